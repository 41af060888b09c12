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
//! A process killed while writing leaves a record that is cut short, the last; it is cut off. What was written survives the
//! program's end, however that comes, and every few seconds it is forced to the disk: loss of power costs what came after that.
//! It may leave a file that has grown already, with zeros where nothing was written; these are cut off too. Anything else that
//! does not match its checksum is damage, and the file is refused.

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

/// Looks, a twentieth of a second apart, for a lock to be free.
const PATIENCE: usize = 60;

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

impl Checkpoint {
    /// Opens a checkpoint of rays with this seed in this scene, or begins one where there is no file or an empty one. One in
    /// which nothing is kept goes again when it is dropped.
    ///
    /// # Errors
    /// [`Error::Input`] when the file is damaged, or of something else: it is not touched then. [`Error::Setting`] when another
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

    /// Rays in it when it was opened, of all subdivisions.
    pub fn found(&self) -> u64 {
        self.found
    }

    /// Bytes at the end of the file that were cut off when it was opened: records that the end of the last run, or a loss of
    /// power, left incomplete.
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
            store.finish();
        }
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
