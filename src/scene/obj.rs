//! Wavefront OBJ with MTL.
//!
//! [tobj](https://docs.rs/tobj) parses the files. A thin layer before it and one after it do the rest:
//!
//! - The layer before (`text`, `scan`, `mtl`) handles text that is not UTF-8, line ends, `\` continuations, tabs after
//!   keywords, several names or names with blanks after `mtllib`, Windows paths, `Kd` with one number, `Kd spectral`,
//!   `Kd xyz`, and statements out of order. It checks every line of numbers, because errors of tobj have no line.
//! - The layer after (`material`, and `triangulate`) checks the ranges of reflectance and radiance, reads textures with
//!   their options, and cuts polygons into triangles.
//!
//! The formats leave some questions open. This reader answers them so:
//!
//! - The reflectance is 0.5, with a warning, for a material without `Kd`, an undefined material and a face without
//!   material.
//! - A missing `Kd` is 1 beside `map_Kd`; a missing `Ke` is 1 beside `map_Ke`.
//! - The first of two definitions of a material counts.
//! - The front is the side from which the vertices run counter-clockwise. Normals only determine where pictures are
//!   smooth.
//! - `-s` and `-o` of a texture statement make `uv · s + o`.
//! - Texels are holes where `map_d`, or else the alpha of `map_Kd`, is below a half. Faces with `d 0` are left out.
//! - Only materials that faces use are kept.
//! - `Ks` is a modified Phong lobe of exponent `Ns`. With `illum 3` it is a mirror, with `illum 5` a mirror with
//!   Schlick's Fresnel term.
//! - With `Pr` or `Pm`, the material is glTF's metallic-roughness model with the base colour `Kd`.

mod map_line;
mod material;
mod mtl;
mod scan;

use std::path::Path;

use glam::{DVec2, DVec3};

use self::material::Materials;
use self::mtl::{Libraries, Origin};
use self::scan::{Face, Scan};
use super::{LoadOptions, Scene, SceneBuilder, text, triangulate};
use crate::{Error, Result};

/// Reads `path` and the material libraries it names.
///
/// # Errors
/// [`Error::Io`] when `path` cannot be read. [`Error::Input`], with a line if there is one, when the contents of the
/// file or of its libraries cannot be used. Missing libraries and textures are warnings.
pub(super) fn load(path: &Path, options: &LoadOptions) -> Result<Scene> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    let text = text::decode(bytes);
    let mut scan = scan::scan(path, &text)?;
    if scan.faces.is_empty() && text.contains('\0') {
        return Err(Error::input(path, None, "not an OBJ file: it is not text")
            .with_hint("the name ends in .obj, but the contents are of another kind"));
    }
    drop(text);
    if scan.faces.is_empty() {
        return Err(Error::input(path, None, "no faces")
            .with_hint("an OBJ file needs lines like `f 1 2 3`; points and lines have no area to light"));
    }
    let mut libraries = Libraries::read(path, &scan, options);
    let (models, definitions) = parse(path, &scan, &libraries)?;
    scan.text = String::new();

    // A reflectance from the options takes precedence over colours, because colours are rarely measured values.
    let coloured = options.reflectance.is_none() && !scan.colours.is_empty();
    let smooth = !scan.normals.is_empty();
    let mut assembly = Assembly {
        path,
        materials: Materials::new(*options),
        builder: SceneBuilder::default(),
        coloured: coloured.then_some(&scan),
        smooth: smooth.then_some(&scan),
        colours: Vec::new(),
        normals: Vec::new(),
    };
    assembly.add(&models, &scan.faces, &definitions, &libraries.origins)?;
    let Assembly { mut materials, builder, mut colours, normals, .. } = assembly;

    let mut warnings = scan.warnings;
    warnings.append(libraries.warnings);
    warnings.append(materials.warnings);
    let mut scene = builder.finish();
    if !colours.is_empty() {
        colours.resize(scene.triangles.len(), [[1.0; 3]; 3]);
    }
    scene.colours = colours;
    scene.normals = normals;
    scene.materials = materials.materials;
    scene.textures = materials.textures;
    if options.faces {
        scene.parts = scan.parts;
    }
    scene.warnings = warnings.into_sentences();
    scene.files = vec![path.to_owned()];
    scene.files.append(&mut libraries.files);
    scene.files.append(&mut materials.files);
    scene.missing = libraries.missing;
    scene.missing.append(&mut materials.missing);
    if scene.triangles.is_empty() {
        return Err(Error::input(path, None, "every face has zero area")
            .with_hint("check that the vertices of the faces are at different places"));
    }
    Ok(scene)
}

