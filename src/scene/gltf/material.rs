//! Converts materials of glTF: reflectance and emission, with warnings about the rest.

use std::collections::HashMap;
use std::path::PathBuf;
use std::rc::Rc;

use glam::DVec2;

use super::container::Document;
use super::document::{self, TextureInfo, TextureTransform};
use super::images::{Image, mirrored, without_metal};
use super::surface::{Surface, textures_of};
use crate::Result;
use crate::scene::texture;
use crate::scene::{
    Distribution, Fresnel, LEAST_ALPHA, LoadOptions, MOST_RADIANCE, Material, Shadowing, Specular, Texture,
    TextureMap, is_radiance, warnings::Warnings,
};

/// The texture coordinates of a map.
#[derive(Debug, Clone, PartialEq)]
pub struct Lookup {
    /// The number of TEXCOORD.
    pub set: u32,
    transform: Option<TextureTransform>,
}

impl Lookup {
    fn of(info: &TextureInfo) -> Lookup {
        let transform = info.extensions.transform.clone();
        let set = transform.as_ref().and_then(|t| t.tex_coord).unwrap_or(info.tex_coord);
        Lookup { set, transform: transform.map(|t| TextureTransform { tex_coord: None, ..t }) }
    }

    /// Converts texture coordinates of the file to coordinates of the scene, with v upwards.
    ///
    /// KHR_texture_transform scales, rotates and then moves. The text of its specification and the example there rotate
    /// in opposite directions. Viewers follow the example, and so does this function.
    pub fn apply(&self, uv: DVec2) -> DVec2 {
        let uv = match &self.transform {
            None => uv,
            Some(transform) => {
                let scaled = uv * DVec2::from(transform.scale.unwrap_or([1.0; 2]));
                let (sin, cos) = transform.rotation.unwrap_or(0.0).sin_cos();
                let turned = DVec2::new(cos * scaled.x + sin * scaled.y, cos * scaled.y - sin * scaled.x);
                turned + DVec2::from(transform.offset.unwrap_or([0.0; 2]))
            }
        };
        let flipped = DVec2::new(uv.x, 1.0 - uv.y);
        if flipped.is_finite() { flipped } else { DVec2::ZERO }
    }
}

/// Channels of a metallic-roughness texture.
const ROUGHNESS: usize = 1;
const METAL: usize = 2;

/// A material of the scene, and how a primitive uses it.
#[derive(Debug, Clone)]
pub struct Made {
    /// Index into the scene's materials.
    pub index: u32,
    /// The texture coordinates of the reflectance texture and of the emission texture.
    pub reflectance: Option<Lookup>,
    pub emission: Option<Lookup>,
    /// Whether backs of its triangles emit too.
    pub both_sides_emit: bool,
}

/// The continuation of an image outside 0..1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Wrap {
    Repeat,
    Clamp,
    Mirror,
}

/// The steps that make a texture of an image. The image may be extended by its mirror image, multiplied by the share
/// that is not metal, or replaced by a mask of its holes.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Prepared {
    image: Option<usize>,
    wrap: [Wrap; 2],
    /// The image of the metallic channel, and the bits of its factor.
    metal: Option<(usize, u64)>,
    /// For a mask, the bits of the smallest alpha that is not a hole.
    mask: Option<u64>,
}

/// The use of an image.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Taken {
    /// The colours.
    Colour,
    /// The colours, or white, times the share that is not metal. The share follows from the metallic image and factor.
    WithoutMetal(usize, f64),
    /// A mask: solid where alpha, from 0 to 255, is at least this.
    Mask(f64),
}

/// Makes the materials that primitives use, each once.
pub struct Materials<'a> {
    document: &'a Document,
    options: &'a LoadOptions,
    pub materials: Vec<Material>,
    pub textures: Vec<Texture>,
    pub warnings: Warnings,
    /// Image files that were read.
    pub files: Vec<PathBuf>,
    /// Names of images that could not be read.
    pub missing: Vec<String>,
    /// Materials. The key is the index in the file and the missing sets of texture coordinates.
    made: HashMap<(Option<usize>, Vec<u32>), Made>,
    images: HashMap<usize, Option<Rc<Image>>>,
    prepared: HashMap<Prepared, Option<usize>>,
}

