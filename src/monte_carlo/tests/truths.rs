//! Tests against closed forms.

use super::*;
use crate::{Progress, trace::Tracer};
use glam::Vec3A;
use std::f64::consts::PI;

fn effort(samples: u32) -> Effort {
    Effort { samples, replicates: 32, seed: 11 }
}

/// Asserts that every estimator finds radiance 1 and irradiance π in a furnace, where all radiance is 1.
fn assert_furnace(scene: &Scene, from: DVec3, sharp: f64) {
    let tracer = Tracer::new(scene);
    let progress = Progress::new();
    let camera = Camera::new(from, from + dvec3(0.3, 0.2, -1.0), DVec3::Y, 90.0, 16, 16).unwrap();
    for options in [PLAIN, NEXT_EVENT] {
        let paths = PathTracer::new(scene, &tracer, options);
        let places: Vec<Receiver> = [(0, [0.2, 0.3, 0.5]), (1, [0.01, 0.01, 0.98]), (7, [0.4, 0.55, 0.05])]
            .map(|(t, b)| Receiver::on_triangle(&tracer, t, b, true))
            .into_iter()
            .chain([Receiver::free(&tracer, from, dvec3(1.0, 2.0, -0.5))])
            .collect();
        for e in paths.irradiances(&places, &effort(1 << 14), &progress).unwrap() {
            assert_is(&e, [PI; 3], 4.0, sharp);
        }
        let lens = camera.lens(&tracer);
        let seen = effort(1 << 14).estimate(4, &progress, |i, samples| {
            paths.radiance(lens.eye(), lens.direction(4.0 * i as f64 + 0.5, 7.5), samples)
        });
        for e in seen.unwrap() {
            assert_is(&e, [1.0; 3], 4.0, sharp);
        }
    }
    let light = LightTracer::new(scene, &tracer, LightOptions { particles: 1 << 19, ..Default::default() });
    let fronts = |hit: &crate::trace::Hit| hit.front.then_some(hit.triangle as usize);
    let found = light.trace(scene.triangles.len(), fronts, &progress).unwrap();
    let (mut worst, mut blunt): (f64, f64) = (0.0, 0.0);
    for (t, flux) in found.bins.iter().enumerate() {
        let e = flux.scaled(1.0 / scene.area(t));
        worst = worst.max((e.mean[0] - PI).abs() / e.standard_error[0]);
        blunt = blunt.max(e.standard_error[0] / PI);
    }
    assert!(
        worst < 5.0 && blunt < 0.06,
        "a bin is {worst} standard errors off; the largest error is {blunt}"
    );
    let picture = light.image(&camera, &progress).unwrap();
    let n = 256.0;
    let mean = picture.film.pixels().iter().map(|p| p[0] as f64).sum::<f64>() / n;
    let variance: f64 = picture.standard_error.pixels().iter().map(|s| (s[0] as f64).powi(2)).sum();
    let se = variance.sqrt() / n;
    assert!((mean - 1.0).abs() < 4.0 * se && se < 0.01, "light image {mean} ± {se}");
}

#[test]
fn furnace_in_a_sphere() {
    // This is how pbrt tests its integrators: Le = Kd = 1/2 on a unit sphere gives radiance 1.
    let scene = Scene::new(&sphere(16, 24, |_| 0), grey(0.5, 0.5));
    assert_furnace(&scene, dvec3(0.1, 0.2, 0.3), 3e-3);
}

#[test]
fn furnace_of_many_colours_with_a_floating_box() {
    // With Le = 1 - ρ, radiance is 1 for any pattern of ρ.
    let mut faces = box_walls(DVec3::ZERO, dvec3(3.0, 2.0, 2.5), true);
    faces.extend(box_walls(dvec3(0.5, 0.4, 0.6), dvec3(1.4, 1.2, 1.3), false));
    faces.iter_mut().enumerate().for_each(|(i, f)| f.1 = (i * 5 % 3) as u32);
    let furnace = |rho: [f64; 3]| Material::new("m", rho, rho.map(|r| 1.0 - r));
    let materials = vec![furnace([0.9, 0.5, 0.2]), furnace([0.1, 0.7, 0.6]), furnace([0.5, 0.0, 0.8])];
    assert_furnace(&Scene::new(&faces, materials), dvec3(2.2, 1.0, 1.9), 4e-3);
}

