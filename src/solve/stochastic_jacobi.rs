//! Stochastic Jacobi iteration. Every sweep casts new rays through the light that the earlier sweeps have found, and no
//! matrix is stored (Neumann and Neumann, "Stochastic iteration", 1999, and Bekaert, *Hierarchical and Stochastic
//! Algorithms for Radiosity*, 1999). Memory is proportional to the number of patches for any number of rays.
//!
//! One sweep is a noisy product: E = F_s B, B ← Be + ρ E. It is linear in B, and its rays are independent of the light
//! they meet. So the mean of the sweeps has two errors: noise, and the error of the start. The latter decays as slowly
//! as light spreads, over hundreds of sweeps in a long bright corridor. Sweeps therefore start from an equilibrium
//! estimated by few rays (`few_rays`), whose only error is noise. The results are averaged in 16 batches, whose spread
//! estimates the standard error. The dependence between batches is estimated from runs of batches over all patches.
//! Drift from the first half to the last counts as error. Noise that lasts longer than all sweeps together cannot be
//! detected.
//!
//! Light from sky, sun and points enters as in the solution with a matrix: hemisphere rays that leave the scene see the
//! sky, and shadow rays go to the other lights.

use std::ops::Range;

use nalgebra::{SVector, Vector2};
use rayon::prelude::*;

use super::{
    Radiometry,
    batches::{BATCHES, Batches, balancing},
    few_rays::{FewRays, RAYS},
    sweep::{Arrived, Outside, Sweeper, Swept, Tally},
};
use crate::{Error, Progress, Result, form_factor::ordered_sum};

/// Shadow rays of each patch before the first sweep.
const FIRST_SHADOW: u32 = 32;
/// Index of the rays before the first sweep, in a part of the sequences that sweeps do not reach.
const FAR: u32 = u32::MAX - ((1 << 16) - 1);
/// Least number of hemisphere rays of a patch in a sweep, if there are enough rays.
const LEAST_RAYS: f64 = 4.0;
/// Share of all rays that are shadow rays.
const SHADOW: f64 = 0.25;
/// Weight of the newest sweep in the light that the next sweep meets. A smaller weight carries less noise to the next
/// sweep, but reacts more slowly.
const NEWEST: f64 = 0.5;

/// An energy imbalance within this many standard errors counts as noise. With 9 to 16 batches noise exceeds it in one
/// of 950 to 6,300 cases (Student's t distribution with 8 to 15 degrees of freedom).
const NOISE: f64 = 5.0;
/// Share of the energy that may be missing besides: the accuracy of the unblocked light of lamps.
const KNOWN: f64 = 1e-6;

/// The name used on the command line and in reports.
pub const NAME: &str = "stochastic-jacobi";

/// Options for sampling.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct StochasticOptions {
    /// Mean number of rays a patch, without the rays before the first sweep.
    pub rays: f64,
}

impl Default for StochasticOptions {
    /// 256 rays a patch, as in [`Quality::MEDIUM`](crate::Quality::MEDIUM).
    fn default() -> Self {
        StochasticOptions { rays: 256.0 }
    }
}

setters!(StochasticOptions {
    with_rays(rays: f64),
});

/// Progress of the sweeps.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Reached {
    /// Rays a patch, without the rays before the first sweep.
    pub rays: f64,
    /// Area-weighted root mean square of the standard error of irradiance, relative to its mean.
    pub error: f64,
    /// Rays of the next batch, as a share of the rays so far.
    pub next: f64,
}

/// The light on every patch, with its standard errors; `channels` interleaved values a patch.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct StochasticSolution {
    /// Number of channels, 1 or 3.
    pub channels: usize,
    /// Radiosity B = Be + ρ E, W/m².
    pub radiosity: Vec<f64>,
    /// Irradiance E, W/m².
    pub irradiance: Vec<f64>,
    /// Standard error of the irradiance, W/m². It is rather too large than too small.
    pub standard_error: Vec<f64>,
    /// Number of sweeps.
    pub sweeps: u32,
    /// Number of rays of the sweeps, and of those before the first one.
    pub tally: Tally,
    /// Rays a patch and error of the sweeps that count.
    pub reached: Reached,
    /// Σ A Be, W.
    pub emitted: Vec<f64>,
    /// Power from sky, sun and other lights that are not surfaces, as far as it hits a surface, W.
    pub entered: Vec<f64>,
    /// Standard error of the power that enters, W.
    pub entered_error: Vec<f64>,
    /// Σ A (1 - ρ) E, W.
    pub absorbed: Vec<f64>,
    /// Power that left the scene, W.
    pub escaped: Vec<f64>,
    /// (emitted + entered - absorbed - escaped) / (emitted + entered) of each channel as the rays estimate it, before
    /// all arriving and escaping light is scaled to balance.
    pub imbalance: Vec<f64>,
    /// Standard error of the imbalance.
    pub imbalance_error: Vec<f64>,
}

