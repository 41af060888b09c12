//! Escape of light through small openings, against exact form factors. In convex surroundings with an opening all
//! patches see each other, and the light that a row of form factors lacks to one escapes.

use crate::common::*;
use glam::DVec3;
use radiosity::{
    Progress,
    accuracy::{
        error_bars::T_QUANTILE,
        refinement::{Plan, begin, refine},
        solved::Solved,
    },
    energy::EnergyLedger,
    form_factor::{CastOptions, Estimator, FormFactors, exact::polygon_exchange_area},
    patch::{Patches, Subdivision},
    solve::{Radiometry, SolveOptions, solve},
    trace::Tracer,
};

/// Seeds per case.
const SEEDS: u64 = 12;

/// A sphere of facets without the lowest ones. The highest six emit.
fn sphere(missing: usize) -> (Vec<Corners>, Vec<bool>) {
    let mut facets = flipped(icosphere(1.0, 2));
    let height = |[a, b, c]: &Corners| (*a + *b + *c).z;
    facets.sort_by(|p, q| height(q).total_cmp(&height(p)));
    facets.truncate(facets.len() - missing);
    let lamps = (0..facets.len()).map(|k| k < 6).collect();
    (facets, lamps)
}

/// A room of 4 x 3 x 5 m whose sides are cut into 5 x 5 cells. One cell is missing. The middle of the ceiling emits.
fn room_with_window() -> (Vec<Corners>, Vec<bool>) {
    const CELLS: usize = 5;
    let (mut triangles, mut lamps) = (Vec::new(), Vec::new());
    for (side, face) in room_faces(DVec3::ZERO, DVec3::new(4.0, 3.0, 5.0)).iter().enumerate() {
        let [corner, along, across] = face[0];
        let (u, v) = ((along - corner) / CELLS as f64, (across - along) / CELLS as f64);
        for cell in 0..CELLS * CELLS {
            let at = corner + u * (cell % CELLS) as f64 + v * (cell / CELLS) as f64;
            // The ceiling is the last side. The window is in the first.
            if (side, cell) != (0, 7) {
                triangles.extend(rectangle(at, u, v));
                lamps.extend([side == 5 && cell == 12; 2]);
            }
        }
    }
    (triangles, lamps)
}

struct Truth {
    form_factors: FormFactors,
    lamps: Vec<bool>,
    triangles: Vec<Corners>,
}

impl Truth {
    fn of((triangles, lamps): (Vec<Corners>, Vec<bool>)) -> Truth {
        let form_factors = convex_form_factors(&triangles, false);
        Truth { form_factors, lamps, triangles }
    }

    /// Irradiance of all patches, and the share of the emitted power that escapes.
    fn light(&self, rho: f64) -> (Vec<f64>, f64) {
        let emission: Vec<f64> = self.lamps.iter().map(|&lamp| f64::from(u8::from(lamp))).collect();
        let reflectance = vec![rho; emission.len()];
        let light = Radiometry { channels: 1, emission: &emission, reflectance: &reflectance };
        let solution = solve(&self.form_factors, light, &SolveOptions::default(), &Progress::new()).unwrap();
        let ledger = EnergyLedger::of(&self.form_factors, light, &solution);
        (solution.irradiance, ledger.escaped[0] / ledger.emitted[0])
    }

    fn scene(&self, rho: f64) -> radiosity::Scene {
        let parts: Vec<Part> = (self.triangles.iter().zip(&self.lamps))
            .map(|(&t, &lamp)| part(vec![t], rho, f64::from(u8::from(lamp))))
            .collect();
        scene(&parts)
    }
}

fn whole(estimator: Estimator, rays: f64, seed: u64, scene: &radiosity::Scene) -> Solved {
    let cast = CastOptions::default().with_rays(rays).with_seed(seed).with_estimator(estimator);
    let whole = Subdivision::Edge(f64::INFINITY);
    // The truths are those of constant light on each triangle.
    let options = SolveOptions::default().with_linear(false);
    Solved::new(scene, &Tracer::new(scene), &whole, &cast, &options, &Progress::new()).unwrap()
}