#[test]
fn nearly_white_furnace() {
    // Each bounce loses a thousandth, so the light of a point comes from about a thousand bounces, most of which must
    // survive roulette.
    let scene = Scene::new(&box_walls(DVec3::ZERO, dvec3(3.0, 2.0, 2.5), true), grey(0.999, 0.001));
    let tracer = Tracer::new(&scene);
    let place = Receiver::on_triangle(&tracer, 0, [0.2, 0.3, 0.5], true);
    for options in [PLAIN, NEXT_EVENT] {
        let paths = PathTracer::new(&scene, &tracer, options);
        let found = paths.irradiances(&[place], &effort(1 << 9), &Progress::new()).unwrap();
        assert_is(&found[0], [PI; 3], 4.0, 0.05);
    }
}

#[test]
fn without_roulette_a_furnace_has_no_variance() {
    let scene = Scene::new(&box_walls(DVec3::ZERO, dvec3(3.0, 2.0, 2.5), true), grey(0.5, 0.5));
    let tracer = Tracer::new(&scene);
    let options = PathOptions { next_event: false, max_bounces: Some(40), roulette_after: u32::MAX };
    let paths = PathTracer::new(&scene, &tracer, options);
    for i in 0..20_000 {
        let seen = paths.radiance(Vec3A::ZERO, Vec3A::new(0.3, 0.5, 0.1), &mut Samples::new(i, 5));
        assert!(seen.iter().all(|x| (x - 1.0).abs() < 1e-12), "path {i}: {seen:?}");
    }
}

/// Lambert's form factor from a point to a polygon, clipped to the horizon.
fn lambert(point: DVec3, normal: DVec3, polygon: &[DVec3]) -> f64 {
    let mut above = Vec::new();
    for (i, &a) in polygon.iter().enumerate() {
        let b = polygon[(i + 1) % polygon.len()];
        let (ha, hb) = ((a - point).dot(normal), (b - point).dot(normal));
        if ha >= 0.0 {
            above.push(a - point);
        }
        if ha * hb < 0.0 {
            above.push(a + (b - a) * (ha / (ha - hb)) - point);
        }
    }
    let sum: f64 = (0..above.len())
        .map(|k| {
            let (u, v) = (above[k], above[(k + 1) % above.len()]);
            let cross = u.cross(v);
            cross.length().atan2(u.dot(v)) * cross.dot(normal) / cross.length()
        })
        .sum();
    sum.abs() / (2.0 * PI)
}

#[test]
fn direct_light_of_a_triangle() {
    let lamp = [dvec3(0.1, 0.2, 1.2), dvec3(0.3, 1.1, 0.7), dvec3(1.2, 0.4, 0.9)];
    let point = dvec3(0.3, 0.2, 0.0);
    assert!((lambert(point, DVec3::Z, &lamp) - 0.122926902965).abs() < 1e-11);
    // For the second normal, only a part of the lamp is above the horizon.
    let normals = [DVec3::Z, dvec3(-1.0, 0.1, 0.1), dvec3(1.0, 1.0, 0.3)].map(|n| n.normalize());
    let radiance = [3.0, 1.0, 0.25];
    let materials = vec![Material::new("lamp", [0.0; 3], radiance)];
    let scene = Scene::new(&[(lamp, 0)], materials.clone());
    let tracer = Tracer::new(&scene);
    for options in [PLAIN, NEXT_EVENT] {
        let places = normals.map(|n| Receiver::free(&tracer, point, n));
        let paths = PathTracer::new(&scene, &tracer, options);
        let found = paths.irradiances(&places, &effort(1 << 17), &Progress::new()).unwrap();
        for (e, n) in found.iter().zip(normals) {
            let form_factor = lambert(point, n, &lamp);
            assert!(form_factor > 1e-3);
            let sharp = if options.next_event { 1e-3 } else { 1e-2 };
            assert_is(e, radiance.map(|l| PI * l * form_factor), 4.0, sharp);
        }
    }
    // Backs do not emit.
    let flipped = Scene::new(&[([lamp[0], lamp[2], lamp[1]], 0)], materials);
    let tracer = Tracer::new(&flipped);
    for options in [PLAIN, NEXT_EVENT] {
        let paths = PathTracer::new(&flipped, &tracer, options);
        let place = Receiver::free(&tracer, point, DVec3::Z);
        let e = paths.irradiances(&[place], &effort(1 << 10), &Progress::new()).unwrap();
        assert_eq!(e[0].mean, [0.0; 3]);
    }
}

