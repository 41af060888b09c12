//! Hemisphere rays: from points spread over a patch, in cosine-distributed directions (Malley's method), the share of
//! rays that land on patch j estimates the form factor F_ij.
//!
//! Two dimensions of an Owen-scrambled Sobol sequence choose the point, two the direction. Rays from the centroid
//! alone would not converge to the form factor of the patch, and independent random rays need about ten times as many.
//! The rays of a patch come as [`REPLICATES`] independent scrambles, whose spread tells the standard error.

use rayon::prelude::*;

use super::shadow::{self, Footprint, Link, Sources};
use crate::{
    Progress, Result,
    patch::Patches,
    scene::Scene,
    trace::{
        Tracer,
        sampling::{around, mix, sobol_4d, square_to_cosine_hemisphere},
    },
};

/// Independent scrambles that the rays of each patch are divided into. The standard error then has 15 degrees of
/// freedom; with 4 replicates intervals of two standard errors held only 85 % of patches, with 16 about 94 %.
pub const REPLICATES: usize = 16;

/// The target of a ray that left the scene.
pub const ESCAPED: u32 = u32::MAX;

/// The target of a ray that connects a source with another patch: such rays are kept with their geometry.
pub const LINKED: u32 = u32::MAX - 1;

/// While casting: the ray met the back of this front patch, which was no unknown yet.
const BACK: u32 = 1 << 31;

/// How many rays leave a patch in each replicate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Share {
    pub(super) hemisphere: u32,
    pub(super) shadow: u32,
}

/// What every ray met. Kept ray by ray: at 4 bytes a ray that is no more than counts would take, and it holds the
/// replicates apart.
#[derive(Debug, Clone)]
pub struct Hits {
    pub(super) shares: Vec<Share>,
    /// Where the hemisphere rays of patch `i` begin in `targets`.
    offsets: Vec<usize>,
    targets: Vec<u32>,
    pub(super) links: Vec<Link>,
    pub(super) sources: Sources,
    back_hits: u64,
}

impl Hits {
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
        let shadow: u64 = self.shares.iter().map(|s| u64::from(s.shadow)).sum();
        self.targets.len() as u64 + shadow * REPLICATES as u64
    }

    /// Hemisphere rays that met the back of a surface.
    pub fn back_hits(&self) -> u64 {
        self.back_hits
    }

    /// Hemisphere rays that left patch `i`.
    pub fn rays_of(&self, i: usize) -> u32 {
        self.shares[i].hemisphere * REPLICATES as u32
    }

    /// Shadow rays that left patch `i`.
    pub fn shadow_rays_of(&self, i: usize) -> u32 {
        self.shares[i].shadow * REPLICATES as u32
    }

    /// The links found from patch `i`. Patches are cast in order, so that links are sorted by where they come from.
    pub(super) fn links_of(&self, i: usize) -> &[Link] {
        let first = self.links.partition_point(|l| (l.from as usize) < i);
        let length = self.links[first..].partition_point(|l| l.from as usize == i);
        &self.links[first..first + length]
    }

    /// What the hemisphere rays of patch `i` met: patches, [`ESCAPED`] or [`LINKED`].
    pub fn of(&self, i: usize) -> &[u32] {
        &self.targets[self.offsets[i]..self.offsets[i + 1]]
    }

    /// The same of one replicate.
    pub fn of_replicate(&self, i: usize, replicate: usize) -> &[u32] {
        let n = self.shares[i].hemisphere as usize;
        &self.of(i)[replicate * n..(replicate + 1) * n]
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        4 * self.targets.len() + size_of::<Link>() * self.links.len() + 16 * self.shares.len()
    }
}

