//! Closure: all light that leaves a patch arrives somewhere or escapes.
//!
//! Pooling makes the exchange areas S reciprocal, but spoils the row sums, which one-way estimates keep exactly. A
//! positive diagonal D with
//!
//!   d_i Σ_j S_ij d_j + X_i d_i^ε = A_i
//!
//! restores them. X_i = A_i e_i is the exchange area with the outside. The scaling keeps symmetry, zeros and positive
//! signs.
//!
//! A patch's own rays measure its escaped share e_i. This estimate is unbiased and should stay. With ε = 1 the escaped
//! shares would be scaled like all other entries, and rows without an escaping ray could not return the light that
//! other rows lose. But ε = 0 has no solution if two objects see only each other and the outside: each object sends the
//! sum of A - X over its patches to the other, and the two sums differ by noise. A small ε lets the escaped shares
//! yield in that case. Elsewhere it moves them by a few percent of the noise.

use rayon::prelude::*;

use super::{SHORT, ordered_sum};
use crate::symmetric::Symmetric;

/// The scaling, and the deviation that it repaired.
pub(super) struct Closed {
    pub(super) scale: Vec<f64>,
    /// The exchange areas with the outside.
    pub(super) escaping: Vec<f64>,
    pub(super) deviation_before: f64,
}

/// Precision that the rounding of the longest row sums allows.
pub(super) const EXACT: f64 = 1e-13;

/// Rounds after which an unclosable matrix is given up. The remaining deviation is reported.
const MOST_ROUNDS: usize = 500;

/// Rounds after which rows that still deviate by more than [`CONTRADICTION`] keep the missing light on the diagonal.
const PATIENCE: usize = 100;
const CONTRADICTION: f64 = 1e-3;

/// The power ε of d that scales the exchange areas with the outside.
const YIELD: f64 = 0.1;
/// A row sum is scaled down to this share of itself at most. It matters if all own rays of a patch escape although rays
/// of other patches hit it.
pub(super) const LEAST_LANDING: f64 = 1e-3;

/// Newton's method starts when no row deviates by more than this.
const NEAR: f64 = 0.1;
/// Newton's method continues as long as each step leaves at most this share of the deviation.
const PROGRESS: f64 = 0.5;
/// Smallest share of the residual to which a Newton step is solved: some hundred times the rounding of single
/// precision.
const LEAST_STEP: f64 = 1e-5;

/// Finds the scaling. `precision` bounds the largest |row sum + escaped share - 1|.
///
/// Far from the solution it iterates the fixed point d ← sqrt(d A / (S d + X)). That converges, though slowly, for all
/// scenes that are not nearly bipartite. Near the solution it uses Newton's method (like Knight and Ruiz, "A fast
/// algorithm for matrix balancing", IMA Journal of Numerical Analysis 33, 2013), which needs a third of the products.
///
/// If two patches see hardly anything but each other, few rays may show that all light of one arrives at the other,
/// whose area is too small for it. No scaling closes such rows. After some rounds their missing light is kept on the
/// diagonal. Rows without any entry keep all light that does not escape on the diagonal from the start.
pub(super) fn close(matrix: &mut Symmetric, areas: &[f64], escaped: &[f64], precision: f64) -> Closed {
    let n = areas.len();
    let sums = matrix.row_sums();
    // Not zero if all own rays of a patch escape although rays of other patches may hit it.
    let least = |i: usize| if escaped[i] < 1.0 { 0.0 } else { LEAST_LANDING * sums[i].min(areas[i]) };
    let measured: Vec<f64> = (0..n).map(|i| areas[i] * escaped[i] - least(i)).collect();
    if (0..n).any(|i| sums[i] <= 0.0 && escaped[i] < 1.0) {
        let unknown = |i: usize| if sums[i] > 0.0 { 0.0 } else { (areas[i] - measured[i]) as f32 };
        matrix.add_diagonal(unknown);
    }
    let outside = |scale: &[f64]| -> Vec<f64> {
        let escapes = |(x, d): (&f64, &f64)| if *x > 0.0 { x * d.powf(YIELD) } else { 0.0 };
        measured.par_iter().zip(scale).with_min_len(SHORT).map(escapes).collect()
    };
    let rows = |matrix: &Symmetric, scale: &[f64], escaping: &[f64]| -> Vec<f64> {
        let mut arriving = vec![0.0; n];
        matrix.add_product(scale.as_chunks::<1>().0, arriving.as_chunks_mut::<1>().0);
        (0..n).into_par_iter().with_min_len(SHORT).map(|i| scale[i] * arriving[i] + escaping[i]).collect()
    };
    let mut scale = vec![1.0; n];
    let mut escaping = measured.clone();
    let mut deviation_before = None;
    let (mut newton, mut before) = (true, f64::INFINITY);
    for round in 1..=MOST_ROUNDS {
        escaping = outside(&scale);
        let sums = rows(matrix, &scale, &escaping);
        let off = |i: usize| (sums[i] / areas[i] - 1.0).abs();
        let deviation = (0..n).into_par_iter().with_min_len(SHORT).map(off).reduce(|| 0.0, f64::max);
        deviation_before.get_or_insert(deviation);
        if deviation < precision {
            break;
        }
        if round % PATIENCE == 0 && deviation > CONTRADICTION {
            // No row may exceed its area. The missing light stays on the diagonal.
            for i in 0..n {
                scale[i] *= (areas[i] / sums[i]).min(1.0);
            }
            let sums = rows(matrix, &scale, &outside(&scale));
            matrix.add_diagonal(|i| ((areas[i] - sums[i]).max(0.0) / scale[i].powi(2)) as f32);
            (newton, before) = (true, f64::INFINITY);
            continue;
        }
        if newton && deviation < NEAR {
            newton = deviation <= PROGRESS * before;
            let taken = if newton {
                step(matrix, areas, &mut scale, (&sums, &escaping), deviation, precision)
            } else {
                None
            };
            if let Some(share) = taken {
                // A shortened step need not reduce the deviation much.
                before = if share == 1.0 { deviation } else { f64::INFINITY };
                continue;
            }
            newton = false;
        }
        let scales = scale.par_iter_mut().zip(&sums).zip(areas).with_min_len(SHORT);
        scales.for_each(|((scale, sum), area)| *scale *= (area / sum).sqrt());
    }
    Closed { scale, escaping, deviation_before: deviation_before.unwrap_or(0.0) }
}

