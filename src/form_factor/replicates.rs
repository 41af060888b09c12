//! The replicates taken apart: how every row would differ had only one of them been cast.

use std::ops::Range;

use rayon::prelude::*;

use super::{
    CastOptions, Estimator, FormFactors, calibration,
    escape::Escape,
    hemisphere::{ESCAPED, Hits, LINKED, REPLICATES},
    reciprocity::{Buckets, Densities, excess_kernels},
    shadow::{Found, Link},
    symmetric::Blocks,
};

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
    pub(super) radiosity: Vec<f64>,
    /// Runs of patches that are close to each other.
    pub(super) siblings: Vec<Range<usize>>,
    /// What was asked for.
    pub(super) options: CastOptions,
}

/// Sums over each replicate for a patch: exchange areas and exchanged radiosity, of links and of everything else.
#[derive(Debug, Clone, Copy)]
struct Sums<const C: usize> {
    plain: [f32; REPLICATES],
    links: [f32; REPLICATES],
    /// Shares of the hemisphere rays that escaped, and that connected with sources.
    escaped: [f32; REPLICATES],
    linked: [f32; REPLICATES],
    plain_power: [[f32; REPLICATES]; C],
    link_power: [[f32; REPLICATES]; C],
}

impl<const C: usize> Sums<C> {
    const ZERO: Self = Sums {
        plain: [0.0; REPLICATES],
        links: [0.0; REPLICATES],
        escaped: [0.0; REPLICATES],
        linked: [0.0; REPLICATES],
        plain_power: [[0.0; REPLICATES]; C],
        link_power: [[0.0; REPLICATES]; C],
    };

    #[inline]
    fn add_plain(&mut self, replicate: usize, exchange: f64, radiosity: &[f64; C]) {
        self.plain[replicate] += exchange as f32;
        for c in 0..C {
            self.plain_power[c][replicate] += (exchange * radiosity[c]) as f32;
        }
    }

