//! Triangles that another surface touches or crosses are cut along that line, and nothing else changes.

use std::collections::{HashMap, HashSet};

use glam::{DQuat, DVec2, DVec3, dvec2, dvec3};
use radiosity::{Scene, scene::Material};

use crate::common::Random;

const GROUND: u32 = 0;
const WALL: u32 = 1;

fn quad(material: u32, corners: [DVec3; 4]) -> Vec<([DVec3; 3], u32)> {
    let [a, b, c, d] = corners;
    vec![([a, b, c], material), ([a, c, d], material)]
}

/// A horizontal rectangle that faces up.
fn level(material: u32, low: DVec2, high: DVec2, y: f64) -> Vec<([DVec3; 3], u32)> {
    let at = |x: f64, z: f64| dvec3(x, y, z);
    quad(material, [at(low.x, low.y), at(low.x, high.y), at(high.x, high.y), at(high.x, low.y)])
}

/// A box without bottom and top whose walls begin at height `from`. Its faces look outward.
fn walls(low: DVec2, high: DVec2, from: f64, to: f64) -> Vec<([DVec3; 3], u32)> {
    let outline = [dvec2(low.x, low.y), dvec2(low.x, high.y), dvec2(high.x, high.y), dvec2(high.x, low.y)];
    let at = |p: DVec2, y: f64| dvec3(p.x, y, p.y);
    (0..4)
        .flat_map(|k| {
            let (p, q) = (outline[k], outline[(k + 1) % 4]);
            quad(WALL, [at(p, from), at(q, from), at(q, to), at(p, to)])
        })
        .collect()
}

fn scene(triangles: &[([DVec3; 3], u32)], place: impl Fn(DVec3) -> DVec3) -> Scene {
    let placed: Vec<_> = triangles.iter().map(|(corners, m)| (corners.map(&place), *m)).collect();
    let materials = ["ground", "wall"].map(|name| Material::new(name, [0.5; 3], [0.0; 3]));
    let mut scene = Scene::new(&placed, materials.to_vec());
    scene.cut_overlaps();
    scene.cut_contacts();
    scene
}

/// Rounded to the six digits of a file.
fn six_digits(p: DVec3) -> DVec3 {
    p.to_array().map(|x| format!("{x:.5e}").parse::<f64>().unwrap()).into()
}

/// The number of pieces of the ground that lie on both sides of a rectangle's outline, and the largest area on the
/// wrong side.
fn straddling(scene: &Scene, back: impl Fn(DVec3) -> DVec3, low: DVec2, high: DVec2) -> (usize, f64) {
    let mut worst: (usize, f64) = (0, 0.0);
    for t in (0..scene.triangles.len()).filter(|&t| scene.triangles[t].material == GROUND) {
        let corners = scene.corners(t).map(&back).map(|p| dvec2(p.x, p.z));
        let mut inside = corners.to_vec();
        for (normal, offset) in
            [(DVec2::X, low.x), (-DVec2::X, -high.x), (DVec2::Y, low.y), (-DVec2::Y, -high.y)]
        {
            inside = clipped(&inside, normal, offset);
        }
        let (inside, whole) = (area(&inside), area(&corners));
        let off = inside.min(whole - inside);
        // A strip along the whole outline, as wide as the rounding of single precision.
        if off > 1e-5 {
            worst = (worst.0 + 1, worst.1.max(off));
        }
    }
    worst
}

fn clipped(polygon: &[DVec2], normal: DVec2, offset: f64) -> Vec<DVec2> {
    let side = |p: DVec2| normal.dot(p) - offset;
    let mut kept = Vec::new();
    for (k, &p) in polygon.iter().enumerate() {
        let q = polygon[(k + 1) % polygon.len()];
        if side(p) >= 0.0 {
            kept.push(p);
        }
        if side(p) * side(q) < 0.0 {
            kept.push(p + (q - p) * (side(p) / (side(p) - side(q))));
        }
    }
    kept
}

fn area(polygon: &[DVec2]) -> f64 {
    let shoelace = |k: usize| polygon[k].perp_dot(polygon[(k + 1) % polygon.len()]);
    0.5 * (0..polygon.len()).map(shoelace).sum::<f64>().abs()
}

