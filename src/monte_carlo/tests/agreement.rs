//! Estimators that share only the ray tracer must agree in any scene.

use super::*;
use crate::{Progress, trace::Tracer};
use std::f64::consts::PI;

/// Mean and variance of single samples of the red irradiance.
fn spread(paths: &PathTracer, at: Receiver, n: u32) -> (f64, f64) {
    let values: Vec<f64> = (0..n).map(|i| paths.irradiance(at, &mut Samples::new(i, 9))[0]).collect();
    let mean = values.iter().sum::<f64>() / n as f64;
    (mean, values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1) as f64)
}

#[test]
fn next_event_estimation_pays_as_theory_says() {
    let scene = room(false);
    let tracer = Tracer::new(&scene);
    let at = Receiver::free(&tracer, dvec3(3.0, 0.0, 3.4), DVec3::Y);
    // A sample of direct light without next event estimation is π L with probability F, otherwise 0. Its variance is (π
    // L)² F (1 - F). The lamp of 0.3 m² at 2.9 m, nearly overhead, has a form factor F of about 0.3/(π 2.9²) = 0.011.
    let direct = |next_event| PathOptions { next_event, max_bounces: Some(0), ..PLAIN };
    let (mean, variance) = spread(&PathTracer::new(&scene, &tracer, direct(false)), at, 1 << 16);
    let full = PI * 20.0;
    let form_factor = mean / full;
    assert!((0.008..0.012).contains(&form_factor), "{form_factor}");
    assert!((variance / (full * full * form_factor * (1.0 - form_factor)) - 1.0).abs() < 1e-3);
    let (mean_next, variance_next) = spread(&PathTracer::new(&scene, &tracer, direct(true)), at, 1 << 16);
    assert!((mean_next / mean - 1.0).abs() < 0.03);
    // With next event estimation, the samples from such a small lamp vary by a few per cent: the relative variance
    // falls from 1/F to below 0.01.
    println!("direct light: variance ratio {:.0}", variance / variance_next);
    assert!(variance > 5000.0 * variance_next, "{variance} {variance_next}");
    let (_, variance) = spread(&PathTracer::new(&scene, &tracer, PLAIN), at, 1 << 16);
    let (_, variance_next) = spread(&PathTracer::new(&scene, &tracer, NEXT_EVENT), at, 1 << 16);
    println!("all light: variance ratio {:.1}", variance / variance_next);
    assert!(variance > 10.0 * variance_next, "{variance} {variance_next}");
}

#[test]
fn paths_and_particles_agree_on_every_side_of_every_triangle() {
    for open in [false, true] {
        let scene = room(open);
        let tracer = Tracer::new(&scene);
        let n = scene.triangles.len();
        let progress = Progress::new();
        let effort = Effort { samples: 1 << 13, replicates: 32, seed: 4 };
        let by = |options| {
            let paths = PathTracer::new(&scene, &tracer, options);
            paths.mean_irradiances(&all_sides(&scene), &effort, &progress).unwrap()
        };
        let (plain, next) = (by(PLAIN), by(NEXT_EVENT));
        let options = LightOptions { particles: 1 << 19, seed: 8, ..Default::default() };
        let side = |hit: &crate::trace::Hit| Some(hit.triangle as usize + if hit.front { 0 } else { n });
        let light = LightTracer::new(&scene, &tracer, options).trace(2 * n, side, &progress).unwrap();
        let mut squares = 0.0;
        let mut compared = 0;
        for i in 0..2 * n {
            let flux = light.bins[i].scaled(1.0 / scene.area(i % n));
            assert!(apart(&plain[i], &next[i]) < 5.0, "side {i}: {:?} {:?}", plain[i], next[i]);
            assert!(apart(&flux, &next[i]) < 5.0, "side {i}: {flux:?} {:?}", next[i]);
            if next[i].mean[0] > 0.0 {
                assert!(next[i].standard_error[0] < 0.03 * next[i].mean[0], "side {i}: {:?}", next[i]);
                squares += ((flux.mean[0] - next[i].mean[0])
                    / flux.standard_error[0].hypot(next[i].standard_error[0]))
                .powi(2);
                compared += 1;
            }
        }
        // All fronts are lit, and so are the backs of the lamp, which receives light from the ceiling.
        assert!(compared >= n, "{compared} of {n}");
        let chi = squares / compared as f64;
        assert!(
            (0.5..2.0).contains(&chi),
            "the squared differences are {chi} of the squared standard errors"
        );
    }
}

