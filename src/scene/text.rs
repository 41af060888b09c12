//! Decodes text files into logical lines, and finds files by the names that exporters write.

use std::borrow::Cow;
use std::ffi::OsStr;
use std::path::{Component, Path, PathBuf};

use crate::{Error, Result};

/// Decodes a file: as UTF-16 if it has its byte order mark, otherwise as UTF-8. Text that is not UTF-8 is read as
/// Latin-1. This keeps different names different, unlike a replacement character.
pub(crate) fn decode(bytes: Vec<u8>) -> String {
    let utf_16 = |pair: fn([u8; 2]) -> u16| {
        let units: Vec<u16> = bytes[2..].as_chunks().0.iter().map(|&two| pair(two)).collect();
        String::from_utf16_lossy(&units)
    };
    if bytes.starts_with(b"\xff\xfe") {
        return utf_16(u16::from_le_bytes);
    }
    if bytes.starts_with(b"\xfe\xff") {
        return utf_16(u16::from_be_bytes);
    }
    let text =
        String::from_utf8(bytes).unwrap_or_else(|e| e.into_bytes().into_iter().map(char::from).collect());
    match text.strip_prefix('\u{feff}') {
        Some(rest) => rest.into(),
        None => text,
    }
}

/// Reads a file of a format that is UTF-8 by definition, such as TOML.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read. [`Error::Input`], with the line, when it is not UTF-8.
pub(crate) fn read_utf8(path: &Path) -> Result<String> {
    let bytes = std::fs::read(path).map_err(|source| Error::io(path, source))?;
    String::from_utf8(bytes).map_err(|error| {
        let line = line_of(error.as_bytes(), error.utf8_error().valid_up_to());
        Error::input(path, Some(line), "this line is not UTF-8 text: save the file as UTF-8")
    })
}

/// The line, from 1, of the byte with this index.
pub(crate) fn line_of(text: &[u8], at: usize) -> usize {
    1 + text[..at.min(text.len())].iter().filter(|&&byte| byte == b'\n').count()
}

/// Logical lines, each with the number of its first physical line. LF, CR LF and CR end a line. A backslash at the end
/// of a line continues it, but not in a comment, because some comments end with a Windows path.
pub(crate) fn lines(text: &str) -> impl Iterator<Item = (usize, Cow<'_, str>)> {
    let mut rest = text;
    let mut number = 0;
    std::iter::from_fn(move || {
        if rest.is_empty() {
            return None;
        }
        number += 1;
        let first = number;
        let mut line = Cow::Borrowed(physical_line(&mut rest));
        while !line.trim_start().starts_with('#')
            && !rest.is_empty()
            && let Some(kept) = line.trim_end().strip_suffix('\\')
        {
            number += 1;
            let kept = kept.trim_end().len();
            let line = line.to_mut();
            line.truncate(kept);
            line.push(' ');
            line.push_str(physical_line(&mut rest));
        }
        Some((first, line))
    })
}

/// The physical lines of the file.
pub(super) fn physical_lines(text: &str) -> impl Iterator<Item = &str> {
    let mut rest = text;
    std::iter::from_fn(move || (!rest.is_empty()).then(|| physical_line(&mut rest)))
}

fn physical_line<'a>(rest: &mut &'a str) -> &'a str {
    let end = rest.find(['\n', '\r']).unwrap_or(rest.len());
    let (line, tail) = rest.split_at(end);
    *rest = tail.strip_prefix("\r\n").or_else(|| tail.strip_prefix(['\n', '\r'])).unwrap_or(tail);
    line
}

/// The keyword of a line and its trimmed rest.
pub(crate) fn split_keyword(line: &str) -> (&str, &str) {
    let line = line.trim();
    line.split_once(char::is_whitespace).map_or((line, ""), |(key, rest)| (key, rest.trim()))
}

/// The part of a line before a comment. Use it only for lines of numbers: names may contain `#`.
pub(crate) fn without_comment(rest: &str) -> &str {
    rest.split_once('#').map_or(rest, |(before, _)| before)
}

/// A file that was found by its name.
pub(super) struct Found {
    pub(super) path: PathBuf,
    /// Whether the file is not where its name points, but was found by the last parts of the name.
    pub(super) elsewhere: bool,
}