impl StochasticSolution {
    /// Whether in every channel the imbalance of energy is within its own noise and the sampling error of patches.
    /// Balancing then moves no patch by more than its uncertainty. If not, some light was never sampled, or the sweeps
    /// have not settled.
    pub fn is_balanced(&self) -> bool {
        let both = self.imbalance.iter().zip(&self.imbalance_error);
        let allowed = |error: f64| KNOWN + NOISE * error + self.reached.error;
        both.into_iter().all(|(imbalance, &error)| imbalance.abs() <= allowed(error))
    }

    /// The imbalance of the worst channel, and its standard error.
    pub fn worst_imbalance(&self) -> (f64, f64) {
        let both = self.imbalance.iter().copied().zip(self.imbalance_error.iter().copied());
        both.fold((0.0, 0.0), |worst: (f64, f64), one| if one.0.abs() > worst.0.abs() { one } else { worst })
    }

    /// (emitted + entered - absorbed - escaped) / (emitted + entered) of the worst channel, after balancing.
    pub fn balanced_to(&self) -> f64 {
        let sent = self.emitted.iter().zip(&self.entered).map(|(emitted, entered)| emitted + entered);
        let powers = sent.zip(&self.absorbed).zip(&self.escaped);
        let left = powers.filter(|((sent, _), _)| *sent > 0.0).map(|((b, a), e)| (b - a - e) / b);
        left.fold(0.0, |worst: f64, x| if x.abs() > worst.abs() { x } else { worst })
    }
}

/// Solves B = Be + ρ F B for the patches of the sweeper.
///
/// # Errors
/// [`Error::NoEquilibrium`] when nothing absorbs and nothing escapes; [`Error::Stopped`].
///
/// # Panics
/// When the radiometry does not belong to those patches.
pub fn solve<'a>(
    sweeper: &Sweeper<'_>,
    radiometry: impl Into<Radiometry<'a>>,
    options: &StochasticOptions,
    progress: &Progress,
) -> Result<StochasticSolution> {
    solve_while(sweeper, radiometry, options, |_| false, progress)
}

/// Like [`solve`], and then continues batch by batch while `more` returns true. 16 full batches are joined to 8 that
/// are twice as long. So the result is the mean of 9 to 16 batches, and each batch adds at most an eighth to the rays
/// before.
///
/// # Errors
/// As [`solve`].
///
/// # Panics
/// As [`solve`].
pub fn solve_while<'a>(
    sweeper: &Sweeper<'_>,
    radiometry: impl Into<Radiometry<'a>>,
    options: &StochasticOptions,
    mut more: impl FnMut(&Reached) -> bool,
    progress: &Progress,
) -> Result<StochasticSolution> {
    iterate(sweeper, radiometry.into(), options, &mut more, progress)
}

fn iterate(
    sweeper: &Sweeper<'_>,
    radiometry: Radiometry<'_>,
    options: &StochasticOptions,
    more: &mut dyn FnMut(&Reached) -> bool,
    progress: &Progress,
) -> Result<StochasticSolution> {
    let n = sweeper.areas().len() * radiometry.channels;
    assert_eq!((radiometry.emission.len(), radiometry.reflectance.len()), (n, n), "sizes disagree");
    match radiometry.channels {
        1 => Iteration::<1>::new(sweeper, radiometry).run(options, more, progress),
        _ => Iteration::<3>::new(sweeper, radiometry).run(options, more, progress),
    }
}

/// Indices into [`Iteration::outside`].
const WHOLE: usize = 0;
const BATCH: usize = 1;