impl<'a> Materials<'a> {
    pub fn new(document: &'a Document, options: &'a LoadOptions) -> Self {
        Materials {
            document,
            options,
            materials: Vec::new(),
            textures: Vec::new(),
            warnings: Warnings::default(),
            files: Vec::new(),
            missing: Vec::new(),
            made: HashMap::new(),
            images: HashMap::new(),
            prepared: HashMap::new(),
        }
    }

    /// Material `id` for a primitive. `has` returns whether the primitive has a set of texture coordinates.
    ///
    /// # Errors
    /// [`Error::Input`](crate::Error::Input) when the material is missing or has values that no surface can have.
    pub fn index(&mut self, id: Option<usize>, has: impl Fn(u32) -> bool) -> Result<Made> {
        let definition = match id {
            None => None,
            Some(id) => Some(self.document.root.materials.get(id).ok_or_else(|| {
                self.document.error(format!("materials[{id}] does not exist, but a primitive names it"))
            })?),
        };
        let mut absent: Vec<u32> = definition
            .into_iter()
            .flat_map(textures_of)
            .map(|info| Lookup::of(info).set)
            .filter(|&set| !has(set))
            .collect();
        absent.sort_unstable();
        absent.dedup();
        let key = (id, absent);
        if let Some(made) = self.made.get(&key) {
            return Ok(made.clone());
        }
        let made = match (id, definition) {
            (Some(id), Some(definition)) => {
                let first = !self.made.keys().any(|(known, _)| *known == Some(id));
                self.convert(id, definition, &key.1, first)?
            }
            _ => self.without_material(),
        };
        self.made.insert(key, made.clone());
        Ok(made)
    }

    fn without_material(&mut self) -> Made {
        if self.options.reflectance.is_none() {
            self.warnings.push(format!(
                "{}: surfaces without a material get {}",
                self.document.path.display(),
                self.options.default_in_words()
            ));
        }
        self.push(Material::new("(none)", self.options.default_reflectance(), [0.0; 3]), [None, None], false)
    }

    fn push(&mut self, material: Material, [reflectance, emission]: [Option<Lookup>; 2], both: bool) -> Made {
        let index = self.materials.len() as u32;
        self.materials.push(material);
        Made { index, reflectance, emission, both_sides_emit: both }
    }

    fn warn(&mut self, name: &str, after: &str) {
        self.warnings.repeat(self.document.path.display().to_string(), "material", name, after);
    }

    fn convert(
        &mut self,
        id: usize,
        definition: &document::Material,
        absent: &[u32],
        first: bool,
    ) -> Result<Made> {
        let name = definition.name.clone().unwrap_or_else(|| format!("material {id}"));
        let failed = |what: String| self.document.error(format!("materials[{id}] (`{name}`): {what}"));
        let surface = Surface::of(definition);
        if let Some(bad) = surface.colour.iter().flatten().find(|r| !(0.0..=1.0).contains(*r)) {
            return Err(failed(format!("reflectance {bad} is outside 0..1")).with_hint(
                "a surface cannot give back more light than it gets: scale its base colour into 0..1",
            ));
        }
        if !(0.0..=1.0).contains(&surface.metallic) {
            return Err(failed(format!("metallicFactor {} is outside 0..1", surface.metallic)));
        }
        if let Some(gloss) = surface.gloss.as_ref().filter(|gloss| !(0.0..=1.0).contains(&gloss.roughness)) {
            return Err(failed(format!("roughnessFactor {} is outside 0..1", gloss.roughness)));
        }
        let strength = definition.extensions.emissive_strength.as_ref().and_then(|e| e.emissive_strength);
        let factor = definition.emissive_factor.unwrap_or_default();
        let mut emission = factor.map(|e| e * strength.unwrap_or(1.0));
        if let Some(bad) = factor.iter().chain(&strength).chain(&emission).find(|&&l| !is_radiance(l)) {
            return Err(failed(format!("emission {bad:?} is not a number from 0 to {MOST_RADIANCE:e}")));
        }
        if first {
            self.warn_left_out(&name, definition, &surface);
        }
        let usable = |info: &TextureInfo| !absent.contains(&Lookup::of(info).set);
        if first && !absent.is_empty() {
            self.warn(
                &name,
                " is used where there are no texture coordinates for it; its texture has no effect there",
            );
        }
        let emission_map = definition.emissive_texture.as_ref().filter(|_| emission != [0.0; 3]);
        let mut emission_map = match emission_map {
            None => None,
            Some(info) => {
                let map = Some(info)
                    .filter(|info| usable(info))
                    .map(|info| (info, self.map(info, Taken::Colour, &name, "it does not emit")));
                match map {
                    Some((info, Some(map))) => Some((Lookup::of(info), map)),
                    // A surface without its emission texture is dark, because it would otherwise be bright all over.
                    _ => {
                        emission = [0.0; 3];
                        None
                    }
                }
            }
        };
        let (mut reflectance, mut reflectance_map) = self.reflectance(&name, &surface, usable);
        let unlit = definition.extensions.unlit.is_some();
        if unlit && self.options.unlit_emits {
            (emission, emission_map) = (reflectance, reflectance_map);
            (reflectance, reflectance_map) = ([0.0; 3], None);
        }
        let both = definition.double_sided && emission != [0.0; 3];
        let (reflectance_lookup, reflectance_map) = reflectance_map.unzip();
        let (emission_lookup, emission_map) = emission_map.unzip();
        let (cutout, absent) = self.holes(&name, definition, &surface, usable);
        let specular = self.specular(&name, &surface, usable).map(Box::new);
        let plain = Material::new(&name, reflectance, emission);
        let material = Material { reflectance_map, emission_map, cutout, absent, specular, ..plain };
        Ok(self.push(material, [reflectance_lookup, emission_lookup], both))
    }

