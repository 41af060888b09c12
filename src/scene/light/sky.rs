//! The sky: radiance by direction, from infinitely far away.
//!
//! Below the horizon a sky model is dark. An image covers all directions.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use super::{Cell, Perez, SkyImage, Up, cie};

/// Steps of altitude and azimuth in which the irradiance of a model is integrated.
const STEPS: usize = 512;

/// How the radiance of a sky depends on the direction.
#[derive(Debug, Clone, PartialEq)]
pub enum SkyModel {
    /// The same everywhere above the horizon.
    Uniform,
    /// CIE overcast sky: three times as bright at the zenith as at the horizon.
    Overcast,
    /// CIE clear sky with the sun in this direction.
    Clear(DVec3),
    /// CIE intermediate sky with the sun in this direction.
    Intermediate(DVec3),
    /// The all-weather sky of Perez with the sun in this direction.
    AllWeather(Perez, DVec3),
    /// An image of all directions.
    Image(SkyImage),
}

/// A sky.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Sky {
    model: SkyModel,
    up: Up,
    /// Radiance, R G B, where the model is 1.
    scale: [f64; 3],
}

impl SkyModel {
    /// Relative radiance in a direction, a unit vector; an image has a colour besides.
    fn shape(&self, up: Up, direction: DVec3) -> f64 {
        let [_, _, sin] = up.of_scene(direction);
        if sin < 0.0 {
            return 0.0;
        }
        match self {
            SkyModel::Uniform => 1.0,
            SkyModel::Overcast => cie::overcast(sin),
            SkyModel::Clear(sun) => cie::clear(sin, direction.dot(*sun)),
            SkyModel::Intermediate(sun) => cie::intermediate(sin, direction.dot(*sun), up.of_scene(*sun)[2]),
            SkyModel::AllWeather(perez, sun) => perez.shape(sin, direction.dot(*sun)),
            SkyModel::Image(_) => 1.0,
        }
    }

    /// The irradiance of an unobstructed horizontal plane where the relative radiance is in W/(m² sr).
    fn horizontal(&self, up: Up) -> f64 {
        match self {
            SkyModel::Uniform => PI,
            SkyModel::Overcast => 7.0 * PI / 9.0,
            _ => {
                // Equal steps of sin², in which the cosine of a level plane is even, and of azimuth.
                let step = |k: usize| (k as f64 + 0.5) / STEPS as f64;
                let row = |i: usize| {
                    let altitude = step(i).sqrt().asin();
                    let at = |j: usize| self.shape(up, up.direction(TAU * step(j), altitude));
                    (0..STEPS).map(at).sum::<f64>()
                };
                PI * (0..STEPS).map(row).sum::<f64>() / (STEPS * STEPS) as f64
            }
        }
    }
}

impl Sky {
    /// A sky of this radiance, W/(m² sr), everywhere above the horizon.
    pub fn uniform(up: Up, radiance: [f64; 3]) -> Sky {
        Sky { model: SkyModel::Uniform, up, scale: radiance }
    }

    /// A sky that sends this irradiance, W/m², to an unobstructed horizontal plane.
    pub fn with_irradiance(model: SkyModel, up: Up, irradiance: [f64; 3]) -> Sky {
        let whole = model.horizontal(up);
        Sky { model, up, scale: irradiance.map(|e| e / whole) }
    }

    /// The all-weather sky of Perez: of direct normal and diffuse horizontal irradiance in W/m², with the sun in the direction
    /// `towards`, whose irradiance outside the atmosphere is `extraterrestrial`. The sun itself is no part of it.
    pub fn all_weather(up: Up, [direct, diffuse]: [f64; 2], towards: DVec3, extraterrestrial: f64) -> Sky {
        let altitude = up.of_scene(towards)[2].clamp(-1.0, 1.0).asin();
        let perez = Perez::new(direct, diffuse, altitude, extraterrestrial);
        Sky::with_irradiance(SkyModel::AllWeather(perez, towards), up, [diffuse; 3])
    }

    /// A sky with the radiance that the model has by itself.
    pub fn relative(model: SkyModel, up: Up) -> Sky {
        Sky { model, up, scale: [1.0; 3] }
    }

    /// An image times a factor.
    pub fn image(image: SkyImage, up: Up, strength: f64) -> Sky {
        Sky { model: SkyModel::Image(image), up, scale: [strength; 3] }
    }

    /// The same with each channel times a factor.
    pub fn coloured(self, colour: [f64; 3]) -> Sky {
        Sky { scale: std::array::from_fn(|c| self.scale[c] * colour[c]), ..self }
    }

    /// The image, if it is one.
    pub(crate) fn as_image(&self) -> Option<&SkyImage> {
        match &self.model {
            SkyModel::Image(image) => Some(image),
            _ => None,
        }
    }

