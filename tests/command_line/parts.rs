//! `solve --cast-only --part`: parts of the rays, cast by separate processes, give the bytes of a single run.

use std::fs;

use super::checkpoint::{plate, report};
use crate::common::program::{Here, stderr};
use serde_json::Value;

const SCENE: &str = "solve scene.obj --patches 1500 --rays 64";

/// The mesh and the report of a solution with these options.
fn solved(here: &Here, options: &str) -> (Vec<u8>, Value) {
    let output = here.run(&format!("{SCENE} --quiet -o out.ply --report r.json {options}"));
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    (here.read("out.ply"), report(here))
}

/// Casts a part, and returns stdout.
fn cast(here: &Here, part: u32, parts: u32, options: &str) -> String {
    let output = here.run(&format!(
        "{SCENE} --cast-only --part {part}/{parts} --checkpoint part-{part} part-* --threads 2 {options}"
    ));
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    String::from_utf8(output.stdout).unwrap()
}

/// The number of rays that no file held, by stderr.
fn added(said: &str) -> f64 {
    let Some((_, rest)) = said.split_once("no file held ") else { return 0.0 };
    rest.split_whitespace().next().unwrap().parse().unwrap()
}

/// The result has the same bytes after any number of rounds, from a pattern and from a list of files. In the end the
/// parts hold all rays, in equal shares.
#[test]
fn parts_have_the_bytes_of_one_run() {
    let here = plate();
    let truth = solved(&here, "");
    let all = truth.1["form_factors"]["rays"].as_u64().unwrap() as f64;
    for parts in [1, 3] {
        let mut rounds = 0;
        loop {
            rounds += 1;
            let said: Vec<String> = (1..=parts).map(|part| cast(&here, part, parts, "")).collect();
            assert!(solved(&here, "--checkpoint part-*") == truth, "{parts} parts, round {rounds}");
            // That run added rays to the first file: it begins anew with only its own.
            if parts > 1 {
                fs::remove_file(here.path("part-1")).unwrap();
                cast(&here, 1, parts, "");
            }
            if said.iter().all(|said| !said.contains("the next rays depend")) {
                break;
            }
            assert!(rounds < 6, "{said:?}");
        }
        assert!(if parts == 1 { rounds == 1 } else { rounds >= 3 }, "{rounds} rounds");
        let names: Vec<String> = (1..=parts).map(|part| format!("part-{part}")).collect();
        let held: Vec<f64> =
            names.iter().map(|name| fs::metadata(here.path(name)).unwrap().len() as f64).collect();
        let mean = held.iter().sum::<f64>() / held.len() as f64;
        assert!(held.iter().all(|held| (held / mean - 1.0).abs() < 0.2), "{held:?}");
        let output =
            here.run(&format!("{SCENE} -o out.ply --report r.json --checkpoint {}", names.join(" ")));
        assert_eq!((here.read("out.ply"), report(&here)), truth);
        // Backs that the last stage finds become patches that no part knew.
        assert!(added(&stderr(&output)) <= 0.01 * all, "{all} rays: {}", stderr(&output));
        names.iter().for_each(|name| fs::remove_file(here.path(name)).unwrap());
    }
}

/// Parts of another estimator and of a scene with lights that are not surfaces.
#[test]
fn all_kinds_of_rays_are_shared_out() {
    let here = plate();
    for options in ["--estimator one-way", "--sun 30,40,100 --sky uniform:5 --ignore lamp"] {
        let truth = solved(&here, options);
        for _ in 0..4 {
            (1..=2).for_each(|part| drop(cast(&here, part, 2, options)));
        }
        let output = here.run(&format!("{SCENE} {options} -o out.ply --report r.json --checkpoint part-*"));
        assert!((here.read("out.ply"), report(&here)) == truth, "{options}");
        let all = truth.1["form_factors"]["rays"].as_u64().unwrap() as f64;
        assert!(added(&stderr(&output)) <= 0.01 * all, "{all} rays: {}", stderr(&output));
        ["part-1", "part-2"].iter().for_each(|name| fs::remove_file(here.path(name)).unwrap());
    }
}

