//! Scenes of known size for the benchmarks.

#![allow(dead_code, reason = "every benchmark is a program of its own and uses some of these")]

use glam::{DQuat, DVec3, dvec3};
use radiosity::{Scene, scene::Material, trace::sampling::mix};

/// A scene and its name in the tables.
#[derive(Clone, Copy)]
pub struct Place {
    pub name: &'static str,
    pub make: fn() -> Scene,
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name)
    }
}

pub const CORNELL: Place = Place { name: "cornell, 36 triangles", make: || load("cornell-box.obj") };
pub const DOOR: Place = Place { name: "door ajar", make: || load("door-ajar.obj") };
pub const SPHERES_1E5: Place = Place { name: "spheres, 1e5", make: || spheres([4, 4, 5], 3) };
pub const SPHERES_1E6: Place = Place { name: "spheres, 1e6", make: || spheres([7, 7, 4], 4) };
/// Flat walls of equal small triangles are hard for hierarchies: their Morton codes tie.
pub const WALLS_1E5: Place = Place { name: "tessellated walls, 1e5", make: || room(91) };
pub const WALLS_1E6: Place = Place { name: "tessellated walls, 1e6", make: || room(289) };

type Triangles = Vec<([DVec3; 3], u32)>;
const WHITE: u32 = 0;
const LAMP: u32 = 1;

fn load(name: &str) -> Scene {
    Scene::load(format!("{}/meshes/{name}", env!("CARGO_MANIFEST_DIR")))
        .expect("the scene is in the repository")
}

fn scene(triangles: &Triangles) -> Scene {
    let materials = vec![
        Material::new("white", [0.7, 0.6, 0.5], [0.0; 3]),
        Material::new("lamp", [0.7, 0.6, 0.5], [10.0, 9.0, 8.0]),
    ];
    Scene::new(triangles, materials)
}

/// A closed unit cube whose walls are cut into n × n squares of two triangles, with a lamp in the ceiling.
fn room(n: u32) -> Scene {
    let mut triangles = Vec::new();
    add_room(n, &mut triangles);
    scene(&triangles)
}

/// The same cube with a grid of spheres, each of 20 · 4^level triangles.
fn spheres(grid: [u32; 3], level: u32) -> Scene {
    let mut triangles = Vec::new();
    add_room(16, &mut triangles);
    let sphere = icosphere(level);
    let cell = dvec3(1.0 / f64::from(grid[0]), 1.0 / f64::from(grid[1]), 1.0 / f64::from(grid[2]));
    let radius = 0.35 * cell.min_element();
    for i in 0..grid[0] * grid[1] * grid[2] {
        let [x, y, z] = [i % grid[0], i / grid[0] % grid[1], i / (grid[0] * grid[1])].map(f64::from);
        let centre = (dvec3(x, y, z) + 0.5) * cell;
        triangles.extend(sphere.iter().map(|corners| (corners.map(|p| centre + p * radius), WHITE)));
    }
    scene(&triangles)
}

fn add_room(n: u32, triangles: &mut Triangles) {
    for wall in 0..6 {
        let (axis, far) = (wall / 2, wall % 2);
        let origin = DVec3::AXES[axis] * far as f64;
        // The cross product of the edges points inwards.
        let (a, b) = (DVec3::AXES[(axis + 1 + far) % 3], DVec3::AXES[(axis + 2 - far) % 3]);
        for i in 0..n * n {
            let at = |u: u32, v: u32| origin + (a * f64::from(u) + b * f64::from(v)) / f64::from(n);
            let (u, v) = (i % n, i / n);
            let [p, q, r, s] = [at(u, v), at(u + 1, v), at(u + 1, v + 1), at(u, v + 1)];
            let middle = (p + r) * 0.5 - dvec3(0.5, 1.0, 0.5);
            let material = if middle.abs().max_element() < 0.15 { LAMP } else { WHITE };
            triangles.extend([([p, q, r], material), ([p, r, s], material)]);
        }
    }
}

/// An icosahedron on the unit sphere. Each face is cut in four, `level` times.
fn icosphere(level: u32) -> Vec<[DVec3; 3]> {
    let golden = (1.0 + 5f64.sqrt()) / 2.0;
    let signs = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)];
    let corners: Vec<DVec3> = signs
        .iter()
        .flat_map(|&(s, t)| [dvec3(0.0, s, t * golden), dvec3(s, t * golden, 0.0), dvec3(t * golden, 0.0, s)])
        .collect();
    // Faces are triples of corners whose distances are the length of an edge, 2.
    let is_edge = |a: DVec3, b: DVec3| (a.distance(b) - 2.0).abs() < 1e-9;
    let mut faces = Vec::new();
    for (i, &a) in corners.iter().enumerate() {
        for (j, &b) in corners.iter().enumerate().skip(i + 1).filter(|(_, b)| is_edge(a, **b)) {
            for &c in corners.iter().skip(j + 1).filter(|c| is_edge(a, **c) && is_edge(b, **c)) {
                let outward = (b - a).cross(c - a).dot(a) > 0.0;
                faces.push((if outward { [a, b, c] } else { [a, c, b] }).map(DVec3::normalize));
            }
        }
    }
    for _ in 0..level {
        let cut = |[a, b, c]: [DVec3; 3]| {
            let [p, q, r] = [(a + b).normalize(), (b + c).normalize(), (c + a).normalize()];
            [[a, p, r], [p, b, q], [r, q, c], [p, q, r]]
        };
        faces = faces.into_iter().flat_map(cut).collect();
    }
    faces
}

