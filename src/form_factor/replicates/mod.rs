//! Deviations of single replicates from the mean of all.

mod sums;

use std::ops::Range;

use rayon::prelude::*;

use super::{CastOptions, Estimator, FormFactors, pooling::Densities};
use crate::{
    direct::{Deviation, DirectLight, ShadowRays, sky::SkyLight},
    patch::Patches,
    rays::{
        ESCAPED, REPLICATES, RaySet,
        allocation::{self, Share},
        regions::Regions,
    },
    scene::light::SKY,
};
use sums::{Counted, Sums, WhichRays};

/// The samples behind the form factors, kept for error bars.
#[derive(Debug, Clone)]
pub(crate) struct Samples {
    pub(crate) rays: RaySet,
    pub(crate) shadow: ShadowRays,
    /// Irradiance from the sky, if there is one.
    pub(super) sky: Option<SkyLight>,
    pub(super) densities: Densities,
    /// The share of each patch's rays that leave the scene.
    pub(super) escaped: Vec<f64>,
    /// The share of all light leaving patches that leaves the scene; 0 without lamps.
    pub(super) escaping: f64,
    /// Areas in the unit of `densities`.
    pub(crate) areas: Vec<f64>,
    /// The radiosity after some bounces without the emission of lamps, interleaved channels, in the unit of emission.
    pub(super) radiosity: Vec<f32>,
    /// Runs of patches that are close to each other.
    pub(super) siblings: Vec<Range<usize>>,
    pub(super) regions: Regions,
    /// Options of the rays.
    pub(crate) options: CastOptions,
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

    /// Direct light of lamps and of other lights except those in `dark`, in multiples of `unit`, as `emission` is.
    /// Powers use relative areas.
    pub(super) fn direct<const C: usize>(
        &self,
        emission: &[[f64; C]],
        unit: f64,
        dark: &[String],
    ) -> DirectLight<C> {
        let mut light = self.shadow.irradiance((emission, unit, dark), &self.areas, self.escaping);
        if let Some(sky) = self.sky.as_ref().filter(|_| !dark.iter().any(|name| name == SKY)) {
            let (irradiance, deviations) = sky.arriving(unit);
            light.add(&irradiance, &deviations, &self.areas);
        }
        light
    }

    /// The numbers of rays that lower the error most, with `rays` rays a patch in the mean. The error of each patch is
    /// relative to the light of its region. Patches that are shut in solids do not count, because nobody sees their light.
    ///
    /// Without lamps and sky no light stands out. Variances then hardly differ, and their noise would distribute the rays. So
    /// they count as zero, and all rays are cast evenly.
    pub(super) fn shares(&self, patches: &Patches, rays: f64) -> Vec<Share> {
        let cast = |i: usize| Share { hemisphere: self.rays.rays_of(i), shadow: self.shadow.count(i) };
        let rays = rays * self.areas.len() as f64;
        if !self.has_direct() {
            let none = vec![[0.0; 2]; self.areas.len()];
            return allocation::by_variance(cast, &self.areas, &none, &self.siblings, rays);
        }
        let (variances, light) = match patches.channels() {
            1 => self.variances::<1>(patches),
            _ => self.variances::<3>(patches),
        };
        let around = self.regions.means(&self.areas, |i| light[i]);
        // Without light there are no errors.
        let relative = |(variances, around): (&[f64; 2], &f64)| {
            variances.map(|v| if *around > 0.0 { v / (around * around) } else { 0.0 })
        };
        let variances: Vec<[f64; 2]> = variances.iter().zip(&around).map(relative).collect();
        let repeated = |&light: &f64| std::iter::repeat_n(light, patches.channels());
        let mut areas = patches.seen_areas(&light.iter().flat_map(repeated).collect::<Vec<_>>());
        areas
            .iter_mut()
            .zip(&self.areas)
            .filter(|(seen, _)| **seen > 0.0)
            .for_each(|(seen, area)| *seen = *area);
        allocation::by_variance(cast, &areas, &variances, &self.siblings, rays)
    }

    /// Variances of every patch's irradiance, summed over channels: those from its own hemisphere rays, and those from
    /// its shadow rays. Noise in the radiosity of other patches is not included. Also the irradiance that its own rays
    /// measure, summed over channels.
    fn variances<const C: usize>(&self, patches: &Patches) -> (Vec<[f64; 2]>, Vec<f64>) {
        let unit = self.shadow.lamps.magnitude(patches.emission());
        let scaled = |b: &[f64; C]| b.map(|b| b / unit);
        let emission: Vec<[f64; C]> = patches.emission().as_chunks().0.iter().map(scaled).collect();
        let direct = self.shadow.irradiance((&emission, unit, &[]), &self.areas, self.escaping);
        let radiosity = self.radiosity.as_chunks::<C>().0;
        let mut reflected = self.deviations::<C>(radiosity, WhichRays::Own);
        let sent: Vec<f64> = radiosity.iter().map(|b| b.iter().copied().map(f64::from).sum()).collect();
        let gathered = |i: usize| -> f64 {
            let hits = self.rays.of(i).iter().filter(|&&j| j != ESCAPED);
            hits.map(|&j| sent[j as usize]).sum::<f64>() / f64::from(self.rays.rays_of(i))
        };
        let mut light: Vec<f64> = (0..sent.len()).into_par_iter().with_min_len(128).map(gathered).collect();
        let add = |light: &mut [f64], arriving: &[[f64; C]]| {
            light.iter_mut().zip(arriving).for_each(|(sum, e)| *sum += e.iter().sum::<f64>());
        };
        add(&mut light, &direct.irradiance);
        if let Some((irradiance, deviations)) = self.sky.as_ref().map(|sky| sky.arriving::<C>(unit)) {
            for (reflected, sky) in reflected.iter_mut().zip(deviations) {
                let values = reflected.as_flattened_mut().iter_mut().zip(sky.as_flattened());
                values.for_each(|(reflected, sky)| *reflected += sky);
            }
            add(&mut light, &irradiance);
        }
        let squares = |d: &Deviation<C>| d.as_flattened().iter().map(|&d| f64::from(d).powi(2)).sum();
        let both = reflected.iter().zip(&direct.deviations);
        (both.map(|(reflected, direct)| [squares(reflected), squares(direct)]).collect(), light)
    }

    /// The deviation of every patch's irradiance in each replicate.
    fn deviations<const C: usize>(&self, radiosity: &[[f32; C]], which: WhichRays) -> Vec<Deviation<C>> {
        let counted = Counted::new(self, radiosity, which);
        let blocks = counted.blocks;
        let of_block = |sums: &mut Vec<Sums<C>>, block: usize| {
            if !blocks.owns(block) {
                return vec![[[0.0; REPLICATES]; C]; blocks.range(block).len()];
            }
            counted.sum(block, sums);
            blocks.range(block).zip(&*sums).map(|(i, sums)| self.deviation(i, sums)).collect::<Vec<_>>()
        };
        let of_blocks: Vec<_> =
            (0..blocks.count()).into_par_iter().with_max_len(1).map_init(Vec::new, of_block).collect();
        let mut deviations = of_blocks.concat();
        blocks.share(&mut deviations);
        deviations
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
