//! Path tracing, light tracing and radiosity with equal time: which one when? Prints a Markdown table of errors.
//!
//!     cargo bench --bench which_one_when -- [SECONDS A CELL] [PATCHES OF THE RADIOSITY SOLUTION]
//!
//! Each method first runs briefly to find how many samples, particles or rays fit into the time. The time to build the
//! ray tracer is not counted, everything else is.
//!
//! The truth r is known only from two independent references with five times the time each. The mean of
//! (x - r1)(x - r2) is free of their noise in expectation. Its root is the printed error of x.

use std::{cell::RefCell, time::Instant};

use glam::{DVec3, Vec3A, dvec3};
use radiosity::{
    Progress, Result, Scene,
    accuracy::validation::{ValidationOptions, averaged, light_traced},
    form_factor::{CastOptions, FormFactors},
    monte_carlo::{
        Camera, Effort, Estimate, Film, LightOptions, LightTracer, PathOptions, PathTracer, Region,
        RenderOptions,
    },
    output::picture,
    patch::{Patches, Subdivision},
    scene::Material,
    solve::{Solution, SolveOptions, solve},
    trace::Tracer,
};

/// Side of the picture in pixels.
const SIDE: usize = 64;
/// The least number of patches whose irradiance is compared.
const ASKED: usize = 500;
/// Hemisphere rays per sample of the final gather.
const GATHER: u32 = 8;

fn main() -> Result<()> {
    let words: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    let argument = |i: usize| words.get(i).and_then(|word| word.parse::<f64>().ok());
    let budget = argument(0).unwrap_or(2.0);
    let solved_patches = argument(1).unwrap_or(8000.0) as usize;
    let door = Scene::load(concat!(env!("CARGO_MANIFEST_DIR"), "/meshes/door-ajar.obj"))?;
    let in_room = (dvec3(0.3, 1.9, 3.7), dvec3(2.3, 0.7, 1.5));
    let lightings = [
        ("one large lamp", room(1, 2.0), in_room),
        ("one small lamp", room(1, 0.04), in_room),
        ("64 small lamps", room(8, 0.04), in_room),
        ("door ajar", door, (dvec3(5.7, 1.7, 3.7), dvec3(3.6, 0.9, 1.4))),
    ];
    println!("| lighting | task | path | path without next event | light | radiosity | with gather |");
    println!("|---|---|---:|---:|---:|---:|---:|");
    let mut notes = Vec::new();
    for (name, scene, (eye, look_at)) in &lightings {
        let camera = Camera::new(*eye, *look_at, DVec3::Y, 60.0, SIDE, SIDE)?;
        notes.push(Contest::new(scene, camera, budget, solved_patches).run(name)?);
    }
    println!("\n{}", notes.join("\n"));
    Ok(())
}

/// A closed room of 4 × 3 × 4 with a table top and a chest in it, and `n` × `n` square lamps flush in the ceiling.
fn room(n: usize, side: f64) -> Scene {
    let names = [("wall", 0.7, 0.68, 0.62), ("floor", 0.4, 0.3, 0.2), ("table", 0.5, 0.35, 0.2)];
    let mut materials: Vec<Material> =
        names.iter().map(|&(name, r, g, b)| Material::new(name, [r, g, b], [0.0; 3])).collect();
    materials.push(Material::new("lamp", [0.5; 3], [100.0, 95.0, 85.0]));
    let mut triangles = Vec::new();
    // Corners run counter-clockwise as seen from the front.
    let mut quad = |[a, b, c, d]: [DVec3; 4], material: u32| {
        triangles.extend([([a, b, c], material), ([a, c, d], material)]);
    };
    let mut sides = |low: DVec3, high: DVec3, inwards: bool, faces: &[(usize, bool)], material: u32| {
        for &(axis, at_high) in faces {
            let mut normal_corner = low;
            normal_corner[axis] = if at_high { high[axis] } else { low[axis] };
            let (mut u, mut v) = (DVec3::ZERO, DVec3::ZERO);
            u[(axis + 1) % 3] = high[(axis + 1) % 3] - low[(axis + 1) % 3];
            v[(axis + 2) % 3] = high[(axis + 2) % 3] - low[(axis + 2) % 3];
            let (u, v) = if at_high == inwards { (v, u) } else { (u, v) };
            let a = normal_corner;
            quad([a, a + u, a + u + v, a + v], material);
        }
    };
    let all = [(0, false), (0, true), (1, false), (1, true), (2, false), (2, true)];
    let (low, high) = (DVec3::ZERO, dvec3(4.0, 3.0, 4.0));
    sides(low, high, true, &[all[0], all[1], all[4], all[5]], 0);
    sides(low, high, true, &[all[2]], 1);
    sides(dvec3(1.2, 0.70, 1.0), dvec3(2.8, 0.75, 1.9), false, &all, 2);
    sides(dvec3(2.9, 0.05, 2.6), dvec3(3.7, 1.00, 3.5), false, &all, 2);
    let pitch = 4.0 / n as f64;
    let cuts: Vec<f64> = std::iter::once(0.0)
        .chain((0..n).flat_map(|k| [-0.5, 0.5].map(|s| (k as f64 + 0.5) * pitch + s * side)))
        .chain([4.0])
        .collect();
    for (i, z) in cuts.windows(2).enumerate() {
        // Between rows of lamps a strip of ceiling spans from wall to wall.
        let columns = if i % 2 == 1 { &cuts[..] } else { &[0.0, 4.0] };
        for (k, x) in columns.windows(2).enumerate() {
            let lamp = i % 2 == 1 && k % 2 == 1;
            let (low, high) = (dvec3(x[0], 0.0, z[0]), dvec3(x[1], 3.0, z[1]));
            sides(low, high, true, &[all[3]], if lamp { 3 } else { 0 });
        }
    }
    Scene::new(&triangles, materials)
}

