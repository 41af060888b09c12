//! What patches of finite size cost: radiosity is constant on each, while light is not.
//!
//! The solution with patches of edge h is compared with that of their parents, edge 2h, whose form factors are sums of
//! those at hand: no ray is cast for it, and both have the same sampling error, which cancels. The error falls like h
//! where patches straddle the edges of shadows, as in most scenes; then what is left at h is as large as the change from
//! 2h to h. Where light is smooth it falls like h², and the estimate is three times too large.

use crate::{
    Progress, Result,
    accuracy::error_bars::relative_rms,
    form_factor::FormFactors,
    patch::Patches,
    solve::{Radiometry, Solution, SolveOptions, solve},
};

/// The discretisation error of a solution.
#[derive(Debug, Clone, PartialEq)]
pub struct Discretisation {
    /// Irradiance of the parent, edge 2h, less the mean of its children, W/m²: interleaved channels a patch.
    pub change: Vec<f64>,
    /// Its area-weighted root mean square, relative to the mean irradiance.
    pub relative: f64,
}

impl Discretisation {
    /// Solves the scene with patches twice as large and compares; `None` where more than half of the area is in triangles
    /// that are patches as a whole, which have no parents.
    ///
    /// # Errors
    /// As [`solve()`].
    ///
    /// # Panics
    /// When the sizes disagree.
    pub fn of(
        form_factors: &FormFactors,
        patches: &Patches,
        solution: &Solution,
        options: &SolveOptions,
        progress: &Progress,
    ) -> Result<Option<Discretisation>> {
        let areas = form_factors.areas();
        assert_eq!(areas.len(), patches.len(), "sizes disagree");
        let whole = |i: &usize| patches.level(patches.triangle(*i)) == 0;
        let area = |i: usize| areas[i];
        let all: f64 = areas.iter().sum();
        if (0..patches.len()).filter(whole).map(area).sum::<f64>() > 0.5 * all {
            return Ok(None);
        }
        let parents = parents(patches);
        let channels = solution.channels;
        let count = parents.last().map_or(0, |&last| last as usize + 1);
        let coarse = form_factors.merged(&parents);
        let mean = |values: &[f64]| {
            let mut means = vec![0.0; count * channels];
            for (i, &parent) in parents.iter().enumerate() {
                for c in 0..channels {
                    let share = areas[i] / coarse.areas()[parent as usize];
                    means[parent as usize * channels + c] += share * values[i * channels + c];
                }
            }
            means
        };
        let (emission, reflectance) = (mean(patches.emission()), mean(patches.reflectance()));
        let radiometry = Radiometry { channels, emission: &emission, reflectance: &reflectance };
        let solved = solve(&coarse, radiometry, options, progress)?;
        let fine = mean(&solution.irradiance);
        let change: Vec<f64> = (0..patches.len() * channels)
            .map(|q| {
                let p = parents[q / channels] as usize * channels + q % channels;
                solved.irradiance[p] - fine[p]
            })
            .collect();
        let relative = relative_rms(&change, &solution.irradiance, areas);
        Ok(Some(Discretisation { change, relative }))
    }
}

/// The parent of every patch, numbered in their order; patches that are whole triangles are their own.
fn parents(patches: &Patches) -> Vec<u32> {
    let parent = |i: usize| (patches.triangle(i), patches.is_front(i), patches.child(i) >> 2);
    let mut number = 0;
    (0..patches.len())
        .map(|i| {
            if i > 0 && parent(i) != parent(i - 1) {
                number += 1;
            }
            number
        })
        .collect()
}
