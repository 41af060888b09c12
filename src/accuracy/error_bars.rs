//! Error bars: the standard error of every patch's irradiance from sampling the form factors.
//!
//! The rays of every patch are divided into K parts, the replicates. Replicate k alone gives direct light D + dD_k and
//! form factors F + dF_k. To first order its irradiance deviates by
//!
//!   dE_k = dD_k + dF_k U + F ρ dE_k
//!
//! where U is the radiosity that form factors carry: all light except the emission of lamps. The first term comes from
//! shadow rays. The second comes from the hemisphere rays of the replicate, including their closure. These two are
//! independent. The third term is the error that a patch inherits through the light of other patches. It is summed as a
//! Neumann series.
//!
//! If the K replicates were independent, the standard error of their mean would be sqrt(Σ dE_k² / (K (K - 1))). But
//! they are parts of one stratified sequence, so their mean has a smaller error. The gain differs between patches; see
//! `stratification`.

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

/// Largest number of terms of a Neumann series. Error bars need a relative accuracy of a few percent only.
const MOST_BOUNCES: usize = 40;
/// A series ends when a term changes the root mean square of the deviations by less than this share.
const ENOUGH: f64 = 0.01;

/// In the first model, the variance of the mean of a run of rays falls with one power of the run's length. The smallest
/// and largest allowed power are those of independent rays, and of scrambled nets with smooth integrands (Owen,
/// "Scrambled net variance for integrals of smooth functions", Annals of Statistics 25, 1997). A steeper observed power
/// is chance.
const RATES: (f64, f64) = (1.0, 3.0);

/// In the second model, a part of the integrand has edges and the rest is smooth. The variances of the two parts fall
/// with these powers. In d dimensions the power of the first part is 1 + 1/d (He and Wang, "On the Convergence Rate of
/// Randomized Quasi-Monte Carlo for Discontinuous Functions", SIAM Journal on Numerical Analysis 53, 2015). Rays have
/// four dimensions, but an edge need not cut all of them.
///
/// The mean of both models is used. At 64 to 1024 rays, the 95 % confidence intervals of the first model contained the
/// truth for 93.8 to 97.3 % of patches on the five scenes of the example `calibration`, but only for 88 % in a box with
/// two spheres. With the second model these were 92.0 to 98.0 %, and 95 % in the box.
const POWERS: [f64; 2] = [1.3, 3.0];

/// Weight of the mean over all patches, as a number of patches, when it is combined with a run of siblings to estimate
/// the gain from stratification. The gain differs between places, but a few patches alone determine it badly. In the
/// scene door-ajar, whose second room is lit by rare paths, 95 % confidence intervals from the mean alone contained the
/// truth for 91 % of patches at 64 rays, and for 92 % at 256. With a weight of 16 it is 94 %. With a weight of 4, other
/// scenes lose a percent.
const PRIOR: f64 = 16.0;

/// Least share of its own variance that a patch keeps if its inherited error compensates its own error.
const LEAST_LEFT: f64 = 0.25;

/// Least share of light lost at a bounce, in the first guess of the importance.
const LEAST_LOSS: f64 = 1e-2;

/// Number of lengths of runs: 1, 2, 4, ... replicates.
const LEVELS: usize = REPLICATES.ilog2() as usize;

/// Least relative standard error. Even exactly known light is stored in single precision, and row sums are closed to a
/// tolerance of some millionths.
const LEAST: f64 = 1e-5;

/// 97.5 % quantile of Student's t distribution with K - 1 = 15 degrees of freedom. The 95 % confidence interval of a
/// patch is E ± this factor times its standard error.
pub const T_QUANTILE: f64 = 2.131;

/// Standard errors of irradiance, W/m², with interleaved channels.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ErrorBars {
    /// Number of channels: 1 or 3.
    pub channels: usize,
    /// The standard error of each patch and channel, W/m².
    pub standard_error: Vec<f64>,
    /// The standard error of the area-weighted mean irradiance of all patches, W/m² per channel. It is smaller than for
    /// patches with independent errors, because light that one patch receives too much is missing at another.
    pub of_mean: Vec<f64>,
    /// The standard error of the power that escapes, W per channel.
    pub of_escaped: Vec<f64>,
    /// The standard error of the power that enters from lights that are no surfaces, for each channel.
    pub of_entered: Vec<f64>,
}

