//! Error bars: the standard error of every patch's irradiance from sampling the form factors.
//!
//! The rays of every patch are divided into K parts, the replicates. Replicate k alone gives direct light D + dD_k and
//! form factors F + dF_k. To first order its irradiance deviates by
//!
//!   dE_k = dD_k + dF_k U + F ρ dE_k
//!
//! where U is the radiosity that form factors carry: all light except the emission of lamps. The first term comes from
//! shadow rays. The second comes from the hemisphere rays of the replicate, including their closure. These two are
//! independent. The third term is the error that a patch inherits through the light of other patches, over all bounces
//! (`reflected`).
//!
//! If the K replicates were independent, the standard error of their mean would be sqrt(Σ dE_k² / (K (K - 1))). But
//! they are parts of one stratified sequence, so their mean has a smaller error. The gain differs between patches; see
//! `stratification`.

use rayon::prelude::*;

use crate::{
    direct::{Deviation, DirectLight},
    form_factor::{Estimator, FormFactors, magnitude, ordered_sum, together},
    rays::{
        ESCAPED, REPLICATES,
        regions::Regions,
        siblings::with_mean,
        stratification::{half_differences, variance_of_all, variance_of_nets},
    },
    solve::{Radiometry, Solution},
};

/// Largest number of bounces of deviations.
const MOST_BOUNCES: usize = 40;
/// Bounces end when all further ones together change the light by less than this share, in the root mean square. They
/// are added as a geometric series, so that the remaining error is a fraction of this share.
const ENOUGH: f64 = 0.05;
/// The largest ratio of two bounces that the geometric series assumes.
const SLOWEST: f64 = 0.98;
/// Number of patches that show the ratio of two bounces.
const SAMPLE: usize = 4096;
/// The least share of light that is lost in the mean. Below it, single precision does not resolve the loss.
const LEAST_LOSS: f64 = 1e-6;

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

/// Weight of what is known about escape from the neighbours of a patch, as a number of escaping rays of its own. In a
/// sphere of reflectance 0.8 with a port of 0.6 %, 38 and 77 % of the patches were in their 95 % intervals at 64 and 256
/// rays without it. With a weight of 1 it is 97 and 89 %, with 2 98 and 95 %, and with 4 98 and 98 %.
const RARE: f64 = 2.0;

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
        let single = |rho: &[f64; C]| rho.map(|rho| rho as f32);
        let reflectance: Vec<[f32; C]> = radiometry.reflectance.as_chunks().0.iter().map(single).collect();
        let reflectance = &reflectance[..];
        let unit = magnitude(&solution.radiosity);
        // Divided by `unit`, the values fit single precision.
        let scaled = |b: &[f64; C]| b.map(|b| b / unit);
        let emission: Vec<[f64; C]> = radiometry.emission.as_chunks().0.iter().map(scaled).collect();
        let mut carried: Vec<[f64; C]> = solution.radiosity.as_chunks().0.iter().map(scaled).collect();
        for (i, b) in carried.iter_mut().enumerate().filter(|&(i, _)| form_factors.is_lamp(i)) {
            *b = std::array::from_fn(|c| b[c] - emission[i][c]);
        }
        let mut local = form_factors.deviations(&carried)?;
        let shares = form_factors.escape_deviations()?;
        conserve(form_factors, &carried, &shares, &mut local);
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
        let escaped =
            escaped_deviations(form_factors, reflectance, (&carried, &shares), &local, direct.as_ref());
        let of_escaped = escaped.iter().map(|deviations| unit * variance_of(deviations).sqrt()).collect();
        let of_entered = direct.as_ref().map_or_else(
            || vec![0.0; C],
            |direct| direct.entered_deviations.iter().map(|d| unit * variance_of(d).sqrt()).collect(),
        );
        let [own, all] = propagate(form_factors, reflectance, solution, &local);
        // All patches share a part of the inherited deviations, which therefore tell little about stratification.
        let strata: Vec<Strata> = own.par_iter().with_min_len(256).map(Strata::of).collect();
        let typical = Strata::sum(&strata, 0..strata.len(), |i| areas[i]);
        let escaping = escape_variances(form_factors, &shares);
        let missing = |i: usize, c: usize| {
            let lands = 1.0 - form_factors.escaped()[i];
            if escaping[i] == 0.0 || lands <= 0.0 {
                return 0.0;
            }
            let direct = direct.as_ref().map_or(0.0, |direct| direct.irradiance[i][c]);
            let seen = (solution.irradiance[C * i + c] / unit - direct) / lands;
            escaping[i] * seen * seen
        };
        let mut standard_error = smoothed_errors(form_factors, solution, &local, [&own, &all], missing);
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
/// channels. `all` are the summed deviations with inherited errors. The inherited variance is distributed over the
/// channels by the square of their share of the irradiance. `missing` is the variance that the deviations of a patch and
/// channel lack.
fn smoothed_errors<const C: usize>(
    form_factors: &FormFactors,
    solution: &Solution,
    local: &[Deviation<C>],
    [own, all]: [&[[f32; REPLICATES]]; 2],
    missing: impl Fn(usize, usize) -> f64 + Sync,
) -> Vec<f64> {
    let variance = |deviation: &[f32; REPLICATES]| variance_of(&deviation.map(f64::from));
    let of_patch = |i: usize| -> [f64; C] {
        let irradiance = &solution.irradiance[C * i..][..C];
        let inherited = variance(&all[i]) - variance(&own[i]);
        let light = irradiance.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        std::array::from_fn(|c| {
            let own = (variance(&local[i][c]) + missing(i, c)).max(0.0);
            (own + inherited * (irradiance[c] / light).powi(2)).max(LEAST_LEFT * own)
        })
    };
    let variances: Vec<[f64; C]> = (0..local.len()).into_par_iter().with_min_len(256).map(of_patch).collect();
    with_mean(form_factors.siblings(), &variances, |own, mean| (0.5 * (own + mean)).sqrt())
}

