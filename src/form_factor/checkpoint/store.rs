//! The file of a checkpoint, and where in it the rays of each patch are.

use std::{
    collections::HashMap,
    fs::{self, File},
    io::{self, BufRead, BufReader, Read, Seek, SeekFrom, Write},
    path::Path,
    time::{Duration, Instant},
};

use super::format::{AFTER, BEFORE, HEADER, Key, Piece, body_length, damage, pieces};
use crate::{Error, Result};

/// Time after which what was written is forced to the disk.
const SYNC_EVERY: Duration = Duration::from_secs(5);

#[derive(Debug)]
pub(super) struct Store {
    pub(super) file: File,
    /// Where the next record goes.
    pub(super) end: u64,
    pub(super) rays: u64,
    /// Whether the file was made here.
    made: bool,
    /// When it was last forced to the disk, and where it ended then.
    synced: (Instant, u64),
    pub(super) known: HashMap<Key, Kept>,
}

/// The rays of one patch.
#[derive(Debug, Default)]
pub(super) struct Kept {
    /// How many there are.
    pub(super) rays: u32,
    pub(super) pieces: Vec<Piece>,
}

impl Store {
    /// Of a file without records.
    pub(super) fn new(file: File, made: bool) -> Store {
        let end = HEADER as u64;
        Store { file, end, rays: 0, made, synced: (Instant::now(), end), known: HashMap::new() }
    }

    /// Removes a file that was made here and holds nothing.
    pub(super) fn discard(&self, path: &Path) {
        if self.made && self.rays == 0 {
            let _ = fs::remove_file(path);
        }
    }

    /// Forces to the disk what is not there yet: nobody is left whom it could tell that this failed.
    pub(super) fn finish(&self) {
        if self.end > self.synced.1 {
            let _ = self.file.sync_data();
        }
    }

    /// Finds all records.
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

    /// Takes note of a piece, unless it does not follow what is known.
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

    /// Appends a record whole or not at all.
    pub(super) fn append(&mut self, record: &[u8]) -> io::Result<()> {
        self.file.seek(SeekFrom::Start(self.end))?;
        self.file.write_all(record).inspect_err(|_| {
            let _ = self.file.set_len(self.end);
        })?;
        self.end += record.len() as u64;
        Ok(())
    }

    /// The file, when it is time to force it to the disk again.
    pub(super) fn due(&mut self) -> io::Result<Option<File>> {
        if self.synced.0.elapsed() < SYNC_EVERY {
            return Ok(None);
        }
        self.synced = (Instant::now(), self.end);
        self.file.try_clone().map(Some)
    }
}

/// Whether there are zeros alone from a byte to the end of the file.
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
