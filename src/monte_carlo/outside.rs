//! Sampling of lights that are not surfaces, for paths and particles: sky, distant discs and points.

use std::f64::consts::{PI, TAU};

use glam::{DVec3, Vec3A};

use super::Samples;
use crate::{
    scene::{
        Scene,
        light::{Area, Distant, Distribution, LightKind, PointLight, Sky},
    },
    trace::Tracer,
};

/// Length of a shadow ray to a distant light, in unit space. It leaves the scene from any point in it.
const FAR_AWAY: f32 = 4.0;
/// Share of the shadow rays that sample the image of the sky if there are other lights too.
const OF_IMAGE: f64 = 0.5;
/// The power of the sky, by which particles are distributed, is summed over a grid of this many directions per
/// dimension.
const DIRECTIONS: usize = 16;

/// A light at a point in unit space.
#[derive(Debug, Clone)]
struct Point {
    at: Vec3A,
    intensity: DVec3,
    distribution: Distribution,
    area: Option<Area>,
    /// Shadow rays end this far before the light ([`Tracer::mounted`]).
    short: f32,
}

impl Point {
    /// A point on the area that emits, or the position of a light without area.
    fn at(&self, samples: &mut Samples) -> Vec3A {
        match &self.area {
            Some(area) => self.at + area.sample(samples.square().map(f64::from)).as_vec3a(),
            None => self.at,
        }
    }
}

/// The lights of a scene that are not surfaces: sky, distant discs and points.
#[derive(Debug, Clone, Default)]
pub(super) struct Outside {
    sky: Option<Sky>,
    distant: Vec<Distant>,
    points: Vec<Point>,
    /// Corners of the bounding box of all triangles, in unit space.
    bounds: [Vec3A; 2],
    /// Length in scene units of a unit of length in unit space.
    scale: f64,
    /// Cumulative power that enters the bounding box: from the sky, from each disc and from each point.
    powers: Vec<f64>,
}

/// A sampled shadow ray and its light.
pub(super) struct Look {
    /// End of the shadow ray.
    pub(super) target: Vec3A,
    /// Radiance divided by the density of the direction. For a light without size: its irradiance on a surface that
    /// faces it, divided by the probability of choosing the light.
    pub(super) light: DVec3,
    /// Density of the direction; infinite for a light without size.
    pub(super) density: f64,
}

/// A ray of light that enters the scene.
pub(super) struct Ray {
    pub(super) origin: Vec3A,
    pub(super) direction: Vec3A,
    /// Flux of all particles together, estimated from this one.
    pub(super) flux: DVec3,
}

impl Outside {
    /// Collects the lights of a scene that are not surfaces.
    pub(super) fn new(scene: &Scene, tracer: &Tracer) -> Outside {
        let mut outside =
            Outside { sky: scene.lights.sky.clone(), scale: tracer.scale(), ..Outside::default() };
        for light in &scene.lights.list {
            match &light.kind {
                LightKind::Distant(distant) => outside.distant.push(*distant),
                LightKind::Point(PointLight { position, intensity, distribution, area }) => {
                    outside.points.push(Point {
                        at: tracer.to_unit(*position),
                        intensity: DVec3::from(*intensity),
                        distribution: distribution.clone(),
                        area: area.map(|area| Area {
                            first: area.first / tracer.scale(),
                            second: area.second / tracer.scale(),
                            ..area
                        }),
                        short: tracer.mounted(*position),
                    });
                }
            }
        }
        if outside.is_empty() {
            return outside;
        }
        let corners = || tracer.triangles().iter().flat_map(|t| t.corners);
        let bound = |f: fn(Vec3A, Vec3A) -> Vec3A| corners().reduce(f).unwrap_or_default();
        outside.bounds = [bound(Vec3A::min), bound(Vec3A::max)];
        let mut sum = 0.0;
        let powers = outside.powers_of_all().into_iter().map(|power| {
            sum += power;
            sum
        });
        outside.powers = powers.collect();
        outside
    }

    /// Whether there are no such lights.
    pub(super) fn is_empty(&self) -> bool {
        self.sky.is_none() && self.distant.is_empty() && self.points.is_empty()
    }

    /// The power that enters the bounding box, summed over the channels: from the sky, from each disc and from each
    /// point.
    fn powers_of_all(&self) -> Vec<f64> {
        let cell = |k: usize| (k as f64 + 0.5) / DIRECTIONS as f64;
        let of_sky = self.sky.as_ref().map_or(0.0, |sky| {
            let cells = (0..DIRECTIONS * DIRECTIONS).map(|k| [cell(k / DIRECTIONS), cell(k % DIRECTIONS)]);
            let power = |at: [f64; 2]| {
                let (direction, density) = of_sky(sky, at);
                DVec3::from(sky.radiance(direction)).element_sum() * self.shadow(direction) / density
            };
            cells.map(power).sum::<f64>() / (DIRECTIONS * DIRECTIONS) as f64
        });
        let discs = self.distant.iter().map(|d| d.irradiance.iter().sum::<f64>() * self.shadow(d.direction));
        let points = self.points.iter().map(|p| p.intensity.element_sum() * p.distribution.total());
        std::iter::once(of_sky).chain(discs).chain(points).collect()
    }

