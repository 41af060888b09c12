//! Daylight coefficients against closed forms and against a solution under the same sky.

use std::f64::consts::PI;

use glam::{DVec3, dvec3};
use radiosity::{
    Progress, Scene,
    accuracy::solved::Solved,
    daylight::{
        SkyParts,
        coefficients::{Coefficients, Daylight, DaylightOptions},
        year::{Year, daylight_factors},
    },
    form_factor::CastOptions,
    patch::{Patches, Subdivision},
    scene::light::{Distant, Hour, Light, LightKind, Sky, SkyModel, Up, Weather},
    solve::SolveOptions,
    trace::Tracer,
};

use crate::common::{flipped, level_square, part, rectangle, scene};

fn options() -> DaylightOptions {
    DaylightOptions::default().with_up(Up::Z).with_rays(256.0)
}

fn sum(coefficients: &Coefficients, i: usize) -> f64 {
    let many = coefficients.parts.count();
    coefficients.total[i * many..][..many].iter().map(|&c| f64::from(c)).sum()
}

/// On an open floor the coefficient of each part is its solid angle times the cosine, within 5 % for the sampling error
/// of one part. They sum to π, and to π / 2 on a vertical plane. The daylight factor is 1. The sun's own coefficients,
/// which hold reflected light only, are zero.
#[test]
fn an_open_floor() {
    let floor = scene(&[part(level_square(2.0, 0.0, true), 0.5, 0.0)]);
    let tracer = Tracer::new(&floor);
    let patches = Patches::subdivide(&floor, &Subdivision::Count(2));
    let options = options().with_rays_of_points(1 << 15);
    let daylight = Daylight::new(&floor, &tracer, patches, &options, &Progress::new()).unwrap();
    let points = [(dvec3(0.1, 0.2, 0.0), DVec3::Z), (dvec3(0.1, 0.2, 0.0), 2.0 * DVec3::Y)];
    let found = daylight.of_points(&points, &Progress::new()).unwrap();
    let parts = SkyParts::new(1);
    for k in 0..parts.count() {
        let (c, wanted) = (f64::from(found.total[k]), parts.horizontal(k));
        assert!((c / wanted - 1.0).abs() < 0.05, "part {k}: {c} for {wanted}");
        assert_eq!(found.of_sun(0, k), 0.0);
    }
    assert!((sum(&found, 0) - PI).abs() < 1e-3 && (sum(&found, 1) - 0.5 * PI).abs() < 0.02 * PI);
    let factors = daylight_factors(&found, Up::Z);
    // A wall under the CIE overcast sky has the daylight factor (π/6 + 4/9) / (7π/9).
    let wall = (PI / 6.0 + 4.0 / 9.0) / (7.0 * PI / 9.0);
    assert!((factors[0] - 1.0).abs() < 2e-3 && (factors[1] - wall).abs() < 0.01, "{factors:?}");
    assert!(daylight.sees(&points[0], DVec3::Z) && !daylight.sees(&points[1], -DVec3::Y));
}

/// A courtyard with a floor and two walls, open to the sky.
fn courtyard() -> Scene {
    let wall = |corner: DVec3, u: DVec3| flipped(rectangle(corner, u, 2.0 * DVec3::Z));
    scene(&[
        part(level_square(4.0, 0.0, true), 0.3, 0.0),
        part(wall(dvec3(-2.0, 2.0, 0.0), 4.0 * DVec3::X), 0.7, 0.0),
        part(wall(dvec3(2.0, 2.0, 0.0), -4.0 * DVec3::Y), 0.5, 0.0),
    ])
}

/// Daylight coefficients times the luminance of the parts of an overcast sky sum to the solution under that sky. The
/// two castings of 256 rays per patch and the 145 steps of the sky differ by less than 2 % RMS.
#[test]
fn coefficients_sum_to_the_solution() {
    let scene = courtyard();
    let tracer = Tracer::new(&scene);
    let patches = Patches::subdivide(&scene, &Subdivision::Count(200));
    let daylight = Daylight::new(&scene, &tracer, patches, &options(), &Progress::new()).unwrap();
    let found = daylight.of_patches();
    let mut lit = scene.clone();
    lit.lights.sky = Some(Sky::with_irradiance(SkyModel::Overcast, Up::Z, [1.0; 3]));
    let cast = CastOptions::default().with_rays(256.0).with_seed(7);
    let (subdivision, solve) = (Subdivision::Count(200), SolveOptions::default());
    let solved = Solved::new(&lit, &tracer, &subdivision, &cast, &solve, &Progress::new()).unwrap();
    let factors = daylight_factors(&found, Up::Z);
    let (mut difference, mut size) = (0.0, 0.0);
    for (i, factor) in factors.iter().enumerate() {
        let area = solved.patches.area(i);
        difference += area * (factor - solved.solution.irradiance[i]).powi(2);
        size += area * solved.solution.irradiance[i].powi(2);
        assert!(found.of_sun(i, 60) >= 0.0);
    }
    assert!((difference / size).sqrt() < 0.02, "{}", (difference / size).sqrt());
}

