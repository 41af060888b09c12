//! Cuts triangles along an outline in their plane, and at new vertices on their edges.

use std::collections::HashMap;

use glam::{DVec2, DVec3};
use spade::{
    ConstrainedDelaunayTriangulation, HasPosition, Point2, Triangulation, handles::FixedVertexHandle,
};

use super::{NEW_CORNER, Scene, Triangle, interpolate, scaled_cross, triangle_area};

/// New vertices on an edge of one triangle.
pub(super) struct Chain {
    /// The edge, its lower vertex first.
    pub(super) ends: [u32; 2],
    /// The vertices between the ends, in order from the lower end.
    pub(super) between: Vec<u32>,
}

impl Chain {
    /// Makes a chain from all vertices on an edge, in order from one end to the other.
    pub(super) fn new(mut line: Vec<u32>) -> Chain {
        if line.first() > line.last() {
            line.reverse();
        }
        let ends = [line[0], line[line.len() - 1]];
        Chain { ends, between: line[1..line.len() - 1].to_vec() }
    }
}

/// Vertices on edges. The key is an edge, its lower vertex first. The vertices are in order from the lower vertex.
type OnEdges = HashMap<[u32; 2], Vec<u32>>;

/// New vertices on edges.
#[derive(Default)]
pub(super) struct Cuts {
    /// New vertices on whole edges, for triangles that were not cut.
    whole: OnEdges,
    /// New vertices on parts of edges, for pieces. The pieces of one triangle already have the vertices of its own cut
    /// as corners, but lack the vertices that cuts of its neighbours made on the same edge.
    parts: OnEdges,
}

/// Joins the new vertices from the cuts of several triangles, which may share edges. `inner` are new vertices on edges
/// of pieces.
pub(super) fn cuts(scene: &Scene, chains: Vec<Chain>, inner: Vec<Chain>) -> Cuts {
    let mut cuts = Cuts::default();
    for Chain { ends, between } in chains.iter().filter(|chain| !chain.between.is_empty()) {
        cuts.whole.entry(*ends).or_default().extend(between);
    }
    let at = |v: u32| scene.vertices[v as usize];
    for ([a, b], between) in &mut cuts.whole {
        let along = |v: &u32| (at(*v) - at(*a)).dot(at(*b) - at(*a));
        between.sort_by(|v, w| along(v).total_cmp(&along(w)).then(v.cmp(w)));
        between.dedup();
    }
    for Chain { ends: [a, b], between } in chains {
        let Some(whole) = cuts.whole.get(&[a, b]) else { continue };
        let (mut from, mut foreign) = (a, Vec::new());
        for &v in whole.iter().chain(&[b]) {
            if v != b && !between.contains(&v) {
                foreign.push(v);
                continue;
            }
            if !foreign.is_empty() {
                if from > v {
                    foreign.reverse();
                }
                cuts.parts.insert([from.min(v), from.max(v)], std::mem::take(&mut foreign));
            }
            from = v;
        }
    }
    cuts.parts.extend(inner.into_iter().map(|Chain { ends, between }| (ends, between)));
    cuts
}

/// The vertices on the edges from each corner of a triangle to the next, in this order.
fn on_edges(corners: [u32; 3], known: &OnEdges) -> [Vec<u32>; 3] {
    [0, 1, 2].map(|k| {
        let (p, q) = (corners[k], corners[(k + 1) % 3]);
        let mut between = known.get(&[p.min(q), p.max(q)]).cloned().unwrap_or_default();
        if p > q {
            between.reverse();
        }
        between
    })
}

