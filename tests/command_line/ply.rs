//! The PLY reader on good, odd and broken files in all encodings.

use std::fmt::Write as _;

use crate::common::program::{Here, stderr};
use glam::DVec3;
use radiosity::{Error, Scene, scene::LoadOptions};

fn try_load(bytes: impl AsRef<[u8]>) -> Result<Scene, Error> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("s.PLY");
    std::fs::write(&path, bytes).unwrap();
    // The faces of a test are often the same.
    Scene::load_with(&path, &LoadOptions::default().with_keep_overlaps(true))
}

fn load(bytes: impl AsRef<[u8]>) -> Scene {
    try_load(bytes).unwrap()
}

/// The text of the error without the folder.
fn error(bytes: impl AsRef<[u8]>) -> String {
    let error = try_load(bytes).expect_err("should be refused");
    let Error::Input { file, .. } = &error else { panic!("{error:?}") };
    let folder = format!("{}/", file.parent().unwrap().display());
    let text = error.to_string().replace(&folder, "");
    assert!(!text.contains('\n'), "{text}");
    text
}

const HEADER: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n\
    property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n";
const SQUARE: &str = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n";

fn square() -> String {
    format!("{HEADER}{SQUARE}4 0 1 2 3\n")
}

#[test]
fn a_square_in_every_encoding_and_type_is_two_triangles() {
    let corners = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]];
    let check = |scene: &Scene, what: &str| {
        assert_eq!(scene.triangles.len(), 2, "{what}");
        let at = corners.map(DVec3::from_array);
        assert_eq!((scene.corners(0), scene.corners(1)), ([at[0], at[1], at[2]], [at[0], at[2], at[3]]));
        assert_eq!(scene.triangles[1].source, 1);
        assert_eq!(scene.files.len(), 1);
    };
    check(&load(square()), "ascii");
    let put = |big: bool, bytes: &mut Vec<u8>, value: f64, kind: &str| {
        let (big_endian, little_endian) = match kind {
            "double" | "float64" => (value.to_be_bytes().to_vec(), value.to_le_bytes().to_vec()),
            "float" => ((value as f32).to_be_bytes().to_vec(), (value as f32).to_le_bytes().to_vec()),
            "int" | "uint" | "uint32" => {
                ((value as u32).to_be_bytes().to_vec(), (value as u32).to_le_bytes().to_vec())
            }
            "short" | "ushort" => {
                ((value as u16).to_be_bytes().to_vec(), (value as u16).to_le_bytes().to_vec())
            }
            _ => (vec![value as u8], vec![value as u8]),
        };
        bytes.extend(if big { big_endian } else { little_endian });
    };
    for (big, encoding) in [(true, "binary_big_endian"), (false, "binary_little_endian")] {
        for coordinate in ["float", "double", "float64"] {
            for length in ["uchar", "ushort", "int"] {
                for index in ["char", "uint8", "short", "ushort", "int", "uint32"] {
                    // Another element and another list come between, and are skipped.
                    let mut bytes = format!(
                        "ply\nformat {encoding} 1.0\ncomment here\nobj_info there\nelement vertex 4\n\
                         property {coordinate} x\nproperty uchar flags\nproperty {coordinate} y\n\
                         property {coordinate} z\nelement edge 1\nproperty int vertex1\n\
                         property list uchar double weights\nelement face 1\n\
                         property list uchar float texcoord\nproperty list {length} {index} vertex_index\n\
                         end_header\n"
                    )
                    .into_bytes();
                    for [x, y, z] in corners {
                        put(big, &mut bytes, x, coordinate);
                        bytes.push(b'\n');
                        put(big, &mut bytes, y, coordinate);
                        put(big, &mut bytes, z, coordinate);
                    }
                    put(big, &mut bytes, 7.0, "int");
                    bytes.push(1);
                    put(big, &mut bytes, 0.5, "double");
                    bytes.push(1);
                    put(big, &mut bytes, 0.5, "float");
                    put(big, &mut bytes, 4.0, length);
                    (0..4).for_each(|k| put(big, &mut bytes, f64::from(k), index));
                    check(&load(&bytes), &format!("{encoding} {coordinate} {length} {index}"));
                    bytes.pop();
                    let text = error(&bytes);
                    assert_eq!(text, "s.PLY: face 0: the file ends here; its header announces 1");
                }
            }
        }
    }
}

