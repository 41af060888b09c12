//! Scenes built in code, and form factors between their parts with error bars.

#![allow(dead_code, reason = "every test file uses a part of it")]

pub mod gltf;
#[cfg(feature = "cli")]
pub mod program;

use std::{collections::HashMap, f64::consts::PI};

use glam::{DVec3, dvec3};
use radiosity::{
    Progress, Scene,
    accuracy::error_bars::ErrorBars,
    form_factor::{CastOptions, Estimator, FormFactors, Matrix, exact::polygon_exchange_area},
    patch::{Patches, Subdivision},
    scene::Material,
    solve::{Radiometry, SolveOptions, solve},
    trace::{Tracer, sampling::mix},
};

/// Writes a picture as PNG. `ImageBuffer::save` would compile the encoders of all formats into the test program.
pub fn save_png<P>(picture: &image::ImageBuffer<P, Vec<u8>>, path: impl AsRef<std::path::Path>)
where
    P: image::Pixel<Subpixel = u8> + image::PixelWithColorType,
{
    let file = std::fs::File::create(path).unwrap();
    picture.write_with_encoder(image::codecs::png::PngEncoder::new(file)).unwrap();
}

pub type Corners = [DVec3; 3];

pub const BOTH: [Estimator; 2] = [Estimator::OneWay, Estimator::Pooled];

/// Two-sided quantile of Student's t for a probability of 10⁻⁴ to be exceeded by chance. It has the 15 degrees of
/// freedom of an error bar from 16 replicates.
pub const T15: f64 = 5.24;

/// Half a unit in the last place of single precision, relative: the rounding of a stored exchange area.
pub const F32: f64 = 6e-8;

/// A surface of one material.
pub struct Part {
    pub triangles: Vec<Corners>,
    pub reflectance: [f64; 3],
    /// Emitted radiosity Be.
    pub exitance: [f64; 3],
}

pub fn part(triangles: Vec<Corners>, reflectance: f64, exitance: f64) -> Part {
    Part { triangles, reflectance: [reflectance; 3], exitance: [exitance; 3] }
}

/// A part that neither reflects nor emits.
pub fn black(triangles: Vec<Corners>) -> Part {
    part(triangles, 0.0, 0.0)
}

/// The scene of these parts. Part `k` has material `k`.
pub fn scene(parts: &[Part]) -> Scene {
    let triangles: Vec<(Corners, u32)> =
        parts.iter().zip(0..).flat_map(|(p, k)| p.triangles.iter().map(move |&t| (t, k))).collect();
    let materials = parts.iter().map(|p| Material::new("part", p.reflectance, p.exitance.map(|e| e / PI)));
    Scene::new(&triangles, materials.collect())
}

pub fn load(name: &str) -> Scene {
    Scene::load(format!("{}/meshes/{name}.obj", env!("CARGO_MANIFEST_DIR"))).unwrap()
}

/// The parallelogram from `corner` along `u` and `v`; its front looks along u × v.
/// The corners of a parallelogram.
pub fn parallelogram(corner: DVec3, u: DVec3, v: DVec3) -> Vec<DVec3> {
    vec![corner, corner + u, corner + u + v, corner + v]
}

pub fn rectangle(corner: DVec3, u: DVec3, v: DVec3) -> Vec<Corners> {
    vec![[corner, corner + u, corner + u + v], [corner, corner + u + v, corner + v]]
}

/// The horizontal square with edges of `side`, centred on the z axis at height `z`.
pub fn level_square(side: f64, z: f64, up: bool) -> Vec<Corners> {
    let square = rectangle(dvec3(-0.5 * side, -0.5 * side, z), DVec3::X * side, DVec3::Y * side);
    if up { square } else { flipped(square) }
}

pub fn flipped(triangles: Vec<Corners>) -> Vec<Corners> {
    triangles.into_iter().map(|[a, b, c]| [a, c, b]).collect()
}

/// The six faces of a box in the order -x, +x, -y, +y, -z, +z, seen from inside.
pub fn room_faces(low: DVec3, high: DVec3) -> [Vec<Corners>; 6] {
    let size = high - low;
    let (x, y, z) = (DVec3::X * size.x, DVec3::Y * size.y, DVec3::Z * size.z);
    [(y, z, x), (z, x, y), (x, y, z)]
        .map(|(u, v, w)| [rectangle(low, u, v), rectangle(low + w, v, u)])
        .into_iter()
        .flatten()
        .collect::<Vec<_>>()
        .try_into()
        .unwrap()
}

