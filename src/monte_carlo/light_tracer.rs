//! Light tracing: particles are followed from emission to absorption.
//!
//! The energy of each particle balances to rounding. At the first reflections absorption is continuous: the particle
//! keeps the share ρ and the rest is absorbed, which avoids the variance of early deaths. After that the particle
//! survives with probability q = max ρ. A survivor keeps the share ρ/q, and 1 − ρ/q ≥ 0 is absorbed. If the particle
//! dies, all of it is absorbed. In expectation both rules absorb 1 − ρ, and absorbed and escaped flux sum to the
//! emitted flux. Weights never grow, as they would if roulette raised the weight of survivors.
//!
//! On glossy surfaces ρ is the weight of the sampled direction. Some weights exceed 1, and then the absorbed part is
//! negative. The energy still balances, and the mean is right.

use std::f64::consts::{FRAC_1_PI, PI};

use glam::{DVec3, Vec3A};
use rayon::prelude::*;

use super::{
    Camera, Emitters, Estimate, Film, Lens, Outside, RenderOptions, Samples,
    estimate::Running,
    reflection::{Surface, Surfaces},
    samples::take,
    scattering::{Diffuse, Place, Scattering},
};
use crate::{
    Error, Progress, Result,
    scene::Scene,
    trace::{
        Hit, Side, Tracer,
        sampling::{around, mix, square_to_cosine_hemisphere},
    },
};

/// After this many hits a particle counts as endless. At a reflectance of 0.9999 only one in e¹⁰⁰ has this many.
const ENDLESS: u32 = 1_000_000;

/// Camera rays per pixel for the sky behind the scene.
const BACKGROUND: u32 = 16;

/// Options of [`LightTracer::new`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct LightOptions {
    /// Number of particles, rounded up to a multiple of `batches`. Default 2²⁰.
    pub particles: u64,
    /// Number of independent batches. Their spread gives the standard errors. Default 32.
    pub batches: u32,
    /// Number of reflections before a particle may die. Until then absorption is continuous. Default 3.
    pub continuous: u32,
    /// Seed of all random numbers. Default 1.
    pub seed: u64,
}

setters!(LightOptions {
    with_particles(particles: u64),
    with_batches(batches: u32),
    with_continuous(continuous: u32),
    with_seed(seed: u64),
});

impl Default for LightOptions {
    fn default() -> Self {
        LightOptions { particles: 1 << 20, batches: 32, continuous: 3, seed: 1 }
    }
}

/// The energy balance of one particle, W: `emitted` = `absorbed` + `escaped` to rounding.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct Particle {
    /// Flux at emission. For a particle from the sky, a distant light or a point light that misses the scene, it is 0.
    pub emitted: [f64; 3],
    /// Flux absorbed by surfaces.
    pub absorbed: [f64; 3],
    /// Flux that left the scene.
    pub escaped: [f64; 3],
}

/// Totals of light tracing, W.
#[derive(Debug, Clone, PartialEq, Default)]
#[non_exhaustive]
pub struct LightTransport {
    /// Flux that arrived in each bin. Divided by the area of the bin, this is its irradiance.
    pub bins: Vec<Estimate>,
    /// Flux emitted by surfaces, plus flux from other lights that hits a surface.
    pub emitted: Estimate,
    /// Absorbed flux.
    pub absorbed: Estimate,
    /// Flux that left the scene.
    pub escaped: Estimate,
}

/// A picture from light tracing, with the totals of its particles.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct LightImage {
    /// Radiance, W/(m² sr).
    pub film: Film,
    /// Standard error of each pixel, W/(m² sr).
    pub standard_error: Film,
    /// Totals of all particles, without bins.
    pub transport: LightTransport,
}

/// Follows particles through a scene.
#[derive(Debug)]
pub struct LightTracer<'a> {
    scene: &'a Scene,
    tracer: &'a Tracer,
    emitters: Emitters,
    outside: Outside,
    /// The share of the particles that come from lights that are not surfaces.
    share: f64,
    surfaces: Surfaces,
    /// Whether particles are followed with the code for glossy surfaces.
    glossy: bool,
    options: LightOptions,
}

