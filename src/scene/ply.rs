//! PLY meshes, ASCII and binary, through [ply-rs](https://docs.rs/ply-rs-bw).
//!
//! The format has no materials and no light, and the names of its elements are conventions. The reader knows these:
//!
//! - `vertex`: `x y z`; `red green blue`, integers of 0 to 255 (`ushort` to 65535) or floats of 0 to 1, sRGB-encoded.
//! - `face`: a list `vertex_indices` or `vertex_index` of any integer type; the same colours, which take precedence
//!   over those of the vertices; `reflectance_r reflectance_g reflectance_b`, linear, which take precedence over any
//!   colour; `emission_r emission_g emission_b`, radiance in W/(m² sr).
//!
//! The reflectance of a face is the mean of the linear colours of its vertices. The name of a material is its
//! reflectance as a colour, `#rrggbb`. Faces without reflectance have the material `(none)`.
//!
//! The reader also reads files that this program wrote. Their vertex colours show light and do not count as
//! reflectances. A face that shows the back of its patch is turned round. It is left out if the file has a face for the
//! front too ([`BOTH_SIDES`]).
//!
//! Each element becomes triangles as soon as it is read. So a false header cannot make the reader allocate memory.

mod element;

use std::collections::{HashMap, HashSet};
use std::path::Path;

use glam::DVec3;
use ply_rs::parser::{Parser, Reader};
use ply_rs::ply::{ElementDef, Encoding, Header, PropertyAccess, PropertyType};

use self::element::{Face, INDICES, Ignored, Vertex};
use super::warnings::Warnings;
use super::{
    LoadOptions, MOST_RADIANCE, Material, Part, Scene, SceneBuilder, is_radiance, text, triangulate,
};
use crate::{Error, Result, tone};

/// The comment in files that have faces for both sides of patches.
pub(crate) const BOTH_SIDES: &str = "faces: both sides of patches";

/// Reads `path`.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read. [`Error::Input`] when its contents cannot be used, with the line of an
/// ASCII file or the number of the element of a binary file.
pub(super) fn load(path: &Path, options: &LoadOptions) -> Result<Scene> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    let (header, first_line, payload) = read_header(path, &bytes)?;
    check(path, &header)?;
    let light = header.elements["vertex"].properties.contains_key("radiosity_r");
    let mut mesh = Mesh {
        path,
        options,
        light,
        sides: ["triangle", "side"].iter().all(|p| header.elements["face"].properties.contains_key(*p)),
        both: header.comments.iter().any(|comment| comment.trim() == BOTH_SIDES),
        vertices: Vec::new(),
        normals: Vec::new(),
        builder: SceneBuilder::default(),
        materials: Vec::new(),
        known: HashMap::new(),
        parts: HashMap::new(),
        warnings: Warnings::default(),
        plain: 0,
        short: None,
    };
    match header.encoding {
        Encoding::Ascii => read_ascii(&mut mesh, &header, first_line, payload)?,
        encoding => read_binary(&mut mesh, &header, encoding, payload)?,
    }
    mesh.finish(&header)
}

/// The header, the number of the line after it, and the rest of the file.
///
/// ply-rs needs UTF-8 without blank lines and without blanks before a keyword, and lines that end with LF. But comments
/// often hold names in other encodings. So ply-rs gets a clean copy.
fn read_header<'a>(path: &Path, bytes: &'a [u8]) -> Result<(Header, usize, &'a [u8])> {
    let error = |line, message: &str| Error::input(path, line, message);
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    if !bytes.starts_with(b"ply") {
        return Err(error(Some(1), "not a PLY file: it does not begin with `ply`"));
    }
    // A line ends with CR LF or LF, or with CR if the first line ends so.
    let first = bytes.iter().position(|b| matches!(b, b'\n' | b'\r')).unwrap_or(0);
    let end =
        if bytes[first..].starts_with(b"\r") && !bytes[first..].starts_with(b"\r\n") { b'\r' } else { b'\n' };
    let (mut rest, mut line, mut clean) = (bytes, 0, String::new());
    let mut names = (HashSet::new(), HashSet::new());
    loop {
        if rest.is_empty() {
            return Err(error(Some(line), "the file ends before `end_header`"));
        }
        line += 1;
        let length = rest.iter().position(|&b| b == end).unwrap_or(rest.len());
        let (this, tail) = rest.split_at(length);
        rest = tail.get(1..).unwrap_or_default();
        let this = text::decode(this.to_vec());
        let words: Vec<&str> = this.split_whitespace().collect();
        let twice = match words[..] {
            ["element", name, ..] => {
                names.1.clear();
                (!names.0.insert(name.to_owned())).then_some(name)
            }
            ["property", .., name] => (!names.1.insert(name.to_owned())).then_some(name),
            _ => None,
        };
        if let Some(name) = twice {
            return Err(error(Some(line), &format!("`{name}` is declared twice")));
        }
        clean += if words.is_empty() { "comment" } else { this.trim() };
        clean.push('\n');
        if words == ["end_header"] {
            break;
        }
    }
    let header = Parser::<Vertex>::new().read_header(&mut Reader::new(clean.as_bytes())).map_err(|e| {
        let message =
            e.line().and_then(|l| clean.lines().nth(l - 1)).map(|l| format!("`{l}` is not understood"));
        error(e.line(), &message.unwrap_or_else(|| first_line(&e.to_string())))
    })?;
    Ok((header, line + 1, rest))
}

