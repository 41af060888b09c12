//! Convex polygons in unit space: their exchange with nothing between them, and points on them.

use glam::{DVec3, Vec3A};

use crate::{
    form_factor::{
        exact::{clip, exchange_area_to, nodes},
        kernel,
    },
    scene::centre_and_extent,
};

/// Largest distance of a corner from a polygon's plane, relative to the polygon's radius, because files round to six
/// digits.
const SKEW: f64 = 1e-5;

/// A corner this far below a plane, relative to the radius of the plane's polygon, still counts as on it.
const ON_PLANE: f64 = 1e-9;

/// Gauss-Legendre points in each direction, and the distance from which they suffice: from this polygon's centre to the
/// other polygon, in radii of this one. With them, exchange areas of squares and triangles in 20,000 random positions
/// had relative errors of at most [`FORMULA`] (test `products_are_as_precise_as_stated`).
const RULES: [(usize, f64); 3] = [(2, 40.0), (3, 12.0), (4, 6.0)];

/// Relative error of an exchange area with nothing between the polygons.
pub(super) const FORMULA: f64 = 1e-5;

/// Relative precision of exchange areas of polygons that are too near for [`RULES`].
const NEAR_PRECISION: f64 = 1e-6;
/// Number of radii from which points replace contour integrals for that precision.
const RADII: f64 = 2.0;

/// A convex polygon, or a piece of one.
pub(super) struct Polygon {
    /// The surface that it belongs to.
    pub(super) surface: u32,
    /// The given polygon that it is a piece of.
    pub(super) source: u32,
    /// Counterclockwise as seen from the front.
    pub(super) corners: Vec<DVec3>,
    pub(super) normal: DVec3,
    pub(super) area: f64,
    pub(super) centre: DVec3,
    pub(super) radius: f64,
    /// For each of the [`RULES`], points as offsets from the centre, with weights that sum to the area.
    nodes: [Vec<(Vec3A, f32)>; RULES.len()],
    /// The normal in single precision.
    facing: Vec3A,
    /// Its outline, for choosing points on it.
    pub(super) whole: Area,
}

impl Polygon {
    /// # Panics
    /// When the corners are not those of a convex planar polygon with an area.
    pub(super) fn new(corners: Vec<DVec3>, surface: u32, source: u32) -> Polygon {
        assert!(corners.len() >= 3, "a polygon has at least three corners");
        let polygon = Polygon::piece(corners, surface, source);
        assert!(polygon.area > 0.0, "a polygon has no area");
        let flat = polygon.corners.iter().all(|&p| polygon.height(p).abs() <= SKEW * polygon.radius);
        assert!(flat, "a polygon is not planar");
        assert!(is_convex(&polygon.corners, polygon.normal), "a polygon is not convex");
        polygon
    }

    /// A piece of a polygon. It must have an area.
    pub(super) fn piece(corners: Vec<DVec3>, surface: u32, source: u32) -> Polygon {
        let vector = area_vector(&corners);
        let area = vector.length();
        let normal = vector / area;
        let centre = corners.iter().sum::<DVec3>() / corners.len() as f64;
        let radius = corners.iter().map(|p| p.distance(centre)).fold(0.0, f64::max);
        let offsets =
            |n| nodes(&corners, n).iter().map(|&(p, w)| ((p - centre).as_vec3a(), w as f32)).collect();
        let nodes = RULES.map(|(n, _)| offsets(n));
        let whole = Area::new(corners.clone(), normal);
        let facing = normal.as_vec3a();
        Polygon { surface, source, corners, normal, area, centre, radius, nodes, facing, whole }
    }

    /// The height of a point above the polygon's plane.
    pub(super) fn height(&self, point: DVec3) -> f64 {
        (point - self.centre).dot(self.normal)
    }

    /// Depth below the plane at which a corner still counts as on it.
    fn slack(&self) -> f64 {
        (ON_PLANE * self.radius).max(8.0 * f64::EPSILON)
    }

    /// Whether the polygon lies wholly, and whether it lies partly, in front of another polygon's plane.
    pub(super) fn in_front(&self, of: &Polygon) -> (bool, bool) {
        let (slack, height) = (of.slack(), of.height(self.centre));
        if height > self.radius {
            return (true, true);
        }
        if height < -self.radius {
            return (false, false);
        }
        let heights = || self.corners.iter().map(|&p| of.height(p));
        (heights().all(|h| h >= -slack), heights().any(|h| h > slack))
    }

