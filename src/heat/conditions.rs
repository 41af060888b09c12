//! What is known of surfaces, from a small TOML file.

use std::path::Path;

use serde::Deserialize;

use crate::{Error, Result};

/// What is known of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Condition {
    /// Its temperature.
    Temperature {
        /// Kelvin.
        temperature: f64,
        /// 0 to 1.
        emissivity: f64,
    },
    /// The net flux that leaves it.
    Flux {
        /// W/m².
        flux: f64,
        /// 0 to 1.
        emissivity: f64,
    },
    /// That it gains and loses nothing in all: an adiabatic wall, or a radiation shield. It has one temperature.
    Floating {
        /// 0 to 1.
        emissivity: f64,
    },
}

impl Condition {
    /// The emissivity.
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

/// What a file says of surfaces.
#[derive(Debug, Clone, PartialEq)]
pub struct Conditions {
    /// By the order of surfaces asked for.
    pub surfaces: Vec<Condition>,
    /// Kelvin of what is seen outside all surfaces, if told.
    pub sky: Option<f64>,
}

/// The name of the sky in the file, unless a surface has it.
const SKY: &str = "sky";

impl Conditions {
    /// Reads the file: a line a surface, `wall = { temperature = 293, emissivity = 0.9 }`. In place of a temperature it may hold a
    /// `flux` in W/m², or neither: then the surface floats. The emissivity of such a one is 1 where it is not told. `sky` may have a
    /// temperature.
    ///
    /// # Errors
    /// [`Error::Io`] and [`Error::Input`] when it cannot be read, names what is no surface, or lacks one of `names`.
    pub fn load(path: &Path, names: &[String]) -> Result<Conditions> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, e))?;
        let file = toml::de::DeTable::parse(&text).map_err(|error| {
            let line = error.span().map(|span| line_of(&text, span.start));
            Error::input(path, line, error.message().to_owned())
        })?;
        let mut conditions: Vec<Option<Condition>> = vec![None; names.len()];
        let mut sky = None;
        for (key, value) in file.into_inner() {
            let line = Some(line_of(&text, key.span().start));
            let name = key.into_inner().into_owned();
            let fail = |message: String| Error::input(path, line, message);
            let entry = Entry::deserialize(toml::de::ValueDeserializer::from(value))
                .map_err(|error| fail(format!("`{name}`: {}", error.message())))?;
            match names.iter().position(|known| *known == name) {
                Some(k) => conditions[k] = Some(condition(&name, &entry).map_err(fail)?),
                None if name == SKY => {
                    let temperature =
                        entry.temperature.ok_or_else(|| fail("the sky needs a temperature".into()))?;
                    sky = Some(positive("sky", temperature).map_err(fail)?);
                }
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
                Error::input(path, None, format!("nothing is said of surface `{}`", names[k])).with_hint(
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

fn line_of(text: &str, at: usize) -> usize {
    1 + text[..at.min(text.len())].matches('\n').count()
}

fn positive(name: &str, temperature: f64) -> std::result::Result<f64, String> {
    if temperature >= 0.0 && temperature.is_finite() {
        Ok(temperature)
    } else {
        Err(format!("`{name}`: a temperature of {temperature} K"))
    }
}

fn condition(name: &str, entry: &Entry) -> std::result::Result<Condition, String> {
    let emissivity = match entry.emissivity {
        Some(e) if e > 0.0 && e <= 1.0 => Some(e),
        Some(e) => return Err(format!("`{name}`: an emissivity of {e} is not between 0 and 1")),
        None => None,
    };
    let needed = emissivity.ok_or_else(|| format!("`{name}` needs an emissivity"));
    match (entry.temperature, entry.flux, entry.adiabatic.unwrap_or(false)) {
        (Some(temperature), None, false) => {
            Ok(Condition::Temperature { temperature: positive(name, temperature)?, emissivity: needed? })
        }
        (None, Some(flux), false) if flux.is_finite() => Ok(Condition::Flux { flux, emissivity: needed? }),
        (None, Some(flux), false) => Err(format!("`{name}`: a flux of {flux}")),
        (None, None, _) => Ok(Condition::Floating { emissivity: emissivity.unwrap_or(1.0) }),
        _ => Err(format!("`{name}` may have a temperature, a flux, or be adiabatic, but one of them")),
    }
}
