//! Patches: pieces of the scene's triangles, each of constant radiosity.
//!
//! A quadtree cuts a triangle: level `l` has 4^l congruent children. The ray tracer holds only the triangles. The
//! barycentric coordinates of a hit lead to the child in `l` steps ([`quadtree`]). A search follows where a triangle
//! has patches of different sizes ([`Patches::refined`]).
//!
//! A triangle has a front and a back. Patches of fronts are always unknowns of the linear system. Patches of backs
//! become unknowns when a ray hits them: rays never hit the inside of a closed solid.

mod disjoint_sets;
pub(crate) mod edges;
mod forest;
pub(crate) mod restricted;
mod solids;

use std::ops::Range;

use glam::DVec3;

pub use crate::scene::quadtree;
use crate::scene::{Scene, longest_edge};
pub(crate) use disjoint_sets::DisjointSets;
use forest::Forest;

/// How finely to cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Subdivision {
    /// No patch has an edge longer than this, in the file's unit. Infinity leaves the triangles whole.
    Edge(f64),
    /// About this many patches, all with edges below one common length. Every triangle has at least one patch.
    Count(usize),
}

/// Single-precision barycentric coordinates resolve no more levels.
const MAX_LEVEL: u8 = 15;
const NONE: u32 = u32::MAX;

/// A cell of the quadtree of a triangle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cell {
    /// The triangle.
    pub triangle: u32,
    /// The steps from the root to the cell as base-4 digits, the first most significant.
    pub child: u32,
    /// Number of steps.
    pub level: u8,
}

/// The unknowns: all patches of fronts in file order, then the patches of backs that rays have hit.
///
/// Radiometric values are interleaved: element `i * channels + c` is channel `c` of patch `i`.
#[derive(Debug, Clone)]
pub struct Patches {
    channels: usize,
    fronts: usize,
    trees: Forest,
    restricted: bool,
    triangle_areas: Vec<f64>,
    back_offsets: Vec<u32>,
    triangle: Vec<u32>,
    reflectance: Vec<f64>,
    emission: Vec<f64>,
    edge: f64,
    /// Whether the front and the back of each triangle are shut in solids; empty where none is.
    shut_in: Vec<[bool; 2]>,
}

/// Whether the front and the back of each triangle are shut in solids, where nobody can see their light: sides of faces
/// between blocks that touch. Empty where none is.
pub fn shut_in_solids(scene: &Scene) -> Vec<[bool; 2]> {
    solids::shut_in(scene)
}

/// Whether both sides of each triangle are shut in solids ([`shut_in_solids`]).
pub(crate) fn within_solids(scene: &Scene) -> Vec<bool> {
    let shut_in = solids::shut_in(scene);
    (0..scene.triangles.len()).map(|t| shut_in.get(t) == Some(&[true; 2])).collect()
}

impl Patches {
    /// Cuts the fronts of all triangles.
    ///
    /// # Panics
    /// When an edge length is not positive, or when there would be 2³¹ patches or more.
    pub fn subdivide(scene: &Scene, subdivision: &Subdivision) -> Patches {
        let (edge, levels) = levels(scene, subdivision);
        assert!(edge > 0.0, "the patch size must be positive");
        let total = count(levels.iter().copied());
        assert!(total < f64::from(1u32 << 31), "{total:.2e} patches are more than the program can number");

        Patches { shut_in: solids::shut_in(scene), ..Self::of_trees(scene, Forest::uniform(levels), edge) }
    }

    fn of_cells(scene: &Scene, cells: &[Cell], edge: f64) -> Patches {
        assert!(cells.len() < 1 << 31, "{} patches are more than the program can number", cells.len());
        Self::of_trees(scene, Forest::of_leaves(cells), edge)
    }

