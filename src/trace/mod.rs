//! Ray tracing. The solver and the path tracer share only this module and the scene.
//!
//! All rays run in *unit space*: the scene is moved and rescaled so that its longest side is 2. So single precision resolves a
//! scene in millimetres, or 10 km from its origin, as well as any other. The origin lies where the scene has its finest detail
//! (`space.rs`), since single precision resolves small coordinates best.

mod bvh;
mod collapse;
mod flight;
mod gaps;
mod query;
pub mod sampling;
mod side;
pub(crate) mod sobol;
mod space;
mod watertight;
mod wide;

use glam::{BVec3A, DVec3, Vec3A};
use rayon::prelude::*;

use crate::scene::{Scene, direction};
use bvh::Bvh;
use query::{Free, Nearest};
use space::UnitSpace;
use watertight::Met;
use wide::Kernel;

pub use gaps::Gap;
pub use side::Side;

/// The point where a ray hits a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Index into [`Scene::triangles`].
    pub triangle: u32,
    /// Whether the ray came from the side where the vertices run counter-clockwise.
    pub front: bool,
    /// Distance in unit space, in multiples of the length of the ray's direction.
    pub t: f32,
    /// Barycentric coordinates of the point, one weight for each corner.
    pub barycentric: [f32; 3],
}

impl Hit {
    fn new(met: Met) -> Self {
        Hit { triangle: met.triangle, front: met.front(), t: met.t, barycentric: met.barycentric() }
    }

    /// Reflectance of the surface there, R G B.
    #[inline]
    pub fn reflectance(&self, scene: &Scene) -> [f64; 3] {
        scene.reflectance_at(self.triangle as usize, self.barycentric.map(f64::from))
    }

    /// Radiance that the surface emits there, W/(m² sr), R G B. Backs emit nothing.
    #[inline]
    pub fn emission(&self, scene: &Scene) -> [f64; 3] {
        if self.front && scene.emits(self.triangle as usize) {
            scene.emission_at(self.triangle as usize, self.barycentric.map(f64::from))
        } else {
            [0.0; 3]
        }
    }
}

/// A triangle in unit space.
#[derive(Debug, Clone, Copy)]
pub struct UnitTriangle {
    /// Corners.
    pub corners: [Vec3A; 3],
    /// Unit normal of the front.
    pub normal: Vec3A,
    /// Corners of the triangle from which rays start: each edge is moved inward ([`distances_to_edges`]).
    inner: [Vec3A; 3],
    /// The largest magnitude of the corners' coordinates, by axis.
    reach: Vec3A,
}

/// Half a unit in the last place of 1.
const ROUNDING: f64 = 0.5 * f32::EPSILON as f64;

impl UnitTriangle {
    /// `keep` holds one distance for the edge from each corner to the next: rays start at least that far from the edge. Coordinates
    /// are rounded at least as much as numbers of magnitude `least`.
    fn new(corners: [DVec3; 3], normal: Vec3A, keep: [f64; 3], least: f64) -> Self {
        let [a, b, c] = corners;
        let doubled = (b - a).cross(c - a).length();
        // The least barycentric coordinate of each corner: the distance to keep from the opposite edge, over the
        // height. If nothing is left, the triangle shrinks to a point.
        let weights = [1, 2, 0].map(|k| keep[k] * (corners[(k + 1) % 3] - corners[k]).length());
        let sum: f64 = weights.iter().sum();
        let whole = sum.max(doubled);
        let (least_weight, rest) = (weights.map(|w| w / whole), (1.0 - sum / whole).max(0.0));
        let inner =
            |k: usize| a * least_weight[0] + b * least_weight[1] + c * least_weight[2] + corners[k] * rest;
        UnitTriangle {
            corners: corners.map(|p| p.as_vec3a()),
            normal,
            inner: [inner(0), inner(1), inner(2)].map(|p| p.as_vec3a()),
            reach: reach(corners).max(DVec3::splat(least)).as_vec3a(),
        }
    }

    /// The point with these barycentric coordinates, for rays to start from.
    #[inline]
    pub fn point(&self, b: [f32; 3]) -> Vec3A {
        self.inner[0] * b[0] + self.inner[1] * b[1] + self.inner[2] * b[2]
    }

    /// Normal of the front or the back.
    #[inline]
    pub fn side_normal(&self, front: bool) -> Vec3A {
        if front { self.normal } else { -self.normal }
    }

    /// The front or the back, for rays to leave.
    #[inline]
    pub fn side(&self, front: bool) -> Side {
        Side::new(self.side_normal(front), self.reach)
    }
}

/// The largest magnitude of coordinates, by axis.
fn reach(corners: [DVec3; 3]) -> DVec3 {
    corners.into_iter().fold(DVec3::ZERO, |reach, corner| reach.max(corner.abs()))
}

/// The scene's triangles, ready for rays.
pub struct Tracer {
    bvh: Bvh,
    kernel: Kernel,
    space: UnitSpace,
}

