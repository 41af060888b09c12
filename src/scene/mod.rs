//! The scene: triangles, materials, textures, and the readers of file formats.
//!
//! A scene keeps the values of its file: lengths in the file's unit and in double precision, `Ke` as radiance, `Kd` as
//! reflectance. The ray tracer makes a recentred and rescaled copy ([`crate::trace`]).

mod contacts;
mod cutouts;
mod cutting;
pub(crate) mod gltf;
mod indexed;
pub mod inspection;
pub mod light;
mod near;
pub mod obj;
pub mod overlaps;
mod paint;
pub(crate) mod ply;
pub mod quadtree;
mod specular;
mod stl;
pub mod surfaces;
pub(crate) mod text;
mod texture;
mod triangulate;
mod warnings;

use std::path::{Path, PathBuf};

use glam::{DVec2, DVec3};

use crate::{Error, Result};
pub use contacts::Contacts;
use light::{Lights, Units};
use overlaps::Hidden;
pub(crate) use specular::LEAST_ALPHA;
pub use specular::{Distribution, Fresnel, MOST_EXPONENT, Shadowing, Specular};
pub use texture::{Texture, TextureMap};

/// One triangle of the scene. Its vertices run counter-clockwise as seen from its front.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Triangle {
    /// Indices into [`Scene::vertices`].
    pub vertices: [u32; 3],
    /// Index into [`Scene::materials`].
    pub material: u32,
    /// Index of the triangle in the file, in file order after triangulation. Triangles left out count too.
    pub source: u32,
}

/// A material: a Lambertian surface that may emit, and may have a specular part.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Material {
    /// The name in the file.
    pub name: String,
    /// Diffuse reflectance of both sides, R G B in \[0, 1\]; a factor where [`Material::reflectance_map`] is set.
    pub reflectance: [f64; 3],
    /// Radiance emitted by the front, W/(m² sr), R G B; a factor where [`Material::emission_map`] is set.
    pub emission: [f64; 3],
    /// Texture that multiplies the reflectance.
    pub reflectance_map: Option<TextureMap>,
    /// Texture that multiplies the emitted radiance.
    pub emission_map: Option<TextureMap>,
    /// Reflectance of the share of specular reflection that counts as diffuse. It is added after textures and vertex
    /// colours.
    pub reflectance_offset: [f64; 3],
    /// The specular reflection, if any. Only path and light tracing use it.
    pub specular: Option<Box<Specular>>,
    /// Texture whose [holes](Texture::has_holes) are holes of the surface.
    pub cutout: Option<TextureMap>,
    /// Whether faces of this material are left out.
    pub absent: bool,
}

impl Material {
    /// A material of one colour without textures.
    pub fn new(name: &str, reflectance: [f64; 3], emission: [f64; 3]) -> Self {
        Material {
            name: name.into(),
            reflectance,
            emission,
            reflectance_map: None,
            emission_map: None,
            reflectance_offset: [0.0; 3],
            specular: None,
            cutout: None,
            absent: false,
        }
    }

    /// Whether any point of the material can emit.
    #[inline]
    pub fn emits(&self) -> bool {
        self.emission.iter().any(|&e| e > 0.0)
    }
}

/// A face of the file, before it was cut into triangles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Face {
    /// [`Triangle::source`] of its first triangle. Its last triangle comes just before the first of the next face.
    pub first: u32,
    /// Its line, if the file is text.
    pub line: Option<usize>,
    /// Index into [`Scene::parts`].
    pub part: u32,
}

/// A part of the scene: faces of the same object and group, with the same properties.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash)]
pub struct Part {
    /// The name after `o`.
    pub object: Option<String>,
    /// The names after `g`. Several names form one group together.
    pub group: Option<String>,
    /// Other numbers of the faces of a PLY file, beside corners and colours: names and values.
    pub properties: Vec<(String, String)>,
}

