//! Entries of the matrix of exchange areas, with their errors.

use super::{
    estimate::{Estimate, REPLICATES, student},
    polygon::FORMULA,
};

/// The estimated exchange of two surfaces, in unit space.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Cell {
    /// A_i F_ij.
    pub(super) exchange: f64,
    /// The surface with the larger index.
    pub(super) column: u32,
    /// The standard error from the spread of rays, without the factor for the few degrees of freedom that it has.
    pub(super) spread: f32,
    /// The fourth root of the sum of v², where v are the variances of those of its pairs that have
    /// [`REPLICATES`] replicates each.
    pub(super) quartic: f32,
    /// The largest standard error that may be missing because samples are skew or agree by chance.
    pub(super) doubt: f32,
}

impl Cell {
    pub(super) fn of(estimate: &Estimate) -> Cell {
        let Estimate { exchange, variance, doubt, matters, .. } = *estimate;
        let spread = variance.sqrt() as f32;
        let quartic = if matters { spread } else { 0.0 };
        Cell { exchange, column: 0, spread, quartic, doubt: doubt as f32 }
    }

    /// The standard error, from rays and from the formula.
    pub(super) fn error(&self) -> f64 {
        let doubt = f64::from(self.doubt);
        let formula = FORMULA * self.exchange;
        (Spread::of(self).variance() + doubt * doubt + formula * formula).sqrt()
    }

    /// Adds the exchange of other pairs of polygons. The sum of independent errors of equal skewness is no farther off
    /// by it than one of them, so the largest doubt counts.
    pub(super) fn merge(&mut self, other: &Cell) {
        self.exchange += other.exchange;
        let sum = Spread::of(self).and(Spread::of(other));
        self.spread = sum.variance.sqrt() as f32;
        self.quartic = sum.quartic.sqrt().sqrt() as f32;
        self.doubt = self.doubt.max(other.doubt);
    }
}

/// The variance of a sum of independent pairs, each estimated by sixteen replicates.
#[derive(Clone, Copy, Default)]
pub(super) struct Spread {
    pub(super) variance: f64,
    /// The sum of the squares of the variances.
    pub(super) quartic: f64,
}

impl Spread {
    pub(super) fn of(cell: &Cell) -> Spread {
        Spread { variance: f64::from(cell.spread).powi(2), quartic: f64::from(cell.quartic).powi(4) }
    }

    pub(super) fn and(self, other: Spread) -> Spread {
        Spread { variance: self.variance + other.variance, quartic: self.quartic + other.quartic }
    }

    /// The variance by which 1.96 standard errors are an interval of 95 %. The degrees of freedom of a sum are those of B. L. Welch
    /// ("The Generalization of 'Student's' Problem", Biometrika 34, 1947).
    pub(super) fn variance(&self) -> f64 {
        if self.quartic > 0.0 {
            let freedom = f64::from(REPLICATES - 1) * self.variance * self.variance / self.quartic;
            self.variance * student(freedom).powi(2)
        } else {
            self.variance
        }
    }
}