    /// The diffuse reflectance and its texture: the base colour times the share that is not metal.
    fn reflectance(
        &mut self,
        name: &str,
        surface: &Surface,
        usable: impl Fn(&TextureInfo) -> bool,
    ) -> ([f64; 3], Option<(Lookup, TextureMap)>) {
        let base = surface.texture.filter(|info| usable(info));
        let metal = surface.metal_texture.filter(|info| usable(info) && surface.metallic > 0.0);
        let alike = |a: &TextureInfo, b: &TextureInfo| {
            Lookup::of(a) == Lookup::of(b) && self.wraps(a) == self.wraps(b)
        };
        let mut dielectric = 1.0 - surface.metallic;
        let mut composed = None;
        if let Some(metal) = metal {
            if base.is_none_or(|base| alike(base, metal)) {
                composed = Some(metal);
                dielectric = 1.0;
            } else {
                // The two layouts rarely differ on one surface. If they do, the mean conserves energy.
                let image = self.image_of(metal, name, "only the metallic factor counts");
                dielectric = 1.0 - surface.metallic * image.map_or(1.0, |image| image.mean_of(METAL));
                self.warn(
                    name,
                    " has different texture coordinates for metal and base colour; the mean of the metal texture is used",
                );
            }
        }
        let mut colour = surface.colour;
        let mut map = None;
        if let Some(info) = base.or(composed) {
            let fallback = match colour {
                Some(_) => "its plain base colour is used".to_owned(),
                None => format!("{} is used", self.options.default_in_words()),
            };
            let taken = match composed.and_then(|metal| self.source(metal)) {
                Some(metal) => Taken::WithoutMetal(metal, surface.metallic),
                None => Taken::Colour,
            };
            map = match base {
                Some(base) => self.map(base, taken, name, &fallback),
                None => self.prepare(None, info, taken, name, &fallback),
            }
            .map(|map| (Lookup::of(info), map));
            if map.is_none() {
                dielectric = 1.0 - surface.metallic;
                colour = Some(colour.unwrap_or_else(|| self.options.default_reflectance()));
            }
        }
        (colour.unwrap_or([1.0; 3]).map(|c| c * dielectric), map)
    }

    /// The mask of the holes of a material with alphaMode MASK, and whether all of the material is a hole.
    fn holes(
        &mut self,
        name: &str,
        definition: &document::Material,
        surface: &Surface,
        usable: impl Fn(&TextureInfo) -> bool,
    ) -> (Option<TextureMap>, bool) {
        if definition.alpha_mode.as_deref() != Some("MASK") {
            return (None, false);
        }
        let cutoff = definition.alpha_cutoff.unwrap_or(0.5);
        if surface.alpha < cutoff {
            return (None, true);
        }
        let textured = surface.texture.filter(|info| usable(info) && surface.alpha > 0.0);
        let least = Taken::Mask(255.0 * cutoff / surface.alpha);
        (textured.and_then(|info| self.map(info, least, name, "it has no holes")), false)
    }

