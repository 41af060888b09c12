//! The metallic-roughness model of glTF, and the diffuse part below a surface that reflects by Fresnel's law.
//!
//! glTF 2.0, appendix B: a metal has GGX facets with the base colour as Schlick's r0. A dielectric has GGX facets with
//! r0 = 0.04 over a diffuse base. `metallic` mixes both. The specification mixes the parts of a dielectric by the
//! Fresnel term of the half vector, which reflects up to 1.45 times the light at grazing angles. Here the diffuse part
//! is ρ/π · (1 - E(ωi))(1 - E(ωo))/(1 - Ē) instead, where E is the directional albedo of the facets and Ē its mean
//! (Kelemen and Szirmay-Kalos, "A Microfacet Based Coupled Specular-Matte BRDF Model with Importance Sampling",
//! Eurographics 2001 short papers). It is reciprocal, and a white base reflects exactly the light that the facets do
//! not.

use glam::DVec3;
use rayon::prelude::*;

use super::{
    Lobe,
    albedo::{azimuths, directional_albedo},
    spherical,
};

/// Reflectance of a dielectric at normal incidence, for an index of refraction of 1.5.
pub const DIELECTRIC: f64 = 0.04;

/// GGX's roughness along and across the tangent: the square of the perceptual roughness, stretched by the anisotropy
/// (Burley, "Physically-Based Shading at Disney", SIGGRAPH 2012 course notes, section 5.4).
pub fn alpha_of(roughness: f64, anisotropy: f64) -> [f64; 2] {
    let (alpha, aspect) = (roughness * roughness, (1.0 - 0.9 * anisotropy).sqrt());
    [(alpha / aspect).min(1.0), alpha * aspect]
}

/// Number of evenly spaced cosines in the table. Schlick's fifth power is most curved at grazing angles. Linear
/// interpolation between these cosines has an error of 6·10⁻⁴ there.
const NODES: usize = 65;

/// The share of light that a lobe does not reflect, as a function of the angle. It is left for the diffuse part.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Coupling {
    /// 1 - E at cosines from 0 to 1.
    left: Vec<f64>,
    /// 1 - Ē.
    mean: f64,
}

impl Coupling {
    /// Tabulates the share for the channel and the azimuth at which it is smallest.
    pub(super) fn below(lobe: &Lobe) -> Coupling {
        let azimuths = azimuths(lobe);
        let left: Vec<f64> = (0..NODES)
            .into_par_iter()
            .map(|k| {
                let cos = (k as f64 / (NODES - 1) as f64).max(1e-4);
                let albedo = |&azimuth: &f64| directional_albedo(lobe, spherical(cos, azimuth)).max_element();
                1.0 - azimuths.iter().map(albedo).fold(0.0, f64::max).min(1.0)
            })
            .collect();
        // The exact integral ∫ 2μ l(μ) dμ of a piecewise linear l.
        let step = 1.0 / (NODES - 1) as f64;
        let mean = (0..NODES - 1)
            .map(|k| {
                let (a, b, low) = (left[k], left[k + 1], k as f64 * step);
                step * (low * (a + b) + step * (a + 2.0 * b) / 3.0)
            })
            .sum();
        Coupling { left, mean }
    }

    /// 1 - E at a cosine.
    pub(super) fn left(&self, cos: f64) -> f64 {
        let x = cos.clamp(0.0, 1.0) * (NODES - 1) as f64;
        let k = (x as usize).min(NODES - 2);
        let t = x - k as f64;
        self.left[k] * (1.0 - t) + self.left[k + 1] * t
    }

    /// Share of diffuse light that reaches the diffuse part: 1 - Ē.
    pub(super) fn mean(&self) -> f64 {
        self.mean
    }

    /// Factor of the diffuse BRDF for a pair of directions.
    pub(super) fn factor(&self, wo: DVec3, wi: DVec3) -> f64 {
        if self.mean > 0.0 { self.left(wo.z) * self.left(wi.z) / self.mean } else { 0.0 }
    }
}
