//! Hemisphere rays: from points spread over a patch, in cosine-distributed directions (Malley's method), the share of
//! rays that land on patch j estimates the form factor F_ij.
//!
//! Two dimensions of an Owen-scrambled Sobol sequence choose the point, two the direction. Rays from the centroid
//! alone would not converge to the form factor of the patch, and independent random rays need about ten times as many.
//! A patch has one sequence, which more rays continue. Its [`REPLICATES`] equal parts, one after the other, tell the
//! standard error by their spread.

use std::{
    sync::atomic::{AtomicBool, Ordering::Relaxed},
    time::Instant,
};

use rayon::prelude::*;

use super::{
    checkpoint::{Known, Record, Section},
    shadow::{self, Footprint, Found, Link, Sources},
};
use crate::{
    Progress, Result,
    patch::Patches,
    scene::Scene,
    trace::{Tracer, sampling::mix},
};

/// Parts that the rays of each patch are divided into. The standard error then has 15 degrees of freedom; with 4 parts
/// intervals of two standard errors held only 85 % of patches, with 16 about 94 %.
pub const REPLICATES: usize = 16;

/// The target of a ray that left the scene.
pub const ESCAPED: u32 = u32::MAX;

/// The target of a ray that connects a source with another patch: such rays are kept with their geometry.
pub const LINKED: u32 = u32::MAX - 1;

/// So many hits are expected of other patches' rays at least where none can only mean that a patch is hidden from them: by
/// chance that happens once in 10⁹ patches.
const HIDDEN: f64 = 20.0;

/// While casting: the ray met the back of this front patch, which was no unknown yet.
pub(super) const BACK: u32 = 1 << 31;

/// How many rays leave a patch: none, or at least [`REPLICATES`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Share {
    pub(super) hemisphere: u32,
    pub(super) shadow: u32,
}

/// The rays of a replicate: as many as of any other, or one more.
fn part(rays: u32, replicate: usize) -> std::ops::Range<usize> {
    let start = |k: usize| k * rays as usize / REPLICATES;
    start(replicate)..start(replicate + 1)
}

/// What every ray met. Kept ray by ray: at 4 bytes a ray that is no more than counts would take, and it holds the
/// replicates apart.
#[derive(Debug, Clone)]
pub struct Hits {
    shares: Vec<Share>,
    /// Where the hemisphere rays of patch `i` begin in `targets`.
    offsets: Vec<usize>,
    targets: Vec<u32>,
    /// Where the links of patch `i` begin in `links`.
    link_offsets: Vec<usize>,
    links: Vec<Link>,
    /// The mean kernel of each patch's shadow rays to each lamp, were none blocked.
    mean_kernels: Vec<f64>,
    pub(super) sources: Sources,
    back_hits: u64,
    seconds: f64,
    /// Where rays are kept, and looked for before they are cast.
    pub(super) checkpoint: Option<Section>,
}

impl Hits {
    /// No rays yet.
    pub(super) fn none(sources: Sources) -> Hits {
        Hits {
            shares: Vec::new(),
            offsets: vec![0],
            targets: Vec::new(),
            link_offsets: vec![0],
            links: Vec::new(),
            mean_kernels: Vec::new(),
            sources,
            back_hits: 0,
            seconds: 0.0,
            checkpoint: None,
        }
    }

    /// The first or second half of every patch's rays; `None` when some patch has but one of a kind.
    pub(super) fn half(&self, half: usize) -> Option<Hits> {
        if self.shares.iter().any(|share| share.hemisphere < 2 || share.shadow == 1) {
            return None;
        }
        let of = |rays: u32| [0..rays / 2, rays / 2..rays][half].clone();
        let mut hits = Hits { mean_kernels: self.mean_kernels.clone(), ..Hits::none(self.sources.clone()) };
        let share = |share: &Share| Share {
            hemisphere: of(share.hemisphere).len() as u32,
            shadow: of(share.shadow).len() as u32,
        };
        hits.shares = self.shares.iter().map(share).collect();
        let add_targets = || {
            hits.targets.reserve_exact(self.targets.len().div_ceil(2) + self.len());
            for (i, share) in self.shares.iter().enumerate() {
                let own = of(share.hemisphere);
                hits.targets.extend_from_slice(&self.of(i)[own.start as usize..own.end as usize]);
                hits.offsets.push(hits.targets.len());
            }
        };
        let add_links = || {
            hits.links.reserve(self.links.len() / 2);
            for (i, share) in self.shares.iter().enumerate() {
                let (own, shadow) = (of(share.hemisphere), of(share.shadow));
                for link in self.links_of(i) {
                    let range = if link.found == Found::Hemisphere { &own } else { &shadow };
                    if range.contains(&link.index) {
                        hits.links.push(Link { index: link.index - range.start, ..*link });
                    }
                }
                hits.link_offsets.push(hits.links.len());
            }
        };
        rayon::join(add_targets, add_links);
        Some(hits)
    }

