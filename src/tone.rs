//! Conversion of linear light to the colours of a screen.

/// Luminance of linear Rec. 709 red, green and blue.
pub const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// The share of lit surface or lit pixels that automatic exposure shows at a brightness of at most [`BRIGHT`].
const PERCENTILE: f64 = 0.9;
/// Linear brightness of this percentile on the screen: a well lit white wall, with room for brighter parts.
const BRIGHT: f64 = 0.8;

/// An exposure. It converts light to a screen colour: light is multiplied by a factor, clipped to white, and encoded as
/// sRGB. There is no tone curve: below white, brightness is proportional to light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exposure {
    /// Screen brightness (1 is white) per W/m² of radiosity or W/(m² sr) of radiance.
    pub scale: f64,
}

impl Exposure {
    /// The exposure that shows the light `white` as white.
    pub fn of_white(white: f64) -> Exposure {
        Exposure { scale: 1.0 / white }
    }

    /// The exposure that shows 90 % of the lit weight at a brightness of at most 0.8, from pairs of luminance and
    /// weight. Luminances of zero do not count. If nothing is lit, the factor is 1.
    pub fn automatic(luminances: impl IntoIterator<Item = (f64, f64)>) -> Exposure {
        let mut lit: Vec<(f64, f64)> =
            luminances.into_iter().filter(|(bright, _)| *bright > 0.0 && bright.is_finite()).collect();
        let percentile = percentile(&mut lit, PERCENTILE);
        // The inverse of a very faint brightness overflows.
        let scale = BRIGHT / percentile;
        Exposure { scale: if percentile > 0.0 && scale.is_finite() { scale } else { 1.0 } }
    }

    /// Makes the exposure brighter by a number of stops. A stop is a factor of two.
    #[must_use]
    pub fn brighter(self, stops: f64) -> Exposure {
        Exposure { scale: self.scale * stops.exp2() }
    }

    /// The least light that appears white.
    pub fn white(self) -> f64 {
        1.0 / self.scale
    }

    /// The colour on a screen.
    pub fn encode(self, linear: [f64; 3]) -> [u8; 3] {
        linear.map(|x| (srgb((x * self.scale).clamp(0.0, 1.0)) * 255.0).round() as u8)
    }
}

/// Converts one or three channels to red, green and blue.
///
/// # Panics
/// When there are two channels or none.
pub fn rgb(values: &[f64]) -> [f64; 3] {
    if let &[grey] = values { [grey; 3] } else { [values[0], values[1], values[2]] }
}

/// Luminance of a linear colour.
pub fn luminance(rgb: [f64; 3]) -> f64 {
    rgb.iter().zip(LUMINANCE).map(|(x, weight)| x * weight).sum()
}

/// Encodes a linear value in \[0, 1\] as sRGB (IEC 61966-2-1).
pub fn srgb(linear: f64) -> f64 {
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

/// Decodes an sRGB value in \[0, 1\] (IEC 61966-2-1).
pub fn linear(srgb: f64) -> f64 {
    if srgb <= 0.04045 { srgb / 12.92 } else { ((srgb + 0.055) / 1.055).powf(2.4) }
}

/// The smallest value that `share` of the weight does not exceed; 0 without values.
fn percentile(weighted: &mut [(f64, f64)], share: f64) -> f64 {
    weighted.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let wanted = share * weighted.iter().map(|w| w.1).sum::<f64>();
    let mut below = 0.0;
    for &(value, weight) in weighted.iter() {
        below += weight;
        if below >= wanted {
            return value;
        }
    }
    weighted.last().map_or(0.0, |w| w.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_encodes_the_published_values() {
        // Mid grey, and both sides of the join at 0.0031308.
        assert!((srgb(0.214_041_14) - 0.5).abs() < 1e-7);
        assert!((srgb(0.003_130_8) - 0.040_449_936).abs() < 1e-9);
        assert!((srgb(0.003_130_9) - srgb(0.003_130_7)).abs() < 1e-5);
        assert_eq!((srgb(0.0), (srgb(1.0) * 1e12).round()), (0.0, 1e12));
        for k in 0..=255 {
            let x = f64::from(k) / 255.0;
            assert!((srgb(linear(x)) - x).abs() < 1e-6);
        }
    }

    #[test]
    fn the_percentile_goes_by_weight_and_by_light() {
        // The lit weight is 10. Nine tenths of it have luminances of 1 and 2.
        let exposure =
            Exposure::automatic([(0.0, 50.0), (3.0, 1.0), (1.0, 5.0), (2.0, 4.0), (f64::NAN, 9.0)]);
        assert!((exposure.scale - 0.8 / 2.0).abs() < 1e-15);
        assert_eq!(exposure.encode([1000.0, 0.0, -1.0]), [255, 0, 0]);
        let twice = exposure.brighter(1.0);
        assert_eq!(twice.scale, 2.0 * exposure.scale);
        assert_eq!(exposure.encode([2.0; 3]), twice.encode([1.0; 3]));
    }

    #[test]
    fn exposure_of_darkness_is_finite_and_white_is_white() {
        assert_eq!(Exposure::automatic([]).scale, 1.0);
        assert!(Exposure::automatic([(1e-310, 1.0)]).scale.is_finite());
        assert_eq!(Exposure::of_white(4.0).encode([4.0, 8.0, 0.0]), [255, 255, 0]);
        assert_eq!(Exposure::of_white(4.0).white(), 4.0);
        // Half of white is 188 of 255 by the standard.
        assert_eq!(Exposure::of_white(4.0).encode([2.0; 3]), [188; 3]);
    }
}
