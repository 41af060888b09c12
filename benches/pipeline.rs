//! Time and memory from a scene to its radiosity and error bars: `cargo bench --bench pipeline`.
//!
//! The peak memory of a process never falls, so each size runs in its own process: this program, started again. 100,000
//! patches with 64 rays must fit into 2 GiB.

mod scenes;

use std::{hint::black_box, process::Command, time::Instant};

use radiosity::{
    Progress,
    accuracy::error_bars::ErrorBars,
    form_factor::{CastOptions, FormFactors},
    output::report::peak_bytes,
    patch::{Patches, Subdivision},
    solve::{SolveOptions, solve},
    trace::Tracer,
};
use scenes::{CORNELL, Place, SPHERES_1E5};

const RUNS: [(Place, usize); 4] =
    [(CORNELL, 1_000), (CORNELL, 10_000), (CORNELL, 100_000), (SPHERES_1E5, 100_000)];
const RAYS: f64 = 64.0;
const ROUNDS: usize = 5;
const MIB: f64 = (1 << 20) as f64;
const MOST_BYTES: u64 = 2 << 30;
/// This environment variable gives a new process the index of its task in [`RUNS`].
const TASK: &str = "RADIOSITY_BENCH_TASK";

fn main() {
    if let Ok(task) = std::env::var(TASK) {
        let (place, patches) = RUNS[task.parse::<usize>().expect("a number")];
        return run(place, patches);
    }
    println!(
        "{RAYS} rays per patch; the fastest of {ROUNDS} rounds, in seconds; matrix with hits and peak of the process in MiB"
    );
    println!(
        "scene                    patches  casting  Mrays/s  solving  iterations  error bars  non-zeros   held   peak"
    );
    for task in 0..RUNS.len() {
        let program = std::env::current_exe().expect("a running program has a name");
        let status = Command::new(program).env(TASK, task.to_string()).status().expect("it starts again");
        assert!(status.success(), "{} with {} patches failed", RUNS[task].0, RUNS[task].1);
    }
}

fn run(place: Place, count: usize) {
    let progress = Progress::new();
    let scene = (place.make)();
    let ([mut casting, mut solving, mut judging], mut peak) = ([f64::INFINITY; 3], None);
    for round in 0..ROUNDS {
        let tracer = Tracer::new(&scene);
        let mut patches = Patches::subdivide(&scene, &Subdivision::Count(count));
        let options = CastOptions::default().with_rays(RAYS);
        let start = Instant::now();
        let form_factors = FormFactors::cast(&scene, &tracer, &mut patches, &options, &progress).unwrap();
        casting = casting.min(start.elapsed().as_secs_f64());
        let start = Instant::now();
        let solution = solve(&form_factors, &patches, &SolveOptions::default(), &progress).unwrap();
        solving = solving.min(start.elapsed().as_secs_f64());
        let start = Instant::now();
        black_box(ErrorBars::of(&form_factors, &patches, &solution));
        judging = judging.min(start.elapsed().as_secs_f64());
        // Later rounds may find fragmented memory.
        if round == 0 {
            peak = peak_bytes();
        }
        if round + 1 == ROUNDS {
            println!(
                "{place:23}  {:7}  {casting:7.3}  {:7.2}  {solving:7.3}  {:10}  {judging:10.3}  {:9}  {:5.1}  {}",
                patches.len(),
                form_factors.rays() as f64 / casting / 1e6,
                solution.iterations,
                form_factors.non_zeros(),
                form_factors.bytes() as f64 / MIB,
                peak.map_or("    ?".into(), |bytes| format!("{:5.1}", bytes as f64 / MIB)),
            );
        }
    }
    assert!(peak.is_none_or(|bytes| bytes <= MOST_BYTES), "{count} patches took more than 2 GiB");
}
