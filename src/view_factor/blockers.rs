//! Blockers between points, in double precision: a bounding volume hierarchy over the given polygons.
//!
//! Points on polygons need no offset. A polygon does not block a path with an end in its plane. Rounding is 10⁻¹⁶ of
//! the scene, so that gaps of a millionth of it stay open.

use std::{cell::Cell, collections::HashMap};

use glam::DVec3;

use super::{
    join::{STRAIGHT, Shape, join},
    polygon::Polygon,
    shaft::Shaft,
};

/// A point this close to a plane, in unit space, lies in it: some roundings of coordinates up to 1.
pub(super) const IN_PLANE: f64 = 1e-14;

/// Most blockers of a leaf.
const LEAF: usize = 4;

/// A triangle or parallelogram that blocks from both sides.
pub(super) struct Blocker {
    origin: DVec3,
    normal: DVec3,
    /// Dual vectors, which give the coordinates of a point in multiples of the two edges at the origin.
    duals: [DVec3; 2],
    pub(super) corners: [DVec3; 4],
    triangle: bool,
    /// The name of its polygons. Polygons with the same corners share a name, whichever way they face, and so do joined polygons.
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

    /// Distance at which a ray meets it, and whether it meets the side where the corners run counterclockwise.
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
    /// For a leaf the first blocker, otherwise the second child. The first child follows its parent.
    at: u32,
    /// Number of blockers of a leaf; 0 for other nodes.
    count: u32,
    /// The axis along which the first child lies before the second.
    axis: usize,
}

/// The places of polygons, before they become blockers: one for all polygons with the same corners.
struct Places {
    names: Vec<u32>,
    shapes: Vec<Shape>,
    sides: Vec<[Option<u32>; 2]>,
    sources: Vec<Vec<u32>>,
}

impl Places {
    fn new(polygons: &[Polygon], obstacles: &[Polygon]) -> Places {
        let mut known: HashMap<Vec<[u64; 3]>, u32> = HashMap::new();
        let mut places =
            Places { names: Vec::new(), shapes: Vec::new(), sides: Vec::new(), sources: Vec::new() };
        let Places { names, shapes, sides, sources } = &mut places;
        for (polygon, is_seen) in
            polygons.iter().map(|p| (p, true)).chain(obstacles.iter().map(|p| (p, false)))
        {
            let next = sides.len() as u32;
            let name = *known.entry(sorted(&polygon.corners)).or_insert(next);
            names.push(name);
            if name == next {
                sides.push([None; 2]);
                sources.push(Vec::new());
                let (corners, normal) = (polygon.corners.clone(), polygon.normal);
                shapes.push(Shape { corners, normal, kind: 0, members: vec![name] });
            }
            if !is_seen {
                continue;
            }
            sources[name as usize].push(polygon.source);
            let turned = polygon.normal.dot(shapes[name as usize].normal) < 0.0;
            sides[name as usize][usize::from(turned)].get_or_insert(polygon.source);
        }
        places
    }

    /// Joins places in one plane that are seen from one side, and obstacles. Sheets with two sides stay as they are.
    fn joined(mut self) -> Places {
        for (shape, sides) in self.shapes.iter_mut().zip(&self.sides) {
            shape.kind = sides.iter().flatten().count() as u32;
        }
        let (sheets, others) = self.shapes.into_iter().partition(|shape| shape.kind == 2);
        let mut shapes = join(others);
        shapes.extend::<Vec<Shape>>(sheets);
        let mut new = vec![0; self.sides.len()];
        let mut sources = vec![Vec::new(); shapes.len()];
        for (name, shape) in shapes.iter().enumerate() {
            for &member in &shape.members {
                new[member as usize] = name as u32;
                sources[name].append(&mut self.sources[member as usize]);
            }
        }
        let sides = shapes.iter().map(|shape| self.sides[shape.members[0] as usize]).collect();
        let names = self.names.iter().map(|&name| new[name as usize]).collect();
        Places { names, shapes, sides, sources }
    }
}

