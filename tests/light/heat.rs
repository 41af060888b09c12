//! Heat by radiation against closed forms.

use std::fs;

use crate::common::{Corners, flipped, icosphere, parallelogram as rectangle};
use glam::{DVec3, dvec3};
use radiosity::{
    Progress,
    form_factor::exact::opposed_rectangles,
    heat::{Condition, Conditions, Exchange, STEFAN_BOLTZMANN, exchange},
    view_factor::{ViewFactorOptions, view_factors},
};

/// A box whose sides face inward, or outward.
fn cuboid(low: DVec3, size: DVec3, inward: bool) -> Vec<Vec<DVec3>> {
    let [x, y, z] = [DVec3::X * size.x, DVec3::Y * size.y, DVec3::Z * size.z];
    let mut sides = vec![
        rectangle(low, x, y),
        rectangle(low + z, y, x),
        rectangle(low, y, z),
        rectangle(low + x, z, y),
        rectangle(low, z, x),
        rectangle(low + y, x, z),
    ];
    if !inward {
        sides.iter_mut().for_each(|side| side.reverse());
    }
    sides
}

/// Heat flows between surfaces of some polygons each, checked to balance.
fn run(surfaces: &[(Vec<Vec<DVec3>>, Condition)], enclosed: bool, sky: f64) -> Exchange {
    let polygons: Vec<Vec<DVec3>> = surfaces.iter().flat_map(|s| s.0.clone()).collect();
    let of: Vec<usize> = surfaces.iter().enumerate().flat_map(|(k, s)| vec![k; s.0.len()]).collect();
    let conditions: Vec<Condition> = surfaces.iter().map(|s| s.1).collect();
    let options = ViewFactorOptions::default().with_error(3e-4).with_enclosed(enclosed);
    let found = view_factors(&polygons, &options, &Progress::new()).unwrap();
    let heat = exchange(&found, &of, &conditions, sky, 0, &Progress::new()).unwrap();
    assert!(heat.imbalance.abs() < 1e-9, "off balance by {:.1e}", heat.imbalance);
    heat
}

fn at(temperature: f64, emissivity: f64) -> Condition {
    Condition::Temperature { temperature, emissivity }
}

fn power(temperature: f64) -> f64 {
    STEFAN_BOLTZMANN * temperature.powi(4)
}

fn close(got: f64, right: f64, relative: f64) {
    assert!((got / right - 1.0).abs() < relative, "{got}, not {right}");
}

/// Two grey plates under a sky: B1 = e1 + r1 (F B2 + s E) and the other way round are two equations with a closed
/// solution. View factors with an error of 3e-4 (RMS) give the heat to 1e-5, since the formula for F is exact where
/// nothing blocks.
#[test]
fn two_plates_under_a_sky() {
    let up = rectangle(DVec3::ZERO, DVec3::X, DVec3::Y);
    let down = rectangle(DVec3::Z, DVec3::Y, DVec3::X);
    let heat = run(&[(vec![up], at(500.0, 0.8)), (vec![down], at(300.0, 0.3))], false, 250.0);
    let (f, sky) = (opposed_rectangles(1.0, 1.0, 1.0), power(250.0));
    let (e, r) = ([0.8 * power(500.0), 0.3 * power(300.0)], [0.2, 0.7]);
    let s = (1.0 - f) * sky;
    let [a, b] = [e[0] + r[0] * s, e[1] + r[1] * s];
    let radiosity =
        [(a + r[0] * f * b) / (1.0 - r[0] * r[1] * f * f), (b + r[1] * f * a) / (1.0 - r[0] * r[1] * f * f)];
    for k in 0..2 {
        close(heat.surfaces[k].heat, radiosity[k] - f * radiosity[1 - k] - s, 1e-5);
    }
    assert_eq!((heat.surfaces[0].temperature, heat.surfaces[0].temperature_error), (500.0, 0.0));
}

/// A convex body in a black room has q = A ε σ (T1⁴ - T2⁴), whatever the shapes. In a much larger grey room 1/ε becomes
/// 1/ε1 + A1/A2 (1/ε2 - 1), as for concentric spheres, because the light returns evenly: 1e-3 is allowed for that.
#[test]
fn a_convex_body_in_a_room() {
    let room = cuboid(DVec3::ZERO, dvec3(3.0, 4.0, 2.5), true);
    let body = cuboid(dvec3(1.0, 2.0, 1.0), dvec3(0.5, 0.3, 0.2), false);
    let area = 2.0 * (0.5 * 0.3 + 0.5 * 0.2 + 0.3 * 0.2);
    let heat = run(&[(body, at(400.0, 0.6)), (room, at(300.0, 1.0))], true, 0.0);
    let right = area * 0.6 * (power(400.0) - power(300.0));
    close(heat.surfaces[0].heat, right, 1e-4);
    close(heat.surfaces[1].heat, -right, 1e-4);
    close(heat.exchange_areas[(0, 1)], 0.6 * area, 1e-4);
    let body = cuboid(DVec3::splat(4.9), DVec3::splat(0.2), false);
    let room = cuboid(DVec3::ZERO, DVec3::splat(10.0), true);
    let heat = run(&[(body, at(400.0, 0.6)), (room, at(300.0, 0.2))], true, 0.0);
    let resistance = 1.0 / 0.6 + 0.24 / 600.0 * (1.0 / 0.2 - 1.0);
    close(heat.surfaces[0].heat, 0.24 * (power(400.0) - power(300.0)) / resistance, 1e-3);
}

