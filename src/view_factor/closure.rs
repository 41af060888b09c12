//! Closes rows to a sum of one. The deviation left by sampling is distributed to the least certain entries.
//!
//! Of all changes that close the rows, this one is smallest in units of the standard errors: an exchange area x_ij with
//! variance v_ij changes by v_ij (λ_i + λ_j), where the multipliers λ solve a symmetric system (adjustment of
//! observations with conditions; C. F. Gauss, *Theoria combinationis observationum*, 1828). Entries known by formulas
//! change only within their own small error.

use nalgebra::DMatrix;

use super::cell::Cell;

/// Deviation of closed rows, as a share of their area.
const CLOSED: f64 = 1e-14;
/// Most steps of conjugate gradients.
const STEPS: usize = 2000;
/// Most rounds. In each of them, exchange areas that would become negative are set to zero and stay zero.
const ROUNDS: usize = 20;
/// Up to this number of surfaces the standard errors after closing are computed. With more surfaces each error changes
/// little.
const FEW: usize = 400;

/// Changes the sums of the given rows to `targets`, and updates the standard errors.
pub(super) fn close(cells: &mut [Vec<Cell>], targets: &[f64], rows: &[bool]) {
    if !rows.contains(&true) {
        return;
    }
    let n = targets.len();
    let mut variances: Vec<Vec<f64>> =
        cells.iter().map(|row| row.iter().map(|cell| cell.error().powi(2)).collect()).collect();
    for _ in 0..ROUNDS {
        let missing = missing(cells, targets, rows);
        let worst = (0..n).map(|i| (missing[i] / targets[i]).abs()).fold(0.0, f64::max);
        let multipliers = if worst > CLOSED {
            multipliers(cells, &variances, missing, targets, rows)
        } else {
            vec![0.0; n]
        };
        let mut negative = false;
        for (i, row) in cells.iter_mut().enumerate() {
            for (cell, variance) in row.iter_mut().zip(&mut variances[i]) {
                let j = cell.column as usize;
                let change = if i == j { multipliers[i] } else { multipliers[i] + multipliers[j] };
                cell.exchange += *variance * change;
                if cell.exchange < 0.0 {
                    (cell.exchange, *variance, negative) = (0.0, 0.0, true);
                }
            }
        }
        if worst <= CLOSED && !negative {
            break;
        }
    }
    if n <= FEW && rows.iter().all(|&row| row) {
        tighten(cells, &variances);
    }
}

/// The difference of each row sum from its target.
fn missing(cells: &[Vec<Cell>], targets: &[f64], rows: &[bool]) -> Vec<f64> {
    let sums = sums(cells, targets.len(), |cell| cell.exchange);
    (0..targets.len()).map(|i| if rows[i] { targets[i] - sums[i] } else { 0.0 }).collect()
}

/// Row sums of a symmetric matrix, from its upper triangle.
pub(super) fn sums(cells: &[Vec<Cell>], n: usize, value: impl Fn(&Cell) -> f64) -> Vec<f64> {
    let mut sums = vec![0.0; n];
    for (i, row) in cells.iter().enumerate() {
        for cell in row {
            let value = value(cell);
            sums[i] += value;
            if i != cell.column as usize {
                sums[cell.column as usize] += value;
            }
        }
    }
    sums
}

/// Solves for the multipliers by conjugate gradients, scaled by the diagonal.
fn multipliers(
    cells: &[Vec<Cell>],
    variances: &[Vec<f64>],
    mut residual: Vec<f64>,
    targets: &[f64],
    rows: &[bool],
) -> Vec<f64> {
    let n = residual.len();
    let product = |x: &[f64]| {
        let mut y = vec![0.0; n];
        for (i, row) in cells.iter().enumerate() {
            for (cell, v) in row.iter().zip(&variances[i]) {
                let j = cell.column as usize;
                if i == j {
                    y[i] += v * x[i];
                } else {
                    let sum = v * (x[i] + x[j]);
                    y[i] += sum;
                    y[j] += sum;
                }
            }
        }
        (0..n).for_each(|i| {
            if !rows[i] {
                y[i] = 0.0
            }
        });
        y
    };
    let mut diagonal = vec![0.0; n];
    for (i, row) in cells.iter().enumerate() {
        for (cell, v) in row.iter().zip(&variances[i]) {
            diagonal[i] += v;
            if i != cell.column as usize {
                diagonal[cell.column as usize] += v;
            }
        }
    }
    let scaled = |r: &[f64]| -> Vec<f64> {
        (0..n).map(|i| if rows[i] && diagonal[i] > 0.0 { r[i] / diagonal[i] } else { 0.0 }).collect()
    };
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut x = vec![0.0; n];
    let mut direction = scaled(&residual);
    let mut size = dot(&residual, &direction);
    for _ in 0..STEPS {
        let off =
            (0..n).any(|i| rows[i] && diagonal[i] > 0.0 && residual[i].abs() > 0.1 * CLOSED * targets[i]);
        if !off || !(size > 0.0) {
            break;
        }
        let image = product(&direction);
        let curvature = dot(&direction, &image);
        if !(curvature > 0.0) {
            break;
        }
        let step = size / curvature;
        (0..n).for_each(|i| x[i] += step * direction[i]);
        (0..n).for_each(|i| residual[i] -= step * image[i]);
        let next = scaled(&residual);
        let before = std::mem::replace(&mut size, dot(&residual, &next));
        let growth = size / before;
        (0..n).for_each(|i| direction[i] = next[i] + growth * direction[i]);
    }
    x
}

/// The variances of adjusted observations: v_ij - v_ij² (Z_ii + 2 Z_ij + Z_jj), where Z is the inverse of the system's
/// matrix.
fn tighten(cells: &mut [Vec<Cell>], variances: &[Vec<f64>]) {
    let n = cells.len();
    let mut system = DMatrix::<f64>::zeros(n, n);
    for (i, row) in cells.iter().enumerate() {
        for (cell, &v) in row.iter().zip(&variances[i]) {
            let j = cell.column as usize;
            system[(i, i)] += v;
            if i != j {
                system[(j, j)] += v;
                system[(i, j)] += v;
                system[(j, i)] += v;
            }
        }
    }
    // Scaled to a unit diagonal, because areas and thus variances may differ widely.
    let scale: Vec<f64> =
        (0..n).map(|i| if system[(i, i)] > 0.0 { system[(i, i)].sqrt().recip() } else { 0.0 }).collect();
    // The small diagonal term keeps linearly dependent rows invertible.
    let entry = |i: usize, j: usize| system[(i, j)] * scale[i] * scale[j] + if i == j { 1e-12 } else { 0.0 };
    let Some(inverse) = DMatrix::from_fn(n, n, entry).cholesky().map(|c| c.inverse()) else { return };
    let z = |i: usize, j: usize| inverse[(i, j)] * scale[i] * scale[j];
    for (i, row) in cells.iter_mut().enumerate() {
        for (cell, &v) in row.iter_mut().zip(&variances[i]) {
            let j = cell.column as usize;
            let known = if i == j { z(i, i) } else { z(i, i) + 2.0 * z(i, j) + z(j, j) };
            let share = (1.0 - v * known).clamp(0.0, 1.0);
            for part in [&mut cell.spread, &mut cell.quartic, &mut cell.doubt] {
                *part *= share.sqrt() as f32;
            }
        }
    }
}