impl ErrorBars {
    /// Estimates the error bars of a solution. `None` if its form factors were not sampled.
    ///
    /// # Panics
    /// If the sizes disagree.
    pub fn of<'a>(
        form_factors: &FormFactors,
        radiometry: impl Into<Radiometry<'a>>,
        solution: &Solution,
    ) -> Option<ErrorBars> {
        Self::of_radiometry(form_factors, radiometry.into(), solution)
    }

    fn of_radiometry(
        form_factors: &FormFactors,
        radiometry: Radiometry<'_>,
        solution: &Solution,
    ) -> Option<ErrorBars> {
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
        // Divided by `unit`, the values fit single precision.
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
        let of_entered = direct.as_ref().map_or_else(
            || vec![0.0; C],
            |direct| direct.entered_deviations.iter().map(|d| unit * variance_of(d).sqrt()).collect(),
        );
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
        Some(ErrorBars { channels: C, standard_error, of_mean, of_escaped, of_entered })
    }
}

/// The standard errors of all patches and channels. The variance of a patch is averaged with the mean variance of its
/// siblings, up to 16 patches of a triangle: the patch's own variance has only 15 degrees of freedom and does not
/// include rare paths that its rays missed.
///
/// `local` and `own` are the deviations of the replicates without inherited errors: per channel, and summed over the
/// channels. `strata` are those of the summed deviations with inherited errors. The inherited variance is distributed
/// over the channels by the square of their share of the irradiance.
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

/// Statistics of the replicates that determine the gain from stratification, summed over patches.
#[derive(Debug, Clone, Copy, Default)]
struct Strata {
    /// Squares of the standard errors of the mean if the replicates were independent.
    spread: f64,
    /// For each length of runs, the mean square of half the difference of neighbouring runs.
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

    /// Combines these statistics with the typical ones, whose weight is `share` times the weight of these.
    fn beside(&self, typical: &Strata, share: f64) -> Strata {
        let weight = share * self.spread / typical.spread;
        // Without any spread the weight is not finite, and the typical values do not matter.
        self.plus(typical, if weight.is_finite() { weight } else { 0.0 })
    }

    /// The ratio of the standard error of the mean to its value for independent replicates. At most 1.
    fn factor(&self) -> f64 {
        if !(self.spread > 0.0) || self.halves.contains(&0.0) {
            return 1.0;
        }
        let one = variance_of_all(&self.halves, REPLICATES, RATES);
        let two = variance_of_nets(&self.halves, REPLICATES, POWERS);
        (0.5 * (one + two) / self.spread).sqrt().min(1.0)
    }
}

/// Area-weighted root mean square of `values`, relative to the area-weighted mean irradiance. Both have interleaved
/// channels. Zero if the mean irradiance is zero.
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

/// The importance of each patch: the flux that all patches together receive in addition per additional flux that this
/// patch receives. It satisfies v = 1 + ρ F v. Because form factors are reciprocal, this is the radiosity of a scene in
/// which all patches emit 1. The iteration starts from the value that each patch would have if the others were all like
/// the mean.
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

/// Deviations of the escaped power of each replicate, per channel. They have three sources: light that escapes straight
/// from lamps, deviations of the patches' escaped shares, and local deviations of irradiance, of which a part is
/// reflected and finally escapes.
fn escaped_deviations<const C: usize>(
    form_factors: &FormFactors,
    reflectance: &[[f64; C]],
    carried: &[[f64; C]],
    local: &[Deviation<C>],
    direct: Option<&DirectLight<C>>,
) -> Option<[[f64; REPLICATES]; C]> {
    let (areas, escaped) = (form_factors.areas(), form_factors.escaped());
    // The part of additional flux on a patch that finally escapes: v = ρ e + ρ F v.
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

/// Two deviations of each patch, summed over the channels: the local deviations, and the deviations dE_k that include
/// inherited errors. The inherited part is propagated in a single channel, because in most scenes it is small and
/// similar in all channels.
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
    // The mean reflectance for inherited deviations, weighted by the irradiance of the channels.
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

/// Variance of the mean of independent replicates, from their deviations, which sum to zero up to rounding.
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
        // The expected value is sqrt((2² + 3 · 1²) / 4) / ((1 + 3 · 5) / 4).
        let relative = relative_rms(&[2.0, 1.0], &[1.0, 5.0], &[1.0, 3.0]);
        assert!((relative - 1.75f64.sqrt() / 4.0).abs() < 1e-14);
        assert_eq!(relative_rms(&[0.0, 0.0], &[0.0, 0.0], &[1.0, 3.0]), 0.0);
    }
}
