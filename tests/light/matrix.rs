//! Invariants of every matrix of form factors by rays: closure, reciprocity and bounds, whatever the scene.

use crate::common::*;
use glam::{DVec3, dvec3};
use radiosity::{
    Scene,
    form_factor::{CastOptions, Estimator, rays::ESCAPED},
    patch::Subdivision,
};

/// A room of 100 by 100 in few triangles, with a cube of a hundredth in it: areas from 5e-5 to 5e3.
fn uneven(exitance: f64) -> Scene {
    let [x0, x1, y0, y1, floor, ceiling] = room_faces(DVec3::ZERO, dvec3(100.0, 100.0, 40.0));
    let crumb = flipped(room(dvec3(50.0, 50.0, 0.5), dvec3(50.01, 50.01, 0.51)));
    scene(&[black([x0, x1, y0, y1, floor].concat()), part(ceiling, 0.5, exitance), black(crumb)])
}

fn open_and_occluded() -> Scene {
    scene(&[
        black(level_square(1.0, 0.0, true)),
        part(level_square(0.5, 1.0, false), 0.0, 1.0),
        black(level_square(0.3, 0.5, true)),
    ])
}

fn scenes() -> Vec<(&'static str, Cast)> {
    let cases = [
        ("closed, occluded", load("furnace"), Subdivision::Count(400)),
        ("a slit", load("door-ajar"), Subdivision::Count(600)),
        ("textured", load("textured"), Subdivision::Count(300)),
        ("open", load("cornell-box"), Subdivision::Count(400)),
        ("open, occluded", open_and_occluded(), Subdivision::Edge(0.2)),
        ("uneven, lit", uneven(1.0), Subdivision::Edge(f64::INFINITY)),
        ("uneven, dark", uneven(0.0), Subdivision::Edge(30.0)),
    ];
    cases.into_iter().map(|(name, scene, cut)| (name, cast(scene, cut, CastOptions::default()))).collect()
}

/// Rows sum to one and are reciprocal to 1e-12, the tolerance of the closure. The bounds F_ij ≤ 1 and A_i F_ij ≤ A_j
/// hold to the same tolerance, since they are partial sums of closed rows.
#[test]
fn pooled_matrices_are_closed_reciprocal_and_bounded() {
    for (name, cast) in scenes() {
        let f = &cast.form_factors;
        let (closure, reciprocity) = deviations(f);
        println!("{name}: {} patches, {closure:e} {reciprocity:e}, {:?}", f.len(), f.row_sum_deviation());
        assert!(closure <= 1e-12 && reciprocity <= 1e-12, "{name}: {closure:e}, {reciprocity:e}");
        // The same sums with the factors taken out or left in: each of some hundred terms rounds once more.
        assert!((f.row_sum_deviation().after - closure).abs() <= 1e-13, "{name}");
        assert!((f.reciprocity_deviation().after - reciprocity).abs() <= 1e-15, "{name}");
        for i in 0..f.len() {
            assert!((0.0..=1.0 + 1e-12).contains(&f.escaped()[i]));
            for (j, x) in f.row(i) {
                let ratio = f.areas()[j] / f.areas()[i];
                assert!(x >= 0.0 && x <= ratio.min(1.0) * (1.0 + 1e-12), "{name}: F[{i}][{j}] = {x}");
            }
        }
        if name.starts_with("closed") || name == "a slit" || name == "textured" {
            assert!(f.escaped().iter().all(|&e| e == 0.0), "{name}: light escapes");
        }
    }
}

/// One-way form factors keep the bounds although nothing enforces them. With R rays, the hits on patch j have a mean m
/// of at most R A_j / A_i. By Bernstein's inequality more than m + x hits have a probability below e^-l for
/// x = l/3 + sqrt(l²/9 + 2 m l).
#[test]
fn one_way_counts_keep_the_bounds() {
    for (name, lit) in scenes() {
        let options = CastOptions::default().with_estimator(Estimator::OneWay);
        let cast = cast(lit.scene, Subdivision::Edge(lit.patches.edge()), options);
        let f = &cast.form_factors;
        let l = (f.non_zeros() as f64 / 1e-4).ln();
        for i in 0..f.len() {
            let sum: f64 = f.row(i).map(|(_, x)| x).sum();
            // 64 rays: sums of multiples of 1/64 are exact.
            assert_eq!(sum + f.escaped()[i], 1.0, "{name}");
            let rays = f64::from(f.ray_set().unwrap().rays_of(i));
            for (j, x) in f.row(i) {
                let m = rays * f.areas()[j] / f.areas()[i];
                let most = m + l / 3.0 + (l * l / 9.0 + 2.0 * m * l).sqrt();
                assert!(x * rays <= most, "{name}: {} hits of {j} from {i}, {most} at most", x * rays);
            }
        }
    }
}

