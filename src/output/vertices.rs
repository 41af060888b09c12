//! The patches as one mesh with shared vertices.
//!
//! A vertex is known by where it is: a vertex of the scene; a dyadic fraction of the way along an edge, counted from
//! the end with the lower index; or a point inside one triangle. Its position comes from one expression of those, so
//! patches that meet there agree to the last bit, also where one triangle is cut more finely than its neighbour.
//!
//! Where surfaces meet at a crease, one place has a vertex for each surface, because each has its own radiosity there.

use glam::DVec3;
use rayon::prelude::*;

use super::surfaces::{NONE, Surfaces, has_side};
use crate::{
    patch::{Patches, quadtree},
    scene::Scene,
};

/// Surfaces whose normals differ by less than this many degrees at an edge look smooth there: a column of 16 sides
/// looks round, one of 8 sides keeps its edges.
pub const CREASE: f64 = 30.0;

/// A vertex in the middle of an edge of a coarser patch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hanging {
    /// The vertex.
    pub vertex: u32,
    /// The ends of the coarser patch's edge.
    pub ends: [u32; 2],
    /// How far the vertex is from the first end to the second, between 0 and 1.
    pub fraction: f64,
}

/// The vertices of all patches.
#[derive(Debug, Clone)]
pub struct PatchMesh {
    positions: Vec<DVec3>,
    corners: Vec<[u32; 3]>,
    hanging: Vec<Hanging>,
    fronts: usize,
}

impl PatchMesh {
    /// Numbers the vertices; surfaces that bend by `crease` degrees or more at an edge share none there.
    pub fn new(scene: &Scene, patches: &Patches, crease: f64) -> PatchMesh {
        let surfaces = Surfaces::new(scene, patches, crease);
        let mut numbering = Numbering::new(scene, patches, &surfaces);
        for front in [true, false] {
            for t in (0..scene.triangles.len()).filter(|&t| has_side(patches, t, front)) {
                numbering.add(t, front);
            }
        }
        let corners = (0..patches.len()).into_par_iter().map(|i| numbering.corners_of(i)).collect();
        PatchMesh {
            hanging: numbering.hanging(),
            positions: numbering.positions,
            corners,
            fronts: patches.fronts(),
        }
    }

    /// Where the vertices are, in the file's unit.
    pub fn positions(&self) -> &[DVec3] {
        &self.positions
    }

    /// The vertices of patch `i` in the order of its triangle's corners.
    pub fn corners(&self, i: usize) -> [u32; 3] {
        self.corners[i]
    }

    /// The vertices of patch `i`, counter-clockwise seen from the side that it is on.
    pub fn face(&self, i: usize) -> [u32; 3] {
        let [a, b, c] = self.corners[i];
        if i < self.fronts { [a, b, c] } else { [a, c, b] }
    }

    /// The vertices in the middle of edges of coarser patches of the same surface.
    pub fn hanging(&self) -> &[Hanging] {
        &self.hanging
    }
}

/// Numbers of the vertices while they are given out.
struct Numbering<'a> {
    scene: &'a Scene,
    patches: &'a Patches,
    surfaces: &'a Surfaces,
    positions: Vec<DVec3>,
    /// The vertex at the corner of each slot that is the lowest of its cluster.
    corner: Vec<u32>,
    /// The first vertex inside the edge of each slot that is the lower of those that share it.
    edge: Vec<u32>,
    /// The first vertex inside each side of a triangle, fronts first.
    inner: Vec<u32>,
}

impl<'a> Numbering<'a> {
    fn new(scene: &'a Scene, patches: &'a Patches, surfaces: &'a Surfaces) -> Self {
        let slots = surfaces.slots();
        Numbering {
            scene,
            patches,
            surfaces,
            positions: Vec::with_capacity(patches.len() / 2 + scene.vertices.len()),
            corner: vec![NONE; slots],
            edge: vec![NONE; slots],
            inner: vec![NONE; slots / 3],
        }
    }

    /// Gives numbers to the vertices of a side of triangle `t` that have none yet.
    fn add(&mut self, t: usize, front: bool) {
        for k in 0..3 {
            let slot = self.surfaces.slot(t, k, front);
            let cluster = self.surfaces.cluster(slot);
            if self.corner[cluster] == NONE {
                self.corner[cluster] = self.positions.len() as u32;
                self.positions.push(self.scene.corners(t)[k]);
            }
            let owner = self.owner(slot);
            if self.edge[owner] == NONE {
                self.edge[owner] = self.positions.len() as u32;
                self.push_edge(owner);
            }
        }
        self.inner[self.surfaces.slot(t, 0, front) / 3] = self.positions.len() as u32;
        let [a, b, c] = self.scene.corners(t);
        let n = 1u32 << self.patches.level(t);
        for i in 1..n {
            for j in 1..n - i {
                let along = |k: u32| f64::from(k) / f64::from(n);
                self.positions.push(a + (b - a) * along(i) + (c - a) * along(j));
            }
        }
    }