#[test]
fn lines_end_in_all_ways_and_blanks_do_not_matter() {
    for text in [
        square().replace('\n', "\r\n"),
        square().replace('\n', "\r"),
        square().replace('\n', " \n\n"),
        square().replace("1 1 0", "\t1.  +1.0 .0e1"),
        square().replace("element", "  element").trim_end().into(),
        format!("\u{feff}{}", square()),
    ] {
        let scene = load(&text);
        assert_eq!((scene.triangles.len(), scene.area(0)), (2, 0.5), "{text:?}");
    }
    let latin = [&b"ply\ncomment gr\xfcn\n"[..], &square().as_bytes()[4..]].concat();
    assert_eq!(load(latin).triangles.len(), 2);
    // The data of a binary file may begin with bytes that look like line ends.
    for (end, first) in [("\n", 10u8), ("\r\n", 10), ("\r", 10), ("\n", 13), ("\r", 13)] {
        let mut bytes = HEADER
            .replace("ascii", "binary_little_endian")
            .replace("float", "uchar")
            .replace('\n', end)
            .into_bytes();
        bytes.extend([first, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0, 3]);
        bytes.extend([0u32, 1, 2].map(u32::to_le_bytes).concat());
        assert_eq!(load(bytes).corners(0)[0].x, f64::from(first), "{end:?}");
    }
}

#[test]
fn concave_faces_are_cut_inside() {
    let arrow = format!("{HEADER}1 1 0\n2 0 0\n0 3 0\n-2 0 0\n4 2 3 0 1\n");
    let scene = load(arrow);
    assert!((0..2).all(|t| scene.normal(t).z > 0.99));
    assert!((scene.area(0) + scene.area(1) - 4.0).abs() < 1e-12);
}

/// The linear value of 188 by IEC 61966-2-1.
const MID: f64 = 0.502_886;

#[test]
fn colours_are_decoded_and_averaged_and_the_face_takes_precedence() {
    let colours = "property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue";
    let vertices = "0 0 0 255 188 0\n1 0 0 255 188 0\n1 1 0 0 188 255\n0 1 0 0 188 0\n";
    let text = HEADER.replace("property float z", colours) + vertices + "4 0 1 2 3\n";
    let scene = load(&text);
    let [r, g, b] = scene.material(0).reflectance;
    assert_eq!((r, b), (0.5, 0.25));
    assert!((g - MID).abs() < 1e-6, "{g}");
    // Encoded again, 0.5 is 188 and 0.25 is 137.
    assert_eq!(scene.material(0).name, "#bcbc89");
    assert_eq!(scene.warnings, [""; 0]);

    let face = "vertex_indices\nproperty float red\nproperty float green\nproperty float blue";
    let both = text.replace("vertex_indices", face).replace("4 0 1 2 3", "4 0 1 2 3 0 0.5 1");
    let [r, g, b] = load(both).material(0).reflectance;
    assert_eq!((r, b), (0.0, 1.0));
    assert!((g - 0.214_041).abs() < 1e-6, "{g}");
    let ushort = text.replace("uchar red", "ushort red").replace(" 188 ", " 255 ");
    assert!((load(ushort).material(0).reflectance[0] - 0.5 * 255.0 / 65535.0 / 12.92).abs() < 1e-9);
}

#[test]
fn reflectance_and_emission_come_as_numbers() {
    let names = ["reflectance_r", "reflectance_g", "reflectance_b", "emission_r", "emission_g", "emission_b"];
    let properties: String = names.iter().map(|n| format!("\nproperty double {n}")).collect();
    let text = HEADER.replace("vertex_indices", &format!("vertex_indices{properties}")) + SQUARE;
    let scene = load(format!("{text}4 0 1 2 3 0.1 0.2 0.3 4 5 6\n"));
    assert_eq!(scene.materials.len(), 1);
    assert_eq!(
        (scene.material(1).reflectance, scene.material(1).emission),
        ([0.1, 0.2, 0.3], [4.0, 5.0, 6.0])
    );
    assert_eq!(
        error(format!("{text}4 0 1 2 3 0 1.5 0 0 0 0\n")),
        "s.PLY:20: reflectance 1.5 is outside 0..1"
    );
    assert_eq!(
        error(format!("{text}4 0 1 2 3 0 1 0 0 -1 0\n")),
        "s.PLY:20: radiance -1.0 is not a number from 0 to 1e100"
    );
}

