//! `radiosity view-factors`: view factors between the surfaces of a scene.

use std::{fmt::Write, path::PathBuf, time::Instant};

use clap::{Args, ValueEnum};
use radiosity::{
    Error, Result, Scene,
    accuracy::survey::{Seen, Survey},
    output::{
        file::{OutputFile, Pending},
        report::{peak_bytes, seconds},
        view_factors::{
            LookReport, SurfaceReport, ViewFactorErrorReport, ViewFactorOptionsReport, ViewFactorSeconds,
            ViewFactorsReport, write_matrix, write_pairs,
        },
    },
    scene::{
        DEFAULT_REFLECTANCE, LoadOptions,
        surfaces::{By, Side, Surface, Surfaces},
    },
    trace::Tracer,
    view_factor::{ViewFactorOptions, ViewFactors, view_factors_of_surfaces},
};

use super::{Common, Outcome, options, outputs, summary, to_stdout, watch::Watch};

/// Compute the view factors between all surfaces of a scene
#[derive(Args)]
#[command(
    after_help = "Example:\n  radiosity view-factors room.obj -o view-factors.csv --error 1e-4 --report r.json\n\n\
    A surface is a face of the file, or with --by all faces of a group, object or material, whose view factors are put\n\
    together by area. It is seen from its front, where its vertices run counter-clockwise; both its sides block light.\n\
    The table has a line a surface: its name, area, the share of what leaves it that escapes, and the view factors from\n\
    it to all surfaces. These and what escapes sum to 1, and A_i F_ij = A_j F_ji, to rounding. Where the surfaces enclose\n\
    a room nothing escapes; rays tell whether they do, unless --enclosed or --open says so. What meets the back of a\n\
    face escapes too. Errors told are of sampling alone, of what is hidden, before rows are made to sum to 1. What two\n\
    surfaces would exchange with nothing between them is computed, to 1e-3 of itself or a tenth of --error, whichever is\n\
    less. Reads into Python with numpy.loadtxt(\"view-factors.csv\", delimiter=\",\", skiprows=1)[:, 3:],\n\
    or pandas.read_csv(\"view-factors.csv\", index_col=0) where surfaces have names, as with --by or --side both."
)]
pub struct ViewFactorsArgs {
    /// The scene: Wavefront .obj, or .ply
    #[arg(value_name = "SCENE")]
    scene: PathBuf,
    /// Leave out all faces of a material, as of window panes. May be given several times
    #[arg(long, value_name = "MATERIAL")]
    ignore: Vec<String>,
    /// Write the matrix here, as CSV
    #[arg(short, long, value_name = "OUT.csv")]
    output: Option<PathBuf>,
    /// Write a line `from,to,view_factor,standard_error` for each view factor that is not zero
    #[arg(long, value_name = "PAIRS.csv")]
    pairs: Option<PathBuf>,
    /// Write all figures as JSON
    #[arg(long, value_name = "R.json")]
    report: Option<PathBuf>,
    /// Cast rays until the RMS standard error of view factors, over all pairs of surfaces, is below this
    #[arg(long, value_name = "E", default_value_t = ViewFactorOptions::default().error, value_parser = error)]
    error: f64,
    /// What one surface is
    #[arg(long, value_enum, default_value_t = ByName::Face)]
    by: ByName,
    /// Which sides of faces are surfaces
    #[arg(long, value_enum, default_value_t = SideName::Front)]
    side: SideName,
    /// The surfaces enclose a room: all rows sum to 1. Refused where they clearly do not
    #[arg(long, conflicts_with = "open")]
    enclosed: bool,
    /// The surfaces enclose no room: what rows miss to 1 escapes
    #[arg(long)]
    open: bool,
    /// Another seed casts other rays; the same gives the same bytes
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    common: Common,
}

#[derive(Clone, Copy, ValueEnum)]
enum ByName {
    /// A face, named by its number in the file from 0
    Face,
    /// All faces of a group (`g` in an .obj)
    Group,
    /// All faces of an object (`o` in an .obj)
    Object,
    /// All faces of a material
    Material,
}

#[derive(Clone, Copy, ValueEnum)]
enum SideName {
    /// Where vertices run counter-clockwise
    Front,
    /// Where they run clockwise
    Back,
    /// Each is a surface: first all fronts, then all backs
    Both,
}

impl ByName {
    fn by(self) -> (By, &'static str) {
        match self {
            ByName::Face => (By::Face, "face"),
            ByName::Group => (By::Group, "group"),
            ByName::Object => (By::Object, "object"),
            ByName::Material => (By::Material, "material"),
        }
    }
}

impl SideName {
    fn side(self) -> (Side, &'static str) {
        match self {
            SideName::Front => (Side::Front, "front"),
            SideName::Back => (Side::Back, "back"),
            SideName::Both => (Side::Both, "both"),
        }
    }
}

fn error(text: &str) -> std::result::Result<f64, String> {
    options::parse(text, |x| (1e-7..=0.1).contains(&x), "an error between 1e-7 and 0.1 is wanted")
}

