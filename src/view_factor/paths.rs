//! Paths between two polygons, sampled nearly in proportion to what they carry.

use std::{borrow::Cow, f64::consts::PI};

use glam::DVec3;

use super::polygon::Area;

/// Distance of the centres, in sums of radii, beyond which points are chosen evenly on both polygons. The kernel varies
/// little there. At smaller distances it may be singular and have an infinite variance.
const APART: f64 = 3.0;

/// A way of sampling paths. The mean weight of the paths is the exchange of the two polygons with nothing between them.
pub(super) enum Paths<'a> {
    /// Points distributed evenly on both.
    Apart(Cow<'a, Area>, Cow<'a, Area>),
    /// A point distributed evenly on the first, and from it a direction distributed evenly over the solid angle of the
    /// second. The weight is bounded.
    Near(Cow<'a, Area>, Cow<'a, Area>),
}

impl<'a> Paths<'a> {
    /// Paths between the parts of two polygons that are in front of each other.
    pub(super) fn between(p: Cow<'a, Area>, q: Cow<'a, Area>) -> Paths<'a> {
        let ball = |area: &Area| {
            let corners = area.corners();
            let centre = corners.iter().sum::<DVec3>() / corners.len() as f64;
            (centre, corners.iter().map(|v| v.distance(centre)).fold(0.0, f64::max))
        };
        let ((a, r), (b, s)) = (ball(&p), ball(&q));
        if a.distance(b) > APART * (r + s) {
            Paths::Apart(p, q)
        } else if p.area() <= q.area() {
            Paths::Near(p, q)
        } else {
            Paths::Near(q, p)
        }
    }

    /// Maps a point of the unit hypercube to the ends of a path and its weight.
    pub(super) fn path(&self, [x, y, u, v]: [f64; 4]) -> (DVec3, DVec3, f64) {
        match self {
            Paths::Apart(p, q) => {
                let (from, to) = (p.point(x, y), q.point(u, v));
                let path = to - from;
                let squared = path.length_squared();
                let cosines = path.dot(p.normal()).max(0.0) * (-path.dot(q.normal())).max(0.0);
                (from, to, p.area() * q.area() * cosines / (PI * squared * squared))
            }
            Paths::Near(p, q) => {
                let from = p.point(x, y);
                let Some((direction, angle)) = toward(from, q.corners(), u, v) else {
                    return (from, from, 0.0);
                };
                let descent = -direction.dot(q.normal());
                let height = (from - q.corners()[0]).dot(q.normal());
                let cosine = direction.dot(p.normal());
                if descent <= 0.0 || height <= 0.0 || cosine <= 0.0 {
                    return (from, from, 0.0);
                }
                (from, from + direction * (height / descent), p.area() * cosine * angle / PI)
            }
        }
    }
}

/// A direction from a point to a convex polygon, distributed evenly over its solid angle, and the solid angle.
fn toward(from: DVec3, corners: &[DVec3], u: f64, v: f64) -> Option<(DVec3, f64)> {
    let sight = |k: usize| (corners[k] - from).normalize_or_zero();
    let triangles = corners.len() - 2;
    let first = sight(0);
    let angle = |k: usize| solid_angle(first, sight(k + 1), sight(k + 2));
    let all: f64 = (0..triangles).map(angle).sum();
    let mut at = u * all;
    for k in 0..triangles {
        let angle = angle(k);
        if at < angle || k + 1 == triangles {
            let direction = in_triangle(first, sight(k + 1), sight(k + 2), angle, (at / angle).min(1.0), v);
            return direction.is_finite().then_some((direction, all));
        }
        at -= angle;
    }
    None
}

/// The solid angle of a triangle given by unit vectors (A. van Oosterom and J. Strackee, "The Solid Angle of a Plane
/// Triangle", IEEE Trans. Biomed. Eng. 30(2), 1983).
fn solid_angle(a: DVec3, b: DVec3, c: DVec3) -> f64 {
    2.0 * a.dot(b.cross(c)).abs().atan2(1.0 + a.dot(b) + b.dot(c) + c.dot(a))
}

/// A point of a spherical triangle with this area (J. Arvo, "Stratified Sampling of Spherical Triangles", SIGGRAPH 95).
fn in_triangle(a: DVec3, b: DVec3, c: DVec3, area: f64, u: f64, v: f64) -> DVec3 {
    let (to_b, to_c) = (a.cross(b), a.cross(c));
    let alpha = to_b.cross(to_c).length().atan2(to_b.dot(to_c));
    let (sine, cosine) = alpha.sin_cos();
    let (s, t) = (u * area - alpha).sin_cos();
    let (x, y) = (t - cosine, s + sine * a.dot(b));
    let q = (((y * t - x * s) * cosine - y) / ((y * s + x * t) * sine)).clamp(-1.0, 1.0);
    let side = |p: DVec3, axis: DVec3| (p - axis * p.dot(axis)).normalize_or_zero();
    let corner = a * q + side(c, a) * (1.0 - q * q).sqrt();
    let z = 1.0 - v * (1.0 - corner.dot(b));
    b * z + side(corner, b) * (1.0 - z * z).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use glam::dvec3;

    use super::*;
    use crate::form_factor::exact::exchange_area_to;

    /// The mean weight of a lattice of paths is the exchange, near and far. Near weights stay below their bound.
    #[test]
    fn weights_mean_what_is_exchanged() {
        let floor =
            vec![dvec3(0.0, 0.0, 0.0), dvec3(0.0, 3.0, 0.0), dvec3(-2.0, 3.0, 0.0), dvec3(-2.0, 0.0, 0.0)];
        for (wall, near) in [
            (vec![dvec3(0.0, 0.0, 0.0), dvec3(0.0, 0.0, 1.0), dvec3(0.0, 2.0, 1.5)], true),
            (vec![dvec3(0.0, 50.0, 0.0), dvec3(0.0, 50.0, 1.0), dvec3(0.0, 52.0, 1.5)], false),
        ] {
            let exact = exchange_area_to(&wall, &floor, 3.0, f64::EPSILON);
            let paths = Paths::between(
                Cow::Owned(Area::new(wall, -DVec3::X)),
                Cow::Owned(Area::new(floor.clone(), DVec3::Z)),
            );
            assert_eq!(matches!(paths, Paths::Near(..)), near);
            let n = 1 << 18;
            let (mut sum, mut most) = (0.0, 0f64);
            for k in 0..n {
                // A lattice given by the powers of the root of x⁵ = x + 1 (M. Roberts' R4 sequence).
                let g = 1.1673039782614187f64;
                let point = [1, 2, 3, 4].map(|d| (0.5 + f64::from(k) / g.powi(d)).fract());
                let (from, to, weight) = paths.path(point);
                if weight > 0.0 {
                    assert!(to.z.abs() < 1e-9 && from.x.abs() < 1e-9, "{from} {to}");
                }
                sum += weight;
                most = most.max(weight);
            }
            let mean = sum / f64::from(n);
            assert!((mean / exact - 1.0).abs() < 2e-3, "{mean}, not {exact}");
            assert!(!near || most <= 2.0 * 1.0, "a weight of {most}");
        }
    }
}
