//! Path tracing: light followed backwards, from where it is wanted to where it was emitted.
//!
//! At a surface the quantity estimated is the mean incoming radiance weighted by the cosine, E/π; so
//! L = Le + ρ E/π holds at every vertex, and the probability density of a cosine-distributed direction cancels
//! everything but ρ.

use std::f64::consts::PI;

use glam::{DVec3, Vec3A};

use super::{Effort, Emitters, Estimate, Samples};
use crate::{
    Progress, Result,
    scene::{Scene, direction},
    trace::{
        Hit, Tracer,
        sampling::{around, square_to_cosine_hemisphere, square_to_triangle},
    },
};

/// A path survives roulette with at most this probability, so that it ends even where nothing absorbs. Where surfaces reflect
/// more than its square root, weights of long paths grow beyond any variance: with 0.98 a furnace of reflectance 0.999 was told
/// less than half as bright as it is, with error bars of a few percent.
const MOST_LIKELY_SURVIVAL: f64 = 0.9999;

/// How far from a surface, in unit space, a point can come to lie when its coordinates are printed with six digits.
const NEAR: f32 = 4e-6;

/// How paths are built. None of it changes the expectation but `max_bounces`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct PathOptions {
    /// Whether each vertex also looks at a point chosen on an emitter. Default true. Without it a path counts only
    /// when it runs into an emitter: slow with small lamps, but with nothing to get wrong.
    pub next_event: bool,
    /// Reflections after which a path is cut, which loses light. 0 keeps direct light only. Default none.
    pub max_bounces: Option<u32>,
    /// Reflections before Russian roulette may end a path. Default 3. `u32::MAX` plays none, and then `max_bounces`
    /// must be given.
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

/// A place that receives light, with the side it receives from; unit space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Receiver {
    /// The point.
    pub position: Vec3A,
    /// Unit normal of the receiving side.
    pub normal: Vec3A,
}

impl Receiver {
    /// A point of a triangle of the scene.
    pub fn on_triangle(tracer: &Tracer, triangle: usize, barycentric: [f64; 3], front: bool) -> Receiver {
        let shape = &tracer.triangles()[triangle];
        Receiver { position: shape.point(barycentric.map(|b| b as f32)), normal: shape.side_normal(front) }
    }

    /// A point in the file's coordinates, which need not lie on a surface. One that lies on a surface but for the
    /// rounding of its printed coordinates is taken to be on it: just below it would be dark.
    ///
    /// # Panics
    /// When the normal is zero or not finite.
    pub fn free(tracer: &Tracer, point: DVec3, normal: DVec3) -> Receiver {
        let normal = direction(normal).expect("a normal has a direction").as_vec3a();
        let given = Receiver { position: tracer.to_unit(point), normal };
        match tracer.closest(given.position + normal * NEAR, -normal) {
            Some(hit) if hit.t < 2.0 * NEAR => {
                let met = Receiver::of_hit(tracer, &hit);
                // Steep surfaces are met by chance, near an edge.
                if met.normal.dot(normal) > 0.7 { Receiver { position: met.position, normal } } else { given }
            }
            _ => given,
        }
    }

    /// Where a hit is, seen from the side that was hit.
    #[inline]
    pub fn of_hit(tracer: &Tracer, hit: &Hit) -> Receiver {
        let shape = &tracer.triangles()[hit.triangle as usize];
        Receiver { position: shape.point(hit.barycentric), normal: shape.side_normal(hit.front) }
    }
}

/// A part of a triangle, one side of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Region {
    /// Index of the triangle in the scene.
    pub triangle: usize,
    /// Barycentric coordinates of the part's corners.
    pub part: [[f64; 3]; 3],
    /// Which side receives.
    pub front: bool,
}

/// Estimates radiance and irradiance by paths from the receiver.
#[derive(Debug)]
pub struct PathTracer<'a> {
    scene: &'a Scene,
    tracer: &'a Tracer,
    emitters: Emitters,
    options: PathOptions,
}

impl<'a> PathTracer<'a> {
    /// Prepares the emitters of the scene.
    ///
    /// # Panics
    /// When the options forbid both roulette and a limit: such a path never ends.
    pub fn new(scene: &'a Scene, tracer: &'a Tracer, options: PathOptions) -> Self {
        assert!(
            options.max_bounces.is_some() || options.roulette_after != u32::MAX,
            "paths without roulette need a limit"
        );
        PathTracer { scene, tracer, emitters: Emitters::new(scene, tracer), options }
    }

