//! The command `bake`.

use std::{
    fs,
    process::{Command, Stdio},
    time::Duration,
};

use crate::common::program::{Here, stderr};
use glam::{DVec2, DVec3, dvec3};
use radiosity::Scene;

const MTL: &str = "newmtl wall\nKd 0.5 0.5 0.5\nnewmtl lamp\nKd 0 0 0\nKe 5 5 5\n";
/// A square floor and a lamp above it, both with the same texture coordinates.
const OBJ: &str = "mtllib scene.mtl\nv 0 0 0\nv 0 0 1\nv 1 0 1\nv 1 0 0\nv 0 1 0\nv 1 1 0\nv 1 1 1\nv 0 1 1\n\
    vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl wall\nf 1/1 2/2 3/3 4/4\nusemtl lamp\nf 5/1 6/2 7/3 8/4\n";

fn here() -> Here {
    Here::new(OBJ, MTL)
}

fn cornell() -> String {
    format!("{}/meshes/cornell-box.obj", env!("CARGO_MANIFEST_DIR"))
}

fn bake(here: &Here, arguments: &str) {
    let output = here.run(&format!("bake {arguments} --quality draft --quiet"));
    assert_eq!(output.status.code(), Some(0), "{arguments}: {}", stderr(&output));
    assert!(output.stdout.is_empty());
}

/// Barycentric coordinates of a point in the plane of a triangle.
fn barycentric([a, b, c]: [DVec3; 3], p: DVec3) -> [f64; 3] {
    let n = (b - a).cross(c - a);
    let share = |u: DVec3, v: DVec3| (u - p).cross(v - p).dot(n) / n.length_squared();
    [share(b, c), share(c, a), share(a, b)]
}

/// The light at a point of the scene can be read from the written files alone: it agrees with path tracing within 10 %.
#[test]
fn the_files_alone_give_the_light_at_a_point() {
    let here = here();
    bake(&here, &format!("{} -o out/deep --resolution 128 --mask --standard-error", cornell()));
    let mut names: Vec<_> = fs::read_dir(here.path("out/deep"))
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    let expected = [
        ".radiosity",
        "lightmap.exr",
        "lightmap.hdr",
        "lightmap.png",
        "mask.png",
        "report.json",
        "scene.mtl",
        "scene.obj",
        "scene.png",
        "standard-error.exr",
    ];
    assert_eq!(names, expected);
    let report = here.json("out/deep/report.json");
    assert_eq!(report["files"].as_array().unwrap().len(), expected.len() - 2);
    assert_eq!((&report["atlas"]["width"], &report["atlas"]["pages"]), (&128.into(), &1.into()));

    // On the floor, on the green and red walls, on top of the short block.
    let probes = [
        (dvec3(80.0, 0.0, 420.0), DVec3::Y),
        (dvec3(470.0, 0.0, 80.0), DVec3::Y),
        (dvec3(0.0, 400.0, 150.0), DVec3::X),
        (dvec3(556.0, 150.0, 400.0), -DVec3::X),
        (dvec3(186.0, 165.0, 168.0), DVec3::Y),
    ];
    let lines: Vec<String> =
        probes.iter().map(|(p, n)| format!("{} {} {} {} {} {}", p.x, p.y, p.z, n.x, n.y, n.z)).collect();
    fs::write(here.path("points.txt"), lines.join("\n")).unwrap();
    here.run(&format!("probe {} --points points.txt -o truth.txt --spp 4096", cornell()));
    let truth = String::from_utf8(here.read("truth.txt")).unwrap();

    let scene = Scene::load(here.path("out/deep/scene.obj")).unwrap();
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    let map = image::load_from_memory(&here.read("out/deep/lightmap.exr")).unwrap().to_rgb32f();
    for ((point, normal), line) in probes.iter().zip(truth.lines()) {
        let numbers: Vec<f64> = line.split_whitespace().map(|w| w.parse().unwrap()).collect();
        let (t, weights) = (0..scene.triangles.len())
            .filter(|&t| scene.normal(t).dot(*normal) > 0.999)
            .filter(|&t| ((scene.corners(t)[0] - *point).dot(*normal)).abs() < 1e-6)
            .map(|t| (t, barycentric(scene.corners(t), *point)))
            .find(|(_, w)| w.iter().all(|&x| x >= 0.0))
            .unwrap();
        let uv: DVec2 = (0..3).map(|k| scene.texcoords[t][k] * weights[k]).sum();
        // v runs up, rows of an image run down.
        let (x, y) = ((uv.x * 128.0) as u32, ((1.0 - uv.y) * 128.0) as u32);
        let found = map.get_pixel(x, y).0.map(f64::from);
        // Texels of 13 mm in a room of 556 change the light by up to 5 %. Paths and texels have noise of 1 %.
        for c in 0..3 {
            assert!((found[c] / numbers[6 + c] - 1.0).abs() < 0.1, "{found:?} at {line}");
        }
    }
}

