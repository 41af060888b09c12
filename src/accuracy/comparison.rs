//! Comparison of two independent estimates of the same irradiances, patch by patch.
//!
//! If both are right, the differences divided by their combined standard errors (the z-scores) follow Student's t
//! distribution with mean 0. An error in either estimate shifts or spreads them.

use serde::Serialize;

/// Estimates of the irradiance of every patch, with interleaved channels.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Estimates {
    /// Irradiance, W/m².
    pub irradiance: Vec<f64>,
    /// Standard error of the irradiance from sampling, W/m².
    pub standard_error: Vec<f64>,
    /// Standard deviation of all other errors, W/m².
    pub allowance: Vec<f64>,
    /// Area-weighted mean irradiance of each channel and its standard error, which includes the allowance. W/m².
    pub mean: Vec<(f64, f64)>,
}

impl Estimates {
    /// Estimates whose errors are independent from patch to patch and come from sampling alone.
    pub fn independent(irradiance: Vec<f64>, standard_error: Vec<f64>, areas: &[f64]) -> Estimates {
        let channels = irradiance.len() / areas.len();
        let total: f64 = areas.iter().sum();
        let mean = (0..channels)
            .map(|c| {
                let at = |values: &[f64], i: usize| areas[i] / total * values[i * channels + c];
                let mean = (0..areas.len()).map(|i| at(&irradiance, i)).sum();
                let variance: f64 = (0..areas.len()).map(|i| at(&standard_error, i).powi(2)).sum();
                (mean, variance.sqrt())
            })
            .collect();
        Estimates { allowance: vec![0.0; irradiance.len()], irradiance, standard_error, mean }
    }
}

/// A patch at which two estimates differ much.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Worst {
    /// The patch.
    pub patch: usize,
    /// The channel.
    pub channel: usize,
    /// The difference in units of its standard error.
    pub z: f64,
    /// The first estimate, W/m².
    pub first: f64,
    /// The second estimate, W/m².
    pub second: f64,
}

/// The differences of two estimates.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Comparison {
    /// Area-weighted root mean square of the difference, relative to the mean irradiance.
    pub rms_relative: f64,
    /// Relative difference of the area-weighted means, for the channel with the largest z-score.
    pub mean_relative: f64,
    /// The same difference in units of its standard error.
    pub mean_z: f64,
    /// Mean of the patches' z-scores.
    pub z_mean: f64,
    /// Root mean square of the patches' z-scores. If both estimates are right, it is about 1.07 and not 1, because
    /// standard errors are estimates too.
    pub z_spread: f64,
    /// Share of patches with |z| > 2: 4.6 % for normal errors, 6.4 % with 15 degrees of freedom.
    pub beyond_2: f64,
    /// Share of patches with |z| > 3: 0.3 % for normal errors, 0.9 % with 15 degrees of freedom.
    pub beyond_3: f64,
    /// Number of compared values: patches times channels, without values that are equal in both estimates.
    pub compared: usize,
    /// The patches that differ most, worst first.
    #[serde(skip)]
    pub worst: Vec<Worst>,
}

/// Number of the worst patches to report.
const NAMED: usize = 10;

/// Largest allowed |z| of the means. With about 15 degrees of freedom, 1 in 400 right answers exceeds it.
const MEAN_LIMIT: f64 = 3.6;
/// Largest allowed spread of the z-scores. The errors of neighbouring patches are correlated, so a thousand patches
/// count like about a hundred independent ones. Then 1.35 is four standard deviations above 1.07.
const SPREAD_LIMIT: f64 = 1.35;
/// Largest allowed share of patches beyond three standard errors: about three times the expected share.
const BEYOND_3_LIMIT: f64 = 0.03;

impl Comparison {
    /// Compares two estimates for the same patches.
    ///
    /// # Panics
    /// If their sizes disagree.
    pub fn of(first: &Estimates, second: &Estimates, areas: &[f64]) -> Comparison {
        let n = first.irradiance.len();
        let channels = n / areas.len();
        assert_eq!((second.irradiance.len(), first.mean.len()), (n, channels), "sizes disagree");
        let (mut squares, mut sum, mut weight) = (0.0, 0.0, 0.0);
        let mut scores = Vec::with_capacity(n);
        for q in 0..n {
            let area = areas[q / channels];
            let difference = first.irradiance[q] - second.irradiance[q];
            squares += area * difference.powi(2);
            sum += area * second.irradiance[q];
            weight += area;
            let variance = [first, second]
                .iter()
                .map(|e| e.standard_error[q].powi(2) + e.allowance[q].powi(2))
                .sum::<f64>();
            if difference != 0.0 {
                scores.push((q, difference / variance.sqrt()));
            }
        }
        let mean_irradiance = sum / weight;
        let (mean_relative, mean_z) = (0..channels)
            .map(|c| {
                let ((a, sa), (b, sb)) = (first.mean[c], second.mean[c]);
                (if b > 0.0 { (a - b) / b } else { 0.0 }, if a == b { 0.0 } else { (a - b) / sa.hypot(sb) })
            })
            .max_by(|x, y| x.1.abs().total_cmp(&y.1.abs()))
            .unwrap_or_default();
        let compared = scores.len().max(1) as f64;
        let share = |limit: f64| scores.iter().filter(|(_, z)| !(z.abs() <= limit)).count() as f64 / compared;
        let mut comparison = Comparison {
            rms_relative: if mean_irradiance > 0.0 {
                (squares / weight).sqrt() / mean_irradiance
            } else {
                0.0
            },
            mean_relative,
            mean_z,
            // An empty sum is -0; adding 0 makes it positive.
            z_mean: scores.iter().map(|(_, z)| z).sum::<f64>() / compared + 0.0,
            z_spread: (scores.iter().map(|(_, z)| z * z).sum::<f64>() / compared).sqrt(),
            beyond_2: share(2.0),
            beyond_3: share(3.0),
            compared: scores.len(),
            worst: Vec::new(),
        };
        scores.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
        comparison.worst = scores
            .iter()
            .take(NAMED)
            .map(|&(q, z)| Worst {
                patch: q / channels,
                channel: q % channels,
                z,
                first: first.irradiance[q],
                second: second.irradiance[q],
            })
            .collect();
        comparison
    }

    /// Reasons to believe that the two estimates differ by more than their errors, one sentence each. Empty if they
    /// agree.
    pub fn objections(&self) -> Vec<String> {
        let mut objections = Vec::new();
        // All conditions are negated, so that NaN fails.
        if !(self.mean_z.abs() <= MEAN_LIMIT) {
            objections.push(format!(
                "the means differ by {:.2} %, which is {:.1} standard errors ({MEAN_LIMIT} are allowed)",
                100.0 * self.mean_relative,
                self.mean_z
            ));
        }
        if !(self.z_spread <= SPREAD_LIMIT) {
            objections.push(format!(
                "the differences of patches are {:.2} times their standard errors ({SPREAD_LIMIT} are allowed)",
                self.z_spread
            ));
        }
        if !(self.beyond_3 <= BEYOND_3_LIMIT) {
            objections.push(format!(
                "{:.1} % of the patches differ by more than 3 standard errors ({:.0} % allowed)",
                100.0 * self.beyond_3,
                100.0 * BEYOND_3_LIMIT
            ));
        }
        objections
    }
}
