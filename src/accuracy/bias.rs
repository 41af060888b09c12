//! Bias of the pooled solution.
//!
//! Ratios and products of estimates have a bias of about c/n after n rays. The mean of the two solutions with half of
//! the rays each has a bias of 2c/n. The difference from the whole solution is therefore an estimate of the bias. This
//! is the jackknife in its simplest form (Quenouille, "Notes on Bias in Estimation", Biometrika 43, 1956).

use crate::{
    Progress, Result,
    form_factor::FormFactors,
    patch::Patches,
    solve::{Solution, SolveOptions, solve_from},
    trace::Tracer,
};

/// From this number of patches on, one half of the rays is enough, because the sampling errors of the halves average
/// out.
const ENOUGH: usize = 1 << 17;

/// The estimated relative bias of the mean irradiance, over all channels and weighted by area. It is positive if the
/// mean is too high. `None` if the form factors were not sampled, or if there are too few rays to halve.
///
/// # Errors
/// See [`solve`](crate::solve::solve()).
///
/// # Panics
/// If the sizes disagree.
pub fn relative(
    form_factors: &FormFactors,
    tracer: &Tracer,
    patches: &Patches,
    solution: &Solution,
    options: &SolveOptions,
    progress: &Progress,
) -> Result<Option<f64>> {
    // The bias is that of the solution with constant light: slopes use the same rays in the whole and in the halves.
    let mean = |solution: &Solution| -> f64 {
        let irradiance = solution.constant_irradiance().chunks_exact(solution.channels);
        irradiance.zip(form_factors.areas()).map(|(e, area)| area * e.iter().sum::<f64>()).sum()
    };
    let options = &options.rough();
    let start = &solution.radiosity;
    let whole = mean(solution);
    let mut halves = 0.0;
    let many = if patches.len() < ENOUGH { 2 } else { 1 };
    for half in 0..many {
        let Some(form_factors) = form_factors.half(half, tracer, patches) else { return Ok(None) };
        halves += mean(&solve_from(Some(start), &form_factors, patches.into(), options, progress)?);
    }
    Ok((whole > 0.0).then(|| halves / (many as f64 * whole) - 1.0))
}