#[test]
fn missing_values_get_defaults_and_are_reported_once() {
    let scene = load(square().replace("face 1", "face 3") + "2 0 1\n3 0 1 2\n");
    assert_eq!(scene.triangles.len(), 3);
    assert_eq!((scene.materials[0].name.as_str(), scene.materials[0].reflectance), ("(none)", [0.5; 3]));
    assert_eq!(scene.warnings.len(), 2, "{:?}", scene.warnings);
    assert!(scene.warnings[0].ends_with("s.PLY: 2 faces without a reflectance get reflectance 0.5"));
    assert!(
        scene.warnings[1]
            .ends_with("line 15: a face with fewer than three vertices is left out (1 in the file)")
    );

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("s.ply");
    std::fs::write(&path, square()).unwrap();
    let given =
        Scene::load_with(&path, &LoadOptions::default().with_reflectance(Some([0.1, 0.2, 0.3]))).unwrap();
    assert_eq!((given.materials[0].reflectance, given.warnings.len()), ([0.1, 0.2, 0.3], 0));
}

#[test]
fn a_given_reflectance_takes_precedence_over_colours() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("white.ply");
    let text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
        property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 1\nproperty list uchar int vertex_indices\n\
        property float reflectance_r\nproperty float reflectance_g\nproperty float reflectance_b\nend_header\n\
        0 0 0 255 255 255\n1 0 0 255 255 255\n0 1 0 255 255 255\n3 0 1 2 0.25 0.25 0.25\n";
    // A reflectance in the file takes precedence.
    std::fs::write(&path, text).unwrap();
    let given = LoadOptions::default().with_reflectance(Some([0.6; 3]));
    assert_eq!(Scene::load_with(&path, &given).unwrap().materials[0].reflectance, [0.25; 3]);
    let plain = text.replace("3 0 1 2 0.25 0.25 0.25", "3 0 1 2");
    let plain: String = plain.split_inclusive('\n').filter(|line| !line.contains("reflectance")).collect();
    std::fs::write(&path, plain).unwrap();
    assert_eq!(Scene::load(&path).unwrap().materials[0].reflectance, [1.0; 3]);
    assert_eq!(Scene::load_with(&path, &given).unwrap().materials[0].reflectance, [0.6; 3]);
}

#[test]
fn a_reflectance_for_a_material_takes_precedence_over_the_file() {
    let here = Here::new(
        "mtllib scene.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl wall\nf 1 2 3\nusemtl lamp\nf 1 3 2\n",
        "newmtl wall\nKd 1 1 1\nnewmtl lamp\nKd 0.5 0.5 0.5\nKe 1 1 1\n",
    );
    let run = here.run("inspect scene.obj --reflectance 0.25,0.5,0.75@wall --report r.json --quiet");
    assert!(run.status.success());
    let materials = &here.json("r.json")["materials"];
    assert_eq!(materials[0]["reflectance"], serde_json::json!([0.25, 0.5, 0.75]));
    assert_eq!(materials[1]["reflectance"], serde_json::json!([0.5, 0.5, 0.5]));
    let said = here.fails("inspect scene.obj --reflectance 0.25@roof", 2);
    assert!(said.contains("--reflectance: no face of scene.obj has material `roof`"), "{said}");
}

