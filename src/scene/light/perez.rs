//! The all-weather sky of Perez, Seals and Michalsky ("All-weather model for sky luminance distribution: preliminary
//! configuration and validation", Solar Energy 50, 1993, with its erratum, 51, 1993).
//!
//! L = (1 + a exp(b / cos ζ)) (1 + c exp(d γ) + e cos² γ), where ζ is the angle from the zenith and γ the angle from
//! the sun. The five coefficients follow from the sun's zenith angle Z and from the clearness ε and the brightness Δ of
//! the sky.

use std::f64::consts::FRAC_PI_2;

/// Irradiance of the sun outside the atmosphere on a plane that faces it, W/m², at the mean distance.
pub const SOLAR_CONSTANT: f64 = 1367.0;
/// Illuminance of the sun outside the atmosphere on a plane that faces it, lx, for skies in photometric units.
pub const SOLAR_ILLUMINANCE: f64 = 127_500.0;

/// Upper ends of the bins of clearness. The last bin has no end.
const BINS: [f64; 7] = [1.065, 1.230, 1.500, 1.950, 2.800, 4.500, 6.200];

/// Table 1 of the paper: for each bin, x1 to x4 of the coefficients a, b, c, d and e. A coefficient is
/// x = x1 + x2 Z + Δ (x3 + x4 Z).
const TABLE: [[[f64; 4]; 5]; 8] = [
    [
        [1.3525, -0.2576, -0.2690, -1.4366],
        [-0.7670, 0.0007, 1.2734, -0.1233],
        [2.8000, 0.6004, 1.2375, 1.0000],
        [1.8734, 0.6297, 0.9738, 0.2809],
        [0.0356, -0.1246, -0.5718, 0.9938],
    ],
    [
        [-1.2219, -0.7730, 1.4148, 1.1016],
        [-0.2054, 0.0367, -3.9128, 0.9156],
        [6.9750, 0.1774, 6.4477, -0.1239],
        [-1.5798, -0.5081, -1.7812, 0.1080],
        [0.2624, 0.0672, -0.2190, -0.4285],
    ],
    [
        [-1.1000, -0.2515, 0.8952, 0.0156],
        [0.2782, -0.1812, -4.5000, 1.1766],
        [24.7219, -13.0812, -37.7000, 34.8438],
        [-5.0000, 1.5218, 3.9229, -2.6204],
        [-0.0156, 0.1597, 0.4199, -0.5562],
    ],
    [
        [-0.5484, -0.6654, -0.2672, 0.7117],
        [0.7234, -0.6219, -5.6812, 2.6297],
        [33.3389, -18.3000, -62.2500, 52.0781],
        [-3.5000, 0.0016, 1.1477, 0.1062],
        [0.4659, -0.3296, -0.0876, -0.0329],
    ],
    [
        [-0.6000, -0.3566, -2.5000, 2.3250],
        [0.2937, 0.0496, -5.6812, 1.8415],
        [21.0000, -4.7656, -21.5906, 7.2492],
        [-3.5000, -0.1554, 1.4062, 0.3988],
        [0.0032, 0.0766, -0.0656, -0.1294],
    ],
    [
        [-1.0156, -0.3670, 1.0078, 1.4051],
        [0.2875, -0.5328, -3.8500, 3.3750],
        [14.0000, -0.9999, -7.1406, 7.5469],
        [-3.4000, -0.1078, -1.0750, 1.5702],
        [-0.0672, 0.4016, 0.3017, -0.4844],
    ],
    [
        [-1.0000, 0.0211, 0.5025, -0.5119],
        [-0.3000, 0.1922, 0.7023, -1.6317],
        [19.0000, -5.0000, 1.2438, -1.9094],
        [-4.0000, 0.0250, 0.3844, 0.2656],
        [1.0468, -0.3788, -2.4517, 1.4656],
    ],
    [
        [-1.0500, 0.0289, 0.4260, 0.3590],
        [-0.3250, 0.1156, 0.7781, 0.0025],
        [31.0625, -14.5000, -46.1148, 55.3750],
        [-7.2312, 0.4050, 13.3500, 0.6234],
        [1.5000, -0.6426, 1.8564, 0.5636],
    ],
];

