//! A glTF file with its lightmap: every mesh gets texture coordinates for the map, and every material shows it.
//!
//! Everything else stays as it is in the file: nodes, names, animations, cameras, unknown extensions. The bytes of
//! vertices are copied. There are three exceptions. Vertices on seams of the map are doubled. Strips and fans become
//! lists. A mesh that several nodes show becomes one mesh for each, because each has its own part of the map.

use std::collections::HashMap;

use glam::{DVec2, DVec3};
use image::RgbImage;
use serde_json::{Value, json};

use super::{GENERATOR, Glb, Source, glb::Target, source};
use crate::{
    Result,
    scene::{
        Scene,
        gltf::{Place, accessor::Raw, container::Document, primitive::Geometry},
    },
};

/// The places of a scene's triangles in the map.
#[derive(Debug, Clone, Copy)]
pub struct Layout<'a> {
    /// Texture coordinates in \[0, 1\], v upwards.
    pub coordinates: &'a [DVec2],
    /// Indices of the texture coordinates of each triangle's corners.
    pub corners: &'a [[u32; 3]],
    /// The page of each triangle; `None` if it has no place in the map.
    pub pages: &'a [Option<u32>],
}

/// How materials show a map.
#[derive(Debug, Clone)]
pub enum Show {
    /// Materials are black and emit the map. Every viewer can show this, and its own lights add nothing.
    Emissive {
        /// Images of radiosity, one per page. White has the brightness `strength`.
        pages: Vec<RgbImage>,
        /// The brightness of the images' white; 1 is white on a screen.
        strength: f64,
        /// For each material, its uniform emission if it is too bright for the map. Such a material does not use the
        /// map.
        plain: Vec<Option<[f64; 3]>>,
    },
    /// Materials keep their colours, and the extension MOZ_lightmap names the map of irradiance.
    Moz {
        /// Linear images of irradiance, one per page. White is the irradiance `intensity`.
        pages: Vec<RgbImage>,
        /// The irradiance of the images' white, W/m².
        intensity: f64,
    },
    /// Texture coordinates only. The map is in separate files.
    Coordinates,
}

/// With this extension, a material reflects no light of the viewer.
const BLACK: &str = "KHR_materials_specular";
const STRENGTH: &str = "KHR_materials_emissive_strength";
const INSTANCING: &str = "EXT_mesh_gpu_instancing";

/// The bytes of the file with the map. `extras` become extras at the file's top level.
///
/// # Errors
/// Errors of reading the source.
pub fn lit(
    scene: &Scene,
    source: &Source,
    layout: Layout<'_>,
    show: &Show,
    extras: Value,
) -> Result<Vec<u8>> {
    let json = source.document.value()?;
    let mut writer = Writer {
        scene,
        source,
        layout,
        show,
        set: free_set(&json, show),
        glb: Glb::new(json),
        textures: Vec::new(),
        materials: HashMap::new(),
        meshes: Vec::new(),
        next: 0,
    };
    writer.take_in_buffers();
    writer.take_in_images();
    writer.add_textures();
    source.document.for_each_primitive(|place, geometry| {
        if place.primitive == 0 {
            writer.meshes.push(Vec::new());
        }
        let made = match geometry {
            Some(geometry) => writer.primitives(place, geometry)?,
            None => vec![writer.original(place)],
        };
        writer.meshes.last_mut().expect("each instance began with a mesh").extend(made);
        Ok(())
    })?;
    writer.place_meshes()?;
    writer.glb.json["asset"]["generator"] = GENERATOR.into();
    writer.add_extras(extras);
    Ok(writer.glb.finish())
}

