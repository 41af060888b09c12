//! Finds the lines along which another surface touches or crosses a triangle.

use std::collections::HashMap;

use glam::{DVec3, Vec3A};
use obvhs::aabb::Aabb;
use rayon::prelude::*;

use crate::scene::{Scene, centre_and_extent, near::overlapping};

/// A straight line in a triangle's plane, along which another triangle meets it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Line {
    pub(super) triangle: u32,
    pub(super) ends: [DVec3; 2],
    /// Longest side of the other triangle.
    pub(super) size: f64,
    /// The other triangle, if all of it lies in the plane.
    pub(super) of: Option<u32>,
    /// If the line runs along an edge of the triangle, the corner at which this edge begins.
    pub(super) edge: Option<usize>,
}

impl Line {
    pub(super) fn length(&self) -> f64 {
        self.ends[0].distance(self.ends[1])
    }
}

/// A corner touches a plane if its distance is at most this share of the smaller triangle's longest side. The light
/// that passes through such a gap is about this share of the light that the triangle receives.
pub(super) const TOUCHING: f64 = 1e-3;
/// Ends of lines count as one point if their distance is at most this share of the size of the triangles that meet
/// there.
pub(super) const SAME: f64 = 1e-6;

/// Cosine of the largest angle between neighbours in one plane. Coordinates are rounded.
pub(super) const FLAT: f64 = 1.0 - 1e-6;

/// All lines that divide a flat surface, sorted by triangle. They run inside a triangle or along an edge that it shares
/// with another triangle of the same flat surface. Lines along other edges are left out, because they divide nothing.
pub(super) fn find(scene: &Scene) -> Vec<Line> {
    let (centre, half) = centre_and_extent(scene.vertices.iter().copied());
    let count = scene.triangles.len();
    let flat: Vec<Flat> = (0..count).into_par_iter().map(|t| Flat::of(scene, t)).collect();
    let boxes: Vec<Aabb> = flat.par_iter().map(|flat| flat.padded(centre, half)).collect();
    let search = Search { scene, flat };
    let found: Vec<Found> = overlapping(&boxes, |k, other, found| search.pair(k, other, found));
    let mut lines = search.of_surfaces(found);
    lines.sort_by_cached_key(|line| (line.triangle, line.ends.map(|p| p.to_array().map(f64::to_bits))));
    lines
}

/// A line. If all of the other triangle lies in the plane, the line is an edge of it: its index and the edge follow.
type Found = (Line, Option<(u32, usize)>);

/// A triangle with its plane.
struct Flat {
    corners: [DVec3; 3],
    normal: DVec3,
    longest: f64,
}

impl Flat {
    fn of(scene: &Scene, t: usize) -> Flat {
        let corners @ [a, b, c] = scene.corners(t);
        let longest = (b - a).length().max((c - b).length()).max((a - c).length());
        Flat { corners, normal: scene.normal(t), longest }
    }

    /// The box in unit space, padded by the tolerance of any pair in which the triangle is the smaller one.
    fn padded(&self, centre: DVec3, half: f64) -> Aabb {
        let [a, b, c] = self.corners.map(|p| ((p - centre) / half).as_vec3a());
        let padding = Vec3A::splat((TOUCHING * self.longest / half) as f32 + 4.0 * f32::EPSILON);
        Aabb::new(a.min(b).min(c) - padding, a.max(b).max(c) + padding)
    }

    /// Heights of the corners of another triangle above the plane. Heights within the tolerance become zero.
    fn heights(&self, other: &Flat, tolerance: f64) -> [f64; 3] {
        other.corners.map(|p| {
            let height = self.normal.dot(p - self.corners[0]);
            if height.abs() <= tolerance { 0.0 } else { height }
        })
    }

    /// Clips a line in the plane to the triangle, including its edges. Also returns the edge that the line runs along,
    /// if any.
    fn clip(&self, [p, q]: [DVec3; 2], same: f64) -> Option<([DVec3; 2], Option<usize>)> {
        let (mut from, mut to, mut edge) = (0.0, 1.0, None);
        let inward = |k: usize| {
            let (a, b) = (self.corners[k], self.corners[(k + 1) % 3]);
            (a, self.normal.cross((b - a).normalize_or_zero()))
        };
        for k in 0..3 {
            let (a, inward) = inward(k);
            let (d, e) = (inward.dot(p - a), inward.dot(q - a));
            if d.abs() <= same && e.abs() <= same {
                edge = Some(k);
                continue;
            }
            if d <= same && e <= same {
                return None;
            }
            let crossing = d / (d - e);
            if d < 0.0 {
                from = f64::max(from, crossing);
            } else if e < 0.0 {
                to = f64::min(to, crossing);
            }
        }
        let ends = [from, to].map(|x| p + (q - p) * x);
        let near_edge = |k: usize| {
            let (a, inward) = inward(k);
            ends.iter().all(|&end| inward.dot(end - a) <= same)
        };
        let is_inside = from < to && ends[0].distance(ends[1]) > same;
        (is_inside && (edge.is_some() || !(0..3).any(near_edge))).then_some((ends, edge))
    }
}

