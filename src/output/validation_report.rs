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
    scene::Scene,
};

/// What `radiosity validate --report` writes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ValidationReport {
    /// Version of the program.
    pub version: &'static str,
    /// The scene's file, as it was named.
    pub scene: String,
    /// Whether every check passed.
    pub valid: bool,
    /// What speaks against the answer, a sentence each.
    pub objections: Vec<String>,
    /// Patches under test.
    pub patches: usize,
    /// Rays of the solution under test.
    pub rays: u64,
    /// The energy ledger with its split.
    pub energy: EnergyReport,
    /// Largest |sum of a row + its escaped share - 1|.
    pub row_sum_deviation: BeforeAfter,
    /// Largest |A_i F_ij - A_j F_ji| / min(A_i, A_j).
    pub reciprocity_deviation: BeforeAfter,
    /// What the size of the patches may add to differences, RMS relative to the mean irradiance: measured by solving
    /// with edges half as long.
    pub discretisation_relative: f64,
    /// Each pair of methods.
    pub comparisons: Vec<ComparisonReport>,
    /// What taking all surfaces as Lambertian costs, where that was asked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lambert: Option<LambertReport>,
}

/// How two methods differ.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ComparisonReport {
    /// Which two.
    pub what: &'static str,
    /// The figures.
    #[serde(flatten)]
    pub figures: Comparison,
    /// The worst patches.
    pub worst: Vec<WorstReport>,
}

/// A patch where two methods differ most.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WorstReport {
    /// Index of the patch.
    pub patch: usize,
    /// 0 red, 1 green, 2 blue.
    pub channel: usize,
    /// Its centre in the scene's coordinates.
    pub position: [f64; 3],
    /// Name of its material.
    pub material: String,
    /// The difference in standard errors.
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

    /// Writes it as indented JSON with a line end after it.
    ///
    /// # Errors
    /// What `out` says.
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
