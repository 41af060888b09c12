//! What rays met, kept in a file as it comes, so that a run that was stopped or killed goes on where it was.
//!
//! What a ray meets depends on the scene, the patch, the seed and the ray's number among those of its patch: on nothing that
//! happened before. A checkpoint is therefore a store of rays. Whoever would cast a ray that is in it takes it from there;
//! everything else (who casts how many, form factors, solutions) is computed again, and comes out the same to the bit. So the
//! same file also serves a run with more rays, and holds the rays of as many subdivisions of a scene as are wanted.
//!
//! The file, little endian: a header that names the program's version, the scene and the seed, then one record for every block
//! of patches cast, appended by one write:
//!
//!   length of the body (8 bytes), its CRC-32 (4), body, CRC-32 of the body (4).
//!
//! A process killed while writing leaves a record that is cut short, the last; it is cut off. Anything else that does not
//! match its checksum is damage, and the file is refused. Nothing is forced to the disk: what was written survives the
//! program's end, however that comes. Loss of power may cost what the system had not written yet.

use std::{
    collections::HashMap,
    fs::{self, File, OpenOptions, TryLockError},
    io::{self, BufReader, Read, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard},
    time::Duration,
};

use rayon::prelude::*;

use super::{
    hemisphere::{BACK, LINKED, Share},
    shadow::{Found, Link, Sources},
};
use crate::{Error, Result, patch::Patches, scene::Scene, trace::sampling::mix};

/// Says what the file is; the line end is lost where it was transferred as text.
const MAGIC: &[u8; 16] = b"radiosity rays\r\n";
/// Counts changes of the file's format, of which rays a seed stands for, and of what is kept of them.
const FORMAT: u32 = 2;
const HEADER: usize = 48;
/// Looks, a twentieth of a second apart, for a lock to be free.
const PATIENCE: usize = 60;
/// Bytes of a record before its body and after it.
const BEFORE: usize = 12;
const AFTER: usize = 4;
/// Numbers of 4 bytes that a record has for each patch beside its targets and links.
const NUMBERS: usize = 7;
/// Bytes of a link.
const LINK: usize = 13;

/// A file of rays cast: see the module's documentation.
#[derive(Debug)]
pub struct Checkpoint {
    path: PathBuf,
    seed: u64,
    /// Rays in it when it was opened.
    found: u64,
    /// Bytes of a last record that was cut short.
    torn: u64,
    store: Mutex<Store>,
}

#[derive(Debug)]
struct Store {
    file: File,
    /// Where the next record goes.
    end: u64,
    rays: u64,
    /// Whether the file was made here.
    made: bool,
    known: HashMap<Key, Kept>,
}

/// The subdivision; the patch's number, which chooses its rays; and what surface it is on, since numbers of backs depend on
/// the order in which they were found.
type Key = (u64, u32, u32);

/// The rays of one patch.
#[derive(Debug, Default)]
struct Kept {
    /// How many of each kind there are.
    rays: Share,
    pieces: Vec<Piece>,
}

/// Rays of one patch in a record. Those of a kind begin where the ones before end; there may be none of a kind.
#[derive(Debug, Clone, Copy)]
struct Piece {
    /// Where in the file the targets are; the links follow.
    at: u64,
    from: Share,
    to: Share,
    links: u32,
}

