//! From hits to a reciprocal matrix.
//!
//! A ray from i that lands on j measures j → i as well. With h_ij hits from R_i rays, the inverse-variance estimate of
//! the symmetric exchange area is S_ij = (h_ij + h_ji) / (R_i / A_i + R_j / A_j). The plain mean of A_i F_ij and
//! A_j F_ji is worse as soon as areas or numbers of rays differ.

use rayon::prelude::*;

use super::{
    Matrix,
    blocks::{Blocks, PLACE},
    hemisphere::{Hits, LINKED, REPLICATES},
    shadow::{Found, Link},
    symmetric::Symmetric,
};

/// Weight of a hemisphere ray's density against a shadow ray's in the balance heuristic, where lamps are many. Any gives
/// the same mean. As many shadow rays as wanted go to a pair, while hemisphere rays find it by chance: their number varies
/// as well as what they say. RMS errors of irradiance at 64 rays a patch on four rooms, 0.1 against 1: 9.3 against 11.5 %,
/// 8.4 against 9.8 %, 3.0 against 5.2 %, 7.9 against 10.9 %; 0.01 loses where shadow rays are few.
const TRUST: f64 = 0.1;

/// The same where lamps are few, and their own rays alone are kept, in the power heuristic, which leaves more to whichever kind
/// samples a pair better. Others' shadow rays are stratified too, and better where a lamp is far. RMS errors on the patches of
/// lamps at 256 rays a patch with 0, 0.3, 0.5 and 1: 8.3, 1.0, 0.8 and 0.6 % on a ceiling that shines as a whole, 0.6, 0.7, 1.1 and
/// 2.1 % on the lamp of the Cornell box.
const LAMPS_TRUST: f64 = 0.5;

/// How densely the rays sample pairs of points, in relative areas.
#[derive(Debug, Clone)]
pub(super) struct Densities {
    /// R_i / A_i.
    hemisphere: Vec<f64>,
    /// N_i / A_i.
    shadow: Vec<f64>,
    /// p_i / A_i.
    source: Vec<f64>,
    /// The same if shadow rays went to sources by power alone.
    brightness: Vec<f64>,
    /// The known mean kernel of each patch's shadow rays to each lamp over that of its samples; 1 where lamps are many.
    ratios: Vec<f64>,
    /// What gives each patch the light that it is known to get from each lamp; 1 of sources, and where lamps are many.
    restored: Vec<f64>,
    /// Relative area of one unit-space area.
    unit: f64,
}

impl Densities {
    /// `areas` are relative, `unit` is how many of them make one unit-space area.
    pub(super) fn new(hits: &Hits, areas: &[f64], unit: f64) -> Densities {
        let a_patch = |f: &dyn Fn(usize) -> f64| (0..areas.len()).map(|i| f(i) / areas[i]).collect();
        let probability = |i: usize| hits.sources.probability(i);
        let ratios =
            (0..areas.len()).into_par_iter().with_min_len(128).flat_map_iter(|i| lamp_ratios(hits, i));
        Densities {
            hemisphere: a_patch(&|i| f64::from(hits.rays_of(i))),
            shadow: a_patch(&|i| f64::from(hits.shadow_rays_of(i))),
            source: a_patch(&probability),
            brightness: a_patch(&|i| probability(i) * hits.sources.weight(i)),
            ratios: ratios.collect(),
            restored: vec![1.0; areas.len() * hits.sources.lamps()],
            unit,
        }
    }

    /// Radiosity of sources, all channels together, in a unit of its own; zero of all that are none.
    pub(super) fn brightness(&self) -> &[f64] {
        &self.brightness
    }

    /// What a hemisphere ray that connects two patches, neither a source, adds to their exchange area.
    #[inline]
    pub(super) fn hit(&self, i: usize, j: usize) -> f64 {
        1.0 / (self.hemisphere[i] + self.hemisphere[j])
    }