/// All blockers.
pub(super) struct Blockers {
    nodes: Vec<Node>,
    list: Vec<Blocker>,
    /// For each given polygon, the name of its blockers.
    names: Vec<u32>,
    /// For each name, the first of its polygons that faces like the blocker, and the first that faces the other way.
    sides: Vec<[Option<u32>; 2]>,
    /// For each name, its polygons.
    sources: Vec<Vec<u32>>,
}

impl Blockers {
    /// Builds the hierarchy from whole polygons, in the order of their `source`, and from obstacles, which have no
    /// visible side.
    pub(super) fn new(polygons: &[Polygon], obstacles: &[Polygon]) -> Blockers {
        Blockers::of(Places::new(polygons, obstacles))
    }

    /// The same with adjoining polygons joined that lie in one plane and face the same way. There, polygons with the
    /// same corners are not found by [`Blockers::reverse`] any more.
    pub(super) fn joined(polygons: &[Polygon], obstacles: &[Polygon]) -> Blockers {
        Blockers::of(Places::new(polygons, obstacles).joined())
    }

    fn of(Places { names, shapes, sides, sources }: Places) -> Blockers {
        let mut list = Vec::new();
        for (name, Shape { corners, .. }) in (0..).zip(&shapes) {
            if is_parallelogram(corners) {
                list.push(Blocker::new(corners, false, name));
            } else {
                let triangles = (2..corners.len()).map(|k| [corners[0], corners[k - 1], corners[k]]);
                // Three corners may be in line.
                let has_area = |t: &[DVec3; 3]| {
                    let (e, f) = (t[1] - t[0], t[2] - t[0]);
                    e.cross(f).length() > STRAIGHT * e.length() * f.length()
                };
                list.extend(triangles.filter(has_area).map(|t| Blocker::new(&t, true, name)));
            }
        }
        let mut nodes = Vec::new();
        build(&mut list, 0, &mut nodes);
        Blockers { nodes, list, names, sides, sources }
    }

    /// The name of a polygon's blockers.
    pub(super) fn name(&self, source: u32) -> u32 {
        self.names[source as usize]
    }

    /// The polygon that faces the other way at the same place.
    pub(super) fn reverse(&self, source: u32) -> Option<u32> {
        let sides = self.sides[self.name(source) as usize];
        let mine = usize::from(sides[1] == Some(source));
        if sides[mine] == Some(source) { sides[1 - mine] } else { None }
    }

    /// Whether no blockers except those of two names are between two points. `last` is the blocker that was found last.
    /// It often blocks the next path as well and is tested first.
    fn free(&self, from: DVec3, to: DVec3, except: [u32; 2], last: &Cell<u32>) -> bool {
        let blocks = |blocker: &Blocker| !except.contains(&blocker.name) && blocker.blocks(from, to);
        if self.list.get(last.get() as usize).is_some_and(blocks) {
            return false;
        }
        let ray = Ray::new(from, to - from);
        self.walk(
            &ray,
            |node| ray.enters(node, 1.0),
            |first, blockers| match blockers.iter().position(blocks) {
                Some(k) => {
                    last.set((first + k) as u32);
                    false
                }
                None => true,
            },
        )
    }

