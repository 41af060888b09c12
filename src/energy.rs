//! The energy ledger: all power that is emitted or enters the scene (from sky, sun and other lights that are not
//! surfaces) is absorbed or escapes.
//!
//! Do is the direct irradiance from lights that are not surfaces. Their power enters as Σ A Do. The emission Bd of
//! lamps arrives as direct irradiance Dl or escapes. Form factors carry U = B - Bd. With irradiance E = Dl + Do + F U
//! and residual r = Be + ρ E - B, exactly
//!
//!   emitted + entered - absorbed - escaped = Σ_i A_i r_i + Σ_j U_j Σ_i (A_j F_ji - A_i F_ij)
//!
//! The first part is the solver's error, the second the defect of reciprocity. A balanced ledger proves only that both
//! are small: a wrong but symmetric matrix balances perfectly. Error bars and an independent estimator test whether the
//! result is right.

use crate::{
    form_factor::FormFactors,
    solve::{Radiometry, Solution},
};

/// Powers of each channel, in watts if lengths are metres.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct EnergyLedger {
    /// Σ A Be.
    pub emitted: Vec<f64>,
    /// Σ A Do: power that arrives directly from lights that are not surfaces.
    pub entered: Vec<f64>,
    /// Σ A (1 - ρ) E.
    pub absorbed: Vec<f64>,
    /// Power that leaves the scene: Σ A U times the escaped share, the lamps' power that arrives at no patch, Σ A (Bd -
    /// Dl), and the correction for linear light.
    pub escaped: Vec<f64>,
    /// Σ A r.
    pub solver_part: Vec<f64>,
    /// Σ_j U_j Σ_i (A_j F_ji - A_i F_ij).
    pub reciprocity_part: Vec<f64>,
    /// Σ A B: the power that leaves the patches, counted at every bounce.
    pub leaving: Vec<f64>,
    /// Lamps' power that arrives at no patch, beyond sampling error, in a scene from which no ray escapes.
    pub leaking: Vec<f64>,
}

impl EnergyLedger {
    /// The ledger of a solution.
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
        // A_j Σ_i F_ji, the exchange area by which patch j sends; and Σ_i A_i F_ij, the one by which others receive
        // from it.
        let sent: Vec<f64> = form_factors.row_sums().iter().zip(areas).map(|(sum, a)| a * sum).collect();
        let taken = form_factors.column_sums();
        let direct = form_factors.direct_powers(radiometry.emission, channels);
        let zero = vec![0.0; channels];
        let linear = solution.linear.as_ref().map_or(&zero, |linear| &linear.escaped);
        let mut ledger = EnergyLedger {
            emitted: zero.clone(),
            entered: direct.entered,
            absorbed: zero.clone(),
            leaking: if direct.leaks { direct.escaped.clone() } else { zero.clone() },
            escaped: direct.escaped.iter().zip(linear).map(|(direct, linear)| direct + linear).collect(),
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
                let carried = if form_factors.is_lamp(i) { (b - be).max(0.0) } else { b };
                ledger.escaped[c] += areas[i] * carried * escaped[i];
                ledger.leaving[c] += areas[i] * b;
                ledger.solver_part[c] += areas[i] * (be + rho * e - b);
                ledger.reciprocity_part[c] += carried * (sent[i] - taken[i]);
            }
        }
        ledger
    }

    /// (emitted + entered - absorbed - escaped) / (emitted + entered), in the worst channel.
    pub fn imbalance(&self) -> f64 {
        self.worst(|c| self.emitted[c] + self.entered[c] - self.absorbed[c] - self.escaped[c])
    }

    /// The solver's part of the imbalance, relative to the power that is emitted and enters, in the worst channel.
    pub fn relative_solver_part(&self) -> f64 {
        self.worst(|c| self.solver_part[c])
    }

    /// The reciprocity defect's part of the imbalance, relative to the power that is emitted and enters, in the worst
    /// channel.
    pub fn relative_reciprocity_part(&self) -> f64 {
        self.worst(|c| self.reciprocity_part[c])
    }

    /// The rounding of the power that leaves the patches, relative to the power that is emitted and enters, in the
    /// worst channel. No balance can be closer. It matters if surfaces reflect nearly all light.
    pub fn rounding(&self) -> f64 {
        self.worst(|c| f64::EPSILON * self.leaving[c])
    }

    /// Leaking power, relative to the power that is emitted and enters, in the worst channel.
    pub fn relative_leak(&self) -> f64 {
        self.worst(|c| self.leaking[c])
    }

    fn worst(&self, power: impl Fn(usize) -> f64) -> f64 {
        (0..self.emitted.len())
            .map(|c| (c, self.emitted[c] + self.entered[c]))
            .filter(|&(_, all)| all > 0.0)
            .map(|(c, all)| power(c) / all)
            .fold(0.0, |worst: f64, x| if x.abs() > worst.abs() { x } else { worst })
    }
}