struct Iteration<'a, const C: usize> {
    sweeper: &'a Sweeper<'a>,
    emission: &'a [[f64; C]],
    reflectance: &'a [[f64; C]],
    radiosity: Vec<[f64; C]>,
    /// Irradiance of each patch by hemisphere rays, without the emission of lamps, averaged over the newest sweeps.
    indirect: Vec<[f64; C]>,
    /// Unblocked irradiance of each patch from lamps, if it is known.
    unblocked: Vec<Option<[f64; C]>>,
    /// Light that rays brought in all sweeps.
    whole: Vec<Arrived<C>>,
    /// Light that rays brought in the present batch.
    batch: Vec<Arrived<C>>,
    /// The part of `whole` and of `batch` from outside the patches; empty if there is none.
    outside: [Vec<Outside<C>>; 2],
    /// Number of hemisphere rays of each patch in `whole`.
    counted: f64,
    batches: Batches<'a, C>,
    tally: Tally,
    sweeps: u32,
}

impl<'a, const C: usize> Iteration<'a, C> {
    fn new(sweeper: &'a Sweeper<'a>, radiometry: Radiometry<'a>) -> Self {
        let (emission, n) = (radiometry.emission.as_chunks::<C>().0, sweeper.areas().len());
        let reflectance = radiometry.reflectance.as_chunks().0;
        let outside = vec![Outside::NOTHING; if sweeper.has_outside() { n } else { 0 }];
        Iteration {
            sweeper,
            emission,
            reflectance,
            radiosity: emission.to_vec(),
            indirect: vec![[0.0; C]; n],
            unblocked: (0..n).into_par_iter().with_min_len(64).map(|i| sweeper.unblocked(i)).collect(),
            whole: vec![Arrived::NOTHING; n],
            batch: vec![Arrived::NOTHING; n],
            outside: [outside.clone(), outside],
            counted: 0.0,
            batches: Batches::new(sweeper.areas(), emission, reflectance, sweeper.magnitude()),
            tally: Tally::default(),
            sweeps: 0,
        }
    }

    fn run(
        mut self,
        options: &StochasticOptions,
        mut more: impl FnMut(&Reached) -> bool,
        progress: &Progress,
    ) -> Result<StochasticSolution> {
        let lamps = self.sweeper.has_lamps();
        let of_batch = options.rays / BATCHES as f64;
        let hemisphere = of_batch * if lamps { 1.0 - SHADOW } else { 1.0 };
        let sweeps = (hemisphere / LEAST_RAYS).floor().max(1.0);
        let each = |rays: f64| (rays / sweeps).round().max(1.0) as u32;
        let rays = [each(hemisphere), if lamps { each(of_batch * SHADOW) } else { 0 }];
        let mut sweeps = sweeps as u64;
        let steps = |sweeps: u64| sweeps * self.emission.len() as u64;
        progress.begin("stochastic Jacobi", steps(u64::from(RAYS) + BATCHES as u64 * sweeps));

        self.start(progress)?;
        let (mut counted, mut first) = (0, true);
        loop {
            self.fill_batch(counted..counted + sweeps, rays, progress)?;
            counted += sweeps;
            if first && !self.batches.are_full() {
                continue;
            }
            first = false;
            let so_far = (counted * u64::from(rays[0] + rays[1])) as f64;
            let next = if self.batches.are_full() { 2 * sweeps } else { sweeps } as f64 / counted as f64;
            let reached = Reached { rays: so_far, error: self.batches.error(), next };
            if !more(&reached) {
                return Ok(self.finish(reached));
            }
            if self.batches.are_full() {
                self.batches.pair();
                sweeps *= 2;
                progress.begin("stochastic Jacobi", steps(BATCHES as u64 / 2 * sweeps));
            }
        }
    }

    /// Adds a batch of sweeps with these numbers.
    fn fill_batch(&mut self, numbers: Range<u64>, rays: [u32; 2], progress: &Progress) -> Result<()> {
        let count = (numbers.end - numbers.start) as f64 * f64::from(rays[0]);
        self.batch.fill(Arrived::NOTHING);
        self.outside[BATCH].fill(Outside::NOTHING);
        let mut escaped = SVector::<f64, C>::zeros();
        for number in numbers {
            // Sequences start again before they reach the far part.
            let first = rays.map(|rays| (number * u64::from(rays) % u64::from(FAR)) as u32);
            escaped += self.sweep(first, rays, progress)? / count;
        }
        let (whole, batch) = (&self.whole, &self.batch);
        let direct = |i: usize| self.sweeper.direct(&self.unblocked[i], &batch[i], &whole[i]);
        let entered = entered(self.sweeper.areas(), &self.outside[BATCH], batch, count, &direct);
        let (sky, of_batch) = (&self.outside[BATCH], &self.batch);
        let arrived = |i: usize| {
            let (direct, sky) = (direct(i), sky_of(sky, i, count));
            std::array::from_fn(|c| direct[c] + sky[c] + of_batch[i].met[c] / count)
        };
        self.batches.push(arrived, [entered, escaped.into()]);
        Ok(())
    }