#[test]
fn pictures_by_paths_and_by_particles_agree() {
    let scene = room(true);
    let tracer = Tracer::new(&scene);
    let camera = Camera::new(dvec3(1.8, 1.6, 9.0), dvec3(2.1, 1.4, 2.0), DVec3::Y, 35.0, 48, 40).unwrap();
    let progress = Progress::new();
    let options = LightOptions { particles: 1 << 19, ..Default::default() };
    let light = LightTracer::new(&scene, &tracer, options).image(&camera, &progress).unwrap();
    for options in [PLAIN, NEXT_EVENT] {
        let paths = PathTracer::new(&scene, &tracer, options);
        let renders: Vec<Film> = (0..8)
            .map(|seed| {
                let samples = if options.next_event { 16 } else { 64 };
                Film::render(&paths, &camera, &RenderOptions { samples, seed }, &progress).unwrap()
            })
            .collect();
        let mut worst: f64 = 0.0;
        for block in 0..20 {
            // Blocks of 12 × 8 pixels.
            let inside = |i: usize| i % 48 / 12 == block % 4 && i / 48 / 8 == block / 4;
            let mean = |film: &Film| {
                let chosen = film.pixels().iter().enumerate().filter(|(i, _)| inside(*i));
                chosen.fold([0.0; 3], |sum: [f64; 3], (_, p)| {
                    std::array::from_fn(|c| sum[c] + p[c] as f64 / 96.0)
                })
            };
            let by_paths = Estimate::of(&renders.iter().map(mean).collect::<Vec<_>>());
            let squares = light
                .standard_error
                .pixels()
                .iter()
                .enumerate()
                .filter(|(i, _)| inside(*i))
                .fold([0.0; 3], |sum: [f64; 3], (_, s)| {
                    std::array::from_fn(|c| sum[c] + (s[c] as f64 / 96.0).powi(2))
                });
            let by_light = Estimate { mean: mean(&light.film), standard_error: squares.map(f64::sqrt) };
            assert!(by_light.standard_error[0] < 0.03 * by_light.mean[0], "{block}: {by_light:?}");
            worst = worst.max(apart(&by_paths, &by_light));
        }
        assert!(worst < 5.0, "a block is {worst} standard errors apart");
    }
}

#[test]
fn swapping_lamp_and_receiver_changes_nothing() {
    // A triangle and a distant, tilted, larger triangle, with a screen that hides part of each from the other.
    let a = [dvec3(0., 0., 0.), dvec3(1., 0., 0.), dvec3(0.2, 0.9, 0.)];
    let b = [dvec3(-0.5, -0.3, 1.5), dvec3(0.4, 2.1, 1.1), dvec3(1.9, 0.2, 1.7)];
    let screen = [dvec3(0.4, -2.0, 0.7), dvec3(0.5, 2.0, 0.6), dvec3(3.0, 0.0, 0.8)];
    let flux = |lamp: u32, receiver: usize, options| {
        let materials = vec![grey(0.0, 0.0).remove(0), grey(0.0, 1.0).remove(0)];
        let scene = Scene::new(&[(a, 1 - lamp), (b, lamp), (screen, 0)], materials);
        let tracer = Tracer::new(&scene);
        let effort = Effort { samples: 1 << 17, replicates: 32, seed: 21 };
        let paths = PathTracer::new(&scene, &tracer, options);
        let region = Region { front: true, ..all_sides(&scene)[receiver] };
        paths.mean_irradiances(&[region], &effort, &Progress::new()).unwrap()[0].scaled(scene.area(receiver))
    };
    for options in [PLAIN, NEXT_EVENT] {
        let (there, back) = (flux(1, 0, options), flux(0, 1, options));
        assert!(there.mean[0] > 0.0 && there.standard_error[0] < 5e-3 * there.mean[0], "{there:?}");
        assert!(apart(&there, &back) < 4.0, "{there:?} {back:?}");
    }
}

