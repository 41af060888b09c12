//! View factors of a model of streets: `cargo bench --bench streets -- PLOTS CELLS [ERROR]`, by default 6 6 1e-4, which
//! has 22,176 triangles. `--write FILE.stl` writes the model instead, for the command line and for other programs.
//!
//! The authors of uDALES, a model of urban climate, report 1,280 s for a model of 22,176 facets with View3D on 8
//! threads.

mod scenes;

use std::{fmt::Write, time::Instant};

use radiosity::{
    Progress,
    output::report::peak_bytes,
    view_factor::{ViewFactorOptions, view_factors},
};

fn main() {
    let mut arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let file = arguments.iter().position(|a| a == "--write").map(|k| arguments.drain(k..).nth(1));
    let number = |k: usize, default: f64| arguments.get(k).map_or(default, |a| a.parse().expect("a number"));
    let polygons = scenes::streets(number(0, 6.0) as u32, number(1, 6.0) as u32);
    if let Some(file) = file {
        let mut text = String::from("solid streets\n");
        for triangle in &polygons {
            text += "facet normal 0 0 0\nouter loop\n";
            triangle.iter().for_each(|p| {
                writeln!(text, "vertex {} {} {}", p.x, p.y, p.z).expect("strings take all");
            });
            text += "endloop\nendfacet\n";
        }
        std::fs::write(file.expect("a file after --write"), text + "endsolid streets\n")
            .expect("it can be written");
        return;
    }
    let options = ViewFactorOptions::default().with_error(number(2, 1e-4)).with_enclosed(false);
    let start = Instant::now();
    let found = view_factors(&polygons, &options, &Progress::new()).expect("the run is not stopped");
    println!("triangles, seconds, view factors above zero, RMS standard error, rays, peak GiB");
    println!(
        "{}, {:.1}, {}, {:.1e}, {}, {:.2}",
        polygons.len(),
        start.elapsed().as_secs_f64(),
        found.non_zeros(),
        found.error,
        found.rays,
        peak_bytes().unwrap_or(0) as f64 / 2f64.powi(30)
    );
}
