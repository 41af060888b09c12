//! `radiosity daylight`: irradiance from each part of the sky, and the hours of a year.

use std::{path::PathBuf, time::Instant};

use clap::Args;
use radiosity::{
    Error, Result, Scene,
    daylight::{
        SkyParts,
        coefficients::{Daylight, DaylightOptions, Place},
        year::{Year, daylight_factors},
    },
    form_factor::Estimator,
    monte_carlo::{Probe, read_probes},
    output::{
        daylight::{DaylightReport, DaylightTable},
        file::Pending,
        page::reports,
        report::{Seconds, peak_bytes, seconds},
    },
    patch::Patches,
    scene::light::Weather,
    solve::Solver,
};

use super::{
    Common, Outcome,
    forecast::{self, Work},
    options::{CastArgs, SceneArgs},
    outputs, page, pipeline, summary, to_stdout,
    watch::Watch,
};

/// Compute daylight coefficients: the irradiance at points or patches from each part of the sky, and from them the
/// hours of a year
#[derive(Args)]
#[command(
    after_help = "Example:\n  radiosity daylight office.obj --points desks.txt -o office.npz --epw munich.epw\n\n\
    The parts of the sky are Tregenza's or Reinhart's, in the order of RADIANCE without its ground. The .npz holds \
    places, parts, coefficients, reflected, sun and daylight_factor. With --epw, it also holds hours, illuminance and \
    autonomy. docs/lights.md describes these arrays. Lamps of the scene do not count."
)]
pub struct DaylightArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// Points and their normals, one line `x y z nx ny nz` each [default: all patches]
    #[arg(long, value_name = "FILE")]
    points: Option<PathBuf>,
    /// Write the coefficients to this file
    #[arg(short, long, value_name = "OUT.npz")]
    output: PathBuf,
    /// Also compute every hour of this weather file
    #[arg(long, value_name = "WEATHER.epw")]
    epw: Option<PathBuf>,
    /// Divide each side of Tregenza's 145 parts by this number: 2 gives 577 parts, 4 gives 2305
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=8))]
    division: u32,
    /// Rays per point
    #[arg(long, value_name = "N", default_value_t = DaylightOptions::default().rays_of_points,
        value_parser = clap::value_parser!(u32).range(16..=1 << 24))]
    rays_of_points: u32,
    /// Write a page with charts of the daylight factor and of the year, whose points can be read with the cursor
    #[arg(long, value_name = "OUT.html")]
    plots: Option<PathBuf>,
    /// Write all figures as JSON
    #[arg(long, value_name = "R.json")]
    report: Option<PathBuf>,
    #[command(flatten)]
    cast: CastArgs,
    /// Seed of the random numbers. The same seed gives the same bytes
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    common: Common,
}

