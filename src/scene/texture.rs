//! Textures.

use glam::DVec2;

/// An image, decoded from sRGB when read. Its texels are constant squares: the mean over a patch and the value at
/// a point agree exactly.
#[derive(Debug, Clone, Default)]
pub struct Texture {}

/// How a material uses a texture.
#[derive(Debug, Clone, PartialEq)]
pub struct TextureMap {
    /// Index into [`Scene::textures`](super::Scene::textures).
    pub texture: usize,
}

impl Texture {
    /// Whether every texel has three equal channels.
    pub fn is_grey(&self) -> bool {
        todo!()
    }
    /// Linear value at `uv`.
    pub fn at(&self, _map: &TextureMap, _uv: DVec2) -> [f64; 3] {
        todo!()
    }
    /// Linear value averaged over the triangle `uv`.
    pub fn mean(&self, _map: &TextureMap, _uv: [DVec2; 3]) -> [f64; 3] {
        todo!()
    }
}