#[test]
fn bad_files_are_reported_with_line_or_element() {
    let header = |from: &str, to: &str| square().replace(from, to);
    for (text, wanted) in [
        (String::new(), "s.PLY:1: not a PLY file: it does not begin with `ply`"),
        ("solid cube\n".into(), "s.PLY:1: not a PLY file: it does not begin with `ply`"),
        ("ply\nformat ascii 1.0\n".into(), "s.PLY:2: the file ends before `end_header`"),
        (header("format ascii 1.0\n", ""), "s.PLY: No format line found"),
        (header("ascii", "morse"), "s.PLY:2: `format morse 1.0` is not understood"),
        (header("float y", "real y"), "s.PLY:5: `property real y` is not understood"),
        (header("vertex 4", "vertex many"), "s.PLY:3: `element vertex many` is not understood"),
        (
            header("vertex 4", "vertex 99999999999999999999"),
            "s.PLY:3: `element vertex 99999999999999999999` is not understood",
        ),
        (header("float y", "float x"), "s.PLY:5: `x` is declared twice"),
        (header("element face 1", "element vertex 1"), "s.PLY:7: `vertex` is declared twice"),
        (header("float z", "float w"), "s.PLY: element `vertex` has no number `z`"),
        (header("float z", "list uchar float z"), "s.PLY: element `vertex` has no number `z`"),
        (header("element vertex", "element vertices"), "s.PLY: there is no element `vertex`"),
        (header("face 1", "face 0"), "s.PLY: no faces"),
        (header("element face", "element faces"), "s.PLY: no faces"),
        (header("vertex_indices", "indices"), "s.PLY: element `face` has no list `vertex_indices`"),
        (header("list uchar int ", "int "), "s.PLY: element `face` has no list `vertex_indices`"),
        (header("list uchar int", "list uchar float"), "s.PLY:14: `4 0 1 2 3` is not a face"),
        (
            header("end_header", "element nothing 1000000000000\nend_header"),
            "s.PLY: element `nothing` has no properties",
        ),
        (header("1 1 0", "1 one 0"), "s.PLY:12: `1 one 0` is not a vertex"),
        (header("1 1 0", "1 nan 0"), "s.PLY:12: `1 nan 0` is not a vertex"),
        (header("1 1 0", "1 1e99 0"), "s.PLY:12: a coordinate is not finite"),
        (header("1 1 0", "1 1"), "s.PLY:12: `1 1` is not a vertex"),
        (header("4 0 1 2 3", "4 0 1 2"), "s.PLY:14: `4 0 1 2` is not a face"),
        (header("4 0 1 2 3", "4 0 1 2 4"), "s.PLY:14: vertex 4 does not exist, 4 were read before"),
        (header("4 0 1 2 3", "4 0 1 2 -1"), "s.PLY:14: vertex -1 does not exist, 4 were read before"),
        (
            header("face 1", "face 1000000000000"),
            "s.PLY:14: the file ends after 1 of 1000000000000 elements `face`",
        ),
        (
            header("vertex 4", "vertex 1000000000000"),
            "s.PLY:14: the file ends after 5 of 1000000000000 elements `vertex`",
        ),
        (header("4 0 1 2 3", "4 0 0 0 0"), "s.PLY: every face has zero area"),
    ] {
        assert_eq!(error(&text), wanted, "{text}");
    }
    let binary = HEADER.replace("ascii", "binary_little_endian").replace("float", "uchar");
    let vertices = [0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0];
    let with = |rest: &[u8]| [binary.as_bytes(), &vertices[..], rest].concat();
    assert_eq!(error(with(&[])), "s.PLY: face 0: the file ends here; its header announces 1");
    assert_eq!(
        error(with(&[3, 0, 0, 0, 0, 1, 0, 0, 0, 2, 1, 0, 0])),
        "s.PLY: face 0: vertex 258 does not exist, 4 were read before"
    );
    let long = binary.replace("uchar int vertex", "uint int vertex");
    let bytes = [long.as_bytes(), &vertices[..], &[255; 4]].concat();
    assert_eq!(error(bytes), "s.PLY: face 0: the file ends here; its header announces 1");
    let negative = binary.replace("uchar int vertex", "char int vertex");
    let bytes = [negative.as_bytes(), &vertices[..], &[255; 40]].concat();
    assert_eq!(error(bytes), "s.PLY: face 0: List length cannot be negative (i8)");
}

/// A scene of this repository is the same after it is written as PLY with all its digits.
#[test]
fn a_scene_survives_the_way_through_ply() {
    let scene = Scene::load(format!("{}/meshes/cornell-box.obj", env!("CARGO_MANIFEST_DIR"))).unwrap();
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex {}\n", scene.vertices.len());
    text += "property double x\nproperty double y\nproperty double z\n";
    let _ = writeln!(text, "element face {}\nproperty list uchar int vertex_indices", scene.triangles.len());
    for quantity in ["reflectance", "emission"] {
        for channel in ["r", "g", "b"] {
            let _ = writeln!(text, "property double {quantity}_{channel}");
        }
    }
    text += "end_header\n";
    for v in &scene.vertices {
        let _ = writeln!(text, "{} {} {}", v.x, v.y, v.z);
    }
    for (t, triangle) in scene.triangles.iter().enumerate() {
        let ([a, b, c], m) = (triangle.vertices, scene.material(t));
        let numbers: Vec<String> =
            m.reflectance.iter().chain(&m.emission).map(|x| format!("{x:.17}")).collect();
        let _ = writeln!(text, "3 {a} {b} {c} {}", numbers.join(" "));
    }
    let again = load(text);
    assert_eq!(again.triangles.len(), scene.triangles.len());
    for t in 0..scene.triangles.len() {
        assert_eq!(again.corners(t), scene.corners(t));
        assert_eq!(again.material(t).reflectance, scene.material(t).reflectance);
        assert_eq!(again.material(t).emission, scene.material(t).emission);
    }
    assert_eq!(again.materials.len(), scene.materials.len());
}

