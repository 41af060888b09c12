//! PLY files read back by another library, their vertices and their colours.

use std::{collections::HashMap, io::Cursor};

use glam::DVec3;
use ply_rs::{
    parser::Parser,
    ply::{DefaultElement, Encoding, Ply, Property},
};
use radiosity::{
    Progress, Scene,
    form_factor::{CastOptions, FormFactors},
    output::{
        ply::{PlyOptions, encode},
        vertex_colors::at_vertices,
        vertices::{CREASE, PatchMesh},
    },
    patch::{Patches, Subdivision},
    scene::Material,
    solve::{Light, SolveOptions, solve},
    tone::Exposure,
    trace::Tracer,
};

use crate::common::load;

const GREY: [f64; 3] = [0.5; 3];
const DARK: [f64; 3] = [0.0; 3];

fn grey() -> Vec<Material> {
    vec![Material::new("grey", GREY, DARK)]
}

fn quad(corners: [DVec3; 4], material: u32) -> [([DVec3; 3], u32); 2] {
    let [a, b, c, d] = corners;
    [([a, b, c], material), ([a, c, d], material)]
}

/// The unit cube, seen from outside.
fn cube() -> Scene {
    let at = |k: u32| DVec3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2));
    let sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles: Vec<_> = sides.iter().flat_map(|side| quad(side.map(at), 0)).collect();
    Scene::new(&triangles, grey())
}

fn subdivide(scene: &Scene, edge: f64) -> Patches {
    Patches::subdivide(scene, &Subdivision::Edge(edge))
}

/// Radiosity and irradiance of patches, without a solver.
struct Lit {
    radiosity: Vec<f64>,
    irradiance: Vec<f64>,
}

impl<'a> From<&'a Lit> for Light<'a> {
    fn from(Lit { radiosity, irradiance }: &'a Lit) -> Self {
        Light { radiosity, irradiance, slopes: &[] }
    }
}

/// The values of `f` at the centroids of all patches.
fn field(scene: &Scene, patches: &Patches, f: impl Fn(DVec3) -> f64) -> Vec<f64> {
    (0..patches.len()).map(|i| f(patches.centroid(scene, i))).collect()
}

fn place(p: DVec3) -> [u64; 3] {
    (p + 0.0).to_array().map(f64::to_bits)
}

/// Counts each directed edge of the mesh. `name` gives the key of a vertex.
fn edge_uses<K: std::hash::Hash + Eq + Copy>(
    mesh: &PatchMesh,
    patches: usize,
    name: impl Fn(u32) -> K,
) -> HashMap<(K, K), usize> {
    let mut uses = HashMap::new();
    for i in 0..patches {
        let face = mesh.face(i).map(&name);
        for k in 0..3 {
            *uses.entry((face[k], face[(k + 1) % 3])).or_insert(0) += 1;
        }
    }
    uses
}

/// With the default crease angle the six sides of a cube share positions, so the mesh is watertight, but no vertices.
#[test]
fn a_closed_cube_is_watertight_by_position_and_open_by_index() {
    let scene = cube();
    let patches = subdivide(&scene, 0.3);
    let mesh = PatchMesh::new(&scene, &patches, CREASE);
    let position = |v: u32| place(mesh.positions()[v as usize]);
    let uses = edge_uses(&mesh, patches.len(), position);
    for (&(a, b), &count) in &uses {
        assert_eq!((count, uses.get(&(b, a))), (1, Some(&1)));
    }
    // Euler: V - E + F = 2 for a sphere.
    let places: std::collections::HashSet<_> = (0..mesh.positions().len() as u32).map(position).collect();
    assert_eq!(places.len() + patches.len(), uses.len() / 2 + 2);
    // Six smooth squares of (2^l + 1)² vertices each, none shared between squares.
    let n = (patches.len() / 12).isqrt();
    assert_eq!(mesh.positions().len(), 6 * (n + 1) * (n + 1));
}

/// With a crease angle above 90 degrees the sides of a cube share vertices, and the mesh is watertight by index.
#[test]
fn a_crease_angle_above_a_right_angle_welds_the_cube() {
    let scene = cube();
    let patches = subdivide(&scene, 0.3);
    let mesh = PatchMesh::new(&scene, &patches, 91.0);
    let uses = edge_uses(&mesh, patches.len(), |v| v);
    assert!(uses.iter().all(|(&(a, b), &count)| count == 1 && uses.get(&(b, a)) == Some(&1)));
}