/// Sunlight of some hours, direct and reflected, against a solution with each of the twelve positions of the sun as a light
/// of its own. There is no diffuse light. Patches that a shadow cuts have four shadow rays for each part of the sky: with
/// 1000 patches, these leave 2 % RMS. The mean over all patches has no such error.
#[test]
fn sunlight_sums_to_the_solution() {
    let hours = [(6, 21, 9, 500.0, 0.0), (6, 21, 13, 700.0, 0.0), (12, 21, 12, 400.0, 0.0)];
    let weather = weather(&hours);
    let scene = courtyard();
    let tracer = Tracer::new(&scene);
    let subdivision = Subdivision::Count(1000);
    let patches = Patches::subdivide(&scene, &subdivision);
    let daylight = Daylight::new(&scene, &tracer, patches, &options(), &Progress::new()).unwrap();
    let found = daylight.of_patches();
    let year = Year::of(&daylight, &found, None, &weather, Up::Z, &Progress::new()).unwrap();
    let mut lit = scene.clone();
    for hour in &weather.hours {
        let e = hour.direct * efficacies(hour)[0] / hour.positions.len() as f64;
        for (azimuth, altitude) in hour.positions.iter().flatten() {
            let sun = Distant::new(Up::Z.direction(*azimuth, *altitude), [e; 3], 0.0);
            lit.lights.list.push(Light::new("sun", LightKind::Distant(sun)));
        }
    }
    let cast = CastOptions::default().with_rays(256.0).with_seed(7);
    let solved =
        Solved::new(&lit, &tracer, &subdivision, &cast, &SolveOptions::default(), &Progress::new()).unwrap();
    let (mut difference, mut size, mut sums) = (0.0, 0.0, [0.0; 2]);
    for (i, &wanted) in solved.solution.irradiance.iter().enumerate().take(found.places) {
        let e: f64 = (0..3).map(|hour| f64::from(year.illuminance[hour * found.places + i])).sum();
        let area = solved.patches.area(i);
        difference += area * (e - wanted).powi(2);
        size += area * wanted.powi(2);
        sums = [sums[0] + area * e, sums[1] + area * wanted];
    }
    assert!((difference / size).sqrt() < 0.03, "{}", (difference / size).sqrt());
    assert!((sums[0] / sums[1] - 1.0).abs() < 0.005, "{sums:?}");
}

/// Diffuse light before sunrise counts, and direct irradiance at night does not.
#[test]
fn twilight_counts() {
    let weather = weather(&[(6, 21, 4, 0.0, 15.0), (6, 21, 3, 300.0, 15.0), (6, 21, 2, 300.0, 0.0)]);
    assert!(weather.hours.iter().all(|hour| hour.sun.is_none()));
    let floor = scene(&[part(level_square(2.0, 0.0, true), 0.5, 0.0)]);
    let tracer = Tracer::new(&floor);
    let patches = Patches::subdivide(&floor, &Subdivision::Count(2));
    let daylight = Daylight::new(&floor, &tracer, patches, &options(), &Progress::new()).unwrap();
    let points = [(DVec3::ZERO, DVec3::Z)];
    let found = daylight.of_points(&points, &Progress::new()).unwrap();
    let year = Year::of(&daylight, &found, Some(&points), &weather, Up::Z, &Progress::new()).unwrap();
    let hour = weather.hours[0];
    let outside = radiosity::scene::light::SOLAR_CONSTANT * hour.eccentricity;
    let [_, diffuse] = radiosity::scene::light::luminous_efficacy([0.0, 15.0], 0.0, outside, hour.dew_point);
    for hour in 0..2 {
        let e = f64::from(year.illuminance[hour]);
        assert!((e / (15.0 * diffuse) - 1.0).abs() < 0.01, "{e} for {}", 15.0 * diffuse);
    }
    assert_eq!(year.illuminance[2], 0.0);
}

