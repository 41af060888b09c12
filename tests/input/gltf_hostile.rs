//! glTF files that break readers are refused with one line that says where, or read with a warning.

use radiosity::{Error, Scene};
use serde_json::{Value, json};

use crate::common::gltf::Gltf;

fn triangle() -> Gltf {
    let mut file = Gltf::new();
    let position = file.floats::<3>(&[[0., 0., 0.], [2., 0., 0.], [0., 1., 0.]]);
    let indices = file.indices(&[0, 1, 2]);
    file.primitive(json!({"attributes": {"POSITION": position}, "indices": indices}));
    file
}

/// The message and the hint of the error for a file of these bytes.
fn refused(bytes: &[u8], name: &str) -> (String, Option<String>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    let error = Scene::load(&path).expect_err("the file should be refused");
    assert!(matches!(error, Error::Input { .. }), "{error:?}");
    let said = error.to_string();
    assert!(!said.contains('\n') && said.len() < 400 + path.as_os_str().len(), "{said}");
    (said, error.hint().map(Into::into))
}

/// A triangle whose file has this value at the path.
fn changed(path: &str, value: Value) -> Gltf {
    let mut file = triangle();
    let mut at = &mut file.json;
    for word in path.split('.') {
        at = match word.parse::<usize>() {
            Ok(index) => &mut at[index],
            Err(_) => &mut at[word],
        };
    }
    *at = value;
    file
}

#[test]
fn each_fault_is_refused_and_named() {
    for (path, value, said) in [
        ("nodes.0.mesh", json!("cube"), "invalid type: string \"cube\", expected usize, after `"),
        ("accessors.0.bufferView", json!(9), "accessors[0]: bufferViews[9] does not exist"),
        ("accessors.0.count", json!(4), "accessors[0]: it ends beyond bufferViews[0]"),
        ("accessors.0.count", json!(1u64 << 62), "more than the buffers can hold"),
        ("accessors.0.count", json!(-1), "invalid value"),
        ("accessors.0.byteOffset", json!(1u64 << 63), "it ends beyond"),
        ("accessors.0.componentType", json!(5127), "componentType 5127 is unknown"),
        ("accessors.0.type", json!("VEC4"), "its type must be VEC3, not VEC4"),
        ("accessors.1.componentType", json!(5126), "unsigned integers"),
        ("bufferViews.0.byteLength", json!(1u64 << 40), "bufferViews[0] ends beyond its buffer"),
        ("bufferViews.0.byteOffset", json!(u64::MAX), "bufferViews[0] ends beyond its buffer"),
        ("bufferViews.0.buffer", json!(7), "buffers[7] does not exist"),
        ("bufferViews.0.byteStride", json!(4), "byteStride 4 is less than its elements of 12 bytes"),
        ("nodes.0.children", json!([0]), "nodes[0]: it is met twice"),
        ("nodes.0.children", json!([4]), "nodes[4]: it does not exist"),
        ("nodes.0.mesh", json!(4), "meshes[4] does not exist"),
        ("nodes.0.rotation", json!([0, 0, 0, 0]), "not a quaternion"),
        ("nodes.0.matrix", json!([1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]), "last row"),
        ("scene", json!(5), "scenes[5] does not exist"),
        ("scenes.0.nodes", json!([]), "no triangles"),
        ("meshes.0.primitives.0.mode", json!(7), "mode 7 is unknown"),
        ("meshes.0.primitives.0.material", json!(2), "materials[2] does not exist"),
        ("meshes.0.primitives.0.attributes.POSITION", json!(20), "accessors[20]: it does not exist"),
        ("meshes.0.primitives.0.attributes.COLOR_0", json!(1), "accessors[1]"),
        ("asset.version", json!("1.0"), "glTF of version 1.0"),
        ("asset.minVersion", json!("2.1"), "needs a reader of glTF 2.1"),
        ("extensionsRequired", json!(["ACME_everything"]), "ACME_everything, which is not supported"),
    ] {
        let (found, _) = refused(&changed(path, value).glb(), "scene.glb");
        assert!(found.contains(said), "{path}: {found}");
    }
}