/// Replaces the triangles in `left` by their pieces there. Cuts other triangles if they have new vertices on their
/// edges.
pub(super) fn replace(scene: &mut Scene, left: &HashMap<u32, Vec<[u32; 3]>>, cuts: &Cuts) {
    let old = std::mem::take(&mut scene.triangles);
    let texcoords = [&mut scene.texcoords, &mut scene.emission_texcoords].map(std::mem::take);
    let [colours, normals] = [&mut scene.colours, &mut scene.normals].map(std::mem::take);
    let face_corners = std::mem::take(&mut scene.face_corners);
    let backs = old.len() - scene.backs_of_lamps;
    scene.backs_of_lamps = 0;
    let mut parts = Vec::new();
    for (t, triangle) in old.iter().enumerate() {
        parts.clear();
        match left.get(&(t as u32)) {
            Some(pieces) => {
                pieces.iter().for_each(|&piece| cut(piece, on_edges(piece, &cuts.parts), &mut parts))
            }
            None => cut(triangle.vertices, on_edges(triangle.vertices, &cuts.whole), &mut parts),
        }
        parts.retain(|part| triangle_area(part.map(|v| scene.vertices[v as usize])) > 0.0);
        for &vertices in &parts {
            let corners = vertices.map(|v| match triangle.vertices.iter().position(|&w| w == v) {
                Some(k) => std::array::from_fn(|i| f64::from(u8::from(i == k))),
                None => weights(scene, triangle, v),
            });
            let mapped = |uv: &[DVec2; 3]| corners.map(|weights| interpolate(uv, weights));
            scene.texcoords.extend(texcoords[0].get(t).map(mapped));
            scene.emission_texcoords.extend(texcoords[1].get(t).map(mapped));
            let mixed = |values: &[[f32; 3]; 3]| {
                corners.map(|w| [0, 1, 2].map(|c| (0..3).map(|k| values[k][c] * w[k] as f32).sum()))
            };
            scene.colours.extend(colours.get(t).map(mixed));
            let named = |names: &[u32; 3]| {
                let name = |v| triangle.vertices.iter().position(|&w| w == v).map(|k| names[k]);
                vertices.map(|v| name(v).unwrap_or(NEW_CORNER | v))
            };
            scene.face_corners.extend(face_corners.get(t).map(named));
            scene.normals.extend(normals.get(t).map(mixed));
            scene.triangles.push(Triangle { vertices, ..*triangle });
            scene.backs_of_lamps += usize::from(t >= backs);
        }
    }
}

/// Barycentric coordinates of a vertex that lies in the plane of a triangle.
fn weights(scene: &Scene, triangle: &Triangle, v: u32) -> [f64; 3] {
    let corners = triangle.vertices.map(|v| scene.vertices[v as usize]);
    let plane = Plane::of(corners);
    let [a, b, c] = corners.map(|p| plane.flat(p));
    let p = plane.flat(scene.vertices[v as usize]);
    let [u, v, w] = [(b - p).perp_dot(c - p), (c - p).perp_dot(a - p), (a - p).perp_dot(b - p)];
    [u, v, w].map(|x| x / (u + v + w))
}

/// Cuts a triangle so that the vertices on its edges become corners. `on` holds the vertices on the edge from each
/// corner to the next.
fn cut([a, b, c]: [u32; 3], on: [Vec<u32>; 3], parts: &mut Vec<[u32; 3]>) {
    let Some(k) = on.iter().position(|between| !between.is_empty()) else { return parts.push([a, b, c]) };
    let [p, q, r] = [0, 1, 2].map(|i| [a, b, c][(k + i) % 3]);
    let [first, second, third] = [0, 1, 2].map(|i| &on[(k + i) % 3]);
    let mut from = p;
    for &to in first.iter().chain([&q]) {
        // If the corners are in a line, the third corner can lie on the first edge.
        if to != r && from != r {
            let of_second = if to == q { second.clone() } else { Vec::new() };
            let of_third = if from == p { third.clone() } else { Vec::new() };
            cut([from, to, r], [Vec::new(), of_second, of_third], parts);
        }
        from = to;
    }
}

/// A projection along the axis that is closest to a normal. It copies coordinates, so that equal points stay equal.
#[derive(Clone, Copy)]
pub(super) struct Plane {
    pub(super) axes: [usize; 2],
    /// The axis of the projection.
    pub(super) along: usize,
    pub(super) normal: DVec3,
}

impl Plane {
    pub(super) fn of([a, b, c]: [DVec3; 3]) -> Plane {
        let normal = scaled_cross(b - a, c - a).0.normalize();
        let size = normal.abs();
        let along = if size.x.max(size.y) >= size.z { usize::from(size.x < size.y) } else { 2 };
        let (x, y) = ((along + 1) % 3, (along + 2) % 3);
        // This order keeps counter-clockwise triangles counter-clockwise.
        let axes = if normal[along] > 0.0 { [x, y] } else { [y, x] };
        Plane { axes, along, normal }
    }

