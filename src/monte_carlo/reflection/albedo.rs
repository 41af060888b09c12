//! How much of the light a lobe reflects, by quadrature.

use std::f64::consts::PI;

use glam::DVec3;

use super::{Brdf, Lobe, spherical};
use crate::trace::sampling::sobol_4d;

/// Directions of which the mean is taken. A net of so many is within 10⁻³ of the albedo of all models, at roughnesses from 0.1 to 1;
/// a square grid of as many was up to 8·10⁻³ off where a part of the lobe is below the surface.
const DIRECTIONS: u32 = 1 << 11;

/// Share of the light that goes on of what comes from ωo, by the lobe's own directions: ∫ f cos θi dωi. The same as the share of what
/// goes to ωo, since the models are reciprocal.
pub fn directional_albedo(lobe: &Lobe, wo: DVec3) -> DVec3 {
    if lobe.is_mirror() {
        return lobe.weight(wo, DVec3::Z);
    }
    let weight = |i| {
        let [x, y, ..] = sobol_4d(i, 1).map(f64::from);
        lobe.sample(wo, [x, y]).map_or(DVec3::ZERO, |wi| lobe.weight(wo, wi))
    };
    (0..DIRECTIONS).map(weight).sum::<DVec3>() / f64::from(DIRECTIONS)
}

/// The cosines at which albedos are taken: middles of the strata of cos² θ, in which diffuse light is even.
const RINGS: u32 = 24;

/// Azimuths at which a lobe that is not the same in all is looked at, over the quarter that is not symmetric to others.
const AZIMUTHS: u32 = 4;

/// Share of diffuse light that the lobe reflects: the mean of the directional albedo, weighted by cos θ.
pub fn hemispherical_albedo(lobe: &Lobe) -> DVec3 {
    let azimuths = azimuths(lobe);
    let mut sum = DVec3::ZERO;
    for ring in 0..RINGS {
        let cos = ((f64::from(ring) + 0.5) / f64::from(RINGS)).sqrt();
        azimuths.iter().for_each(|&azimuth| sum += directional_albedo(lobe, spherical(cos, azimuth)));
    }
    sum / (f64::from(RINGS) * azimuths.len() as f64)
}

/// Azimuths spread over a quarter turn; one where all are alike.
pub(super) fn azimuths(lobe: &Lobe) -> Vec<f64> {
    let azimuths = if lobe.is_anisotropic() { AZIMUTHS } else { 1 };
    (0..azimuths).map(|k| 0.5 * PI * (f64::from(k) + 0.5) / f64::from(azimuths)).collect()
}
