//! Extreme numbers, each with the answer that physics gives. `cargo test --test light extremes:: -- --nocapture` prints
//! the figures of docs/extremes.md.

use std::f64::consts::PI;

use crate::common::*;
use glam::{DVec3, dvec3};
use radiosity::{
    Error, Progress, Scene,
    accuracy::error_bars::ErrorBars,
    energy::EnergyLedger,
    form_factor::{
        CastOptions,
        exact::{point_to_polygon, polygon_form_factor},
    },
    patch::Subdivision,
    scene::Material,
    solve::{Radiometry, Solution, SolveOptions, Solver, solve},
    trace::Tracer,
};

const WHOLE: Subdivision = Subdivision::Edge(f64::INFINITY);

/// A scene that is cut, cast and solved.
struct Lit {
    cast: Cast,
    solution: Solution,
    errors: Vec<f64>,
    ledger: EnergyLedger,
}

/// Solves, and checks what holds in every scene: shares lie between 0 and 1, nothing is negative or not a number, and
/// the ledger closes up to the solver's tolerance and the rounding of the light in circulation.
fn light<'a>(cast: Cast, radiometry: Option<Radiometry<'a>>) -> Lit {
    let f = &cast.form_factors;
    let light = radiometry.unwrap_or_else(|| (&cast.patches).into());
    let solution = solve(f, light, &SolveOptions::default(), &Progress::new()).unwrap();
    let errors = ErrorBars::of(f, light, &solution).unwrap().standard_error;
    let ledger = EnergyLedger::of(f, light, &solution);

    for i in 0..f.len() {
        assert!((0.0..=1.0).contains(&f.escaped()[i]), "{i} loses {}", f.escaped()[i]);
        assert!(f.row(i).all(|(_, x)| (0.0..=1.0 + 1e-12).contains(&x)), "row {i}");
    }
    let (closure, reciprocity) = deviations(f);
    let row_sums = f.row_sum_deviation();
    assert!(closure <= 1e-12 && reciprocity <= 1e-12, "{closure:e} {reciprocity:e} {row_sums:?}");
    assert_eq!(f.out_of_range(), 0);
    for values in [&solution.radiosity, &solution.irradiance, &errors] {
        assert!(values.iter().all(|x| x.is_finite() && *x >= 0.0));
    }
    // Sums of some thousand rounded terms: their rounding is about ten times one rounding of the light that leaves.
    assert!(solution.residual <= 1e-10 || solution.residual <= 16.0 * ledger.rounding(), "{solution:?}");
    let allowed = 1e-10 + 64.0 * ledger.rounding();
    assert!(ledger.imbalance().abs() <= allowed, "{:e}, {allowed:e} allowed", ledger.imbalance());
    Lit { cast, solution, errors, ledger }
}

fn solved(scene: Scene, subdivision: Subdivision) -> Lit {
    light(cast(scene, subdivision, CastOptions::default()), None)
}

/// Gives every patch, backs included, an emission of 1 - ρ, so that the radiosity is 1 everywhere if no light escapes.
fn furnace(cast: Cast, reflectance: f64) -> Lit {
    let n = cast.patches.len();
    let (rho, be) = (vec![reflectance; n], vec![1.0 - reflectance; n]);
    light(cast, Some(Radiometry { channels: 1, emission: &be, reflectance: &rho }))
}

fn worst(values: &[f64], truth: f64) -> f64 {
    values.iter().map(|b| (b - truth).abs()).fold(0.0, f64::max)
}

/// For the table: the relative error, also in standard errors.
fn off(measured: Measured, truth: f64) -> String {
    let Measured { value, error } = measured;
    format!("{:.1e} ({:.1} standard errors)", value / truth - 1.0, (value - truth) / error)
}

fn unit_room() -> Vec<Corners> {
    room(DVec3::ZERO, DVec3::ONE)
}

/// The unit cube: the floor is part 0, the ceiling part 1, the walls part 2.
fn furnished(floor: (f64, f64), ceiling: (f64, f64), walls: (f64, f64)) -> Vec<Part> {
    let [x0, x1, y0, y1, z0, z1] = room_faces(DVec3::ZERO, DVec3::ONE);
    let of = |triangles, (rho, be)| part(triangles, rho, be);
    vec![of(z0, floor), of(z1, ceiling), of([x0, x1, y0, y1].concat(), walls)]
}