    fn of_trees(scene: &Scene, trees: Forest, edge: f64) -> Patches {
        let triangles = trees.trees();
        let fronts = trees.offset(triangles) as usize;
        let mut patches = Patches {
            channels: scene.channels(),
            fronts,
            triangle_areas: (0..triangles).map(|t| scene.area(t)).collect(),
            back_offsets: vec![NONE; triangles],
            triangle: Vec::with_capacity(fronts),
            reflectance: Vec::new(),
            emission: Vec::new(),
            trees,
            restricted: false,
            edge,
            shut_in: Vec::new(),
        };
        (0..triangles).for_each(|t| patches.append(scene, t as u32, true));
        patches
    }

    /// Cuts each marked front patch in four. Then cuts further patches until neighbours differ by one level at most,
    /// and each patch has smaller neighbours on one edge at most. Triangles that share an edge count as neighbours. The
    /// result has no back patches yet.
    ///
    /// # Panics
    /// When the number of marks is not the number of front patches, or when there would be 2³¹ patches or more.
    #[must_use]
    pub fn refined(&self, scene: &Scene, marked: &[bool]) -> Patches {
        assert_eq!(marked.len(), self.fronts, "marks need one value a front patch");
        let cells: Vec<Cell> = (0..self.fronts).map(|i| self.cell(i)).collect();
        let cells = restricted::restrict(scene, restricted::split(cells, marked));
        let shut_in = self.shut_in.clone();
        Patches { restricted: true, shut_in, ..Self::of_cells(scene, &cells, self.edge) }
    }

    /// Cuts every front patch in four, except patches of the deepest level. The result has no back patches yet.
    ///
    /// # Panics
    /// When there would be 2³¹ patches or more.
    #[must_use]
    pub fn quartered(&self, scene: &Scene) -> Patches {
        let cells: Vec<Cell> = (0..self.fronts).map(|i| self.cell(i)).collect();
        let cells = restricted::split(cells, &vec![true; self.fronts]);
        // All patches are cut, so that neighbours differ by as many levels as before.
        let (restricted, shut_in) = (self.restricted, self.shut_in.clone());
        Patches { restricted, shut_in, ..Self::of_cells(scene, &cells, 0.5 * self.edge) }
    }

    /// Takes reflectance and emission of every patch anew from the scene's materials.
    ///
    /// Form factors do not depend on them. So a scene with other lamps or other paint is solved without new rays:
    /// change [`Scene::materials`] or call [`Scene::set_material`], then this, then [`solve`](crate::solve::solve).
    ///
    /// # Panics
    /// When the scene has another number of triangles.
    pub fn update_materials(&mut self, scene: &Scene) {
        assert_eq!(scene.triangles.len(), self.trees.trees(), "the patches are of another scene");
        self.channels = scene.channels();
        let sides: Vec<(u32, bool)> =
            self.sides().map(|side| (self.triangle[side.start], self.is_front(side.start))).collect();
        self.triangle.clear();
        self.reflectance.clear();
        self.emission.clear();
        sides.into_iter().for_each(|(t, front)| self.append(scene, t, front));
    }

    /// The patches of each side of a triangle, in their order.
    fn sides(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        let mut start = 0;
        std::iter::from_fn(move || {
            let side = start..start + self.leaves(*self.triangle.get(start)? as usize);
            start = side.end;
            Some(side)
        })
    }

    /// How many patches a subdivision gives, without making them.
    pub fn forecast(scene: &Scene, subdivision: &Subdivision) -> f64 {
        count(levels(scene, subdivision).1.into_iter())
    }

    /// Adds the back patches of these triangles in this order. Skips triangles whose backs were added before.
    pub fn add_backs(&mut self, scene: &Scene, triangles: &[u32]) {
        for &t in triangles {
            if self.back_offsets[t as usize] == NONE {
                self.back_offsets[t as usize] = self.triangle.len() as u32;
                self.append(scene, t, false);
            }
        }
    }

