//! The error from treating all surfaces as Lambertian.
//!
//! Path and light tracing run three times with the same random numbers: with the given materials, with Lambertian
//! materials of the same hemispherical albedo, and with the diffuse parts only. The runs are correlated, so their
//! differences have smaller errors than each run.

use std::ops::Range;

use crate::{
    Progress, Result,
    monte_carlo::{
        Effort, Estimate, LightOptions, LightTracer, PathOptions, PathTracer, Region,
        reflection::{SpecularPart, make_lambertian},
    },
    patch::Patches,
    scene::Scene,
    trace::Tracer,
};

/// Options of [`LambertCost::of`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct LambertOptions {
    /// Paths per patch in each run.
    pub paths: u32,
    /// Particles from the emitters in each run.
    pub particles: u64,
    /// Number of independent parts of the paths and particles. Their spread gives the standard errors.
    pub replicates: u32,
    /// Seed of all random numbers.
    pub seed: u64,
}

setters!(LambertOptions {
    with_paths(paths: u32),
    with_particles(particles: u64),
    with_replicates(replicates: u32),
    with_seed(seed: u64),
});

impl Default for LambertOptions {
    fn default() -> Self {
        LambertOptions { paths: 1024, particles: 1 << 20, replicates: 16, seed: 0 }
    }
}

/// The change of irradiance from Lambertian materials to the given ones.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// For each front patch, irradiance with the given materials minus irradiance with Lambertian ones, W/m².
    pub irradiance: Vec<Estimate>,
    /// Area-weighted root mean square of the change, relative to the mean irradiance. The contribution of sampling
    /// noise is removed.
    pub rms_relative: f64,
    /// Standard error of `rms_relative`.
    pub standard_error: f64,
    /// Relative change of the mean irradiance of all channels.
    pub mean_relative: f64,
    /// Standard error of `mean_relative`.
    pub mean_standard_error: f64,
    /// The patch with the largest certain change: the lower limit of the 95 % confidence interval of its |change| is
    /// largest.
    pub worst: usize,
    /// Change of the patch `worst` relative to the mean irradiance, for the channel with the largest certain change.
    pub largest_relative: f64,
    /// Standard error of `largest_relative`.
    pub largest_standard_error: f64,
    /// Change of the absorbed flux, W.
    pub absorbed: Estimate,
    /// Change of the escaped flux, W.
    pub escaped: Estimate,
}

/// The error from treating all surfaces as Lambertian.
#[derive(Debug, Clone, PartialEq)]
pub struct LambertCost {
    /// Number of materials with a specular part.
    pub glossy: usize,
    /// Mean irradiance of all channels with the given materials, W/m².
    pub mean: f64,
    /// Change from Lambertian materials of the same hemispherical albedo.
    pub matched: Change,
    /// Change from the diffuse parts only.
    pub dropped: Change,
}

/// The results with one set of materials.
struct Runs {
    /// Irradiance of each replicate, patch by patch.
    irradiance: Vec<[f64; 3]>,
    /// Emitted, absorbed and escaped flux of each batch.
    books: Vec<[[f64; 3]; 3]>,
}

impl LambertCost {
    /// Follows light through the scene with the given and with Lambertian materials, and compares the front patches.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped); [`Error::NoEquilibrium`](crate::Error::NoEquilibrium).
    ///
    /// # Panics
    /// With fewer than two replicates.
    pub fn of(
        scene: &Scene,
        tracer: &Tracer,
        patches: &Patches,
        options: &LambertOptions,
        progress: &Progress,
    ) -> Result<LambertCost> {
        let given = Runs::of(scene, tracer, patches, options, progress)?;
        let against = |part| -> Result<Change> {
            let mut flat = scene.clone();
            make_lambertian(&mut flat, part);
            let flat = Runs::of(&flat, tracer, patches, options, progress)?;
            Ok(Change::between(&given, &flat, patches, options.replicates as usize))
        };
        Ok(LambertCost {
            glossy: scene.materials.iter().filter(|m| m.specular.is_some()).count(),
            mean: given.mean(patches, options.replicates as usize),
            matched: against(SpecularPart::Diffuse)?,
            dropped: against(SpecularPart::Drop)?,
        })
    }
}

impl Runs {
    fn of(
        scene: &Scene,
        tracer: &Tracer,
        patches: &Patches,
        options: &LambertOptions,
        progress: &Progress,
    ) -> Result<Runs> {
        let regions: Vec<Region> = (0..patches.fronts())
            .map(|i| Region {
                triangle: patches.triangle(i),
                part: patches.barycentric_corners(i),
                front: true,
            })
            .collect();
        let LambertOptions { paths, particles, replicates, seed } = *options;
        let effort = Effort { samples: paths, replicates, seed };
        let irradiance = PathTracer::new(scene, tracer, PathOptions::default())
            .in_step()
            .replicates_of_irradiance(&regions, &effort, progress)?;
        let light = LightOptions { particles, batches: replicates, seed, ..LightOptions::default() };
        let books = LightTracer::new(scene, tracer, light).in_step().books(progress)?;
        Ok(Runs { irradiance, books })
    }

