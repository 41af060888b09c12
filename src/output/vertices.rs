//! The patches as one mesh with shared vertices.
//!
//! A vertex is a vertex of the scene, a point on an edge, or a point inside one triangle. A point on an edge is given
//! by its distance from the end with the lower index, as a dyadic fraction. Its position is computed in the same way
//! for all patches that meet there, so the positions agree to the last bit.
//!
//! Where one triangle is cut more finely than its neighbour, a large patch has vertices of smaller patches on its edge.
//! It is drawn as several faces that have these vertices as corners (`pieces`). Otherwise viewers would show pixels of
//! the background along such edges.
//!
//! Where surfaces meet at a crease, each surface has vertices of its own, because each has its own radiosity there.

use glam::DVec3;
use rayon::prelude::*;

use super::{
    meeting::{Meeting, common_edge},
    pieces::{OnEdges, Pieces},
    surfaces::{NONE, Surfaces, has_side},
};
use crate::{
    patch::{
        Cell, Patches,
        edges::{FINEST, edge_of, from_lower_end},
        restricted::{middle, points},
    },
    scene::Scene,
};

/// Default crease angle in degrees. A column of 16 sides looks round with it, a column of 8 sides keeps its edges.
pub const CREASE: f64 = 30.0;

/// A vertex within an edge of a patch, where smaller patches meet the patch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hanging {
    /// The vertex.
    pub vertex: u32,
    /// The ends of the larger patch's edge.
    pub ends: [u32; 2],
    /// Position of the vertex from the first end to the second, between 0 and 1.
    pub fraction: f64,
}

/// The vertices of all patches.
#[derive(Debug, Clone)]
pub struct PatchMesh {
    positions: Vec<DVec3>,
    corners: Vec<[u32; 3]>,
    pieces: Pieces,
    hanging: Vec<Hanging>,
    fronts: usize,
}

impl PatchMesh {
    /// Numbers the vertices. Surfaces that bend by `crease` degrees or more at an edge share no vertices there.
    pub fn new(scene: &Scene, patches: &Patches, crease: f64) -> PatchMesh {
        let surfaces = Surfaces::new(scene, patches, crease);
        let meeting = Meeting::new(scene, patches);
        let mut numbering = Numbering::new(scene, patches, &surfaces, &meeting);
        for front in [true, false] {
            for t in (0..scene.triangles.len()).filter(|&t| has_side(patches, t, front)) {
                numbering.add(t, front);
            }
        }
        let corners: Vec<_> = (0..patches.len()).into_par_iter().map(|i| numbering.corners_of(i)).collect();
        let met = numbering.met();
        PatchMesh {
            pieces: Pieces::new(&numbering.positions, &corners, &met),
            hanging: hanging(patches, &corners, &met),
            positions: numbering.positions,
            corners,
            fronts: patches.fronts(),
        }
    }

    /// Positions of the vertices in scene units.
    pub fn positions(&self) -> &[DVec3] {
        &self.positions
    }

    /// The vertices of patch `i` in the order of its triangle's corners.
    pub fn corners(&self, i: usize) -> [u32; 3] {
        self.corners[i]
    }

    /// Number of faces: first one for each patch, in the order of patches, then the other pieces of patches that are
    /// drawn as several faces.
    pub fn faces(&self) -> usize {
        self.corners.len() + self.pieces.others()
    }

    /// Whether some patch is drawn as several faces.
    pub fn has_pieces(&self) -> bool {
        self.pieces.others() > 0
    }

    /// The patch of a face, and the share of the patch's area that the face covers.
    pub fn patch(&self, face: usize) -> (usize, f64) {
        self.pieces
            .get(face, self.corners.len())
            .map_or((face, 1.0), |piece| (piece.patch as usize, piece.share))
    }