/// A flat wall shares vertices, but not across materials, opposite windings or edges with a third triangle.
#[test]
fn materials_windings_and_third_triangles_split_a_flat_wall() {
    let (o, x, y) = (DVec3::ZERO, DVec3::X, DVec3::Y);
    let two = |second: [DVec3; 3], material: u32, third: Option<[DVec3; 3]>| {
        let mut triangles = vec![([o, x, y], 0), (second, material)];
        triangles.extend(third.map(|t| (t, 0)));
        let scene =
            Scene::new(&triangles, vec![Material::new("a", GREY, DARK), Material::new("b", GREY, DARK)]);
        PatchMesh::new(&scene, &subdivide(&scene, 9.0), CREASE).positions().len()
    };
    assert_eq!(two([x, x + y, y], 0, None), 4);
    assert_eq!(two([x, x + y, y], 1, None), 6);
    assert_eq!(two([x, y, x + y], 0, None), 6);
    assert_eq!(two([x, x + y, y], 0, Some([x, y, DVec3::Z])), 9);
}

/// Triangles that touch only in a corner do not share its vertex.
#[test]
fn triangles_that_only_touch_in_a_vertex_share_none() {
    let (o, x, y) = (DVec3::ZERO, DVec3::X, DVec3::Y);
    let scene = Scene::new(&[([o, x, y], 0), ([o, -x, -y], 0)], grey());
    let mesh = PatchMesh::new(&scene, &subdivide(&scene, 9.0), CREASE);
    assert_eq!(mesh.positions().len(), 6);
}

/// Interpolation to vertices reproduces constant values everywhere and linear values inside smooth surfaces, to
/// rounding.
#[test]
fn constant_radiosity_gives_constant_vertices_and_linear_is_reproduced_inside() {
    let scene = cube();
    let patches = subdivide(&scene, 0.1);
    let mesh = PatchMesh::new(&scene, &patches, CREASE);
    let constant = at_vertices(&scene, &patches, &mesh, &vec![7.0; patches.len()]);
    assert_eq!(constant.len(), mesh.positions().len());
    assert!(constant.iter().all(|v| (v - 7.0).abs() < 1e-14));

    let linear = |p: DVec3| 1.0 + p.dot(DVec3::new(0.3, 0.5, 0.7));
    let values = at_vertices(&scene, &patches, &mesh, &field(&scene, &patches, linear));
    let mut inside = 0;
    for (&p, value) in mesh.positions().iter().zip(&values) {
        if p.to_array().iter().filter(|&&x| x == 0.0 || x == 1.0).count() == 1 {
            inside += 1;
            assert!((value - linear(p)).abs() < 1e-12, "{value} at {p}");
        } else {
            // At a crease only one side contributes: the error is below the change over a patch.
            assert!((value - linear(p)).abs() < 0.07);
        }
    }
    assert!(inside > 1000);
}

/// The patches around a vertex count by their angle: three thin corners weigh as much as one wide corner.
#[test]
fn a_corner_counts_by_its_angle_not_by_the_number_of_triangles() {
    // One triangle covers half of the surface around the origin. Three triangles cover the other half.
    let scene = Scene::new(
        &[
            ([DVec3::ZERO, DVec3::X, DVec3::Y], 0),
            ([DVec3::ZERO, DVec3::Y, DVec3::new(-0.5, 1.0, 0.0)], 0),
            ([DVec3::ZERO, DVec3::new(-0.5, 1.0, 0.0), DVec3::new(-1.0, 0.5, 0.0)], 0),
            ([DVec3::ZERO, DVec3::new(-1.0, 0.5, 0.0), -DVec3::X], 0),
        ],
        grey(),
    );
    let patches = subdivide(&scene, 9.0);
    let mesh = PatchMesh::new(&scene, &patches, CREASE);
    let values = at_vertices(&scene, &patches, &mesh, &[1.0, 3.0, 3.0, 3.0]);
    assert!((values[mesh.corners(0)[0] as usize] - 2.0).abs() < 1e-12);
}

