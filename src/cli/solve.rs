//! `radiosity solve`: radiosity of every patch.

use std::{f64::consts::PI, path::PathBuf, time::Instant};

use clap::{Args, ValueEnum};
use radiosity::{
    Error, Progress, Ranks, Result, Scene,
    accuracy::{
        bias, discretisation::Discretisation, error_bars::relative_rms, refinement::Round, regions,
        solved::Solved,
    },
    energy::EnergyLedger,
    form_factor::Estimator,
    monte_carlo::{Camera, Film, RenderOptions},
    output::{
        exposure,
        file::{OutputFile, Pending},
        gltf, picture,
        ply::{self, PlyOptions},
        report::{
            ErrorReport, OptionsReport, RanksReport, RoundReport, Seconds, SolveReport, peak_bytes, seconds,
        },
    },
    patch::Patches,
    solve::{Light, SolveOptions, Solver, stochastic_jacobi},
    tone::Exposure,
    trace::Tracer,
};

use super::{
    Common, Outcome,
    checkpoint::{self, CheckpointArgs, Files},
    forecast,
    options::{CastArgs, SceneArgs, below_one, percent, seconds_given, stops},
    outputs,
    page::{self, PageArgs},
    pipeline,
    sampling::{Answer, Sampled, Sampling},
    summary, to_stdout,
    watch::Watch,
};

/// Largest share of the power of all lights that may be missing in the energy ledger by rounding.
const ROUNDING: f64 = 1e-9;

/// Pixels of `--picture`: the defaults of `render`.
const PICTURE_WIDTH: usize = 640;
const PICTURE_HEIGHT: usize = 480;
/// Samples per pixel. They smooth edges. The light itself has no noise.
const PICTURE_SAMPLES: u32 = 8;

/// Compute the radiosity of every patch of a scene
#[derive(Args)]
#[command(
    after_help = "Example:\n  radiosity solve room.obj -o room.ply --picture room.png --report room.json"
)]
pub struct SolveArgs {
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Write a coloured mesh: binary PLY with all figures, or glTF with colours at its vertices
    #[arg(short, long, value_name = "OUT.ply|.glb")]
    pub output: Option<PathBuf>,
    /// Write a picture of the solution that frames the scene; `render` has a camera and a final gather
    #[arg(long, value_name = "OUT.png|.exr|.hdr")]
    pub picture: Option<PathBuf>,
    #[command(flatten)]
    pub page: PageArgs,
    /// Write both sides of each patch to the mesh. Without this option, the side with more light is written
    #[arg(long, requires = "output")]
    backs: bool,
    /// Write all figures as JSON
    #[arg(long, value_name = "R.json")]
    report: Option<PathBuf>,
    #[command(flatten)]
    pub cast: CastArgs,
    /// Solver of the linear system. `auto` is cg for pooled form factors and gauss-seidel for one-way form factors. If
    /// the matrix does not fit into memory, `auto` warns and uses stochastic-jacobi, which casts new rays in each
    /// iteration instead
    #[arg(long, value_enum, default_value_t = SolverName::Auto)]
    solver: SolverName,
    /// Relative residual at which the solver stops [default: 1e-10]
    #[arg(long, value_name = "T", value_parser = below_one)]
    tolerance: Option<f64>,
    /// `pooled` form factors use the rays of both patches of a pair; they are reciprocal and closed. `one-way` form
    /// factors use the rays of one patch; they are a baseline for comparison
    #[arg(long, value_enum, default_value_t = EstimatorName::Pooled)]
    estimator: EstimatorName,
    /// Make vertex colours and the picture brighter by this number of stops. A negative number makes them darker
    #[arg(long, value_name = "STOPS", default_value_t = 0.0, value_parser = stops)]
    exposure: f64,
    /// Sample until the estimated RMS error of irradiance, from sampling and from the size of patches, is at most this
    /// percentage of its mean. The program makes patches small enough, unless an option sets them
    #[arg(long, value_name = "PERCENT", value_parser = percent, conflicts_with = "rays")]
    pub error: Option<f64>,
    /// Sample for this number of seconds, and give the best answer by then
    #[arg(long, value_name = "SECONDS", value_parser = seconds_given, conflicts_with = "rays")]
    pub time: Option<f64>,
    #[command(flatten)]
    pub checkpoint: CheckpointArgs,
    /// Seed of the random numbers. The same seed gives the same bytes
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