#[test]
fn compressed_files_are_refused_with_the_command_that_unpacks_them() {
    for name in [
        "KHR_draco_mesh_compression",
        "EXT_meshopt_compression",
        "KHR_meshopt_compression",
        "KHR_texture_basisu",
    ] {
        let (said, hint) = refused(&changed("extensionsRequired", json!([name])).glb(), "scene.glb");
        assert!(said.contains(name), "{said}");
        assert!(hint.is_some_and(|hint| hint.contains("gltf-transform")), "{name}");
    }
    // It is not listed as required, but the file has nothing else.
    let mut file =
        changed("meshes.0.primitives.0.extensions", json!({"KHR_draco_mesh_compression": {"bufferView": 0}}));
    file.json["accessors"][0] = json!({"componentType": 5126, "count": 3, "type": "VEC3"});
    let (said, hint) = refused(&file.glb(), "scene.glb");
    assert!(said.contains("compressed") && hint.is_some(), "{said}");
}

#[test]
fn impossible_material_values_are_refused() {
    for (material, said) in [
        (
            json!({"pbrMetallicRoughness": {"baseColorFactor": [1.5, 0, 0, 1]}}),
            "reflectance 1.5 is outside 0..1",
        ),
        (json!({"pbrMetallicRoughness": {"metallicFactor": -1}}), "metallicFactor -1 is outside 0..1"),
        (json!({"emissiveFactor": [-1, 0, 0]}), "emission -1.0"),
        (
            json!({"emissiveFactor": [1, 1, 1], "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 1e200}}}),
            "emission 1e200",
        ),
    ] {
        let mut file = changed("meshes.0.primitives.0.material", json!(0));
        file.push("materials", material);
        let (found, _) = refused(&file.glb(), "scene.glb");
        assert!(found.contains(said), "{found}");
    }
}

#[test]
fn indices_out_of_range_are_refused() {
    let mut file = triangle();
    file.json["meshes"][0]["primitives"][0]["indices"] = file.indices(&[0, 1, 999]).into();
    assert!(refused(&file.glb(), "a.glb").0.contains("index 999 of 3 vertices"));
    for (count, index, said) in
        [(1, 3, "sparse index 3 of 3"), (4, 0, "4 of 3 elements are sparse"), (2, 0, "sparse part ends")]
    {
        let mut file = triangle();
        let (indices, values) = (file.view(&[index]), file.view(&[0; 12]));
        file.json["accessors"][0]["sparse"] = json!({"count": count,
            "indices": {"bufferView": indices, "componentType": 5121}, "values": {"bufferView": values}});
        let (found, _) = refused(&file.glb(), "a.glb");
        assert!(found.contains(said), "{found}");
    }
    let mut file = triangle();
    file.json["nodes"][0]["translation"] = json!([0, 0, 0]);
    file.json["nodes"][0]["matrix"] = json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
    assert!(refused(&file.glb(), "a.glb").0.contains("a matrix and a translation"));
}

#[test]
fn broken_and_truncated_files_are_refused() {
    let whole = triangle().glb();
    for cut in [0, 3, 11, 15, 40, whole.len() - 1] {
        refused(&whole[..cut], "scene.glb");
    }
    let mut old = whole.clone();
    old[4] = 1;
    assert!(refused(&old, "scene.glb").0.contains("version 1"));
    assert!(refused(b"o cube\nv 0 0 0\n", "scene.gltf").0.contains("not a glTF file"));
    assert!(refused(b"{\"asset\":\n{\"version\": 2}}", "scene.gltf").0.contains(":2: "));
    assert!(refused("[".repeat(100_000).as_bytes(), "scene.gltf").0.contains("not a glTF file"));
    let deep = format!("{{\"extras\":{}", "[".repeat(100_000));
    assert!(refused(deep.as_bytes(), "scene.gltf").0.contains("EOF"));
}

#[test]
fn missing_buffers_are_refused_whatever_their_name() {
    for (uri, said) in [
        ("..%ff%2f%2fx", "not UTF-8"),
        ("missing.bin", "`missing.bin` not found"),
        ("http://example.com/a.bin", "is not fetched"),
        ("data:application/octet-stream;base64,AAAA", "but has 3"),
        ("data:application/octet-stream;base64,A===", "base64 is broken"),
        ("data:text/plain", "without data"),
    ] {
        let mut json = triangle().json;
        json["buffers"] = json!([{"byteLength": 44, "uri": uri}]);
        let (found, _) = refused(json.to_string().as_bytes(), "scene.gltf");
        assert!(found.contains(said), "{uri}: {found}");
    }
}

#[test]
fn nested_nodes_twenty_thousand_deep_are_read() {
    let mut file = triangle();
    let n = 20_000;
    let nodes: Vec<Value> =
        (0..n).map(|k| if k + 1 < n { json!({"children": [k + 1]}) } else { json!({"mesh": 0}) }).collect();
    file.json["nodes"] = nodes.into();
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(Scene::load(file.save(folder.path(), "deep.glb")).unwrap().triangles.len(), 1);
}
