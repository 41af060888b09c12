//! The layer before tobj for material libraries. tobj panics on some lines (`Kd 0.5`), and drops the whole library
//! because of others (`Kd spectral …`). This layer rewrites or removes such lines. It also records the line number of
//! every statement.

use std::collections::{HashMap, HashSet};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use super::scan::{Scan, UNNAMED};
use crate::scene::text::{self, find_as_named, find_file, split_keyword, without_comment};
use crate::scene::{LoadOptions, warnings::Warnings};
use crate::{Error, Result};

/// Statements in the spelling that tobj knows. Exporters vary the case.
const STATEMENTS: [&str; 24] = [
    "Kd", "Ke", "Ks", "d", "Tr", "Tf", "illum", "map_Kd", "map_Ke", "map_Ks", "map_d", "map_Tr", "map_Ns",
    "bump", "map_bump", "norm", "disp", "decal", "refl", "Pm", "Pc", "Ns", "Pr", "aniso",
];

/// The origin of a material.
pub(super) struct Origin {
    pub(super) file: PathBuf,
    lines: HashMap<&'static str, usize>,
    /// A statement that cannot be read. It is an error only if a face uses the material.
    bad: Option<(usize, String)>,
    /// Warnings about this material. They appear only if a face uses it.
    pub(super) notes: Vec<String>,
    /// Whether a library defines it.
    pub(super) defined: bool,
}

impl Origin {
    /// An error at the line of `statement`.
    pub(super) fn error(&self, statement: &str, message: impl Into<String>) -> Error {
        Error::input(&self.file, self.lines.get(statement).copied(), message)
    }

    /// `FILE:LINE` of `statement`.
    pub(super) fn place(&self, statement: &str) -> String {
        match self.lines.get(statement) {
            Some(line) => format!("{}:{line}", self.file.display()),
            None => self.file.display().to_string(),
        }
    }

    pub(super) fn check(&self) -> Result<()> {
        match &self.bad {
            Some((line, message)) => Err(Error::input(&self.file, Some(*line), message)),
            None => Ok(()),
        }
    }
}

/// All libraries of an OBJ file.
#[derive(Default)]
pub(super) struct Libraries {
    /// The text of all libraries for tobj.
    pub(super) text: String,
    /// The origins of the materials, in tobj's order.
    pub(super) origins: Vec<Origin>,
    pub(super) warnings: Warnings,
    /// Libraries that were read.
    pub(super) files: Vec<PathBuf>,
    /// Names of libraries that could not be read.
    pub(super) missing: Vec<String>,
    /// Reflectance of undefined materials, in words.
    default: String,
    names: HashSet<String>,
    /// Whether the current statements belong to a second definition, which is ignored.
    skipping: bool,
}

impl Libraries {
    /// Reads the libraries that `scan` of `obj` names. Defines materials that faces use but no library defines.
    pub(super) fn read(obj: &Path, scan: &Scan, options: &LoadOptions) -> Libraries {
        let folder = obj.parent().unwrap_or(Path::new(""));
        let mut libraries = Libraries { default: options.default_in_words(), ..Libraries::default() };
        let mut seen = HashSet::new();
        for (line, value) in &scan.libraries {
            for name in library_names(folder, value) {
                if !seen.insert(name.clone()) {
                    continue;
                }
                let read = find_file(folder, &name)
                    .ok_or_else(|| "not found".to_string())
                    .map(|found| found.path)
                    .and_then(|path| std::fs::read(&path).map(|b| (path, b)).map_err(|e| e.to_string()));
                match read {
                    Ok((path, bytes)) => {
                        libraries.parse(&path, &text::decode(bytes));
                        libraries.files.push(path);
                    }
                    Err(why) => {
                        libraries.warnings.push(format!(
                            "{}:{line}: material library `{name}`: {why}; its materials get {}",
                            obj.display(),
                            libraries.default
                        ));
                        libraries.missing.push(name);
                    }
                }
            }
        }
        for (line, name) in &scan.used {
            if !libraries.names.contains(name) {
                let place = format!("{}:{line}", obj.display());
                let after = format!(" is not defined; it gets {}", libraries.default);
                libraries.warnings.repeat(place, "material", name, &after);
                libraries.define(obj, *line, name, false);
            }
        }
        libraries
    }

    fn parse(&mut self, path: &Path, text: &str) {
        // Statements before the first `newmtl` belong to no material.
        self.skipping = true;
        for (number, line) in text::lines(text) {
            let (keyword, value) = split_keyword(&line);
            if keyword.eq_ignore_ascii_case("newmtl") {
                self.define(path, number, if value.is_empty() { UNNAMED } else { value }, true);
            } else if !self.skipping
                && let Some(statement) = STATEMENTS.iter().find(|s| s.eq_ignore_ascii_case(keyword))
            {
                self.statement(statement, number, value);
            }
        }
    }

    fn define(&mut self, file: &Path, line: usize, name: &str, defined: bool) {
        self.skipping = !self.names.insert(name.into());
        if self.skipping {
            let place = format!("{}:{line}", file.display());
            self.warnings.repeat(place, "material", name, " is defined again; the first definition counts");
            return;
        }
        let _ = writeln!(self.text, "newmtl {name}");
        self.origins.push(Origin {
            file: file.into(),
            lines: HashMap::from([("newmtl", line)]),
            bad: None,
            notes: Vec::new(),
            defined,
        });
    }