    /// The part of the polygon in front of another polygon's plane.
    pub(super) fn part_in_front(&self, of: &Polygon) -> Option<Vec<DVec3>> {
        clip(&self.corners, of.centre, of.normal, of.slack())
    }

    /// A_i F_ij if nothing is between the two, with the relative error [`FORMULA`]. `whole` states that both lie wholly
    /// in front of each other.
    pub(super) fn exchange(&self, other: &Polygon, whole: bool) -> f64 {
        let path = other.centre - self.centre;
        let distance = path.length();
        let rule = |of: &Polygon, to: &Polygon| {
            RULES.iter().position(|&(_, radii)| distance - to.radius >= radii * of.radius)
        };
        let (true, Some(ours), Some(theirs)) = (whole, rule(self, other), rule(other, self)) else {
            return exchange_near(&self.corners, &other.corners);
        };
        let path = path.as_vec3a();
        let from = |&(x, w): &(Vec3A, f32)| {
            let to = |&(y, v): &(Vec3A, f32)| v * kernel(path + (y - x), self.facing, other.facing);
            f64::from(w * other.nodes[theirs].iter().map(to).sum::<f32>())
        };
        self.nodes[ours].iter().map(from).sum()
    }
}

/// A_i F_ij of two polygons that may be near each other.
pub(super) fn exchange_near(p: &[DVec3], q: &[DVec3]) -> f64 {
    exchange_area_to(p, q, RADII, NEAR_PRECISION)
}

/// Half the sum of the cross products. Its length is the area, and it points to the front.
pub(super) fn area_vector(corners: &[DVec3]) -> DVec3 {
    let o = corners[0];
    0.5 * corners.windows(2).map(|e| (e[0] - o).cross(e[1] - o)).sum::<DVec3>()
}

fn is_convex(corners: &[DVec3], normal: DVec3) -> bool {
    let n = corners.len();
    (0..n).all(|k| {
        let (a, b, c) = (corners[k], corners[(k + 1) % n], corners[(k + 2) % n]);
        let (before, after) = (b - a, c - b);
        before.cross(after).dot(normal) >= -SKEW * before.length() * after.length()
    })
}

/// A convex outline on which points are chosen.
#[derive(Clone)]
pub(super) struct Area {
    corners: Vec<DVec3>,
    normal: DVec3,
    /// The area of the triangles from the first corner up to each.
    sums: Vec<f64>,
}

impl Area {
    pub(super) fn new(corners: Vec<DVec3>, normal: DVec3) -> Area {
        let mut sum = 0.0;
        let triangle = |k: usize| 0.5 * (corners[k - 1] - corners[0]).cross(corners[k] - corners[0]).length();
        let sums = (2..corners.len())
            .map(|k| {
                sum += triangle(k);
                sum
            })
            .collect();
        Area { corners, normal, sums }
    }

    pub(super) fn area(&self) -> f64 {
        self.sums[self.sums.len() - 1]
    }

    pub(super) fn normal(&self) -> DVec3 {
        self.normal
    }

    pub(super) fn corners(&self) -> &[DVec3] {
        &self.corners
    }

    /// A point inside: the mean of the corners.
    pub(super) fn middle(&self) -> DVec3 {
        self.corners.iter().sum::<DVec3>() / self.corners.len() as f64
    }

    /// Maps a point of the unit square to a point of the outline, uniformly by area.
    pub(super) fn point(&self, u: f64, v: f64) -> DVec3 {
        let at = u * self.area();
        let k = self.sums.partition_point(|&sum| sum <= at).min(self.sums.len() - 1);
        let before = if k == 0 { 0.0 } else { self.sums[k - 1] };
        let across = ((at - before) / (self.sums[k] - before)).clamp(0.0, 1.0).sqrt();
        let [o, a, b] = [self.corners[0], self.corners[k + 1], self.corners[k + 2]];
        o + (a + (b - a) * v - o) * across
    }
}

