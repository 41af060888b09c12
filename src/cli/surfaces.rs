//! Surfaces and their view factors, for the commands that start with them.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use glam::DVec3;
use radiosity::{
    Error, Result, Scene,
    output::file::OutputFile,
    scene::{
        DEFAULT_REFLECTANCE, LoadOptions,
        surfaces::{By, Side, Surface, Surfaces},
    },
    view_factor::{Sight, ViewFactorOptions, ViewFactors, view_factors_of_surfaces},
};

use super::{options, watch::Watch};

/// Which surfaces, and how accurate their view factors are wanted.
#[derive(Args)]
pub struct SurfaceArgs {
    /// The scene, in any format that `inspect` reads
    #[arg(value_name = "SCENE")]
    pub scene: PathBuf,
    /// Leave out all faces of a material, for example of window panes. May be repeated
    #[arg(long, value_name = "MATERIAL")]
    pub ignore: Vec<String>,
    /// Cast rays until the RMS standard error of the view factors that are not zero is below this
    #[arg(long, value_name = "E", default_value_t = ViewFactorOptions::default().error, value_parser = error)]
    pub error: f64,
    /// What one surface is [default: face; group in `exchange`]
    #[arg(long, value_enum)]
    pub by: Option<ByName>,
    /// The sides of faces that are surfaces
    #[arg(long, value_enum, default_value_t = SideName::Front)]
    pub side: SideName,
    /// State that the surfaces enclose a room, so that all rows sum to 1. Refused if they clearly do not
    #[arg(long, conflicts_with = "open")]
    pub enclosed: bool,
    /// State that the surfaces do not enclose a room. The difference between 1 and the row sum escapes
    #[arg(long)]
    pub open: bool,
    /// Seed of the random numbers. The same seed gives the same bytes
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
}

/// What one surface is.
#[derive(Clone, Copy, ValueEnum)]
pub enum ByName {
    /// A face, named by its number in the file from 0
    Face,
    /// All faces of a group (`g` in an .obj)
    Group,
    /// All faces of an object (`o` in an .obj)
    Object,
    /// All faces of a material
    Material,
}

/// Which sides of faces are surfaces.
#[derive(Clone, Copy, ValueEnum)]
pub enum SideName {
    /// The side from which the corners run counter-clockwise
    Front,
    /// The side from which they run clockwise
    Back,
    /// Each side is a surface of its own: first all fronts, then all backs
    Both,
}

impl ByName {
    /// As the library knows it, and its name.
    pub fn by(self) -> (By, &'static str) {
        match self {
            ByName::Face => (By::Face, "face"),
            ByName::Group => (By::Group, "group"),
            ByName::Object => (By::Object, "object"),
            ByName::Material => (By::Material, "material"),
        }
    }
}

