//! Surfaces for heat transfer: the faces of a file, or its groups, objects or materials.
//!
//! Each surface consists of triangles and parallelograms. A quadrilateral face that is a parallelogram stays one. All
//! other faces consist of the triangles that the reader cut them into.

use std::collections::{HashMap, HashSet};

use glam::DVec3;

use super::{Material, Part, Scene, Triangle, centre_and_extent};

/// The faces that make up one surface.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum By {
    /// A face. Its name is its number in the file, from 0.
    Face,
    /// All faces of a group.
    Group,
    /// All faces of an object.
    Object,
    /// All faces of a material.
    Material,
    /// All faces of a PLY file with the same value of this property; the name is the value.
    Property(String),
}

/// The sides of faces that count as surfaces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The side from which vertices run counter-clockwise.
    Front,
    /// The side from which vertices run clockwise.
    Back,
    /// All fronts, then all backs, whose names end in ` back`.
    Both,
}

/// A surface.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Surface {
    /// Its name.
    pub name: String,
    /// The line of its first face in a text file.
    pub line: Option<usize>,
    /// Number of faces.
    pub faces: usize,
    /// Triangles and parallelograms, counter-clockwise as seen from the side of the surface.
    pub polygons: Vec<Vec<DVec3>>,
}

impl AsRef<[Vec<DVec3>]> for Surface {
    fn as_ref(&self) -> &[Vec<DVec3>] {
        &self.polygons
    }
}

/// The surfaces of a scene.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Surfaces {
    /// In the order in which they begin in the file.
    pub list: Vec<Surface>,
    /// Number of polygons that were left out because an earlier one is at the same place and faces the same way.
    pub doubled: usize,
    /// Number of triangles that were left out because they are smaller than [`SMALLEST`].
    pub tiny: usize,
    /// Polygons that block but are not surfaces.
    pub obstacles: Vec<Vec<DVec3>>,
    /// Faces that are probably mistakes in the file.
    pub odd: OddFaces,
}

/// Faces that are probably mistakes in the file. Each has its number in the file, from 0, and its line.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct OddFaces {
    /// Faces whose corners do not lie in one plane. Their triangles are used as they are.
    pub bent: Vec<(usize, Option<usize>)>,
    /// Faces that run along an edge in the same direction as the only neighbour there. One of the two shows its back.
    pub turned: Vec<(usize, Option<usize>)>,
}

/// The name of faces without a group, object or material.
pub const NONE: &str = "(none)";

/// Triangles are left out if twice their area is at most this share of the square of the scene's extent. Their corners
/// are practically in a line.
pub const SMALLEST: f64 = 1e-24;

/// Largest distance between the fourth corner of a quadrilateral and the fourth corner of the parallelogram, as a share
/// of the diagonal and of the scene's extent. Files round to six digits. With a larger tolerance, points of the
/// parallelogram could lie behind the face.
const SKEW: (f64, f64) = (5e-6, 2e-7);

impl Surfaces {
    /// The surfaces of `scene`. Read it with [`LoadOptions::faces`](super::LoadOptions::faces), otherwise each triangle
    /// is a face.
    pub fn of(scene: &Scene, by: &By, side: Side) -> Surfaces {
        Surfaces::among(scene, by, side, &[])
    }

