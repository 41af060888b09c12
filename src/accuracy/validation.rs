//! Whether the answer can be trusted: radiosity against path tracing and light tracing.
//!
//! An energy balance cannot tell a right answer from a wrong symmetric one; an estimate that shares no numerics with
//! the solver can. What the patches of finite size add to the difference is not guessed: the scene is solved with
//! edges half as long too, and the change tells.

use crate::{
    Progress, Result,
    accuracy::{
        comparison::{Comparison, Estimates},
        error_bars::relative_rms,
        solved::Solved,
    },
    energy::EnergyLedger,
    form_factor::{CastOptions, is_hidden},
    monte_carlo::{Effort, Estimate, LightOptions, LightTracer, PathOptions, PathTracer, Region},
    patch::{Patches, Subdivision},
    scene::Scene,
    solve::SolveOptions,
    trace::Tracer,
};

/// How hard to look.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ValidationOptions {
    /// The patches under test.
    pub subdivision: Subdivision,
    /// Rays a patch for the solution under test; the finer one takes a quarter of it from each of its patches.
    pub rays: f64,
    /// Paths a patch.
    pub paths: u32,
    /// Particles from the emitters.
    pub particles: u64,
    /// How the systems are solved.
    pub solve: SolveOptions,
    /// The same seed gives the same verdict.
    pub seed: u64,
}

setters!(ValidationOptions {
    with_subdivision(subdivision: Subdivision),
    with_rays(rays: f64),
    with_paths(paths: u32),
    with_particles(particles: u64),
    with_solve(solve: SolveOptions),
    with_seed(seed: u64),
});

impl Default for ValidationOptions {
    /// About 1000 patches, 1024 rays and 1024 paths each, 4 million particles: some seconds, errors near 1 %.
    fn default() -> Self {
        ValidationOptions {
            subdivision: Subdivision::Count(1000),
            rays: 1024.0,
            paths: 1024,
            particles: 1 << 22,
            solve: SolveOptions::default(),
            seed: 0,
        }
    }
}

/// Radiosity as one side of the comparison: estimates for the front patches of `coarse`, with allowances for their
/// size from `fine`, the same scene with edges half as long.
///
/// From `fine` on the error still left is between a third (if it falls with the square of the edge) and all (if it
/// falls with the edge) of the change between the two. A patch's own estimate stays as it is, and its allowance is
/// twice the change, its own or its neighbours', so far as it exceeds what sampling explains. The mean, where a small bias matters, is
/// extrapolated by two thirds of the change, give or take a third.
pub fn radiosity_estimates(coarse: &Solved, fine: &Solved) -> Estimates {
    let channels = coarse.solution.channels;
    let n = coarse.patches.fronts();
    let mean_fine = averaged(&coarse.patches, &fine.patches, &fine.solution.irradiance);
    let error_fine = averaged_errors(&coarse.patches, &fine.patches, &fine.error_bars.standard_error);
    let irradiance = coarse.solution.irradiance[..n * channels].to_vec();
    let standard_error = coarse.error_bars.standard_error[..n * channels].to_vec();
    let excess: Vec<f64> = (0..n * channels)
        .map(|q| (irradiance[q] - mean_fine[q]).powi(2) - standard_error[q].powi(2) - error_fine[q].powi(2))
        .collect();
    let allowance =
        at_least_common(&coarse.patches, &excess).iter().map(|x| 2.0 * x.max(0.0).sqrt()).collect();
    let total: f64 = (0..n).map(|i| coarse.patches.area(i)).sum();
    let mean = (0..channels)
        .map(|c| {
            let mean_of = |values: &[f64]| {
                (0..n).map(|i| coarse.patches.area(i) / total * values[i * channels + c]).sum::<f64>()
            };
            let (at_edge, at_half) = (mean_of(&irradiance), mean_of(&mean_fine));
            let change = at_half - at_edge;
            let noise =
                (5.0 / 3.0 * fine.error_bars.of_mean[c]).hypot(2.0 / 3.0 * coarse.error_bars.of_mean[c]);
            (at_half + 2.0 / 3.0 * change, noise.hypot(change / 3.0))
        })
        .collect();
    let standard_error = share_luck(&coarse.patches, &standard_error);
    Estimates { irradiance, standard_error, allowance, mean }
}