impl Checkpoint {
    /// Opens a checkpoint of rays with this seed in this scene, or begins one where there is no file or an empty one. One in
    /// which nothing is kept goes again when it is dropped.
    ///
    /// # Errors
    /// [`Error::Input`] when the file is damaged, or of something else: it is not touched then. [`Error::Usage`] when another
    /// process uses it, [`Error::Io`] when it cannot be read or written.
    pub fn open(path: &Path, scene: &Scene, seed: u64) -> Result<Checkpoint> {
        let failed = |e| Error::io(path, e);
        if fs::metadata(path).is_ok_and(|there| !there.is_file()) {
            return Err(Error::input(path, None, "a checkpoint is kept in a regular file"));
        }
        let made = !path.exists();
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)
            .map_err(failed)?;
        if !lock(&file) {
            return Err(Error::Usage {
                message: format!("{}: another run is using this checkpoint", path.display()),
                hint: Some("wait for its end, or give --checkpoint another name".into()),
            });
        }
        let size = file.metadata().map_err(failed)?.len();
        let wanted = header(scene, seed);
        let mut start = Vec::with_capacity(HEADER);
        (&file).take(HEADER as u64).read_to_end(&mut start).map_err(failed)?;
        let mut store = Store { end: HEADER as u64, rays: 0, made, known: HashMap::new(), file };
        if start.len() < HEADER && wanted.starts_with(&start) {
            file = store.file.try_clone().map_err(failed)?;
            let begun = file.set_len(0).and_then(|()| file.rewind()).and_then(|()| file.write_all(&wanted));
            if let Err(e) = begun {
                store.discard(path);
                return Err(failed(e));
            }
        } else {
            check_header(path, &start, &wanted)?;
            store.load(path, size)?;
        }
        let (found, torn) = (store.rays, size.saturating_sub(store.end));
        if torn > 0 {
            store.file.set_len(store.end).map_err(failed)?;
        }
        Ok(Checkpoint { path: path.to_owned(), seed, found, torn, store: Mutex::new(store) })
    }

    /// Rays in it when it was opened, of all subdivisions.
    pub fn found(&self) -> u64 {
        self.found
    }

    /// Bytes at the end of the file that were cut off when it was opened: a record that the end of the last run left
    /// incomplete.
    pub fn torn(&self) -> u64 {
        self.torn
    }

    /// Rays in it now, of all subdivisions.
    pub fn rays(&self) -> u64 {
        self.store().rays
    }

    fn store(&self) -> MutexGuard<'_, Store> {
        self.store.lock().expect("no thread panics holding it")
    }
}

impl Drop for Checkpoint {
    fn drop(&mut self) {
        let path = &self.path;
        if let Ok(store) = self.store.get_mut() {
            store.discard(path);
        }
    }
}

impl Store {
    /// Removes a file that was made here and holds nothing.
    fn discard(&self, path: &Path) {
        if self.made && self.rays == 0 {
            let _ = fs::remove_file(path);
        }
    }

    /// Finds all records.
    fn load(&mut self, path: &Path, size: u64) -> Result<()> {
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
            let (length, check) = before.split_at(8);
            if crc32fast::hash(length).to_le_bytes() != check {
                return Err(damaged(self.end));
            }
            let length = u64::from_le_bytes(std::array::from_fn(|k| length[k]));
            if left < length.saturating_add((BEFORE + AFTER) as u64) {
                return Ok(());
            }
            let mut body = vec![0; length as usize + AFTER];
            reader.read_exact(&mut body).map_err(failed)?;
            let (body, check) = body.split_at(length as usize);
            if crc32fast::hash(body).to_le_bytes() != check {
                return Err(damaged(self.end));
            }
            let pieces = pieces(body, self.end + BEFORE as u64).ok_or_else(|| damaged(self.end))?;
            if pieces.into_iter().any(|(key, piece)| !self.add(key, piece)) {
                return Err(damaged(self.end));
            }
            self.end += length + (BEFORE + AFTER) as u64;
        }
    }

    /// Takes note of a piece, unless it does not follow what is known.
    fn add(&mut self, key: Key, piece: Piece) -> bool {
        let Piece { from, to, .. } = piece;
        let kept = self.known.entry(key).or_default();
        let follows = |from: u32, to: u32, end: u32| from == to || (from == end && from < to);
        let fits = follows(from.hemisphere, to.hemisphere, kept.rays.hemisphere)
            && follows(from.shadow, to.shadow, kept.rays.shadow);
        if fits {
            kept.rays.hemisphere = kept.rays.hemisphere.max(to.hemisphere);
            kept.rays.shadow = kept.rays.shadow.max(to.shadow);
            kept.pieces.push(piece);
            self.rays += u64::from(to.hemisphere - from.hemisphere) + u64::from(to.shadow - from.shadow);
        }
        fits
    }

    fn read(&mut self, piece: &Piece) -> io::Result<Vec<u8>> {
        let targets = (piece.to.hemisphere - piece.from.hemisphere) as usize;
        let mut bytes = vec![0; 4 * targets + LINK * piece.links as usize];
        self.file.seek(SeekFrom::Start(piece.at))?;
        self.file.read_exact(&mut bytes)?;
        Ok(bytes)
    }

    /// Appends a record whole or not at all.
    fn append(&mut self, record: &[u8]) -> io::Result<()> {
        self.file.seek(SeekFrom::Start(self.end))?;
        self.file.write_all(record).inspect_err(|_| {
            let _ = self.file.set_len(self.end);
        })?;
        self.end += record.len() as u64;
        Ok(())
    }
}

