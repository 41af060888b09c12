//! Tracing and form factors on degenerate triangles: slivers, folds, doubles, flat bodies.

use crate::common::*;
use glam::{DVec3, Vec3A, dvec3};
use radiosity::{
    Scene, form_factor::CastOptions, patch::Subdivision, scene::inspection::Inspection, trace::Tracer,
};

fn point(random: &mut Random) -> DVec3 {
    DVec3::from_array([0; 3].map(|_| random.between(-1.0, 1.0)))
}

/// A number from 10^`low` to 1. All magnitudes are equally likely.
fn magnitude(random: &mut Random, low: f64) -> f64 {
    10f64.powf(random.between(low, 0.0))
}

/// A closed body around the origin: a flattened tetrahedron whose faces are split at points that may lie close to an
/// edge or a corner. Splits keep all edges, so the surface stays closed.
fn body(random: &mut Random) -> Vec<Corners> {
    let flat = dvec3(1.0, 1.0, magnitude(random, -4.0));
    let corners = loop {
        let c: [DVec3; 4] = std::array::from_fn(|_| point(random));
        let middle = c.iter().sum::<DVec3>() / 4.0;
        let c = c.map(|p| p - middle);
        // Not too flat yet: flattening comes after.
        if (c[1] - c[0]).cross(c[2] - c[0]).dot(c[3] - c[0]) > 0.5 {
            break c.map(|p| p * flat);
        }
    };
    let [a, b, c, d] = corners;
    let mut faces = vec![[a, b, c], [a, c, d], [a, d, b], [b, d, c]];
    for _ in 0..12 {
        let [p, q, r] = faces.swap_remove((random.next() * faces.len() as f64) as usize);
        let (u, v) = (0.5 * magnitude(random, -6.0), 0.5 * magnitude(random, -6.0));
        let split = p * (1.0 - u - v) + q * u + r * v;
        faces.extend([[p, q, split], [q, r, split], [r, p, split]]);
    }
    faces
}

/// A closed surface stops every ray from inside: the crossings of a ray, front against back, add up to the winding
/// number of the surface around the origin, which is one. Rays also aim at vertices and edges. There the triangle test
/// decides by the sign of one rounded number, which both neighbours share.
#[test]
fn closed_bodies_of_slivers_hold_every_ray() {
    let mut random = Random::new(31);
    let mut rays = 0;
    for _ in 0..300 {
        let scene = scene(&[black(body(&mut random))]);
        // A split may fall on a corner or make a face without area. The rest need not be closed then.
        if scene.degenerate > 0 || !is_closed(&scene) {
            continue;
        }
        let tracer = Tracer::new(&scene);
        let origin = tracer.to_unit(DVec3::ZERO);
        let mut targets: Vec<Vec3A> = Vec::new();
        for triangle in tracer.triangles() {
            let [a, b, c] = triangle.corners;
            targets.extend([a, b, c, (a + b) * 0.5, a * 0.3 + b * 0.7, (a + b + c) / 3.0]);
        }
        targets.extend((0..200).map(|_| origin + point(&mut random).as_vec3a()));
        for target in targets {
            assert!(tracer.closest(origin, target - origin).is_some(), "{target} {:?}", tracer.triangles());
            rays += 1;
        }
    }
    assert!(rays > 50_000, "{rays}");
}

/// Triangles from well-shaped ones to slivers of 10⁻⁷. Some are repeated, inverted, folded back over an edge, or have a
/// corner moved by a rounding.
fn knot(random: &mut Random) -> Vec<Corners> {
    let mut triangles: Vec<Corners> = Vec::new();
    for _ in 0..4 {
        let (a, b, c) = (point(random), point(random), point(random));
        let foot = a + (b - a) * 0.3;
        let [a, b, c] = [a, b, foot + (c - foot) * magnitude(random, -7.0)];
        triangles.push([a, b, c]);
        match (5.0 * random.next()) as u32 {
            0 => triangles.push([a, b, c]),
            1 => triangles.push([b, a, c]),
            2 => triangles.push([b, a, c + point(random) * 1e-7]),
            3 => triangles.push([a + point(random) * 1e-15, c, b]),
            _ => {}
        }
    }
    triangles
}

