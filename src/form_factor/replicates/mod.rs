//! The replicates taken apart: how every row would differ had only one of them been cast.

mod sums;

use std::ops::Range;

use rayon::prelude::*;

use super::{
    CastOptions, FormFactors, SHORT,
    escape::Escape,
    hemisphere::{Hits, REPLICATES},
    reciprocity::Densities,
};
use sums::{Counted, Rays, Sums};

/// By what share proportions may differ that count as one: what is left out is as much smaller than the standard error of a
/// source's row.
const ALIKE: f64 = 0.05;

/// What the estimate was made of, kept for the error bars.
#[derive(Debug, Clone)]
pub(super) struct Samples {
    pub(super) hits: Hits,
    pub(super) densities: Densities,
    /// Of each patch; empty for one-way form factors, which need none.
    pub(super) escapes: Vec<Escape>,
    /// Areas in the unit of `densities`.
    pub(super) areas: Vec<f64>,
    /// The radiosity after some bounces, interleaved channels, in a unit of its own.
    pub(super) radiosity: Vec<f32>,
    /// Runs of patches that are close to each other.
    pub(super) siblings: Vec<Range<usize>>,
    /// What was asked for.
    pub(super) options: CastOptions,
}

/// By how much each replicate's irradiance of a patch deviates from the mean of all, for a given radiosity.
pub(crate) type Deviation<const C: usize> = [[f32; REPLICATES]; C];

/// The deviations of a patch, to first order.
#[derive(Debug, Clone)]
struct Parts<const C: usize> {
    /// By hemisphere rays.
    hemisphere: Deviation<C>,
    /// By shadow rays.
    shadow: Deviation<C>,
    /// Of a source: by what factor, less one, closing its row scales its links.
    scale: [f32; REPLICATES],
}

impl FormFactors {
    /// Σ_j dF_ij B_j of all replicates for every patch, where E = F B; `None` when the form factors were not sampled.
    pub(crate) fn deviations<const C: usize>(&self, radiosity: &[[f64; C]]) -> Option<Vec<Deviation<C>>> {
        let samples = self.samples.as_ref()?;
        let single: Vec<[f32; C]> = radiosity.iter().map(|b| b.map(|b| b as f32)).collect();
        let add = |to: &mut [f32], what: &[f32], factor: f32| {
            to.iter_mut().zip(what).for_each(|(to, what)| *to += factor * what);
        };
        let mut whole: Vec<Deviation<C>> = vec![[[0.0; REPLICATES]; C]; radiosity.len()];
        let scales = samples.deviations(&single, Rays::All, &mut whole, |parts| {
            let mut whole = parts.hemisphere;
            add(whole.as_flattened_mut(), parts.shadow.as_flattened(), 1.0);
            whole
        });
        if !samples.shine_alike(radiosity) {
            // What sources scale by is scaled in the rows of the others too, whose light from sources as a whole stays. With the
            // brightness b_l of the sources dE_i = Σ_l F_il ds_l (B_l - b_l Σ_m F_im B_m / Σ_m F_im b_m).
            let brightness = samples.densities.brightness();
            let sources = samples.hits.sources.patches();
            let scale = self.gather_from(sources, |k, i| [scales[k].map(|s| s * brightness[i] as f32)]);
            let sent: Vec<Deviation<C>> = self.gather_from(sources, |k, i| {
                std::array::from_fn(|c| scales[k].map(|s| s * radiosity[i][c] as f32))
            });
            let known = self.irradiance(brightness, 1);
            let of_source = |i: usize| radiosity[i].map(|b| if brightness[i] > 0.0 { b } else { 0.0 });
            let light = self.irradiance(&(0..radiosity.len()).flat_map(of_source).collect::<Vec<_>>(), C);
            let rows = whole.par_iter_mut().enumerate().with_min_len(SHORT);
            rows.filter(|&(i, _)| !samples.hits.sources.contains(i)).for_each(|(i, whole)| {
                for c in 0..C {
                    add(&mut whole[c], &sent[i][c], 1.0);
                    let ratio = if known[i] > 0.0 { light[i * C + c] / known[i] } else { 0.0 };
                    add(&mut whole[c], &scale[i][0], -ratio as f32);
                }
            });
        }
        Some(whole)
    }
}

impl Samples {
    /// Whether the radiosity of all sources is in one proportion to their brightness, nearly: how they share what others get from
    /// them does not matter then.
    fn shine_alike<const C: usize>(&self, radiosity: &[[f64; C]]) -> bool {
        let brightness = self.densities.brightness();
        (0..C).all(|c| {
            let sources = self.hits.sources.patches().iter().map(|&i| i as usize);
            let of = sources.filter(|&i| brightness[i] > 0.0).map(|i| radiosity[i][c] / brightness[i]);
            let (least, most) = of.fold((f64::INFINITY, 0.0), |(low, high), x| (x.min(low), x.max(high)));
            most <= (1.0 + ALIKE) * least
        })
    }

    /// Variances of every patch's irradiance, all channels together, that come from its own hemisphere rays, and from its
    /// shadow rays. Light reflected from patches that are off counts to none.
    pub(super) fn variances(&self, channels: usize) -> Vec<[f64; 2]> {
        match channels {
            1 => self.variances_of::<1>(),
            _ => self.variances_of::<3>(),
        }
    }

