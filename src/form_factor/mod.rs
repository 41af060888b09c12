//! Form factors F_ij: the share of the light leaving patch i that arrives at patch j.
//!
//! Rays measure them ([`hemisphere`]), both directions of a pair are pooled into one symmetric exchange area
//! S_ij = A_i F_ij ([`reciprocity`]), and a diagonal scaling makes every row sum to one ([`closure`]). [`exact`] holds
//! the closed forms that all of it is tested against. View factors of single surfaces, each accurate by itself, are in
//! [`view_factor`](crate::view_factor).

mod allocation;
mod assembly;
mod blocks;
mod calibration;
mod checkpoint;
pub mod closure;
mod escape;
pub mod exact;
pub mod hemisphere;
pub(crate) mod lamp;
mod product;
pub mod reciprocity;
pub(crate) mod replicates;
mod shadow;
pub(crate) mod siblings;
pub(crate) mod stratification;
pub mod sweep;
mod symmetric;

use std::{borrow::Cow, ops::Range, sync::Arc};

use rayon::prelude::*;
use sprs::CsMatI;

use crate::{Progress, Result, patch::Patches, scene::Scene, trace::Tracer};
use assembly::Assembled;
use checkpoint::Section;
use hemisphere::Hits;
use replicates::Samples;
use shadow::Sources;
pub(crate) use shadow::{is_hidden, kernel};
pub(crate) use symmetric::Real;
use symmetric::Symmetric;

pub use checkpoint::Checkpoint;

/// Sparse matrix row by row, with 8 bytes a non-zero: single-precision values (their sums run in double), 32-bit columns. To
/// hand form factors over with, and for solvers that need whole rows.
pub type Matrix = CsMatI<f32, u32, usize>;

/// What a form factor may exceed 1 by: rows are closed to about as much.
const ROUNDING: f64 = 1e-12;

/// How hits become form factors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Estimator {
    /// F_ij = hits / rays, each direction by itself: the baseline. Neither reciprocal nor, therefore, conserving energy
    /// in a gathered solution.
    OneWay,
    /// Both directions pooled, then closed: reciprocal, rows sum to one, energy is conserved to rounding.
    #[default]
    Pooled,
}

/// What to cast.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct CastOptions {
    /// Mean number of rays a patch.
    pub rays: f64,
    /// How hits become form factors.
    pub estimator: Estimator,
    /// The same seed gives the same bytes, whatever the number of threads.
    pub seed: u64,
    /// Share of the rays that are shadow rays to emitters; the rest are hemisphere rays. Only for the pooled estimator.
    pub shadow_share: f64,
    /// Whether half of the rays are cast evenly, and the other half where those say that they lower the error of
    /// irradiance most; else all evenly. Only for the pooled estimator.
    pub by_variance: bool,
}

setters!(CastOptions {
    with_rays(rays: f64),
    with_estimator(estimator: Estimator),
    with_seed(seed: u64),
    with_shadow_share(shadow_share: f64),
    with_by_variance(by_variance: bool),
});

impl Default for CastOptions {
    /// 64 rays a patch, a quarter of them shadow rays, pooled, seed 0.
    fn default() -> Self {
        CastOptions {
            rays: 64.0,
            estimator: Estimator::Pooled,
            seed: 0,
            shadow_share: 0.25,
            by_variance: true,
        }
    }
}

impl CastOptions {
    /// Whether variances decide on a part of the rays.
    fn looks_first(&self) -> bool {
        self.estimator == Estimator::Pooled && self.by_variance
    }
}

/// A figure before and after a repair.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct BeforeAfter {
    /// Before.
    pub before: f64,
    /// After.
    pub after: f64,
}

/// The sparse s of F_ij = left_i s_ij right_j.
#[derive(Debug, Clone)]
enum Stored {
    /// Pooled exchange areas.
    Symmetric(Symmetric),
    /// Hits of one-way form factors.
    Rows(Matrix),
}

/// The form factors of all patches, F_ij = left_i s_ij right_j with a sparse s, and the share of each patch's light
/// that leaves the scene.
#[derive(Debug, Clone)]
pub struct FormFactors {
    stored: Stored,
    left: Vec<f64>,
    right: Vec<f64>,
    escaped: Vec<f64>,
    areas: Vec<f64>,
    estimator: Estimator,
    samples: Option<Samples>,
    row_sum_deviation: BeforeAfter,
    reciprocity_deviation: BeforeAfter,
}

