//! Parallel work whose result does not depend on the number of threads.

use rayon::prelude::*;

/// A number of patches that is barely worth a separate task.
pub(crate) const SHORT: usize = 4096;

/// Runs work that has many short parallel parts on one of rayon's threads. From another thread, each part would wake
/// one of rayon's threads and wait for it. This saves a twelfth of the time for a thousand patches.
pub(crate) fn together<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    rayon::scope(|_| work())
}

/// The sum of one value per patch. Each run of [`SHORT`] patches is summed by itself, and then the runs are summed in
/// order. So the result does not depend on the number of threads.
pub(crate) fn ordered_sum<T: Copy + Send + std::iter::Sum<T>>(
    len: usize,
    value: impl Fn(usize) -> T + Sync,
) -> T {
    let run = |k: usize| (k * SHORT..((k + 1) * SHORT).min(len)).map(&value).sum();
    let runs: Vec<T> = (0..len.div_ceil(SHORT)).into_par_iter().map(run).collect();
    runs.into_iter().sum()
}

/// The largest power of two that is at most the largest absolute value; 1 if all values are zero. Division by it causes
/// no rounding. It brings squares and numbers of single precision into range, however bright or dark a scene is.
pub(crate) fn magnitude(values: &[f64]) -> f64 {
    let largest = values.iter().copied().map(f64::abs).fold(0.0, f64::max);
    // The clamp keeps the inverse finite.
    if largest > 0.0 { 2f64.powi(largest.log2().floor().clamp(-1000.0, 1000.0) as i32) } else { 1.0 }
}