/// Values of the patches of `fine`, interleaved channels each, averaged over the front patches of `coarse`, which are cut from the
/// same triangles.
///
/// # Panics
/// When the sizes disagree.
pub fn averaged(coarse: &Patches, fine: &Patches, values: &[f64]) -> Vec<f64> {
    weighted(coarse, fine, values, |share| share)
}

/// Standard errors of such averages, from those of the patches of `fine`, taken to be independent.
pub(super) fn averaged_errors(coarse: &Patches, fine: &Patches, errors: &[f64]) -> Vec<f64> {
    let variance: Vec<f64> = errors.iter().map(|e| e * e).collect();
    weighted(coarse, fine, &variance, |share| share * share).into_iter().map(f64::sqrt).collect()
}

fn weighted(coarse: &Patches, fine: &Patches, values: &[f64], weight: impl Fn(f64) -> f64) -> Vec<f64> {
    let channels = fine.channels();
    let mut sums = vec![0.0; coarse.fronts() * channels];
    for j in 0..fine.fronts() {
        let (overlapped, share) = fine.overlap(coarse, j);
        for i in overlapped {
            for c in 0..channels {
                sums[i * channels + c] += weight(share) * values[j * channels + c];
            }
        }
    }
    sums
}

/// Path tracing as one side of the comparison, for the front patches.
///
/// # Errors
/// [`Error::Stopped`](crate::Error::Stopped).
pub fn path_traced(
    scene: &Scene,
    tracer: &Tracer,
    patches: &Patches,
    options: &ValidationOptions,
    progress: &Progress,
) -> Result<Estimates> {
    let regions: Vec<Region> = (0..patches.fronts())
        .map(|i| Region { triangle: patches.triangle(i), part: patches.barycentric_corners(i), front: true })
        .collect();
    let effort = Effort { samples: options.paths, seed: options.seed, ..Effort::default() };
    let mut found = PathTracer::new(scene, tracer, PathOptions::default())
        .mean_irradiances(&regions, &effort, progress)?;
    // Paths that begin on one of two faces at the same place do not know that light comes to the other.
    for (i, found) in found.iter_mut().enumerate() {
        if is_hidden(tracer, patches, i) {
            *found = Estimate::default();
        }
    }
    Ok(from_monte_carlo(&found, patches, |_| 1.0))
}

/// Light tracing as one side of the comparison, for the front patches.
///
/// # Errors
/// [`Error::Stopped`](crate::Error::Stopped); [`Error::NoEquilibrium`](crate::Error::NoEquilibrium).
pub fn light_traced(
    scene: &Scene,
    tracer: &Tracer,
    patches: &Patches,
    options: &ValidationOptions,
    progress: &Progress,
) -> Result<Estimates> {
    let light = LightOptions { particles: options.particles, seed: options.seed, ..LightOptions::default() };
    let front = |hit: &crate::trace::Hit| {
        let patch = patches.at(hit.triangle, hit.barycentric, true)?;
        hit.front.then_some(patch as usize)
    };
    let transport = LightTracer::new(scene, tracer, light).trace(patches.fronts(), front, progress)?;
    Ok(from_monte_carlo(&transport.bins, patches, |i| 1.0 / patches.area(i)))
}

/// Standard errors no lower than the common one of a patch's block. Where light comes by rare paths, a patch that missed
/// them has both too low a mean and too low an error; its neighbours know better.
fn share_luck(patches: &Patches, standard_error: &[f64]) -> Vec<f64> {
    let variance: Vec<f64> = standard_error.iter().map(|e| e * e).collect();
    at_least_common(patches, &variance).into_iter().map(f64::sqrt).collect()
}

/// Values no lower than their mean over the block of up to 16 patches, two levels up the quadtree, that a patch lies in.
fn at_least_common(patches: &Patches, values: &[f64]) -> Vec<f64> {
    let channels = patches.channels();
    let mut raised = values.to_vec();
    for members in patches.families(2).take_while(|members| members.end <= patches.fronts()) {
        for c in 0..channels {
            let mean = members.clone().map(|i| values[i * channels + c]).sum::<f64>() / members.len() as f64;
            for i in members.clone() {
                let value = &mut raised[i * channels + c];
                *value = value.max(mean);
            }
        }
    }
    raised
}

