//! Compares patches that are small where light varies with patches of one size: error of irradiance over about 500
//! patches against path tracing.
//!
//!     cargo bench --bench adaptive_patches -- [SCENE.obj …]
//!
//! Two solutions x1, x2 and two references r1, r2 with different seeds give the error that remains with many rays: the
//! mean of (x1 - r1)(x2 - r2) is free of their noise. Solutions of the same patches with many rays check the error
//! bars.

use std::time::Instant;

use radiosity::{
    Progress, Result, Scene,
    accuracy::{
        adaptive::finer,
        error_bars::{T_QUANTILE, relative_rms},
        solved::Solved,
        validation::averaged,
    },
    form_factor::CastOptions,
    monte_carlo::{Effort, PathOptions, PathTracer, Region},
    patch::{Patches, Subdivision},
    solve::SolveOptions,
    trace::Tracer,
};

/// The number of patches over which errors are averaged.
const COMMON: usize = 500;
/// Paths per patch of each reference, and rays per patch of the solutions.
const PATHS: u32 = 16_384;
const RAYS: f64 = 256.0;
/// Rays per patch of the solution that shows where light varies.
const PILOT: f64 = 64.0;
/// Rays per patch of the reference for error bars, and the number of solutions compared with it.
const MANY: f64 = 8192.0;
const SEEDS: u64 = 4;

struct Lab {
    scene: Scene,
    tracer: Tracer,
    common: Patches,
    truth: [Vec<f64>; 2],
}

impl Lab {
    fn new(file: &str) -> Result<Lab> {
        let scene = Scene::load(file)?;
        let tracer = Tracer::new(&scene);
        let common = Patches::subdivide(&scene, &Subdivision::Count(COMMON));
        let region =
            |i| Region { triangle: common.triangle(i), part: common.barycentric_corners(i), front: true };
        let regions: Vec<Region> = (0..common.len()).map(region).collect();
        let traced = |seed| -> Result<Vec<f64>> {
            let effort = Effort::default().with_samples(PATHS).with_seed(seed);
            let paths = PathTracer::new(&scene, &tracer, PathOptions::default());
            let found = paths.mean_irradiances(&regions, &effort, &Progress::new())?;
            Ok(found.iter().flat_map(|e| e.mean.into_iter().take(common.channels())).collect())
        };
        let truth = [traced(1)?, traced(2)?];
        Ok(Lab { scene, tracer, common, truth })
    }

    fn solved(&self, patches: &Patches, rays: f64, seed: u64) -> Result<Solved> {
        let cast = CastOptions::default().with_rays(rays).with_seed(seed);
        let (options, progress) = (SolveOptions::default(), Progress::new());
        Solved::of_patches(&self.scene, &self.tracer, patches.clone(), &cast, &options, &progress)
    }

    /// Irradiance of the common patches.
    fn averaged(&self, solved: &Solved) -> Vec<f64> {
        averaged(&self.common, &solved.patches, &solved.solution.irradiance)
    }

    /// RMS error relative to the mean: of one solution, or without its sampling error if two are given.
    fn error(&self, first: &[f64], second: &[f64]) -> f64 {
        let ([one, two], channels) = (&self.truth, self.common.channels());
        let (mut squares, mut mean, mut weight) = (0.0, 0.0, 0.0);
        for q in 0..one.len() {
            let area = self.common.area(q / channels);
            let crossed =
                (first[q] - one[q]) * (second[q] - two[q]) + (first[q] - two[q]) * (second[q] - one[q]);
            squares += area * 0.5 * crossed;
            mean += area * 0.5 * (one[q] + two[q]);
            weight += area;
        }
        (squares * weight).max(0.0).sqrt() / mean
    }

    fn row(&self, name: &str, patches: &Patches) -> Result<()> {
        let start = Instant::now();
        let solved = self.solved(patches, RAYS, 11)?;
        let seconds = start.elapsed().as_secs_f64();
        let (one, two) = (self.averaged(&solved), self.averaged(&self.solved(patches, RAYS, 12)?));
        let (whole, floor) = (100.0 * self.error(&one, &one), 100.0 * self.error(&one, &two));
        println!("| {name} | {} | {floor:.2} % | {whole:.2} % | {seconds:.2} s |", patches.fronts());
        Ok(())
    }

    /// Prints estimated and actual sampling errors.
    fn error_bars(&self, patches: &Patches, rays: f64) -> Result<()> {
        let truth = self.solved(patches, MANY, 1000)?;
        let values = patches.fronts() * truth.solution.channels;
        let (areas, truth) =
            (&truth.form_factors.areas()[..patches.fronts()], &truth.solution.irradiance[..values]);
        let (mut actual, mut estimated, mut within) = (0.0, 0.0, 0.0);
        for seed in 0..SEEDS {
            let solved = self.solved(patches, rays, seed)?;
            let bars = &solved.error_bars.standard_error[..values];
            let off: Vec<f64> = solved.solution.irradiance.iter().zip(truth).map(|(e, t)| e - t).collect();
            let many = SEEDS as f64;
            actual += relative_rms(&off, truth, areas).powi(2) / many;
            estimated += relative_rms(bars, truth, areas).powi(2) / many;
            let inside = off.iter().zip(bars).filter(|(off, bar)| off.abs() <= T_QUANTILE * *bar).count();
            within += inside as f64 / values as f64 / many;
        }
        println!(
            "{} patches, {rays} rays: sampling error {:.2} %, estimated {:.2} %, {:.1} % within 95 % intervals",
            patches.fronts(),
            100.0 * actual.sqrt(),
            100.0 * estimated.sqrt(),
            100.0 * within
        );
        Ok(())
    }
}

fn main() -> Result<()> {
    let mut files: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    if files.is_empty() {
        files = ["cornell-box", "door-ajar", "textured"].map(|name| format!("meshes/{name}.obj")).into();
    }
    for file in &files {
        let lab = Lab::new(file)?;
        println!(
            "\n{file}\n\n| patches | number | floor | error at {RAYS} rays | time |\n|---|---|---|---|---|"
        );
        for count in [1000, 4000, 16000] {
            lab.row("of one size", &Patches::subdivide(&lab.scene, &Subdivision::Count(count)))?;
        }
        let mut patches = Patches::subdivide(&lab.scene, &Subdivision::Count(COMMON));
        let mut shown = Vec::new();
        for step in 0..3 {
            let Solved { patches: solved, solution, .. } = lab.solved(&patches, PILOT, step)?;
            patches = finer(&lab.scene, &solved, &solution, 2.0);
            lab.row("by the light", &patches)?;
            shown.push(patches.clone());
        }
        for (patches, rays) in [(&shown[0], 64.0), (&shown[0], RAYS), (&shown[2], 64.0)] {
            lab.error_bars(patches, rays)?;
        }
    }
    Ok(())
}
