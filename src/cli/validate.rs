//! `radiosity validate`: checks of the solution by independent methods.

use std::{fmt::Write, path::PathBuf};

use clap::Args;
use radiosity::{
    Result, Scene,
    accuracy::{
        lambert::{LambertCost, LambertOptions},
        solved::Solved,
        validation::{Validation, ValidationOptions},
    },
    form_factor::Estimator,
    output::{
        file::{OutputFile, Pending},
        lambert_report::LambertReport,
        page::{Method, PageOptions, encode, reports},
        ply::{self, PlyOptions},
        report::Seconds,
        validation_report::{ComparisonReport, ValidationReport},
    },
    patch::Patches,
    solve::{Light, Solver},
    trace::Tracer,
};

use super::{
    Common, Outcome,
    forecast::{self, Work},
    options::{CastArgs, SceneArgs},
    outputs, page, pipeline, summary, to_stdout,
    watch::Watch,
};

/// Check the solution: energy ledger, closure, reciprocity, and radiosity against path tracing and light tracing
#[derive(Args)]
#[command(after_help = "Example:\n  radiosity validate room.obj --report validation.json\n\n\
    Solves the scene with two patch sizes, traces paths and particles, and compares the irradiance of every patch in \
    units of the combined standard errors. The exit status is 1 if a check fails.")]
pub struct ValidateArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// Write all figures as JSON
    #[arg(long, value_name = "R.json")]
    report: Option<PathBuf>,
    /// Write a page that shows the light of each method in a browser, and their differences. It is one file and needs no server
    #[arg(long, value_name = "OUT.html")]
    page: Option<PathBuf>,
    /// Write a page with charts of the comparisons, whose points can be read with the cursor
    #[arg(long, value_name = "OUT.html")]
    plots: Option<PathBuf>,
    #[command(flatten)]
    cast: CastArgs,
    /// Paths per patch
    #[arg(long, value_name = "N", default_value_t = ValidationOptions::default().paths,
        value_parser = clap::value_parser!(u32).range(16..=1 << 24))]
    paths: u32,
    /// Particles from the emitters
    #[arg(long, value_name = "N", default_value_t = ValidationOptions::default().particles,
        value_parser = clap::value_parser!(u64).range(1024..=1 << 40))]
    particles: u64,
    /// Also measure the error of the Lambertian assumption. Light is traced with the given materials and with
    /// Lambertian materials of the same albedo, with the same random numbers
    #[arg(long)]
    lambert: bool,
    /// With --lambert: write a coloured mesh with the change of irradiance of each face and its standard error
    #[arg(short, long, value_name = "OUT.ply", requires = "lambert")]
    output: Option<PathBuf>,
    /// Seed of the random numbers. The same seed gives the same verdict
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    common: Common,
}

/// Runs the command.
pub fn run(args: &ValidateArgs) -> Result<Outcome> {
    let report_file = args.report.as_ref().map(|path| outputs::report(path, &args.scene.path)).transpose()?;
    let mesh = args.output.as_ref().map(|path| outputs::mesh(path, &args.scene.path)).transpose()?;
    let page = args.page.as_ref().map(|path| page::file(path, &args.scene.path)).transpose()?;
    let plots = args.plots.as_ref().map(|path| page::file(path, &args.scene.path)).transpose()?;
    let files: Vec<_> = report_file.iter().chain(&mesh).chain(&page).chain(&plots).collect();
    outputs::check_distinct(&files)?;
    args.common.start_threads()?;
    let watch = Watch::new(args.common.quiet);
    let (given, tracer) = pipeline::load_as_given(&args.scene, &files, &watch, &mut Seconds::default())?;
    let mut scene = given.clone();
    pipeline::flatten(&mut scene, &args.scene, &watch);
    let defaults = ValidationOptions::default();
    let options = defaults
        .with_subdivision(args.cast.given_subdivision().unwrap_or(defaults.subdivision))
        .with_rays(args.cast.given_rays().map_or(defaults.rays, f64::from))
        .with_paths(args.paths)
        .with_particles(args.particles)
        .with_solve(defaults.solve.with_linear(args.cast.linear()))
        .with_seed(args.seed);
    // Validation also solves with edges half as long.
    let one = forecast::bytes(&scene, Estimator::Pooled, Solver::Auto);
    let bytes = |patches: f64, rays: f64| one(patches, rays) + one(4.0 * patches, rays);
    let work = Work {
        scene: &scene,
        patches: Patches::forecast(&scene, &options.subdivision),
        rays: options.rays,
        bytes: &bytes,
        options: forecast::USUAL,
    };
    if let Some(warning) = args.common.limit().check(&work)? {
        watch.warn(&warning);
    }
    let (validation, _) = watch.stage("validating", || {
        Validation::of(&scene, &tracer, &options, watch.progress())
            .map_err(|error| pipeline::blame(&args.scene.path, error))
    })?;
    let mut report = ValidationReport::new(&args.scene.path.display().to_string(), &scene, &validation);
    let patches = &validation.solved.patches;
    let cost = args.lambert.then(|| lambert(args, &given, &tracer, patches, &watch)).transpose()?;
    report.lambert = cost.as_ref().map(|cost| LambertReport::new(cost, &given, patches));
    watch.begin_writing();
    let mut pending = Vec::new();
    pending.extend(report_file.map(|file| file.write(|out| report.write(out))).transpose()?);
    if let (Some(file), Some(cost)) = (mesh, &cost) {
        let options = PlyOptions::default()
            .with_standard_errors(Some(&validation.solved.error_bars.standard_error))
            .with_lambert(Some(&cost.matched.irradiance));
        let solution = &validation.solved.solution;
        pending.push(file.write(|out| ply::encode(out, &scene, patches, solution, &options))?);
    }
    pending
        .extend(page.map(|file| write_page(args, file, (&scene, &tracer), &validation, &watch)).transpose()?);
    if let Some(file) = plots {
        let charts = reports::validation(&report, &validation, &scene);
        pending.push(file.write(|out| charts.write(out))?);
    }
    Pending::commit_all(pending)?;
    drop(watch);
    if !args.common.quiet {
        to_stdout(&table(&report))?;
    }
    Ok(match report.objections.len() {
        0 => Outcome::Done,
        n => Outcome::CheckFailed(format!(
            "{}: {} failed; the first: {}",
            report.scene,
            summary::count(n, "check"),
            report.objections[0]
        )),
    })
}