/// One event of a particle.
enum Event<'h> {
    /// Flux arrives at a hit.
    Arrives(&'h Hit, DVec3),
    /// Flux leaves a point of a side. The function returns this flux per solid angle and cosine in the direction of a
    /// vector.
    Leaves(Vec3A, Side, &'h dyn Fn(Vec3A) -> DVec3),
}

/// A particle at its origin.
struct Begun {
    origin: Vec3A,
    direction: Vec3A,
    flux: DVec3,
    /// Whether it comes from a light that is not a surface.
    is_outside: bool,
}

/// Sums of one batch: the counters, and the emitted, absorbed and escaped flux. Three channels each.
struct Batch {
    counters: Vec<[f64; 3]>,
    books: [[f64; 3]; 3],
}

impl<'a> LightTracer<'a> {
    /// Prepares the emitters of the scene.
    pub fn new(scene: &'a Scene, tracer: &'a Tracer, options: LightOptions) -> Self {
        let (emitters, surfaces) = (Emitters::new(scene, tracer), Surfaces::of(scene));
        let glossy = !surfaces.is_lambertian();
        let outside = Outside::new(scene, tracer);
        let entering = outside.power();
        let share = if entering > 0.0 { entering / (entering + emitters.power()) } else { 0.0 };
        LightTracer { scene, tracer, emitters, outside, share, surfaces, glossy, options }
    }

    /// The same tracer, but all materials use the same number of random numbers per hit; see
    /// [`super::PathTracer::in_step`].
    pub(crate) fn in_step(self) -> Self {
        LightTracer { glossy: true, ..self }
    }

    /// Follows all particles. `bin` returns the index of the bin that a hit belongs to, if any.
    ///
    /// # Errors
    /// [`Error::Stopped`]; [`Error::NoEquilibrium`] if a particle does not end.
    pub fn trace(
        &self,
        bins: usize,
        bin: impl Fn(&Hit) -> Option<usize> + Sync,
        progress: &Progress,
    ) -> Result<LightTransport> {
        self.run(bins, progress, |counters, event| {
            if let Event::Arrives(hit, flux) = event
                && let Some(i) = bin(hit)
            {
                add(&mut counters[i], flux);
            }
        })
    }

    /// Follows all particles and connects each of their vertices to the camera.
    ///
    /// # Errors
    /// [`Error::Stopped`]; [`Error::NoEquilibrium`] if a particle does not end.
    pub fn image(&self, camera: &Camera, progress: &Progress) -> Result<LightImage> {
        let lens = camera.lens(self.tracer);
        let (width, height) = (camera.width(), camera.height());
        let found = self.run(width * height, progress, |counters, event| {
            if let Event::Leaves(point, side, leaving) = event {
                self.splat(&lens, point, side, leaving, counters);
            }
        })?;
        let film = |pick: fn(&Estimate) -> [f64; 3]| {
            Film::from_pixels(width, height, found.bins.iter().map(|e| pick(e).map(|x| x as f32)).collect())
        };
        let mut picture = film(|e| e.mean);
        if !self.outside.is_empty() {
            // No particle from the sky passes the pinhole directly, so camera rays add the visible sky.
            let options = RenderOptions::default().with_samples(BACKGROUND).with_seed(self.options.seed);
            let sky = Film::sample(&lens, &options, progress, |direction, _| {
                match self.tracer.closest(lens.eye(), direction) {
                    Some(_) => [0.0; 3],
                    None => self.scene.lights.seen(direction.as_dvec3()),
                }
            })?;
            picture.add(&sky);
        }
        Ok(LightImage {
            film: picture,
            standard_error: film(|e| e.standard_error),
            transport: LightTransport { bins: Vec::new(), ..found },
        })
    }

    /// The energy balance of each batch, W: emitted, absorbed and escaped flux, per channel.
    ///
    /// # Errors
    /// [`Error::Stopped`]; [`Error::NoEquilibrium`] if a particle does not end.
    pub(crate) fn books(&self, progress: &Progress) -> Result<Vec<[[f64; 3]; 3]>> {
        let LightOptions { batches, .. } = self.options;
        let each = self.particles_of_a_batch();
        progress.begin("tracing light", u64::from(each) * u64::from(batches));
        if self.is_dark() {
            return Ok(vec![[[0.0; 3]; 3]; batches as usize]);
        }
        let books = |b| Ok(self.batch(b, each, 0, progress, &|_, _| ())?.books);
        (0..batches).into_par_iter().map(books).collect()
    }

    /// Whether the scene has no light.
    fn is_dark(&self) -> bool {
        self.emitters.is_empty() && self.share == 0.0
    }

    fn particles_of_a_batch(&self) -> u32 {
        let LightOptions { particles, batches, .. } = self.options;
        u32::try_from(particles.div_ceil(batches.into()).max(1))
            .expect("the particles of a batch fit 32 bits")
    }

    /// Follows particle `index` of the stream `seed`. On average it carries `1/count` of the power of the scene.
    ///
    /// # Errors
    /// [`Error::NoEquilibrium`] if it does not end.
    pub fn particle(&self, index: u32, seed: u64, count: u64) -> Result<Particle> {
        self.follow(&mut Samples::new(index, seed), 1.0 / count as f64, &mut |_| ())
    }

    fn run(
        &self,
        counters: usize,
        progress: &Progress,
        count: impl Fn(&mut [[f64; 3]], Event) + Sync,
    ) -> Result<LightTransport> {
        let LightOptions { batches, .. } = self.options;
        assert!(batches >= 2, "a standard error needs two batches");
        let each = self.particles_of_a_batch();
        progress.begin("tracing light", each as u64 * batches as u64);
        if self.is_dark() {
            return Ok(LightTransport { bins: vec![Estimate::default(); counters], ..Default::default() });
        }
        // Batches run in waves, so there are no more arrays of counters than threads. They are added in order, so the
        // sums do not depend on the number of threads.
        let wave = rayon::current_num_threads().max(1) as u32;
        let mut running = vec![Running::default(); counters + 3];
        for first in (0..batches).step_by(wave as usize) {
            let done: Vec<Batch> = (first..batches.min(first.saturating_add(wave)))
                .into_par_iter()
                .map(|b| self.batch(b, each, counters, progress, &count))
                .collect::<Result<_>>()?;
            running.par_iter_mut().enumerate().for_each(|(i, running)| {
                for (n, batch) in (first + 1..).zip(&done) {
                    let value = batch.counters.get(i).unwrap_or_else(|| &batch.books[i - counters]);
                    running.add(n, DVec3::from(*value));
                }
            });
        }
        let mut bins: Vec<Estimate> = running.iter().map(|r| r.estimate(batches)).collect();
        let books = bins.split_off(counters);
        Ok(LightTransport { bins, emitted: books[0], absorbed: books[1], escaped: books[2] })
    }

    fn batch(
        &self,
        batch: u32,
        each: u32,
        counters: usize,
        progress: &Progress,
        count: &impl Fn(&mut [[f64; 3]], Event),
    ) -> Result<Batch> {
        let seed = mix(&[self.options.seed, batch as u64]);
        let mut sums = Batch { counters: vec![[0.0; 3]; counters], books: [[0.0; 3]; 3] };
        take(each, progress, |i| {
            let mut samples = Samples::new(i, seed);
            let counters = &mut sums.counters[..];
            let books = self.follow(&mut samples, 1.0 / each as f64, &mut |event| count(counters, event))?;
            add(&mut sums.books[0], books.emitted.into());
            add(&mut sums.books[1], books.absorbed.into());
            add(&mut sums.books[2], books.escaped.into());
            Ok(())
        })?;
        Ok(sums)
    }

    /// Follows one particle that carries `share` of the scene's power on average, and reports its events.
    #[inline]
    fn follow(&self, samples: &mut Samples, share: f64, report: &mut impl FnMut(Event)) -> Result<Particle> {
        if self.glossy {
            self.follow_by::<Surface>(samples, share, report)
        } else {
            self.follow_by::<Diffuse>(samples, share, report)
        }
    }

    #[inline]
    fn follow_by<'s, S: Scattering<'s>>(
        &'s self,
        samples: &mut Samples,
        share: f64,
        report: &mut impl FnMut(Event),
    ) -> Result<Particle> {
        let place = Place { scene: self.scene, tracer: self.tracer, surfaces: &self.surfaces };
        let begun = self.begin(samples, share, report);
        let (mut origin, mut direction, mut flux) = (begun.origin, begun.direction, begun.flux);
        let emitted = flux;
        let mut absorbed = DVec3::ZERO;
        for hits in 0..ENDLESS {
            let Some(hit) = self.tracer.closest(origin, direction) else {
                let passes = hits == 0 && begun.is_outside;
                return Ok(if passes { Particle::default() } else { close(emitted, absorbed, flux) });
            };
            report(Event::Arrives(&hit, flux));
            let shape = &self.tracer.triangles()[hit.triangle as usize];
            let (point, side) = (shape.point(hit.barycentric), shape.side(hit.front));
            origin = side.leave(point);
            let (surface, reflectance) = S::met(place, &hit, direction);
            let arrived = flux * reflectance;
            report(Event::Leaves(point, side, &|to| arrived * surface.brdf(to)));
            let bounce = surface.sample(side.normal, samples);
            let weight = bounce.map_or(DVec3::ZERO, |b| b.weight * reflectance);
            let q = if hits < self.options.continuous { 1.0 } else { survival(weight, flux) };
            let kept =
                if q < 1.0 && f64::from(samples.number()) >= q { DVec3::ZERO } else { flux * (weight / q) };
            absorbed += flux - kept;
            flux = kept;
            match bounce {
                Some(bounce) if flux != DVec3::ZERO => direction = bounce.direction,
                _ => return Ok(close(emitted, absorbed, flux)),
            }
        }
        Err(Error::NoEquilibrium)
    }

    /// Emits a particle that carries `share` of the scene's power on average.
    #[inline]
    fn begin(&self, samples: &mut Samples, share: f64, report: &mut impl FnMut(Event)) -> Begun {
        let mut of_lamps = 1.0;
        if self.share > 0.0 {
            let u = f64::from(samples.number());
            if u < self.share {
                let ray = self.outside.emit(u / self.share, samples);
                let flux = ray.flux * (share / self.share);
                return Begun { origin: ray.origin, direction: ray.direction, flux, is_outside: true };
            }
            of_lamps = 1.0 - self.share;
        }
        let lamp = self.emitters.sample(self.scene, self.tracer, samples);
        let (point, side) = (lamp.position, lamp.side);
        let file_density = lamp.density / self.tracer.scale().powi(2);
        let flux = DVec3::from(lamp.radiance) * (PI * share / (file_density * of_lamps));
        report(Event::Leaves(point, side, &|_| flux * FRAC_1_PI));
        let [x, y] = samples.square();
        let direction = around(side.normal, square_to_cosine_hemisphere(x, y));
        Begun { origin: side.leave(point), direction, flux, is_outside: false }
    }

    /// Adds flux that leaves a point to the radiance of the pixel in which the camera sees the point.
    ///
    /// A pixel is the mean of L over its square of the image plane at distance 1. On that plane an area dA at distance
    /// r covers dA cos θ / (r² cos³ θc), where θc is the angle to the optical axis. If flux Φ arrives on dA, then L dA
    /// = f Φ. Light from mirrors never passes the pinhole.
    #[inline]
    fn splat(
        &self,
        lens: &Lens,
        point: Vec3A,
        side: Side,
        leaving: &dyn Fn(Vec3A) -> DVec3,
        counters: &mut [[f64; 3]],
    ) {
        let Some((pixel, cos_axis)) = lens.pixel_of(point) else { return };
        let from = side.leave_towards(point, lens.eye());
        let to = lens.eye() - from;
        let cos = to.dot(side.normal);
        if cos > 0.0 && self.tracer.visible(from, lens.eye()) {
            let squared = f64::from(to.length_squared());
            let cover = f64::from(cos) / (squared * squared.sqrt() * cos_axis.powi(3));
            // The density of flux is per area in scene units, but distances are in unit space.
            let unit = lens.pixel_area() * self.tracer.scale().powi(2);
            add(&mut counters[pixel], leaving(to) * (cover / unit));
        }
    }
}

/// Probability of survival: the largest reflectance among the channels that still carry flux, at most 1.
#[inline]
fn survival(reflectance: DVec3, flux: DVec3) -> f64 {
    (0..3).filter(|&c| flux[c] > 0.0).map(|c| reflectance[c]).fold(0.0, f64::max).min(1.0)
}

#[inline]
fn add(sum: &mut [f64; 3], flux: DVec3) {
    (0..3).for_each(|c| sum[c] += flux[c]);
}

fn close(emitted: DVec3, absorbed: DVec3, escaped: DVec3) -> Particle {
    Particle { emitted: emitted.into(), absorbed: absorbed.into(), escaped: escaped.into() }
}
