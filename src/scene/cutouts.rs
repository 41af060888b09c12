//! Cut-outs: fences, leaves and grilles whose texture has holes.
//!
//! Texels with an alpha below a half are holes. All others are surface ([`Texture::is_solid`]). The reader cuts
//! triangles along the borders of the texels, exactly. After that, rays pass through holes without looking at a
//! texture, and areas, emitted power and means count the surface alone. A test of the texture at each hit would be
//! simpler here, but the origins of rays, the areas of patches and the exact light of lamps would then need such tests
//! too.

use std::collections::HashMap;

use glam::{DVec2, DVec3};

use super::{
    Scene, Texture, TextureMap,
    cutting::{self, Chain, within},
};

/// Largest number of pieces that all cut-outs of a scene may make. Each piece is at least one patch.
const MOST_PIECES: usize = 4_000_000;
/// Largest number of texels along all grid lines of the texture on one triangle.
const MOST_TEXELS: f64 = 3e8;
/// Points count as one if they are closer than this, as a share of an edge or in texels.
const SAME: f64 = 1e-9;

/// The error of a scene that cannot be cut: a material with too many pieces.
pub(super) struct TooFine {
    pub(super) material: String,
}

/// Cuts the holes of all materials with cut-outs, and leaves out the faces of absent materials.
pub(super) fn cut(scene: &mut Scene) -> Result<(), TooFine> {
    let absent = |t: usize| scene.material(t).absent;
    let mut left: HashMap<u32, Vec<[u32; 3]>> = HashMap::new();
    left.extend((0..scene.triangles.len()).filter(|&t| absent(t)).map(|t| (t as u32, Vec::new())));
    let textures = std::mem::take(&mut scene.textures);
    let cut = cut_all(scene, &textures, &mut left);
    scene.textures = textures;
    let chains = cut?;
    if !left.is_empty() {
        let cuts = cutting::cuts(scene, chains, Vec::new());
        cutting::replace(scene, &left, &cuts);
        scene.forget_unused_vertices();
    }
    Ok(())
}

/// Cuts all triangles with holes and adds their rests to `left`. Returns the new vertices on edges.
fn cut_all(
    scene: &mut Scene,
    textures: &[Texture],
    left: &mut HashMap<u32, Vec<[u32; 3]>>,
) -> Result<Vec<Chain>, TooFine> {
    let mut chains = Vec::new();
    let mut edges = EdgeVertices::default();
    let mut pieces = 0;
    for t in 0..scene.triangles.len() {
        let material = scene.material(t);
        let Some(map) = material.cutout.clone().filter(|_| !material.absent) else { continue };
        let texture = &textures[map.texture];
        let mut sheet = Sheet::new(scene, t, texture, &map);
        let fine = sheet.texels() <= MOST_TEXELS;
        if let Some(parts) =
            if fine { sheet.cut(scene, texture, &map, &mut edges, &mut chains) } else { None }
        {
            pieces += parts.len();
            left.insert(t as u32, parts);
        }
        if !fine || pieces > MOST_PIECES {
            return Err(TooFine { material: scene.material(t).name.clone() });
        }
    }
    Ok(chains)
}

/// The new vertices on edges. The key is an edge, its lower vertex first. Each vertex has its fraction of the way from
/// that end.
#[derive(Default)]
struct EdgeVertices(HashMap<[u32; 2], Vec<(f64, u32)>>);

impl EdgeVertices {
    /// The vertex at a place. Makes a new one if there is none yet.
    fn at(&mut self, scene: &mut Scene, ends: [u32; 2], share: f64) -> u32 {
        let known = self.0.entry(ends).or_default();
        if let Some((_, v)) = known.iter().find(|(other, _)| (other - share).abs() < SAME) {
            return *v;
        }
        let [a, b] = ends.map(|v| scene.vertices[v as usize]);
        scene.vertices.push(a + (b - a) * share);
        let v = scene.vertices.len() as u32 - 1;
        known.push((share, v));
        v
    }
}

/// A triangle in the grid of its texture.
struct Sheet {
    vertices: [u32; 3],
    corners: [DVec3; 3],
    /// Its corners, then other points, in texels, and the vertices of the scene at these points.
    points: Vec<DVec2>,
    named: Vec<u32>,
    lattice: HashMap<[i64; 2], usize>,
    /// Vertices on the edge from each corner to the next, with their fraction of the way from its lower vertex.
    on_edges: [Vec<(f64, usize)>; 3],
    outline: Vec<[usize; 2]>,
}

