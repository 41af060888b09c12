//! Cuts one triangle along lines, and adds points where pieces would be slender.

use glam::{DVec2, DVec3};
use spade::{Point2, PositionInTriangulation, Triangulation, handles::VertexHandle};

use super::{
    edges::EdgeVertices,
    grading::{Grading, Surface, distance},
};
use crate::scene::{
    Scene,
    cutting::{Corner, Plane, UNNAMED, triangulate},
};

/// During triangulation, vertices on an edge are moved outward by up to this share of the edge. They are then corners
/// of the convex hull, in order, in spite of rounding.
const BOW: f64 = 1e-5;
/// Largest relative difference between the area of the pieces and the area of the triangle.
const ROUNDING: f64 = 1e-9;

/// Sine of 20 degrees. A triangle with a smaller angle gets more points.
const SLENDER: f64 = 0.34;

/// Whether a triangle has too small an angle. The smallest angle lies between the two longest sides.
fn is_slender(corners: [Point2<f64>; 3]) -> bool {
    let [a, b, c] = corners.map(|p| DVec2::new(p.x, p.y));
    let mut sides = [a.distance(b), b.distance(c), c.distance(a)];
    sides.sort_by(f64::total_cmp);
    (b - a).perp_dot(c - a) < SLENDER * sides[1] * sides[2]
}

/// The pieces of a triangle.
pub(super) struct Pieces {
    vertices: Vec<Vertex>,
    triangles: Vec<[usize; 3]>,
    /// Edges of pieces that are parts of lines.
    contacts: Vec<[usize; 2]>,
}

#[derive(Clone, Copy)]
enum Vertex {
    Known(u32),
    New(DVec3),
}

impl Pieces {
    /// Cuts triangle `k` of a surface. `None` if there is nothing to cut or if rounding makes the cut fail.
    pub(super) fn of(
        scene: &Scene,
        surface: &Surface,
        grading: &Grading,
        k: usize,
        edges: &EdgeVertices,
    ) -> Option<Pieces> {
        let t = surface.triangles[k];
        let mut sheet = Sheet::new(scene, surface.plane, t, edges);
        let lines = surface.lines_on(t);
        let ends: Vec<[usize; 2]> = lines
            .iter()
            .map(|line| line.ends.map(|end| sheet.point(surface.plane.flat(end), surface.same)))
            .collect();
        sheet.parts(&ends, surface.same);
        let more = sheet.points_of(grading);
        (sheet.points.len() + more.len() > 3).then(|| sheet.triangulate(more))?
    }

    /// Adds the new vertices to the scene. Returns the pieces, and the edges along lines.
    pub(super) fn number(self, scene: &mut Scene) -> (Vec<[u32; 3]>, Vec<[u32; 2]>) {
        let mut number = |vertex: Vertex| match vertex {
            Vertex::Known(v) => v,
            Vertex::New(position) => {
                scene.vertices.push(position);
                scene.vertices.len() as u32 - 1
            }
        };
        let names: Vec<u32> = self.vertices.into_iter().map(&mut number).collect();
        let edge = |ends: [usize; 2]| {
            let [a, b] = ends.map(|v| names[v]);
            [a.min(b), a.max(b)]
        };
        let triangles = self.triangles.into_iter().map(|corners| corners.map(|v| names[v])).collect();
        (triangles, self.contacts.into_iter().map(edge).collect())
    }
}

/// A triangle in its plane, with points in it.
struct Sheet {
    plane: Plane,
    corners: [DVec3; 3],
    /// The corners, then the vertices on edges, then others.
    points: Vec<DVec2>,
    known: Vec<u32>,
    /// Points on the edge from each corner to the next, in order, both corners included.
    on_edges: [Vec<usize>; 3],
    /// Lines, cut at all points on them.
    lines: Vec<[usize; 2]>,
}

impl Sheet {
    fn new(scene: &Scene, plane: Plane, t: u32, edges: &EdgeVertices) -> Sheet {
        let vertices = scene.triangles[t as usize].vertices;
        let mut known = vertices.to_vec();
        let on_edges = [0, 1, 2].map(|k| {
            let next = (k + 1) % 3;
            let start = known.len();
            known.extend(edges.between(vertices[k], vertices[next]));
            [k].into_iter().chain(start..known.len()).chain([next]).collect()
        });
        let points = known.iter().map(|&v| plane.flat(scene.vertices[v as usize])).collect();
        let corners = scene.corners(t as usize);
        Sheet { plane, corners, points, known, on_edges, lines: Vec::new() }
    }

    /// The index of the point at a place. Adds a point if there is none.
    fn point(&mut self, at: DVec2, same: f64) -> usize {
        let near = |k: &usize| self.points[*k].distance(at);
        let nearest = (0..self.points.len()).min_by(|k, l| near(k).total_cmp(&near(l)));
        // A place near an edge can deviate from its vertex by `same` along the edge and by `same` across it.
        if let Some(k) = nearest.filter(|k| near(k) <= 2.0 * same) {
            return k;
        }
        self.points.push(at);
        self.points.len() - 1
    }

    /// Cuts lines at the points that lie on them, and adds the parts to [`Sheet::lines`].
    fn parts(&mut self, lines: &[[usize; 2]], same: f64) {
        for &[from, to] in lines {
            let [p, q] = [from, to].map(|k| self.points[k]);
            let is_on = |&k: &usize| {
                let r = self.points[k];
                r != p && r != q && distance([p, q], r) <= same
            };
            let mut on: Vec<usize> = (0..self.points.len()).filter(is_on).collect();
            on.sort_by(|&k, &l| (self.points[k] - p).dot(q - p).total_cmp(&(self.points[l] - p).dot(q - p)));
            let mut start = from;
            for end in on.into_iter().chain([to]) {
                let along_edge =
                    self.on_edges.iter().any(|edge| edge.contains(&start) && edge.contains(&end));
                if start != end && !along_edge {
                    self.lines.push([start.min(end), start.max(end)]);
                }
                start = end;
            }
        }
        self.lines.sort_unstable();
        self.lines.dedup();
    }

