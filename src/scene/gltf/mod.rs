//! glTF 2.0, `.gltf` and `.glb`.
//!
//! The reader takes the default scene, or all nodes if there is none. Nodes place meshes, EXT_mesh_gpu_instancing
//! copies them, and skins and morph targets pose them at rest. The reflectance of a material is the product of its base
//! colour, its texture, COLOR_0 and the share that is not metal. Its emission, in W/(m² sr), is the product of the
//! emissive factor, KHR_materials_emissive_strength and the emissive texture. Lights of KHR_lights_punctual are divided
//! by a luminous efficacy.
//!
//! A double-sided surface emits from both sides, as the specification requires. If its mesh is open, copies of its
//! triangles, turned round, come after all other triangles. A closed mesh emits only outwards, because light inside it
//! stays there.
//!
//! The reader trusts no number in the file. It checks every index, length and offset before use, walks nodes without
//! recursion, and bounds its memory by the size of the file.

pub(crate) mod accessor;
pub(crate) mod container;
pub(crate) mod document;
mod images;
mod lamps;
mod material;
pub(crate) mod nodes;
pub(crate) mod primitive;
mod punctual;
mod surface;

use std::collections::HashMap;
use std::path::Path;

use glam::{DVec2, DVec3};

use self::container::Document;
use self::material::{Lookup, Made, Materials};
use self::nodes::{Instance, Nodes};
use self::primitive::Geometry;
use super::{LoadOptions, Part, Scene, SceneBuilder};
use crate::{Error, Result};

/// Scenes with more triangles are refused, because a few nested copies of meshes could give any number of triangles.
const MOST_TRIANGLES: usize = 1 << 27;

/// Reads `path`.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Input`] when its contents or its buffers cannot be used.
/// Missing images are warnings.
pub(super) fn load(path: &Path, options: &LoadOptions) -> Result<Scene> {
    let document = Document::read(path)?;
    let nodes = document.nodes()?;
    let mut assembly = Assembly {
        document: &document,
        options,
        materials: Materials::new(&document, options),
        builder: SceneBuilder::default(),
        colours: Vec::new(),
        emission_texcoords: Vec::new(),
        both_sides: Vec::new(),
        parts: Vec::new(),
        left_out: 0,
    };
    document.walk(&nodes, |place, geometry| assembly.add(place, geometry))?;
    let mut scene = assembly.finish()?;
    scene.units = options.units;
    scene.lights.list = punctual::lights(&document, &nodes, options.units.efficacy())?;
    Ok(scene)
}

/// A primitive of a mesh in the scene.
pub(crate) struct Place<'a> {
    /// Its mesh and the place of the mesh.
    pub instance: &'a Instance,
    /// Index of the primitive in the mesh.
    pub primitive: usize,
}

impl Place<'_> {
    /// The position of a vertex in the space of the scene.
    pub fn position(&self, geometry: &Geometry, vertex: usize) -> DVec3 {
        let p = geometry.positions[vertex];
        if geometry.posed { p } else { self.instance.matrix.transform_point3(p) }
    }

    /// Whether the matrix turns fronts into backs (section 3.7.4 of the specification).
    pub fn is_mirrored(&self, geometry: &Geometry) -> bool {
        !geometry.posed && self.instance.matrix.determinant() < 0.0
    }
}

impl Document {
    /// Calls `show` with every primitive of the scene, and with its geometry if it has triangles. The order is the
    /// order of the scene's triangles.
    ///
    /// # Errors
    /// Errors of reading geometry, and errors of `show`.
    pub fn for_each_primitive(
        &self,
        show: impl FnMut(&Place<'_>, Option<&Geometry>) -> Result<()>,
    ) -> Result<()> {
        self.walk(&self.nodes()?, show)
    }

    fn walk(
        &self,
        nodes: &Nodes,
        mut show: impl FnMut(&Place<'_>, Option<&Geometry>) -> Result<()>,
    ) -> Result<()> {
        // Geometry is read once for all instances, unless each instance has its own pose.
        let mut known: HashMap<(usize, usize), Option<Geometry>> = HashMap::new();
        for instance in &nodes.instances {
            let node = &self.root.nodes[instance.node];
            let is_shared = node.skin.is_none() && node.weights.is_none();
            for primitive in 0..self.root.meshes[instance.mesh].primitives.len() {
                let place = Place { instance, primitive };
                let key = (instance.mesh, primitive);
                if !is_shared || !known.contains_key(&key) {
                    let geometry = self.geometry(nodes, instance.node, instance.mesh, primitive)?;
                    if !is_shared {
                        show(&place, geometry.as_ref())?;
                        continue;
                    }
                    known.insert(key, geometry);
                }
                show(&place, known[&key].as_ref())?;
            }
        }
        Ok(())
    }
}

struct Assembly<'a> {
    document: &'a Document,
    options: &'a LoadOptions,
    materials: Materials<'a>,
    builder: SceneBuilder,
    colours: Vec<[[f32; 3]; 3]>,
    emission_texcoords: Vec<[DVec2; 3]>,
    /// Triangles whose backs emit.
    both_sides: Vec<u32>,
    parts: Vec<Part>,
    /// Number of primitives of points and lines.
    left_out: usize,
}

impl Assembly<'_> {
    fn add(&mut self, place: &Place<'_>, geometry: Option<&Geometry>) -> Result<()> {
        let (document, instance) = (self.document, place.instance);
        let mesh = &document.root.meshes[instance.mesh];
        if self.options.faces && place.primitive == 0 {
            let name = |name: &Option<String>, kind: &str, i: usize| {
                Some(name.clone().unwrap_or(format!("{kind} {i}")))
            };
            self.parts.push(Part {
                object: name(&document.root.nodes[instance.node].name, "node", instance.node),
                group: name(&mesh.name, "mesh", instance.mesh),
                ..Part::default()
            });
        }
        let Some(geometry) = geometry else {
            self.left_out += 1;
            return Ok(());
        };
        if self.builder.pushed as usize + geometry.triangles.len() > MOST_TRIANGLES {
            return Err(
                document.error(format!("more than {MOST_TRIANGLES} triangles, all instances counted"))
            );
        }
        let primitive = &mesh.primitives[place.primitive];
        let has = |set: u32| primitive.attributes.contains_key(&format!("TEXCOORD_{set}"));
        let made = self.materials.index(primitive.material, has)?;
        let coordinates = |lookup: &Option<Lookup>, or: Option<u32>| -> Result<Option<Vec<DVec2>>> {
            let Some(set) = lookup.as_ref().map(|l| l.set).or(or) else { return Ok(None) };
            let uv = document.texture_coordinates(primitive, set, geometry.positions.len())?;
            // Coordinates are kept even without a texture, because a lightmap may use them.
            let plain = |uv: DVec2| DVec2::new(uv.x, 1.0 - uv.y);
            Ok(uv.map(|uv| {
                uv.into_iter().map(|uv| lookup.as_ref().map_or(plain(uv), |l| l.apply(uv))).collect()
            }))
        };
        let uv = coordinates(&made.reflectance, made.emission.is_none().then_some(0))?;
        let uv_of_emission = match &made.emission {
            Some(_) if made.emission != made.reflectance => coordinates(&made.emission, None)?,
            _ => None,
        };
        // A set for the emission alone serves as the only set.
        let (uv, uv_of_emission) = match (uv, uv_of_emission) {
            (None, Some(only)) => (Some(only), None),
            both => both,
        };
        self.triangles(place, geometry, &made, uv.as_deref(), uv_of_emission.as_deref())
    }

