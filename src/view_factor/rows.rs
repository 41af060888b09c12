//! Rows of view factors: put together from the pairs of polygons, summed up, and whether they are those of a room.

use rayon::prelude::*;

use super::{pair::Pair, polygon::Polygon};
use crate::{Error, Result, form_factor::Matrix};

/// A sum of view factors is off one where it is so by more than this, and by more than so many standard errors.
const OFF: f64 = 0.01;
const STANDARD_ERRORS: f64 = 5.0;

/// Of pairs that are sorted by rows, and polygons that are by surfaces: the exchange areas of surfaces, and their standard
/// errors, in this unit of area.
pub(super) fn upper_triangles(pairs: &[Pair], polygons: &[Polygon], n: usize, unit: f64) -> [Matrix; 2] {
    let surface = |k: u32| polygons[k as usize].surface;
    let row = |i: usize| {
        let [start, end] = [0, 1].map(|k| pairs.partition_point(|p| (surface(p.i) as usize) < i + k));
        let mut cells: Vec<(u32, f64, f64)> =
            pairs[start..end].iter().map(|p| (surface(p.j), f64::from(p.exchange()), p.variance())).collect();
        cells.sort_by_key(|cell| cell.0);
        let merge = |same: &[(u32, f64, f64)]| {
            let sum = |value: fn(&(u32, f64, f64)) -> f64| same.iter().map(value).sum::<f64>();
            let twice = if same[0].0 as usize == i { 2.0 } else { 1.0 };
            let (exchange, error) = (twice * sum(|c| c.1), twice * sum(|c| c.2).sqrt());
            (same[0].0, (exchange / unit) as f32, (error / unit) as f32)
        };
        cells.chunk_by(|a, b| a.0 == b.0).map(merge).collect()
    };
    let rows: Vec<Vec<(u32, f32, f32)>> = (0..n).into_par_iter().map(row).collect();
    [false, true].map(|errors| {
        let (mut starts, mut columns, mut values) = (vec![0], Vec::new(), Vec::new());
        for row in &rows {
            let cells = row.iter().map(|&(j, exchange, error)| (j, if errors { error } else { exchange }));
            for (j, value) in cells.filter(|&(_, value)| value > 0.0) {
                columns.push(j);
                values.push(value);
            }
            starts.push(columns.len());
        }
        Matrix::new((n, n), starts, columns, values)
    })
}

/// The sums of the rows of a symmetric matrix, of which this is the upper triangle.
pub(super) fn sums_of_rows(upper: &Matrix, n: usize, value: impl Fn(f64) -> f64) -> Vec<f64> {
    let mut sums = vec![0.0; n];
    for (&entry, (i, j)) in upper {
        let value = value(f64::from(entry));
        sums[i as usize] += value;
        if i != j {
            sums[j as usize] += value;
        }
    }
    sums
}

/// What the sum of each row may be off one by.
pub(super) fn allowances(errors: &Matrix, areas: &[f64]) -> Vec<f64> {
    let variances = sums_of_rows(errors, areas.len(), |error| error * error);
    let allowed = |(variance, area): (&f64, &f64)| STANDARD_ERRORS * variance.sqrt() / area;
    variances.iter().zip(areas).map(|pair| OFF.max(allowed(pair))).collect()
}

/// The surface that contradicts most that all of them enclose a room.
pub(super) fn check_enclosed(row_sums: &[f64], errors: &Matrix, areas: &[f64]) -> Result<()> {
    let allowed = allowances(errors, areas);
    // Of nothing no diagonal makes one.
    let open = |&i: &usize| row_sums[i] <= 0.0 || row_sums[i] < 1.0 - allowed[i];
    match (0..areas.len()).filter(open).min_by(|&a, &b| row_sums[a].total_cmp(&row_sums[b])) {
        Some(surface) => Err(Error::NotEnclosed { surface, sum: row_sums[surface] }),
        None => Ok(()),
    }
}
