//! Radiosity at vertices, for viewers that shade smoothly.
//!
//! The value at a vertex is a mean over the patches of its surface that meet there, weighted by their angles at the
//! vertex. Cohen and Wallace ("Radiosity and Realistic Image Synthesis", 1993, chapter 9) use equal weights. With
//! angles as weights the result does not depend on how a flat surface was cut into triangles, and radiosity that varies
//! linearly over a regular mesh is reproduced. Linear light of a patch counts with its value at the vertex.

use rayon::prelude::*;

use super::vertices::PatchMesh;
use crate::{
    patch::Patches,
    scene::Scene,
    slopes::{CORNERS, rise},
    solve::Light,
};

/// The smallest weight, so that a vertex with slivers only still has a value.
const LEAST_ANGLE: f64 = 1e-9;

/// Values at the vertices from values of the patches, both with `patches.channels()` interleaved channels.
///
/// # Panics
/// If `values` does not have a value per patch and channel.
pub fn at_vertices(scene: &Scene, patches: &Patches, mesh: &PatchMesh, values: &[f64]) -> Vec<f64> {
    means(scene, patches, mesh, values, |_, _| 0.0)
}

/// Irradiance at the vertices, averaged as in [`at_vertices`], with the slopes of linear light.
pub(super) fn irradiance(scene: &Scene, patches: &Patches, mesh: &PatchMesh, light: Light<'_>) -> Vec<f64> {
    means(scene, patches, mesh, light.irradiance, |q, corner| rise_of(light, q, corner))
}

/// Radiosity at the vertices, averaged as in [`at_vertices`], with the slopes of linear light.
pub(super) fn radiosity(scene: &Scene, patches: &Patches, mesh: &PatchMesh, light: Light<'_>) -> Vec<f64> {
    let reflectance = patches.reflectance();
    means(scene, patches, mesh, light.radiosity, |q, corner| reflectance[q] * rise_of(light, q, corner))
}

/// The difference of a patch's irradiance at a corner from its mean. `q` is the index of the patch and channel.
fn rise_of(light: Light<'_>, q: usize, corner: usize) -> f64 {
    light.slopes.get(q).map_or(0.0, |slopes| rise(slopes, CORNERS[corner]))
}

/// Means at the vertices. `more` returns the difference of a patch's value at a corner from its mean, for an index of
/// patch and channel.
fn means(
    scene: &Scene,
    patches: &Patches,
    mesh: &PatchMesh,
    values: &[f64],
    more: impl Fn(usize, usize) -> f64,
) -> Vec<f64> {
    match patches.channels() {
        1 => mean::<1>(scene, patches, mesh, values, more),
        _ => mean::<3>(scene, patches, mesh, values, more),
    }
}

fn mean<const C: usize>(
    scene: &Scene,
    patches: &Patches,
    mesh: &PatchMesh,
    values: &[f64],
    more: impl Fn(usize, usize) -> f64,
) -> Vec<f64> {
    assert_eq!(values.len(), C * patches.len(), "one value per patch and channel is needed");
    let angles: Vec<[f64; 3]> =
        (0..scene.triangles.len()).into_par_iter().map(|t| corner_angles(scene, t)).collect();
    let mut sums = vec![[0.0; C]; mesh.positions().len()];
    let mut weights = vec![0.0; sums.len()];
    for (i, value) in values.as_chunks::<C>().0.iter().enumerate() {
        // Patches are similar to their triangle, so corresponding corners have equal angles.
        for (corner, angle) in angles[patches.triangle(i)].into_iter().enumerate() {
            let vertex = mesh.corners(i)[corner] as usize;
            weights[vertex] += angle;
            for (c, (sum, value)) in sums[vertex].iter_mut().zip(value).enumerate() {
                *sum += angle * (value + more(C * i + c, corner));
            }
        }
    }
    for (sum, weight) in sums.iter_mut().zip(&weights) {
        *sum = sum.map(|s| s / weight);
    }
    // Light is linear along the edge of the larger patch. Any other value here would make its pieces visible.
    for hanging in mesh.hanging() {
        let [a, b] = hanging.ends.map(|end| sums[end as usize]);
        sums[hanging.vertex as usize] = std::array::from_fn(|c| a[c] + (b[c] - a[c]) * hanging.fraction);
    }
    sums.into_flattened()
}

/// Interior angles of triangle `t` in radians.
fn corner_angles(scene: &Scene, t: usize) -> [f64; 3] {
    let p = scene.corners(t);
    let edges = [p[1] - p[0], p[2] - p[1], p[0] - p[2]];
    // Without scaling, the squares of very short or long edges would leave the range of double precision.
    let scale = edges.iter().map(|e| e.abs().max_element()).fold(0.0, f64::max);
    let edges = edges.map(|e| e / scale);
    std::array::from_fn(|k| {
        let (to_next, to_last) = (edges[k], -edges[(k + 2) % 3]);
        to_next.cross(to_last).length().atan2(to_next.dot(to_last)).max(LEAST_ANGLE)
    })
}