/// The quadrilaterals of a closed room with 20 floating boxes, rotated about the vertical. Six walls of 8 × 8 and six
/// sides per box make 504. Each is cut into `cuts` × `cuts`. They face the air of the room.
pub fn room_with_boxes(cuts: u32) -> Vec<[DVec3; 4]> {
    let size = dvec3(5.0, 4.0, 2.5);
    let mut quads = Vec::new();
    add_box(size / 2.0, size / 2.0, 0.0, -1.0, 8 * cuts, &mut quads);
    for i in 0..20 {
        let random = |k: u64| mix(&[i, k]) as f64 / u64::MAX as f64;
        let cell = dvec3((i % 5) as f64 + 0.5, (i / 5) as f64 + 0.5, 0.5);
        let half = dvec3(0.1 + 0.2 * random(0), 0.1 + 0.2 * random(1), 0.1 + 0.6 * random(2));
        let height = half.z + 0.05 + (size.z - 2.0 * half.z - 0.1) * random(3);
        add_box(cell.with_z(height), half, 1.5 * random(4), 1.0, cuts, &mut quads);
    }
    quads
}

/// The six sides of a box, each cut into n × n. They face outward with side 1, and inward with side -1.
fn add_box(centre: DVec3, half: DVec3, turn: f64, side: f64, n: u32, quads: &mut Vec<[DVec3; 4]>) {
    let turned = DQuat::from_rotation_z(turn);
    for wall in 0..6 {
        let (axis, sign) = (wall / 2, if wall % 2 == 0 { -1.0 } else { 1.0 });
        // a × b points along the axis.
        let (a, b) = (DVec3::AXES[(axis + 1) % 3], DVec3::AXES[(axis + 2) % 3] * sign * side);
        for k in 0..n * n {
            let at = |u: u32, v: u32| {
                let [u, v] = [u, v].map(|w| 2.0 * f64::from(w) / f64::from(n) - 1.0);
                centre + turned * ((DVec3::AXES[axis] * sign + a * u + b * v) * half)
            };
            let (u, v) = (k % n, k / n);
            quads.push([at(u, v), at(u + 1, v), at(u + 1, v + 1), at(u, v + 1)]);
        }
    }
}

/// A model of streets as in micrometeorology: blocks of buildings on a grid under an open sky, all of triangles of one
/// size. Each of `plots` x `plots` plots is twice as wide as its building. The walls of a building are `cells` squares
/// wide and 4 to 10 high.
pub fn streets(plots: u32, cells: u32) -> Vec<Vec<DVec3>> {
    let mut triangles = Vec::new();
    let mut square = |o: DVec3, a: DVec3, b: DVec3| {
        triangles.push(vec![o, o + a, o + a + b]);
        triangles.push(vec![o, o + a + b, o + b]);
    };
    for plot in 0..plots * plots {
        let corner = dvec3(f64::from(plot % plots), f64::from(plot / plots), 0.0) * f64::from(2 * cells);
        // No two rows of plots have the same pattern of heights. The last building makes up 22,176 triangles in the
        // model of 6 x 6 plots.
        let height = if plot + 1 == plots * plots { 1 } else { 4 + plot * 5 % 7 };
        let (low, high) = (cells / 2, cells / 2 + cells);
        for (x, y) in (0..4 * cells * cells).map(|k| (k % (2 * cells), k / (2 * cells))) {
            let is_built = (low..high).contains(&x) && (low..high).contains(&y);
            let z = if is_built { height } else { 0 };
            square(corner + dvec3(f64::from(x), f64::from(y), f64::from(z)), DVec3::X, DVec3::Y);
        }
        let (low, high) = (f64::from(low), f64::from(high));
        for (k, z) in (0..cells * height).map(|k| (f64::from(k % cells), f64::from(k / cells))) {
            square(corner + dvec3(low + k, low, z), DVec3::X, DVec3::Z);
            square(corner + dvec3(high - k, high, z), -DVec3::X, DVec3::Z);
            square(corner + dvec3(low, high - k, z), -DVec3::Y, DVec3::Z);
            square(corner + dvec3(high, low + k, z), DVec3::Y, DVec3::Z);
        }
    }
    triangles
}
