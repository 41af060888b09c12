//! Binary glTF files of `bake` and `solve`: the unchanged scene with its light.

use std::{collections::BTreeSet, fs, path::Path};

use radiosity::{Scene, tone};
use serde_json::{Value, json};

use crate::common::{
    gltf::{Gltf, taken_apart},
    program::{Here, stderr},
    save_png,
};

/// The reflectance of the files is the diffuse one alone, so that what is shown is known in closed form.
const FAST: &str = "--resolution 64 --quality draft --final-gather 0 --specular drop --quiet";

/// A floor and a lamp above it that faces down, each a board.
fn boards() -> Gltf {
    let mut file = Gltf::new();
    let floor = file.material("floor", [0.5, 0.4, 0.3], [0.0; 3]);
    let lamp = file.material("lamp", [0.0; 3], [1.0; 3]);
    file.json["materials"][lamp]["extensions"] =
        json!({"KHR_materials_emissive_strength": {"emissiveStrength": 40}});
    file.rectangle([-2., 0., -2.], [0., 0., 4.], [4., 0., 0.], floor);
    file.rectangle([-0.5, 1., -0.5], [1., 0., 0.], [0., 0., 1.], lamp);
    file
}

fn here(file: &Gltf) -> Here {
    let here = Here::new("", "");
    file.save(here.directory(), "in.glb");
    here
}

fn baked(here: &Here, words: &str) -> (Value, Vec<u8>) {
    let output = here.run(&format!("bake in.glb -o out.glb {FAST} {words}"));
    assert!(output.status.success(), "{}", stderr(&output));
    taken_apart(&here.read("out.glb"))
}

