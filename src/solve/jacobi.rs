//! Jacobi iteration: B ← Be + ρ F B, one bounce of light in each sweep.

use super::{Iterate, SolveOptions, System};
use crate::{Progress, Result};

/// Repeats sweeps until the residual, which is the change of a sweep, is small.
pub(super) fn solve<const C: usize>(
    system: &System<C>,
    options: &SolveOptions,
    progress: &Progress,
) -> Result<Iterate<C>> {
    let mut radiosity = system.source.to_vec();
    for iteration in 0..=options.max_iterations {
        progress.check()?;
        let irradiance = system.irradiance(&radiosity);
        if system.relative_residual(&radiosity, &irradiance) <= options.tolerance
            || iteration == options.max_iterations
        {
            return Ok((radiosity, iteration));
        }
        for (i, b) in radiosity.iter_mut().enumerate() {
            let change = system.residual(i, b, &irradiance[i]);
            for c in 0..C {
                b[c] += change[c];
            }
        }
    }
    unreachable!("the last iteration returns")
}
