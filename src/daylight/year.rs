//! The hours of a year: illuminance of places under all-weather skies, daylight factor and daylight autonomy.

use glam::DVec3;
use rayon::prelude::*;

use super::{
    SkyParts,
    coefficients::{Coefficients, Daylight, Place},
    suns::Suns,
};
use crate::{
    Progress, Result,
    scene::light::{Hour, Perez, SOLAR_CONSTANT, Sky, SkyModel, Up, Weather, luminous_efficacy},
};

/// The radiance of a sky is averaged over at least this number squared of directions in each of Tregenza's parts.
const STEPS: usize = 3;

/// Illuminance that counts for daylight autonomy, lx (IES LM-83, "Approved Method: IES Spatial Daylight Autonomy (sDA)
/// and Annual Sunlight Exposure (ASE)").
pub const ENOUGH_LIGHT: f64 = 300.0;
/// Share of the occupied hours with [`ENOUGH_LIGHT`] that spatial daylight autonomy demands (IES LM-83).
pub const ENOUGH_HOURS: f64 = 0.5;
/// Labels of the first and the last occupied hour. Together they span the time from 8:00 to 18:00.
pub const OCCUPIED: [u32; 2] = [9, 18];

/// Illuminance of places for every hour of a weather file, with daylight autonomy.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Year {
    /// Month, day and label of each hour.
    pub labels: Vec<[u32; 3]>,
    /// Illuminance in lx, hour by hour, with an entry per place. It is 0 in hours without irradiance in the weather file.
    pub illuminance: Vec<f32>,
    /// For each hour, whether the weather file lacks its irradiance although the sun is up.
    pub is_missing: Vec<bool>,
    /// Daylight autonomy of each place: the share of occupied hours with [`ENOUGH_LIGHT`]. Missing hours do not count.
    pub autonomy: Vec<f64>,
    /// Spatial daylight autonomy: the share of places whose daylight autonomy is at least [`ENOUGH_HOURS`].
    pub spatial_autonomy: f64,
}

/// Daylight factor of each place: its irradiance under the overcast sky of the CIE, divided by the irradiance of an
/// unobstructed horizontal plane.
pub fn daylight_factors(coefficients: &Coefficients, up: Up) -> Vec<f64> {
    let sky = Sky::with_irradiance(SkyModel::Overcast, up, [1.0; 3]);
    let radiance = Samples::new(coefficients.parts, up).radiances(&sky, 1.0);
    (0..coefficients.places).map(|i| coefficients.irradiance(i, &radiance)).collect()
}

/// Directions for the mean radiance of a sky in each of its parts.
struct Samples {
    parts: SkyParts,
    /// The same number for each part.
    directions: Vec<DVec3>,
}

impl Samples {
    fn new(parts: SkyParts, up: Up) -> Samples {
        let steps = STEPS.div_ceil(parts.division());
        let directions = (0..parts.count()).flat_map(|k| parts.directions(up, k, steps)).collect();
        Samples { parts, directions }
    }

    /// Mean radiance of a sky in each of its parts, scaled so that a horizontal plane receives the given irradiance.
    /// Without scaling, the plane would receive 0.4 % less under an overcast sky, because the brighter half of each
    /// part is also the higher half.
    fn radiances(&self, sky: &Sky, irradiance: f64) -> Vec<f64> {
        let of_part = self.directions.len() / self.parts.count();
        let mean = |directions: &[DVec3]| {
            directions.iter().map(|&d| sky.radiance(d)[0]).sum::<f64>() / of_part as f64
        };
        let mut radiance: Vec<f64> = self.directions.chunks_exact(of_part).map(mean).collect();
        let horizontal: f64 = radiance.iter().enumerate().map(|(k, l)| l * self.parts.horizontal(k)).sum();
        let scale = if horizontal > 0.0 { irradiance / horizontal } else { 0.0 };
        radiance.iter_mut().for_each(|l| *l *= scale);
        radiance
    }
}

/// The light of an hour: of the sun, and what the sky follows from.
struct Light {
    /// Directions to the sun in the course of the hour; none if it is down.
    suns: Vec<DVec3>,
    /// Illuminance of a plane that faces the sun, in the mean of its directions, lx.
    direct: f64,
    /// Illuminance of an unobstructed horizontal plane by the sky, lx.
    diffuse: f64,
    /// The sky, without its scale.
    sky: Sky,
}

