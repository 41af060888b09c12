//! View factors between all pairs of a few hundred or thousand polygons, as heat transfer wants them: each accurate by
//! itself, where a lighting solution wants but their sums.
//!
//! What two polygons would exchange if nothing stood between them is known: by Gauss-Legendre products where they are apart,
//! by [closed forms](super::exact) where they are near. Only the visible share of it is sampled (a ratio estimator; Cochran,
//! *Sampling Techniques*, ch. 6): where all see each other nothing is left to chance. Polygons that are apart are sampled by
//! rays between points of both, weighted by the kernel. Between neighbours that has a singularity, and its square no integral:
//! there rays leave the smaller one as light does, and those count that would meet the other. Rays go to pairs in proportion to their standard deviations, which is what lowers the sum of
//! variances most (Neyman, 1934), in rounds that each learn from the ones before.
//!
//! A surface may be of several polygons: their exchange areas A_i F_ij sum up, and so do the variances of these.

use glam::{DVec3, Vec3A};
use rayon::prelude::*;

use super::{
    FormFactors, Matrix,
    exact::{exchange_area_to, nodes},
    ordered_sum,
    shadow::kernel,
};
use crate::{
    Error, Progress, Result,
    scene::{Material, Scene},
    trace::{
        Tracer,
        sampling::{mix, sobol_4d, square_to_triangle},
    },
};

/// How accurate view factors are wanted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewFactorOptions {
    /// RMS error over all pairs that independent samples would have. These are stratified, and had 0.35 to 0.65 of it in rooms of
    /// 500 and 2000 polygons. Not in it is what is unoccluded, which is known to about 10⁻³ of itself, or to a tenth of this
    /// error if that is less; single precision ends at about 10⁻⁷.
    pub error: f64,
    /// Whether the polygons enclose a room and show it their fronts: then rows sum to one exactly, else what is missing from
    /// them escapes, or is caught by backs.
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
const DOUBT: f64 = 0.1;

/// Distance of centres, in sums of radii, up to which rays leave the smaller polygon as light does, if at least such a share of
/// its light meets the other.
const NEIGHBOURS: f64 = NEAR;
const LEAST_SHARE: f64 = 0.1;

/// Samples of equal weight that those of a pair are worth at least, so that none is no certainty; and how many rays one takes
/// at most: of polygons that single precision cannot tell apart none may ever meet the other.
const LEAST_SAMPLES: f64 = 1.0;
const MOST_RAYS: f64 = 100.0;

/// Points of a pair's sequence before a new one begins.
const SEQUENCE: u32 = 1 << 12;

/// The most pairs that a thread casts the rays of at a time.
const TOGETHER: usize = 256;

/// Distances of centres, in sums of radii, up to which closed forms are needed, and beyond which the fewest points do.
const NEAR: f64 = 1.1;
const FAR: f64 = 2.0;

/// How well what is unoccluded is known at least, relatively, and from how many radii on points do for that, where polygons are
/// near or reach behind each other.
const PRECISION: f64 = 1e-3;
const RADII: f64 = 2.0;

/// What is unoccluded may be off by this share of the error wanted.
const UNOCCLUDED: f64 = 0.1;

/// A sum of view factors is off one where it is so by more than this, and by more than so many standard errors.
const OFF: f64 = 0.01;
const STANDARD_ERRORS: f64 = 5.0;

/// What the corners of a quadrilateral may be off those of a parallelogram by, relative to its diagonal: files round.
const SKEW: f64 = 1e-5;

/// Whether these corners are a parallelogram's, but for rounding.
fn is_parallelogram(corners: &[DVec3]) -> bool {
    matches!(*corners, [p, q, r, s] if (r - q - (s - p)).length() <= SKEW * (r - p).length())
}

/// A polygon in unit space.
struct Polygon {
    /// Which surface it is of.
    surface: u32,
    corners: Vec<DVec3>,
    /// The first corner, for rays to start from.
    origin: Vec3A,
    edges: [Vec3A; 2],
    /// What gives a point of the plane in multiples of the edges.
    duals: [Vec3A; 2],
    normal: DVec3,
    /// The same, for rays.
    facing: Vec3A,
    is_triangle: bool,
    area: f64,
    centre: DVec3,
    radius: f64,
    /// Points with weights that sum to the area, four and nine of a parallelogram.
    nodes: [Vec<(Vec3A, f32)>; 2],
}