    /// The vertices of a face, counter-clockwise as seen from its side of the patch.
    pub fn face(&self, face: usize) -> [u32; 3] {
        let piece = self.pieces.get(face, self.corners.len());
        let (patch, [a, b, c]) =
            piece.map_or_else(|| (face, self.corners[face]), |piece| (piece.patch as usize, piece.corners));
        if patch < self.fronts { [a, b, c] } else { [a, c, b] }
    }

    /// The vertices within edges of larger patches, those of the largest patches first.
    pub fn hanging(&self) -> &[Hanging] {
        &self.hanging
    }
}

/// The vertices within edges of larger patches, those of the largest patches first.
fn hanging(patches: &Patches, corners: &[[u32; 3]], met: &[OnEdges]) -> Vec<Hanging> {
    let mut order: Vec<&OnEdges> = met.iter().collect();
    order.sort_by_key(|met| patches.cell(met.patch as usize).level);
    let of_patch = |met: &'_ &OnEdges| {
        let corners = corners[met.patch as usize];
        let of_edge = |k: usize| {
            let ends = [corners[k], corners[(k + 1) % 3]];
            let at = move |&(vertex, fraction): &(u32, f64)| Hanging { vertex, ends, fraction };
            met.edges[k].iter().map(at).collect::<Vec<_>>()
        };
        (0..3).flat_map(of_edge).collect::<Vec<_>>()
    };
    order.iter().flat_map(of_patch).collect()
}

/// Numbering of the vertices. Points have whole barycentric coordinates that sum to 2^[`FINEST`]. A point on an edge is
/// given by its distance from the end with the lower index.
struct Numbering<'a> {
    scene: &'a Scene,
    patches: &'a Patches,
    surfaces: &'a Surfaces,
    meeting: &'a Meeting,
    positions: Vec<DVec3>,
    /// For the lowest slot of each cluster, the vertex at its corner.
    corner: Vec<u32>,
    /// For the lower one of the slots that share an edge, the first vertex inside the edge.
    edge: Vec<u32>,
    /// The first vertex inside each side of a triangle, fronts first.
    inner: Vec<u32>,
    /// The points inside edges of mixed triangles: edge of the scene and distance, sorted. All surfaces that meet at an
    /// edge have vertices at all of its points.
    on_edges: Vec<(u32, u32)>,
    /// The points inside triangles that are not uniform: triangle and two coordinates, sorted.
    inside: Vec<(u32, [u32; 2])>,
}

impl<'a> Numbering<'a> {
    fn new(scene: &'a Scene, patches: &'a Patches, surfaces: &'a Surfaces, meeting: &'a Meeting) -> Self {
        let slots = surfaces.slots();
        let mut numbering = Numbering {
            scene,
            patches,
            surfaces,
            meeting,
            positions: Vec::with_capacity(patches.len() / 2 + scene.vertices.len()),
            corner: vec![NONE; slots],
            edge: vec![NONE; slots],
            inner: vec![NONE; slots / 3],
            on_edges: Vec::new(),
            inside: Vec::new(),
        };
        numbering.list_points();
        numbering
    }

    /// Fills the lists of points.
    fn list_points(&mut self) {
        let (mut on_edges, mut inside) = (Vec::new(), Vec::new());
        for (_, cell) in &self.meeting.cells {
            let t = cell.triangle as usize;
            for p in points(cell).into_iter().filter(|p| !p.contains(&(1 << FINEST))) {
                match edge_of(p) {
                    Some(k) => on_edges.push((self.meeting.edges.of(t, k), self.distance(t, k, p))),
                    None if !self.patches.is_uniform(t) => inside.push((cell.triangle, [p[1], p[2]])),
                    None => {}
                }
            }
        }
        on_edges.par_sort_unstable();
        on_edges.dedup();
        inside.par_sort_unstable();
        inside.dedup();
        (self.on_edges, self.inside) = (on_edges, inside);
    }