#[test]
fn the_same_bytes_for_any_number_of_threads() {
    let here = here();
    let files = ["lightmap.exr", "lightmap.hdr", "lightmap.png", "scene.obj", "scene.mtl", "scene.png"];
    let runs: Vec<Vec<Vec<u8>>> = [1, 2, 5]
        .map(|threads| {
            bake(
                &here,
                &format!("{} -o out --resolution 96 --final-gather 8 --threads {threads}", cornell()),
            );
            files.iter().map(|name| here.read(&format!("out/{name}"))).collect()
        })
        .into();
    assert!(runs[0] == runs[1] && runs[0] == runs[2]);
    bake(&here, &format!("{} -o out --resolution 96 --final-gather 8 --seed 1", cornell()));
    assert!(here.read("out/lightmap.exr") != runs[0][0], "another seed gives another map");
}

#[test]
fn unsuitable_coordinates_are_kept_in_a_second_file() {
    let here = here();
    bake(&here, "scene.obj -o out --resolution 32 --final-gather 4 --report out/report.json");
    let report = here.json("out/report.json");
    let why = report["atlas"]["refused"].as_str().unwrap();
    assert!(why.contains("triangle 1 and triangle 3"), "{why}");
    let [made, original] =
        ["out/scene.obj", "out/scene-original-uv.obj"].map(|name| Scene::load(here.path(name)).unwrap());
    assert_eq!(made.triangles, original.triangles);
    assert_eq!(made.vertices, original.vertices);
    assert_eq!(original.texcoords, Scene::load(here.path("scene.obj")).unwrap().texcoords);
    assert_ne!(made.texcoords, original.texcoords);
    // A baked scene can be baked again, now with its own texture coordinates.
    fs::write(here.path("out/scene.mtl"), MTL).unwrap();
    bake(&here, "out/scene.obj -o again --resolution 32 --final-gather 0 --keep-uv");
    assert!(here.json("again/report.json")["atlas"]["refused"].is_null());
    assert!(!here.path("again/scene-original-uv.obj").exists());
}

#[test]
fn pages_have_their_own_files_and_materials() {
    let here = here();
    bake(&here, &format!("{} -o out --texel 10 --resolution 100 --final-gather 0", cornell()));
    let pages = here.json("out/report.json")["atlas"]["pages"].as_u64().unwrap();
    assert!(pages > 1);
    let materials = String::from_utf8(here.read("out/scene.mtl")).unwrap();
    for page in 2..=pages {
        assert!(materials.contains(&format!("map_Ke scene-{page}.png")));
        assert!(here.path(&format!("out/lightmap-{page}.exr")).exists());
    }
    let scene = Scene::load(here.path("out/scene.obj")).unwrap();
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    assert!(scene.textures.len() as u64 == pages);
}

#[test]
fn bad_input_is_reported_and_leaves_nothing() {
    let here = here();
    let errors = here.fails("bake scene.obj -o out --keep-uv", 2);
    assert!(errors.contains("triangle 1 and triangle 3") && errors.contains("hint: "), "{errors}");
    let errors = here.fails(&format!("bake {} -o a/b/c --keep-uv", cornell()), 2);
    assert!(errors.contains("the file has none"), "{errors}");
    let errors = here.fails(&format!("bake {} -o out --resolution 8", cornell()), 2);
    assert!(errors.contains("8 x 8 texels is too small") && errors.contains("--resolution"), "{errors}");
    let errors = here.fails("bake scene.obj -o out --density floor=2", 2);
    assert!(errors.contains("no face of scene.obj has material `floor`"), "{errors}");
    here.fails("bake scene.obj -o out --density wall=0", 2);
    here.fails("bake scene.obj -o out --density wall", 2);
    let errors = here.fails(&format!("bake {} -o out --texel 1e-4", cornell()), 2);
    assert!(errors.contains("longer texels (--texel)"), "{errors}");
    here.fails("bake scene.obj -o out --texel 0", 2);
    here.fails("bake scene.obj -o out --texel inf", 2);
    here.fails("bake scene.obj -o out --resolution 0", 2);
    here.fails("bake scene.obj -o out --final-gather 0 --standard-error", 2);
    here.fails("bake scene.obj -o out --keep-uv --new-uv", 2);
    here.fails("bake scene.obj -o scene.mtl", 2);
    here.fails("bake none.obj -o out", 2);
}

