//! Loads every `.obj` and `.ply` below the folder in the environment variable `RADIOSITY_CORPUS`, and compares the
//! scenes with its `EXPECTED.tsv` if there is one. Without the variable nothing is tested.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use radiosity::{
    Error, Scene,
    scene::{LoadOptions, inspection::Inspection},
};

/// Files that this reader refuses on purpose although the list accepts them, with a part of the message.
const REFUSED: [(&str, &str); 13] = [
    // Everything in it is transparent.
    ("parser/obj2gltf/box-transparent/box-transparent.obj", "holes"),
    ("parser/obj2gltf/box-incomplete-attributes/box-incomplete-positions.obj", "vertex"),
    ("parser/tinyobjloader/invalid-relative-texture-index.obj", "vertex"),
    ("parser/tinyobjloader/invalid-relative-vertex-index.obj", "vertex"),
    ("parser/tinyobjloader/issue-140-zero-face-idx.obj", "count from 1"),
    ("parser/tobj/invalid_index.obj", "vertex"),
    ("parser/tinyobjloader/test-nan.obj", ":"),
    // No face has an area.
    ("degenerate-xatlas/zero_area_face.obj", "zero area"),
    // No face with three vertices.
    ("parser/tinyobjloader/invalid-face-definition.obj", "no faces"),
    ("parser/tinyobjloader/line-prim.obj", "no faces"),
    ("parser/tinyobjloader/points-prim.obj", "no faces"),
    ("parser/tobj/lines.obj", "no faces"),
    ("parser/tinyobjloader/issue-356-leading-spaces-newmtl.obj", "no faces"),
];

fn meshes(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap().flatten() {
        let path = entry.path();
        if path.is_dir() {
            meshes(&path, found);
        } else if path.extension().is_some_and(|e| ["obj", "ply"].iter().any(|k| e.eq_ignore_ascii_case(k))) {
            found.push(path);
        }
    }
}

/// The rows by file name, the cells by column name.
fn expected(folder: &Path) -> HashMap<String, HashMap<String, String>> {
    let Ok(table) = std::fs::read_to_string(folder.join("EXPECTED.tsv")) else { return HashMap::new() };
    let mut lines = table.lines();
    let columns: Vec<&str> = lines.next().unwrap().split('\t').collect();
    lines
        .map(|line| {
            let row = columns.iter().map(ToString::to_string).zip(line.split('\t').map(String::from));
            (line.split('\t').next().unwrap().to_string(), row.collect())
        })
        .collect()
}

/// The differences between `scene` and its row.
fn differences(scene: &Scene, row: &HashMap<String, String>) -> Vec<String> {
    let mut found = Vec::new();
    let triangles = (scene.triangles.len() + scene.degenerate).to_string();
    if triangles != row["triangles_fan"] {
        found.push(format!("{triangles} triangles, expected {}", row["triangles_fan"]));
    }
    // Vertices of degenerate triangles are not kept, although they may have been the outermost.
    if scene.degenerate == 0 {
        for (column, pick) in [("bbox_min", f64::min as fn(f64, f64) -> f64), ("bbox_max", f64::max)] {
            let bound = scene
                .vertices
                .iter()
                .map(|v| v.to_array())
                .reduce(|a, b| std::array::from_fn(|i| pick(a[i], b[i])));
            let given = row[column].split(' ').map(|w| w.parse::<f64>().unwrap());
            if !bound.unwrap().iter().zip(given).all(|(b, g)| (b - g).abs() <= 1e-4 * (1.0 + g.abs())) {
                found.push(format!("{column} {bound:?}, expected {}", row[column]));
            }
        }
        let area: f64 = (0..scene.triangles.len()).map(|t| scene.area(t)).sum();
        let given: f64 = row["area_fan"].parse().unwrap();
        // A fan over a concave polygon counts parts twice.
        if area > given * (1.0 + 1e-4) || (row["ngons"] == "0" && area < given * (1.0 - 1e-4)) {
            found.push(format!("area {area}, expected {given}"));
        }
    }
    found.extend(joins(scene, row));
    // The list has no materials of PLY files.
    if row["materials_used"].is_empty() {
        return found;
    }
    // The list counts names after `usemtl`. This reader uses "(none)" and "(unnamed)" for missing names.
    let used: std::collections::HashSet<&str> =
        scene.materials.iter().map(|m| m.name.as_str()).filter(|n| !n.starts_with('(')).collect();
    if used.len().to_string() != row["materials_used"] {
        found.push(format!("materials {used:?}, expected {}", row["materials_used"]));
    }
    // The list has all emitters of the library, including materials that no face uses.
    let emits = !row["Ke_materials"].is_empty();
    if !used.is_empty() && scene.has_emitter() != emits {
        found.push(format!("emits: {}, expected {emits}", scene.has_emitter()));
    }
    found
}

/// The differences between the edges of `scene` and its row. The list welds vertices like the inspection, but cuts
/// polygons into fans, which gives other edges in concave ones.
fn joins(scene: &Scene, row: &HashMap<String, String>) -> Vec<String> {
    if scene.degenerate > 0 && !row["notes"].contains("zero-area") || !["0", ""].contains(&&row["ngons"][..])
    {
        return Vec::new();
    }
    let edges = Inspection::of(scene).edges;
    let mut found = Vec::new();
    for (column, got) in [
        ("closed_after_weld", if edges.is_closed() { "True".into() } else { "False".into() }),
        ("open_edges", edges.open.to_string()),
        ("nonmanifold_edges", edges.non_manifold.to_string()),
    ] {
        // Vertices of the door handle lie within the tolerance but in different cells of the grid to which the list
        // rounds.
        let judged = row["file"] == "veach-ajar/veach_ajar.obj" && column == "nonmanifold_edges";
        if !row[column].is_empty() && row[column] != got && !judged {
            found.push(format!("{column} {got}, expected {}", row[column]));
        }
    }
    found
}

#[test]
fn every_file_loads_or_is_refused_with_a_reason() {
    let Some(folder) = std::env::var_os("RADIOSITY_CORPUS").map(PathBuf::from) else { return };
    let mut files = Vec::new();
    meshes(&folder, &mut files);
    files.sort();
    assert!(!files.is_empty(), "no .obj and no .ply below {}", folder.display());
    let table = expected(&folder);
    // The table counts everything in the files, also hidden surface.
    let as_the_file_has_them = LoadOptions::default().with_keep_overlaps(true);
    let mut wrong = Vec::new();
    for file in &files {
        let name = file.strip_prefix(&folder).unwrap().to_string_lossy().replace('\\', "/");
        let refused = REFUSED.iter().find(|(n, _)| *n == name);
        match (Scene::load_with(file, &as_the_file_has_them), refused, table.get(&name)) {
            (Ok(_), Some(_), _) => wrong.push(format!("{name}: should be refused")),
            // The table counts triangles with holes as whole.
            (Ok(scene), None, Some(_)) if scene.materials.iter().any(|m| m.cutout.is_some()) => {}
            (Ok(scene), None, Some(row)) => {
                wrong.extend(differences(&scene, row).into_iter().map(|d| format!("{name}: {d}")));
            }
            (Ok(_), None, None) => {}
            (Err(e @ Error::Input { .. }), Some((_, part)), _) if e.to_string().contains(part) => {}
            (Err(e @ (Error::Input { .. } | Error::Io { .. })), None, None) => println!("{e}"),
            (Err(e), ..) => wrong.push(format!("{name}: {e}")),
        }
    }
    assert!(wrong.is_empty(), "{} of {} files:\n{}", wrong.len(), files.len(), wrong.join("\n"));
}