/// The share of the power that escapes, its standard error, and the share of patches within their 95 % intervals.
fn measure(solved: &Solved, irradiance: &[f64]) -> [f64; 3] {
    let ledger = EnergyLedger::of(&solved.form_factors, &solved.patches, &solved.solution);
    let bars = &solved.error_bars;
    let within = (0..irradiance.len())
        .filter(|&i| {
            (solved.solution.irradiance[i] - irradiance[i]).abs() <= T_QUANTILE * bars.standard_error[i]
        })
        .count();
    let emitted = ledger.emitted[0];
    assert!(ledger.imbalance().abs() <= 1e-9, "{}", ledger.imbalance());
    [ledger.escaped[0] / emitted, bars.of_escaped[0] / emitted, within as f64 / irradiance.len() as f64]
}

/// Compares the escaped power of several seeds with the truth, and returns the share of patches within their intervals.
///
/// The mean is within four standard errors, as the seeds report them, plus an error of second order. A patch with too
/// many escaping rays is darker by as much, so that its escaped power lacks ρ / R of itself with R hemisphere rays. At
/// least a quarter of a patch's rays are hemisphere rays. Standard errors have 15 degrees of freedom: the root mean
/// square of twelve errors over their standard errors is 1.07 on average, and at most 1.6 in 97.5 % of cases. If most
/// light escapes, standard errors are up to four times too long.
fn compare(name: &str, found: &[[f64; 3]], wanted: f64, rho: f64, rays: f64) -> f64 {
    let many = found.len() as f64;
    let mean = |value: &dyn Fn(&[f64; 3]) -> f64| found.iter().map(value).sum::<f64>() / many;
    let (escaped, within) = (mean(&|f| f[0]), mean(&|f| f[2]));
    let squares = mean(&|f| f[1].powi(2));
    let error = (squares / many).sqrt();
    let ratio = (mean(&|f| (f[0] - wanted).powi(2)) / squares).sqrt();
    println!(
        "{name}, rho {rho}, {rays} rays: {escaped:.5} for {wanted:.5}: {:+.2} ± {:.2} %, errors over standard errors \
         {ratio:.2}, {:.1} % within",
        100.0 * (escaped / wanted - 1.0),
        100.0 * error / wanted,
        100.0 * within
    );
    let slack = wanted * rho / (0.25 * rays);
    assert!((escaped - wanted).abs() <= 4.0 * error + slack, "{name}: {escaped} ± {error} for {wanted}");
    assert!(ratio > 0.2 && ratio < 1.8, "{name}: errors are {ratio} of their standard errors");
    within
}

/// Checks the escaped power at three reflectances, and at the lowest also the intervals of patches. If light is reflected
/// more often, the error that all patches share is so large that twelve seeds do not measure how often intervals hold.
fn check(name: &str, shape: (Vec<Corners>, Vec<bool>)) {
    let truth = Truth::of(shape);
    for rho in [0.8, 0.95, 0.99] {
        let (scene, (irradiance, escaped)) = (truth.scene(rho), truth.light(rho));
        for rays in [64.0, 256.0] {
            let one = |seed| measure(&whole(Estimator::Pooled, rays, seed, &scene), &irradiance);
            let within = compare(name, &(0..SEEDS).map(one).collect::<Vec<_>>(), escaped, rho, rays);
            assert!(rho > 0.8 || (0.91..=0.985).contains(&within), "{name}: {within} within");
        }
    }
}

/// A sphere without 0.6 % of its surface: nearly all light is reflected many times before it escapes.
#[test]
fn a_sphere_with_a_small_port() {
    check("port of 0.6 %", sphere(2));
}

/// A sphere without 5 % of its surface.
#[test]
fn a_sphere_with_a_large_port() {
    check("port of 5 %", sphere(16));
}

