//! The replicates taken apart: how every row would differ had only one of them been cast.

use std::ops::Range;

use rayon::prelude::*;

use super::{
    CastOptions, Estimator, FormFactors, SHORT,
    blocks::Blocks,
    calibration,
    escape::Escape,
    hemisphere::{ESCAPED, Hits, LINKED, REPLICATES},
    reciprocity::{Buckets, Densities, excess_kernels},
    shadow::{Found, Link},
};

/// Patches of a block at most whose sums are made together: a megabyte of what rays add to anywhere,
const MOST_ROWS: usize = 1 << 12;
/// and at least: smaller ones are not worth a task.
const LEAST_ROWS: usize = 1 << 7;

/// By what share proportions may differ that count as one: what is left out is as much smaller than the standard error of a
/// source's row.
const ALIKE: f64 = 0.05;

/// In single precision.
const TRUST: f32 = calibration::TRUST as f32;

/// What the estimate was made of, kept for the error bars.
#[derive(Debug, Clone)]
pub(super) struct Samples {
    pub(super) hits: Hits,
    pub(super) densities: Densities,
    /// Of each patch; empty for one-way form factors, which need none.
    pub(super) escapes: Vec<Escape>,
    /// Areas in the unit of `densities`.
    pub(super) areas: Vec<f64>,
    /// The radiosity after some bounces, interleaved channels, in a unit of its own.
    pub(super) radiosity: Vec<f32>,
    /// Runs of patches that are close to each other.
    pub(super) siblings: Vec<Range<usize>>,
    /// What was asked for.
    pub(super) options: CastOptions,
}

/// Which hemisphere rays tell of a patch without a source.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Rays {
    /// Those that come in too, as the matrix counts them.
    All,
    /// Its own, which is nearly as good to tell who needs more.
    Own,
}

/// Sums over each replicate for a patch: of links and of everything else.
#[derive(Debug, Clone, Copy)]
struct Sums<const C: usize> {
    plain: [Exchange<C>; REPLICATES],
    links: [Exchange<C>; REPLICATES],
    /// Shares of the hemisphere rays that escaped, and that connected with sources.
    escaped: [f32; REPLICATES],
    linked: [f32; REPLICATES],
}

/// Exchange areas, and what is exchanged. Side by side, since a ray adds to both at once, in any row.
#[derive(Debug, Clone, Copy)]
struct Exchange<const C: usize> {
    area: f32,
    power: [f32; C],
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

/// By how much each replicate's irradiance of a patch deviates from the mean of all, for a given radiosity.
pub(crate) type Deviation<const C: usize> = [[f32; REPLICATES]; C];

/// The deviations of a patch, to first order.
#[derive(Debug, Clone)]
struct Parts<const C: usize> {
    /// By hemisphere rays, those that come in included.
    hemisphere: Deviation<C>,
    /// By shadow rays.
    shadow: Deviation<C>,
    /// Of a source: by what factor, less one, closing its row scales its links.
    scale: [f32; REPLICATES],
}

impl FormFactors {
    /// Σ_j dF_ij B_j of all replicates for every patch, where E = F B; `None` when the form factors were not sampled.
    pub(crate) fn deviations<const C: usize>(&self, radiosity: &[[f64; C]]) -> Option<Vec<Deviation<C>>> {
        let samples = self.samples.as_ref()?;
        let single: Vec<[f32; C]> = radiosity.iter().map(|b| b.map(|b| b as f32)).collect();
        let add = |to: &mut [f32], what: &[f32], factor: f32| {
            to.iter_mut().zip(what).for_each(|(to, what)| *to += factor * what);
        };
        let mut whole: Vec<Deviation<C>> = vec![[[0.0; REPLICATES]; C]; radiosity.len()];
        let scales = samples.deviations(&single, Rays::All, &mut whole, |parts| {
            let mut whole = parts.hemisphere;
            add(whole.as_flattened_mut(), parts.shadow.as_flattened(), 1.0);
            whole
        });
        if !samples.shine_alike(radiosity) {
            // What sources scale by is scaled in the rows of the others too, whose light from sources as a whole stays. With the
            // brightness b_l of the sources dE_i = Σ_l F_il ds_l (B_l - b_l Σ_m F_im B_m / Σ_m F_im b_m).
            let brightness = samples.densities.brightness();
            let sources = samples.hits.sources.patches();
            let scale = self.gather_from(sources, |k, i| [scales[k].map(|s| s * brightness[i] as f32)]);
            let sent: Vec<Deviation<C>> = self.gather_from(sources, |k, i| {
                std::array::from_fn(|c| scales[k].map(|s| s * radiosity[i][c] as f32))
            });
            let known = self.irradiance(brightness, 1);
            let of_source = |i: usize| radiosity[i].map(|b| if brightness[i] > 0.0 { b } else { 0.0 });
            let light = self.irradiance(&(0..radiosity.len()).flat_map(of_source).collect::<Vec<_>>(), C);
            let rows = whole.par_iter_mut().enumerate().with_min_len(SHORT);
            rows.filter(|&(i, _)| !samples.hits.sources.contains(i)).for_each(|(i, whole)| {
                for c in 0..C {
                    add(&mut whole[c], &sent[i][c], 1.0);
                    let ratio = if known[i] > 0.0 { light[i * C + c] / known[i] } else { 0.0 };
                    add(&mut whole[c], &scale[i][0], -ratio as f32);
                }
            });
        }
        Some(whole)
    }
}

impl Samples {
    /// Whether the radiosity of all sources is in one proportion to their brightness, nearly: how they share what others get from
    /// them does not matter then.
    fn shine_alike<const C: usize>(&self, radiosity: &[[f64; C]]) -> bool {
        let brightness = self.densities.brightness();
        (0..C).all(|c| {
            let sources = self.hits.sources.patches().iter().map(|&i| i as usize);
            let of = sources.filter(|&i| brightness[i] > 0.0).map(|i| radiosity[i][c] / brightness[i]);
            let (least, most) = of.fold((f64::INFINITY, 0.0), |(low, high), x| (x.min(low), x.max(high)));
            most <= (1.0 + ALIKE) * least
        })
    }

