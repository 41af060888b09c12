//! View factors as tables for other programs, and the report of their computation as JSON.

use std::{
    fmt::Write as _,
    io::{self, Write},
    path::Path,
};

use rayon::prelude::*;
use serde::Serialize;

use super::{numpy, report::BeforeAfter};
use crate::{
    scene::surfaces::Surfaces,
    view_factor::{Share, Sight, ViewFactors},
};

/// Number of rows that are converted to text at a time.
const ROWS: usize = 256;

/// The format of a matrix.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MatrixFormat {
    /// All entries as text, with names, areas and escaped shares.
    Csv,
    /// All entries as a NumPy array.
    Npy,
    /// The non-zero entries as a sparse matrix of SciPy.
    Npz,
    /// The non-zero entries as Matrix Market coordinates.
    MatrixMarket,
}

impl MatrixFormat {
    /// The format by the file name extension: `csv`, `npy`, `npz` or `mtx`.
    pub fn of(path: &Path) -> Option<MatrixFormat> {
        let extension = path.extension()?.to_string_lossy().to_lowercase();
        match extension.as_str() {
            "csv" => Some(MatrixFormat::Csv),
            "npy" => Some(MatrixFormat::Npy),
            "npz" => Some(MatrixFormat::Npz),
            "mtx" => Some(MatrixFormat::MatrixMarket),
            _ => None,
        }
    }
}

/// The matrix of view factors. Sky and ground may be surfaces of their own.
///
/// Light that leaves the scene upward reaches the sky, and light that leaves it downward reaches the ground. Both are
/// infinitely large and far away, so light that they send is not counted and their rows are empty.
#[derive(Debug, Clone, Copy)]
pub struct Table<'a> {
    /// The surfaces.
    pub surfaces: &'a Surfaces,
    /// The view factors of the surfaces.
    pub found: &'a ViewFactors,
    /// Whether the sky is a surface.
    pub sky: bool,
    /// Whether the ground is a surface.
    pub ground: bool,
}

impl Table<'_> {
    /// The names of rows and columns.
    pub fn names(&self) -> Vec<String> {
        let own = self.surfaces.list.iter().map(|surface| surface.name.clone());
        own.chain(self.sky.then(|| "sky".into())).chain(self.ground.then(|| "ground".into())).collect()
    }

    /// Number of rows and of columns.
    pub fn len(&self) -> usize {
        self.found.len() + usize::from(self.sky) + usize::from(self.ground)
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn area(&self, i: usize) -> f64 {
        self.found.areas().get(i).copied().unwrap_or(f64::INFINITY)
    }

    /// The share of a row that reaches no surface. If sky or ground are surfaces, light that reaches them does not
    /// count.
    pub fn escaped(&self, i: usize) -> Share {
        let Some(lost) = self.found.lost.get(i) else { return Share::default() };
        match (self.sky, self.ground) {
            (false, false) => lost.escaped,
            (true, true) => lost.backs,
            (true, false) => sum(lost.backs, lost.down),
            (false, true) => sum(lost.backs, lost.up),
        }
    }

    /// Columns, view factors and standard errors of a row, in the order of columns. Includes view factors that are zero
    /// with a standard error.
    fn entries(&self, i: usize) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
        let own = (i < self.found.len()).then(|| self.found.entries(i)).into_iter().flatten();
        let lost = self.found.lost.get(i).copied().unwrap_or_default();
        let far = [self.sky.then_some(lost.up), self.ground.then_some(lost.down)];
        let columns = (self.found.len()..).zip(far.into_iter().flatten());
        own.chain(columns.map(|(j, share)| (j, share.value, share.error)))
    }

    /// Columns and view factors of the non-zero entries of a row, in the order of columns.
    fn row(&self, i: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.entries(i).map(|(j, f, _)| (j, f)).filter(|&(_, f)| f > 0.0)
    }

    fn dense_row(&self, i: usize) -> Vec<f64> {
        let mut row = vec![0.0; self.len()];
        self.row(i).for_each(|(j, f)| row[j] = f);
        row
    }

    /// Writes the matrix.
    ///
    /// # Errors
    /// Errors of writing to `out`.
    pub fn write(&self, format: MatrixFormat, out: &mut dyn Write) -> io::Result<()> {
        match format {
            MatrixFormat::Csv => self.write_csv(out),
            MatrixFormat::Npy => numpy::write_dense(self.len(), |i| self.dense_row(i), out),
            MatrixFormat::Npz => numpy::write_sparse(self.len(), |i| self.row(i), out),
            MatrixFormat::MatrixMarket => self.write_matrix_market(out),
        }
    }

    /// The first line names the columns: `surface`, `area`, `escaped`, then each surface. Row i holds its name, its
    /// area in square scene units, the share that reaches no surface, and F_ij to each surface. `escaped` and the F_ij
    /// sum to 1. Numbers have enough digits for double precision.
    fn write_csv(&self, out: &mut dyn Write) -> io::Result<()> {
        let names: Vec<String> = self.names().iter().map(|name| quoted(name)).collect();
        writeln!(out, "surface,area,escaped,{}", names.join(","))?;
        write_rows(names.len(), out, |i, text| {
            text.push_str(&names[i]);
            let start = [self.area(i), self.escaped(i).value];
            start.into_iter().chain(self.dense_row(i)).for_each(|x| add(text, x));
            text.push('\n');
        })
    }

    /// Writes coordinates, counted from 1 (R. F. Boisvert, R. Pozo and K. A. Remington, "The Matrix Market Exchange
    /// Formats", NISTIR 5935, 1996).
    fn write_matrix_market(&self, out: &mut dyn Write) -> io::Result<()> {
        let n = self.len();
        let non_zeros: usize = (0..n).into_par_iter().map(|i| self.row(i).count()).sum();
        writeln!(out, "%%MatrixMarket matrix coordinate real general")?;
        writeln!(out, "% view factors from the surface of the row to that of the column")?;
        writeln!(out, "{n} {n} {non_zeros}")?;
        write_rows(n, out, |i, text| {
            self.row(i).for_each(|(j, f)| {
                let _ = writeln!(text, "{} {} {f:e}", i + 1, j + 1);
            });
        })
    }

    /// Writes a line `from,to,view_factor,standard_error` for each view factor that is not zero or has a standard
    /// error, in the order of rows.
    ///
    /// # Errors
    /// Errors of writing to `out`.
    pub fn write_pairs(&self, out: &mut dyn Write) -> io::Result<()> {
        let names: Vec<String> = self.names().iter().map(|name| quoted(name)).collect();
        writeln!(out, "from,to,view_factor,standard_error")?;
        write_rows(names.len(), out, |i, text| {
            for (j, f, error) in self.entries(i).filter(|e| e.1 > 0.0 || e.2 > 0.0) {
                text.extend([names[i].as_str(), ",", names[j].as_str()]);
                [f, error].into_iter().for_each(|x| add(text, x));
                text.push('\n');
            }
        })
    }
}