/// Hours of Munich: month, day, label, direct and diffuse irradiance.
fn weather(hours: &[(u32, u32, u32, f64, f64)]) -> Weather {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("made.epw");
    let mut text = String::from("LOCATION,Munich,-,DEU,made,108660,48.1,11.6,1.0,520\n");
    text += &"HEADER,0\n".repeat(7);
    for (month, day, hour, direct, diffuse) in hours {
        text +=
            &format!("2026,{month},{day},{hour},60,?9,20,10,50,95000,0,0,300,500,{direct},{diffuse},0,0\n");
    }
    std::fs::write(&path, text).unwrap();
    Weather::load(&path).unwrap()
}

/// Luminous efficacies of the direct and of the diffuse light of an hour.
fn efficacies(hour: &Hour) -> [f64; 2] {
    let (_, altitude) = hour.sun.unwrap();
    let outside = radiosity::scene::light::SOLAR_CONSTANT * hour.eccentricity;
    radiosity::scene::light::luminous_efficacy([hour.direct, hour.diffuse], altitude, outside, hour.dew_point)
}

/// A wall that the sun goes behind at half past twelve lets in the direct light of the first half of the hour from noon to
/// one: two of its four positions of the sun. There is no other light.
#[test]
fn the_sun_of_an_hour_moves() {
    let weather = weather(&[(6, 21, 13, 700.0, 0.0)]);
    let hour = weather.hours[0];
    let (azimuth, _) = hour.sun.unwrap();
    let [from, to] = [0.0, 1.4].map(|more| Up::Z.direction(azimuth + more, 0.0));
    let wall = scene(&[
        part(level_square(0.1, 0.0, true), 0.0, 0.0),
        part(rectangle(from, to - from, 10.0 * DVec3::Z), 0.0, 0.0),
    ]);
    let tracer = Tracer::new(&wall);
    let patches = Patches::subdivide(&wall, &Subdivision::Count(4));
    let daylight = Daylight::new(&wall, &tracer, patches, &options(), &Progress::new()).unwrap();
    let points = [(DVec3::ZERO, DVec3::Z)];
    let found = daylight.of_points(&points, &Progress::new()).unwrap();
    let year = Year::of(&daylight, &found, Some(&points), &weather, Up::Z, &Progress::new()).unwrap();
    let [efficacy, _] = efficacies(&hour);
    let sines = hour.positions[..2].iter().map(|position| position.unwrap().1.sin()).sum::<f64>();
    let wanted = 700.0 * efficacy * sines / 4.0;
    let e = f64::from(year.illuminance[0]);
    assert!((e / wanted - 1.0).abs() < 1e-5, "{e} for {wanted}");
}

/// Hours of a weather file over an open floor: the illuminance is direct sunlight times the sine of the altitude plus
/// diffuse light, each times its luminous efficacy. The tolerance of 1 % covers the rays to the sky.
#[test]
fn hours_over_an_open_floor() {
    let weather = weather(&[(6, 21, 1, 0.0, 0.0), (6, 21, 10, 500.0, 100.0), (6, 21, 13, 700.0, 120.0)]);
    let floor = scene(&[part(level_square(2.0, 0.0, true), 0.5, 0.0)]);
    let tracer = Tracer::new(&floor);
    let patches = Patches::subdivide(&floor, &Subdivision::Count(2));
    let options = options().with_rays_of_points(1 << 14);
    let daylight = Daylight::new(&floor, &tracer, patches, &options, &Progress::new()).unwrap();
    let points = [(DVec3::ZERO, DVec3::Z)];
    let found = daylight.of_points(&points, &Progress::new()).unwrap();
    let year = Year::of(&daylight, &found, Some(&points), &weather, Up::Z, &Progress::new()).unwrap();
    assert_eq!(year.illuminance[0], 0.0);
    for (k, hour) in weather.hours.iter().enumerate().skip(1) {
        let (_, altitude) = hour.sun.unwrap();
        let [direct, diffuse] = efficacies(hour);
        let wanted = hour.direct * direct * altitude.sin() + hour.diffuse * diffuse;
        let e = f64::from(year.illuminance[k]);
        assert!((e / wanted - 1.0).abs() < 0.01, "{e} for {wanted}");
    }
    // Two of the three hours are from 8 to 18, and both are bright.
    assert_eq!((year.autonomy[0], year.spatial_autonomy), (1.0, 1.0));
}
