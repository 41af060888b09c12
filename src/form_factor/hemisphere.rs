//! Hemisphere rays: from points spread over a patch, in cosine-distributed directions (Malley's method), the share of
//! rays that land on patch j estimates the form factor F_ij.
//!
//! Two dimensions of an Owen-scrambled Sobol sequence choose the point, two the direction. Rays from the centroid
//! alone would not converge to the form factor of the patch, and independent random rays need about ten times as many.
//! A patch has one sequence, which more rays continue. Its [`REPLICATES`] equal parts, one after the other, tell the
//! standard error by their spread.

mod casting;

use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use rayon::prelude::*;

use super::{
    checkpoint::Section,
    shadow::{self, Found, Link, Sources},
};
use crate::{patch::Patches, trace::Tracer};

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
                    if link.probe().is_some() {
                        hits.links.push(*link);
                    } else if range.contains(&link.index) {
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
        let index = link.probe().map_or(link.index, |probe| (link.to + probe) % rays);
        let replicate = ((many * u64::from(index) + many - 1) / u64::from(rays)) as usize;
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
}
