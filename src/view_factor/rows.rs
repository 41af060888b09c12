//! All pairs, row by row: none is kept that exchanges nothing, so that memory goes with what is seen.

use std::{borrow::Cow, f64::consts::PI, ops::Range};

use glam::DVec3;
use rayon::prelude::*;

use super::{
    ViewFactorOptions,
    blockers::Blockers,
    estimate::{self, Estimate, REPLICATES, Sample, Sequence},
    paths::Paths,
    polygon::{Area, FORMULA, Polygon},
    shaft::Shaft,
};
use crate::{Progress, Result, form_factor::ordered_sum};

/// View factors below the error wanted, within these bounds, are found by two rays a pair: none of them matters by itself, and their
/// sum is as right as its standard error says.
const TINY: (f64, f64) = (1e-7, 1e-4);
const FEWEST: u32 = 2;
/// Rays of a pair that tell how many it shall have: the fewest, the most, and about how many for all pairs. These do not enter its
/// estimate: it would be too low wherever few paths are free, since those pairs would stop early whose first rays were all blocked.
const PILOT: (u32, u32) = (8, 1024);
const PILOTS: usize = 1 << 20;
/// The most rays of a pair.
const MOST: f64 = (1u32 << 28) as f64;
/// Polygons in a shaft up to which each is asked in turn; beyond it paths go through the hierarchy.
const SOME: usize = 24;
/// Pairs of polygons that tell at what pace rays are given.
const SAMPLE: u64 = 1 << 19;
/// How much smaller an error the pace aims at than is wanted, and how often it is mended.
const MARGIN: f64 = 0.97;
const TRIES: u32 = 5;
/// A round that leaves more of the error than this share is the last.
const USEFUL: f64 = 0.98;

/// What two surfaces exchange, as far as known, in unit space.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Cell {
    /// A_i F_ij.
    pub(super) exchange: f64,
    /// The surface with the larger index.
    pub(super) column: u32,
    /// The standard error by the spread of rays,
    pub(super) spread: f32,
    /// and the largest that rays which agree may hide.
    pub(super) doubt: f32,
}

impl Cell {
    fn of(estimate: &Estimate) -> Cell {
        let Estimate { exchange, variance, doubt, .. } = *estimate;
        Cell { exchange, column: 0, spread: variance.sqrt() as f32, doubt: doubt as f32 }
    }

    /// The standard error: that of rays, and the formula's.
    pub(super) fn error(&self) -> f64 {
        let [spread, doubt] = [self.spread, self.doubt].map(f64::from);
        let formula = FORMULA * self.exchange;
        (spread * spread + doubt * doubt + formula * formula).sqrt()
    }

    /// Adds what other pairs of polygons exchange. Rays of several pairs do not all agree by chance.
    fn merge(&mut self, other: &Cell) {
        self.exchange += other.exchange;
        self.spread = self.spread.hypot(other.spread);
        self.doubt = self.doubt.max(other.doubt);
    }
}

/// The blocker that was found last.
type Last = std::cell::Cell<u32>;

/// Where a piece is, which way it faces and how large it is: so little decides most pairs.
struct Ball {
    centre: DVec3,
    normal: DVec3,
    radius: f64,
    area: f64,
}

impl Ball {
    /// Whether two pieces see nothing of each other because one is wholly behind the other.
    fn is_behind(&self, other: &Ball) -> bool {
        let path = other.centre - self.centre;
        path.dot(self.normal) < -other.radius || -path.dot(other.normal) < -self.radius
    }

    /// At least what two pieces exchange: cosines and distance are bounded.
    fn exchange_at_most(&self, other: &Ball) -> f64 {
        let path = other.centre - self.centre;
        let least = path.length() - self.radius - other.radius;
        if least <= 0.0 {
            return f64::INFINITY;
        }
        let cosine = |height: f64, radius: f64| ((height + radius) / least).min(1.0);
        let cosines =
            cosine(path.dot(self.normal), other.radius) * cosine(-path.dot(other.normal), self.radius);
        self.area * other.area * cosines / (PI * least * least)
    }
}

/// What is needed to compute a pair.
struct Pairs<'a> {
    pieces: &'a [Polygon],
    balls: Vec<Ball>,
    /// Of surfaces.
    areas: &'a [f64],
    blockers: &'a Blockers,
    sequence: Sequence,
    seed: u64,
    /// Rays of a pilot.
    pilot: u32,
    /// Below this view factors do not matter by themselves.
    tiny: f64,
    /// The error wanted.
    error: f64,
}

