//! The command `tradeoff`: files that other programs can read, and errors that follow physics.

use std::fs;

use crate::common::program::{Here, stderr};
use serde_json::Value;

/// A closed room whose ceiling emits.
const ROOM: &str = "mtllib scene.mtl\nusemtl wall
v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nv 0 0 1\nv 1 0 1\nv 0 1 1\nv 1 1 1
f 1 2 4 3\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\nusemtl lamp\nf 5 7 8 6\n";
const MATERIALS: &str = "newmtl wall\nKd 0.5 0.5 0.5\nnewmtl lamp\nKd 0 0 0\nKe 1 1 1\n";
const SMALL: &str = "--patches 150 --most-rays 110000";

/// Upper limit for the ratio of a mean square error to its expectation. The errors of the patches of one triangle may
/// be fully correlated, so there are at least 12 independent ones. The mean of 12 squares of normal variables has a
/// relative standard deviation of sqrt(2/12). Four of these are allowed.
const BAND: f64 = 1.0 + 4.0 * 0.408_248;

fn here() -> Here {
    Here::new(ROOM, MATERIALS)
}

fn number(point: &Value, name: &str) -> f64 {
    point[name].as_f64().unwrap_or_else(|| panic!("{name} is {}", point[name]))
}

fn of<'a>(points: &'a [Value], series: &str) -> Vec<&'a Value> {
    points.iter().filter(|p| p["series"] == series).collect()
}

/// The names of the elements of well-formed XML without comments. Panics if tags do not match.
fn elements(xml: &str) -> Vec<&str> {
    let (mut open, mut all) = (Vec::new(), Vec::new());
    for tag in xml.split('<').skip(1) {
        let (tag, text) = tag.split_once('>').expect("a tag ends");
        assert!(!text.contains('>'), "{text}");
        for entity in text.split('&').skip(1).chain(tag.split('&').skip(1)) {
            let known = ["amp;", "lt;", "gt;", "apos;", "quot;"].iter().any(|name| entity.starts_with(name));
            assert!(known, "&{entity}");
        }
        assert_eq!(tag.matches('"').count() % 2, 0, "{tag}");
        let name = tag.split([' ', '/']).find(|word| !word.is_empty()).unwrap();
        if tag.starts_with('/') {
            assert_eq!(open.pop(), Some(name));
        } else {
            all.push(name);
            if !tag.ends_with('/') {
                open.push(name);
            }
        }
    }
    assert!(open.is_empty(), "{open:?} stay open");
    all
}

