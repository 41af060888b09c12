//! The perfect mirror: all light from one direction goes to a single other direction.

use glam::DVec3;

use super::Brdf;
use crate::scene::Fresnel;

/// f = F δ(ωi - ωr)/cos θ, where ωr is the mirror image of ωo. It is infinite where it is not 0, so [`Brdf::evaluate`]
/// and [`Brdf::density`] return 0. The weight of the sampled direction is F.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mirror {
    /// The reflectance F.
    pub fresnel: Fresnel,
}

impl Brdf for Mirror {
    fn evaluate(&self, _: DVec3, _: DVec3) -> DVec3 {
        DVec3::ZERO
    }

    fn sample(&self, wo: DVec3, _: [f64; 2]) -> Option<DVec3> {
        Some(DVec3::new(-wo.x, -wo.y, wo.z))
    }

    fn density(&self, _: DVec3, _: DVec3) -> f64 {
        0.0
    }
}
