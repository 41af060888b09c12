//! Lights that are no surfaces, and units of light, on the command line.

use std::fs;

use crate::common::program::{Here, stderr};

/// A floor of 2 by 2 in a court, y up, with two lamps.
const COURT: &str = "mtllib scene.mtl\nusemtl floor
v -1 0 -1\nv -1 0 1\nv 1 0 1\nv 1 0 -1\nf 1 2 3 4\nusemtl wall
v -1 0 -1\nv 1 0 -1\nv 1 1 -1\nv -1 1 -1\nf 5 6 7 8\nusemtl lamp
v -0.2 1 -0.2\nv 0.2 1 -0.2\nv 0.2 1 0.2\nv -0.2 1 0.2\nf 9 10 11 12\n";
const MATERIALS: &str =
    "newmtl floor\nKd 0.5 0.5 0.5\nnewmtl wall\nKd 0.7 0.7 0.7\nnewmtl lamp\nKd 0 0 0\nKe 20 20 20\n";

fn run(here: &Here, words: &str) -> String {
    let output = here.run(words);
    assert!(matches!(output.status.code(), Some(0 | 1)), "{words}: {}", stderr(&output));
    String::from_utf8(output.stdout).unwrap()
}

/// Reports, summaries, the header of a mesh and a glTF file name the unit, whichever command wrote them.
#[test]
fn photometric_units_are_named_everywhere() {
    let here = Here::new(COURT, MATERIALS);
    fs::write(here.path("p.txt"), "0 0 0 0 1 0\n").unwrap();
    let light = "--sky overcast:10000 --patches 60";
    for units in ["--units photometric", "--photometric"] {
        let said = run(&here, &format!("solve scene.obj {light} {units} -o a.ply --report r.json"));
        assert!(said.contains(" lm,") && said.contains("lm/m2") && !said.contains("W/m2"), "{said}");
        let report = here.json("r.json");
        assert_eq!(report["scene"]["units"]["irradiance"], "lx");
        assert!(report["scene"]["units"]["lumens_per_watt"].is_null());
        let mesh = String::from_utf8_lossy(&here.read("a.ply")).into_owned();
        let header = mesh.split("end_header").next().unwrap();
        assert!(header.contains("lx") && !header.contains("W/m2"), "{header}");
    }
    let units = "--units photometric";
    let effort = "--paths 64 --particles 4096 --rays 64 --report v.json";
    let said = run(&here, &format!("validate scene.obj {light} {units} {effort}"));
    assert!(said.contains(" lx at ") && !said.contains("W/m2"), "{said}");
    assert_eq!(here.json("v.json")["units"]["power"], "lm");
    let said =
        run(&here, &format!("bake scene.obj {light} {units} -o lit.glb --resolution 64 --report b.json"));
    assert!(!said.contains("W/m2"), "{said}");
    assert_eq!(here.json("b.json")["scene"]["units"]["radiance"], "cd/m2");
    let (lit, _) = crate::common::gltf::taken_apart(&here.read("lit.glb"));
    assert_eq!(lit["extras"]["radiosity"]["unit"], "lx");
    run(&here, &format!("probe scene.obj --sky overcast:10000 {units} --points p.txt --report q.json"));
    assert_eq!(here.json("q.json")["units"]["irradiance"], "lx");
    let said = run(&here, &format!("inspect scene.obj {units} --report i.json"));
    assert!(said.contains("emits 20.0000 cd/m2") && !said.contains("W/"), "{said}");
    assert_eq!(here.json("i.json")["scene"]["units"]["radiance"], "cd/m2");
    let picture = "-o a.png --width 32 --height 24 --spp 4";
    let said = run(&here, &format!("render scene.obj --sky overcast:10000 {units} {picture}"));
    assert!(said.contains(" cd/m2") && !said.contains("W/"), "{said}");

    // Watts by default, and what cannot be both.
    run(&here, &format!("solve scene.obj {light} --units radiometric --report r.json"));
    assert_eq!(here.json("r.json")["scene"]["units"]["lumens_per_watt"], 683.0);
    let said = here.fails("solve scene.obj --units photometric --luminous-efficacy 179", 2);
    assert!(said.contains("--luminous-efficacy has no effect"), "{said}");
    here.fails("solve scene.obj --units radiometric --photometric", 2);
}

