//! Forecasts of memory, and refusals of work that needs too much.

use std::{fs, path::Path};

use crate::common::program::{Here, stderr};
use radiosity::{
    Scene,
    accuracy::memory::{Memory, without_matrix},
    form_factor::Estimator,
    solve::Solver,
};

fn mesh(name: &str) -> String {
    format!("{}/meshes/{name}.obj", env!("CARGO_MANIFEST_DIR"))
}

/// The memory forecast for the solution of a scene, and the memory that it took.
fn forecast_and_peak(
    here: &Here,
    file: &str,
    (patches, rays): (u32, u32),
    estimator: Estimator,
    solver: Solver,
) -> (f64, f64) {
    let way = if estimator == Estimator::Pooled { "pooled" } else { "one-way" };
    let how = format!("--estimator {way} --solver {} --tolerance 1e-2", solver.name());
    let work = format!("{file} --patches {patches} --rays {rays} {how}");
    let output = here.run(&format!("solve {work} -o out.ply --report r.json --quiet"));
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let report = here.json("r.json");
    let name = Path::new(file).file_stem().unwrap().to_str().unwrap();
    let scene = Scene::load(here.path(file)).unwrap();
    let made = report["scene"]["patches"].as_f64().unwrap();
    let peak = report["peak_bytes"].as_f64().unwrap();
    let forecast = Memory::of(&scene, made, rays.into(), estimator, solver).peak();
    println!(
        "| {name} | {made} | {rays} | {way}, {} | {:.0} MB | {:.0} MB | {:.2} |",
        solver.name(),
        forecast / 1e6,
        peak / 1e6,
        forecast / peak
    );
    (forecast, peak)
}

/// Asserts that the memory is at most the forecast, and at least a third of it, because several rays can share an entry
/// of the matrix.
fn check(cases: &[(u32, u32)], names: &[&str]) {
    let here = Here::new("", "");
    for name in names {
        for &case in cases {
            for estimator in [Estimator::Pooled, Estimator::OneWay] {
                let (forecast, peak) = forecast_and_peak(&here, &mesh(name), case, estimator, Solver::Auto);
                assert!(peak <= forecast && forecast <= 3.0 * peak, "{name}, {case:?}");
            }
        }
    }
}

/// A solution takes at most the memory that was forecast.
#[test]
fn memory_is_at_most_the_forecast() {
    check(&[(8000, 64)], &["cornell-box", "furnace"]);
}

/// Solvers that need more memory than the stored matrix, and white walls, which need a search for trapped light.
#[test]
fn solvers_take_at_most_the_forecast() {
    let here = Here::new("", "");
    for name in ["textured.obj", "textured.mtl", "checkerboard.png", "gradient.png"] {
        fs::copy(mesh("").replace(".obj", name), here.path(name)).unwrap();
    }
    let grey = fs::read_to_string(here.path("textured.mtl")).unwrap();
    let white = grey.replace("Kd 0.7 0.7 0.7", "Kd 1 1 1");
    assert_ne!(grey, white);
    fs::write(here.path("textured.mtl"), white).unwrap();
    for (solver, estimator, case) in [
        (Solver::ConjugateGradient, Estimator::Pooled, (2000, 256)),
        (Solver::GaussSeidel, Estimator::Pooled, (2000, 256)),
        (Solver::GaussSeidel, Estimator::OneWay, (2000, 256)),
        (Solver::Southwell, Estimator::Pooled, (2000, 256)),
        (Solver::Southwell, Estimator::OneWay, (2000, 256)),
        (Solver::Direct, Estimator::Pooled, (700, 256)),
        (Solver::Direct, Estimator::OneWay, (700, 256)),
    ] {
        let (forecast, peak) = forecast_and_peak(&here, "textured.obj", case, estimator, solver);
        assert!(
            peak <= forecast && forecast <= 3.0 * peak,
            "{solver:?}, {estimator:?}: {peak} of {forecast}"
        );
    }
}

/// Without a matrix memory is at most the forecast, for any number of rays.
#[test]
fn sweeps_take_at_most_the_forecast() {
    let here = Here::new("", "");
    for (name, patches, rays) in [("cornell-box", 1000, 64), ("furnace", 20000, 16), ("textured", 8000, 16)] {
        let file = mesh(name);
        let work = format!("{file} --patches {patches} --rays {rays} --solver stochastic-jacobi");
        let output = here.run(&format!("solve {work} -o out.ply --report r.json --quiet"));
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let report = here.json("r.json");
        let made = report["scene"]["patches"].as_f64().unwrap();
        let peak = report["peak_bytes"].as_f64().unwrap();
        let forecast = without_matrix(&Scene::load(file).unwrap(), made);
        println!("| {name} | {made} | {rays} | sweeps | {:.0} MB | {:.0} MB |", forecast / 1e6, peak / 1e6);
        assert!(peak <= forecast && forecast <= 2.0 * peak, "{name}, {made} patches: {peak} of {forecast}");
    }
}

