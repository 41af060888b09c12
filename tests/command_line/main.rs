//! Tests that run the program.

#[path = "../common/mod.rs"]
mod common;

mod bake;
#[cfg(unix)]
mod checkpoint;
mod gloss;
mod gltf;
mod inspect;
#[cfg(target_os = "linux")]
mod matrix_free;
#[cfg(target_os = "linux")]
mod memory;
#[cfg(unix)]
mod outputs;
mod ply;
mod probe;
mod radiance;
mod render;
mod solve;
mod tradeoff;
mod view_factors;
