//! View factors as tables that other programs read, and the figures of their computation as JSON.

use std::{
    fmt::Write as _,
    io::{self, Write},
};

use rayon::prelude::*;
use serde::Serialize;

use super::report::BeforeAfter;
use crate::{scene::surfaces::Surfaces, view_factor::ViewFactors};

/// Rows that are written as text at a time.
const ROWS: usize = 256;

/// Writes the matrix as CSV. The first line names the columns: `surface`, `area`, `escaped`, then each surface. Row i holds its
/// name, its area in the square of the file's unit, the share of what leaves it that reaches no surface, and F_ij from it to
/// each: what `escaped` and these sum up to is 1. Numbers have as many digits as tell them from all others in double
/// precision.
///
/// # Errors
/// What `out` says.
pub fn write_matrix(surfaces: &Surfaces, found: &ViewFactors, out: &mut dyn Write) -> io::Result<()> {
    let names: Vec<String> = surfaces.list.iter().map(|surface| quoted(&surface.name)).collect();
    writeln!(out, "surface,area,escaped,{}", names.join(","))?;
    let form_factors = &found.form_factors;
    write_rows(names.len(), out, |i, text| {
        let (area, escaped) = (form_factors.areas()[i], form_factors.escaped()[i]);
        text.push_str(&names[i]);
        let mut row = vec![0.0; names.len()];
        form_factors.row(i).for_each(|(j, f)| row[j] = f);
        [area, escaped].into_iter().chain(row).for_each(|x| add(text, x));
        text.push('\n');
    })
}

/// Writes a line `from,to,view_factor,standard_error` for each view factor that is not zero, by rows. The standard error is
/// that of as many independent samples, before rows are closed.
///
/// # Errors
/// What `out` says.
pub fn write_pairs(surfaces: &Surfaces, found: &ViewFactors, out: &mut dyn Write) -> io::Result<()> {
    let names: Vec<String> = surfaces.list.iter().map(|surface| quoted(&surface.name)).collect();
    writeln!(out, "from,to,view_factor,standard_error")?;
    write_rows(names.len(), out, |i, text| {
        let mut row: Vec<(usize, f64)> = found.form_factors.row(i).collect();
        row.sort_unstable_by_key(|&(j, _)| j);
        for (j, f) in row {
            text.extend([names[i].as_str(), ",", names[j].as_str()]);
            [f, found.standard_error(i, j)].into_iter().for_each(|x| add(text, x));
            text.push('\n');
        }
    })
}

/// Writes what `row` makes of each row, in order.
fn write_rows(n: usize, out: &mut dyn Write, row: impl Fn(usize, &mut String) + Sync) -> io::Result<()> {
    let text = |i: usize| {
        let mut text = String::new();
        row(i, &mut text);
        text
    };
    for start in (0..n).step_by(ROWS) {
        let lines: Vec<String> = (start..n.min(start + ROWS)).into_par_iter().map(text).collect();
        lines.iter().try_for_each(|line| out.write_all(line.as_bytes()))?;
    }
    Ok(())
}

/// Adds a comma and the shortest text that reads back as the same number.
fn add(text: &mut String, x: f64) {
    let _ = if x == 0.0 || (1e-3..1e6).contains(&x) { write!(text, ",{x}") } else { write!(text, ",{x:e}") };
}

/// A field of a CSV file (RFC 4180).
fn quoted(name: &str) -> String {
    if name.contains([',', '"', '\n', '\r']) || name.trim() != name {
        format!("\"{}\"", name.replace('"', "\"\""))
    } else {
        name.into()
    }
}

/// What `radiosity view-factors --report` writes. A figure that is not finite is `null`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ViewFactorsReport {
    /// Version of the program.
    pub version: &'static str,
    /// The scene's file, as it was named.
    pub scene: String,
    /// Triangles of the scene that have an area.
    pub triangles: usize,
    /// Triangles and parallelograms between which view factors were computed.
    pub polygons: usize,
    /// Of them, those left out because an earlier one is at the same place and faces the same way.
    pub doubled: usize,
    /// Triangles left out as too small beside the scene.
    pub tiny: usize,
    /// Whether rows were closed to sum to one without escaping light.
    pub enclosed: bool,
    /// What hemisphere rays from the surfaces met, which tells whether they enclose a room.
    pub look: LookReport,
    /// Rays cast between surfaces.
    pub rays: u64,
    /// View factors that are not zero.
    pub non_zeros: usize,
    /// How wrong they are.
    pub error: ViewFactorErrorReport,
    /// Largest |sum of a row + its escaped share - 1|; as sampled only where rows are to sum to one.
    pub row_sum_deviation: BeforeAfter,
    /// Largest |A_i F_ij - A_j F_ji| / min(A_i, A_j).
    pub reciprocity_deviation: BeforeAfter,
    /// The surfaces, in the order of rows and columns.
    pub surfaces: Vec<SurfaceReport>,
    /// What the reader and the computation left out or assumed.
    pub warnings: Vec<String>,
    /// Time of each stage.
    pub seconds: ViewFactorSeconds,
    /// Most memory held at any time; `null` where the operating system does not tell.
    pub peak_bytes: Option<u64>,
    /// What was asked for.
    pub options: ViewFactorOptionsReport,
}

