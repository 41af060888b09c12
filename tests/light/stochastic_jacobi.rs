//! The solution without a matrix, against the solution with one.

use glam::DVec3;
use radiosity::{
    Progress, Scene,
    accuracy::error_bars::T_QUANTILE,
    energy::EnergyLedger,
    form_factor::{CastOptions, FormFactors},
    patch::{Patches, Subdivision},
    scene::light::{Distant, Light, LightKind, PointLight, SUN_DIAMETER, Sky, SkyModel, Up},
    solve::{
        SolveOptions, solve,
        stochastic_jacobi::{self, Reached, StochasticOptions, StochasticSolution},
        sweep::Sweeper,
    },
    trace::Tracer,
};

fn by_sweeps(scene: &Scene, patches: usize, rays: f64, seed: u64) -> (Patches, StochasticSolution) {
    let (tracer, progress) = (Tracer::new(scene), Progress::new());
    let mut patches = Patches::subdivide(scene, &Subdivision::Count(patches));
    let sweeper = Sweeper::new(scene, &tracer, &mut patches, seed, &progress).unwrap();
    let solution = stochastic_jacobi::solve(
        &sweeper,
        sweeper.patches(),
        &StochasticOptions::default().with_rays(rays),
        &progress,
    )
    .unwrap();
    (patches, solution)
}

/// The solution of the same patches with a matrix and many more rays, whose error is small beside that of the sweeps.
fn by_matrix(scene: &Scene, patches: usize) -> (Patches, Vec<f64>) {
    let (tracer, progress) = (Tracer::new(scene), Progress::new());
    let mut patches = Patches::subdivide(scene, &Subdivision::Count(patches));
    let cast = CastOptions::default().with_rays(4096.0);
    let form_factors = FormFactors::cast(scene, &tracer, &mut patches, &cast, &progress).unwrap();
    let solution = solve(&form_factors, &patches, &SolveOptions::default(), &progress).unwrap();
    (patches, solution.irradiance)
}

const SEEDS: u64 = 2;

/// 95 % intervals from 16 batches contain the matrix solution. Errors of neighbouring patches are correlated, so the
/// share of a run scatters by some percent; over two seeds 90 % is required. The energy balances within five standard
/// errors.
#[test]
fn sweeps_agree_with_the_matrix_within_their_error_bars() {
    for name in ["cornell-box", "door-ajar", "corridor", "court"] {
        let scene = match name {
            "corridor" => corridor(),
            "court" => court(),
            _ => crate::common::load(name),
        };
        let (patches, truth) = by_matrix(&scene, 300);
        let (mut inside, mut all, mut squares, mut off, mut mean) = (0, 0, 0.0, 0.0, 0.0);
        for seed in 0..SEEDS {
            let (same, found) = by_sweeps(&scene, 300, 256.0, seed);
            assert_eq!(same.fronts(), patches.fronts());
            for q in 0..patches.fronts() * found.channels {
                let difference = found.irradiance[q] - truth[q];
                let error = found.standard_error[q];
                inside += usize::from(difference.abs() <= T_QUANTILE * error);
                all += 1;
                let area = patches.area(q / found.channels);
                squares += area * error * error;
                off += area * difference * difference;
                mean += area * truth[q];
            }
            for (imbalance, error) in found.imbalance.iter().zip(&found.imbalance_error) {
                assert!(imbalance.abs() <= 5.0 * error + 1e-9, "{name}: {imbalance} with error {error}");
            }
        }
        let values = SEEDS as f64 * truth.len() as f64 / patches.fronts() as f64;
        let area: f64 = values * (0..patches.fronts()).map(|i| patches.area(i)).sum::<f64>();
        let share = inside as f64 / all as f64;
        println!(
            "{name}: {:.1} % in 95 % intervals; RMS error {:.2} %, estimated {:.2} %",
            100.0 * share,
            100.0 * (off / area).sqrt() / (mean / area),
            100.0 * (squares / area).sqrt() / (mean / area)
        );
        assert!(share >= 0.9, "{name}: {share}");
    }
}