#[test]
fn files_of_a_scene_are_never_replaced() {
    let here = here();
    let before = (here.read("scene.obj"), here.read("scene.mtl"));
    let errors = here.fails("bake scene.obj -o .", 2);
    assert!(errors.contains("no earlier bake wrote"), "{errors}");
    // A material library of this name might belong to another scene.
    fs::rename(here.path("scene.obj"), here.path("room.obj")).unwrap();
    let errors = here.fails("bake room.obj -o .", 2);
    assert!(errors.contains("scene.mtl") && errors.contains("no earlier bake wrote"), "{errors}");
    assert_eq!((here.read("room.obj"), here.read("scene.mtl")), before);
    // Baking again into the same directory works, also after another program has saved the scene. Baking onto the input does
    // not.
    bake(&here, "room.obj -o out --resolution 32 --final-gather 0");
    fs::write(here.path("out/scene.obj"), "# saved elsewhere\n").unwrap();
    bake(&here, "room.obj -o out --resolution 40 --final-gather 0");
    assert_eq!(here.json("out/report.json")["atlas"]["width"], 40);
    fs::write(here.path("out/scene.mtl"), MTL).unwrap();
    let errors = here.fails("bake out/scene.obj -o out", 2);
    assert!(errors.contains("would replace the input"), "{errors}");
    // A file from elsewhere stays.
    fs::write(here.path("out/mask.png"), "mine").unwrap();
    let errors = here.fails("bake room.obj -o out --mask", 2);
    assert!(errors.contains("mask.png") && errors.contains("no earlier bake wrote"), "{errors}");
}

/// A file like those of modelling programs: objects, groups, smoothing, normals, quads, comments, names of materials.
const LEVEL: &str = "# made by hand\nmtllib level.mtl\no Floor_01\nv 0 0 0\nv 0 0 4\nv 4 0 4\nv 4 0 0\nvn 0 1 0\n\
    vt 0 0\nvt 0 4\nvt 4 4\nvt 4 0\nusemtl tiles\ns off\nf 1/1/1 2/2/1 3/3/1 4/4/1\n\
    o Bent\ng cloth folds\nv 1 1 1\nv 2 1 1\nv 2 2 2\nv 1 1 2\nusemtl tiles\ns 1\nf -4/1 -3/2 -2/3 -1/4\n\
    o Lamp.001\nusemtl lamp\nf 8//1 7//1 6//1\nv 1 3 1\nv 3 3 1\nv 3 3 3\nv 1 3 3\nvn 0 -1 0\nf 9//2 10//2 11//2 12//2\n\
    f 9 9 10\n# the end\n";

