//! Batches of sweeps. Their spread estimates the standard error of their mean.

use std::ops::Range;

use nalgebra::{SVector, Vector2};
use rayon::prelude::*;

use crate::{
    form_factor::ordered_sum,
    rays::{
        siblings::with_mean,
        stratification::{half_differences, variance_of_all},
    },
};

/// Most batches.
pub(super) const BATCHES: usize = 16;
/// Number of times that the number of batches can be halved.
const LEVELS: usize = BATCHES.ilog2() as usize;
/// Bounds of the power with which the variance of a run of batches falls with its length: slower than for independent
/// batches if light lingers, faster if the parts of a sequence complement each other.
const RATES: (f64, f64) = (0.5, 3.0);

/// A factor for every batch and channel.
type Scales<const C: usize> = [[f64; BATCHES]; C];

/// The mean irradiance of each patch in up to 16 batches.
pub(super) struct Batches<'a, const C: usize> {
    areas: &'a [f64],
    emission: &'a [[f64; C]],
    reflectance: &'a [[f64; C]],
    /// All light is divided by this unit, so that single precision and squares can hold it.
    unit: f64,
    irradiance: Vec<[[f32; BATCHES]; C]>,
    /// Power that enters from outside the patches in each batch.
    entered: [[f64; BATCHES]; C],
    /// Escaped power in each batch.
    escaped: [[f64; BATCHES]; C],
    filled: usize,
}

impl<'a, const C: usize> Batches<'a, C> {
    /// No batches yet. `unit` is the magnitude of the light.
    pub(super) fn new(
        areas: &'a [f64],
        emission: &'a [[f64; C]],
        reflectance: &'a [[f64; C]],
        unit: f64,
    ) -> Self {
        Batches {
            areas,
            emission,
            reflectance,
            unit,
            irradiance: vec![[[0.0; BATCHES]; C]; areas.len()],
            entered: [[0.0; BATCHES]; C],
            escaped: [[0.0; BATCHES]; C],
            filled: 0,
        }
    }

    pub(super) fn are_full(&self) -> bool {
        self.filled == BATCHES
    }

    /// Adds a batch, given the irradiance of each patch, and the power that entered the scene and escaped from it.
    pub(super) fn push(
        &mut self,
        arrived: impl Fn(usize) -> [f64; C] + Sync,
        [entered, escaped]: [[f64; C]; 2],
    ) {
        let (batch, unit) = (self.filled, self.unit);
        self.irradiance.par_iter_mut().enumerate().with_min_len(1024).for_each(|(i, of)| {
            for (of, arrived) in of.iter_mut().zip(arrived(i)) {
                of[batch] = (arrived / unit) as f32;
            }
        });
        self.entered.iter_mut().zip(entered).for_each(|(of, entered)| of[batch] = entered / unit);
        self.escaped.iter_mut().zip(escaped).for_each(|(of, escaped)| of[batch] = escaped / unit);
        self.filled += 1;
    }

    /// Joins every two batches.
    pub(super) fn pair(&mut self) {
        self.filled /= 2;
        let filled = self.filled;
        for of in self.escaped.iter_mut().chain(&mut self.entered) {
            (0..filled).for_each(|k| of[k] = 0.5 * (of[2 * k] + of[2 * k + 1]));
        }
        self.irradiance.par_iter_mut().with_min_len(1024).for_each(|batches| {
            for of in batches {
                (0..filled).for_each(|k| of[k] = 0.5 * (of[2 * k] + of[2 * k + 1]));
            }
        });
    }

    /// Factors for the arriving and escaping light of each batch that balance its energy.
    fn scales(&self) -> Scales<C> {
        std::array::from_fn(|c| {
            let absorbed = |i: usize| {
                let share = self.areas[i] * (1.0 - self.reflectance[i][c]);
                SVector::<f64, BATCHES>::from(self.irradiance[i][c].map(|e| share * f64::from(e)))
            };
            let absorbed = ordered_sum(self.areas.len(), absorbed);
            let emitted =
                ordered_sum(self.areas.len(), |i| self.areas[i] * (self.emission[i][c] / self.unit));
            std::array::from_fn(|k| balancing(emitted + self.entered[c][k], absorbed[k] + self.escaped[c][k]))
        })
    }

    /// The irradiance of patch `i` in each batch, after balancing.
    fn balanced(&self, i: usize, scales: &Scales<C>) -> [[f64; BATCHES]; C] {
        std::array::from_fn(|c| std::array::from_fn(|k| scales[c][k] * f64::from(self.irradiance[i][c][k])))
    }