impl std::fmt::Debug for Tracer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Tracer").field("triangles", &self.triangles().len()).finish_non_exhaustive()
    }
}

impl Tracer {
    /// Builds the bounding volume hierarchy over the scene's triangles.
    pub fn new(scene: &Scene) -> Tracer {
        Tracer::with_kernel(scene, Kernel::detect())
    }

    /// Like [`Tracer::new`], but without AVX2 instructions, which only some processors have. The results are the same
    /// bytes, but casting rays takes longer.
    pub fn portable(scene: &Scene) -> Tracer {
        Tracer::with_kernel(scene, Kernel::Portable)
    }

    fn with_kernel(scene: &Scene, kernel: Kernel) -> Tracer {
        let space = UnitSpace::of(scene);
        let keep = distances_to_edges(scene, &space);
        let triangles: Vec<UnitTriangle> = (0..scene.triangles.len())
            .map(|t| {
                let corners = scene.corners(t).map(|p| space.to_unit(p));
                UnitTriangle::new(corners, scene.normal(t).as_vec3a(), keep[t], space.least)
            })
            .collect();
        Tracer { bvh: Bvh::new(triangles, &distinct(scene)), kernel, space }
    }

    /// The triangles in unit space, in the order of [`Scene::triangles`].
    pub fn triangles(&self) -> &[UnitTriangle] {
        &self.bvh.triangles
    }

    /// A point of the file in unit space.
    pub fn to_unit(&self, point: DVec3) -> Vec3A {
        self.space.to_unit(point).as_vec3a()
    }

    /// The same in double precision.
    pub(crate) fn to_unit_exactly(&self, point: DVec3) -> DVec3 {
        self.space.to_unit(point)
    }

    /// A point of unit space in the file's coordinates.
    pub fn to_file(&self, point: Vec3A) -> DVec3 {
        point.as_dvec3() * self.space.scale + self.space.origin
    }

    /// Length in the file's unit of one length in unit space.
    pub fn scale(&self) -> f64 {
        self.space.scale
    }

    /// A side that is no triangle's, at a point of unit space: that of a sensor.
    pub(crate) fn side_at(&self, point: Vec3A, normal: Vec3A) -> Side {
        Side::new(normal, point.abs().max(Vec3A::splat(self.space.least as f32)))
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.bvh.bytes() + size_of_val(self.triangles())
    }

    /// The first triangle that the ray hits. The direction must not be zero; it need not have unit length.
    #[inline]
    pub fn closest(&self, origin: Vec3A, direction: Vec3A) -> Option<Hit> {
        self.kernel.ask::<Nearest>(&self.bvh, origin, direction).map(Hit::new)
    }

    /// [`Tracer::closest`] for many rays. Each has a name, an origin and a direction. Calls `found` with the name of a ray and its
    /// hit, in the order in which rays end, which is the same on every machine. Twice as fast in scenes with many triangles.
    pub fn closest_each<T>(
        &self,
        rays: impl IntoIterator<Item = (T, Vec3A, Vec3A)>,
        mut found: impl FnMut(T, Option<Hit>),
    ) {
        self.kernel.ask_each::<Nearest, T>(&self.bvh, rays, |name, met| found(name, met.map(Hit::new)));
    }

    /// Whether no triangle lies between two points, in whichever order they are given. Both should be moved off their surfaces by
    /// [`Side::leave_towards`].
    #[inline(always)]
    pub fn visible(&self, from: Vec3A, to: Vec3A) -> bool {
        let (from, to) = finer_first(from, to);
        self.kernel.ask::<Free>(&self.bvh, from, to - from)
    }

    /// [`Tracer::visible`] for many pairs of points. Each has a name. Calls `found` with the name of a pair and whether the points
    /// see each other, in the order in which rays end.
    pub fn visible_each<T>(
        &self,
        pairs: impl IntoIterator<Item = (T, Vec3A, Vec3A)>,
        found: impl FnMut(T, bool),
    ) {
        let rays = pairs.into_iter().map(|(name, from, to)| {
            let (from, to) = finer_first(from, to);
            (name, from, to - from)
        });
        self.kernel.ask_each::<Free, T>(&self.bvh, rays, found);
    }
}

/// Two points, first the one with the smaller coordinates. A ray is most exact where it starts.
#[inline(always)]
fn finer_first(p: Vec3A, q: Vec3A) -> (Vec3A, Vec3A) {
    // No branch: which one is finer cannot be predicted.
    let swap = BVec3A::splat(side::is_finer(q, p));
    (Vec3A::select(swap, q, p), Vec3A::select(swap, p, q))
}

