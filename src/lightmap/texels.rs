//! Irradiance of texels from the patches of a solution: exact means over the covered part of each texel.

use rayon::prelude::*;

use super::{atlas::Atlas, coverage::Coverage};
use crate::{patch::Patches, solve::Solution, tone::rgb};

/// Texels that one task works on.
pub(super) const STRETCH: usize = 64;

/// Which side of each triangle the map is of: the front, but the back where only that is lit.
pub fn lit_sides(patches: &Patches, solution: &Solution) -> Vec<bool> {
    let channels = solution.channels;
    let lit = |i: usize| solution.irradiance[i * channels..][..channels].iter().any(|&e| e > 0.0);
    (0..patches.triangle_areas().len())
        .map(|t| {
            let fronts = patches.fronts_of(t);
            fronts.clone().any(lit) || !fronts.filter_map(|i| patches.back_of(i)).any(|i| lit(i as usize))
        })
        .collect()
}

/// Mean irradiance of each covered texel, W/m²: Σ area · E over the patches in it, over Σ area.
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
                coverage.barycentric_part(atlas, i, t).for_each_patch(
                    patches,
                    t,
                    sides[t],
                    |patch, share| {
                        let e = patch.map_or([0.0; 3], irradiance);
                        (0..3).for_each(|c| sum[c] += share * e[c]);
                        weight += share;
                    },
                );
                if weight > 0.0 {
                    (0..3).for_each(|c| flux[c] += piece.area * sum[c] / weight);
                    total += piece.area;
                }
            }
            flux.map(|f| if total > 0.0 { (f / total).max(0.0) as f32 } else { 0.0 })
        })
        .collect()
}
