//! Irradiance of texels by a final gather: rays from points spread over the covered part of each texel.
//!
//! A sample is a point, a shadow ray to a point of a lamp, and a hemisphere ray. Where this ray hits, direct light is
//! sampled in the same way, and the light that surfaces have reflected is read from the solution. Points are uniform on
//! the pieces of surface in the texel. Rays start on the point's own triangle, so nothing is interpolated across a wall.
//!
//! Points inside a solid are buried and do not count: the mean is over the part of the surface that light can reach. A
//! point is buried if rays from it hit nothing but backs of faces, and no random walk from it finds light or a way out
//! of the scene. The walks are needed because a house of single faces whose fronts face outward is not a solid: light
//! comes in through its windows. Separate rays make this decision, not the rays that are averaged. Dropping averaged
//! rays because they are dark made a floor under a shell with a narrow gap 56 times too bright.

use glam::DVec3;
use rayon::prelude::*;

use super::{atlas::Atlas, coverage::Coverage};
use crate::{
    Progress, Result,
    monte_carlo::{Receiver, Samples},
    output::final_gather::{FinalGather, Gathered},
    scene::in_triangle,
    trace::{
        Hit, Tracer,
        sampling::{mix, square_to_triangle},
    },
};

/// Replicates of each texel: independent groups of its samples, for its standard error.
const REPLICATES: u32 = 4;
/// Rays that decide whether a point is inside a solid, if some ray of its texel suggests it.
const PROBES: u32 = 16;
/// Random walks that look for light from a point that seems to be inside a solid, in [`Gatherer::hidden`]. [`Gatherer::gather`] does one
/// walk per sample.
const WALKS: u32 = 4;
/// Most hits of a walk.
const STEPS: u32 = 16;
/// Points per texel in [`Gatherer::hidden`]. All must be inside a solid for the texel to be hidden.
const HIDDEN_POINTS: u32 = 4;
const PROBE_SEED: u64 = 0x6275_7269_6564;

/// Mean of a texel and the variance of that mean, per channel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Noisy {
    /// Mean irradiance, W/m².
    pub mean: [f32; 3],
    /// Squared standard error of the mean.
    pub variance: [f32; 3],
    /// Half the difference between the means of the first and the last half of the replicates. Its expectation is 0, and
    /// its variance is that of the mean.
    pub half: [f32; 3],
}

/// The gathered irradiance of a texel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Texel {
    /// Light straight from emitters: it has sharp edges and little noise.
    pub direct: Noisy,
    /// Reflected light: smooth and noisy.
    pub reflected: Noisy,
    /// Share of the samples that are not inside a solid.
    pub open: f32,
}

/// The surface of a map, and the light that reaches it.
#[derive(Clone, Copy)]
pub struct Gatherer<'a> {
    pub atlas: &'a Atlas,
    pub coverage: &'a Coverage,
    pub tracer: &'a Tracer,
    /// For each facet, whether the map shows the front of its triangle there.
    pub sides: &'a [bool],
    pub source: &'a FinalGather<'a>,
}

