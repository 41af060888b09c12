//! The scene's mesh as an OBJ file, with the texture coordinates of the map or with the scene's own.
//!
//! An OBJ file has one set of texture coordinates, but engines want two: the file's own for the materials, and the
//! coordinates of the map. So there are two files. Their faces and corners are the same in the same order: corner k of
//! face i has the first coordinates in one file and the second in the other.
//!
//! If the scene comes from an OBJ file and nothing was cut away from it, the mesh is written as a copy of that file.
//! Objects, groups, smoothing groups, normals, comments and polygons stay. Texture coordinates and the names of
//! material libraries change, and on further pages also the names of materials. A polygon whose parts lie on different
//! charts is cut into its triangles, in both files. So is a polygon that was cut to make charts smaller; its new
//! vertices come first in the file. Second copies of faces, for their backs, come last. Scenes from other files keep
//! polygons and normals too.

use std::{
    borrow::Cow,
    collections::{BTreeSet, HashMap},
    io::{self, Write},
    ops::Range,
    path::Path,
};

use glam::{DVec2, Vec3};

use super::atlas::{Atlas, NONE};
use crate::scene::{NEW_CORNER, Part, Scene, text};

/// The choice of a mesh's texture coordinates, with the material libraries that the file names.
#[derive(Debug, Clone, Copy)]
pub(super) enum Set<'a> {
    /// The coordinates of the map.
    Map(&'a str),
    /// The coordinates of the scene's file.
    Own(&'a [String]),
}

impl Set<'_> {
    fn libraries(&self) -> Vec<&str> {
        match *self {
            Set::Map(library) => vec![library],
            Set::Own(libraries) => libraries.iter().map(String::as_str).collect(),
        }
    }
}

/// Writes the mesh to `out`.
pub(super) fn write(scene: &Scene, atlas: &Atlas, set: Set, out: &mut dyn Write) -> io::Result<()> {
    let what = match set {
        Set::Map(_) => "texture coordinates address the lightmap, v upwards",
        Set::Own(_) => "the faces and corners of scene.obj with the scene's own texture coordinates",
    };
    writeln!(out, "# radiosity bake: {what}")?;
    for library in set.libraries() {
        writeln!(out, "mtllib {library}")?;
    }
    let mesh = Mesh { scene: atlas.scene(scene), atlas, set };
    let is_obj = |file: &&std::path::PathBuf| file.extension().is_some_and(|e| e.eq_ignore_ascii_case("obj"));
    match scene.files.first().filter(is_obj) {
        Some(source) if !scene.faces.is_empty() && scene.face_corners.len() == scene.triangles.len() => {
            mesh.copy(source, out)
        }
        _ => mesh.write(scene, out),
    }
}

/// The name in scene.mtl of a facet's material on the facet's page. `facets` is the scene of the facets.
pub(super) fn material_name<'a>(facets: &'a Scene, atlas: &Atlas, t: usize) -> Cow<'a, str> {
    let name = facets.material(t).name.as_str();
    match atlas.page[t] {
        0 => name.into(),
        page => format!("{name} page {}", page + 1).into(),
    }
}

struct Mesh<'a> {
    /// The scene of the facets.
    scene: &'a Scene,
    atlas: &'a Atlas,
    set: Set<'a>,
}

/// A face to write: a whole polygon, or a triangle of a polygon that is cut.
struct Outline {
    /// A facet that is part of it; `None` if all of it is without area.
    facet: Option<usize>,
    /// For each corner, the index of the corner of the face, or a new corner ([`NEW_CORNER`]); and the index of its
    /// texture coordinate in the map.
    corners: Vec<(u32, Option<u32>)>,
}

/// A corner of a face: its indices in the file that is written, counted from 1.
#[derive(Debug, Clone, Copy)]
struct Word {
    vertex: i64,
    coordinate: Option<i64>,
    normal: Option<i64>,
}

/// Counts of the elements read so far, to convert the file's indices to those of the written file.
#[derive(Debug, Default)]
struct Words {
    vertices: i64,
    coordinates: i64,
    normals: i64,
    /// Number of new vertices and of new texture coordinates, which come before the file's own.
    new: [usize; 2],
}