fn parse(path: &Path, scan: &Scan, libraries: &Libraries) -> Result<(Vec<tobj::Model>, Vec<tobj::Material>)> {
    // tobj gets all libraries as one text. `Libraries` finds the files.
    let text = format!("mtllib all\n{}", scan.text);
    let failed = |e: tobj::LoadError| Error::input(path, None, format!("not understood: {e}"));
    let (models, materials) = tobj::load_obj_buf(&mut text.as_bytes(), &tobj::LoadOptions::default(), |_| {
        tobj::load_mtl_buf(&mut libraries.text.as_bytes())
    })
    .map_err(failed)?;
    let materials = materials.map_err(failed)?;
    assert_eq!(
        materials.len(),
        libraries.origins.len(),
        "tobj and the layer before it agree on the materials"
    );
    Ok((models, materials))
}

struct Assembly<'a> {
    path: &'a Path,
    materials: Materials,
    builder: SceneBuilder,
    /// The scan, if vertices have colours.
    coloured: Option<&'a Scan>,
    /// The scan, if there are normals.
    smooth: Option<&'a Scan>,
    /// Colours of each triangle's corners.
    colours: Vec<[[f32; 3]; 3]>,
    /// Normals of each triangle's corners.
    normals: Vec<[[f32; 3]; 3]>,
}

impl Assembly<'_> {
    /// Adds the polygons of all models. They come in file order, like `faces`.
    fn add(
        &mut self,
        models: &[tobj::Model],
        faces: &[Face],
        definitions: &[tobj::Material],
        origins: &[Origin],
    ) -> Result<()> {
        let mut faces = faces.iter();
        let mut without_material = None;
        for mesh in models.iter().map(|model| &model.mesh) {
            let mut start = 0;
            let count =
                if mesh.face_arities.is_empty() { mesh.indices.len() / 3 } else { mesh.face_arities.len() };
            for i in 0..count {
                let arity = mesh.face_arities.get(i).map_or(3, |&n| n as usize);
                let face = faces.next().expect("tobj and the layer before it agree on the faces");
                let [colours, normals] = [self.colours_of(face, arity), self.normals_of(face, arity)];
                let kind = (face.textured, colours.is_some());
                let material = self.materials.index(mesh.material_id, kind, definitions, origins)?;
                if mesh.material_id.is_none() && colours.is_none() {
                    without_material.get_or_insert(face.line);
                }
                self.polygon(mesh, start..start + arity, face, material, [colours, normals])?;
                start += arity;
            }
        }
        assert!(faces.next().is_none(), "tobj and the layer before it agree on the faces");
        if let Some(line) = without_material
            && self.materials.options.reflectance.is_none()
        {
            self.materials.warnings.push(format!(
                "{}:{line}: faces without a material get {}",
                self.path.display(),
                self.materials.options.default_in_words()
            ));
        }
        Ok(())
    }

    /// The colours of a face's vertices, if all have one.
    fn colours_of(&self, face: &Face, arity: usize) -> Option<Vec<[f32; 3]>> {
        let scan = self.coloured?;
        scan.corners[face.corners..][..arity].iter().map(|&(v, _)| scan.colours[v as usize]).collect()
    }

    /// The normals of a face's corners; zero for a corner without one.
    fn normals_of(&self, face: &Face, arity: usize) -> Option<Vec<[f32; 3]>> {
        let scan = self.smooth?;
        let normal = |&(_, vn): &(u32, u32)| scan.normals.get(vn as usize).copied().unwrap_or_default();
        Some(scan.corners[face.corners..][..arity].iter().map(normal).collect())
    }

    fn polygon(
        &mut self,
        mesh: &tobj::Mesh,
        corners: std::ops::Range<usize>,
        face: &Face,
        material: u32,
        [colours, normals]: [Option<Vec<[f32; 3]>>; 2],
    ) -> Result<()> {
        let points: Vec<DVec3> = mesh.indices[corners.clone()]
            .iter()
            .map(|&i| DVec3::from_slice(&mesh.positions[3 * i as usize..]))
            .collect();
        let uv: Option<Vec<DVec2>> = face.textured.then(|| {
            mesh.texcoord_indices[corners]
                .iter()
                .map(|&i| DVec2::from_slice(&mesh.texcoords[2 * i as usize..]))
                .collect()
        });
        let triangles = triangulate::polygon(&points)
            .ok_or_else(|| Error::input(self.path, Some(face.line), triangulate::TOO_MANY))?;
        if self.materials.options.faces {
            self.builder.face(Some(face.line), face.part);
        }
        for triangle in triangles {
            let uv = uv.as_ref().map(|uv| triangle.map(|i| uv[i]));
            let kept = self.builder.scene.triangles.len();
            self.builder.push_part(&points, triangle, material, uv);
            if self.builder.scene.triangles.len() > kept {
                if let Some(colours) = &colours {
                    self.colours.resize(kept, [[1.0; 3]; 3]);
                    self.colours.push(triangle.map(|i| colours[i]));
                }
                self.normals.extend(normals.as_ref().map(|normals| triangle.map(|i| normals[i])));
            }
        }
        Ok(())
    }
}
