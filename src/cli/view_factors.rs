//! `radiosity view-factors`: view factors between the surfaces of a scene.

use std::{
    fmt::Write,
    path::{Path, PathBuf},
    time::Instant,
};

use clap::{Args, ValueEnum};
use glam::DVec3;
use radiosity::{
    Error, Result,
    output::{
        file::Pending,
        report::{peak_bytes, seconds},
        view_factors::{
            LookReport, MatrixFormat, SurfaceReport, Table, ViewFactorErrorReport, ViewFactorOptionsReport,
            ViewFactorSeconds, ViewFactorsReport,
        },
    },
    scene::surfaces::By,
};

use super::{
    Common, Outcome, outputs, summary,
    surfaces::{Known, SurfaceArgs, Warnings, find, name, read},
    to_stdout,
    watch::Watch,
};

/// Compute the view factors between all surfaces of a scene
#[derive(Args)]
#[command(after_help = "Example:\n  radiosity view-factors room.obj -o view-factors.csv --report r.json\n\n\
    A surface is a face of the file or, with --by, all faces of a group, object or material. Its view factors are means \
    over its area. It is seen from its front, where its vertices run counter-clockwise. Both sides block.\n\n\
    If nothing is between two surfaces, their view factor is computed without rays to a relative error of 1e-5. \
    Otherwise, rays sample the hidden part. --error bounds the standard error of this sampling.\n\n\
    The CSV has a line for each surface: its name, its area, the share of its power that escapes, and the view factors \
    from it to all surfaces. The view factors and the escaped share of a line sum to 1, and A_i F_ij = A_j F_ji, both to \
    rounding. If the surfaces enclose a room, nothing escapes. Rays from every face test whether they do, unless --enclosed \
    or --open states it. Power that hits the back of a face escapes too; the report separates it from power that leaves the \
    scene.\n\n\
    If faces lie on each other front to front, the touching parts see only each other. If faces in one plane face the \
    same way, the smaller one is in front.\n\n\
    In Python: scipy.sparse.load_npz(\"f.npz\"), numpy.load(\"f.npy\"), scipy.io.mmread(\"f.mtx\"), \
    pandas.read_csv(\"f.csv\", index_col=0).")]
pub struct ViewFactorsArgs {
    #[command(flatten)]
    surfaces: SurfaceArgs,
    /// Write the matrix to this file: all entries as .csv or .npy, or the entries that are not zero as .npz (SciPy) or
    /// .mtx (Matrix Market)
    #[arg(short, long, value_name = "OUT")]
    output: Option<PathBuf>,
    /// Write a line `from,to,view_factor,standard_error` for each view factor that is not zero
    #[arg(long, value_name = "PAIRS.csv")]
    pairs: Option<PathBuf>,
    /// Write all figures as JSON
    #[arg(long, value_name = "R.json")]
    report: Option<PathBuf>,
    /// Make the sky a surface. It receives the power that leaves the scene upward
    #[arg(long)]
    sky: bool,
    /// Make the ground a surface. It receives the power that leaves the scene downward
    #[arg(long)]
    ground: bool,
    /// The axis that points up
    #[arg(long, value_enum, default_value_t = UpName::Y)]
    up: UpName,
    #[command(flatten)]
    common: Common,
}

#[derive(Clone, Copy, ValueEnum)]
enum UpName {
    /// +y
    Y,
    /// +z
    Z,
}

impl UpName {
    fn direction(self) -> DVec3 {
        match self {
            UpName::Y => DVec3::Y,
            UpName::Z => DVec3::Z,
        }
    }
}