/// Errors name the file. Nothing is written.
#[test]
fn wrong_parts_are_refused_with_their_names() {
    let here = plate();
    (1..=3).for_each(|part| drop(cast(&here, part, 3, "")));
    let whole = here.read("part-2");
    let solve = format!("{SCENE} -o out.ply");
    let check = |command: &str, wanted: &str| {
        let errors = here.fails(command, 2);
        assert!(errors.starts_with(&format!("error: {wanted}")), "{command}: {errors}");
        assert_eq!(errors.lines().count(), 2, "no hint: {errors}");
    };
    let missing = "part-1: this file holds part 1 of 3, and no file holds part 2\n";
    check(&format!("{solve} --checkpoint part-1 part-3"), missing);
    fs::rename(here.path("part-2"), here.path("other-2")).unwrap();
    check(&format!("{solve} --checkpoint part-*"), missing);
    fs::rename(here.path("other-2"), here.path("part-2")).unwrap();
    let other = "part-2: this file holds part 2 of 3, and part 1 of 3 is to be cast\n";
    check(&format!("{SCENE} --cast-only --part 1/3 --checkpoint part-2"), other);
    check(
        &format!("{SCENE} --cast-only --checkpoint part-2"),
        "part-2: this file holds part 2 of 3, and part 1 of 1",
    );
    check(&format!("{solve} --checkpoint nothing-*"), "nothing-*: no file has a name like this\n");
    check(&format!("{SCENE} --seed 4 --checkpoint part-*"), "part-1: the checkpoint is of seed 0\n");
    let reads = "part-2: the output would replace the input part-2";
    check(&format!("{solve} --report part-2 --checkpoint part-*"), reads);
    check(&format!("{solve} room.obj"), "room.obj: the command takes one scene\n");
    for (options, wanted) in [
        ("--part 4/3 --cast-only --checkpoint a", "--part"),
        ("--cast-only --checkpoint a -o out.ply", "-o needs a solution"),
        ("--cast-only --checkpoint a --error 1", "--error needs a solution"),
        ("--cast-only", "--checkpoint"),
        ("--part 1/2 --checkpoint a", "--cast-only"),
    ] {
        assert!(here.fails(&format!("solve scene.obj {options}"), 2).contains(wanted), "{options}");
    }
    // A part of another scene among the others, a damaged part, and one without its last bytes.
    let mtl = here.read("scene.mtl");
    fs::write(here.path("scene.mtl"), "newmtl wall\nKd 0.5\nnewmtl lamp\nKe 5\n").unwrap();
    fs::remove_file(here.path("part-2")).unwrap();
    let of_other = format!("{SCENE} --cast-only --part 2/3 --checkpoint part-2");
    assert_eq!(here.run(&of_other).status.code(), Some(0));
    fs::write(here.path("scene.mtl"), mtl).unwrap();
    check(&format!("{solve} --checkpoint part-*"), "part-2: the checkpoint is of another scene\n");
    let mut damaged = whole.clone();
    damaged[whole.len() / 2] ^= 1;
    fs::write(here.path("part-2"), damaged).unwrap();
    check(&format!("{solve} --checkpoint part-*"), "part-2: the checkpoint is damaged at byte ");
    fs::write(here.path("part-2"), &whole[..whole.len() - 5]).unwrap();
    let (truth, first) = (solved(&here, ""), here.read("part-1"));
    let output = here.run(&format!("{SCENE} -o out.ply --report r.json --checkpoint part-*"));
    let said = stderr(&output);
    assert!(said.starts_with("warning: part-2: ignored the last "), "{said}");
    assert!((here.read("out.ply"), report(&here)) == truth);
    // That run added the missing rays to the first file. Without it, the part's own process casts them again.
    fs::write(here.path("part-1"), first).unwrap();
    cast(&here, 2, 3, "");
    assert!(here.read("part-2").len() >= whole.len());
    // A file that another process is just making.
    fs::write(here.path("part-4"), "").unwrap();
    assert!(solved(&here, "--checkpoint part-*") == truth);
}