    /// Area-weighted root mean square of the standard error of the mean of all batches, relative to the mean
    /// irradiance.
    pub(super) fn error(&self) -> f64 {
        let scales = self.scales();
        let stratified = self.stratification(&scales);
        let sums = ordered_sum(self.areas.len(), |i| {
            let mut sums = Vector2::zeros();
            for values in self.balanced(i, &scales) {
                let [mean, error] = mean_and_error(&values[..self.filled]);
                sums[0] += self.areas[i] * (stratified * error).powi(2);
                sums[1] += self.areas[i] * mean;
            }
            sums
        });
        let [squares, mean]: [f64; 2] = sums.into();
        let weight = C as f64 * ordered_sum(self.areas.len(), |i| self.areas[i]);
        if mean > 0.0 { (squares / weight).sqrt() / (mean / weight) } else { 0.0 }
    }

    /// Standard errors of the mean of all batches: of the irradiance of each patch, of the relative energy imbalance of
    /// each channel, and of the power that enters.
    pub(super) fn errors(&self, siblings: &[Range<usize>]) -> [Vec<f64>; 3] {
        let scales = self.scales();
        let stratified = self.stratification(&scales);
        let variances = |i: usize| {
            self.balanced(i, &scales).map(|values| mean_and_error(&values[..self.filled])[1].powi(2))
        };
        let own: Vec<[f64; C]> =
            (0..self.areas.len()).into_par_iter().with_min_len(1024).map(variances).collect();
        // Uses the larger of the patch's own variance and the mean of its siblings, which may have found rare paths.
        // Errors of light from shadow rays are carried into all later batches, so that they do not show in the spread.
        let error = |own: f64, mean: f64| self.unit * stratified * own.max(mean).sqrt();
        let standard_error = with_mean(siblings, &own, error);
        // The arriving and escaping light of a batch is 1 / scale of the emitted and entering light.
        let of_imbalance = scales.map(|scales| {
            let [_, error] = mean_and_error(&scales.map(|scale| 1.0 - 1.0 / scale)[..self.filled]);
            stratified * error
        });
        let of_entered = self.entered.map(|entered| {
            let [_, error] = mean_and_error(&entered[..self.filled]);
            self.unit * stratified * error
        });
        [standard_error, of_imbalance.into(), of_entered.into()]
    }

    /// Ratio of the standard error of the mean of the batches to its value for independent batches.
    ///
    /// Batches are parts of one sequence and complement each other, but errors of one batch are reflected into the
    /// next. If the light has not settled, the halves differ more than shorter runs predict. The excess counts as
    /// error: if the light settles within the batches, the mean of all is wrong by about half the difference.
    fn stratification(&self, scales: &Scales<C>) -> f64 {
        let sums = ordered_sum(self.areas.len(), |i| self.half_differences(i, scales));
        let levels = self.filled.ilog2() as usize;
        if !(0..=levels).all(|k| sums[if k < levels { k } else { LEVELS }] > 0.0) {
            return 1.0;
        }
        let of_run = |levels, batches| variance_of_all(&sums.as_slice()[..levels], batches, RATES);
        let half = self.filled / 2;
        // The prediction excludes the longest runs, which are the halves or nearly so.
        let drift = match levels {
            3.. => (sums[LEVELS + 1] - (of_run(levels - 1, half) - of_run(levels - 1, 2 * half))).max(0.0),
            _ => 0.0,
        };
        ((of_run(levels, self.filled) + drift) / sums[LEVELS]).sqrt()
    }

    /// For patch `i`, times its area: the mean squares of half the differences of neighbouring runs of 1, 2, 4 and 8
    /// batches, the variance of the mean if batches were independent, and the squared half difference of the first and
    /// the last half.
    fn half_differences(&self, i: usize, scales: &Scales<C>) -> SVector<f64, { LEVELS + 2 }> {
        let mut sums = SVector::zeros();
        let half = self.filled / 2;
        for mut runs in self.balanced(i, scales) {
            let [_, error] = mean_and_error(&runs[..self.filled]);
            sums[LEVELS] += self.areas[i] * error.powi(2);
            let [first, last] =
                [0, self.filled - half].map(|k| runs[k..k + half].iter().sum::<f64>() / half as f64);
            sums[LEVELS + 1] += self.areas[i] * (0.5 * (last - first)).powi(2);
            let halves: [f64; LEVELS] = half_differences(&mut runs[..self.filled]);
            halves.iter().enumerate().for_each(|(level, half)| sums[level] += self.areas[i] * half);
        }
        sums
    }
}

/// The factor that brings a sum of powers to the power that is emitted and enters.
pub(super) fn balancing(sent: f64, lost: f64) -> f64 {
    if sent > 0.0 && lost > 0.0 { sent / lost } else { 1.0 }
}

/// The mean of independent values, and its standard error.
fn mean_and_error(values: &[f64]) -> [f64; 2] {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    [mean, (squares / (count * (count - 1.0))).sqrt()]
}