/// Triangles with materials. Make one with [`Scene::load`], [`Scene::from_indexed`] or [`Scene::new`].
#[derive(Debug, Clone, Default)]
#[non_exhaustive]
pub struct Scene {
    /// Positions in the file's unit; vertices at the same position are one vertex.
    pub vertices: Vec<DVec3>,
    /// Triangles of positive area.
    pub triangles: Vec<Triangle>,
    /// Texture coordinates of each triangle's corners; zero for a triangle without. Empty if no triangle has any.
    pub texcoords: Vec<[DVec2; 3]>,
    /// Texture coordinates of each triangle's corners for its emission texture. Empty if they equal
    /// [`Scene::texcoords`].
    pub emission_texcoords: Vec<[DVec2; 3]>,
    /// Linear colours of each triangle's corners; they multiply its reflectance. Empty if no triangle has any.
    pub colours: Vec<[[f32; 3]; 3]>,
    /// Normals of each triangle's corners as in the file, of any length; zero where the file has none. They determine
    /// where pictures and vertex colours are smooth, and do not affect light. Empty if no triangle has any.
    pub normals: Vec<[[f32; 3]; 3]>,
    /// The faces that the triangles come from, in file order; empty unless [`LoadOptions::faces`] asked for them.
    pub faces: Vec<Face>,
    /// For each corner of each triangle, its index among the corners of its face, from 0. A vertex that is not in the
    /// file has [`NEW_CORNER`] plus its index. Empty if the reader does not provide them.
    pub face_corners: Vec<[u32; 3]>,
    /// Objects and groups of the faces.
    pub parts: Vec<Part>,
    /// Materials.
    pub materials: Vec<Material>,
    /// Textures that the materials refer to.
    pub textures: Vec<Texture>,
    /// Lights that are not surfaces.
    pub lights: Lights,
    /// Whether light is in watts or in lumens.
    pub units: Units,
    /// Number of triangles at the end that were added as backs of double-sided emitters.
    pub backs_of_lamps: usize,
    /// Number of triangles that were left out because their area is zero.
    pub degenerate: usize,
    /// [`Triangle::source`] of these triangles, ascending.
    pub(crate) degenerate_sources: Vec<u32>,
    /// Invisible surfaces that [`Scene::cut_overlaps`] and [`Scene::cut_contacts`] left out.
    pub hidden: Vec<Hidden>,
    /// Numbers of cuts that [`Scene::cut_contacts`] made.
    pub contacts: Contacts,
    /// Warnings of the reader, one sentence each, about omissions and assumptions.
    pub warnings: Vec<String>,
    /// Files that were read: the mesh, then material libraries and textures; empty for a scene made in memory.
    pub files: Vec<PathBuf>,
    /// Names of material libraries and textures that could not be read.
    pub missing: Vec<String>,
}

/// How to read a scene.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
#[non_exhaustive]
pub struct LoadOptions {
    /// Reflectance of surfaces without one in the file, R G B in \[0, 1\]. It overrides colours of vertices and faces
    /// in an OBJ or PLY. `None` means [`DEFAULT_REFLECTANCE`] and a warning.
    pub reflectance: Option<[f64; 3]>,
    /// Whether to keep [`Scene::faces`] and [`Scene::parts`].
    pub faces: bool,
    /// Whether unlit materials of a glTF file emit their colour. Otherwise the colour is their reflectance.
    pub unlit_emits: bool,
    /// Whether to leave faces uncut that overlap in one plane, touch or cross. This is for callers that change the
    /// emission of materials and then call [`Scene::cut_overlaps`] and [`Scene::cut_contacts`].
    pub keep_overlaps: bool,
    /// Whether light is in watts or in lumens, and the divisor of luminous quantities in files.
    pub units: Units,
}

setters!(LoadOptions {
    with_reflectance(reflectance: Option<[f64; 3]>),
    with_faces(faces: bool),
    with_unlit_emits(unlit_emits: bool),
    with_keep_overlaps(keep_overlaps: bool),
    with_units(units: Units),
});