    /// Number of patches.
    pub fn len(&self) -> usize {
        self.shares.len()
    }

    /// Whether there is no patch.
    pub fn is_empty(&self) -> bool {
        self.shares.is_empty()
    }

    /// All rays cast, hemisphere and shadow rays.
    pub fn rays(&self) -> u64 {
        self.shares.iter().map(|s| u64::from(s.hemisphere) + u64::from(s.shadow)).sum()
    }

    /// Hemisphere rays that met the back of a surface.
    pub fn back_hits(&self) -> u64 {
        self.back_hits
    }

    /// Seconds that casting took, nothing else.
    pub fn seconds(&self) -> f64 {
        self.seconds
    }

    /// Hemisphere rays that left patch `i`.
    pub fn rays_of(&self, i: usize) -> u32 {
        self.shares[i].hemisphere
    }

    /// Shadow rays that left patch `i`.
    pub fn shadow_rays_of(&self, i: usize) -> u32 {
        self.shares[i].shadow
    }

    /// The links found from patch `i`.
    pub(super) fn links_of(&self, i: usize) -> &[Link] {
        &self.links[self.link_offsets[i]..self.link_offsets[i + 1]]
    }

    /// The replicate that found a link of patch `i`, and how many rays of its kind left the patch, as a multiple of those in it.
    #[inline]
    pub(super) fn part_of(&self, i: usize, link: &Link) -> (usize, f64) {
        let (many, rays) = (REPLICATES as u64, self.rays_like(i, link));
        let replicate = ((many * u64::from(link.index) + many - 1) / u64::from(rays)) as usize;
        (replicate, f64::from(rays) / part(rays, replicate).len() as f64)
    }

    fn rays_like(&self, i: usize, link: &Link) -> u32 {
        let share = self.shares[i];
        if link.found == Found::Hemisphere { share.hemisphere } else { share.shadow }
    }

    /// The mean kernels of patch `i`'s shadow rays to each lamp, were they chosen by power and none blocked; 1 where lamps are many.
    pub(super) fn mean_kernels_of(&self, i: usize) -> &[f64] {
        let lamps = self.sources.lamps();
        &self.mean_kernels[i * lamps..][..lamps]
    }

    /// What the hemisphere rays of patch `i` met: patches, [`ESCAPED`] or [`LINKED`].
    pub fn of(&self, i: usize) -> &[u32] {
        &self.targets[self.offsets[i]..self.offsets[i + 1]]
    }

    /// The same of one replicate.
    pub fn of_replicate(&self, i: usize, replicate: usize) -> &[u32] {
        &self.of(i)[part(self.shares[i].hemisphere, replicate)]
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        4 * self.targets.len() + size_of::<Link>() * self.links.len() + 32 * self.shares.len()
    }

    /// Casts rays until every patch has as many as `wanted(i, mean kernel)` says; those cast already are kept. Backs that
    /// are hit become patches and cast rays too, until no new ones are found. The result depends on the seed alone, not
    /// on the number of threads.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped) when `progress` says so.
    pub(super) fn extend(
        &mut self,
        scene: &Scene,
        tracer: &Tracer,
        patches: &mut Patches,
        wanted: impl Fn(usize, f64) -> Share,
        seed: u64,
        progress: &Progress,
    ) -> Result<()> {
        let start = Instant::now();
        let mut first = 0;
        while first < patches.len() {
            let last = patches.len();
            let kernels: Vec<f64> = (self.mean_kernels.len() / self.sources.lamps()..last)
                .into_par_iter()
                .flat_map_iter(|i| self.sources.mean_kernels(&Footprint::new(tracer, patches, i)))
                .collect();
            self.mean_kernels.extend(kernels);
            let before = self.rays();
            let old = self.make_room(first..last, &wanted);
            progress.begin(self.rays() - before);
            self.cast(tracer, patches, first, &old, seed, progress)?;
            let seen = backs_seen(patches, self);
            patches.add_backs(scene, &seen);
            first = last;
        }
        name_backs(patches, self);
        self.seconds += start.elapsed().as_secs_f64();
        Ok(())
    }