/// All methods on one scene.
struct Contest<'a> {
    scene: &'a Scene,
    tracer: Tracer,
    camera: Camera,
    budget: f64,
    solved_patches: usize,
    /// The patches whose irradiance is compared.
    asked: Patches,
    areas: Vec<f64>,
    progress: Progress,
    /// The ratio of used to allowed time, for every run.
    taken: RefCell<Vec<f64>>,
}

impl<'a> Contest<'a> {
    fn new(scene: &'a Scene, camera: Camera, budget: f64, solved_patches: usize) -> Self {
        let asked = Patches::subdivide(scene, &Subdivision::Count(ASKED));
        let areas = (0..asked.fronts()).map(|i| asked.area(i)).collect();
        let (tracer, progress) = (Tracer::new(scene), Progress::new());
        let taken = RefCell::default();
        Contest { scene, tracer, camera, budget, solved_patches, asked, areas, progress, taken }
    }

    /// Prints two rows of the table. Returns further remarks.
    fn run(&self, name: &str) -> Result<String> {
        let t = self.budget;
        let truth = [self.path_irradiance(true, 5.0 * t, 1001)?, self.light_irradiance(5.0 * t, 1002)?];
        let error = |found: &[f64]| percent(relative_error(found, &truth, &self.areas));
        let path = error(&self.path_irradiance(true, t, 1)?);
        let plain = error(&self.path_irradiance(false, t, 1)?);
        let light = error(&self.light_irradiance(t, 1)?);
        let (patches, solution) = self.solved(t)?;
        let solved = error(&averaged(&self.asked, &patches, &solution.irradiance));
        println!("| {name} | irradiance | {path} | {plain} | {light} | {solved} | |");

        let truth = [self.path_image(true, 5.0 * t, 1001)?, self.path_image(true, 5.0 * t, 1002)?];
        let weights = self.weights();
        let error = |found: &[f64]| percent(relative_error(found, &truth, &weights));
        let path = error(&self.path_image(true, t, 1)?);
        let black = self.path_image(false, t, 1)?;
        let plain = error(&black);
        let light = error(&self.light_image(t)?);
        let smooth = error(&self.solved_image(None)?);
        let gather = error(&self.solved_image(Some(GATHER))?);
        println!("| {name} | image | {path} | {plain} | {light} | {smooth} | {gather} |");

        let dark = black.as_chunks::<3>().0.iter().filter(|p| **p == [0.0; 3]).count();
        let taken = self.taken.borrow();
        Ok(format!(
            "- {name}: {} patches compared, {} solved; without next event {} of the pixels stay black; runs took \
             {:.2} to {:.2} of their time.",
            self.asked.fronts(),
            patches.fronts(),
            percent(dark as f64 / (SIDE * SIDE) as f64),
            taken.iter().copied().fold(f64::INFINITY, f64::min),
            taken.iter().copied().fold(0.0, f64::max),
        ))
    }

    /// Runs with the amount of work that takes about `seconds`, extrapolated from the last two trials.
    fn timed<T>(&self, seconds: f64, run: impl Fn(u64) -> Result<T>) -> Result<T> {
        let clocked = |work: f64| -> Result<(T, f64)> {
            let start = Instant::now();
            let result = run(work.max(1.0) as u64)?;
            Ok((result, start.elapsed().as_secs_f64()))
        };
        let (mut work, mut before) = (32.0, (0.0, 0.0));
        loop {
            let (_, took) = clocked(work)?;
            let each = ((took - before.1) / (work - before.0)).max(0.5 * took / work);
            if took > 0.1 * seconds {
                let (result, took) = clocked(work + (seconds - took) / each)?;
                self.taken.borrow_mut().push(took / seconds);
                return Ok(result);
            }
            before = (work, took);
            work *= 4.0;
        }
    }

