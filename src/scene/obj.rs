//! Wavefront OBJ with MTL.
use super::Scene;
use crate::Result;
use std::path::Path;
/// Reads `path` and the material libraries it names.
pub fn load(_path: &Path) -> Result<Scene> {
    todo!()
}
