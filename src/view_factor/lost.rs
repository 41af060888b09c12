//! Light that reaches no surface. Rays from all polygons estimate how much of it meets backs, and how much leaves the
//! scene upward and downward.

use glam::DVec3;
use rayon::prelude::*;

use super::{blockers::Blockers, estimate::SKEWNESS, polygon::Polygon};
use crate::{
    Progress, Result,
    trace::sampling::{around, mix, sobol_4d, square_to_cosine_hemisphere},
};

/// Number of rays for looking around, distributed by area.
const LOOK: f64 = 131_072.0;
/// Fewest of these rays for a whole polygon. Pieces get their share by area: slivers that rounding leaves beside a contact get none.
const FEWEST: f64 = 32.0;
/// Most rays that divide the escaping light of a surface. They give a standard error of 10⁻³ of the escaping light.
const MOST: f64 = (1u32 << 18) as f64;
/// Most rays that divide the escaping light of all surfaces.
const MOST_IN_ALL: f64 = (1u32 << 22) as f64;

/// Counts of what rays from a polygon or a surface met.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Sight {
    /// Number of rays cast.
    pub rays: u64,
    /// Rays that met the back of a polygon.
    pub backs: u64,
    /// Rays that left the scene upward or level.
    pub up: u64,
    /// Rays that left the scene downward.
    pub down: u64,
}

impl Sight {
    /// Rays that met no front.
    pub fn lost(&self) -> u64 {
        self.backs + self.up + self.down
    }

    /// Their share of all.
    pub fn lost_share(&self) -> f64 {
        self.lost() as f64 / self.rays.max(1) as f64
    }

    /// The sum of two counts.
    pub fn and(self, other: Sight) -> Sight {
        Sight {
            rays: self.rays + other.rays,
            backs: self.backs + other.backs,
            up: self.up + other.up,
            down: self.down + other.down,
        }
    }
}

/// The surface that loses the largest share of its rays. `None` if cracks between faces and chance explain all losses.
/// A room with larger losses is open, and its rows must not be closed, however uncertain they are.
pub fn most_open(seen: &[Sight]) -> Option<usize> {
    /// The share of rays that escape through cracks, which rounding leaves between adjoining polygons; and the number
    /// of standard errors of a count that chance explains.
    const CRACKS: f64 = 1e-4;
    const STANDARD_ERRORS: f64 = 3.0;
    let share = |i: usize| seen[i].lost_share();
    let is_open = |&i: &usize| {
        let lost = seen[i].lost() as f64;
        lost - STANDARD_ERRORS * lost.sqrt() > CRACKS * seen[i].rays as f64
    };
    (0..seen.len()).filter(is_open).max_by(|&i, &j| share(i).total_cmp(&share(j)))
}

/// Casts `rays` from a piece and counts what they meet.
fn sight(piece: &Polygon, blockers: &Blockers, up: DVec3, rays: u64, seed: u64) -> Sight {
    let name = blockers.name(piece.source);
    let mut sight = Sight { rays, ..Sight::default() };
    for k in 0..rays {
        let [x, y, u, v] = sobol_4d(k as u32, seed);
        let from = piece.whole.point(f64::from(x), f64::from(y));
        let direction = around(piece.normal.as_vec3a(), square_to_cosine_hemisphere(u, v)).as_dvec3();
        match blockers.first(from, direction, name) {
            Some(true) => {}
            Some(false) => sight.backs += 1,
            None if direction.dot(up) >= 0.0 => sight.up += 1,
            None => sight.down += 1,
        }
    }
    sight
}

