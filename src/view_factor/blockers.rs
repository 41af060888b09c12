//! What stands between points, in double precision: a bounding volume hierarchy over the polygons as they were given.
//!
//! Points on polygons need no offset here. A polygon whose plane holds an end of a path does not block it, and rounding is 10⁻¹⁶ of
//! the scene, so that gaps of a millionth of it are as open as they are drawn.

use std::collections::HashMap;

use glam::DVec3;

use super::{polygon::Polygon, shaft::Shaft};

/// A point this close to a plane, in unit space, lies in it: some roundings of coordinates up to 1.
const IN_PLANE: f64 = 1e-14;

/// The most polygons of a leaf.
const LEAF: usize = 4;

/// A triangle or parallelogram that blocks from both sides.
pub(super) struct Blocker {
    origin: DVec3,
    normal: DVec3,
    /// What gives a point of the plane in multiples of the two edges at the origin.
    duals: [DVec3; 2],
    pub(super) corners: [DVec3; 4],
    triangle: bool,
    /// The polygons with these corners, which differ in the way they face, are one.
    name: u32,
}

impl Blocker {
    fn new(corners: &[DVec3], triangle: bool, name: u32) -> Blocker {
        let [o, a, last] = [corners[0], corners[1], corners[corners.len() - 1]];
        let (e, f) = (a - o, last - o);
        let across = e.cross(f);
        let normal = across.normalize();
        Blocker {
            origin: o,
            normal,
            duals: [f.cross(normal), normal.cross(e)].map(|d| d / across.length()),
            corners: [o, a, corners[2], last],
            triangle,
            name,
        }
    }

    pub(super) fn corners(&self) -> &[DVec3] {
        &self.corners[..if self.triangle { 3 } else { 4 }]
    }

    fn holds(&self, point: DVec3) -> bool {
        let start = point - self.origin;
        let (a, b) = (start.dot(self.duals[0]), start.dot(self.duals[1]));
        a >= 0.0 && b >= 0.0 && if self.triangle { a + b <= 1.0 } else { a <= 1.0 && b <= 1.0 }
    }

    /// Whether the segment between two points that are not in its plane crosses it.
    fn blocks(&self, from: DVec3, to: DVec3) -> bool {
        let [h, g] = [from, to].map(|p| (p - self.origin).dot(self.normal));
        h * g < 0.0
            && h.abs() > IN_PLANE
            && g.abs() > IN_PLANE
            && self.holds(from + (to - from) * (h / (h - g)))
    }

    /// Where a ray meets it, and whether it meets the side where the corners run counter-clockwise.
    fn met(&self, from: DVec3, direction: DVec3) -> Option<(f64, bool)> {
        let (h, speed) = ((from - self.origin).dot(self.normal), direction.dot(self.normal));
        if h * speed >= 0.0 || h.abs() <= IN_PLANE {
            return None;
        }
        let t = -h / speed;
        self.holds(from + direction * t).then_some((t, h > 0.0))
    }
}

struct Node {
    low: DVec3,
    high: DVec3,
    /// Of a leaf the first blocker, else the second child; the first one follows its parent.
    at: u32,
    /// Blockers of a leaf, else 0.
    count: u32,
}

/// All blockers.
pub(super) struct Blockers {
    nodes: Vec<Node>,
    list: Vec<Blocker>,
    /// Of each polygon given, the name of the blockers at its place.
    names: Vec<u32>,
    /// Of each name, the polygons with its corners: the first that runs as the blocker does, and the first that runs the other way.
    sides: Vec<[Option<u32>; 2]>,
    /// Of each name, all polygons with its corners.
    sources: Vec<Vec<u32>>,
}

