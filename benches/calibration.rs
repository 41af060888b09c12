//! Compares error bars with errors, and reached errors with wanted errors. Solves the same patches with several seeds, and once
//! with many rays as the reference. Prints a Markdown table.
//!
//!     cargo bench --bench calibration -- [SCENE.obj ...]

use std::path::PathBuf;

use glam::DVec3;
use radiosity::{
    Progress, Result, Scene,
    accuracy::{
        error_bars::{T_QUANTILE, relative_rms},
        refinement::{Plan, Round, begin, refine},
        solved::Solved,
    },
    form_factor::CastOptions,
    patch::{Patches, Subdivision},
    scene::Material,
    solve::SolveOptions,
    trace::Tracer,
};

const PATCHES: usize = 1000;
const SEEDS: u64 = 8;
/// The reference has 8 to 128 times the rays: what it adds to the variance of a difference is that much smaller.
const REFERENCE_RAYS: f64 = 8192.0;

fn main() -> Result<()> {
    let files: Vec<PathBuf> =
        std::env::args_os().skip(1).filter(|word| word != "--bench").map(PathBuf::from).collect();
    let mut scenes = Vec::new();
    if files.is_empty() {
        for name in ["cornell-box.obj", "textured.obj", "door-ajar.obj"] {
            let path: PathBuf = [env!("CARGO_MANIFEST_DIR"), "meshes", name].iter().collect();
            scenes.push((name.to_owned(), Scene::load(&path)?));
        }
        scenes.push(("a block in the open".into(), open()));
        scenes.push(("a small lamp".into(), small_lamp()));
    }
    for path in files {
        scenes.push((path.display().to_string(), Scene::load(&path)?));
    }
    println!("| scene | patches | rays a patch | RMS error | as estimated | within 95 % intervals |");
    println!("|---|---|---|---|---|---|");
    for (name, scene) in scenes {
        let tracer = Tracer::new(&scene);
        let solve = |rays: f64, seed: u64| {
            let cast = CastOptions::default().with_rays(rays).with_seed(seed);
            let count = Subdivision::Count(PATCHES);
            Solved::new(&scene, &tracer, &count, &cast, &SolveOptions::default(), &Progress::new())
        };
        let reference = solve(REFERENCE_RAYS, 1_000_000)?;
        for rays in [64.0, 256.0, 1024.0] {
            row(&name, &reference, rays, |seed| solve(rays, seed))?;
        }
        targets(&name, &scene, &tracer, &reference)?;
    }
    Ok(())
}

/// Two triangles with these corners.
fn quad(corners: [[f64; 3]; 4], material: u32) -> [([DVec3; 3], u32); 2] {
    let [a, b, c, d] = corners.map(DVec3::from);
    [([a, b, c], material), ([a, c, d], material)]
}

/// The six sides of a box, seen from outside or from inside.
fn cuboid([x, y, z]: [f64; 3], [u, v, w]: [f64; 3], inside: bool, material: u32) -> Vec<([DVec3; 3], u32)> {
    let sides = [
        [[x, y, z], [x, v, z], [u, v, z], [u, y, z]],
        [[x, y, w], [u, y, w], [u, v, w], [x, v, w]],
        [[x, y, z], [u, y, z], [u, y, w], [x, y, w]],
        [[x, v, z], [x, v, w], [u, v, w], [u, v, z]],
        [[x, y, z], [x, y, w], [x, v, w], [x, v, z]],
        [[u, y, z], [u, v, z], [u, v, w], [u, y, w]],
    ];
    let turned = |s: [[f64; 3]; 4]| if inside { [s[0], s[3], s[2], s[1]] } else { s };
    sides.into_iter().flat_map(|s| quad(turned(s), material)).collect()
}

fn scene(triangles: &[([DVec3; 3], u32)]) -> Scene {
    let grey = Material::new("grey", [0.6; 3], [0.0; 3]);
    let lamp = Material::new("lamp", [0.0; 3], [10.0; 3]);
    Scene::new(triangles, vec![grey, lamp])
}

