//! Checks by independent methods.

use std::sync::Arc;

use pyo3::prelude::*;
use radiosity::{
    accuracy::validation::{Validation, ValidationOptions},
    output::validation_report::ValidationReport,
};

use crate::{casting::Casting, run::run, scene::Scene};

/// Validates the solution of a scene, and gives the report as JSON.
#[pyfunction]
pub fn validate(
    py: Python<'_>,
    scene: &Scene,
    casting: Casting,
    paths: Option<u32>,
    particles: Option<u64>,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<String> {
    let data = Arc::clone(&scene.data);
    data.check_lit()?;
    let defaults = ValidationOptions::default();
    let options = defaults
        .with_subdivision(casting.given_subdivision()?.unwrap_or(defaults.subdivision))
        .with_rays(casting.given_rays()?.map_or(defaults.rays, f64::from))
        .with_paths(paths.unwrap_or(defaults.paths))
        .with_particles(particles.unwrap_or(defaults.particles))
        .with_solve(casting.solve_options()?)
        .with_seed(casting.seed);
    run(py, progress, threads, move |progress| {
        let scene = data.lambertian();
        let validation = Validation::of(scene, data.tracer(), &options, progress)?;
        let report = ValidationReport::new(&data.name, scene, &validation);
        let mut text = Vec::new();
        report.write(&mut text).expect("writing to memory works");
        Ok(String::from_utf8(text).expect("JSON is text"))
    })
}
