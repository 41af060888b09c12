//! Specular reflection on the command line.

use std::{f64::consts::PI, fs};

use crate::common::program::{Here, stderr};
use glam::{DVec3, dvec3};
use radiosity::form_factor::exact::point_to_polygon;

/// A black floor, a black lamp that faces down above it, and an upright mirror beside both, in which a point of the
/// floor sees the whole lamp.
const MIRROR: &str = "mtllib scene.mtl\nusemtl black
v -1 0 -4\nv -1 0 4\nv 4 0 4\nv 4 0 -4\nf 1 2 3 4\nusemtl lamp
v 0 1.5 0\nv 1 1.5 0\nv 1 1.5 0.6\nv 0 1.5 0.6\nf 5 6 7 8\nusemtl wall
v -1 0 -4\nv -1 3 -4\nv -1 3 4\nv -1 0 4\nf 9 10 11 12\n";
const BLACK: &str = "newmtl black\nKd 0 0 0\nnewmtl lamp\nKd 0 0 0\nKe 3 1 0.25\nnewmtl wall\nKd 0 0 0\n";
const LAMP: [DVec3; 4] =
    [dvec3(0.0, 1.5, 0.0), dvec3(1.0, 1.5, 0.0), dvec3(1.0, 1.5, 0.6), dvec3(0.0, 1.5, 0.6)];
const POINT: DVec3 = dvec3(0.5, 0.0, 0.3);

fn mirrored() -> [DVec3; 4] {
    let [a, b, c, d] = LAMP.map(|p| dvec3(-2.0 - p.x, p.y, p.z));
    [d, c, b, a]
}

fn with_wall(lines: &str) -> Here {
    let here = Here::new(MIRROR, &format!("{BLACK}{lines}"));
    fs::write(here.path("points"), format!("{} {} {} 0 1 0\n", POINT.x, POINT.y, POINT.z)).unwrap();
    here
}

/// Irradiance of the point and its standard error, R G B.
fn probed(here: &Here, options: &str) -> [[f64; 3]; 2] {
    let output = here.run(&format!("probe scene.obj --points points --spp 32768 {options}"));
    assert_eq!(output.status.code(), Some(0), "{options}: {}", stderr(&output));
    assert_eq!(stderr(&output), "");
    let text = String::from_utf8(output.stdout).unwrap();
    let numbers: Vec<f64> = text.split_whitespace().map(|word| word.parse().unwrap()).collect();
    [6, 9].map(|k| numbers[k..k + 3].try_into().unwrap())
}

/// The irradiance at a point is π L (F + k F'), where F is the form factor of the lamp, F' that of its mirror image and
/// k the reflectance of the mirror, within four standard errors.
#[test]
fn a_mirror_shows_a_second_lamp() {
    let [direct, image] = [LAMP, mirrored()].map(|lamp| point_to_polygon(POINT, DVec3::Y, &lamp));
    // 4.6 % of the direct light of the lamp, many times the errors allowed below.
    assert!((0.04..0.05).contains(&(image / direct)));
    for (lines, options, ks) in [
        ("Ks 1 0.5 0\nillum 3\n", "", [1.0, 0.5, 0.0]),
        ("", "--model wall=mirror:0.8", [0.8; 3]),
        // Schlick's term adds 2·10⁻⁵ at 27 degrees.
        ("Ks 0.8 0.5 0.2\nillum 5\n", "", [0.8, 0.5, 0.2]),
        ("Ks 1 1 1\nillum 1\n", "", [0.0; 3]),
    ] {
        let [mean, error] = probed(&with_wall(lines), options);
        for (c, radiance) in [3.0, 1.0, 0.25].into_iter().enumerate() {
            let wanted = PI * radiance * (direct + ks[c] * image);
            assert!(error[c] < 0.008 * wanted, "{lines}{options}: {mean:?} ± {error:?}");
            assert!((mean[c] - wanted).abs() < 4.0 * error[c], "{lines}{options}: {mean:?}, not {wanted}");
        }
    }
}

