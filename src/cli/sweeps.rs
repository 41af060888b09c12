//! `solve` without a matrix, if a matrix does not fit into memory or an option chooses this solver.

use std::time::Instant;

use radiosity::{
    Error, Result,
    accuracy::{
        memory::without_matrix,
        refinement::{Plan, Round},
    },
    output::report::Seconds,
    patch::Patches,
    solve::{
        stochastic_jacobi::{self, Reached, StochasticOptions},
        sweep::Sweeper,
    },
};

use super::{
    forecast::{self, Work},
    pipeline::blame,
    sampling::{Answer, Sampling},
    summary,
};

impl Sampling<'_> {
    /// Whether to solve with a matrix. Refuses work that does not even fit without a matrix, and work that fits only
    /// without one although an option needs it.
    pub fn holds_matrix(&self, work: &Work) -> Result<bool> {
        let (limit, args) = (self.args.common.limit(), self.args);
        let without = self.bytes_without_matrix();
        let swept = Work { bytes: &without, ..*work };
        let is_swept = args.without_matrix();
        let refusal = match limit.check(if is_swept { &swept } else { work }) {
            Ok(warning) => {
                warning.iter().for_each(|warning| self.watch.warn(warning));
                return Ok(!is_swept);
            }
            Err(refusal) if is_swept => return Err(refusal),
            Err(refusal) => refusal,
        };
        let bytes = without(work.patches, work.rays);
        let Some(option) = args.needs_matrix() else {
            limit.check(&swept).map_err(even_without)?;
            let bytes = summary::memory(bytes);
            self.watch.warn(&format!("{refusal}; solving without a matrix, which takes about {bytes}"));
            return Ok(false);
        };
        if !limit.allows(bytes) {
            return Err(refusal);
        }
        let left_out = if option == "--solver" { String::new() } else { format!(", without {option}") };
        let also = format!("--solver {}{left_out}: {}", stochastic_jacobi::NAME, forecast::exact(bytes));
        let hint = refusal.hint().map_or(also.clone(), |hint| format!("{hint}; or {also}"));
        Err(refusal.with_hint(hint))
    }

    /// Bytes without a matrix, by the number of front patches.
    fn bytes_without_matrix(&self) -> impl Fn(f64, f64) -> f64 {
        move |fronts, _| without_matrix(self.scene, self.with_backs * fronts)
    }

    /// Whether to start again without a matrix, because a matrix with enough rays does not fit into memory.
    pub fn goes_on_without_matrix(&self, plan: &Plan, rounds: &[Round], fronts: f64) -> bool {
        let goes_on = plan.starts_anew(rounds)
            && self.args.needs_matrix().is_none()
            && self.args.common.limit().allows(self.bytes_without_matrix()(fronts, 0.0));
        if goes_on {
            self.watch.warn("a matrix with more rays does not fit into memory; starting again without one");
        }
        goes_on
    }

    /// Solves without a matrix, with `rays` per patch, until the plan is fulfilled.
    pub fn sweep(
        &self,
        mut patches: Patches,
        rays: f64,
        plan: &Plan,
        times: &mut Seconds,
    ) -> Result<(Answer, Vec<Round>)> {
        let (args, progress) = (self.args, self.watch.progress());
        let start = Instant::now();
        let mut rounds: Vec<Round> = Vec::new();
        let in_rounds = *plan != Plan::default();
        let more = |reached: &Reached| {
            let elapsed = start.elapsed().as_secs_f64();
            let round = Round { rays: reached.rays, error: reached.error, elapsed, casting: elapsed };
            let goes_on = plan.goes_on(&round, reached.next * elapsed);
            // A round is reported when the number of rays has doubled, and at the end.
            if !goes_on || rounds.last().is_none_or(|last| round.rays >= 2.0 * last.rays) {
                rounds.push(round);
                if in_rounds {
                    self.tell(plan, &rounds);
                }
            }
            goes_on
        };
        let work = || {
            let looking = Instant::now();
            let sweeper = Sweeper::new(self.scene, self.tracer, &mut patches, args.seed, progress)?;
            times.form_factors = looking.elapsed().as_secs_f64();
            let options = StochasticOptions::default().with_rays(rays);
            stochastic_jacobi::solve_while(&sweeper, sweeper.patches(), &options, more, progress)
                .map_err(|error| blame(&args.scene.path, error))
        };
        let (solution, seconds) = self.watch.stage("sweeps", work)?;
        times.solve = seconds - times.form_factors;
        Ok((Answer::Sweeps(Box::new(patches), Box::new(solution)), rounds))
    }
}

fn even_without(refusal: Error) -> Error {
    let hint = refusal.hint().map(String::from);
    Error::Usage { message: format!("even without a matrix {refusal}"), hint }
}
