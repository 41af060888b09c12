//! Conjugate gradients on the symmetrised system.
//!
//! Reciprocal form factors are F_ij = l_i s_ij r_j with a symmetric s. With G = diag(sqrt(ρ l / r)) and
//! W = diag(sqrt(ρ l r)), the reflected radiosity is B - Be = G y, where
//!
//!   (I - W s W) y = G⁻¹ ρ F Be
//!
//! is symmetric and, unless light is trapped for ever, positive definite. No division by ρ occurs: black patches simply
//! have y = 0 (Hestenes and Stiefel 1952). One product in each iteration serves all channels.
//!
//! The iterations run in single precision, which takes half the time. They restart from the true residual, which is
//! computed in double precision (iterative refinement: Wilkinson, "Rounding Errors in Algebraic Processes", 1963). If
//! that does not converge, the iterations use double precision too.

use super::{Iterate, SolveOptions, System};
use crate::{
    Progress, Result,
    form_factor::{Real, SHORT, magnitude},
};
use rayon::prelude::*;

/// Greatest reduction of the residual by iterations in single precision: some hundred times their rounding.
const SINGLE: f64 = 3e-6;

/// Least mean share of light that surfaces and openings absorb for iterations in single precision.
const LEAST_LOSS: f64 = 1e-3;
/// Least area of a patch, relative to the mean, for iterations in single precision.
const LEAST_AREA: f64 = 1e-6;

/// Patches that reflect less than this start without reflected light, which would be lost in the rounding of their
/// emission.
const LEAST_REFLECTANCE: f64 = 1e-3;

/// Iterates until the true residual is small. Recursive residuals drift from the true ones in ill-conditioned rooms
/// (reflectances of 1 - 10⁻⁶ and more). So the true residual decides convergence, and the iteration restarts if needed.
/// Returns the irradiance as well.
pub(super) fn solve<const C: usize>(
    system: &System<C>,
    start: Option<&[f64]>,
    options: &SolveOptions,
    progress: &Progress,
) -> Result<(Iterate<C>, Vec<[f64; C]>)> {
    let judged = |radiosity: Vec<[f64; C]>| {
        let irradiance = system.irradiance(&radiosity);
        let residual = system.relative_residual(&radiosity, &irradiance);
        (radiosity, irradiance, residual)
    };
    let begin = start.map(|start| system.unknowns(start.as_chunks().0)).or_else(|| expected(system));
    // The expected radiosity may belong to other light.
    let begin = begin.map(judged).filter(|&(.., residual)| residual < 1.0);
    let (mut radiosity, mut irradiance, mut residual) =
        begin.unwrap_or_else(|| judged(system.source.to_vec()));
    let (mut iterations, mut single) = (0, suits_single(system));
    // Negated, so that NaN ends the loop too.
    while !(residual <= options.tolerance) && iterations < options.max_iterations {
        let most = options.max_iterations - iterations;
        // With a margin, because the tolerance uses another norm.
        let reduction = 0.5 * options.tolerance / residual;
        let (correction, taken) = if single {
            // Divided into steps of equal reduction.
            let steps = (reduction.ln() / SINGLE.ln()).ceil();
            let reduction = reduction.powf(steps.recip());
            // Four lanes fill a vector register, three do not.
            match C {
                3 => correct::<f32, C, 4>(system, &radiosity, &irradiance, reduction, most, progress),
                _ => correct::<f32, C, C>(system, &radiosity, &irradiance, reduction, most, progress),
            }
        } else {
            correct::<f64, C, C>(system, &radiosity, &irradiance, reduction, most, progress)
        }?;
        iterations += taken;
        let corrected = radiosity.par_iter().zip(&correction).with_min_len(SHORT);
        let corrected: Vec<[f64; C]> =
            corrected.map(|(b, d)| std::array::from_fn(|c| (b[c] + d[c]).max(0.0))).collect();
        let corrected = judged(corrected);
        let stalled = !(corrected.2 <= 0.5 * residual);
        // Results of single precision that are worse are dropped.
        if corrected.2 < residual || !single {
            (radiosity, irradiance, residual) = corrected;
        }
        if stalled && !std::mem::take(&mut single) {
            break;
        }
    }
    Ok(((radiosity, iterations), irradiance))
}