/// The light of an hour; `None` if there is none. Before sunrise and after sunset, it is that of a sky without sun.
fn light_of(hour: &Hour, up: Up) -> Option<Light> {
    let (azimuth, altitude) = hour.sun.unwrap_or((hour.azimuth, 0.0));
    let direct = if hour.sun.is_some() { hour.direct } else { 0.0 };
    if hour.is_missing || direct + hour.diffuse <= 0.0 {
        return None;
    }
    let towards = up.direction(azimuth, altitude);
    let outside = SOLAR_CONSTANT * hour.eccentricity;
    let of = [direct, hour.diffuse];
    let [of_direct, of_diffuse] = luminous_efficacy(of, altitude, outside, hour.dew_point);
    let perez = Perez::new(direct, hour.diffuse, altitude, outside);
    let sky = Sky::relative(SkyModel::AllWeather(perez, towards), up);
    let direction = |(azimuth, altitude): (f64, f64)| up.direction(azimuth, altitude);
    let mut suns: Vec<DVec3> = hour.positions.iter().flatten().copied().map(direction).collect();
    if suns.is_empty() && hour.sun.is_some() {
        suns.push(towards);
    }
    Some(Light { suns, direct: direct * of_direct, diffuse: hour.diffuse * of_diffuse, sky })
}

impl Year {
    /// Mean illuminance of all places in all hours whose irradiance is known, lx.
    pub fn mean(&self) -> f64 {
        let known = self.is_missing.iter().filter(|missing| !**missing).count();
        let places = self.illuminance.len() / self.is_missing.len().max(1);
        let sum: f64 = self.illuminance.iter().map(|&e| f64::from(e)).sum();
        sum / (known * places).max(1) as f64
    }

    /// Computes the hours of a weather file. If `points` are given, which are the places of the coefficients, a ray to
    /// each position of the sun decides whether its direct light reaches each point. Otherwise the places are the front
    /// patches, and shadow rays to positions in the same part of the sky find the sunlit share of each.
    ///
    /// # Errors
    /// [`crate::Error::Stopped`]; [`crate::Error::NoEquilibrium`].
    pub fn of(
        daylight: &Daylight<'_>,
        coefficients: &Coefficients,
        points: Option<&[Place]>,
        weather: &Weather,
        up: Up,
        progress: &Progress,
    ) -> Result<Year> {
        let lights: Vec<Option<Light>> = weather.hours.par_iter().map(|hour| light_of(hour, up)).collect();
        let positions = lights.iter().flatten().flat_map(|light| {
            let each = light.direct / light.suns.len().max(1) as f64;
            light.suns.iter().map(move |&towards| (towards, each))
        });
        let suns = Suns::new(daylight, points, positions.collect(), progress)?;
        let samples = Samples::new(coefficients.parts, up);
        progress.begin("computing hours", weather.hours.len() as u64);
        let of_hour = |light: &Option<Light>| -> Result<Vec<f32>> {
            progress.check()?;
            progress.advance(1);
            let Some(Light { suns: positions, direct, diffuse, sky }) = light else {
                return Ok(vec![0.0; coefficients.places]);
            };
            let luminance = samples.radiances(sky, *diffuse);
            let each = direct / positions.len().max(1) as f64;
            let positions: Vec<(DVec3, usize)> = positions
                .iter()
                .filter_map(|&towards| Some((towards, suns.group(daylight, towards)?)))
                .collect();
            let of_place = |i: usize| {
                let mut light = coefficients.irradiance(i, &luminance);
                for &(towards, group) in &positions {
                    light += each * suns.of(i, group);
                    if let Some(point) = points.map(|points| &points[i])
                        && daylight.sees(point, towards)
                    {
                        light += each * point.1.normalize().dot(towards);
                    }
                }
                light as f32
            };
            Ok((0..coefficients.places).map(of_place).collect())
        };
        let hours: Vec<Vec<f32>> = lights.par_iter().map(of_hour).collect::<Result<_>>()?;
        let is_occupied =
            |hour: &Hour| (OCCUPIED[0]..=OCCUPIED[1]).contains(&hour.label[2]) && !hour.is_missing;
        let occupied: Vec<&Vec<f32>> =
            hours.iter().zip(&weather.hours).filter(|(_, hour)| is_occupied(hour)).map(|(e, _)| e).collect();
        let autonomy: Vec<f64> = (0..coefficients.places)
            .map(|i| {
                let lit = occupied.iter().filter(|e| f64::from(e[i]) >= ENOUGH_LIGHT).count();
                lit as f64 / occupied.len().max(1) as f64
            })
            .collect();
        let enough = autonomy.iter().filter(|&&share| share >= ENOUGH_HOURS).count();
        Ok(Year {
            labels: weather.hours.iter().map(|hour| hour.label).collect(),
            illuminance: hours.concat(),
            is_missing: weather.hours.iter().map(|hour| hour.is_missing).collect(),
            spatial_autonomy: enough as f64 / autonomy.len().max(1) as f64,
            autonomy,
        })
    }
}
