//! The scenes in `meshes/` are what their comments state.

use std::collections::HashMap;

use glam::DVec3;
use radiosity::Scene;

fn load(name: &str) -> Scene {
    let scene = Scene::load(format!("{}/meshes/{name}.obj", env!("CARGO_MANIFEST_DIR"))).unwrap();
    assert_eq!(scene.warnings, [""; 0]);
    assert_eq!(scene.degenerate, 0);
    assert!(scene.has_emitter());
    scene
}

/// The number of edges that no other triangle has in the opposite direction.
fn open_edges(scene: &Scene) -> usize {
    open_edges_of(scene, &(0..scene.triangles.len()).collect::<Vec<_>>())
}

/// The number of edges that only one of these triangles has.
fn open_edges_of(scene: &Scene, triangles: &[usize]) -> usize {
    let mut halves: HashMap<(u32, u32), i32> = HashMap::new();
    for [a, b, c] in triangles.iter().map(|&t| scene.triangles[t].vertices) {
        for (p, q) in [(a, b), (b, c), (c, a)] {
            *halves.entry((p, q)).or_default() += 1;
        }
    }
    assert!(halves.values().all(|&n| n == 1), "an edge occurs twice in the same direction");
    halves.keys().filter(|(p, q)| !halves.contains_key(&(*q, *p))).count()
}

/// The volume enclosed by fronts: positive for bodies seen from outside, negative for rooms seen from inside.
fn volume(scene: &Scene) -> f64 {
    (0..scene.triangles.len()).map(|t| scene.corners(t)).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
}

fn area_of(scene: &Scene, material: &str) -> f64 {
    (0..scene.triangles.len()).filter(|&t| scene.material(t).name == material).map(|t| scene.area(t)).sum()
}

/// Asserts equality up to the rounding of coordinates in the files.
fn assert_near(got: f64, wanted: f64) {
    assert!((got - wanted).abs() <= 1e-5 * wanted.abs(), "{got}, wanted {wanted}");
}

#[test]
fn cornell_box_is_closed_except_for_its_front() {
    let scene = load("cornell-box");
    // A floor of 12 corners and two holes has 14 triangles. The rest is 20 quads: ceiling, walls, lamp, and six per
    // block.
    assert_eq!(scene.triangles.len(), 14 + 2 * 20);
    let is_bottom = |t: usize| scene.corners(t).iter().all(|p| p.y == 0.0) && scene.normal(t).y < 0.0;
    let (bottoms, rest): (Vec<usize>, Vec<usize>) = (0..scene.triangles.len()).partition(|&t| is_bottom(t));
    // The front of the room is open. The blocks are part of its shell.
    assert_eq!(open_edges_of(&scene, &rest), 4);
    let floor = rest.iter().filter(|&&t| scene.corners(t).iter().all(|p| p.y == 0.0));
    let area = |t: &usize| scene.area(*t);
    assert_near(floor.map(area).sum::<f64>() + bottoms.iter().map(area).sum::<f64>(), 556.0 * 559.2);
    assert_near(area_of(&scene, "light"), 130.0 * 105.0);
    assert_near(area_of(&scene, "red"), 548.8 * 559.2);
    let room = DVec3::new(556.0, 548.8, 559.2);
    let on_wall = |p: DVec3| (0..3).any(|i| p[i] == 0.0 || p[i] == room[i]);
    for t in rest {
        let corners = scene.corners(t);
        let to_middle = 0.5 * room - corners[0];
        if corners.iter().all(|&p| on_wall(p)) {
            assert!(scene.normal(t).dot(to_middle) > 0.0, "triangle {t} faces out of the room");
        } else {
            // The middle of a block's footprint is below every point of the block.
            let foot = if corners.iter().all(|p| p.y < 200.0) {
                DVec3::new(185.5, 0.0, 169.0)
            } else {
                DVec3::new(368.5, 0.0, 351.25)
            };
            assert!(scene.normal(t).dot(corners[0] - foot) > 0.0, "triangle {t} faces into its block");
        }
    }
}

#[test]
fn furnace_is_closed() {
    let scene = load("furnace");
    assert_eq!(open_edges(&scene), 0);
    assert_near(volume(&scene), -(1.0 - 0.3 * 0.35 * 0.4));
    for m in &scene.materials {
        assert_eq!(m.reflectance, [0.5; 3]);
        assert!(m.emission.iter().all(|e| (e * std::f64::consts::PI - 0.5).abs() < 1e-15));
    }
}

#[test]
fn door_ajar_is_two_rooms_with_a_door() {
    let scene = load("door-ajar");
    assert_eq!(open_edges(&scene), 0);
    let air = (3.0 + 2.85) * 2.5 * 4.0 + 0.15 * 0.9 * 2.05;
    let door = 1.0 * 0.04 * 2.11;
    assert_near(volume(&scene), door - air);
    assert_near(area_of(&scene, "lamp"), 0.8 * 0.6);
    assert_near(area_of(&scene, "door"), 2.0 * (1.0 * 0.04 + 0.04 * 2.11 + 2.11 * 1.0));
}

#[test]
fn textured_is_closed_and_has_both_maps() {
    let scene = load("textured");
    assert_eq!(open_edges(&scene), 0);
    assert_near(volume(&scene), -(4.0 * 2.5 * 3.0));
    assert_eq!(scene.textures.len(), 2);
    assert_eq!([scene.textures[0].is_grey(), scene.textures[1].is_grey()], [false, true]);
    let whole = [[1., 0., 0.], [0., 1., 0.], [0., 0., 1.]];
    let lamp = (0..scene.triangles.len()).filter(|&t| scene.material(t).name == "lamp");
    let means: Vec<f64> = lamp.map(|t| scene.mean_emission(t, &whole)[0]).collect();
    // The mean of both halves is the mean of the gradient. Each half sees more of one end.
    let levels = (0..64).map(|x| f64::from(255 - 3 * x) / 255.0);
    let linear = levels.map(|c| if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) });
    assert_near(0.5 * (means[0] + means[1]), 40.0 * linear.sum::<f64>() / 64.0);
    assert!((means[0] - means[1]).abs() > 1.0, "{means:?}");
}