/// The set of texture coordinates for the map: the first one from `TEXCOORD_1` on that no kept texture uses.
fn free_set(json: &Value, show: &Show) -> u32 {
    fn sets(value: &Value, found: &mut Vec<u64>) {
        match value {
            Value::Object(map) => {
                found.extend(map.get("texCoord").and_then(Value::as_u64));
                map.values().for_each(|value| sets(value, found));
            }
            Value::Array(list) => list.iter().for_each(|value| sets(value, found)),
            _ => {}
        }
    }
    let mut used = Vec::new();
    for material in json["materials"].as_array().into_iter().flatten() {
        let opaque = material["alphaMode"].as_str().is_none_or(|mode| mode == "OPAQUE");
        if !(opaque && matches!(show, Show::Emissive { .. })) {
            sets(material, &mut used);
        }
    }
    (1..).find(|set| !used.contains(set)).unwrap_or(1) as u32
}

struct Writer<'a> {
    scene: &'a Scene,
    source: &'a Source,
    layout: Layout<'a>,
    show: &'a Show,
    /// The set of texture coordinates for the map.
    set: u32,
    glb: Glb,
    /// Textures of the map, one per page.
    textures: Vec<usize>,
    /// New materials, by the index of the material in the file, the page, and the material of the scene if it has its
    /// own uniform emission.
    materials: HashMap<(Option<usize>, u32, Option<u32>), usize>,
    /// New primitives of each instance of a mesh.
    meshes: Vec<Vec<Value>>,
    /// Index of the next triangle of the file.
    next: usize,
}

/// A corner of a triangle in the output.
#[derive(Clone, Copy)]
enum Corner {
    /// A vertex of the file.
    Vertex(u32),
    /// A point between three vertices of the file, with its weights.
    Between([u32; 3], [f64; 3]),
}

/// The corners of a triangle, and the indices of their texture coordinates in the map.
type Corners = [(Corner, Option<u32>); 3];

/// The vertices and triangles of a new primitive.
#[derive(Default)]
struct Group {
    vertices: Vec<(Corner, Option<u32>)>,
    known: HashMap<(u32, Option<u32>), u32>,
    corners: Vec<[u32; 3]>,
}

impl Group {
    fn vertex(&mut self, corner: Corner, uv: Option<u32>) -> u32 {
        let next = self.vertices.len() as u32;
        let index = match corner {
            Corner::Vertex(v) => *self.known.entry((v, uv)).or_insert(next),
            Corner::Between(..) => next,
        };
        if index == next {
            self.vertices.push((corner, uv));
        }
        index
    }
}