/// Two cubes joined by a channel of this width and length through the wall between them. The surface is closed.
fn two_chambers(width: f64, length: f64) -> Vec<Corners> {
    let (low, high) = (0.5 - 0.5 * width, 0.5 + 0.5 * width);
    let at = |x: f64, y: f64, z: f64| dvec3(x, y, z);
    // The wall at x, seen against the x axis: four strips around the hole.
    let wall = |x: f64| -> Vec<Corners> {
        let strip = |y0: f64, y1: f64, z0: f64, z1: f64| {
            flipped(rectangle(at(x, y0, z0), DVec3::Y * (y1 - y0), DVec3::Z * (z1 - z0)))
        };
        [
            strip(0.0, low, 0.0, 1.0),
            strip(high, 1.0, 0.0, 1.0),
            strip(low, high, 0.0, low),
            strip(low, high, high, 1.0),
        ]
        .concat()
    };
    let far = 1.0 + length;
    let near_room = room_faces(DVec3::ZERO, DVec3::ONE);
    let far_room = room_faces(at(far, 0.0, 0.0), at(far + 1.0, 1.0, 1.0));
    let mut all = [wall(1.0), flipped(wall(far))].concat();
    all.extend([0, 2, 3, 4, 5].iter().flat_map(|&k| near_room[k].clone()));
    all.extend([1, 2, 3, 4, 5].iter().flat_map(|&k| far_room[k].clone()));
    let channel = room_faces(at(1.0, low, low), at(far, high, high));
    all.extend(channel[2..].concat());
    all
}

/// Black walls reflect nothing: B = Be to the bit, and the floor gets 0.1998 of the light of the ceiling (Howell C-11).
#[test]
fn reflectance_zero() {
    let parts = furnished((0.0, 0.0), (0.0, 1.0), (0.0, 0.0));
    let lit = solved(scene(&parts), Subdivision::Count(300));
    assert_eq!(lit.solution.radiosity, lit.cast.patches.emission());
    assert_eq!((lit.solution.iterations, lit.solution.residual), (0, 0.0));

    // Nothing blocks the ceiling, so its light is known. Closing rows that few rays measured elsewhere changes it by
    // some millionths at most. The least error bar, 10⁻⁵, stands for that.
    let truth = 0.199_824_895_698_387_46;
    let floor = lit.cast.of_part(0);
    for rays in [16.0, 64.0, 256.0] {
        let options = CastOptions::default().with_rays(rays);
        let lit = light(cast(scene(&parts), Subdivision::Count(300), options), None);
        let mean = lit.cast.mean(&floor, &lit.solution.irradiance, &lit.errors).value;
        let off = (mean / truth - 1.0).abs();
        println!("reflectance 0: B exact; E of the floor off by {off:.1e} at {rays} rays");
        assert!(off <= 1e-5, "{off:e} at {rays} rays");
    }
}

/// Furnaces that hardly absorb: one chamber, and two chambers that exchange light through a pinhole of 1/2500 of the
/// wall. B is 1 everywhere. Rounding changes it by a unit in the last place over 1 - ρ, 10⁻⁷ here; 10⁻⁶ is allowed.
#[test]
fn furnaces_that_hardly_absorb() {
    for (name, triangles) in [("cube", unit_room()), ("two chambers", two_chambers(0.02, 0.05))] {
        let cast_once = cast(scene(&[black(triangles)]), Subdivision::Count(600), CastOptions::default());
        assert!(cast_once.form_factors.escaped().iter().all(|&e| e == 0.0));
        for k in 1..=9 {
            let Cast { scene, patches, form_factors, .. } = &cast_once;
            let copy = Cast {
                scene: scene.clone(),
                tracer: Tracer::new(scene),
                patches: patches.clone(),
                form_factors: form_factors.clone(),
            };
            let loss = 10f64.powi(-k);
            let lit = furnace(copy, 1.0 - loss);
            let Solution { iterations, residual, error_bound, ref radiosity, .. } = lit.solution;
            let off = worst(radiosity, 1.0);
            println!(
                "{name}, 1 - ρ = 1e-{k}: off by {off:.1e}, bound {error_bound:.1e}, {iterations} iterations, \
                 residual {residual:.1e}, imbalance {:.1e}",
                lit.ledger.imbalance()
            );
            assert!(off <= 1e-6, "{name} {k}: {off:e}");
            assert!(iterations <= 100, "{name} {k}: {iterations}");
        }
    }
}

