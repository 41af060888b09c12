//! Lights that are no surfaces: options of every command that computes light.

use std::str::FromStr;

use clap::Args;
use glam::DVec3;
use radiosity::{
    Error, Result as RadiosityResult, Scene,
    scene::{
        is_radiance,
        light::{Distant, Light, LightKind, SUN_DIAMETER, Sky, SkyModel, Up},
    },
};

use super::options::point;

/// Name of the sun of `--sun`, for `--emitters`.
const SUN: &str = "sun";

/// Sun, sky and other lights.
#[derive(Args)]
pub struct LightArgs {
    /// Add the sun: its azimuth in degrees clockwise from north as seen from above, its altitude in degrees, and the irradiance in
    /// W/m2 on a plane that faces it. North is -z, or +y with --up z; east is +x. Without the irradiance it only says where the sun
    /// of the sky is
    #[arg(long, value_name = "AZIMUTH,ALTITUDE[,W/M2]", value_parser = sun, allow_hyphen_values = true)]
    sun: Option<SunArg>,
    /// Add a sky, which is dark below the horizon: uniform:RADIANCE in W/(m2 sr), or overcast:E, clear:E or intermediate:E (CIE) with
    /// the irradiance E in W/m2 on an unobstructed horizontal plane
    #[arg(long, value_name = "KIND:VALUE", value_parser = SkyArg::from_str)]
    sky: Option<SkyArg>,
    /// Which axis points up for sun and sky: y or z. `render` also takes the direction that points upwards in the picture, x,y,z; sun
    /// and sky then follow the nearer axis [default: y]
    #[arg(long, value_name = "y|z", value_parser = UpArg::from_str, allow_hyphen_values = true)]
    up: Option<UpArg>,
}

/// Azimuth and altitude in degrees, and the irradiance.
#[derive(Debug, Clone, Copy, PartialEq)]
struct SunArg {
    azimuth: f64,
    altitude: f64,
    irradiance: Option<f64>,
}

#[derive(Debug, Clone, PartialEq)]
enum SkyArg {
    Uniform(f64),
    Overcast(f64),
    Clear(f64),
    Intermediate(f64),
}

/// An axis, or the direction that is upwards in a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
enum UpArg {
    Axis(Up),
    Direction(DVec3),
}

fn sun(text: &str) -> Result<SunArg, String> {
    let numbers: Option<Vec<f64>> =
        text.split(',').map(|word| word.trim().parse().ok().filter(|x: &f64| x.is_finite())).collect();
    let (azimuth, altitude, irradiance) = match numbers.as_deref() {
        Some(&[azimuth, altitude]) => (azimuth, altitude, None),
        Some(&[azimuth, altitude, irradiance]) => (azimuth, altitude, Some(irradiance)),
        _ => return Err("expected AZIMUTH,ALTITUDE,IRRADIANCE, three numbers without blanks".into()),
    };
    if !(0.0..=90.0).contains(&altitude) {
        return Err("the altitude of the sun is between 0 and 90 degrees".into());
    }
    if irradiance.is_some_and(|e| !is_radiance(e)) {
        return Err("the irradiance is a number that is not negative".into());
    }
    Ok(SunArg { azimuth, altitude, irradiance })
}

impl FromStr for SkyArg {
    type Err = String;

    fn from_str(text: &str) -> Result<SkyArg, String> {
        const WANTED: &str = "expected uniform:RADIANCE, overcast:E, clear:E or intermediate:E";
        let (kind, value) = text.split_once(':').ok_or(WANTED)?;
        let number = || {
            let number = value.parse().ok().filter(|&x| is_radiance(x));
            number.ok_or_else(|| format!("`{value}` is no number from 0 on"))
        };
        Ok(match kind {
            "uniform" => SkyArg::Uniform(number()?),
            "overcast" => SkyArg::Overcast(number()?),
            "clear" => SkyArg::Clear(number()?),
            "intermediate" => SkyArg::Intermediate(number()?),
            _ => return Err(WANTED.into()),
        })
    }
}

