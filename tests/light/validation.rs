//! The verdict of the validation passes right answers and fails wrong ones.

use radiosity::{
    Progress, Scene,
    accuracy::{
        comparison::{Comparison, Estimates},
        solved::Solved,
        validation::{Validation, ValidationOptions, light_traced, path_traced, radiosity_estimates},
    },
    form_factor::{CastOptions, FormFactors, Matrix},
    patch::{Patches, Subdivision},
    scene::Material,
    solve::{SolveOptions, solve},
    trace::Tracer,
};

fn options(seed: u64) -> ValidationOptions {
    ValidationOptions::default()
        .with_subdivision(Subdivision::Count(400))
        .with_paths(512)
        .with_particles(1 << 20)
        .with_seed(seed)
}

fn cornell_box() -> Scene {
    Scene::load("meshes/cornell-box.obj").unwrap()
}

/// The same scene with other materials. Triangles from `kept` on are shrunk to almost nothing on the floor.
fn altered(scene: &Scene, kept: usize, change: impl Fn(&mut Material)) -> Scene {
    let shrunk = |t: usize| scene.corners(t).map(|p| if t < kept { p } else { 1e-3 * p });
    let corners: Vec<_> =
        (0..scene.triangles.len()).map(|t| (shrunk(t), scene.triangles[t].material)).collect();
    let mut materials = scene.materials.clone();
    materials.iter_mut().for_each(change);
    Scene::new(&corners, materials)
}

fn solved_twice(scene: &Scene, options: &ValidationOptions) -> (Solved, Solved) {
    let tracer = Tracer::new(scene);
    let cast = CastOptions::default().with_rays(options.rays).with_seed(options.seed);
    let at = |subdivision: &Subdivision, cast: &CastOptions| {
        Solved::new(scene, &tracer, subdivision, cast, &options.solve, &Progress::new()).unwrap()
    };
    let coarse = at(&options.subdivision, &cast);
    let finer = cast.with_rays(0.25 * options.rays).with_seed(options.seed + 1);
    let quarters = coarse.patches.quartered(scene);
    let fine =
        Solved::of_patches(scene, &tracer, quarters, &finer, &options.solve, &Progress::new()).unwrap();
    (coarse, fine)
}

fn areas(patches: &Patches) -> Vec<f64> {
    (0..patches.fronts()).map(|i| patches.area(i)).collect()
}

/// Compares radiosity with path tracing and light tracing of the scene `referee`.
fn against(
    referee: &Scene,
    patches: &Patches,
    radiosity: &Estimates,
    options: &ValidationOptions,
) -> [Comparison; 2] {
    let tracer = Tracer::new(referee);
    let path = path_traced(referee, &tracer, patches, options, &Progress::new()).unwrap();
    let light = light_traced(referee, &tracer, patches, options, &Progress::new()).unwrap();
    [path, light].map(|seen| Comparison::of(radiosity, &seen, &areas(patches)))
}

/// The limits are set so that about one right answer in a hundred fails, whatever the numbers of rays, paths and particles.
/// With four answers, two failures have a probability of one in seventeen hundred.
#[test]
fn right_answers_pass() {
    let mut objecting = Vec::new();
    for scene in ["meshes/cornell-box.obj", "meshes/textured.obj"] {
        let scene = Scene::load(scene).unwrap();
        let tracer = Tracer::new(&scene);
        for seed in 0..2 {
            let options = options(seed).with_rays(256.0).with_paths(128).with_particles(1 << 18);
            let objections =
                Validation::of(&scene, &tracer, &options, &Progress::new()).unwrap().objections();
            if !objections.is_empty() {
                objecting.push(objections);
            }
        }
    }
    assert!(objecting.len() <= 1, "{objecting:#?}");
}

/// Files often contain faces twice. The second of two is never lit, and paths from it must not cause objections.
#[test]
fn doubled_faces_pass() {
    let scene = cornell_box();
    let all = 0..scene.triangles.len();
    let corners: Vec<_> = all
        .clone()
        .chain(all.clone().skip(all.len() - 10))
        .map(|t| (scene.corners(t), scene.triangles[t].material))
        .collect();
    let doubled = Scene::new(&corners, scene.materials);
    let tracer = Tracer::new(&doubled);
    let validation = Validation::of(&doubled, &tracer, &options(0), &Progress::new()).unwrap();
    assert_eq!(validation.objections(), Vec::<String>::new());
}

