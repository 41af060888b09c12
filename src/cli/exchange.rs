//! `radiosity exchange`: radiative heat exchange between surfaces.

use std::{path::PathBuf, time::Instant};

use clap::Args;
use glam::DVec3;
use radiosity::{
    Error, Result,
    heat::{Conditions, Exchange, exchange},
    output::{
        exchange::{ExchangeReport, SurfaceHeat, write_exchange_areas},
        file::Pending,
        report::seconds,
    },
    scene::surfaces::{By, Surface},
};

use super::{
    Common, Outcome, outputs, summary,
    surfaces::{Known, SurfaceArgs, Warnings, find, read},
    to_stdout,
    watch::Watch,
};

/// Compute the heat that surfaces exchange by radiation
#[derive(Args)]
#[command(after_help = "Example:\n  radiosity exchange room.obj --surfaces room.toml --report r.json\n\n\
    The file has a line for each surface. A surface is a group of the scene, or as --by sets it. Lengths are metres.\n  \
    wall = { temperature = 293, emissivity = 0.9 }  # kelvin\n  \
    heater = { flux = 200, emissivity = 0.8 }       # net flux, W/m2\n  \
    shield = { emissivity = 0.1 }                   # floats: net heat 0\n  \
    sky = { temperature = 260 }                     # outside all surfaces\n\n\
    Surfaces are grey and diffuse. Radiosity is uniform on each face, and temperature is uniform on each surface. Heat is \
    in W, and positive if it leaves the surface. Its standard error follows from the standard errors of the view factors. \
    --exchange-areas writes A_i times Hottel's script-F_ij: the power that surface i absorbs per sigma T^4 of surface j.")]
pub struct ExchangeArgs {
    #[command(flatten)]
    surfaces: SurfaceArgs,
    /// Temperature, flux and emissivity of the surfaces
    #[arg(long = "surfaces", value_name = "FILE.toml")]
    conditions: PathBuf,
    /// Write all figures as JSON
    #[arg(long, value_name = "R.json")]
    report: Option<PathBuf>,
    /// Write the exchange areas between surfaces in m2, including reflections, as CSV
    #[arg(long, value_name = "OUT.csv")]
    exchange_areas: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

/// Largest relative imbalance of heat that passes the check.
const BALANCED: f64 = 1e-9;

/// Runs the command.
pub fn run(args: &ExchangeArgs) -> Result<Outcome> {
    let start = Instant::now();
    let inputs = [args.surfaces.scene.as_path(), args.conditions.as_path()];
    let text = |path: &PathBuf, what| outputs::text(path, &inputs, what);
    let report_file = args.report.as_ref().map(|path| text(path, "a report")).transpose()?;
    let areas_file = args.exchange_areas.as_ref().map(|path| text(path, "a table")).transpose()?;
    let files: Vec<_> = [&report_file, &areas_file].into_iter().flatten().collect();
    outputs::check_distinct(&files)?;
    args.common.start_threads()?;

    let watch = Watch::new(args.common.quiet);
    let mut warnings = Warnings::new(&watch);
    let by = args.surfaces.by.as_ref().unwrap_or(&By::Group);
    let ((_, surfaces), _) = watch.stage("reading", || read(&args.surfaces, by, &files, &mut warnings))?;
    let names: Vec<String> = surfaces.list.iter().map(|surface| surface.name.clone()).collect();
    let conditions = Conditions::load(&args.conditions, &names)?;
    let (parts, surface_of) = surfaces.parts();
    let Known { found, enclosed, .. } =
        find(&args.surfaces, args.common.limit(), DVec3::Y, &parts, &mut warnings)?;
    if let Some(i) = (0..found.len()).find(|&i| found.areas()[i] <= 0.0) {
        let Surface { name, line, .. } = &parts.list[i];
        let message = format!("a face of `{name}` is entirely hidden by other faces in its plane");
        return Err(Error::input(&args.surfaces.scene, *line, message).with_hint("take it out of the scene"));
    }
    let sky = match conditions.sky {
        Some(sky) => sky,
        None if enclosed => 0.0,
        None => {
            warnings.warn(format!(
                "{}: surfaces see the outside, but the file has no line for the sky: 0 K is used; add a line like  sky = \
                 {{ temperature = 260 }}",
                args.conditions.display()
            ));
            0.0
        }
    };
    let (exchanged, _) = watch.stage("heat", || {
        exchange(&found, &surface_of, &conditions.surfaces, sky, args.surfaces.seed, watch.progress())
    })?;
    let mut areas = vec![0.0; names.len()];
    surface_of.iter().zip(found.areas()).for_each(|(&k, area)| areas[k] += area);
    let (list, outside) = SurfaceHeat::of(&names, &areas, sky, &exchanged);

    watch.begin_writing();
    let mut pending = Vec::new();
    let write = |file: radiosity::output::file::OutputFile| {
        file.write(|out| write_exchange_areas(&names, &exchanged, out))
    };
    pending.extend(areas_file.map(write).transpose()?);
    let report = ExchangeReport {
        version: env!("CARGO_PKG_VERSION"),
        scene: args.surfaces.scene.display().to_string(),
        parts: parts.list.len(),
        enclosed,
        surfaces: list,
        sky: outside,
        imbalance: exchanged.imbalance,
        view_factor_error: found.error,
        warnings: warnings.warnings,
        seconds: seconds(start.elapsed()),
    };
    pending.extend(report_file.map(|file| file.write(|out| report.write(out))).transpose()?);
    watch.progress().check()?;
    Pending::commit_all(pending)?;
    drop(watch);
    if !args.common.quiet {
        to_stdout(&table(&report, &exchanged, &outputs::names(&[&args.report, &args.exchange_areas])))?;
    }
    Ok(if exchanged.imbalance.abs() <= BALANCED {
        Outcome::Done
    } else {
        Outcome::CheckFailed(format!(
            "the heat does not balance: the relative imbalance is {:.1e}",
            exchanged.imbalance
        ))
    })
}

fn table(report: &ExchangeReport, exchanged: &Exchange, written: &str) -> String {
    const MOST: usize = 24;
    let mut text = String::new();
    let mut row = |name: &str, value: String| summary::row(&mut text, name, &value);
    row("scene", format!("{}: {}", report.scene, summary::count(report.parts, "face")));
    let enclosed = if report.enclosed { "yes" } else { "no" };
    row("enclosed", enclosed.into());
    let heat = |surface: &SurfaceHeat| {
        format!("{:.6} W ± {:.1e}, {:.3} K", surface.heat, surface.heat_standard_error, surface.temperature)
    };
    report.surfaces.iter().take(MOST).for_each(|surface| row(&surface.name, heat(surface)));
    if report.surfaces.len() > MOST {
        row("and", format!("{} more surfaces", report.surfaces.len() - MOST));
    }
    if !report.enclosed {
        row("sky", heat(&report.sky));
    }
    row("balance", format!("off by {} of all heat", summary::small(Some(exchanged.imbalance.abs()))));
    row("wrote", written.into());
    text
}
