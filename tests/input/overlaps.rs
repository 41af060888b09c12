//! Faces that overlap in one plane: hidden parts are cut away, and nothing else changes.

use glam::{DVec3, dvec3};
use radiosity::{
    Scene,
    scene::{Material, inspection::Inspection},
};

use crate::common::{Random, is_closed};

/// A polygon and its material.
type Face = (u32, Vec<DVec3>);

const WALL: u32 = 0;
const LAMP: u32 = 1;
const RUG: u32 = 2;

fn level(low: [f64; 2], high: [f64; 2], y: f64) -> Vec<DVec3> {
    vec![
        dvec3(low[0], y, low[1]),
        dvec3(high[0], y, low[1]),
        dvec3(high[0], y, high[1]),
        dvec3(low[0], y, high[1]),
    ]
}

/// A room of 4 x 3 x 4, seen from inside. The ceiling comes first.
fn room() -> Vec<Face> {
    let floor = level([0.0, 0.0], [4.0, 4.0], 0.0).into_iter().rev().collect();
    let wall = |a: [f64; 2], b: [f64; 2]| {
        let at = |p: [f64; 2], y| dvec3(p[0], y, p[1]);
        (WALL, vec![at(a, 0.0), at(b, 0.0), at(b, 3.0), at(a, 3.0)])
    };
    let [p, q, r, s] = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]];
    let ceiling = (WALL, level([0.0, 0.0], [4.0, 4.0], 3.0));
    vec![ceiling, (WALL, floor), wall(p, q), wall(q, r), wall(r, s), wall(s, p)]
}

/// A square of side 1 in the ceiling, rotated by an angle.
fn turned(x: f64, z: f64, angle: f64) -> Vec<DVec3> {
    let (sin, cos) = angle.sin_cos();
    let corner = |(u, v): (f64, f64)| dvec3(x + cos * u - sin * v, 3.0, z + sin * u + cos * v);
    [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)].map(corner).to_vec()
}

fn scene(faces: &[Face], place: impl Fn(DVec3) -> DVec3) -> Scene {
    let fan = |(material, points): &Face| {
        let points: Vec<DVec3> = points.iter().map(|&p| place(p)).collect();
        (2..points.len()).map(|k| ([points[0], points[k - 1], points[k]], *material)).collect::<Vec<_>>()
    };
    let triangles: Vec<_> = faces.iter().flat_map(fan).collect();
    let materials = vec![
        Material::new("wall", [0.5; 3], [0.0; 3]),
        Material::new("lamp", [0.0; 3], [10.0; 3]),
        Material::new("rug", [0.2; 3], [0.0; 3]),
    ];
    let mut scene = Scene::new(&triangles, materials);
    scene.cut_overlaps();
    scene
}

/// The total area of a material.
fn area(scene: &Scene, material: u32) -> f64 {
    (0..scene.triangles.len())
        .filter(|&t| scene.triangles[t].material == material)
        .map(|t| scene.area(t))
        .sum()
}

/// Rounded to the six digits of a file.
fn six_digits(p: DVec3) -> DVec3 {
    p.to_array().map(|x| format!("{x:.5e}").parse::<f64>().unwrap()).into()
}

/// A rotation by a random axis and angle.
fn turn(seed: u64) -> impl Fn(DVec3) -> DVec3 {
    let mut random = Random::new(seed);
    let axis = DVec3::from(std::array::from_fn(|_| random.between(-1.0, 1.0))).normalize();
    let rotation = glam::DQuat::from_axis_angle(axis, random.between(0.5, 2.5));
    move |p| rotation * p
}

