//! A file that stores the targets of rays as they are cast, so that a stopped or killed run can continue.
//!
//! The target of a ray depends only on the scene, the patch, the seed and the number of the ray within its patch, not
//! on earlier results. A checkpoint is therefore a store of rays: a ray in the file is read instead of cast. Everything
//! else (numbers of rays, form factors, solutions) is computed again and is the same to the bit. So the same file also
//! serves a run with more rays, and can hold the rays of several subdivisions of a scene.
//!
//! The file is little endian. A header identifies the program's version, the scene and the seed. Each block of patches
//! then appends one record by a single write:
//!
//!   length of the body (8 bytes), its CRC-32 (4), body, CRC-32 of the body (4).
//!
//! A process killed while writing leaves an incomplete last record, which is cut off. Written records survive the end
//! of the program. Every few seconds they are forced to the disk, so that a loss of power costs only later records. It
//! may also leave zeros at the end of the file, which are cut off too. Anything else that does not match its checksum
//! is damage, and the file is refused.
//!
//! Several files can serve one run: it reads all of them and writes to the first. So processes without a connection can
//! share out the rays of a scene. Each casts those of its own [`Part`] of the patches, and one of them reads all files.

mod format;
mod part;
mod section;
mod store;

use std::{
    collections::BTreeSet,
    fs::{self, File, OpenOptions, TryLockError},
    io::{Read, Seek, Write},
    path::{Path, PathBuf},
    sync::{
        Mutex, MutexGuard,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
    time::Duration,
};

use crate::{Error, Result, Setting, scene::Scene};
use format::{HEADER, check_header, header};
use store::Store;

pub use part::Part;
pub(crate) use part::RUN;
pub(crate) use section::{Record, Section};

/// Number of attempts, a twentieth of a second apart, to lock the file.
const PATIENCE: usize = 60;

/// Files of rays (see the module's documentation).
#[derive(Debug)]
pub struct Checkpoint {
    seed: u64,
    /// The part of the patches whose rays are cast.
    part: Part,
    /// Number of rays in the files when they were opened.
    found: u64,
    /// Files with an incomplete last record, and its bytes.
    torn: Vec<(PathBuf, u64)>,
    /// Number of rays of other parts that no file holds.
    lacking: AtomicU64,
    store: Mutex<Store>,
}

impl Checkpoint {
    /// Opens a checkpoint of rays with this seed in this scene. Creates it if there is no file or an empty one. A
    /// checkpoint that is created and stays empty is removed when it is dropped.
    ///
    /// # Errors
    /// [`Error::Input`] when the file is damaged or is something else; the file is not changed. [`Error::Setting`] when
    /// another process uses it. [`Error::Io`] when it cannot be read or written.
    pub fn open(path: &Path, scene: &Scene, seed: u64) -> Result<Checkpoint> {
        Self::open_all(&[path.to_owned()], scene, seed)
    }

    /// Like [`Checkpoint::open`], with several files, of which the first gets new rays. If one of them is the file of a
    /// part of the patches, the files of all parts must be there.
    ///
    /// # Errors
    /// See [`Checkpoint::open`]; also [`Error::Input`] when a part is missing.
    ///
    /// # Panics
    /// When there is no path.
    pub fn open_all(paths: &[PathBuf], scene: &Scene, seed: u64) -> Result<Checkpoint> {
        let (checkpoint, parts) = Self::open_files(paths, Part::WHOLE, scene, seed)?;
        let counts: BTreeSet<u32> = parts.iter().map(|part| part.count()).collect();
        let mut all =
            counts.into_iter().flat_map(|count| (1..=count).filter_map(move |k| Part::new(k, count)));
        if let Some(missing) = all.find(|part| !parts.contains(part)) {
            let of_same = parts.iter().position(|part| part.count() == missing.count());
            let k = of_same.expect("the count is that of a file");
            let what = format!("this file holds {}, and no file holds part {}", parts[k], missing.number());
            let hint =
                format!("name the files of all {} parts, or cast the missing part first", missing.count());
            return Err(Error::input(&paths[k], None, what).with_hint(hint));
        }
        Ok(checkpoint)
    }

    /// Like [`Checkpoint::open_all`], for a process that casts only the rays of one part of the patches. The first file
    /// belongs to that part. The other files may be those of other processes, which may be writing to them.
    ///
    /// # Errors
    /// See [`Checkpoint::open`]; also [`Error::Input`] when the first file belongs to another part.
    ///
    /// # Panics
    /// When there is no path.
    pub fn open_part(paths: &[PathBuf], part: Part, scene: &Scene, seed: u64) -> Result<Checkpoint> {
        let (checkpoint, parts) = Self::open_files(paths, part, scene, seed)?;
        if parts[0] != part {
            let what = format!("this file holds {}, and {part} is to be cast", parts[0]);
            return Err(Error::input(&paths[0], None, what).with_hint("give each part a file of its own"));
        }
        Ok(checkpoint)
    }

    /// Opens the files, and returns the part that each belongs to. A new file becomes that of `part`.
    fn open_files(
        paths: &[PathBuf],
        part: Part,
        scene: &Scene,
        seed: u64,
    ) -> Result<(Checkpoint, Vec<Part>)> {
        let wanted = header(scene, seed, part);
        let (store, size, first) = open_first(&paths[0], &wanted)?;
        let mut checkpoint = Checkpoint {
            seed,
            part,
            found: 0,
            torn: Vec::new(),
            lacking: AtomicU64::new(0),
            store: Mutex::new(store),
        };
        let mut parts = vec![first];
        let store = checkpoint.store.get_mut().expect("no thread holds it yet");
        let mut torn = Vec::new();
        let mut note = |path: &Path, bytes: u64| (bytes > 0).then(|| torn.push((path.to_owned(), bytes)));
        let end = store.load(0, size)?;
        if size > end {
            store.files[0].1.set_len(end).map_err(|e| Error::io(&paths[0], e))?;
        }
        note(&paths[0], size.saturating_sub(end));
        for path in &paths[1..] {
            let failed = |e| Error::io(path, e);
            check_kind(path)?;
            let file = File::open(path).map_err(failed)?;
            let size = file.metadata().map_err(failed)?.len();
            let mut start = Vec::with_capacity(HEADER);
            (&file).take(HEADER as u64).read_to_end(&mut start).map_err(failed)?;
            // Another process is making the file, or was killed while it did.
            if start.len() < HEADER && wanted.starts_with(&start) {
                parts.push(part);
                continue;
            }
            parts.push(check_header(path, &start, &wanted)?);
            store.files.push((path.clone(), file));
            let end = store.load(store.files.len() - 1, size)?;
            note(path, size.saturating_sub(end));
        }
        store.settle();
        checkpoint.found = store.rays;
        checkpoint.torn = torn;
        Ok((checkpoint, parts))
    }

    /// Number of rays in the files when they were opened, of all subdivisions.
    pub fn found(&self) -> u64 {
        self.found
    }

    /// Files whose last records were incomplete when they were opened, because a run was interrupted or lost its power,
    /// and the bytes of these records. The first file has been cut to its complete records.
    pub fn torn(&self) -> &[(PathBuf, u64)] {
        &self.torn
    }

    /// Number of rays in the files now, of all subdivisions.
    pub fn rays(&self) -> u64 {
        self.store().rays
    }

    /// The part of the patches whose rays are cast.
    pub fn part(&self) -> Part {
        self.part
    }

    /// Number of rays of other parts that no file holds and on which further rays depend.
    pub fn lacking(&self) -> u64 {
        self.lacking.load(Relaxed)
    }

    fn store(&self) -> MutexGuard<'_, Store> {
        self.store.lock().expect("no thread panics holding it")
    }
}

