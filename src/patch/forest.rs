//! The quadtrees of all triangles, each stored as its leaves.
//!
//! Most trees are uniform: leaf `k` is child `k` at the tree's level. The leaves of other trees are in a list. A leaf
//! is listed by its first descendant at the level of the smallest leaf, and ends where the next leaf begins
//! (Gargantini, "An Effective Way to Represent Quadtrees", CACM 25, 1982).

use super::{Cell, quadtree};

const NONE: u32 = u32::MAX;

#[derive(Debug, Clone)]
pub(super) struct Forest {
    /// The level of each tree's smallest leaves.
    levels: Vec<u8>,
    /// The number of leaves in all trees before each tree; at the end, the number of all leaves.
    offsets: Vec<u32>,
    /// The leaves of trees that are not uniform.
    listed: Vec<u32>,
    /// Where the leaves of each tree begin in `listed`; [`NONE`] for a uniform tree. Empty when all trees are uniform.
    lists: Vec<u32>,
}

impl Forest {
    /// One uniform tree for each triangle.
    pub(super) fn uniform(levels: Vec<u8>) -> Forest {
        let mut offsets = Vec::with_capacity(levels.len() + 1);
        offsets.push(0);
        for (t, &level) in levels.iter().enumerate() {
            offsets.push(offsets[t] + quadtree::children(level));
        }
        Forest { levels, offsets, listed: Vec::new(), lists: Vec::new() }
    }

    /// The trees with these leaves. Leaves come in the order of triangles and steps; every triangle has at least one.
    pub(super) fn of_leaves(cells: &[Cell]) -> Forest {
        let (mut levels, mut offsets) = (Vec::new(), vec![0]);
        let (mut listed, mut lists) = (Vec::new(), Vec::new());
        for leaves in cells.chunk_by(|a, b| a.triangle == b.triangle) {
            let deepest = leaves.iter().map(|leaf| leaf.level).max().expect("chunks are not empty");
            if leaves.iter().all(|leaf| leaf.level == deepest) {
                lists.push(NONE);
            } else {
                lists.push(listed.len() as u32);
                listed.extend(leaves.iter().map(|leaf| leaf.child << (2 * (deepest - leaf.level))));
            }
            levels.push(deepest);
            offsets.push(offsets[offsets.len() - 1] + leaves.len() as u32);
        }
        if listed.is_empty() {
            lists.clear();
        }
        Forest { levels, offsets, listed, lists }
    }

    pub(super) fn trees(&self) -> usize {
        self.levels.len()
    }

    /// The level of a tree's smallest leaves.
    pub(super) fn level(&self, t: usize) -> u8 {
        self.levels[t]
    }

    /// The number of leaves in all trees before this one.
    #[inline]
    pub(super) fn offset(&self, t: usize) -> u32 {
        self.offsets[t]
    }

    /// Number of leaves of a tree.
    pub(super) fn leaves(&self, t: usize) -> u32 {
        self.offsets[t + 1] - self.offsets[t]
    }

    /// The leaves of a tree that is not uniform.
    #[inline]
    fn list(&self, t: usize) -> Option<&[u32]> {
        match self.lists.get(t) {
            None | Some(&NONE) => None,
            Some(&start) => Some(&self.listed[start as usize..][..self.leaves(t) as usize]),
        }
    }

    /// Whether all leaves of a tree are of one level.
    pub(super) fn is_uniform(&self, t: usize) -> bool {
        self.list(t).is_none()
    }

    /// The leaf that holds this child at the tree's level.
    #[inline]
    fn leaf_of(&self, t: usize, child: u32) -> u32 {
        match self.list(t) {
            None => child,
            Some(list) => list.partition_point(|&first| first <= child) as u32 - 1,
        }
    }

    /// The leaf that holds a point.
    #[inline]
    pub(super) fn leaf_at(&self, t: usize, barycentric: [f32; 3]) -> u32 {
        self.leaf_of(t, quadtree::child_at(barycentric, self.levels[t]))
    }

    /// The cell of a leaf.
    pub(super) fn cell(&self, t: usize, leaf: u32) -> Cell {
        let (triangle, level) = (t as u32, self.levels[t]);
        match self.list(t) {
            None => Cell { triangle, child: leaf, level },
            Some(list) => {
                let up = steps(self.end(t, list, leaf) - list[leaf as usize]);
                Cell { triangle, child: list[leaf as usize] >> (2 * up), level: level - up }
            }
        }
    }

    /// The first child at the tree's level after a leaf.
    fn end(&self, t: usize, list: &[u32], leaf: u32) -> u32 {
        list.get(leaf as usize + 1).copied().unwrap_or(quadtree::children(self.levels[t]))
    }

    /// The leaves that overlap a cell: either the one leaf that contains it, or all leaves inside it.
    pub(super) fn overlapping(&self, cell: &Cell) -> std::ops::Range<u32> {
        let t = cell.triangle as usize;
        let level = self.levels[t];
        let (first, last) = if cell.level >= level {
            let child = cell.child >> (2 * (cell.level - level));
            (child, child)
        } else {
            let down = 2 * (level - cell.level);
            (cell.child << down, ((cell.child + 1) << down) - 1)
        };
        self.leaf_of(t, first)..self.leaf_of(t, last) + 1
    }

    /// Number of leaves in the family that begins with this leaf: all leaves below the highest ancestor whose leaves
    /// are at most `levels` levels below it.
    pub(super) fn family(&self, t: usize, leaf: u32, levels: u8) -> u32 {
        let Some(list) = self.list(t) else { return quadtree::children(levels.min(self.levels[t])) };
        let first = list[leaf as usize];
        let mut span = self.end(t, list, leaf) - first;
        let mut count = 1;
        loop {
            span *= 4;
            if span > quadtree::children(self.levels[t]) || first % span != 0 {
                return count;
            }
            let next = list.partition_point(|&other| other < first + span) as u32;
            let size = |k: u32| self.end(t, list, k) - list[k as usize];
            if (leaf..next).any(|k| size(k) << (2 * levels) < span) {
                return count;
            }
            count = next - leaf;
        }
    }
}

/// The number of quadtree steps that make this number of leaves.
fn steps(children: u32) -> u8 {
    (children.trailing_zeros() / 2) as u8
}
