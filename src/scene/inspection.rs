//! Properties of a mesh before any computation: size, edges, and materials.

use std::collections::HashMap;

use glam::DVec3;
use rayon::prelude::*;
use serde::Serialize;

use super::Scene;

/// Vertices closer than this share of the scene's extent count as one. Files round positions to about six digits, so
/// that two triangles can have slightly different ends of a shared edge.
pub const WELD: f64 = 1e-6;

/// Properties of a mesh.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Inspection {
    /// Number of triangles with an area.
    pub triangles: usize,
    /// Number of triangles that were left out because they have no area.
    pub degenerate: usize,
    /// Number of different positions.
    pub vertices: usize,
    /// Number of vertices that lie within [`WELD`] of another vertex. Rays may pass through such cracks.
    pub near_vertices: usize,
    /// Area of all triangles, one side each, in the file's unit squared.
    pub area: f64,
    /// The lowest and highest corner of the bounding box.
    pub bounds: [DVec3; 2],
    /// The edges of the triangles. Near vertices count as one.
    pub edges: Edges,
    /// Number of triangles with the same three corners as an earlier one.
    pub doubled: usize,
    /// The materials, in the scene's order.
    pub materials: Vec<MaterialUse>,
}

/// Numbers of edges by the triangles that share them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct Edges {
    /// All edges.
    pub total: usize,
    /// Edges of one triangle: the rim of a surface. Light escapes there from a solid that should be closed.
    pub open: usize,
    /// Edges of three or more triangles.
    pub non_manifold: usize,
    /// Edges of two triangles that run along it in the same direction. One triangle shows its front where the other
    /// shows its back.
    pub inconsistent: usize,
}

impl Edges {
    /// Whether each edge has exactly two triangles.
    pub fn is_closed(&self) -> bool {
        self.total > 0 && self.open == 0 && self.non_manifold == 0
    }
}

/// A material and the triangles that use it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MaterialUse {
    /// The name of the material.
    pub name: String,
    /// Number of its triangles.
    pub triangles: usize,
    /// Their area, in the file's unit squared.
    pub area: f64,
    /// Their mean reflectance, textures included.
    pub reflectance: [f64; 3],
    /// Their mean emitted radiance, W/(m² sr), textures included.
    pub emission: [f64; 3],
}

impl Inspection {
    /// Inspects a scene. To inspect the mesh as it is in the file, load the scene without cuts
    /// ([`LoadOptions::keep_overlaps`](super::LoadOptions::keep_overlaps)), because each cut adds edges. Time and
    /// memory are proportional to the number of triangles.
    pub fn of(scene: &Scene) -> Inspection {
        let bounds = bounds(scene);
        let (names, near_vertices) = weld(scene, bounds);
        let triangles: Vec<[u32; 3]> =
            scene.triangles.iter().map(|t| t.vertices.map(|v| names[v as usize])).collect();
        Inspection {
            triangles: scene.triangles.len() - scene.backs_of_lamps,
            degenerate: scene.degenerate,
            vertices: scene.vertices.len(),
            near_vertices,
            area: (0..scene.triangles.len()).map(|t| scene.area(t)).sum(),
            bounds,
            edges: edges(&triangles),
            doubled: doubled(&triangles[..scene.triangles.len() - scene.backs_of_lamps]),
            materials: materials(scene),
        }
    }

    /// Longest side of the bounding box.
    pub fn extent(&self) -> f64 {
        (self.bounds[1] - self.bounds[0]).max_element()
    }

    /// The unit of length in which the scene is as large as a room or a building, if there is one. This is a guess.
    /// Only powers and areas depend on it.
    pub fn unit_guess(&self) -> Option<&'static str> {
        // A room measures some metres, a street some hundred metres. The Cornell box has an extent of 549 in
        // millimetres. A room has 300 in centimetres.
        match self.extent() {
            x if (0.5..150.0).contains(&x) => Some("metres"),
            x if (150.0..1_500.0).contains(&x) => Some("centimetres or millimetres"),
            x if (1_500.0..150_000.0).contains(&x) => Some("millimetres"),
            _ => None,
        }
    }
}

fn bounds(scene: &Scene) -> [DVec3; 2] {
    let first = scene.vertices.first().copied().unwrap_or_default();
    scene.vertices.iter().fold([first; 2], |[low, high], &v| [low.min(v), high.max(v)])
}

/// Gives every vertex the index of the first vertex near it. Also counts the vertices whose index has changed.
fn weld(scene: &Scene, [low, high]: [DVec3; 2]) -> (Vec<u32>, usize) {
    // Coordinates are halved first, because the difference of two large ones may overflow.
    let extent = (high * 0.5 - low * 0.5).max_element();
    let mut cells: HashMap<[i32; 3], Vec<u32>> = HashMap::new();
    let unit = |v: DVec3| (v * 0.5 - low * 0.5) / extent;
    let cell = |p: DVec3| (p / (8.0 * WELD)).floor().to_array().map(|x| x as i32);
    let mut near = 0;
    let names = scene.vertices.iter().enumerate().map(|(i, &v)| {
        let p = unit(v);
        // A cell is eight times as wide as `WELD`. So near vertices are usually in the same cell, and a cell holds few
        // other vertices.
        let (from, to) = (cell(p - WELD), cell(p + WELD));
        let near_cells = (from[0]..=to[0])
            .flat_map(|x| (from[1]..=to[1]).flat_map(move |y| (from[2]..=to[2]).map(move |z| [x, y, z])));
        let found = near_cells.into_iter().find_map(|key| {
            let others = cells.get(&key)?;
            others.iter().copied().find(|&o| unit(scene.vertices[o as usize]).distance(p) <= WELD)
        });
        match found {
            Some(other) => {
                near += 1;
                other
            }
            None => {
                cells.entry(cell(p)).or_default().push(i as u32);
                i as u32
            }
        }
    });
    (names.collect(), near)
}