    fn path_irradiance(&self, next_event: bool, seconds: f64, seed: u64) -> Result<Vec<f64>> {
        let region = |i| Region {
            triangle: self.asked.triangle(i),
            part: self.asked.barycentric_corners(i),
            front: true,
        };
        let regions: Vec<Region> = (0..self.asked.fronts()).map(region).collect();
        let options = PathOptions::default().with_next_event(next_event);
        let found = self.timed(seconds, |samples| {
            let effort = Effort::default().with_samples(samples as u32).with_seed(seed);
            PathTracer::new(self.scene, &self.tracer, options).mean_irradiances(
                &regions,
                &effort,
                &self.progress,
            )
        })?;
        Ok(found.iter().flat_map(|e: &Estimate| e.mean).collect())
    }

    fn light_irradiance(&self, seconds: f64, seed: u64) -> Result<Vec<f64>> {
        let found = self.timed(seconds, |particles| {
            let options = ValidationOptions::default().with_particles(particles).with_seed(seed);
            light_traced(self.scene, &self.tracer, &self.asked, &options, &self.progress)
        })?;
        Ok(found.irradiance)
    }

    /// A solution of `solved_patches` patches with the number of rays that fits into the time.
    fn solved(&self, seconds: f64) -> Result<(Patches, Solution)> {
        self.timed(seconds, |rays| {
            let subdivision = Subdivision::Count(self.solved_patches.max(ASKED));
            let mut patches = Patches::subdivide(self.scene, &subdivision);
            let options = CastOptions::default().with_rays(rays as f64);
            let matrix = FormFactors::cast(self.scene, &self.tracer, &mut patches, &options, &self.progress)?;
            let solution = solve(&matrix, &patches, &SolveOptions::default(), &self.progress)?;
            Ok((patches, solution))
        })
    }

    fn path_image(&self, next_event: bool, seconds: f64, seed: u64) -> Result<Vec<f64>> {
        let paths =
            PathTracer::new(self.scene, &self.tracer, PathOptions::default().with_next_event(next_event));
        Ok(values(&self.timed(seconds, |samples| {
            let options = RenderOptions::default().with_samples(samples as u32).with_seed(seed);
            Film::render(&paths, &self.camera, &options, &self.progress)
        })?))
    }

    fn light_image(&self, seconds: f64) -> Result<Vec<f64>> {
        Ok(values(&self.timed(seconds, |particles| {
            let options = LightOptions::default().with_particles(particles);
            let image = LightTracer::new(self.scene, &self.tracer, options);
            Ok(image.image(&self.camera, &self.progress)?.film)
        })?))
    }

    /// A picture of a solution. Without a gather nine tenths of the time go to the solution, with one half of it.
    fn solved_image(&self, gather: Option<u32>) -> Result<Vec<f64>> {
        let share = if gather.is_some() { 0.5 } else { 0.9 };
        let (patches, solution) = self.solved(share * self.budget)?;
        let film = self.timed((1.0 - share) * self.budget, |samples| {
            let options = RenderOptions::default().with_samples(samples as u32).with_seed(1);
            let solved = (&patches, &solution);
            picture::render(self.scene, &self.tracer, solved, &self.camera, gather, &options, &self.progress)
        })?;
        Ok(values(&film))
    }

    /// 1 for a pixel that shows no lamp, otherwise 0.
    fn weights(&self) -> Vec<f64> {
        let lens = self.camera.lens(&self.tracer);
        let shines = |direction: Vec3A| {
            let hit = self.tracer.closest(lens.eye(), direction);
            hit.is_some_and(|hit| hit.front && self.scene.emits(hit.triangle as usize))
        };
        let place = |cell: usize, k: usize| cell as f64 + (k as f64 + 0.5) / 16.0;
        let free = |i: usize| {
            (0..256).all(|k| !shines(lens.direction(place(i % SIDE, k % 16), place(i / SIDE, k / 16))))
        };
        (0..SIDE * SIDE).map(|i| f64::from(u8::from(free(i)))).collect()
    }
}

/// Weighted RMS error of three channels relative to the mean, from two independent references.
fn relative_error(found: &[f64], truth: &[Vec<f64>; 2], weights: &[f64]) -> f64 {
    let (mut squares, mut mean, mut total) = (0.0, 0.0, 0.0);
    for (q, x) in found.iter().enumerate() {
        let weight = weights[q / 3];
        squares += weight * (x - truth[0][q]) * (x - truth[1][q]);
        mean += weight * 0.5 * (truth[0][q] + truth[1][q]);
        total += weight;
    }
    (squares.max(0.0) / total).sqrt() / (mean / total)
}

fn values(film: &Film) -> Vec<f64> {
    film.pixels().iter().flatten().map(|&x| f64::from(x)).collect()
}

/// Two significant digits.
fn percent(x: f64) -> String {
    let x = 100.0 * x;
    match x {
        x if x >= 10.0 || x == 0.0 => format!("{x:.0} %"),
        x if x >= 1.0 => format!("{x:.1} %"),
        x if x >= 0.1 => format!("{x:.2} %"),
        x => format!("{x:.3} %"),
    }
}