/// Runs the command.
pub fn run(args: &ViewFactorsArgs) -> Result<Outcome> {
    let start = Instant::now();
    let by = args.surfaces.by.as_ref().unwrap_or(&By::Face);
    let text = |path: &PathBuf, what| outputs::text(path, &[args.surfaces.scene.as_path()], what);
    let matrix = args.output.as_ref().map(|path| Ok((text(path, "a table")?, format(path)?))).transpose()?;
    let pairs = args.pairs.as_ref().map(|path| text(path, "a table")).transpose()?;
    let report_file = args.report.as_ref().map(|path| text(path, "a report")).transpose()?;
    let files: Vec<_> =
        matrix.iter().map(|(file, _)| file).chain([&pairs, &report_file].into_iter().flatten()).collect();
    outputs::check_distinct(&files)?;
    args.common.start_threads()?;

    let watch = Watch::new(args.common.quiet);
    let mut times = ViewFactorSeconds::default();
    let mut warnings = Warnings::new(&watch);
    let (scene, surfaces);
    ((scene, surfaces), times.load) =
        watch.stage("reading", || read(&args.surfaces, by, &files, &mut warnings))?;
    let Known { seen, found, enclosed, seconds: [looking, computing] } =
        find(&args.surfaces, args.common.limit(), args.up.direction(), &surfaces, &mut warnings)?;
    (times.look, times.view_factors) = (looking, computing);

    watch.begin_writing();
    let mut pending = Vec::new();
    let writing = Instant::now();
    let output = Table { surfaces: &surfaces, found: &found, sky: args.sky, ground: args.ground };
    pending.extend(matrix.map(|(file, format)| file.write(|out| output.write(format, out))).transpose()?);
    pending.extend(pairs.map(|file| file.write(|out| output.write_pairs(out))).transpose()?);
    times.output = seconds(writing.elapsed());
    times.total = seconds(start.elapsed());
    let report = ViewFactorsReport {
        version: env!("CARGO_PKG_VERSION"),
        scene: args.surfaces.scene.display().to_string(),
        triangles: scene.triangles.len(),
        polygons: surfaces.polygons(),
        doubled: surfaces.doubled,
        tiny: surfaces.tiny,
        enclosed,
        look: LookReport::of(&seen),
        rays: found.rays,
        non_zeros: found.non_zeros(),
        error: ViewFactorErrorReport::of(&surfaces, &found, args.surfaces.error),
        row_sum_deviation: found.row_sum_deviation().into(),
        reciprocity_deviation: found.reciprocity_deviation().into(),
        surfaces: SurfaceReport::all(&surfaces, &found),
        warnings: warnings.warnings,
        seconds: times,
        peak_bytes: peak_bytes(),
        options: ViewFactorOptionsReport {
            by: name(by),
            side: args.surfaces.side.side().1,
            seed: args.surfaces.seed,
            threads: rayon::current_num_threads(),
        },
    };
    pending.extend(report_file.map(|file| file.write(|out| report.write(out))).transpose()?);
    watch.progress().check()?;
    Pending::commit_all(pending)?;
    drop(watch);
    if !args.common.quiet {
        to_stdout(&table(&report, &outputs::names(&[&args.output, &args.pairs, &args.report])))?;
    }
    Ok(if report.error.rms <= args.surfaces.error {
        Outcome::Done
    } else {
        Outcome::CheckFailed(format!(
            "the error is {:.1e}, above the target of {:.1e}",
            report.error.rms, args.surfaces.error
        ))
    })
}

/// The format of the matrix.
fn format(path: &Path) -> Result<MatrixFormat> {
    MatrixFormat::of(path).ok_or_else(|| Error::Usage {
        message: format!("{}: unknown kind of table", path.display()),
        hint: Some("end the name in .csv, .npy, .npz or .mtx".into()),
    })
}

fn table(report: &ViewFactorsReport, written: &str) -> String {
    let mut text = String::new();
    let mut row = |name: &str, value: String| summary::row(&mut text, name, &value);
    let ViewFactorsReport { look, error, seconds, options, .. } = report;
    row("scene", format!("{}: {}", report.scene, summary::count(report.triangles, "triangle")));
    let n = report.surfaces.len();
    let of = summary::count(report.polygons, "polygon");
    row("surfaces", format!("{n} by {} ({} side), of {of}", options.by, options.side));
    let (is, lost) = (if report.enclosed { "yes" } else { "no" }, [look.escaped, look.backs]);
    row(
        "enclosed",
        format!("{is}: of {} rays, {} hit nothing and {} hit backs", look.rays, lost[0], lost[1]),
    );
    row("rays", format!("{}, {} view factors that are not zero", report.rays, report.non_zeros));
    let mut at = String::new();
    if let Some([from, to]) = &error.largest_at {
        let _ = write!(at, ", at most {:.1e} (from {from} to {to})", error.largest);
    }
    row("error", format!("{:.1e} RMS standard error of view factors that are not zero{at}", error.rms));
    row(
        "row sums",
        format!(
            "off 1 by {} before closure, {} after",
            summary::small(report.row_sum_deviation.before),
            summary::small(report.row_sum_deviation.after)
        ),
    );
    row("reciprocity", format!("off by {}", summary::small(report.reciprocity_deviation.after)));
    row(
        "seconds",
        format!(
            "load {:.2}, look {:.2}, view factors {:.2}, output {:.2}; total {:.2}",
            seconds.load, seconds.look, seconds.view_factors, seconds.output, seconds.total
        ),
    );
    row("wrote", written.into());
    text
}
