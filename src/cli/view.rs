//! `radiosity view`: solves a scene and opens its page in a browser.

use std::{
    path::Path,
    process::{Command, Stdio},
};

use clap::Args;
use radiosity::{Error, Result};

use super::{
    Outcome, page,
    solve::{self, SolveArgs},
    to_stderr,
};

/// Solve a scene and open it in the browser, to walk through and to read
#[derive(Args)]
pub struct ViewArgs {
    #[command(flatten)]
    solve: SolveArgs,
}

/// Runs the command. Without `--page` the page goes into a new directory for temporary files, where it stays, because the browser reads
/// it after this program has ended.
pub fn run(mut args: ViewArgs) -> Result<Outcome> {
    let temporary = match args.solve.page.page {
        Some(_) => None,
        None => {
            let directory = tempfile::Builder::new()
                .prefix("radiosity-")
                .tempdir()
                .map_err(|e| Error::io(&std::env::temp_dir(), e))?;
            let name = format!("{}.html", page::title(&args.solve.scene.path));
            args.solve.page.page = Some(directory.path().join(name));
            Some(directory)
        }
    };
    let outcome = solve::run(&args.solve)?;
    // A temporary directory without a page is removed by now, and with one it is kept.
    let _ = temporary.map(tempfile::TempDir::keep);
    let page = args.solve.page.page.as_deref().expect("it was set");
    if !open(page) {
        to_stderr(format_args!("no browser was found: open {} in one", page.display()));
    }
    Ok(outcome)
}

/// Shows a file with the program that the environment variable BROWSER names, or else the usual one of the system. Whether one started.
fn open(path: &Path) -> bool {
    let usual: &[&str] = match std::env::consts::OS {
        "macos" => &["open"],
        "windows" => &["cmd", "/C", "start", ""],
        _ => &["xdg-open"],
    };
    let named = std::env::var_os("BROWSER").filter(|name| !name.is_empty());
    let (program, arguments) = match &named {
        Some(name) => (name.as_os_str(), &[][..]),
        None => (usual[0].as_ref(), &usual[1..]),
    };
    let mut command = Command::new(program);
    command.args(arguments).arg(path).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    command.spawn().is_ok()
}