    /// Mean irradiance of all patches and channels.
    fn mean(&self, patches: &Patches, replicates: usize) -> f64 {
        let fronts = 0..patches.fronts();
        let sum: f64 = fronts
            .clone()
            .map(|i| {
                let all = self.irradiance[i * replicates..][..replicates].iter().flatten();
                patches.area(i) * all.sum::<f64>() / (3 * replicates) as f64
            })
            .sum();
        sum / total_area(patches, fronts)
    }
}

fn total_area(patches: &Patches, fronts: Range<usize>) -> f64 {
    fronts.map(|i| patches.area(i)).sum()
}

impl Change {
    fn between(given: &Runs, flat: &Runs, patches: &Patches, replicates: usize) -> Change {
        let fronts = patches.fronts();
        let mean = given.mean(patches, replicates);
        let relative = |x: f64| if mean > 0.0 { x / mean } else { 0.0 };
        let differences: Vec<[f64; 3]> =
            given.irradiance.iter().zip(&flat.irradiance).map(|(a, b)| less(a, b)).collect();
        let irradiance: Vec<Estimate> = differences.chunks(replicates).map(Estimate::of).collect();
        let areas: Vec<f64> = (0..fronts).map(|i| patches.area(i)).collect();
        let total: f64 = areas.iter().sum();

        let mut gram = vec![0.0; replicates * replicates];
        let mut means = vec![0.0; replicates];
        for (of_patch, area) in differences.chunks(replicates).zip(&areas) {
            for (r, a) in of_patch.iter().enumerate() {
                means[r] += area / total * a.iter().sum::<f64>() / 3.0;
                for (s, b) in of_patch.iter().enumerate() {
                    gram[r * replicates + s] += area / total * (0..3).map(|c| a[c] * b[c]).sum::<f64>() / 3.0;
                }
            }
        }
        let (rms, rms_error) = root_mean_square(&gram, replicates);
        let of_mean = Estimate::of(&means.iter().map(|&m| [m; 3]).collect::<Vec<_>>());

        let certain = |i: usize, c: usize| {
            irradiance[i].mean[c].abs() - CONFIDENCE_95 * irradiance[i].standard_error[c]
        };
        let places = (0..fronts).flat_map(|i| (0..3).map(move |c| (i, c)));
        let (worst, channel) =
            places.max_by(|&(i, c), &(j, d)| certain(i, c).total_cmp(&certain(j, d))).unwrap_or((0, 0));
        let largest = irradiance.get(worst).copied().unwrap_or_default();
        let booked = |which: usize| {
            let pairs = given.books.iter().zip(&flat.books);
            Estimate::of(&pairs.map(|(a, b)| less(&a[which], &b[which])).collect::<Vec<_>>())
        };
        Change {
            rms_relative: relative(rms),
            standard_error: relative(rms_error),
            mean_relative: relative(of_mean.mean[0]),
            mean_standard_error: relative(of_mean.standard_error[0]),
            worst,
            largest_relative: relative(largest.mean[channel]),
            largest_standard_error: relative(largest.standard_error[channel]),
            absorbed: booked(1),
            escaped: booked(2),
            irradiance,
        }
    }
}

/// Half width of the 95 % confidence interval of a mean of 16 replicates, in standard errors: Student's t with 15
/// degrees of freedom.
pub const CONFIDENCE_95: f64 = 2.131;

fn less(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    std::array::from_fn(|c| a[c] - b[c])
}

/// Root mean square of the mean of `n` replicates, and its standard error. `gram` holds the scalar products of the
/// replicates.
///
/// The mean product of different replicates is an estimate of the squared mean without the contribution of noise. Its
/// standard error comes from the jackknife (Efron, *The Jackknife, the Bootstrap and Other Resampling Plans*, 1982).
fn root_mean_square(gram: &[f64], n: usize) -> (f64, f64) {
    let row = |r: usize| -> f64 { gram[r * n..][..n].iter().sum::<f64>() - gram[r * n + r] };
    let rows: Vec<f64> = (0..n).map(row).collect();
    let sum: f64 = rows.iter().sum();
    let count = n as f64;
    let square = sum / (count * (count - 1.0));
    if n < 3 {
        return (square.max(0.0).sqrt(), f64::NAN);
    }
    let without: Vec<f64> = rows.iter().map(|r| (sum - 2.0 * r) / ((count - 1.0) * (count - 2.0))).collect();
    let middle = without.iter().sum::<f64>() / count;
    let variance = (count - 1.0) / count * without.iter().map(|w| (w - middle).powi(2)).sum::<f64>();
    let error = variance.sqrt();
    let rms = square.max(0.0).sqrt();
    // The error of the square is propagated by the derivative of the root. Near zero, where the derivative is infinite,
    // the root of the square's error is used.
    (rms, if rms * rms > error { 0.5 * error / rms } else { error.sqrt() })
}
