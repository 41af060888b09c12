//! The patches as one mesh with shared vertices.
//!
//! A vertex is known by where it is: a vertex of the scene; a dyadic fraction of the way along an edge, counted from
//! the end with the lower index; or a point inside one triangle. Its position comes from one expression of those, so
//! patches that meet there agree to the last bit, also where one triangle is cut more finely than its neighbour.
//! There the larger patch may be drawn as two halves, which meet at the vertex that is no corner of it
//! (`meeting`).
//!
//! Where surfaces meet at a crease, one place has a vertex for each surface, because each has its own radiosity there.

use glam::DVec3;
use rayon::prelude::*;

use super::{
    meeting::{Meeting, common_edge},
    surfaces::{NONE, Surfaces, has_side},
};
use crate::{
    patch::{
        Cell, Patches,
        edges::{FINEST, edge_of, from_lower_end},
        restricted::{middle, points},
    },
    scene::Scene,
};

/// Surfaces whose normals differ by less than this many degrees at an edge look smooth there: a column of 16 sides
/// looks round, one of 8 sides keeps its edges.
pub const CREASE: f64 = 30.0;

/// A vertex within an edge of a patch, where smaller ones meet it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hanging {
    /// The vertex.
    pub vertex: u32,
    /// The ends of the larger patch's edge.
    pub ends: [u32; 2],
    /// How far the vertex is from the first end to the second, between 0 and 1.
    pub fraction: f64,
}

/// The vertices of all patches.
#[derive(Debug, Clone)]
pub struct PatchMesh {
    positions: Vec<DVec3>,
    corners: Vec<[u32; 3]>,
    /// Patches drawn as two halves, in order: which edge has a vertex in the middle, and which it is.
    halved: Vec<(u32, usize, u32)>,
    hanging: Vec<Hanging>,
    fronts: usize,
}

impl PatchMesh {
    /// Numbers the vertices; surfaces that bend by `crease` degrees or more at an edge share none there.
    pub fn new(scene: &Scene, patches: &Patches, crease: f64) -> PatchMesh {
        let surfaces = Surfaces::new(scene, patches, crease);
        let meeting = Meeting::new(scene, patches);
        let mut numbering = Numbering::new(scene, patches, &surfaces, &meeting);
        for front in [true, false] {
            for t in (0..scene.triangles.len()).filter(|&t| has_side(patches, t, front)) {
                numbering.add(t, front);
            }
        }
        let corners = (0..patches.len()).into_par_iter().map(|i| numbering.corners_of(i)).collect();
        PatchMesh {
            halved: numbering.halved(&meeting),
            hanging: numbering.hanging(&meeting),
            positions: numbering.positions,
            corners,
            fronts: patches.fronts(),
        }
    }

    /// Where the vertices are, in the file's unit.
    pub fn positions(&self) -> &[DVec3] {
        &self.positions
    }

    /// The vertices of patch `i` in the order of its triangle's corners.
    pub fn corners(&self, i: usize) -> [u32; 3] {
        self.corners[i]
    }

    /// Number of faces: one a patch in their order, which may be a half, and the other halves.
    pub fn faces(&self) -> usize {
        self.corners.len() + self.halved.len()
    }

    /// The patch that a face is of, and the share of it that the face is.
    pub fn patch(&self, face: usize) -> (usize, f64) {
        match face.checked_sub(self.corners.len()) {
            Some(other) => (self.halved[other].0 as usize, 0.5),
            None if self.halved_at(face).is_some() => (face, 0.5),
            None => (face, 1.0),
        }
    }

    /// The vertices of a face, counter-clockwise seen from the side that it is on.
    pub fn face(&self, face: usize) -> [u32; 3] {
        let (patch, _) = self.patch(face);
        let mut corners = self.corners[patch];
        if let Some((_, k, middle)) = self.halved_at(patch) {
            // Each half has one end of the edge, and the middle in the place of the other.
            corners[if face == patch { (k + 1) % 3 } else { k }] = middle;
        }
        let [a, b, c] = corners;
        if patch < self.fronts { [a, b, c] } else { [a, c, b] }
    }

