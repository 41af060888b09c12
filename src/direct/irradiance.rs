//! Turns shadow rays into direct light.
//!
//! A shadow ray s of weight w contributes the irradiance V w B to a patch, where V is 1 if it is unblocked and 0
//! otherwise, and B is the radiosity of the piece it went to. The mean over all rays is unbiased. If the unblocked
//! irradiance G is known, it equals the mean of w B, and w B serves as a control variate. For any number β that does
//! not depend on s,
//!
//!   y = (V - β) w B + β G
//!
//! has the same mean, with the least variance if β is about the unblocked share of the light (a regression estimate:
//! Cochran, *Sampling Techniques*, 1977, chapter 7). Each lamp has its own β. It is estimated from the half of the
//! shadow rays that s is not in. If all rays are free, β is 1 and y is exactly G; if all are blocked, y is 0. A ratio
//! estimator G Σ V w / Σ w takes the share from the samples that it corrects. It is biased if few rays are free: 2.7
//! times too large under a grille that lets patches see a fiftieth.

use rayon::prelude::*;

use super::{
    Constants,
    shadow::{HALVES, ShadowRays},
};
use crate::{
    parallel::{SHORT, ordered_sum},
    rays::{REPLICATES, part},
};

/// Deviation of the irradiance of a patch in each replicate from the mean of all, by channel.
pub(crate) type Deviation<const C: usize> = [[f32; REPLICATES]; C];

/// Light that arrives straight from lamps and from outside the patches.
#[derive(Debug, Clone)]
pub(crate) struct DirectLight<const C: usize> {
    /// Irradiance of each patch.
    pub(crate) irradiance: Vec<[f64; C]>,
    /// Deviations of its replicates.
    pub(crate) deviations: Vec<Deviation<C>>,
    /// Power that arrives from lights that are not surfaces.
    pub(crate) entered: [f64; C],
    /// Deviations of its replicates.
    pub(crate) entered_deviations: [[f64; REPLICATES]; C],
    /// Power of lamps that arrives at no patch.
    pub(crate) escaped: [f64; C],
    /// Deviations of its replicates.
    pub(crate) escaped_deviations: [[f64; REPLICATES]; C],
    /// Whether more power is missing than sampling error explains in a scene from which no ray escapes.
    pub(crate) leaks: bool,
}

/// In a closed scene, this many standard errors of missing power count as noise.
const NOISE: f64 = 4.0;
/// Share of the lamps' power that may be missing besides, because of the rounding of quadrature.
const ROUNDING: f64 = 1e-5;
/// Standard deviation of the share of the lamps' own light that escapes, relative to the share of all light.
const PRIOR: f64 = 3.0;

/// Samples of a lamp in one half of the rays.
#[derive(Clone, Copy, Default)]
struct Seen {
    free: f64,
    all: f64,
    count: f64,
}

impl Seen {
    fn add(&mut self, weight: f64) {
        self.free += weight.max(0.0);
        self.all += weight.abs();
        self.count += f64::from(weight != 0.0);
    }
}

impl ShadowRays {
    /// The direct light of lamps and of other lights except those in `dark`, in multiples of `unit`, as `emission` is.
    /// `escaping` is the share of all light leaving patches that leaves the scene.
    pub(crate) fn irradiance<const C: usize>(
        &self,
        (emission, unit, dark): (&[[f64; C]], f64, &[String]),
        areas: &[f64],
        escaping: f64,
    ) -> DirectLight<C> {
        let sent = self.lamps.sent(emission, unit, dark);
        let of_kind = |remote: bool| self.arriving(&sent, areas.len(), remote);
        let (irradiance, deviations) = of_kind(false);
        let mut light = self.settled(irradiance, deviations, emission, areas, escaping);
        if self.lamps.has_remote() {
            let (irradiance, deviations) = of_kind(true);
            light.add(&irradiance, &deviations, areas);
        }
        light
    }

    /// Irradiance of all patches and the deviations of its replicates: from surfaces, or from other lights.
    fn arriving<const C: usize>(
        &self,
        sent: &[[f64; C]],
        patches: usize,
        remote: bool,
    ) -> (Vec<[f64; C]>, Vec<Deviation<C>>) {
        let scratch = || Scratch::new(self.lamps.count);
        (0..patches)
            .into_par_iter()
            .with_min_len(64)
            .map_init(scratch, |scratch, i| self.of_patch(i, sent, remote, scratch))
            .unzip()
    }