pub fn room(low: DVec3, high: DVec3) -> Vec<Corners> {
    room_faces(low, high).concat()
}

/// A closed room of unit size in the middle of 26 blocks of unit size. Each block has all its six faces, as worlds of
/// blocks have. `keep` chooses faces: its arguments say if another block touches there, and if the face is part of
/// the room.
pub fn room_of_blocks(keep: impl Fn(bool, bool) -> bool) -> Vec<Corners> {
    let is_block =
        |p: DVec3| p.cmpge(DVec3::ZERO).all() && p.cmplt(DVec3::splat(3.0)).all() && p != DVec3::ONE;
    let places = (0..27).map(|k| dvec3((k % 3) as f64, (k / 3 % 3) as f64, (k / 9) as f64));
    let axes = [-DVec3::X, DVec3::X, -DVec3::Y, DVec3::Y, -DVec3::Z, DVec3::Z];
    let mut faces = Vec::new();
    for at in places.filter(|&at| is_block(at)) {
        for (axis, face) in axes.into_iter().zip(room_faces(at, at + 1.0)) {
            if keep(is_block(at + axis), at + axis == DVec3::ONE) {
                faces.extend(flipped(face));
            }
        }
    }
    faces
}

/// A black room with a square lamp that shines down on its floor from close above.
pub fn low_lamp() -> Scene {
    let lamp = rectangle(DVec3::new(0.3, 0.3, 0.03), DVec3::Y * 0.4, DVec3::X * 0.4);
    scene(&[black(room(DVec3::ZERO, DVec3::ONE)), part(lamp, 0.0, 1.0)])
}