/// Rays that look whether the surfaces enclose a room.
const LOOK: u64 = 1 << 17;
/// A share of backs among what is seen that is worth a word.
const MANY_BACKS: f64 = 0.01;

/// Runs the command.
pub fn run(args: &ViewFactorsArgs) -> Result<Outcome> {
    let start = Instant::now();
    let text = |path: &PathBuf, what| outputs::text(path, &[args.scene.as_path()], what);
    let matrix = args.output.as_ref().map(|path| text(path, "a table")).transpose()?;
    let pairs = args.pairs.as_ref().map(|path| text(path, "a table")).transpose()?;
    let report_file = args.report.as_ref().map(|path| text(path, "a report")).transpose()?;
    let files: Vec<_> = [&matrix, &pairs, &report_file].into_iter().flatten().collect();
    outputs::check_distinct(&files)?;
    args.common.start_threads()?;

    let watch = Watch::new(args.common.quiet);
    let mut times = ViewFactorSeconds::default();
    let mut told = Told { watch: &watch, warnings: Vec::new() };
    let (scene, surfaces);
    ((scene, surfaces), times.load) = watch.stage("reading", || read(args, &files, &mut told))?;
    args.common.limit().check_polygons(surfaces.polygons())?;
    let seen;
    (seen, times.look) = watch.stage("looking", || Ok(look(&surfaces)))?;
    let (found, enclosed);
    ((found, enclosed), times.view_factors) =
        watch.stage("view factors", || compute(args, &surfaces, &seen, &mut told))?;
    told.overfull(args, &surfaces, &found);
    told.unclosed(args, &surfaces, &found);

    watch.begin_writing();
    let mut pending = Vec::new();
    let writing = Instant::now();
    pending.extend(matrix.map(|file| file.write(|out| write_matrix(&surfaces, &found, out))).transpose()?);
    pending.extend(pairs.map(|file| file.write(|out| write_pairs(&surfaces, &found, out))).transpose()?);
    times.output = seconds(writing.elapsed());
    times.total = seconds(start.elapsed());
    let report = ViewFactorsReport {
        version: env!("CARGO_PKG_VERSION"),
        scene: args.scene.display().to_string(),
        triangles: scene.triangles.len(),
        polygons: surfaces.polygons(),
        doubled: surfaces.doubled,
        tiny: surfaces.tiny,
        enclosed,
        look: LookReport { rays: seen.rays, backs: seen.backs, escaped: seen.escaped },
        rays: found.rays,
        non_zeros: found.form_factors.non_zeros(),
        error: ViewFactorErrorReport::of(&surfaces, &found, args.error),
        row_sum_deviation: found.form_factors.row_sum_deviation().into(),
        reciprocity_deviation: found.form_factors.reciprocity_deviation().into(),
        surfaces: SurfaceReport::all(&surfaces, &found),
        warnings: told.warnings,
        seconds: times,
        peak_bytes: peak_bytes(),
        options: ViewFactorOptionsReport {
            by: args.by.by().1,
            side: args.side.side().1,
            seed: args.seed,
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
    Ok(if report.error.rms <= args.error {
        Outcome::Done
    } else {
        Outcome::CheckFailed(format!("the error is {:.1e}, {:.1e} was wanted", report.error.rms, args.error))
    })
}

/// Warnings, for people and for the report.
struct Told<'a> {
    watch: &'a Watch,
    warnings: Vec<String>,
}

impl Told<'_> {
    fn warn(&mut self, warning: String) {
        self.watch.warn(&warning);
        self.warnings.push(warning);
    }

    /// Names surfaces whose rows were more than full.
    fn overfull(&mut self, args: &ViewFactorsArgs, surfaces: &Surfaces, found: &ViewFactors) {
        let rows = found.overfull_rows();
        let Some(&worst) = rows.iter().max_by(|&&i, &&j| found.row_sums[i].total_cmp(&found.row_sums[j]))
        else {
            return;
        };
        self.warn(format!(
            "{}: the view factors of {} surfaces summed up to more than 1 before they were scaled, those of `{}` to {:.4}: \
             do faces overlap?",
            place(args, surfaces, worst),
            rows.len(),
            surfaces.list[worst].name,
            found.row_sums[worst]
        ));
    }

    /// Names surfaces whose rows do not sum to one after they were scaled, as the rays of some contradict each other's.
    fn unclosed(&mut self, args: &ViewFactorsArgs, surfaces: &Surfaces, found: &ViewFactors) {
        let sums: Vec<f64> = std::iter::zip(found.form_factors.row_sums(), found.form_factors.escaped())
            .map(|(sum, escaped)| sum + escaped)
            .collect();
        let off = |i: usize| (sums[i] - 1.0).abs();
        let rows: Vec<usize> = (0..sums.len()).filter(|&i| off(i) > CLOSED).collect();
        let Some(&worst) = rows.iter().max_by(|&&i, &&j| off(i).total_cmp(&off(j))) else { return };
        self.warn(format!(
            "{}: the view factors of {} surfaces could not be made to sum to 1, those of `{}` sum to {:.7}: too few rays tell \
             of what passes surfaces that are close to each other; a smaller --error tells more",
            place(args, surfaces, worst),
            rows.len(),
            surfaces.list[worst].name,
            sums[worst]
        ));
    }
}