    /// The vertices inside an edge, from the end with the lower index to the other.
    fn push_edge(&mut self, slot: usize) {
        let (low, high) = self.ends(slot);
        let (low, high) = (self.scene.vertices[low as usize], self.scene.vertices[high as usize]);
        let n = 1u32 << self.finest(slot);
        for k in 1..n {
            self.positions.push(low + (high - low) * (f64::from(k) / f64::from(n)));
        }
    }

    /// The lower of the slots that share an edge's vertices.
    fn owner(&self, slot: usize) -> usize {
        self.surfaces.across(slot).map_or(slot, |other| slot.min(other))
    }

    /// The vertices of the scene at the ends of an edge, lower index first.
    fn ends(&self, slot: usize) -> (u32, u32) {
        let v = self.scene.triangles[self.surfaces.triangle(slot)].vertices;
        let (a, b) = (v[slot % 3], v[(slot + 1) % 3]);
        (a.min(b), a.max(b))
    }

    /// The finest level of the triangles that share an edge's vertices.
    fn finest(&self, slot: usize) -> u8 {
        let level = |slot: usize| self.patches.level(self.surfaces.triangle(slot));
        self.surfaces.across(slot).map_or(level(slot), |other| level(slot).max(level(other)))
    }

    /// The vertex `k` / 2^`level` of the way along an edge from its lower end.
    fn on_edge(&self, slot: usize, k: u32, level: u8) -> u32 {
        let lower_first = {
            let v = self.scene.triangles[self.surfaces.triangle(slot)].vertices;
            v[slot % 3] < v[(slot + 1) % 3]
        };
        let n = 1 << level;
        if k == 0 || k == n {
            let at_start = lower_first == (k == 0);
            let corner = if at_start { slot } else { slot - slot % 3 + (slot + 1) % 3 };
            return self.corner[self.surfaces.cluster(corner)];
        }
        self.edge[self.owner(slot)] + (k << (self.finest(slot) - level)) - 1
    }

    /// The vertices of patch `i` in the order of its triangle's corners.
    fn corners_of(&self, i: usize) -> [u32; 3] {
        let t = self.patches.triangle(i);
        let level = self.patches.level(t);
        let front = self.patches.is_front(i);
        quadtree::lattice(self.patches.child(i), level).map(|p| self.lattice_vertex(t, front, level, p))
    }

    /// The vertex at whole barycentric coordinates that sum to 2^`level`.
    fn lattice_vertex(&self, t: usize, front: bool, level: u8, p: [u32; 3]) -> u32 {
        let n = 1u32 << level;
        // Edge k runs from corner k to corner k + 1; there the third coordinate is zero.
        if let Some(k) = (0..3).find(|&k| p[(k + 2) % 3] == 0) {
            let slot = self.surfaces.slot(t, k, front);
            let v = self.scene.triangles[t].vertices;
            let from_lower = if v[k] < v[(k + 1) % 3] { p[(k + 1) % 3] } else { p[k] };
            return self.on_edge(slot, from_lower, level);
        }
        let [_, row, column] = p;
        let before = (row - 1) * (n - 1) - row * (row - 1) / 2;
        self.inner[self.surfaces.slot(t, 0, front) / 3] + before + column - 1
    }

    /// The vertices of finer triangles in the middle of edges of coarser ones.
    fn hanging(&self) -> Vec<Hanging> {
        let mut hanging = Vec::new();
        for slot in 0..self.surfaces.slots() {
            let coarse = self.patches.level(self.surfaces.triangle(slot));
            let fine = self.finest(slot);
            if self.surfaces.across(slot).is_none() || coarse == fine {
                continue;
            }
            let step = 1u32 << (fine - coarse);
            for k in (1..1u32 << fine).filter(|k| k % step != 0) {
                let end = k / step;
                hanging.push(Hanging {
                    vertex: self.on_edge(slot, k, fine),
                    ends: [self.on_edge(slot, end, coarse), self.on_edge(slot, end + 1, coarse)],
                    fraction: f64::from(k % step) / f64::from(step),
                });
            }
        }
        hanging
    }
}