    /// The specular reflection of a material: GGX's microfacets (appendix B). Textures count with their means.
    fn specular(
        &mut self,
        name: &str,
        surface: &Surface,
        usable: impl Fn(&TextureInfo) -> bool,
    ) -> Option<Specular> {
        let gloss = surface.gloss.as_ref()?;
        let mut mean = |info: Option<&TextureInfo>| {
            let info = info.filter(|info| usable(info))?;
            self.image_of(info, name, "only its factors count")
        };
        let metal = mean(surface.metal_texture);
        let mean_of = |channel| metal.as_ref().map_or(1.0, |image| image.mean_of(channel));
        let metallic = surface.metallic * mean_of(METAL);
        let roughness = gloss.roughness * mean_of(ROUGHNESS);
        // Only the specular reflection of metals has the base colour.
        let base = mean(surface.texture.filter(|_| metallic > 0.0)).map_or([1.0; 3], |image| image.mean());
        let colour = surface.colour.unwrap_or([1.0; 3]);
        let r0: [f64; 3] =
            std::array::from_fn(|c| (1.0 - metallic) * gloss.dielectric[c] + metallic * colour[c] * base[c]);
        (r0 != [0.0; 3]).then_some(Specular::Microfacet {
            distribution: Distribution::Ggx,
            alpha: [(roughness * roughness).max(LEAST_ALPHA); 2],
            fresnel: Fresnel::Schlick(r0),
            shadowing: Shadowing::HeightCorrelated,
        })
    }

    fn map(&mut self, info: &TextureInfo, taken: Taken, name: &str, fallback: &str) -> Option<TextureMap> {
        match self.source(info) {
            Some(image) => self.prepare(Some(image), info, taken, name, fallback),
            None => {
                self.warn(name, &format!(" has a texture without a readable image; {fallback}"));
                None
            }
        }
    }

    /// Makes the texture of an image for its use by `info`, once for each use.
    fn prepare(
        &mut self,
        image: Option<usize>,
        info: &TextureInfo,
        taken: Taken,
        name: &str,
        fallback: &str,
    ) -> Option<TextureMap> {
        let wrap = self.wraps(info);
        let mut key = Prepared { image, wrap, metal: None, mask: None };
        match taken {
            Taken::Colour => {}
            Taken::WithoutMetal(image, factor) => key.metal = Some((image, factor.to_bits())),
            Taken::Mask(least) => key.mask = Some(least.to_bits()),
        }
        let index = match self.prepared.get(&key) {
            Some(&known) => known,
            None => {
                let texture = self.texture(&key, name, fallback);
                let index = texture.map(|texture| {
                    self.textures.push(texture);
                    self.textures.len() - 1
                });
                self.prepared.insert(key, index);
                index
            }
        };
        // With its mirror image, an image has twice the length.
        let side = |wrap| if wrap == Wrap::Mirror { 0.5 } else { 1.0 };
        let scale = DVec2::new(side(wrap[0]), side(wrap[1]));
        // v points up, and the original is the upper half: its lower end is halfway up.
        let offset = DVec2::new(0.0, 1.0 - scale.y);
        if wrap.contains(&Wrap::Clamp) && wrap[0] != wrap[1] {
            self.warn(
                name,
                " repeats a texture in one direction only; the texture is not repeated in either",
            );
        }
        Some(TextureMap { scale, offset, clamp: wrap.contains(&Wrap::Clamp), ..TextureMap::new(index?) })
    }

    fn texture(&mut self, key: &Prepared, name: &str, fallback: &str) -> Option<Texture> {
        let base = match key.image {
            Some(image) => Some(self.image(image, name, fallback)?),
            None => None,
        };
        let metal = match key.metal {
            Some((image, factor)) => self
                .image(image, name, "only the metallic factor counts")
                .map(|image| (image, f64::from_bits(factor))),
            None => None,
        };
        let composed = match (base, metal, key.mask) {
            (base, Some((metal, factor)), _) => {
                without_metal(base.as_ref().map(|base| &base.colour), &metal.colour, factor)
            }
            (Some(base), None, Some(least)) => base.mask(f64::from_bits(least))?,
            (Some(base), None, None) => base.colour.clone(),
            (None, None, _) => return None,
        };
        let composed = mirrored(composed, key.wrap.map(|wrap| wrap == Wrap::Mirror));
        let (width, height) = (composed.width() as usize, composed.height() as usize);
        let texture = Texture::new(width, height, composed.into_raw());
        Some(if key.mask.is_some() { texture.into_mask() } else { texture })
    }

