//! The shape of direct light over a patch: moments of the shadow rays over their starting points.
//!
//! The samples y = (V - β) w B + β G of `irradiance` estimate slopes and curvatures as they estimate the mean. The
//! moments of the control variate β G are known too. So unblocked light has an exact shape, and rays sample only the
//! variation of shadows. Starting points are reproduced from the numbers of the rays; visibility is stored.

use std::ops::Range;

use glam::Vec3A;
use rayon::prelude::*;

use super::{
    irradiance::Scratch,
    shadow::{HALVES, ShadowRays, paths},
};
use crate::{
    patch::Patches,
    rays::{REPLICATES, footprint::Footprint, part},
    scene::{Scene, in_triangle},
    slopes::{CELLS, MODES, Measured, SQUARES, beyond_modes, cell, modes},
    trace::{Tracer, sampling::mix},
};

/// Converts points on or above a patch to barycentric coordinates.
pub(crate) struct Local {
    corner: Vec3A,
    across: [Vec3A; 2],
}

impl Local {
    /// Coordinates on a patch from which rays start.
    pub(crate) fn new(from: &Footprint) -> Local {
        let [a, b, c] = from.corners.map(|corner| corner.as_dvec3());
        let (u, v) = (b - a, c - a);
        let normal = u.cross(v);
        let squared = normal.length_squared();
        // All points of a patch without area are the same.
        let across =
            |edge: glam::DVec3| if squared > 0.0 { (edge / squared).as_vec3a() } else { Vec3A::ZERO };
        Local { corner: from.corners[0], across: [across(v.cross(normal)), across(normal.cross(u))] }
    }

    /// Barycentric coordinates in the patch.
    #[inline]
    pub(crate) fn barycentric(&self, point: Vec3A) -> [f64; 3] {
        let off = point - self.corner;
        let [b, c] = self.across.map(|across| across.dot(off).clamp(0.0, 1.0));
        [1.0 - b - c, b, c].map(f64::from)
    }
}

/// The shape of the light of a patch, from the means of φ y over each replicate. `shares` are the shares of the rays.
fn measured<const C: usize>(
    parts: &[[[f64; MODES]; C]; REPLICATES],
    shares: [f64; REPLICATES],
) -> Measured<C> {
    const HALF: usize = REPLICATES / 2;
    let mut found = Measured::NONE;
    let of_half: [f64; 2] = [0, 1].map(|half| shares[half * HALF..][..HALF].iter().sum());
    for c in 0..C {
        for m in 0..MODES {
            for k in 0..REPLICATES {
                found.halves[k / HALF][c][m] += shares[k] / of_half[k / HALF] * parts[k][c][m] / SQUARES[m];
            }
        }
        for (m, square) in SQUARES.iter().enumerate().take(2) {
            let mean: f64 = (0..REPLICATES).map(|k| shares[k] * parts[k][c][m]).sum();
            let squares: f64 = parts.iter().map(|part| (part[c][m] - mean).powi(2)).sum();
            let count = REPLICATES as f64;
            found.noise += squares / (count * (count - 1.0)) / square;
        }
    }
    found
}

/// How the direct light of a patch varies.
#[derive(Clone)]
pub(crate) struct Shape<const C: usize> {
    /// Slopes and curvatures.
    pub(crate) measured: Measured<C>,
    /// What the mean light of each cell has beyond these, by each half of the rays. Shadows have edges, which no
    /// polynomial describes.
    pub(crate) cells: [[[f64; CELLS]; C]; 2],
    /// What textures of lamps add to the mean over the patch, by each half of the rays: lamps emit as much everywhere on
    /// one of their patches.
    pub(crate) of_textures: [[f64; C]; 2],
}

impl<const C: usize> Shape<C> {
    pub(crate) const NONE: Self =
        Shape { measured: Measured::NONE, cells: [[[0.0; CELLS]; C]; 2], of_textures: [[0.0; C]; 2] };
}

/// Lamps that emit `emission`; it and the results are in multiples of `unit`. Suns and points in `dark` do not shine.
#[derive(Clone, Copy)]
pub(crate) struct Emission<'a, const C: usize> {
    pub(crate) emission: &'a [[f64; C]],
    pub(crate) unit: f64,
    pub(crate) dark: &'a [String],
}

impl ShadowRays {
    /// The shape of the direct light of some patches, without the sky. `seed` must be the seed of the rays cast.
    pub(crate) fn shapes<const C: usize>(
        &self,
        (scene, tracer, patches): (&Scene, &Tracer, &Patches),
        range: Range<usize>,
        light: Emission<C>,
        seed: u64,
    ) -> Vec<Shape<C>> {
        if self.lamps.is_empty() {
            return vec![Shape::NONE; range.len()];
        }
        let sent = self.lamps.sent(light.emission, light.unit, light.dark);
        let textured: Vec<_> = self.lamps.pieces.iter().map(|piece| piece.textured(scene, patches)).collect();
        let pass = Pass { rays: self, scene, tracer, patches, sent: &sent, textured: &textured, seed };
        let scratch = || Scratch::new(self.lamps.count);
        range
            .into_par_iter()
            .with_min_len(4)
            .map_init(scratch, |scratch, i| pass.shape_of(i, scratch))
            .collect()
    }
}