    /// Lets patches lose all light that are not there for others: none ever met them, though another face is at the same place, or
    /// though their own rays meet patches that should have met them [many times](HIDDEN). Reciprocity would have to send them what
    /// they cannot get. Sources are kept, but for those that are known to be hidden.
    pub(super) fn withdraw_hidden(&mut self, areas: &[f64], tracer: &Tracer, patches: &Patches) {
        let density = |i: usize| f64::from(self.rays_of(i)) / areas[i];
        let met: Vec<AtomicBool> = (0..self.len()).map(|_| AtomicBool::new(false)).collect();
        let meets = |j: u32| {
            // Most are known to be met: reading is cheaper than writing.
            if !met[j as usize].load(Relaxed) {
                met[j as usize].store(true, Relaxed);
            }
        };
        let met_by = |i: usize| {
            self.links_of(i).iter().for_each(|link| meets(link.to));
            let targets = self.of(i).iter().filter(|&&j| j < LINKED);
            targets.inspect(|&&j| meets(j)).map(|&j| density(j as usize) / density(i)).sum::<f64>()
        };
        let expected: Vec<f64> = (0..self.len()).into_par_iter().with_min_len(128).map(met_by).collect();
        let is_hidden = |i: usize| {
            let unmet = !met[i].load(Relaxed) && !self.sources.contains(i);
            unmet && (expected[i] >= HIDDEN || shadow::is_hidden(tracer, patches, i))
        };
        let hidden = (0..self.len()).into_par_iter().filter(|&i| self.sources.hide(i) || is_hidden(i));
        for i in hidden.collect::<Vec<_>>() {
            self.targets[self.offsets[i]..self.offsets[i + 1]].fill(ESCAPED);
            self.links[self.link_offsets[i]..self.link_offsets[i + 1]]
                .iter_mut()
                .for_each(|link| link.found = Found::Blocked);
        }
    }

    /// Makes room for the rays that patches want, and returns how many each had.
    fn make_room(
        &mut self,
        range: std::ops::Range<usize>,
        wanted: impl Fn(usize, f64) -> Share,
    ) -> Vec<Share> {
        let old = self.shares.clone();
        self.shares.resize(range.end, Share::default());
        for i in range.clone() {
            let want = wanted(i, self.mean_kernels_of(i).iter().sum());
            let have = &mut self.shares[i];
            have.hemisphere = have.hemisphere.max(want.hemisphere);
            have.shadow = have.shadow.max(want.shadow);
        }
        let mut offsets = vec![0];
        for i in 0..range.end {
            offsets.push(offsets[i] + self.rays_of(i) as usize);
        }
        // The rays of new patches follow those of old ones; those of old patches are moved apart.
        let mut targets = std::mem::take(&mut self.targets);
        if range.start > 0 || old.is_empty() {
            targets.resize(offsets[range.end], ESCAPED);
        } else {
            let mut apart = vec![ESCAPED; offsets[range.end]];
            for i in 0..old.len() {
                let had = &targets[self.offsets[i]..self.offsets[i + 1]];
                apart[offsets[i]..][..had.len()].copy_from_slice(had);
            }
            targets = apart;
        }
        (self.targets, self.offsets) = (targets, offsets);
        let mut old = old;
        old.resize(range.end, Share::default());
        old
    }

    /// Casts the rays that patches from `first` on have not cast yet, but for those that the checkpoint knows.
    fn cast(
        &mut self,
        tracer: &Tracer,
        patches: &Patches,
        first: usize,
        old: &[Share],
        seed: u64,
        progress: &Progress,
    ) -> Result<()> {
        const BLOCK: usize = 32;
        let Hits { shares, offsets, targets, sources, checkpoint, .. } = self;
        let checkpoint = checkpoint.as_ref().map(|section| section.names(patches, sources));
        let mut rest = &mut targets[offsets[first]..];
        let mut blocks = Vec::new();
        for start in (first..patches.len()).step_by(BLOCK) {
            let end = (start + BLOCK).min(patches.len());
            let (block, tail) = rest.split_at_mut(offsets[end] - offsets[start]);
            blocks.push((start..end, block));
            rest = tail;
        }
        let found: Vec<Vec<Vec<Link>>> = blocks
            .into_par_iter()
            .map(|(range, mut rest)| {
                let mut found = Vec::with_capacity(range.len());
                let mut record = Record::default();
                for i in range {
                    if progress.is_stopped() {
                        break;
                    }
                    let (had, share) = (old[i], shares[i]);
                    let (own, tail) = rest.split_at_mut(share.hemisphere as usize);
                    rest = tail;
                    let from = Footprint::new(tracer, patches, i);
                    let known = match &checkpoint {
                        Some(checkpoint) => checkpoint.known(i, had, share)?,
                        None => Known::nothing(had),
                    };
                    own[had.hemisphere as usize..][..known.targets.len()].copy_from_slice(&known.targets);
                    let mut links = known.hemisphere_links;
                    let new = known.rays.hemisphere..share.hemisphere;
                    let seed = mix(&[seed, i as u64]);
                    cast_patch(tracer, patches, sources, &from, i, (new, seed), own, &mut links);
                    links.extend(known.shadow_links);
                    let new = known.rays.shadow..share.shadow;
                    shadow::cast_patch(tracer, sources, &from, new, mix(&[seed, 1]), &mut links);
                    if let Some(checkpoint) = &checkpoint {
                        checkpoint.add(&mut record, i, (known.rays, share), own, &links);
                    }
                    found.push(links);
                    let before = had.hemisphere + had.shadow;
                    progress.advance(u64::from(share.hemisphere + share.shadow - before));
                }
                if let Some(checkpoint) = &checkpoint {
                    checkpoint.write(record)?;
                }
                progress.check()?;
                Ok(found)
            })
            .collect::<Result<_>>()?;
        self.add_links(first, found);
        Ok(())
    }