    fn halved_at(&self, patch: usize) -> Option<(u32, usize, u32)> {
        self.halved.binary_search_by_key(&(patch as u32), |&(patch, ..)| patch).ok().map(|at| self.halved[at])
    }

    /// The vertices within edges of larger patches, the largest first.
    pub fn hanging(&self) -> &[Hanging] {
        &self.hanging
    }
}

/// Numbers of the vertices while they are given out. Points have whole barycentric coordinates that sum to 2^[`FINEST`],
/// and those on edges are known by their distance from the end with the lower index.
struct Numbering<'a> {
    scene: &'a Scene,
    patches: &'a Patches,
    surfaces: &'a Surfaces,
    meeting: &'a Meeting,
    positions: Vec<DVec3>,
    /// The vertex at the corner of each slot that is the lowest of its cluster.
    corner: Vec<u32>,
    /// The first vertex inside the edge of each slot that is the lower of those that share it.
    edge: Vec<u32>,
    /// The first vertex inside each side of a triangle, fronts first.
    inner: Vec<u32>,
    /// Those slots, and the points inside their edges, where mixed triangles have them; in order.
    on_edges: Vec<(u32, u32)>,
    /// Triangles that are not uniform, and the points inside them, by two coordinates; in order.
    inside: Vec<(u32, [u32; 2])>,
}

impl<'a> Numbering<'a> {
    fn new(scene: &'a Scene, patches: &'a Patches, surfaces: &'a Surfaces, meeting: &'a Meeting) -> Self {
        let slots = surfaces.slots();
        let mut numbering = Numbering {
            scene,
            patches,
            surfaces,
            meeting,
            positions: Vec::with_capacity(patches.len() / 2 + scene.vertices.len()),
            corner: vec![NONE; slots],
            edge: vec![NONE; slots],
            inner: vec![NONE; slots / 3],
            on_edges: Vec::new(),
            inside: Vec::new(),
        };
        numbering.list_points();
        numbering
    }

    /// Fills the lists of points.
    fn list_points(&mut self) {
        let (mut on_edges, mut inside) = (Vec::new(), Vec::new());
        for (_, cell) in &self.meeting.cells {
            let t = cell.triangle as usize;
            for p in points(cell).into_iter().filter(|p| !p.contains(&(1 << FINEST))) {
                match edge_of(p) {
                    Some(k) => {
                        on_edges.extend(self.owners(t, k).map(|owner| (owner, self.distance(t, k, p))))
                    }
                    None if !self.patches.is_uniform(t) => inside.push((cell.triangle, [p[1], p[2]])),
                    None => {}
                }
            }
        }
        for &(i, k) in &self.meeting.cut {
            let p = points(&self.patches.cell(i));
            let (t, p) = (self.patches.triangle(i), middle(p[k], p[(k + 1) % 3]));
            if let Some(k) = edge_of(p) {
                on_edges.extend(self.owners(t, k).map(|owner| (owner, self.distance(t, k, p))));
            }
        }
        on_edges.par_sort_unstable();
        on_edges.dedup();
        inside.par_sort_unstable();
        inside.dedup();
        (self.on_edges, self.inside) = (on_edges, inside);
    }

