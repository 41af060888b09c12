//! Path tracing, light tracing and radiosity agree on scenes with textured reflectance and emission.

use glam::{DVec3, dvec2, dvec3};
use radiosity::{
    Progress, Scene,
    accuracy::error_bars::ErrorBars,
    form_factor::{CastOptions, FormFactors},
    monte_carlo::{Effort, LightOptions, LightTracer, PathOptions, PathTracer, Receiver, Region},
    patch::{Patches, Subdivision},
    scene::{Material, Texture, TextureMap},
    solve::{SolveOptions, solve},
    trace::Tracer,
};

const WHOLE: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// The mean irradiance of the fronts of all triangles, from patches of at most this size, and the largest standard
/// error of a patch on each, which is an upper limit for the error of its mean.
fn by_radiosity(scene: &Scene, tracer: &Tracer, edge: f64) -> Vec<([f64; 3], [f64; 3])> {
    let progress = Progress::new();
    let mut patches = Patches::subdivide(scene, &Subdivision::Edge(edge));
    let cast = CastOptions::default().with_rays(128.0);
    let factors = FormFactors::cast(scene, tracer, &mut patches, &cast, &progress).unwrap();
    let solution = solve(&factors, &patches, &SolveOptions::default(), &progress).unwrap();
    let bars = ErrorBars::of(&factors, &patches, &solution).unwrap();
    assert_eq!(solution.channels, 3);
    let mut found = vec![([0.0; 3], [0.0f64; 3]); scene.triangles.len()];
    for i in 0..patches.fronts() {
        let t = patches.triangle(i);
        for c in 0..3 {
            found[t].0[c] += solution.irradiance[3 * i + c] * patches.area(i) / scene.area(t);
            found[t].1[c] = found[t].1[c].max(bars.standard_error[3 * i + c]);
        }
    }
    found
}

/// Paths with and without next event estimation, particles and radiosity agree on every triangle: within 4.5 standard
/// errors, and for radiosity also within the largest error of a patch and the change from patches of twice the size.
#[test]
fn all_ways_agree_on_a_room_with_a_checkerboard_and_a_fading_lamp() {
    let scene = Scene::load(concat!(env!("CARGO_MANIFEST_DIR"), "/meshes/textured.obj")).unwrap();
    assert_eq!(scene.textures.len(), 2);
    let (tracer, progress) = (Tracer::new(&scene), Progress::new());
    let regions: Vec<Region> =
        (0..scene.triangles.len()).map(|triangle| Region { triangle, part: WHOLE, front: true }).collect();
    let by = |next_event, samples| {
        let effort = Effort::default().with_samples(samples);
        let paths = PathTracer::new(&scene, &tracer, PathOptions::default().with_next_event(next_event));
        paths.mean_irradiances(&regions, &effort, &progress).unwrap()
    };
    let (paths, plain) = (by(true, 1 << 14), by(false, 1 << 16));
    let options = LightOptions::default().with_particles(1 << 19);
    let light = LightTracer::new(&scene, &tracer, options)
        .trace(regions.len(), |hit| hit.front.then_some(hit.triangle as usize), &progress)
        .unwrap();
    let [coarse, fine] = [0.5, 0.25].map(|edge| by_radiosity(&scene, &tracer, edge));
    for t in 0..regions.len() {
        let particles = light.bins[t].scaled(1.0 / scene.area(t));
        for c in 0..3 {
            let (want, error) = (paths[t].mean[c], paths[t].standard_error[c]);
            assert!(error < 0.02 * want);
            for other in [plain[t], particles] {
                let allowed = 4.5 * error.hypot(other.standard_error[c]);
                assert!(allowed < 0.15 * want, "triangle {t}: {allowed} is too blunt for {want}");
                assert!(
                    (other.mean[c] - want).abs() < allowed,
                    "triangle {t}: {other:?}, paths {:?}",
                    paths[t]
                );
            }
            let (got, spread) = (fine[t].0[c], fine[t].1[c]);
            let allowed = 4.5 * error + spread + (coarse[t].0[c] - got).abs();
            assert!(allowed < 0.15 * want, "triangle {t}: {allowed} is too blunt for {want}");
            assert!((got - want).abs() < allowed, "triangle {t}: {got} ± {spread}, paths {:?}", paths[t]);
        }
    }
    // The lamp fades along x. Without its texture the walls at the two ends would be equally lit.
    let at = |low: bool| {
        let end = if low { 0.0 } else { 4.0 };
        let walls = (0..regions.len()).filter(|&t| scene.corners(t).iter().all(|p| p.x == end));
        walls.map(|t| paths[t].mean[1]).sum::<f64>() / 2.0
    };
    assert!((at(true) / at(false) - 1.0).abs() > 0.1, "{} {}", at(true), at(false));
}

