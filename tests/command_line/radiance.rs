//! Irradiance compared with RADIANCE's own programs.

use std::process::Command;

/// What the script says with these arguments.
fn compared(arguments: &[&str]) -> String {
    let python = std::env::var("PYTHON").unwrap_or_else(|_| "python3".into());
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/radiance/compare.py");
    let program = env!("CARGO_BIN_EXE_radiosity");
    let done = Command::new(python).args([script, program]).args(arguments).output().unwrap();
    let said = String::from_utf8_lossy(&done.stdout).into_owned();
    assert!(done.status.success(), "{said}{}", String::from_utf8_lossy(&done.stderr));
    said
}

/// A court and a room under skies of gensky and gendaylit, and a disc of ies2rad, by rtrace. In all five scenes each
/// point agrees within 1 %.
///
///     pip install pyradiance numpy
///     cargo test --test command_line -- --ignored radiance
///
/// `PYTHON` names the Python that has pyradiance; `python3` by default.
#[test]
#[ignore = "needs Python with pyradiance, and some minutes"]
fn irradiance_by_the_programs_of_radiance() {
    let said = compared(&[]);
    assert_eq!(said.matches("largest difference").count(), 5, "{said}");
}

/// Every hour of a year in a room with a window, by gendaymtx and rfluxmtx: the mean illuminance of each point within 5 %.
#[test]
#[ignore = "needs Python with pyradiance and numpy, and some minutes"]
fn a_year_of_daylight_by_the_programs_of_radiance() {
    let said = compared(&["--year"]);
    assert!(said.contains("mean of 8760 hours at 25 points"), "{said}");
}