    /// What a hemisphere ray of patch `i` that lands on `j` adds to the exchange area, where own rays count `trust` times
    /// as much as those that come in; and what the same ray, coming in, adds to the estimate of patch `j`.
    #[inline]
    pub(super) fn one_sided(&self, i: usize, j: usize, trust: f64) -> (f64, f64) {
        let (h_i, h_j) = (self.hemisphere[i], self.hemisphere[j]);
        (trust / (trust * h_i + h_j), 1.0 / (trust * h_j + h_i))
    }

    /// What a link from patch `i` adds to the exchange area of its patches: by the balance heuristic, or where lamps are few by
    /// the power heuristic.
    #[inline]
    pub(super) fn link(&self, hits: &Hits, i: usize, link: &Link) -> f64 {
        let j = link.to as usize;
        let kernel = f64::from(link.kernel) / self.unit;
        let shadow = self.shadow[i] * self.source[j] + self.shadow[j] * self.source[i];
        let by_shadow_ray = match link.found {
            Found::Blocked => return 0.0,
            Found::Shadow => true,
            Found::Hemisphere => false,
        };
        if hits.sources.are_lamps() {
            // Of others' rays that meet lamps nothing is kept.
            let of_lamp = |k: usize| if self.source[k] > 0.0 { self.hemisphere[k] } else { 0.0 };
            let hemisphere = LAMPS_TRUST * (of_lamp(i) + of_lamp(j)) * kernel;
            let weight = if by_shadow_ray { shadow } else { LAMPS_TRUST * hemisphere };
            let both = (hemisphere.powi(2) + shadow.powi(2)).max(f64::MIN_POSITIVE);
            return self.restored(hits, i, j) * weight * kernel / both;
        }
        let weight = if by_shadow_ray { 1.0 } else { TRUST };
        weight * kernel / (TRUST * (self.hemisphere[i] + self.hemisphere[j]) * kernel + shadow)
    }

    /// What gives a pair of a lamp and another patch the light that this is known to get.
    #[inline]
    fn restored(&self, hits: &Hits, i: usize, j: usize) -> f64 {
        let (lamps, lamp) = (hits.sources.lamps(), |k: usize| hits.sources.lamp_of(k));
        self.restored[i * lamps + lamp(j)] * self.restored[j * lamps + lamp(i)]
    }

    /// What a link from patch `i` adds to what a row gets from all lamps together, where these are few and the row's patch is none:
    /// its own shadow rays alone tell that.
    #[inline]
    pub(super) fn known(&self, hits: &Hits, row: usize, i: usize, link: &Link) -> Option<f64> {
        let is_known = hits.sources.are_lamps() && self.source[row] == 0.0;
        is_known.then(|| if row == i { self.received(hits, i, link) } else { 0.0 })
    }

    /// What a shadow ray of patch `i` to one of few lamps adds to what it gets: a ratio estimate, all to that lamp together.
    #[inline]
    fn received(&self, hits: &Hits, i: usize, link: &Link) -> f64 {
        if link.found != Found::Shadow {
            return 0.0;
        }
        let l = link.to as usize;
        let ratio = self.ratios[i * hits.sources.lamps() + hits.sources.lamp_of(l)];
        ratio * f64::from(link.kernel) / (self.unit * self.shadow[i] * self.source[l])
    }
}

/// The known mean kernel of patch `i`'s shadow rays to each lamp over that of its samples; infinite where it has none.
fn lamp_ratios(hits: &Hits, i: usize) -> Vec<f64> {
    let mut kernels = vec![0.0; hits.sources.lamps()];
    if !hits.sources.are_lamps() {
        return vec![1.0; kernels.len()];
    }
    for link in hits.links_of(i).iter().filter(|l| l.found != Found::Hemisphere) {
        let l = link.to as usize;
        kernels[hits.sources.lamp_of(l)] += f64::from(link.kernel) * hits.sources.weight(l);
    }
    let rays = f64::from(hits.shadow_rays_of(i));
    let ratio =
        |(known, kernels): (&f64, f64)| if kernels > 0.0 { known * rays / kernels } else { f64::INFINITY };
    hits.mean_kernels_of(i).iter().zip(kernels).map(ratio).collect()
}

