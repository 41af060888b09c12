//! Sums over the rays of every replicate, patch by patch.

use rayon::prelude::*;

use super::{
    super::{Estimator, SHORT, calibration, pooling::Buckets},
    Samples,
};
use crate::{
    rays::{ESCAPED, REPLICATES, RaySet},
    symmetric::blocks::Blocks,
};

/// Most patches of a block whose sums are made together: a megabyte of sums with random access.
const MOST_ROWS: usize = 1 << 12;
/// Fewest patches of a block: smaller ones are not worth a task.
const LEAST_ROWS: usize = 1 << 7;

/// The calibration's weight of own rays, in single precision.
const TRUST: f32 = calibration::TRUST as f32;

/// The rays that contribute to the sums of a patch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum WhichRays {
    /// Own and arriving rays, weighted as in the matrix.
    All,
    /// Own rays only, which are nearly as good for distributing rays.
    Own,
}

/// Exchange area and exchanged power, side by side because each ray adds to both in a random row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Exchange<const C: usize> {
    pub(super) area: f32,
    pub(super) power: [f32; C],
}

/// Sums over each replicate for a patch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sums<const C: usize> {
    pub(super) landed: [Exchange<C>; REPLICATES],
    /// Shares of the rays that escaped.
    pub(super) escaped: [f32; REPLICATES],
}

impl<const C: usize> Sums<C> {
    const ZERO: Self = Sums { landed: [Exchange::ZERO; REPLICATES], escaped: [0.0; REPLICATES] };
}

impl<const C: usize> Exchange<C> {
    const ZERO: Self = Exchange { area: 0.0, power: [0.0; C] };

    #[inline]
    fn add(&mut self, area: f32, radiosity: &[f32; C]) {
        self.area += area;
        for c in 0..C {
            self.power[c] += area * radiosity[c];
        }
    }
}

/// The data of a patch that a ray reads when it hits it, in one place because accesses are random.
#[derive(Debug, Clone, Copy)]
struct Seen<const C: usize> {
    radiosity: [f32; C],
    /// Number of its rays per area.
    density: f32,
}

/// Rays by the blocks of patches where they start and land.
struct Incoming {
    /// Arriving rays, if they are counted.
    buckets: Option<Buckets>,
    /// For each replicate and patch, the number of all its rays over the number in the replicate.
    ratios: Vec<Vec<f32>>,
}

impl Incoming {
    fn new(rays: &RaySet, blocks: Blocks, which: WhichRays) -> Incoming {
        let buckets = (which == WhichRays::All).then(|| Buckets::by_replicates(rays, blocks));
        let ratios = |replicate: usize| {
            let ratio = |i| rays.rays_of(i) as f32 / rays.of_replicate(i, replicate).len() as f32;
            (0..rays.len()).map(ratio).collect()
        };
        Incoming { buckets, ratios: (0..REPLICATES).into_par_iter().map(ratios).collect() }
    }
}

/// Sums the rays for a given radiosity.
pub(super) struct Counted<'a, const C: usize> {
    samples: &'a Samples,
    /// Patches whose sums are made together.
    pub(super) blocks: Blocks,
    /// Present for pooled form factors.
    incoming: Option<Incoming>,
    seen: Vec<Seen<C>>,
}

impl<'a, const C: usize> Counted<'a, C> {
    pub(super) fn new(samples: &'a Samples, radiosity: &[[f32; C]], which: WhichRays) -> Self {
        let blocks = Blocks::of_rows(samples.areas.len(), LEAST_ROWS, MOST_ROWS);
        let blocks = blocks.among(samples.options.ranks);
        let pooled = samples.options.estimator == Estimator::Pooled;
        let density = |i: usize| (f64::from(samples.rays.rays_of(i)) / samples.areas[i]) as f32;
        let seen = |(i, &radiosity)| Seen { radiosity, density: density(i) };
        Counted {
            samples,
            blocks,
            incoming: pooled.then(|| Incoming::new(&samples.rays, blocks, which)),
            seen: radiosity.par_iter().enumerate().with_min_len(SHORT).map(seen).collect(),
        }
    }

    /// Sums for the patches of a block.
    pub(super) fn sum(&self, block: usize, sums: &mut Vec<Sums<C>>) {
        sums.clear();
        sums.resize(self.blocks.range(block).len(), Sums::ZERO);
        let Some(incoming) = &self.incoming else {
            self.one_way(block, sums);
            return;
        };
        let resistance = |i: usize| calibration::RESISTANCE as f32 / self.samples.rays.rays_of(i) as f32;
        let resistance: Vec<f32> = self.blocks.range(block).map(resistance).collect();
        self.own(block, incoming, &resistance, sums);
        if let Some(buckets) = &incoming.buckets {
            self.coming_in(block, buckets, &incoming.ratios, &resistance, sums);
        }
    }

    fn one_way(&self, block: usize, sums: &mut [Sums<C>]) {
        for (i, sums) in self.blocks.range(block).zip(sums) {
            for replicate in 0..REPLICATES {
                let targets = self.samples.rays.of_replicate(i, replicate);
                let weight = self.samples.areas[i] / targets.len() as f64;
                for &j in targets.iter().filter(|&&j| j != ESCAPED) {
                    sums.landed[replicate].add(weight as f32, &self.seen[j as usize].radiosity);
                }
            }
        }
    }

    /// Adds the patches' own rays.
    fn own(&self, block: usize, incoming: &Incoming, resistance: &[f32], sums: &mut [Sums<C>]) {
        let (rays, seen) = (&self.samples.rays, &self.seen);
        for ((i, sums), &resistance) in self.blocks.range(block).zip(sums).zip(resistance) {
            for replicate in 0..REPLICATES {
                let ratio = incoming.ratios[replicate][i];
                let targets = rays.of_replicate(i, replicate);
                let (share, alone) = (1.0 / targets.len() as f32, ratio / seen[i].density);
                for &j in targets {
                    if j == ESCAPED {
                        sums.escaped[replicate] += share;
                        continue;
                    }
                    let other = &seen[j as usize];
                    let exchange = match incoming.buckets {
                        Some(_) => ratio * counted(TRUST, seen[i].density, other.density, resistance),
                        None => alone,
                    };
                    sums.landed[replicate].add(exchange, &other.radiosity);
                }
            }
        }
    }

    /// Adds the rays that arrive from other patches.
    fn coming_in(
        &self,
        block: usize,
        buckets: &Buckets,
        ratios: &[Vec<f32>],
        resistance: &[f32],
        sums: &mut [Sums<C>],
    ) {
        let start = self.blocks.range(block).start;
        // A single replicate of all patches of a block fits a cache near the processor.
        for (replicate, ratios) in ratios.iter().enumerate() {
            for other in 0..self.blocks.count() {
                let from = self.blocks.range(other).start;
                for (r, c) in buckets.of_replicate(other, block, replicate) {
                    let sender = &self.seen[from + r];
                    let own = self.seen[start + c].density;
                    let exchange = counted(1.0, own, sender.density, resistance[c]);
                    sums[c].landed[replicate].add(ratios[from + r] * exchange, &sender.radiosity);
                }
            }
        }
    }
}

/// Exchange area that one ray adds to the row of a patch. `own` and `others` are the rays per area of this patch and of
/// the other one. In a calibrated row own rays have a `weight` of [`TRUST`] and arriving rays of one. As far as the row
/// resists its calibration, the ray counts as in the pooled matrix.
#[inline]
fn counted(weight: f32, own: f32, others: f32, resistance: f32) -> f32 {
    (weight / (TRUST * own + others) + resistance / (own + others)) / (1.0 + resistance)
}