/// An icosahedron inscribed in a sphere. Each level cuts every triangle in four. Fronts face outward.
pub fn icosphere(radius: f64, level: u32) -> Vec<Corners> {
    let g = 0.5 * (1.0 + 5f64.sqrt());
    let v = [
        (-1., g, 0.),
        (1., g, 0.),
        (-1., -g, 0.),
        (1., -g, 0.),
        (0., -1., g),
        (0., 1., g),
        (0., -1., -g),
        (0., 1., -g),
        (g, 0., -1.),
        (g, 0., 1.),
        (-g, 0., -1.),
        (-g, 0., 1.),
    ]
    .map(|(x, y, z)| dvec3(x, y, z).normalize());
    let faces = [
        [0, 11, 5],
        [0, 5, 1],
        [0, 1, 7],
        [0, 7, 10],
        [0, 10, 11],
        [1, 5, 9],
        [5, 11, 4],
        [11, 10, 2],
        [10, 7, 6],
        [7, 1, 8],
        [3, 9, 4],
        [3, 4, 2],
        [3, 2, 6],
        [3, 6, 8],
        [3, 8, 9],
        [4, 9, 5],
        [2, 4, 11],
        [6, 2, 10],
        [8, 6, 7],
        [9, 8, 1],
    ];
    let mut sphere: Vec<Corners> = faces.iter().map(|f| f.map(|k| v[k])).collect();
    for _ in 0..level {
        sphere = sphere
            .into_iter()
            .flat_map(|[a, b, c]| {
                let (ab, bc, ca) = ((a + b).normalize(), (b + c).normalize(), (c + a).normalize());
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    sphere.into_iter().map(|t| t.map(|p| p * radius)).collect()
}

/// The zone of the unit sphere between two polar angles, in `rings` by `sectors`. Fronts face inward.
pub fn zone(from: f64, to: f64, rings: usize, sectors: usize) -> Vec<Corners> {
    let at = |ring: usize, sector: usize| {
        let theta = from + (to - from) * ring as f64 / rings as f64;
        let phi = 2.0 * PI * (sector % sectors) as f64 / sectors as f64;
        // The poles are one point each, although sin π does not round to zero.
        let r = if theta < PI { theta.sin() } else { 0.0 };
        dvec3(r * phi.cos(), r * phi.sin(), theta.cos())
    };
    let mut triangles = Vec::new();
    for ring in 0..rings {
        for sector in 0..sectors {
            let (a, b) = (at(ring, sector), at(ring, sector + 1));
            let (c, d) = (at(ring + 1, sector), at(ring + 1, sector + 1));
            triangles.extend([[a, d, c], [a, b, d]].iter().filter(|t| t[0] != t[1] && t[1] != t[2]));
        }
    }
    triangles
}

/// A regular polygon of `n` corners inscribed in the circle of radius `r` at height `z`, as a fan.
pub fn disk(n: usize, r: f64, z: f64, up: bool) -> Vec<Corners> {
    let rim = |k: usize| {
        let phi = 2.0 * PI * (k % n) as f64 / n as f64;
        dvec3(r * phi.cos(), r * phi.sin(), z)
    };
    let fan = (0..n).map(|k| [DVec3::Z * z, rim(k), rim(k + 1)]).collect();
    if up { fan } else { flipped(fan) }
}

pub fn area(triangles: &[Corners]) -> f64 {
    triangles.iter().map(|[a, b, c]| 0.5 * (*b - *a).cross(*c - *a).length()).sum()
}

/// Whether every edge has one triangle in each direction, so that no ray can escape. Vertices at equal positions
/// count as one.
pub fn is_closed(scene: &Scene) -> bool {
    let mut halves: HashMap<(u32, u32), u32> = HashMap::new();
    let mut first: HashMap<[u64; 3], u32> = HashMap::new();
    let place = |v: u32| scene.vertices[v as usize].to_array().map(f64::to_bits);
    for triangle in &scene.triangles {
        let [a, b, c] = triangle.vertices.map(|v| *first.entry(place(v)).or_insert(v));
        for edge in [(a, b), (b, c), (c, a)] {
            *halves.entry(edge).or_default() += 1;
        }
    }
    halves.iter().all(|(&(p, q), &n)| n == 1 && halves.get(&(q, p)) == Some(&1))
}

/// A scene cut into patches, and the form factors from its rays.
pub struct Cast {
    pub scene: Scene,
    pub tracer: Tracer,
    pub patches: Patches,
    pub form_factors: FormFactors,
}

pub fn cast(scene: Scene, subdivision: Subdivision, options: CastOptions) -> Cast {
    let tracer = Tracer::new(&scene);
    cast_by(tracer, scene, subdivision, options)
}

/// Casts with the given tracer of the scene.
pub fn cast_by(tracer: Tracer, scene: Scene, subdivision: Subdivision, options: CastOptions) -> Cast {
    let mut patches = Patches::subdivide(&scene, &subdivision);
    let form_factors = FormFactors::cast(&scene, &tracer, &mut patches, &options, &Progress::new()).unwrap();
    Cast { scene, tracer, patches, form_factors }
}

/// Casts from whole triangles.
pub fn cast_whole(parts: &[Part], rays: f64, estimator: Estimator, seed: u64) -> Cast {
    let options = CastOptions::default().with_rays(rays).with_estimator(estimator).with_seed(seed);
    cast(scene(parts), Subdivision::Edge(f64::INFINITY), options)
}

/// The irradiance from emitters without reflections and its standard errors, in one channel, one value per patch.
pub fn lit(f: &FormFactors, emission: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let zero = vec![0.0; emission.len()];
    let dark = Radiometry { channels: 1, emission, reflectance: &zero };
    let known = solve(f, dark, &SolveOptions::default(), &Progress::new()).unwrap();
    let errors = ErrorBars::of(f, dark, &known).unwrap().standard_error;
    (known.irradiance, errors)
}

/// Standard errors of the irradiance, one per patch, from one channel of known radiosity without reflections.
pub fn standard_errors(f: &FormFactors, radiosity: &[f64]) -> Vec<f64> {
    lit(f, radiosity).1
}

/// A measured value and its standard error.
#[derive(Clone, Copy, Debug)]
pub struct Measured {
    pub value: f64,
    pub error: f64,
}

impl Measured {
    /// Asserts that the value is the truth within [`T15`] standard errors plus a known `slack`.
    #[track_caller]
    pub fn assert_is(self, truth: f64, slack: f64) {
        let Measured { value, error } = self;
        assert!(
            (value - truth).abs() <= T15 * error + slack,
            "{value} instead of {truth}: off by {:.2} standard errors of {error:.1e}",
            (value - truth).abs() / error
        );
    }
}

impl Cast {
    /// The front patches of a part.
    pub fn of_part(&self, part: u32) -> Vec<usize> {
        let of = |i: &usize| self.scene.triangles[self.patches.triangle(*i)].material == part;
        (0..self.patches.fronts()).filter(of).collect()
    }

    /// The form factor between the fronts of two parts.
    ///
    /// The error treats the patches of the first part as independent. They cast their own rays, and a ray from the
    /// second part that hits one of them misses the others. So the variance of the sum is at most the sum of
    /// variances.
    pub fn form_factor(&self, from: u32, to: u32) -> Measured {
        let mut indicator = vec![0.0; self.patches.len()];
        for j in self.of_part(to) {
            indicator[j] = 1.0;
        }
        let irradiance = self.form_factors.light(&indicator, &indicator, 1);
        let errors = standard_errors(&self.form_factors, &indicator);
        self.mean(&self.of_part(from), &irradiance, &errors)
    }

    /// The mean over some patches, weighted by area.
    pub fn mean(&self, patches: &[usize], values: &[f64], errors: &[f64]) -> Measured {
        let areas = self.form_factors.areas();
        let total: f64 = patches.iter().map(|&i| areas[i]).sum();
        let sum: f64 = patches.iter().map(|&i| areas[i] * values[i]).sum();
        let squares: f64 = patches.iter().map(|&i| (areas[i] * errors[i]).powi(2)).sum();
        Measured { value: sum / total, error: squares.sqrt() / total }
    }
}

/// Random numbers in \[0, 1) from a seed.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Random {
        Random(mix(&[seed]))
    }

    pub fn next(&mut self) -> f64 {
        self.0 = mix(&[self.0]);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }
}

/// The matrix of the exchange areas of `n` patches.
pub fn store(n: usize, exchange: impl Fn(usize, usize) -> f64) -> Matrix {
    let (mut starts, mut columns, mut values) = (vec![0], Vec::new(), Vec::new());
    for i in 0..n {
        for j in 0..n {
            let s = exchange(i, j);
            if s != 0.0 {
                columns.push(j as u32);
                values.push(s as f32);
            }
        }
        starts.push(columns.len());
    }
    Matrix::new((n, n), starts, columns, values)
}

/// Exact form factors of a convex polyhedron seen from inside, where nothing blocks. If faces are missing, the light
/// that a row lacks to one escapes.
pub fn convex_form_factors(triangles: &[Corners], is_closed: bool) -> FormFactors {
    let n = triangles.len();
    let areas: Vec<f64> = triangles.iter().map(|t| area(&[*t])).collect();
    let mut exchange = vec![0.0; n * n];
    for i in 0..n {
        for j in 0..i {
            let s = polygon_exchange_area(&triangles[i], &triangles[j]);
            (exchange[i * n + j], exchange[j * n + i]) = (s, s);
        }
    }
    let lacking = |i: usize| (1.0 - exchange[i * n..][..n].iter().sum::<f64>() / areas[i]).max(0.0);
    let escaped = (0..n).map(|i| if is_closed { 0.0 } else { lacking(i) }).collect();
    FormFactors::from_exchange(store(n, |i, j| exchange[i * n + j]), areas, escaped)
}

/// Largest |row sum + escaped - 1| and largest |A_i F_ij - A_j F_ji| / min(A_i, A_j), entry by entry.
pub fn deviations(f: &FormFactors) -> (f64, f64) {
    let a = f.areas();
    let (mut closure, mut reciprocity) = (0f64, 0f64);
    for i in 0..f.len() {
        let sum: f64 = f.row(i).map(|(_, x)| x).sum();
        closure = closure.max((sum + f.escaped()[i] - 1.0).abs());
        for (j, there) in f.row(i) {
            let defect = (a[i] * there - a[j] * f.get(j, i)).abs();
            reciprocity = reciprocity.max(defect / a[i].min(a[j]));
        }
    }
    (closure, reciprocity)
}
