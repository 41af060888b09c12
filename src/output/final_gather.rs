//! Final gather: irradiance at a point from the radiosity solution, with the last bounce sampled by rays.
//!
//! E = E direct + π mean(ρ E' / π). Direct light is sampled as in the path tracer, by rays to points on emitters and by
//! hemisphere rays that hit emitters. Reflected light comes from hemisphere rays with a cosine distribution. At their
//! hits, the direct part of the irradiance E' is sampled in the same way. Only the part that other surfaces have
//! reflected is read from the solution. So the shadows of direct light are sharp, and so is the light that is reflected
//! once. A patch on both sides of a wall does not carry the light of lamps through the wall (Reichert, "A Two-Pass
//! Radiosity Method Driven by Lights and Viewer Position", 1992; Cohen and Wallace, "Radiosity and Realistic Image
//! Synthesis", 1993, section 9.4).

use glam::{DVec3, Vec3A};

use crate::{
    Progress, Result,
    monte_carlo::{Effort, Estimate, PathOptions, PathTracer, Receiver, Samples},
    patch::Patches,
    scene::Scene,
    solve::{Solution, linear::rise_at},
    tone::rgb,
    trace::{
        Hit, Tracer,
        sampling::{around, square_to_cosine_hemisphere},
    },
};

/// One sample of irradiance, W/m², in its two parts.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct Gathered {
    /// Direct light.
    pub direct: [f64; 3],
    /// Light reflected by other surfaces.
    pub reflected: [f64; 3],
    /// The hit of the hemisphere ray.
    pub hit: Option<Hit>,
}

/// Gathers light from a radiosity solution.
#[derive(Debug)]
pub struct FinalGather<'a> {
    scene: &'a Scene,
    tracer: &'a Tracer,
    patches: &'a Patches,
    /// The reflected part of the irradiance of each patch, never negative.
    reflected: Vec<[f64; 3]>,
    /// Slopes of this part over each patch; empty for constant light.
    slopes: Vec<[f64; 2]>,
    direct: PathTracer<'a>,
    rays: u32,
}

impl<'a> FinalGather<'a> {
    /// Prepares to gather with `rays` hemisphere rays per sample, at least one.
    ///
    /// # Panics
    /// If the solution belongs to other patches.
    pub fn new(
        scene: &'a Scene,
        tracer: &'a Tracer,
        patches: &'a Patches,
        solution: &Solution,
        rays: u32,
    ) -> Self {
        let reflected = positive(&solution.reflected, solution.channels);
        assert_eq!(reflected.len(), patches.len(), "the solution belongs to other patches");
        let options = PathOptions { max_bounces: Some(0), ..PathOptions::default() };
        let direct = PathTracer::new(scene, tracer, options);
        let slopes = solution.linear.as_ref().map_or_else(Vec::new, |linear| linear.reflected.clone());
        FinalGather { scene, tracer, patches, reflected, slopes, direct, rays: rays.max(1) }
    }

    /// One sample of the irradiance of a point, W/m².
    pub fn irradiance(&self, at: Receiver, samples: &mut Samples) -> [f64; 3] {
        let direct = DVec3::from(self.direct.irradiance(at, samples));
        let origin = at.side.leave(at.position);
        let mut reflected = DVec3::ZERO;
        for ray in 0..self.rays {
            let mut branch = samples.branch(ray, self.rays);
            let [x, y] = branch.square();
            let direction = around(at.side.normal, square_to_cosine_hemisphere(x, y));
            if let Some(hit) = self.tracer.closest(origin, direction) {
                // The sample is π times the radiance ρ E' / π.
                reflected += self.reflected(&hit, &mut branch);
            }
        }
        (direct + reflected / f64::from(self.rays)).to_array()
    }

    /// One sample of the irradiance of a point from a single hemisphere ray, which serves for direct and reflected
    /// light.
    #[inline]
    pub fn gather(&self, at: Receiver, samples: &mut Samples) -> Gathered {
        let (direct, hit) = self.direct(at, samples);
        let Some(hit) = hit else { return Gathered { direct, ..Gathered::default() } };
        let reflected = self.reflected(&hit, samples).to_array();
        Gathered { direct, reflected, hit: Some(hit) }
    }

    /// One sample of the direct irradiance of a point, and the hit of the hemisphere ray that was used for it.
    #[inline]
    pub(crate) fn direct(&self, at: Receiver, samples: &mut Samples) -> ([f64; 3], Option<Hit>) {
        self.direct.direct(at, samples)
    }

    /// Irradiance of points, W/m². The standard errors are those of the final gather, without the error of the
    /// solution.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped).
    pub fn irradiances(
        &self,
        places: &[Receiver],
        effort: &Effort,
        progress: &Progress,
    ) -> Result<Vec<Estimate>> {
        effort.estimate(places.len(), progress, |i, samples| self.irradiance(places[i], samples))
    }

    /// One sample of the radiance that arrives at `origin` from `direction`, both in unit space. W/(m² sr).
    pub fn radiance(&self, origin: Vec3A, direction: Vec3A, samples: &mut Samples) -> [f64; 3] {
        let Some(hit) = self.tracer.closest(origin, direction) else {
            return self.scene.lights.seen(direction.as_dvec3());
        };
        let irradiance = self.irradiance(Receiver::of_hit(self.tracer, &hit), samples);
        outgoing(self.scene, &hit, irradiance.into())
    }

    /// One sample of the radiosity that a hit point reflects.
    #[inline]
    fn reflected(&self, hit: &Hit, samples: &mut Samples) -> DVec3 {
        let reflectance = DVec3::from(hit.reflectance(self.scene));
        if reflectance == DVec3::ZERO {
            return reflectance;
        }
        let (direct, _) = self.direct(Receiver::of_hit(self.tracer, hit), samples);
        reflectance * (DVec3::from(direct) + self.reflected_before(hit))
    }

    /// The part of the irradiance of a hit point that surfaces have reflected. Zero on backs that no ray of the solution
    /// hit.
    #[inline]
    fn reflected_before(&self, hit: &Hit) -> DVec3 {
        let Some(patch) = self.patches.at(hit.triangle, hit.barycentric, hit.front) else {
            return DVec3::ZERO;
        };
        let (patch, channels) = (patch as usize, self.patches.channels());
        let mut irradiance = DVec3::from(self.reflected[patch]);
        if !self.slopes.is_empty() {
            let there = self.patches.local(patch, hit.barycentric);
            irradiance += DVec3::from(rise_at(&self.slopes, patch, channels, there));
        }
        irradiance.max(DVec3::ZERO)
    }
}

/// Radiance Le + ρ E / π that leaves a hit point with irradiance E, with the values of textures at the point.
pub(crate) fn outgoing(scene: &Scene, hit: &Hit, irradiance: DVec3) -> [f64; 3] {
    let reflected = DVec3::from(hit.reflectance(scene)) * irradiance / std::f64::consts::PI;
    (DVec3::from(hit.emission(scene)) + reflected).to_array()
}

/// Converts interleaved values to red, green and blue. Values below zero, which a solver leaves within its tolerance,
/// become zero.
pub(super) fn positive(values: &[f64], channels: usize) -> Vec<[f64; 3]> {
    values.chunks_exact(channels).map(|v| rgb(v).map(|x| x.max(0.0))).collect()
}
