//! Gauss-Seidel iteration. It is like Jacobi, but every patch gathers the new values of the patches before it. It
//! converges about twice as fast, but a sweep runs on one thread because each patch waits for the one before.

use super::{Iterate, SolveOptions, System};
use crate::{
    Progress, Result,
    form_factor::{Matrix, row},
};

/// Repeats sweeps until the true residual is small. The residual costs a product, so it is computed only when the
/// change of a sweep, which is of the same order, is small enough.
pub(super) fn solve<const C: usize>(
    system: &System<C>,
    options: &SolveOptions,
    progress: &Progress,
) -> Result<Iterate<C>> {
    let rows = system.form_factors.rows();
    let mut radiosity = system.source.to_vec();
    for iteration in 0..options.max_iterations {
        progress.check()?;
        let change = sweep(system, &rows, &mut radiosity);
        if system.relative(change.into_iter()) <= options.tolerance {
            let irradiance = system.irradiance(&radiosity);
            if system.relative_residual(&radiosity, &irradiance) <= options.tolerance {
                return Ok((radiosity, iteration + 1));
            }
        }
    }
    Ok((radiosity, options.max_iterations))
}

/// Sweeps once over all patches. Returns the change of each.
fn sweep<const C: usize>(system: &System<C>, rows: &Matrix, radiosity: &mut [[f64; C]]) -> Vec<[f64; C]> {
    let (left, right) = system.form_factors.scaling();
    (0..radiosity.len())
        .map(|i| {
            let (columns, values) = row(rows, i);
            let mut sums = [0.0; C];
            for (&j, &s) in columns.iter().zip(values) {
                let j = j as usize;
                let weight = f64::from(s) * right[j];
                for c in 0..C {
                    sums[c] += weight * radiosity[j][c];
                }
            }
            let change = system.residual(i, &radiosity[i], &sums.map(|sum| left[i] * sum));
            for c in 0..C {
                radiosity[i][c] += change[c];
            }
            change
        })
        .collect()
}
