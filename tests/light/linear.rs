//! Light that varies linearly over each patch.

use crate::common::*;
use glam::{DVec3, dvec3};
use radiosity::{
    Progress, Scene,
    accuracy::{solved::Solved, validation::averaged},
    energy::EnergyLedger,
    form_factor::{CastOptions, exact::point_to_polygon},
    patch::{Patches, Subdivision},
    solve::{Solution, SolveOptions, solve_linear},
    trace::Tracer,
};

fn solved(scene: &Scene, patches: Patches, rays: f64, seed: u64) -> Solved {
    let tracer = Tracer::new(scene);
    let cast = CastOptions::default().with_rays(rays).with_seed(seed);
    let options = SolveOptions::default().with_linear(true);
    Solved::of_patches(scene, &tracer, patches, &cast, &options, &Progress::new()).unwrap()
}

/// Irradiance of a front patch at one of its corners.
fn at_corner(solution: &Solution, q: usize, corner: usize) -> f64 {
    let basis = [[1.0, 1.0], [-1.0, 1.0], [0.0, -2.0]][corner];
    let slopes = solution.linear.as_ref().unwrap().slopes[q];
    solution.irradiance[q] + slopes[0] * basis[0] + slopes[1] * basis[1]
}

/// A closed room with a square lamp under its ceiling.
fn lamp_room(reflectance: f64) -> Scene {
    let lamp = rectangle(dvec3(0.3, 0.3, 0.95), DVec3::Y * 0.4, DVec3::X * 0.4);
    scene(&[part(room(DVec3::ZERO, DVec3::ONE), reflectance, 0.0), part(lamp, 0.0, 1.0)])
}

/// A room lit by its ceiling, with a block on the floor.
fn room_with_block() -> Scene {
    let [x0, x1, y0, y1, floor, ceiling] = room_faces(DVec3::ZERO, DVec3::ONE);
    let block: Vec<Corners> =
        room_faces(dvec3(0.32, 0.41, 0.0), dvec3(0.63, 0.67, 0.4)).into_iter().flatten().collect();
    let walls = [x0, x1, y0, y1, floor].concat();
    scene(&[part(walls, 0.6, 0.0), part(flipped(block), 0.6, 0.0), part(ceiling, 0.6, 1.0)])
}

/// The light of an unblocked lamp has the slopes of Lambert's formula, projected with a lattice of points. On patches
/// that are small beside their distance from the lamp, the program's quadrature has an error below a thousandth of the
/// light; twice that is allowed.
#[test]
fn slopes_of_unblocked_light_are_exact() {
    const N: usize = 24;
    let room = lamp_room(0.0);
    let lamp = [(0.3, 0.3), (0.3, 0.7), (0.7, 0.7), (0.7, 0.3)].map(|(x, y)| dvec3(x, y, 0.95));
    let Solved { patches, solution, .. } =
        solved(&room, Patches::subdivide(&room, &Subdivision::Count(300)), 64.0, 1);
    let slopes = &solution.linear.as_ref().unwrap().slopes;
    let mut floor = 0;
    for i in 0..patches.fronts() {
        if patches.normal(&room, i).z < 0.5 || patches.centroid(&room, i).z > 0.5 {
            continue;
        }
        let (corners, normal) = (patches.corners(&room, i), patches.normal(&room, i));
        let (mut moments, mut mean, mut many) = ([0.0; 2], 0.0, 0.0);
        for j in 0..N {
            for k in 0..N - j {
                for turned in 0..=usize::from(j + k + 2 <= N) {
                    let x = |k: usize| (k as f64 + (1.0 + turned as f64) / 3.0) / N as f64;
                    let b = [x(j), x(k), 1.0 - x(j) - x(k)];
                    let light = point_to_polygon((0..3).map(|k| corners[k] * b[k]).sum(), normal, &lamp);
                    moments[0] += 6.0 * light * (b[0] - b[1]);
                    moments[1] += 2.0 * light * (b[0] + b[1] - 2.0 * b[2]);
                    (mean, many) = (mean + light, many + 1.0);
                }
            }
        }
        for m in 0..2 {
            let off = (slopes[i][m] - moments[m] / many).abs();
            assert!(off <= 2e-3 * mean / many, "patch {i}: {:?}, {moments:?} / {many}", slopes[i]);
        }
        floor += 1;
    }
    assert!(floor > 10);
}