/// A court under an overcast sky with a blue tinge, a low sun, a bulb and a lamp. Walls of 2 m hide parts of the sky and
/// of the sun from the floor. No surface sees the back of the lamp.
fn court() -> Scene {
    let [left, right, front, back, floor, _] =
        crate::common::room_faces(DVec3::ZERO, DVec3::new(4.0, 3.0, 2.0));
    let lamp = crate::common::rectangle(DVec3::new(1.0, 1.0, 2.0), DVec3::Y, DVec3::X);
    let mut scene = crate::common::scene(&[
        crate::common::part([left, right, front, back].concat(), 0.7, 0.0),
        crate::common::part(floor, 0.4, 0.0),
        crate::common::part(lamp, 0.0, 20.0),
    ]);
    let towards = Up::Z.direction(2.5, 0.7);
    let sun = Distant::new(towards, [90.0, 80.0, 60.0], SUN_DIAMETER.to_radians());
    let bulb = PointLight::isotropic(DVec3::new(3.0, 2.0, 0.7), [4.0; 3]);
    scene.lights.list.push(Light::new("sun", LightKind::Distant(sun)));
    scene.lights.list.push(Light::new("bulb", LightKind::Point(bulb)));
    scene.lights.sky = Some(Sky::with_irradiance(SkyModel::Overcast, Up::Z, [40.0, 45.0, 60.0]));
    scene
}

/// Power that enters without a matrix is the power that enters with one, within their standard errors, and the ledger
/// closes: emitted + entered = absorbed + escaped. In the open, sun and bulb enter without noise.
#[test]
fn the_ledger_counts_the_light_that_enters() {
    let scene = court();
    let (tracer, progress) = (Tracer::new(&scene), Progress::new());
    let mut patches = Patches::subdivide(&scene, &Subdivision::Count(300));
    let cast = CastOptions::default().with_rays(2048.0);
    let form_factors = FormFactors::cast(&scene, &tracer, &mut patches, &cast, &progress).unwrap();
    let solution = solve(&form_factors, &patches, &SolveOptions::default(), &progress).unwrap();
    let ledger = EnergyLedger::of(&form_factors, &patches, &solution);
    let (_, found) = by_sweeps(&scene, 300, 256.0, 3);
    for c in 0..3 {
        let (entered, error) = (found.entered[c], found.entered_error[c]);
        let wanted = ledger.entered[c];
        assert!(
            (entered - wanted).abs() < 4.0 * error && error < 0.01 * wanted,
            "{entered} ± {error}: {wanted}"
        );
        let sent = found.emitted[c] + entered;
        assert!((sent - found.absorbed[c] - found.escaped[c]).abs() < 1e-9 * sent);
    }
    assert!(found.is_balanced());

    let mut open =
        crate::common::scene(&[crate::common::part(crate::common::level_square(2.0, 0.0, true), 0.5, 0.0)]);
    open.lights.list = scene.lights.list[..1].to_vec();
    let (_, found) = by_sweeps(&open, 32, 64.0, 1);
    let wanted = 4.0 * 90.0 * 0.7f64.sin();
    assert!((found.entered[0] / wanted - 1.0).abs() < 1e-6, "{} for {wanted}", found.entered[0]);
}

/// White walls between black ends, lit at one end. Light takes tens of bounces to the dark end. The first sweeps lack
/// this light, so the mean over all sweeps would have an error beyond its standard error.
fn corridor() -> Scene {
    let [left, right, floor, ceiling, lit, dark] =
        crate::common::room_faces(DVec3::ZERO, DVec3::new(1.0, 1.0, 12.0));
    let walls = [left, right, floor, ceiling].concat();
    crate::common::scene(&[
        crate::common::part(walls, 0.95, 0.0),
        crate::common::part(lit, 0.0, 1.0),
        crate::common::black(dark),
    ])
}

/// In a closed furnace every patch has Be / (1 - ρ), here with ρ = 0.9. Rows of few rays sum to 1, so the first
/// solution has an error of 10⁻⁸ over 1 - ρ, and every sweep keeps it. Without this start 0.95⁶⁴ = 4 % would be missing
/// after 64 sweeps.
#[test]
fn a_furnace_is_as_bright_as_it_must_be() {
    let room = crate::common::room(DVec3::ZERO, DVec3::new(1.0, 2.0, 3.0));
    let scene = crate::common::scene(&[crate::common::part(room, 0.9, 1.0)]);
    let (_, found) = by_sweeps(&scene, 200, 64.0, 1);
    let wanted = 1.0 / (1.0 - 0.9);
    for (e, error) in found.irradiance.iter().zip(&found.standard_error) {
        assert!((e / wanted - 1.0).abs() < 1e-6, "{e} of {wanted} with error {error}");
    }
}