/// Checks that the header has everything that a mesh needs, with usable types.
fn check(path: &Path, header: &Header) -> Result<()> {
    let error = |message: String| Error::input(path, None, message);
    let faces = header.elements.get("face");
    if faces.is_none_or(|faces| faces.count == 0) {
        return Err(error("no faces".into()).with_hint(if header.elements.contains_key("tristrips") {
            "triangle strips are not read: save the mesh with an element `face`"
        } else {
            "the file needs an element `face` with a list `vertex_indices`; points have no area to light"
        }));
    }
    for (element, needed) in [("vertex", &["x", "y", "z"][..]), ("face", &[])] {
        let Some(found) = header.elements.get(element) else {
            return Err(error(format!("there is no element `{element}`")));
        };
        if let Some(missing) = needed.iter().find(|&&p| !is_scalar(found, p)) {
            return Err(error(format!("element `{element}` has no number `{missing}`")));
        }
    }
    let faces = &header.elements["face"].properties;
    if !INDICES
        .iter()
        .any(|name| faces.get(*name).is_some_and(|p| matches!(p.data_type, PropertyType::List(..))))
    {
        return Err(error("element `face` has no list `vertex_indices`".into()));
    }
    // A header could announce any number of elements without properties.
    match header.elements.values().find(|e| e.count > 0 && e.properties.is_empty()) {
        Some(empty) => Err(error(format!("element `{}` has no properties", empty.name))),
        None => Ok(()),
    }
}

fn is_scalar(element: &ElementDef, property: &str) -> bool {
    element.properties.get(property).is_some_and(|p| matches!(p.data_type, PropertyType::Scalar(_)))
}

fn first_line(text: &str) -> String {
    text.lines().next().unwrap_or_default().trim_end_matches('.').into()
}

fn read_ascii(mesh: &mut Mesh, header: &Header, first: usize, payload: &[u8]) -> Result<()> {
    let text = String::from_utf8_lossy(payload);
    let mut lines = text::physical_lines(&text).enumerate().filter(|(_, line)| !line.trim().is_empty());
    let mut last = first;
    for element in header.elements.values() {
        for k in 0..element.count {
            let Some((n, line)) = lines.next() else {
                let message =
                    format!("the file ends after {k} of {} elements `{}`", element.count, element.name);
                return Err(Error::input(mesh.path, Some(last), message));
            };
            last = first + n;
            let at = Place { line: Some(last), element: &element.name, index: k };
            match element.name.as_str() {
                "vertex" => mesh.vertex(ascii(line, element, mesh.path, &at)?, &at)?,
                "face" => mesh.face(ascii(line, element, mesh.path, &at)?, &at)?,
                _ => {}
            }
        }
    }
    Ok(())
}

fn ascii<E: PropertyAccess>(line: &str, element: &ElementDef, path: &Path, at: &Place) -> Result<E> {
    let parser = Parser::new();
    parser.read_ascii_element(line, element).or_else(|_| {
        // The parser does not know numbers like `1.` and `.5`.
        let words: Vec<String> = line
            .split_whitespace()
            .map(|word| match word.parse::<f64>() {
                Ok(number) if number.is_finite() && word.contains('.') => number.to_string(),
                _ => word.into(),
            })
            .collect();
        parser.read_ascii_element(&words.join(" "), element).map_err(|_| {
            let shown: String = line.trim().chars().take(60).collect();
            at.error(path, format!("`{shown}` is not a {}", element.name))
        })
    })
}

