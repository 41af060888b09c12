//! Renders a scene from its lightmap alone, and by path tracing. Prints the difference between the lightmap and path
//! tracing at random points of the surface, for several numbers of rays.
//!
//!     cargo run --release --example lightmap -- [FOLDER [SCENE.obj]]
//!
//! Writes `lightmap.png` and `lightmap-paths.png`; without a folder into `docs/images`.

use std::{path::PathBuf, time::Instant};

use glam::dvec3;
use radiosity::{
    Progress, Quality, Result, Scene,
    form_factor::{CastOptions, FormFactors},
    lightmap::{Atlas, BakeOptions, Coordinates, Layout, Lightmap, bake},
    monte_carlo::{Camera, Effort, Film, PathOptions, PathTracer, PictureFormat, Receiver, RenderOptions},
    output::file::OutputFile,
    patch::{Patches, Subdivision},
    solve::{SolveOptions, solve},
    trace::{
        Tracer,
        sampling::{mix, sobol_4d, square_to_triangle},
    },
};

const TEXELS: usize = 512;
const PIXELS: usize = 320;
const POINTS: u32 = 2000;
const PATHS: u32 = 2048;

fn main() -> Result<()> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    let folder = arguments.next().unwrap_or_else(|| root.join("docs/images"));
    let given = arguments.next();
    let input = given.clone().unwrap_or_else(|| root.join("meshes/cornell-box.obj"));

    let scene = Scene::load(&input)?;
    let progress = Progress::new();
    let start = Instant::now();
    let tracer = Tracer::new(&scene);
    let mut patches = Patches::subdivide(&scene, &Subdivision::Count(Quality::MEDIUM.patches));
    let cast = CastOptions::default().with_rays(Quality::MEDIUM.rays.into());
    let form_factors = FormFactors::cast(&scene, &tracer, &mut patches, &cast, &progress)?;
    let solution = solve(&form_factors, &patches, &SolveOptions::default(), &progress)?;
    println!("solution: {} patches, {:.2} s", patches.len(), start.elapsed().as_secs_f64());

    let truth = Truth::new(&scene, &tracer, &progress)?;
    println!("rays per texel  seconds  RMS %  from the median %  bias %  standard error of bias %");
    let mut best = None;
    for final_gather in [0, 4, 8, 16, 32, 64] {
        let start = Instant::now();
        let atlas = Atlas::new(&scene, &tracer, Layout::Resolution(TEXELS), Coordinates::Auto)?;
        let options = BakeOptions::default().with_final_gather(final_gather);
        let map = bake(&scene, &tracer, (&patches, &solution), atlas, &options, &progress)?;
        let seconds = start.elapsed().as_secs_f64();
        let [rms, typical, bias, error] = truth.compare(&map).map(|x| 100.0 * x);
        println!("{final_gather:14}  {seconds:7.2}  {rms:5.2}  {typical:17.2}  {bias:+6.3}  {error:6.3}");
        best = Some(map);
    }
    let map = best.expect("maps were made");

    let camera = match given {
        // The camera of the data; https://www.graphics.cornell.edu/online/box/data.html
        None => Camera::new(
            dvec3(278.0, 273.0, -800.0),
            dvec3(278.0, 273.0, 0.0),
            dvec3(0.0, 1.0, 0.0),
            39.3,
            PIXELS,
            PIXELS,
        )?,
        Some(_) => Camera::frame(&scene, &tracer, PIXELS, PIXELS)?,
    };
    let lens = camera.lens(&tracer);
    let options = RenderOptions::default().with_samples(16);
    let by_map = Film::sample(&lens, &options, &progress, |direction, _| {
        tracer.closest(lens.eye(), direction).map_or([0.0; 3], |hit| map.radiance(&scene, &hit))
    })?;
    let paths = PathTracer::new(&scene, &tracer, PathOptions::default());
    let options = RenderOptions::default().with_samples(1024);
    let by_paths = Film::render(&paths, &camera, &options, &progress)?;
    let exposure = by_paths.automatic_exposure();
    for (film, name) in [(by_map, "lightmap.png"), (by_paths, "lightmap-paths.png")] {
        OutputFile::new(&folder.join(name), &[&input])?
            .write(|out| film.encode(out, PictureFormat::Png, exposure))?
            .commit()?;
    }
    println!("wrote lightmap.png and lightmap-paths.png to {}", folder.display());
    Ok(())
}

/// Path-traced irradiance at random points of the fronts.
struct Truth {
    /// Triangle, barycentric coordinates, green irradiance and its standard error.
    points: Vec<(usize, [f64; 3], f64, f64)>,
}

impl Truth {
    fn new(scene: &Scene, tracer: &Tracer, progress: &Progress) -> Result<Truth> {
        let mut ends = Vec::new();
        let mut total = 0.0;
        for t in 0..scene.triangles.len() {
            total += scene.area(t);
            ends.push(total);
        }
        let places: Vec<(usize, [f64; 3])> = (0..POINTS)
            .map(|i| {
                let [x, y, z, _] = sobol_4d(i, mix(&[1])).map(f64::from);
                let t = ends.partition_point(|&end| end <= x * total).min(ends.len() - 1);
                (t, square_to_triangle(y as f32, z as f32).map(f64::from))
            })
            .collect();
        let receivers: Vec<Receiver> =
            places.iter().map(|&(t, at)| Receiver::on_triangle(tracer, t, at, true)).collect();
        let paths = PathTracer::new(scene, tracer, PathOptions::default());
        let effort = Effort::default().with_samples(PATHS);
        let found = paths.irradiances(&receivers, &effort, progress)?;
        let points = places
            .iter()
            .zip(found)
            .map(|(&(t, at), e)| (t, at, e.mean[1], e.standard_error[1]))
            // No light arrives inside solids. Maps have values of neighbours there.
            .filter(|point| point.2 > 0.0)
            .collect();
        Ok(Truth { points })
    }

    /// Returns, relative to the mean: the root mean square difference without the noise of the paths; the median of the
    /// absolute differences, noise included, scaled to the standard deviation of a normal distribution; the mean
    /// difference and its standard error.
    fn compare(&self, map: &Lightmap) -> [f64; 4] {
        let n = self.points.len() as f64;
        let mean = self.points.iter().map(|p| p.2).sum::<f64>() / n;
        let mut differences: Vec<f64> =
            self.points.iter().filter_map(|&(t, at, e, _)| Some(map.at(t, at)?[1] - e)).collect();
        let squares: f64 = differences.iter().map(|d| d * d).sum();
        let noise: f64 = self.points.iter().map(|p| p.3 * p.3).sum();
        let bias = differences.iter().sum::<f64>() / n;
        differences.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
        let median = differences[differences.len() / 2].abs() / 0.6745;
        [
            ((squares - noise).max(0.0) / n).sqrt() / mean,
            median / mean,
            bias / mean,
            (squares.sqrt() / n) / mean,
        ]
    }
}
