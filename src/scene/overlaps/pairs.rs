//! Finds triangles that overlap in one plane.

use glam::{DVec2, DVec3, Vec3, Vec3A};
use obvhs::aabb::Aabb;
use rayon::prelude::*;

use crate::scene::{Scene, centre_and_extent, cutting::Plane, longest_edge, near::overlapping};

/// Two triangles that overlap.
pub(super) struct Pair {
    pub(super) triangles: [u32; 2],
    /// Points closer than this count as one.
    pub(super) tolerance: f64,
}

/// Planes closer than this share of the longest side of the scene count as one. Files often pass through single
/// precision.
const SAME_PLANE: f64 = 1e-6;
/// Planes farther apart than this share of the smaller face count as two, even in a large scene. The light that passes
/// through such a gap is about this share of the light that the face receives.
const OF_FACE: f64 = 1e-3;
/// Planes closer than this share of the largest rounding error count as one. The rounding error of a coordinate of six
/// digits is at most half a unit of the sixth digit. But two faces in one plane perpendicular to an axis have equal
/// digits, so that a difference of a whole unit is a gap.
const OF_ROUNDING: f64 = 0.9;
/// Two triangles may lie in one plane if the cosine of the angle between their normals is at least this. Then the
/// heights decide.
const PARALLEL: f32 = 0.99;

/// Whether two triangles must face the same way.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Facing {
    Same,
    Any,
}

/// All pairs. Their order has no meaning. Of triangles with the same three corners in the same winding, only the first
/// is compared with others.
pub(super) fn find(scene: &Scene, facing: Facing) -> Vec<Pair> {
    let (centre, half) = centre_and_extent(scene.vertices.iter().copied());
    let search = Search { scene, facing, extent: 2.0 * half, normals: normals(scene) };
    let (kept, mut pairs) = search.distinct();
    let boxes: Vec<Aabb> = kept.par_iter().map(|&t| search.padded(t, centre, half)).collect();
    pairs.extend(overlapping(&boxes, |k, other, found| found.extend(search.pair(kept[k], kept[other]))));
    pairs
}

fn normals(scene: &Scene) -> Vec<Vec3> {
    (0..scene.triangles.len()).into_par_iter().map(|t| scene.normal(t).as_vec3()).collect()
}

struct Search<'a> {
    scene: &'a Scene,
    facing: Facing,
    /// Longest side of the bounding box of the scene.
    extent: f64,
    normals: Vec<Vec3>,
}

impl Search<'_> {
    /// Separates triangles that equal an earlier one, because building the hierarchy takes quadratic time if many boxes
    /// are equal. Returns the other triangles, and pairs of equal ones.
    fn distinct(&self) -> (Vec<u32>, Vec<Pair>) {
        let cycle = |t: u32| {
            let [a, b, c] = self.scene.triangles[t as usize].vertices;
            let least = a.min(b).min(c);
            if least == a {
                [a, b, c]
            } else if least == b {
                [b, c, a]
            } else {
                [c, a, b]
            }
        };
        let mut kept: Vec<u32> = (0..self.scene.triangles.len() as u32).collect();
        kept.par_sort_unstable_by_key(|&t| (cycle(t), t));
        let same = kept.chunk_by(|&s, &t| cycle(s) == cycle(t)).filter(|same| same.len() > 1);
        let pair = |s: u32, t: u32| Pair { triangles: [s, t], tolerance: self.own_tolerance(s) };
        let pairs = same.flat_map(|same| same[1..].iter().map(|&t| pair(same[0], t))).collect();
        kept.dedup_by_key(|t| cycle(*t));
        kept.par_sort_unstable();
        (kept, pairs)
    }

    fn longest(&self, t: u32) -> f64 {
        longest_edge(self.scene.corners(t as usize))
    }

    /// The tolerance between a triangle and its copy.
    fn own_tolerance(&self, t: u32) -> f64 {
        (SAME_PLANE * self.extent).min(OF_FACE * self.longest(t))
    }

    /// The box of a triangle in unit space, padded by the tolerance of any pair in which it is the smaller one.
    fn padded(&self, t: u32, centre: DVec3, half: f64) -> Aabb {
        let corners = self.scene.corners(t as usize);
        let largest = corners.iter().map(|p| p.abs().max_element()).fold(0.0, f64::max);
        let widest = (SAME_PLANE * self.extent).max(2.0 * 3f64.sqrt() * half_unit(largest));
        let padding = widest.min(OF_FACE * self.longest(t)) / half;
        let [a, b, c] = corners.map(|p| ((p - centre) / half).as_vec3a());
        let padding = Vec3A::splat(padding as f32 + 4.0 * f32::EPSILON);
        Aabb::new(a.min(b).min(c) - padding, a.max(b).max(c) + padding)
    }

    fn pair(&self, s: u32, t: u32) -> Option<Pair> {
        let (i, j) = (s as usize, t as usize);
        let cosine = self.normals[i].dot(self.normals[j]);
        if cosine.abs() < PARALLEL || (cosine < 0.0 && self.facing == Facing::Same) {
            return None;
        }
        let (a, b) = (self.scene.corners(i), self.scene.corners(j));
        let larger = if self.scene.area(i) >= self.scene.area(j) { a } else { b };
        let plane = Plane::of(larger);
        let [flat_a, flat_b] = [a, b].map(|corners| plane.counter_clockwise(corners));
        // A quick test for the common case: neighbours that share an edge and lie on different sides of it.
        let least = self.own_tolerance(s).min(self.own_tolerance(t));
        if separated(&flat_a, &flat_b, least) {
            return None;
        }
        let tolerance = self.tolerance(s, t, plane.normal);
        if separated(&flat_a, &flat_b, tolerance) {
            return None;
        }
        let (above, other) = (Height::of(a, &plane)?, Height::of(b, &plane)?);
        let across = plane.normal[plane.along].abs();
        let apart = |p: &DVec2| (above.at(*p) - other.at(*p)).abs() * across;
        let common = common(&flat_a, &flat_b);
        let one = !common.is_empty() && common.iter().all(|p| apart(p) < tolerance);
        one.then_some(Pair { triangles: [s, t], tolerance })
    }

    /// The largest distance at which the planes of two triangles count as one.
    fn tolerance(&self, s: u32, t: u32, normal: DVec3) -> f64 {
        let corners = || [s, t].into_iter().flat_map(|t| self.scene.corners(t as usize));
        let mut widest = SAME_PLANE * self.extent;
        if corners().all(|p| p.to_array().into_iter().all(has_six_digits)) {
            let largest = corners().fold(DVec3::ZERO, |most, p| most.max(p.abs()));
            let off: f64 = (0..3).map(|axis| normal[axis].abs() * 2.0 * half_unit(largest[axis])).sum();
            widest = widest.max(OF_ROUNDING * off);
        }
        widest.min(OF_FACE * self.longest(s).min(self.longest(t)))
    }
}

