//! Error bars: the standard error of every patch's irradiance that comes from sampling the form factors.
//!
//! The rays of every patch are taken as K parts, the replicates. Replicate k, by itself, gives form factors F_k = F + dF_k,
//! and to first order the irradiance
//!
//!   dE_k = dF_k B + F ρ dE_k
//!
//! The first term is summed from the rays of the replicate, its closure included; the second, the error that a patch
//! inherits through the light of others, is a Neumann series. The spread of dE_k over the K replicates would give
//! the standard error of their mean, sqrt(Σ dE_k² / (K (K - 1))), were they independent; they are parts of one sequence,
//! and together better than that, here more and there less: see `stratification`.

use rayon::prelude::*;

use crate::{
    form_factor::{
        FormFactors,
        hemisphere::REPLICATES,
        magnitude, ordered_sum,
        replicates::Deviation,
        siblings::with_mean,
        stratification::{half_differences, variance_of_all, variance_of_nets},
        together,
    },
    solve::{Radiometry, Solution},
};

/// Terms of the Neumann series at most. Error bars need no more than a few percent of themselves.
const MOST_BOUNCES: usize = 40;
/// The series ends when a term changes the root mean square of the deviations by less than this share.
const ENOUGH: f64 = 0.01;

/// The variance of a run of rays falls with some power of its length: at least and at most as that of independent rays, or of
/// scrambled nets where all is smooth (Owen, "Scrambled net variance for integrals of smooth functions", Annals of Statistics 25,
/// 1997). Steeper ones are luck.
const RATES: (f64, f64) = (1.0, 3.0);

/// Or it is partly smooth, partly cut by edges, and these fall with powers of their own: the latter, in d dimensions, with 1 + 1/d
/// (He and Wang, "On the Convergence Rate of Randomized Quasi-Monte Carlo for Discontinuous Functions", SIAM Journal on Numerical
/// Analysis 53, 2015). Rays have four, of which an edge need not cut all.
///
/// The mean of both is taken. At 64 to 1024 rays intervals of 95 % held, with one power, 93.8 to 97.3 % of patches on the five scenes
/// of the example `calibration`, but 88 % in a box with two spheres; with two 92.0 to 98.0, and 95 % there.
const POWERS: [f64; 2] = [1.3, 3.0];

/// How many patches the mean of all counts as, beside a run of siblings, where it is told how much better the parts are together:
/// it differs from place to place, but few patches tell it badly. In door-ajar, whose second room is lit by rare paths, the mean
/// alone held 91 % of patches at 64 rays in 95 % intervals, and 92 % at 256; with 16 it is 94 %. With 4, others lose a percent.
const PRIOR: f64 = 16.0;

/// The least share of its own variance that a patch keeps where what it inherits makes up for it.
const LEAST_LEFT: f64 = 0.25;

/// The least share of light that is taken to be lost at a bounce, where importance is guessed.
const LEAST_LOSS: f64 = 1e-2;

/// Lengths of runs: 1, 2, 4, ... replicates.
const LEVELS: usize = REPLICATES.ilog2() as usize;

/// The least relative standard error. Light that is known exactly is still stored in single precision, and shares in what rows
/// are settled to: some millionths.
const LEAST: f64 = 1e-5;

/// 97.5 % quantile of Student's t distribution with K - 1 = 15 degrees of freedom: E ± this times its standard error
/// is the 95 % interval of a patch.
pub const T_QUANTILE: f64 = 2.131;

/// Standard errors of irradiance, W/m², `channels` interleaved values a patch.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ErrorBars {
    /// 1 or 3.
    pub channels: usize,
    /// The standard error of each patch and channel.
    pub standard_error: Vec<f64>,
    /// The standard error of the area-weighted mean irradiance of all patches, for each channel: less than patches
    /// with independent errors would give, since what one patch receives too much another misses.
    pub of_mean: Vec<f64>,
}