/// A lamp in one of two nearly white chambers that are joined by a pinhole. All that is emitted is absorbed, so the
/// mean irradiance is Φ / (A (1 - ρ)), up to rounding over 1 - ρ. The ledger must close, and the solver must converge
/// although the chambers are far from balance.
#[test]
fn chambers_far_from_balance() {
    for k in [3, 6, 9] {
        let triangles = two_chambers(0.1, 0.1);
        let scene = scene(&[part(triangles, 1.0 - 10f64.powi(-k), 0.0)]);
        let room = cast(scene, Subdivision::Count(600), CastOptions::default());
        let f = &room.form_factors;
        let n = room.patches.len();
        let rho = vec![1.0 - 10f64.powi(-k); n];
        let mut be = vec![0.0; n];
        be[0] = 1.0;
        let lit = light(
            Cast {
                scene: room.scene.clone(),
                tracer: Tracer::new(&room.scene),
                patches: room.patches.clone(),
                form_factors: f.clone(),
            },
            Some(Radiometry { channels: 1, emission: &be, reflectance: &rho }),
        );
        let area: f64 = f.areas().iter().sum();
        let mean: f64 =
            f.areas().iter().zip(&lit.solution.irradiance).map(|(a, e)| a * e).sum::<f64>() / area;
        let truth = f.areas()[0] / area / (1.0 - rho[0]);
        println!(
            "pinhole, lamp in one chamber, 1 - ρ = 1e-{k}: mean E off by {:.1e}, {} iterations",
            mean / truth - 1.0,
            lit.solution.iterations
        );
        assert!((mean / truth - 1.0).abs() <= 1e-6, "{mean} instead of {truth}");
        assert!(lit.solution.iterations <= 200);
    }
}

/// White walls reflect all light, so all that is emitted leaves by the opening, up to the solver's tolerance.
#[test]
fn white_with_an_opening() {
    let mut parts = furnished((1.0, 1.0), (1.0, 0.0), (1.0, 0.0));
    parts.remove(1);
    let lit = solved(scene(&parts), Subdivision::Count(300));
    let EnergyLedger { emitted, absorbed, escaped, .. } = &lit.ledger;
    println!("white, open: escaped off by {:.1e}", escaped[0] / emitted[0] - 1.0);
    assert_eq!(absorbed[0], 0.0);
    assert!((escaped[0] / emitted[0] - 1.0).abs() <= 1e-10);

    // A black ceiling that emits evenly fills the white room evenly.
    let parts = furnished((1.0, 0.0), (0.0, 1.0), (1.0, 0.0));
    let lit = solved(scene(&parts), Subdivision::Count(300));
    let off = worst(&lit.solution.radiosity, 1.0);
    println!("white, lit by its opening: off by {off:.1e}");
    assert!(off <= 1e-8, "{off:e}");
}

/// In a closed white room nothing absorbs the emitted light. There is no equilibrium, in whichever channel that
/// happens.
#[test]
fn white_and_closed_is_refused() {
    let all = part(unit_room(), 1.0, 1.0);
    let red = Part { reflectance: [1.0, 0.5, 0.5], ..part(unit_room(), 0.5, 1.0) };
    let sealed = [all, part(room(DVec3::splat(2.0), DVec3::splat(3.0)), 0.5, 1.0)];
    for parts in [&sealed[..1], &[red], &sealed] {
        let room = cast(scene(parts), Subdivision::Count(100), CastOptions::default());
        for solver in [Solver::Auto, Solver::Jacobi, Solver::GaussSeidel, Solver::Southwell, Solver::Direct] {
            let options = SolveOptions::default().with_solver(solver);
            let solution = solve(&room.form_factors, &room.patches, &options, &Progress::new());
            assert!(matches!(solution, Err(Error::NoEquilibrium)), "{solver:?}: {solution:?}");
        }
    }
    // Without emission there is an equilibrium: darkness.
    let lit = solved(scene(&[part(unit_room(), 1.0, 0.0)]), WHOLE);
    assert!(lit.solution.radiosity.iter().all(|&b| b == 0.0));
}

