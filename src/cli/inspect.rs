//! `radiosity inspect`: the contents and the problems of a scene, before anything is computed.

use std::{fmt::Write, num::NonZeroUsize, path::PathBuf, time::Instant};

use clap::Args;
use glam::DVec3;
use radiosity::{
    Progress, Quality, Result, Scene,
    accuracy::{error_bars::ErrorBars, memory::Memory, survey::Survey},
    energy::EnergyLedger,
    form_factor::{CastOptions, Estimator, FormFactors},
    output::inspection_report::{Enclosed, EnclosedReport, InspectionReport, MaterialReport},
    patch::{Patches, Subdivision},
    scene::{
        Material,
        inspection::{Inspection, MaterialUse},
        surfaces::{By, Side, Surfaces},
    },
    solve::{SolveOptions, Solver, solve},
    trace::Tracer,
    view_factor::look,
};

use super::{
    Common, Outcome, forecast, options::SceneArgs, outputs, pipeline, summary, to_stdout, watch::Watch,
};

/// Check a scene before you compute: its contents, its problems, and the cost of each quality
#[derive(Args)]
#[command(after_help = "Example:\n  radiosity inspect room.obj --report room.json\n\n\
    Loads the scene, checks the edges of its faces, casts some rays to find the visible sides, and estimates patches, \
    memory and time for each quality. The exit status is 0 for every scene that can be loaded, even if nothing in it \
    emits light.")]
pub struct InspectArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// Write all figures as JSON
    #[arg(long, value_name = "R.json")]
    report: Option<PathBuf>,
    /// Forecast the memory of each of this number of MPI ranks that share out `solve`. See docs/guides/clusters.md
    #[arg(long, value_name = "N", default_value = "1")]
    ranks: NonZeroUsize,
    #[command(flatten)]
    common: Common,
}

/// Rays for the survey. They take about ten milliseconds and give shares to half a per cent.
const RAYS: u64 = 1 << 17;

/// Runs the command.
pub fn run(args: &InspectArgs) -> Result<Outcome> {
    let report_file = args.report.as_ref().map(|path| outputs::report(path, &args.scene.path)).transpose()?;
    args.common.start_threads()?;
    let watch = Watch::new(args.common.quiet);
    let files: Vec<_> = report_file.iter().collect();
    let ((scene, (inspection, enclosed)), _) = watch.stage("reading", || {
        pipeline::read_and(&args.scene, &files, &watch, |scene| (Inspection::of(scene), enclosed(scene)))
    })?;
    let (tracer, _) = watch.stage("bvh", || Ok(Tracer::new(&scene)))?;
    pipeline::warn_of_turned_lamps(&scene, &tracer, &watch);
    let (bookkeeping, _) = watch.stage("pace", || bookkeeping(watch.progress()))?;
    let (survey, _) = watch.stage("rays", || Ok(Survey::of(&scene, &tracer, RAYS, 0)))?;
    let a_ray = survey.seconds / (survey.all.rays + survey.lamps.rays).max(1) as f64 + bookkeeping;

    let bytes = |patches: f64, rays: f64| {
        Memory::of(&scene, patches, rays, Estimator::Pooled, Solver::Auto).among(args.ranks.get()).peak()
    };
    let file = args.scene.path.display().to_string();
    let report = InspectionReport::new(&file, &scene, &inspection, enclosed, &survey, |quality: Quality| {
        let fronts = Patches::forecast(&scene, &Subdivision::Count(quality.patches));
        let patches = (fronts * (1.0 + survey.back_area)).round();
        let rays = f64::from(quality.rays);
        (patches, patches * rays, bytes(patches, rays), patches * rays * a_ray)
    });
    watch.begin_writing();
    if let Some(file) = report_file {
        file.write(|out| report.write(out))?.commit()?;
    }
    drop(watch);
    if !args.common.quiet {
        to_stdout(&table(&report, args.common.limit(), args.ranks.get()))?;
    }
    Ok(Outcome::Done)
}

/// Looking round takes seconds where faces are more than this.
const MOST_FACES: usize = 50_000;

