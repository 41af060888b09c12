//! The files that a command writes. They are checked before the work, and all are written together after it.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
    sync::Mutex,
};

use radiosity::{
    Error, Result,
    monte_carlo::PictureFormat,
    output::file::{OutputFile, Pending},
};

/// Extensions of files of scenes. A text output may not have such a name, because the file might belong to another
/// scene. The files of this scene are compared with each output after they are read (`pipeline::read`).
const INPUT_KINDS: [&str; 14] =
    ["obj", "stl", "mtl", "gltf", "glb", "bin", "png", "jpg", "jpeg", "tga", "bmp", "exr", "hdr", "dds"];

/// The output file of a mesh.
pub fn mesh(path: &Path, scene: &Path) -> Result<OutputFile> {
    let output = OutputFile::new(path, &[scene])?;
    let is_ply = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("ply"));
    if !is_ply && !is_glb(path) && !is_device(path) {
        return Err(usage(
            path,
            "the name of a mesh must end in .ply or .glb",
            "the program writes PLY and binary glTF files",
        ));
    }
    Ok(output)
}

/// Whether a name belongs to a binary glTF file.
pub fn is_glb(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("glb"))
}

/// A file that belongs to a binary glTF file beside it. An existing file is replaced only if the glTF file exists too
/// and an earlier run of this program wrote it.
pub fn beside_glb(glb: &Path, name: &str, scene: &Path) -> Result<OutputFile> {
    let path = glb.with_file_name(name);
    let is_ours = || {
        let mark = b"\"generator\":\"radiosity ";
        fs::read(glb).is_ok_and(|bytes| bytes.windows(mark.len()).any(|window| window == mark))
    };
    if path.exists() && !is_ours() {
        let message = "there is a file of this name that no earlier bake wrote";
        return Err(usage(&path, message, "give another name with -o"));
    }
    OutputFile::new(&path, &[scene])
}

/// The output file of a picture, and its format.
pub fn picture(path: &Path, scene: &Path) -> Result<(OutputFile, PictureFormat)> {
    let output = OutputFile::new(path, &[scene])?;
    let extension = path.extension().map(|e| e.to_string_lossy());
    match extension.and_then(|e| PictureFormat::of_extension(&e)) {
        Some(format) => Ok((output, format)),
        None if is_device(path) => Ok((output, PictureFormat::Png)),
        None => Err(usage(path, "unknown kind of picture", "use a name that ends in .png, .exr or .hdr")),
    }
}

/// The output file of a report.
pub fn report(path: &Path, scene: &Path) -> Result<OutputFile> {
    text(path, &[scene], "a report")
}

/// The output file of a text; `what` names its contents in messages.
pub fn text(path: &Path, inputs: &[&Path], what: &str) -> Result<OutputFile> {
    no_scene(path, inputs, what, "give it a name that ends in .json or .txt")
}

/// The file of a checkpoint.
pub fn checkpoint(path: &Path, scene: &Path) -> Result<OutputFile> {
    no_scene(path, &[scene], "a checkpoint", "give it a name that ends in .checkpoint")
}

fn no_scene(path: &Path, inputs: &[&Path], what: &str, hint: &str) -> Result<OutputFile> {
    let output = OutputFile::new(path, inputs)?;
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    if extension.is_some_and(|e| INPUT_KINDS.contains(&e.as_str())) {
        let message = format!("{what} may not have the name of a scene, material or texture");
        return Err(usage(path, &message, hint));
    }
    Ok(output)
}

/// The directories made in this run, outermost first. Static, because a second Ctrl-C exits without dropping anything.
static MADE: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// Removes the directories that were made and are still empty.
pub fn remove_made() {
    // The lock is held until all are removed, so that a concurrent exit waits.
    let mut made = MADE.lock().expect("no thread panics holding it");
    made.drain(..).rev().for_each(|path| drop(fs::remove_dir(path)));
}

/// The file in a directory of outputs that lists what this program wrote there and may replace. The files themselves
/// may be edited and saved by other programs.
const MARKER: &str = ".radiosity";
const MARKER_TITLE: &str = "# Files here that radiosity wrote and may replace";

/// A directory for the files of a command. It is removed again if this run made it and wrote nothing into it.
#[derive(Debug)]
pub struct Directory {
    path: PathBuf,
    command: &'static str,
    /// Names of files in the directory that earlier runs wrote.
    ours: Vec<String>,
}

impl Directory {
    /// Makes the directory if it is missing.
    pub fn new(path: &Path, command: &'static str) -> Result<Directory> {
        let missing: Vec<PathBuf> = path
            .ancestors()
            .take_while(|p| !p.as_os_str().is_empty() && !p.exists())
            .map(Path::to_owned)
            .collect();
        let mut directory = Directory { path: path.to_owned(), command, ours: Vec::new() };
        for path in missing.into_iter().rev() {
            let mut made = MADE.lock().expect("no thread panics holding it");
            fs::create_dir(&path).map_err(|e| Error::io(&path, e))?;
            made.push(path);
        }
        if !path.is_dir() {
            return Err(Error::io(path, std::io::ErrorKind::NotADirectory.into()));
        }
        let marker = fs::read_to_string(path.join(MARKER)).unwrap_or_default();
        let mut lines = marker.lines();
        if lines.next() == Some(MARKER_TITLE) {
            directory.ours = lines.map(str::to_owned).collect();
        }
        Ok(directory)
    }

    /// A file in the directory. An existing file that no earlier run wrote is never replaced: it might belong to a
    /// scene.
    pub fn file(&self, name: &str, inputs: &[&Path]) -> Result<OutputFile> {
        let path = self.path.join(name);
        if path.exists() && !self.ours.iter().any(|ours| ours == name) {
            let message = format!("there is a file of this name that no earlier {} wrote", self.command);
            return Err(usage(&path, &message, "give another directory with -o"));
        }
        OutputFile::new(&path, inputs)
    }

    /// The list of the written files, for later runs. It must get its name before all other files.
    pub fn marker<'a>(&'a self, names: impl Iterator<Item = &'a str>) -> Result<Pending> {
        let still_there = self.ours.iter().map(String::as_str).filter(|name| self.path.join(name).exists());
        let names: BTreeSet<&str> = names.chain(still_there).collect();
        OutputFile::new(&self.path.join(MARKER), &[])?.write(|out| {
            writeln!(out, "{MARKER_TITLE}")?;
            names.iter().try_for_each(|name| writeln!(out, "{name}"))
        })
    }
}

impl Drop for Directory {
    fn drop(&mut self) {
        remove_made();
    }
}

/// Refuses two outputs that are the same file.
pub fn check_distinct(outputs: &[&OutputFile]) -> Result<()> {
    for (i, output) in outputs.iter().enumerate() {
        if outputs[..i].iter().any(|other| output.is_same(other)) {
            let hint = "give each output its own name";
            return Err(usage(output.path(), "two outputs would be the same file", hint));
        }
    }
    Ok(())
}

fn is_device(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|there| !there.is_file())
}

fn usage(path: &Path, message: &str, hint: &str) -> Error {
    Error::Usage { message: format!("{}: {message}", path.display()), hint: Some(hint.into()) }
}

/// The names of the written files, for a summary.
pub fn names(paths: &[&Option<PathBuf>]) -> String {
    let names: Vec<_> = paths.iter().filter_map(|p| p.as_ref()).map(|p| p.display().to_string()).collect();
    if names.is_empty() { "nothing: no -o and no --report".into() } else { names.join(", ") }
}