/// The files hold the same points, errors fall with more rays as physics requires, and all figures except times are the
/// same for any number of threads.
#[test]
fn errors_fall_as_rays_grow_and_files_can_be_read() {
    let here = here();
    // A name with characters of XML markup.
    fs::rename(here.path("scene.obj"), here.path("r&d<1.obj")).unwrap();
    let output = here.run(&format!("tradeoff r&d<1.obj -o deep/out --report r.json {SMALL}"));
    assert_eq!((output.status.code(), stderr(&output)), (Some(0), String::new()));
    assert!(String::from_utf8(output.stdout).unwrap().contains("path tracing"));
    assert!(here.read("r.json") == here.read("deep/out/tradeoff.json"));
    fs::rename(here.path("deep/out"), here.path("out")).unwrap();
    let report = here.json("out/tradeoff.json");
    assert_eq!(report["units"]["irradiance"], "W/m2");
    let points = report["points"].as_array().unwrap();
    let mut files: Vec<_> = fs::read_dir(here.path("out"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    files.sort();
    assert_eq!(files, [".radiosity", "tradeoff.csv", "tradeoff.html", "tradeoff.json", "tradeoff.svg"]);

    // Every number is finite, since JSON has no others. Costs are above zero.
    for p in points {
        assert!(number(p, "error") >= 0.0 && number(p, "seconds") > 0.0 && number(p, "bytes") > 0.0, "{p}");
    }
    check_csv(&String::from_utf8(here.read("out/tradeoff.csv")).unwrap(), points);
    check_svg(&String::from_utf8(here.read("out/tradeoff.svg")).unwrap(), points);
    check_errors(&report, points);
    check_variants(points);

    // Another run with any number of threads replaces the files and gives the same figures except for times.
    let again = here.run(&format!("tradeoff r&d<1.obj -o out --threads 1 --quiet {SMALL}"));
    assert_eq!((again.status.code(), again.stdout.len()), (Some(0), 0));
    let mut files: Vec<_> = fs::read_dir(here.path("out"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    files.sort();
    assert_eq!(files, [".radiosity", "tradeoff.csv", "tradeoff.html", "tradeoff.json", "tradeoff.svg"]);
    let second = here.json("out/tradeoff.json");
    assert_eq!(second["reference"], report["reference"]);
    for (a, b) in points.iter().zip(second["points"].as_array().unwrap()) {
        for name in ["error", "estimated_error", "bytes", "iterations"] {
            assert_eq!(a[name], b[name], "{a}");
        }
    }
}

fn check_csv(csv: &str, points: &[Value]) {
    let mut lines = csv.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let names = lines.next().unwrap();
    assert_eq!(names.len(), points[0].as_object().unwrap().len());
    let rows: Vec<_> = lines.collect();
    assert_eq!(rows.len(), points.len());
    for (row, point) in rows.iter().zip(points) {
        assert_eq!(row.len(), names.len());
        for (name, cell) in names.iter().zip(row) {
            match &point[name] {
                Value::String(text) => assert_eq!(cell, text),
                Value::Null => assert_eq!(*cell, ""),
                Value::Bool(truth) => assert_eq!(*cell, truth.to_string()),
                number => {
                    // A reader of the JSON may round the last digit.
                    let (a, b) = (cell.parse::<f64>().unwrap(), number.as_f64().unwrap());
                    assert!((a - b).abs() <= 2.0 * f64::EPSILON * b.abs(), "{name}: {a} {b}");
                }
            }
        }
    }
}

fn check_svg(svg: &str, points: &[Value]) {
    let all = elements(svg);
    assert_eq!(all[0], "svg");
    assert!(svg.contains("r&amp;d&lt;1.obj") && svg.contains("true error"), "{svg}");
    for unwanted in ["NaN", "inf", "-0.0"] {
        assert!(!svg.contains(unwanted), "{unwanted}");
    }
    // A mark for each point with an error. Crosses are lines.
    let is_cross = |p: &&Value| p["series"] == "estimator";
    let drawn = points.iter().filter(|p| number(p, "error") > 0.0 && !is_cross(p)).count();
    assert!(all.iter().filter(|name| matches!(**name, "circle" | "polygon")).count() >= drawn);
}

/// Checks that the error falls with more rays down to the discretisation error, and that it agrees with the estimate.
fn check_errors(report: &Value, points: &[Value]) {
    let known = number(&report["reference"], "error");
    let rays = of(points, "rays");
    let coarse: Vec<_> = rays.iter().filter(|p| p["patches"] == rays[0]["patches"]).copied().collect();
    let paths = of(points, "path tracing");
    for line in [&coarse, &paths] {
        assert!(line.len() >= 3, "{} points", line.len());
        let (first, last) = (line[0], line[line.len() - 1]);
        let growth = number(last, "rays") / number(first, "rays");
        let floor = number(last, "estimated_discretisation").hypot(known);
        let most = BAND * (number(first, "error").powi(2) / growth + floor.powi(2));
        assert!(number(last, "error").powi(2) <= most, "{first} {last}");
        assert!(most < number(first, "error").powi(2), "the check could not fail: {first} {last}");
    }
    for p in rays.iter().chain(&paths) {
        let (error, most) = (number(p, "error"), number(p, "estimated_error").hypot(known));
        assert!(error * error <= BAND * most * most, "{p}");
        let least = number(p, "estimated_sampling").powi(2) / BAND - known * known;
        assert!(error * error >= least, "{p}");
        assert_eq!(p["believed"], error > known, "{p}");
    }
}

fn check_variants(points: &[Value]) {
    let estimators = of(points, "estimator");
    let names: Vec<_> = estimators.iter().map(|p| p["name"].as_str().unwrap()).collect();
    assert_eq!(
        names,
        ["pooled with rays by variance", "pooled with rays evenly", "pooled without shadow rays", "one way"]
    );
    // Without shadow rays hemisphere rays find the lamp, so no patch stays dark.
    for p in &estimators {
        let (error, estimate) = (number(p, "error"), number(p, "estimated_error"));
        assert!(estimate > 0.0 && error < 1.0, "{p}");
        assert!(error * error <= BAND * estimate * estimate, "{p}");
    }
    // Both ends of a ray contribute to the pooled estimate, so one-way form factors cannot be better.
    assert!(number(estimators[3], "error") > number(estimators[0], "error"));

    let solvers = of(points, "solver");
    let direct = solvers.iter().find(|p| p["solver"] == "direct").unwrap();
    for name in ["cg", "gauss-seidel", "jacobi", "southwell"] {
        let line: Vec<_> = solvers.iter().filter(|p| p["solver"] == name).collect();
        assert!(line.len() >= 4, "{name}");
        assert!(line.windows(2).all(|p| number(p[0], "tolerance") > number(p[1], "tolerance")));
        assert!(line.windows(2).all(|p| number(p[0], "iterations") <= number(p[1], "iterations")));
        // At 1e-10 of the emitted power all solvers have the solution of the dense system, and so the same sampling
        // error.
        let (last, same) = (number(line[line.len() - 1], "error"), number(direct, "error"));
        assert!((last / same - 1.0).abs() < 1e-6, "{name}: {last} {same}");
    }
}

#[test]
fn bad_input_is_reported_and_nothing_is_left() {
    let here = here();
    fs::write(here.path("file"), "precious").unwrap();
    fs::create_dir(here.path("foreign")).unwrap();
    fs::write(here.path("foreign/tradeoff.svg"), "precious").unwrap();
    for arguments in [
        "tradeoff missing.obj -o out",
        "tradeoff scene.obj -o file",
        "tradeoff scene.obj -o file/out",
        "tradeoff scene.obj -o foreign",
        "tradeoff scene.obj -o out --report out/tradeoff.csv",
        "tradeoff scene.obj -o out --patches 0",
        "tradeoff scene.obj -o out --most-rays 0",
        "tradeoff scene.obj",
        // More patches than any machine has memory for.
        "tradeoff scene.obj -o out --patches 4000000000",
    ] {
        let errors = here.fails(arguments, 2);
        assert!(errors.starts_with("error: "), "{errors}");
    }
    assert_eq!(here.read("file"), b"precious");
    assert_eq!(here.read("foreign/tradeoff.svg"), b"precious");

    // The missing equilibrium is found while computing.
    fs::write(
        here.path("scene.mtl"),
        MATERIALS.replace("Kd 0.5 0.5 0.5", "Kd 1 1 1").replace("Kd 0 0 0", "Kd 1 1 1"),
    )
    .unwrap();
    let errors = here.fails(&format!("tradeoff scene.obj -o out {SMALL}"), 2);
    assert!(errors.contains("no equilibrium"), "{errors}");
    // An existing directory stays, without files.
    fs::create_dir(here.path("out")).unwrap();
    here.fails(&format!("tradeoff scene.obj -o out {SMALL}"), 2);
    assert_eq!(fs::read_dir(here.path("out")).unwrap().count(), 0);
    // No emitter.
    fs::write(here.path("scene.mtl"), "newmtl wall\nKd 0.5 0.5 0.5\nnewmtl lamp\n").unwrap();
    assert!(here.fails("tradeoff scene.obj -o out", 2).contains("nothing emits light"));
}
