//! Standard skies of the CIE. Their radiance is in any unit, because only its shape counts here.
//!
//! Clear and overcast sky: CIE S 003 (1996). Intermediate sky: Nakamura, Oki and Hayashi, "Luminance distribution of
//! intermediate sky", Journal of Light and Visual Environment 9, 1985.

/// Overcast sky: relative radiance at the altitude whose sine is `sin`.
pub(super) fn overcast(sin: f64) -> f64 {
    (1.0 + 2.0 * sin) / 3.0
}

/// Clear sky: relative radiance at the altitude whose sine is `sin`. `cos_sun` is the cosine of the angle from the sun.
pub(super) fn clear(sin: f64, cos_sun: f64) -> f64 {
    let gamma = cos_sun.clamp(-1.0, 1.0).acos();
    let thickness = if sin > 0.01 { 1.0 - (-0.32 / sin).exp() } else { 1.0 };
    (0.91 + 10.0 * (-3.0 * gamma).exp() + 0.45 * cos_sun * cos_sun) * thickness
}

/// Intermediate sky: relative radiance as for [`clear`]. `sun` is the sine of the sun's altitude.
pub(super) fn intermediate(sin: f64, cos_sun: f64, sun: f64) -> f64 {
    let gamma = cos_sun.clamp(-1.0, 1.0).acos();
    let (zenith, of_sun) = (sin.clamp(-1.0, 1.0).acos(), sun.clamp(-1.0, 1.0).acos());
    let bright = (1.35 * (5.631 - 3.59 * zenith).sin() + 3.12) * (4.396 - 2.6 * of_sun).sin() + 6.37 - zenith;
    bright / 2.326 * (-0.563 * gamma * ((2.629 - zenith) * (1.562 - of_sun) + 0.812)).exp()
}