/// The first number in [`Scene::face_corners`] that is not a corner in the file but a new vertex: this constant plus
/// the index of the vertex.
pub const NEW_CORNER: u32 = 1 << 31;

/// Reflectance where neither the file nor [`LoadOptions`] gives one: grey plaster.
pub const DEFAULT_REFLECTANCE: f64 = 0.5;

/// Largest radiance that a surface may emit, W/(m² sr). It keeps sums of squared errors and sums of powers within the
/// range of double precision.
pub const MOST_RADIANCE: f64 = 1e100;

/// Whether a surface may emit this radiance: a number from 0 to [`MOST_RADIANCE`].
pub fn is_radiance(radiance: f64) -> bool {
    (0.0..=MOST_RADIANCE).contains(&radiance)
}

impl LoadOptions {
    /// Reflectance of surfaces without one.
    fn default_reflectance(&self) -> [f64; 3] {
        self.reflectance.unwrap_or([DEFAULT_REFLECTANCE; 3])
    }

    /// [`LoadOptions::default_reflectance`] in words, for warnings.
    fn default_in_words(&self) -> String {
        match self.default_reflectance() {
            [r, g, b] if r == g && g == b => format!("reflectance {r}"),
            [r, g, b] => format!("reflectance {r} {g} {b}"),
        }
    }
}

impl Scene {
    /// Reads a scene. The extension of the file determines the format: `.obj` with its `.mtl`, `.ply`, `.gltf`, `.glb`
    /// or `.stl`.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be read, [`Error::Input`] with file and line when it cannot be used.
    pub fn load(path: impl AsRef<Path>) -> Result<Scene> {
        Scene::load_with(path, &LoadOptions::default())
    }

    /// Reads a scene as [`Scene::load`] does, with options.
    ///
    /// # Errors
    /// Errors of [`Scene::load`].
    ///
    /// # Panics
    /// When the reflectance in `options` is outside 0 to 1.
    pub fn load_with(path: impl AsRef<Path>, options: &LoadOptions) -> Result<Scene> {
        let path = path.as_ref();
        let given = options.default_reflectance();
        assert!(given.iter().all(|r| (0.0..=1.0).contains(r)), "a reflectance is outside 0 to 1");
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        let mut scene = match extension.as_deref() {
            Some("obj") => obj::load(path, options),
            Some("ply") => ply::load(path, options),
            Some("gltf" | "glb") => gltf::load(path, options),
            Some("stl") => stl::load(path, options),
            _ => Err(not_a_scene(path, extension.as_deref())),
        }?;
        scene.cut_holes(path)?;
        if !options.keep_overlaps {
            scene.cut_overlaps();
            scene.cut_contacts();
        }
        Ok(scene)
    }

    /// Cuts the holes of cut-outs.
    fn cut_holes(&mut self, path: &Path) -> Result<()> {
        cutouts::cut(self).map_err(|cutouts::TooFine { material }| {
            Error::input(
                path,
                None,
                format!("material `{material}`: its holes cut the scene into millions of pieces"),
            )
            .with_hint("use a smaller image, repeat it less often, or ignore the material")
        })?;
        if self.triangles.is_empty() {
            return Err(Error::input(path, None, "no face is left but holes").with_hint(
                "faces of a material with `d 0` and texels with an alpha below a half are left out",
            ));
        }
        Ok(())
    }

    /// Removes all faces of materials with this name. Returns the number of removed triangles.
    pub fn leave_out(&mut self, material: &str) -> usize {
        let kept: Vec<bool> =
            self.triangles.iter().map(|t| self.materials[t.material as usize].name != material).collect();
        let mut keep = kept.iter();
        self.triangles.retain(|_| keep.next() == Some(&true));
        for texcoords in [&mut self.texcoords, &mut self.emission_texcoords] {
            let mut keep = kept.iter();
            texcoords.retain(|_| keep.next() == Some(&true));
        }
        let mut keep = kept.iter();
        self.colours.retain(|_| keep.next() == Some(&true));
        let mut keep = kept.iter();
        self.normals.retain(|_| keep.next() == Some(&true));
        let mut keep = kept.iter();
        self.face_corners.retain(|_| keep.next() == Some(&true));
        let backs = &kept[kept.len() - self.backs_of_lamps..];
        self.backs_of_lamps = backs.iter().filter(|&&kept| kept).count();
        self.forget_unused_vertices();
        kept.iter().filter(|&&kept| !kept).count()
    }