/// What rays met.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LookReport {
    /// Rays, spread evenly over the area of all surfaces.
    pub rays: u64,
    /// Of them, those that met a surface from behind,
    pub backs: u64,
    /// and those that met nothing.
    pub escaped: u64,
}

/// Standard errors that as many independent samples would have, before rows are closed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ViewFactorErrorReport {
    /// RMS over all pairs of surfaces.
    pub rms: f64,
    /// The one that was wanted.
    pub wanted: f64,
    /// The largest of a view factor,
    pub largest: f64,
    /// and from which surface to which it is.
    pub largest_at: Option<[String; 2]>,
}

/// A surface.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SurfaceReport {
    /// Its name.
    pub name: String,
    /// The line of its first face; `null` in binary files.
    pub line: Option<usize>,
    /// Faces of the file that it is of,
    pub faces: usize,
    /// and triangles and parallelograms.
    pub polygons: usize,
    /// Its area.
    pub area: f64,
    /// Sum of its view factors as sampled.
    pub row_sum: f64,
    /// The share of what leaves it that reaches no surface.
    pub escaped: f64,
}

/// Seconds that the stages took.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct ViewFactorSeconds {
    /// Reading the scene, and making surfaces of it.
    pub load: f64,
    /// Looking whether they enclose a room.
    pub look: f64,
    /// View factors.
    pub view_factors: f64,
    /// Writing tables.
    pub output: f64,
    /// All.
    pub total: f64,
}

/// What was asked for.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ViewFactorOptionsReport {
    /// What one surface is.
    pub by: &'static str,
    /// Which sides of faces are surfaces.
    pub side: &'static str,
    /// The seed.
    pub seed: u64,
    /// Threads used.
    pub threads: usize,
}

impl ViewFactorsReport {
    /// Writes it as JSON.
    ///
    /// # Errors
    /// What `out` says.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        super::write_json(self, out)
    }
}

impl ViewFactorErrorReport {
    /// Collects what is known of the errors.
    pub fn of(surfaces: &Surfaces, found: &ViewFactors, wanted: f64) -> Self {
        let largest = found.largest_standard_error();
        let name = |i: usize| surfaces.list[i].name.clone();
        ViewFactorErrorReport {
            rms: found.error,
            wanted,
            largest: largest.map_or(0.0, |(_, _, error)| error),
            largest_at: largest.map(|(i, j, _)| [name(i), name(j)]),
        }
    }
}

impl SurfaceReport {
    /// One report a surface.
    pub fn all(surfaces: &Surfaces, found: &ViewFactors) -> Vec<SurfaceReport> {
        let report = |(i, surface): (usize, &crate::scene::surfaces::Surface)| SurfaceReport {
            name: surface.name.clone(),
            line: surface.line,
            faces: surface.faces,
            polygons: surface.polygons.len(),
            area: found.form_factors.areas()[i],
            row_sum: found.row_sums[i],
            escaped: found.form_factors.escaped()[i],
        };
        surfaces.list.iter().enumerate().map(report).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_back_as_they_were() {
        for x in [0.0, 1.0, 0.1, 1.0 / 3.0, 1e-3, 9.9e-4, 5e-324, 1.23456789e300, f64::MAX, 123456.7] {
            let mut text = String::new();
            add(&mut text, x);
            assert_eq!(text[1..].parse::<f64>().unwrap().to_bits(), x.to_bits());
        }
        let mut text = String::new();
        [0.25, 1e-9, 0.0].into_iter().for_each(|x| add(&mut text, x));
        assert_eq!(text, ",0.25,1e-9,0");
    }

    #[test]
    fn names_that_csv_would_cut_are_quoted() {
        assert_eq!(quoted("wall north"), "wall north");
        assert_eq!(quoted("a,b"), "\"a,b\"");
        assert_eq!(quoted("6\" pipe"), "\"6\"\" pipe\"");
    }
}
