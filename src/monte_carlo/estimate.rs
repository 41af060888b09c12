//! Means with standard errors, from independent replicates.

use glam::DVec3;
use rayon::prelude::*;

use super::{Samples, samples::take};
use crate::{Progress, Result, trace::sampling::mix};

/// A Monte Carlo estimate per channel (R, G, B).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct Estimate {
    /// The mean.
    pub mean: [f64; 3],
    /// Standard deviation of the mean.
    pub standard_error: [f64; 3],
}

impl Estimate {
    /// Mean and standard error of replicates of equal weight.
    ///
    /// # Panics
    /// With fewer than two replicates: their spread is not defined.
    pub fn of(replicates: &[[f64; 3]]) -> Estimate {
        let n = replicates.len() as f64;
        assert!(n >= 2.0, "a standard error needs two replicates");
        let mean: [f64; 3] = std::array::from_fn(|c| replicates.iter().map(|r| r[c]).sum::<f64>() / n);
        let standard_error = std::array::from_fn(|c| {
            let squares: f64 = replicates.iter().map(|r| (r[c] - mean[c]).powi(2)).sum();
            (squares / (n * (n - 1.0))).sqrt()
        });
        Estimate { mean, standard_error }
    }

    /// The estimate of a quantity `factor` times as large.
    pub fn scaled(self, factor: f64) -> Estimate {
        Estimate {
            mean: self.mean.map(|x| x * factor),
            standard_error: self.standard_error.map(|x| x * factor.abs()),
        }
    }
}

/// Running mean and variance of replicates (Welford, Technometrics 4(3), 1962).
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Running {
    mean: DVec3,
    /// Sum of the squared deviations from the mean.
    squares: DVec3,
}

impl Running {
    /// Adds replicate number `n`, counted from 1.
    pub(super) fn add(&mut self, n: u32, value: DVec3) {
        let before = value - self.mean;
        self.mean += before / f64::from(n);
        self.squares += before * (value - self.mean);
    }

    /// The estimate from `n` replicates.
    pub(super) fn estimate(&self, n: u32) -> Estimate {
        let n = f64::from(n);
        let standard_error = (self.squares / (n * (n - 1.0))).to_array().map(f64::sqrt);
        Estimate { mean: self.mean.to_array(), standard_error }
    }
}

/// The number of samples of each estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct Effort {
    /// Samples per estimate, rounded up to a multiple of `replicates`. Default 4096. Sobol sequences are most accurate
    /// with powers of two.
    pub samples: u32,
    /// Number of replicates, which are independent scrambles of the sequence. Their spread gives the standard error,
    /// which has a relative uncertainty of about 1/√(2·replicates). Default 16.
    pub replicates: u32,
    /// Seed of all random numbers. Default 1.
    pub seed: u64,
}

setters!(Effort {
    with_samples(samples: u32),
    with_replicates(replicates: u32),
    with_seed(seed: u64),
});

impl Default for Effort {
    fn default() -> Self {
        Effort { samples: 4096, replicates: 16, seed: 1 }
    }
}

impl Effort {
    /// Estimates `count` quantities, each the mean of `sample(i, numbers)`.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped).
    ///
    /// # Panics
    /// With fewer than two replicates.
    pub fn estimate(
        &self,
        count: usize,
        progress: &Progress,
        sample: impl Fn(usize, &mut Samples) -> [f64; 3] + Sync,
    ) -> Result<Vec<Estimate>> {
        let means = self.replicates(count, progress, sample)?;
        Ok(means.chunks(self.replicates as usize).map(Estimate::of).collect())
    }

    /// Means of the replicates of `count` quantities, quantity by quantity.
    ///
    /// Replicates are the unit of parallel work, so that a single quantity keeps several threads busy. Each replicate
    /// is summed in order by one thread, so that the result does not depend on the number of threads.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped).
    ///
    /// # Panics
    /// With fewer than two replicates.
    pub(crate) fn replicates(
        &self,
        count: usize,
        progress: &Progress,
        sample: impl Fn(usize, &mut Samples) -> [f64; 3] + Sync,
    ) -> Result<Vec<[f64; 3]>> {
        assert!(self.replicates >= 2, "a standard error needs two replicates");
        let replicates = self.replicates as usize;
        let each = self.samples.div_ceil(self.replicates).max(1);
        progress.begin("sampling", count as u64 * replicates as u64 * each as u64);
        let one = |task: usize| {
            let (i, replicate) = (task / replicates, task % replicates);
            let seed = mix(&[self.seed, i as u64, replicate as u64]);
            let mut sum = [0.0; 3];
            take(each, progress, |s| {
                let value = sample(i, &mut Samples::new(s, seed));
                (0..3).for_each(|c| sum[c] += value[c]);
                Ok(())
            })?;
            Ok(sum.map(|x| x / each as f64))
        };
        (0..count * replicates).into_par_iter().map(one).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn standard_error_covers_a_known_mean() {
        // The integral of x² y over the square is 1/6. About 5 % of 400 estimates should be more than two standard
        // errors off.
        let effort = Effort { samples: 256, ..Effort::default() };
        let all = effort
            .estimate(400, &Progress::new(), |_, s| {
                let [x, y] = s.square().map(f64::from);
                [x * x * y, 1.0, 0.0]
            })
            .unwrap();
        let outside =
            all.iter().filter(|e| (e.mean[0] - 1.0 / 6.0).abs() > 2.0 * e.standard_error[0]).count();
        assert!((5..60).contains(&outside), "{outside} of 400 outside two standard errors");
        assert!(all.iter().all(|e| e.mean[1] == 1.0 && e.standard_error[1] == 0.0));
    }

    #[test]
    fn replicates_tell_the_same_one_by_one() {
        let r = [[1.0, 2.0, 3.0], [2.0, 2.5, 7.0], [4.0, 1.0, 5.0]];
        let a = Estimate::of(&r);
        let mut running = Running::default();
        r.iter().zip(1..).for_each(|(x, n)| running.add(n, (*x).into()));
        let b = running.estimate(3);
        for c in 0..3 {
            assert!((a.mean[c] - b.mean[c]).abs() < 1e-12);
            assert!((a.standard_error[c] - b.standard_error[c]).abs() < 1e-12);
        }
        assert!((a.standard_error[0] - (7.0f64 / 9.0).sqrt()).abs() < 1e-12);
    }

    #[test]
    fn a_stop_is_obeyed() {
        let progress = Progress::new();
        progress.stop();
        let stopped = Effort::default().estimate(1, &progress, |_, _| [0.0; 3]);
        assert!(matches!(stopped, Err(crate::Error::Stopped)));
    }
}