/// The system is linear: scaling the emission scales the answer, by powers of two to the bit, by powers of ten up to
/// the rounding of Be.
#[test]
fn emission_from_1e_minus_30_to_1e30() {
    let at = |factor: f64| {
        let mut scene = load("cornell-box");
        scene.materials.iter_mut().for_each(|m| m.emission = m.emission.map(|e| e * factor));
        solved(scene, Subdivision::Count(300))
    };
    let one = at(1.0);
    for factor in [2f64.powi(-100), 2f64.powi(100), 1e-30, 1e30] {
        let lit = at(factor);
        let off = |a: &[f64], b: &[f64]| {
            a.iter().zip(b).map(|(a, b)| (a / factor - b).abs()).fold(0.0, f64::max)
                / b.iter().copied().fold(0.0, f64::max)
        };
        let [b, e, s] = [
            off(&lit.solution.radiosity, &one.solution.radiosity),
            off(&lit.solution.irradiance, &one.solution.irradiance),
            off(&lit.errors, &one.errors),
        ];
        println!("emission times {factor:.0e}: B off by {b:.1e}, E {e:.1e}, error bars {s:.1e}");
        if factor.log2().fract() == 0.0 {
            assert_eq!([b, e, s], [0.0; 3], "{factor:e}");
        } else {
            // Rows are calibrated, and error bars computed, in single precision.
            assert!(b <= 1e-7 && e <= 1e-7 && s <= 1e-5, "{factor:e}: {b:e} {e:e} {s:e}");
        }
    }
}

/// A flat surface does not see itself: B = Be, and all light leaves.
#[test]
fn one_triangle_in_one_patch_or_many() {
    let triangle = vec![[DVec3::ZERO, DVec3::X, DVec3::Y]];
    for subdivision in [WHOLE, Subdivision::Count(64)] {
        let lit = solved(scene(&[part(triangle.clone(), 0.7, 2.0)]), subdivision);
        assert!(lit.solution.radiosity.iter().all(|&b| b == 2.0));
        assert!(lit.solution.irradiance.iter().all(|&e| e == 0.0));
        assert!(lit.cast.form_factors.escaped().iter().all(|&e| e == 1.0));
        assert!((lit.ledger.escaped[0] / 1.0 - 1.0).abs() <= 1e-12);
        println!("one triangle, {} patches: exact", lit.solution.radiosity.len());
    }
    let dark = solved(scene(&[part(triangle, 0.7, 0.0)]), WHOLE);
    assert_eq!(dark.solution.radiosity, [0.0]);
}

/// No light at all arrives from an emitter behind walls, or from one that faces away.
#[test]
fn an_emitter_that_nobody_sees() {
    let inner = room(DVec3::splat(0.4), DVec3::splat(0.6));
    let away = level_square(1.0, -2.0, false);
    let lamps = [("walled in", part(inner, 0.5, 1.0)), ("looking away", part(away, 0.5, 1.0))];
    for (name, lamp) in lamps {
        let shell = flipped(room(DVec3::splat(0.39), DVec3::splat(0.61)));
        let parts = [part(unit_room(), 0.5, 0.0), part(shell, 0.5, 0.0), lamp];
        let lit = solved(scene(&parts), Subdivision::Count(300));
        for k in [0, 1] {
            assert!(lit.cast.of_part(k).iter().all(|&i| lit.solution.radiosity[i] == 0.0), "{name}");
        }
        let lamp = lit.cast.of_part(2);
        assert!(lamp.iter().all(|&i| lit.solution.radiosity[i] > 0.5), "{name}");
        println!("emitter that nobody sees, {name}: all else 0");
    }
}

fn moved(scene: &Scene, factor: f64, offset: DVec3) -> Scene {
    let mut moved = scene.clone();
    moved.vertices.iter_mut().for_each(|v| *v = *v * factor + offset);
    moved
}

