//! The replicates taken apart: how every row would differ had only one of them been cast.

use rayon::prelude::*;

use super::{
    Estimator, FormFactors,
    closure::Spread,
    escape::Escape,
    hemisphere::{ESCAPED, Hits, LINKED, REPLICATES},
    reciprocity::Densities,
};

/// What the estimate was made of, kept for the error bars.
#[derive(Debug, Clone)]
pub(super) struct Samples {
    pub(super) hits: Hits,
    pub(super) densities: Densities,
    pub(super) spread: Spread,
    /// Of each patch; empty for one-way form factors, which need none.
    pub(super) escapes: Vec<Escape>,
    /// Areas in the unit of `densities`.
    pub(super) areas: Vec<f64>,
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

/// How one replicate's rows deviate from the mean of all, for a given radiosity.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Deviation<const C: usize> {
    /// Σ_j dS_ij B_j / A_i before closure, for each channel and replicate.
    pub(crate) irradiance: [[f32; REPLICATES]; C],
    /// By how much the closure would scale the row if no other were scaled, d ln d.
    pub(crate) scale: [f32; REPLICATES],
    /// The share of the row's scale that its links with sources take; 1 for sources.
    pub(crate) link_yield: f32,
    /// What a change of the row's scale changes its irradiance by, dE / d ln d.
    pub(crate) response: [f32; C],
}

impl FormFactors {
    /// The deviations of all replicates for every patch; `None` when the form factors were not sampled.
    pub(crate) fn deviations<const C: usize>(&self, radiosity: &[[f64; C]]) -> Option<Vec<Deviation<C>>> {
        let samples = self.samples.as_ref()?;
        let replicates: Vec<Vec<Sums<C>>> = (0..REPLICATES)
            .into_par_iter()
            .map(|k| match self.estimator {
                Estimator::OneWay => samples.one_way(k, radiosity),
                Estimator::Pooled => samples.pooled(k, radiosity),
            })
            .collect();
        Some(
            (0..self.len())
                .into_par_iter()
                .with_min_len(256)
                .map(|i| {
                    let own: [Sums<C>; REPLICATES] = std::array::from_fn(|k| replicates[k][i]);
                    samples.deviation(i, &own, self.estimator)
                })
                .collect(),
        )
    }
}

impl Samples {
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

    fn pooled<const C: usize>(&self, replicate: usize, radiosity: &[[f64; C]]) -> Vec<Sums<C>> {
        let many = REPLICATES as f64;
        let Samples { hits, densities, spread, areas, .. } = self;
        let mut all = vec![Sums::<C>::ZERO; areas.len()];
        for i in 0..areas.len() {
            let targets = hits.of_replicate(i, replicate);
            for &j in targets {
                match j {
                    LINKED => all[i].linked += 1.0 / targets.len() as f32,
                    ESCAPED => all[i].escaped += 1.0 / targets.len() as f32,
                    j => {
                        let j = j as usize;
                        let exchange = many * densities.hit(i, j) * spread.plain[i] * spread.plain[j];
                        all[i].add_plain(exchange, &radiosity[j]);
                        all[j].add_plain(exchange, &radiosity[i]);
                    }
                }
            }
        }
        for link in hits.links.iter().filter(|link| link.replicate as usize == replicate) {
            let (i, j) = (link.from as usize, link.to as usize);
            let exchange = many * densities.link(link) * spread.link[i] * spread.link[j];
            all[i].add_link(exchange, &radiosity[j]);
            all[j].add_link(exchange, &radiosity[i]);
        }
        all
    }

    /// Deviations of the replicates of patch `i` from their mean.
    fn deviation<const C: usize>(
        &self,
        i: usize,
        replicates: &[Sums<C>; REPLICATES],
        estimator: Estimator,
    ) -> Deviation<C> {
        let mean = |value: &dyn Fn(&Sums<C>) -> f32| {
            replicates.iter().map(|s| f64::from(value(s))).sum::<f64>() / REPLICATES as f64
        };
        let (plain, links) = (mean(&|s| s.plain), mean(&|s| s.links));
        let power = Spread::link_yield(self.hits.sources.probability(i) > 0.0);
        // A replicate whose row sums to more than the mean is scaled down by the closure.
        let stiffness = plain + power * links;
        let sum = |s: &Sums<C>| {
            let Escape { by_rays, by_links, by_linked, .. } = self.escapes[i];
            let links = f64::from(s.links) / self.areas[i];
            let escaped = by_rays * f64::from(s.escaped) + by_links * links + by_linked * f64::from(s.linked);
            f64::from(s.plain + s.links) + self.areas[i] * escaped
        };
        let mut scale = [0.0; REPLICATES];
        if estimator == Estimator::Pooled && stiffness > 0.0 {
            let sums: [f64; REPLICATES] = std::array::from_fn(|k| sum(&replicates[k]));
            let whole = sums.iter().sum::<f64>() / REPLICATES as f64;
            scale = sums.map(|sum| (whole - sum) / stiffness);
        }
        let power_mean = |c: usize| (mean(&|s| s.plain_power[c]), mean(&|s| s.link_power[c]));
        Deviation {
            scale: scale.map(|s| s as f32),
            link_yield: power as f32,
            response: std::array::from_fn(|c| {
                let (plain, links) = power_mean(c);
                ((plain + power * links) / self.areas[i]) as f32
            }),
            irradiance: std::array::from_fn(|c| {
                let (plain, links) = power_mean(c);
                std::array::from_fn(|k| {
                    let power = f64::from(replicates[k].plain_power[c] + replicates[k].link_power[c]);
                    ((power - (plain + links)) / self.areas[i]) as f32
                })
            }),
        }
    }
}
