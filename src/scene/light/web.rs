//! The distribution of a luminaire in the directions of the scene.

use glam::DVec3;

use super::Photometry;

/// A distribution with the axes of its frame in the scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Web {
    photometry: Photometry,
    /// 1 over the largest intensity.
    scale: f64,
    c0: DVec3,
    c90: DVec3,
    up: DVec3,
}

impl Web {
    /// Makes a distribution from the axes of C0, of C90 and upwards: unit vectors of the scene.
    pub(super) fn new(photometry: Photometry, [c0, c90, up]: [DVec3; 3]) -> Web {
        let peak = photometry.peak();
        Web { scale: if peak > 0.0 { 1.0 / peak } else { 0.0 }, photometry, c0, c90, up }
    }

    /// Intensity in a direction, a unit vector, relative to the largest intensity.
    pub(super) fn towards(&self, direction: DVec3) -> f64 {
        let local = DVec3::new(direction.dot(self.c0), direction.dot(self.c90), direction.dot(self.up));
        self.scale * self.photometry.intensity(local)
    }

    /// All numbers of the distribution.
    pub(super) fn numbers(&self) -> Vec<f64> {
        let axes = [self.c0, self.c90, self.up].into_iter().flat_map(|axis| axis.to_array());
        self.photometry.numbers().chain(axes).collect()
    }

    /// The integral of [`Web::towards`] over all directions, sr.
    pub(super) fn total(&self) -> f64 {
        self.scale * self.photometry.flux()
    }
}
