//! Daylight coefficients of patches and points.

use std::f64::consts::PI;

use glam::DVec3;
use rayon::prelude::*;

use super::SkyParts;
use crate::{
    Error, Progress, Result,
    form_factor::{CastOptions, FormFactors},
    patch::Patches,
    rays::{ESCAPED, footprint::Footprint},
    scene::{
        Scene,
        light::{Lights, Sky, Up},
    },
    trace::{
        Tracer,
        sampling::{around, mix, sobol_4d, square_to_cosine_hemisphere},
    },
};

/// Number of columns that are multiplied by the matrix at a time.
pub(super) const BLOCK: usize = 16;
/// The iteration ends when a bounce adds less than this share of the light.
const ENOUGH: f64 = 1e-5;
const MOST_BOUNCES: usize = 2000;

/// Options of [`Daylight::new`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct DaylightOptions {
    /// The parts of the sky.
    pub parts: SkyParts,
    /// The axis that points up.
    pub up: Up,
    /// Rays per patch.
    pub rays: f64,
    /// Rays per point.
    pub rays_of_points: u32,
    /// Seed of all random numbers.
    pub seed: u64,
}

setters!(DaylightOptions {
    with_parts(parts: SkyParts),
    with_up(up: Up),
    with_rays(rays: f64),
    with_rays_of_points(rays_of_points: u32),
    with_seed(seed: u64),
});

impl Default for DaylightOptions {
    /// Tregenza's parts, y is up, 256 rays per patch and 4096 per point, seed 0.
    fn default() -> Self {
        DaylightOptions { parts: SkyParts::new(1), up: Up::Y, rays: 256.0, rays_of_points: 4096, seed: 0 }
    }
}

/// The patches that rays from a point hit, each with its share of the rays times its reflectance.
pub(super) type Met = Vec<(u32, f32)>;

/// A receiver: a point in scene coordinates and its normal.
pub type Place = (DVec3, DVec3);

/// Daylight coefficients: the irradiance of places from each part of the sky with radiance 1. Surfaces reflect with the
/// mean reflectance of their channels.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Coefficients {
    /// The parts of the sky.
    pub parts: SkyParts,
    /// Number of places.
    pub places: usize,
    /// Direct and reflected irradiance of each place from each part, place by place.
    pub total: Vec<f32>,
    /// Reflected irradiance only, in the same order.
    pub reflected: Vec<f32>,
}

/// A scene that is solved for all parts of the sky.
#[derive(Debug)]
pub struct Daylight<'a> {
    scene: &'a Scene,
    tracer: &'a Tracer,
    patches: Patches,
    form_factors: FormFactors,
    /// Mean reflectance of each patch.
    reflectance: Vec<f64>,
    options: DaylightOptions,
    /// Direct and reflected irradiance of each patch from each part, patch by patch.
    irradiance: Vec<f32>,
    /// Direct irradiance only, in the same order.
    direct: Vec<f32>,
}

