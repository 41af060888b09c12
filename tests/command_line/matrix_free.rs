//! `solve` without a matrix, if memory is too small for one.

use crate::common::program::{Here, stderr};
use ply_rs::{
    parser::Parser,
    ply::{DefaultElement, Property},
};
use radiosity::accuracy::error_bars::T_QUANTILE;
use serde_json::Value;

fn mesh(name: &str) -> String {
    format!("{}/meshes/{name}.obj", env!("CARGO_MANIFEST_DIR"))
}

/// Area, then irradiance, radiosity and error in three channels.
type Face = (f64, [[f64; 3]; 3]);

/// The faces of fronts. Backs come after them, and not every run finds the same ones.
fn fronts(here: &Here, name: &str) -> Vec<Face> {
    let ply = Parser::<DefaultElement>::new().read_ply(&mut &here.read(name)[..]).unwrap();
    let is_front = |face: &&DefaultElement| matches!(face["side"], Property::UChar(0));
    let of = |face: &DefaultElement| {
        let Property::Double(area) = face["area"] else { panic!("no double") };
        let float = |name: String| match face[&name] {
            Property::Float(x) => f64::from(x),
            _ => panic!("no float"),
        };
        let values = ["irradiance", "radiosity", "error"];
        (area, values.map(|quantity| ["r", "g", "b"].map(|c| float(format!("{quantity}_{c}")))))
    };
    ply.payload["face"].iter().filter(is_front).map(of).collect()
}

fn solved(here: &Here, arguments: &str) -> (Value, String) {
    let output = here.run(&format!("solve {arguments} --report r.json"));
    assert_eq!(output.status.code(), Some(0), "{arguments}: {}", stderr(&output));
    (here.json("r.json"), stderr(&output))
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// The matrix would take at least 40 MB (`tests/command_line/memory.rs`), but only 27 MB are allowed. 95 % of the 95 %
/// intervals of the difference between both solutions contain zero. Errors of patches are correlated, so the share of a
/// run scatters by some percent: 90 % is required.
#[test]
fn work_too_large_for_a_matrix_is_solved_without_one_within_its_error_bars() {
    let here = Here::new("", "");
    for name in ["cornell-box", "door-ajar"] {
        let work = format!("{} --patches 8000", mesh(name));
        solved(&here, &format!("{work} --rays 128 -o matrix.ply"));
        let (report, said) = solved(&here, &format!("{work} --rays 64 --memory 27MB -o sweeps.ply"));
        assert!(said.contains("solving without a matrix") && said.lines().count() == 1, "{said}");
        assert!(number(&report["peak_bytes"]) <= 27e6, "{}", report["peak_bytes"]);
        assert_eq!(report["solve"]["solver"], "stochastic-jacobi");
        assert_eq!(
            (&report["form_factors"]["non_zeros"], &report["form_factors"]["bytes"]),
            (&0.into(), &0.into())
        );
        for unknown in ["bias_relative", "discretisation_relative", "solver_relative"] {
            assert!(report["error"][unknown].is_null(), "{unknown}");
        }
        let (truth, found) = (fronts(&here, "matrix.ply"), fronts(&here, "sweeps.ply"));
        assert_eq!(truth.len(), found.len());
        let (mut inside, mut squares, mut mean, mut areas) = (0, 0.0, 0.0, 0.0);
        for ((area, [e, _, error]), (_, [of_matrix, _, its_error])) in found.iter().zip(&truth) {
            for c in 0..3 {
                let error_of_both = error[c].hypot(its_error[c]);
                inside += usize::from((e[c] - of_matrix[c]).abs() <= T_QUANTILE * error_of_both);
                squares += area * error[c].powi(2);
                mean += area * e[c];
                areas += area;
            }
        }
        let share = inside as f64 / (3 * found.len()) as f64;
        println!("{name}: {:.1} % in 95 % intervals", 100.0 * share);
        assert!(share >= 0.9, "{name}: {share}");
        // The file has the larger of a patch's own variance and the variance of its siblings. With 16 batches the
        // larger of the two is 15 % above their mean, and the error 7 %. Backs are not counted here.
        let reported = number(&report["error"]["rms_relative"]);
        let written = (squares / areas).sqrt() / (mean / areas);
        assert!((0.95..1.2).contains(&(written / reported)), "{name}: {written} and {reported}");
        check_energy(&report);
    }
}

/// Asserts that all emitted light is absorbed or escapes, and that the imbalance of the rays is within five standard
/// errors.
fn check_energy(report: &Value) {
    let energy = &report["energy"];
    for c in 0..3 {
        let [emitted, absorbed, escaped] =
            ["emitted", "absorbed", "escaped"].map(|power| number(&energy[power][c]));
        assert!((emitted - absorbed - escaped).abs() <= 1e-12 * emitted);
    }
    let sampled = number(&energy["sampled_imbalance"]);
    assert!(sampled != 0.0 && sampled.abs() <= 5.0 * number(&energy["sampled_imbalance_error"]), "{sampled}");
    assert_eq!(report["solve"]["converged"], true);
}

#[test]
fn sweeps_write_the_same_bytes_for_any_number_of_threads() {
    let here = Here::new("", "");
    let work = format!("{} --patches 500 --error 4 --solver stochastic-jacobi", mesh("cornell-box"));
    let bytes = |threads: u32| {
        let (report, said) = solved(&here, &format!("{work} -o out.ply --threads {threads}"));
        assert!(!said.contains("warning"), "{said}");
        (here.read("out.ply"), report["energy"].clone(), report["solve"].clone())
    };
    let one = bytes(1);
    assert!(one == bytes(2) && one == bytes(3));
}

/// 1,080 patches with 64 rays need 23.5 MB with a matrix, which does not fit into 19 MB. It fits into 25 MB, but the
/// matrix for the number of rays that this error needs does not.
#[test]
fn an_error_is_reached_without_a_matrix() {
    let here = Here::new("", "");
    let work = format!("{} --patches 1000 --error 2", mesh("cornell-box"));
    for (memory, says) in [(19, "solving without a matrix"), (25, "starting again without one")] {
        let (report, said) = solved(&here, &format!("{work} --memory {memory}MB"));
        assert!(said.contains(says), "{said}");
        assert!(number(&report["error"]["rms_relative"]) <= 0.02);
        assert!(number(&report["peak_bytes"]) <= 1e6 * f64::from(memory));
        let rounds: Vec<_> = report["rounds"].as_array().unwrap().iter().collect();
        let rays: Vec<f64> = rounds.iter().map(|round| number(&round["rays_per_patch"])).collect();
        // The run stopped at the first batch that reached the error, not at the next power of two.
        let [.., before, last] = rays[..] else { panic!("{rays:?}") };
        assert!(rays[0] == 64.0 && last > before && last <= 2.0 * before, "{rays:?}");
        let errors = rounds.iter().map(|round| number(&round["rms_relative"]));
        assert!(errors.take(rays.len() - 1).all(|error| error > 0.02));
        check_energy(&report);
    }
}

/// Patches that are small enough for this error do not fit into memory. The discretisation error alone is larger, and
/// the exit status says so.
#[test]
fn an_error_below_the_discretisation_error_is_not_reached() {
    let here = Here::new("", "");
    let work = format!("solve {} --error 0.1 --time 2 --memory 27MB --report r.json", mesh("cornell-box"));
    let output = here.run(&work);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("warning: an error of 0.10 % is out of reach"), "{said}");
    assert!(said.contains("the discretisation error is") && said.contains("target of 0.10 %"), "{said}");
    let error = &here.json("r.json")["error"];
    let [patches, total] = ["discretisation_relative", "total_relative"].map(|e| number(&error[e]));
    assert!(patches > 0.001 && total >= patches, "{patches}, {total}");
}

