//! Casting rays: which patches need more of them, what they hit, and which backs become patches.

use std::{ops::Range, time::Instant};

use rayon::prelude::*;

use super::{
    super::checkpoint::{RUN, Record},
    BACK, ESCAPED, RaySet,
};
use crate::{
    Progress, Result,
    direct::footprint::Footprint,
    patch::Patches,
    scene::Scene,
    trace::{Tracer, sampling::mix},
};

/// Patches whose rays a thread casts together. They share a record in a checkpoint.
const BLOCK: usize = RUN as usize;

impl RaySet {
    /// Casts rays until every patch has the `wanted` number. Rays cast before are kept. Backs that are hit become
    /// patches and cast rays too, until no new ones are found. The result depends on the seed alone, not on the number
    /// of threads. If the checkpoint is that of one part and rays of others are missing, the rays are incomplete.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped) when `progress` says so.
    pub(in super::super) fn extend(
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
            let old = self.make_room(first..last, &wanted);
            progress.begin("casting rays", self.rays() - before);
            self.cast(tracer, patches, first, (&old, self.rays() - before), seed, progress)?;
            if self.is_lacking() {
                return Ok(());
            }
            let seen = backs_seen(patches, &self.targets);
            patches.add_backs(scene, &seen);
            first = last;
        }
        self.name_backs(patches);
        self.seconds += start.elapsed().as_secs_f64();
        Ok(())
    }

    /// Makes room for the wanted rays, and returns how many each patch had.
    fn make_room(&mut self, range: Range<usize>, wanted: impl Fn(usize) -> u32) -> Vec<u32> {
        let mut old: Vec<u32> = (0..self.len()).map(|i| self.rays_of(i)).collect();
        old.resize(range.end, 0);
        let mut offsets = vec![0];
        for (i, &had) in old.iter().enumerate() {
            let wanted = if range.contains(&i) { wanted(i).max(had) } else { had };
            offsets.push(offsets[i] + wanted as usize);
        }
        // The rays of new patches follow those of old ones. The rays of old patches are moved apart.
        if range.start > 0 || self.is_empty() {
            self.targets.resize(offsets[range.end], ESCAPED);
        } else {
            let mut apart = vec![ESCAPED; offsets[range.end]];
            (0..self.len()).for_each(|i| apart[offsets[i]..][..self.of(i).len()].copy_from_slice(self.of(i)));
            self.targets = apart;
        }
        self.offsets = offsets;
        old
    }

    /// Casts the `new` rays of the patches from `first` on. Rays in the checkpoint are read instead.
    fn cast(
        &mut self,
        tracer: &Tracer,
        patches: &Patches,
        first: usize,
        (old, new): (&[u32], u64),
        seed: u64,
        progress: &Progress,
    ) -> Result<()> {
        let RaySet { offsets, targets, checkpoint, ranks, .. } = self;
        let ranks = *ranks;
        let checkpoint = checkpoint.as_ref();
        let is_shared = checkpoint.is_some_and(|section| section.shares_out(new, targets.len() as u64));
        let names = Names::new(patches);
        let mut rest = &mut targets[offsets[first]..];
        let mut blocks = Vec::new();
        for start in (first..patches.len()).step_by(BLOCK) {
            let end = (start + BLOCK).min(patches.len());
            let (block, tail) = rest.split_at_mut(offsets[end] - offsets[start]);
            blocks.push((start..end, block));
            rest = tail;
        }
        let owner = |i: usize| ranks.of_turn((i - first) / BLOCK);
        blocks.into_par_iter().try_for_each(|(range, mut rest)| {
            let mut record = Record::default();
            if owner(range.start) != ranks.rank() {
                range
                    .for_each(|i| progress.advance((offsets[i + 1] - offsets[i]) as u64 - u64::from(old[i])));
                return Ok(());
            }
            for i in range {
                progress.check()?;
                let (own, tail) = rest.split_at_mut(offsets[i + 1] - offsets[i]);
                rest = tail;
                let (all, mut had) = (own.len() as u32, old[i]);
                let key = (i as u32, names.lasting(i as u32));
                if let Some(checkpoint) = checkpoint.filter(|_| had < all) {
                    let present = |bytes| names.present(u32::from_le_bytes(bytes));
                    let known = checkpoint.known(key, had..all, present)?;
                    own[had as usize..][..known.len()].copy_from_slice(&known);
                    had += known.len() as u32;
                    if had < all && !checkpoint.casts(i as u32, is_shared) {
                        checkpoint.lack(all - had);
                        continue;
                    }
                }
                let from = Footprint::new(tracer, patches, i);
                cast_patch(tracer, patches, &from, had..all, mix(&[seed, i as u64]), own);
                if let Some(checkpoint) = checkpoint {
                    let new = own[had as usize..].iter().map(|&target| names.lasting(target).to_le_bytes());
                    checkpoint.add(&mut record, key, had, new);
                }
                progress.advance(u64::from(all - old[i]));
            }
            checkpoint.map_or(Ok(()), |checkpoint| checkpoint.write(record))
        })?;
        let new = |i: usize| (offsets[i] + old[i] as usize..offsets[i + 1], owner(i));
        ranks.share(targets.as_chunks_mut::<1>().0, (first..patches.len()).map(new));
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
        self.back_hits = self.targets.par_iter_mut().map(name).sum();
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

/// Names of patches that do not depend on the order in which backs are found: the number of the front, with a mark for
/// its back.
pub(in super::super) struct Names<'a> {
    patches: &'a Patches,
    /// The front of each back that is a patch.
    fronts: Vec<u32>,
}

impl<'a> Names<'a> {
    pub(in super::super) fn new(patches: &'a Patches) -> Self {
        let mut fronts = vec![0; patches.len() - patches.fronts()];
        for front in 0..patches.fronts() {
            if let Some(back) = patches.back_of(front) {
                fronts[back as usize - patches.fronts()] = front as u32;
            }
        }
        Names { patches, fronts }
    }

    pub(in super::super) fn lasting(&self, target: u32) -> u32 {
        match (target as usize).checked_sub(self.patches.fronts()) {
            Some(back) if target & BACK == 0 => BACK | self.fronts[back],
            _ => target,
        }
    }

    /// The number of a target among the present patches; `None` if there is no such patch.
    fn present(&self, lasting: u32) -> Option<u32> {
        let front = (lasting & !BACK) as usize;
        match lasting {
            ESCAPED => Some(lasting),
            _ if front >= self.patches.fronts() => None,
            _ if lasting & BACK == 0 => Some(lasting),
            _ => Some(self.patches.back_of(front).unwrap_or(lasting)),
        }
    }
}
