//! The photometry of a luminaire: its intensity in every direction.

use std::{f64::consts::TAU, path::Path, sync::Arc};

use glam::DVec3;

use super::{
    eulumdat, ies,
    measured::{Goniometer, Measured, Opening, Wrong},
};
use crate::{Error, Result};

/// Largest relative difference without a warning between the integral of the intensity and the flux that the file
/// states.
const FLUX: f64 = 0.05;
/// Number of steps per half turn for the integral.
const STEPS: usize = 180;

/// A distribution of intensity.
///
/// Directions are in the frame of the luminaire: x is C0, y is C90, and −z, straight down, is γ = 0.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Photometry {
    goniometer: Goniometer,
    /// Horizontal angles in degrees, ascending. For type C, they run all round from 0 to 360 without use of symmetry.
    horizontal: Vec<f64>,
    /// Vertical angles in degrees, ascending.
    vertical: Vec<f64>,
    /// Intensities in candela, plane by plane.
    candela: Arc<Vec<f64>>,
    /// The flux that the file states, lm; `None` for absolute photometry.
    pub stated_flux: Option<f64>,
    /// The luminous opening, if it has a size.
    pub opening: Option<Opening>,
    /// Warnings of the reader, one sentence each, about omissions and assumptions.
    pub warnings: Vec<String>,
}

impl Photometry {
    /// The kind of goniometer, the angles and the intensities.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let lists = [&self.horizontal, &self.vertical, &*self.candela];
        std::iter::once(f64::from(self.goniometer as u8)).chain(lists.into_iter().flatten().copied())
    }

    /// Reads an IES file (LM-63 of 1986 to 2019), or a EULUMDAT file if its name ends in `.ldt`.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be read. [`Error::Input`], with the line, when its contents cannot be used.
    pub fn load(path: &Path) -> Result<Photometry> {
        let bytes = std::fs::read(path).map_err(|source| Error::io(path, source))?;
        let text = String::from_utf8_lossy(&bytes);
        let is_ldt = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("ldt"));
        let read = if is_ldt { eulumdat::parse(&text) } else { ies::parse(&text) };
        let measured = read.map_err(|Wrong { line, message }| Error::input(path, Some(line), message))?;
        let mut photometry = Photometry::new(measured);
        if let Some(stated) = photometry.stated_flux {
            let found = photometry.flux();
            if (found - stated).abs() > FLUX * stated {
                photometry.warnings.push(format!(
                    "{}: the intensities sum to {found:.0} lm, the file states {stated:.0} lm",
                    path.display()
                ));
            }
        }
        Ok(photometry)
    }

    pub(super) fn new(measured: Measured) -> Photometry {
        let Measured { goniometer, horizontal, vertical, candela, stated_flux, opening, mut warnings } =
            measured;
        warnings.extend(goniometer.missing(&vertical, &horizontal));
        let (horizontal, candela) = match goniometer {
            Goniometer::C => all_round(&horizontal, &candela, vertical.len()),
            _ => (horizontal, candela),
        };
        let candela = Arc::new(candela);
        Photometry { goniometer, horizontal, vertical, candela, stated_flux, opening, warnings }
    }

    /// Intensity in a direction, a unit vector in the frame of the luminaire, cd.
    pub fn intensity(&self, direction: DVec3) -> f64 {
        let DVec3 { x, y, z } = direction;
        let degrees = |sine: f64| sine.clamp(-1.0, 1.0).asin().to_degrees();
        // Luminaires of types B and A aim straight down here. Upwards in the beam is C0, and right is opposite to C90.
        // The differences avoid a negative zero, which would turn an angle around.
        let (forward, above, right) = (0.0 - z, x, 0.0 - y);
        let (h, v) = match self.goniometer {
            // The arc cosine of a number next to 1 would have an error of a hundred millionth. The arc tangent has not.
            Goniometer::C => {
                (y.atan2(x).to_degrees().rem_euclid(360.0), x.hypot(y).atan2(forward).to_degrees())
            }
            Goniometer::B => (degrees(right), above.atan2(forward).to_degrees()),
            Goniometer::A => (right.atan2(forward).to_degrees(), degrees(above)),
        };
        self.at(h, v)
    }

    /// Intensity at two angles in degrees: linear between the angles of the file, and zero beyond them.
    fn at(&self, h: f64, v: f64) -> f64 {
        // If the angles start at zero, they describe half of a beam that stands for both halves.
        let folded = |angles: &[f64], angle: f64| if angles[0] >= 0.0 { angle.abs() } else { angle };
        let (h, v) = (folded(&self.horizontal, h), folded(&self.vertical, v));
        let (Some((i, s)), Some((j, t))) = (between(&self.horizontal, h), between(&self.vertical, v)) else {
            return 0.0;
        };
        let rows = self.vertical.len();
        let value =
            |i: usize, j: usize| self.candela[i.min(self.horizontal.len() - 1) * rows + j.min(rows - 1)];
        let row = |i: usize| value(i, j) * (1.0 - t) + value(i, j + 1) * t;
        row(i) * (1.0 - s) + row(i + 1) * s
    }

    /// The integral of the intensity over all directions, lm.
    pub fn flux(&self) -> f64 {
        // Rings of equal width in γ, because distributions change most with this angle, and equal steps around.
        let ring = |k: usize| {
            let edge = |k: usize| (std::f64::consts::PI * k as f64 / STEPS as f64).cos();
            let (upper, lower) = (edge(k), edge(k + 1));
            let gamma = std::f64::consts::PI * (k as f64 + 0.5) / STEPS as f64;
            let at = |j: usize| {
                let (sin, cos) = (TAU * (j as f64 + 0.5) / (2 * STEPS) as f64).sin_cos();
                self.intensity(DVec3::new(gamma.sin() * cos, gamma.sin() * sin, -gamma.cos()))
            };
            (0..2 * STEPS).map(at).sum::<f64>() / (2 * STEPS) as f64 * (upper - lower)
        };
        TAU * (0..STEPS).map(ring).sum::<f64>()
    }

    /// The largest intensity, cd.
    pub fn peak(&self) -> f64 {
        self.candela.iter().copied().fold(0.0, f64::max)
    }
}

