//! The runs of a sweep.

use std::{mem::size_of, time::Instant};

use super::{Extent, FIRST_RAYS, LINES, Point, Reference, Series, Times, TradeoffOptions};
use crate::{
    Error, Progress, Quality, Result,
    accuracy::{
        discretisation::Discretisation,
        error_bars::{ErrorBars, relative_rms},
        solved::Solved,
        validation::{averaged, averaged_errors},
    },
    form_factor::{CastOptions, Estimator, FormFactors},
    monte_carlo::{Effort, Estimate, PathOptions, PathTracer, Region},
    patch::{Patches, Subdivision},
    scene::Scene,
    solve::{SolveOptions, Solver, solve_linear},
    trace::Tracer,
};

/// Each point of a line has this many times the rays of the previous point.
const STEP: f64 = 4.0;
/// Estimators and solvers are compared with this share of the rays of the largest point, rounded down to a power of two
/// per patch.
const SHORT: f64 = 1.0 / 15.0;
/// Number of runs of each point.
const REPEATS: u64 = 3;
/// A path takes about as long as this many rays of radiosity, including their form factors.
const RAYS_A_PATH: f64 = 2.0;
/// Tolerances of the compared solvers, the loosest first.
const TOLERANCES: [f64; 4] = [1e-1, 1e-2, 1e-4, 1e-10];
/// With more patches than this, a dense matrix takes too long.
const MOST_DIRECT: usize = 1500;

/// The scene, and its references.
pub(super) struct Sweep<'a> {
    scene: &'a Scene,
    tracer: &'a Tracer,
    progress: &'a Progress,
    seed: u64,
    extent: Extent,
    pub(super) common: Patches,
    areas: Vec<f64>,
    /// Irradiance of the common patches by each reference.
    truth: [Vec<f64>; 2],
    pub(super) reference: Reference,
}

/// One run: its point, and the squared relative error of the common patches.
struct Run {
    point: Point,
    square: f64,
}

impl<'a> Sweep<'a> {
    pub(super) fn new(
        scene: &'a Scene,
        tracer: &'a Tracer,
        options: &TradeoffOptions,
        progress: &'a Progress,
    ) -> Result<Self> {
        let extent = Extent::of(scene, options);
        let common = Patches::subdivide(scene, &Subdivision::Edge(extent.edge));
        let areas: Vec<f64> = (0..common.len()).map(|i| common.area(i)).collect();
        let solved = |k: u64| -> Result<Solved> {
            // This seed differs from the seeds of all points.
            let seed = options.seed.wrapping_add((1 << 32) + k);
            let cast = CastOptions { rays: extent.reference_rays, seed, ..CastOptions::default() };
            let finest = Subdivision::Edge(extent.edge * 0.5f64.powi(LINES));
            Solved::new(scene, tracer, &finest, &cast, &SolveOptions::default(), progress)
        };
        let first = solved(0)?;
        let one = averaged(&common, &first.patches, &first.solution.irradiance);
        let Solved { patches, form_factors, solution, .. } = &first;
        let size = Discretisation::of((scene, tracer), form_factors, patches, solution, progress)?;
        let (count, rays) = (patches.len(), rays_a_patch(form_factors));
        let size = size.map(|size| averaged(&common, patches, &size.error));
        drop(first);
        let second = solved(1)?;
        let two = averaged(&common, &second.patches, &second.solution.irradiance);
        let half: Vec<f64> = one.iter().zip(&two).map(|(a, b)| 0.5 * (a - b)).collect();
        let reference = Reference {
            patches: count,
            rays,
            sampling: relative_rms(&half, &one, &areas),
            discretisation: size.map_or(0.0, |size| relative_rms(&size, &one, &areas)),
        };
        let (seed, truth) = (options.seed, [one, two]);
        Ok(Sweep { scene, tracer, progress, seed, extent, common, areas, truth, reference })
    }

    /// Increasing numbers of rays for each size of patches. Returns each point with the requested numbers of patches
    /// and of rays per patch.
    pub(super) fn lines(&self) -> Result<Vec<([f64; 2], Point)>> {
        let mut points = Vec::new();
        for line in 0..LINES {
            let subdivision = Subdivision::Edge(self.extent.edge * 0.5f64.powi(line));
            let count = Patches::forecast(self.scene, &subdivision);
            let mut rays = FIRST_RAYS;
            while rays * count <= self.extent.rays {
                let cast = CastOptions { rays, ..CastOptions::default() };
                let point = self.radiosity(Series::Rays(line as usize), &subdivision, &cast)?;
                points.push(([count, rays], point));
                rays *= STEP;
            }
        }
        Ok(points)
    }