impl FormFactors {
    /// Casts rays from every patch and estimates all form factors. Backs of surfaces that are hit are added to
    /// `patches` and cast rays too.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped) when `progress` says so.
    pub fn cast(
        scene: &Scene,
        tracer: &Tracer,
        patches: &mut Patches,
        options: &CastOptions,
        progress: &Progress,
    ) -> Result<FormFactors> {
        Self::cast_checkpointed(scene, tracer, patches, options, None, progress)
    }

    /// As [`FormFactors::cast`], with a file that takes up what rays meet as they are cast, and from which those are taken that
    /// it holds already. [`FormFactors::cast_more`] goes on with it. The result is the same with a file and without.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped) when `progress` says so, [`Error::Io`](crate::Error::Io) and
    /// [`Error::Input`](crate::Error::Input) when the file cannot be read or written; what it holds stays good.
    ///
    /// # Panics
    /// When the checkpoint is of another seed.
    pub fn cast_checkpointed(
        scene: &Scene,
        tracer: &Tracer,
        patches: &mut Patches,
        options: &CastOptions,
        checkpoint: Option<Arc<Checkpoint>>,
        progress: &Progress,
    ) -> Result<FormFactors> {
        together(|| {
            let sources = match options.estimator {
                // What no shadow ray looks at must be found by hemisphere rays.
                Estimator::Pooled if options.shadow_share > 0.0 => Sources::emitters(tracer, patches),
                _ => Sources::default(),
            };
            let mut hits = Hits::none(sources);
            hits.checkpoint = checkpoint.map(|file| Section::new(file, patches, &hits.sources, options.seed));
            let rays = if options.looks_first() { allocation::PILOT * options.rays } else { options.rays };
            let share = allocation::even(options, rays, !hits.sources.is_empty());
            hits.extend(scene, tracer, patches, share, options.seed, progress)?;
            if options.looks_first() {
                let samples =
                    Assembled::new(hits, tracer, patches, options, Vec::new()).into_samples(patches);
                return Self::continued(samples, scene, tracer, patches, options.rays, progress);
            }
            Ok(Self::from_hits(hits, tracer, patches, options, Vec::new()))
        })
    }

    /// Casts more rays, until there are `rays` a patch in the mean, as the options that the first were cast with say; those
    /// that were cast before are kept.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped) when `progress` says so.
    ///
    /// # Panics
    /// When the form factors were not cast for these patches.
    pub fn cast_more(
        self,
        scene: &Scene,
        tracer: &Tracer,
        patches: &mut Patches,
        rays: f64,
        progress: &Progress,
    ) -> Result<FormFactors> {
        let samples = self.samples.expect("only what was cast can be cast more of");
        assert_eq!(samples.hits.len(), patches.len(), "other patches");
        // Memory for what comes next.
        drop(self.stored);
        together(|| Self::continued(samples, scene, tracer, patches, rays, progress))
    }

    /// Casts more rays where these samples say that they lower the error most.
    fn continued(
        samples: Samples,
        scene: &Scene,
        tracer: &Tracer,
        patches: &mut Patches,
        rays: f64,
        progress: &Progress,
    ) -> Result<FormFactors> {
        let n = samples.hits.len();
        let shares = if samples.options.looks_first() {
            let variances = samples.variances(patches.channels());
            allocation::by_variance(
                &samples.hits,
                &samples.areas,
                &variances,
                &samples.siblings,
                rays * n as f64,
            )
        } else {
            Vec::new()
        };
        let Samples { mut hits, options, radiosity, .. } = samples;
        // Where no variance decides, rounds are to give what casting all at once does.
        let start = if options.looks_first() { radiosity } else { Vec::new() };
        let even = allocation::even(&options, rays, !hits.sources.is_empty());
        let share = |i: usize, kernel: f64| shares.get(i).copied().unwrap_or_else(|| even(i, kernel));
        hits.extend(scene, tracer, patches, share, options.seed, progress)?;
        Ok(Self::from_hits(hits, tracer, patches, &options, start))
    }