    /// Removes vertices without a triangle, because they would count in the size of the scene.
    fn forget_unused_vertices(&mut self) {
        let mut used = vec![false; self.vertices.len()];
        self.triangles.iter().flat_map(|t| t.vertices).for_each(|v| used[v as usize] = true);
        let mut next = 0;
        let number = |&used: &bool| {
            next += u32::from(used);
            next.wrapping_sub(1)
        };
        let numbers: Vec<u32> = used.iter().map(number).collect();
        let mut keep = used.iter();
        self.vertices.retain(|_| keep.next() == Some(&true));
        for triangle in &mut self.triangles {
            triangle.vertices = triangle.vertices.map(|v| numbers[v as usize]);
        }
        for corner in self.face_corners.iter_mut().flatten().filter(|corner| **corner & NEW_CORNER != 0) {
            *corner = NEW_CORNER | numbers[(*corner & !NEW_CORNER) as usize];
        }
    }

    /// Number of triangles of a face that were left out because their area is zero.
    pub(crate) fn degenerates_of(&self, face: usize) -> usize {
        let before = |first: u32| self.degenerate_sources.partition_point(|&source| source < first);
        before(self.faces.get(face + 1).map_or(u32::MAX, |next| next.first)) - before(self.faces[face].first)
    }

    /// Cuts away hidden parts of faces that overlap in one plane and face the same way, by the rule of [`overlaps`].
    /// [`Scene::load`] does this. For scenes made in memory, call it yourself. [`Scene::hidden`] and
    /// [`Scene::warnings`] list the hidden parts.
    pub fn cut_overlaps(&mut self) {
        let hidden = overlaps::resolve(self);
        self.record(hidden);
    }

    fn record(&mut self, hidden: Vec<Hidden>) {
        self.warnings.extend(hidden.iter().map(Hidden::to_string));
        self.hidden.extend(hidden);
    }

    /// Cuts triangles along the lines where other surfaces touch or cross them, so that no patch lies on both sides of
    /// a wall. [`Scene::load`] does this. For scenes made in memory, call it yourself, after [`Scene::cut_overlaps`].
    /// [`Scene::contacts`] counts the cuts.
    pub fn cut_contacts(&mut self) {
        let hidden;
        (self.contacts, hidden) = contacts::cut(self);
        self.record(hidden);
        if self.contacts.uncut > 0 {
            self.warnings.push(format!(
                "surfaces touch or cross along {} lines without a cut: light may leak there",
                self.contacts.uncut
            ));
        }
    }

    /// Makes a scene from triangles, each given by the positions of its corners and a material index.
    ///
    /// Equal positions become one vertex. Triangles without area are left out and counted in [`Scene::degenerate`].
    ///
    /// # Panics
    /// When a position is not finite or a material index is out of range.
    pub fn new(triangles: &[([DVec3; 3], u32)], materials: Vec<Material>) -> Scene {
        let mut builder = SceneBuilder::default();
        for (corners, material) in triangles {
            assert!((*material as usize) < materials.len(), "material index out of range");
            builder.push(*corners, *material, None);
        }
        Scene { materials, ..builder.finish() }
    }

    /// The corners of triangle `t`.
    pub fn corners(&self, t: usize) -> [DVec3; 3] {
        self.triangles[t].vertices.map(|v| self.vertices[v as usize])
    }

    /// The area of triangle `t`, in the file's unit squared.
    pub fn area(&self, t: usize) -> f64 {
        triangle_area(self.corners(t))
    }