    /// Parts of an image that are much brighter than the rest, with their radiance, and the sky without them.
    pub(crate) fn split(&self) -> (Vec<(Cell, [f64; 3])>, Sky) {
        let Some(image) = self.as_image() else { return (Vec::new(), self.clone()) };
        let (mut cells, dim) = image.split(self.up);
        for (_, radiance) in &mut cells {
            *radiance = std::array::from_fn(|c| self.scale[c] * radiance[c]);
        }
        (cells, Sky { model: SkyModel::Image(dim), ..*self })
    }

    /// A direction into an image, chosen by its radiance, and its density.
    pub(crate) fn sample_image(&self, at: [f64; 2]) -> Option<(DVec3, f64)> {
        self.as_image().map(|image| image.sample(self.up, at))
    }

    /// The density of [`Sky::sample_image`] in a direction.
    pub(crate) fn density_of_image(&self, direction: DVec3) -> Option<f64> {
        self.as_image().map(|image| image.density(self.up, direction))
    }

    /// The model.
    pub fn model(&self) -> &SkyModel {
        &self.model
    }

    /// Which axis is up.
    pub fn up(&self) -> Up {
        self.up
    }

    /// Radiance in a direction, a unit vector, R G B, W/(m² sr).
    pub fn radiance(&self, direction: DVec3) -> [f64; 3] {
        if let SkyModel::Image(image) = &self.model {
            let radiance = image.radiance(self.up, direction);
            return std::array::from_fn(|c| self.scale[c] * radiance[c]);
        }
        let shape = self.model.shape(self.up, direction);
        self.scale.map(|scale| scale * shape)
    }

    /// About its largest radiance, R G B.
    pub(crate) fn strongest(&self) -> [f64; 3] {
        match &self.model {
            SkyModel::Image(image) => {
                let brightest = image.brightest();
                std::array::from_fn(|c| self.scale[c] * brightest[c])
            }
            _ => self.scale,
        }
    }

    /// Whether all channels are alike.
    pub fn is_grey(&self) -> bool {
        let of_model = self.as_image().is_none_or(SkyImage::is_grey);
        of_model && self.scale[0] == self.scale[1] && self.scale[1] == self.scale[2]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The irradiance of a plane with this normal by a midpoint rule over azimuth and the sine of altitude.
    fn irradiance(sky: &Sky, normal: DVec3) -> f64 {
        let many = 1000;
        let step = |k: usize| (k as f64 + 0.5) / many as f64;
        let mut sum = 0.0;
        for (i, j) in (0..many).flat_map(|i| (0..many).map(move |j| (i, j))) {
            let direction = sky.up.direction(TAU * step(i), (2.0 * step(j) - 1.0).asin());
            sum += sky.radiance(direction)[0] * direction.dot(normal).max(0.0);
        }
        sum * 4.0 * PI / (many * many) as f64
    }

    /// Uniform: π L on a horizontal and half of it on a vertical plane. Overcast: 7π/9 and π/6 + 4/9 times the zenith's radiance.
    #[test]
    fn closed_forms_of_uniform_and_overcast_sky() {
        for up in [Up::Y, Up::Z] {
            let zenith = up.to_scene([0.0, 0.0, 1.0]);
            let wall = up.to_scene([0.6, 0.8, 0.0]);
            let uniform = Sky::uniform(up, [2.0; 3]);
            assert!((irradiance(&uniform, zenith) - 2.0 * PI).abs() < 1e-4);
            assert!((irradiance(&uniform, wall) - PI).abs() < 1e-4);
            let overcast = Sky::with_irradiance(SkyModel::Overcast, up, [100.0; 3]);
            let of_zenith = overcast.radiance(zenith)[0];
            // gensky -B 100 gives the same.
            assert!((of_zenith - 900.0 / (7.0 * PI)).abs() < 1e-12 && (of_zenith - 40.93).abs() < 5e-3);
            assert!((irradiance(&overcast, zenith) - 100.0).abs() < 1e-2);
            let wanted = of_zenith * (PI / 6.0 + 4.0 / 9.0);
            assert!((irradiance(&overcast, wall) / wanted - 1.0).abs() < 1e-4);
            assert_eq!(irradiance(&overcast, -zenith), 0.0);
        }
    }

    /// Skies with a sun have the irradiance that is asked for, and are brightest around it.
    #[test]
    fn skies_with_a_sun_have_their_irradiance() {
        for up in [Up::Y, Up::Z] {
            let sun = up.direction(2.5, 0.6);
            let perez = Perez::new(600.0, 80.0, 0.6, super::super::SOLAR_CONSTANT);
            for model in [SkyModel::Clear(sun), SkyModel::Intermediate(sun), SkyModel::AllWeather(perez, sun)]
            {
                let sky = Sky::with_irradiance(model, up, [80.0; 3]);
                let zenith = up.to_scene([0.0, 0.0, 1.0]);
                assert!((irradiance(&sky, zenith) / 80.0 - 1.0).abs() < 1e-3);
                let away = up.direction(2.5 + PI, 0.6);
                assert!(sky.radiance(sun)[0] > 3.0 * sky.radiance(away)[0]);
                assert_eq!(sky.radiance(-zenith), [0.0; 3]);
            }
        }
    }
}