/// A room with one cell missing in a wall.
#[test]
fn a_room_with_a_window() {
    check("window", room_with_window());
}

/// Sampling in rounds until an error is reached depends on earlier results. The escaped power must stay unbiased.
#[test]
fn a_wanted_error_leaves_the_escaped_power_unbiased() {
    let (truth, rho) = (Truth::of(sphere(2)), 0.9);
    let (scene, (irradiance, escaped)) = (truth.scene(rho), truth.light(rho));
    let tracer = Tracer::new(&scene);
    let plan = Plan::default().with_error(Some(0.002));
    let one = |seed| {
        let patches = Patches::subdivide(&scene, &Subdivision::Edge(f64::INFINITY));
        let cast = CastOptions::default().with_rays(64.0).with_seed(seed);
        let (options, progress) = (SolveOptions::default().with_linear(false), Progress::new());
        let first = begin(&scene, &tracer, patches, &cast, &options, None, &progress).unwrap();
        let next = |_: &Solved, rounds: &[_]| Ok(plan.next(rounds));
        measure(&refine(&scene, &tracer, first, &options, next, &progress).unwrap().0, &irradiance)
    };
    compare("error of 0.2 %", &(0..SEEDS).map(one).collect::<Vec<_>>(), escaped, rho, 64.0);
}

/// If all patches emit, the estimate from both ends of a ray is no worse than the one-way estimate.
#[test]
fn where_all_emit_both_directions_are_no_worse_than_one() {
    let sides = room_faces(DVec3::ZERO, DVec3::new(4.0, 3.0, 5.0));
    let cells: Vec<Vec<Corners>> = sides
        .iter()
        .map(|face| {
            let [corner, along, across] = face[0];
            let (u, v) = ((along - corner) / 4.0, (across - along) / 4.0);
            (0..16)
                .flat_map(|k| rectangle(corner + u * f64::from(k % 4) + v * f64::from(k / 4), u, v))
                .collect()
        })
        .collect();
    let triangles = cells.concat();
    let truth = Truth::of((triangles.clone(), vec![true; triangles.len()]));
    let emits = |i: usize| 0.2 + ((i * 37) % 11) as f64 / 10.0;
    let emission: Vec<f64> = (0..triangles.len()).map(emits).collect();
    let reflectance = vec![0.5; emission.len()];
    let light = Radiometry { channels: 1, emission: &emission, reflectance: &reflectance };
    let wanted =
        solve(&truth.form_factors, light, &SolveOptions::default(), &Progress::new()).unwrap().irradiance;
    let parts: Vec<Part> =
        triangles.iter().zip(&emission).map(|(&t, &emission)| part(vec![t], 0.5, emission)).collect();
    let scene = scene(&parts);
    for rays in [64.0, 256.0] {
        let [one_way, pooled] = [Estimator::OneWay, Estimator::Pooled].map(|estimator| {
            let squares = (0..8).map(|seed| {
                let found = whole(estimator, rays, seed, &scene).solution.irradiance;
                found.iter().zip(&wanted).map(|(e, truth)| (e / truth - 1.0).powi(2)).sum::<f64>()
            });
            (squares.sum::<f64>() / (8 * wanted.len()) as f64).sqrt()
        });
        println!("{rays} rays: one-way {one_way:.5}, pooled {pooled:.5}");
        // From eight times 192 errors each root mean square is known to 2 %.
        assert!(pooled <= 1.06 * one_way, "pooled {pooled}, one-way {one_way}");
    }
}