/// Opens the file for new rays, or makes it with this header. Returns the store without an index, the size of the file
/// and its part.
fn open_first(path: &Path, wanted: &[u8; HEADER]) -> Result<(Store, u64, Part)> {
    let failed = |e| Error::io(path, e);
    check_kind(path)?;
    let made = !path.exists();
    let mut file =
        OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path).map_err(failed)?;
    if !lock(&file) {
        return Err(Error::setting(
            &[Setting::Checkpoint],
            format!("{}: another run is using this checkpoint", path.display()),
            "wait for its end, or use another file",
        ));
    }
    let size = file.metadata().map_err(failed)?.len();
    let mut start = Vec::with_capacity(HEADER);
    (&file).take(HEADER as u64).read_to_end(&mut start).map_err(failed)?;
    if start.len() == HEADER || !wanted.starts_with(&start) {
        let part = check_header(path, &start, wanted)?;
        return Ok((Store::new(path.to_owned(), file, made), size, part));
    }
    let begun = file.set_len(0).and_then(|()| file.rewind()).and_then(|()| file.write_all(wanted));
    let begun = begun.and_then(|()| file.sync_all());
    let store = Store::new(path.to_owned(), file, made);
    if let Err(e) = begun {
        store.discard();
        return Err(failed(e));
    }
    let part = check_header(path, wanted, wanted)?;
    Ok((store, HEADER as u64, part))
}

fn check_kind(path: &Path) -> Result<()> {
    if fs::metadata(path).is_ok_and(|there| !there.is_file()) {
        return Err(Error::input(path, None, "a checkpoint is kept in a regular file"));
    }
    Ok(())
}

impl Drop for Checkpoint {
    fn drop(&mut self) {
        if let Ok(store) = self.store.get_mut() {
            store.discard();
            store.finish();
        }
    }
}

/// Waits a little for another process to release the file: a killed process releases it only when its memory is free.
/// On file systems without locks, two processes may use the same file.
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