impl Blockers {
    /// Of whole polygons, in order of their `source`.
    pub(super) fn new(polygons: &[Polygon]) -> Blockers {
        let mut known: HashMap<Vec<[u64; 3]>, u32> = HashMap::new();
        let (mut list, mut names, mut sides): (Vec<Blocker>, Vec<u32>, Vec<[Option<u32>; 2]>) =
            Default::default();
        let mut normals: Vec<DVec3> = Vec::new();
        let mut sources: Vec<Vec<u32>> = Vec::new();
        for polygon in polygons {
            let next = sides.len() as u32;
            let name = *known.entry(sorted(&polygon.corners)).or_insert(next);
            names.push(name);
            if name == next {
                sides.push([None; 2]);
                sources.push(Vec::new());
                normals.push(polygon.normal);
                let corners = &polygon.corners;
                if is_parallelogram(corners) {
                    list.push(Blocker::new(corners, false, name));
                } else {
                    let triangles = (2..corners.len()).map(|k| [corners[0], corners[k - 1], corners[k]]);
                    list.extend(triangles.map(|t| Blocker::new(&t, true, name)));
                }
            }
            sources[name as usize].push(polygon.source);
            let turned = polygon.normal.dot(normals[name as usize]) < 0.0;
            sides[name as usize][usize::from(turned)].get_or_insert(polygon.source);
        }
        let mut nodes = Vec::new();
        build(&mut list, 0, &mut nodes);
        Blockers { nodes, list, names, sides, sources }
    }

    /// The name of the blockers at the place of a polygon.
    pub(super) fn name(&self, source: u32) -> u32 {
        self.names[source as usize]
    }

    /// The polygon that faces the other way at the same place.
    pub(super) fn reverse(&self, source: u32) -> Option<u32> {
        let sides = self.sides[self.name(source) as usize];
        let mine = usize::from(sides[1] == Some(source));
        if sides[mine] == Some(source) { sides[1 - mine] } else { None }
    }

    /// Whether nothing but blockers of these two names stands between two points.
    pub(super) fn free(&self, from: DVec3, to: DVec3, except: [u32; 2]) -> bool {
        let direction = to - from;
        let mut free = true;
        self.visit(from, direction, 1.0, |blocker, _| {
            free &= except.contains(&blocker.name) || !blocker.blocks(from, to);
            if free { 1.0 } else { -1.0 }
        });
        free
    }

    /// Whether none of these blockers stands between two points.
    pub(super) fn free_of(&self, some: &[u32], from: DVec3, to: DVec3) -> bool {
        !some.iter().any(|&b| self.list[b as usize].blocks(from, to))
    }

    /// Whether what a ray meets first, but for the blockers of a name, is a front. One that is at the same place as a back counts.
    pub(super) fn first(&self, from: DVec3, direction: DVec3, except: u32) -> Option<bool> {
        let mut met: Option<(f64, u32, bool)> = None;
        self.visit(from, direction, f64::INFINITY, |blocker, limit| {
            let found = if blocker.name == except { None } else { blocker.met(from, direction) };
            match found {
                Some((t, front)) if t < limit => {
                    met = Some((t, blocker.name, front));
                    t
                }
                _ => limit,
            }
        });
        met.map(|(_, name, front)| self.sides[name as usize][usize::from(!front)].is_some())
    }

    /// Calls `meet` for the blockers of the leaves that a ray passes before a limit, which it returns anew each time.
    fn visit(
        &self,
        from: DVec3,
        direction: DVec3,
        mut limit: f64,
        mut meet: impl FnMut(&Blocker, f64) -> f64,
    ) {
        let inverse = direction.recip();
        let enters = |node: &Node, limit: f64| {
            let (a, b) = ((node.low - from) * inverse, (node.high - from) * inverse);
            // `min` and `max` leave out what is not a number: a ray in the plane of a side.
            let (near, far) = (a.min(b).max_element(), a.max(b).min_element());
            near.max(0.0) <= far * (1.0 + 4.0 * f64::EPSILON) && near <= limit
        };
        let mut stack = [0u32; 64];
        let mut depth = usize::from(!self.nodes.is_empty());
        while depth > 0 {
            depth -= 1;
            let at = stack[depth];
            let node = &self.nodes[at as usize];
            if !enters(node, limit) {
                continue;
            }
            if node.count == 0 {
                (stack[depth], stack[depth + 1]) = (node.at, at + 1);
                depth += 2;
                continue;
            }
            for blocker in &self.list[node.at as usize..(node.at + node.count) as usize] {
                limit = meet(blocker, limit);
            }
            if limit < 0.0 {
                return;
            }
        }
    }