    /// Adds a link, of which each replicate has a share.
    #[inline]
    fn add_link(&mut self, exchange: f64, shares: &[f32; REPLICATES], radiosity: &[f64; C]) {
        let exchanges = shares.map(|share| exchange as f32 * share);
        for k in 0..REPLICATES {
            self.links[k] += exchanges[k];
        }
        for c in 0..C {
            for k in 0..REPLICATES {
                self.link_power[c][k] += exchanges[k] * radiosity[c] as f32;
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
        let parts = samples.deviations(radiosity, |parts| parts);
        let add = |to: &mut [f32], what: &[f32], factor: f32| {
            to.iter_mut().zip(what).for_each(|(to, what)| *to += factor * what);
        };
        let mut whole: Vec<Deviation<C>> = parts
            .iter()
            .map(|p| {
                let mut whole = p.hemisphere;
                add(whole.as_flattened_mut(), p.shadow.as_flattened(), 1.0);
                whole
            })
            .collect();
        if !samples.hits.sources.is_empty() {
            // What sources scale by is scaled in the rows of the others too, whose light from sources as a whole stays. With the
            // brightness b_l of the sources dE_i = Σ_l F_il ds_l (B_l - b_l Σ_m F_im B_m / Σ_m F_im b_m).
            let brightness = samples.densities.brightness();
            let scale: Vec<Deviation<1>> =
                parts.iter().zip(brightness).map(|(p, &b)| [p.scale.map(|s| s * b as f32)]).collect();
            let sent: Vec<Deviation<C>> = parts
                .iter()
                .zip(radiosity)
                .map(|(p, b)| std::array::from_fn(|c| p.scale.map(|s| s * b[c] as f32)))
                .collect();
            let (scale, sent) = (self.gather_replicates(&scale), self.gather_replicates(&sent));
            let known = self.irradiance(brightness, 1);
            let of_source = |i: usize| radiosity[i].map(|b| if brightness[i] > 0.0 { b } else { 0.0 });
            let light = self.irradiance(&(0..parts.len()).flat_map(of_source).collect::<Vec<_>>(), C);
            for i in (0..whole.len()).filter(|&i| !samples.hits.sources.contains(i)) {
                for c in 0..C {
                    add(&mut whole[i][c], &sent[i][c], 1.0);
                    let ratio = if known[i] > 0.0 { light[i * C + c] / known[i] } else { 0.0 };
                    add(&mut whole[i][c], &scale[i][0], -ratio as f32);
                }
            }
        }
        Some(whole)
    }
}

impl Samples {
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
        self.deviations::<C, _>(self.radiosity.as_chunks().0, |parts| {
            [squares(&parts.hemisphere), squares(&parts.shadow)]
        })
    }

    /// What `make` makes of the deviations of every patch.
    fn deviations<const C: usize, T: Send>(
        &self,
        radiosity: &[[f64; C]],
        make: impl Fn(Parts<C>) -> T + Sync,
    ) -> Vec<T> {
        let pooled = self.options.estimator == Estimator::Pooled;
        let incoming = if pooled { Incoming::new(&self.hits) } else { Incoming::default() };
        let blocks = Blocks::new(self.areas.len());
        let of_block = |block: usize| -> Vec<T> {
            let mut sums = vec![Sums::ZERO; blocks.range(block).len()];
            if pooled {
                self.pooled(block, blocks, &incoming, radiosity, &mut sums);
            } else {
                self.one_way(blocks.range(block), radiosity, &mut sums);
            }
            blocks.range(block).zip(&sums).map(|(i, sums)| make(self.deviation(i, sums))).collect()
        };
        (0..blocks.count()).into_par_iter().with_max_len(1).flat_map_iter(of_block).collect()
    }

    fn one_way<const C: usize>(&self, range: Range<usize>, radiosity: &[[f64; C]], sums: &mut [Sums<C>]) {
        for (i, sums) in range.zip(sums) {
            for replicate in 0..REPLICATES {
                let targets = self.hits.of_replicate(i, replicate);
                let weight = self.areas[i] / targets.len() as f64;
                for &j in targets.iter().filter(|&&j| j != ESCAPED) {
                    sums.add_plain(replicate, weight, &radiosity[j as usize]);
                }
            }
        }
    }

    /// Sums for the patches of a block: of their own rays and of those that come in.
    fn pooled<const C: usize>(
        &self,
        block: usize,
        blocks: Blocks,
        incoming: &Incoming,
        radiosity: &[[f64; C]],
        sums: &mut [Sums<C>],
    ) {
        let Samples { hits, densities, .. } = self;
        // By how much the replicate's rays stand for all.
        let many = |i: usize, replicate: usize| {
            f64::from(hits.rays_of(i)) / hits.of_replicate(i, replicate).len() as f64
        };
        for (i, sums) in blocks.range(block).zip(&mut *sums) {
            for replicate in 0..REPLICATES {
                let targets = hits.of_replicate(i, replicate);
                let share = 1.0 / targets.len() as f32;
                let many = many(i, replicate);
                for &j in targets {
                    match j {
                        LINKED => sums.linked[replicate] += share,
                        ESCAPED => sums.escaped[replicate] += share,
                        j => {
                            let (own, _) = densities.one_sided(i, j as usize, calibration::TRUST);
                            sums.add_plain(replicate, many * own, &radiosity[j as usize]);
                        }
                    }
                }
            }
            let excess = excess_kernels(hits, i);
            for link in hits.links_of(i).iter().filter(|link| link.found != Found::Blocked) {
                let exchange = densities.link(hits, i, link);
                sums.add_link(exchange, &shares(hits, i, link, &excess), &radiosity[link.to as usize]);
            }
        }
        for other in 0..blocks.count() {
            let start = blocks.range(other).start;
            for (r, c, replicate) in incoming.plain.list(other, block) {
                let (i, j) = (start + r, blocks.range(block).start + c);
                let (_, exchange) = densities.one_sided(i, j, calibration::TRUST);
                sums[c].add_plain(replicate, many(i, replicate) * exchange, &radiosity[i]);
            }
            let (mut from, mut excess) = (u32::MAX, [0.0; REPLICATES]);
            for &(i, k) in &incoming.links[other * blocks.count() + block] {
                if i != from {
                    (from, excess) = (i, excess_kernels(hits, i as usize));
                }
                let i = i as usize;
                let link = &hits.links_of(i)[k as usize];
                let place = blocks.of(link.to as usize).1 as usize;
                let exchange = densities.link(hits, i, link);
                sums[place].add_link(exchange, &shares(hits, i, link, &excess), &radiosity[i]);
            }
        }
    }

    /// Deviations of the replicates of patch `i` from their mean: what the matrix makes of their sums.
    fn deviation<const C: usize>(&self, i: usize, sums: &Sums<C>) -> Parts<C> {
        let mean = |values: &[f32; REPLICATES]| {
            values.iter().map(|&value| f64::from(value)).sum::<f64>() / REPLICATES as f64
        };
        let area = self.areas[i];
        let none = [[0.0; REPLICATES]; C];
        let mut deviation = Parts { hemisphere: none, shadow: none, scale: [0.0; REPLICATES] };
        let Some(&Escape { share, by_rays, by_links, by_linked }) = self.escapes.get(i) else {
            for c in 0..C {
                let power = mean(&sums.plain_power[c]);
                deviation.hemisphere[c] = sums.plain_power[c].map(|p| ((f64::from(p) - power) / area) as f32);
            }
            return deviation;
        };
        let (plain, links) = (mean(&sums.plain), mean(&sums.links));
        let (escaped, linked) = (mean(&sums.escaped), mean(&sums.linked));
        let is_source = self.hits.sources.contains(i);
        let ratio = |power: f64, exchange: f64| if exchange > 0.0 { power / exchange } else { 0.0 };
        for c in 0..C {
            let (plain_power, link_power) = (mean(&sums.plain_power[c]), mean(&sums.link_power[c]));
            for k in 0..REPLICATES {
                let d_links = f64::from(sums.links[k]) - links;
                let d_link_power = f64::from(sums.link_power[c][k]) - link_power;
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
                    (-closing * area * d_escaped, scale * d_closing - closing * area * d_escaped_links)
                } else {
                    let closing = ratio(plain_power, plain);
                    let d_closing = f64::from(sums.plain_power[c][k])
                        - plain_power
                        - closing * (f64::from(sums.plain[k]) - plain);
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
    plain: Buckets,
    /// The patch that each link comes from, and which of its links it is.
    links: Vec<Vec<(u32, u32)>>,
}

impl Incoming {
    fn new(hits: &Hits) -> Incoming {
        let plain = Buckets::new(hits);
        let blocks = plain.blocks;
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
        let links = (0..blocks.count()).into_par_iter().with_max_len(1).flat_map_iter(of_block).collect();
        Incoming { plain, links }
    }
}

/// The share of each replicate in a link from patch `i`: less than nothing where its kernels exceed their mean.
#[inline]
fn shares(hits: &Hits, i: usize, link: &Link, excess: &[f64; REPLICATES]) -> [f32; REPLICATES] {
    let mut shares = excess.map(|excess| -excess);
    shares[hits.replicate(i, link)] += hits.weight(i, link);
    shares.map(|share| share as f32)
}
