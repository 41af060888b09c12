//! Temperatures, fluxes and emissivities of surfaces, from a small TOML file.

use std::path::Path;

use serde::Deserialize;

use crate::{
    Error, Result,
    scene::text::{line_of, read_utf8},
};

/// The thermal boundary condition of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Condition {
    /// A given temperature.
    Temperature {
        /// The temperature in kelvin.
        temperature: f64,
        /// The emissivity, above 0 and at most 1.
        emissivity: f64,
    },
    /// A given net flux that leaves the surface.
    Flux {
        /// The net flux in W/m².
        flux: f64,
        /// The emissivity, above 0 and at most 1.
        emissivity: f64,
    },
    /// No net heat in total: an adiabatic wall or a radiation shield. The surface has one temperature, which follows
    /// from the others.
    Floating {
        /// The emissivity, above 0 and at most 1.
        emissivity: f64,
    },
}

impl Condition {
    /// Returns the emissivity.
    pub fn emissivity(&self) -> f64 {
        match *self {
            Condition::Temperature { emissivity, .. }
            | Condition::Flux { emissivity, .. }
            | Condition::Floating { emissivity } => emissivity,
        }
    }
}

/// A line of the file.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    temperature: Option<f64>,
    flux: Option<f64>,
    emissivity: Option<f64>,
    adiabatic: Option<bool>,
}

/// The conditions in a file.
#[derive(Debug, Clone, PartialEq)]
pub struct Conditions {
    /// One condition per surface, in the order of the names passed to [`Conditions::load`].
    pub surfaces: Vec<Condition>,
    /// The temperature in kelvin of the surroundings outside all surfaces, if given.
    pub sky: Option<f64>,
}

/// The name of the sky in the file, unless a surface has this name.
const SKY: &str = "sky";

impl Conditions {
    /// Reads the file. It has one line per surface, such as `wall = { temperature = 293, emissivity = 0.9 }`. Instead
    /// of a temperature the line may give a `flux` in W/m², or neither: then the temperature of the surface floats, and
    /// its emissivity is 1 by default. `sky` may have a temperature.
    ///
    /// # Errors
    /// [`Error::Io`] if the file cannot be read. [`Error::Input`] if it is invalid, names an unknown surface, or lacks
    /// one of `names`.
    pub fn load(path: &Path, names: &[String]) -> Result<Conditions> {
        let text = read_utf8(path)?;
        let file = toml::de::DeTable::parse(&text).map_err(|error| {
            let line = error.span().map(|span| line_of(text.as_bytes(), span.start));
            Error::input(path, line, error.message().to_owned())
        })?;
        let mut conditions: Vec<Option<Condition>> = vec![None; names.len()];
        let mut sky = None;
        for (key, value) in file.into_inner() {
            let line = Some(line_of(text.as_bytes(), key.span().start));
            let name = key.into_inner().into_owned();
            let fail = |message: String| Error::input(path, line, message);
            let entry = Entry::deserialize(toml::de::ValueDeserializer::from(value))
                .map_err(|error| fail(format!("`{name}`: {}", error.message())))?;
            match names.iter().position(|known| *known == name) {
                Some(k) => conditions[k] = Some(condition(&name, &entry).map_err(fail)?),
                None if name == SKY => sky = Some(sky_temperature(&entry).map_err(fail)?),
                None => {
                    let hint = format!(
                        "surfaces are {}",
                        names.iter().take(8).cloned().collect::<Vec<_>>().join(", ")
                    );
                    return Err(fail(format!("`{name}` is no surface of the scene")).with_hint(hint));
                }
            }
        }
        let missing = |(k, condition): (usize, Option<Condition>)| {
            condition.ok_or_else(|| {
                Error::input(path, None, format!("surface `{}` has no condition", names[k])).with_hint(
                    format!(
                        "add a line such as  {} = {{ temperature = 293, emissivity = 0.9 }}",
                        quoted(&names[k])
                    ),
                )
            })
        };
        let surfaces = conditions.into_iter().enumerate().map(missing).collect::<Result<_>>()?;
        Ok(Conditions { surfaces, sky })
    }
}

fn quoted(name: &str) -> String {
    let bare = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
    if bare { name.into() } else { format!("{name:?}") }
}

fn possible(name: &str, temperature: f64) -> std::result::Result<f64, String> {
    if temperature >= 0.0 && temperature.is_finite() {
        Ok(temperature)
    } else {
        Err(format!("`{name}`: a temperature of {temperature} K is impossible"))
    }
}

fn sky_temperature(entry: &Entry) -> std::result::Result<f64, String> {
    match *entry {
        Entry { temperature: Some(temperature), flux: None, emissivity: None, adiabatic: None } => {
            possible(SKY, temperature)
        }
        _ => Err("the sky has a temperature and nothing else: it is black".into()),
    }
}

fn condition(name: &str, entry: &Entry) -> std::result::Result<Condition, String> {
    let emissivity = match entry.emissivity {
        Some(e) if e > 0.0 && e <= 1.0 => Some(e),
        Some(e) => return Err(format!("`{name}`: an emissivity of {e} is not between 0 and 1")),
        None => None,
    };
    let needed = emissivity.ok_or_else(|| format!("`{name}` needs an emissivity"));
    match (entry.temperature, entry.flux, entry.adiabatic) {
        (None, None, Some(false)) => {
            Err(format!("`{name}` is not adiabatic: it needs a temperature or a flux"))
        }
        (Some(temperature), None, None | Some(false)) => {
            Ok(Condition::Temperature { temperature: possible(name, temperature)?, emissivity: needed? })
        }
        (None, Some(flux), None | Some(false)) if flux.is_finite() => {
            Ok(Condition::Flux { flux, emissivity: needed? })
        }
        (None, Some(flux), None | Some(false)) => Err(format!("`{name}`: a flux of {flux} is not finite")),
        (None, None, _) => Ok(Condition::Floating { emissivity: emissivity.unwrap_or(1.0) }),
        _ => Err(format!("`{name}` may have a temperature or a flux or be adiabatic, but only one of them")),
    }
}