    /// Variances of every patch's irradiance, all channels together, that come from its hemisphere rays, those that come
    /// in included, and from its shadow rays. Light reflected from patches that are off counts to none.
    pub(super) fn variances(&self, channels: usize) -> Vec<[f64; 2]> {
        match channels {
            1 => self.variances_of::<1>(),
            _ => self.variances_of::<3>(),
        }
    }

    fn variances_of<const C: usize>(&self) -> Vec<[f64; 2]> {
        let squares = |d: &Deviation<C>| d.as_flattened().iter().map(|&d| f64::from(d).powi(2)).sum();
        let mut variances = vec![[0.0; 2]; self.areas.len()];
        self.deviations::<C, _>(self.radiosity.as_chunks().0, Rays::Own, &mut variances, |parts| {
            [squares(&parts.hemisphere), squares(&parts.shadow)]
        });
        variances
    }

    /// Fills `out` with what `make` makes of the deviations of every patch. Returns by what closing their rows scales the links of
    /// sources, one after the other.
    fn deviations<const C: usize, T: Send>(
        &self,
        radiosity: &[[f32; C]],
        rays: Rays,
        out: &mut [T],
        make: impl Fn(&Parts<C>) -> T + Sync,
    ) -> Vec<[f32; REPLICATES]> {
        let pooled = self.options.estimator == Estimator::Pooled;
        let blocks = Blocks::of_rows(self.areas.len(), LEAST_ROWS, MOST_ROWS);
        let incoming = if pooled { Incoming::new(&self.hits, blocks, rays) } else { Incoming::default() };
        let of_lamps = self.per_brightness(radiosity);
        let density = |i: usize| (f64::from(self.hits.rays_of(i)) / self.areas[i]) as f32;
        let seen = |(i, &radiosity)| Seen { radiosity, density: density(i) };
        let seen: Vec<Seen<C>> = radiosity.par_iter().enumerate().with_min_len(SHORT).map(seen).collect();
        let of_block = |sums: &mut Vec<Sums<C>>, (block, out): (usize, &mut [T])| {
            sums.clear();
            sums.resize(out.len(), Sums::ZERO);
            if pooled {
                self.pooled(block, &incoming, &seen, &of_lamps, sums);
            } else {
                self.one_way(blocks.range(block), radiosity, sums);
            }
            let mut scales = Vec::new();
            for ((i, sums), out) in blocks.range(block).zip(sums).zip(out) {
                let parts = self.deviation(i, sums);
                *out = make(&parts);
                if self.hits.sources.patches().binary_search(&(i as u32)).is_ok() {
                    scales.push(parts.scale);
                }
            }
            scales
        };
        let parts = out.par_chunks_mut(blocks.rows()).enumerate().with_max_len(1);
        let scales: Vec<_> = parts.map_init(Vec::new, of_block).collect();
        scales.concat()
    }

