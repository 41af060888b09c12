//! Lights that are not surfaces, as lamps: distant discs, bright cells of sky images, and points.

use glam::{DVec3, Vec3A};

use super::{Constants, solid_angle, unoccluded::Facing};
use crate::{
    rays::footprint::Footprint,
    scene::light::{Area, Cell, Distant, Distribution, LightKind},
    trace::{Tracer, sampling::square_to_triangle},
};

/// Length of a shadow ray to a distant light, in unit space: it leaves the scene from any point.
const FAR_AWAY: f32 = 4.0;
/// A triangle is cut for integrating intensity if it subtends more than this solid angle.
const WIDE: f64 = 0.1;
/// It is also cut if halving its edges changes the integral by more than this share.
const EVEN: f64 = 1e-4;
/// Most successive cuts.
const MOST_CUTS: u32 = 7;
/// Points of a light's area in each of two dimensions. The mean over all of them gives the unblocked irradiance.
const POINTS: usize = 4;

/// A light that is not a surface, in unit space. All results are relative to its colour, irradiance or intensity.
#[derive(Debug, Clone)]
pub(super) enum Remote {
    Distant(Distant),
    /// A cell of a sky image.
    Cell(Cell),
    Point {
        at: DVec3,
        distribution: Distribution,
        area: Option<Area>,
        /// Shadow rays end this far before the light ([`Tracer::mounted`]).
        short: f32,
        /// Ratio of areas in the file's unit to those in unit space.
        unit: f64,
    },
}

impl Remote {
    pub(super) fn new(kind: &LightKind, tracer: &Tracer) -> Remote {
        match kind {
            LightKind::Distant(distant) => Remote::Distant(*distant),
            LightKind::Point(point) => Remote::Point {
                at: tracer.to_unit_exactly(point.position),
                short: tracer.mounted(point.position),
                distribution: point.distribution.clone(),
                area: point.area.map(|area| Area {
                    first: area.first / tracer.scale(),
                    second: area.second / tracer.scale(),
                    ..area
                }),
                unit: tracer.scale() * tracer.scale(),
            },
        }
    }

    /// The mean unblocked irradiance of a patch.
    pub(super) fn unblocked(&self, patch: &Facing) -> f64 {
        match self {
            Remote::Distant(distant) => distant.unblocked(patch.normal),
            Remote::Cell(cell) => cell.unblocked(patch.normal),
            Remote::Point { at, distribution, area: shining, unit, .. } => {
                let from = |at: DVec3| match (at - patch.corners[0]).dot(patch.normal) > 0.0 {
                    true => flux(distribution, at, patch.corners, 0),
                    false => 0.0,
                };
                let cell = |k: usize| (k as f64 + 0.5) / POINTS as f64;
                let flux = shining.map_or_else(
                    || from(*at),
                    |shining| {
                        let point =
                            |k: usize| from(*at + shining.sample([cell(k / POINTS), cell(k % POINTS)]));
                        (0..POINTS * POINTS).map(point).sum::<f64>() / (POINTS * POINTS) as f64
                    },
                );
                let area = area(patch.corners);
                if area > 0.0 { flux / (area * unit) } else { 0.0 }
            }
        }
    }

    /// Whether [`Remote::unblocked`] is exact. It is not for a light with an area, where it uses only some points.
    pub(super) fn is_known(&self) -> bool {
        !matches!(self, Remote::Point { area: Some(_), .. })
    }

    /// A path from a point of a patch to the light, and the irradiance that this sample estimates; `None` if the light
    /// is below the patch.
    #[inline]
    pub(super) fn sample(&self, from: &Footprint, [x, y, u, v]: [f32; 4]) -> Option<(Vec3A, Vec3A, f64)> {
        match self {
            Remote::Distant(distant) => {
                let direction = distant.sample([u, v].map(f64::from));
                let cos = direction.dot(from.normal().as_dvec3());
                if cos <= 0.0 {
                    return None;
                }
                let p = from.at(square_to_triangle(x, y));
                let weight = if distant.radius > 0.0 {
                    distant.solid_angle() / (std::f64::consts::PI * distant.radius.sin().powi(2))
                } else {
                    1.0
                };
                Some((p, p + direction.as_vec3a() * FAR_AWAY, cos * weight))
            }
            Remote::Cell(cell) => {
                let direction = cell.sample([u, v].map(f64::from));
                let cos = direction.dot(from.normal().as_dvec3());
                let p = from.at(square_to_triangle(x, y));
                let weight = cos * cell.solid_angle();
                (cos > 0.0).then(|| (p, p + direction.as_vec3a() * FAR_AWAY, weight))
            }
            Remote::Point { at, distribution, area: shining, short, unit } => {
                let at = *at + shining.map_or(DVec3::ZERO, |area| area.sample([u, v].map(f64::from)));
                let at = &at;
                let corners = from.corners.map(|corner| corner.as_dvec3());
                let normal = from.normal().as_dvec3();
                let height = (*at - corners[0]).dot(normal);
                if height <= 0.0 {
                    return None;
                }
                let area = area(corners);
                let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
                let (p, weight) = if middle.distance_squared(*at) * Constants::FAR < area {
                    let (direction, solid_angle) = solid_angle::sample(corners, *at, [x, y].map(f64::from))?;
                    let p = *at - direction * (height / direction.dot(normal));
                    (p, distribution.towards(direction) * solid_angle / area)
                } else {
                    let p = from.at(square_to_triangle(x, y)).as_dvec3();
                    let path = p - *at;
                    let (squared, distance) = (path.length_squared(), path.length());
                    (p, distribution.towards(path / distance) * -path.dot(normal) / (squared * distance))
                };
                let (p, to) = (p.as_vec3a(), at.as_vec3a());
                Some((p, to + (p - to).normalize_or_zero() * *short, weight / unit))
            }
        }
    }