/// Casts rays from every patch, as many as `share` says. Backs that are hit become patches and cast rays too,
/// until no new ones are found. The result depends on the seed alone, not on the number of threads.
///
/// # Errors
/// [`Error::Stopped`](crate::Error::Stopped) when `progress` says so.
pub(super) fn cast(
    scene: &Scene,
    tracer: &Tracer,
    patches: &mut Patches,
    sources: Sources,
    share: impl Fn(usize) -> Share,
    seed: u64,
    progress: &Progress,
) -> Result<Hits> {
    let mut hits = Hits {
        shares: Vec::new(),
        offsets: vec![0],
        targets: Vec::new(),
        links: Vec::new(),
        sources,
        back_hits: 0,
    };
    let mut first = 0;
    while first < patches.len() {
        let last = patches.len();
        let done = hits.rays();
        for i in first..last {
            hits.shares.push(share(i));
            hits.offsets.push(hits.offsets[i] + hits.rays_of(i) as usize);
        }
        hits.targets.resize(hits.offsets[last], 0);
        progress.begin(hits.rays());
        progress.advance(done);
        cast_from(tracer, patches, first, &mut hits, seed, progress)?;
        let seen = backs_seen(patches, &hits);
        patches.add_backs(scene, &seen);
        first = last;
    }
    name_backs(patches, &mut hits);
    Ok(hits)
}

/// Casts the rays of the patches from `first` on.
fn cast_from(
    tracer: &Tracer,
    patches: &Patches,
    first: usize,
    hits: &mut Hits,
    seed: u64,
    progress: &Progress,
) -> Result<()> {
    const BLOCK: usize = 32;
    let Hits { shares, offsets, targets, links, sources, .. } = hits;
    let mut rest = &mut targets[offsets[first]..];
    let mut blocks = Vec::new();
    for start in (first..patches.len()).step_by(BLOCK) {
        let end = (start + BLOCK).min(patches.len());
        let (block, tail) = rest.split_at_mut(offsets[end] - offsets[start]);
        blocks.push((start..end, block));
        rest = tail;
    }
    let found: Vec<Vec<Link>> = blocks
        .into_par_iter()
        .map(|(range, block)| {
            progress.check()?;
            let mut links = Vec::new();
            let mut rest = block;
            for i in range {
                let share = shares[i];
                let from = Footprint::new(tracer, patches, i);
                for replicate in 0..REPLICATES as u32 {
                    let seed = mix(&[seed, i as u64, u64::from(replicate)]);
                    let (own, tail) = rest.split_at_mut(share.hemisphere as usize);
                    cast_patch(tracer, patches, sources, &from, (i, replicate), seed, own, &mut links);
                    rest = tail;
                    let task = (i, replicate, share.shadow);
                    shadow::cast_patch(tracer, patches, sources, &from, task, mix(&[seed, 1]), &mut links);
                }
                progress.advance(u64::from(share.hemisphere + share.shadow) * REPLICATES as u64);
            }
            Ok(links)
        })
        .collect::<Result<_>>()?;
    links.reserve_exact(found.iter().map(Vec::len).sum());
    links.extend(found.into_iter().flatten());
    Ok(())
}

/// Casts one replicate of the hemisphere rays of patch `i`.
#[expect(clippy::too_many_arguments, reason = "the inner loop of the program, called once")]
fn cast_patch(
    tracer: &Tracer,
    patches: &Patches,
    sources: &Sources,
    from: &Footprint,
    (i, replicate): (usize, u32),
    seed: u64,
    targets: &mut [u32],
    links: &mut Vec<Link>,
) {
    for (index, target) in targets.iter_mut().enumerate() {
        let [x, y, u, v] = sobol_4d(index as u32, seed);
        let lifted = square_to_cosine_hemisphere(u, v);
        let direction = around(from.normal, lifted);
        let Some(hit) = tracer.closest(Tracer::leave(from.point(x, y), from.normal), direction) else {
            *target = ESCAPED;
            continue;
        };
        *target = patches.at(hit.triangle, hit.barycentric, hit.front).unwrap_or_else(|| {
            BACK | patches.at(hit.triangle, hit.barycentric, true).expect("fronts are patches")
        });
        let j = (*target & !BACK) as usize;
        if sources.concern(i, if *target & BACK == 0 { j } else { usize::MAX }) {
            let cos = tracer.triangles()[hit.triangle as usize].normal.dot(direction).abs();
            let kernel = lifted.z * cos / (std::f32::consts::PI * hit.t * hit.t);
            links.push(Link { from: i as u32, to: *target, kernel, replicate, shadow: false });
            *target = LINKED;
        }
    }
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
