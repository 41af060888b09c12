//! All pairs, row by row: none is kept that exchanges nothing, so that memory goes with what is seen.

use rayon::prelude::*;

use super::{
    ViewFactorOptions,
    blockers::Blockers,
    estimate::{self, Estimate, REPLICATES, Sequence},
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

/// What two surfaces exchange, as far as known, in unit space.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Cell {
    /// The surface with the larger index.
    pub(super) column: u32,
    /// A_i F_ij.
    pub(super) exchange: f64,
    /// Its variance by the spread of rays,
    pub(super) variance: f64,
    /// and the largest that rays which agree may hide.
    pub(super) doubt: f64,
}

impl Cell {
    /// The standard error: that of rays, and the formula's.
    pub(super) fn error(&self) -> f64 {
        let formula = FORMULA * self.exchange;
        (self.variance + self.doubt + formula * formula).sqrt()
    }
}

/// What is needed to compute a pair.
struct Pairs<'a> {
    pieces: &'a [Polygon],
    /// Of surfaces.
    areas: &'a [f64],
    blockers: &'a Blockers,
    sequence: Sequence,
    seed: u64,
    /// Rays of a pilot.
    pilot: u32,
    /// Below this view factors do not matter by themselves.
    tiny: f64,
}

/// A pair between which something stands.
struct Hidden {
    unoccluded: f64,
    paths: Paths,
    /// All that may block, where it is little.
    blockers: Option<Vec<u32>>,
    names: [u32; 2],
    ends: [u64; 2],
    /// What an error of the exchange area is in both view factors together.
    weight: f64,
}

enum Seen {
    Nothing,
    All(f64),
    Part(Box<Hidden>),
}

impl Pairs<'_> {
    /// What is seen without a ray.
    fn look(&self, i: usize, j: usize) -> Seen {
        let (p, q) = (&self.pieces[i], &self.pieces[j]);
        let (p_all, p_any) = p.in_front(q);
        if !p_any {
            return Seen::Nothing;
        }
        let (q_all, q_any) = q.in_front(p);
        if !q_any {
            return Seen::Nothing;
        }
        let unoccluded = p.exchange(q, p_all && q_all);
        if unoccluded <= 0.0 {
            return Seen::Nothing;
        }
        let part = |of: &Polygon, all: bool, before: &Polygon| {
            if all { Some(of.corners.clone()) } else { of.part_in_front(before) }
        };
        let (Some(ours), Some(theirs)) = (part(p, p_all, q), part(q, q_all, p)) else { return Seen::Nothing };
        let names = [p, q].map(|polygon| self.blockers.name(polygon.source));
        let shaft = Shaft::new((&ours, p.normal), (&theirs, q.normal));
        let mut found = Vec::new();
        let all = self.blockers.within(&shaft, names, SOME, &mut found);
        if all && found.is_empty() {
            return Seen::All(unoccluded);
        }
        let [a, b] = [p, q].map(|polygon| self.areas[polygon.surface as usize]);
        let squares = (a * a).recip() + (b * b).recip();
        Seen::Part(Box::new(Hidden {
            unoccluded,
            paths: Paths::between(Area::new(ours, p.normal), Area::new(theirs, q.normal)),
            blockers: all.then_some(found),
            names,
            ends: [i as u64, j as u64],
            weight: if p.surface == q.surface { 2.0 * squares } else { squares }.sqrt(),
        }))
    }

    fn cast(&self, pair: &Hidden, rays: u32, stage: u64) -> Estimate {
        let is_free = |from, to| match &pair.blockers {
            Some(some) => self.blockers.free_of(some, from, to),
            None => self.blockers.free(from, to, pair.names),
        };
        let seed = [mix(self.seed, stage), pair.ends[0], pair.ends[1]];
        Estimate::new(&pair.paths, pair.unoccluded, rays, is_free, &self.sequence, seed)
    }

    /// The pilot of a pair, unless it is tiny.
    fn pilot(&self, pair: &Hidden) -> Option<Estimate> {
        (pair.weight * pair.unoccluded >= self.tiny).then(|| self.cast(pair, self.pilot, 0))
    }

    /// What a piece exchanges with later ones, by surfaces, and rays cast.
    fn row(&self, i: usize, pace: f64) -> (Vec<Cell>, u64) {
        let (mut cells, mut rays): (Vec<Cell>, u64) = (Vec::new(), 0);
        for j in i + 1..self.pieces.len() {
            let found = match self.look(i, j) {
                Seen::Nothing => continue,
                Seen::All(exchange) => Cell { exchange, ..Cell::default() },
                Seen::Part(pair) => {
                    let pilot = self.pilot(&pair);
                    let wanted = pilot.map_or(f64::from(FEWEST), |pilot| {
                        let deviation = pilot.deviation(pair.unoccluded);
                        let seen = pilot.exchange > 0.0;
                        estimate::rays(pair.weight, deviation, pair.unoccluded, seen, pace)
                            .clamp(f64::from(REPLICATES), MOST)
                    });
                    let found = self.cast(&pair, wanted.ceil() as u32, 1);
                    rays += u64::from(found.rays + pilot.map_or(0, |pilot| pilot.rays));
                    let Estimate { exchange, variance, doubt, .. } = found;
                    // Too little to be missed, if it is there at all.
                    if exchange == 0.0 && doubt.sqrt() * pair.weight < self.tiny {
                        continue;
                    }
                    Cell { exchange, variance, doubt, column: 0 }
                }
            };
            add(&mut cells, Cell { column: self.pieces[j].surface, ..found });
        }
        (cells, rays)
    }
}

