//! Input and structure: readers, the meshes of this repository, damaged geometry, layers of modules.

#[path = "../common/mod.rs"]
mod common;

mod contacts;
mod corpus;
mod cutouts;
mod degenerate;
mod gltf_corpus;
mod gltf_hostile;
mod gltf_reader;
mod independence;
mod meshes;
mod obj_reader;
mod overlaps;
mod stl;
mod textures;