    /// Casts a sweep with `rays` hemisphere and shadow rays from the indices `first` on, and updates the radiosity.
    /// Returns the power that escaped, times the number of hemisphere rays.
    fn sweep(&mut self, first: [u32; 2], rays: [u32; 2], progress: &Progress) -> Result<SVector<f64, C>> {
        let [hemisphere, shadow] = [0, 1].map(|k| first[k]..first[k] + rays[k]);
        let Swept { arrived: came, outside, tally } =
            self.sweeper.sweep(&self.radiosity, hemisphere, shadow, progress)?;
        self.tally.add(tally);
        self.sweeps += 1;
        self.counted += f64::from(rays[0]);
        for sums in &mut self.outside {
            sums.iter_mut().zip(&outside).for_each(|(sum, came)| sum.add(came));
        }
        let (sky, counted) = (&self.outside[WHOLE], self.counted);
        let (sweeper, areas, unblocked) = (self.sweeper, self.sweeper.areas(), &self.unblocked);
        // Escaping power uses the light before the sweep.
        let left = |i: usize| areas[i] * came[i].escaped * SVector::from(self.radiosity[i]);
        let escaped = ordered_sum(came.len(), left);
        let patches = self.radiosity.par_iter_mut().zip(&mut self.indirect).zip(&mut self.whole);
        patches.zip(&mut self.batch).zip(&came).enumerate().with_min_len(1024).for_each(
            |(i, ((((radiosity, indirect), whole), batch), came))| {
                whole.add(came);
                batch.add(came);
                let (direct, sky) = (sweeper.direct(&unblocked[i], whole, whole), sky_of(sky, i, counted));
                for c in 0..C {
                    indirect[c] += NEWEST * (came.met[c] / f64::from(rays[0]) - indirect[c]);
                    let light = direct[c] + sky[c] + indirect[c];
                    radiosity[c] = self.emission[i][c] + self.reflectance[i][c] * light;
                }
            },
        );
        progress.advance(came.len() as u64);
        Ok(escaped)
    }

    /// Starts from the light that few rays estimate, which is correct after any number of bounces except for sampling
    /// error.
    fn start(&mut self, progress: &Progress) -> Result<()> {
        let (sweeper, n) = (self.sweeper, self.emission.len());
        if sweeper.has_lamps() {
            let swept = sweeper.sweep(self.emission, 0..0, FAR..FAR + FIRST_SHADOW, progress)?;
            self.tally.add(swept.tally);
            (self.whole, self.outside[WHOLE]) = (swept.arrived, swept.outside);
        }
        let few = FewRays::cast(sweeper, FAR, progress)?;
        self.tally.add(few.tally);
        // Direct light: from lamps by shadow rays, and from other emitters and the sky by hemisphere rays.
        let direct = |i: usize| sweeper.direct(&self.unblocked[i], &self.whole[i], &self.whole[i]);
        let direct: Vec<[f64; C]> = (0..n).map(direct).collect();
        let dim: Vec<[f64; C]> =
            (0..n).map(|i| if sweeper.is_lamp(i) { [0.0; C] } else { self.emission[i] }).collect();
        let mut arriving = few.gather(&dim);
        let sky = |i: usize| few.sky.get(i).copied().unwrap_or([0.0; C]);
        for (i, arriving) in arriving.iter_mut().enumerate() {
            let sky = sky(i);
            (0..C).for_each(|c| arriving[c] += direct[i][c] + sky[c]);
        }
        let light = few.solve(&arriving, self.reflectance, progress)?;
        let light = light.as_ref().unwrap_or(&arriving);
        if self.is_caught(light, &few) {
            return Err(Error::NoEquilibrium);
        }
        for i in 0..n {
            let sky = sky(i);
            for c in 0..C {
                let light = light[i][c].max(0.0);
                self.indirect[i][c] = light - direct[i][c] - sky[c];
                self.radiosity[i][c] = self.emission[i][c] + self.reflectance[i][c] * light;
            }
        }
        Ok(())
    }