/// One icosahedron in another one: all faces of each are alike, so the forms of concentric spheres hold without an error of
/// discretisation. Script-F times area: A 𝓕12 = 1 / (1 / (A1 ε1) + (1 / ε2 - 1) / A2).
#[test]
fn script_f_of_concentric_bodies() {
    let triangles = |t: Vec<Corners>| t.into_iter().map(Vec::from).collect::<Vec<Vec<DVec3>>>();
    let (inner, outer) = (triangles(icosphere(0.5, 0)), triangles(flipped(icosphere(1.0, 0))));
    let area = |polygons: &[Vec<DVec3>]| {
        polygons.iter().map(|p| (p[1] - p[0]).cross(p[2] - p[0]).length() / 2.0).sum::<f64>()
    };
    let [(a1, e1), (a2, e2)] = [(area(&inner), 0.7), (area(&outer), 0.4)];
    let heat = run(&[(inner, at(400.0, e1)), (outer, at(300.0, e2))], true, 0.0);
    let right = 1.0 / (1.0 / (a1 * e1) + (1.0 / e2 - 1.0) / a2);
    close(heat.exchange_areas[(0, 1)], right, 1e-4);
    close(heat.exchange_areas[(1, 0)], right, 1e-4);
    close(heat.surfaces[0].heat, right * (power(400.0) - power(300.0)), 1e-4);
}

/// An adiabatic shield between two concentric bodies, all icosahedra, so that the resistances add up: the heat is
/// σ (T1⁴ - T2⁴) over 1 / A1 + 1 / As, because all are black. The faces of the shield fill the
/// shafts between the faces of the bodies exactly, and the two bodies do not see each other.
#[test]
fn a_shield_between_concentric_bodies() {
    let faces = |radius: f64, inward: bool| -> Vec<Vec<DVec3>> {
        let sphere = icosphere(radius, 0);
        (if inward { flipped(sphere) } else { sphere }).into_iter().map(Vec::from).collect()
    };
    let surfaces = [
        (faces(0.5, false), at(400.0, 1.0)),
        ([faces(0.75, true), faces(0.75, false)].concat(), Condition::Floating { emissivity: 1.0 }),
        (faces(1.0, true), at(300.0, 1.0)),
    ];
    let area = |faces: &[Vec<DVec3>]| {
        faces.iter().map(|p| (p[1] - p[0]).cross(p[2] - p[0]).length() / 2.0).sum::<f64>()
    };
    let heat = run(&surfaces, true, 0.0);
    let [a1, shield] = [area(&surfaces[0].0), area(&surfaces[1].0) / 2.0];
    let conductance = 1.0 / (1.0 / a1 + 1.0 / shield);
    let right = conductance * (power(400.0) - power(300.0));
    // View factors have an error of 3e-4.
    close(heat.surfaces[0].heat, right, 1e-3);
    close(heat.surfaces[2].heat, -right, 1e-3);
    close(heat.exchange_areas[(0, 2)], conductance, 1e-3);
}

/// Plates 1 m wide and 1 mm apart from an adiabatic shield between them: the heat is σ (T1⁴ - T2⁴) over
/// (1/ε1 + 1/ε3 - 1) + (1/ε3 + 1/ε2 - 1). The rims exchange light with the sky in proportion to about four gaps, which
/// bounds the difference.
#[test]
fn a_shield_between_plates() {
    let gap = 1e-3;
    let plate = |height: f64, up: bool| match up {
        true => rectangle(DVec3::Z * height, DVec3::X, DVec3::Y),
        false => rectangle(DVec3::Z * height, DVec3::Y, DVec3::X),
    };
    let shield = Condition::Floating { emissivity: 0.05 };
    let sky = ((500f64.powi(4) + 300f64.powi(4)) / 2.0).powf(0.25);
    let heat = run(
        &[
            (vec![plate(0.0, true)], at(500.0, 0.8)),
            (vec![plate(2.0 * gap, false)], at(300.0, 0.8)),
            (vec![plate(gap, false), plate(gap, true)], shield),
        ],
        false,
        sky,
    );
    let right = (power(500.0) - power(300.0)) / (2.0 * (1.0 / 0.8 + 1.0 / 0.05 - 1.0));
    // The sky is as warm as the shield and sees each plate by 4 gaps of its area: 16 % beside 1/40 of the power.
    let rim = 4.0 * gap / 2.0 * (power(500.0) - power(300.0)) / 2.0;
    let got = heat.surfaces[0].heat;
    assert!(got > right && got < right + 2.0 * rim, "{got}, not {right} to {}", right + 2.0 * rim);
    close(heat.surfaces[0].heat, -heat.surfaces[1].heat, 1e-4);
    close(heat.surfaces[2].temperature, sky, 1e-5);
    assert_eq!(heat.surfaces[2].heat, 0.0);
}

