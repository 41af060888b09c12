//! Scenes as binary glTF 2.0.
//!
//! [`Glb`] joins bytes and JSON. [`Source`] is the file that a lightmap is added to: the glTF file of the scene with
//! everything in it, or a new file if the scene has another format. [`lit`] adds the lightmap. [`vertex_colours`]
//! writes the patches of a solution.

mod glb;
pub mod lit;
mod source;
pub mod vertex_colours;

pub use glb::Glb;
pub use source::Source;

/// The value of `asset.generator`.
pub const GENERATOR: &str = concat!("radiosity ", env!("CARGO_PKG_VERSION"));