impl Gatherer<'_> {
    /// Gathers irradiance for the given covered texels, with `rays` hemisphere rays and as many shadow rays per texel,
    /// rounded up to a multiple of [`REPLICATES`].
    ///
    /// The random numbers depend only on the seed and the texel's place.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped).
    pub fn gather(
        &self,
        texels: &[u32],
        (rays, seed): (u32, u64),
        progress: &Progress,
    ) -> Result<Vec<Texel>> {
        let each = rays.div_ceil(REPLICATES).max(1);
        progress.begin("final gather", texels.len() as u64 * u64::from(each * REPLICATES));
        texels
            .par_iter()
            .with_min_len(super::texels::STRETCH)
            .map_init(Default::default, |scratch, &i| {
                progress.check()?;
                let found = self.texel(i as usize, (each, seed), scratch);
                progress.advance(u64::from(each * REPLICATES));
                Ok(found)
            })
            .collect()
    }

    fn texel(
        &self,
        i: usize,
        (each, seed): (u32, u64),
        (parts, gathered): &mut (Vec<Part>, Vec<Sample>),
    ) -> Texel {
        let surface = Surface::new(parts, self.atlas, self.coverage, i);
        let (tile, number) = tile(self.atlas, self.coverage.texels()[i]);
        let tile_seed = mix(&[seed, tile]);
        if surface.0.is_empty() {
            return Texel::default();
        }
        gathered.clear();
        for k in 0..REPLICATES {
            let seed = mix(&[tile_seed, k.into()]);
            for s in number * each..(number + 1) * each {
                let mut samples = Samples::new(s, seed);
                let at = surface.receiver(self.tracer, self.sides, &mut samples);
                let found = self.source.gather(at, &mut samples);
                let seed = mix(&[seed, s.into(), PROBE_SEED]);
                gathered.push(Sample { replicate: k as usize, at, seed, found });
            }
        }
        let buried = buried(self.source, self.tracer, gathered);
        let mut replicates = [Replicate::default(); REPLICATES as usize];
        for (sample, buried) in gathered.iter().zip(buried) {
            if !buried {
                replicates[sample.replicate].add(&sample.found);
            }
        }
        texel(&replicates, each)
    }

    /// For each covered texel, whether its surface is all inside a solid, as tested by [`HIDDEN_POINTS`] points.
    pub fn hidden(&self, seed: u64) -> Vec<bool> {
        (0..self.coverage.len())
            .into_par_iter()
            .with_min_len(super::texels::STRETCH)
            .map_init(Vec::new, |parts, i| {
                let surface = Surface::new(parts, self.atlas, self.coverage, i);
                let seed = mix(&[seed, u64::from(self.coverage.texels()[i])]);
                !surface.0.is_empty()
                    && (0..HIDDEN_POINTS).all(|s| {
                        let mut samples = Samples::new(s, seed);
                        let at = surface.receiver(self.tracer, self.sides, &mut samples);
                        let (_, hit) = self.source.direct(at, &mut samples);
                        met_back(hit.as_ref())
                            && is_buried(self.source, self.tracer, at, mix(&[seed, s.into(), PROBE_SEED]))
                    })
            })
            .collect()
    }
}

/// The tile of 8 x 8 texels that a texel lies in, and the texel's index in the tile, in Morton order.
///
/// The texels of a tile share one low-discrepancy sequence, and each takes a stretch of it. The samples of each texel
/// are well spread, and so are the samples of 2 x 2 or 4 x 4 texels together. So averaging over neighbours reduces
/// noise faster than with independent samples.
fn tile(atlas: &Atlas, texel: u32) -> (u64, u32) {
    let (x, row) = (texel % atlas.width as u32, texel / atlas.width as u32);
    let bits = |a: u32| (a & 1) | (a & 2) << 1 | (a & 4) << 2;
    (u64::from(row >> 3) << 32 | u64::from(x >> 3), bits(x) | bits(row) << 1)
}

/// Whether the hemisphere ray hit the back of a face.
fn met_back(hit: Option<&Hit>) -> bool {
    hit.is_some_and(|hit| !hit.front)
}

/// A sample of a texel.
struct Sample {
    replicate: usize,
    at: Receiver,
    /// Seed of the rays that decide whether the point is inside a solid.
    seed: u64,
    found: Gathered,
}

/// For each sample of a texel, whether its point is inside a solid. The points that seem to be inside are most likely
/// in one region, so if a walk from one of them finds light, none is inside a solid.
fn buried(source: &FinalGather, tracer: &Tracer, samples: &[Sample]) -> Vec<bool> {
    if !samples.iter().any(|sample| met_back(sample.found.hit.as_ref())) {
        return vec![false; samples.len()];
    }
    let inside: Vec<bool> = samples.iter().map(|s| seems_inside(source, s.at, s.seed)).collect();
    let mut there = samples.iter().zip(&inside).filter(|(_, inside)| **inside).map(|(sample, _)| sample);
    match there.all(|s| is_dark(source, tracer, s.at, (PROBES, s.seed))) {
        true => inside,
        false => vec![false; samples.len()],
    }
}

/// Whether a point seems to be inside a solid: all hemisphere rays but at most one hit backs of faces, and no emitter
/// shines on the point. The backs need not be dark, because patches that reach under a wall carry some light there.
fn seems_inside(source: &FinalGather, at: Receiver, seed: u64) -> bool {
    let is_inside = |s: &u32| {
        let (direct, hit) = source.direct(at, &mut Samples::new(*s, seed));
        direct == [0.0; 3] && met_back(hit.as_ref())
    };
    let inside = (0..PROBES).filter(is_inside).count();
    inside + 1 >= PROBES as usize
}

/// Whether a point is inside a solid: it seems to be, and random walks from it find neither a point that an emitter
/// shines on nor a way out of the scene.
fn is_buried(source: &FinalGather, tracer: &Tracer, at: Receiver, seed: u64) -> bool {
    seems_inside(source, at, seed)
        && (0..WALKS).all(|walk| is_dark(source, tracer, at, (PROBES + walk, seed)))
}

