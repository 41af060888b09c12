//! The glTF file that a lightmap is added to, and the triangles of the scene for each of its triangles.

use std::{collections::HashMap, path::Path};

use glam::{DVec2, DVec3};
use serde_json::{Value, json};

use super::{GENERATOR, Glb};
use crate::{
    Result,
    scene::{Material, Scene, Texture, TextureMap, gltf::container::Document},
};

/// A glTF file, and for each of its triangles in file order the corresponding triangles of the scene.
pub struct Source {
    pub(super) document: Document,
    /// For each triangle of the file, its triangles in the scene: none if it was left out, several if it was cut.
    pub(super) triangles: Vec<Vec<u32>>,
    /// Names of materials of surfaces that are hidden behind other faces in the same plane.
    hidden: Vec<String>,
}

impl Source {
    /// Reads the file of the scene again, or makes a new file if the scene has another format.
    ///
    /// # Errors
    /// Errors of [`Scene::load`], and [`Error::Input`](crate::Error::Input) if the file has changed since the scene was
    /// read.
    pub fn of(scene: &Scene, path: &Path) -> Result<Source> {
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        if !matches!(extension.as_deref(), Some("gltf" | "glb")) {
            return Source::made_of(scene);
        }
        let document = Document::read(path)?;
        let mut total = 0;
        document.for_each_primitive(|_, geometry| {
            total += geometry.map_or(0, |geometry| geometry.triangles.len());
            Ok(())
        })?;
        let mut triangles = vec![Vec::new(); total];
        let faces = scene.triangles.len() - scene.backs_of_lamps;
        for (t, triangle) in scene.triangles[..faces].iter().enumerate() {
            match triangles.get_mut(triangle.source as usize) {
                Some(list) => list.push(t as u32),
                None => return Err(document.error("the file has changed since it was read")),
            }
        }
        let hidden = scene.hidden.iter().map(|hidden| hidden.material.clone()).collect();
        Ok(Source { document, triangles, hidden })
    }

    /// Whether triangles of a material of the file that are missing from the scene are hidden behind other faces.
    pub(super) fn is_hidden(&self, material: Option<usize>) -> bool {
        let name = material.map(|m| (m, self.document.root.materials.get(m).and_then(|m| m.name.clone())));
        let name = match name {
            None => "(none)".into(),
            Some((m, name)) => name.unwrap_or(format!("material {m}")),
        };
        self.hidden.contains(&name)
    }

    /// Makes a file with one mesh that has a primitive for each material.
    fn made_of(scene: &Scene) -> Result<Source> {
        let mut glb = Glb::new(json!({
            "asset": {"version": "2.0", "generator": GENERATOR}, "scene": 0, "scenes": [{"nodes": [0]}],
            "nodes": [{"name": "scene", "mesh": 0}],
        }));
        let images: Vec<usize> =
            scene.textures.iter().enumerate().map(|(i, t)| image(&mut glb, i, t)).collect();
        let (mut triangles, mut primitives) = (Vec::new(), Vec::new());
        for (m, material) in scene.materials.iter().enumerate() {
            let of: Vec<usize> =
                (0..scene.triangles.len()).filter(|&t| scene.triangles[t].material as usize == m).collect();
            let described = describe(&mut glb, material, &images);
            let index = glb.push("materials", described);
            if !of.is_empty() {
                let mut primitive = primitive(&mut glb, scene, &of);
                primitive["material"] = index.into();
                primitives.push(primitive);
            }
            triangles.extend(of.into_iter().map(|t| vec![t as u32]));
        }
        glb.push("meshes", json!({"name": "scene", "primitives": primitives}));
        let document = Document::of_bytes(Path::new("scene.glb"), glb.finish())?;
        Ok(Source { document, triangles, hidden: Vec::new() })
    }
}

