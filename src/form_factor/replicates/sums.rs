//! Sums over the rays of every replicate, patch by patch.

use rayon::prelude::*;

use super::{
    super::{
        Estimator, SHORT,
        blocks::Blocks,
        calibration,
        hemisphere::{ESCAPED, Hits, LINKED, REPLICATES},
        reciprocity::{Buckets, excess_kernels},
        shadow::{Found, Link},
    },
    Samples,
};

/// Patches of a block at most whose sums are made together: a megabyte of what rays add to anywhere,
const MOST_ROWS: usize = 1 << 12;
/// and at least: smaller ones are not worth a task.
const LEAST_ROWS: usize = 1 << 7;

/// In single precision.
const TRUST: f32 = calibration::TRUST as f32;

/// Which hemisphere rays tell of a patch without a source.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rays {
    /// Those that come in too, as the matrix counts them.
    All,
    /// Its own, which is nearly as good to tell who needs more.
    Own,
}

/// Sums over each replicate for a patch: of links and of everything else.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sums<const C: usize> {
    pub(super) plain: [Exchange<C>; REPLICATES],
    pub(super) links: [Exchange<C>; REPLICATES],
    /// Shares of the hemisphere rays that escaped, and that connected with sources.
    pub(super) escaped: [f32; REPLICATES],
    pub(super) linked: [f32; REPLICATES],
}

/// Exchange areas, and what is exchanged. Side by side, since a ray adds to both at once, in any row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Exchange<const C: usize> {
    pub(super) area: f32,
    pub(super) power: [f32; C],
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

    #[inline]
    fn add_times(&mut self, factor: f32, other: &Self) {
        self.area += factor * other.area;
        for c in 0..C {
            self.power[c] += factor * other.power[c];
        }
    }
}

/// What rays that meet a patch need to know of it, in one place: they come to any.
#[derive(Debug, Clone, Copy)]
struct Seen<const C: usize> {
    radiosity: [f32; C],
    /// Its hemisphere rays per area.
    density: f32,
}

impl<const C: usize> Sums<C> {
    const ZERO: Self = Sums {
        plain: [Exchange::ZERO; REPLICATES],
        links: [Exchange::ZERO; REPLICATES],
        escaped: [0.0; REPLICATES],
        linked: [0.0; REPLICATES],
    };

    /// Takes away what links are too much for the kernels of each replicate, by `excess`.
    #[inline]
    fn correct_links(&mut self, of_kernels: &Exchange<C>, excess: &[f32; REPLICATES]) {
        for (links, excess) in self.links.iter_mut().zip(excess) {
            links.area -= excess * of_kernels.area;
            for c in 0..C {
                links.power[c] -= excess * of_kernels.power[c];
            }
        }
    }
}

/// Samples by the blocks of patches that they come from and go to.
struct Incoming {
    /// Of hemisphere rays that come in, where they are counted.
    plain: Option<Buckets>,
    /// By how much the rays of each replicate, of each patch, stand for all of its rays.
    many: Vec<Vec<f32>>,
    /// The patch that each link comes from, and which of its links it is.
    links: Vec<Vec<(u32, u32)>>,
}

impl Incoming {
    fn new(hits: &Hits, blocks: Blocks, rays: Rays) -> Incoming {
        let plain = (rays == Rays::All).then(|| Buckets::by_replicates(hits, blocks));
        let many = |replicate: usize| {
            let many = |i| hits.rays_of(i) as f32 / hits.of_replicate(i, replicate).len() as f32;
            (0..hits.len()).map(many).collect()
        };
        let of_block = |block: usize| {
            let mut lists = vec![Vec::new(); blocks.count()];
            for i in blocks.range(block) {
                let found = |&(_, link): &(usize, &Link)| link.found != Found::Blocked;
                for (k, link) in hits.links_of(i).iter().enumerate().filter(found) {
                    lists[blocks.of(link.to as usize).0].push((i as u32, k as u32));
                }
            }
            lists
        };
        Incoming {
            plain,
            many: (0..REPLICATES).into_par_iter().map(many).collect(),
            links: (0..blocks.count()).into_par_iter().with_max_len(1).flat_map_iter(of_block).collect(),
        }
    }
}