    /// Neighbours in the plane: runs of up to 16 patches of one triangle's side, in the order of the patches.
    pub(crate) fn siblings(&self) -> &[Range<usize>] {
        self.samples.as_ref().map_or(&[], |samples| &samples.siblings)
    }

    /// What share of patch `i`'s light is taken to stay there, since no ray told where it goes.
    pub(crate) fn unseen(&self, i: usize) -> f64 {
        match &self.stored {
            Stored::Symmetric(_) => self.get(i, i),
            Stored::Rows(_) => 0.0,
        }
    }

    /// By what share the closure has moved what patch `i` exchanges with others, and what sources do, in the mean.
    pub(crate) fn moved(&self) -> impl Fn(usize) -> f64 + '_ {
        let brightness = self.samples.as_ref().map_or(&[][..], |samples| samples.densities.brightness());
        let power = || brightness.iter().zip(&self.areas).zip(&self.right).filter(|((b, _), _)| **b > 0.0);
        let squares: f64 = power().map(|((b, area), right)| b * area * (right - 1.0).powi(2)).sum();
        let all: f64 = power().map(|((b, area), _)| b * area).sum();
        let of_sources = if all > 0.0 { (squares / all).sqrt() } else { 0.0 };
        move |i| of_sources.hypot(self.right[i] - 1.0)
    }

    /// Whether shadow rays went to patch `i`.
    pub(crate) fn is_source(&self, i: usize) -> bool {
        self.samples.as_ref().is_some_and(|samples| samples.hits.sources.contains(i))
    }

    /// Number of patches.
    pub fn len(&self) -> usize {
        self.areas.len()
    }

    /// Whether there is no patch.
    pub fn is_empty(&self) -> bool {
        self.areas.is_empty()
    }

    /// F_ij. Looks for it in a part of the matrix.
    pub fn get(&self, i: usize, j: usize) -> f64 {
        let s = match &self.stored {
            Stored::Symmetric(matrix) => matrix.get(i, j),
            Stored::Rows(matrix) => matrix.get(i, j).copied().unwrap_or(0.0),
        };
        self.left[i] * f64::from(s) * self.right[j]
    }

    /// The non-zero F_ij of row `i` as (j, F_ij). Collects them from a part of the matrix.
    pub fn row(&self, i: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let entries = match &self.stored {
            Stored::Symmetric(matrix) => matrix.row(i),
            Stored::Rows(matrix) => {
                let (columns, values) = row(matrix, i);
                columns.iter().map(|&j| j as usize).zip(values.iter().copied()).collect()
            }
        };
        entries.into_iter().map(move |(j, s)| (j, self.left[i] * f64::from(s) * self.right[j]))
    }

    /// All rows of the s in F_ij = left_i s_ij right_j, compressed: pooled form factors take twice their memory so.
    pub(crate) fn rows(&self) -> Cow<'_, Matrix> {
        match &self.stored {
            Stored::Symmetric(matrix) => Cow::Owned(matrix.rows()),
            Stored::Rows(matrix) => Cow::Borrowed(matrix),
        }
    }

    /// Area of each patch; at least 10⁻²⁰ of their mean.
    pub fn areas(&self) -> &[f64] {
        &self.areas
    }

    /// Puts areas in another unit; form factors stay.
    pub(crate) fn scale_areas(&mut self, unit: f64) {
        self.areas.iter_mut().for_each(|area| *area *= unit);
    }

    /// Share of each patch's light that leaves the scene.
    pub fn escaped(&self) -> &[f64] {
        &self.escaped
    }

    /// How hits became form factors.
    pub fn estimator(&self) -> Estimator {
        self.estimator
    }

    /// The radiosity that they were calibrated with, interleaved channels, in a [`magnitude`] of emission: near the solution,
    /// if that has the same emission. Empty where there is none.
    pub(crate) fn expected(&self) -> &[f32] {
        self.samples.as_ref().map_or(&[], |samples| &samples.radiosity)
    }

    /// What every ray met, unless the form factors came from elsewhere.
    pub fn hits(&self) -> Option<&Hits> {
        self.samples.as_ref().map(|samples| &samples.hits)
    }

    /// Rays cast: none where the form factors came from elsewhere.
    pub fn rays(&self) -> u64 {
        self.hits().map_or(0, Hits::rays)
    }

    /// Non-zero form factors.
    pub fn non_zeros(&self) -> usize {
        match &self.stored {
            Stored::Symmetric(matrix) => matrix.non_zeros(),
            Stored::Rows(matrix) => matrix.nnz(),
        }
    }

    /// Bytes of the matrix.
    pub fn matrix_bytes(&self) -> usize {
        match &self.stored {
            Stored::Symmetric(matrix) => matrix.bytes(),
            Stored::Rows(matrix) => 8 * (matrix.nnz() + self.len()),
        }
    }

    /// Bytes held by the matrix, its scaling and the hits.
    pub fn bytes(&self) -> usize {
        self.matrix_bytes() + 8 * 4 * self.len() + self.hits().map_or(0, Hits::bytes)
    }

    /// How many form factors, escaped shares included, are no shares: negative, above one by more than rounding, or not
    /// numbers. None, or there is an error in the program.
    pub fn out_of_range(&self) -> usize {
        let is_share = |x: f64| (0.0..=1.0 + ROUNDING).contains(&x);
        let strays =
            |i: usize, j: usize, s: f32| usize::from(!is_share(self.left[i] * f64::from(s) * self.right[j]));
        let escaped = self.escaped.iter().filter(|&&x| !is_share(x)).count();
        escaped
            + match &self.stored {
                Stored::Symmetric(matrix) => {
                    let both = |(i, j, s): (usize, usize, f32)| strays(i, j, s) + strays(j, i, s);
                    matrix.tiles().map(|tile| tile.map(both).sum::<usize>()).sum::<usize>()
                        + matrix.diagonal().map(|(i, s)| strays(i, i, s)).sum::<usize>()
                }
                Stored::Rows(matrix) => {
                    matrix.iter().map(|(&s, (i, j))| strays(i as usize, j as usize, s)).sum()
                }
            }
    }

    /// Largest |row sum + escaped share - 1|, before and after the closure.
    pub fn row_sum_deviation(&self) -> BeforeAfter {
        self.row_sum_deviation
    }

    /// Largest |A_i F_ij - A_j F_ji| / min(A_i, A_j): before, of the rays as cast; after, of the form factors in use.
    pub fn reciprocity_deviation(&self) -> BeforeAfter {
        self.reciprocity_deviation
    }

    /// The left and right of F_ij = left_i s_ij right_j.
    pub(crate) fn scaling(&self) -> (&[f64], &[f64]) {
        (&self.left, &self.right)
    }
}