/// The sum of two parts of the escaped share. Its error is that of independent parts: an upper estimate, because shares
/// of the same rays are negatively correlated.
fn sum(a: Share, b: Share) -> Share {
    Share { value: a.value + b.value, error: a.error.hypot(b.error) }
}

/// Writes the text that `row` returns for each row, in order.
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

/// Adds a comma and the shortest text that parses to the same number.
fn add(text: &mut String, x: f64) {
    let _ = if x == 0.0 || (1e-3..1e6).contains(&x) { write!(text, ",{x}") } else { write!(text, ",{x:e}") };
}

/// A field of a CSV file (RFC 4180).
pub(super) fn quoted(name: &str) -> String {
    if name.contains([',', '"', '\n', '\r']) || name.trim() != name {
        format!("\"{}\"", name.replace('"', "\"\""))
    } else {
        name.into()
    }
}

/// The report of `radiosity view-factors`. A figure that is not finite is `null`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ViewFactorsReport {
    /// Version of the program.
    pub version: &'static str,
    /// The scene's file, as it was named.
    pub scene: String,
    /// Number of triangles with an area.
    pub triangles: usize,
    /// Number of triangles and parallelograms between which view factors were computed.
    pub polygons: usize,
    /// Number of these that were left out because an earlier one is at the same place with the same orientation.
    pub doubled: usize,
    /// Number of triangles that were left out because they are too small compared with the scene.
    pub tiny: usize,
    /// Whether the surfaces are treated as an enclosure, so that all rows sum to 1.
    pub enclosed: bool,
    /// The hits of hemisphere rays from the surfaces. They show whether the surfaces enclose a room.
    pub look: LookReport,
    /// Number of rays for pairs of surfaces that others partly hide.
    pub rays: u64,
    /// Number of view factors that are not zero.
    pub non_zeros: usize,
    /// The errors.
    pub error: ViewFactorErrorReport,
    /// Largest |sum of a row + its escaped share - 1|. The value before closure is given only for an enclosure.
    pub row_sum_deviation: BeforeAfter,
    /// Largest |A_i F_ij - A_j F_ji| / min(A_i, A_j).
    pub reciprocity_deviation: BeforeAfter,
    /// The surfaces, in the order of rows and columns.
    pub surfaces: Vec<SurfaceReport>,
    /// Warnings: what was left out or assumed.
    pub warnings: Vec<String>,
    /// Time of each stage.
    pub seconds: ViewFactorSeconds,
    /// Peak memory of the process in bytes; `null` if the operating system does not report it.
    pub peak_bytes: Option<u64>,
    /// The options.
    pub options: ViewFactorOptionsReport,
}

