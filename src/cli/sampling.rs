//! How long `solve` samples, and on which patches.

use std::{sync::Arc, time::Instant};

use radiosity::{
    Result, Scene,
    accuracy::{
        discretisation::Discretisation,
        refinement::{FIRST_RAYS, Plan, Round, refine},
        solved::Solved,
    },
    form_factor::{CastOptions, Checkpoint, Estimator},
    output::report::Seconds,
    patch::{Patches, Subdivision},
    trace::Tracer,
};

use super::{
    forecast::{self, Work},
    pipeline::blame,
    solve::SolveArgs,
    watch::Watch,
};

/// Patches that a wanted error starts with.
const FIRST_PATCHES: usize = 1000;
/// Share of a wanted error that the patches' size may take; as errors add up by squares, the rays may take 0.87 of it.
const OF_PATCHES: f64 = 0.5;
/// Patches are made smaller so often at most, and no more at a time than this: the estimate is rough while they are large.
const MOST_CUTS: usize = 6;
const MOST_MORE: f64 = 16.0;

/// A scene about to be sampled.
pub struct Sampling<'a> {
    pub args: &'a SolveArgs,
    pub scene: &'a Scene,
    pub tracer: &'a Tracer,
    pub watch: &'a Watch,
    /// Where rays are kept.
    pub checkpoint: Option<Arc<Checkpoint>>,
}

/// What came of it.
pub struct Sampled {
    pub solved: Solved,
    pub rounds: Vec<Round>,
    /// Who chose the patches.
    pub chosen: String,
}