    /// All blockers.
    pub(super) fn all(&self) -> Near<'_> {
        Near { all: self, few: None }
    }

    /// The blockers whose bounds `may_meet` some hull. All of them if these are more than `most`.
    pub(super) fn near_hull(&self, may_meet: impl Fn(DVec3, DVec3) -> bool, most: usize) -> Near<'_> {
        let mut few = Vec::new();
        let is_complete = self.walk(
            &Ray::NONE,
            |node| may_meet(node.low, node.high),
            |first, blockers| {
                for (k, blocker) in (first as u32..).zip(blockers) {
                    let (low, high) = bounds(blocker.corners());
                    if may_meet(low, high) {
                        few.push(k);
                    }
                }
                few.len() <= most
            },
        );
        Near { all: self, few: is_complete.then_some(few) }
    }

    /// Whether a blocker is between all points of two convex polygons. It is if it is between all of their corners: where a path
    /// crosses its plane is a mean, with positive weights, of the points where the paths between corners do.
    pub(super) fn hides(&self, blocker: u32, p: &[DVec3], q: &[DVec3]) -> bool {
        let blocker = &self.list[blocker as usize];
        p.iter().all(|&from| q.iter().all(|&to| blocker.blocks(from, to)))
    }

    /// Corners and normal of a blocker.
    pub(super) fn outline(&self, blocker: u32) -> (&[DVec3], DVec3) {
        let blocker = &self.list[blocker as usize];
        (blocker.corners(), blocker.normal)
    }

    /// Whether the first blocker that a ray meets, except those of one name, shows a front. A front at the same place
    /// as a back counts.
    pub(super) fn first(&self, from: DVec3, direction: DVec3, except: u32) -> Option<bool> {
        let met: Cell<Option<(f64, u32, bool)>> = Cell::new(None);
        let limit = || met.get().map_or(f64::INFINITY, |(t, ..)| t);
        let ray = Ray::new(from, direction);
        self.walk(
            &ray,
            |node| ray.enters(node, limit()),
            |_, blockers| {
                for blocker in blockers.iter().filter(|blocker| blocker.name != except) {
                    if let Some((t, front)) = blocker.met(from, direction).filter(|&(t, _)| t < limit()) {
                        met.set(Some((t, blocker.name, front)));
                    }
                }
                true
            },
        );
        met.get().map(|(_, name, front)| self.sides[name as usize][usize::from(!front)].is_some())
    }

    /// Walks through the nodes that `enters` accepts, in the order of the ray, and calls `meet` with the blockers of
    /// each leaf and the index of the first. The walk stops if `meet` returns false. Returns whether it was completed.
    fn walk(
        &self,
        ray: &Ray,
        enters: impl Fn(&Node) -> bool,
        mut meet: impl FnMut(usize, &[Blocker]) -> bool,
    ) -> bool {
        // The hierarchy is balanced: its depth is the logarithm of the number of blockers.
        let mut stack = [0u32; 64];
        let mut depth = usize::from(!self.nodes.is_empty());
        while depth > 0 {
            depth -= 1;
            let at = stack[depth];
            let node = &self.nodes[at as usize];
            if !enters(node) {
                continue;
            }
            if node.count == 0 {
                let (first, second) = (at + 1, node.at);
                let is_backward = ray.inverse[node.axis] < 0.0;
                (stack[depth], stack[depth + 1]) =
                    if is_backward { (first, second) } else { (second, first) };
                depth += 2;
                continue;
            }
            let first = node.at as usize;
            if !meet(first, &self.list[first..first + node.count as usize]) {
                return false;
            }
        }
        true
    }

    /// The polygons whose bounds are within `margin` of the bounds of some corners, sorted.
    pub(super) fn near(&self, corners: &[DVec3], margin: f64) -> Vec<u32> {
        let (low, high) = bounds(corners);
        let (low, high) = (low - margin, high + margin);
        let apart = |from: DVec3, to: DVec3| from.cmpgt(high).any() || to.cmplt(low).any();
        let mut names = Vec::new();
        self.walk(
            &Ray::NONE,
            |node| !apart(node.low, node.high),
            |_, blockers| {
                let is_near = |blocker: &&Blocker| {
                    let (low, high) = bounds(blocker.corners());
                    !apart(low, high)
                };
                names.extend(blockers.iter().filter(is_near).map(|blocker| blocker.name));
                true
            },
        );
        names.sort_unstable();
        names.dedup();
        let mut sources: Vec<u32> =
            names.iter().flat_map(|&name| &self.sources[name as usize]).copied().collect();
        sources.sort_unstable();
        sources
    }

    /// Appends the blockers in a shaft except those of two names, up to `most`. Returns whether these are all.
    fn within(&self, shaft: &Shaft, except: [u32; 2], most: usize, found: &mut Vec<u32>) -> bool {
        self.walk(
            &Ray::NONE,
            |node| shaft.may_meet_box(node.low, node.high),
            |first, blockers| {
                for (k, blocker) in (first as u32..).zip(blockers) {
                    if !except.contains(&blocker.name) && shaft.meets(blocker.corners()) {
                        if found.len() == most {
                            return false;
                        }
                        found.push(k);
                    }
                }
                true
            },
        )
    }
}

/// The blockers that may be between two places: few, or all.
pub(super) struct Near<'a> {
    all: &'a Blockers,
    few: Option<Vec<u32>>,
}