/// An L-shaped room whose walls hide parts of each other. At one temperature no heat flows, and adiabatic walls take
/// that temperature. With a given flux the heat balances, and the heated wall is warmer than its emissivity requires
/// for emission alone.
#[test]
fn an_l_shaped_room_in_equilibrium() {
    let wall =
        |x: f64, y: f64, dx: f64, dy: f64| rectangle(dvec3(x, y, 0.0), DVec3::Z * 2.5, dvec3(dx, dy, 0.0));
    let mut walls = vec![
        wall(0.0, 0.0, 4.0, 0.0),
        wall(4.0, 0.0, 0.0, 2.0),
        wall(4.0, 2.0, -2.0, 0.0),
        wall(2.0, 2.0, 0.0, 3.0),
        wall(2.0, 5.0, -2.0, 0.0),
        wall(0.0, 5.0, 0.0, -5.0),
    ];
    let mut horizontal = |x: f64, y: f64, dx: f64, dy: f64| {
        walls.push(rectangle(dvec3(x, y, 0.0), DVec3::X * dx, DVec3::Y * dy));
        walls.push(rectangle(dvec3(x, y, 2.5), DVec3::Y * dy, DVec3::X * dx));
    };
    horizontal(0.0, 0.0, 4.0, 2.0);
    horizontal(0.0, 2.0, 2.0, 3.0);
    let surfaces = |first: Condition| -> Vec<(Vec<Vec<DVec3>>, Condition)> {
        let condition = |k: usize| match k {
            0 => first,
            1 | 8 => Condition::Floating { emissivity: 0.4 },
            _ => at(300.0, 0.5 + 0.04 * k as f64),
        };
        walls.iter().enumerate().map(|(k, w)| (vec![w.clone()], condition(k))).collect()
    };
    let still = run(&surfaces(at(300.0, 0.7)), true, 0.0);
    for surface in &still.surfaces {
        assert!(
            surface.heat.abs() < 1e-7 * 10.0 * power(300.0) && (surface.temperature - 300.0).abs() < 1e-4,
            "{surface:?}"
        );
    }
    let heated = run(&surfaces(Condition::Flux { flux: 100.0, emissivity: 0.7 }), true, 0.0);
    close(heated.surfaces[0].heat, 100.0 * 10.0, 1e-12);
    let others: f64 = heated.surfaces[1..].iter().map(|s| s.heat).sum();
    close(others, -1000.0, 1e-9);
    let least = (power(300.0) + 100.0 / 0.7) / STEFAN_BOLTZMANN;
    assert!(heated.surfaces[0].temperature > least.powf(0.25) && heated.surfaces[1].temperature > 300.0);
    assert!(heated.surfaces[2..].iter().any(|s| s.heat_error > 0.0));
}

/// Conditions are read as the file states them, and errors name file and line.
#[test]
fn conditions_are_read_and_errors_name_their_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.toml");
    let names: Vec<String> = ["wall", "big floor", "shield"].map(String::from).to_vec();
    let load = |text: &str| {
        fs::write(&path, text).unwrap();
        Conditions::load(&path, &names)
    };
    let wall = "wall = { temperature = 293, emissivity = 0.9 }\n";
    let rest = "\"big floor\" = { flux = -5.5, emissivity = 1.0 }\nshield = { adiabatic = true }\nsky = { temperature = 250.0 }\n";
    let found = load(&format!("{wall}{rest}")).unwrap();
    assert_eq!(found.sky, Some(250.0));
    assert_eq!(
        found.surfaces,
        [
            at(293.0, 0.9),
            Condition::Flux { flux: -5.5, emissivity: 1.0 },
            Condition::Floating { emissivity: 1.0 }
        ]
    );
    for (text, said) in [
        (format!("{wall}x = 1 2\n"), "a.toml:2: "),
        (format!("{wall}{rest}roof = {{ temperature = 1 }}\n"), "a.toml:5: `roof` is no surface"),
        (format!("\nwall = {{ temperature = 293 }}\n{rest}"), "a.toml:2: `wall` needs an emissivity"),
        (format!("wall = {{ temperature = 293, emissivity = 1.5 }}\n{rest}"), "not between 0 and 1"),
        (format!("wall = {{ temperature = 293, colour = 1 }}\n{rest}"), "colour"),
        (format!("wall = {{ temperature = 293, flux = 1, emissivity = 1 }}\n{rest}"), "one of them"),
        (wall.to_string(), "surface `big floor` has no condition"),
    ] {
        let error = load(&text).unwrap_err().to_string();
        assert!(error.contains(said), "{text}: {error}");
    }
}
