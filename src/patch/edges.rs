//! Edges that triangles share, and numbers for the corners of patches.

use rayon::prelude::*;

use super::MAX_LEVEL;
use crate::scene::Scene;

/// Points have whole barycentric coordinates in units of 1/2^this.
pub(crate) const FINEST: u32 = MAX_LEVEL as u32;

/// The edges of a scene. Two triangles share an edge when both have its two vertices, whatever their winding or
/// material. Any number of triangles can share an edge.
#[derive(Debug)]
pub(crate) struct Edges {
    /// For edge `k` of triangle `t`, which runs from its corner `k` to the next, at `3 t + k`: its lowest such number.
    first: Vec<u32>,
}

impl Edges {
    pub(crate) fn new(scene: &Scene) -> Edges {
        let slots = slots(scene);
        let mut first = vec![0; slots.len()];
        for edge in slots.chunk_by(same_edge) {
            edge.iter().for_each(|&(.., slot)| first[slot as usize] = edge[0].2);
        }
        Edges { first }
    }

    /// The number of edge `k` of triangle `t`. All triangles that share the edge have the same number for it.
    pub(crate) fn of(&self, t: usize, k: usize) -> u32 {
        self.first[3 * t + k]
    }

    /// A number for a point of triangle `t`, given by whole barycentric coordinates that sum to 2^[`FINEST`]. All
    /// triangles that share the point's vertex or edge have the same number for it.
    pub(crate) fn point(&self, scene: &Scene, t: usize, p: [u32; 3]) -> u64 {
        let v = scene.triangles[t].vertices;
        if let Some(k) = (0..3).find(|&k| p[k] == 1 << FINEST) {
            return u64::from(v[k]);
        }
        match edge_of(p) {
            Some(k) => 1 << 62 | u64::from(self.of(t, k)) << FINEST | u64::from(from_lower_end(v, k, p)),
            None => 2 << 62 | (t as u64) << (2 * FINEST) | u64::from(p[0]) << FINEST | u64::from(p[1]),
        }
    }
}

/// A triangle's edge by its vertices, the lower first, and its number 3 t + k.
pub(crate) type Slot = (u32, u32, u32);

/// The edges of all triangles; edges with the same vertices are neighbours in the list.
pub(crate) fn slots(scene: &Scene) -> Vec<Slot> {
    let mut slots = Vec::with_capacity(3 * scene.triangles.len());
    for (t, triangle) in scene.triangles.iter().enumerate() {
        for k in 0..3 {
            let (a, b) = (triangle.vertices[k], triangle.vertices[(k + 1) % 3]);
            slots.push((a.min(b), a.max(b), (3 * t + k) as u32));
        }
    }
    slots.par_sort_unstable();
    slots
}

/// Whether two slots have the same vertices.
pub(crate) fn same_edge(e: &Slot, f: &Slot) -> bool {
    (e.0, e.1) == (f.0, f.1)
}

/// Which edge of its triangle a point that is no corner lies on, if any: `k` runs from corner `k` to the next.
pub(crate) fn edge_of(p: [u32; 3]) -> Option<usize> {
    (0..3).find(|&k| p[(k + 2) % 3] == 0)
}

/// How far a point on edge `k` is from the end with the lower index.
pub(crate) fn from_lower_end(vertices: [u32; 3], k: usize, p: [u32; 3]) -> u32 {
    if vertices[k] < vertices[(k + 1) % 3] { p[(k + 1) % 3] } else { p[k] }
}
