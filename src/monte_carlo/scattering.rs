//! How a path goes on from a place. Scenes without gloss have code of their own, made by the compiler from the same source: they pay
//! nothing for what they do not have.

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

/// A scene as paths and particles meet it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place<'s> {
    pub(super) scene: &'s Scene,
    pub(super) tracer: &'s Tracer,
    pub(super) surfaces: &'s Surfaces,
}

/// What a place does with light. Vectors are in unit space; `normal` is that of the side that receives.
pub(super) trait Scattering<'s>: Sized {
    /// The surface that a ray in this direction, a unit vector, met; and a factor of all that it reflects.
    fn met(place: Place<'s>, hit: &Hit, direction: Vec3A) -> (Self, DVec3);

    /// A direction to go on in.
    fn sample(&self, normal: Vec3A, samples: &mut Samples) -> Option<Bounce>;

    /// f cos θ towards a vector of the length given, and the density with which [`Scattering::sample`] chooses that direction; without
    /// what mirrors reflect.
    fn towards(&self, normal: Vec3A, to: Vec3A, length: f64) -> (DVec3, f64);

    /// f towards a vector of any length above the surface, without what mirrors reflect.
    fn brdf(&self, to: Vec3A) -> DVec3;
}

/// Lambertian surfaces only: reflectance is a factor, and all else the same everywhere.
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
