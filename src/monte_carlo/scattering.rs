//! Scattering of paths at surfaces. The compiler makes separate code for scenes without gloss from the same source, so
//! scenes without gloss pay nothing for it.

use std::f64::consts::{FRAC_1_PI, PI};

use glam::{DVec3, Vec3A};

use super::{
    Samples,
    reflection::{Bounce, Surface, Surfaces},
};
use crate::{
    scene::Scene,
    trace::{
        Hit, Tracer,
        sampling::{around, square_to_cosine_hemisphere},
    },
};

/// The scene, its ray tracer and its materials, for paths and particles.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place<'s> {
    pub(super) scene: &'s Scene,
    pub(super) tracer: &'s Tracer,
    pub(super) surfaces: &'s Surfaces,
}

/// Scattering at a point. Vectors are in unit space. `normal` is the normal of the side that receives light.
pub(super) trait Scattering<'s>: Sized {
    /// The surface at a hit, and a factor of all light that it reflects. `direction` is the unit direction of the ray.
    fn met(place: Place<'s>, hit: &Hit, direction: Vec3A) -> (Self, DVec3);

    /// Samples the direction in which the path continues.
    fn sample(&self, normal: Vec3A, samples: &mut Samples) -> Option<Bounce>;

    /// f cos θ in the direction of a vector of the given length, and the density of [`Scattering::sample`] for this
    /// direction. Mirror reflection is not included.
    fn towards(&self, normal: Vec3A, to: Vec3A, length: f64) -> (DVec3, f64);

    /// f in the direction of a vector of any length above the surface. Mirror reflection is not included.
    fn brdf(&self, to: Vec3A) -> DVec3;
}

/// Scattering in scenes with Lambertian surfaces only. The reflectance is the factor from [`Scattering::met`].
#[derive(Debug, Clone, Copy)]
pub(super) struct Diffuse;

impl<'s> Scattering<'s> for Diffuse {
    #[inline]
    fn met(place: Place<'s>, hit: &Hit, _: Vec3A) -> (Diffuse, DVec3) {
        (Diffuse, hit.reflectance(place.scene).into())
    }

    #[inline]
    fn sample(&self, normal: Vec3A, samples: &mut Samples) -> Option<Bounce> {
        let [x, y] = samples.square();
        let local = square_to_cosine_hemisphere(x, y);
        let density = f64::from(local.z) / PI;
        Some(Bounce { direction: around(normal, local), weight: DVec3::ONE, density })
    }

    #[inline]
    fn towards(&self, normal: Vec3A, to: Vec3A, length: f64) -> (DVec3, f64) {
        let density = f64::from(to.dot(normal)) / (PI * length);
        (DVec3::splat(density), density)
    }

    #[inline]
    fn brdf(&self, _: Vec3A) -> DVec3 {
        DVec3::splat(FRAC_1_PI)
    }
}

impl<'s> Scattering<'s> for Surface<'s> {
    fn met(place: Place<'s>, hit: &Hit, direction: Vec3A) -> (Surface<'s>, DVec3) {
        let triangle = &place.tracer.triangles()[hit.triangle as usize];
        (Surface::met(place.surfaces, place.scene, triangle, hit, direction), DVec3::ONE)
    }

    fn sample(&self, _: Vec3A, samples: &mut Samples) -> Option<Bounce> {
        Surface::sample(self, samples)
    }

    fn towards(&self, _: Vec3A, to: Vec3A, length: f64) -> (DVec3, f64) {
        Surface::towards(self, to / length as f32)
    }

    fn brdf(&self, to: Vec3A) -> DVec3 {
        Surface::brdf(self, to.normalize())
    }
}