    /// The owners of edge `k` on those sides of triangle `t` that have patches.
    fn owners(&self, t: usize, k: usize) -> impl Iterator<Item = u32> + use<'a> {
        let (patches, surfaces) = (self.patches, self.surfaces);
        let sides = [true, false].into_iter().filter(move |&front| has_side(patches, t, front));
        sides.map(move |front| owner(surfaces, surfaces.slot(t, k, front)) as u32)
    }

    fn distance(&self, t: usize, k: usize, p: [u32; 3]) -> u32 {
        from_lower_end(self.scene.triangles[t].vertices, k, p)
    }

    /// Gives numbers to the vertices of a side of triangle `t` that have none yet.
    fn add(&mut self, t: usize, front: bool) {
        for k in 0..3 {
            let slot = self.surfaces.slot(t, k, front);
            let cluster = self.surfaces.cluster(slot);
            if self.corner[cluster] == NONE {
                self.corner[cluster] = self.positions.len() as u32;
                self.positions.push(self.scene.corners(t)[k]);
            }
            let owner = owner(self.surfaces, slot);
            if self.edge[owner] == NONE {
                self.edge[owner] = self.positions.len() as u32;
                self.push_edge(owner);
            }
        }
        self.inner[self.surfaces.slot(t, 0, front) / 3] = self.positions.len() as u32;
        let [a, b, c] = self.scene.corners(t);
        let along = |k: u32, n: u32| f64::from(k) / f64::from(n);
        if self.patches.is_uniform(t) {
            let n = 1u32 << self.patches.level(t);
            for i in 1..n {
                for j in 1..n - i {
                    self.positions.push(a + (b - a) * along(i, n) + (c - a) * along(j, n));
                }
            }
        } else {
            for &(_, [i, j]) in run(&self.inside, t as u32).1 {
                let n = 1 << FINEST;
                self.positions.push(a + (b - a) * along(i, n) + (c - a) * along(j, n));
            }
        }
    }

    /// The vertices inside an edge, from the end with the lower index to the other.
    fn push_edge(&mut self, slot: usize) {
        let v = self.scene.triangles[self.surfaces.triangle(slot)].vertices;
        let (a, b) = (v[slot % 3], v[(slot + 1) % 3]);
        let [low, high] = [a.min(b), a.max(b)].map(|v| self.scene.vertices[v as usize]);
        let at = |k: u32, n: u32| low + (high - low) * (f64::from(k) / f64::from(n));
        if self.is_listed(slot) {
            let (_, listed) = run(&self.on_edges, slot as u32);
            self.positions.extend(listed.iter().map(|&(_, distance)| at(distance, 1 << FINEST)));
        } else {
            let n = 1 << self.patches.level(self.surfaces.triangle(slot));
            self.positions.extend((1..n).map(|k| at(k, n)));
        }
    }

    /// Whether the points inside the edge of a slot are listed; else its triangles cut it evenly.
    fn is_listed(&self, slot: usize) -> bool {
        let is_mixed = |slot: usize| self.meeting.is_mixed(self.surfaces.triangle(slot));
        is_mixed(slot) || self.surfaces.across(slot).is_some_and(is_mixed)
    }

    /// The vertex inside an edge at a point, if there is one.
    fn on_edge(&self, slot: usize, distance: u32) -> Option<u32> {
        let owner = owner(self.surfaces, slot);
        let index = if self.is_listed(owner) {
            let (start, _) = run(&self.on_edges, owner as u32);
            self.on_edges.binary_search(&(owner as u32, distance)).ok()? - start
        } else {
            (distance >> (FINEST - u32::from(self.patches.level(self.surfaces.triangle(owner))))) as usize - 1
        };
        Some(self.edge[owner] + index as u32)
    }

    /// The vertices of patch `i` in the order of its triangle's corners.
    fn corners_of(&self, i: usize) -> [u32; 3] {
        let (t, front) = (self.patches.triangle(i), self.patches.is_front(i));
        let vertex = |p| self.vertex(t, front, p).expect("corners of patches have vertices");
        points(&self.patches.cell(i)).map(vertex)
    }

    /// The vertex of a side of a triangle at a point, if there is one.
    fn vertex(&self, t: usize, front: bool, p: [u32; 3]) -> Option<u32> {
        if let Some(k) = (0..3).find(|&k| p[k] == 1 << FINEST) {
            return Some(self.corner[self.surfaces.cluster(self.surfaces.slot(t, k, front))]);
        }
        if let Some(k) = edge_of(p) {
            return self.on_edge(self.surfaces.slot(t, k, front), self.distance(t, k, p));
        }
        let index = if self.patches.is_uniform(t) {
            let level = u32::from(self.patches.level(t));
            let (n, [_, row, column]) = (1u32 << level, p.map(|x| x >> (FINEST - level)));
            (row - 1) * (n - 1) - row * (row - 1) / 2 + column - 1
        } else {
            let (start, _) = run(&self.inside, t as u32);
            (self.inside.binary_search(&(t as u32, [p[1], p[2]])).ok()? - start) as u32
        };
        Some(self.inner[self.surfaces.slot(t, 0, front) / 3] + index)
    }

    /// The patches that are drawn as two halves.
    fn halved(&self, meeting: &Meeting) -> Vec<(u32, usize, u32)> {
        let sides = |&(i, k): &(usize, usize)| {
            let p = points(&self.patches.cell(i));
            let middle = middle(p[k], p[(k + 1) % 3]);
            let vertex = |front| self.vertex(self.patches.triangle(i), front, middle).expect("it was listed");
            let back = self.patches.back_of(i).map(|back| (back, k, vertex(false)));
            std::iter::once((i as u32, k, vertex(true))).chain(back)
        };
        let mut halved: Vec<(u32, usize, u32)> = meeting.cut.par_iter().flat_map_iter(sides).collect();
        halved.par_sort_unstable();
        halved
    }

    /// The vertices within edges of patches.
    fn hanging(&self, meeting: &Meeting) -> Vec<Hanging> {
        let of_cell = |(i, cell): &(usize, Cell)| {
            let sides =
                [true, false].into_iter().filter(|&front| front || self.patches.back_of(*i).is_some());
            let found = sides.flat_map(|front| self.hanging_of(cell, front));
            found.map(|hanging| (cell.level, hanging)).collect::<Vec<_>>()
        };
        let mut hanging: Vec<(u8, Hanging)> = meeting.cells.par_iter().flat_map_iter(of_cell).collect();
        hanging.par_sort_by_key(|&(level, _)| level);
        hanging.into_iter().map(|(_, hanging)| hanging).collect()
    }

    /// The vertices within the edges of one patch.
    fn hanging_of(&self, cell: &Cell, front: bool) -> Vec<Hanging> {
        let (t, p) = (cell.triangle as usize, points(cell));
        let mut found = Vec::new();
        for k in 0..3 {
            let (a, b) = (p[k], p[(k + 1) % 3]);
            let end = |p| self.vertex(t, front, p).expect("corners of patches have vertices");
            let mut add =
                |vertex: u32, ends: [u32; 2], fraction: f64| found.push(Hanging { vertex, ends, fraction });
            match common_edge(a, b) {
                Some(side) => {
                    let owner = owner(self.surfaces, self.surfaces.slot(t, side, front));
                    let [from, to] = [a, b].map(|p| self.distance(t, side, p));
                    let (_, listed) = run(&self.on_edges, owner as u32);
                    let between = |x: u32| from.min(to) < x && x < from.max(to);
                    let first = listed.partition_point(|&(_, x)| x <= from.min(to));
                    for (n, &(_, x)) in
                        listed.iter().enumerate().skip(first).take_while(|(_, (_, x))| between(*x))
                    {
                        let fraction = (f64::from(x) - f64::from(from)) / (f64::from(to) - f64::from(from));
                        add(self.edge[owner] + n as u32, [end(a), end(b)], fraction);
                    }
                }
                None if !self.patches.is_uniform(t) && u32::from(cell.level) < FINEST => {
                    if let Some(vertex) = self.vertex(t, front, middle(a, b)) {
                        add(vertex, [end(a), end(b)], 0.5);
                    }
                }
                None => {}
            }
        }
        found
    }
}

/// The lower of the slots that share an edge's vertices.
fn owner(surfaces: &Surfaces, slot: usize) -> usize {
    surfaces.across(slot).map_or(slot, |other| slot.min(other))
}

/// The part of a sorted list that belongs to `key`, and where it begins.
fn run<T>(list: &[(u32, T)], key: u32) -> (usize, &[(u32, T)]) {
    let start = list.partition_point(|&(k, _)| k < key);
    let length = list[start..].partition_point(|&(k, _)| k == key);
    (start, &list[start..start + length])
}