/// Where a grid line meets the outline of the triangle: at a corner, or at a fraction of an edge.
#[derive(Clone, Copy)]
enum End {
    Corner(usize),
    Edge(usize, f64),
}

/// Moves a point onto the grid lines that it misses by rounding only.
fn snap(p: DVec2) -> DVec2 {
    let line = p.round();
    DVec2::select((p - line).abs().cmple(DVec2::splat(1e-7)), line, p)
}

impl Sheet {
    fn new(scene: &Scene, t: usize, texture: &Texture, map: &TextureMap) -> Sheet {
        let vertices = scene.triangles[t].vertices;
        let uv = scene.texcoords.get(t).copied().unwrap_or_default();
        Sheet {
            vertices,
            corners: scene.corners(t),
            points: uv.map(|p| snap(texture.to_texels(map, p))).to_vec(),
            named: vertices.to_vec(),
            lattice: HashMap::new(),
            on_edges: Default::default(),
            outline: Vec::new(),
        }
    }

    fn bounds(&self) -> [DVec2; 2] {
        let [a, b, c] = [self.points[0], self.points[1], self.points[2]];
        [a.min(b).min(c), a.max(b).max(c)]
    }

    /// Number of texels along the grid lines.
    fn texels(&self) -> f64 {
        let [low, high] = self.bounds();
        let size = (high - low).ceil() + 1.0;
        2.0 * size.x * size.y
    }

    /// The rest of the triangle; `None` if nothing is cut away.
    fn cut(
        &mut self,
        scene: &mut Scene,
        texture: &Texture,
        map: &TextureMap,
        edges: &mut EdgeVertices,
        chains: &mut Vec<Chain>,
    ) -> Option<Vec<[u32; 3]>> {
        let solid = |x: i64, y: i64| texture.is_solid(map, x, y);
        let winding = (self.points[1] - self.points[0]).perp_dot(self.points[2] - self.points[0]);
        let centre = (self.points[0] + self.points[1] + self.points[2]) / 3.0;
        let at = |p: DVec2| solid(p.x.floor() as i64, p.y.floor() as i64);
        if winding.abs() > SAME {
            for axis in [0, 1] {
                self.cut_along(scene, edges, axis, &solid);
            }
        }
        let flat = winding.abs() <= SAME;
        if flat || (self.outline.is_empty() && self.on_edges.iter().all(Vec::is_empty)) {
            if at(centre) { None } else { Some(Vec::new()) }
        } else {
            self.close(winding.signum(), &at, chains);
            let name = |piece: [usize; 3]| {
                let [a, b, c] = piece.map(|v| self.named[v]);
                if winding > 0.0 { [a, b, c] } else { [a, c, b] }
            };
            Some(within(&self.points, &self.outline).into_iter().map(name).collect())
        }
    }

    /// Adds the borders between solid texels and holes along the grid lines perpendicular to an axis.
    fn cut_along(
        &mut self,
        scene: &mut Scene,
        edges: &mut EdgeVertices,
        axis: usize,
        solid: &impl Fn(i64, i64) -> bool,
    ) {
        let [low, high] = self.bounds();
        let first = low[axis].floor() as i64 + 1;
        for line in first..high[axis].ceil() as i64 {
            let Some(ends) = self.ends(axis, line as f64) else { continue };
            let texel = |side: i64, along: i64| {
                if axis == 0 { solid(line + side, along) } else { solid(along, line + side) }
            };
            let differs = |along: i64| texel(-1, along) != texel(0, along);
            let [from, to] = ends.map(|(along, _)| along);
            // `SAME` keeps out a texel that the line only touches at its end.
            let (start, stop) = ((from + SAME).floor() as i64, (to - SAME).ceil() as i64);
            let mut begin = None;
            for along in start..stop {
                // A border ends where it crosses another border, so that both have a corner there.
                let crossed = along > start && texel(-1, along - 1) != texel(-1, along);
                if begin.is_some() && (!differs(along) || crossed) {
                    let end = self.lattice_point(scene, axis, line, along);
                    self.outline.extend(begin.take().map(|begin| [begin, end]));
                }
                if differs(along) && begin.is_none() {
                    begin = Some(if along == start {
                        self.end_point(scene, edges, ends[0].1)
                    } else {
                        self.lattice_point(scene, axis, line, along)
                    });
                }
            }
            if let Some(begin) = begin {
                let end = self.end_point(scene, edges, ends[1].1);
                self.outline.push([begin, end]);
            }
        }
    }

