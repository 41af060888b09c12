//! Form factors of well-separated polygons by products of Gauss-Legendre rules. The kernel is positive, so unlike the
//! closed forms this loses no digits, however small the polygons are. The kernel is also analytic, so few points
//! suffice.

use std::f64::consts::PI;
use std::sync::OnceLock;

use glam::DVec3;

use super::polygon::lambert;

/// The largest number of points of a rule.
pub(super) const MAX_POINTS: usize = 16;

/// Nodes in (0, 1) and weights that sum to 1, of the Gauss-Legendre rule with `n` points.
pub(super) fn gauss_legendre(n: usize) -> &'static [(f64, f64)] {
    static RULES: OnceLock<Vec<Vec<(f64, f64)>>> = OnceLock::new();
    &RULES.get_or_init(|| (0..=MAX_POINTS).map(newton_rule).collect())[n]
}

/// Newton's method on the Legendre polynomial, started from Tricomi's approximation of its roots.
fn newton_rule(n: usize) -> Vec<(f64, f64)> {
    let legendre = |x: f64| {
        let (mut before, mut p) = (1.0, x);
        for k in 2..=n {
            let k = k as f64;
            (before, p) = (p, ((2.0 * k - 1.0) * x * p - (k - 1.0) * before) / k);
        }
        (p, n as f64 * (x * p - before) / (x * x - 1.0))
    };
    let node = |i: usize| {
        let mut x = (PI * (i as f64 + 0.75) / (n as f64 + 0.5)).cos();
        for _ in 0..6 {
            let (p, slope) = legendre(x);
            x -= p / slope;
        }
        let slope = legendre(x).1;
        (0.5 * (1.0 + x), 1.0 / ((1.0 - x * x) * slope * slope))
    };
    (0..n).map(node).collect()
}

/// The number of points per side that integrates a function to this relative precision. The nearest singularity of the
/// function is `ratio` half-lengths from the centre of the interval.
///
/// The error falls as rho^(-2n), where rho is the sum of the half-axes of the Bernstein ellipse through the singularity
/// (L. N. Trefethen, *Approximation Theory and Approximation Practice*, theorem 19.3). One more point makes up for the
/// constant.
fn points_for(ratio: f64, precision: f64) -> usize {
    let rho = ratio + (ratio * ratio - 1.0).sqrt();
    let n = (-precision.ln() / (2.0 * rho.ln())).ceil() as usize + 1;
    n.clamp(2, MAX_POINTS)
}

/// Points of a convex polygon and their weights, which sum to its area.
pub(crate) fn nodes(polygon: &[DVec3], n: usize) -> Vec<(DVec3, f64)> {
    let rule = gauss_legendre(n);
    let o = polygon[0];
    let mut out = Vec::with_capacity(n * n * (polygon.len() - 2));
    let is_parallelogram = polygon.len() == 4
        && (polygon[1] - o + (polygon[3] - polygon[2])).length() < 1e-14 * (polygon[2] - o).length();
    if is_parallelogram {
        let (a, b) = (polygon[1] - o, polygon[3] - o);
        let area = a.cross(b).length();
        out.extend(
            rule.iter().flat_map(|&(s, w)| rule.iter().map(move |&(t, v)| (o + a * s + b * t, area * w * v))),
        );
        return out;
    }
    for k in 1..polygon.len() - 1 {
        let (a, b) = (polygon[k] - o, polygon[k + 1] - o);
        let double_area = a.cross(b).length();
        for &(s, w) in rule {
            out.extend(rule.iter().map(|&(t, v)| (o + (a + (b - a) * t) * s, double_area * s * w * v)));
        }
    }
    out
}

/// The centre and radius of a ball around a polygon.
pub(super) fn ball(polygon: &[DVec3]) -> (DVec3, f64) {
    let centre = polygon.iter().sum::<DVec3>() / polygon.len() as f64;
    (centre, polygon.iter().map(|v| v.distance(centre)).fold(0.0, f64::max))
}

/// The distance from a point to a convex polygon with the given unit normal.
fn distance(p: DVec3, polygon: &[DVec3], normal: DVec3) -> f64 {
    let (mut inside, mut nearest) = (true, f64::INFINITY);
    for (k, &a) in polygon.iter().enumerate() {
        let edge = polygon[(k + 1) % polygon.len()] - a;
        let t = ((p - a).dot(edge) / edge.length_squared()).clamp(0.0, 1.0);
        // A repeated vertex has no edge: t is not a number, and `min` ignores it.
        nearest = nearest.min(p.distance(a + edge * t));
        inside &= normal.cross(edge).dot(p - a) >= 0.0;
    }
    if inside { (p - polygon[0]).dot(normal).abs() } else { nearest }
}

/// cos cos / (π r²) between two points that face each other, with unit normals.
fn kernel(p: DVec3, n: DVec3, q: DVec3, m: DVec3) -> f64 {
    let d = q - p;
    let r2 = d.length_squared();
    (d.dot(n) / r2) * (-d.dot(m) / r2) / PI
}

/// The form factor from a point to a polygon wholly above its horizon, if the polygon is at least `far` of its radii
/// away.
pub(super) fn point_if_far(p: DVec3, n: DVec3, polygon: &[DVec3], normal: DVec3, far: f64) -> Option<f64> {
    let (centre, radius) = ball(polygon);
    let d = centre.distance(p);
    (d >= far * radius).then(|| {
        let sum: f64 = nodes(polygon, points_for(d / radius, f64::EPSILON))
            .iter()
            .map(|&(q, w)| w * kernel(p, n, q, normal))
            .sum();
        sum.abs()
    })
}

/// The exchange area of two convex polygons wholly in front of each other, if the smaller is at least `far` of its
/// radii from the larger. Integrates over the smaller one by points. Integrates over the larger one by points too if it
/// is far away as well, otherwise by Lambert's formula.
pub(super) fn exchange_if_far(
    (p, np): (&[DVec3], DVec3),
    (q, nq): (&[DVec3], DVec3),
    far: f64,
    precision: f64,
) -> Option<f64> {
    let ((cp, rp), (cq, rq)) = (ball(p), ball(q));
    if rp > rq {
        return exchange_if_far((q, nq), (p, np), far, precision);
    }
    let d = distance(cp, q, nq);
    if d < far * rp {
        return None;
    }
    let ours = nodes(p, points_for(d / rp, precision));
    let d = distance(cq, p, np);
    if d < far * rq {
        return Some(ours.iter().map(|&(x, w)| w * lambert(x, np, q)).sum());
    }
    let theirs = nodes(q, points_for(d / rq, precision));
    Some(
        ours.iter()
            .map(|&(x, w)| w * theirs.iter().map(|&(y, v)| v * kernel(x, np, y, nq)).sum::<f64>())
            .sum(),
    )
}
