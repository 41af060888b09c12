//! What people take home: coloured meshes, pictures and reports.
//!
//! Everything written here is written whole or not at all ([`mod@file`]), and holds finite numbers only, except where a
//! figure is not known: NaN in a PLY, `null` in a report.

pub mod exchange;
pub mod exposure;
pub mod file;
pub mod final_gather;
pub mod gltf;
pub mod inspection_report;
pub mod lambert_report;
mod lit_sides;
mod meeting;
mod numpy;
pub mod picture;
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

/// Writes a report as indented JSON with a line end after it.
pub(crate) fn write_json(report: &impl serde::Serialize, mut out: &mut dyn Write) -> io::Result<()> {
    serde_json::to_writer_pretty(&mut out, report)?;
    out.write_all(b"\n")
}