impl SideName {
    /// As the library knows it, and its name.
    pub fn side(self) -> (Side, &'static str) {
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

/// Share of hits on backs that causes a warning.
const MANY_BACKS: f64 = 0.01;

/// Warnings, for people and for the report.
pub struct Told<'a> {
    pub watch: &'a Watch,
    pub warnings: Vec<String>,
}

impl<'a> Told<'a> {
    pub fn new(watch: &'a Watch) -> Told<'a> {
        Told { watch, warnings: Vec::new() }
    }

    pub fn warn(&mut self, warning: String) {
        self.watch.warn(&warning);
        self.warnings.push(warning);
    }

    /// Warns of surfaces that are hidden by others in their plane.
    pub fn hidden(&mut self, args: &SurfaceArgs, surfaces: &Surfaces, found: &ViewFactors) {
        let of: Vec<usize> = (0..found.len()).filter(|&i| found.hidden[i] > 0.0).collect();
        let Some(&most) = of.iter().max_by(|&&i, &&j| found.hidden[i].total_cmp(&found.hidden[j])) else {
            return;
        };
        self.warn(format!(
            "{}: parts of {} surfaces lie in the plane of smaller faces, which hide them; of `{}` an area of {:.6}, \
             which is not counted",
            place(args, surfaces, most),
            of.len(),
            surfaces.list[most].name,
            found.hidden[most]
        ));
    }

    /// Warns of surfaces whose row sums exceeded one.
    pub fn overfull(&mut self, args: &SurfaceArgs, surfaces: &Surfaces, found: &ViewFactors) {
        let rows = found.overfull_rows();
        let Some(&worst) = rows.iter().max_by(|&&i, &&j| found.row_sums[i].total_cmp(&found.row_sums[j]))
        else {
            return;
        };
        self.warn(format!(
            "{}: the view factors of {} surfaces summed up to more than 1 before they were closed, those of `{}` to {:.4}: \
             do faces cross or overlap?",
            place(args, surfaces, worst),
            rows.len(),
            surfaces.list[worst].name,
            found.row_sums[worst]
        ));
    }

    /// Warns of surfaces whose rows do not sum to one after closure, because their rays contradict each other.
    pub fn unclosed(&mut self, args: &SurfaceArgs, surfaces: &Surfaces, found: &ViewFactors) {
        let sums: Vec<f64> =
            (0..found.len()).map(|i| found.row(i).map(|(_, f)| f).sum::<f64>() + found.escaped(i)).collect();
        let off = |i: usize| (sums[i] - 1.0).abs();
        let rows: Vec<usize> =
            (0..sums.len()).filter(|&i| found.areas()[i] > 0.0 && off(i) > CLOSED).collect();
        let Some(&worst) = rows.iter().max_by(|&&i, &&j| off(i).total_cmp(&off(j))) else { return };
        self.warn(format!(
            "{}: the view factors of {} surfaces could not be made to sum to 1, those of `{}` sum to {:.7}: those of \
             others leave no room for it; a smaller --error tells more",
            place(args, surfaces, worst),
            rows.len(),
            surfaces.list[worst].name,
            sums[worst]
        ));
    }
}

/// Rows whose sums differ from one by more than this cause a warning. Rounding errors are a hundred times smaller.
const CLOSED: f64 = 1e-10;

/// The file, and the line where a surface begins.
fn place(args: &SurfaceArgs, surfaces: &Surfaces, i: usize) -> String {
    let line = surfaces.list[i].line.map_or(String::new(), |line| format!(":{line}"));
    format!("{}{line}", args.scene.display())
}

/// The scene and its surfaces.
pub fn read(
    args: &SurfaceArgs,
    by: ByName,
    outputs: &[&OutputFile],
    told: &mut Told,
) -> Result<(Scene, Surfaces)> {
    let path = &args.scene;
    // View factors do not depend on the reflectance. Setting it avoids the warning about materials without one.
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
    let (by, name) = by.by();
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

/// The surfaces that lose most rays, with the lost share.
fn open_faces(surfaces: &Surfaces, seen: &[Sight]) -> String {
    const MOST: usize = 4;
    let share = |i: usize| seen[i].lost() as f64 / seen[i].rays.max(1) as f64;
    let mut open: Vec<usize> = (0..seen.len()).filter(|&i| seen[i].lost() > 0).collect();
    open.sort_by(|&i, &j| share(j).total_cmp(&share(i)));
    let name = |&i: &usize| format!("`{}` ({:.3} %)", surfaces.list[i].name, 100.0 * share(i));
    let names: Vec<String> = open.iter().take(MOST).map(name).collect();
    let more = open.len().saturating_sub(MOST);
    names.join(", ") + &if more > 0 { format!(" and {more} more") } else { String::new() }
}

/// The view factors, and whether the surfaces enclose a room.
pub fn compute(
    args: &SurfaceArgs,
    up: DVec3,
    surfaces: &Surfaces,
    seen: &[Sight],
    told: &mut Told,
) -> Result<(ViewFactors, bool)> {
    let watch = told.watch;
    let run = |enclosed: bool| {
        let options = ViewFactorOptions::default()
            .with_error(args.error)
            .with_enclosed(enclosed)
            .with_up(up)
            .with_seed(args.seed);
        view_factors_of_surfaces(&surfaces.list, &options, watch.progress())
    };
    let all = seen.iter().fold(Sight::default(), |all, sight| all.and(*sight));
    let (lost, scene) = (all.lost(), args.scene.display());
    let met = (all.rays - all.up - all.down).max(1);
    let backs = all.backs as f64 / met as f64;
    if backs > MANY_BACKS {
        told.warn(format!(
            "{scene}: {:.1} % of what surfaces see are backs, from which nothing comes; --side back turns all faces, \
             --side both takes both sides",
            100.0 * backs
        ));
    }
    if args.open || !args.enclosed && lost > 0 {
        return Ok((run(false)?, false));
    }
    if lost > 0 {
        told.warn(format!(
            "{scene}: {lost} of {} rays left the room or met backs, most from {}; --enclosed shares out what they carry",
            all.rays,
            open_faces(surfaces, seen)
        ));
    }
    match run(true) {
        Err(Error::NotEnclosed { surface, sum }) if args.enclosed => {
            let Surface { name, line, .. } = &surfaces.list[surface];
            let message =
                format!("the view factors of surface `{name}` sum to {sum:.6}: no room is enclosed");
            let hint = match lost {
                0 => "leave --enclosed out; `inspect` reports open edges and backs".into(),
                _ => format!(
                    "leave --enclosed out; it is open where rays leave {}",
                    open_faces(surfaces, seen)
                ),
            };
            Err(Error::input(&args.scene, *line, message).with_hint(hint))
        }
        // No ray was lost, but a row sum deviates by more than chance explains.
        Err(Error::NotEnclosed { surface, sum }) => {
            told.warn(format!(
                "{}: the view factors of `{}` sum to {sum:.6}, so no room is enclosed, though none of {} rays was lost",
                place(args, surfaces, surface),
                surfaces.list[surface].name,
                all.rays
            ));
            Ok((run(false)?, false))
        }
        found => Ok((found?, true)),
    }
}