    /// The presets within the extent of the sweep.
    pub(super) fn presets(&self, lines: &[([f64; 2], Point)]) -> Result<Vec<Point>> {
        let mut points = Vec::new();
        for (name, quality) in Quality::PRESETS {
            let subdivision = Subdivision::Count(quality.patches);
            let rays = f64::from(quality.rays);
            let edge = Patches::subdivide(self.scene, &subdivision).edge();
            let count = Patches::forecast(self.scene, &subdivision);
            // The number of patches of a preset is approximate, and a scene may need more.
            let nominal = count.min(quality.patches as f64);
            let within = edge <= self.extent.edge && edge > self.extent.edge * 0.5f64.powi(LINES);
            if within && nominal * rays <= self.extent.rays {
                let series = Series::Preset(name);
                let cast = CastOptions { rays, ..CastOptions::default() };
                points.push(match lines.iter().find(|(asked, _)| *asked == [count, rays]) {
                    Some((_, same)) => Point { series, ..same.clone() },
                    None => self.radiosity(series, &subdivision, &cast)?,
                });
            }
        }
        Ok(points)
    }

    /// The numbers of patches and rays for the comparison of estimators and of solvers.
    fn common_ground(&self) -> (Subdivision, CastOptions) {
        // All estimators can cast exactly this number of rays if it is a power of two.
        let rays =
            (self.extent.rays * SHORT / self.common.len() as f64).max(FIRST_RAYS).log2().floor().exp2();
        let cast = CastOptions { rays, ..CastOptions::default() };
        (Subdivision::Edge(self.extent.edge), cast)
    }

    /// A point for each estimator of form factors, all with the same number of rays.
    pub(super) fn estimators(&self) -> Result<Vec<Point>> {
        let (subdivision, pooled) = self.common_ground();
        let evenly = CastOptions { by_variance: false, ..pooled };
        [
            ("pooled with rays by variance", pooled),
            ("pooled with rays evenly", evenly),
            ("pooled without shadow rays", CastOptions { shadow_share: 0.0, ..evenly }),
            ("one way", CastOptions { estimator: Estimator::OneWay, ..evenly }),
        ]
        .into_iter()
        .map(|(name, cast)| self.radiosity(Series::Estimator(name), &subdivision, &cast))
        .collect()
    }

    /// A point for every solver with every tolerance, and a sentence for each run that was left out.
    pub(super) fn solvers(&self) -> Result<(Vec<Point>, Vec<String>)> {
        let (subdivision, cast) = self.common_ground();
        let cast = CastOptions { seed: self.seed, ..cast };
        let start = Instant::now();
        let mut patches = Patches::subdivide(self.scene, &subdivision);
        let form_factors = FormFactors::cast(self.scene, self.tracer, &mut patches, &cast, self.progress)?;
        let casting = start.elapsed().as_secs_f64();
        let (mut points, mut left_out) = (Vec::new(), Vec::new());
        for solver in [
            Solver::ConjugateGradient,
            Solver::GaussSeidel,
            Solver::Jacobi,
            Solver::Southwell,
            Solver::Direct,
        ] {
            if solver == Solver::Direct && patches.len() > MOST_DIRECT {
                left_out.push(format!("direct: {} patches are too many", patches.len()));
                continue;
            }
            // The direct solver has no tolerance.
            let from = if solver == Solver::Direct { TOLERANCES.len() - 1 } else { 0 };
            for &tolerance in &TOLERANCES[from..] {
                // Linear light is found by conjugate gradients, whatever the solver.
                let options = SolveOptions { solver, tolerance, linear: false, ..SolveOptions::default() };
                let mut runs = Vec::new();
                for _ in 0..REPEATS {
                    let run = self.solved(&patches, &form_factors, casting, Series::Solver, &options);
                    match run {
                        Ok(run) => runs.push(run),
                        Err(Error::NotConverged { iterations, .. }) => {
                            left_out.push(format!(
                                "{} to {tolerance:e}: not reached in {iterations} iterations",
                                solver.name()
                            ));
                            break;
                        }
                        Err(error) => return Err(error),
                    }
                }
                points.extend(self.summed_up(runs));
            }
        }
        Ok((points, left_out))
    }

    /// Path tracing with increasing numbers of paths.
    pub(super) fn path_tracing(&self) -> Result<Vec<Point>> {
        let region = |i| Region {
            triangle: self.common.triangle(i),
            part: self.common.barycentric_corners(i),
            front: true,
        };
        let regions: Vec<Region> = (0..self.common.len()).map(region).collect();
        let paths = PathTracer::new(self.scene, self.tracer, PathOptions::default());
        let channels = self.common.channels();
        let most = (self.extent.rays / RAYS_A_PATH / regions.len() as f64).max(FIRST_RAYS);
        let mut points = Vec::new();
        let mut samples = FIRST_RAYS;
        while samples <= most {
            let mut runs = Vec::new();
            for repeat in 0..REPEATS {
                let seed = self.seed.wrapping_add(repeat);
                let effort = Effort { samples: samples as u32, seed, ..Effort::default() };
                let start = Instant::now();
                let found = paths.mean_irradiances(&regions, &effort, self.progress)?;
                let casting = start.elapsed().as_secs_f64();
                let of = |value: fn(&Estimate) -> [f64; 3]| -> Vec<f64> {
                    found.iter().flat_map(|e| value(e).into_iter().take(channels)).collect()
                };
                let replicate = size_of::<[f64; 3]>() * effort.replicates as usize;
                runs.push(Run {
                    square: self.square(&of(|e| e.mean)),
                    point: Point {
                        series: Series::PathTracing,
                        patches: regions.len(),
                        rays: samples,
                        solver: None,
                        tolerance: 0.0,
                        iterations: 0,
                        error: 0.0,
                        believed: false,
                        estimated_sampling: self.relative(&of(|e| e.standard_error)),
                        estimated_discretisation: Some(0.0),
                        seconds: Times { casting, ..Times::default() },
                        runs: 0,
                        bytes: regions.len() * (size_of::<Region>() + size_of::<Estimate>() + replicate),
                    },
                });
            }
            points.extend(self.summed_up(runs));
            samples *= STEP;
        }
        Ok(points)
    }

