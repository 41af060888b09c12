//! Conversion of materials with specular parts to Lambertian materials.

use glam::DVec3;

use super::{Lobe, albedo::hemispherical_albedo, surface::Gloss};
use crate::scene::{Material, Scene, Specular};

/// Treatment of the specular part of a material in [`make_lambertian`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SpecularPart {
    /// The share of diffuse light that the specular part reflects is added to the diffuse reflectance. In six scenes this
    /// had the smaller error, by factors of 1.8 to 9 (`docs/reflection.md`).
    #[default]
    Diffuse,
    /// The specular part is dropped. The diffuse reflectance stays as in the file, and so does the base colour of a
    /// metal.
    Drop,
}

/// Converts all materials of a scene to Lambertian ones.
pub fn make_lambertian(scene: &mut Scene, part: SpecularPart) {
    for m in 0..scene.materials.len() {
        let mut material = scene.materials[m].clone();
        if let Some(specular) = material.specular.take()
            && part == SpecularPart::Diffuse
        {
            flatten(&mut material, scene, &specular);
        }
        scene.materials[m] = material;
    }
}

/// Converts a material to a Lambertian one with the same hemispherical albedo. The albedo is linear in the reflectance,
/// so it also holds for each texel of a texture.
fn flatten(material: &mut Material, scene: &Scene, specular: &Specular) {
    let (gloss, _) = Gloss::of(scene, material, specular, &mut Vec::new());
    let below = gloss.diffuse * gloss.coupling.as_ref().map_or(1.0, |c| c.mean());
    let reflectance = DVec3::from(material.reflectance);
    let (factor, offset) = if let Specular::MetallicRoughness { .. } = specular {
        // Schlick's reflectance is linear in r0 and so in the base colour, and the albedo with it.
        let [black, white] = [0.0, 1.0].map(|base| hemispherical_albedo(&Lobe::of(specular, [base; 3])));
        (reflectance * (below + white - black), black)
    } else {
        (reflectance * below, hemispherical_albedo(&gloss.lobe))
    };
    let (factor, offset) = (factor.min(DVec3::ONE), offset.min(DVec3::ONE));
    let offset = offset.min(DVec3::ONE - factor);
    if material.reflectance_map.is_some() || !scene.colours.is_empty() {
        (material.reflectance, material.reflectance_offset) = (factor.into(), offset.into());
    } else {
        material.reflectance = (factor + offset).into();
    }
}
