//! Light that varies linearly over each patch, by defect correction.
//!
//! The system has constant light on each patch. Its solution tells how irradiance varies over the patches: the same rays have
//! first moments over the points that they start from, which give two slopes a patch. With the light ρ(x) E(x) where rays land,
//! instead of its mean over the patch, they bring ΔE more to each patch. The system is then solved once more with ΔE beside the
//! direct light. Matrix and solver stay as they are (defect correction: Stetter, "The Defect Correction Principle and
//! Discretization Methods", Numerische Mathematik 29, 1978).
//!
//! Slopes move light and make none. What ΔE brings to all patches, and out of the scene, sums to zero, so the energy ledger stays
//! as exact as it was.

use crate::{
    Progress, Result,
    form_factor::{
        FormFactors, magnitude,
        moments::{Shifted, Varying},
        ordered_sum,
        rays::REPLICATES,
        together,
    },
    patch::Patches,
    scene::Scene,
    slopes::{CORNERS, Measured, Slopes, basis, rise, spread},
    solve::{Radiometry, Solution, SolveOptions, Solver, System, solve},
    trace::Tracer,
};

/// The largest share of the light F U₀ that comes through form factors which ΔE may take from a patch. Then no light is negative:
/// U - U₀/2 = S/2 + ρ (ΔE + F U₀/2) + ρ F (U - U₀/2), in which all terms are positive.
const MOST_TAKEN: f64 = 0.5;

/// How irradiance varies over the patches, and what that changed.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LinearLight {
    /// The two slopes of irradiance of each patch and channel, W/m²: with the barycentric coordinates b of a point in its patch,
    /// the irradiance there is the mean plus the first times b₀ - b₁ plus the second times b₀ + b₁ - 2 b₂. It is never negative.
    pub slopes: Vec<[f64; 2]>,
    /// Irradiance with constant light on each patch, W/m², interleaved channels.
    pub constant: Vec<f64>,
    /// Power that escapes more than with constant light, W, for each channel.
    pub escaped: Vec<f64>,
    /// What each replicate of the rays brought to a patch more than with constant light: deviations from the mean, in this unit.
    pub(crate) deviations: Vec<[f32; REPLICATES]>,
    pub(crate) unit: f64,
}

/// By how much the irradiance of patch `i`, R G B, exceeds its mean at a point with these barycentric coordinates in the patch; not
/// at all where there are no slopes.
pub(crate) fn rise_at(slopes: &[[f64; 2]], i: usize, channels: usize, barycentric: [f64; 3]) -> [f64; 3] {
    let (basis, last) = (basis(barycentric), channels - 1);
    std::array::from_fn(|c| slopes.get(i * channels + c.min(last)).map_or(0.0, |slopes| rise(slopes, basis)))
}