    /// Adds the links found from the patches from `first` on behind those that each had.
    fn add_links(&mut self, first: usize, found: Vec<Vec<Vec<Link>>>) {
        let known = self.link_offsets.len() - 1;
        let added: usize = found.iter().flatten().map(Vec::len).sum();
        let old = std::mem::take(&mut self.links);
        let old_offsets = std::mem::take(&mut self.link_offsets);
        self.links.reserve_exact(old.len() + added);
        self.links.extend_from_slice(&old[..old_offsets[first.min(known)]]);
        self.link_offsets.extend_from_slice(&old_offsets[..=first.min(known)]);
        for (k, links) in found.into_iter().flatten().enumerate() {
            if first + k < known {
                self.links.extend_from_slice(&old[old_offsets[first + k]..old_offsets[first + k + 1]]);
            }
            self.links.extend(links);
            self.link_offsets.push(self.links.len());
        }
    }
}

/// Casts the hemisphere rays of patch `i` with these indices; `targets` are those of all its rays.
#[expect(clippy::too_many_arguments, reason = "the inner loop of the program, called once")]
fn cast_patch(
    tracer: &Tracer,
    patches: &Patches,
    sources: &Sources,
    from: &Footprint,
    i: usize,
    (indices, seed): (std::ops::Range<u32>, u64),
    targets: &mut [u32],
    links: &mut Vec<Link>,
) {
    from.hemisphere_rays(indices, seed, |index, origin, direction, cosine| {
        let target = &mut targets[index as usize];
        let Some(hit) = tracer.closest(origin, direction) else {
            *target = ESCAPED;
            return;
        };
        *target = patches.at(hit.triangle, hit.barycentric, hit.front).unwrap_or_else(|| {
            BACK | patches.at(hit.triangle, hit.barycentric, true).expect("fronts are patches")
        });
        let j = (*target & !BACK) as usize;
        if sources.concern(i, if *target & BACK == 0 { j } else { usize::MAX }) {
            // Of what comes from few lamps nothing is left to measure, but how it divides among these their own rays tell; and
            // that backs were seen must be known.
            if !sources.are_lamps() || sources.contains(i) || !hit.front {
                let cos = tracer.triangles()[hit.triangle as usize].normal.dot(direction).abs();
                let kernel = cosine * cos / (std::f32::consts::PI * hit.t * hit.t);
                links.push(Link { to: *target, kernel, index, found: Found::Hemisphere });
            }
            *target = LINKED;
        }
    });
}

/// Triangles whose backs, no unknowns yet, were hit; in file order.
fn backs_seen(patches: &Patches, hits: &Hits) -> Vec<u32> {
    let targets = hits.targets.par_iter().copied().filter(|&target| target < LINKED);
    let links = hits.links.par_iter().map(|link| link.to);
    let mut seen: Vec<u32> = targets
        .chain(links)
        .filter(|&target| target & BACK != 0)
        .map(|target| patches.triangle((target & !BACK) as usize) as u32)
        .collect();
    seen.par_sort_unstable();
    seen.dedup();
    seen
}

/// Replaces the marks of [`BACK`] by the patches that the backs have become, and counts hits on backs.
fn name_backs(patches: &Patches, hits: &mut Hits) {
    let fronts = patches.fronts() as u32;
    let name = |target: &mut u32| {
        if *target >= LINKED {
            return 0;
        }
        if *target & BACK != 0 {
            let front = (*target & !BACK) as usize;
            *target = patches.back_of(front).expect("backs that were hit are patches");
        }
        u64::from(*target >= fronts)
    };
    hits.back_hits = hits.targets.par_iter_mut().map(name).sum::<u64>()
        + hits.links.par_iter_mut().map(|link| name(&mut link.to)).sum::<u64>();
}
