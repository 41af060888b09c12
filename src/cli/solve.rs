//! `radiosity solve`: radiosity of every patch.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::Instant,
};

use clap::{Args, ValueEnum};
use radiosity::{
    Error, Progress, Result, Scene,
    accuracy::{
        bias, discretisation::Discretisation, error_bars::relative_rms, refinement::Round, solved::Solved,
    },
    energy::EnergyLedger,
    form_factor::{Checkpoint, Estimator},
    output::{
        exposure,
        file::{OutputFile, Pending},
        gltf,
        ply::{self, PlyOptions},
        report::{ErrorReport, OptionsReport, RoundReport, Seconds, SolveReport, peak_bytes, seconds},
    },
    solve::{SolveOptions, Solver, stochastic_jacobi},
    tone::Exposure,
    trace::Tracer,
};

use super::{
    Common, Outcome, forecast,
    options::{CastArgs, SceneArgs, below_one, percent, seconds_given, stops},
    outputs, pipeline,
    sampling::{Answer, Sampled, Sampling},
    summary, to_stderr, to_stdout,
    watch::Watch,
};

/// Share of the emitted power that rounding may lose in the sums of the energy ledger.
const ROUNDING: f64 = 1e-9;

/// Compute the radiosity of every patch of a scene
#[derive(Args)]
#[command(after_help = "Example:\n  radiosity solve room.obj -o room.ply --report room.json --quality high")]
pub struct SolveArgs {
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Write a coloured mesh: binary PLY with all figures, or glTF with colours at its vertices
    #[arg(short, long, value_name = "OUT.ply|.glb")]
    pub output: Option<PathBuf>,
    /// Write both sides of each patch that rays met on both, not only the side that has more light
    #[arg(long, requires = "output")]
    backs: bool,
    /// Write all figures as JSON
    #[arg(long, value_name = "R.json")]
    report: Option<PathBuf>,
    #[command(flatten)]
    pub cast: CastArgs,
    /// Algorithm for the linear system; auto takes cg for pooled form factors, else gauss-seidel, and stochastic-jacobi, with a
    /// warning, where memory does not hold a matrix: it casts new rays for each iteration and needs none
    #[arg(long, value_enum, default_value_t = SolverName::Auto)]
    solver: SolverName,
    /// Relative residual to reach [default: 1e-10]
    #[arg(long, value_name = "T", value_parser = below_one)]
    tolerance: Option<f64>,
    /// Form factors from the rays of both patches, reciprocal and closed, or from the rays of one: the baseline
    #[arg(long, value_enum, default_value_t = EstimatorName::Pooled)]
    estimator: EstimatorName,
    /// Make vertex colours brighter than automatic exposure does, by stops; negative is darker
    #[arg(long, value_name = "STOPS", default_value_t = 0.0, value_parser = stops)]
    exposure: f64,
    /// Keep sampling until the estimated RMS error of irradiance is at most so many percent of its mean; unless patches are
    /// chosen too, they are made small enough for it
    #[arg(long, value_name = "PERCENT", value_parser = percent, conflicts_with = "rays")]
    pub error: Option<f64>,
    /// Sample for as many seconds as this, and give the best answer by then
    #[arg(long, value_name = "SECONDS", value_parser = seconds_given, conflicts_with = "rays")]
    pub time: Option<f64>,
    /// Keep what rays meet in this file as they are cast. After a stop or a kill the same command goes on from it, to the same
    /// result. The file stays: more --rays or a lower --error go on from it too
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    /// Another seed casts other rays; the same gives the same bytes
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    #[command(flatten)]
    pub common: Common,
}

#[derive(Clone, Copy, ValueEnum)]
enum SolverName {
    Auto,
    Jacobi,
    GaussSeidel,
    Southwell,
    Cg,
    Direct,
    StochasticJacobi,
}

#[derive(Clone, Copy, ValueEnum)]
enum EstimatorName {
    Pooled,
    OneWay,
}

impl SolveArgs {
    pub fn estimator(&self) -> Estimator {
        match self.estimator {
            EstimatorName::Pooled => Estimator::Pooled,
            EstimatorName::OneWay => Estimator::OneWay,
        }
    }

