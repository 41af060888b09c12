//! One bounce of light without a matrix: rays are cast, bring the radiosity of what they meet, and are forgotten.
//!
//! Where lamps are few shadow rays bring their light, a ratio estimate as in `shadow`, and hemisphere rays
//! what the patches reflect; else hemisphere rays bring all. Memory is in proportion to the patches, not to the rays.

use std::{
    ops::Range,
    sync::atomic::{AtomicU64, Ordering},
};

use rayon::prelude::*;

use super::{
    hemisphere::{ESCAPED, REPLICATES},
    shadow::{self, Footprint, Found, Sources},
    siblings::siblings,
};
use crate::{
    Progress, Result,
    patch::Patches,
    scene::Scene,
    trace::{Hit, Tracer, sampling::mix},
};

/// Rays of each patch that look for backs which are no unknowns yet.
const LOOKING: u32 = 2 * REPLICATES as u32;

/// What the rays of a sweep brought to a patch; what several did is their sum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Arrived<const C: usize> {
    /// Σ of the radiosity that hemisphere rays met.
    pub(crate) met: [f64; C],
    /// Hemisphere rays that left the scene, or met the back of what is no unknown.
    pub(crate) escaped: f64,
    /// Σ over the shadow rays that arrived of their kernels times the lamp's radiosity over its density.
    pub(crate) lit: [f64; C],
    /// Σ of the kernels of all shadow rays.
    pub(crate) kernel: f64,
}

impl<const C: usize> Arrived<C> {
    pub(crate) const NOTHING: Self = Arrived { met: [0.0; C], escaped: 0.0, lit: [0.0; C], kernel: 0.0 };

    pub(crate) fn add(&mut self, other: &Self) {
        for c in 0..C {
            self.met[c] += other.met[c];
            self.lit[c] += other.lit[c];
        }
        self.escaped += other.escaped;
        self.kernel += other.kernel;
    }
}

/// How many rays were cast, and what became of them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Tally {
    /// Hemisphere rays.
    pub hemisphere: u64,
    /// Of them those that left the scene, or met the back of what is no unknown,
    pub escaped: u64,
    /// and those that met a back.
    pub backs: u64,
    /// Shadow rays.
    pub shadow: u64,
}

impl Tally {
    pub(crate) fn add(&mut self, other: Tally) {
        self.hemisphere += other.hemisphere;
        self.escaped += other.escaped;
        self.backs += other.backs;
        self.shadow += other.shadow;
    }
}

/// Casts sweeps of rays.
#[derive(Debug)]
pub struct Sweeper<'a> {
    tracer: &'a Tracer,
    patches: &'a Patches,
    sources: Sources,
    /// Of each patch; all zero where no shadow rays are cast.
    mean_kernels: Vec<f64>,
    areas: Vec<f64>,
    seed: u64,
}

