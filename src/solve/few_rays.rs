//! The light at equilibrium, estimated by few rays of each patch. The targets of the rays are stored, 4 bytes a ray,
//! and the sparse system that they form is solved by BiCGSTAB (van der Vorst, "Bi-CGSTAB: a fast and smoothly
//! converging variant of Bi-CG for the solution of nonsymmetric linear systems", 1992). A product takes only 32
//! look-ups a patch.

use nalgebra::SVector;
use rayon::prelude::*;

use super::sweep::{Sweeper, Tally, Targets};
use crate::{
    Progress, Result,
    form_factor::{SHORT, magnitude, ordered_sum},
    rays::ESCAPED,
};

/// Hemisphere rays of each patch.
pub(super) const RAYS: u32 = 32;
/// Tolerance of the residual, relative to the light that arrives first. The error of the light is larger by the number
/// of bounces, and relative to the light in dark corners. Sampling errors are larger still.
const TOLERANCE: f64 = 1e-8;
/// Most iterations. Reflectances within 10⁻³ of 1 take some tens.
const MOST: usize = 500;

/// Irradiance, or a similar quantity, of every patch.
type Light<const C: usize> = Vec<[f64; C]>;

/// Targets of few rays of every patch.
pub(super) struct FewRays<const C: usize> {
    /// Targets of each patch's rays.
    met: Vec<[u32; RAYS as usize]>,
    /// Irradiance of each patch from the sky; empty if no light enters from outside the patches.
    pub(super) sky: Light<C>,
    /// Number of rays.
    pub(super) tally: Tally,
}

impl<const C: usize> FewRays<C> {
    /// Casts hemisphere rays, from index `first` on.
    pub(super) fn cast(sweeper: &Sweeper<'_>, first: u32, progress: &Progress) -> Result<Self> {
        let Targets { met, sky, tally } = sweeper.met(first, progress)?;
        Ok(FewRays { met, sky, tally })
    }

    /// Share of the rays of patch `i` that escape.
    pub(super) fn escaping(&self, i: usize) -> f64 {
        self.met[i].iter().filter(|met| **met == ESCAPED).count() as f64 / f64::from(RAYS)
    }

    /// Irradiance of each patch from the light that all patches send.
    pub(super) fn gather(&self, sent: &[[f64; C]]) -> Light<C> {
        let gathered = |met: &[u32; _]| {
            let patches = met.iter().filter(|j| **j != ESCAPED);
            let sum: SVector<f64, C> = patches.map(|&j| SVector::from(sent[j as usize])).sum();
            (sum / f64::from(RAYS)).into()
        };
        self.met.par_iter().with_min_len(64).map(gathered).collect()
    }

    /// The irradiance e = first + F (ρ e), or `None` if the iterations do not converge.
    pub(super) fn solve(
        &self,
        first: &[[f64; C]],
        reflectance: &[[f64; C]],
        progress: &Progress,
    ) -> Result<Option<Light<C>>> {
        let product = |e: &[[f64; C]]| {
            let mut reflected = e.to_vec();
            update(&mut reflected, [reflectance; 2], |e, [rho, _], _| e * rho);
            let mut gathered = self.gather(&reflected);
            update(&mut gathered, [e; 2], |gathered, [e, _], _| e - gathered);
            gathered
        };
        let unit = magnitude(first.as_flattened());
        let first: Light<C> = first.iter().map(|e| e.map(|e| e / unit)).collect();
        let mut shadow = dot(&first, &first);
        let wanted = shadow * TOLERANCE.powi(2);
        let (mut light, mut residual, mut along) =
            (vec![[0.0; C]; first.len()], first.clone(), first.clone());
        for _ in 0..MOST {
            progress.check()?;
            let left = dot(&residual, &residual);
            // Channels that have converged stay unchanged.
            let moves: [bool; C] = std::array::from_fn(|c| left[c] > wanted[c]);
            if moves == [false; C] {
                light.iter_mut().flatten().for_each(|e| *e *= unit);
                let finite = light.iter().flatten().all(|e| e.is_finite());
                return Ok(finite.then_some(light));
            }
            let ratio = |p: SVector<f64, C>, q: SVector<f64, C>| -> SVector<f64, C> {
                SVector::from_fn(|c, _| if moves[c] && q[c] != 0.0 { p[c] / q[c] } else { 0.0 })
            };
            let carried = product(&along);
            let step = ratio(shadow, dot(&first, &carried));
            update(&mut residual, [&carried; 2], |r, [v, _], c| r - step[c] * v);
            let smoothed = product(&residual);
            let weight = ratio(dot(&smoothed, &residual), dot(&smoothed, &smoothed));
            update(&mut light, [&along, &residual], |e, [p, s], c| e + step[c] * p + weight[c] * s);
            update(&mut residual, [&smoothed; 2], |s, [t, _], c| s - weight[c] * t);
            let next = dot(&first, &residual);
            let turn = ratio(next, shadow).component_mul(&ratio(step, weight));
            update(&mut along, [&residual, &carried], |p, [r, v], c| r + turn[c] * (p - weight[c] * v));
            shadow = next;
        }
        Ok(None)
    }
}

/// Σ p q of each channel.
fn dot<const C: usize>(p: &[[f64; C]], q: &[[f64; C]]) -> SVector<f64, C> {
    ordered_sum(p.len(), |i| SVector::from(p[i]).component_mul(&SVector::from(q[i])))
}

/// Replaces each value of `light` by `value` of itself and of the values of two other lights.
fn update<const C: usize>(
    light: &mut [[f64; C]],
    by: [&[[f64; C]]; 2],
    value: impl Fn(f64, [f64; 2], usize) -> f64 + Sync,
) {
    let [p, q] = by;
    light.par_iter_mut().zip(p).zip(q).with_min_len(SHORT).for_each(|((light, p), q)| {
        (0..C).for_each(|c| light[c] = value(light[c], [p[c], q[c]], c));
    });
}
