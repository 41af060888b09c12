//! Sampling errors against a converged solution on the same patches: error bars, wanted errors, rounds, patch sizes.

use std::sync::LazyLock;

use radiosity::{
    Progress, Scene,
    accuracy::{
        bias,
        discretisation::Discretisation,
        error_bars::{T_QUANTILE, relative_rms},
        refinement::{Plan, Round, begin, refine},
        solved::Solved,
    },
    form_factor::{CastOptions, FormFactors},
    output::exposure,
    patch::{Patches, Subdivision},
    solve::SolveOptions,
    trace::Tracer,
};

use crate::common::*;
use glam::DVec3;

struct Case {
    scene: Scene,
    tracer: Tracer,
    subdivision: Subdivision,
    reference: Solved,
}

static CORNELL_BOX: LazyLock<Case> = LazyLock::new(|| Case::new("cornell-box.obj"));
static TEXTURED: LazyLock<Case> = LazyLock::new(|| Case::new("textured.obj"));

impl Case {
    /// A mesh of this repository in about 300 patches, with a reference of 8192 rays per patch. The error of the
    /// reference is at most a third of the error of 1024 rays.
    fn new(name: &str) -> Case {
        let path: std::path::PathBuf = [env!("CARGO_MANIFEST_DIR"), "meshes", name].iter().collect();
        let scene = Scene::load(&path).unwrap();
        let tracer = Tracer::new(&scene);
        let subdivision = Subdivision::Count(300);
        let reference = solve_with(&scene, &tracer, subdivision, 8192.0, 1000);
        Case { scene, tracer, subdivision, reference }
    }

    fn solve(&self, rays: f64, seed: u64) -> Solved {
        solve_with(&self.scene, &self.tracer, self.subdivision, rays, seed)
    }

    /// The RMS error of irradiance relative to the mean, the estimate of the same from error bars, and the share of
    /// 95 % intervals that contain the reference.
    fn errors(&self, solved: &Solved) -> (f64, f64, f64) {
        let values = self.reference.patches.fronts() * self.reference.solution.channels;
        let truth = &self.reference.solution.irradiance[..values];
        let areas = &self.reference.form_factors.areas()[..self.reference.patches.fronts()];
        let bars = &solved.error_bars.standard_error[..values];
        let off: Vec<f64> = solved.solution.irradiance.iter().zip(truth).map(|(e, t)| e - t).collect();
        let within = off.iter().zip(bars).filter(|(off, bar)| off.abs() <= T_QUANTILE * *bar).count();
        let share = within as f64 / values as f64;
        (relative_rms(&off, truth, areas), relative_rms(bars, truth, areas), share)
    }
}

fn solve_with(scene: &Scene, tracer: &Tracer, subdivision: Subdivision, rays: f64, seed: u64) -> Solved {
    let cast = CastOptions::default().with_rays(rays).with_seed(seed);
    Solved::new(scene, tracer, &subdivision, &cast, &SolveOptions::default(), &Progress::new()).unwrap()
}

