//! Everything that glTF files state arrives in the scene: positions, corners, colours, textures, light.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_3};

use glam::{DMat4, DQuat, DVec3, dvec3};
use radiosity::{
    Scene,
    scene::{
        Distribution, Fresnel, LoadOptions, Specular,
        light::{LightKind, Units},
    },
    tone,
};
use serde_json::{Value, json};

use crate::common::gltf::Gltf;

const WHOLE: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
const MIDDLE: [f64; 3] = [1.0 / 3.0; 3];

fn load(file: &Gltf) -> Scene {
    let folder = tempfile::tempdir().unwrap();
    Scene::load(file.save(folder.path(), "scene.glb")).unwrap()
}

/// One grey triangle without indices.
fn triangle() -> (Gltf, usize) {
    let mut file = Gltf::new();
    let grey = file.material("grey", [0.5; 3], [0.0; 3]);
    let position = file.floats::<3>(&[[0., 0., 0.], [2., 0., 0.], [0., 1., 0.]]);
    file.primitive(json!({"attributes": {"POSITION": position}, "material": grey}));
    (file, position)
}

/// Asserts that corners agree up to the rounding of single precision.
#[track_caller]
fn assert_corners(scene: &Scene, t: usize, wanted: [DVec3; 3]) {
    for (found, wanted) in scene.corners(t).into_iter().zip(wanted) {
        assert!(found.distance(wanted) < 1e-6, "{:?} instead of {wanted:?}", scene.corners(t));
    }
}

fn near(found: [f64; 3], wanted: [f64; 3], tolerance: f64) -> bool {
    (0..3).all(|c| (found[c] - wanted[c]).abs() <= tolerance)
}

#[test]
fn nodes_place_their_meshes_and_mirrors_keep_fronts_in_front() {
    let (mut file, _) = triangle();
    let turn = DQuat::from_rotation_z(FRAC_PI_2);
    file.json["scenes"] = json!([{"nodes": [1]}]);
    file.push("nodes", json!({"children": [0, 2], "translation": [1, 2, 3], "rotation": turn.to_array(), "scale": [2, 2, 2]}));
    file.push("nodes", json!({"mesh": 0, "scale": [-1, 1, 1]}));
    // Not part of the default scene.
    file.push("nodes", json!({"mesh": 0}));
    let scene = load(&file);
    assert_eq!(scene.triangles.len(), 2);
    let place = DMat4::from_scale_rotation_translation(DVec3::splat(2.0), turn, dvec3(1., 2., 3.));
    let corners = [DVec3::ZERO, dvec3(2., 0., 0.), dvec3(0., 1., 0.)].map(|p| place.transform_point3(p));
    assert_corners(&scene, 0, corners);
    assert!((scene.normal(1) - scene.normal(0)).length() < 1e-12, "a mirrored triangle shows its front");
    // Now by a matrix, and without a default scene: all roots count, this node and the fourth.
    file.json["nodes"][1] = json!({"children": [0, 2], "matrix": place.to_cols_array()});
    file.json.as_object_mut().unwrap().remove("scene");
    let scene = load(&file);
    assert_eq!(scene.triangles.len(), 3);
    assert_corners(&scene, 0, corners);
}

#[test]
fn instances_are_placed_by_their_three_attributes() {
    let (mut file, _) = triangle();
    let translation = file.floats::<3>(&[[0., 0., 0.], [10., 0., 0.], [0., 10., 0.]]);
    let scale = file.floats::<3>(&[[1., 1., 1.], [2., 3., 1.], [1., 1., 1.]]);
    // Rotations are often normalised bytes: a half turn about z, and none.
    let rotation = file.accessor(&[0, 0, 0, 127, 0, 0, 127, 0, 0, 0, 0, 127], 5120, "VEC4", 3);
    file.json["accessors"][rotation]["normalized"] = true.into();
    file.json["nodes"][0]["extensions"] = json!({"EXT_mesh_gpu_instancing": {"attributes":
        {"TRANSLATION": translation, "SCALE": scale, "ROTATION": rotation}}});
    file.json["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
    let scene = load(&file);
    assert_eq!(scene.triangles.len(), 3);
    assert_corners(&scene, 1, [dvec3(10., 0., 0.), dvec3(6., 0., 0.), dvec3(10., -3., 0.)]);
    assert_corners(&scene, 2, [dvec3(0., 10., 0.), dvec3(2., 10., 0.), dvec3(0., 11., 0.)]);
}

#[test]
fn strips_and_fans_turn_the_way_the_specification_says() {
    let square = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [1., 1., 0.], [0., 2., 0.]];
    for (mode, order) in [(5, None), (5, Some([0u16, 1, 2, 3, 4])), (6, Some([0, 1, 3, 2, 4]))] {
        let mut file = Gltf::new();
        let position = file.floats::<3>(&square);
        let mut primitive = json!({"attributes": {"POSITION": position}, "mode": mode});
        if let Some(order) = order {
            primitive["indices"] = file.indices(&order).into();
        }
        file.primitive(primitive);
        // Lines and points have no area.
        file.primitive(json!({"attributes": {"POSITION": position}, "mode": 1}));
        let scene = load(&file);
        let flat = scene.degenerate;
        assert_eq!(scene.triangles.len() + flat, 3);
        assert!((0..3 - flat).all(|t| scene.normal(t).z > 0.0), "mode {mode}");
        assert!(scene.warnings.iter().any(|w| w.contains("1 primitives of points or lines")));
    }
}