/// A terrain of 512 facets that all emit, alike or up to six times as much as others, in the open. What other facets emit is
/// a small part of what hemisphere rays find out, so that shadow rays would only be missing. The estimate from both ends
/// of a ray is no worse than the one-way estimate, and its error bars are right.
#[test]
fn a_terrain_that_emits_everywhere() {
    const CELLS: usize = 16;
    let at = |x: usize, y: usize| {
        let (x, y) = (x as f64 / CELLS as f64, y as f64 / CELLS as f64);
        DVec3::new(x, y, 0.08 * (11.0 * x + 3.0 * y).sin() + 0.06 * (13.0 * y - 5.0 * x).cos())
    };
    let of_cell = |k: usize| {
        let (x, y) = (k % CELLS, k / CELLS);
        let [a, b, c, d] = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
        [[a, b, c], [a, c, d]]
    };
    let triangles: Vec<Corners> = (0..CELLS * CELLS).flat_map(of_cell).collect();
    for (emits, rho) in [(0.0, 0.0), (1.0, 0.5)] {
        let emission = |i: usize| 0.2 + emits * ((i * 37) % 11) as f64 / 10.0;
        let parts: Vec<Part> =
            triangles.iter().enumerate().map(|(i, &t)| part(vec![t], rho, emission(i))).collect();
        let scene = scene(&parts);
        let truth = whole(Estimator::OneWay, 16384.0, 99, &scene).solution.irradiance;
        let mean = truth.iter().sum::<f64>() / truth.len() as f64;
        let [one_way, pooled] = [Estimator::OneWay, Estimator::Pooled].map(|estimator| {
            let (mut squares, mut estimated) = (0.0, 0.0);
            for seed in 0..4 {
                let found = whole(estimator, 256.0, seed, &scene);
                let errors = found.solution.irradiance.iter().zip(&truth).map(|(e, truth)| e - truth);
                squares += errors.map(|off| off * off).sum::<f64>();
                estimated += found.error_bars.standard_error.iter().map(|e| e * e).sum::<f64>();
            }
            [squares, estimated].map(|sum| (sum / (4 * truth.len()) as f64).sqrt() / mean)
        });
        println!("emission differs by {emits}: one-way {one_way:.4?}, pooled {pooled:.4?}");
        // From 2,048 errors each root mean square is known to 2 %.
        assert!(pooled[0] <= 1.06 * one_way[0], "pooled {pooled:?}, one-way {one_way:?}");
        assert!((0.85..1.2).contains(&(pooled[1] / pooled[0])), "pooled {pooled:?}");
    }
}

/// A lamp above a black grille whose cells are as high as wide. The share of its light that escapes is the form factor
/// between opposite faces of a cube. Cut along the blades, the lamp becomes hundreds of small ones: a blade sees two of
/// them in full and most not at all. The tolerance is four standard errors.
#[test]
fn a_lamp_cut_by_the_grille_below_it() {
    const CELLS: usize = 8;
    let cell = 1.0 / CELLS as f64;
    let along =
        |k: usize, u: DVec3, v: DVec3| rectangle(u * (k as f64 * cell - 0.5) - v * 0.5, v, DVec3::Z * cell);
    let blades =
        (0..=CELLS).flat_map(|k| [along(k, DVec3::X, DVec3::Y), along(k, DVec3::Y, DVec3::X)].concat());
    let mut scene = scene(&[part(level_square(1.0, cell, false), 0.0, 1.0), black(blades.collect())]);
    scene.cut_contacts();
    let square = |z: f64, up: bool| level_square(1.0, z, up);
    let pairs =
        square(0.0, true).into_iter().flat_map(|p| square(1.0, false).into_iter().map(move |q| [p, q]));
    let wanted: f64 = pairs.map(|[p, q]| polygon_exchange_area(&p, &q)).sum();
    assert!((wanted - 0.199825).abs() < 1e-6, "{wanted}");
    let found: Vec<[f64; 3]> =
        (0..2).map(|seed| measure(&whole(Estimator::Pooled, 256.0, seed, &scene), &[])).collect();
    let escaped = found.iter().map(|f| f[0]).sum::<f64>() / 2.0;
    let error = (found.iter().map(|f| f[1].powi(2)).sum::<f64>() / 4.0).sqrt();
    println!("{escaped:.5} ± {error:.5} for {wanted:.5}");
    assert!((escaped - wanted).abs() <= 4.0 * error && error < 0.01 * wanted, "{escaped} ± {error}");
}