/// Sine of the lowest altitude in the measurements of the model, 6 degrees. If b is positive, which happens with bright
/// skies and the sun at the horizon, the model would send nearly all light from the horizon itself. The radiance is then
/// constant below this altitude.
const LOWEST_SCAN: f64 = 0.104_528;

/// The coefficients a to e of a sky.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Perez([f64; 5]);

/// Coefficients a to d of the luminous efficacy of diffuse and of direct light, lm/W, in each bin (Perez, Ineichen,
/// Seals, Michalsky and Stewart, "Modeling daylight availability and irradiance components from direct and global
/// irradiance", Solar Energy 44, 1990, table 4).
const EFFICACY: [[[f64; 4]; 2]; 8] = [
    [[97.24, -0.46, 12.00, -8.91], [57.20, -4.55, -2.98, 117.12]],
    [[107.22, 1.15, 0.59, -3.95], [98.99, -3.46, -1.21, 12.38]],
    [[104.97, 2.96, -5.53, -8.77], [109.83, -4.90, -1.71, -8.81]],
    [[102.39, 5.59, -13.95, -13.90], [110.34, -5.84, -1.99, -4.56]],
    [[100.71, 5.94, -22.75, -23.74], [106.36, -3.97, -1.75, -6.16]],
    [[106.42, 3.83, -36.15, -28.83], [107.19, -1.25, -1.51, -26.73]],
    [[141.88, 1.90, -53.24, -14.03], [105.75, 0.77, -1.26, -34.44]],
    [[152.23, 0.35, -45.27, -7.98], [101.18, 1.58, -1.10, -8.29]],
];

/// The parameters of a sky: the sun's zenith angle, the clearness, and the brightness.
struct Conditions {
    zenith: f64,
    clearness: f64,
    brightness: f64,
}

impl Conditions {
    fn new(direct: f64, diffuse: f64, altitude: f64, extraterrestrial: f64) -> Conditions {
        let zenith = FRAC_PI_2 - altitude.max(0.0);
        let cubed = 1.041 * zenith.powi(3);
        let clearness = if diffuse > 0.0 {
            ((diffuse + direct) / diffuse + cubed) / (1.0 + cubed)
        } else {
            f64::INFINITY
        };
        // Optical air mass: Kasten, "A new table and approximation formula for the relative optical air mass", 1965.
        let air = 1.0 / (zenith.cos() + 0.15 * (93.885 - zenith.to_degrees()).powf(-1.253));
        Conditions { zenith, clearness, brightness: (diffuse * air / extraterrestrial).clamp(0.01, 0.6) }
    }

    fn bin(&self) -> usize {
        BINS.partition_point(|&end| end <= self.clearness)
    }
}

/// Luminous efficacies of direct and of diffuse light, lm/W. They follow from the direct normal and the diffuse
/// horizontal irradiance in W/m², the altitude of the sun in radians, the irradiance of the sun outside the atmosphere
/// in W/m², and the dew point in °C.
pub fn luminous_efficacy(
    [direct, diffuse]: [f64; 2],
    altitude: f64,
    extraterrestrial: f64,
    dew_point: f64,
) -> [f64; 2] {
    let of = Conditions::new(direct, diffuse, altitude, extraterrestrial);
    let water = (0.07 * dew_point - 0.075).exp();
    let [[a, b, c, d], [e, f, g, h]] = EFFICACY[of.bin()];
    let of_direct = e + f * water + g * (5.73 * of.zenith - 5.0).exp() + h * of.brightness;
    let of_diffuse = a + b * water + c * of.zenith.cos() + d * of.brightness.ln();
    [of_direct.max(0.0), of_diffuse.max(0.0)]
}

