//! Contacts: lines along which another surface touches or crosses a triangle, such as a wall on a floor or a block in a
//! wall.
//!
//! Radiosity jumps at such a line: the floor of a room is dark where the ground outside is bright. A patch on both
//! sides would carry light from one side to the other. So triangles are cut along the line before any other step. The
//! two sides of the line then get separate vertices at the same places. This keeps three things from crossing the line:
//! light at vertices, charts of a lightmap, and the rule for the size of neighbouring patches.
//!
//! `find` finds the lines. `grading` determines the size of the pieces around them. `edges` collects the new vertices
//! on edges of triangles. `pieces` triangulates one triangle. `sides` separates the vertices. If an edge gets a vertex,
//! all triangles with this edge get it, so that no crack opens between neighbours.

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

/// Largest number of lines that triangles are cut along: in a small scene, and per triangle in a large scene. The limit
/// is needed because a line makes about four pieces, and each piece is at least one patch. Lines on large triangles
/// come first, because a patch may be as large as its triangle.
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
    /// Lines without a cut, because there are too many lines or because rounding made the cut fail.
    pub uncut: usize,
}

/// Cuts all triangles that another surface touches or crosses. The triangles keep their order, and the pieces of a
/// triangle take its place.
pub(super) fn cut(scene: &mut Scene) -> (Contacts, Vec<Hidden>) {
    // A joint is a line along an edge. It needs no cut, only separate vertices on its two sides.
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
    let mut done =
        Contacts { lines: surfaces.iter().map(|s| s.lines.len()).sum(), uncut, ..Contacts::default() };
    let (mut left, mut marked) = (HashMap::new(), HashSet::new());
    for ((surface, _, k), pieces) in work.into_iter().zip(pieces) {
        let Some(pieces) = pieces else {
            done.uncut += surface.lines_on(surface.triangles[k]).len();
            continue;
        };
        let (triangles, contacts) = pieces.number(scene);
        done.triangles += 1;
        done.pieces += triangles.len();
        marked.extend(contacts);
        left.insert(surface.triangles[k], triangles);
    }
    marked.extend(joints.iter().flat_map(|joint| edges.parts(scene, joint)));
    let hidden = covered::leave_out(scene, &surfaces, &mut left);
    cutting::replace(scene, &left, &cutting::cuts(scene, edges.into_chains(), Vec::new()));
    sides::part(scene, &marked);
    (done, hidden)
}

/// Drops the lines on the smallest triangles if there are too many lines. Returns the number of dropped lines.
fn limit(scene: &Scene, lines: &mut Vec<Line>) -> usize {
    let all = lines.len();
    let most = MOST_LINES.max((MOST_LINES_EACH * scene.triangles.len() as f64) as usize);
    if all > most {
        lines.sort_by(|a, b| {
            let area = |line: &Line| scene.area(line.triangle as usize);
            area(b).total_cmp(&area(a)).then(a.triangle.cmp(&b.triangle))
        });
        // A triangle keeps all of its lines or none.
        let last = lines[most].triangle;
        let kept = lines[..most].iter().position(|line| line.triangle == last).unwrap_or(most);
        lines.truncate(kept);
        lines.sort_by_key(|line| line.triangle);
    }
    all - lines.len()
}