/// The reported error bars agree with the actual errors. The RMS over 300 patches and three channels has the weight
/// of about 100 independent values, since neighbours and channels err together. Over eight seeds the actual RMS
/// scatters by 1/sqrt(2 * 800) = 2.5 %, and the estimate as much. The error of the reference is smaller at least by
/// the ratio of rays to the power 0.6; half the square of that ratio is added. Four standard deviations are allowed.
/// A binomial share of 0.95 among 800 values scatters by 0.8 %.
#[test]
fn errors_are_as_estimated_and_fall() {
    const SEEDS: u64 = 8;
    for (name, case) in [("cornell-box", &*CORNELL_BOX), ("textured", &*TEXTURED)] {
        let mut before = f64::INFINITY;
        for rays in [64.0, 256.0, 1024.0] {
            let (mut actual, mut estimated, mut within) = (0.0, 0.0, 0.0);
            for seed in 0..SEEDS {
                let (a, e, w) = case.errors(&case.solve(rays, seed));
                actual += a * a / SEEDS as f64;
                estimated += e * e / SEEDS as f64;
                within += w / SEEDS as f64;
            }
            let (actual, estimated) = (actual.sqrt(), estimated.sqrt());
            println!("{name} {rays}: {actual:.5}, estimated {estimated:.5}, within {within:.3}");
            let of_reference = 0.5 * (rays / 8192.0f64).powf(1.2);
            let allowed = 4.0 * (2.0 * 0.025f64.powi(2) + of_reference.powi(2)).sqrt();
            assert!((actual / estimated - 1.0).abs() < allowed, "{name} {rays}: {actual}, not {estimated}");
            assert!((within - 0.95).abs() < 4.0 * 0.008, "{name} {rays}: {within} within");
            // Independent rays would halve the error. Stratified rays do better, but no error falls faster than 1/n.
            assert!(actual < 0.5 * before && actual > before / 5.0 || before.is_infinite(), "{name} {rays}");
            before = actual;
        }
    }
}

/// Variances decide how many rays each patch casts. All sixteen replicates of a patch have equally many rays of each
/// kind. The mean number of rays is the requested one, up to the 16 rays by which the last patch is rounded.
#[test]
fn replicates_have_equal_rays_and_the_mean_is_as_requested() {
    let case = &*TEXTURED;
    for rays in [50.0, 64.0, 100.0] {
        let f = case.solve(rays, 1).form_factors;
        let set = f.ray_set().unwrap();
        for i in 0..f.len() {
            assert_eq!((set.rays_of(i) % 16, f.shadow_rays_of(i) % 16), (0, 0), "patch {i} of {rays} rays");
        }
        let mean = f.rays() as f64 / f.len() as f64;
        assert!((mean - rays).abs() <= 16.0 / f.len() as f64, "{mean} rays instead of {rays}");
    }
}

/// Sampling in rounds stops at the first round whose estimated error is below the target, and the actual error then
/// keeps to the target. Actual and estimated error each scatter by 1/sqrt(2 * 100) = 7 %, as above, and their ratio
/// by 10 %; 15 % is allowed.
#[test]
fn a_wanted_error_is_reached() {
    let case = &*CORNELL_BOX;
    let target = 0.02;
    let plan = Plan::default().with_error(Some(target));
    for seed in 0..4 {
        let patches = Patches::subdivide(&case.scene, &case.subdivision);
        let cast = CastOptions::default().with_seed(seed);
        let mut reported: Vec<Round> = Vec::new();
        let (options, progress) = (SolveOptions::default(), Progress::new());
        let first = begin(&case.scene, &case.tracer, patches, &cast, &options, None, &progress).unwrap();
        let next = |_: &Solved, rounds: &[Round]| {
            reported = rounds.to_vec();
            Ok(plan.next(rounds))
        };
        let (solved, rounds) = refine(&case.scene, &case.tracer, first, &options, next, &progress).unwrap();
        assert_eq!(reported, rounds);
        assert!(rounds.len() > 1 && rounds.windows(2).all(|r| r[1].rays > r[0].rays), "{rounds:?}");
        let last = rounds.last().unwrap();
        assert!(last.error <= target && rounds[rounds.len() - 2].error > target, "{rounds:?}");
        let (actual, ..) = case.errors(&solved);
        println!("{actual:.5} {rounds:?}");
        assert!(actual <= 1.15 * target, "{actual} for {rounds:?}");
        // The round reports the mean number of rays that were cast.
        let f = &solved.form_factors;
        assert!((f.rays() as f64 / f.len() as f64 - last.rays).abs() < 1e-9);
    }
}