    pub(super) fn flat(&self, p: DVec3) -> DVec2 {
        DVec2::new(p[self.axes[0]], p[self.axes[1]])
    }

    /// Projects a triangle that is parallel to the plane. The result is counter-clockwise, whichever way the triangle
    /// faces.
    pub(super) fn counter_clockwise(&self, corners: [DVec3; 3]) -> [DVec2; 3] {
        let [a, b, c] = corners.map(|p| self.flat(p));
        if (b - a).perp_dot(c - a) < 0.0 { [a, c, b] } else { [a, b, c] }
    }
}

/// A vertex of a triangulation with its index among the points.
#[derive(Clone, Copy)]
pub(super) struct Corner {
    pub(super) at: Point2<f64>,
    pub(super) vertex: usize,
}

impl HasPosition for Corner {
    type Scalar = f64;

    fn position(&self) -> Point2<f64> {
        self.at
    }
}

pub(super) type Cdt = ConstrainedDelaunayTriangulation<Corner>;

/// The index of a vertex that the triangulation adds where rounding makes constraints cross.
pub(super) const UNNAMED: usize = usize::MAX;

/// Triangulates vertices with some edges as constraints.
pub(super) fn triangulate(points: &[DVec2], vertices: &[usize], edges: &[[usize; 2]]) -> Cdt {
    // The points are scaled to about one unit, because the triangulation limits coordinates. The scale depends on all
    // points, not only on `vertices`. So a subset of the points gets the same coordinates, and no new crossings.
    let none = [DVec2::INFINITY, DVec2::NEG_INFINITY];
    let [low, high] = points.iter().fold(none, |[low, high], &p| [low.min(p), high.max(p)]);
    let extent = (high - low).max_element();
    let mut cdt = Cdt::new();
    let mut handles: HashMap<usize, FixedVertexHandle> = HashMap::new();
    for &vertex in vertices {
        let p = (points[vertex] - low) / extent;
        // The triangulation refuses coordinates that are tiny but not zero.
        let p = p.to_array().map(|x| if x.abs() < 1e-40 { 0.0 } else { x });
        let at = Point2::new(p[0], p[1]);
        handles
            .insert(vertex, cdt.insert(Corner { at, vertex }).expect("coordinates are finite and not tiny"));
    }
    for ends in edges {
        let [from, to] = ends.map(|v| handles[&v]);
        if from != to {
            cdt.add_constraint_and_split(from, to, |at| Corner { at, vertex: UNNAMED });
        }
    }
    cdt
}

/// The triangles inside an outline. A triangle is inside if an odd number of outline edges separates it from the
/// outside.
pub(super) fn within(points: &[DVec2], outline: &[[usize; 2]]) -> Vec<[usize; 3]> {
    let mut vertices: Vec<usize> = outline.iter().flatten().copied().collect();
    vertices.sort_unstable();
    vertices.dedup();
    if vertices.is_empty() {
        return Vec::new();
    }
    let cdt = triangulate(points, &vertices, outline);
    let mut within: HashMap<usize, bool> = HashMap::new();
    let outer = cdt.outer_face().fix().index();
    within.insert(outer, false);
    let mut neighbours: HashMap<usize, Vec<(usize, bool)>> = HashMap::new();
    for edge in cdt.undirected_edges() {
        let [a, b] = [edge.as_directed(), edge.as_directed().rev()].map(|e| e.face().fix().index());
        neighbours.entry(a).or_default().push((b, edge.is_constraint_edge()));
        neighbours.entry(b).or_default().push((a, edge.is_constraint_edge()));
    }
    let mut open = vec![outer];
    while let Some(face) = open.pop() {
        let inside = within[&face];
        for &(other, crossed) in neighbours.get(&face).into_iter().flatten() {
            within.entry(other).or_insert_with(|| {
                open.push(other);
                inside != crossed
            });
        }
    }
    let inner = cdt.inner_faces().filter(|face| within.get(&face.fix().index()) == Some(&true));
    let corners = inner.map(|face| face.vertices().map(|v| v.data().vertex));
    corners.filter(|corners| !corners.contains(&UNNAMED)).collect()
}
