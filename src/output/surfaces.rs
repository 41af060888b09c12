//! Smooth surfaces: the triangles that belong together at an edge and around a vertex.
//!
//! Two triangles continue each other across an edge if no third triangle has that edge, their windings agree, they have
//! the same material, and their normals differ by less than the crease angle. At an edge of three triangles several
//! surfaces meet, for example a floor and a wall with a room on each side. Their light is independent. Triangles within
//! solids do not count: the floor of a world of blocks is smooth. If the file has normals, these decide instead of the
//! crease angle.

use glam::Vec3;

use crate::{
    patch::{
        DisjointSets, Patches,
        edges::{Slot, same_edge, slots},
        within_solids,
    },
    scene::Scene,
};

/// Edges with a larger angle, in degrees, are creases even if the file has the same normal on both sides, because tools
/// also average the normals at the corners of rooms. A column of six sides is still round.
const ROUNDEST: f64 = 61.0;
/// Normals of a file are considered equal if the cosine of their angle exceeds this, because files round them to few
/// digits.
const SAME_NORMAL: f32 = 0.9998;

/// Marks a missing edge, vertex or slot.
pub(super) const NONE: u32 = u32::MAX;

/// The sides of all triangles and their continuations across edges.
///
/// A *slot* is a corner of one side of a triangle, or the edge that starts at this corner. Slots of fronts have the
/// numbers `3 t + k`. Slots of backs follow after all fronts.
pub(super) struct Surfaces {
    triangles: usize,
    /// For each slot, the slot of the same edge on the triangle that continues this one; [`NONE`] at a crease.
    across: Vec<u32>,
    /// For each slot, the lowest slot of the same surface at the same vertex.
    cluster: Vec<u32>,
}

impl Surfaces {
    /// Finds the smooth surfaces. `crease` is the crease angle in degrees for edges without normals in the file.
    pub(super) fn new(scene: &Scene, patches: &Patches, crease: f64) -> Surfaces {
        let triangles = scene.triangles.len();
        let (mut across, mut clusters) = (vec![NONE; 6 * triangles], DisjointSets::new(6 * triangles));
        let mut join = |e: u32, f: u32| {
            (across[e as usize], across[f as usize]) = (f, e);
            // The windings agree: each edge starts where the other ends.
            clusters.unite(e as usize, next(f) as usize);
            clusters.unite(next(e) as usize, f as usize);
        };
        let back: Vec<bool> = (0..triangles).map(|t| has_side(patches, t, false)).collect();
        let same_material = |e: u32, f: u32| {
            let [t, u] = [e, f].map(|slot| scene.triangles[slot as usize / 3].material);
            t == u
        };
        for [e, f] in shaded_edges(scene, crease).into_iter().filter(|&[e, f]| same_material(e, f)) {
            join(e, f);
            if back[e as usize / 3] && back[f as usize / 3] {
                join(e + 3 * triangles as u32, f + 3 * triangles as u32);
            }
        }
        let cluster = (0..6 * triangles).map(|slot| clusters.root(slot) as u32).collect();
        Surfaces { triangles, across, cluster }
    }

    /// The slot of corner `k`, or edge `k`, of a side of triangle `t`.
    pub(super) fn slot(&self, t: usize, k: usize, front: bool) -> usize {
        3 * t + k + if front { 0 } else { 3 * self.triangles }
    }

    /// The triangle of a slot.
    pub(super) fn triangle(&self, slot: usize) -> usize {
        slot % (3 * self.triangles) / 3
    }

    /// The slot of the same edge on the triangle that continues this one; `None` at a crease.
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
}

/// Whether a side of triangle `t` has patches.
pub(super) fn has_side(patches: &Patches, t: usize, front: bool) -> bool {
    patches.at(t as u32, [1.0, 0.0, 0.0], front).is_some()
}

/// The slot of the next corner of the same triangle.
fn next(slot: u32) -> u32 {
    if slot % 3 == 2 { slot - 2 } else { slot + 1 }
}

/// Pairs of front slots whose triangles continue each other across the edge. Their materials may differ.
pub(crate) fn smooth_edges(scene: &Scene, crease: f64) -> Vec<[u32; 2]> {
    edges_within(scene, crease, |_| true)
}

