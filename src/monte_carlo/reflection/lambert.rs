//! Lambert's model: the same radiance in all directions.

use std::f64::consts::PI;

use glam::DVec3;

use super::Brdf;

/// f = ρ/π. Directions are chosen with density cos θ/π.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lambert {
    /// Reflectance ρ, per channel.
    pub reflectance: DVec3,
}

impl Brdf for Lambert {
    fn evaluate(&self, _: DVec3, _: DVec3) -> DVec3 {
        self.reflectance / PI
    }

    fn sample(&self, _: DVec3, [x, y]: [f64; 2]) -> Option<DVec3> {
        let w = crate::trace::sampling::square_to_cosine_hemisphere(x as f32, y as f32).as_dvec3();
        super::above(w.normalize())
    }

    fn density(&self, _: DVec3, wi: DVec3) -> f64 {
        wi.z / PI
    }
}