#[test]
fn the_written_mesh_is_the_file_with_other_texture_coordinates() {
    let here = Here::new("", "");
    fs::create_dir(here.path("level")).unwrap();
    fs::write(here.path("level/level.obj"), LEVEL).unwrap();
    let materials = "newmtl tiles\nKd 0.6 0.5 0.4\nnewmtl lamp\nKd 0 0 0\nKe 10 10 10\n";
    fs::write(here.path("level/level.mtl"), materials).unwrap();
    bake(&here, "level/level.obj -o out --resolution 64 --final-gather 0");
    let text = |name: &str| String::from_utf8(here.read(&format!("out/{name}"))).unwrap();
    let (map, own) = (text("scene.obj"), text("scene-original-uv.obj"));
    let but = |text: &str, keywords: &[&str]| -> Vec<String> {
        let kept = |line: &&str| !keywords.contains(&line.split(' ').next().unwrap());
        text.lines().filter(kept).map(str::to_owned).collect()
    };
    let changed = ["mtllib", "vt", "usemtl", "f"];
    assert_eq!(but(&map, &changed)[1..], but(LEVEL, &changed));
    assert_eq!(but(&own, &["mtllib", "f"])[1..], but(LEVEL, &["mtllib", "f"]));
    assert!(own.contains("mtllib ../level/level.mtl\n"), "{own}");

    // Quads stay quads, except for the one that lies on two charts. Vertices and normals stay.
    let faces = |text: &str| -> Vec<Vec<(String, String)>> {
        let corner = |corner: &str| {
            let mut parts = corner.split('/');
            let (v, _) = (parts.next().unwrap().to_owned(), parts.next());
            (v, parts.next().unwrap_or_default().to_owned())
        };
        let lines = text.lines().filter_map(|line| line.strip_prefix("f "));
        lines.map(|line| line.split(' ').map(corner).collect()).collect()
    };
    assert_eq!(faces(&map), faces(&own));
    let of_file = faces(&LEVEL.replace("-4/1 -3/2 -2/3 -1/4", "5/1 6/2 7/3 8/4"));
    let arities: Vec<usize> = faces(&map).iter().map(Vec::len).collect();
    assert_eq!(arities, [4, 3, 3, 3, 4, 3]);
    assert_eq!((&faces(&map)[0], &faces(&map)[3..]), (&of_file[0], &of_file[2..]));
    for cut in &faces(&map)[1..3] {
        assert!(cut.iter().all(|corner| of_file[1].contains(corner)), "{cut:?}");
    }

    // The first is a lit scene of its own, the second is the original scene.
    let [map, own, file] = ["out/scene.obj", "out/scene-original-uv.obj", "level/level.obj"]
        .map(|name| Scene::load(here.path(name)).unwrap());
    assert!(map.warnings.is_empty() && own.warnings.is_empty(), "{:?} {:?}", map.warnings, own.warnings);
    assert_eq!((&own.vertices, &own.texcoords), (&file.vertices, &file.texcoords));
    assert_eq!(own.materials, file.materials);
    let names = |scene: &Scene| -> Vec<String> {
        (0..scene.triangles.len()).map(|t| scene.material(t).name.clone()).collect()
    };
    assert_eq!(names(&map), names(&file));
    assert!(map.materials.iter().all(|m| m.emission == [1.0; 3] && m.reflectance == [0.0; 3]));
    assert!(map.texcoords.iter().flatten().all(|uv| uv.min_element() >= 0.0 && uv.max_element() <= 1.0));
}

/// A rug in the plane of the floor hides a part of it, and a material is ignored. All other faces stay as they are, and
/// what is hidden or ignored does not come back.
#[test]
fn faces_keep_their_shape_beside_hidden_and_ignored_ones() {
    let here = Here::new("", "");
    let rug = "o Rug\ng soft\nv 0.5 0 2\nv 0.5 0 3\nv 1 0 3\nv 1 0 2\nusemtl rug\nf -4//1 -3//1 -2//1 -1//1\n\
        o Pane\nv 3 0.5 1\nv 3 1.5 1\nv 3 1.5 2\nusemtl glass\nf -3 -2 -1\n";
    fs::write(here.path("level.obj"), [LEVEL, rug].concat()).unwrap();
    let materials = "newmtl tiles\nKd 0.6 0.5 0.4\nnewmtl lamp\nKd 0 0 0\nKe 10 10 10\nnewmtl rug\nKd 0.2 0.1 0.1\n\
        newmtl glass\nKd 0.9 0.9 0.9\n";
    fs::write(here.path("level.mtl"), materials).unwrap();
    bake(&here, "level.obj -o out --resolution 64 --final-gather 0 --ignore glass");
    for name in ["out/scene.obj", "out/scene-original-uv.obj"] {
        let text = String::from_utf8(here.read(name)).unwrap();
        // The number of corners of each face, by object.
        let mut arities: Vec<(&str, Vec<usize>)> = Vec::new();
        for line in text.lines() {
            match line.split_once(' ') {
                Some(("o", object)) => arities.push((object, Vec::new())),
                Some(("f", corners)) => {
                    let corners: Vec<&str> = corners.split(' ').collect();
                    arities.last_mut().unwrap().1.push(corners.len());
                }
                _ => {}
            }
        }
        let [floor, bent, lamp, rug, pane] = &arities[..] else { panic!("{arities:?}") };
        // The floor is cut around the rug. The degenerate face at the end of the lamp comes back too.
        assert!(floor.0 == "Floor_01" && floor.1.len() > 4 && floor.1.iter().all(|&n| n == 3), "{floor:?}");
        assert_eq!((bent, lamp), (&("Bent", vec![3, 3]), &("Lamp.001", vec![3, 4, 3])), "{name}");
        assert_eq!((rug, pane), (&("Rug", vec![4]), &("Pane", vec![])), "{name}");
        assert!(!text.contains("vn 0 0 0") && text.contains("g soft"), "{name}");
        let scene = Scene::load(here.path(name)).unwrap();
        let area: f64 = (0..scene.triangles.len()).map(|t| scene.area(t)).sum();
        let sources = Scene::load(here.path("level.obj")).unwrap();
        let wanted: f64 = (0..sources.triangles.len()).map(|t| sources.area(t)).sum();
        // The pane has an area of a half.
        assert!((area - (wanted - 0.5)).abs() < 1e-9, "{area} {wanted}");
    }
}

