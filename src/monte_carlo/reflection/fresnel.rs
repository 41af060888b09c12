//! Reflectance of a smooth surface as a function of the angle of incidence.

use glam::DVec3;

use crate::scene::Fresnel;

impl Fresnel {
    /// Reflectance per channel. `cos` is the cosine of the angle between the light and the normal.
    pub fn reflectance(&self, cos: f64) -> DVec3 {
        match *self {
            Fresnel::Constant(r) => r.into(),
            // Schlick, "An Inexpensive BRDF Model for Physically-Based Rendering", Computer Graphics Forum 13(3), 1994.
            Fresnel::Schlick(r0) => {
                let r0 = DVec3::from(r0);
                r0 + (DVec3::ONE - r0) * (1.0 - cos).clamp(0.0, 1.0).powi(5)
            }
            Fresnel::Conductor { eta, kappa } => {
                DVec3::from_array(std::array::from_fn(|c| conductor(cos, eta[c], kappa[c])))
            }
        }
    }

    /// Whether the reflectance is the same at all angles.
    pub(super) fn is_constant(&self) -> bool {
        matches!(self, Fresnel::Constant(_))
    }
}

/// Unpolarised light on a conductor in vacuum: mean of the squares of Fresnel's coefficients (Born and Wolf,
/// *Principles of Optics*, section 14.2).
fn conductor(cos: f64, eta: f64, kappa: f64) -> f64 {
    let (cos2, sin2) = (cos * cos, (1.0 - cos * cos).max(0.0));
    // a² - b² and a² + b², where a + ib describes the refracted wave.
    let difference = eta * eta - kappa * kappa - sin2;
    let sum = difference.hypot(2.0 * eta * kappa);
    let twice = 2.0 * (0.5 * (sum + difference)).max(0.0).sqrt() * cos;
    let across = (sum + cos2 - twice) / (sum + cos2 + twice);
    let (along, rest) = (cos2 * sum + sin2 * sin2, twice * sin2);
    0.5 * across * (1.0 + (along - rest) / (along + rest))
}
