//! Paths, particles and radiosity agree where reflectance and emission come from textures.

use radiosity::{
    Progress, Scene,
    accuracy::error_bars::ErrorBars,
    form_factor::{CastOptions, FormFactors},
    monte_carlo::{Effort, LightOptions, LightTracer, PathOptions, PathTracer, Region},
    patch::{Patches, Subdivision},
    solve::{SolveOptions, solve},
    trace::Tracer,
};

const WHOLE: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Mean irradiance of the fronts of all triangles by patches of at most this size, and the largest standard error of a
/// patch on each: more than that of its mean.
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
    // The lamp fades along x: the floor's halves and the walls at the ends would be equal without its texture.
    let at = |low: bool| {
        let end = if low { 0.0 } else { 4.0 };
        let walls = (0..regions.len()).filter(|&t| scene.corners(t).iter().all(|p| p.x == end));
        walls.map(|t| paths[t].mean[1]).sum::<f64>() / 2.0
    };
    assert!((at(true) / at(false) - 1.0).abs() > 0.1, "{} {}", at(true), at(false));
}