/// Whether the faces enclose a room, as `view-factors` finds out; `None` where they are too many.
fn enclosed(scene: &Scene) -> Option<EnclosedReport> {
    if scene.faces.len().max(scene.triangles.len() / 2) > MOST_FACES {
        return None;
    }
    let surfaces = Surfaces::of(scene, &By::Face, Side::Front);
    let seen = look(&surfaces.list, &surfaces.obstacles, DVec3::Y);
    Some(EnclosedReport::new(&surfaces, &seen))
}

/// Seconds per ray on this machine for everything except tracing: form factors, solution and error bars. Measured on a
/// room whose tracing time is measured too.
fn bookkeeping(progress: &Progress) -> Result<f64> {
    let at = |k: u32| DVec3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2));
    let walls = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
    let triangles: Vec<_> = std::iter::zip(0u32.., walls)
        .map(|(k, wall)| (u32::from(k == 0), wall.map(at)))
        .flat_map(|(m, [a, b, c, d])| [([a, b, c], m), ([a, c, d], m)])
        .collect();
    let grey = |name, emission| Material::new(name, [0.5; 3], emission);
    let room = Scene::new(&triangles, vec![grey("wall", [0.0; 3]), grey("lamp", [1.0; 3])]);
    let tracer = Tracer::new(&room);
    let survey = Survey::of(&room, &tracer, RAYS, 0);
    let tracing = survey.seconds / (survey.all.rays + survey.lamps.rays) as f64;
    let start = Instant::now();
    let mut patches = Patches::subdivide(&room, &Subdivision::Count(2000));
    let cast = CastOptions::default().with_rays(f64::from(Quality::DRAFT.rays));
    let form_factors = FormFactors::cast(&room, &tracer, &mut patches, &cast, progress)?;
    let solution = solve(&form_factors, &patches, &SolveOptions::default(), progress)?;
    let _ = EnergyLedger::of(&form_factors, &patches, &solution);
    let _ = ErrorBars::of(&form_factors, &patches, &solution);
    let all = start.elapsed().as_secs_f64() / (cast.rays * patches.len() as f64);
    Ok((all - tracing).max(0.0))
}

fn table(report: &InspectionReport, limit: forecast::Limit, ranks: usize) -> String {
    let each = if ranks > 1 { format!(" on each of {ranks} ranks") } else { String::new() };
    let mut text = String::new();
    let mut row = |name: &str, value: String| summary::row(&mut text, name, &value);
    let scene = &report.scene;
    row(
        "scene",
        format!(
            "{}: {} triangles, {} vertices, area {:.6}",
            scene.file, scene.triangles, scene.vertices, scene.area
        ),
    );
    let size: Vec<String> =
        std::iter::zip(scene.bounds_min, scene.bounds_max).map(|(a, b)| format!("{:.6}", b - a)).collect();
    let unit = scene.unit_guess.map_or("unit of length unknown".into(), |unit| format!("probably in {unit}"));
    row("size", format!("{}, {unit}", size.join(" x ")));
    let edges = &report.edges.count;
    row(
        "edges",
        format!(
            "{}: {} open, {} with more than two faces, {} of mixed winding",
            edges.total, edges.open, edges.non_manifold, edges.inconsistent
        ),
    );
    row("enclosed", report.enclosed.as_ref().map_or("not examined: too many faces".into(), enclosure));
    let contacts = &report.contacts;
    if contacts.lines > 0 {
        row(
            "contacts",
            format!(
                "{} lines where surfaces touch or cross; {} triangles are cut along them, into {}",
                contacts.lines, contacts.triangles, contacts.pieces
            ),
        );
    }
    row(
        "faulty",
        format!(
            "{} triangles without area, {} doubled, {} vertices almost coincide",
            scene.degenerate, scene.doubled, scene.near_vertices
        ),
    );
    let seen = &report.seen;
    let mut sights = format!(
        "{:.2} % of the hits are backs, {:.2} % of the rays escape",
        100.0 * seen.back_share,
        100.0 * seen.escaped_share
    );
    if let Some(share) = seen.lamp_escaped_share {
        let _ = write!(sights, ", {:.2} % of the rays from lamps", 100.0 * share);
    }
    row("rays", sights);
    let (shown, hidden) = worth_showing(&report.materials);
    for m in shown {
        row("material", material(m, scene.area, scene.units.radiance));
    }
    if hidden > 0 {
        row("material", format!("and {hidden} more"));
    }
    row(
        "textures",
        format!(
            "{} read; {} missing",
            report.textures.found.len(),
            summary::count(report.textures.missing.len(), "file")
        ),
    );
    for f in &report.forecast {
        row(
            f.quality,
            format!(
                "about {} patches, {:.2e} rays; up to {} of memory{each}{}, about {}{}",
                f.patches,
                f.rays,
                summary::memory(f.bytes),
                if limit.allows(f.bytes) { "" } else { " (more than allowed)" },
                time(f.seconds),
                if ranks > 1 { " on one" } else { "" }
            ),
        );
    }
    match &report.concerns[..] {
        [] => row("concerns", "none".into()),
        concerns => concerns.iter().for_each(|concern| row("concern", concern.clone())),
    }
    text
}

