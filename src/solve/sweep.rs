//! One bounce of light without a matrix: rays are cast, bring the radiosity of the patches they hit, and are forgotten.
//!
//! Shadow rays bring the light of lamps, sun and points, as everywhere (`direct`). Hemisphere rays bring the reflected
//! light, and the light of the sky if they leave the scene. Memory is proportional to the number of patches, not of rays.

use std::{
    f64::consts::PI,
    ops::Range,
    sync::atomic::{AtomicU64, Ordering},
};

use glam::Vec3A;
use rayon::prelude::*;

use crate::{
    Progress, Result,
    direct::{ShadowRays, brightness},
    patch::Patches,
    rays::{ESCAPED, REPLICATES, RaySet, footprint::Footprint, siblings::siblings},
    scene::Scene,
    trace::{Tracer, sampling::mix},
};

/// Rays of each patch that search for backs that are not yet unknowns.
const LOOKING: u32 = 2 * REPLICATES as u32;

/// The light that the rays of a sweep bring to a patch. Sweeps add up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Arrived<const C: usize> {
    /// Sum of the radiosity that hemisphere rays met.
    pub(crate) met: [f64; C],
    /// Hemisphere rays that left the scene, or met a back that is not an unknown.
    pub(crate) escaped: f64,
    /// Sum of the light of unblocked shadow rays.
    pub(crate) lit: [f64; C],
    /// One entry for each sequence of shadow rays.
    pub(crate) shadow: [Shadow; 2],
}

/// The light from outside the patches that the rays of a sweep bring to a patch. Sweeps add up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Outside<const C: usize> {
    /// The part of [`Arrived::lit`] from lights that are not surfaces.
    pub(crate) lit: [f64; C],
    /// Sum of π times the radiance of the sky over the hemisphere rays that left the scene.
    pub(crate) sky: [f64; C],
}

impl<const C: usize> Outside<C> {
    pub(crate) const NOTHING: Self = Outside { lit: [0.0; C], sky: [0.0; C] };

    pub(crate) fn add(&mut self, other: &Self) {
        for c in 0..C {
            self.lit[c] += other.lit[c];
            self.sky[c] += other.sky[c];
        }
    }
}

/// The rays of one sweep.
pub(crate) struct Swept<const C: usize> {
    /// The light that they bring to each patch.
    pub(crate) arrived: Vec<Arrived<C>>,
    /// The light from outside the patches; empty if there are no such lights.
    pub(crate) outside: Vec<Outside<C>>,
    pub(crate) tally: Tally,
}

/// The targets of `N` hemisphere rays of every patch.
pub(crate) struct Targets<const N: usize, const C: usize> {
    /// The patch that each ray hits, or [`ESCAPED`].
    pub(crate) met: Vec<[u32; N]>,
    /// The irradiance from the sky by these rays; empty if no light enters from outside the patches.
    pub(crate) sky: Vec<[f64; C]>,
    pub(crate) tally: Tally,
}

/// The light of the shadow rays of one sequence to lamps whose unblocked light is known, summed over all channels.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Shadow {
    /// Number of all rays of the sequence.
    pub(crate) rays: f64,
    /// Sum of the light of the rays as if none were blocked.
    pub(crate) all: f64,
    /// Sum of the light of unblocked rays.
    pub(crate) free: f64,
}

impl<const C: usize> Arrived<C> {
    pub(crate) const NOTHING: Self = Arrived {
        met: [0.0; C],
        escaped: 0.0,
        lit: [0.0; C],
        shadow: [Shadow { rays: 0.0, all: 0.0, free: 0.0 }; 2],
    };

    pub(crate) fn add(&mut self, other: &Self) {
        for c in 0..C {
            self.met[c] += other.met[c];
            self.lit[c] += other.lit[c];
        }
        self.escaped += other.escaped;
        for (sum, other) in self.shadow.iter_mut().zip(&other.shadow) {
            sum.rays += other.rays;
            sum.all += other.all;
            sum.free += other.free;
        }
    }
}

/// Number of rays cast, by their results.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Tally {
    /// Number of hemisphere rays.
    pub hemisphere: u64,
    /// Hemisphere rays that left the scene, or met a back that is not an unknown.
    pub escaped: u64,
    /// Hemisphere rays that met a back.
    pub backs: u64,
    /// Number of shadow rays.
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

/// Casts sweeps of rays through a scene.
#[derive(Debug)]
pub struct Sweeper<'a> {
    tracer: &'a Tracer,
    patches: &'a Patches,
    shadow: ShadowRays,
    /// Whether light enters from outside the patches.
    has_outside: bool,
    areas: Vec<f64>,
    seed: u64,
}

