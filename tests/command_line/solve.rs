//! The command `solve`.

use std::{collections::BTreeMap, f64::consts::PI, fs, path::Path, process::Command};

use ply_rs::{
    parser::Parser,
    ply::{DefaultElement, Property},
};
use serde_json::Value;

use crate::common::program::{Here, stderr};

/// A closed unit cube seen from inside. All walls emit 1/π and reflect half: B = Be + B / 2 = 2.
const FURNACE: &str = "mtllib scene.mtl\nusemtl wall
v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nv 0 0 1\nv 1 0 1\nv 0 1 1\nv 1 1 1
f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n";
const GLOW: &str =
    "newmtl wall\nKd 0.5 0.5 0.5\nKe 0.31830988618379067 0.31830988618379067 0.31830988618379067\n";

/// Every pixel of `--picture` sees a wall of radiosity 2 W/m², so its radiance is 2/π. The mesh and the picture come
/// from the same run, also for a solution without a matrix.
#[test]
fn the_picture_of_a_solution_shows_its_radiance() {
    let here = Here::new(FURNACE, GLOW);
    for (solver, tolerance) in [("auto", 1e-5), ("stochastic-jacobi", 0.05)] {
        let options = format!("--solver {solver} --patches 200 --rays 64");
        let output = here.run(&format!("solve scene.obj -o out.ply --picture out.exr {options}"));
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        assert_eq!(here.names(), ["out.exr", "out.ply", "scene.mtl", "scene.obj"]);
        let bytes = here.read("out.exr");
        let picture =
            image::load_from_memory_with_format(&bytes, image::ImageFormat::OpenExr).unwrap().to_rgb32f();
        assert_eq!(picture.dimensions(), (640, 480));
        let off = picture.iter().map(|&l| (f64::from(l) * PI / 2.0 - 1.0).abs()).fold(0.0, f64::max);
        assert!(off < tolerance, "{solver}: a pixel has an error of {off}");
    }
    here.fails("solve scene.obj -o out.ply --picture out.gif", 2);
    here.fails("solve scene.obj --picture out.png --report out.png", 2);
}