#[test]
fn options_that_sweeps_lack_are_refused_with_a_way_out() {
    let here = Here::new("", "");
    let scene = mesh("cornell-box");
    for option in ["--checkpoint rays", "--estimator one-way", "--tolerance 1e-3"] {
        let named = option.split(' ').next().unwrap();
        let errors = here.fails(&format!("solve {scene} --solver stochastic-jacobi {option}"), 2);
        assert!(
            errors.contains(named) && errors.contains("has no effect with --solver stochastic-jacobi"),
            "{errors}"
        );
        // Not requested, but necessary.
        let errors =
            here.fails(&format!("solve {scene} --patches 8000 --rays 256 --memory 27MB {option}"), 2);
        assert!(errors.contains("of memory, --memory allows 25.7 MiB"), "{errors}");
        let memory = errors.split_once(&format!("or --solver stochastic-jacobi, without {named}: "));
        let memory = memory.unwrap_or_else(|| panic!("{errors}")).1.trim();
        let work = format!("{scene} --patches 8000 --rays 16 --solver stochastic-jacobi");
        solved(&here, &format!("{work} --memory {memory}"));
    }
    let errors = here.fails(&format!("solve {scene} --patches 8000 --rays 256 --memory 27MB --solver cg"), 2);
    assert!(errors.contains("; or --solver stochastic-jacobi: "), "{errors}");
    let errors = here.fails(&format!("solve {scene} --patches 30000 --rays 256 --memory 27MB"), 2);
    assert!(
        errors.contains("even without a matrix") && errors.contains("of memory, --memory allows"),
        "{errors}"
    );
    assert_eq!(errors.lines().count(), 2, "{errors}");
    let memory = errors.rsplit_once("--memory ").unwrap().1.trim();
    solved(&here, &format!("{scene} --patches 30000 --rays 16 --memory {memory} --quiet"));
}
