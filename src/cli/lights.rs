//! Lights that are not surfaces: options of every command that computes light.

use std::{
    path::{Path, PathBuf},
    str::FromStr,
};

use clap::{Args, ValueEnum};
use glam::DVec3;
use radiosity::{
    Error, Result as RadiosityResult, Scene,
    scene::{
        MOST_RADIANCE, is_radiance,
        light::{
            Distant, LUMINOUS_EFFICACY, Light, LightKind, Moment, Mounting, Photometry, Place, SUN_DIAMETER,
            Sky, SkyImage, SkyModel, Units, Up,
            file::{self, SunAt, SunInFile, sun_at},
            luminaire,
        },
    },
};

use super::options::{parse, point};

/// Name of the sun of `--sun`, for `--emitters`.
const SUN: &str = "sun";

/// Sun, sky and other lights.
#[derive(Args)]
pub struct LightArgs {
    /// Add the sun: its azimuth in degrees clockwise from north as seen from above, its altitude in degrees, and the
    /// irradiance in W/m2 on a plane that faces it. North is -z, or +y with --up z; east is +x. Without the irradiance,
    /// this is only the position of the sun for --sky
    #[arg(long, value_name = "AZIMUTH,ALTITUDE[,W/M2]", value_parser = sun, allow_hyphen_values = true)]
    sun: Option<SunArg>,
    /// Add a sky: uniform:RADIANCE in W/(m2 sr); overcast:E, clear:E or intermediate:E (CIE) with the irradiance E in
    /// W/m2 on an unobstructed horizontal plane; perez:DIRECT,DIFFUSE with the direct normal and the diffuse horizontal
    /// irradiance, which adds the sun too; or an image of all directions, FILE.hdr or FILE.exr, optionally with
    /// :STRENGTH. All skies except images are dark below the horizon
    #[arg(long, value_name = "KIND:VALUE", value_parser = SkyArg::from_str)]
    sky: Option<SkyArg>,
    /// Turn the image of the sky clockwise as seen from above
    #[arg(long, value_name = "DEGREES", requires = "sky", allow_hyphen_values = true)]
    sky_rotation: Option<f64>,
    /// Compute the position of the sun for --sky at this place, in degrees north and east, and at the time of --at
    #[arg(long, value_name = "LAT,LON", value_parser = Place::from_str, requires = "at", conflicts_with = "sun",
        allow_hyphen_values = true)]
    place: Option<Place>,
    /// The time for --place, with its offset from UTC, for example 2026-06-21T12:00+02:00
    #[arg(long, value_name = "TIME", value_parser = Moment::from_str, requires = "place")]
    at: Option<Moment>,
    /// Add a luminaire from its photometric file, .ies or .ldt, at a point. 0 degrees of the file points down, and C0
    /// along +x. May be repeated
    #[arg(long, value_name = "FILE@X,Y,Z", value_parser = luminaire_at)]
    light: Vec<(PathBuf, DVec3)>,
    /// Add the lights of this file [default: lights.toml beside the scene, if there is one]
    #[arg(long, value_name = "FILE.toml")]
    lights: Option<PathBuf>,
    /// Units of the numbers that are read and written. Emission of materials is taken as it stands in both
    #[arg(long, value_enum, default_value_t = UnitsName::Radiometric)]
    units: UnitsName,
    /// The same as --units photometric
    #[arg(long, conflicts_with = "units")]
    photometric: bool,
    /// With radiometric units: lumens per watt. The candela and lux of photometric files and of glTF lights are divided
    /// by this number [default: 683]
    #[arg(long, value_name = "LM/W", value_parser = efficacy, conflicts_with = "photometric")]
    luminous_efficacy: Option<f64>,
    /// The axis that points up for sun and sky: y or z. For `render`, it may also be the upward direction of the
    /// picture, x,y,z. Sun and sky then use the nearer axis [default: y]
    #[arg(long, value_name = "y|z", value_parser = UpArg::from_str, allow_hyphen_values = true)]
    up: Option<UpArg>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum UnitsName {
    /// W, W/sr, W/m2 and W/(m2 sr)
    Radiometric,
    /// lm, cd, lx and cd/m2
    Photometric,
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
    Perez([f64; 2]),
    Image(PathBuf, f64),
}

fn efficacy(text: &str) -> Result<f64, String> {
    parse(text, |x| (1e-3..=1e6).contains(&x), "expected a number of lumens above 0")
}

