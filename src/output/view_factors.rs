//! View factors as tables that other programs read, and the figures of their computation as JSON.

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

/// Rows that are written as text at a time.
const ROWS: usize = 256;

/// What a matrix is written as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MatrixFormat {
    /// All entries as text, with names, areas and what escapes.
    Csv,
    /// All entries as a NumPy array.
    Npy,
    /// What is not zero as SciPy's sparse matrix.
    Npz,
    /// What is not zero as Matrix Market coordinates.
    MatrixMarket,
}

impl MatrixFormat {
    /// By the ending of a name: `.csv`, `.npy`, `.npz` or `.mtx`.
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

/// The matrix of view factors, with the sky and the ground as surfaces of their own where that is wanted.
///
/// What leaves a surface upward goes to the sky, what leaves it downward to the ground. Both are infinitely far and large: nothing of
/// what leaves them is counted, and their rows are empty.
#[derive(Debug, Clone, Copy)]
pub struct Table<'a> {
    /// The surfaces,
    pub surfaces: &'a Surfaces,
    /// and what is known of them.
    pub found: &'a ViewFactors,
    /// Whether the sky is a surface.
    pub sky: bool,
    /// Whether the ground is one.
    pub ground: bool,
}

impl Table<'_> {
    /// The names of rows and columns.
    pub fn names(&self) -> Vec<String> {
        let own = self.surfaces.list.iter().map(|surface| surface.name.clone());
        own.chain(self.sky.then(|| "sky".into())).chain(self.ground.then(|| "ground".into())).collect()
    }

    /// How many rows and columns there are.
    pub fn len(&self) -> usize {
        self.found.len() + usize::from(self.sky) + usize::from(self.ground)
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn area(&self, i: usize) -> f64 {
        self.found.areas().get(i).copied().unwrap_or(f64::INFINITY)
    }

    /// What of a row reaches no surface, nor the sky or the ground where they are surfaces.
    pub fn escaped(&self, i: usize) -> Share {
        let Some(lost) = self.found.lost.get(i) else { return Share::default() };
        match (self.sky, self.ground) {
            (false, false) => lost.escaped,
            (true, true) => lost.backs,
            (true, false) => sum(lost.backs, lost.down),
            (false, true) => sum(lost.backs, lost.up),
        }
    }

    /// Columns, view factors and standard errors of a row, by columns; also of those that rays found to be zero but might not be.
    fn entries(&self, i: usize) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
        let own = (i < self.found.len()).then(|| self.found.entries(i)).into_iter().flatten();
        let lost = self.found.lost.get(i).copied().unwrap_or_default();
        let far = [self.sky.then_some(lost.up), self.ground.then_some(lost.down)];
        let columns = (self.found.len()..).zip(far.into_iter().flatten());
        own.chain(columns.map(|(j, share)| (j, share.value, share.error)))
    }

    /// Columns and view factors of a row that are not zero, by columns.
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
    /// What `out` says.
    pub fn write(&self, format: MatrixFormat, out: &mut dyn Write) -> io::Result<()> {
        match format {
            MatrixFormat::Csv => self.write_csv(out),
            MatrixFormat::Npy => numpy::write_dense(self.len(), |i| self.dense_row(i), out),
            MatrixFormat::Npz => numpy::write_sparse(self.len(), |i| self.row(i), out),
            MatrixFormat::MatrixMarket => self.write_matrix_market(out),
        }
    }

    /// The first line names the columns: `surface`, `area`, `escaped`, then each surface. Row i holds its name, its area in the
    /// square of the file's unit, the share of what leaves it that reaches no surface, and F_ij from it to each: what `escaped` and
    /// these sum up to is 1. Numbers have as many digits as tell them from all others in double precision.
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

    /// Coordinates from 1 (R. F. Boisvert, R. Pozo and K. A. Remington, "The Matrix Market Exchange Formats", NISTIR 5935, 1996).
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

    /// Writes a line `from,to,view_factor,standard_error` for each view factor that is not zero, by rows, and for those that rays
    /// found to be zero but might not be.
    ///
    /// # Errors
    /// What `out` says.
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

/// Two shares of what escapes, which is known better than how it is divided.
fn sum(a: Share, b: Share) -> Share {
    Share { value: a.value + b.value, error: a.error.hypot(b.error) }
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
pub(super) fn quoted(name: &str) -> String {
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
    /// Rays cast between surfaces of which others hide parts.
    pub rays: u64,
    /// View factors that are not zero.
    pub non_zeros: usize,
    /// How wrong they are.
    pub error: ViewFactorErrorReport,
    /// Largest |sum of a row + its escaped share - 1|; before closure only where rows are to sum to one.
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
    /// Rays: from each polygon some, and of large ones more.
    pub rays: u64,
    /// Of them, those that met a surface from behind,
    pub backs: u64,
    /// and those that met nothing.
    pub escaped: u64,
}

/// Standard errors of view factors that are not zero.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ViewFactorErrorReport {
    /// RMS over all of them, before rows are closed.
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
    /// Its area that others in its plane hide, which is not counted.
    pub hidden_area: f64,
    /// Sum of its view factors before closure.
    pub row_sum: f64,
    /// The share of what leaves it that reaches no surface: `backs` and `left`.
    pub escaped: f64,
    /// The standard error of that.
    pub escaped_standard_error: f64,
    /// The share that meets the backs of surfaces,
    pub backs: f64,
    /// with its standard error.
    pub backs_standard_error: f64,
    /// The share that leaves the scene: `sky` and `ground`,
    pub left: f64,
    /// with its standard error.
    pub left_standard_error: f64,
    /// The share that leaves it upward or level,
    pub sky: f64,
    /// with its standard error.
    pub sky_standard_error: f64,
    /// The share that leaves it downward,
    pub ground: f64,
    /// with its standard error.
    pub ground_standard_error: f64,
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

impl LookReport {
    /// The sum of what all surfaces saw.
    pub fn of(seen: &[Sight]) -> LookReport {
        let all = seen.iter().fold(Sight::default(), |all, sight| all.and(*sight));
        LookReport { rays: all.rays, backs: all.backs, escaped: all.up + all.down }
    }
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
