//! The exchange of heat as JSON, and its exchange areas as a table.

use std::io::{self, Write};

use serde::Serialize;

use crate::heat::Exchange;

/// The report of `radiosity exchange`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ExchangeReport {
    /// Version of the program.
    pub version: &'static str,
    /// The scene's file, as it was named.
    pub scene: String,
    /// Number of faces. The radiosity of each is taken as uniform.
    pub parts: usize,
    /// Whether the faces enclose a room, so that none of them sees the sky.
    pub enclosed: bool,
    /// The surfaces.
    pub surfaces: Vec<SurfaceHeat>,
    /// The sky: everything outside the scene.
    pub sky: SurfaceHeat,
    /// The sum of all heat, including that of the sky, relative to the sum of absolute values.
    pub imbalance: f64,
    /// RMS standard error of the view factors between faces that are not zero.
    pub view_factor_error: f64,
    /// What the reader and the computation left out or assumed.
    pub warnings: Vec<String>,
    /// Seconds, all in all.
    pub seconds: f64,
}

/// The heat of a surface.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SurfaceHeat {
    /// Its name.
    pub name: String,
    /// Area, m²; `null` for the sky.
    pub area: Option<f64>,
    /// Temperature, K. For a surface with a given flux: the fourth root of the mean fourth power.
    pub temperature: f64,
    /// Standard error of the temperature: 0 where the temperature was given.
    pub temperature_standard_error: f64,
    /// Net power, W: what leaves the surface minus what arrives.
    pub heat: f64,
    /// Standard error of the net power that follows from the standard errors of the view factors.
    pub heat_standard_error: f64,
}

impl SurfaceHeat {
    /// All surfaces, and the sky.
    pub fn of(
        names: &[String],
        areas: &[f64],
        sky: f64,
        found: &Exchange,
    ) -> (Vec<SurfaceHeat>, SurfaceHeat) {
        let surface = |k: usize| SurfaceHeat {
            name: names[k].clone(),
            area: Some(areas[k]),
            temperature: found.surfaces[k].temperature,
            temperature_standard_error: found.surfaces[k].temperature_error,
            heat: found.surfaces[k].heat,
            heat_standard_error: found.surfaces[k].heat_error,
        };
        let outside = SurfaceHeat {
            name: "sky".into(),
            area: None,
            temperature: sky,
            temperature_standard_error: 0.0,
            heat: found.sky,
            heat_standard_error: found.sky_error,
        };
        ((0..names.len()).map(surface).collect(), outside)
    }
}

impl ExchangeReport {
    /// Writes it as JSON.
    ///
    /// # Errors
    /// Errors of writing to `out`.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        super::write_json(self, out)
    }
}

/// Writes A_i 𝓕_ij in m² as CSV, with names in the first line and column.
///
/// # Errors
/// Errors of writing to `out`.
pub fn write_exchange_areas(names: &[String], found: &Exchange, out: &mut dyn Write) -> io::Result<()> {
    let names: Vec<String> =
        names.iter().map(|name| super::view_factors::quoted(name)).chain(["sky".into()]).collect();
    writeln!(out, "surface,{}", names.join(","))?;
    for (i, name) in names.iter().enumerate() {
        write!(out, "{name}")?;
        (0..names.len()).try_for_each(|j| write!(out, ",{:e}", found.exchange_areas[(i, j)]))?;
        writeln!(out)?;
    }
    Ok(())
}
