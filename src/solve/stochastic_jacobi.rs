//! Stochastic Jacobi iteration: every sweep casts its rays anew through the light that the sweeps before have found, and no
//! matrix is ever held (Neumann and Neumann, "Stochastic iteration", 1999, and Bekaert, *Hierarchical and Stochastic Algorithms for
//! Radiosity*, 1999). Memory is in proportion to the patches, whatever the number of rays.
//!
//! One sweep is a noisy product: E = F_s B, B ← Be + ρ E. Since the product is linear in B and the rays of a sweep are
//! independent of the light they meet, the mean of the sweeps has no error but noise, once the first bounces are over. What
//! a sweep brings is averaged in 16 batches. Their spread tells the standard error; because light that one sweep overestimates is
//! reflected in the next, batches are correlated, and by how much is read off neighbouring batches of all patches together.

use rayon::prelude::*;

use super::Radiometry;
use crate::{
    Error, Progress, Result,
    form_factor::{
        ordered_sum,
        sweep::{Arrived, Sweeper},
    },
};

/// Sweeps before any is counted,
const FIRST_SWEEPS: u32 = 16;
/// with so many hemisphere rays and shadow rays of each patch. They come from a far part of the sequences.
const FIRST_RAYS: [u32; 2] = [4, 2];
const FAR: u32 = 1 << 15;
/// Batches that the counted sweeps are averaged in.
const BATCHES: usize = 16;
/// Hemisphere rays that a sweep has at least, where there are enough.
const LEAST_RAYS: f64 = 4.0;
/// Share of all rays that are shadow rays.
const SHADOW: f64 = 0.25;
/// Weight of the newest sweep in the light that the next one meets: less noise is carried on, and later.
const NEWEST: f64 = 0.5;

/// How to sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StochasticOptions {
    /// Mean number of rays a patch, the first sweeps not counted.
    pub rays: f64,
}

/// The light on every patch, with its statistical errors; `channels` interleaved values each.
#[derive(Debug, Clone, PartialEq)]
pub struct StochasticSolution {
    /// 1 or 3.
    pub channels: usize,
    /// Radiosity B = Be + ρ E, W/m².
    pub radiosity: Vec<f64>,
    /// Irradiance E, W/m².
    pub irradiance: Vec<f64>,
    /// Standard error of the irradiance, W/m².
    pub standard_error: Vec<f64>,
    /// Sweeps, the first ones counted.
    pub sweeps: u32,
    /// Rays of each patch, all sweeps together; fewer where no lamp is in front.
    pub rays: u32,
    /// Σ A Be, W.
    pub emitted: Vec<f64>,
    /// Σ A (1 - ρ) E, W.
    pub absorbed: Vec<f64>,
    /// What left the scene, W.
    pub escaped: Vec<f64>,
    /// (emitted - absorbed - escaped) / emitted of each channel: of statistical nature, unlike that of a matrix.
    pub imbalance: Vec<f64>,
    /// Its standard error.
    pub imbalance_error: Vec<f64>,
}

/// Solves B = Be + ρ F B for the patches of the sweeper.
///
/// # Errors
/// [`Error::NoEquilibrium`] when nothing absorbs and nothing escapes; [`Error::Stopped`].
///
/// # Panics
/// When the radiometry is not of those patches.
pub fn solve<'a>(
    sweeper: &Sweeper<'_>,
    radiometry: impl Into<Radiometry<'a>>,
    options: &StochasticOptions,
    progress: &Progress,
) -> Result<StochasticSolution> {
    let radiometry = radiometry.into();
    let n = sweeper.areas().len() * radiometry.channels;
    assert_eq!((radiometry.emission.len(), radiometry.reflectance.len()), (n, n), "sizes disagree");
    match radiometry.channels {
        1 => Iteration::<1>::new(sweeper, radiometry).run(options, progress),
        _ => Iteration::<3>::new(sweeper, radiometry).run(options, progress),
    }
}

/// The mean irradiance of each batch.
type Batches<const C: usize> = [[f32; BATCHES]; C];

struct Iteration<'a, const C: usize> {
    sweeper: &'a Sweeper<'a>,
    emission: &'a [[f64; C]],
    reflectance: &'a [[f64; C]],
    radiosity: Vec<[f64; C]>,
    /// What patches other than lamps send, averaged over the newest sweeps.
    indirect: Vec<[f64; C]>,
    /// All that came by shadow rays, and in the present batch.
    whole: Vec<Arrived<C>>,
    batch: Vec<Arrived<C>>,
}

impl<'a, const C: usize> Iteration<'a, C> {
    fn new(sweeper: &'a Sweeper<'a>, radiometry: Radiometry<'a>) -> Self {
        let (emission, n) = (radiometry.emission.as_chunks::<C>().0, sweeper.areas().len());
        Iteration {
            sweeper,
            emission,
            reflectance: radiometry.reflectance.as_chunks().0,
            radiosity: emission.to_vec(),
            indirect: vec![[0.0; C]; n],
            whole: vec![Arrived::NOTHING; n],
            batch: vec![Arrived::NOTHING; n],
        }
    }

