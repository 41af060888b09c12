//! The files of a checkpoint, and an index of the rays in them.

use std::{
    cmp::Reverse,
    collections::HashMap,
    fs::{self, File},
    io::{self, BufRead, BufReader, Read, Seek, SeekFrom, Write},
    path::PathBuf,
    time::{Duration, Instant},
};

use super::format::{AFTER, BEFORE, HEADER, Key, Piece, body_length, damage, pieces};
use crate::{Error, Result};

/// Interval at which written records are forced to the disk.
const SYNC_EVERY: Duration = Duration::from_secs(5);

#[derive(Debug)]
pub(super) struct Store {
    /// The file that gets new rays, and then the files that are only read.
    pub(super) files: Vec<(PathBuf, File)>,
    /// Position of the next record in the first file.
    pub(super) end: u64,
    pub(super) rays: u64,
    /// Whether this run created the first file.
    made: bool,
    /// Time when the first file was last forced to the disk, and its end then.
    synced: (Instant, u64),
    pub(super) known: HashMap<Key, Kept>,
}

/// The rays of one patch.
#[derive(Debug, Default)]
pub(super) struct Kept {
    /// Number of rays, from the first on without gaps.
    pub(super) rays: u32,
    /// In ascending order.
    pub(super) pieces: Vec<Piece>,
}

impl Store {
    /// The store of a file without records.
    pub(super) fn new(path: PathBuf, file: File, made: bool) -> Store {
        let end = HEADER as u64;
        let files = vec![(path, file)];
        Store { files, end, rays: 0, made, synced: (Instant::now(), end), known: HashMap::new() }
    }

    /// Removes the first file if this run created it and it holds no rays.
    pub(super) fn discard(&self) {
        if self.made && self.end == HEADER as u64 {
            let _ = fs::remove_file(&self.files[0].0);
        }
    }

    /// Forces the rest of the first file to the disk. A failure cannot be reported any more.
    pub(super) fn finish(&self) {
        if self.end > self.synced.1 {
            let _ = self.files[0].1.sync_data();
        }
    }

    /// Adds the records of a file of `size` bytes to the index, and returns where the last complete record ends. Call
    /// [`Store::settle`] after the last file.
    pub(super) fn load(&mut self, which: usize, size: u64) -> Result<u64> {
        let path = self.files[which].0.clone();
        let failed = |e| Error::io(&path, e);
        let file = self.files[which].1.try_clone().map_err(failed)?;
        let damaged = |at: u64| damage(&path, &format!("byte {at}"));
        let mut reader = BufReader::with_capacity(1 << 20, file);
        let mut end = HEADER as u64;
        reader.seek(SeekFrom::Start(end)).map_err(failed)?;
        loop {
            let left = size - end;
            let mut before = [0; BEFORE];
            if left < BEFORE as u64 {
                return Ok(end);
            }
            reader.read_exact(&mut before).map_err(failed)?;
            let Some(length) = body_length(&before) else {
                let unwritten = is_unwritten(&mut reader, end + BEFORE as u64 - 1).map_err(failed)?;
                return if unwritten { Ok(end) } else { Err(damaged(end)) };
            };
            if left < length.saturating_add((BEFORE + AFTER) as u64) {
                return Ok(end);
            }
            let mut body = vec![0; length as usize + AFTER];
            reader.read_exact(&mut body).map_err(failed)?;
            let (body, check) = body.split_at(length as usize);
            let next = end + length + (BEFORE + AFTER) as u64;
            if crc32fast::hash(body).to_le_bytes() != check {
                let unwritten = is_unwritten(&mut reader, next - 1).map_err(failed)?;
                return if unwritten { Ok(end) } else { Err(damaged(end)) };
            }
            for (key, piece) in pieces(body, end + BEFORE as u64).ok_or_else(|| damaged(end))? {
                let piece = Piece { file: which as u32, ..piece };
                self.known.entry(key).or_default().pieces.push(piece);
            }
            end = next;
            if which == 0 {
                (self.end, self.synced.1) = (end, end);
            }
        }
    }

    /// Orders the pieces of each patch. Drops rays that are there already, and rays whose predecessors are missing: they
    /// are in a file that is not among these.
    pub(super) fn settle(&mut self) {
        for kept in self.known.values_mut() {
            kept.pieces.sort_by_key(|piece| (piece.from, Reverse(piece.to)));
            let mut rays = 0;
            kept.pieces.retain(|piece| {
                let continues = piece.from <= rays && rays < piece.to;
                if continues {
                    rays = piece.to;
                }
                continues
            });
            kept.rays = rays;
            self.rays += u64::from(rays);
        }
    }

    /// Adds a piece of the first file, which must continue the rays of its patch.
    pub(super) fn add(&mut self, key: Key, piece: Piece) {
        let kept = self.known.entry(key).or_default();
        assert_eq!(piece.from, kept.rays, "rays are cast in order");
        kept.rays = piece.to;
        kept.pieces.push(piece);
        self.rays += u64::from(piece.to - piece.from);
    }

    pub(super) fn read(&mut self, piece: &Piece) -> Result<Vec<u8>> {
        let (path, file) = &mut self.files[piece.file as usize];
        let mut bytes = vec![0; piece.bytes()];
        let read = file.seek(SeekFrom::Start(piece.at)).and_then(|_| file.read_exact(&mut bytes));
        read.map(|()| bytes).map_err(|e| Error::io(path, e))
    }

    /// Appends a record to the first file as a whole, or leaves the file unchanged.
    pub(super) fn append(&mut self, record: &[u8]) -> io::Result<()> {
        let file = &mut self.files[0].1;
        file.seek(SeekFrom::Start(self.end))?;
        file.write_all(record).inspect_err(|_| {
            let _ = file.set_len(self.end);
        })?;
        self.end += record.len() as u64;
        Ok(())
    }

    /// The first file, if it is time to force it to the disk again.
    pub(super) fn due(&mut self) -> io::Result<Option<File>> {
        if self.synced.0.elapsed() < SYNC_EVERY {
            return Ok(None);
        }
        self.synced = (Instant::now(), self.end);
        self.files[0].1.try_clone().map(Some)
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
