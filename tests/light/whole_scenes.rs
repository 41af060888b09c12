//! Whole solutions against scenes whose light is known.

use std::f64::consts::PI;

use crate::common::*;
use glam::{DVec2, DVec3, dvec2};
use radiosity::{
    Progress, Scene,
    accuracy::error_bars::ErrorBars,
    energy::EnergyLedger,
    form_factor::{
        CastOptions, Estimator, FormFactors,
        exact::{Axis, AxisRectangle},
    },
    patch::Subdivision,
    scene::{Material, Texture, TextureMap},
    solve::{Radiometry, Solution, SolveOptions, Solver, solve},
};

fn solved<'a>(f: &FormFactors, light: impl Into<Radiometry<'a>>) -> Solution {
    solve(f, light, &SolveOptions::default(), &Progress::new()).unwrap()
}

fn grey<'a>(emission: &'a [f64], reflectance: &'a [f64]) -> Radiometry<'a> {
    Radiometry { channels: 1, emission, reflectance }
}

fn bars(cast: &Cast, solution: &Solution) -> Vec<f64> {
    ErrorBars::of(&cast.form_factors, &cast.patches, solution).unwrap().standard_error
}

/// Asserts B = 1 within the certified bound of the solver and the error that row sums other than 1 add with every
/// bounce. The rounding of the sums is 1e-15 of some hundred terms.
#[track_caller]
fn assert_furnace(f: &FormFactors, solution: &Solution, most: f64, slack: f64) {
    let closure = deviations(f).0 * most / (1.0 - most);
    let tolerance = solution.error_bound + closure + slack + 1e-13;
    for (i, b) in solution.radiosity.iter().enumerate() {
        assert!((b - 1.0).abs() <= tolerance, "B[{i}] = {b}, tolerance {tolerance:e}");
    }
}

/// A closed room with Be = 1 - ρ = 0.5 has B = 1 everywhere.
#[test]
fn the_furnace_is_evenly_bright() {
    let room = cast(load("furnace"), Subdivision::Count(500), CastOptions::default());
    let solution = solved(&room.form_factors, &room.patches);
    // Be is 0.5 up to rounding.
    assert_furnace(&room.form_factors, &solution, 0.5, 1e-15);
}

/// Closed scenes with any reflectances, occluders and textures have B = 1 if each patch emits as much as it absorbs.
/// One-way rows sum to one as well.
#[test]
fn what_emits_as_it_absorbs_is_white() {
    for name in ["furnace", "door-ajar", "textured"] {
        for estimator in BOTH {
            // Without shadow rays all light goes by form factors, so the same ones serve any emission.
            let options = CastOptions::default().with_estimator(estimator).with_shadow_share(0.0);
            let room = cast(load(name), Subdivision::Count(500), options);
            let (n, mut random) = (room.patches.len(), Random::new(12));
            let patterns = [
                (0..n).map(|_| random.between(0.0, 0.97)).collect::<Vec<_>>(),
                // The reflectances of the file, with textures averaged over each patch.
                room.patches.reflectance().iter().step_by(room.patches.channels()).copied().collect(),
            ];
            for reflectance in patterns {
                let emission: Vec<f64> = reflectance.iter().map(|rho| 1.0 - rho).collect();
                let solution = solved(&room.form_factors, grey(&emission, &reflectance));
                assert_furnace(&room.form_factors, &solution, 0.97, 0.0);
            }
        }
    }
}

fn linear(texel: u8) -> f64 {
    let c = f64::from(texel) / 255.0;
    if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
}