    fn append(&mut self, scene: &Scene, t: u32, front: bool) {
        let ti = t as usize;
        let material = scene.material(ti);
        let mapped = material.reflectance_map.is_some() || material.emission_map.is_some();
        let varies = mapped || scene.colours.get(ti).is_some();
        for leaf in 0..self.trees.leaves(ti) {
            let (mut reflectance, mut emission) = (material.reflectance, material.emission);
            if varies {
                let Cell { child, level, .. } = self.trees.cell(ti, leaf);
                let part = quadtree::corners(child, level);
                reflectance = scene.mean_reflectance(ti, &part);
                emission = scene.mean_emission(ti, &part);
            }
            self.triangle.push(t);
            self.reflectance.extend_from_slice(&reflectance[..self.channels]);
            let side = if front { std::f64::consts::PI } else { 0.0 };
            self.emission.extend(emission[..self.channels].iter().map(|radiance| side * radiance));
        }
    }

    /// Number of unknowns: front patches, and back patches added so far.
    pub fn len(&self) -> usize {
        self.triangle.len()
    }

    /// Whether the scene has no triangle.
    pub fn is_empty(&self) -> bool {
        self.triangle.is_empty()
    }

    /// Whether a patch is shut in a solid, so that nobody can see its light ([`shut_in_solids`]).
    pub fn is_shut_in(&self, i: usize) -> bool {
        let side = usize::from(!self.is_front(i));
        self.shut_in.get(self.triangle(i)).is_some_and(|sides| sides[side])
    }

    /// The area of each patch whose light can be seen, and zero for patches shut in solids. If no visible patch has
    /// light, all areas are kept. `light` holds interleaved values.
    pub fn seen_areas(&self, light: &[f64]) -> Vec<f64> {
        let is_lit = |i: usize| light[i * self.channels..][..self.channels].iter().any(|&x| x > 0.0);
        let all = !(0..self.len()).any(|i| !self.is_shut_in(i) && is_lit(i));
        (0..self.len()).map(|i| if all || !self.is_shut_in(i) { self.area(i) } else { 0.0 }).collect()
    }

    /// Number of front patches; they come first.
    pub fn fronts(&self) -> usize {
        self.fronts
    }

    /// 1 for a grey scene, else 3.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// The largest edge that the subdivision allowed, in the file's unit.
    pub fn edge(&self) -> f64 {
        self.edge
    }

    /// Index of the triangle that patch `i` is a part of.
    pub fn triangle(&self, i: usize) -> usize {
        self.triangle[i] as usize
    }

    /// Area of every triangle in the file's unit squared.
    pub fn triangle_areas(&self) -> &[f64] {
        &self.triangle_areas
    }

    /// Whether patch `i` is on the front of its triangle.
    pub fn is_front(&self, i: usize) -> bool {
        i < self.fronts
    }

    /// Whether neighbours cut at most one edge of each patch, and at most once. [`Patches::refined`] makes it so.
    pub fn is_restricted(&self) -> bool {
        self.restricted
    }

    /// Quadtree level of the smallest patches of a triangle.
    pub fn level(&self, triangle: usize) -> u8 {
        self.trees.level(triangle)
    }

    /// Whether all patches of a triangle are of one level.
    pub fn is_uniform(&self, triangle: usize) -> bool {
        self.trees.is_uniform(triangle)
    }

    /// Number of patches on each side of a triangle.
    pub fn leaves(&self, triangle: usize) -> usize {
        self.trees.leaves(triangle) as usize
    }

    /// The front patches of a triangle.
    pub fn fronts_of(&self, triangle: usize) -> Range<usize> {
        let start = self.trees.offset(triangle) as usize;
        start..start + self.leaves(triangle)
    }

    /// Index of patch `i` among the patches of its side of its triangle, in the order of the quadtree.
    fn leaf(&self, i: usize) -> u32 {
        let t = self.triangle(i);
        i as u32 - if self.is_front(i) { self.trees.offset(t) } else { self.back_offsets[t] }
    }

    /// Where patch `i` is in the quadtree of its triangle.
    pub fn cell(&self, i: usize) -> Cell {
        self.trees.cell(self.triangle(i), self.leaf(i))
    }