    /// Total power that enters the bounding box, summed over the channels.
    pub(super) fn power(&self) -> f64 {
        self.powers.last().copied().unwrap_or_default()
    }

    /// Area of the bounding box projected along a direction, in square scene units.
    fn shadow(&self, direction: DVec3) -> f64 {
        self.faces(direction).iter().sum::<f64>() * self.scale * self.scale
    }

    /// For each axis, the projected area of the bounding box's face perpendicular to it, in unit space.
    fn faces(&self, direction: DVec3) -> [f64; 3] {
        let size = (self.bounds[1] - self.bounds[0]).as_dvec3();
        let d = direction.abs();
        [size.y * size.z * d.x, size.z * size.x * d.y, size.x * size.y * d.z]
    }

    /// Approximate largest radiance that a path without light may have missed.
    pub(super) fn brightest(&self) -> [f64; 3] {
        let mut most = self.sky.as_ref().map_or(DVec3::ZERO, |sky| sky.strongest().into());
        most += self.distant.iter().map(|d| DVec3::from(d.irradiance) / PI).sum::<DVec3>();
        most += self.points.iter().map(|p| p.intensity / (PI * self.scale * self.scale)).sum::<DVec3>();
        most.to_array()
    }

    fn sky_seen(&self, direction: DVec3) -> DVec3 {
        self.sky.as_ref().map_or(DVec3::ZERO, |sky| sky.radiance(direction).into())
    }

    /// Radiance of the sky and the discs that a bounce meets when it leaves the scene. `direction` is a unit vector.
    /// With next event estimation, light that [`Outside::look`] could also have sampled gets its weight for multiple
    /// importance sampling.
    pub(super) fn met(
        &self,
        (origin, normal): (Vec3A, Vec3A),
        direction: Vec3A,
        density: f64,
        next_event: bool,
    ) -> DVec3 {
        let towards = direction.as_dvec3();
        let mut light = self.sky_seen(towards);
        let chosen = self.density_of_image(towards);
        if next_event && chosen > 0.0 {
            let share = if self.has_lights() { OF_IMAGE } else { 1.0 };
            light *= weight_of_bounce(share * chosen, density);
        }
        if self.distant.iter().any(|d| d.contains(towards)) {
            let shares = self.shares(origin, normal, next_event);
            let sum: f64 = shares.iter().sum();
            for (disc, share) in self.distant.iter().zip(&shares).filter(|(d, _)| d.contains(towards)) {
                let others = if self.image().is_some() { 1.0 - OF_IMAGE } else { 1.0 };
                let of_disc = others * share / sum * density_of_disc(disc, towards);
                let chosen = if next_event { of_disc } else { 0.0 };
                light += weight_of_bounce(chosen, density) * DVec3::from(disc.radiance());
            }
        }
        light
    }

    /// The sky, if it is an image. Its directions are importance-sampled by brightness.
    fn image(&self) -> Option<&Sky> {
        self.sky.as_ref().filter(|sky| sky.as_image().is_some())
    }

    fn has_lights(&self) -> bool {
        !self.distant.is_empty() || !self.points.is_empty()
    }

    fn density_of_image(&self, direction: DVec3) -> f64 {
        self.image().and_then(|sky| sky.density_of_image(direction)).unwrap_or_default()
    }

    /// Upper bound, summed over the channels, of the unblocked irradiance of a place from each disc, and the value for
    /// each point. Without next event estimation, only lights that no bounce can hit are counted.
    fn shares(&self, origin: Vec3A, normal: Vec3A, next_event: bool) -> Vec<f64> {
        let normal = normal.as_dvec3();
        let disc = |d: &Distant| {
            let most = (normal.dot(d.direction) + d.radius.sin()).clamp(0.0, 1.0);
            let counts = next_event || d.radius == 0.0;
            if counts { most * d.irradiance.iter().sum::<f64>() } else { 0.0 }
        };
        let point = |p: &Point| {
            let path = (p.at - origin).as_dvec3();
            let distance = path.length();
            let arrives = path.dot(normal).max(0.0) / distance.powi(3).max(f64::MIN_POSITIVE);
            let towards = p.distribution.towards(-path / distance.max(f64::MIN_POSITIVE));
            p.intensity.element_sum() * towards * arrives / (self.scale * self.scale)
        };
        self.distant.iter().map(disc).chain(self.points.iter().map(point)).collect()
    }