/// The hits of rays.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LookReport {
    /// Number of rays. Large polygons cast more.
    pub rays: u64,
    /// Number of rays that hit a back.
    pub backs: u64,
    /// Number of rays that hit nothing.
    pub escaped: u64,
}

/// Standard errors of view factors that are not zero.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ViewFactorErrorReport {
    /// RMS of the standard errors, before closure.
    pub rms: f64,
    /// The target of this RMS.
    pub wanted: f64,
    /// The largest standard error.
    pub largest: f64,
    /// The surfaces of the view factor with the largest standard error.
    pub largest_at: Option<[String; 2]>,
}

/// A surface.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SurfaceReport {
    /// Its name.
    pub name: String,
    /// Line of its first face; `null` in binary files.
    pub line: Option<usize>,
    /// Number of its faces in the file.
    pub faces: usize,
    /// Number of its triangles and parallelograms.
    pub polygons: usize,
    /// Its area.
    pub area: f64,
    /// Its area that is hidden by other faces in the same plane. `area` does not include it.
    pub hidden_area: f64,
    /// Sum of its view factors before closure.
    pub row_sum: f64,
    /// The share that reaches no surface: the sum of `backs` and `left`.
    pub escaped: f64,
    /// Standard error of that share.
    pub escaped_standard_error: f64,
    /// The share that reaches the backs of surfaces.
    pub backs: f64,
    /// Its standard error.
    pub backs_standard_error: f64,
    /// The share that leaves the scene: the sum of `sky` and `ground`.
    pub left: f64,
    /// Its standard error.
    pub left_standard_error: f64,
    /// The share that leaves the scene upward or level.
    pub sky: f64,
    /// Its standard error.
    pub sky_standard_error: f64,
    /// The share that leaves the scene downward.
    pub ground: f64,
    /// Its standard error.
    pub ground_standard_error: f64,
}

/// Wall-clock time of each stage in seconds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct ViewFactorSeconds {
    /// Reading the scene and forming its surfaces.
    pub load: f64,
    /// Checking whether the surfaces enclose a room.
    pub look: f64,
    /// View factors.
    pub view_factors: f64,
    /// Writing tables.
    pub output: f64,
    /// All stages.
    pub total: f64,
}

/// The options of the run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ViewFactorOptionsReport {
    /// The unit that forms a surface: face, group, object, material or property.
    pub by: String,
    /// The sides of faces that are surfaces.
    pub side: &'static str,
    /// Seed of the rays.
    pub seed: u64,
    /// Number of threads.
    pub threads: usize,
}

impl LookReport {
    /// Sums the hits of all surfaces.
    pub fn of(seen: &[Sight]) -> LookReport {
        let all = seen.iter().fold(Sight::default(), |all, sight| all.and(*sight));
        LookReport { rays: all.rays, backs: all.backs, escaped: all.up + all.down }
    }
}

impl ViewFactorsReport {
    /// Writes the report as indented JSON, followed by a line end.
    ///
    /// # Errors
    /// Errors of writing to `out`.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        super::write_json(self, out)
    }
}

impl ViewFactorErrorReport {
    /// Collects the errors.
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
    /// The reports of the surfaces.
    pub fn all(surfaces: &Surfaces, found: &ViewFactors) -> Vec<SurfaceReport> {
        let report = |(i, surface): (usize, &crate::scene::surfaces::Surface)| {
            let lost = &found.lost[i];
            SurfaceReport {
                name: surface.name.clone(),
                line: surface.line,
                faces: surface.faces,
                polygons: surface.polygons.len(),
                area: found.areas()[i],
                hidden_area: found.hidden[i],
                row_sum: found.row_sums[i],
                escaped: lost.escaped.value,
                escaped_standard_error: lost.escaped.error,
                backs: lost.backs.value,
                backs_standard_error: lost.backs.error,
                left: lost.left.value,
                left_standard_error: lost.left.error,
                sky: lost.up.value,
                sky_standard_error: lost.up.error,
                ground: lost.down.value,
                ground_standard_error: lost.down.error,
            }
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