    /// Options of the solver with a matrix.
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
        let tolerance = self.tolerance.unwrap_or(default.tolerance);
        default.with_solver(solver).with_tolerance(tolerance).with_linear(self.cast.linear())
    }

    /// Whether the solver without a matrix was chosen.
    pub fn without_matrix(&self) -> bool {
        matches!(self.solver, SolverName::StochasticJacobi)
    }

    /// The first of the given options that needs a matrix.
    pub fn needs_matrix(&self) -> Option<&'static str> {
        [
            (!matches!(self.solver, SolverName::Auto | SolverName::StochasticJacobi), "--solver"),
            (matches!(self.estimator, EstimatorName::OneWay), "--estimator"),
            (self.tolerance.is_some(), "--tolerance"),
            (self.checkpoint.is_given(), "--checkpoint"),
        ]
        .into_iter()
        .find_map(|(given, name)| given.then_some(name))
    }

    /// The options that would reduce the errors further.
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

    /// Refuses options that the ranks of an MPI job do not share out.
    fn check_ranks(&self) -> Result<()> {
        let alone = [
            (matches!(self.estimator, EstimatorName::OneWay), "--estimator one-way"),
            (!matches!(self.solver, SolverName::Auto | SolverName::Cg | SolverName::Jacobi), "this --solver"),
            (self.error.is_some(), "--error"),
            (self.time.is_some(), "--time"),
            (self.page.page.is_some(), "--page"),
            (self.checkpoint.cast_only, "--cast-only"),
        ];
        match alone.into_iter().find_map(|(given, name)| given.then_some(name)) {
            Some(option) if Ranks::world().count() > 1 => Err(Error::Usage {
                message: format!("{option} does not share out its work among MPI ranks"),
                hint: Some(format!("leave {option} out, or run without mpirun")),
            }),
            _ => Ok(()),
        }
    }

    /// Refuses combinations of options that would fail only after the work.
    fn check(&self) -> Result<()> {
        self.checkpoint.check()?;
        self.check_ranks()?;
        let written = [
            (self.output.is_some(), "-o"),
            (self.picture.is_some(), "--picture"),
            (self.page.page.is_some(), "--page"),
            (self.report.is_some(), "--report"),
            (self.error.is_some(), "--error"),
            (self.time.is_some(), "--time"),
        ];
        if let Some((_, option)) = written.iter().find(|(given, _)| *given && self.checkpoint.cast_only) {
            return Err(Error::Usage {
                message: format!("{option} needs a solution, and --cast-only computes none"),
                hint: Some(format!("leave {option} out here, and give it to the run that solves")),
            });
        }
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
                    "{option} has no effect with --solver {}, which stores no form factors",
                    stochastic_jacobi::NAME
                ),
                hint: Some(format!("leave {option} out, or use another solver")),
            }),
        }
    }
}

/// The solution, and everything that belongs to it.
struct Computed {
    scene: Scene,
    tracer: Tracer,
    /// The camera of the picture, if there is one.
    camera: Option<Camera>,
    answer: Answer,
    rounds: Vec<Round>,
    chosen: String,
    error: ErrorReport,
}

impl Computed {
    fn view(&self, progress: &Progress) -> Result<Option<Film>> {
        let light = (self.answer.patches(), self.answer.light());
        let scene = (&self.scene, &self.tracer);
        self.camera.as_ref().map(|camera| view(camera, scene, light, progress)).transpose()
    }
}

