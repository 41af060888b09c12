//! Closest hits of hemisphere rays, in rays a second: `cargo bench --bench rays`.
//!
//! Each ray leaves a random point of the scene, so that no two in a row share a part of the hierarchy: what is measured
//! is the worst order. The program itself casts the rays of a patch together and is faster.

mod scenes;

use divan::{Bencher, counter::ItemsCount};
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
const PLACES: [Place; 5] = [CORNELL, SPHERES_1E5, WALLS_1E5, SPHERES_1E6, WALLS_1E6];

fn main() {
    divan::main();
}

#[divan::bench(args = PLACES, sample_count = 20, sample_size = 1)]
fn one_thread(bencher: Bencher, place: Place) {
    let (tracer, rays) = prepare(place);
    let hits = || rays.iter().filter(|(from, to)| tracer.closest(*from, *to).is_some()).count();
    bencher.counter(ItemsCount::new(RAYS)).bench_local(hits);
}

#[divan::bench(args = PLACES, sample_count = 20, sample_size = 1)]
fn all_threads(bencher: Bencher, place: Place) {
    let (tracer, rays) = prepare(place);
    let hits = || rays.par_iter().filter(|(from, to)| tracer.closest(*from, *to).is_some()).count();
    bencher.counter(ItemsCount::new(RAYS)).bench_local(hits);
}

/// Origins and directions.
fn prepare(place: Place) -> (Tracer, Vec<(Vec3A, Vec3A)>) {
    let scene = (place.make)();
    let tracer = Tracer::new(&scene);
    let mut below = 0.0;
    let areas_below: Vec<f64> = (0..scene.triangles.len())
        .map(|t| {
            below += scene.area(t);
            below
        })
        .collect();
    let rays = (0..RAYS).into_par_iter().map(|i| ray(&scene, &tracer, &areas_below, i)).collect();
    (tracer, rays)
}

/// A ray from a point uniform on all fronts, its direction cosine-distributed.
fn ray(scene: &Scene, tracer: &Tracer, areas_below: &[f64], index: u32) -> (Vec3A, Vec3A) {
    let total = areas_below[scene.triangles.len() - 1];
    let wanted = mix(&[u64::from(index)]) as f64 / u64::MAX as f64 * total;
    let t = areas_below.partition_point(|&a| a < wanted).min(scene.triangles.len() - 1);
    let triangle = &tracer.triangles()[t];
    let [x, y, u, v] = sobol_4d(index, 1);
    let from = Tracer::leave(triangle.point(square_to_triangle(x, y)), triangle.normal);
    (from, around(triangle.normal, square_to_cosine_hemisphere(u, v)))
}
