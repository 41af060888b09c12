//! Images of the sky: all directions in latitude and longitude.
//!
//! The top row is the zenith. Columns run clockwise as seen from above. The left edge is north, and a quarter of the
//! width further is east. If y is up, these are -z and +x. The radiance is constant over a texel.

use std::{
    f64::consts::{FRAC_PI_2, PI, TAU},
    path::Path,
    sync::Arc,
};

use glam::DVec3;

use super::Up;
use crate::{Error, Result};

/// Texels brighter than this many times the mean are sampled by shadow rays. Hemisphere rays hit dimmer texels often
/// enough: at 16 times the mean, a hundredth of the sky has a sixth of its light.
const BRIGHT: f64 = 16.0;
/// Largest number of cells of bright texels. Each cell is a lamp that all patches sample.
const MOST_CELLS: usize = 96;

/// A block of one or more texels.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Cell {
    /// The lowest and highest azimuth before the rotation of the image, in radians.
    azimuth: [f64; 2],
    /// Sines of the lowest and highest altitude.
    sine: [f64; 2],
    /// Rotation of the image, which is added to azimuths, in radians.
    rotation: f64,
    up: Up,
}

/// An image of the sky.
#[derive(Debug, Clone, PartialEq)]
pub struct SkyImage {
    width: usize,
    height: usize,
    /// Radiance row by row from the top. Values that are negative or not finite become zero.
    texels: Arc<Vec<[f32; 3]>>,
    /// Rotation of the image in radians, clockwise as seen from above.
    rotation: f64,
    /// Running sums of radiance times solid angle, over all channels.
    cumulative: Arc<Vec<f64>>,
    is_grey: bool,
    brightest: [f64; 3],
}

impl SkyImage {
    /// Reads an image: .hdr, .exr, or another format with linear colours.
    ///
    /// # Errors
    /// [`Error::Io`] or [`Error::Input`] when the image cannot be read.
    pub fn load(path: &Path) -> Result<SkyImage> {
        let bytes = std::fs::read(path).map_err(|source| Error::io(path, source))?;
        let image = image::load_from_memory(&bytes)
            .map_err(|e| Error::input(path, None, format!("cannot be read as an image: {e}")))?
            .into_rgb32f();
        let (width, height) = (image.width() as usize, image.height() as usize);
        let texels = image.into_raw().as_chunks().0.to_vec();
        SkyImage::new(width, height, texels)
            .ok_or_else(|| Error::input(path, None, "an image of the sky needs texels that are not black"))
    }

    /// Makes an image from its texels, R G B in W/(m² sr), row by row from the top. `None` if there are not `width`
    /// times `height` texels, or if all are black.
    pub fn new(width: usize, height: usize, mut texels: Vec<[f32; 3]>) -> Option<SkyImage> {
        if width == 0 || height == 0 || texels.len() != width * height {
            return None;
        }
        let mut brightest = [0f64; 3];
        for texel in &mut texels {
            for c in 0..3 {
                texel[c] = if texel[c].is_finite() { texel[c].max(0.0) } else { 0.0 };
                brightest[c] = brightest[c].max(texel[c].into());
            }
        }
        let is_grey = texels.iter().all(|t| t[0] == t[1] && t[1] == t[2]);
        let mut image = SkyImage {
            width,
            height,
            texels: Arc::new(texels),
            rotation: 0.0,
            cumulative: Arc::default(),
            is_grey,
            brightest,
        };
        let mut sum = 0.0;
        let sums = (0..width * height).map(|k| {
            let radiance: f64 = image.texels[k].iter().copied().map(f64::from).sum();
            sum += radiance * image.solid_angle(k / width);
            sum
        });
        image.cumulative = Arc::new(sums.collect());
        (sum > 0.0 && sum.is_finite()).then_some(image)
    }

    /// The image turned further by an angle in radians, clockwise as seen from above.
    pub fn turned(self, angle: f64) -> SkyImage {
        SkyImage { rotation: self.rotation + angle, ..self }
    }

    pub(super) fn is_grey(&self) -> bool {
        self.is_grey
    }

    pub(super) fn brightest(&self) -> [f64; 3] {
        self.brightest
    }

