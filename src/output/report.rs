//! The figures of a solution as JSON.
//!
//! Arrays of three are red, green and blue. A figure that is unknown or not finite is `null`. Lengths and areas are in
//! the unit of the scene. Powers are in watts if that unit is the metre.

use std::{
    io::{self, Write},
    time::Duration,
};

use rayon::prelude::*;
use serde::Serialize;

use crate::{
    Ranks,
    accuracy::{error_bars::ErrorBars, regions::RegionError},
    energy::EnergyLedger,
    form_factor::{self, FormFactors},
    patch::Patches,
    rays,
    scene::{Scene, light::UnitNames},
    solve::{
        Solution,
        stochastic_jacobi::{self, StochasticSolution},
    },
    tone::rgb,
};

/// The report of `radiosity solve`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SolveReport {
    /// Version of the program.
    pub version: &'static str,
    /// The scene and its patches.
    pub scene: SceneReport,
    /// The rays and the form factors.
    pub form_factors: FormFactorsReport,
    /// The linear system.
    pub solve: SolverReport,
    /// The energy ledger.
    pub energy: EnergyReport,
    /// The estimated errors.
    pub error: ErrorReport,
    /// The rounds of sampling.
    pub rounds: Vec<RoundReport>,
    /// Time of each stage.
    pub seconds: Seconds,
    /// Peak memory of the process in bytes; `null` if the operating system does not report it.
    pub peak_bytes: Option<u64>,
    /// The processes of an MPI job; left out if there is only one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ranks: Option<RanksReport>,
    /// The options, sufficient to repeat the computation.
    pub options: OptionsReport,
}

/// The processes of an MPI job.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RanksReport {
    /// Number of processes.
    pub count: usize,
    /// Bytes that all of them sent, if each sends its values once to each other one.
    pub bytes_sent: u64,
    /// Peak memory of each process in bytes.
    pub peak_bytes: Vec<u64>,
}

impl RanksReport {
    /// Collects the figures of all ranks; `None` if there is only one. All ranks must call this.
    pub fn of(ranks: Ranks, peak_bytes: Option<u64>) -> Option<RanksReport> {
        let bytes_sent = Ranks::sent();
        let peaks = || ranks.values(peak_bytes.unwrap_or(0));
        (ranks.count() > 1).then(|| RanksReport { count: ranks.count(), bytes_sent, peak_bytes: peaks() })
    }
}

/// The scene and its patches.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SceneReport {
    /// The file, as it was named.
    pub file: String,
    /// Number of triangles with an area.
    pub triangles: usize,
    /// Number of unknowns: patches of fronts, and of backs that rays have hit.
    pub patches: usize,
    /// Area of all triangles, one side each.
    pub area: f64,
    /// Number of channels: 1 if everything in the scene is grey, otherwise 3.
    pub channels: usize,
    /// Number of patches on backs.
    pub back_patches: usize,
    /// The longest edge that the subdivision allowed; `null` if triangles were left whole.
    pub patch_edge: Option<f64>,
    /// Units of light.
    pub units: UnitNames,
    /// Warnings of the reader: what it left out or assumed.
    pub warnings: Vec<String>,
}

/// The form factors.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FormFactorsReport {
    /// Rays cast.
    pub rays: u64,
    /// Number of form factors that are not zero.
    pub non_zeros: usize,
    /// Bytes of form factors and hits.
    pub bytes: usize,
    /// Share of the hemisphere rays that left the scene.
    pub escaped_fraction: f64,
    /// Number of rays that hit the back of a surface.
    pub back_hits: u64,
    /// Number of form factors outside 0 to 1. Any value but 0 is a bug.
    pub out_of_range: usize,
    /// Largest |sum of a row + its escaped share - 1|.
    pub row_sum_deviation: BeforeAfter,
    /// Largest |A_i F_ij - A_j F_ji| / min(A_i, A_j).
    pub reciprocity_deviation: BeforeAfter,
}