    /// The front patches that overlap a cell: either the one patch that contains it, or all patches inside it.
    pub fn fronts_in(&self, cell: &Cell) -> Range<usize> {
        let (leaves, first) = (self.trees.overlapping(cell), self.trees.offset(cell.triangle as usize));
        (first + leaves.start) as usize..(first + leaves.end) as usize
    }

    /// The front patches of `other`, another subdivision of the same scene, that overlap front patch `i`: either the
    /// one patch that contains it, or all patches inside it. Also returns the share of their area that patch `i`
    /// covers, which is 1 in the second case.
    pub fn overlap(&self, other: &Patches, i: usize) -> (Range<usize>, f64) {
        let cell = self.cell(i);
        let fronts = other.fronts_in(&cell);
        let deeper = cell.level.saturating_sub(other.cell(fronts.start).level);
        (fronts, 0.25f64.powi(deeper.into()))
    }

    /// Groups of neighbouring patches, in the order of the patches. A group holds all patches below one cell of a
    /// quadtree: the highest cell whose patches are at most `levels` levels below it.
    pub fn families(&self, levels: u8) -> impl Iterator<Item = Range<usize>> + '_ {
        let mut start = 0;
        std::iter::from_fn(move || {
            let t = *self.triangle.get(start)? as usize;
            let family = start..start + self.trees.family(t, self.leaf(start), levels) as usize;
            start = family.end;
            Some(family)
        })
    }

    /// The patch on the back of front patch `i`, if it was added.
    pub fn back_of(&self, i: usize) -> Option<u32> {
        let offset = self.back_offsets[self.triangle(i)];
        (offset != NONE).then(|| offset + self.leaf(i))
    }

    /// Area of patch `i` in the file's unit squared.
    pub fn area(&self, i: usize) -> f64 {
        self.triangle_areas[self.triangle(i)] / f64::from(quadtree::children(self.cell(i).level))
    }

    /// Barycentric coordinates of the corners of patch `i` in its triangle. A back patch has the same coordinates as
    /// its front patch.
    pub fn barycentric_corners(&self, i: usize) -> [[f64; 3]; 3] {
        let Cell { child, level, .. } = self.cell(i);
        quadtree::corners(child, level)
    }

    /// Corners of patch `i` in the file's unit, counter-clockwise as seen from the patch's side.
    pub fn corners(&self, scene: &Scene, i: usize) -> [DVec3; 3] {
        let [a, b, c] = scene.corners(self.triangle(i));
        let [p, q, r] = self.barycentric_corners(i).map(|[u, v, w]| a * u + b * v + c * w);
        if self.is_front(i) { [p, q, r] } else { [p, r, q] }
    }

    /// Centroid of patch `i` in the file's unit.
    pub fn centroid(&self, scene: &Scene, i: usize) -> DVec3 {
        // Divided first: the sum of three large coordinates may overflow.
        self.corners(scene, i).into_iter().map(|corner| corner / 3.0).sum()
    }

    /// Unit normal of patch `i`, on the patch's side.
    pub fn normal(&self, scene: &Scene, i: usize) -> DVec3 {
        let normal = scene.normal(self.triangle(i));
        if self.is_front(i) { normal } else { -normal }
    }

    /// Barycentric coordinates in patch `i` of a point of its triangle. Rounding may put the point just outside the
    /// patch; it is then moved to the edge.
    pub fn local(&self, i: usize, barycentric: [f32; 3]) -> [f64; 3] {
        let corners = self.barycentric_corners(i);
        // Signed areas of the triangles between the point and each edge, from two of the coordinates.
        let from = |k: usize| [0, 1].map(|axis| corners[k][axis] - f64::from(barycentric[axis]));
        let across = |[ux, uy]: [f64; 2], [vx, vy]: [f64; 2]| (ux * vy - vx * uy).max(0.0);
        let weights = [across(from(1), from(2)), across(from(2), from(0)), across(from(0), from(1))];
        let sum: f64 = weights.iter().sum();
        weights.map(|w| w / sum)
    }

    /// Reflectance of every patch, interleaved channels.
    pub fn reflectance(&self) -> &[f64] {
        &self.reflectance
    }

    /// Emitted radiosity Be = π Le of every patch in W/m², interleaved channels.
    pub fn emission(&self) -> &[f64] {
        &self.emission
    }

    /// The patch at a point of a triangle's front or back; `None` on a back that was not added.
    #[inline]
    pub fn at(&self, triangle: u32, barycentric: [f32; 3], front: bool) -> Option<u32> {
        let t = triangle as usize;
        let offset = if front { self.trees.offset(t) } else { self.back_offsets[t] };
        (offset != NONE).then(|| offset + self.trees.leaf_at(t, barycentric))
    }
}

