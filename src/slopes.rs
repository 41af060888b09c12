//! Light that varies over a triangle, as its mean, two slopes and three curvatures.
//!
//! With barycentric coordinates b, the linear basis functions are φ₁ = b₀ - b₁ and φ₂ = b₀ + b₁ - 2 b₂. They are
//! orthogonal, their means over the triangle are zero, and their mean squares are [`SQUARES`]. So the least squares fit
//! to any light E has the coefficients mean(φ E) / mean(φ²), and slopes do not change the mean. This is an orthogonal P1
//! basis (Heckbert and Winget, "Finite Element Methods for Global Illumination", 1991). The [modes] continue it with
//! the quadratic polynomials of Dubiner, "Spectral Methods on Triangles", Journal of Scientific Computing 6, 1991. They
//! are orthogonal to each other and to the slopes.

use std::sync::LazyLock;

use nalgebra::{SMatrix, SVector};

/// Number of basis functions up to the second degree, without the constant.
pub(crate) const MODES: usize = 5;

/// Mean squares of the basis functions.
pub(crate) const SQUARES: [f64; MODES] = [1.0 / 6.0, 0.5, 1.0 / 15.0, 1.0 / 9.0, 1.0 / 3.0];

/// The coefficients of the two linear basis functions, for each channel.
pub(crate) type Slopes<const C: usize> = [[f64; 2]; C];

/// The coefficients of all basis functions, for each channel.
pub(crate) type Shape<const C: usize> = [[f64; MODES]; C];

/// Estimated shape of the light with its sampling noise.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Measured<const C: usize> {
    /// Estimates from the first and from the second half of the rays, which are independent.
    pub(crate) halves: [Shape<C>; 2],
    /// The expected increase of the [`spread`] of the slopes of all rays by sampling noise.
    pub(crate) noise: f64,
}

impl<const C: usize> Measured<C> {
    pub(crate) const NONE: Self = Measured { halves: [[[0.0; MODES]; C]; 2], noise: 0.0 };

    /// The sum of two estimates from different rays.
    pub(crate) fn plus(&self, other: &Self) -> Self {
        let mut sum = *self;
        let values = sum.halves.as_flattened_mut().as_flattened_mut().iter_mut();
        values.zip(other.halves.as_flattened().as_flattened()).for_each(|(sum, other)| *sum += other);
        sum.noise += other.noise;
        sum
    }

    /// The slopes by all rays.
    pub(crate) fn slopes(&self) -> Slopes<C> {
        let [first, second] = &self.halves;
        std::array::from_fn(|c| [0, 1].map(|m| 0.5 * (first[c][m] + second[c][m])))
    }
}

/// The linear basis functions at a point.
#[inline]
pub(crate) fn basis(barycentric: [f64; 3]) -> [f64; 2] {
    let [a, b, c] = barycentric;
    [a - b, a + b - 2.0 * c]
}

/// All basis functions at a point.
#[inline]
pub(crate) fn modes(barycentric: [f64; 3]) -> [f64; MODES] {
    let [a, b, c] = barycentric;
    let ([x, y], s) = (basis(barycentric), a + b);
    [x, y, 1.5 * x * x - 0.5 * s * s, x * (5.0 * c - 1.0), (10.0 * c - 8.0) * c + 1.0]
}

/// Number of cells of equal area of a triangle: two levels of quarters.
pub(crate) const CELLS: usize = 16;

/// The cell of a point.
#[inline]
pub(crate) fn cell(barycentric: [f64; 3]) -> usize {
    let place = |x: f64| {
        let x = 4.0 * x.clamp(0.0, 1.0);
        (x.min(3.0).floor(), x)
    };
    let ((i, x), (j, y)) = (place(barycentric[0]), place(barycentric[1]));
    let (strip, along) = (i as usize, (j as usize).min(3 - i as usize));
    let turned = x - i + y - j > 1.0 && along < 3 - strip;
    // The strips have 7, 5, 3 and 1 cells.
    strip * (8 - strip) + 2 * along + usize::from(turned)
}

/// The middles of all cells, in their order.
pub(crate) fn middles() -> [[f64; 3]; CELLS] {
    let mut middles = [[0.0; 3]; CELLS];
    for i in 0..4 {
        for j in 0..4 - i {
            for turned in 0..=usize::from(i + j < 3) {
                let [x, y] = [i, j].map(|k| (k as f64 + (1.0 + turned as f64) / 3.0) / 4.0);
                middles[i * (8 - i) + 2 * j + turned] = [x, y, 1.0 - x - y];
            }
        }
    }
    middles
}

/// Removes the mean and all modes from the means of some light over the cells, by least squares.
pub(crate) fn beyond_modes(means: &[f64; CELLS]) -> [f64; CELLS] {
    static RESIDUAL: LazyLock<SMatrix<f64, CELLS, CELLS>> = LazyLock::new(|| {
        let modes = middles().map(modes);
        let basis = SMatrix::<f64, CELLS, { MODES + 1 }>::from_fn(|k, m| {
            m.checked_sub(1).map_or(1.0, |m| modes[k][m])
        });
        let inverse = (basis.transpose() * basis).try_inverse().unwrap_or_else(SMatrix::zeros);
        SMatrix::identity() - basis * inverse * basis.transpose()
    });
    (*RESIDUAL * SVector::from(*means)).into()
}

/// The linear basis functions at the corners.
pub(crate) const CORNERS: [[f64; 2]; 3] = [[1.0, 1.0], [-1.0, 1.0], [0.0, -2.0]];

/// The difference of linear light from its mean, at a point where the basis functions have these values.
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
        let (mut count, mut sums, mut products) = (0.0, [0.0; MODES], [[0.0; MODES]; MODES]);
        for i in 0..N {
            for j in 0..N - i {
                let x = |k: usize| (k as f64 + 1.0 / 3.0) / N as f64;
                let values = modes([x(i), x(j), 1.0 - x(i) - x(j)]);
                count += 1.0;
                for m in 0..MODES {
                    sums[m] += values[m];
                    (0..MODES).for_each(|n| products[m][n] += values[m] * values[n]);
                }
            }
        }
        // Each cell of the lattice is a parallelogram, except cells along one edge. Their share bounds the error.
        let tolerance = 4.0 / N as f64;
        for m in 0..MODES {
            assert!((sums[m] / count).abs() < tolerance, "{m}: {}", sums[m] / count);
            for n in 0..MODES {
                let wanted = if m == n { SQUARES[m] } else { 0.0 };
                assert!((products[m][n] / count - wanted).abs() < tolerance, "{m} {n}: {products:?}");
            }
        }
        for (k, middle) in middles().into_iter().enumerate() {
            assert_eq!(cell(middle), k);
        }
        // Light of the second degree leaves nothing.
        let left = beyond_modes(&middles().map(|[a, b, c]| 1.0 + a - 3.0 * a * b + c * c));
        assert!(left.iter().all(|x| x.abs() < 1e-12), "{left:?}");
        for (k, corner) in CORNERS.iter().enumerate() {
            assert_eq!(*corner, basis(std::array::from_fn(|other| f64::from(u8::from(other == k)))));
        }
    }
}