/// A figure before and after closure; `null` without form factors.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct BeforeAfter {
    /// For the form factors directly from the rays.
    pub before: Option<f64>,
    /// For the form factors that the solver uses.
    pub after: Option<f64>,
}

/// The solver and its convergence.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SolverReport {
    /// Its name.
    pub solver: &'static str,
    /// Number of iterations.
    pub iterations: usize,
    /// Σ A |Be + ρ E - B| / Σ A Be for the worst channel; `null` without a linear system.
    pub residual: Option<f64>,
    /// Bound on the difference of any patch's radiosity from the exact solution of the system; `null` if there is no
    /// bound.
    pub error_bound: Option<f64>,
    /// Whether the tolerance was reached. Without a linear system: whether the energy imbalance of the rays is explained by
    /// its standard error and the sampling error.
    pub converged: bool,
}

/// The energy ledger.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EnergyReport {
    /// Power emitted by surfaces.
    pub emitted: [f64; 3],
    /// Power from sky, sun and other lights that are not surfaces, as far as it hits a surface.
    pub entered: [f64; 3],
    /// Standard error of the power that enters; `null` if it is not known.
    pub entered_standard_error: Option<[f64; 3]>,
    /// Absorbed power.
    pub absorbed: [f64; 3],
    /// Escaped power.
    pub escaped: [f64; 3],
    /// Standard error of the escaped power; `null` without a matrix.
    pub escaped_standard_error: Option<[f64; 3]>,
    /// (emitted + entered - absorbed - escaped) / (emitted + entered) for the worst channel.
    pub imbalance: f64,
    /// The part of the imbalance that is due to the residual of the solver; `null` without a linear system.
    pub solver_part: Option<f64>,
    /// The part of the imbalance that is due to form factors without reciprocity; `null` without form factors.
    pub reciprocity_part: Option<f64>,
    /// Without a matrix: the imbalance of the rays, before the result is scaled to remove it.
    pub sampled_imbalance: Option<f64>,
    /// Standard error of that imbalance.
    pub sampled_imbalance_error: Option<f64>,
}

/// The error of a material or an object.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RegionReport {
    /// Name of the material or object, as in `material wall` or `object lamp`.
    pub region: String,
    /// Area-weighted root mean square of the irradiance's standard error, relative to the region's own mean irradiance.
    pub rms_relative: f64,
}

impl From<&RegionError> for RegionReport {
    fn from(error: &RegionError) -> Self {
        RegionReport { region: error.region.clone(), rms_relative: error.rms_relative }
    }
}

/// Estimated errors. An error without an estimate is `null`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ErrorReport {
    /// Root mean square of the standard errors of irradiance, weighted by area, relative to the mean irradiance.
    pub rms_relative: Option<f64>,
    /// Level of the confidence intervals.
    pub confidence: f64,
    /// Estimated bias, relative to the mean irradiance.
    pub bias_relative: Option<f64>,
    /// Discretisation error, relative to the mean irradiance. Without a matrix, it is given only if it determined the
    /// patches.
    pub discretisation_relative: Option<f64>,
    /// Sampling and discretisation together: the root of the sum of their squares.
    pub total_relative: Option<f64>,
    /// Bound on the error of the solver, relative to the mean irradiance; `null` if there is no bound.
    pub solver_relative: Option<f64>,
    /// The value of `--error`; `null` without it.
    pub target: Option<f64>,
    /// The material or object with the largest sampling error; `null` if no light arrives anywhere.
    pub largest_region: Option<RegionReport>,
}

/// A round of sampling.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RoundReport {
    /// Mean number of rays per patch in all rounds so far.
    pub rays_per_patch: f64,
    /// The sampling error, defined as `rms_relative` of [`ErrorReport`].
    pub rms_relative: f64,
    /// Seconds since the first round began.
    pub elapsed: f64,
}

