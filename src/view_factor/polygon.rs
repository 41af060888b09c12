//! Triangles and parallelograms: their points, and where rays meet them.

use glam::{DVec3, Vec3A};

use crate::{
    form_factor::exact::nodes,
    scene::centre_and_extent,
    trace::{Tracer, sampling::square_to_triangle},
};

/// Points keep this share of a polygon's size from its edges: rounding would carry them through the adjoining wall.
const INSET: f32 = 1e-5;

/// What the corners of a quadrilateral may be off those of a parallelogram by, relative to its diagonal: files round.
const SKEW: f64 = 1e-5;

/// A polygon in unit space.
pub(super) struct Polygon {
    /// Which surface it is of.
    pub(super) surface: u32,
    pub(super) corners: Vec<DVec3>,
    /// The first corner, for rays to start from.
    origin: Vec3A,
    pub(super) edges: [Vec3A; 2],
    /// What gives a point of the plane in multiples of the edges.
    duals: [Vec3A; 2],
    normal: DVec3,
    /// The same, for rays.
    pub(super) facing: Vec3A,
    is_triangle: bool,
    pub(super) area: f64,
    pub(super) centre: DVec3,
    pub(super) radius: f64,
    /// Points with weights that sum to the area, four and nine of a parallelogram.
    pub(super) nodes: [Vec<(Vec3A, f32)>; 2],
}

impl Polygon {
    fn new(corners: Vec<DVec3>, surface: u32) -> Polygon {
        assert!(matches!(corners.len(), 3 | 4), "polygons are triangles or parallelograms");
        assert!(corners.len() == 3 || is_parallelogram(&corners), "a quadrilateral is no parallelogram");
        let [a, b] = [corners[1] - corners[0], corners[corners.len() - 1] - corners[0]];
        let double_area = a.cross(b);
        assert!(double_area.length() > 0.0, "a polygon has no area");
        let normal = double_area.normalize();
        let centre = corners.iter().sum::<DVec3>() / corners.len() as f64;
        Polygon {
            surface,
            // Off the surface once for the rounding of the origin, and once for that of what is added to it.
            origin: Tracer::leave(Tracer::leave(corners[0].as_vec3a(), normal.as_vec3a()), normal.as_vec3a()),
            edges: [a, b].map(|e| e.as_vec3a()),
            duals: [b.cross(normal), normal.cross(a)].map(|d| (d / double_area.length()).as_vec3a()),
            normal,
            facing: normal.as_vec3a(),
            is_triangle: corners.len() == 3,
            area: double_area.length() * if corners.len() == 3 { 0.5 } else { 1.0 },
            radius: corners.iter().map(|p| p.distance(centre)).fold(0.0, f64::max),
            centre,
            nodes: [2, 3]
                .map(|n| nodes(&corners, n).iter().map(|&(p, w)| (p.as_vec3a(), w as f32)).collect()),
            corners,
        }
    }

    pub(super) fn triangles(&self) -> impl Iterator<Item = [DVec3; 3]> + '_ {
        (2..self.corners.len()).map(|k| [self.corners[0], self.corners[k - 1], self.corners[k]])
    }

    #[inline]
    pub(super) fn point(&self, u: f32, v: f32) -> Vec3A {
        if self.is_triangle {
            let [_, b, c] = square_to_triangle(u, v);
            self.at(b, c)
        } else {
            self.at(u, v)
        }
    }

    /// The point at these multiples of the edges, a little off them.
    #[inline]
    fn at(&self, a: f32, b: f32) -> Vec3A {
        let middle = if self.is_triangle { 1.0 / 3.0 } else { 0.5 };
        let inset = |x: f32| INSET * middle + (1.0 - INSET) * x;
        self.origin + self.edges[0] * inset(a) + self.edges[1] * inset(b)
    }

    /// Where a ray meets its front.
    #[inline]
    pub(super) fn met(&self, from: Vec3A, direction: Vec3A) -> Option<Vec3A> {
        let start = from - self.origin;
        let (height, descent) = (start.dot(self.facing), -direction.dot(self.facing));
        if !(height > 0.0 && descent > 0.0) {
            return None;
        }
        let foot = start + direction * (height / descent);
        let (a, b) = (foot.dot(self.duals[0]), foot.dot(self.duals[1]));
        let most = if self.is_triangle { 1.0 - a } else { 1.0 };
        ((0.0..=1.0).contains(&a) && b >= 0.0 && b <= most).then(|| self.at(a, b))
    }

    /// Whether it is wholly, and whether it is partly, in front of another's plane.
    pub(super) fn in_front(&self, of: &Polygon) -> (bool, bool) {
        let slack = 1e-9 * of.radius;
        let height = |p: &DVec3| (*p - of.corners[0]).dot(of.normal);
        (self.corners.iter().all(|p| height(p) >= -slack), self.corners.iter().any(|p| height(p) > slack))
    }
}

/// Whether these corners are a parallelogram's, but for rounding.
fn is_parallelogram(corners: &[DVec3]) -> bool {
    matches!(*corners, [p, q, r, s] if (r - q - (s - p)).length() <= SKEW * (r - p).length())
}

/// The polygons recentred and rescaled so that their largest coordinate is 1, and how many of their lengths that is.
pub(super) fn in_unit_space(surfaces: &[impl AsRef<[Vec<DVec3>]>]) -> (Vec<Polygon>, f64) {
    let all = || (0..).zip(surfaces).flat_map(|(k, s)| s.as_ref().iter().map(move |polygon| (k, polygon)));
    let (centre, scale) = centre_and_extent(all().flat_map(|(_, polygon)| polygon).copied());
    let polygon = |(k, corners): (u32, &Vec<DVec3>)| {
        Polygon::new(corners.iter().map(|&v| (v - centre) / scale).collect(), k)
    };
    (all().map(polygon).collect(), scale)
}