/// Lamps in the plane of a ceiling that comes first or last in the file, exact or rounded. Every lamp keeps its whole
/// area, the ceiling keeps the rest, and the room stays closed without a crack. The tolerance is the rounding of six
/// digits.
#[test]
fn lamps_flush_with_a_ceiling_replace_it() {
    let fan = |k: u32| {
        let at = |k: u32| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 12.0).sin_cos();
            dvec3(2.0 + cos, 3.0, 2.0 + sin)
        };
        (LAMP, vec![dvec3(2.0, 3.0, 2.0), at(k), at(k + 1)])
    };
    let lamps: [(&str, Vec<Face>, f64); 6] = [
        ("in the middle", vec![(LAMP, level([1.5, 1.5], [2.5, 2.5], 3.0))], 1.0),
        ("in a corner", vec![(LAMP, level([0.0, 0.0], [1.0, 1.0], 3.0))], 1.0),
        ("across", vec![(LAMP, level([0.0, 1.0], [4.0, 2.0], 3.0))], 4.0),
        ("turned", vec![(LAMP, turned(2.1, 1.9, 0.3))], 1.0),
        ("of twelve triangles", (0..12).map(fan).collect(), 3.0),
        ("all of it", vec![(LAMP, level([0.0, 0.0], [4.0, 4.0], 3.0))], 16.0),
    ];
    for (name, lamp, lit) in lamps {
        for (last, rounded) in [(true, false), (false, false), (true, true), (false, true)] {
            let mut faces = room();
            let at = if last { faces.len() } else { 0 };
            faces.splice(at..at, lamp.clone());
            for seed in 0..3 {
                let turn = turn(seed);
                let scene = match rounded {
                    true => scene(&faces, |p| six_digits(turn(p))),
                    false => scene(&faces, |p| if seed == 0 { p } else { turn(p) }),
                };
                let context = format!("{name}, last {last}, rounded {rounded}, {seed}");
                // The sixth digit is a millionth of the room.
                let slack = if rounded { 2e-5 * lit } else { 1e-9 };
                assert!((area(&scene, LAMP) - lit).abs() <= slack, "{context}: {}", area(&scene, LAMP));
                assert!((area(&scene, WALL) - (80.0 - lit)).abs() <= 2e-3, "{context}");
                assert!(is_closed(&scene), "{context}: {:?}", Inspection::of(&scene).edges);
                let hidden = &scene.hidden[0];
                assert_eq!(
                    (hidden.material.as_str(), &hidden.behind[..]),
                    ("wall", &["lamp".to_string()][..])
                );
                assert!((hidden.area - lit).abs() <= 2e-3, "{context}: {}", hidden.area);
            }
        }
    }
}

/// A ceiling of many faces, as exporters write it. Six digits leave its corners up to a unit beside one plane, so that
/// narrow strips appear along the lines where the faces meet. Each strip belongs to the face whose outline it lies in.
#[test]
fn lamps_flush_with_a_ceiling_of_many_faces_replace_it() {
    const N: usize = 5;
    let at = |k: usize| 4.0 * k as f64 / N as f64;
    let cells = (0..N).flat_map(|i| (0..N).map(move |j| (i, j)));
    let ceiling: Vec<Face> =
        cells.map(|(i, j)| (WALL, level([at(i), at(j)], [at(i + 1), at(j + 1)], 3.0))).collect();
    // The upper edge of each wall has the corners of the ceiling, so that the room is closed.
    let plain = room();
    let walls = plain[2..].iter().map(|(material, wall)| {
        let upper = (1..N).map(|k| wall[2].lerp(wall[3], k as f64 / N as f64));
        (*material, [wall[0], wall[1], wall[2]].into_iter().chain(upper).chain([wall[3]]).collect())
    });
    let room: Vec<Face> = ceiling.into_iter().chain([plain[1].clone()]).chain(walls).collect();
    let disc = (0..24).map(|k| std::f64::consts::TAU * f64::from(k) / 24.0);
    let disc: Vec<DVec3> = disc.map(|a| dvec3(2.1 + 0.7 * a.cos(), 3.0, 1.9 + 0.7 * a.sin())).collect();
    let of_disc = 12.0 * 0.49 * (std::f64::consts::TAU / 24.0).sin();
    let halves = |x: f64| (LAMP, level([x, 1.3], [x + 0.5, 2.3], 3.0));
    let lamps: [(&str, Vec<Face>, f64); 4] = [
        ("square", vec![(LAMP, level([1.5, 1.5], [2.5, 2.5], 3.0))], 1.0),
        ("turned", vec![(LAMP, turned(2.1, 1.9, 0.3))], 1.0),
        ("disc", vec![(LAMP, disc)], of_disc),
        ("halves", vec![halves(1.1), halves(1.6)], 1.0),
    ];
    for (name, lamp, lit) in lamps {
        for last in [true, false] {
            let mut faces = room.clone();
            let at = if last { faces.len() } else { 0 };
            faces.splice(at..at, lamp.clone());
            for seed in 0..4 {
                let turn = turn(seed);
                let scene = scene(&faces, |p| six_digits(turn(p)));
                let context = format!("{name}, last {last}, {seed}");
                assert!((area(&scene, LAMP) - lit).abs() <= 2e-5 * lit, "{context}: {}", area(&scene, LAMP));
                assert!((area(&scene, WALL) - (80.0 - lit)).abs() <= 1e-4, "{context}");
                assert!(is_closed(&scene), "{context}: {:?}", Inspection::of(&scene).edges);
                let hidden: Vec<&str> = scene.hidden.iter().map(|hidden| hidden.material.as_str()).collect();
                assert_eq!(hidden, ["wall"], "{context}");
            }
        }
    }
}

