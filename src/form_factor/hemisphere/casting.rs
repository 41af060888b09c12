//! Rays on their way: who still has to cast some, what they meet, and which backs become patches for that.

use std::{ops::Range, time::Instant};

use rayon::prelude::*;

use super::{
    super::{
        checkpoint::{Known, Record},
        shadow::{self, Footprint, Found, Link, Sources},
    },
    BACK, ESCAPED, Hits, LINKED, Share,
};
use crate::{
    Progress, Result,
    patch::Patches,
    scene::Scene,
    trace::{Tracer, sampling::mix},
};

impl Hits {
    /// Casts rays until every patch has as many as `wanted(i, mean kernel)` says; those cast already are kept. Backs that
    /// are hit become patches and cast rays too, until no new ones are found. The result depends on the seed alone, not
    /// on the number of threads.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped) when `progress` says so.
    pub(in super::super) fn extend(
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
            progress.begin("casting rays", self.rays() - before);
            self.cast(tracer, patches, first, &old, seed, progress)?;
            let seen = backs_seen(patches, self);
            patches.add_backs(scene, &seen);
            first = last;
        }
        name_backs(patches, self);
        self.seconds += start.elapsed().as_secs_f64();
        Ok(())
    }

    /// Makes room for the rays that patches want, and returns how many each had.
    fn make_room(&mut self, range: Range<usize>, wanted: impl Fn(usize, f64) -> Share) -> Vec<Share> {
        let mut old = self.shares.clone();
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
        let Hits { shares, offsets, targets, sources, checkpoint, mean_kernels, .. } = self;
        let (old_links, link_offsets, lamps) = (&self.links, &self.link_offsets, sources.lamps());
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
                    if share.shadow > 0 && sources.are_lamps() && !sources.contains(i) {
                        let before = link_offsets.get(i..i + 2).map_or(&[][..], |l| &old_links[l[0]..l[1]]);
                        let kernels = &mean_kernels[i * lamps..][..lamps];
                        shadow::probe(tracer, sources, &from, kernels, mix(&[seed, 2]), before, &mut links);
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
                let old = &old[old_offsets[first + k]..old_offsets[first + k + 1]];
                self.links.extend(old.iter().filter(|link| link.probe().is_none()));
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
    (indices, seed): (Range<u32>, u64),
    targets: &mut [u32],
    links: &mut Vec<Link>,
) {
    let known = links.len();
    let rays = from.hemisphere_rays(indices, seed).map(|ray| (ray, ray.origin, ray.direction));
    tracer.closest_each(rays, |ray, hit| {
        let target = &mut targets[ray.index as usize];
        let Some(hit) = hit else {
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
                let cos = tracer.triangles()[hit.triangle as usize].normal.dot(ray.direction).abs();
                let kernel = ray.cosine * cos / (std::f32::consts::PI * hit.t * hit.t);
                let (index, found) = (ray.index, Found::Hemisphere);
                links.push(Link { to: *target, kernel, index, found });
            }
            *target = LINKED;
        }
    });
    // In the order of the sequence, not that in which rays end: sums over links go by it.
    links[known..].sort_unstable_by_key(|link| link.index);
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