/// Rays run in unit space, so scaling by powers of two changes nothing, to the bit. Other factors and offsets round the
/// coordinates of the file to 1e-16 of their size. At an offset of 10⁶ sizes that is 1e-10 of the scene's size. It
/// moves some coordinates of unit space by one rounding of single precision, 6e-8, and so the few rays that pass so
/// close to an edge.
#[test]
fn scale_and_offset() {
    let original = load("cornell-box");
    let run = |scene: Scene| {
        let options = CastOptions::default().with_by_variance(false);
        light(cast(scene, Subdivision::Count(300), options), None)
    };
    let size = 2f64.powi(9);
    let one = run(original.clone());
    for (factor, offset) in [
        (2f64.powi(-20), 0.0),
        (2f64.powi(20), 0.0),
        (1e-6, 0.0),
        (1e6, 0.0),
        (1.0, 1e6 * size),
        (1e-6, 1.0 * size),
        (1e6, 1e12 * size),
    ] {
        let lit = run(moved(&original, factor, dvec3(offset, -offset, offset)));
        let hits = |lit: &Lit, i: usize| lit.cast.form_factors.ray_set().unwrap().of(i).to_vec();
        let n = lit.cast.patches.len();
        let (mut differ, mut rays) = (0, 0);
        for i in 0..n {
            let (a, b) = (hits(&one, i), hits(&lit, i));
            assert_eq!(a.len(), b.len());
            differ += a.iter().zip(&b).filter(|(a, b)| a != b).count();
            rays += a.len();
        }
        let (mut squares, mut all) = (0.0, 0.0);
        for (a, b) in one.solution.irradiance.iter().zip(&lit.solution.irradiance) {
            squares += (a - b).powi(2);
            all += a * a;
        }
        let off = (squares / all).sqrt();
        println!(
            "scale {factor:.0e}, offset {offset:.0e}: {differ} of {rays} rays differ, E off by {off:.1e} (RMS)"
        );
        if offset == 0.0 && factor.log2().fract() == 0.0 {
            assert_eq!((differ, off), (0, 0.0));
        }
        // A ray passes about ten edges of patches. It comes within 1e-7 of one in at most 1e-5 of all cases.
        assert!(differ as f64 <= 1.0 + 1e-5 * rays as f64 && off <= 1e-3, "{differ} of {rays}, {off:e}");
    }
}

/// The share of the light of `from` that arrives at `to`. Both are convex, and nothing blocks.
fn exact(from: &[DVec3], to: &[DVec3]) -> f64 {
    polygon_form_factor(from, to)
}

fn quad(corner: DVec3, u: DVec3, v: DVec3) -> [DVec3; 4] {
    [corner, corner + u, corner + u + v, corner + v]
}

/// Strips a million times as long as wide: one emits, one is lit, and one is in the wall of a furnace.
#[test]
fn slivers() {
    const W: f64 = 1e-6;
    let floor = (DVec3::ZERO, DVec3::X, DVec3::Y);
    let strip = (dvec3(0.5, 0.0, 1.0), DVec3::Y, DVec3::X * W);
    let square = (dvec3(0.0, 0.0, 1.0), DVec3::Y, DVec3::X);
    let low_strip = (dvec3(0.5, 0.0, 0.0), DVec3::X * W, DVec3::Y);
    let cases = [("a sliver shines", floor, strip), ("a sliver is lit", low_strip, square)];
    for (name, lit_part, lamp) in cases {
        let of = |(c, u, v): (DVec3, DVec3, DVec3)| rectangle(c, u, v);
        let parts = [part(of(lit_part), 0.0, 0.0), part(of(lamp), 0.0, 1.0)];
        let lit = solved(scene(&parts), Subdivision::Edge(0.25));
        let mean = lit.cast.mean(&lit.cast.of_part(0), &lit.solution.irradiance, &lit.errors);
        let truth = exact(&quad(lit_part.0, lit_part.1, lit_part.2), &quad(lamp.0, lamp.1, lamp.2));
        println!("{name}: E off by {:.1e}", mean.value / truth - 1.0);
        if name == "a sliver shines" {
            // Nothing blocks, so the light is known up to the single precision of the strip's width: 6e-8 / 1e-6 at a
            // position of 1/2.
            assert!((mean.value / truth - 1.0).abs() <= 0.06, "{} instead of {truth}", mean.value);
        } else {
            // Rays keep 6e-7 of half of the scene away from edges, so they start on a part of the sliver only. The
            // result is the light on that part: between the light at the ends and in the middle.
            let at = |y: f64| point_to_polygon(dvec3(0.5, y, 0.0), DVec3::Z, &quad(lamp.0, lamp.1, lamp.2));
            assert!(at(0.0) < mean.value && mean.value < at(0.5), "{} to {}", at(0.0), at(0.5));
        }
    }

    let [_, x1, y0, y1, z0, z1] = room_faces(DVec3::ZERO, DVec3::ONE);
    let (a, b) = (
        rectangle(DVec3::ZERO, DVec3::Y * W, DVec3::Z),
        rectangle(DVec3::Y * W, DVec3::Y * (1.0 - W), DVec3::Z),
    );
    let room = scene(&[black([a, b, x1, y0, y1, z0, z1].concat())]);
    let lit = furnace(cast(room, Subdivision::Count(300), CastOptions::default()), 0.9);
    let off = worst(&lit.solution.radiosity, 1.0);
    println!("a sliver in a furnace: off by {off:.1e}");
    // The solver's tolerance over 1 - ρ = 0.1.
    assert!(off <= 1e-9, "{off:e}");
}