/// A later round keeps the rays of earlier rounds and adds to them. Rows still sum to one and stay reciprocal, to
/// rounding.
#[test]
fn more_rays_keep_those_that_were_cast() {
    let case = &*CORNELL_BOX;
    let mut patches = Patches::subdivide(&case.scene, &case.subdivision);
    let cast = CastOptions::default().with_seed(5);
    let progress = Progress::new();
    let first = FormFactors::cast(&case.scene, &case.tracer, &mut patches, &cast, &progress).unwrap();
    let before: Vec<Vec<u32>> = (0..first.len()).map(|i| first.ray_set().unwrap().of(i).to_vec()).collect();
    let second = first.cast_more(&case.scene, &case.tracer, &mut patches, 200.0, &progress).unwrap();
    for (i, before) in before.iter().enumerate() {
        assert_eq!(&second.ray_set().unwrap().of(i)[..before.len()], before, "patch {i}");
    }
    assert!(second.row_sum_deviation().after < 1e-12 && second.reciprocity_deviation().after < 1e-12);
}

/// If variances do not decide, casting in rounds and casting at once give the same rays and rows, to the bit.
#[test]
fn even_rounds_are_one_cast() {
    let case = &*CORNELL_BOX;
    for estimator in BOTH {
        let cast_at_once = |rays: f64| {
            let mut patches = Patches::subdivide(&case.scene, &case.subdivision);
            let options = CastOptions::default()
                .with_rays(rays)
                .with_estimator(estimator)
                .with_by_variance(false)
                .with_seed(5);
            let f = FormFactors::cast(&case.scene, &case.tracer, &mut patches, &options, &Progress::new());
            (f.unwrap(), patches)
        };
        let (first, mut patches) = cast_at_once(64.0);
        let rounds =
            first.cast_more(&case.scene, &case.tracer, &mut patches, 160.0, &Progress::new()).unwrap();
        let (at_once, _) = cast_at_once(160.0);
        assert_eq!(rounds.len(), at_once.len());
        for i in 0..rounds.len() {
            assert!(
                rounds.ray_set().unwrap().of(i) == at_once.ray_set().unwrap().of(i),
                "{estimator:?}: patch {i}"
            );
            assert!(rounds.row(i).eq(at_once.row(i)), "{estimator:?}: row {i}");
        }
    }
}

/// Two parallel squares one side apart see each other smoothly. The error of constant radiosity then falls with the
/// square of the edge, and so does the change between two patch sizes. Half the edge then leaves a quarter of the
/// error. An error of first order would leave a half, one of third order an eighth. The limits are the geometric means:
/// the order is nearer to two than to one or three.
#[test]
fn discretisation_falls_with_the_square_of_the_edge() {
    let squares = |edge: f64| {
        let low = rectangle(DVec3::ZERO, DVec3::X, DVec3::Y);
        let high = rectangle(DVec3::Z, DVec3::Y, DVec3::X);
        let scene = scene(&[part(low, 0.5, 0.0), part(high, 0.5, 1.0)]);
        let tracer = Tracer::new(&scene);
        let cast = CastOptions::default().with_rays(4096.0).with_seed(3);
        let (options, cut) = (SolveOptions::default().with_linear(false), Subdivision::Edge(edge));
        let solved = Solved::new(&scene, &tracer, &cut, &cast, &options, &Progress::new()).unwrap();
        let Solved { patches, form_factors, solution, .. } = &solved;
        Discretisation::of((&scene, &tracer), form_factors, patches, solution, &Progress::new())
            .unwrap()
            .unwrap()
            .relative
    };
    let [coarse, fine] = [0.8, 0.4].map(squares);
    println!("{coarse:e} {fine:e}");
    let order = (coarse / fine).log2();
    assert!((1.5..2.5).contains(&order), "{order}");
}

