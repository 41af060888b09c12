//! Compares errors with error bars on the scenes by which the estimators were chosen. Solves the same patches with
//! several seeds, and once with many rays as the reference. Prints a Markdown table.
//!
//!     cargo bench --bench calibration -- [PART OF A SCENE'S NAME | SCENE.obj | --targets] ...
//!
//! With `--targets`, it also counts how often a wanted error of 2 % is reached.

#[path = "calibration/scenes.rs"]
mod scenes;

use radiosity::{
    Progress, Result, Scene,
    accuracy::{
        error_bars::{T_QUANTILE, relative_rms},
        refinement::{Plan, Round, begin, refine},
        solved::Solved,
    },
    energy::EnergyLedger,
    form_factor::CastOptions,
    patch::{Patches, Subdivision},
    solve::SolveOptions,
    trace::Tracer,
};

const PATCHES: usize = 1000;
/// Rays per patch, and the number of seeds for each.
const RAYS: [(f64, u64); 3] = [(64.0, 8), (256.0, 6), (1024.0, 4)];
/// The reference has 8 to 128 times the rays, so its part of the variance of a difference is that much smaller.
const REFERENCE_RAYS: f64 = 8192.0;

fn main() -> Result<()> {
    let words: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    let (targets, words): (Vec<String>, Vec<String>) =
        words.into_iter().partition(|word| word == "--targets");
    let (files, names): (Vec<String>, Vec<String>) =
        words.into_iter().partition(|word| word.ends_with(".obj"));
    let mut chosen = Vec::new();
    if files.is_empty() {
        chosen = scenes::all()?;
        chosen.retain(|(name, _)| names.is_empty() || names.iter().any(|part| name.contains(&**part)));
    }
    for path in files {
        chosen.push((path.clone(), Scene::load(&path)?));
    }
    println!(
        "| scene | patches | rays per patch | RMS error | estimated | within 95 % intervals | error of mean | error of escaped |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for (name, scene) in chosen {
        let tracer = Tracer::new(&scene);
        let solve = |rays: f64, seed: u64| {
            let cast = CastOptions::default().with_rays(rays).with_seed(seed);
            let count = Subdivision::Count(PATCHES);
            Solved::new(&scene, &tracer, &count, &cast, &SolveOptions::default(), &Progress::new())
        };
        let reference = solve(REFERENCE_RAYS, 1_000_000)?;
        for (rays, seeds) in RAYS {
            row(&name, &reference, (rays, seeds), |seed| solve(rays, seed))?;
        }
        if !targets.is_empty() {
            honesty(&name, &scene, &tracer, &reference)?;
        }
    }
    Ok(())
}

/// Prints errors and error bars with the given number of rays per patch, averaged over the given number of seeds.
fn row(
    name: &str,
    reference: &Solved,
    (rays, seeds): (f64, u64),
    solve: impl Fn(u64) -> Result<Solved>,
) -> Result<()> {
    // Fronts come first and are the same patches for every seed.
    let fronts = reference.patches.fronts();
    let values = fronts * reference.solution.channels;
    let areas = &reference.form_factors.areas()[..fronts];
    let truth = &reference.solution.irradiance[..values];
    let mean = |light: &[f64]| {
        let channels = reference.solution.channels;
        (0..values).map(|q| areas[q / channels] * light[q]).sum::<f64>()
    };
    let (mut actual, mut estimated, mut within, mut all) = (0.0, 0.0, 0, 0);
    let (mut means, mut escapes) = (Vec::new(), Vec::new());
    for seed in 0..seeds {
        let solved = solve(seed)?;
        let errors = &solved.error_bars.standard_error[..values];
        let off: Vec<f64> = solved.solution.irradiance.iter().zip(truth).map(|(e, t)| e - t).collect();
        actual += relative_rms(&off, truth, areas).powi(2) / seeds as f64;
        estimated += relative_rms(errors, truth, areas).powi(2) / seeds as f64;
        // Patches without any light have neither an error nor an error bar.
        let lit = off.iter().zip(errors).filter(|&(off, bar)| *off != 0.0 || *bar != 0.0);
        lit.for_each(|(off, bar)| {
            all += 1;
            within += usize::from(off.abs() <= T_QUANTILE * bar);
        });
        means.push(mean(&solved.solution.irradiance) / mean(truth) - 1.0);
        escapes.push(escaped(&solved) / escaped(reference) - 1.0);
    }
    println!(
        "| {name} | {} | {rays} | {:.2} % | {:.2} % | {:.1} % | {} | {} |",
        reference.patches.len(),
        100.0 * actual.sqrt(),
        100.0 * estimated.sqrt(),
        100.0 * f64::from(within as u32) / f64::from(all as u32),
        mean_and_error(&means),
        mean_and_error(&escapes),
    );
    Ok(())
}

/// The power that escapes, all channels together.
fn escaped(solved: &Solved) -> f64 {
    EnergyLedger::of(&solved.form_factors, &solved.patches, &solved.solution).escaped.iter().sum()
}

fn mean_and_error(values: &[f64]) -> String {
    let many = values.len() as f64;
    let mean = values.iter().sum::<f64>() / many;
    let squares: f64 = values.iter().map(|x| (x - mean).powi(2)).sum();
    if !mean.is_finite() {
        return String::new();
    }
    format!("{:+.2} ± {:.2} %", 100.0 * mean, 100.0 * (squares / (many * (many - 1.0))).sqrt())
}

/// Counts how often a wanted error is reached, over twenty seeds.
fn honesty(name: &str, scene: &Scene, tracer: &Tracer, reference: &Solved) -> Result<()> {
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
        "| {name} | | {rays:.0}, for 2 % | worst of 20: {:.2} % | at most 2 % | {honest} of 20 at most 2.3 % | | |",
        100.0 * worst
    );
    Ok(())
}
