//! Subdivision, sampling and matrices of random input.

use crate::common::*;
use glam::{DVec3, Vec3A, dvec3};
use proptest::{prelude::*, test_runner::RngSeed};
use radiosity::{
    Scene,
    form_factor::CastOptions,
    patch::{Patches, Subdivision},
    trace::sampling::{around, sobol_4d, square_to_cosine_hemisphere, square_to_triangle},
};

fn point() -> impl Strategy<Value = DVec3> {
    (-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64).prop_map(|(x, y, z)| dvec3(x, y, z))
}

/// Any triangle, from a well-shaped one to a sliver a millionth as wide as long.
fn triangle() -> impl Strategy<Value = Corners> {
    (point(), point(), point(), -6.0..0.0f64).prop_map(|(a, b, c, squeeze)| {
        let along = a + (b - a) * 0.3;
        [a, b, along + (c - along) * 10f64.powf(squeeze)]
    })
}

fn soup(most: usize) -> impl Strategy<Value = Scene> {
    prop::collection::vec((triangle(), 0u32..2), 1..most).prop_map(|triangles| {
        let parts = [0, 1].map(|m| {
            let of = |(t, k): &(Corners, u32)| (*k == m).then_some(*t);
            part(triangles.iter().filter_map(of).collect(), 0.5, f64::from(m))
        });
        scene(&parts)
    })
}

fn longest_edge([a, b, c]: Corners) -> f64 {
    a.distance(b).max(b.distance(c)).max(c.distance(a))
}

fn patch_corners(scene: &Scene, patches: &Patches, i: usize) -> Corners {
    let t = scene.corners(patches.triangle(i));
    patches.barycentric_corners(i).map(|b| t[0] * b[0] + t[1] * b[1] + t[2] * b[2])
}

/// The number of patches for an edge length, by definition: each triangle is halved until no edge is longer.
fn patches_at(scene: &Scene, edge: f64) -> f64 {
    let levels = |t| (longest_edge(scene.corners(t)) / edge).log2().ceil().max(0.0);
    (0..scene.triangles.len()).map(|t| 4f64.powf(levels(t))).sum()
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 200,
        failure_persistence: None,
        rng_seed: RngSeed::Fixed(1),
        ..ProptestConfig::default()
    })]

    /// Patches have the area of the mesh, and no edge is longer than asked. The tolerances are the rounding of a sum
    /// over some hundred patches and of halved corners.
    #[test]
    fn patches_cover_the_mesh_and_respect_the_edge(scene in soup(8), edge in 0.1..3.0f64) {
        let patches = Patches::subdivide(&scene, &Subdivision::Edge(edge));
        let mesh: f64 = (0..scene.triangles.len()).map(|t| scene.area(t)).sum();
        let sum: f64 = (0..patches.len()).map(|i| patches.area(i)).sum();
        prop_assert!((sum / mesh - 1.0).abs() < 1e-12);
        prop_assert_eq!(Patches::forecast(&scene, &Subdivision::Edge(edge)), patches.len() as f64);
        for i in 0..patches.len() {
            let corners = patch_corners(&scene, &patches, i);
            prop_assert!(longest_edge(corners) <= edge * (1.0 + 1e-11));
            // In a sliver the rounding of corners, 2e-16 of the length, is a larger part of the width.
            let slack = 1e-14 * longest_edge(scene.corners(patches.triangle(i)));
            prop_assert!((area(&[corners]) - patches.area(i)).abs() <= slack);
        }
        // One level less would leave a longer edge.
        for t in (0..scene.triangles.len()).filter(|&t| patches.level(t) > 0) {
            let coarser = longest_edge(scene.corners(t)) / f64::from(1u32 << (patches.level(t) - 1));
            prop_assert!(coarser > edge * (1.0 - 1e-11));
        }
    }

    /// No edge length gives a number of patches whose ratio to the wanted number is nearer to one.
    #[test]
    fn counts_are_the_nearest(scene in soup(8), count in 1usize..3000) {
        let patches = Patches::subdivide(&scene, &Subdivision::Count(count));
        let off = |n: f64| (n / count as f64).ln().abs();
        let got = off(patches.len() as f64);
        // The number changes only at edge lengths that halve some triangle exactly. Try both sides of all of them.
        for t in 0..scene.triangles.len() {
            for level in 0..12 {
                let step = longest_edge(scene.corners(t)) / f64::from(1u32 << level);
                for edge in [step * (1.0 - 1e-9), step * (1.0 + 1e-9)] {
                    let other = patches_at(&scene, edge);
                    prop_assert!(got <= off(other) + 1e-9, "{} for {count}, {other} is nearer", patches.len());
                }
            }
        }
    }

    /// Every point well inside a patch is found in it, on both sides.
    #[test]
    fn points_are_found_in_their_patch(scene in soup(4), edge in 0.1..1.0f64, x in 0f32..1.0, y in 0f32..1.0) {
        let mut patches = Patches::subdivide(&scene, &Subdivision::Edge(edge));
        let b = square_to_triangle(x, y).map(f64::from);
        // Away from the rim by more than the single precision of the finest level here, 32 times 1e-7.
        let b = b.map(|w| 0.999 * w + 0.001 / 3.0);
        let fronts = patches.fronts();
        for i in 0..fronts {
            let corners = patches.barycentric_corners(i);
            let at: [f32; 3] =
                std::array::from_fn(|k| (0..3).map(|c| b[c] * corners[c][k]).sum::<f64>() as f32);
            let t = patches.triangle(i) as u32;
            prop_assert_eq!(patches.at(t, at, true), Some(i as u32));
            prop_assert_eq!(patches.at(t, at, false), patches.back_of(i));
        }
        let all: Vec<u32> = (0..scene.triangles.len() as u32).rev().collect();
        patches.add_backs(&scene, &all);
        prop_assert_eq!(patches.len(), 2 * fronts);
        for i in fronts..2 * fronts {
            let corners = patches.barycentric_corners(i);
            let middle = std::array::from_fn(|k| (corners.iter().map(|c| c[k]).sum::<f64>() / 3.0) as f32);
            prop_assert_eq!(patches.at(patches.triangle(i) as u32, middle, false), Some(i as u32));
            prop_assert_eq!(patches.emission()[i], 0.0);
        }
    }

    /// Whatever surfaces intersect, no form factor is negative, pairs are reciprocal and rows sum to one, to the
    /// tolerance of the closure.
    #[test]
    fn matrices_of_soups(scene in soup(12), seed in any::<u64>()) {
        let options = CastOptions::default().with_seed(seed);
        let cast = cast(scene, Subdivision::Count(60), options);
        let f = &cast.form_factors;
        let (closure, reciprocity) = deviations(f);
        prop_assert!((f.row_sum_deviation().after - closure).abs() < 1e-13);
        prop_assert!(closure <= 1e-12, "rows off by {closure:e}");
        prop_assert!(reciprocity <= 1e-12, "{reciprocity:e}");
        for i in 0..f.len() {
            prop_assert!(f.escaped()[i] >= 0.0);
            prop_assert!(f.row(i).all(|(_, x)| x >= 0.0 && x.is_finite()));
        }
    }

    /// Sampled directions have unit length and keep their cosine when they are rotated to a normal, to single
    /// precision.
    #[test]
    fn directions_keep_length_and_side(x in 0f32..1.0, y in 0f32..1.0, u in 0f32..1.0, v in 0f32..1.0) {
        let lifted = square_to_cosine_hemisphere(x, y);
        // Six roundings, of coordinates and their squares.
        prop_assert!((lifted.length() - 1.0).abs() <= 6.0 * f32::EPSILON && lifted.z >= 0.0);
        let normal = square_to_cosine_hemisphere(u, v) * if u < 0.5 { 1.0 } else { -1.0 };
        let turned = around(normal, lifted);
        // The length of the normal has the same rounding.
        prop_assert!((turned.length() - 1.0).abs() <= 16.0 * f32::EPSILON);
        prop_assert!((turned.dot(normal) - lifted.z).abs() <= 16.0 * f32::EPSILON);
    }
}

