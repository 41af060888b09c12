//! Reads `.gltf` and `.glb` files with their buffers: files, chunks and data URIs.

use std::{
    borrow::Cow,
    path::{Path, PathBuf},
};

use super::document::Root;
use crate::{Error, Result, scene::text};

/// Extensions that a file may require, because the reader supports them or because they do not affect diffuse light.
const KNOWN: [&str; 9] = [
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    "KHR_lights_punctual",
    "KHR_animation_pointer",
    "KHR_node_visibility",
    "EXT_mesh_gpu_instancing",
    "EXT_texture_webp",
    "MSFT_lod",
    "KHR_xmp_json_ld",
];
/// Prefix of further extensions that a file may require.
const KNOWN_START: &str = "KHR_materials_";

/// Extensions for compressed data, each with the command that unpacks it.
const COMPRESSED: [(&str, &str); 4] = [
    ("KHR_draco_mesh_compression", "npx @gltf-transform/cli dedup IN.glb OUT.glb"),
    ("EXT_meshopt_compression", "npx @gltf-transform/cli dedup IN.glb OUT.glb"),
    ("KHR_meshopt_compression", "npx @gltf-transform/cli dedup IN.glb OUT.glb"),
    ("KHR_texture_basisu", "npx @gltf-transform/cli ktxdecompress IN.glb OUT.glb"),
];

/// A file with all its buffers.
pub struct Document {
    /// The path of the file.
    pub path: PathBuf,
    /// The JSON as bytes.
    json: Vec<u8>,
    /// The parsed JSON.
    pub root: Root,
    /// The bytes of each buffer.
    pub buffers: Vec<Vec<u8>>,
    /// Files that were read.
    pub files: Vec<PathBuf>,
}

impl Document {
    /// Reads a file and the buffers that it names.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be read; [`Error::Input`] when its contents cannot be used.
    pub fn read(path: &Path) -> Result<Document> {
        Document::of_bytes(path, std::fs::read(path).map_err(|e| Error::io(path, e))?)
    }

    /// Parses the bytes of the file at `path`, and reads the buffers that it names.
    ///
    /// # Errors
    /// Those of [`Document::read`].
    pub fn of_bytes(path: &Path, bytes: Vec<u8>) -> Result<Document> {
        let (json, chunk, is_text) = split(path, bytes)?;
        let root: Root = serde_json::from_slice(&json).map_err(|e| {
            // The message ends with a position. It is replaced by the text there, and by a line if the file is text.
            let why = e.to_string();
            let why = why.rsplit_once(" at line ").map_or(&*why, |(before, _)| before);
            let line = is_text.then(|| e.line()).filter(|&line| line > 0);
            let near = before(&json, e.line(), e.column());
            Error::input(
                path,
                line,
                format!("the JSON of this glTF file cannot be used: {why}, after `{near}`"),
            )
        })?;
        check_version(path, &root)?;
        check_extensions(path, &root)?;
        let mut document =
            Document { path: path.to_owned(), json, root, buffers: Vec::new(), files: vec![path.to_owned()] };
        document.load_buffers(chunk)?;
        Ok(document)
    }

    /// All of the JSON, including parts that the reader does not know.
    ///
    /// # Errors
    /// [`Error::Input`] when the JSON is nested too deeply.
    pub fn value(&self) -> Result<serde_json::Value> {
        serde_json::from_slice(&self.json).map_err(|e| self.error(format!("the JSON cannot be used: {e}")))
    }

    /// An error in this file.
    pub fn error(&self, message: impl Into<String>) -> Error {
        Error::input(&self.path, None, message)
    }

    fn load_buffers(&mut self, mut chunk: Option<Vec<u8>>) -> Result<()> {
        for (i, buffer) in self.root.buffers.iter().enumerate() {
            let bytes = match &buffer.uri {
                // Only the first buffer may be the chunk. Other buffers without a URI get their contents from an
                // extension.
                None if i == 0 && chunk.is_some() => chunk.take().unwrap_or_default(),
                None => Vec::new(),
                Some(uri) => match data_uri(uri) {
                    Some(data) => data.map_err(|why| self.error(format!("buffers[{i}]: {why}")))?,
                    None => {
                        let (bytes, file) = self
                            .beside(uri)
                            .map_err(|why| self.error(format!("buffers[{i}]: {why}")).with_hint(
                                "keep the file with the geometry beside the .gltf file, or use a .glb, which holds everything",
                            ))?;
                        self.files.push(file);
                        bytes
                    }
                },
            };
            let missing = buffer.uri.is_some() || i == 0;
            if missing && (bytes.len() as u64) < buffer.byte_length {
                return Err(self.error(format!(
                    "buffers[{i}]: it should have {} bytes but has {}",
                    buffer.byte_length,
                    bytes.len()
                )));
            }
            self.buffers.push(bytes);
        }
        Ok(())
    }