impl Sampling<'_> {
    /// Samples and solves as the arguments say.
    pub fn run(&self, start: Instant, times: &mut Seconds) -> Result<Sampled> {
        let args = self.args;
        let wanted = args.error.map(|percent| percent / 100.0);
        let in_rounds = wanted.is_some() || args.time.is_some();
        let rays = if in_rounds { FIRST_RAYS } else { f64::from(args.cast.rays()) };
        let (mut subdivision, mut chosen) = args.cast.subdivision();
        let (mut target, mut floor) = (wanted, None);
        if let (Some(wanted), None) = (wanted, args.cast.given_subdivision()) {
            (subdivision, floor) = self.small_enough(wanted, start)?;
            chosen = format!("for --error {}", 100.0 * wanted);
            let left = floor.filter(|&f| f < wanted).map(|f| (wanted * wanted - f * f).sqrt());
            target = Some(left.unwrap_or(wanted));
        }
        let count = Patches::forecast(self.scene, &subdivision);
        let bytes = forecast::bytes(self.scene, args.estimator());
        if let Some(warning) = args.common.limit().check(&self.work(count, rays, &bytes))? {
            self.watch.warn(&warning);
        }
        let (patches, subdivide) =
            self.watch.stage("patches", || Ok(Patches::subdivide(self.scene, &subdivision)))?;
        times.subdivide = subdivide;
        let before = start.elapsed().as_secs_f64();
        let plan = Plan {
            error: target,
            seconds: args.time.map(|seconds| seconds - before),
            most_rays: in_rounds.then(|| args.common.limit().most_rays(count, &bytes)),
        };
        let cast =
            CastOptions { rays, estimator: args.estimator(), seed: args.seed, ..CastOptions::default() };
        let tell = |solved: &Solved, rounds: &[Round]| {
            if !in_rounds {
                return Ok(());
            }
            if let (1, Some(wanted), None) = (rounds.len(), wanted, floor) {
                self.warn_of_patches(solved, wanted)?;
            }
            self.tell(&plan, rounds);
            Ok(())
        };
        let ((solved, rounds), _) = self.watch.stage("rays", || self.refine(patches, &cast, &plan, tell))?;
        times.form_factors = rounds.iter().map(|round| round.casting).sum();
        times.solve = rounds.last().map_or(0.0, |round| round.elapsed) - times.form_factors;
        Ok(Sampled { solved, rounds, chosen })
    }

    fn work<'a>(&'a self, patches: f64, rays: f64, bytes: &'a dyn Fn(f64, f64) -> f64) -> Work<'a> {
        Work { scene: self.scene, patches, rays, bytes, options: forecast::USUAL }
    }

    fn refine(
        &self,
        patches: Patches,
        cast: &CastOptions,
        plan: &Plan,
        tell: impl FnMut(&Solved, &[Round]) -> Result<()>,
    ) -> Result<(Solved, Vec<Round>)> {
        let (options, progress) = (self.args.solve_options(), self.watch.progress());
        let file = self.checkpoint.clone();
        refine(self.scene, self.tracer, patches, cast, &options, plan, tell, file, progress)
            .map_err(|error| blame(&self.args.scene.path, error))
    }

    /// Patches small enough for a wanted error, and the error that they leave; none where that cannot be told.
    fn small_enough(&self, wanted: f64, start: Instant) -> Result<(Subdivision, Option<f64>)> {
        let mut subdivision = Subdivision::Count(FIRST_PATCHES);
        let mut floor = None;
        let (limit, bytes) = (self.args.common.limit(), forecast::bytes(self.scene, Estimator::Pooled));
        for _ in 0..MOST_CUTS {
            let cast = CastOptions { rays: FIRST_RAYS, seed: self.args.seed, ..CastOptions::default() };
            let options = self.args.solve_options();
            let progress = self.watch.progress();
            let patches = Patches::subdivide(self.scene, &subdivision);
            let (solved, _) = self.refine(patches, &cast, &Plan::default(), |_, _| Ok(()))?;
            let Solved { patches, form_factors, solution, .. } = &solved;
            let found = Discretisation::of(form_factors, patches, solution, &options, progress)?;
            floor = found.map(|d| d.relative);
            // It falls with the edge, and edges with the root of the number of patches.
            let more = floor.map_or(4.0, |f| (f / (OF_PATCHES * wanted)).powi(2).min(MOST_MORE));
            let late = self.args.time.is_some_and(|seconds| start.elapsed().as_secs_f64() > 0.1 * seconds);
            if (more <= 1.0 && floor.is_some()) || late {
                break;
            }
            let next = Subdivision::Count((patches.fronts() as f64 * more.max(1.2)) as usize);
            let count = Patches::forecast(self.scene, &next);
            if count <= patches.fronts() as f64 || limit.check(&self.work(count, FIRST_RAYS, &bytes)).is_err()
            {
                break;
            }
            subdivision = next;
        }
        if let Some(f) = floor.filter(|&f| f > wanted) {
            self.watch.warn(&format!(
                "{:.2} % is out of reach: the smallest patches that can be held leave about {:.2} % themselves",
                100.0 * wanted,
                100.0 * f
            ));
        }
        Ok((subdivision, floor))
    }

    /// Says that the patches someone chose are too large for the error that he wants.
    fn warn_of_patches(&self, solved: &Solved, wanted: f64) -> Result<()> {
        let Solved { patches, form_factors, solution, .. } = solved;
        let options = self.args.solve_options();
        let found = Discretisation::of(form_factors, patches, solution, &options, self.watch.progress())?;
        if let Some(found) = found.filter(|d| d.relative > wanted) {
            self.watch.warn(&format!(
                "patches of this size leave about {:.2} % themselves, which no ray lowers: give more --patches, or none",
                100.0 * found.relative
            ));
        }
        Ok(())
    }

    /// Tells how far a round came.
    fn tell(&self, plan: &Plan, rounds: &[Round]) {
        let [.., round] = rounds else { return };
        let mut line = format!(
            "round {}: {:.0} rays a patch, error {:.3} %, {:.2} s",
            rounds.len(),
            round.rays,
            100.0 * round.error,
            round.elapsed
        );
        let target = plan.error.filter(|&target| round.error > target);
        if let (Some(target), Some(rays)) = (target, plan.forecast(rounds)) {
            let left = round.elapsed * (rays / round.rays - 1.0);
            line += &format!("; {:.3} % needs about {rays:.0} rays, {left:.1} s more", 100.0 * target);
            if plan.most_rays.is_some_and(|most| rays > most) {
                line += ": out of reach of memory";
            }
        }
        if !self.args.common.quiet {
            self.watch.say(&line);
        }
    }
}
