//! Pairs of polygons: what they would exchange if nothing stood between them, and what rays told of the visible share of it.

use glam::Vec3A;
use rayon::prelude::*;

use super::polygon::Polygon;
use crate::{
    Progress, Result,
    form_factor::{exact::exchange_area_to, kernel},
};

/// What counts for a pair whose rays all met the same: as if so many more had been both free and blocked.
const DOUBT: f64 = 0.1;

/// Samples of equal weight that those of a pair are worth at least, so that none is no certainty; and how many rays one takes
/// at most: of polygons that single precision cannot tell apart none may ever meet the other.
const LEAST_SAMPLES: f64 = 1.0;
const MOST_RAYS: f64 = 100.0;

/// Distances of centres, in sums of radii, up to which closed forms are needed, and beyond which the fewest points do.
pub(super) const NEAR: f64 = 1.1;
const FAR: f64 = 2.0;

/// How well what is unoccluded is known at least, relatively, and from how many radii on points do for that, where polygons are
/// near or reach behind each other.
const PRECISION: f64 = 1e-3;
const RADII: f64 = 2.0;

/// What is unoccluded may be off by this share of the error wanted.
const UNOCCLUDED: f64 = 0.1;

/// Two polygons that would see each other if nothing stood between them.
#[derive(Clone, Copy)]
pub(super) struct Pair {
    pub(super) i: u32,
    pub(super) j: u32,
    /// A_i F_ij if nothing did.
    pub(super) unoccluded: f32,
    pub(super) rays: u32,
    pub(super) wanted: u32,
    /// Sums of the weights of all rays, of the free ones, and of their squares.
    pub(super) weights: f32,
    pub(super) free: f32,
    pub(super) squares: f32,
}

impl Pair {
    fn visible(&self) -> f32 {
        if self.weights > 0.0 { self.free / self.weights } else { 0.0 }
    }

    /// A_i F_ij.
    pub(super) fn exchange(&self) -> f32 {
        self.unoccluded * self.visible()
    }

    /// Standard deviation of the visible share by one ray. Rays of unequal weights are worth fewer of equal ones (Kish, *Survey
    /// Sampling*, sec. 11.7).
    pub(super) fn deviation(&self) -> f64 {
        let [weights, squares] = [self.weights, self.squares].map(f64::from);
        let worth = if squares > 0.0 { weights * weights / squares } else { 0.0 };
        let share = (f64::from(self.visible()) * worth + DOUBT) / (worth + 2.0 * DOUBT);
        let rays = (f64::from(self.rays.max(1)) / worth.max(LEAST_SAMPLES)).min(MOST_RAYS);
        (share * (1.0 - share) * rays).sqrt()
    }

    /// Variance of A_i F_ij.
    pub(super) fn variance(&self) -> f64 {
        (f64::from(self.unoccluded) * self.deviation()).powi(2) / f64::from(self.rays.max(1))
    }
}

/// All pairs that would see each other, by rows. `sum` is what the errors of a row may sum up to.
pub(super) fn pairs(polygons: &[Polygon], sum: f64, progress: &Progress) -> Result<Vec<Pair>> {
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
    progress.begin("pairing polygons", polygons.len() as u64);
    let row = |i: usize| {
        progress.advance(1);
        let others = if progress.is_stopped() { 0..0 } else { i + 1..polygons.len() };
        others.filter_map(move |j| pair(i, j))
    };
    let pairs = (0..polygons.len()).into_par_iter().flat_map_iter(row).collect();
    progress.check()?;
    Ok(pairs)
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