#[test]
fn indices_of_every_width_are_read() {
    for (component, size) in [(5121, 1), (5123, 2), (5125, 4)] {
        let (mut file, _) = triangle();
        let bytes: Vec<u8> = [0u32, 2, 1].iter().flat_map(|i| i.to_le_bytes()[..size].to_vec()).collect();
        file.json["meshes"][0]["primitives"][0]["indices"] =
            file.accessor(&bytes, component, "SCALAR", 3).into();
        assert!(load(&file).normal(0).z < 0.0, "{component}");
    }
}

#[test]
fn interleaved_sparse_and_quantised_positions_are_where_they_should_be() {
    let wanted = [dvec3(0., 0., 0.), dvec3(2., 0., 0.), dvec3(0., 1., 0.)];
    // Eight other bytes follow each position.
    let (mut file, position) = triangle();
    let mut bytes = vec![9; 4];
    for p in &wanted {
        bytes.extend(p.as_vec3().to_array().iter().flat_map(|x| x.to_le_bytes()));
        bytes.extend([7; 8]);
    }
    let view = file.view(&bytes);
    file.json["bufferViews"][view]["byteStride"] = 20.into();
    file.json["accessors"][position] =
        json!({"bufferView": view, "byteOffset": 4, "componentType": 5126, "count": 3, "type": "VEC3"});
    assert_corners(&load(&file), 0, wanted);

    // Zeros, two of which are replaced.
    let (mut file, position) = triangle();
    let indices = file.view(&[1, 2]);
    let bytes: Vec<u8> = [2f32, 0., 0., 0., 1., 0.].iter().flat_map(|x| x.to_le_bytes()).collect();
    let values = file.view(&bytes);
    file.json["accessors"][position] = json!({"componentType": 5126, "count": 3, "type": "VEC3", "sparse": {"count": 2,
        "indices": {"bufferView": indices, "componentType": 5121}, "values": {"bufferView": values}}});
    assert_corners(&load(&file), 0, wanted);

    // KHR_mesh_quantization: normalised integers, and integers.
    for (normalized, unit) in [(true, 32767.0), (false, 1.0)] {
        let (mut file, position) = triangle();
        let whole = |x: f64| ((x * unit / if normalized { 2.0 } else { 1.0 }) as i16).to_le_bytes();
        let bytes: Vec<u8> =
            wanted.iter().flat_map(|p| [whole(p.x), whole(p.y), whole(p.z), [0; 2]].concat()).collect();
        let view = file.view(&bytes);
        file.json["bufferViews"][view]["byteStride"] = 8.into();
        file.json["accessors"][position] = json!({"bufferView": view, "componentType": 5122, "normalized": normalized, "count": 3, "type": "VEC3"});
        if normalized {
            file.json["nodes"][0]["scale"] = json!([2, 2, 2]);
        }
        // Half of 32767 is no integer.
        for (found, wanted) in load(&file).corners(0).into_iter().zip(wanted) {
            assert!(found.distance(wanted) <= 1.0 / 32767.0, "{found} {wanted}");
        }
    }
}