/// The same as [`smooth_edges`], but normals of the file take precedence: an edge is smooth if both triangles have the
/// same normals at its ends, and a crease if their normals differ.
fn shaded_edges(scene: &Scene, crease: f64) -> Vec<[u32; 2]> {
    if scene.normals.is_empty() {
        return smooth_edges(scene, crease);
    }
    let normals = |slot: u32| {
        let ends = [slot, next(slot)];
        ends.map(|slot| Vec3::from(scene.normals[slot as usize / 3][slot as usize % 3]).normalize_or_zero())
    };
    let mut edges = edges_within(scene, ROUNDEST, |[e, f]| {
        // The edge has the opposite direction on the other triangle.
        let ([a, b], [c, d]) = (normals(e), normals(f));
        a.dot(d) > SAME_NORMAL && b.dot(c) > SAME_NORMAL
    });
    edges.extend(edges_within(scene, crease, |[e, f]| {
        [e, f].map(normals).as_flattened().contains(&Vec3::ZERO)
    }));
    edges
}

/// Pairs of front slots whose triangles continue each other across the edge at less than the given angle in degrees,
/// and for which `counts` is true.
fn edges_within(scene: &Scene, angle: f64, counts: impl Fn([u32; 2]) -> bool) -> Vec<[u32; 2]> {
    let normals: Vec<_> = (0..scene.triangles.len()).map(|t| scene.normal(t)).collect();
    let least_cosine = angle.to_radians().cos();
    let slots = slots(scene);
    let edges: Vec<&[Slot]> = slots.chunk_by(same_edge).collect();
    // Without edges of more than two triangles nothing is within solids.
    let within = match edges.iter().any(|edge| edge.len() > 2) {
        true => within_solids(scene),
        false => vec![false; scene.triangles.len()],
    };
    edges
        .into_iter()
        .filter_map(|group| {
            let open: Vec<&Slot> = group.iter().filter(|(_, _, slot)| !within[*slot as usize / 3]).collect();
            let &[&(_, _, e), &(_, _, f)] = &open[..] else { return None };
            let (t, u) = (e as usize / 3, f as usize / 3);
            let start = |slot: u32| scene.triangles[slot as usize / 3].vertices[slot as usize % 3];
            let smooth = start(e) != start(f) && normals[t].dot(normals[u]) > least_cosine;
            (smooth && counts([e, f])).then_some([e, f])
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Material;
    use glam::{DVec3, dvec3};

    /// Whether the common edge of two triangles is smooth. `angle` is the angle between them in degrees, and `normals`
    /// are the normals at all corners of each.
    fn is_smooth(angle: f64, normals: Option<[[f32; 3]; 2]>) -> bool {
        let (sine, cosine) = angle.to_radians().sin_cos();
        let triangles =
            [([DVec3::ZERO, DVec3::X, DVec3::Y], 0), ([DVec3::ZERO, DVec3::Y, dvec3(-cosine, 0.0, sine)], 0)];
        let mut scene = Scene::new(&triangles, vec![Material::new("m", [0.5; 3], [0.0; 3])]);
        scene.normals = normals.map_or(Vec::new(), |both| both.map(|normal| [normal; 3]).to_vec());
        shaded_edges(&scene, 30.0).len() == 1
    }

    #[test]
    fn normals_of_the_file_decide_what_is_smooth() {
        let (up, side, between, none) = ([0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.4, 0.0, 2.0], [0.0; 3]);
        assert_eq!([20.0, 40.0].map(|angle| is_smooth(angle, None)), [true, false]);
        assert_eq!([20.0, 40.0].map(|angle| is_smooth(angle, Some([between; 2]))), [true; 2]);
        assert_eq!([20.0, 40.0].map(|angle| is_smooth(angle, Some([up, side]))), [false; 2]);
        assert_eq!([20.0, 40.0].map(|angle| is_smooth(angle, Some([up, none]))), [true, false]);
        // The corner of a room stays a crease, even if a tool has averaged its normals.
        assert!(!is_smooth(90.0, Some([between; 2])));
    }
}