impl Words {
    fn count(&mut self, keyword: &str) {
        match keyword {
            "v" => self.vertices += 1,
            "vt" => self.coordinates += 1,
            "vn" => self.normals += 1,
            _ => {}
        }
    }

    /// Parses the corners of a face.
    fn of(&self, rest: &str) -> Vec<Word> {
        let index = |text: Option<&str>, so_far: i64, new: usize| -> Option<i64> {
            let index: i64 = text?.parse().ok()?;
            Some(new as i64 + if index < 0 { so_far + 1 + index } else { index })
        };
        let word = |word: &str| {
            let mut parts = word.split('/');
            let vertex = index(parts.next(), self.vertices, self.new[0]);
            let coordinate = index(parts.next(), self.coordinates, self.new[1]);
            Word { vertex: vertex.unwrap_or(0), coordinate, normal: index(parts.next(), self.normals, 0) }
        };
        text::without_comment(rest).split_whitespace().map(word).collect()
    }
}

/// Vertices and texture coordinates that cutting the triangles added to those of the scene's file.
#[derive(Debug, Default)]
struct New {
    /// New vertices of the scene, ascending.
    vertices: Vec<u32>,
    /// New texture coordinates for the materials, without duplicates.
    coordinates: Vec<DVec2>,
    /// The index in `coordinates` of each new corner, by facet and corner.
    of_corner: HashMap<(usize, usize), usize>,
}

impl New {
    fn of(scene: &Scene) -> New {
        let mut new = New::default();
        let (mut vertices, mut known) = (BTreeSet::new(), HashMap::new());
        for (f, names) in scene.face_corners.iter().enumerate() {
            for k in (0..3).filter(|&k| names[k] & NEW_CORNER != 0) {
                vertices.insert(names[k] & !NEW_CORNER);
                if let Some(uv) = scene.texcoords.get(f).map(|uv| uv[k]) {
                    let next = new.coordinates.len();
                    let index = *known.entry(uv.to_array().map(f64::to_bits)).or_insert(next);
                    if index == next {
                        new.coordinates.push(uv);
                    }
                    new.of_corner.insert((f, k), index);
                }
            }
        }
        new.vertices = vertices.into_iter().collect();
        new
    }

    /// The index of a new vertex in the written file, counted from 1. New vertices come first.
    fn vertex(&self, v: u32) -> i64 {
        self.vertices.partition_point(|&w| w < v) as i64 + 1
    }
}

