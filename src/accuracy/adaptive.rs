//! Adaptive subdivision: patches are small where light varies.
//!
//! Most of the discretisation error comes from few patches, which straddle the edge of a shadow or the contact of two
//! surfaces. A solution from few rays shows which. The criterion of a patch is its area times the variance of radiosity
//! over its parent in the quadtree. The patches with the largest criterion are cut in four and the scene is solved
//! again. Each step refines the lines along which light changes by one level.
//!
//! The criterion uses radiosity, because the solution treats radiosity as constant on a patch. Textured lamps and walls
//! therefore count too. If the criterion used irradiance, a lamp with a picture would stay coarse, and the error of the
//! room that it lights would stay large.

use crate::{
    patch::{Cell, Patches},
    scene::Scene,
    solve::Solution,
};

/// Largest share of the patches that a step cuts. This share doubles their number, and the restriction of the quadtrees
/// adds a few more. Larger steps would cut patches before the solution shows whether they matter.
const MOST_CUT: f64 = 1.0 / 3.0;

/// Cuts the front patches over which light varies most in four. The result has about `growth` times as many patches,
/// but at most about twice as many. It does not contain backs yet.
///
/// # Panics
/// If the solution belongs to other patches.
pub fn finer(scene: &Scene, patches: &Patches, solution: &Solution, growth: f64) -> Patches {
    let variation = variation(patches, solution);
    let mut order: Vec<usize> = (0..patches.fronts()).collect();
    order.sort_by(|&i, &j| variation[j].total_cmp(&variation[i]));
    let share = ((growth - 1.0) / 3.0).clamp(0.0, MOST_CUT);
    let mut marked = vec![false; patches.fronts()];
    let count = (share * patches.fronts() as f64).ceil() as usize;
    order.iter().take(count).for_each(|&i| marked[i] = true);
    patches.refined(scene, &marked)
}

/// For every front patch, its area times the variance of radiosity over its parent, summed over the channels. Patches
/// that are whole triangles have no parent; they get the mean variance of the other patches.
fn variation(patches: &Patches, solution: &Solution) -> Vec<f64> {
    let channels = solution.channels;
    assert_eq!(solution.radiosity.len(), patches.len() * channels, "sizes disagree");
    let variances: Vec<Option<f64>> = (0..patches.fronts())
        .map(|i| {
            let Cell { triangle, child, level } = patches.cell(i);
            let parent = Cell { triangle, child: child >> 2, level: level.checked_sub(1)? };
            Some(variance(patches, patches.fronts_in(&parent), &solution.radiosity, channels))
        })
        .collect();
    let known = || (0..variances.len()).filter_map(|i| Some((patches.area(i), variances[i]?)));
    let (area, sum) = known().fold((0.0, 0.0), |(area, sum), (a, v)| (area + a, sum + a * v));
    let mean = if area > 0.0 { sum / area } else { 1.0 };
    variances.iter().enumerate().map(|(i, v)| patches.area(i) * v.unwrap_or(mean)).collect()
}

/// The area-weighted variance of `values` over the patches `of`, summed over the channels.
fn variance(patches: &Patches, of: std::ops::Range<usize>, values: &[f64], channels: usize) -> f64 {
    let area: f64 = of.clone().map(|i| patches.area(i)).sum();
    let mean = |f: &dyn Fn(usize) -> f64| of.clone().map(|i| patches.area(i) / area * f(i)).sum::<f64>();
    (0..channels)
        .map(|c| {
            let centre = mean(&|i| values[i * channels + c]);
            mean(&|i| (values[i * channels + c] - centre).powi(2))
        })
        .sum()
}
