//! Lights that are no surfaces, against closed forms, the energy that enters, path tracing and light tracing.

use std::f64::consts::PI;

use glam::{DVec3, dvec3};
use radiosity::{
    Progress, Scene,
    accuracy::{
        bias,
        solved::Solved,
        validation::{Validation, ValidationOptions},
    },
    energy::EnergyLedger,
    exact::opposed_rectangles,
    form_factor::CastOptions,
    monte_carlo::{Effort, PathOptions, PathTracer, Receiver},
    output::final_gather::FinalGather,
    patch::Subdivision,
    scene::{
        Material,
        light::{
            Distant, Distribution, Light, LightKind, Mounting, Photometry, PointLight, SUN_DIAMETER, Sky,
            SkyImage, SkyModel, Up, luminaire,
        },
    },
    solve::SolveOptions,
    trace::Tracer,
};

use crate::common::{flipped, level_square, part, rectangle, room_faces, scene};

fn solved(scene: &Scene, patches: usize, rays: f64) -> Solved {
    let (subdivision, cast) = (Subdivision::Count(patches), CastOptions::default().with_rays(rays));
    Solved::new(scene, &Tracer::new(scene), &subdivision, &cast, &SolveOptions::default(), &Progress::new())
        .unwrap()
}

fn with_sky(mut scene: Scene, sky: Sky) -> Scene {
    scene.lights.sky = Some(sky);
    scene
}

fn with_light(mut scene: Scene, kind: LightKind) -> Scene {
    scene.lights.list.push(Light::new("light", kind));
    scene
}

/// The sun at this azimuth and altitude in degrees with 1000 W/m²; z is up.
fn sun(azimuth: f64, altitude: f64) -> LightKind {
    let towards = Up::Z.direction(azimuth.to_radians(), altitude.to_radians());
    LightKind::Distant(Distant::new(towards, [1000.0; 3], SUN_DIAMETER.to_radians()))
}

fn overcast(e: f64) -> Sky {
    Sky::with_irradiance(SkyModel::Overcast, Up::Z, [e; 3])
}

/// Mean irradiance of the front patches, weighted by area, and its standard error.
fn mean(solved: &Solved) -> (f64, f64) {
    let fronts = solved.patches.fronts();
    let areas = &solved.form_factors.areas()[..fronts];
    let total: f64 = areas.iter().sum();
    let mean = (0..fronts).map(|i| areas[i] * solved.solution.irradiance[i]).sum::<f64>() / total;
    (mean, solved.error_bars.of_mean[0])
}

/// Asserts agreement within four standard errors, which are below 2 %, and 1e-4 for single precision.
fn close((found, error): (f64, f64), wanted: f64) {
    assert!((found - wanted).abs() < 4.0 * error + 1e-4 * wanted, "{found} ± {error} for {wanted}");
    assert!(error < 0.02 * wanted, "{found} ± {error} for {wanted}");
}

/// A uniform sky of radiance L gives π L on a horizontal plane and half of that on a wall. An overcast sky gives 7π/9
/// and π/6 + 4/9 times the radiance of its zenith.
#[test]
fn skies_over_planes() {
    let floor = || scene(&[part(level_square(2.0, 0.0, true), 0.5, 0.0)]);
    let wall = || scene(&[part(rectangle(DVec3::ZERO, 2.0 * DVec3::X, 2.0 * DVec3::Z), 0.5, 0.0)]);
    let uniform = || Sky::uniform(Up::Z, [3.0; 3]);
    close(mean(&solved(&with_sky(floor(), uniform()), 32, 256.0)), 3.0 * PI);
    close(mean(&solved(&with_sky(wall(), uniform()), 32, 256.0)), 1.5 * PI);
    close(mean(&solved(&with_sky(floor(), overcast(100.0)), 32, 256.0)), 100.0);
    let zenith = 900.0 / (7.0 * PI);
    close(mean(&solved(&with_sky(wall(), overcast(100.0)), 32, 256.0)), zenith * (PI / 6.0 + 4.0 / 9.0));
}