/// Two pieces of which something may stand between the parts that are in front of each other.
struct Pair<'a> {
    ends: [usize; 2],
    parts: [Cow<'a, Area>; 2],
    /// Whether these parts are all of both.
    whole: bool,
    names: [u32; 2],
    /// All that may block, where it is known to be little.
    blockers: Option<Vec<u32>>,
    /// What an error of the exchange area is in both view factors together.
    weight: f64,
}

/// What is seen of a pair without sampling.
enum Seen<'a> {
    Nothing,
    All(f64),
    /// Too little to matter by itself.
    Tiny(Pair<'a>),
    /// With what is exchanged where nothing stands between.
    Part(Pair<'a>, f64),
}

/// A pair with more rays than the fewest, or with a larger error than is wanted, which may need more.
struct Sampled {
    ends: [u32; 2],
    unoccluded: f64,
    deviation: f64,
    /// Whether rays of the pilot were free.
    seen: bool,
    estimate: Estimate,
}

/// What is known of the pairs of a piece with later ones.
#[derive(Default)]
struct Row {
    /// By surfaces; all but the sampled.
    cells: Vec<Cell>,
    sampled: Vec<Sampled>,
    rays: u64,
}

impl<'a> Pairs<'a> {
    /// The parts of two pieces that are in front of each other.
    fn facing(&self, i: usize, j: usize) -> Option<Pair<'a>> {
        if self.balls[i].is_behind(&self.balls[j]) {
            return None;
        }
        let (p, q) = (&self.pieces[i], &self.pieces[j]);
        let (p_all, p_any) = p.in_front(q);
        if !p_any {
            return None;
        }
        let (q_all, q_any) = q.in_front(p);
        if !q_any {
            return None;
        }
        let part = |of: &'a Polygon, all: bool, before: &Polygon| {
            if all {
                Some(Cow::Borrowed(&of.whole))
            } else {
                of.part_in_front(before).map(|corners| Cow::Owned(Area::new(corners, of.normal)))
            }
        };
        let (ours, theirs) = (part(p, p_all, q)?, part(q, q_all, p)?);
        let [a, b] = [p, q].map(|polygon| self.areas[polygon.surface as usize]);
        let squares = (a * a).recip() + (b * b).recip();
        Some(Pair {
            ends: [i, j],
            parts: [ours, theirs],
            whole: p_all && q_all,
            names: [p, q].map(|polygon| self.blockers.name(polygon.source)),
            blockers: None,
            weight: if p.surface == q.surface { 2.0 * squares } else { squares }.sqrt(),
        })
    }

    fn unoccluded(&self, pair: &Pair) -> f64 {
        let [p, q] = pair.ends.map(|k| &self.pieces[k]);
        p.exchange(q, pair.whole)
    }

    /// What is seen without sampling. A path between the middles that is blocked tells at once that something stands between; the
    /// shaft tells where nothing does.
    fn look(&self, i: usize, j: usize, last: &Last) -> Seen<'a> {
        let Some(mut pair) = self.facing(i, j) else { return Seen::Nothing };
        let [from, to] = [&pair.parts[0], &pair.parts[1]].map(|part| part.middle());
        let is_blocked = !self.blockers.free(from, to, pair.names, last);
        if is_blocked && pair.weight * self.balls[i].exchange_at_most(&self.balls[j]) < self.tiny {
            return Seen::Tiny(pair);
        }
        let unoccluded = self.unoccluded(&pair);
        if unoccluded <= 0.0 {
            return Seen::Nothing;
        }
        if !is_blocked {
            pair.blockers = self.blockers_between(&pair);
            if pair.blockers.as_ref().is_some_and(Vec::is_empty) {
                return Seen::All(unoccluded);
            }
        }
        if pair.weight * unoccluded < self.tiny { Seen::Tiny(pair) } else { Seen::Part(pair, unoccluded) }
    }

    /// What stands between a pair, where it is little.
    fn blockers_between(&self, pair: &Pair) -> Option<Vec<u32>> {
        let [ours, theirs] = [&pair.parts[0], &pair.parts[1]].map(|part| (part.corners(), part.normal()));
        let mut found = Vec::new();
        self.blockers.within(&Shaft::new(ours, theirs), pair.names, SOME, &mut found).then_some(found)
    }

    fn cast(&self, pair: &Pair, rays: u32, stage: u64, last: &Last) -> Sample {
        let is_free = |from, to| match &pair.blockers {
            Some(some) => self.blockers.free_of(some, from, to),
            None => self.blockers.free(from, to, pair.names, last),
        };
        let [i, j] = pair.ends.map(|k| k as u64);
        let [ours, theirs] = [&pair.parts[0], &pair.parts[1]].map(|part| Cow::Borrowed(&**part));
        let paths = Paths::between(ours, theirs);
        Sample::cast(&paths, rays, is_free, &self.sequence, [mix(self.seed, stage), i, j])
    }

    /// What two rays tell of a pair that does not matter by itself, unless they see nothing.
    fn tiny(&self, pair: &Pair, last: &Last) -> Option<Cell> {
        let sample = self.cast(pair, FEWEST, 1, last);
        // Where all was blocked it is too little to be missed, if it is there at all.
        (!sample.is_blocked()).then(|| Cell::of(&sample.estimate(self.unoccluded(pair))))
    }

    /// What a piece exchanges with later ones.
    fn row(&self, i: usize, pace: f64) -> Row {
        let mut row = Row::default();
        let last = Last::new(u32::MAX);
        for j in i + 1..self.pieces.len() {
            let found = match self.look(i, j, &last) {
                Seen::Nothing => continue,
                Seen::All(exchange) => Cell { exchange, ..Cell::default() },
                Seen::Tiny(pair) => {
                    row.rays += u64::from(FEWEST);
                    let Some(found) = self.tiny(&pair, &last) else { continue };
                    found
                }
                Seen::Part(mut pair, unoccluded) => {
                    let pilot = self.cast(&pair, self.pilot, 0, &last);
                    let (seen, deviation) =
                        (!pilot.is_blocked(), pilot.estimate(unoccluded).deviation(unoccluded));
                    let wanted = wanted(&pair, deviation, unoccluded, seen, pace);
                    if wanted > REPLICATES && pair.blockers.is_none() {
                        pair.blockers = self.blockers_between(&pair);
                    }
                    let estimate = self.cast(&pair, wanted, 1, &last).estimate(unoccluded);
                    row.rays += u64::from(estimate.rays + pilot.rays());
                    // The pilot may have missed what the sample met.
                    if wanted > REPLICATES || Cell::of(&estimate).error() * pair.weight > self.error {
                        let ends = [i as u32, j as u32];
                        row.sampled.push(Sampled { ends, unoccluded, deviation, seen, estimate });
                        continue;
                    }
                    // Too little to be missed, if it is there at all.
                    if estimate.exchange == 0.0 && estimate.doubt * pair.weight < self.tiny {
                        continue;
                    }
                    Cell::of(&estimate)
                }
            };
            add(&mut row.cells, Cell { column: self.pieces[j].surface, ..found });
        }
        row.cells.shrink_to_fit();
        row.sampled.shrink_to_fit();
        row
    }

    /// Samples a pair anew where it wants more rays at this pace. Returns how many were cast.
    fn sample_again(&self, sampled: &mut Sampled, pace: f64) -> u64 {
        let [i, j] = sampled.ends.map(|k| k as usize);
        let Some(mut pair) = self.facing(i, j) else { return 0 };
        let &mut Sampled { unoccluded, estimate, .. } = sampled;
        let deviation = sampled.deviation.max(estimate.deviation(unoccluded));
        let seen = sampled.seen || estimate.exchange > 0.0;
        let wanted = wanted(&pair, deviation, unoccluded, seen, pace);
        if wanted <= sampled.estimate.rays {
            return 0;
        }
        pair.blockers = self.blockers_between(&pair);
        let last = Last::new(u32::MAX);
        sampled.estimate = self.cast(&pair, wanted, 1, &last).estimate(unoccluded);
        u64::from(sampled.estimate.rays)
    }
}

