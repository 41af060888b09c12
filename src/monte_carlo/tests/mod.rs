//! Tests of the physics: against closed forms, and of estimators against each other.

mod agreement;
mod books;
mod gloss;
mod mitsuba;
mod truths;

use glam::{DVec3, dvec3};

use super::*;
use crate::scene::{Material, Scene};

pub(crate) type Faces = Vec<([DVec3; 3], u32)>;

/// One grey material.
pub(crate) fn grey(reflectance: f64, emission: f64) -> Vec<Material> {
    vec![Material::new("grey", [reflectance; 3], [emission; 3])]
}

/// A quadrilateral of two triangles, with counter-clockwise corners.
pub(crate) fn quad(corners: [DVec3; 4], material: u32) -> Faces {
    let [a, b, c, d] = corners;
    vec![([a, b, c], material), ([a, c, d], material)]
}

/// The twelve triangles of a box of material 0, with fronts that face inwards or outwards.
pub(crate) fn box_walls(low: DVec3, high: DVec3, inwards: bool) -> Faces {
    let corner = |i: usize| {
        let pick = |axis: usize| if i >> axis & 1 == 0 { low[axis] } else { high[axis] };
        dvec3(pick(0), pick(1), pick(2))
    };
    // These faces have their fronts outwards.
    let faces = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let mut walls = Faces::new();
    for mut face in faces {
        if inwards {
            face.reverse();
        }
        walls.extend(quad(face.map(corner), 0));
    }
    walls
}

/// A unit sphere of flat faces between meridians and parallels, with fronts inwards. `material` returns the material of
/// a face from the polar angle of its middle.
fn sphere(rows: usize, columns: usize, material: impl Fn(f64) -> u32) -> Faces {
    let pi = std::f64::consts::PI;
    let point = |row: usize, column: usize| {
        let theta = pi * row as f64 / rows as f64;
        let (sin, cos) = (2.0 * pi * (column % columns) as f64 / columns as f64).sin_cos();
        match row {
            0 => DVec3::Z,
            r if r == rows => DVec3::NEG_Z,
            _ => dvec3(theta.sin() * cos, theta.sin() * sin, theta.cos()),
        }
    };
    let mut faces = Faces::new();
    for row in 0..rows {
        let m = material(pi * (row as f64 + 0.5) / rows as f64);
        for column in 0..columns {
            let [a, b, c, d] = [(row, column), (row + 1, column), (row + 1, column + 1), (row, column + 1)]
                .map(|(r, c)| point(r, c));
            if row + 1 < rows {
                faces.push(([a, c, b], m));
            }
            if row > 0 {
                faces.push(([a, d, c], m));
            }
        }
    }
    faces
}

/// A coloured room of 4 × 3 × 5 with a box and a lamp under its ceiling (the last two triangles). An `open` room has
/// no wall at z = 5.
fn room(open: bool) -> Scene {
    let mut faces = box_walls(DVec3::ZERO, dvec3(4.0, 3.0, 5.0), true);
    for (i, (_, material)) in faces.iter_mut().enumerate() {
        *material = [1, 1, 2, 2, 0, 0, 0, 0, 0, 0, 0, 0][i];
    }
    if open {
        faces.truncate(10);
    }
    faces.extend(box_walls(dvec3(1.0, 0.3, 1.0), dvec3(2.0, 1.8, 2.2), false));
    let lamp = [dvec3(2., 2.9, 3.), dvec3(2.6, 2.9, 3.), dvec3(2.6, 2.9, 3.5), dvec3(2., 2.9, 3.5)];
    faces.extend(quad(lamp, 3));
    let materials = vec![
        Material::new("white", [0.75, 0.7, 0.65], [0.0; 3]),
        Material::new("red", [0.6, 0.1, 0.05], [0.0; 3]),
        Material::new("green", [0.1, 0.5, 0.15], [0.0; 3]),
        Material::new("lamp", [0.2; 3], [20.0, 15.0, 9.0]),
    ];
    Scene::new(&faces, materials)
}

const PLAIN: PathOptions = PathOptions { next_event: false, max_bounces: None, roulette_after: 3 };
const NEXT_EVENT: PathOptions = PathOptions { next_event: true, ..PLAIN };

/// Asserts that an estimate is within `sigmas` standard errors of `want`, and that the standard errors are at most
/// `sharp` times `want`.
#[track_caller]
fn assert_is(estimate: &Estimate, want: [f64; 3], sigmas: f64, sharp: f64) {
    for (c, want) in want.into_iter().enumerate() {
        let (mean, se) = (estimate.mean[c], estimate.standard_error[c]);
        assert!(
            se <= sharp * want.abs(),
            "channel {c}: the error of {mean} ± {se} is too large for {}",
            want
        );
        assert!((mean - want).abs() <= sigmas * se + 1e-6 * want.abs(), "{mean} ± {se}, not {}", want);
    }
}

/// The difference of two estimates in standard errors, in the channel where it is largest.
fn apart(a: &Estimate, b: &Estimate) -> f64 {
    (0..3)
        .map(|c| {
            let se = a.standard_error[c].hypot(b.standard_error[c]);
            let difference = (a.mean[c] - b.mean[c]).abs();
            if difference <= 1e-6 * a.mean[c].abs() { 0.0 } else { difference / se }
        })
        .fold(0.0, f64::max)
}

/// Both sides of every triangle as regions: first all fronts, then all backs.
fn all_sides(scene: &Scene) -> Vec<Region> {
    let part = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let side = |front| (0..scene.triangles.len()).map(move |triangle| Region { triangle, part, front });
    side(true).chain(side(false)).collect()
}