/// A cube papered with 8 by 8 random greys. The emission map has the texels nearest to 1 - ρ, whose error is at most
/// half a step of 8 bits. B is 1 up to that error over 1 - ρ.
#[test]
fn a_textured_furnace() {
    let mut random = Random::new(3);
    let dark: Vec<u8> = (0..64).map(|_| random.between(0.0, 230.0) as u8).collect();
    let nearest = |value: f64| {
        let off = |t: &u8| (linear(*t) - value).abs();
        (0..=255).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap()
    };
    let bright: Vec<u8> = dark.iter().map(|&t| nearest(1.0 - linear(t))).collect();
    let missed = dark.iter().zip(&bright).map(|(&a, &b)| (linear(a) + linear(b) - 1.0).abs());
    let missed = missed.fold(0.0, f64::max);
    // The steps are largest at white: 2.4 / 1.055 / 255.
    assert!(missed > 0.0 && missed <= 0.5 * 2.4 / 1.055 / 255.0, "{missed}");

    let paper = |texels: &[u8]| Texture::new(8, 8, texels.iter().flat_map(|&t| [t; 3]).collect());
    let mut material = Material::new("paper", [1.0; 3], [1.0 / PI; 3]);
    material.reflectance_map = Some(TextureMap::new(0));
    material.emission_map = Some(TextureMap::new(1));
    let corners: Vec<(Corners, u32)> = room(DVec3::ZERO, DVec3::ONE).into_iter().map(|t| (t, 0)).collect();
    let mut papered = Scene::new(&corners, vec![material]);
    papered.textures = vec![paper(&dark), paper(&bright)];
    // Not aligned with the texels, and repeated.
    let square = [dvec2(0.1, 0.0), dvec2(1.3, 0.2), dvec2(1.1, 1.7), dvec2(-0.1, 1.5)];
    papered.texcoords = (0..12)
        .map(|t| {
            if t % 2 == 0 { [0, 1, 2] } else { [0, 2, 3] }.map(|k: usize| square[k] + DVec2::X * t as f64)
        })
        .collect();

    let room = cast(papered, Subdivision::Edge(0.3), CastOptions::default());
    assert_eq!(room.patches.channels(), 1);
    let most = room.patches.reflectance().iter().copied().fold(0.0, f64::max);
    let least = room.patches.reflectance().iter().copied().fold(1.0, f64::min);
    assert!(most - least > 0.1, "the pattern shows in the patches");
    let solution = solved(&room.form_factors, &room.patches);
    assert_furnace(&room.form_factors, &solution, most, missed / (1.0 - most));
}

/// Be and ρ of the patches of a sphere: emission within 30 degrees of the pole, one bright and one dark half.
fn sphere_pattern(triangles: &[Corners]) -> (Vec<f64>, Vec<f64>) {
    let height = |[a, b, c]: &Corners| (*a + *b + *c).normalize().z;
    let emission = triangles.iter().map(|t| if height(t) > (PI / 6.0).cos() { 1.0 } else { 0.0 });
    let reflectance = triangles.iter().map(|t| if height(t) > 0.0 { 0.8 } else { 0.2 });
    (emission.collect(), reflectance.collect())
}

/// E = Φ / (A - ∫ρ dA) at every point of a sphere, for any pattern. In a polyhedron the RMS deviation from that falls
/// with the square of the size of facets in the end. It is measured with exact form factors, because it soon drops
/// below the noise of rays. Form factors by rays are then compared with the exact ones, patch by patch, in standard
/// errors: the RMS of 80 or 320 z-scores with 15 degrees of freedom is sqrt(15/13) = 1.07 with a standard deviation of
/// 10 or 5 %.
#[test]
fn the_inside_of_a_sphere() {
    let mut deviations = Vec::new();
    for level in 0..3 {
        let sphere = flipped(icosphere(1.0, level));
        let (emission, reflectance) = sphere_pattern(&sphere);
        let f = convex_form_factors(&sphere, true);
        let exact = solved(&f, grey(&emission, &reflectance));
        let sum = |x: &dyn Fn(usize) -> f64| (0..sphere.len()).map(|i| f.areas()[i] * x(i)).sum::<f64>();
        let even = sum(&|i| emission[i]) / sum(&|i| 1.0 - reflectance[i]);
        let squares = sum(&|i| (exact.irradiance[i] / even - 1.0).powi(2));
        deviations.push((squares / sum(&|_| 1.0)).sqrt());
        if level == 0 {
            continue;
        }

        let parts: Vec<Part> =
            (0..sphere.len()).map(|i| part(vec![sphere[i]], reflectance[i], emission[i])).collect();
        let cast = cast_whole(&parts, 512.0, Estimator::Pooled, 1);
        let solution = solved(&cast.form_factors, &cast.patches);
        let errors = bars(&cast, &solution);
        let z = |i: usize| (solution.irradiance[i] - exact.irradiance[i]) / errors[i];
        let rms = ((0..sphere.len()).map(|i| z(i).powi(2)).sum::<f64>() / sphere.len() as f64).sqrt();
        println!("level {level}: RMS of z {rms}");
        assert!(rms > 0.6 && rms < 1.5, "level {level}: RMS of z {rms}");
    }
    println!("{deviations:?}");
    // The order rises to 2 with the level, and is nearer to 2 than to 1 between the last two.
    let [coarse, fine] = [0, 1].map(|k| (deviations[k] / deviations[k + 1]).log2());
    assert!(fine > 1.5 && fine > coarse, "orders {coarse}, {fine} of {deviations:?}");
}