/// How many rays a pair shall have, by what its pilot told.
fn wanted(pair: &Pair, deviation: f64, unoccluded: f64, seen: bool, pace: f64) -> u32 {
    let rays = estimate::rays(pair.weight, deviation, unoccluded, seen, pace);
    rays.clamp(f64::from(REPLICATES), MOST).ceil() as u32
}

/// Adds a cell to those of its column, which is the last or a new one.
fn add(cells: &mut Vec<Cell>, cell: Cell) {
    match cells.last_mut() {
        Some(last) if last.column == cell.column => last.merge(&cell),
        _ => cells.push(cell),
    }
}

fn mix(seed: u64, stage: u64) -> u64 {
    crate::trace::sampling::mix(&[seed, stage])
}

/// Upper triangles of rows.
pub(super) struct Rows {
    pub(super) cells: Vec<Vec<Cell>>,
    pub(super) rays: u64,
    /// RMS standard error of view factors that are not zero.
    pub(super) error: f64,
}

/// What all pairs of surfaces exchange, to the error wanted. `touching` are the areas that surfaces touch each other with.
pub(super) fn rows(
    pieces: &[Polygon],
    areas: &[f64],
    blockers: &Blockers,
    touching: &[(u32, u32, f64)],
    options: &ViewFactorOptions,
    progress: &Progress,
) -> Result<Rows> {
    let all_pairs = pieces.len().pow(2).max(1);
    let ball = |p: &Polygon| Ball { centre: p.centre, normal: p.normal, radius: p.radius, area: p.area };
    let pairs = Pairs {
        pieces,
        balls: pieces.iter().map(ball).collect(),
        areas,
        blockers,
        sequence: Sequence::new(),
        seed: options.seed,
        pilot: (PILOTS / all_pairs).clamp(PILOT.0 as usize, PILOT.1 as usize) as u32,
        // A surface of many pieces has the square of their number of pairs with another one, and their variances add up.
        tiny: (options.error * areas.len() as f64 / pieces.len().max(1) as f64).clamp(TINY.0, TINY.1),
        error: options.error,
    };
    let mut pace = pace(&pairs, options.error * MARGIN, progress)?;
    let mut rows = all_rows(&pairs, pace, progress)?;
    let mut rays = rows.iter().map(|row| row.rays).sum();
    let touching = by_row(touching, areas.len());
    let pieces_of = pieces_of(pieces, areas.len());
    let merged = |rows: &[Row], i: usize| merged(&rows[pieces_of[i].clone()], i, &pairs, &touching[i]);
    let mut error = rms(areas, |i| merged(&rows, i));
    for _ in 0..TRIES {
        if error <= options.error {
            break;
        }
        pace *= (error / (MARGIN * options.error)).powi(2);
        rays += sample_again(&pairs, &mut rows, pace, progress)?;
        let before = error;
        error = rms(areas, |i| merged(&rows, i));
        // What is left is not the rays': more of them would only take time.
        if error > USEFUL * before {
            break;
        }
    }
    let mut cells = Vec::with_capacity(areas.len());
    for (i, of) in pieces_of.iter().enumerate() {
        cells.push(merged(&rows, i));
        // Its memory is wanted for the next ones.
        rows[of.clone()].fill_with(Row::default);
    }
    Ok(Rows { cells, rays, error })
}

