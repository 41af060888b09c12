//! Sides of faces that are shut in solids.
//!
//! A world of blocks often has all six faces of every block, also between blocks that touch. Such a face sends its
//! light into the next block. That light never gets out and is never seen, but it may be much more than the light in
//! the rooms.
//!
//! Faces divide space into cells. Around an edge, the sides of consecutive faces bound the same cell. Two faces at one
//! place with opposite fronts are called a *pair*. Either both of their sides are inside solids, or neither is: a ray
//! that crosses the pair enters a solid and leaves one. So the cells on both sides of a pair count as one region. A
//! region is inside solids if it sees pairs and otherwise only backs. The air in a room sees fronts, and so does the
//! air around the blocks.

use std::f64::consts::TAU;

use glam::DVec3;

use super::{
    disjoint_sets::DisjointSets,
    edges::{Slot, same_edge, slots},
};
use crate::scene::Scene;

/// Faces at an edge whose planes differ by less than this angle, in radians, are at one place: coordinates may be
/// rounded.
const SAME_PLANE: f64 = 1e-4;

/// Whether the front and the back of each triangle are shut in solids; empty where none is.
pub(super) fn shut_in(scene: &Scene) -> Vec<[bool; 2]> {
    let slots = slots(scene);
    let edges: Vec<&[Slot]> = slots.chunk_by(same_edge).collect();
    // Solids that touch share edges of three faces or more.
    if edges.iter().all(|edge| edge.len() <= 2) {
        return Vec::new();
    }
    let paired = pairs(scene, &edges);
    if !paired.contains(&true) {
        return Vec::new();
    }
    let number = |t: usize, front: bool| 2 * t + usize::from(!front);
    let mut regions = DisjointSets::new(2 * paired.len());
    for edge in &edges {
        let faces = round(scene, edge);
        for (k, face) in faces.iter().enumerate() {
            let (next, once_round) = faces.get(k + 1).map_or((&faces[0], TAU), |next| (next, 0.0));
            if next.angle + once_round - face.angle > SAME_PLANE {
                let ahead = number(face.triangle, face.front_ahead);
                regions.unite(ahead, number(next.triangle, !next.front_ahead));
            } else {
                for ahead in [true, false] {
                    let side = |f: &Face| number(f.triangle, f.front_ahead == ahead);
                    regions.unite(side(face), side(next));
                }
            }
        }
    }
    for t in (0..paired.len()).filter(|&t| paired[t]) {
        regions.unite(number(t, true), number(t, false));
    }
    let (region, count) = regions.numbers();
    let (mut sees_fronts, mut sees_backs, mut sees_pairs) =
        (vec![false; count], vec![false; count], vec![false; count]);
    for t in 0..paired.len() {
        let [front, back] = [true, false].map(|front| region[number(t, front)] as usize);
        match paired[t] {
            true => sees_pairs[front] = true,
            false => (sees_fronts[front], sees_backs[back]) = (true, true),
        }
    }
    let is_solid = |r: u32| {
        let r = r as usize;
        sees_pairs[r] && sees_backs[r] && !sees_fronts[r]
    };
    let shut: Vec<[bool; 2]> =
        (0..paired.len()).map(|t| [true, false].map(|front| is_solid(region[number(t, front)]))).collect();
    if shut.iter().flatten().any(|&shut| shut) { shut } else { Vec::new() }
}

/// A face at an edge.
struct Face {
    triangle: usize,
    /// Rotation angle around the edge.
    angle: f64,
    /// Whether its front points towards greater angles.
    front_ahead: bool,
}

/// The faces at an edge, sorted by their angle around it. Faces at one place are consecutive.
fn round(scene: &Scene, edge: &[Slot]) -> Vec<Face> {
    let [from, to] = [edge[0].0, edge[0].1].map(|v| scene.vertices[v as usize]);
    let axis = (to - from).normalize_or_zero();
    let opposite = |slot: u32| {
        let corner = (slot as usize % 3 + 2) % 3;
        let away = scene.vertices[scene.triangles[slot as usize / 3].vertices[corner] as usize] - from;
        away - axis * away.dot(axis)
    };
    let start: DVec3 = opposite(edge[0].2).normalize_or_zero();
    let side = axis.cross(start);
    let mut faces: Vec<Face> = edge
        .iter()
        .map(|&(first, _, slot)| {
            let away = opposite(slot);
            let angle = away.dot(side).atan2(away.dot(start)).rem_euclid(TAU);
            // An angle rounded to just below zero is at one place with the first face.
            let angle = if angle > TAU - SAME_PLANE { 0.0 } else { angle };
            let vertices = scene.triangles[slot as usize / 3].vertices;
            Face { triangle: slot as usize / 3, angle, front_ahead: vertices[slot as usize % 3] == first }
        })
        .collect();
    faces.sort_by(|a, b| a.angle.total_cmp(&b.angle));
    faces
}