/// At the bottom of a black pit a uniform sky equals a lid that emits π L: E = π L F.
#[test]
fn sky_at_the_bottom_of_a_pit() {
    let [faces @ .., _] = room_faces(DVec3::ZERO, dvec3(1.0, 1.0, 2.0));
    let is_lid = |face: &Vec<[DVec3; 3]>| face.iter().flatten().all(|p| p.z == 2.0);
    let all = room_faces(DVec3::ZERO, dvec3(1.0, 1.0, 2.0));
    assert_eq!((faces.len(), all.iter().filter(|face| is_lid(face)).count()), (5, 1));
    let parts: Vec<_> =
        all.into_iter().filter(|face| !is_lid(face)).map(|face| part(face, 0.0, 0.0)).collect();
    let pit = with_sky(scene(&parts), Sky::uniform(Up::Z, [2.0; 3]));
    let solved = solved(&pit, 200, 512.0);
    let bottom: Vec<usize> = (0..solved.patches.fronts())
        .filter(|&i| solved.patches.corners(&pit, i).iter().all(|p| p.z == 0.0))
        .collect();
    let areas = solved.form_factors.areas();
    let total: f64 = bottom.iter().map(|&i| areas[i]).sum();
    let found = bottom.iter().map(|&i| areas[i] * solved.solution.irradiance[i]).sum::<f64>() / total;
    let variance =
        bottom.iter().map(|&i| (areas[i] / total * solved.error_bars.standard_error[i]).powi(2)).sum::<f64>();
    close((found, variance.sqrt()), 2.0 * PI * opposed_rectangles(1.0, 1.0, 2.0));
}

/// Unblocked sunlight is exact with any number of rays: E = E₀ sin(altitude) on a floor.
#[test]
fn sun_on_a_floor_is_exact() {
    let floor = scene(&[part(level_square(2.0, 0.0, true), 0.5, 0.0)]);
    let solved = solved(&with_light(floor, sun(200.0, 35.0)), 32, 16.0);
    for (e, error) in solved.solution.irradiance.iter().zip(&solved.error_bars.standard_error) {
        let wanted = 1000.0 * 35f64.to_radians().sin();
        assert!((e / wanted - 1.0).abs() < 1e-6 && *error < 2e-5 * wanted, "{e} ± {error} for {wanted}");
    }
}

/// Behind an edge the visible part of the sun's disc is the segment of a circle. Its diameter and the distance give the
/// width of the penumbra.
#[test]
fn penumbra_of_the_sun() {
    // The sun stands at the zenith. A roof with an edge at x = 0 and a height of 10 covers x < 0.
    let height = 10.0;
    let roof = rectangle(dvec3(-50.0, -50.0, height), 50.0 * DVec3::X, 100.0 * DVec3::Y);
    let parts = [part(level_square(100.0, 0.0, true), 0.0, 0.0), part(roof, 0.0, 0.0)];
    let scene = with_light(scene(&parts), sun(0.0, 90.0));
    let tracer = Tracer::new(&scene);
    let radius = height * (0.5 * SUN_DIAMETER.to_radians()).tan();
    let shares = [-1.2, -0.8, -0.3, 0.0, 0.5, 0.9, 1.1];
    let places: Vec<Receiver> =
        shares.iter().map(|s| Receiver::free(&tracer, dvec3(s * radius, 0.3, 0.0), DVec3::Z)).collect();
    let effort = Effort::default().with_samples(1 << 14);
    let paths = PathTracer::new(&scene, &tracer, PathOptions::default());
    let found = paths.irradiances(&places, &effort, &Progress::new()).unwrap();
    for (s, found) in shares.iter().zip(found) {
        let x = f64::clamp(*s, -1.0, 1.0);
        let seen = 0.5 + (x * (1.0 - x * x).sqrt() + x.asin()) / PI;
        let (e, error) = (found.mean[0], found.standard_error[0]);
        // At half of the light, independent samples have an error of 1000 / 2 / √16384 = 3.9.
        assert!(
            (e - 1000.0 * seen).abs() < 4.0 * error + 1.0 && error < 4.0,
            "{s}: {e} ± {error} for {seen}"
        );
    }
}