    /// Reads the file that a relative URI names. Returns its bytes and its path.
    pub fn beside(&self, uri: &str) -> std::result::Result<(Vec<u8>, PathBuf), String> {
        let shown: String = uri.chars().take(80).collect();
        if uri.split(['/', '?', '#']).next().is_some_and(|start| start.contains(':') && start.len() > 2) {
            return Err(format!("`{shown}` is not fetched: only files beside the scene are read"));
        }
        let name = percent_decoded(uri)
            .ok_or_else(|| format!("`{shown}` is not a file name: its % codes are not UTF-8"))?;
        let folder = self.path.parent().unwrap_or(Path::new(""));
        let file = text::find_file(folder, &name).ok_or_else(|| format!("`{shown}` not found"))?.path;
        let bytes = std::fs::read(&file).map_err(|e| format!("`{shown}`: {e}"))?;
        Ok((bytes, file))
    }

    /// The bytes of an image, and its path if it is a separate file.
    pub fn image(&self, i: usize) -> std::result::Result<(Cow<'_, [u8]>, Option<PathBuf>), String> {
        let image = self.root.images.get(i).ok_or_else(|| format!("images[{i}] does not exist"))?;
        match (&image.uri, image.buffer_view) {
            (_, Some(view)) => self.view(view).map(|bytes| (bytes.into(), None)),
            (Some(uri), None) => match data_uri(uri) {
                Some(data) => data.map(|bytes| (bytes.into(), None)),
                None => self.beside(uri).map(|(bytes, file)| (bytes.into(), Some(file))),
            },
            (None, None) => Err("it has neither a file nor bytes".into()),
        }
    }

    /// The bytes of a buffer view.
    pub fn view(&self, i: usize) -> std::result::Result<&[u8], String> {
        let view = self.root.buffer_views.get(i).ok_or_else(|| format!("bufferViews[{i}] does not exist"))?;
        let buffer = self
            .buffers
            .get(view.buffer)
            .ok_or_else(|| format!("buffers[{}] does not exist", view.buffer))?;
        if view.extensions.meshopt.is_some() && buffer.is_empty() {
            return Err(format!("bufferViews[{i}] is compressed"));
        }
        let end = view.byte_offset.checked_add(view.byte_length);
        let range =
            end.and_then(|end| Some(usize::try_from(view.byte_offset).ok()?..usize::try_from(end).ok()?));
        range
            .and_then(|range| buffer.get(range))
            .ok_or_else(|| format!("bufferViews[{i}] ends beyond its buffer of {} bytes", buffer.len()))
    }
}

/// Splits a file. Returns its JSON, the binary chunk of a `.glb`, and whether the file is text.
fn split(path: &Path, bytes: Vec<u8>) -> Result<(Vec<u8>, Option<Vec<u8>>, bool)> {
    let error = |message: &str| Error::input(path, None, message);
    if !bytes.starts_with(b"glTF") {
        let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
        if !text.trim_ascii_start().starts_with(b"{") {
            return Err(error("not a glTF file: it begins neither with `glTF` nor with `{`"));
        }
        return Ok((text.to_vec(), None, true));
    }
    let word = |at: usize| {
        let four = bytes.get(at..at + 4)?;
        Some(u32::from_le_bytes(four.try_into().ok()?))
    };
    let truncated = || error("the file ends within its header");
    let (version, length) = (word(4).ok_or_else(truncated)?, word(8).ok_or_else(truncated)?);
    if version != 2 {
        return Err(error(&format!("binary glTF of version {version}; only version 2 is read"))
            .with_hint("open the file with a current program and export it again as glTF 2.0"));
    }
    if (bytes.len() as u64) < u64::from(length) {
        let message = format!("the file is cut off: it should have {length} bytes but has {}", bytes.len());
        return Err(error(&message));
    }
    let (mut at, mut json, mut binary) = (12, None, None);
    while at < length as usize && binary.is_none() {
        let (Some(size), Some(kind)) = (word(at), word(at + 4)) else { return Err(truncated()) };
        let data = (at + 8).checked_add(size as usize).and_then(|end| bytes.get(at + 8..end));
        let Some(data) = data else { return Err(error("a chunk ends beyond the file")) };
        match kind {
            0x4E4F_534A if json.is_none() => json = Some(data.to_vec()),
            0x004E_4942 if json.is_some() => binary = Some(data.to_vec()),
            _ => {}
        }
        at += 8 + data.len();
    }
    let json = json.ok_or_else(|| error("the file has no JSON chunk"))?;
    Ok((json, binary, false))
}

/// The last characters of the text before a place. Lines and columns count from 1.
fn before(json: &[u8], line: usize, column: usize) -> String {
    let line = json.split(|&b| b == b'\n').nth(line.saturating_sub(1)).unwrap_or_default();
    let end = column.min(line.len());
    String::from_utf8_lossy(&line[end.saturating_sub(40)..end]).trim().replace(char::is_control, " ")
}

