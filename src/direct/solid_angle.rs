//! Directions distributed evenly over the solid angle of a triangle.

use std::f64::consts::PI;

use glam::DVec3;

/// Maps a point of the unit square to a direction from `point` to a triangle, with constant density over the triangle's
/// solid angle. Also returns the solid angle. Returns `None` if rounding makes it zero.
///
/// Arvo, "Stratified Sampling of Spherical Triangles", SIGGRAPH 95, as in Pharr, Jakob and Humphreys, *Physically Based
/// Rendering*, 4th edition, section 6.5.4.
pub(super) fn sample(corners: [DVec3; 3], point: DVec3, [u, v]: [f64; 2]) -> Option<(DVec3, f64)> {
    let [a, b, c] = corners.map(|corner| (corner - point).normalize_or_zero());
    let [ab, bc, ca] = [a.cross(b), b.cross(c), c.cross(a)].map(DVec3::normalize_or_zero);
    let angle = |p: DVec3, q: DVec3| p.dot(q).clamp(-1.0, 1.0).acos();
    let alpha = angle(ab, -ca);
    let sum = alpha + angle(bc, -ab) + angle(ca, -bc);
    let solid_angle = sum - PI;
    if !(solid_angle > 0.0 && alpha > 0.0) {
        return None;
    }
    let part = PI + u * solid_angle;
    let (sin_alpha, cos_alpha) = alpha.sin_cos();
    let (sin_part, cos_part) = part.sin_cos();
    let sin = sin_part * cos_alpha - cos_part * sin_alpha;
    let cos = cos_part * cos_alpha + sin_part * sin_alpha;
    let (k1, k2) = (cos + cos_alpha, sin - sin_alpha * a.dot(b));
    let cos_side = (k2 + (k2 * cos - k1 * sin) * cos_alpha) / ((k2 * sin + k1 * cos) * sin_alpha);
    let cos_side = if cos_side.is_nan() { 1.0 } else { cos_side.clamp(-1.0, 1.0) };
    let across = |p: DVec3, axis: DVec3| (p - p.dot(axis) * axis).normalize_or_zero();
    let on_side = cos_side * a + (1.0 - cos_side * cos_side).sqrt() * across(c, a);
    let cos_end = 1.0 - v * (1.0 - on_side.dot(b));
    let direction = cos_end * b + (1.0 - cos_end * cos_end).max(0.0).sqrt() * across(on_side, b);
    Some((direction, solid_angle))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::dvec3;

    /// An octant of the sphere has solid angle π / 2. Over it the mean cosine with each axis is 1/2, and the mean
    /// squared cosine 1/3.
    #[test]
    fn an_octant_is_filled_evenly() {
        let corners = [dvec3(9.0, 2.0, 3.0), dvec3(1.0, 6.0, 3.0), dvec3(1.0, 2.0, 10.0)];
        let point = dvec3(1.0, 2.0, 3.0);
        let (count, mut first, mut second) = (64, DVec3::ZERO, DVec3::ZERO);
        for i in 0..count {
            for j in 0..count {
                let at = [i, j].map(|k| (f64::from(k) + 0.5) / f64::from(count));
                let (direction, solid_angle) = sample(corners, point, at).unwrap();
                assert!((solid_angle - PI / 2.0).abs() < 1e-12);
                assert!((direction.length() - 1.0).abs() < 1e-12 && direction.min_element() >= -1e-12);
                first += direction / f64::from(count * count);
                second += direction * direction / f64::from(count * count);
            }
        }
        assert!((first - 0.5).abs().max_element() < 1e-3, "{first}");
        assert!((second - 1.0 / 3.0).abs().max_element() < 1e-3, "{second}");
    }
}
