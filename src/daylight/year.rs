//! The hours of a year: illuminance of places under all-weather skies, daylight factor and daylight autonomy.

use glam::DVec3;
use rayon::prelude::*;

use super::{
    SkyParts,
    coefficients::{Coefficients, Daylight, Place},
};
use crate::scene::light::{Hour, Perez, SOLAR_CONSTANT, Sky, SkyModel, Up, Weather, luminous_efficacy};

/// The radiance of a sky is averaged over `STEPS` × `STEPS` directions in each part.
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
    let radiance = radiances(coefficients.parts, up, &sky, 1.0);
    (0..coefficients.places).map(|i| coefficients.irradiance(i, &radiance)).collect()
}

/// Mean radiance of a sky in each of its parts, scaled so that a horizontal plane receives the given irradiance.
/// Without scaling, the plane would receive 0.4 % less under an overcast sky, because the brighter half of each part is
/// also the higher half.
fn radiances(parts: SkyParts, up: Up, sky: &Sky, irradiance: f64) -> Vec<f64> {
    let mut radiance: Vec<f64> =
        (0..parts.count()).map(|k| parts.mean(up, k, STEPS, |d| sky.radiance(d)[0])).collect();
    let horizontal: f64 = radiance.iter().enumerate().map(|(k, l)| l * parts.horizontal(k)).sum();
    let scale = if horizontal > 0.0 { irradiance / horizontal } else { 0.0 };
    radiance.iter_mut().for_each(|l| *l *= scale);
    radiance
}

/// The light of an hour.
struct Light {
    /// Directions to the sun in the course of the hour.
    suns: Vec<DVec3>,
    /// Illuminance of a plane that faces the sun, lx.
    direct: f64,
    /// Luminance of the parts of the sky, cd/m².
    luminance: Vec<f64>,
}

/// The light of an hour; `None` if there is none.
fn light_of(hour: &Hour, parts: SkyParts, up: Up) -> Option<Light> {
    let (azimuth, altitude) = hour.sun?;
    if hour.is_missing || hour.direct + hour.diffuse <= 0.0 {
        return None;
    }
    let towards = up.direction(azimuth, altitude);
    let outside = SOLAR_CONSTANT * hour.eccentricity;
    let of = [hour.direct, hour.diffuse];
    let [direct, diffuse] = luminous_efficacy(of, altitude, outside, hour.dew_point);
    let perez = Perez::new(hour.direct, hour.diffuse, altitude, outside);
    let shape = SkyModel::AllWeather(perez, towards);
    let sky = Sky::relative(shape, up);
    let luminance = radiances(parts, up, &sky, hour.diffuse * diffuse);
    let direction = |(azimuth, altitude): (f64, f64)| up.direction(azimuth, altitude);
    let mut suns: Vec<DVec3> = hour.positions.iter().flatten().copied().map(direction).collect();
    if suns.is_empty() {
        suns.push(towards);
    }
    Some(Light { suns, direct: hour.direct * direct, luminance })
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
    /// each position of the sun decides whether its direct light reaches each point. Otherwise the coefficients are those
    /// of patches, and the light of the sun is added to the parts of the sky where it stands.
    pub fn of(
        daylight: &Daylight<'_>,
        coefficients: &Coefficients,
        points: Option<&[Place]>,
        weather: &Weather,
        up: Up,
    ) -> Year {
        let parts = coefficients.parts;
        let of_hour = |hour: &Hour| -> Vec<f32> {
            let Some(Light { suns, direct, mut luminance }) = light_of(hour, parts, up) else {
                return vec![0.0; coefficients.places];
            };
            let sun = direct / suns.len() as f64;
            let suns: Vec<(DVec3, usize)> =
                suns.into_iter().filter_map(|towards| Some((towards, parts.at(up, towards)?))).collect();
            if points.is_none() {
                suns.iter().for_each(|&(_, part)| luminance[part] += sun / parts.solid_angle(part));
            }
            let of_place = |i: usize| {
                let mut light = coefficients.irradiance(i, &luminance);
                for &(towards, part) in suns.iter().filter(|_| points.is_some()) {
                    light += sun * coefficients.of_sun(i, part);
                    if let Some(point) = points.map(|points| &points[i])
                        && daylight.sees(point, towards)
                    {
                        light += sun * point.1.normalize().dot(towards);
                    }
                }
                light as f32
            };
            (0..coefficients.places).map(of_place).collect()
        };
        let hours: Vec<Vec<f32>> = weather.hours.par_iter().map(of_hour).collect();
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
        Year {
            labels: weather.hours.iter().map(|hour| hour.label).collect(),
            illuminance: hours.concat(),
            is_missing: weather.hours.iter().map(|hour| hour.is_missing).collect(),
            spatial_autonomy: enough as f64 / autonomy.len().max(1) as f64,
            autonomy,
        }
    }
}
