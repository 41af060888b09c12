//! Shadow rays: paths between points of a patch and points of lamps, each unblocked or blocked.
//!
//! The rays of a patch alternate between two sequences with separate scrambles, so that the visibility estimated from
//! one is independent of the samples of the other. Halves of one sequence complement each other: they made light behind
//! a grille 0.3 % too large, and 2 % if the lamp is cut into hundreds of pieces. For partly hidden large lamps such
//! halves are up to 7 % better at 64 rays a patch, and equal at 256.

use std::ops::Range;

use rayon::prelude::*;

use super::{
    footprint::Footprint,
    lamps::{Choice, Lamps, Path},
};
use crate::{
    Progress, Ranks, Result,
    patch::Patches,
    trace::{
        Tracer,
        sampling::mix,
        sobol::{LANES, Sobol, blocks},
    },
};

/// Number of halves of a patch's rays. Each half estimates visibility for the other.
pub(super) const HALVES: usize = 2;

/// A shadow ray: the piece of the lamps that it went to, and its weight. The weight is negative if the ray was blocked,
/// and zero if the two points do not face each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ShadowRay {
    pub(crate) piece: u32,
    pub(crate) weight: f32,
}

/// A shadow ray that is not stored.
pub(crate) struct Sample<const C: usize> {
    /// The half of the rays that it is in.
    pub(crate) half: usize,
    /// Its irradiance if it is unblocked, by channel.
    pub(crate) light: [f64; C],
    /// The same summed over the channels, for the emission at which the lamps were made, if the unblocked light of its
    /// piece is known exactly; otherwise 0.
    pub(crate) known: f64,
    /// Whether it is unblocked.
    pub(crate) is_free: bool,
    /// Whether its light enters the scene from outside the patches.
    pub(crate) is_remote: bool,
}

impl ShadowRay {
    const NONE: ShadowRay = ShadowRay { piece: 0, weight: 0.0 };
}

/// The shadow rays of all patches.
#[derive(Debug, Clone, Default)]
pub(crate) struct ShadowRays {
    pub(crate) lamps: Lamps,
    /// Index in `rays` of the first ray of each patch.
    offsets: Vec<usize>,
    rays: Vec<ShadowRay>,
    /// The unblocked form factor of each patch to each piece; empty if there are too many pieces.
    unoccluded: Vec<f64>,
    /// Whether any light can reach each patch.
    is_faced: Vec<bool>,
}

/// A store of shadow rays.
pub(crate) trait Keep: Sync {
    /// The stored rays among the `wanted` numbers of a patch, without gaps from the first on.
    fn known(&self, patch: usize, wanted: Range<u32>) -> Result<Vec<ShadowRay>>;
    /// Whether to cast the rays of a patch that are not stored, in a stage of `new` rays. If not, notes that `missing` rays
    /// are missing.
    fn casts(&self, patch: usize, missing: u32, new: u64) -> bool;
    /// Stores rays of patches, given as (patch, number of the first ray, all rays from it on).
    fn keep(&self, rays: &[(usize, u32, &[ShadowRay])]) -> Result<()>;
}

impl ShadowRays {
    /// A set without rays.
    pub(crate) fn none(lamps: Lamps) -> ShadowRays {
        ShadowRays { lamps, offsets: vec![0], ..ShadowRays::default() }
    }

    /// Number of patches for which rays were cast.
    fn len(&self) -> usize {
        self.offsets.len().max(1) - 1
    }

    /// Number of rays of all patches.
    pub(crate) fn rays(&self) -> u64 {
        self.rays.len() as u64
    }

    /// Number of rays of patch `i`.
    pub(crate) fn count(&self, i: usize) -> u32 {
        if i < self.len() { (self.offsets[i + 1] - self.offsets[i]) as u32 } else { 0 }
    }

    /// The rays of patch `i`.
    pub(super) fn of(&self, i: usize) -> &[ShadowRay] {
        if i < self.len() { &self.rays[self.offsets[i]..self.offsets[i + 1]] } else { &[] }
    }