impl<'a> Daylight<'a> {
    /// Casts rays from all patches under a uniform sky and solves for all parts. Other lights of the scene are ignored.
    ///
    /// # Errors
    /// [`Error::Stopped`]; [`Error::NoEquilibrium`] if light cannot leave the scene and is not absorbed.
    pub fn new(
        scene: &'a Scene,
        tracer: &'a Tracer,
        mut patches: Patches,
        options: &DaylightOptions,
        progress: &Progress,
    ) -> Result<Daylight<'a>> {
        // The uniform sky determines which patches get more rays, and calibrates the form factors.
        let mut lit = scene.clone();
        lit.lights = Lights { sky: Some(Sky::uniform(options.up, [1.0; 3])), ..Lights::default() };
        lit.materials.iter_mut().for_each(|m| m.emission = [0.0; 3]);
        patches.update_materials(&lit);
        let cast = CastOptions::default().with_rays(options.rays).with_seed(options.seed);
        let form_factors = FormFactors::cast(&lit, tracer, &mut patches, &cast, progress)?;
        let channels = patches.channels();
        let mean = |rho: &[f64]| rho.iter().sum::<f64>() / rho.len() as f64;
        let reflectance = patches.reflectance().chunks_exact(channels).map(mean).collect();
        let mut daylight = Daylight {
            scene,
            tracer,
            patches,
            form_factors,
            reflectance,
            options: *options,
            irradiance: Vec::new(),
            direct: Vec::new(),
        };
        daylight.direct = daylight.straight();
        daylight.irradiance = daylight.solve(progress)?;
        Ok(daylight)
    }

    /// The patches, including the backs that rays hit.
    pub fn patches(&self) -> &Patches {
        &self.patches
    }

    /// Direct irradiance of each patch from each part of radiance 1.
    fn straight(&self) -> Vec<f32> {
        let DaylightOptions { parts, up, seed, .. } = self.options;
        let set = self.form_factors.ray_set().expect("the form factors were cast");
        let mut direct = vec![0f32; self.patches.len() * parts.count()];
        direct.par_chunks_mut(parts.count()).enumerate().with_min_len(16).for_each(|(i, row)| {
            let targets = set.of(i);
            if set.is_withdrawn(i) || !targets.contains(&ESCAPED) {
                return;
            }
            let share = (PI / targets.len() as f64) as f32;
            let from = Footprint::new(self.tracer, &self.patches, i);
            for ray in from.hemisphere_rays(0..targets.len() as u32, mix(&[seed, i as u64])) {
                if targets[ray.index as usize] == ESCAPED
                    && let Some(part) = parts.at(up, ray.direction.as_dvec3().normalize())
                {
                    row[part] += share;
                }
            }
        });
        direct
    }

    /// Solves for all parts, in blocks of columns.
    fn solve(&self, progress: &Progress) -> Result<Vec<f32>> {
        let (n, count) = (self.patches.len(), self.options.parts.count());
        let mut irradiance = vec![0f32; n * count];
        progress.begin("solving for the parts of the sky", count.div_ceil(BLOCK) as u64);
        for first in (0..count).step_by(BLOCK) {
            let columns = BLOCK.min(count - first);
            let direct: Vec<[f32; BLOCK]> = (0..n)
                .map(|i| {
                    let row = &self.direct[i * count + first..][..columns];
                    std::array::from_fn(|k| row.get(k).copied().unwrap_or_default())
                })
                .collect();
            let light = self.solve_block(direct, progress)?;
            for (i, light) in light.iter().enumerate() {
                irradiance[i * count + first..][..columns].copy_from_slice(&light[..columns]);
            }
            progress.advance(1);
        }
        Ok(irradiance)
    }

    /// Solves E = D + F ρ E for a block of columns D.
    pub(super) fn solve_block(
        &self,
        direct: Vec<[f32; BLOCK]>,
        progress: &Progress,
    ) -> Result<Vec<[f32; BLOCK]>> {
        let n = self.patches.len();
        let (mut light, mut sent, mut arriving) =
            (direct.clone(), vec![[0f32; BLOCK]; n], vec![[0f32; BLOCK]; n]);
        let size = |light: &[[f32; BLOCK]]| -> f64 { light.iter().flatten().map(|&e| f64::from(e)).sum() };
        let mut before = size(&light);
        for _ in 0..MOST_BOUNCES {
            progress.check()?;
            sent.par_iter_mut()
                .zip(&light)
                .zip(&self.reflectance)
                .with_min_len(256)
                .for_each(|((sent, light), &rho)| *sent = light.map(|e| rho as f32 * e));
            self.form_factors.irradiance_into::<f32, BLOCK>(sent.as_flattened(), arriving.as_flattened_mut());
            let values = light.as_flattened_mut().iter_mut().zip(direct.as_flattened());
            values.zip(arriving.as_flattened()).for_each(|((e, d), a)| *e = d + a);
            let now = size(&light);
            if now - before <= ENOUGH * now {
                return Ok(light);
            }
            before = now;
        }
        Err(Error::NoEquilibrium)
    }

    /// The coefficients of all front patches.
    pub fn of_patches(&self) -> Coefficients {
        let (parts, fronts) = (self.options.parts, self.patches.fronts());
        let all = fronts * parts.count();
        let total = self.irradiance[..all].to_vec();
        let reflected = total.iter().zip(&self.direct).map(|(e, d)| e - d).collect();
        Coefficients { parts, places: fronts, total, reflected }
    }

    /// The coefficients of points. Rays from each point hit the sky, or patches that reflect its light.
    ///
    /// # Errors
    /// [`Error::Stopped`].
    pub fn of_points(&self, points: &[Place], progress: &Progress) -> Result<Coefficients> {
        let DaylightOptions { parts, up, .. } = self.options;
        let count = parts.count();
        let gathered = self.gather(points, progress, |direct: &mut Vec<f64>, towards, share| {
            direct.resize(count, 0.0);
            if let Some(part) = parts.at(up, towards) {
                direct[part] += PI * share;
            }
        })?;
        let of_point = |(mut direct, met): (Vec<f64>, Met)| {
            direct.resize(count, 0.0);
            let mut reflected = vec![0f64; count];
            for (j, weight) in met {
                let row = &self.irradiance[j as usize * count..][..count];
                reflected.iter_mut().zip(row).for_each(|(sum, &e)| *sum += f64::from(weight) * f64::from(e));
            }
            let total = direct.iter().zip(&reflected).map(|(d, r)| (d + r) as f32).collect();
            (total, reflected.into_iter().map(|r| r as f32).collect())
        };
        let (total, reflected): (Vec<Vec<f32>>, Vec<Vec<f32>>) =
            gathered.into_par_iter().map(of_point).unzip();
        Ok(Coefficients { parts, places: points.len(), total: total.concat(), reflected: reflected.concat() })
    }

    /// The patches that rays from each point hit.
    pub(super) fn met(&self, points: &[Place], progress: &Progress) -> Result<Vec<Met>> {
        let gathered = self.gather(points, progress, |(): &mut (), _, _| {})?;
        Ok(gathered.into_iter().map(|((), met)| met).collect())
    }

    /// Casts rays from points. `escape` collects the rays that leave the scene, each with its direction and its share.
    /// The patches that the others hit are as for [`Daylight::met`].
    fn gather<T: Default + Send>(
        &self,
        points: &[Place],
        progress: &Progress,
        escape: impl Fn(&mut T, DVec3, f64) + Sync,
    ) -> Result<Vec<(T, Met)>> {
        let DaylightOptions { rays_of_points, seed, .. } = self.options;
        progress.begin("gathering at points", points.len() as u64);
        let of_point = |(k, &(point, normal)): (usize, &Place)| {
            progress.check()?;
            let (place, side) = self.tracer.place(point, normal);
            let (origin, normal) = (side.leave(place), side.normal);
            let (mut escaped, mut met) = (T::default(), vec![0f64; self.patches.len()]);
            let share = 1.0 / f64::from(rays_of_points);
            let seed = mix(&[seed, k as u64, 0x706f_696e_7473]);
            for ray in 0..rays_of_points {
                let [x, y, ..] = sobol_4d(ray, seed);
                let towards = around(normal, square_to_cosine_hemisphere(x, y));
                match self.tracer.closest(origin, towards) {
                    None => escape(&mut escaped, towards.as_dvec3().normalize(), share),
                    Some(hit) => {
                        if let Some(j) = self.patches.at(hit.triangle, hit.barycentric, hit.front) {
                            let rho = hit.reflectance(self.scene);
                            met[j as usize] += share * rho.iter().sum::<f64>() / 3.0;
                        }
                    }
                }
            }
            progress.advance(1);
            let met = met.into_iter().enumerate().filter(|(_, weight)| *weight > 0.0);
            Ok((escaped, met.map(|(j, weight)| (j as u32, weight as f32)).collect()))
        };
        points.par_iter().enumerate().map(of_point).collect()
    }

    /// The options.
    pub(super) fn options(&self) -> &DaylightOptions {
        &self.options
    }

    pub(super) fn tracer(&self) -> &Tracer {
        self.tracer
    }

    /// Whether a patch takes no part, because no ray can reach it.
    pub(super) fn is_hidden(&self, i: usize) -> bool {
        self.form_factors.ray_set().is_some_and(|set| set.is_withdrawn(i))
    }

    /// Whether a point receives direct light from the sun in the direction `towards`.
    pub fn sees(&self, (point, normal): &Place, towards: DVec3) -> bool {
        let (place, side) = self.tracer.place(*point, *normal);
        let towards = towards.as_vec3a();
        side.normal.dot(towards) > 0.0 && self.tracer.closest(side.leave(place), towards).is_none()
    }
}

impl Coefficients {
    /// The irradiance of place `i` under a sky with the given radiance of each part.
    pub fn irradiance(&self, i: usize, radiance: &[f64]) -> f64 {
        let row = &self.total[i * self.parts.count()..][..self.parts.count()];
        row.iter().zip(radiance).map(|(&c, l)| f64::from(c) * l).sum()
    }

    /// The irradiance that surfaces reflect to place `i` from a sun in the direction of a part, per irradiance of a
    /// plane that faces the sun.
    pub fn of_sun(&self, i: usize, part: usize) -> f64 {
        f64::from(self.reflected[i * self.parts.count() + part]) / self.parts.solid_angle(part)
    }
}
