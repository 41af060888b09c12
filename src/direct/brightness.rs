//! Finds patches that emit more than their surroundings, so that their light is worth shadow rays.
//!
//! The light of other emitters is treated like reflected light. In a furnace, where emitted and reflected light add up
//! to the same everywhere, all light is treated that way and is exact. Shadow rays to large, dim lamps would only be
//! missing elsewhere.

use rayon::prelude::*;

use crate::{
    parallel::ordered_sum,
    patch::Patches,
    rays::{ESCAPED, RaySet},
};

/// Light bounces until the total power grows by less than this share, at most `MOST_BOUNCES` times.
const ENOUGH: f64 = 1e-3;
const MOST_BOUNCES: usize = 200;
/// Number of rays of each patch that are used.
const ASKED: usize = 32;
/// An emitter must exceed what it sees by this factor to be worth shadow rays. In a furnace nothing is brighter than
/// what it sees, but the estimates have errors.
const BRIGHTER: f64 = 1.25;

/// Estimates the radiosity at equilibrium from some rays alone, interleaved channels, in the unit of emission.
pub(crate) fn radiosity(rays: &RaySet, patches: &Patches) -> Vec<f64> {
    let channels = patches.channels();
    let mut radiosity = patches.emission().to_vec();
    let mut before = total(patches, &radiosity);
    for _ in 0..MOST_BOUNCES {
        let gathered = |i: usize| {
            let asked = &rays.of(i)[..rays.of(i).len().min(ASKED)];
            let mut sum = [0.0; 3];
            for &j in asked.iter().filter(|&&j| j != ESCAPED) {
                (0..channels).for_each(|c| sum[c] += radiosity[j as usize * channels + c]);
            }
            let of_channel = |c: usize| {
                let q = i * channels + c;
                patches.emission()[q] + patches.reflectance()[q] * sum[c] / asked.len().max(1) as f64
            };
            std::array::from_fn::<f64, 3, _>(|c| if c < channels { of_channel(c) } else { 0.0 })
        };
        let next: Vec<[f64; 3]> =
            (0..patches.len()).into_par_iter().with_min_len(128).map(gathered).collect();
        radiosity = next.iter().flat_map(|b| &b[..channels]).copied().collect();
        let now = total(patches, &radiosity);
        if now - before <= ENOUGH * now {
            break;
        }
        before = now;
    }
    radiosity
}

/// The power that leaves all patches, summed over channels.
fn total(patches: &Patches, radiosity: &[f64]) -> f64 {
    let channels = patches.channels();
    let power = |i: usize| patches.area(i) * radiosity[i * channels..][..channels].iter().sum::<f64>();
    ordered_sum(patches.len(), power)
}

/// Whether each front patch emits more than what its triangle sees on average, summed over channels. Bright emitters
/// elsewhere do not matter: a dim lamp may be the only one behind a door.
pub(crate) fn above_what_is_seen(rays: &RaySet, patches: &Patches) -> Vec<bool> {
    let channels = patches.channels();
    let brightness = |b: &[f64], i: usize| b[i * channels..][..channels].iter().sum::<f64>();
    if !patches.emission().iter().any(|&b| b > 0.0) {
        return vec![false; patches.fronts()];
    }
    let radiosity = radiosity(rays, patches);
    let emits = |i: &usize| brightness(patches.emission(), *i) > 0.0;
    let mut shines = vec![false; patches.fronts()];
    let parts: Vec<usize> = (0..patches.fronts()).filter(emits).collect();
    for part in parts.chunk_by(|&i, &j| patches.triangle(i) == patches.triangle(j)) {
        let (mut seen, mut met) = (0.0, 0.0);
        for &j in part.iter().flat_map(|&i| rays.of(i)).filter(|&&j| j != ESCAPED) {
            seen += brightness(&radiosity, j as usize);
            met += 1.0;
        }
        let mean = if met > 0.0 { seen / met } else { 0.0 };
        part.iter().for_each(|&i| shines[i] = brightness(patches.emission(), i) > BRIGHTER * mean);
    }
    shines
}

/// Estimates the share of all light leaving patches that leaves the scene, from rays alone.
pub(crate) fn escaping(rays: &RaySet, patches: &Patches, escaped: &[f64]) -> f64 {
    let channels = patches.channels();
    let radiosity = radiosity(rays, patches);
    let power = |i: usize| patches.area(i) * radiosity[i * channels..][..channels].iter().sum::<f64>();
    let there = || (0..rays.len()).filter(|&i| !rays.is_withdrawn(i));
    let all: f64 = there().map(power).sum();
    if all > 0.0 { there().map(|i| power(i) * escaped[i]).sum::<f64>() / all } else { 0.0 }
}
