//! View factors between all pairs of a few hundred or thousand polygons, as heat transfer wants them: each accurate by
//! itself, where a lighting solution wants but their sums.
//!
//! What two polygons would exchange if nothing stood between them is known: by Gauss-Legendre products where they are apart,
//! by [closed forms](super::exact) where they are near. Only the visible share of it is sampled, by rays between points
//! of both, weighted by the kernel (a ratio estimator; Cochran, *Sampling Techniques*, ch. 6): where all see each other
//! nothing is left to chance. Rays go to pairs in proportion to their standard deviations, which is what lowers the sum of
//! variances most (Neyman, 1934), in rounds that each learn from the ones before.

use glam::{DVec3, Vec3A};
use rayon::prelude::*;

use super::{
    FormFactors, Matrix,
    exact::{exchange_area_to, nodes},
    ordered_sum,
    shadow::kernel,
};
use crate::{
    Progress, Result,
    scene::{Material, Scene},
    trace::{
        Tracer,
        sampling::{mix, sobol_4d, square_to_triangle},
    },
};

/// How accurate view factors are wanted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewFactorOptions {
    /// RMS error over all pairs that independent samples would have. These are stratified, and had 0.2 to 0.6 of it in rooms of
    /// 500 and 2000 polygons. Below about 10⁻⁵ what is unoccluded is known no better.
    pub error: f64,
    /// Whether the polygons enclose a room: then rows sum to one exactly, else what is missing from them escapes.
    pub enclosed: bool,
    /// The same seed gives the same bytes, whatever the number of threads.
    pub seed: u64,
}

impl Default for ViewFactorOptions {
    /// 10⁻⁴, enclosed, seed 0.
    fn default() -> Self {
        ViewFactorOptions { error: 1e-4, enclosed: true, seed: 0 }
    }
}

/// Points keep this share of a polygon's size from its edges: rounding would carry them through the adjoining wall.
const INSET: f32 = 1e-5;

/// The most rays of a pair in the first round.
const FIRST: f64 = 8.0;

/// By how much the rays of a pair may grow in a round, as a multiple of what it had.
const GROWTH: f64 = 4.0;

/// What counts for a pair whose rays all met the same: as if so many more had been both free and blocked.
const DOUBT: f32 = 0.1;

/// Points of a pair's sequence before a new one begins.
const SEQUENCE: u32 = 1 << 12;

/// No further round is worth it for a smaller share of the rays cast.
const ENOUGH: f64 = 0.05;

/// Distances of centres, in sums of radii, up to which closed forms are needed, and beyond which the fewest points do.
const NEAR: f64 = 1.1;
const FAR: f64 = 2.0;

/// How well what is unoccluded is wanted, and from how many radii on points do for that, where polygons are near or reach
/// behind each other.
const PRECISION: f64 = 1e-3;
const RADII: f64 = 2.0;

/// A polygon in unit space, or in the file's.
struct Polygon {
    corners: Vec<DVec3>,
    /// The first corner, for rays to start from.
    origin: Vec3A,
    edges: [Vec3A; 2],
    normal: DVec3,
    area: f64,
    centre: DVec3,
    radius: f64,
    /// Points with weights that sum to the area, four and nine of a parallelogram.
    nodes: [Vec<(Vec3A, f32)>; 2],
}

