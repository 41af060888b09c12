//! A bounding volume hierarchy with up to eight children a node, and its traversal.

use std::mem::MaybeUninit;

use glam::Vec3A;
use obvhs::{
    BvhBuildParams,
    aabb::Aabb,
    bvh2::builder::build_bvh2,
    ploc::{PlocSearchDistance, SortPrecision},
};

use super::{
    UnitTriangle,
    collapse::Collapse,
    query::Query,
    watertight::{Met, PreparedRay},
    wide::{Lanes, Stack},
};

/// Most children of a node, and most triangles and vertices of a leaf.
pub(super) const WIDTH: usize = 8;

/// obvhs's presets lower the search distance near the leaves. That degrades on tessellated planar walls, where Morton codes
/// tie; a search distance of 6 at all levels does not. Reinsertion saves rays a sixth of the nodes there.
const BUILD: BvhBuildParams = BvhBuildParams {
    pre_split: false,
    ploc_search_distance: PlocSearchDistance::Low,
    search_depth_threshold: 0,
    reinsertion_batch_ratio: 0.15,
    post_collapse_reinsertion_batch_ratio_multiplier: 1.0,
    sort_precision: SortPrecision::U64,
    max_prims_per_leaf: 1,
    collapse_traversal_cost: 1.0,
};

/// Boxes of up to eight children, one lane each. A lane without a child has a box that no ray hits.
#[repr(C, align(64))]
pub(super) struct Node {
    /// By axis, then low and high.
    pub(super) bounds: [[[f32; WIDTH]; 2]; 3],
    /// Index of a node, or [`IS_LEAF`] and the index of a leaf.
    children: [u32; WIDTH],
}

const IS_LEAF: u32 = 1 << 31;

impl Node {
    pub(super) const EMPTY: Node =
        Node { bounds: [[[f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]]; 3], children: [0; WIDTH] };

    fn set(&mut self, lane: usize, aabb: &Aabb, child: u32) {
        for axis in 0..3 {
            self.bounds[axis][0][lane] = aabb.min[axis];
            self.bounds[axis][1][lane] = aabb.max[axis];
        }
        self.children[lane] = child;
    }
}

/// Up to eight triangles with up to eight vertices, in two cache lines. A vertex is sheared once for all its triangles. A lane
/// without a triangle has all corners in one vertex, where the edge functions are exactly zero.
#[repr(C, align(64))]
pub(super) struct Leaf {
    /// By axis, one lane for each vertex.
    pub(super) vertices: [[f32; WIDTH]; 3],
    /// Index of the vertex, by corner, one lane for each triangle.
    pub(super) corners: [[u8; WIDTH]; 3],
}

impl Leaf {
    /// A leaf of triangles whose vertices are few enough for [`share_vertices`].
    ///
    /// # Panics
    /// When they are too many.
    pub(super) fn new(members: &[u32], triangles: &[UnitTriangle]) -> Leaf {
        let (vertices, corners) = share_vertices(members, triangles).expect("the triangles fit into a leaf");
        Leaf { vertices: [0, 1, 2].map(|axis| vertices.map(|v| v[axis])), corners }
    }

    /// The first corner of the triangle in a lane.
    #[inline(always)]
    fn first_corner(&self, lane: usize) -> Vec3A {
        let corner = self.corners[0][lane] as usize % WIDTH;
        let [x, y, z] = &self.vertices;
        Vec3A::new(x[corner], y[corner], z[corner])
    }
}

/// The different vertices of triangles, and for every corner its index among them. `None` if there are too many.
pub(super) fn share_vertices(
    members: &[u32],
    triangles: &[UnitTriangle],
) -> Option<([Vec3A; WIDTH], [[u8; WIDTH]; 3])> {
    if members.len() > WIDTH {
        return None;
    }
    let mut vertices = [Vec3A::ZERO; WIDTH];
    let mut corners = [[0; WIDTH]; 3];
    let mut count = 0;
    for (lane, &t) in members.iter().enumerate() {
        for (corner, &position) in triangles[t as usize].corners.iter().enumerate() {
            let vertex = vertices[..count].iter().position(|&v| v == position).unwrap_or(count);
            *vertices.get_mut(vertex)? = position;
            count = count.max(vertex + 1);
            corners[corner][lane] = vertex as u8;
        }
    }
    Some((vertices, corners))
}

/// Data that only hits need.
#[derive(Clone, Copy, Default)]
struct Facet {
    /// Unit normal of the front, from the corners before rounding. The rounded corners lie in its plane up to their rounding.
    normal: [f32; 3],
    /// The scene's index.
    triangle: u32,
}

/// One lane for each triangle. Apart from the leaf but at the same index, so that memory delivers both at once.
#[derive(Clone, Copy, Default)]
#[repr(C, align(64))]
struct Facets([Facet; WIDTH]);

