//! How light spreads between Lambertian surfaces, and how right the answer is.
//!
//! The way from a scene to its light, each step a plain value: [`Scene::load`] → [`trace::Tracer`] →
//! [`patch::Patches`] → [`form_factor::FormFactors`] → [`solve::Solution`] → [`energy::EnergyLedger`],
//! [`accuracy::error_bars::ErrorBars`] and the files of [`output`]. [`monte_carlo`] is the referee: it follows light
//! without form factors, and [`accuracy::validation`] compares. The README, whose example is tested with the
//! documentation, shows it in ten lines.

#![deny(missing_docs)]
#![deny(unsafe_code)]

#[macro_use]
mod setters;

pub mod accuracy;
pub mod energy;
mod error;
pub mod form_factor;
pub mod lightmap;
pub mod monte_carlo;
pub mod output;
pub mod patch;
mod progress;
mod quality;
pub mod scene;
pub mod solve;
pub mod tone;
pub mod trace;
pub mod view_factor;

pub use error::{Error, MeshError, Result, Setting};
pub use glam;
pub use progress::Progress;
pub use quality::Quality;
pub use scene::Scene;

/// The README's example, compiled and run with the tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

/// The examples of the library guide, compiled and run with the tests.
#[cfg(doctest)]
#[doc = include_str!("../docs/guides/library.md")]
struct LibraryGuide;
