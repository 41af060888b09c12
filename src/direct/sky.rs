//! Light of the sky, seen by the hemisphere rays that leave the scene.
//!
//! Directions are cosine-distributed, so that the irradiance of a patch is π times the mean radiance that its rays see.
//! The directions are not stored: they are reproduced from the numbers of the rays.

use rayon::prelude::*;

use super::{Deviation, Lamps};
use crate::{
    patch::Patches,
    rays::{ESCAPED, REPLICATES, RaySet, footprint::Footprint, part},
    scene::light::Sky,
    trace::{Tracer, sampling::mix},
};

/// The irradiance of all patches that comes from the sky.
#[derive(Debug, Clone)]
pub(crate) struct SkyLight {
    channels: usize,
    /// The unit of all values.
    unit: f64,
    /// Irradiance by each replicate of the rays of a patch; interleaved channels.
    parts: Vec<[f32; REPLICATES]>,
    /// Irradiance by all rays; interleaved channels.
    irradiance: Vec<f64>,
}

impl SkyLight {
    /// The light that these rays see, if there is a sky.
    pub(crate) fn of(
        rays: &RaySet,
        lamps: &Lamps,
        tracer: &Tracer,
        patches: &Patches,
        seed: u64,
    ) -> Option<SkyLight> {
        let sky = lamps.sky.as_ref()?;
        let (channels, unit) = (patches.channels(), lamps.magnitude(&[]));
        let of_patch = |i: usize| {
            let from = Footprint::new(tracer, patches, i);
            of_patch(rays.of(i), &from, sky, mix(&[seed, i as u64])).map(|sums| sums.map(|e| e / unit))
        };
        let sums: Vec<[[f64; REPLICATES]; 3]> =
            (0..rays.len()).into_par_iter().with_min_len(32).map(of_patch).collect();
        let mut light = SkyLight { channels, unit, parts: Vec::new(), irradiance: Vec::new() };
        for (i, sums) in sums.iter().enumerate() {
            let count: [f64; REPLICATES] = std::array::from_fn(|k| rays.of_replicate(i, k).len() as f64);
            for sums in &sums[..channels] {
                light.parts.push(std::array::from_fn(|k| (sums[k] / count[k]) as f32));
                light.irradiance.push(sums.iter().sum::<f64>() / f64::from(rays.rays_of(i)));
            }
        }
        Some(light)
    }

    /// The light by the first or second half of all rays. Each replicate of the half is counted twice.
    pub(crate) fn half(&self, half: usize) -> SkyLight {
        let of_half = REPLICATES / 2;
        let parts: Vec<[f32; REPLICATES]> =
            self.parts.iter().map(|parts| std::array::from_fn(|k| parts[half * of_half + k / 2])).collect();
        let mean = |parts: &[f32; REPLICATES]| parts.iter().copied().map(f64::from).sum::<f64>();
        let irradiance = parts.iter().map(|parts| mean(parts) / REPLICATES as f64).collect();
        SkyLight { parts, irradiance, ..*self }
    }

    /// Removes all light from these patches.
    pub(crate) fn withdraw(&mut self, patches: &[usize]) {
        for q in patches.iter().flat_map(|&i| self.channels * i..self.channels * (i + 1)) {
            (self.parts[q], self.irradiance[q]) = ([0.0; REPLICATES], 0.0);
        }
    }

    /// Irradiance of all patches and the deviations of its replicates, in multiples of `unit`.
    pub(crate) fn arriving<const C: usize>(&self, unit: f64) -> (Vec<[f64; C]>, Vec<Deviation<C>>) {
        let scale = self.unit / unit;
        let irradiance = self.irradiance.as_chunks::<C>().0.iter().map(|e| e.map(|e| scale * e)).collect();
        let deviation = |parts: &[f32; REPLICATES]| {
            let mean = parts.iter().copied().map(f64::from).sum::<f64>() / REPLICATES as f64;
            parts.map(|part| (scale * (f64::from(part) - mean)) as f32)
        };
        let parts = self.parts.as_chunks::<C>().0.iter();
        (irradiance, parts.map(|parts| std::array::from_fn(|c| deviation(&parts[c]))).collect())
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.parts[..]) + size_of_val(&self.irradiance[..])
    }
}

/// Sums of π times the radiance that the escaping rays of each replicate see.
fn of_patch(targets: &[u32], from: &Footprint, sky: &Sky, seed: u64) -> [[f64; REPLICATES]; 3] {
    let mut sums = [[0.0; REPLICATES]; 3];
    if !targets.contains(&ESCAPED) {
        return sums;
    }
    let count = targets.len() as u32;
    let mut replicate = 0;
    for ray in from.hemisphere_rays(0..count, seed) {
        if targets[ray.index as usize] != ESCAPED {
            continue;
        }
        while part(count, replicate).end <= ray.index as usize {
            replicate += 1;
        }
        let radiance = sky.radiance(ray.direction.as_dvec3().normalize());
        (0..3).for_each(|c| sums[c][replicate] += std::f64::consts::PI * radiance[c]);
    }
    sums
}
