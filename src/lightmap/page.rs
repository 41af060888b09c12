//! A map as a page: see [`crate::output::page`].

use std::io::{self, Write};

use serde_json::json;

use super::{Lightmap, NONE};
use crate::{
    monte_carlo::Camera,
    output::page::{
        self, PageOptions,
        document::{self, Array, Kind, Values},
        materials,
        numbers::{halves, shared_exponent, unit_of},
        place::Ball,
    },
    scene::Scene,
};

/// The corners of a triangle in barycentric coordinates.
const CORNERS: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

impl Lightmap {
    /// Writes a page that shows the scene with this map to `out`, which should be buffered. Without an exposure in `options` the map's
    /// own is taken.
    ///
    /// # Errors
    /// Errors of writing to `out`.
    pub fn write_page(
        &self,
        scene: &Scene,
        camera: &Camera,
        options: &PageOptions,
        out: &mut dyn Write,
    ) -> io::Result<()> {
        let radiance = scene.materials.iter().flat_map(|m| m.emission);
        let emitted = radiance.map(|radiance| std::f64::consts::PI * radiance);
        let unit = unit_of(self.irradiance.iter().flatten().map(|&e| f64::from(e)).chain(emitted));
        let ball = Ball::around(&scene.vertices);
        let mut arrays = self.facet_arrays(scene, unit, &ball);
        for (k, texels) in self.irradiance.chunks(self.atlas.width * self.atlas.height).enumerate() {
            let bits = texels.iter().map(|e| shared_exponent(e.map(|e| f64::from(e) / unit))).collect();
            arrays.push((format!("page_{k}"), Values::U32(bits)));
        }
        let exposure = options.exposure.unwrap_or_else(|| self.exposure());
        let mut about = page::about((scene, camera), options, (unit, exposure), &ball, &mut arrays)?;
        about["kind"] = "lightmap".into();
        about["channels"] = 3.into();
        about["methods"] = json!([{"name": "lightmap", "layers": []}]);
        about["layers"] = json!([]);
        about["pages"] = self.atlas.pages.into();
        about["width"] = self.atlas.width.into();
        about["height"] = self.atlas.height.into();
        document::write(out, Kind::View, options.title, &about, &arrays)
    }

    /// The facets that have a place in the map. Each shows the side that the map is of.
    fn facet_arrays(&self, scene: &Scene, unit: f64, ball: &Ball) -> Vec<Array> {
        let atlas = &self.atlas;
        let facets = atlas.scene(scene);
        let shown: Vec<usize> = (0..atlas.corners.len()).filter(|&f| atlas.chart[f] != NONE).collect();
        // Seen from behind, corners run the other way round.
        let order = |f: usize| if self.sides[f] { [0, 1, 2] } else { [0, 2, 1] };
        let two_sided = |f: usize| atlas.facet_at(atlas.triangle(f), CORNERS[0], true).is_some();
        let flags = |&f: &usize| u8::from(!self.sides[f]) + 2 * u8::from(two_sided(f));
        let corners = |f: usize| order(f).map(|k| facets.triangles[f].vertices[k]);
        let map_uv = |f: usize| order(f).map(|k| atlas.coordinates[atlas.corners[f][k] as usize]);
        let single = |values: Vec<f64>| values.into_iter().map(|x| x as f32).collect();
        let of = |what: &dyn Fn(usize) -> u32| Values::indices(shown.iter().map(|&f| what(f)).collect());
        let mut arrays: Vec<Array> = vec![
            ("positions".into(), Values::F32(ball.place(&facets.vertices))),
            ("faces".into(), Values::indices(shown.iter().flat_map(|&f| corners(f)).collect())),
            ("material".into(), of(&|f| facets.triangles[f].material)),
            ("triangle".into(), of(&|f| scene.triangles[atlas.triangle(f)].source)),
            ("page_of".into(), of(&|f| atlas.page[f])),
            ("flags".into(), Values::U8(shown.iter().map(flags).collect())),
            (
                "map_uv".into(),
                Values::F32(single(
                    shown.iter().flat_map(|&f| map_uv(f)).flat_map(|p| p.to_array()).collect(),
                )),
            ),
        ];
        let part = |f: usize| CORNERS.map(|b| atlas.in_triangle(f, b));
        if materials::vary(scene) {
            let reflectance: Vec<f64> =
                shown.iter().flat_map(|&f| scene.mean_reflectance(atlas.triangle(f), &part(f))).collect();
            let emitted = |f: usize| {
                let front = if self.sides[f] { std::f64::consts::PI } else { 0.0 };
                scene.mean_emission(atlas.triangle(f), &part(f)).map(|radiance| front * radiance)
            };
            let emission: Vec<f64> = shown.iter().flat_map(|&f| emitted(f)).collect();
            arrays.push(("reflectance".into(), Values::F16(halves(&reflectance, 1.0))));
            arrays.push(("emission".into(), Values::F16(halves(&emission, unit))));
        }
        let mapped = shown.iter().filter(|&&f| materials::has_map(facets.material(f)));
        let uv: Vec<_> = mapped
            .map(|&f| {
                let corners = part(f);
                materials::coordinates(scene, atlas.triangle(f), order(f).map(|k| corners[k]))
            })
            .collect();
        if !uv.is_empty() {
            arrays.extend(materials::coordinate_arrays(&uv));
        }
        arrays
    }
}
