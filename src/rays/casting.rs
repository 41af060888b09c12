//! Casting rays: which patches need more of them, what they hit, and which backs become patches.

use std::{ops::Range, time::Instant};

use rayon::prelude::*;

use super::{BACK, ESCAPED, RaySet, footprint::Footprint, targets::Names};
use crate::{
    Progress, Result,
    patch::Patches,
    scene::Scene,
    trace::{Tracer, sampling::mix},
};

impl RaySet {
    /// Casts rays until every patch has the `wanted` number. Rays cast before are kept. Backs that are hit become
    /// patches and cast rays too, until no new ones are found. The result depends on the seed alone, not on the number
    /// of threads. If the checkpoint is that of one part and rays of others are missing, the rays are incomplete.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped) when `progress` says so.
    pub(crate) fn extend(
        &mut self,
        scene: &Scene,
        tracer: &Tracer,
        patches: &mut Patches,
        wanted: impl Fn(usize) -> u32,
        seed: u64,
        progress: &Progress,
    ) -> Result<()> {
        let start = Instant::now();
        let mut first = 0;
        while first < patches.len() {
            let last = patches.len();
            let before = self.rays();
            let old = self.targets.make_room(first..last, &wanted, ESCAPED);
            progress.begin("casting rays", self.rays() - before);
            let (names, all) = (Names::new(patches), self.rays());
            let encode = |target: u32| names.lasting(target).to_le_bytes();
            let decode = |bytes| names.present(u32::from_le_bytes(bytes));
            let casts = (self.checkpoint.as_ref(), all, self.ranks);
            let cast = |i: usize, indices: Range<u32>, own: &mut [u32]| {
                let from = Footprint::new(tracer, patches, i);
                cast_patch(tracer, patches, &from, indices, mix(&[seed, i as u64]), own);
            };
            self.targets.cast((first, &old), casts, (&names, encode, decode), progress, cast)?;
            if self.is_lacking() {
                return Ok(());
            }
            let seen = backs_seen(patches, &self.targets.all);
            patches.add_backs(scene, &seen);
            first = last;
        }
        self.name_backs(patches);
        self.seconds += start.elapsed().as_secs_f64();
        Ok(())
    }

    /// Replaces the [`BACK`] marks by the patches of these backs, and counts hits on backs.
    fn name_backs(&mut self, patches: &Patches) {
        let fronts = patches.fronts() as u32;
        let name = |target: &mut u32| {
            if *target == ESCAPED {
                return 0;
            }
            if *target & BACK != 0 {
                let front = (*target & !BACK) as usize;
                *target = patches.back_of(front).expect("backs that were hit are patches");
            }
            u64::from(*target >= fronts)
        };
        self.back_hits = self.targets.all.par_iter_mut().map(name).sum();
    }
}

/// Casts the rays of a patch with these indices. `targets` holds all rays of the patch.
fn cast_patch(
    tracer: &Tracer,
    patches: &Patches,
    from: &Footprint,
    indices: Range<u32>,
    seed: u64,
    targets: &mut [u32],
) {
    let rays = from.hemisphere_rays(indices, seed).map(|ray| (ray.index, ray.origin, ray.direction));
    tracer.closest_each(rays, |index, hit| {
        targets[index as usize] = hit.map_or(ESCAPED, |hit| {
            patches.at(hit.triangle, hit.barycentric, hit.front).unwrap_or_else(|| {
                BACK | patches.at(hit.triangle, hit.barycentric, true).expect("fronts are patches")
            })
        });
    });
}

/// Triangles with hit backs that are not unknowns yet, in file order.
fn backs_seen(patches: &Patches, targets: &[u32]) -> Vec<u32> {
    let backs = targets.par_iter().filter(|&&target| target != ESCAPED && target & BACK != 0);
    let mut seen: Vec<u32> = backs.map(|target| patches.triangle((target & !BACK) as usize) as u32).collect();
    seen.par_sort_unstable();
    seen.dedup();
    seen
}
