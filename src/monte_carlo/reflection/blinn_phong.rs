//! The Blinn-Phong model: a lobe of the half vector round the normal.

use std::f64::consts::PI;

use glam::DVec3;

use super::{Brdf, above, reflect, spherical};

/// f = ks · c(n) · cosⁿ θh, θh between normal and half vector (Blinn, "Models of Light Reflection for Computer Synthesized
/// Pictures", SIGGRAPH 77). The exact c(n) = (n + 2)(n + 4)/(8π (2^(-n/2) + n)) (Giesen, "Phong and Blinn-Phong Normalization
/// Factors", 2009) makes it reflect ks from straight above and less from elsewhere. The common (n + 8)/8π is 7 % above it at n = 10.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlinnPhong {
    /// ks, R G B.
    pub reflectance: DVec3,
    /// n.
    pub exponent: f64,
}

impl Brdf for BlinnPhong {
    fn evaluate(&self, wo: DVec3, wi: DVec3) -> DVec3 {
        let n = self.exponent;
        let factor = (n + 2.0) * (n + 4.0) / (8.0 * PI * ((-0.5 * n).exp2() + n));
        self.reflectance * (factor * (wo + wi).normalize().z.powf(n))
    }

    /// The half vector with density (n + 1)/2π · cosⁿ θh.
    fn sample(&self, wo: DVec3, [x, y]: [f64; 2]) -> Option<DVec3> {
        let h = spherical((1.0 - x).powf(1.0 / (self.exponent + 1.0)), 2.0 * PI * y);
        // A facet that turns its back on the viewer is the facet on the other side of the mirror image.
        above(reflect(wo, h))
    }

    fn density(&self, wo: DVec3, wi: DVec3) -> f64 {
        let h = (wo + wi).normalize();
        (self.exponent + 1.0) / (8.0 * PI * wo.dot(h)) * h.z.powf(self.exponent)
    }
}