/// The reported deviations before the repairs agree with deviations recomputed from the rays alone.
#[test]
fn deviations_before_are_those_of_the_rays() {
    let options =
        CastOptions::default().with_rays(48.0).with_shadow_share(0.0).with_by_variance(false).with_seed(2);
    let cut = Subdivision::Edge(30.0);
    let pooled = cast(uneven(0.0), cut, options).form_factors;
    let one_way = cast(uneven(0.0), cut, options.with_estimator(Estimator::OneWay)).form_factors;
    let n = pooled.len();
    assert_eq!(one_way.len(), n);

    let (_, reciprocity) = deviations(&one_way);
    let reported = [pooled.reciprocity_deviation().before, one_way.reciprocity_deviation().before];
    for reported in reported.into_iter().chain([one_way.reciprocity_deviation().after]) {
        assert!((reported / reciprocity - 1.0).abs() < 1e-12, "{reported}, recomputed {reciprocity}");
    }
    assert!(reciprocity > 0.1, "48 rays are not reciprocal by chance");

    // S_ij = (h_ij + h_ji) / (R_i/A_i + R_j/A_j).
    let (hits, a) = (pooled.ray_set().unwrap(), pooled.areas());
    let density = |i: usize| f64::from(hits.rays_of(i)) / a[i];
    let (mut sums, mut escaped) = (vec![0.0; n], vec![0.0; n]);
    for i in 0..n {
        for &target in hits.of(i) {
            if target == ESCAPED {
                escaped[i] += 1.0 / f64::from(hits.rays_of(i));
            } else {
                let j = target as usize;
                let exchange = 1.0 / (density(i) + density(j));
                sums[i] += exchange;
                sums[j] += exchange;
            }
        }
    }
    let worst = (0..n).map(|i| (sums[i] / a[i] + escaped[i] - 1.0).abs()).fold(0.0, f64::max);
    let reported = pooled.row_sum_deviation().before;
    // Entries are stored in single precision: the error of a row sum is at most the sum times that rounding.
    assert!((reported - worst).abs() <= F32 * (1.0 + worst), "{reported}, recomputed {worst}");
    assert!(worst > 0.01, "48 rays are not closed by chance");
}

/// Backs become patches if rays see them, and only then.
#[test]
fn backs_that_are_seen() {
    let closed = cast(load("furnace"), Subdivision::Edge(0.3), CastOptions::default());
    assert_eq!(closed.patches.len(), closed.patches.fronts());
    assert_eq!(closed.form_factors.ray_set().unwrap().back_hits(), 0);

    // The plate is the third part of seven, but its backs come last.
    let [x0, x1, y0, y1, floor, ceiling] = room_faces(DVec3::ZERO, DVec3::ONE).map(black);
    let corner = dvec3(0.3, 0.3, 0.5);
    let plate = black(rectangle(corner, DVec3::X * 0.4, DVec3::Y * 0.4));
    for rays in [64.0, 1024.0] {
        let options = CastOptions::default().with_rays(rays);
        let parts = [&x0, &x1, &plate, &y0, &y1, &floor, &ceiling];
        let parts = parts.map(|p| black(p.triangles.clone()));
        let room = cast(scene(&parts), Subdivision::Edge(0.3), options);
        let plate = room.of_part(2);
        assert!(plate.len() > 2);
        assert_eq!(room.patches.len(), room.patches.fronts() + plate.len());
        assert_eq!(room.form_factors.len(), room.patches.len());
        for i in 0..room.patches.fronts() {
            let back = room.patches.back_of(i);
            assert_eq!(back.is_some(), plate.contains(&i));
            if let Some(back) = back.map(|b| b as usize) {
                assert!(!room.patches.is_front(back));
                assert_eq!(room.patches.barycentric_corners(back), room.patches.barycentric_corners(i));
                assert_eq!(room.patches.area(back), room.patches.area(i));
                // The two sides of a plane see neither each other nor themselves.
                for (p, q) in [(i, back), (back, i), (i, i), (back, back)] {
                    assert_eq!(room.form_factors.get(p, q), 0.0);
                }
            }
        }
    }

    // Two floors that both look up: the lower sees the back of the upper.
    let stage = [black(level_square(1.0, 0.0, true)), black(level_square(1.0, 1.0, true))];
    let stage = cast_whole(&stage, 256.0, Estimator::Pooled, 0);
    assert_eq!((stage.patches.fronts(), stage.patches.len()), (4, 6));
    assert_eq!([0, 1].map(|i| stage.patches.back_of(i)), [None; 2]);
}

/// A triangle that faces away from all others, and that none of them sees, has an empty row. Its light escapes, and the
/// rows of the others do not refer to it.
#[test]
fn a_patch_that_sees_nothing_loses_everything() {
    let lit = |lonely: bool| {
        let mut parts =
            vec![part(level_square(1.0, 0.0, true), 0.5, 0.0), part(level_square(1.0, 1.0, false), 0.5, 1.0)];
        if lonely {
            parts.push(part(level_square(1.0, 3.0, true), 0.5, 0.0));
        }
        cast(scene(&parts), Subdivision::Edge(0.4), CastOptions::default())
    };
    let f = lit(true).form_factors;
    let n = lit(false).form_factors.len();
    for i in 0..n {
        assert!(f.escaped()[i] < 1.0 && f.row(i).all(|(j, x)| j < n && x.is_finite()));
    }
    for i in n..f.len() {
        assert_eq!((f.escaped()[i], f.row(i).count()), (1.0, 0));
    }
    assert!(f.row_sum_deviation().after <= 1e-12);
}