/// The light of each lamp and light alone sums to that of all.
#[test]
fn lights_of_a_light_file_are_chosen_by_name() {
    let here = Here::new(COURT, MATERIALS);
    let lights = "[[point]]\nname = \"bulb\"\nposition = [0.3, 0.6, 0.2]\nintensity = 5\n\
        [[directional]]\nname = \"moon\"\ndirection = [0.1, -1, 0.2]\nirradiance = 3\n[sky]\nkind = \"uniform\"\nradiance = 2\n";
    fs::write(here.path("lights.toml"), lights).unwrap();
    fs::write(here.path("p.txt"), "0.1 0 0.3 0 1 0\n-0.6 0 -0.5 0 1 0\n").unwrap();
    let probed = |which: &str| -> Vec<[f64; 2]> {
        let said = run(&here, &format!("probe scene.obj --points p.txt --spp 16384 {which}"));
        let of_line = |line: &str| {
            let numbers: Vec<f64> = line.split_whitespace().map(|word| word.parse().unwrap()).collect();
            [numbers[6], numbers[9]]
        };
        said.lines().map(of_line).collect()
    };
    let whole = probed("");
    let parts = ["lamp", "bulb", "moon", "sky"].map(|name| probed(&format!("--emitters {name}")));
    for (k, [all, error]) in whole.iter().enumerate() {
        let sum: f64 = parts.iter().map(|part| part[k][0]).sum();
        let square: f64 = parts.iter().map(|part| part[k][1].powi(2)).sum();
        let error = error.hypot(square.sqrt());
        assert!(
            (sum - all).abs() < 4.0 * error + 1e-6 * all && error < 0.02 * all,
            "{sum} for {all} ± {error}"
        );
        assert!(parts.iter().all(|part| part[k][0] > 0.0));
    }
    let said = here.fails("probe scene.obj --points p.txt --emitters mood", 2);
    assert!(said.contains("mood") && said.contains("bulb"), "{said}");
}

/// `bake --per-light` writes one map for each emitter. They sum to the whole map in every texel, up to single precision.
/// Each has as much light as a bake of this emitter alone, which casts other rays: the fluxes agree within 3 %.
#[test]
fn maps_of_single_lights_sum_to_the_whole() {
    let here = Here::new(COURT, MATERIALS);
    let lights = "[[point]]\nname = \"bulb\"\nposition = [0.3, 0.6, 0.2]\nintensity = 5\n\
        [[directional]]\nname = \"moon\"\ndirection = [0.1, -1, 0.2]\nirradiance = 3\n[sky]\nkind = \"uniform\"\nradiance = 2\n";
    fs::write(here.path("lights.toml"), lights).unwrap();
    let map = |folder: &str, name: &str| -> Vec<f32> {
        let map = image::open(here.path(folder).join(name)).unwrap().into_rgb32f();
        map.pixels().flat_map(|pixel| pixel.0).collect()
    };
    let flux = |map: &[f32]| map.iter().copied().map(f64::from).sum::<f64>();
    for options in ["", "--final-gather 0 --constant-light"] {
        let options = format!("--resolution 32 --quality draft {options}");
        run(&here, &format!("bake scene.obj -o maps --per-light {options}"));
        let whole = map("maps", "lightmap.exr");
        let names = ["lamp", "bulb", "moon", "sky"];
        let parts = names.map(|name| map("maps", &format!("lightmap-{name}.exr")));
        for (at, whole) in whole.iter().enumerate() {
            let sum: f64 = parts.iter().map(|part| f64::from(part[at])).sum();
            assert!((sum - f64::from(*whole)).abs() <= 1e-6 * f64::from(*whole), "{at}: {sum} for {whole}");
        }
        for (name, part) in names.iter().zip(&parts) {
            run(&here, &format!("bake scene.obj -o alone-{name} --emitters {name} {options}"));
            let alone = flux(&map(&format!("alone-{name}"), "lightmap.exr"));
            let ratio = flux(part) / alone;
            println!("{options}: {name} {ratio:.4}");
            assert!((ratio - 1.0).abs() < 0.03, "{name}: {ratio}");
        }
    }
}

/// The ledger without a matrix has the line of the outside: the power that enters agrees with the solution with a matrix
/// within the standard errors of both, and everything balances.
#[test]
fn light_enters_without_a_matrix() {
    let here = Here::new(COURT, MATERIALS);
    let work = "solve scene.obj --sky uniform:3 --sun 30,50,20 --patches 200 --report r.json";
    let powers = |words: &str| {
        let said = run(&here, &format!("{work} {words}"));
        assert!(said.contains(" entered "), "{said}");
        let energy = here.json("r.json")["energy"].clone();
        ["emitted", "entered", "entered_standard_error", "absorbed", "escaped"]
            .map(|name| energy[name][0].as_f64().unwrap_or_else(|| panic!("{name}: {energy}")))
    };
    let [emitted, entered, error, absorbed, escaped] = powers("--solver stochastic-jacobi");
    assert!((emitted + entered - absorbed - escaped).abs() < 1e-9 * (emitted + entered));
    let [_, by_matrix, its_error, ..] = powers("");
    assert!((entered - by_matrix).abs() < 4.0 * error.hypot(its_error), "{entered} {by_matrix}");
    assert!(error > 0.0 && error < 0.01 * entered, "{error}");
}

/// The sun of an all-weather sky shines by itself, so another sun that shines is an error, wherever it is given.
#[test]
fn a_sun_is_not_counted_twice() {
    let here = Here::new(COURT, MATERIALS);
    let work = "solve scene.obj --sky perez:700,120";
    fs::write(here.path("sun.toml"), "[[sun]]\nazimuth = 10\naltitude = 40\nirradiance = 5\n").unwrap();
    for sun in ["--sun 10,40,5", "--lights sun.toml"] {
        let errors = here.fails(&format!("{work} {sun}"), 2);
        assert!(errors.contains("must not have an irradiance"), "{errors}");
    }
    let errors = here.fails("solve scene.obj --sun 10,40", 2);
    assert!(errors.contains("the position of the sun has no effect"), "{errors}");
}
