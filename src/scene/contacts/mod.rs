//! Lines along which other surface touches or crosses a triangle: a wall that stands on a floor, a block in a wall.
//!
//! Light jumps at such a line: a room's floor is dark where the ground outside is bright. A patch that lies on both sides would carry the
//! light from one side to the other. So triangles are cut along the line before anything else looks at the scene, and the two
//! sides of the line get vertices of their own, at the same places: neither light of vertices, nor charts of a lightmap,
//! nor the rule for the size of neighbouring patches goes across.
//!
//! `find` finds the lines, `grading` says how large pieces should be around them, `edges` keeps the vertices that edges of
//! triangles get, `pieces` triangulates one triangle, and `sides` parts the vertices. Every triangle whose edge got a vertex
//! gets it too, so that no crack opens between neighbours.

mod covered;
mod edges;
mod find;
mod grading;
mod pieces;
mod sides;

use std::collections::{HashMap, HashSet};

use rayon::prelude::*;
use serde::Serialize;

use super::{Scene, cutting, overlaps::Hidden};
use edges::EdgeVertices;
use find::Line;
use grading::{Grading, Surface};
use pieces::Pieces;

/// Most lines that are cut along in a small scene, and for each triangle of a large one: a line makes about four pieces, and
/// each of these is a patch at least. Lines on large triangles come first, for a patch may be as large as its triangle.
const MOST_LINES: usize = 5_000;
const MOST_LINES_EACH: f64 = 0.125;

/// What was cut where surfaces touch or cross.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct Contacts {
    /// Lines along which triangles were cut.
    pub lines: usize,
    /// Triangles that were cut.
    pub triangles: usize,
    /// The pieces that they became.
    pub pieces: usize,
    /// Lines that were found and left alone, because there are too many or because rounding forbids a cut.
    pub uncut: usize,
}

/// Cuts all triangles that other surface touches or crosses. The triangles keep their order; the pieces of one stand in its
/// place.
pub(super) fn cut(scene: &mut Scene) -> (Contacts, Vec<Hidden>) {
    // Along the joints of tiles there is nothing to cut: the two sides need vertices of their own only.
    let (joints, mut lines): (Vec<Line>, Vec<Line>) =
        find::find(scene).into_iter().partition(|line| line.edge.is_some());
    let uncut = limit(scene, &mut lines);
    if lines.is_empty() && joints.is_empty() {
        return (Contacts { uncut, ..Contacts::default() }, Vec::new());
    }
    let surfaces = grading::surfaces(scene, lines);
    let mut edges = EdgeVertices::default();
    for surface in &surfaces {
        edges.end_lines(scene, surface);
    }
    for joint in &joints {
        edges.end_joint(scene, joint);
    }
    let gradings: Vec<Grading> = surfaces.par_iter().map(|surface| Grading::new(scene, surface)).collect();
    for (surface, grading) in surfaces.iter().zip(&gradings) {
        edges.grade(scene, surface, grading);
    }
    let work: Vec<(&Surface, &Grading, usize)> = surfaces
        .iter()
        .zip(&gradings)
        .flat_map(|(surface, grading)| (0..surface.triangles.len()).map(move |k| (surface, grading, k)))
        .collect();
    let pieces: Vec<Option<Pieces>> = work
        .par_iter()
        .map(|&(surface, grading, k)| Pieces::of(scene, surface, grading, k, &edges))
        .collect();
    let mut told =
        Contacts { lines: surfaces.iter().map(|s| s.lines.len()).sum(), uncut, ..Contacts::default() };
    let (mut left, mut marked) = (HashMap::new(), HashSet::new());
    for ((surface, _, k), pieces) in work.into_iter().zip(pieces) {
        let Some(pieces) = pieces else {
            told.uncut += surface.lines_on(surface.triangles[k]).len();
            continue;
        };
        let (triangles, contacts) = pieces.number(scene);
        told.triangles += 1;
        told.pieces += triangles.len();
        marked.extend(contacts);
        left.insert(surface.triangles[k], triangles);
    }
    marked.extend(joints.iter().flat_map(|joint| edges.parts(scene, joint)));
    let hidden = covered::leave_out(scene, &surfaces, &mut left);
    if !hidden.is_empty() {
        // What is left of a face is no face of the file.
        scene.face_corners.clear();
    }
    cutting::replace(scene, &left, &cutting::cuts(scene, edges.into_chains(), Vec::new()));
    sides::part(scene, &marked);
    (told, hidden)
}

/// Leaves out lines beyond the most, those on the smallest triangles, and tells how many.
fn limit(scene: &Scene, lines: &mut Vec<Line>) -> usize {
    let all = lines.len();
    let most = MOST_LINES.max((MOST_LINES_EACH * scene.triangles.len() as f64) as usize);
    if all > most {
        lines.sort_by(|a, b| {
            let area = |line: &Line| scene.area(line.triangle as usize);
            area(b).total_cmp(&area(a)).then(a.triangle.cmp(&b.triangle))
        });
        // All lines of a triangle or none.
        let last = lines[most].triangle;
        let kept = lines[..most].iter().position(|line| line.triangle == last).unwrap_or(most);
        lines.truncate(kept);
        lines.sort_by_key(|line| line.triangle);
    }
    all - lines.len()
}
