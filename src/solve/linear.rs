//! Light that varies linearly over each patch, by defect correction.
//!
//! The system has constant light on each patch. First moments of the same rays over their starting points show how the
//! irradiance of its solution varies, with two slopes a patch. If the rays carry the light ρ(x) E(x) of the points they
//! start from, instead of its mean over the patch, they bring ΔE more to the patches they hit. The system is then solved
//! once more with ΔE added to the direct light. Matrix and solver stay the same, and no ray is cast (defect correction:
//! Stetter, "The Defect Correction Principle and Discretization Methods", Numerische Mathematik 29, 1978).
//!
//! Slopes redistribute light and create none. ΔE, summed over all patches and the light that escapes, is zero, so that
//! the energy ledger stays as exact as before. On textured patches reflectance and irradiance vary together. What they
//! reflect beyond the product of their means is in ΔE, and missing in what they absorb.

use crate::{
    Error, Progress, Result,
    form_factor::{FormFactors, magnitude, ordered_sum, together},
    moments::{Brought, Constant, Variation, keep_positive},
    patch::Patches,
    rays::REPLICATES,
    scene::Scene,
    slopes::{basis, rise},
    solve::{Radiometry, Solution, SolveOptions, Solver, System, solve},
    trace::Tracer,
};

/// ΔE may reduce the light of a patch by at most this share of F U₀, the light that arrives through form factors. One
/// bounce then leaves no light negative. The solution still may be: U = U₀ + (I - ρ F)⁻¹ ρ ΔE, and where several patches
/// without direct light lose by ΔE and see each other, their losses add up ([`limited`]).
const MOST_TAKEN: f64 = 0.5;

/// Variation of irradiance over the patches, and its effect.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LinearLight {
    /// The two slopes of irradiance of each patch and channel, W/m². At a point with barycentric coordinates b in its
    /// patch, the irradiance is the mean plus the first slope times b₀ - b₁ plus the second times b₀ + b₁ - 2 b₂. It is
    /// never negative.
    pub slopes: Vec<[f64; 2]>,
    /// The slopes of [`Solution::reflected`], in the same form.
    pub reflected: Vec<[f64; 2]>,
    /// Irradiance with constant light on each patch, W/m², interleaved channels.
    pub constant: Vec<f64>,
    /// Escaped power minus that of constant light, W, for each channel.
    pub escaped: Vec<f64>,
    /// Power that textured patches reflect beyond their mean reflectance times their mean irradiance, W, for each
    /// channel.
    pub beyond_means: Vec<f64>,
    /// Deviation from the mean, in each replicate, of the light that patches gain over constant light, divided by
    /// `unit`.
    pub(crate) deviations: Vec<[f32; REPLICATES]>,
    /// What light would bring to each patch that is not linear over the patches, by each half of the rays, divided by
    /// `unit`.
    pub(crate) missing: [Vec<f32>; 2],
    pub(crate) unit: f64,
}

/// Irradiance of patch `i`, R G B, at a point with these barycentric coordinates in the patch, minus its mean; 0 if
/// there are no slopes.
pub(crate) fn rise_at(slopes: &[[f64; 2]], i: usize, channels: usize, barycentric: [f64; 3]) -> [f64; 3] {
    let (basis, last) = (basis(barycentric), channels - 1);
    std::array::from_fn(|c| slopes.get(i * channels + c.min(last)).map_or(0.0, |slopes| rise(slopes, basis)))
}

/// Solves like [`solve()`], and then again for light that is linear over each patch. The result has the mean irradiance
/// of each patch, and [`Solution::linear`] has its slopes. Light stays constant if the options say so, or if the form
/// factors were not cast from rays.
///
/// # Errors
/// Those of [`solve()`].
///
/// # Panics
/// When the sizes disagree.
pub fn solve_linear(
    (scene, tracer): (&Scene, &Tracer),
    form_factors: &FormFactors,
    patches: &Patches,
    options: &SolveOptions,
    progress: &Progress,
) -> Result<Solution> {
    let constant = solve(form_factors, patches, options, progress)?;
    if !options.linear || form_factors.ray_set().is_none() {
        return Ok(constant);
    }
    together(|| match patches.channels() {
        1 => corrected::<1>((scene, tracer), form_factors, patches, constant, options, progress),
        _ => corrected::<3>((scene, tracer), form_factors, patches, constant, options, progress),
    })
}

/// Share of what linear light brings below which light stays constant.
const LEAST_SHARE: f64 = 1.0 / 64.0;

/// Solves with what linear light brings in addition. Solvers keep light from becoming negative and do not converge where it would be
/// ([`MOST_TAKEN`]). So `brought` is halved until they converge. Any share of it keeps the energy balance, because the sum over all
/// patches and the escaping light is zero.
fn limited<const C: usize>(
    form_factors: &FormFactors,
    radiometry: Radiometry,
    brought: &mut Brought<C>,
    start: &[f64],
    (options, progress): (&SolveOptions, &Progress),
) -> Result<Solution> {
    // The user's choice of solver is for the light itself. Corrections may be negative, which not all solvers support.
    let again = SolveOptions { solver: Solver::Auto, ..*options };
    let mut share = 1.0;
    loop {
        let system = System::<C>::with_more(form_factors, radiometry, &brought.irradiance);
        match system.solve(Some(start), &again, progress) {
            Err(Error::NotConverged { .. }) if share > 0.0 => {
                let factor = if share > LEAST_SHARE { 0.5 } else { 0.0 };
                share *= factor;
                let light = brought.irradiance.as_flattened_mut().iter_mut();
                light.chain(&mut brought.escaped).chain(&mut brought.beyond_means).for_each(|x| *x *= factor);
            }
            found => return found,
        }
    }
}