/// Whether a random walk of [`STEPS`] hits finds neither direct light nor a way out of the scene.
fn is_dark(source: &FinalGather, tracer: &Tracer, mut at: Receiver, (walk, seed): (u32, u64)) -> bool {
    let mut samples = Samples::new(walk, seed);
    for _ in 0..STEPS {
        match source.direct(at, &mut samples) {
            ([0.0, 0.0, 0.0], Some(hit)) => at = Receiver::of_hit(tracer, &hit),
            _ => return false,
        }
    }
    true
}

/// The surface in a texel as triangular parts. Each has the cumulative area up to and including it, its facet and
/// triangle, and the barycentric coordinates of its corners.
struct Surface<'a>(&'a [Part]);

type Part = (f64, [u32; 2], [[f64; 3]; 3]);

impl<'a> Surface<'a> {
    fn new(parts: &'a mut Vec<Part>, atlas: &Atlas, coverage: &Coverage, i: usize) -> Surface<'a> {
        parts.clear();
        let mut sum = 0.0;
        for piece in coverage.pieces(i) {
            let t = piece.triangle as usize;
            let part = coverage.barycentric_part(atlas, i, t).in_triangle(atlas, t);
            let whole: f64 = part.fan().map(|(_, share)| share).sum();
            for (corners, share) in part.fan().filter(|(_, share)| *share > 0.0) {
                sum += piece.area * share / whole;
                parts.push((sum, [piece.triangle, atlas.triangle(t) as u32], corners));
            }
        }
        Surface(parts)
    }

    /// A uniformly distributed point of the surface.
    fn receiver(&self, tracer: &Tracer, sides: &[bool], samples: &mut Samples) -> Receiver {
        let [x, y] = samples.square();
        let total = self.0.last().map_or(0.0, |part| part.0);
        let wanted = f64::from(x) * total;
        let k = self.0.partition_point(|part| part.0 <= wanted).min(self.0.len() - 1);
        let below = if k == 0 { 0.0 } else { self.0[k - 1].0 };
        let (upto, [facet, triangle], corners) = self.0[k];
        // The remainder of the number that chose the part is uniform again.
        let rest = ((wanted - below) / (upto - below)).clamp(0.0, 1.0) as f32;
        let weights = square_to_triangle(rest, y).map(f64::from);
        let barycentric = in_triangle(weights, &corners);
        Receiver::on_triangle(tracer, triangle as usize, barycentric, sides[facet as usize])
    }
}

/// Sums over the samples of a replicate that are not inside a solid.
#[derive(Clone, Copy, Default)]
struct Replicate {
    direct: DVec3,
    reflected: DVec3,
    count: u32,
}

impl Replicate {
    fn add(&mut self, found: &Gathered) {
        self.direct += DVec3::from(found.direct);
        self.reflected += DVec3::from(found.reflected);
        self.count += 1;
    }
}

/// Pools the replicates: the mean of all samples that count, and its variance from the spread of the replicates.
fn texel(replicates: &[Replicate], each: u32) -> Texel {
    // A single replicate gives no estimate of its error.
    if replicates.iter().filter(|r| r.count > 0).count() < 2 {
        return Texel::default();
    }
    let count: u32 = replicates.iter().map(|r| r.count).sum();
    let noisy = |part: fn(&Replicate) -> DVec3| {
        let n = f64::from(count);
        let mean = replicates.iter().map(part).sum::<DVec3>() / n;
        // First-order variance of a ratio estimator: both the sum and the count vary from replicate to replicate.
        let k = replicates.len() as f64;
        let deviation = |r: &Replicate| part(r) - mean * f64::from(r.count);
        let squares: DVec3 = replicates.iter().map(|r| deviation(r) * deviation(r)).sum();
        let variance = squares * (k / (k - 1.0)) / (n * n);
        let [first, last] = [0, 1].map(|half| {
            let of_half = replicates.iter().skip(half * replicates.len() / 2).take(replicates.len() / 2);
            of_half.map(deviation).sum::<DVec3>()
        });
        let [mean, variance, half] =
            [mean, variance, (first - last) / n].map(|values| values.as_vec3().to_array());
        Noisy { mean, variance, half }
    };
    Texel {
        direct: noisy(|r| r.direct),
        reflected: noisy(|r| r.reflected),
        open: (f64::from(count) / (f64::from(each) * replicates.len() as f64)) as f32,
    }
}