fn read_binary(mesh: &mut Mesh, header: &Header, encoding: Encoding, payload: &[u8]) -> Result<()> {
    let mut rest = payload;
    for element in header.elements.values() {
        for k in 0..element.count {
            let at = Place { line: None, element: &element.name, index: k };
            match element.name.as_str() {
                "vertex" => mesh.vertex(binary(&mut rest, element, encoding, mesh.path, &at)?, &at)?,
                "face" => mesh.face(binary(&mut rest, element, encoding, mesh.path, &at)?, &at)?,
                _ => {
                    binary::<Ignored>(&mut rest, element, encoding, mesh.path, &at)?;
                }
            }
        }
    }
    Ok(())
}

fn binary<E: PropertyAccess>(
    rest: &mut &[u8],
    element: &ElementDef,
    encoding: Encoding,
    path: &Path,
    at: &Place,
) -> Result<E> {
    let parser = Parser::new();
    let read = match encoding {
        Encoding::BinaryBigEndian => parser.read_big_endian_element(rest, element),
        _ => parser.read_little_endian_element(rest, element),
    };
    read.map_err(|e| match e.kind() {
        std::io::ErrorKind::UnexpectedEof => {
            at.error(path, format!("the file ends here; its header announces {}", element.count))
        }
        _ => at.error(path, first_line(&e.to_string())),
    })
}

/// The place of an element, for messages.
struct Place<'a> {
    line: Option<usize>,
    element: &'a str,
    index: usize,
}

impl Place<'_> {
    fn error(&self, path: &Path, message: String) -> Error {
        // A line number helps more than the number of an element.
        match self.line {
            Some(_) => Error::input(path, self.line, message),
            None => Error::input(path, None, format!("{} {}: {message}", self.element, self.index)),
        }
    }
}

/// Collects the elements.
struct Mesh<'a> {
    path: &'a Path,
    options: &'a LoadOptions,
    /// Whether vertex colours show light.
    light: bool,
    /// Whether this program wrote the file, with a number at each face for the side of the patch that it shows.
    sides: bool,
    /// Whether the file has faces for both sides of patches.
    both: bool,
    vertices: Vec<Corner>,
    /// Normals of each triangle's corners, where the vertices have some.
    normals: Vec<[[f32; 3]; 3]>,
    builder: SceneBuilder,
    materials: Vec<Material>,
    /// Materials by reflectance and emission.
    known: HashMap<(Option<[u64; 3]>, [u64; 3]), u32>,
    /// Parts by the properties that their faces share, numbered in the order of their first face.
    parts: HashMap<Part, u32>,
    warnings: Warnings,
    /// Number of faces without a reflectance.
    plain: usize,
    /// Number of faces with too few corners, and the place of the first.
    short: Option<(usize, String)>,
}