fn edges(triangles: &[[u32; 3]]) -> Edges {
    // The two ends in ascending order, and whether the triangle runs from the larger to the smaller index.
    let mut halves: Vec<(u32, u32, bool)> = triangles
        .iter()
        .flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)])
        .filter(|(a, b)| a != b)
        .map(|(a, b)| (a.min(b), a.max(b), a > b))
        .collect();
    halves.par_sort_unstable();
    let mut edges = Edges::default();
    for edge in halves.chunk_by(|p, q| (p.0, p.1) == (q.0, q.1)) {
        edges.total += 1;
        match edge {
            [_] => edges.open += 1,
            [p, q] => edges.inconsistent += usize::from(p.2 == q.2),
            _ => edges.non_manifold += 1,
        }
    }
    edges
}

fn doubled(triangles: &[[u32; 3]]) -> usize {
    let mut sets: Vec<[u32; 3]> = triangles.to_vec();
    sets.iter_mut().for_each(|t| t.sort_unstable());
    sets.par_sort_unstable();
    sets.chunk_by(|p, q| p == q).map(|same| same.len() - 1).sum()
}

fn materials(scene: &Scene) -> Vec<MaterialUse> {
    const WHOLE: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let mut uses: Vec<MaterialUse> = scene
        .materials
        .iter()
        .map(|m| MaterialUse {
            name: m.name.clone(),
            triangles: 0,
            area: 0.0,
            reflectance: [0.0; 3],
            emission: [0.0; 3],
        })
        .collect();
    for (t, triangle) in scene.triangles.iter().enumerate() {
        let used = &mut uses[triangle.material as usize];
        let area = scene.area(t);
        used.triangles += 1;
        used.area += area;
        let (reflectance, emission) = (scene.mean_reflectance(t, &WHOLE), scene.mean_emission(t, &WHOLE));
        for c in 0..3 {
            used.reflectance[c] += area * reflectance[c];
            used.emission[c] += area * emission[c];
        }
    }
    for used in uses.iter_mut().filter(|used| used.area > 0.0) {
        used.reflectance = used.reflectance.map(|sum| sum / used.area);
        used.emission = used.emission.map(|sum| sum / used.area);
    }
    uses
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Material;

    /// The unit cube seen from outside; `edit` changes its list of sides.
    fn cube(edit: impl Fn(&mut Vec<[DVec3; 3]>)) -> Inspection {
        let at = |k: u32| DVec3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2));
        let sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let mut triangles: Vec<[DVec3; 3]> =
            sides.iter().map(|side| side.map(at)).flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        edit(&mut triangles);
        let triangles: Vec<_> = triangles.into_iter().map(|t| (t, 0)).collect();
        Inspection::of(&Scene::new(&triangles, vec![Material::new("m", [0.25; 3], [2.0; 3])]))
    }

    #[test]
    fn a_cube_is_closed() {
        let whole = cube(|_| ());
        // Euler: 8 - 18 + 12 = 2.
        assert_eq!((whole.vertices, whole.edges.total, whole.triangles), (8, 18, 12));
        assert!(whole.edges.is_closed() && whole.edges.inconsistent == 0 && whole.doubled == 0);
        assert_eq!((whole.area, whole.extent(), whole.near_vertices), (6.0, 1.0, 0));
        assert_eq!(whole.bounds, [DVec3::ZERO, DVec3::ONE]);
        let m = &whole.materials[0];
        assert_eq!((m.triangles, m.area, m.reflectance, m.emission), (12, 6.0, [0.25; 3], [2.0; 3]));
    }

    #[test]
    fn faults_of_a_cube_are_counted() {
        // A side is missing. Its four edges are open, and its diagonal is gone.
        let open = cube(|t| t.truncate(10));
        assert_eq!((open.edges.open, open.edges.total), (4, 17));
        // One triangle is turned round. At its three edges, both triangles run in the same direction.
        let turned = cube(|t| t[3].swap(0, 1));
        assert_eq!((turned.edges.inconsistent, turned.edges.open), (3, 0));
        assert!(turned.edges.is_closed());
        // One triangle is there twice, the second time turned round and from another corner.
        let twice = cube(|t| t.push([t[0][2], t[0][1], t[0][0]]));
        assert_eq!((twice.doubled, twice.edges.non_manifold, twice.edges.open), (1, 3, 0));
        // A wing on an edge of the cube.
        let wing = cube(|t| t.push([t[0][0], t[0][1], DVec3::splat(-1.0)]));
        assert_eq!((wing.edges.non_manifold, wing.edges.open), (1, 2));
    }

    #[test]
    fn vertices_that_were_rounded_apart_are_one() {
        // The corner at the origin has two positions, on both sides of a border between cells.
        let rounded = cube(|t| t[0][0] -= DVec3::splat(0.4e-6));
        assert_eq!((rounded.vertices, rounded.near_vertices), (9, 1));
        assert!(rounded.edges.is_closed());
        let apart = cube(|t| t[0][0] -= DVec3::splat(4e-6));
        assert_eq!(apart.near_vertices, 0);
        assert_eq!(apart.edges.open, 4);
    }

    #[test]
    fn very_large_coordinates_do_not_overflow() {
        let huge = cube(|t| t.iter_mut().flatten().for_each(|p| *p = (*p - 0.5) * 1e154));
        assert!(huge.edges.is_closed());
        assert_eq!(huge.unit_guess(), None);
        assert_eq!(
            cube(|t| t.iter_mut().flatten().for_each(|p| *p *= 3000.0)).unit_guess(),
            Some("millimetres")
        );
    }
}