/// Sun through a window lights an area of the window's size on the floor, shifted as its altitude requires. The power
/// on the floor is the power through the window.
#[test]
fn sun_through_a_window() {
    let [left, right, top] = [
        rectangle(dvec3(-2.0, 0.0, 0.0), dvec3(1.5, 0.0, 0.0), 3.0 * DVec3::Z),
        rectangle(dvec3(0.5, 0.0, 0.0), dvec3(1.5, 0.0, 0.0), 3.0 * DVec3::Z),
        rectangle(dvec3(-0.5, 0.0, 2.0), DVec3::X, DVec3::Z),
    ];
    let sill = rectangle(dvec3(-0.5, 0.0, 0.0), DVec3::X, DVec3::Z);
    // Narrower than the wall: part of the sun's disc shines past the ends of the wall.
    let floor = rectangle(dvec3(-1.5, 0.0, 0.0), 3.0 * DVec3::X, 4.0 * DVec3::Y);
    let roof = flipped(rectangle(dvec3(-2.0, 0.0, 3.0), 4.0 * DVec3::X, 4.0 * DVec3::Y));
    let parts = [left, right, top, sill, floor, roof].map(|face| part(face, 0.0, 0.0));
    // From the south, y < 0: light travels towards +y, downward at 45 degrees.
    let scene = with_light(scene(&parts), sun(180.0, 45.0));
    let solved = solved(&scene, 4000, 64.0);
    let inside = |i: usize| {
        let (middle, normal) = (solved.patches.centroid(&scene, i), solved.patches.normal(&scene, i));
        middle.z == 0.0 && normal.z > 0.5
    };
    let on_floor: Vec<usize> = (0..solved.patches.len()).filter(|&i| inside(i)).collect();
    let areas = solved.form_factors.areas();
    let power: f64 = on_floor.iter().map(|&i| areas[i] * solved.solution.irradiance[i]).sum();
    let variance: f64 =
        on_floor.iter().map(|&i| (areas[i] * solved.error_bars.standard_error[i]).powi(2)).sum();
    // One square metre of window, 45 degrees from facing the sun.
    close((power, variance.sqrt()), 1000.0 * 45f64.to_radians().cos());
    // Light from 1 to 2 m above the floor lands from 1 to 2 m behind the window.
    for &i in &on_floor {
        let corners = solved.patches.corners(&scene, i);
        let all = |f: &dyn Fn(DVec3) -> bool| corners.iter().all(|&p| f(p));
        let margin = 0.03;
        let lit = all(&|p| p.x.abs() < 0.5 - margin && (1.0 + margin..2.0 - margin).contains(&p.y));
        let dark = all(&|p| p.x > 0.5 + margin)
            || all(&|p| p.x < -0.5 - margin)
            || all(&|p| p.y < 1.0 - margin)
            || all(&|p| p.y > 2.0 + margin);
        let e = solved.solution.irradiance[i];
        let wanted = 1000.0 * 45f64.to_radians().sin();
        assert!(!lit || (e / wanted - 1.0).abs() < 1e-3, "{corners:?}: {e} for {wanted}");
        assert!(!dark || e == 0.0, "{corners:?}: {e}");
    }
}

/// Solid angle of a square of this side, seen from a height above its middle.
fn solid_angle_of_square(side: f64, height: f64) -> f64 {
    let a = 0.5 * side;
    4.0 * (a * a / (height * (2.0 * a * a + height * height).sqrt())).atan()
}

/// A point of intensity I sends the power I Ω to a square: near and far, exact with any number of rays, and the same
/// watts in any unit of length.
#[test]
fn a_point_over_a_square() {
    for (height, scale) in [(0.3, 1.0), (2.0, 1.0), (2.0, 1000.0)] {
        let square = scene(&[part(level_square(2.0 * scale, 0.0, true), 0.5, 0.0)]);
        let light = PointLight::isotropic(dvec3(0.0, 0.0, height * scale), [5.0; 3]);
        let solved = solved(&with_light(square, LightKind::Point(light)), 64, 16.0);
        let areas = solved.form_factors.areas();
        let power: f64 = areas.iter().zip(&solved.solution.irradiance).map(|(a, e)| a * e).sum();
        let wanted = 5.0 * solid_angle_of_square(2.0, height);
        assert!((power / wanted - 1.0).abs() < 1e-5, "{height}: {power} for {wanted}");
    }
}