/// A tile of 10⁻⁴ of the room's size in its middle: the ceiling lights it like a point. In a furnace its radiosity is
/// 1.
#[test]
fn patches_from_1_to_1e_minus_4() {
    const W: f64 = 1e-4;
    let tile = (dvec3(0.5, 0.5, 0.5), DVec3::X * W, DVec3::Y * W);
    let mut parts = furnished((0.0, 0.0), (0.0, 1.0), (0.0, 0.0));
    parts.push(black(rectangle(tile.0, tile.1, tile.2)));
    let lit = solved(scene(&parts), WHOLE);
    let mean = lit.cast.mean(&lit.cast.of_part(3), &lit.solution.irradiance, &lit.errors);
    let ceiling = quad(DVec3::Z, DVec3::Y, DVec3::X);
    let truth = exact(&quad(tile.0, tile.1, tile.2), &ceiling);
    println!("a tile of 1e-4: E off by {}", off(mean, truth));
    // Nothing blocks. Rounding its corners, by 1e-7 / 1e-4 at most, changes its area and its light alike.
    mean.assert_is(truth, 0.0);

    parts.iter_mut().for_each(|p| (p.reflectance, p.exitance) = ([0.0; 3], [0.0; 3]));
    let lit = furnace(cast(scene(&parts), WHOLE, CastOptions::default()), 0.9);
    let off = worst(&lit.solution.radiosity, 1.0);
    println!("a tile of 1e-4 in a furnace, both sides: off by {off:.1e}");
    assert!(off <= 1e-9, "{off:e}");
}

/// A wall of two faces 10⁻⁵ apart lets no light through, and neither does a wall without thickness. The furnace on its
/// bright side has B = 1, up to the solver's tolerance.
#[test]
fn thin_walls_hold_light_back() {
    for gap in [1e-5, 1e-6, 0.0] {
        let bright = || part(room(DVec3::ZERO, DVec3::ONE), 0.5, 0.5);
        let dark = || part(room(dvec3(1.0 + gap, 0.0, 0.0), dvec3(2.0 + gap, 1.0, 1.0)), 0.5, 0.0);
        for first in [0, 1] {
            let parts = if first == 0 { [bright(), dark()] } else { [dark(), bright()] };
            let lit = solved(scene(&parts), Subdivision::Count(400));
            // Each of two faces back to back is seen from its own room.
            assert_eq!(lit.cast.patches.len(), lit.cast.patches.fronts());
            let [b, d] = [first, 1 - first].map(|k| lit.cast.of_part(k));
            let through = d.iter().map(|&i| lit.solution.irradiance[i]).fold(0.0, f64::max);
            let off = b.iter().map(|&i| (lit.solution.radiosity[i] - 1.0).abs()).fold(0.0, f64::max);
            println!("walls {gap:.0e} apart: {through:.1e} passes, the furnace is off by {off:.1e}");
            assert_eq!(through, 0.0);
            assert!(off <= 1e-9, "{off:e}");
        }
    }
}

