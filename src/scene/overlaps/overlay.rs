//! Cuts triangles that overlap in one plane, so that each keeps its visible part.
//!
//! A constrained Delaunay triangulation with the edges of all triangles gives cells that no edge crosses. Each cell
//! belongs to the frontmost triangle that contains it. The cells of a triangle are then triangulated again from their
//! outline alone. So triangles in front are not cut along the edges of hidden triangles.

use std::collections::{HashMap, HashSet};

use glam::{DVec2, DVec3};
use spade::{
    Triangulation,
    handles::{FixedVertexHandle, VertexHandle},
};

use crate::scene::{
    Scene,
    cutting::{Cdt, Chain, Corner, Plane, UNNAMED, triangulate, within},
};

/// Most rounds of adding vertices where rounding makes parts of edges cross. Each round moves edges by less than the one
/// before, and one is nearly always enough.
const MOST_ROUNDS: usize = 4;

/// The visible parts of some triangles.
pub(super) struct Overlay {
    /// The visible triangles of each member. The list is empty for a hidden member, and `None` for an unchanged one.
    pub(super) left: Vec<Option<Vec<[u32; 3]>>>,
    /// The vertices on edges of members.
    pub(super) chains: Vec<Chain>,
    /// The vertices on edges of pieces.
    pub(super) inner: Vec<Chain>,
}

impl Overlay {
    /// Overlays `members`, triangles of `scene` with the frontmost first. Adds vertices to the scene.
    pub(super) fn new(scene: &mut Scene, members: &[u32], tolerance: f64) -> Overlay {
        let mut sheet = Sheet::new(scene, members, tolerance);
        sheet.cut_edges(scene);
        let cells = sheet.cells(scene);
        let owners = sheet.owners(&cells);
        let straight = Straight::new(&sheet.edges);
        let mut inner: Vec<Vec<usize>> =
            cells.corners.iter().filter_map(|cell| straight.across(cell)).collect();
        let left = (0..members.len() as u32)
            .map(|m| {
                let mut pieces = sheet.left(m, &cells, &owners)?;
                pieces.retain(|piece| match straight.across(piece) {
                    Some(line) => {
                        inner.push(line);
                        false
                    }
                    None => true,
                });
                Some(pieces.into_iter().map(|piece| piece.map(|v| sheet.vertices[v])).collect())
            })
            .collect();
        let chain = |line: &[usize]| Chain::new(line.iter().map(|&v| sheet.vertices[v]).collect());
        Overlay {
            left,
            chains: straight.lines.iter().map(|line| chain(line)).collect(),
            inner: inner.iter().map(|line| chain(line)).collect(),
        }
    }
}

/// An edge of members, and the vertices on it in order, with their distances from its first end.
struct Edge {
    ends: [usize; 2],
    on: Vec<(usize, f64)>,
}

/// Vertices that lie in a line because they are on one edge. Rounding can make triangles of three such vertices. They
/// have no area but separate their neighbours. So they are left out, and the neighbour at the longest side gets their
/// vertices.
struct Straight {
    /// All vertices of each edge, in order.
    lines: Vec<Vec<usize>>,
    /// The lines that each vertex is on.
    of: HashMap<usize, Vec<usize>>,
}

impl Straight {
    fn new(edges: &[Edge]) -> Straight {
        let line = |edge: &Edge| {
            let [first, last] = edge.ends;
            [first].into_iter().chain(edge.on.iter().map(|&(v, _)| v)).chain([last]).collect::<Vec<usize>>()
        };
        let lines: Vec<Vec<usize>> = edges.iter().map(line).collect();
        let mut of: HashMap<usize, Vec<usize>> = HashMap::new();
        for (k, line) in lines.iter().enumerate().filter(|(_, line)| line.len() > 2) {
            line.iter().for_each(|&v| of.entry(v).or_default().push(k));
        }
        Straight { lines, of }
    }

    /// If three corners lie in a line, all vertices on that line from the first corner to the last.
    fn across(&self, corners: &[usize; 3]) -> Option<Vec<usize>> {
        let places = |&k: &usize| {
            let place = |v: &usize| self.lines[k].iter().position(|w| w == v);
            let places = [place(&corners[0])?, place(&corners[1])?, place(&corners[2])?];
            let [first, last] = [places.into_iter().min()?, places.into_iter().max()?];
            Some(self.lines[k][first..=last].to_vec())
        };
        self.of.get(&corners[0])?.iter().find_map(places)
    }
}

/// The edges from each corner to the next.
fn sides<T: Copy>([a, b, c]: [T; 3]) -> [[T; 2]; 3] {
    [[a, b], [b, c], [c, a]]
}