/// Whole triangles have an estimate of the discretisation error too. It is larger than that of the smaller patches of the
/// reference. The bias of 8192 rays is below the noise: it vanishes within four standard errors of the mean irradiance.
#[test]
fn whole_triangles_have_an_estimate_and_there_is_no_bias_beyond_noise() {
    let case = &*CORNELL_BOX;
    let whole = solve_with(&case.scene, &case.tracer, Subdivision::Edge(f64::INFINITY), 64.0, 1);
    let options = SolveOptions::default();
    let Solved { patches, form_factors, solution, .. } = &whole;
    let of = |scene, form_factors, patches, solution| {
        Discretisation::of(scene, form_factors, patches, solution, &Progress::new())
            .unwrap()
            .unwrap()
            .relative
    };
    let coarse = of((&case.scene, &case.tracer), form_factors, patches, solution);

    let Solved { patches, form_factors, solution, error_bars } = &case.reference;
    let fine = of((&case.scene, &case.tracer), form_factors, patches, solution);
    println!("{coarse} {fine}");
    assert!(fine > 0.0 && coarse > 1.5 * fine, "{coarse} {fine}");
    let bias = bias::relative(form_factors, &case.tracer, patches, solution, &options, &Progress::new());
    let bias = bias.unwrap().unwrap();
    let mean = |values: &[f64]| values.iter().sum::<f64>() / 3.0;
    let areas = form_factors.areas();
    let total: f64 = areas.iter().sum();
    let irradiance: f64 = solution.irradiance.chunks(3).zip(areas).map(|(e, a)| a / total * mean(e)).sum();
    // The difference between the halves and the whole varies as much as the whole itself.
    let allowed = 4.0 * mean(&error_bars.of_mean) / irradiance;
    println!("bias {bias:e}, allowed {allowed:e}");
    assert!(bias.abs() < allowed, "{bias} with {allowed}");
}

/// A cube whose whole ceiling emits, in 768 patches.
struct ShiningCeiling {
    scene: Scene,
    tracer: Tracer,
    reference: Solved,
}

static ROOM: LazyLock<ShiningCeiling> = LazyLock::new(ShiningCeiling::new);

impl ShiningCeiling {
    fn new() -> ShiningCeiling {
        let [x0, x1, y0, y1, floor, ceiling] = room_faces(DVec3::ZERO, DVec3::ONE);
        let walls = [x0, x1, y0, y1, floor].concat();
        let scene = scene(&[part(walls, 0.5, 0.0), part(ceiling, 0.0, 1.0)]);
        let tracer = Tracer::new(&scene);
        let reference = Self::solve_in(&scene, &tracer, 8192.0, 1000);
        ShiningCeiling { scene, tracer, reference }
    }

    fn solve(&self, rays: f64, seed: u64) -> Solved {
        Self::solve_in(&self.scene, &self.tracer, rays, seed)
    }

    /// Light is constant on each patch. Linear light would depend on the number of rays, because slopes are reduced by
    /// their noise.
    fn solve_in(scene: &Scene, tracer: &Tracer, rays: f64, seed: u64) -> Solved {
        let cast = CastOptions::default().with_rays(rays).with_seed(seed);
        let options = SolveOptions::default().with_linear(false);
        Solved::new(scene, tracer, &Subdivision::Count(700), &cast, &options, &Progress::new()).unwrap()
    }
}

/// The light of a ceiling that emits as a whole reaches floor and walls in the right proportion. The mean of 32 casts
/// of few rays agrees with the reference of 8192 rays within five standard errors. The error of the reference is at
/// most a tenth of the error of one cast, since errors fall at least with the power 0.6 of the rays; five times that is
/// added.
#[test]
fn a_large_lamp_divides_its_light_right() {
    const SEEDS: u64 = 32;
    let room = &*ROOM;
    let means = |solved: &Solved| -> Vec<f64> {
        let (patches, mut means) = (&solved.patches, vec![0.0; room.scene.triangles.len()]);
        for i in 0..patches.len() {
            let t = patches.triangle(i);
            means[t] += solved.solution.irradiance[i] * patches.area(i) / patches.triangle_areas()[t];
        }
        means
    };
    let truth = means(&room.reference);
    let casts: Vec<Vec<f64>> = (0..SEEDS).map(|seed| means(&room.solve(64.0, seed))).collect();
    for t in 0..truth.len() {
        let off: Vec<f64> = casts.iter().map(|means| means[t] / truth[t] - 1.0).collect();
        let mean = off.iter().sum::<f64>() / SEEDS as f64;
        let variance = off.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (SEEDS - 1) as f64;
        let allowed = 5.0 * (variance / SEEDS as f64).sqrt() + 5.0 * 0.1 * variance.sqrt();
        println!("triangle {t}: off by {mean:+.4}, {allowed:.4} allowed");
        assert!(mean.abs() <= allowed && allowed < 0.02, "triangle {t}: {mean}, {allowed} allowed");
    }
}

