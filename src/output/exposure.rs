//! From radiosity to the colours of a screen.

use crate::patch::Patches;

/// Luminance of linear Rec. 709 red, green and blue.
pub const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// The share of the lit, non-emitting area that automatic exposure leaves darker than [`BRIGHT`].
const PERCENTILE: f64 = 0.9;
/// Linear brightness of that percentile: a well lit white wall, with room for what is brighter.
const BRIGHT: f64 = 0.8;

/// How bright radiosity is shown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exposure {
    /// Screen brightness (1 is white) per W/m².
    pub scale: f64,
}

impl Exposure {
    /// Shows 90 % of the lit area that does not emit below a brightness of 0.8, as pictures are shown. Lamps may clip, unlit surfaces and the
    /// unit of length have no say. A scene without light is shown black.
    ///
    /// # Panics
    /// When `radiosity` does not hold `channels` values a patch.
    pub fn automatic(patches: &Patches, radiosity: &[f64]) -> Exposure {
        let channels = patches.channels();
        assert_eq!(radiosity.len(), channels * patches.len(), "one value a patch and channel is wanted");
        let emits = |i: usize| patches.emission()[i * channels..][..channels].iter().any(|&e| e > 0.0);
        let lit = |i: usize| {
            let bright = luminance(rgb(&radiosity[i * channels..][..channels]));
            (bright > 0.0).then(|| (bright, patches.area(i)))
        };
        let mut seen: Vec<(f64, f64)> = (0..patches.len()).filter(|&i| !emits(i)).filter_map(lit).collect();
        if seen.is_empty() {
            seen = (0..patches.len()).filter_map(lit).collect();
        }
        let percentile = percentile(&mut seen, PERCENTILE);
        // A brightness so faint that its inverse overflows cannot be shown either.
        let scale = BRIGHT / percentile;
        Exposure { scale: if percentile > 0.0 && scale.is_finite() { scale } else { 1.0 } }
    }

    /// Brighter by so many stops: a stop is a factor of two.
    pub fn brighter(self, stops: f64) -> Exposure {
        Exposure { scale: self.scale * stops.exp2() }
    }

    /// The colour on a screen: exposed, clipped to white and encoded as sRGB.
    pub fn encode(self, radiosity: [f64; 3]) -> [u8; 3] {
        radiosity.map(|b| (srgb((b * self.scale).clamp(0.0, 1.0)) * 255.0).round() as u8)
    }
}

/// One to three channels as red, green and blue.
pub(crate) fn rgb(values: &[f64]) -> [f64; 3] {
    if let &[grey] = values { [grey; 3] } else { [values[0], values[1], values[2]] }
}

/// Luminance of a linear colour.
pub fn luminance(rgb: [f64; 3]) -> f64 {
    rgb.iter().zip(LUMINANCE).map(|(x, weight)| x * weight).sum()
}

/// Encodes a linear value in \[0, 1\] as IEC 61966-2-1 says.
pub fn srgb(linear: f64) -> f64 {
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

/// The value that `share` of the weight is below or at; 0 of nothing.
fn percentile(weighted: &mut [(f64, f64)], share: f64) -> f64 {
    weighted.sort_by(|a, b| a.0.total_cmp(&b.0));
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
    use crate::{Scene, patch::Subdivision, scene::Material};
    use glam::DVec3;

    #[test]
    fn srgb_encodes_the_published_values() {
        // Mid grey, and both sides of the join at 0.0031308.
        assert!((srgb(0.214_041_14) - 0.5).abs() < 1e-7);
        assert!((srgb(0.003_130_8) - 0.040_449_936).abs() < 1e-9);
        assert!((srgb(0.003_130_9) - srgb(0.003_130_7)).abs() < 1e-5);
        assert_eq!((srgb(0.0), (srgb(1.0) * 1e12).round()), (0.0, 1e12));
    }

    /// Unit squares, of which the first emits.
    fn squares(n: usize) -> Patches {
        let materials =
            vec![Material::new("lamp", [0.5; 3], [9.0; 3]), Material::new("wall", [0.5; 3], [0.0; 3])];
        let triangles: Vec<_> = (0..n)
            .map(|k| {
                let x = DVec3::X * (2 * k) as f64;
                ([x, x + DVec3::X, x + DVec3::Y], u32::from(k > 0))
            })
            .collect();
        Patches::subdivide(&Scene::new(&triangles, materials), &Subdivision::Edge(f64::INFINITY))
    }

    #[test]
    fn exposure_goes_by_lit_walls_not_by_lamps_or_darkness() {
        // A lamp, three dark walls and ten lit ones, of which the brightest may exceed the target.
        let mut radiosity = vec![1000.0, 0.0, 0.0, 0.0];
        radiosity.extend((1..=10).map(f64::from));
        let exposure = Exposure::automatic(&squares(14), &radiosity);
        assert!((exposure.scale - 0.8 / 9.0).abs() < 1e-15);
        assert_eq!(exposure.encode([1000.0, 0.0, -1.0]), [255, 0, 0]);
        let twice = exposure.brighter(1.0);
        assert_eq!(twice.scale, 2.0 * exposure.scale);
        assert_eq!(exposure.encode([2.0; 3]), twice.encode([1.0; 3]));
    }

    #[test]
    fn exposure_of_darkness_and_of_lamps_alone_is_finite() {
        assert_eq!(Exposure::automatic(&squares(3), &[0.0; 3]).encode([0.0; 3]), [0; 3]);
        assert!((Exposure::automatic(&squares(1), &[5.0]).scale - 0.8 / 5.0).abs() < 1e-15);
        assert!(Exposure::automatic(&squares(2), &[0.0, 1e-310]).scale.is_finite());
    }
}