    /// The unblocked form factors of patch `i` to all pieces; empty if they are not known.
    pub(super) fn unoccluded(&self, i: usize) -> &[f64] {
        let count = self.lamps.pieces.len();
        if self.lamps.are_known() { &self.unoccluded[i * count..][..count] } else { &[] }
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.rays[..]) + size_of_val(&self.unoccluded[..]) + 9 * self.len()
    }

    /// The first or second half of every patch's rays; `None` if some patch has only one ray.
    pub(crate) fn half(&self, half: usize) -> Option<ShadowRays> {
        let mut part = ShadowRays {
            lamps: self.lamps.clone(),
            offsets: vec![0],
            rays: Vec::with_capacity(self.rays.len().div_ceil(2)),
            unoccluded: self.unoccluded.clone(),
            is_faced: self.is_faced.clone(),
        };
        for i in 0..self.len() {
            let (all, middle) = (self.of(i), self.of(i).len() / 2);
            if all.len() == 1 {
                return None;
            }
            part.rays.extend_from_slice([&all[..middle], &all[middle..]][half]);
            part.offsets.push(part.rays.len());
        }
        Some(part)
    }

    /// Removes all light from these patches, which are sorted.
    pub(crate) fn withdraw(&mut self, patches: &[usize]) {
        let cast = self.len();
        for &i in patches.iter().filter(|&&i| i < cast) {
            self.rays[self.offsets[i]..self.offsets[i + 1]].fill(ShadowRay::NONE);
        }
    }

    /// Computes the unblocked form factors of patches to lamps, and which patches light can reach.
    pub(crate) fn face(&mut self, tracer: &Tracer, patches: &Patches) {
        let (n, known) = (patches.len(), self.is_faced.len());
        let lamps = &self.lamps;
        let count = if lamps.are_known() { lamps.pieces() } else { 0 };
        let start = self.unoccluded.len();
        // Written in place: with many pieces they take most of the memory.
        self.unoccluded.reserve_exact((n - known) * count);
        self.unoccluded.resize(start + (n - known) * count, 0.0);
        self.is_faced.resize(n, false);
        let (unoccluded, faced) = (&mut self.unoccluded[start..], &mut self.is_faced[known..]);
        let face = |i: usize, unoccluded: &mut [f64], faced: &mut bool| {
            let from = Footprint::new(tracer, patches, i);
            lamps.unoccluded_into(tracer, patches, i, unoccluded);
            *faced = lamps.choice(&from, unoccluded).is_some();
        };
        let each = faced.par_iter_mut().enumerate().with_min_len(32);
        if count == 0 {
            each.for_each(|(k, faced)| face(known + k, &mut [], faced));
        } else {
            let rows = unoccluded.par_chunks_mut(count);
            each.zip(rows).for_each(|((k, faced), row)| face(known + k, row, faced));
        }
    }

    /// The unblocked irradiance of patch `i` for this emission from the pieces whose unblocked light is known exactly, by
    /// channel; `None` if there are too many pieces.
    pub(crate) fn unblocked<const C: usize>(&self, i: usize, emission: &[[f64; C]]) -> Option<[f64; C]> {
        self.lamps.are_known().then(|| {
            let mut sum = [0.0; C];
            for (piece, f) in self.lamps.pieces.iter().zip(self.unoccluded(i)).filter(|(p, _)| p.is_known()) {
                let sent = piece.sent(emission, 1.0);
                (0..C).for_each(|c| sum[c] += f * sent[c]);
            }
            sum
        })
    }

    /// Casts the shadow rays of patch `i` with these numbers without storing them, and calls `found` with each. Rays that
    /// face no lamp are left out.
    pub(crate) fn each<const C: usize>(
        &self,
        (tracer, i, from): (&Tracer, usize, &Footprint),
        emission: &[[f64; C]],
        indices: Range<u32>,
        seed: u64,
        mut found: impl FnMut(&Sample<C>),
    ) {
        cast(tracer, &self.lamps, from, self.unoccluded(i), indices, seed, |index, ray| {
            let piece = &self.lamps.pieces[ray.piece as usize];
            let weight = f64::from(ray.weight.abs());
            found(&Sample {
                half: index as usize % HALVES,
                light: piece.sent(emission, 1.0).map(|sent| weight * sent),
                known: if piece.is_known() { weight * piece.brightness } else { 0.0 },
                is_free: ray.weight > 0.0,
                is_remote: piece.is_remote(),
            });
        });
    }

    /// Whether any light of lamps can reach patch `i`.
    pub(crate) fn is_faced(&self, i: usize) -> bool {
        self.is_faced[i]
    }

    /// Casts rays until every patch that light can reach has the `wanted` number. Rays cast before are kept.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped) when `progress` says so, and the errors of `keep`.
    pub(crate) fn extend(
        &mut self,
        tracer: &Tracer,
        patches: &Patches,
        wanted: impl Fn(usize) -> u32,
        seed: u64,
        (keep, ranks): (Option<&dyn Keep>, Ranks),
        progress: &Progress,
    ) -> Result<()> {
        if self.lamps.is_empty() {
            return Ok(());
        }
        self.face(tracer, patches);
        let n = patches.len();
        let mut offsets = vec![0];
        for i in 0..n {
            let want = if self.is_faced[i] { wanted(i) } else { 0 };
            offsets.push(offsets[i] + want.max(self.count(i)) as usize);
        }
        let mut rays = vec![ShadowRay::NONE; offsets[n]];
        (0..self.len()).for_each(|i| rays[offsets[i]..][..self.of(i).len()].copy_from_slice(self.of(i)));
        let stage = (offsets[n] - self.rays.len()) as u64;
        progress.begin("casting shadow rays", stage);
        const BLOCK: usize = 32;
        let mut rest = &mut rays[..];
        let mut work = Vec::new();
        for start in (0..n).step_by(BLOCK) {
            let end = (start + BLOCK).min(n);
            let (block, tail) = rest.split_at_mut(offsets[end] - offsets[start]);
            work.push((start..end, block));
            rest = tail;
        }
        let this = &*self;
        let owner = |i: usize| ranks.of_turn(i / BLOCK);
        work.into_par_iter().try_for_each(|(range, mut rest)| {
            let mut cast = Vec::new();
            if owner(range.start) != ranks.rank() {
                range.for_each(|i| {
                    progress.advance((offsets[i + 1] - offsets[i]) as u64 - u64::from(this.count(i)))
                });
                return Ok(());
            }
            for i in range {
                progress.check()?;
                let (own, tail) = rest.split_at_mut(offsets[i + 1] - offsets[i]);
                rest = tail;
                let mut had = this.count(i);
                let new = own.len() as u32 - had;
                if let Some(keep) = keep.filter(|_| new > 0) {
                    let known = keep.known(i, had..own.len() as u32)?;
                    own[had as usize..][..known.len()].copy_from_slice(&known);
                    had += known.len() as u32;
                    let missing = own.len() as u32 - had;
                    if missing > 0 && !keep.casts(i, missing, stage) {
                        continue;
                    }
                }
                this.cast(
                    tracer,
                    &Footprint::new(tracer, patches, i),
                    i,
                    had,
                    own,
                    mix(&[seed, i as u64, 1]),
                );
                progress.advance(new.into());
                cast.push((i, had, &*own));
            }
            let cast: Vec<_> = cast
                .into_iter()
                .map(|(i, had, own)| (i, had, &own[had as usize..]))
                .filter(|(.., own)| !own.is_empty())
                .collect();
            keep.map_or(Ok(()), |keep| keep.keep(&cast))
        })?;
        if ranks.count() > 1 {
            let new = |i: usize| (offsets[i] + self.count(i) as usize..offsets[i + 1], owner(i));
            let mut words: Vec<[u32; 2]> = rays.iter().map(|ray| [ray.piece, ray.weight.to_bits()]).collect();
            ranks.share(&mut words, (0..n).map(new));
            let ray = |[piece, weight]: [u32; 2]| ShadowRay { piece, weight: f32::from_bits(weight) };
            rays.iter_mut().zip(words).for_each(|(to, words)| *to = ray(words));
        }
        (self.rays, self.offsets) = (rays, offsets);
        Ok(())
    }

    /// Casts the rays of a patch from number `had` on.
    fn cast(&self, tracer: &Tracer, from: &Footprint, i: usize, had: u32, own: &mut [ShadowRay], seed: u64) {
        let indices = had..own.len() as u32;
        if !indices.is_empty() {
            cast(tracer, &self.lamps, from, self.unoccluded(i), indices, seed, |index, ray| {
                own[index as usize] = ray;
            });
        }
    }
}

