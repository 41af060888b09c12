//! The modified Phong model: a lobe around the mirror direction.

use std::f64::consts::PI;

use glam::DVec3;

use super::{Brdf, above, spherical};

/// f = ks (n + 2)/2π · max(0, cos α)ⁿ, where α is the angle between ωi and the mirror image of ωo (Lafortune and
/// Willems, "Using the Modified Phong Reflectance Model for Physically Based Rendering", report CW 197, 1994, equation
/// 1). It is reciprocal because it is not divided by cos θ. It reflects ks at normal incidence and less at other
/// angles, because the part of the lobe below the surface is lost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Phong {
    /// ks, per channel.
    pub reflectance: DVec3,
    /// The exponent n.
    pub exponent: f64,
}

impl Phong {
    /// max(0, cos α)ⁿ. Beyond 90 degrees it is 0, even for n = 0.
    fn lobe(&self, wo: DVec3, wi: DVec3) -> f64 {
        let cos = DVec3::new(-wo.x, -wo.y, wo.z).dot(wi);
        if cos > 0.0 { cos.min(1.0).powf(self.exponent) } else { 0.0 }
    }
}

impl Brdf for Phong {
    fn evaluate(&self, wo: DVec3, wi: DVec3) -> DVec3 {
        self.reflectance * ((self.exponent + 2.0) / (2.0 * PI) * self.lobe(wo, wi))
    }

    /// α = acos u^(1/(n+1)) (the report's equation 12).
    fn sample(&self, wo: DVec3, [x, y]: [f64; 2]) -> Option<DVec3> {
        let mirrored = DVec3::new(-wo.x, -wo.y, wo.z);
        let (tangent, bitangent) = mirrored.any_orthonormal_pair();
        let w = spherical((1.0 - x).powf(1.0 / (self.exponent + 1.0)), 2.0 * PI * y);
        above((tangent * w.x + bitangent * w.y + mirrored * w.z).normalize())
    }

    fn density(&self, wo: DVec3, wi: DVec3) -> f64 {
        (self.exponent + 1.0) / (2.0 * PI) * self.lobe(wo, wi)
    }
}
