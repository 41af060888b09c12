//! Irradiance of texels by a final gather: rays from points spread over the covered part of each texel.
//!
//! A sample is a point, a ray to a point of a lamp, and a hemisphere ray that reads the solved radiosity where it hits.
//! Points are uniform on the pieces of surface that the texel covers, so each starts on its own triangle and sees from
//! there what it sees: nothing is interpolated across a wall. Points inside a solid are buried in it and do not count: the mean
//! is over the part of the surface that light can reach. A point is inside a solid where rays meet nothing but backs of faces,
//! and where no walk from there finds light or a way out: a house of single faces whose fronts face outward is no solid, for
//! light comes in by its windows. Other rays decide that than those that are averaged: dropping these where they are dark made a
//! floor under a shell with a narrow gap 56 times too bright.

use glam::DVec3;
use rayon::prelude::*;

use super::{atlas::Atlas, coverage::Coverage};
use crate::{
    Progress, Result,
    monte_carlo::{Receiver, Samples},
    output::final_gather::{FinalGather, Gathered},
    trace::{
        Tracer,
        sampling::{mix, square_to_triangle},
    },
};

/// Independent parts of the samples of a texel, for its standard error.
const REPLICATES: u32 = 4;
/// Rays that decide whether a point is inside a solid, where some ray of its texel suggests it.
const PROBES: u32 = 16;
/// Walks that look for light from a point that seems to be inside a solid where nothing is gathered; else one a sample. And
/// the hits of each.
const WALKS: u32 = 4;
const STEPS: u32 = 16;
/// Points of a texel that all must be inside a solid for it to be hidden, where nothing is gathered.
const HIDDEN_POINTS: u32 = 4;
const PROBE_SEED: u64 = 0x6275_7269_6564;

/// Mean and variance of that mean, a texel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Noisy {
    /// W/m².
    pub mean: [f32; 3],
    /// Squared standard error of the mean.
    pub variance: [f32; 3],
}

/// What was gathered for a texel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Texel {
    /// Straight from emitters: sharp, hardly noisy.
    pub direct: Noisy,
    /// Reflected: smooth, noisy.
    pub reflected: Noisy,
    /// Share of the covered part that is not buried in a solid.
    pub open: f32,
}

/// Gathers for every covered texel, `rays` hemisphere rays and as many to lamps each, rounded up to a multiple of 4.
///
/// Numbers depend on the seed and the texel's place alone.
///
/// # Errors
/// [`Error::Stopped`](crate::Error::Stopped).
pub fn gather(
    atlas: &Atlas,
    coverage: &Coverage,
    tracer: &Tracer,
    sides: &[bool],
    source: &FinalGather,
    (rays, seed): (u32, u64),
    progress: &Progress,
) -> Result<Vec<Texel>> {
    let each = rays.div_ceil(REPLICATES).max(1);
    progress.begin("final gather", coverage.len() as u64 * u64::from(each * REPLICATES));
    (0..coverage.len())
        .into_par_iter()
        .with_min_len(super::texels::STRETCH)
        .map_init(Default::default, |(parts, gathered): &mut (Vec<_>, Vec<Sample>), i| {
            progress.check()?;
            let surface = Surface::new(parts, atlas, coverage, i);
            let (tile, number) = tile(atlas, coverage.texels()[i]);
            let tile_seed = mix(&[seed, tile]);
            if surface.0.is_empty() {
                return Ok(Texel::default());
            }
            gathered.clear();
            for k in 0..REPLICATES {
                let seed = mix(&[tile_seed, k.into()]);
                for s in number * each..(number + 1) * each {
                    let mut samples = Samples::new(s, seed);
                    let at = surface.receiver(tracer, sides, &mut samples);
                    let found = source.gather(at, &mut samples);
                    let seed = mix(&[seed, s.into(), PROBE_SEED]);
                    gathered.push(Sample { replicate: k as usize, at, seed, found });
                }
            }
            let buried = buried(source, tracer, gathered);
            let mut replicates = [Replicate::default(); REPLICATES as usize];
            for (sample, buried) in gathered.iter().zip(buried) {
                if !buried {
                    replicates[sample.replicate].add(&sample.found);
                }
            }
            progress.advance(u64::from(each * REPLICATES));
            Ok(texel(&replicates, each))
        })
        .collect()
}

/// The tile of 8 x 8 texels that a texel lies in, and its number there, in Morton's order.
///
/// The texels of a tile take turns with one sequence of samples. The samples of each are well spread by themselves, and
/// so are those of any 2 x 2 or 4 x 4 of them together: averaged over neighbours, noise falls faster than with
/// independent samples.
fn tile(atlas: &Atlas, texel: u32) -> (u64, u32) {
    let (x, row) = (texel % atlas.width as u32, texel / atlas.width as u32);
    let bits = |a: u32| (a & 1) | (a & 2) << 1 | (a & 4) << 2;
    (u64::from(row >> 3) << 32 | u64::from(x >> 3), bits(x) | bits(row) << 1)
}

