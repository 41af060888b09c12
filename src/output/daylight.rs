//! Daylight coefficients and the hours of a year as a `.npz`.

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

/// What is written.
#[derive(Debug, Clone, Copy)]
pub struct DaylightTable<'a> {
    /// Points, or middles and normals of patches.
    pub places: &'a [Place],
    /// Their coefficients.
    pub coefficients: &'a Coefficients,
    /// Irradiance under the overcast sky over that of an unobstructed horizontal plane.
    pub factors: &'a [f64],
    /// The hours of a year, if there was a weather file.
    pub year: Option<&'a Year>,
}

impl DaylightTable<'_> {
    /// Writes arrays for `numpy.load`: `places` (x y z nx ny nz), `parts` (azimuth and altitude of the middle of each part in degrees,
    /// solid angle), `coefficients` (places by parts: irradiance over the radiance of the part), `reflected` (what of it surfaces
    /// reflect), `sun` (places by parts: what surfaces reflect of a sun in the part, over its irradiance on a plane that faces it),
    /// `daylight_factor`; and with a year `hours` (month, day, label), `illuminance` (hours by places, lx) and `autonomy`.
    ///
    /// # Errors
    /// What `out` says, and when the file would be larger than 4 GiB.
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

/// What `radiosity daylight --report` writes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DaylightReport {
    /// Version of the program.
    pub version: &'static str,
    /// The scene's file, as it was named.
    pub scene: String,
    /// Patches of the scene.
    pub patches: usize,
    /// Points, or patches where no points were given.
    pub places: usize,
    /// Parts of the sky.
    pub parts: usize,
    /// Mean of the daylight factors of all places, as a share.
    pub mean_daylight_factor: f64,
    /// Hours of the weather file; `null` without one.
    pub hours: Option<usize>,
    /// Share of places with 300 lx in half of the hours from 8 to 18; `null` without a weather file.
    pub spatial_daylight_autonomy: Option<f64>,
    /// Mean illuminance of all places and hours, lx; `null` without a weather file.
    pub mean_illuminance: Option<f64>,
    /// Seed of the rays.
    pub seed: u64,
    /// Time of each stage.
    pub seconds: Seconds,
    /// Most memory held at any time; `null` where the operating system does not tell.
    pub peak_bytes: Option<u64>,
}

impl DaylightReport {
    /// Writes it as indented JSON with a line end after it.
    ///
    /// # Errors
    /// What `out` says.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        super::write_json(self, out)
    }
}
