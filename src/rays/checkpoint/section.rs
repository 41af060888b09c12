//! Reads and writes the rays of one kind and one subdivision.

use std::{
    ops::Range,
    path::PathBuf,
    sync::{Arc, atomic::Ordering::Relaxed},
};

use super::{
    Checkpoint,
    format::{Key, Piece, begin_record, damage, piece_start, seal_record},
};
use crate::{Error, Result, trace::sampling::mix};

/// A stage of casting is not shared out if it adds at most one in this number to the rays of a part. It costs each part
/// this share of its time, and spares it the wait for the others.
const FEW: u64 = 8;

/// The rays of one kind and one subdivision in a checkpoint.
#[derive(Debug, Clone)]
pub(crate) struct Section {
    checkpoint: Arc<Checkpoint>,
    digest: u64,
}

/// Rays to be written to the file together.
#[derive(Default)]
pub(crate) struct Record {
    bytes: Vec<u8>,
    pieces: Vec<(Key, Piece)>,
}

impl Section {
    /// The section with this digest.
    ///
    /// # Panics
    /// When the checkpoint belongs to another seed.
    pub(crate) fn new(checkpoint: Arc<Checkpoint>, digest: u64, seed: u64) -> Section {
        assert_eq!(checkpoint.seed, seed, "the checkpoint belongs to another seed");
        Section { checkpoint, digest }
    }

    /// The section for rays of another kind with the same patches.
    pub(crate) fn of_kind(&self, kind: u64) -> Section {
        Section { checkpoint: self.checkpoint.clone(), digest: mix(&[self.digest, kind]) }
    }

    /// Reads the known rays among the `wanted` numbers of a patch, without gaps from the first on. The patch is given
    /// by number and surface. `decode` turns the `S` bytes of a ray into a value, and invalid bytes into `None`.
    ///
    /// # Errors
    /// [`Error::Io`], and [`Error::Input`] when the file has invalid contents.
    pub(crate) fn known<const S: usize, T>(
        &self,
        (patch, surface): (u32, u32),
        wanted: Range<u32>,
        decode: impl Fn([u8; S]) -> Option<T>,
    ) -> Result<Vec<T>> {
        let checkpoint = &*self.checkpoint;
        let mut store = checkpoint.store();
        let Some(kept) = store.known.get(&(self.digest, patch, surface)) else { return Ok(Vec::new()) };
        let needed = |p: &&Piece| p.to > wanted.start && p.from < wanted.end;
        let needed: Vec<Piece> = kept.pieces.iter().filter(needed).copied().collect();
        let read: Vec<_> =
            needed.into_iter().map(|piece| Ok((piece, store.read(&piece)?))).collect::<Result<_>>()?;
        let path = |piece: &Piece| store.files[piece.file as usize].0.clone();
        let paths: Vec<PathBuf> = read.iter().map(|(piece, _)| path(piece)).collect();
        drop(store);
        let mut rays = Vec::with_capacity(wanted.len());
        for ((piece, bytes), path) in read.into_iter().zip(paths) {
            let damaged = || damage(&path, &format!("byte {}", piece.at));
            if piece.size as usize != S {
                return Err(damaged());
            }
            for (index, &bytes) in (piece.from..).zip(bytes.as_chunks::<S>().0) {
                // Pieces of several files may overlap.
                if index == wanted.start + rays.len() as u32 && index < wanted.end {
                    rays.push(decode(bytes).ok_or_else(damaged)?);
                }
            }
        }
        Ok(rays)
    }

    /// Whether this run casts the rays of a patch if no file holds them. Stages with few rays are not shared out.
    pub(crate) fn casts(&self, patch: u32, is_shared: bool) -> bool {
        !is_shared || self.checkpoint.part.contains(patch)
    }

    /// Whether to share out a stage of casting with this number of `new` rays, of `all` rays so far. Rays that every part
    /// casts for itself spare it the wait for the other parts.
    pub(crate) fn shares_out(&self, new: u64, all: u64) -> bool {
        let parts = u64::from(self.checkpoint.part.count());
        parts > 1 && FEW * parts * new > all
    }

    /// Notes rays that another part has to cast.
    pub(crate) fn lack(&self, rays: u32) {
        self.checkpoint.lacking.fetch_add(rays.into(), Relaxed);
    }

    /// Whether rays of other parts are missing.
    pub(crate) fn is_lacking(&self) -> bool {
        self.checkpoint.lacking() > 0
    }

    /// Adds rays of a patch to a record. `from` is the number of the first ray.
    pub(crate) fn add<const S: usize>(
        &self,
        record: &mut Record,
        (patch, surface): (u32, u32),
        from: u32,
        rays: impl ExactSizeIterator<Item = [u8; S]>,
    ) {
        if rays.len() == 0 {
            return;
        }
        let Record { bytes, pieces } = record;
        if bytes.is_empty() {
            begin_record(bytes, self.digest);
        }
        let key = (self.digest, patch, surface);
        let mut piece = Piece { file: 0, at: 0, from, to: from + rays.len() as u32, size: S as u32 };
        bytes.extend(piece_start(key, &piece));
        piece.at = bytes.len() as u64;
        pieces.push((key, piece));
        rays.for_each(|ray| bytes.extend(ray));
    }

    /// Writes a record, unless it is empty, and now and then forces the file to the disk.
    ///
    /// # Errors
    /// [`Error::Io`]. The contents of the file stay valid.
    pub(crate) fn write(&self, record: Record) -> Result<()> {
        let Record { mut bytes, pieces } = record;
        if pieces.is_empty() {
            return Ok(());
        }
        seal_record(&mut bytes);
        let checkpoint = &*self.checkpoint;
        let mut store = checkpoint.store();
        let start = store.end;
        let path = store.files[0].0.clone();
        let failed = |e| Error::io(&path, e);
        store.append(&bytes).map_err(failed)?;
        for (key, piece) in pieces {
            store.add(key, Piece { at: start + piece.at, ..piece });
        }
        let due = store.due().map_err(failed)?;
        // Other threads continue meanwhile.
        drop(store);
        due.map_or(Ok(()), |file| file.sync_data()).map_err(failed)
    }
}
