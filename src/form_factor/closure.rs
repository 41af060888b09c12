//! Closure: what leaves a patch arrives somewhere or escapes.
//!
//! Pooling makes the exchange areas S reciprocal, and thereby spoils the row sums that one-way hits have for free. A
//! positive diagonal D with  d_i (Σ_j S_ij d_j + X_i) = A_i  restores them, where X_i = A_i e_i is the exchange area with
//! the outside, one more column that closes with the rest. The scaling keeps symmetry, zeros and positivity.

use rayon::prelude::*;

use super::{Matrix, gather, row};

/// The scaling and what it repaired.
pub(super) struct Closed {
    pub(super) scale: Vec<f64>,
    pub(super) deviation_before: f64,
}

/// Rounds after which a matrix that cannot be closed is given up; what remains is reported.
const MOST_ROUNDS: usize = 500;

/// Finds the scaling by the fixed point d ← sqrt(d A / (S d + X)), which converges to rounding in 30 to 60 products
/// for scenes that are not nearly bipartite.
pub(super) fn close(matrix: &Matrix, areas: &[f64], escaped: &[f64]) -> Closed {
    let mut scale = vec![1.0; areas.len()];
    let mut arriving = vec![0.0; areas.len()];
    let mut deviation_before = None;
    let (mut best, mut stalled) = (f64::INFINITY, 0);
    for _ in 0..MOST_ROUNDS {
        gather(matrix, scale.as_chunks::<1>().0, &mut arriving, |i, [sum]| [sum + areas[i] * escaped[i]]);
        let deviation =
            (0..areas.len()).map(|i| (scale[i] * arriving[i] / areas[i] - 1.0).abs()).fold(0.0, f64::max);
        deviation_before.get_or_insert(deviation);
        // What is left in the end is the rounding of the longest row sums.
        stalled = if deviation < 0.5 * best { 0 } else { stalled + 1 };
        best = best.min(deviation);
        if deviation < 1e-15 || (deviation < 1e-13 && stalled >= 3) {
            break;
        }
        for i in 0..scale.len() {
            scale[i] = (scale[i] * areas[i] / arriving[i]).sqrt();
        }
    }
    Closed { scale, deviation_before: deviation_before.unwrap_or(0.0) }
}

/// How far a link with a source yields where the other entries of a row yield by a factor: as the power of it.
///
/// Shadow rays make links far more precise than the rest of a row, and they should not pay for its noise. Measured on
/// a Cornell box of 960 patches at 64 rays, RMS error of irradiance: 13.2 % when all entries yield alike (1), 9.6 % at
/// 0.25, 9.2 % at 0.1, 9.1 % at 0.03. Not zero, so that a row which sees hardly anything but a lamp can close.
const YIELD: f64 = 0.1;

/// Rounds of [`spread`], which need not be exact.
const SPREAD_ROUNDS: usize = 60;
/// Largest |ln d| of [`spread`].
const MOST_LOG: f64 = 3.0;

/// What brought the rows near their sums.
#[derive(Debug, Clone)]
pub(super) struct Spread {
    /// Factor of row and column `i` in entries between patches that are no sources.
    pub(super) plain: Vec<f64>,
    /// Factor of row and column `i` in links.
    pub(super) link: Vec<f64>,
}

impl Spread {
    /// Nothing is scaled.
    pub(super) fn none(n: usize) -> Spread {
        Spread { plain: vec![1.0; n], link: vec![1.0; n] }
    }

    fn new(plain: Vec<f64>, is_source: &[bool]) -> Spread {
        let link = plain.iter().zip(is_source).map(|(&d, &s)| if s { d } else { d.powf(YIELD) }).collect();
        Spread { plain, link }
    }

    /// The share of patch `i`'s factor that a small change of it passes on to its links.
    pub(super) fn link_yield(is_source: bool) -> f64 {
        if is_source { 1.0 } else { YIELD }
    }
}