    fn one_way<const C: usize>(&self, range: Range<usize>, radiosity: &[[f32; C]], sums: &mut [Sums<C>]) {
        for (i, sums) in range.zip(sums) {
            for replicate in 0..REPLICATES {
                let targets = self.hits.of_replicate(i, replicate);
                let weight = self.areas[i] / targets.len() as f64;
                for &j in targets.iter().filter(|&&j| j != ESCAPED) {
                    sums.plain[replicate].add(weight as f32, &radiosity[j as usize]);
                }
            }
        }
    }

    /// Area and power of all sources over the same with their brightness.
    fn per_brightness<const C: usize>(&self, radiosity: &[[f32; C]]) -> Exchange<C> {
        let (mut sum, mut brightness) = (Exchange::ZERO, 0.0);
        for i in self.hits.sources.patches().iter().map(|&i| i as usize) {
            sum.add(self.areas[i] as f32, &radiosity[i]);
            brightness += self.areas[i] * self.densities.brightness()[i];
        }
        let per = (1.0 / brightness.max(f64::MIN_POSITIVE)) as f32;
        Exchange { area: sum.area * per, power: sum.power.map(|power| power * per) }
    }

    /// Sums for the patches of a block: of their own rays and of those that come in.
    fn pooled<const C: usize>(
        &self,
        block: usize,
        incoming: &Incoming,
        seen: &[Seen<C>],
        of_lamps: &Exchange<C>,
        sums: &mut [Sums<C>],
    ) {
        let (hits, blocks) = (&self.hits, incoming.blocks);
        let resistance = |i: usize| calibration::RESISTANCE as f32 / hits.rays_of(i) as f32;
        let resistance: Vec<f32> = blocks.range(block).map(resistance).collect();
        for ((i, sums), &resistance) in blocks.range(block).zip(&mut *sums).zip(&resistance) {
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
            let mut of_kernels = Exchange::ZERO;
            for link in hits.links_of(i).iter().filter(|link| link.found != Found::Blocked) {
                let (replicate, many) = hits.part_of(i, link);
                let exchange = self.exchanged(i, i, link, seen, of_lamps);
                sums.links[replicate].add_times(many as f32, &exchange);
                if link.found != Found::Hemisphere {
                    of_kernels.add_times(1.0, &exchange);
                }
            }
            sums.correct_links(&of_kernels, &excess_kernels(hits, i));
        }
        let start = blocks.range(block).start;
        // A replicate of all patches of a block stays in a near cache.
        for (plain, replicate) in
            incoming.plain.iter().flat_map(|plain| (0..REPLICATES).map(move |k| (plain, k)))
        {
            let many = &incoming.many[replicate];
            for other in 0..blocks.count() {
                let from = blocks.range(other).start;
                for (r, c) in plain.of_replicate(other, block, replicate) {
                    let sender = &seen[from + r];
                    let exchange = counted(1.0, seen[start + c].density, sender.density, resistance[c]);
                    sums[c].plain[replicate].add(many[from + r] * exchange, &sender.radiosity);
                }
            }
        }
        for other in 0..blocks.count() {
            let (mut from, mut excess) = (u32::MAX, [0.0; REPLICATES]);
            for &(i, k) in &incoming.links[other * blocks.count() + block] {
                if i != from {
                    (from, excess) = (i, excess_kernels(hits, i as usize));
                }
                let i = i as usize;
                let link = &hits.links_of(i)[k as usize];
                let sums = &mut sums[blocks.of(link.to as usize).1 as usize];
                let exchange = self.exchanged(link.to as usize, i, link, seen, of_lamps);
                let (replicate, many) = hits.part_of(i, link);
                sums.links[replicate].add_times(many as f32, &exchange);
                if link.found != Found::Hemisphere && hits.sources.are_lamps() {
                    sums.correct_links(&exchange, &excess);
                }
            }
        }
    }

    /// What a link of patch `i` adds to what a row exchanges.
    #[inline]
    fn exchanged<const C: usize>(
        &self,
        row: usize,
        i: usize,
        link: &Link,
        seen: &[Seen<C>],
        of_lamps: &Exchange<C>,
    ) -> Exchange<C> {
        let Samples { hits, densities, .. } = self;
        let from = if row == i { link.to as usize } else { i };
        let exchange = densities.link(hits, i, link) as f32;
        let mut sum = Exchange::ZERO;
        sum.add(exchange, &seen[from].radiosity);
        if let Some(known) = densities.known(hits, row, i, link) {
            // All light of lamps together, which the matrix holds as it is known, not as its entries are told.
            sum.add_times((known as f32 - exchange) * densities.brightness()[from] as f32, of_lamps);
        }
        sum
    }

