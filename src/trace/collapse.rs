//! Chooses the nodes of a binary hierarchy that become nodes of a wide one.
//!
//! Ylitie, Karras and Laine, "Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs", HPG 2017,
//! section 3: dynamic programming finds the collapse of least cost under the surface area heuristic.

use obvhs::bvh2::Bvh2;

use super::{
    UnitTriangle,
    bvh::{WIDTH, share_vertices},
};

/// Cost of a leaf relative to a node. Both test all lanes, even if few are in use.
const LEAF_COST: f32 = 1.0;

/// The cheapest collapse of every subtree.
pub(super) struct Collapse<'a> {
    binary: &'a Bvh2,
    triangles: &'a [UnitTriangle],
    /// Cost of a binary node's triangles as a forest of at most 1, 2, ... trees.
    forests: Vec<[f32; WIDTH - 1]>,
    /// Whether the triangles of a node fit into a leaf.
    fits: Vec<bool>,
}

impl<'a> Collapse<'a> {
    /// The cheapest collapses of a hierarchy with one triangle in each leaf.
    pub(super) fn new(binary: &'a Bvh2, triangles: &'a [UnitTriangle]) -> Self {
        let n = binary.nodes.len();
        let mut collapse =
            Collapse { binary, triangles, forests: vec![[0.0; WIDTH - 1]; n], fits: vec![true; n] };
        let mut order = Vec::with_capacity(n);
        let mut open = vec![0];
        while let Some(node) = open.pop() {
            order.push(node);
            if let Some([a, b]) = collapse.children(node) {
                open.extend([a, b]);
            }
        }
        for &node in order.iter().rev() {
            collapse.price(node);
        }
        collapse
    }

    fn children(&self, node: usize) -> Option<[usize; 2]> {
        let n = &self.binary.nodes[node];
        (!n.is_leaf()).then(|| [n.first_index as usize, n.first_index as usize + 1])
    }

    fn price(&mut self, node: usize) {
        let area = self.binary.nodes[node].aabb().half_area();
        let Some([a, b]) = self.children(node) else {
            self.forests[node] = [area * LEAF_COST; WIDTH - 1];
            return;
        };
        self.fits[node] =
            self.fits[a] && self.fits[b] && share_vertices(&self.below(node), self.triangles).is_some();
        let mut cost = self.split(a, b, WIDTH).0 + area;
        if self.fits[node] {
            cost = cost.min(area * LEAF_COST);
        }
        self.forests[node][0] = cost;
        for trees in 2..WIDTH {
            cost = cost.min(self.split(a, b, trees).0);
            self.forests[node][trees - 1] = cost;
        }
    }

    /// The least cost of two subtrees as `trees` trees together, and the number of trees of the first.
    fn split(&self, a: usize, b: usize, trees: usize) -> (f32, usize) {
        (1..trees)
            .map(|of_a| (self.forests[a][of_a - 1] + self.forests[b][trees - of_a - 1], of_a))
            .min_by(|x, y| x.0.total_cmp(&y.0))
            .expect("at least two trees")
    }

    /// The triangles below a binary node.
    fn below(&self, node: usize) -> Vec<u32> {
        let mut triangles = Vec::with_capacity(2 * WIDTH);
        let mut open = vec![node];
        while let Some(node) = open.pop() {
            match self.children(node) {
                Some([a, b]) => open.extend([b, a]),
                None => triangles
                    .push(self.binary.primitive_indices[self.binary.nodes[node].first_index as usize]),
            }
        }
        triangles
    }

    /// The triangles of a binary node that becomes a leaf; `None` if it becomes a node.
    pub(super) fn leaf(&self, node: usize) -> Option<Vec<u32>> {
        let cheap = self.forests[node][0] >= self.binary.nodes[node].aabb().half_area() * LEAF_COST;
        (self.fits[node] && cheap).then(|| self.below(node))
    }

    /// The binary nodes that become the children of a wide node.
    pub(super) fn gather(&self, node: usize) -> Vec<usize> {
        let mut gathered = Vec::with_capacity(WIDTH);
        match self.children(node) {
            Some([a, b]) => self.halve(a, b, WIDTH, &mut gathered),
            None => gathered.push(node),
        }
        gathered
    }

    fn halve(&self, a: usize, b: usize, trees: usize, gathered: &mut Vec<usize>) {
        let of_a = self.split(a, b, trees).1;
        self.spread(a, of_a, gathered);
        self.spread(b, trees - of_a, gathered);
    }

    fn spread(&self, node: usize, trees: usize, gathered: &mut Vec<usize>) {
        let costs = &self.forests[node];
        // The smallest number of trees with this cost.
        let trees = (1..trees).find(|&fewer| costs[fewer - 1] == costs[trees - 1]).unwrap_or(trees);
        match self.children(node) {
            Some([a, b]) if trees > 1 => self.halve(a, b, trees, gathered),
            _ => gathered.push(node),
        }
    }
}
