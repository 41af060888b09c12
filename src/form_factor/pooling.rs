//! Pools the hits of both directions into a symmetric matrix.
//!
//! A ray from i that lands on j also measures the direction j → i. With h_ij hits from R_i rays, the inverse-variance
//! estimate of the symmetric exchange area is S_ij = (h_ij + h_ji) / (R_i / A_i + R_j / A_j). The plain mean of
//! A_i F_ij and A_j F_ji is worse as soon as areas or numbers of rays differ.

use rayon::prelude::*;

use crate::{
    rays::{ESCAPED, REPLICATES, RaySet},
    symmetric::{
        Matrix, Symmetric,
        blocks::{Blocks, PLACE},
    },
};

/// Sampling density of each patch: R_i / A_i.
#[derive(Debug, Clone)]
pub(crate) struct Densities(Vec<f64>);

impl Densities {
    pub(super) fn new(rays: &RaySet, areas: &[f64]) -> Densities {
        Densities(areas.iter().enumerate().map(|(i, area)| f64::from(rays.rays_of(i)) / area).collect())
    }

    /// Exchange area that one ray between two patches contributes.
    #[inline]
    fn hit(&self, i: usize, j: usize) -> f64 {
        1.0 / (self.0[i] + self.0[j])
    }

    /// Contributions of a ray of patch `i` that lands on `j` to one-sided estimates, in which own rays weigh `trust`
    /// times as much as arriving rays. The first value is for the row of `i`, the second for the row of `j`.
    #[inline]
    pub(super) fn one_sided(&self, i: usize, j: usize, trust: f64) -> (f64, f64) {
        let (h_i, h_j) = (self.0[i], self.0[j]);
        (trust / (trust * h_i + h_j), 1.0 / (trust * h_j + h_i))
    }
}

/// The rays between patches, sorted by the blocks of both patches, so that values close in memory are counted together.
#[derive(Default)]
pub(super) struct Buckets {
    pub(super) blocks: Blocks,
    /// For each block, one after the other, its rays to each block.
    lists: Vec<Bucket>,
}

/// Rays from one block to another.
#[derive(Default)]
struct Bucket {
    /// Places of the origin and of the target, sorted by part and within a part by origin.
    pairs: Vec<u32>,
    /// Where each part ends.
    ends: Vec<u32>,
}

impl Buckets {
    pub(super) fn new(rays: &RaySet, blocks: Blocks) -> Buckets {
        let needs = |from: usize, to: usize| blocks.has((from, to));
        Self::in_parts(rays, blocks, 1, |i, _| rays.of(i), needs)
    }

    /// One part for each replicate.
    pub(super) fn by_replicates(rays: &RaySet, blocks: Blocks) -> Buckets {
        let needs = |_, to: usize| blocks.owns(to);
        Self::in_parts(rays, blocks, REPLICATES, |i, replicate| rays.of_replicate(i, replicate), needs)
    }

    fn in_parts<'a>(
        rays: &'a RaySet,
        blocks: Blocks,
        parts: usize,
        of: impl Fn(usize, usize) -> &'a [u32] + Sync,
        needs: impl Fn(usize, usize) -> bool + Sync,
    ) -> Buckets {
        let of_block = |block: usize| {
            let needed: Vec<bool> = (0..blocks.count()).map(|other| needs(block, other)).collect();
            let mut lengths = vec![0; blocks.count()];
            let met = |i: usize| rays.of(i).iter().filter(|&&j| j != ESCAPED).map(|&j| j as usize);
            for other in blocks.range(block).flat_map(met).map(|j| blocks.of(j).0) {
                lengths[other] += usize::from(needed[other]);
            }
            let empty =
                |length| Bucket { pairs: Vec::with_capacity(length), ends: Vec::with_capacity(parts) };
            let mut lists: Vec<Bucket> = lengths.into_iter().map(empty).collect();
            for part in 0..parts {
                for i in blocks.range(block) {
                    let row = blocks.of(i).1 << PLACE;
                    for &j in of(i, part).iter().filter(|&&j| j != ESCAPED) {
                        let (other, column) = blocks.of(j as usize);
                        if needed[other] {
                            lists[other].pairs.push(row | column);
                        }
                    }
                }
                lists.iter_mut().for_each(|list| list.ends.push(list.pairs.len() as u32));
            }
            lists
        };
        let lists = (0..blocks.count()).into_par_iter().with_max_len(1).flat_map_iter(of_block).collect();
        Buckets { blocks, lists }
    }

    fn bucket(&self, from: usize, to: usize) -> &Bucket {
        &self.lists[from * self.blocks.count() + to]
    }

    /// Rays from one block to another, as (place of the origin, place of the target). With a single part they are
    /// sorted by origin.
    pub(super) fn list(&self, from: usize, to: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.bucket(from, to).pairs.iter().map(|&pair| places(pair))
    }

    /// Rays from one block to another, of one replicate.
    pub(super) fn of_replicate(
        &self,
        from: usize,
        to: usize,
        replicate: usize,
    ) -> impl Iterator<Item = (usize, usize)> + '_ {
        let Bucket { pairs, ends } = self.bucket(from, to);
        let start = if replicate > 0 { ends[replicate - 1] } else { 0 };
        pairs[start as usize..ends[replicate] as usize].iter().map(|&pair| places(pair))
    }
}