    fn variances_of<const C: usize>(&self) -> Vec<[f64; 2]> {
        let squares = |d: &Deviation<C>| d.as_flattened().iter().map(|&d| f64::from(d).powi(2)).sum();
        let mut variances = vec![[0.0; 2]; self.areas.len()];
        self.deviations::<C, _>(self.radiosity.as_chunks().0, Rays::Own, &mut variances, |parts| {
            [squares(&parts.hemisphere), squares(&parts.shadow)]
        });
        variances
    }

    /// Fills `out` with what `make` makes of the deviations of every patch. Returns by what closing their rows scales the links of
    /// sources, one after the other.
    fn deviations<const C: usize, T: Send>(
        &self,
        radiosity: &[[f32; C]],
        rays: Rays,
        out: &mut [T],
        make: impl Fn(&Parts<C>) -> T + Sync,
    ) -> Vec<[f32; REPLICATES]> {
        let counted = Counted::new(self, radiosity, rays);
        let blocks = counted.blocks;
        let of_block = |sums: &mut Vec<Sums<C>>, (block, out): (usize, &mut [T])| {
            counted.sum(block, sums);
            let mut scales = Vec::new();
            for ((i, sums), out) in blocks.range(block).zip(&*sums).zip(out) {
                let parts = self.deviation(i, sums);
                *out = make(&parts);
                if self.hits.sources.patches().binary_search(&(i as u32)).is_ok() {
                    scales.push(parts.scale);
                }
            }
            scales
        };
        let parts = out.par_chunks_mut(blocks.rows()).enumerate().with_max_len(1);
        let scales: Vec<_> = parts.map_init(Vec::new, of_block).collect();
        scales.concat()
    }

    /// Deviations of the replicates of patch `i` from their mean: what the matrix makes of their sums.
    fn deviation<const C: usize>(&self, i: usize, sums: &Sums<C>) -> Parts<C> {
        let mean = |of: &dyn Fn(usize) -> f32| {
            (0..REPLICATES).map(|k| f64::from(of(k))).sum::<f64>() / REPLICATES as f64
        };
        let area = self.areas[i];
        let none = [[0.0; REPLICATES]; C];
        let mut deviation = Parts { hemisphere: none, shadow: none, scale: [0.0; REPLICATES] };
        let Some(&Escape { share, by_rays, by_links, by_linked }) = self.escapes.get(i) else {
            for c in 0..C {
                let power = mean(&|k| sums.plain[k].power[c]);
                deviation.hemisphere[c] =
                    sums.plain.map(|plain| ((f64::from(plain.power[c]) - power) / area) as f32);
            }
            return deviation;
        };
        let (plain, links) = (mean(&|k| sums.plain[k].area), mean(&|k| sums.links[k].area));
        let (escaped, linked) = (mean(&|k| sums.escaped[k]), mean(&|k| sums.linked[k]));
        let is_source = self.hits.sources.contains(i);
        let ratio = |power: f64, exchange: f64| if exchange > 0.0 { power / exchange } else { 0.0 };
        for c in 0..C {
            let plain_power = mean(&|k| sums.plain[k].power[c]);
            let link_power = mean(&|k| sums.links[k].power[c]);
            for k in 0..REPLICATES {
                let d_links = f64::from(sums.links[k].area) - links;
                let d_link_power = f64::from(sums.links[k].power[c]) - link_power;
                let d_escaped = by_rays * (f64::from(sums.escaped[k]) - escaped)
                    + by_linked * (f64::from(sums.linked[k]) - linked);
                let d_escaped_links = by_links * d_links / area;
                // A row sums to its area less what escapes: of a source, whose row is all links, these take up the rest,
                // else what is no link does.
                let (hemisphere, shadow) = if is_source {
                    let closing = ratio(link_power, links);
                    let d_closing = d_link_power - closing * d_links;
                    deviation.scale[k] = -ratio(d_links + area * (d_escaped + d_escaped_links), links) as f32;
                    let scale = ratio(area * (1.0 - share), links);
                    // Where lamps are few, more of their own rays tell it; others' shadow rays go to what these light.
                    let (own, others) = if self.hits.sources.are_lamps() { (1.0, 0.0) } else { (0.0, 1.0) };
                    (
                        own * scale * d_closing - closing * area * d_escaped,
                        others * scale * d_closing - closing * area * d_escaped_links,
                    )
                } else {
                    let closing = ratio(plain_power, plain);
                    let d_closing = f64::from(sums.plain[k].power[c])
                        - plain_power
                        - closing * (f64::from(sums.plain[k].area) - plain);
                    let scale = ratio(area * (1.0 - share) - links, plain);
                    (
                        scale * d_closing - closing * area * d_escaped,
                        d_link_power - closing * (d_links + area * d_escaped_links),
                    )
                };
                deviation.hemisphere[c][k] = (hemisphere / area) as f32;
                deviation.shadow[c][k] = (shadow / area) as f32;
            }
        }
        deviation
    }
}