    fn triangles(
        &mut self,
        place: &Place<'_>,
        geometry: &Geometry,
        made: &Made,
        uv: Option<&[DVec2]>,
        uv_of_emission: Option<&[DVec2]>,
    ) -> Result<()> {
        let positions: Vec<DVec3> =
            (0..geometry.positions.len()).map(|v| place.position(geometry, v)).collect();
        if positions.iter().any(|p| !p.is_finite()) {
            let node = place.instance.node;
            return Err(self
                .document
                .error(format!("nodes[{node}] moves a vertex beyond the range of numbers")));
        }
        let mirrored = place.is_mirrored(geometry);
        for &[a, b, c] in &geometry.triangles {
            let corners = if mirrored { [a, c, b] } else { [a, b, c] }.map(|i| i as usize);
            let kept = self.builder.scene.triangles.len();
            if self.options.faces {
                self.builder.face(None, self.parts.len() as u32 - 1);
            }
            let of_corners = |uv: &[DVec2]| corners.map(|i| uv[i]);
            self.builder.push(corners.map(|i| positions[i]), made.index, uv.map(of_corners));
            if self.builder.scene.triangles.len() == kept {
                continue;
            }
            if let Some(colours) = &geometry.colours {
                self.colours.resize(kept, [[1.0; 3]; 3]);
                self.colours.push(corners.map(|i| std::array::from_fn(|c| colours[i][c] as f32)));
            }
            if let Some(uv) = uv_of_emission {
                let texcoords = &self.builder.scene.texcoords;
                let own = (self.emission_texcoords.len()..kept)
                    .map(|t| texcoords.get(t).copied().unwrap_or_default());
                self.emission_texcoords.extend(own.collect::<Vec<_>>());
                self.emission_texcoords.push(of_corners(uv));
            }
            if made.both_sides_emit {
                self.both_sides.push(kept as u32);
            }
        }
        Ok(())
    }

    fn finish(self) -> Result<Scene> {
        let Assembly { document, materials: mut made, builder, mut colours, mut emission_texcoords, .. } =
            self;
        let file = document.path.display();
        let mut scene = builder.finish();
        if scene.triangles.is_empty() {
            let what =
                if scene.degenerate > 0 { "every face has zero area" } else { "no triangles in the scene" };
            return Err(Error::input(&document.path, None, what)
                .with_hint("nodes of the default scene must place meshes with triangles"));
        }
        let own = (emission_texcoords.len()..scene.triangles.len()).map(|t| scene.texcoords[t]);
        if !emission_texcoords.is_empty() {
            emission_texcoords.extend(own.collect::<Vec<_>>());
        }
        if !colours.is_empty() {
            colours.resize(scene.triangles.len(), [[1.0; 3]; 3]);
        }
        (scene.colours, scene.emission_texcoords) = (colours, emission_texcoords);
        scene.materials = made.materials;
        scene.textures = made.textures;
        if !self.options.faces {
            scene.backs_of_lamps = lamps::double(&mut scene, &self.both_sides);
            if scene.backs_of_lamps > 0 {
                let doubled = scene.backs_of_lamps;
                made.warnings.push(format!(
                    "{file}: {doubled} triangles emit from both sides because their materials are double-sided"
                ));
            }
        }
        scene.parts = self.parts;
        if self.left_out > 0 {
            made.warnings.push(format!("{file}: left out {} primitives of points or lines", self.left_out));
        }
        if !document.root.animations.is_empty() {
            made.warnings.push(format!("{file}: animations are left out; the scene is read at rest"));
        }
        scene.warnings = made.warnings.into_sentences();
        scene.files = document.files.clone();
        scene.files.append(&mut made.files);
        scene.missing = made.missing;
        Ok(scene)
    }
}