/// Casts the shadow rays of a patch with these indices, and calls `found` with each, in the order in which they finish.
/// Rays whose points do not face each other are left out.
fn cast(
    tracer: &Tracer,
    lamps: &Lamps,
    from: &Footprint,
    unoccluded: &[f64],
    indices: Range<u32>,
    seed: u64,
    mut found: impl FnMut(u32, ShadowRay),
) {
    let Some(choice) = lamps.choice(from, unoccluded) else { return };
    let rays = paths(lamps, &choice, from, indices, seed)
        .map(|(index, Path { from, to, piece, weight })| ((index, ShadowRay { piece, weight }), from, to));
    tracer.visible_each(rays, |(index, ray), visible| {
        found(index, if visible { ray } else { ShadowRay { weight: -ray.weight, ..ray } });
    });
}

/// The paths of a patch's shadow rays with these numbers, one sequence after the other. Paths whose points do not face
/// each other are left out.
pub(super) fn paths<'a>(
    lamps: &'a Lamps,
    choice: &'a Choice<'a>,
    from: &'a Footprint,
    indices: Range<u32>,
    seed: u64,
) -> impl Iterator<Item = (u32, Path)> + 'a {
    let turns = (0..HALVES as u32).flat_map(move |turn| {
        let sobol = Sobol::new(mix(&[seed, turn.into()]));
        let number = |index: u32| (index + HALVES as u32 - 1 - turn) / HALVES as u32;
        let numbers = number(indices.start)..number(indices.end);
        blocks(numbers).flat_map(move |(first, lanes)| {
            let points: [[f32; LANES]; 4] = sobol.points(first);
            lanes.map(move |lane| (HALVES as u32 * (first + lane as u32) + turn, points.map(|x| x[lane])))
        })
    });
    turns.filter_map(|(index, point)| Some((index, lamps.sample(choice, from, point)?)))
}