    /// The points of a grading that keep their clearance from edges and lines. Points of the largest cells come first.
    fn points_of(&self, grading: &Grading) -> Vec<DVec2> {
        let corners = [0, 1, 2].map(|k| self.points[k]);
        let low = corners.iter().fold(f64::INFINITY, |x, p| x.min(p.x));
        let high = corners.iter().fold(f64::NEG_INFINITY, |x, p| x.max(p.x));
        let is_clear = |&(p, clearance): &(DVec2, f64)| {
            let inside = |k: usize| {
                let (a, b) = (corners[k], corners[(k + 1) % 3]);
                (b - a).normalize_or_zero().perp_dot(p - a) >= clearance
            };
            let clear = |ends: &[usize; 2]| distance(ends.map(|k| self.points[k]), p) >= clearance;
            (0..3).all(inside) && self.lines.iter().all(clear)
        };
        let mut clear: Vec<_> = grading.points(low, high).iter().copied().filter(is_clear).collect();
        clear.sort_by(|(_, c), (_, d)| d.total_cmp(c));
        clear.into_iter().map(|(p, _)| p).collect()
    }

    /// Triangulates. Adds each point of `more` if it lies in a slender triangle.
    fn triangulate(mut self, more: Vec<DVec2>) -> Option<Pieces> {
        let mut bowed = self.points.clone();
        for edge in &self.on_edges {
            let [a, b] = [edge[0], edge[edge.len() - 1]].map(|k| self.points[k]);
            for &k in &edge[1..edge.len() - 1] {
                let share = self.points[k].distance(a) / b.distance(a);
                bowed[k] -= (b - a).perp() * (4.0 * BOW * share * (1.0 - share));
            }
        }
        let all: Vec<usize> = (0..bowed.len()).collect();
        let mut cdt = triangulate(&bowed, &all, &self.lines);
        let none = [DVec2::INFINITY, DVec2::NEG_INFINITY];
        let [low, high] = bowed.iter().fold(none, |[low, high], &p| [low.min(p), high.max(p)]);
        for p in more {
            let at = (p - low) / (high - low).max_element();
            let at = Point2::new(at.x, at.y);
            if let PositionInTriangulation::OnFace(face) = cdt.locate(at)
                && is_slender(cdt.face(face).positions())
            {
                self.points.push(p);
                cdt.insert(Corner { at, vertex: self.points.len() - 1 }).ok()?;
            }
        }
        // The triangulation has made vertices where lines cross. They have no name yet.
        let mut names = vec![UNNAMED; cdt.num_vertices()];
        for v in cdt.vertices() {
            names[v.fix().index()] = match v.data().vertex {
                UNNAMED => {
                    self.points
                        .push(low + DVec2::new(v.position().x, v.position().y) * (high - low).max_element());
                    self.points.len() - 1
                }
                known => known,
            };
        }
        let name = |v: VertexHandle<'_, Corner, (), _, ()>| names[v.fix().index()];
        let triangles: Vec<[usize; 3]> = cdt.inner_faces().map(|face| face.vertices().map(name)).collect();
        let contacts = cdt
            .undirected_edges()
            .filter(|edge| edge.is_constraint_edge())
            .map(|edge| edge.vertices().map(name))
            .collect();
        self.is_whole(&triangles).then(|| {
            let known = self.known.iter().map(|&v| Vertex::Known(v));
            let new = self.points[self.known.len()..].iter().map(|&p| Vertex::New(self.lift(p)));
            Pieces { vertices: known.chain(new).collect(), triangles, contacts }
        })
    }

    /// Whether `triangles` cover this triangle exactly, and none of them has all its corners on one edge.
    fn is_whole(&self, triangles: &[[usize; 3]]) -> bool {
        let area = |corners: [usize; 3]| {
            let [a, b, c] = corners.map(|k| self.points[k]);
            0.5 * (b - a).perp_dot(c - a)
        };
        let whole = area([0, 1, 2]);
        let sum: f64 = triangles.iter().map(|&corners| area(corners)).sum();
        (sum - whole).abs() <= ROUNDING * whole
            && triangles.iter().all(|&corners| area(corners) > 0.0)
            && triangles.iter().all(|corners| {
                !self.on_edges.iter().any(|edge| corners.iter().all(|corner| edge.contains(corner)))
            })
    }

    /// The point of the triangle in space at `p`, a point in its plane.
    fn lift(&self, p: DVec2) -> DVec3 {
        let [a, b, c] = self.corners.map(|corner| self.plane.flat(corner));
        let weights = [(b - p).perp_dot(c - p), (c - p).perp_dot(a - p), (a - p).perp_dot(b - p)];
        let heights = self.corners.map(|corner| corner[self.plane.along]);
        let sum: f64 = weights.iter().sum();
        let height: f64 = (0..3).map(|k| heights[k] * (weights[k] / sum)).sum();
        let [low, high] = [
            heights.iter().copied().fold(f64::INFINITY, f64::min),
            heights.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        ];
        let mut at = DVec3::ZERO;
        (at[self.plane.axes[0]], at[self.plane.axes[1]]) = (p.x, p.y);
        // If the plane is perpendicular to an axis, this keeps the height exact.
        at[self.plane.along] = height.clamp(low, high);
        at
    }
}