fn from_monte_carlo(found: &[Estimate], patches: &Patches, factor: impl Fn(usize) -> f64) -> Estimates {
    let channels = patches.channels();
    let values = |of: &dyn Fn(&Estimate) -> [f64; 3]| -> Vec<f64> {
        found
            .iter()
            .enumerate()
            .flat_map(|(i, e)| of(e).map(|x| x * factor(i)).into_iter().take(channels))
            .collect()
    };
    let areas: Vec<f64> = (0..found.len()).map(|i| patches.area(i)).collect();
    let mut estimates = Estimates::independent(values(&|e| e.mean), values(&|e| e.standard_error), &areas);
    estimates.standard_error = share_luck(patches, &estimates.standard_error);
    estimates
}

/// Everything that was looked at.
#[derive(Debug)]
#[non_exhaustive]
pub struct Validation {
    /// The solution under test.
    pub solved: Solved,
    /// Its energy ledger.
    pub energy: EnergyLedger,
    /// Area-weighted root mean square of the allowance for patch size, relative to the mean irradiance.
    pub discretisation_relative: f64,
    /// Radiosity against path tracing.
    pub path: Comparison,
    /// Radiosity against light tracing.
    pub light: Comparison,
    /// Path tracing against light tracing.
    pub referees: Comparison,
}

impl Validation {
    /// Solves the scene at two patch sizes, traces it from both ends, and compares.
    ///
    /// # Errors
    /// As [`Solved::new`] and [`light_traced`].
    pub fn of(
        scene: &Scene,
        tracer: &Tracer,
        options: &ValidationOptions,
        progress: &Progress,
    ) -> Result<Validation> {
        let cast = CastOptions { rays: options.rays, seed: options.seed, ..CastOptions::default() };
        let coarse = Solved::new(scene, tracer, &options.subdivision, &cast, &options.solve, progress)?;
        let finer = CastOptions { rays: 0.25 * options.rays, seed: options.seed.wrapping_add(1), ..cast };
        let quarters = coarse.patches.quartered(scene);
        let fine = Solved::of_patches(scene, tracer, quarters, &finer, &options.solve, progress)?;
        let radiosity = radiosity_estimates(&coarse, &fine);
        drop(fine);
        let path = path_traced(scene, tracer, &coarse.patches, options, progress)?;
        let light = light_traced(scene, tracer, &coarse.patches, options, progress)?;
        let areas = &coarse.form_factors.areas()[..coarse.patches.fronts()];
        Ok(Validation {
            energy: EnergyLedger::of(&coarse.form_factors, &coarse.patches, &coarse.solution),
            discretisation_relative: relative_rms(&radiosity.allowance, &radiosity.irradiance, areas),
            path: Comparison::of(&radiosity, &path, areas),
            light: Comparison::of(&radiosity, &light, areas),
            referees: Comparison::of(&path, &light, areas),
            solved: coarse,
        })
    }

    /// Every check that failed, a sentence each; empty when the answer can be trusted.
    pub fn objections(&self) -> Vec<String> {
        let mut objections = Vec::new();
        let mut limit = |what: &str, value: f64, limit: f64| {
            // Negated, so that NaN objects.
            if !(value.abs() <= limit) {
                objections.push(format!("{what} is {value:.2e}, {limit:.0e} is allowed"));
            }
        };
        limit("the energy imbalance", self.energy.imbalance(), 1e-9 + 64.0 * self.energy.rounding());
        limit("the row sum deviation", self.solved.form_factors.row_sum_deviation().after, 1e-9);
        limit("the reciprocity deviation", self.solved.form_factors.reciprocity_deviation().after, 1e-9);
        for (name, comparison) in self.comparisons() {
            objections.extend(comparison.objections().into_iter().map(|o| format!("{name}: {o}")));
        }
        objections
    }

    /// The comparisons with their names.
    pub fn comparisons(&self) -> [(&'static str, &Comparison); 3] {
        [
            ("radiosity against path tracing", &self.path),
            ("radiosity against light tracing", &self.light),
            ("path tracing against light tracing", &self.referees),
        ]
    }
}