/// Finds the file that a file in `folder` calls `name`. Tries the name with and without a comment after it
/// ([`find_as_named`]). If both fail, the name may be a path of another machine: then tries its last parts, the longest
/// path first.
pub(super) fn find_file(folder: &Path, name: &str) -> Option<Found> {
    let bare = name.trim().trim_matches('"');
    let without_comment = bare.split_once(" #").or_else(|| bare.split_once("\t#")).map(|(before, _)| before);
    let names = [Some(bare), without_comment];
    let named = names.iter().flatten().find_map(|name| find_as_named(folder, name));
    if let Some(path) = named {
        return Some(Found { path, elsewhere: false });
    }
    names.into_iter().flatten().find_map(|name| {
        let slashed = name.trim().trim_matches('"').replace('\\', "/");
        let parts: Vec<&str> = slashed.split('/').filter(|part| !part.is_empty()).collect();
        let path = (0..parts.len()).find_map(|first| existing(folder, &parts[first..].join("/")))?;
        Some(Found { path, elsewhere: true })
    })
}

/// Finds the file `name` in `folder`. Also tries `\ ` as a blank, `\` as `/`, and each part in upper and lower case.
pub(super) fn find_as_named(folder: &Path, name: &str) -> Option<PathBuf> {
    let bare = name.trim().trim_matches('"');
    existing(folder, bare).or_else(|| existing(folder, &bare.replace("\\ ", " ").replace('\\', "/")))
}

fn existing(folder: &Path, name: &str) -> Option<PathBuf> {
    let path = folder.join(name);
    if path.is_file() {
        return Some(path);
    }
    let mut place = PathBuf::new();
    for part in path.components() {
        place = match part {
            Component::Normal(part) if !place.join(part).exists() => in_any_case(&place, part)?,
            _ => place.join(part),
        };
    }
    place.is_file().then_some(place)
}

/// The entry of a folder whose name differs from this one in case only.
fn in_any_case(folder: &Path, name: &OsStr) -> Option<PathBuf> {
    let wanted = name.to_str()?.to_lowercase();
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let names = std::fs::read_dir(folder).ok()?.flatten().map(|entry| entry.file_name());
    // The order of a directory is not defined.
    names.filter(|name| name.to_string_lossy().to_lowercase() == wanted).min().map(|name| folder.join(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn continued_lines_keep_the_number_of_their_first() {
        let text = "a \\\r\n b\r\n# c:\\\nd\re";
        let got: Vec<_> = lines(text).map(|(n, l)| (n, l.split_whitespace().collect::<String>())).collect();
        assert_eq!(got, [(1, "ab".into()), (3, "#c:\\".into()), (4, "d".into()), (5, "e".into())]);
    }

    /// With a quadratic algorithm, this test would take minutes.
    #[test]
    fn lines_continued_very_often_are_read_in_linear_time() {
        for part in ["1 2 3 \\\n", "\\\n"] {
            let text = part.repeat(500_000) + "4\n";
            let got: Vec<_> = lines(&text).collect();
            let words = got[0].1.split_whitespace().count();
            assert_eq!((got.len(), words), (1, if part.len() > 2 { 1_500_001 } else { 1 }));
        }
    }

    #[test]
    fn files_are_found_in_any_case_behind_comments_and_from_other_machines() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir_all(folder.path().join("Textures/Wood")).unwrap();
        std::fs::write(folder.path().join("Textures/Wood/Oak 1.png"), b"").unwrap();
        for (name, elsewhere) in [
            ("Textures/Wood/Oak 1.png", false),
            ("textures\\wood\\oak 1.PNG", false),
            ("TEXTURES/Wood/oak\\ 1.png # the floor", false),
            ("\"Textures/Wood/Oak 1.png\"\t# the floor", false),
            ("C:\\Users\\me\\textures\\WOOD\\Oak 1.png", true),
            ("/home/me/level/textures/wood/oak 1.png # the floor", true),
        ] {
            let found = find_file(folder.path(), name).unwrap_or_else(|| panic!("{name}"));
            assert!(found.path.ends_with("Textures/Wood/Oak 1.png"), "{name}: {}", found.path.display());
            assert_eq!(found.elsewhere, elsewhere, "{name}");
        }
        for name in ["Oak 1.png", "wood/oak 2.png", "", "/", "Textures/Wood"] {
            assert!(find_file(folder.path(), name).is_none(), "{name}");
        }
    }

    #[test]
    fn latin_1_names_stay_different() {
        assert_ne!(decode(b"gr\xfcn".to_vec()), decode(b"gr\xf6n".to_vec()));
        assert_eq!(decode("\u{feff}v".into()), "v");
    }

    #[test]
    fn utf_16_is_recognised_by_its_mark() {
        for swap in [u16::to_le_bytes, u16::to_be_bytes] {
            let bytes = "\u{feff}v 1 ü𝄞\n".encode_utf16().flat_map(swap).collect();
            assert_eq!(decode(bytes), "v 1 ü𝄞\n");
        }
        // Half of a surrogate pair at the end is dropped.
        assert_eq!(decode(b"\xff\xfev\0w".to_vec()), "v");
    }
}
