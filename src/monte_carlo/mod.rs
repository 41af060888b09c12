//! The referee: path tracing and light tracing. They share only the rays with the solver.
//!
//! No form factor, no patch and no linear system is used here, so an agreement with the solver is evidence. Rays run in unit
//! space ([`crate::trace::Tracer`]), and results are in the units of the file. Irradiance and radiance do not depend on the
//! unit of length. Flux is in W if areas are in m².
//!
//! Every estimate has a standard error, computed from independent replicates. Everything is a function of the seed alone, for any
//! number of threads.

mod camera;
mod emitters;
mod estimate;
mod frame;
mod image;
mod light_tracer;
mod outside;
mod path_tracer;
mod probe;
pub mod reflection;
mod samples;
mod scattering;
#[cfg(test)]
mod tests;

pub use camera::{Camera, Lens};
use emitters::Emitters;
pub use estimate::{Effort, Estimate};
pub use image::{Film, PictureFormat, RenderOptions};
pub use light_tracer::{LightImage, LightOptions, LightTracer, LightTransport, Particle};
use outside::Outside;
pub use path_tracer::{PathOptions, PathTracer, Receiver, Region};
pub use probe::{Probe, read_probes, write_probes};
pub use samples::Samples;
