//! The reflection of a material, whichever way the file describes it.

use super::document::{self, MaterialExtensions, TextureInfo};

/// The colours and textures that determine the reflection of a material.
pub struct Surface<'a> {
    /// Base colour; `None` if the file gives none.
    pub colour: Option<[f64; 3]>,
    /// Factor of the texture's alpha.
    pub alpha: f64,
    pub texture: Option<&'a TextureInfo>,
    pub metallic: f64,
    pub metal_texture: Option<&'a TextureInfo>,
    /// Whether the file has no metallic or roughness factor or texture for the material.
    pub lacks_metal: bool,
    pub gloss: Option<Gloss>,
}

/// The microfacets on top of the diffuse part. A metal has no diffuse part.
pub struct Gloss {
    /// Reflectance of a dielectric at normal incidence.
    pub dielectric: [f64; 3],
    /// Perceptual roughness: the square root of GGX's alpha. A factor of the green channel of
    /// [`Surface::metal_texture`].
    pub roughness: f64,
}

impl<'a> Surface<'a> {
    pub fn of(definition: &'a document::Material) -> Surface<'a> {
        let colour = |factor: Option<[f64; 4]>| factor.map_or([1.0; 3], |[r, g, b, _]| [r, g, b]);
        let alpha = |factor: Option<[f64; 4]>| factor.map_or(1.0, |[.., a]| a);
        let extensions = &definition.extensions;
        let plain = Surface {
            colour: Some([1.0; 3]),
            alpha: 1.0,
            texture: None,
            metallic: 0.0,
            metal_texture: None,
            lacks_metal: false,
            gloss: None,
        };
        if let Some(old) = &extensions.specular_glossiness {
            return Surface {
                colour: Some(colour(old.diffuse_factor)),
                alpha: alpha(old.diffuse_factor),
                texture: old.diffuse_texture.as_ref(),
                ..plain
            };
        }
        let Some(pbr) = &definition.pbr_metallic_roughness else {
            return Surface { lacks_metal: true, ..plain };
        };
        // By default, everything is a metal of full roughness (section 5.22), which resembles a diffuse surface more
        // than a black one. A file with a metal on purpose gives its roughness.
        let silent = pbr.metallic_factor.is_none()
            && pbr.roughness_factor.is_none()
            && pbr.metallic_roughness_texture.is_none();
        let is_unlit = extensions.unlit.is_some();
        Surface {
            colour: Some(colour(pbr.base_color_factor)),
            alpha: alpha(pbr.base_color_factor),
            texture: pbr.base_color_texture.as_ref(),
            metallic: if silent || is_unlit { 0.0 } else { pbr.metallic_factor.unwrap_or(1.0) },
            metal_texture: pbr.metallic_roughness_texture.as_ref(),
            lacks_metal: silent && !is_unlit,
            gloss: (!silent && !is_unlit).then(|| Gloss {
                dielectric: dielectric(extensions),
                roughness: pbr.roughness_factor.unwrap_or(1.0),
            }),
        }
    }
}

/// Reflectance of a dielectric at normal incidence: Fresnel's ((n - 1)/(n + 1))², tinted and weakened by
/// KHR_materials_specular. The index of refraction n comes from KHR_materials_ior and is 1.5 by default.
fn dielectric(extensions: &MaterialExtensions) -> [f64; 3] {
    let n = extensions.ior.as_ref().and_then(|ior| ior.ior).unwrap_or(1.5);
    // In the extension, 0 stands for an infinite index.
    let r0 = if n == 0.0 { 1.0 } else { ((n - 1.0) / (n + 1.0)).powi(2) };
    let specular = extensions.specular.as_ref();
    let tint = specular.and_then(|s| s.specular_color_factor).unwrap_or([1.0; 3]);
    let strength = specular.and_then(|s| s.specular_factor).unwrap_or(1.0);
    tint.map(|tint| ((r0 * tint).min(1.0) * strength).clamp(0.0, 1.0))
}

/// The textures that determine reflectance and emission.
pub fn textures_of(definition: &document::Material) -> Vec<&TextureInfo> {
    let surface = Surface::of(definition);
    let all = [surface.texture, surface.metal_texture, definition.emissive_texture.as_ref()];
    all.into_iter().flatten().collect()
}