/// A block on a floor under a lamp, nothing around.
fn open() -> Scene {
    let mut triangles =
        quad([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [4.0, 4.0, 0.0], [0.0, 4.0, 0.0]], 0).to_vec();
    triangles.extend(cuboid([1.5, 1.5, 0.0], [2.5, 2.5, 1.0], false, 0));
    triangles.extend(quad([[1.0, 0.5, 3.0], [1.0, 1.5, 3.0], [2.0, 1.5, 3.0], [2.0, 0.5, 3.0]], 1));
    scene(&triangles)
}

/// A closed room with two blocks and a lamp a fiftieth as wide.
fn small_lamp() -> Scene {
    let mut triangles = cuboid([0.0; 3], [1.0; 3], true, 0);
    triangles.extend(cuboid([0.2, 0.2, 0.0], [0.4, 0.5, 0.5], false, 0));
    triangles.extend(cuboid([0.6, 0.5, 0.2], [0.8, 0.7, 0.4], false, 0));
    triangles.extend(quad([[0.5, 0.5, 0.9], [0.5, 0.52, 0.9], [0.52, 0.52, 0.9], [0.52, 0.5, 0.9]], 1));
    scene(&triangles)
}

/// How honest a wanted error is: twenty seeds.
fn targets(name: &str, scene: &Scene, tracer: &Tracer, reference: &Solved) -> Result<()> {
    const TARGET: f64 = 0.02;
    let plan = Plan::default().with_error(Some(TARGET));
    let values = reference.patches.fronts() * reference.solution.channels;
    let areas = &reference.form_factors.areas()[..reference.patches.fronts()];
    let truth = &reference.solution.irradiance[..values];
    let (mut honest, mut worst, mut rays) = (0, 0f64, 0.0);
    for seed in 0..20 {
        let patches = Patches::subdivide(scene, &Subdivision::Count(PATCHES));
        let cast = CastOptions::default().with_seed(seed);
        let options = SolveOptions::default();
        let progress = Progress::new();
        let first = begin(scene, tracer, patches, &cast, &options, None, &progress)?;
        let next = |_: &Solved, rounds: &[Round]| Ok(plan.next(rounds));
        let (solved, rounds) = refine(scene, tracer, first, &options, next, &progress)?;
        let off: Vec<f64> = solved.solution.irradiance.iter().zip(truth).map(|(e, t)| e - t).collect();
        let actual = relative_rms(&off, truth, areas);
        honest += usize::from(actual <= 1.15 * TARGET);
        worst = worst.max(actual);
        rays += rounds.last().map_or(0.0, |round| round.rays) / 20.0;
    }
    println!(
        "| {name} | | {rays:.0}, for 2 % | worst of 20: {:.2} % | at most 2 % | {honest} of 20 at most 2.3 % |",
        100.0 * worst
    );
    Ok(())
}

fn row(name: &str, reference: &Solved, rays: f64, solve: impl Fn(u64) -> Result<Solved>) -> Result<()> {
    // Fronts come first, and are the same patches for every seed.
    let fronts = reference.patches.fronts();
    let values = fronts * reference.solution.channels;
    let areas = &reference.form_factors.areas()[..fronts];
    let truth = &reference.solution.irradiance[..values];
    let (mut actual, mut estimated, mut within, mut all) = (0.0, 0.0, 0, 0);
    for seed in 0..SEEDS {
        let solved = solve(seed)?;
        let errors = &solved.error_bars.standard_error[..values];
        let off: Vec<f64> = solved.solution.irradiance.iter().zip(truth).map(|(e, t)| e - t).collect();
        actual += relative_rms(&off, truth, areas).powi(2) / SEEDS as f64;
        estimated += relative_rms(errors, truth, areas).powi(2) / SEEDS as f64;
        // Where no light arrives at all, neither error nor bar says anything.
        let lit = off.iter().zip(errors).filter(|&(off, bar)| *off != 0.0 || *bar != 0.0);
        lit.for_each(|(off, bar)| {
            all += 1;
            within += usize::from(off.abs() <= T_QUANTILE * bar);
        });
    }
    println!(
        "| {name} | {} | {rays} | {:.2} % | {:.2} % | {:.1} % |",
        reference.patches.len(),
        100.0 * actual.sqrt(),
        100.0 * estimated.sqrt(),
        100.0 * within as f64 / f64::from(all as u32)
    );
    Ok(())
}