    /// Sines of the altitudes of the upper and lower edge of a row.
    fn edges(&self, row: usize) -> [f64; 2] {
        [row, row + 1].map(|r| (PI * r as f64 / self.height as f64).cos())
    }

    /// Solid angle of a texel in a row.
    fn solid_angle(&self, row: usize) -> f64 {
        let [upper, lower] = self.edges(row);
        (upper - lower) * TAU / self.width as f64
    }

    /// Index of the texel in a direction, a unit vector.
    fn texel(&self, up: Up, direction: DVec3) -> usize {
        let [east, north, sin] = up.of_scene(direction);
        let row = (0.5 - sin.clamp(-1.0, 1.0).asin() / PI) * self.height as f64;
        let column = ((east.atan2(north) - self.rotation) / TAU).rem_euclid(1.0) * self.width as f64;
        let [row, column] = [(row, self.height), (column, self.width)].map(|(x, n)| (x as usize).min(n - 1));
        row * self.width + column
    }

    /// Radiance in a direction, a unit vector.
    pub(super) fn radiance(&self, up: Up, direction: DVec3) -> [f64; 3] {
        self.texels[self.texel(up, direction)].map(f64::from)
    }

    /// Samples a direction by radiance. Returns it with its density, 1/sr.
    pub(super) fn sample(&self, up: Up, [u, v]: [f64; 2]) -> (DVec3, f64) {
        let total = self.cumulative[self.cumulative.len() - 1];
        let wanted = u * total;
        let k = self.cumulative.partition_point(|&c| c <= wanted).min(self.cumulative.len() - 1);
        let below = if k > 0 { self.cumulative[k - 1] } else { 0.0 };
        let rest = ((wanted - below) / (self.cumulative[k] - below)).clamp(0.0, 1.0);
        let [upper, lower] = self.edges(k / self.width);
        let azimuth = TAU * ((k % self.width) as f64 + rest) / self.width as f64 + self.rotation;
        let direction = up.direction(azimuth, (lower + (upper - lower) * v).clamp(-1.0, 1.0).asin());
        (direction, (self.cumulative[k] - below) / (total * self.solid_angle(k / self.width)))
    }

    /// The density of [`SkyImage::sample`] in a direction, 1/sr.
    pub(super) fn density(&self, up: Up, direction: DVec3) -> f64 {
        let k = self.texel(up, direction);
        let below = if k > 0 { self.cumulative[k - 1] } else { 0.0 };
        let total = self.cumulative[self.cumulative.len() - 1];
        (self.cumulative[k] - below) / (total * self.solid_angle(k / self.width))
    }

    /// The bright cells with their mean radiance, and the image without them.
    pub(crate) fn split(&self, up: Up) -> (Vec<(Cell, [f64; 3])>, SkyImage) {
        let mean = self.cumulative[self.cumulative.len() - 1] / (4.0 * PI);
        let bright = |t: &[f32; 3]| t.iter().copied().map(f64::from).sum::<f64>() > BRIGHT * mean;
        let texels: Vec<usize> = (0..self.texels.len()).filter(|&k| bright(&self.texels[k])).collect();
        let mut edge = 1;
        let block_of = |k: usize, edge: usize| (k / self.width / edge, k % self.width / edge);
        let blocks = loop {
            let mut blocks: Vec<(usize, usize)> = texels.iter().map(|&k| block_of(k, edge)).collect();
            blocks.sort_unstable();
            blocks.dedup();
            if blocks.len() <= MOST_CELLS {
                break blocks;
            }
            edge *= 2;
        };
        let mut rest = self.texels.to_vec();
        let mut cells = Vec::new();
        for (row, column) in blocks {
            let rows = row * edge..((row + 1) * edge).min(self.height);
            let columns = column * edge..((column + 1) * edge).min(self.width);
            let (mut sum, mut whole) = (DVec3::ZERO, 0.0);
            for r in rows.clone() {
                for k in columns.clone().map(|c| r * self.width + c) {
                    sum += DVec3::from(self.texels[k].map(f64::from)) * self.solid_angle(r);
                    whole += self.solid_angle(r);
                    rest[k] = [0.0; 3];
                }
            }
            let at = |column: usize| TAU * column as f64 / self.width as f64;
            let cell = Cell {
                azimuth: [at(columns.start), at(columns.end)],
                sine: [self.edges(rows.end - 1)[1], self.edges(rows.start)[0]],
                rotation: self.rotation,
                up,
            };
            cells.push((cell, (sum / whole).to_array()));
        }
        let dim = SkyImage::new(self.width, self.height, rest.clone()).unwrap_or_else(|| {
            // All light is in bright cells, and the rest is black.
            SkyImage { texels: Arc::new(rest), brightest: [0.0; 3], ..self.clone() }
        });
        (cells, SkyImage { rotation: self.rotation, ..dim })
    }
}

