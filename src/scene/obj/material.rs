//! The layer after tobj: converts its materials to [`Material`] and checks their values.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use glam::DVec2;

use super::map_line;
use super::mtl::Origin;
use crate::Result;
use crate::scene::text::find_file;
use crate::scene::{
    Fresnel, LoadOptions, MOST_EXPONENT, MOST_RADIANCE, Material, Specular, Texture, TextureMap, is_radiance,
    warnings::Warnings,
};

/// Makes the materials that faces use, each once, in the order of first use.
pub(super) struct Materials {
    pub(super) options: LoadOptions,
    pub(super) materials: Vec<Material>,
    pub(super) textures: Vec<Texture>,
    pub(super) warnings: Warnings,
    /// Textures that were read.
    pub(super) files: Vec<PathBuf>,
    /// Names of textures that could not be read.
    pub(super) missing: Vec<String>,
    /// Materials. The key is the index of tobj, whether textures apply, and whether vertices have colours.
    made: HashMap<(Option<usize>, bool, bool), u32>,
    read: HashMap<PathBuf, Option<usize>>,
    absent: HashSet<(PathBuf, String)>,
    /// Textures with holes, by file and by whether black texels are the holes.
    masks: HashMap<(PathBuf, bool), Option<usize>>,
}

impl Materials {
    pub(super) fn new(options: LoadOptions) -> Self {
        Materials {
            options,
            materials: Vec::new(),
            textures: Vec::new(),
            warnings: Warnings::default(),
            files: Vec::new(),
            missing: Vec::new(),
            made: HashMap::new(),
            read: HashMap::new(),
            absent: HashSet::new(),
            masks: HashMap::new(),
        }
    }

    /// The index of the material `id` for a face with or without texture coordinates, and with or without vertex
    /// colours.
    pub(super) fn index(
        &mut self,
        id: Option<usize>,
        (textured, coloured): (bool, bool),
        definitions: &[tobj::Material],
        origins: &[Origin],
    ) -> Result<u32> {
        let has = |i: usize, map: &str| map_of(&definitions[i], map).is_some();
        let maps = id.is_some_and(|i| ["map_Kd", "map_Ke", "map_d"].into_iter().any(|map| has(i, map)));
        let key = (id, textured || !maps, coloured);
        if let Some(&index) = self.made.get(&key) {
            return Ok(index);
        }
        let material = match id {
            Some(i) => {
                let first = !self.made.keys().any(|(known, ..)| *known == id);
                self.convert(&definitions[i], &origins[i], (key.1, coloured), first)?
            }
            None if coloured => Material::new("(none)", [1.0; 3], [0.0; 3]),
            None => Material::new("(none)", self.options.default_reflectance(), [0.0; 3]),
        };
        let index = self.materials.len() as u32;
        self.materials.push(material);
        self.made.insert(key, index);
        Ok(index)
    }

    fn convert(
        &mut self,
        definition: &tobj::Material,
        origin: &Origin,
        (textured, coloured): (bool, bool),
        first: bool,
    ) -> Result<Material> {
        origin.check()?;
        let name = &definition.name;
        if let Some(kd) = definition.diffuse
            && let Some(bad) = kd.iter().find(|r| !(0.0..=1.0).contains(*r))
        {
            return Err(origin
                .error("Kd", format!("material `{name}`: reflectance {bad} is outside 0..1"))
                .with_hint("a surface cannot give back more light than it gets: scale Kd into 0..1"));
        }
        if let Some(ke) = definition.emissive
            && let Some(bad) = ke.into_iter().find(|&l| !is_radiance(l))
        {
            let message =
                format!("material `{name}`: radiance {bad:?} is not a number from 0 to {MOST_RADIANCE:e}");
            return Err(origin.error("Ke", message));
        }
        if first {
            origin.notes.iter().for_each(|note| self.warnings.push(note.clone()));
            self.warn_left_out(definition, origin);
        }
        let cutout = if textured { self.cutout(definition, origin, first) } else { None };
        let maps = ["map_Kd", "map_Ke"].map(|statement| {
            map_of(definition, statement)
                .filter(|_| textured)
                .and_then(|value| self.map(statement, value, definition, origin))
        });
        let [reflectance_map, emission_map] = maps;
        if !textured {
            let after = " have no texture coordinates; they get no texture";
            self.warnings.repeat(origin.file.display().to_string(), "faces of material", name, after);
        }
        let has_colour = reflectance_map.is_some() || coloured;
        let plain = if has_colour { [1.0; 3] } else { self.options.default_reflectance() };
        let warned =
            coloured || map_of(definition, "map_Kd").is_some() || !origin.notes.is_empty() || !origin.defined;
        if definition.diffuse.is_none() && !warned && self.options.reflectance.is_none() {
            let after = format!(" has no Kd; {} is used", self.options.default_in_words());
            self.warnings.repeat(origin.place("newmtl"), "material", name, &after);
        }
        let specular = specular(definition);
        if first && let Some((statement, value)) = specular.clamped {
            let after = format!(": {statement} {value} is out of range; the nearest value is used");
            self.warnings.repeat(origin.place(statement), "material", name, &after);
        }
        let dark = if emission_map.is_some() { 1.0 } else { 0.0 };
        Ok(Material {
            name: name.clone(),
            reflectance: definition.diffuse.unwrap_or(plain),
            emission: definition.emissive.unwrap_or([dark; 3]),
            reflectance_map,
            emission_map,
            reflectance_offset: [0.0; 3],
            specular: specular.part.map(Box::new),
            cutout,
            absent: definition.dissolve == Some(0.0),
        })
    }

