//! Sampling in rounds, until the error is low enough or the time is up.
//!
//! Every round keeps all earlier rays and casts more where they reduce the error of irradiance most. A [`Plan`] decides
//! how many more. It uses the recorded rounds and never reads a clock.

use std::{sync::Arc, time::Instant};

use crate::{
    Progress, Result,
    accuracy::{
        error_bars::{ErrorBars, relative_rms},
        solved::Solved,
    },
    form_factor::{CastOptions, Checkpoint, FormFactors},
    patch::Patches,
    scene::Scene,
    solve::{SolveOptions, solve_linear},
    trace::Tracer,
};

/// Rays per patch in the first round.
pub const FIRST_RAYS: f64 = 64.0;
/// A round has at most this many times the rays of the previous one.
const MOST_GROWTH: f64 = 4.0;
/// A round has at least this many times the rays of the previous one, because each assembles and solves everything
/// again.
const LEAST_GROWTH: f64 = 1.2;
/// The plan aims at this share of the target error, so that chance does not cause one more round.
const AIM: f64 = 0.97;
/// Smallest and largest power of the number of rays with which the error falls. It is 1/2 for independent rays and
/// larger for stratified rays.
const RATES: (f64, f64) = (0.5, 0.8);
/// The power that is assumed after one round.
const USUAL_RATE: f64 = 0.65;

/// Sweeps without a matrix start only if the remaining time is this many times the time spent with a matrix. With the
/// same rays their error is about twice as large, and it falls with the power 0.6 of the number of rays. So 4 times the
/// time reaches about the same error, and 5 times a smaller one.
const ANEW: f64 = 5.0;

/// The result of a round.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Round {
    /// Mean number of rays per patch, over all rounds.
    pub rays: f64,
    /// Estimated RMS error of irradiance from sampling, relative to its mean.
    pub error: f64,
    /// Seconds that all rounds so far took.
    pub elapsed: f64,
    /// Seconds that casting and assembling took in this round.
    pub casting: f64,
}

/// Limits of the sampling. Without any limit, sampling stops after the first round.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct Plan {
    /// Target error. Sampling stops when the error is at most this.
    pub error: Option<f64>,
    /// Time limit in seconds. A round starts only if it, and everything after the last round, is expected to end in
    /// time.
    pub seconds: Option<f64>,
    /// Duration of everything after the last round, relative to the last round. Zero if unknown.
    pub after: f64,
    /// Largest number of rays per patch that memory holds.
    pub most_rays: Option<f64>,
}

setters!(Plan {
    with_error(error: Option<f64>),
    with_seconds(seconds: Option<f64>),
    with_after(after: f64),
    with_most_rays(most_rays: Option<f64>),
});

impl Plan {
    /// The number of rays per patch after the next round, or `None` to stop.
    ///
    /// # Panics
    /// If `rounds` is empty.
    pub fn next(&self, rounds: &[Round]) -> Option<f64> {
        let last = rounds.last().expect("at least one round");
        if !self.wants_more(last) {
            return None;
        }
        let mut growth = MOST_GROWTH;
        if let Some(target) = self.error {
            growth = growth.min((last.error / (AIM * target)).powf(1.0 / rate(rounds)).max(LEAST_GROWTH));
        }
        if let Some(seconds) = self.seconds {
            // The time of a round is about proportional to all rays so far, because it assembles and solves with all of
            // them.
            let before = rounds.len().checked_sub(2).map_or(0.0, |k| rounds[k].elapsed);
            let left = seconds - last.elapsed;
            growth = growth.min(left / ((1.0 + self.after) * (last.elapsed - before)).max(1e-9));
        }
        let rays = self.most_rays.unwrap_or(f64::INFINITY).min(growth * last.rays);
        (rays >= LEAST_GROWTH * last.rays).then_some(rays)
    }

    /// Whether to continue after this round, for a method that can stop at any time. `seconds` is the time of the next
    /// step.
    pub fn goes_on(&self, last: &Round, seconds: f64) -> bool {
        self.wants_more(last) && self.seconds.is_none_or(|all| last.elapsed + seconds <= all)
    }

    /// Whether to start again without a matrix after the last round that fits into memory. This is so if the target
    /// error was not reached and there is enough time for sweeps to reach a smaller error.
    pub fn starts_anew(&self, rounds: &[Round]) -> bool {
        let Some(last) = rounds.last() else { return false };
        self.wants_more(last) && self.seconds.is_none_or(|all| all - last.elapsed > ANEW * last.elapsed)
    }