impl Cell {
    /// The solid angle of the cell, sr.
    pub(crate) fn solid_angle(&self) -> f64 {
        (self.azimuth[1] - self.azimuth[0]) * (self.sine[1] - self.sine[0])
    }

    /// Samples a direction into the cell, uniformly over its solid angle.
    pub(crate) fn sample(&self, [u, v]: [f64; 2]) -> DVec3 {
        let within = |[from, to]: [f64; 2], share: f64| from + (to - from) * share;
        let altitude = within(self.sine, v).clamp(-1.0, 1.0).asin();
        self.up.direction(within(self.azimuth, u) + self.rotation, altitude)
    }

    /// The unblocked irradiance of a plane with this unit normal, divided by the radiance of the cell. Only the part of
    /// the cell above the plane counts.
    pub(crate) fn unblocked(&self, normal: DVec3) -> f64 {
        // If all of the cell is above the plane, the integral of the direction over the cell has a closed form.
        let corners = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]];
        let heights = corners.map(|at| self.sample(at).dot(normal));
        let wide = self.azimuth[1] - self.azimuth[0] > FRAC_PI_2;
        if !wide && heights.iter().all(|&h| h > 0.05) {
            let [low, high] = self.sine.map(|s| s.clamp(-1.0, 1.0).asin());
            let level = 0.5 * (high - low) + 0.25 * ((2.0 * high).sin() - (2.0 * low).sin());
            let rise = 0.5 * (high.sin().powi(2) - low.sin().powi(2));
            let [from, to] = self.azimuth.map(|a| a + self.rotation);
            let sum = [level * (from.cos() - to.cos()), level * (to.sin() - from.sin()), rise * (to - from)];
            return self.up.to_scene(sum).dot(normal);
        }
        const STEPS: usize = 32;
        let step = |k: usize| (k as f64 + 0.5) / STEPS as f64;
        let sum: f64 = (0..STEPS * STEPS)
            .map(|k| self.sample([step(k / STEPS), step(k % STEPS)]).dot(normal).max(0.0))
            .sum();
        sum * self.solid_angle() / (STEPS * STEPS) as f64
    }

    /// The numbers that determine the samples of the cell.
    pub(crate) fn words(&self) -> Vec<u64> {
        let [from, to] = self.azimuth;
        [from, to, self.sine[0], self.sine[1], self.rotation].map(f64::to_bits).into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each texel has a value of its own, which identifies it. After a quarter turn, the north of the image is in the
    /// east.
    #[test]
    fn columns_and_rows_are_in_their_directions() {
        let texels = (0..8).map(|k| [k as f32 + 1.0, 0.0, 0.0]).collect();
        let image = SkyImage::new(4, 2, texels).unwrap();
        for up in [Up::Y, Up::Z] {
            let seen = |image: &SkyImage, azimuth: f64, altitude: f64| {
                image.radiance(up, up.direction(azimuth, altitude))[0]
            };
            // Columns begin at north. Their middles are in the north-east, south-east, south-west and north-west.
            for column in 0..4 {
                let azimuth = (f64::from(column) + 0.5) * FRAC_PI_2;
                assert_eq!(seen(&image, azimuth, 0.3), f64::from(column) + 1.0);
                assert_eq!(seen(&image, azimuth, -0.3), f64::from(column) + 5.0);
                let turned = image.clone().turned(FRAC_PI_2);
                assert_eq!(seen(&turned, azimuth + FRAC_PI_2, 0.3), f64::from(column) + 1.0);
                assert_eq!(seen(&turned.turned(FRAC_PI_2), azimuth + PI, 0.3), f64::from(column) + 1.0);
            }
        }
        // With y up, as in Mitsuba: column 0 is at -z, and a quarter of the width is at +x.
        assert_eq!(image.radiance(Up::Y, DVec3::new(0.01, 0.1, -1.0).normalize())[0], 1.0);
        assert_eq!(image.radiance(Up::Y, DVec3::new(1.0, 0.1, 0.01).normalize())[0], 2.0);
    }

    fn patterned() -> SkyImage {
        let mut texels: Vec<[f32; 3]> = (0..64 * 32).map(|k| [1.0 + (k % 7) as f32, 2.0, 1.0]).collect();
        texels[5 * 64 + 9] = [4e4, 3e4, 2e4];
        texels[5 * 64 + 10] = [5e4, 3e4, 2e4];
        texels[20 * 64 + 60] = [f32::NAN, -1.0, f32::INFINITY];
        SkyImage::new(64, 32, texels).unwrap().turned(0.3)
    }

    /// Samples follow the radiance, and [`SkyImage::density`] is their density.
    #[test]
    fn samples_follow_the_radiance() {
        let (image, up) = (patterned(), Up::Z);
        let many = 200;
        let mut mean = 0.0;
        for (i, j) in (0..many).flat_map(|i| (0..many).map(move |j| (i, j))) {
            let at = [i, j].map(|k| (f64::from(k) + 0.5) / f64::from(many));
            let (direction, density) = image.sample(up, at);
            assert!((image.density(up, direction) / density - 1.0).abs() < 1e-9);
            mean += image.radiance(up, direction).iter().sum::<f64>() / density / f64::from(many * many);
        }
        let total = image.cumulative[image.cumulative.len() - 1];
        assert!((mean / total - 1.0).abs() < 1e-6, "{mean} {total}");
    }

    /// The irradiance from the bright cells and the irradiance from the rest sum to the irradiance from the image.
    #[test]
    fn bright_cells_and_the_rest_are_the_whole() {
        let (image, up) = (patterned(), Up::Y);
        let (cells, dim) = image.split(up);
        assert_eq!(cells.len(), 2);
        let irradiance = |image: &SkyImage, normal: DVec3| {
            let mut sum = 0.0;
            for k in 0..image.texels.len() {
                let [upper, lower] = image.edges(k / 64);
                let azimuth = TAU * ((k % 64) as f64 + 0.5) / 64.0 + image.rotation;
                let direction = up.direction(azimuth, (0.5 * (upper + lower)).asin());
                sum += f64::from(image.texels[k][0])
                    * direction.dot(normal).max(0.0)
                    * image.solid_angle(k / 64);
            }
            sum
        };
        for normal in [DVec3::Y, DVec3::new(0.6, 0.0, 0.8), DVec3::new(0.0, 0.6, -0.8)] {
            let of_cells: f64 = cells.iter().map(|(cell, l)| l[0] * cell.unblocked(normal)).sum();
            let (all, rest) = (irradiance(&image, normal), irradiance(&dim, normal));
            assert!((of_cells + rest - all).abs() < 2e-3 * all, "{of_cells} {rest} {all}");
        }
        // The same holds for a cell that the plane cuts.
        let (cell, _) = &cells[0];
        for normal in [cell.sample([0.5, 0.5]).any_orthonormal_vector(), cell.sample([0.2, 0.9])] {
            let many = 300;
            let at = |k: i32| (f64::from(k) + 0.5) / f64::from(many);
            let sum: f64 = (0..many * many)
                .map(|k| cell.sample([at(k / many), at(k % many)]).dot(normal).max(0.0))
                .sum();
            let wanted = sum * cell.solid_angle() / f64::from(many * many);
            assert!((cell.unblocked(normal) - wanted).abs() < 2e-3 * wanted, "{}", cell.unblocked(normal));
        }
    }

    /// If there are more bright texels than cells, several texels form one cell.
    #[test]
    fn many_bright_texels_are_few_cells() {
        let bright = |k: usize| (k / 256) < 40 && k % 256 < 10;
        let texels = (0..256 * 128).map(|k| if bright(k) { [1e5; 3] } else { [1.0; 3] }).collect();
        let (cells, dim) = SkyImage::new(256, 128, texels).unwrap().split(Up::Y);
        assert!((10..=MOST_CELLS).contains(&cells.len()), "{}", cells.len());
        assert!(dim.brightest()[0] <= 1.0);
    }
}