/// The same cube with one lamp; the other sides have a colour.
fn lamp() -> Here {
    let obj = FURNACE.replace("f 1 2 4 3", "usemtl lamp\nf 1 2 4 3\nusemtl wall");
    Here::new(&obj, "newmtl wall\nKd 0.5 0.9 0.1\nnewmtl lamp\nKd 0.5 0.5 0.5\nKe 1 1 1\n")
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// A furnace has B = 2 and absorbs the 6 W that it emits, to the tolerance of the solver and single precision of the
/// file.
#[test]
fn the_furnace_is_solved_exactly_and_reported() {
    let here = Here::new(FURNACE, GLOW);
    let output = here.run("solve scene.obj -o out.ply --report r.json --patches 200 --rays 64");
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert_eq!(stderr(&output), "");
    assert_eq!(here.names(), ["out.ply", "r.json", "scene.mtl", "scene.obj"]);

    let ply = Parser::<DefaultElement>::new().read_ply(&mut &here.read("out.ply")[..]).unwrap();
    let faces = &ply.payload["face"];
    assert_eq!(faces.len(), 12 * 16);
    for face in faces {
        let Property::Float(radiosity) = face["radiosity_g"] else { panic!("no float") };
        assert!((radiosity - 2.0).abs() < 1e-6, "{radiosity}");
    }
    let report = here.json("r.json");
    assert_eq!(report["scene"]["file"], "scene.obj");
    assert_eq!(report["scene"]["triangles"], 12);
    assert_eq!(report["scene"]["patches"], 192);
    assert_eq!(report["scene"]["channels"], 1);
    assert_eq!(number(&report["scene"]["area"]), 6.0);
    assert_eq!(report["solve"]["converged"], true);
    assert_eq!(report["form_factors"]["escaped_fraction"], 0.0);
    for channel in 0..3 {
        assert!((number(&report["energy"]["emitted"][channel]) - 6.0).abs() < 1e-9);
        assert!((number(&report["energy"]["absorbed"][channel]) - 6.0).abs() < 1e-7);
    }
    assert!(number(&report["energy"]["imbalance"]).abs() < 1e-9);
    if cfg!(target_os = "linux") {
        assert!(number(&report["peak_bytes"]) > 1e6);
    }

    let table = String::from_utf8(output.stdout).unwrap();
    for said in
        ["12 triangles", "192 front + 0 back", "--patches 200", "emitted 6.000000e0 W", "out.ply, r.json"]
    {
        assert!(table.contains(said), "{said} is missing in\n{table}");
    }
}

#[test]
fn the_report_has_the_promised_fields_in_the_promised_order() {
    let here = Here::new(FURNACE, GLOW);
    here.run("solve scene.obj --report r.json --patch-size inf --rays 16");
    let text = String::from_utf8(here.read("r.json")).unwrap();
    let mut rest = &text[..];
    for field in [
        "version scene file triangles patches area channels",
        "form_factors rays non_zeros bytes escaped_fraction back_hits",
        "row_sum_deviation before after reciprocity_deviation before after",
        "solve solver iterations residual error_bound converged",
        "energy emitted entered entered_standard_error absorbed escaped escaped_standard_error imbalance solver_part reciprocity_part",
        "error rms_relative confidence bias_relative discretisation_relative total_relative largest_region",
        "seconds load subdivide bvh form_factors solve output total peak_bytes",
    ]
    .into_iter()
    .flat_map(str::split_whitespace)
    {
        let at = rest.find(&format!("\"{field}\":")).unwrap_or_else(|| panic!("{field} is not in its place"));
        rest = &rest[at + field.len()..];
    }
    let seconds = &here.json("r.json")["seconds"];
    let sum: f64 = ["load", "subdivide", "bvh", "form_factors", "solve", "output"]
        .map(|s| number(&seconds[s]))
        .iter()
        .sum();
    assert!(sum <= number(&seconds["total"]) + 1e-5);
    // Whole triangles have no largest edge: infinity is written as null.
    assert!(here.json("r.json")["scene"]["patch_edge"].is_null());
    assert_eq!(here.json("r.json")["scene"]["patches"], 12);
}

/// If no option sets the patches, `--error` makes them small where light varies, so that triangles have patches of
/// several sizes. If an option sets them, all patches of a triangle have one size. Then they may be too large for the
/// wanted error, and the exit status is 1.
#[test]
fn a_wanted_error_alone_cuts_patches_by_the_light() {
    let here = Here::new("", "");
    let scene = format!("{}/meshes/cornell-box.obj", env!("CARGO_MANIFEST_DIR"));
    // The areas of the patches of each triangle. A patch that is drawn as several faces counts once.
    let sizes = |options: &str, status: i32| {
        let output = here.run(&format!("solve {scene} --error .5 {options} -o out.ply --quiet"));
        assert_eq!(output.status.code(), Some(status), "{}", stderr(&output));
        let ply = Parser::<DefaultElement>::new().read_ply(&mut &here.read("out.ply")[..]).unwrap();
        let mut patches = BTreeMap::new();
        for (k, face) in ply.payload["face"].iter().enumerate() {
            let (Property::Int(triangle), Property::UChar(side)) = (&face["triangle"], &face["side"]) else {
                panic!("no integers")
            };
            let patch = match face.get("patch") {
                Some(Property::Int(patch)) => *patch as usize,
                _ => k,
            };
            let Property::Double(area) = face["area"] else { panic!("no double") };
            if *side == 0 {
                *patches.entry((*triangle, patch)).or_insert(0.0) += area;
            }
        }
        let mut of_triangle: BTreeMap<i32, Vec<f64>> = BTreeMap::new();
        patches
            .into_iter()
            .for_each(|((triangle, _), area)| of_triangle.entry(triangle).or_default().push(area));
        of_triangle
    };
    // The ratio of the largest to the smallest patch of a triangle is a power of four.
    let ratio = |areas: &Vec<f64>| {
        let extreme = |f: fn(f64, f64) -> f64| areas.iter().copied().reduce(f).unwrap();
        (extreme(f64::max) / extreme(f64::min)).round() as u32
    };
    let by_light = sizes("", 0);
    assert_eq!(by_light.len(), 54);
    assert!(by_light.values().all(|areas| [1, 4, 16, 64, 256].contains(&ratio(areas))));
    let mixed = by_light.values().filter(|areas| ratio(areas) > 1).count();
    assert!(mixed >= 5, "{mixed} of 54 triangles");
    assert!(sizes("--patches 200", 1).values().all(|areas| ratio(areas) == 1));
}

#[test]
fn the_same_seed_gives_the_same_bytes_on_any_number_of_threads() {
    let here = lamp();
    let mesh = |options: &str| {
        let output =
            here.run(&format!("solve scene.obj -o out.ply --quiet --patches 500 --rays 32 {options}"));
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        assert!(output.stdout.is_empty() && output.stderr.is_empty());
        here.read("out.ply")
    };
    let one = mesh("--threads 1");
    assert!(one == mesh("--threads 2"));
    assert!(one == mesh("--threads 5"));
    assert!(one != mesh("--seed 7"));
}

/// Every solver and quality absorbs the 6 W that the furnace emits, to the tolerance of the solver.
#[test]
fn every_solver_and_quality_gives_the_furnace_the_same_light() {
    let here = Here::new(FURNACE, GLOW);
    let absorbed = |options: &str| {
        let output = here.run(&format!("solve scene.obj --report r.json {options}"));
        assert_eq!(output.status.code(), Some(0), "{options}: {}", stderr(&output));
        let report = here.json("r.json");
        (
            number(&report["energy"]["absorbed"][0]),
            report["solve"]["solver"].as_str().unwrap().to_owned(),
            report,
        )
    };
    for solver in ["jacobi", "gauss-seidel", "southwell", "cg", "direct"] {
        let (watts, name, _) = absorbed(&format!("--solver {solver} --patches 100 --rays 16"));
        assert!((watts - 6.0).abs() < 1e-6);
        assert_eq!(name, solver);
    }
    let (_, name, report) = absorbed("--quality draft --estimator one-way");
    assert_eq!((name.as_str(), &report["options"]["estimator"]), ("gauss-seidel", &Value::from("one-way")));
    assert_eq!(report["scene"]["patches"], 768);
    // After half of the rays all patches are known to be equally bright. The other half is cast all the same, evenly.
    assert_eq!(absorbed("--quality draft").2["options"]["rays_per_patch"], 64.0);
}

/// The reported error is the RMS of the standard errors in the mesh, and falls with the root of the number of rays or
/// faster.
#[test]
fn standard_errors_are_in_the_mesh_and_fall_with_more_rays() {
    let here = lamp();
    let errors = |rays: u32| {
        let options = format!("solve scene.obj -o out.ply --report r.json --patches 200 --rays {rays}");
        assert_eq!(here.run(&options).status.code(), Some(0));
        let ply = Parser::<DefaultElement>::new().read_ply(&mut &here.read("out.ply")[..]).unwrap();
        let (mut squares, mut irradiance) = (0.0, 0.0);
        for face in &ply.payload["face"] {
            for channel in ["r", "g", "b"] {
                let value = |quantity: &str| match face[&format!("{quantity}_{channel}")] {
                    Property::Float(x) => f64::from(x),
                    _ => panic!("no float"),
                };
                squares += value("error").powi(2);
                irradiance += value("irradiance");
            }
        }
        // All patches of a cube have one area.
        let count = (3 * ply.payload["face"].len()) as f64;
        let relative = (squares / count).sqrt() / (irradiance / count);
        let reported = number(&here.json("r.json")["error"]["rms_relative"]);
        assert!((relative / reported - 1.0).abs() < 1e-5, "{relative} {reported}");
        relative
    };
    let (few, many) = (errors(32), errors(512));
    // 16 times the rays leave at most a quarter of the error; a third is allowed.
    assert!(few < 0.5 && many < few / 3.0, "{few} {many}");
}

/// Exposure scales colours by powers of two and leaves radiosity unchanged.
#[test]
fn exposure_moves_colours_by_stops_and_nothing_else() {
    let here = Here::new(FURNACE, GLOW);
    let run = |stops: &str| {
        let options =
            format!("solve scene.obj -o out.ply --report r.json --patches 50 --rays 16 --exposure {stops}");
        let output = here.run(&options);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let ply = Parser::<DefaultElement>::new().read_ply(&mut &here.read("out.ply")[..]).unwrap();
        let vertex = &ply.payload["vertex"][0];
        (
            vertex["red"].clone(),
            vertex["radiosity_r"].clone(),
            number(&here.json("r.json")["options"]["white"]),
        )
    };
    let (colour, radiosity, white) = run("0");
    let (darker, same, grey) = run("-1");
    assert_eq!(radiosity, same);
    assert!((grey / white - 2.0).abs() < 1e-12);
    // 0.8 and 0.4 of white, encoded as sRGB.
    assert_eq!((colour, darker), (Property::UChar(231), Property::UChar(170)));
}

#[test]
fn bad_usage_is_reported_before_any_work_and_exits_with_two() {
    let here = Here::new(FURNACE, GLOW);
    for (arguments, said) in [
        ("", "Usage"),
        ("solve", "<SCENE>"),
        ("solve scene.obj --rays 0", "--rays"),
        ("solve scene.obj --rays -1", "error: invalid value '-1' for '--rays <N>': "),
        ("solve scene.obj --error 1000", "at most 100"),
        ("solve scene.obj --time inf", "a finite number of seconds"),
        ("solve scene.obj --patch 3", "\nhint: a similar argument exists: '--patches'"),
        ("solve scene.obj --patch-size 0", "a length above 0"),
        ("solve scene.obj --patch-size nan", "a length above 0"),
        ("solve scene.obj --patches 10 --patch-size 1", "cannot be used with"),
        ("solve scene.obj --tolerance 0", "between 0 and 1"),
        ("solve scene.obj --exposure inf", "between -100 and 100"),
        ("solve scene.obj --emit 1e308", "from 0 to 1e100"),
        ("solve scene.obj --threads 0", "--threads"),
        ("solve scene.obj --threads 100000", "--threads 100000 is too large"),
        ("solve scene.obj --solver magic", "possible values"),
        ("solve scene.obj --solver cg --estimator one-way", "reciprocal"),
        ("solve scene.obj -o out.stl", "must end in .ply"),
        ("solve scene.obj -o scene.obj", "replace the input"),
        ("solve scene.obj --report ./scene.obj", "replace the input"),
        ("solve scene.obj --report scene.mtl", "material"),
        ("solve scene.obj -o a.ply --report a.ply", "the same file"),
        ("solve scene.obj -o nowhere/out.ply", "hint: make the directory nowhere first"),
        ("solve scene.obj --patches 800000000 --rays 4000000000", "of memory, this machine has"),
        ("solve scene.obj --patch-size 1e-9", "hint: choose a larger --patch-size"),
        ("validate scene.obj --patches 100000000 --rays 16", "of memory, this machine has"),
    ] {
        let errors = here.fails(arguments, 2);
        assert!(errors.contains(said), "{arguments}: {errors}");
        if !arguments.is_empty() {
            let lines: Vec<_> = errors.lines().collect();
            assert!(lines.len() <= 2 && lines[0].starts_with("error: "), "{errors}");
            assert!(lines[1..].iter().all(|line| line.starts_with("hint: ")), "{errors}");
        }
    }
    assert_eq!(here.read("scene.obj"), FURNACE.as_bytes());
}

#[test]
fn every_command_prints_its_version() {
    let here = Here::new("", "");
    for command in ["", "solve", "validate", "render", "bake", "probe", "inspect", "tradeoff", "view-factors"]
    {
        let output = here.run(&format!("{command} --version"));
        assert_eq!(output.status.code(), Some(0), "{command}: {}", stderr(&output));
        let said = String::from_utf8(output.stdout).unwrap();
        assert!(said.trim_end().ends_with(env!("CARGO_PKG_VERSION")), "{said}");
    }
}

#[test]
fn bad_input_is_reported_with_file_and_line() {
    let here = Here::new(&FURNACE.replace("f 1 5 6 2", "f 1 5 66 2"), GLOW);
    let errors = here.fails("solve scene.obj -o out.ply --report r.json", 2);
    assert!(errors.starts_with("error: scene.obj:13: "), "{errors}");
    assert!(errors.lines().all(|l| l.starts_with("error: ") || l.starts_with("hint: ")), "{errors}");

    assert!(here.fails("solve missing.obj", 2).starts_with("error: missing.obj: "));
    assert!(
        here.fails("solve scene.mtl", 2).starts_with("error: scene.mtl: this is a material library\nhint: ")
    );

    let dark = Here::new(FURNACE, "newmtl wall\nKd 0.5 0.5 0.5\n");
    let errors = dark.fails("solve scene.obj -o out.ply", 2);
    assert!(errors.starts_with("error: scene.obj: nothing emits light"), "{errors}");
    assert!(errors.contains("\nhint: give a material"), "{errors}");

    let mirror = Here::new(FURNACE, &GLOW.replace("Kd 0.5 0.5 0.5", "Kd 1 1 1"));
    let errors = mirror.fails("solve scene.obj -o out.ply --rays 16 --patches 50", 2);
    assert!(errors.starts_with("error: scene.obj: the scene has no equilibrium"), "{errors}");
}

#[test]
fn existing_files_stay_when_the_run_fails() {
    let here = lamp();
    fs::write(here.path("out.ply"), "old").unwrap();
    let errors = here.fails("solve scene.obj -o out.ply --tolerance 1e-300 --patches 50 --rays 16", 1);
    assert!(errors.starts_with("error: cg did not converge: "), "{errors}");
    assert!(errors.contains("\nhint: "), "{errors}");
    assert_eq!(here.read("out.ply"), b"old");
}

#[test]
fn warnings_go_to_stderr_and_do_not_stop_the_work() {
    let here = Here::new(&format!("{FURNACE}f 1 2 2\n"), GLOW);
    let output = here.run("solve scene.obj -o out.ply --quiet --patches 50 --rays 16");
    assert_eq!(output.status.code(), Some(0));
    assert!(stderr(&output).lines().all(|line| line.starts_with("warning: ")) && !output.stderr.is_empty());
}

#[test]
fn help_and_version_are_there() {
    let here = Here::new(FURNACE, GLOW);
    for (arguments, said) in [
        ("--version", concat!("radiosity ", env!("CARGO_PKG_VERSION"))),
        ("--help", "Example:\n  radiosity solve room.obj"),
        ("solve --help", "Example:\n  radiosity solve room.obj"),
    ] {
        let output = here.run(arguments);
        assert_eq!(output.status.code(), Some(0));
        assert!(String::from_utf8(output.stdout).unwrap().contains(said));
    }
}

#[cfg(unix)]
#[test]
fn a_signal_stops_the_work_and_leaves_nothing() {
    use std::{
        process::Stdio,
        time::{Duration, Instant},
    };
    let here = Here::new(FURNACE, GLOW);
    let child = Command::new(env!("CARGO_BIN_EXE_radiosity"))
        .current_dir(here.directory())
        .args([
            "solve",
            "scene.obj",
            "-o",
            "out.ply",
            "--report",
            "r.json",
            "--patches",
            "50000",
            "--rays",
            "4000",
        ])
        .args(["--threads", "1"])
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    std::thread::sleep(Duration::from_millis(700));
    let killed = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(killed.success());
    let asked = Instant::now();
    let output = child.wait_with_output().unwrap();
    assert!(asked.elapsed() < Duration::from_secs(5));
    assert_eq!(output.status.code(), Some(130));
    assert_eq!(stderr(&output).lines().last(), Some("stopped"));
    assert_eq!(here.names(), ["scene.mtl", "scene.obj"]);
}

#[test]
fn paths_with_blanks_and_directories_work() {
    let here = Here::new(FURNACE, GLOW);
    fs::create_dir(here.path("a b")).unwrap();
    let scene: &Path = &here.path("scene.obj");
    let output = Command::new(env!("CARGO_BIN_EXE_radiosity"))
        .current_dir(here.path("a b"))
        .arg("solve")
        .arg(scene)
        .args(["-o", "my mesh.PLY", "--patches", "50", "--rays", "16"])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(here.path("a b/my mesh.PLY").exists());
}