impl FromStr for UpArg {
    type Err = String;

    fn from_str(text: &str) -> Result<UpArg, String> {
        match text {
            "y" => Ok(UpArg::Axis(Up::Y)),
            "z" => Ok(UpArg::Axis(Up::Z)),
            _ => {
                point(text).map(UpArg::Direction).map_err(|_| "expected y, z or x,y,z without blanks".into())
            }
        }
    }
}

impl LightArgs {
    /// The axis that is up.
    pub fn up(&self) -> Up {
        match self.up {
            None => Up::Y,
            Some(UpArg::Axis(up)) => up,
            Some(UpArg::Direction(d)) if d.z.abs() > d.y.abs() => Up::Z,
            Some(UpArg::Direction(_)) => Up::Y,
        }
    }

    /// The direction that is upwards in a picture, if one was given.
    pub fn upwards(&self) -> Option<DVec3> {
        self.up.map(|up| match up {
            UpArg::Axis(up) => up.to_scene([0.0, 0.0, 1.0]),
            UpArg::Direction(direction) => direction,
        })
    }

    /// Adds the lights to a scene.
    pub fn add(&self, scene: &mut Scene) -> RadiosityResult<()> {
        let up = self.up();
        let towards = self.sun.map(|sun| up.direction(sun.azimuth.to_radians(), sun.altitude.to_radians()));
        if let (Some(SunArg { irradiance: Some(e), .. }), Some(towards)) = (self.sun, towards) {
            let sun = Distant::new(towards, [e; 3], SUN_DIAMETER.to_radians());
            scene.lights.list.push(Light::new(SUN, LightKind::Distant(sun)));
        }
        let Some(sky) = &self.sky else {
            return match self.sun {
                Some(SunArg { irradiance: None, .. }) => Err(Error::Usage {
                    message: "--sun has no irradiance, and there is no sky whose sun it could be".into(),
                    hint: Some("add it in W/m2, as in --sun 220,40,800".into()),
                }),
                _ => Ok(()),
            };
        };
        let towards = |kind: &str| {
            towards.ok_or_else(|| Error::Usage {
                message: format!("--sky {kind} needs to know where the sun is"),
                hint: Some("add --sun AZIMUTH,ALTITUDE".into()),
            })
        };
        scene.lights.sky = Some(match *sky {
            SkyArg::Uniform(radiance) => Sky::uniform(up, [radiance; 3]),
            SkyArg::Overcast(e) => Sky::with_irradiance(SkyModel::Overcast, up, [e; 3]),
            SkyArg::Clear(e) => Sky::with_irradiance(SkyModel::Clear(towards("clear")?), up, [e; 3]),
            SkyArg::Intermediate(e) => {
                Sky::with_irradiance(SkyModel::Intermediate(towards("intermediate")?), up, [e; 3])
            }
        });
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn suns_have_two_or_three_numbers() {
        let of = |azimuth, altitude, irradiance| Ok(SunArg { azimuth, altitude, irradiance });
        assert_eq!(sun("220,40,800"), of(220.0, 40.0, Some(800.0)));
        assert_eq!(sun("-10,90"), of(-10.0, 90.0, None));
        for wrong in ["", "1", "1,2,3,4", "1,91,3", "1,-1,3", "1,2,-3", "nan,2,3", "1,2,inf", "a,b,c"] {
            assert!(sun(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn skies_have_a_kind_and_a_number() {
        assert_eq!("uniform:0.5".parse(), Ok(SkyArg::Uniform(0.5)));
        assert_eq!("overcast:120".parse(), Ok(SkyArg::Overcast(120.0)));
        for wrong in ["", "uniform", "uniform:", "uniform:-1", "overcast:x", "blue:3", "clear:nan"] {
            assert!(wrong.parse::<SkyArg>().is_err(), "{wrong}");
        }
    }
}
