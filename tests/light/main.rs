//! The library: form factors, light, error bars and lightmaps against physics.

#[path = "../common/mod.rs"]
mod common;

mod accuracy;
mod adaptive;
mod checkpoint;
mod contacts;
mod daylight;
mod determinism;
mod error_bars;
mod exact_form_factors;
mod extremes;
mod form_factors;
mod heat;
mod lambert;
mod lightmaps;
mod lights;
mod linear;
mod matrix;
mod openings;
mod ply;
mod presets;
mod properties;
mod rays;
mod sizes;
mod solvers;
mod stochastic_jacobi;
mod validation;
mod view_factors;
mod whole_scenes;
