//! How much better the parts of a sequence of rays are together than by themselves.
//!
//! The parts of a Sobol sequence complement each other, and how well they tell themselves: let D_b be the mean square of half
//! the difference of two neighbouring runs of b parts. If the variance of a run is v b^-α (α = 1 when parts are independent),
//! then D_b = v b^-α (1 - 2^-α); a line through ln D_b for b = 1, 2, 4, … gives α and v, and the variance of all. One patch
//! could not tell, many together can.

use std::f64::consts::LN_2;

/// The variance of the mean of `parts`, from D_1, D_2, D_4, …, each with as much weight as it has differences; α stays between
/// `rates`.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Where the variance of a run of b parts is 3 b^-α, that of all 16 is 3 · 16^-α.
    #[test]
    fn a_power_of_the_length_is_found() {
        for rate in [1.0, 1.7, 3.0] {
            let difference = |k: i32| 3.0 * 2f64.powf(-rate * f64::from(k)) * (1.0 - 2f64.powf(-rate));
            let found = variance_of_all(&[0, 1, 2, 3].map(difference), 16, (1.0, 3.0));
            assert!((found / (3.0 * 16f64.powf(-rate)) - 1.0).abs() < 1e-12, "{rate}: {found}");
        }
    }
}
