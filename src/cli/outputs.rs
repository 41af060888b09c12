//! The files that a command writes: checked before the work, written after it, together.

use std::path::{Path, PathBuf};

use radiosity::{Error, Result, monte_carlo::PictureFormat, output::file::OutputFile};

/// Kinds of files that scenes are made of. No text takes the place of one: it might be of another scene. Those of this
/// scene are compared with each output once they are known (`pipeline::read`).
const INPUT_KINDS: [&str; 13] =
    ["obj", "mtl", "gltf", "glb", "bin", "png", "jpg", "jpeg", "tga", "bmp", "exr", "hdr", "dds"];

/// Where a mesh can be written to.
pub fn mesh(path: &Path, scene: &Path) -> Result<OutputFile> {
    let output = OutputFile::new(path, &[scene])?;
    let is_ply = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("ply"));
    if !is_ply && !is_device(path) {
        return Err(usage(path, "the name of a mesh must end in .ply", "the program writes PLY files"));
    }
    Ok(output)
}

/// Where a picture can be written to, and its format.
pub fn picture(path: &Path, scene: &Path) -> Result<(OutputFile, PictureFormat)> {
    let output = OutputFile::new(path, &[scene])?;
    let extension = path.extension().map(|e| e.to_string_lossy());
    match extension.and_then(|e| PictureFormat::of_extension(&e)) {
        Some(format) => Ok((output, format)),
        None if is_device(path) => Ok((output, PictureFormat::Png)),
        None => Err(usage(path, "unknown kind of picture", "end the name in .png, .exr or .hdr")),
    }
}

/// Where a report can be written to.
pub fn report(path: &Path, scene: &Path) -> Result<OutputFile> {
    text(path, &[scene], "a report")
}

/// Where text can be written to; `what` it is.
pub fn text(path: &Path, inputs: &[&Path], what: &str) -> Result<OutputFile> {
    let output = OutputFile::new(path, inputs)?;
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    if extension.is_some_and(|e| INPUT_KINDS.contains(&e.as_str())) {
        let message = format!("{what} may not take the name of a scene, material or texture");
        return Err(usage(path, &message, "give it a name that ends in .json or .txt"));
    }
    Ok(output)
}

/// Refuses two outputs that are one file.
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

/// Names of files for a summary.
pub fn names(paths: &[&Option<PathBuf>]) -> String {
    let names: Vec<_> = paths.iter().filter_map(|p| p.as_ref()).map(|p| p.display().to_string()).collect();
    if names.is_empty() { "nothing: no -o and no --report".into() } else { names.join(", ") }
}