    fn run(mut self, options: &StochasticOptions, progress: &Progress) -> Result<StochasticSolution> {
        let lamps = self.sweeper.has_lamps();
        let of_batch = options.rays / BATCHES as f64;
        let hemisphere = of_batch * if lamps { 1.0 - SHADOW } else { 1.0 };
        let sweeps = (hemisphere / LEAST_RAYS).floor().max(1.0);
        let each = |rays: f64| (rays / sweeps).round().max(1.0) as u32;
        let rays = [each(hemisphere), if lamps { each(of_batch * SHADOW) } else { 0 }];
        let sweeps = sweeps as u32;
        let n = self.radiosity.len();
        let all = FIRST_SWEEPS + BATCHES as u32 * sweeps;
        progress.begin(u64::from(all) * n as u64);

        for sweep in 0..FIRST_SWEEPS {
            self.sweep(FAR + sweep, FIRST_RAYS, 1.0 / (1.0 + f64::from(sweep)).min(1.0 / NEWEST), progress)?;
            self.balance(FIRST_RAYS[0])?;
        }
        // Shadow rays know nothing of other patches' light: all of them count.
        self.whole.iter_mut().for_each(|whole| (whole.met, whole.escaped) = ([0.0; C], 0.0));
        let mut batches: Vec<Batches<C>> = vec![[[0.0; BATCHES]; C]; n];
        let mut escaped = [[0.0; BATCHES]; C];
        for batch in 0..BATCHES {
            self.batch.fill(Arrived::NOTHING);
            for sweep in 0..sweeps {
                // What left is told by the light that this sweep starts from.
                let before: Vec<f64> = self.batch.iter().map(|came| came.escaped).collect();
                let leaving = self.radiosity.clone();
                self.sweep(batch as u32 * sweeps + sweep, rays, NEWEST, progress)?;
                let areas = self.sweeper.areas();
                for c in 0..C {
                    let of_patch = |i: usize| areas[i] * leaving[i][c] * (self.batch[i].escaped - before[i]);
                    escaped[c][batch] += ordered_sum(n, of_patch) / f64::from(rays[0] * sweeps);
                }
            }
            let many = f64::from(rays[0] * sweeps);
            batches.par_iter_mut().enumerate().with_min_len(1024).for_each(|(i, batches)| {
                let [mut direct, indirect] = self.sweeper.irradiance(i, &self.batch[i], many);
                if self.batch[i].kernel == 0.0 {
                    [direct, _] = self.sweeper.irradiance(i, &self.whole[i], many);
                }
                for c in 0..C {
                    batches[c][batch] = (direct[c] + indirect[c]) as f32;
                }
            });
        }
        let of_patch = FIRST_SWEEPS * (FIRST_RAYS[0] + FIRST_RAYS[1] * u32::from(lamps))
            + BATCHES as u32 * sweeps * (rays[0] + rays[1]);
        let counted = BATCHES as u32 * sweeps * rays[0];
        Ok(self.finish(&batches, &escaped, f64::from(counted), [all, of_patch]))
    }

    /// Casts the sweep of this number, and lets the patches reflect what comes.
    fn sweep(&mut self, number: u32, rays: [u32; 2], newest: f64, progress: &Progress) -> Result<()> {
        let [hemisphere, shadow] = rays.map(|rays| {
            // The first sweeps' numbers are far, and their indices no further.
            let first = if number < FAR { number * rays } else { FAR + (number - FAR) * rays };
            first..first + rays
        });
        let came = self.sweeper.sweep(&self.radiosity, hemisphere, shadow, progress)?;
        let sweeper = self.sweeper;
        let patches = self.radiosity.par_iter_mut().zip(&mut self.indirect).zip(&mut self.whole);
        patches.zip(&mut self.batch).zip(&came).enumerate().with_min_len(1024).for_each(
            |(i, ((((radiosity, indirect), whole), batch), came))| {
                whole.add(came);
                batch.add(came);
                let [_, new] = sweeper.irradiance(i, came, f64::from(rays[0]));
                let [direct, _] = sweeper.irradiance(i, whole, 1.0);
                for c in 0..C {
                    indirect[c] += newest * (new[c] - indirect[c]);
                    radiosity[c] = self.emission[i][c] + self.reflectance[i][c] * (direct[c] + indirect[c]);
                }
            },
        );
        progress.advance(came.len() as u64);
        Ok(())
    }

