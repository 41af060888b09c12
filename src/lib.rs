//! How light spreads between Lambertian surfaces.

#![deny(missing_docs)]
#![forbid(unsafe_code)]

pub mod accuracy;
pub mod energy;
mod error;
pub mod form_factor;
pub mod monte_carlo;
pub mod output;
pub mod patch;
mod progress;
mod quality;
pub mod scene;
pub mod solve;
pub mod tone;
pub mod trace;

pub use error::{Error, Result};
pub use progress::Progress;
pub use quality::Quality;
pub use scene::Scene;
