//! Irradiance of texels from the patches of a solution: exact means over the covered part of each texel.

use rayon::prelude::*;

use super::{atlas::Atlas, coverage::Coverage};
use crate::{
    patch::Patches,
    solve::Solution,
    tone::{luminance, rgb},
};

/// Least number of texels per parallel task.
pub(super) const STRETCH: usize = 64;

/// For each triangle, whether the flux on its front is at least the flux on its back.
pub fn lit_sides(patches: &Patches, solution: &Solution) -> Vec<bool> {
    let flux = side_fluxes(patches, solution);
    flux.into_iter().map(|[front, back]| front >= back).collect()
}

/// For each triangle, whether the flux on its darker side is more than `least` times the flux on its brighter side.
pub fn lit_on_both_sides(patches: &Patches, solution: &Solution, least: f64) -> Vec<bool> {
    let flux = side_fluxes(patches, solution);
    flux.into_iter().map(|[front, back]| front.min(back) > least * front.max(back)).collect()
}

/// Luminance of the flux on the front and on the back of each triangle.
fn side_fluxes(patches: &Patches, solution: &Solution) -> Vec<[f64; 2]> {
    let channels = solution.channels;
    let mut flux = vec![[0.0; 2]; patches.triangle_areas().len()];
    for i in 0..patches.len() {
        let e = rgb(&solution.irradiance[i * channels..][..channels]);
        let side = usize::from(!patches.is_front(i));
        flux[patches.triangle(i)][side] += patches.area(i) * luminance(e).max(0.0);
    }
    flux
}

/// Mean irradiance of each covered texel, W/m²: Σ area · E / Σ area over the patches in it.
pub fn means(
    atlas: &Atlas,
    coverage: &Coverage,
    patches: &Patches,
    solution: &Solution,
    sides: &[bool],
) -> Vec<[f32; 3]> {
    let channels = solution.channels;
    let irradiance = |i: usize| rgb(&solution.irradiance[i * channels..][..channels]);
    (0..coverage.len())
        .into_par_iter()
        .with_min_len(STRETCH)
        .map(|i| {
            let (mut flux, mut total) = ([0.0; 3], 0.0);
            for piece in coverage.pieces(i) {
                let t = piece.triangle as usize;
                let (mut sum, mut weight) = ([0.0; 3], 0.0);
                let part = coverage.barycentric_part(atlas, i, t).in_triangle(atlas, t);
                part.for_each_patch(patches, atlas.triangle(t), sides[t], |patch, share| {
                    let e = patch.map_or([0.0; 3], irradiance);
                    (0..3).for_each(|c| sum[c] += share * e[c]);
                    weight += share;
                });
                if weight > 0.0 {
                    (0..3).for_each(|c| flux[c] += piece.area * sum[c] / weight);
                    total += piece.area;
                }
            }
            flux.map(|f| if total > 0.0 { (f / total).max(0.0) as f32 } else { 0.0 })
        })
        .collect()
}
