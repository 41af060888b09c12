//! Error bars: the standard error of every patch's irradiance that comes from sampling the form factors.
//!
//! The rays are cast as independent replicates. Replicate k, by itself, gives form factors F_k = F + dF_k, and to first
//! order the irradiance
//!
//!   dE_k = dF_k B + F ρ dE_k
//!
//! The first term is summed from the rays of the replicate, its closure included; the second, the error that a patch
//! inherits through the light of others, is a Neumann series. The spread of dE_k over the K replicates gives the
//! standard error of their mean, sqrt(Σ dE_k² / (K (K - 1))), with K - 1 degrees of freedom.

use rayon::prelude::*;

use crate::{
    form_factor::{FormFactors, hemisphere::REPLICATES, replicates::Deviation},
    solve::{Radiometry, Solution},
};

/// Rounds of the closure: what is left of the excess halves in each.
const CLOSURE_ROUNDS: usize = 6;
/// Terms of the Neumann series at most. Error bars need no more than a few percent of themselves.
const MOST_BOUNCES: usize = 40;
/// The series ends when a term changes the root mean square of the deviations by less than this share.
const ENOUGH: f64 = 0.01;

/// 97.5 % quantile of Student's t distribution with K - 1 = 15 degrees of freedom: E ± this times its standard error
/// is the 95 % interval of a patch.
pub const T_QUANTILE: f64 = 2.131;

/// Standard errors of irradiance, W/m², `channels` interleaved values a patch.
#[derive(Debug, Clone, PartialEq)]
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
        match solution.channels {
            1 => Self::spread::<1>(form_factors, reflectance.as_chunks().0, solution.radiosity.as_chunks().0),
            _ => Self::spread::<3>(form_factors, reflectance.as_chunks().0, solution.radiosity.as_chunks().0),
        }
    }

    fn spread<const C: usize>(
        form_factors: &FormFactors,
        reflectance: &[[f64; C]],
        radiosity: &[[f64; C]],
    ) -> Option<ErrorBars> {
        let deviations = propagate(form_factors, reflectance, radiosity)?;
        let areas = form_factors.areas();
        let total: f64 = areas.iter().sum();
        let mut mean = [[0f64; REPLICATES]; C];
        for (area, deviation) in areas.iter().zip(&deviations) {
            for c in 0..C {
                for k in 0..REPLICATES {
                    mean[c][k] += area / total * f64::from(deviation[c][k]);
                }
            }
        }
        Some(ErrorBars {
            channels: C,
            standard_error: deviations
                .iter()
                .flat_map(|e| e.map(|c| standard_error(&c.map(f64::from))))
                .collect(),
            of_mean: mean.iter().map(standard_error).collect(),
        })
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

/// One value a replicate and channel.
type Spectrum<const C: usize> = [[f32; REPLICATES]; C];

/// The deviations dE_k of all patches.
fn propagate<const C: usize>(
    form_factors: &FormFactors,
    reflectance: &[[f64; C]],
    radiosity: &[[f64; C]],
) -> Option<Vec<Spectrum<C>>> {
    let mut local = form_factors.deviations(radiosity)?;
    close(form_factors, &mut local);
    let mut total: Vec<Spectrum<C>> = local.iter().map(|d| d.irradiance).collect();
    let mut size = root_mean_square(&total);
    for _ in 0..MOST_BOUNCES {
        let sent: Vec<Spectrum<C>> = total
            .par_iter()
            .enumerate()
            .with_min_len(256)
            .map(|(i, e)| sent(e, &local[i].scale, &reflectance[i], &radiosity[i]))
            .collect();
        total = form_factors.gather_replicates(
            &sent,
            |i| is_source(&local[i]),
            |j| self::sent(&total[j], &link_scale(&local[j]), &reflectance[j], &radiosity[j]),
        );
        total.par_iter_mut().zip(&local).for_each(|(total, local)| {
            for c in 0..C {
                for k in 0..REPLICATES {
                    total[c][k] += local.irradiance[c][k];
                }
            }
        });
        let before = size;
        size = root_mean_square(&total);
        if (size - before).abs() <= ENOUGH * size {
            break;
        }
    }
    Some(total)
}

/// Standard error of the mean of deviations, which sum to zero but for rounding.
fn standard_error(deviations: &[f64; REPLICATES]) -> f64 {
    let many = REPLICATES as f64;
    let squares: f64 = deviations.iter().map(|d| d * d).sum();
    (squares / (many * (many - 1.0))).sqrt()
}

/// Solves for the scales that close all rows of each replicate together, (I + F) d ln d = -excess, by damped Jacobi
/// iteration, and adds what each row's own scale does to its irradiance.
fn close<const C: usize>(form_factors: &FormFactors, local: &mut [Deviation<C>]) {
    let alone: Vec<Spectrum<1>> = local.iter().map(|d| [d.scale]).collect();
    for _ in 0..CLOSURE_ROUNDS {
        let scale: Vec<Spectrum<1>> = local.iter().map(|d| [d.scale]).collect();
        let arriving =
            form_factors.gather_replicates(&scale, |i| is_source(&local[i]), |j| [link_scale(&local[j])]);
        for (i, d) in local.iter_mut().enumerate() {
            for k in 0..REPLICATES {
                d.scale[k] = 0.5 * (d.scale[k] + alone[i][0][k] - arriving[i][0][k]);
            }
        }
    }
    for d in local {
        for c in 0..C {
            for k in 0..REPLICATES {
                d.irradiance[c][k] += d.scale[k] * d.response[c];
            }
        }
    }
}

/// All entries in the row of a source are links.
fn is_source<const C: usize>(deviation: &Deviation<C>) -> bool {
    deviation.link_yield == 1.0
}

/// How the closure scales the links of a patch.
fn link_scale<const C: usize>(deviation: &Deviation<C>) -> [f32; REPLICATES] {
    deviation.scale.map(|s| s * deviation.link_yield)
}

/// What the deviations of a patch send on: reflected irradiance, and radiosity through form factors that the closure
/// scales.
fn sent<const C: usize>(
    irradiance: &Spectrum<C>,
    scale: &[f32; REPLICATES],
    reflectance: &[f64; C],
    radiosity: &[f64; C],
) -> Spectrum<C> {
    std::array::from_fn(|c| {
        let (rho, b) = (reflectance[c] as f32, radiosity[c] as f32);
        std::array::from_fn(|k| rho * irradiance[c][k] + scale[k] * b)
    })
}

fn root_mean_square<const C: usize>(values: &[Spectrum<C>]) -> f64 {
    let squares: f64 = values.iter().flatten().flatten().map(|&v| f64::from(v).powi(2)).sum();
    (squares / values.len() as f64).sqrt()
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