impl Default for ErrorReport {
    /// No estimates, confidence level 0.95.
    fn default() -> Self {
        ErrorReport {
            rms_relative: None,
            confidence: 0.95,
            bias_relative: None,
            discretisation_relative: None,
            total_relative: None,
            solver_relative: None,
            target: None,
            largest_region: None,
        }
    }
}

/// Wall-clock time of each stage in seconds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Seconds {
    /// Reading the scene.
    pub load: f64,
    /// Cutting the scene into patches.
    pub subdivide: f64,
    /// Building the bounding volume hierarchy.
    pub bvh: f64,
    /// Casting rays and computing form factors.
    pub form_factors: f64,
    /// Solving, energy ledger and error bars.
    pub solve: f64,
    /// Writing the mesh.
    pub output: f64,
    /// All stages up to the report.
    pub total: f64,
}

/// The options as given, or their defaults.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OptionsReport {
    /// Requested number of rays per patch.
    pub rays_per_patch: f64,
    /// `pooled` or `one-way`; `sweeps` without a matrix.
    pub estimator: &'static str,
    /// Tolerance for the relative residual; `null` without a matrix.
    pub tolerance: Option<f64>,
    /// Seed of the rays.
    pub seed: u64,
    /// Radiosity shown as white in the mesh, W/m².
    pub white: f64,
}

impl SolveReport {
    /// Collects the figures of a solution. The caller adds times, errors and peak memory.
    pub fn new(
        file: &str,
        scene: &Scene,
        patches: &Patches,
        form_factors: &FormFactors,
        (solution, error_bars): (&Solution, &ErrorBars),
        energy: &EnergyLedger,
        options: OptionsReport,
    ) -> SolveReport {
        SolveReport {
            version: env!("CARGO_PKG_VERSION"),
            scene: SceneReport::of(file, scene, patches),
            form_factors: FormFactorsReport::of(form_factors),
            solve: SolverReport {
                solver: solution.solver.name(),
                iterations: solution.iterations,
                residual: Some(solution.residual),
                error_bound: finite(solution.error_bound),
                converged: true,
            },
            energy: EnergyReport {
                entered_standard_error: Some(rgb(&error_bars.of_entered)),
                escaped_standard_error: Some(rgb(&error_bars.of_escaped)),
                ..EnergyReport::of(energy)
            },
            error: ErrorReport::default(),
            rounds: Vec::new(),
            seconds: Seconds::default(),
            peak_bytes: None,
            ranks: None,
            options,
        }
    }

    /// Collects the figures of a solution without a matrix.
    pub fn of_sweeps(
        file: &str,
        scene: &Scene,
        patches: &Patches,
        solution: &StochasticSolution,
        options: OptionsReport,
    ) -> SolveReport {
        let tally = solution.tally;
        SolveReport {
            version: env!("CARGO_PKG_VERSION"),
            scene: SceneReport::of(file, scene, patches),
            form_factors: FormFactorsReport {
                rays: tally.hemisphere + tally.shadow,
                non_zeros: 0,
                bytes: 0,
                escaped_fraction: tally.escaped as f64 / tally.hemisphere.max(1) as f64,
                back_hits: tally.backs,
                out_of_range: 0,
                row_sum_deviation: BeforeAfter::default(),
                reciprocity_deviation: BeforeAfter::default(),
            },
            solve: SolverReport {
                solver: stochastic_jacobi::NAME,
                iterations: solution.sweeps as usize,
                residual: None,
                error_bound: None,
                converged: solution.is_balanced(),
            },
            energy: EnergyReport::of_sweeps(solution),
            error: ErrorReport { rms_relative: Some(solution.reached.error), ..ErrorReport::default() },
            rounds: Vec::new(),
            seconds: Seconds::default(),
            peak_bytes: None,
            ranks: None,
            options,
        }
    }

