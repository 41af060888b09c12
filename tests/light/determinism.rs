//! The same seed gives the same bytes, for any number of threads and with or without AVX2.

use crate::common::*;
use radiosity::{
    Progress, Scene,
    accuracy::error_bars::ErrorBars,
    form_factor::{CastOptions, Estimator},
    monte_carlo::{Effort, PathOptions, PathTracer, Region},
    patch::Subdivision,
    solve::{SolveOptions, Solver, solve, solve_linear},
    trace::Tracer,
};

/// All results of a run, bit by bit.
#[derive(PartialEq)]
struct Bytes {
    hits: Vec<u32>,
    columns: Vec<usize>,
    values: Vec<u64>,
    solutions: Vec<Vec<u64>>,
    errors: Vec<u64>,
}

fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|x| x.to_bits()).collect()
}

fn run(scene: &Scene, estimator: Estimator, seed: u64, threads: usize) -> Bytes {
    run_by(Tracer::new(scene), scene, estimator, seed, threads)
}

fn run_by(tracer: Tracer, scene: &Scene, estimator: Estimator, seed: u64, threads: usize) -> Bytes {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        let options = CastOptions::default().with_estimator(estimator).with_seed(seed);
        let room = cast_by(tracer, scene.clone(), Subdivision::Count(700), options);
        let (f, n) = (&room.form_factors, room.patches.len());
        let rows: Vec<(usize, f64)> = (0..n).flat_map(|i| f.row(i)).collect();
        let mut values: Vec<f64> = rows.iter().map(|r| r.1).collect();
        values.extend(f.escaped());
        let before_after = [f.row_sum_deviation(), f.reciprocity_deviation()];
        values.extend(before_after.iter().flat_map(|d| [d.before, d.after]));
        // All solvers that suit both estimators.
        let solvers = [Solver::Auto, Solver::Jacobi, Solver::Southwell];
        let solutions: Vec<_> = solvers
            .iter()
            .map(|&solver| {
                let options = SolveOptions::default().with_solver(solver).with_tolerance(1e-8);
                solve(f, &room.patches, &options, &Progress::new()).unwrap()
            })
            .collect();
        let options = SolveOptions::default().with_linear(true);
        let linear = solve_linear((&room.scene, &room.tracer), f, &room.patches, &options, &Progress::new());
        let linear = linear.unwrap();
        let errors = ErrorBars::of(f, &room.patches, &linear).unwrap().standard_error;
        let slopes = &linear.linear.as_ref().unwrap().slopes;
        let linear = bits(&[&linear.radiosity[..], slopes.as_flattened()].concat());
        Bytes {
            hits: (0..n).flat_map(|i| f.ray_set().unwrap().of(i)).copied().collect(),
            columns: rows.iter().map(|r| r.0).collect(),
            values: bits(&values),
            solutions: solutions.iter().map(|s| bits(&s.radiosity)).chain([linear]).collect(),
            errors: bits(&errors),
        }
    })
}

/// The same seed gives the same bits for any number of threads; another seed gives other rays and results. One scene
/// has colours and shadow rays. The other has backs that become patches while rays are cast.
#[test]
fn threads_change_nothing_and_seeds_everything() {
    let plate = black(level_square(0.6, 0.1, true));
    let cell = part(room(glam::DVec3::splat(-0.5), glam::DVec3::splat(0.5)), 0.6, 0.0);
    let lamp = part(level_square(0.2, 0.4, false), 0.0, 1.0);
    for scene in [load("door-ajar"), scene(&[plate, cell, lamp])] {
        for estimator in BOTH {
            let one = run(&scene, estimator, 17, 1);
            for threads in [2, 5] {
                let many = run(&scene, estimator, 17, threads);
                assert!(one.hits == many.hits, "{estimator:?}, {threads} threads: other hits");
                assert!(one.columns == many.columns && one.values == many.values, "other form factors");
                assert!(one.solutions == many.solutions, "other solutions");
                assert!(one.errors == many.errors, "other error bars");
            }
            let other = run(&scene, estimator, 18, 1);
            assert!(one.hits != other.hits && one.values != other.values);
            assert!(one.solutions != other.solutions && one.errors != other.errors);
        }
    }
}

/// The tracer without AVX2 gives the same bits. Form factors and paths together use every kind of ray query.
#[test]
fn the_portable_tracer_gives_the_same_bytes() {
    let scene = load("door-ajar");
    let [wide, plain] = [Tracer::new(&scene), Tracer::portable(&scene)].map(|tracer| {
        let paths = PathTracer::new(&scene, &tracer, PathOptions::default());
        let region =
            |triangle| Region { triangle, part: [[1., 0., 0.], [0., 1., 0.], [0., 0., 1.]], front: true };
        let regions: Vec<Region> = (0..scene.triangles.len()).map(region).collect();
        let effort = Effort::default().with_samples(64);
        let traced = paths.mean_irradiances(&regions, &effort, &Progress::new()).unwrap();
        let traced: Vec<u64> = traced.iter().flat_map(|e| bits(&e.mean)).collect();
        (run_by(tracer, &scene, Estimator::Pooled, 17, 2), traced)
    });
    assert!(wide.0 == plain.0, "other form factors");
    assert!(wide.1 == plain.1, "other paths");
    assert!(wide.1.iter().any(|&bits| bits != 0), "there is light");
}

/// Patches and replicates use different random numbers.
#[test]
fn patches_and_replicates_have_rays_of_their_own() {
    let cell = cast_whole(&[black(room(glam::DVec3::ZERO, glam::DVec3::ONE))], 256.0, Estimator::OneWay, 1);
    let hits = cell.form_factors.ray_set().unwrap();
    for k in 1..16 {
        assert_ne!(hits.of_replicate(0, 0), hits.of_replicate(0, k));
    }
    // The two triangles of a face see the room alike up to a symmetry of the cube. Their counts differ by chance.
    let sorted = |i: usize| {
        let mut counts: Vec<u64> = cell.form_factors.row(i).map(|(_, x)| x.to_bits()).collect();
        counts.sort_unstable();
        counts
    };
    assert_ne!(sorted(0), sorted(1));
}