/// Whether single precision helps. It does not converge if hardly any light is absorbed, and its errors on the smallest
/// patches do not show in the residual.
fn suits_single<const C: usize>(system: &System<C>) -> bool {
    let (areas, escaped) = (system.form_factors.areas(), system.form_factors.escaped());
    let (all, least) = areas.iter().fold((0.0, f64::INFINITY), |(sum, least), &a| (sum + a, least.min(a)));
    let lost = |c: usize| -> f64 {
        let of_patch = |i: usize| areas[i] * (1.0 - system.reflectance[i][c] * (1.0 - escaped[i]));
        (0..areas.len()).map(of_patch).sum()
    };
    least * areas.len() as f64 > LEAST_AREA * all && (0..C).all(|c| lost(c) > LEAST_LOSS * all)
}

/// The radiosity that calibrated the form factors, if it has the same number of channels. It is brought to the form S
/// plus ρ times something, because corrections have that form and could not repair other errors on black patches.
fn expected<const C: usize>(system: &System<C>) -> Option<Vec<[f64; C]>> {
    let (known, n) = (system.form_factors.expected().as_chunks::<C>().0, system.source.len());
    let unit = system.form_factors.magnitude(system.emission.as_flattened());
    let of_patch = |i: usize| -> [f64; C] {
        std::array::from_fn(|c| {
            let (source, rho) = (system.source[i][c], system.reflectance[i][c]);
            let reflected = (f64::from(known[i][c]) * unit - source).max(0.0);
            if rho > LEAST_REFLECTANCE { source + reflected } else { source }
        })
    };
    let known_to_all = system.form_factors.expected().len() == n * C;
    known_to_all.then(|| (0..n).into_par_iter().with_min_len(SHORT).map(of_patch).collect())
}