/// Form factors by rays on zones that follow the pattern. Facets have smaller areas than the sphere, so the mean
/// irradiance deviates by O(h²): half of h gives a quarter of the deviation. Energy conservation leaves little noise in
/// the mean.
#[test]
fn a_tessellated_sphere_converges_to_the_true_one() {
    let truth = 0.1339745962;
    let measured: Vec<Measured> = [6, 12, 24]
        .into_iter()
        .map(|rings| {
            let sectors = 2 * rings;
            let bands = [
                part(zone(0.0, PI / 6.0, rings / 6, sectors), 0.8, 1.0),
                part(zone(PI / 6.0, PI / 2.0, rings / 3, sectors), 0.8, 0.0),
                part(zone(PI / 2.0, PI, rings / 2, sectors), 0.2, 0.0),
            ];
            let sphere = cast_whole(&bands, 1024.0, Estimator::Pooled, 2);
            assert_eq!(sphere.patches.len(), sphere.patches.fronts());
            let solution = solved(&sphere.form_factors, &sphere.patches);
            let errors = bars(&sphere, &solution);
            let all: Vec<usize> = (0..sphere.patches.len()).collect();
            sphere.mean(&all, &solution.irradiance, &errors)
        })
        .collect();
    println!("{measured:?}");
    let off: Vec<f64> = measured.iter().map(|m| (m.value - truth).abs()).collect();
    for k in 0..2 {
        // A quarter, and the neglected h⁴ term: at most a quarter of that again, at 30 degrees.
        let wanted = off[k] / 4.0 * 1.25 + T15 * (measured[k].error / 4.0 + measured[k + 1].error);
        assert!(off[k + 1] <= wanted, "{off:?}");
    }
    // Extrapolation removes the leading term.
    let extrapolated = (4.0 * measured[2].value - measured[1].value) / 3.0;
    let error = (4.0 * measured[2].error + measured[1].error) / 3.0;
    assert!((extrapolated - truth).abs() <= T15 * error + off[2] / 4.0, "{extrapolated} instead of {truth}");
}

/// Two similar polyhedra have the form factors of spheres for any number of facets. So the means over both have only
/// sampling errors, which error bars describe to first order. To second order there is a bias: a patch of the outer
/// sphere that sees too much of the inner one by chance is brighter, and the inner one sees it more. With
/// dE = (B1 - B2) dF21, which has the standard error of the patch, the irradiance of the inner sphere gains ρ2 mean(dE
/// dF21) / F21 on average. Twice that is allowed.
#[test]
fn concentric_spheres() {
    let (truth, rho) = ([1.08910891, 0.29702970], [0.3, 0.6]);
    for level in [1, 2, 3] {
        let parts =
            [part(icosphere(0.5, level), rho[0], 1.0), part(flipped(icosphere(1.0, level)), rho[1], 0.0)];
        let spheres = cast_whole(&parts, 512.0, Estimator::Pooled, 4);
        let solution = solved(&spheres.form_factors, &spheres.patches);
        let errors = bars(&spheres, &solution);
        let squares: Vec<f64> = errors.iter().map(|e| e * e).collect();
        let square = spheres.mean(&spheres.of_part(1), &squares, &squares).value;
        let gain = 2.0 * rho[1] * square / (truth[0] - truth[1]) / 0.25;
        // Conservation: the outer sphere, of four times the area, lacks what the inner one absorbs too much.
        let gains = [gain, gain * (1.0 - rho[0]) / (4.0 * (1.0 - rho[1]))];
        for k in 0..2 {
            let b = spheres.mean(&spheres.of_part(k as u32), &solution.radiosity, &errors);
            println!("level {level}: {b:?} for {}", truth[k]);
            // Eight digits are given.
            let measured = Measured { value: b.value, error: rho[k] * b.error };
            measured.assert_is(truth[k], rho[k] * gains[k] + 1e-8);
        }
    }
}

