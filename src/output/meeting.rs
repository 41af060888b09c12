//! Where patches of different size meet: vertices in the middle of edges, and the patches that are drawn as two halves.
//!
//! A face could take in the vertices on its edges, but trimesh reads no binary PLY whose faces differ in their number of
//! corners, and CloudCompare and three.js leave out those of more than four. In [restricted
//! quadtrees](crate::patch::restricted) a patch has one such vertex at most, and its two halves are triangles. Elsewhere whole
//! triangles of very different size may meet; each patch is one face then, and vertices of others touch its edges.

use rayon::prelude::*;

use crate::{
    patch::{
        Cell, Patches,
        edges::{Edges, edge_of},
        restricted::{Corners, points},
    },
    scene::Scene,
};

/// The front patches at which sizes may differ.
#[derive(Debug)]
pub(super) struct Meeting {
    mixed: Vec<bool>,
    /// Those of mixed triangles, but for the inner ones of uniform triangles: by patch, with their place.
    pub(super) cells: Vec<(usize, Cell)>,
    /// Of these, in restricted quadtrees, those with a vertex of others on an edge, in order, and on which edge it is.
    pub(super) cut: Vec<(usize, usize)>,
}

impl Meeting {
    pub(super) fn new(scene: &Scene, patches: &Patches) -> Meeting {
        let triangles = scene.triangles.len();
        let edges = Edges::new(scene);
        let mixed = mixed(patches, &edges, triangles);
        let at_rim = |cell: &Cell| points(cell).iter().any(|p| p.contains(&0));
        let of_triangle = |t: usize| {
            patches
                .fronts_of(t)
                .map(|i| (i, patches.cell(i)))
                .filter(move |(_, c)| !patches.is_uniform(t) || at_rim(c))
        };
        let cells: Vec<(usize, Cell)> =
            (0..triangles).into_par_iter().filter(|&t| mixed[t]).flat_map_iter(of_triangle).collect();
        if !patches.is_restricted() {
            return Meeting { mixed, cells, cut: Vec::new() };
        }
        let places: Vec<Cell> = cells.iter().map(|&(_, cell)| cell).collect();
        let corners = Corners::new(scene, &edges, &places);
        let cut = cells.par_iter().filter_map(|(i, cell)| {
            let cuts = corners.cuts(scene, &edges, cell);
            Some((*i, cuts.iter().position(|&cut| cut > 0)?))
        });
        Meeting { cut: cut.collect(), mixed, cells }
    }

    /// Whether a triangle, or one that it shares an edge with, has patches of another level than the rest of the two.
    pub(super) fn is_mixed(&self, t: usize) -> bool {
        self.mixed[t]
    }
}

/// Which triangles have patches of several levels, or share an edge with one that has others.
fn mixed(patches: &Patches, edges: &Edges, triangles: usize) -> Vec<bool> {
    // The level that all have who share an edge, as far as they are known.
    const UNKNOWN: u8 = u8::MAX;
    const SEVERAL: u8 = u8::MAX - 1;
    let mut levels = vec![UNKNOWN; 3 * triangles];
    for t in 0..triangles {
        let own = if patches.is_uniform(t) { patches.level(t) } else { SEVERAL };
        for k in 0..3 {
            let level = &mut levels[edges.of(t, k) as usize];
            *level = if *level == UNKNOWN || *level == own { own } else { SEVERAL };
        }
    }
    (0..triangles).map(|t| (0..3).any(|k| levels[edges.of(t, k) as usize] == SEVERAL)).collect()
}

/// The edge of its triangle that a cell's edge is a part of, if any.
pub(super) fn common_edge(a: [u32; 3], b: [u32; 3]) -> Option<usize> {
    edge_of(std::array::from_fn(|axis| a[axis] + b[axis]))
}