/// What the variance of each patch's escaped share lacks, from the deviations `shares` of its replicates.
///
/// If an opening is small, no ray of most patches escapes. Their replicates agree that nothing escapes, and the variance of
/// the few other patches is too large. Hits of a rare target are independent: their variance is that of the binomial
/// distribution. Its probability is the posterior mean for a prior that counts as [`RARE`] escaping rays and has the mean
/// of the siblings. Their prior has the mean of the region (Gelman et al., *Bayesian Data Analysis*, 3rd edition, section
/// 2.4). The binomial variance counts as much as [`RARE`] escaping rays beside the variance that the replicates show.
fn escape_variances(form_factors: &FormFactors, shares: &[[f32; REPLICATES]]) -> Vec<f64> {
    let mut lacking = vec![0.0; shares.len()];
    let (Some(rays), Some(regions)) = (form_factors.ray_set(), form_factors.regions()) else {
        return lacking;
    };
    // Rows of one-way form factors are not closed, so that their errors are those of hits alone.
    if form_factors.estimator() != Estimator::Pooled {
        return lacking;
    }
    // Escaping rays, and all rays.
    let count = |i: usize| {
        let escaped = rays.of(i).iter().filter(|&&j| j == ESCAPED).count();
        [escaped as f64, rays.rays_of(i).into()]
    };
    let counts: Vec<[f64; 2]> = (0..shares.len()).into_par_iter().with_min_len(256).map(count).collect();
    let add = |sum: [f64; 2], count: &[f64; 2]| [sum[0] + count[0], sum[1] + count[1]];
    let mut of_regions = vec![[0.0; 2]; regions.count()];
    for (i, count) in counts.iter().enumerate() {
        of_regions[regions.of(i)] = add(of_regions[regions.of(i)], count);
    }
    for run in form_factors.siblings() {
        let [escaped, all] = of_regions[regions.of(run.start)];
        if escaped == 0.0 {
            continue;
        }
        let near = posterior(counts[run.clone()].iter().fold([0.0; 2], add), escaped / all);
        for i in run.clone().filter(|&i| counts[i][0] < counts[i][1]) {
            let [escaped, all] = counts[i];
            let share = posterior(counts[i], near);
            let shown = variance_of(&shares[i].map(f64::from));
            lacking[i] = RARE / (escaped + RARE) * (share * (1.0 - share) / all - shown);
        }
    }
    lacking
}

