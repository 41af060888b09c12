//! Comparison with another renderer in glossy scenes: the Cornell box with blocks of other materials.
//!
//! The constants are the means of the quarters of a picture and their standard errors, from the scalar path integrator
//! of Mitsuba 3.9.1 (`benches/mitsuba/glossy_boxes.py`, 262144 samples per quarter, 16 runs).

use std::process::Command;

use super::*;
use crate::{
    Progress,
    scene::{Distribution, Fresnel, Shadowing, Specular},
    trace::Tracer,
};

type Quarters = [([f64; 3], [f64; 3]); 4];

/// The box with purely specular blocks.
fn box_with(tall: Specular, short: Specular) -> Scene {
    let mut scene = Scene::load(concat!(env!("CARGO_MANIFEST_DIR"), "/meshes/cornell-glossy.obj")).unwrap();
    for (name, specular) in [("tall", tall), ("short", short)] {
        let material = scene.materials.iter_mut().find(|m| m.name == name).unwrap();
        (material.reflectance, material.specular) = ([0.0; 3], Some(Box::new(specular)));
    }
    scene
}

fn facets(distribution: Distribution, alpha: f64, ks: f64) -> Specular {
    Specular::Microfacet {
        distribution,
        alpha: [alpha; 2],
        fresnel: Fresnel::Constant([ks; 3]),
        // Mitsuba uses this term.
        shadowing: Shadowing::Separable,
    }
}

const MIRROR_AND_GGX: Quarters = [
    ([0.355021, 0.201437, 0.064098], [9.72e-4, 6.67e-4, 2.22e-4]),
    ([0.293786, 0.224182, 0.063305], [6.76e-4, 5.04e-4, 1.61e-4]),
    ([0.098366, 0.034999, 0.01037], [1.250e-4, 6.08e-5, 1.97e-5]),
    ([0.054605, 0.054848, 0.009886], [8.69e-5, 7.40e-5, 1.48e-5]),
];

const BECKMANN_AND_GGX: Quarters = [
    ([0.34067, 0.194393, 0.061933], [9.02e-4, 6.33e-4, 2.11e-4]),
    ([0.289026, 0.220493, 0.062702], [9.63e-4, 6.76e-4, 2.23e-4]),
    ([0.088138, 0.033112, 0.009693], [6.00e-5, 3.05e-5, 9.11e-6]),
    ([0.055662, 0.054611, 0.010315], [3.76e-5, 3.17e-5, 8.53e-6]),
];

/// Renders with `samples` paths a quarter in each of 32 runs. Their standard errors are at most the share `sharp` of the means.
fn assert_same(scene: &Scene, wanted: &Quarters, samples: u32, sharp: f64) {
    let tracer = Tracer::new(scene);
    let camera = Camera::new(dvec3(278., 273., -800.), dvec3(278., 273., 0.), DVec3::Y, 39.3, 2, 2).unwrap();
    let paths = PathTracer::new(scene, &tracer, NEXT_EVENT);
    let films: Vec<Film> = (0..32)
        .map(|seed| {
            let options = RenderOptions { samples, seed };
            Film::render(&paths, &camera, &options, &Progress::new()).unwrap()
        })
        .collect();
    for (quarter, (mean, standard_error)) in wanted.iter().enumerate() {
        let of_quarter: Vec<[f64; 3]> = films.iter().map(|f| f.pixels()[quarter].map(f64::from)).collect();
        let ours = Estimate::of(&of_quarter);
        let theirs = Estimate { mean: *mean, standard_error: *standard_error };
        assert!(apart(&ours, &theirs) < 4.5, "quarter {quarter}: {ours:?} {theirs:?}");
        assert!(ours.standard_error[0] < sharp * ours.mean[0], "{ours:?}");
    }
}

fn mirror_and_ggx() -> Scene {
    let tall = Specular::Mirror(Fresnel::Constant([0.9; 3]));
    box_with(tall, facets(Distribution::Ggx, 0.2, 0.8))
}

fn beckmann_and_ggx() -> Scene {
    let tall = facets(Distribution::Beckmann, 0.3, 0.7);
    box_with(tall, facets(Distribution::Ggx, 0.5, 0.9))
}

/// Light of the small lamp that the mirror reflects is found only by chance hits, which cause most of the noise.
const CAUSTIC: f64 = 0.015;
const SMOOTH: f64 = 0.005;

#[test]
fn a_mirror_and_ggx_are_as_bright_as_elsewhere() {
    assert_same(&mirror_and_ggx(), &MIRROR_AND_GGX, 4096, CAUSTIC);
}

#[test]
fn beckmann_and_ggx_are_as_bright_as_elsewhere() {
    assert_same(&beckmann_and_ggx(), &BECKMANN_AND_GGX, 4096, SMOOTH);
}

/// What the script prints: of each scene four lines with the means of a quarter and their standard errors.
fn printed(text: &str) -> Vec<([f64; 3], [f64; 3])> {
    let quarters = text.lines().filter(|line| line.starts_with("    ("));
    let of_line = |line: &str| {
        let words = line.split(|c: char| !(c.is_ascii_digit() || "+-.e".contains(c)));
        let numbers: Vec<f64> = words.filter(|word| !word.is_empty()).map(|w| w.parse().unwrap()).collect();
        let three = |k: usize| -> [f64; 3] { numbers[k..k + 3].try_into().unwrap() };
        assert_eq!(numbers.len(), 6, "{line}");
        (three(0), three(3))
    };
    quarters.map(of_line).collect()
}

/// Mitsuba itself beside ours, with eight times as many paths as in the other tests.
///
///     pip install mitsuba numpy
///     cargo test --lib -- --ignored mitsuba
///
/// `PYTHON` names the Python that has Mitsuba; `python3` by default.
#[test]
#[ignore = "needs Python with mitsuba, and two minutes"]
fn both_boxes_are_as_bright_as_mitsuba_renders_them() {
    let python = std::env::var("PYTHON").unwrap_or_else(|_| "python3".into());
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/mitsuba/glossy_boxes.py");
    let done = Command::new(python).args([script, "131072", "16"]).output().unwrap();
    let said = String::from_utf8_lossy(&done.stdout);
    assert!(done.status.success(), "{said}{}", String::from_utf8_lossy(&done.stderr));
    let found = printed(&said);
    let [first, second] = [0, 4].map(|k| -> Quarters { found[k..k + 4].try_into().unwrap() });
    assert_same(&mirror_and_ggx(), &first, 1 << 15, 0.5 * CAUSTIC);
    assert_same(&beckmann_and_ggx(), &second, 1 << 15, 0.5 * SMOOTH);
}