    /// Scales what is reflected so that the energy balances: the light that all patches share, slowest to settle, is right at
    /// once. `rays` are those of a sweep.
    fn balance(&mut self, rays: u32) -> Result<()> {
        let (n, areas) = (self.radiosity.len(), self.sweeper.areas());
        let escaping: Vec<f64> = self.batch.iter().map(|came| came.escaped / f64::from(rays)).collect();
        self.batch.fill(Arrived::NOTHING);
        for c in 0..C {
            let sum = |value: &(dyn Fn(usize) -> f64 + Sync)| ordered_sum(n, |i| areas[i] * value(i));
            let emitted = sum(&|i| self.emission[i][c]);
            let arriving = sum(&|i| self.irradiance(i)[c]);
            let reflected = sum(&|i| self.reflectance[i][c] * self.irradiance(i)[c]);
            if !(reflected > 0.0 && emitted > 0.0) {
                continue;
            }
            // Of what leaves the patches the share that the scene loses before it leaves them again.
            let out = sum(&|i| self.radiosity[i][c] * escaping[i]) / (emitted + reflected);
            let lost = out + (1.0 - out) * (1.0 - reflected / arriving);
            if !(lost > 0.0) {
                return Err(Error::NoEquilibrium);
            }
            let factor = ((emitted / lost - emitted) / reflected).clamp(0.1, 1e3);
            for i in 0..n {
                // All that arrives is to grow by the factor; lamps' own light cannot.
                self.indirect[i][c] += (factor - 1.0) * self.irradiance(i)[c];
                let light = self.reflectance[i][c] * self.irradiance(i)[c];
                self.radiosity[i][c] = self.emission[i][c] + light;
            }
        }
        Ok(())
    }

    /// What arrives at patch `i`, as far as is known.
    fn irradiance(&self, i: usize) -> [f64; C] {
        let [direct, _] = self.sweeper.irradiance(i, &self.whole[i], 1.0);
        std::array::from_fn(|c| (direct[c] + self.indirect[i][c]).max(0.0))
    }

    fn finish(
        self,
        batches: &[Batches<C>],
        escaped: &[[f64; BATCHES]; C],
        counted: f64,
        [sweeps, rays]: [u32; 2],
    ) -> StochasticSolution {
        let (n, areas) = (batches.len(), self.sweeper.areas());
        let many = BATCHES as f64;
        let correlated = correlation(batches, areas);
        let error = |values: &[f64; BATCHES]| {
            let mean = values.iter().sum::<f64>() / many;
            let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
            correlated * (squares / (many * (many - 1.0))).sqrt()
        };
        // Ratios of whole sums, which are less biased than those of batches.
        let irradiance: Vec<[f64; C]> = (0..n)
            .map(|i| {
                let [direct, indirect] = self.sweeper.irradiance(i, &self.whole[i], counted);
                std::array::from_fn(|c| direct[c] + indirect[c])
            })
            .collect();
        let of_channel = |value: &dyn Fn(usize) -> f64| (0..C).map(value).collect::<Vec<f64>>();
        let emitted = of_channel(&|c| ordered_sum(n, |i| areas[i] * self.emission[i][c]));
        let absorbed_in = |c: usize, k: usize| {
            ordered_sum(n, |i| areas[i] * (1.0 - self.reflectance[i][c]) * f64::from(batches[i][c][k]))
        };
        let imbalances: Vec<[f64; BATCHES]> =
            (0..C).map(|c| std::array::from_fn(|k| emitted[c] - absorbed_in(c, k) - escaped[c][k])).collect();
        let absorbed =
            of_channel(&|c| ordered_sum(n, |i| areas[i] * (1.0 - self.reflectance[i][c]) * irradiance[i][c]));
        let left = of_channel(&|c| escaped[c].iter().sum::<f64>() / many);
        let relative = |c: usize, power: f64| if emitted[c] > 0.0 { power / emitted[c] } else { 0.0 };
        let radiosity = irradiance.iter().zip(self.emission).zip(self.reflectance);
        StochasticSolution {
            channels: C,
            radiosity: radiosity.flat_map(|((e, be), rho)| (0..C).map(|c| be[c] + rho[c] * e[c])).collect(),
            standard_error: batches.iter().flatten().map(|b| error(&b.map(f64::from))).collect(),
            irradiance: irradiance.into_flattened(),
            sweeps,
            rays,
            imbalance: of_channel(&|c| relative(c, emitted[c] - absorbed[c] - left[c])),
            absorbed,
            escaped: left,
            imbalance_error: of_channel(&|c| relative(c, error(&imbalances[c]))),
            emitted,
        }
    }
}

/// The standard error of the mean of the batches over what it would be, were they independent.
fn correlation<const C: usize>(batches: &[Batches<C>], areas: &[f64]) -> f64 {
    let (mut own, mut next) = (0.0, 0.0);
    for (batches, area) in batches.iter().zip(areas) {
        for values in batches {
            let mean = values.iter().map(|&v| f64::from(v)).sum::<f64>() / BATCHES as f64;
            let d = values.map(|v| f64::from(v) - mean);
            own += area * d.iter().map(|d| d * d).sum::<f64>() / (BATCHES - 1) as f64;
            next += area * d.windows(2).map(|d| d[0] * d[1]).sum::<f64>() / (BATCHES - 1) as f64;
        }
    }
    if !(own > 0.0) {
        return 1.0;
    }
    // Deviations from their own mean are correlated by -1 / K.
    let lag = (next / own + 1.0 / BATCHES as f64).min(0.9);
    // As of a chain whose correlation falls geometrically.
    ((1.0 + lag) / (1.0 - lag)).max(0.1).sqrt()
}
