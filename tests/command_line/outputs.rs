//! Outputs that cannot be written, or would replace an input: one clear error, no loss, and no files left behind.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use crate::common::program::{Here, stderr};

/// The textured mesh of the repository, with the files that it refers to.
fn textured() -> Here {
    let here = Here::new("", "");
    for name in ["textured.obj", "textured.mtl", "checkerboard.png", "gradient.png"] {
        fs::copy(format!("{}/meshes/{name}", env!("CARGO_MANIFEST_DIR")), here.path(name)).unwrap();
    }
    fs::write(here.path("points"), "0.5 0.5 0.5 0 0 1\n").unwrap();
    here
}

const SOLVE: &str = "solve textured.obj --patches 50 --rays 16";
const RENDER: &str = "render textured.obj --spp 1 --width 64 --height 48";
const BAKE: &str = "bake textured.obj --patches 50 --rays 16 --resolution 64";
const PROBE: &str = "probe textured.obj --points points --spp 16";
const VALIDATE: &str = "validate textured.obj --patches 20 --rays 16 --paths 16 --particles 1024";

/// All files of the directory with their bytes.
fn contents(here: &Here) -> Vec<(String, Vec<u8>)> {
    let files = here.names().into_iter().filter(|name| here.path(name).is_file());
    files.map(|name| (name.clone(), here.read(&name))).collect()
}

/// Runs a command that must fail: exit status 2, one line of error with `place` and one of `why`, and no changed file.
fn refused(here: &Here, arguments: &str, place: &str, why: &[&str]) {
    let before = contents(here);
    let errors = here.fails(arguments, 2);
    let line = errors.lines().find(|line| line.starts_with("error: ")).expect(&errors);
    assert_eq!(errors.matches("error: ").count(), 1, "{arguments}: {errors}");
    assert!(line.contains(place) && why.iter().any(|why| line.contains(why)), "{arguments}: {errors}");
    assert!(contents(here) == before, "{arguments}");
}

#[test]
fn no_output_replaces_an_input() {
    let here = textured();
    for (command, inputs) in [
        (SOLVE, &["textured.obj", "textured.mtl", "checkerboard.png", "gradient.png"][..]),
        (RENDER, &["checkerboard.png", "gradient.png"]),
        (PROBE, &["textured.obj", "textured.mtl", "checkerboard.png", "points"]),
    ] {
        for input in inputs {
            let why = ["replace the input", "must end in .ply", "may not have the name"];
            refused(&here, &format!("{command} -o {input}"), input, &why);
        }
    }
    for command in
        [SOLVE, VALIDATE, "inspect textured.obj", &format!("{RENDER} -o out.png"), &format!("{BAKE} -o lit")]
    {
        for input in ["textured.obj", "textured.mtl", "checkerboard.png"] {
            let why = ["replace the input", "may not have the name"];
            refused(&here, &format!("{command} --report {input}"), input, &why);
        }
    }
    // A texture with an unusual name, by another path.
    let mtl = String::from_utf8(here.read("textured.mtl")).unwrap();
    fs::write(here.path("textured.mtl"), mtl.replace("checkerboard.png", "board.json")).unwrap();
    fs::rename(here.path("checkerboard.png"), here.path("board.json")).unwrap();
    fs::create_dir(here.path("sub")).unwrap();
    refused(&here, &format!("{SOLVE} --report sub/../board.json"), "board.json", &["replace the input"]);
    refused(&here, &format!("{SOLVE} --checkpoint board.json"), "board.json", &["replace the input"]);
    fs::hard_link(here.path("board.json"), here.path("sub/link.json")).unwrap();
    std::os::unix::fs::symlink(here.path("textured.obj"), here.path("out.ply")).unwrap();
    refused(&here, &format!("{SOLVE} -o out.ply"), "out.ply", &["replace the input"]);
    // Another name of the same bytes may be replaced: the texture keeps its own.
    let board = here.read("board.json");
    assert_eq!(here.run(&format!("{SOLVE} --report sub/link.json")).status.code(), Some(0));
    assert!(here.read("board.json") == board);
}

/// Names of files may contain line ends. The error is still one line.
#[test]
fn errors_of_odd_names_are_one_line() {
    let here = textured();
    let output = Command::new(env!("CARGO_BIN_EXE_radiosity"))
        .current_dir(here.directory())
        .args(["solve", "textured.obj", "-o", "a\nhint: b.stl"])
        .output()
        .unwrap();
    let errors = stderr(&output);
    let lines: Vec<_> = errors.lines().collect();
    assert!(lines.len() == 2 && lines[0].starts_with("error: a\\nhint: b.stl: "), "{errors}");
    assert!(lines[1].starts_with("hint: the program writes"), "{errors}");
}

#[test]
fn two_outputs_are_two_files() {
    let here = textured();
    for (command, place) in [
        (format!("{SOLVE} -o out.ply --report ./out.ply"), "out.ply"),
        (format!("{RENDER} -o out.exr --report out.exr"), "out.exr"),
        (format!("{PROBE} -o out.txt --report out.txt"), "out.txt"),
    ] {
        refused(&here, &command, place, &["the same file", "may not have the name"]);
    }
}

