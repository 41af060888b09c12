//! The whole way from a scene to a picture: patches, form factors, radiosity; then a coloured mesh, and a picture whose
//! pixels look the radiosity up instead of following light.
//!
//!     cargo run --release --example cornell_box -- [SCENE.obj [FOLDER]]

use std::path::PathBuf;

use glam::Vec3A;
use radiosity::{
    Progress, Result, Scene,
    form_factor::{CastOptions, FormFactors},
    monte_carlo::{Camera, Exposure, Film},
    output::{
        ply::{self, PlyOptions},
        vertex_colors::at_vertices,
        vertices::{CREASE, PatchMesh},
    },
    patch::{Patches, Subdivision},
    solve::{SolveOptions, solve},
    trace::Tracer,
};
use rayon::prelude::*;

const SIZE: usize = 512;
/// Rays along each side of a pixel.
const GRID: usize = 3;

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

    // Radiosity is constant on a patch; between values at the corners it looks as smooth as the light is.
    let mesh = PatchMesh::new(&scene, &patches, CREASE);
    let corners = at_vertices(&scene, &patches, &mesh, &solution.radiosity);
    let channels = patches.channels();
    let radiance = |origin: Vec3A, direction: Vec3A| -> [f64; 3] {
        let Some(hit) = tracer.closest(origin, direction) else { return [0.0; 3] };
        // A back that no light reached is no patch.
        let Some(patch) = patches.at(hit.triangle, hit.barycentric, hit.front) else { return [0.0; 3] };
        let part = patches.corners(patch as usize);
        let vertices = mesh.corners(patch as usize);
        // A patch is its triangle scaled: so are barycentric coordinates.
        let scale = part[0][0] - part[1][0];
        let weights: [f64; 3] = std::array::from_fn(|k| {
            let centre = (part[0][k] + part[1][k] + part[2][k]) / 3.0;
            (f64::from(hit.barycentric[k]) - centre) / scale + 1.0 / 3.0
        });
        std::array::from_fn(|c| {
            let at = |k: usize| corners[vertices[k] as usize * channels + c.min(channels - 1)];
            // Rounding may carry a point a hair beyond its patch, and light below zero.
            ((0..3).map(|k| weights[k] * at(k)).sum::<f64>() / std::f64::consts::PI).max(0.0)
        })
    };

    let camera = Camera::frame(&scene, &tracer, SIZE, SIZE)?;
    let lens = camera.lens(&tracer);
    let pixel = |i: usize| {
        let mut sum = [0.0; 3];
        for k in 0..GRID * GRID {
            let within = |k: usize| (k as f64 + 0.5) / GRID as f64;
            let (x, y) = ((i % SIZE) as f64 + within(k % GRID), (i / SIZE) as f64 + within(k / GRID));
            let sample = radiance(lens.eye(), lens.direction(x, y));
            (0..3).for_each(|c| sum[c] += sample[c] / (GRID * GRID) as f64);
        }
        sum.map(|x| x as f32)
    };
    let pixels = (0..SIZE * SIZE).into_par_iter().map(pixel).collect();
    Film::from_pixels(SIZE, SIZE, pixels).save(&folder.join("cornell_box.png"), Exposure::default())?;
    println!("wrote cornell_box.ply and cornell_box.png");
    Ok(())
}