/// Whether each triangle has another one at the same place with the opposite front. Also finds pairs of triangles if a
/// rectangle is cut along different diagonals.
fn pairs(scene: &Scene, edges: &[&[Slot]]) -> Vec<bool> {
    let vertices = |t: usize| scene.triangles[t].vertices;
    let mut paired = vec![false; scene.triangles.len()];
    let mut triangles: Vec<([u32; 4], Vec<usize>)> = Vec::new();
    // Only faces with an edge of three faces or more touch others.
    let mut touches = vec![false; paired.len()];
    for edge in edges.iter().filter(|edge| edge.len() > 2) {
        edge.iter().for_each(|&(.., slot)| touches[slot as usize / 3] = true);
    }
    for t in (0..paired.len()).filter(|&t| touches[t]) {
        let [a, b, c] = sorted(vertices(t));
        triangles.push(([a, b, c, c], vec![t]));
    }
    mark(scene, triangles, &mut paired);
    let mut rectangles = Vec::new();
    for edge in edges {
        let &[(_, _, e), (_, _, f)] = *edge else { continue };
        let (t, u) = (e as usize / 3, f as usize / 3);
        let is_free = |t: usize| touches[t] && !paired[t];
        if is_free(t) && is_free(u) && scene.normal(t).dot(scene.normal(u)) > 1.0 - SAME_PLANE {
            let mut corners = [vertices(t), vertices(u)].concat();
            corners.sort_unstable();
            corners.dedup();
            if let Ok(corners) = corners.try_into() {
                rectangles.push((corners, vec![t, u]));
            }
        }
    }
    mark(scene, rectangles, &mut paired);
    paired
}

/// Marks faces that have the same corners as another face and the opposite front. Faces are lists of triangles with
/// their sorted corners.
fn mark(scene: &Scene, mut faces: Vec<([u32; 4], Vec<usize>)>, paired: &mut [bool]) {
    faces.sort_unstable();
    for pair in faces.windows(2) {
        let [one, other] = pair else { continue };
        let are_opposite = scene.normal(one.1[0]).dot(scene.normal(other.1[0])) < 0.0;
        if one.0 == other.0 && are_opposite {
            one.1.iter().chain(&other.1).for_each(|&t| paired[t] = true);
        }
    }
}

fn sorted(mut vertices: [u32; 3]) -> [u32; 3] {
    vertices.sort_unstable();
    vertices
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Material;

    /// A block of unit size with fronts outside, each face cut along one diagonal or the other.
    fn block(at: DVec3, other_diagonal: bool) -> Vec<([DVec3; 3], u32)> {
        let corner = |k: usize| at + DVec3::new((k & 1) as f64, (k >> 1 & 1) as f64, (k >> 2) as f64);
        let faces = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        let triangles = faces.map(|face| {
            let [a, b, c, d] = face.map(corner);
            if other_diagonal { [[b, c, d], [b, d, a]] } else { [[a, b, c], [a, c, d]] }
        });
        triangles.concat().into_iter().map(|triangle| (triangle, 0)).collect()
    }

    fn shut(triangles: &[([DVec3; 3], u32)]) -> Vec<[bool; 2]> {
        shut_in(&Scene::new(triangles, vec![Material::new("m", [0.5; 3], [0.0; 3])]))
    }

    /// Blocks around an empty place: a closed room.
    fn room(with_middle: bool, other_diagonal: impl Fn(usize) -> bool) -> Vec<([DVec3; 3], u32)> {
        let places = (0..27).map(|k| (k, DVec3::new((k % 3) as f64, (k / 3 % 3) as f64, (k / 9) as f64)));
        let kept = places.filter(|(k, _)| with_middle || *k != 13);
        kept.flat_map(|(k, at)| block(at, other_diagonal(k))).collect()
    }

    #[test]
    fn faces_between_blocks_are_shut_in_and_those_of_rooms_are_not() {
        for diagonals in [|_| false, |k: usize| k % 2 == 1] {
            let room = room(false, diagonals);
            let shut = shut(&room);
            // 54 squares outside and 6 round the room show their fronts; their backs are in the blocks.
            let fronts = shut.iter().filter(|[front, _]| !front).count();
            assert_eq!((fronts, shut.len()), (2 * 60, 26 * 12));
            assert!(shut.iter().all(|[_, back]| *back));
        }
    }

    #[test]
    fn a_block_among_blocks_has_nothing_to_be_seen() {
        let shut = shut(&room(true, |_| false));
        assert_eq!(shut.iter().filter(|[front, _]| !front).count(), 2 * 54);
        assert!(shut[13 * 12..14 * 12].iter().flatten().all(|&shut| shut));
    }

    #[test]
    fn sheets_of_two_faces_and_single_solids_shut_nothing_in() {
        assert!(shut(&block(DVec3::ZERO, false)).is_empty());
        let both = |triangle: &([DVec3; 3], u32)| {
            let ([a, b, c], m) = *triangle;
            [([a, b, c], m), ([a, c, b], m)]
        };
        // A closed box of such sheets, and two rooms with fronts inside that share such a wall.
        let sheets: Vec<_> = block(DVec3::ZERO, false).iter().flat_map(both).collect();
        assert!(shut(&sheets).is_empty());
        let rooms = [block(DVec3::ZERO, false), block(DVec3::X, false)].concat();
        let rooms: Vec<_> = rooms.into_iter().map(|([a, b, c], m)| ([a, c, b], m)).collect();
        assert!(shut(&rooms).is_empty());
    }
}