/// A cone within the square sends all of its flux there, wherever it points. The quadrature over patches has an error
/// below 1e-3.
#[test]
fn a_spot_over_a_square() {
    let square = || scene(&[part(level_square(4.0, 0.0, true), 0.0, 0.0)]);
    for axis in [-DVec3::Z, dvec3(0.4, -0.3, -1.0)] {
        let distribution = Distribution::spot(axis, 0.2, 0.4);
        let flux = 5.0 * distribution.total();
        let light = PointLight::new(dvec3(0.1, 0.0, 1.5), [5.0; 3], distribution);
        let scene = with_light(square(), LightKind::Point(light.clone()));
        let solved = solved(&scene, 500, 64.0);
        let areas = solved.form_factors.areas();
        let power: f64 = areas.iter().zip(&solved.solution.irradiance).map(|(a, e)| a * e).sum();
        assert!((power / flux - 1.0).abs() < 1e-3, "{axis}: {power} for {flux}");
        // On the axis the square gets the full intensity over the squared distance.
        let tracer = Tracer::new(&scene);
        let at = light.position - axis * (light.position.z / axis.z);
        let place = Receiver::free(&tracer, at, DVec3::Z);
        let paths = PathTracer::new(&scene, &tracer, PathOptions::default());
        let found = paths.irradiances(&[place], &Effort::default(), &Progress::new()).unwrap()[0];
        let path = light.position - at;
        let wanted = 5.0 * path.normalize().z / path.length_squared();
        assert!((found.mean[0] / wanted - 1.0).abs() < 1e-5, "{} for {wanted}", found.mean[0]);
    }
}

/// A disc of 0.2 m in diameter that emits downward with an intensity of 100 cd times the cosine.
fn cosine_disc() -> Photometry {
    let angles: Vec<String> = (0..=90).step_by(2).map(|angle| angle.to_string()).collect();
    let candela = (0..=90).step_by(2).map(|angle| (100.0 * f64::from(angle).to_radians().cos()).to_string());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("disc.ies");
    let text = format!(
        "IESNA91\nTILT=NONE\n1 -1 1 {} 1 1 2 -0.2 -0.2 0\n1 1 10\n{}\n0\n{}\n",
        angles.len(),
        angles.join(" "),
        candela.collect::<Vec<_>>().join(" ")
    );
    std::fs::write(&path, text).unwrap();
    Photometry::load(&path).unwrap()
}

/// At 2 m below the disc: E = π L r² / (r² + d²) with L = I / (π r²), 24.94 lx; a point would give 25. A small patch
/// there receives as much, within its error bar.
#[test]
fn a_disc_of_a_photometric_file() {
    let floor = scene(&[part(level_square(0.02, 0.0, true), 0.0, 0.0)]);
    let hung = Mounting { position: dvec3(0.0, 0.0, 2.0), aim: None, rotation: 0.0, dimming: 1.0 };
    let scene = with_light(floor, LightKind::Point(luminaire(cosine_disc(), Up::Z, &hung, 1.0)));
    let wanted = 100.0 / (0.1f64.powi(2) + 4.0);
    let tracer = Tracer::new(&scene);
    let place = Receiver::free(&tracer, DVec3::ZERO, DVec3::Z);
    let paths = PathTracer::new(&scene, &tracer, PathOptions::default());
    let found = paths.irradiances(&[place], &Effort::default(), &Progress::new()).unwrap()[0];
    assert!((found.mean[0] / wanted - 1.0).abs() < 1e-4, "{} for {wanted}", found.mean[0]);
    assert!((found.mean[0] - 24.94).abs() < 0.01, "{}", found.mean[0]);
    let solved = solved(&scene, 2, 256.0);
    let (e, error) = mean(&solved);
    assert!((e / wanted - 1.0).abs() < 1e-3 + 4.0 * error / wanted, "{e} ± {error} for {wanted}");
}

/// A court with a block in it, lit by sky, sun, a spot and a lamp.
fn court() -> Scene {
    let block = room_faces(dvec3(-0.4, -0.3, 0.0), dvec3(0.2, 0.3, 0.8)).map(flipped);
    let mut parts = vec![
        part(level_square(4.0, 0.0, true), 0.5, 0.0),
        part(flipped(rectangle(dvec3(-2.0, 2.0, 0.0), 4.0 * DVec3::X, 1.5 * DVec3::Z)), 0.7, 0.0),
        part(rectangle(dvec3(-2.0, -2.0, 0.0), 4.0 * DVec3::Y, 1.5 * DVec3::Z), 0.3, 0.0),
    ];
    // Without its bottom, which is on the floor.
    parts.extend(
        block.into_iter().filter(|face| face.iter().flatten().any(|p| p.z > 0.0)).map(|f| part(f, 0.6, 0.0)),
    );
    parts.push(part(level_square(0.3, 1.6, false), 0.0, 400.0));
    scene(&parts)
}

