//! Reads a mesh and writes it with its light as vertex colours, in a PLY file for any viewer.
//!
//!     cargo run --release --example vertex_colors -- [SCENE.obj [OUT.ply]]

use std::path::PathBuf;

use radiosity::{
    Progress, Quality, Result, Scene,
    accuracy::error_bars::ErrorBars,
    form_factor::{CastOptions, FormFactors},
    output::{
        exposure,
        ply::{self, PlyOptions},
    },
    patch::{Patches, Subdivision},
    solve::{SolveOptions, solve},
    trace::Tracer,
};

fn main() -> Result<()> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let input = arguments
        .next()
        .unwrap_or_else(|| concat!(env!("CARGO_MANIFEST_DIR"), "/meshes/door-ajar.obj").into());
    let output = arguments.next().unwrap_or_else(|| "vertex_colors.ply".into());

    let scene = Scene::load(&input)?;
    for warning in &scene.warnings {
        eprintln!("warning: {warning}");
    }
    let quality = Quality::MEDIUM;
    let tracer = Tracer::new(&scene);
    let mut patches = Patches::subdivide(&scene, &Subdivision::Count(quality.patches));
    let options = CastOptions::default().with_rays(quality.rays.into());
    let progress = Progress::new();
    let form_factors = FormFactors::cast(&scene, &tracer, &mut patches, &options, &progress)?;
    let solution = solve(&form_factors, &patches, &SolveOptions::default(), &progress)?;

    // The file holds the standard error of every patch.
    let errors = ErrorBars::of(&form_factors, &patches, &solution).map(|bars| bars.standard_error);
    let exposure = exposure::of_radiosity(&patches, &solution.radiosity);
    let options = PlyOptions::default().with_standard_errors(errors.as_deref()).with_exposure(Some(exposure));
    ply::write(&output, &scene, &patches, &solution, &options)?;

    println!("{} triangles, {} patches: {}", scene.triangles.len(), patches.len(), output.display());
    println!("white is a radiosity of {:.3} W/m2", 1.0 / exposure.scale);
    Ok(())
}