/// Half a unit of the sixth decimal digit of `x`.
fn half_unit(x: f64) -> f64 {
    if x > 0.0 { 0.5 * 10f64.powf(x.log10().floor() - 5.0) } else { 0.0 }
}

/// Whether a number has at most six decimal digits, up to the rounding of double precision.
fn has_six_digits(x: f64) -> bool {
    if x == 0.0 {
        return true;
    }
    let digits = x.abs() / (2.0 * half_unit(x.abs()));
    (digits - digits.round()).abs() <= 1e-8
}

/// Whether the line through an edge separates two triangles. An overlap of up to `width` does not count.
fn separated(a: &[DVec2; 3], b: &[DVec2; 3], width: f64) -> bool {
    let divides = |edges: &[DVec2; 3], other: &[DVec2; 3]| {
        (0..3).any(|k| {
            let (p, q) = (edges[k], edges[(k + 1) % 3]);
            let along = (q - p).normalize_or_zero();
            other.iter().all(|&r| along.perp_dot(r - p) <= width)
        })
    };
    divides(a, b) || divides(b, a)
}

/// The share of triangle `a` that triangle `b` covers. Both lie in one plane.
pub(crate) fn covered(a: [DVec3; 3], b: [DVec3; 3]) -> f64 {
    let plane = Plane::of(a);
    let [a, b] = [a, b].map(|corners| plane.counter_clockwise(corners));
    area(&common(&a, &b)) / area(&a)
}

/// The area of a convex counter-clockwise polygon.
fn area(polygon: &[DVec2]) -> f64 {
    let Some(&first) = polygon.first() else { return 0.0 };
    polygon.windows(2).map(|pair| 0.5 * (pair[0] - first).perp_dot(pair[1] - first)).sum()
}

/// The part that two counter-clockwise triangles have in common.
fn common(a: &[DVec2; 3], b: &[DVec2; 3]) -> Vec<DVec2> {
    let mut polygon = a.to_vec();
    for k in 0..3 {
        let (p, q) = (b[k], b[(k + 1) % 3]);
        let side = |r: DVec2| (q - p).perp_dot(r - p);
        let mut kept = Vec::with_capacity(polygon.len() + 1);
        for (i, &r) in polygon.iter().enumerate() {
            let next = polygon[(i + 1) % polygon.len()];
            let (d, e) = (side(r), side(next));
            if d >= 0.0 {
                kept.push(r);
            }
            if d * e < 0.0 {
                kept.push(r + (next - r) * (d / (d - e)));
            }
        }
        polygon = kept;
    }
    polygon
}

/// The height of a triangle's plane along the axis of a projection.
struct Height {
    corner: DVec2,
    height: f64,
    slope: DVec2,
}

impl Height {
    fn of(corners: [DVec3; 3], plane: &Plane) -> Option<Height> {
        let [a, b, c] = corners.map(|p| plane.flat(p));
        let [h, i, j] = corners.map(|p| p[plane.along]);
        let (e, f) = (b - a, c - a);
        let area = e.perp_dot(f);
        let slope = DVec2::new(f.y * (i - h) - e.y * (j - h), e.x * (j - h) - f.x * (i - h)) / area;
        slope.is_finite().then_some(Height { corner: a, height: h, slope })
    }

    fn at(&self, p: DVec2) -> f64 {
        self.height + self.slope.dot(p - self.corner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_six_digits_are_recognised() {
        for x in [0.0, 1.0, -3.0, 0.123456, 2.99999, 5004.12, 1.5e-7, 987654.0, 1e300] {
            assert!(has_six_digits(x), "{x}");
        }
        for x in [1.0 / 3.0, 2.999999, 1234567.0, std::f64::consts::PI] {
            assert!(!has_six_digits(x), "{x}");
        }
        assert!((half_unit(2.99999) - 0.5e-5).abs() < 1e-18);
    }
}