/// Edges, by position, that are not used once in each direction: the rims of surfaces.
fn rims(scene: &Scene) -> HashMap<[[u64; 3]; 2], i32> {
    let mut halves: HashMap<[[u64; 3]; 2], i32> = HashMap::new();
    for t in 0..scene.triangles.len() {
        let corners = scene.corners(t).map(|p| (p + 0.0).to_array().map(f64::to_bits));
        for k in 0..3 {
            let (p, q) = (corners[k], corners[(k + 1) % 3]);
            *halves.entry([p.min(q), p.max(q)]).or_default() += if p < q { 1 } else { -1 };
        }
    }
    halves.retain(|_, n| *n != 0);
    halves
}

fn rim_length(scene: &Scene) -> f64 {
    let at = |p: [u64; 3]| DVec3::from(p.map(f64::from_bits));
    rims(scene).iter().map(|([p, q], n)| f64::from(n.abs()) * at(*p).distance(at(*q))).sum()
}

/// Walls that stand on a ground, a micrometre above it, or through it, in the middle of a large ground; also rotated
/// and rounded to the six digits of a file. No piece of the ground lies on both sides of a wall, the area stays the
/// same up to the rounding of the file, and the number of pieces grows with the logarithm of the ground's size.
#[test]
fn no_piece_of_a_ground_lies_on_both_sides_of_a_wall() {
    let turn = DQuat::from_axis_angle(dvec3(0.3, -0.5, 0.8).normalize(), 1.1);
    let (low, high) = (dvec2(-1.3, -0.9), dvec2(2.2, 1.6));
    for half in [5.0, 200.0, 1000.0] {
        for (from, rounded) in [(0.0, false), (1e-6, false), (-0.01, false), (-0.7, true), (0.0, true)] {
            let ground = level(GROUND, dvec2(-half, -half), dvec2(half, half + 1.0), 0.0);
            let all: Vec<_> = ground.into_iter().chain(walls(low, high, from, 2.5)).collect();
            let place = |p: DVec3| if rounded { six_digits(turn * p) } else { p };
            let back = |p: DVec3| if rounded { turn.inverse() * p } else { p };
            let scene = scene(&all, place);
            let what = format!("{half} {from} {rounded}: {:?}", scene.contacts);
            let ground: Vec<usize> =
                (0..scene.triangles.len()).filter(|&t| scene.triangles[t].material == GROUND).collect();
            // Rounding to six digits tilts a large ground, which shifts the line where walls meet it.
            let slack = if rounded { 1e-4 * half } else { 0.0 };
            let (pieces, off) = straddling(&scene, back, low - slack, high + slack);
            if !rounded {
                assert_eq!(pieces, 0, "{what} {off}");
            }
            let whole: f64 = ground.iter().map(|&t| scene.area(t)).sum();
            assert!((whole / (2.0 * half * (2.0 * half + 1.0)) - 1.0).abs() < 1e-5, "{what} {whole}");
            assert!(ground.len() > 10 && ground.len() < 250, "{what} {}", ground.len());
            assert!(ground.iter().all(|&t| scene.triangles[t].source < 2), "{what}");
        }
    }
}