impl Mesh<'_> {
    /// Writes a copy of the OBJ file that the scene comes from.
    fn copy(&self, source: &Path, out: &mut dyn Write) -> io::Result<()> {
        let of_source = |e: io::Error| io::Error::new(e.kind(), format!("{}: {e}", source.display()));
        let changed = || {
            of_source(io::Error::new(io::ErrorKind::InvalidData, "the file has changed since it was read"))
        };
        let source_text = text::decode(std::fs::read(source).map_err(of_source)?);
        let new = New::of(self.scene);
        let is_map = matches!(self.set, Set::Map(_));
        for &vertex in &new.vertices {
            let v = self.scene.vertices[vertex as usize];
            writeln!(out, "v {} {} {}", v.x, v.y, v.z)?;
        }
        match is_map {
            true => self.coordinates(&self.atlas.coordinates, out)?,
            false => new.coordinates.iter().try_for_each(|uv| writeln!(out, "vt {} {}", uv.x, uv.y))?,
        }
        let mut words = Words { new: [new.vertices.len(), new.coordinates.len()], ..Words::default() };
        let (mut faces, mut used) = (self.faces().peekable(), None);
        let mut seconds = Vec::new();
        for (number, line) in text::lines(&source_text) {
            let (keyword, rest) = text::split_keyword(&line);
            match keyword {
                "mtllib" => {}
                "vt" | "usemtl" if is_map => {}
                "f" | "fo" => {
                    let of_line =
                        |face: &(usize, Range<usize>)| self.scene.faces[face.0].line == Some(number);
                    // The scene leaves out faces with fewer than three corners.
                    let Some((face, facets)) = faces.next_if(of_line) else { continue };
                    let corners = words.of(rest);
                    for outline in self.outlines(face, facets.clone(), corners.len()) {
                        self.face(&outline, (&corners, &new), &mut used, out)?.ok_or_else(changed)?;
                    }
                    if let Some(cut) = &self.atlas.cut {
                        let triangles =
                            cut.facets[facets.clone()].iter().map(|facet| facet.triangle as usize);
                        let copies: BTreeSet<usize> =
                            triangles.flat_map(|t| cut.facets_of(t, true)).collect();
                        if !copies.is_empty() {
                            seconds.push((corners, copies));
                        }
                    }
                }
                // Lines and points lose their texture coordinates, whose indices no longer hold.
                "l" | "p" if is_map || !new.vertices.is_empty() => {
                    let corners = words.of(rest);
                    let bare = corners.iter().map(|corner| corner.vertex.to_string());
                    writeln!(out, "{keyword} {}", bare.collect::<Vec<_>>().join(" "))?;
                }
                _ => {
                    words.count(keyword);
                    writeln!(out, "{line}")?;
                }
            }
            if is_map && keyword == "vt" {
                words.count(keyword);
            }
        }
        for (corners, copies) in seconds {
            for f in copies {
                let outline = self.triangle(f, None);
                self.face(&outline, (&corners, &new), &mut used, out)?.ok_or_else(changed)?;
            }
        }
        if faces.next().is_some() { Err(changed()) } else { Ok(()) }
    }

    /// Writes a face of the file or a triangle of it; `None` if the file has changed since it was read.
    fn face(
        &self,
        outline: &Outline,
        (corners, new): (&[Word], &New),
        used: &mut Option<String>,
        out: &mut dyn Write,
    ) -> io::Result<Option<()>> {
        let is_map = matches!(self.set, Set::Map(_));
        let is_there =
            |&(corner, _): &(u32, Option<u32>)| corner & NEW_CORNER != 0 || (corner as usize) < corners.len();
        if corners.is_empty() || !outline.corners.iter().all(is_there) {
            return Ok(None);
        }
        self.use_material(outline, used, out)?;
        write!(out, "f")?;
        for (k, &(corner, coordinate)) in outline.corners.iter().enumerate() {
            let is_new = corner & NEW_CORNER != 0;
            // A new corner takes the normal of another corner of its face.
            let word = &corners[if is_new { k % corners.len() } else { corner as usize }];
            let vertex = if is_new { new.vertex(corner & !NEW_CORNER) } else { word.vertex };
            let own = match outline.facet.filter(|_| is_new) {
                Some(f) => {
                    new.of_corner.get(&(f, k)).filter(|_| word.coordinate.is_some()).map(|i| *i as i64 + 1)
                }
                None => word.coordinate,
            };
            // Corners without a place in the map use the last coordinate, which exists for this purpose.
            let map = coordinate.map_or(self.atlas.coordinates.len(), |i| i as usize) as i64 + 1;
            let coordinate = if is_map { Some(map) } else { own };
            match (coordinate, word.normal) {
                (Some(vt), Some(normal)) => write!(out, " {vertex}/{vt}/{normal}")?,
                (Some(vt), None) => write!(out, " {vertex}/{vt}")?,
                (None, Some(normal)) => write!(out, " {vertex}//{normal}")?,
                (None, None) => write!(out, " {vertex}")?,
            }
        }
        writeln!(out)?;
        Ok(Some(()))
    }

    /// The index of each of the scene's faces and the range of its facets. Triangles without area have no facet.
    fn faces(&self) -> impl Iterator<Item = (usize, Range<usize>)> {
        let Scene { faces, triangles, .. } = self.scene;
        let firsts = (0..triangles.len()).take_while(|&f| !self.atlas.is_second(f)).count();
        let triangles = &triangles[..firsts];
        let mut start = 0;
        (0..faces.len()).map(move |i| {
            let next = faces.get(i + 1).map_or(u32::MAX, |face| face.first);
            let end = start + triangles[start..].iter().take_while(|t| t.source < next).count();
            (i, std::mem::replace(&mut start, end)..end)
        })
    }

    /// A face of `arity` corners: one polygon if nothing of it was left out and each of its corners has a single texture
    /// coordinate, otherwise triangles.
    fn outlines(&self, face: usize, facets: Range<usize>, arity: usize) -> Vec<Outline> {
        let mut coordinates = vec![None; arity];
        let mut agree = facets.len() + self.scene.degenerates_of(face) + 2 >= arity;
        for f in facets.clone() {
            for (corner, new) in self.scene.face_corners[f].into_iter().zip(self.atlas.corners[f]) {
                match coordinates.get_mut(corner as usize) {
                    Some(known) if self.is_mapped(f) => {
                        agree &= known.replace(new).is_none_or(|old| old == new)
                    }
                    Some(_) => {}
                    // It is a new corner.
                    None => agree = false,
                }
            }
        }
        let any = coordinates.iter().copied().find_map(|coordinate| coordinate);
        if agree {
            let corners = (0..).zip(coordinates).map(|(corner, coordinate)| (corner, coordinate.or(any)));
            let facet = facets.clone().find(|&f| self.is_mapped(f)).or(facets.clone().next());
            return vec![Outline { facet, corners: corners.collect() }];
        }
        facets.map(|f| self.triangle(f, any)).collect()
    }

    fn is_mapped(&self, f: usize) -> bool {
        self.atlas.chart[f] != NONE
    }

    /// A facet as a face of its own. If it has no place in the map, its corners have the coordinate `other`.
    fn triangle(&self, f: usize, other: Option<u32>) -> Outline {
        let corners = self.scene.face_corners[f].into_iter().zip(self.atlas.corners[f]);
        let corners = corners.map(|(corner, new)| (corner, self.is_mapped(f).then_some(new).or(other)));
        Outline { facet: Some(f), corners: corners.collect() }
    }

    fn use_material(
        &self,
        outline: &Outline,
        used: &mut Option<String>,
        out: &mut dyn Write,
    ) -> io::Result<()> {
        // A copy with the file's own texture coordinates keeps the file's own `usemtl` statements.
        let is_there = |f: &usize| {
            matches!(self.set, Set::Own(_)) && !outline.corners.is_empty() && !self.atlas.is_second(*f)
        };
        let Some(f) = outline.facet.filter(|f| !is_there(f)) else { return Ok(()) };
        let name = match self.set {
            Set::Map(_) => material_name(self.scene, self.atlas, f),
            Set::Own(_) => self.scene.material(f).name.as_str().into(),
        };
        if used.as_deref() != Some(&*name) {
            writeln!(out, "usemtl {name}")?;
            *used = Some(name.into_owned());
        }
        Ok(())
    }

    fn coordinates(&self, coordinates: &[DVec2], out: &mut dyn Write) -> io::Result<()> {
        for uv in coordinates {
            writeln!(out, "vt {} {}", uv.x, uv.y)?;
        }
        // The coordinate of faces without a place in the map.
        writeln!(out, "vt 0 0")
    }

    /// Writes the mesh of a scene that is not a copy of an OBJ file, with the scene's objects and groups.
    fn write(&self, whole: &Scene, out: &mut dyn Write) -> io::Result<()> {
        let Scene { vertices, triangles, faces, parts, .. } = self.scene;
        for v in vertices {
            writeln!(out, "v {} {} {}", v.x, v.y, v.z)?;
        }
        let own;
        let (coordinates, corners): (&[DVec2], &[[u32; 3]]) = match self.set {
            Set::Map(_) => (&self.atlas.coordinates, &self.atlas.corners),
            Set::Own(_) => {
                own = own_coordinates(self.scene);
                (&own.0, &own.1)
            }
        };
        self.coordinates(coordinates, out)?;
        let (normals, of_corner) = self.normals(whole);
        for [x, y, z] in &normals {
            writeln!(out, "vn {x} {y} {z}")?;
        }
        let word = |f: usize, k: usize| {
            [triangles[f].vertices[k], corners[f][k], of_corner.get(f).map_or(NONE, |n| n[k])]
        };
        let nothing = Part::default();
        let (mut used, mut part, mut face, mut next) = (None, &nothing, 0, 0);
        while next < triangles.len() {
            let f = next;
            while faces.get(face + 1).is_some_and(|later| later.first <= triangles[f].source) {
                face += 1;
            }
            let here = faces.get(face).and_then(|face| parts.get(face.part as usize)).unwrap_or(&nothing);
            for (keyword, before, now) in [("o", &part.object, &here.object), ("g", &part.group, &here.group)]
            {
                if before != now {
                    writeln!(out, "{keyword} {}", now.as_deref().unwrap_or_default())?;
                }
            }
            part = here;
            self.use_material(&Outline { facet: Some(f), corners: Vec::new() }, &mut used, out)?;
            let polygon = self.polygon(f, face, word);
            next = f + polygon.as_ref().map_or(1, |(facets, _)| *facets);
            let words = polygon.map_or_else(|| (0..3).map(|k| word(f, k)).collect(), |(_, words)| words);
            write!(out, "f")?;
            let has_normals = words.iter().all(|word| word[2] != NONE);
            for [v, vt, vn] in words {
                write!(out, " {}/{}", v + 1, vt + 1)?;
                if has_normals {
                    write!(out, "/{}", vn + 1)?;
                }
            }
            writeln!(out)?;
        }
        Ok(())
    }

    /// The face that begins with facet `f`: the number of its facets, and the vertex, texture coordinate and normal of
    /// each of its corners in order. `None` if the scene has no corners of the face, or if its facets disagree at a
    /// corner.
    fn polygon(
        &self,
        f: usize,
        face: usize,
        word: impl Fn(usize, usize) -> [u32; 3],
    ) -> Option<(usize, Vec<[u32; 3]>)> {
        let Scene { faces, face_corners, triangles, .. } = self.scene;
        if faces.is_empty() || face_corners.len() != triangles.len() || self.atlas.is_second(f) {
            return None;
        }
        let end = faces.get(face + 1).map_or(u32::MAX, |later| later.first);
        let is_of_face = |&f: &usize| triangles[f].source < end && !self.atlas.is_second(f);
        let facets = f..f + (f..triangles.len()).take_while(is_of_face).count();
        // Facets that belong to one polygon share its chart, or have no place in the map.
        let mut corners: Vec<Option<[u32; 3]>> = vec![None; facets.len() + 2];
        for f in facets.clone() {
            for (k, &corner) in face_corners[f].iter().enumerate() {
                let known = corners.get_mut(corner as usize)?;
                if known.replace(word(f, k)).is_some_and(|before| before != word(f, k)) {
                    return None;
                }
            }
        }
        let corners: Option<Vec<[u32; 3]>> = corners.into_iter().collect();
        Some((facets.len(), corners?))
    }

    /// The normals of the scene's file without duplicates, and the indices of the normals of each facet's corners;
    /// [`NONE`] for a corner without one. Both are empty if the file has no normals.
    fn normals(&self, whole: &Scene) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
        let (mut known, mut normals) = (HashMap::new(), Vec::new());
        if whole.normals.is_empty() {
            return (Vec::new(), Vec::new());
        }
        let mut number = |normal: Vec3| {
            let normal = normal.normalize_or_zero();
            if normal == Vec3::ZERO {
                return NONE;
            }
            let normal = normal.to_array();
            *known.entry(normal.map(f32::to_bits)).or_insert_with(|| {
                normals.push(normal);
                normals.len() as u32 - 1
            })
        };
        let of_corner = (0..self.scene.triangles.len())
            .map(|f| {
                let of_triangle = whole.normals[self.atlas.triangle(f)].map(Vec3::from);
                let side = if self.atlas.is_second(f) { -1.0 } else { 1.0 };
                [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|corner| {
                    let at = self.atlas.in_triangle(f, corner);
                    number((0..3).map(|k| side * of_triangle[k] * at[k] as f32).sum())
                })
            })
            .collect();
        (normals, of_corner)
    }
}

/// The scene's own texture coordinates without duplicates, and the indices of each triangle's corners.
fn own_coordinates(scene: &Scene) -> (Vec<DVec2>, Vec<[u32; 3]>) {
    let (mut known, mut coordinates) = (HashMap::new(), Vec::new());
    let mut corner = |uv: DVec2| {
        *known.entry(uv.to_array().map(f64::to_bits)).or_insert_with(|| {
            coordinates.push(uv);
            coordinates.len() as u32 - 1
        })
    };
    let corners = scene.texcoords.iter().map(|uv| uv.map(&mut corner)).collect();
    (coordinates, corners)
}
