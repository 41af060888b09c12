//! The layer before tobj for the OBJ file itself. It checks every line, records its number, and writes a text that tobj
//! can read.

use std::collections::{HashMap, HashSet};
use std::fmt::Write as _;
use std::path::Path;

use crate::scene::Part;
use crate::scene::text::{self, split_keyword, without_comment};
use crate::scene::warnings::Warnings;
use crate::{Error, Result, tone};

/// Name of a material without a name.
pub(super) const UNNAMED: &str = "(unnamed)";

/// A polygon. It has the same index in tobj's list of faces.
pub(super) struct Face {
    pub(super) line: usize,
    /// Whether every corner has a texture coordinate.
    pub(super) textured: bool,
    /// Index into the parts.
    pub(super) part: u32,
    /// Where its corners begin in [`Scan::corners`].
    pub(super) corners: usize,
}

/// An OBJ file, checked.
pub(super) struct Scan {
    /// The text for tobj: first all vertices, because faces may come before them in the file; then faces with absolute
    /// indices.
    pub(super) text: String,
    /// The polygons of `text`, in order.
    pub(super) faces: Vec<Face>,
    /// Linear colours of the vertices, in file order. Empty if the file has none.
    pub(super) colours: Vec<Option<[f32; 3]>>,
    /// Normals, in file order.
    pub(super) normals: Vec<[f32; 3]>,
    /// Indices of the vertex and the normal of each corner of all faces, from 0. A corner without a normal has an index
    /// that does not exist. Empty if the file has neither colours nor normals.
    pub(super) corners: Vec<(u32, u32)>,
    /// Objects and groups of faces.
    pub(super) parts: Vec<Part>,
    /// `mtllib` lines.
    pub(super) libraries: Vec<(usize, String)>,
    /// Names after `usemtl`, each with the line of the first face that uses it.
    pub(super) used: Vec<(usize, String)>,
    pub(super) warnings: Warnings,
}

struct Scanner<'a> {
    path: &'a Path,
    positions: usize,
    texcoords: usize,
    /// The value of white in the file's colours: 1 or 255. `None` if vertices have no colours.
    white: Option<f64>,
    has_normals: bool,
    total_positions: usize,
    total_texcoords: usize,
    vertex_text: String,
    face_text: String,
    material: Option<String>,
    /// The names in [`Scan::used`].
    used: HashSet<String>,
    part: Part,
    /// Index of `part` in the list, if a face has used it.
    current: Option<u32>,
    known: HashMap<Part, u32>,
    skipped: Noted,
    bad_texcoords: Noted,
    absent_texcoords: Noted,
    surfaces: Noted,
    scan: Scan,
}

/// The number of cases, and the line of the first case.
#[derive(Default)]
struct Noted {
    count: usize,
    line: usize,
}

impl Noted {
    fn add(&mut self, line: usize) {
        if self.count == 0 {
            self.line = line;
        }
        self.count += 1;
    }
}

/// Reads the lines of `text`, the contents of `path`.
pub(super) fn scan(path: &Path, text: &str) -> Result<Scan> {
    let count = |keyword| text::lines(text).filter(|(_, l)| split_keyword(l).0 == keyword).count();
    let mut scanner = Scanner {
        path,
        positions: 0,
        texcoords: 0,
        white: white(text),
        has_normals: text.contains("vn"),
        total_positions: count("v"),
        total_texcoords: count("vt"),
        vertex_text: String::new(),
        face_text: String::new(),
        material: None,
        used: HashSet::new(),
        part: Part::default(),
        current: None,
        known: HashMap::new(),
        skipped: Noted::default(),
        bad_texcoords: Noted::default(),
        absent_texcoords: Noted::default(),
        surfaces: Noted::default(),
        scan: Scan {
            text: String::new(),
            faces: Vec::new(),
            colours: Vec::new(),
            normals: Vec::new(),
            corners: Vec::new(),
            parts: Vec::new(),
            libraries: Vec::new(),
            used: Vec::new(),
            warnings: Warnings::default(),
        },
    };
    for (number, line) in text::lines(text) {
        let (keyword, rest) = split_keyword(&line);
        match keyword {
            "v" => scanner.position(number, without_comment(rest))?,
            "vt" => scanner.texcoord(number, without_comment(rest))?,
            "vn" => scanner.normal(without_comment(rest)),
            "f" | "fo" => scanner.face(number, without_comment(rest))?,
            "usemtl" => scanner.material = Some(if rest.is_empty() { UNNAMED } else { rest }.into()),
            "o" => scanner.belongs(|part| &mut part.object, rest),
            "g" => scanner.belongs(|part| &mut part.group, rest),
            "mtllib" => scanner.scan.libraries.push((number, rest.into())),
            "surf" => scanner.surfaces.add(number),
            _ => {}
        }
    }
    Ok(scanner.finish())
}

