//! Models of reflection for path and light tracing. The solver supports only [`Lambert`].
//!
//! A model is a BRDF f(ωo, ωi) in 1/sr: the radiance to ωo per irradiance from ωi. Directions are unit vectors in the
//! frame of the surface, whose z axis is the normal, and point away from the surface. Every model here is reciprocal,
//! f(ωo, ωi) = f(ωi, ωo), and none reflects more light than it receives. Light that is reflected between several facets
//! is not modelled and is lost.

mod albedo;
mod beckmann;
mod blinn_phong;
mod fresnel;
mod ggx;
mod lambert;
mod lambertian;
mod lobe;
mod metallic_roughness;
mod microfacet;
mod mirror;
mod phong;
mod surface;
#[cfg(test)]
mod tests;
mod ward;

use glam::DVec3;

pub use albedo::{directional_albedo, hemispherical_albedo};
pub use blinn_phong::BlinnPhong;
pub use lambert::Lambert;
pub use lambertian::{SpecularPart, make_lambertian};
pub use lobe::Lobe;
pub use metallic_roughness::{DIELECTRIC, alpha_of};
pub use microfacet::Microfacet;
pub use mirror::Mirror;
pub use phong::Phong;
pub use surface::Surfaces;
pub(super) use surface::{Bounce, Surface};
pub use ward::Ward;

/// A model of reflection. Both directions have z > 0.
pub trait Brdf {
    /// The BRDF, 1/sr, per channel. For a mirror, whose BRDF is infinite in one direction, this is 0.
    fn evaluate(&self, wo: DVec3, wi: DVec3) -> DVec3;

    /// Maps a point of the unit square to a direction ωi, for light that goes to ωo. `None` if the direction is below
    /// the surface: this part of the lobe is lost.
    fn sample(&self, wo: DVec3, u: [f64; 2]) -> Option<DVec3>;

    /// Probability per solid angle, 1/sr, with which [`Brdf::sample`] chooses ωi; 0 for a mirror.
    fn density(&self, wo: DVec3, wi: DVec3) -> f64;
}

/// The mirror image of `w` in a facet with the unit normal `h`.
fn reflect(w: DVec3, h: DVec3) -> DVec3 {
    h * (2.0 * w.dot(h)) - w
}

/// The unit vector with the given cosine to the z axis and the given azimuth.
fn spherical(cos: f64, azimuth: f64) -> DVec3 {
    let (sin_azimuth, cos_azimuth) = azimuth.sin_cos();
    let sin = (1.0 - cos * cos).max(0.0).sqrt();
    DVec3::new(sin * cos_azimuth, sin * sin_azimuth, cos)
}

/// The direction if it is above the surface, otherwise `None`.
fn above(w: DVec3) -> Option<DVec3> {
    (w.z > 0.0).then_some(w)
}