/// Runs the command.
pub fn run(args: &SolveArgs) -> Result<Outcome> {
    args.check()?;
    let files = args.checkpoint.files(&args.scene.path)?;
    let result = solve(args, files.as_ref());
    if let (Err(Error::Stopped), Some(files)) = (&result, &files) {
        files.say_stopped();
    }
    result
}

fn solve(args: &SolveArgs, checkpoint: Option<&Files>) -> Result<Outcome> {
    let start = Instant::now();
    // The first rank writes.
    let first = Ranks::world().is_first();
    let mesh = args.output.as_ref().filter(|_| first);
    let mesh = mesh.map(|path| outputs::mesh(path, &args.scene.path)).transpose()?;
    let picture = args.picture.as_ref().filter(|_| first);
    let picture = picture.map(|path| outputs::picture(path, &args.scene.path)).transpose()?;
    let page = args.page.page.as_ref().map(|path| page::file(path, &args.scene.path)).transpose()?;
    let report_file = args.report.as_ref().filter(|_| first);
    let report_file = report_file.map(|path| outputs::report(path, &args.scene.path)).transpose()?;
    let picture_file = picture.as_ref().map(|(file, _)| file);
    let files: Vec<_> =
        [mesh.as_ref(), picture_file, page.as_ref(), report_file.as_ref(), checkpoint.map(|c| &c.written)]
            .into_iter()
            .flatten()
            .collect();
    outputs::check_distinct(&files)?;
    let read = checkpoint.map_or(&[][..], |checkpoint| &checkpoint.paths[1..]);
    files.iter().try_for_each(|file| file.check_inputs(read))?;
    args.common.start_threads()?;
    if let Some(checkpoint) = checkpoint.filter(|_| args.checkpoint.cast_only) {
        return checkpoint::cast_only(args, checkpoint, &files);
    }

    let watch = Watch::new(args.common.quiet);
    let mut times = Seconds::default();
    let computed = compute(args, (&files, checkpoint), &watch, start, &mut times)?;
    let (patches, light) = (computed.answer.patches(), computed.answer.light());
    let exposure = exposure::of_radiosity(patches, light.radiosity).brighter(args.exposure);
    let (film, drawing) = watch.stage("picture", || computed.view(watch.progress()))?;
    watch.begin_writing();
    let mut pending = Vec::new();
    let written;
    (written, times.output) = watch.stage("writing", || {
        let picture = picture.zip(film).map(|((file, format), film)| {
            // Radiance is radiosity over π, so this is the same white as in the mesh.
            let exposure = Exposure::of_white(exposure.white() / PI);
            file.write(|out| film.encode(out, format, exposure))
        });
        let mesh = mesh.map(|file| write_mesh(args, file, &computed, exposure));
        let page = page.map(|file| args.page.write(file, &page_of(args, &computed, exposure), &watch));
        picture.into_iter().chain(mesh).chain(page).collect::<Result<Vec<_>>>()
    })?;
    pending.extend(written);
    times.output += drawing;

    let mut report = report_of(args, &computed, exposure);
    times.total = seconds(start.elapsed());
    report.seconds = times;
    report.peak_bytes = peak_bytes();
    report.ranks = RanksReport::of(Ranks::world(), report.peak_bytes);
    pending.extend(report_file.map(|file| file.write(|out| report.write(out))).transpose()?);

    watch.progress().check()?;
    // The contents of all files are on the disk. The rest only renames them.
    Pending::commit_all(pending)?;
    drop(watch);
    if !args.common.quiet {
        let names = outputs::names(&[&args.output, &args.picture, &args.page.page, &args.report]);
        to_stdout(&summary::table(&report, patches, &computed.chosen, args.advice(), args.exposure, &names))?;
    }
    Ok(verdict(args, &report, &computed))
}

