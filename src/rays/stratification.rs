//! Estimates the variance of stratified samples from differences between parts of their sequence.
//!
//! The parts of a Sobol sequence complement each other. Differences between parts show how well: let D_b be the mean
//! square of half the difference of two neighbouring runs of b parts. If the variance of a run is v b^-α (α = 1 for
//! independent parts), then D_b = v b^-α (1 - 2^-α). A line through ln D_b for b = 1, 2, 4, … gives α and v, and the
//! variance of all parts. The estimate needs the data of many patches.
//!
//! The integrand over a net of rays has a smooth part and a part with edges, whose variances fall with different
//! powers: D_1 may be six times D_2, but D_4 only twice D_8. The same differences determine both parts.

use std::f64::consts::LN_2;

use nalgebra::{Matrix2, Vector2};

/// Returns D_1, D_2, D_4, …, and 0 where no longer run exists. Overwrites `parts` with means of ever longer runs.
pub(crate) fn half_differences<const LEVELS: usize>(parts: &mut [f64]) -> [f64; LEVELS] {
    let mut pairs = parts.len();
    std::array::from_fn(|_| {
        pairs /= 2;
        let mut sum = 0.0;
        for k in 0..pairs {
            let (p, q) = (parts[2 * k], parts[2 * k + 1]);
            sum += (0.5 * (p - q)).powi(2);
            parts[k] = 0.5 * (p + q);
        }
        sum / pairs.max(1) as f64
    })
}

/// The variance of the mean of `parts`, from D_1, D_2, D_4, …. Each D_b is weighted by its number of differences. α
/// stays within `rates`.
pub(crate) fn variance_of_all(half_differences: &[f64], parts: usize, rates: (f64, f64)) -> f64 {
    let points =
        || half_differences.iter().enumerate().map(|(k, d)| (k as f64 * LN_2, d.ln(), 0.5f64.powi(k as i32)));
    let weight: f64 = points().map(|(_, _, w)| w).sum();
    let (x, y) = points().fold((0.0, 0.0), |(x, y), (l, d, w)| (x + w * l / weight, y + w * d / weight));
    let slope = points().map(|(l, d, w)| w * (l - x) * (d - y)).sum::<f64>()
        / points().map(|(l, _, w)| w * (l - x).powi(2)).sum::<f64>();
    let rate = (-slope).clamp(rates.0, rates.1);
    (y - rate * ((parts as f64).ln() - x)).exp() / (1.0 - 0.5f64.powf(rate))
}

/// The variance of the mean of `parts`, if the variance of a run of b parts is v b^-p + w b^-q with `powers` p and q. A
/// fit by least squares of the relative errors of D_b gives v and w, neither negative. The weights are those of
/// [`variance_of_all`].
pub(crate) fn variance_of_nets(half_differences: &[f64], parts: usize, powers: [f64; 2]) -> f64 {
    // The first fit is relative to the measured values, which favours values that are small by chance.
    const FITS: usize = 3;
    let mut fitted = half_differences.to_vec();
    let mut shares = [0.0; 2];
    for _ in 0..FITS {
        let (mut squares, mut values) = (Matrix2::zeros(), Vector2::zeros());
        for (k, (&d, fitted)) in (0..).zip(half_differences.iter().zip(&fitted)) {
            let row = Vector2::from(powers.map(|p| half_difference(p, k) / fitted));
            let weight = 0.5f64.powi(k);
            squares += weight * row * row.transpose();
            values += weight * d / fitted * row;
        }
        let both = squares.try_inverse().map_or(Vector2::repeat(-1.0), |inverse| inverse * values);
        shares = match (both[0] > 0.0, both[1] > 0.0) {
            (true, true) => [both[0], both[1]],
            (false, true) => [0.0, values[1] / squares[(1, 1)]],
            _ => [values[0] / squares[(0, 0)], 0.0],
        };
        for (k, fitted) in (0..).zip(&mut fitted) {
            *fitted = (0..2).map(|m| shares[m] * half_difference(powers[m], k)).sum();
        }
    }
    (0..2).map(|m| shares[m] * (parts as f64).powf(-powers[m])).sum()
}

/// D_b for b = 2^k parts, if the variance of a run is b^-p.
fn half_difference(p: f64, k: i32) -> f64 {
    2f64.powf(-p * f64::from(k)) * (1.0 - 2f64.powf(-p))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_differ_by_half_of_what_they_are_apart() {
        // Half differences 1, 2, 0 and 3. The means 2, 3, 5 and 8 then give 0.5 and 1.5, and 2.5 and 6.5 give 2. The
        // last part is alone.
        let found = half_differences::<4>(&mut [1.0, 3.0, 1.0, 5.0, 5.0, 5.0, 5.0, 11.0, 100.0]);
        assert_eq!(found, [14.0 / 4.0, 2.5 / 2.0, 4.0, 0.0]);
    }

    /// If the variance of a run of b parts is 3 b^-α, that of all 16 parts is 3 · 16^-α.
    #[test]
    fn a_power_of_the_length_is_found() {
        for rate in [1.0, 1.7, 3.0] {
            let found =
                variance_of_all(&[0, 1, 2, 3].map(|k| 3.0 * half_difference(rate, k)), 16, (1.0, 3.0));
            assert!((found / (3.0 * 16f64.powf(-rate)) - 1.0).abs() < 1e-12, "{rate}: {found}");
        }
    }

    /// Separates two powers, one alone or both. A power steeper than both counts as the steeper one.
    #[test]
    fn two_powers_are_taken_apart() {
        let powers = [1.25, 3.0];
        for shares in [[2.0, 5.0], [2.0, 0.0], [0.0, 5.0], [0.01, 50.0]] {
            let sum = |k: i32| (0..2).map(|m| shares[m] * half_difference(powers[m], k)).sum();
            let found = variance_of_nets(&[0, 1, 2, 3].map(sum), 16, powers);
            let wanted: f64 = (0..2).map(|m| shares[m] * 16f64.powf(-powers[m])).sum();
            assert!((found / wanted - 1.0).abs() < 1e-9, "{shares:?}: {found}");
        }
        let steep = variance_of_nets(&[0, 1, 2, 3].map(|k| half_difference(4.0, k)), 16, powers);
        assert!(steep > 16f64.powi(-4) && steep < 16f64.powi(-2), "{steep}");
    }
}