struct Pass<'a, const C: usize> {
    rays: &'a ShadowRays,
    scene: &'a Scene,
    tracer: &'a Tracer,
    patches: &'a Patches,
    sent: &'a [[f64; C]],
    textured: &'a [Option<(usize, &'a Footprint)>],
    seed: u64,
}

impl<const C: usize> Pass<'_, C> {
    fn shape_of(&self, i: usize, scratch: &mut Scratch) -> Shape<C> {
        let Pass { tracer, patches, sent, .. } = *self;
        let lamps = &self.rays.lamps;
        let rays = self.rays.of(i);
        let from = Footprint::new(tracer, patches, i);
        let Some(choice) = lamps.choice(&from, self.rays.unoccluded(i)).filter(|_| !rays.is_empty()) else {
            return Shape::NONE;
        };
        let known = lamps.are_known();
        let mut cells = [[[0.0; CELLS]; C]; 2];
        // Moments of the known unblocked light, times the unblocked share for each half.
        let mut controlled = [[[0.0; MODES]; C]; HALVES];
        if known {
            scratch.look(self.rays, i);
            let facing = lamps.facing(tracer, patches, i);
            for ((piece, sent), &f) in lamps.pieces.iter().zip(sent).zip(self.rays.unoccluded(i)) {
                let free: [f64; HALVES] = std::array::from_fn(|half| scratch.free[half][piece.lamp]);
                if f == 0.0 || free == [0.0; HALVES] {
                    continue;
                }
                let Some(moments) = piece.moments(&facing) else {
                    // Without known moments the lamp gets no control variate.
                    (0..HALVES).for_each(|half| scratch.free[half][piece.lamp] = 0.0);
                    continue;
                };
                for half in 0..HALVES {
                    for c in 0..C {
                        (0..MODES).for_each(|m| controlled[half][c][m] += free[half] * moments[m] * sent[c]);
                    }
                }
                if let Some(of_cells) = piece.of_cells(&facing) {
                    let free = free.iter().sum::<f64>() / HALVES as f64;
                    for cells in &mut cells {
                        for c in 0..C {
                            (0..CELLS).for_each(|k| cells[c][k] += free * of_cells[k] * sent[c]);
                        }
                    }
                }
            }
        }
        let local = Local::new(&from);
        let mut parts = [[[0.0; MODES]; C]; REPLICATES];
        let mut of_textures = [[0.0; C]; 2];
        let ranges: [_; REPLICATES] = std::array::from_fn(|k| part(rays.len() as u32, k));
        let replicate_of = |s: usize| ranges.partition_point(|range| range.end <= s);
        let middle = ranges[REPLICATES / 2].start;
        let of_half = [middle as f64, (rays.len() - middle) as f64];
        for (range, part) in ranges.iter().zip(&mut parts) {
            for s in range.clone() {
                for c in 0..C {
                    (0..MODES).for_each(|m| part[c][m] += controlled[s % HALVES][c][m] / range.len() as f64);
                }
            }
        }
        let seed = mix(&[self.seed, i as u64, 1]);
        for (index, path) in paths(lamps, &choice, &from, 0..rays.len() as u32, seed) {
            let (s, ray) = (index as usize, rays[index as usize]);
            let (piece, half) = (ray.piece(), usize::from(index as usize >= middle));
            let free = if known { scratch.free[s % HALVES][lamps.pieces[piece].lamp] } else { 0.0 };
            let weight = f64::from(ray.weight());
            if weight > 0.0
                && let Some(more) = self.of_texture(piece, path.to)
            {
                (0..C)
                    .for_each(|c| of_textures[half][c] += weight * sent[piece][c] * more[c] / of_half[half]);
            }
            let left = weight.max(0.0) - free * weight.abs();
            if left == 0.0 {
                continue;
            }
            let (k, there) = (replicate_of(s), local.barycentric(path.from));
            let (basis, cell) = (modes(there), cell(there));
            for c in 0..C {
                let light = left * sent[piece][c];
                (0..MODES).for_each(|m| parts[k][c][m] += light * basis[m] / ranges[k].len() as f64);
                cells[half][c][cell] += CELLS as f64 * light / of_half[half];
            }
        }
        let shares = ranges.map(|range| range.len() as f64 / rays.len() as f64);
        let cells = cells.map(|cells| cells.map(|cells| beyond_modes(&cells)));
        Shape { measured: measured(&parts, shares), cells, of_textures }
    }

    /// What a textured piece emits at a point beyond its mean, relative to the mean.
    fn of_texture(&self, piece: usize, point: Vec3A) -> Option<[f64; C]> {
        let (patch, footprint) = self.textured[piece]?;
        let there = Local::new(footprint).barycentric(point);
        let corners = self.patches.barycentric_corners(patch);
        let here = self.scene.emission_at(self.patches.triangle(patch), in_triangle(there, &corners));
        let mean = &self.patches.emission()[patch * C..][..C];
        let more =
            |c: usize| if mean[c] > 0.0 { std::f64::consts::PI * here[c] / mean[c] - 1.0 } else { 0.0 };
        Some(std::array::from_fn(more))
    }
}