/// A closed room stays closed when it is cut by a block on its floor, a block half in a wall, and partitions between
/// walls: every edge is used equally often in both directions, and the area stays the same, to rounding.
#[test]
fn what_was_closed_stays_closed() {
    let turn = DQuat::from_axis_angle(dvec3(0.3, -0.5, 0.8).normalize(), 1.1);
    for turned in [false, true] {
        let place = |p: DVec3| if turned { turn * p + 7.0 } else { p };
        let inside_out = |all: Vec<([DVec3; 3], u32)>| all.into_iter().map(|([a, b, c], m)| ([a, c, b], m));
        let room = |low: DVec3, high: DVec3| {
            let (l, h) = (dvec2(low.x, low.z), dvec2(high.x, high.z));
            let floor = inside_out(level(WALL, l, h, low.y)).collect::<Vec<_>>();
            walls(l, h, low.y, high.y)
                .into_iter()
                .chain(level(WALL, l, h, high.y))
                .chain(floor)
                .collect::<Vec<_>>()
        };
        let mut all: Vec<_> = inside_out(room(dvec3(0., 0., 0.), dvec3(5., 3., 4.))).collect();
        // On the floor, in a wall, across the whole room, and two that cross each other.
        all.extend(room(dvec3(1., 0., 1.), dvec3(1.5, 1., 1.7)));
        all.extend(room(dvec3(4.5, 0., 2.), dvec3(5., 1., 3.)));
        all.extend(room(dvec3(2.2, 0., 0.), dvec3(2.3, 3., 4.)));
        all.extend(room(dvec3(3.1, 0.5, 0.2), dvec3(3.7, 1.5, 3.3)));
        all.extend(room(dvec3(3.0, 0.7, 1.2), dvec3(3.9, 1.1, 1.9)));
        let scene = scene(&all, place);
        assert!(scene.contacts.triangles > 8, "{:?}", scene.contacts);
        let length = rim_length(&scene);
        assert!(length == 0.0, "{turned} {length} {:?}", scene.contacts);
        let total: f64 = (0..scene.triangles.len()).map(|t| scene.area(t)).sum();
        let want: f64 = all.iter().map(|([a, b, c], _)| 0.5 * (*b - *a).cross(*c - *a).length()).sum();
        assert!((total / want - 1.0).abs() < 1e-12, "{total} {want}");
    }
}

/// Random triangles that cross each other: the pieces have the area of their triangle, and no piece crosses another
/// triangle.
#[test]
fn random_triangles_are_cut_where_they_cross() {
    let mut random = Random::new(3);
    let mut point = || DVec3::from(std::array::from_fn(|_| random.between(-1.0, 1.0)));
    let all: Vec<_> = (0..60).map(|_| ([point(), point(), point()], WALL)).collect();
    let scene = scene(&all, |p| p);
    let mut areas = vec![0.0; all.len()];
    for t in 0..scene.triangles.len() {
        areas[scene.triangles[t].source as usize] += scene.area(t);
    }
    for (area, ([a, b, c], _)) in areas.iter().zip(&all) {
        assert!((area / (0.5 * (b - a).cross(c - a).length()) - 1.0).abs() < 1e-9);
    }
    let mut crossed = 0;
    for t in 0..scene.triangles.len() {
        let piece = scene.corners(t);
        for (other, ([a, b, c], _)) in all.iter().enumerate() {
            if other == scene.triangles[t].source as usize {
                continue;
            }
            crossed += usize::from(crosses(piece, [*a, *b, *c]));
        }
    }
    assert_eq!(crossed, 0, "of {} pieces, {:?}", scene.triangles.len(), scene.contacts);
}

/// Whether a triangle crosses the inside of another by more than rounding.
fn crosses(piece: [DVec3; 3], [a, b, c]: [DVec3; 3]) -> bool {
    let normal = (b - a).cross(c - a).normalize();
    let heights = piece.map(|p| normal.dot(p - a));
    let mut ends = Vec::new();
    for k in 0..3 {
        let (h, i) = (heights[k], heights[(k + 1) % 3]);
        if h * i < 0.0 && h.abs().min(i.abs()) > 1e-4 {
            ends.push(piece[k] + (piece[(k + 1) % 3] - piece[k]) * (h / (h - i)));
        }
    }
    let inside = |p: DVec3| {
        [(a, b), (b, c), (c, a)]
            .into_iter()
            .all(|(q, r)| (r - q).cross(p - q).dot(normal) > 1e-3 * (r - q).length())
    };
    ends.len() == 2 && (0..=10).any(|k| inside(ends[0].lerp(ends[1], f64::from(k) / 10.0)))
}