/// An error of 2 % in all reflectances is noticed by both referees.
#[test]
fn two_percent_of_reflectance_are_noticed() {
    let scene = cornell_box();
    for factor in [0.98, 1.02] {
        let wrong =
            altered(&scene, scene.triangles.len(), |m| m.reflectance = m.reflectance.map(|r| r * factor));
        let (coarse, fine) = solved_twice(&wrong, &options(0));
        let radiosity = radiosity_estimates(&coarse, &fine);
        for comparison in against(&scene, &coarse.patches, &radiosity, &options(0)) {
            assert!(!comparison.objections().is_empty(), "{factor}: {comparison:?}");
        }
    }
}

/// A missing block is noticed by both referees.
#[test]
fn a_missing_blocker_is_noticed() {
    let scene = cornell_box();
    // The blocks come last in the file, ten triangles each.
    let wrong = altered(&scene, scene.triangles.len() - 10, |_| ());
    let (coarse, fine) = solved_twice(&wrong, &options(0));
    let radiosity = radiosity_estimates(&coarse, &fine);
    for comparison in against(&scene, &coarse.patches, &radiosity, &options(0)) {
        assert!(!comparison.objections().is_empty(), "{comparison:?}");
    }
}

/// Form factors between pairs of triangles have symmetric errors of up to a fifth at both patch sizes, like a mistake
/// in the program would make: reciprocal, closed, in perfect energy balance, and wrong. Both referees notice.
#[test]
fn a_wrong_symmetric_matrix_is_noticed() {
    let scene = cornell_box();
    let (coarse, fine) = solved_twice(&scene, &options(0));
    let [coarse, fine] = [coarse, fine].map(perturbed);
    assert!(coarse.form_factors.reciprocity_deviation().after < 1e-12);
    assert!(coarse.form_factors.row_sum_deviation().after < 1e-12);
    let radiosity = radiosity_estimates(&coarse, &fine);
    for comparison in against(&scene, &coarse.patches, &radiosity, &options(0)) {
        assert!(!comparison.objections().is_empty(), "{comparison:?}");
    }
}

fn perturbed(solved: Solved) -> Solved {
    let Solved { patches, form_factors, error_bars, .. } = solved;
    let n = patches.len();
    let mean = form_factors.areas().iter().sum::<f64>() / n as f64;
    let relative: Vec<f64> = form_factors.areas().iter().map(|a| a / mean).collect();
    let (mut starts, mut columns, mut values) = (vec![0], Vec::new(), Vec::new());
    for i in 0..n {
        for (j, form_factor) in form_factors.row(i) {
            let (s, t) = (patches.triangle(i), patches.triangle(j));
            let factor = 1.0 + 0.2 * ((s.min(t) * 12 + s.max(t) * 7) as f64).sin();
            columns.push(j as u32);
            values.push((relative[i] * form_factor * factor) as f32);
        }
        starts.push(columns.len());
    }
    let matrix = Matrix::new((n, n), starts, columns, values);
    let form_factors = FormFactors::from_exchange(matrix, relative, form_factors.escaped().to_vec());
    let solution = solve(&form_factors, &patches, &SolveOptions::default(), &Progress::new()).unwrap();
    Solved { patches, form_factors, solution, error_bars }
}

/// The discretisation error of whole triangles is measured although no edge limits their size, and is larger than that
/// of their parts.
#[test]
fn the_discretisation_error_of_whole_triangles_is_measured() {
    let scene = cornell_box();
    let tracer = Tracer::new(&scene);
    let left = |subdivision: Subdivision| {
        let options = options(0).with_subdivision(subdivision).with_paths(16).with_particles(1024);
        Validation::of(&scene, &tracer, &options, &Progress::new()).unwrap().discretisation_relative
    };
    let (whole, whole_by_length) = (left(Subdivision::Edge(f64::INFINITY)), left(Subdivision::Edge(1e6)));
    assert_eq!(whole, whole_by_length);
    assert!(whole > left(Subdivision::Count(400)), "{whole}");

    let patches = Patches::subdivide(&scene, &Subdivision::Count(100));
    let fine = patches.quartered(&scene);
    assert_eq!(fine.fronts(), 4 * patches.fronts());
    assert!((0..patches.fronts()).all(|i| patches.overlap(&fine, i).0.len() == 4));
}