/// The primitive of some triangles. Corners with the same position, texture coordinates and colour share one vertex.
fn primitive(glb: &mut Glb, scene: &Scene, triangles: &[usize]) -> Value {
    let mut known = HashMap::new();
    let (mut positions, mut texcoords, mut colours, mut corners) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for &t in triangles {
        corners.push(std::array::from_fn(|k| {
            let vertex = scene.triangles[t].vertices[k];
            let uv = scene.texcoords.get(t).map_or(DVec2::ZERO, |uv| uv[k]);
            let colour = scene.colours.get(t).map_or([1.0; 3], |colours| colours[k]);
            let key = (vertex, uv.to_array().map(f64::to_bits), colour.map(f32::to_bits));
            *known.entry(key).or_insert_with(|| {
                let DVec3 { x, y, z } = scene.vertices[vertex as usize];
                positions.push([x as f32, y as f32, z as f32]);
                texcoords.push([uv.x as f32, (1.0 - uv.y) as f32]);
                colours.push(colour);
                positions.len() as u32 - 1
            })
        }));
    }
    let mut attributes = json!({"POSITION": glb.vectors(&positions, true)});
    if !scene.texcoords.is_empty() {
        attributes["TEXCOORD_0"] = glb.vectors(&texcoords, false).into();
    }
    if !scene.colours.is_empty() {
        attributes["COLOR_0"] = glb.vectors(&colours, false).into();
    }
    json!({"attributes": attributes, "indices": glb.triangles(&corners)})
}

/// Adds a texture of the scene and returns its index.
fn image(glb: &mut Glb, i: usize, texture: &Texture) -> usize {
    let (width, height) = texture.size();
    let pixels = image::RgbImage::from_raw(width as u32, height as u32, texture.texels().to_vec());
    let image = glb.png(&format!("texture {i}"), &pixels.expect("three bytes a texel"));
    glb.push("textures", json!({"source": image}))
}

/// A material of the scene as a glTF material.
fn describe(glb: &mut Glb, material: &Material, textures: &[usize]) -> Value {
    let [r, g, b] = material.reflectance;
    // Both sides reflect, but only fronts emit: a double-sided lamp would shine both ways.
    let mut described = json!({"name": material.name, "doubleSided": !material.emits(), "pbrMetallicRoughness":
        {"baseColorFactor": [r, g, b, 1.0], "metallicFactor": 0.0, "roughnessFactor": 1.0}, "extensions": {}});
    if material.specular.is_none() {
        // By default a dielectric reflects 4 % at its surface.
        glb.uses("KHR_materials_specular");
        described["extensions"]["KHR_materials_specular"] = json!({"specularFactor": 0.0});
    }
    if let Some(map) = &material.reflectance_map {
        described["pbrMetallicRoughness"]["baseColorTexture"] = look_up(glb, map, textures);
    }
    if material.emits() {
        let strength = material.emission.into_iter().fold(1.0, f64::max);
        described["emissiveFactor"] = json!(material.emission.map(|e| e / strength));
        if strength > 1.0 {
            glb.uses("KHR_materials_emissive_strength");
            described["extensions"]["KHR_materials_emissive_strength"] =
                json!({"emissiveStrength": strength});
        }
        if let Some(map) = &material.emission_map {
            described["emissiveTexture"] = look_up(glb, map, textures);
        }
    }
    described
}

/// A reference to a texture with the transform of a map. In glTF v points downwards, here it points upwards.
fn look_up(glb: &mut Glb, map: &TextureMap, textures: &[usize]) -> Value {
    let mut index = textures[map.texture];
    if map.clamp {
        let sampler = glb.push("samplers", json!({"wrapS": 33071, "wrapT": 33071}));
        let source = glb.json["textures"][index]["source"].clone();
        index = glb.push("textures", json!({"source": source, "sampler": sampler}));
    }
    let mut info = json!({"index": index});
    if map.scale != DVec2::ONE || map.offset != DVec2::ZERO {
        glb.uses("KHR_texture_transform");
        // 1 - ((1 - v) s + o) = v s + (1 - s - o).
        let offset = [map.offset.x, 1.0 - map.scale.y - map.offset.y];
        info["extensions"] =
            json!({"KHR_texture_transform": {"scale": map.scale.to_array(), "offset": offset}});
    }
    info
}

/// The MIME type of an image file by its first bytes; `None` if glTF does not allow this type.
pub(super) fn mime(bytes: &[u8]) -> Option<&'static str> {
    match image::guess_format(bytes).ok()? {
        image::ImageFormat::Png => Some("image/png"),
        image::ImageFormat::Jpeg => Some("image/jpeg"),
        image::ImageFormat::WebP => Some("image/webp"),
        _ => None,
    }
}