/// A bent sheet of two quads with normals at its vertices, and a lamp above it.
const PLY: &str = "ply\nformat ascii 1.0\nelement vertex 10\nproperty float x\nproperty float y\nproperty float z\n\
    property float nx\nproperty float ny\nproperty float nz\nelement face 3\nproperty list uchar int vertex_indices\n\
    property float emission_r\nproperty float emission_g\nproperty float emission_b\nend_header\n\
    0 0 0 0 2 0\n0 0 1 0 2 0\n1 0 1 0.6 0.8 0\n1 0 0 0.6 0.8 0\n1.5 -1 1 1 0 0\n1.5 -1 0 1 0 0\n\
    0 2 0 0 -1 0\n1 2 0 0 -1 0\n1 2 1 0 -1 0\n0 2 1 0 -1 0\n4 0 1 2 3 0 0 0\n4 3 2 4 5 0 0 0\n4 6 7 8 9 5 5 5\n";

#[test]
fn quads_and_normals_of_a_ply_come_back() {
    let here = Here::new("", "");
    fs::write(here.path("sheet.ply"), PLY).unwrap();
    bake(&here, "sheet.ply -o out --resolution 64 --final-gather 0");
    let obj = String::from_utf8(here.read("out/scene.obj")).unwrap();
    let words = |keyword: &str| -> Vec<Vec<String>> {
        let lines = obj.lines().filter_map(|line| line.strip_prefix(keyword));
        lines.map(|line| line.split_whitespace().map(str::to_owned).collect()).collect()
    };
    let faces = words("f ");
    assert_eq!(faces.iter().map(Vec::len).collect::<Vec<_>>(), [4, 4, 4], "{obj}");
    let number = |word: &str| word.parse::<f64>().unwrap();
    let (vertices, normals) = (words("v "), words("vn "));
    for (face, of_file) in faces.iter().zip([[0, 1, 2, 3], [3, 2, 4, 5], [6, 7, 8, 9]]) {
        let lines: Vec<&str> = PLY.lines().skip_while(|line| *line != "end_header").skip(1).collect();
        for (corner, v) in face.iter().zip(of_file) {
            let given: Vec<f64> = lines[v].split(' ').map(number).collect();
            let index: Vec<usize> = corner.split('/').map(|i| i.parse::<usize>().unwrap() - 1).collect();
            let position: Vec<f64> = vertices[index[0]].iter().map(|x| number(x)).collect();
            assert_eq!(position, given[..3]);
            let length = given[3..].iter().map(|x| x * x).sum::<f64>().sqrt();
            for (found, wanted) in normals[index[2]].iter().zip(&given[3..]) {
                assert!((number(found) - wanted / length).abs() < 1e-6, "{corner}");
            }
        }
    }
    assert!(Scene::load(here.path("out/scene.obj")).unwrap().warnings.is_empty());
}

/// Two signals at once, as timeout(1) sends them. The second ends the program while it still stops after the first, but
/// no directory stays.
#[cfg(unix)]
#[test]
fn a_new_directory_is_removed_even_after_a_second_signal() {
    let here = here();
    let scene = cornell();
    for command in ["bake", "tradeoff"] {
        for pause in [0, 1, 2, 3, 5, 8] {
            let mut child = Command::new(env!("CARGO_BIN_EXE_radiosity"))
                .current_dir(here.directory())
                .args([command, &scene, "-o", "a/b", "--patches", "20000", "--threads", "1"])
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()
                .unwrap();
            while !here.path("a/b").exists() {
                assert!(child.try_wait().unwrap().is_none(), "{command} ended without its directory");
            }
            // The program checks that the directory is writable by creating files for a moment.
            std::thread::sleep(Duration::from_millis(20));
            let script = format!("kill -INT {0}; sleep 0.00{pause}; kill -INT {0} 2>/dev/null", child.id());
            Command::new("sh").args(["-c", &script]).status().unwrap();
            assert_eq!(child.wait().unwrap().code(), Some(130), "{command}");
            assert_eq!(here.names(), ["scene.mtl", "scene.obj"], "{command}, {pause} ms");
        }
    }
}