    /// The light of surfaces, with their power divided between arriving and escaping light.
    fn settled<const C: usize>(
        &self,
        mut irradiance: Vec<[f64; C]>,
        mut deviations: Vec<Deviation<C>>,
        emission: &[[f64; C]],
        areas: &[f64],
        escaping: f64,
    ) -> DirectLight<C> {
        let n = areas.len();
        let of_lamps = |i: usize| if self.lamps.contains(i) { emission[i] } else { [0.0; C] };
        let mut leaks = false;
        let mut escaped = [0.0; C];
        let mut escaped_deviations = [[0.0; REPLICATES]; C];
        for c in 0..C {
            let power = ordered_sum(n, |i| areas[i] * of_lamps(i)[c]);
            let arrived = ordered_sum(n, |i| areas[i] * irradiance[i][c]);
            for k in 0..REPLICATES {
                escaped_deviations[c][k] = -ordered_sum(n, |i| areas[i] * f64::from(deviations[i][c][k]));
            }
            let variance = |i: usize| (areas[i] * areas[i]) * variance_of(&deviations[i][c]);
            let variances = ordered_sum(n, variance);
            let slack = NOISE * variances.sqrt() + ROUNDING * power;
            // The power missing, and the best estimate of the escaping power from it and from all rays.
            let missing = power - arrived;
            let prior = (PRIOR * escaping * power).powi(2);
            let trust = if prior + variances > 0.0 { prior / (prior + variances) } else { 1.0 };
            let escapes = escaping * power + trust * (missing - escaping * power);
            if escaping == 0.0 && missing.abs() > slack {
                leaks = true;
                escaped[c] = missing;
                continue;
            }
            // Corrects the irradiance in proportion to its variances, and then all of it by a factor for the remaining
            // rounding.
            let more = missing - escapes;
            if variances > 0.0 && more != 0.0 {
                // Replicates that bring too much light would be corrected as well.
                let too_much = escaped_deviations[c].map(|escaped| (1.0 - trust) * escaped);
                let corrected = irradiance.par_iter_mut().zip(&mut deviations).enumerate();
                corrected.with_min_len(SHORT).for_each(|(i, (e, deviations))| {
                    let share = areas[i] * variance_of(&deviations[c]) / variances;
                    e[c] = (e[c] + more * share).max(0.0);
                    for k in 0..REPLICATES {
                        deviations[c][k] += (too_much[k] * share) as f32;
                    }
                });
            }
            let arrived = ordered_sum(n, |i| areas[i] * irradiance[i][c]);
            let factor = if arrived > 0.0 { (power - escapes) / arrived } else { 1.0 };
            if more != 0.0 && (factor - 1.0).abs() < 1e-2 {
                irradiance.iter_mut().for_each(|e| e[c] *= factor);
                deviations.iter_mut().flat_map(|d| &mut d[c]).for_each(|d| *d *= factor as f32);
            }
            escaped_deviations[c].iter_mut().for_each(|d| *d *= trust);
            let rest = power - ordered_sum(n, |i| areas[i] * irradiance[i][c]);
            // Ignores rounding errors.
            escaped[c] = if rest.abs() > n as f64 * f64::EPSILON * power { rest } else { 0.0 };
        }
        let (entered, entered_deviations) = ([0.0; C], [[0.0; REPLICATES]; C]);
        DirectLight {
            irradiance,
            deviations,
            entered,
            entered_deviations,
            escaped,
            escaped_deviations,
            leaks,
        }
    }

