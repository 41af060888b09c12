//! Surfaces and their view factors, for the commands that start with them.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use glam::DVec3;
use radiosity::{
    Error, Result, Scene,
    output::file::OutputFile,
    scene::{
        DEFAULT_REFLECTANCE, LoadOptions, Part,
        surfaces::{By, Side, Surface, Surfaces},
    },
    view_factor::{Enclosure, Sight, ViewFactorOptions, ViewFactors, leaks, look, view_factors_among},
};

use super::{forecast::Limit, options, watch::Watch};

/// The surfaces, and the accuracy of their view factors.
#[derive(Args)]
pub struct SurfaceArgs {
    /// The scene, in any format that `inspect` reads
    #[arg(value_name = "SCENE")]
    pub scene: PathBuf,
    /// Leave out all faces of a material, for example window panes. May be repeated
    #[arg(long, value_name = "MATERIAL")]
    pub ignore: Vec<String>,
    /// Cast rays until the RMS standard error of the view factors that are not zero is below this
    #[arg(long, value_name = "E", default_value_t = ViewFactorOptions::default().error, value_parser = error)]
    pub error: f64,
    /// Let all faces of a material block, but do not make them surfaces. May be repeated
    #[arg(long, value_name = "MATERIAL")]
    pub obstruct: Vec<String>,
    /// The faces that form one surface: face (one face; its name is its number in the file from 0), group (`g` in an
    /// .obj), object (`o`), material, or property:NAME (all faces of a .ply with the same value) [default: face; group
    /// in `exchange`]
    #[arg(long, value_parser = by)]
    pub by: Option<By>,
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

/// The sides of faces that are surfaces.
#[derive(Clone, Copy, ValueEnum)]
pub enum SideName {
    /// The side from which the corners run counter-clockwise
    Front,
    /// The side from which they run clockwise
    Back,
    /// Each side is a separate surface: first all fronts, then all backs
    Both,
}

/// Reads the value of `--by`.
fn by(text: &str) -> std::result::Result<By, String> {
    match text {
        "face" => Ok(By::Face),
        "group" => Ok(By::Group),
        "object" => Ok(By::Object),
        "material" => Ok(By::Material),
        _ => match text.strip_prefix("property:") {
            Some(name) if !name.is_empty() => Ok(By::Property(name.into())),
            _ => Err("expected face, group, object, material or property:NAME".into()),
        },
    }
}

/// The word for a kind of surface.
pub fn name(by: &By) -> String {
    match by {
        By::Face => "face".into(),
        By::Group => "group".into(),
        By::Object => "object".into(),
        By::Material => "material".into(),
        By::Property(name) => format!("property:{name}"),
    }
}

impl SideName {
    /// The side for the library, and its name.
    pub fn side(self) -> (Side, &'static str) {
        match self {
            SideName::Front => (Side::Front, "front"),
            SideName::Back => (Side::Back, "back"),
            SideName::Both => (Side::Both, "both"),
        }
    }
}

fn error(text: &str) -> std::result::Result<f64, String> {
    options::parse(text, |x| (1e-7..=0.1).contains(&x), "expected an error between 1e-7 and 0.1")
}

/// Share of hits on backs that causes a warning.
const MANY_BACKS: f64 = 0.01;

/// Collects warnings: prints each, and keeps it for the report.
pub struct Warnings<'a> {
    pub watch: &'a Watch,
    pub warnings: Vec<String>,
}

