//! Python bindings of `radiosity`: arrays in, arrays out.
//!
//! The package in `package/radiosity` brings what users give into one form and says in their words what is wrong. Here are the
//! calls of the library alone, a file for each group of functions.

mod arrays;
mod casting;
mod error;
mod form_factors;
mod lightmap;
mod monte_carlo;
mod run;
mod scene;
mod solution;
mod validation;
mod view_factors;

use std::ffi::OsString;

use pyo3::prelude::*;

/// Runs the command-line program and returns its exit status.
#[pyfunction]
fn command_line(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| radiosity::cli::run(arguments))
}

#[pymodule(gil_used = false)]
mod _radiosity {
    #[pymodule_export]
    use super::{
        command_line,
        form_factors::{FormFactors, form_factors},
        lightmap::{Lightmap, bake},
        monte_carlo::{probe, render, to_srgb},
        scene::Scene,
        solution::{Solution, solve},
        validation::validate,
        view_factors::{ViewFactors, view_factors},
    };
    #[allow(non_upper_case_globals)]
    #[pymodule_export]
    const __version__: &str = env!("CARGO_PKG_VERSION");
}