/// The outline of a triangle through all vertices on its edges, as edges with the inside on their left. Where the outline
/// touches itself, the two opposite edges cancel.
fn outline(corners: [usize; 3], lines: &HashMap<[usize; 2], &Edge>) -> HashSet<[usize; 2]> {
    let mut outline = HashSet::new();
    for [p, q] in sides(corners).into_iter().filter(|[p, q]| p != q) {
        let on = lines[&[p.min(q), p.max(q)]].on.iter().map(|&(v, _)| v);
        let between: Vec<usize> = if p < q { on.collect() } else { on.rev().collect() };
        let mut from = p;
        for to in between.into_iter().chain([q]) {
            if !outline.remove(&[to, from]) {
                outline.insert([from, to]);
            }
            from = to;
        }
    }
    outline
}

/// The members in their plane.
struct Sheet {
    plane: Plane,
    tolerance: f64,
    /// Indices of vertices in the scene, and their positions in the plane.
    vertices: Vec<u32>,
    points: Vec<DVec2>,
    /// The members as indices into `vertices`, counter-clockwise.
    triangles: Vec<[usize; 3]>,
    edges: Vec<Edge>,
}

/// Cells. Each has its corners, counter-clockwise, and the neighbours across the edges from each corner to the next.
struct Cells {
    corners: Vec<[usize; 3]>,
    neighbours: Vec<[Option<usize>; 3]>,
}

impl Sheet {
    fn new(scene: &Scene, members: &[u32], tolerance: f64) -> Sheet {
        let plane = Plane::of(scene.corners(members[0] as usize));
        let mut sheet = Sheet {
            plane,
            tolerance,
            vertices: Vec::new(),
            points: Vec::new(),
            triangles: Vec::new(),
            edges: Vec::new(),
        };
        let mut known = HashMap::new();
        let mut edges = HashMap::new();
        for &t in members {
            let corners = scene.triangles[t as usize].vertices.map(|v| {
                *known.entry(v).or_insert_with(|| {
                    sheet.vertices.push(v);
                    sheet.points.push(plane.flat(scene.vertices[v as usize]));
                    sheet.vertices.len() - 1
                })
            });
            sheet.triangles.push(corners);
            let [a, b, c] = corners;
            for (p, q) in [(a, b), (b, c), (c, a)].into_iter().filter(|(p, q)| p != q) {
                let ends = [p.min(q), p.max(q)];
                edges.entry(ends).or_insert_with(|| sheet.edges.push(Edge { ends, on: Vec::new() }));
            }
        }
        sheet
    }

    /// Finds the vertices on edges, and makes vertices where edges cross.
    fn cut_edges(&mut self, scene: &mut Scene) {
        self.find_on_edges(0);
        let given = self.points.len();
        for [e, f] in self.crossing() {
            self.cross(scene, e, f);
        }
        self.find_on_edges(given);
        self.sort_on_edges();
    }

    fn sort_on_edges(&mut self) {
        for edge in &mut self.edges {
            edge.on.sort_by(|(v, s), (w, t)| s.total_cmp(t).then(v.cmp(w)));
            edge.on.dedup_by_key(|(v, _)| *v);
        }
    }

    /// Finds the edges on which vertices lie. Looks at vertices with an index of at least `first`.
    fn find_on_edges(&mut self, first: usize) {
        let mut order: Vec<usize> = (first..self.points.len()).collect();
        order.sort_by(|&v, &w| self.points[v].x.total_cmp(&self.points[w].x));
        for e in 0..self.edges.len() {
            let [p, q] = self.edges[e].ends.map(|v| self.points[v]);
            let (low, high) = (p.min(q) - self.tolerance, p.max(q) + self.tolerance);
            let start = order.partition_point(|&v| self.points[v].x < low.x);
            for &v in order[start..].iter().take_while(|&&v| self.points[v].x <= high.x) {
                let r = self.points[v];
                if r.y < low.y || r.y > high.y || self.edges[e].ends.contains(&v) {
                    continue;
                }
                let along = (q - p).normalize();
                let (from, off) = (along.dot(r - p), along.perp_dot(r - p).abs());
                let apart = r.distance(p).min(r.distance(q)) > self.tolerance;
                if off <= self.tolerance && from > 0.0 && from < p.distance(q) && apart {
                    self.edges[e].on.push((v, from));
                }
            }
        }
    }