/// A step of Newton's method in ln d. It solves (diag(R - (1 - ε) X) + D S D) δ = A - R for δ by conjugate gradients in
/// single precision, where R are the row sums. Scales d by exp(δ), or by a share of δ if that is large, and returns the
/// share. Returns `None` if δ is not finite.
fn step(
    matrix: &Symmetric,
    areas: &[f64],
    scale: &mut [f64],
    (sums, escaping): (&[f64], &[f64]),
    deviation: f64,
    precision: f64,
) -> Option<f32> {
    const MOST: usize = 40;
    // Largest change of the logarithm of a scale.
    const MOST_STEP: f32 = 0.5;
    let n = areas.len();
    let patches = || (0..n).into_par_iter().with_min_len(SHORT);
    let rows: Vec<f32> = patches().map(|i| (sums[i] - (1.0 - YIELD) * escaping[i]) as f32).collect();
    // In units of the deviation the residual fits single precision.
    let mut residual: Vec<f32> = patches().map(|i| ((areas[i] - sums[i]) / deviation) as f32).collect();
    let mut step = vec![[0f32]; n];
    let inverse = |i: usize, residual: f32| if rows[i] > 0.0 { residual / rows[i] } else { 0.0 };
    let mut direction: Vec<f32> = patches().map(|i| inverse(i, residual[i])).collect();
    let (mut scaled, mut image) = (vec![[0f32]; n], vec![[0f32]; n]);
    let dot =
        |a: &[f32], b: &(dyn Fn(usize) -> f32 + Sync)| ordered_sum(n, |i| f64::from(a[i]) * f64::from(b(i)));
    let mut size = dot(&residual, &|i| direction[i]);
    // A step needs no more precision than Newton's method gains, single precision can hold, or `precision` requires.
    let enough = deviation.max(0.1 * precision / deviation).clamp(LEAST_STEP, 1e-1).powi(2) * size;
    for _ in 0..MOST {
        // Negated, so that NaN ends the loop too.
        if !(size > enough) {
            break;
        }
        let directions = scaled.par_iter_mut().zip(&mut image).zip(&direction).zip(&*scale);
        directions.with_min_len(SHORT).for_each(|(((scaled, image), direction), scale)| {
            (*scaled, *image) = ([direction * *scale as f32], [0.0]);
        });
        matrix.add_product(&scaled, &mut image);
        let images = image.par_iter_mut().zip(&direction).zip(&rows).zip(&*scale).with_min_len(SHORT);
        images.for_each(|((([image], direction), row), scale)| {
            *image = *image * *scale as f32 + row * direction;
        });
        let length = (size / dot(&direction, &|i| image[i][0])) as f32;
        let ends = step.par_iter_mut().zip(&mut residual).zip(&direction).zip(&image).with_min_len(SHORT);
        ends.for_each(|((([step], residual), direction), [image])| {
            *step += length * direction;
            *residual -= length * image;
        });
        let before = std::mem::replace(&mut size, dot(&residual, &|i| inverse(i, residual[i])));
        let growth = (size / before) as f32;
        let directions = direction.par_iter_mut().zip(&residual).enumerate().with_min_len(SHORT);
        directions.for_each(|(i, (direction, residual))| {
            *direction = inverse(i, *residual) + growth * *direction;
        });
    }
    step.par_iter_mut().with_min_len(SHORT).for_each(|[step]| *step *= deviation as f32);
    if !step.iter().all(|[step]| step.is_finite()) {
        return None;
    }
    let farthest = step.iter().fold(0f32, |most, [step]| most.max(step.abs()));
    let share = (MOST_STEP / farthest).min(1.0);
    let scales = scale.par_iter_mut().zip(&step).with_min_len(SHORT);
    scales.for_each(|(scale, [step])| *scale *= f64::from(share * *step).exp());
    Some(share)
}

