//! View factors between all pairs of surfaces, as heat transfer needs them: each is accurate by itself, while a
//! lighting solution needs only accurate sums.
//!
//! The exchange of two polygons with nothing between them is known: from Gauss-Legendre products if they are far apart,
//! from [closed forms](crate::form_factor::exact) if they are near. Their shaft shows without rays whether something is
//! between them. Only then rays estimate how much is hidden, by an unbiased estimator whose replicates give its
//! standard error. The number of rays of a pair is proportional to its standard deviation, which minimises the sum of
//! variances (Neyman, 1934).
//!
//! A surface may consist of several polygons. Its exchange areas A_i F_ij are the sums of theirs, and so are the
//! variances.

mod blockers;
mod cell;
mod closure;
mod clusters;
mod contact;
mod enclosure;
mod estimate;
mod join;
mod lost;
mod paths;
mod polygon;
mod rows;
mod shadows;
mod shaft;
mod symmetric;

use glam::DVec3;

use self::{
    blockers::Blockers,
    cell::{Cell, Spread},
    contact::{Parts, separate},
    polygon::{Polygon, in_unit_space},
    symmetric::Symmetric,
};
use crate::{Error, Progress, Result, form_factor::BeforeAfter};

pub use enclosure::{Enclosure, leaks};
pub use lost::{Lost, Share, Sight, most_open};

/// Options for view factors.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ViewFactorOptions {
    /// RMS standard error over all non-zero view factors. View factors between which nothing stands have a relative
    /// error of 10⁻⁵ in any case.
    pub error: f64,
    /// Whether the polygons enclose a room and show it their fronts. Rows then sum to one exactly. Otherwise the
    /// missing light escapes: it meets backs, or leaves the scene.
    pub enclosed: bool,
    /// The upward direction, which divides the light that leaves the scene.
    pub up: DVec3,
    /// The same seed gives the same bytes, whatever the number of threads.
    pub seed: u64,
}

setters!(ViewFactorOptions {
    with_error(error: f64),
    with_enclosed(enclosed: bool),
    with_up(up: DVec3),
    with_seed(seed: u64),
});

impl Default for ViewFactorOptions {
    /// Error 10⁻⁴, enclosed, y up, seed 0.
    fn default() -> Self {
        ViewFactorOptions { error: 1e-4, enclosed: true, up: DVec3::Y, seed: 0 }
    }
}

/// View factors, their errors, and how they were computed.
#[derive(Debug, Clone)]
pub struct ViewFactors {
    /// Number of rays cast, all for pairs with something between them.
    pub rays: u64,
    /// RMS standard error of all non-zero view factors, before rows were closed.
    pub error: f64,
    /// Row sums before rows were closed.
    pub row_sums: Vec<f64>,
    /// For each surface, where the light goes that reaches no surface.
    pub lost: Vec<Lost>,
    /// For each surface, the area that others in its plane hide. It takes no part in view factors.
    pub hidden: Vec<f64>,
    enclosed: bool,
    areas: Vec<f64>,
    /// Deviation of each row sum from one that its errors allow.
    allowed: Vec<f64>,
    /// Exchange areas in unit space.
    exchange: Symmetric,
    /// The unit of these areas.
    unit: f64,
}

impl ViewFactors {
    /// Number of surfaces.
    pub fn len(&self) -> usize {
        self.areas.len()
    }

    /// Whether there is no surface.
    pub fn is_empty(&self) -> bool {
        self.areas.is_empty()
    }

    /// The visible areas of the surfaces, in the square of the unit of length.
    pub fn areas(&self) -> &[f64] {
        &self.areas
    }

    /// The share of surface `i`'s light that reaches no surface.
    pub fn escaped(&self, i: usize) -> f64 {
        self.lost[i].escaped.value
    }

