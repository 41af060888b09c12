//! `radiosity tradeoff`: speed against accuracy on a scene.

use std::{
    fmt::Write,
    fs,
    path::{Path, PathBuf},
};

use clap::Args;
use radiosity::{
    Error, Result,
    accuracy::tradeoff::{Extent, Series, Tradeoff, TradeoffOptions},
    form_factor::Estimator,
    output::{file::OutputFile, report::Seconds, tradeoff_plot, tradeoff_report::TradeoffReport},
    patch::{Patches, Subdivision},
    solve::Solver,
};

use super::{
    Common, Outcome,
    forecast::{self, Work},
    options::SceneArgs,
    pipeline, to_stdout,
    watch::Watch,
};

/// Measure speed against accuracy: rays, patch size, tolerance, solver, estimator, and path tracing beside them
#[derive(Args)]
#[command(after_help = "Example:\n  radiosity tradeoff room.obj -o tradeoff\n\n\
    Writes tradeoff.json, tradeoff.csv and tradeoff.svg into the directory. Every point is compared with two reference\n\
    solutions of finer patches and more rays; errors below what is known of these are marked. Takes some ten seconds and\n\
    grows in proportion to --most-rays.")]
pub struct TradeoffArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// Write into this directory, which is made where there is none
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// About how many patches the coarsest solutions have; errors are of the mean irradiance of these
    #[arg(long, value_name = "N", default_value_t = TradeoffOptions::default().patches as u32,
        value_parser = clap::value_parser!(u32).range(1..))]
    patches: u32,
    /// Rays of the largest point, all patches together
    #[arg(long, value_name = "N", default_value_t = TradeoffOptions::default().rays as u64,
        value_parser = clap::value_parser!(u64).range(1..=1 << 40))]
    most_rays: u64,
    /// Another seed casts other rays; the same gives the same errors
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    common: Common,
}

const NAMES: [&str; 3] = ["tradeoff.json", "tradeoff.csv", "tradeoff.svg"];

/// Runs the command.
pub fn run(args: &TradeoffArgs) -> Result<Outcome> {
    let directory = Directory::new(&args.output, &args.scene.path)?;
    args.common.start_threads()?;
    let watch = Watch::new(args.common.quiet);
    let (scene, tracer) = pipeline::load(&args.scene, &directory.outputs(), &watch, &mut Seconds::default())?;
    let options =
        TradeoffOptions { patches: args.patches as usize, rays: args.most_rays as f64, seed: args.seed };
    // What could not be cut is told before it is.
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
    // References have more patches than were asked for.
    let fewer = "choose fewer --patches or fewer --most-rays, or allow more --memory";
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
    directory.write(|name, out| match name {
        "tradeoff.json" => report.write_json(out),
        "tradeoff.csv" => report.write_csv(out),
        _ => out.write_all(plot.as_bytes()),
    })?;
    drop(watch);
    if !args.common.quiet {
        to_stdout(&table(&tradeoff, &args.output))?;
    }
    Ok(Outcome::Done)
}

/// Where the files go: checked before the work, made after it.
struct Directory<'a> {
    path: &'a Path,
    /// The files; where there is no directory yet, a file that takes its place and only shows that it could be made.
    files: Vec<OutputFile>,
    is_there: bool,
}

impl<'a> Directory<'a> {
    fn new(path: &'a Path, scene: &Path) -> Result<Self> {
        let is_there = path.exists();
        if is_there && !path.is_dir() {
            return Err(Error::Usage {
                message: format!("{}: not a directory", path.display()),
                hint: Some("give -o the name of a directory; it is made where there is none".into()),
            });
        }
        let files = match is_there {
            true => Self::files(path, &[scene])?,
            false => vec![OutputFile::new(path, &[scene])?],
        };
        Ok(Directory { path, files, is_there })
    }

    fn files(path: &Path, inputs: &[&Path]) -> Result<Vec<OutputFile>> {
        NAMES.iter().map(|name| OutputFile::new(&path.join(name), inputs)).collect()
    }

    fn outputs(&self) -> Vec<&OutputFile> {
        self.files.iter().collect()
    }

    /// Writes all files, or none.
    fn write(self, contents: impl Fn(&str, &mut dyn std::io::Write) -> std::io::Result<()>) -> Result<()> {
        let Directory { path, mut files, is_there } = self;
        if !is_there {
            fs::create_dir(path).map_err(|e| Error::io(path, e))?;
        }
        let mut write = || -> Result<()> {
            if !is_there {
                files = Self::files(path, &[])?;
            }
            let pending: Vec<_> = files
                .drain(..)
                .zip(NAMES)
                .map(|(file, name)| file.write(|out| contents(name, out)))
                .collect::<Result<_>>()?;
            pending.into_iter().try_for_each(|file| file.commit())
        };
        let written = write();
        if written.is_err() && !is_there {
            // It stays where a file could be put into it: then there is something to look at.
            let _ = fs::remove_dir(path);
        }
        written
    }
}

fn table(tradeoff: &Tradeoff, directory: &Path) -> String {
    let mut text = String::new();
    let reference = &tradeoff.reference;
    let _ = writeln!(
        text,
        "errors: RMS of the irradiance of {} patches, relative to its mean\n\
         reference: {} patches, {:.0} rays each, twice; its own error {:.2} %; errors below are in brackets\n\n\
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
            (Series::PathTracing, _) => "path tracing (paths a patch)".into(),
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
    let _ = writeln!(text, "\nwritten to {}: {}", directory.display(), NAMES.join(", "));
    text
}