/// The pieces of each surface, which follow each other.
fn pieces_of(pieces: &[Polygon], surfaces: usize) -> Vec<Range<usize>> {
    let mut next = 0;
    let of = |surface: usize| {
        let first = next;
        next += pieces[first..].iter().take_while(|piece| piece.surface as usize == surface).count();
        first..next
    };
    (0..surfaces).map(of).collect()
}

/// Columns and areas of what touches, by the surface of the lower index.
fn by_row(touching: &[(u32, u32, f64)], surfaces: usize) -> Vec<Vec<Cell>> {
    let mut rows = vec![Vec::new(); surfaces];
    for &(i, j, area) in touching {
        // Both of two polygons of one surface touch the other.
        let exchange = if i == j { 2.0 * area } else { area };
        rows[i as usize].push(Cell { exchange, column: j, ..Cell::default() });
    }
    rows
}

/// The row of a surface: what its pieces exchange with those of later surfaces and with each other.
fn merged(rows: &[Row], surface: usize, pairs: &Pairs, touching: &[Cell]) -> Vec<Cell> {
    let of_sampled = |sampled: &Sampled| {
        let column = pairs.pieces[sampled.ends[1] as usize].surface;
        Cell { column, ..Cell::of(&sampled.estimate) }
    };
    let mut cells: Vec<Cell> = rows
        .iter()
        .flat_map(|row| row.cells.iter().copied().chain(row.sampled.iter().map(of_sampled)))
        .map(|cell| {
            // Both of two pieces of one surface see the other.
            let twice = if cell.column as usize == surface { 2.0 } else { 1.0 };
            let Cell { exchange, column, spread, doubt } = cell;
            Cell {
                exchange: exchange * twice,
                column,
                spread: spread * twice as f32,
                doubt: doubt * twice as f32,
            }
        })
        .chain(touching.iter().copied())
        .collect();
    cells.sort_by_key(|cell| cell.column);
    let mut merged = Vec::with_capacity(cells.len());
    cells.into_iter().for_each(|cell| add(&mut merged, cell));
    merged.shrink_to_fit();
    merged
}

