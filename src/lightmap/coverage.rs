//! The covered texels of a map, and the pieces of the surface in each of them.

use glam::DVec2;
use rayon::prelude::*;

use super::{
    atlas::Atlas,
    raster::{self, Polygon},
};
use crate::{patch::Patches, scene::Scene};

/// The part of a facet that lies in a texel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Piece {
    /// Index of the facet; see [`Atlas`].
    pub triangle: u32,
    /// Surface area in square scene units.
    pub area: f64,
}

/// The covered texels of a map, page by page, rows from the bottom to the top.
#[derive(Debug, Clone)]
pub struct Coverage {
    /// Covered texels, ascending: (page · height + row) · width + column, with rows counted from the bottom.
    texels: Vec<u32>,
    /// Index of the first piece of each covered texel, and the number of all pieces.
    starts: Vec<u32>,
    pieces: Vec<Piece>,
    width: usize,
    height: usize,
}

impl Coverage {
    /// Clips all triangles of a scene to the texels of its map.
    pub fn new(scene: &Scene, atlas: &Atlas) -> Coverage {
        let scene = atlas.scene(scene);
        let of_triangle = |t: usize| {
            let mut found = Vec::new();
            let Some(corners) = atlas.texel_corners(t) else { return found };
            let whole = Polygon::triangle(corners).area();
            let density = scene.area(t) / whole;
            let page = atlas.page[t] as usize * atlas.height;
            raster::for_each_texel(corners, |x, y, part| {
                // A coordinate of 1 may round up to a position one texel outside.
                let (x, y) = (x.min(atlas.width - 1), y.min(atlas.height - 1));
                let piece = Piece { triangle: t as u32, area: part.area() * density };
                found.push((((page + y) * atlas.width + x) as u32, piece));
            });
            found
        };
        let mut all: Vec<(u32, Piece)> =
            (0..atlas.corners.len()).into_par_iter().flat_map_iter(of_triangle).collect();
        all.par_sort_unstable_by_key(|(texel, piece)| (*texel, piece.triangle));
        let (mut texels, mut starts) = (Vec::new(), Vec::new());
        for (k, (texel, _)) in all.iter().enumerate() {
            if texels.last() != Some(texel) {
                texels.push(*texel);
                starts.push(k as u32);
            }
        }
        starts.push(all.len() as u32);
        let pieces = all.into_iter().map(|(_, piece)| piece).collect();
        Coverage { texels, starts, pieces, width: atlas.width, height: atlas.height }
    }

    /// Number of covered texels.
    pub fn len(&self) -> usize {
        self.texels.len()
    }

    /// Whether no texel is covered.
    pub fn is_empty(&self) -> bool {
        self.texels.is_empty()
    }

    /// The covered texels, ascending: (page · height + row) · width + column, with rows counted from the bottom.
    pub fn texels(&self) -> &[u32] {
        &self.texels
    }

    /// The pieces of surface in covered texel `i`.
    pub fn pieces(&self, i: usize) -> &[Piece] {
        &self.pieces[self.starts[i] as usize..self.starts[i + 1] as usize]
    }

    /// Surface area in covered texel `i`, in square scene units.
    pub fn area(&self, i: usize) -> f64 {
        self.pieces(i).iter().map(|p| p.area).sum()
    }

    /// The chart of covered texel `i`: the chart of its largest piece.
    pub fn chart(&self, atlas: &Atlas, i: usize) -> u32 {
        let largest = self.pieces(i).iter().max_by(|p, q| p.area.total_cmp(&q.area));
        atlas.chart[largest.expect("a covered texel has a piece").triangle as usize]
    }

    /// The part of facet `t` that lies in covered texel `i`, in barycentric coordinates of the facet.
    pub fn barycentric_part(&self, atlas: &Atlas, i: usize, t: usize) -> Barycentric {
        let texel = self.texels[i] as usize;
        let (x, y) = (texel % self.width, texel / self.width % self.height);
        let corners = atlas.texel_corners(t).expect("a piece has a place in the map");
        Barycentric::new(corners, raster::clip(corners, x, y))
    }
}

/// A convex part of a triangle. Each of its corners is given by the weights of the triangle's first two corners.
#[derive(Debug, Clone, Copy)]
pub struct Barycentric(Polygon);

