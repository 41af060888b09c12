//! The light of the suns of a year: what surfaces reflect of it to each place.
//!
//! A part of the sky is too large for the sun. Sunlight that enters by a window moves over the floor within a part, and
//! parts at the edge of the sun's paths are only partly on them. In a room with a window, one coefficient for each of
//! Tregenza's parts made the reflected sunlight of a year 3 to 17 % too strong. So positions of the sun are grouped by
//! finer parts, and each patch takes its direct light from positions of the group, drawn in proportion to their
//! irradiance. The sum over a year then has no error from the size of the parts.

use glam::DVec3;
use rayon::prelude::*;

use super::{
    SkyParts,
    coefficients::{BLOCK, Daylight, Place},
};
use crate::{
    Progress, Result,
    rays::footprint::Footprint,
    trace::sampling::{mix, sobol_4d, square_to_triangle},
};

/// Least division of the sky for the positions of the sun: parts of 6 degrees. The sum over a year does not depend on
/// it, and the sun moves further in half an hour.
const LEAST_DIVISION: usize = 2;
/// Shadow rays from each patch to each group of positions.
const SHADOW_RAYS: u32 = 4;
const NO_GROUP: u32 = u32::MAX;

/// A position of the sun, and the irradiance of a plane that faces it, summed over the hours with this position.
pub(super) type Position = (DVec3, f64);

/// The positions in one part of the sky, and the running sums of their irradiances.
#[derive(Default)]
struct Group {
    positions: Vec<DVec3>,
    sums: Vec<f64>,
}

impl Group {
    /// The position at a share of the irradiance, from 0 to 1.
    fn at(&self, share: f64) -> DVec3 {
        let last = self.sums.len() - 1;
        let k = self.sums.partition_point(|&sum| sum <= share * self.sums[last]);
        self.positions[k.min(last)]
    }
}

/// Irradiance of places from the suns of a year, over the irradiance of a plane that faces the sun.
pub(super) struct Suns {
    parts: SkyParts,
    /// The group of each part.
    group: Vec<u32>,
    groups: usize,
    /// An entry for each place and group.
    coefficients: Vec<f32>,
}

impl Suns {
    /// The group of a position.
    pub(super) fn group(&self, daylight: &Daylight<'_>, towards: DVec3) -> Option<usize> {
        let part = self.parts.at(daylight.options().up, towards)?;
        Some(self.group[part]).filter(|&group| group != NO_GROUP).map(|group| group as usize)
    }

    /// The irradiance of a place from a sun in a group, over the irradiance of a plane that faces it: at points only
    /// the reflected part, on patches all of it.
    pub(super) fn of(&self, place: usize, group: usize) -> f64 {
        self.coefficients[place * self.groups + group].into()
    }

    /// Casts shadow rays to the positions and solves for each group. The places are points, or all front patches.
    ///
    /// # Errors
    /// [`crate::Error::Stopped`]; [`crate::Error::NoEquilibrium`].
    pub(super) fn new(
        daylight: &Daylight<'_>,
        points: Option<&[Place]>,
        positions: Vec<Position>,
        progress: &Progress,
    ) -> Result<Suns> {
        let options = daylight.options();
        let parts = SkyParts::new(options.parts.division().max(LEAST_DIVISION));
        let (group, all) = grouped(parts, positions, |towards| parts.at(options.up, towards));
        let places = points.map_or(daylight.patches().fronts(), <[Place]>::len);
        let met = points.map(|points| daylight.met(points, progress)).transpose()?;
        let mut coefficients = vec![0f32; places * all.len()];
        progress.begin("solving for the sun", all.len().div_ceil(BLOCK) as u64);
        for first in (0..all.len()).step_by(BLOCK) {
            let block = &all[first..(first + BLOCK).min(all.len())];
            let light = daylight.solve_block(direct(daylight, first, block), progress)?;
            coefficients.par_chunks_mut(all.len()).enumerate().for_each(|(place, row)| {
                let row = &mut row[first..first + block.len()];
                let Some(met) = &met else {
                    row.copy_from_slice(&light[place][..block.len()]);
                    return;
                };
                for &(j, weight) in &met[place] {
                    row.iter_mut().zip(&light[j as usize]).for_each(|(sum, e)| *sum += weight * e);
                }
            });
            progress.advance(1);
        }
        Ok(Suns { parts, group, groups: all.len(), coefficients })
    }
}

/// The group of each part, and the groups in the order of their parts.
fn grouped(
    parts: SkyParts,
    positions: Vec<Position>,
    at: impl Fn(DVec3) -> Option<usize>,
) -> (Vec<u32>, Vec<Group>) {
    let mut of_parts: Vec<Group> = (0..parts.count()).map(|_| Group::default()).collect();
    for (towards, irradiance) in positions {
        if let Some(part) = at(towards).filter(|_| irradiance > 0.0) {
            let group = &mut of_parts[part];
            group.positions.push(towards);
            group.sums.push(group.sums.last().copied().unwrap_or_default() + irradiance);
        }
    }
    let (mut group, mut groups) = (vec![NO_GROUP; parts.count()], Vec::new());
    for (part, positions) in of_parts.into_iter().enumerate().filter(|(_, g)| !g.positions.is_empty()) {
        group[part] = groups.len() as u32;
        groups.push(positions);
    }
    (group, groups)
}

/// Direct irradiance of each patch from groups of positions, the first of which has this number.
fn direct(daylight: &Daylight<'_>, first: usize, groups: &[Group]) -> Vec<[f32; BLOCK]> {
    let (tracer, patches, seed) = (daylight.tracer(), daylight.patches(), daylight.options().seed);
    let of_patch = |i: usize| {
        let mut light = [0f32; BLOCK];
        if daylight.is_hidden(i) {
            return light;
        }
        let from = Footprint::new(tracer, patches, i);
        for (k, group) in groups.iter().enumerate() {
            let seed = mix(&[seed, i as u64, (first + k) as u64, 0x0073_756e]);
            for ray in 0..SHADOW_RAYS {
                let [x, y, which, _] = sobol_4d(ray, seed);
                let towards = group.at(which.into()).as_vec3a();
                let cos = from.normal().dot(towards);
                if cos > 0.0 {
                    let origin = from.side.leave(from.at(square_to_triangle(x, y)));
                    if tracer.closest(origin, towards).is_none() {
                        light[k] += cos / SHADOW_RAYS as f32;
                    }
                }
            }
        }
        light
    };
    (0..patches.len()).into_par_iter().with_min_len(16).map(of_patch).collect()
}