    /// Pairs of edges that cross.
    fn crossing(&self) -> Vec<[usize; 2]> {
        let ends = |e: usize| self.edges[e].ends.map(|v| self.points[v]);
        let bounds: Vec<[DVec2; 2]> =
            (0..self.edges.len()).map(ends).map(|[p, q]| [p.min(q), p.max(q)]).collect();
        let mut order: Vec<usize> = (0..bounds.len()).collect();
        order.sort_by(|&e, &f| bounds[e][0].x.total_cmp(&bounds[f][0].x));
        let mut found = Vec::new();
        for (k, &e) in order.iter().enumerate() {
            let after = order[k + 1..].iter().take_while(|&&f| bounds[f][0].x <= bounds[e][1].x);
            for &f in after.filter(|&&f| bounds[f][0].y <= bounds[e][1].y && bounds[e][0].y <= bounds[f][1].y)
            {
                let ([p, q], [r, s]) = (ends(e), ends(f));
                let side = |p: DVec2, q: DVec2, r: DVec2| (q - p).perp_dot(r - p);
                if side(p, q, r) * side(p, q, s) < 0.0 && side(r, s, p) * side(r, s, q) < 0.0 {
                    found.push([e, f]);
                }
            }
        }
        found.sort_unstable();
        found
    }

    /// Gives two crossing edges a common vertex if they have none: a vertex of theirs that is close, or else a new one.
    fn cross(&mut self, scene: &mut Scene, e: usize, f: usize) {
        let on = |edge: &Edge, v: usize| edge.ends.contains(&v) || edge.on.iter().any(|&(w, _)| w == v);
        let (first, second) = (&self.edges[e], &self.edges[f]);
        let all =
            |edge: &Edge| edge.ends.into_iter().chain(edge.on.iter().map(|&(v, _)| v)).collect::<Vec<_>>();
        let ([p, q], [r, s]) = (first.ends.map(|v| self.points[v]), second.ends.map(|v| self.points[v]));
        let share = (s - r).perp_dot(p - r) / (s - r).perp_dot(p - q);
        let at = p + (q - p) * share;
        // Straight edges meet only once. By rounding, almost parallel edges would seem to cross elsewhere too.
        if all(first).into_iter().any(|v| on(second, v)) {
            return;
        }
        let near = |v: &usize| self.points[*v].distance(at) <= 2.0 * self.tolerance;
        let known = all(first).into_iter().chain(all(second)).find(near);
        let [a, b] = first.ends.map(|v| scene.vertices[self.vertices[v] as usize]);
        let v = known.unwrap_or_else(|| self.make(scene, a + (b - a) * share, at));
        for (edge, from) in [(e, p), (f, r)] {
            if !on(&self.edges[edge], v) {
                let from = self.points[v].distance(from);
                self.edges[edge].on.push((v, from));
            }
        }
    }

    fn make(&mut self, scene: &mut Scene, position: DVec3, at: DVec2) -> usize {
        scene.vertices.push(position);
        self.vertices.push(scene.vertices.len() as u32 - 1);
        self.points.push(at);
        self.points.len() - 1
    }