impl ErrorBars {
    /// Estimates the error bars of a solution; `None` when its form factors were not sampled.
    ///
    /// # Panics
    /// When the sizes disagree.
    pub fn of<'a>(
        form_factors: &FormFactors,
        radiometry: impl Into<Radiometry<'a>>,
        solution: &Solution,
    ) -> Option<ErrorBars> {
        let reflectance = radiometry.into().reflectance;
        assert_eq!(reflectance.len(), solution.radiosity.len(), "sizes disagree");
        together(|| match solution.channels {
            1 => Self::spread::<1>(form_factors, reflectance.as_chunks().0, solution),
            _ => Self::spread::<3>(form_factors, reflectance.as_chunks().0, solution),
        })
    }

    fn spread<const C: usize>(
        form_factors: &FormFactors,
        reflectance: &[[f64; C]],
        solution: &Solution,
    ) -> Option<ErrorBars> {
        let unit = magnitude(&solution.radiosity);
        // Divided by it, single precision holds them.
        let scaled: Vec<[f64; C]> =
            solution.radiosity.as_chunks::<C>().0.iter().map(|x| x.map(|x| x / unit)).collect();
        let local = form_factors.deviations(&scaled)?;
        let areas = form_factors.areas();
        let total: f64 = areas.iter().sum();
        let mut mean = [[0f64; REPLICATES]; C];
        for ((area, importance), local) in areas.iter().zip(importance(form_factors, reflectance)).zip(&local)
        {
            for c in 0..C {
                let weight = area / total * f64::from(importance[c]);
                for k in 0..REPLICATES {
                    mean[c][k] += weight * f64::from(local[c][k]);
                }
            }
        }
        let [own, all] = propagate(form_factors, reflectance, solution, &local);
        let strata: Vec<Strata> = all.par_iter().with_min_len(256).map(Strata::of).collect();
        // What comes from all others' shadow rays is stratified otherwise than what a patch's own rays tell. Of two patches of a
        // lamp luck would tell; another patch beside them keeps it within bounds.
        let is_source = |i: &usize| form_factors.is_source(*i);
        let patches = 0..strata.len();
        let others = Strata::sum(&strata, patches.clone().filter(|i| !is_source(i)), |i| areas[i]);
        let sources = Strata::sum(&strata, patches.clone().filter(is_source), |i| areas[i])
            .beside(&others, 1.0 / patches.filter(is_source).count() as f64);
        let mut standard_error = smoothed_errors(form_factors, solution, &local, &own, &strata);
        let (moved, radiosity) = (form_factors.moved(), solution.radiosity.as_chunks::<C>().0);
        let brightest: [f64; C] = std::array::from_fn(|c| radiosity.iter().map(|b| b[c]).fold(0.0, f64::max));
        for family in form_factors.siblings() {
            let typical = if is_source(&family.start) { &sources } else { &others };
            let near = Strata::sum(&strata, family.clone(), |_| 1.0);
            let stratified = near.beside(typical, PRIOR / family.len() as f64).factor();
            for i in family.clone() {
                let (unseen, moved) = (form_factors.unseen(i), moved(i));
                for q in C * i..C * (i + 1) {
                    let irradiance = solution.irradiance[q];
                    // Rows still sum to one: what was moved counts as far as what the patch sees differs, of which this is the most
                    // (Bhatia and Davis, "A better bound on the variance", American Mathematical Monthly 107, 2000).
                    let differs =
                        (irradiance * (brightest[q % C] - irradiance)).max(0.0).sqrt().min(irradiance);
                    standard_error[q] = (unit * stratified * standard_error[q])
                        .hypot(moved * differs)
                        .hypot(LEAST * irradiance)
                        .hypot(unseen * solution.radiosity[q]);
                }
            }
        }
        let of_mean = |deviations| unit * others.factor() * variance_of(deviations).sqrt();
        let of_mean = mean.iter().map(of_mean).collect();
        Some(ErrorBars { channels: C, standard_error, of_mean })
    }
}

