//! Daylight coefficients: the irradiance of points of a scene from each part of the sky, from one set of form factors.
//!
//! The sky is divided into the 145 parts of Tregenza (1987), or into those of Reinhart, which divide Tregenza's rows
//! and columns again. One set of rays gives the direct irradiance D_k from each part and the form factors F. Then E_k =
//! D_k + F ρ E_k is solved for all parts k, in blocks of columns ([`coefficients`]). Any sky is a weighted sum of its
//! parts, so the light of every hour of a year is a weighted sum of the E_k ([`year`]).

pub mod coefficients;
mod suns;
pub mod year;

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::DVec3;

use crate::scene::light::Up;

/// Number of parts in the rows of Tregenza's sky, from the horizon up. The zenith is one more part.
const ROWS: [usize; 7] = [30, 30, 24, 24, 18, 12, 6];

/// The parts of a sky: Tregenza's parts with each side divided by `division`.
///
/// Parts are numbered from the horizon up, and clockwise in each row. The middle of the first part of a row is in the
/// north. This is the order of RADIANCE without its ground.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SkyParts {
    division: usize,
}

impl SkyParts {
    /// A sky of 145 parts for a division of 1, 577 for 2, 2305 for 4.
    ///
    /// # Panics
    /// If the division is 0.
    pub fn new(division: usize) -> SkyParts {
        assert!(division > 0, "the division of a sky is at least 1");
        SkyParts { division }
    }

    /// The number by which each side of Tregenza's parts is divided.
    pub fn division(self) -> usize {
        self.division
    }

    /// Number of parts.
    pub fn count(self) -> usize {
        144 * self.division * self.division + 1
    }

    /// Height of a row in radians. The zenith is a cap with half this radius.
    fn height(self) -> f64 {
        FRAC_PI_2 / ((ROWS.len() * self.division) as f64 + 0.5)
    }

    /// Number of parts in a row.
    fn of_row(self, row: usize) -> usize {
        ROWS[row / self.division] * self.division
    }

    fn rows(self) -> usize {
        ROWS.len() * self.division
    }

    /// Number of parts below a row.
    fn before(self, row: usize) -> usize {
        (0..row).map(|row| self.of_row(row)).sum()
    }

    /// The part in a direction, which is a unit vector. `None` below the horizon.
    pub fn at(self, up: Up, direction: DVec3) -> Option<usize> {
        let [east, north, sin] = up.of_scene(direction);
        if sin <= 0.0 {
            return None;
        }
        let row = (sin.min(1.0).asin() / self.height()) as usize;
        if row >= self.rows() {
            return Some(self.count() - 1);
        }
        let many = self.of_row(row);
        let turn = (east.atan2(north) / TAU).rem_euclid(1.0) * many as f64;
        Some(self.before(row) + (turn + 0.5) as usize % many)
    }

    /// Bounds of a part in radians: first and last azimuth, of which the first may be negative; lowest and highest
    /// altitude.
    pub fn bounds(self, part: usize) -> [[f64; 2]; 2] {
        let height = self.height();
        if part + 1 >= self.count() {
            return [[0.0, TAU], [self.rows() as f64 * height, FRAC_PI_2]];
        }
        let row = (0..self.rows()).rfind(|&row| self.before(row) <= part).unwrap_or_default();
        let (k, width) = ((part - self.before(row)) as f64, TAU / self.of_row(row) as f64);
        [[(k - 0.5) * width, (k + 0.5) * width], [row as f64 * height, (row + 1) as f64 * height]]
    }

    /// Solid angle of a part, sr.
    pub fn solid_angle(self, part: usize) -> f64 {
        let [[from, to], [low, high]] = self.bounds(part);
        (to - from) * (high.sin() - low.sin())
    }

    /// The irradiance of an unobstructed horizontal plane from a part of radiance 1.
    pub fn horizontal(self, part: usize) -> f64 {
        let [[from, to], [low, high]] = self.bounds(part);
        0.5 * (to - from) * (high.sin().powi(2) - low.sin().powi(2))
    }

    /// `steps` by `steps` directions in a part, evenly spread over its solid angle.
    pub fn directions(self, up: Up, part: usize, steps: usize) -> impl Iterator<Item = DVec3> {
        let [[from, to], [low, high]] = self.bounds(part);
        let step = move |k: usize| (k as f64 + 0.5) / steps as f64;
        (0..steps * steps).map(move |k| {
            let azimuth = from + (to - from) * step(k / steps);
            let sin = low.sin() + (high.sin() - low.sin()) * step(k % steps);
            up.direction(azimuth, sin.clamp(-1.0, 1.0).asin())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 145, 577 and 2305 parts fill the sky: their solid angles sum to 2π sr, and their irradiances of a horizontal
    /// plane to π. Each direction belongs to the part whose bounds contain it.
    #[test]
    fn parts_fill_the_sky() {
        for (division, count) in [(1, 145), (2, 577), (4, 2305)] {
            let parts = SkyParts::new(division);
            assert_eq!(parts.count(), count);
            let sum = |of: &dyn Fn(usize) -> f64| (0..count).map(of).sum::<f64>();
            assert!((sum(&|k| parts.solid_angle(k)) - TAU).abs() < 1e-9);
            assert!((sum(&|k| parts.horizontal(k)) - 0.5 * TAU).abs() < 1e-9);
            for up in [Up::Y, Up::Z] {
                for k in 0..count {
                    let [[from, to], [low, high]] = parts.bounds(k);
                    for (s, t) in [(0.5, 0.5), (0.01, 0.01), (0.99, 0.98)] {
                        let (azimuth, altitude) = (from + (to - from) * s, low + (high - low) * t);
                        assert_eq!(parts.at(up, up.direction(azimuth, altitude)), Some(k));
                    }
                }
            }
        }
    }

    /// The first part is in the north and the next one to the east of it, as in RADIANCE.
    #[test]
    fn the_order_of_parts() {
        let (parts, up) = (SkyParts::new(1), Up::Z);
        let at = |azimuth: f64, altitude: f64| {
            parts.at(up, up.direction(azimuth.to_radians(), altitude.to_radians()))
        };
        assert_eq!([at(0.0, 6.0), at(12.0, 6.0), at(348.0, 6.0)], [Some(0), Some(1), Some(29)]);
        assert_eq!([at(0.0, 18.0), at(90.0, 90.0), at(10.0, -1.0)], [Some(30), Some(144), None]);
    }
}