/// The polygons of surfaces and of obstacles, recentred and rescaled so that their largest coordinate is 1, and the
/// scale that was divided by.
pub(super) fn in_unit_space(
    surfaces: &[&[Vec<DVec3>]],
    obstacles: &[Vec<DVec3>],
) -> (Vec<Polygon>, Vec<Polygon>, f64) {
    let own = || (0..).zip(surfaces).flat_map(|(k, s)| s.iter().map(move |polygon| (k, polygon)));
    let all = || own().map(|(_, polygon)| polygon).chain(obstacles);
    let (centre, scale) = centre_and_extent(all().flatten().copied());
    let polygon = |(source, (surface, corners)): (u32, (u32, &Vec<DVec3>))| {
        Polygon::new(corners.iter().map(|&v| (v - centre) / scale).collect(), surface, source)
    };
    let polygons: Vec<Polygon> = (0..).zip(own()).map(polygon).collect();
    let others = (polygons.len() as u32..).zip(obstacles.iter().map(|corners| (u32::MAX, corners)));
    let hindrances = others.map(polygon).collect();
    (polygons, hindrances, scale)
}

/// A level square that faces up or down.
#[cfg(test)]
pub(super) fn level_square(side: f64, centre: DVec3, up: bool) -> Vec<DVec3> {
    let h = side / 2.0;
    let mut corners =
        vec![DVec3::new(-h, -h, 0.0), DVec3::new(h, -h, 0.0), DVec3::new(h, h, 0.0), DVec3::new(-h, h, 0.0)];
    if !up {
        corners.reverse();
    }
    corners.into_iter().map(|p| p + centre).collect()
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, dvec3};

    use super::*;
    use crate::trace::sampling::mix;

    /// Random squares and triangles that face each other, from nearly touching to a hundred sizes apart.
    #[test]
    fn products_are_as_precise_as_stated() {
        let random = |k: u64, i: u64| mix(&[k, i]) as f64 / 2f64.powi(64);
        let (mut worst, mut met) = (0f64, 0);
        for k in 0..4000 {
            let polygon = |i: u64, place: DVec3, size: f64| {
                let turn = DQuat::from_rotation_z(6.3 * random(k, i))
                    * DQuat::from_rotation_x(3.1 * random(k, i + 1));
                let corners = if k % 2 == 0 {
                    vec![
                        dvec3(-1.0, -1.0, 0.0),
                        dvec3(1.0, -1.0, 0.0),
                        dvec3(1.0, 1.0, 0.0),
                        dvec3(-1.0, 1.0, 0.0),
                    ]
                } else {
                    vec![dvec3(-1.0, -0.7, 0.0), dvec3(1.3, -0.4, 0.0), dvec3(-0.2, 1.1, 0.0)]
                };
                Polygon::new(corners.iter().map(|&p| place + turn * (p * size)).collect(), 0, 0)
            };
            let distance = 5.0 * 30f64.powf(random(k, 8));
            let p = polygon(0, DVec3::ZERO, 1.0);
            let q = polygon(2, dvec3(0.3, 0.4, 0.86) * distance, 0.3 + random(k, 9));
            if !(p.in_front(&q).0 && q.in_front(&p).0) {
                continue;
            }
            met += 1;
            let exact = exchange_area_to(&p.corners, &q.corners, 3.0, f64::EPSILON);
            worst = worst.max((p.exchange(&q, true) / exact - 1.0).abs());
        }
        assert!(met > 500, "{met} pairs");
        assert!(worst < FORMULA, "off by {worst:.1e}");
    }

    #[test]
    fn points_are_uniform_by_area() {
        let corners =
            vec![dvec3(0.0, 0.0, 0.0), dvec3(2.0, 0.0, 0.0), dvec3(2.0, 1.0, 0.0), dvec3(0.0, 3.0, 0.0)];
        let area = Area::new(corners, DVec3::Z);
        assert!((area.area() - 4.0).abs() < 1e-15);
        let n = 400;
        let at = |k: u32| (f64::from(k) + 0.5) / f64::from(n);
        let mean = (0..n * n).map(|k| area.point(at(k / n), at(k % n))).sum::<DVec3>() / f64::from(n * n);
        // The centroid of a rectangle of 2 x 1 with a triangle of 2 x 2 on it.
        let exact = (dvec3(1.0, 0.5, 0.0) + dvec3(2.0 / 3.0, 1.0 + 2.0 / 3.0, 0.0)) / 2.0;
        assert!(mean.distance(exact) < 1e-4, "{mean}");
    }
}
