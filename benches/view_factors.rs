//! View factors of a closed room with 20 boxes, 504 and 2016 quadrilaterals: `cargo bench --bench view_factors`.
use std::time::Instant;

mod scenes;

use glam::DVec3;
use radiosity::{
    Progress, Scene,
    form_factor::{
        CastOptions, FormFactors,
        between_polygons::{ViewFactorOptions, view_factors},
    },
    patch::{Patches, Subdivision},
    scene::Material,
    trace::Tracer,
};

fn dense(quads: &[[DVec3; 4]], rays: f64, seed: u64) -> (Vec<f64>, f64, f64) {
    let t0 = Instant::now();
    let triangles: Vec<_> = quads.iter().flat_map(|&[a, b, c, d]| [([a, b, c], 0), ([a, c, d], 0)]).collect();
    let scene = Scene::new(&triangles, vec![Material::new("white", [0.5; 3], [0.0; 3])]);
    let tracer = Tracer::new(&scene);
    let mut patches = Patches::subdivide(&scene, &Subdivision::Edge(f64::INFINITY));
    let options = CastOptions { rays, seed, shadow_share: 0.0, by_variance: false, ..CastOptions::default() };
    let t1 = Instant::now();
    let ff = FormFactors::cast(&scene, &tracer, &mut patches, &options, &Progress::new()).unwrap();
    let cast = t1.elapsed().as_secs_f64();
    let n = quads.len();
    assert_eq!(ff.len(), 2 * n);
    let mut out = vec![0.0; n * n];
    let areas = ff.areas();
    for q in 0..n {
        let area = areas[2 * q] + areas[2 * q + 1];
        for i in [2 * q, 2 * q + 1] {
            for (j, f) in ff.row(i) {
                out[q * n + j / 2] += areas[i] * f / area;
            }
        }
    }
    (out, t0.elapsed().as_secs_f64(), cast)
}

fn rms(a: &[f64], b: &[f64]) -> f64 {
    (a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum::<f64>() / a.len() as f64).sqrt()
}

fn by_pairs(quads: &[[DVec3; 4]], error: f64, seed: u64) -> (Vec<f64>, f64) {
    let t0 = Instant::now();
    let polygons: Vec<Vec<DVec3>> = quads.iter().map(|q| q.to_vec()).collect();
    let options = ViewFactorOptions { error, seed, ..ViewFactorOptions::default() };
    let ff = view_factors(&polygons, &options, &Progress::new()).unwrap();
    let n = quads.len();
    let mut out = vec![0.0; n * n];
    for q in 0..n {
        for (j, f) in ff.row(q) {
            out[q * n + j] = f;
        }
    }
    (out, t0.elapsed().as_secs_f64())
}

fn main() {
    for cuts in [1, 2] {
        let quads = scenes::room_with_boxes(cuts);
        let n = quads.len();
        let bytes = std::fs::read(format!("/tmp/peers/out/ref_{n}.f64")).unwrap();
        let reference: Vec<f64> = bytes.as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b)).collect();
        for e in [1e-3, 4e-4, 2e-4, 1e-4] {
            let (m, seconds) = by_pairs(&quads, e, 1);
            let off =
                (0..n).map(|q| (m[q * n..(q + 1) * n].iter().sum::<f64>() - 1.0).abs()).fold(0.0, f64::max);
            println!(
                "{n} pairs {e:.0e}: rms {:.2e}, {seconds:.3} s, rows off {off:.1e}",
                rms(&m, &reference)
            );
        }
        for k in if std::env::var("V").is_ok() { vec![] } else { vec![1e7] } {
            let rays = k / (2 * n) as f64;
            let (m, seconds, cast) = dense(&quads, rays, 1);
            println!(
                "{n} rays {k:.0e} in all: rms {:.2e}, {seconds:.3} s ({cast:.3} cast)",
                rms(&m, &reference)
            );
        }
    }
}
