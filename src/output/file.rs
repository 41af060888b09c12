//! Files that are written completely or not at all.
//!
//! The contents go to a temporary file in the same directory. It is synchronised to the disk and then renamed. Renaming
//! within a file system is atomic, so a reader finds either the old file or the new one, even after a loss of power. If
//! a process was killed, the next process that writes to the same name removes its temporary file.

use std::{
    ffi::{OsStr, OsString},
    fs,
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
};

use tempfile::NamedTempFile;

use crate::{Error, Result};

/// Number of random characters in the name of a temporary file.
const RANDOM: usize = 6;

/// A file that can be written. Create it with [`OutputFile::new`] before a long computation, so that a bad path is
/// reported early.
#[derive(Debug)]
pub struct OutputFile {
    /// The path as given by the user, for messages.
    path: PathBuf,
    /// The regular file to replace, with links followed; `None` for devices and pipes.
    target: Option<PathBuf>,
}

/// A file that is written but does not have its final name yet. Dropping it removes the file.
#[derive(Debug)]
#[must_use = "the file is removed unless it is committed"]
pub struct Pending {
    output: OutputFile,
    contents: Contents,
}

#[derive(Debug)]
enum Contents {
    File(NamedTempFile),
    /// Contents for a device or a pipe. They are sent at once when they are complete.
    Memory(Vec<u8>),
}

impl OutputFile {
    /// Checks that `path` can be written and is not one of `inputs`. An existing file stays as it is.
    ///
    /// # Errors
    /// [`Error::Usage`] if the file is an input or its directory is missing; [`Error::Io`] if it cannot be written.
    pub fn new(path: &Path, inputs: &[&Path]) -> Result<OutputFile> {
        let failed = |e| Error::io(path, e);
        let target = match fs::metadata(path) {
            Ok(there) if there.is_dir() => return Err(failed(io::ErrorKind::IsADirectory.into())),
            Ok(there) if !there.is_file() => None,
            Ok(there) if there.permissions().readonly() => {
                return Err(failed(io::ErrorKind::PermissionDenied.into()));
            }
            Ok(_) => Some(fs::canonicalize(path).map_err(failed)?),
            Err(e) if e.kind() == io::ErrorKind::NotFound => Some(end_of_links(path)),
            Err(e) => return Err(failed(e)),
        };
        let output = OutputFile { path: path.to_owned(), target };
        output.check_inputs(inputs)?;
        if let Some(target) = &output.target {
            remove_abandoned(target);
            output.temporary()?;
        }
        Ok(output)
    }

    /// Checks that the file is not one of `inputs`. This is for inputs that are known only after others have been read.
    ///
    /// # Errors
    /// [`Error::Usage`] if the file is an input.
    pub fn check_inputs(&self, inputs: &[impl AsRef<Path>]) -> Result<()> {
        // A file that does not exist yet cannot be an input.
        let is_input = |input: &Path| fs::canonicalize(input).is_ok_and(|input| Some(input) == self.target);
        match inputs.iter().map(AsRef::as_ref).find(|input| is_input(input)) {
            None => Ok(()),
            Some(input) => Err(Error::Usage {
                message: format!(
                    "{}: the output would replace the input {}",
                    self.path.display(),
                    input.display()
                ),
                hint: Some("give the output another name".into()),
            }),
        }
    }

    /// The path as it was given.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether both are the same file.
    pub fn is_same(&self, other: &OutputFile) -> bool {
        let place = |output: &OutputFile| {
            let target = output.target.as_ref()?;
            Some((fs::canonicalize(directory(target)).ok()?, target.file_name()?.to_owned()))
        };
        place(self).is_some_and(|p| Some(p) == place(other))
    }