impl Polygon {
    fn new(corners: Vec<DVec3>) -> Polygon {
        assert!(matches!(corners.len(), 3 | 4), "polygons are triangles or parallelograms");
        let [a, b] = [corners[1] - corners[0], corners[corners.len() - 1] - corners[0]];
        if let [p, _, r, _] = corners[..] {
            assert!(
                (r - p - a - b).length() <= 1e-6 * (r - p).length(),
                "a quadrilateral is no parallelogram"
            );
        }
        let double_area = a.cross(b);
        assert!(double_area.length() > 0.0, "a polygon has no area");
        let normal = double_area.normalize();
        let centre = corners.iter().sum::<DVec3>() / corners.len() as f64;
        Polygon {
            // Off the surface once for the rounding of the origin, and once for that of what is added to it.
            origin: Tracer::leave(Tracer::leave(corners[0].as_vec3a(), normal.as_vec3a()), normal.as_vec3a()),
            edges: [a, b].map(|e| e.as_vec3a()),
            normal,
            area: double_area.length() * if corners.len() == 3 { 0.5 } else { 1.0 },
            radius: corners.iter().map(|p| p.distance(centre)).fold(0.0, f64::max),
            centre,
            nodes: [2, 3]
                .map(|n| nodes(&corners, n).iter().map(|&(p, w)| (p.as_vec3a(), w as f32)).collect()),
            corners,
        }
    }

    fn triangles(&self) -> impl Iterator<Item = [DVec3; 3]> + '_ {
        (2..self.corners.len()).map(|k| [self.corners[0], self.corners[k - 1], self.corners[k]])
    }

    fn point(&self, u: f32, v: f32) -> Vec3A {
        let [a, b] = if self.corners.len() == 3 {
            let [_, b, c] = square_to_triangle(u, v);
            [b, c].map(|x| INSET / 3.0 + (1.0 - INSET) * x)
        } else {
            [u, v].map(|x| INSET / 2.0 + (1.0 - INSET) * x)
        };
        self.origin + self.edges[0] * a + self.edges[1] * b
    }

    /// Whether it is wholly, and whether it is partly, in front of another's plane.
    fn in_front(&self, of: &Polygon) -> (bool, bool) {
        let slack = 1e-9 * of.radius;
        let height = |p: &DVec3| (*p - of.corners[0]).dot(of.normal);
        (self.corners.iter().all(|p| height(p) >= -slack), self.corners.iter().any(|p| height(p) > slack))
    }
}

/// Two polygons that would see each other if nothing stood between them.
#[derive(Clone, Copy)]
struct Pair {
    i: u32,
    j: u32,
    /// A_i F_ij if nothing did.
    unoccluded: f32,
    rays: u32,
    wanted: u32,
    /// Sums of the kernels of all rays, of the free ones.
    kernels: f32,
    free: f32,
}

impl Pair {
    fn visible(&self) -> f32 {
        if self.kernels > 0.0 { self.free / self.kernels } else { 0.0 }
    }

    /// A_i F_ij.
    fn exchange(&self) -> f32 {
        self.unoccluded * self.visible()
    }

    /// Standard deviation of a sample of the visible share.
    fn deviation(&self) -> f64 {
        let rays = self.rays as f32;
        let share = (self.visible() * rays + DOUBT) / (rays + 2.0 * DOUBT);
        f64::from((share * (1.0 - share)).sqrt())
    }
}

/// View factors, and how they came about.
#[derive(Debug, Clone)]
pub struct ViewFactors {
    /// F_ij of the polygons in the order given: reciprocal, and rows close.
    pub form_factors: FormFactors,
    /// Rays cast.
    pub rays: u64,
    /// RMS error over all pairs that as many independent samples would have.
    pub error: f64,
}

