//! The discretisation error: light varies over a patch otherwise than the solution assumes.
//!
//! Moments of the rays give the shape of irradiance over each patch, up to the second degree. If every ray carried the
//! light ρ(x) E(x) of the point x it starts from, instead of the light that the solution has there, the rays would bring
//! ΔE more to the patches they hit. The error of the solution is then -(I - F ρ)⁻¹ ΔE, up to the error of light of the
//! second degree. No ray is cast: the start points of the rays at hand are known. For constant light, ΔE is the effect of slopes and
//! curvatures. For [linear light](crate::solve::linear), it is the effect of curvatures, and of the part of the slopes
//! that was left out: as noise, or because light would be negative.
//!
//! The noise of ΔE would be counted as error, so the rays are divided into two halves. The product of the two values of
//! ΔE has the square of ΔE as its expectation.

use std::ops::Range;

use crate::{
    Progress, Result,
    accuracy::error_bars::relative_rms,
    form_factor::{FormFactors, magnitude, ordered_sum, together},
    patch::Patches,
    scene::Scene,
    solve::{Solution, linear::variation},
    trace::Tracer,
};

/// The series of reflections ends when a term is less than this share of the sum, or after this many terms.
const ENOUGH: f64 = 0.02;
const MOST_BOUNCES: usize = 200;

/// The discretisation error of a solution.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Discretisation {
    /// The estimated error of the irradiance of each patch, W/m², with interleaved channels: irradiance minus its true
    /// mean over the patch.
    pub error: Vec<f64>,
    /// Area-weighted root mean square of `error`, relative to the mean irradiance, over the patches that can be seen
    /// ([`Patches::seen_areas`]).
    pub relative: f64,
}

impl Discretisation {
    /// Estimates the error from the rays of the form factors. `None` if they were not sampled.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped) if `progress` was stopped.
    ///
    /// # Panics
    /// If the sizes disagree.
    pub fn of(
        (scene, tracer): (&Scene, &Tracer),
        form_factors: &FormFactors,
        patches: &Patches,
        solution: &Solution,
        progress: &Progress,
    ) -> Result<Option<Discretisation>> {
        assert_eq!(form_factors.len(), patches.len(), "sizes disagree");
        let scene = (scene, tracer);
        let found = together(|| match solution.channels {
            1 => estimate::<1>(scene, form_factors, patches, solution, progress),
            _ => estimate::<3>(scene, form_factors, patches, solution, progress),
        })?;
        let areas = patches.seen_areas(&solution.irradiance);
        Ok(found.map(|error| {
            let relative = relative_rms(&error, &solution.irradiance, &areas);
            Discretisation { error, relative }
        }))
    }
}

fn estimate<const C: usize>(
    (scene, tracer): (&Scene, &Tracer),
    form_factors: &FormFactors,
    patches: &Patches,
    solution: &Solution,
    progress: &Progress,
) -> Result<Option<Vec<f64>>> {
    let reflectance: &[[f64; C]] = patches.reflectance().as_chunks().0;
    let (halves, unit) = match &solution.linear {
        Some(linear) => (linear.missing.clone().map(in_channels::<C>), linear.unit),
        None => {
            let found = variation::<C>((scene, tracer), form_factors, patches, solution, false, progress)?;
            let Some(found) = found else { return Ok(None) };
            (found.missing.map(|half| in_channels(half.into_flattened())), magnitude(&solution.radiosity))
        }
    };
    let brought = |i: usize, c: usize| 0.5 * (halves[0][i][c] + halves[1][i][c]);
    let brought: Vec<[f64; C]> = (0..patches.len()).map(|i| std::array::from_fn(|c| brought(i, c))).collect();
    let inherited = inherited(form_factors, reflectance, &brought, progress)?;
    let product = |i: usize| {
        let of = |half: usize, c: usize| halves[half][i][c] + inherited[i][c];
        (0..C).map(|c| of(0, c) * of(1, c)).sum::<f64>()
    };
    let products: Vec<f64> = (0..patches.len()).map(product).collect();
    let change = |i: usize| std::array::from_fn(|c| -unit * (brought[i][c] + inherited[i][c]));
    let change: Vec<[f64; C]> = (0..patches.len()).map(change).collect();
    let squares: Vec<f64> = products.into_iter().map(|x| unit * unit * x).collect();
    Ok(Some(without_noise(&change, &squares, form_factors.siblings(), form_factors.areas())))
}

/// Interleaved values as those of each patch.
fn in_channels<const C: usize>(values: Vec<f32>) -> Vec<[f64; C]> {
    values.as_chunks().0.iter().map(|values| values.map(f64::from)).collect()
}

/// The light of ΔE after one reflection and more: Σ (F ρ)ⁿ ΔE for n ≥ 1.
fn inherited<const C: usize>(
    form_factors: &FormFactors,
    reflectance: &[[f64; C]],
    brought: &[[f64; C]],
    progress: &Progress,
) -> Result<Vec<[f64; C]>> {
    let areas = form_factors.areas();
    let size = |values: &[[f32; C]]| {
        let squares = |i: usize| areas[i] * values[i].iter().map(|&x| f64::from(x).powi(2)).sum::<f64>();
        ordered_sum(areas.len(), squares).sqrt()
    };
    let mut term: Vec<[f32; C]> = brought.iter().map(|e| e.map(|e| e as f32)).collect();
    let mut sum = vec![[0.0; C]; brought.len()];
    let mut arriving = vec![[0f32; C]; brought.len()];
    let first = size(&term);
    for _ in 0..MOST_BOUNCES {
        progress.check()?;
        for (term, rho) in term.iter_mut().zip(reflectance) {
            (0..C).for_each(|c| term[c] *= rho[c] as f32);
        }
        form_factors.irradiance_into::<f32, C>(term.as_flattened(), arriving.as_flattened_mut());
        std::mem::swap(&mut term, &mut arriving);
        for (sum, term) in sum.iter_mut().zip(&term) {
            (0..C).for_each(|c| sum[c] += f64::from(term[c]));
        }
        if size(&term) <= ENOUGH * first {
            break;
        }
    }
    Ok(sum)
}

/// Reduces the changes of each run of neighbours, so that their squares sum to the sum of `squares`, which has no noise.
/// Then scales all of them so that this holds for the whole scene too, because a run may not have less than zero.
fn without_noise<const C: usize>(
    change: &[[f64; C]],
    squares: &[f64],
    siblings: &[Range<usize>],
    areas: &[f64],
) -> Vec<f64> {
    let square = |change: &[f64; C]| change.iter().map(|x| x * x).sum::<f64>();
    let mut error = change.to_vec();
    for run in siblings {
        let true_sum: f64 = run.clone().map(|i| areas[i] * squares[i]).sum();
        let noisy_sum: f64 = run.clone().map(|i| areas[i] * square(&change[i])).sum();
        let share = if noisy_sum > 0.0 { (true_sum / noisy_sum).clamp(0.0, 1.0).sqrt() } else { 0.0 };
        error[run.clone()].as_flattened_mut().iter_mut().for_each(|x| *x *= share);
    }
    let whole = ordered_sum(areas.len(), |i| areas[i] * squares[i]).max(0.0);
    let found = ordered_sum(areas.len(), |i| areas[i] * square(&error[i]));
    let scale = if found > 0.0 { (whole / found).sqrt() } else { 0.0 };
    error.as_flattened().iter().map(|x| scale * x).collect()
}