/// The hierarchy over the triangles of a scene.
pub(super) struct Bvh {
    /// In the order of the scene.
    pub(super) triangles: Vec<UnitTriangle>,
    /// The root first.
    nodes: Vec<Node>,
    leaves: Vec<Leaf>,
    /// For every leaf.
    facets: Vec<Facets>,
    /// Largest number of entries on the stack of a ray.
    stack: usize,
}

/// The state of a ray.
pub(super) struct Way<'a> {
    stack: Stack<'a>,
    /// The next node or leaf.
    at: u32,
    /// Distance beyond which hits do not matter.
    limit: f32,
}

impl<'a> Way<'a> {
    /// Starts at the root. `room` must hold the entries that the hierarchy's stack needs.
    #[inline(always)]
    pub(super) fn begin<Q: Query>(room: &'a mut [MaybeUninit<u64>], ray: &PreparedRay) -> Self {
        let mut way = Way { stack: Stack::new(room), at: 0, limit: 0.0 };
        way.begin_anew::<Q>(ray);
        way
    }

    /// Returns to the root for another ray.
    #[inline(always)]
    pub(super) fn begin_anew<Q: Query>(&mut self, ray: &PreparedRay) {
        // A negative limit makes an improper ray hit nothing.
        (self.at, self.limit) = (0, if ray.is_proper() { Q::LIMIT } else { -1.0 });
    }
}

/// Entries of a ray's stack without allocation: enough for millions of triangles in ordinary scenes.
pub(super) const STACK: usize = 96;

impl Bvh {
    /// Builds the hierarchy over the triangles in `kept`.
    pub(super) fn new(triangles: Vec<UnitTriangle>, kept: &[u32]) -> Bvh {
        // Along each axis the watertight test rounds by the size of the triangle and by its distance. The box is larger
        // by the first: 4 ulp of the triangle's coordinates on this axis. The test of boxes allows for the second
        // (`SLACK`). A ray that leaves a wall across an axis starts 7 ulp above it (`Side`), so outside the wall's box.
        let padded = |t: &UnitTriangle| {
            let ([a, b, c], padding) = (t.corners, t.reach * (4.0 * f32::EPSILON));
            Aabb::new(a.min(b).min(c) - padding, a.max(b).max(c) + padding)
        };
        let boxes: Vec<Aabb> = kept.iter().map(|&t| padded(&triangles[t as usize])).collect();
        let mut binary = build_bvh2(&boxes, BUILD, &mut Default::default());
        binary.primitive_indices.iter_mut().for_each(|index| *index = kept[*index as usize]);
        let mut bvh = Bvh {
            triangles: Vec::new(),
            nodes: vec![Node::EMPTY],
            leaves: Vec::new(),
            facets: Vec::new(),
            stack: 1,
        };
        if binary.nodes.is_empty() {
            return Bvh { triangles, ..bvh };
        }
        let collapse = Collapse::new(&binary, &triangles);
        // Nodes yet to fill: the binary node of each, its index, and the height of the stack when a ray visits it.
        let mut open = vec![(0, 0, 0)];
        while let Some((from, to, above)) = open.pop() {
            let children = collapse.gather(from);
            let held = above + children.len() - 1;
            bvh.stack = bvh.stack.max(held + 1);
            for (lane, &child) in children.iter().enumerate() {
                let index = if let Some(members) = collapse.leaf(child) {
                    bvh.push_leaf(&members, &triangles)
                } else {
                    bvh.nodes.push(Node::EMPTY);
                    open.push((child, bvh.nodes.len() - 1, held));
                    (bvh.nodes.len() - 1) as u32
                };
                bvh.nodes[to].set(lane, binary.nodes[child].aabb(), index);
            }
        }
        Bvh { triangles, ..bvh }
    }

    fn push_leaf(&mut self, members: &[u32], triangles: &[UnitTriangle]) -> u32 {
        self.leaves.push(Leaf::new(members, triangles));
        let mut facets = Facets::default();
        for (facet, &triangle) in facets.0.iter_mut().zip(members) {
            *facet = Facet { normal: triangles[triangle as usize].normal.to_array(), triangle };
        }
        self.facets.push(facets);
        IS_LEAF | (self.leaves.len() - 1) as u32
    }

    /// Bytes that rays read.
    pub(super) fn bytes(&self) -> usize {
        size_of_val(&self.nodes[..]) + size_of_val(&self.leaves[..]) + size_of_val(&self.facets[..])
    }

    /// Entries that the stack of a ray needs.
    pub(super) fn stack(&self) -> usize {
        self.stack
    }

    /// Casts one ray.
    #[inline(always)]
    pub(super) fn ask<L: Lanes, Q: Query>(&self, lanes: L, ray: &PreparedRay) -> Q::Answer {
        // Not initialised: setting it to zero would take as long as a node.
        let mut fixed = [MaybeUninit::uninit(); STACK];
        let mut large = Vec::new();
        let mut room = &mut fixed[..];
        if self.stack > STACK {
            large.resize(self.stack, MaybeUninit::uninit());
            room = &mut large;
        }
        let (mut query, mut way) = (Q::default(), Way::begin::<Q>(room, ray));
        while self.step(lanes, ray, &mut way, &mut query) {}
        query.answer(|met| self.rounding(ray, met))
    }

