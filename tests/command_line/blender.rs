//! A lit glTF file in Blender.

use std::process::Command;

use radiosity::{Scene, scene::LoadOptions};
use serde_json::Value;

use crate::common::{
    gltf::taken_apart,
    program::{Here, stderr},
};

const MESH: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/meshes/cornell-box.obj");

/// Blender imports the geometry and the emission of the file, and Cycles renders the picture that `render` shows: the mean difference is
/// below 2 of 255.
///
///     pip install bpy
///     cargo test --test command_line -- --ignored blender
///
/// `PYTHON` names the Python that has bpy; `python3` by default.
#[test]
#[ignore = "needs Python with bpy, and a minute"]
fn blender_imports_a_lit_file_and_shows_its_light() {
    let here = Here::new("", "");
    let run = |words: &str| {
        let output = here.run(words);
        assert!(output.status.success(), "{words}: {}", stderr(&output));
    };
    run(&format!("bake {MESH} -o lit.glb --resolution 1024 --final-gather 16 --quiet"));
    let (lit, _) = taken_apart(&here.read("lit.glb"));
    let white = lit["extras"]["radiosity"]["white"].as_f64().unwrap();
    let view = "--eye 278,273,-800 --look-at 278,273,0 --fov 39 --width 256 --height 256 --quiet";
    run(&format!(
        "render {MESH} -o ours.png --method radiosity --final-gather 32 --spp 16 --white {white} {view}"
    ));

    let python = std::env::var("PYTHON").unwrap_or_else(|_| "python3".into());
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/viewers/blender.py");
    let files = ["lit.glb", "ours.png"].map(|name| here.path(name).into_os_string());
    let camera = ["278,273,-800", "278,273,0", "0,1,0", "39"];
    let done = Command::new(python)
        .arg(script)
        .args(files)
        .args(camera)
        .arg(here.path("blender.png"))
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&done.stdout);
    assert!(done.status.success(), "{said}{}", String::from_utf8_lossy(&done.stderr));
    let found: Value = serde_json::from_str(said.lines().last().unwrap()).unwrap();

    // The triangles of the scene as its file has them.
    let scene = Scene::load_with(MESH, &LoadOptions::default().with_keep_overlaps(true)).unwrap();
    assert_eq!(found["triangles"], scene.triangles.len());
    let area: f64 = (0..scene.triangles.len()).map(|t| scene.area(t)).sum();
    assert!((found["area"].as_f64().unwrap() / area - 1.0).abs() < 1e-6, "{found}");
    for (k, pick) in [f64::min as fn(f64, f64) -> f64, f64::max].into_iter().enumerate() {
        for c in 0..3 {
            let bound = scene.vertices.iter().map(|v| v[c]).reduce(pick).unwrap();
            // The lit file has the nearest numbers of single precision, and Blender keeps them.
            assert_eq!(found["bounds"][k][c].as_f64().unwrap(), f64::from(bound as f32), "{found}");
        }
    }
    let emitting = found["emitting"].as_object().unwrap();
    for (name, strength) in emitting {
        let material = lit["materials"].as_array().unwrap().iter().find(|m| m["name"] == name.as_str());
        let wanted = &material.unwrap()["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"];
        assert!((strength.as_f64().unwrap() - wanted.as_f64().unwrap()).abs() < 1e-6, "{name}: {found}");
    }
    assert_eq!(emitting.len(), 3, "{found}");
    assert!(found["difference"].as_f64().unwrap() < 2.0, "{found}");
}
