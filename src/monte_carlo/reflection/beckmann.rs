//! Beckmann's distribution of slopes: Gaussian.

use std::f64::consts::PI;

use glam::DVec3;

/// Density of facets with normal h, per solid angle and area of the surface, 1/sr (Walter et al., EGSR 2007, equation
/// 25).
pub(super) fn density([ax, ay]: [f64; 2], h: DVec3) -> f64 {
    let z2 = h.z * h.z;
    (-((h.x / ax).powi(2) + (h.y / ay).powi(2)) / z2).exp() / (PI * ax * ay * z2 * z2)
}

/// Smith's Λ from α² tan² θ (Heitz, JCGT 3(2), 2014, equation 68). It uses the exact error function: the usual rational
/// approximation has an error of 0.35 %, and then the density of visible facets does not integrate to 1.
pub(super) fn lambda(tan2: f64) -> f64 {
    let a = 1.0 / tan2.sqrt();
    // Beyond this limit Λ is below 10⁻²⁰. The limit also covers a division by zero.
    if a > 6.5 {
        return 0.0;
    }
    0.5 * ((-a * a).exp() / (a * PI.sqrt()) - libm::erfc(a))
}

/// Samples the normal of a facet that is visible from w. The surface is stretched to α = 1. There the slope across the
/// view is Gaussian for any view direction (Heitz and d'Eon, "Importance Sampling Microfacet-Based BSDFs using the
/// Distribution of Visible Normals", EGSR 2014, section 4 and supplement 1).
pub(super) fn visible([ax, ay]: [f64; 2], w: DVec3, [x, y]: [f64; 2]) -> DVec3 {
    let stretched = DVec3::new(ax * w.x, ay * w.y, w.z).normalize();
    let sin = stretched.x.hypot(stretched.y);
    let (cos_azimuth, sin_azimuth) =
        if sin > 0.0 { (stretched.x / sin, stretched.y / sin) } else { (1.0, 0.0) };
    let (along, across) = (slope(stretched.z, sin, x), slope(1.0, 0.0, y));
    let turned = [cos_azimuth * along - sin_azimuth * across, sin_azimuth * along + cos_azimuth * across];
    DVec3::new(-turned[0] * ax, -turned[1] * ay, 1.0).normalize()
}

/// Steepest slope. Steeper ones have a probability below 10⁻¹⁶.
const STEEPEST: f64 = 6.0;

/// The quantile `u` of the slope x along the view, among visible facets. The density of x is proportional to max(0, cos
/// θ - x sin θ) exp(-x²). The closure `below` is its integral from -∞ to x, up to a factor. The equation is solved by
/// Newton's method between bounds.
fn slope(cos: f64, sin: f64, u: f64) -> f64 {
    let below = |x: f64| 0.5 * cos * libm::erfc(-x) + 0.5 * sin * (-x * x).exp() / PI.sqrt();
    let (mut low, mut high) = (-STEEPEST, if sin > 0.0 { (cos / sin).min(STEEPEST) } else { STEEPEST });
    let target = u * below(high);
    let mut x = 0.5 * (low + high);
    for _ in 0..64 {
        let off = below(x) - target;
        if off > 0.0 {
            high = x
        } else {
            low = x
        }
        let newton = x - off * PI.sqrt() / ((cos - x * sin) * (-x * x).exp());
        let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        if (next - x).abs() < 1e-10 {
            return next;
        }
        x = next;
    }
    x
}