/// View factors between triangles and parallelograms, each by its corners, counter-clockwise where it is seen. They see each
/// other from that side, and block each other from both. Takes 28 bytes a pair that could see each other.
///
/// # Errors
/// [`Error::Stopped`](crate::Error::Stopped) when `progress` says so.
///
/// # Panics
/// When a polygon is neither triangle nor parallelogram, or has no area, or no positive error is wanted.
pub fn view_factors(
    polygons: &[Vec<DVec3>],
    options: &ViewFactorOptions,
    progress: &Progress,
) -> Result<ViewFactors> {
    assert!(options.error > 0.0, "the error must be positive");
    let tracer = tracer_of_blockers(polygons);
    let (centre, scale) = (tracer.to_file(Vec3A::ZERO), tracer.scale());
    let in_unit_space = |p: &Vec<DVec3>| Polygon::new(p.iter().map(|&v| (v - centre) / scale).collect());
    let polygons: Vec<Polygon> = polygons.iter().map(in_unit_space).collect();
    let mut pairs = pairs(&polygons);
    let (rays, error) = sample(&mut pairs, &polygons, &tracer, options, progress)?;
    let mean = polygons.iter().map(|p| p.area).sum::<f64>() / polygons.len() as f64;
    // In units of the mean area no exchange area leaves the range of single precision.
    let areas: Vec<f64> = polygons.iter().map(|p| p.area / mean).collect();
    let matrix = upper_triangle(&pairs, areas.len(), mean as f32);
    let mut escaped = vec![0.0; areas.len()];
    if !options.enclosed {
        escaped.fill(1.0);
        for (&exchange, (i, j)) in &matrix {
            for k in [i as usize, j as usize] {
                escaped[k] -= f64::from(exchange) / areas[k];
            }
        }
        escaped.iter_mut().for_each(|e| *e = e.max(0.0));
    }
    let mut form_factors = FormFactors::from_exchange(matrix, areas, escaped);
    form_factors.areas.iter_mut().for_each(|area| *area *= mean * scale * scale);
    Ok(ViewFactors { form_factors, rays, error })
}

/// A tracer of the polygons that have others behind them: the rest, like the walls of a room, block nothing.
fn tracer_of_blockers(polygons: &[Vec<DVec3>]) -> Tracer {
    let polygons: Vec<Polygon> = polygons.iter().map(|p| Polygon::new(p.clone())).collect();
    let blocks = |p: &&Polygon| polygons.iter().any(|q| !q.in_front(p).0);
    let blockers: Vec<&Polygon> = polygons.par_iter().filter(blocks).collect();
    let triangles: Vec<([DVec3; 3], u32)> =
        blockers.iter().flat_map(|p| p.triangles()).map(|t| (t, 0)).collect();
    Tracer::new(&Scene::new(&triangles, vec![Material::new("polygons", [0.0; 3], [0.0; 3])]))
}

/// All pairs that would see each other, by rows.
fn pairs(polygons: &[Polygon]) -> Vec<Pair> {
    let pair = |i: usize, j: usize| {
        let unoccluded = unoccluded(&polygons[i], &polygons[j]) as f32;
        let (i, j) = (i as u32, j as u32);
        (unoccluded > 0.0).then_some(Pair { i, j, unoccluded, rays: 0, wanted: 0, kernels: 0.0, free: 0.0 })
    };
    let row = |i: usize| (i + 1..polygons.len()).filter_map(move |j| pair(i, j));
    (0..polygons.len()).into_par_iter().flat_map_iter(row).collect()
}

/// Casts rays until the error is as wanted. Returns how many, and the error.
fn sample(
    pairs: &mut [Pair],
    polygons: &[Polygon],
    tracer: &Tracer,
    options: &ViewFactorOptions,
    progress: &Progress,
) -> Result<(u64, f64)> {
    // What a deviation of the visible share does to both view factors of a pair.
    let weight = |pair: &Pair| {
        let [a, b] = [pair.i, pair.j].map(|k| polygons[k as usize].area);
        f64::from(pair.unoccluded) * (1.0 / (a * a) + 1.0 / (b * b)).sqrt()
    };
    let (n, sequence) = (polygons.len() as f64, sequence());
    let mut rays = 0;
    loop {
        let sum = ordered_sum(pairs.len(), |k| weight(&pairs[k]) * pairs[k].deviation());
        let rays_per_deviation = sum / (n * options.error).powi(2);
        let want = |pair: &mut Pair| {
            let most = if pair.rays == 0 { FIRST } else { (1.0 + GROWTH) * f64::from(pair.rays) };
            pair.wanted = (weight(pair) * pair.deviation() * rays_per_deviation).min(most).ceil() as u32;
            u64::from(pair.wanted.saturating_sub(pair.rays))
        };
        let more: u64 = pairs.par_iter_mut().map(want).sum();
        if more as f64 <= ENOUGH * rays as f64 {
            let variance =
                |pair: &Pair| (weight(pair) * pair.deviation()).powi(2) / f64::from(pair.rays.max(1));
            return Ok((rays, ordered_sum(pairs.len(), |k| variance(&pairs[k])).sqrt() / n));
        }
        rays += more;
        pairs.par_iter_mut().for_each(|pair| cast(pair, polygons, tracer, &sequence, options.seed));
        progress.check()?;
    }
}