impl<'a> Warnings<'a> {
    pub fn new(watch: &'a Watch) -> Warnings<'a> {
        Warnings { watch, warnings: Vec::new() }
    }

    pub fn warn(&mut self, warning: String) {
        self.watch.warn(&warning);
        self.warnings.push(warning);
    }

    /// Warns of faces that are probably mistakes.
    fn odd(&mut self, path: &Path, surfaces: &Surfaces) {
        for (faces, what) in [
            (&surfaces.odd.bent, "has corners out of its plane: its triangles are used as they are"),
            (
                &surfaces.odd.turned,
                "runs along an edge in the same direction as its neighbour: one of the two shows its back",
            ),
        ] {
            let Some(&(first, line)) = faces.first() else { continue };
            let line = line.map_or(String::new(), |line| format!(":{line}"));
            let more = match faces.len() - 1 {
                0 => String::new(),
                n => {
                    format!("; the same of {n} more: {}", list(faces[1..].iter().map(|(k, _)| k.to_string())))
                }
            };
            self.warn(format!("{}{line}: face {first} {what}{more}", path.display()));
        }
    }

    /// Warns of surfaces that are hidden by others in their plane.
    pub fn hidden(&mut self, args: &SurfaceArgs, surfaces: &Surfaces, found: &ViewFactors) {
        let of: Vec<usize> = (0..found.len()).filter(|&i| found.hidden[i] > 0.0).collect();
        let Some(&most) = of.iter().max_by(|&&i, &&j| found.hidden[i].total_cmp(&found.hidden[j])) else {
            return;
        };
        self.warn(format!(
            "{}: parts of {} surfaces lie in the plane of smaller faces, which hide them; for `{}`, the hidden area is {:.6}. \
             Hidden parts do not count",
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
            "{}: before closure, the view factors of {} surfaces sum to more than 1, those of `{}` to {:.4}: \
             do faces cross or overlap?",
            place(args, surfaces, worst),
            rows.len(),
            surfaces.list[worst].name,
            found.row_sums[worst]
        ));
    }

    /// Warns of surfaces whose rows do not sum to one after closure. Their rays contradict each other.
    pub fn unclosed(&mut self, args: &SurfaceArgs, surfaces: &Surfaces, found: &ViewFactors) {
        let sums: Vec<f64> =
            (0..found.len()).map(|i| found.row(i).map(|(_, f)| f).sum::<f64>() + found.escaped(i)).collect();
        let off = |i: usize| (sums[i] - 1.0).abs();
        let rows: Vec<usize> =
            (0..sums.len()).filter(|&i| found.areas()[i] > 0.0 && off(i) > CLOSED).collect();
        let Some(&worst) = rows.iter().max_by(|&&i, &&j| off(i).total_cmp(&off(j))) else { return };
        self.warn(format!(
            "{}: closure failed for {} surfaces: the view factors of `{}` sum to {:.7}, because they contradict the view \
             factors of other surfaces; a smaller --error helps",
            place(args, surfaces, worst),
            rows.len(),
            surfaces.list[worst].name,
            sums[worst]
        ));
    }
}

/// Rows whose sums differ from one by more than this cause a warning. Rounding errors are a hundred times smaller.
const CLOSED: f64 = 1e-10;

/// The file, and the line at which a surface begins.
fn place(args: &SurfaceArgs, surfaces: &Surfaces, i: usize) -> String {
    let line = surfaces.list[i].line.map_or(String::new(), |line| format!(":{line}"));
    format!("{}{line}", args.scene.display())
}

/// The scene and its surfaces.
pub fn read(
    args: &SurfaceArgs,
    by: &By,
    outputs: &[&OutputFile],
    warnings: &mut Warnings,
) -> Result<(Scene, Surfaces)> {
    let path = &args.scene;
    // View factors do not depend on the reflectance. Setting it avoids the warning about materials without one.
    let reflectance = Some([DEFAULT_REFLECTANCE; 3]);
    let options =
        LoadOptions::default().with_reflectance(reflectance).with_faces(true).with_keep_overlaps(true);
    let mut scene = Scene::load_with(path, &options)?;
    options::ignore(&mut scene, path, &args.ignore)?;
    let obstacles = options::materials(&scene, path, "--obstruct", &args.obstruct)?;
    scene.cut_overlaps();
    outputs.iter().try_for_each(|output| output.check_inputs(&scene.files))?;
    scene.warnings.iter().for_each(|warning| warnings.warn(warning.clone()));
    if scene.degenerate > 0 {
        warnings.warn(format!("{}: left out {} triangles without area", path.display(), scene.degenerate));
    }
    let (is_named, what) = match by {
        By::Group => {
            (scene.parts.iter().any(|part| part.group.is_some()), "no face belongs to a named group".into())
        }
        By::Object => {
            (scene.parts.iter().any(|part| part.object.is_some()), "no face belongs to a named object".into())
        }
        By::Property(name) => {
            let has = |part: &Part| part.properties.iter().any(|(property, _)| property == name);
            (scene.parts.iter().any(has), format!("no face has a property `{name}`"))
        }
        By::Face | By::Material => (true, String::new()),
    };
    if !is_named {
        return Err(Error::input(path, None, what).with_hint("choose another kind of surface with --by"));
    }
    let surfaces = Surfaces::among(&scene, by, args.side.side().0, &obstacles);
    if surfaces.list.is_empty() {
        return Err(Error::input(path, None, "every face is too small beside the whole scene"));
    }
    if surfaces.doubled > 0 {
        warnings.warn(format!(
            "{}: left out {} faces at the same place as earlier ones",
            path.display(),
            surfaces.doubled
        ));
    }
    if surfaces.tiny > 0 {
        warnings.warn(format!(
            "{}: left out {} triangles too small beside the scene",
            path.display(),
            surfaces.tiny
        ));
    }
    warnings.odd(path, &surfaces);
    Ok((scene, surfaces))
}

/// The first of some names, and how many more there are.
fn list(names: impl ExactSizeIterator<Item = String>) -> String {
    const MOST: usize = 4;
    let more = names.len().saturating_sub(MOST);
    let first: Vec<String> = names.take(MOST).collect();
    first.join(", ") + &if more > 0 { format!(" and {more} more") } else { String::new() }
}

/// The surfaces that lose most rays, with the lost share.
pub fn open_faces(surfaces: &Surfaces, seen: &[Sight]) -> String {
    let named = |i: usize| format!("`{}` ({:.3} %)", surfaces.list[i].name, 100.0 * seen[i].lost_share());
    list(leaks(seen).into_iter().map(named))
}

/// The view factors of the surfaces of a scene, and the rays that tested whether they enclose a room.
pub struct Known {
    pub seen: Vec<Sight>,
    pub found: ViewFactors,
    pub enclosed: bool,
    /// Seconds for the test rays and for the view factors.
    pub seconds: [f64; 2],
}

/// Casts test rays, computes the view factors, and warns of problems.
pub fn find(
    args: &SurfaceArgs,
    limit: Limit,
    up: DVec3,
    surfaces: &Surfaces,
    warnings: &mut Warnings,
) -> Result<Known> {
    let watch = warnings.watch;
    limit.check_polygons(surfaces.polygons())?;
    let (seen, look) = watch.stage("looking", || Ok(look(&surfaces.list, &surfaces.obstacles, up)))?;
    let ((found, enclosed), view_factors) =
        watch.stage("view factors", || compute(args, up, surfaces, &seen, warnings))?;
    warnings.hidden(args, surfaces, &found);
    warnings.overfull(args, surfaces, &found);
    warnings.unclosed(args, surfaces, &found);
    Ok(Known { seen, found, enclosed, seconds: [look, view_factors] })
}

/// The view factors, and whether the surfaces enclose a room.
fn compute(
    args: &SurfaceArgs,
    up: DVec3,
    surfaces: &Surfaces,
    seen: &[Sight],
    warnings: &mut Warnings,
) -> Result<(ViewFactors, bool)> {
    let watch = warnings.watch;
    let run = |enclosed: bool| {
        let options = ViewFactorOptions::default()
            .with_error(args.error)
            .with_enclosed(enclosed)
            .with_up(up)
            .with_seed(args.seed);
        view_factors_among(&surfaces.list, &surfaces.obstacles, &options, watch.progress())
    };
    let all = seen.iter().fold(Sight::default(), |all, sight| all.and(*sight));
    let (lost, scene) = (all.lost(), args.scene.display());
    let met = (all.rays - all.up - all.down).max(1);
    let backs = all.backs as f64 / met as f64;
    // Obstacles count as backs, and they are intended.
    if backs > MANY_BACKS && surfaces.obstacles.is_empty() {
        warnings.warn(format!(
            "{scene}: {:.1} % of the rays hit backs, which are not surfaces; --side back turns all faces round, --side both \
             uses both sides",
            100.0 * backs
        ));
    }
    if args.open || !args.enclosed && lost > 0 {
        return Ok((run(false)?, false));
    }
    let refused = |i: usize, message: String| {
        let Surface { line, .. } = &surfaces.list[i];
        let hint = match lost {
            0 => "leave --enclosed out".into(),
            _ => format!("leave --enclosed out; it is open where rays leave {}", open_faces(surfaces, seen)),
        };
        Err(Error::input(&args.scene, *line, message).with_hint(hint))
    };
    if let Enclosure::Open(i) = Enclosure::of(seen) {
        let Sight { rays, .. } = seen[i];
        let message = format!(
            "no room is enclosed: {} of {rays} rays left the room or hit backs, all from surface `{}`",
            seen[i].lost(),
            surfaces.list[i].name
        );
        return refused(i, message);
    }
    if lost > 0 {
        warnings.warn(format!(
            "{scene}: {lost} of {} rays left the room or hit backs, most from {}; --enclosed distributes their share",
            all.rays,
            open_faces(surfaces, seen)
        ));
    }
    match run(true) {
        Err(Error::NotEnclosed { surface, sum }) if args.enclosed => {
            let name = &surfaces.list[surface].name;
            refused(
                surface,
                format!("the view factors of surface `{name}` sum to {sum:.6}: no room is enclosed"),
            )
        }
        // No ray was lost, but chance does not explain the deviation of a row sum.
        Err(Error::NotEnclosed { surface, sum }) => {
            warnings.warn(format!(
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
