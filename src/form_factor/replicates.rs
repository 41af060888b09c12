//! The replicates taken apart: how the irradiance would vary had only one of them been cast.

use rayon::prelude::*;

use super::{
    Estimator, FormFactors,
    closure::Spread,
    hemisphere::{ESCAPED, Hits, LINKED, REPLICATES},
    reciprocity::Densities,
};

/// What the estimate was made of, kept for the error bars.
#[derive(Debug, Clone)]
pub(super) struct Samples {
    pub(super) hits: Hits,
    pub(super) densities: Densities,
    pub(super) spread: Spread,
    /// Areas in the unit of `densities`.
    pub(super) areas: Vec<f64>,
}

/// Sums over one replicate for a patch: exchange areas and exchanged radiosity, of links and of everything else.
#[derive(Debug, Clone, Copy)]
struct Sums<const C: usize> {
    plain: f32,
    links: f32,
    plain_power: [f32; C],
    link_power: [f32; C],
}

impl<const C: usize> Sums<C> {
    const ZERO: Self = Sums { plain: 0.0, links: 0.0, plain_power: [0.0; C], link_power: [0.0; C] };

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

impl FormFactors {
    /// Standard error of the irradiance of every patch and channel that comes from sampling the form factors, for the
    /// radiosity of a solution; `None` when the form factors were not sampled.
    ///
    /// Each replicate is an independent estimate of every row from 1/[`REPLICATES`] of the rays. The spread of
    /// Σ_j S_ij B_j between them, after the same closure to first order, gives the standard error of their mean. The
    /// error that a patch inherits through the radiosity of others is left out: it is an average over many independent
    /// ones.
    pub fn standard_errors(&self, radiosity: &[f64], channels: usize) -> Option<Vec<f64>> {
        let samples = self.samples.as_ref()?;
        assert_eq!(radiosity.len(), channels * self.len(), "one value a patch and channel is wanted");
        Some(match channels {
            1 => self.spread_of_replicates::<1>(samples, radiosity.as_chunks().0),
            3 => self.spread_of_replicates::<3>(samples, radiosity.as_chunks().0),
            _ => panic!("{channels} channels: there are 1 or 3"),
        })
    }

    fn spread_of_replicates<const C: usize>(&self, samples: &Samples, radiosity: &[[f64; C]]) -> Vec<f64> {
        let replicates: Vec<Vec<Sums<C>>> = (0..REPLICATES)
            .into_par_iter()
            .map(|k| match self.estimator {
                Estimator::OneWay => samples.one_way(k, radiosity),
                Estimator::Pooled => samples.pooled(k, radiosity),
            })
            .collect();
        let mut errors = vec![[0.0; C]; self.len()];
        errors.par_iter_mut().enumerate().with_min_len(256).for_each(|(i, error)| {
            let own: [Sums<C>; REPLICATES] = std::array::from_fn(|k| replicates[k][i]);
            *error = samples.patch_error(i, &own, self.estimator);
        });
        errors.into_flattened()
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
        let Samples { hits, densities, spread, areas } = self;
        let mut all = vec![Sums::<C>::ZERO; areas.len()];
        for i in 0..areas.len() {
            let targets = hits.of_replicate(i, replicate);
            for &j in targets {
                match j {
                    LINKED => {}
                    ESCAPED => all[i].plain += (areas[i] / targets.len() as f64 * spread.plain[i]) as f32,
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

    /// Standard error of the mean of the replicates of patch `i`.
    fn patch_error<const C: usize>(
        &self,
        i: usize,
        replicates: &[Sums<C>; REPLICATES],
        estimator: Estimator,
    ) -> [f64; C] {
        let many = REPLICATES as f64;
        let mean = |value: &dyn Fn(&Sums<C>) -> f32| {
            replicates.iter().map(|s| f64::from(value(s))).sum::<f64>() / many
        };
        let (plain, links) = (mean(&|s| s.plain), mean(&|s| s.links));
        let power = Spread::link_yield(self.hits.sources.probability(i) > 0.0);
        // A replicate whose row sums to more than the mean is scaled down by the closure: d ln d = -excess / stiffness.
        let stiffness = plain + power * links;
        std::array::from_fn(|c| {
            let (plain_power, link_power) = (mean(&|s| s.plain_power[c]), mean(&|s| s.link_power[c]));
            let squares: f64 = replicates
                .iter()
                .map(|s| {
                    let excess = f64::from(s.plain + s.links) - (plain + links);
                    let deviation =
                        f64::from(s.plain_power[c] + s.link_power[c]) - (plain_power + link_power);
                    let closure = match estimator {
                        Estimator::Pooled => excess / stiffness * (plain_power + power * link_power),
                        Estimator::OneWay => 0.0,
                    };
                    (deviation - closure).powi(2)
                })
                .sum();
            (squares / (many * (many - 1.0))).sqrt() / self.areas[i]
        })
    }
}