/// Row and column in a tile.
#[inline]
fn places(pair: u32) -> (usize, usize) {
    ((pair >> PLACE) as usize, (pair & ((1 << PLACE) - 1)) as usize)
}

/// Row and column as one number.
#[inline]
fn key(row: usize, column: usize) -> u32 {
    (row << PLACE | column) as u32
}

/// The sorted keys of pairs that are sorted by row.
fn sorted(pairs: impl Iterator<Item = (usize, usize)>) -> Vec<u32> {
    let mut keys: Vec<u32> = pairs.map(|(r, c)| key(r, c)).collect();
    keys.chunk_by_mut(|x, y| x >> PLACE == y >> PLACE).for_each(<[u32]>::sort_unstable);
    keys
}

/// The sorted keys of pairs that are sorted by column. Counting the entries of each row gives every key its place.
fn transposed<P: Iterator<Item = (usize, usize)>>(pairs: impl Fn() -> P, blocks: Blocks) -> Vec<u32> {
    let mut next = vec![0u32; blocks.rows() + 1];
    pairs().for_each(|(_, row)| next[row + 1] += 1);
    for row in 1..next.len() {
        next[row] += next[row - 1];
    }
    let mut keys = vec![0; next[blocks.rows()] as usize];
    for (column, row) in pairs() {
        keys[next[row] as usize] = key(row, column);
        next[row] += 1;
    }
    keys
}

/// The pooled exchange areas S_ij of all pairs, and the largest |A_i F_ij - A_j F_ji| / min(A_i, A_j) of the one-way
/// estimates F_ij = h_ij / R_i.
pub(super) fn pool(
    rays: &RaySet,
    buckets: &Buckets,
    densities: &Densities,
    areas: &[f64],
) -> (Symmetric, f64) {
    let blocks = buckets.blocks;
    let (matrix, deviations) = Symmetric::from_tiles(blocks, |(a, b)| {
        let (start_a, start_b) = (blocks.range(a).start, blocks.range(b).start);
        // Rays from the rows, and rays from the columns. A flat patch does not see itself.
        let (out, back) = if a == b {
            let hits = || buckets.list(a, a);
            (sorted(hits().filter(|(r, c)| r < c)), transposed(|| hits().filter(|(r, c)| r > c), blocks))
        } else {
            (sorted(buckets.list(a, b)), transposed(|| buckets.list(b, a), blocks))
        };
        let mut deviation = 0f64;
        let mut entries = Vec::with_capacity(out.len() + back.len());
        let (mut out, mut back) = (out.chunk_by(u32::eq).peekable(), back.chunk_by(u32::eq).peekable());
        loop {
            let pair = match (out.peek(), back.peek()) {
                (Some(out), Some(back)) => out[0].min(back[0]),
                (Some(hits), None) | (None, Some(hits)) => hits[0],
                (None, None) => break,
            };
            let out = out.next_if(|hits| hits[0] == pair).map_or(0, <[u32]>::len) as f64;
            let back = back.next_if(|hits| hits[0] == pair).map_or(0, <[u32]>::len) as f64;
            let (row, column) = places(pair);
            let (i, j) = (start_a + row, start_b + column);
            let one_way = |k: usize, hits_of: f64| areas[k] * hits_of / f64::from(rays.rays_of(k));
            let difference = one_way(i, out) - one_way(j, back);
            deviation = deviation.max(difference.abs() / areas[i].min(areas[j]));
            entries.push((row as u16, column as u16, ((out + back) * densities.hit(i, j)) as f32));
        }
        let count = entries.len();
        (entries.into_iter(), count, deviation)
    });
    (matrix, blocks.ranks().max(deviations.into_iter().fold(0.0, f64::max)))
}

/// Number of rays from each patch to each other patch, by rows.
pub(super) fn one_way(rays: &RaySet) -> Matrix {
    let mut starts = vec![0];
    let (mut columns, mut counts) = (Vec::new(), Vec::new());
    for i in 0..rays.len() {
        let mut targets: Vec<u32> = rays.of(i).iter().copied().filter(|&j| j != ESCAPED).collect();
        targets.sort_unstable();
        for run in targets.chunk_by(|a, b| a == b) {
            columns.push(run[0]);
            counts.push(run.len() as f32);
        }
        starts.push(columns.len());
    }
    Matrix::new((rays.len(), rays.len()), starts, columns, counts)
}
