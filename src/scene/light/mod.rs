//! Lights that are not surfaces: sun, sky, points, spots and luminaires.
//!
//! They belong to the scene. A [`Distant`] light is given by the irradiance on a plane that faces it, a [`PointLight`]
//! by its intensity in every direction, and a [`Sky`] by its radiance in every direction. Positions are in the unit of
//! the file. Directions point from the scene to the light.

mod cie;
mod distant;
mod eulumdat;
pub mod file;
mod ies;
mod image;
mod luminaire;
mod measured;
mod perez;
mod photometry;
mod place;
mod point;
mod sky;
mod units;
mod weather;
mod web;

use glam::DVec3;

pub use distant::{Distant, SUN_DIAMETER};
pub(crate) use image::Cell;
pub use image::SkyImage;
pub use luminaire::{Mounting, luminaire};
pub use measured::{Goniometer, Opening};
pub use perez::{Perez, SOLAR_CONSTANT, SOLAR_ILLUMINANCE, luminous_efficacy};
pub use photometry::Photometry;
pub use place::{Moment, Place};
pub use point::{Area, Distribution, PointLight};
pub use sky::{Sky, SkyModel};
pub use units::{LUMINOUS_EFFICACY, UnitNames, Units};
pub use weather::{Hour, POSITIONS, Weather};
pub use web::Web;

/// The axis that points up. It defines the frame of azimuths and altitudes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Up {
    /// y is up, north is −z, east is +x.
    #[default]
    Y,
    /// z is up, north is +y, east is +x.
    Z,
}

impl Up {
    /// Makes a direction of the scene from its components towards east, north and up.
    pub fn to_scene(self, [east, north, up]: [f64; 3]) -> DVec3 {
        match self {
            Up::Y => DVec3::new(east, up, -north),
            Up::Z => DVec3::new(east, north, up),
        }
    }

    /// The components of a direction of the scene towards east, north and up.
    pub fn of_scene(self, direction: DVec3) -> [f64; 3] {
        match self {
            Up::Y => [direction.x, -direction.z, direction.y],
            Up::Z => direction.to_array(),
        }
    }

    /// The unit vector at this azimuth, in radians clockwise from north as seen from above, and this altitude above the
    /// horizon.
    pub fn direction(self, azimuth: f64, altitude: f64) -> DVec3 {
        let (sin, cos) = azimuth.sin_cos();
        let level = altitude.cos();
        self.to_scene([sin * level, cos * level, altitude.sin()])
    }
}

/// A light with its name.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Light {
    /// The name, for messages and for choosing lights. Names need not be unique.
    pub name: String,
    /// The kind of light, with its data.
    pub kind: LightKind,
}

impl Light {
    /// Makes a light of this name.
    pub fn new(name: &str, kind: LightKind) -> Light {
        Light { name: name.into(), kind }
    }
}

/// The kinds of lights that are seen in one direction from any place.
#[derive(Debug, Clone, PartialEq)]
pub enum LightKind {
    /// A light so far away that its direction is the same everywhere.
    Distant(Distant),
    /// A light at a point of the scene.
    Point(PointLight),
}

impl LightKind {
    /// R G B of the light: the irradiance on a plane that faces a distant light, or the intensity of a light at a
    /// point.
    pub fn colour(&self) -> [f64; 3] {
        match self {
            LightKind::Distant(distant) => distant.irradiance,
            LightKind::Point(point) => point.intensity,
        }
    }
}

/// A group of lights that are not surfaces. Each group can be dimmed by itself in a page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum LightGroup {
    /// Sun and other distant lights.
    Distant,
    /// Points, spots and luminaires.
    Points,
    /// The sky.
    Sky,
}

/// The name of the sky among [`Lights::names`].
pub const SKY: &str = "sky";

/// All lights of a scene that are not surfaces.
#[derive(Debug, Clone, Default, PartialEq)]
#[non_exhaustive]
pub struct Lights {
    /// Distant lights and lights at points.
    pub list: Vec<Light>,
    /// The sky.
    pub sky: Option<Sky>,
}

impl Lights {
    /// Whether there are no lights.
    pub fn is_empty(&self) -> bool {
        self.list.is_empty() && self.sky.is_none()
    }