/// Adds a cell to those of its column, which is the last or a new one.
fn add(cells: &mut Vec<Cell>, cell: Cell) {
    match cells.last_mut() {
        Some(last) if last.column == cell.column => {
            last.exchange += cell.exchange;
            last.variance += cell.variance;
            last.doubt = last.doubt.max(cell.doubt);
        }
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
    let pilot = (PILOTS / all_pairs).clamp(PILOT.0 as usize, PILOT.1 as usize) as u32;
    let tiny = options.error.clamp(TINY.0, TINY.1);
    let pairs = Pairs { pieces, areas, blockers, sequence: Sequence::new(), seed: options.seed, pilot, tiny };
    let mut pace = pace(&pairs, options.error * MARGIN, progress)?;
    let (mut all, mut tries) = (0, 0);
    loop {
        let (mut cells, rays) = all_rows(&pairs, pace, progress)?;
        all += rays;
        tries += 1;
        touching.iter().for_each(|&(i, j, area)| {
            touch(&mut cells[i as usize], j, if i == j { 2.0 * area } else { area })
        });
        let error = rms(&cells, areas);
        if error <= options.error || tries == TRIES {
            return Ok(Rows { cells, rays: all, error });
        }
        pace *= (error / (MARGIN * options.error)).powi(2);
    }
}

/// Adds the area that surfaces touch each other with to a row.
fn touch(row: &mut Vec<Cell>, column: u32, area: f64) {
    match row.binary_search_by_key(&column, |cell| cell.column) {
        Ok(k) => row[k].exchange += area,
        Err(k) => row.insert(k, Cell { column, exchange: area, ..Cell::default() }),
    }
}

/// RMS standard error of both view factors of all pairs that are not zero.
fn rms(cells: &[Vec<Cell>], areas: &[f64]) -> f64 {
    let of_row = |i: usize| {
        let mut sums = [0.0, 0.0];
        for cell in cells[i].iter().filter(|cell| cell.exchange > 0.0) {
            let (a, b) = (areas[i], areas[cell.column as usize]);
            let both = if i == cell.column as usize { 1.0 } else { 2.0 };
            sums[0] += cell.error().powi(2) * ((a * a).recip() + (b * b).recip()) * both / 2.0;
            sums[1] += both;
        }
        sums
    };
    let [squares, count] = [0, 1].map(|k| ordered_sum(cells.len(), |i| of_row(i)[k]));
    if count > 0.0 { (squares / count).sqrt() } else { 0.0 }
}

/// Rows of all surfaces.
fn all_rows(pairs: &Pairs, pace: f64, progress: &Progress) -> Result<(Vec<Vec<Cell>>, u64)> {
    let n = pairs.pieces.len();
    progress.begin("view factors", n as u64);
    let row = |i: usize| {
        progress.advance(1);
        if progress.is_stopped() { (Vec::new(), 0) } else { pairs.row(i, pace) }
    };
    let of_pieces: Vec<(Vec<Cell>, u64)> = (0..n).into_par_iter().with_max_len(1).map(row).collect();
    progress.check()?;
    let rays = of_pieces.iter().map(|(_, rays)| rays).sum();
    let mut cells: Vec<Vec<Cell>> = pairs.areas.iter().map(|_| Vec::new()).collect();
    // Pieces of a surface follow each other.
    for (piece, (row, _)) in pairs.pieces.iter().zip(of_pieces) {
        cells[piece.surface as usize].extend(row);
    }
    cells.par_iter_mut().enumerate().for_each(|(i, row)| {
        row.sort_by_key(|cell| cell.column);
        let mut merged = Vec::new();
        row.iter().for_each(|&cell| add(&mut merged, cell));
        // Both of two pieces of one surface see the other.
        for cell in merged.iter_mut().filter(|cell| cell.column as usize == i) {
            cell.exchange *= 2.0;
            cell.variance *= 4.0;
            cell.doubt *= 4.0;
        }
        merged.shrink_to_fit();
        *row = merged;
    });
    Ok((cells, rays))
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
        for j in others {
            match pairs.look(i, j) {
                Seen::Nothing => {}
                Seen::All(_) => seen += 1,
                Seen::Part(pair) => match pairs.pilot(&pair) {
                    Some(pilot) => {
                        let deviation = pilot.deviation(pair.unoccluded);
                        most = most.max(pair.weight * deviation);
                        if pilot.exchange > 0.0 {
                            seen += 1;
                            told.push((pair.weight, deviation, pair.unoccluded));
                        }
                    }
                    // A half of the tiny ones, about.
                    None => seen += u64::from((i + j).is_multiple_of(2)),
                },
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