    fn distance(&self, t: usize, k: usize, p: [u32; 3]) -> u32 {
        from_lower_end(self.scene.triangles[t].vertices, k, p)
    }

    /// Numbers the vertices of a side of triangle `t` that have no number yet.
    fn add(&mut self, t: usize, front: bool) {
        for k in 0..3 {
            let slot = self.surfaces.slot(t, k, front);
            let cluster = self.surfaces.cluster(slot);
            if self.corner[cluster] == NONE {
                self.corner[cluster] = self.positions.len() as u32;
                self.positions.push(self.scene.corners(t)[k]);
            }
            let owner = owner(self.surfaces, slot);
            if self.edge[owner] == NONE {
                self.edge[owner] = self.positions.len() as u32;
                self.push_edge(owner);
            }
        }
        self.inner[self.surfaces.slot(t, 0, front) / 3] = self.positions.len() as u32;
        let [a, b, c] = self.scene.corners(t);
        let along = |k: u32, n: u32| f64::from(k) / f64::from(n);
        if self.patches.is_uniform(t) {
            let n = 1u32 << self.patches.level(t);
            for i in 1..n {
                for j in 1..n - i {
                    self.positions.push(a + (b - a) * along(i, n) + (c - a) * along(j, n));
                }
            }
        } else {
            for &(_, [i, j]) in run(&self.inside, t as u32).1 {
                let n = 1 << FINEST;
                self.positions.push(a + (b - a) * along(i, n) + (c - a) * along(j, n));
            }
        }
    }

    /// Adds the vertices inside an edge, from the end with the lower index to the other.
    fn push_edge(&mut self, slot: usize) {
        let v = self.scene.triangles[self.surfaces.triangle(slot)].vertices;
        let (a, b) = (v[slot % 3], v[(slot + 1) % 3]);
        let [low, high] = [a.min(b), a.max(b)].map(|v| self.scene.vertices[v as usize]);
        let at = |k: u32, n: u32| low + (high - low) * (f64::from(k) / f64::from(n));
        if self.is_listed(slot) {
            let (_, listed) = run(&self.on_edges, self.scene_edge(slot));
            self.positions.extend(listed.iter().map(|&(_, distance)| at(distance, 1 << FINEST)));
        } else {
            let n = 1 << self.patches.level(self.surfaces.triangle(slot));
            self.positions.extend((1..n).map(|k| at(k, n)));
        }
    }

    /// Whether the points inside the edge of a slot are listed. Otherwise its triangles cut it evenly.
    fn is_listed(&self, slot: usize) -> bool {
        let is_mixed = |slot: usize| self.meeting.is_mixed(self.surfaces.triangle(slot));
        is_mixed(slot) || self.surfaces.across(slot).is_some_and(is_mixed)
    }

    /// The number of the scene's edge at a slot.
    fn scene_edge(&self, slot: usize) -> u32 {
        self.meeting.edges.of(self.surfaces.triangle(slot), slot % 3)
    }

    /// The vertex inside an edge at a point, if there is one.
    fn on_edge(&self, slot: usize, distance: u32) -> Option<u32> {
        let owner = owner(self.surfaces, slot);
        let index = if self.is_listed(owner) {
            let edge = self.scene_edge(owner);
            let (start, _) = run(&self.on_edges, edge);
            self.on_edges.binary_search(&(edge, distance)).ok()? - start
        } else {
            (distance >> (FINEST - u32::from(self.patches.level(self.surfaces.triangle(owner))))) as usize - 1
        };
        Some(self.edge[owner] + index as u32)
    }

    /// The vertices of patch `i` in the order of its triangle's corners.
    fn corners_of(&self, i: usize) -> [u32; 3] {
        let (t, front) = (self.patches.triangle(i), self.patches.is_front(i));
        let vertex = |p| self.vertex(t, front, p).expect("corners of patches have vertices");
        points(&self.patches.cell(i)).map(vertex)
    }

