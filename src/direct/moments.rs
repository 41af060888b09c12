//! Slopes of direct light over a patch: first moments of the shadow rays over their starting points.
//!
//! The samples y = (V - β) w B + β G of `irradiance` estimate slopes as they estimate the mean. The moments of the
//! control variate β G are known too. So unblocked light has exact slopes, and rays sample only the variation of
//! shadows. Starting points are reproduced from the numbers of the rays; visibility is stored.

use glam::Vec3A;
use rayon::prelude::*;

use super::{
    irradiance::Scratch,
    shadow::{HALVES, ShadowRays, paths},
};
use crate::{
    patch::Patches,
    rays::{REPLICATES, footprint::Footprint, part},
    slopes::{Measured, SQUARES, basis},
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

    /// The basis functions at a point.
    #[inline]
    pub(crate) fn basis(&self, point: Vec3A) -> [f64; 2] {
        basis(self.barycentric(point))
    }

    /// Barycentric coordinates in the patch.
    #[inline]
    pub(crate) fn barycentric(&self, point: Vec3A) -> [f64; 3] {
        let off = point - self.corner;
        let [b, c] = self.across.map(|across| across.dot(off).clamp(0.0, 1.0));
        [1.0 - b - c, b, c].map(f64::from)
    }
}

/// The slopes of a patch, from the mean of φ y over each replicate, and its number of rays.
pub(crate) fn measured<const C: usize>(parts: &[[[f64; 2]; C]; REPLICATES], rays: usize) -> Measured<C> {
    let mut found = Measured::NONE;
    let share = |k: usize| part(rays as u32, k).len() as f64 / rays as f64;
    for c in 0..C {
        for m in 0..2 {
            let mean: f64 = (0..REPLICATES).map(|k| share(k) * parts[k][c][m]).sum();
            let squares: f64 = parts.iter().map(|part| (part[c][m] - mean).powi(2)).sum();
            let count = REPLICATES as f64;
            found.slopes[c][m] = mean / SQUARES[m];
            found.noise += squares / (count * (count - 1.0)) / SQUARES[m];
        }
    }
    found
}

impl ShadowRays {
    /// The slopes of the direct light of lamps, and of suns and points except those in `dark`, in multiples of `unit`,
    /// as `emission` is. `seed` must be the seed of the rays cast.
    pub(crate) fn slopes<const C: usize>(
        &self,
        tracer: &Tracer,
        patches: &Patches,
        (emission, unit, dark): (&[[f64; C]], f64, &[String]),
        seed: u64,
    ) -> Vec<Measured<C>> {
        let sent = self.lamps.sent(emission, unit, dark);
        let scratch = || Scratch::new(self.lamps.count);
        (0..patches.len())
            .into_par_iter()
            .with_min_len(64)
            .map_init(scratch, |scratch, i| self.slopes_of(tracer, patches, i, &sent, seed, scratch))
            .collect()
    }

    fn slopes_of<const C: usize>(
        &self,
        tracer: &Tracer,
        patches: &Patches,
        i: usize,
        sent: &[[f64; C]],
        seed: u64,
        scratch: &mut Scratch,
    ) -> Measured<C> {
        let rays = self.of(i);
        let from = Footprint::new(tracer, patches, i);
        let Some(choice) = self.lamps.choice(&from, self.unoccluded(i)).filter(|_| !rays.is_empty()) else {
            return Measured::NONE;
        };
        let known = self.lamps.are_known();
        // Moments of the known unblocked light, times the unblocked share for each half.
        let mut controlled = [[[0.0; 2]; C]; HALVES];
        if known {
            scratch.look(self, i);
            let facing = self.lamps.facing(tracer, patches, i);
            for ((piece, sent), &f) in self.lamps.pieces.iter().zip(sent).zip(self.unoccluded(i)) {
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
                        for m in 0..2 {
                            controlled[half][c][m] += free[half] * moments[m] * sent[c];
                        }
                    }
                }
            }
        }
        let local = Local::new(&from);
        let mut parts = [[[0.0; 2]; C]; REPLICATES];
        let ranges: [_; REPLICATES] = std::array::from_fn(|k| part(rays.len() as u32, k));
        let replicate_of = |s: usize| ranges.partition_point(|range| range.end <= s);
        for (range, part) in ranges.iter().zip(&mut parts) {
            for s in range.clone() {
                for c in 0..C {
                    for m in 0..2 {
                        part[c][m] += controlled[s % HALVES][c][m] / range.len() as f64;
                    }
                }
            }
        }
        let seed = mix(&[seed, i as u64, 1]);
        for (index, path) in paths(&self.lamps, &choice, &from, 0..rays.len() as u32, seed) {
            let (s, ray) = (index as usize, rays[index as usize]);
            let piece = ray.piece();
            let free = if known { scratch.free[s % HALVES][self.lamps.pieces[piece].lamp] } else { 0.0 };
            let weight = f64::from(ray.weight());
            let left = weight.max(0.0) - free * weight.abs();
            if left == 0.0 {
                continue;
            }
            let (k, basis) = (replicate_of(s), local.basis(path.from));
            for c in 0..C {
                for m in 0..2 {
                    parts[k][c][m] += left * sent[piece][c] * basis[m] / ranges[k].len() as f64;
                }
            }
        }
        measured(&parts, rays.len())
    }
}
