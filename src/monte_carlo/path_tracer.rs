//! Path tracing: light is followed backwards, from the receiver to the emitters.
//!
//! At a Lambertian surface L = Le + ρ E/π. If directions have a cosine density, the weight of a bounce is ρ. On glossy
//! surfaces directions are sampled from the lobes, and the weight of a bounce is f cos θ over the density.

use std::f64::consts::PI;

use glam::{DVec3, Vec3A};

use super::{
    Effort, Emitters, Estimate, Outside, Samples,
    outside::weight_of_bounce,
    reflection::{Bounce, Surface, Surfaces},
    scattering::{Diffuse, Place, Scattering},
};
use crate::{
    Progress, Result,
    scene::{Scene, in_triangle},
    trace::{
        Hit, Side, Tracer,
        sampling::{around, sobol_4d, square_to_cosine_hemisphere, square_to_triangle},
    },
};

/// Largest probability that a path survives roulette, so that paths end even if nothing absorbs. If reflectances exceed
/// its square root, the variance of long paths is infinite. With 0.98, the estimate for a furnace of reflectance 0.999
/// was less than half of the true value, with error bars of a few percent.
const MOST_LIKELY_SURVIVAL: f64 = 0.9999;

/// Options of [`PathTracer::new`]. Only `max_bounces` changes the expectation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct PathOptions {
    /// Next event estimation: whether each vertex also connects to a point on an emitter. Default true. Without it,
    /// light counts only if a path hits an emitter. This is slow with small lamps, but simple enough to serve as a
    /// check.
    pub next_event: bool,
    /// Number of reflections after which a path ends, which loses light. 0 means direct light only. Default `None`: no
    /// limit.
    pub max_bounces: Option<u32>,
    /// Number of reflections before Russian roulette may end a path. Default 3. `u32::MAX` means no roulette, and then
    /// `max_bounces` is required.
    pub roulette_after: u32,
}

setters!(PathOptions {
    with_next_event(next_event: bool),
    with_max_bounces(max_bounces: Option<u32>),
    with_roulette_after(roulette_after: u32),
});

impl Default for PathOptions {
    fn default() -> Self {
        PathOptions { next_event: true, max_bounces: None, roulette_after: 3 }
    }
}

/// A point that receives light on one side, in unit space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Receiver {
    /// The point.
    pub position: Vec3A,
    /// The receiving side.
    pub side: Side,
}

impl Receiver {
    /// A point on the front or back of a triangle of the scene.
    pub fn on_triangle(tracer: &Tracer, triangle: usize, barycentric: [f64; 3], front: bool) -> Receiver {
        let shape = &tracer.triangles()[triangle];
        Receiver { position: shape.point(barycentric.map(|b| b as f32)), side: shape.side(front) }
    }

    /// A point in scene coordinates ([`Tracer::place`]).
    ///
    /// # Panics
    /// If the normal is zero or not finite.
    pub fn free(tracer: &Tracer, point: DVec3, normal: DVec3) -> Receiver {
        let (position, side) = tracer.place(point, normal);
        Receiver { position, side }
    }

    /// Whether the point sees the backs of faces in almost all directions, with cosine weight: it lies below a surface or inside a
    /// solid.
    pub fn is_buried(&self, tracer: &Tracer) -> bool {
        const RAYS: u32 = 64;
        const MOSTLY: f64 = 0.9;
        let origin = self.side.leave(self.position);
        let sees_back = |&k: &u32| {
            let [x, y, ..] = sobol_4d(k, 0);
            let direction = around(self.side.normal, square_to_cosine_hemisphere(x, y));
            tracer.closest(origin, direction).is_some_and(|hit| !hit.front)
        };
        (0..RAYS).filter(sees_back).count() as f64 >= MOSTLY * f64::from(RAYS)
    }

    /// The point of a hit, on the side that was hit.
    #[inline]
    pub fn of_hit(tracer: &Tracer, hit: &Hit) -> Receiver {
        let shape = &tracer.triangles()[hit.triangle as usize];
        Receiver { position: shape.point(hit.barycentric), side: shape.side(hit.front) }
    }
}

