//! The figures of a validation as JSON.

use std::io::{self, Write};

use serde::Serialize;

use super::{
    lambert_report::LambertReport,
    report::{BeforeAfter, EnergyReport},
};
use crate::{
    accuracy::{
        comparison::{Comparison, Worst},
        validation::Validation,
    },
    patch::Patches,
    scene::{Scene, light::UnitNames},
};

/// The report of `radiosity validate`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ValidationReport {
    /// Version of the program.
    pub version: &'static str,
    /// The scene's file, as it was named.
    pub scene: String,
    /// Units of light.
    pub units: UnitNames,
    /// Whether every check passed.
    pub valid: bool,
    /// The failed checks, one sentence each.
    pub objections: Vec<String>,
    /// Number of patches of the solution.
    pub patches: usize,
    /// Number of rays of the solution.
    pub rays: u64,
    /// The energy ledger.
    pub energy: EnergyReport,
    /// Largest |sum of a row + its escaped share - 1|.
    pub row_sum_deviation: BeforeAfter,
    /// Largest |A_i F_ij - A_j F_ji| / min(A_i, A_j).
    pub reciprocity_deviation: BeforeAfter,
    /// RMS discretisation error relative to the mean irradiance, from a solution with edges half as long.
    pub discretisation_relative: f64,
    /// The comparisons of pairs of methods.
    pub comparisons: Vec<ComparisonReport>,
    /// The error from treating all surfaces as Lambertian, if it was measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lambert: Option<LambertReport>,
}

/// The differences between two methods.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ComparisonReport {
    /// The names of the methods.
    pub what: &'static str,
    /// The figures.
    #[serde(flatten)]
    pub figures: Comparison,
    /// The patches that differ most.
    pub worst: Vec<WorstReport>,
}

/// A patch where two methods differ much.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WorstReport {
    /// Index of the patch.
    pub patch: usize,
    /// 0 red, 1 green, 2 blue.
    pub channel: usize,
    /// Its centre in scene coordinates.
    pub position: [f64; 3],
    /// Name of its material.
    pub material: String,
    /// The difference in units of its standard error.
    pub z: f64,
    /// Irradiance by the first method, W/m².
    pub first: f64,
    /// Irradiance by the second method, W/m².
    pub second: f64,
}

impl ValidationReport {
    /// Collects the figures.
    pub fn new(file: &str, scene: &Scene, validation: &Validation) -> ValidationReport {
        let solved = &validation.solved;
        let objections = validation.objections();
        ValidationReport {
            version: env!("CARGO_PKG_VERSION"),
            scene: file.into(),
            units: scene.units.names(),
            valid: objections.is_empty(),
            objections,
            patches: solved.patches.len(),
            rays: solved.form_factors.rays(),
            energy: EnergyReport::of(&validation.energy),
            row_sum_deviation: solved.form_factors.row_sum_deviation().into(),
            reciprocity_deviation: solved.form_factors.reciprocity_deviation().into(),
            discretisation_relative: validation.discretisation_relative,
            comparisons: validation
                .comparisons()
                .map(|(what, comparison)| ComparisonReport::new(what, comparison, scene, &solved.patches))
                .into(),
            lambert: None,
        }
    }

    /// Writes the report as indented JSON, followed by a line end.
    ///
    /// # Errors
    /// Errors of writing to `out`.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        super::write_json(self, out)
    }
}

impl ComparisonReport {
    fn new(what: &'static str, comparison: &Comparison, scene: &Scene, patches: &Patches) -> Self {
        let worst = comparison.worst.iter().map(|worst| WorstReport::new(worst, scene, patches)).collect();
        ComparisonReport { what, figures: comparison.clone(), worst }
    }
}

impl WorstReport {
    fn new(worst: &Worst, scene: &Scene, patches: &Patches) -> Self {
        WorstReport {
            patch: worst.patch,
            channel: worst.channel,
            position: patches.centroid(scene, worst.patch).to_array(),
            material: scene.material(patches.triangle(worst.patch)).name.clone(),
            z: worst.z,
            first: worst.first,
            second: worst.second,
        }
    }
}
