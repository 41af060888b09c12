//! The number of rays and the choice of patches in `solve`.

use std::{io, sync::Arc, time::Instant};

use radiosity::{
    Error, Ranks, Result, Scene,
    accuracy::{
        discretisation::Discretisation,
        patch_search::{PatchSearch, SmallPatches, left_for_sampling},
        refinement::{FIRST_RAYS, Plan, Round, begin, refine},
        solved::Solved,
    },
    form_factor::{CastOptions, Checkpoint, Estimator},
    monte_carlo::Camera,
    output::{
        ply::{self, PlyOptions},
        report::Seconds,
    },
    patch::Patches,
    solve::{Light, stochastic_jacobi::StochasticSolution},
    trace::Tracer,
};

use super::{
    forecast::{self, Work},
    pipeline::blame,
    solve::{Errors, SolveArgs, view},
    watch::Watch,
};

/// Share of `--time` that may pass until the patches are chosen.
const LATE: f64 = 0.2;

/// A scene about to be sampled.
pub struct Sampling<'a> {
    pub args: &'a SolveArgs,
    pub scene: &'a Scene,
    pub tracer: &'a Tracer,
    /// The camera of the picture, if there is one.
    pub camera: Option<&'a Camera>,
    pub watch: &'a Watch,
    /// The store of rays.
    pub checkpoint: Option<Arc<Checkpoint>>,
    /// Number of all patches relative to the number of fronts.
    pub with_backs: f64,
}

/// The light, with its sampling errors.
pub enum Answer {
    /// The solution with a matrix, and the errors that need a matrix.
    Matrix(Box<Solved>, Box<Errors>),
    /// The solution without a matrix.
    Sweeps(Box<Patches>, Box<StochasticSolution>),
}

impl Answer {
    pub fn patches(&self) -> &Patches {
        match self {
            Answer::Matrix(solved, _) => &solved.patches,
            Answer::Sweeps(patches, _) => patches,
        }
    }

    pub fn light(&self) -> Light<'_> {
        match self {
            Answer::Matrix(solved, _) => (&solved.solution).into(),
            Answer::Sweeps(_, solution) => (&**solution).into(),
        }
    }

    /// Standard error of irradiance.
    pub fn standard_error(&self) -> &[f64] {
        match self {
            Answer::Matrix(solved, _) => &solved.error_bars.standard_error,
            Answer::Sweeps(_, solution) => &solution.standard_error,
        }
    }

    /// The errors that need a matrix.
    pub fn errors(&self) -> Option<&Errors> {
        match self {
            Answer::Matrix(_, errors) => Some(errors),
            Answer::Sweeps(..) => None,
        }
    }
}

/// The result of the sampling.
pub struct Sampled {
    pub answer: Answer,
    pub rounds: Vec<Round>,
    /// The origin of the choice of patches, in words.
    pub chosen: String,
    /// Their discretisation error, if they were refined where light varies and if it is known.
    pub floor: Option<f64>,
}