impl<'a> Sweeper<'a> {
    /// Adds the backs that rays see to `patches`, and learns what lamps would send if nothing stood between.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped) when `progress` says so.
    pub fn new(
        scene: &Scene,
        tracer: &'a Tracer,
        patches: &'a mut Patches,
        seed: u64,
        progress: &Progress,
    ) -> Result<Sweeper<'a>> {
        let mut first = 0;
        while first < patches.len() {
            let (known, last) = (&*patches, patches.len());
            let seen = (first..last).into_par_iter().with_min_len(32).map(|i| {
                progress.check()?;
                let (from, seed) = (Footprint::new(tracer, known, i), mix(&[seed, i as u64]));
                let mut unknown = Vec::new();
                let rays = from.hemisphere_rays(0..LOOKING, seed);
                tracer.closest_each(rays.map(|ray| ((), ray.origin, ray.direction)), |(), hit| {
                    let is_unknown = |hit: &Hit| known.at(hit.triangle, hit.barycentric, hit.front).is_none();
                    unknown.extend(hit.filter(is_unknown).map(|hit| hit.triangle));
                });
                Ok(unknown)
            });
            let seen: Vec<Vec<u32>> = seen.collect::<Result<_>>()?;
            let mut seen: Vec<u32> = seen.into_iter().flatten().collect();
            seen.sort_unstable();
            seen.dedup();
            patches.add_backs(scene, &seen);
            first = last;
        }
        let patches = &*patches;
        let sources = Sources::emitters(tracer, patches);
        let mean_kernel = |i: usize| {
            let of_lamps = || sources.mean_kernels(&Footprint::new(tracer, patches, i)).iter().sum();
            if sources.are_lamps() { of_lamps() } else { 0.0 }
        };
        let mean_kernels = (0..patches.len()).into_par_iter().with_min_len(32).map(mean_kernel).collect();
        let areas = (0..patches.len()).map(|i| patches.area(i)).collect();
        Ok(Sweeper { tracer, patches, sources, mean_kernels, areas, seed })
    }

    /// The patches, with those backs that were seen.
    pub fn patches(&self) -> &Patches {
        self.patches
    }

    /// Neighbours in the plane: runs of up to 16 patches of one triangle's side, in the order of the patches.
    pub(crate) fn siblings(&self) -> Vec<Range<usize>> {
        siblings(self.tracer, self.patches)
    }

    /// Area of each patch.
    pub(crate) fn areas(&self) -> &[f64] {
        &self.areas
    }

    /// Whether shadow rays bring the light of lamps.
    pub(crate) fn has_lamps(&self) -> bool {
        self.sources.are_lamps() && !self.sources.is_empty()
    }

    /// The irradiance from what came to patch `i` by so many hemisphere rays: of lamps, and of all else.
    pub(crate) fn irradiance<const C: usize>(
        &self,
        i: usize,
        came: &Arrived<C>,
        hemisphere: f64,
    ) -> [[f64; C]; 2] {
        let ratio = if came.kernel > 0.0 { self.mean_kernels[i] / came.kernel } else { 0.0 };
        [came.lit.map(|lit| ratio * lit), came.met.map(|met| met / hemisphere)]
    }

    /// Casts hemisphere rays from patch `i` and calls `met` with the patch that each meets. Counts those that met a back.
    fn cast(
        &self,
        (i, from): (usize, &Footprint),
        rays: Range<u32>,
        backs: &AtomicU64,
        mut met: impl FnMut(Option<usize>),
    ) {
        let mut behind = 0;
        let rays = from.hemisphere_rays(rays, self.seed_of(i));
        self.tracer.closest_each(rays.map(|ray| ((), ray.origin, ray.direction)), |(), hit| {
            behind += u64::from(hit.is_some_and(|hit| !hit.front));
            let patch = hit.and_then(|hit| self.patches.at(hit.triangle, hit.barycentric, hit.front));
            met(patch.map(|j| j as usize));
        });
        if behind > 0 {
            backs.fetch_add(behind, Ordering::Relaxed);
        }
    }

    fn seed_of(&self, i: usize) -> u64 {
        mix(&[self.seed, i as u64])
    }

    /// What the `N` hemisphere rays that begin with the index `first` meet from every patch: patches, or [`ESCAPED`].
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped) when `progress` says so.
    pub(crate) fn met<const N: usize>(
        &self,
        first: u32,
        progress: &Progress,
    ) -> Result<(Vec<[u32; N]>, Tally)> {
        let backs = AtomicU64::new(0);
        let cast = |i: usize| {
            progress.check()?;
            let (mut met, mut ray) = ([ESCAPED; N], 0);
            let from = Footprint::new(self.tracer, self.patches, i);
            self.cast((i, &from), first..first + N as u32, &backs, |patch| {
                met[ray] = patch.map_or(ESCAPED, |j| j as u32);
                ray += 1;
            });
            progress.advance(N as u64);
            Ok(met)
        };
        let met: Vec<[u32; N]> =
            (0..self.patches.len()).into_par_iter().with_min_len(64).map(cast).collect::<Result<_>>()?;
        let all = met.as_flattened();
        let escaped = all.par_iter().filter(|&&j| j == ESCAPED).count() as u64;
        let tally = Tally { hemisphere: all.len() as u64, escaped, backs: backs.into_inner(), shadow: 0 };
        Ok((met, tally))
    }

    /// Casts the rays with these indices from every patch, hemisphere and shadow rays, through patches of this radiosity.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped) when `progress` says so.
    pub(crate) fn sweep<const C: usize>(
        &self,
        radiosity: &[[f64; C]],
        hemisphere: Range<u32>,
        shadow: Range<u32>,
        progress: &Progress,
    ) -> Result<(Vec<Arrived<C>>, Tally)> {
        let emission = self.patches.emission().as_chunks::<C>().0;
        let (lamps, scale) = (self.has_lamps(), self.tracer.scale());
        let backs = AtomicU64::new(0);
        let cast = |i: usize| {
            if i.is_multiple_of(1024) {
                progress.check()?;
            }
            let from = Footprint::new(self.tracer, self.patches, i);
            let mut came = Arrived::NOTHING;
            self.cast((i, &from), hemisphere.clone(), &backs, |patch| match patch {
                None => came.escaped += 1.0,
                Some(j) => {
                    for c in 0..C {
                        came.met[c] += radiosity[j][c] - if lamps { emission[j][c] } else { 0.0 };
                    }
                }
            });
            if lamps && self.mean_kernels[i] > 0.0 {
                let mut links = Vec::new();
                let seed = mix(&[self.seed_of(i), 1]);
                shadow::cast_patch(self.tracer, &self.sources, &from, shadow.clone(), seed, &mut links);
                for link in links {
                    let (l, kernel) = (link.to as usize, f64::from(link.kernel));
                    came.kernel += kernel * self.sources.weight(l);
                    if link.found == Found::Shadow {
                        // The mean kernel is in proportion to the density p / A of samples on lamps, but for weights.
                        let density = self.sources.probability(l) / (self.areas[l] / (scale * scale));
                        for c in 0..C {
                            came.lit[c] += kernel * emission[l][c] / density;
                        }
                    }
                }
            }
            Ok(came)
        };
        let n = self.patches.len();
        let arrived: Vec<Arrived<C>> =
            (0..n).into_par_iter().with_min_len(64).map(cast).collect::<Result<_>>()?;
        let lit = |kernel: &&f64| lamps && **kernel > 0.0;
        let tally = Tally {
            hemisphere: n as u64 * u64::from(hemisphere.end - hemisphere.start),
            // Whole numbers: exact in any order.
            escaped: arrived.par_iter().map(|came| came.escaped as u64).sum(),
            backs: backs.into_inner(),
            shadow: self.mean_kernels.iter().filter(lit).count() as u64
                * u64::from(shadow.end - shadow.start),
        };
        Ok((arrived, tally))
    }
}