    /// The cells that all edges make. Where rounding makes parts of edges cross, the triangulation has vertices without
    /// a name. They become vertices of the edges, and the triangulation begins again.
    fn cells(&mut self, scene: &mut Scene) -> Cells {
        let mut cdt = self.triangulated();
        let mut named = self.name_crossings(scene, &cdt);
        for _ in 0..MOST_ROUNDS {
            let Some(&first) = named.values().min() else { break };
            self.find_on_edges(first);
            self.sort_on_edges();
            cdt = self.triangulated();
            named = self.name_crossings(scene, &cdt);
        }
        let vertex = |v: VertexHandle<'_, Corner, (), _, ()>| match v.data().vertex {
            UNNAMED => named[&v.fix()],
            known => known,
        };
        let mut cells = Cells { corners: Vec::new(), neighbours: Vec::new() };
        let inner: HashMap<_, usize> =
            cdt.inner_faces().enumerate().map(|(k, face)| (face.fix().index(), k)).collect();
        for face in cdt.inner_faces() {
            let edges = face.adjacent_edges();
            cells.corners.push(edges.map(|edge| vertex(edge.from())));
            cells.neighbours.push(edges.map(|edge| {
                let other = edge.rev().face();
                if other.is_outer() { None } else { inner.get(&other.fix().index()).copied() }
            }));
        }
        cells
    }

    /// Makes vertices where the triangulation has vertices without a name.
    fn name_crossings(&mut self, scene: &mut Scene, cdt: &Cdt) -> HashMap<FixedVertexHandle, usize> {
        let none = [DVec2::INFINITY, DVec2::NEG_INFINITY];
        let [low, high] = self.points.iter().fold(none, |[l, h], &p| [l.min(p), h.max(p)]);
        let mut named = HashMap::new();
        for v in cdt.vertices().filter(|v| v.data().vertex == UNNAMED) {
            let at = low + DVec2::new(v.position().x, v.position().y) * (high - low).max_element();
            let position = self.lift(scene, at);
            named.insert(v.fix(), self.make(scene, position, at));
        }
        named
    }

    /// The triangulation of all points with the parts of all edges.
    fn triangulated(&self) -> Cdt {
        let vertices: Vec<usize> = (0..self.points.len()).collect();
        let mut edges = Vec::new();
        for Edge { ends: [a, b], on } in &self.edges {
            let mut from = *a;
            for to in on.iter().map(|&(v, _)| v).chain([*b]) {
                edges.push([from, to]);
                from = to;
            }
        }
        triangulate(&self.points, &vertices, &edges)
    }

    /// The point of the frontmost member's plane that projects to `at`.
    fn lift(&self, scene: &Scene, at: DVec2) -> DVec3 {
        let corners = self.triangles[0].map(|v| scene.vertices[self.vertices[v] as usize]);
        let [normal, along] = [self.plane.normal, DVec3::AXES[self.plane.along]];
        let mut p = DVec3::ZERO;
        (p[self.plane.axes[0]], p[self.plane.axes[1]]) = (at.x, at.y);
        p + along * (normal.dot(corners[0] - p) / normal[self.plane.along])
    }

    /// The member that each cell belongs to, if any: the frontmost one whose outline runs around the cell.
    ///
    /// An outline bends by up to the tolerance, because it runs through vertices beside the straight edges. So the
    /// geometry alone does not decide about narrow cells along an edge. The outline does: it consists of edges of
    /// cells, the cells on its left are inside, and so are the cells that are reached from these without crossing it.
    fn owners(&self, cells: &Cells) -> Vec<Option<u32>> {
        let centres: Vec<DVec2> = cells
            .corners
            .iter()
            .map(|corners| corners.iter().map(|&v| self.points[v]).sum::<DVec2>() / 3.0)
            .collect();
        let mut order: Vec<usize> = (0..centres.len()).collect();
        order.sort_by(|&i, &j| centres[i].x.total_cmp(&centres[j].x));
        let on_left: HashMap<[usize; 2], usize> =
            (0..cells.corners.len()).flat_map(|k| sides(cells.corners[k]).map(|side| (side, k))).collect();
        let lines: HashMap<[usize; 2], &Edge> = self.edges.iter().map(|edge| (edge.ends, edge)).collect();
        let mut owners = vec![None; centres.len()];
        let slack = 2.0 * self.tolerance;
        for (m, &corners) in self.triangles.iter().enumerate() {
            let [a, b, c] = corners.map(|v| self.points[v]);
            let (low, high) = (a.min(b).min(c) - slack, a.max(b).max(c) + slack);
            let outline = outline(corners, &lines);
            let is_near = |p: DVec2| {
                let inside = |[p, q]: [DVec2; 2], r| (q - p).normalize_or_zero().perp_dot(r - p) >= -slack;
                p.cmpge(low).all()
                    && p.cmple(high).all()
                    && sides([a, b, c]).into_iter().all(|s| inside(s, p))
            };
            let start = order.partition_point(|&i| centres[i].x < low.x);
            let near = order[start..].iter().take_while(|&&i| centres[i].x <= high.x);
            let near: HashSet<usize> = near.copied().filter(|&i| is_near(centres[i])).collect();
            let mut open: Vec<usize> = outline.iter().filter_map(|side| on_left.get(side).copied()).collect();
            let mut inside = HashSet::new();
            while let Some(k) = open.pop() {
                if !near.contains(&k) || !inside.insert(k) {
                    continue;
                }
                owners[k].get_or_insert(m as u32);
                for (side, neighbour) in std::iter::zip(sides(cells.corners[k]), cells.neighbours[k]) {
                    let [p, q] = side;
                    if !outline.contains(&side) && !outline.contains(&[q, p]) {
                        open.extend(neighbour);
                    }
                }
            }
        }
        owners
    }

    /// The visible part of a member. `None` if all of it is visible.
    fn left(&self, member: u32, cells: &Cells, owners: &[Option<u32>]) -> Option<Vec<[usize; 3]>> {
        let own = |k: usize| owners[k] == Some(member);
        let mut outline = Vec::new();
        for k in (0..owners.len()).filter(|&k| own(k)) {
            for side in 0..3 {
                if !cells.neighbours[k][side].is_some_and(own) {
                    let [from, to] = [cells.corners[k][side], cells.corners[k][(side + 1) % 3]];
                    outline.push([from.min(to), from.max(to)]);
                }
            }
        }
        let corners = self.triangles[member as usize];
        let mut whole =
            [[0, 1], [1, 2], [2, 0]].map(|[i, j]| [corners[i].min(corners[j]), corners[i].max(corners[j])]);
        whole.sort_unstable();
        outline.sort_unstable();
        if outline == whole {
            return None;
        }
        Some(within(&self.points, &outline))
    }
}