/// A sharp lobe of Ks acts like a mirror of Ks, except for its width. Phong lobes reflect less away from normal
/// incidence. The tolerance is four standard errors and some percent for the width.
#[test]
fn sharp_lobes_of_files_and_options_are_nearly_mirrors() {
    let [direct, image] = [LAMP, mirrored()].map(|lamp| PI * 3.0 * point_to_polygon(POINT, DVec3::Y, &lamp));
    // Cosine of the angle between the normal of the wall and the direction to the mirror image of the lamp.
    let cos = 3.0 / 3f64.hypot(1.5);
    for (lines, options, least) in [
        ("Ks 0.8 0.8 0.8\nNs 100000\nillum 2\n", "", 0.95 * cos),
        ("Ks 0.8 0.8 0.8\nNs 100000\n", "", 0.95 * cos),
        ("", "--model wall=phong:0.8,100000", 0.95 * cos),
        ("", "--model wall=blinn-phong:0.8,400000", 0.95 * cos * cos),
        ("", "--model wall=ward:0.8,0.003,0.003", 0.97),
        ("", "--model wall=beckmann:0.8,0.003", 0.97),
        ("", "--model wall=ggx:0.8,0.003", 0.97),
        ("", "--model wall=schlick:0.8,0.003", 0.97),
        // κ²/(4 + κ²) at normal incidence.
        ("", "--model wall=conductor:1,4,0.003", 0.97),
        // α is the square of the roughness, and the base colour of a metal is its reflectance.
        ("", "--reflectance 0.8@wall --model wall=metallic-roughness:1,0.05", 0.97),
        ("Pm 1\nPr 0.05\n", "--reflectance 0.8@wall", 0.97),
        ("Pm 1\nPr 0.05\naniso 0.5\nKs 1 0 0\nNs 3\n", "--reflectance 0.8@wall", 0.97),
    ] {
        let [mean, error] = probed(&with_wall(lines), options);
        let (share, error) = ((mean[0] - direct) / (0.8 * image), error[0] / (0.8 * image));
        assert!(error < 0.06, "{lines}{options}: {share} ± {error}");
        let within = (least - 4.0 * error..1.02 + 4.0 * error).contains(&share);
        assert!(within, "{lines}{options}: {share} ± {error}");
    }
}

#[test]
fn faults_of_a_model_are_reported() {
    let here = with_wall("");
    let said = here.fails("probe scene.obj --points points --model wand=mirror:1", 2);
    assert!(
        said.contains("--model") && said.contains("`wand`") && said.contains("black, lamp, wall"),
        "{said}"
    );
    let said = here.fails("render scene.obj -o a.png --model wall=glass:1", 2);
    assert!(said.contains("ward:KS,AX,AY"), "{said}");
    let said = here.fails("validate scene.obj --model wall=ggx:0.5,3", 2);
    assert!(said.contains("roughness 3"), "{said}");
}

#[test]
fn materials_that_would_make_light_are_scaled_with_a_warning() {
    let here = with_wall("Ks 0.5 0.5 0.5\nNs 10\nillum 2\n");
    fs::write(here.path("scene.mtl"), format!("{BLACK}Kd 0.8 0.8 0.8\nKs 0.5 0.5 0.5\nNs 10\n")).unwrap();
    let output = here.run("probe scene.obj --points points --spp 64");
    assert!(stderr(&output).contains("material `wall`: diffuse and specular reflectance sum to 1.300"));
    // A file with numbers out of range is not refused.
    fs::write(here.path("scene.mtl"), format!("{BLACK}Ks 3 0 0\nNs -4\n")).unwrap();
    let output = here.run("probe scene.obj --points points --spp 64");
    assert_eq!(output.status.code(), Some(0));
    assert!(
        stderr(&output).contains("scene.mtl:8: material `wall`: Ks 3 is out of range"),
        "{}",
        stderr(&output)
    );
}

