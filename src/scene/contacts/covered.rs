//! Parts of emitters that a solid covers, such as the part of a luminous wall behind a block.
//!
//! The face of the block and the covered part of the wall lie in one plane and face each other, so that both are
//! invisible. But a ray inside the block hits both at the same distance, so that the wall would light the inside of the
//! block. The covered part is therefore left out, like a face hidden behind another in one plane.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use glam::DVec3;

use super::{find::FLAT, grading::Surface};
use crate::scene::{Scene, overlaps::Hidden, triangle_area};

/// Leaves out the pieces of emitting surfaces that solids cover. A surface that is covered entirely stays: it may be
/// the lamp of a room whose walls show their backs.
pub(super) fn leave_out(
    scene: &Scene,
    surfaces: &[Surface],
    left: &mut HashMap<u32, Vec<[u32; 3]>>,
) -> Vec<Hidden> {
    let touched = |surface: &&Surface| {
        scene.emits(surface.triangles[0] as usize) && surface.lines.iter().any(|line| line.of.is_some())
    };
    let candidates: Vec<&Surface> = surfaces.iter().filter(touched).collect();
    if candidates.is_empty() {
        return Vec::new();
    }
    let solids = Solids::of(scene);
    let mut covered: BTreeMap<u32, (f64, BTreeSet<u32>)> = BTreeMap::new();
    for surface in candidates {
        let covers = solids.covers(scene, surface);
        let corners = |piece: &[u32; 3]| piece.map(|v| scene.vertices[v as usize]);
        let is_covered = |piece: &[u32; 3]| {
            let centre = surface.plane.flat(corners(piece).into_iter().map(|p| p / 3.0).sum());
            covers.iter().any(|&t| {
                let [a, b, c] = scene.corners(t as usize).map(|p| surface.plane.flat(p));
                let sides = [(a, b), (b, c), (c, a)].map(|(p, q)| (q - p).perp_dot(centre - p));
                // The covering triangle faces the other way, so that its corners run clockwise here.
                sides.iter().all(|&side| side < 0.0)
            })
        };
        let pieces = || surface.triangles.iter().filter_map(|t| left.get(t)).flatten();
        let area: f64 = pieces().filter(|p| is_covered(p)).map(|p| triangle_area(corners(p))).sum();
        let whole: f64 = surface.triangles.iter().map(|&t| scene.area(t as usize)).sum();
        if area > 0.0 && area < 0.999 * whole {
            for t in &surface.triangles {
                left.entry(*t).and_modify(|pieces| pieces.retain(|piece| !is_covered(piece)));
            }
            let material = |t: u32| scene.triangles[t as usize].material;
            let of_material = covered.entry(material(surface.triangles[0])).or_default();
            of_material.0 += area;
            of_material.1.extend(covers.iter().map(|&t| material(t)));
        }
    }
    let name = |m: &u32| scene.materials[*m as usize].name.clone();
    let hidden = |(m, (area, behind)): (u32, (f64, BTreeSet<u32>))| Hidden {
        material: name(&m),
        behind: behind.iter().map(name).collect(),
        area,
    };
    covered.into_iter().map(hidden).collect()
}

/// The triangles of solids: closed surfaces whose fronts face outward.
struct Solids {
    /// For each triangle, the first triangle of its solid; `None` if the triangle belongs to no solid.
    of: Vec<Option<u32>>,
}

impl Solids {
    fn of(scene: &Scene) -> Solids {
        let count = scene.triangles.len();
        let mut edges: Vec<(u32, u32, bool, u32)> = Vec::with_capacity(3 * count);
        for (t, triangle) in scene.triangles.iter().enumerate() {
            let [a, b, c] = triangle.vertices;
            edges.extend([(a, b), (b, c), (c, a)].map(|(p, q)| (p.min(q), p.max(q), p < q, t as u32)));
        }
        edges.sort_unstable();
        let mut first: Vec<u32> = (0..count as u32).collect();
        let mut open = vec![false; count];
        for edge in edges.chunk_by(|e, f| (e.0, e.1) == (f.0, f.1)) {
            for pair in edge.windows(2) {
                let [s, t] = [pair[0].3, pair[1].3].map(|t| root(&mut first, t));
                first[s.max(t) as usize] = s.min(t);
            }
            if edge.len() != 2 || edge[0].2 == edge[1].2 {
                edge.iter().for_each(|e| open[e.3 as usize] = true);
            }
        }
        let roots: Vec<u32> = (0..count as u32).map(|t| root(&mut first, t)).collect();
        let mut volumes = vec![0.0; count];
        for (t, &root) in roots.iter().enumerate() {
            let origin = scene.corners(root as usize)[0];
            let [a, b, c] = scene.corners(t).map(|p| p - origin);
            volumes[root as usize] += a.dot(b.cross(c));
            open[root as usize] |= open[t];
        }
        let is_solid = |root: &u32| !open[*root as usize] && volumes[*root as usize] > 0.0;
        Solids { of: roots.into_iter().map(|root| Some(root).filter(is_solid)).collect() }
    }

    /// The triangles of solids that lie against a surface.
    fn covers(&self, scene: &Scene, surface: &Surface) -> Vec<u32> {
        let touching = surface.lines.iter().filter_map(|line| self.of[line.of? as usize]);
        let bodies: BTreeSet<u32> = touching.collect();
        let place = scene.corners(surface.triangles[0] as usize)[0];
        let normal: DVec3 = scene.normal(surface.triangles[0] as usize);
        let size = surface.lines.iter().map(|line| line.size).fold(0.0, f64::max);
        let lies_against = |t: &u32| {
            let near = |p: DVec3| normal.dot(p - place).abs() <= super::find::TOUCHING * size;
            self.of[*t as usize].is_some_and(|body| bodies.contains(&body))
                && normal.dot(scene.normal(*t as usize)) < -FLAT
                && scene.corners(*t as usize).into_iter().all(near)
        };
        (0..scene.triangles.len() as u32).filter(lies_against).collect()
    }
}

fn root(first: &mut [u32], mut t: u32) -> u32 {
    while first[t as usize] != t {
        first[t as usize] = first[first[t as usize] as usize];
        t = first[t as usize];
    }
    t
}
