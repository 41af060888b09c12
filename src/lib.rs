//! How light spreads between Lambertian surfaces.

#![deny(missing_docs)]
#![forbid(unsafe_code)]

mod error;
pub mod form_factor;
pub mod monte_carlo;
mod progress;
pub mod scene;
pub mod trace;

pub use error::{Error, Result};
pub use progress::Progress;
pub use scene::Scene;