#[test]
fn skins_and_morph_targets_pose_the_mesh_at_rest() {
    let (mut file, _) = triangle();
    let target = file.floats::<3>(&[[0., 0., 1.]; 3]);
    file.json["meshes"][0]["primitives"][0]["targets"] = json!([{"POSITION": target}]);
    file.json["meshes"][0]["weights"] = json!([0.5]);
    assert_corners(&load(&file), 0, [dvec3(0., 0., 0.5), dvec3(2., 0., 0.5), dvec3(0., 1., 0.5)]);

    // Two joints at 10 and 20 along x. The node's own position does not count.
    let (mut file, _) = triangle();
    let joints = file.accessor(&[0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0], 5121, "VEC4", 3);
    let weights = file.floats::<4>(&[[1., 0., 0., 0.], [1., 0., 0., 0.], [0.5, 0.5, 0., 0.]]);
    let inverse = DMat4::from_translation(DVec3::Y).to_cols_array().map(|x| x as f32);
    let inverse = file.floats::<16>(&[inverse, inverse]);
    let attributes = &mut file.json["meshes"][0]["primitives"][0]["attributes"];
    (attributes["JOINTS_0"], attributes["WEIGHTS_0"]) = (joints.into(), weights.into());
    file.push("skins", json!({"joints": [1, 2], "inverseBindMatrices": inverse}));
    file.json["nodes"] = json!([{"mesh": 0, "skin": 0, "translation": [0, 0, 99]}, {"translation": [10, 0, 0]}, {"translation": [20, 0, 0]}]);
    file.json["scenes"][0]["nodes"] = json!([0, 1, 2]);
    assert_corners(&load(&file), 0, [dvec3(10., 1., 0.), dvec3(22., 1., 0.), dvec3(15., 2., 0.)]);
}

