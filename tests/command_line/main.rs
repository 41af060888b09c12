//! Tests that run the program.

#[path = "../common/mod.rs"]
mod common;

mod bake;
mod blender;
#[cfg(unix)]
mod checkpoint;
mod exchange;
mod gloss;
mod gltf;
mod inspect;
mod lights;
#[cfg(target_os = "linux")]
mod matrix_free;
#[cfg(target_os = "linux")]
mod memory;
#[cfg(unix)]
mod outputs;
mod page;
#[cfg(unix)]
mod parts;
mod ply;
mod probe;
mod radiance;
mod render;
mod solve;
mod tradeoff;
mod view_factors;