/// `solve` reports how it treats gloss: a diffuse wall reflects some of the light that is absorbed when its gloss is
/// left out.
#[test]
fn solve_reports_how_it_treats_gloss() {
    let here = with_wall("Ks 0.6 0.6 0.6\nillum 3\n");
    let mean = |options: &str, what: &str| {
        let output = here.run(&format!("solve scene.obj --patches 100 --rays 64 --report r.json {options}"));
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(0), "{said}");
        assert!(said.contains("the specular part of material `wall`") && said.contains(what), "{said}");
        here.json("r.json")["energy"]["absorbed"][0].as_f64().unwrap()
    };
    let (diffuse, dropped) = (mean("", "counted as diffuse"), mean("--specular drop", "left out"));
    assert_eq!(diffuse, mean("--specular diffuse", "--specular drop"));
    // The wall absorbs all of its light, or two fifths of it and reflects some of the rest to the floor.
    assert!(diffuse < 0.99 * dropped, "{diffuse} {dropped}");
}

#[test]
fn light_tracing_warns_that_mirrors_are_dark() {
    let here = with_wall("");
    let render = |model: &str| {
        let size = "--width 8 --height 8 --eye 3,1,0 --look-at -1,1,0";
        here.run(&format!("render scene.obj -o a.png --method light --spp 4 {size} --model wall={model}"))
    };
    assert!(stderr(&render("mirror:1")).contains("mirrors are dark"));
    assert!(!stderr(&render("ggx:1,0.3")).contains("mirrors are dark"));
}

/// `validate --lambert` estimates the light that is lost without a mirror. The loss is at least four standard errors.
#[test]
fn validation_reports_the_cost_of_lambertian_surfaces() {
    let here = with_wall("Ks 0.9 0.9 0.9\nillum 3\n");
    let validate = |options: &str| {
        let effort = "--patches 60 --rays 256 --paths 1024 --particles 20000 --report r.json";
        let output = here.run(&format!("validate scene.obj {effort} {options}"));
        assert!(matches!(output.status.code(), Some(0 | 1)), "{}", stderr(&output));
        (String::from_utf8(output.stdout).unwrap(), here.json("r.json"))
    };
    let (said, report) = validate("--lambert --threads 1");
    let lambert = &report["lambert"];
    let figure = |key: &str| lambert[key].as_f64().unwrap();
    assert!(figure("standard_error") > 0.0);
    assert!(figure("largest_relative").abs() > figure("rms_relative"));
    // Without the mirror the floor is darker.
    let dropped = |key: &str| lambert["dropped"][key].as_f64().unwrap();
    assert!(dropped("rms_relative") > 4.0 * dropped("standard_error"), "{lambert}");
    assert!(dropped("mean_relative") > 4.0 * dropped("mean_standard_error"), "{lambert}");
    assert!(said.contains(lambert["verdict"].as_str().unwrap()), "{said}");
    assert!(said.contains("taking gloss as diffuse changes irradiance by"), "{said}");
    let (_, again) = validate("--lambert --threads 2 -o a.ply");
    let mesh = String::from_utf8_lossy(&here.read("a.ply")).into_owned();
    let header = mesh.split("end_header").next().unwrap();
    for property in ["lambert_r", "lambert_b", "lambert_error_g"] {
        assert!(header.contains(&format!("property float {property}\n")), "{header}");
    }
    assert_eq!(report["lambert"], again["lambert"]);
    // Without gloss both solutions have the same bits.
    fs::write(here.path("scene.mtl"), BLACK).unwrap();
    let (said, report) = validate("--lambert");
    assert_eq!(report["lambert"]["rms_relative"], 0.0);
    assert!(said.contains("nothing is lost"), "{said}");
    assert!(validate("").1.get("lambert").is_none());
}