/// The largest edge that is allowed, and the level of each triangle.
fn levels(scene: &Scene, subdivision: &Subdivision) -> (f64, Vec<u8>) {
    let longest: Vec<f64> = (0..scene.triangles.len()).map(|t| longest_edge(scene.corners(t))).collect();
    let edge = match *subdivision {
        Subdivision::Edge(edge) => edge,
        Subdivision::Count(count) => edge_for_count(&longest, count),
    };
    (edge, longest.iter().map(|&l| level(l, edge)).collect())
}

/// The lowest level at which an edge of length `longest` is cut to at most `edge`.
fn level(longest: f64, edge: f64) -> u8 {
    // The slack keeps rounding from cutting an edge once more when it already has exactly the wanted length.
    let mut level = 0;
    while level < MAX_LEVEL && longest / f64::from(1u32 << level) > edge * (1.0 + 1e-12) {
        level += 1;
    }
    level
}

/// Patches of triangles with these levels.
fn count(levels: impl Iterator<Item = u8>) -> f64 {
    levels.map(|l| f64::from(quadtree::children(l))).sum()
}

/// The edge length that gives the number of patches nearest to `wanted`, by ratio.
fn edge_for_count(longest: &[f64], wanted: usize) -> f64 {
    let Some(largest) = longest.iter().copied().reduce(f64::max) else { return f64::INFINITY };
    let patches = |edge: f64| count(longest.iter().map(|&l| level(l, edge)));
    // The number of patches falls in steps as the edge grows: bisect for the step at the wanted number.
    let wanted = wanted.max(1) as f64;
    let (mut fine, mut coarse) = (largest / f64::from(1u32 << MAX_LEVEL), largest);
    for _ in 0..60 {
        let middle = (fine * coarse).sqrt();
        if patches(middle) > wanted { fine = middle } else { coarse = middle }
    }
    let ratio = |edge: f64| (patches(edge) / wanted).ln().abs();
    if ratio(fine) < ratio(coarse) { fine } else { coarse }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{scene::Material, trace::sampling::square_to_triangle};
    use glam::dvec3;

    /// Two triangles 1000 away from the origin: the first of a plain material, the second with another.
    fn two() -> Scene {
        let at = |x: f64, y: f64| dvec3(1000.0 + x, y, -3.0);
        let triangles =
            [([at(0., 0.), at(4., 0.), at(0., 4.)], 0), ([at(0., 9.), at(4., 9.), at(0., 13.)], 1)];
        let material = |name, reflectance| Material::new(name, [reflectance; 3], [0.0; 3]);
        Scene::new(&triangles, vec![material("floor", 0.5), material("wall", 0.25)])
    }

    #[test]
    fn patches_have_corners_centroid_and_normal_in_scene_units() {
        let scene = two();
        let mut patches = Patches::subdivide(&scene, &Subdivision::Edge(3.0));
        patches.add_backs(&scene, &[0]);
        assert_eq!((patches.fronts(), patches.len()), (8, 12));
        for i in 0..patches.len() {
            let [a, b, c] = patches.corners(&scene, i);
            let cross = (b - a).cross(c - a);
            // Binary fractions have no rounding errors, except in the centroid's thirds.
            assert_eq!(0.5 * cross.length(), patches.area(i));
            assert_eq!(cross.normalize(), patches.normal(&scene, i));
            assert_eq!(patches.normal(&scene, i), if patches.is_front(i) { DVec3::Z } else { -DVec3::Z });
            assert!(patches.centroid(&scene, i).distance((a + b + c) / 3.0) < 1e-12);
        }
        let back = patches.back_of(2).unwrap() as usize;
        assert!(patches.centroid(&scene, back).distance(patches.centroid(&scene, 2)) < 1e-12);
    }

    /// The colour is linear, so that its mean over a patch is its value at the centroid.
    #[test]
    fn colours_of_vertices_multiply_the_reflectance_of_patches() {
        let mut scene = two();
        scene.colours = vec![[[1.0; 3]; 3]; 2];
        scene.colours[1] = [[0.25, 0.5, 1.0], [0.5, 0.5, 0.0], [0.75, 0.5, 0.5]];
        for edge in [f64::INFINITY, 1.5] {
            let patches = Patches::subdivide(&scene, &Subdivision::Edge(edge));
            for i in 0..patches.len() {
                let t = patches.triangle(i);
                let corners = patches.barycentric_corners(i);
                for c in 0..3 {
                    let at =
                        |b: [f64; 3]| (0..3).map(|k| b[k] * f64::from(scene.colours[t][k][c])).sum::<f64>();
                    let mean = corners.map(at).iter().sum::<f64>() / 3.0;
                    let want = scene.materials[t].reflectance[c] * mean;
                    assert!((patches.reflectance()[3 * i + c] - want).abs() < 1e-12, "{i} {c}");
                }
            }
        }
    }

    #[test]
    fn materials_change_without_new_patches() {
        let mut scene = two();
        let mut patches = Patches::subdivide(&scene, &Subdivision::Edge(3.0));
        patches.add_backs(&scene, &[1, 0]);
        assert_eq!(scene.set_material("wall", [0.1, 0.2, 0.3], [1.0, 0.0, 2.0]), 1);
        assert_eq!(scene.set_material("roof", [0.0; 3], [0.0; 3]), 0);
        patches.update_materials(&scene);
        let mut anew = Patches::subdivide(&scene, &Subdivision::Edge(3.0));
        anew.add_backs(&scene, &[1, 0]);
        assert_eq!((patches.channels(), patches.len()), (3, 16));
        assert_eq!(patches.reflectance(), anew.reflectance());
        assert_eq!(patches.emission(), anew.emission());
        assert_eq!(patches.emission()[3 * 4 + 2], 2.0 * std::f64::consts::PI);
    }

    #[test]
    fn a_point_is_a_mix_of_the_corners_of_its_patch() {
        let material = Material::new("m", [0.5; 3], [0.0; 3]);
        let scene = Scene::new(&[([DVec3::ZERO, DVec3::X, DVec3::Y], 0)], vec![material]);
        let patches = Patches::subdivide(&scene, &Subdivision::Edge(0.1));
        assert_eq!(patches.level(0), 4);
        for k in 0..500 {
            let [x, y] = [0.618, 0.755].map(|step| (f64::from(k) * step).fract() as f32);
            let barycentric = square_to_triangle(x, y);
            let i = patches.at(0, barycentric, true).unwrap() as usize;
            let (weights, corners) = (patches.local(i, barycentric), patches.barycentric_corners(i));
            assert!(weights.iter().all(|w| (0.0..=1.0).contains(w)));
            for axis in 0..3 {
                let mixed: f64 = (0..3).map(|c| weights[c] * corners[c][axis]).sum();
                assert!((mixed - f64::from(barycentric[axis])).abs() < 1e-6, "{barycentric:?} {weights:?}");
            }
        }
        // A corner, and a point that rounding has put outside.
        assert_eq!(patches.local(0, [1.0, 0.0, 0.0]), [1.0, 0.0, 0.0]);
        assert!(patches.local(0, [1.0, -1e-7, 0.0]).iter().all(|w| (0.0..=1.0).contains(w)));
    }
}