    /// Samples a shadow ray from a place: to the image of the sky, or to a disc or point chosen in proportion to
    /// [`Outside::shares`]. `None` if no light can reach the place.
    pub(super) fn look(
        &self,
        origin: Vec3A,
        normal: Vec3A,
        next_event: bool,
        samples: &mut Samples,
    ) -> Option<Look> {
        let mut others = 1.0;
        if let Some(sky) = self.image().filter(|_| next_event) {
            let share = if self.has_lights() { OF_IMAGE } else { 1.0 };
            if share == 1.0 || f64::from(samples.number()) < share {
                let (direction, density) = sky.sample_image(samples.square().map(f64::from))?;
                let density = share * density;
                let light = DVec3::from(sky.radiance(direction)) / density;
                return Some(Look { target: origin + direction.as_vec3a() * FAR_AWAY, light, density });
            }
            others = 1.0 - share;
        }
        if !self.has_lights() {
            return None;
        }
        let shares = self.shares(origin, normal, next_event);
        let sum: f64 = shares.iter().sum();
        if !(sum > 0.0 && sum.is_finite()) {
            return None;
        }
        let (x, y) = samples.fine_square();
        let (mut rest, mut k) = (x * sum, 0);
        while k + 1 < shares.len() && (rest >= shares[k] || shares[k] == 0.0) {
            rest -= shares[k];
            k += 1;
        }
        let probability = others * shares[k] / sum;
        if probability == 0.0 {
            return None;
        }
        let Some(disc) = self.distant.get(k) else {
            let point = &self.points[k - self.distant.len()];
            let at = point.at(samples);
            let path = origin - at;
            let squared = f64::from(path.length_squared());
            let towards = point.distribution.towards((path / squared.sqrt() as f32).as_dvec3().normalize());
            return Some(Look {
                target: at + path.normalize_or_zero() * point.short,
                light: point.intensity * (towards / (squared * self.scale * self.scale * probability)),
                density: f64::INFINITY,
            });
        };
        let rest = (rest / shares[k]).clamp(0.0, 1.0);
        let direction = in_disc(disc, [rest, y.into()]);
        let target = origin + direction.as_vec3a() * FAR_AWAY;
        Some(if disc.radius == 0.0 {
            Look { target, light: DVec3::from(disc.irradiance) / probability, density: f64::INFINITY }
        } else {
            let density = probability * density_of_disc(disc, direction);
            Look { target, light: DVec3::from(disc.radiance()) / density, density }
        })
    }

    /// Emits a particle. The uniform number `u` chooses its light by power.
    pub(super) fn emit(&self, u: f64, samples: &mut Samples) -> Ray {
        let end = self.power();
        let k = self.powers.partition_point(|&p| p <= u * end).min(self.powers.len() - 1);
        let below = if k > 0 { self.powers[k - 1] } else { 0.0 };
        let probability = (self.powers[k] - below) / end;
        let at = samples.square().map(f64::from);
        if k > self.distant.len() {
            let point = &self.points[k - 1 - self.distant.len()];
            let (direction, density) = of_point(&point.distribution, at);
            let flux = point.intensity * (point.distribution.towards(direction) / (density * probability));
            return Ray { origin: point.at(samples), direction: direction.as_vec3a(), flux };
        }
        let (towards, light) = match k.checked_sub(1) {
            None => {
                let sky = self.sky.as_ref().expect("the sky has power");
                let (direction, density) = of_sky(sky, at);
                (direction, DVec3::from(sky.radiance(direction)) / density)
            }
            Some(k) => {
                let disc = &self.distant[k];
                let direction = in_disc(disc, at);
                // Radiance over density: the irradiance of a plane that faces this direction.
                (direction, DVec3::from(disc.irradiance) / direction.dot(disc.direction))
            }
        };
        let origin = self.entry(towards, samples);
        let flux = light * (self.shadow(towards) / probability);
        Ray { origin, direction: -towards.as_vec3a(), flux }
    }

    /// A point outside the bounding box, uniform over the box's projection along a direction.
    fn entry(&self, towards: DVec3, samples: &mut Samples) -> Vec3A {
        let faces = self.faces(towards);
        let [x, y] = samples.square();
        let mut rest = f64::from(x) * faces.iter().sum::<f64>();
        let mut axis = 0;
        while axis < 2 && (rest >= faces[axis] || faces[axis] == 0.0) {
            rest -= faces[axis];
            axis += 1;
        }
        let x = (rest / faces[axis].max(f64::MIN_POSITIVE)).clamp(0.0, 1.0) as f32;
        let [low, high] = self.bounds;
        let mut point = low;
        let along = |axis: usize, share: f32| low[axis] + (high[axis] - low[axis]) * share;
        let (first, second) = ((axis + 1) % 3, (axis + 2) % 3);
        point[first] = along(first, x);
        point[second] = along(second, y);
        point[axis] = if towards[axis] > 0.0 { high[axis] } else { low[axis] };
        point + towards.as_vec3a()
    }
}