fn luminaire_at(text: &str) -> Result<(PathBuf, DVec3), String> {
    let (file, at) = text.rsplit_once('@').ok_or("expected FILE@X,Y,Z")?;
    Ok((file.into(), point(at)?))
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
        return Err("the altitude of the sun must be between 0 and 90 degrees".into());
    }
    if irradiance.is_some_and(|e| !is_radiance(e)) {
        return Err(format!("the irradiance must be a number from 0 to {MOST_RADIANCE:e}"));
    }
    Ok(SunArg { azimuth, altitude, irradiance })
}

impl FromStr for SkyArg {
    type Err = String;

    fn from_str(text: &str) -> Result<SkyArg, String> {
        const WANTED: &str = "expected uniform:RADIANCE, overcast:E, clear:E, intermediate:E, perez:DIRECT,DIFFUSE or an image in .hdr or .exr";
        let is_image = |file: &str| {
            let extension = Path::new(file).extension().map(|e| e.to_ascii_lowercase());
            extension.is_some_and(|e| e == "hdr" || e == "exr")
        };
        if is_image(text) {
            return Ok(SkyArg::Image(text.into(), 1.0));
        }
        if let Some((file, strength)) = text.rsplit_once(':').filter(|(file, _)| is_image(file)) {
            let wanted = format!("the strength of the image must be a number from 0 to {MOST_RADIANCE:e}");
            return Ok(SkyArg::Image(file.into(), parse(strength, is_radiance, &wanted)?));
        }
        let (kind, value) = text.split_once(':').ok_or(WANTED)?;
        let number = || {
            let wanted = format!("`{value}` is not a number from 0 to {MOST_RADIANCE:e}");
            parse(value, is_radiance, &wanted)
        };
        Ok(match kind {
            "uniform" => SkyArg::Uniform(number()?),
            "overcast" => SkyArg::Overcast(number()?),
            "clear" => SkyArg::Clear(number()?),
            "intermediate" => SkyArg::Intermediate(number()?),
            "perez" => {
                let numbers: Option<Vec<f64>> =
                    value.split(',').map(|x| x.trim().parse().ok().filter(|&x| is_radiance(x))).collect();
                match numbers.as_deref() {
                    Some(&[direct, diffuse]) => SkyArg::Perez([direct, diffuse]),
                    _ => {
                        return Err(format!(
                            "expected perez:DIRECT,DIFFUSE, two numbers from 0 to {MOST_RADIANCE:e}"
                        ));
                    }
                }
            }
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

    /// The upward direction of a picture with this direction of view, if an option sets it. If the view runs along the
    /// given axis, north is upward instead.
    pub fn upwards(&self, view: DVec3) -> Option<DVec3> {
        self.up.map(|up| match up {
            UpArg::Axis(up) => {
                let axis = up.to_scene([0.0, 0.0, 1.0]);
                let across = view.cross(axis).length() > 1e-6 * view.length();
                if across { axis } else { up.to_scene([0.0, 1.0, 0.0]) }
            }
            UpArg::Direction(direction) => direction,
        })
    }

    /// The units of the scene.
    pub fn units(&self) -> RadiosityResult<Units> {
        match self.photometric || self.units == UnitsName::Photometric {
            true if self.luminous_efficacy.is_some() => Err(Error::Usage {
                message: "--luminous-efficacy has no effect with --units photometric: nothing is divided"
                    .into(),
                hint: Some("leave one of them out".into()),
            }),
            true => Ok(Units::Photometric),
            false => Ok(Units::Radiometric { efficacy: self.luminous_efficacy.unwrap_or(LUMINOUS_EFFICACY) }),
        }
    }

    /// The position of the sun from the options.
    fn given_sun(&self) -> RadiosityResult<Option<SunAt>> {
        if let Some(sun) = self.sun {
            return Ok(Some((self.up().direction(sun.azimuth.to_radians(), sun.altitude.to_radians()), 1.0)));
        }
        let (Some(place), Some(at)) = (self.place, &self.at) else { return Ok(None) };
        sun_at(self.up(), place, at)
            .map(Some)
            .map_err(|message| Error::Usage { message: format!("--at: {message}"), hint: None })
    }

    /// Adds the lights to a scene. Where a file of the scene is given and no light file, the one beside it is taken if it exists.
    pub fn add(&self, scene: &mut Scene, of_scene: Option<&Path>) -> RadiosityResult<()> {
        let beside = || of_scene.map(|path| path.with_file_name("lights.toml")).filter(|path| path.is_file());
        let file = self.lights.clone().or_else(beside);
        let given_up = self.up.map(|_| self.up());
        let of_file = file.map(|file| file::add(scene, &file, given_up)).transpose()?.flatten();
        let sun = self.given_sun()?;
        if let (Some(SunArg { irradiance: Some(e), .. }), Some((towards, _))) = (self.sun, sun) {
            add_sun(scene, towards, e);
        }
        for (file, position) in &self.light {
            let photometry = Photometry::load(file)?;
            scene.files.push(file.clone());
            scene.warnings.extend(photometry.warnings.iter().cloned());
            let mounting = Mounting { position: *position, aim: None, rotation: 0.0, dimming: 1.0 };
            let light = luminaire(photometry, self.up(), &mounting, scene.units.efficacy());
            let name = file.file_stem().map_or(String::new(), |name| name.to_string_lossy().into_owned());
            scene.lights.list.push(Light::new(&name, LightKind::Point(light)));
        }
        let Some(sky) = &self.sky else {
            let needless = matches!(self.sun, Some(SunArg { irradiance: None, .. })) || self.place.is_some();
            return match needless && scene.lights.sky.is_none() {
                true => Err(Error::Usage {
                    message: "the position of the sun has no effect: it has no irradiance, and no sky needs it"
                        .into(),
                    hint: Some(
                        "add its irradiance in W/m2, as in --sun 220,40,800, or a sky, as in --sky perez:700,120"
                            .into(),
                    ),
                }),
                false => Ok(()),
            };
        };
        let double = matches!(self.sun, Some(SunArg { irradiance: Some(_), .. }))
            .then_some("--sun")
            .or(of_file.is_some_and(|sun| sun.shines).then_some("the [[sun]] of the light file"));
        if let (SkyArg::Perez(_), Some(other)) = (sky, double) {
            return Err(Error::Usage {
                message: format!(
                    "--sky perez has the direct irradiance of the sun, so {other} must not have an irradiance"
                ),
                hint: Some("give azimuth and altitude alone".into()),
            });
        }
        let sky = self.make_sky(sky, scene, sun.or(of_file.map(|sun: SunInFile| sun.at)))?;
        scene.lights.sky = Some(sky);
        Ok(())
    }

    /// The sky of the options. Adds its image to the files of the scene, and the sun of an all-weather sky to the
    /// lights.
    fn make_sky(&self, sky: &SkyArg, scene: &mut Scene, sun: Option<SunAt>) -> RadiosityResult<Sky> {
        let up = self.up();
        if self.sky_rotation.is_some() && !matches!(sky, SkyArg::Image(..)) {
            return Err(Error::Usage {
                message: "--sky-rotation needs an image as the sky".into(),
                hint: Some("leave it out".into()),
            });
        }
        let sun = |kind: &str| {
            sun.ok_or_else(|| Error::Usage {
                message: format!("--sky {kind} needs the position of the sun"),
                hint: Some("add --sun AZIMUTH,ALTITUDE, or --place LAT,LON --at TIME".into()),
            })
        };
        Ok(match sky {
            SkyArg::Uniform(radiance) => Sky::uniform(up, [*radiance; 3]),
            SkyArg::Overcast(e) => Sky::with_irradiance(SkyModel::Overcast, up, [*e; 3]),
            SkyArg::Clear(e) => Sky::with_irradiance(SkyModel::Clear(sun("clear")?.0), up, [*e; 3]),
            SkyArg::Intermediate(e) => {
                Sky::with_irradiance(SkyModel::Intermediate(sun("intermediate")?.0), up, [*e; 3])
            }
            SkyArg::Perez(of) => {
                let (towards, eccentricity) = sun("perez")?;
                add_sun(scene, towards, of[0]);
                Sky::all_weather(up, *of, towards, eccentricity * scene.units.extraterrestrial())
            }
            SkyArg::Image(file, strength) => {
                let image = SkyImage::load(file)?;
                scene.files.push(file.clone());
                let rotation = self.sky_rotation.unwrap_or_default().to_radians();
                Sky::image(image.turned(rotation), up, *strength)
            }
        })
    }
}

fn add_sun(scene: &mut Scene, towards: DVec3, irradiance: f64) {
    let sun = Distant::new(towards, [irradiance; 3], SUN_DIAMETER.to_radians());
    scene.lights.list.push(Light::new(SUN, LightKind::Distant(sun)));
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
        assert_eq!("perez:700,120".parse(), Ok(SkyArg::Perez([700.0, 120.0])));
        assert_eq!("a/b:c.HDR".parse(), Ok(SkyArg::Image("a/b:c.HDR".into(), 1.0)));
        assert_eq!("sky.exr:2.5".parse(), Ok(SkyArg::Image("sky.exr".into(), 2.5)));
        assert!("sky.exr:x".parse::<SkyArg>().is_err() && "perez:1".parse::<SkyArg>().is_err());
        for wrong in ["", "uniform", "uniform:", "uniform:-1", "overcast:x", "blue:3", "clear:nan"] {
            assert!(wrong.parse::<SkyArg>().is_err(), "{wrong}");
        }
    }
}