    /// Unit normal of the front of triangle `t`.
    pub fn normal(&self, t: usize) -> DVec3 {
        let [a, b, c] = self.corners(t);
        scaled_cross(b - a, c - a).0.normalize()
    }

    /// The material of triangle `t`.
    pub fn material(&self, t: usize) -> &Material {
        &self.materials[self.triangles[t].material as usize]
    }

    /// Whether the front of triangle `t` emits anywhere.
    #[inline]
    pub fn emits(&self, t: usize) -> bool {
        self.material(t).emits()
    }

    /// Whether any material has a specular part.
    pub fn has_specular(&self) -> bool {
        self.materials.iter().any(|m| m.specular.is_some())
    }

    /// Whether the scene has any light: surfaces that emit, or [lights that are not surfaces](Scene::lights).
    pub fn is_lit(&self) -> bool {
        self.has_emitter() || !self.lights.is_empty()
    }

    /// Whether any triangle emits.
    pub fn has_emitter(&self) -> bool {
        (0..self.triangles.len()).any(|t| self.emits(t))
    }

    /// Sets the emitted radiance, W/(m² sr), of all materials with this name, or of all materials if `material` is
    /// `None`. Their emission textures are removed. The fronts of their triangles emit. Returns the number of
    /// materials: names need not be unique.
    ///
    /// # Panics
    /// When the radiance [is out of range](is_radiance).
    pub fn emit(&mut self, material: Option<&str>, radiance: [f64; 3]) -> usize {
        assert!(radiance.into_iter().all(is_radiance), "not a radiance");
        let mut found = 0;
        for m in self.materials.iter_mut().filter(|m| material.is_none_or(|name| m.name == name)) {
            m.emission = radiance;
            m.emission_map = None;
            found += 1;
        }
        found
    }

    /// Gives all materials with this name a reflectance, R G B in \[0, 1\], and an emitted radiance, W/(m² sr). Their
    /// textures and vertex colours no longer count; a specular part stays. Returns the number of materials.
    ///
    /// [`Patches::update_materials`](crate::patch::Patches::update_materials) applies the change to existing patches.
    ///
    /// # Panics
    /// When a reflectance is outside 0 to 1, or the emission [is out of range](is_radiance).
    pub fn set_material(&mut self, name: &str, reflectance: [f64; 3], emission: [f64; 3]) -> usize {
        self.reflect(name, reflectance);
        self.emit(Some(name), emission)
    }

    /// Sets the reflectance, R G B in \[0, 1\], of all materials with this name. Their textures and vertex colours no
    /// longer count. Returns the number of materials.
    ///
    /// # Panics
    /// When a reflectance is outside 0 to 1.
    pub fn reflect(&mut self, material: &str, reflectance: [f64; 3]) -> usize {
        assert!(reflectance.iter().all(|r| (0.0..=1.0).contains(r)), "a reflectance is outside 0 to 1");
        let mut found = 0;
        for m in self.materials.iter_mut().filter(|m| m.name == material) {
            m.reflectance = reflectance;
            m.reflectance_offset = [0.0; 3];
            m.reflectance_map = None;
            found += 1;
        }
        for (triangle, colours) in self.triangles.iter().zip(&mut self.colours) {
            if self.materials[triangle.material as usize].name == material {
                *colours = [[1.0; 3]; 3];
            }
        }
        found
    }

    /// 1 if every material and texture is grey, so that one channel describes the scene; otherwise 3.
    pub fn channels(&self) -> usize {
        let grey = |c: [f64; 3]| c[0] == c[1] && c[1] == c[2];
        let colourful = self.materials.iter().any(|m| {
            !grey(m.reflectance)
                || !grey(m.reflectance_offset)
                || !grey(m.emission)
                || [&m.reflectance_map, &m.emission_map]
                    .into_iter()
                    .flatten()
                    .any(|map| !self.textures[map.texture].is_grey())
        });
        let colourful = colourful
            || self.colours.iter().flatten().any(|&c| !grey(c.map(f64::from)))
            || !self.lights.is_grey();
        if colourful { 3 } else { 1 }
    }