/// A vertex in the middle of a coarse edge lies on that edge, in position and in colour.
#[test]
fn hanging_vertices_lie_on_the_coarse_edge_in_place_and_in_colour() {
    // A long thin triangle on a short edge is cut more finely than its neighbour.
    let (a, b) = (DVec3::ZERO, DVec3::X);
    let scene = Scene::new(&[([a, b, DVec3::Y], 0), ([b, a, DVec3::new(0.3, -5.0, 0.0)], 0)], grey());
    let patches = subdivide(&scene, 1.5);
    assert_eq!((patches.level(0), patches.level(1)), (0, 2));
    let mesh = PatchMesh::new(&scene, &patches, CREASE);
    let values = at_vertices(&scene, &patches, &mesh, &field(&scene, &patches, |p| p.y * p.y + p.x));
    assert_eq!(mesh.hanging().len(), 3);
    for hanging in mesh.hanging() {
        let [from, to] = hanging.ends.map(|v| v as usize);
        let [start, end] = [mesh.positions()[from], mesh.positions()[to]];
        assert_eq!(mesh.positions()[hanging.vertex as usize], start.lerp(end, hanging.fraction));
        let between = values[from] + (values[to] - values[from]) * hanging.fraction;
        assert!((values[hanging.vertex as usize] - between).abs() < 1e-12);
    }
    let middle = mesh.hanging().iter().find(|h| h.fraction == 0.5).unwrap();
    let mean = middle.ends.iter().map(|&v| values[v as usize]).sum::<f64>() / 2.0;
    assert!((values[middle.vertex as usize] - mean).abs() < 1e-12);
    // The ends of the coarse edge are vertices of the coarse triangle.
    assert!(middle.ends.iter().all(|v| mesh.corners(0).contains(v)));
}

/// The back of a triangle has vertices and values of its own and the opposite winding.
#[test]
fn a_back_is_another_surface_and_faces_the_other_way() {
    let scene = cube();
    let mut patches = subdivide(&scene, 0.6);
    let fronts = patches.len();
    patches.add_backs(&scene, &[0, 1]);
    let mesh = PatchMesh::new(&scene, &patches, CREASE);
    let normal = |i: usize| {
        let [a, b, c] = mesh.face(i).map(|v| mesh.positions()[v as usize]);
        (b - a).cross(c - a)
    };
    for i in 0..patches.len() {
        let outward = scene.normal(patches.triangle(i));
        assert_eq!(normal(i).dot(outward) > 0.0, i < fronts);
    }
    let mut values = vec![1.0; patches.len()];
    values[fronts..].fill(5.0);
    let values = at_vertices(&scene, &patches, &mesh, &values);
    let backs: Vec<u32> = (fronts..patches.len()).flat_map(|i| mesh.face(i)).collect();
    assert!((0..values.len()).all(|v| values[v] == if backs.contains(&(v as u32)) { 5.0 } else { 1.0 }));
}

/// Vertices do not depend on the order of triangles and corners. Values do not depend on the unit of length, down to
/// 1e-200.
#[test]
fn any_order_of_triangles_and_any_unit_give_the_same_vertices() {
    let scene = cube();
    let there = |scene: &Scene| -> Vec<[u64; 3]> {
        let mesh = PatchMesh::new(scene, &subdivide(scene, 0.3), CREASE);
        let mut places: Vec<_> = mesh.positions().iter().map(|&p| place(p)).collect();
        places.sort_unstable();
        places
    };
    let mut reversed = scene.clone();
    reversed.triangles.reverse();
    for triangle in &mut reversed.triangles {
        triangle.vertices.rotate_left(1);
    }
    // The cube's coordinates are dyadic, so every order of corners gives exactly the same points.
    assert_eq!(there(&scene), there(&reversed));

    let mut tiny = scene.clone();
    tiny.vertices.iter_mut().for_each(|v| *v *= 1e-200);
    let patches = subdivide(&tiny, 0.3e-200);
    let mesh = PatchMesh::new(&tiny, &patches, CREASE);
    let values = at_vertices(&tiny, &patches, &mesh, &vec![7.0; patches.len()]);
    assert!(values.iter().all(|v| (v - 7.0).abs() < 1e-14));
}