    /// The non-zero F_ij of row `i` as (j, F_ij), sorted by j.
    pub fn row(&self, i: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.entries(i).map(|(j, f, _)| (j, f)).filter(|&(_, f)| f > 0.0)
    }

    /// Columns, F_ij and standard errors of row `i`, sorted by column. Includes pairs that rays found to be zero but
    /// whose error is not.
    pub fn entries(&self, i: usize) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
        let area = self.areas[i] / self.unit;
        self.exchange.row(i).map(move |(j, cell)| (j, cell.exchange.max(0.0) / area, cell.error() / area))
    }

    /// F_ij.
    pub fn get(&self, i: usize, j: usize) -> f64 {
        self.exchange.get(i, j).map_or(0.0, |cell| cell.exchange.max(0.0) / (self.areas[i] / self.unit))
    }

    /// The standard error of F_ij. If nothing is between the two surfaces, it is the error of the formula.
    pub fn standard_error(&self, i: usize, j: usize) -> f64 {
        self.exchange.get(i, j).map_or(0.0, |cell| cell.error() / (self.areas[i] / self.unit))
    }

    /// Number of non-zero F_ij.
    pub fn non_zeros(&self) -> usize {
        let both = |(i, cell): (usize, &Cell)| if i == cell.column as usize { 1 } else { 2 };
        self.exchange.upper().filter(|(_, cell)| cell.exchange > 0.0).map(both).sum()
    }

    /// The largest standard error of a non-zero F_ij, as (i, j, error). Of F_ij and F_ji the one with the smaller area
    /// A_i has the larger error.
    pub fn largest_standard_error(&self) -> Option<(usize, usize, f64)> {
        let of = |(i, cell): (usize, &Cell)| {
            let j = cell.column as usize;
            let (i, j) = if self.areas[i] <= self.areas[j] { (i, j) } else { (j, i) };
            (i, j, cell.error() / (self.areas[i] / self.unit))
        };
        let all = self.exchange.upper().filter(|(_, cell)| cell.exchange > 0.0).map(of);
        all.reduce(|a, b| if b.2 > a.2 { b } else { a })
    }

    /// Largest |row sum + escaped share - 1|. `before` covers enclosed rooms only.
    pub fn row_sum_deviation(&self) -> BeforeAfter {
        let largest = |off: &dyn Fn(usize) -> f64| {
            (0..self.len()).filter(|&i| self.areas[i] > 0.0).map(off).fold(0.0, f64::max)
        };
        let after = |i: usize| (self.row(i).map(|(_, f)| f).sum::<f64>() + self.escaped(i) - 1.0).abs();
        let before = |i: usize| (self.row_sums[i] - 1.0).abs();
        BeforeAfter { before: if self.enclosed { largest(&before) } else { 0.0 }, after: largest(&after) }
    }

    /// Largest |A_i F_ij - A_j F_ji| / min(A_i, A_j).
    pub fn reciprocity_deviation(&self) -> BeforeAfter {
        let of = |(i, cell): (usize, &Cell)| {
            let [a, b] = [i, cell.column as usize].map(|k| self.areas[k]);
            let [f, back] = [a, b].map(|area| cell.exchange.max(0.0) / (area / self.unit));
            (a * f - b * back).abs() / a.min(b)
        };
        let after = self.exchange.upper().map(of).fold(0.0, f64::max);
        BeforeAfter { before: after, after }
    }

    /// The surfaces whose row sums exceeded 1 before closing by more than their errors allow. Other surfaces are at the
    /// same place.
    pub fn overfull_rows(&self) -> Vec<usize> {
        (0..self.len()).filter(|&i| self.row_sums[i] > 1.0 + self.allowed[i]).collect()
    }
}