impl Polygon {
    fn new(corners: Vec<DVec3>, surface: u32) -> Polygon {
        assert!(matches!(corners.len(), 3 | 4), "polygons are triangles or parallelograms");
        assert!(corners.len() == 3 || is_parallelogram(&corners), "a quadrilateral is no parallelogram");
        let [a, b] = [corners[1] - corners[0], corners[corners.len() - 1] - corners[0]];
        let double_area = a.cross(b);
        assert!(double_area.length() > 0.0, "a polygon has no area");
        let normal = double_area.normalize();
        let centre = corners.iter().sum::<DVec3>() / corners.len() as f64;
        Polygon {
            surface,
            // Off the surface once for the rounding of the origin, and once for that of what is added to it.
            origin: Tracer::leave(Tracer::leave(corners[0].as_vec3a(), normal.as_vec3a()), normal.as_vec3a()),
            edges: [a, b].map(|e| e.as_vec3a()),
            duals: [b.cross(normal), normal.cross(a)].map(|d| (d / double_area.length()).as_vec3a()),
            normal,
            facing: normal.as_vec3a(),
            is_triangle: corners.len() == 3,
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

    #[inline]
    fn point(&self, u: f32, v: f32) -> Vec3A {
        if self.is_triangle {
            let [_, b, c] = square_to_triangle(u, v);
            self.at(b, c)
        } else {
            self.at(u, v)
        }
    }

    /// The point at these multiples of the edges, a little off them.
    #[inline]
    fn at(&self, a: f32, b: f32) -> Vec3A {
        let middle = if self.is_triangle { 1.0 / 3.0 } else { 0.5 };
        let inset = |x: f32| INSET * middle + (1.0 - INSET) * x;
        self.origin + self.edges[0] * inset(a) + self.edges[1] * inset(b)
    }

    /// Where a ray meets its front.
    #[inline]
    fn met(&self, from: Vec3A, direction: Vec3A) -> Option<Vec3A> {
        let start = from - self.origin;
        let (height, descent) = (start.dot(self.facing), -direction.dot(self.facing));
        if !(height > 0.0 && descent > 0.0) {
            return None;
        }
        let foot = start + direction * (height / descent);
        let (a, b) = (foot.dot(self.duals[0]), foot.dot(self.duals[1]));
        let most = if self.is_triangle { 1.0 - a } else { 1.0 };
        ((0.0..=1.0).contains(&a) && b >= 0.0 && b <= most).then(|| self.at(a, b))
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
    /// Sums of the weights of all rays, of the free ones, and of their squares.
    weights: f32,
    free: f32,
    squares: f32,
}

impl Pair {
    fn visible(&self) -> f32 {
        if self.weights > 0.0 { self.free / self.weights } else { 0.0 }
    }

    /// A_i F_ij.
    fn exchange(&self) -> f32 {
        self.unoccluded * self.visible()
    }

    /// Standard deviation of the visible share by one ray. Rays of unequal weights are worth fewer of equal ones (Kish, *Survey
    /// Sampling*, sec. 11.7).
    fn deviation(&self) -> f64 {
        let [weights, squares] = [self.weights, self.squares].map(f64::from);
        let worth = if squares > 0.0 { weights * weights / squares } else { 0.0 };
        let share = (f64::from(self.visible()) * worth + DOUBT) / (worth + 2.0 * DOUBT);
        let rays = (f64::from(self.rays.max(1)) / worth.max(LEAST_SAMPLES)).min(MOST_RAYS);
        (share * (1.0 - share) * rays).sqrt()
    }

    /// Variance of A_i F_ij.
    fn variance(&self) -> f64 {
        (f64::from(self.unoccluded) * self.deviation()).powi(2) / f64::from(self.rays.max(1))
    }
}

/// View factors, and how they came about.
#[derive(Debug, Clone)]
pub struct ViewFactors {
    /// F_ij of the surfaces in the order given: reciprocal, and rows close.
    pub form_factors: FormFactors,
    /// Rays cast.
    pub rays: u64,
    /// RMS error over all pairs that as many independent samples would have: at most the one wanted, unless more than 2³² rays
    /// of a pair would be needed.
    pub error: f64,
    /// Sums of the rows as sampled, before they were closed.
    pub row_sums: Vec<f64>,
    /// Standard errors of exchange areas, in units of the mean area; the upper triangle.
    errors: Matrix,
    /// Areas in the same unit.
    areas: Vec<f64>,
}

impl ViewFactors {
    /// The standard error of F_ij that as many independent samples would have, before rows are closed.
    pub fn standard_error(&self, i: usize, j: usize) -> f64 {
        let (row, column) = (i.min(j), i.max(j));
        let (columns, errors) = super::row(&self.errors, row);
        columns.binary_search(&(column as u32)).map_or(0.0, |k| f64::from(errors[k]) / self.areas[i])
    }

    /// The largest standard error, and of which F_ij it is.
    pub fn largest_standard_error(&self) -> Option<(usize, usize, f64)> {
        let of_pair = |(&e, (i, j)): (&f32, (u32, u32))| {
            let (i, j) = (i as usize, j as usize);
            let (i, j) = if self.areas[j] < self.areas[i] { (j, i) } else { (i, j) };
            (i, j, f64::from(e) / self.areas[i])
        };
        self.errors.iter().map(of_pair).reduce(|a, b| if b.2 > a.2 { b } else { a })
    }

    /// The surfaces whose view factors summed up to more than 1 before rows were closed, beyond what chance explains: there are
    /// others at the same place.
    pub fn overfull_rows(&self) -> Vec<usize> {
        let allowed = allowances(&self.errors, &self.areas);
        (0..self.row_sums.len()).filter(|&i| self.row_sums[i] > 1.0 + allowed[i]).collect()
    }
}

/// What the sum of each row may be off one by.
fn allowances(errors: &Matrix, areas: &[f64]) -> Vec<f64> {
    let variances = sums_of_rows(errors, areas.len(), |error| error * error);
    let allowed = |(variance, area): (&f64, &f64)| STANDARD_ERRORS * variance.sqrt() / area;
    variances.iter().zip(areas).map(|pair| OFF.max(allowed(pair))).collect()
}

/// The sums of the rows of a symmetric matrix, of which this is the upper triangle.
fn sums_of_rows(upper: &Matrix, n: usize, value: impl Fn(f64) -> f64) -> Vec<f64> {
    let mut sums = vec![0.0; n];
    for (&entry, (i, j)) in upper {
        let value = value(f64::from(entry));
        sums[i as usize] += value;
        if i != j {
            sums[j as usize] += value;
        }
    }
    sums
}

/// The surface that contradicts most that all of them enclose a room.
fn check_enclosed(row_sums: &[f64], errors: &Matrix, areas: &[f64]) -> Result<()> {
    let allowed = allowances(errors, areas);
    // Of nothing no diagonal makes one.
    let open = |&i: &usize| row_sums[i] <= 0.0 || row_sums[i] < 1.0 - allowed[i];
    match (0..areas.len()).filter(open).min_by(|&a, &b| row_sums[a].total_cmp(&row_sums[b])) {
        Some(surface) => Err(Error::NotEnclosed { surface, sum: row_sums[surface] }),
        None => Ok(()),
    }
}

/// View factors between triangles and parallelograms, each by its corners, counter-clockwise where it is seen. They see each
/// other from that side, and block each other from both. Takes 32 bytes a pair that could see each other, and 16 for the result.
///
/// # Errors
/// [`Error::NotEnclosed`] when they were said to enclose a room and do not, [`Error::Stopped`] when `progress` says so.
///
/// # Panics
/// When a polygon is neither triangle nor parallelogram, or has no area, or no positive error is wanted.
pub fn view_factors(
    polygons: &[Vec<DVec3>],
    options: &ViewFactorOptions,
    progress: &Progress,
) -> Result<ViewFactors> {
    let surfaces: Vec<&[Vec<DVec3>]> = polygons.iter().map(std::slice::from_ref).collect();
    view_factors_of_surfaces(&surfaces, options, progress)
}

/// View factors between surfaces, each a list of polygons as [`view_factors`] takes them. A surface may see itself.
///
/// # Errors
/// Those of [`view_factors`].
///
/// # Panics
/// As [`view_factors`], or when a surface has no polygon.
pub fn view_factors_of_surfaces(
    surfaces: &[impl AsRef<[Vec<DVec3>]>],
    options: &ViewFactorOptions,
    progress: &Progress,
) -> Result<ViewFactors> {
    assert!(options.error > 0.0, "the error must be positive");
    let (polygons, scale) = in_unit_space(surfaces);
    let mut areas = vec![0.0; surfaces.len()];
    polygons.iter().for_each(|p| areas[p.surface as usize] += p.area);
    assert!(areas.iter().all(|&area| area > 0.0), "a surface has no polygon");
    let mean = areas.iter().sum::<f64>() / areas.len() as f64;
    let mut pairs = pairs(&polygons, areas.len() as f64 * options.error, progress)?;
    let (rays, error) = sample(&mut pairs, &polygons, &areas, options, progress)?;
    // In units of the mean area no exchange area leaves the range of single precision.
    areas.iter_mut().for_each(|area| *area /= mean);
    let [matrix, errors] = upper_triangles(&pairs, &polygons, areas.len(), mean);
    let mut row_sums = sums_of_rows(&matrix, areas.len(), |exchange| exchange);
    row_sums.iter_mut().zip(&areas).for_each(|(sum, area)| *sum /= area);
    if options.enclosed {
        check_enclosed(&row_sums, &errors, &areas)?;
    }
    let escapes = |sum: &f64| if options.enclosed { 0.0 } else { (1.0 - sum).max(0.0) };
    let escaped = row_sums.iter().map(escapes).collect();
    let mut form_factors = FormFactors::from_exchange(matrix, areas.clone(), escaped);
    form_factors.areas.iter_mut().for_each(|area| *area *= mean * scale * scale);
    Ok(ViewFactors { form_factors, rays, error, row_sums, errors, areas })
}

/// The polygons recentred and rescaled so that their largest coordinate is 1, and how many of their lengths that is.
fn in_unit_space(surfaces: &[impl AsRef<[Vec<DVec3>]>]) -> (Vec<Polygon>, f64) {
    let all = || (0..).zip(surfaces).flat_map(|(k, s)| s.as_ref().iter().map(move |polygon| (k, polygon)));
    let corners = || all().flat_map(|(_, polygon)| polygon);
    let low = corners().fold(DVec3::INFINITY, |low, &v| low.min(v));
    let high = corners().fold(DVec3::NEG_INFINITY, |high, &v| high.max(v));
    // Halved first: the sum of two large coordinates may overflow.
    let (centre, scale) = (low * 0.5 + high * 0.5, (high * 0.5 - low * 0.5).max_element());
    let polygon = |(k, corners): (u32, &Vec<DVec3>)| {
        Polygon::new(corners.iter().map(|&v| (v - centre) / scale).collect(), k)
    };
    (all().map(polygon).collect(), scale)
}

/// A tracer of the polygons that have others behind them: the rest, like the walls of a room, block nothing.
fn tracer_of_blockers(polygons: &[Polygon]) -> Tracer {
    let blocks = |p: &&Polygon| polygons.iter().any(|q| !q.in_front(p).0);
    let blockers: Vec<&Polygon> = polygons.par_iter().filter(blocks).collect();
    let triangles: Vec<([DVec3; 3], u32)> =
        blockers.iter().flat_map(|p| p.triangles()).map(|t| (t, 0)).collect();
    let mut scene = Scene::new(&triangles, vec![Material::new("polygons", [0.0; 3], [0.0; 3])]);
    // Its unit space is that of all: blockers may be small, and rays come from afar.
    scene.vertices.extend(polygons.iter().flat_map(|p| &p.corners));
    Tracer::new(&scene)
}

/// All pairs that would see each other, by rows. `sum` is what the errors of a row may sum up to.
fn pairs(polygons: &[Polygon], sum: f64, progress: &Progress) -> Result<Vec<Pair>> {
    let precision = (UNOCCLUDED * sum).clamp(f64::EPSILON, PRECISION);
    let pair = |i: usize, j: usize| {
        let unoccluded = unoccluded(&polygons[i], &polygons[j], precision) as f32;
        let (i, j) = (i as u32, j as u32);
        (unoccluded > 0.0).then_some(Pair {
            i,
            j,
            unoccluded,
            rays: 0,
            wanted: 0,
            weights: 0.0,
            free: 0.0,
            squares: 0.0,
        })
    };
    progress.begin(polygons.len() as u64);
    let row = |i: usize| {
        progress.advance(1);
        let others = if progress.is_stopped() { 0..0 } else { i + 1..polygons.len() };
        others.filter_map(move |j| pair(i, j))
    };
    let pairs = (0..polygons.len()).into_par_iter().flat_map_iter(row).collect();
    progress.check()?;
    Ok(pairs)
}

/// Casts rays until the error is as wanted. Returns how many, and the error.
fn sample(
    pairs: &mut [Pair],
    polygons: &[Polygon],
    areas: &[f64],
    options: &ViewFactorOptions,
    progress: &Progress,
) -> Result<(u64, f64)> {
    // What a deviation of the visible share does to both view factors of a pair of surfaces, or to the one of a surface
    // and itself, in which each pair of polygons counts twice.
    let weight = |pair: &Pair| {
        let [i, j] = [pair.i, pair.j].map(|k| polygons[k as usize].surface);
        let [a, b] = [i, j].map(|k| areas[k as usize]);
        let squares = 1.0 / (a * a) + 1.0 / (b * b);
        f64::from(pair.unoccluded) * if i == j { 2.0 * squares } else { squares }.sqrt()
    };
    let (n, tracer, sequence) = (areas.len() as f64, tracer_of_blockers(polygons), sequence());
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
        let variance = |pair: &Pair| (weight(pair) * pair.deviation()).powi(2) / f64::from(pair.rays.max(1));
        let error = ordered_sum(pairs.len(), |k| variance(&pairs[k])).sqrt() / n.max(1.0);
        // Once each pair has as many as it wants, so it is.
        if more == 0 || (rays > 0 && error <= options.error) {
            return Ok((rays, error));
        }
        rays += more;
        progress.begin(more);
        let cast_some = |pairs: &mut [Pair]| {
            let rays = |pairs: &[Pair]| pairs.iter().map(|p| u64::from(p.rays)).sum::<u64>();
            let before = rays(pairs);
            pairs
                .iter_mut()
                .for_each(|pair| cast(pair, polygons, &tracer, &sequence, options.seed, progress));
            progress.advance(rays(pairs) - before);
        };
        // Of few pairs each may have many rays.
        let together = (pairs.len() / TOGETHER).clamp(1, TOGETHER);
        pairs.par_chunks_mut(together).for_each(cast_some);
        progress.check()?;
    }
}

/// Of pairs that are sorted by rows, and polygons that are by surfaces: the exchange areas of surfaces, and their standard
/// errors, in this unit of area.
fn upper_triangles(pairs: &[Pair], polygons: &[Polygon], n: usize, unit: f64) -> [Matrix; 2] {
    let surface = |k: u32| polygons[k as usize].surface;
    let row = |i: usize| {
        let [start, end] = [0, 1].map(|k| pairs.partition_point(|p| (surface(p.i) as usize) < i + k));
        let mut cells: Vec<(u32, f64, f64)> =
            pairs[start..end].iter().map(|p| (surface(p.j), f64::from(p.exchange()), p.variance())).collect();
        cells.sort_by_key(|cell| cell.0);
        let merge = |same: &[(u32, f64, f64)]| {
            let sum = |value: fn(&(u32, f64, f64)) -> f64| same.iter().map(value).sum::<f64>();
            let twice = if same[0].0 as usize == i { 2.0 } else { 1.0 };
            let (exchange, error) = (twice * sum(|c| c.1), twice * sum(|c| c.2).sqrt());
            (same[0].0, (exchange / unit) as f32, (error / unit) as f32)
        };
        cells.chunk_by(|a, b| a.0 == b.0).map(merge).collect()
    };
    let rows: Vec<Vec<(u32, f32, f32)>> = (0..n).into_par_iter().map(row).collect();
    [false, true].map(|errors| {
        let (mut starts, mut columns, mut values) = (vec![0], Vec::new(), Vec::new());
        for row in &rows {
            let cells = row.iter().map(|&(j, exchange, error)| (j, if errors { error } else { exchange }));
            for (j, value) in cells.filter(|&(_, value)| value > 0.0) {
                columns.push(j);
                values.push(value);
            }
            starts.push(columns.len());
        }
        Matrix::new((n, n), starts, columns, values)
    })
}

/// What two polygons would exchange if nothing stood between them, to this relative precision.
fn unoccluded(p: &Polygon, q: &Polygon, precision: f64) -> f64 {
    let ((p_all, p_any), (q_all, q_any)) = (p.in_front(q), q.in_front(p));
    if !p_any || !q_any {
        return 0.0;
    }
    let ratio = p.centre.distance(q.centre) / (p.radius + q.radius);
    if precision < PRECISION || !(p_all && q_all && ratio > NEAR) {
        return exchange_area_to(&p.corners, &q.corners, RADII, precision);
    }
    let (n, m) = (p.facing, q.facing);
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
fn cast(
    pair: &mut Pair,
    polygons: &[Polygon],
    tracer: &Tracer,
    sequence: &[[u32; 4]],
    seed: u64,
    progress: &Progress,
) {
    let ends = Ends::of(pair, polygons);
    let [start, end] = [pair.rays, pair.rays.max(pair.wanted)].map(|rays| u64::from(rays) * ends.tries());
    pair.rays = pair.rays.max(pair.wanted);
    const UNIT: f32 = 1.0 / (1u64 << 32) as f32;
    // Millions may be summed up.
    let (mut weights, mut free, mut squares) = (0.0, 0.0, 0.0);
    let length = u64::from(SEQUENCE);
    for block in start / length..end.div_ceil(length) {
        if progress.is_stopped() {
            return;
        }
        let [a, b] = [0, 1].map(|k| mix(&[seed, u64::from(pair.i), u64::from(pair.j), block, k]));
        let shift = [a as u32, (a >> 32) as u32, b as u32, (b >> 32) as u32];
        for index in start.max(block * length)..end.min((block + 1) * length) {
            let digits = sequence[(index % length) as usize];
            let shifted = |k: usize| (digits[k] ^ shift[k]) as f32 * UNIT;
            if let Some((from, to, weight)) = ends.path([shifted(0), shifted(1), shifted(2), shifted(3)]) {
                weights += weight;
                squares += weight * weight;
                if tracer.visible(from, to) {
                    free += weight;
                }
            }
        }
    }
    let add = |sum: &mut f32, more: f64| *sum = (f64::from(*sum) + more) as f32;
    add(&mut pair.weights, weights);
    add(&mut pair.free, free);
    add(&mut pair.squares, squares);
}

/// How points of a pair are chosen.
enum Ends<'a> {
    /// Evenly on both, weighted by the kernel; the product of the areas over what they exchange, so that weights are near 1.
    Apart(&'a Polygon, &'a Polygon, f64),
    /// By rays that leave the first as light does: as many as one that meets the other takes, in a frame round its normal.
    Neighbours(&'a Polygon, &'a Polygon, u64, [Vec3A; 2]),
}

impl<'a> Ends<'a> {
    fn of(pair: &Pair, polygons: &'a [Polygon]) -> Ends<'a> {
        let [p, q] = [pair.i, pair.j].map(|k| &polygons[k as usize]);
        let (small, large) = if p.area <= q.area { (p, q) } else { (q, p) };
        let exchange = f64::from(pair.unoccluded);
        let share = exchange / small.area;
        if share >= LEAST_SHARE && p.centre.distance(q.centre) < NEIGHBOURS * (p.radius + q.radius) {
            // Of the points of a square a disk holds π / 4.
            let tries = (4.0 / std::f64::consts::PI / share).ceil() as u64;
            let across = small.edges[0].normalize();
            Ends::Neighbours(small, large, tries, [across, small.facing.cross(across)])
        } else {
            Ends::Apart(p, q, p.area * q.area / exchange)
        }
    }

    /// Points of the sequence a ray.
    fn tries(&self) -> u64 {
        if let Ends::Neighbours(_, _, tries, _) = self { *tries } else { 1 }
    }

    /// Two points and the weight of what they tell, if they face each other.
    #[inline]
    fn path(&self, [x, y, u, v]: [f32; 4]) -> Option<(Vec3A, Vec3A, f64)> {
        match *self {
            Ends::Apart(p, q, unit) => {
                let (from, to) = (p.point(x, y), q.point(u, v));
                let (d, n, m) = (to - from, p.facing, q.facing);
                (d.dot(n) > 0.0 && d.dot(m) < 0.0).then(|| (from, to, unit * f64::from(kernel(d, n, m))))
            }
            Ends::Neighbours(p, q, _, [across, along]) => {
                // Above even points of the disk directions have the density of light (Nusselt's analogue).
                let (s, t) = (2.0 * u - 1.0, 2.0 * v - 1.0);
                let squared = 1.0 - s * s - t * t;
                if squared <= 0.0 {
                    return None;
                }
                let from = p.point(x, y);
                let to = q.met(from, across * s + along * t + p.facing * squared.sqrt())?;
                Some((from, to, 1.0))
            }
        }
    }
}
