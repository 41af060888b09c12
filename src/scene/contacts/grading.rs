//! The desired size of pieces around contacts. Next to a contact, it follows from the size of the contact. Farther
//! away, it equals the distance from the contact.
//!
//! A triangulation of lines and corners alone would have slivers, such as from the corners of a room to the corners of
//! the ground around it. A patch is as slender as its triangle. So edges are halved, and points are added in between:
//! at the centres of a quadtree whose cells grow with the distance (Bern, Eppstein and Gilbert, "Provably Good Mesh
//! Generation", J. Comput. Syst. Sci. 48, 1994). The number of points grows with the logarithm of the ratio of sizes.

use std::collections::HashMap;

use glam::{DVec2, DVec3};

use super::find::{Line, SAME};
use crate::scene::{Scene, cutting::Plane, overlaps};

/// A flat surface with contacts: triangles of one material that share edges and lie in one plane.
pub(super) struct Surface {
    pub(super) triangles: Vec<u32>,
    /// The lines on these triangles, in the order of the triangles.
    pub(super) lines: Vec<Line>,
    pub(super) plane: Plane,
    /// Points closer than this count as one.
    pub(super) same: f64,
}

impl Surface {
    /// The lines on triangle `t` of the surface.
    pub(super) fn lines_on(&self, t: u32) -> &[Line] {
        let first = self.lines.partition_point(|line| line.triangle < t);
        let of_it = self.lines[first..].partition_point(|line| line.triangle == t);
        &self.lines[first..first + of_it]
    }
}

/// The surfaces with at least one line.
pub(super) fn surfaces(scene: &Scene, lines: Vec<Line>) -> Vec<Surface> {
    if lines.is_empty() {
        return Vec::new();
    }
    let of = overlaps::surfaces(scene);
    let mut known: HashMap<u32, usize> = HashMap::new();
    let mut surfaces: Vec<Surface> = Vec::new();
    for line in lines {
        let k = *known.entry(of[line.triangle as usize]).or_insert_with(|| {
            let plane = Plane::of(scene.corners(line.triangle as usize));
            surfaces.push(Surface { triangles: Vec::new(), lines: Vec::new(), plane, same: f64::INFINITY });
            surfaces.len() - 1
        });
        surfaces[k].same = surfaces[k].same.min(SAME * line.size);
        surfaces[k].lines.push(line);
    }
    for t in 0..of.len() {
        if let Some(&k) = known.get(&of[t]) {
            surfaces[k].triangles.push(t as u32);
        }
    }
    surfaces
}

/// Largest number of points that are added to one surface.
const MOST_POINTS: usize = 20_000;
/// An object on a surface meets it along an outline. The desired size of pieces next to a line is this share of the
/// extent of its outline, or the length of the line if this is larger. Four pieces a side are well shaped.
const OF_OUTLINE: f64 = 0.25;

/// The desired size of pieces at each place of a surface.
pub(super) struct Grading {
    lines: Vec<Flat>,
    /// Points to add, each with its clearance: its least distance from edges and lines. Sorted by the first coordinate.
    points: Vec<(DVec2, f64)>,
}

/// A line in the plane of its surface, and the desired size of pieces next to it.
#[derive(Clone, Copy)]
struct Flat {
    ends: [DVec2; 2],
    size: f64,
}

impl Flat {
    fn size_at(&self, p: DVec2) -> f64 {
        distance(self.ends, p).max(self.size)
    }
}

impl Grading {
    pub(super) fn new(scene: &Scene, surface: &Surface) -> Grading {
        let flat = |p: DVec3| surface.plane.flat(p);
        let extents = extents(surface);
        let lines = surface.lines.iter().zip(extents).map(|(line, extent)| Flat {
            ends: line.ends.map(flat),
            size: line.length().max(OF_OUTLINE * extent),
        });
        let mut grading = Grading { lines: lines.collect(), points: Vec::new() };
        let corners = surface.triangles.iter().flat_map(|&t| scene.corners(t as usize)).map(flat);
        let none = [DVec2::INFINITY, DVec2::NEG_INFINITY];
        let [low, high] = corners.fold(none, |[low, high], p| [low.min(p), high.max(p)]);
        let half = 0.5 * (high - low).max_element();
        let mut points = Vec::new();
        grading.fill(0.5 * (low + high), half, &grading.lines, &mut points);
        points.sort_by(|(p, _), (q, _)| p.x.total_cmp(&q.x).then(p.y.total_cmp(&q.y)));
        grading.points = points;
        grading
    }

