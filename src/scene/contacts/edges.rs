//! New vertices on edges of triangles: at the ends of lines, and where long edges are halved.

use std::collections::HashMap;

use glam::DVec3;

use super::{
    find::{Line, SAME},
    grading::{Grading, Surface},
};
use crate::scene::{Scene, cutting::Chain};

/// A part of an edge is halved if it is longer than this factor times the desired size of the pieces next to it.
const LONG: f64 = 4.0;

/// New vertices on edges. The key is an edge, its lower vertex first. Each new vertex has its distance from that
/// vertex, and the list is sorted by distance.
#[derive(Default)]
pub(super) struct EdgeVertices(HashMap<[u32; 2], Vec<(f64, u32)>>);

impl EdgeVertices {
    /// Adds the ends of lines, if they lie on edges of their triangles.
    pub(super) fn end_lines(&mut self, scene: &mut Scene, surface: &Surface) {
        for line in &surface.lines {
            let vertices = scene.triangles[line.triangle as usize].vertices;
            for end in line.ends {
                for k in 0..3 {
                    self.add(scene, [vertices[k], vertices[(k + 1) % 3]], end, surface.same);
                }
            }
        }
    }

    /// Adds the ends of a line along an edge.
    pub(super) fn end_joint(&mut self, scene: &mut Scene, joint: &Line) {
        if let Some([a, b]) = ends(scene, joint) {
            for end in joint.ends {
                self.add(scene, [a, b], end, SAME * joint.size);
            }
        }
    }

    /// The parts of the edge that `joint` covers.
    pub(super) fn parts(&self, scene: &Scene, joint: &Line) -> Vec<[u32; 2]> {
        let Some([a, b]) = ends(scene, joint) else { return Vec::new() };
        let vertices: Vec<u32> = [a].into_iter().chain(self.between(a, b)).chain([b]).collect();
        let along = joint.ends[1] - joint.ends[0];
        let is_on = |v: &u32| {
            let at = along.normalize().dot(scene.vertices[*v as usize] - joint.ends[0]);
            (-2.0 * SAME * joint.size..=along.length() + 2.0 * SAME * joint.size).contains(&at)
        };
        let on = |pair: &[u32]| pair.iter().all(is_on).then(|| [pair[0].min(pair[1]), pair[0].max(pair[1])]);
        vertices.windows(2).filter_map(on).collect()
    }

    /// Adds a point to an edge if it lies on this edge and no vertex is there.
    fn add(&mut self, scene: &mut Scene, [a, b]: [u32; 2], point: DVec3, same: f64) {
        let ends = [a.min(b), a.max(b)];
        let [from, to] = ends.map(|v| scene.vertices[v as usize]);
        let length = from.distance(to);
        let along = (to - from) / length;
        let at = along.dot(point - from);
        let off = point.distance(from + along * at);
        if off > same || at <= same || at >= length - same {
            return;
        }
        let known = self.0.entry(ends).or_default();
        if known.iter().all(|(other, _)| (other - at).abs() > same) {
            scene.vertices.push(from + (to - from) * (at / length));
            let k = known.partition_point(|(other, _)| *other < at);
            known.insert(k, (at, scene.vertices.len() as u32 - 1));
        }
    }

    /// Halves the edges of a surface until no part is much longer than the desired size of the pieces next to it.
    pub(super) fn grade(&mut self, scene: &mut Scene, surface: &Surface, grading: &Grading) {
        let least = LONG * grading.least();
        for &t in &surface.triangles {
            let v = scene.triangles[t as usize].vertices;
            for k in 0..3 {
                let ends = [v[k].min(v[(k + 1) % 3]), v[k].max(v[(k + 1) % 3])];
                let [from, to] = ends.map(|v| scene.vertices[v as usize]);
                let length = from.distance(to);
                if length <= least {
                    continue;
                }
                let known = self.0.entry(ends).or_default();
                let mut i = 0;
                // Each step looks at the part of the edge before its vertex `i`.
                while i <= known.len() {
                    let start = if i == 0 { 0.0 } else { known[i - 1].0 };
                    let end = known.get(i).map_or(length, |(at, _)| *at);
                    let part = [start, end].map(|at| surface.plane.flat(from + (to - from) * (at / length)));
                    if end - start <= LONG * grading.size_along(part) {
                        i += 1;
                        continue;
                    }
                    let at = 0.5 * (start + end);
                    scene.vertices.push(from + (to - from) * (at / length));
                    known.insert(i, (at, scene.vertices.len() as u32 - 1));
                }
            }
        }
    }

    /// The vertices on the edge from one vertex to another, in this order.
    pub(super) fn between(&self, from: u32, to: u32) -> Vec<u32> {
        let known = self.0.get(&[from.min(to), from.max(to)]);
        let mut between: Vec<u32> = known.into_iter().flatten().map(|(_, v)| *v).collect();
        if from > to {
            between.reverse();
        }
        between
    }

    pub(super) fn into_chains(self) -> Vec<Chain> {
        let mut edges: Vec<_> = self.0.into_iter().filter(|(_, known)| !known.is_empty()).collect();
        edges.sort_unstable_by_key(|(ends, _)| *ends);
        let chain = |(ends, known): ([u32; 2], Vec<(f64, u32)>)| Chain {
            ends,
            between: known.into_iter().map(|(_, v)| v).collect(),
        };
        edges.into_iter().map(chain).collect()
    }
}

/// The vertices of the edge that a line runs along.
fn ends(scene: &Scene, joint: &Line) -> Option<[u32; 2]> {
    let vertices = scene.triangles[joint.triangle as usize].vertices;
    joint.edge.map(|k| [vertices[k], vertices[(k + 1) % 3]])
}
