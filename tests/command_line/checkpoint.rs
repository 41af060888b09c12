//! `solve --checkpoint`, killed and stopped: the result has the bytes of an undisturbed run.

use std::{
    fs,
    os::unix::process::ExitStatusExt,
    process::{Child, Command, Stdio},
};

use crate::common::program::{Here, stderr};
use serde_json::Value;

/// A cube with a lamp, and a plate in it whose back is seen.
pub fn plate() -> Here {
    let obj = "mtllib scene.mtl\nusemtl wall\n\
        v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nv 0 0 1\nv 1 0 1\nv 0 1 1\nv 1 1 1\n\
        v 0.2 0.2 0.4\nv 0.7 0.2 0.5\nv 0.7 0.7 0.5\nv 0.2 0.7 0.4\n\
        v 0.4 0.4 0.95\nv 0.4 0.6 0.95\nv 0.6 0.6 0.95\nv 0.6 0.4 0.95\n\
        f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\nf 9 10 11 12\nusemtl lamp\nf 13 14 15 16\n";
    Here::new(obj, "newmtl wall\nKd 0.5 0.7 0.6\nnewmtl lamp\nKd 0\nKe 5 4 3\n")
}

/// A fixed sequence of random numbers in [0, 1).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = radiosity::trace::sampling::mix(&[self.0]);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

fn start(here: &Here, arguments: &str) -> Child {
    Command::new(env!("CARGO_BIN_EXE_radiosity"))
        .current_dir(here.directory())
        .args(arguments.split_whitespace())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

fn size(here: &Here, name: &str) -> u64 {
    fs::metadata(here.path(name)).map_or(0, |m| m.len())
}

/// Waits until the file has this many bytes. Returns `false` if the program ends before.
fn grows_to(here: &Here, name: &str, bytes: u64, child: &mut Child) -> bool {
    loop {
        if size(here, name) >= bytes {
            return true;
        }
        if child.try_wait().unwrap().is_some() {
            return false;
        }
        std::thread::yield_now();
    }
}

/// The report without times and peak memory, which differ between runs.
pub fn report(here: &Here) -> Value {
    let mut report = here.json("r.json");
    for field in ["seconds", "peak_bytes"] {
        assert!(report.as_object_mut().unwrap().remove(field).is_some());
    }
    for round in report["rounds"].as_array_mut().unwrap() {
        assert!(round.as_object_mut().unwrap().remove("elapsed").is_some());
    }
    report
}

/// Runs with a checkpoint. Kills the run whenever the file has grown to one of the given shares of its final size, and
/// continues with another number of threads. The last run must give the bytes of an undisturbed run. Returns how many
/// kills hit a running program.
fn survive(here: &Here, options: &str, shares: &[f64]) -> u32 {
    let command = format!("solve scene.obj -o out.ply --report r.json --quiet {options}");
    assert_eq!(here.run(&command).status.code(), Some(0), "{options}");
    let truth = (here.read("out.ply"), report(here));
    let command = format!("{command} --checkpoint rays");
    let whole = here.run(&command);
    assert_eq!((whole.status.code(), stderr(&whole)), (Some(0), String::new()), "{options}");
    assert!((here.read("out.ply"), report(here)) == truth, "{options}");
    let all = size(here, "rays");
    ["rays", "out.ply", "r.json"].iter().for_each(|name| fs::remove_file(here.path(name)).unwrap());

    let mut kills = 0;
    for (share, threads) in shares.iter().zip([1, 2, 7, 64, 2].into_iter().cycle()) {
        let mut child = start(here, &format!("{command} --threads {threads}"));
        grows_to(here, "rays", (share * all as f64) as u64 + 1, &mut child);
        child.kill().unwrap();
        kills += u32::from(child.wait().unwrap().signal() == Some(9));
    }
    let output = here.run(&format!("{command} --threads 1"));
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(stderr(&output).lines().all(|l| l.starts_with("warning: rays: removed")), "{}", stderr(&output));
    assert!((here.read("out.ply"), report(here)) == truth, "{options}");
    assert_eq!(size(here, "rays"), all, "{options}: rays are missing, or there twice");
    assert_eq!(here.names(), ["out.ply", "r.json", "rays", "scene.mtl", "scene.obj"]);
    ["rays", "out.ply", "r.json"].iter().for_each(|name| fs::remove_file(here.path(name)).unwrap());
    kills
}

const RUNS: [&str; 4] = [
    "--patches 1000 --rays 256",
    "--patches 1000 --rays 200 --estimator one-way",
    "--error 2 --patches 1000",
    "--error 4",
];

/// Killed at the first bytes and at four random places, runs end with the same bytes.
#[test]
fn killed_again_and_again_it_ends_with_the_same_bytes() {
    let here = plate();
    let mut random = Random(1);
    let mut kills = 0;
    for options in RUNS {
        let mut shares: Vec<f64> = (0..4).map(|_| random.next()).collect();
        shares.sort_by(f64::total_cmp);
        kills += survive(&here, options, &[&[0.0], &shares[..]].concat());
    }
    // A program that ended before it could be killed proves nothing.
    assert!(kills >= 12, "only {kills} kills of 20 met the program at work");
}

/// The count in docs/extremes.md: `cargo test --test command_line checkpoint:: -- --ignored --nocapture`.
#[test]
#[ignore = "minutes"]
fn killed_hundreds_of_times_it_ends_with_the_same_bytes() {
    let here = plate();
    let mut random = Random(2);
    let mut kills = 0;
    for round in 0..12 {
        for options in RUNS {
            let mut shares: Vec<f64> = (0..6).map(|_| random.next()).collect();
            shares.sort_by(f64::total_cmp);
            kills += survive(&here, &format!("{options} --seed {round}"), &shares);
        }
    }
    println!("{kills} kills survived in 48 runs");
    assert!(kills >= 144, "only {kills} kills of 288 met the program at work");
}

/// After a signal to stop, the file stays, a message says how to continue, no ray is lost, and no other file is left.
#[test]
fn a_stopped_run_states_how_to_continue() {
    let here = plate();
    let command = "solve scene.obj -o out.ply --quiet --patches 2000 --rays 512";
    assert_eq!(here.run(command).status.code(), Some(0));
    let truth = here.read("out.ply");
    fs::remove_file(here.path("out.ply")).unwrap();
    let command = format!("{command} --checkpoint rays");
    let mut child = start(&here, &command);
    assert!(grows_to(&here, "rays", 100_000, &mut child));
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130));
    let said = stderr(&output);
    assert_eq!(said, "rays holds the rays cast so far: the same command continues from there\nstopped\n");
    assert_eq!(here.names(), ["rays", "scene.mtl", "scene.obj"]);
    let kept = size(&here, "rays");
    let output = here.run(&command.replace("--quiet", ""));
    assert_eq!(output.status.code(), Some(0));
    assert!(stderr(&output).starts_with("rays: ") && stderr(&output).contains("rays of earlier runs"));
    assert!(here.read("out.ply") == truth && size(&here, "rays") > kept);
}