    /// The surfaces of `scene` as from [`Surfaces::of`], but faces of the materials `obstacles` only block and are not
    /// surfaces.
    pub fn among(scene: &Scene, by: &By, side: Side, obstacles: &[u32]) -> Surfaces {
        let mut surfaces = Surfaces {
            list: Vec::new(),
            doubled: 0,
            tiny: 0,
            obstacles: Vec::new(),
            odd: OddFaces { bent: Vec::new(), turned: turned(scene) },
        };
        let (_, extent) = centre_and_extent(scene.vertices.iter().copied());
        let (mut known, mut seen): (HashMap<String, usize>, HashSet<Vec<u32>>) = Default::default();
        // The added backs of emitters are not faces of the file.
        let mut rest = &scene.triangles[..scene.triangles.len() - scene.backs_of_lamps];
        while let Some(triangle) = rest.first() {
            let after = scene.faces.partition_point(|face| face.first <= triangle.source);
            let end = scene.faces.get(after).map_or(u32::MAX, |face| face.first);
            let count = if scene.faces.is_empty() { 1 } else { rest.partition_point(|t| t.source < end) };
            let (triangles, others) = rest.split_at(count);
            rest = others;
            let large = |t: &&Triangle| is_large(scene, t, extent);
            let all: Vec<&Triangle> = triangles.iter().filter(large).collect();
            surfaces.tiny += triangles.len() - all.len();
            let corners = |p: Vec<u32>| p.into_iter().map(|v| scene.vertices[v as usize]).collect();
            let mut polygons = polygons(scene, &all, extent);
            if obstacles.contains(&triangle.material) {
                surfaces.obstacles.extend(polygons.into_iter().map(corners));
                continue;
            }
            if !is_flat(scene, &all, extent) {
                let line = after.checked_sub(1).and_then(|k| scene.faces[k].line);
                surfaces.odd.bent.push((after.saturating_sub(1), line));
            }
            let before = polygons.len();
            polygons.retain(|polygon| seen.insert(cycle(polygon)));
            surfaces.doubled += before - polygons.len();
            if polygons.is_empty() {
                continue;
            }
            let face = after.checked_sub(1).map(|k| scene.faces[k]);
            let part = face.and_then(|face| scene.parts.get(face.part as usize));
            let named = |name: fn(&Part) -> &Option<String>| part.and_then(|part| name(part).clone());
            let name = match by {
                By::Face => Some(after.checked_sub(1).map_or(triangle.source as usize, |k| k).to_string()),
                By::Group => named(|part| &part.group),
                By::Object => named(|part| &part.object),
                By::Property(property) => part.and_then(|part| {
                    let found = part.properties.iter().find(|(name, _)| name == property);
                    found.map(|(_, value)| value.clone())
                }),
                By::Material => Some(scene.materials[triangle.material as usize].name.clone()),
            };
            let name = name.unwrap_or_else(|| NONE.into());
            let at = *known.entry(name.clone()).or_insert(surfaces.list.len());
            if at == surfaces.list.len() {
                let line = face.and_then(|face| face.line);
                surfaces.list.push(Surface { name, line, faces: 0, polygons: Vec::new() });
            }
            let surface = &mut surfaces.list[at];
            surface.faces += 1;
            surface.polygons.extend(polygons.into_iter().map(corners));
        }
        surfaces.turned(side)
    }

    fn turned(mut self, side: Side) -> Surfaces {
        let turn = |surface: &mut Surface| surface.polygons.iter_mut().for_each(|p| p.reverse());
        match side {
            Side::Front => {}
            Side::Back => self.list.iter_mut().for_each(turn),
            Side::Both => {
                let mut backs = self.list.clone();
                for back in &mut backs {
                    turn(back);
                    back.name += " back";
                }
                self.list.append(&mut backs);
            }
        }
        self
    }

    /// Splits surfaces: each triangle and parallelogram becomes a surface with the name of its original surface. Also
    /// returns the index of the original surface of each.
    pub fn parts(&self) -> (Surfaces, Vec<usize>) {
        let of = |(k, surface): (usize, &Surface)| {
            let (name, line) = (surface.name.clone(), surface.line);
            let part = move |polygon: &Vec<DVec3>| {
                (Surface { name: name.clone(), line, faces: 1, polygons: vec![polygon.clone()] }, k)
            };
            surface.polygons.iter().map(part).collect::<Vec<_>>()
        };
        let (list, surface_of) = self.list.iter().enumerate().flat_map(of).unzip();
        let (obstacles, odd) = (self.obstacles.clone(), self.odd.clone());
        (Surfaces { list, doubled: self.doubled, tiny: self.tiny, obstacles, odd }, surface_of)
    }

    /// Number of triangles and parallelograms of all surfaces.
    pub fn polygons(&self) -> usize {
        self.list.iter().map(|surface| surface.polygons.len()).sum()
    }

    /// A scene for rays. Its triangles show their fronts on the sides that are surfaces.
    pub fn scene(&self) -> Scene {
        let polygons = self.list.iter().flat_map(|surface| &surface.polygons);
        let triangles: Vec<([DVec3; 3], u32)> =
            polygons.flat_map(|p| (2..p.len()).map(|k| ([p[0], p[k - 1], p[k]], 0))).collect();
        Scene::new(&triangles, vec![Material::new("surfaces", [0.0; 3], [0.0; 3])])
    }
}