/// Scenes without contacts stay as they are. Tiles whose joints lie under a wall need no cut.
#[test]
fn nothing_is_cut_where_nothing_touches() {
    let tiles: Vec<_> = (0..4)
        .flat_map(|k| {
            let low = dvec2(f64::from(k % 2), f64::from(k / 2));
            level(GROUND, low, low + 1.0, 0.0)
        })
        .collect();
    let (plain, above) = (scene(&tiles, |p| p), walls(dvec2(0.2, 0.2), dvec2(1.8, 1.8), 0.1, 1.0));
    assert_eq!((plain.triangles.len(), plain.contacts), (8, Default::default()));
    let apart = scene(&tiles.iter().cloned().chain(above).collect::<Vec<_>>(), |p| p);
    assert_eq!((apart.triangles.len(), apart.contacts), (16, Default::default()));
    let joint = quad(WALL, [dvec3(1., 0., 0.), dvec3(1., 0., 2.), dvec3(1., 1., 2.), dvec3(1., 1., 0.)]);
    let on_joint = scene(&tiles.iter().cloned().chain(joint).collect::<Vec<_>>(), |p| p);
    assert_eq!((on_joint.triangles.len(), on_joint.contacts), (10, Default::default()));
    // The tiles on the two sides share no vertex, and the wall shares none with them.
    let vertices = |range: std::ops::Range<usize>| {
        on_joint.triangles[range].iter().flat_map(|t| t.vertices).collect::<HashSet<u32>>()
    };
    let tiles_on = |x: f64| {
        (0..8).filter(|&t| on_joint.corners(t).iter().all(|p| (p.x - x).abs() <= 0.5)).collect::<Vec<_>>()
    };
    let of = |tiles: Vec<usize>| tiles.into_iter().flat_map(|t| vertices(t..t + 1)).collect::<HashSet<u32>>();
    let (left, right) = (of(tiles_on(0.5)), of(tiles_on(1.5)));
    assert_eq!((left.len(), right.len()), (6, 6));
    assert!(left.is_disjoint(&right) && vertices(8..10).is_disjoint(&left));
}

/// The part of a lamp behind a block is left out. A lamp that lies wholly in the ceiling of a room whose walls face
/// outward is seen from inside and stays.
#[test]
fn only_a_part_of_a_lamp_is_hidden_by_a_solid() {
    let solid = |low: DVec3, high: DVec3| {
        let (l, h) = (dvec2(low.x, low.z), dvec2(high.x, high.z));
        let floor = level(GROUND, l, h, low.y).into_iter().map(|([a, b, c], m)| ([a, c, b], m));
        walls(l, h, low.y, high.y)
            .into_iter()
            .chain(level(GROUND, l, h, high.y))
            .chain(floor)
            .collect::<Vec<_>>()
    };
    let lamp = |y: f64, up: bool| {
        let all = level(2, dvec2(0.0, 0.0), dvec2(2.0, 2.0), y);
        all.into_iter().map(move |([a, b, c], m)| (if up { [a, b, c] } else { [a, c, b] }, m))
    };
    let load = |all: Vec<([DVec3; 3], u32)>| {
        let mut materials = ["ground", "wall"].map(|name| Material::new(name, [0.5; 3], [0.0; 3])).to_vec();
        materials.push(Material::new("lamp", [0.0; 3], [1.0; 3]));
        let mut scene = Scene::new(&all, materials);
        scene.cut_overlaps();
        scene.cut_contacts();
        scene
    };
    let of_lamp = |scene: &Scene| -> f64 {
        (0..scene.triangles.len()).filter(|&t| scene.emits(t)).map(|t| scene.area(t)).sum()
    };
    // A floor that emits, under a block that may reach beyond it.
    for (x, hidden) in [(0.5, 1.0), (1.5, 0.5)] {
        let block = solid(dvec3(x, 0.0, 0.5), dvec3(x + 1.0, 1.0, 1.5));
        let scene = load(block.into_iter().chain(lamp(0.0, true)).collect());
        assert!((of_lamp(&scene) - (4.0 - hidden)).abs() < 1e-12, "{}", of_lamp(&scene));
        assert!((scene.hidden[0].area - hidden).abs() < 1e-12, "{:?}", scene.hidden);
    }
    let turned_room = solid(dvec3(-1.0, 0.0, -1.0), dvec3(3.0, 3.0, 3.0));
    let scene = load(turned_room.into_iter().chain(lamp(3.0, false)).collect());
    assert!((of_lamp(&scene) - 4.0).abs() < 1e-12 && scene.hidden.is_empty(), "{:?}", scene.hidden);
}