    /// Whether the target error was not reached. Without a target error: whether there is a time limit.
    fn wants_more(&self, last: &Round) -> bool {
        match self.error {
            Some(target) => last.error > target,
            None => self.seconds.is_some(),
        }
    }

    /// Forecast of the number of rays per patch for the target error, from the rounds so far. `None` without a target
    /// error.
    pub fn forecast(&self, rounds: &[Round]) -> Option<f64> {
        let (target, last) = (self.error?, rounds.last()?);
        Some(last.rays * (last.error / target).max(1.0).powf(1.0 / rate(rounds)))
    }
}

/// The power of the number of rays with which the error falls.
fn rate(rounds: &[Round]) -> f64 {
    let [.., before, last] = rounds else { return USUAL_RATE };
    let observed = (before.error / last.error).ln() / (last.rays / before.rays).ln();
    if observed.is_finite() { observed.clamp(RATES.0, RATES.1) } else { RATES.0 }
}

/// Casts and solves the first round, with the rays of `cast`. If there is a checkpoint, known hits are read from it.
/// New hits are stored in it, also by later rounds.
///
/// # Errors
/// See [`FormFactors::cast_checkpointed`] and [`solve_linear`].
pub fn begin(
    scene: &Scene,
    tracer: &Tracer,
    mut patches: Patches,
    cast: &CastOptions,
    options: &SolveOptions,
    checkpoint: Option<Arc<Checkpoint>>,
    progress: &Progress,
) -> Result<(Solved, Round)> {
    let start = Instant::now();
    let form_factors =
        FormFactors::cast_checkpointed(scene, tracer, &mut patches, cast, checkpoint, progress)?;
    round((scene, tracer), (start, 0.0), patches, form_factors, options, progress)
}

/// Continues after the first round until `next` returns `None`. Returns the last solution and all rounds. `next`
/// receives the solution and all rounds so far, and returns the number of rays per patch after one more round. Its own
/// time is not part of any round.
///
/// # Errors
/// See [`solve_linear`]. Errors of `next` are returned too.
pub fn refine(
    scene: &Scene,
    tracer: &Tracer,
    (mut solved, first): (Solved, Round),
    options: &SolveOptions,
    mut next: impl FnMut(&Solved, &[Round]) -> Result<Option<f64>>,
    progress: &Progress,
) -> Result<(Solved, Vec<Round>)> {
    let mut rounds = vec![first];
    while let Some(rays) = next(&solved, &rounds)? {
        let (start, before) = (Instant::now(), rounds.last().map_or(0.0, |round| round.elapsed));
        let Solved { mut patches, form_factors, .. } = solved;
        let form_factors = form_factors.cast_more(scene, tracer, &mut patches, rays, progress)?;
        let last;
        (solved, last) = round((scene, tracer), (start, before), patches, form_factors, options, progress)?;
        rounds.push(last);
    }
    Ok((solved, rounds))
}