/// Brings the rows to within 10⁻⁴ of their sums, before [`close`] makes them exact, with corrections about in proportion
/// to the variance of the entries: pairs without a source are multiplied by d_i d_j, the link of patch i with source l
/// by d_i^YIELD d_l.
///
/// What escapes stays as it is: only a patch's own rays measure it, so that it would yield to its own noise twice as much
/// as pooled entries do, and too little light would leave the scene (measured: 1 % more light in a Cornell box of 16,000
/// patches at 64 rays).
pub(super) fn spread(matrix: &mut Matrix, areas: &[f64], escaped: &[f64], is_source: &[bool]) -> Spread {
    let n = areas.len();
    let mut spread = Spread::none(n);
    for _ in 0..SPREAD_ROUNDS {
        let rows: Vec<(f64, f64)> = (0..n)
            .into_par_iter()
            .with_min_len(128)
            .map(|i| rescale_row(matrix, areas, escaped, is_source, &spread, i))
            .collect();
        if rows.iter().all(|(_, deviation)| deviation.abs() < 1e-4) {
            break;
        }
        spread = Spread::new(rows.into_iter().map(|(d, _)| d).collect(), is_source);
    }
    let starts = matrix.indptr().raw_storage().to_vec();
    let columns = matrix.indices().to_vec();
    let values = matrix.data_mut();
    for i in 0..n {
        for k in starts[i]..starts[i + 1] {
            let j = columns[k] as usize;
            let factors = if is_source[i] || is_source[j] { &spread.link } else { &spread.plain };
            values[k] = (f64::from(values[k]) * (factors[i] * factors[j])) as f32;
        }
    }
    spread
}

/// The next scale of row `i`, and by how much its sum deviates with the present one.
fn rescale_row(
    matrix: &Matrix,
    areas: &[f64],
    escaped: &[f64],
    is_source: &[bool],
    spread: &Spread,
    i: usize,
) -> (f64, f64) {
    let (columns, values) = row(matrix, i);
    if columns.is_empty() {
        return (1.0, 0.0);
    }
    let (mut plain, mut links) = (0.0, 0.0);
    for (&j, &s) in columns.iter().zip(values) {
        let j = j as usize;
        if is_source[i] || is_source[j] {
            links += f64::from(s) * spread.link[j];
        } else {
            plain += f64::from(s) * spread.plain[j];
        }
    }
    let power = Spread::link_yield(is_source[i]);
    let target = areas[i] * (1.0 - escaped[i]);
    // The d with d plain + d^power links = target, by Newton's method in ln d.
    let now = spread.plain[i].ln();
    let mut x = now;
    for _ in 0..8 {
        let (p, l) = (x.exp() * plain, (power * x).exp() * links);
        x = (x - (p + l - target) / (p + power * l)).clamp(-8.0, 8.0);
    }
    let sum = now.exp() * plain + (power * now).exp() * links;
    // Half the way, as in `close`: each pair is corrected from both its ends.
    // Where patches see hardly more than each other, targets from few rays may contradict: `close`, in which what escapes
    // yields too, settles what is left beyond this bound.
    ((0.5 * (x + now)).clamp(-MOST_LOG, MOST_LOG).exp(), (sum - target) / areas[i])
}

/// Largest |row sum + escaped share - 1|.
pub(super) fn deviation(row_sums: &[f64], escaped: &[f64]) -> f64 {
    row_sums.iter().zip(escaped).map(|(sum, out)| (sum + out - 1.0).abs()).fold(0.0, f64::max)
}

/// Largest |row sum + escaped share - 1| of the exchange areas as they are.
pub(super) fn row_sum_deviation(matrix: &Matrix, areas: &[f64], escaped: &[f64]) -> f64 {
    let mut sums = vec![0.0; areas.len()];
    gather(matrix, &vec![[1.0]; areas.len()], &mut sums, |i, [sum]| [sum / areas[i]]);
    deviation(&sums, escaped)
}