/// Plates of 16, 32 and 64 distances. Their middle lacks the light from beyond the edges, of the order of L⁻². Without
/// that term the last two agree with endless plates to the next order, L⁻⁴. The change between extrapolations is 15
/// times the rest.
#[test]
fn endless_parallel_plates() {
    let (be, rho) = ([1.0, 0.25], [0.5, 0.8]);
    let truth = [0, 1].map(|k| (be[k] + rho[k] * be[1 - k]) / (1.0 - rho[0] * rho[1]));
    let middle = |length: f64| {
        const N: usize = 15;
        let cell = |u: usize, v: usize, positive| {
            let at = |m: usize| (m as f64 / N as f64 - 0.5) * length;
            let (min, max) = ([at(u), at(v)], [at(u + 1), at(v + 1)]);
            AxisRectangle { axis: Axis::Z, positive, offset: if positive { 0.0 } else { 1.0 }, min, max }
        };
        // What two cells exchange depends on their distance only.
        let first = cell(0, 0, true);
        let by_distance: Vec<f64> =
            (0..N * N).map(|k| first.exchange_area(&cell(k / N, k % N, false)) / first.area()).collect();
        let one = N * N;
        let exchanged = |i: usize, j: usize| {
            let (k, l) = (i % one, j % one);
            let distance = (k / N).abs_diff(l / N) * N + (k % N).abs_diff(l % N);
            if (i < one) == (j < one) { 0.0 } else { by_distance[distance] }
        };
        let escaped =
            (0..2 * one).map(|i| 1.0 - (0..2 * one).map(|j| exchanged(i, j)).sum::<f64>()).collect();
        let f = FormFactors::from_exchange(store(2 * one, exchanged), vec![1.0; 2 * one], escaped);
        let both = |x: [f64; 2]| (0..2 * one).map(|i| x[i / one]).collect::<Vec<_>>();
        let b = solved(&f, grey(&both(be), &both(rho))).radiosity;
        [b[one / 2], b[one + one / 2]]
    };
    let [a, b, c] = [16.0, 32.0, 64.0].map(middle);
    for k in 0..2 {
        let (first, second) = ((4.0 * b[k] - a[k]) / 3.0, (4.0 * c[k] - b[k]) / 3.0);
        println!("{} {} {} -> {first} {second} for {}", a[k], b[k], c[k], truth[k]);
        assert!(a[k] < b[k] && b[k] < c[k] && c[k] < truth[k]);
        assert!((second - truth[k]).abs() <= (second - first).abs(), "{second} instead of {}", truth[k]);
        assert!((second - truth[k]).abs() <= 0.25 * (truth[k] - c[k]));
    }
}

