//! How many patches a wanted error needs, and where.
//!
//! A coarse subdivision is solved with few rays, its discretisation error is estimated, and the patches over which light varies
//! most are cut ([`adaptive`]), until that error is small enough beside the wanted one.

use std::sync::Arc;

use crate::{
    Progress, Result,
    accuracy::{
        adaptive,
        discretisation::Discretisation,
        refinement::{FIRST_RAYS, Round, begin},
        solved::Solved,
    },
    form_factor::{CastOptions, Checkpoint},
    patch::{Patches, Subdivision},
    scene::Scene,
    solve::SolveOptions,
    trace::Tracer,
};

/// Number of patches to start with.
const FIRST_PATCHES: usize = 500;
/// Number of patches that is enough where no error is wanted. Beyond it, more rays gain more. It is half the number of the
/// preset, because patches are small where light varies.
const ENOUGH_PATCHES: usize = 4000;
/// Share of the wanted error for the discretisation error. The squares of errors add up, so the sampling error may be 0.87
/// of the wanted one.
const OF_PATCHES: f64 = 0.5;
/// Largest number of solutions.
const MOST_ROUNDS: usize = 16;
/// Factor for the rays per patch where the estimate of the discretisation error is noise. On the Cornell box with 8,000 patches the
/// estimate is 0.85, 0.16 and 0.10 % with 64, 256 and 1,024 rays.
const MORE_RAYS: f64 = 4.0;
/// The discretisation error falls approximately with this power of the number of patches, if they are small where light
/// varies.
const RATE: f64 = 0.75;
/// Least factor by which the number of patches grows in a refinement.
const LEAST_GROWTH: f64 = 1.2;

/// A search for patches that are small enough.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct PatchSearch<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Its ray tracer.
    pub tracer: &'a Tracer,
    /// The wanted RMS error of irradiance relative to its mean, patches and sampling together. Without one, the search ends at
    /// some thousand patches.
    pub error: Option<f64>,
    /// Seed of the rays.
    pub seed: u64,
    /// How to solve.
    pub solve: SolveOptions,
    /// A store of rays.
    pub checkpoint: Option<Arc<Checkpoint>>,
}

setters!(PatchSearch<'a> {
    with_error(error: Option<f64>),
    with_solve(solve: SolveOptions),
    with_checkpoint(checkpoint: Option<Arc<Checkpoint>>),
});

/// Patches that were refined where light varies.
#[derive(Debug)]
#[non_exhaustive]
pub struct SmallPatches {
    /// The patches, without backs.
    pub patches: Patches,
    /// Their discretisation error relative to the mean irradiance, if it is known.
    pub floor: Option<f64>,
    /// A first round of sampling with them, if there was one.
    pub first: Option<(Solved, Round)>,
}

impl SmallPatches {
    /// The share of the wanted error that is left for sampling. The whole of it where the discretisation error is unknown, or
    /// exceeds the wanted error by itself.
    pub fn sampling_error(&self, wanted: f64) -> f64 {
        left_for_sampling(wanted, self.floor)
    }
}

/// The share of the wanted error that is left for sampling. The squares of errors add up. The whole of it where the
/// discretisation error is unknown, or exceeds the wanted error by itself.
pub fn left_for_sampling(wanted: f64, of_patches: Option<f64>) -> f64 {
    let left = of_patches.filter(|&f| f < wanted).map(|f| (wanted * wanted - f * f).sqrt());
    left.unwrap_or(wanted)
}

impl<'a> PatchSearch<'a> {
    /// A search without a wanted error.
    pub fn new(scene: &'a Scene, tracer: &'a Tracer, seed: u64) -> Self {
        PatchSearch { scene, tracer, error: None, seed, solve: SolveOptions::default(), checkpoint: None }
    }

    /// Searches until the patches are small enough, until `allows` says of a number of front patches that they are too many, or
    /// until `late` says that there is no more time.
    ///
    /// # Errors
    /// As [`begin`].
    pub fn run(
        &self,
        allows: impl Fn(f64) -> bool,
        late: impl Fn() -> bool,
        progress: &Progress,
    ) -> Result<SmallPatches> {
        let mut rays = FIRST_RAYS;
        // The number of patches before they were cut, and their discretisation error.
        let mut before: Option<(usize, f64)> = None;
        let mut patches = Patches::subdivide(self.scene, &Subdivision::Count(FIRST_PATCHES));
        let (mut floor, mut first) = (None, None);
        if !allows(patches.fronts() as f64) {
            // Memory is too small even for the first solution, which would show where light varies.
            return Ok(SmallPatches { patches, floor, first });
        }
        for _ in 0..MOST_ROUNDS {
            let cast = CastOptions::default().with_rays(rays).with_seed(self.seed);
            let round = begin(
                self.scene,
                self.tracer,
                patches.clone(),
                &cast,
                &self.solve,
                self.checkpoint.clone(),
                progress,
            )?;
            let (solved, _) = first.insert(round);
            let Solved { patches: solved, form_factors, solution, .. } = &*solved;
            floor = Discretisation::of((self.scene, self.tracer), form_factors, solved, solution, progress)?
                .map(|d| d.relative);
            let growth = match (self.error, floor) {
                (Some(wanted), Some(floor)) => (floor / (OF_PATCHES * wanted)).powf(1.0 / RATE),
                (None, _) => ENOUGH_PATCHES as f64 / patches.fronts() as f64,
                (Some(_), None) => f64::INFINITY,
            };
            if late() || growth <= 1.0 {
                break;
            }
            if let (Some(last), Some(floor)) = (before, floor)
                && !falls(last, (patches.fronts(), floor))
            {
                // Smaller patches would not help: the estimate is noise of too few rays.
                before = None;
                if !allows(patches.fronts() as f64 * MORE_RAYS * rays / FIRST_RAYS) {
                    break;
                }
                rays *= MORE_RAYS;
                first = None;
                continue;
            }
            let finer = match floor {
                Some(_) => adaptive::finer(self.scene, solved, solution, growth.max(LEAST_GROWTH)),
                // One patch per triangle does not show where light varies.
                None => Patches::subdivide(self.scene, &Subdivision::Count(4 * patches.fronts())),
            };
            if finer.fronts() <= patches.fronts() || !allows(finer.fronts() as f64 * rays / FIRST_RAYS) {
                break;
            }
            before = floor.map(|floor| (patches.fronts(), floor));
            patches = finer;
            first = None;
        }
        Ok(SmallPatches { patches, floor, first })
    }
}

/// Whether the discretisation error fell, from one number of patches to the next, by at least half of [`RATE`].
fn falls((patches, error): (usize, f64), (more, less): (usize, f64)) -> bool {
    less <= error * (patches as f64 / more as f64).powf(0.5 * RATE)
}