fn read(bytes: &[u8]) -> Ply<DefaultElement> {
    Parser::<DefaultElement>::new().read_ply(&mut Cursor::new(bytes)).unwrap()
}

fn float(element: &DefaultElement, name: &str) -> f32 {
    match element[name] {
        Property::Float(x) => x,
        ref other => panic!("{name} is {other:?}"),
    }
}

/// A coloured room corner with a back, its solution and standard errors.
fn coloured() -> (Scene, Patches, Lit, Vec<f64>) {
    let materials =
        vec![Material::new("a", [0.5, 0.4, 0.3], DARK), Material::new("b", [0.1, 0.2, 0.3], DARK)];
    let (o, x, y, z) = (DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z);
    // The second triangle has no area. The numbering of the file counts it.
    let scene = Scene::new(&[([o, x, y], 0), ([o, o, y], 0), ([o, y, z], 1)], materials);
    let mut patches = subdivide(&scene, 0.8);
    patches.add_backs(&scene, &[1]);
    let values = |scale: f64| (0..3 * patches.len()).map(|k| scale * (k + 1) as f64).collect();
    let solution = Lit { radiosity: values(1.0), irradiance: values(10.0) };
    let errors = values(0.1);
    (scene, patches, solution, errors)
}

/// Another library reads exactly the positions, colours, values, areas and sides that were written.
#[test]
fn what_is_written_is_what_another_reader_reads() {
    let (scene, patches, solution, errors) = coloured();
    let exposure = Exposure { scale: 0.01 };
    let mut bytes = Vec::new();
    let options = PlyOptions::default()
        .with_standard_errors(Some(&errors))
        .with_backs(true)
        .with_exposure(Some(exposure));
    encode(&mut bytes, &scene, &patches, &solution, &options).unwrap();

    let ply = read(&bytes);
    assert_eq!(ply.header.encoding, Encoding::BinaryLittleEndian);
    let comments = ply.header.comments.join("\n");
    for said in [env!("CARGO_PKG_VERSION"), "W/m2", "1.000000e2 W/m2"] {
        assert!(comments.contains(said), "{comments}");
    }
    let mesh = PatchMesh::new(&scene, &patches, CREASE);
    let at_vertices = at_vertices(&scene, &patches, &mesh, &solution.radiosity);
    let vertices = &ply.payload["vertex"];
    assert_eq!(vertices.len(), mesh.positions().len());
    for (v, vertex) in vertices.iter().enumerate() {
        let radiosity: [f64; 3] = at_vertices[3 * v..][..3].try_into().unwrap();
        let colour = exposure.encode(radiosity);
        for c in 0..3 {
            assert_eq!(float(vertex, ["x", "y", "z"][c]), mesh.positions()[v][c] as f32);
            assert_eq!(vertex[["red", "green", "blue"][c]], Property::UChar(colour[c]));
            let name = ["radiosity_r", "radiosity_g", "radiosity_b"][c];
            assert_eq!(float(vertex, name), radiosity[c] as f32);
        }
    }
    let faces = &ply.payload["face"];
    assert_eq!(faces.len(), patches.len());
    for (i, face) in faces.iter().enumerate() {
        assert_eq!(face["vertex_indices"], Property::ListInt(mesh.face(i).map(|v| v as i32).to_vec()));
        // Triangle 1 of the scene is triangle 2 of the file.
        assert_eq!(face["triangle"], Property::Int(2 * patches.triangle(i) as i32));
        assert_eq!(face["side"], Property::UChar(u8::from(i >= patches.fronts())));
        assert_eq!(face["area"], Property::Double(0.5 / 4.0));
        for (c, channel) in ["r", "g", "b"].into_iter().enumerate() {
            let k = (3 * i + c + 1) as f64;
            assert_eq!(float(face, &format!("radiosity_{channel}")), k as f32);
            assert_eq!(float(face, &format!("irradiance_{channel}")), (10.0 * k) as f32);
            assert_eq!(float(face, &format!("error_{channel}")), (0.1 * k) as f32);
        }
    }
}

