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
    /// Number of faces. The radiosity of each face is assumed to be uniform.
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
    /// Warnings of the reader and of the computation.
    pub warnings: Vec<String>,
    /// Total time in seconds.
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
    /// Standard error of the temperature, K; 0 for a given temperature.
    pub temperature_standard_error: f64,
    /// Net power, W: the power that leaves the surface minus the power that arrives.
    pub heat: f64,
    /// Standard error of the net power from the standard errors of the view factors, W.
    pub heat_standard_error: f64,
}

impl SurfaceHeat {
    /// Collects the heat of all surfaces, and of the sky.
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
    /// Writes the report as indented JSON, followed by a line end.
    ///
    /// # Errors
    /// Errors of writing to `out`.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        super::write_json(self, out)
    }
}

/// Writes the exchange areas A_i 𝓕_ij in m² as CSV, with names in the first line and column.
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
