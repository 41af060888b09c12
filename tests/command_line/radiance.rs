//! Irradiance compared with RADIANCE's own programs.

use std::process::Command;

/// A court and a room under skies of gensky and gendaylit, and a disc of ies2rad, by rtrace. In all five scenes each
/// point agrees within 1 %.
///
///     pip install pyradiance
///     cargo test --test command_line -- --ignored radiance
///
/// `PYTHON` names the Python that has pyradiance; `python3` by default.
#[test]
#[ignore = "needs Python with pyradiance, and a minute"]
fn irradiance_by_the_programs_of_radiance() {
    let python = std::env::var("PYTHON").unwrap_or_else(|_| "python3".into());
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/radiance/compare.py");
    let done = Command::new(python).args([script, env!("CARGO_BIN_EXE_radiosity")]).output().unwrap();
    let (said, errors) = (String::from_utf8_lossy(&done.stdout), String::from_utf8_lossy(&done.stderr));
    assert!(done.status.success(), "{said}{errors}");
    assert_eq!(said.matches("largest difference").count(), 5, "{said}{errors}");
}
