//! STL files: both forms give the same scene, and faults are named.

use std::fs;

use radiosity::{
    Scene,
    scene::{
        LoadOptions,
        surfaces::{By, Side, Surfaces},
    },
};

const TRIANGLES: [[[f32; 3]; 3]; 2] = [
    [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]],
    [[0.0, 0.0, 1.0], [0.0, 2.0, 1.0], [1.0, 0.0, 1.0]],
];

fn solid(name: &str, triangle: [[f32; 3]; 3]) -> String {
    let corners: String = triangle.iter().map(|[x, y, z]| format!("      vertex {x} {y:e} {z}\n")).collect();
    format!(
        "solid {name}\n  facet normal 0 0 0\n    outer loop\n{corners}    endloop\n  endfacet\nendsolid {name}\n"
    )
}

fn binary(header: &[u8]) -> Vec<u8> {
    let mut bytes = header.to_vec();
    bytes.resize(80, b' ');
    bytes.extend(2u32.to_le_bytes());
    for triangle in TRIANGLES {
        bytes.extend([0; 12]);
        bytes.extend(triangle.as_flattened().iter().flat_map(|x| x.to_le_bytes()));
        bytes.extend([0; 2]);
    }
    bytes
}

fn load(bytes: &[u8]) -> Result<Scene, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.stl");
    fs::write(&path, bytes).unwrap();
    let options = LoadOptions::default().with_reflectance(Some([0.5; 3])).with_faces(true);
    Scene::load_with(&path, &options).map_err(|e| e.to_string().rsplit('/').next().unwrap().to_owned())
}

#[test]
fn text_and_binary_files_give_the_same_scene() {
    let text = solid("lower part", TRIANGLES[0]) + &solid("upper", TRIANGLES[1]);
    let ascii = load(text.as_bytes()).unwrap();
    // The header of a binary file may begin like a text file.
    for header in [&b"solid of a program"[..], b""] {
        let scene = load(&binary(header)).unwrap();
        assert_eq!((&scene.vertices, &scene.triangles), (&ascii.vertices, &ascii.triangles));
    }
    // Old Macintosh programs end lines with CR, Windows programs with CR LF.
    for end in ["\r", "\r\n"] {
        let scene = load(text.replace('\n', end).as_bytes()).unwrap();
        assert_eq!((&scene.vertices, &scene.triangles), (&ascii.vertices, &ascii.triangles));
    }
    let surfaces = Surfaces::of(&ascii, &By::Object, Side::Front);
    let names: Vec<&str> = surfaces.list.iter().map(|s| s.name.as_str()).collect();
    assert_eq!(names, ["lower part", "upper"]);
    assert_eq!(surfaces.list[1].line, Some(17));
    assert!(ascii.warnings.is_empty() && (ascii.area(0) - 1.0).abs() < 1e-12);
}

#[test]
fn faults_are_named_by_line() {
    let good = solid("a", TRIANGLES[0]);
    let cut = &binary(b"")[..150];
    for (bytes, said) in [
        (good.replace("1 0e0 0", "1 0e0 x").into_bytes(), "a.stl:5: a vertex must have three coordinates"),
        (good.replace("1 0e0 0", "1 nan 0").into_bytes(), "a.stl:5: a coordinate is not a finite number"),
        (
            good.replace("      vertex 1 0e0 0\n", "").into_bytes(),
            "a.stl:7: a facet has 2 vertices, not three",
        ),
        (good.replace("endsolid a\n", "").into_bytes(), "a.stl: the file ends within a solid"),
        (good.replace("outer loop", "inner loop").into_bytes(), "a.stl:3: `inner` is not understood"),
        (b"solid\nendsolid\n".to_vec(), "a.stl: no triangles"),
        (cut.to_vec(), "a.stl: not an STL file"),
        (b"".to_vec(), "a.stl: not an STL file"),
    ] {
        assert_eq!(load(&bytes).unwrap_err(), said);
    }
}
