//! Light that varies linearly over each patch, by defect correction.
//!
//! The system has constant light on each patch. First moments of the same rays over their starting points show how the
//! irradiance of its solution varies, with two slopes a patch. If the rays carry the light ρ(x) E(x) at the points they
//! hit, instead of its mean over the patch, they bring ΔE more to each patch. The system is then solved once more with
//! ΔE added to the direct light. Matrix and solver stay the same (defect correction: Stetter, "The Defect Correction
//! Principle and Discretization Methods", Numerische Mathematik 29, 1978).
//!
//! Slopes redistribute light and create none. ΔE, summed over all patches and the light that escapes, is zero, so that
//! the energy ledger stays as exact as before.

use crate::{
    Progress, Result,
    form_factor::{FormFactors, magnitude, ordered_sum, together},
    moments::{Shifted, Varying},
    patch::Patches,
    rays::REPLICATES,
    scene::Scene,
    slopes::{CORNERS, Measured, Slopes, basis, rise, spread},
    solve::{Radiometry, Solution, SolveOptions, Solver, System, solve},
    trace::Tracer,
};

/// ΔE may reduce the light of a patch by at most this share of F U₀, the light that arrives through form factors. Then
/// no light becomes negative: U - U₀/2 = S/2 + ρ (ΔE + F U₀/2) + ρ F (U - U₀/2), where all terms are positive.
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
    /// Deviation from the mean, in each replicate, of the light that patches gain over constant light, divided by
    /// `unit`.
    pub(crate) deviations: Vec<[f32; REPLICATES]>,
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

fn corrected<const C: usize>(
    (scene, tracer): (&Scene, &Tracer),
    form_factors: &FormFactors,
    patches: &Patches,
    constant: Solution,
    options: &SolveOptions,
    progress: &Progress,
) -> Result<Solution> {
    let radiometry = Radiometry::from(patches);
    let reflectance: &[[f64; C]] = radiometry.reflectance.as_chunks().0;
    // In a unit in which squares and single precision can hold it.
    let unit = magnitude(&constant.radiosity);
    let scaled = |values: &[f64]| -> Vec<[f64; C]> {
        values.as_chunks::<C>().0.iter().map(|values| values.map(|x| x / unit)).collect()
    };
    let (emission, irradiance) = (scaled(radiometry.emission), scaled(&constant.irradiance));
    let radiosity = scaled(&constant.radiosity);
    let carried = without(&radiosity, &emission, |i| form_factors.is_lamp(i));
    let slopes = slopes::<C>(tracer, form_factors, patches, &radiosity, unit);
    let mut slopes = slopes.expect("the form factors were sampled");
    keep_positive(&mut slopes, &irradiance);
    let reflected = form_factors.carried_slopes(tracer, patches, &without(&radiosity, &emission, |_| true));
    let reflected = reflected.expect("the form factors were sampled");
    let mut reflected: Vec<Slopes<C>> = reflected.iter().map(believed).collect();
    let is_mapped: Vec<bool> = (0..patches.len()).map(|i| is_textured(scene, patches.triangle(i))).collect();
    let light = Varying { irradiance: &irradiance, slopes: &slopes, reflectance, is_mapped: &is_mapped };
    let shifted = form_factors.shift((scene, tracer, patches), &light, progress)?;
    let mut shifted = shifted.expect("the form factors were sampled");
    let mut through = vec![[0.0; C]; carried.len()];
    form_factors.irradiance_into::<f64, C>(carried.as_flattened(), through.as_flattened_mut());
    balance(&mut shifted, &through, form_factors.areas());
    let unscaled = |values: &mut [f64]| values.iter_mut().for_each(|x| *x *= unit);
    unscaled(shifted.irradiance.as_flattened_mut());
    let system = System::<C>::with_more(form_factors, radiometry, &shifted.irradiance);
    // The user's choice of solver is for the light itself. Corrections may be negative, which not all solvers support.
    let again = SolveOptions { solver: Solver::Auto, ..*options };
    let found = system.solve(Some(&constant.radiosity), &again, progress)?;
    for slopes in [&mut slopes, &mut reflected] {
        for (slopes, more) in slopes.iter_mut().zip(&shifted.slopes) {
            *slopes = std::array::from_fn(|c| [0, 1].map(|m| unit * (slopes[c][m] + more[c][m])));
        }
    }
    let mut light = found.reflected;
    light.iter_mut().zip(shifted.irradiance.as_flattened()).for_each(|(light, more)| *light += more);
    keep_positive(&mut slopes, found.irradiance.as_chunks().0);
    keep_positive(&mut reflected, light.as_chunks().0);
    Ok(Solution {
        reflected: light,
        solver: constant.solver,
        iterations: constant.iterations + found.iterations,
        linear: Some(Box::new(LinearLight {
            slopes: slopes.into_flattened(),
            reflected: reflected.into_flattened(),
            constant: constant.irradiance,
            escaped: shifted.escaped.iter().map(|escaped| unit * escaped).collect(),
            deviations: shifted.deviations.into_flattened(),
            unit,
        })),
        ..found
    })
}

