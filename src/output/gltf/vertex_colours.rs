//! The patches of a solution as glTF, with radiosity as vertex colours.
//!
//! Materials are unlit (KHR_materials_unlit) and white, so that a viewer shows COLOR_0 without any shading. The
//! specification limits colours to 1, so everything brighter than white is white. A face shows the side of its patch
//! that has more light.

use std::{
    collections::HashMap,
    f64::consts::PI,
    io::{self, Write},
};

use serde_json::json;

use super::{GENERATOR, Glb};
use crate::{
    output::{
        lit_sides::lit_sides,
        vertex_colors,
        vertices::{CREASE, PatchMesh},
    },
    patch::Patches,
    scene::Scene,
    solve::Light,
    tone::{Exposure, rgb},
};

/// Writes the patches, with a primitive for each material.
///
/// # Errors
/// Errors of writing to `out`.
///
/// # Panics
/// If the sizes disagree.
pub fn encode(
    out: &mut dyn Write,
    scene: &Scene,
    patches: &Patches,
    light: Light<'_>,
    exposure: Exposure,
) -> io::Result<()> {
    let mesh = PatchMesh::new(scene, patches, CREASE);
    let colours = vertex_colors::radiosity(scene, patches, &mesh, light);
    let channels = patches.channels();
    let shown = lit_sides(scene, patches, light);
    let mut glb = Glb::new(json!({
        "asset": {"version": "2.0", "generator": GENERATOR}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "radiosity", "mesh": 0}],
        "extras": {"radiosity": {"white": exposure.white() / PI}},
    }));
    glb.uses("KHR_materials_unlit");
    let mut faces: Vec<Vec<[u32; 3]>> = vec![Vec::new(); scene.materials.len()];
    for face in 0..mesh.faces() {
        let (patch, _) = mesh.patch(face);
        if shown[patch] {
            faces[scene.triangles[patches.triangle(patch)].material as usize].push(mesh.face(face));
        }
    }
    let mut primitives = Vec::new();
    for (material, faces) in scene.materials.iter().zip(faces).filter(|(_, faces)| !faces.is_empty()) {
        let (mut known, mut positions, mut values) = (HashMap::new(), Vec::new(), Vec::new());
        let mut vertex = |v: u32| {
            *known.entry(v).or_insert_with(|| {
                positions.push(mesh.positions()[v as usize].to_array().map(|x| x as f32));
                let value = rgb(&colours[v as usize * channels..][..channels]);
                values.push(value.map(|x| (x * exposure.scale).clamp(0.0, 1.0) as f32));
                positions.len() as u32 - 1
            })
        };
        let corners: Vec<[u32; 3]> = faces.iter().map(|face| face.map(&mut vertex)).collect();
        let index = glb.push(
            "materials",
            json!({"name": material.name, "doubleSided": true, "extensions": {"KHR_materials_unlit": {}},
                "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0}}),
        );
        let attributes =
            json!({"POSITION": glb.vectors(&positions, true), "COLOR_0": glb.vectors(&values, false)});
        let indices = glb.triangles(&corners);
        primitives.push(json!({"attributes": attributes, "indices": indices, "material": index}));
    }
    glb.push("meshes", json!({"name": "radiosity", "primitives": primitives}));
    out.write_all(&glb.finish())
}
