//! Distant lights: the sun, and lights in one direction without a size.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::DVec3;

/// Angular diameter of the sun as seen from the Earth, in degrees.
pub const SUN_DIAMETER: f64 = 0.533;

/// Number of rings for the integral over a disc that the horizon of a plane cuts.
const RINGS: usize = 64;

/// A disc of constant radiance that is seen in the same direction everywhere.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Distant {
    /// Unit vector to the middle of the disc.
    pub direction: DVec3,
    /// Irradiance on a plane that faces it, W/m², R G B.
    pub irradiance: [f64; 3],
    /// Half of the angular diameter in radians, below π/2; zero for a light without a size.
    pub radius: f64,
}

impl Distant {
    /// Makes a light from the direction to it, the irradiance on a plane that faces it (W/m², R G B), and its angular
    /// diameter in radians.
    ///
    /// # Panics
    /// When the direction has no length, or the diameter is not in \[0, π).
    pub fn new(direction: DVec3, irradiance: [f64; 3], diameter: f64) -> Distant {
        assert!((0.0..PI).contains(&diameter), "not a diameter");
        let direction = crate::scene::direction(direction).expect("a direction has a length");
        Distant { direction, irradiance, radius: 0.5 * diameter }
    }

    /// The solid angle of the disc, sr.
    pub fn solid_angle(&self) -> f64 {
        // This form of 1 - cos avoids cancellation.
        2.0 * TAU * (0.5 * self.radius).sin().powi(2)
    }

    /// The radiance of the disc, R G B, W/(m² sr); infinite for a light without a size.
    pub fn radiance(&self) -> [f64; 3] {
        // The divisor is the projected solid angle of a cap that faces a plane.
        self.irradiance.map(|e| e / (PI * self.radius.sin().powi(2)))
    }

    /// Whether a direction, a unit vector, hits the disc.
    pub fn contains(&self, direction: DVec3) -> bool {
        self.radius > 0.0
            && direction.cross(self.direction).length() < self.radius.sin()
            && direction.dot(self.direction) > 0.0
    }

    /// Samples a direction to the disc, uniformly over its solid angle.
    pub fn sample(&self, [u, v]: [f64; 2]) -> DVec3 {
        if self.radius == 0.0 {
            return self.direction;
        }
        let versine = u * 2.0 * (0.5 * self.radius).sin().powi(2);
        let sin = (versine * (2.0 - versine)).max(0.0).sqrt();
        let (y, x) = (TAU * v).sin_cos();
        let (a, b) = self.direction.any_orthonormal_pair();
        (a * x + b * y) * sin + self.direction * (1.0 - versine)
    }

    /// The unblocked irradiance of a plane with this unit normal, relative to the irradiance of a plane that faces the
    /// light. Only the part of the disc above the plane counts.
    pub fn unblocked(&self, normal: DVec3) -> f64 {
        let cos = normal.dot(self.direction).clamp(-1.0, 1.0);
        let zenith = cos.acos();
        if zenith + self.radius <= FRAC_PI_2 {
            return cos;
        }
        if zenith - self.radius >= FRAC_PI_2 {
            return 0.0;
        }
        // On a ring at the angle α from the middle, the cosine is cos z cos α + sin z sin α cos φ. Only its positive
        // part counts.
        let ring = |alpha: f64| {
            let (level, swing) = (cos * alpha.cos(), zenith.sin() * alpha.sin());
            let end = if swing > 0.0 { (-level / swing).clamp(-1.0, 1.0).acos() } else { PI };
            2.0 * (end * level + end.sin() * swing) * alpha.sin()
        };
        let step = self.radius / RINGS as f64;
        let sum: f64 = (0..RINGS).map(|k| ring((k as f64 + 0.5) * step)).sum();
        (sum * step / (PI * self.radius.sin().powi(2))).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sun(zenith: f64, diameter: f64) -> Distant {
        Distant::new(DVec3::new(zenith.sin(), 0.0, zenith.cos()), [2.0; 3], diameter)
    }

    /// The sun's disc has 6.797e-5 sr. Its radiance times this solid angle is its irradiance, apart from the cosine
    /// within the disc.
    #[test]
    fn the_disc_of_the_sun() {
        let sun = sun(0.3, SUN_DIAMETER.to_radians());
        assert!((sun.solid_angle() - 6.7967e-5).abs() < 1e-9, "{}", sun.solid_angle());
        assert!((sun.radiance()[0] * sun.solid_angle() / 2.0 - 1.0).abs() < 1e-5);
        assert!(sun.contains(sun.direction) && !sun.contains(-sun.direction));
        let edge = |share: f64| sun.direction + share * sun.radius.tan() * DVec3::Y;
        assert!(sun.contains(edge(0.99).normalize()) && !sun.contains(edge(1.01).normalize()));
    }

    /// The irradiance agrees with the mean over points of the disc: above the horizon, cut by it, and below it. A disc
    /// with its middle on the horizon gives (2/3 sin³ r) / (π sin² r) to first order.
    #[test]
    fn unblocked_irradiance_is_the_mean_over_the_disc() {
        for (zenith, diameter) in
            [(0.4, 0.01), (1.5, 0.3), (1.6, 0.3), (FRAC_PI_2, 0.01), (1.4, 1.0), (1.9, 0.3)]
        {
            let sun = sun(zenith, diameter);
            let many = 512;
            let cell = |k: usize| (k as f64 + 0.5) / many as f64;
            let mut sum = 0.0;
            for (i, j) in (0..many).flat_map(|i| (0..many).map(move |j| (i, j))) {
                let direction = sun.sample([cell(i), cell(j)]);
                assert!((direction.length() - 1.0).abs() < 1e-12 && sun.contains(direction));
                sum += direction.z.max(0.0) / (many * many) as f64;
            }
            let wanted = sum * sun.solid_angle() / (PI * sun.radius.sin().powi(2));
            let found = sun.unblocked(DVec3::Z);
            assert!((found - wanted).abs() < 2e-4 * sun.radius.min(1.0), "{zenith}: {found} for {wanted}");
        }
        let half = sun(FRAC_PI_2, 0.01);
        let wanted = 2.0 / (3.0 * PI) * half.radius;
        assert!((half.unblocked(DVec3::Z) / wanted - 1.0).abs() < 1e-3);
    }

    #[test]
    fn a_light_without_a_size_follows_the_cosine() {
        let light = sun(1.0, 0.0);
        assert_eq!(light.sample([0.3, 0.7]), light.direction);
        assert!((light.unblocked(DVec3::Z) - 1f64.cos()).abs() < 1e-15);
        assert_eq!(light.unblocked(-DVec3::Z), 0.0);
        assert!(!light.contains(light.direction));
    }
}