fn compute(
    args: &SolveArgs,
    (outputs, files): (&[&OutputFile], Option<&Files>),
    watch: &Watch,
    start: Instant,
    times: &mut Seconds,
) -> Result<Computed> {
    let (scene, tracer) = pipeline::load(&args.scene, outputs, watch, times)?;
    let first = Ranks::world().is_first();
    let camera =
        args.picture.as_ref().filter(|_| first).map(|_| camera(&scene, &tracer, watch)).transpose()?;
    let checkpoint = files.map(|files| files.open(&scene, args, watch)).transpose()?;
    // With --error or --time, the program chooses the number of patches.
    if args.cast.given_patches().is_some() || (args.error.is_none() && args.time.is_none()) {
        args.cast.too_few(&scene).iter().for_each(|warning| watch.warn(warning));
    }
    let with_backs = forecast::with_backs(&scene, &tracer, args.seed);
    let sampling = Sampling {
        args,
        scene: &scene,
        tracer: &tracer,
        camera: camera.as_ref(),
        watch,
        checkpoint: checkpoint.clone(),
        with_backs,
    };
    let Sampled { answer, rounds, chosen, floor } = sampling.run(start, times)?;
    if let (Some(files), Some(checkpoint), false) = (files, &checkpoint, args.common.quiet) {
        files.say_added(checkpoint, watch);
    }
    let known = answer.errors();
    let light = (answer.light().irradiance, answer.standard_error());
    let regions = regions::errors(&scene, answer.patches(), light.0, light.1);
    let discretisation = match known {
        Some(errors) => errors.discretisation.as_ref().map(|d| d.relative),
        None => floor,
    };
    let sampling = rounds.last().map(|round| round.error);
    let error = ErrorReport {
        largest_region: regions.first().map(Into::into),
        target: args.error.map(|percent| percent / 100.0),
        rms_relative: sampling,
        bias_relative: known.and_then(|errors| errors.bias),
        discretisation_relative: discretisation,
        total_relative: sampling.zip(discretisation).map(|(sampling, patches)| sampling.hypot(patches)),
        solver_relative: known.and_then(|errors| errors.solver),
        ..ErrorReport::default()
    };
    Ok(Computed { scene, tracer, camera, answer, rounds, chosen, error })
}

/// The camera that frames the scene. A camera that sees nothing is refused before the work.
fn camera(scene: &Scene, tracer: &Tracer, watch: &Watch) -> Result<Camera> {
    let camera = Camera::frame(scene, tracer, PICTURE_WIDTH, PICTURE_HEIGHT)?;
    let hint = "leave --picture out, and give `render` an --eye and --look-at";
    if let Some(warning) = camera.check(tracer).map_err(|error| error.with_hint(hint))? {
        watch.warn(&warning);
    }
    Ok(camera)
}

/// A picture of a solution.
pub fn view(
    camera: &Camera,
    (scene, tracer): (&Scene, &Tracer),
    light: (&Patches, Light),
    progress: &Progress,
) -> Result<Film> {
    let options = RenderOptions::default().with_samples(PICTURE_SAMPLES);
    picture::smooth(scene, tracer, light, camera, &options, progress)
}

/// The errors that are computed once all rays are cast.
pub struct Errors {
    pub energy: EnergyLedger,
    /// Relative to the mean irradiance, as is the bound on the error of the solver.
    bias: Option<f64>,
    solver: Option<f64>,
    discretisation: Option<Discretisation>,
}

impl Errors {
    /// The estimated discretisation error of each patch, if it is known.
    pub fn of_patches(&self) -> Option<&[f64]> {
        self.discretisation.as_ref().map(|found| &found.error[..])
    }

    pub fn of(
        options: &SolveOptions,
        tracer: &Tracer,
        solved: &Solved,
        discretisation: Option<Discretisation>,
        progress: &Progress,
    ) -> Result<Errors> {
        let Solved { patches, form_factors, solution, .. } = solved;
        let unit = vec![1.0; solution.irradiance.len()];
        // One W/m2 relative to the mean irradiance. Zero if nothing is lit.
        let seen = patches.seen_areas(&solution.irradiance);
        let unit = relative_rms(&unit, &solution.irradiance, &seen);
        Ok(Errors {
            energy: EnergyLedger::of(form_factors, patches, solution),
            discretisation,
            bias: bias::relative(form_factors, tracer, patches, solution, options, progress)?,
            solver: Some(solution.error_bound * unit).filter(|x| x.is_finite() && unit > 0.0),
        })
    }
}

