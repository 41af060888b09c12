//! Reflection at a point of a scene, with its diffuse and specular parts.

use std::{f64::consts::PI, sync::Arc};

use glam::{DVec3, Vec3A};

use super::{Brdf, Lambert, Lobe, metallic_roughness::Coupling};
use crate::{
    monte_carlo::Samples,
    scene::{Material, Scene, Specular},
    trace::{Hit, UnitTriangle},
};

/// The specular parts of a scene's materials, prepared for sampling.
#[derive(Debug, Clone, Default)]
pub struct Surfaces {
    /// One entry per material. Empty if no material has a specular part.
    glosses: Vec<Option<Gloss>>,
    warnings: Vec<String>,
}

/// The specular part of a material, and the share of light that it leaves for the diffuse part.
#[derive(Debug, Clone)]
pub(super) struct Gloss {
    pub(super) lobe: Lobe,
    /// The share of light that the lobe leaves for the diffuse part. `None` if it does not depend on the angle.
    pub(super) coupling: Option<Arc<Coupling>>,
    /// Factor of the diffuse part.
    pub(super) diffuse: f64,
    /// Whether textures and vertex colours apply to the lobe, as for metals.
    is_textured: bool,
}

impl Surfaces {
    /// Prepares the materials of a scene.
    pub fn of(scene: &Scene) -> Surfaces {
        let mut surfaces = Surfaces::default();
        if !scene.has_specular() {
            return surfaces;
        }
        let mut known = Vec::new();
        for material in &scene.materials {
            let gloss = material.specular.as_deref().map(|specular| {
                let (gloss, excess) = Gloss::of(scene, material, specular, &mut known);
                if let Some(sum) = excess {
                    surfaces.warnings.push(format!(
                        "material `{}`: diffuse and specular reflectance sum to {sum:.3}; both are divided by this sum",
                        material.name
                    ));
                }
                gloss
            });
            surfaces.glosses.push(gloss);
        }
        surfaces
    }

    /// Whether all surfaces are Lambertian.
    pub fn is_lambertian(&self) -> bool {
        self.glosses.is_empty()
    }

    /// Whether any surface is a mirror. Light tracing cannot show reflections in mirrors.
    pub fn has_mirror(&self) -> bool {
        self.glosses.iter().flatten().any(|gloss| gloss.lobe.is_mirror())
    }

    /// A warning for each material that would reflect more light than it receives.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }
}

impl Gloss {
    /// The specular part of a material, and the sum of its reflectances if this sum is above 1. Materials with equal
    /// lobes share one table through `known`.
    pub(super) fn of(
        scene: &Scene,
        material: &Material,
        specular: &Specular,
        known: &mut Vec<(Lobe, Arc<Coupling>)>,
    ) -> (Gloss, Option<f64>) {
        let (coupled, share) = match *specular {
            // A metal has no diffuse part.
            Specular::MetallicRoughness { roughness, anisotropy, metallic, .. } => {
                let dielectric = Specular::MetallicRoughness { metallic: 0.0, roughness, anisotropy };
                (Lobe::of(&dielectric, [0.0; 3]), 1.0 - metallic)
            }
            _ => (Lobe::of(specular, material.reflectance), 1.0),
        };
        let mut gloss = Gloss {
            lobe: Lobe::of(specular, material.reflectance),
            coupling: None,
            diffuse: share,
            is_textured: matches!(specular, Specular::MetallicRoughness { .. })
                && (material.reflectance_map.is_some() || !scene.colours.is_empty()),
        };
        let Some(bound) = coupled.bound() else {
            let found = known.iter().find(|(lobe, _)| *lobe == coupled).map(|(_, c)| Arc::clone(c));
            gloss.coupling = Some(found.unwrap_or_else(|| {
                let made = Arc::new(Coupling::below(&coupled));
                known.push((coupled, Arc::clone(&made)));
                made
            }));
            return (gloss, None);
        };
        let brightest = match &material.reflectance_map {
            Some(map) => scene.textures[map.texture].brightest(),
            None => [1.0; 3],
        };
        let diffuse = DVec3::from(material.reflectance) * DVec3::from(brightest);
        let sum = (diffuse + bound).max_element();
        // Allows for the rounding of a sum that should be 1.
        if sum <= 1.0 + 1e-9 {
            return (gloss, None);
        }
        gloss.diffuse /= sum;
        gloss.lobe = gloss.lobe.scaled(1.0 / sum);
        (gloss, Some(sum))
    }
}

/// A sampled direction.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bounce {
    /// Unit vector.
    pub(crate) direction: Vec3A,
    /// f cos θ over the density, per channel.
    pub(crate) weight: DVec3,
    /// Probability per solid angle with which it is chosen; infinite for a mirror.
    pub(crate) density: f64,
}

/// A point of a surface with one fixed direction, from or to which light goes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Surface<'s> {
    /// Tangent, bitangent, normal.
    frame: [DVec3; 3],
    wo: DVec3,
    diffuse: Lambert,
    specular: Option<(Lobe, Option<&'s Coupling>)>,
    /// Probability of sampling the specular lobe.
    share: f64,
}

/// Smallest probability of sampling the diffuse or the specular part if there are both. A part that reflects little on
/// average may reflect more at some angles.
const LEAST_SHARE: f64 = 0.05;

/// Smaller cosines are rounding errors of directions and normals in single precision.
const LEAST_COS: f64 = 1e-6;