/// Which covered texels are inside solids altogether, as far as a few points of each tell.
pub fn hidden(
    atlas: &Atlas,
    coverage: &Coverage,
    tracer: &Tracer,
    sides: &[bool],
    source: &FinalGather,
    seed: u64,
) -> Vec<bool> {
    (0..coverage.len())
        .into_par_iter()
        .with_min_len(super::texels::STRETCH)
        .map_init(Vec::new, |parts, i| {
            let surface = Surface::new(parts, atlas, coverage, i);
            let seed = mix(&[seed, u64::from(coverage.texels()[i])]);
            !surface.0.is_empty()
                && (0..HIDDEN_POINTS).all(|s| {
                    let mut samples = Samples::new(s, seed);
                    let at = surface.receiver(tracer, sides, &mut samples);
                    let found = source.gather(at, &mut samples);
                    met_back(&found) && is_buried(source, tracer, at, mix(&[seed, s.into(), PROBE_SEED]))
                })
        })
        .collect()
}

/// Whether a ray met the back of a face.
fn met_back(found: &Gathered) -> bool {
    found.hit.is_some_and(|hit| !hit.front)
}

/// A sample of a texel.
struct Sample {
    replicate: usize,
    at: Receiver,
    /// For the rays that look whether it is inside a solid.
    seed: u64,
    found: Gathered,
}

/// Which samples of a texel are inside a solid. Those that seem to be are in one region, most likely: if light is found from
/// one of them, none is inside a solid.
fn buried(source: &FinalGather, tracer: &Tracer, samples: &[Sample]) -> Vec<bool> {
    if !samples.iter().any(|sample| met_back(&sample.found)) {
        return vec![false; samples.len()];
    }
    let inside: Vec<bool> = samples.iter().map(|s| seems_inside(source, s.at, s.seed)).collect();
    let mut there = samples.iter().zip(&inside).filter(|(_, inside)| **inside).map(|(sample, _)| sample);
    match there.all(|s| is_dark(source, tracer, s.at, (PROBES, s.seed))) {
        true => inside,
        false => vec![false; samples.len()],
    }
}

/// Whether a place seems to be inside a solid: rays meet backs, next to all of them, and no emitter shines on it. That the
/// backs be dark is not asked for: patches that reach under a wall carry some light there.
fn seems_inside(source: &FinalGather, at: Receiver, seed: u64) -> bool {
    let is_inside = |found: &Gathered| found.direct == [0.0; 3] && met_back(found);
    let inside = (0..PROBES).filter(|&s| is_inside(&source.gather(at, &mut Samples::new(s, seed)))).count();
    inside + 1 >= PROBES as usize
}

/// Whether a place is inside a solid: it seems so, and walks from there, from hit to hit, find neither a point that an emitter
/// shines on nor a way out of the scene.
fn is_buried(source: &FinalGather, tracer: &Tracer, at: Receiver, seed: u64) -> bool {
    seems_inside(source, at, seed)
        && (0..WALKS).all(|walk| is_dark(source, tracer, at, (PROBES + walk, seed)))
}

/// Whether a walk from a place finds no light within its steps.
fn is_dark(source: &FinalGather, tracer: &Tracer, mut at: Receiver, (walk, seed): (u32, u64)) -> bool {
    let mut samples = Samples::new(walk, seed);
    for _ in 0..STEPS {
        let found = source.gather(at, &mut samples);
        match found.hit {
            Some(hit) if found.direct == [0.0; 3] => at = Receiver::of_hit(tracer, &hit),
            _ => return false,
        }
    }
    true
}

/// The surface in a texel as parts of triangles, each with the sum of the areas up to it, its facet and its triangle.
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

    /// A uniform point of the surface.
    fn receiver(&self, tracer: &Tracer, sides: &[bool], samples: &mut Samples) -> Receiver {
        let [x, y] = samples.square();
        let total = self.0.last().map_or(0.0, |part| part.0);
        let wanted = f64::from(x) * total;
        let k = self.0.partition_point(|part| part.0 <= wanted).min(self.0.len() - 1);
        let below = if k == 0 { 0.0 } else { self.0[k - 1].0 };
        let (upto, [facet, triangle], corners) = self.0[k];
        // What is left of the number that chose the part is uniform again.
        let rest = ((wanted - below) / (upto - below)).clamp(0.0, 1.0) as f32;
        let weights = square_to_triangle(rest, y).map(f64::from);
        let barycentric = std::array::from_fn(|c| (0..3).map(|k| weights[k] * corners[k][c]).sum());
        Receiver::on_triangle(tracer, triangle as usize, barycentric, sides[facet as usize])
    }
}

/// Sums of the samples that count.
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

/// Pools the replicates: the mean of all samples that count, and its variance by their spread.
fn texel(replicates: &[Replicate], each: u32) -> Texel {
    // One part alone does not tell its error.
    if replicates.iter().filter(|r| r.count > 0).count() < 2 {
        return Texel::default();
    }
    let count: u32 = replicates.iter().map(|r| r.count).sum();
    let noisy = |part: fn(&Replicate) -> DVec3| {
        let n = f64::from(count);
        let mean = replicates.iter().map(part).sum::<DVec3>() / n;
        // The variance of a ratio of sums, to first order.
        let k = replicates.len() as f64;
        let squares: DVec3 = replicates
            .iter()
            .map(|r| part(r) - mean * f64::from(r.count))
            .map(|deviation| deviation * deviation)
            .sum();
        let variance = squares * (k / (k - 1.0)) / (n * n);
        Noisy { mean: mean.as_vec3().to_array(), variance: variance.as_vec3().to_array() }
    };
    Texel {
        direct: noisy(|r| r.direct),
        reflected: noisy(|r| r.reflected),
        open: (f64::from(count) / (f64::from(each) * replicates.len() as f64)) as f32,
    }
}