/// The share of rays that escape, from the numbers of escaping and of all rays, if [`RARE`] rays had escaped before at the
/// share `prior`.
fn posterior([escaped, all]: [f64; 2], prior: f64) -> f64 {
    (escaped + RARE) / (all + RARE / prior)
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

/// Makes the deviations of each region conserve energy: what form factors bring too much to its patches has not escaped.
/// Closure and calibration make the form factors reciprocal, so that this holds for the light itself. The rays of a
/// replicate alone are not reciprocal. As in the closure, patches with larger variances are corrected more.
fn conserve<const C: usize>(
    form_factors: &FormFactors,
    carried: &[[f64; C]],
    shares: &[[f32; REPLICATES]],
    local: &mut [Deviation<C>],
) {
    let Some(regions) = form_factors.regions().filter(|_| form_factors.estimator() == Estimator::Pooled)
    else {
        return;
    };
    // In a unit in which squares of areas are in range.
    let unit = magnitude(form_factors.areas());
    let areas: Vec<f64> = form_factors.areas().iter().map(|area| area / unit).collect();
    let variance = |deviation: &[f32; REPLICATES]| variance_of(&deviation.map(f64::from));
    let mut variances = vec![[0.0; C]; regions.count()];
    let mut too_much = vec![[[0.0; REPLICATES]; C]; regions.count()];
    for i in 0..local.len() {
        let region = regions.of(i);
        for c in 0..C {
            variances[region][c] += areas[i] * areas[i] * variance(&local[i][c]);
            for k in 0..REPLICATES {
                let escaped = carried[i][c] * f64::from(shares[i][k]);
                too_much[region][c][k] += areas[i] * (f64::from(local[i][c][k]) + escaped);
            }
        }
    }
    local.par_iter_mut().enumerate().with_min_len(256).for_each(|(i, local)| {
        let region = regions.of(i);
        for c in (0..C).filter(|&c| variances[region][c] > 0.0) {
            let share = areas[i] * variance(&local[c]) / variances[region][c];
            for k in 0..REPLICATES {
                local[c][k] -= (share * too_much[region][c][k]) as f32;
            }
        }
    });
}

/// Solves y = s + ρ F y, approximately, for `K` columns with the same reflectances (`R` is 1) or one for each (`R` is
/// `K`).
///
/// In a bright room with a small opening, an error that all patches share fades slowly, however small each bounce of it
/// is beside the own errors of patches. So every bounce also adds a multiple of ρ in each region such that the power
/// that arrives is the power that is absorbed or escapes: a coarse-grid correction with one cell a region (Galerkin's
/// method). It is the projection of the remaining error in the energy norm, so that bounces still converge. The last
/// ratio of two bounces gives the sum of all further ones.
fn reflected<const K: usize, const R: usize>(
    form_factors: &FormFactors,
    source: &[[f32; K]],
    reflectance: &[[f32; R]],
) -> Vec<[f32; K]> {
    let (areas, n) = (form_factors.areas(), source.len());
    let regions = form_factors.regions();
    let (region, count) = (|i: usize| regions.map_or(0, |r| r.of(i)), regions.map_or(1, Regions::count));
    let precise: Vec<[f64; R]> = reflectance.iter().map(|rho| rho.map(f64::from)).collect();
    let mut returned = vec![[0f64; R]; n];
    form_factors.irradiance_into::<f64, R>(precise.as_flattened(), returned.as_flattened_mut());
    // All light that is reflected once, and the part of it that is not reflected again.
    let (mut all, mut lost) = (vec![[0.0; R]; count], vec![[0.0; R]; count]);
    for i in 0..n {
        for r in 0..R {
            all[region(i)][r] += areas[i] * precise[i][r];
            lost[region(i)][r] += areas[i] * precise[i][r] * (1.0 - returned[i][r]);
        }
    }
    let (mut light, mut change) = (vec![[0f32; K]; n], vec![[0f32; K]; n]);
    // Where plates face each other, bounces change their sign. A sample of the patches shows the signed ratio.
    let sample = |change: &[[f32; K]]| -> Vec<f32> {
        change.iter().step_by(n.div_ceil(SAMPLE)).flatten().copied().collect()
    };
    let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(a * b)).sum::<f64>();
    let (mut last, mut sampled) = (f64::INFINITY, Vec::new());
    for bounce in 1..=MOST_BOUNCES {
        if bounce > 1 {
            form_factors.irradiance_into::<f32, K>(light.as_flattened(), change.as_flattened_mut());
        }
        change.par_iter_mut().enumerate().with_min_len(256).for_each(|(i, change)| {
            for k in 0..K {
                change[k] = source[i][k] + reflectance[i][k % R] * change[k] - light[i][k];
            }
        });
        let mut shared = vec![[0f64; K]; count];
        for (i, change) in change.iter().enumerate() {
            let shared = &mut shared[region(i)];
            (0..K).for_each(|k| shared[k] += areas[i] * f64::from(change[k]));
        }
        for (shared, (all, lost)) in shared.iter_mut().zip(all.iter().zip(&lost)) {
            for k in 0..K {
                shared[k] *= if lost[k % R] > LEAST_LOSS * all[k % R] { 1.0 / lost[k % R] } else { 0.0 };
            }
        }
        light.par_iter_mut().zip(&mut change).enumerate().with_min_len(256).for_each(
            |(i, (light, change))| {
                let shared = &shared[region(i)];
                for k in 0..K {
                    change[k] += (shared[k] * precise[i][k % R] * returned[i][k % R]) as f32;
                    light[k] += change[k];
                }
            },
        );
        let size = root_mean_square(&change);
        let ratio = if size > 0.0 { (size / last).min(SLOWEST) } else { 0.0 };
        let left = size * ratio / (1.0 - ratio);
        let before = std::mem::replace(&mut sampled, sample(&change));
        if bounce > 1 && left <= ENOUGH * root_mean_square(&light) || bounce == MOST_BOUNCES {
            let squares = dot(&before, &before);
            let signed = if squares > 0.0 { dot(&before, &sampled) / squares } else { 0.0 };
            let signed = signed.clamp(-SLOWEST, SLOWEST);
            let rest = signed / (1.0 - signed);
            light.par_iter_mut().zip(&change).with_min_len(256).for_each(|(light, change)| {
                (0..K).for_each(|k| light[k] += rest as f32 * change[k]);
            });
            break;
        }
        last = size;
    }
    light
}

