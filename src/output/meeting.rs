//! The places where patches of different sizes meet, so that patches have vertices of neighbours on their edges.

use rayon::prelude::*;

use crate::{
    patch::{
        Cell, Patches,
        edges::{Edges, edge_of},
        restricted::points,
    },
    scene::Scene,
};

/// The front patches at which sizes may change.
#[derive(Debug)]
pub(super) struct Meeting {
    pub(super) edges: Edges,
    mixed: Vec<bool>,
    /// The patches of mixed triangles with their cells, without the inner patches of uniform triangles.
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

    /// Whether a triangle and its neighbours together have patches of several levels.
    pub(super) fn is_mixed(&self, t: usize) -> bool {
        self.mixed[t]
    }
}

/// For each triangle, whether it has patches of several levels, or shares an edge with a triangle of another level.
fn mixed(patches: &Patches, edges: &Edges, triangles: usize) -> Vec<bool> {
    // Per edge, the common level of the triangles that share it, or one of two special values.
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

/// The edge of the triangle that contains a cell's edge from `a` to `b`, if any.
pub(super) fn common_edge(a: [u32; 3], b: [u32; 3]) -> Option<usize> {
    edge_of(std::array::from_fn(|axis| a[axis] + b[axis]))
}
