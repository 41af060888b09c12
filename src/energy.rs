//! The energy ledger. All power that is emitted or enters is absorbed or escapes.
//!
//! Power enters from sky, sun and other lights that are not surfaces. Do is their direct irradiance, so the power that
//! enters is Σ A Do. The emission Bd of lamps arrives as direct irradiance Dl or escapes. Form factors carry the rest
//! of the radiosity, U = B - Bd. With the irradiance E = Dl + Do + F U and the residual r = Be + ρ E - B, this equation
//! is exact:
//!
//!   emitted + entered - absorbed - escaped = Σ_i A_i r_i + Σ_j U_j Σ_i (A_j F_ji - A_i F_ij)
//!
//! The first sum is the solver's error, and the second is the defect of reciprocity. A balanced ledger proves only that
//! both are small: a wrong but symmetric matrix balances perfectly. Error bars and an independent estimator show
//! whether the solution is correct.

use crate::{
    form_factor::FormFactors,
    solve::{Radiometry, Solution},
};

/// Powers of each channel, in watts if lengths are metres.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct EnergyLedger {
    /// Emitted power, Σ A Be.
    pub emitted: Vec<f64>,
    /// Power that arrives directly from lights that are not surfaces, Σ A Do.
    pub entered: Vec<f64>,
    /// Absorbed power, Σ A (1 - ρ) E.
    pub absorbed: Vec<f64>,
    /// Power that escapes: Σ A U times the share of rays that leave the scene, plus the power of lamps that arrives
    /// nowhere, Σ A (Bd - Dl), plus a correction for light that varies over patches.
    pub escaped: Vec<f64>,
    /// The solver's part of the imbalance, Σ A r.
    pub solver_part: Vec<f64>,
    /// The part of the imbalance from the defect of reciprocity, Σ_j U_j Σ_i (A_j F_ji - A_i F_ij).
    pub reciprocity_part: Vec<f64>,
    /// The power that leaves the patches, counted at every bounce, Σ A B.
    pub leaving: Vec<f64>,
    /// Power of lamps that arrives nowhere although no ray leaves the scene. Zero if sampling errors explain it.
    pub leaking: Vec<f64>,
}

impl EnergyLedger {
    /// The ledger of a solution.
    ///
    /// # Panics
    /// When the numbers of patches or channels disagree.
    pub fn of<'a>(
        form_factors: &FormFactors,
        radiometry: impl Into<Radiometry<'a>>,
        solution: &Solution,
    ) -> EnergyLedger {
        Self::of_radiometry(form_factors, radiometry.into(), solution)
    }

    fn of_radiometry(
        form_factors: &FormFactors,
        radiometry: Radiometry<'_>,
        solution: &Solution,
    ) -> EnergyLedger {
        let channels = radiometry.channels;
        assert_eq!(solution.radiosity.len(), form_factors.len() * channels, "sizes disagree");
        let (areas, escaped) = (form_factors.areas(), form_factors.escaped());
        // The exchange area of patch j towards all others by rows, A_j Σ_i F_ji, and by columns, Σ_i A_i F_ij.
        let sent: Vec<f64> = form_factors.row_sums().iter().zip(areas).map(|(sum, a)| a * sum).collect();
        let taken = form_factors.column_sums();
        let direct = form_factors.direct_powers(radiometry.emission, channels);
        let zero = vec![0.0; channels];
        let [escaped_more, beyond_means] = match &solution.linear {
            Some(linear) => [&linear.escaped, &linear.beyond_means],
            None => [&zero, &zero],
        };
        let mut ledger = EnergyLedger {
            emitted: zero.clone(),
            entered: direct.entered,
            absorbed: beyond_means.iter().map(|power| -power).collect(),
            leaking: if direct.leaks { direct.escaped.clone() } else { zero.clone() },
            escaped: direct.escaped.iter().zip(escaped_more).map(|(direct, more)| direct + more).collect(),
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

    /// One rounding error of the power that leaves the patches, relative to the power that is emitted and enters, in
    /// the worst channel. No balance can be closer. This matters if surfaces reflect nearly all light.
    pub fn rounding(&self) -> f64 {
        self.worst(|c| f64::EPSILON * self.leaving[c])
    }

    /// The power that leaks, relative to the power that is emitted and enters, in the worst channel.
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
