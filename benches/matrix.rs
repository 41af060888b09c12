//! The product of the form factors with three channels of radiosity, against plain reading and copying of equally many
//! bytes: `cargo bench --bench matrix`.
//!
//! Every solver spends its time in this product, and memory bandwidth limits it. The three take turns in one run. The
//! figure to look at is the ratio, which hardly depends on other load on the machine. Pairs are the stored ones, each
//! of which serves both of its patches.

mod scenes;

use std::{hint::black_box, time::Instant};

use radiosity::{
    Progress,
    form_factor::{CastOptions, FormFactors},
    patch::{Patches, Subdivision},
    trace::Tracer,
};
use rayon::prelude::*;

const ROUNDS: usize = 40;

fn main() {
    println!(
        "patches   non-zeros      bytes  a pair  1e9 pairs/s  product GB/s  read GB/s  copy GB/s  product/read  product/copy"
    );
    for patches in [1_000, 3_840, 10_000, 100_000] {
        measure(patches);
    }
}

fn measure(count: usize) {
    let scene = (scenes::CORNELL.make)();
    let tracer = Tracer::new(&scene);
    let mut patches = Patches::subdivide(&scene, &Subdivision::Count(count));
    let options = CastOptions::default();
    let form_factors = FormFactors::cast(&scene, &tracer, &mut patches, &options, &Progress::new()).unwrap();
    let n = form_factors.len();
    let radiosity: Vec<f64> = (0..3 * n).map(|i| 1.0 + (i % 7) as f64).collect();
    // The minimum: the matrix once, and per patch two scale factors and three channels in and out.
    let bytes = form_factors.matrix_bytes() + n * (16 + 2 * 24);
    let from = vec![1u64; bytes / 8];
    let mut to = vec![0u64; bytes / 8];

    let mut seconds = [const { Vec::new() }; 3];
    for _ in 0..ROUNDS {
        seconds[0].push(time(|| form_factors.irradiance(&radiosity, 3)));
        seconds[1].push(time(|| from.par_chunks(CHUNK).map(|c| c.iter().sum::<u64>()).sum::<u64>()));
        seconds[2].push(time(|| {
            to.par_chunks_mut(CHUNK)
                .zip(from.par_chunks(CHUNK))
                .for_each(|(to, from)| to.copy_from_slice(from));
            to[0]
        }));
    }
    // A copy moves each byte twice.
    let rate = |k: usize, moved: usize| moved as f64 / median(&seconds[k]) / 1e9;
    let [product, read, copy] = [rate(0, bytes), rate(1, bytes), rate(2, 2 * bytes)];
    println!(
        "{n:7}  {:10}  {bytes:9}  {:6.2}  {:11.2}  {product:12.2}  {read:9.2}  {copy:9.2}  {:12.2}  {:12.2}",
        form_factors.non_zeros(),
        form_factors.matrix_bytes() as f64 / (0.5 * form_factors.non_zeros() as f64),
        0.5 * form_factors.non_zeros() as f64 / median(&seconds[0]) / 1e9,
        product / read,
        product / copy
    );
}

/// Long enough that starting a task costs nothing, short enough that all threads end together.
const CHUNK: usize = 1 << 14;

fn time<T>(work: impl FnOnce() -> T) -> f64 {
    let start = Instant::now();
    black_box(work());
    start.elapsed().as_secs_f64()
}

fn median(seconds: &[f64]) -> f64 {
    let mut sorted = seconds.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}
