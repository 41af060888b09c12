//! The error of treating all surfaces as Lambertian, as JSON and in a sentence.

use serde::Serialize;

use crate::{
    accuracy::lambert::{CONFIDENCE_95, Change, LambertCost},
    patch::Patches,
    scene::Scene,
};

/// Changes from Lambertian materials with the same hemispherical albedo to the given materials. `dropped` holds the
/// changes from the diffuse parts only.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LambertReport {
    /// Number of materials with a specular part.
    pub glossy_materials: usize,
    /// Mean irradiance with the given materials, W/m².
    pub mean_irradiance: f64,
    /// The changes from Lambertian materials with the same hemispherical albedo.
    #[serde(flatten)]
    pub matched: ChangeReport,
    /// The changes from the diffuse parts only.
    pub dropped: ChangeReport,
    /// The verdict in a sentence.
    pub verdict: String,
}

/// The change from Lambertian materials to the given ones.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ChangeReport {
    /// Area-weighted root mean square of the change of irradiance, relative to the mean irradiance.
    pub rms_relative: f64,
    /// Its standard error.
    pub standard_error: f64,
    /// Relative change of the mean irradiance.
    pub mean_relative: f64,
    /// Its standard error.
    pub mean_standard_error: f64,
    /// The largest significant change, relative to the mean irradiance. It is positive if gloss makes the patch
    /// brighter.
    pub largest_relative: f64,
    /// Its standard error.
    pub largest_standard_error: f64,
    /// Centre of the patch of the largest change.
    pub largest_position: [f64; 3],
    /// Material of that patch.
    pub largest_material: String,
    /// Change of the absorbed flux, W per channel.
    pub absorbed: [f64; 3],
    /// Its standard error.
    pub absorbed_standard_error: [f64; 3],
    /// Change of the escaped flux, W per channel.
    pub escaped: [f64; 3],
    /// Its standard error.
    pub escaped_standard_error: [f64; 3],
}

impl LambertReport {
    /// Collects the figures.
    pub fn new(cost: &LambertCost, scene: &Scene, patches: &Patches) -> LambertReport {
        let [matched, dropped] =
            [&cost.matched, &cost.dropped].map(|change| ChangeReport::new(change, scene, patches));
        let verdict = if cost.glossy == 0 {
            "no material has a specular part: nothing is lost".into()
        } else {
            format!(
                "taking gloss as diffuse changes irradiance by {}; leaving it out, by {}",
                matched.in_words(),
                dropped.in_words()
            )
        };
        LambertReport { glossy_materials: cost.glossy, mean_irradiance: cost.mean, matched, dropped, verdict }
    }
}

impl ChangeReport {
    fn new(change: &Change, scene: &Scene, patches: &Patches) -> ChangeReport {
        ChangeReport {
            rms_relative: change.rms_relative,
            standard_error: change.standard_error,
            mean_relative: change.mean_relative,
            mean_standard_error: change.mean_standard_error,
            largest_relative: change.largest_relative,
            largest_standard_error: change.largest_standard_error,
            largest_position: patches.centroid(scene, change.worst).to_array(),
            largest_material: scene.material(patches.triangle(change.worst)).name.clone(),
            absorbed: change.absorbed.mean,
            absorbed_standard_error: change.absorbed.standard_error,
            escaped: change.escaped.mean,
            escaped_standard_error: change.escaped.standard_error,
        }
    }

    /// The change in words, in percent of the mean irradiance, with 95 % confidence intervals.
    fn in_words(&self) -> String {
        let percent =
            |x: f64, error: f64| format!("{:.1} ± {:.1} %", 100.0 * x, 100.0 * CONFIDENCE_95 * error);
        let [x, y, z] = self.largest_position;
        format!(
            "{} RMS of its mean, at most by {} at {x:.4} {y:.4} {z:.4} ({})",
            percent(self.rms_relative, self.standard_error),
            percent(self.largest_relative.abs(), self.largest_standard_error),
            self.largest_material
        )
    }
}