/// Each face of a cut patch has the values of its patch and an area of its own, so sums over faces equal sums over
/// patches.
#[test]
fn patches_of_several_sizes_are_one_face_or_two() {
    let scene = cube();
    let coarse = subdivide(&scene, 0.8);
    let mut patches = coarse.refined(&scene, &(0..coarse.len()).map(|i| i == 5).collect::<Vec<_>>());
    patches.add_backs(&scene, &[patches.triangle(5) as u32]);
    let values = |factor: f64| (0..patches.len()).map(|i| factor * (i + 1) as f64).collect::<Vec<f64>>();
    let solution = Lit { radiosity: values(1.0), irradiance: values(10.0) };
    let discretisation = values(-0.5);
    let options = PlyOptions::default().with_discretisation(Some(&discretisation)).with_backs(true);
    let mut bytes = Vec::new();
    encode(&mut bytes, &scene, &patches, &solution, &options).unwrap();
    let ply = read(&bytes);
    let faces = &ply.payload["face"];
    // The three neighbours of the four small patches are cut, and neighbours on the back if they lie on the same
    // triangle.
    assert!(faces.len() >= patches.len() + 3);
    let mut areas = vec![0.0; patches.len()];
    for (f, face) in faces.iter().enumerate() {
        let (Property::Int(i), Property::Double(area)) = (&face["patch"], &face["area"]) else { panic!() };
        assert!(f >= patches.len() || *i == f as i32);
        areas[*i as usize] += area;
        assert_eq!(float(face, "radiosity_g"), (i + 1) as f32);
        assert_eq!(float(face, "discretisation_b"), -0.5 * (i + 1) as f32);
    }
    assert!(areas.iter().enumerate().all(|(i, area)| *area == patches.area(i)));
}

/// The faces of a PLY: the positions of the corners, the triangle, whether it is a back, and the red irradiance.
fn faces_of(ply: &Ply<DefaultElement>) -> Vec<([[u32; 3]; 3], i32, bool, f32)> {
    let vertices = &ply.payload["vertex"];
    let place = |v: &i32| ["x", "y", "z"].map(|axis| (float(&vertices[*v as usize], axis) + 0.0).to_bits());
    let face = |face: &DefaultElement| {
        let (Property::ListInt(v), Property::Int(t)) = (&face["vertex_indices"], &face["triangle"]) else {
            panic!("{face:?}")
        };
        let back = face["side"] == Property::UChar(1);
        ([place(&v[0]), place(&v[1]), place(&v[2])], *t, back, float(face, "irradiance_r"))
    };
    ply.payload["face"].iter().map(face).collect()
}

/// The area of faces that lie on others, in units of the smallest face.
fn overlap(faces: &[[DVec3; 3]]) -> f64 {
    let cross = |[a, b, c]: &[DVec3; 3]| (*b - *a).cross(*c - *a);
    let smallest = faces.iter().map(|face| 0.5 * cross(face).length()).fold(f64::INFINITY, f64::min);
    let common = |one: &[DVec3; 3], other: &[DVec3; 3]| {
        let normal = cross(one).normalize();
        let longest = one.iter().flat_map(|p| one.map(|q| p.distance(q))).fold(0.0, f64::max);
        if other.iter().any(|&p| (p - one[0]).dot(normal).abs() > 1e-6 * longest) {
            return 0.0;
        }
        // The part of `other` inside the planes through the edges of `one` (Sutherland and Hodgman, 1974).
        let mut polygon = other.to_vec();
        for k in 0..3 {
            let inward = normal.cross(one[(k + 1) % 3] - one[k]);
            let height = |p: DVec3| (p - one[k]).dot(inward);
            let mut kept = Vec::new();
            for (i, &p) in polygon.iter().enumerate() {
                let q = polygon[(i + 1) % polygon.len()];
                let (d, e) = (height(p), height(q));
                if d >= 0.0 {
                    kept.push(p);
                }
                if d * e < 0.0 {
                    kept.push(p.lerp(q, d / (d - e)));
                }
            }
            polygon = kept;
        }
        polygon.windows(2).map(|w| 0.5 * (w[0] - polygon[0]).cross(w[1] - polygon[0]).length()).sum::<f64>()
    };
    let of_face =
        |(i, face): (usize, &[DVec3; 3])| faces[..i].iter().map(|other| common(face, other)).sum::<f64>();
    faces.iter().enumerate().map(of_face).sum::<f64>() / smallest
}