/// Rows that sum to one but for more than this are told: rounding leaves less than a hundredth of it.
const CLOSED: f64 = 1e-10;

/// The file, and the line where a surface begins.
fn place(args: &ViewFactorsArgs, surfaces: &Surfaces, i: usize) -> String {
    let line = surfaces.list[i].line.map_or(String::new(), |line| format!(":{line}"));
    format!("{}{line}", args.scene.display())
}

/// The scene and its surfaces.
fn read(args: &ViewFactorsArgs, outputs: &[&OutputFile], told: &mut Told) -> Result<(Scene, Surfaces)> {
    let path = &args.scene;
    // Nothing here depends on it: given, it needs no warning where the file has none.
    let reflectance = Some([DEFAULT_REFLECTANCE; 3]);
    let options =
        LoadOptions::default().with_reflectance(reflectance).with_faces(true).with_keep_overlaps(true);
    let mut scene = Scene::load_with(path, &options)?;
    options::ignore(&mut scene, path, &args.ignore)?;
    scene.cut_overlaps();
    outputs.iter().try_for_each(|output| output.check_inputs(&scene.files))?;
    scene.warnings.iter().for_each(|warning| told.warn(warning.clone()));
    if scene.degenerate > 0 {
        told.warn(format!("{}: left out {} triangles without area", path.display(), scene.degenerate));
    }
    let (by, name) = args.by.by();
    let is_named = match by {
        By::Group => scene.parts.iter().any(|part| part.group.is_some()),
        By::Object => scene.parts.iter().any(|part| part.object.is_some()),
        By::Face | By::Material => true,
    };
    if !is_named {
        return Err(Error::input(path, None, format!("no face belongs to a named {name}"))
            .with_hint("choose another kind of surface with --by"));
    }
    let surfaces = Surfaces::of(&scene, by, args.side.side().0);
    if surfaces.list.is_empty() {
        return Err(Error::input(path, None, "every face is too small beside the whole scene"));
    }
    if surfaces.doubled > 0 {
        told.warn(format!(
            "{}: left out {} faces at the same place as earlier ones",
            path.display(),
            surfaces.doubled
        ));
    }
    if surfaces.tiny > 0 {
        told.warn(format!(
            "{}: left out {} triangles too small beside the scene",
            path.display(),
            surfaces.tiny
        ));
    }
    Ok((scene, surfaces))
}

/// What is seen from the surfaces.
fn look(surfaces: &Surfaces) -> Seen {
    let scene = surfaces.scene();
    Survey::of(&scene, &Tracer::new(&scene), LOOK, 0).all
}

/// The view factors, and whether the surfaces enclose a room.
fn compute(
    args: &ViewFactorsArgs,
    surfaces: &Surfaces,
    seen: &Seen,
    told: &mut Told,
) -> Result<(ViewFactors, bool)> {
    let watch = told.watch;
    let run = |enclosed: bool| {
        let options =
            ViewFactorOptions::default().with_error(args.error).with_enclosed(enclosed).with_seed(args.seed);
        view_factors_of_surfaces(&surfaces.list, &options, watch.progress())
    };
    let lost = seen.backs + seen.escaped;
    if seen.back_share() > MANY_BACKS {
        let share = 100.0 * seen.back_share();
        told.warn(format!(
            "{}: {share:.1} % of what surfaces see are backs, from which nothing comes; --side back turns all faces, \
             --side both takes both sides",
            args.scene.display()
        ));
    }
    if args.open || !args.enclosed && lost > 0 {
        return Ok((run(false)?, false));
    }
    if lost > 0 {
        told.warn(format!(
            "{}: {lost} of {} rays left the room or met backs; --enclosed shares out what they carry",
            args.scene.display(),
            seen.rays
        ));
    }
    match run(true) {
        Err(Error::NotEnclosed { surface, sum }) if args.enclosed => {
            let Surface { name, line, .. } = &surfaces.list[surface];
            let message =
                format!("the view factors of surface `{name}` sum to {sum:.4}: no room is enclosed");
            Err(Error::input(&args.scene, *line, message)
                .with_hint("leave --enclosed out; `inspect` tells of open edges and of backs"))
        }
        // So small a surface that rays missed it.
        Err(Error::NotEnclosed { .. }) => Ok((run(false)?, false)),
        found => Ok((found?, true)),
    }
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
    row("enclosed", format!("{is}: of {} rays {} met nothing, {} met backs", look.rays, lost[0], lost[1]));
    row("rays", format!("{}, {} view factors that are not zero", report.rays, report.non_zeros));
    let mut at = String::new();
    if let Some([from, to]) = &error.largest_at {
        let _ = write!(at, ", at most {:.1e} (from {from} to {to})", error.largest);
    }
    row("error", format!("{:.1e} RMS standard error of a view factor{at}", error.rms));
    row(
        "row sums",
        format!(
            "off 1 by {} as sampled, {} closed",
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