/// A black ceiling of 4 by 4 at z = 3. Four of the 32 by 32 texels of its texture emit.
fn spot() -> Scene {
    let corners = [dvec3(0., 0., 3.), dvec3(0., 4., 3.), dvec3(4., 4., 3.), dvec3(4., 0., 3.)];
    let uv = [dvec2(0., 0.), dvec2(0., 1.), dvec2(1., 1.), dvec2(1., 0.)];
    let halves = [[0, 1, 2], [0, 2, 3]];
    let mut lamp = Material::new("lamp", [0.0; 3], [10.0; 3]);
    lamp.emission_map = Some(TextureMap::new(0));
    let mut scene = Scene::new(&halves.map(|half| (half.map(|k| corners[k]), 0)), vec![lamp]);
    scene.texcoords = halves.map(|half| half.map(|k| uv[k])).to_vec();
    let mut texels = vec![0; 3 * 32 * 32];
    for (x, y) in [(10, 20), (11, 20), (10, 21), (11, 21)] {
        texels[3 * (32 * y + x)..][..3].fill(255);
    }
    scene.textures = vec![Texture::new(32, 32, texels)];
    scene
}

/// The light of a few texels is found by few samples: 1/256 of the ceiling emits. The tolerance is five standard
/// errors, which are below 2 %, and the quadrature of the reference.
#[test]
fn a_bright_spot_of_a_texture_is_sampled() {
    let scene = spot();
    let (tracer, progress) = (Tracer::new(&scene), Progress::new());
    let effort = Effort::default().with_samples(256);
    let paths = PathTracer::new(&scene, &tracer, PathOptions::default());
    let places = [dvec3(1.4, 1.4, 0.0), dvec3(3.5, 2.0, 0.0), dvec3(1.0, 1.0, 2.5)];
    let receivers = places.map(|p| Receiver::free(&tracer, p, DVec3::Z));
    for (p, estimate) in places.into_iter().zip(paths.irradiances(&receivers, &effort, &progress).unwrap()) {
        // The integral of L cos² / r² over the spot, from 1.25 to 1.5 both ways, by the midpoint rule.
        const N: usize = 64;
        let at = |k: usize| 1.25 + 0.25 * (k as f64 + 0.5) / N as f64;
        let light = |q: DVec3| 10.0 * ((q - p).z / (q - p).length_squared()).powi(2);
        let points = (0..N * N).map(|k| dvec3(at(k % N), at(k / N), 3.0));
        let right = points.map(light).sum::<f64>() * (0.25f64 / N as f64).powi(2);
        let (got, error) = (estimate.mean[0], estimate.standard_error[0]);
        assert!((got - right).abs() < 5.0 * error + 1e-4 * right, "{p}: {got} for {right} ± {error}");
        assert!(error > 0.0 && error < 0.02 * right, "{p}: {error} of {right}");
    }
    let options = LightOptions::default().with_particles(1 << 12);
    let emitted = LightTracer::new(&scene, &tracer, options).trace(0, |_| None, &progress).unwrap().emitted;
    let power = 10.0 * std::f64::consts::PI * 0.0625;
    // At the rim of the spot a few parts are dark on one side.
    assert!((emitted.mean[0] / power - 1.0).abs() < 0.01, "{} for {power}", emitted.mean[0]);
}

/// Samples that all miss the light do not prove that there is none: the standard error is that of one sample of full
/// light.
#[test]
fn all_samples_missing_is_not_certainty() {
    let scene = spot();
    let tracer = Tracer::new(&scene);
    let paths = PathTracer::new(&scene, &tracer, PathOptions::default());
    let above = Receiver::free(&tracer, dvec3(2.0, 2.0, 3.5), DVec3::Z);
    let effort = Effort::default().with_samples(1024);
    let estimate = paths.irradiances(&[above], &effort, &Progress::new()).unwrap()[0];
    assert_eq!(estimate.mean, [0.0; 3]);
    assert!((estimate.standard_error[0] - std::f64::consts::PI * 10.0 / 1024.0).abs() < 1e-12);
}

/// A face whose corners share one texture coordinate has one value, also on the border between two texels.
#[test]
fn one_texture_coordinate_is_one_value() {
    let corners = [dvec3(0., 0., 0.), dvec3(1., 0., 0.), dvec3(0., 1., 0.)];
    let mut material = Material::new("m", [1.0; 3], [0.0; 3]);
    material.reflectance_map = Some(TextureMap::new(0));
    let mut scene = Scene::new(&[(corners, 0)], vec![material]);
    scene.textures = vec![Texture::new(10, 10, (0..300).map(|k| (k * 83 % 251) as u8).collect())];
    for k in 0..100 {
        let shared = dvec2(f64::from(k % 10) / 10.0, f64::from(k / 10) / 10.0);
        scene.texcoords = vec![[shared; 3]];
        let mean = scene.mean_reflectance(0, &WHOLE);
        for step in 1..50 {
            let (a, b) = (f64::from(step) * 0.019, 1.0 / f64::from(step + 51));
            assert_eq!(scene.reflectance_at(0, [a, b, 1.0 - a - b]), mean, "{shared}");
        }
    }
}
