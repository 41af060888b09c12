//! The referee: path and light tracing, which share nothing with the solver but the rays.
//!
//! No form factor, no patch and no linear system is used here, so an agreement with the solver is evidence. Rays run
//! in unit space ([`crate::trace::Tracer`]); what is returned is in the file's units: irradiance and radiance do not
//! depend on the unit of length, flux is in W for areas in the file's unit squared.
//!
//! Every estimate comes with a standard error, taken from independent replicates; everything is a function of the
//! seed alone, whatever the number of threads.

mod camera;
mod emitters;
mod estimate;
mod frame;
mod image;
mod light_tracer;
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
pub use path_tracer::{PathOptions, PathTracer, Receiver, Region};
pub use probe::{Probe, read_probes, write_probes};
pub use samples::Samples;
