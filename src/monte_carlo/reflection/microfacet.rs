//! The microfacet model of Cook and Torrance: a surface of small mirrors.

use glam::DVec3;

use super::{Brdf, above, beckmann, ggx, reflect};
use crate::scene::{Distribution, Fresnel, LEAST_ALPHA, Shadowing};

/// f = F D G2/(4 cos θi cos θo) (Cook and Torrance, "A Reflectance Model for Computer Graphics", ACM TOG 1(1), 1982,
/// with the 4 of Walter et al., "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007, equation 20).
/// Light that is reflected by more than one facet is lost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Microfacet {
    distribution: Distribution,
    alpha: [f64; 2],
    fresnel: Fresnel,
    shadowing: Shadowing,
}

impl Microfacet {
    /// A model with roughness `alpha` along and across the tangent.
    pub fn new(
        distribution: Distribution,
        alpha: [f64; 2],
        fresnel: Fresnel,
        shadowing: Shadowing,
    ) -> Microfacet {
        Microfacet { distribution, alpha: alpha.map(|a| a.max(LEAST_ALPHA)), fresnel, shadowing }
    }

    /// The same facets with another reflectance.
    pub(super) fn with_fresnel(self, fresnel: Fresnel) -> Microfacet {
        Microfacet { fresnel, ..self }
    }

    pub(super) fn is_anisotropic(&self) -> bool {
        self.alpha[0] != self.alpha[1]
    }

    pub(super) fn fresnel(&self) -> &Fresnel {
        &self.fresnel
    }

    fn facets(&self, h: DVec3) -> f64 {
        match self.distribution {
            Distribution::Beckmann => beckmann::density(self.alpha, h),
            Distribution::Ggx => ggx::density(self.alpha, h),
        }
    }

    fn lambda(&self, w: DVec3) -> f64 {
        let [ax, ay] = self.alpha;
        let tan2 = ((ax * w.x).powi(2) + (ay * w.y).powi(2)) / (w.z * w.z);
        match self.distribution {
            Distribution::Beckmann => beckmann::lambda(tan2),
            Distribution::Ggx => ggx::lambda(tan2),
        }
    }

    /// Share of the facets that are visible from both directions.
    fn shadowing(&self, wo: DVec3, wi: DVec3) -> f64 {
        let (o, i) = (self.lambda(wo), self.lambda(wi));
        match self.shadowing {
            Shadowing::HeightCorrelated => 1.0 / (1.0 + o + i),
            Shadowing::Separable => 1.0 / ((1.0 + o) * (1.0 + i)),
        }
    }
}

impl Brdf for Microfacet {
    fn evaluate(&self, wo: DVec3, wi: DVec3) -> DVec3 {
        let h = (wo + wi).normalize();
        let facets = self.facets(h) * self.shadowing(wo, wi) / (4.0 * wo.z * wi.z);
        self.fresnel.reflectance(wo.dot(h)) * facets
    }

    /// Samples a facet that is visible from ωo.
    fn sample(&self, wo: DVec3, u: [f64; 2]) -> Option<DVec3> {
        let h = match self.distribution {
            Distribution::Beckmann => beckmann::visible(self.alpha, wo, u),
            Distribution::Ggx => ggx::visible(self.alpha, wo, u),
        };
        above(reflect(wo, h))
    }

    /// G1(ωo) D(h)/(4 cos θo) (Heitz and d'Eon, EGSR 2014, equations 2 and 17).
    fn density(&self, wo: DVec3, wi: DVec3) -> f64 {
        let h = (wo + wi).normalize();
        self.facets(h) / (4.0 * wo.z * (1.0 + self.lambda(wo)))
    }
}
