//! Independent reference estimators: path tracing and light tracing. They share only the ray tracer with the solver.
//!
//! They use no form factors, no patches and no linear system, so their agreement with the solver is evidence that it is
//! right. Rays run in unit space ([`crate::trace::Tracer`]), and results are in the units of the file. Irradiance and
//! radiance do not depend on the unit of length. Flux is in W if areas are in m².
//!
//! Every estimate has a standard error, computed from independent replicates. Results depend on the seed but not on the
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