    fn wraps(&self, info: &TextureInfo) -> [Wrap; 2] {
        let root = &self.document.root;
        let sampler = root.textures.get(info.index).and_then(|texture| root.samplers.get(texture.sampler?));
        let wrap = |code: Option<u64>| match code {
            Some(33071) => Wrap::Clamp,
            Some(33648) => Wrap::Mirror,
            _ => Wrap::Repeat,
        };
        sampler.map_or([Wrap::Repeat; 2], |sampler| [wrap(sampler.wrap_s), wrap(sampler.wrap_t)])
    }

    /// The image of a texture. A WebP image is preferred to its replacement.
    fn source(&self, info: &TextureInfo) -> Option<usize> {
        let texture = self.document.root.textures.get(info.index)?;
        let webp = texture.extensions.webp.as_ref().and_then(|webp| webp.source);
        webp.or(texture.source)
    }

    fn image_of(&mut self, info: &TextureInfo, name: &str, fallback: &str) -> Option<Rc<Image>> {
        self.source(info).and_then(|image| self.image(image, name, fallback))
    }

    /// Image `i`. Each image is read once, and causes one warning if it is absent or damaged.
    fn image(&mut self, i: usize, name: &str, fallback: &str) -> Option<Rc<Image>> {
        if let Some(known) = self.images.get(&i) {
            return known.clone();
        }
        let document = self.document;
        let read = document.image(i).and_then(|(bytes, file)| {
            self.files.extend(file);
            texture::decode(&bytes, None).map(Image::new)
        });
        let image = match read {
            Ok(image) => Some(Rc::new(image)),
            Err(why) => {
                self.warn(name, &format!(": images[{i}] cannot be read: {why}; {fallback}"));
                let uri = document.root.images.get(i).and_then(|image| image.uri.as_deref());
                let uri = uri.filter(|uri| !uri.starts_with("data:"));
                self.missing.push(uri.map_or(format!("images[{i}]"), Into::into));
                None
            }
        };
        self.images.insert(i, image.clone());
        image
    }

    /// Warns about properties of a material that are left out or changed.
    fn warn_left_out(&mut self, name: &str, definition: &document::Material, surface: &Surface) {
        if surface.metallic > 0.0 {
            let share = if surface.metal_texture.is_some() {
                "by its texture"
            } else {
                &*format!("{}", surface.metallic as f32)
            };
            self.warn(
                name,
                &format!(
                    " is metal ({share}), which has no diffuse reflection; the diffuse part of the metal is black"
                ),
            );
        }
        if surface.lacks_metal && self.options.reflectance.is_none() {
            self.warn(name, " has neither a metallic factor nor a roughness factor; it counts as diffuse");
        }
        if definition.alpha_mode.as_deref() == Some("BLEND") {
            self.warn(name, " is transparent (alphaMode BLEND); it counts as opaque");
        }
        if definition.extensions.transmission.as_ref().is_some_and(|t| t.transmission_factor > 0.0) {
            self.warn(name, " lets light through (KHR_materials_transmission); it counts as opaque");
        }
        if definition.extensions.unlit.is_some() && !self.options.unlit_emits {
            self.warn(name, " is unlit (KHR_materials_unlit); its colour counts as reflectance");
        }
        if definition.emissive_factor.is_some_and(|factor| factor.iter().any(|&e| e > 1.0)) {
            self.warn(
                name,
                " has an emissiveFactor above 1, against the specification; the factor is used all the same",
            );
        }
        let textures = &self.document.root.textures;
        let basis =
            |info: &TextureInfo| textures.get(info.index).is_some_and(|t| t.extensions.basis.is_some());
        if textures_of(definition).into_iter().any(basis) {
            self.warn(
                name,
                " has a Basis texture (KHR_texture_basisu), which is not read; its replacement is used if there is one",
            );
        }
    }
}
