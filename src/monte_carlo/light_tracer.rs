//! Light tracing: particles followed forwards, from where they are emitted to where they are absorbed.
//!
//! The books of each particle balance to rounding. For the first reflections absorption is continuous: a hit keeps
//! ρ of the particle and books the rest, which spares the variance of dying early. After that the particle dies, or
//! goes on, with probability q = max ρ; it then carries ρ/q of what it had and the hit books the difference
//! 1 − ρ/q ≥ 0, or all of it when the particle dies. The expectation of both is 1 − ρ; the sum of what is booked
//! telescopes to what was emitted; and weights never grow, as they would if roulette paid survivors.

use std::f64::consts::PI;

use glam::{DVec3, Vec3A};
use rayon::prelude::*;

use super::{Camera, Emitters, Estimate, Film, Lens, Samples, estimate::Running, samples::take};
use crate::{
    Error, Progress, Result,
    scene::Scene,
    trace::{
        Hit, Tracer,
        sampling::{around, mix, square_to_cosine_hemisphere},
    },
};

/// A particle that has hit this often will never end: reflectance 0.9999 would have stopped all but one in e¹⁰⁰.
const ENDLESS: u32 = 1_000_000;

/// How particles are followed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct LightOptions {
    /// Particles, rounded up to a multiple of `batches`. Default 2²⁰.
    pub particles: u64,
    /// Independent batches, whose spread gives the standard errors. Default 32.
    pub batches: u32,
    /// Reflections before a particle may die; until then it is absorbed bit by bit. Default 3.
    pub continuous: u32,
    /// Everything is a function of it. Default 1.
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

/// The books of one particle, W: `emitted` = `absorbed` + `escaped` to rounding.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct Particle {
    /// Flux it set out with.
    pub emitted: [f64; 3],
    /// Flux left on surfaces.
    pub absorbed: [f64; 3],
    /// Flux that left the scene.
    pub escaped: [f64; 3],
}

/// What light tracing found, W.
#[derive(Debug, Clone, PartialEq, Default)]
#[non_exhaustive]
pub struct LightTransport {
    /// Flux that arrived in each bin; over the bin's area it is the irradiance.
    pub bins: Vec<Estimate>,
    /// Flux emitted.
    pub emitted: Estimate,
    /// Flux absorbed.
    pub absorbed: Estimate,
    /// Flux that left the scene.
    pub escaped: Estimate,
}

/// A picture made by light tracing, with the totals of the particles that made it.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct LightImage {
    /// Radiance.
    pub film: Film,
    /// Standard error of each pixel.
    pub standard_error: Film,
    /// Totals; no bins.
    pub transport: LightTransport,
}

/// Follows particles through a scene.
#[derive(Debug)]
pub struct LightTracer<'a> {
    scene: &'a Scene,
    tracer: &'a Tracer,
    emitters: Emitters,
    options: LightOptions,
}

/// What one step of a particle gives to those who count.
enum Event<'h> {
    /// Flux arrives.
    Arrives(&'h Hit, DVec3),
    /// Flux leaves a Lambertian surface at a point with this normal.
    Leaves(Vec3A, Vec3A, DVec3),
}

/// Sums of one batch: counters of three channels, and the particles' books.
struct Batch {
    counters: Vec<[f64; 3]>,
    books: [[f64; 3]; 3],
}

impl<'a> LightTracer<'a> {
    /// Prepares the emitters of the scene.
    pub fn new(scene: &'a Scene, tracer: &'a Tracer, options: LightOptions) -> Self {
        LightTracer { scene, tracer, emitters: Emitters::new(scene, tracer), options }
    }

    /// Follows all particles; `bin` tells which of the `bins` counters a hit belongs to, if any.
    ///
    /// # Errors
    /// [`Error::Stopped`]; [`Error::NoEquilibrium`] when particles do not end.
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

    /// Follows all particles and shows every place they leave to the camera.
    ///
    /// # Errors
    /// [`Error::Stopped`]; [`Error::NoEquilibrium`] when particles do not end.
    pub fn image(&self, camera: &Camera, progress: &Progress) -> Result<LightImage> {
        let lens = camera.lens(self.tracer);
        let (width, height) = (camera.width(), camera.height());
        let found = self.run(width * height, progress, |counters, event| {
            if let Event::Leaves(point, normal, flux) = event {
                // Flux carries file areas, distances are of unit space.
                let flux = flux / self.tracer.scale().powi(2);
                self.splat(&lens, point, normal, flux, counters);
            }
        })?;
        let film = |pick: fn(&Estimate) -> [f64; 3]| {
            Film::from_pixels(width, height, found.bins.iter().map(|e| pick(e).map(|x| x as f32)).collect())
        };
        Ok(LightImage {
            film: film(|e| e.mean),
            standard_error: film(|e| e.standard_error),
            transport: LightTransport { bins: Vec::new(), ..found },
        })
    }