/// The importance of each patch: the flux that all patches together receive in addition per additional flux that this
/// patch receives. It satisfies v = 1 + ρ F v. Because form factors are reciprocal, this is the radiosity of a scene in
/// which all patches emit 1.
fn importance<const C: usize>(form_factors: &FormFactors, reflectance: &[[f32; C]]) -> Vec<[f32; C]> {
    reflected(form_factors, &vec![[1.0; C]; reflectance.len()], reflectance)
}

/// Deviations of the escaped power of each replicate, per channel. They have three sources: light that escapes straight
/// from lamps, deviations of the patches' escaped shares, and local deviations of irradiance, of which a part is
/// reflected and finally escapes.
fn escaped_deviations<const C: usize>(
    form_factors: &FormFactors,
    reflectance: &[[f32; C]],
    (carried, shares): (&[[f64; C]], &[[f32; REPLICATES]]),
    local: &[Deviation<C>],
    direct: Option<&DirectLight<C>>,
) -> [[f64; REPLICATES]; C] {
    let (areas, escaped) = (form_factors.areas(), form_factors.escaped());
    // The part of additional flux on a patch that finally escapes: v = ρ e + ρ F v.
    let escaping = |(rho, &e): (&[f32; C], &f64)| rho.map(|rho| rho * e as f32);
    let source: Vec<[f32; C]> = reflectance.iter().zip(escaped).map(escaping).collect();
    let v = reflected(form_factors, &source, reflectance);
    std::array::from_fn(|c| {
        std::array::from_fn(|k| {
            let of_patch = |i: usize| {
                let returned = f64::from(v[i][c]) * f64::from(local[i][c][k]);
                areas[i] * (carried[i][c] * f64::from(shares[i][k]) + returned)
            };
            ordered_sum(areas.len(), of_patch) + direct.map_or(0.0, |direct| direct.escaped_deviations[c][k])
        })
    })
}