/// Counts what rays from each piece meet. `areas` are those of whole polygons.
pub(super) fn look(pieces: &[Polygon], areas: &[f64], blockers: &Blockers, up: DVec3) -> Vec<Sight> {
    let total: f64 = pieces.iter().map(|piece| piece.area).sum();
    let mut rays = Vec::with_capacity(pieces.len());
    for own in pieces.chunk_by(|a, b| a.source == b.source) {
        let area: f64 = own.iter().map(|piece| piece.area).sum();
        let of_polygon = (LOOK * area / total).max(FEWEST * area / areas[own[0].source as usize]);
        let (mut sum, mut before) = (0.0, 0);
        for piece in own {
            sum += piece.area;
            let up_to = (of_polygon * sum / area).round() as u64;
            rays.push(up_to - before);
            before = up_to;
        }
    }
    let of_piece = |k: usize| sight(&pieces[k], blockers, up, rays[k], mix(&[u64::MAX, k as u64]));
    (0..pieces.len()).into_par_iter().map(of_piece).collect()
}

/// A share of a surface's light, and its standard error.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Share {
    /// The share.
    pub value: f64,
    /// Its standard error.
    pub error: f64,
}

/// The shares of a surface's light that reach no surface.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Lost {
    /// All of these shares together.
    pub escaped: Share,
    /// The share that meets backs.
    pub backs: Share,
    /// The share that leaves the scene.
    pub left: Share,
    /// The part of `left` that leaves upward or level.
    pub up: Share,
    /// The part of `left` that leaves downward.
    pub down: Share,
}

/// Divides the escaping share of each surface, which has a standard error. `error` is the wanted standard error.
pub(super) fn divide(
    escaped: &[Share],
    pieces: &[Polygon],
    blockers: &Blockers,
    up: DVec3,
    (error, seed): (f64, u64),
    progress: &Progress,
) -> Result<Vec<Lost>> {
    let n = escaped.len();
    let mut of: Vec<std::ops::Range<usize>> = vec![0..0; n];
    for (k, piece) in pieces.iter().enumerate() {
        let range = &mut of[piece.surface as usize];
        *range = if range.end == 0 { k } else { range.start }..k + 1;
    }
    progress.begin("what escapes", n as u64);
    let most = (MOST_IN_ALL / n as f64).clamp(256.0, MOST);
    let divided = |i: usize| {
        progress.advance(1);
        let all = escaped[i];
        if all.value <= 0.0 || progress.is_stopped() {
            return Lost { escaped: all, ..Lost::default() };
        }
        let own = &pieces[of[i].clone()];
        let area: f64 = own.iter().map(|piece| piece.area).sum();
        let cast = |rays: f64, round: u64| {
            let of_piece = |(k, piece): (usize, &Polygon)| {
                let rays = (rays * piece.area / area).ceil().max(1.0) as u64;
                sight(piece, blockers, up, rays, mix(&[seed, i as u64, k as u64, round]))
            };
            own.par_iter().enumerate().map(of_piece).reduce(Sight::default, Sight::and)
        };
        let first = cast(256.0_f64.min(most), 0);
        let shares = |sight: &Sight| {
            let lost = sight.lost().max(1) as f64;
            [sight.backs, sight.up + sight.down, sight.up, sight.down].map(|k| k as f64 / lost)
        };
        let spread = shares(&first).map(|s| s * (1.0 - s)).into_iter().fold(0.0, f64::max);
        // The spread of rays that agree is known only to one over their number.
        let wanted = (all.value * spread / (error * error)).max(1.0 / error).min(most);
        let seen = if wanted > first.rays as f64 { cast(wanted, 1) } else { first };
        // If no ray is lost, the small escaping share is counted as leaving upward.
        let parts = if seen.lost() == 0 { [0.0, 1.0, 1.0, 0.0] } else { shares(&seen) };
        let lost = seen.lost().max(1) as f64;
        let part = |s: f64| {
            let variance = s * (1.0 - s) / lost + SKEWNESS / (lost * lost);
            let value = s * all.value;
            Share { value, error: (all.value * all.value * variance + (s * all.error).powi(2)).sqrt() }
        };
        let [backs, left, up, down] = parts.map(part);
        Lost { escaped: all, backs, left, up, down }
    };
    let lost = (0..n).into_par_iter().map(divided).collect();
    progress.check()?;
    Ok(lost)
}
