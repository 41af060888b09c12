//! The file of a checkpoint, and an index of the rays in it.

use std::{
    collections::HashMap,
    fs::{self, File},
    io::{self, BufRead, BufReader, Read, Seek, SeekFrom, Write},
    path::Path,
    time::{Duration, Instant},
};

use super::format::{AFTER, BEFORE, HEADER, Key, Piece, body_length, damage, pieces};
use crate::{Error, Result};

/// Interval at which written records are forced to the disk.
const SYNC_EVERY: Duration = Duration::from_secs(5);

#[derive(Debug)]
pub(super) struct Store {
    pub(super) file: File,
    /// Position of the next record.
    pub(super) end: u64,
    pub(super) rays: u64,
    /// Whether this run created the file.
    made: bool,
    /// Time when the file was last forced to the disk, and its end then.
    synced: (Instant, u64),
    pub(super) known: HashMap<Key, Kept>,
}

/// The rays of one patch.
#[derive(Debug, Default)]
pub(super) struct Kept {
    /// Number of rays.
    pub(super) rays: u32,
    pub(super) pieces: Vec<Piece>,
}

impl Store {
    /// The store of a file without records.
    pub(super) fn new(file: File, made: bool) -> Store {
        let end = HEADER as u64;
        Store { file, end, rays: 0, made, synced: (Instant::now(), end), known: HashMap::new() }
    }

    /// Removes the file if this run created it and it holds no rays.
    pub(super) fn discard(&self, path: &Path) {
        if self.made && self.rays == 0 {
            let _ = fs::remove_file(path);
        }
    }

    /// Forces the rest of the file to the disk. A failure cannot be reported any more.
    pub(super) fn finish(&self) {
        if self.end > self.synced.1 {
            let _ = self.file.sync_data();
        }
    }

    /// Reads the index of all records.
    pub(super) fn load(&mut self, path: &Path, size: u64) -> Result<()> {
        let failed = |e| Error::io(path, e);
        let mut reader = BufReader::with_capacity(1 << 20, self.file.try_clone().map_err(failed)?);
        reader.seek(SeekFrom::Start(self.end)).map_err(failed)?;
        let damaged = |at: u64| damage(path, &format!("byte {at}"));
        loop {
            let left = size - self.end;
            let mut before = [0; BEFORE];
            if left < BEFORE as u64 {
                return Ok(());
            }
            reader.read_exact(&mut before).map_err(failed)?;
            let Some(length) = body_length(&before) else {
                let unwritten = is_unwritten(&mut reader, self.end + BEFORE as u64 - 1).map_err(failed)?;
                return if unwritten { Ok(()) } else { Err(damaged(self.end)) };
            };
            if left < length.saturating_add((BEFORE + AFTER) as u64) {
                return Ok(());
            }
            let mut body = vec![0; length as usize + AFTER];
            reader.read_exact(&mut body).map_err(failed)?;
            let (body, check) = body.split_at(length as usize);
            let end = self.end + length + (BEFORE + AFTER) as u64;
            if crc32fast::hash(body).to_le_bytes() != check {
                let unwritten = is_unwritten(&mut reader, end - 1).map_err(failed)?;
                return if unwritten { Ok(()) } else { Err(damaged(self.end)) };
            }
            let pieces = pieces(body, self.end + BEFORE as u64).ok_or_else(|| damaged(self.end))?;
            if pieces.into_iter().any(|(key, piece)| !self.add(key, piece)) {
                return Err(damaged(self.end));
            }
            (self.end, self.synced.1) = (end, end);
        }
    }

    /// Adds a piece to the index. Returns false if it does not follow the pieces already known.
    pub(super) fn add(&mut self, key: Key, piece: Piece) -> bool {
        let Piece { from, to, .. } = piece;
        let kept = self.known.entry(key).or_default();
        let fits = from == kept.rays && from < to;
        if fits {
            kept.rays = to;
            kept.pieces.push(piece);
            self.rays += u64::from(to - from);
        }
        fits
    }

    pub(super) fn read(&mut self, piece: &Piece) -> io::Result<Vec<u8>> {
        let mut bytes = vec![0; piece.bytes()];
        self.file.seek(SeekFrom::Start(piece.at))?;
        self.file.read_exact(&mut bytes)?;
        Ok(bytes)
    }

    /// Appends a record as a whole, or leaves the file unchanged.
    pub(super) fn append(&mut self, record: &[u8]) -> io::Result<()> {
        self.file.seek(SeekFrom::Start(self.end))?;
        self.file.write_all(record).inspect_err(|_| {
            let _ = self.file.set_len(self.end);
        })?;
        self.end += record.len() as u64;
        Ok(())
    }

    /// The file, if it is time to force it to the disk again.
    pub(super) fn due(&mut self) -> io::Result<Option<File>> {
        if self.synced.0.elapsed() < SYNC_EVERY {
            return Ok(None);
        }
        self.synced = (Instant::now(), self.end);
        self.file.try_clone().map(Some)
    }
}

/// Whether the file contains only zeros from this byte to its end.
fn is_unwritten(file: &mut (impl BufRead + Seek), from: u64) -> io::Result<bool> {
    file.seek(SeekFrom::Start(from))?;
    loop {
        let bytes = file.fill_buf()?;
        if bytes.is_empty() || bytes.iter().any(|&byte| byte != 0) {
            return Ok(bytes.is_empty());
        }
        let length = bytes.len();
        file.consume(length);
    }
}
