//! Lights at a point.

use std::sync::Arc;

use glam::DVec3;

use super::Web;

/// The intensity of a light at a point as a function of the direction.
#[derive(Debug, Clone, PartialEq)]
pub enum Distribution {
    /// The same in all directions.
    Isotropic,
    /// A cone: full intensity within the inner angle, and none beyond the outer angle. In between, the intensity is the
    /// square of a ramp linear in the cosine, as in the glTF extension KHR_lights_punctual.
    Spot {
        /// The axis of the cone, a unit vector away from the light.
        axis: DVec3,
        /// Cosine of the inner half angle.
        inner: f64,
        /// Cosine of the outer half angle.
        outer: f64,
    },
    /// The distribution of a photometric file.
    Web(Arc<Web>),
}

/// The luminous area of a light: a parallelogram, or the ellipse in it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Area {
    /// The first half axis.
    pub first: DVec3,
    /// The second half axis.
    pub second: DVec3,
    /// Whether the area is an ellipse.
    pub round: bool,
}

impl Area {
    /// Samples a point of the area uniformly, relative to its middle.
    pub fn sample(&self, [u, v]: [f64; 2]) -> DVec3 {
        if self.round {
            let (sin, cos) = (std::f64::consts::TAU * v).sin_cos();
            return u.sqrt() * (cos * self.first + sin * self.second);
        }
        (2.0 * u - 1.0) * self.first + (2.0 * v - 1.0) * self.second
    }
}

/// A light at a point.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PointLight {
    /// The position, in the unit of the file.
    pub position: DVec3,
    /// Intensity, R G B, W/sr, in directions where the distribution is 1.
    pub intensity: [f64; 3],
    /// Factor of the intensity, by direction.
    pub distribution: Distribution,
    /// The luminous area, which emits equally from all its points; `None` for a point.
    pub area: Option<Area>,
}

/// Least difference between the cosines of the inner and the outer angle, as in glTF.
const LEAST_RAMP: f64 = 1e-3;

impl Distribution {
    /// All numbers of the distribution: two distributions of the same kind are equal if these are.
    pub(crate) fn numbers(&self) -> Vec<f64> {
        match self {
            Distribution::Isotropic => Vec::new(),
            Distribution::Spot { axis, inner, outer } => {
                axis.to_array().into_iter().chain([*inner, *outer]).collect()
            }
            Distribution::Web(web) => web.numbers(),
        }
    }

    /// Makes a cone about an axis, with its inner and outer half angles in radians.
    ///
    /// # Panics
    /// When the axis has no length.
    pub fn spot(axis: DVec3, inner: f64, outer: f64) -> Distribution {
        let axis = crate::scene::direction(axis).expect("an axis has a length");
        Distribution::Spot { axis, inner: inner.cos(), outer: outer.cos() }
    }

    /// Factor of the intensity in a direction, a unit vector away from the light.
    pub fn towards(&self, direction: DVec3) -> f64 {
        match self {
            Distribution::Isotropic => 1.0,
            Distribution::Spot { axis, inner, outer } => {
                let ramp = (inner - outer).max(LEAST_RAMP);
                ((axis.dot(direction) - outer) / ramp).clamp(0.0, 1.0).powi(2)
            }
            Distribution::Web(web) => web.towards(direction),
        }
    }

    /// The integral of [`Distribution::towards`] over all directions, sr.
    pub fn total(&self) -> f64 {
        match self {
            Distribution::Isotropic => 4.0 * std::f64::consts::PI,
            Distribution::Spot { inner, outer, .. } => {
                // The mean of the squared ramp is a third.
                let ramp = (inner - outer).max(LEAST_RAMP);
                let full = (1.0 - outer - ramp).max(0.0);
                let of_ramp = ramp.min(1.0 - outer);
                std::f64::consts::TAU * (full + of_ramp.powi(3) / (3.0 * ramp * ramp))
            }
            Distribution::Web(web) => web.total(),
        }
    }
}

impl PointLight {
    /// Makes a light with the same intensity in all directions.
    pub fn isotropic(position: DVec3, intensity: [f64; 3]) -> PointLight {
        PointLight::new(position, intensity, Distribution::Isotropic)
    }

    /// Makes a light with this distribution.
    pub fn new(position: DVec3, intensity: [f64; 3], distribution: Distribution) -> PointLight {
        PointLight { position, intensity, distribution, area: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The ramp of glTF, clamp((cos θ - cos outer) / (cos inner - cos outer))², and its integral.
    #[test]
    fn the_cone_of_gltf() {
        for (inner, outer) in [(0.0, 0.8), (0.3, 0.5), (0.5, 0.5), (0.0, 0.01)] {
            let spot = Distribution::spot(DVec3::new(0.0, -3.0, 0.0), inner, outer);
            let at = |angle: f64| spot.towards(DVec3::new(angle.sin(), -angle.cos(), 0.0));
            let ramp = (f64::cos(inner) - f64::cos(outer)).max(1e-3);
            for angle in [0.0, 0.2, 0.4, 0.499, 0.6, 0.9, 2.0] {
                let wanted = ((f64::cos(angle) - f64::cos(outer)) / ramp).clamp(0.0, 1.0).powi(2);
                assert!((at(angle) - wanted).abs() < 1e-12);
            }
            let many = 200_000;
            let cos = |k: i32| 1.0 - 2.0 * (f64::from(k) + 0.5) / f64::from(many);
            let sum: f64 = (0..many).map(|k| at(cos(k).acos())).sum();
            let wanted = sum * 4.0 * std::f64::consts::PI / f64::from(many);
            assert!((spot.total() - wanted).abs() < 1e-4, "{inner} {outer}: {} {wanted}", spot.total());
        }
    }
}