/// The standard errors of all patches and channels: the variance of a patch is taken together with the mean of its
/// siblings, up to 16 patches of a triangle. By itself it has 15 degrees of freedom, and knows nothing of rare paths that
/// its own rays have missed.
///
/// `own` is what the replicates of a patch deviate by, the channels together, without what it inherits, `strata` tell of it with
/// that: which is shared out among the channels as its irradiance is.
fn smoothed_errors<const C: usize>(
    form_factors: &FormFactors,
    solution: &Solution,
    local: &[Deviation<C>],
    own: &[[f32; REPLICATES]],
    strata: &[Strata],
) -> Vec<f64> {
    let variance = |deviation: &[f32; REPLICATES]| variance_of(&deviation.map(f64::from));
    let of_patch = |i: usize| -> [f64; C] {
        let irradiance = &solution.irradiance[C * i..][..C];
        let inherited = strata[i].spread - variance(&own[i]);
        let light = irradiance.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        std::array::from_fn(|c| {
            let own = variance(&local[i][c]);
            (own + inherited * (irradiance[c] / light).powi(2)).max(LEAST_LEFT * own)
        })
    };
    let variances: Vec<[f64; C]> = (0..local.len()).into_par_iter().with_min_len(256).map(of_patch).collect();
    with_mean(form_factors.siblings(), &variances, |own, mean| (0.5 * (own + mean)).sqrt())
}

/// How well the parts of sequences complement each other: sums over patches.
#[derive(Debug, Clone, Copy, Default)]
struct Strata {
    /// Squares of the standard errors that the whole would have, were its parts independent.
    spread: f64,
    /// Mean squares of half the difference of neighbouring runs of each length.
    halves: [f64; LEVELS],
}

impl Strata {
    fn of(deviation: &[f32; REPLICATES]) -> Strata {
        let mut runs = deviation.map(f64::from);
        Strata { spread: variance_of(&runs), halves: half_differences(&mut runs) }
    }

    fn sum(strata: &[Strata], patches: impl Iterator<Item = usize>, weight: impl Fn(usize) -> f64) -> Strata {
        patches.fold(Strata::default(), |sum, i| sum.plus(&strata[i], weight(i)))
    }

    fn plus(&self, other: &Strata, weight: f64) -> Strata {
        Strata {
            spread: self.spread + weight * other.spread,
            halves: std::array::from_fn(|k| self.halves[k] + weight * other.halves[k]),
        }
    }

    /// This, and what is typical with so many times its weight.
    fn beside(&self, typical: &Strata, share: f64) -> Strata {
        let weight = share * self.spread / typical.spread;
        // Where nothing spreads there is nothing to tell.
        self.plus(typical, if weight.is_finite() { weight } else { 0.0 })
    }

    /// The standard error of the whole over what its parts would have, were they independent: at most 1.
    fn factor(&self) -> f64 {
        if !(self.spread > 0.0) || self.halves.contains(&0.0) {
            return 1.0;
        }
        let one = variance_of_all(&self.halves, REPLICATES, RATES);
        let two = variance_of_nets(&self.halves, REPLICATES, POWERS);
        (0.5 * (one + two) / self.spread).sqrt().min(1.0)
    }
}

/// Area-weighted root mean square of `values`, interleaved channels a patch, relative to the area-weighted mean
/// irradiance; zero in the dark.
pub fn relative_rms(values: &[f64], irradiance: &[f64], areas: &[f64]) -> f64 {
    let channels = values.len() / areas.len();
    let (mut squares, mut mean, mut weight) = (0.0, 0.0, 0.0);
    for q in 0..values.len() {
        let area = areas[q / channels];
        squares += area * values[q].powi(2);
        mean += area * irradiance[q];
        weight += area;
    }
    if mean > 0.0 { (squares / weight).sqrt() / (mean / weight) } else { 0.0 }
}

/// What all patches together receive more of one more unit that each receives: v = 1 + ρ F v, the radiosity of a scene in which
/// all shine alike, since form factors are reciprocal. From what it would be were every patch like the mean of all.
fn importance<const C: usize>(form_factors: &FormFactors, reflectance: &[[f64; C]]) -> Vec<[f32; C]> {
    let (areas, escaped) = (form_factors.areas(), form_factors.escaped());
    let returned = |i: usize, c: usize| reflectance[i][c] * (1.0 - escaped[i]);
    let area: f64 = areas.iter().sum();
    let mean: [f64; C] = std::array::from_fn(|c| {
        let lost: f64 = (0..areas.len()).map(|i| areas[i] * (1.0 - returned(i, c))).sum();
        area / lost.max(LEAST_LOSS * area)
    });
    let mut importance: Vec<[f32; C]> =
        (0..areas.len()).map(|i| std::array::from_fn(|c| (1.0 + returned(i, c) * mean[c]) as f32)).collect();
    let mut arriving = vec![[0f32; C]; areas.len()];
    for _ in 0..MOST_BOUNCES {
        form_factors.irradiance_into::<f32, C>(importance.as_flattened(), arriving.as_flattened_mut());
        let rows = importance.par_iter_mut().zip(&arriving).zip(reflectance).with_min_len(256);
        let change: Vec<f32> = rows
            .map(|((v, arriving), rho)| {
                let next: [f32; C] = std::array::from_fn(|c| 1.0 + rho[c] as f32 * arriving[c]);
                let change = (0..C).map(|c| (next[c] / v[c] - 1.0).abs()).fold(0.0, f32::max);
                *v = next;
                change
            })
            .collect();
        if ordered_sum(areas.len(), |i| areas[i] * f64::from(change[i])) <= ENOUGH * area {
            break;
        }
    }
    importance
}

