//! The discretisation error: the solution treats radiosity as constant on each patch, but real light varies.
//!
//! The solution for patches of edge h is compared with the solution for their parents of edge 2h. The form factors of
//! the parents are sums of the patches' form factors, so no rays are needed, and the sampling error is the same in both
//! and cancels. If patches straddle the edges of shadows, as in most scenes, the error falls like h. Then the error at
//! h equals the change from 2h to h. Where light is smooth, the error falls like h², and the estimate is three times
//! too large. It estimates the error of constant light, which is an upper bound for linear light.

use std::ops::Range;

use crate::{
    Progress, Result,
    accuracy::error_bars::relative_rms,
    form_factor::{FormFactors, magnitude, ordered_sum, together},
    patch::Patches,
    solve::Solution,
};

/// The iteration ends when the missing part of the change is less than this share of it.
const ENOUGH: f64 = 0.02;
/// It also ends when a bounce changes the light by less than this share: a few rounding errors of single precision.
const ROUNDING: f64 = 1e-6;
/// It ends after this many bounces at the latest.
const MOST_BOUNCES: usize = 200;

/// The discretisation error of a solution.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Discretisation {
    /// For each patch, the irradiance of its parent (edge 2h) minus the mean irradiance of the parent's children, W/m²,
    /// with interleaved channels.
    pub change: Vec<f64>,
    /// Area-weighted root mean square of `change`, relative to the mean irradiance, over the patches that can be seen
    /// ([`Patches::seen_areas`]).
    pub relative: f64,
}

impl Discretisation {
    /// Estimates the error by solving for patches twice as large. `None` if more than half of the area is in patches
    /// that are whole triangles, because these have no parents.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped) if `progress` was stopped.
    ///
    /// # Panics
    /// If the sizes disagree.
    pub fn of(
        form_factors: &FormFactors,
        patches: &Patches,
        solution: &Solution,
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
        let coarse = together(|| match channels {
            1 => coarse_irradiance::<1>(form_factors, patches, solution, &families, progress),
            _ => coarse_irradiance::<3>(form_factors, patches, solution, &families, progress),
        })?;
        let fine = means(&families, areas, solution.constant_irradiance(), channels);
        let of_family = |p: usize| (0..channels).map(move |c| p * channels + c);
        let change: Vec<f64> = families
            .iter()
            .enumerate()
            .flat_map(|(p, family)| family.clone().flat_map(move |_| of_family(p)))
            .map(|q| coarse[q] - fine[q])
            .collect();
        let relative = relative_rms(&change, &solution.irradiance, &patches.seen_areas(&solution.irradiance));
        Ok(Some(Discretisation { change, relative }))
    }
}

/// The area-weighted means of `values` over the patches of every family, with interleaved channels.
fn means(families: &[Range<usize>], areas: &[f64], values: &[f64], channels: usize) -> Vec<f64> {
    let of_family = |family: &Range<usize>| -> Vec<f64> {
        let area: f64 = areas[family.clone()].iter().sum();
        let weighted = |c: usize| family.clone().map(|i| areas[i] * values[i * channels + c]).sum::<f64>();
        (0..channels).map(|c| weighted(c) / area).collect()
    };
    families.iter().flat_map(of_family).collect()
}

/// The irradiance of every family if its patches were a single patch with constant radiosity. The form factors of
/// parents are sums of their children's form factors, so no matrix of parents is built. The iteration starts from the
/// solution of the children and ends when the remaining terms are small compared with the change.
fn coarse_irradiance<const C: usize>(
    form_factors: &FormFactors,
    patches: &Patches,
    solution: &Solution,
    families: &[Range<usize>],
    progress: &Progress,
) -> Result<Vec<f64>> {
    let areas = form_factors.areas();
    let mean = |values: &[f64]| means(families, areas, values, C);
    let (mut source, reflectance) = (patches.emission().to_vec(), mean(patches.reflectance()));
    let direct = form_factors.direct::<C>(patches.emission().as_chunks().0, 1.0);
    let direct =
        direct.map_or_else(|| vec![0.0; C * areas.len()], |direct| direct.irradiance.into_flattened());
    let is_lamp = |q: &usize| form_factors.is_lamp(*q / C);
    (0..source.len()).filter(is_lamp).for_each(|q| source[q] = 0.0);
    let (source, direct) = (mean(&source), mean(&direct));
    let unit = magnitude(&solution.radiosity);
    let fine = mean(solution.constant_irradiance());
    let mut irradiance = fine.clone();
    let mut radiosity: Vec<[f32; C]> = vec![[0.0; C]; areas.len()];
    let mut arriving = radiosity.clone();
    let weights: Vec<f64> = families.iter().map(|family| areas[family.clone()].iter().sum()).collect();
    let distance = |a: &[f64], b: &[f64]| {
        let squares = |p: usize| (C * p..C * (p + 1)).map(|q| (a[q] - b[q]).powi(2)).sum::<f64>();
        ordered_sum(weights.len(), |p| weights[p] * squares(p)).sqrt()
    };
    let rounding = ROUNDING * distance(&fine, &vec![0.0; fine.len()]);
    let mut before = f64::INFINITY;
    for _ in 0..MOST_BOUNCES {
        progress.check()?;
        for (p, family) in families.iter().enumerate() {
            let of_parent = std::array::from_fn(|c| {
                let q = C * p + c;
                ((source[q] + reflectance[q] * irradiance[q]) / unit) as f32
            });
            radiosity[family.clone()].fill(of_parent);
        }
        form_factors.irradiance_into::<f32, C>(radiosity.as_flattened(), arriving.as_flattened_mut());
        let last = std::mem::take(&mut irradiance);
        let arrived: Vec<f64> = arriving.as_flattened().iter().map(|&e| unit * f64::from(e)).collect();
        irradiance = mean(&arrived).iter().zip(&direct).map(|(e, direct)| e + direct).collect();
        let step = distance(&irradiance, &last);
        // The remaining terms form a geometric series.
        let ratio = if before < f64::INFINITY { (step / before).min(1.0) } else { 1.0 };
        if step <= rounding || step * ratio <= ENOUGH * (1.0 - ratio) * distance(&irradiance, &fine) {
            break;
        }
        before = step;
    }
    Ok(irradiance)
}