struct Search<'a> {
    scene: &'a Scene,
    flat: Vec<Flat>,
}

impl Search<'_> {
    /// Adds the lines at which two triangles meet, for each of the two.
    fn pair(&self, s: usize, t: usize, found: &mut Vec<Found>) {
        let corners = [s, t].map(|t| self.scene.triangles[t].vertices);
        let shared = corners[0].iter().filter(|v| corners[1].contains(v)).count();
        if shared > 1 {
            return;
        }
        let (a, b) = (&self.flat[s], &self.flat[t]);
        let tolerance = TOUCHING * a.longest.min(b.longest);
        let one_side =
            |heights: [f64; 3]| heights.iter().all(|&h| h > 0.0) || heights.iter().all(|&h| h < 0.0);
        let above = a.heights(b, tolerance);
        if one_side(above) {
            return;
        }
        let below = b.heights(a, tolerance);
        if one_side(below) {
            return;
        }
        let same = SAME * a.longest.min(b.longest);
        for ([of, t], on, other, heights) in [([t, s], a, b, above), ([s, t], b, a, below)] {
            let in_plane = heights == [0.0; 3];
            for (k, line) in lines(other, heights).into_iter().enumerate() {
                let Some(line) = line else { continue };
                let flattened = line.map(|p| p - on.normal * on.normal.dot(p - on.corners[0]));
                if let Some((ends, edge)) = on.clip(flattened, same) {
                    let in_plane = in_plane.then_some((of as u32, k));
                    let (triangle, size, of) = (t as u32, other.longest, in_plane.map(|(of, _)| of));
                    found.push((Line { triangle, ends, size, of, edge }, in_plane));
                }
            }
        }
    }

    /// Keeps the lines that divide a flat surface and belong to the outline of the other surface. Drops a line along an
    /// edge where the touched surface ends. Also drops a line that is an edge inside the other surface, such as a
    /// diagonal.
    fn of_surfaces(&self, found: Vec<Found>) -> Vec<Line> {
        let edge = |t: u32, k: usize| {
            let v = self.scene.triangles[t as usize].vertices;
            [v[k].min(v[(k + 1) % 3]), v[k].max(v[(k + 1) % 3])]
        };
        let along = |(line, _): &Found| line.edge.map(|k| (line.triangle, k));
        let asked = found.iter().flat_map(|found| [along(found), found.1]).flatten();
        let mut sharing: HashMap<[u32; 2], Vec<u32>> = asked.map(|(t, k)| (edge(t, k), Vec::new())).collect();
        if !sharing.is_empty() {
            for t in 0..self.scene.triangles.len() as u32 {
                for k in 0..3 {
                    sharing.entry(edge(t, k)).and_modify(|sharing| sharing.push(t));
                }
            }
        }
        let is_inner = |(of, k): (u32, usize)| {
            let normal = |t: u32| self.flat[t as usize].normal;
            sharing[&edge(of, k)].iter().any(|&t| t != of && normal(t).dot(normal(of)) > FLAT)
        };
        let is_wanted = |found: &Found| along(found).is_none_or(is_inner) && !found.1.is_some_and(is_inner);
        found.into_iter().filter(is_wanted).map(|(line, _)| line).collect()
    }
}

/// The lines of a triangle in the plane at height zero, from the heights of its corners: a line across the triangle,
/// one edge, or all three edges.
fn lines(of: &Flat, heights: [f64; 3]) -> [Option<[DVec3; 2]>; 3] {
    let corners = of.corners;
    let edge = |k: usize| Some([corners[k], corners[(k + 1) % 3]]);
    let zeros = heights.iter().filter(|&&h| h == 0.0).count();
    match zeros {
        3 => [edge(0), edge(1), edge(2)],
        2 => [edge((0..3).find(|&k| heights[(k + 2) % 3] != 0.0).unwrap_or(0)), None, None],
        _ => {
            let crossing = |k: usize| {
                let (h, i) = (heights[k], heights[(k + 1) % 3]);
                let at = corners[k] + (corners[(k + 1) % 3] - corners[k]) * (h / (h - i));
                (h * i < 0.0).then_some(at)
            };
            let touching = (0..3).filter(|&k| heights[k] == 0.0).map(|k| corners[k]);
            let mut points = (0..3).filter_map(crossing).chain(touching);
            match (points.next(), points.next()) {
                (Some(p), Some(q)) => [Some([p, q]), None, None],
                _ => [None; 3],
            }
        }
    }
}