fn check_version(path: &Path, root: &Root) -> Result<()> {
    let error = |message: String| {
        Error::input(path, None, message)
            .with_hint("open the file with a current program and export it again as glTF 2.0")
    };
    if !root.asset.version.starts_with("2.") {
        let version: String = root.asset.version.chars().take(20).collect();
        return Err(error(match &*version {
            "" => "asset.version is missing: this is not a glTF 2.0 file".into(),
            _ => format!("glTF of version {version}; only version 2.0 is read"),
        }));
    }
    match root.asset.min_version.as_deref() {
        None | Some("2.0") => Ok(()),
        Some(least) => {
            let least: String = least.chars().take(20).collect();
            Err(error(format!("the file needs a reader of glTF {least}; this one reads 2.0")))
        }
    }
}

fn check_extensions(path: &Path, root: &Root) -> Result<()> {
    for name in &root.extensions_required {
        if let Some((_, command)) = COMPRESSED.iter().find(|(compressed, _)| compressed == name) {
            return Err(Error::input(
                path,
                None,
                format!("the file is compressed ({name}), which is not read"),
            )
            .with_hint(format!("unpack it: {command}")));
        }
        if !KNOWN.contains(&&**name) && !name.starts_with(KNOWN_START) {
            let name: String = name.chars().take(60).collect();
            return Err(Error::input(
                path,
                None,
                format!("the file requires the extension {name}, which is not supported"),
            )
            .with_hint("export the scene without it"));
        }
    }
    Ok(())
}

/// The bytes of a data URI; `None` for any other URI.
fn data_uri(uri: &str) -> Option<std::result::Result<Vec<u8>, String>> {
    let rest = uri.get(..5).filter(|start| start.eq_ignore_ascii_case("data:")).map(|_| &uri[5..])?;
    let Some((kind, data)) = rest.split_once(',') else { return Some(Err("a data URI without data".into())) };
    if !kind.ends_with(";base64") {
        return Some(Err("a data URI that is not base64".into()));
    }
    Some(base64(data).ok_or_else(|| "a data URI whose base64 is broken".into()))
}

/// Decodes base64 (RFC 4648), with or without padding.
fn base64(text: &str) -> Option<Vec<u8>> {
    let text = text.trim_ascii().as_bytes();
    let text = text.strip_suffix(b"==").or_else(|| text.strip_suffix(b"=")).unwrap_or(text);
    let mut bytes = Vec::with_capacity(text.len() / 4 * 3 + 2);
    for group in text.chunks(4) {
        let mut word = 0u32;
        for &c in group {
            let digit = match c {
                b'A'..=b'Z' => c - b'A',
                b'a'..=b'z' => c - b'a' + 26,
                b'0'..=b'9' => c - b'0' + 52,
                b'+' | b'-' => 62,
                b'/' | b'_' => 63,
                _ => return None,
            };
            word = word << 6 | u32::from(digit);
        }
        // Four digits make three bytes, three digits two, and two digits one. A single digit is an error.
        let missing = 4 - group.len();
        if missing == 3 {
            return None;
        }
        word <<= 6 * missing;
        bytes.extend(&word.to_be_bytes()[1..4 - missing]);
    }
    Some(bytes)
}

/// Decodes codes like `%20`. `None` if the result is not UTF-8.
fn percent_decoded(uri: &str) -> Option<String> {
    let (mut bytes, mut rest) = (Vec::with_capacity(uri.len()), uri.as_bytes());
    while let [first, tail @ ..] = rest {
        let code = match (first, tail) {
            (b'%', [a, b, ..]) => {
                std::str::from_utf8(&[*a, *b]).ok().and_then(|two| u8::from_str_radix(two, 16).ok())
            }
            _ => None,
        };
        bytes.push(code.unwrap_or(*first));
        rest = if code.is_some() { &tail[2..] } else { tail };
    }
    String::from_utf8(bytes).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_of_the_standard() {
        // RFC 4648, section 10.
        for (text, bytes) in [
            ("", ""),
            ("Zg==", "f"),
            ("Zm8=", "fo"),
            ("Zm9v", "foo"),
            ("Zm9vYg==", "foob"),
            ("Zm9vYmE", "fooba"),
        ] {
            assert_eq!(base64(text).unwrap(), bytes.as_bytes());
        }
        assert!(base64("Z").is_none() && base64("Zg!=").is_none());
    }

    #[test]
    fn percent_codes_are_bytes_of_utf_8() {
        assert_eq!(percent_decoded("a%20b%C3%BC%").unwrap(), "a bü%");
        assert!(percent_decoded("..%ff%2f%2fx").is_none());
    }
}
