//! The sky: radiance by direction, from infinitely far away.
//!
//! A sky model is dark below the horizon. An image covers all directions.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::DVec3;

use super::{Cell, Perez, SkyImage, Up, cie};

/// Number of steps of altitude and of azimuth for the irradiance of a model.
const STEPS: usize = 512;

/// The radiance of a sky as a function of the direction.
#[derive(Debug, Clone, PartialEq)]
pub enum SkyModel {
    /// The same everywhere above the horizon.
    Uniform,
    /// The CIE overcast sky: three times as bright at the zenith as at the horizon.
    Overcast,
    /// The CIE clear sky with the sun in this direction.
    Clear(DVec3),
    /// The CIE intermediate sky with the sun in this direction.
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
    /// Radiance, R G B, in directions where the model is 1.
    scale: [f64; 3],
}

impl SkyModel {
    /// Relative radiance in a direction, a unit vector. It is 1 for an image, whose texels hold the radiance.
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

    /// The direction to the sun, if the sky depends on it.
    fn sun(&self) -> Option<DVec3> {
        match self {
            SkyModel::Clear(sun) | SkyModel::Intermediate(sun) | SkyModel::AllWeather(_, sun) => Some(*sun),
            SkyModel::Uniform | SkyModel::Overcast | SkyModel::Image(_) => None,
        }
    }

    /// About the largest relative radiance: the largest at the sun and at directions some degrees apart.
    fn largest(&self, up: Up) -> f64 {
        const ROWS: usize = 24;
        let Some(sun) = self.sun() else { return 1.0 };
        let at = |k: usize| {
            let [row, column] = [k / (4 * ROWS), k % (4 * ROWS)].map(|k| k as f64 / ROWS as f64);
            up.direction(FRAC_PI_2 * column, FRAC_PI_2 * row)
        };
        let directions = (0..4 * ROWS * (ROWS + 1)).map(at).chain([sun]);
        directions.map(|direction| self.shape(up, direction)).fold(0.0, f64::max)
    }

    /// The irradiance of an unobstructed horizontal plane, W/m², if the relative radiance is in W/(m² sr).
    fn horizontal(&self, up: Up) -> f64 {
        match self {
            SkyModel::Uniform => PI,
            SkyModel::Overcast => 7.0 * PI / 9.0,
            _ => {
                // Equal steps of sin² of the altitude and of azimuth have equal projected solid angles on a level
                // plane.
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
    /// Makes a sky with this radiance, W/(m² sr), everywhere above the horizon.
    pub fn uniform(up: Up, radiance: [f64; 3]) -> Sky {
        Sky { model: SkyModel::Uniform, up, scale: radiance }
    }

    /// Makes a sky that gives an unobstructed horizontal plane this irradiance, W/m².
    pub fn with_irradiance(model: SkyModel, up: Up, irradiance: [f64; 3]) -> Sky {
        let whole = model.horizontal(up);
        Sky { model, up, scale: irradiance.map(|e| e / whole) }
    }

    /// Makes the all-weather sky of Perez from the direct normal and the diffuse horizontal irradiance in W/m².
    /// `towards` is the direction to the sun, and `extraterrestrial` the irradiance of the sun outside the atmosphere.
    /// The sun itself is not part of the sky.
    pub fn all_weather(up: Up, [direct, diffuse]: [f64; 2], towards: DVec3, extraterrestrial: f64) -> Sky {
        let altitude = up.of_scene(towards)[2].clamp(-1.0, 1.0).asin();
        let perez = Perez::new(direct, diffuse, altitude, extraterrestrial);
        Sky::with_irradiance(SkyModel::AllWeather(perez, towards), up, [diffuse; 3])
    }

    /// Makes a sky with the relative radiance of its model.
    pub fn relative(model: SkyModel, up: Up) -> Sky {
        Sky { model, up, scale: [1.0; 3] }
    }

    /// Makes a sky from an image whose radiance is multiplied by `strength`.
    pub fn image(image: SkyImage, up: Up, strength: f64) -> Sky {
        Sky { model: SkyModel::Image(image), up, scale: [strength; 3] }
    }

    /// Multiplies each channel by a factor.
    pub fn coloured(self, colour: [f64; 3]) -> Sky {
        Sky { scale: std::array::from_fn(|c| self.scale[c] * colour[c]), ..self }
    }

    /// The image, if the sky is an image.
    pub(crate) fn as_image(&self) -> Option<&SkyImage> {
        match &self.model {
            SkyModel::Image(image) => Some(image),
            _ => None,
        }
    }

    /// Splits off the parts of an image that are much brighter than the rest. Returns them with their radiance, and the
    /// sky without them.
    pub(crate) fn split(&self) -> (Vec<(Cell, [f64; 3])>, Sky) {
        let Some(image) = self.as_image() else { return (Vec::new(), self.clone()) };
        let (mut cells, dim) = image.split(self.up);
        for (_, radiance) in &mut cells {
            *radiance = std::array::from_fn(|c| self.scale[c] * radiance[c]);
        }
        (cells, Sky { model: SkyModel::Image(dim), ..*self })
    }

    /// Samples a direction by the radiance of an image. Returns it with its density, 1/sr.
    pub(crate) fn sample_image(&self, at: [f64; 2]) -> Option<(DVec3, f64)> {
        self.as_image().map(|image| image.sample(self.up, at))
    }

    /// The density of [`Sky::sample_image`] in a direction, 1/sr.
    pub(crate) fn density_of_image(&self, direction: DVec3) -> Option<f64> {
        self.as_image().map(|image| image.density(self.up, direction))
    }

    /// The model of the sky.
    pub fn model(&self) -> &SkyModel {
        &self.model
    }

    /// The axis that points up.
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

    /// About the largest radiance, R G B: of a model, or of the brightest texel of an image.
    pub(crate) fn strongest(&self) -> [f64; 3] {
        match &self.model {
            SkyModel::Image(image) => {
                let brightest = image.brightest();
                std::array::from_fn(|c| self.scale[c] * brightest[c])
            }
            model => self.scale.map(|scale| scale * model.largest(self.up)),
        }
    }

    /// Whether all channels are equal.
    pub fn is_grey(&self) -> bool {
        let of_model = self.as_image().is_none_or(SkyImage::is_grey);
        of_model && self.scale[0] == self.scale[1] && self.scale[1] == self.scale[2]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The irradiance of a plane with this normal, by a midpoint rule over azimuth and the sine of altitude.
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

    /// A uniform sky gives π L on a horizontal plane and half of it on a vertical plane. An overcast sky gives 7π/9 and
    /// π/6 + 4/9 times the radiance of the zenith.
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

    /// Skies with a sun have the requested irradiance, and are brightest around the sun.
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
                // No direction is more than 2 % brighter than the largest radiance, which some direction has.
                let largest = sky.strongest()[0];
                let step = |k: usize| (k as f64 + 0.5) / 300.0;
                let seen = (0..300 * 300)
                    .map(|k| sky.radiance(up.direction(TAU * step(k / 300), FRAC_PI_2 * step(k % 300)))[0]);
                let brightest = seen.fold(sky.radiance(sun)[0], f64::max);
                assert!((brightest / largest - 1.0).abs() < 0.02, "{largest}, {brightest} seen");
            }
        }
    }
}