impl<'a> Sweeper<'a> {
    /// Adds the backs that rays see to `patches`, and computes the unblocked light of lamps at every patch.
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
        let mut few = RaySet::none();
        few.extend(scene, tracer, patches, |_| LOOKING, mix(&[seed, LOOKING.into()]), progress)?;
        let patches = &*patches;
        let mut shadow = ShadowRays::none(brightness::lamps(&few, tracer, patches, &scene.lights));
        shadow.face(tracer, patches);
        let areas = (0..patches.len()).map(|i| patches.area(i)).collect();
        let has_outside = shadow.lamps.has_remote() || shadow.lamps.sky.is_some();
        Ok(Sweeper { tracer, patches, shadow, has_outside, areas, seed })
    }

    /// The patches, including the backs that rays saw.
    pub fn patches(&self) -> &Patches {
        self.patches
    }

    /// Coplanar neighbours: runs of up to 16 patches, in the order of the patches.
    pub(crate) fn siblings(&self) -> Vec<Range<usize>> {
        siblings(self.tracer, self.patches)
    }

    /// Area of each patch.
    pub(crate) fn areas(&self) -> &[f64] {
        &self.areas
    }

    /// Whether light enters from outside the patches.
    pub(crate) fn has_outside(&self) -> bool {
        self.has_outside
    }

    /// The [`magnitude`](crate::parallel::magnitude) of all light that is emitted or enters.
    pub(crate) fn magnitude(&self) -> f64 {
        self.shadow.lamps.magnitude(self.patches.emission())
    }

    /// Whether there are lamps, which need shadow rays.
    pub(crate) fn has_lamps(&self) -> bool {
        !self.shadow.lamps.is_empty()
    }

    /// Whether patch `i` is a part of a lamp.
    pub(crate) fn is_lamp(&self, i: usize) -> bool {
        self.shadow.lamps.contains(i)
    }

    /// The unblocked irradiance of patch `i` from the lamps for which it is known; `None` if there are too many lamps.
    pub(crate) fn unblocked<const C: usize>(&self, i: usize) -> Option<[f64; C]> {
        self.shadow.unblocked(i, self.patches.emission().as_chunks::<C>().0)
    }

    /// The direct irradiance of a patch from its shadow rays `came`. The unblocked irradiance is a control variate, if
    /// it is known. Its coefficient is the unblocked share of light in `whole`, which contains `came`: each sequence is
    /// corrected by the share of the other one (as in `direct`).
    pub(crate) fn direct<const C: usize>(
        &self,
        unblocked: &Option<[f64; C]>,
        came: &Arrived<C>,
        whole: &Arrived<C>,
    ) -> [f64; C] {
        let count: f64 = came.shadow.iter().map(|shadow| shadow.rays).sum();
        if count == 0.0 {
            return [0.0; C];
        }
        let lit = came.lit.map(|lit| lit / count);
        let Some(unblocked) = unblocked else { return lit };
        let all: f64 = unblocked.iter().sum();
        if all == 0.0 {
            return lit;
        }
        let mut more = 0.0;
        for turn in 0..2 {
            let other = &whole.shadow[1 - turn];
            let used = if other.all > 0.0 { other } else { &whole.shadow[turn] };
            let share = if used.all > 0.0 { used.free / used.all } else { 0.0 };
            more += share * (came.shadow[turn].rays * all - came.shadow[turn].all) / count;
        }
        std::array::from_fn(|c| (lit[c] + more * (unblocked[c] / all)).max(0.0))
    }

    /// π times the radiance that a ray of this direction sees of the sky.
    fn sky<const C: usize>(&self, direction: Vec3A) -> [f64; C] {
        let seen = self.shadow.lamps.sky.as_ref().map(|sky| sky.radiance(direction.as_dvec3().normalize()));
        std::array::from_fn(|c| seen.map_or(0.0, |radiance| PI * radiance[c]))
    }

    /// Casts hemisphere rays from patch `i` and calls `met` with the direction of each ray and its target: a patch, a
    /// back that is not an unknown, or the outside. Counts hits of backs.
    fn cast(
        &self,
        (i, from): (usize, &Footprint),
        rays: Range<u32>,
        backs: &AtomicU64,
        mut met: impl FnMut(Vec3A, Target),
    ) {
        let mut behind = 0;
        let rays = from.hemisphere_rays(rays, self.seed_of(i));
        self.tracer.closest_each(
            rays.map(|ray| (ray.direction, ray.origin, ray.direction)),
            |direction, hit| {
                behind += u64::from(hit.is_some_and(|hit| !hit.front));
                let target = hit.map_or(Target::Outside, |hit| {
                    let patch = self.patches.at(hit.triangle, hit.barycentric, hit.front);
                    patch.map_or(Target::Nothing, |j| Target::Patch(j as usize))
                });
                met(direction, target);
            },
        );
        if behind > 0 {
            backs.fetch_add(behind, Ordering::Relaxed);
        }
    }

    fn seed_of(&self, i: usize) -> u64 {
        mix(&[self.seed, i as u64])
    }

    /// Targets of `N` hemisphere rays of every patch, from index `first` on.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped) when `progress` says so.
    pub(crate) fn met<const N: usize, const C: usize>(
        &self,
        first: u32,
        progress: &Progress,
    ) -> Result<Targets<N, C>> {
        let backs = AtomicU64::new(0);
        let cast = |i: usize| {
            progress.check()?;
            let (mut met, mut sky, mut ray) = ([ESCAPED; N], [0.0; C], 0);
            let from = Footprint::new(self.tracer, self.patches, i);
            self.cast((i, &from), first..first + N as u32, &backs, |direction, target| {
                match target {
                    Target::Patch(j) => met[ray] = j as u32,
                    Target::Outside if self.has_outside => {
                        let seen = self.sky::<C>(direction);
                        (0..C).for_each(|c| sky[c] += seen[c] / N as f64);
                    }
                    Target::Outside | Target::Nothing => {}
                }
                ray += 1;
            });
            progress.advance(N as u64);
            Ok((met, sky))
        };
        let (met, sky) = self.of_patches(cast)?;
        let all = met.as_flattened();
        let escaped = all.par_iter().filter(|&&j| j == ESCAPED).count() as u64;
        let tally = Tally { hemisphere: all.len() as u64, escaped, backs: backs.into_inner(), shadow: 0 };
        Ok(Targets { met, sky, tally })
    }

    /// Casts the hemisphere and shadow rays with these indices from every patch, for patches with this radiosity.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped) when `progress` says so.
    pub(crate) fn sweep<const C: usize>(
        &self,
        radiosity: &[[f64; C]],
        hemisphere: Range<u32>,
        shadow: Range<u32>,
        progress: &Progress,
    ) -> Result<Swept<C>> {
        let emission = self.patches.emission().as_chunks::<C>().0;
        let backs = AtomicU64::new(0);
        let cast = |i: usize| {
            if i.is_multiple_of(1024) {
                progress.check()?;
            }
            let from = Footprint::new(self.tracer, self.patches, i);
            let (mut came, mut outside) = (Arrived::NOTHING, Outside::NOTHING);
            self.cast((i, &from), hemisphere.clone(), &backs, |direction, target| match target {
                Target::Patch(j) => {
                    let lamp = self.is_lamp(j);
                    for c in 0..C {
                        came.met[c] += radiosity[j][c] - if lamp { emission[j][c] } else { 0.0 };
                    }
                }
                Target::Nothing => came.escaped += 1.0,
                Target::Outside => {
                    came.escaped += 1.0;
                    if self.has_outside {
                        let seen = self.sky::<C>(direction);
                        (0..C).for_each(|c| outside.sky[c] += seen[c]);
                    }
                }
            });
            if self.has_lamps() && self.shadow.is_faced(i) {
                for (turn, sum) in came.shadow.iter_mut().enumerate() {
                    let number = |end: u32| (end + 1 - turn as u32) / 2;
                    sum.rays = f64::from(number(shadow.end) - number(shadow.start));
                }
                let (at, seed) = ((self.tracer, i, &from), mix(&[self.seed_of(i), 1]));
                self.shadow.each(at, emission, shadow.clone(), seed, |sample| {
                    came.shadow[sample.half].all += sample.known;
                    if sample.is_free {
                        came.shadow[sample.half].free += sample.known;
                        (0..C).for_each(|c| came.lit[c] += sample.light[c]);
                        if sample.is_remote {
                            (0..C).for_each(|c| outside.lit[c] += sample.light[c]);
                        }
                    }
                });
            }
            Ok((came, outside))
        };
        let n = self.patches.len();
        let (arrived, outside) = self.of_patches(cast)?;
        let faced = |i: &usize| self.has_lamps() && self.shadow.is_faced(*i);
        let tally = Tally {
            hemisphere: n as u64 * u64::from(hemisphere.end - hemisphere.start),
            // Whole numbers have exact sums in any order.
            escaped: arrived.par_iter().map(|came| came.escaped as u64).sum(),
            backs: backs.into_inner(),
            shadow: (0..n).filter(faced).count() as u64 * u64::from(shadow.end - shadow.start),
        };
        Ok(Swept { arrived, outside, tally })
    }

    /// Two results for each patch. The second list is empty if no light enters from outside the patches.
    fn of_patches<A: Send, B: Send>(
        &self,
        of_patch: impl Fn(usize) -> Result<(A, B)> + Send + Sync,
    ) -> Result<(Vec<A>, Vec<B>)> {
        let patches = (0..self.patches.len()).into_par_iter().with_min_len(64);
        if self.has_outside {
            let both: Vec<(A, B)> = patches.map(of_patch).collect::<Result<_>>()?;
            return Ok(both.into_iter().unzip());
        }
        let first = patches.map(|i| of_patch(i).map(|(first, _)| first)).collect::<Result<_>>()?;
        Ok((first, Vec::new()))
    }
}

/// The target of a hemisphere ray.
#[derive(Clone, Copy)]
enum Target {
    Patch(usize),
    /// A back that is not an unknown.
    Nothing,
    Outside,
}
