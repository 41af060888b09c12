//! Error over time on one scene, for different rays, patches, tolerances, solvers, estimators and for path tracing.
//!
//! All methods are compared by the mean irradiance of *common patches*, the coarsest subdivision of the sweep. The
//! truth is estimated by two independent reference solutions r1 and r2, with finer patches and more rays than any
//! point. In expectation, the mean of (x - r1)(x - r2) contains no noise of the references. [`Reference::error`] is the
//! remaining error from their discretisation and noise. Errors below it are marked as not believed.

mod sweep;

use crate::{
    Progress, Quality, Result,
    patch::{Patches, Subdivision},
    scene::Scene,
    solve::Solver,
    trace::Tracer,
};
use sweep::Sweep;

/// Rays per patch at the start of every line.
const FIRST_RAYS: f64 = 16.0;
/// Number of lines. Each line has edges half as long as the line before.
const LINES: i32 = 3;
/// The coarsest line has at least this many rays per patch at its end, for any number of triangles.
const LEAST_MOST_RAYS: f64 = 64.0;
/// Rays of each reference, relative to the rays of the largest point.
const REFERENCE_RAYS: f64 = 4.0;

/// Options of [`Tradeoff::of`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct TradeoffOptions {
    /// Approximate number of common patches.
    pub patches: usize,
    /// Number of rays of the largest point, over all patches. Time and memory are proportional to this number.
    pub rays: f64,
    /// Seed of all random numbers. The same seed gives the same errors, but not the same times.
    pub seed: u64,
}

setters!(TradeoffOptions {
    with_patches(patches: usize),
    with_rays(rays: f64),
    with_seed(seed: u64),
});

impl Default for TradeoffOptions {
    /// 1000 common patches and 2²¹ rays, as many as the preset [`Quality::MEDIUM`].
    fn default() -> Self {
        TradeoffOptions { patches: Quality::DRAFT.patches, rays: f64::from(1 << 21), seed: 0 }
    }
}

/// The series that a point belongs to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Series {
    /// Increasing numbers of rays on the patches of one line. Lines are numbered from the coarsest, from 0.
    Rays(usize),
    /// A preset, by its name.
    Preset(&'static str),
    /// An estimator of form factors, by its name.
    Estimator(&'static str),
    /// Solvers with different tolerances, on the same form factors.
    Solver,
    /// Path tracing of the common patches, with next event estimation.
    PathTracing,
}

/// Wall-clock times in seconds.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct Times {
    /// Subdivision and form factors. For path tracing, everything.
    pub casting: f64,
    /// The linear system.
    pub solving: f64,
    /// The error bars.
    pub error_bars: f64,
}

impl Times {
    /// The sum of all times.
    pub fn total(&self) -> f64 {
        self.casting + self.solving + self.error_bars
    }
}

/// Time and errors of one choice of options. Errors are area-weighted RMS errors over the common patches, relative to
/// the mean irradiance.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Point {
    /// The series that it belongs to.
    pub series: Series,
    /// Number of patches, backs included.
    pub patches: usize,
    /// Mean number of rays or paths per patch.
    pub rays: f64,
    /// The solver that ran; `None` for path tracing.
    pub solver: Option<Solver>,
    /// The tolerance of the solver.
    pub tolerance: f64,
    /// Iterations of the solver.
    pub iterations: usize,
    /// The error against the references. Zero if the noise of the references exceeds it.
    pub error: f64,
    /// Whether `error` exceeds the error of the references.
    pub believed: bool,
    /// The sampling error according to the error bars of the point.
    pub estimated_sampling: f64,
    /// The estimated discretisation error. `None` if unknown.
    pub estimated_discretisation: Option<f64>,
    /// Median over the runs of the time of each stage.
    pub seconds: Times,
    /// Number of runs with different seeds. The squares of the errors are averaged.
    pub runs: usize,
    /// Bytes of form factors and hits. For path tracing, bytes of the estimates.
    pub bytes: usize,
}

impl Point {
    /// The error estimate of the point itself: sampling and discretisation together.
    pub fn estimated(&self) -> f64 {
        self.estimated_sampling.hypot(self.estimated_discretisation.unwrap_or(0.0))
    }
}

/// Sizes and errors of the two references.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Reference {
    /// Number of patches of each reference.
    pub patches: usize,
    /// Mean number of rays per patch of each reference.
    pub rays: f64,
    /// Standard error of the references' mean, estimated from their difference, relative to the mean irradiance.
    pub sampling: f64,
    /// Change of the irradiance from edges twice as long, relative to the mean irradiance. It equals the remaining
    /// error if the error falls with the edge, and is three times as large if the error falls with the square of the
    /// edge.
    pub discretisation: f64,
}

impl Reference {
    /// Sampling and discretisation error together. Smaller errors of points are not believed.
    pub fn error(&self) -> f64 {
        self.sampling.hypot(self.discretisation)
    }
}

/// The result of a sweep.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Tradeoff {
    /// Number of common patches.
    pub common_patches: usize,
    /// The references.
    pub reference: Reference,
    /// The points, by series.
    pub points: Vec<Point>,
    /// Runs that were left out of the sweep, one sentence each.
    pub left_out: Vec<String>,
}

/// Sizes of the sweep.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Extent {
    /// Edge of the common patches.
    pub edge: f64,
    /// Rays of the largest point.
    pub rays: f64,
    /// Number of patches of a reference, without backs.
    pub reference_patches: f64,
    /// Mean number of rays per patch of a reference.
    pub reference_rays: f64,
}

impl Extent {
    /// The extent of a sweep on a scene.
    pub fn of(scene: &Scene, options: &TradeoffOptions) -> Extent {
        let common = Patches::subdivide(scene, &Subdivision::Count(options.patches));
        let rays = options.rays.max(LEAST_MOST_RAYS * common.len() as f64);
        let edge = common.edge();
        let finest = Subdivision::Edge(edge * 0.5f64.powi(LINES));
        let reference_patches = Patches::forecast(scene, &finest);
        let reference_rays = (REFERENCE_RAYS * rays / reference_patches).max(FIRST_RAYS);
        Extent { edge, rays, reference_patches, reference_rays }
    }
}

impl Tradeoff {
    /// Runs the sweep.
    ///
    /// # Errors
    /// See [`crate::form_factor::FormFactors::cast`] and [`crate::solve::solve`]. A solver that does not converge is
    /// not an error but left out.
    pub fn of(
        scene: &Scene,
        tracer: &Tracer,
        options: &TradeoffOptions,
        progress: &Progress,
    ) -> Result<Tradeoff> {
        let sweep = Sweep::new(scene, tracer, options, progress)?;
        let lines = sweep.lines()?;
        let presets = sweep.presets(&lines)?;
        let mut points: Vec<Point> = lines.into_iter().map(|(_, point)| point).collect();
        points.extend(presets);
        points.extend(sweep.estimators()?);
        let (solvers, left_out) = sweep.solvers()?;
        points.extend(solvers);
        points.extend(sweep.path_tracing()?);
        Ok(Tradeoff { common_patches: sweep.common.len(), reference: sweep.reference, points, left_out })
    }
}