/// A lamp that is there twice, as exporters leave them, emits once: the second is hidden, and its light is lost. This
/// holds for few lamps, whose light is known exactly, and for many. Both scenes cast the same rays but calibrate rows
/// differently, so irradiances agree within error bars.
#[test]
fn doubled_lamps_shine_once() {
    for pieces in [1, 3] {
        let ceiling: Vec<Corners> = (0..pieces * pieces)
            .flat_map(|k| {
                let side = 1.0 / f64::from(pieces);
                let corner = dvec3(side * f64::from(k % pieces), side * f64::from(k / pieces), 1.0);
                flipped(rectangle(corner, DVec3::X * side, DVec3::Y * side))
            })
            .collect();
        let lit = |lamps: usize| {
            let [x0, x1, y0, y1, z0, _] = room_faces(DVec3::ZERO, DVec3::ONE);
            let mut parts = vec![part([x0, x1, y0, y1, z0].concat(), 0.5, 0.0)];
            parts.extend((0..lamps).map(|_| part(ceiling.clone(), 0.5, 1.0)));
            let options = CastOptions::default().with_by_variance(false);
            light(cast(scene(&parts), Subdivision::Edge(0.15), options), None)
        };
        let (once, twice) = (lit(1), lit(2));
        let (mut off, mut sigmas) = (0f64, 0f64);
        for i in once.cast.of_part(0) {
            let [a, b] = [&once, &twice].map(|lit| lit.solution.irradiance[i]);
            off = off.max((b / a - 1.0).abs());
            sigmas = sigmas.max((b - a).abs() / once.errors[i].hypot(twice.errors[i]));
        }
        let hidden = twice.cast.of_part(2);
        println!(
            "a doubled lamp of {} triangles: off by {off:.1e}, {sigmas:.1} standard errors",
            ceiling.len()
        );
        assert!(sigmas <= T15, "{off:e}, {sigmas}");
        assert!(hidden.iter().all(|&i| twice.cast.form_factors.escaped()[i] == 1.0));
        assert!((twice.ledger.emitted[0] / once.ledger.emitted[0] - 2.0).abs() <= 1e-12);
    }
}

/// In a closed furnace B is 1 on all surfaces, wherever they lie, up to the solver's tolerance over 1 - ρ.
#[test]
fn touching_coplanar_doubled_and_intersecting_faces() {
    let solid = |low: DVec3, high: DVec3| flipped(room(low, high));
    let third = 1.0 / 3.0;
    let cases = [
        ("touching", vec![solid(dvec3(0.2, 0.2, 0.0), dvec3(0.6, 0.6, third))]),
        ("touching in a corner", vec![solid(DVec3::ZERO, DVec3::splat(third))]),
        ("coplanar", vec![rectangle(dvec3(0.2, 0.2, 0.0), DVec3::X * 0.4, DVec3::Y * 0.4)]),
        ("doubled", vec![unit_room()]),
        ("doubled and turned", vec![flipped(unit_room())]),
        ("doubled and moved by 1e-9", vec![room(DVec3::splat(1e-9), DVec3::splat(1.0 - 1e-9))]),
        (
            "intersecting",
            vec![
                solid(dvec3(0.2, 0.2, 0.2), dvec3(0.6, 0.6, 0.6)),
                solid(dvec3(0.4, 0.4, 0.3), dvec3(0.8, 0.8, 0.7)),
            ],
        ),
    ];
    for (name, more) in cases {
        let mut parts = vec![black(unit_room())];
        parts.extend(more.into_iter().map(black));
        let lit = furnace(cast(scene(&parts), Subdivision::Count(500), CastOptions::default()), 0.9);
        // A face in contact with another, or behind it, does not see the room.
        let (escaped, b) = (lit.cast.form_factors.escaped(), &lit.solution.radiosity);
        let inside: Vec<f64> = (0..b.len()).filter(|&i| escaped[i] < 1.0).map(|i| b[i]).collect();
        let off = worst(&inside, 1.0);
        println!("{name}: off by {off:.1e}, {} of {} patches see nothing", b.len() - inside.len(), b.len());
        assert!(off <= 1e-9 && inside.len() >= lit.cast.of_part(0).len(), "{name}: {off:e}");
    }
}

/// Faces without area are left out, and nothing else changes.
#[test]
fn faces_without_area() {
    let parts = furnished((0.5, 0.0), (0.5, 1.0), (0.5, 0.0));
    let plain = solved(scene(&parts), Subdivision::Count(200));
    let mut with = furnished((0.5, 0.0), (0.5, 1.0), (0.5, 0.0));
    let (a, b) = (dvec3(0.25, 0.25, 0.5), dvec3(0.5, 0.75, 0.5));
    with[0].triangles.splice(1..1, [[a, a, a], [a, b, a], [a, a.midpoint(b), b]]);
    let scene = scene(&with);
    assert_eq!(scene.degenerate, 3);
    let lit = solved(scene, Subdivision::Count(200));
    assert_eq!(lit.solution, plain.solution);
    assert_eq!(lit.errors, plain.errors);
    println!("faces without area: same bits");
}