    /// Reflectance at a point of triangle `t` given by barycentric coordinates.
    #[inline]
    pub fn reflectance_at(&self, t: usize, barycentric: [f64; 3]) -> [f64; 3] {
        let m = self.material(t);
        let reflectance = self.mapped(m.reflectance, &m.reflectance_map, |texture, map| {
            texture.at(map, interpolate(&self.texcoords[t], barycentric))
        });
        sum(self.coloured(t, reflectance, barycentric), m.reflectance_offset)
    }

    /// Radiance emitted at a point of the front of triangle `t` given by barycentric coordinates.
    #[inline]
    pub fn emission_at(&self, t: usize, barycentric: [f64; 3]) -> [f64; 3] {
        let m = self.material(t);
        self.mapped(m.emission, &m.emission_map, |texture, map| {
            texture.at(map, interpolate(self.uv_of_emission(t), barycentric))
        })
    }

    /// Reflectance averaged over the part of triangle `t` whose corners have these barycentric coordinates. If both a
    /// texture and vertex colours vary, the part is split into sixteen, each with one colour.
    pub fn mean_reflectance(&self, t: usize, part: &[[f64; 3]; 3]) -> [f64; 3] {
        let m = self.material(t);
        let mean = |part: &[[f64; 3]; 3]| {
            let reflectance = self.mapped(m.reflectance, &m.reflectance_map, |texture, map| {
                texture.mean(map, part.map(|b| interpolate(&self.texcoords[t], b)))
            });
            // The mean of a linear function is its value in the middle.
            sum(self.coloured(t, reflectance, middle(part)), m.reflectance_offset)
        };
        let vary = self.colours.get(t).is_some_and(|[a, b, c]| a != b || b != c);
        if !vary || m.reflectance_map.is_none() {
            return mean(part);
        }
        let parts: Vec<[[f64; 3]; 3]> = quarters(part).iter().flat_map(quarters).collect();
        let share = 1.0 / parts.len() as f64;
        parts.iter().map(mean).fold([0.0; 3], |total, of_part| sum(total, of_part.map(|r| r * share)))
    }

    /// Emitted radiance averaged over the part of triangle `t` whose corners have these barycentric coordinates.
    pub fn mean_emission(&self, t: usize, part: &[[f64; 3]; 3]) -> [f64; 3] {
        let m = self.material(t);
        self.mapped(m.emission, &m.emission_map, |texture, map| {
            texture.mean(map, part.map(|b| interpolate(self.uv_of_emission(t), b)))
        })
    }

    fn uv_of_emission(&self, t: usize) -> &[DVec2; 3] {
        self.emission_texcoords.get(t).unwrap_or_else(|| &self.texcoords[t])
    }

    /// Extent of triangle `t` on its emission texture, in texels, along the longer axis. Zero without such a texture.
    pub(crate) fn emission_texels(&self, t: usize) -> f64 {
        let Some(map) = &self.material(t).emission_map else { return 0.0 };
        let [a, b, c] = *self.uv_of_emission(t);
        let (width, height) = self.textures[map.texture].size();
        let extent = (a.max(b).max(c) - a.min(b).min(c)) * map.scale;
        (extent * DVec2::new(width as f64, height as f64)).abs().max_element()
    }

    #[inline]
    fn mapped(
        &self,
        factor: [f64; 3],
        map: &Option<TextureMap>,
        look_up: impl Fn(&Texture, &TextureMap) -> [f64; 3],
    ) -> [f64; 3] {
        match map {
            None => factor,
            Some(map) => {
                let texel = look_up(&self.textures[map.texture], map);
                std::array::from_fn(|c| factor[c] * texel[c])
            }
        }
    }

