//! From a scene to a picture: patches, form factors and radiosity, then a coloured mesh and a picture. The pixels of
//! the picture look up the radiosity and trace no light.
//!
//!     cargo run --release --example cornell_box -- [SCENE.obj [FOLDER]]

use std::path::PathBuf;

use radiosity::{
    Progress, Result, Scene,
    form_factor::{CastOptions, FormFactors},
    monte_carlo::{Camera, PictureFormat, RenderOptions},
    output::{
        file::OutputFile,
        picture,
        ply::{self, PlyOptions},
    },
    patch::{Patches, Subdivision},
    solve::{SolveOptions, solve},
    trace::Tracer,
};

const SIZE: usize = 512;

fn main() -> Result<()> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let input = arguments
        .next()
        .unwrap_or_else(|| concat!(env!("CARGO_MANIFEST_DIR"), "/meshes/cornell-box.obj").into());
    let folder = arguments.next().unwrap_or_default();

    let scene = Scene::load(&input)?;
    let tracer = Tracer::new(&scene);
    let mut patches = Patches::subdivide(&scene, &Subdivision::Count(20_000));
    let progress = Progress::new();
    let form_factors = FormFactors::cast(&scene, &tracer, &mut patches, &CastOptions::default(), &progress)?;
    let solution = solve(&form_factors, &patches, &SolveOptions::default(), &progress)?;
    println!("{} patches, {} in {} iterations", patches.len(), solution.solver.name(), solution.iterations);
    ply::write(&folder.join("cornell_box.ply"), &scene, &patches, &solution, &PlyOptions::default())?;

    let camera = Camera::frame(&scene, &tracer, SIZE, SIZE)?;
    let options = RenderOptions::default().with_samples(16);
    let film = picture::render(&scene, &tracer, (&patches, &solution), &camera, None, &options, &progress)?;
    OutputFile::new(&folder.join("cornell_box.png"), &[&input])?
        .write(|out| film.encode(out, PictureFormat::Png, film.automatic_exposure()))?
        .commit()?;
    println!("wrote cornell_box.ply and cornell_box.png");
    Ok(())
}