/// The number of vertices inside an edge that only one face has. A viewer draws a gap along such an edge, through which
/// the background shows.
fn gaps(faces: &[[DVec3; 3]]) -> usize {
    let mut vertices: Vec<DVec3> = faces.iter().flatten().copied().collect();
    vertices.sort_by(|p, q| p.x.total_cmp(&q.x).then(p.y.total_cmp(&q.y)).then(p.z.total_cmp(&q.z)));
    vertices.dedup();
    let is_inside = |p: DVec3, a: DVec3, b: DVec3| {
        let along = (p - a).dot(b - a) / (b - a).length_squared();
        p != a
            && p != b
            && (0.0..=1.0).contains(&along)
            && p.distance(a.lerp(b, along)) < 1e-5 * a.distance(b)
    };
    let of_edge = |a: DVec3, b: DVec3| {
        let slack = 1e-5 * a.distance(b);
        let first = vertices.partition_point(|p| p.x < a.x.min(b.x) - slack);
        let near = vertices[first..].iter().take_while(|p| p.x <= a.x.max(b.x) + slack);
        near.filter(|&&p| is_inside(p, a, b)).count()
    };
    let mut uses: HashMap<_, usize> = HashMap::new();
    let edges: Vec<[DVec3; 2]> =
        faces.iter().flat_map(|face| [0, 1, 2].map(|k| [face[k], face[(k + 1) % 3]])).collect();
    let name = |[a, b]: [DVec3; 2]| (place(a).min(place(b)), place(a).max(place(b)));
    edges.iter().for_each(|&edge| *uses.entry(name(edge)).or_default() += 1);
    edges.iter().filter(|&&edge| uses[&name(edge)] == 1).map(|&[a, b]| of_edge(a, b)).sum()
}

/// The positions of the corners of all faces.
fn corners_of(ply: &Ply<DefaultElement>) -> Vec<[DVec3; 3]> {
    let at = |bits: [u32; 3]| DVec3::from(bits.map(|x| f64::from(f32::from_bits(x))));
    faces_of(ply).into_iter().map(|(corners, ..)| corners.map(at)).collect()
}

/// A sheet above a lamp, present twice with opposite windings, and a curtain with a lamp on each side. Each patch gives
/// one face, on its brighter side. With backs the file has both sides.
#[test]
fn one_face_a_patch_shows_the_side_with_more_light() {
    let (x, z) = (DVec3::X, DVec3::Z);
    let square = |y: f64, turned: bool, material: u32| {
        let at = DVec3::Y * y;
        let corners =
            if turned { [at, at + x, at + x + z, at + z] } else { [at, at + z, at + x + z, at + x] };
        quad(corners, material)
    };
    let lamp = |name: &str, radiance: f64| Material::new(name, GREY, [radiance; 3]);
    let materials = vec![lamp("dim", 1.0), lamp("bright", 5.0), Material::new("grey", GREY, DARK)];
    // From below: a dim lamp that faces up, a sheet, a bright lamp that faces down. Far away: a lamp and a sheet above
    // it, once in each winding.
    let triangles: Vec<_> = [
        square(0.0, false, 0),
        square(1.0, true, 2),
        square(2.0, true, 1),
        square(20.0, false, 0),
        square(21.0, true, 2),
        square(21.0, false, 2).map(|([a, b, c], m)| ([c, a, b], m)),
    ]
    .concat();
    let scene = Scene::new(&triangles, materials);
    let mut patches = subdivide(&scene, 0.4);
    let cast = CastOptions::default().with_rays(64.0);
    let tracer = Tracer::new(&scene);
    let factors = FormFactors::cast(&scene, &tracer, &mut patches, &cast, &Progress::default()).unwrap();
    let solution = solve(&factors, &patches, &SolveOptions::default(), &Progress::default()).unwrap();
    let written = |backs: bool| {
        let mut bytes = Vec::new();
        encode(&mut bytes, &scene, &patches, &solution, &PlyOptions::default().with_backs(backs)).unwrap();
        read(&bytes)
    };
    let (one, both) = (written(false), written(true));
    let areas = [&one, &both].map(|ply| overlap(&corners_of(ply)));
    let [one, both] = [one, both].map(|ply| faces_of(&ply));
    let a_square = patches.fronts() / 6;
    assert_eq!((one.len(), areas[0]), (5 * a_square, 0.0));
    assert!(areas[1] > 1.0);
    // The sheet between the lamps is lit from above, on its back. The doubled sheet has light from below.
    assert!(one.iter().filter(|f| matches!(f.1, 2 | 3)).all(|f| f.2 && f.3 > 0.0));
    assert_eq!(one.iter().filter(|f| matches!(f.1, 8..12) && f.3 > 0.0).count(), a_square);
    assert_eq!(both.len(), patches.len());
    let most = both.iter().filter(|f| matches!(f.1, 2 | 3)).map(|f| f.3).fold(0.0, f32::max);
    assert_eq!(one.iter().filter(|f| matches!(f.1, 2 | 3)).map(|f| f.3).fold(0.0, f32::max), most);
}

