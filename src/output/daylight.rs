//! Daylight coefficients and the hours of a year as an `.npz` file.

use std::io::{self, Write};

use serde::Serialize;

use super::{
    numpy::{Array, Values, write_arrays},
    report::Seconds,
};
use crate::daylight::{
    coefficients::{Coefficients, Place},
    year::Year,
};

/// The contents of the `.npz` file.
#[derive(Debug, Clone, Copy)]
pub struct DaylightTable<'a> {
    /// Positions and normals of points, or of the middles of patches.
    pub places: &'a [Place],
    /// The coefficients of these places.
    pub coefficients: &'a Coefficients,
    /// Daylight factor of each place.
    pub factors: &'a [f64],
    /// The hours of a year, if there was a weather file.
    pub year: Option<&'a Year>,
}

impl DaylightTable<'_> {
    /// Writes arrays for `numpy.load`:
    ///
    /// - `places`: x y z nx ny nz of each place.
    /// - `parts`: azimuth and altitude of the middle of each part in degrees, and its solid angle in sr.
    /// - `coefficients` (places × parts): irradiance of the place per radiance of the part.
    /// - `reflected` (places × parts): the part of `coefficients` that surfaces reflect.
    /// - `sun` (places × parts): irradiance that surfaces reflect from a sun in the part, per irradiance of a plane
    ///   that faces the sun.
    /// - `daylight_factor` of each place.
    /// - With a year: `hours` (month, day, label), `illuminance` (hours × places, lx) and `autonomy` of each place.
    ///
    /// # Errors
    /// Errors of `out`, and an error if the file would be larger than 4 GiB.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        let Coefficients { parts, places, total, reflected, .. } = self.coefficients;
        let (places, count) = (*places, parts.count());
        let at: Vec<f64> =
            self.places.iter().flat_map(|(p, n)| [p.to_array(), n.to_array()].concat()).collect();
        let about = |k: usize| {
            let [[from, to], [low, high]] = parts.bounds(k);
            // The last part is around the zenith.
            let altitude = if k + 1 == count { high } else { 0.5 * (low + high) };
            [(0.5 * (from + to)).to_degrees(), altitude.to_degrees(), parts.solid_angle(k)]
        };
        let parts_of: Vec<f64> = (0..count).flat_map(about).collect();
        let sun: Vec<f32> =
            (0..places * count).map(|q| self.coefficients.of_sun(q / count, q % count) as f32).collect();
        let array =
            |name: &'static str, shape: &[usize], values| Array { name, shape: shape.to_vec(), values };
        let mut arrays = vec![
            array("places", &[places, 6], Values::F64(&at)),
            array("parts", &[count, 3], Values::F64(&parts_of)),
            array("coefficients", &[places, count], Values::F32(total)),
            array("reflected", &[places, count], Values::F32(reflected)),
            array("sun", &[places, count], Values::F32(&sun)),
            array("daylight_factor", &[places], Values::F64(self.factors)),
        ];
        let labels: Vec<i32>;
        if let Some(year) = self.year {
            labels = year.labels.iter().flatten().map(|&x| x as i32).collect();
            let hours = year.labels.len();
            arrays.push(array("hours", &[hours, 3], Values::I32(&labels)));
            arrays.push(array("illuminance", &[hours, places], Values::F32(&year.illuminance)));
            arrays.push(array("autonomy", &[places], Values::F64(&year.autonomy)));
        }
        write_arrays(&arrays, out)
    }
}

/// The report of `radiosity daylight`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DaylightReport {
    /// Version of the program.
    pub version: &'static str,
    /// The scene's file, as it was named.
    pub scene: String,
    /// Number of patches of the scene.
    pub patches: usize,
    /// Number of points, or of patches if no points were given.
    pub places: usize,
    /// Number of parts of the sky.
    pub parts: usize,
    /// Mean of the daylight factors of all places, as a share.
    pub mean_daylight_factor: f64,
    /// Number of hours in the weather file; `null` without one.
    pub hours: Option<usize>,
    /// Number of hours whose irradiance is missing in the weather file although the sun is up; `null` without one. They do
    /// not count in the figures below.
    pub missing_hours: Option<usize>,
    /// Share of places with at least 300 lx in at least half of the hours from 8 to 18; `null` without a weather file.
    pub spatial_daylight_autonomy: Option<f64>,
    /// Mean illuminance of all places and hours, lx; `null` without a weather file.
    pub mean_illuminance: Option<f64>,
    /// Seed of the rays.
    pub seed: u64,
    /// Time of each stage.
    pub seconds: Seconds,
    /// Peak memory of the process in bytes; `null` if the operating system does not report it.
    pub peak_bytes: Option<u64>,
}

impl DaylightReport {
    /// Writes the report as indented JSON, followed by a line end.
    ///
    /// # Errors
    /// Errors of `out`.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        super::write_json(self, out)
    }
}
