//! Speed against accuracy as JSON and CSV.

use std::io::{self, Write};

use serde::Serialize;

use crate::{
    accuracy::tradeoff::{Point, Series, Tradeoff},
    scene::{Scene, light::UnitNames},
};

/// The first line of the CSV.
pub const CSV_NAMES: &str = "series,name,patches,rays,solver,tolerance,iterations,error,believed,estimated_error,\
    estimated_sampling,estimated_discretisation,seconds,seconds_casting,seconds_solving,seconds_error_bars,runs,bytes";

/// The report of `radiosity tradeoff`. Errors are RMS over the common patches, weighted by area, relative to the mean
/// irradiance.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TradeoffReport {
    /// Version of the program.
    pub version: &'static str,
    /// The scene's file, as it was named.
    pub scene: String,
    /// Units of light. All errors are relative.
    pub units: UnitNames,
    /// Number of triangles.
    pub triangles: usize,
    /// Number of threads.
    pub threads: usize,
    /// Seed of the first run of every point.
    pub seed: u64,
    /// Number of common patches.
    pub common_patches: usize,
    /// The reference.
    pub reference: ReferenceReport,
    /// The points.
    pub points: Vec<PointReport>,
    /// Points that were left out, one sentence each.
    pub left_out: Vec<String>,
}

/// The reference: the mean of two solutions.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReferenceReport {
    /// Number of patches of each solution.
    pub patches: usize,
    /// Rays per patch of each solution.
    pub rays: f64,
    /// Estimated error of their mean: sampling error and discretisation error. Measured errors below this have no
    /// meaning.
    pub error: f64,
    /// The sampling error.
    pub sampling: f64,
    /// The discretisation error.
    pub discretisation: f64,
}

/// One choice of options with its time and its error.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PointReport {
    /// `rays`, `preset`, `estimator`, `solver` or `path tracing`.
    pub series: &'static str,
    /// Name of the preset or estimator; empty for other series.
    pub name: &'static str,
    /// Number of patches.
    pub patches: usize,
    /// Mean number of rays per patch; of paths per patch for path tracing.
    pub rays: f64,
    /// Name of the solver; empty for path tracing.
    pub solver: &'static str,
    /// Its tolerance.
    pub tolerance: Option<f64>,
    /// Number of iterations.
    pub iterations: usize,
    /// The measured error.
    pub error: f64,
    /// Whether the measured error is above the error of the reference.
    pub believed: bool,
    /// The error that the solution estimates for itself: sampling error and discretisation error.
    pub estimated_error: f64,
    /// The estimated sampling error.
    pub estimated_sampling: f64,
    /// The estimated discretisation error, if there is an estimate.
    pub estimated_discretisation: Option<f64>,
    /// Wall-clock time of casting, solving and error bars.
    pub seconds: f64,
    /// Time of subdivision and form factors; for path tracing, of everything.
    pub seconds_casting: f64,
    /// Time of the solver.
    pub seconds_solving: f64,
    /// Time of the error bars.
    pub seconds_error_bars: f64,
    /// Number of runs. Times are medians. Errors are root mean squares.
    pub runs: usize,
    /// Bytes of form factors and hits; of the estimates for path tracing.
    pub bytes: usize,
}

impl TradeoffReport {
    /// Collects the figures.
    pub fn new(file: &str, scene: &Scene, seed: u64, threads: usize, tradeoff: &Tradeoff) -> TradeoffReport {
        let reference = &tradeoff.reference;
        TradeoffReport {
            version: env!("CARGO_PKG_VERSION"),
            scene: file.into(),
            units: scene.units.names(),
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

    /// Writes the report as indented JSON, followed by a line end.
    ///
    /// # Errors
    /// Errors of writing to `out`.
    pub fn write_json(&self, out: &mut dyn Write) -> io::Result<()> {
        super::write_json(self, out)
    }

    /// Writes the points as CSV, with the names of the columns in the first line. The columns are the fields of
    /// [`PointReport`]. There are no quotes, because no name has a comma.
    ///
    /// # Errors
    /// Errors of writing to `out`.
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