/// Solves as [`solve()`] does, and then for light that is linear over each patch. The result has the mean irradiance of each patch,
/// and [`Solution::linear`] has its slopes. Light stays constant where the options say so, or where form factors come from elsewhere
/// and so have no rays.
///
/// # Errors
/// As [`solve()`].
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
    // In a unit in which squares and single precision hold it.
    let unit = magnitude(&constant.radiosity);
    let scaled = |values: &[f64]| -> Vec<[f64; C]> {
        values.as_chunks::<C>().0.iter().map(|values| values.map(|x| x / unit)).collect()
    };
    let (emission, irradiance) = (scaled(radiometry.emission), scaled(&constant.irradiance));
    let mut carried = scaled(&constant.radiosity);
    for i in (0..carried.len()).filter(|&i| form_factors.is_lamp(i)) {
        carried[i] = std::array::from_fn(|c| carried[i][c] - emission[i][c]);
    }
    let direct = form_factors.direct_slopes(tracer, patches, (&emission, unit));
    let reflected = form_factors.carried_slopes(tracer, patches, &carried);
    let (direct, reflected) = direct.zip(reflected).expect("the form factors were sampled");
    let found: Vec<Measured<C>> = direct.iter().zip(&reflected).map(|(d, r)| d.plus(r)).collect();
    let mut slopes: Vec<Slopes<C>> = found.iter().map(believed).collect();
    drop((direct, reflected, found));
    keep_positive(&mut slopes, &irradiance);
    let is_mapped: Vec<bool> = (0..patches.len()).map(|i| varies(scene, patches.triangle(i))).collect();
    let light = Varying { irradiance: &irradiance, slopes: &slopes, reflectance, is_mapped: &is_mapped };
    let shifted = form_factors.shift((scene, tracer, patches), &light, progress)?;
    let mut shifted = shifted.expect("the form factors were sampled");
    let mut through = vec![[0.0; C]; carried.len()];
    form_factors.irradiance_into::<f64, C>(carried.as_flattened(), through.as_flattened_mut());
    balance(&mut shifted, &through, form_factors.areas());
    let unscaled = |values: &mut [f64]| values.iter_mut().for_each(|x| *x *= unit);
    unscaled(shifted.irradiance.as_flattened_mut());
    unscaled(carried.as_flattened_mut());
    let system = System::<C>::with_more(form_factors, radiometry, &shifted.irradiance);
    // The algorithm was the user's to choose for the light itself. Corrections may be negative, which not all suit.
    let again = SolveOptions { solver: Solver::Auto, ..*options };
    let found = system.solve(Some(carried.as_flattened()), &again, progress)?;
    for (slopes, more) in slopes.iter_mut().zip(&shifted.slopes) {
        *slopes = std::array::from_fn(|c| [0, 1].map(|m| unit * (slopes[c][m] + more[c][m])));
    }
    keep_positive(&mut slopes, found.irradiance.as_chunks().0);
    Ok(Solution {
        solver: constant.solver,
        iterations: constant.iterations + found.iterations,
        linear: Some(Box::new(LinearLight {
            slopes: slopes.into_flattened(),
            constant: constant.irradiance,
            escaped: shifted.escaped.iter().map(|escaped| unit * escaped).collect(),
            deviations: shifted.deviations.into_flattened(),
            unit,
        })),
        ..found
    })
}

/// Whether reflectance varies over a triangle.
fn varies(scene: &Scene, triangle: usize) -> bool {
    scene.material(triangle).reflectance_map.is_some() || scene.colours.get(triangle).is_some()
}

/// Slopes shrunk by what sampling adds to them: the share of their spread that is not noise (Wiener's filter).
fn believed<const C: usize>(found: &Measured<C>) -> Slopes<C> {
    let spread = spread(&found.slopes);
    let share = if spread > 0.0 { (1.0 - found.noise / spread).max(0.0) } else { 0.0 };
    found.slopes.map(|slopes| slopes.map(|slope| share * slope))
}

/// Flattens slopes until the light is nowhere negative. The mean stays.
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

/// Makes sure that what linear light brings to all patches and out of the scene sums to zero, and takes no more from a patch than
/// comes `through` form factors. The larger of what is brought and what is taken is scaled down, so that no light becomes negative.
fn balance<const C: usize>(shifted: &mut Shifted<C>, through: &[[f64; C]], areas: &[f64]) {
    let shift = &mut shifted.irradiance;
    for c in 0..C {
        for (shift, through) in shift.iter_mut().zip(through) {
            shift[c] = shift[c].max(-MOST_TAKEN * through[c]);
        }
        let sum = |sign: f64| ordered_sum(areas.len(), |i| areas[i] * (sign * shift[i][c]).max(0.0));
        let (brought, taken) = (sum(1.0), sum(-1.0));
        // More escapes than all that is taken only where nearly nothing arrives.
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
        // What rounding leaves is counted where light leaves.
        shifted.escaped[c] = -ordered_sum(areas.len(), |i| areas[i] * shift[i][c]);
    }
}