/// All figures except times and memory.
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
            let Solved { patches, form_factors, solution, error_bars } = &**solved;
            options.estimator =
                if form_factors.estimator() == Estimator::Pooled { "pooled" } else { "one-way" };
            options.tolerance = Some(args.solve_options().tolerance);
            let light = (solution, error_bars);
            SolveReport::new(&file, scene, patches, form_factors, light, &errors.energy, options)
        }
        Answer::Sweeps(patches, solution) => SolveReport::of_sweeps(&file, scene, patches, solution, options),
    };
    report.error = computed.error.clone();
    report.rounds = rounds.iter().map(round_report).collect();
    report
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
    let options = PlyOptions::default()
        .with_standard_errors(Some(answer.standard_error()))
        .with_discretisation(answer.errors().and_then(Errors::of_patches))
        .with_backs(args.backs)
        .with_exposure(Some(exposure));
    file.write(|out| ply::encode(out, scene, answer.patches(), answer.light(), &options))
}

fn page_of<'a>(args: &'a SolveArgs, computed: &'a Computed, exposure: Exposure) -> page::Solution<'a> {
    let Computed { scene, tracer, answer, .. } = computed;
    page::Solution { args: &args.scene, scene, tracer, answer, exposure, options: args.solve_options() }
}

/// Checks that form factors lie between 0 and 1 and that the energy balances. One-way form factors need not balance,
/// because they are a baseline without reciprocity. Without a matrix, the imbalance must be within its standard error.
fn verdict(args: &SolveArgs, report: &SolveReport, computed: &Computed) -> Outcome {
    let rounding = computed.answer.errors().map_or(0.0, |errors| errors.energy.rounding());
    let allowed = ROUNDING + args.solve_options().tolerance + 64.0 * rounding;
    let (imbalance, strays) = (report.energy.imbalance, report.form_factors.out_of_range);
    match args.estimator {
        _ if !report.solve.converged => Outcome::CheckFailed(format!(
            "{}: the energy does not balance: {} of the power of all lights is missing, with a standard error of {}",
            report.scene.file,
            summary::small(report.energy.sampled_imbalance),
            summary::small(report.energy.sampled_imbalance_error)
        )),
        _ if strays > 0 => {
            Outcome::CheckFailed(format!("{}: {strays} form factors are outside 0 to 1", report.scene.file))
        }
        // The condition also holds for NaN.
        EstimatorName::Pooled if imbalance.abs().partial_cmp(&allowed).is_none_or(|o| o.is_gt()) => {
            Outcome::CheckFailed(format!(
                "{}: the energy does not balance: {imbalance:.3e} of the power of all lights is missing, {allowed:.1e} is allowed",
                report.scene.file
            ))
        }
        _ => target_verdict(report),
    }
}

/// Checks whether the total error, of sampling and discretisation, is at most `--error`.
fn target_verdict(report: &SolveReport) -> Outcome {
    let ErrorReport { target: Some(target), rms_relative, discretisation_relative, .. } = report.error else {
        return Outcome::Done;
    };
    let total = rms_relative.map(|sampling| sampling.hypot(discretisation_relative.unwrap_or(0.0)));
    let parts = [
        ("discretisation error", discretisation_relative),
        ("sampling error", rms_relative),
        ("total error of sampling and discretisation", total),
    ];
    let missed = parts.into_iter().find_map(|(name, error)| Some((name, error.filter(|e| !(*e <= target))?)));
    missed.map_or(Outcome::Done, |(name, error)| {
        let (error, target) = (100.0 * error, 100.0 * target);
        let file = &report.scene.file;
        Outcome::CheckFailed(format!("{file}: the {name} is {error:.2} %, above the target of {target:.2} %"))
    })
}