impl Scanner<'_> {
    fn error(&self, line: usize, message: impl Into<String>) -> Error {
        Error::input(self.path, Some(line), message)
    }

    /// Reads x y z. The weight is for rational curves (OBJ specification, "Vertex data"). Colours are an extension.
    fn position(&mut self, line: usize, rest: &str) -> Result<()> {
        let mut words = rest.split_whitespace();
        self.vertex_text.push('v');
        for axis in ["x", "y", "z"] {
            let Some(word) = words.next() else {
                return Err(self.error(line, format!("vertex without {axis}")));
            };
            let value: f64 = word
                .parse()
                .map_err(|_| self.error(line, format!("vertex coordinate `{word}` is not a number")))?;
            if !value.is_finite() {
                return Err(self.error(line, format!("vertex coordinate `{word}` is not finite")));
            }
            let _ = write!(self.vertex_text, " {word}");
        }
        self.vertex_text.push('\n');
        self.positions += 1;
        if let Some(white) = self.white {
            let colour =
                colour(rest).map(|rgb| rgb.map(|c| tone::linear((c / white).clamp(0.0, 1.0)) as f32));
            self.scan.colours.push(colour);
        }
        Ok(())
    }

    /// Reads a normal. Numbers that are missing or wrong become 0, without an error: light does not depend on normals.
    fn normal(&mut self, rest: &str) {
        let mut normal = [0.0; 3];
        for (value, word) in normal.iter_mut().zip(rest.split_whitespace()) {
            *value = word.parse().ok().filter(|x: &f32| x.is_finite()).unwrap_or_default();
        }
        self.scan.normals.push(normal);
    }

    fn texcoord(&mut self, line: usize, rest: &str) -> Result<()> {
        let mut uv = [0.0f64; 2];
        for (value, word) in uv.iter_mut().zip(rest.split_whitespace()) {
            *value = word
                .parse()
                .map_err(|_| self.error(line, format!("texture coordinate `{word}` is not a number")))?;
        }
        if !uv.iter().all(|c| c.is_finite()) {
            self.bad_texcoords.add(line);
            uv = [0.0; 2];
        }
        let _ = writeln!(self.vertex_text, "vt {:e} {:e}", uv[0], uv[1]);
        self.texcoords += 1;
        Ok(())
    }

    fn face(&mut self, line: usize, rest: &str) -> Result<()> {
        let corners =
            rest.split_whitespace().map(|word| self.corner(line, word)).collect::<Result<Vec<_>>>()?;
        if corners.len() < 3 {
            self.skipped.add(line);
            return Ok(());
        }
        self.use_material(line);
        let textured = corners.iter().all(|(_, vt, _)| vt.is_some());
        self.face_text.push('f');
        let first = self.scan.corners.len();
        if self.white.is_some() || self.has_normals {
            self.scan.corners.extend(corners.iter().map(|&(v, _, vn)| (v as u32 - 1, vn)));
        }
        for (v, vt, _) in corners {
            let _ = match vt.filter(|_| textured) {
                Some(vt) => write!(self.face_text, " {v}/{vt}"),
                None => write!(self.face_text, " {v}"),
            };
        }
        self.face_text.push('\n');
        let part = self.part();
        self.scan.faces.push(Face { line, textured, part, corners: first });
        Ok(())
    }

    /// Begins another object or group. With an empty name, the next faces belong to none.
    fn belongs(&mut self, to: impl Fn(&mut Part) -> &mut Option<String>, name: &str) {
        *to(&mut self.part) = (!name.is_empty()).then(|| name.into());
        self.current = None;
    }

    fn part(&mut self) -> u32 {
        let (part, parts, known) = (&self.part, &mut self.scan.parts, &mut self.known);
        *self.current.get_or_insert_with(|| match known.get(part) {
            Some(&index) => index,
            None => {
                parts.push(part.clone());
                known.insert(part.clone(), parts.len() as u32 - 1);
                parts.len() as u32 - 1
            }
        })
    }

    /// Writes `usemtl` before the first face that needs it.
    fn use_material(&mut self, line: usize) {
        if let Some(name) = self.material.take() {
            let _ = writeln!(self.face_text, "usemtl {name}");
            if !self.used.contains(&name) {
                self.used.insert(name.clone());
                self.scan.used.push((line, name));
            }
        }
    }

    /// Indices of the vertex and texture coordinate of a corner, from 1, and of its normal, from 0. A texture
    /// coordinate or a normal that does not exist is not an error, because the light may not depend on it.
    fn corner(&mut self, line: usize, word: &str) -> Result<(usize, Option<usize>, u32)> {
        let mut parts = word.split('/');
        let mut index = || match parts.next().unwrap_or_default() {
            "" => Ok(None),
            digits => digits.parse::<i64>().map(Some).map_err(|_| {
                Error::input(self.path, Some(line), format!("face corner `{word}` is not an index"))
            }),
        };
        let (Some(v), vt) = (index()?, index()?) else {
            return Err(self.error(line, format!("face corner `{word}` is not an index")));
        };
        let Some(position) = absolute(v, self.positions, self.total_positions) else {
            let why = match v {
                0 => "vertex 0 does not exist: vertices count from 1".into(),
                v if v < 0 => format!("vertex {v} does not exist, {} came before", self.positions),
                v => format!("vertex {v} does not exist, the file has {}", self.total_positions),
            };
            return Err(self.error(line, format!("face corner `{word}`: {why}")));
        };
        let given = parts.next().and_then(|digits| digits.parse().ok());
        let normal = given.and_then(|vn| absolute(vn, self.scan.normals.len(), u32::MAX as usize));
        let normal = normal.map_or(u32::MAX, |vn| vn as u32 - 1);
        let texcoord = vt.and_then(|vt| absolute(vt, self.texcoords, self.total_texcoords));
        if vt.is_some() && texcoord.is_none() {
            self.absent_texcoords.add(line);
        }
        Ok((position, texcoord, normal))
    }

    fn finish(self) -> Scan {
        let mut scan = self.scan;
        let mut note = |noted: &Noted, what: &str| {
            if noted.count > 0 {
                let at = self.path.display();
                scan.warnings.push(format!("{at}:{}: {what} ({} in the file)", noted.line, noted.count));
            }
        };
        note(&self.skipped, "a face with fewer than three vertices is left out");
        note(&self.bad_texcoords, "a texture coordinate is not finite; 0 0 is used instead");
        note(
            &self.absent_texcoords,
            "a face corner names a texture coordinate that does not exist; the face gets no texture",
        );
        note(&self.surfaces, "a free-form surface is left out");
        scan.text = self.vertex_text + &self.face_text;
        scan
    }
}