    /// A bound of the rounding of a hit's distance. Only rays that graze an outline need it.
    #[cold]
    pub(super) fn rounding(&self, ray: &PreparedRay, met: &Met) -> f32 {
        let triangle = &self.triangles[met.triangle as usize];
        met.rounding(ray.reach(triangle.corners[0], triangle.normal))
    }

    /// Visits the next node or leaf of a ray, gives `query` the hits there, and finds the next one after it, near boxes first.
    /// Leaves out boxes beyond the limit of the query. Returns whether there is a next one.
    #[inline(always)]
    pub(super) fn step<L: Lanes, Q: Query>(
        &self,
        lanes: L,
        ray: &PreparedRay,
        way: &mut Way,
        query: &mut Q,
    ) -> bool {
        if way.at & IS_LEAF != 0 {
            let index = (way.at & !IS_LEAF) as usize;
            let leaf = &self.leaves[index];
            let (mut inside, edges) = lanes.edges(leaf, ray);
            while inside != 0 {
                let lane = take_lane(&mut inside);
                let facet = &self.facets[index].0[lane];
                let edges = [edges[0][lane], edges[1][lane], edges[2][lane]];
                let plane = (leaf.first_corner(lane), facet.normal.into());
                if let Some(met) = ray.meet(facet.triangle, plane, edges) {
                    way.limit = query.meet(met);
                }
            }
        } else {
            let node = &self.nodes[way.at as usize];
            let (entered, entries) = lanes.boxes(node, ray, way.limit);
            if entered != 0 {
                way.at = self.nearest_child(lanes, node, entered, &entries, &mut way.stack);
                return true;
            }
        }
        loop {
            match way.stack.pop() {
                Some(top) if f32::from_bits((top >> 32) as u32) <= way.limit => {
                    way.at = top as u32;
                    return true;
                }
                Some(_) => {}
                None => return false,
            }
        }
    }

    /// The nearest child; the others go to the stack, near ones on top.
    #[inline(always)]
    fn nearest_child<L: Lanes>(
        &self,
        lanes: L,
        node: &Node,
        mut entered: u32,
        entries: &[f32; WIDTH],
        stack: &mut Stack,
    ) -> u32 {
        // Distances are not negative, so that their bits have the same order. The index decides between equal distances.
        let mut next = || {
            let lane = take_lane(&mut entered);
            let child = node.children[lane];
            if child & IS_LEAF != 0 {
                let leaf = (child & !IS_LEAF) as usize;
                lanes.prefetch(&self.leaves, leaf);
                lanes.prefetch(&self.facets, leaf);
            } else {
                lanes.prefetch(&self.nodes, child as usize);
            }
            (u64::from(entries[lane].to_bits()) << 32 | u64::from(child), entered != 0)
        };
        let (mut nearest, mut more) = next();
        let below = stack.height();
        while more {
            let other;
            (other, more) = next();
            stack.insert(below, nearest.max(other));
            nearest = nearest.min(other);
        }
        nearest as u32
    }
}

/// Removes the lowest lane of a mask that is not zero, and returns it.
#[inline(always)]
fn take_lane(mask: &mut u32) -> usize {
    let lane = mask.trailing_zeros() as usize % WIDTH;
    *mask &= *mask - 1;
    lane
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, vec3a};

    use super::*;
    use crate::trace::wide::{Portable, tests::tracer};

    /// Rays that leave a wall across an axis do not enter the wall's own box, also if the wall is near the origin and
    /// other surface is far away. Otherwise each ray would test the surface that it leaves.
    #[test]
    fn rays_start_outside_the_box_of_their_wall() {
        for at in [1e-3, 0.1, 0.6, 1.0] {
            let wall =
                |x: f64| ([DVec3::new(x, -1.0, -1.0), DVec3::new(x, 1.0, -1.0), DVec3::new(x, 1.0, 1.0)], 0);
            // The two walls are alike, so the origin of unit space is between them.
            let tracer = tracer(&[wall(-at), wall(at)]);
            for t in &tracer.bvh.triangles {
                let origin = t.side(true).leave(t.point([0.2, 0.3, 0.5]));
                let ray = PreparedRay::new(origin, t.normal);
                assert_eq!(
                    Portable.boxes(&tracer.bvh.nodes[0], &ray, f32::INFINITY).0,
                    u32::from(t.corners[0].x < 0.0),
                    "{at}"
                );
                let ray = PreparedRay::new(origin, t.normal + vec3a(0.0, 3.0, -7.0));
                assert_eq!(Portable.boxes(&tracer.bvh.nodes[0], &ray, 1e-3).0, 0, "{at}");
            }
        }
    }
}