    /// A point of radiosity: casts and solves several times.
    fn radiosity(&self, series: Series, subdivision: &Subdivision, cast: &CastOptions) -> Result<Point> {
        let mut runs = Vec::new();
        for repeat in 0..REPEATS {
            let cast = CastOptions { seed: self.seed.wrapping_add(repeat), ..*cast };
            let start = Instant::now();
            let mut patches = Patches::subdivide(self.scene, subdivision);
            let form_factors =
                FormFactors::cast(self.scene, self.tracer, &mut patches, &cast, self.progress)?;
            let casting = start.elapsed().as_secs_f64();
            let options = SolveOptions::default();
            runs.push(self.solved(&patches, &form_factors, casting, series, &options)?);
        }
        Ok(self.summed_up(runs).expect("there is at least one run"))
    }

    /// Solves with form factors that took `casting` seconds to cast.
    fn solved(
        &self,
        patches: &Patches,
        form_factors: &FormFactors,
        casting: f64,
        series: Series,
        options: &SolveOptions,
    ) -> Result<Run> {
        let start = Instant::now();
        let solution =
            solve_linear((self.scene, self.tracer), form_factors, patches, options, self.progress)?;
        let solving = start.elapsed().as_secs_f64();
        let start = Instant::now();
        let error_bars = ErrorBars::of(form_factors, patches, &solution).expect("rays were cast");
        let seconds = Times { casting, solving, error_bars: start.elapsed().as_secs_f64() };
        let size =
            Discretisation::of((self.scene, self.tracer), form_factors, patches, &solution, self.progress)?;
        let size = size.map(|size| averaged(&self.common, patches, &size.error));
        let errors = averaged_errors(&self.common, patches, &error_bars.standard_error);
        let point = Point {
            series,
            patches: patches.len(),
            rays: rays_a_patch(form_factors),
            solver: Some(solution.solver),
            tolerance: options.tolerance,
            iterations: solution.iterations,
            error: 0.0,
            believed: false,
            estimated_sampling: self.relative(&errors),
            estimated_discretisation: size.map(|size| self.relative(&size)),
            seconds,
            runs: 0,
            bytes: form_factors.bytes(),
        };
        Ok(Run { square: self.square(&averaged(&self.common, patches, &solution.irradiance)), point })
    }

    /// The squared error relative to the squared mean irradiance. In expectation it contains no noise of the
    /// references.
    fn square(&self, irradiance: &[f64]) -> f64 {
        let [one, two] = &self.truth;
        let channels = self.common.channels();
        let (mut squares, mut mean, mut weight) = (0.0, 0.0, 0.0);
        for (q, x) in irradiance.iter().enumerate() {
            let area = self.areas[q / channels];
            squares += area * (x - one[q]) * (x - two[q]);
            mean += area * 0.5 * (one[q] + two[q]);
            weight += area;
        }
        if mean > 0.0 { squares * weight / (mean * mean) } else { 0.0 }
    }

    /// Root mean square of values relative to the mean irradiance of the first reference.
    fn relative(&self, values: &[f64]) -> f64 {
        relative_rms(values, &self.truth[0], &self.areas)
    }

    /// Combines several runs to one point. `None` if there are no runs.
    fn summed_up(&self, runs: Vec<Run>) -> Option<Point> {
        let count = runs.len();
        let mean = |value: fn(&Run) -> f64| runs.iter().map(value).sum::<f64>() / count as f64;
        let median = |value: fn(&Times) -> f64| {
            let mut values: Vec<f64> = runs.iter().map(|run| value(&run.point.seconds)).collect();
            values.sort_by(f64::total_cmp);
            values[count / 2]
        };
        let error = mean(|run| run.square).max(0.0).sqrt();
        let first = &runs.first()?.point;
        Some(Point {
            error,
            believed: error > self.reference.error(),
            estimated_sampling: mean(|run| run.point.estimated_sampling.powi(2)).sqrt(),
            estimated_discretisation: first
                .estimated_discretisation
                .map(|_| mean(|run| run.point.estimated_discretisation.unwrap_or(0.0).powi(2)).sqrt()),
            seconds: Times {
                casting: median(|t| t.casting),
                solving: median(|t| t.solving),
                error_bars: median(|t| t.error_bars),
            },
            runs: count,
            ..first.clone()
        })
    }
}

/// Mean number of rays per patch.
fn rays_a_patch(form_factors: &FormFactors) -> f64 {
    form_factors.rays() as f64 / form_factors.len() as f64
}