    /// How to solve where there is a matrix.
    pub fn solve_options(&self) -> SolveOptions {
        let solver = match self.solver {
            SolverName::Auto | SolverName::StochasticJacobi => Solver::Auto,
            SolverName::Jacobi => Solver::Jacobi,
            SolverName::GaussSeidel => Solver::GaussSeidel,
            SolverName::Southwell => Solver::Southwell,
            SolverName::Cg => Solver::ConjugateGradient,
            SolverName::Direct => Solver::Direct,
        };
        let default = SolveOptions::default();
        default.with_solver(solver).with_tolerance(self.tolerance.unwrap_or(default.tolerance))
    }

    /// Whether no matrix is wanted.
    pub fn without_matrix(&self) -> bool {
        matches!(self.solver, SolverName::StochasticJacobi)
    }

    /// The first of the options given that nothing but a matrix can honour.
    pub fn needs_matrix(&self) -> Option<&'static str> {
        [
            (!matches!(self.solver, SolverName::Auto | SolverName::StochasticJacobi), "--solver"),
            (matches!(self.estimator, EstimatorName::OneWay), "--estimator"),
            (self.tolerance.is_some(), "--tolerance"),
            (self.checkpoint.is_some(), "--checkpoint"),
        ]
        .into_iter()
        .find_map(|(given, name)| given.then_some(name))
    }

    /// What lowers errors, on top of what was asked for.
    fn advice(&self) -> summary::Advice {
        let sampling = match (self.error, self.time) {
            (_, Some(_)) => "a longer --time",
            (Some(_), None) => "a lower --error",
            (None, None) => "a larger --rays, or --error,",
        };
        let patches = match self.cast.given_patches() {
            Some("--patch-size") => "a smaller --patch-size",
            None if self.error.is_some() => "a lower --error",
            _ => "a larger --patches",
        };
        summary::Advice { sampling, patches }
    }

    /// Refuses combinations that would only fail after hours.
    fn check(&self) -> Result<()> {
        if matches!((self.solver, self.estimator), (SolverName::Cg, EstimatorName::OneWay)) {
            return Err(Error::Usage {
                message: "--solver cg needs reciprocal form factors".into(),
                hint: Some("use --estimator pooled or --solver gauss-seidel".into()),
            });
        }
        match self.needs_matrix().filter(|_| self.without_matrix()) {
            None => Ok(()),
            Some(option) => Err(Error::Usage {
                message: format!(
                    "{option} is of no use with --solver {}: it keeps no form factors",
                    stochastic_jacobi::NAME
                ),
                hint: Some(format!("leave out {option}, or take another solver")),
            }),
        }
    }
}

/// What was computed.
struct Computed {
    scene: Scene,
    answer: Answer,
    rounds: Vec<Round>,
    chosen: String,
    error: ErrorReport,
}

/// Runs the command.
pub fn run(args: &SolveArgs) -> Result<Outcome> {
    let result = solve(args);
    match &args.checkpoint {
        Some(path) if matches!(result, Err(Error::Stopped)) && path.exists() => {
            to_stderr(format_args!(
                "{} keeps what was cast: the same command goes on from there",
                path.display()
            ));
        }
        _ => {}
    }
    result
}

fn solve(args: &SolveArgs) -> Result<Outcome> {
    let start = Instant::now();
    args.check()?;
    let mesh = args.output.as_ref().map(|path| outputs::mesh(path, &args.scene.path)).transpose()?;
    let report_file = args.report.as_ref().map(|path| outputs::report(path, &args.scene.path)).transpose()?;
    let checkpoint =
        args.checkpoint.as_ref().map(|path| outputs::checkpoint(path, &args.scene.path)).transpose()?;
    let files: Vec<_> = [&mesh, &report_file, &checkpoint].into_iter().flatten().collect();
    outputs::check_distinct(&files)?;
    args.common.start_threads()?;

    let watch = Watch::new(args.common.quiet);
    let mut times = Seconds::default();
    let computed = compute(args, &files, &watch, start, &mut times)?;
    let (patches, light) = (computed.answer.patches(), computed.answer.light());
    let exposure = exposure::of_radiosity(patches, light.radiosity).brighter(args.exposure);
    watch.begin_writing();
    let mut pending = Vec::new();
    let written;
    (written, times.output) = watch
        .stage("writing", || mesh.map(|file| write_mesh(args, file, &computed, exposure)).transpose())?;
    pending.extend(written);

    let mut report = report_of(args, &computed, exposure);
    times.total = seconds(start.elapsed());
    report.seconds = times;
    report.peak_bytes = peak_bytes();
    pending.extend(report_file.map(|file| file.write(|out| report.write(out))).transpose()?);

    watch.progress().check()?;
    // All is on the disk already: from here only names change.
    Pending::commit_all(pending)?;
    drop(watch);
    if !args.common.quiet {
        let names = outputs::names(&[&args.output, &args.report]);
        to_stdout(&summary::table(&report, patches, &computed.chosen, args.advice(), args.exposure, &names))?;
    }
    Ok(verdict(args, &report, &computed))
}

