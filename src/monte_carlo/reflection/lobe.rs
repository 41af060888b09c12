//! The specular part of a material, by one of the models.

use glam::DVec3;

use super::{BlinnPhong, Brdf, DIELECTRIC, Microfacet, Mirror, Phong, Ward, alpha_of};
use crate::scene::{Distribution, Fresnel, Shadowing, Specular};

/// A specular lobe.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Lobe {
    /// A perfect mirror.
    Mirror(Mirror),
    /// Modified Phong.
    Phong(Phong),
    /// Blinn-Phong.
    BlinnPhong(BlinnPhong),
    /// Ward.
    Ward(Ward),
    /// Cook and Torrance's microfacets.
    Microfacet(Microfacet),
}

impl Lobe {
    /// The lobe of the specular part of a material. The reflectance of the material is the base colour of
    /// [`Specular::MetallicRoughness`]; other models ignore it.
    pub fn of(specular: &Specular, reflectance: [f64; 3]) -> Lobe {
        match *specular {
            Specular::Mirror(fresnel) => Lobe::Mirror(Mirror { fresnel }),
            Specular::Phong { reflectance, exponent } => {
                Lobe::Phong(Phong { reflectance: reflectance.into(), exponent })
            }
            Specular::BlinnPhong { reflectance, exponent } => {
                Lobe::BlinnPhong(BlinnPhong { reflectance: reflectance.into(), exponent })
            }
            Specular::Ward { reflectance, alpha } => {
                Lobe::Ward(Ward { reflectance: reflectance.into(), alpha })
            }
            Specular::Microfacet { distribution, alpha, fresnel, shadowing } => {
                Lobe::Microfacet(Microfacet::new(distribution, alpha, fresnel, shadowing))
            }
            Specular::MetallicRoughness { metallic, roughness, anisotropy } => {
                let r0 = reflectance.map(|base| (1.0 - metallic) * DIELECTRIC + metallic * base);
                let alpha = alpha_of(roughness, anisotropy);
                let fresnel = Fresnel::Schlick(r0);
                Lobe::Microfacet(Microfacet::new(
                    Distribution::Ggx,
                    alpha,
                    fresnel,
                    Shadowing::HeightCorrelated,
                ))
            }
        }
    }

    /// The model of the lobe.
    fn model(&self) -> &dyn Brdf {
        match self {
            Lobe::Mirror(m) => m,
            Lobe::Phong(m) => m,
            Lobe::BlinnPhong(m) => m,
            Lobe::Ward(m) => m,
            Lobe::Microfacet(m) => m,
        }
    }

    /// Whether it is a mirror.
    pub fn is_mirror(&self) -> bool {
        matches!(self, Lobe::Mirror(_))
    }

    /// Whether the lobe is anisotropic.
    pub fn is_anisotropic(&self) -> bool {
        match self {
            Lobe::Ward(m) => m.alpha[0] != m.alpha[1],
            Lobe::Microfacet(m) => m.is_anisotropic(),
            Lobe::Mirror(_) | Lobe::Phong(_) | Lobe::BlinnPhong(_) => false,
        }
    }

    /// The weight of a direction chosen by [`Brdf::sample`], per channel: f cos θi over the density, or the reflectance
    /// of a mirror.
    pub fn weight(&self, wo: DVec3, wi: DVec3) -> DVec3 {
        if let Lobe::Mirror(mirror) = self {
            return mirror.fresnel.reflectance(wo.z);
        }
        let density = self.density(wo, wi);
        if density > 0.0 { self.evaluate(wo, wi) * (wi.z / density) } else { DVec3::ZERO }
    }

    /// Approximate share of light that the lobe reflects to ωo, for the choice between the lobe and the diffuse part.
    pub(super) fn about(&self, wo: DVec3) -> f64 {
        let reflectance = match self {
            Lobe::Mirror(m) => m.fresnel.reflectance(wo.z),
            Lobe::Phong(m) => m.reflectance,
            Lobe::BlinnPhong(m) => m.reflectance,
            Lobe::Ward(m) => m.reflectance,
            Lobe::Microfacet(m) => m.fresnel().reflectance(wo.z),
        };
        reflectance.element_sum() / 3.0
    }

    /// Largest share of light that the lobe reflects at any angle, per channel. `None` for a Fresnel term, which
    /// reaches 1.
    pub(super) fn bound(&self) -> Option<DVec3> {
        match self {
            Lobe::Mirror(m) => m.fresnel.is_constant().then(|| m.fresnel.reflectance(1.0)),
            Lobe::Phong(m) => Some(m.reflectance),
            Lobe::BlinnPhong(m) => Some(m.reflectance),
            Lobe::Ward(m) => Some(m.reflectance),
            Lobe::Microfacet(m) => m.fresnel().is_constant().then(|| m.fresnel().reflectance(1.0)),
        }
    }

    /// The lobe with its constant reflectance multiplied by a factor. Other Fresnel terms stay as they are.
    pub(super) fn scaled(self, factor: f64) -> Lobe {
        let fresnel = |fresnel: &Fresnel| match *fresnel {
            Fresnel::Constant(r) => Fresnel::Constant(r.map(|r| factor * r)),
            other => other,
        };
        match self {
            Lobe::Mirror(m) => Lobe::Mirror(Mirror { fresnel: fresnel(&m.fresnel) }),
            Lobe::Phong(m) => Lobe::Phong(Phong { reflectance: factor * m.reflectance, ..m }),
            Lobe::BlinnPhong(m) => Lobe::BlinnPhong(BlinnPhong { reflectance: factor * m.reflectance, ..m }),
            Lobe::Ward(m) => Lobe::Ward(Ward { reflectance: factor * m.reflectance, ..m }),
            Lobe::Microfacet(m) => Lobe::Microfacet(m.with_fresnel(fresnel(m.fresnel()))),
        }
    }
}

impl Brdf for Lobe {
    fn evaluate(&self, wo: DVec3, wi: DVec3) -> DVec3 {
        self.model().evaluate(wo, wi)
    }

    fn sample(&self, wo: DVec3, u: [f64; 2]) -> Option<DVec3> {
        self.model().sample(wo, u)
    }

    fn density(&self, wo: DVec3, wi: DVec3) -> f64 {
        self.model().density(wo, wi)
    }
}