    /// Numbers that identify the samples of the light.
    pub(super) fn words(&self) -> Vec<u64> {
        match self {
            Remote::Distant(d) => {
                d.direction.to_array().into_iter().chain([d.radius]).map(f64::to_bits).collect()
            }
            Remote::Cell(cell) => cell.words(),
            Remote::Point { at, distribution, area, unit, .. } => {
                let axes = area.map(|area| [area.first, area.second, DVec3::splat(f64::from(area.round))]);
                let vectors = axes.iter().flatten().chain([at]).flat_map(|v| v.to_array());
                let numbers = vectors.chain([*unit]).chain(distribution.numbers());
                numbers.map(f64::to_bits).collect()
            }
        }
    }
}

fn area([a, b, c]: [DVec3; 3]) -> f64 {
    0.5 * (b - a).cross(c - a).length()
}

/// The solid angle of a triangle seen from a point (Van Oosterom and Strackee, "The Solid Angle of a Plane Triangle",
/// IEEE Transactions on Biomedical Engineering 30, 1983).
fn subtended(at: DVec3, corners: [DVec3; 3]) -> f64 {
    let [a, b, c] = corners.map(|corner| corner - at);
    let [la, lb, lc] = [a, b, c].map(DVec3::length);
    let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
    2.0 * a.dot(b.cross(c)).abs().atan2(below)
}

/// The integral of a distribution over the solid angle of a triangle.
fn flux(distribution: &Distribution, at: DVec3, corners: [DVec3; 3], cuts: u32) -> f64 {
    let whole = subtended(at, corners);
    if matches!(distribution, Distribution::Isotropic) {
        return whole;
    }
    let towards = |[a, b, c]: [DVec3; 3]| distribution.towards(((a + b + c) / 3.0 - at).normalize_or_zero());
    let [a, b, c] = corners;
    let (ab, bc, ca) = (a.midpoint(b), b.midpoint(c), c.midpoint(a));
    let parts = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [bc, ca, ab]];
    let middle = whole * towards(corners);
    let finer: f64 = parts.iter().map(|&part| subtended(at, part) * towards(part)).sum();
    let even = (finer - middle).abs() <= EVEN * finer.max(1e-3 * whole);
    if cuts >= MOST_CUTS || (cuts > 0 && whole < WIDE && even) {
        // The error of a midpoint rule is proportional to the square of the edge.
        return (finer + (finer - middle) / 3.0).max(0.0);
    }
    parts.iter().map(|&part| flux(distribution, at, part, cuts + 1)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::Side;
    use glam::dvec3;

    /// The integral of intensity over near and far triangles is the mean of many samples.
    #[test]
    fn what_a_point_sends_unblocked_is_the_mean_of_its_samples() {
        let spot = Distribution::spot(dvec3(0.2, 0.1, -1.0), 0.2, 0.7);
        for distribution in [Distribution::Isotropic, spot] {
            for (height, size) in [(0.2, 1.0), (1.0, 0.5), (0.9, 0.02)] {
                let light = Remote::Point {
                    at: dvec3(0.1, 0.2, height),
                    distribution: distribution.clone(),
                    area: None,
                    short: 1e-6,
                    unit: 4.0,
                };
                let corners = [DVec3::ZERO, dvec3(size, 0.0, 0.0), dvec3(0.0, size, 0.0)];
                let from = Footprint {
                    corners: corners.map(|corner| corner.as_vec3a()),
                    side: Side::new(Vec3A::Z, Vec3A::ONE),
                };
                let count = 512;
                let cell = |k: usize| (k as f32 + 0.5) / count as f32;
                let mut mean = 0.0;
                for (i, j) in (0..count).flat_map(|i| (0..count).map(move |j| (i, j))) {
                    let (_, to, weight) = light.sample(&from, [cell(i), cell(j), 0.5, 0.5]).unwrap();
                    assert!((to - Vec3A::new(0.1, 0.2, height as f32)).length() < 2e-6);
                    mean += weight / (count * count) as f64;
                }
                let wanted = light.unblocked(&Facing { corners, normal: DVec3::Z });
                assert!((mean / wanted - 1.0).abs() < 3e-4, "{distribution:?} {height}: {mean} for {wanted}");
                assert_eq!(light.unblocked(&Facing { corners, normal: -DVec3::Z }), 0.0);
            }
        }
    }

    /// An octant of the sphere, and a far triangle, whose solid angle is its area over the squared distance.
    #[test]
    fn solid_angles() {
        let octant = [DVec3::X, DVec3::Y, DVec3::Z].map(|p| 3.0 * p + 1.0);
        assert!((subtended(DVec3::ONE, octant) - 0.5 * std::f64::consts::PI).abs() < 1e-14);
        let far = [dvec3(1e4, 0.0, 0.0), dvec3(1e4, 0.1, 0.0), dvec3(1e4, 0.0, 0.1)];
        assert!((subtended(DVec3::ZERO, far) / 5e-11 - 1.0).abs() < 1e-4);
    }
}