/// Largest |row sum + escaped share - 1|.
pub(super) fn deviation(row_sums: impl Iterator<Item = f64>, escaped: &[f64]) -> f64 {
    row_sums.zip(escaped).map(|(sum, out)| (sum + out - 1.0).abs()).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows of the closed matrix, the escaped share last.
    fn closed(pairs: &[(u32, u32, f32)], areas: &[f64], escaped: &[f64]) -> Vec<Vec<f64>> {
        let n = areas.len();
        let mut matrix = Symmetric::from_lists(n, &[pairs.to_vec()]);
        let closed = close(&mut matrix, areas, escaped, EXACT);
        let form_factor =
            |i: usize, j: usize| closed.scale[i] * f64::from(matrix.get(i, j)) * closed.scale[j] / areas[i];
        let out = |i: usize| closed.escaping[i] / areas[i];
        (0..n).map(|i| (0..n).map(|j| form_factor(i, j)).chain([out(i)]).collect()).collect()
    }

    fn assert_near(found: &[Vec<f64>], wanted: &[&[f64]]) {
        for (found, wanted) in found.iter().zip(wanted) {
            for (x, y) in found.iter().zip(*wanted) {
                assert!((x - y).abs() < 1e-7, "{found:?} for {wanted:?}");
            }
        }
    }

    /// Three flat or convex surfaces that enclose a room exchange (A_i + A_j - A_k) / 2 for any estimates (Hottel's
    /// rule).
    #[test]
    fn three_surfaces_close_to_their_only_solution() {
        let found = closed(&[(0, 1, 1.0), (0, 2, 3.0), (1, 2, 2.0)], &[3.0, 4.0, 5.0], &[0.0; 3]);
        let wanted: [&[f64]; 3] =
            [&[0.0, 1.0 / 3.0, 2.0 / 3.0, 0.0], &[0.25, 0.0, 0.75, 0.0], &[0.4, 0.6, 0.0, 0.0]];
        assert_near(&found, &wanted);
    }

    /// Two equal patches exchange s = 0.5 and lose x = 0.4. So d² s = 0.6, except for the small change of the escaped
    /// share.
    #[test]
    fn what_escapes_stays_as_it_was_measured() {
        let [first, second]: [Vec<f64>; 2] = closed(&[(0, 1, 0.5)], &[1.0; 2], &[0.4; 2]).try_into().unwrap();
        let escapes = |d: f64| 0.4 * d.powf(YIELD);
        let d = (0..50).fold(1.0, |d, _| ((1.0 - escapes(d)) / 0.5f64).sqrt());
        assert!((first[2] - escapes(d)).abs() < 1e-12 && first[2] == second[2], "{first:?}, {d}");
        assert!((first[2] - 0.4).abs() < 0.004, "{first:?}");
        assert!((first[1] + first[2] - 1.0).abs() < 1e-12 && first[1] == second[0], "{first:?}");
    }

    /// Two objects see only each other, but their rays give different escaped shares: 0.44 and 0.36. The closure shares
    /// the difference between them, and the diagonal stays zero.
    #[test]
    fn objects_that_see_only_each_other_agree() {
        let pairs = [(0, 2, 0.3), (0, 3, 0.3), (1, 2, 0.3), (1, 3, 0.3)];
        let found = closed(&pairs, &[1.0; 4], &[0.44, 0.44, 0.36, 0.36]);
        for (i, row) in found.iter().enumerate() {
            assert!((row.iter().sum::<f64>() - 1.0).abs() < 1e-12 && row[i] == 0.0, "{found:?}");
            assert!((found[0][4] - row[4]).abs() < 1e-12, "{found:?}");
            assert!(row[4] > 0.36 && row[4] < 0.44, "{found:?}");
        }
    }

    /// A large and a small patch see only each other. No scaling closes both rows. The missing light of the larger one
    /// stays on the diagonal.
    #[test]
    fn what_no_scaling_closes_stays_where_it_is() {
        let found = closed(&[(0, 1, 1.2)], &[2.0, 1.0], &[0.0; 2]);
        for row in &found {
            assert!(
                (row.iter().sum::<f64>() - 1.0).abs() < 1e-12 && row.iter().all(|x| *x >= 0.0),
                "{found:?}"
            );
        }
        assert!(found[0][0] > 0.4 && (found[0][1] * 2.0 - found[1][0]).abs() < 1e-12, "{found:?}");
        // A patch whose rays only met itself keeps all light on the diagonal.
        assert_near(
            &closed(&[(1, 2, 1.0)], &[1.0; 3], &[0.0; 3]),
            &[&[1.0, 0.0, 0.0, 0.0], &[0.0, 0.0, 1.0, 0.0]],
        );
    }
}
