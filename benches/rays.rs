//! Closest hits of hemisphere rays, in millions per second, beside Embree's if that is installed:
//! `cargo bench --bench rays`. An argument selects the scenes whose names contain it.
//!
//! Each ray leaves a random point of the scene, so that successive rays share no part of the hierarchy: this measures
//! the worst order. The program itself casts the rays of a patch together and is faster. Our turns and Embree's
//! alternate, and the ratio is the median over the rounds, so that other load on the machine affects both. Our rays are
//! cast one by one, and in turns as the program casts the rays of a patch (`Tracer::closest_each`).

mod embree;
mod scenes;

use std::{
    hint::black_box,
    time::{Duration, Instant},
};

use embree::Embree;
use glam::Vec3A;
use radiosity::{
    Scene,
    trace::{
        Tracer,
        sampling::{around, mix, sobol_4d, square_to_cosine_hemisphere, square_to_triangle},
    },
};
use rayon::prelude::*;
use scenes::{CORNELL, Place, SPHERES_1E5, SPHERES_1E6, WALLS_1E5, WALLS_1E6};

const RAYS: u32 = 1 << 17;
const ROUNDS: usize = 15;
const PLACES: [Place; 5] = [CORNELL, SPHERES_1E5, WALLS_1E5, SPHERES_1E6, WALLS_1E6];

fn main() {
    // Cargo itself passes `--bench`.
    let wanted: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    println!(
        "| scene | triangles | built in, ms | threads | one by one, Mrays/s | in turns | Embree | one by one / Embree | quartiles | in turns / Embree | quartiles |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    for place in PLACES {
        if wanted.is_empty() || wanted.iter().any(|w| place.name.contains(w.as_str())) {
            measure(place);
        }
    }
}

fn measure(place: Place) {
    let (tracer, built_in, rays) = prepare(place);
    let embree = Embree::new(&tracer);
    if let Some(embree) = &embree {
        // Otherwise the two would do different work.
        let differ = |(from, to): &&(Vec3A, Vec3A)| {
            let (ours, theirs) = (tracer.closest(*from, *to), embree.closest(*from, *to));
            ours.is_some() != theirs.is_some()
                || ours.zip(theirs).is_some_and(|(a, b)| (a.t - b).abs() > 1e-3 * b)
        };
        let differing = rays.iter().filter(differ).count();
        assert!(differing < rays.len() / 1000, "{differing} rays end elsewhere in Embree");
    }
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start");
        let single = |rays: &[(Vec3A, Vec3A)]| {
            rays.iter().filter(|(from, to)| tracer.closest(*from, *to).is_some()).count()
        };
        let in_turns = |rays: &[(Vec3A, Vec3A)]| {
            let mut hits = 0;
            let named = rays.iter().map(|&(from, to)| ((), from, to));
            tracer.closest_each(named, |(), hit| hits += usize::from(hit.is_some()));
            hits
        };
        let theirs = |embree: &Embree| {
            time(&pool, &rays, |rays| {
                rays.iter().filter(|(from, to)| embree.closest(*from, *to).is_some()).count()
            })
        };
        let rounds: Vec<([f64; 2], Option<f64>)> = (0..ROUNDS)
            .map(|_| {
                ([time(&pool, &rays, single), time(&pool, &rays, in_turns)], embree.as_ref().map(theirs))
            })
            .collect();
        let rate = |seconds: f64| f64::from(RAYS) / seconds / 1e6;
        let [one, turns] = [0, 1].map(|k| quantile(rounds.iter().map(|r| rate(r.0[k])), 0.5));
        print!(
            "| {place} | {} | {:.1} | {threads} | {one:.2} | {turns:.2} | ",
            tracer.triangles().len(),
            1e3 * built_in.as_secs_f64()
        );
        if embree.is_none() {
            println!("not installed | | | | |");
            continue;
        }
        print!("{:.2} |", quantile(rounds.iter().filter_map(|r| r.1).map(rate), 0.5));
        for k in 0..2 {
            let ratios = || rounds.iter().filter_map(|r| Some(r.1? / r.0[k]));
            let [low, middle, high] = [0.25, 0.5, 0.75].map(|q| quantile(ratios(), q));
            print!(" {middle:.2} | {low:.2} to {high:.2} |");
        }
        println!();
    }
}

/// The seconds for all rays.
fn time(
    pool: &rayon::ThreadPool,
    rays: &[(Vec3A, Vec3A)],
    hits: impl Fn(&[(Vec3A, Vec3A)]) -> usize + Sync,
) -> f64 {
    pool.install(|| {
        let start = Instant::now();
        black_box(rays.par_chunks(1024).map(&hits).sum::<usize>());
        start.elapsed().as_secs_f64()
    })
}

fn quantile(values: impl Iterator<Item = f64>, q: f64) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted[((sorted.len() - 1) as f64 * q).round() as usize]
}

/// The tracer, the time to build it, and rays as origins and directions.
fn prepare(place: Place) -> (Tracer, Duration, Vec<(Vec3A, Vec3A)>) {
    let scene = (place.make)();
    let start = Instant::now();
    let tracer = Tracer::new(&scene);
    let built_in = start.elapsed();
    let mut below = 0.0;
    let areas_below: Vec<f64> = (0..scene.triangles.len())
        .map(|t| {
            below += scene.area(t);
            below
        })
        .collect();
    let rays = (0..RAYS).into_par_iter().map(|i| ray(&scene, &tracer, &areas_below, i)).collect();
    (tracer, built_in, rays)
}

/// A ray from a uniformly random point of all fronts, with a cosine-distributed direction.
fn ray(scene: &Scene, tracer: &Tracer, areas_below: &[f64], index: u32) -> (Vec3A, Vec3A) {
    let total = areas_below[scene.triangles.len() - 1];
    let wanted = mix(&[u64::from(index)]) as f64 / u64::MAX as f64 * total;
    let t = areas_below.partition_point(|&a| a < wanted).min(scene.triangles.len() - 1);
    let triangle = &tracer.triangles()[t];
    let [x, y, u, v] = sobol_4d(index, 1);
    let from = triangle.side(true).leave(triangle.point(square_to_triangle(x, y)));
    (from, around(triangle.normal, square_to_cosine_hemisphere(u, v)))
}
