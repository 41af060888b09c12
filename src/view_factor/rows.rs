//! All pairs, row by row. Pairs that exchange nothing are not stored, so that memory is proportional to the number of
//! visible pairs.

use std::{borrow::Cow, f64::consts::PI, ops::Range};

use glam::DVec3;
use rayon::prelude::*;

use super::{
    ViewFactorOptions,
    blockers::{Blockers, Near},
    cell::Cell,
    clusters::Cluster,
    estimate::{self, Estimate, REPLICATES, Sample, Sequence},
    paths::Paths,
    polygon::{Area, FORMULA, Polygon},
    shadows::{Pieces, Shadows},
    shaft::Shaft,
};
use crate::{Progress, Result, form_factor::ordered_sum};

/// Bounds of the limit below which view factors are tiny. Each is estimated by [`FEWEST`] rays: none matters by itself,
/// and their sum has the standard error that is stated.
const TINY: (f64, f64) = (1e-7, 1e-4);
/// Rays of a tiny pair.
const FEWEST: u32 = 2;
/// Fewest and most rays of a pilot, which decides the number of rays of a pair. Pilot rays do not enter the estimate.
/// It would otherwise be too low where few paths are free, because pairs whose first rays were all blocked would stop
/// early.
const PILOT: (u32, u32) = (8, 1024);
/// Most points of a pilot that sees past few blockers, because points differ less than rays. Where there are so few pairs that pilots of
/// this size are affordable, each pair gets at least as many points: in twelve scenes (benches/coverage.rs), 95 % intervals from 16 points
/// held in 70 to 100 % of the seeds for single pairs of which few points see much hidden.
const PILOT_PAST_FEW: u32 = 64;
/// Approximate number of pilot rays for all pairs.
const PILOTS: usize = 1 << 20;
/// Up to this number of pairs, all that are sampled are kept for being sampled again. With more, these would take too much memory, and
/// only those are kept that their pilot or their error says need more rays.
const KEPT: usize = 1 << 23;
/// Most rays of a pair.
const MOST: f64 = (1u32 << 28) as f64;
/// Up to this number of blockers in a shaft, what a point sees past them is computed exactly. With more, paths go through the hierarchy.
const SOME: usize = 24;
/// Number of pairs of polygons that determine the pace of casting rays.
const SAMPLE: u64 = 1 << 19;
/// The pace aims at this share of the wanted error.
const MARGIN: f64 = 0.97;
/// A correction of the pace goes this much farther than the error asks for. Otherwise the chance in a new estimate of a small error could
/// look like an error that more rays do not reduce.
const FASTER: f64 = 1.5;
/// Most corrections of the pace.
const TRIES: u64 = 5;
/// A round that leaves more than this share of the error is the last.
const USEFUL: f64 = 0.98;

/// The blocker that was found last.
type Last = std::cell::Cell<u32>;

/// The blockers that paths may meet, and the one that was met last.
type Past<'a> = (&'a Near<'a>, &'a Last);

/// Position, direction and size of a piece, which decide most pairs.
struct Ball {
    centre: DVec3,
    normal: DVec3,
    radius: f64,
    area: f64,
}

impl Ball {
    /// Whether two pieces cannot see each other because one is wholly behind the other.
    fn is_behind(&self, other: &Ball) -> bool {
        let path = other.centre - self.centre;
        path.dot(self.normal) < -other.radius || -path.dot(other.normal) < -self.radius
    }

    /// An upper bound of the exchange of two pieces, from bounds of cosines and distance.
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

/// The data for computing pairs.
struct Pairs<'a> {
    pieces: &'a [Polygon],
    balls: Vec<Ball>,
    clusters: Vec<Cluster>,
    /// Areas of the surfaces.
    areas: &'a [f64],
    blockers: &'a Blockers,
    sequence: Sequence,
    seed: u64,
    /// Number of rays of a pilot.
    pilot: u32,
    /// Fewest points of a pair past few blockers.
    fewest: u32,
    /// Whether all pairs may be sampled again.
    keeps_all: bool,
    /// Limit below which view factors do not matter by themselves.
    tiny: f64,
    /// The wanted error.
    error: f64,
}