/// View factors between convex planar polygons. Each is given by its corners, counterclockwise as seen from its front.
/// Polygons see each other by their fronts, and block each other from both sides.
///
/// # Errors
/// [`Error::NotEnclosed`] when the options say that the polygons enclose a room and they do not, [`Error::Stopped`]
/// when `progress` says so.
///
/// # Panics
/// When a polygon is not convex or not planar or has no area, or when the wanted error is not positive.
pub fn view_factors(
    polygons: &[Vec<DVec3>],
    options: &ViewFactorOptions,
    progress: &Progress,
) -> Result<ViewFactors> {
    let surfaces: Vec<&[Vec<DVec3>]> = polygons.iter().map(std::slice::from_ref).collect();
    view_factors_of_surfaces(&surfaces, options, progress)
}

/// Counts what rays from each surface meet. The counts show whether the surfaces enclose a room, and where they do not.
/// Every polygon casts some rays. Obstacles block from both sides and count as backs.
///
/// # Panics
/// As [`view_factors`].
pub fn look(surfaces: &[impl AsRef<[Vec<DVec3>]>], obstacles: &[Vec<DVec3>], up: DVec3) -> Vec<Sight> {
    let surfaces = &slices(surfaces);
    let (polygons, hindrances, _) = in_unit_space(surfaces, obstacles);
    let (places, blockers) = blockers(&polygons, &hindrances);
    let areas: Vec<f64> = polygons.iter().map(|polygon| polygon.area).collect();
    let Parts { pieces, .. } = separate(polygons, &places);
    let mut seen = vec![Sight::default(); surfaces.len()];
    for (piece, sight) in pieces.iter().zip(lost::look(&pieces, &areas, &blockers, up)) {
        let sum = &mut seen[piece.surface as usize];
        *sum = sum.and(sight);
    }
    seen
}

/// View factors between surfaces, each a list of polygons as in [`view_factors`]. A surface may see itself.
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
    view_factors_among(surfaces, &[], options, progress)
}

/// View factors between surfaces as in [`view_factors_of_surfaces`], with obstacles: polygons that block from both
/// sides and have no view factors of their own. Light that meets them escapes, like light that meets backs.
///
/// # Errors
/// Those of [`view_factors`].
///
/// # Panics
/// As [`view_factors_of_surfaces`].
pub fn view_factors_among(
    surfaces: &[impl AsRef<[Vec<DVec3>]>],
    obstacles: &[Vec<DVec3>],
    options: &ViewFactorOptions,
    progress: &Progress,
) -> Result<ViewFactors> {
    among(&slices(surfaces), obstacles, options, progress)
}

/// The blockers at the place of each polygon, for looking for contacts, and joined ones, for rays.
fn blockers(polygons: &[Polygon], obstacles: &[Polygon]) -> (Blockers, Blockers) {
    (Blockers::new(polygons, obstacles), Blockers::joined(polygons, obstacles))
}

fn slices(surfaces: &[impl AsRef<[Vec<DVec3>]>]) -> Vec<&[Vec<DVec3>]> {
    surfaces.iter().map(AsRef::as_ref).collect()
}