/// Visibility between two points is symmetric, except for lines that pass an edge within a rounding of about 10⁻⁶ on
/// either side: that share of the pairs, times the number of edges, may differ.
#[test]
fn visibility_is_symmetric_among_knots() {
    let mut random = Random::new(32);
    let (mut differ, mut allowed, mut blocked) = (0, 0.0, 0);
    for _ in 0..400 {
        let tracer = Tracer::new(&scene(&[black(knot(&mut random))]));
        for _ in 0..500 {
            let (p, q) = (point(&mut random).as_vec3a(), point(&mut random).as_vec3a());
            let seen = tracer.visible(p, q);
            differ += u32::from(seen != tracer.visible(q, p));
            blocked += u32::from(!seen);
        }
        allowed += 500.0 * 3.0 * tracer.triangles().len() as f64 * 2e-6;
    }
    println!("{blocked} pairs blocked, {differ} one way only, {allowed:.1} allowed");
    assert!(f64::from(differ) <= allowed && blocked > 4_000, "{differ} of {blocked}, {allowed} allowed");
}

/// Form factors lie between zero and one whatever surfaces overlap, rows with the escaped share sum to one, and pairs
/// are reciprocal, to the tolerance of the closure.
#[test]
fn form_factors_of_knots_are_shares() {
    let mut random = Random::new(33);
    for seed in 0..60 {
        let scene: Scene = scene(&[part(knot(&mut random), 0.5, 0.0), part(knot(&mut random), 0.5, 1.0)]);
        let inspection = Inspection::of(&scene);
        assert_eq!(inspection.triangles + inspection.degenerate, scene.triangles.len() + scene.degenerate);
        let options = CastOptions::default().with_seed(seed);
        let f = cast(scene, Subdivision::Count(40), options).form_factors;
        let (closure, reciprocity) = deviations(&f);
        assert!(closure <= 1e-12 && reciprocity <= 1e-12, "{seed}: {closure:e} {reciprocity:e}");
        for i in 0..f.len() {
            let escaped = f.escaped()[i];
            assert!((0.0..=1.0).contains(&escaped), "{seed}: {escaped}");
            // The excess over one is at most that of the row sum.
            assert!(f.row(i).all(|(_, x)| (0.0..=1.0 + 1e-12).contains(&x)), "{seed}: row {i}");
        }
    }
}

/// Of two faces at the same place one is hidden, and the other gets the irradiance of a single face, within the error
/// bars of both: under one lamp that is all they see, and among many lamps, some of which its own rays hit.
#[test]
fn of_doubled_faces_the_first_takes_part() {
    let mut sphere = flipped(icosphere(1.0, 2));
    // An opening, so that the escaped share depends on the lamps.
    sphere.pop();
    let below = level_square(0.5, -0.2, true);
    for (lamps, edge) in [(level_square(0.5, -0.1, false), 0.1), (sphere, f64::INFINITY)] {
        let irradiance = |floor: Vec<Corners>| {
            let parts = [part(lamps.clone(), 0.0, 1.0), black(floor), black(level_square(0.4, 0.4, false))];
            let options = CastOptions::default().with_rays(256.0);
            let cast = cast(scene(&parts), Subdivision::Edge(edge), options);
            let exitance: Vec<f64> = (0..cast.patches.len()).map(|i| cast.patches.emission()[i]).collect();
            let (irradiance, errors) = lit(&cast.form_factors, &exitance);
            let floor = cast.of_part(1);
            let mean = |of: &[usize]| cast.mean(of, &irradiance, &errors);
            // All, the first of two, and the second.
            let (first, second) = floor.split_at(floor.len() / 2);
            (mean(&floor), mean(first), mean(second))
        };
        let (alone, ..) = irradiance(below.clone());
        let (_, first, second) = irradiance([below.clone(), below.clone()].concat());
        assert_eq!(second.value, 0.0);
        first.assert_is(alone.value, T15 * alone.error + 1e-5);
    }
}
