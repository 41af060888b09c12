//! The errors that the documentation states for the presets of quality.

use radiosity::{
    Progress, Quality, Scene,
    accuracy::{solved::Solved, validation::averaged},
    form_factor::CastOptions,
    patch::{Patches, Subdivision},
    solve::SolveOptions,
    trace::Tracer,
};

/// The irradiance of every patch of `common`, per channel, averaged from a solution of this quality.
fn means(scene: &Scene, common: &Patches, quality: Quality, seed: u64) -> Vec<f64> {
    let cast = CastOptions::default().with_rays(f64::from(quality.rays)).with_seed(seed);
    let (options, progress) = (SolveOptions::default(), Progress::new());
    let cut = Subdivision::Count(quality.patches);
    let Solved { patches, solution, .. } =
        Solved::new(scene, &Tracer::new(scene), &cut, &cast, &options, &progress).unwrap();
    averaged(common, &patches, &solution.irradiance)
}

/// `src/quality.rs` states 4.4 % for draft and 0.58 % for medium, as upper limits. The product of the deviations from
/// two independent references is free of the noise of the references. A thousand patches count like about a hundred
/// independent values, since neighbours err together. So the error scatters by 1 / sqrt(200) = 7 %, and by 4 % over
/// three seeds. Three standard deviations are allowed.
#[test]
fn presets_reach_their_stated_errors() {
    let scene = Scene::load(format!("{}/meshes/cornell-box.obj", env!("CARGO_MANIFEST_DIR"))).unwrap();
    let common = Patches::subdivide(&scene, &Subdivision::Count(Quality::DRAFT.patches));
    let fine = Quality { patches: 32_000, rays: 64 };
    let truths = [101, 102].map(|seed| means(&scene, &common, fine, seed));
    let channels = truths[0].len() / common.fronts();
    let areas = || (0..common.fronts()).flat_map(|i| std::iter::repeat_n(common.area(i), channels));
    let all: f64 = areas().sum();
    let mean: f64 = areas().zip(&truths[0]).map(|(area, e)| area * e / all).sum();
    for (name, quality, stated) in [("draft", Quality::DRAFT, 0.044), ("medium", Quality::MEDIUM, 0.0058)] {
        let mut squares = 0.0;
        for seed in 0..3 {
            let found = means(&scene, &common, quality, seed);
            let product = |q: usize| (found[q] - truths[0][q]) * (found[q] - truths[1][q]);
            squares += areas().enumerate().map(|(q, area)| area / all * product(q)).sum::<f64>() / 3.0;
        }
        let error = squares.sqrt() / mean;
        println!("{name}: {:.2} %, stated {:.2} %", 100.0 * error, 100.0 * stated);
        assert!(error <= 1.12 * stated, "{name}: {error}, stated {stated}");
    }
}
