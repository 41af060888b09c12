//! The figures of a picture or of probes as JSON.

use std::io::{self, Write};

use serde::Serialize;

use super::report::Seconds;
use crate::{
    monte_carlo::{Camera, Estimate, Film},
    scene::light::UnitNames,
};

/// The report of `radiosity render` and `radiosity probe`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SamplingReport {
    /// Version of the program.
    pub version: &'static str,
    /// The scene's file, as it was named.
    pub scene: String,
    /// Number of triangles with an area.
    pub triangles: usize,
    /// `path`, `light` or `radiosity`.
    pub method: &'static str,
    /// Samples per pixel or point.
    pub samples: u32,
    /// Whether next event estimation was used.
    pub next_event: bool,
    /// Rays of the final gather per sample; `null` without a final gather.
    pub final_gather: Option<u32>,
    /// Number of patches of the solution; `null` without a solution.
    pub patches: Option<usize>,
    /// Seed of the random numbers.
    pub seed: u64,
    /// Units of light.
    pub units: UnitNames,
    /// The picture, if there is one.
    pub picture: Option<PictureReport>,
    /// The probes, if there are any.
    pub probes: Option<ProbesReport>,
    /// Time of each stage.
    pub seconds: SamplingSeconds,
    /// Peak memory of the process in bytes; `null` if the operating system does not report it.
    pub peak_bytes: Option<u64>,
}

/// A picture.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PictureReport {
    /// Pixels in a row.
    pub width: usize,
    /// Rows of pixels.
    pub height: usize,
    /// Position of the camera.
    pub eye: [f64; 3],
    /// The point in the middle of the picture.
    pub look_at: [f64; 3],
    /// Direction that points upwards in the picture.
    pub up: [f64; 3],
    /// Vertical angle of view, degrees.
    pub fov: f64,
    /// Radiance shown as white, W/(m² sr).
    pub white: f64,
    /// Mean radiance of the picture, W/(m² sr).
    pub mean_radiance: [f64; 3],
}

/// Probes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProbesReport {
    /// Number of probes.
    pub points: usize,
    /// Mean irradiance of the probes, W/m².
    pub mean_irradiance: [f64; 3],
    /// Root mean square of the standard errors relative to the mean irradiance, in the worst channel.
    pub rms_relative: f64,
}

/// Wall-clock time of each stage in seconds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct SamplingSeconds {
    /// Stages of the solution.
    #[serde(flatten)]
    pub stages: Seconds,
    /// Sampling the picture or the probes.
    pub sampling: f64,
}

impl PictureReport {
    /// Collects the figures of a picture. `white` is the radiance shown as white.
    pub fn new(camera: &Camera, film: &Film, white: f64) -> PictureReport {
        PictureReport {
            width: film.width(),
            height: film.height(),
            eye: camera.eye().to_array(),
            look_at: camera.look_at().to_array(),
            up: camera.up().to_array(),
            fov: camera.fov(),
            white,
            mean_radiance: film.mean(),
        }
    }
}

impl ProbesReport {
    /// Collects the figures of probes.
    pub fn new(estimates: &[Estimate]) -> ProbesReport {
        let n = estimates.len().max(1) as f64;
        let mean = |c: usize| estimates.iter().map(|e| e.mean[c]).sum::<f64>() / n;
        let rms = |c: usize| (estimates.iter().map(|e| e.standard_error[c].powi(2)).sum::<f64>() / n).sqrt();
        let relative = |c: usize| if mean(c) > 0.0 { rms(c) / mean(c) } else { 0.0 };
        ProbesReport {
            points: estimates.len(),
            mean_irradiance: std::array::from_fn(mean),
            rms_relative: (0..3).map(relative).fold(0.0, f64::max),
        }
    }
}

impl SamplingReport {
    /// Writes the report as indented JSON, followed by a line end.
    ///
    /// # Errors
    /// Errors of writing to `out`.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        super::write_json(self, out)
    }
}