/// Means over 2¹⁶ points of the sequence are those of the densities. Five standard errors of independent points are
/// allowed; the sequence has smaller errors. Fails with uniform directions (mean cosine 1/2), or with the square folded
/// without its density.
#[test]
fn samples_have_the_moments_of_their_densities() {
    const N: u32 = 1 << 16;
    let (mut corners, mut squares, mut products) = ([0f64; 3], [0f64; 3], 0f64);
    let (mut direction, mut cosine_squares) = (glam::DVec3::ZERO, 0f64);
    for index in 0..N {
        let [x, y, u, v] = sobol_4d(index, 99);
        let b = square_to_triangle(x, y).map(f64::from);
        for k in 0..3 {
            corners[k] += b[k] / f64::from(N);
            squares[k] += b[k] * b[k] / f64::from(N);
        }
        products += b[0] * b[1] / f64::from(N);
        let d: Vec3A = square_to_cosine_hemisphere(u, v);
        direction += d.as_dvec3() / f64::from(N);
        cosine_squares += f64::from(d.z * d.z) / f64::from(N);
    }
    // No sampled quantity has a variance above 1/2.
    let near = |got: f64, wanted: f64, variance: f64| {
        let error = (variance / f64::from(N)).sqrt();
        assert!((got - wanted).abs() <= 5.0 * error, "{got} instead of {wanted}");
    };
    for k in 0..3 {
        near(corners[k], 1.0 / 3.0, 1.0 / 18.0);
        // E b⁴ = 1/15.
        near(squares[k], 1.0 / 6.0, 1.0 / 15.0 - 1.0 / 36.0);
    }
    // E b0² b1² = 2! 2! 2! / 6! = 1/90.
    near(products, 1.0 / 12.0, 1.0 / 90.0 - 1.0 / 144.0);
    near(direction.x, 0.0, 0.25);
    near(direction.y, 0.0, 0.25);
    near(direction.z, 2.0 / 3.0, 0.5 - 4.0 / 9.0);
    near(cosine_squares, 0.5, 1.0 / 12.0);
}
