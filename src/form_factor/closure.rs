//! Closure: what leaves a patch arrives somewhere or escapes.
//!
//! Pooling makes the exchange areas S reciprocal, and thereby spoils the row sums that one-way hits have for free. A
//! positive diagonal D with  d_i (Σ_j S_ij d_j + X_i) = A_i  restores them, where X_i = A_i e_i is the exchange area with
//! the outside, one more column that closes with the rest. The scaling keeps symmetry, zeros and positivity.
//!
//! It would move links with sources as well, which are known much better than the rest. So what is missing in a row is first
//! taken from what is uncertain: from what only hemisphere rays measured, and from what escapes ([`settle`]). RMS errors
//! at 64 rays a patch without and with that: 4.3 and 4.1 % on the Cornell box, 3.6 and 3.4 % on another one, 1.7 and 1.3 %
//! on a block in the open, whose floor and block, which exchange light with each other alone, contradict each other.

use rayon::prelude::*;

use super::{Matrix, gather, hemisphere::Hits, row};

/// The scaling and what it repaired.
pub(super) struct Closed {
    pub(super) scale: Vec<f64>,
    /// The shares that escape, more than given where rows contradicted each other.
    pub(super) escaped: Vec<f64>,
    pub(super) deviation_before: f64,
}

/// Rounds after which a matrix that cannot be closed is given up; what remains is reported.
const MOST_ROUNDS: usize = 500;

/// Rounds after which rows that are still off by more than [`CONTRADICTION`] yield.
const PATIENCE: usize = 100;
const CONTRADICTION: f64 = 1e-3;

/// Rounds of [`settle`],
const SETTLING_ROUNDS: usize = 20;
/// and what rows may be off by after it, relative to their area.
const SETTLED: f64 = 1e-4;
/// Share of what a row misses that its escaped light takes, in a round. With none of it the mean irradiance of rooms is too
/// large, with all too small, by some 0.2 % at 64 rays a patch.
const ESCAPING: f64 = 0.3;
/// The least and greatest factor of an entry's row.
const FACTORS: (f64, f64) = (0.1, 10.0);

/// Brings rows nearer to their sums by a positive diagonal that scales only what no source takes part in, and by what
/// escapes. Rows that this cannot bring there are left to [`close`].
pub(super) fn settle(matrix: &mut Matrix, hits: &Hits, areas: &[f64], escaped: &mut [f64]) {
    let is_link = |i: usize, j: u32| hits.sources.concern(i, j as usize);
    let mut scale = vec![1.0; areas.len()];
    for _ in 0..SETTLING_ROUNDS {
        let next = |i: usize| -> (f64, f64, f64) {
            let (columns, values) = row(matrix, i);
            let (mut links, mut plain) = (0.0, 0.0);
            for (&j, &s) in columns.iter().zip(values) {
                let s = f64::from(s);
                if is_link(i, j) { links += s } else { plain += s * scale[j as usize] }
            }
            let off = 1.0 - (links + plain * scale[i]) / areas[i] - escaped[i];
            let escapes = (escaped[i] + ESCAPING * off).max(0.5 * escaped[i]);
            let escapes = if escaped[i] > 0.0 { escapes } else { 0.0 };
            let wanted = areas[i] * (1.0 - escapes) - links;
            if plain <= 0.0 || wanted <= 0.0 {
                return (scale[i], escaped[i], 0.0);
            }
            ((scale[i] * wanted / plain).sqrt().clamp(FACTORS.0, FACTORS.1), escapes, off.abs())
        };
        let rows: Vec<_> = (0..areas.len()).into_par_iter().with_min_len(128).map(next).collect();
        let worst = rows.iter().map(|&(_, _, off)| off).fold(0.0, f64::max);
        for (i, (row_scale, escapes, _)) in rows.into_iter().enumerate() {
            (scale[i], escaped[i]) = (row_scale, escapes);
        }
        if worst < SETTLED {
            break;
        }
    }
    let scale = &scale;
    let factors: Vec<f32> = (0..areas.len())
        .into_par_iter()
        .with_min_len(128)
        .flat_map_iter(|i| {
            let factor = move |&j: &u32| {
                // The product of two, so that the matrix stays symmetric to the bit.
                if is_link(i, j) { 1.0 } else { (scale[i] * scale[j as usize]) as f32 }
            };
            row(matrix, i).0.iter().map(factor)
        })
        .collect();
    matrix.data_mut().iter_mut().zip(factors).for_each(|(value, factor)| *value *= factor);
}

/// Finds the scaling by the fixed point d ← sqrt(d A / (S d + X)), which converges to rounding in 30 to 60 products
/// for scenes that are not nearly bipartite.
///
/// Patches that see hardly more than each other may have been told by few rays that all of what one sends arrives at the
/// other, whose area is too small for it. No scaling closes them; `spare`, a share that may have escaped unseen, does.
pub(super) fn close(matrix: &Matrix, areas: &[f64], escaped: &[f64], spare: impl Fn(usize) -> f64) -> Closed {
    let mut escaped = escaped.to_vec();
    let mut scale = vec![1.0; areas.len()];
    let mut arriving = vec![0.0; areas.len()];
    let mut deviation_before = None;
    let (mut best, mut stalled) = (f64::INFINITY, 0);
    for round in 1..=MOST_ROUNDS {
        gather(matrix, scale.as_chunks::<1>().0, &mut arriving, |i, [sum]| [sum + areas[i] * escaped[i]]);
        let off = |i: usize| (scale[i] * arriving[i] / areas[i] - 1.0).abs();
        let deviation = (0..areas.len()).map(off).fold(0.0, f64::max);
        deviation_before.get_or_insert(deviation);
        // What is left in the end is the rounding of the longest row sums.
        stalled = if deviation < 0.5 * best { 0 } else { stalled + 1 };
        best = best.min(deviation);
        if deviation < 1e-15 || (deviation < 1e-13 && stalled >= 3) {
            break;
        }
        if round % PATIENCE == 0 && deviation > CONTRADICTION {
            for i in (0..scale.len()).filter(|&i| off(i) > CONTRADICTION) {
                escaped[i] = (escaped[i] + spare(i)).min(1.0);
            }
            scale.fill(1.0);
            continue;
        }
        for i in 0..scale.len() {
            scale[i] = (scale[i] * areas[i] / arriving[i]).sqrt();
        }
    }
    Closed { scale, escaped, deviation_before: deviation_before.unwrap_or(0.0) }
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