    /// Writes the contents to the temporary file.
    ///
    /// # Errors
    /// [`Error::Io`]. The temporary file is then removed.
    pub fn write(self, contents: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<Pending> {
        let failed = |e| Error::io(&self.path, e);
        if self.target.is_none() {
            let mut bytes = Vec::new();
            contents(&mut bytes).map_err(failed)?;
            return Ok(Pending { output: self, contents: Contents::Memory(bytes) });
        }
        let file = self.temporary()?;
        let mut out = BufWriter::with_capacity(1 << 20, file);
        contents(&mut out).map_err(failed)?;
        let file = out.into_inner().map_err(|e| failed(e.into_error()))?;
        file.as_file().sync_all().map_err(failed)?;
        Ok(Pending { output: self, contents: Contents::File(file) })
    }

    /// Creates a temporary file beside the target, with the permissions that the target has or would get.
    fn temporary(&self) -> Result<NamedTempFile> {
        let target = self.target.as_deref().expect("only regular files are replaced");
        let failed = |e| Error::io(&self.path, e);
        // Paths like `a/` and `a/.` name directories.
        let is_last =
            |name: &&OsStr| target.as_os_str().as_encoded_bytes().ends_with(name.as_encoded_bytes());
        let Some(name) = target.file_name().filter(is_last) else {
            return Err(Error::Usage {
                message: format!("{}: this is the path of a directory", self.path.display()),
                hint: Some("give the name of a file".into()),
            });
        };
        let mut prefix = OsString::from(".");
        prefix.push(name);
        let mut builder = tempfile::Builder::new();
        builder.prefix(&prefix).rand_bytes(RANDOM).suffix(".part");
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        // The error of tempfile names the temporary file and hides the error of the operating system.
        let bare = |e: io::Error| io::Error::from(e.kind());
        if let Err(e) = fs::metadata(directory(target)) {
            let what = failed(e);
            return Err(match &what {
                Error::Io { source, .. } if source.kind() == io::ErrorKind::NotFound => Error::Usage {
                    message: what.to_string(),
                    hint: Some(format!("make the directory {} first", directory(target).display())),
                },
                _ => what,
            });
        }
        let file = loop {
            let file = builder.tempfile_in(directory(target)).map_err(|e| failed(bare(e)))?;
            // The file stays locked until it is renamed, so that no other process considers it abandoned. If another
            // process removed it before the lock was held, the loop makes another one.
            let _ = file.as_file().lock();
            if file.path().exists() {
                break file;
            }
        };
        if let Ok(there) = fs::metadata(target) {
            file.as_file().set_permissions(there.permissions()).map_err(failed)?;
        }
        Ok(file)
    }
}

impl Pending {
    /// Gives all files their final names. Devices and pipes come first: if one of them fails, no file has been replaced
    /// yet.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn commit_all(mut all: Vec<Pending>) -> Result<()> {
        all.sort_by_key(|pending| matches!(pending.contents, Contents::File(_)));
        let mut directories: Vec<PathBuf> = Vec::new();
        for pending in all {
            let renamed = pending.output.target.as_deref().map(|target| directory(target).to_owned());
            pending.rename()?;
            directories.extend(renamed.filter(|renamed| !directories.contains(renamed)));
        }
        directories.iter().for_each(|directory| sync_directory(directory));
        Ok(())
    }

    /// Gives the file its final name. This replaces an older file of this name.
    ///
    /// # Errors
    /// [`Error::Io`]. The older file then stays.
    pub fn commit(self) -> Result<()> {
        Self::commit_all(vec![self])
    }

    fn rename(self) -> Result<()> {
        let Pending { output, contents } = self;
        let failed = |e| Error::io(&output.path, e);
        match contents {
            Contents::File(file) => {
                let target = output.target.as_deref().expect("only regular files are replaced");
                file.persist(target).map(drop).map_err(|e| failed(e.error))
            }
            Contents::Memory(bytes) => fs::OpenOptions::new()
                .write(true)
                .open(&output.path)
                .and_then(|mut out| out.write_all(&bytes))
                .map_err(failed),
        }
    }
}