    /// The polygons whose bounds come as near to those of some corners as this, in order.
    pub(super) fn near(&self, corners: &[DVec3], margin: f64) -> Vec<u32> {
        let none = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let (low, high) = corners.iter().fold(none, |(low, high), p| (low.min(*p), high.max(*p)));
        let (low, high) = (low - margin, high + margin);
        let apart = |from: DVec3, to: DVec3| from.cmpgt(high).any() || to.cmplt(low).any();
        let mut names = Vec::new();
        let mut stack: Vec<u32> = if self.nodes.is_empty() { Vec::new() } else { vec![0] };
        while let Some(at) = stack.pop() {
            let node = &self.nodes[at as usize];
            if apart(node.low, node.high) {
                continue;
            }
            if node.count == 0 {
                stack.extend([node.at, at + 1]);
                continue;
            }
            for blocker in &self.list[node.at as usize..(node.at + node.count) as usize] {
                let bounds =
                    blocker.corners().iter().fold(none, |(low, high), p| (low.min(*p), high.max(*p)));
                if !apart(bounds.0, bounds.1) {
                    names.push(blocker.name);
                }
            }
        }
        names.sort_unstable();
        names.dedup();
        let mut sources: Vec<u32> =
            names.iter().flat_map(|&name| &self.sources[name as usize]).copied().collect();
        sources.sort_unstable();
        sources
    }

    /// Appends the blockers in a shaft but for those of two names, up to `most`. Whether that is all of them.
    pub(super) fn within(&self, shaft: &Shaft, except: [u32; 2], most: usize, found: &mut Vec<u32>) -> bool {
        let mut stack = [0u32; 64];
        let mut depth = usize::from(!self.nodes.is_empty());
        while depth > 0 {
            depth -= 1;
            let at = stack[depth];
            let node = &self.nodes[at as usize];
            if !shaft.may_meet_box(node.low, node.high) {
                continue;
            }
            if node.count == 0 {
                (stack[depth], stack[depth + 1]) = (node.at, at + 1);
                depth += 2;
                continue;
            }
            for k in node.at..node.at + node.count {
                let blocker = &self.list[k as usize];
                if !except.contains(&blocker.name) && shaft.meets(blocker.corners()) {
                    if found.len() == most {
                        return false;
                    }
                    found.push(k);
                }
            }
        }
        true
    }
}

/// The corners in an order that does not depend on where they begin and which way they run.
fn sorted(corners: &[DVec3]) -> Vec<[u64; 3]> {
    // Zeros of both signs are one place.
    let mut bits: Vec<[u64; 3]> =
        corners.iter().map(|p| (*p + DVec3::ZERO).to_array().map(f64::to_bits)).collect();
    bits.sort_unstable();
    bits
}

/// What the corners of a quadrilateral may be off those of a parallelogram by, relative to its diagonal: files round.
const SKEW: f64 = 1e-5;

fn is_parallelogram(corners: &[DVec3]) -> bool {
    matches!(*corners, [p, q, r, s] if (r - q - (s - p)).length() <= SKEW * (r - p).length())
}

/// Sorts the blockers into a hierarchy: halves them at the middle of the axis along which they are spread most.
fn build(list: &mut [Blocker], first: usize, nodes: &mut Vec<Node>) {
    if list.is_empty() {
        return;
    }
    let corners = list.iter().flat_map(Blocker::corners);
    let none = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let (low, high) = corners.fold(none, |(low, high), p| (low.min(*p), high.max(*p)));
    let at = nodes.len();
    // As large as rounding may ask for.
    let margin = DVec3::splat(4.0 * f64::EPSILON);
    nodes.push(Node { low: low - margin, high: high + margin, at: first as u32, count: list.len() as u32 });
    if list.len() <= LEAF {
        return;
    }
    let size = high - low;
    let axis = if size.x >= size.max_element() {
        0
    } else if size.y >= size.max_element() {
        1
    } else {
        2
    };
    let middle = |b: &Blocker| b.corners().iter().map(|p| p[axis]).sum::<f64>() / b.corners().len() as f64;
    let half = list.len() / 2;
    list.select_nth_unstable_by(half, |a, b| middle(a).total_cmp(&middle(b)));
    let (left, right) = list.split_at_mut(half);
    build(left, first, nodes);
    nodes[at].at = nodes.len() as u32;
    nodes[at].count = 0;
    build(right, first + half, nodes);
}
