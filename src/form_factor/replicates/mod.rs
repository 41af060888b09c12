//! Deviations of single replicates from the mean of all.

mod sums;

use std::ops::Range;

use rayon::prelude::*;

use super::{
    CastOptions, Estimator, FormFactors, allocation,
    allocation::Share,
    pooling::Densities,
    rays::{ESCAPED, REPLICATES, RaySet},
    sky::SkyLight,
};
use crate::{
    direct::{Deviation, DirectLight, ShadowRays},
    patch::Patches,
    scene::light::LightGroup,
};
use sums::{Counted, Sums, WhichRays};

/// The samples behind the form factors, kept for error bars.
#[derive(Debug, Clone)]
pub(super) struct Samples {
    pub(super) rays: RaySet,
    pub(super) shadow: ShadowRays,
    /// Irradiance from the sky, if there is one.
    pub(super) sky: Option<SkyLight>,
    pub(super) densities: Densities,
    /// The share of each patch's rays that leave the scene.
    pub(super) escaped: Vec<f64>,
    /// The share of all light leaving patches that leaves the scene; 0 without lamps.
    pub(super) escaping: f64,
    /// Areas in the unit of `densities`.
    pub(super) areas: Vec<f64>,
    /// The radiosity after some bounces without the emission of lamps, interleaved channels, in the unit of emission.
    pub(super) radiosity: Vec<f32>,
    /// Runs of patches that are close to each other.
    pub(super) siblings: Vec<Range<usize>>,
    /// Options of the rays.
    pub(super) options: CastOptions,
}

impl FormFactors {
    /// The deviation of Σ_j F_ij B_j of every patch in every replicate; `None` if the form factors were not sampled.
    pub(crate) fn deviations<const C: usize>(&self, radiosity: &[[f64; C]]) -> Option<Vec<Deviation<C>>> {
        let samples = self.samples.as_ref()?;
        let single: Vec<[f32; C]> = radiosity.iter().map(|b| b.map(|b| b as f32)).collect();
        Some(samples.deviations(&single, WhichRays::All))
    }
}

impl FormFactors {
    /// The deviation of the escaped share of each patch in each replicate; `None` if the form factors were not sampled.
    pub(crate) fn escape_deviations(&self) -> Option<Vec<[f32; REPLICATES]>> {
        let samples = self.samples.as_ref()?;
        let of_patch = |i: usize| {
            let share = |k: usize| {
                let targets = samples.rays.of_replicate(i, k);
                targets.iter().filter(|&&j| j == ESCAPED).count() as f64 / targets.len() as f64
            };
            let shares: [f64; REPLICATES] = std::array::from_fn(share);
            let mean = shares.iter().sum::<f64>() / REPLICATES as f64;
            shares.map(|share| (share - mean) as f32)
        };
        Some((0..samples.rays.len()).into_par_iter().with_min_len(128).map(of_patch).collect())
    }
}

impl Samples {
    /// Bytes held by the rays and the light that they brought.
    pub(super) fn bytes(&self) -> usize {
        self.rays.bytes() + self.shadow.bytes() + self.sky.as_ref().map_or(0, SkyLight::bytes)
    }

    /// Whether there is direct light, from lamps or from outside the patches.
    pub(super) fn has_direct(&self) -> bool {
        !self.shadow.lamps.is_empty() || self.sky.is_some()
    }

    /// Direct light of lamps and other lights, in multiples of `unit`, as `emission` is. Powers use relative areas.
    pub(super) fn direct<const C: usize>(&self, emission: &[[f64; C]], unit: f64) -> DirectLight<C> {
        let mut light = self.shadow.irradiance(emission, unit, &self.areas, self.escaping);
        if let Some(sky) = &self.sky {
            let (irradiance, deviations) = sky.arriving(unit);
            light.add(&irradiance, &deviations, &self.areas);
        }
        light
    }

    /// The direct irradiance of all patches from one group of lights that are not surfaces.
    pub(super) fn direct_from<const C: usize>(&self, group: LightGroup) -> Vec<[f64; C]> {
        let mut irradiance = self.shadow.of_group(group, self.areas.len());
        if let Some(sky) = self.sky.as_ref().filter(|_| group == LightGroup::Sky) {
            let (seen, _) = sky.arriving::<C>(1.0);
            for (sum, seen) in irradiance.iter_mut().zip(seen) {
                (0..C).for_each(|c| sum[c] += seen[c]);
            }
        }
        irradiance
    }