/// A texture of two by two texels: red and green above, blue and white below.
fn four() -> image::RgbaImage {
    image::RgbaImage::from_fn(2, 2, |x, y| {
        image::Rgba([[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [255; 4]][(2 * y + x) as usize])
    })
}

/// The reflectance of a small triangle around the point (u, v) of a texture, with v downward. `info` adds to the
/// texture's entry.
fn at(u: f64, v: f64, info: Value, sampler: Value) -> [f64; 3] {
    let (mut file, _) = triangle();
    let texture = file.texture(&four());
    file.json["textures"][texture]["sampler"] = file.push("samplers", sampler).into();
    let (u, v) = (u as f32, v as f32);
    let uv = file.floats::<2>(&[[u - 0.02, v - 0.02], [u + 0.04, v - 0.02], [u - 0.02, v + 0.04]]);
    let mut info = info;
    info["index"] = texture.into();
    let set = info["texCoord"].as_u64().unwrap_or(0);
    let set = info["extensions"]["KHR_texture_transform"]["texCoord"].as_u64().unwrap_or(set);
    file.json["meshes"][0]["primitives"][0]["attributes"][format!("TEXCOORD_{set}")] = uv.into();
    file.json["materials"][0]["pbrMetallicRoughness"] =
        json!({"metallicFactor": 0, "baseColorTexture": info});
    load(&file).mean_reflectance(0, &WHOLE)
}

#[test]
fn textures_are_looked_up_where_the_file_says() {
    let (red, green, blue, white) = ([1., 0., 0.], [0., 1., 0.], [0., 0., 1.], [1.; 3]);
    assert_eq!(at(0.25, 0.25, json!({}), json!({})), red);
    assert_eq!(at(0.75, 0.25, json!({"texCoord": 1}), json!({})), green);
    assert_eq!(at(0.25, 0.75, json!({"texCoord": 3}), json!({})), blue);
    // Outside of 0..1: repeated, clamped, mirrored.
    assert_eq!(at(1.25, 0.25, json!({}), json!({})), red);
    assert_eq!(at(1.25, 1.75, json!({}), json!({"wrapS": 33071, "wrapT": 33071})), white);
    assert_eq!(at(1.25, 0.25, json!({}), json!({"wrapS": 33648})), green);
    assert_eq!(at(1.75, 0.25, json!({}), json!({"wrapS": 33648})), red);
    assert_eq!(at(2.25, -0.25, json!({}), json!({"wrapS": 33648, "wrapT": 33648})), red);
    assert_eq!(at(0.25, 1.25, json!({}), json!({"wrapT": 33648})), blue);
    assert_eq!(at(0.25, 1.75, json!({}), json!({"wrapS": 33648, "wrapT": 33648})), red);
    // KHR_texture_transform moves, scales and rotates as its example does, and may name another set of coordinates.
    let with = |transform: Value| json!({"extensions": {"KHR_texture_transform": transform}});
    assert_eq!(at(0.25, 0.25, with(json!({"offset": [0.5, 0.0], "texCoord": 2})), json!({})), green);
    assert_eq!(at(1.25, 0.75, with(json!({"scale": [0.5, 0.5]})), json!({})), green);
    // A quarter turn takes (0.2, 0.7) to (0.7, -0.2).
    assert_eq!(at(0.2, 0.7, with(json!({"rotation": FRAC_PI_2})), json!({})), white);
}

#[test]
fn reflectance_is_factor_times_texture_times_colour_without_the_metallic_part() {
    let (mut file, _) = triangle();
    let grey = image::RgbaImage::from_pixel(1, 1, image::Rgba([188, 188, 188, 255]));
    let texture = file.texture(&grey);
    let uv = file.floats::<2>(&[[0., 0.], [1., 0.], [0., 1.]]);
    let colours = file.floats::<4>(&[[1., 0.5, 0.25, 1.], [1., 0.5, 0.25, 1.], [0.4, 2.0, 0.25, 1.]]);
    let attributes = &mut file.json["meshes"][0]["primitives"][0]["attributes"];
    (attributes["TEXCOORD_0"], attributes["COLOR_0"]) = (uv.into(), colours.into());
    file.json["materials"][0]["pbrMetallicRoughness"] = json!({"metallicFactor": 0.25, "baseColorFactor": [0.8, 0.8, 0.8, 1], "baseColorTexture": {"index": texture}});
    let scene = load(&file);
    assert_eq!(scene.channels(), 3);
    let texel = tone::linear(188.0 / 255.0);
    // Colours are linear and clamped. The mean of a linear function is its value in the middle.
    let wanted = [0.8, 2.0 / 3.0, 0.25].map(|c| 0.75 * 0.8 * texel * c);
    assert!(near(scene.mean_reflectance(0, &WHOLE), wanted, 1e-7), "{:?}", scene.mean_reflectance(0, &WHOLE));
    assert!(near(scene.reflectance_at(0, MIDDLE), wanted, 1e-7));
    let at_last = [0.4, 1.0, 0.25].map(|c| 0.6 * texel * c);
    assert!(near(scene.reflectance_at(0, [0.0, 0.0, 1.0]), at_last, 1e-7));
    assert!(scene.warnings.iter().any(|w| w.contains("`grey` is metal (0.25)")), "{:?}", scene.warnings);

    // The left half of the texture is metal, where nothing reflects diffusely.
    let metal =
        image::RgbaImage::from_fn(2, 1, |x, _| image::Rgba([0, 99, if x == 0 { 255 } else { 0 }, 255]));
    let metal = file.texture(&metal);
    file.json["materials"][0]["pbrMetallicRoughness"] =
        json!({"baseColorTexture": {"index": texture}, "metallicRoughnessTexture": {"index": metal}});
    file.json["meshes"][0]["primitives"][0]["attributes"].as_object_mut().unwrap().remove("COLOR_0");
    let scene = load(&file);
    // The triangle's left half has three quarters of its area.
    assert!(near(scene.mean_reflectance(0, &WHOLE), [0.25 * texel; 3], 1e-9));
    assert_eq!(scene.reflectance_at(0, [1.0, 0.0, 0.0]), [0.0; 3]);
}

/// The mean of a texture times colours is the exact integral of their product over the triangle, to rounding.
#[test]
fn a_texture_and_colours_that_both_vary_have_the_mean_of_their_product() {
    let (mut file, _) = triangle();
    let texture = file.texture(&image::RgbaImage::from_fn(2, 1, |x, _| image::Rgba([(255 * x) as u8; 4])));
    let uv = file.floats::<2>(&[[0., 0.], [1., 0.], [0., 1.]]);
    let colours = file.floats::<3>(&[[0., 0., 0.], [1., 1., 1.], [0., 0., 0.]]);
    let attributes = &mut file.json["meshes"][0]["primitives"][0]["attributes"];
    (attributes["TEXCOORD_0"], attributes["COLOR_0"]) = (uv.into(), colours.into());
    file.json["materials"][0]["pbrMetallicRoughness"] =
        json!({"metallicFactor": 0, "baseColorTexture": {"index": texture}});
    let scene = load(&file);
    // The mean of u over u > 1/2 in the triangle u, v ≥ 0, u + v ≤ 1: twice the integral of u (1 - u) from 1/2 to 1,
    // 1/6.
    let exact = 2.0 * ((0.5 - 1.0 / 3.0) - (0.125 - 1.0 / 24.0));
    let found = scene.mean_reflectance(0, &WHOLE)[0];
    assert!((found - exact).abs() < 1e-9, "{found} for {exact}");
}

#[test]
fn emission_is_factor_times_strength_times_its_own_texture() {
    let (mut file, _) = triangle();
    let (base, glow) =
        (file.texture(&image::RgbaImage::from_pixel(1, 1, image::Rgba([255; 4]))), file.texture(&four()));
    let first = file.floats::<2>(&[[0.1, 0.1], [0.2, 0.1], [0.1, 0.2]]);
    let second = file.floats::<2>(&[[0.6, 0.1], [0.7, 0.1], [0.6, 0.2]]);
    let attributes = &mut file.json["meshes"][0]["primitives"][0]["attributes"];
    (attributes["TEXCOORD_0"], attributes["TEXCOORD_1"]) = (first.into(), second.into());
    file.json["materials"][0] = json!({"name": "lamp", "emissiveFactor": [1, 0.5, 1],
        "emissiveTexture": {"index": glow, "texCoord": 1},
        "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 8}},
        "pbrMetallicRoughness": {"metallicFactor": 0, "baseColorTexture": {"index": base}}});
    // A triangle without emission before it has only one set of coordinates.
    let plain = file.floats::<3>(&[[5., 0., 0.], [6., 0., 0.], [5., 1., 0.]]);
    let grey = file.material("grey", [0.5; 3], [0.0; 3]);
    file.json["meshes"][0]["primitives"]
        .as_array_mut()
        .unwrap()
        .insert(0, json!({"attributes": {"POSITION": plain}, "material": grey}));
    let scene = load(&file);
    assert_eq!(scene.mean_emission(0, &WHOLE), [0.0; 3]);
    assert_eq!(scene.mean_emission(1, &WHOLE), [0.0, 4.0, 0.0]);
    assert_eq!(scene.emission_at(1, MIDDLE), [0.0, 4.0, 0.0]);
    assert_eq!(scene.mean_reflectance(1, &WHOLE), [1.0; 3]);
    assert_eq!(scene.backs_of_lamps, 0);

    // Without its image the lamp's emission is unknown.
    file.json["images"][1] = json!({"uri": "missing.png"});
    let folder = tempfile::tempdir().unwrap();
    let scene = Scene::load(file.save(folder.path(), "scene.glb")).unwrap();
    assert!(!scene.has_emitter());
    assert_eq!(scene.missing, ["missing.png"]);
    assert!(
        scene.warnings.iter().any(|w| w.contains("`missing.png` not found; it does not emit")),
        "{:?}",
        scene.warnings
    );
}

#[test]
fn double_sided_lamps_shine_from_both_sides_where_they_are_open() {
    let (mut file, _) = triangle();
    file.json["materials"][0]["emissiveFactor"] = json!([1, 1, 1]);
    assert_eq!((load(&file).triangles.len(), load(&file).backs_of_lamps), (1, 0));
    file.json["materials"][0]["doubleSided"] = true.into();
    let scene = load(&file);
    assert_eq!((scene.triangles.len(), scene.backs_of_lamps), (2, 1));
    assert!((scene.normal(0) + scene.normal(1)).length() < 1e-12);
    assert_eq!(scene.triangles[1].source, 0);
    // The inside of a closed tetrahedron gets no lamps.
    let indices = file.indices(&[0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3]);
    let position = file.floats::<3>(&[[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]]);
    file.json["meshes"][0]["primitives"] =
        json!([{"attributes": {"POSITION": position}, "indices": indices, "material": 0}]);
    assert_eq!((load(&file).triangles.len(), load(&file).backs_of_lamps), (4, 0));
}

#[test]
fn what_diffuse_light_ignores_is_reported_once() {
    let mut file = Gltf::new();
    for (k, extra) in [
        json!({"alphaMode": "BLEND"}),
        json!({"extensions": {"KHR_materials_transmission": {"transmissionFactor": 1}}}),
        json!({"extensions": {"KHR_materials_unlit": {}}}),
        json!({"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 1]}}),
        json!({"extensions": {"KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [0.25, 0.5, 0.75, 1]}}}),
    ]
    .into_iter()
    .enumerate()
    {
        let material = file.material(&format!("m{k}"), [0.5; 3], [0.0; 3]);
        for (key, value) in extra.as_object().unwrap() {
            file.json["materials"][material][key] = value.clone();
        }
        let corner = [2.0 * k as f32, 0., 0.];
        file.rectangle(corner, [1., 0., 0.], [0., 1., 0.], material);
    }
    file.push("animations", json!({"channels": [], "samplers": []}));
    let scene = load(&file);
    for said in
        ["`m0` is transparent", "`m1` lets light through", "`m2` is unlit", "`m3` has neither", "at rest"]
    {
        let times = scene.warnings.iter().filter(|w| w.contains(said)).count();
        assert_eq!(times, 1, "{said}: {:?}", scene.warnings);
    }
    assert!((0..8).all(|t| scene.mean_reflectance(t, &WHOLE) == [0.5; 3]));
    assert_eq!(scene.mean_reflectance(8, &WHOLE), [0.25, 0.5, 0.75]);
    let folder = tempfile::tempdir().unwrap();
    let options = LoadOptions::default().with_unlit_emits(true);
    let lit = Scene::load_with(file.save(folder.path(), "scene.glb"), &options).unwrap();
    assert_eq!((lit.mean_emission(4, &WHOLE), lit.mean_reflectance(4, &WHOLE)), ([0.5; 3], [0.0; 3]));
}

#[test]
fn text_files_with_buffers_beside_them_or_in_them_are_the_same_scene() {
    let (file, _) = triangle();
    let folder = tempfile::tempdir().unwrap();
    let binary = Scene::load(file.save(folder.path(), "scene.glb")).unwrap();
    std::fs::write(folder.path().join("my data.bin"), &file.bytes).unwrap();
    // The bytes of the three corners.
    let base64 = "AAAAAAAAAAAAAAAAAAAAQAAAAAAAAAAAAAAAAAAAgD8AAAAA";
    for uri in ["my%20data.bin".to_owned(), format!("data:application/octet-stream;base64,{base64}")] {
        let mut json = file.json.clone();
        json["buffers"] = json!([{"byteLength": file.bytes.len(), "uri": uri}]);
        let path = folder.path().join("scene.gltf");
        std::fs::write(&path, format!("\u{feff}{json}")).unwrap();
        let text = Scene::load(&path).unwrap();
        assert_eq!((text.vertices, &text.triangles), (binary.vertices.clone(), &binary.triangles));
        assert_eq!(text.files.len(), if uri.starts_with("data:") { 1 } else { 2 });
    }
}

#[test]
fn webp_images_are_read_by_extension_and_as_they_are() {
    let (mut file, _) = triangle();
    let mut webp = Vec::new();
    image::RgbImage::from_pixel(2, 2, image::Rgb([0, 255, 0]))
        .write_with_encoder(image::codecs::webp::WebPEncoder::new_lossless(&mut webp))
        .unwrap();
    let view = file.view(&webp);
    let image = file.push("images", json!({"bufferView": view, "mimeType": "image/webp"}));
    file.push("textures", json!({"extensions": {"EXT_texture_webp": {"source": image}}}));
    let uv = file.floats::<2>(&[[0., 0.], [1., 0.], [0., 1.]]);
    file.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = uv.into();
    file.json["materials"][0]["pbrMetallicRoughness"] =
        json!({"metallicFactor": 0, "baseColorTexture": {"index": 0}});
    file.json["extensionsRequired"] = json!(["EXT_texture_webp"]);
    assert_eq!(load(&file).mean_reflectance(0, &WHOLE), [0.0, 1.0, 0.0]);
}

/// A rotation about a diagonal axis by a quaternion of length three, which is normalised.
#[test]
fn rotations_are_quaternions_x_y_z_w_and_need_not_have_unit_length() {
    let (mut file, _) = triangle();
    let turn = DQuat::from_axis_angle(dvec3(1., 1., 1.).normalize(), 2.0 * FRAC_PI_3);
    file.json["nodes"][0]["rotation"] = json!((turn * 3.0).to_array());
    // A third of a turn about the diagonal takes x to y, y to z.
    assert_corners(&load(&file), 0, [DVec3::ZERO, dvec3(0., 2., 0.), dvec3(0., 0., 1.)]);
}

/// The remaining area of a square of four texels, with alpha 255 and 128 in the upper row, 0 and 64 in the lower row.
fn left_of_square(mask: Value, colour: [f64; 4]) -> Result<f64, radiosity::Error> {
    let mut file = Gltf::new();
    let alphas = [[255, 128], [0, 64]];
    let texels =
        image::RgbaImage::from_fn(2, 2, |x, y| image::Rgba([200, 200, 200, alphas[y as usize][x as usize]]));
    let texture = file.texture(&texels);
    let material = file.material("leaf", [1.0; 3], [0.0; 3]);
    for (key, value) in mask.as_object().unwrap() {
        file.json["materials"][material][key] = value.clone();
    }
    let pbr = &mut file.json["materials"][material]["pbrMetallicRoughness"];
    (pbr["baseColorTexture"], pbr["baseColorFactor"]) = (json!({"index": texture}), json!(colour));
    file.rectangle([0.; 3], [2., 0., 0.], [0., 2., 0.], material);
    let folder = tempfile::tempdir().unwrap();
    let scene = Scene::load(file.save(folder.path(), "scene.glb"))?;
    // The remaining surface keeps the colour of its texels.
    let texel = tone::linear(200.0 / 255.0);
    assert!((0..scene.triangles.len()).all(|t| near(scene.mean_reflectance(t, &WHOLE), [texel; 3], 1e-9)));
    Ok((0..scene.triangles.len()).map(|t| scene.area(t)).sum())
}

#[test]
fn masked_materials_have_holes_where_alpha_is_below_the_cutoff() {
    let left = |mask: Value, alpha: f64| left_of_square(mask, [1.0, 1.0, 1.0, alpha]).unwrap();
    let near = |found: f64, wanted: f64| assert!((found - wanted).abs() < 1e-9, "{found} for {wanted}");
    near(left(json!({}), 1.0), 4.0);
    near(left(json!({"alphaMode": "BLEND"}), 1.0), 4.0);
    // 128 of 255 is above a half, 64 is above 0.25.
    near(left(json!({"alphaMode": "MASK"}), 1.0), 2.0);
    near(left(json!({"alphaMode": "MASK", "alphaCutoff": 0.25}), 1.0), 3.0);
    near(left(json!({"alphaMode": "MASK", "alphaCutoff": 0.0}), 1.0), 4.0);
    // The factor multiplies the texture.
    near(left(json!({"alphaMode": "MASK"}), 0.9), 1.0);
    let none = left_of_square(json!({"alphaMode": "MASK"}), [1.0, 1.0, 1.0, 0.4]).unwrap_err();
    assert!(none.to_string().contains("no face is left"), "{none}");
}

#[test]
fn specular_reflection_is_kept_for_path_tracing() {
    let microfacets = |pbr: Value, extensions: Value| {
        let (mut file, _) = triangle();
        file.json["materials"][0] = json!({"pbrMetallicRoughness": pbr, "extensions": extensions});
        let image = image::RgbaImage::from_pixel(1, 1, image::Rgba([0, 51, 102, 255]));
        file.texture(&image);
        let uv = file.floats::<2>(&[[0., 0.], [1., 0.], [0., 1.]]);
        file.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = uv.into();
        let scene = load(&file);
        scene.materials[0].specular.as_deref().map(|specular| match specular {
            Specular::Microfacet {
                distribution: Distribution::Ggx,
                alpha: [alpha, across],
                fresnel: Fresnel::Schlick(r0),
                ..
            } if alpha == across => (*alpha, *r0),
            other => panic!("{other:?}"),
        })
    };
    let assert_near = |found: Option<(f64, [f64; 3])>, alpha: f64, r0: [f64; 3]| {
        let (found_alpha, found_r0) = found.unwrap();
        assert!((found_alpha - alpha).abs() < 1e-9 && near(found_r0, r0, 1e-9), "{found:?}");
    };
    // Alpha is the square of the roughness. A dielectric of index 1.5 reflects 4 %, a metal its base colour.
    let none = json!({});
    let plastic = json!({"metallicFactor": 0, "roughnessFactor": 0.5});
    assert_near(microfacets(plastic.clone(), none.clone()), 0.25, [0.04; 3]);
    let gold = json!({"metallicFactor": 1, "roughnessFactor": 0.2, "baseColorFactor": [1, 0.8, 0.3, 1]});
    assert_near(microfacets(gold, none.clone()), 0.04, [1.0, 0.8, 0.3]);
    let half = json!({"metallicFactor": 0.5, "roughnessFactor": 1, "baseColorFactor": [0.5, 0.5, 0.5, 1]});
    assert_near(microfacets(half, none.clone()), 1.0, [0.27; 3]);
    // Green is the roughness, blue the metallic part: 0.2 and 0.4.
    let textured = json!({"metallicRoughnessTexture": {"index": 0}, "baseColorFactor": [0.5, 0.5, 0.5, 1]});
    assert_near(microfacets(textured, none.clone()), 0.04, [0.6 * 0.04 + 0.4 * 0.5; 3]);
    // Diamond: ((2.4 - 1) / (2.4 + 1))², tinted and weakened.
    let diamond = json!({"KHR_materials_ior": {"ior": 2.4},
        "KHR_materials_specular": {"specularFactor": 0.5, "specularColorFactor": [1, 0.5, 0]}});
    let r0 = (1.4f64 / 3.4).powi(2);
    assert_near(microfacets(plastic.clone(), diamond), 0.25, [0.5 * r0, 0.25 * r0, 0.0]);

    // If the file does not mention it, or the surface is unlit, or it is switched off, there is none.
    assert_eq!(microfacets(json!({"baseColorFactor": [0.5, 0.5, 0.5, 1]}), none), None);
    assert_eq!(microfacets(plastic.clone(), json!({"KHR_materials_unlit": {}})), None);
    assert_eq!(microfacets(plastic, json!({"KHR_materials_specular": {"specularFactor": 0}})), None);
}

/// Intensities in candela and lux over 683 lm/W, times the colour. Lights shine along -z of their node, whose scale
/// does not count. Spots have glTF's default cone.
#[test]
fn punctual_lights() {
    let mut file = Gltf::new();
    let material = file.material("m", [0.5; 3], [0.0; 3]);
    file.rectangle([0., 0., 0.], [1., 0., 0.], [0., 1., 0.], material);
    file.json["extensions"] = json!({"KHR_lights_punctual": {"lights": [
        {"type": "point", "intensity": 683, "color": [1, 0.5, 0.25], "name": "bulb"},
        {"type": "spot", "intensity": 1366},
        {"type": "directional", "intensity": 68300},
    ]}});
    let half = 0.5f64.sqrt();
    for (light, node) in [
        (0, json!({"translation": [1, 2, 3], "scale": [5, 5, 5]})),
        // A quarter turn about x: -z becomes -y.
        (1, json!({"translation": [0, 4, 0], "rotation": [-half, 0, 0, half]})),
        (2, json!({"rotation": [-half, 0, 0, half]})),
    ] {
        let mut node = node;
        node["extensions"] = json!({"KHR_lights_punctual": {"light": light}});
        let node = file.push("nodes", node);
        file.json["scenes"][0]["nodes"].as_array_mut().unwrap().push(node.into());
    }
    let lights = load(&file).lights.list;
    let [bulb, spot, sun] = &lights[..] else { panic!("{lights:?}") };
    assert_eq!(bulb.name, "bulb");
    let LightKind::Point(point) = &bulb.kind else { panic!("{bulb:?}") };
    assert_eq!((point.intensity, point.position), ([1.0, 0.5, 0.25], dvec3(1.0, 2.0, 3.0)));
    let LightKind::Point(point) = &spot.kind else { panic!("{spot:?}") };
    assert!((point.intensity[0] - 2.0).abs() < 1e-12);
    let towards = |angle: f64| point.distribution.towards(dvec3(angle.sin(), -angle.cos(), 0.0));
    assert!((towards(0.0) - 1.0).abs() < 1e-12 && towards(0.8) == 0.0);
    let wanted = ((0.4f64.cos() - half) / (1.0 - half)).powi(2);
    assert!((towards(0.4) - wanted).abs() < 1e-9, "{} {wanted}", towards(0.4));
    let LightKind::Distant(sun) = &sun.kind else { panic!("{sun:?}") };
    assert!((sun.irradiance[0] - 100.0).abs() < 1e-9 && (sun.direction - DVec3::Y).length() < 1e-9);
    // With photometric units nothing is divided.
    let folder = tempfile::tempdir().unwrap();
    let options = LoadOptions::default().with_units(Units::Photometric);
    let scene = Scene::load_with(file.save(folder.path(), "scene.glb"), &options).unwrap();
    let LightKind::Point(point) = &scene.lights.list[0].kind else { panic!() };
    assert_eq!(point.intensity, [683.0, 341.5, 170.75]);
}