/// emitted - absorbed - escaped = solver_part + reciprocity_part, for any matrix and however poor the solution. Sums of
/// some thousand terms round at 1e-13 of the largest.
#[test]
fn the_ledger_splits_exactly() {
    for (name, estimator, tolerance) in ["cornell-box", "furnace", "door-ajar"]
        .into_iter()
        .flat_map(|name| BOTH.map(|e| (name, e)))
        .flat_map(|(name, e)| [1e-10, 1e-1].map(|t| (name, e, t)))
    {
        let room =
            cast(load(name), Subdivision::Count(500), CastOptions::default().with_estimator(estimator));
        let options = SolveOptions::default().with_solver(Solver::GaussSeidel).with_tolerance(tolerance);
        let solution = solve(&room.form_factors, &room.patches, &options, &Progress::new()).unwrap();
        let ledger = EnergyLedger::of(&room.form_factors, &room.patches, &solution);
        assert_eq!(ledger.emitted.len(), room.patches.channels());
        for c in 0..room.patches.channels() {
            let left = ledger.emitted[c] - ledger.absorbed[c] - ledger.escaped[c];
            let parts = ledger.solver_part[c] + ledger.reciprocity_part[c];
            assert!(
                (left - parts).abs() <= 1e-12 * ledger.emitted[c],
                "{name} {estimator:?}: {left} {parts}"
            );
            assert!(ledger.absorbed[c] > 0.0);
            assert_eq!(ledger.escaped[c] > 0.0, name == "cornell-box", "{name}");
        }
        assert!(ledger.relative_solver_part().abs() <= tolerance);
        // Rows are closed to 1e-13, which counts for each bounce of the radiosity: at most ten here. Rows of one-way form
        // factors sum to one as well, but without reciprocity light is lost or made.
        if estimator == Estimator::Pooled {
            let reciprocity = ledger.relative_reciprocity_part().abs();
            assert!(reciprocity <= 1e-11, "{name}: {reciprocity:e}");
        }
    }
}

/// With default options the energy balances to the tolerance of the solver.
#[test]
fn by_default_energy_balances() {
    for name in ["cornell-box", "furnace", "door-ajar", "textured"] {
        let room = cast(load(name), Subdivision::Count(500), CastOptions::default());
        let solution = solved(&room.form_factors, &room.patches);
        let ledger = EnergyLedger::of(&room.form_factors, &room.patches, &solution);
        assert!(ledger.imbalance().abs() <= 1e-9, "{name}: {:e}", ledger.imbalance());
        assert!(ledger.relative_solver_part().abs() <= 1e-10);
    }
}

/// A scene without colours has one channel, and its power is Be times the area. A coloured scene has three.
#[test]
fn grey_scenes_have_one_channel() {
    let room = cast(load("furnace"), Subdivision::Edge(1.0), CastOptions::default());
    let solution = solved(&room.form_factors, &room.patches);
    assert_eq!((room.patches.channels(), solution.channels), (1, 1));
    assert_eq!(solution.radiosity.len(), room.patches.len());
    let ledger = EnergyLedger::of(&room.form_factors, &room.patches, &solution);
    assert_eq!(ledger.emitted.len(), 1);
    // Be = 1/2 everywhere.
    let total: f64 = room.form_factors.areas().iter().sum();
    assert!((ledger.emitted[0] / total - 0.5).abs() < 1e-14);
    let coloured = cast(load("cornell-box"), Subdivision::Count(100), CastOptions::default());
    assert_eq!(coloured.patches.channels(), 3);
    assert_eq!(coloured.patches.emission().len(), 3 * coloured.patches.len());
}

/// Emitting triangles with corners on a small grid touch, cross and cover each other. None of these scenes panics, and
/// their light is finite and balances.
#[test]
fn lamps_that_touch_or_cross_are_solved() {
    let mut random = Random::new(7);
    let mut corner = || DVec3::from([0; 3].map(|_| random.between(0.0, 3.0).floor()));
    let mut scenes = 0;
    while scenes < 40 {
        let triangles: Vec<Corners> = (0..2 + scenes % 6).map(|_| [0; 3].map(|_| corner())).collect();
        if triangles.iter().any(|t| area(&[*t]) == 0.0) {
            continue;
        }
        scenes += 1;
        let lit = cast_whole(&[part(triangles, 0.5, 1.0)], 16.0, Estimator::Pooled, 3);
        let solution = solved(&lit.form_factors, &lit.patches);
        assert!(solution.irradiance.iter().all(|e| e.is_finite() && *e >= 0.0), "scene {scenes}");
        let ledger = EnergyLedger::of(&lit.form_factors, &lit.patches, &solution);
        assert!(ledger.imbalance().abs() <= 1e-9, "scene {scenes}: {:e}", ledger.imbalance());
        assert_eq!(lit.form_factors.out_of_range(), 0, "scene {scenes}");
    }
}