    /// A reflectance times the colour at a point of triangle `t`.
    #[inline]
    fn coloured(&self, t: usize, reflectance: [f64; 3], barycentric: [f64; 3]) -> [f64; 3] {
        match self.colours.get(t) {
            None => reflectance,
            Some(colours) => std::array::from_fn(|c| {
                let colour: f64 = (0..3).map(|k| f64::from(colours[k][c]) * barycentric[k]).sum();
                // Barycentric coordinates sum to 1 only up to rounding.
                reflectance[c] * colour.clamp(0.0, 1.0)
            }),
        }
    }
}

#[inline]
fn sum(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|c| a[c] + b[c])
}

/// The middle of a part of a triangle in barycentric coordinates.
fn middle(part: &[[f64; 3]; 3]) -> [f64; 3] {
    std::array::from_fn(|k| (part[0][k] + part[1][k] + part[2][k]) / 3.0)
}

/// The four congruent children of a part of a triangle.
fn quarters([a, b, c]: &[[f64; 3]; 3]) -> [[[f64; 3]; 3]; 4] {
    let between = |p: &[f64; 3], q: &[f64; 3]| std::array::from_fn(|k| 0.5 * (p[k] + q[k]));
    let (ab, bc, ca) = (between(a, b), between(b, c), between(c, a));
    [[*a, ab, ca], [ab, *b, bc], [ca, bc, *c], [bc, ca, ab]]
}

/// The error for a path that the program cannot read as a scene, with a hint.
fn not_a_scene(path: &Path, extension: Option<&str>) -> Error {
    const READ: &str = "the program reads Wavefront .obj, .ply, .gltf, .glb and .stl files";
    const EXPORT: &str = "open it in a modelling program and export .glb or Wavefront .obj";
    let error = |message: &str, hint: &str| Error::input(path, None, message).with_hint(hint);
    if path.is_dir() {
        return error("this is a directory", "give the scene's file in it");
    }
    match extension {
        None => error("the name has no extension, so the kind of scene is unknown", READ),
        Some("blend") => {
            error("Blender's own files are not read", "export it from Blender as .glb or Wavefront .obj")
        }
        Some("mtl") => error("this is a material library", "give the .obj file that names it"),
        Some("fbx") => error("FBX files are not read", EXPORT),
        Some("dae") => error("COLLADA files are not read", EXPORT),
        Some("3ds" | "max") => error("3ds Max files are not read", EXPORT),
        Some("usd" | "usda" | "usdc" | "usdz") => error("USD files are not read", EXPORT),
        Some("skp" | "ifc" | "step" | "stp" | "dwg" | "dxf") => error("CAD files are not read", EXPORT),
        Some("xml" | "pbrt" | "rad") => error("scenes of other renderers are not read", EXPORT),
        Some(_) => error("unknown kind of scene", READ),
    }
}

/// The texture coordinates at a point. Coordinates that all corners share are copied: interpolation could round them,
/// and on the border of two texels rounding would choose one of the two by chance.
fn interpolate(uv: &[DVec2; 3], b: [f64; 3]) -> DVec2 {
    if uv[0] == uv[1] && uv[1] == uv[2] {
        return uv[0];
    }
    uv[0] * b[0] + uv[1] * b[1] + uv[2] * b[2]
}

/// Barycentric coordinates in a triangle of a point given by its barycentric coordinates in a part, whose corners are given.
#[inline]
pub(crate) fn in_triangle(in_part: [f64; 3], part: &[[f64; 3]; 3]) -> [f64; 3] {
    std::array::from_fn(|k| (0..3).map(|corner| in_part[corner] * part[corner][k]).sum())
}

/// Cross product of two edges, both divided by a power of two, and this power. Without the division, the product of
/// very short or very long edges would underflow or overflow.
fn scaled_cross(e: DVec3, f: DVec3) -> (DVec3, f64) {
    let largest = e.abs().max_element().max(f.abs().max_element());
    if largest == 0.0 || !largest.is_finite() {
        return (DVec3::ZERO, 1.0);
    }
    let scale = 2f64.powi(largest.log2().floor() as i32);
    ((e / scale).cross(f / scale), scale)
}