/// Two pieces with parts that are in front of each other, with or without something between them.
struct Pair<'a> {
    ends: [usize; 2],
    parts: [Cow<'a, Area>; 2],
    /// Whether these parts are the whole pieces.
    whole: bool,
    names: [u32; 2],
    /// All possible blockers, if they are few.
    blockers: Option<Vec<u32>>,
    /// Factor from an error of the exchange area to the errors of both view factors, added in squares.
    weight: f64,
}

/// Visibility of a pair, found without sampling.
enum Seen<'a> {
    Nothing,
    All(f64),
    /// The exchange is too small to matter by itself.
    Tiny(Pair<'a>),
    /// A pair with something between, and its exchange if there were nothing.
    Part(Pair<'a>, f64),
}

/// A pair that may be sampled again.
struct Sampled {
    ends: [u32; 2],
    unoccluded: f64,
    past_few: Option<u32>,
    need: Need,
    estimate: Estimate,
}

/// What decides the number of rays of a pair.
#[derive(Clone, Copy)]
struct Need {
    /// The part of the standard error that falls as the square root of the number of rays, for one ray.
    deviation: f64,
    /// The part that falls as the number of rays, for one ray.
    doubt: f64,
    /// Fewest rays.
    fewest: u32,
}

impl Need {
    /// `past_few` is the fewest points of a pair past few blockers. What a point sees past these is continuous in the point. So the error of evenly distributed points falls about as their
    /// number, while that of rays falls as the square root.
    fn of(estimate: &Estimate, past_few: Option<u32>) -> Need {
        let doubt = if estimate.exchange != 0.0 { estimate.doubt_of_ray() } else { 0.0 };
        let deviation = estimate.deviation();
        match past_few {
            Some(fewest) => {
                let doubt = doubt.hypot(deviation * f64::from(estimate.rays).sqrt());
                Need { deviation: 0.0, doubt, fewest }
            }
            None => Need { deviation, doubt, fewest: REPLICATES },
        }
    }

    fn or(self, other: Need) -> Need {
        Need {
            deviation: self.deviation.max(other.deviation),
            doubt: self.doubt.max(other.doubt),
            fewest: self.fewest,
        }
    }

    /// The largest pace at which a pair with this weight gets the fewest rays.
    fn pace_of_fewest(self, weight: f64) -> f64 {
        let fewest = f64::from(self.fewest);
        (fewest / (weight * self.deviation)).min((fewest.powi(3) / 2.0).sqrt() / (weight * self.doubt))
    }

    /// The number of rays of a pair with this weight.
    fn rays(self, weight: f64, pace: f64) -> u32 {
        let rays = estimate::rays(weight, self.deviation, self.doubt, pace);
        rays.clamp(f64::from(self.fewest), MOST).ceil() as u32
    }
}

/// The pairs of a piece with later ones.
#[derive(Default)]
struct Row {
    /// Exchange with other surfaces, without the sampled pairs.
    cells: Vec<Cell>,
    sampled: Vec<Sampled>,
    rays: u64,
}

/// How a pair is sampled.
struct Sampler<'a> {
    means: Means<'a>,
    /// The exchange of what nothing can hide.
    beside: f64,
    /// The exchange of the rest, with nothing between, if it is known.
    sampled: Option<f64>,
    /// The error of the exchange of what nothing can hide. It is a difference, and has the error of the larger exchange.
    formula: f64,
}

enum Means<'a> {
    /// What is between hides nothing.
    Nothing,
    /// Points that see past few blockers.
    Points(Box<Shadows>),
    /// Paths through the hierarchy.
    Paths(Paths<'a>),
}

