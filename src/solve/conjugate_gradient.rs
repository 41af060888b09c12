//! Conjugate gradients on the symmetrised system.
//!
//! With reciprocal exchange areas S = A F and G = diag(sqrt(ρ / A)), the reflected radiosity is B - Be = G y, where
//!
//!   (I - G S G) y = G S Be
//!
//! is symmetric and, unless light is caught for ever, positive definite. No division by ρ occurs: black patches simply
//! have y = 0. Hestenes and Stiefel 1952; the channels run side by side through one product an iteration.

use super::{Iterate, SolveOptions, System};
use crate::{
    Progress, Result,
    form_factor::{SHORT, magnitude, ordered_sum},
};
use rayon::prelude::*;

/// Iterates until the true residual is small. Recursive residuals drift from the true ones in ill-conditioned rooms
/// (reflectances of 1 - 10⁻⁶ and up), so that convergence is judged by the true residual and restarted where needed.
pub(super) fn solve<const C: usize>(
    system: &System<C>,
    start: &[f64],
    options: &SolveOptions,
    progress: &Progress,
) -> Result<Iterate<C>> {
    let mut radiosity = start.as_chunks().0.to_vec();
    let mut iterations = 0;
    let mut best = f64::INFINITY;
    loop {
        let irradiance = system.irradiance(&radiosity);
        let residual = system.relative_residual(&radiosity, &irradiance);
        // Negated, so that NaN ends it too.
        let stalled = !(residual <= 0.5 * best);
        if residual <= options.tolerance || iterations >= options.max_iterations || stalled {
            return Ok((radiosity, iterations));
        }
        best = residual;
        let correction = correct(
            system,
            &radiosity,
            &irradiance,
            options.tolerance / residual,
            &mut iterations,
            options,
            progress,
        )?;
        for (b, d) in radiosity.iter_mut().zip(&correction) {
            for c in 0..C {
                b[c] = (b[c] + d[c]).max(0.0);
            }
        }
    }
}

/// Solves for the correction that removes the present residual, down to `reduction` times it.
fn correct<const C: usize>(
    system: &System<C>,
    radiosity: &[[f64; C]],
    irradiance: &[[f64; C]],
    reduction: f64,
    iterations: &mut usize,
    options: &SolveOptions,
    progress: &Progress,
) -> Result<Vec<[f64; C]>> {
    let n = radiosity.len();
    let areas = areas(system);
    // y = G⁻¹ d = d sqrt(A / ρ): the residual r of d is ρ times something, so that G⁻¹ r = sqrt(ρ A) (r / ρ).
    let gain: Vec<[f64; C]> =
        (0..n).map(|i| system.reflectance[i].map(|rho| (rho / areas[i]).sqrt())).collect();
    let mut r: Vec<[f64; C]> = (0..n)
        .map(|i| {
            let residual = system.residual(i, &radiosity[i], &irradiance[i]);
            std::array::from_fn(|c| if gain[i][c] > 0.0 { residual[c] / gain[i][c] } else { 0.0 })
        })
        .collect();
    let mut y = vec![[0.0; C]; n];
    let mut p = r.clone();
    let mut rr = dot(&r, &r);
    let start = rr;
    // A margin, since the norm here is another one than that of the tolerance.
    let goal = (0.03 * reduction.min(1.0)).powi(2);
    while *iterations < options.max_iterations && (0..C).any(|c| rr[c] > goal * start[c]) {
        progress.check()?;
        let q = apply(system, &areas, &gain, &p);
        let pq = dot(&p, &q);
        let alpha: [f64; C] = std::array::from_fn(|c| if pq[c] > 0.0 { rr[c] / pq[c] } else { 0.0 });
        let ends = y.par_iter_mut().zip(&mut r).zip(&p).zip(&q).with_min_len(SHORT);
        ends.for_each(|(((y, r), p), q)| {
            for c in 0..C {
                y[c] += alpha[c] * p[c];
                r[c] -= alpha[c] * q[c];
            }
        });
        let next = dot(&r, &r);
        *iterations += 1;
        if (0..C).all(|c| alpha[c] == 0.0) {
            break;
        }
        let growth: [f64; C] = std::array::from_fn(|c| if rr[c] > 0.0 { next[c] / rr[c] } else { 0.0 });
        p.par_iter_mut().zip(&r).with_min_len(SHORT).for_each(|(p, r)| {
            *p = std::array::from_fn(|c| if rr[c] > 0.0 { r[c] + growth[c] * p[c] } else { 0.0 });
        });
        rr = next;
    }
    Ok((0..n).map(|i| std::array::from_fn(|c| gain[i][c] * y[i][c])).collect())
}

/// Areas in a unit in which squares of what they weigh stay in range.
fn areas<const C: usize>(system: &System<C>) -> Vec<f64> {
    let areas = system.form_factors.areas();
    let unit = magnitude(areas);
    areas.iter().map(|a| a / unit).collect()
}

/// (I - G S G) p, where S = A F.
fn apply<const C: usize>(
    system: &System<C>,
    areas: &[f64],
    gain: &[[f64; C]],
    p: &[[f64; C]],
) -> Vec<[f64; C]> {
    let lifted: Vec<[f64; C]> = p
        .par_iter()
        .zip(gain)
        .with_min_len(SHORT)
        .map(|(p, g)| std::array::from_fn(|c| g[c] * p[c]))
        .collect();
    let mut out = system.irradiance(&lifted);
    out.par_iter_mut().enumerate().with_min_len(SHORT).for_each(|(i, out)| {
        for c in 0..C {
            out[c] = p[i][c] - gain[i][c] * areas[i] * out[c];
        }
    });
    out
}

/// Scalar products, summed in order.
fn dot<const C: usize>(a: &[[f64; C]], b: &[[f64; C]]) -> [f64; C] {
    std::array::from_fn(|c| ordered_sum(a.len(), |i| a[i][c] * b[i][c]))
}
