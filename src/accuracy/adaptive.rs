//! Patches that are small where light varies.
//!
//! What patches of finite size cost comes from few of them, those that straddle the edge of a shadow or the contact of two
//! surfaces. A solution from few rays tells which: a patch counts by its area times the variance of radiosity over its
//! parent in the quadtree. Those that count most are cut in four, and the scene is solved anew; each such step follows the
//! lines along which light changes one level further down.
//!
//! It is radiosity whose variation is neglected, so that lamps and walls with textures count too: by irradiance, a lamp with
//! a picture on it stays coarse, and the error of a room that it lights falls no further.

use crate::{
    patch::{Cell, Patches},
    scene::Scene,
    solve::Solution,
};

/// A step cuts at most this share of the patches: it doubles their number, and restricted quadtrees want a few more. When
/// steps cut more, patches that matter little are cut before it shows which do.
const MOST_CUT: f64 = 1.0 / 3.0;

/// Cuts those front patches in four over which light varies most, so that there are about `growth` times as many, and no
/// more than about twice. Backs are no unknowns of the result yet.
///
/// # Panics
/// When the solution is not one of these patches.
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

/// The area of every front patch times the variance of radiosity over its parent, all channels together. Whole triangles
/// have no parents, and are given the mean variance of the other patches.
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

/// The variance by area of some values over these patches.
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
