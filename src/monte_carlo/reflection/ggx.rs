//! Trowbridge and Reitz' distribution of slopes, called GGX.

use std::f64::consts::PI;

use glam::DVec3;

use super::spherical;

/// Density of facets with normal h per solid angle and area of the surface, 1/sr (Walter et al., "Microfacet Models for
/// Refraction through Rough Surfaces", EGSR 2007, equation 33; Heitz, JCGT 3(2), 2014, for two roughnesses).
pub(super) fn density([ax, ay]: [f64; 2], h: DVec3) -> f64 {
    let stretched = (h.x / ax).powi(2) + (h.y / ay).powi(2) + h.z * h.z;
    1.0 / (PI * ax * ay * stretched * stretched)
}

/// Smith's Λ from α² tan² θ (Heitz 2014, equation 72).
pub(super) fn lambda(tan2: f64) -> f64 {
    // √(1 + t) - 1 without cancellation.
    0.5 * tan2 / (1.0 + (1.0 + tan2).sqrt())
}

/// Samples the normal of a facet that is visible from w: a half vector that is uniform in a spherical cap (Dupuy and
/// Benyoub, "Sampling Visible GGX Normals with Spherical Caps", HPG 2023).
pub(super) fn visible([ax, ay]: [f64; 2], w: DVec3, [x, y]: [f64; 2]) -> DVec3 {
    let stretched = DVec3::new(ax * w.x, ay * w.y, w.z).normalize();
    let z = (1.0 - y).mul_add(1.0 + stretched.z, -stretched.z);
    let h = spherical(z, 2.0 * PI * x) + stretched;
    DVec3::new(ax * h.x, ay * h.y, h.z).normalize()
}