impl Sampling<'_> {
    /// Samples and solves according to the arguments.
    pub fn run(&self, start: Instant, times: &mut Seconds) -> Result<Sampled> {
        let args = self.args;
        let wanted = args.error.map(|percent| percent / 100.0);
        let in_rounds = wanted.is_some() || args.time.is_some();
        let rays = if in_rounds { FIRST_RAYS } else { f64::from(args.cast.rays()) };
        let (subdivision, mut chosen) = args.cast.subdivision();
        let (mut target, mut floor) = (wanted, None);
        let (mut adapted, mut first) = (None, None);
        let mut searching = 0.0;
        if in_rounds && args.cast.given_subdivision().is_none() {
            let small;
            (small, searching) = self.watch.stage("patches", || self.small_enough(wanted, start))?;
            let adaptive = small.patches.is_restricted();
            chosen = if adaptive { "smaller where light varies" } else { "as small as needed" }.into();
            target = wanted.map(|wanted| small.sampling_error(wanted));
            (adapted, floor, first) = (Some(small.patches), small.floor, small.first);
        }
        let forecast = || Patches::forecast(self.scene, &subdivision);
        let count = adapted.as_ref().map_or_else(forecast, |patches: &Patches| patches.fronts() as f64);
        let bytes = self.bytes(args.estimator());
        let with_matrix = self.holds_matrix(&self.work(count, rays, &bytes))?;
        let cut = || adapted.unwrap_or_else(|| Patches::subdivide(self.scene, &subdivision));
        let (patches, subdivide) = self.watch.stage("patches", || Ok(cut()))?;
        let ranks = Ranks::world();
        if !with_matrix && ranks.count() > 1 {
            return Err(Error::Usage {
                message: "the matrix does not fit into memory, and only a solution with a matrix is shared out among MPI ranks".into(),
                hint: Some("use fewer --patches or --rays, or more machines and a larger --memory".into()),
            });
        }
        let cast = CastOptions::default()
            .with_rays(rays)
            .with_estimator(args.estimator())
            .with_seed(args.seed)
            .with_ranks(ranks);
        let usable = with_matrix && cast.estimator == Estimator::Pooled;
        let first = first.filter(|_| usable);
        // A first round that is continued counts as a round, not as part of the search for patches.
        let kept = first.as_ref().map_or(0.0, |(_, round)| round.elapsed);
        times.subdivide = searching - kept + subdivide;
        let before = start.elapsed().as_secs_f64() - kept;
        let plan = Plan::default()
            .with_error(target)
            .with_seconds(args.time.map(|seconds| seconds - before))
            .with_most_rays((in_rounds && with_matrix).then(|| args.common.limit().most_rays(count, &bytes)));
        let (answer, rounds) = match with_matrix {
            true => self.by_matrix(patches, first, &cast, plan, wanted, times)?,
            false => self.sweep(patches, rays, &plan, times)?,
        };
        Ok(Sampled { answer, rounds, chosen, floor })
    }

    /// Casts and solves until the plan is fulfilled, continuing the first round if there is one. The plan leaves room for
    /// the discretisation error, which every round estimates anew, below the total error `wanted`.
    fn by_matrix(
        &self,
        patches: Patches,
        first: Option<(Solved, Round)>,
        cast: &CastOptions,
        mut plan: Plan,
        wanted: Option<f64>,
        times: &mut Seconds,
    ) -> Result<(Answer, Vec<Round>)> {
        let target = plan.error;
        let mut of_last = None;
        let next = |solved: &Solved, rounds: &[Round]| {
            if plan == Plan::default() {
                return Ok(None);
            }
            if let Some(wanted) = wanted {
                of_last = self.discretisation(solved)?;
                let of_patches = of_last.as_ref().map(|found| found.relative);
                if let (1, Some(error)) = (rounds.len(), of_patches) {
                    self.warn_of_patches(error, wanted);
                }
                plan.error = Some(left_for_sampling(wanted, of_patches));
            }
            self.tell(&plan, rounds);
            if let (1, Some(seconds), Some(_)) = (rounds.len(), plan.seconds, plan.next(rounds)) {
                let takes = self.seconds_after(solved)?;
                plan.after = takes / rounds[0].elapsed;
                plan.seconds = Some(seconds - takes);
            }
            Ok(plan.next(rounds))
        };
        let ((solved, rounds), _) = self.watch.stage("rays", || {
            let first = first.map_or_else(|| self.begin(patches, cast), Ok)?;
            let (options, progress) = (self.args.solve_options(), self.watch.progress());
            refine(self.scene, self.tracer, first, &options, next, progress)
                .map_err(|error| self.blame(error))
        })?;
        let all = rounds.last().map_or(0.0, |round| round.elapsed);
        times.form_factors = rounds.iter().map(|round| round.casting).sum();
        times.solve = all - times.form_factors;
        if !self.goes_on_without_matrix(&plan, &rounds, solved.patches.fronts() as f64) {
            let (errors, seconds) = self.watch.stage("errors", || self.errors(&solved, of_last))?;
            times.solve += seconds;
            let leak = errors.energy.relative_leak();
            if leak != 0.0 {
                self.watch.warn(&format!(
                    "{:.2} % of the light of lamps arrives nowhere, although no ray leaves the scene: several faces may be at the \
                     same place",
                    100.0 * leak
                ));
            }
            return Ok((Answer::Matrix(Box::new(solved), Box::new(errors)), rounds));
        }
        // The rays cannot be used again, because sweeps need new rays.
        let Solved { patches, .. } = solved;
        let plan = plan
            .with_error(target)
            .with_most_rays(None)
            .with_seconds(plan.seconds.map(|seconds| seconds - all));
        let swept = self.sweep(patches, FIRST_RAYS, &plan, times)?;
        times.form_factors += all;
        Ok(swept)
    }

    /// Bytes with a matrix, by the number of front patches and the rays per patch.
    fn bytes(&self, estimator: Estimator) -> impl Fn(f64, f64) -> f64 {
        let options = self.args.solve_options();
        let (bytes, with_backs) = (forecast::bytes(self.scene, estimator, options.solver), self.with_backs);
        let linear = forecast::of_linear_light(self.scene, options.linear);
        move |fronts, rays| bytes(with_backs * fronts, rays) + linear(with_backs * fronts)
    }

    fn work<'a>(&'a self, patches: f64, rays: f64, bytes: &'a dyn Fn(f64, f64) -> f64) -> Work<'a> {
        Work { scene: self.scene, patches, rays, bytes, options: forecast::USUAL }
    }

    fn begin(&self, patches: Patches, cast: &CastOptions) -> Result<(Solved, Round)> {
        let (options, progress) = (self.args.solve_options(), self.watch.progress());
        begin(self.scene, self.tracer, patches, cast, &options, self.checkpoint.clone(), progress)
            .map_err(|error| self.blame(error))
    }

    /// The errors of a solution, whose discretisation error may be known already.
    fn errors(&self, solved: &Solved, known: Option<Discretisation>) -> Result<Errors> {
        let discretisation = known.map_or_else(|| self.discretisation(solved), |known| Ok(Some(known)))?;
        let (options, progress) = (self.args.solve_options(), self.watch.progress());
        Errors::of(&options, self.tracer, solved, discretisation, progress)
    }

    fn blame(&self, error: Error) -> Error {
        blame(&self.args.scene.path, error)
    }

    /// Seconds for the work after the last round, measured by doing it once.
    fn seconds_after(&self, solved: &Solved) -> Result<f64> {
        let start = Instant::now();
        self.errors(solved, None)?;
        if let Some(camera) = self.camera {
            let light = (&solved.patches, (&solved.solution).into());
            view(camera, (self.scene, self.tracer), light, self.watch.progress())?;
        }
        if let Some(path) = &self.args.output {
            let (patches, light) = (&solved.patches, &solved.solution);
            let options = PlyOptions::default().with_standard_errors(Some(&solved.error_bars.standard_error));
            ply::encode(&mut io::sink(), self.scene, patches, light, &options)
                .map_err(|error| Error::io(path, error))?;
        }
        Ok(start.elapsed().as_secs_f64())
    }

    /// Patches that are small enough for `--error` or suitable for `--time`. They are smaller where light varies.
    fn small_enough(&self, wanted: Option<f64>, start: Instant) -> Result<SmallPatches> {
        let (limit, bytes) = (self.args.common.limit(), self.bytes(Estimator::Pooled));
        let search = PatchSearch::new(self.scene, self.tracer, self.args.seed)
            .with_error(wanted)
            .with_solve(self.args.solve_options())
            .with_checkpoint(self.checkpoint.clone());
        let allows = |patches: f64| limit.check(&self.work(patches, FIRST_RAYS, &bytes)).is_ok();
        let late = || self.args.time.is_some_and(|time| start.elapsed().as_secs_f64() > LATE * time);
        let found = search.run(allows, late, self.watch.progress()).map_err(|error| self.blame(error))?;
        if let (Some(wanted), Some(floor)) = (wanted, found.floor)
            && floor > wanted
        {
            self.watch.warn(&format!(
                "an error of {:.2} % is out of reach: the smallest patches that fit into memory have a discretisation error of about {:.2} %",
                100.0 * wanted,
                100.0 * floor
            ));
        }
        Ok(found)
    }

    fn discretisation(&self, solved: &Solved) -> Result<Option<Discretisation>> {
        let Solved { patches, form_factors, solution, .. } = solved;
        let scene = (self.scene, self.tracer);
        Discretisation::of(scene, form_factors, patches, solution, self.watch.progress())
    }

    /// Warns if the patches from the options are too large for an error of `wanted`.
    fn warn_of_patches(&self, of_patches: f64, wanted: f64) {
        if let Some(option) = self.args.cast.given_patches().filter(|_| of_patches > wanted) {
            self.watch.warn(&format!(
                "patches of this size have a discretisation error of about {:.2} %, which more rays do not reduce: leave {option} out",
                100.0 * of_patches,
            ));
        }
    }

    /// Prints the result of the last round.
    pub fn tell(&self, plan: &Plan, rounds: &[Round]) {
        let [.., round] = rounds else { return };
        let mut line = format!(
            "round {}: {:.0} rays per patch, error {:.3} %, {:.2} s",
            rounds.len(),
            round.rays,
            100.0 * round.error,
            round.elapsed
        );
        let target = plan.error.filter(|&target| round.error > target);
        if let (Some(target), Some(rays)) = (target, plan.forecast(rounds)) {
            let left = round.elapsed * (rays / round.rays - 1.0);
            line +=
                &format!("; {:.3} % needs about {rays:.0} rays per patch, {left:.1} s more", 100.0 * target);
            if plan.most_rays.is_some_and(|most| rays > most) {
                line += ": out of reach of memory";
            }
        }
        if !self.args.common.quiet {
            self.watch.say(&line);
        }
    }
}