/// The numbers of an accessor of single precision.
fn floats(json: &Value, bytes: &[u8], accessor: &Value, width: usize) -> Vec<Vec<f32>> {
    let accessor = &json["accessors"][accessor.as_u64().unwrap() as usize];
    assert_eq!(accessor["componentType"], 5126);
    let view = &json["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
    let stride = view["byteStride"].as_u64().unwrap() as usize;
    let start = view["byteOffset"].as_u64().unwrap() as usize;
    let count = accessor["count"].as_u64().unwrap() as usize;
    (0..count)
        .map(|i| {
            let at = |c: usize| start + i * stride + 4 * c;
            (0..width).map(|c| f32::from_le_bytes(bytes[at(c)..at(c) + 4].try_into().unwrap())).collect()
        })
        .collect()
}

/// The corners of all triangles of a file, to the bit, in any order.
fn corners(path: &Path) -> Vec<[[u64; 3]; 3]> {
    let scene = Scene::load(path).unwrap();
    let mut corners: Vec<_> = (0..scene.triangles.len())
        .map(|t| scene.corners(t).map(|p| p.to_array().map(f64::to_bits)))
        .collect();
    corners.sort_unstable();
    corners
}

/// `bake` writes the unchanged scene. Each surface is black and emits its radiosity, ρ E / π in units of white, to half
/// a step of 8 bits and 1e-3.
#[test]
fn a_lit_scene_keeps_its_contents_and_shows_the_radiosity() {
    let mut file = boards();
    file.json["nodes"][0]["name"] = "house".into();
    file.json["nodes"][0]["translation"] = json!([0.1, 0.2, 0.3]);
    file.json["extensions"] = json!({"ACME_weather": {"rain": 3}});
    file.json["extensionsUsed"] = json!(["ACME_weather", "KHR_materials_emissive_strength"]);
    file.json["extras"] = json!({"author": "somebody"});
    let (time, place) = (file.floats::<1>(&[[0.], [1.]]), file.floats::<3>(&[[0.; 3], [1.; 3]]));
    file.push(
        "animations",
        json!({"samplers": [{"input": time, "output": place}], "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}]}),
    );
    let here = here(&file);
    let (out, bytes) = baked(&here, "");
    assert_eq!(corners(&here.path("in.glb")), corners(&here.path("out.glb")));
    for kept in ["nodes", "scenes", "scene", "animations", "extensions"] {
        assert_eq!(out[kept], file.json[kept], "{kept}");
    }
    assert_eq!(out["extras"]["author"], "somebody");
    let said = &out["extras"]["radiosity"];
    assert_eq!((&said["irradiance"], &said["encoding"]), (&json!(["out.exr"]), &json!("emissive")));
    assert!(here.path("out.exr").exists());

    // The lamp is too bright for the map, so it has an emission of its own, in units of white.
    let primitives = out["meshes"][0]["primitives"].as_array().unwrap();
    let material = |p: &Value| &out["materials"][p["material"].as_u64().unwrap() as usize];
    let white = said["white"].as_f64().unwrap();
    let lamp = primitives.iter().find(|p| material(p)["name"] == "lamp").unwrap();
    let strength = &material(lamp)["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"];
    assert!((strength.as_f64().unwrap() - 40.0 / white).abs() < 1e-6 * 40.0 / white);
    assert!(material(lamp).get("emissiveTexture").is_none());

    // The floor is black and emits its part of the map: reflectance times irradiance at each texel.
    let floor = primitives.iter().find(|p| material(p)["name"] == "floor").unwrap();
    assert_eq!(material(floor)["pbrMetallicRoughness"]["baseColorFactor"], json!([0.0, 0.0, 0.0, 1.0]));
    assert_eq!(material(floor)["extras"]["radiosity"]["material"], 0);
    assert_eq!(material(floor)["emissiveTexture"]["texCoord"], 1);
    let strength = material(floor)["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"]
        .as_f64()
        .unwrap();
    let view = &out["bufferViews"][out["images"][0]["bufferView"].as_u64().unwrap() as usize];
    let range = |key: &str| view[key].as_u64().unwrap() as usize;
    let png = &bytes[range("byteOffset")..][..range("byteLength")];
    let shown = image::load_from_memory(png).unwrap().into_rgb8();
    let map = image::load_from_memory(&here.read("out.exr")).unwrap().into_rgb32f();
    assert_eq!(shown.dimensions(), map.dimensions());
    let mut compared = 0;
    for uv in floats(&out, &bytes, &floor["attributes"]["TEXCOORD_1"], 2) {
        assert!(uv.iter().all(|x| (0.0..=1.0).contains(x)));
    }
    for (x, y, pixel) in shown.enumerate_pixels() {
        let e = map.get_pixel(x, y).0;
        for (c, rho) in [0.5, 0.4, 0.3].into_iter().enumerate() {
            let wanted = f64::from(e[c]) * rho / std::f64::consts::PI / white / strength;
            // The lamp is too bright for the map, so its texels are white.
            if pixel.0[c] > 0 && pixel.0 != [255; 3] && e[c] > 0.0 {
                let found = tone::linear(f64::from(pixel.0[c]) / 255.0);
                let step = tone::linear((f64::from(pixel.0[c]) + 0.51) / 255.0) - found;
                assert!((found - wanted).abs() <= step + 1e-3 * wanted, "{x} {y} {c}: {found} for {wanted}");
                compared += 1;
            }
        }
    }
    assert!(compared > 1000, "{compared}");
}

#[test]
fn instances_become_meshes_with_their_own_places_in_the_map() {
    let mut file = boards();
    file.json["nodes"] = json!([{"children": [1, 2]}, {"mesh": 0}, {"mesh": 0, "translation": [10, 0, 0], "scale": [-1, 1, 1]}]);
    let places = file.floats::<3>(&[[0., 0., 10.], [0., 0., 20.]]);
    file.push("nodes", json!({"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": places}}}}));
    file.json["scenes"][0]["nodes"] = json!([0, 3]);
    file.json["extensionsUsed"] = json!(["EXT_mesh_gpu_instancing", "KHR_materials_emissive_strength"]);
    file.json["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
    let here = here(&file);
    let (out, bytes) = baked(&here, "--texel 0.5");
    assert_eq!(corners(&here.path("in.glb")), corners(&here.path("out.glb")));
    assert_eq!(out["nodes"].as_array().unwrap().len(), 6);
    assert_eq!(out["nodes"][3]["children"], json!([4, 5]));
    assert!(out["nodes"][3].get("mesh").is_none() && out.get("extensionsRequired").is_none());
    let meshes: BTreeSet<u64> =
        [1, 2, 4, 5].iter().map(|&n| out["nodes"][n]["mesh"].as_u64().unwrap()).collect();
    assert_eq!(meshes.len(), 4);
    // The middle of each floor lies in another texel.
    let mut middles = BTreeSet::new();
    for mesh in meshes {
        let primitive = &out["meshes"][mesh as usize]["primitives"][0];
        let uv = floats(&out, &bytes, &primitive["attributes"]["TEXCOORD_1"], 2);
        let middle = [0, 1].map(|c| uv.iter().map(|uv| uv[c]).sum::<f32>() / uv.len() as f32);
        middles.insert(middle.map(|x| (x * 1024.0) as i32));
    }
    assert_eq!(middles.len(), 4);
}

#[test]
fn surface_behind_other_faces_is_not_written() {
    let mut file = boards();
    // A panel with a node of its own, wholly behind the lamp, and a rug on the floor.
    let panel = file.material("panel", [0.5; 3], [0.0; 3]);
    let rug = file.material("rug", [0.2; 3], [0.0; 3]);
    file.rectangle([-1., 0., -1.], [0., 0., 1.], [1., 0., 0.], rug);
    file.rectangle([-0.25, 1., -0.25], [0.5, 0., 0.], [0., 0., 0.5], panel);
    let last = file.json["meshes"][0]["primitives"].as_array_mut().unwrap().pop().unwrap();
    let mesh = file.push("meshes", json!({"primitives": [last]}));
    let node = file.push("nodes", json!({"mesh": mesh}));
    file.json["scenes"][0]["nodes"].as_array_mut().unwrap().push(node.into());
    let here = here(&file);
    let (out, _) = baked(&here, "");
    assert!(out["nodes"][node].get("mesh").is_none(), "{}", out["nodes"][node]);
    let scene = Scene::load(here.path("out.glb")).unwrap();
    // The lamp has an area of 1, the floor with its rug 16: everything occurs once.
    let area: f64 = (0..scene.triangles.len()).map(|t| scene.area(t)).sum();
    assert!((area - 17.0).abs() < 1e-5, "{area}");
    assert!(scene.hidden.is_empty(), "{:?}", scene.hidden);
}

/// With a lightmap of irradiance, or with coordinates alone, the materials stay. The map has a precision of 8 bits.
#[test]
fn other_encodings_keep_the_materials() {
    let here = here(&boards());
    let (out, bytes) = baked(&here, "--gltf-lightmap moz");
    let floor =
        out["materials"].as_array().unwrap().iter().find(|m| m["extensions"].get("MOZ_lightmap").is_some());
    let floor = floor.unwrap();
    assert_eq!(floor["pbrMetallicRoughness"]["baseColorFactor"], json!([0.5, 0.4, 0.3, 1.0]));
    let light = &floor["extensions"]["MOZ_lightmap"];
    assert_eq!((&light["texCoord"], &light["index"]), (&json!(1), &json!(0)));
    // Linear irradiance. White is the maximum.
    let map = image::load_from_memory(&here.read("out.exr")).unwrap().into_rgb32f();
    let most = map.pixels().flat_map(|p| p.0).fold(0.0, f32::max);
    assert!((light["intensity"].as_f64().unwrap() as f32 - most).abs() < 1e-3 * most);
    let view = &out["bufferViews"][out["images"][0]["bufferView"].as_u64().unwrap() as usize];
    let range = |key: &str| view[key].as_u64().unwrap() as usize;
    let shown =
        image::load_from_memory(&bytes[range("byteOffset")..][..range("byteLength")]).unwrap().into_rgb8();
    for (x, y, pixel) in shown.enumerate_pixels() {
        let wanted = map.get_pixel(x, y).0[0] / most * 255.0;
        assert!((f32::from(pixel.0[0]) - wanted).abs() < 0.6, "{x} {y}");
    }

    let (out, _) = baked(&here, "--gltf-lightmap uv");
    assert_eq!(out["materials"], boards().json["materials"]);
    assert!(out.get("images").is_none());
    assert!(out["meshes"][0]["primitives"][0]["attributes"].get("TEXCOORD_1").is_some());
}

#[test]
fn scenes_of_other_formats_become_gltf_with_their_materials() {
    let here = Here::new(
        "mtllib scene.mtl\nv 0 0 0\nv 0 0 1\nv 1 0 1\nv 1 0 0\nv 0 1 0\nv 1 1 0\nv 1 1 1\nv 0 1 1\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n\
         usemtl wall\nf 1/1 2/2 3/3 4/4\nusemtl lamp\nf 5 6 7 8\n",
        "newmtl wall\nKd 0.5 0.25 0.125\nmap_Kd t.png\nnewmtl lamp\nKd 0 0 0\nKe 3 3 3\n",
    );
    save_png(&image::RgbImage::from_pixel(2, 2, image::Rgb([255; 3])), here.path("t.png"));
    let output = here.run(&format!("bake scene.obj -o out.glb --gltf-lightmap uv {FAST}"));
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(corners(&here.path("scene.obj")), corners(&here.path("out.glb")));
    let again = Scene::load(here.path("out.glb")).unwrap();
    let of = |name: &str| again.materials.iter().find(|m| m.name == name).unwrap();
    assert_eq!((of("wall").reflectance, of("lamp").emission), ([0.5, 0.25, 0.125], [3.0; 3]));
    assert_eq!(again.textures.len(), 1);
    let t = (0..again.triangles.len()).find(|&t| again.material(t).name == "wall").unwrap();
    assert_eq!(again.reflectance_at(t, [0.2, 0.3, 0.5]), [0.5, 0.25, 0.125]);
}

#[test]
fn solve_writes_unlit_vertex_colours() {
    let here = here(&boards());
    let output = here.run("solve in.glb -o out.glb --quality draft --specular drop --quiet");
    assert!(output.status.success(), "{}", stderr(&output));
    let (out, bytes) = taken_apart(&here.read("out.glb"));
    let lamp = &out["meshes"][0]["primitives"][1];
    let material = &out["materials"][lamp["material"].as_u64().unwrap() as usize];
    assert_eq!(
        (&material["name"], &material["extensions"]),
        (&json!("lamp"), &json!({"KHR_materials_unlit": {}}))
    );
    assert!(floats(&out, &bytes, &lamp["attributes"]["COLOR_0"], 3).iter().flatten().all(|&c| c == 1.0));
    let floor = floats(&out, &bytes, &out["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"], 3);
    assert!(floor.len() > 100);
    // The only lamp is white, so all light of the floor has the colour of the floor.
    for colour in floor.iter().filter(|c| c[0] < 1.0) {
        assert!(
            (colour[1] - 0.8 * colour[0]).abs() < 1e-5 && (colour[2] - 0.6 * colour[0]).abs() < 1e-5,
            "{colour:?}"
        );
    }
}

#[test]
fn files_that_no_bake_wrote_are_never_replaced() {
    let here = here(&boards());
    fs::write(here.path("out.exr"), "a picture").unwrap();
    let said = here.fails(&format!("bake in.glb -o out.glb {FAST}"), 2);
    assert!(said.contains("no earlier bake wrote"), "{said}");
    fs::remove_file(here.path("out.exr")).unwrap();
    baked(&here, "");
    baked(&here, "");
    let said = here.fails(&format!("bake in.glb -o in.glb {FAST}"), 2);
    assert!(said.contains("would replace the input"), "{said}");
    let said = here.fails("solve in.glb -o out.gltf --quiet", 2);
    assert!(said.contains(".ply or .glb"), "{said}");
}
