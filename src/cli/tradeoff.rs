//! `radiosity tradeoff`: speed against accuracy on a scene.

use std::{
    fmt::Write,
    path::{Path, PathBuf},
};

use clap::Args;
use radiosity::{
    Result,
    accuracy::tradeoff::{Extent, Series, Tradeoff, TradeoffOptions},
    form_factor::Estimator,
    output::{
        file::{OutputFile, Pending},
        page::reports,
        report::Seconds,
        tradeoff_plot,
        tradeoff_report::TradeoffReport,
    },
    patch::{Patches, Subdivision},
    solve::Solver,
};

use super::{
    Common, Outcome,
    forecast::{self, Work},
    options::SceneArgs,
    outputs::{self, Directory},
    pipeline, to_stdout,
    watch::Watch,
};

/// Measure the error over time for rays, patch sizes, tolerances, solvers, estimators and path tracing
#[derive(Args)]
#[command(after_help = "Example:\n  radiosity tradeoff room.obj -o tradeoff\n\n\
    Writes tradeoff.json, tradeoff.csv, tradeoff.svg and tradeoff.html into the directory. The .html is a page whose \
    points can be read with the cursor. Every solution is compared with two reference solutions with finer patches and \
    more rays. Errors below the error of the references are marked. The command takes about ten seconds, in proportion \
    to --most-rays. It never replaces a file that no earlier tradeoff wrote.")]
pub struct TradeoffArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// Write into this directory, which is created if it is missing
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Write the JSON to this file too
    #[arg(long, value_name = "R.json")]
    report: Option<PathBuf>,
    /// Approximate number of patches of the coarsest solution. Errors refer to the mean irradiance of these patches
    #[arg(long, value_name = "N", default_value_t = TradeoffOptions::default().patches as u32,
        value_parser = clap::value_parser!(u32).range(1..))]
    patches: u32,
    /// Number of rays of the largest solution, over all patches
    #[arg(long, value_name = "N", default_value_t = TradeoffOptions::default().rays as u64,
        value_parser = clap::value_parser!(u64).range(1..=1 << 40))]
    most_rays: u64,
    /// Seed of the random numbers. The same seed gives the same errors
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    common: Common,
}

const JSON: &str = "tradeoff.json";
const CSV: &str = "tradeoff.csv";
const SVG: &str = "tradeoff.svg";
const HTML: &str = "tradeoff.html";

/// Runs the command.
pub fn run(args: &TradeoffArgs) -> Result<Outcome> {
    args.common.start_threads()?;
    // The watch comes before the directory, because a signal would otherwise leave the directory behind.
    let watch = Watch::new(args.common.quiet);
    let directory = Directory::new(&args.output, "tradeoff")?;
    let file = |name: &str| directory.file(name, &[&args.scene.path]);
    let (csv, json, svg, html) = (file(CSV)?, file(JSON)?, file(SVG)?, file(HTML)?);
    // The report in the output directory is written anyway.
    let elsewhere = args.report.as_ref().filter(|path| **path != args.output.join(JSON));
    let report_file = elsewhere.map(|path| outputs::report(path, &args.scene.path)).transpose()?;
    let all: Vec<&OutputFile> = [&csv, &json, &svg, &html].into_iter().chain(&report_file).collect();
    outputs::check_distinct(&all)?;
    let (scene, tracer) = pipeline::load(&args.scene, &all, &watch, &mut Seconds::default())?;
    let options = TradeoffOptions::default()
        .with_patches(args.patches as usize)
        .with_rays(args.most_rays as f64)
        .with_seed(args.seed);
    // Work that is too large is refused before the patches are made.
    let bytes = forecast::bytes(&scene, Estimator::Pooled, Solver::Auto);
    let work = |patches: f64, rays: f64| Work {
        scene: &scene,
        patches,
        rays,
        bytes: &bytes,
        options: ["--patches", "--most-rays"],
    };
    let limit = args.common.limit();
    limit.check(&work(Patches::forecast(&scene, &Subdivision::Count(options.patches)), 0.0))?;
    let extent = Extent::of(&scene, &options);
    // The references have more patches than --patches.
    let fewer = "use fewer --patches or --most-rays, or allow more --memory";
    let checked = limit.check(&work(extent.reference_patches, extent.reference_rays));
    if let Some(warning) = checked.map_err(|error| error.with_hint(fewer))? {
        watch.warn(&warning);
    }
    let (tradeoff, _) = watch.stage("sweeping", || {
        Tradeoff::of(&scene, &tracer, &options, watch.progress())
            .map_err(|error| pipeline::blame(&args.scene.path, error))
    })?;
    let file = args.scene.path.display().to_string();
    let threads = rayon::current_num_threads();
    let report = TradeoffReport::new(&file, &scene, options.seed, threads, &tradeoff);
    let plot = tradeoff_plot::svg(&file, &tradeoff);
    watch.begin_writing();
    let marker = directory.marker([CSV, JSON, SVG, HTML].into_iter())?;
    let mut pending = vec![marker, csv.write(|out| report.write_csv(out))?];
    for json in std::iter::once(json).chain(report_file) {
        pending.push(json.write(|out| report.write_json(out))?);
    }
    pending.push(svg.write(|out| out.write_all(plot.as_bytes()))?);
    pending.push(html.write(|out| reports::tradeoff(&file, &tradeoff).write(out))?);
    watch.progress().check()?;
    Pending::commit_all(pending)?;
    drop(watch);
    if !args.common.quiet {
        to_stdout(&table(&tradeoff, &args.output, args.report.as_deref()))?;
    }
    Ok(Outcome::Done)
}

fn table(tradeoff: &Tradeoff, directory: &Path, report: Option<&Path>) -> String {
    let mut text = String::new();
    let reference = &tradeoff.reference;
    let _ = writeln!(
        text,
        "errors: RMS of the irradiance of {} patches, relative to its mean\n\
         reference: {} patches with {:.0} rays each, twice; its own error is {:.2} %, and smaller errors are in brackets\n\n\
         {:<36} {:>8} {:>7} {:>9} {:>10} {:>9} {:>9}",
        tradeoff.common_patches,
        reference.patches,
        reference.rays,
        100.0 * reference.error(),
        "",
        "patches",
        "rays",
        "error",
        "estimated",
        "seconds",
        "MiB"
    );
    for p in &tradeoff.points {
        let name = match (p.series, p.solver) {
            (Series::Rays(_), _) => "rays".into(),
            (Series::Preset(name), _) => format!("preset {name}"),
            (Series::Estimator(name), _) => name.into(),
            (Series::PathTracing, _) => "path tracing (paths per patch)".into(),
            (Series::Solver, solver) => {
                format!("{} to {:.0e}", solver.map_or("", |s| s.name()), p.tolerance)
            }
        };
        let error = format!("{:.2} %", 100.0 * p.error);
        let _ = writeln!(
            text,
            "{name:<36} {:>8} {:>7.0} {:>9} {:>8.2} % {:>9.4} {:>9.1}",
            p.patches,
            p.rays,
            if p.believed { error } else { format!("({error})") },
            100.0 * p.estimated(),
            p.seconds.total(),
            p.bytes as f64 / f64::from(1 << 20)
        );
    }
    for sentence in &tradeoff.left_out {
        let _ = writeln!(text, "left out: {sentence}");
    }
    let also = report.map_or(String::new(), |path| format!("; {}", path.display()));
    let _ = writeln!(text, "\nwritten to {}: {JSON}, {CSV}, {SVG}, {HTML}{also}", directory.display());
    text
}
