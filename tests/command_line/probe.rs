//! The command `probe`.

use std::{f64::consts::PI, fs};

use crate::common::program::{Here, stderr};
use glam::{DVec3, dvec3};
use radiosity::form_factor::exact::point_to_polygon;

/// A black floor, and above it a black lamp of 1 x 0.6 that faces down with radiances 3, 1, 1/4.
const LAMP: &str = "mtllib scene.mtl\nusemtl black
v -4 0 -4\nv -4 0 4\nv 4 0 4\nv 4 0 -4\nf 1 2 3 4\nusemtl lamp
v 0 1.5 0\nv 1 1.5 0\nv 1 1.5 0.6\nv 0 1.5 0.6\nf 5 6 7 8\n";
const BLACK: &str = "newmtl black\nKd 0 0 0\nnewmtl lamp\nKd 0 0 0\nKe 3 1 0.25\n";
const CORNERS: [DVec3; 4] =
    [dvec3(0.0, 1.5, 0.0), dvec3(1.0, 1.5, 0.0), dvec3(1.0, 1.5, 0.6), dvec3(0.0, 1.5, 0.6)];

/// The numbers of every line.
fn table(bytes: &[u8]) -> Vec<Vec<f64>> {
    let text = std::str::from_utf8(bytes).unwrap();
    text.lines().map(|line| line.split_whitespace().map(|word| word.parse().unwrap()).collect()).collect()
}

fn probe(here: &Here, options: &str) -> Vec<Vec<f64>> {
    let output = here.run(&format!("probe {options}"));
    assert_eq!(output.status.code(), Some(0), "{options}: {}", stderr(&output));
    assert_eq!(stderr(&output), "");
    table(&output.stdout)
}

/// In a black scene the irradiance at a point is Lambert's formula for the lamp, within four standard errors.
#[test]
fn direct_light_is_lambert_s() {
    let here = Here::new(LAMP, BLACK);
    // On the floor, below the middle of the lamp and aside; in the air, upright and tilted so that the lamp straddles
    // the horizon.
    let probes = [
        (dvec3(0.5, 0.0, 0.3), DVec3::Y),
        (dvec3(-2.0, 0.0, 1.7), DVec3::Y),
        (dvec3(0.2, 1.2, 0.1), DVec3::Y),
        (dvec3(0.5, 0.7, 0.3), dvec3(1.0, 0.1, 0.2)),
    ];
    let lines: String = probes
        .iter()
        .map(|(p, n)| format!("{} {} {} {} {} {} # a place\n", p.x, p.y, p.z, n.x, n.y, n.z))
        .collect();
    fs::write(here.path("points.txt"), lines).unwrap();
    for method in ["path", "radiosity --patches 50 --rays 32"] {
        let found = probe(&here, &format!("scene.obj --points points.txt --spp 16384 --method {method}"));
        assert_eq!(found.len(), probes.len());
        for (line, (point, normal)) in found.iter().zip(probes) {
            assert_eq!(line.len(), 12);
            assert_eq!(line[..6], [point.to_array(), normal.to_array()].concat());
            let form_factor = point_to_polygon(point, normal.normalize(), &CORNERS);
            for (c, radiance) in [3.0, 1.0, 0.25].into_iter().enumerate() {
                let (got, error, want) = (line[6 + c], line[9 + c], PI * radiance * form_factor);
                assert!(
                    error < 0.01 * want && (got - want).abs() <= 4.0 * error + 1e-9 * want,
                    "{method}: {got} ± {error}, not {want}"
                );
            }
        }
    }
}