#[test]
fn places_that_do_not_exist_or_are_directories() {
    let here = textured();
    fs::create_dir(here.path("dir.ply")).unwrap();
    fs::create_dir(here.path("dir.png")).unwrap();
    fs::write(here.path("dir.ply/kept"), "kept").unwrap();
    for (command, place, why) in [
        (format!("{SOLVE} -o nowhere/out.ply"), "nowhere/out.ply", "No such file"),
        (format!("{SOLVE} --report nowhere/r.json"), "nowhere/r.json", "No such file"),
        (format!("{RENDER} -o nowhere/out.png"), "nowhere/out.png", "No such file"),
        (format!("{PROBE} -o nowhere/out.txt"), "nowhere/out.txt", "No such file"),
        (format!("{VALIDATE} --report nowhere/r.json"), "nowhere/r.json", "No such file"),
        (format!("{SOLVE} -o points/out.ply"), "points/out.ply", "ot a directory"),
        (format!("{SOLVE} -o dir.ply"), "dir.ply", "directory"),
        (format!("{RENDER} -o out.png --report nowhere/"), "nowhere/", "the path of a directory"),
        (format!("{SOLVE} -o out.ply --report nowhere/."), "nowhere/.", "the path of a directory"),
        (format!("{RENDER} -o dir.png"), "dir.png", "directory"),
        (format!("{PROBE} -o ."), ".", "directory"),
        (format!("{BAKE} -o points"), "points", "ot a directory"),
        ("tradeoff textured.obj -o points".into(), "points", "not a directory"),
    ] {
        refused(&here, &command, place, &[why]);
    }
    assert_eq!(here.read("dir.ply/kept"), b"kept");
}

/// Directories that nobody can write to, not even root, and one that root can write to.
#[cfg(target_os = "linux")]
#[test]
fn directories_that_cannot_be_written_to() {
    use std::os::unix::fs::PermissionsExt;
    let here = textured();
    refused(
        &here,
        &format!("{SOLVE} -o /proc/self/out.ply"),
        "/proc/self/out.ply",
        &["denied", "not found", "permitted"],
    );
    refused(
        &here,
        &format!("{SOLVE} --report /sys/r.json"),
        "/sys/r.json",
        &["denied", "not found", "permitted", "ead-only"],
    );
    let locked = here.path("locked");
    fs::create_dir(&locked).unwrap();
    fs::set_permissions(&locked, fs::Permissions::from_mode(0o555)).unwrap();
    let is_root = fs::write(locked.join("probe"), "").is_ok();
    if !is_root {
        refused(&here, &format!("{SOLVE} -o locked/out.ply"), "locked/out.ply", &["denied"]);
        refused(&here, &format!("{BAKE} -o locked/lit"), "locked/lit", &["denied"]);
    }
}

/// A device that is always full.
#[cfg(target_os = "linux")]
#[test]
fn a_device_without_room() {
    if !Path::new("/dev/full").exists() {
        return;
    }
    let here = textured();
    for command in [
        format!("{SOLVE} -o /dev/full"),
        format!("{SOLVE} -o out.ply --report /dev/full"),
        format!("{RENDER} -o /dev/full"),
        format!("{RENDER} -o out.png --report /dev/full"),
        format!("{PROBE} -o /dev/full"),
        format!("{BAKE} -o lit --report /dev/full"),
        "inspect textured.obj --report /dev/full".into(),
    ] {
        refused(&here, &command, "/dev/full", &["No space left"]);
    }
    for command in [PROBE, SOLVE, VALIDATE, "inspect textured.obj", &format!("{RENDER} -o out.png")] {
        let full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let output = Command::new(env!("CARGO_BIN_EXE_radiosity"))
            .current_dir(here.directory())
            .args(command.split_whitespace())
            .stdout(full)
            .output()
            .unwrap();
        let errors = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{command}: {errors}");
        assert!(errors.contains("error: stdout: No space left"), "{command}: {errors}");
    }
}

/// Runs with a limit on the size of files, in the shell's units of 512 or 1024 bytes, like on a disk that fills up
/// while writing.
fn limited(here: &Here, units: u32, arguments: &str) -> Output {
    Command::new("sh")
        .current_dir(here.directory())
        .args(["-c", &format!("trap '' XFSZ; ulimit -f {units}; exec \"$@\""), "sh"])
        .arg(env!("CARGO_BIN_EXE_radiosity"))
        .args(arguments.split_whitespace())
        .output()
        .unwrap()
}

#[test]
fn a_disk_that_fills_up_while_writing() {
    let here = textured();
    fs::write(here.path("out.ply"), "old").unwrap();
    let before = contents(&here);
    for (units, command, place) in [
        (4, format!("{SOLVE} -o out.ply --report r.json"), "out.ply"),
        // There is room for the report but not for the mesh, and the other way round.
        (20, format!("{SOLVE} --patches 400 -o out.ply --report r.json"), "out.ply"),
        (4, format!("{RENDER} -o out.exr --report r.json"), "out.exr"),
        (8, format!("{BAKE} -o lit"), "lit"),
    ] {
        let command = command.replace("--patches 50 --rays 16 --patches", "--rays 16 --patches");
        let output = limited(&here, units, &command);
        let errors = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{command}: {errors}");
        let line = errors.lines().find(|line| line.starts_with("error: ")).unwrap();
        assert!(line.contains(place) && line.contains("too large"), "{command}: {errors}");
        assert!(contents(&here) == before && !here.path("lit").exists(), "{command}: {:?}", here.names());
    }
}