/// Whether the faces enclose a room, and where they do not.
fn enclosure(enclosed: &EnclosedReport) -> String {
    let most = enclosed.open_at.iter().take(4);
    let faces: Vec<String> =
        most.map(|open| format!("`{}` ({:.3} %)", open.face, 100.0 * open.lost_share)).collect();
    let more = enclosed.open_at.len() - faces.len();
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    let at = format!("from faces {}{more}", faces.join(", "));
    match enclosed.enclosed {
        Enclosed::Yes => "yes: every ray from a front meets a front".into(),
        Enclosed::Cracked => format!("but for cracks: some rays are lost {at}"),
        Enclosed::No => format!("no: rays leave the scene or meet backs {at}"),
    }
}

/// The lamps and the materials with the largest areas, in the order of the scene, and the number of the others.
fn worth_showing(materials: &[MaterialReport]) -> (Vec<&MaterialUse>, usize) {
    const MOST: usize = 12;
    let mut order: Vec<usize> = (0..materials.len()).collect();
    let emits = |m: &MaterialUse| m.emission.iter().any(|&e| e > 0.0);
    order.sort_by(|&i, &j| {
        let rank = |k: usize| (emits(&materials[k].used), materials[k].used.area);
        let ((lamp_i, area_i), (lamp_j, area_j)) = (rank(i), rank(j));
        lamp_j.cmp(&lamp_i).then(area_j.total_cmp(&area_i))
    });
    order.truncate(MOST);
    order.sort_unstable();
    let hidden = materials.len() - order.len();
    (order.into_iter().map(|i| &materials[i].used).collect(), hidden)
}

fn material(m: &MaterialUse, total: f64, unit: &str) -> String {
    let colour = |c: [f64; 3]| match c.map(|x| format!("{:.4}", (x * 1e4).round() / 1e4)) {
        [r, g, b] if r == g && g == b => r,
        rgb => rgb.join(" "),
    };
    let mut text = format!(
        "{}: {} triangles, {:.2} % of the area, reflectance {}",
        m.name,
        m.triangles,
        100.0 * m.area / total,
        colour(m.reflectance)
    );
    if m.emission.iter().any(|&e| e > 0.0) {
        let _ = write!(text, ", emits {} {unit}", colour(m.emission));
    }
    text
}

/// An estimated time, with two digits.
fn time(seconds: f64) -> String {
    match seconds {
        s if s < 1.0 => format!("{s:.2} s"),
        s if s < 10.0 => format!("{s:.1} s"),
        s if s < 120.0 => format!("{s:.0} s"),
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.0} h", s / 3600.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lamps_come_before_large_walls() {
        let made = |k: usize| MaterialReport {
            used: MaterialUse {
                name: k.to_string(),
                triangles: 1,
                area: k as f64,
                reflectance: [0.5; 3],
                emission: [if k == 1 { 2.0 } else { 0.0 }; 3],
            },
            share_of_backs: 0.0,
        };
        let all: Vec<_> = (0..20).map(made).collect();
        let (shown, hidden) = worth_showing(&all);
        assert_eq!(hidden, 8);
        let names: Vec<_> = shown.iter().map(|m| m.name.as_str()).collect();
        assert_eq!(names, ["1", "9", "10", "11", "12", "13", "14", "15", "16", "17", "18", "19"]);
    }
}
