//! What the numbers of a scene mean: watts or lumens.

use serde::Serialize;

use super::{SOLAR_CONSTANT, SOLAR_ILLUMINANCE};

/// Lumens of a watt of light where all of it has the wavelength that the eye is most sensitive to; as Blender and glTF convert.
/// RADIANCE takes 179, for white light.
pub const LUMINOUS_EFFICACY: f64 = 683.0;

/// Radiometric or photometric quantities. Reflectance is the same in both.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Units {
    /// W, W/sr, W/m² and W/(m² sr); luminous quantities of photometric files and of glTF are divided by so many lumens a watt.
    Radiometric {
        /// Lumens of a watt.
        efficacy: f64,
    },
    /// lm, cd, lx and cd/m²; nothing is divided.
    Photometric,
}

/// The names of units.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct UnitNames {
    /// Of power.
    pub power: &'static str,
    /// Of irradiance.
    pub irradiance: &'static str,
    /// Of radiosity.
    pub radiosity: &'static str,
    /// Of radiance.
    pub radiance: &'static str,
    /// Lumens that count as a watt where luminous quantities are read; `null` where nothing is converted.
    pub lumens_per_watt: Option<f64>,
}

impl Default for Units {
    /// Radiometric, with [`LUMINOUS_EFFICACY`].
    fn default() -> Units {
        Units::Radiometric { efficacy: LUMINOUS_EFFICACY }
    }
}

impl Units {
    /// What luminous quantities of files are divided by.
    pub fn efficacy(self) -> f64 {
        match self {
            Units::Radiometric { efficacy } => efficacy,
            Units::Photometric => 1.0,
        }
    }

    /// Irradiance of the sun outside the atmosphere.
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