/// Light that returns to such a ceiling is estimated no worse than by 16 independent rays of each of its patches, the
/// least that a patch casts. The variance of such a ray is the variance of the radiosity that it sees. Also, 95 %
/// intervals contain the reference. The patches of one seed share rays, so the tolerance of the share comes from its
/// spread between seeds: 4.8 standard errors with seven degrees of freedom, which chance exceeds in 2 cases of 1000.
/// Another 2 % is allowed because error bars are an approximation.
#[test]
fn light_that_returns_to_a_large_lamp_is_known_to_its_bar() {
    const SEEDS: u64 = 8;
    let room = &*ROOM;
    let Solved { patches, form_factors, solution: truth, .. } = &room.reference;
    let lamps: Vec<usize> = (0..patches.len()).filter(|&i| patches.emission()[i] > 0.0).collect();
    let mean = |of: &dyn Fn(usize) -> f64| lamps.iter().map(|&i| of(i)).sum::<f64>() / lamps.len() as f64;
    let seen = |i: usize| form_factors.row(i).map(|(j, f)| f * truth.radiosity[j].powi(2)).sum::<f64>();
    let of_own_rays = (mean(&|i| seen(i) - truth.irradiance[i].powi(2)) / 16.0).sqrt();
    for rays in [64.0, 256.0, 1024.0] {
        let (mut squares, mut shares) = (0.0, Vec::new());
        for seed in 0..SEEDS {
            let solved = room.solve(rays, seed);
            let off = |i: usize| (solved.solution.irradiance[i] - truth.irradiance[i]).abs();
            let bar = |i: usize| T_QUANTILE * solved.error_bars.standard_error[i];
            squares += mean(&|i| off(i).powi(2)) / SEEDS as f64;
            shares.push(mean(&|i| if off(i) <= bar(i) { 1.0 } else { 0.0 }));
        }
        let share = shares.iter().sum::<f64>() / SEEDS as f64;
        let variance = shares.iter().map(|s| (s - share).powi(2)).sum::<f64>() / (SEEDS - 1) as f64;
        let band = 4.8 * (variance / SEEDS as f64).sqrt() + 0.02;
        println!("{rays}: off by {:.5}, own rays {of_own_rays:.5}; {share:.4} ± {band:.4}", squares.sqrt());
        assert!(squares.sqrt() <= of_own_rays, "{rays}: {} beyond {of_own_rays}", squares.sqrt());
        assert!((share - 0.95).abs() <= band, "{rays}: {share} within, band {band}");
    }
}