/// If the file cannot grow any more, the run ends with one error. The contents of the file stay valid, and the next run
/// with room uses them.
#[test]
fn a_full_disk_loses_only_the_rays_that_did_not_fit() {
    let here = plate();
    let command = "solve scene.obj -o out.ply --quiet --patches 1000 --rays 64";
    assert_eq!(here.run(command).status.code(), Some(0));
    let truth = here.read("out.ply");
    fs::remove_file(here.path("out.ply")).unwrap();
    // A limit on the size of files, in units of 512 or 1024 bytes depending on the shell. Its signal, which would kill
    // the program, is ignored.
    let limited = "trap '' XFSZ; ulimit -f 100; exec \"$@\"";
    let output = Command::new("sh")
        .current_dir(here.directory())
        .args(["-c", limited, "sh", env!("CARGO_BIN_EXE_radiosity")])
        .args(command.split_whitespace())
        .args(["--checkpoint", "rays"])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert!(stderr(&output).starts_with("error: rays: ") && stderr(&output).lines().count() == 1);
    assert_eq!(here.names(), ["rays", "scene.mtl", "scene.obj"]);
    assert!(size(&here, "rays") > 30_000 && size(&here, "rays") <= 102_400);
    let output = here.run(&format!("{command} --checkpoint rays"));
    assert_eq!((output.status.code(), stderr(&output)), (Some(0), String::new()));
    assert!(here.read("out.ply") == truth);
}

/// A scene or an output never becomes a checkpoint. Other files stay as they are. A failed run leaves no checkpoint.
#[test]
fn a_checkpoint_replaces_no_other_file() {
    let here = plate();
    fs::write(here.path("notes"), "Notes on many things, longer than the header of a checkpoint is.")
        .unwrap();
    for (options, said) in [
        ("--checkpoint scene.obj", "replace the input"),
        ("--checkpoint ./scene.mtl", "may not have the name"),
        ("--checkpoint room.mtl", "may not have the name"),
        ("-o out.ply --checkpoint out.ply", "the same file"),
        ("--report rays --checkpoint rays", "the same file"),
        ("--checkpoint notes", "error: notes: this file is not a checkpoint"),
        ("--checkpoint nowhere/rays", "nowhere/rays"),
        ("--checkpoint .", "error: ."),
        ("--checkpoint /dev/null", "regular file"),
        ("--checkpoint rays --patches 100000000 --rays 4000000000", "of memory, this machine has"),
    ] {
        let errors = here.fails(&format!("solve scene.obj {options}"), 2);
        assert!(errors.contains(said), "{options}: {errors}");
    }
    assert!(here.read("notes").starts_with(b"Notes"));
    let run = |options: &str| {
        here.run(&format!("solve scene.obj --patches 100 --rays 16 --checkpoint rays {options}"))
    };
    assert_eq!(run("").status.code(), Some(0));
    let bytes = here.read("rays");
    assert!(here.fails("solve scene.obj --checkpoint rays --seed 3", 2).contains("\nhint: use seed 0"));
    fs::write(here.path("scene.mtl"), "newmtl wall\nKd 0.5\nnewmtl lamp\nKe 5\n").unwrap();
    assert!(here.fails("solve scene.obj --checkpoint rays", 2).contains("of another scene\nhint: "));
    assert!(here.read("rays") == bytes);
}
