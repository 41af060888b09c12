//! Speed against accuracy on one scene: what rays, patches, tolerance, solver and estimator buy, and what path tracing
//! gives for the same time.
//!
//! What is compared is the mean irradiance of *common patches*, the coarsest subdivision of the sweep, so that coarse and
//! fine solutions and path tracing answer one question. The truth is known by two independent reference solutions r1 and
//! r2, with patches finer and rays more numerous than of any point. The mean of (x - r1)(x - r2) is free of their noise in
//! expectation; what their patches' size and their noise may still add is [`Reference::error`], and no error below that
//! is believed.

mod sweep;

use crate::{
    Progress, Quality, Result,
    patch::{Patches, Subdivision},
    scene::Scene,
    solve::Solver,
    trace::Tracer,
};
use sweep::Sweep;

/// Rays a patch at the start of every line.
const FIRST_RAYS: f64 = 16.0;
/// Every line has edges half as long as the one before.
const LINES: i32 = 3;
/// The coarsest line reaches at least this many rays a patch, however many triangles the scene has.
const LEAST_MOST_RAYS: f64 = 64.0;
/// Each of the two references casts this many times the rays of the largest point.
const REFERENCE_RAYS: f64 = 4.0;

/// How far to go.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct TradeoffOptions {
    /// About how many common patches.
    pub patches: usize,
    /// Rays of the largest point, all patches together. Time and memory grow in proportion.
    pub rays: f64,
    /// The same seed gives the same errors; times are never the same.
    pub seed: u64,
}

setters!(TradeoffOptions {
    with_patches(patches: usize),
    with_rays(rays: f64),
    with_seed(seed: u64),
});

impl Default for TradeoffOptions {
    /// 1000 common patches and 2²¹ rays: as many as the preset [`Quality::MEDIUM`] has.
    fn default() -> Self {
        TradeoffOptions { patches: Quality::DRAFT.patches, rays: f64::from(1 << 21), seed: 0 }
    }
}

/// What a point was made to show.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Series {
    /// More and more rays with the patches of one line, which is numbered from the coarsest.
    Rays(usize),
    /// A preset, by its name.
    Preset(&'static str),
    /// Another way from rays to form factors, by its name.
    Estimator(&'static str),
    /// Another solver or tolerance, on form factors cast once for all of them.
    Solver,
    /// Path tracing of the common patches with next event.
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

/// What one choice costs and gives. Errors are RMS by area over the common patches, relative to the mean irradiance.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Point {
    /// What it was made to show.
    pub series: Series,
    /// Patches, those on backs included.
    pub patches: usize,
    /// Mean rays a patch, or paths a patch.
    pub rays: f64,
    /// The solver that ran; `None` for path tracing.
    pub solver: Option<Solver>,
    /// The tolerance that it was given.
    pub tolerance: f64,
    /// Its iterations.
    pub iterations: usize,
    /// The true error; zero where the noise of the references outweighs it.
    pub error: f64,
    /// Whether the true error is above what is known of the references.
    pub believed: bool,
    /// The error that sampling is estimated to cause, from the point's own error bars.
    pub estimated_sampling: f64,
    /// The error that the size of its patches is estimated to cause; `None` where it cannot be told.
    pub estimated_discretisation: Option<f64>,
    /// The median of its runs, stage by stage.
    pub seconds: Times,
    /// How often it was run, with different seeds; the squares of the errors are averaged.
    pub runs: usize,
    /// Bytes of form factors and hits; of path tracing, its estimates.
    pub bytes: usize,
}

impl Point {
    /// The error that the point itself would tell its user: sampling and the size of patches together.
    pub fn estimated(&self) -> f64 {
        self.estimated_sampling.hypot(self.estimated_discretisation.unwrap_or(0.0))
    }
}

/// What the truth is taken from.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Reference {
    /// Patches of each of the two.
    pub patches: usize,
    /// Mean rays a patch of each.
    pub rays: f64,
    /// Standard error of their mean, from their difference.
    pub sampling: f64,
    /// Change of their irradiance from edges twice as long: what is left where the error falls with the edge, three times
    /// too much where it falls with its square.
    pub discretisation: f64,
}

impl Reference {
    /// Both parts together: no error below is believed.
    pub fn error(&self) -> f64 {
        self.sampling.hypot(self.discretisation)
    }
}

/// Speed against accuracy.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Tradeoff {
    /// How many patches errors are taken over.
    pub common_patches: usize,
    /// What the truth is taken from.
    pub reference: Reference,
    /// The points, by series.
    pub points: Vec<Point>,
    /// What was asked of the sweep and could not be had, a sentence each.
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
    /// Patches of a reference, but for backs.
    pub reference_patches: f64,
    /// Mean rays a patch of a reference.
    pub reference_rays: f64,
}

impl Extent {
    /// How far a sweep will go.
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
    /// As [`crate::form_factor::FormFactors::cast`] and [`crate::solve::solve`]; but a solver that does not converge is only
    /// left out.
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
