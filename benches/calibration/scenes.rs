//! The scenes of the calibration.

use std::path::PathBuf;

use glam::DVec3;
use radiosity::{Result, Scene, scene::Material};

type Triangles = Vec<([DVec3; 3], u32)>;

/// The material of most surfaces.
const GREY: u32 = 0;
const LAMP: u32 = 1;

/// All scenes with their names.
pub fn all() -> Result<Vec<(String, Scene)>> {
    let mut scenes = Vec::new();
    for name in ["cornell-box.obj", "door-ajar.obj", "textured.obj"] {
        let path: PathBuf = [env!("CARGO_MANIFEST_DIR"), "meshes", name].iter().collect();
        scenes.push((name.to_owned(), Scene::load(&path)?));
    }
    let mut add = |name: &str, scene: Scene| scenes.push((name.to_owned(), scene));
    add("a block in the open", open());
    add("a small lamp", small_lamp());
    add("a ceiling that shines, blocks", shining_ceiling(&blocks()));
    add("a ceiling that shines, empty", shining_ceiling(&[]));
    add("eight coloured lamps", coloured_lamps());
    add("a hundred small lamps", hundred_lamps());
    add("nine rooms", nine_rooms());
    add("a lamp 0.03 above the floor", low_lamp());
    add("two spheres in a box", spheres());
    add("a slender room", slender());
    Ok(scenes)
}

/// Two triangles with these corners.
fn quad(corners: [[f64; 3]; 4], material: u32) -> [([DVec3; 3], u32); 2] {
    let [a, b, c, d] = corners.map(DVec3::from);
    [([a, b, c], material), ([a, c, d], material)]
}

/// The sides of a box, seen from outside or from inside: floor, ceiling, and four walls.
fn sides([x, y, z]: [f64; 3], [u, v, w]: [f64; 3], inside: bool) -> [[[f64; 3]; 4]; 6] {
    let sides = [
        [[x, y, z], [x, v, z], [u, v, z], [u, y, z]],
        [[x, y, w], [u, y, w], [u, v, w], [x, v, w]],
        [[x, y, z], [u, y, z], [u, y, w], [x, y, w]],
        [[x, v, z], [x, v, w], [u, v, w], [u, v, z]],
        [[x, y, z], [x, y, w], [x, v, w], [x, v, z]],
        [[u, y, z], [u, v, z], [u, v, w], [u, y, w]],
    ];
    sides.map(|s| if inside { [s[0], s[3], s[2], s[1]] } else { s })
}

fn cuboid(low: [f64; 3], high: [f64; 3], inside: bool, material: u32) -> Triangles {
    sides(low, high, inside).into_iter().flat_map(|side| quad(side, material)).collect()
}

/// A square that faces down.
fn square(x: f64, y: f64, z: f64, side: f64, material: u32) -> [([DVec3; 3], u32); 2] {
    quad([[x, y, z], [x, y + side, z], [x + side, y + side, z], [x + side, y, z]], material)
}

fn scene(triangles: &[([DVec3; 3], u32)]) -> Scene {
    let grey = Material::new("grey", [0.6; 3], [0.0; 3]);
    let lamp = Material::new("lamp", [0.0; 3], [10.0; 3]);
    Scene::new(triangles, vec![grey, lamp])
}

fn blocks() -> Triangles {
    let mut triangles = cuboid([0.2, 0.2, 0.0], [0.4, 0.5, 0.5], false, GREY);
    triangles.extend(cuboid([0.6, 0.5, 0.2], [0.8, 0.7, 0.4], false, GREY));
    triangles
}

/// A closed room of one metre with two blocks.
fn room_with_blocks() -> Triangles {
    let mut triangles = cuboid([0.0; 3], [1.0; 3], true, GREY);
    triangles.extend(blocks());
    triangles
}

/// A block on a floor under a lamp, with nothing around.
fn open() -> Scene {
    let mut triangles =
        quad([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [4.0, 4.0, 0.0], [0.0, 4.0, 0.0]], GREY).to_vec();
    triangles.extend(cuboid([1.5, 1.5, 0.0], [2.5, 2.5, 1.0], false, GREY));
    triangles.extend(square(1.0, 0.5, 3.0, 1.0, LAMP));
    scene(&triangles)
}

/// A closed room with two blocks and a lamp a fiftieth as wide.
fn small_lamp() -> Scene {
    let mut triangles = room_with_blocks();
    triangles.extend(square(0.5, 0.5, 0.9, 0.02, LAMP));
    scene(&triangles)
}

/// A closed room whose ceiling emits.
fn shining_ceiling(things: &[([DVec3; 3], u32)]) -> Scene {
    let [floor, ceiling, walls @ ..] = sides([0.0; 3], [1.0; 3], true);
    let mut triangles: Triangles =
        [floor].into_iter().chain(walls).flat_map(|side| quad(side, GREY)).collect();
    triangles.extend(quad(ceiling, LAMP));
    triangles.extend(things);
    scene(&triangles)
}

/// A room with eight small lamps of three colours and their mixtures.
fn coloured_lamps() -> Scene {
    let mut triangles = room_with_blocks();
    let mut materials = vec![Material::new("grey", [0.6; 3], [0.0; 3])];
    for k in 0..8 {
        let (x, y) = (0.1 + 0.25 * f64::from(k % 4), 0.25 + 0.45 * f64::from(k / 4));
        triangles.extend(square(x, y, 0.95, 0.05, 1 + k));
        let emission =
            [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (0, 1, 1), (1, 0, 1), (1, 1, 1), (2, 1, 0)];
        let (r, g, b) = emission[k as usize];
        materials.push(Material::new(&format!("lamp {k}"), [0.0; 3], [r, g, b].map(f64::from)));
    }
    Scene::new(&triangles, materials)
}

