//! Loads every `.gltf` and `.glb` below the folder that the environment variable `RADIOSITY_CORPUS` names, and solves it under a
//! uniform sky. Without the variable there is nothing to test.
//!
//! The counts are those of a script of its own, from the accessors and nodes of each file. The files are samples of Khronos'
//! and others, as godotengine/godot-demo-projects, bevyengine/bevy, kovacsv/Online3DViewer (`test/testfiles/gltf`) and
//! assimp/assimp (`test/models/glTF2`) have them.

use std::path::{Path, PathBuf};

use radiosity::{
    Error, Progress, Scene,
    accuracy::solved::Solved,
    energy::EnergyLedger,
    form_factor::CastOptions,
    patch::Subdivision,
    scene::{
        LoadOptions,
        light::{Sky, Up},
    },
    solve::SolveOptions,
    trace::Tracer,
};

/// The end of a path, triangles, materials that faces have (none at all is one of them), and triangles of emitting materials.
const COUNTS: [(&str, usize, usize, usize); 27] = [
    // 36 and 2 in the file; its lamp is open and double-sided, so that a copy of it shines from the other side.
    ("CornellBox.glb", 38, 5, 4),
    ("living_room.glb", 5088, 7, 0),
    ("godot/room.glb", 63720, 2, 0),
    ("BoxInterleaved.glb", 12, 1, 0),
    ("BoxVertexColors.glb", 12, 1, 0),
    ("CubeHierarchy.gltf", 48, 3, 0),
    ("OrientationTest.glb", 524, 7, 0),
    ("SimpleMeshes.gltf", 2, 1, 0),
    ("SimpleSparseAccessor.gltf", 12, 1, 0),
    ("TriangleWithoutIndices.gltf", 1, 1, 0),
    ("2CylinderEngine.glb", 121_496, 34, 0),
    ("AnimatedMorphCube.gltf", 12, 1, 0),
    ("AnimatedMorphSphere.gltf", 960, 1, 0),
    ("BoxTextured-glTF-pbrSpecularGlossiness/BoxTextured.gltf", 12, 1, 0),
    ("BoxTextured.glb", 12, 1, 0),
    ("ClearCoatTest.gltf", 37116, 19, 36),
    ("MorphPrimitivesTest.gltf", 32, 2, 0),
    ("MorphStressTest.gltf", 2412, 2, 0),
    ("quad_skin.glb", 2, 1, 0),
    ("simple_skin.gltf", 8, 1, 0),
    ("TextureTransformTest.gltf", 24, 9, 0),
    ("Box.glb", 12, 1, 0),
    ("properties.glb", 36, 3, 0),
    ("VertexColorTest.glb", 36, 2, 0),
    ("Mesh_PrimitiveMode_04.gltf", 2, 1, 0),
    ("Mesh_PrimitiveMode_05.gltf", 2, 1, 0),
    ("Mesh_PrimitiveMode_06.gltf", 2, 1, 0),
];

/// Files that must be refused, with a part of the message.
const REFUSED: [(&str, &str); 14] = [
    ("glTF-Draco/Box.gltf", "KHR_draco_mesh_compression"),
    ("BoxTextured-glTF-techniqueWebGL/BoxTextured.gltf", "KHR_technique_webgl"),
    ("BoxWithInfinites.glb", "not finite"),
    ("AllIndicesOutOfRange.gltf", "index 65535 of 24 vertices"),
    ("IndexOutOfRange.gltf", "index 255 of 24 vertices"),
    ("MissingBin/BoxTextured.gltf", "not found"),
    ("RecursiveNodes.gltf", "one parent"),
    ("sceneWrongType.gltf", "invalid type"),
    ("NoScene.gltf", "does not exist"),
    ("SceneWithoutNodes.gltf", "no triangles"),
    ("badArray.gltf", "invalid type"),
    ("badObject.gltf", "invalid type"),
    ("badUint.gltf", "invalid value"),
    ("badExtension.gltf", "invalid type"),
];

fn files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap().flatten() {
        let path = entry.path();
        if path.is_dir() {
            files(&path, found);
        } else if path.extension().is_some_and(|e| e == "glb" || e == "gltf") {
            found.push(path);
        }
    }
}

/// What of the energy of the scene is not accounted for.
fn imbalance(mut scene: Scene) -> Result<f64, Error> {
    scene.lights.sky = Some(Sky::uniform(Up::Y, [1.0; 3]));
    let tracer = Tracer::new(&scene);
    let (cast, solve) = (CastOptions::default().with_rays(16.0), SolveOptions::default());
    let solved = Solved::new(&scene, &tracer, &Subdivision::Count(300), &cast, &solve, &Progress::new())?;
    assert!(solved.solution.irradiance.iter().all(|e| e.is_finite() && *e >= 0.0));
    Ok(EnergyLedger::of(&solved.form_factors, &solved.patches, &solved.solution).imbalance())
}

#[test]
fn sample_files_load_with_the_right_counts_and_solve() {
    let Some(folder) = std::env::var_os("RADIOSITY_CORPUS").map(PathBuf::from) else { return };
    let mut found = Vec::new();
    files(&folder, &mut found);
    found.sort();
    assert!(!found.is_empty(), "no .gltf and no .glb below {}", folder.display());
    let options = LoadOptions::default().with_keep_overlaps(true);
    let (mut wrong, mut counted) = (Vec::new(), 0);
    for file in &found {
        let name = file.strip_prefix(&folder).unwrap().to_string_lossy().replace('\\', "/");
        // A name of a file alone ends the path after a slash.
        let is = |end: &str| name == end || name.ends_with(&format!("/{end}"));
        let refused = REFUSED.iter().find(|(end, _)| is(end));
        let scene = match (Scene::load_with(file, &options), refused) {
            (Ok(scene), None) => scene,
            (Ok(_), Some(_)) => {
                wrong.push(format!("{name}: should be refused"));
                continue;
            }
            (Err(e @ Error::Input { .. }), Some((_, part))) if e.to_string().contains(part) => continue,
            (Err(e @ (Error::Input { .. } | Error::Io { .. })), None)
                if !COUNTS.iter().any(|(end, ..)| is(end)) =>
            {
                println!("{e}");
                continue;
            }
            (Err(e), _) => {
                wrong.push(format!("{name}: {e}"));
                continue;
            }
        };
        if let Some(&(_, triangles, materials, emitting)) = COUNTS.iter().find(|(end, ..)| is(end)) {
            let used: std::collections::BTreeSet<u32> = scene.triangles.iter().map(|t| t.material).collect();
            let lit = |t: &usize| scene.material(*t).emission != [0.0; 3];
            let emits = (0..scene.triangles.len()).filter(lit).count();
            let counts = (scene.triangles.len() + scene.degenerate, used.len(), emits);
            if counts != (triangles, materials, emitting) {
                wrong.push(format!("{name}: {counts:?}, expected {:?}", (triangles, materials, emitting)));
            }
            counted += 1;
        }
        match imbalance(scene) {
            Ok(off) if off.abs() < 1e-9 => {}
            other => wrong.push(format!("{name}: {other:?} of the energy is not accounted for")),
        }
    }
    assert!(wrong.is_empty(), "{} of {} files:\n{}", wrong.len(), found.len(), wrong.join("\n"));
    assert!(counted > 0, "no known file below {}", folder.display());
}
