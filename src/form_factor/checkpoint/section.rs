//! The rays of one subdivision: names that last for its patches, reading and writing.

use std::{io, sync::Arc};

use rayon::prelude::*;

use super::{
    super::{
        hemisphere::{BACK, LINKED, Share},
        shadow::{Found, Link, Sources},
    },
    Checkpoint,
    format::{Key, LINK, Piece, begin_record, damage, link, link_bytes, piece_start, seal_record},
};
use crate::{Error, Result, patch::Patches, trace::sampling::mix};

/// The rays of one subdivision in a checkpoint.
#[derive(Debug, Clone)]
pub(in super::super) struct Section {
    checkpoint: Arc<Checkpoint>,
    digest: u64,
}

impl Section {
    /// Of the fronts of `patches`. Where there are sources, rays that connect them are kept in another way.
    ///
    /// # Panics
    /// When the checkpoint is of another seed.
    pub(in super::super) fn new(
        checkpoint: Arc<Checkpoint>,
        patches: &Patches,
        sources: &Sources,
        seed: u64,
    ) -> Section {
        assert_eq!(checkpoint.seed, seed, "the checkpoint is of another seed");
        let of_patch = |i: usize| {
            let corners = patches.barycentric_corners(i).map(|b| mix(&b.map(f64::to_bits)));
            mix(&[patches.triangle(i) as u64, mix(&corners)])
        };
        let all: Vec<u64> = (0..patches.fronts()).into_par_iter().with_min_len(1024).map(of_patch).collect();
        let digest = mix(&[sources.is_empty().into(), mix(&all)]);
        Section { checkpoint, digest }
    }

    /// Ready to read and write while these are the patches.
    pub(in super::super) fn names<'a>(&'a self, patches: &'a Patches, sources: &'a Sources) -> Names<'a> {
        let mut fronts = vec![0; patches.len() - patches.fronts()];
        for front in 0..patches.fronts() {
            if let Some(back) = patches.back_of(front) {
                fronts[back as usize - patches.fronts()] = front as u32;
            }
        }
        Names { section: self, patches, sources, fronts }
    }
}

/// A section, with names for patches that do not depend on the order in which backs are found: the number of a front, marked
/// where its back is meant.
pub(in super::super) struct Names<'a> {
    section: &'a Section,
    patches: &'a Patches,
    sources: &'a Sources,
    /// Of each back that is a patch, the front.
    fronts: Vec<u32>,
}

/// What is known of the rays that a patch shall cast.
pub(in super::super) struct Known {
    /// All before these numbers.
    pub(in super::super) rays: Share,
    pub(in super::super) targets: Vec<u32>,
    pub(in super::super) hemisphere_links: Vec<Link>,
    pub(in super::super) shadow_links: Vec<Link>,
}

impl Known {
    /// None beyond those it has.
    pub(in super::super) fn nothing(had: Share) -> Known {
        Known { rays: had, targets: Vec::new(), hemisphere_links: Vec::new(), shadow_links: Vec::new() }
    }
}

/// Rays just cast, on their way into the file.
#[derive(Default)]
pub(in super::super) struct Record {
    bytes: Vec<u8>,
    pieces: Vec<(Key, Piece)>,
}