/// The squares of these lengths are beyond double precision. Scaling by a power of two keeps the direction, to the bit.
#[test]
fn directions_of_any_length_are_directions() {
    let here = Here::new(LAMP, BLACK);
    let light = |length: f64| {
        let n = dvec3(1.0, 0.1, 0.2) * length;
        fs::write(here.path("p"), format!("0.5 0.7 0.3 {} {} {}\n", n.x, n.y, n.z)).unwrap();
        probe(&here, "scene.obj --points p --spp 16")[0].split_off(6)
    };
    let wanted = light(1.0);
    assert!(wanted[0] > 0.0);
    for length in [2f64.powi(1000), 2f64.powi(-600), 2f64.powi(-1000)] {
        assert_eq!(light(length), wanted, "{length:e}");
    }
}

/// In a furnace both methods give an irradiance of 1, within 4.5 standard errors.
#[test]
fn both_methods_give_the_irradiance_of_a_furnace() {
    let here = Here::new(LAMP, BLACK);
    fs::write(here.path("p"), "0.5 0 0.5 0 1 0\n0.2 0.2 0.2 1 1 1\n0.45 0.7 0.4 0 3 0\n").unwrap();
    let scene = format!("{}/meshes/furnace.obj", env!("CARGO_MANIFEST_DIR"));
    for method in ["path", "path --no-next-event", "radiosity --patches 300"] {
        for line in probe(&here, &format!("{scene} --points p --method {method}")) {
            assert!((line[6] - 1.0).abs() < 4.5 * line[9] && line[9] < 0.01, "{method}: {line:?}");
        }
    }
}

/// Both methods agree where most light is indirect. The tolerance is four standard errors and the change between two
/// patch sizes, which estimates the discretisation error.
#[test]
fn both_methods_agree_on_indirect_light() {
    let here = Here::new(LAMP, BLACK);
    // On the ceiling, which the lamp does not light; in the shadow of the tall block; on the red wall.
    fs::write(here.path("p"), "100 548.8 450 0 -1 0\n500 0 450 0 1 0\n556 200 100 -1 0 0\n").unwrap();
    let scene = format!("{}/meshes/cornell-box.obj", env!("CARGO_MANIFEST_DIR"));
    let by = |options: &str| probe(&here, &format!("{scene} --points p {options}"));
    let paths = by("--spp 32768");
    let [coarse, fine] =
        [1_000, 4_000].map(|n| by(&format!("--method radiosity --rays 256 --patches {n} --spp 8192")));
    for (i, p) in paths.iter().enumerate() {
        for c in 0..3 {
            let (want, error) = (p[6 + c], p[9 + c]);
            // The change between two patch sizes estimates the error of the solution.
            let allowed = 4.0 * error.hypot(fine[i][9 + c]) + (coarse[i][6 + c] - fine[i][6 + c]).abs();
            assert!(allowed < 0.15 * want, "{i}: {p:?} {:?} {:?}", coarse[i], fine[i]);
            assert!((fine[i][6 + c] - want).abs() < allowed, "{i}: {p:?} {:?} {:?}", coarse[i], fine[i]);
        }
    }
}

#[test]
fn a_file_has_the_bytes_of_stdout_for_any_number_of_threads() {
    let here = Here::new(LAMP, BLACK);
    fs::write(here.path("p"), "0.5 0 0.3 0 1 0\n1 0 1 0 1 0\n").unwrap();
    let shown = here.run("probe scene.obj --points p --spp 256 --threads 1").stdout;
    assert_eq!(table(&shown).len(), 2);
    let output = here.run("probe scene.obj --points p --spp 256 --threads 3 -o out.txt --report r.json");
    assert!(here.read("out.txt") == shown);
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(said.contains("2 points") && said.contains("out.txt, r.json"), "{said}");
    let report = here.json("r.json");
    assert_eq!((&report["probes"]["points"], &report["samples"]), (&2.into(), &256.into()));
    let mean = table(&shown).iter().map(|line| line[6]).sum::<f64>() / 2.0;
    assert!((report["probes"]["mean_irradiance"][0].as_f64().unwrap() / mean - 1.0).abs() < 1e-6);
    assert!(here.run("probe scene.obj --points p --spp 256 --seed 9").stdout != shown);
}