/// Patches that are hardly worth a task of their own.
pub(crate) const SHORT: usize = 4096;

/// Does work of many short parallel parts on one of rayon's threads: from outside of these, each part would wake one and wait.
/// A thousand patches take a twelfth less time.
pub(crate) fn together<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    rayon::scope(|_| work())
}

/// The sum of a value a patch: of each run of patches by itself, then of the runs, whatever the number of threads.
pub(crate) fn ordered_sum<T: Copy + Send + std::iter::Sum<T>>(
    len: usize,
    value: impl Fn(usize) -> T + Sync,
) -> T {
    let run = |k: usize| (k * SHORT..((k + 1) * SHORT).min(len)).map(&value).sum();
    let runs: Vec<T> = (0..len.div_ceil(SHORT)).into_par_iter().map(run).collect();
    runs.into_iter().sum()
}

/// The power of two next below the largest size, or 1 where there is none: dividing by it costs no rounding, and brings
/// squares and single precision into range, however bright or dark a scene is.
pub(crate) fn magnitude(values: &[f64]) -> f64 {
    let largest = values.iter().copied().map(f64::abs).fold(0.0, f64::max);
    // Not below what has an inverse.
    if largest > 0.0 { 2f64.powi(largest.log2().floor().clamp(-1000.0, 1000.0) as i32) } else { 1.0 }
}

/// Columns and values of a row.
pub(crate) fn row(matrix: &Matrix, i: usize) -> (&[u32], &[f32]) {
    let range = matrix.indptr().outer_inds_sz(i);
    (&matrix.indices()[range.clone()], &matrix.data()[range])
}