/// A unit cube seen from inside: B = Be + ρ B with Be = π L, L = 1/π and ρ = 1/2 gives B = 2 everywhere. Half of it is
/// absorbed: 6 W.
#[test]
fn every_command_takes_ply_and_light_by_option() {
    let here = Here::new("", "");
    let mut cube = HEADER.replace("vertex 4", "vertex 8").replace("face 1", "face 6");
    for k in 0..8 {
        let _ = writeln!(cube, "{} {} {}", k & 1, k >> 1 & 1, k >> 2);
    }
    cube += "4 0 1 3 2\n4 4 6 7 5\n4 0 4 5 1\n4 2 3 7 6\n4 0 2 6 4\n4 1 5 7 3\n";
    std::fs::write(here.path("cube.Ply"), &cube).unwrap();
    let light = "--emit 0.3183098861837907 --reflectance 0.5";
    let run = |arguments: &str| {
        let output = here.run(arguments);
        assert_eq!((output.status.code(), stderr(&output)), (Some(0), String::new()), "{arguments}");
        output
    };
    run(&format!("solve cube.Ply -o out.ply --report r.json --patches 200 --rays 64 {light}"));
    let absorbed = here.json("r.json")["energy"]["absorbed"][0].as_f64().unwrap();
    assert!((absorbed - 6.0).abs() < 1e-7, "{absorbed}");
    run(&format!("render cube.Ply -o p.png --spp 1 --width 8 --height 8 {light}"));
    std::fs::write(here.path("points"), "0.5 0.5 0.5 0 0 1\n").unwrap();
    run(&format!("probe cube.Ply --points points --spp 16 {light}"));
    run(&format!("validate cube.Ply --patches 50 --rays 32 --paths 16 --particles 1024 {light}"));
    run("inspect cube.Ply --reflectance 0.5");

    // The output is a scene too: 192 triangles of the same cube. Its colours are not reflectances.
    let again = Scene::load(here.path("out.ply")).unwrap();
    assert_eq!(again.triangles.len(), 192);
    let area: f64 = (0..192).map(|t| again.area(t)).sum();
    assert!((area - 6.0).abs() < 1e-6);
    assert_eq!((again.materials.len(), again.materials[0].reflectance), (1, [0.5; 3]));
    assert!(again.warnings[0].contains("colours of vertices show radiosity"), "{:?}", again.warnings);
    assert!(here.fails("solve cube.Ply -o ./cube.Ply --emit 1", 2).contains("replace the input"));
    let dark = here.fails("solve cube.Ply", 2);
    assert!(dark.contains("cube.Ply: nothing emits light") && dark.contains("--emit"), "{dark}");
    assert!(here.fails("solve cube.Ply --emit 1@#ffffff", 2).contains("its materials are (none)"));
}

/// A file of `solve` is read as the original surface. A face that shows a back is reversed, unless the file has its
/// front.
#[test]
fn a_solution_is_read_as_one_surface() {
    let sides = "vertex_indices\nproperty int triangle\nproperty uchar side";
    let text = square().replace("face 1", "face 2").replace("vertex_indices", sides);
    let both = text.replace("4 0 1 2 3", "4 0 1 2 3 0 0\n4 3 2 1 0 0 1");
    let scene = load(both.replace("element vertex", "comment faces: both sides of patches\nelement vertex"));
    assert_eq!(scene.triangles.len(), 2);
    // One face per patch. The second one shows its back.
    let one = load(text.replace("4 0 1 2 3", "3 0 1 2 0 0\n3 3 2 0 1 1"));
    assert_eq!((one.triangles.len(), one.normal(0)), (2, one.normal(1)));
    // Without the number of the triangle, `side` is a property of some other program.
    let other = text.replace("property int triangle\n", "");
    assert_eq!(load(other.replace("4 0 1 2 3", "4 0 1 2 3 0\n4 3 2 1 0 1")).triangles.len(), 4);
}