#[test]
fn bad_points_are_reported_with_file_and_line() {
    let here = Here::new(LAMP, BLACK);
    fs::write(here.path("good"), "0.5 0 0.3 0 1 0\n").unwrap();
    fs::write(here.path("bad"), "0.5 0 0.3 0 1 0\n\n# two\n1 2 3 4 5\n").unwrap();
    fs::write(here.path("empty"), "# none\n").unwrap();
    for (options, said) in [
        ("--points bad", "error: bad:4: 6 numbers expected, found 5\nhint: a line reads: x y z nx ny nz"),
        ("--points empty", "error: empty: no points"),
        ("--points none", "error: none: "),
        ("--points good -o good", "replace the input"),
        ("--points good -o scene.obj", "replace the input"),
        ("--points good -o scene.mtl", "may not have the name"),
        ("--points good -o a --report a", "the same file"),
        ("--points good --spp 0", "--spp"),
        ("--points good --patches 9", "--patches has no effect with --method path"),
        (
            "--points good --method radiosity --no-next-event",
            "--no-next-event has no effect with --method radiosity",
        ),
        ("", "--points"),
    ] {
        let errors = here.fails(&format!("probe scene.obj {options}"), 2);
        assert!(errors.contains(said), "{options}: {errors}");
    }
}

/// A warning names points below a surface, but not points that lie on it up to the rounding of six digits.
#[test]
fn points_below_a_surface_are_named() {
    let here = Here::new(LAMP, BLACK);
    fs::write(here.path("on.txt"), "0.5 0.001 0.3 0 1 0\n0.5 -0.000001 0.3 0 1 0\n").unwrap();
    let on = probe(&here, "scene.obj --points on.txt");
    assert!(on.iter().all(|line| line[6] > 0.7), "{on:?}");
    fs::write(here.path("below.txt"), "0.5 0.001 0.3 0 1 0\n0.5 -0.001 0.3 0 1 0\n0.5 -0.01 0.3 0 1 0\n")
        .unwrap();
    let below = here.run("probe scene.obj --points below.txt");
    let said = stderr(&below);
    assert_eq!(below.status.code(), Some(0), "{said}");
    assert!(
        said.contains("2 points lie below a surface") && said.contains("point 2, 0.5 -0.001 0.3"),
        "{said}"
    );
    assert!(table(&below.stdout)[1][6] == 0.0);
}

/// A pane blocks the light of the lamp unless its material is ignored. Then the light is that without a pane, within 1
/// %.
#[test]
fn materials_can_be_ignored() {
    let pane = "usemtl glass\nv -1 1 -1\nv 2 1 -1\nv 2 1 2\nv -1 1 2\nf 9 10 11 12\n";
    let glass = format!("{BLACK}newmtl glass\nKd 0.9 0.9 0.9\nd 0.1\n");
    let here = Here::new(&format!("{LAMP}{pane}"), &glass);
    fs::write(here.path("p.txt"), "0.5 0 0.3 0 1 0\n").unwrap();
    let irradiance = |options: &str| {
        let output = here.run(&format!("probe scene.obj --points p.txt {options}"));
        table(&output.stdout)[0][6]
    };
    let want = PI * 3.0 * point_to_polygon(dvec3(0.5, 0.0, 0.3), DVec3::Y, &CORNERS);
    assert_eq!(irradiance(""), 0.0);
    let got = irradiance("--ignore glass");
    assert!((got / want - 1.0).abs() < 0.01, "{got} for {want}");
    let unknown = here.fails("probe scene.obj --points p.txt --ignore glas", 2);
    assert!(unknown.contains("`glas`") && unknown.contains("black, lamp, glass"), "{unknown}");
    let nothing = here.fails("inspect scene.obj --ignore glass --ignore black --ignore lamp", 2);
    assert!(nothing.contains("no face is left"), "{nothing}");
}
