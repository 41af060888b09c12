//! Sizes side by side: what is small is right beside what is large.

use crate::common::*;
use glam::{DQuat, DVec3, EulerRot, dvec3};
use radiosity::{
    Error, Progress, Scene,
    form_factor::{
        Estimator,
        exact::{opposed_rectangles, point_to_polygon},
    },
    monte_carlo::{Effort, PathOptions, PathTracer, Receiver},
    trace::Tracer,
};

/// So that no coordinate is exact.
fn turn(is_turned: bool) -> DQuat {
    if is_turned { DQuat::from_euler(EulerRot::XYZ, 0.3, 1.1, -2.0) } else { DQuat::IDENTITY }
}

fn placed(triangles: Vec<Corners>, by: DQuat) -> Vec<Corners> {
    triangles.into_iter().map(|t| t.map(|p| by * p)).collect()
}

/// Squares of 1 m, this far apart, that face each other in the middle of a dome. Which of the three emits.
fn plates(gap: f64, radius: f64, by: DQuat, emits: Option<usize>) -> [Part; 3] {
    let parts = [level_square(1.0, 0.0, true), level_square(1.0, gap, false), flipped(icosphere(radius, 1))];
    let mut k = 0;
    parts.map(|triangles| {
        k += 1;
        part(placed(triangles, by), 0.0, if emits == Some(k - 1) { 1.0 } else { 0.0 })
    })
}

/// Two squares exchange what their closed form says, and the dome gets the rest, whoever casts the rays.
#[test]
fn plates_exchange_beneath_domes_of_kilometres_what_they_do_alone() {
    for (gap, radius) in [(0.02, 2e4), (1e-3, 1e3)] {
        let exact = opposed_rectangles(1.0, 1.0, gap);
        for (is_turned, emits) in [(false, None), (true, Some(0)), (false, Some(2)), (true, Some(2))] {
            let parts = plates(gap, radius, turn(is_turned), emits);
            let found = cast_whole(&parts, 4096.0, Estimator::Pooled, 1);
            assert!(matches!(found.tracer.check_gaps(&found.scene), Ok(None)));
            for (from, to, truth) in [(0, 1, exact), (1, 0, exact), (0, 2, 1.0 - exact), (1, 2, 1.0 - exact)]
            {
                let measured = found.form_factor(from, to);
                measured.assert_is(truth, 1e-4);
            }
        }
    }
}

/// A sensor between the plates sees of a shining dome what the upper plate leaves free.
#[test]
fn sensors_between_plates_see_the_rest_of_the_dome() {
    let places =
        [dvec3(0.0, 0.0, 0.0), dvec3(0.45, 0.3, 0.0), dvec3(0.49, 0.0, 0.005), dvec3(0.3, 0.1, -1e-9)];
    for (radius, is_turned) in [(1e3, false), (2e4, false), (2e4, true)] {
        let by = turn(is_turned);
        let scene = scene(&plates(0.02, radius, by, Some(2)));
        let tracer = Tracer::new(&scene);
        let paths = PathTracer::new(&scene, &tracer, PathOptions::default());
        let receivers = places.map(|p| Receiver::free(&tracer, by * p, by * DVec3::Z));
        let effort = Effort::default().with_samples(1 << 16);
        let found = paths.irradiances(&receivers, &effort, &Progress::new()).unwrap();
        for (p, found) in places.iter().zip(found) {
            let above: Vec<DVec3> =
                [(-0.5, -0.5), (-0.5, 0.5), (0.5, 0.5), (0.5, -0.5)].map(|(x, y)| dvec3(x, y, 0.02)).to_vec();
            let truth = 1.0 - point_to_polygon(*p, DVec3::Z, &above);
            let [mean, error] = [found.mean[0], found.standard_error[0]];
            assert!(
                (mean - truth).abs() < 4.5 * error + 1e-4,
                "{radius} {is_turned} {p}: {mean} ± {error}, {truth}"
            );
        }
    }
}

