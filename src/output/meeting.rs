//! Where patches of different size meet: vertices in the middle of edges, and the faces that take them in.
//!
//! Viewers such as CloudCompare and three.js leave out faces of more than four corners. A face therefore takes in one vertex
//! on its edges, as [restricted quadtrees](crate::patch::restricted) ask for, and no more: whole triangles of very
//! different size may meet otherwise, and then vertices touch the edges of faces that do not have them.

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
    /// Of these, those with one vertex of others on their edges, in order, and on which edge it is.
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
        let places: Vec<Cell> = cells.iter().map(|&(_, cell)| cell).collect();
        let corners = Corners::new(scene, &edges, &places);
        let cut = cells.par_iter().filter_map(|(i, cell)| {
            let cuts = corners.cuts(scene, &edges, cell);
            let only = (0..3).find(|&k| cuts[k] == 1)?;
            (cuts.iter().sum::<u8>() == 1).then_some((*i, only))
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

/// The middle between two points.
pub(super) fn middle(a: [u32; 3], b: [u32; 3]) -> [u32; 3] {
    std::array::from_fn(|axis| (a[axis] + b[axis]) / 2)
}

/// The edge of its triangle that a cell's edge is a part of, if any.
pub(super) fn common_edge(a: [u32; 3], b: [u32; 3]) -> Option<usize> {
    edge_of(std::array::from_fn(|axis| a[axis] + b[axis]))
}