    /// Splits a cell until its parts are small enough, and adds the centres of the parts. `near` are the lines that can
    /// determine the desired size inside the cell.
    fn fill(&self, centre: DVec2, half: f64, near: &[Flat], points: &mut Vec<(DVec2, f64)>) {
        if points.len() >= MOST_POINTS {
            return;
        }
        let sizes: Vec<f64> = near.iter().map(|line| line.size_at(centre)).collect();
        let size = sizes.iter().copied().fold(f64::INFINITY, f64::min);
        if 2.0 * half <= size {
            return points.push((centre, CLEARANCE * 2.0 * half));
        }
        let reach = 2.0 * 2f64.sqrt() * half;
        let near: Vec<Flat> =
            near.iter().zip(sizes).filter(|(_, s)| *s <= size + reach).map(|(line, _)| *line).collect();
        for (x, y) in [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)] {
            self.fill(centre + half * DVec2::new(x, y), 0.5 * half, &near, points);
        }
    }

    /// The points whose first coordinate is in a range, with their clearances.
    pub(super) fn points(&self, from: f64, to: f64) -> &[(DVec2, f64)] {
        let first = self.points.partition_point(|(p, _)| p.x < from);
        let rest = &self.points[first..];
        &rest[..rest.partition_point(|(p, _)| p.x <= to)]
    }

    /// The smallest desired size on the surface.
    pub(super) fn least(&self) -> f64 {
        self.lines.iter().map(|line| line.size).fold(f64::INFINITY, f64::min)
    }

    /// The smallest desired size along an edge.
    pub(super) fn size_along(&self, edge: [DVec2; 2]) -> f64 {
        self.lines.iter().map(|line| between(line.ends, edge).max(line.size)).fold(f64::INFINITY, f64::min)
    }
}

/// The clearance of a point, as a share of the side of its cell.
const CLEARANCE: f64 = 0.3;

/// For each line of a surface, the extent of its outline. An outline consists of lines that are joined at their ends.
fn extents(surface: &Surface) -> Vec<f64> {
    let mut first: Vec<usize> = (0..surface.lines.len()).collect();
    fn root(first: &mut [usize], mut k: usize) -> usize {
        while first[k] != k {
            first[k] = first[first[k]];
            k = first[k];
        }
        k
    }
    // Points that count as one lie in the same cell or in neighbouring cells.
    let side = 2.0 * surface.same;
    let mut cells: HashMap<[i64; 3], Vec<(DVec3, usize)>> = HashMap::new();
    for (k, line) in surface.lines.iter().enumerate() {
        for end in line.ends {
            let cell = (end / side).floor().to_array().map(|x| x as i64);
            for near in 0..27 {
                let at: [i64; 3] = std::array::from_fn(|i| cell[i] + near / 3i64.pow(i as u32) % 3 - 1);
                for &(other, j) in cells.get(&at).into_iter().flatten() {
                    if other.distance(end) <= surface.same {
                        let (i, j) = (root(&mut first, k), root(&mut first, j));
                        first[i.max(j)] = i.min(j);
                    }
                }
            }
            cells.entry(cell).or_default().push((end, k));
        }
    }
    let mut bounds = vec![[DVec3::INFINITY, DVec3::NEG_INFINITY]; first.len()];
    let roots: Vec<usize> = (0..first.len()).map(|k| root(&mut first, k)).collect();
    for (line, &k) in surface.lines.iter().zip(&roots) {
        for end in line.ends {
            bounds[k] = [bounds[k][0].min(end), bounds[k][1].max(end)];
        }
    }
    roots.iter().map(|&k| bounds[k][0].distance(bounds[k][1])).collect()
}

/// The distance of a point from a line.
pub(super) fn distance([a, b]: [DVec2; 2], p: DVec2) -> f64 {
    let along = b - a;
    let share = ((p - a).dot(along) / along.length_squared()).clamp(0.0, 1.0);
    // The share is NaN for a line without length.
    let share = if share.is_nan() { 0.0 } else { share };
    p.distance(a + along * share)
}

/// The distance between two lines.
fn between(a: [DVec2; 2], b: [DVec2; 2]) -> f64 {
    let side = |[p, q]: [DVec2; 2], r: DVec2| (q - p).perp_dot(r - p);
    if side(a, b[0]) * side(a, b[1]) < 0.0 && side(b, a[0]) * side(b, a[1]) < 0.0 {
        return 0.0;
    }
    distance(a, b[0]).min(distance(a, b[1])).min(distance(b, a[0])).min(distance(b, a[1]))
}
