//! Form factors to and between convex polygons in any position.

use std::f64::consts::PI;

use glam::DVec3;

use super::{contour, cubature};

/// A polygon at least this many of its radii away counts as small and is integrated by points. At this distance the
/// closed forms have lost about one digit, and 12 points per side are needed.
const FAR: f64 = 3.0;

fn assert_polygon(polygon: &[DVec3]) {
    assert!(polygon.len() >= 3, "a polygon needs 3 vertices, not {}", polygon.len());
    assert!(polygon.iter().all(|v| v.is_finite()), "vertices must be finite");
}

/// The largest power of two not above a length. Dividing by it changes no digit, so a small polygon far from the origin
/// keeps its shape.
fn power_of_two_below(length: f64) -> f64 {
    length.log2().floor().exp2()
}

/// Half the sum of the cross products (M. E. Newell's formula). Its length is the area, and it points to the front.
fn area_vector(polygon: &[DVec3]) -> DVec3 {
    let o = polygon[0];
    0.5 * polygon.windows(2).map(|e| (e[0] - o).cross(e[1] - o)).sum::<DVec3>()
}

/// The area of a planar polygon.
///
/// # Panics
///
/// If there are fewer than 3 vertices or one is not finite.
pub fn polygon_area(polygon: &[DVec3]) -> f64 {
    assert_polygon(polygon);
    area_vector(polygon).length()
}

/// The part of a convex polygon above a plane, or `None` if no vertex is above it by more than `slack`. Vertices up to
/// `slack` below the plane count as on it, so that rounding does not cut an edge in the plane.
pub(crate) fn clip(polygon: &[DVec3], origin: DVec3, normal: DVec3, slack: f64) -> Option<Vec<DVec3>> {
    let heights: Vec<f64> = polygon.iter().map(|&v| (v - origin).dot(normal)).collect();
    if heights.iter().all(|&h| h <= slack) {
        return None;
    }
    let mut out = Vec::with_capacity(polygon.len() + 1);
    for (i, (&a, &ha)) in polygon.iter().zip(&heights).enumerate() {
        let j = (i + 1) % polygon.len();
        let (b, hb) = (polygon[j], heights[j]);
        if ha >= -slack {
            out.push(a);
        }
        if (ha < -slack && hb > 0.0) || (hb < -slack && ha > 0.0) {
            out.push(a + (b - a) * (ha / (ha - hb)));
        }
    }
    (out.len() >= 3).then_some(out)
}

/// Lambert's sum over the edges of a polygon above the horizon (*Photometria*, 1760). Each edge adds the angle that it
/// subtends times the cosine between `normal` and the normal of the edge's plane through the point.
pub(crate) fn lambert(point: DVec3, normal: DVec3, polygon: &[DVec3]) -> f64 {
    let edge = |k: usize| {
        let start = polygon[k];
        let end = polygon[(k + 1) % polygon.len()];
        let (a, b) = (start - point, end - point);
        // Not a x b, which rounds at the square of the distance. This rounds at distance times edge.
        let across = a.cross(end - start);
        let size = across.length();
        if size > 0.0 { size.atan2(a.dot(b)) / size * across.dot(normal) } else { 0.0 }
    };
    (0..polygon.len()).map(edge).sum::<f64>().abs() / (2.0 * PI)
}