/// What is summed, for a given radiosity.
pub(super) struct Counted<'a, const C: usize> {
    samples: &'a Samples,
    /// Patches whose sums are made together.
    pub(super) blocks: Blocks,
    /// Of pooled form factors.
    incoming: Option<Incoming>,
    seen: Vec<Seen<C>>,
    /// Area and power of each lamp over the same with its brightness.
    of_lamps: Vec<Exchange<C>>,
}

impl<'a, const C: usize> Counted<'a, C> {
    pub(super) fn new(samples: &'a Samples, radiosity: &[[f32; C]], rays: Rays) -> Self {
        let blocks = Blocks::of_rows(samples.areas.len(), LEAST_ROWS, MOST_ROWS);
        let pooled = samples.options.estimator == Estimator::Pooled;
        let density = |i: usize| (f64::from(samples.hits.rays_of(i)) / samples.areas[i]) as f32;
        let seen = |(i, &radiosity)| Seen { radiosity, density: density(i) };
        Counted {
            samples,
            blocks,
            incoming: pooled.then(|| Incoming::new(&samples.hits, blocks, rays)),
            seen: radiosity.par_iter().enumerate().with_min_len(SHORT).map(seen).collect(),
            of_lamps: per_brightness(samples, radiosity),
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
        let resistance = |i: usize| calibration::RESISTANCE as f32 / self.samples.hits.rays_of(i) as f32;
        let resistance: Vec<f32> = self.blocks.range(block).map(resistance).collect();
        self.own(block, incoming, &resistance, sums);
        if let Some(plain) = &incoming.plain {
            self.coming_in(block, plain, &incoming.many, &resistance, sums);
        }
        self.links_coming_in(block, incoming, sums);
    }

    fn one_way(&self, block: usize, sums: &mut [Sums<C>]) {
        for (i, sums) in self.blocks.range(block).zip(sums) {
            for replicate in 0..REPLICATES {
                let targets = self.samples.hits.of_replicate(i, replicate);
                let weight = self.samples.areas[i] / targets.len() as f64;
                for &j in targets.iter().filter(|&&j| j != ESCAPED) {
                    sums.plain[replicate].add(weight as f32, &self.seen[j as usize].radiosity);
                }
            }
        }
    }

    /// Of the patches' own rays.
    fn own(&self, block: usize, incoming: &Incoming, resistance: &[f32], sums: &mut [Sums<C>]) {
        let (hits, seen) = (&self.samples.hits, &self.seen);
        let (mut of_kernels, mut excess) = (vec![Exchange::ZERO; hits.sources.lamps()], Vec::new());
        for ((i, sums), &resistance) in self.blocks.range(block).zip(sums).zip(resistance) {
            for replicate in 0..REPLICATES {
                let targets = hits.of_replicate(i, replicate);
                let (share, many) = (1.0 / targets.len() as f32, incoming.many[replicate][i]);
                for &j in targets {
                    match j {
                        LINKED => sums.linked[replicate] += share,
                        ESCAPED => sums.escaped[replicate] += share,
                        j => {
                            let other = &seen[j as usize];
                            let exchange = match incoming.plain {
                                Some(_) => counted(TRUST, seen[i].density, other.density, resistance),
                                None => seen[i].density.recip(),
                            };
                            sums.plain[replicate].add(many * exchange, &other.radiosity);
                        }
                    }
                }
            }
            of_kernels.fill(Exchange::ZERO);
            for link in hits.links_of(i).iter().filter(|link| link.found != Found::Blocked) {
                let (replicate, many) = hits.part_of(i, link);
                let exchange = self.exchanged(i, i, link);
                sums.links[replicate].add_times(many as f32, &exchange);
                if link.found != Found::Hemisphere {
                    of_kernels[hits.sources.lamp_of(link.to as usize)].add_times(1.0, &exchange);
                }
            }
            excess_kernels(hits, i, &mut excess);
            for (of_kernels, excess) in of_kernels.iter().zip(&excess) {
                sums.correct_links(of_kernels, excess);
            }
        }
    }

    /// Of hemisphere rays that come in.
    fn coming_in(
        &self,
        block: usize,
        plain: &Buckets,
        many: &[Vec<f32>],
        resistance: &[f32],
        sums: &mut [Sums<C>],
    ) {
        let start = self.blocks.range(block).start;
        // A replicate of all patches of a block stays in a near cache.
        for (replicate, many) in many.iter().enumerate() {
            for other in 0..self.blocks.count() {
                let from = self.blocks.range(other).start;
                for (r, c) in plain.of_replicate(other, block, replicate) {
                    let sender = &self.seen[from + r];
                    let own = self.seen[start + c].density;
                    let exchange = counted(1.0, own, sender.density, resistance[c]);
                    sums[c].plain[replicate].add(many[from + r] * exchange, &sender.radiosity);
                }
            }
        }
    }

    /// Of links that other patches found.
    fn links_coming_in(&self, block: usize, incoming: &Incoming, sums: &mut [Sums<C>]) {
        let (hits, blocks) = (&self.samples.hits, self.blocks);
        for other in 0..blocks.count() {
            let (mut from, mut excess) = (u32::MAX, Vec::new());
            for &(i, k) in &incoming.links[other * blocks.count() + block] {
                if i != from {
                    from = i;
                    excess_kernels(hits, i as usize, &mut excess);
                }
                let i = i as usize;
                let link = &hits.links_of(i)[k as usize];
                let sums = &mut sums[blocks.of(link.to as usize).1 as usize];
                let exchange = self.exchanged(link.to as usize, i, link);
                let (replicate, many) = hits.part_of(i, link);
                sums.links[replicate].add_times(many as f32, &exchange);
                if link.found != Found::Hemisphere && hits.sources.are_lamps() {
                    sums.correct_links(&exchange, &excess[hits.sources.lamp_of(link.to as usize)]);
                }
            }
        }
    }

    /// What a link of patch `i` adds to what a row exchanges.
    #[inline]
    fn exchanged(&self, row: usize, i: usize, link: &Link) -> Exchange<C> {
        let Samples { hits, densities, .. } = self.samples;
        let from = if row == i { link.to as usize } else { i };
        let exchange = densities.link(hits, i, link) as f32;
        let mut sum = Exchange::ZERO;
        sum.add(exchange, &self.seen[from].radiosity);
        if let Some(known) = densities.known(hits, row, i, link) {
            let of_lamp = &self.of_lamps[hits.sources.lamp_of(from)];
            // All light of a lamp together, which the matrix holds as it is known, not as its entries are told.
            sum.add_times((known as f32 - exchange) * densities.brightness()[from] as f32, of_lamp);
        }
        sum
    }
}

/// Area and power of each lamp over the same with its brightness.
fn per_brightness<const C: usize>(samples: &Samples, radiosity: &[[f32; C]]) -> Vec<Exchange<C>> {
    let sources = &samples.hits.sources;
    let mut sums = vec![(Exchange::ZERO, 0.0); sources.lamps()];
    for i in sources.patches().iter().map(|&i| i as usize) {
        let (sum, brightness) = &mut sums[sources.lamp_of(i)];
        sum.add(samples.areas[i] as f32, &radiosity[i]);
        *brightness += samples.areas[i] * samples.densities.brightness()[i];
    }
    let each = |(sum, brightness): (Exchange<C>, f64)| {
        let per = (1.0 / brightness.max(f64::MIN_POSITIVE)) as f32;
        Exchange { area: sum.area * per, power: sum.power.map(|power| power * per) }
    };
    sums.into_iter().map(each).collect()
}

/// What a hemisphere ray adds to the exchange area of its patches as the row of one of them counts it, which has so many rays of
/// its own per area, and the other patch so many: as far as it follows its calibration with a weight of [`TRUST`] for its own rays
/// and of one for those that come in, and, as far as it resists that, as it was pooled.
#[inline]
fn counted(weight: f32, own: f32, others: f32, resistance: f32) -> f32 {
    (weight / (TRUST * own + others) + resistance / (own + others)) / (1.0 + resistance)
}
