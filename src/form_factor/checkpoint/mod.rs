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

mod format;
mod section;
mod store;

use std::{
    fs::{self, File, OpenOptions, TryLockError},
    io::{Read, Seek, Write},
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard},
    time::Duration,
};

use crate::{Error, Result, Setting, scene::Scene};
use format::{HEADER, check_header, header};
use store::Store;

pub(super) use section::{Record, Section};

/// Number of attempts, a twentieth of a second apart, to lock the file.
const PATIENCE: usize = 60;

/// A file of rays (see the module's documentation).
#[derive(Debug)]
pub struct Checkpoint {
    path: PathBuf,
    seed: u64,
    /// Number of rays in the file when it was opened.
    found: u64,
    /// Bytes of an incomplete last record.
    torn: u64,
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
            return Err(Error::setting(
                &[Setting::Checkpoint],
                format!("{}: another run is using this checkpoint", path.display()),
                "wait for its end, or use another file",
            ));
        }
        let size = file.metadata().map_err(failed)?.len();
        let wanted = header(scene, seed);
        let mut start = Vec::with_capacity(HEADER);
        (&file).take(HEADER as u64).read_to_end(&mut start).map_err(failed)?;
        let mut store = Store::new(file, made);
        if start.len() < HEADER && wanted.starts_with(&start) {
            file = store.file.try_clone().map_err(failed)?;
            let begun = file.set_len(0).and_then(|()| file.rewind()).and_then(|()| file.write_all(&wanted));
            let begun = begun.and_then(|()| file.sync_all());
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

    /// Number of rays in the file when it was opened, of all subdivisions.
    pub fn found(&self) -> u64 {
        self.found
    }

    /// Bytes cut off the end of the file when it was opened: records left incomplete by the end of the last run or a
    /// loss of power.
    pub fn torn(&self) -> u64 {
        self.torn
    }

    /// Number of rays in the file now, of all subdivisions.
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