#[test]
fn roulette_and_continuous_absorption_change_no_mean() {
    let scene = room(false);
    let tracer = Tracer::new(&scene);
    let at = [
        Receiver::free(&tracer, dvec3(1.5, 0.0, 1.5), DVec3::Y),
        Receiver::on_triangle(&tracer, 0, [0.3, 0.3, 0.4], true),
    ];
    let effort = Effort { samples: 1 << 16, replicates: 32, seed: 2 };
    let by = |roulette_after, max_bounces| {
        let options = PathOptions { roulette_after, max_bounces, ..NEXT_EVENT };
        PathTracer::new(&scene, &tracer, options).irradiances(&at, &effort, &Progress::new()).unwrap()
    };
    // 60 bounces are enough without roulette: 0.75⁶⁰ is 3e-8.
    let (without, at_once, late) = (by(u32::MAX, Some(60)), by(0, None), by(5, None));
    for i in 0..2 {
        assert!(without[i].standard_error[0] < 5e-3 * without[i].mean[0]);
        assert!(apart(&without[i], &at_once[i]) < 4.0, "{:?} {:?}", without[i], at_once[i]);
        assert!(apart(&without[i], &late[i]) < 4.0, "{:?} {:?}", without[i], late[i]);
    }
    let floor = |continuous| {
        let options = LightOptions { particles: 1 << 18, continuous, ..Default::default() };
        let bin = |hit: &crate::trace::Hit| Some(usize::from(!(4..6).contains(&hit.triangle)));
        LightTracer::new(&scene, &tracer, options).trace(2, bin, &Progress::new()).unwrap().bins
    };
    let (analog, mixed) = (floor(0), floor(10));
    for i in 0..2 {
        assert!(mixed[i].standard_error[0] < 5e-3 * mixed[i].mean[0], "{:?}", mixed[i]);
        assert!(apart(&analog[i], &mixed[i]) < 4.0, "{:?} {:?}", analog[i], mixed[i]);
    }
}

#[test]
fn a_limit_of_bounces_cuts_the_series_of_a_furnace() {
    let scene = Scene::new(&box_walls(DVec3::ZERO, DVec3::ONE, true), grey(0.5, 0.5));
    let tracer = Tracer::new(&scene);
    for next_event in [false, true] {
        for (limit, radiance, irradiance) in [(0, 0.5, 0.5), (1, 0.75, 0.75), (3, 0.9375, 0.9375)] {
            let options = PathOptions { next_event, max_bounces: Some(limit), roulette_after: 1000 };
            let paths = PathTracer::new(&scene, &tracer, options);
            let effort = Effort { samples: 1 << 14, replicates: 32, seed: 3 };
            let found = effort.estimate(2, &Progress::new(), |i, samples| match i {
                0 => paths.radiance(glam::Vec3A::ZERO, glam::vec3a(0.2, 0.3, 0.9), samples),
                _ => paths.irradiance(Receiver::on_triangle(&tracer, 0, [0.1, 0.2, 0.7], true), samples),
            });
            let found = found.unwrap();
            assert_is(&found[0], [radiance; 3], 4.0, 5e-3);
            assert_is(&found[1], [PI * irradiance; 3], 4.0, 5e-3);
        }
    }
}

#[test]
fn parts_of_a_triangle_average_to_the_whole() {
    let scene = room(false);
    let tracer = Tracer::new(&scene);
    let paths = PathTracer::new(&scene, &tracer, NEXT_EVENT);
    let [a, b, c] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let [ab, bc, ca] = [[0.5, 0.5, 0.0], [0.0, 0.5, 0.5], [0.5, 0.0, 0.5]];
    let parts = [[a, b, c], [a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]];
    // One triangle of the ceiling, lit by the floor and the walls, and one triangle of a wall near the lamp.
    for triangle in [6, 3] {
        let regions = parts.map(|part| Region { triangle, part, front: true });
        let effort = Effort { samples: 1 << 15, replicates: 32, seed: 6 };
        let e = paths.mean_irradiances(&regions, &effort, &Progress::new()).unwrap();
        let replicas: [f64; 3] = std::array::from_fn(|k| e[1..].iter().map(|x| x.mean[k]).sum::<f64>() / 4.0);
        let errors: [f64; 3] = std::array::from_fn(|k| {
            e[1..].iter().map(|x| x.standard_error[k].powi(2)).sum::<f64>().sqrt() / 4.0
        });
        let mean = Estimate { mean: replicas, standard_error: errors };
        assert!(apart(&e[0], &mean) < 4.0, "{:?} {mean:?}", e[0]);
        // The parts differ so much that the test would detect a wrong part.
        assert!(apart(&e[1], &e[2]) > 10.0 && apart(&e[2], &e[3]) > 10.0, "{e:?}");
    }
}