impl Barycentric {
    /// Converts a part of a facet to the barycentric coordinates of the facet's triangle.
    pub fn in_triangle(self, atlas: &Atlas, facet: usize) -> Barycentric {
        Barycentric(self.0.map(|p| {
            let [x, y, _] = atlas.in_triangle(facet, barycentric(p));
            DVec2::new(x, y)
        }))
    }

    fn new([a, b, c]: [DVec2; 3], part: Polygon) -> Barycentric {
        let doubled = (b - a).perp_dot(c - a);
        Barycentric(part.map(|p| {
            let weights = DVec2::new((b - p).perp_dot(c - p), (c - p).perp_dot(a - p)) / doubled;
            weights.clamp(DVec2::ZERO, DVec2::ONE)
        }))
    }

    /// The part as a fan of triangles: the corners of each, and its share of the whole triangle's area.
    pub fn fan(&self) -> impl Iterator<Item = ([[f64; 3]; 3], f64)> + '_ {
        self.0.fan().map(|corners| {
            let [a, b, c] = corners;
            (corners.map(barycentric), (b - a).perp_dot(c - a).abs())
        })
    }

    /// Cuts the part into its intersections with the patches on one side of triangle `t`. Calls `visit` for each
    /// intersection with the patch and the intersection's share of the triangle's area. The patch is `None` if it is
    /// not an unknown of the system.
    pub fn for_each_patch(
        &self,
        patches: &Patches,
        t: usize,
        front: bool,
        mut visit: impl FnMut(Option<usize>, f64),
    ) {
        let level = patches.level(t);
        let n = f64::from(1u32 << level);
        // The lines of the quadtree form three families of parallels. A cell is the intersection of one strip of each.
        let family = |polygon: &Polygon, value: fn(DVec2) -> f64| {
            let (low, high) = polygon.range(|p| n * value(p));
            raster::cells(low, high)
        };
        let (first, second) = (|p: DVec2| p.x, |p: DVec2| p.y);
        let third = |p: DVec2| 1.0 - p.x - p.y;
        for i in family(&self.0, first) {
            let strip = self.0.strip(i as f64, (i + 1) as f64, |p| n * first(p));
            for j in family(&strip, second) {
                let rhombus = strip.strip(j as f64, (j + 1) as f64, |p| n * second(p));
                for k in family(&rhombus, third) {
                    let cell = rhombus.strip(k as f64, (k + 1) as f64, |p| n * third(p));
                    let area = cell.area();
                    if area > 0.0 {
                        let middle = barycentric(cell.middle()).map(|b| b as f32);
                        visit(patches.at(t as u32, middle, front).map(|i| i as usize), 2.0 * area);
                    }
                }
            }
        }
    }
}

/// All three barycentric coordinates from the first two.
fn barycentric(p: DVec2) -> [f64; 3] {
    [p.x, p.y, (1.0 - p.x - p.y).max(0.0)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        lightmap::{Coordinates, Layout},
        patch::Subdivision,
        trace::Tracer,
    };

    #[test]
    fn patches_are_covered_whole_and_once() {
        let scene = Scene::load(concat!(env!("CARGO_MANIFEST_DIR"), "/meshes/cornell-box.obj")).unwrap();
        let atlas =
            Atlas::new(&scene, &Tracer::new(&scene), Layout::Resolution(100), Coordinates::Auto).unwrap();
        let patches = Patches::subdivide(&scene, &Subdivision::Count(2000));
        let coverage = Coverage::new(&scene, &atlas);
        let mut covered = vec![0.0; patches.fronts()];
        for i in 0..coverage.len() {
            for piece in coverage.pieces(i) {
                let t = piece.triangle as usize;
                let part = coverage.barycentric_part(&atlas, i, t);
                part.for_each_patch(&patches, t, true, |patch, share| {
                    covered[patch.unwrap()] += share * patches.triangle_areas()[t];
                });
            }
        }
        for (i, area) in covered.iter().enumerate() {
            assert!((area / patches.area(i) - 1.0).abs() < 1e-9, "patch {i}: {area} of {}", patches.area(i));
        }
    }
}
