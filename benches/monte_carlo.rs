//! Paths of the referee per second: `cargo bench --bench monte_carlo`.
//!
//! This measures speed, not efficiency: paths with next event estimation are slower, but far fewer are needed if lamps
//! are small.

mod scenes;

use divan::{Bencher, counter::ItemsCount};
use radiosity::{
    Progress, Scene,
    monte_carlo::{Effort, LightOptions, LightTracer, PathOptions, PathTracer, Receiver},
    trace::{Tracer, sampling::mix},
};
use scenes::{CORNELL, DOOR, Place, SPHERES_1E5};

const PLACES: [Place; 3] = [CORNELL, DOOR, SPHERES_1E5];
const RECEIVERS: u64 = 1024;
const PATHS_EACH: u32 = 64;
const PARTICLES: u64 = 1 << 16;

fn main() {
    divan::main();
}

#[divan::bench(args = PLACES, sample_count = 15, sample_size = 1)]
fn path_with_next_event(bencher: Bencher, place: Place) {
    paths(bencher, place, PathOptions::default());
}

#[divan::bench(args = PLACES, sample_count = 15, sample_size = 1)]
fn path_without_next_event(bencher: Bencher, place: Place) {
    paths(bencher, place, PathOptions::default().with_next_event(false));
}

#[divan::bench(args = PLACES, sample_count = 15, sample_size = 1)]
fn light(bencher: Bencher, place: Place) {
    let scene = (place.make)();
    let tracer = Tracer::new(&scene);
    let options = LightOptions::default().with_particles(PARTICLES);
    let light = LightTracer::new(&scene, &tracer, options);
    let bin = |hit: &radiosity::trace::Hit| Some(hit.triangle as usize % 64);
    bencher
        .counter(ItemsCount::new(PARTICLES))
        .bench_local(|| light.trace(64, bin, &Progress::new()).unwrap());
}

fn paths(bencher: Bencher, place: Place, options: PathOptions) {
    let scene = (place.make)();
    let tracer = Tracer::new(&scene);
    let paths = PathTracer::new(&scene, &tracer, options);
    let places = receivers(&scene, &tracer);
    let effort = Effort::default().with_samples(PATHS_EACH);
    bencher
        .counter(ItemsCount::new(RECEIVERS * u64::from(PATHS_EACH)))
        .bench_local(|| paths.irradiances(&places, &effort, &Progress::new()).unwrap());
}

/// The centroids of random triangles.
fn receivers(scene: &Scene, tracer: &Tracer) -> Vec<Receiver> {
    let triangles = scene.triangles.len() as u64;
    (0..RECEIVERS)
        .map(|i| Receiver::on_triangle(tracer, (mix(&[i]) % triangles) as usize, [1.0 / 3.0; 3], true))
        .collect()
}
