//! Restricted quadtrees. Two rules hold for neighbouring patches, within a triangle and across shared edges: neighbours
//! differ by one level at most, and smaller neighbours cut at most one of a patch's three edges.
//!
//! The first rule is von Herzen and Barr's ("Accurate Triangulations of Deformed, Intersecting Surfaces", SIGGRAPH 87),
//! the second Bank's ("The Efficient Implementation of Local Mesh Refinement Algorithms", 1983). Both together
//! allow every patch to be drawn as one triangle, or as its two halves.

use rayon::prelude::*;

use super::{
    Cell, MAX_LEVEL,
    edges::{Edges, FINEST},
    quadtree::lattice,
};
use crate::scene::Scene;

/// The corners of all cells, numbered as [`Edges::point`] does, in order.
#[derive(Debug)]
pub(crate) struct Corners(Vec<u64>);

impl Corners {
    pub(crate) fn new(scene: &Scene, edges: &Edges, cells: &[Cell]) -> Corners {
        let corners = |cell: &Cell| points(cell).map(|p| edges.point(scene, cell.triangle as usize, p));
        let mut all: Vec<u64> = cells.par_iter().flat_map_iter(corners).collect();
        all.par_sort_unstable();
        all.dedup();
        Corners(all)
    }

    /// How finely neighbours cut the edges of a cell: 0 not at all, 1 once, 2 more than that. Edge `k` runs from its
    /// corner `k` to the next.
    pub(crate) fn cuts(&self, scene: &Scene, edges: &Edges, cell: &Cell) -> [u8; 3] {
        let p = points(cell);
        let is_corner = |p| self.0.binary_search(&edges.point(scene, cell.triangle as usize, p)).is_ok();
        std::array::from_fn(|k| {
            let (a, b) = (p[k], p[(k + 1) % 3]);
            if cell.level >= MAX_LEVEL || !is_corner(middle(a, b)) {
                0
            } else if cell.level + 1 >= MAX_LEVEL || ![1, 3].iter().any(|&q| is_corner(between(a, b, q))) {
                1
            } else {
                2
            }
        })
    }
}

/// The corners of a cell in units of 1/2^[`FINEST`].
pub(crate) fn points(cell: &Cell) -> [[u32; 3]; 3] {
    lattice(cell.child, cell.level).map(|p| p.map(|x| x << (FINEST - u32::from(cell.level))))
}

/// The middle between two points.
pub(crate) fn middle(a: [u32; 3], b: [u32; 3]) -> [u32; 3] {
    between(a, b, 2)
}

/// The point at `quarters` quarters of the way from `a` to `b`.
fn between(a: [u32; 3], b: [u32; 3], quarters: u32) -> [u32; 3] {
    std::array::from_fn(|axis| ((4 - quarters) * a[axis] + quarters * b[axis]) / 4)
}

/// Cuts cells until both rules hold. Cells come, and stay, in the order of their triangles and quadtrees.
pub(super) fn restrict(scene: &Scene, mut cells: Vec<Cell>) -> Vec<Cell> {
    let edges = Edges::new(scene);
    loop {
        let corners = Corners::new(scene, &edges, &cells);
        let breaks_rules = |cell: &Cell| {
            let cuts = corners.cuts(scene, &edges, cell);
            cuts.contains(&2) || cuts.iter().filter(|&&cut| cut > 0).count() > 1
        };
        let cut: Vec<bool> = cells.par_iter().map(breaks_rules).collect();
        if !cut.contains(&true) {
            return cells;
        }
        cells = split(cells, &cut);
    }
}

/// Replaces each marked cell by its children, except cells of the deepest level.
pub(super) fn split(cells: Vec<Cell>, marked: &[bool]) -> Vec<Cell> {
    let mut all = Vec::with_capacity(cells.len() + 3 * marked.iter().filter(|&&m| m).count());
    for (cell, &marked) in cells.into_iter().zip(marked) {
        if marked && cell.level < MAX_LEVEL {
            let child = |digit| Cell { child: 4 * cell.child + digit, level: cell.level + 1, ..cell };
            all.extend((0..4).map(child));
        } else {
            all.push(cell);
        }
    }
    all
}