#[test]
fn few_samples_show_the_light_of_a_lamp() {
    let lamp = [dvec3(0.2, 0.3, 0.8), dvec3(0.2, 0.6, 0.8), dvec3(0.7, 0.6, 0.8), dvec3(0.7, 0.3, 0.8)];
    let scene = Scene::new(&quad(lamp, 0), grey(0.0, 1.0));
    let tracer = Tracer::new(&scene);
    let paths = PathTracer::new(&scene, &tracer, NEXT_EVENT);
    let (point, samples) = (dvec3(0.5, 0.5, 0.0), 32);
    let places = vec![Receiver::free(&tracer, point, DVec3::Z); 1000];
    let effort = Effort { samples, replicates: 4, seed: 3 };
    let found = paths.irradiances(&places, &effort, &Progress::new()).unwrap();
    let share = lambert(point, DVec3::Z, &lamp);
    let off: Vec<f64> = found.iter().map(|e| e.mean[0] / (PI * share) - 1.0).collect();
    let rms = (off.iter().map(|x| x * x).sum::<f64>() / off.len() as f64).sqrt();
    let mean = off.iter().sum::<f64>() / off.len() as f64;
    assert!(mean.abs() < 4.0 * rms / (off.len() as f64).sqrt(), "{mean} ± {rms}");
    // Some of the bounces hit the lamp. With weights p/(p + q) these alone would cause noise of 4.5 %.
    let to = (lamp[0] + lamp[2]) / 2.0 - point;
    let cos = to.z / to.length();
    let (p, q) = (cos / PI, to.length_squared() / (cos * 0.15));
    let by_hits = p / (p + q) * (share * (1.0 - share) / f64::from(samples)).sqrt() / share;
    assert!(rms < 0.5 * by_hits, "{rms}, {by_hits}");
}

#[test]
fn sphere_with_a_glowing_cap() {
    // E = ∫Be / (A - ∫ρ) at every point of a sphere, for any pattern.
    let third = PI / 6.0;
    let material = |theta: f64| match theta {
        t if t < third => 0,
        t if t < PI / 2.0 => 1,
        _ => 2,
    };
    let lamp = [1.0 / PI; 3];
    let materials = vec![
        Material::new("cap", [0.8; 3], lamp),
        Material::new("north", [0.8; 3], [0.0; 3]),
        Material::new("south", [0.2; 3], [0.0; 3]),
    ];
    let scene = Scene::new(&sphere(60, 90, material), materials);
    let tracer = Tracer::new(&scene);
    let places: Vec<Receiver> = (0..scene.triangles.len())
        .step_by(scene.triangles.len() / 5)
        .map(|t| {
            // The receiver is the middle of a face, with the normal of the sphere. The face's own normal differs by the
            // order of h.
            let middle = scene.corners(t).iter().sum::<DVec3>() / 3.0;
            Receiver::free(&tracer, middle, -middle)
        })
        .collect();
    for options in [PLAIN, NEXT_EVENT] {
        let paths = PathTracer::new(&scene, &tracer, options);
        for e in paths.irradiances(&places, &effort(1 << 16), &Progress::new()).unwrap() {
            // Flat faces of 3 by 4 degrees cause an error of a few times h²/8.
            let allowed = 4.0 * e.standard_error[0] + 0.004 * 0.1339745962;
            assert!((e.mean[0] - 0.1339745962).abs() < allowed && allowed < 0.004, "{e:?}");
        }
    }
}

/// A square of side `s` centred on the z axis, with its front to +z or -z.
fn centred(s: f64, z: f64, up: bool, material: u32) -> Faces {
    let h = s / 2.0;
    let mut corners = [dvec3(-h, -h, z), dvec3(h, -h, z), dvec3(h, h, z), dvec3(-h, h, z)];
    if !up {
        corners.reverse();
    }
    quad(corners, material)
}

#[test]
fn a_blocker_between_squares() {
    for (s, form_factor) in [(0.0, 0.199824895698), (0.25, 0.169474204912), (0.5, 0.099506294599)] {
        let mut faces = centred(1.0, 0.0, true, 0);
        faces.extend(centred(1.0, 1.0, false, 1));
        faces.extend(centred(s, 0.5, true, 0));
        let materials = vec![grey(0.0, 0.0).remove(0), Material::new("lamp", [0.0; 3], [1.0; 3])];
        let scene = Scene::new(&faces, materials);
        let tracer = Tracer::new(&scene);
        for options in [PLAIN, NEXT_EVENT] {
            let paths = PathTracer::new(&scene, &tracer, options);
            let found =
                paths.mean_irradiances(&all_sides(&scene)[..2], &effort(1 << 16), &Progress::new()).unwrap();
            // By symmetry both triangles of the floor receive the same.
            for e in &found {
                assert_is(e, [PI * form_factor; 3], 4.0, if options.next_event { 4e-3 } else { 1e-2 });
            }
        }
    }
}
