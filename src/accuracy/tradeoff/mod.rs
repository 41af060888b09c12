//! Error over time on one scene, for rays, patches, tolerances, solvers, estimators and path tracing.
//!
//! All methods are compared by the mean irradiance of *common patches*, the coarsest subdivision of the sweep. The truth is
//! estimated by two independent reference solutions r1 and r2, with finer patches and more rays than any point. The mean of
//! (x - r1)(x - r2) is free of their noise in expectation. [`Reference::error`] is what their discretisation error and their
//! noise may still add, and smaller errors are marked as not believed.

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
/// Every line has edges half as long as the one before.
const LINES: i32 = 3;
/// The coarsest line reaches at least this many rays per patch, for any number of triangles.
const LEAST_MOST_RAYS: f64 = 64.0;
/// Each of the two references casts this many times the rays of the largest point.
const REFERENCE_RAYS: f64 = 4.0;

/// The extent of a sweep.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct TradeoffOptions {
    /// Approximate number of common patches.
    pub patches: usize,
    /// Number of rays of the largest point, over all patches. Time and memory are proportional to it.
    pub rays: f64,
    /// The same seed gives the same errors. Times differ.
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

/// What a point belongs to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Series {
    /// Increasing numbers of rays on the patches of one line. Lines are numbered from the coarsest.
    Rays(usize),
    /// A preset, by its name.
    Preset(&'static str),
    /// An estimator of form factors, by its name.
    Estimator(&'static str),
    /// A solver and a tolerance, on form factors that are cast once for all of them.
    Solver,
    /// Path tracing of the common patches, with next event estimation.
    PathTracing,
}

/// Seconds of the wall clock.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct Times {
    /// Subdivision and form factors; of path tracing, everything.
    pub casting: f64,
    /// The linear system.
    pub solving: f64,
    /// The error bars.
    pub error_bars: f64,
}

impl Times {
    /// All of it.
    pub fn total(&self) -> f64 {
        self.casting + self.solving + self.error_bars
    }
}

/// The time and the errors of one choice. Errors are area-weighted RMS errors over the common patches, relative to the mean irradiance.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Point {
    /// What it belongs to.
    pub series: Series,
    /// Patches, those on backs included.
    pub patches: usize,
    /// Mean number of rays or paths per patch.
    pub rays: f64,
    /// The solver that ran; `None` for path tracing.
    pub solver: Option<Solver>,
    /// The tolerance of the solver.
    pub tolerance: f64,
    /// Its iterations.
    pub iterations: usize,
    /// The true error. Zero if the noise of the references outweighs it.
    pub error: f64,
    /// Whether the true error exceeds the error of the references.
    pub believed: bool,
    /// The sampling error as estimated by the error bars of the point.
    pub estimated_sampling: f64,
    /// The estimated discretisation error. `None` if unknown.
    pub estimated_discretisation: Option<f64>,
    /// The median of its runs, stage by stage.
    pub seconds: Times,
    /// Number of runs with different seeds. The squares of the errors are averaged.
    pub runs: usize,
    /// Bytes of form factors and hits. For path tracing, bytes of the estimates.
    pub bytes: usize,
}

impl Point {
    /// The error that the point itself would report: sampling and discretisation together.
    pub fn estimated(&self) -> f64 {
        self.estimated_sampling.hypot(self.estimated_discretisation.unwrap_or(0.0))
    }
}

/// The references.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Reference {
    /// Number of patches of each of the two.
    pub patches: usize,
    /// Mean number of rays per patch of each.
    pub rays: f64,
    /// Standard error of their mean, from their difference.
    pub sampling: f64,
    /// Change of their irradiance from edges twice as long. It equals the remaining error if the error falls with the edge, and is three
    /// times as large if the error falls with its square.
    pub discretisation: f64,
}

impl Reference {
    /// Both parts together. Errors below this are not believed.
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
    /// What was left out of the sweep, one sentence each.
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
    /// As [`crate::form_factor::FormFactors::cast`] and [`crate::solve::solve`], except that a solver that does not converge is left
    /// out.
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
