//! Which side of each patch a mesh shows.
//!
//! A viewer that draws both sides of a face cannot tell two faces at one place apart: each pixel shows one or the other by
//! chance of rounding. A mesh for such viewers has one face at each place, and it shows the side that has more light.

use std::collections::HashMap;

use crate::{
    patch::Patches,
    scene::Scene,
    solve::Light,
    tone::{luminance, rgb},
};

/// For each unknown, whether it is the side to show. Of a patch and its back the one with the larger radiosity is, or with the
/// larger irradiance where nothing is reflected, or else the front. Of triangles with the same corners one is shown: the one
/// with the largest power.
pub(super) fn lit_sides(scene: &Scene, patches: &Patches, light: Light<'_>) -> Vec<bool> {
    let channels = patches.channels();
    let of = |values: &[f64], i: usize| luminance(rgb(&values[i * channels..][..channels]));
    let brightness = |i: usize| [of(light.radiosity, i), of(light.irradiance, i)];
    let mut shown = vec![false; patches.len()];
    for i in 0..patches.fronts() {
        let back = patches.back_of(i).map(|back| back as usize);
        shown[back.filter(|&back| brightness(back) > brightness(i)).unwrap_or(i)] = true;
    }
    let power = |t: usize| -> [f64; 2] {
        let sides =
            patches.fronts_of(t).flat_map(|i| [Some(i), patches.back_of(i).map(|back| back as usize)]);
        let shown = sides.flatten().filter(|&i| shown[i]);
        shown.fold([0.0; 2], |sum, i| {
            let (area, brightness) = (patches.area(i), brightness(i));
            std::array::from_fn(|k| sum[k] + area * brightness[k])
        })
    };
    let hidden: Vec<usize> = doubled(scene)
        .flat_map(|same| {
            let brightest = same.iter().copied().reduce(|a, b| if power(b) > power(a) { b } else { a });
            same.into_iter().filter(move |&t| Some(t) != brightest)
        })
        .collect();
    for i in hidden.into_iter().flat_map(|t| patches.fronts_of(t)) {
        shown[i] = false;
        if let Some(back) = patches.back_of(i) {
            shown[back as usize] = false;
        }
    }
    shown
}

/// Triangles that have the same corners, in the order of the file.
fn doubled(scene: &Scene) -> impl Iterator<Item = Vec<usize>> {
    let mut at: HashMap<[u32; 3], Vec<usize>> = HashMap::with_capacity(scene.triangles.len());
    for (t, triangle) in scene.triangles.iter().enumerate() {
        let mut corners = triangle.vertices;
        corners.sort_unstable();
        at.entry(corners).or_default().push(t);
    }
    at.into_values().filter(|same| same.len() > 1)
}