    /// The irradiance of patch `i` from surfaces or from other lights, and the deviations of its replicates.
    fn of_patch<const C: usize>(
        &self,
        i: usize,
        sent: &[[f64; C]],
        remote: bool,
        scratch: &mut Scratch,
    ) -> ([f64; C], Deviation<C>) {
        let rays = self.of(i);
        if rays.is_empty() {
            return ([0.0; C], [[0.0; REPLICATES]; C]);
        }
        // For each half, the control variate: the unblocked light of each lamp times its unblocked share.
        let mut controlled = [[0.0; C]; HALVES];
        if self.lamps.are_known() {
            scratch.look(self, i);
            let pieces = self.lamps.pieces.iter().zip(sent).zip(self.unoccluded(i));
            for ((piece, sent), f) in pieces.filter(|((piece, _), _)| piece.is_remote() == remote) {
                for half in 0..HALVES {
                    for c in 0..C {
                        controlled[half][c] += scratch.free[half][piece.lamp] * f * sent[c];
                    }
                }
            }
        }
        let mut parts = [[0f64; REPLICATES]; C];
        for k in 0..REPLICATES {
            let range = part(rays.len() as u32, k);
            let count = range.len() as f64;
            for s in range {
                let (ray, half) = (rays[s], s % HALVES);
                let piece = ray.piece();
                let counts = self.lamps.pieces[piece].is_remote() == remote;
                let free = scratch.free[half].get(self.lamps.pieces[piece].lamp).copied().unwrap_or(0.0);
                let weight = f64::from(ray.weight());
                let left = if counts { weight.max(0.0) - free * weight.abs() } else { 0.0 };
                for c in 0..C {
                    parts[c][k] += (left * sent[piece][c] + controlled[half][c]) / count;
                }
            }
        }
        let weights: [f64; REPLICATES] =
            std::array::from_fn(|k| part(rays.len() as u32, k).len() as f64 / rays.len() as f64);
        let mean: [f64; C] =
            std::array::from_fn(|c| parts[c].iter().zip(weights).map(|(part, weight)| weight * part).sum());
        let deviation = std::array::from_fn(|c| parts[c].map(|part| (part - mean[c]) as f32));
        (mean.map(|e| e.max(0.0)), deviation)
    }
}

impl<const C: usize> DirectLight<C> {
    /// Adds light that enters from outside the patches.
    pub(crate) fn add(&mut self, irradiance: &[[f64; C]], deviations: &[Deviation<C>], areas: &[f64]) {
        for (sum, more) in self.irradiance.iter_mut().zip(irradiance) {
            (0..C).for_each(|c| sum[c] += more[c]);
        }
        for (sum, more) in self.deviations.iter_mut().zip(deviations) {
            let values = sum.as_flattened_mut().iter_mut().zip(more.as_flattened());
            values.for_each(|(sum, more)| *sum += more);
        }
        for c in 0..C {
            self.entered[c] += ordered_sum(areas.len(), |i| areas[i] * irradiance[i][c]);
            for k in 0..REPLICATES {
                self.entered_deviations[c][k] +=
                    ordered_sum(areas.len(), |i| areas[i] * f64::from(deviations[i][c][k]));
            }
        }
    }
}

/// Unblocked shares of each lamp's light, for use with one half of the samples and estimated from the other.
pub(super) struct Scratch {
    seen: [Vec<Seen>; HALVES],
    pub(super) free: [Vec<f64>; HALVES],
}

impl Scratch {
    pub(super) fn new(lamps: usize) -> Scratch {
        let each = || vec![Seen::default(); lamps];
        Scratch { seen: [each(), each()], free: [vec![0.0; lamps], vec![0.0; lamps]] }
    }

    pub(super) fn look(&mut self, rays: &ShadowRays, i: usize) {
        let mut whole = [Seen::default(); HALVES];
        self.seen.iter_mut().for_each(|seen| seen.fill(Seen::default()));
        for (s, ray) in rays.of(i).iter().enumerate() {
            let (half, piece) = (s % HALVES, &rays.lamps.pieces[ray.piece()]);
            let weight = f64::from(ray.weight()) * piece.brightness;
            self.seen[half][piece.lamp].add(weight);
            whole[half].add(weight);
        }
        // Expected number of samples of each lamp in a half.
        let mut expected = vec![0.0; self.free[0].len()];
        let shares = rays.lamps.shares(rays.unoccluded(i)).unwrap_or_default();
        for (piece, share) in rays.lamps.pieces.iter().zip(shares) {
            expected[piece.lamp] += 0.5 * rays.of(i).len() as f64 * share;
        }
        for half in 0..HALVES {
            let other = 1 - half;
            // Without samples in the other half, the own half is used instead.
            let of = if whole[other].all > 0.0 { whole[other] } else { whole[half] };
            let shared = if of.all > 0.0 { of.free / of.all } else { 0.0 };
            for lamp in 0..expected.len() {
                let (others, own) = (self.seen[other][lamp], self.seen[half][lamp]);
                let seen = if others.count == 0.0 && expected[lamp] >= 1.0 { own } else { others };
                let prior = if seen.count > 0.0 { Constants::SHARED * seen.all / seen.count } else { 1.0 };
                // A lamp with many samples needs no estimate from other lamps.
                let prior = if expected[lamp] >= Constants::MANY { 0.0 } else { prior };
                self.free[half][lamp] = if seen.all + prior > 0.0 {
                    (seen.free + prior * shared) / (seen.all + prior)
                } else {
                    shared
                };
            }
            // Lights without known unblocked irradiance get no control variate.
            for piece in rays.lamps.pieces.iter().filter(|piece| !piece.is_known()) {
                self.free[half][piece.lamp] = 0.0;
            }
        }
    }
}