/// A room with boxes whose bottoms lie on the floor. The floor is not cut around them. One box crosses a diagonal of
/// the floor, and another box stands on the first one.
fn furnished() -> Scene {
    let axes = |low: DVec3, high: DVec3, inward: bool| {
        let at = move |k: u32| DVec3::select(glam::BVec3::new(k & 1 > 0, k & 2 > 0, k & 4 > 0), high, low);
        let sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        sides.map(move |mut side| {
            if inward {
                side.reverse();
            }
            side.map(at)
        })
    };
    let (mut triangles, point) = (Vec::new(), DVec3::new);
    for (k, side) in axes(DVec3::ZERO, point(4.0, 3.0, 3.0), true).into_iter().enumerate() {
        triangles.extend(quad(side, u32::from(k == 1)));
    }
    for (low, high) in [
        // No vertex of the floor lies on the rim of a box by accident.
        (point(0.53, 0.7, 0.0), point(1.2, 1.6, 0.9)),
        (point(0.6, 0.8, 0.9), point(1.1, 1.4, 1.3)),
        (point(2.2, 1.0, 0.0), point(3.1, 2.9, 0.4)),
    ] {
        triangles.extend(axes(low, high, false).into_iter().flat_map(|side| quad(side, 0)));
    }
    let materials = vec![Material::new("grey", GREY, DARK), Material::new("lamp", DARK, [1.0; 3])];
    Scene::new(&triangles, materials)
}

/// A sheet of two quadrangles back to back, cut along different diagonals, below a lamp.
fn two_diagonals() -> Scene {
    let at = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    let square = |z: f64| [at(0.0, 0.0, z), at(1.0, 0.0, z), at(1.0, 1.0, z), at(0.0, 1.0, z)];
    let [a, b, c, d] = square(0.0);
    let [e, f, g, h] = square(0.7);
    let back = [([b, a, d], 0), ([b, d, c], 0)];
    let triangles = [quad([a, b, c, d], 0), back, quad([h, g, f, e], 1)].concat();
    Scene::new(&triangles, vec![Material::new("grey", GREY, DARK), Material::new("lamp", DARK, [1.0; 3])])
}

