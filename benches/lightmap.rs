//! Time and memory of lightmaps against the number of texels: `cargo bench --bench lightmap`.
//!
//! Each size runs in its own process, whose peak memory is that of this size. From 256 to 1024 texels per side both may
//! grow at most a third faster than the number of texels.

mod scenes;

use std::{process::Command, time::Instant};

use radiosity::{
    Progress,
    form_factor::{CastOptions, FormFactors},
    lightmap::{Atlas, BakeOptions, Coordinates, Layout, bake},
    output::report::peak_bytes,
    patch::{Patches, Subdivision},
    solve::{SolveOptions, solve},
    trace::Tracer,
};
use scenes::CORNELL;

const SIDES: [usize; 4] = [128, 256, 512, 1024];
const RAYS: u32 = 16;
const MIB: f64 = (1 << 20) as f64;
/// This environment variable gives a new process the index of its task in [`SIDES`].
const TASK: &str = "RADIOSITY_BENCH_TASK";

fn main() {
    if let Ok(task) = std::env::var(TASK) {
        return run(SIDES[task.parse::<usize>().expect("a number")]);
    }
    println!(
        "{RAYS} rays per texel, all steps; {CORNELL}; peak of the process in MiB, and the map's part of it"
    );
    println!("texels per side covered  seconds  million texels/s   peak  the map's");
    let figures: Vec<[f64; 2]> = (0..SIDES.len())
        .map(|task| {
            let program = std::env::current_exe().expect("a running program has a name");
            let output = Command::new(program).env(TASK, task.to_string()).output().expect("it starts again");
            assert!(output.status.success(), "{} texels a side failed", SIDES[task]);
            let text = String::from_utf8(output.stdout).expect("it prints text");
            print!("{text}");
            let number =
                |k: usize| text.split_whitespace().nth(k).and_then(|w| w.parse().ok()).unwrap_or(f64::NAN);
            [number(2), number(5)]
        })
        .collect();
    let growth = (SIDES[3] / SIDES[1]).pow(2) as f64 * 4.0 / 3.0;
    for (k, what) in ["time", "memory"].iter().enumerate() {
        let found = figures[3][k] / figures[1][k];
        assert!(!(found > growth), "{what} grew {found:.1} times");
    }
}

fn run(side: usize) {
    let progress = Progress::new();
    let scene = (CORNELL.make)();
    let tracer = Tracer::new(&scene);
    let mut patches = Patches::subdivide(&scene, &Subdivision::Count(1000));
    let form_factors =
        FormFactors::cast(&scene, &tracer, &mut patches, &CastOptions::default(), &progress).unwrap();
    let solution = solve(&form_factors, &patches, &SolveOptions::default(), &progress).unwrap();
    let before = peak_bytes();
    let start = Instant::now();
    let atlas = Atlas::new(&scene, &tracer, Layout::Resolution(side), Coordinates::Auto).unwrap();
    let options = BakeOptions::default().with_final_gather(RAYS);
    let map = bake(&scene, &tracer, (&patches, &solution), atlas, &options, &progress).unwrap();
    let seconds = start.elapsed().as_secs_f64();
    let (covered, peak) = (map.coverage().len(), peak_bytes());
    let mib = |bytes: Option<u64>| bytes.map_or(f64::NAN, |b| b as f64 / MIB);
    println!(
        "{side:13}  {covered:7}  {seconds:7.2}  {:16.2}  {:5.0}  {:9.1}",
        covered as f64 / seconds / 1e6,
        mib(peak),
        mib(peak) - mib(before)
    );
}