/// Solves for the correction that removes the present residual. Stops when the residual has fallen to `reduction` times
/// itself, or after `most` iterations. Uses `W` lanes, of which `C` hold channels. Returns the number of iterations
/// too.
fn correct<T: Real, const C: usize, const W: usize>(
    system: &System<C>,
    radiosity: &[[f64; C]],
    irradiance: &[[f64; C]],
    reduction: f64,
    most: usize,
    progress: &Progress,
) -> Result<(Vec<[f64; C]>, usize)> {
    let n = radiosity.len();
    let (left, right) = system.form_factors.scaling();
    let patches = || (0..n).into_par_iter().with_min_len(SHORT);
    let gain = |i: usize, c: usize| (system.reflectance[i][c] * left[i] / right[i]).sqrt();
    // B = G y. The residual of B is a multiple of ρ, so that it can be divided by G.
    let residual: Vec<[f64; C]> = patches()
        .map(|i| {
            let residual = system.residual(i, &radiosity[i], &irradiance[i]);
            std::array::from_fn(|c| if gain(i, c) > 0.0 { residual[c] / gain(i, c) } else { 0.0 })
        })
        .collect();
    // In a unit in which single precision can hold it.
    let unit = magnitude(residual.as_flattened());
    let lanes = |value: &dyn Fn(usize) -> f64| -> [T; W] {
        std::array::from_fn(|c| T::of(if c < C { value(c) } else { 0.0 }))
    };
    let weights: Vec<[T; W]> =
        patches().map(|i| lanes(&|c| (system.reflectance[i][c] * left[i] * right[i]).sqrt())).collect();
    let mut r: Vec<[T; W]> = patches().map(|i| lanes(&|c| residual[i][c] / unit)).collect();
    drop(residual);
    let (mut y, mut p) = (vec![[T::of(0.0); W]; n], vec![[T::of(0.0); W]; n]);
    // W p, and s W p.
    let (mut weighted, mut image) = (p.clone(), p.clone());
    let mut rr: [f64; W] = in_order(r.par_chunks(SHORT).map(|r| dot(r, r)));
    let start = rr;
    let (goal, mut growth) = (reduction.powi(2), [0.0; W]);
    for iteration in 0..most {
        progress.check()?;
        if !(0..W).any(|c| rr[c] > goal * start[c]) {
            return Ok((unscaled(&y, gain, unit), iteration));
        }
        let steps = p.par_iter_mut().zip(&mut weighted).zip(&mut image).zip(&r).zip(&weights);
        steps.with_min_len(SHORT).for_each(|((((p, weighted), image), r), weight)| {
            for c in 0..W {
                p[c] = if rr[c] > 0.0 { r[c] + T::of(growth[c]) * p[c] } else { T::of(0.0) };
                weighted[c] = weight[c] * p[c];
                image[c] = T::of(0.0);
            }
        });
        system.form_factors.add_exchanged(&weighted, &mut image);
        let images = image.par_chunks_mut(SHORT).zip(p.par_chunks(SHORT)).zip(weights.par_chunks(SHORT));
        let pq: [f64; W] = in_order(images.map(|((image, p), weights)| {
            for ((image, p), weight) in image.iter_mut().zip(p).zip(weights) {
                for c in 0..W {
                    image[c] = p[c] - weight[c] * image[c];
                }
            }
            dot(p, image)
        }));
        let alpha: [f64; W] = std::array::from_fn(|c| if pq[c] > 0.0 { rr[c] / pq[c] } else { 0.0 });
        let ends = y.par_chunks_mut(SHORT).zip(r.par_chunks_mut(SHORT));
        let ends = ends.zip(p.par_chunks(SHORT)).zip(image.par_chunks(SHORT));
        let step = alpha.map(T::of);
        let next: [f64; W] = in_order(ends.map(|(((y, r), p), q)| {
            for (((y, r), p), q) in y.iter_mut().zip(&mut *r).zip(p).zip(q) {
                for c in 0..W {
                    y[c] += step[c] * p[c];
                    r[c] -= step[c] * q[c];
                }
            }
            dot(r, r)
        }));
        if alpha.iter().all(|&alpha| alpha == 0.0) {
            return Ok((unscaled(&y, gain, unit), iteration + 1));
        }
        growth = std::array::from_fn(|c| if rr[c] > 0.0 { next[c] / rr[c] } else { 0.0 });
        rr = next;
    }
    Ok((unscaled(&y, gain, unit), most))
}

/// G y in the unit of radiosity.
fn unscaled<T: Real, const C: usize, const W: usize>(
    y: &[[T; W]],
    gain: impl Fn(usize, usize) -> f64 + Sync,
    unit: f64,
) -> Vec<[f64; C]> {
    let patches = y.par_iter().enumerate().with_min_len(SHORT);
    patches.map(|(i, y)| std::array::from_fn(|c| gain(i, c) * y[c].into() * unit)).collect()
}

/// Σ a b over some patches.
fn dot<T: Real, const W: usize>(a: &[[T; W]], b: &[[T; W]]) -> [f64; W] {
    let mut sum = [0.0; W];
    for (a, b) in a.iter().zip(b) {
        for c in 0..W {
            sum[c] += a[c].into() * b[c].into();
        }
    }
    sum
}

/// The sum over runs of patches, in the same order for any number of threads.
fn in_order<const W: usize>(runs: impl IndexedParallelIterator<Item = [f64; W]>) -> [f64; W] {
    let runs: Vec<[f64; W]> = runs.collect();
    std::array::from_fn(|c| runs.iter().map(|run| run[c]).sum())
}