/// Areas beyond the range of single precision, of all surfaces or of one among others. Scaling changes no light, and a
/// tiny tile in a furnace has B = 1.
#[test]
fn areas_beyond_single_precision() {
    let original = scene(&furnished((0.5, 0.0), (0.5, 1.0), (0.5, 0.0)));
    let one = solved(original.clone(), Subdivision::Count(200));
    for exponent in [-450, -100, 100, 450] {
        let lit = solved(moved(&original, 2f64.powi(exponent), DVec3::ZERO), Subdivision::Count(200));
        assert_eq!(lit.solution, one.solution, "2^{exponent}");
        // They contain a logarithm of areas, which is as large as the exponent.
        for (a, b) in lit.errors.iter().zip(&one.errors) {
            assert!((a / b - 1.0).abs() <= 1e-12, "2^{exponent}: {a} {b}");
        }
    }
    println!("areas from 2^-900 to 2^900: same bits");

    for width in [1e-3, 1e-8, 1e-12, 1e-20, 1e-30, 1e-100] {
        let tile = rectangle(DVec3::ZERO, DVec3::X * width, DVec3::Y * width);
        let mut parts = vec![black(unit_room())];
        // In the middle of the room, where coordinates are smallest.
        parts[0].triangles.iter_mut().flatten().for_each(|p| *p -= 0.5);
        parts.push(black(tile));
        for lamp in [0.0, 1.0] {
            parts[1].exitance = [lamp; 3];
            let lit = furnace(cast(scene(&parts), Subdivision::Count(100), CastOptions::default()), 0.9);
            let off = worst(&lit.solution.radiosity, 1.0);
            println!(
                "a tile of {width:.0e} {}: off by {off:.1e}",
                if lamp > 0.0 { "that shines" } else { "" }
            );
            // The unblocked light of a lamp is known to some millionths.
            let allowed = if lamp > 0.0 { 2e-6 } else { 1e-9 };
            assert!(off <= allowed, "{width:e} {lamp}: {off:e}");
        }
    }
}

/// The scenes of this file give the same bits for any number of threads.
#[test]
fn threads_change_nothing_at_the_extremes() {
    let run = |scene: &Scene, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let lit = solved(scene.clone(), Subdivision::Count(400));
            let bits = |values: &[f64]| values.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
            (bits(&lit.solution.radiosity), bits(&lit.errors), bits(lit.cast.form_factors.escaped()))
        })
    };
    let nearly_white = scene(&[part(two_chambers(0.02, 0.05), 1.0 - 1e-9, 1e-9)]);
    let mut knot = furnished((0.5, 0.0), (0.5, 1e30), (0.5, 0.0));
    knot.push(part(flipped(room(DVec3::splat(0.3), dvec3(0.6, 0.300001, 0.6))), 1.0, 0.0));
    knot.push(part(unit_room(), 0.5, 1e-30));
    let far = moved(&load("cornell-box"), 1e-6, DVec3::splat(500.0));
    for scene in [nearly_white, scene(&knot), far] {
        let one = run(&scene, 1);
        for threads in [2, 7, 64] {
            assert!(run(&scene, threads) == one, "{threads} threads");
        }
    }
}

/// Emission too weak to count beside others, and reflectances from 0 to 1 in one furnace: B is 1 on all of them.
#[test]
fn materials_side_by_side() {
    let material = |rho: f64, be: f64| Material::new("m", [rho; 3], [be / PI; 3]);
    let triangles: Vec<(Corners, u32)> = unit_room().into_iter().zip((0..6).flat_map(|k| [k, k])).collect();
    let rho = [0.0, 1e-300, 1e-9, 0.5, 1.0, 1.0 - 1e-9];
    let be = rho.map(|rho: f64| 1.0 - rho);
    let scene = Scene::new(&triangles, rho.iter().zip(&be).map(|(&r, &b)| material(r, b)).collect());
    let lit = solved(scene, Subdivision::Count(200));
    let off = worst(&lit.solution.radiosity, 1.0);
    println!("reflectances from 0 to 1 side by side: off by {off:.1e}");
    assert!(off <= 1e-9, "{off:e}");
}