/// Weight by the power heuristic of light that a bounce hit with probability `density` and that next event estimation
/// could have chosen with probability `chosen`, both per solid angle.
#[inline]
pub(super) fn weight_of_bounce(chosen: f64, density: f64) -> f64 {
    // The density of a mirror is infinite.
    if density > 0.0 { 1.0 / (1.0 + (chosen / density).powi(2)) } else { 0.0 }
}

/// A direction to a disc, uniform over the disc's projection onto the plane that faces it.
fn in_disc(disc: &Distant, [u, v]: [f64; 2]) -> DVec3 {
    let sin = disc.radius.sin() * u.sqrt();
    let (y, x) = (TAU * v).sin_cos();
    let (a, b) = disc.direction.any_orthonormal_pair();
    (a * x + b * y) * sin + disc.direction * (1.0 - sin * sin).sqrt()
}

/// The density of [`in_disc`] over solid angle.
fn density_of_disc(disc: &Distant, direction: DVec3) -> f64 {
    direction.dot(disc.direction).max(0.0) / (PI * disc.radius.sin().powi(2))
}

/// A direction to the sky and its density: by the brightness of an image, otherwise uniform over the hemisphere above
/// the horizon.
fn of_sky(sky: &Sky, [u, v]: [f64; 2]) -> (DVec3, f64) {
    if let Some(sample) = sky.sample_image([u, v]) {
        return sample;
    }
    (sky.up().direction(TAU * u, v.asin()), 1.0 / TAU)
}

/// A direction from a point light and its density: uniform over the cone of a spot, otherwise over the sphere.
fn of_point(distribution: &Distribution, [u, v]: [f64; 2]) -> (DVec3, f64) {
    let (axis, outer) = match distribution {
        Distribution::Spot { axis, outer, .. } => (*axis, *outer),
        Distribution::Isotropic | Distribution::Web(_) => (DVec3::Z, -1.0),
    };
    let cos = 1.0 - u * (1.0 - outer);
    let sin = (1.0 - cos * cos).max(0.0).sqrt();
    let (y, x) = (TAU * v).sin_cos();
    let (a, b) = axis.any_orthonormal_pair();
    ((a * x + b * y) * sin + axis * cos, 1.0 / (TAU * (1.0 - outer)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{
        Material,
        light::{Light, SkyModel, Up},
    };
    use glam::dvec3;

    fn boxed(lights: Vec<LightKind>, sky: Option<Sky>) -> (Scene, Tracer) {
        let corners = [dvec3(0.0, 0.0, 0.0), dvec3(3.0, 0.0, 0.0), dvec3(0.0, 2.0, 1.0)];
        let mut scene = Scene::new(&[(corners, 0)], vec![Material::new("m", [0.5; 3], [0.0; 3])]);
        scene.lights.list = lights.into_iter().map(|kind| Light::new("", kind)).collect();
        scene.lights.sky = sky;
        let tracer = Tracer::new(&scene);
        (scene, tracer)
    }

    /// The mean flux of the particles is the power that enters the bounding box. Discs and sky contribute in proportion
    /// to the projected area of the box, points by their intensity.
    #[test]
    fn particles_carry_the_power_that_goes_into_the_box() {
        let sun = Distant::new(dvec3(0.3, 0.5, 1.0), [2.0; 3], 0.5);
        let spot = PointLight::new(dvec3(1.0, 1.0, 2.0), [3.0; 3], Distribution::spot(-DVec3::Z, 0.2, 0.6));
        let sky = Sky::with_irradiance(SkyModel::Overcast, Up::Z, [4.0; 3]);
        for (lights, sky) in [
            (vec![LightKind::Distant(sun)], None),
            (vec![LightKind::Point(spot.clone())], None),
            (vec![], Some(sky.clone())),
            (vec![LightKind::Distant(sun), LightKind::Point(spot)], Some(sky)),
        ] {
            let (scene, tracer) = boxed(lights, sky);
            let outside = Outside::new(&scene, &tracer);
            let many = 1 << 14;
            let mut flux = 0.0;
            for k in 0..many {
                let mut samples = Samples::new(k, 7);
                let u = f64::from(samples.number());
                flux += outside.emit(u, &mut samples).flux.x / f64::from(many);
            }
            let wanted = outside.power() / 3.0;
            assert!((flux / wanted - 1.0).abs() < 0.03, "{flux} for {wanted}");
        }
    }
}