/// Waits a little for whoever holds the file: a process that was killed lets go only when its memory is free. Some file
/// systems know no locks; there nobody is kept from using a file twice.
fn lock(file: &File) -> bool {
    let is_held = || matches!(file.try_lock(), Err(TryLockError::WouldBlock));
    for _ in 0..PATIENCE {
        if !is_held() {
            return true;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    !is_held()
}

fn damage(path: &Path, place: &str) -> Error {
    Error::input(path, None, format!("the checkpoint is damaged at {place}"))
        .with_hint("delete it to begin anew, or give --checkpoint another name")
}

fn header(scene: &Scene, seed: u64) -> [u8; HEADER] {
    let mut bytes = [0; HEADER];
    bytes[..16].copy_from_slice(MAGIC);
    bytes[16..20].copy_from_slice(&FORMAT.to_le_bytes());
    let version = env!("CARGO_PKG_VERSION").bytes().fold(0, |h, b| mix(&[h, b.into()]));
    for (k, word) in [version, digest(scene), seed].into_iter().enumerate() {
        bytes[20 + 8 * k..28 + 8 * k].copy_from_slice(&word.to_le_bytes());
    }
    let check = crc32fast::hash(&bytes[..44]);
    bytes[44..].copy_from_slice(&check.to_le_bytes());
    bytes
}

/// Says what the file is instead of the wanted one.
fn check_header(path: &Path, found: &[u8], wanted: &[u8; HEADER]) -> Result<()> {
    let same = |range: std::ops::Range<usize>| found[range.clone()] == wanted[range];
    let other = |what: String, advice: &str| Err(Error::input(path, None, what).with_hint(advice));
    let name = "give --checkpoint another name, or delete the file";
    if found.len() < HEADER || !same(0..16) {
        return other("this file is not a checkpoint, and was left as it is".into(), name);
    }
    if crc32fast::hash(&found[..44]).to_le_bytes() != found[44..48] {
        return Err(damage(path, "its start"));
    }
    if !same(16..28) {
        return other("the checkpoint is of another version of the program".into(), name);
    }
    if !same(28..36) {
        return other("the checkpoint is of another scene".into(), name);
    }
    if !same(36..44) {
        let seed = u64::from_le_bytes(std::array::from_fn(|k| found[36 + k]));
        return other(format!("the checkpoint is of seed {seed}"), &format!("give --seed {seed}, or {name}"));
    }
    Ok(())
}

/// Whatever decides where light comes from and what it meets.
fn digest(scene: &Scene) -> u64 {
    let mut sum = 0;
    let mut add = |words: &[u64]| sum = mix(&[sum, mix(words)]);
    add(&[scene.triangles.len(), scene.materials.len(), scene.textures.len()].map(|n| n as u64));
    for (t, triangle) in scene.triangles.iter().enumerate() {
        let corners = scene.corners(t).map(|p| mix(&p.to_array().map(f64::to_bits)));
        add(&[triangle.material.into(), mix(&corners)]);
    }
    for uv in scene.texcoords.iter().flatten() {
        add(&uv.to_array().map(f64::to_bits));
    }
    for m in &scene.materials {
        add(&[m.reflectance, m.emission].map(|rgb| mix(&rgb.map(f64::to_bits))));
        for map in [&m.reflectance_map, &m.emission_map] {
            let Some(map) = map else { continue };
            let placed = [map.scale.x, map.scale.y, map.offset.x, map.offset.y].map(f64::to_bits);
            add(&[map.texture as u64, map.clamp.into(), mix(&placed)]);
        }
    }
    for texture in &scene.textures {
        add(&[texture.size().0 as u64, texture.size().1 as u64]);
        for texels in texture.texels().chunks(1 << 10) {
            add(&[u64::from(crc32fast::hash(texels))]);
        }
    }
    sum
}

/// The next `N` numbers of 4 bytes.
fn numbers<const N: usize>(bytes: &[u8]) -> [u32; N] {
    std::array::from_fn(|k| u32::from_le_bytes(std::array::from_fn(|b| bytes[4 * k + b])))
}

/// The pieces of a record's body, which begins at `at` in the file; `None` when it is none.
fn pieces(body: &[u8], at: u64) -> Option<Vec<(Key, Piece)>> {
    let (digest, mut rest) = body.split_first_chunk::<8>()?;
    let mut pieces = Vec::new();
    while !rest.is_empty() {
        let (start, tail) = rest.split_at_checked(4 * NUMBERS)?;
        let [patch, surface, from_hemisphere, to_hemisphere, from_shadow, to_shadow, links] = numbers(start);
        let targets = to_hemisphere.checked_sub(from_hemisphere)? as usize;
        let piece = Piece {
            at: at + (body.len() - tail.len()) as u64,
            from: Share { hemisphere: from_hemisphere, shadow: from_shadow },
            to: Share { hemisphere: to_hemisphere, shadow: to_shadow },
            links,
        };
        pieces.push(((u64::from_le_bytes(*digest), patch, surface), piece));
        rest = tail.get(4 * targets + LINK * links as usize..)?;
    }
    Some(pieces)
}

/// The rays of one subdivision in a checkpoint.
#[derive(Debug, Clone)]
pub(super) struct Section {
    checkpoint: Arc<Checkpoint>,
    digest: u64,
}

impl Section {
    /// Of the fronts of `patches`. Where there are sources, rays that connect them are kept in another way.
    ///
    /// # Panics
    /// When the checkpoint is of another seed.
    pub(super) fn new(
        checkpoint: Arc<Checkpoint>,
        patches: &Patches,
        sources: &Sources,
        seed: u64,
    ) -> Section {
        assert_eq!(checkpoint.seed, seed, "the checkpoint is of another seed");
        let of_patch = |i: usize| {
            let corners = patches.corners(i).map(|b| mix(&b.map(f64::to_bits)));
            mix(&[patches.triangle(i) as u64, mix(&corners)])
        };
        let all: Vec<u64> = (0..patches.fronts()).into_par_iter().with_min_len(1024).map(of_patch).collect();
        let digest = mix(&[sources.is_empty().into(), mix(&all)]);
        Section { checkpoint, digest }
    }

    /// Ready to read and write while these are the patches.
    pub(super) fn names<'a>(&'a self, patches: &'a Patches, sources: &'a Sources) -> Names<'a> {
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
pub(super) struct Names<'a> {
    section: &'a Section,
    patches: &'a Patches,
    sources: &'a Sources,
    /// Of each back that is a patch, the front.
    fronts: Vec<u32>,
}

/// What is known of the rays that a patch shall cast.
pub(super) struct Known {
    /// All before these numbers.
    pub(super) rays: Share,
    pub(super) targets: Vec<u32>,
    pub(super) hemisphere_links: Vec<Link>,
    pub(super) shadow_links: Vec<Link>,
}

impl Known {
    /// None beyond those it has.
    pub(super) fn nothing(had: Share) -> Known {
        Known { rays: had, targets: Vec::new(), hemisphere_links: Vec::new(), shadow_links: Vec::new() }
    }
}

/// Rays just cast, on their way into the file.
#[derive(Default)]
pub(super) struct Record {
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
    pub(super) fn known(&self, patch: usize, had: Share, wanted: Share) -> Result<Known> {
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
        let targets = (piece.to.hemisphere - piece.from.hemisphere) as usize;
        let (targets, links) = bytes.split_at(4 * targets);
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
        for link in links.as_chunks::<LINK>().0 {
            let [to_patch, kernel, index] = numbers(link);
            let (found, list, range) = match link[LINK - 1] {
                0 => (Found::Hemisphere, &mut known.hemisphere_links, had.hemisphere..to.hemisphere),
                1 => (Found::Shadow, &mut known.shadow_links, had.shadow..to.shadow),
                2 => (Found::Blocked, &mut known.shadow_links, had.shadow..to.shadow),
                _ => return None,
            };
            let (kernel, j) = (f32::from_bits(kernel), to_patch as usize);
            // Without a source at either end the pair would have no density.
            let is_link = match found {
                Found::Hemisphere => self.sources.concern(patch, j),
                _ => self.sources.contains(j),
            };
            if to_patch >= LINKED || !is_link || !(kernel >= 0.0) {
                return None;
            }
            if range.contains(&index) {
                list.push(Link { to: self.present(to_patch)?, kernel, index, found });
            }
        }
        Some(())
    }

    /// Adds the rays of a patch from `from` on: all its targets up to `to`, and links among which those are.
    pub(super) fn add(
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
            bytes.extend([0; BEFORE]);
            bytes.extend(self.section.digest.to_le_bytes());
        }
        let is_new = |link: &&Link| {
            link.index >= if link.found == Found::Hemisphere { from.hemisphere } else { from.shadow }
        };
        let key = self.key(patch);
        let count = links.iter().filter(is_new).count() as u32;
        let start = [key.1, key.2, from.hemisphere, to.hemisphere, from.shadow, to.shadow, count];
        bytes.extend(start.iter().flat_map(|n| n.to_le_bytes()));
        pieces.push((key, Piece { at: bytes.len() as u64, from, to, links: count }));
        for &target in &targets[from.hemisphere as usize..] {
            bytes.extend(self.lasting(target).to_le_bytes());
        }
        for link in links.iter().filter(is_new) {
            for number in [self.lasting(link.to), link.kernel.to_bits(), link.index] {
                bytes.extend(number.to_le_bytes());
            }
            bytes.push(match link.found {
                Found::Hemisphere => 0,
                Found::Shadow => 1,
                Found::Blocked => 2,
            });
        }
    }

    /// Writes what was added, if anything.
    ///
    /// # Errors
    /// [`Error::Io`]; what is in the file stays good.
    pub(super) fn write(&self, record: Record) -> Result<()> {
        let Record { mut bytes, pieces } = record;
        if pieces.is_empty() {
            return Ok(());
        }
        let length = ((bytes.len() - BEFORE) as u64).to_le_bytes();
        bytes[..8].copy_from_slice(&length);
        bytes[8..BEFORE].copy_from_slice(&crc32fast::hash(&length).to_le_bytes());
        let check = crc32fast::hash(&bytes[BEFORE..]);
        bytes.extend(check.to_le_bytes());
        let checkpoint = &*self.section.checkpoint;
        let mut store = checkpoint.store();
        let start = store.end;
        store.append(&bytes).map_err(|e| Error::io(&checkpoint.path, e))?;
        for (key, piece) in pieces {
            let follows = store.add(key, Piece { at: start + piece.at, ..piece });
            assert!(follows, "rays are cast in order");
        }
        Ok(())
    }
}