impl<'s> Surface<'s> {
    /// A surface for estimating irradiance: it has the cosine weight of a Lambertian surface of reflectance 1.
    pub(crate) fn receiver(normal: Vec3A) -> Surface<'s> {
        let diffuse = Lambert { reflectance: DVec3::ONE };
        let frame = frame(normal, None);
        Surface { frame, wo: DVec3::Z, diffuse, specular: None, share: 0.0 }
    }

    /// The surface at a hit, on the side that was hit. `direction` is the unit direction of the ray.
    pub(crate) fn met(
        surfaces: &'s Surfaces,
        scene: &Scene,
        triangle: &UnitTriangle,
        hit: &Hit,
        direction: Vec3A,
    ) -> Surface<'s> {
        let t = hit.triangle as usize;
        let mut diffuse = DVec3::from(hit.reflectance(scene));
        let normal = triangle.side_normal(hit.front);
        let Some(Some(gloss)) = surfaces.glosses.get(scene.triangles[t].material as usize) else {
            return Surface { diffuse: Lambert { reflectance: diffuse }, ..Surface::receiver(normal) };
        };
        let frame = frame(normal, gloss.lobe.is_anisotropic().then(|| along_u(scene, t)).flatten());
        let mut wo = local(&frame, -direction.as_dvec3());
        wo.z = wo.z.max(LEAST_COS);
        wo = wo.normalize();
        let lobe = match scene.material(t).specular.as_deref() {
            Some(specular) if gloss.is_textured => Lobe::of(specular, diffuse.into()),
            _ => gloss.lobe,
        };
        diffuse *= gloss.diffuse;
        let below = diffuse.element_sum() / 3.0 * gloss.coupling.as_ref().map_or(1.0, |c| c.left(wo.z));
        let share = match (lobe.about(wo), below) {
            (_, 0.0) => 1.0,
            (specular, below) => (specular / (specular + below)).clamp(LEAST_SHARE, 1.0 - LEAST_SHARE),
        };
        let specular = Some((lobe, gloss.coupling.as_deref()));
        Surface { frame, wo, diffuse: Lambert { reflectance: diffuse }, specular, share }
    }

    /// The BRDF in the direction of a unit vector, without mirror reflection.
    pub(crate) fn brdf(&self, direction: Vec3A) -> DVec3 {
        let wi = local(&self.frame, direction.as_dvec3());
        if wi.z > 0.0 { self.evaluate(wi) } else { DVec3::ZERO }
    }

    /// f cos θ in the direction of a unit vector, and the density of sampling this direction. Mirror reflection is not
    /// included.
    pub(crate) fn towards(&self, direction: Vec3A) -> (DVec3, f64) {
        let wi = local(&self.frame, direction.as_dvec3());
        if wi.z > 0.0 { (self.evaluate(wi) * wi.z, self.density(wi)) } else { (DVec3::ZERO, 0.0) }
    }

    /// Samples the direction in which the path continues. `None` if the light is lost.
    pub(crate) fn sample(&self, samples: &mut Samples) -> Option<Bounce> {
        // Takes one number and one pair for every material, so that runs with other materials stay correlated.
        let choice = f64::from(samples.number());
        let u = samples.square().map(f64::from);
        let lobe = self.specular.map(|(lobe, _)| lobe).filter(|_| choice < self.share);
        let (wi, weight, density) = match lobe {
            Some(lobe) if lobe.is_mirror() => {
                let wi = lobe.sample(self.wo, u)?;
                (wi, lobe.weight(self.wo, wi) / self.share, f64::INFINITY)
            }
            _ => {
                let wi = match lobe {
                    Some(lobe) => lobe.sample(self.wo, u)?,
                    None => self.diffuse.sample(self.wo, u)?,
                };
                let density = self.density(wi);
                (wi, if density > 0.0 { self.evaluate(wi) * (wi.z / density) } else { DVec3::ZERO }, density)
            }
        };
        let [tangent, bitangent, normal] = self.frame;
        let direction = (tangent * wi.x + bitangent * wi.y + normal * wi.z).as_vec3a();
        Some(Bounce { direction, weight, density })
    }

    fn evaluate(&self, wi: DVec3) -> DVec3 {
        let diffuse = self.diffuse.evaluate(self.wo, wi);
        match &self.specular {
            None => diffuse,
            Some((lobe, coupling)) => {
                let left = coupling.map_or(1.0, |c| c.factor(self.wo, wi));
                diffuse * left + lobe.evaluate(self.wo, wi)
            }
        }
    }

    fn density(&self, wi: DVec3) -> f64 {
        let specular = self.specular.as_ref().map_or(0.0, |(lobe, _)| lobe.density(self.wo, wi));
        (1.0 - self.share) * wi.z / PI + self.share * specular
    }
}

/// Converts a unit vector to the frame.
fn local(frame: &[DVec3; 3], w: DVec3) -> DVec3 {
    DVec3::new(w.dot(frame[0]), w.dot(frame[1]), w.dot(frame[2]))
}

/// A frame around the normal whose tangent is as close as possible to the given one.
fn frame(normal: Vec3A, tangent: Option<DVec3>) -> [DVec3; 3] {
    let normal = normal.as_dvec3().normalize();
    let (tangent, bitangent) = match tangent.and_then(|t| t.reject_from_normalized(normal).try_normalize()) {
        Some(tangent) => (tangent, normal.cross(tangent)),
        None => normal.any_orthonormal_pair(),
    };
    [tangent, bitangent, normal]
}

/// The direction in which the texture coordinate u grows; `None` if the triangle has no texture coordinates.
fn along_u(scene: &Scene, t: usize) -> Option<DVec3> {
    let [a, b, c] = scene.corners(t);
    let [p, q, r] = *scene.texcoords.get(t)?;
    let (q, r) = (q - p, r - p);
    ((b - a) * r.y - (c - a) * q.y).try_normalize().map(|u| u * (q.perp_dot(r)).signum())
}