/// Slopes of the irradiance of a solution with constant light, without the light of the sky. The radiosity and the
/// result are in multiples of `unit`. `None` if the form factors were not sampled.
pub(crate) fn slopes<const C: usize>(
    tracer: &Tracer,
    form_factors: &FormFactors,
    patches: &Patches,
    radiosity: &[[f64; C]],
    unit: f64,
) -> Option<Vec<Slopes<C>>> {
    let emission: Vec<[f64; C]> =
        patches.emission().as_chunks().0.iter().map(|e: &[f64; C]| e.map(|e| e / unit)).collect();
    let carried = without(radiosity, &emission, |i| form_factors.is_lamp(i));
    let direct = form_factors.direct_slopes(tracer, patches, (&emission, unit))?;
    let arriving = form_factors.carried_slopes(tracer, patches, &carried)?;
    Some(direct.iter().zip(&arriving).map(|(d, r)| believed(&d.plus(r))).collect())
}

/// A radiosity without the emission of some patches.
fn without<const C: usize>(
    radiosity: &[[f64; C]],
    emission: &[[f64; C]],
    of: impl Fn(usize) -> bool,
) -> Vec<[f64; C]> {
    let mut light = radiosity.to_vec();
    for i in (0..light.len()).filter(|&i| of(i)) {
        light[i] = std::array::from_fn(|c| light[i][c] - emission[i][c]);
    }
    light
}

/// Whether reflectance varies over a triangle.
pub(crate) fn is_textured(scene: &Scene, triangle: usize) -> bool {
    scene.material(triangle).reflectance_map.is_some() || scene.colours.get(triangle).is_some()
}

/// Reduces slopes by the share of their spread that is noise (Wiener filter).
fn believed<const C: usize>(found: &Measured<C>) -> Slopes<C> {
    let spread = spread(&found.slopes);
    let share = if spread > 0.0 { (1.0 - found.noise / spread).max(0.0) } else { 0.0 };
    found.slopes.map(|slopes| slopes.map(|slope| share * slope))
}

/// Reduces slopes until the light is nowhere negative. The mean does not change.
fn keep_positive<const C: usize>(slopes: &mut [Slopes<C>], irradiance: &[[f64; C]]) {
    for (slopes, irradiance) in slopes.iter_mut().zip(irradiance) {
        for (slopes, mean) in slopes.iter_mut().zip(irradiance) {
            let least = CORNERS.iter().map(|&corner| rise(slopes, corner)).fold(0.0, f64::min);
            if -least > *mean {
                let flat = mean.max(0.0) / -least;
                *slopes = slopes.map(|slope| flat * slope);
            }
        }
    }
}

/// Makes the changes of all patches and of the escaping light sum to zero, and takes from each patch at most a share of
/// the light that arrives `through` form factors. Scales down the larger of gains and losses, so that no light becomes
/// negative.
fn balance<const C: usize>(shifted: &mut Shifted<C>, through: &[[f64; C]], areas: &[f64]) {
    let shift = &mut shifted.irradiance;
    for c in 0..C {
        for (shift, through) in shift.iter_mut().zip(through) {
            shift[c] = shift[c].max(-MOST_TAKEN * through[c]);
        }
        let sum = |sign: f64| ordered_sum(areas.len(), |i| areas[i] * (sign * shift[i][c]).max(0.0));
        let (brought, taken) = (sum(1.0), sum(-1.0));
        // The escaping light exceeds all losses only if almost no light arrives.
        let escaped = shifted.escaped[c].clamp(-brought, taken);
        let more = brought + escaped - taken;
        let (of_brought, of_taken) = if more > 0.0 {
            ((taken - escaped) / brought, 1.0)
        } else if more < 0.0 {
            (1.0, (brought + escaped) / taken)
        } else {
            (1.0, 1.0)
        };
        for shift in shift.iter_mut() {
            shift[c] *= if shift[c] > 0.0 { of_brought } else { of_taken };
        }
        // The rounding error is added to the escaping light.
        shifted.escaped[c] = -ordered_sum(areas.len(), |i| areas[i] * shift[i][c]);
    }
}