/// Meshes have no faces that lie on others, no gaps between patches of different size, and all of the irradiance.
#[test]
fn meshes_have_no_overlaps_and_no_gaps() {
    let shipped = ["cornell-box", "door-ajar", "furnace", "textured"].map(|name| (name, load(name)));
    let made = [("furnished", furnished()), ("two diagonals", two_diagonals())];
    for (name, scene) in shipped.into_iter().chain(made) {
        let mut patches = Patches::subdivide(&scene, &Subdivision::Count(600));
        let cast = CastOptions::default().with_rays(64.0);
        let tracer = Tracer::new(&scene);
        let factors = FormFactors::cast(&scene, &tracer, &mut patches, &cast, &Progress::default()).unwrap();
        let solution = solve(&factors, &patches, &SolveOptions::default(), &Progress::default()).unwrap();
        let mut bytes = Vec::new();
        encode(&mut bytes, &scene, &patches, &solution, &PlyOptions::default()).unwrap();
        let ply = read(&bytes);
        let faces = corners_of(&ply);
        println!("{name}: {} faces, overlap {}, gaps {}", faces.len(), overlap(&faces), gaps(&faces));
        // Positions have single precision.
        assert!(overlap(&faces) < 1e-3, "{name}");
        assert_eq!(gaps(&faces), 0, "{name}");
        let power = |face: &DefaultElement| match face["area"] {
            Property::Double(area) => area * f64::from(float(face, "irradiance_g")),
            _ => panic!("area is a double"),
        };
        let written: f64 = ply.payload["face"].iter().map(power).sum();
        let channels = patches.channels();
        let arriving: f64 = (0..patches.len())
            .map(|i| patches.area(i) * solution.irradiance[i * channels + channels / 2])
            .sum();
        // Covered surfaces are left out, with the light that patches across their rims send to them.
        let left_out = (patches.fronts() - distinct_patches(&ply)) as f64 / patches.fronts() as f64;
        assert_eq!(left_out > 0.0, matches!(name, "furnished" | "two diagonals"), "{name}");
        let share = written / arriving;
        assert!(share < 1.0 + 1e-6 && share > 1.0 - 1e-6 - left_out, "{name}: {written} of {arriving}");
    }
}

/// The number of patches that the faces of a PLY belong to.
fn distinct_patches(ply: &Ply<DefaultElement>) -> usize {
    let faces = &ply.payload["face"];
    let patch = |(f, face): (usize, &DefaultElement)| match face.get("patch") {
        Some(Property::Int(i)) => *i as usize,
        _ => f,
    };
    faces.iter().enumerate().map(patch).collect::<std::collections::HashSet<_>>().len()
}

/// Grey light gives three equal channels, missing standard errors are NaN, and radiosities slightly below zero are
/// written as 0.
#[test]
fn grey_is_written_as_three_equal_channels_and_unknown_errors_as_nan() {
    let scene = cube();
    let patches = subdivide(&scene, 0.6);
    // Slightly below zero, as iterative solvers may leave dark patches.
    let mut radiosity = vec![2.0; patches.len()];
    radiosity[5] = -1e-20;
    let solution = Lit { radiosity, irradiance: vec![3.0; patches.len()] };
    let mut bytes = Vec::new();
    encode(&mut bytes, &scene, &patches, &solution, &PlyOptions::default()).unwrap();
    let ply = read(&bytes);
    for (i, face) in ply.payload["face"].iter().enumerate() {
        for channel in ["r", "g", "b"] {
            assert_eq!(float(face, &format!("radiosity_{channel}")), if i == 5 { 0.0 } else { 2.0 });
            assert_eq!(float(face, &format!("irradiance_{channel}")), 3.0);
            assert!(float(face, &format!("error_{channel}")).is_nan());
        }
    }
    // 0.8 of white: automatic exposure shows an evenly lit wall at this brightness.
    assert!(ply.payload["vertex"].iter().any(|v| v["green"] == Property::UChar(231)));
}

/// Values beyond single precision, or no numbers, are errors.
#[test]
fn what_single_precision_cannot_hold_is_an_error() {
    let scene = cube();
    let patches = subdivide(&scene, 0.6);
    for (radiosity, irradiance) in [(1e39, 1.0), (1.0, f64::NAN)] {
        let n = patches.len();
        let solution = Lit { radiosity: vec![radiosity; n], irradiance: vec![irradiance; n] };
        let error = encode(&mut Vec::new(), &scene, &patches, &solution, &PlyOptions::default()).unwrap_err();
        assert_eq!(error.kind(), std::io::ErrorKind::InvalidData);
    }
}

/// A file of 800,000 faces has the expected size and is written in linear time.
#[test]
fn vertices_take_27_bytes_each() {
    let scene = cube();
    let patches = subdivide(&scene, 2f64.sqrt() / 256.0);
    assert_eq!(patches.len(), 12 << 16);
    let solution = Lit { radiosity: vec![1.0; patches.len()], irradiance: vec![2.0; patches.len()] };
    let mut bytes = Vec::new();
    encode(&mut bytes, &scene, &patches, &solution, &PlyOptions::default()).unwrap();
    let vertices = 6 * 257 * 257;
    let payload = 27 * vertices + 62 * patches.len();
    assert!((payload..payload + 2000).contains(&bytes.len()));
}
