//! Scenes as binary glTF 2.0.
//!
//! [`Glb`] puts bytes and JSON together. [`Source`] is what a lit file is made of: the glTF file that the scene came from, with
//! all that is in it, or one made of the scene where it came from elsewhere. [`lit`] gives every mesh a second set of texture
//! coordinates and every material a way to show a map; [`vertex_colours`] writes a solution's patches.

mod glb;
pub mod lit;
mod source;
pub mod vertex_colours;

pub use glb::Glb;
pub use source::Source;

/// Written to `asset.generator`.
pub const GENERATOR: &str = concat!("radiosity ", env!("CARGO_PKG_VERSION"));