/// Sums over the channels of dF_k B, which are `local`, and of dE_k. One channel serves for all: what patches inherit is the small
/// part in most scenes, and alike in all channels.
fn propagate<const C: usize>(
    form_factors: &FormFactors,
    reflectance: &[[f64; C]],
    solution: &Solution,
    local: &[Deviation<C>],
) -> [Vec<[f32; REPLICATES]>; 2] {
    let sum = |local: &Deviation<C>, weight: [f32; C]| -> [f32; REPLICATES] {
        std::array::from_fn(|k| (0..C).map(|c| weight[c] * local[c][k]).sum())
    };
    let own: Vec<[f32; REPLICATES]> =
        local.par_iter().with_min_len(256).map(|local| sum(local, [1.0; C])).collect();
    // What is inherited is reflected as the irradiance is.
    let mean = |rho: &[f64; C], e: &[f64]| {
        let all: f64 = e.iter().sum();
        if all > 0.0 { (0..C).map(|c| rho[c] * e[c] / all).sum() } else { 0.0 }
    };
    let irradiance = solution.irradiance.par_chunks_exact(C);
    let means: Vec<f64> =
        reflectance.par_iter().zip(irradiance).with_min_len(256).map(|(rho, e)| mean(rho, e)).collect();
    let (mut total, mut reflected) = (own.clone(), vec![[0.0; REPLICATES]; own.len()]);
    let mut size = root_mean_square(&total);
    for _ in 0..MOST_BOUNCES {
        reflected.par_iter_mut().enumerate().with_min_len(256).for_each(|(i, reflected)| {
            *reflected = sum(&local[i], reflectance[i].map(|rho| rho as f32));
            for k in 0..REPLICATES {
                reflected[k] += means[i] as f32 * (total[i][k] - own[i][k]);
            }
        });
        form_factors.irradiance_into::<f32, REPLICATES>(reflected.as_flattened(), total.as_flattened_mut());
        total.par_iter_mut().zip(&own).with_min_len(256).for_each(|(total, own)| {
            for k in 0..REPLICATES {
                total[k] += own[k];
            }
        });
        let before = size;
        size = root_mean_square(&total);
        if (size - before).abs() <= ENOUGH * size {
            break;
        }
    }
    [own, total]
}

/// Variance of the mean of deviations, which sum to zero but for rounding.
fn variance_of(deviations: &[f64; REPLICATES]) -> f64 {
    let many = REPLICATES as f64;
    let squares: f64 = deviations.iter().map(|d| d * d).sum();
    squares / (many * (many - 1.0))
}

fn root_mean_square(values: &[[f32; REPLICATES]]) -> f64 {
    let squares = |i: usize| values[i].iter().map(|&v| f64::from(v).powi(2)).sum::<f64>();
    (ordered_sum(values.len(), squares) / values.len() as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_root_mean_square_is_weighted_by_area() {
        // sqrt((2^2 + 3 * 1^2) / 4) over (1 + 3 * 5) / 4.
        let relative = relative_rms(&[2.0, 1.0], &[1.0, 5.0], &[1.0, 3.0]);
        assert!((relative - 1.75f64.sqrt() / 4.0).abs() < 1e-14);
        assert_eq!(relative_rms(&[0.0, 0.0], &[0.0, 0.0], &[1.0, 3.0]), 0.0);
    }
}
