//! Cuts patches with vertices of neighbours on their edges into triangles that have these vertices as corners.
//!
//! A single face with more corners would be simpler. But trimesh cannot read a binary PLY file whose faces differ in
//! their number of corners, and CloudCompare and three.js leave out faces with more than four corners.

use glam::DVec3;
use rayon::prelude::*;

/// The vertices of neighbours on the edges of one patch.
pub(super) struct OnEdges {
    pub(super) patch: u32,
    /// For the edge from each corner to the next: its vertices, and their positions along it from 0 to 1, in order.
    pub(super) edges: [Vec<(u32, f64)>; 3],
}

/// A part of a patch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Piece {
    pub(super) patch: u32,
    /// Vertices in the order of the patch's corners.
    pub(super) corners: [u32; 3],
    /// Share of the patch's area.
    pub(super) share: f64,
}

/// The pieces of all patches that are cut.
#[derive(Debug, Clone)]
pub(super) struct Pieces {
    /// The first piece of each patch, in the order of patches.
    first: Vec<Piece>,
    /// The other pieces, in the order of patches.
    others: Vec<Piece>,
}

impl Pieces {
    /// Cuts the patches in `met`, which are in order. `corners` are the vertices of all patches.
    pub(super) fn new(positions: &[DVec3], corners: &[[u32; 3]], met: &[OnEdges]) -> Pieces {
        let of_patch = |met: &OnEdges| {
            let mut pieces = Vec::new();
            let whole = Piece { patch: met.patch, corners: corners[met.patch as usize], share: 1.0 };
            let edges = [0, 1, 2].map(|k| Chain { on: &met.edges[k], span: [0.0, 1.0] });
            bisect(positions, whole, edges, &mut pieces);
            pieces
        };
        let pieces: Vec<Vec<Piece>> = met.par_iter().map(of_patch).collect();
        Pieces {
            first: pieces.iter().map(|pieces| pieces[0]).collect(),
            others: pieces.iter().flat_map(|pieces| &pieces[1..]).copied().collect(),
        }
    }

    /// Number of pieces that are not the first of their patch.
    pub(super) fn others(&self) -> usize {
        self.others.len()
    }

    /// The piece of a face; `None` if the face is a whole patch. The first piece of a patch has the number of the
    /// patch. The others are numbered after all `patches`.
    pub(super) fn get(&self, face: usize, patches: usize) -> Option<&Piece> {
        match face.checked_sub(patches) {
            Some(other) => Some(&self.others[other]),
            None => {
                let at = self.first.binary_search_by_key(&(face as u32), |piece| piece.patch);
                Some(&self.first[at.ok()?])
            }
        }
    }
}

/// The vertices on an edge of a piece. The edge is a part of an edge of the patch.
#[derive(Clone, Copy)]
struct Chain<'a> {
    on: &'a [(u32, f64)],
    /// Positions of the ends of the part along the edge of the patch.
    span: [f64; 2],
}

const NONE: Chain<'static> = Chain { on: &[], span: [0.0, 1.0] };

/// Cuts a triangle until no edge has vertices. Among its edges with vertices, the longest is cut at the vertex nearest
/// to its middle, by a line to the opposite corner. Then both parts are cut in the same way. Every piece has an area,
/// because no cut runs along an edge.
fn bisect(positions: &[DVec3], whole: Piece, edges: [Chain; 3], pieces: &mut Vec<Piece>) {
    let at = |k: usize| positions[whole.corners[k % 3] as usize];
    let length = |k: usize| (at(k + 1) - at(k)).length();
    let longest =
        (0..3).filter(|&k| !edges[k].on.is_empty()).reduce(|j, k| if length(k) > length(j) { k } else { j });
    let Some(k) = longest else { return pieces.push(whole) };
    let (next, last) = ((k + 1) % 3, (k + 2) % 3);
    let Chain { on, span: [start, end] } = edges[k];
    let off = |n: usize| (on[n].1 - 0.5 * (start + end)).abs();
    let nearest = (0..on.len()).reduce(|m, n| if off(n) < off(m) { n } else { m }).expect("it has vertices");
    let (vertex, fraction) = on[nearest];
    let share = (fraction - start) / (end - start);
    // The first part loses the end of edge `k`, and with it the edge that starts there. The second part loses the
    // start.
    let (mut first, mut second) = (whole, whole);
    (first.corners[next], first.share) = (vertex, whole.share * share);
    (second.corners[k], second.share) = (vertex, whole.share * (1.0 - share));
    let (mut of_first, mut of_second) = (edges, edges);
    (of_first[k], of_first[next]) = (Chain { on: &on[..nearest], span: [start, fraction] }, NONE);
    (of_second[k], of_second[last]) = (Chain { on: &on[nearest + 1..], span: [fraction, end] }, NONE);
    bisect(positions, first, of_first, pieces);
    bisect(positions, second, of_second, pieces);
}