/// All power that is emitted or enters is absorbed or escapes.
#[test]
fn the_ledger_has_an_outside() {
    let mut scene = with_light(with_sky(court(), overcast(150.0)), sun(150.0, 50.0));
    let spot = Distribution::spot(dvec3(-1.0, 1.0, -1.0), 0.3, 0.6);
    let spot = PointLight::new(dvec3(1.5, -1.5, 2.0), [300.0, 200.0, 100.0], spot);
    scene.lights.list.push(Light::new("spot", LightKind::Point(spot)));
    let solved = solved(&scene, 400, 64.0);
    assert_eq!(solved.patches.channels(), 3);
    let ledger = EnergyLedger::of(&solved.form_factors, &solved.patches, &solved.solution);
    for c in 0..3 {
        let (emitted, entered) = (ledger.emitted[c], ledger.entered[c]);
        assert!((emitted - 0.09 * 400.0).abs() < 1e-9 && entered > 2000.0, "{emitted} {entered}");
        let left = emitted + entered - ledger.absorbed[c] - ledger.escaped[c];
        assert!(left.abs() < 1e-9 * (emitted + entered), "{left}");
    }
    assert!(ledger.entered[0] > ledger.entered[1] && ledger.entered[1] > ledger.entered[2]);
    assert!(ledger.imbalance().abs() < 1e-9);
}

/// The power that enters has a standard error: over many seeds it spreads by no more, and by no less than a third, since parts of one
/// sequence complement each other. Of a sun that nothing blocks it is known exactly.
#[test]
fn what_enters_spreads_as_its_standard_error_says() {
    let scene = with_light(with_sky(court(), overcast(150.0)), sun(150.0, 50.0));
    let tracer = Tracer::new(&scene);
    let entered = |seed: u64| {
        let cast = CastOptions::default().with_rays(64.0).with_seed(seed);
        let (patches, options) = (Subdivision::Count(120), SolveOptions::default());
        let solved = Solved::new(&scene, &tracer, &patches, &cast, &options, &Progress::new()).unwrap();
        let ledger = EnergyLedger::of(&solved.form_factors, &solved.patches, &solved.solution);
        (ledger.entered[0], solved.error_bars.of_entered[0])
    };
    const SEEDS: usize = 40;
    let found: Vec<(f64, f64)> = (0..SEEDS as u64).map(entered).collect();
    let many = SEEDS as f64;
    let mean = found.iter().map(|(e, _)| e).sum::<f64>() / many;
    let spread = (found.iter().map(|(e, _)| (e - mean).powi(2)).sum::<f64>() / (many - 1.0)).sqrt();
    let said = (found.iter().map(|(_, error)| error.powi(2)).sum::<f64>() / many).sqrt();
    // A spread of 40 is known to 11 %.
    assert!(spread < 1.4 * said && spread > 0.3 * said, "{spread} for {said} of {mean}");
    assert!(said < 0.01 * mean, "{said} of {mean}");

    let floor = with_light(scene_of_floor(), sun(150.0, 50.0));
    let solved = solved(&floor, 8, 64.0);
    let ledger = EnergyLedger::of(&solved.form_factors, &solved.patches, &solved.solution);
    let wanted = 4.0 * 1000.0 * 50f64.to_radians().sin();
    assert!((ledger.entered[0] / wanted - 1.0).abs() < 1e-4, "{} for {wanted}", ledger.entered[0]);
    assert!(solved.error_bars.of_entered[0] < 1e-5 * wanted);
}

/// A floor of two by two.
fn scene_of_floor() -> Scene {
    scene(&[part(level_square(2.0, 0.0, true), 0.5, 0.0)])
}

/// The bias is found by starting from a solution with all rays. A black lamp emits as much in it as it does by direct light, once.
#[test]
fn a_black_lamp_under_a_sky_has_a_bias() {
    let scene = with_sky(court(), overcast(150.0));
    let (tracer, options) = (Tracer::new(&scene), SolveOptions::default());
    let solved = solved(&scene, 120, 64.0);
    let Solved { form_factors, patches, solution, .. } = &solved;
    let bias = bias::relative(form_factors, &tracer, patches, solution, &options, &Progress::new()).unwrap();
    assert!(bias.unwrap().abs() < 0.02, "{bias:?}");
}