/// The colour of a vertex line: the last three of six numbers, or of seven numbers (then the fourth is the weight).
/// `None` for other lines and for words that are not numbers.
fn colour(rest: &str) -> Option<[f64; 3]> {
    let mut words = rest.split_whitespace().skip(3);
    let mut numbers = [0.0; 4];
    let count = words.by_ref().take(4).zip(&mut numbers).try_fold(0, |count, (word, number)| {
        *number = word.parse().ok().filter(|x: &f64| x.is_finite())?;
        Some(count + 1)
    })?;
    match (count, numbers) {
        (3, [r, g, b, _]) | (4, [_, r, g, b]) if words.next().is_none() => Some([r, g, b]),
        _ => None,
    }
}

/// The value of white: 1, or 255 if a colour is larger than 1. `None` if no vertex has a colour.
fn white(text: &str) -> Option<f64> {
    let lines = text::lines(text);
    let colours = lines.filter_map(|(_, line)| match split_keyword(&line) {
        ("v", rest) => colour(without_comment(rest)),
        _ => None,
    });
    let most = colours.flatten().reduce(f64::max)?;
    Some(if most > 1.0 { 255.0 } else { 1.0 })
}

/// Makes an index absolute, counted from 1. Negative indices count back from the last element read.
fn absolute(index: i64, so_far: usize, total: usize) -> Option<usize> {
    let index = if index < 0 { index.checked_add_unsigned(so_far as u64)?.checked_add(1)? } else { index };
    usize::try_from(index).ok().filter(|i| (1..=total).contains(i))
}