/// Removes temporary files for `target` that killed processes left behind. Their locks are free. Files that cannot be
/// opened stay.
fn remove_abandoned(target: &Path) {
    let Some(name) = target.file_name() else { return };
    let prefix = [b".", name.as_encoded_bytes()].concat();
    for entry in fs::read_dir(directory(target)).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let random = name.as_encoded_bytes().strip_prefix(&prefix[..]).and_then(|n| n.strip_suffix(b".part"));
        if random.is_some_and(|r| r.len() == RANDOM && r.iter().all(u8::is_ascii_alphanumeric))
            && fs::File::open(entry.path()).is_ok_and(|file| file.try_lock().is_ok())
        {
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// Synchronises the names in a directory to the disk, if the system can do that. If it cannot, a loss of power may
/// bring back the older file, which is complete. So a failure here is not an error.
fn sync_directory(directory: &Path) {
    #[cfg(unix)]
    let _ = fs::File::open(directory).and_then(|directory| directory.sync_all());
    #[cfg(not(unix))]
    let _ = directory;
}

/// The path at which a new file would be created. It follows symbolic links whose target does not exist yet.
fn end_of_links(path: &Path) -> PathBuf {
    let mut target = path.to_owned();
    while let Ok(next) = fs::read_link(&target) {
        target = directory(&target).join(next);
    }
    target
}

/// The directory that holds `path`.
fn directory(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(directory: &Path) -> Vec<OsString> {
        let mut names: Vec<_> = fs::read_dir(directory).unwrap().map(|e| e.unwrap().file_name()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_appears_whole_at_commit_and_not_before() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("out.ply");
        fs::write(&path, "old").unwrap();
        let pending = OutputFile::new(&path, &[]).unwrap().write(|out| out.write_all(b"new")).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"old");
        pending.commit().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(names(dir.path()), ["out.ply"]);
    }

    #[test]
    fn a_failed_or_abandoned_write_leaves_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("out.ply");
        let half = |out: &mut dyn Write| {
            out.write_all(&[0; 100])?;
            Err(io::Error::other("the disk is full"))
        };
        let error = OutputFile::new(&path, &[]).unwrap().write(half).unwrap_err();
        assert_eq!(error.to_string(), format!("{}: the disk is full", path.display()));
        drop(OutputFile::new(&path, &[]).unwrap().write(|out| out.write_all(b"x")).unwrap());
        assert!(names(dir.path()).is_empty());
    }

    #[test]
    fn what_a_killed_process_left_goes_and_what_another_writes_stays() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("out.ply");
        for name in [".out.plyAbC123.part", ".out.ply.part", ".out.plyAbC1234.part", "out.plyAbC123.part"] {
            fs::write(dir.path().join(name), "half").unwrap();
        }
        let pending = OutputFile::new(&path, &[]).unwrap().write(|out| out.write_all(b"first")).unwrap();
        assert_eq!(names(dir.path()).len(), 4);
        assert!(!dir.path().join(".out.plyAbC123.part").exists());
        let second = OutputFile::new(&path, &[]).unwrap().write(|out| out.write_all(b"second")).unwrap();
        assert_eq!(names(dir.path()).len(), 5);
        pending.commit().unwrap();
        second.commit().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"second");
    }

    #[test]
    fn inputs_are_never_replaced_whatever_they_are_called() {
        let dir = tempfile::tempdir().unwrap();
        let input = dir.path().join("in.obj");
        fs::write(&input, "precious").unwrap();
        fs::create_dir(dir.path().join("sub")).unwrap();
        let detour = dir.path().join("sub").join("..").join("in.obj");
        assert!(matches!(OutputFile::new(&detour, &[&input]), Err(Error::Usage { .. })));
        #[cfg(unix)]
        {
            let link = dir.path().join("link.ply");
            std::os::unix::fs::symlink(&input, &link).unwrap();
            assert!(matches!(OutputFile::new(&link, &[&input]), Err(Error::Usage { .. })));
        }
        assert_eq!(fs::read(&input).unwrap(), b"precious");
    }

    #[test]
    fn places_that_cannot_be_written_are_told_at_once() {
        let dir = tempfile::tempdir().unwrap();
        let missing = dir.path().join("missing").join("out.ply");
        for path in [dir.path(), &missing] {
            let error = OutputFile::new(path, &[]).unwrap_err();
            assert!(error.to_string().starts_with(&path.display().to_string()), "{error}");
            assert!(!error.to_string().contains(".part"), "{error}");
        }
        let locked = dir.path().join("locked.ply");
        fs::write(&locked, "old").unwrap();
        let mut permissions = fs::metadata(&locked).unwrap().permissions();
        permissions.set_readonly(true);
        fs::set_permissions(&locked, permissions).unwrap();
        assert!(matches!(OutputFile::new(&locked, &[]), Err(Error::Io { .. })));
    }

    #[test]
    fn two_names_of_one_output_are_told_apart_from_two_outputs() {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(dir.path().join("sub")).unwrap();
        let at = |name: &str| OutputFile::new(&dir.path().join(name), &[]).unwrap();
        assert!(at("a").is_same(&at("sub/../a")));
        assert!(!at("a").is_same(&at("b")));
    }

    #[cfg(unix)]
    #[test]
    fn devices_are_written_to_and_stay_devices() {
        let null = Path::new("/dev/null");
        OutputFile::new(null, &[]).unwrap().write(|out| out.write_all(b"x")).unwrap().commit().unwrap();
        assert!(!fs::metadata(null).unwrap().is_file());
    }

    #[cfg(unix)]
    #[test]
    fn a_link_stays_a_link_and_permissions_stay_as_they_were() {
        use std::os::unix::fs::PermissionsExt;
        let dir = tempfile::tempdir().unwrap();
        let (real, link) = (dir.path().join("real"), dir.path().join("link"));
        fs::write(&real, "old").unwrap();
        fs::set_permissions(&real, fs::Permissions::from_mode(0o640)).unwrap();
        std::os::unix::fs::symlink(&real, &link).unwrap();
        OutputFile::new(&link, &[]).unwrap().write(|out| out.write_all(b"new")).unwrap().commit().unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read(&real).unwrap(), b"new");
        assert_eq!(fs::metadata(&real).unwrap().permissions().mode() & 0o777, 0o640);
    }

    #[cfg(unix)]
    #[test]
    fn links_that_lead_nowhere_yet_are_followed() {
        use std::os::unix::fs::symlink;
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        fs::create_dir(at("sub")).unwrap();
        symlink("second", at("first")).unwrap();
        symlink("sub/real", at("second")).unwrap();
        let [first, real] = ["first", "sub/real"].map(|name| OutputFile::new(&at(name), &[]).unwrap());
        assert!(first.is_same(&real));
        first.write(|out| out.write_all(b"new")).unwrap().commit().unwrap();
        assert_eq!(fs::read(at("sub/real")).unwrap(), b"new");
        assert!(["first", "second"].iter().all(|link| fs::symlink_metadata(at(link)).unwrap().is_symlink()));
        symlink("nowhere/real", at("lost")).unwrap();
        symlink("circle", at("circle")).unwrap();
        for bad in ["lost", "circle"] {
            let error = OutputFile::new(&at(bad), &[]).unwrap_err().to_string();
            assert!(error.starts_with(&at(bad).display().to_string()), "{error}");
        }
    }
}