    /// The texture that gives the material its holes: `map_d`, or else the alpha of `map_Kd`.
    fn cutout(&mut self, definition: &tobj::Material, origin: &Origin, first: bool) -> Option<TextureMap> {
        for statement in ["map_d", "map_Kd"] {
            let Some(value) = map_of(definition, statement) else { continue };
            let line = map_line::parse(value);
            let folder = origin.file.parent().unwrap_or(Path::new(""));
            let Some(path) = find_file(folder, &line.file).map(|found| found.path) else {
                if statement == "map_d" && first {
                    let after = " not found; the material has no holes";
                    self.warnings.repeat(origin.place(statement), "texture", &line.file, after);
                    self.missing.push(line.file.clone());
                }
                continue;
            };
            if let Some(texture) = self.mask(&path, statement == "map_d") {
                let [scale, offset] = [line.scale, line.offset].map(DVec2::from_array);
                return Some(TextureMap { texture, scale, offset, clamp: line.clamp });
            }
        }
        None
    }

    /// The index of a texture with holes. With `whiteness`, black texels are holes if the alpha has none.
    fn mask(&mut self, path: &Path, whiteness: bool) -> Option<usize> {
        let path = path.canonicalize().unwrap_or(path.to_owned());
        *self.masks.entry((path.clone(), whiteness)).or_insert_with(|| {
            let texture = Texture::load(&path).ok()?;
            let texture = if whiteness { texture.into_mask() } else { texture };
            let index = texture.has_holes().then_some(self.textures.len())?;
            self.textures.push(texture);
            self.files.push(path);
            Some(index)
        })
    }

    fn map(
        &mut self,
        statement: &str,
        value: &str,
        definition: &tobj::Material,
        origin: &Origin,
    ) -> Option<TextureMap> {
        let line = map_line::parse(value);
        let place = origin.place(statement);
        if !line.ignored.is_empty() {
            self.warnings
                .push(format!("{place}: texture options without effect: {}", line.ignored.join(" ")));
        }
        let factor = if statement == "map_Kd" { definition.diffuse } else { definition.emissive };
        let texture = self.texture(&line.file, origin, &place, statement, factor)?;
        if factor == Some([0.0; 3]) {
            let colour = &statement[4..];
            self.warnings.push(format!("{place}: {statement} has no effect because {colour} is 0"));
        }
        let [scale, offset] = [line.scale, line.offset].map(DVec2::from_array);
        Some(TextureMap { texture, scale, offset, clamp: line.clamp })
    }

    /// The index of a texture. Each texture is read once, and causes one warning if it is missing or damaged.
    fn texture(
        &mut self,
        name: &str,
        origin: &Origin,
        place: &str,
        statement: &str,
        factor: Option<[f64; 3]>,
    ) -> Option<usize> {
        let folder = origin.file.parent().unwrap_or(Path::new(""));
        let instead = match (statement, factor) {
            ("map_Kd", Some(_)) => "plain Kd is used".to_string(),
            ("map_Kd", None) => format!("{} is used", self.options.default_in_words()),
            (_, Some(_)) => "plain Ke is used".to_string(),
            (_, None) => "the material does not emit".to_string(),
        };
        let Some(found) = find_file(folder, name) else {
            if self.absent.insert((folder.into(), name.into())) {
                let after = format!(" not found; {instead}");
                self.warnings.repeat(place.into(), "texture", name, &after);
                self.missing.push(name.into());
            }
            return None;
        };
        if found.elsewhere && self.absent.insert((folder.into(), name.into())) {
            let after = " is not where the library says; the one beside the scene is used";
            self.warnings.repeat(place.into(), "texture", name, after);
        }
        let path = found.path.canonicalize().unwrap_or(found.path);
        if let Some(&known) = self.read.get(&path) {
            return known;
        }
        let index = match Texture::load(&path) {
            Ok(texture) => {
                self.textures.push(texture);
                self.files.push(path.clone());
                Some(self.textures.len() - 1)
            }
            Err(why) => {
                let after = format!(" cannot be read: {why}; {instead}");
                self.warnings.repeat(place.into(), "texture", name, &after);
                self.missing.push(name.into());
                None
            }
        };
        self.read.insert(path, index);
        index
    }

