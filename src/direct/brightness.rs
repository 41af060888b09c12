//! Finds patches that emit more than their surroundings, so that their light is worth shadow rays.
//!
//! The light of other emitters is treated like reflected light. In a furnace, where emitted and reflected light add up
//! to the same everywhere, all light is treated that way and is exact. Shadow rays to large, dim lamps would only be
//! missing elsewhere.

use rayon::prelude::*;

use super::Lamps;
use crate::{
    parallel::ordered_sum,
    patch::Patches,
    rays::{ESCAPED, RaySet},
    scene::light::Lights,
    trace::Tracer,
};

/// Light bounces until the total power grows by less than this share, at most `MOST_BOUNCES` times.
const ENOUGH: f64 = 1e-3;
const MOST_BOUNCES: usize = 200;
/// Number of rays of each patch that are used.
const ASKED: usize = 32;
/// An emitter must exceed what it sees by this factor to be worth shadow rays. In a furnace nothing is brighter than
/// what it sees, but the estimates have errors.
const BRIGHTER: f64 = 1.25;
/// The same if there are too many emitters to compute their unblocked light. Shadow rays are then worth less, because they
/// also sample how unblocked light varies. RMS errors of irradiance with 1.25 and 4: a terrain of 2,048 facets whose
/// emissions differ by up to 6 times, 256 rays, 10.8 and 6.7 % (one-way 7.1 %); by up to 128 times, 12.6 and 12.5 % (one-way
/// 18 %); a ceiling of 800 triangles that shines, 64 rays, 8.8 and 4.1 %, and above blocks 9.8 and 5.5 %; a small lamp of
/// 392 triangles 2.1 % in both cases.
const MUCH_BRIGHTER: f64 = 4.0;

/// Estimates the radiosity at equilibrium from some rays alone, interleaved channels, in the unit of emission.
fn radiosity(rays: &RaySet, patches: &Patches) -> Vec<f64> {
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

/// The power that leaves a patch, summed over channels.
fn power(patches: &Patches, radiosity: &[f64], i: usize) -> f64 {
    let channels = patches.channels();
    patches.area(i) * radiosity[i * channels..][..channels].iter().sum::<f64>()
}

/// The power that leaves all patches, summed over channels.
fn total(patches: &Patches, radiosity: &[f64]) -> f64 {
    ordered_sum(patches.len(), |i| power(patches, radiosity, i))
}

/// The lamps of a scene, given some rays: the emitters that exceed what they see by [`BRIGHTER`], and all lights that are
/// not surfaces. If these emitters are [many](Lamps::are_many), they must exceed it by [`MUCH_BRIGHTER`].
pub(crate) fn lamps(rays: &RaySet, tracer: &Tracer, patches: &Patches, lights: &Lights) -> Lamps {
    let contrast = Contrast::new(rays, patches);
    let lamps = Lamps::new(tracer, patches, lights, |i| contrast.exceeds(i, BRIGHTER));
    if lamps.are_many() {
        return Lamps::new(tracer, patches, lights, |i| contrast.exceeds(i, MUCH_BRIGHTER));
    }
    lamps
}

/// How much emitters exceed what they see.
struct Contrast {
    /// The ratio of both for each front patch: 0 if it does not emit, infinite if what it sees is dark.
    of: Vec<f64>,
}

impl Contrast {
    fn new(rays: &RaySet, patches: &Patches) -> Contrast {
        let channels = patches.channels();
        let brightness = |b: &[f64], i: usize| b[i * channels..][..channels].iter().sum::<f64>();
        let mut of = vec![0.0; patches.fronts()];
        if !patches.emission().iter().any(|&b| b > 0.0) {
            return Contrast { of };
        }
        let radiosity = radiosity(rays, patches);
        let emission = |i: usize| brightness(patches.emission(), i);
        let parts: Vec<usize> = (0..patches.fronts()).filter(|&i| emission(i) > 0.0).collect();
        // The light that the triangles of emitters see: its sum over the rays that hit something, and their number.
        let sees = |part: &[usize]| {
            let hits = part.iter().flat_map(|&i| rays.of(i)).filter(|&&j| j != ESCAPED);
            hits.fold((0.0, 0.0), |(sum, count), &j| (sum + brightness(&radiosity, j as usize), count + 1.0))
        };
        let mut blind = Vec::new();
        let (mut power, mut area) = (0.0, 0.0);
        for part in parts.chunk_by(|&i, &j| patches.triangle(i) == patches.triangle(j)) {
            let (sum, count) = sees(part);
            for &i in part {
                if count == 0.0 {
                    blind.push(i);
                    continue;
                }
                of[i] = emission(i) / (sum / count);
                if of[i] <= BRIGHTER {
                    power += patches.area(i) * emission(i);
                    area += patches.area(i);
                }
            }
        }
        // Emitters that see nothing are compared with those that are no lamps: the facets on a hilltop with the others.
        let mean = if area > 0.0 { power / area } else { 0.0 };
        blind.into_iter().for_each(|i| of[i] = BRIGHTER / MUCH_BRIGHTER * emission(i) / mean);
        Contrast { of }
    }

    fn exceeds(&self, i: usize, factor: f64) -> bool {
        self.of[i] > factor
    }
}

/// Estimates the share of all light leaving patches that leaves the scene, from rays alone.
pub(crate) fn escaping(rays: &RaySet, patches: &Patches, escaped: &[f64]) -> f64 {
    let radiosity = radiosity(rays, patches);
    let power = |i: usize| power(patches, &radiosity, i);
    let there = || (0..rays.len()).filter(|&i| !rays.is_withdrawn(i));
    let all: f64 = there().map(power).sum();
    if all > 0.0 { there().map(|i| power(i) * escaped[i]).sum::<f64>() / all } else { 0.0 }
}