#[test]
fn the_unit_of_length_changes_nothing() {
    let scene = room(true);
    let moved = Scene {
        vertices: scene.vertices.iter().map(|v| *v * 1000.0 + dvec3(2e5, -1e5, 3e5)).collect(),
        ..scene.clone()
    };
    let at = |scene: &Scene, scale: f64| {
        let tracer = Tracer::new(scene);
        let effort = Effort { samples: 1 << 12, ..Default::default() };
        let paths = PathTracer::new(scene, &tracer, NEXT_EVENT);
        let e = paths.mean_irradiances(&all_sides(scene)[..4], &effort, &Progress::new()).unwrap();
        let options = LightOptions { particles: 1 << 15, ..Default::default() };
        let light = LightTracer::new(scene, &tracer, options)
            .trace(1, |hit| (hit.triangle < 4).then_some(0), &Progress::new())
            .unwrap();
        (e, light.bins[0].scaled(1.0 / scale.powi(2)))
    };
    let ((metres, flux), (millimetres, flux_mm)) = (at(&scene, 1.0), at(&moved, 1000.0));
    for (a, b) in metres.iter().zip(&millimetres).chain([(&flux, &flux_mm)]) {
        for c in 0..3 {
            assert!((a.mean[c] / b.mean[c] - 1.0).abs() < 1e-2 && apart(a, b) < 0.5, "{a:?} {b:?}");
        }
    }
}

#[test]
fn backs_reflect_as_fronts_do() {
    // The front or the back of a floor faces the lamp and a plate that receives the reflected light.
    let found = [false, true].map(|flipped| {
        let mut floor = [dvec3(-2., 0., -2.), dvec3(-2., 0., 2.), dvec3(2., 0., 2.), dvec3(2., 0., -2.)];
        if flipped {
            floor.reverse();
        }
        let mut faces = quad(floor, 0);
        faces.extend(quad([dvec3(1., 2., 0.), dvec3(2., 2., 0.), dvec3(2., 2., 1.), dvec3(1., 2., 1.)], 1));
        faces.extend(quad(
            [dvec3(-1., 1.5, 0.), dvec3(0., 1.5, 0.), dvec3(0., 1.5, 1.), dvec3(-1., 1.5, 1.)],
            2,
        ));
        let materials = [(0.8, 0.0), (0.0, 5.0), (0.0, 0.0)].map(|(rho, le)| grey(rho, le).remove(0));
        let scene = Scene::new(&faces, materials.to_vec());
        let tracer = Tracer::new(&scene);
        let at = Receiver::free(&tracer, dvec3(-0.5, 1.4, 0.5), DVec3::NEG_Y);
        let paths = PathTracer::new(&scene, &tracer, NEXT_EVENT);
        let effort = Effort { samples: 1 << 14, ..Default::default() };
        let by_paths = paths.irradiances(&[at], &effort, &Progress::new()).unwrap()[0];
        let plate = |hit: &crate::trace::Hit| (hit.triangle >= 4 && hit.front).then_some(0);
        let options = LightOptions { particles: 1 << 18, ..Default::default() };
        let light = LightTracer::new(&scene, &tracer, options).trace(1, plate, &Progress::new());
        [by_paths, light.unwrap().bins[0]]
    });
    for [front, back] in [[found[0][0], found[1][0]], [found[0][1], found[1][1]]] {
        assert!(front.mean[0] > 0.1 && front.standard_error[0] < 0.02 * front.mean[0], "{front:?}");
        assert!(apart(&front, &back) < 4.0, "{front:?} {back:?}");
    }
}

#[test]
fn a_point_rounded_to_below_a_surface_is_on_it() {
    let scene = room(true);
    let tracer = Tracer::new(&scene);
    let paths = PathTracer::new(&scene, &tracer, NEXT_EVENT);
    // The scene is 5 long, so 5e-6 is 2e-6 in unit space. A distance of 1e-3 is not rounding.
    let places = [0.0, 5e-6, -5e-6, -1e-3].map(|h| Receiver::free(&tracer, dvec3(3.0, h, 3.4), DVec3::Y));
    let e = paths.irradiances(&places, &Effort::default(), &Progress::new()).unwrap();
    assert!(e[0].mean[0] > 0.1 && apart(&e[0], &e[1]) < 4.0 && apart(&e[0], &e[2]) < 4.0, "{e:?}");
    assert_eq!(e[3].mean, [0.0; 3]);
}