    /// Writes the report as indented JSON, followed by a line end.
    ///
    /// # Errors
    /// Errors of writing to `out`.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        super::write_json(self, out)
    }
}

impl SceneReport {
    /// Collects the figures of a scene that was read from `file`.
    pub fn of(file: &str, scene: &Scene, patches: &Patches) -> Self {
        SceneReport {
            file: file.into(),
            triangles: scene.triangles.len() - scene.backs_of_lamps,
            patches: patches.len(),
            area: (0..scene.triangles.len()).map(|t| scene.area(t)).sum(),
            channels: patches.channels(),
            back_patches: patches.len() - patches.fronts(),
            patch_edge: finite(patches.edge()),
            units: scene.units.names(),
            warnings: scene.warnings.clone(),
        }
    }
}

impl FormFactorsReport {
    fn of(form_factors: &FormFactors) -> Self {
        let rays = form_factors.ray_set();
        let count = |what: fn(&[u32]) -> usize| -> usize {
            rays.map_or(0, |h| (0..h.len()).into_par_iter().map(|i| what(h.of(i))).sum())
        };
        let escaped = count(|targets| targets.iter().filter(|&&t| t == rays::ESCAPED).count());
        FormFactorsReport {
            rays: form_factors.rays(),
            non_zeros: form_factors.non_zeros(),
            bytes: form_factors.bytes(),
            escaped_fraction: escaped as f64 / count(<[u32]>::len).max(1) as f64,
            back_hits: rays.map_or(0, |h| h.back_hits()),
            out_of_range: form_factors.out_of_range(),
            row_sum_deviation: form_factors.row_sum_deviation().into(),
            reciprocity_deviation: form_factors.reciprocity_deviation().into(),
        }
    }
}

impl From<form_factor::BeforeAfter> for BeforeAfter {
    fn from(figure: form_factor::BeforeAfter) -> Self {
        BeforeAfter { before: Some(figure.before), after: Some(figure.after) }
    }
}

impl EnergyReport {
    /// Collects the figures of a ledger.
    pub fn of(energy: &EnergyLedger) -> Self {
        EnergyReport {
            emitted: rgb(&energy.emitted),
            entered: rgb(&energy.entered),
            entered_standard_error: None,
            absorbed: rgb(&energy.absorbed),
            escaped: rgb(&energy.escaped),
            escaped_standard_error: None,
            imbalance: energy.imbalance(),
            solver_part: Some(energy.relative_solver_part()),
            reciprocity_part: Some(energy.relative_reciprocity_part()),
            sampled_imbalance: None,
            sampled_imbalance_error: None,
        }
    }

    /// Collects the figures of a solution without a matrix.
    fn of_sweeps(solution: &StochasticSolution) -> Self {
        let (imbalance, error) = solution.worst_imbalance();
        EnergyReport {
            emitted: rgb(&solution.emitted),
            entered: rgb(&solution.entered),
            entered_standard_error: Some(rgb(&solution.entered_error)),
            absorbed: rgb(&solution.absorbed),
            escaped: rgb(&solution.escaped),
            escaped_standard_error: None,
            imbalance: solution.balanced_to(),
            solver_part: None,
            reciprocity_part: None,
            sampled_imbalance: Some(imbalance),
            sampled_imbalance_error: Some(error),
        }
    }
}

fn finite(x: f64) -> Option<f64> {
    x.is_finite().then_some(x)
}

/// Peak memory of this process on Linux; `None` on other systems.
pub fn peak_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(1024 * kibibytes)
}

/// A time in seconds, rounded to microseconds.
pub fn seconds(time: Duration) -> f64 {
    (time.as_secs_f64() * 1e6).round() / 1e6
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn peak_memory_is_that_of_this_process() {
        if cfg!(target_os = "linux") {
            let held = vec![1u8; 64 << 20];
            assert!(held.iter().all(|&b| b == 1) && peak_bytes().unwrap() > 64 << 20);
        }
    }
}