    /// The scene's rays.
    pub fn tracer(&self) -> &'a Tracer {
        self.tracer
    }

    /// One sample of the radiance that arrives at `origin` against `direction` (unit space).
    #[inline]
    pub fn radiance(&self, origin: Vec3A, direction: Vec3A, samples: &mut Samples) -> [f64; 3] {
        let Some(hit) = self.tracer.closest(origin, direction) else { return [0.0; 3] };
        let emitted = hit.emission(self.scene);
        if self.options.max_bounces == Some(0) {
            return emitted;
        }
        let reflectance = hit.reflectance(self.scene).into();
        let gathered = self.gather(Receiver::of_hit(self.tracer, &hit), reflectance, 1, samples);
        (DVec3::from(emitted) + gathered).to_array()
    }

    /// One sample of the irradiance of a place, W/m².
    #[inline]
    pub fn irradiance(&self, at: Receiver, samples: &mut Samples) -> [f64; 3] {
        self.gather(at, DVec3::splat(PI), 0, samples).to_array()
    }

    /// Irradiance of places.
    ///
    /// # Errors
    /// [`crate::Error::Stopped`].
    pub fn irradiances(
        &self,
        places: &[Receiver],
        effort: &Effort,
        progress: &Progress,
    ) -> Result<Vec<Estimate>> {
        effort.estimate(places.len(), progress, |i, samples| self.irradiance(places[i], samples))
    }

    /// Mean irradiance of parts of triangles, from points uniform on each part.
    ///
    /// # Errors
    /// [`crate::Error::Stopped`].
    pub fn mean_irradiances(
        &self,
        regions: &[Region],
        effort: &Effort,
        progress: &Progress,
    ) -> Result<Vec<Estimate>> {
        effort.estimate(regions.len(), progress, |i, samples| {
            let Region { triangle, part, front } = &regions[i];
            let [x, y] = samples.square();
            let weights = square_to_triangle(x, y).map(f64::from);
            let barycentric =
                std::array::from_fn(|k| (0..3).map(|corner| weights[corner] * part[corner][k]).sum());
            self.irradiance(Receiver::on_triangle(self.tracer, *triangle, barycentric, *front), samples)
        })
    }

    /// `throughput` times the mean radiance that arrives at a place, weighted by the cosine; `bounces` reflections
    /// lie between the place and the eye, its own included.
    fn gather(
        &self,
        mut at: Receiver,
        mut throughput: DVec3,
        mut bounces: u32,
        samples: &mut Samples,
    ) -> DVec3 {
        let mut sum = DVec3::ZERO;
        if self.emitters.is_empty() {
            return sum;
        }
        loop {
            let (light, hit) = self.look(at, samples);
            sum += throughput * light;
            let Some(hit) = hit else { return sum };
            if self.options.max_bounces.is_some_and(|limit| bounces >= limit) {
                return sum;
            }
            throughput *= DVec3::from(hit.reflectance(self.scene));
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
            at = Receiver::of_hit(self.tracer, &hit);
        }
    }

    /// One sample of the irradiance of a place that comes straight from emitters, W/m², and what the hemisphere ray met
    /// that took part in it.
    #[inline]
    pub(crate) fn direct(&self, at: Receiver, samples: &mut Samples) -> ([f64; 3], Option<Hit>) {
        let (light, hit) = self.look(at, samples);
        ((light * PI).to_array(), hit)
    }

    /// Mean radiance that arrives straight from emitters, weighted by the cosine: a point chosen on one, and a ray with a
    /// cosine distribution. Also what that ray met.
    #[inline]
    fn look(&self, at: Receiver, samples: &mut Samples) -> (DVec3, Option<Hit>) {
        let [x, y] = samples.square();
        let local = square_to_cosine_hemisphere(x, y);
        let origin = Tracer::leave(at.position, at.normal);
        let mut light = DVec3::ZERO;
        if self.options.next_event && !self.emitters.is_empty() {
            light += self.look_at_emitter(origin, at.normal, samples);
        }
        let direction = around(at.normal, local);
        let hit = self.tracer.closest(origin, direction);
        if let Some(hit) = &hit {
            let emitted = DVec3::from(hit.emission(self.scene));
            if emitted != DVec3::ZERO {
                light += emitted * self.bounce_weight(hit, direction, local.z);
            }
        }
        (light, hit)
    }

    /// Le cos θ/π over the density of a point chosen on an emitter, weighted against the same point met by a bounce.
    ///
    /// With the power heuristic (Veach and Guibas, "Optimally Combining Sampling Techniques", SIGGRAPH 95, section 3.3) and
    /// p = cos θ/π the density of a bounce, Le p/q · q²/(p² + q²) = Le / (p/q + q/p): bounded, however near the lamp. With
    /// the balance heuristic the few bounces that meet a small lamp carry p/q of its light, which error bars miss together with
    /// them: at 32 rays a texel a floor under a lamp had 3.7 % of noise, and 83 % of its texels within 3.2 standard errors.
    #[inline]
    fn look_at_emitter(&self, origin: Vec3A, normal: Vec3A, samples: &mut Samples) -> DVec3 {
        let lamp = self.emitters.sample(self.scene, self.tracer, samples);
        let target = Tracer::leave(lamp.position, lamp.normal);
        let to = target - origin;
        let (cos, cos_lamp) = (to.dot(normal), -to.dot(lamp.normal));
        if !(cos > 0.0 && cos_lamp > 0.0) {
            return DVec3::ZERO;
        }
        let squared = f64::from(to.length_squared());
        let bounce = f64::from(cos) / (PI * squared.sqrt());
        let chosen = lamp.density * squared * squared.sqrt() / f64::from(cos_lamp);
        if !self.tracer.visible(origin, target) {
            return DVec3::ZERO;
        }
        let ratio = bounce / chosen;
        DVec3::from(lamp.radiance) / (ratio + ratio.recip())
    }

    /// Weight of emission met by a bounce: 1, or p²/(p² + q²) where the emitter could also have been chosen.
    #[inline]
    fn bounce_weight(&self, hit: &Hit, direction: Vec3A, cos: f32) -> f64 {
        if !self.options.next_event {
            return 1.0;
        }
        let normal = self.tracer.triangles()[hit.triangle as usize].normal;
        let squared = f64::from(hit.t).powi(2) * f64::from(direction.length_squared());
        let cos_lamp = f64::from(direction.dot(normal).abs()).max(f64::MIN_POSITIVE);
        let chosen = self.emitters.density(hit.triangle) * squared / cos_lamp;
        let bounce = f64::from(cos) / PI;
        if bounce > 0.0 { 1.0 / (1.0 + (chosen / bounce).powi(2)) } else { 0.0 }
    }
}