impl Names<'_> {
    fn lasting(&self, target: u32) -> u32 {
        match (target as usize).checked_sub(self.patches.fronts()) {
            Some(back) if target & BACK == 0 => BACK | self.fronts[back],
            _ => target,
        }
    }

    /// What rays of the present patches are told to have met; `None` when there is no such patch.
    fn present(&self, lasting: u32) -> Option<u32> {
        let front = (lasting & !BACK) as usize;
        match lasting {
            LINKED.. => Some(lasting),
            _ if front >= self.patches.fronts() => None,
            _ if lasting & BACK == 0 => Some(lasting),
            _ => Some(self.patches.back_of(front).unwrap_or(lasting)),
        }
    }

    fn key(&self, patch: usize) -> Key {
        (self.section.digest, patch as u32, self.lasting(patch as u32))
    }

    /// What is known of the rays of a patch that has these, and wants those.
    ///
    /// # Errors
    /// [`Error::Io`], and [`Error::Input`] when the file says what cannot be.
    pub(in super::super) fn known(&self, patch: usize, had: Share, wanted: Share) -> Result<Known> {
        let checkpoint = &*self.section.checkpoint;
        let mut known = Known::nothing(had);
        let mut store = checkpoint.store();
        let Some(kept) = store.known.get(&self.key(patch)) else { return Ok(known) };
        let more = |from: Share, to: Share| from.hemisphere < to.hemisphere || from.shadow < to.shadow;
        let needed: Vec<Piece> =
            kept.pieces.iter().filter(|p| more(had, p.to) && more(p.from, wanted)).copied().collect();
        known.rays.hemisphere = kept.rays.hemisphere.clamp(had.hemisphere, wanted.hemisphere);
        known.rays.shadow = kept.rays.shadow.clamp(had.shadow, wanted.shadow);
        let read: Vec<_> = needed
            .into_iter()
            .map(|piece| Ok((piece, store.read(&piece)?)))
            .collect::<io::Result<_>>()
            .map_err(|e| Error::io(&checkpoint.path, e))?;
        drop(store);
        let to = known.rays;
        for (piece, bytes) in read {
            self.decode(patch, (&piece, &bytes), (had, to), &mut known)
                .ok_or_else(|| damage(&checkpoint.path, &format!("byte {}", piece.at)))?;
        }
        Ok(known)
    }

    /// Adds the rays with numbers in a range; `None` when the bytes say what cannot be.
    fn decode(
        &self,
        patch: usize,
        (piece, bytes): (&Piece, &[u8]),
        (had, to): (Share, Share),
        known: &mut Known,
    ) -> Option<()> {
        let (targets, links) = bytes.split_at(4 * piece.targets());
        for (index, target) in (piece.from.hemisphere..).zip(targets.as_chunks::<4>().0) {
            if (had.hemisphere..to.hemisphere).contains(&index) {
                let target = u32::from_le_bytes(*target);
                // With a source at either end the pair has links.
                if target < LINKED && self.sources.concern(patch, target as usize) {
                    return None;
                }
                known.targets.push(self.present(target)?);
            }
        }
        for bytes in links.as_chunks::<LINK>().0 {
            let link = link(bytes)?;
            let of_shadow_ray = link.found != Found::Hemisphere;
            let j = link.to as usize;
            // Without a source at either end the pair would have no density.
            let is_link =
                if of_shadow_ray { self.sources.contains(j) } else { self.sources.concern(patch, j) };
            if link.to >= LINKED || !is_link || !(link.kernel >= 0.0) {
                return None;
            }
            let (list, range) = match of_shadow_ray {
                false => (&mut known.hemisphere_links, had.hemisphere..to.hemisphere),
                true => (&mut known.shadow_links, had.shadow..to.shadow),
            };
            if range.contains(&link.index) {
                list.push(Link { to: self.present(link.to)?, ..link });
            }
        }
        Some(())
    }

    /// Adds the rays of a patch from `from` on: all its targets up to `to`, and links among which those are.
    pub(in super::super) fn add(
        &self,
        record: &mut Record,
        patch: usize,
        (from, to): (Share, Share),
        targets: &[u32],
        links: &[Link],
    ) {
        if from == to {
            return;
        }
        let Record { bytes, pieces } = record;
        if bytes.is_empty() {
            begin_record(bytes, self.section.digest);
        }
        let is_new = |link: &&Link| {
            link.index >= if link.found == Found::Hemisphere { from.hemisphere } else { from.shadow }
        };
        let key = self.key(patch);
        let count = links.iter().filter(is_new).count() as u32;
        let mut piece = Piece { at: 0, from, to, links: count };
        bytes.extend(piece_start(key, &piece));
        piece.at = bytes.len() as u64;
        pieces.push((key, piece));
        for &target in &targets[from.hemisphere as usize..] {
            bytes.extend(self.lasting(target).to_le_bytes());
        }
        for link in links.iter().filter(is_new) {
            bytes.extend(link_bytes(&Link { to: self.lasting(link.to), ..*link }));
        }
    }

    /// Writes what was added, if anything, and now and then forces all that was written to the disk.
    ///
    /// # Errors
    /// [`Error::Io`]; what is in the file stays good.
    pub(in super::super) fn write(&self, record: Record) -> Result<()> {
        let Record { mut bytes, pieces } = record;
        if pieces.is_empty() {
            return Ok(());
        }
        seal_record(&mut bytes);
        let checkpoint = &*self.section.checkpoint;
        let mut store = checkpoint.store();
        let start = store.end;
        let failed = |e| Error::io(&checkpoint.path, e);
        store.append(&bytes).map_err(failed)?;
        for (key, piece) in pieces {
            let follows = store.add(key, Piece { at: start + piece.at, ..piece });
            assert!(follows, "rays are cast in order");
        }
        let due = store.due().map_err(failed)?;
        // Others go on meanwhile.
        drop(store);
        due.map_or(Ok(()), |file| file.sync_data()).map_err(failed)
    }
}