/// How far points to start from stay away from the edge from each corner of a triangle to the next.
///
/// Rounding moves a point computed on a triangle by some ulp of its coordinates, and the planes of the triangles next to it as well.
/// Near an edge that can carry the point through the adjoining wall, out of a closed room. So rays start at least ten roundings from
/// the edges, of the largest coordinates of all triangles at the end of the edge where these are larger.
///
/// Rays begin 14 roundings above the surface, up to √3 times as far where it is oblique to the axes ([`Side::leave`]). Where two
/// triangles meet in an edge at a small angle, a point next to the edge may come to lie on the far side of the other one: outside a
/// closed roof. At a distance of 48 roundings times the cotangent of the angle it does not: 24 for the height, 4 for the ulp
/// outward, 20 for the point and the two planes. That holds for all triangles that have an end of the edge as a corner: they too are
/// below the roof there.
///
/// Vertices at one place count as one: the two sides of a line of contact have vertices of their own.
fn distances_to_edges(scene: &Scene, space: &UnitSpace) -> Vec<[f64; 3]> {
    const INSET: f64 = 10.0;
    const HEIGHT: f64 = 48.0;
    /// Cosine above which two triangles lie on each other rather than meet at an angle: a twentieth of a degree.
    const CLOSED: f64 = 1.0 - 4e-7;
    let places = places(scene);
    let vertices = |t: usize| scene.triangles[t].vertices.map(|v| places[v as usize]);
    let mut rounding = vec![0.0f64; scene.vertices.len()];
    let mut edges: Vec<(u32, u32, u32)> = Vec::with_capacity(3 * scene.triangles.len());
    for t in 0..scene.triangles.len() {
        let corners = scene.corners(t).map(|p| space.to_unit(p));
        let of_triangle = ROUNDING * reach(corners).max_element().max(space.least);
        let ends = vertices(t);
        for k in 0..3 {
            let (p, q) = (ends[k], ends[(k + 1) % 3]);
            edges.push((p.min(q), p.max(q), (3 * t + k) as u32));
            rounding[p as usize] = rounding[p as usize].max(of_triangle);
        }
    }
    edges.par_sort_unstable();
    let inward = |slot: u32| {
        let (t, k) = ((slot / 3) as usize, (slot % 3) as usize);
        let corners = scene.corners(t);
        let along = direction(corners[(k + 1) % 3] - corners[k]).unwrap_or(DVec3::X);
        let across = direction(corners[(k + 2) % 3] - corners[k]).unwrap_or(DVec3::X);
        (across - along * along.dot(across)).normalize_or_zero()
    };
    let mut from_corners: Vec<f64> = rounding.iter().map(|rounding| INSET * rounding).collect();
    for edge in edges.chunk_by(|e, f| (e.0, e.1) == (f.0, f.1)).filter(|edge| edge.len() > 1) {
        // Each triangle at an edge is compared with this number of next ones. If there are more, they form a fan, in
        // which neighbours are closest. All pairs would take quadratic time.
        const NEXT: usize = 8;
        let pairs = |k: usize| edge[k + 1..].iter().take(NEXT).map(move |f| [edge[k].2, f.2]);
        for pair in (0..edge.len()).flat_map(pairs) {
            let cos = inward(pair[0]).dot(inward(pair[1]));
            if cos > 0.0 && cos < CLOSED {
                let ends = [edge[0].0, edge[0].1].map(|v| v as usize);
                let rounding = rounding[ends[0]].max(rounding[ends[1]]);
                let far = rounding * (INSET + HEIGHT * cos / (1.0 - cos * cos).sqrt());
                for v in ends {
                    from_corners[v] = far.max(from_corners[v]);
                }
            }
        }
    }
    let keep = |t: usize| {
        let [a, b, c] = vertices(t).map(|v| from_corners[v as usize]);
        [a.max(b), b.max(c), c.max(a)]
    };
    (0..scene.triangles.len()).map(keep).collect()
}

/// Of each vertex, the first one at its place.
fn places(scene: &Scene) -> Vec<u32> {
    let bits = |v: u32| (scene.vertices[v as usize] + 0.0).to_array().map(f64::to_bits);
    let mut order: Vec<u32> = (0..scene.vertices.len() as u32).collect();
    order.par_sort_unstable_by_key(|&v| (bits(v), v));
    let mut places = vec![0; order.len()];
    for same in order.chunk_by(|&v, &w| bits(v) == bits(w)) {
        same.iter().for_each(|&v| places[v as usize] = same[0]);
    }
    places
}

/// The scene's triangles without duplicates: triangles with the corners of an earlier one in the same order. A ray hits both at
/// once, and the lower index wins. With many equal boxes, building the hierarchy would take quadratic time.
fn distinct(scene: &Scene) -> Vec<u32> {
    let corners = |t: u32| scene.triangles[t as usize].vertices;
    let mut kept: Vec<u32> = (0..scene.triangles.len() as u32).collect();
    kept.par_sort_unstable_by_key(|&t| (corners(t), t));
    kept.dedup_by_key(|t| corners(*t));
    kept.par_sort_unstable();
    kept
}