    /// Follows particle `index` of the stream `seed`, emitting a `1/count` of the scene's power on average.
    ///
    /// # Errors
    /// [`Error::NoEquilibrium`] when it does not end.
    pub fn particle(&self, index: u32, seed: u64, count: u64) -> Result<Particle> {
        self.follow(&mut Samples::new(index, seed), 1.0 / count as f64, &mut |_| ())
    }

    fn run(
        &self,
        counters: usize,
        progress: &Progress,
        count: impl Fn(&mut [[f64; 3]], Event) + Sync,
    ) -> Result<LightTransport> {
        let LightOptions { particles, batches, .. } = self.options;
        assert!(batches >= 2, "a standard error needs two batches");
        let each = u32::try_from(particles.div_ceil(batches as u64).max(1)).expect("fewer particles a batch");
        progress.begin("tracing light", each as u64 * batches as u64);
        if self.emitters.is_empty() {
            return Ok(LightTransport { bins: vec![Estimate::default(); counters], ..Default::default() });
        }
        // Waves keep no more arrays than threads; folding in the order of the batches makes the sums the same for
        // any number of them.
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

    /// Follows one particle that stands for `share` of all.
    #[inline]
    fn follow(&self, samples: &mut Samples, share: f64, tell: &mut impl FnMut(Event)) -> Result<Particle> {
        let lamp = self.emitters.sample(self.scene, self.tracer, samples);
        let (mut point, mut normal) = (lamp.position, lamp.normal);
        let file_density = lamp.density / self.tracer.scale().powi(2);
        let mut flux = DVec3::from(lamp.radiance) * (PI * share / file_density);
        let emitted = flux;
        let mut absorbed = DVec3::ZERO;
        for hits in 0..ENDLESS {
            tell(Event::Leaves(point, normal, flux));
            let [x, y] = samples.square();
            let direction = around(normal, square_to_cosine_hemisphere(x, y));
            let Some(hit) = self.tracer.closest(Tracer::leave(point, normal), direction) else {
                return Ok(close(emitted, absorbed, flux));
            };
            tell(Event::Arrives(&hit, flux));
            let reflectance = DVec3::from(hit.reflectance(self.scene));
            let q = if hits < self.options.continuous { 1.0 } else { survival(reflectance, flux) };
            let kept = if q < 1.0 && f64::from(samples.number()) >= q {
                DVec3::ZERO
            } else {
                flux * (reflectance / q)
            };
            absorbed += flux - kept;
            flux = kept;
            if flux == DVec3::ZERO {
                return Ok(close(emitted, absorbed, flux));
            }
            let shape = &self.tracer.triangles()[hit.triangle as usize];
            (point, normal) = (shape.point(hit.barycentric), shape.side_normal(hit.front));
        }
        Err(Error::NoEquilibrium)
    }

    /// Adds what the eye sees of flux that leaves a point, as radiance of the pixel it is seen in.
    ///
    /// A pixel is the mean of L over its square of the image plane at distance 1. Of that plane, the area dA at
    /// distance r covers dA cos θ / (r² cos³ θc), θc being the angle to the optical axis; and flux Φ leaving dA as a
    /// Lambertian surface is L dA = Φ/π.
    #[inline]
    fn splat(&self, lens: &Lens, point: Vec3A, normal: Vec3A, flux: DVec3, counters: &mut [[f64; 3]]) {
        let Some((pixel, cos_axis)) = lens.pixel_of(point) else { return };
        let from = Tracer::leave(point, normal);
        let to = lens.eye() - from;
        let cos = to.dot(normal);
        if cos > 0.0 && self.tracer.visible(from, lens.eye()) {
            let squared = f64::from(to.length_squared());
            let cover = f64::from(cos) / (squared * squared.sqrt() * cos_axis.powi(3));
            add(&mut counters[pixel], flux * (cover / (PI * lens.pixel_area())));
        }
    }
}

/// The largest reflectance of the channels that still carry flux.
#[inline]
fn survival(reflectance: DVec3, flux: DVec3) -> f64 {
    (0..3).filter(|&c| flux[c] > 0.0).map(|c| reflectance[c]).fold(0.0, f64::max)
}

#[inline]
fn add(sum: &mut [f64; 3], flux: DVec3) {
    (0..3).for_each(|c| sum[c] += flux[c]);
}

fn close(emitted: DVec3, absorbed: DVec3, escaped: DVec3) -> Particle {
    Particle { emitted: emitted.into(), absorbed: absorbed.into(), escaped: escaped.into() }
}