    /// Where a grid line enters and leaves the triangle. `None` if it runs along an edge or only touches a corner.
    fn ends(&self, axis: usize, line: f64) -> Option<[(f64, End); 2]> {
        let mut ends = Vec::with_capacity(3);
        for k in 0..3 {
            let next = (k + 1) % 3;
            if self.points[k][axis] == line {
                ends.push((self.points[k][1 - axis], End::Corner(k)));
            }
            // The lower vertex comes first, so that both triangles at an edge compute the same point.
            let (i, j) = if self.vertices[k] < self.vertices[next] { (k, next) } else { (next, k) };
            let (p, q) = (self.points[i], self.points[j]);
            if (p[axis] - line) * (q[axis] - line) < 0.0 {
                let share = (line - p[axis]) / (q[axis] - p[axis]);
                ends.push((p[1 - axis] + (q[1 - axis] - p[1 - axis]) * share, End::Edge(k, share)));
            }
        }
        ends.sort_by(|a, b| a.0.total_cmp(&b.0));
        match ends[..] {
            [(_, End::Corner(_)), (_, End::Corner(_))] => None,
            [a, b] if b.0 - a.0 > SAME => Some([a, b]),
            _ => None,
        }
    }

    fn end_point(&mut self, scene: &mut Scene, edges: &mut EdgeVertices, end: End) -> usize {
        match end {
            End::Corner(k) => k,
            End::Edge(k, share) if !(SAME..=1.0 - SAME).contains(&share) => {
                let next = (k + 1) % 3;
                let lower = if self.vertices[k] < self.vertices[next] { k } else { next };
                if share < SAME { lower } else { k + next - lower }
            }
            End::Edge(k, share) => {
                let [p, q] = [self.vertices[k], self.vertices[(k + 1) % 3]];
                let named = edges.at(scene, [p.min(q), p.max(q)], share);
                if let Some(&(_, known)) = self.on_edges[k].iter().find(|(_, v)| self.named[*v] == named) {
                    return known;
                }
                let [i, j] = if p < q { [k, (k + 1) % 3] } else { [(k + 1) % 3, k] };
                let at = self.points[i] + (self.points[j] - self.points[i]) * share;
                self.points.push(at);
                self.named.push(named);
                self.on_edges[k].push((share, self.points.len() - 1));
                self.points.len() - 1
            }
        }
    }

    /// The corner of texels at position `along` on a grid line.
    fn lattice_point(&mut self, scene: &mut Scene, axis: usize, line: i64, along: i64) -> usize {
        let key = if axis == 0 { [line, along] } else { [along, line] };
        *self.lattice.entry(key).or_insert_with(|| {
            let p = DVec2::new(key[0] as f64, key[1] as f64);
            let [a, b, c] = [self.points[0], self.points[1], self.points[2]];
            let [u, v, w] = [(b - p).perp_dot(c - p), (c - p).perp_dot(a - p), (a - p).perp_dot(b - p)];
            let [i, j, k] = self.corners;
            scene.vertices.push((i * u + j * v + k * w) / (u + v + w));
            self.points.push(p);
            self.named.push(scene.vertices.len() as u32 - 1);
            self.points.len() - 1
        })
    }

    /// Adds the parts of the triangle's edges that border on surface. Adds the vertices on the edges to `chains`.
    fn close(&mut self, winding: f64, at: &impl Fn(DVec2) -> bool, chains: &mut Vec<Chain>) {
        for k in 0..3 {
            let next = (k + 1) % 3;
            let on = &mut self.on_edges[k];
            on.sort_by(|a, b| a.0.total_cmp(&b.0));
            let (lower, upper) = if self.vertices[k] < self.vertices[next] { (k, next) } else { (next, k) };
            let inward = (self.points[next] - self.points[k]).normalize().perp() * winding;
            let mut from = lower;
            for to in on.iter().map(|&(_, v)| v).chain([upper]) {
                let (p, q) = (self.points[from], self.points[to]);
                // The test point lies just inside, because the edge may run along a grid line.
                let beside = (p + q) * 0.5 + inward * (1e-6 * p.distance(q)).min(1e-6);
                if at(beside) {
                    self.outline.push([from, to]);
                }
                from = to;
            }
            let ends = [self.vertices[lower], self.vertices[upper]];
            let between = on.iter().map(|&(_, v)| self.named[v]).collect();
            chains.push(Chain { ends, between });
        }
    }
}