    /// Whether light is reflected, but no surface absorbs any and none escapes, as far as few rays show.
    fn is_caught(&self, light: &[[f64; C]], few: &FewRays<C>) -> bool {
        (0..C).any(|c| {
            let powers = |i: usize| {
                let (rho, all) = (self.reflectance[i][c], self.sweeper.areas()[i] * light[i][c].max(0.0));
                all * Vector2::new(rho, 1.0 - rho + few.escaping(i) * rho)
            };
            let [reflected, lost]: [f64; 2] = ordered_sum(light.len(), powers).into();
            reflected > 0.0 && lost <= 0.0
        })
    }

    /// Σ A Be of a channel.
    fn emitted(&self, c: usize) -> f64 {
        let areas = self.sweeper.areas();
        ordered_sum(areas.len(), |i| areas[i] * self.emission[i][c])
    }

    fn finish(self, reached: Reached) -> StochasticSolution {
        let (n, areas, counted) = (self.radiosity.len(), self.sweeper.areas(), self.counted);
        // Ratios of total sums have less bias than ratios of batches.
        let direct = |i: usize| self.sweeper.direct(&self.unblocked[i], &self.whole[i], &self.whole[i]);
        let sampled = |i: usize| {
            let (direct, sky) = (direct(i), sky_of(&self.outside[WHOLE], i, counted));
            std::array::from_fn::<f64, C, _>(|c| direct[c] + sky[c] + self.whole[i].met[c] / counted)
        };
        let entered = entered(areas, &self.outside[WHOLE], &self.whole, counted, &direct);
        let mut irradiance: Vec<[f64; C]> = (0..n).map(sampled).collect();
        let (mut emitted, mut absorbed, mut escaped) = (vec![], vec![], vec![]);
        let mut imbalance = vec![];
        for c in 0..C {
            let sent = self.emitted(c) + entered[c];
            // Escaping power is estimated from all rays and the mean light. A sum over sweeps is too large: within a
            // sequence, rays that follow many hits of bright patches are more likely to escape.
            let lost = |i: usize| {
                let (e, rho) = (irradiance[i][c], self.reflectance[i][c]);
                let escaping = self.whole[i].escaped / counted;
                areas[i] * Vector2::new((1.0 - rho) * e, escaping * (self.emission[i][c] + rho * e))
            };
            let [kept, left]: [f64; 2] = ordered_sum(n, lost).into();
            let scale = balancing(sent, kept + left);
            irradiance.iter_mut().for_each(|e| e[c] *= scale);
            let relative = |power: f64| if sent > 0.0 { power / sent } else { 0.0 };
            imbalance.push(relative(sent - kept - left));
            emitted.push(self.emitted(c));
            absorbed.push(scale * kept);
            escaped.push(scale * left);
        }
        let [standard_error, imbalance_error, entered_error] = self.batches.errors(&self.sweeper.siblings());
        let radiosity = irradiance.iter().zip(self.emission).zip(self.reflectance);
        StochasticSolution {
            channels: C,
            radiosity: radiosity.flat_map(|((e, be), rho)| (0..C).map(|c| be[c] + rho[c] * e[c])).collect(),
            standard_error,
            irradiance: irradiance.into_flattened(),
            sweeps: self.sweeps,
            tally: self.tally,
            reached,
            emitted,
            entered: entered.into(),
            entered_error,
            absorbed,
            escaped,
            imbalance,
            imbalance_error,
        }
    }
}

/// The irradiance of patch `i` from the sky by `count` hemisphere rays.
fn sky_of<const C: usize>(outside: &[Outside<C>], i: usize, count: f64) -> [f64; C] {
    outside.get(i).map_or([0.0; C], |outside| outside.sky.map(|sky| sky / count))
}

/// The power that enters from outside the patches and hits a surface: the light of the sky by `count` hemisphere rays, and
/// the share of direct light that shadow rays to other lights brought.
fn entered<const C: usize>(
    areas: &[f64],
    outside: &[Outside<C>],
    came: &[Arrived<C>],
    count: f64,
    direct: &(impl Fn(usize) -> [f64; C] + Sync),
) -> [f64; C] {
    let power = |i: usize| -> SVector<f64, C> {
        let (direct, sky) = (direct(i), sky_of(outside, i, count));
        let share = |c: usize| if came[i].lit[c] > 0.0 { outside[i].lit[c] / came[i].lit[c] } else { 0.0 };
        SVector::from_fn(|c, _| areas[i] * (sky[c] + direct[c] * share(c)))
    };
    ordered_sum(outside.len(), power).into()
}