/// Ten micrometres in a room of five metres are a gap, which six digits can express.
#[test]
fn small_gaps_stay() {
    for gap in [1e-5, 1e-4, 1e-3] {
        let mut faces = room();
        faces[0] = (WALL, level([0.0, 0.0], [5.0, 4.0], 3.0));
        faces.push((LAMP, level([1.5, 1.5], [2.5, 2.5], 3.0 - gap)));
        for place in [|p| p, six_digits] {
            let apart = scene(&faces, place);
            assert!(apart.hidden.is_empty(), "{gap}: {:?}", apart.hidden);
            assert_eq!(apart.triangles.len(), 14);
        }
    }
}

/// Emitters are in front, then smaller surfaces, then the first in the file.
#[test]
fn the_order_of_overlapping_faces() {
    let small = level([1.0, 1.0], [2.0, 2.0], 3.0);
    let overlapping = level([1.5, 1.0], [2.5, 2.0], 3.0);
    let large = level([0.5, 0.5], [3.5, 3.5], 3.0);
    // Faces with their materials, and the resulting area of each material. A lamp is in front of a smaller rug, a rug
    // in front of a larger wall, and the first in front of the second of the same size.
    let cases: [(&str, Vec<Face>, [f64; 3]); 5] = [
        ("large lamp", vec![(RUG, small.clone()), (LAMP, large.clone())], [0.0, 9.0, 0.0]),
        ("large lamp first", vec![(LAMP, large.clone()), (RUG, small.clone())], [0.0, 9.0, 0.0]),
        ("decal", vec![(WALL, large.clone()), (RUG, small.clone())], [8.0, 0.0, 1.0]),
        ("decal on decal", vec![(RUG, small.clone()), (WALL, overlapping.clone())], [0.5, 0.0, 1.0]),
        ("doubled", vec![(RUG, small.clone()), (WALL, small.clone())], [0.0, 0.0, 1.0]),
    ];
    for (name, faces, areas) in cases {
        let scene = scene(&faces, |p| p);
        for (material, right) in (0..).zip(areas) {
            assert!((area(&scene, material) - right).abs() < 1e-12, "{name}: {}", area(&scene, material));
        }
    }
    // A carpet is in front of the tiles below it although each tile is smaller: together they are one surface.
    let mut faces: Vec<Face> = (0..16)
        .map(|k| (f64::from(k % 4), f64::from(k / 4)))
        .map(|(x, z)| (WALL, level([x, z], [x + 1.0, z + 1.0], 3.0)))
        .collect();
    faces.push((RUG, level([0.3, 0.3], [3.2, 3.2], 3.0)));
    let scene = scene(&faces, |p| p);
    assert!(
        (area(&scene, RUG) - 2.9 * 2.9).abs() < 1e-12
            && (area(&scene, WALL) - (16.0 - 2.9 * 2.9)).abs() < 1e-12
    );
}

/// Faces that only touch, cross, or face each other hide nothing.
#[test]
fn other_faces_are_left_alone() {
    let floor = level([0.0, 0.0], [4.0, 4.0], 0.0);
    let contact: Vec<DVec3> = level([1.0, 1.0], [2.0, 2.0], 0.0).into_iter().rev().collect();
    let beside = level([4.0, 0.0], [5.0, 4.0], 0.0);
    let across =
        vec![dvec3(1.0, -1.0, 1.0), dvec3(2.0, -1.0, 1.0), dvec3(2.0, 1.0, 1.0), dvec3(1.0, 1.0, 1.0)];
    for other in [contact, beside, across] {
        let scene = scene(&[(WALL, floor.clone()), (RUG, other)], |p| p);
        assert_eq!((scene.triangles.len(), scene.hidden.len()), (4, 0));
    }
}

/// The remaining pieces keep the texture coordinates of the file.
#[test]
fn pieces_keep_their_place_on_the_texture() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("s.obj");
    let text = "v 0 0 0\nv 4 0 0\nv 4 4 0\nv 0 4 0\nv 1 1 0\nv 2 1 0\nv 2 3 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n\
                f 1/1 2/2 3/3 4/4\nf 5/1 6/1 7/1\n";
    std::fs::write(&path, text).unwrap();
    let scene = Scene::load(&path).unwrap();
    let mut floor = 0.0;
    for (t, triangle) in scene.triangles.iter().enumerate() {
        for (corner, uv) in scene.corners(t).into_iter().zip(scene.texcoords[t]) {
            if triangle.source < 2 {
                assert!((uv * 4.0 - corner.truncate()).length() < 1e-12, "{corner} {uv}");
            } else {
                assert_eq!(uv, glam::DVec2::ZERO);
            }
        }
        floor += if triangle.source < 2 { scene.area(t) } else { 0.0 };
    }
    assert!((floor - 15.0).abs() < 1e-12, "{floor}");
    assert!(scene.triangles.is_sorted_by_key(|t| t.source));
}
