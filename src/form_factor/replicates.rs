//! The replicates taken apart: how every row would differ had only one of them been cast.

use rayon::prelude::*;

use super::{
    CastOptions, Estimator, FormFactors, calibration,
    escape::Escape,
    hemisphere::{ESCAPED, Hits, LINKED, REPLICATES},
    reciprocity::{Densities, excess_kernels},
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
    pub(super) siblings: Vec<std::ops::Range<usize>>,
    /// What was asked for.
    pub(super) options: CastOptions,
}

/// Sums over one replicate for a patch: exchange areas and exchanged radiosity, of links and of everything else.
#[derive(Debug, Clone, Copy)]
struct Sums<const C: usize> {
    plain: f32,
    links: f32,
    /// Shares of the hemisphere rays that escaped, and that connected with sources.
    escaped: f32,
    linked: f32,
    plain_power: [f32; C],
    link_power: [f32; C],
}

impl<const C: usize> Sums<C> {
    const ZERO: Self = Sums {
        plain: 0.0,
        links: 0.0,
        escaped: 0.0,
        linked: 0.0,
        plain_power: [0.0; C],
        link_power: [0.0; C],
    };

    #[inline]
    fn add_plain(&mut self, exchange: f64, radiosity: &[f64; C]) {
        self.plain += exchange as f32;
        for c in 0..C {
            self.plain_power[c] += (exchange * radiosity[c]) as f32;
        }
    }

    #[inline]
    fn add_link(&mut self, exchange: f64, radiosity: &[f64; C]) {
        self.links += exchange as f32;
        for c in 0..C {
            self.link_power[c] += (exchange * radiosity[c]) as f32;
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
    pub(crate) fn deviations<const C: usize>(
        &self,
        radiosity: &[[f64; C]],
        irradiance: &[[f64; C]],
    ) -> Option<Vec<Deviation<C>>> {
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
            // What sources scale by is scaled in the rows of the others too, which make up for it: dE_i = Σ F_il (B_l - E_i) ds_l.
            let scale: Vec<Deviation<1>> = parts.iter().map(|p| [p.scale]).collect();
            let sent: Vec<Deviation<C>> = parts
                .iter()
                .zip(radiosity)
                .map(|(p, b)| std::array::from_fn(|c| p.scale.map(|s| s * b[c] as f32)))
                .collect();
            let (scale, sent) = (self.gather_replicates(&scale), self.gather_replicates(&sent));
            for i in (0..whole.len()).filter(|&i| !samples.hits.sources.contains(i)) {
                for c in 0..C {
                    add(&mut whole[i][c], &sent[i][c], 1.0);
                    add(&mut whole[i][c], &scale[i][0], -irradiance[i][c] as f32);
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
        let excess: Vec<[f64; REPLICATES]> =
            (0..self.areas.len()).into_par_iter().map(|i| excess_kernels(&self.hits, i)).collect();
        let replicates: Vec<Vec<Sums<C>>> = (0..REPLICATES)
            .into_par_iter()
            .map(|k| match self.options.estimator {
                Estimator::OneWay => self.one_way(k, radiosity),
                Estimator::Pooled => self.pooled(k, radiosity, &excess),
            })
            .collect();
        (0..self.areas.len())
            .into_par_iter()
            .with_min_len(256)
            .map(|i| make(self.deviation(i, |k| &replicates[k][i])))
            .collect()
    }

    fn one_way<const C: usize>(&self, replicate: usize, radiosity: &[[f64; C]]) -> Vec<Sums<C>> {
        (0..self.areas.len())
            .map(|i| {
                let mut sums = Sums::ZERO;
                let targets = self.hits.of_replicate(i, replicate);
                let weight = self.areas[i] / targets.len() as f64;
                for &j in targets.iter().filter(|&&j| j != ESCAPED) {
                    sums.add_plain(weight, &radiosity[j as usize]);
                }
                sums
            })
            .collect()
    }

    fn pooled<const C: usize>(
        &self,
        replicate: usize,
        radiosity: &[[f64; C]],
        excess: &[[f64; REPLICATES]],
    ) -> Vec<Sums<C>> {
        let Samples { hits, densities, areas, .. } = self;
        let mut all = vec![Sums::<C>::ZERO; areas.len()];
        for i in 0..areas.len() {
            let targets = hits.of_replicate(i, replicate);
            let many = f64::from(hits.rays_of(i)) / targets.len() as f64;
            for &j in targets {
                match j {
                    LINKED => all[i].linked += 1.0 / targets.len() as f32,
                    ESCAPED => all[i].escaped += 1.0 / targets.len() as f32,
                    j => {
                        let j = j as usize;
                        let (own, incoming) = densities.one_sided(i, j, calibration::TRUST);
                        all[i].add_plain(many * own, &radiosity[j]);
                        all[j].add_plain(many * incoming, &radiosity[i]);
                    }
                }
            }
            for link in hits.links_of(i) {
                let j = link.to as usize;
                let own = if hits.replicate(i, link) == replicate { hits.weight(i, link) } else { 0.0 };
                let share = own - excess[i][replicate];
                if share == 0.0 {
                    continue;
                }
                let exchange = densities.link(hits, i, link) * share;
                all[i].add_link(exchange, &radiosity[j]);
                all[j].add_link(exchange, &radiosity[i]);
            }
        }
        all
    }

    /// Deviations of the replicates of patch `i` from their mean: what the matrix makes of their sums.
    fn deviation<'a, const C: usize>(&self, i: usize, replicate: impl Fn(usize) -> &'a Sums<C>) -> Parts<C> {
        let mean = |value: &dyn Fn(&Sums<C>) -> f32| {
            (0..REPLICATES).map(|k| f64::from(value(replicate(k)))).sum::<f64>() / REPLICATES as f64
        };
        let area = self.areas[i];
        let none = [[0.0; REPLICATES]; C];
        let mut deviation = Parts { hemisphere: none, shadow: none, scale: [0.0; REPLICATES] };
        let Some(&Escape { share, by_rays, by_links, by_linked }) = self.escapes.get(i) else {
            for c in 0..C {
                let power = mean(&|s| s.plain_power[c]);
                deviation.hemisphere[c] =
                    std::array::from_fn(|k| ((f64::from(replicate(k).plain_power[c]) - power) / area) as f32);
            }
            return deviation;
        };
        let (plain, links) = (mean(&|s| s.plain), mean(&|s| s.links));
        let (escaped, linked) = (mean(&|s| s.escaped), mean(&|s| s.linked));
        let is_source = self.hits.sources.contains(i);
        let ratio = |power: f64, exchange: f64| if exchange > 0.0 { power / exchange } else { 0.0 };
        for c in 0..C {
            let (plain_power, link_power) = (mean(&|s| s.plain_power[c]), mean(&|s| s.link_power[c]));
            for k in 0..REPLICATES {
                let s = replicate(k);
                let d_links = f64::from(s.links) - links;
                let d_link_power = f64::from(s.link_power[c]) - link_power;
                let d_escaped =
                    by_rays * (f64::from(s.escaped) - escaped) + by_linked * (f64::from(s.linked) - linked);
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
                    let d_closing =
                        f64::from(s.plain_power[c]) - plain_power - closing * (f64::from(s.plain) - plain);
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