impl Writer<'_> {
    /// Joins all buffers into one.
    fn take_in_buffers(&mut self) {
        let starts: Vec<usize> = self.source.document.buffers.iter().map(|b| self.glb.append(b)).collect();
        for view in self.glb.json["bufferViews"].as_array_mut().into_iter().flatten() {
            let buffer = view["buffer"].as_u64().unwrap_or(0) as usize;
            let offset =
                view["byteOffset"].as_u64().unwrap_or(0) + starts.get(buffer).copied().unwrap_or(0) as u64;
            view["buffer"] = 0.into();
            view["byteOffset"] = offset.into();
        }
    }

    /// Embeds images that are separate files. Images that cannot be read stay references.
    fn take_in_images(&mut self) {
        let count = self.glb.json["images"].as_array().map_or(0, Vec::len);
        for i in 0..count {
            let image = &self.glb.json["images"][i];
            if image["uri"].as_str().is_none_or(|uri| uri.starts_with("data:")) {
                continue;
            }
            let Ok((bytes, _)) = self.source.document.image(i) else { continue };
            let Some(mime) = source::mime(&bytes) else { continue };
            let view = self.glb.view(&bytes, Target::Other);
            if let Some(image) = self.glb.json["images"][i].as_object_mut() {
                image.remove("uri");
                image.insert("bufferView".into(), view.into());
                image.insert("mimeType".into(), mime.into());
            }
        }
    }

    fn add_textures(&mut self) {
        let (pages, name) = match self.show {
            Show::Emissive { pages, .. } => (pages, "light"),
            Show::Moz { pages, .. } => (pages, "irradiance"),
            Show::Coordinates => return,
        };
        // The sampler has no mipmaps and no repetition, because both would mix points that are far apart on the
        // surface.
        let sampler = self
            .glb
            .push("samplers", json!({"magFilter": 9729, "minFilter": 9729, "wrapS": 33071, "wrapT": 33071}));
        for (i, page) in pages.iter().enumerate() {
            let name = if i == 0 { name.to_owned() } else { format!("{name} {}", i + 1) };
            let image = self.glb.png(&name, page);
            self.textures
                .push(self.glb.push("textures", json!({"name": name, "source": image, "sampler": sampler})));
        }
    }

    fn original(&self, place: &Place<'_>) -> Value {
        self.glb.json["meshes"][place.instance.mesh]["primitives"][place.primitive].clone()
    }

    /// The primitives that replace one: one for each page that it lies on, and one for triangles without a place in the
    /// map.
    fn primitives(&mut self, place: &Place<'_>, geometry: &Geometry) -> Result<Vec<Value>> {
        let original = self.original(place);
        // Triangles that were left out because they are hidden behind other faces would flicker through these.
        let hidden = self.source.is_hidden(original["material"].as_u64().map(|m| m as usize));
        let mut groups: Vec<(Option<(u32, u32)>, Group)> = Vec::new();
        let mut group = |key: Option<(u32, u32)>| {
            groups.iter().position(|(known, _)| *known == key).unwrap_or_else(|| {
                groups.push((key, Group::default()));
                groups.len() - 1
            })
        };
        let mut written: Vec<(usize, Corners)> = Vec::new();
        for triangle in &geometry.triangles {
            let list = &self.source.triangles[self.next];
            self.next += 1;
            if list.is_empty() && !hidden {
                written.push((group(None), triangle.map(|v| (Corner::Vertex(v), None))));
            }
            for &t in list {
                let t = t as usize;
                let key = self.layout.pages[t].map(|page| (page, self.scene.triangles[t].material));
                let corners = self.corners(place, geometry, triangle, t, list.len() == 1);
                written.push((group(key), corners));
            }
        }
        for (at, corners) in written {
            let group = &mut groups[at].1;
            let corners = corners.map(|(corner, uv)| group.vertex(corner, uv));
            group.corners.push(corners);
        }
        let attributes = self.source.document.attributes(place)?;
        groups
            .into_iter()
            .map(|(key, group)| Ok(self.primitive(&original, &attributes, key, &group)))
            .collect()
    }

    /// Corners of triangle `t` of the scene with their coordinates in the map, in the order of the file.
    fn corners(
        &self,
        place: &Place<'_>,
        geometry: &Geometry,
        triangle: &[u32; 3],
        t: usize,
        alone: bool,
    ) -> Corners {
        let [a, b, c] = *triangle;
        let mirrored = place.is_mirrored(geometry);
        let order = if mirrored { [a, c, b] } else { [a, b, c] };
        let whole = order.map(|v| place.position(geometry, v as usize));
        let found = self.scene.corners(t);
        let same = alone && (0..3).all(|k| found[k] == whole[k] || found[k].as_vec3() == whole[k].as_vec3());
        let uv = self.layout.pages[t].map(|_| self.layout.corners[t]);
        let corner = |k: usize| {
            let corner = if same { Corner::Vertex(order[k]) } else { between(order, whole, found[k]) };
            (corner, uv.map(|uv| uv[k]))
        };
        if mirrored { [corner(0), corner(2), corner(1)] } else { [corner(0), corner(1), corner(2)] }
    }

    fn primitive(
        &mut self,
        original: &Value,
        attributes: &Attributes,
        key: Option<(u32, u32)>,
        group: &Group,
    ) -> Value {
        let mut primitive = original.clone();
        primitive["mode"] = 4.into();
        primitive["indices"] = self.glb.triangles(&group.corners).into();
        for (name, raw) in &attributes.plain {
            primitive["attributes"][name] = self.copy(name, raw, group).into();
        }
        for (i, target) in attributes.targets.iter().enumerate() {
            for (name, raw) in target {
                primitive["targets"][i][name] = self.copy(name, raw, group).into();
            }
        }
        let Some((page, material)) = key else { return primitive };
        let uv: Vec<[f32; 2]> = group
            .vertices
            .iter()
            .map(|(_, uv)| {
                let uv = uv.map_or(DVec2::ZERO, |uv| self.layout.coordinates[uv as usize]);
                [uv.x as f32, (1.0 - uv.y) as f32]
            })
            .collect();
        let accessor = self.glb.vectors(&uv, false);
        // Sets must be numbered without gaps. If the file lacks earlier sets, they get the coordinates of this set.
        for set in 0..=self.set {
            let name = format!("TEXCOORD_{set}");
            if set == self.set || primitive["attributes"].get(&name).is_none() {
                primitive["attributes"][name] = accessor.into();
            }
        }
        let original = original["material"].as_u64().map(|m| m as usize);
        if let Some(material) = self.material(original, page, material) {
            primitive["material"] = material.into();
        }
        primitive
    }

    /// Copies an attribute for the vertices of a group and returns the index of its accessor.
    fn copy(&mut self, name: &str, raw: &Raw, group: &Group) -> usize {
        let stride = raw.size.next_multiple_of(4);
        let mut bytes = vec![0; stride * group.vertices.len()];
        for ((corner, _), out) in group.vertices.iter().zip(bytes.chunks_exact_mut(stride)) {
            match corner {
                Corner::Vertex(v) => out[..raw.size].copy_from_slice(raw.element(*v as usize)),
                // Joints are indices and cannot be interpolated.
                Corner::Between(of, weights) if name.starts_with("JOINTS") => {
                    let nearest = (0..3).fold(0, |best, k| if weights[k] > weights[best] { k } else { best });
                    out[..raw.size].copy_from_slice(raw.element(of[nearest] as usize));
                }
                Corner::Between(of, weights) => raw.mix(*of, *weights, &mut out[..raw.size]),
            }
        }
        let view = self.glb.view(&bytes, Target::Vertices(stride));
        let mut accessor = json!({"bufferView": view, "componentType": raw.component_type, "type": raw.kind,
            "count": group.vertices.len()});
        if raw.normalized {
            accessor["normalized"] = true.into();
        }
        if name == "POSITION" {
            let elements = bytes.chunks_exact(stride).map(|element| raw.numbers(element));
            let bound = |of: fn(f64, f64) -> f64| {
                elements.clone().reduce(|a, b| std::array::from_fn(|c| of(a[c], b[c])))
            };
            // Bounds of single-precision values are written in single precision, because validators compare them with
            // the values.
            let bound_json = |bound: Option<[f64; 3]>| match raw.component_type {
                5126 => json!(bound.unwrap_or_default().map(|x| x as f32)),
                _ => json!(bound.unwrap_or_default().map(|x| x as i64)),
            };
            accessor["min"] = bound_json(bound(f64::min));
            accessor["max"] = bound_json(bound(f64::max));
        }
        self.glb.push("accessors", accessor)
    }

    /// The index of the new material that shows a page instead of a material of the file. `None` if that material
    /// stays.
    fn material(&mut self, original: Option<usize>, page: u32, material: u32) -> Option<usize> {
        let plain = match self.show {
            Show::Emissive { plain, .. } => plain[material as usize],
            Show::Moz { .. } => None,
            Show::Coordinates => return None,
        };
        let key = (original, page, plain.map(|_| material));
        if let Some(&known) = self.materials.get(&key) {
            return Some(known);
        }
        let of = original.map_or(Value::Null, |i| self.glb.json["materials"][i].clone());
        let mut made = match self.show {
            Show::Emissive { strength, .. } => self.emissive(&of, page, *strength, plain),
            _ => self.moz(&of, page),
        };
        if let (Some(name), true) = (of["name"].as_str(), page > 0) {
            made["name"] = format!("{name} page {}", page + 1).into();
        }
        if let (Some(original), Show::Emissive { .. }) = (original, self.show) {
            made["extras"] = if of["extras"].is_object() { of["extras"].clone() } else { json!({}) };
            made["extras"]["radiosity"] = json!({"material": original});
        }
        let index = self.glb.push("materials", made);
        self.materials.insert(key, index);
        Some(index)
    }

    fn emissive(&mut self, of: &Value, page: u32, strength: f64, plain: Option<[f64; 3]>) -> Value {
        let alpha = of["pbrMetallicRoughness"]["baseColorFactor"][3].as_f64().unwrap_or(1.0);
        let mut made = json!({
            "pbrMetallicRoughness": {"baseColorFactor": [0.0, 0.0, 0.0, alpha], "metallicFactor": 0.0, "roughnessFactor": 1.0},
            "extensions": {BLACK: {"specularFactor": 0.0}},
        });
        self.glb.uses(BLACK);
        for key in ["name", "doubleSided", "alphaMode", "alphaCutoff"] {
            if let Some(value) = of.get(key) {
                made[key] = value.clone();
            }
        }
        // The alpha of the base colour texture marks holes. Its colours have no effect, because their factor is black.
        if of["alphaMode"].as_str().is_some_and(|mode| mode != "OPAQUE")
            && let Some(texture) = of["pbrMetallicRoughness"].get("baseColorTexture")
        {
            made["pbrMetallicRoughness"]["baseColorTexture"] = texture.clone();
        }
        let strength = match plain {
            Some(emitted) => {
                let most = emitted.into_iter().fold(0.0, f64::max);
                made["emissiveFactor"] = json!(emitted.map(|e| e / most));
                most
            }
            None => {
                made["emissiveFactor"] = json!([1.0, 1.0, 1.0]);
                made["emissiveTexture"] =
                    json!({"index": self.textures[page as usize], "texCoord": self.set});
                strength
            }
        };
        made["extensions"][STRENGTH] = json!({"emissiveStrength": strength});
        self.glb.uses(STRENGTH);
        made
    }

    fn moz(&mut self, of: &Value, page: u32) -> Value {
        let mut made = if of.is_object() { of.clone() } else { json!({}) };
        let Show::Moz { intensity, .. } = self.show else { return made };
        if !made["extensions"].is_object() {
            made["extensions"] = json!({});
        }
        made["extensions"]["MOZ_lightmap"] =
            json!({"index": self.textures[page as usize], "texCoord": self.set, "intensity": intensity});
        self.glb.uses("MOZ_lightmap");
        made
    }

    /// Gives each node its meshes. Instances of EXT_mesh_gpu_instancing become children of the node.
    fn place_meshes(&mut self) -> Result<()> {
        let nodes = self.source.document.nodes()?;
        let meshes = std::mem::take(&mut self.meshes);
        let filled = nodes
            .instances
            .iter()
            .filter(|i| !self.source.document.root.meshes[i.mesh].primitives.is_empty());
        let mut shown = vec![false; self.source.document.root.meshes.len()];
        for (instance, primitives) in filled.zip(meshes) {
            if primitives.is_empty() {
                if let Some(node) = self.glb.json["nodes"][instance.node].as_object_mut() {
                    node.remove("mesh");
                }
                continue;
            }
            let mut mesh = self.glb.json["meshes"][instance.mesh].clone();
            mesh["primitives"] = primitives.into();
            // The first instance replaces the original mesh, so that meshes keep their indices.
            let first = !std::mem::replace(&mut shown[instance.mesh], true);
            let index = if first {
                self.glb.json["meshes"][instance.mesh] = mesh;
                instance.mesh
            } else {
                self.glb.push("meshes", mesh)
            };
            match instance.copy {
                None => self.glb.json["nodes"][instance.node]["mesh"] = index.into(),
                Some(copy) => {
                    let matrix = self.source.document.copies(instance.node)?[copy].to_cols_array();
                    let child = self.glb.push(
                        "nodes",
                        json!({"name": format!("instance {copy}"), "mesh": index, "matrix": matrix}),
                    );
                    let node = &mut self.glb.json["nodes"][instance.node];
                    if !node["children"].is_array() {
                        node["children"] = json!([]);
                    }
                    if let Some(children) = node["children"].as_array_mut() {
                        children.push(child.into());
                    }
                }
            }
        }
        self.remove_instancing();
        Ok(())
    }

    fn remove_instancing(&mut self) {
        for node in self.glb.json["nodes"].as_array_mut().into_iter().flatten() {
            let Some(node) = node.as_object_mut() else { continue };
            let extensions = node.get_mut("extensions").and_then(Value::as_object_mut);
            if let Some(extensions) = extensions
                && extensions.remove(INSTANCING).is_some()
            {
                let empty = extensions.is_empty();
                node.remove("mesh");
                if empty {
                    node.remove("extensions");
                }
            }
        }
        let Some(json) = self.glb.json.as_object_mut() else { return };
        for list in ["extensionsUsed", "extensionsRequired"] {
            let Some(names) = json.get_mut(list).and_then(Value::as_array_mut) else { continue };
            names.retain(|name| name != INSTANCING);
            // The specification forbids empty lists.
            if names.is_empty() {
                json.remove(list);
            }
        }
    }

    /// Adds to the extras at the top level. Extras that are not an object are replaced.
    fn add_extras(&mut self, extras: Value) {
        let mut extras = extras;
        extras["texCoord"] = self.set.into();
        let top = match self.glb.json.get("extras") {
            None | Some(Value::Object(_)) => &mut self.glb.json,
            Some(_) => &mut self.glb.json["asset"],
        };
        if !top["extras"].is_object() {
            top["extras"] = json!({});
        }
        top["extras"]["radiosity"] = extras;
    }
}