/// The table in docs/extremes.md: `cargo test --test command_line memory:: -- --ignored --nocapture`.
#[test]
#[ignore = "minutes, and a gigabyte"]
fn memory_is_at_most_the_forecast_on_many_scenes() {
    let cases = [(1000, 64), (8000, 64), (8000, 256), (2000, 1024), (32000, 128), (100_000, 64)];
    check(&cases, &["cornell-box", "door-ajar", "furnace", "textured"]);
}

/// Every command that solves refuses too large work at once, and works with each option of the hint.
#[test]
fn work_beyond_the_memory_is_refused_with_a_way_out() {
    let here = Here::new("", "");
    let file = mesh("cornell-box");
    for (command, size) in [
        ("solve SCENE -o out.ply --patches 30000 --rays 256", "30MB"),
        ("solve SCENE -o out.ply --patches 30000 --rays 256 --solver cg", "100MB"),
        ("solve SCENE --patches 2000 --rays 2000 --estimator one-way", "40MB"),
        ("solve SCENE --error 5 --patches 30000", "30MB"),
        ("bake SCENE -o lit --quality high", "0.1GiB"),
        ("render SCENE -o out.png --method radiosity --quality high", "100M"),
        ("probe SCENE --points points --method radiosity --quality high", "100M"),
        ("validate SCENE --patches 30000", "200M"),
        ("tradeoff SCENE -o dir --patches 20000", "300M"),
    ] {
        fs::write(here.path("points"), "0 0 0 0 0 1\n").unwrap();
        let command = command.replace("SCENE", &file);
        let errors = here.fails(&format!("{command} --memory {size}"), 2);
        assert!(errors.contains("of memory, --memory allows") && errors.contains("\nhint: "), "{errors}");
        assert_eq!(errors.lines().count(), 2, "{errors}");
    }
    let command = format!("solve {file} -o out.ply --quiet --memory 40MB --solver cg");
    let errors = here.fails(&format!("{command} --patches 4000 --rays 256"), 2);
    let hint = errors.split_once("hint: use ").unwrap().1.trim();
    let (hint, _) = hint.split_once("; ").unwrap();
    let ways: Vec<&str> = hint.split(", or ").collect();
    assert_eq!(ways.len(), 3, "{hint}");
    let fewer = here.run(&format!("{command} --rays 256 {}", ways[0]));
    assert_eq!(fewer.status.code(), Some(0), "{}", stderr(&fewer));
    let thinner = here.run(&format!("{command} --patches 4000 {}", ways[1]));
    assert_eq!(thinner.status.code(), Some(0), "{}", stderr(&thinner));
    let more = command.replace("--memory 40MB", ways[2]) + " --patches 4000 --rays 256";
    assert_eq!(here.run(&more).status.code(), Some(0));

    // Pictures and maps have sizes of their own.
    for (command, said) in [
        ("render SCENE -o out.png --width 3000 --height 3000 --memory 100MB", "hint: give a smaller --width"),
        ("bake SCENE -o lit --quality draft --resolution 2048 --memory 200MB", "hint: give a longer --texel"),
    ] {
        let errors = here.fails(&command.replace("SCENE", &file), 2);
        assert!(errors.contains(said), "{errors}");
    }
    let inspected = here.run(&format!("inspect {file} --memory 200MB"));
    let table = String::from_utf8(inspected.stdout).unwrap();
    assert_eq!(table.matches("more than allowed").count(), 2, "{table}");
    assert!(here.fails(&format!("solve {file} --memory lots"), 2).contains("a size like 500MB or 4GiB"));
}

/// The limit applies to sampling too. If an option needs a matrix, sampling ends with a message when memory is full.
#[test]
fn sampling_in_rounds_ends_when_memory_is_full() {
    let here = Here::new("", "");
    let file = mesh("cornell-box");
    let command =
        format!("solve {file} --patches 1000 --error 0.1 --solver cg --report r.json --memory 40MB");
    let output = here.run(&command);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(stderr(&output).contains("out of reach of memory"), "{}", stderr(&output));
    let peak = here.json("r.json")["peak_bytes"].as_f64().unwrap();
    assert!(peak <= 40e6, "{peak}");
}
