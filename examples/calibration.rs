//! Whether error bars are as long as errors: the same patches solved with many seeds, against the same solved with many
//! rays. Prints a Markdown table.
//!
//!     cargo run --release --example calibration -- [SCENE.obj ...]

use std::path::PathBuf;

use radiosity::{
    Progress, Result, Scene,
    accuracy::{
        error_bars::{T_QUANTILE, relative_rms},
        validation::Solved,
    },
    form_factor::CastOptions,
    patch::Subdivision,
    solve::SolveOptions,
    trace::Tracer,
};

const PATCHES: usize = 1000;
const SEEDS: u64 = 8;
/// The reference has 8 to 128 times the rays: what it adds to the variance of a difference is that much smaller.
const REFERENCE_RAYS: f64 = 8192.0;

fn main() -> Result<()> {
    let mut scenes: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    if scenes.is_empty() {
        let own = |name| [env!("CARGO_MANIFEST_DIR"), "meshes", name].iter().collect();
        scenes = ["cornell-box.obj", "textured.obj", "door-ajar.obj"].map(own).into();
    }
    println!("| scene | patches | rays a patch | RMS error | as estimated | within 95 % intervals |");
    println!("|---|---|---|---|---|---|");
    for path in scenes {
        let scene = Scene::load(&path)?;
        let tracer = Tracer::new(&scene);
        let solve = |rays: f64, seed: u64| {
            let cast = CastOptions { rays, seed, ..CastOptions::default() };
            let count = Subdivision::Count(PATCHES);
            Solved::new(&scene, &tracer, &count, &cast, &SolveOptions::default(), &Progress::new())
        };
        let reference = solve(REFERENCE_RAYS, 1_000_000)?;
        for rays in [64.0, 256.0, 1024.0] {
            row(&path, &reference, rays, |seed| solve(rays, seed))?;
        }
    }
    Ok(())
}

fn row(
    path: &std::path::Path,
    reference: &Solved,
    rays: f64,
    solve: impl Fn(u64) -> Result<Solved>,
) -> Result<()> {
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
        "| {} | {} | {rays} | {:.2} % | {:.2} % | {:.1} % |",
        path.file_name().unwrap_or_default().display(),
        reference.patches.len(),
        100.0 * actual.sqrt(),
        100.0 * estimated.sqrt(),
        100.0 * within as f64 / f64::from(all as u32)
    );
    Ok(())
}
