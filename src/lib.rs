//! Computes the exchange of light between Lambertian surfaces, and the accuracy of the result.
//!
//! The radiosity method cuts surfaces into patches of constant or linear light. A form factor F_ij is the share of the
//! light leaving patch i that arrives at patch j. Rays estimate the form factors. The radiosity B of a patch is the
//! power that leaves it per area. It is the solution of the linear system B = Be + ρ F B, with emission Be and
//! reflectance ρ.
//!
//! # From a file to radiosity
//!
//! ```
//! use radiosity::{Progress, Scene, energy::EnergyLedger, form_factor::*, patch::*, solve::*, trace::Tracer};
//!
//! let scene = Scene::load("meshes/cornell-box.obj")?;
//! let tracer = Tracer::new(&scene);
//! let progress = Progress::new();
//!
//! let mut patches = Patches::subdivide(&scene, &Subdivision::Count(1000));
//! let options = CastOptions::default().with_rays(64.0).with_seed(1);
//! let form_factors = FormFactors::cast(&scene, &tracer, &mut patches, &options, &progress)?;
//! let solution = solve(&form_factors, &patches, &SolveOptions::default(), &progress)?;
//!
//! let brightest = (0..patches.len()).max_by(|&i, &j| solution.rgb(i)[1].total_cmp(&solution.rgb(j)[1])).unwrap();
//! println!("brightest at {}: {:?} W/m²", patches.centroid(&scene, brightest), solution.rgb(brightest));
//! assert_eq!(scene.material(patches.triangle(brightest)).name, "light");
//!
//! // All light that is emitted is absorbed or escapes.
//! let ledger = EnergyLedger::of(&form_factors, &patches, &solution);
//! assert!(ledger.imbalance().abs() < 1e-9);
//! # Ok::<(), radiosity::Error>(())
//! ```
//!
//! [`accuracy::error_bars::ErrorBars`] gives the standard error of every patch. [`output`] writes meshes, pictures and
//! reports. [`lightmap`] bakes textures.
//!
//! # Your own mesh, and other lamps without new rays
//!
//! ```
//! use radiosity::{Progress, Scene, form_factor::*, glam::dvec3, patch::*, scene::Material, solve::*, trace::Tracer};
//!
//! // A lamp of one square metre faces a floor at a distance of one metre.
//! let corner = |x: f64, y: f64, z: f64| dvec3(x, y, z);
//! let vertices = [
//!     corner(0., 0., 0.), corner(1., 0., 0.), corner(1., 1., 0.), corner(0., 1., 0.),
//!     corner(0., 0., 1.), corner(0., 1., 1.), corner(1., 1., 1.), corner(1., 0., 1.),
//! ];
//! let materials = vec![
//!     Material::new("floor", [0.5; 3], [0.0; 3]),
//!     Material::new("lamp", [0.0; 3], [1.0; 3]),
//! ];
//! let mut scene = Scene::from_indexed(&vertices, [[0, 1, 2, 3], [4, 5, 6, 7]], &[0, 1], materials)?;
//! let tracer = Tracer::new(&scene);
//! let progress = Progress::new();
//! let mut patches = Patches::subdivide(&scene, &Subdivision::Edge(0.25));
//! let options = CastOptions::default().with_rays(256.0);
//! let form_factors = FormFactors::cast(&scene, &tracer, &mut patches, &options, &progress)?;
//! let dim = solve(&form_factors, &patches, &SolveOptions::default(), &progress)?;
//!
//! scene.set_material("lamp", [0.0; 3], [3.0; 3]);
//! patches.update_materials(&scene);
//! let bright = solve(&form_factors, &patches, &SolveOptions::default(), &progress)?;
//! assert!((bright.irradiance_rgb(0)[0] / dim.irradiance_rgb(0)[0] - 3.0).abs() < 1e-6);
//! # Ok::<(), radiosity::Error>(())
//! ```
//!
//! # The same light by path tracing
//!
//! [`monte_carlo`] computes light without form factors. It shares only the scene and the ray tracer with the solver, so
//! it is an independent check. [`accuracy::validation`] compares both patch by patch.
//!
//! ```
//! use radiosity::{Progress, Scene, glam::dvec3, monte_carlo::{Effort, PathOptions, PathTracer, Receiver}, trace::Tracer};
//!
//! let scene = Scene::load("meshes/cornell-box.obj")?;
//! let tracer = Tracer::new(&scene);
//! let paths = PathTracer::new(&scene, &tracer, PathOptions::default());
//! // A point of the floor, in millimetres as in the file.
//! let place = Receiver::free(&tracer, dvec3(420.0, 0.0, 100.0), dvec3(0.0, 1.0, 0.0));
//! let effort = Effort::default().with_samples(1024);
//! let irradiance = &paths.irradiances(&[place], &effort, &Progress::new())?[0];
//! println!("{:?} ± {:?} W/m²", irradiance.mean, irradiance.standard_error);
//! assert!(irradiance.mean[0] > 10.0 * irradiance.standard_error[0]);
//! # Ok::<(), radiosity::Error>(())
//! ```
//!
//! # Options, errors and features
//!
//! Option structs have defaults and a method `with_…` for each field. New versions may add fields. Unusable input gives
//! an [`Error`]. A wrong index panics. The default feature `cli` builds the program `radiosity`. The library does not
//! need it: `radiosity = { version = "0.1", default-features = false }`.

#![deny(missing_docs)]
#![deny(unsafe_code)]

#[macro_use]
mod setters;

// The commands name the library as any other program does.
#[cfg(feature = "cli")]
extern crate self as radiosity;

pub mod accuracy;
#[cfg(feature = "cli")]
pub mod cli;
pub mod daylight;
mod direct;
pub mod energy;
mod error;
pub mod exact;
pub mod form_factor;
pub mod heat;
pub mod lightmap;
mod moments;
pub mod monte_carlo;
pub mod output;
mod parallel;
pub mod patch;
mod progress;
mod quality;
mod ranks;
pub mod rays;
pub mod scene;
mod slopes;
pub mod solve;
mod symmetric;
pub mod tone;
pub mod trace;
pub mod view_factor;

pub use error::{Error, MeshError, Result, Setting};
pub use glam;
pub use progress::Progress;
pub use quality::Quality;
pub use ranks::{Connection, Ranks};
pub use scene::Scene;

/// The README's example, compiled and run with the tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

/// The examples of the library guide, compiled and run with the tests.
#[cfg(doctest)]
#[doc = include_str!("../docs/guides/library.md")]
struct LibraryGuide;