fn among(
    surfaces: &[&[Vec<DVec3>]],
    obstacles: &[Vec<DVec3>],
    options: &ViewFactorOptions,
    progress: &Progress,
) -> Result<ViewFactors> {
    assert!(options.error > 0.0, "the error must be positive");
    let n = surfaces.len();
    let (polygons, hindrances, scale) = in_unit_space(surfaces, obstacles);
    let (mut areas, mut hidden) = (vec![0.0; n], vec![0.0; n]);
    polygons.iter().for_each(|p| areas[p.surface as usize] += p.area);
    assert!(areas.iter().all(|&area| area > 0.0), "a surface has no polygon");
    let (places, blockers) = blockers(&polygons, &hindrances);
    let owners: Vec<u32> = polygons.iter().map(|p| p.surface).collect();
    let parts = separate(polygons, &places);
    drop(places);
    owners.iter().zip(&parts.hidden).for_each(|(&owner, area)| hidden[owner as usize] += area);
    areas.iter_mut().zip(&hidden).for_each(|(area, hidden)| *area = (*area - hidden).max(0.0));
    let mut found = rows::rows(&parts.pieces, &areas, &blockers, &parts.touching, options, progress)?;

    let divided = |sums: &[f64]| -> Vec<f64> {
        sums.iter().zip(&areas).map(|(sum, area)| if *area > 0.0 { sum / area } else { 0.0 }).collect()
    };
    let sums = |cells: &[Vec<Cell>], value: fn(&Cell) -> f64| divided(&closure::sums(cells, n, value));
    let row_sums = sums(&found.cells, |cell| cell.exchange);
    let errors = row_errors(&found.cells, &areas);
    // If rays agree by chance, all pairs of a row may be wrong in the same way, for example along an edge that few rays
    // reach.
    let doubts = sums(&found.cells, |cell| f64::from(cell.doubt));
    let allowed: Vec<f64> = errors
        .iter()
        .zip(&doubts)
        .map(|(error, doubt)| STANDARD_ERRORS * (error + doubt) + ROUNDING)
        .collect();
    let is_seen = |i: usize| areas[i] > 0.0;
    if options.enclosed {
        let open = |&i: &usize| is_seen(i) && (row_sums[i] <= 0.0 || row_sums[i] < 1.0 - allowed[i]);
        if let Some(surface) = (0..n).filter(open).min_by(|&a, &b| row_sums[a].total_cmp(&row_sums[b])) {
            return Err(Error::NotEnclosed { surface, sum: row_sums[surface] });
        }
    }
    let closing: Vec<bool> = (0..n).map(|i| is_seen(i) && (options.enclosed || row_sums[i] > 1.0)).collect();
    closure::close(&mut found.cells, &areas, &closing);
    let closed = sums(&found.cells, |cell| cell.exchange);
    let escaped: Vec<Share> = (0..n)
        .map(|i| match options.enclosed || !is_seen(i) {
            true => Share::default(),
            false => Share { value: (1.0 - closed[i]).max(0.0), error: errors[i] },
        })
        .collect();
    let lost = lost::divide(
        &escaped,
        &parts.pieces,
        &blockers,
        options.up,
        (options.error, options.seed),
        progress,
    )?;

    let square = scale * scale;
    Ok(ViewFactors {
        rays: found.rays,
        error: found.error,
        row_sums,
        lost,
        enclosed: options.enclosed,
        hidden: hidden.iter().map(|area| area * square).collect(),
        areas: areas.iter().map(|area| area * square).collect(),
        allowed,
        exchange: Symmetric::new(found.cells),
        unit: square,
    })
}

/// A row sum differs from one if the difference exceeds this many standard errors plus [`ROUNDING`].
const STANDARD_ERRORS: f64 = 5.0;
/// Gap left by polygons that adjoin except for rounding.
const ROUNDING: f64 = 2e-5;

/// The standard errors of row sums. Variances add up, but the formula's errors may all have the same sign.
fn row_errors(cells: &[Vec<Cell>], areas: &[f64]) -> Vec<f64> {
    let n = areas.len();
    let variances = closure::sums(cells, n, |cell| Spread::of(cell).variance);
    let quartics = closure::sums(cells, n, |cell| Spread::of(cell).quartic);
    let exchange = closure::sums(cells, n, |cell| cell.exchange);
    let mut doubts = vec![0f64; n];
    for (i, row) in cells.iter().enumerate() {
        for cell in row {
            for k in [i, cell.column as usize] {
                doubts[k] = doubts[k].max(f64::from(cell.doubt).powi(2));
            }
        }
    }
    (0..n)
        .map(|i| {
            let formula = polygon::FORMULA * exchange[i];
            if areas[i] > 0.0 {
                let spread = Spread { variance: variances[i], quartic: quartics[i] };
                (spread.variance() + doubts[i] + formula * formula).sqrt() / areas[i]
            } else {
                0.0
            }
        })
        .collect()
}