/// RMS standard error of both view factors of all pairs that are not zero.
fn rms(areas: &[f64], row: impl Fn(usize) -> Vec<Cell> + Sync) -> f64 {
    let of_row = |i: usize| {
        let mut sums = [0.0, 0.0];
        for cell in row(i).iter().filter(|cell| cell.exchange > 0.0) {
            let (a, b) = (areas[i], areas[cell.column as usize]);
            let both = if i == cell.column as usize { 1.0 } else { 2.0 };
            sums[0] += cell.error().powi(2) * ((a * a).recip() + (b * b).recip()) * both / 2.0;
            sums[1] += both;
        }
        sums
    };
    let sums: Vec<[f64; 2]> = (0..areas.len()).into_par_iter().map(of_row).collect();
    let [squares, count] = [0, 1].map(|k| sums.iter().map(|sum| sum[k]).sum::<f64>());
    if count > 0.0 { (squares / count).sqrt() } else { 0.0 }
}

/// Rows of all pieces.
fn all_rows(pairs: &Pairs, pace: f64, progress: &Progress) -> Result<Vec<Row>> {
    let n = pairs.pieces.len();
    progress.begin("view factors", n as u64);
    let row = |i: usize| {
        progress.advance(1);
        if progress.is_stopped() { Row::default() } else { pairs.row(i, pace) }
    };
    let rows = (0..n).into_par_iter().with_max_len(1).map(row).collect();
    progress.check()?;
    Ok(rows)
}

/// Samples pairs anew that want more rays at this pace. Returns how many rays were cast.
fn sample_again(pairs: &Pairs, rows: &mut [Row], pace: f64, progress: &Progress) -> Result<u64> {
    progress.begin("more rays", rows.len() as u64);
    let row = |row: &mut Row| {
        progress.advance(1);
        if progress.is_stopped() {
            return 0;
        }
        row.sampled.par_iter_mut().map(|sampled| pairs.sample_again(sampled, pace)).sum()
    };
    let rays = rows.par_iter_mut().with_max_len(1).map(row).sum();
    progress.check()?;
    Ok(rays)
}

/// The pace at which rays leave the error wanted, as the pilots of a sample of rows tell.
fn pace(pairs: &Pairs, error: f64, progress: &Progress) -> Result<f64> {
    let n = pairs.pieces.len() as u64;
    let step = (n * n / 2 / SAMPLE).max(1) as usize;
    progress.begin("planning rays", n / step as u64);
    /// Weights, deviations and unoccluded exchange areas of what is seen in part, and the count of what is seen.
    /// And the largest product of weight and deviation.
    type Told = (Vec<(f64, f64, f64)>, u64, f64);
    let row = |i: usize| {
        progress.advance(1);
        let (mut told, mut seen, mut most): Told = (Vec::new(), 0, 0.0);
        let others = if progress.is_stopped() { 0..0 } else { i + 1..pairs.pieces.len() };
        let last = Last::new(u32::MAX);
        for j in others {
            match pairs.look(i, j, &last) {
                Seen::Nothing => {}
                Seen::All(_) => seen += 1,
                Seen::Tiny(pair) => seen += u64::from(!pairs.cast(&pair, FEWEST, 0, &last).is_blocked()),
                Seen::Part(pair, unoccluded) => {
                    let pilot = pairs.cast(&pair, pairs.pilot, 0, &last);
                    let deviation = pilot.estimate(unoccluded).deviation(unoccluded);
                    most = most.max(pair.weight * deviation);
                    if !pilot.is_blocked() {
                        seen += 1;
                        told.push((pair.weight, deviation, unoccluded));
                    }
                }
            }
        }
        (told, seen, most)
    };
    let rows: Vec<Told> =
        (0..pairs.pieces.len()).into_par_iter().step_by(step).with_max_len(1).map(row).collect();
    progress.check()?;
    let seen = rows.iter().map(|(_, seen, _)| seen).sum::<u64>().max(1) as f64;
    let squares = |pace: f64| {
        let pair = |&(weight, deviation, unoccluded): &(f64, f64, f64)| {
            let rays = estimate::rays(weight, deviation, unoccluded, true, pace).max(f64::from(REPLICATES));
            weight * weight * estimate::variance(deviation, unoccluded, rays)
        };
        ordered_sum(rows.len(), |k| rows[k].0.iter().map(pair).sum::<f64>())
    };
    // Both view factors of a pair.
    let enough = |pace: f64| squares(pace) <= 2.0 * seen * error * error;
    let most = rows.iter().map(|row| row.2).fold(0.0, f64::max);
    // The pair that varies most has the fewest rays.
    let least = if most > 0.0 { f64::from(REPLICATES) / most } else { 0.0 };
    if enough(least) {
        return Ok(least);
    }
    let (mut low, mut high) = (0.0, 1.0);
    while !enough(high) && high < 1e18 {
        (low, high) = (high, 4.0 * high);
    }
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if enough(middle) { high = middle } else { low = middle }
    }
    Ok(high)
}