/// The attributes of a primitive, and of its morph targets.
pub struct Attributes {
    plain: Vec<(String, Raw)>,
    targets: Vec<Vec<(String, Raw)>>,
}

impl Document {
    fn attributes(&self, place: &Place<'_>) -> Result<Attributes> {
        let primitive = &self.root.meshes[place.instance.mesh].primitives[place.primitive];
        let count =
            primitive.attributes.get("POSITION").map_or(Ok(0), |&a| self.raw(a).map(|raw| raw.count()))?;
        let read = |attributes: &std::collections::BTreeMap<String, usize>| -> Result<Vec<(String, Raw)>> {
            let all = attributes.iter().map(|(name, &a)| Ok((name.clone(), self.raw(a)?)));
            let all: Vec<(String, Raw)> = all.collect::<Result<_>>()?;
            match all.iter().find(|(_, raw)| raw.count() < count) {
                Some((name, raw)) => {
                    Err(self
                        .error(format!("only {} of {count} vertices have the attribute {name}", raw.count())))
                }
                None => Ok(all),
            }
        };
        Ok(Attributes {
            plain: read(&primitive.attributes)?,
            targets: primitive.targets.iter().map(read).collect::<Result<_>>()?,
        })
    }
}

/// A point of a triangle: one of its vertices, or a point between them.
fn between(of: [u32; 3], [a, b, c]: [DVec3; 3], p: DVec3) -> Corner {
    let (e, f) = (b - a, c - a);
    let normal = e.cross(f);
    let square = normal.length_squared();
    let [v, w] = [(p - a).cross(f), e.cross(p - a)].map(|x| (x.dot(normal) / square).clamp(0.0, 1.0));
    let weights = [(1.0 - v - w).max(0.0), v, w];
    // Positions have single precision at best, so a point this close to a vertex is the vertex.
    match (0..3).find(|&k| weights[k] > 1.0 - 1e-6) {
        Some(k) => Corner::Vertex(of[k]),
        None if square > 0.0 => Corner::Between(of, weights),
        None => Corner::Vertex(of[0]),
    }
}
