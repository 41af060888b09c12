//! Hemisphere rays start from points spread over a patch, in cosine-distributed directions (Malley's method). The share
//! of rays that land on patch j estimates the form factor F_ij.
//!
//! Two dimensions of an Owen-scrambled Sobol sequence choose the point, two the direction. Rays from the centroid alone
//! would not converge to the form factor of the patch, and independent random rays need about ten times as many. Each
//! patch has one sequence, which additional rays continue. It is divided into [`REPLICATES`] consecutive parts of equal
//! size, whose spread estimates the standard error.

pub(crate) mod allocation;
pub(crate) mod casting;
pub(crate) mod checkpoint;
pub(crate) mod footprint;
pub(crate) mod lists;
pub(crate) mod regions;
pub(crate) mod siblings;
pub(crate) mod stratification;
pub(crate) mod targets;

use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use rayon::prelude::*;

use crate::{Ranks, patch::Patches, trace::Tracer};
use checkpoint::Section;
use footprint::is_hidden;
use lists::Lists;
use targets::BACK;

pub use checkpoint::{Checkpoint, Part};
pub use targets::ESCAPED;

/// Number of replicates: equal parts of the rays of each patch. With 16 the standard error has 15 degrees of freedom,
/// and intervals of two standard errors contain the true value for about 94 % of patches. With 4 parts they did so for
/// 85 %.
pub const REPLICATES: usize = 16;

/// A patch that no ray of another patch hits counts as hidden if at least this many hits are expected. This happens by
/// chance to one patch in 10⁹.
const HIDDEN: f64 = 20.0;

/// Targets of all hemisphere rays. Storing each ray takes 4 bytes, no more than counts of hits would, and keeps the
/// replicates apart.
#[derive(Debug, Clone)]
pub struct RaySet {
    targets: Lists<u32>,
    back_hits: u64,
    seconds: f64,
    /// Patches from which all light is withdrawn, in order.
    withdrawn: Vec<usize>,
    /// Rays are read from here if it has them, and are added to it when cast.
    pub(crate) checkpoint: Option<Section>,
    /// The processes that share out the casting.
    pub(crate) ranks: Ranks,
}

impl RaySet {
    /// No rays yet.
    pub(crate) fn none() -> RaySet {
        RaySet {
            targets: Lists::default(),
            back_hits: 0,
            seconds: 0.0,
            withdrawn: Vec::new(),
            checkpoint: None,
            ranks: Ranks::alone(),
        }
    }

    /// Whether rays of other parts are missing.
    pub(crate) fn is_lacking(&self) -> bool {
        self.checkpoint.as_ref().is_some_and(Section::is_lacking)
    }

    /// The first or second half of every patch's rays; `None` if some patch has only one ray.
    pub(crate) fn half(&self, half: usize) -> Option<RaySet> {
        let targets = self.targets.half(half)?;
        Some(RaySet { targets, withdrawn: self.withdrawn.clone(), ..RaySet::none() })
    }

    /// Number of patches.
    pub fn len(&self) -> usize {
        self.targets.len()
    }

    /// Whether there is no patch.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of rays of all patches.
    pub fn rays(&self) -> u64 {
        self.targets.all.len() as u64
    }

    /// Number of rays that hit the back of a surface.
    pub fn back_hits(&self) -> u64 {
        self.back_hits
    }

    /// Time spent casting rays, in seconds.
    pub fn seconds(&self) -> f64 {
        self.seconds
    }

    /// Number of rays that left patch `i`.
    pub fn rays_of(&self, i: usize) -> u32 {
        self.targets.count(i)
    }

    /// Targets of the rays of patch `i`: patches, or [`ESCAPED`].
    pub fn of(&self, i: usize) -> &[u32] {
        self.targets.of(i)
    }

    /// Targets of the rays of one replicate of patch `i`.
    pub fn of_replicate(&self, i: usize, replicate: usize) -> &[u32] {
        &self.of(i)[part(self.rays_of(i), replicate)]
    }

    /// The share of each patch's rays that leave the scene.
    pub(crate) fn escaped(&self) -> Vec<f64> {
        let share = |i: usize| {
            let escaped = self.of(i).iter().filter(|&&j| j == ESCAPED).count();
            escaped as f64 / f64::from(self.rays_of(i))
        };
        (0..self.len()).into_par_iter().with_min_len(128).map(share).collect()
    }

    /// Whether all light was withdrawn from patch `i`.
    pub(crate) fn is_withdrawn(&self, i: usize) -> bool {
        self.withdrawn.binary_search(&i).is_ok()
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.targets.bytes()
    }

    /// Withdraws all light from patches that no other patch sees. No ray hits such a patch, although another face lies
    /// at the same place, or although its own rays hit patches that should have hit it [many times](HIDDEN).
    /// Reciprocity would have to send these patches light that cannot reach them. Patches that are `kept` stay, and
    /// those known to be `hidden` are always withdrawn. Returns the withdrawn patches.
    pub(crate) fn withdraw_hidden(
        &mut self,
        areas: &[f64],
        tracer: &Tracer,
        patches: &Patches,
        (kept, hidden): (impl Fn(usize) -> bool + Sync, impl Fn(usize) -> bool + Sync),
    ) -> &[usize] {
        let density = |i: usize| f64::from(self.rays_of(i)) / areas[i];
        let met: Vec<AtomicBool> = (0..self.len()).map(|_| AtomicBool::new(false)).collect();
        let meets = |j: u32| {
            // Most are marked already, and reading is cheaper than writing.
            if !met[j as usize].load(Relaxed) {
                met[j as usize].store(true, Relaxed);
            }
        };
        let met_by = |i: usize| {
            let targets = self.of(i).iter().filter(|&&j| j != ESCAPED);
            targets.inspect(|&&j| meets(j)).map(|&j| density(j as usize) / density(i)).sum::<f64>()
        };
        let expected: Vec<f64> = (0..self.len()).into_par_iter().with_min_len(128).map(met_by).collect();
        let is_hidden = |i: usize| {
            let unmet = !met[i].load(Relaxed) && !kept(i);
            unmet && (expected[i] >= HIDDEN || is_hidden(tracer, patches, i))
        };
        self.withdrawn = (0..self.len()).into_par_iter().filter(|&i| hidden(i) || is_hidden(i)).collect();
        for &i in &self.withdrawn {
            self.targets.fill(i, ESCAPED);
        }
        &self.withdrawn
    }
}

/// The rays of a replicate. Their numbers differ by at most one.
pub(crate) fn part(rays: u32, replicate: usize) -> std::ops::Range<usize> {
    let start = |k: usize| k * rays as usize / REPLICATES;
    start(replicate)..start(replicate + 1)
}