/// By how much the kernels of each replicate of patch `i`'s shadow rays to each lamp exceed their mean, as a share of it: what the
/// ratio estimator corrects for. Zero where lamps are many.
pub(super) fn excess_kernels(hits: &Hits, i: usize, excess: &mut Vec<[f32; REPLICATES]>) {
    excess.clear();
    excess.resize(hits.sources.lamps(), [0.0; REPLICATES]);
    if !hits.sources.are_lamps() {
        return;
    }
    for link in hits.links_of(i).iter().filter(|l| l.found != Found::Hemisphere) {
        let (replicate, many) = hits.part_of(i, link);
        excess[hits.sources.lamp_of(link.to as usize)][replicate] += many as f32 * link.kernel;
    }
    for excess in excess {
        let mean = excess.iter().sum::<f32>() / REPLICATES as f32;
        if mean > 0.0 {
            *excess = excess.map(|kernels| kernels / mean - 1.0);
        }
    }
}

/// The hits that connect two patches, neither a source, by the blocks that these are in: what is near in memory is counted
/// together.
#[derive(Default)]
pub(super) struct Buckets {
    pub(super) blocks: Blocks,
    /// Of each block, one after the other, what its rays met in each.
    lists: Vec<Bucket>,
}

/// What the rays of one block met in another.
#[derive(Default)]
struct Bucket {
    /// Places of the patch and of what it met, part by part, and in each by the patch.
    pairs: Vec<u32>,
    /// Where each part ends.
    ends: Vec<u32>,
}

impl Buckets {
    pub(super) fn new(hits: &Hits, blocks: Blocks) -> Buckets {
        Self::in_parts(hits, blocks, 1, |i, _| hits.of(i))
    }

    /// Each replicate by itself.
    pub(super) fn by_replicates(hits: &Hits, blocks: Blocks) -> Buckets {
        Self::in_parts(hits, blocks, REPLICATES, |i, replicate| hits.of_replicate(i, replicate))
    }