fn corrected<const C: usize>(
    (scene, tracer): (&Scene, &Tracer),
    form_factors: &FormFactors,
    patches: &Patches,
    constant: Solution,
    options: &SolveOptions,
    progress: &Progress,
) -> Result<Solution> {
    let radiometry = Radiometry::from(patches);
    // In a unit in which squares and single precision can hold it.
    let unit = magnitude(&constant.radiosity);
    let found = variation::<C>((scene, tracer), form_factors, patches, &constant, true, progress)?;
    let Variation { mut slopes, mut reflected, linear, missing } =
        found.expect("the form factors were sampled");
    let mut brought = linear.expect("linear light was asked for");
    let emission: &[[f64; C]] = patches.emission().as_chunks().0;
    let carried = |i: usize, c: usize| {
        let lamp = if form_factors.is_lamp(i) { emission[i][c] } else { 0.0 };
        (constant.radiosity[i * C + c] - lamp) / unit
    };
    let carried: Vec<[f64; C]> = (0..patches.len()).map(|i| std::array::from_fn(|c| carried(i, c))).collect();
    let mut through = vec![[0.0; C]; carried.len()];
    form_factors.irradiance_into::<f64, C>(carried.as_flattened(), through.as_flattened_mut());
    balance(&mut brought, &through, form_factors.areas());
    brought.irradiance.as_flattened_mut().iter_mut().for_each(|x| *x *= unit);
    let found = limited(form_factors, radiometry, &mut brought, &constant.radiosity, (options, progress))?;
    let mut light = found.reflected;
    light.iter_mut().zip(brought.irradiance.as_flattened()).for_each(|(light, more)| *light += more);
    for (slopes, light) in [(&mut slopes, &found.irradiance), (&mut reflected, &light)] {
        let means: &[[f64; C]] = light.as_chunks().0;
        for (slopes, mean) in slopes.iter_mut().zip(means) {
            *slopes = slopes.map(|slopes| slopes.map(|slope| unit * slope));
            keep_positive(slopes, mean);
        }
    }
    Ok(Solution {
        reflected: light,
        solver: constant.solver,
        iterations: constant.iterations + found.iterations,
        linear: Some(Box::new(LinearLight {
            slopes: slopes.into_flattened(),
            reflected: reflected.into_flattened(),
            constant: constant.irradiance,
            escaped: brought.escaped.iter().map(|power| unit * power).collect(),
            beyond_means: brought.beyond_means.iter().map(|power| unit * power).collect(),
            deviations: brought.deviations.into_flattened(),
            missing: missing.map(Vec::into_flattened),
            unit,
        })),
        ..found
    })
}

/// How the light of a solution with constant light varies over the patches, in multiples of the
/// [`magnitude`] of its radiosity. `None` if the form factors were not sampled.
pub(crate) fn variation<const C: usize>(
    (scene, tracer): (&Scene, &Tracer),
    form_factors: &FormFactors,
    patches: &Patches,
    constant: &Solution,
    linear: bool,
    progress: &Progress,
) -> Result<Option<Variation<C>>> {
    let unit = magnitude(&constant.radiosity);
    let scaled = |values: &[f64]| -> Vec<[f64; C]> {
        values.as_chunks::<C>().0.iter().map(|values| values.map(|x| x / unit)).collect()
    };
    let is_mapped: Vec<bool> = (0..patches.len()).map(|i| is_textured(scene, patches.triangle(i))).collect();
    let light = Constant {
        irradiance: &scaled(&constant.irradiance),
        radiosity: &scaled(&constant.radiosity),
        emission: &scaled(patches.emission()),
        reflectance: patches.reflectance().as_chunks().0,
        is_mapped: &is_mapped,
        unit,
    };
    form_factors.variation((scene, tracer, patches), &light, linear, progress)
}

/// Whether reflectance varies over a triangle.
fn is_textured(scene: &Scene, triangle: usize) -> bool {
    scene.material(triangle).reflectance_map.is_some() || scene.colours.get(triangle).is_some()
}

/// Makes the changes of all patches and of the escaping light sum to the power that is reflected beyond the means, and
/// takes from each patch at most a share of the light that arrives `through` form factors. Scales down the larger of
/// gains and losses, so that neither grows.
fn balance<const C: usize>(brought: &mut Brought<C>, through: &[[f64; C]], areas: &[f64]) {
    let change = &mut brought.irradiance;
    for c in 0..C {
        for (change, through) in change.iter_mut().zip(through) {
            change[c] = change[c].max(-MOST_TAKEN * through[c]);
        }
        let sum = |sign: f64| ordered_sum(areas.len(), |i| areas[i] * (sign * change[i][c]).max(0.0));
        let (gained, lost) = (sum(1.0), sum(-1.0));
        let beyond_means = brought.beyond_means[c];
        // What patches gain in all. It is out of range only if almost no light arrives.
        let wanted = (beyond_means - brought.escaped[c]).clamp(-lost, gained);
        let (of_gained, of_lost) = match gained - lost > wanted {
            true => ((lost + wanted) / gained, 1.0),
            false if lost > 0.0 => (1.0, (gained - wanted) / lost),
            false => (1.0, 1.0),
        };
        for change in change.iter_mut() {
            change[c] *= if change[c] > 0.0 { of_gained } else { of_lost };
        }
        // The rounding error is added to the escaping light.
        brought.escaped[c] = beyond_means - ordered_sum(areas.len(), |i| areas[i] * change[i][c]);
    }
}
