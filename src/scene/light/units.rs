//! The units of light in a scene: watts or lumens.

use serde::Serialize;

use super::{SOLAR_CONSTANT, SOLAR_ILLUMINANCE};

/// Lumens per watt of light at the wavelength to which the eye is most sensitive. Blender and glTF convert with this
/// value. RADIANCE uses 179, the value for white light.
pub const LUMINOUS_EFFICACY: f64 = 683.0;

/// Radiometric or photometric quantities. Reflectance is the same in both.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Units {
    /// W, W/sr, W/m² and W/(m² sr). Luminous quantities of photometric files and of glTF are divided by `efficacy`.
    Radiometric {
        /// Lumens per watt.
        efficacy: f64,
    },
    /// lm, cd, lx and cd/m². Luminous quantities are not converted.
    Photometric,
}

/// The names of units.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct UnitNames {
    /// The unit of power.
    pub power: &'static str,
    /// The unit of irradiance.
    pub irradiance: &'static str,
    /// The unit of radiosity.
    pub radiosity: &'static str,
    /// The unit of radiance.
    pub radiance: &'static str,
    /// Divisor of luminous quantities when they are read, in lumens per watt; `null` if they are not converted.
    pub lumens_per_watt: Option<f64>,
}

impl Default for Units {
    /// Radiometric units with [`LUMINOUS_EFFICACY`].
    fn default() -> Units {
        Units::Radiometric { efficacy: LUMINOUS_EFFICACY }
    }
}

impl Units {
    /// The divisor of luminous quantities in files.
    pub fn efficacy(self) -> f64 {
        match self {
            Units::Radiometric { efficacy } => efficacy,
            Units::Photometric => 1.0,
        }
    }

    /// Irradiance of the sun outside the atmosphere, W/m² or lx, on a plane that faces it.
    pub fn extraterrestrial(self) -> f64 {
        match self {
            Units::Radiometric { .. } => SOLAR_CONSTANT,
            Units::Photometric => SOLAR_ILLUMINANCE,
        }
    }

    /// The names of units.
    pub fn names(self) -> UnitNames {
        match self {
            Units::Radiometric { efficacy } => UnitNames {
                power: "W",
                irradiance: "W/m2",
                radiosity: "W/m2",
                radiance: "W/(m2 sr)",
                lumens_per_watt: Some(efficacy),
            },
            Units::Photometric => UnitNames {
                power: "lm",
                irradiance: "lx",
                radiosity: "lm/m2",
                radiance: "cd/m2",
                lumens_per_watt: None,
            },
        }
    }
}
