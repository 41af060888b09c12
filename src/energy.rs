//! The energy ledger: what is emitted is absorbed or escapes.
//!
//! With irradiance E = F B and residual r = Be + ρ E - B, exactly
//!
//!   emitted - absorbed - escaped = Σ_i A_i r_i + Σ_j B_j Σ_i (A_j F_ji - A_i F_ij)
//!
//! The first part is the solver's, the second the defect of reciprocity. An energy balance proves no more than that: a
//! wrong but symmetric matrix balances perfectly. Whether the answer is right, error bars and an independent estimator
//! must say.

use crate::{
    form_factor::FormFactors,
    solve::{Radiometry, Solution},
};

/// Powers in watts (if lengths are metres), a value a channel.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct EnergyLedger {
    /// Σ A Be.
    pub emitted: Vec<f64>,
    /// Σ A (1 - ρ) E.
    pub absorbed: Vec<f64>,
    /// Σ A B times the share of form factor that leaves the scene.
    pub escaped: Vec<f64>,
    /// Σ A r.
    pub solver_part: Vec<f64>,
    /// Σ_j B_j Σ_i (A_j F_ji - A_i F_ij).
    pub reciprocity_part: Vec<f64>,
    /// Σ A B: what leaves the patches, again with every bounce.
    pub leaving: Vec<f64>,
}

impl EnergyLedger {
    /// Adds up a solution.
    ///
    /// # Panics
    /// When the sizes disagree.
    pub fn of<'a>(
        form_factors: &FormFactors,
        radiometry: impl Into<Radiometry<'a>>,
        solution: &Solution,
    ) -> EnergyLedger {
        let radiometry = radiometry.into();
        let channels = radiometry.channels;
        assert_eq!(solution.radiosity.len(), form_factors.len() * channels, "sizes disagree");
        let (areas, escaped) = (form_factors.areas(), form_factors.escaped());
        // A_j Σ_i F_ji: what patch j can send to others; and Σ_i A_i F_ij: what the others take from it.
        let sent: Vec<f64> = form_factors.row_sums().iter().zip(areas).map(|(sum, a)| a * sum).collect();
        let taken = form_factors.column_sums();
        let zero = vec![0.0; channels];
        let mut ledger = EnergyLedger {
            emitted: zero.clone(),
            absorbed: zero.clone(),
            escaped: zero.clone(),
            solver_part: zero.clone(),
            reciprocity_part: zero.clone(),
            leaving: zero,
        };
        for i in 0..form_factors.len() {
            for c in 0..channels {
                let at = i * channels + c;
                let (be, rho) = (radiometry.emission[at], radiometry.reflectance[at]);
                let (b, e) = (solution.radiosity[at], solution.irradiance[at]);
                ledger.emitted[c] += areas[i] * be;
                ledger.absorbed[c] += areas[i] * (1.0 - rho) * e;
                ledger.escaped[c] += areas[i] * b * escaped[i];
                ledger.leaving[c] += areas[i] * b;
                ledger.solver_part[c] += areas[i] * (be + rho * e - b);
                ledger.reciprocity_part[c] += b * (sent[i] - taken[i]);
            }
        }
        ledger
    }

    /// (emitted - absorbed - escaped) / emitted of the channel where it is worst.
    pub fn imbalance(&self) -> f64 {
        self.worst(|c| self.emitted[c] - self.absorbed[c] - self.escaped[c])
    }

    /// The solver's part of the imbalance, relative to what is emitted, of the channel where it is worst.
    pub fn relative_solver_part(&self) -> f64 {
        self.worst(|c| self.solver_part[c])
    }

    /// The reciprocity defect's part of the imbalance, relative to what is emitted, of the channel where it is worst.
    pub fn relative_reciprocity_part(&self) -> f64 {
        self.worst(|c| self.reciprocity_part[c])
    }

    /// One rounding of the light that leaves the patches, relative to what is emitted, of the channel where it is worst: no
    /// balance can be closer. It matters where nearly all is reflected.
    pub fn rounding(&self) -> f64 {
        self.worst(|c| f64::EPSILON * self.leaving[c])
    }

    fn worst(&self, power: impl Fn(usize) -> f64) -> f64 {
        (0..self.emitted.len())
            .filter(|&c| self.emitted[c] > 0.0)
            .map(|c| power(c) / self.emitted[c])
            .fold(0.0, |worst: f64, x| if x.abs() > worst.abs() { x } else { worst })
    }
}