/// Sweeps of 64 rays per patch over the Cornell box with this number of patches, repeated while `more` returns true.
fn sweeps_while(count: usize, more: impl FnMut(&Reached) -> bool) -> (Patches, StochasticSolution) {
    let scene = Scene::load("meshes/cornell-box.obj").unwrap();
    let (tracer, progress) = (Tracer::new(&scene), Progress::new());
    let mut patches = Patches::subdivide(&scene, &Subdivision::Count(count));
    let sweeper = Sweeper::new(&scene, &tracer, &mut patches, 1, &progress).unwrap();
    let options = StochasticOptions::default().with_rays(64.0);
    let found = stochastic_jacobi::solve_while(&sweeper, sweeper.patches(), &options, more, &progress);
    (sweeper.patches().clone(), found.unwrap())
}

/// Sampling continues to three times the number of rays. 16 batches become 8 of twice the length, and 8 more follow.
/// These 16 become 8 again, and 4 more, each four times as long as at first, make 48.
#[test]
fn sweeps_go_on_batch_by_batch() {
    let mut reports = Vec::new();
    let (patches, found) = sweeps_while(300, |reached| {
        reports.push(*reached);
        reached.rays < 192.0
    });
    let rays: Vec<f64> = reports.iter().map(|reached| reached.rays).collect();
    let halves = (16..32).step_by(2).chain((32..=48).step_by(4)).map(|batches| f64::from(4 * batches));
    assert_eq!(rays, halves.collect::<Vec<_>>());
    // Each report forecasts the rays of the next one.
    for pair in reports.windows(2) {
        assert!((pair[0].rays * (1.0 + pair[0].next) / pair[1].rays - 1.0).abs() < 1e-12);
    }
    assert_eq!(found.reached, *reports.last().unwrap());
    assert_eq!(found.sweeps, 48);
    let n = patches.len() as u64;
    assert_eq!(found.tally.hemisphere, n * (32 + 48 * 3));
    // The error falls at least like that of independent rays. An estimate from 16 values scatters by 18 %, and the
    // ratio of two by 26 %. Twice that is allowed.
    assert!(found.reached.error < reports[0].error * 3f64.sqrt().recip() * 1.55, "{reports:?}");
}

/// The energy balances within five standard errors after many sweeps of three rays: correlations between successive
/// rays must not accumulate. The mean over patches is then known to two thousandths.
#[test]
fn many_short_sweeps_balance_their_energy() {
    let (_, found) = sweeps_while(300, |reached| reached.rays < 8192.0);
    for (imbalance, error) in found.imbalance.iter().zip(&found.imbalance_error) {
        println!("{imbalance:.2e} with error {error:.2e}");
        assert!(imbalance.abs() <= 5.0 * error && *error < 2e-3, "{imbalance} with error {error}");
    }
    assert!(found.balanced_to().abs() < 1e-12);
}

/// In a black room all light comes from shadow rays to unblocked lamps. All batches are equal, so only the error of
/// unblocked light remains, and the energy balances to that.
#[test]
fn light_without_noise_balances_to_what_is_known_of_it() {
    let (_, found) = by_sweeps(&crate::common::low_lamp(), 1000, 64.0, 1);
    let (imbalance, error) = found.worst_imbalance();
    println!("{imbalance:.2e} with error {error:.2e}");
    assert!(found.is_balanced() && imbalance.abs() < 1e-6 && error < 1e-6, "{imbalance} with error {error}");
}

/// Light beyond the range of single precision, and whose squares are too: a factor of 2⁶⁰⁰ changes no digit.
#[test]
fn brightness_makes_no_difference() {
    let room = crate::common::room(DVec3::ZERO, DVec3::new(1.0, 2.0, 3.0));
    let (lamp, walls) = room.split_at(2);
    let [dim, bright] = [1.0, 2f64.powi(600)].map(|light| {
        let parts =
            [crate::common::part(lamp.to_vec(), 0.5, light), crate::common::part(walls.to_vec(), 0.5, 0.0)];
        let scene = crate::common::scene(&parts);
        by_sweeps(&scene, 100, 32.0, 1).1
    });
    assert!(dim.irradiance.iter().any(|&e| e > 0.0) && dim.standard_error.iter().any(|&e| e > 0.0));
    let scaled = |values: &[f64]| values.iter().map(|x| x * 2f64.powi(600)).collect::<Vec<_>>();
    assert_eq!(scaled(&dim.irradiance), bright.irradiance);
    assert_eq!(scaled(&dim.standard_error), bright.standard_error);
    assert_eq!(dim.reached, bright.reached);
    assert_eq!(dim.imbalance_error, bright.imbalance_error);
}

/// Sweeps give the same bits for any number of threads.
#[test]
fn sweeps_are_the_same_for_any_number_of_threads() {
    let scene = Scene::load("meshes/cornell-box.obj").unwrap();
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| by_sweeps(&scene, 300, 32.0, 7).1)
    };
    assert_eq!(with(1), with(3));
}
