//! What patches of finite size cost: radiosity is constant on each, while light is not.
//!
//! The solution with patches of edge h is compared with that of their parents, edge 2h, whose form factors are sums of
//! those at hand: no ray is cast for it, and both have the same sampling error, which cancels. The error falls like h
//! where patches straddle the edges of shadows, as in most scenes; then what is left at h is as large as the change from
//! 2h to h. Where light is smooth it falls like h², and the estimate is three times too large.

use std::ops::Range;

use crate::{
    Progress, Result,
    accuracy::error_bars::relative_rms,
    form_factor::FormFactors,
    patch::Patches,
    solve::{Radiometry, Solution, SolveOptions, solve_from},
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
    /// As [`solve()`](crate::solve::solve()).
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
        let whole = |i: &usize| patches.cell(*i).level == 0;
        let area = |i: usize| areas[i];
        let all: f64 = areas.iter().sum();
        if (0..patches.len()).filter(whole).map(area).sum::<f64>() > 0.5 * all {
            return Ok(None);
        }
        let families: Vec<Range<usize>> = patches.families(1).collect();
        let channels = solution.channels;
        let coarse = form_factors.merged(&families);
        let mean = |values: &[f64]| {
            let mut means = vec![0.0; families.len() * channels];
            for (p, family) in families.iter().enumerate() {
                for i in family.clone() {
                    for c in 0..channels {
                        let share = areas[i] / coarse.areas()[p];
                        means[p * channels + c] += share * values[i * channels + c];
                    }
                }
            }
            means
        };
        let (emission, reflectance) = (mean(patches.emission()), mean(patches.reflectance()));
        let radiometry = Radiometry { channels, emission: &emission, reflectance: &reflectance };
        let start = mean(&solution.radiosity);
        let solved = solve_from(Some(&start), &coarse, radiometry, &options.rough(), progress)?;
        let fine = mean(&solution.irradiance);
        let of_family = |p: usize| (0..channels).map(move |c| p * channels + c);
        let change: Vec<f64> = families
            .iter()
            .enumerate()
            .flat_map(|(p, family)| family.clone().flat_map(move |_| of_family(p)))
            .map(|q| solved.irradiance[q] - fine[q])
            .collect();
        let relative = relative_rms(&change, &solution.irradiance, areas);
        Ok(Some(Discretisation { change, relative }))
    }
}