/// Blocks with all their faces: light between touching blocks is much brighter than the room, but nobody sees it. So
/// it changes neither the exposure, up to 3 % of sampling noise, nor the relative error.
#[test]
fn exposure_and_errors_count_what_can_be_seen() {
    // Two faces of the room emit. With `between`, the faces between blocks are there too, and much brighter.
    let shell = |between: bool| {
        let [inner, outer, hidden] = [
            room_of_blocks(|touches, room| !touches && room),
            room_of_blocks(|touches, room| !touches && !room),
            room_of_blocks(|touches, _| touches && between),
        ];
        let shiny = inner[..2].to_vec();
        scene(&[
            part(inner[2..].to_vec(), 0.5, 0.0),
            part(shiny, 0.5, 1.0),
            part(outer, 0.5, 0.0),
            part(hidden, 0.9, 9.0),
        ])
    };
    let solve = |between: bool| {
        let scene = shell(between);
        solve_with(&scene, &Tracer::new(&scene), Subdivision::Edge(0.5), 256.0, u64::from(between))
    };
    let [with, without] = [true, false].map(solve);
    let exposed = |s: &Solved| exposure::of_radiosity(&s.patches, &s.solution.radiosity).scale;
    let seen = [&with, &without].map(|s| s.patches.seen_areas(&s.solution.irradiance));
    // Visible are the 6 faces of the room and the 54 outer faces. No ray hits a back, so no back is a patch.
    assert!(seen.iter().all(|areas| (areas.iter().sum::<f64>() - 60.0).abs() < 1e-9));
    let ratio = exposed(&with) / exposed(&without);
    assert!((ratio - 1.0).abs() < 0.03, "{ratio}");
    // The reported errors are errors of the room, not of the light between the blocks: they explain by how much the light
    // of the room differs between the two. The faces of the room come first in both. Errors of patches are correlated, so
    // that the difference of one pair of runs may be off by a factor of two.
    let errors = [&with, &without].map(|s| {
        let areas = s.patches.seen_areas(&s.solution.irradiance);
        relative_rms(&s.error_bars.standard_error, &s.solution.irradiance, &areas)
    });
    let lights = [&with, &without].map(|s| &s.solution.irradiance[..without.patches.len()]);
    let difference: Vec<f64> = lights[0].iter().zip(lights[1]).map(|(a, b)| a - b).collect();
    let measured = relative_rms(&difference, lights[1], &seen[1]);
    let ratio = measured / errors[0].hypot(errors[1]);
    assert!((0.5..2.0).contains(&ratio), "{measured} of {errors:?}");
    // The light between the blocks takes no rays from the room. Both scenes cast the same number of rays a patch, and the
    // patches between the blocks leave more to the room. Estimates of errors scatter by 10 %.
    println!("errors with and without hidden light: {errors:?}");
    assert!(errors[0] < 1.1 * errors[1], "{errors:?}");
}

/// A room beside a sealed one that is a thousand times brighter has the error that it has beside an equally bright one.
/// Patches that face the bright lamp behind the wall send three quarters of their shadow rays to it, so that the error of
/// their direct light may double.
#[test]
fn a_bright_sealed_room_takes_no_rays_from_a_dim_one() {
    let error = |brightness: f64| {
        let room = |x: f64, emission: f64| {
            let at = DVec3::X * x;
            let walls = room_faces(at, at + DVec3::ONE).concat();
            let lamp = rectangle(at + DVec3::new(0.2, 0.2, 0.9), DVec3::Y * 0.3, DVec3::X * 0.3);
            let shade = rectangle(at + DVec3::new(0.3, 0.3, 0.5), DVec3::X * 0.4, DVec3::Y * 0.4);
            [part(walls, 0.5, 0.0), part(lamp, 0.0, emission), part(shade, 0.5, 0.0)]
        };
        let parts: Vec<Part> = room(0.0, 1.0).into_iter().chain(room(1.5, brightness)).collect();
        let scene = scene(&parts);
        let tracer = Tracer::new(&scene);
        let of_seed = |seed| {
            let Solved { patches, form_factors, solution, error_bars } =
                solve_with(&scene, &tracer, Subdivision::Count(600), 64.0, seed);
            // The first half of the front patches are the dim room.
            let dim = patches.fronts() / 2;
            let areas = &form_factors.areas()[..dim];
            relative_rms(&error_bars.standard_error[..dim], &solution.irradiance[..dim], areas).powi(2)
        };
        (0..4).map(of_seed).sum::<f64>().sqrt()
    };
    let [alike, beside_bright] = [1.0, 1000.0].map(error);
    println!("beside an equal room {alike:.5}, beside a bright one {beside_bright:.5}");
    assert!(beside_bright < 2.0 * alike, "{beside_bright} instead of {alike}");
}
