//! Validation of a solution: radiosity against path tracing and light tracing.
//!
//! An energy balance cannot distinguish a right solution from a wrong symmetric one. An estimate that shares no
//! numerics with the solver can. The discretisation error contributes to the difference too. To estimate it, the scene
//! is also solved with edges half as long.

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

/// Options of [`Validation::of`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ValidationOptions {
    /// The patches under test.
    pub subdivision: Subdivision,
    /// Rays per patch for the solution under test. The finer solution casts a quarter of this number from each of its
    /// patches.
    pub rays: f64,
    /// Paths per patch.
    pub paths: u32,
    /// Particles from the emitters.
    pub particles: u64,
    /// Options of the solver.
    pub solve: SolveOptions,
    /// Seed of all random numbers.
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
    /// About 1000 patches with 1024 rays and 1024 paths each, and 4 million particles. This takes some seconds and
    /// gives errors near 1 %.
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

/// Radiosity's estimates for the comparison: the irradiance of the front patches of `coarse`, with allowances for the
/// discretisation error. These come from `fine`, the same scene with edges half as long.
///
/// The error of `fine` is between a third of the change from `coarse` to `fine` (if the error falls with the square of
/// the edge) and all of it (if it falls with the edge). The irradiance of a patch is not corrected. Its allowance is
/// twice the change of the patch or of its neighbours, minus the part that sampling explains. The mean, for which a
/// small bias matters, is extrapolated by two thirds of the change, with an uncertainty of a third.
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

/// Averages values of the patches of `fine` over the front patches of `coarse`. The values have interleaved channels.
/// Both subdivide the same triangles.
///
/// # Panics
/// If the sizes disagree.
pub fn averaged(coarse: &Patches, fine: &Patches, values: &[f64]) -> Vec<f64> {
    weighted(coarse, fine, values, |share| share)
}

/// Standard errors of the averages of [`averaged`], from independent standard errors of the patches of `fine`.
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

/// Path tracing's estimates for the comparison, for the front patches.
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
    // Of two faces at the same place, only one is lit. Paths that start on the hidden face do not find this out.
    for (i, found) in found.iter_mut().enumerate() {
        if is_hidden(tracer, patches, i) {
            *found = Estimate::default();
        }
    }
    Ok(from_monte_carlo(&found, patches, |_| 1.0))
}

/// Light tracing's estimates for the comparison, for the front patches.
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

/// Raises standard errors at least to the common standard error of the patch's block. If light arrives by rare paths, a
/// patch that missed these paths has a mean and a standard error that are both too low. Its neighbours correct the
/// standard error.
fn share_luck(patches: &Patches, standard_error: &[f64]) -> Vec<f64> {
    let variance: Vec<f64> = standard_error.iter().map(|e| e * e).collect();
    at_least_common(patches, &variance).into_iter().map(f64::sqrt).collect()
}

/// Raises values at least to their mean over the block of up to 16 patches, two levels up the quadtree.
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

/// The results of all checks.
#[derive(Debug)]
#[non_exhaustive]
pub struct Validation {
    /// The solution under test.
    pub solved: Solved,
    /// Energy ledger of the solution.
    pub energy: EnergyLedger,
    /// Area-weighted root mean square of the allowances for the discretisation error, relative to the mean irradiance.
    pub discretisation_relative: f64,
    /// Irradiance of the front patches by radiosity.
    pub radiosity: Estimates,
    /// The same by path tracing.
    pub path_traced: Estimates,
    /// The same by light tracing.
    pub light_traced: Estimates,
    /// Radiosity against path tracing.
    pub path: Comparison,
    /// Radiosity against light tracing.
    pub light: Comparison,
    /// Path tracing against light tracing.
    pub referees: Comparison,
}

impl Validation {
    /// Solves the scene with two patch sizes, traces paths and particles, and compares the results.
    ///
    /// # Errors
    /// See [`Solved::new`] and [`light_traced`].
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
            radiosity,
            path_traced: path,
            light_traced: light,
        })
    }

    /// The checks that failed, one sentence each. Empty if all passed.
    pub fn objections(&self) -> Vec<String> {
        let mut objections = Vec::new();
        let mut limit = |what: &str, value: f64, limit: f64| {
            // The condition is negated, so that NaN fails.
            if !(value.abs() <= limit) {
                objections.push(format!("{what} is {value:.2e}; at most {limit:.0e} is allowed"));
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
