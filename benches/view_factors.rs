//! View factors of a closed room with 20 boxes, of 504 and 2016 quadrilaterals: `cargo bench --bench view_factors`.
//! With `-- --write FOLDER` the rooms and the reference are written as text, so that other programs can be measured
//! with them.
//!
//! The reference has a fifth of the error. Hemisphere rays from two triangles per quadrilateral, which share no
//! estimator with it, check it.

mod scenes;

use std::{fmt::Write, path::Path, time::Instant};

use glam::DVec3;
use radiosity::{
    Progress, Scene,
    form_factor::{CastOptions, FormFactors},
    patch::{Patches, Subdivision},
    scene::Material,
    trace::Tracer,
    view_factor::{ViewFactorOptions, view_factors},
};

const ROUNDS: usize = 5;
const RAYS: f64 = 1e7;
const REFERENCE: f64 = 2e-5;
/// Wanted RMS standard errors of the view factors above zero.
const ERRORS: [f64; 4] = [1e-3, 4e-4, 2e-4, 1.5e-4];

type Rows = Vec<Vec<f64>>;

fn main() {
    let folder = std::env::args().skip_while(|a| a != "--write").nth(1);
    println!("| quadrilaterals | rays | seconds | RMS error | largest error of row sums |");
    println!("|---|---|---|---|---|");
    for cuts in [1, 2] {
        let polygons: Vec<Vec<DVec3>> = scenes::room_with_boxes(cuts).iter().map(|q| q.to_vec()).collect();
        let (reference, _) = between_polygons(&polygons, REFERENCE, 1);
        for error in ERRORS {
            measure(&reference, |seed| between_polygons(&polygons, error, seed));
        }
        measure(&reference, |seed| hemisphere_rays(&polygons, seed));
        if let Some(folder) = &folder {
            write(Path::new(folder), &polygons, &reference);
        }
    }
}

fn measure(reference: &Rows, run: impl Fn(u64) -> (Rows, u64)) {
    let n = reference.len();
    let (mut seconds, mut squares, mut off, mut rays) = (Vec::new(), 0.0, 0f64, 0);
    for seed in 2..2 + ROUNDS as u64 {
        let start = Instant::now();
        let (rows, cast) = run(seed);
        seconds.push(start.elapsed().as_secs_f64());
        rays = cast;
        for (row, exact) in rows.iter().zip(reference) {
            squares += row.iter().zip(exact).map(|(f, e)| (f - e).powi(2)).sum::<f64>();
            off = off.max((row.iter().sum::<f64>() - 1.0).abs());
        }
    }
    seconds.sort_by(f64::total_cmp);
    let rms = squares.sqrt() / (n as f64 * (ROUNDS as f64).sqrt());
    println!("| {n} | {:.2e} | {:.3} | {rms:.2e} | {off:.0e} |", rays as f64, seconds[ROUNDS / 2]);
}

/// All rows of the view factors between polygons, and the number of rays.
fn between_polygons(polygons: &[Vec<DVec3>], error: f64, seed: u64) -> (Rows, u64) {
    let options = ViewFactorOptions::default().with_error(error).with_seed(seed);
    let found = view_factors(polygons, &options, &Progress::new()).expect("the run is not stopped");
    let mut rows = vec![vec![0.0; polygons.len()]; polygons.len()];
    for (i, row) in rows.iter_mut().enumerate() {
        found.row(i).for_each(|(j, f)| row[j] = f);
    }
    (rows, found.rays)
}

/// The same from hemisphere rays between triangles.
fn hemisphere_rays(polygons: &[Vec<DVec3>], seed: u64) -> (Rows, u64) {
    let halves = |p: &Vec<DVec3>| [([p[0], p[1], p[2]], 0), ([p[0], p[2], p[3]], 0)];
    let triangles: Vec<_> = polygons.iter().flat_map(halves).collect();
    let scene = Scene::new(&triangles, vec![Material::new("grey", [0.5; 3], [0.0; 3])]);
    let tracer = Tracer::new(&scene);
    let mut patches = Patches::subdivide(&scene, &Subdivision::Edge(f64::INFINITY));
    let rays = RAYS / patches.len() as f64;
    let options =
        CastOptions::default().with_rays(rays).with_seed(seed).with_shadow_share(0.0).with_by_variance(false);
    let form_factors = FormFactors::cast(&scene, &tracer, &mut patches, &options, &Progress::new())
        .expect("the run is not stopped");
    let mut rows = vec![vec![0.0; polygons.len()]; polygons.len()];
    for i in 0..patches.len() {
        let share = patches.area(i) / (patches.area(i & !1) + patches.area(i | 1));
        form_factors.row(i).for_each(|(j, f)| rows[i / 2][j / 2] += share * f);
    }
    (rows, form_factors.rays())
}

/// Writes a line of twelve coordinates per quadrilateral, and a line of view factors per row.
fn write(folder: &Path, polygons: &[Vec<DVec3>], reference: &Rows) {
    let mut room = String::new();
    for p in polygons {
        let corners: Vec<String> = p.iter().map(|v| format!("{} {} {}", v.x, v.y, v.z)).collect();
        writeln!(room, "{}", corners.join(" ")).expect("strings take all");
    }
    let mut matrix = String::new();
    for row in reference {
        let values: Vec<String> = row.iter().map(|f| format!("{f:.9e}")).collect();
        writeln!(matrix, "{}", values.join(" ")).expect("strings take all");
    }
    let n = polygons.len();
    std::fs::write(folder.join(format!("room-{n}.txt")), room).expect("the folder can be written to");
    std::fs::write(folder.join(format!("view-factors-{n}.txt")), matrix)
        .expect("the folder can be written to");
}