/// Two deviations of each patch, summed over the channels: the local deviations, and the deviations dE_k that include
/// inherited errors. The inherited part is propagated in a single channel, because in most scenes it is small and
/// similar in all channels.
fn propagate<const C: usize>(
    form_factors: &FormFactors,
    reflectance: &[[f32; C]],
    solution: &Solution,
    local: &[Deviation<C>],
) -> [Vec<[f32; REPLICATES]>; 2] {
    let sum = |local: &Deviation<C>, weight: [f32; C]| -> [f32; REPLICATES] {
        std::array::from_fn(|k| (0..C).map(|c| weight[c] * local[c][k]).sum())
    };
    let own: Vec<[f32; REPLICATES]> =
        local.par_iter().with_min_len(256).map(|local| sum(local, [1.0; C])).collect();
    // The mean reflectance for inherited deviations, weighted by the irradiance of the channels.
    let mean = |(rho, e): (&[f32; C], &[f64])| {
        let all: f64 = e.iter().sum();
        [if all > 0.0 { (0..C).map(|c| rho[c] * (e[c] / all) as f32).sum() } else { 0.0 }]
    };
    let irradiance = solution.irradiance.par_chunks_exact(C);
    let means: Vec<[f32; 1]> = reflectance.par_iter().zip(irradiance).with_min_len(256).map(mean).collect();
    let first = local.par_iter().zip(reflectance).with_min_len(256).map(|(local, rho)| sum(local, *rho));
    let light = reflected(form_factors, &first.collect::<Vec<_>>(), &means);
    let mut total = vec![[0.0; REPLICATES]; own.len()];
    form_factors.irradiance_into::<f32, REPLICATES>(light.as_flattened(), total.as_flattened_mut());
    total.par_iter_mut().zip(&own).with_min_len(256).for_each(|(total, own)| {
        (0..REPLICATES).for_each(|k| total[k] += own[k]);
    });
    [own, total]
}

/// Variance of the mean of independent replicates, from their deviations, which sum to zero up to rounding.
fn variance_of(deviations: &[f64; REPLICATES]) -> f64 {
    let many = REPLICATES as f64;
    let squares: f64 = deviations.iter().map(|d| d * d).sum();
    squares / (many * (many - 1.0))
}

fn root_mean_square<const K: usize>(values: &[[f32; K]]) -> f64 {
    let squares = |i: usize| values[i].iter().map(|&v| f64::from(v).powi(2)).sum::<f64>();
    (ordered_sum(values.len(), squares) / values.len() as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::form_factor::Matrix;

    /// A prior of two escaping rays among two hundred: no ray of 200 gives a half of that share, and many rays their own
    /// share.
    #[test]
    fn rare_escapes_are_estimated_from_rays_and_prior() {
        assert_eq!(posterior([0.0, 0.0], 0.01), 0.01);
        assert_eq!(posterior([0.0, 200.0], 0.01), 0.005);
        assert_eq!(posterior([8.0, 0.0], 0.01), 0.05);
        assert!((posterior([3e5, 1e6], 0.01) - 0.3).abs() < 1e-4);
    }

    /// Pairs of plates that see only each other: y_1 = (s_1 + ρ s_2) / (1 - ρ²). Without the source's mean, bounces change
    /// their sign.
    #[test]
    fn light_between_bright_plates_is_summed_over_all_bounces() {
        let exchange = Matrix::new((2, 2), vec![0, 1, 1], vec![1], vec![1.0]);
        let plates = FormFactors::from_exchange(exchange, vec![1.0; 2], vec![0.0; 2]);
        for rho in [0.5f32, 0.9, 0.99] {
            for [s, t] in [[1.0, 1.0], [1.0, -1.0], [1.0, 0.0]] {
                let found = reflected(&plates, &[[s], [t]], &[[rho], [rho]]);
                let wanted = [(s + rho * t) / (1.0 - rho * rho), (t + rho * s) / (1.0 - rho * rho)];
                for (found, wanted) in found.iter().zip(wanted) {
                    let off = (found[0] - wanted).abs();
                    assert!(off <= 0.05 * wanted.abs(), "{rho}, {s} {t}: {found:?} for {wanted}");
                }
            }
        }
    }

    #[test]
    fn the_root_mean_square_is_weighted_by_area() {
        // The expected value is sqrt((2² + 3 · 1²) / 4) / ((1 + 3 · 5) / 4).
        let relative = relative_rms(&[2.0, 1.0], &[1.0, 5.0], &[1.0, 3.0]);
        assert!((relative - 1.75f64.sqrt() / 4.0).abs() < 1e-14);
        assert_eq!(relative_rms(&[0.0, 0.0], &[0.0, 0.0], &[1.0, 3.0]), 0.0);
    }
}