impl Mesh<'_> {
    /// Whether colours are reflectances. They are not if they show light or if an option sets the reflectance.
    fn colours_count(&self) -> bool {
        !self.light && self.options.reflectance.is_none()
    }

    fn vertex(&mut self, vertex: Vertex, at: &Place) -> Result<()> {
        let position = DVec3::from_array(vertex.position);
        if !position.is_finite() {
            return Err(at.error(self.path, "a coordinate is not finite".into()));
        }
        let colour = vertex.colour.linear().map_err(|why| at.error(self.path, why))?;
        let colour = colour.filter(|_| self.colours_count());
        self.vertices.push(Corner { position, normal: vertex.normal, colour });
        Ok(())
    }

    fn face(&mut self, mut face: Face, at: &Place) -> Result<()> {
        if self.sides && face.side != 0.0 {
            if self.both {
                return Ok(());
            }
            face.indices.reverse();
        }
        let error = |message: String| at.error(self.path, message);
        let corners = face
            .indices
            .iter()
            .map(|&i| {
                let vertex = usize::try_from(i).ok().and_then(|i| self.vertices.get(i));
                vertex.ok_or_else(|| {
                    error(format!("vertex {i} does not exist, {} were read before", self.vertices.len()))
                })
            })
            .collect::<Result<Vec<_>>>()?;
        if corners.len() < 3 {
            let place = at.line.map_or(format!("face {}", at.index), |line| format!("line {line}"));
            self.short.get_or_insert((0, place)).0 += 1;
            return Ok(());
        }
        let reflectance = match face.reflectance.given() {
            Some(given) => Some(given),
            None => face
                .colour
                .linear()
                .map_err(error)?
                .filter(|_| self.colours_count())
                .or_else(|| mean(&corners)),
        };
        if let Some(bad) = reflectance.and_then(|rgb| rgb.into_iter().find(|r| !(0.0..=1.0).contains(r))) {
            return Err(error(format!("reflectance {bad} is outside 0..1")));
        }
        let emission = face.emission.given().unwrap_or_default();
        if let Some(bad) = emission.into_iter().find(|&l| !is_radiance(l)) {
            return Err(error(format!("radiance {bad:?} is not a number from 0 to {MOST_RADIANCE:e}")));
        }
        let points: Vec<DVec3> = corners.iter().map(|corner| corner.position).collect();
        let normals: Vec<[f32; 3]> = corners.iter().map(|corner| corner.normal).collect();
        let triangles = triangulate::polygon(&points).ok_or_else(|| error(triangulate::TOO_MANY.into()))?;
        let material = self.material(reflectance, emission);
        if self.options.faces {
            let properties = face.others.into_iter().map(|(name, value)| (name, value.to_string())).collect();
            let part = Part { properties, ..Part::default() };
            let next = self.parts.len() as u32;
            self.builder.face(at.line, *self.parts.entry(part).or_insert(next));
        }
        for triangle in triangles {
            let kept = self.builder.scene.triangles.len();
            self.builder.push_part(&points, triangle, material, None);
            if self.builder.scene.triangles.len() > kept {
                self.normals.push(triangle.map(|i| normals[i]));
            }
        }
        Ok(())
    }

    fn material(&mut self, reflectance: Option<[f64; 3]>, emission: [f64; 3]) -> u32 {
        self.plain += usize::from(reflectance.is_none());
        let key = (reflectance.map(|r| r.map(f64::to_bits)), emission.map(f64::to_bits));
        *self.known.entry(key).or_insert_with(|| {
            let name = reflectance.map_or("(none)".into(), |rgb| {
                let [r, g, b] = tone::Exposure { scale: 1.0 }.encode(rgb);
                format!("#{r:02x}{g:02x}{b:02x}")
            });
            let reflectance = reflectance.unwrap_or_else(|| self.options.default_reflectance());
            self.materials.push(Material::new(&name, reflectance, emission));
            (self.materials.len() - 1) as u32
        })
    }

    fn finish(mut self, header: &Header) -> Result<Scene> {
        let file = self.path.display();
        if self.light {
            self.warnings.push(format!(
                "{file}: colours of vertices show radiosity; they do not count as reflectances"
            ));
        }
        if self.plain > 0 && self.options.reflectance.is_none() {
            let default = self.options.default_in_words();
            self.warnings.push(format!("{file}: {} faces without a reflectance get {default}", self.plain));
        }
        if let Some((count, place)) = self.short {
            self.warnings.push(format!(
                "{file}: {place}: a face with fewer than three vertices is left out ({count} in the file)"
            ));
        }
        if header.comments.iter().any(|c| c.starts_with("TextureFile")) {
            self.warnings.push(format!("{file}: its texture is left out"));
        }
        let mut scene = self.builder.finish();
        if header.elements["vertex"].properties.contains_key("nx") {
            scene.normals = self.normals;
        }
        if scene.triangles.is_empty() {
            return Err(Error::input(self.path, None, "every face has zero area")
                .with_hint("check that the vertices of the faces are at different places"));
        }
        scene.materials = self.materials;
        if self.options.faces {
            let mut parts: Vec<(Part, u32)> = self.parts.into_iter().collect();
            parts.sort_unstable_by_key(|&(_, index)| index);
            scene.parts = parts.into_iter().map(|(part, _)| part).collect();
        }
        scene.warnings = self.warnings.into_sentences();
        scene.files = vec![self.path.to_owned()];
        Ok(scene)
    }
}

/// A vertex that was read, as a corner of faces.
struct Corner {
    position: DVec3,
    normal: [f32; 3],
    colour: Option<[f64; 3]>,
}

/// The mean of the vertices' colours, if all have one.
fn mean(corners: &[&Corner]) -> Option<[f64; 3]> {
    let mut sum = [0.0; 3];
    for corner in corners {
        let colour = corner.colour?;
        (0..3).for_each(|c| sum[c] += colour[c]);
    }
    Some(sum.map(|s| s / corners.len() as f64))
}