    /// The vertex of a side of a triangle at a point, if there is one.
    fn vertex(&self, t: usize, front: bool, p: [u32; 3]) -> Option<u32> {
        if let Some(k) = (0..3).find(|&k| p[k] == 1 << FINEST) {
            return Some(self.corner[self.surfaces.cluster(self.surfaces.slot(t, k, front))]);
        }
        if let Some(k) = edge_of(p) {
            return self.on_edge(self.surfaces.slot(t, k, front), self.distance(t, k, p));
        }
        let index = if self.patches.is_uniform(t) {
            let level = u32::from(self.patches.level(t));
            let (n, [_, row, column]) = (1u32 << level, p.map(|x| x >> (FINEST - level)));
            (row - 1) * (n - 1) - row * (row - 1) / 2 + column - 1
        } else {
            let (start, _) = run(&self.inside, t as u32);
            (self.inside.binary_search(&(t as u32, [p[1], p[2]])).ok()? - start) as u32
        };
        Some(self.inner[self.surfaces.slot(t, 0, front) / 3] + index)
    }

    /// The patches that have vertices of neighbours on their edges, in order.
    fn met(&self) -> Vec<OnEdges> {
        let of_cell = |(i, cell): &(usize, Cell)| {
            let back = self.patches.back_of(*i).map(|back| (back, false));
            let sides = std::iter::once((*i as u32, true)).chain(back);
            let met = sides.map(|(patch, front)| OnEdges { patch, edges: self.on_edges_of(cell, front) });
            met.filter(|met| met.edges.iter().any(|edge| !edge.is_empty())).collect::<Vec<_>>()
        };
        let mut met: Vec<OnEdges> = self.meeting.cells.par_iter().flat_map_iter(of_cell).collect();
        met.par_sort_unstable_by_key(|met| met.patch);
        met
    }

    /// The vertices within each edge of a patch, with their positions along it from 0 to 1, in order.
    fn on_edges_of(&self, cell: &Cell, front: bool) -> [Vec<(u32, f64)>; 3] {
        let (t, p) = (cell.triangle as usize, points(cell));
        std::array::from_fn(|k| {
            let (a, b) = (p[k], p[(k + 1) % 3]);
            match common_edge(a, b) {
                Some(side) => {
                    let slot = self.surfaces.slot(t, side, front);
                    let first = self.edge[owner(self.surfaces, slot)];
                    let [from, to] = [a, b].map(|p| self.distance(t, side, p));
                    let (_, listed) = run(&self.on_edges, self.scene_edge(slot));
                    let [start, end] =
                        [from.min(to) + 1, from.max(to)].map(|x| listed.partition_point(|&(_, y)| y < x));
                    let fraction =
                        |x: u32| (f64::from(x) - f64::from(from)) / (f64::from(to) - f64::from(from));
                    let mut within: Vec<_> =
                        (start..end).map(|n| (first + n as u32, fraction(listed[n].1))).collect();
                    if from > to {
                        within.reverse();
                    }
                    within
                }
                // Quadtrees are restricted: a neighbour in the same triangle is smaller by at most one level.
                None if !self.patches.is_uniform(t) && u32::from(cell.level) < FINEST => {
                    self.vertex(t, front, middle(a, b)).map(|vertex| (vertex, 0.5)).into_iter().collect()
                }
                None => Vec::new(),
            }
        })
    }
}

/// The lower one of the slots that share an edge's vertices.
fn owner(surfaces: &Surfaces, slot: usize) -> usize {
    surfaces.across(slot).map_or(slot, |other| slot.min(other))
}

/// The start and the entries of the run of a sorted list that has the key `key`.
fn run<T>(list: &[(u32, T)], key: u32) -> (usize, &[(u32, T)]) {
    let start = list.partition_point(|&(k, _)| k < key);
    let length = list[start..].partition_point(|&(k, _)| k == key);
    (start, &list[start..start + length])
}
