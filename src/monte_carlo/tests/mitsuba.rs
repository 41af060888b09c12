//! Comparison with another renderer in glossy scenes: the Cornell box with blocks of other materials.
//!
//! The constants are the means of the quarters of a picture and their standard errors, from the scalar path integrator
//! of Mitsuba 3.9.1 (`benches/mitsuba/glossy_boxes.py`, 262144 samples per quarter, 16 runs).

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

fn assert_same(scene: &Scene, wanted: &Quarters) {
    let tracer = Tracer::new(scene);
    let camera = Camera::new(dvec3(278., 273., -800.), dvec3(278., 273., 0.), DVec3::Y, 39.3, 2, 2).unwrap();
    let paths = PathTracer::new(scene, &tracer, NEXT_EVENT);
    let films: Vec<Film> = (0..32)
        .map(|seed| {
            let options = RenderOptions { samples: 4096, seed };
            Film::render(&paths, &camera, &options, &Progress::new()).unwrap()
        })
        .collect();
    for (quarter, (mean, standard_error)) in wanted.iter().enumerate() {
        let of_quarter: Vec<[f64; 3]> = films.iter().map(|f| f.pixels()[quarter].map(f64::from)).collect();
        let ours = Estimate::of(&of_quarter);
        let theirs = Estimate { mean: *mean, standard_error: *standard_error };
        assert!(apart(&ours, &theirs) < 4.5, "quarter {quarter}: {ours:?} {theirs:?}");
        // Light of the small lamp that the mirror reflects is found only by chance hits, which causes noise.
        assert!(ours.standard_error[0] < 0.025 * ours.mean[0], "{ours:?}");
    }
}

#[test]
fn a_mirror_and_ggx_are_as_bright_as_elsewhere() {
    let tall = Specular::Mirror(Fresnel::Constant([0.9; 3]));
    assert_same(&box_with(tall, facets(Distribution::Ggx, 0.2, 0.8)), &MIRROR_AND_GGX);
}

#[test]
fn beckmann_and_ggx_are_as_bright_as_elsewhere() {
    let tall = facets(Distribution::Beckmann, 0.3, 0.7);
    assert_same(&box_with(tall, facets(Distribution::Ggx, 0.5, 0.9)), &BECKMANN_AND_GGX);
}