/// The interval of ascending angles that contains an angle, and the position in it from 0 to 1.
fn between(angles: &[f64], angle: f64) -> Option<(usize, f64)> {
    let (first, last) = (angles[0], angles[angles.len() - 1]);
    // Bound of the rounding errors of trigonometric functions, in degrees.
    const ROUNDING: f64 = 1e-9;
    if angles.len() == 1 {
        return Some((0, 0.0));
    }
    if !(first - ROUNDING..=last + ROUNDING).contains(&angle) {
        return None;
    }
    let k = angles.partition_point(|&a| a <= angle).clamp(1, angles.len() - 1) - 1;
    let (low, high) = (angles[k], angles[k + 1]);
    Some((k, ((angle - low) / (high - low)).clamp(0.0, 1.0)))
}

/// Planes of type C all round, by the symmetry that their angles imply. A single plane stands for all. Planes from 0 to
/// 90 are a quadrant. Planes from 0 to 180, from 90 to 270 or from -90 to 90 are a half.
fn all_round(planes: &[f64], candela: &[f64], rows: usize) -> (Vec<f64>, Vec<f64>) {
    let (first, last) = (planes[0], planes[planes.len() - 1]);
    if planes.len() == 1 {
        return (vec![0.0, 360.0], [candela, candela].concat());
    }
    let mirrors: &[fn(f64) -> f64] = match (first, last) {
        (0.0, 90.0) => &[|c| c, |c| 180.0 - c, |c| 180.0 + c, |c| 360.0 - c],
        (0.0, 180.0) => &[|c| c, |c| 360.0 - c],
        (90.0, 270.0) => &[|c| c, |c| (540.0 - c).rem_euclid(360.0), |c| 540.0 - c],
        (-90.0, 90.0) => &[|c| c.rem_euclid(360.0), |c| 180.0 - c, |c| if c == 0.0 { 360.0 } else { c }],
        // All planes are in the file. The last, at 360, may be missing.
        _ => &[|c| c, |c| if c == 0.0 { 360.0 } else { c }],
    };
    let mut all: Vec<(f64, usize)> = Vec::new();
    for (k, &c) in planes.iter().enumerate() {
        all.extend(mirrors.iter().map(|mirror| (mirror(c), k)).filter(|(c, _)| (0.0..=360.0).contains(c)));
    }
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    all.dedup_by(|a, b| a.0 == b.0);
    let values = all.iter().flat_map(|&(_, k)| &candela[k * rows..][..rows]).copied().collect();
    (all.into_iter().map(|(c, _)| c).collect(), values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    fn measured(horizontal: &[f64], vertical: &[f64], candela: impl Fn(f64, f64) -> f64) -> Photometry {
        let all = horizontal.iter().flat_map(|&h| vertical.iter().map(move |&v| (h, v)));
        Photometry::new(Measured {
            goniometer: Goniometer::C,
            horizontal: horizontal.to_vec(),
            vertical: vertical.to_vec(),
            candela: all.map(|(h, v)| candela(h, v)).collect(),
            stated_flux: None,
            opening: None,
            warnings: Vec::new(),
        })
    }

    fn towards(c: f64, gamma: f64) -> DVec3 {
        let (c, gamma) = (c.to_radians(), gamma.to_radians());
        DVec3::new(gamma.sin() * c.cos(), gamma.sin() * c.sin(), -gamma.cos())
    }

    fn steps(from: i32, to: i32, step: usize) -> Vec<f64> {
        (from..=to).step_by(step).map(f64::from).collect()
    }

    /// The flux is 4π I for an isotropic light, and π I for a cosine distribution.
    #[test]
    fn flux_of_isotropic_and_cosine() {
        let even = measured(&[0.0], &[0.0, 180.0], |_, _| 100.0);
        assert!((even.flux() / (400.0 * PI) - 1.0).abs() < 1e-9);
        let cosine = measured(&[0.0], &steps(0, 90, 1), |_, v| 100.0 * v.to_radians().cos());
        assert!((cosine.flux() / (100.0 * PI) - 1.0).abs() < 1e-3, "{}", cosine.flux());
        assert_eq!(cosine.intensity(DVec3::Z), 0.0);
        assert!((cosine.intensity(towards(77.0, 30.5)) - 100.0 * 30.5f64.to_radians().cos()).abs() < 0.01);
    }

    /// A quadrant, a half and the whole give the same intensity in all directions if the distribution has their
    /// symmetry.
    #[test]
    fn symmetric_quadrants_and_halves() {
        let quadrant = |c: f64, v: f64| 10.0 + v + 50.0 * c.to_radians().cos().abs();
        let half = |c: f64, v: f64| 10.0 + v + 20.0 * c.to_radians().cos();
        let other = |c: f64, v: f64| 10.0 + v + 20.0 * c.to_radians().sin();
        let vertical = steps(0, 180, 30);
        let whole = steps(0, 360, 10);
        type Distribution<'a> = &'a dyn Fn(f64, f64) -> f64;
        for (planes, of) in [
            (steps(0, 90, 10), &quadrant as Distribution),
            (steps(0, 180, 10), &half),
            (steps(90, 270, 10), &other),
            (steps(-90, 90, 10), &other),
            (steps(0, 350, 10), &half),
        ] {
            let (part, all) = (measured(&planes, &vertical, of), measured(&whole, &vertical, of));
            for k in 0..200 {
                let direction = towards(f64::from(k) * 7.3, f64::from(k % 19) * 9.4 + 0.1);
                let (a, b) = (part.intensity(direction), all.intensity(direction));
                assert!((a - b).abs() < 1e-9, "{planes:?} {direction}: {a} {b}");
            }
            assert_eq!((part.horizontal[0], part.horizontal[part.horizontal.len() - 1]), (0.0, 360.0));
        }
    }
}
