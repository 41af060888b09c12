//! Error bars: the standard error of every patch's irradiance that comes from sampling the form factors.
//!
//! The rays of every patch are taken as K parts, the replicates. Replicate k, by itself, gives direct light D + dD_k and form
//! factors F + dF_k, and to first order the irradiance is off by
//!
//!   dE_k = dD_k + dF_k U + F ρ dE_k
//!
//! where U is what form factors carry, all light but what lamps emit. The first term is that of shadow rays, the second is summed
//! from the hemisphere rays of the replicate, its closure included; the two are independent. The third, the error that a patch
//! inherits through the light of others, is a Neumann series. The spread of dE_k over the K replicates would give
//! the standard error of their mean, sqrt(Σ dE_k² / (K (K - 1))), were they independent; they are parts of one sequence,
//! and together better than that, here more and there less: see `stratification`.

use rayon::prelude::*;

use crate::{
    direct::{Deviation, DirectLight},
    form_factor::{
        FormFactors, magnitude, ordered_sum,
        rays::REPLICATES,
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
    /// The standard error of the power that escapes, W, for each channel.
    pub of_escaped: Vec<f64>,
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
        let radiometry = radiometry.into();
        assert_eq!(radiometry.reflectance.len(), solution.radiosity.len(), "sizes disagree");
        together(|| match solution.channels {
            1 => Self::spread::<1>(form_factors, radiometry, solution),
            _ => Self::spread::<3>(form_factors, radiometry, solution),
        })
    }

    fn spread<const C: usize>(
        form_factors: &FormFactors,
        radiometry: Radiometry<'_>,
        solution: &Solution,
    ) -> Option<ErrorBars> {
        let reflectance: &[[f64; C]] = radiometry.reflectance.as_chunks().0;
        let unit = magnitude(&solution.radiosity);
        // Divided by it, single precision holds them.
        let scaled = |b: &[f64; C]| b.map(|b| b / unit);
        let emission: Vec<[f64; C]> = radiometry.emission.as_chunks().0.iter().map(scaled).collect();
        let mut carried: Vec<[f64; C]> = solution.radiosity.as_chunks().0.iter().map(scaled).collect();
        for (i, b) in carried.iter_mut().enumerate().filter(|&(i, _)| form_factors.is_lamp(i)) {
            *b = std::array::from_fn(|c| b[c] - emission[i][c]);
        }
        let mut local = form_factors.deviations(&carried)?;
        let direct = form_factors.direct(&emission, unit);
        for (local, direct) in local.iter_mut().zip(direct.iter().flat_map(|direct| &direct.deviations)) {
            let values = local.as_flattened_mut().iter_mut().zip(direct.as_flattened());
            values.for_each(|(local, direct)| *local += direct);
        }
        if let Some(linear) = &solution.linear {
            let scale = (linear.unit / unit) as f32;
            for (local, more) in local.as_flattened_mut().iter_mut().zip(&linear.deviations) {
                local.iter_mut().zip(more).for_each(|(local, more)| *local += scale * more);
            }
        }
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
        let escaped = escaped_deviations(form_factors, reflectance, &carried, &local, direct.as_ref())?;
        let of_escaped = escaped.iter().map(|deviations| unit * variance_of(deviations).sqrt()).collect();
        let [own, all] = propagate(form_factors, reflectance, solution, &local);
        let strata: Vec<Strata> = all.par_iter().with_min_len(256).map(Strata::of).collect();
        let typical = Strata::sum(&strata, 0..strata.len(), |i| areas[i]);
        let mut standard_error = smoothed_errors(form_factors, solution, &local, &own, &strata);
        for family in form_factors.siblings() {
            let near = Strata::sum(&strata, family.clone(), |_| 1.0);
            let stratified = near.beside(&typical, PRIOR / family.len() as f64).factor();
            for i in family.clone() {
                let unseen = form_factors.unseen(i);
                for q in C * i..C * (i + 1) {
                    let irradiance = solution.irradiance[q];
                    standard_error[q] = (unit * stratified * standard_error[q])
                        .hypot(LEAST * irradiance)
                        .hypot(unseen * solution.radiosity[q]);
                }
            }
        }
        let of_mean = |deviations| unit * typical.factor() * variance_of(deviations).sqrt();
        let of_mean = mean.iter().map(of_mean).collect();
        Some(ErrorBars { channels: C, standard_error, of_mean, of_escaped })
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

/// By how much what escapes deviates in each replicate: straight from lamps, by the escaped shares themselves, and of what local
/// deviations bring to patches, what is reflected and escapes in the end.
fn escaped_deviations<const C: usize>(
    form_factors: &FormFactors,
    reflectance: &[[f64; C]],
    carried: &[[f64; C]],
    local: &[Deviation<C>],
    direct: Option<&DirectLight<C>>,
) -> Option<[[f64; REPLICATES]; C]> {
    let (areas, escaped) = (form_factors.areas(), form_factors.escaped());
    // Of one more unit that a patch receives, what escapes: v = ρ e + ρ F v.
    let mut v: Vec<[f32; C]> = vec![[0.0; C]; areas.len()];
    let mut arriving = v.clone();
    let total = |v: &[[f32; C]]| ordered_sum(areas.len(), |i| areas[i] * f64::from(v[i].iter().sum::<f32>()));
    let mut size = 0.0;
    for _ in 0..MOST_BOUNCES {
        let rows = v.par_iter_mut().zip(&arriving).zip(reflectance).zip(escaped).with_min_len(256);
        rows.for_each(|(((v, arriving), rho), &e)| {
            *v = std::array::from_fn(|c| rho[c] as f32 * (e as f32 + arriving[c]));
        });
        let before = size;
        size = total(&v);
        if size - before <= ENOUGH * size {
            break;
        }
        form_factors.irradiance_into::<f32, C>(v.as_flattened(), arriving.as_flattened_mut());
    }
    let shares = form_factors.escape_deviations()?;
    Some(std::array::from_fn(|c| {
        std::array::from_fn(|k| {
            let of_patch = |i: usize| {
                let returned = f64::from(v[i][c]) * f64::from(local[i][c][k]);
                areas[i] * (carried[i][c] * f64::from(shares[i][k]) + returned)
            };
            ordered_sum(areas.len(), of_patch) + direct.map_or(0.0, |direct| direct.escaped_deviations[c][k])
        })
    }))
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