/// The unit vector along `v`, even if the square of its length underflows or overflows. `None` for zero.
pub(crate) fn direction(v: DVec3) -> Option<DVec3> {
    (v / v.abs().max_element()).try_normalize()
}

/// The length of the longest edge of a triangle.
pub(crate) fn longest_edge([a, b, c]: [DVec3; 3]) -> f64 {
    a.distance(b).max(b.distance(c)).max(c.distance(a))
}

/// The centre of the bounding box of points and half of its longest side. They are the origin and the unit of unit
/// space.
pub(crate) fn centre_and_extent(points: impl Iterator<Item = DVec3>) -> (DVec3, f64) {
    let none = [DVec3::INFINITY, DVec3::NEG_INFINITY];
    let [low, high] = points.fold(none, |[low, high], v| [low.min(v), high.max(v)]);
    if low.cmpgt(high).any() {
        return (DVec3::ZERO, 1.0);
    }
    // Halved first: the sum of two large coordinates may overflow.
    (low * 0.5 + high * 0.5, (high * 0.5 - low * 0.5).max_element())
}

/// Area of a triangle.
pub(crate) fn triangle_area([a, b, c]: [DVec3; 3]) -> f64 {
    let (cross, scale) = scaled_cross(b - a, c - a);
    0.5 * cross.length() * scale * scale
}

/// Collects triangles and welds their corners. Triangles without area are dropped and counted.
#[derive(Default)]
pub(crate) struct SceneBuilder {
    scene: Scene,
    welded: std::collections::HashMap<[u64; 3], u32>,
    pushed: u32,
}

impl SceneBuilder {
    /// Begins a new face. The next triangles belong to it.
    pub(crate) fn face(&mut self, line: Option<usize>, part: u32) {
        self.scene.faces.push(Face { first: self.pushed, line, part });
    }

    /// Adds the next triangle of the file. `texcoords` are kept if any triangle has some.
    pub(crate) fn push(&mut self, corners: [DVec3; 3], material: u32, texcoords: Option<[DVec2; 3]>) {
        assert!(corners.iter().all(|c| c.is_finite()), "a vertex is not finite");
        let source = self.pushed;
        self.pushed += 1;
        let area = triangle_area(corners);
        if area <= 0.0 || !area.is_finite() {
            self.scene.degenerate += 1;
            self.scene.degenerate_sources.push(source);
            return;
        }
        let vertices = corners.map(|c| {
            // Adding zero turns -0 into 0, which is the same place.
            let key = (c + 0.0).to_array().map(f64::to_bits);
            *self.welded.entry(key).or_insert_with(|| {
                self.scene.vertices.push(c);
                (self.scene.vertices.len() - 1) as u32
            })
        });
        self.scene.triangles.push(Triangle { vertices, material, source });
        // Triangles before the first one with texture coordinates get zeros. A scene without any has no such list.
        if texcoords.is_some() || !self.scene.texcoords.is_empty() {
            self.scene.texcoords.resize(self.scene.triangles.len() - 1, Default::default());
            self.scene.texcoords.push(texcoords.unwrap_or_default());
        }
    }

    /// Adds the next triangle of the file: three of the corners `points` of a face.
    pub(crate) fn push_part(
        &mut self,
        points: &[DVec3],
        corners: [usize; 3],
        material: u32,
        texcoords: Option<[DVec2; 3]>,
    ) {
        let before = self.scene.triangles.len();
        self.push(corners.map(|i| points[i]), material, texcoords);
        if !self.scene.faces.is_empty() && self.scene.triangles.len() > before {
            self.scene.face_corners.push(corners.map(|i| i as u32));
        }
    }

    /// The scene with triangles and vertices, but without materials.
    pub(crate) fn finish(self) -> Scene {
        self.scene
    }
}