impl Near<'_> {
    /// As [`Blockers::free`].
    pub(super) fn free(&self, from: DVec3, to: DVec3, except: [u32; 2], last: &Cell<u32>) -> bool {
        let Some(few) = &self.few else { return self.all.free(from, to, except, last) };
        let blocks = |&k: &u32| {
            let blocker = &self.all.list[k as usize];
            !except.contains(&blocker.name) && blocker.blocks(from, to)
        };
        let found = few.iter().copied().find(blocks);
        found.inspect(|&k| last.set(k)).is_none()
    }

    /// As [`Blockers::within`].
    pub(super) fn within(&self, shaft: &Shaft, except: [u32; 2], most: usize, found: &mut Vec<u32>) -> bool {
        let Some(few) = &self.few else { return self.all.within(shaft, except, most, found) };
        for &k in few {
            let blocker = &self.all.list[k as usize];
            if !except.contains(&blocker.name) && shaft.meets(blocker.corners()) {
                if found.len() == most {
                    return false;
                }
                found.push(k);
            }
        }
        true
    }
}

/// A ray, prepared for boxes.
struct Ray {
    from: DVec3,
    inverse: DVec3,
}

impl Ray {
    /// For walks without a direction.
    const NONE: Ray = Ray { from: DVec3::ZERO, inverse: DVec3::ZERO };

    fn new(from: DVec3, direction: DVec3) -> Ray {
        Ray { from, inverse: direction.recip() }
    }

    /// Whether the ray enters the box of a node before a limit.
    fn enters(&self, node: &Node, limit: f64) -> bool {
        let (a, b) = ((node.low - self.from) * self.inverse, (node.high - self.from) * self.inverse);
        // `min` and `max` ignore NaN, which a ray in the plane of a side gives.
        let (near, far) = (a.min(b).max_element(), a.max(b).min_element());
        near.max(0.0) <= far * (1.0 + 4.0 * f64::EPSILON) && near <= limit
    }
}

/// The lowest and highest coordinates of some points.
pub(super) fn bounds<'a>(points: impl IntoIterator<Item = &'a DVec3>) -> (DVec3, DVec3) {
    let none = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    points.into_iter().fold(none, |(low, high), p| (low.min(*p), high.max(*p)))
}

/// The corners in an order that does not depend on the first corner and the direction.
fn sorted(corners: &[DVec3]) -> Vec<[u64; 3]> {
    // Zeros of both signs are the same place.
    let mut bits: Vec<[u64; 3]> =
        corners.iter().map(|p| (*p + DVec3::ZERO).to_array().map(f64::to_bits)).collect();
    bits.sort_unstable();
    bits
}

/// Largest deviation of a quadrilateral from a parallelogram, relative to its diagonal, because files round.
const SKEW: f64 = 1e-5;

fn is_parallelogram(corners: &[DVec3]) -> bool {
    matches!(*corners, [p, q, r, s] if (r - q - (s - p)).length() <= SKEW * (r - p).length())
}

/// Sorts the blockers into a hierarchy. Divides them in halves along the longest axis of their bounds.
fn build(list: &mut [Blocker], first: usize, nodes: &mut Vec<Node>) {
    if list.is_empty() {
        return;
    }
    let (low, high) = bounds(list.iter().flat_map(Blocker::corners));
    let at = nodes.len();
    // Margin for the rounding of the box test.
    let margin = DVec3::splat(4.0 * f64::EPSILON);
    let axis = (high - low).max_position();
    let count = list.len() as u32;
    nodes.push(Node { low: low - margin, high: high + margin, at: first as u32, count, axis });
    if list.len() <= LEAF {
        return;
    }
    let middle = |b: &Blocker| b.corners().iter().map(|p| p[axis]).sum::<f64>() / b.corners().len() as f64;
    let half = list.len() / 2;
    list.select_nth_unstable_by(half, |a, b| middle(a).total_cmp(&middle(b)));
    let (left, right) = list.split_at_mut(half);
    build(left, first, nodes);
    nodes[at].at = nodes.len() as u32;
    nodes[at].count = 0;
    build(right, first + half, nodes);
}
