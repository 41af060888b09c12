//! STL meshes, ASCII and binary (3D Systems, *StereoLithography Interface Specification*, 1989).
//!
//! The format has triangles only: no materials, no light and no unit. Each solid of an ASCII file is an object. Normals
//! in the file are ignored: the order of the corners determines the front.

use std::path::Path;

use glam::{DVec3, Vec3};

use super::{LoadOptions, Material, Part, Scene, SceneBuilder, text, warnings::Warnings};
use crate::{Error, Result};

/// Bytes before the number of triangles in a binary file, and bytes per triangle.
const HEADER: usize = 80;
const TRIANGLE: usize = 50;

/// Reads `path`.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read. [`Error::Input`] when its contents cannot be used, with the line of an
/// ASCII file or the number of the triangle in a binary file.
pub(super) fn load(path: &Path, options: &LoadOptions) -> Result<Scene> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    let mut mesh = Mesh { path, options, builder: SceneBuilder::default(), parts: Vec::new(), faces: 0 };
    match binary_triangles(&bytes) {
        Some(triangles) => mesh.read_binary(triangles)?,
        None if bytes.trim_ascii_start().starts_with(b"solid") => mesh.read_ascii(&text::decode(bytes))?,
        None => {
            return Err(Error::input(path, None, "not an STL file").with_hint(
                "an ASCII file begins with `solid`; a binary one of n triangles has 84 + 50 n bytes",
            ));
        }
    }
    mesh.finish()
}

/// The triangles of a binary file; `None` if the file is not binary. Many binary files begin with `solid` too. So the
/// test compares the length of the file with its number of triangles.
fn binary_triangles(bytes: &[u8]) -> Option<&[[u8; TRIANGLE]]> {
    let (count, rest) = bytes.get(HEADER..)?.split_first_chunk::<4>()?;
    let (triangles, left) = rest.as_chunks();
    (triangles.len() == u32::from_le_bytes(*count) as usize && left.is_empty()).then_some(triangles)
}

struct Mesh<'a> {
    path: &'a Path,
    options: &'a LoadOptions,
    builder: SceneBuilder,
    parts: Vec<Part>,
    faces: usize,
}

impl Mesh<'_> {
    fn begin(&mut self, name: &str) {
        let object = (!name.is_empty()).then(|| name.to_owned());
        self.parts.push(Part { object, ..Part::default() });
    }

    fn push(&mut self, corners: [DVec3; 3], line: Option<usize>) {
        if self.options.faces {
            self.builder.face(line, self.parts.len() as u32 - 1);
        }
        self.faces += 1;
        self.builder.push(corners, 0, None);
    }

    fn read_binary(&mut self, triangles: &[[u8; TRIANGLE]]) -> Result<()> {
        self.begin("");
        for (k, triangle) in triangles.iter().enumerate() {
            let number = |at: usize| f32::from_le_bytes([0, 1, 2, 3].map(|b| triangle[at + b]));
            // The corners come after the normal.
            let corners =
                [12, 24, 36].map(|at| Vec3::new(number(at), number(at + 4), number(at + 8)).as_dvec3());
            if !corners.iter().all(|c| c.is_finite()) {
                return Err(Error::input(
                    self.path,
                    None,
                    format!("triangle {k}: a coordinate is not finite"),
                ));
            }
            self.push(corners, None);
        }
        Ok(())
    }

    fn read_ascii(&mut self, text: &str) -> Result<()> {
        let path = self.path;
        let mut corners = Vec::new();
        let mut inside = false;
        let lines = text::physical_lines(text).map(|line| line.split_whitespace().collect::<Vec<_>>());
        for (line, words) in (1..).zip(lines) {
            let error = |message: String| Error::input(path, Some(line), message);
            let is = |k: usize, word: &str| words.get(k).is_some_and(|w| w.eq_ignore_ascii_case(word));
            if words.is_empty() || is(0, "outer") || is(0, "endloop") {
                continue;
            } else if is(0, "solid") {
                if inside {
                    return Err(error("a solid begins before the last one ended with `endsolid`".into()));
                }
                (inside, corners) = (true, Vec::new());
                self.begin(&words[1..].join(" "));
            } else if is(0, "endsolid") {
                inside = false;
            } else if !inside {
                return Err(error(format!("`{}` is outside of a solid", words[0])));
            } else if is(0, "facet") {
                corners.clear();
            } else if is(0, "vertex") {
                let numbers: Vec<f64> = words[1..].iter().filter_map(|word| word.parse().ok()).collect();
                let [x, y, z] = numbers[..] else {
                    return Err(error("a vertex must have three coordinates".into()));
                };
                let corner = DVec3::new(x, y, z);
                if !corner.is_finite() || words.len() != 4 {
                    return Err(error("a coordinate is not a finite number".into()));
                }
                corners.push(corner);
            } else if is(0, "endfacet") {
                let Ok(triangle) = <[DVec3; 3]>::try_from(corners.as_slice()) else {
                    return Err(error(format!("a facet has {} vertices, not three", corners.len())));
                };
                self.push(triangle, Some(line));
            } else {
                return Err(error(format!("`{}` is not understood", words[0])));
            }
        }
        if inside {
            return Err(Error::input(path, None, "the file ends within a solid")
                .with_hint("it was cut short, or lacks its last line, `endsolid`"));
        }
        Ok(())
    }

    fn finish(self) -> Result<Scene> {
        if self.faces == 0 {
            return Err(Error::input(self.path, None, "no triangles"));
        }
        let mut scene = self.builder.finish();
        if scene.triangles.is_empty() {
            return Err(Error::input(self.path, None, "every triangle has zero area"));
        }
        let mut warnings = Warnings::default();
        if self.options.reflectance.is_none() {
            let (file, default) = (self.path.display(), self.options.default_in_words());
            warnings.push(format!("{file}: {} triangles without a reflectance get {default}", self.faces));
        }
        scene.materials = vec![Material::new("(none)", self.options.default_reflectance(), [0.0; 3])];
        if self.options.faces {
            scene.parts = self.parts;
        }
        scene.warnings = warnings.into_sentences();
        scene.files = vec![self.path.to_owned()];
        Ok(scene)
    }
}