    fn warn_left_out(&mut self, definition: &tobj::Material, origin: &Origin) {
        let left_out = left_out(definition);
        if !left_out.is_empty() {
            let after = format!(": left out: {}", left_out.join(", "));
            self.warnings.repeat(origin.place("newmtl"), "material", &definition.name, &after);
        }
    }
}

/// Illumination models of glass. Only the diffuse part of such materials is used.
const GLASS: [u8; 4] = [4, 6, 7, 9];

/// The specular part of a definition.
struct Asked {
    part: Option<Specular>,
    /// A statement whose value was out of range, and the value.
    clamped: Option<(&'static str, f64)>,
}

/// Reads the specular part of a material. `Pr` and `Pm` take precedence over `Ks` and `Ns`, because exporters that
/// write both follow their own conventions for `Ks` and `Ns`. `illum` 3 and 8 are mirrors, 5 is a mirror with a Fresnel
/// term, 0 and 1 have no highlights, and glass is left out. Without `illum`, `Ks` is a highlight as in `illum` 2.
fn specular(definition: &tobj::Material) -> Asked {
    let mut clamped = None;
    let mut within = |statement: &'static str, value: f64, most: f64| {
        if !(0.0..=most).contains(&value) {
            clamped.get_or_insert((statement, value));
        }
        // NaN becomes 0.
        value.max(0.0).min(most)
    };
    let parameter = |key: &str| number(definition, key);
    let part = match definition.illumination_model {
        Some(illum) if GLASS.contains(&illum) => None,
        _ if parameter("Pr").or(parameter("Pm")).is_some() => Some(Specular::MetallicRoughness {
            metallic: within("Pm", parameter("Pm").unwrap_or(0.0), 1.0),
            roughness: within("Pr", parameter("Pr").unwrap_or(1.0), 1.0),
            anisotropy: within("aniso", parameter("aniso").unwrap_or(0.0), 1.0),
        }),
        illum => {
            let reflectance = definition.specular.unwrap_or_default().map(|s| within("Ks", s, 1.0));
            match illum {
                _ if reflectance == [0.0; 3] => None,
                Some(3 | 8) => Some(Specular::Mirror(Fresnel::Constant(reflectance))),
                Some(5) => Some(Specular::Mirror(Fresnel::Schlick(reflectance))),
                Some(2) | None => {
                    let exponent = within("Ns", definition.shininess.unwrap_or(0.0), MOST_EXPONENT);
                    Some(Specular::Phong { reflectance, exponent })
                }
                _ => None,
            }
        }
    };
    Asked { part, clamped }
}

fn number(definition: &tobj::Material, key: &str) -> Option<f64> {
    definition.unknown_param.get(key).and_then(|v| v.split_whitespace().next()?.parse().ok())
}

fn map_of<'a>(definition: &'a tobj::Material, statement: &str) -> Option<&'a str> {
    match statement {
        "map_Kd" => definition.diffuse_texture.as_deref(),
        "map_d" => definition.dissolve_texture.as_deref(),
        _ => definition.unknown_param.get(statement).map(String::as_str),
    }
}

/// Statements of a material that the reader does not support.
fn left_out(definition: &tobj::Material) -> Vec<String> {
    let parameter = |key: &str| definition.unknown_param.get(key);
    let number = |key: &str| number(definition, key);
    let mut parts = Vec::new();
    let mut add = |is_there: bool, what: &str| {
        if is_there {
            parts.push(what.to_string());
        }
    };
    let glass = definition.illumination_model.filter(|illum| GLASS.contains(illum));
    let positive = |ks: [f64; 3]| ks.iter().any(|&s| s > 0.0);
    add(glass.is_some() && definition.specular.is_some_and(positive), "gloss (Ks)");
    add(glass.is_some() && number("Pm").is_some_and(|m| m > 0.0), "metal (Pm)");
    add(definition.specular_texture.is_some(), "map_Ks");
    add(definition.shininess_texture.is_some(), "map_Ns");
    let clear =
        definition.dissolve.is_some_and(|d| 0.0 < d && d < 1.0) || number("Tr").is_some_and(|t| t > 0.0);
    add(clear, "transparency (d, Tr), unless the material is ignored");
    add(parameter("map_Tr").is_some(), "transparency map (map_Tr)");
    let filters = |tf: &String| tf.split_whitespace().any(|w| w.parse::<f64>().is_ok_and(|t| t != 1.0));
    add(parameter("Tf").is_some_and(filters), "transmission filter (Tf)");
    add(definition.normal_texture.is_some() || parameter("norm").is_some(), "bump or normal map");
    for key in ["disp", "decal", "refl"] {
        add(parameter(key).is_some(), key);
    }
    add(number("Pc").is_some_and(|c| c > 0.0), "clear coat (Pc)");
    if let Some(illum) = glass {
        parts.push(format!("glass (illum {illum})"));
    }
    parts
}