/// Largest distance of a corner from the plane of its face: the sum of these shares of the scene's extent and of the
/// face's extent. Files round to six digits.
const BENT: (f64, f64) = (2e-6, 1e-4);

/// Whether the triangles of a face lie in one plane.
fn is_flat(scene: &Scene, triangles: &[&Triangle], extent: f64) -> bool {
    let at = |v: u32| scene.vertices[v as usize] / extent;
    let corners = || triangles.iter().flat_map(|t| t.vertices).map(at);
    let vector = |t: &&Triangle| {
        let [a, b, c] = t.vertices.map(at);
        (b - a).cross(c - a)
    };
    let Some(origin) = corners().next() else { return true };
    let normal = triangles.iter().map(vector).sum::<DVec3>().normalize_or_zero();
    let size = corners().map(|p| p.distance(origin)).fold(0.0, f64::max);
    corners().all(|p| (p - origin).dot(normal).abs() <= BENT.0 + BENT.1 * size)
}

/// The faces that are probably turned round. Two faces that share an edge alone and run along it in the same direction
/// disagree: one of the two shows its back. The list has the face of the two that agrees with fewer of its neighbours.
fn turned(scene: &Scene) -> Vec<(usize, Option<usize>)> {
    let triangles = &scene.triangles[..scene.triangles.len() - scene.backs_of_lamps];
    let mut edges: Vec<(u32, u32, bool, usize)> = Vec::with_capacity(3 * triangles.len());
    for triangle in triangles {
        let own = scene.face_of_source(triangle.source).unwrap_or(triangle.source as usize);
        for k in 0..3 {
            let (a, b) = (triangle.vertices[k], triangle.vertices[(k + 1) % 3]);
            edges.push((a.min(b), a.max(b), a > b, own));
        }
    }
    edges.sort_unstable();
    // For each face, the number of edges at which it disagrees with its neighbour, and at which it agrees.
    let mut counts: HashMap<usize, [i32; 2]> = HashMap::new();
    let mut against = Vec::new();
    for edge in edges.chunk_by(|e, f| (e.0, e.1) == (f.0, f.1)) {
        if let [e, f] = edge
            && e.3 != f.3
        {
            let agrees = e.2 != f.2;
            for of in [e.3, f.3] {
                counts.entry(of).or_default()[usize::from(agrees)] += 1;
            }
            if !agrees {
                against.push([e.3, f.3]);
            }
        }
    }
    let agreement = |of: usize| counts[&of][1] - counts[&of][0];
    let mut faces: Vec<usize> =
        against.into_iter().map(|[e, f]| if agreement(f) < agreement(e) { f } else { e }).collect();
    faces.sort_unstable();
    faces.dedup();
    faces.into_iter().map(|k| (k, scene.faces.get(k).and_then(|face| face.line))).collect()
}

fn is_large(scene: &Scene, triangle: &Triangle, extent: f64) -> bool {
    let [a, b, c] = triangle.vertices.map(|v| scene.vertices[v as usize] / extent);
    (b - a).cross(c - a).length() > SMALLEST
}

/// The corners of the parallelogram if the triangles of a face form one; otherwise the corners of each triangle.
fn polygons(scene: &Scene, triangles: &[&Triangle], extent: f64) -> Vec<Vec<u32>> {
    if let [first, second] = triangles {
        let ([p, q, r], [a, b, s]) = (first.vertices, second.vertices);
        let at = |v: u32| scene.vertices[v as usize] / extent;
        let off = (at(r) - at(q) - (at(s) - at(p))).length();
        if (a, b) == (p, r) && off <= SKEW.0 * at(r).distance(at(p)) && off <= SKEW.1 {
            return vec![vec![p, q, r, s]];
        }
    }
    triangles.iter().map(|triangle| triangle.vertices.to_vec()).collect()
}

/// The corners in order, beginning with the smallest index. Equal polygons give equal lists.
fn cycle(polygon: &[u32]) -> Vec<u32> {
    let mut corners = polygon.to_vec();
    let least = (0..corners.len()).min_by_key(|&k| corners[k]).unwrap_or(0);
    corners.rotate_left(least);
    corners
}
