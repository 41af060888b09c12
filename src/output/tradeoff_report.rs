//! Speed against accuracy as JSON and CSV.

use std::io::{self, Write};

use serde::Serialize;

use crate::{
    accuracy::tradeoff::{Point, Series, Tradeoff},
    scene::Scene,
};

/// The first line of the CSV.
pub const CSV_NAMES: &str = "series,name,patches,rays,solver,tolerance,iterations,error,believed,estimated_error,\
    estimated_sampling,estimated_discretisation,seconds,seconds_casting,seconds_solving,seconds_error_bars,runs,bytes";

/// What `radiosity tradeoff` writes. Errors are RMS by area over the common patches, relative to the mean irradiance.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TradeoffReport {
    /// Version of the program.
    pub version: &'static str,
    /// The scene's file, as it was named.
    pub scene: String,
    /// Its triangles.
    pub triangles: usize,
    /// Threads that the times were taken with.
    pub threads: usize,
    /// The seed of the first run of every point.
    pub seed: u64,
    /// Patches that errors are taken over.
    pub common_patches: usize,
    /// What the truth is taken from.
    pub reference: ReferenceReport,
    /// The points.
    pub points: Vec<PointReport>,
    /// What could not be had, a sentence each.
    pub left_out: Vec<String>,
}

/// The two solutions that the truth is taken from.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReferenceReport {
    /// Patches of each.
    pub patches: usize,
    /// Rays a patch of each.
    pub rays: f64,
    /// Estimated error of their mean: sampling and the size of patches. No true error below it is believed.
    pub error: f64,
    /// The part of sampling.
    pub sampling: f64,
    /// The part of the patches' size.
    pub discretisation: f64,
}

/// One choice, what it costs and what it gives.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PointReport {
    /// `rays`, `preset`, `estimator`, `solver` or `path tracing`.
    pub series: &'static str,
    /// The preset or estimator.
    pub name: &'static str,
    /// Patches.
    pub patches: usize,
    /// Mean rays a patch; of path tracing, paths.
    pub rays: f64,
    /// The solver that ran; empty for path tracing.
    pub solver: &'static str,
    /// Its tolerance.
    pub tolerance: Option<f64>,
    /// Its iterations.
    pub iterations: usize,
    /// The true error.
    pub error: f64,
    /// Whether it is above the error of the reference.
    pub believed: bool,
    /// What the point itself tells of its error: sampling and the size of patches.
    pub estimated_error: f64,
    /// The part of sampling.
    pub estimated_sampling: f64,
    /// The part of the patches' size, where it can be told.
    pub estimated_discretisation: Option<f64>,
    /// Wall clock: casting, solving and error bars.
    pub seconds: f64,
    /// Subdivision and form factors; of path tracing, everything.
    pub seconds_casting: f64,
    /// The linear system.
    pub seconds_solving: f64,
    /// Error bars.
    pub seconds_error_bars: f64,
    /// Runs: times are medians, squares of errors are averaged.
    pub runs: usize,
    /// Bytes of form factors and hits; of path tracing, its estimates.
    pub bytes: usize,
}

impl TradeoffReport {
    /// Collects the figures.
    pub fn new(file: &str, scene: &Scene, seed: u64, threads: usize, tradeoff: &Tradeoff) -> TradeoffReport {
        let reference = &tradeoff.reference;
        TradeoffReport {
            version: env!("CARGO_PKG_VERSION"),
            scene: file.into(),
            triangles: scene.triangles.len(),
            threads,
            seed,
            common_patches: tradeoff.common_patches,
            reference: ReferenceReport {
                patches: reference.patches,
                rays: reference.rays,
                error: reference.error(),
                sampling: reference.sampling,
                discretisation: reference.discretisation,
            },
            points: tradeoff.points.iter().map(PointReport::of).collect(),
            left_out: tradeoff.left_out.clone(),
        }
    }

    /// Writes it as indented JSON with a line end after it.
    ///
    /// # Errors
    /// What `out` says.
    pub fn write_json(&self, out: &mut dyn Write) -> io::Result<()> {
        super::write_json(self, out)
    }

    /// Writes the points as CSV, names first, without quotes: no name has a comma. The columns are the fields of
    /// [`PointReport`].
    ///
    /// # Errors
    /// What `out` says.
    pub fn write_csv(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "{CSV_NAMES}")?;
        let maybe = |x: Option<f64>| x.map_or(String::new(), |x| x.to_string());
        for p in &self.points {
            writeln!(
                out,
                "{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{}",
                p.series,
                p.name,
                p.patches,
                p.rays,
                p.solver,
                maybe(p.tolerance),
                p.iterations,
                p.error,
                p.believed,
                p.estimated_error,
                p.estimated_sampling,
                maybe(p.estimated_discretisation),
                p.seconds,
                p.seconds_casting,
                p.seconds_solving,
                p.seconds_error_bars,
                p.runs,
                p.bytes
            )?;
        }
        Ok(())
    }
}

impl PointReport {
    fn of(point: &Point) -> PointReport {
        let (series, name) = match point.series {
            Series::Rays(_) => ("rays", ""),
            Series::Preset(name) => ("preset", name),
            Series::Estimator(name) => ("estimator", name),
            Series::Solver => ("solver", ""),
            Series::PathTracing => ("path tracing", ""),
        };
        PointReport {
            series,
            name,
            patches: point.patches,
            rays: point.rays,
            solver: point.solver.map_or("", |solver| solver.name()),
            tolerance: point.solver.map(|_| point.tolerance),
            iterations: point.iterations,
            error: point.error,
            believed: point.believed,
            estimated_error: point.estimated(),
            estimated_sampling: point.estimated_sampling,
            estimated_discretisation: point.estimated_discretisation,
            seconds: point.seconds.total(),
            seconds_casting: point.seconds.casting,
            seconds_solving: point.seconds.solving,
            seconds_error_bars: point.seconds.error_bars,
            runs: point.runs,
            bytes: point.bytes,
        }
    }
}