/// Every kind of light passes the validation: radiosity, paths and particles agree within their errors.
#[test]
fn each_kind_passes_the_validation() {
    let lamp = |mut scene: Scene, shines: bool| {
        if !shines {
            scene.materials.iter_mut().for_each(|m: &mut Material| m.emission = [0.0; 3]);
        }
        scene
    };
    let dark = || lamp(court(), false);
    let point = PointLight::isotropic(dvec3(0.7, 0.4, 1.1), [20.0; 3]);
    let spot = PointLight::new(
        dvec3(1.5, 1.0, 1.5),
        [50.0; 3],
        Distribution::spot(dvec3(-1.0, -0.6, -0.8), 0.2, 0.6),
    );
    let towards = Up::Z.direction(4.0, 0.8);
    let mut texels: Vec<[f32; 3]> = (0..64 * 32).map(|k| [4.0 + (k % 5) as f32; 3]).collect();
    texels[9 * 64 + 20] = [2e4; 3];
    texels[4 * 64 + 50] = [6e3; 3];
    let image = Sky::image(SkyImage::new(64, 32, texels).unwrap(), Up::Z, 1.0);
    let perez = Sky::all_weather(Up::Z, [500.0, 120.0], towards, 1367.0);
    let hung = Mounting { position: dvec3(0.8, -0.9, 1.2), aim: None, rotation: 0.4, dimming: 1.0 };
    let lamp_of_file = luminaire(cosine_disc(), Up::Z, &hung, 1.0);
    let kinds = [
        ("image", with_sky(dark(), image)),
        ("all-weather sky", with_sky(dark(), perez)),
        ("luminaire", with_light(dark(), LightKind::Point(lamp_of_file))),
        ("uniform sky", with_sky(dark(), Sky::uniform(Up::Z, [30.0; 3]))),
        ("clear sky", with_sky(dark(), Sky::with_irradiance(SkyModel::Clear(towards), Up::Z, [80.0; 3]))),
        ("sun", with_light(dark(), sun(150.0, 50.0))),
        ("directional", with_light(dark(), LightKind::Distant(Distant::new(towards, [100.0; 3], 0.0)))),
        ("point", with_light(dark(), LightKind::Point(point))),
        ("spot", with_light(dark(), LightKind::Point(spot))),
        ("all", with_light(with_sky(lamp(court(), true), overcast(100.0)), sun(150.0, 50.0))),
    ];
    for (name, scene) in kinds {
        let options = ValidationOptions::default()
            .with_subdivision(Subdivision::Count(250))
            .with_rays(256.0)
            .with_paths(256)
            .with_particles(1 << 18);
        let tracer = Tracer::new(&scene);
        let validation = Validation::of(&scene, &tracer, &options, &Progress::new()).unwrap();
        assert!(validation.objections().is_empty(), "{name}: {:?}", validation.objections());
        assert!(validation.energy.entered[0] > 0.0, "{name}");
    }
}

/// Final gather from a solution agrees with path tracing under a sky and a sun.
#[test]
fn final_gather_sees_the_lights() {
    let scene = with_light(with_sky(court(), overcast(100.0)), sun(150.0, 50.0));
    let (tracer, solved) = (Tracer::new(&scene), solved(&scene, 1000, 128.0));
    let gather = FinalGather::new(&scene, &tracer, &solved.patches, &solved.solution, 1);
    let paths = PathTracer::new(&scene, &tracer, PathOptions::default());
    let places = [dvec3(1.0, 1.0, 0.0), dvec3(-1.0, 0.5, 0.0), dvec3(0.5, 0.0, 0.0)]
        .map(|p| Receiver::free(&tracer, p, DVec3::Z));
    let effort = Effort::default().with_samples(1 << 13);
    let found = gather.irradiances(&places, &effort, &Progress::new()).unwrap();
    let wanted = paths.irradiances(&places, &effort, &Progress::new()).unwrap();
    for (found, wanted) in found.iter().zip(&wanted) {
        let (a, b) = (found.mean[0], wanted.mean[0]);
        let error = found.standard_error[0].hypot(wanted.standard_error[0]);
        // The remaining difference is the size of the patches, in reflected light only.
        assert!((a - b).abs() < 4.0 * error + 0.01 * b, "{a} for {b} ± {error}");
    }
}

/// Lights without power change nothing: the results have the same bits as without them.
#[test]
fn dark_lights_cost_nothing() {
    let plain = solved(&court(), 200, 64.0);
    let nothing = LightKind::Distant(Distant::new(DVec3::Z, [0.0; 3], 0.01));
    let with = solved(&with_light(court(), nothing), 200, 64.0);
    assert_eq!(plain.solution.irradiance, with.solution.irradiance);
    assert_eq!(plain.error_bars, with.error_bars);
}