/// Slopes move light and make none: the ledger balances as without them, and nothing escapes from a closed room. No
/// light is negative at any corner.
#[test]
fn the_ledger_is_exact_and_no_light_is_negative() {
    for (name, scene, closed) in [
        ("cornell-box", load("cornell-box"), false),
        ("textured", load("textured"), false),
        ("room with block", room_with_block(), true),
    ] {
        let patches = Patches::subdivide(&scene, &Subdivision::Count(600));
        let Solved { patches, form_factors, solution, error_bars, .. } = solved(&scene, patches, 64.0, 3);
        let ledger = EnergyLedger::of(&form_factors, &patches, &solution);
        println!("{name}: {:e}, escaped {:?}", ledger.imbalance(), ledger.escaped);
        assert!(ledger.imbalance().abs() < 1e-9, "{name}: {:e}", ledger.imbalance());
        if closed {
            assert!(ledger.escaped.iter().all(|e| e.abs() < 1e-9 * ledger.emitted[0]), "{name}: {ledger:?}");
        }
        let linear = solution.linear.as_ref().unwrap();
        // Many patches have light that varies; otherwise the test would check nothing. The slopes of others are noise.
        let varying = linear.slopes.iter().filter(|s| **s != [0.0; 2]).count();
        println!("{name}: {varying} of {} vary", linear.slopes.len());
        assert!(3 * varying > linear.slopes.len(), "{name}: {varying} vary");
        for q in 0..solution.irradiance.len() {
            let least = (0..3).map(|corner| at_corner(&solution, q, corner)).fold(f64::INFINITY, f64::min);
            assert!(least >= -1e-12 * solution.irradiance[q], "{name}: {least}");
        }
        assert!(error_bars.standard_error.iter().all(|e| e.is_finite() && *e >= 0.0));
    }
}

/// If everything emits alike there are no slopes, however few the rays. Irradiance is 1 with linear and with constant
/// light.
#[test]
fn a_furnace_has_no_slopes() {
    let furnace = load("furnace");
    let patches = Patches::subdivide(&furnace, &Subdivision::Count(300));
    let Solved { solution, .. } = solved(&furnace, patches, 32.0, 1);
    let linear = solution.linear.as_ref().unwrap();
    // Rows are closed to 10⁻¹² of single precision. The light straight from lamps is as exact as its quadrature.
    assert!(solution.irradiance.iter().all(|e| (e - 1.0).abs() < 1e-4));
    assert!(linear.slopes.iter().flatten().all(|slope| slope.abs() < 1e-3), "{:?}", linear.slopes);
    assert!(
        solution.irradiance.iter().zip(&linear.constant).all(|(e, constant)| (e - constant).abs() < 1e-4)
    );
}

/// RMS errors of linear and of constant light, relative to the mean irradiance. The patches of the reference have a
/// quarter of the edge. Products of the errors of two seeds have no noise on average.
fn errors(scene: &Scene, patches: usize, rays: f64) -> [f64; 2] {
    const SEEDS: u64 = 4;
    let coarse = Patches::subdivide(scene, &Subdivision::Count(patches));
    let fine = solved(scene, coarse.quartered(scene).quartered(scene), 512.0, 77);
    let truth = averaged(&coarse, &fine.patches, &fine.solution.irradiance);
    let areas: Vec<f64> = (0..coarse.fronts()).map(|i| coarse.area(i)).collect();
    let channels = coarse.channels();
    let weighted = |value: &dyn Fn(usize) -> f64| -> f64 {
        let sum: f64 = (0..truth.len()).map(|q| areas[q / channels] * value(q)).sum();
        sum / (areas.iter().sum::<f64>() * channels as f64)
    };
    let runs: Vec<Solved> = (0..SEEDS).map(|seed| solved(scene, coarse.clone(), rays, seed)).collect();
    let rms = |light: &dyn Fn(&Solved) -> Vec<f64>| -> f64 {
        let off: Vec<Vec<f64>> = runs
            .iter()
            .map(|run| light(run).iter().zip(&truth).map(|(e, truth)| e - truth).collect())
            .collect();
        let (mut sum, mut pairs) = (0.0, 0.0);
        for a in 0..off.len() {
            for b in 0..a {
                sum += weighted(&|q| off[a][q] * off[b][q]);
                pairs += 1.0;
            }
        }
        (sum / pairs).max(0.0).sqrt() / weighted(&|q| truth[q])
    };
    [
        rms(&|run| run.solution.irradiance.clone()),
        rms(&|run| run.solution.linear.as_ref().unwrap().constant.clone()),
    ]
}

/// At equal patches linear light has at most half of the discretisation error of constant light if nothing touches. If
/// a block stands on patches of the floor, it has at most 80 %.
#[test]
fn errors_are_halved() {
    for (name, scene, most) in [("lamp", lamp_room(0.7), 0.5), ("block", room_with_block(), 0.8)] {
        for patches in [200, 800] {
            let [linear, constant] = errors(&scene, patches, 1024.0);
            println!(
                "{name}, {patches} patches: linear {:.3} %, constant {:.3} %",
                100.0 * linear,
                100.0 * constant
            );
            assert!(linear <= most * constant, "{name}, {patches} patches: {linear}, constant {constant}");
        }
    }
}

/// Light is linear only with its option. Otherwise it is the light of [`radiosity::solve::solve`].
#[test]
fn linear_light_is_an_option() {
    let lit = cast(load("cornell-box"), Subdivision::Count(300), CastOptions::default());
    let by = |linear: bool| {
        let options = SolveOptions::default().with_linear(linear);
        let scene = (&lit.scene, &lit.tracer);
        solve_linear(scene, &lit.form_factors, &lit.patches, &options, &Progress::new()).unwrap()
    };
    let (constant, linear) = (by(false), by(true));
    assert!(constant.linear.is_none());
    assert_eq!(constant.irradiance, linear.linear.as_ref().unwrap().constant);
    assert_ne!(constant.irradiance, linear.irradiance);
}
