//! The Blinn-Phong model: a lobe of the half vector around the normal.

use std::f64::consts::PI;

use glam::DVec3;

use super::{Brdf, above, reflect, spherical};

/// f = ks · c(n) · cosⁿ θh, where θh is the angle between normal and half vector (Blinn, "Models of Light Reflection
/// for Computer Synthesized Pictures", SIGGRAPH 77). With the exact factor c(n) = (n + 2)(n + 4)/(8π (2^(-n/2) + n))
/// (Giesen, "Phong and Blinn-Phong Normalization Factors", 2009), the surface reflects ks at normal incidence and less
/// at other angles. The common factor (n + 8)/8π is 7 % larger at n = 10.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlinnPhong {
    /// ks, per channel.
    pub reflectance: DVec3,
    /// The exponent n.
    pub exponent: f64,
}

impl Brdf for BlinnPhong {
    fn evaluate(&self, wo: DVec3, wi: DVec3) -> DVec3 {
        let n = self.exponent;
        let factor = (n + 2.0) * (n + 4.0) / (8.0 * PI * ((-0.5 * n).exp2() + n));
        self.reflectance * (factor * (wo + wi).normalize().z.powf(n))
    }

    /// Samples the half vector with density (n + 1)/2π · cosⁿ θh.
    fn sample(&self, wo: DVec3, [x, y]: [f64; 2]) -> Option<DVec3> {
        let h = spherical((1.0 - x).powf(1.0 / (self.exponent + 1.0)), 2.0 * PI * y);
        // A half vector on the far side of the viewer gives the same mirror image as its opposite.
        above(reflect(wo, h))
    }

    fn density(&self, wo: DVec3, wi: DVec3) -> f64 {
        let h = (wo + wi).normalize();
        (self.exponent + 1.0) / (8.0 * PI * wo.dot(h)) * h.z.powf(self.exponent)
    }
}