    /// The names of all lights. The sky has the name [`SKY`].
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.list.iter().map(|light| &light.name[..]).chain(self.sky.as_ref().map(|_| SKY))
    }

    /// Whether a light of this name is in a group.
    pub(crate) fn is_in(&self, group: LightGroup, name: &str) -> bool {
        let is_point = |light: &Light| matches!(light.kind, LightKind::Point(_));
        let of_list = |points: bool| self.list.iter().any(|l| l.name == name && is_point(l) == points);
        match group {
            LightGroup::Distant => of_list(false),
            LightGroup::Points => of_list(true),
            LightGroup::Sky => name == SKY,
        }
    }

    /// The groups of these lights, each with its name: the name of the only light in it, or their number.
    pub(crate) fn groups(&self) -> Vec<(LightGroup, String)> {
        let of_list = |group: LightGroup, plural: &str| {
            let is_of =
                |light: &&Light| matches!(light.kind, LightKind::Point(_)) == (group == LightGroup::Points);
            let names: Vec<&str> = self.list.iter().filter(is_of).map(|light| &light.name[..]).collect();
            match names[..] {
                [] => None,
                [name] => Some((group, name.to_owned())),
                _ => Some((group, format!("{} {plural}", names.len()))),
            }
        };
        let groups = [
            of_list(LightGroup::Distant, "distant lights"),
            of_list(LightGroup::Points, "points and luminaires"),
            self.sky.as_ref().map(|_| (LightGroup::Sky, SKY.to_owned())),
        ];
        groups.into_iter().flatten().collect()
    }

    /// Keeps only the lights for whose names `keep` returns true.
    pub fn retain(&mut self, keep: impl Fn(&str) -> bool) {
        self.list.retain(|light| keep(&light.name));
        self.sky = self.sky.take().filter(|_| keep(SKY));
    }

    /// The radiance, R G B, W/(m² sr), of the sky and of distant discs in a direction of any length.
    pub fn seen(&self, direction: DVec3) -> [f64; 3] {
        if self.is_empty() {
            return [0.0; 3];
        }
        let Some(direction) = crate::scene::direction(direction) else { return [0.0; 3] };
        let mut seen = self.sky.as_ref().map_or(DVec3::ZERO, |sky| sky.radiance(direction).into());
        for light in &self.list {
            match &light.kind {
                LightKind::Distant(distant) if distant.contains(direction) => {
                    seen += DVec3::from(distant.radiance());
                }
                _ => {}
            }
        }
        seen.to_array()
    }

    /// Whether any light may be too small for hemisphere rays to hit. This holds for all lights but the sky, and for
    /// images of the sky.
    pub(crate) fn need_shadow_rays(&self) -> bool {
        !self.list.is_empty() || self.sky.as_ref().is_some_and(|sky| sky.as_image().is_some())
    }

    /// Whether all lights have three equal channels.
    pub fn is_grey(&self) -> bool {
        let grey = |c: [f64; 3]| c[0] == c[1] && c[1] == c[2];
        self.list.iter().all(|light| grey(light.kind.colour())) && self.sky.as_ref().is_none_or(Sky::is_grey)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

    /// Azimuths run clockwise from north as seen from above. On the northern hemisphere, the sun is in the south at
    /// noon and in the east in the morning.
    #[test]
    fn azimuths_run_from_north_over_east() {
        for (up, north, east, zenith) in
            [(Up::Y, -DVec3::Z, DVec3::X, DVec3::Y), (Up::Z, DVec3::Y, DVec3::X, DVec3::Z)]
        {
            let close = |a: DVec3, b: DVec3| assert!((a - b).length() < 1e-15, "{a} {b}");
            close(up.direction(0.0, 0.0), north);
            close(up.direction(FRAC_PI_2, 0.0), east);
            close(up.direction(2.0 * FRAC_PI_2, 0.0), -north);
            close(up.direction(3.0 * FRAC_PI_2, 0.0), -east);
            close(up.direction(1.0, FRAC_PI_2), zenith);
            close(up.direction(FRAC_PI_2, FRAC_PI_4), (east + zenith) * 0.5f64.sqrt());
            // Seen from above, east is a quarter turn clockwise from north.
            close(north.cross(zenith), east);
            let direction = up.direction(0.7, 0.4);
            close(up.to_scene(up.of_scene(direction)), direction);
        }
    }
}