fn hundred_lamps() -> Scene {
    let mut triangles = room_with_blocks();
    for k in 0..100 {
        let (x, y) = (0.04 + 0.1 * f64::from(k % 10), 0.04 + 0.1 * f64::from(k / 10));
        triangles.extend(square(x, y, 0.95, 0.02, LAMP));
    }
    scene(&triangles)
}

/// Three by three rooms, with a doorway between neighbours and a lamp in each.
fn nine_rooms() -> Scene {
    const THICK: f64 = 0.02;
    const TOP: f64 = 0.7;
    let mut triangles = cuboid([0.0; 3], [3.0, 3.0, 1.0], true, GREY);
    let mut wall = |at: f64, room: u32, along_x: bool| {
        let (from, to) = (f64::from(room), f64::from(room + 1));
        let (from, to) =
            (if room == 0 { from } else { from + THICK }, if room == 2 { to } else { to - THICK });
        let (door, end) = (f64::from(room) + 0.4, f64::from(room) + 0.6);
        let mut add = |corners: [[f64; 3]; 4]| {
            // A mirror image faces the other way.
            let turned = corners.map(|[u, v, z]| if along_x { [u, v, z] } else { [v, u, z] });
            let [a, b, c, d] = turned;
            triangles.extend(quad(if along_x { [a, b, c, d] } else { [a, d, c, b] }, GREY));
        };
        let (near, far) = (at - THICK, at + THICK);
        for (u, v, low) in [(from, door, 0.0), (end, to, 0.0), (door, end, TOP)] {
            add([[u, near, low], [v, near, low], [v, near, 1.0], [u, near, 1.0]]);
            add([[v, far, low], [u, far, low], [u, far, 1.0], [v, far, 1.0]]);
        }
        add([[door, near, 0.0], [door, near, TOP], [door, far, TOP], [door, far, 0.0]]);
        add([[end, near, 0.0], [end, far, 0.0], [end, far, TOP], [end, near, TOP]]);
        add([[door, near, TOP], [end, near, TOP], [end, far, TOP], [door, far, TOP]]);
    };
    for room in 0..3 {
        for at in [1.0, 2.0] {
            wall(at, room, true);
            wall(at, room, false);
        }
    }
    for k in 0..9 {
        triangles.extend(square(f64::from(k % 3) + 0.4, f64::from(k / 3) + 0.4, 0.99, 0.2, LAMP));
    }
    scene(&triangles)
}

/// A room with a lamp close above its floor.
fn low_lamp() -> Scene {
    let mut triangles = cuboid([0.0; 3], [1.0; 3], true, GREY);
    triangles.extend(square(0.3, 0.3, 0.03, 0.4, LAMP));
    scene(&triangles)
}

/// A room with two spheres of facets and a lamp.
fn spheres() -> Scene {
    let mut triangles = cuboid([0.0; 3], [1.0; 3], true, GREY);
    for (centre, radius) in [([0.3, 0.35, 0.25], 0.25), ([0.7, 0.65, 0.4], 0.2)] {
        let (rings, sectors) = (8, 12);
        let at = |ring: usize, sector: usize| {
            let (theta, phi) = (
                std::f64::consts::PI * ring as f64 / rings as f64,
                std::f64::consts::TAU * (sector % sectors) as f64 / sectors as f64,
            );
            let sine = if ring % rings == 0 { 0.0 } else { theta.sin() };
            DVec3::from(centre) + radius * DVec3::new(sine * phi.cos(), sine * phi.sin(), theta.cos())
        };
        for (ring, sector) in (0..rings).flat_map(|ring| (0..sectors).map(move |sector| (ring, sector))) {
            let [a, b, c, d] =
                [at(ring, sector), at(ring + 1, sector), at(ring + 1, sector + 1), at(ring, sector + 1)];
            if ring + 1 < rings {
                triangles.push(([a, b, c], GREY));
            }
            if ring > 0 {
                triangles.push(([a, c, d], GREY));
            }
        }
    }
    triangles.extend(square(0.4, 0.4, 0.97, 0.2, LAMP));
    scene(&triangles)
}

/// A closed room twelve times as long as wide, lit from one end.
fn slender() -> Scene {
    let [floor, ceiling, walls @ ..] = sides([0.0; 3], [1.0, 1.0, 12.0], true);
    let mut triangles: Triangles =
        [floor].into_iter().chain(walls).flat_map(|side| quad(side, GREY)).collect();
    triangles.extend(quad(ceiling, LAMP));
    scene(&triangles)
}

/// A closed room whose walls end 5 mm above a ground of 40 m, with a lamp above. Light comes in through the gap.
#[allow(dead_code, reason = "only one of the programs uses it")]
pub fn sealed_room() -> Scene {
    const GAP: f64 = 0.005;
    let ground = [[-20.0, -20.0, 0.0], [20.0, -20.0, 0.0], [20.0, 20.0, 0.0], [-20.0, 20.0, 0.0]];
    let mut triangles = quad(ground, GREY).to_vec();
    for (low, high) in [
        ([-2.1, -1.6, GAP], [-2.0, 1.6, 2.5]),
        ([2.0, -1.6, GAP], [2.1, 1.6, 2.5]),
        ([-2.0, -1.6, GAP], [2.0, -1.5, 2.5]),
        ([-2.0, 1.5, GAP], [2.0, 1.6, 2.5]),
        ([-2.1, -1.6, 2.5], [2.1, 1.6, 2.6]),
    ] {
        triangles.extend(cuboid(low, high, false, GREY));
    }
    triangles.extend(square(-6.0, -4.0, 12.0, 8.0, LAMP));
    scene(&triangles)
}