    fn statement(&mut self, statement: &'static str, number: usize, value: &str) {
        let Some(origin) = self.origins.last_mut() else { return };
        let numbers = without_comment(value);
        let kept = match statement {
            "Kd" | "Ke" | "Ks" | "Tf" => match colour(numbers) {
                Ok(rgb) => Some(format!("{:e} {:e} {:e}", rgb[0], rgb[1], rgb[2])),
                Err(Unread::Spectral) if matches!(statement, "Kd" | "Ke") => {
                    let place = format!("{}:{number}", origin.file.display());
                    let default = if statement == "Kd" { &self.default } else { "no emission" };
                    origin.notes.push(format!(
                        "{place}: `{statement} spectral` is not supported; {default} is used instead"
                    ));
                    None
                }
                Err(Unread::Word(word)) if matches!(statement, "Kd" | "Ke") => {
                    origin.bad = Some((number, format!("{statement} needs three numbers, not `{word}`")));
                    None
                }
                Err(_) => None,
            },
            // tobj takes a byte; the cast saturates.
            "illum" => leading_number(numbers).map(|n| (n as u8).to_string()),
            "d" | "Tr" | "Ns" => leading_number(numbers).map(|n| n.to_string()),
            _ => Some(value.to_string()).filter(|v| !v.is_empty()),
        };
        if let Some(kept) = kept {
            origin.lines.insert(statement, number);
            let _ = writeln!(self.text, "{statement} {kept}");
        }
    }
}

enum Unread {
    Spectral,
    Word(String),
}

/// Reads three numbers. One number is a grey (MTL specification: g and b default to r). `xyz` is converted to Rec. 709.
fn colour(value: &str) -> std::result::Result<[f64; 3], Unread> {
    let mut words: Vec<&str> = value.split_whitespace().take(4).collect();
    let kind = words.first().map(|w| w.to_ascii_lowercase());
    if kind.as_deref() == Some("spectral") {
        return Err(Unread::Spectral);
    }
    let xyz = kind.as_deref() == Some("xyz");
    if xyz {
        words.remove(0);
    }
    let numbers = words
        .iter()
        .take(3)
        .map(|w| w.parse::<f64>().map_err(|_| Unread::Word((*w).into())))
        .collect::<std::result::Result<Vec<_>, _>>()?;
    let c = match numbers[..] {
        [grey] => [grey; 3],
        [r, g, b] => [r, g, b],
        _ => return Err(Unread::Word(value.trim().into())),
    };
    Ok(if xyz { rec709(c) } else { c })
}

/// Converts CIE XYZ (D65) to linear Rec. 709. A colour that lies outside the gamut only by the rounding of the file's
/// digits is moved onto its border.
fn rec709([x, y, z]: [f64; 3]) -> [f64; 3] {
    let rgb = [
        3.2404542 * x - 1.5371385 * y - 0.4985314 * z,
        -0.9692660 * x + 1.8760108 * y + 0.0415560 * z,
        0.0556434 * x - 0.2040259 * y + 1.0572252 * z,
    ];
    let tolerance = 1e-3 * y.abs();
    rgb.map(|c| {
        if (c - 1.0).abs() < tolerance {
            1.0
        } else if c.abs() < tolerance {
            0.0
        } else {
            c
        }
    })
}

fn leading_number(value: &str) -> Option<f64> {
    // In `d -halo 0.5`, the factor comes last.
    value.split_whitespace().find_map(|w| w.parse().ok())
}

/// The file names of one `mtllib` line. Names may contain blanks, so the whole value is one name if such a file exists.
/// Otherwise the value is cut after each `.mtl`; without any `.mtl`, it is cut at each blank.
fn library_names(folder: &Path, value: &str) -> Vec<String> {
    if value.is_empty() {
        return Vec::new();
    }
    if find_as_named(folder, value).is_some() {
        return vec![value.into()];
    }
    let mut names = vec![String::new()];
    for word in value.replace("\\ ", "\0").split_whitespace() {
        let word = word.replace('\0', " ");
        let name = names.last_mut().expect("never empty");
        if !name.is_empty() {
            name.push(' ');
        }
        name.push_str(&word);
        if word.to_ascii_lowercase().ends_with(".mtl") {
            names.push(String::new());
        }
    }
    let rest = names.pop().unwrap_or_default();
    names.extend(rest.split_whitespace().map(String::from));
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn library_lines_are_cut_after_the_extension() {
        let none = Path::new("/nonexistent");
        assert_eq!(library_names(none, "a b.mtl c.MTL"), ["a b.mtl", "c.MTL"]);
        assert_eq!(library_names(none, r"x\ y.mtl lib other"), ["x y.mtl", "lib", "other"]);
    }

    #[test]
    fn white_in_xyz_is_white() {
        let Ok(c) = colour("xyz 0.9505 1.0 1.089") else { panic!("not read") };
        assert_eq!(c, [1.0; 3]);
    }

    #[test]
    fn one_number_is_grey_and_two_are_wrong() {
        assert!(matches!(colour("0.25"), Ok([0.25, 0.25, 0.25])));
        assert!(matches!(colour("0.25 0.5"), Err(Unread::Word(_))));
    }
}