impl Perez {
    /// Makes the sky from the direct normal and the diffuse horizontal irradiance and the sun's altitude in radians.
    /// `extraterrestrial` is the irradiance of the sun outside the atmosphere, in the same unit.
    pub fn new(direct: f64, diffuse: f64, altitude: f64, extraterrestrial: f64) -> Perez {
        let of = Conditions::new(direct, diffuse, altitude, extraterrestrial);
        let (zenith, bin) = (of.zenith, of.bin());
        // Outside the range of the table's fit, this bound keeps the radiance from becoming negative.
        let dim = (1.065..2.8).contains(&of.clearness);
        let brightness = if dim { of.brightness.max(0.2) } else { of.brightness };
        let row = &TABLE[bin];
        let x = |k: usize| {
            let [x1, x2, x3, x4] = row[k];
            x1 + x2 * zenith + brightness * (x3 + x4 * zenith)
        };
        let mut found = [x(0), x(1), x(2), x(3), x(4)];
        if bin == 0 {
            let [[c1, c2, c3, c4], [d1, d2, d3, d4]] = [row[2], row[3]];
            found[2] = ((brightness * (c1 + c2 * zenith)).powf(c3)).exp() - c4;
            found[3] = -(brightness * (d1 + d2 * zenith)).exp() + d3 + brightness * d4;
        }
        Perez(found)
    }

    /// Relative radiance at the altitude whose sine is `sin`. `cos_sun` is the cosine of the angle from the sun.
    pub(super) fn shape(&self, sin: f64, cos_sun: f64) -> f64 {
        let [a, b, c, d, e] = self.0;
        let gamma = cos_sun.clamp(-1.0, 1.0).acos();
        let lowest = if b > 0.0 { LOWEST_SCAN } else { 0.01 };
        let gradation = 1.0 + a * (b / sin.max(lowest)).exp();
        (gradation * (1.0 + c * (d * gamma).exp() + e * cos_sun * cos_sun)).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A clear noon is brightest around the sun, an overcast sky towards the zenith.
    #[test]
    fn clear_and_overcast_skies() {
        let clear = Perez::new(800.0, 90.0, 1.0, SOLAR_CONSTANT);
        assert!(clear.shape(0.84, 1.0) > 5.0 * clear.shape(0.84, 0.0));
        let overcast = Perez::new(0.0, 150.0, 0.8, SOLAR_CONSTANT);
        let ratio = overcast.shape(1.0, 0.0) / overcast.shape(0.05, 0.0);
        assert!((1.3..4.0).contains(&ratio), "{ratio}");
        let around = overcast.shape(0.7, 1.0) / overcast.shape(0.7, 0.5);
        assert!((0.8..1.6).contains(&around), "{around}");
    }

    /// Daylight has about 100 to 130 lm/W.
    #[test]
    fn efficacies_are_those_of_daylight() {
        for (of, altitude) in [([700.0, 120.0], 0.9), ([0.0, 150.0], 0.8), ([300.0, 200.0], 0.4)] {
            let [direct, diffuse] = luminous_efficacy(of, altitude, SOLAR_CONSTANT, 10.0);
            assert!((100.0..150.0).contains(&diffuse), "{of:?}: {diffuse}");
            assert!(of[0] == 0.0 || (80.0..115.0).contains(&direct), "{of:?}: {direct}");
        }
    }

    /// No irradiance makes a sky that is negative or not finite, not even with the sun at the horizon.
    #[test]
    fn skies_are_finite() {
        for altitude in [0.0, 0.01, 0.2, 0.7, 1.5] {
            for direct in [0.0, 10.0, 300.0, 1000.0] {
                for diffuse in [0.0, 1.0, 50.0, 500.0] {
                    let sky = Perez::new(direct, diffuse, altitude, SOLAR_CONSTANT);
                    for k in 0..40 {
                        let shape = sky.shape(f64::from(k % 5) / 4.0, f64::from(k / 5) / 4.0 - 1.0);
                        assert!(shape.is_finite() && shape >= 0.0, "{altitude} {direct} {diffuse}: {shape}");
                    }
                }
            }
        }
    }
}