fn compute(
    args: &SolveArgs,
    outputs: &[&OutputFile],
    watch: &Watch,
    start: Instant,
    times: &mut Seconds,
) -> Result<Computed> {
    let (scene, tracer) = pipeline::load(&args.scene, outputs, watch, times)?;
    let checkpoint = args.checkpoint.as_ref().map(|path| open(path, &scene, args, watch)).transpose()?;
    let with_backs = forecast::with_backs(&scene, &tracer, args.seed);
    let sampling = Sampling { args, scene: &scene, tracer: &tracer, watch, checkpoint, with_backs };
    let Sampled { answer, rounds, chosen, floor } = sampling.run(start, times)?;
    let told = answer.errors();
    let error = ErrorReport {
        target: args.error.map(|percent| percent / 100.0),
        rms_relative: rounds.last().map(|round| round.error),
        bias_relative: told.and_then(|errors| errors.bias),
        discretisation_relative: match told {
            Some(errors) => errors.discretisation.as_ref().map(|d| d.relative),
            None => floor,
        },
        solver_relative: told.and_then(|errors| errors.solver),
        ..ErrorReport::default()
    };
    Ok(Computed { scene, answer, rounds, chosen, error })
}

/// What is told of a solution once no more rays are cast.
pub struct Errors {
    energy: EnergyLedger,
    /// Relative to the mean irradiance, as is the bound on what the solver left.
    bias: Option<f64>,
    solver: Option<f64>,
    discretisation: Option<Discretisation>,
}

impl Errors {
    pub fn of(
        options: &SolveOptions,
        tracer: &Tracer,
        solved: &Solved,
        progress: &Progress,
    ) -> Result<Errors> {
        let Solved { patches, form_factors, solution, .. } = solved;
        let unit = vec![1.0; solution.irradiance.len()];
        // One W/m2 relative to the mean irradiance; zero in the dark.
        let unit = relative_rms(&unit, &solution.irradiance, form_factors.areas());
        Ok(Errors {
            energy: EnergyLedger::of(form_factors, patches, solution),
            discretisation: Discretisation::of(form_factors, patches, solution, progress)?,
            bias: bias::relative(form_factors, tracer, patches, solution, options, progress)?,
            solver: Some(solution.error_bound * unit).filter(|x| x.is_finite() && unit > 0.0),
        })
    }
}

/// All figures but times and memory.
fn report_of(args: &SolveArgs, computed: &Computed, exposure: Exposure) -> SolveReport {
    let Computed { scene, answer, rounds, .. } = computed;
    let mut options = OptionsReport {
        rays_per_patch: rounds.last().map_or(0.0, |round| round.rays),
        estimator: "sweeps",
        tolerance: None,
        seed: args.seed,
        white: exposure.white(),
    };
    let file = args.scene.path.display().to_string();
    let mut report = match answer {
        Answer::Matrix(solved, errors) => {
            let Solved { patches, form_factors, solution, .. } = &**solved;
            options.estimator =
                if form_factors.estimator() == Estimator::Pooled { "pooled" } else { "one-way" };
            options.tolerance = Some(args.solve_options().tolerance);
            SolveReport::new(&file, scene, patches, form_factors, solution, &errors.energy, options)
        }
        Answer::Sweeps(patches, solution) => SolveReport::of_sweeps(&file, scene, patches, solution, options),
    };
    report.error = computed.error;
    report.rounds = rounds.iter().map(round_report).collect();
    report
}