    /// The numbers of rays that lower the error most, with `rays` rays a patch in the mean.
    pub(super) fn shares(&self, patches: &Patches, rays: f64) -> Vec<Share> {
        let variances = match patches.channels() {
            1 => self.variances::<1>(patches),
            _ => self.variances::<3>(patches),
        };
        let cast = |i: usize| Share { hemisphere: self.rays.rays_of(i), shadow: self.shadow.count(i) };
        allocation::by_variance(cast, &self.areas, &variances, &self.siblings, rays * self.areas.len() as f64)
    }

    /// Variances of every patch's irradiance, summed over channels: those from its own hemisphere rays, and those from
    /// its shadow rays. Noise in the radiosity of other patches is not included.
    fn variances<const C: usize>(&self, patches: &Patches) -> Vec<[f64; 2]> {
        let unit = self.shadow.lamps.magnitude(patches.emission());
        let scaled = |b: &[f64; C]| b.map(|b| b / unit);
        let emission: Vec<[f64; C]> = patches.emission().as_chunks().0.iter().map(scaled).collect();
        let direct = self.shadow.irradiance(&emission, unit, &self.areas, self.escaping).deviations;
        let mut reflected = self.deviations::<C>(self.radiosity.as_chunks().0, WhichRays::Own);
        if let Some(sky) = &self.sky {
            for (reflected, sky) in reflected.iter_mut().zip(sky.arriving::<C>(unit).1) {
                let values = reflected.as_flattened_mut().iter_mut().zip(sky.as_flattened());
                values.for_each(|(reflected, sky)| *reflected += sky);
            }
        }
        let squares = |d: &Deviation<C>| d.as_flattened().iter().map(|&d| f64::from(d).powi(2)).sum();
        reflected
            .iter()
            .zip(&direct)
            .map(|(reflected, direct)| [squares(reflected), squares(direct)])
            .collect()
    }

    /// The deviation of every patch's irradiance in each replicate.
    fn deviations<const C: usize>(&self, radiosity: &[[f32; C]], which: WhichRays) -> Vec<Deviation<C>> {
        let counted = Counted::new(self, radiosity, which);
        let blocks = counted.blocks;
        let of_block = |sums: &mut Vec<Sums<C>>, block: usize| {
            counted.sum(block, sums);
            blocks.range(block).zip(&*sums).map(|(i, sums)| self.deviation(i, sums)).collect::<Vec<_>>()
        };
        let blocks: Vec<_> =
            (0..blocks.count()).into_par_iter().with_max_len(1).map_init(Vec::new, of_block).collect();
        blocks.concat()
    }

    /// Deviations of the replicates of patch `i` from their mean. As in the matrix, the row is scaled so that it sums
    /// to one with the escaped share. One-way form factors are not scaled.
    fn deviation<const C: usize>(&self, i: usize, sums: &Sums<C>) -> Deviation<C> {
        let mean = |of: &dyn Fn(usize) -> f32| {
            (0..REPLICATES).map(|k| f64::from(of(k))).sum::<f64>() / REPLICATES as f64
        };
        let exchanged = mean(&|k| sums.landed[k].area);
        let escaped = mean(&|k| sums.escaped[k]);
        let closes = self.options.estimator == Estimator::Pooled && exchanged > 0.0;
        let scale = if closes { (1.0 - self.escaped[i]) / exchanged } else { 1.0 / self.areas[i] };
        std::array::from_fn(|c| {
            let power = mean(&|k| sums.landed[k].power[c]);
            let part = if closes { power / exchanged } else { 0.0 };
            std::array::from_fn(|k| {
                let landed = &sums.landed[k];
                let (area, power) = (f64::from(landed.area) - exchanged, f64::from(landed.power[c]) - power);
                let more = f64::from(sums.escaped[k]) - escaped;
                (scale * (power - part * area) - part * more) as f32
            })
        })
    }
}