impl<'a> Sampler<'a> {
    fn paths(pair: &'a Pair) -> Sampler<'a> {
        let [ours, theirs] = [&pair.parts[0], &pair.parts[1]].map(|part| Cow::Borrowed(&**part));
        Sampler {
            means: Means::Paths(Paths::between(ours, theirs)),
            beside: 0.0,
            sampled: None,
            formula: 0.0,
        }
    }

    /// `None` if there is nothing to sample.
    fn sample(&self, pairs: &Pairs, pair: &Pair, rays: u32, stage: u64, past: Past) -> Option<Sample> {
        let [i, j] = pair.ends.map(|k| k as u64);
        let seed = [mix(pairs.seed, stage), i, j];
        match &self.means {
            Means::Nothing => None,
            Means::Points(shadows) => {
                let mut pieces = Pieces::default();
                let sample = |[u, v, ..]: [f64; 4]| shadows.seen_from(u, v, &mut pieces);
                Some(Sample::cast(rays, &pairs.sequence, seed, sample))
            }
            Means::Paths(paths) => Some(Sample::cast(rays, &pairs.sequence, seed, |point| {
                let (from, to, weight) = paths.path(point);
                let is_free = weight > 0.0 && past.0.free(from, to, pair.names, past.1);
                (weight, if is_free { weight } else { 0.0 })
            })),
        }
    }
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

    /// Calls `found` with each later piece that a piece may see, what is known without sampling, and the blockers that
    /// may be between them.
    fn each(&self, i: usize, last: &Last, mut found: impl FnMut(usize, Seen<'a>, &Near)) {
        for cluster in &self.clusters {
            let members = cluster.after(i, &self.pieces[i]);
            if members.is_empty() {
                continue;
            }
            let near = cluster.blockers(&self.pieces[i], self.blockers);
            for j in members.iter().map(|&j| j as usize) {
                found(j, self.look(i, j, &near, last), &near);
            }
        }
    }

    /// Determines visibility without sampling. A blocked path between the middles shows at once that something is
    /// between. The shaft shows whether nothing is.
    fn look(&self, i: usize, j: usize, near: &Near, last: &Last) -> Seen<'a> {
        let Some(mut pair) = self.facing(i, j) else { return Seen::Nothing };
        let [from, to] = [&pair.parts[0], &pair.parts[1]].map(|part| part.middle());
        let is_blocked = !near.free(from, to, pair.names, last);
        let hides = |blocker: u32, pair: &Pair| {
            self.blockers.hides(blocker, pair.parts[0].corners(), pair.parts[1].corners())
        };
        if is_blocked && hides(last.get(), &pair) {
            return Seen::Nothing;
        }
        if is_blocked && pair.weight * self.balls[i].exchange_at_most(&self.balls[j]) < self.tiny {
            return Seen::Tiny(pair);
        }
        let unoccluded = self.unoccluded(&pair);
        if unoccluded <= 0.0 {
            return Seen::Nothing;
        }
        let is_tiny = pair.weight * unoccluded < self.tiny;
        if is_tiny && is_blocked {
            return Seen::Tiny(pair);
        }
        // Which blockers they are matters only to pairs that are sampled past them.
        let blockers = self.blockers_between(&pair, near, if is_tiny { 0 } else { SOME });
        if blockers.as_ref().is_some_and(Vec::is_empty) {
            return Seen::All(unoccluded);
        }
        if is_tiny {
            return Seen::Tiny(pair);
        }
        if blockers.iter().flatten().any(|&blocker| hides(blocker, &pair)) {
            return Seen::Nothing;
        }
        pair.blockers = blockers;
        Seen::Part(pair, unoccluded)
    }

    /// The blockers between a pair, if they are at most so many.
    fn blockers_between(&self, pair: &Pair, near: &Near, most: usize) -> Option<Vec<u32>> {
        let [ours, theirs] = [&pair.parts[0], &pair.parts[1]].map(|part| (part.corners(), part.normal()));
        let mut found = Vec::new();
        near.within(&Shaft::new(ours, theirs), pair.names, most, &mut found).then_some(found)
    }

    /// Prepares the sampling of a pair whose exchange with nothing between is known.
    fn sampler<'b>(&self, pair: &'b Pair, unoccluded: f64) -> Sampler<'b> {
        let [ours, theirs] = [&pair.parts[0], &pair.parts[1]];
        let Some(few) = &pair.blockers else {
            return Sampler { sampled: Some(unoccluded), ..Sampler::paths(pair) };
        };
        let outlines = few.iter().map(|&blocker| self.blockers.outline(blocker));
        let Some(shadows) = Shadows::between(ours, theirs, outlines) else {
            return Sampler { means: Means::Nothing, beside: unoccluded, sampled: None, formula: 0.0 };
        };
        let (sampled, beside) = shadows.exchange(unoccluded);
        let means = if shadows.is_empty() { Means::Nothing } else { Means::Points(Box::new(shadows)) };
        Sampler { means, beside, sampled, formula: FORMULA * unoccluded }
    }

    /// Estimates a pair by samples. Pilots and estimates are stages with different samples.
    fn cast(&self, pair: &Pair, sampler: &Sampler, rays: u32, stage: u64, past: Past) -> Estimate {
        let none = Estimate { exchange: 0.0, variance: 0.0, doubt: 0.0, rays: 0, matters: true };
        let mut estimate = match sampler.sample(self, pair, rays, stage, past) {
            Some(sample) => sample.estimate(sampler.sampled),
            None => none,
        };
        if sampler.beside > 0.0 {
            estimate.exchange += sampler.beside;
            estimate.doubt = estimate.doubt.hypot(sampler.formula);
        }
        estimate
    }

    /// The estimate of a pilot.
    fn pilot(&self, pair: &Pair, sampler: &Sampler, past: Past) -> Estimate {
        let most = if pair.blockers.is_some() { PILOT_PAST_FEW } else { u32::MAX };
        self.cast(pair, sampler, self.pilot.min(most), 0, past)
    }

    /// The estimate of a tiny pair by two rays; `None` if both are blocked.
    fn tiny(&self, pair: &Pair, past: Past) -> Option<Cell> {
        let sample = Sampler::paths(pair).sample(self, pair, FEWEST, 1, past)?;
        // If there is any exchange, it is too small to be missed.
        (!sample.is_blocked()).then(|| Cell::of(&sample.estimate(Some(self.unoccluded(pair)))))
    }

    /// The exchange of a piece with later ones.
    fn row(&self, i: usize, pace: f64) -> Row {
        let mut row = Row::default();
        let last = Last::new(u32::MAX);
        let mut cells = Vec::new();
        self.each(i, &last, |j, seen, near| {
            if let Some(cell) = self.exchange([i, j], seen, (near, &last), pace, &mut row) {
                cells.push(Cell { column: self.pieces[j].surface, ..cell });
            }
        });
        cells.sort_by_key(|cell| cell.column);
        cells.into_iter().for_each(|cell| add(&mut row.cells, cell));
        row.cells.shrink_to_fit();
        row.sampled.shrink_to_fit();
        row
    }

    /// The exchange of two pieces, if there is any, unless they may be sampled again.
    fn exchange(&self, ends: [usize; 2], seen: Seen, past: Past, pace: f64, row: &mut Row) -> Option<Cell> {
        match seen {
            Seen::Nothing => None,
            Seen::All(exchange) => Some(Cell { exchange, ..Cell::default() }),
            Seen::Tiny(pair) => {
                row.rays += u64::from(FEWEST);
                self.tiny(&pair, past)
            }
            Seen::Part(pair, unoccluded) => {
                let sampler = self.sampler(&pair, unoccluded);
                let pilot = self.pilot(&pair, &sampler, past);
                let past_few = pair.blockers.as_ref().map(|_| self.fewest);
                let need = Need::of(&pilot, past_few);
                let wanted = need.rays(pair.weight, pace);
                let estimate = self.cast(&pair, &sampler, wanted, 1, past);
                row.rays += u64::from(estimate.rays + pilot.rays);
                // The pilot may have missed light that the sample met.
                let is_large = || Cell::of(&estimate).error() * pair.weight > self.error;
                if self.keeps_all || wanted > need.fewest || is_large() {
                    let ends = ends.map(|k| k as u32);
                    row.sampled.push(Sampled { ends, unoccluded, past_few, need, estimate });
                    return None;
                }
                // If there is any exchange, it is too small to be missed.
                let is_zero = estimate.exchange == 0.0 && estimate.doubt * pair.weight < self.tiny;
                (!is_zero).then(|| Cell::of(&estimate))
            }
        }
    }

    /// Samples a pair again. All of its rays are new, and their number follows from earlier rays: were estimates that happen to need
    /// no more rays kept, sums over pairs would be biased toward these. Returns the number of rays cast.
    fn sample_again(&self, sampled: &mut Sampled, pace: f64, round: u64) -> u64 {
        let [i, j] = sampled.ends.map(|k| k as usize);
        let Some(mut pair) = self.facing(i, j) else { return 0 };
        sampled.need = sampled.need.or(Need::of(&sampled.estimate, sampled.past_few));
        let wanted = sampled.need.rays(pair.weight, pace).max(sampled.estimate.rays);
        let all = self.blockers.all();
        pair.blockers = self.blockers_between(&pair, &all, SOME);
        let sampler = self.sampler(&pair, sampled.unoccluded);
        let past = (&all, &Last::new(u32::MAX));
        sampled.estimate = self.cast(&pair, &sampler, wanted, 1 + round, past);
        u64::from(sampled.estimate.rays)
    }
}