/// A table beneath an evenly bright dome: what the ground gets beside and beneath it does not depend on how far the ground goes, nor on a turn.
#[test]
fn a_table_casts_the_same_shadow_on_a_ground_of_ten_kilometres() {
    let block = |low: DVec3, high: DVec3| flipped(room(low, high));
    let table = |by: DQuat, half: f64| {
        let mut all = block(dvec3(-0.6, -0.4, 0.73), dvec3(0.6, 0.4, 0.75));
        for (x, y) in [(-0.55, -0.35), (0.5, -0.35), (-0.55, 0.3), (0.5, 0.3)] {
            all.extend(block(dvec3(x, y, 0.0), dvec3(x + 0.05, y + 0.05, 0.73)));
        }
        let mut scene = scene(&[
            part(placed(all, by), 0.5, 0.0),
            part(placed(level_square(2.0 * half, 0.0, true), by), 0.5, 0.0),
            part(placed(flipped(icosphere(2.0 * half, 2)), by), 0.0, 1.0),
        ]);
        scene.cut_contacts();
        scene
    };
    let places = [dvec3(0.0, 0.0, 0.0), dvec3(0.3, 0.5, 0.0), dvec3(0.45, 0.3, 0.0), dvec3(0.1, 0.2, 0.75)];
    let measure = |is_turned: bool, half: f64| {
        let by = turn(is_turned);
        let scene = table(by, half);
        let tracer = Tracer::new(&scene);
        let paths = PathTracer::new(&scene, &tracer, PathOptions::default().with_max_bounces(Some(0)));
        let receivers = places.map(|p| Receiver::free(&tracer, by * p, by * DVec3::Z));
        let effort = Effort::default().with_samples(1 << 15);
        paths.irradiances(&receivers, &effort, &Progress::new()).unwrap()
    };
    let small = measure(false, 10.0);
    for (is_turned, half) in [(true, 10.0), (false, 5e3), (true, 5e3)] {
        for (p, (a, b)) in places.iter().zip(small.iter().zip(measure(is_turned, half))) {
            let error = a.standard_error[0].hypot(b.standard_error[0]);
            assert!((a.mean[0] - b.mean[0]).abs() < 4.5 * error + 1e-3 * a.mean[0], "{half} {is_turned} {p}");
        }
    }
}

/// Plates a millionth of the scene apart see nothing but each other, to what the gap lets out.
#[test]
fn a_gap_of_a_millionth_of_the_scene_is_a_gap() {
    for is_turned in [false, true] {
        let parts = [level_square(1.0, 0.0, true), level_square(1.0, 1e-6, false)];
        let parts = parts.map(|t| black(placed(t, turn(is_turned))));
        let found = cast_whole(&parts, 4096.0, Estimator::Pooled, 1);
        found.form_factor(0, 1).assert_is(1.0, 1e-4);
        found.form_factor(1, 0).assert_is(1.0, 1e-4);
    }
}

/// Two pairs of plates kilometres apart: the origin of unit space cannot be by both. What rays do not resolve is an error that names
/// the faces, and what they resolve badly a gap with its figure.
#[test]
fn what_single_precision_cannot_hold_is_told() {
    let check = |gap: f64| {
        let pair = |x: f64| {
            let by = turn(true);
            let at =
                |t: Vec<Corners>| placed(t.into_iter().map(|t| t.map(|p| p + DVec3::X * x)).collect(), by);
            [black(at(level_square(1.0, 0.0, true))), black(at(level_square(1.0, gap, false)))]
        };
        let scene: Scene = scene(&pair(-1e4).into_iter().chain(pair(1e4)).collect::<Vec<_>>());
        Tracer::new(&scene).check_gaps(&scene)
    };
    let resolved = match check(2e-3) {
        Err(Error::UnresolvedGap { triangles: [a, b], width, resolved }) => {
            assert!((width - 2e-3).abs() < 1e-9 && resolved > 2e-3 && resolved < 0.1, "{width} {resolved}");
            assert_eq!((a / 4, (a % 4) / 2), (b / 4, 1 - (b % 4) / 2), "{a} {b}");
            resolved
        }
        other => panic!("{other:?}"),
    };
    let gap = check(10.0 * resolved).unwrap().expect("a narrow gap");
    assert!((gap.share() - 0.1).abs() < 0.01, "{gap:?}");
    assert_eq!(check(60.0 * resolved).unwrap(), None);
}
