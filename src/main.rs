//! The command line of the `radiosity` library.

#![forbid(unsafe_code)]

use std::process::ExitCode;

fn main() -> ExitCode {
    ExitCode::from(radiosity::cli::run(std::env::args_os()))
}
