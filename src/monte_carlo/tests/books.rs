//! Tests of energy balance and reproducibility.

use super::*;
use crate::{Error, Progress, trace::Tracer};
use std::f64::consts::PI;

#[test]
fn the_books_of_every_particle_balance() {
    for open in [false, true] {
        let scene = room(open);
        let tracer = Tracer::new(&scene);
        for continuous in [0, 3, 20] {
            let options = LightOptions { continuous, ..Default::default() };
            let light = LightTracer::new(&scene, &tracer, options);
            let mut escapes = 0;
            for i in 0..20_000 {
                let p = light.particle(i, 77, 1).unwrap();
                for c in 0..3 {
                    let rest = p.emitted[c] - p.absorbed[c] - p.escaped[c];
                    assert!(rest.abs() <= 1e-14 * p.emitted[c], "particle {i} loses {rest} of {p:?}");
                    assert!(p.absorbed[c] >= 0.0 && p.escaped[c] >= 0.0 && p.emitted[c] > 0.0, "{p:?}");
                }
                escapes += u32::from(p.escaped[0] > 0.0);
            }
            assert!(if open { escapes > 2000 } else { escapes <= 1 }, "{escapes} escaped, open: {open}");
        }
    }
}

#[test]
fn totals_are_the_power_of_the_lamps_and_what_a_bin_absorbs() {
    let scene = room(true);
    let tracer = Tracer::new(&scene);
    let light = LightTracer::new(&scene, &tracer, LightOptions::default());
    let white = |hit: &crate::trace::Hit| Some(scene.triangles[hit.triangle as usize].material as usize);
    let found = light.trace(4, white, &Progress::new()).unwrap();
    let power = [20.0, 15.0, 9.0].map(|l| PI * l * 0.6 * 0.5);
    assert_is(&found.emitted, power, 4.0, 1e-9);
    for (c, power) in power.into_iter().enumerate() {
        let (absorbed, escaped) = (found.absorbed.mean[c], found.escaped.mean[c]);
        assert!((absorbed + escaped - power).abs() < 1e-6 * power, "{found:?}");
        assert!(escaped > 0.05 * power && absorbed > 0.05 * power);
        // In expectation, the share 1 - ρ of the arriving flux is absorbed.
        let expected: f64 =
            (0..4).map(|m| found.bins[m].mean[c] * (1.0 - scene.materials[m].reflectance[c])).sum();
        assert!(
            (expected - absorbed).abs() < 6.0 * found.absorbed.standard_error[c],
            "{expected} {absorbed}"
        );
        assert!(found.absorbed.standard_error[c] < 2e-3 * absorbed);
    }
}

#[test]
fn light_that_never_ends_is_an_error() {
    let scene = Scene::new(&box_walls(DVec3::ZERO, DVec3::ONE, true), grey(1.0, 1.0));
    let tracer = Tracer::new(&scene);
    let options = LightOptions { particles: 64, batches: 2, ..Default::default() };
    let light = LightTracer::new(&scene, &tracer, options);
    assert!(matches!(light.trace(1, |_| None, &Progress::new()), Err(Error::NoEquilibrium)));
    // Paths end, although their estimate has no meaning here.
    let paths = PathTracer::new(&scene, &tracer, PLAIN);
    paths.irradiance(Receiver::on_triangle(&tracer, 0, [0.2, 0.3, 0.5], true), &mut Samples::new(0, 0));
}

#[test]
fn a_dark_scene_is_dark() {
    let scene = Scene::new(&box_walls(DVec3::ZERO, DVec3::ONE, true), grey(0.5, 0.0));
    let tracer = Tracer::new(&scene);
    let progress = Progress::new();
    let found = LightTracer::new(&scene, &tracer, LightOptions::default()).trace(3, |_| None, &progress);
    assert_eq!(found.unwrap(), LightTransport { bins: vec![Estimate::default(); 3], ..Default::default() });
    for options in [PLAIN, NEXT_EVENT] {
        let paths = PathTracer::new(&scene, &tracer, options);
        let place = Receiver::on_triangle(&tracer, 0, [0.2, 0.3, 0.5], true);
        assert_eq!(paths.irradiance(place, &mut Samples::new(0, 0)), [0.0; 3]);
    }
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let scene = room(true);
    let tracer = Tracer::new(&scene);
    let camera = Camera::frame(&scene, &tracer, 33, 21).unwrap();
    let run = || {
        let progress = Progress::new();
        let paths = PathTracer::new(&scene, &tracer, NEXT_EVENT);
        let film = Film::render(&paths, &camera, &RenderOptions { samples: 4, seed: 3 }, &progress).unwrap();
        assert_eq!((progress.done(), progress.total()), (33 * 21 * 4, 33 * 21 * 4));
        let effort = Effort { samples: 256, ..Default::default() };
        let means = paths.mean_irradiances(&all_sides(&scene)[..5], &effort, &progress).unwrap();
        let options = LightOptions { particles: 50_000, batches: 7, ..Default::default() };
        let light = LightTracer::new(&scene, &tracer, options);
        let flux = light.trace(40, |hit| Some(hit.triangle as usize), &progress).unwrap();
        assert_eq!(progress.done(), progress.total());
        let picture = light.image(&camera, &progress).unwrap();
        (film, means, flux, picture.film, picture.standard_error)
    };
    let with = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(run);
    let one = with(1);
    assert!(one.0.pixels().iter().any(|p| p[0] > 0.0) && one.3.pixels().iter().any(|p| p[0] > 0.0));
    assert!(one == with(2) && one == with(5));
    // Another seed gives another picture.
    let paths = PathTracer::new(&scene, &tracer, NEXT_EVENT);
    let other = RenderOptions { samples: 4, seed: 4 };
    assert_ne!(one.0, Film::render(&paths, &camera, &other, &Progress::new()).unwrap());
}

#[test]
fn a_stopped_computation_says_so() {
    let scene = room(true);
    let tracer = Tracer::new(&scene);
    let camera = Camera::frame(&scene, &tracer, 8, 8).unwrap();
    let progress = Progress::new();
    progress.stop();
    let paths = PathTracer::new(&scene, &tracer, NEXT_EVENT);
    let film = Film::render(&paths, &camera, &RenderOptions::default(), &progress);
    assert!(matches!(film, Err(Error::Stopped)));
    let light = LightTracer::new(&scene, &tracer, LightOptions::default());
    assert!(matches!(light.image(&camera, &progress), Err(Error::Stopped)));
}