/// One side of a part of a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Region {
    /// Index of the triangle in the scene.
    pub triangle: usize,
    /// Barycentric coordinates of the part's corners.
    pub part: [[f64; 3]; 3],
    /// Whether the front receives light; otherwise the back does.
    pub front: bool,
}

/// Estimates radiance and irradiance by paths from the receiver.
#[derive(Debug)]
pub struct PathTracer<'a> {
    scene: &'a Scene,
    tracer: &'a Tracer,
    emitters: Emitters,
    outside: Outside,
    surfaces: Surfaces,
    /// Whether paths are followed with the code for glossy surfaces.
    glossy: bool,
    options: PathOptions,
}

impl<'a> PathTracer<'a> {
    /// Prepares the emitters of the scene.
    ///
    /// # Panics
    /// If the options have neither roulette nor a limit, because paths would never end.
    pub fn new(scene: &'a Scene, tracer: &'a Tracer, options: PathOptions) -> Self {
        assert!(
            options.max_bounces.is_some() || options.roulette_after != u32::MAX,
            "paths without roulette need a limit"
        );
        let (emitters, surfaces) = (Emitters::new(scene, tracer), Surfaces::of(scene));
        let glossy = !surfaces.is_lambertian();
        let outside = Outside::new(scene, tracer);
        PathTracer { scene, tracer, emitters, outside, surfaces, glossy, options }
    }

    /// The same tracer, but all materials use the same number of random numbers per bounce. Then runs with the same
    /// seed on scenes that differ only in materials are correlated, so their difference has a smaller error than each
    /// result.
    pub(crate) fn in_step(self) -> Self {
        PathTracer { glossy: true, ..self }
    }

