//! Closure: what leaves a patch arrives somewhere or escapes.
//!
//! Pooling makes the exchange areas S reciprocal, and thereby spoils the row sums that one-way hits have for free. A
//! positive diagonal D with  d_i (Σ_j S_ij d_j + X_i) = A_i  restores them, where X_i = A_i e_i is the exchange area with
//! the outside, one more column that closes with the rest. The scaling keeps symmetry, zeros and positivity.

use super::symmetric::Symmetric;

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

/// Finds the scaling by the fixed point d ← sqrt(d A / (S d + X)), which converges to rounding in 30 to 60 products
/// for scenes that are not nearly bipartite.
///
/// Patches that see hardly more than each other may have been told by few rays that all of what one sends arrives at the
/// other, whose area is too small for it. No scaling closes them; `spare`, a share that may have escaped unseen, does.
pub(super) fn close(
    matrix: &Symmetric,
    areas: &[f64],
    escaped: &[f64],
    spare: impl Fn(usize) -> f64,
) -> Closed {
    let mut escaped = escaped.to_vec();
    let mut scale = vec![1.0; areas.len()];
    let mut deviation_before = None;
    let (mut best, mut stalled) = (f64::INFINITY, 0);
    for round in 1..=MOST_ROUNDS {
        let mut arriving: Vec<f64> = areas.iter().zip(&escaped).map(|(area, e)| area * e).collect();
        matrix.add_product(scale.as_chunks::<1>().0, arriving.as_chunks_mut::<1>().0);
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
pub(super) fn deviation(row_sums: impl Iterator<Item = f64>, escaped: &[f64]) -> f64 {
    row_sums.zip(escaped).map(|(sum, out)| (sum + out - 1.0).abs()).fold(0.0, f64::max)
}