/// Writes the light of all three methods.
fn write_page(
    args: &ValidateArgs,
    file: OutputFile,
    (scene, tracer): (&Scene, &Tracer),
    validation: &Validation,
    watch: &Watch,
) -> Result<Pending> {
    let Solved { patches, solution, error_bars, .. } = &validation.solved;
    // Path and light tracing look at fronts only, and so does the allowance for patches.
    let whole = |values: &[f64]| {
        let mut values = values.to_vec();
        values.resize(patches.channels() * patches.len(), f64::NAN);
        values
    };
    let traced = [("path tracing", &validation.path_traced), ("light tracing", &validation.light_traced)]
        .map(|(name, found)| (name, whole(&found.irradiance), whole(&found.standard_error)));
    let mut methods =
        vec![Method::new("radiosity", solution).with_standard_error(Some(&error_bars.standard_error))];
    methods.extend(traced.iter().map(|(name, irradiance, error)| {
        let light = Light { radiosity: &[], irradiance, slopes: &[] };
        Method::new(name, light).with_standard_error(Some(error))
    }));
    let allowance = whole(&validation.radiosity.allowance);
    let title = page::title(&args.scene.path);
    let notes = vec![format!(
        "radiosity {}: the irradiance of {} patches by three methods, of fronts only by path and light tracing. Grey has no value. The \
         discretisation error is twice the change when edges are half as long.",
        env!("CARGO_PKG_VERSION"),
        patches.len()
    )];
    let options =
        PageOptions::default().with_title(&title).with_discretisation(Some(&allowance)).with_notes(notes);
    let camera = page::camera(&args.scene, scene, tracer)?;
    page::write(file, watch, |out| encode(out, scene, patches, &camera, &methods, &options))
}

fn lambert(
    args: &ValidateArgs,
    given: &Scene,
    tracer: &Tracer,
    patches: &Patches,
    watch: &Watch,
) -> Result<LambertCost> {
    pipeline::warn_of_gloss(given, &args.scene.path, watch);
    let options =
        LambertOptions::default().with_paths(args.paths).with_particles(args.particles).with_seed(args.seed);
    let (cost, _) = watch.stage("following gloss", || {
        LambertCost::of(given, tracer, patches, &options, watch.progress())
            .map_err(|error| pipeline::blame(&args.scene.path, error))
    })?;
    Ok(cost)
}

fn table(report: &ValidationReport) -> String {
    let mut text = String::new();
    let mut line = |name: &str, value: String| {
        let _ = writeln!(text, "{name:<36} {value}");
    };
    line("patches, rays", format!("{}, {}", report.patches, report.rays));
    let energy = &report.energy;
    line(
        "energy imbalance",
        format!(
            "{} (solver {}, reciprocity {})",
            summary::small(Some(energy.imbalance)),
            summary::small(energy.solver_part),
            summary::small(energy.reciprocity_part)
        ),
    );
    for (name, deviation) in
        [("row sums", report.row_sum_deviation), ("reciprocity", report.reciprocity_deviation)]
    {
        line(
            name,
            format!(
                "off by {} as cast, {} after closure",
                summary::small(deviation.before),
                summary::small(deviation.after)
            ),
        );
    }
    line("discretisation error", format!("{:.2} % RMS", 100.0 * report.discretisation_relative));
    for ComparisonReport { what, figures: c, .. } in &report.comparisons {
        line(
            what,
            format!(
                "RMS {:.2} %, mean {:+.2} % (z {:+.1}); z-scores: mean {:+.2}, spread {:.2}, {:.1} % beyond 2, {:.1} % beyond 3",
                100.0 * c.rms_relative,
                summary::rounded(100.0 * c.mean_relative, 2),
                summary::rounded(c.mean_z, 1),
                summary::rounded(c.z_mean, 2),
                c.z_spread,
                100.0 * c.beyond_2,
                100.0 * c.beyond_3
            ),
        );
    }
    if let Some(radiosity) = report.comparisons.first() {
        line("patches farthest from path tracing", String::new());
        for w in &radiosity.worst {
            let [x, y, z] = w.position;
            let _ = writeln!(
                text,
                "  z {:+5.1}  {:.4e} against {:.4e} {} at {x:.4} {y:.4} {z:.4} ({})",
                w.z, w.first, w.second, report.units.irradiance, w.material
            );
        }
    }
    if let Some(lambert) = &report.lambert {
        let _ = writeln!(text, "{:<36} {}", "Lambertian surfaces", lambert.verdict);
    }
    let verdict = if report.valid { "passed" } else { "FAILED" };
    let _ = writeln!(text, "{:<36} {verdict}", "verdict");
    for objection in &report.objections {
        let _ = writeln!(text, "  {objection}");
    }
    text
}