    /// The ray tracer of the scene.
    pub fn tracer(&self) -> &'a Tracer {
        self.tracer
    }

    /// One sample of the radiance that arrives at `origin` from `direction`, both in unit space. W/(m² sr).
    #[inline]
    pub fn radiance(&self, origin: Vec3A, direction: Vec3A, samples: &mut Samples) -> [f64; 3] {
        if self.glossy {
            self.radiance_by::<Surface>(origin, direction, samples)
        } else {
            self.radiance_by::<Diffuse>(origin, direction, samples)
        }
    }

    #[inline]
    fn radiance_by<'s, S: Scattering<'s>>(
        &'s self,
        origin: Vec3A,
        direction: Vec3A,
        samples: &mut Samples,
    ) -> [f64; 3] {
        let Some(hit) = self.tracer.closest(origin, direction) else {
            return self.scene.lights.seen(direction.as_dvec3());
        };
        let emitted = hit.emission(self.scene);
        if self.options.max_bounces == Some(0) {
            return emitted;
        }
        let (surface, reflectance) = S::met(self.place(), &hit, direction.normalize());
        let gathered = self.gather(Receiver::of_hit(self.tracer, &hit), surface, reflectance, 1, samples);
        (DVec3::from(emitted) + gathered).to_array()
    }

    /// One sample of the irradiance of a point, W/m².
    #[inline]
    pub fn irradiance(&self, at: Receiver, samples: &mut Samples) -> [f64; 3] {
        let factor = DVec3::splat(PI);
        let found = if self.glossy {
            self.gather(at, Surface::receiver(at.side.normal), factor, 0, samples)
        } else {
            self.gather(at, Diffuse, factor, 0, samples)
        };
        found.to_array()
    }

    /// Irradiance of points, W/m². One estimate per point.
    ///
    /// A mean of zero does not prove darkness: all samples may have missed the light. If every sample is zero, the
    /// standard error is therefore the change of the mean if one of the samples had hit the brightest emitter.
    ///
    /// # Errors
    /// [`crate::Error::Stopped`].
    pub fn irradiances(
        &self,
        places: &[Receiver],
        effort: &Effort,
        progress: &Progress,
    ) -> Result<Vec<Estimate>> {
        let estimate = |i: usize, samples: &mut Samples| self.irradiance(places[i], samples);
        let mut estimates = effort.estimate(places.len(), progress, estimate)?;
        let brightest = DVec3::from(self.emitters.brightest()).max(self.outside.brightest().into());
        let one = brightest * (PI / f64::from(effort.samples));
        for Estimate { mean, standard_error } in &mut estimates {
            for c in (0..3).filter(|&c| mean[c] == 0.0) {
                standard_error[c] = one[c];
            }
        }
        Ok(estimates)
    }

    /// Mean irradiance of parts of triangles, W/m², from points uniform on each part. One estimate per part.
    ///
    /// # Errors
    /// [`crate::Error::Stopped`].
    pub fn mean_irradiances(
        &self,
        regions: &[Region],
        effort: &Effort,
        progress: &Progress,
    ) -> Result<Vec<Estimate>> {
        effort.estimate(regions.len(), progress, |i, samples| self.irradiance_of(&regions[i], samples))
    }

    /// As [`PathTracer::mean_irradiances`], but returns the means of the replicates, part by part.
    pub(crate) fn replicates_of_irradiance(
        &self,
        regions: &[Region],
        effort: &Effort,
        progress: &Progress,
    ) -> Result<Vec<[f64; 3]>> {
        effort.replicates(regions.len(), progress, |i, samples| self.irradiance_of(&regions[i], samples))
    }

    fn irradiance_of(&self, region: &Region, samples: &mut Samples) -> [f64; 3] {
        let Region { triangle, part, front } = region;
        let [x, y] = samples.square();
        let weights = square_to_triangle(x, y).map(f64::from);
        let barycentric = in_triangle(weights, part);
        self.irradiance(Receiver::on_triangle(self.tracer, *triangle, barycentric, *front), samples)
    }

    /// One sample of `throughput` times the radiance that a point reflects. `bounces` is the number of reflections
    /// between the light that arrives at the point and the eye, including the reflection at the point.
    fn gather<'s, S: Scattering<'s>>(
        &'s self,
        mut at: Receiver,
        mut surface: S,
        mut throughput: DVec3,
        mut bounces: u32,
        samples: &mut Samples,
    ) -> DVec3 {
        let mut sum = DVec3::ZERO;
        if self.emitters.is_empty() && self.outside.is_empty() {
            return sum;
        }
        loop {
            let (light, met) = self.look(at, &surface, samples);
            sum += throughput * light;
            let Some((hit, bounce)) = met else { return sum };
            if self.options.max_bounces.is_some_and(|limit| bounces >= limit) {
                return sum;
            }
            let (next, reflectance) = S::met(self.place(), &hit, bounce.direction);
            throughput *= bounce.weight * reflectance;
            bounces += 1;
            if bounces > self.options.roulette_after {
                let survival = throughput.max_element().min(MOST_LIKELY_SURVIVAL);
                if f64::from(samples.number()) >= survival {
                    return sum;
                }
                throughput /= survival;
            }
            if throughput == DVec3::ZERO {
                return sum;
            }
            (at, surface) = (Receiver::of_hit(self.tracer, &hit), next);
        }
    }

    fn place(&self) -> Place<'_> {
        Place { scene: self.scene, tracer: self.tracer, surfaces: &self.surfaces }
    }

    /// One sample of the direct irradiance of a point, W/m², and the hit of the hemisphere ray that was used for it.
    #[inline]
    pub(crate) fn direct(&self, at: Receiver, samples: &mut Samples) -> ([f64; 3], Option<Hit>) {
        let (light, met) = self.look(at, &Diffuse, samples);
        ((light * PI).to_array(), met.map(|(hit, _)| hit))
    }

    /// One sample of the radiance that a point reflects from direct light, by multiple importance sampling of a point
    /// on an emitter and of a hemisphere ray. Also returns the hit of that ray.
    #[inline]
    fn look<'s, S: Scattering<'s>>(
        &'s self,
        at: Receiver,
        surface: &S,
        samples: &mut Samples,
    ) -> (DVec3, Option<(Hit, Bounce)>) {
        let bounce = surface.sample(at.side.normal, samples);
        let origin = at.side.leave(at.position);
        let mut light = DVec3::ZERO;
        if self.options.next_event && !self.emitters.is_empty() {
            light += self.look_at_emitter(at, surface, samples);
        }
        if !self.outside.is_empty() {
            light += self.look_outside(at, surface, samples);
        }
        let Some(bounce) = bounce else { return (light, None) };
        let hit = self.tracer.closest(origin, bounce.direction);
        if hit.is_none() && !self.outside.is_empty() {
            let (place, next_event) = ((origin, at.side.normal), self.options.next_event);
            let towards = bounce.direction.normalize();
            light += bounce.weight * self.outside.met(place, towards, bounce.density, next_event);
        }
        if let Some(hit) = &hit {
            let emitted = DVec3::from(hit.emission(self.scene));
            if emitted != DVec3::ZERO {
                light += emitted * bounce.weight * self.bounce_weight(hit, &bounce);
            }
        }
        (light, hit.map(|hit| (hit, bounce)))
    }

    /// Le f cos θ over the density q of a point chosen on an emitter, times the weight by the power heuristic against a
    /// bounce that hits the same point.
    ///
    /// The power heuristic is by Veach and Guibas ("Optimally Combining Sampling Techniques", SIGGRAPH 95, section
    /// 3.3). Let p be the density of a bounce, which is f cos θ/ρ for Lambertian surfaces. Then Le p/q · q²/(p² + q²)
    /// is bounded, even near a lamp. With the balance heuristic, the few bounces that hit a small lamp carry p/q of its
    /// light. Error bars miss this light if they miss these bounces: with 32 rays per texel, a floor under a lamp had
    /// 3.7 % of noise, and only 83 % of its texels were within 3.2 standard errors.
    #[inline]
    fn look_at_emitter<'s, S: Scattering<'s>>(
        &self,
        at: Receiver,
        surface: &S,
        samples: &mut Samples,
    ) -> DVec3 {
        let lamp = self.emitters.sample(self.scene, self.tracer, samples);
        let normal = at.side.normal;
        let origin = at.side.leave_towards(at.position, lamp.position);
        let target = lamp.side.leave_towards(lamp.position, at.position);
        let to = target - origin;
        let (cos, cos_lamp) = (to.dot(normal), -to.dot(lamp.side.normal));
        if !(cos > 0.0 && cos_lamp > 0.0) {
            return DVec3::ZERO;
        }
        let squared = f64::from(to.length_squared());
        let length = squared.sqrt();
        let (reflected, bounce) = surface.towards(normal, to, length);
        let chosen = lamp.density * squared * length / f64::from(cos_lamp);
        // A mirror reflects no light of a sampled point: no need to ask whether the point is visible.
        if reflected == DVec3::ZERO || !self.tracer.visible(origin, target) {
            return DVec3::ZERO;
        }
        DVec3::from(lamp.radiance) * reflected * (chosen / (bounce * bounce + chosen * chosen))
    }

    /// The same as [`PathTracer::look_at_emitter`] for lights that are not surfaces. No bounce can hit a light without
    /// size, so its weight is 1.
    #[inline]
    fn look_outside<'s, S: Scattering<'s>>(&self, at: Receiver, surface: &S, samples: &mut Samples) -> DVec3 {
        let normal = at.side.normal;
        let Some(look) = self.outside.look(at.position, normal, self.options.next_event, samples) else {
            return DVec3::ZERO;
        };
        let origin = at.side.leave_towards(at.position, look.target);
        let to = look.target - origin;
        if to.dot(normal) <= 0.0 {
            return DVec3::ZERO;
        }
        let (reflected, bounce) = surface.towards(normal, to, f64::from(to.length()));
        if reflected == DVec3::ZERO || !self.tracer.visible(origin, look.target) {
            return DVec3::ZERO;
        }
        look.light * reflected / (1.0 + (bounce / look.density).powi(2))
    }

    /// Weight of emission that a bounce hits: 1 without next event estimation, otherwise p²/(p² + q²).
    #[inline]
    fn bounce_weight(&self, hit: &Hit, bounce: &Bounce) -> f64 {
        if !self.options.next_event {
            return 1.0;
        }
        let normal = self.tracer.triangles()[hit.triangle as usize].normal;
        let squared = f64::from(hit.t).powi(2) * f64::from(bounce.direction.length_squared());
        let cos_lamp = f64::from(bounce.direction.dot(normal).abs()).max(f64::MIN_POSITIVE);
        let chosen = self.emitters.density(hit.triangle, hit.barycentric) * squared / cos_lamp;
        weight_of_bounce(chosen, bounce.density)
    }
}
