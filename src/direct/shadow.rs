//! Shadow rays: paths between points of a patch and points of lamps, each unblocked or blocked.
//!
//! The rays of a patch alternate between two sequences with separate scrambles, so that the visibility estimated from
//! one is independent of the samples of the other. Halves of one sequence complement each other: they made light behind
//! a grille 0.3 % too large, and 2 % if the lamp is cut into hundreds of pieces. For partly hidden large lamps such
//! halves are up to 7 % better at 64 rays a patch, and equal at 256.

use std::ops::Range;

use rayon::prelude::*;

use super::lamps::{Choice, Lamps, Path};
use crate::{
    Progress, Result,
    patch::Patches,
    ranks::Words,
    rays::{RaySet, footprint::Footprint, lists::Lists, targets::Names},
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
pub(super) struct ShadowRay {
    /// The piece, and the bits of the weight.
    words: [u32; 2],
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
    const NONE: ShadowRay = ShadowRay { words: [0; 2] };

    fn new(piece: u32, weight: f32) -> ShadowRay {
        ShadowRay { words: [piece, weight.to_bits()] }
    }

    pub(super) fn piece(self) -> usize {
        self.words[0] as usize
    }

    pub(super) fn weight(self) -> f32 {
        f32::from_bits(self.words[1])
    }

    /// The ray as it is in a checkpoint.
    fn bytes(self) -> [u8; 8] {
        std::array::from_fn(|b| self.words[b / 4].to_le_bytes()[b % 4])
    }

    /// The ray from a checkpoint; `None` if there is no such ray among this number of pieces.
    fn from_bytes(bytes: [u8; 8], pieces: usize) -> Option<ShadowRay> {
        let word = |k: usize| u32::from_le_bytes(std::array::from_fn(|b| bytes[4 * k + b]));
        let ray = ShadowRay { words: [word(0), word(1)] };
        (ray.piece() < pieces && ray.weight().is_finite()).then_some(ray)
    }
}

impl Words for ShadowRay {
    type Word = u32;
    const COUNT: usize = 2;

    fn words(&self) -> &[u32] {
        &self.words
    }

    fn words_mut(&mut self) -> &mut [u32] {
        &mut self.words
    }
}

/// The shadow rays of all patches.
#[derive(Debug, Clone, Default)]
pub(crate) struct ShadowRays {
    pub(crate) lamps: Lamps,
    rays: Lists<ShadowRay>,
    /// The unblocked form factor of each patch to each piece; empty if there are too many pieces.
    unoccluded: Vec<f64>,
    /// Whether any light can reach each patch.
    is_faced: Vec<bool>,
}

impl ShadowRays {
    /// A set without rays.
    pub(crate) fn none(lamps: Lamps) -> ShadowRays {
        ShadowRays { lamps, ..ShadowRays::default() }
    }

    /// Number of rays of all patches.
    pub(crate) fn rays(&self) -> u64 {
        self.rays.all.len() as u64
    }

    /// Number of rays of patch `i`.
    pub(crate) fn count(&self, i: usize) -> u32 {
        self.rays.count(i)
    }

    /// The rays of patch `i`.
    pub(super) fn of(&self, i: usize) -> &[ShadowRay] {
        self.rays.of(i)
    }

    /// The unblocked form factors of patch `i` to all pieces; empty if they are not known.
    pub(super) fn unoccluded(&self, i: usize) -> &[f64] {
        let count = self.lamps.pieces.len();
        if self.lamps.are_known() { &self.unoccluded[i * count..][..count] } else { &[] }
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        self.rays.bytes() + size_of_val(&self.unoccluded[..]) + self.is_faced.len()
    }

    /// The first or second half of every patch's rays; `None` if some patch has only one ray.
    pub(crate) fn half(&self, half: usize) -> Option<ShadowRays> {
        let (rays, lamps) = (self.rays.half(half)?, self.lamps.clone());
        let (unoccluded, is_faced) = (self.unoccluded.clone(), self.is_faced.clone());
        Some(ShadowRays { lamps, rays, unoccluded, is_faced })
    }

    /// Removes all light from these patches, which are sorted.
    pub(crate) fn withdraw(&mut self, patches: &[usize]) {
        patches.iter().for_each(|&i| self.rays.fill(i, ShadowRay::NONE));
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
            let piece = &self.lamps.pieces[ray.piece()];
            let weight = f64::from(ray.weight().abs());
            found(&Sample {
                half: index as usize % HALVES,
                light: piece.sent(emission, 1.0).map(|sent| weight * sent),
                known: if piece.is_known() { weight * piece.brightness } else { 0.0 },
                is_free: ray.weight() > 0.0,
                is_remote: piece.is_remote(),
            });
        });
    }

    /// Whether any light of lamps can reach patch `i`.
    pub(crate) fn is_faced(&self, i: usize) -> bool {
        self.is_faced[i]
    }

    /// Casts rays until every patch that light can reach has the `wanted` number. Rays cast before are kept. The checkpoint
    /// and the ranks are those of the `hemisphere` rays.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped) when `progress` says so, and those of the checkpoint.
    pub(crate) fn extend(
        &mut self,
        tracer: &Tracer,
        patches: &Patches,
        wanted: impl Fn(usize) -> u32,
        seed: u64,
        hemisphere: &RaySet,
        progress: &Progress,
    ) -> Result<()> {
        if self.lamps.is_empty() {
            return Ok(());
        }
        self.face(tracer, patches);
        let mut rays = std::mem::take(&mut self.rays);
        let before = rays.all.len();
        let wanted = |i: usize| if self.is_faced[i] { wanted(i) } else { 0 };
        let old = rays.make_room(0..patches.len(), wanted, ShadowRay::NONE);
        let new = (rays.all.len() - before) as u64;
        progress.begin("casting shadow rays", new);
        let section = hemisphere.checkpoint.as_ref().map(|section| section.of_kind(self.lamps.digest()));
        let (names, pieces) = (Names::new(patches), self.lamps.pieces());
        let decode = |bytes| ShadowRay::from_bytes(bytes, pieces);
        let found = rays.cast(
            (0, &old),
            (section.as_ref(), hemisphere.rays() + new, hemisphere.ranks),
            (&names, ShadowRay::bytes, decode),
            progress,
            |i, indices, own| {
                if !indices.is_empty() {
                    let (from, seed) = (Footprint::new(tracer, patches, i), mix(&[seed, i as u64, 1]));
                    cast(tracer, &self.lamps, &from, self.unoccluded(i), indices, seed, |index, ray| {
                        own[index as usize] = ray;
                    });
                }
            },
        );
        self.rays = rays;
        found
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
        .map(|(index, Path { from, to, piece, weight })| ((index, piece, weight), from, to));
    tracer.visible_each(rays, |(index, piece, weight), visible| {
        found(index, ShadowRay::new(piece, if visible { weight } else { -weight }));
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
