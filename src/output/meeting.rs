//! Where patches of different size meet: the triangles whose patches have vertices of neighbours on their edges.

use rayon::prelude::*;

use crate::{
    patch::{
        Cell, Patches,
        edges::{Edges, edge_of},
        restricted::points,
    },
    scene::Scene,
};

/// The front patches at which sizes may differ.
#[derive(Debug)]
pub(super) struct Meeting {
    pub(super) edges: Edges,
    mixed: Vec<bool>,
    /// The patches of mixed triangles with their places, without the inner patches of uniform triangles.
    pub(super) cells: Vec<(usize, Cell)>,
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
        let cells = (0..triangles).into_par_iter().filter(|&t| mixed[t]).flat_map_iter(of_triangle).collect();
        Meeting { edges, mixed, cells }
    }

    /// Whether a triangle and its neighbours have patches of several levels.
    pub(super) fn is_mixed(&self, t: usize) -> bool {
        self.mixed[t]
    }
}

/// Which triangles have patches of several levels, or share an edge with a triangle of another level.
fn mixed(patches: &Patches, edges: &Edges, triangles: usize) -> Vec<bool> {
    // The level of all triangles that share an edge.
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