/// Runs the command.
pub fn run(args: &DaylightArgs) -> Result<Outcome> {
    let start = Instant::now();
    let mut inputs = vec![args.scene.path.as_path()];
    inputs.extend(args.points.as_deref());
    inputs.extend(args.epw.as_deref());
    if args.output.extension().is_none_or(|e| e != "npz") {
        return Err(Error::Usage {
            message: format!("{}: unknown kind of table", args.output.display()),
            hint: Some("end the name in .npz".into()),
        });
    }
    let file = outputs::text(&args.output, &inputs, "daylight coefficients")?;
    let report_file =
        args.report.as_ref().map(|path| outputs::text(path, &inputs, "a report")).transpose()?;
    let plots = args.plots.as_ref().map(|path| page::file(path, &args.scene.path)).transpose()?;
    let files: Vec<_> = std::iter::once(&file).chain(&report_file).chain(&plots).collect();
    outputs::check_distinct(&files)?;
    let points = args.points.as_ref().map(|path| read_probes(path)).transpose()?;
    let weather = args.epw.as_ref().map(|path| Weather::load(path)).transpose()?;
    args.common.start_threads()?;

    let watch = Watch::new(args.common.quiet);
    if let (Some(path), Some(weather)) = (&args.epw, &weather) {
        weather.warnings(path).iter().for_each(|warning| watch.warn(warning));
    }
    let mut times = Seconds::default();
    let (mut scene, load) = watch.stage("reading", || pipeline::read(&args.scene, &files, &watch))?;
    times.load = load;
    pipeline::flatten(&mut scene, &args.scene, &watch);
    let tracer;
    (tracer, times.bvh) = watch.stage("bvh", || pipeline::trace(&scene, &args.scene.path, &watch))?;
    let up = args.scene.lights.up();
    let options = DaylightOptions::default()
        .with_parts(SkyParts::new(args.division as usize))
        .with_up(up)
        .with_rays(f64::from(args.cast.rays()))
        .with_rays_of_points(args.rays_of_points)
        .with_seed(args.seed);
    check(args, &scene, &options, &watch)?;
    let (subdivision, _) = args.cast.subdivision();
    let patches;
    (patches, times.subdivide) = watch.stage("patches", || Ok(Patches::subdivide(&scene, &subdivision)))?;
    let daylight;
    (daylight, times.form_factors) = watch.stage("rays", || {
        Daylight::new(&scene, &tracer, patches, &options, watch.progress())
            .map_err(|error| pipeline::blame(&args.scene.path, error))
    })?;
    let patches = daylight.patches();
    let places: Vec<Place> = match &points {
        Some(points) => points.iter().map(|Probe { point, normal }| (*point, *normal)).collect(),
        None => {
            let place = |i: usize| (patches.centroid(&scene, i), patches.normal(&scene, i));
            (0..patches.fronts()).map(place).collect()
        }
    };
    let coefficients;
    (coefficients, times.solve) = watch.stage("points", || match points {
        Some(_) => daylight.of_points(&places, watch.progress()),
        None => Ok(daylight.of_patches()),
    })?;
    let factors = daylight_factors(&coefficients, up);
    let exact = points.as_ref().map(|_| &places[..]);
    let year = match &weather {
        Some(weather) => {
            let of_year = || Year::of(&daylight, &coefficients, exact, weather, up, watch.progress());
            let (year, time) = watch.stage("year", of_year)?;
            times.solve += time;
            Some(year)
        }
        None => None,
    };

    watch.begin_writing();
    let table = DaylightTable {
        places: &places,
        coefficients: &coefficients,
        factors: &factors,
        year: year.as_ref(),
    };
    let mut pending = vec![file.write(|out| table.write(out))?];
    if let Some(plots) = plots {
        let name = args.scene.path.display().to_string();
        let charts = reports::daylight(&name, &places, &factors, year.as_ref());
        pending.push(plots.write(|out| charts.write(out))?);
    }
    times.total = seconds(start.elapsed());
    let report = DaylightReport {
        version: env!("CARGO_PKG_VERSION"),
        scene: args.scene.path.display().to_string(),
        patches: patches.len(),
        places: places.len(),
        parts: options.parts.count(),
        mean_daylight_factor: factors.iter().sum::<f64>() / factors.len().max(1) as f64,
        hours: year.as_ref().map(|year| year.labels.len()),
        missing_hours: year.as_ref().map(|year| year.is_missing.iter().filter(|missing| **missing).count()),
        spatial_daylight_autonomy: year.as_ref().map(|year| year.spatial_autonomy),
        mean_illuminance: year.as_ref().map(Year::mean),
        seed: args.seed,
        seconds: times,
        peak_bytes: peak_bytes(),
    };
    pending.extend(report_file.map(|file| file.write(|out| report.write(out))).transpose()?);
    watch.progress().check()?;
    Pending::commit_all(pending)?;
    drop(watch);
    if !args.common.quiet {
        to_stdout(&summary_of(
            &report,
            &outputs::names(&[&Some(args.output.clone()), &args.report, &args.plots]),
        ))?;
    }
    Ok(Outcome::Done)
}

/// Refuses a computation that needs too much memory, and warns if it needs much.
fn check(args: &DaylightArgs, scene: &Scene, options: &DaylightOptions, watch: &Watch) -> Result<()> {
    let matrix = forecast::bytes(scene, Estimator::Pooled, Solver::Auto);
    // Two numbers of single precision for each part.
    let bytes =
        |patches: f64, rays: f64| matrix(patches, rays) + 8.0 * options.parts.count() as f64 * patches;
    let (subdivision, _) = args.cast.subdivision();
    let work = Work {
        scene,
        patches: Patches::forecast(scene, &subdivision),
        rays: options.rays,
        bytes: &bytes,
        options: forecast::USUAL,
    };
    let warnings = [args.common.limit().check(&work)?, args.cast.too_few(scene)];
    warnings.iter().flatten().for_each(|warning| watch.warn(warning));
    Ok(())
}

fn summary_of(report: &DaylightReport, written: &str) -> String {
    let mut text = String::new();
    let mut row = |name: &str, value: String| summary::row(&mut text, name, &value);
    row("scene", format!("{}: {} patches", report.scene, report.patches));
    row("places", format!("{}, {} parts of the sky", report.places, report.parts));
    row("daylight factor", format!("{:.2} % in the mean", 100.0 * report.mean_daylight_factor));
    if let (Some(hours), Some(autonomy), Some(mean)) =
        (report.hours, report.spatial_daylight_autonomy, report.mean_illuminance)
    {
        let without = match report.missing_hours {
            Some(missing @ 1..) => format!(", {missing} of them without irradiance and not counted"),
            _ => String::new(),
        };
        row("year", format!("{hours} hours{without}; {mean:.0} lx in the mean"));
        row(
            "autonomy",
            format!("{:.1} % of the places have 300 lx in half of the hours from 8 to 18", 100.0 * autonomy),
        );
    }
    let s = &report.seconds;
    row(
        "seconds",
        format!(
            "load {:.2}, coefficients {:.2}, points and hours {:.2}; total {:.2}",
            s.load, s.form_factors, s.solve, s.total
        ),
    );
    row("wrote", written.into());
    text
}
