//! A map inside a glTF file; see [`crate::output::gltf::lit`].

use std::f64::consts::PI;

use image::{Rgb, RgbImage};
use serde_json::json;

use super::{Lightmap, atlas::NONE};
use crate::{
    Result,
    output::gltf::{
        Source,
        lit::{Layout, Show, lit},
    },
    scene::Scene,
    tone::{Exposure, srgb},
};

/// How a glTF file shows a map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// Black materials that emit the radiosity of the surface.
    Emissive,
    /// The scene's materials with the extension MOZ_lightmap, which names a map of irradiance.
    Moz,
    /// Texture coordinates only, for an engine that reads the map from its own file.
    Coordinates,
}

/// Largest value of the emissive map, as a multiple of white. The map has eight bits. With a largest value of four
/// whites, the range from black to white has 137 of the 256 levels of sRGB, and a picture differs by a quarter of a
/// screen level on average.
const HEADROOM: f64 = 4.0;

const WHOLE: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

impl Lightmap {
    /// A binary glTF file of the scene with this map. `source` describes the facets
    /// ([`Atlas::scene`](super::Atlas::scene)). `exposure` scales the emissive map. `files` are the names of the files
    /// that hold the irradiance, one per page.
    ///
    /// # Errors
    /// If `source` cannot be read.
    pub fn glb(
        &self,
        scene: &Scene,
        source: &Source,
        encoding: Encoding,
        exposure: Exposure,
        files: &[String],
    ) -> Result<Vec<u8>> {
        let pages: Vec<Option<u32>> = (0..self.atlas.chart.len())
            .map(|t| (self.atlas.chart[t] != NONE).then_some(self.atlas.page[t]))
            .collect();
        let layout =
            Layout { coordinates: &self.atlas.coordinates, corners: &self.atlas.corners, pages: &pages };
        let mut extras = json!({"irradiance": files, "unit": scene.units.names().irradiance});
        let show = match encoding {
            Encoding::Emissive => {
                extras["encoding"] = "emissive".into();
                // Stored as radiance, the unit of `radiosity render --white`.
                extras["white"] = (exposure.white() / PI).into();
                self.emissive(scene, exposure)
            }
            Encoding::Moz => {
                extras["encoding"] = "MOZ_lightmap".into();
                let most = self.irradiance.iter().flatten().fold(0.0, |most: f32, &e| most.max(e));
                let intensity = if most > 0.0 { f64::from(most) } else { 1.0 };
                Show::Moz { pages: self.pages(&self.irradiance, |e| e / intensity), intensity }
            }
            Encoding::Coordinates => Show::Coordinates,
        };
        lit(self.atlas.scene(scene), source, layout, &show, extras)
    }

    fn emissive(&self, scene: &Scene, exposure: Exposure) -> Show {
        let plain: Vec<Option<[f64; 3]>> =
            (0..scene.materials.len()).map(|m| self.too_bright(scene, m, exposure)).collect();
        let radiosity = self.dilated_radiosity(scene);
        let facets = &self.atlas.scene(scene).triangles;
        let is_plain = |facet: u32| plain[facets[facet as usize].material as usize].is_some();
        let mut most = 0f32;
        for (i, &at) in self.coverage.texels().iter().enumerate() {
            if !self.coverage.pieces(i).iter().any(|piece| is_plain(piece.triangle)) {
                most = radiosity[at as usize].iter().fold(most, |most, &b| most.max(b));
            }
        }
        let brightest = f64::from(most) * exposure.scale;
        let strength = if brightest > 0.0 { brightest.min(HEADROOM) } else { 1.0 };
        let scale = exposure.scale / strength;
        Show::Emissive {
            pages: self.pages(&radiosity, |b| srgb((b * scale).clamp(0.0, 1.0))),
            strength,
            plain,
        }
    }

    /// The mean radiosity of a material, as a multiple of white, if its emission is uniform and brighter than the map
    /// can hold. `None` for all other materials.
    fn too_bright(&self, scene: &Scene, m: usize, exposure: Exposure) -> Option<[f64; 3]> {
        let material = &scene.materials[m];
        let emitted = material.emission.map(|e| PI * e * exposure.scale);
        if material.emission_map.is_some() || emitted.iter().all(|&e| e <= HEADROOM) {
            return None;
        }
        let (mut sum, mut area) = ([0.0; 3], 0.0);
        for (i, &at) in self.coverage.texels().iter().enumerate() {
            for piece in self.coverage.pieces(i) {
                let t = self.atlas.triangle(piece.triangle as usize);
                if scene.triangles[t].material as usize == m {
                    let rho = scene.mean_reflectance(t, &WHOLE);
                    let e = self.irradiance[at as usize];
                    (0..3).for_each(|c| sum[c] += piece.area * rho[c] * f64::from(e[c]) * exposure.scale);
                    area += piece.area;
                }
            }
        }
        Some(std::array::from_fn(|c| emitted[c] + if area > 0.0 { sum[c] / area } else { 0.0 }))
    }

    /// Images of all pages, rows from the top. `share` maps a value to the range 0 to 1.
    fn pages(&self, values: &[[f32; 3]], share: impl Fn(f64) -> f64) -> Vec<RgbImage> {
        let (width, height) = (self.atlas.width, self.atlas.height);
        let image = |page: &[[f32; 3]]| {
            RgbImage::from_fn(width as u32, height as u32, |x, y| {
                let value = page[(height - 1 - y as usize) * width + x as usize];
                Rgb(value.map(|v| (share(f64::from(v)).clamp(0.0, 1.0) * 255.0).round() as u8))
            })
        };
        values.chunks(width * height).map(image).collect()
    }
}
