//! The files that the program writes: coloured meshes, pictures, tables and reports.
//!
//! A file is written whole or not at all ([`mod@file`]). All numbers in it are finite. A figure that is not known is
//! NaN in a PLY and `null` in a report.

pub mod daylight;
pub mod exchange;
pub mod exposure;
pub mod false_colour;
pub mod file;
pub mod final_gather;
pub mod gltf;
pub mod inspection_report;
pub mod lambert_report;
mod lit_sides;
mod meeting;
mod numpy;
pub mod page;
pub mod picture;
mod pieces;
#[cfg(feature = "cli")]
mod plot;
pub mod ply;
pub mod report;
pub mod sampling_report;
pub(crate) mod surfaces;
#[cfg(feature = "cli")]
pub mod tradeoff_plot;
pub mod tradeoff_report;
pub mod validation_report;
pub mod vertex_colors;
pub mod vertices;
pub mod view_factors;

use std::io::{self, Write};

/// Writes a report as indented JSON, followed by a line end.
pub(crate) fn write_json(report: &impl serde::Serialize, mut out: &mut dyn Write) -> io::Result<()> {
    serde_json::to_writer_pretty(&mut out, report)?;
    out.write_all(b"\n")
}