/// Opens a checkpoint and says what is in it.
fn open(path: &Path, scene: &Scene, args: &SolveArgs, watch: &Watch) -> Result<Arc<Checkpoint>> {
    let checkpoint = Checkpoint::open(path, scene, args.seed)?;
    if checkpoint.torn() > 0 {
        watch.warn(&format!(
            "{}: cut off the last {} bytes, which the end of an earlier run left incomplete",
            path.display(),
            checkpoint.torn()
        ));
    }
    if checkpoint.found() > 0 && !args.common.quiet {
        watch.say(&format!("{}: {} rays are known from earlier runs", path.display(), checkpoint.found()));
    }
    Ok(Arc::new(checkpoint))
}

fn round_report(round: &Round) -> RoundReport {
    RoundReport { rays_per_patch: round.rays, rms_relative: round.error, elapsed: round.elapsed }
}

fn write_mesh(
    args: &SolveArgs,
    file: OutputFile,
    computed: &Computed,
    exposure: Exposure,
) -> Result<Pending> {
    let Computed { scene, answer, .. } = computed;
    if outputs::is_glb(file.path()) {
        return file.write(|out| {
            gltf::vertex_colours::encode(out, scene, answer.patches(), answer.light(), exposure)
        });
    }
    let discretisation = answer.errors().and_then(|errors| errors.discretisation.as_ref());
    let options = PlyOptions::default()
        .with_standard_errors(Some(answer.standard_error()))
        .with_discretisation(discretisation.map(|d| &d.change[..]))
        .with_backs(args.backs)
        .with_exposure(Some(exposure));
    file.write(|out| ply::encode(out, scene, answer.patches(), answer.light(), &options))
}

/// Whether form factors are shares, and the energy balances. Form factors from one side never do: that is what they are there to show.
/// Without a matrix what the rays miss has to be within its error.
fn verdict(args: &SolveArgs, report: &SolveReport, computed: &Computed) -> Outcome {
    let rounding = computed.answer.errors().map_or(0.0, |errors| errors.energy.rounding());
    let allowed = ROUNDING + args.solve_options().tolerance + 64.0 * rounding;
    let (imbalance, strays) = (report.energy.imbalance, report.form_factors.out_of_range);
    match args.estimator {
        _ if !report.solve.converged => Outcome::CheckFailed(format!(
            "{}: the energy does not balance: rays miss {} of what is emitted, with a standard error of {}",
            report.scene.file,
            summary::small(report.energy.sampled_imbalance),
            summary::small(report.energy.sampled_imbalance_error)
        )),
        _ if strays > 0 => {
            Outcome::CheckFailed(format!("{}: {strays} form factors are outside 0 to 1", report.scene.file))
        }
        // Also true of NaN.
        EstimatorName::Pooled if imbalance.abs().partial_cmp(&allowed).is_none_or(|o| o.is_gt()) => {
            Outcome::CheckFailed(format!(
                "{}: the energy does not balance: {imbalance:.3e} of what is emitted is missing, {allowed:.1e} is allowed",
                report.scene.file
            ))
        }
        _ => target_verdict(args, report),
    }
}

/// Whether the error that was asked for was reached: by the rays, and by the patches unless someone chose those.
fn target_verdict(args: &SolveArgs, report: &SolveReport) -> Outcome {
    let ErrorReport { target: Some(target), rms_relative, discretisation_relative, .. } = report.error else {
        return Outcome::Done;
    };
    let of_patches = discretisation_relative.filter(|_| args.cast.given_patches().is_none());
    let parts = [("sampling error", rms_relative), ("error of the patches' size", of_patches)];
    let missed = parts.into_iter().find_map(|(name, error)| Some((name, error.filter(|e| !(*e <= target))?)));
    missed.map_or(Outcome::Done, |(name, error)| {
        let (error, target) = (100.0 * error, 100.0 * target);
        let file = &report.scene.file;
        Outcome::CheckFailed(format!("{file}: the {name} is {error:.2} %, {target:.2} % was asked for"))
    })
}