    fn in_parts<'a>(
        hits: &'a Hits,
        blocks: Blocks,
        parts: usize,
        of: impl Fn(usize, usize) -> &'a [u32] + Sync,
    ) -> Buckets {
        let of_block = |block: usize| {
            let mut lengths = vec![0; blocks.count()];
            let rays = |i: usize| hits.of(i).iter().map(|&j| j as usize).filter(|&j| j < LINKED as usize);
            for j in blocks.range(block).flat_map(rays) {
                lengths[blocks.of(j).0] += 1;
            }
            let empty =
                |length| Bucket { pairs: Vec::with_capacity(length), ends: Vec::with_capacity(parts) };
            let mut lists: Vec<Bucket> = lengths.into_iter().map(empty).collect();
            for part in 0..parts {
                for i in blocks.range(block) {
                    let row = blocks.of(i).1 << PLACE;
                    for &j in of(i, part).iter().filter(|&&j| j < LINKED) {
                        let (other, column) = blocks.of(j as usize);
                        lists[other].pairs.push(row | column);
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

    /// What rays from one block met in another: place of the patch, place of what it met. Of one part, by the patch.
    pub(super) fn list(&self, from: usize, to: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.bucket(from, to).pairs.iter().map(|&pair| places(pair))
    }

    /// The same of one replicate.
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

/// The keys of pairs that come by rows, in order.
fn sorted(pairs: impl Iterator<Item = (usize, usize)>) -> Vec<u32> {
    let mut keys: Vec<u32> = pairs.map(|(r, c)| key(r, c)).collect();
    keys.chunk_by_mut(|x, y| x >> PLACE == y >> PLACE).for_each(<[u32]>::sort_unstable);
    keys
}

/// The keys, in order, of pairs that come by columns: each has its place in its row as soon as it is known how many come before.
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

/// The pooled exchange areas S_ij of all pairs without a source, and the largest |A_i F_ij - A_j F_ji| / min(A_i, A_j) that
/// the one-way estimates F_ij = h_ij / R_i of these have.
pub(super) fn pool(hits: &Hits, buckets: &Buckets, densities: &Densities, areas: &[f64]) -> (Symmetric, f64) {
    let blocks = buckets.blocks;
    let (matrix, deviations) = Symmetric::from_tiles(blocks, |(a, b)| {
        let (start_a, start_b) = (blocks.range(a).start, blocks.range(b).start);
        // By rays of the row, and by rays of the column. A flat patch does not see itself.
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
            let one_way = |k: usize, hits_of: f64| areas[k] * hits_of / f64::from(hits.rays_of(k));
            let difference = one_way(i, out) - one_way(j, back);
            deviation = deviation.max(difference.abs() / areas[i].min(areas[j]));
            entries.push((row as u16, column as u16, ((out + back) * densities.hit(i, j)) as f32));
        }
        let count = entries.len();
        (entries.into_iter(), count, deviation)
    });
    (matrix, deviations.into_iter().fold(0.0, f64::max))
}

/// The exchange areas S_ij of all pairs with a source. Where lamps are few, what each other patch gets from all of them is what
/// its shadow rays say, which is nearly known; how that divides among pairs is told by the hemisphere rays of lamps too.
pub(super) fn links(hits: &Hits, densities: &mut Densities) -> Symmetric {
    let blocks = Blocks::new(hits.len());
    let of_block = |block: usize| -> Vec<(u32, u32, f32)> {
        let value = |i: usize, l: &Link| (i as u32, l.to, densities.link(hits, i, l) as f32);
        let of_patch = |i: usize| hits.links_of(i).iter().map(move |l| value(i, l));
        blocks.range(block).flat_map(of_patch).filter(|&(_, _, s)| s > 0.0).collect()
    };
    let lists: Vec<_> = (0..blocks.count()).into_par_iter().with_max_len(1).map(of_block).collect();
    let mut links = Symmetric::from_lists(hits.len(), &lists);
    if hits.sources.are_lamps() {
        let lamps = hits.sources.lamps();
        let divided: Vec<Vec<f64>> = (0..lamps)
            .map(|lamp| {
                let of_lamp =
                    |j: usize| if hits.sources.lamp_of(j) == lamp { densities.brightness[j] } else { 0.0 };
                links.product(&(0..hits.len()).map(of_lamp).collect::<Vec<f64>>())
            })
            .collect();
        let restore = |i: usize| {
            let mut known = vec![0.0; lamps];
            for link in hits.links_of(i) {
                let j = link.to as usize;
                known[hits.sources.lamp_of(j)] += densities.received(hits, i, link) * densities.brightness[j];
            }
            let (of_lamps, divided, is_source) =
                (&densities.ratios[i * lamps..], &divided, densities.source[i] > 0.0);
            // Of a lamp that no shadow ray could see, as it hardly rises above the horizon, its own rays tell.
            let factor = move |(lamp, known): (usize, f64)| {
                let is_known = !is_source && of_lamps[lamp].is_finite() && divided[lamp][i] > 0.0;
                if is_known { known / divided[lamp][i] } else { 1.0 }
            };
            known.into_iter().enumerate().map(factor)
        };
        densities.restored =
            (0..hits.len()).into_par_iter().with_min_len(128).flat_map_iter(restore).collect();
        links.update(|i, j, s| s * densities.restored(hits, i, j) as f32);
    }
    links
}

/// How many rays of each patch met which, row by row.
pub(super) fn one_way(hits: &Hits) -> Matrix {
    let mut starts = vec![0];
    let (mut columns, mut counts) = (Vec::new(), Vec::new());
    for i in 0..hits.len() {
        let mut targets: Vec<u32> = hits.of(i).iter().copied().filter(|&j| j < LINKED).collect();
        targets.sort_unstable();
        for run in targets.chunk_by(|a, b| a == b) {
            columns.push(run[0]);
            counts.push(run.len() as f32);
        }
        starts.push(columns.len());
    }
    Matrix::new((hits.len(), hits.len()), starts, columns, counts)
}