    /// Deviations of the replicates of patch `i` from their mean: what the matrix makes of their sums.
    fn deviation<const C: usize>(&self, i: usize, sums: &Sums<C>) -> Parts<C> {
        let mean = |of: &dyn Fn(usize) -> f32| {
            (0..REPLICATES).map(|k| f64::from(of(k))).sum::<f64>() / REPLICATES as f64
        };
        let area = self.areas[i];
        let none = [[0.0; REPLICATES]; C];
        let mut deviation = Parts { hemisphere: none, shadow: none, scale: [0.0; REPLICATES] };
        let Some(&Escape { share, by_rays, by_links, by_linked }) = self.escapes.get(i) else {
            for c in 0..C {
                let power = mean(&|k| sums.plain[k].power[c]);
                deviation.hemisphere[c] =
                    sums.plain.map(|plain| ((f64::from(plain.power[c]) - power) / area) as f32);
            }
            return deviation;
        };
        let (plain, links) = (mean(&|k| sums.plain[k].area), mean(&|k| sums.links[k].area));
        let (escaped, linked) = (mean(&|k| sums.escaped[k]), mean(&|k| sums.linked[k]));
        let is_source = self.hits.sources.contains(i);
        let ratio = |power: f64, exchange: f64| if exchange > 0.0 { power / exchange } else { 0.0 };
        for c in 0..C {
            let plain_power = mean(&|k| sums.plain[k].power[c]);
            let link_power = mean(&|k| sums.links[k].power[c]);
            for k in 0..REPLICATES {
                let d_links = f64::from(sums.links[k].area) - links;
                let d_link_power = f64::from(sums.links[k].power[c]) - link_power;
                let d_escaped = by_rays * (f64::from(sums.escaped[k]) - escaped)
                    + by_linked * (f64::from(sums.linked[k]) - linked);
                let d_escaped_links = by_links * d_links / area;
                // A row sums to its area less what escapes: of a source, whose row is all links, these take up the rest,
                // else what is no link does.
                let (hemisphere, shadow) = if is_source {
                    let closing = ratio(link_power, links);
                    let d_closing = d_link_power - closing * d_links;
                    deviation.scale[k] = -ratio(d_links + area * (d_escaped + d_escaped_links), links) as f32;
                    let scale = ratio(area * (1.0 - share), links);
                    // Where lamps are few, more of their own rays tell it; others' shadow rays go to what these light.
                    let (own, others) = if self.hits.sources.are_lamps() { (1.0, 0.0) } else { (0.0, 1.0) };
                    (
                        own * scale * d_closing - closing * area * d_escaped,
                        others * scale * d_closing - closing * area * d_escaped_links,
                    )
                } else {
                    let closing = ratio(plain_power, plain);
                    let d_closing = f64::from(sums.plain[k].power[c])
                        - plain_power
                        - closing * (f64::from(sums.plain[k].area) - plain);
                    let scale = ratio(area * (1.0 - share) - links, plain);
                    (
                        scale * d_closing - closing * area * d_escaped,
                        d_link_power - closing * (d_links + area * d_escaped_links),
                    )
                };
                deviation.hemisphere[c][k] = (hemisphere / area) as f32;
                deviation.shadow[c][k] = (shadow / area) as f32;
            }
        }
        deviation
    }
}

/// Samples by the blocks of patches that they come from and go to.
#[derive(Default)]
struct Incoming {
    blocks: Blocks,
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
            blocks,
            plain,
            many: (0..REPLICATES).into_par_iter().map(many).collect(),
            links: (0..blocks.count()).into_par_iter().with_max_len(1).flat_map_iter(of_block).collect(),
        }
    }
}

/// What a hemisphere ray adds to the exchange area of its patches as the row of one of them counts it, which has so many rays of
/// its own per area, and the other patch so many: as far as it follows its calibration with a weight of [`TRUST`] for its own rays
/// and of one for those that come in, and, as far as it resists that, as it was pooled.
#[inline]
fn counted(weight: f32, own: f32, others: f32, resistance: f32) -> f32 {
    (weight / (TRUST * own + others) + resistance / (own + others)) / (1.0 + resistance)
}
