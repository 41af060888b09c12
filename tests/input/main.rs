//! What is read, and the house itself: readers, meshes that ship, damaged geometry, layers.

#[path = "../common/mod.rs"]
mod common;

mod corpus;
mod degenerate;
mod gltf_hostile;
mod gltf_reader;
mod independence;
mod meshes;
mod obj_reader;
mod textures;