/// Everything after casting, in a round that began at `start`. The earlier rounds took `before` seconds.
fn round(
    (scene, tracer): (&Scene, &Tracer),
    (start, before): (Instant, f64),
    patches: Patches,
    form_factors: FormFactors,
    options: &SolveOptions,
    progress: &Progress,
) -> Result<(Solved, Round)> {
    let casting = start.elapsed().as_secs_f64();
    let solution = solve_linear((scene, tracer), &form_factors, &patches, options, progress)?;
    let error_bars = ErrorBars::of(&form_factors, &patches, &solution).expect("rays were cast");
    let seen = patches.seen_areas(&solution.irradiance);
    let round = Round {
        rays: form_factors.rays() as f64 / patches.len() as f64,
        error: relative_rms(&error_bars.standard_error, &solution.irradiance, &seen),
        elapsed: before + start.elapsed().as_secs_f64(),
        casting,
    };
    Ok((Solved { patches, form_factors, solution, error_bars }, round))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn round(rays: f64, error: f64, elapsed: f64) -> Round {
        Round { rays, error, elapsed, casting: 0.5 * elapsed }
    }

    /// An error that falls like 1/sqrt(rays) reaches the target in the fewest rounds that the largest growth allows. It
    /// overshoots by no more than the least growth.
    #[test]
    fn an_error_is_reached_and_not_by_far() {
        let plan = Plan { error: Some(0.01), ..Plan::default() };
        let mut rounds = vec![round(64.0, 0.08, 1.0)];
        while let Some(rays) = plan.next(&rounds) {
            rounds.push(round(rays, 0.08 * (64.0 / rays).sqrt(), 1.0));
        }
        let last = rounds.last().unwrap();
        assert!(last.error <= 0.01 && last.error >= 0.01 / LEAST_GROWTH.sqrt(), "{rounds:?}");
        // 64 times the rays take three more rounds with four times the rays each.
        assert_eq!(rounds.len(), 4);
        // The second round determines the rate.
        assert!((plan.forecast(&rounds[..2]).unwrap() / 4096.0 - 1.0).abs() < 1e-12);
    }

    #[test]
    fn no_round_begins_that_would_end_too_late() {
        let plan = Plan { seconds: Some(10.0), ..Plan::default() };
        assert_eq!(plan.next(&[round(64.0, 0.1, 1.0)]), Some(256.0));
        // The last round took 4 seconds, and 5 are left: a quarter more rays fit.
        assert_eq!(plan.next(&[round(64.0, 0.1, 1.0), round(256.0, 0.05, 5.0)]), Some(320.0));
        assert_eq!(plan.next(&[round(64.0, 0.1, 1.0), round(256.0, 0.05, 6.0)]), None);
    }

    /// Rounds take `cost` seconds per ray per patch, and everything after the last round takes `after` times as long as
    /// that round. Then all ends in time, and the remaining time is too short for another round.
    #[test]
    fn what_comes_after_the_last_round_ends_in_time_too() {
        for (seconds, cost, after) in
            [(1.0, 1e-3, 0.0), (1.0, 1e-3, 0.5), (1.0, 1e-3, 5.0), (30.0, 1e-2, 1.0), (3.0, 2e-3, 2.0)]
        {
            let plan = Plan { seconds: Some(seconds), after, ..Plan::default() };
            let mut rounds = vec![round(64.0, 0.1, 64.0 * cost)];
            while let Some(rays) = plan.next(&rounds) {
                rounds.push(round(rays, 0.1, rounds.last().unwrap().elapsed + rays * cost));
            }
            let last = rounds.last().unwrap();
            let end = |rays: f64| last.elapsed + after * rays * cost;
            assert!(end(last.rays) <= seconds + 1e-12, "{rounds:?}");
            let more = LEAST_GROWTH * last.rays;
            assert!(end(more) + more * cost > seconds - 1e-12, "{rounds:?}");
        }
    }

    #[test]
    fn small_steps_go_on_until_the_error_is_reached_or_the_time_is_up() {
        let last = round(64.0, 0.02, 8.0);
        let plan = |error, seconds| Plan { error, seconds, ..Plan::default() };
        assert!(plan(Some(0.01), None).goes_on(&last, 1e9) && !plan(Some(0.02), None).goes_on(&last, 0.0));
        assert!(plan(None, Some(10.0)).goes_on(&last, 2.0) && !plan(None, Some(10.0)).goes_on(&last, 2.1));
        assert!(!plan(Some(0.02), Some(10.0)).goes_on(&last, 1.0));
        assert!(!Plan::default().goes_on(&last, 0.0));
    }

    #[test]
    fn sweeps_start_where_a_matrix_missed_and_there_is_time() {
        let plan = |error, seconds| Plan { error, seconds, ..Plan::default() };
        let rounds = [round(64.0, 0.1, 0.5), round(100.0, 0.02, 1.0)];
        assert!(plan(Some(0.01), None).starts_anew(&rounds) && !plan(Some(0.02), None).starts_anew(&rounds));
        assert!(plan(None, Some(6.1)).starts_anew(&rounds) && !plan(None, Some(5.9)).starts_anew(&rounds));
        assert!(!plan(Some(0.02), Some(60.0)).starts_anew(&rounds));
        assert!(!Plan::default().starts_anew(&rounds));
    }

    #[test]
    fn memory_is_a_limit_and_no_wish_is_one_round() {
        let plan = Plan { error: Some(1e-6), most_rays: Some(100.0), ..Plan::default() };
        assert_eq!(plan.next(&[round(64.0, 0.1, 1.0)]), Some(100.0));
        assert_eq!(plan.next(&[round(100.0, 0.1, 1.0)]), None);
        assert_eq!(Plan::default().next(&[round(64.0, 0.1, 1.0)]), None);
    }
}
