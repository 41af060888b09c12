//! Lists of rays, one for each patch. Rays are read from a checkpoint, or cast by the threads of one or more ranks.

use std::ops::Range;

use rayon::prelude::*;

use super::{
    checkpoint::{RUN, Record, Section},
    targets::Names,
};
use crate::{Progress, Ranks, Result, ranks::Words};

/// Patches whose rays a thread casts together. They share a record in a checkpoint.
const BLOCK: usize = RUN as usize;

/// The rays of all patches, one list after the other.
#[derive(Debug, Clone)]
pub(crate) struct Lists<R> {
    /// Where the rays of each patch begin in `all`, and where the last ones end.
    offsets: Vec<usize>,
    pub(crate) all: Vec<R>,
}

impl<R> Default for Lists<R> {
    fn default() -> Self {
        Lists { offsets: vec![0], all: Vec::new() }
    }
}

impl<R: Words + Copy + Send + Sync> Lists<R> {
    /// Number of patches.
    pub(crate) fn len(&self) -> usize {
        self.offsets.len() - 1
    }

    fn range(&self, i: usize) -> Range<usize> {
        if i < self.len() { self.offsets[i]..self.offsets[i + 1] } else { 0..0 }
    }

    /// The rays of patch `i`; none if there is no list for it.
    pub(crate) fn of(&self, i: usize) -> &[R] {
        &self.all[self.range(i)]
    }

    /// Number of rays of patch `i`.
    pub(crate) fn count(&self, i: usize) -> u32 {
        self.range(i).len() as u32
    }

    /// Replaces all rays of patch `i`.
    pub(crate) fn fill(&mut self, i: usize, ray: R) {
        let range = self.range(i);
        self.all[range].fill(ray);
    }

    /// The first or second half of every list; `None` if a list has only one ray.
    pub(crate) fn half(&self, half: usize) -> Option<Self> {
        let mut part =
            Lists { offsets: vec![0], all: Vec::with_capacity(self.all.len().div_ceil(2) + self.len()) };
        for i in 0..self.len() {
            let (all, middle) = (self.of(i), self.of(i).len() / 2);
            if all.len() == 1 {
                return None;
            }
            part.all.extend_from_slice([&all[..middle], &all[middle..]][half]);
            part.offsets.push(part.all.len());
        }
        Some(part)
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.all[..]) + size_of_val(&self.offsets[..])
    }

    /// Makes room for the wanted rays of these patches, filled with `none`. Returns how many each patch had.
    pub(crate) fn make_room(
        &mut self,
        range: Range<usize>,
        wanted: impl Fn(usize) -> u32,
        none: R,
    ) -> Vec<u32> {
        let old: Vec<u32> = (0..range.end).map(|i| self.count(i)).collect();
        let mut offsets = vec![0];
        for (i, &had) in old.iter().enumerate() {
            let wanted = if range.contains(&i) { wanted(i).max(had) } else { had };
            offsets.push(offsets[i] + wanted as usize);
        }
        // The rays of new patches follow those of old ones. The rays of old patches are moved apart.
        if range.start > 0 || self.all.is_empty() {
            self.all.resize(offsets[range.end], none);
        } else {
            let mut apart = vec![none; offsets[range.end]];
            (0..self.len()).for_each(|i| apart[offsets[i]..][..self.of(i).len()].copy_from_slice(self.of(i)));
            self.all = apart;
        }
        self.offsets = offsets;
        old
    }

    /// Calls `cast` for the new rays of each patch from `first` on, with the patch, the numbers of the rays and the list.
    /// `old` are the numbers of rays that patches had. Rays that the section of a checkpoint holds are read instead. If
    /// the checkpoint is that of one part of the patches, rays of other parts may be missing afterwards. `all` is the
    /// number of rays of all kinds so far.
    pub(crate) fn cast<const S: usize>(
        &mut self,
        (first, old): (usize, &[u32]),
        (section, all, ranks): (Option<&Section>, u64, Ranks),
        (names, encode, decode): (&Names, impl Fn(R) -> [u8; S] + Sync, impl Fn([u8; S]) -> Option<R> + Sync),
        progress: &Progress,
        cast: impl Fn(usize, Range<u32>, &mut [R]) + Sync,
    ) -> Result<()> {
        let Lists { offsets, all: rays } = self;
        let count = |i: usize| (offsets[i + 1] - offsets[i]) as u32;
        let patches = offsets.len() - 1;
        let new = (first..patches).map(|i| u64::from(count(i) - old[i])).sum();
        let is_shared = section.is_some_and(|section| section.shares_out(new, all));
        let mut rest = &mut rays[offsets[first]..];
        let mut blocks = Vec::new();
        for start in (first..patches).step_by(BLOCK) {
            let end = (start + BLOCK).min(patches);
            let (block, tail) = rest.split_at_mut(offsets[end] - offsets[start]);
            blocks.push((start..end, block));
            rest = tail;
        }
        blocks.into_par_iter().try_for_each(|(range, mut rest)| {
            let mut record = Record::default();
            if owner(range.start, first, ranks) != ranks.rank() {
                range.for_each(|i| progress.advance(u64::from(count(i) - old[i])));
                return Ok(());
            }
            for i in range {
                progress.check()?;
                let (own, tail) = rest.split_at_mut(count(i) as usize);
                rest = tail;
                let (all, mut had) = (count(i), old[i]);
                let key = (i as u32, names.lasting(i as u32));
                if let Some(section) = section.filter(|_| had < all) {
                    let known = section.known(key, had..all, &decode)?;
                    own[had as usize..][..known.len()].copy_from_slice(&known);
                    had += known.len() as u32;
                    if had < all && !section.casts(i as u32, is_shared) {
                        section.lack(all - had);
                        continue;
                    }
                }
                cast(i, had..all, own);
                if let Some(section) = section {
                    section.add(&mut record, key, had, own[had as usize..].iter().map(|&ray| encode(ray)));
                }
                progress.advance(u64::from(all - old[i]));
            }
            section.map_or(Ok(()), |section| section.write(record))
        })?;
        let new = |i: usize| (offsets[i] + old[i] as usize..offsets[i + 1], owner(i, first, ranks));
        ranks.share(rays, (first..patches).map(new));
        Ok(())
    }
}

/// The rank that casts the rays of patch `i`.
fn owner(i: usize, first: usize, ranks: Ranks) -> usize {
    ranks.of_turn((i - first) / BLOCK)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lists of 2, 0 and 4 rays grow at their ends, and a list of a new patch follows.
    #[test]
    fn lists_grow_and_are_halved() {
        let mut lists = Lists::default();
        let first: [u32; 3] = [2, 0, 4];
        assert_eq!(lists.make_room(0..3, |i| first[i], 7), [0; 3]);
        assert_eq!(lists.make_room(0..3, |_| 3, 8), first);
        assert_eq!([0, 1, 2].map(|i| lists.of(i)), [&[7, 7, 8][..], &[8; 3], &[7; 4]]);
        assert_eq!(lists.make_room(3..4, |_| 2, 9), [3, 3, 4, 0]);
        assert_eq!((lists.len(), lists.of(3), lists.of(4)), (4, &[9, 9][..], &[][..]));
        let half = lists.half(1).unwrap();
        assert_eq!([0, 1, 2, 3].map(|i| half.of(i)), [&[7, 8][..], &[8; 2], &[7; 2], &[9]]);
        assert!(half.half(0).is_none(), "a list has only one ray");
    }
}