/// Variance of the mean, from deviations that sum to zero up to rounding.
fn variance_of(deviations: &[f32; REPLICATES]) -> f64 {
    let count = REPLICATES as f64;
    let squares: f64 = deviations.iter().map(|&d| f64::from(d).powi(2)).sum();
    squares / (count * (count - 1.0))
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, dvec3};

    use super::super::Lamps;
    use super::*;
    use crate::{
        Progress,
        exact::{point_to_polygon, polygon_form_factor},
        patch::{Patches, Subdivision},
        rays::RaySet,
        scene::{Material, Scene},
        trace::Tracer,
    };

    fn quad([a, b, c, d]: [DVec3; 4], material: u32) -> [([DVec3; 3], u32); 2] {
        [([a, b, c], material), ([a, c, d], material)]
    }

    /// A horizontal square around the z axis, counterclockwise seen from above.
    fn square(half: f64, z: f64) -> [DVec3; 4] {
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| dvec3(half * x, half * y, z))
    }

    fn down(square: [DVec3; 4]) -> [DVec3; 4] {
        let [a, b, c, d] = square;
        [a, d, c, b]
    }

    /// Dark triangles (material 0) and triangles that emit (material 1). Each is a patch.
    struct Lit {
        scene: Scene,
        tracer: Tracer,
        patches: Patches,
    }

    impl Lit {
        fn new(triangles: &[([DVec3; 3], u32)]) -> Lit {
            let materials =
                vec![Material::new("dark", [0.0; 3], [0.0; 3]), Material::new("lamp", [0.0; 3], [1.0; 3])];
            let scene = Scene::new(triangles, materials);
            let patches = Patches::subdivide(&scene, &Subdivision::Edge(f64::INFINITY));
            Lit { tracer: Tracer::new(&scene), patches, scene }
        }

        /// The direct light of all patches with this number of shadow rays.
        fn direct(&self, rays: u32, seed: u64) -> DirectLight<1> {
            let (tracer, patches) = (&self.tracer, &self.patches);
            let mut shadow = ShadowRays::none(Lamps::new(tracer, patches, &self.scene.lights, |_| true));
            shadow.extend(tracer, patches, |_| rays, seed, &RaySet::none(), &Progress::new()).unwrap();
            let areas: Vec<f64> = (0..patches.len()).map(|i| patches.area(i)).collect();
            shadow.irradiance((patches.emission().as_chunks().0, 1.0, &[]), &areas, 1.0)
        }
    }

    /// If nothing is between a patch and a lamp, the result is the closed form without error for any number of rays:
    /// far, near, and when the lamp crosses the patch's plane.
    #[test]
    fn what_nothing_blocks_is_exact() {
        let lamp = quad(down(square(1.0, 1.0)), 1);
        for (corners, z) in [(square(0.5, 0.0), 0.0), (square(1.0, 0.97), 0.97), (square(3.0, -20.0), -20.0)]
        {
            let patch = [corners[0], corners[1], corners[2]];
            let direct = Lit::new(&[&[(patch, 0)], &lamp[..]].concat()).direct(16, 3);
            let wanted = std::f64::consts::PI * polygon_form_factor(&patch, &down(square(1.0, 1.0)));
            let found = direct.irradiance[0][0];
            assert!((found / wanted - 1.0).abs() < 2e-6, "{z}: {found} for {wanted}");
            assert!(direct.deviations[0][0].iter().all(|d| f64::from(d.abs()) < 1e-5 * wanted), "{z}");
        }
    }

    /// A patch sees from a half to a two-hundredth of a lamp through a hole. For any number of rays, the mean over many
    /// seeds is the light of the visible part, within its standard error.
    #[test]
    fn light_through_holes_has_no_bias() {
        let (half, z) = (0.01, 0.5);
        let floor = [dvec3(-half, -half, 0.0), dvec3(half, -half, 0.0), dvec3(0.0, half, 0.0)];
        let lamp = square(1.0, 1.0);
        for (hole, rays, seeds) in [(0.35, 16, 200), (0.1, 16, 500), (0.03, 16, 1500), (0.03, 64, 400)] {
            // Four strips around the hole.
            let strip = |a: f64, b: f64, c: f64, d: f64| {
                quad([dvec3(a, c, z), dvec3(b, c, z), dvec3(b, d, z), dvec3(a, d, z)], 0)
            };
            let far = 5.0;
            let strips = [
                strip(-far, -hole, -far, far),
                strip(hole, far, -far, far),
                strip(-hole, hole, -far, -hole),
                strip(-hole, hole, hole, far),
            ];
            let parts = [&[(floor, 0)], &quad(down(lamp), 1)[..], &strips.concat()[..]].concat();
            let scene = Lit::new(&parts);
            let found: Vec<f64> = (0..seeds).map(|seed| scene.direct(rays, seed).irradiance[0][0]).collect();
            // The visible part of the lamp is twice as wide as the hole from everywhere on the small patch.
            let seen = square((2.0 * hole).min(1.0), 1.0);
            let middle = (floor[0] + floor[1] + floor[2]) / 3.0;
            let wanted = std::f64::consts::PI * point_to_polygon(middle, DVec3::Z, &seen);
            let count = seeds as f64;
            let mean = found.iter().sum::<f64>() / count;
            let error =
                (found.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (count * (count - 1.0))).sqrt();
            assert!(
                (mean - wanted).abs() < 4.0 * error + 1e-3 * wanted,
                "{hole}: {mean} for {wanted} ± {error}"
            );
            assert!(error < 0.2 * wanted, "{hole}: {mean} ± {error}");
        }
    }

    /// The mean sample weight equals the known unblocked light, even if the lamp's plane cuts the patch or the patch's
    /// plane cuts the lamp.
    #[test]
    fn the_mean_of_samples_is_the_unblocked_light() {
        let lamp = [dvec3(0.0, 0.0, 1.0), dvec3(0.0, 1.0, 1.0), dvec3(1.0, 0.0, 1.0)];
        for patch in [
            [dvec3(0.2, 0.2, 0.9), dvec3(0.5, 0.2, 0.9), dvec3(0.2, 0.5, 0.9)],
            [dvec3(-0.1, 0.0, 0.0), dvec3(-0.1, 1.0, 0.5), dvec3(-0.1, 0.0, 9.0)],
            [dvec3(0.4, -2.0, 0.0), dvec3(0.4, 2.0, 0.0), dvec3(0.4, 0.0, 1.5)],
        ] {
            let materials =
                vec![Material::new("dark", [0.0; 3], [0.0; 3]), Material::new("lamp", [0.0; 3], [1.0; 3])];
            let scene = Scene::new(&[(patch, 0), (lamp, 1)], materials);
            let (tracer, patches) =
                (Tracer::new(&scene), Patches::subdivide(&scene, &Subdivision::Edge(f64::INFINITY)));
            let mut shadow = ShadowRays::none(Lamps::new(&tracer, &patches, &scene.lights, |_| true));
            shadow.extend(&tracer, &patches, |_| 1 << 14, 5, &RaySet::none(), &Progress::new()).unwrap();
            let mean = shadow.of(0).iter().map(|ray| f64::from(ray.weight().abs())).sum::<f64>()
                / f64::from(1 << 14);
            let known = shadow.unoccluded(0)[0];
            assert!((mean / known - 1.0).abs() < 3e-3, "{patch:?}: {mean} for {known}");
        }
    }
}