/// The exchange areas of pairs that are sorted by rows, in this unit of area.
fn upper_triangle(pairs: &[Pair], n: usize, unit: f32) -> Matrix {
    let seen: Vec<&Pair> = pairs.iter().filter(|pair| pair.free > 0.0).collect();
    let starts = (0..=n).map(|i| seen.partition_point(|pair| (pair.i as usize) < i)).collect();
    let columns = seen.iter().map(|pair| pair.j).collect();
    Matrix::new((n, n), starts, columns, seen.iter().map(|pair| pair.exchange() / unit).collect())
}

/// What two polygons would exchange if nothing stood between them.
fn unoccluded(p: &Polygon, q: &Polygon) -> f64 {
    let ((p_all, p_any), (q_all, q_any)) = (p.in_front(q), q.in_front(p));
    if !p_any || !q_any {
        return 0.0;
    }
    let ratio = p.centre.distance(q.centre) / (p.radius + q.radius);
    if !(p_all && q_all && ratio > NEAR) {
        return exchange_area_to(&p.corners, &q.corners, RADII, PRECISION);
    }
    let (n, m) = (p.normal.as_vec3a(), q.normal.as_vec3a());
    let theirs = &q.nodes[usize::from(ratio < FAR)];
    let from = |&(x, w): &(Vec3A, f32)| w * theirs.iter().map(|&(y, v)| v * kernel(y - x, n, m)).sum::<f32>();
    f64::from(p.nodes[usize::from(ratio < FAR)].iter().map(from).sum::<f32>())
}

/// Points of one scrambled Sobol sequence, as fractions of 2³². Pairs shift its digits, each in its own way, which keeps what is
/// even about it (digital shift; Dick and Pillichshammer, *Digital Nets and Sequences*, sec. 4.4).
fn sequence() -> Vec<[u32; 4]> {
    (0..SEQUENCE).map(|index| sobol_4d(index, 0).map(|x| (x * 2f32.powi(32)) as u32)).collect()
}

/// Casts the rays that a pair wants more of.
fn cast(pair: &mut Pair, polygons: &[Polygon], tracer: &Tracer, sequence: &[[u32; 4]], seed: u64) {
    let [p, q] = [pair.i, pair.j].map(|k| &polygons[k as usize]);
    let (n, m) = (p.normal.as_vec3a(), q.normal.as_vec3a());
    let start = pair.rays;
    pair.rays = pair.rays.max(pair.wanted);
    for block in start / SEQUENCE..pair.rays.div_ceil(SEQUENCE) {
        let shift = [0, 1].map(|k| mix(&[seed, u64::from(pair.i), u64::from(pair.j), u64::from(block), k]));
        let range = start.max(block * SEQUENCE)..pair.rays.min((block + 1) * SEQUENCE);
        for index in range {
            let digits = sequence[(index % SEQUENCE) as usize];
            let shifted =
                |k: usize| (digits[k] ^ (shift[k / 2] >> (32 * (k % 2))) as u32) as f32 * 2f32.powi(-32);
            let (from, to) = (p.point(shifted(0), shifted(1)), q.point(shifted(2), shifted(3)));
            let d = to - from;
            if d.dot(n) > 0.0 && d.dot(m) < 0.0 {
                let kernel = kernel(d, n, m);
                pair.kernels += kernel;
                if tracer.visible(from, to) {
                    pair.free += kernel;
                }
            }
        }
    }
}
