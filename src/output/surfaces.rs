//! Which triangles make one smooth surface at an edge and round a vertex.
//!
//! Two triangles continue each other across an edge when nobody else has that edge, their windings agree, they are of
//! one material and their normals differ by less than the crease angle. An edge of three triangles is where surfaces
//! meet, a floor and the walls of two rooms on it, and light on one says nothing about the others.

use rayon::prelude::*;

use crate::{patch::Patches, scene::Scene};

/// No such edge, vertex or slot.
pub(super) const NONE: u32 = u32::MAX;

/// Triangles, their sides, and who continues whom.
///
/// A *slot* is a corner, or the edge that starts at it, of one side of one triangle: the front's are `3 t + k`, the
/// back's come after all fronts'.
pub(super) struct Surfaces {
    triangles: usize,
    /// For each slot, the slot of the same edge on the triangle that continues this one; [`NONE`] at a crease.
    across: Vec<u32>,
    /// For each slot, the lowest slot of the same surface at the same vertex.
    cluster: Vec<u32>,
}

impl Surfaces {
    /// Finds the smooth surfaces; `crease` in degrees.
    pub(super) fn new(scene: &Scene, patches: &Patches, crease: f64) -> Surfaces {
        let triangles = scene.triangles.len();
        let mut surfaces = Surfaces {
            triangles,
            across: vec![NONE; 6 * triangles],
            cluster: (0..6 * triangles as u32).collect(),
        };
        let back: Vec<bool> = (0..triangles).map(|t| has_side(patches, t, false)).collect();
        let same_material = |e: u32, f: u32| {
            let [t, u] = [e, f].map(|slot| scene.triangles[slot as usize / 3].material);
            t == u
        };
        for [e, f] in smooth_edges(scene, crease).into_iter().filter(|&[e, f]| same_material(e, f)) {
            surfaces.join(e, f);
            if back[e as usize / 3] && back[f as usize / 3] {
                surfaces.join(e + 3 * triangles as u32, f + 3 * triangles as u32);
            }
        }
        for slot in 0..surfaces.cluster.len() as u32 {
            surfaces.cluster[slot as usize] = surfaces.root(slot);
        }
        surfaces
    }

    /// The slot of corner, or edge, `k` of a side of triangle `t`.
    pub(super) fn slot(&self, t: usize, k: usize, front: bool) -> usize {
        3 * t + k + if front { 0 } else { 3 * self.triangles }
    }

    /// The triangle of a slot.
    pub(super) fn triangle(&self, slot: usize) -> usize {
        slot % (3 * self.triangles) / 3
    }

    /// The slot of the same edge on the triangle that continues this one.
    pub(super) fn across(&self, slot: usize) -> Option<usize> {
        (self.across[slot] != NONE).then(|| self.across[slot] as usize)
    }

    /// The lowest slot of the same surface at the same vertex.
    pub(super) fn cluster(&self, slot: usize) -> usize {
        self.cluster[slot] as usize
    }

    /// Number of slots.
    pub(super) fn slots(&self) -> usize {
        self.across.len()
    }

    fn join(&mut self, e: u32, f: u32) {
        (self.across[e as usize], self.across[f as usize]) = (f, e);
        // The windings agree: each edge starts where the other ends.
        self.unite(e, next(f));
        self.unite(next(e), f);
    }

    fn unite(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.cluster[a.max(b) as usize] = a.min(b);
    }

    fn root(&mut self, mut slot: u32) -> u32 {
        while self.cluster[slot as usize] != slot {
            let parent = self.cluster[slot as usize];
            self.cluster[slot as usize] = self.cluster[parent as usize];
            slot = self.cluster[slot as usize];
        }
        slot
    }
}

/// Whether a side of triangle `t` has patches.
pub(super) fn has_side(patches: &Patches, t: usize, front: bool) -> bool {
    patches.at(t as u32, [1.0, 0.0, 0.0], front).is_some()
}

/// The slot of the next corner of the same triangle.
fn next(slot: u32) -> u32 {
    if slot % 3 == 2 { slot - 2 } else { slot + 1 }
}

/// Pairs of front slots whose triangles continue each other across the edge, whatever their materials.
pub(crate) fn smooth_edges(scene: &Scene, crease: f64) -> Vec<[u32; 2]> {
    let mut edges: Vec<(u32, u32, u32)> = Vec::with_capacity(3 * scene.triangles.len());
    for (t, triangle) in scene.triangles.iter().enumerate() {
        for k in 0..3 {
            let (a, b) = (triangle.vertices[k], triangle.vertices[(k + 1) % 3]);
            edges.push((a.min(b), a.max(b), (3 * t + k) as u32));
        }
    }
    edges.par_sort_unstable();
    let normals: Vec<_> = (0..scene.triangles.len()).map(|t| scene.normal(t)).collect();
    let least_cosine = crease.to_radians().cos();
    edges
        .chunk_by(|e, f| (e.0, e.1) == (f.0, f.1))
        .filter_map(|group| {
            let &[(_, _, e), (_, _, f)] = group else { return None };
            let (t, u) = (e as usize / 3, f as usize / 3);
            let start = |slot: u32| scene.triangles[slot as usize / 3].vertices[slot as usize % 3];
            let smooth = start(e) != start(f) && normals[t].dot(normals[u]) > least_cosine;
            smooth.then_some([e, f])
        })
        .collect()
}
