//! Light that varies linearly over a triangle, as its mean and two slopes.
//!
//! With barycentric coordinates b, the basis functions are φ₁ = b₀ - b₁ and φ₂ = b₀ + b₁ - 2 b₂. They are orthogonal,
//! their means over the triangle are zero, and their mean squares are [`SQUARES`]. So the least squares fit to any
//! light E has the coefficients mean(φ E) / mean(φ²), and slopes do not change the mean. This is an orthogonal P1 basis
//! (Heckbert and Winget, "Finite Element Methods for Global Illumination", 1991).

/// Mean squares of the basis functions.
pub(crate) const SQUARES: [f64; 2] = [1.0 / 6.0, 0.5];

/// The coefficients of the two basis functions, for each channel.
pub(crate) type Slopes<const C: usize> = [[f64; 2]; C];

/// Estimated slopes with their sampling noise.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Measured<const C: usize> {
    pub(crate) slopes: Slopes<C>,
    /// The expected increase of the [`spread`] of the slopes by sampling noise.
    pub(crate) noise: f64,
}

impl<const C: usize> Measured<C> {
    pub(crate) const NONE: Self = Measured { slopes: [[0.0; 2]; C], noise: 0.0 };

    /// The sum of two estimates from different rays.
    pub(crate) fn plus(&self, other: &Self) -> Self {
        let sum = |c: usize| std::array::from_fn(|m| self.slopes[c][m] + other.slopes[c][m]);
        Measured { slopes: std::array::from_fn(sum), noise: self.noise + other.noise }
    }
}

/// The basis functions at a point.
#[inline]
pub(crate) fn basis(barycentric: [f64; 3]) -> [f64; 2] {
    let [a, b, c] = barycentric;
    [a - b, a + b - 2.0 * c]
}

/// The basis functions at the corners.
pub(crate) const CORNERS: [[f64; 2]; 3] = [[1.0, 1.0], [-1.0, 1.0], [0.0, -2.0]];

/// The difference of the light from its mean, at a point where the basis functions have these values.
#[inline]
pub(crate) fn rise(slopes: &[f64; 2], basis: [f64; 2]) -> f64 {
    slopes[0] * basis[0] + slopes[1] * basis[1]
}

/// The variance over the triangle of light with these slopes, summed over the channels.
pub(crate) fn spread<const C: usize>(slopes: &Slopes<C>) -> f64 {
    slopes.iter().map(|s| SQUARES[0] * s[0] * s[0] + SQUARES[1] * s[1] * s[1]).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Means and mean products of the basis functions over a regular lattice of points in a triangle are as stated
    /// above.
    #[test]
    fn the_basis_is_orthogonal() {
        const N: usize = 400;
        let (mut count, mut sums, mut products) = (0.0, [0.0; 2], [0.0; 3]);
        for i in 0..N {
            for j in 0..N - i {
                let x = |k: usize| (k as f64 + 1.0 / 3.0) / N as f64;
                let [p, q] = basis([x(i), x(j), 1.0 - x(i) - x(j)]);
                count += 1.0;
                sums = [sums[0] + p, sums[1] + q];
                products = [products[0] + p * p, products[1] + q * q, products[2] + p * q];
            }
        }
        // Each cell of the lattice is a parallelogram, except cells along one edge. Their share bounds the error.
        let tolerance = 4.0 / N as f64;
        assert!(
            sums.iter().all(|s| (s / count).abs() < tolerance) && (products[2] / count).abs() < tolerance
        );
        assert!((0..2).all(|m| (products[m] / count - SQUARES[m]).abs() < tolerance), "{products:?}");
        for (k, corner) in CORNERS.iter().enumerate() {
            assert_eq!(*corner, basis(std::array::from_fn(|other| f64::from(u8::from(other == k)))));
        }
    }
}
