//! Light files: `lights.toml`.
//!
//! A file has tables `[[sun]]`, `[[directional]]`, `[[point]]`, `[[spot]]`, `[[luminaire]]` and at most one `[sky]`. A
//! colour is one number, or three numbers for red, green and blue. Angles are in degrees. docs/lights.md shows a file.

use std::{
    ops::Range,
    path::{Path, PathBuf},
};

use glam::DVec3;
use serde::Deserialize;
use toml::Spanned;

use super::{
    Distant, Distribution, Light, LightKind, Moment, Mounting, Photometry, Place, PointLight, SUN_DIAMETER,
    Sky, SkyImage, SkyModel, Units, Up, luminaire,
};
use crate::{
    Error, Result,
    scene::{
        MOST_RADIANCE, Scene, direction, is_radiance,
        text::{line_of, read_utf8},
    },
};

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(untagged, expecting = "expected a number, or three numbers in brackets")]
enum Colour {
    Grey(f64),
    Rgb([f64; 3]),
}

impl Colour {
    fn rgb(self) -> [f64; 3] {
        match self {
            Colour::Grey(x) => [x; 3],
            Colour::Rgb(rgb) => rgb,
        }
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileTable {
    up: Option<UpName>,
    sky: Option<Spanned<SkyTable>>,
    #[serde(default)]
    sun: Vec<Spanned<SunTable>>,
    #[serde(default)]
    directional: Vec<Spanned<DirectionalTable>>,
    #[serde(default)]
    point: Vec<Spanned<PointTable>>,
    #[serde(default)]
    spot: Vec<Spanned<SpotTable>>,
    #[serde(default)]
    luminaire: Vec<Spanned<LuminaireTable>>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum UpName {
    Y,
    Z,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SunTable {
    name: Option<String>,
    azimuth: Option<f64>,
    altitude: Option<f64>,
    place: Option<[f64; 2]>,
    at: Option<String>,
    irradiance: Option<Colour>,
    diameter: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SkyTable {
    kind: SkyKind,
    radiance: Option<f64>,
    irradiance: Option<f64>,
    direct: Option<f64>,
    diffuse: Option<f64>,
    file: Option<PathBuf>,
    strength: Option<f64>,
    rotation: Option<f64>,
    colour: Option<[f64; 3]>,
}

#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum SkyKind {
    Uniform,
    Overcast,
    Clear,
    Intermediate,
    Perez,
    Image,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct DirectionalTable {
    name: Option<String>,
    direction: [f64; 3],
    irradiance: Colour,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct PointTable {
    name: Option<String>,
    position: [f64; 3],
    intensity: Colour,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SpotTable {
    name: Option<String>,
    position: [f64; 3],
    direction: [f64; 3],
    intensity: Colour,
    inner: Option<f64>,
    outer: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct LuminaireTable {
    name: Option<String>,
    file: PathBuf,
    position: [f64; 3],
    direction: Option<[f64; 3]>,
    #[serde(default)]
    rotation: f64,
    dimming: Option<f64>,
    colour: Option<[f64; 3]>,
}

/// The direction to the sun, and the factor of the solar constant on that day.
pub type SunAt = (DVec3, f64);

/// The position of the sun at a place and a time.
///
/// # Errors
/// A sentence, when the sun is below the horizon or its position cannot be computed.
pub fn sun_at(up: Up, place: Place, at: &Moment) -> std::result::Result<SunAt, String> {
    let (azimuth, altitude) = at.sun(place).ok_or("the position of the sun cannot be computed")?;
    if altitude <= 0.0 {
        return Err(format!(
            "the sun is {:.1} degrees below the horizon at that time",
            -altitude.to_degrees()
        ));
    }
    Ok((up.direction(azimuth, altitude), at.eccentricity()))
}

/// The first sun of a light file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SunInFile {
    /// Its position.
    pub at: SunAt,
    /// Whether the file gives a sun an irradiance. Otherwise suns are only positions for the sky.
    pub shines: bool,
}

/// Reads a light file in the units of the scene, and adds its lights to the scene. `up` takes precedence over the
/// file's own setting. Returns its first sun, if it has one.
///
/// # Errors
/// [`Error::Io`] when a file cannot be read. [`Error::Input`], with the line, when its contents cannot be used.
pub fn add(scene: &mut Scene, path: &Path, up: Option<Up>) -> Result<Option<SunInFile>> {
    let text = read_utf8(path)?;
    let wrong = |span: Option<Range<usize>>, message: String| {
        let line = span.map(|span| line_of(text.as_bytes(), span.start));
        Error::input(path, line, message)
    };
    let table: FileTable =
        toml::from_str(&text).map_err(|e| wrong(e.span(), e.message().trim().replace('\n', " ")))?;
    scene.files.push(path.to_owned());
    let up = up.unwrap_or(match table.up {
        Some(UpName::Z) => Up::Z,
        _ => Up::Y,
    });
    let folder = path.parent().unwrap_or(Path::new(""));
    let units = scene.units;
    let mut reader = Reader { scene, up, units, folder, sun: None, shines: false };
    reader.all(table.sun, Reader::sun, &wrong)?;
    reader.all(table.directional, Reader::directional, &wrong)?;
    reader.all(table.point, Reader::point, &wrong)?;
    reader.all(table.spot, Reader::spot, &wrong)?;
    reader.all(table.luminaire, Reader::luminaire, &wrong)?;
    reader.all(table.sky, Reader::sky, &wrong)?;
    Ok(reader.sun.map(|at| SunInFile { at, shines: reader.shines }))
}

/// An error in a table, or in a file that the table names.
enum Fault {
    Here(String),
    Elsewhere(Error),
}

impl Fault {
    fn located(self, wrong: &impl Fn(Option<Range<usize>>, String) -> Error, span: Range<usize>) -> Error {
        match self {
            Fault::Here(message) => wrong(Some(span), message),
            Fault::Elsewhere(error) => error,
        }
    }
}

impl From<&str> for Fault {
    fn from(message: &str) -> Fault {
        Fault::Here(message.into())
    }
}

impl From<String> for Fault {
    fn from(message: String) -> Fault {
        Fault::Here(message)
    }
}

impl From<Error> for Fault {
    fn from(error: Error) -> Fault {
        Fault::Elsewhere(error)
    }
}

type Read<T> = std::result::Result<T, Fault>;

struct Reader<'a> {
    scene: &'a mut Scene,
    up: Up,
    units: Units,
    folder: &'a Path,
    sun: Option<SunAt>,
    /// Whether a sun of the file has an irradiance.
    shines: bool,
}

/// R G B of a colour.
fn strength(colour: Colour, what: &str) -> Read<[f64; 3]> {
    let rgb = colour.rgb();
    if rgb.into_iter().all(is_radiance) { Ok(rgb) } else { Err(not_in_range(what)) }
}

fn not_in_range(what: &str) -> Fault {
    Fault::Here(format!("{what} must be a number from 0 to {MOST_RADIANCE:e}"))
}

fn number(value: Option<f64>, what: &str) -> Read<f64> {
    match value {
        Some(x) if is_radiance(x) => Ok(x),
        Some(_) => Err(not_in_range(what)),
        None => Err(format!("{what} is missing").into()),
    }
}

fn place(values: [f64; 3], what: &str) -> Read<DVec3> {
    let good = values.into_iter().all(|x| x.is_finite() && x.abs() < 1e30);
    if good { Ok(DVec3::from(values)) } else { Err(format!("{what} must be three finite numbers").into()) }
}

fn axis(values: [f64; 3]) -> Read<DVec3> {
    let finite = DVec3::from(values).is_finite() && values != [0.0; 3];
    match direction(DVec3::from(values)) {
        Some(axis) if finite => Ok(axis),
        _ => Err("the direction has no length".into()),
    }
}

fn within(value: f64, range: std::ops::RangeInclusive<f64>, what: &str) -> Read<f64> {
    match range.contains(&value) {
        true => Ok(value),
        false => Err(format!("{what} must be between {} and {} degrees", range.start(), range.end()).into()),
    }
}

impl Reader<'_> {
    /// Reads tables of one kind. An error has the line of its table.
    fn all<T>(
        &mut self,
        tables: impl IntoIterator<Item = Spanned<T>>,
        read: impl Fn(&mut Self, T) -> Read<()>,
        wrong: &impl Fn(Option<Range<usize>>, String) -> Error,
    ) -> Result<()> {
        tables.into_iter().try_for_each(|table| {
            let span = table.span();
            read(self, table.into_inner()).map_err(|fault| fault.located(wrong, span))
        })
    }

    fn push(&mut self, name: Option<String>, kind: &str, light: LightKind) {
        self.scene.lights.list.push(Light { name: name.unwrap_or_else(|| kind.into()), kind: light });
    }

    fn sun(&mut self, table: SunTable) -> Read<()> {
        let at = match (table.azimuth, table.altitude, table.place, &table.at) {
            (Some(azimuth), Some(altitude), None, None) => {
                let altitude = within(altitude, 0.0..=90.0, "the altitude")?;
                let azimuth = within(azimuth, -360.0..=360.0, "the azimuth")?;
                (self.up.direction(azimuth.to_radians(), altitude.to_radians()), 1.0)
            }
            (None, None, Some([latitude, longitude]), Some(at)) => {
                let latitude = within(latitude, -90.0..=90.0, "the latitude")?;
                let longitude = within(longitude, -180.0..=180.0, "the longitude")?;
                sun_at(self.up, Place { latitude, longitude }, &at.parse()?)?
            }
            _ => return Err("a sun needs azimuth and altitude, or place and at".into()),
        };
        self.sun.get_or_insert(at);
        if let Some(irradiance) = table.irradiance {
            let irradiance = strength(irradiance, "the irradiance")?;
            let diameter = within(table.diameter.unwrap_or(SUN_DIAMETER), 0.0..=90.0, "the diameter")?;
            let sun = Distant::new(at.0, irradiance, diameter.to_radians());
            self.push(table.name, "sun", LightKind::Distant(sun));
            self.shines = true;
        }
        Ok(())
    }

    fn directional(&mut self, table: DirectionalTable) -> Read<()> {
        // The file gives the direction in which the light shines.
        let towards = -axis(table.direction)?;
        let light = Distant::new(towards, strength(table.irradiance, "the irradiance")?, 0.0);
        self.push(table.name, "directional", LightKind::Distant(light));
        Ok(())
    }

    fn point(&mut self, table: PointTable) -> Read<()> {
        let position = place(table.position, "the position")?;
        let light = PointLight::isotropic(position, strength(table.intensity, "the intensity")?);
        self.push(table.name, "point", LightKind::Point(light));
        Ok(())
    }

    fn spot(&mut self, table: SpotTable) -> Read<()> {
        let outer = within(table.outer.unwrap_or(45.0), 0.0..=90.0, "the outer angle")?;
        let inner = within(table.inner.unwrap_or(0.0), 0.0..=90.0, "the inner angle")?;
        if inner > outer || outer == 0.0 {
            return Err(
                "the inner angle of a spot must be at most its outer angle, which must be above 0".into()
            );
        }
        let cone = Distribution::spot(axis(table.direction)?, inner.to_radians(), outer.to_radians());
        let position = place(table.position, "the position")?;
        let light = PointLight::new(position, strength(table.intensity, "the intensity")?, cone);
        self.push(table.name, "spot", LightKind::Point(light));
        Ok(())
    }

    fn luminaire(&mut self, table: LuminaireTable) -> Read<()> {
        let file = self.folder.join(&table.file);
        let photometry = Photometry::load(&file)?;
        self.scene.files.push(file);
        self.scene.warnings.extend(photometry.warnings.iter().cloned());
        let mounting = Mounting {
            position: place(table.position, "the position")?,
            aim: table.direction.map(axis).transpose()?,
            rotation: within(table.rotation, -360.0..=360.0, "the rotation")?.to_radians(),
            dimming: table.dimming.map_or(Ok(1.0), |d| number(Some(d), "the dimming"))?,
        };
        let mut light = luminaire(photometry, self.up, &mounting, self.units.efficacy());
        if let Some(colour) = table.colour {
            let colour = strength(Colour::Rgb(colour), "the colour")?;
            light.intensity = std::array::from_fn(|c| light.intensity[c] * colour[c]);
        }
        self.push(table.name, "luminaire", LightKind::Point(light));
        Ok(())
    }

    fn sky(&mut self, table: SkyTable) -> Read<()> {
        let up = self.up;
        let sun = || self.sun.ok_or("this sky needs the position of the sun: add a [[sun]]");
        let e = || number(table.irradiance, "the irradiance");
        let sky = match table.kind {
            SkyKind::Uniform => Sky::uniform(up, [number(table.radiance, "the radiance")?; 3]),
            SkyKind::Overcast => Sky::with_irradiance(SkyModel::Overcast, up, [e()?; 3]),
            SkyKind::Clear => Sky::with_irradiance(SkyModel::Clear(sun()?.0), up, [e()?; 3]),
            SkyKind::Intermediate => Sky::with_irradiance(SkyModel::Intermediate(sun()?.0), up, [e()?; 3]),
            SkyKind::Perez => {
                let of = [number(table.direct, "`direct`")?, number(table.diffuse, "`diffuse`")?];
                let (towards, eccentricity) = sun()?;
                Sky::all_weather(up, of, towards, eccentricity * self.units.extraterrestrial())
            }
            SkyKind::Image => {
                let file = self.folder.join(table.file.as_ref().ok_or("the file of the image is missing")?);
                let image = SkyImage::load(&file)?;
                self.scene.files.push(file);
                let rotation = within(table.rotation.unwrap_or(0.0), -360.0..=360.0, "the rotation")?;
                let strength = table.strength.map_or(Ok(1.0), |s| number(Some(s), "the strength"))?;
                Sky::image(image.turned(rotation.to_radians()), up, strength)
            }
        };
        let colour = table.colour.map_or(Ok([1.0; 3]), |c| strength(Colour::Rgb(c), "the colour"))?;
        self.scene.lights.sky = Some(sky.coloured(colour));
        if table.kind == SkyKind::Perez && !self.shines {
            let direct = number(table.direct, "`direct`")?;
            let sun = Distant::new(sun_of(self.sun), [direct; 3], SUN_DIAMETER.to_radians());
            self.push(None, "sun", LightKind::Distant(sun));
        }
        Ok(())
    }
}

fn sun_of(sun: Option<SunAt>) -> DVec3 {
    sun.expect("the sky has found its sun").0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Scene> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lights.toml");
        std::fs::write(&path, text).unwrap();
        let ies = "IESNA91\nTILT=NONE\n1 -1 1 2 1 1 2 0 0 0 1 1 1\n0 90\n0\n683 0\n";
        std::fs::write(folder.path().join("lamp.ies"), ies).unwrap();
        let mut scene = Scene::default();
        add(&mut scene, &path, None).map(|_| scene)
    }

    #[test]
    fn each_kind_of_light_is_read() {
        let scene = read(
            "up = \"z\"\n[[sun]]\nazimuth = 90\naltitude = 0\nirradiance = [3, 2, 1]\ndiameter = 2\n\
             [[directional]]\nname = \"d\"\ndirection = [0, 0, -2]\nirradiance = 5\n\
             [[point]]\nposition = [1, 2, 3]\nintensity = 4\n\
             [[spot]]\nposition = [1, 2, 3]\ndirection = [0, 0, -1]\nintensity = 4\ninner = 10\nouter = 20\n\
             [[luminaire]]\nfile = \"lamp.ies\"\nposition = [0, 0, 2]\ndimming = 0.5\n\
             [sky]\nkind = \"overcast\"\nirradiance = 70\ncolour = [1, 0.5, 2]\n",
        )
        .unwrap();
        let names: Vec<&str> = scene.lights.names().collect();
        assert_eq!(names, ["sun", "d", "point", "spot", "luminaire", "sky"]);
        let LightKind::Distant(sun) = &scene.lights.list[0].kind else { panic!() };
        assert!(
            (sun.direction - DVec3::X).length() < 1e-12 && (sun.radius - 1f64.to_radians()).abs() < 1e-12
        );
        assert_eq!(sun.irradiance, [3.0, 2.0, 1.0]);
        let LightKind::Distant(directional) = &scene.lights.list[1].kind else { panic!() };
        assert_eq!((directional.direction, directional.radius), (DVec3::Z, 0.0));
        let LightKind::Point(luminaire) = &scene.lights.list[4].kind else { panic!() };
        assert!((luminaire.intensity[0] - 0.5).abs() < 1e-12);
        let zenith = scene.lights.seen(DVec3::Z);
        assert!((zenith[0] - 10.0 * 9.0 / std::f64::consts::PI).abs() < 1e-9 && zenith[2] == 4.0 * zenith[1]);
        assert_eq!(scene.files.len(), 2);
    }

    /// The sun of an all-weather sky has the direct irradiance, unless the file gives the sun another irradiance.
    #[test]
    fn the_sun_of_an_all_weather_sky() {
        let sky = "[sky]\nkind = \"perez\"\ndirect = 700\ndiffuse = 120\n";
        let scene =
            read(&format!("[[sun]]\nplace = [48.1, 11.6]\nat = \"2026-06-21T12:00+02:00\"\n{sky}")).unwrap();
        let LightKind::Distant(sun) = &scene.lights.list[0].kind else { panic!() };
        assert_eq!((scene.lights.list.len(), sun.irradiance), (1, [700.0; 3]));
        assert!(sun.direction.y > 0.8 && sun.direction.x > 0.0, "{}", sun.direction);
        // Also where the sun is a point.
        for diameter in ["", "diameter = 0\n"] {
            let sun = format!("[[sun]]\nazimuth = 10\naltitude = 20\nirradiance = 5\n{diameter}");
            assert_eq!(read(&format!("{sun}{sky}")).unwrap().lights.list.len(), 1, "{diameter}");
        }
    }

    #[test]
    fn errors_name_the_line() {
        for (text, line, what) in [
            ("[[sun]]\nazimuth = 3\n", 1, "azimuth and altitude"),
            ("\n[[point]]\nposition = [0, 0]\nintensity = 1\n", 3, ""),
            ("[[point]]\nposition = [0, 0, 0]\nintensity = -1\n", 1, "a number from 0 to 1e100"),
            ("[[point]]\nposition = [0, 0, 0]\nintensity = nan\n", 1, "a number from 0 to 1e100"),
            ("\n[sky]\nkind = \"uniform\"\nradiance = inf\n", 2, "a number from 0 to 1e100"),
            ("[[point]]\nposition = [0, inf, 0]\nintensity = 1\n", 1, "three finite numbers"),
            ("[[sun]]\nazimuth = nan\naltitude = 3\nirradiance = 1\n", 1, "between -360 and 360 degrees"),
            ("[[point]]\nposition = [0, 0, 0]\nintensity = \"x\"\n", 3, "a number"),
            ("[[point]]\nposition = [0, 0, 0]\nintensity = 1\nrange = 3\n", 4, "range"),
            ("[[spot]]\nposition = [0, 0, 0]\ndirection = [0, 0, 0]\nintensity = 1\n", 1, "no length"),
            ("[sky]\nkind = \"green\"\n", 2, "green"),
            ("[sky]\nkind = \"clear\"\nirradiance = 3\n", 1, "[[sun]]"),
            ("[sky]\nkind = \"overcast\"\n", 1, "missing"),
            ("a = \n", 1, ""),
            (
                "[[sun]]\nplace = [48, 11]\nat = \"2026-06-21T00:30+02:00\"\nirradiance = 3\n",
                1,
                "below the horizon",
            ),
        ] {
            match read(text) {
                Err(Error::Input { line: Some(found), message, .. }) => {
                    assert!(found == line && message.contains(what), "{text}: {found}: {message}");
                }
                other => panic!("{text}: {other:?}"),
            }
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lights.toml");
        std::fs::write(&path, b"up = \"z\"\n# Lampe \xfcber dem Tisch\n").unwrap();
        let error = add(&mut Scene::default(), &path, None).unwrap_err();
        assert!(matches!(error, Error::Input { line: Some(2), .. }), "{error:?}");
        assert!(matches!(read("[sky]\nkind = \"image\"\nfile = \"none.hdr\"\n"), Err(Error::Io { .. })));
    }
}