/// The form factor from a small surface at `point` with unit `normal` to a planar convex polygon (Lambert's formula).
///
/// It is the polygon's share of the irradiance from a hemisphere that is equally bright everywhere: 0 to 1. The part
/// below the horizon of the point is cut off. The side of the polygon and the order of its vertices do not matter. On
/// the polygon itself the value is the limit from the side to which `normal` points: 1 inside, 1/2 on an edge.
///
/// # Panics
///
/// If there are fewer than 3 vertices, one is not finite, or `normal` is not of length 1.
pub fn point_to_polygon(point: DVec3, normal: DVec3, polygon: &[DVec3]) -> f64 {
    assert_polygon(polygon);
    assert!((normal.length() - 1.0).abs() < 1e-6, "the normal {normal} must be of length 1");
    let unit = polygon.iter().map(|v| v.distance(point)).fold(0.0, f64::max);
    if unit == 0.0 {
        return 0.0;
    }
    let unit = power_of_two_below(unit);
    let local: Vec<DVec3> = polygon.iter().map(|&v| (v - point) / unit).collect();
    let above = if local.iter().all(|v| v.dot(normal) >= 0.0) {
        local
    } else {
        match clip(&local, DVec3::ZERO, normal, 0.0) {
            Some(above) => above,
            None => return 0.0,
        }
    };
    let facing = area_vector(&above).normalize_or_zero();
    cubature::point_if_far(DVec3::ZERO, normal, &above, facing, FAR)
        .unwrap_or_else(|| lambert(DVec3::ZERO, normal, &above))
        .min(1.0)
}

/// The exchange area A1 F12 of two planar convex polygons in any position, in the square of their unit of length.
///
/// Light is exchanged by the front of a polygon, the side from which its vertices run counterclockwise. Each polygon
/// counts with its part in front of the other's plane; polygons in one plane exchange nothing. Polygons may share
/// vertices or edges.
///
/// Far polygons are integrated by points, near ones by their contours. The relative error is about 1e-14. It is larger
/// for near polygons that barely see each other: the absolute error is about 1e-15 of the product of the perimeters.
///
/// # Panics
///
/// If a polygon has fewer than 3 vertices or one that is not finite.
pub fn polygon_exchange_area(p: &[DVec3], q: &[DVec3]) -> f64 {
    exchange_area_to(p, q, FAR, f64::EPSILON)
}

/// Like [`polygon_exchange_area`], but polygons at least `far` radii away are integrated by points, to this relative
/// precision.
pub(crate) fn exchange_area_to(p: &[DVec3], q: &[DVec3], far: f64, precision: f64) -> f64 {
    assert_polygon(p);
    assert_polygon(q);
    let origin = p[0];
    let all = || p.iter().chain(q);
    let unit = all().map(|v| v.distance(origin)).fold(0.0, f64::max);
    if unit == 0.0 {
        return 0.0;
    }
    let unit = power_of_two_below(unit);
    // The coordinates are no more precise than this, and so is the side of a plane on which a vertex lies.
    let slack = 16.0 * f64::EPSILON * (1.0 + all().map(|v| v.abs().max_element()).fold(0.0, f64::max) / unit);
    let local = |polygon: &[DVec3]| polygon.iter().map(|&v| (v - origin) / unit).collect::<Vec<_>>();
    let (p, q) = (local(p), local(q));
    let (ap, aq) = (area_vector(&p), area_vector(&q));
    let (np, nq) = (ap.normalize_or_zero(), aq.normalize_or_zero());
    let (Some(p), Some(q)) = (clip(&p, q[0], nq, slack), clip(&q, p[0], np, slack)) else { return 0.0 };
    let exchange = cubature::exchange_if_far((&p, np), (&q, nq), far, precision).unwrap_or_else(|| {
        let size = power_of_two_below(cubature::ball(&p).1.min(cubature::ball(&q).1));
        let scaled = |polygon: &[DVec3]| polygon.iter().map(|&v| v / size).collect::<Vec<_>>();
        contour::exchange(&scaled(&p), &scaled(&q)) * size * size
    });
    exchange.clamp(0.0, ap.length().min(aq.length())) * unit * unit
}

/// The form factor from polygon `p` to polygon `q`: [`polygon_exchange_area`] over the area of `p`.
///
/// # Panics
///
/// Like [`polygon_exchange_area`], and if `p` has no area.
pub fn polygon_form_factor(p: &[DVec3], q: &[DVec3]) -> f64 {
    let area = polygon_area(p);
    assert!(area > 0.0, "a polygon without area has no form factor");
    polygon_exchange_area(p, q) / area
}