/// Adds a cell to the last one if both have the same column, otherwise appends it.
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
    /// RMS standard error of non-zero view factors.
    pub(super) error: f64,
}

/// The exchange of all pairs of surfaces, to the wanted error. `touching` lists the areas by which surfaces touch.
pub(super) fn rows(
    pieces: &[Polygon],
    areas: &[f64],
    blockers: &Blockers,
    touching: &[(u32, u32, f64)],
    options: &ViewFactorOptions,
    progress: &Progress,
) -> Result<Rows> {
    let all_pairs = pieces.len().pow(2).max(1);
    let pilot = (PILOTS / all_pairs).clamp(PILOT.0 as usize, PILOT.1 as usize) as u32;
    let ball = |p: &Polygon| Ball { centre: p.centre, normal: p.normal, radius: p.radius, area: p.area };
    let pairs = Pairs {
        pieces,
        balls: pieces.iter().map(ball).collect(),
        clusters: Cluster::all(pieces),
        areas,
        blockers,
        sequence: Sequence::new(),
        seed: options.seed,
        pilot,
        fewest: pilot.clamp(REPLICATES, PILOT_PAST_FEW),
        keeps_all: all_pairs <= KEPT,
        // A surface of many pieces has as many pairs with another one as the product of their numbers of pieces, and
        // the variances add up.
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
    for round in 1..=TRIES {
        if error <= options.error {
            break;
        }
        pace *= FASTER * (error / (MARGIN * options.error)).powi(2);
        rays += sample_again(&pairs, &mut rows, (pace, round), progress)?;
        let before = error;
        error = rms(areas, |i| merged(&rows, i));
        // The rest of the error does not come from rays, so that more of them would only take time.
        if error > USEFUL * before {
            break;
        }
    }
    let mut cells = Vec::with_capacity(areas.len());
    for (i, of) in pieces_of.iter().enumerate() {
        cells.push(merged(&rows, i));
        // Frees memory for the next rows.
        rows[of.clone()].fill_with(Row::default);
    }
    Ok(Rows { cells, rays, error })
}

/// The pieces of each surface, which are consecutive.
fn pieces_of(pieces: &[Polygon], surfaces: usize) -> Vec<Range<usize>> {
    let mut next = 0;
    let of = |surface: usize| {
        let first = next;
        next += pieces[first..].iter().take_while(|piece| piece.surface as usize == surface).count();
        first..next
    };
    (0..surfaces).map(of).collect()
}

/// Columns and areas of contacts, by the surface with the lower index.
fn by_row(touching: &[(u32, u32, f64)], surfaces: usize) -> Vec<Vec<Cell>> {
    let mut rows = vec![Vec::new(); surfaces];
    for &(i, j, area) in touching {
        // Two touching polygons of one surface exchange in both directions.
        let exchange = if i == j { 2.0 * area } else { area };
        rows[i as usize].push(Cell { exchange, column: j, ..Cell::default() });
    }
    rows
}

/// The row of a surface: the exchange of its pieces with each other and with the pieces of later surfaces.
fn merged(rows: &[Row], surface: usize, pairs: &Pairs, touching: &[Cell]) -> Vec<Cell> {
    let of_sampled = |sampled: &Sampled| {
        let column = pairs.pieces[sampled.ends[1] as usize].surface;
        Cell { column, ..Cell::of(&sampled.estimate) }
    };
    let mut cells: Vec<Cell> = rows
        .iter()
        .flat_map(|row| row.cells.iter().copied().chain(row.sampled.iter().map(of_sampled)))
        .map(|cell| {
            // Two pieces of one surface exchange in both directions.
            let twice = if cell.column as usize == surface { 2.0 } else { 1.0 };
            let [spread, quartic, doubt] = [cell.spread, cell.quartic, cell.doubt].map(|x| x * twice as f32);
            Cell { exchange: cell.exchange * twice, column: cell.column, spread, quartic, doubt }
        })
        .chain(touching.iter().copied())
        .collect();
    cells.sort_by_key(|cell| cell.column);
    let mut merged = Vec::with_capacity(cells.len());
    cells.into_iter().for_each(|cell| add(&mut merged, cell));
    merged.shrink_to_fit();
    merged
}

/// RMS standard error of all non-zero view factors, both of each pair.
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

/// The rows of all pieces.
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

/// Samples pairs again at this pace. Returns the number of rays cast.
fn sample_again(
    pairs: &Pairs,
    rows: &mut [Row],
    (pace, round): (f64, u64),
    progress: &Progress,
) -> Result<u64> {
    progress.begin("more rays", rows.len() as u64);
    let row = |row: &mut Row| {
        progress.advance(1);
        if progress.is_stopped() {
            return 0;
        }
        row.sampled.par_iter_mut().map(|sampled| pairs.sample_again(sampled, pace, round)).sum()
    };
    let rays = rows.par_iter_mut().with_max_len(1).map(row).sum();
    progress.check()?;
    Ok(rays)
}

/// The pace that gives the wanted error, estimated by the pilots of a sample of rows.
fn pace(pairs: &Pairs, error: f64, progress: &Progress) -> Result<f64> {
    let n = pairs.pieces.len() as u64;
    let step = (n * n / 2 / SAMPLE).max(1) as usize;
    progress.begin("planning rays", n / step as u64);
    /// Weights and needs of partly visible pairs, the number of visible pairs, and the pace below which all pairs get the
    /// fewest rays.
    type Pilots = (Vec<(f64, Need)>, u64, f64);
    let row = |i: usize| {
        progress.advance(1);
        let (mut partial, mut seen, mut least): Pilots = (Vec::new(), 0, f64::INFINITY);
        if progress.is_stopped() {
            return (partial, seen, least);
        }
        let last = Last::new(u32::MAX);
        pairs.each(i, &last, |_, found, near| match found {
            Seen::Nothing => {}
            Seen::All(_) => seen += 1,
            Seen::Tiny(pair) => seen += u64::from(pairs.tiny(&pair, (near, &last)).is_some()),
            Seen::Part(pair, unoccluded) => {
                let pilot = pairs.pilot(&pair, &pairs.sampler(&pair, unoccluded), (near, &last));
                let need = Need::of(&pilot, pair.blockers.as_ref().map(|_| pairs.fewest));
                least = least.min(need.pace_of_fewest(pair.weight));
                if pilot.exchange != 0.0 {
                    seen += 1;
                    partial.push((pair.weight, need));
                }
            }
        });
        (partial, seen, least)
    };
    let rows: Vec<Pilots> =
        (0..pairs.pieces.len()).into_par_iter().step_by(step).with_max_len(1).map(row).collect();
    progress.check()?;
    let seen = rows.iter().map(|(_, seen, _)| seen).sum::<u64>().max(1) as f64;
    let squares = |pace: f64| {
        let pair = |&(weight, need): &(f64, Need)| {
            let rays = f64::from(need.rays(weight, pace));
            weight * weight * estimate::variance(need.deviation, need.doubt, rays)
        };
        ordered_sum(rows.len(), |k| rows[k].0.iter().map(pair).sum::<f64>())
    };
    // Counts both view factors of a pair.
    let enough = |pace: f64| squares(pace) <= 2.0 * seen * error * error;
    let least = rows.iter().map(|row| row.2).fold(f64::INFINITY, f64::min);
    if least.is_infinite() || enough(least) {
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
