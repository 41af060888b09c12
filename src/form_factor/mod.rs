//! Form factors F_ij: the share of the light leaving patch i that arrives at patch j.
//!
//! Rays measure them ([`hemisphere`]), both directions of a pair are pooled into one symmetric exchange area
//! S_ij = A_i F_ij ([`reciprocity`]), and a diagonal scaling makes every row sum to one ([`closure`]). [`exact`] holds
//! the closed forms that all of it is tested against. [`between_polygons`] is for who wants view factors, each accurate by
//! itself, and no light.

mod allocation;
pub mod between_polygons;
mod calibration;
mod checkpoint;
pub mod closure;
mod escape;
pub mod exact;
pub mod hemisphere;
pub(crate) mod lamp;
pub mod reciprocity;
pub(crate) mod replicates;
mod shadow;
mod siblings;
pub mod sweep;
mod symmetric;

use std::{borrow::Cow, ops::Range, sync::Arc};

use rayon::prelude::*;
use sprs::CsMatI;

use crate::{Progress, Result, patch::Patches, scene::Scene, trace::Tracer};
use calibration::Measured;
use checkpoint::Section;
use hemisphere::{ESCAPED, Hits, REPLICATES};
use reciprocity::{Buckets, Densities};
use replicates::{Deviation, Samples};
use shadow::Sources;
use symmetric::Symmetric;

pub use checkpoint::Checkpoint;

/// Sparse matrix row by row, with 8 bytes a non-zero: single-precision values (their sums run in double), 32-bit columns. To
/// hand form factors over with, and for solvers that need whole rows.
pub type Matrix = CsMatI<f32, u32, usize>;

/// Patches smaller than this share of the mean patch count as that large: exchange areas would leave the range of single
/// precision otherwise, and what that adds to the energy does not show in double precision.
const LEAST_AREA: f64 = 1e-20;

/// What rows may be off by in form factors that only tell how large an error is.
const ROUGH: f64 = 1e-6;

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
            let samples = Assembled::new(hits, tracer, patches, options).into_samples(patches);
            return Self::continued(samples, scene, tracer, patches, options.rays, progress);
        }
        Ok(Self::from_hits(hits, tracer, patches, options))
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
        Self::continued(samples, scene, tracer, patches, rays, progress)
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
        let Samples { mut hits, options, .. } = samples;
        let even = allocation::even(&options, rays, !hits.sources.is_empty());
        let share = |i: usize, kernel: f64| shares.get(i).copied().unwrap_or_else(|| even(i, kernel));
        hits.extend(scene, tracer, patches, share, options.seed, progress)?;
        Ok(Self::from_hits(hits, tracer, patches, &options))
    }

    fn from_hits(hits: Hits, tracer: &Tracer, patches: &Patches, options: &CastOptions) -> FormFactors {
        let assembled = Assembled::new(hits, tracer, patches, options);
        let form_factors = match options.estimator {
            Estimator::OneWay => assembled.one_way(),
            Estimator::Pooled => assembled.pooled(patches, closure::EXACT),
        };
        debug_assert_eq!(form_factors.out_of_range(), 0, "form factors are shares");
        form_factors
    }

    /// Form factors from a symmetric matrix of exchange areas A_i F_ij, in any one unit of area, the patches' areas in
    /// the same unit, and the share of each patch's light that leaves the scene. Closes the rows. Of the matrix the upper
    /// triangle is read; the lower one is taken to be the same.
    ///
    /// # Panics
    /// When the sizes disagree.
    pub fn from_exchange(matrix: Matrix, areas: Vec<f64>, escaped: Vec<f64>) -> FormFactors {
        assert_eq!((matrix.rows(), matrix.cols()), (areas.len(), areas.len()), "sizes disagree");
        Self::closed(Symmetric::from_rows(&matrix), areas, escaped, |_| 0.0, closure::EXACT)
    }

    fn closed(
        matrix: Symmetric,
        areas: Vec<f64>,
        escaped: Vec<f64>,
        spare: impl Fn(usize) -> f64,
        precision: f64,
    ) -> FormFactors {
        assert_eq!((matrix.len(), escaped.len()), (areas.len(), areas.len()), "sizes disagree");
        let closed = closure::close(&matrix, &areas, &escaped, spare, precision);
        let mut form_factors = FormFactors {
            left: closed.scale.iter().zip(&areas).map(|(d, a)| d / a).collect(),
            escaped: closed.scale.iter().zip(&closed.escaped).map(|(d, e)| d * e).collect(),
            right: closed.scale,
            stored: Stored::Symmetric(matrix),
            areas,
            estimator: Estimator::Pooled,
            samples: None,
            row_sum_deviation: BeforeAfter { before: closed.deviation_before, after: 0.0 },
            reciprocity_deviation: BeforeAfter::default(),
        };
        form_factors.row_sum_deviation.after =
            closure::deviation(form_factors.row_sums().into_iter(), &form_factors.escaped);
        let after = form_factors.measure_reciprocity();
        form_factors.reciprocity_deviation = BeforeAfter { before: after, after };
        form_factors
    }

    /// The form factors of patches that are put together, a run of them each. Nothing tells how they were sampled.
    ///
    /// # Panics
    /// When the sizes disagree.
    pub(crate) fn merged(&self, families: &[Range<usize>]) -> FormFactors {
        let mut parents = Vec::with_capacity(self.len());
        for (p, family) in families.iter().enumerate() {
            parents.extend(family.clone().map(|_| p as u32));
        }
        assert_eq!(parents.len(), self.len(), "one parent a patch is wanted");
        let areas: Vec<f64> = families.iter().map(|f| self.areas[f.clone()].iter().sum()).collect();
        let lost = |f: &Range<usize>| f.clone().map(|i| self.areas[i] * self.escaped[i]).sum::<f64>();
        let escaped = families.iter().zip(&areas).map(|(f, area)| lost(f) / area).collect();
        let mean = areas.iter().sum::<f64>() / families.len() as f64;
        let entry = |i: usize, j: usize, s: f32| {
            let exchange = self.areas[i] * self.left[i] * f64::from(s) * self.right[j] / mean;
            // Within a family both directions fall together.
            let both = if parents[i] == parents[j] && i != j { 2.0 } else { 1.0 };
            (parents[i], parents[j], (both * exchange) as f32)
        };
        let lists: Vec<Vec<(u32, u32, f32)>> = match &self.stored {
            Stored::Symmetric(matrix) => {
                let on_diagonal = matrix.diagonal().map(|(i, s)| entry(i, i, s)).collect();
                let mut lists: Vec<Vec<_>> =
                    matrix.tiles().map(|tile| tile.map(|(i, j, s)| entry(i, j, s)).collect()).collect();
                lists.push(on_diagonal);
                lists
            }
            // Not reciprocal: what lies above the diagonal stands for both.
            Stored::Rows(matrix) => vec![
                matrix
                    .iter()
                    .filter(|&(_, (i, j))| i <= j)
                    .map(|(&s, (i, j))| entry(i as usize, j as usize, s))
                    .collect(),
            ],
        };
        let matrix = Symmetric::from_lists(families.len(), &lists);
        let relative = areas.iter().map(|a| a / mean).collect();
        let mut merged = Self::closed(matrix, relative, escaped, |_| 0.0, ROUGH);
        merged.areas = areas;
        merged.estimator = self.estimator;
        merged
    }

    /// The form factors from the first or second half of every patch's rays; `None` when they are too few or unknown.
    pub(crate) fn half(&self, half: usize, tracer: &Tracer, patches: &Patches) -> Option<FormFactors> {
        let samples = self.samples.as_ref()?;
        let hits = samples.hits.half(half)?;
        let assembled = Assembled::new(hits, tracer, patches, &samples.options);
        Some(match samples.options.estimator {
            Estimator::OneWay => assembled.one_way(),
            Estimator::Pooled => assembled.pooled(patches, ROUGH),
        })
    }

    /// Neighbours in the plane: runs of up to 16 patches of one triangle's side, in the order of the patches.
    pub(crate) fn siblings(&self) -> &[Range<usize>] {
        self.samples.as_ref().map_or(&[], |samples| &samples.siblings)
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

    /// Share of each patch's light that leaves the scene.
    pub fn escaped(&self) -> &[f64] {
        &self.escaped
    }

    /// How hits became form factors.
    pub fn estimator(&self) -> Estimator {
        self.estimator
    }

    /// What every ray met, unless the form factors came from elsewhere.
    pub fn hits(&self) -> Option<&Hits> {
        self.samples.as_ref().map(|samples| &samples.hits)
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

    /// Sum over j of F_ij for every row.
    pub fn row_sums(&self) -> Vec<f64> {
        self.irradiance(&vec![1.0; self.len()], 1)
    }

    /// Σ_i A_i F_ij for every column j: what the other patches receive of patch j's radiosity.
    pub fn column_sums(&self) -> Vec<f64> {
        let weight = |i: usize| self.areas[i] * self.left[i];
        let mut sums = vec![[0.0]; self.len()];
        match &self.stored {
            Stored::Symmetric(matrix) => {
                let weights: Vec<[f64; 1]> = (0..self.len()).map(|i| [weight(i)]).collect();
                matrix.add_product(&weights, &mut sums);
            }
            Stored::Rows(matrix) => {
                for (&s, (i, j)) in matrix {
                    sums[j as usize][0] += weight(i as usize) * f64::from(s);
                }
            }
        }
        sums.iter().zip(&self.right).map(|([sum], right)| sum * right).collect()
    }

    /// Irradiance E_i = Σ_j F_ij B_j of every patch, from `channels` (1 or 3) interleaved values of radiosity.
    ///
    /// # Panics
    /// When the length of `radiosity` is not `channels` a patch.
    pub fn irradiance(&self, radiosity: &[f64], channels: usize) -> Vec<f64> {
        let mut irradiance = vec![0.0; radiosity.len()];
        match channels {
            1 => self.irradiance_into::<1>(radiosity, &mut irradiance),
            3 => self.irradiance_into::<3>(radiosity, &mut irradiance),
            _ => panic!("{channels} channels: there are 1 or 3"),
        }
        irradiance
    }

    /// As [`FormFactors::irradiance`], for `C` channels, into a vector at hand.
    pub(crate) fn irradiance_into<const C: usize>(&self, radiosity: &[f64], irradiance: &mut [f64]) {
        assert_eq!(radiosity.len(), C * self.len(), "one value a patch and channel is wanted");
        let mut scaled = radiosity.as_chunks::<C>().0.to_vec();
        scaled.par_iter_mut().zip(&self.right).with_min_len(SHORT).for_each(|(b, right)| {
            b.iter_mut().for_each(|b| *b *= right);
        });
        let out = irradiance.as_chunks_mut::<C>().0;
        match &self.stored {
            Stored::Symmetric(matrix) => {
                out.fill([0.0; C]);
                matrix.add_product(&scaled, out);
            }
            Stored::Rows(matrix) => gather(matrix, &scaled, out),
        }
        out.par_iter_mut().zip(&self.left).with_min_len(SHORT).for_each(|(e, left)| {
            e.iter_mut().for_each(|e| *e *= left);
        });
    }

    /// F z for a value a replicate and channel, in single precision: for error bars.
    pub(crate) fn gather_replicates<const C: usize>(&self, z: &[Deviation<C>]) -> Vec<Deviation<C>> {
        let scaled = |z: &Deviation<C>, factor: f64| z.map(|z| z.map(|z| z * factor as f32));
        let add = |to: &mut Deviation<C>, factor: f32, z: &Deviation<C>| {
            for (to, z) in to.as_flattened_mut().iter_mut().zip(z.as_flattened()) {
                *to += factor * z;
            }
        };
        let z: Vec<Deviation<C>> =
            z.par_iter().zip(&self.right).with_min_len(SHORT).map(|(z, right)| scaled(z, *right)).collect();
        let mut sums = vec![[[0f32; REPLICATES]; C]; self.len()];
        match &self.stored {
            Stored::Symmetric(matrix) => {
                matrix.diagonal().for_each(|(i, s)| add(&mut sums[i], s, &z[i]));
                matrix.accumulate(&z, &mut sums, |s, z_i, z_j, at_i, at_j| {
                    add(at_i, s, z_j);
                    add(at_j, s, z_i);
                });
            }
            Stored::Rows(matrix) => sums.par_iter_mut().enumerate().with_min_len(128).for_each(|(i, sum)| {
                let (columns, values) = row(matrix, i);
                columns.iter().zip(values).for_each(|(&j, &s)| add(sum, s, &z[j as usize]));
            }),
        }
        let ends = sums.par_iter_mut().zip(&self.left).with_min_len(SHORT);
        ends.for_each(|(sum, left)| *sum = scaled(sum, *left));
        sums
    }

    /// Largest |A_i F_ij - A_j F_ji| / min(A_i, A_j), by visiting every pair.
    fn measure_reciprocity(&self) -> f64 {
        let Stored::Symmetric(matrix) = &self.stored else { unreachable!("only of pooled form factors") };
        let exchange =
            |i: usize, s: f32, j: usize| self.areas[i] * self.left[i] * f64::from(s) * self.right[j];
        let defect = |(i, j, s): (usize, usize, f32)| {
            (exchange(i, s, j) - exchange(j, s, i)).abs() / self.areas[i].min(self.areas[j])
        };
        matrix.tiles().map(|tile| tile.map(defect).fold(0.0, f64::max)).reduce(|| 0.0, f64::max)
    }

    /// The left and right of F_ij = left_i s_ij right_j.
    pub(crate) fn scaling(&self) -> (&[f64], &[f64]) {
        (&self.left, &self.right)
    }
}

/// Patches that are hardly worth a task of their own.
pub(crate) const SHORT: usize = 4096;

/// The sum of a value a patch: of each run of patches by itself, then of the runs, whatever the number of threads.
pub(crate) fn ordered_sum<T: Copy + Send + std::iter::Sum<T>>(
    len: usize,
    value: impl Fn(usize) -> T + Sync,
) -> T {
    let run = |k: usize| (k * SHORT..((k + 1) * SHORT).min(len)).map(&value).sum();
    let runs: Vec<T> = (0..len.div_ceil(SHORT)).into_par_iter().map(run).collect();
    runs.into_iter().sum()
}

/// Hits on their way to form factors.
struct Assembled {
    samples: Samples,
    areas: Vec<f64>,
    buckets: Buckets,
    /// Exchange areas of pairs without a source, and with one.
    plain: Symmetric,
    links: Symmetric,
    /// Sums of the rows of `links`.
    link_sums: Vec<f64>,
    /// Shares of each patch's light that leave the scene: of the rays, and refined.
    of_rays: Vec<f64>,
    escaped: Vec<f64>,
    row_sum_deviation: f64,
    one_way_deviation: f64,
}

impl Assembled {
    fn new(mut hits: Hits, tracer: &Tracer, patches: &Patches, options: &CastOptions) -> Assembled {
        let mut areas: Vec<f64> = (0..patches.len()).map(|i| patches.area(i)).collect();
        let (n, scale) = (areas.len(), tracer.scale());
        // In units of the mean area no exchange area leaves the range of single precision.
        let mean = areas.iter().sum::<f64>() / n as f64;
        areas.iter_mut().for_each(|a| *a = a.max(LEAST_AREA * mean));
        let relative: Vec<f64> = areas.iter().map(|a| a / mean).collect();
        if options.estimator == Estimator::Pooled {
            hits.withdraw_hidden(&relative);
        }
        let densities = Densities::new(&hits, &relative, scale * (scale / mean));
        let buckets = Buckets::new(&hits);
        let (plain, one_way_deviation) = reciprocity::pool(&hits, &buckets, &densities, &relative);
        let links = reciprocity::links(&hits, &densities);
        let share = |i: usize| {
            let escaped = hits.of(i).iter().filter(|&&j| j == ESCAPED).count();
            escaped as f64 / f64::from(hits.rays_of(i))
        };
        let of_rays: Vec<f64> = (0..n).into_par_iter().with_min_len(128).map(share).collect();
        let sums = [plain.row_sums(), links.row_sums()];
        let sum = |i: usize| (sums[0][i] + sums[1][i]) / relative[i];
        let row_sum_deviation = closure::deviation((0..n).map(sum), &of_rays);
        let escapes = escape::refine(&of_rays, &sums, &hits, &densities, &relative);
        let [_, link_sums] = sums;
        Assembled {
            escaped: escapes.iter().map(|e| e.share).collect(),
            samples: Samples {
                hits,
                densities,
                escapes,
                areas: relative,
                radiosity: Vec::new(),
                siblings: siblings::siblings(tracer, patches),
                options: *options,
            },
            areas,
            buckets,
            plain,
            links,
            link_sums,
            of_rays,
            row_sum_deviation,
            one_way_deviation,
        }
    }

    fn measured(&self) -> Measured<'_> {
        Measured {
            links: &self.links,
            link_sums: &self.link_sums,
            densities: &self.samples.densities,
            hits: &self.samples.hits,
            areas: &self.samples.areas,
            escaped: &self.escaped,
        }
    }

    /// No more than tells the variances.
    fn into_samples(mut self, patches: &Patches) -> Samples {
        self.samples.radiosity = calibration::radiosity(&self.plain, &self.measured(), patches);
        self.samples
    }

    fn pooled(mut self, patches: &Patches, precision: f64) -> FormFactors {
        let mut plain = std::mem::take(&mut self.plain);
        let buckets = std::mem::take(&mut self.buckets);
        let brightness = self.samples.densities.brightness();
        closure::balance(&mut self.links, brightness, &self.samples.areas, &self.escaped);
        self.link_sums = self.links.row_sums();
        let radiosity = calibration::calibrate(
            &mut plain,
            buckets,
            &self.measured(),
            patches,
            precision > closure::EXACT,
        );
        let Assembled { mut samples, links, link_sums, mut escaped, areas, .. } = self;
        closure::settle(&mut plain, &link_sums, &samples.areas, &mut escaped);
        plain.append(links);
        let spare = |i: usize| 0.5 / f64::from(samples.hits.rays_of(i));
        let mut form_factors = FormFactors::closed(plain, samples.areas.clone(), escaped, spare, precision);
        samples.radiosity = radiosity;
        form_factors.areas = areas;
        form_factors.samples = Some(samples);
        form_factors.row_sum_deviation.before = self.row_sum_deviation;
        form_factors.reciprocity_deviation.before = self.one_way_deviation;
        form_factors
    }

    fn one_way(self) -> FormFactors {
        let Assembled { mut samples, areas, one_way_deviation: deviation, .. } = self;
        samples.escapes = Vec::new();
        FormFactors {
            left: (0..areas.len()).map(|i| 1.0 / f64::from(samples.hits.rays_of(i))).collect(),
            right: vec![1.0; areas.len()],
            stored: Stored::Rows(reciprocity::one_way(&samples.hits)),
            escaped: self.of_rays,
            areas,
            estimator: Estimator::OneWay,
            samples: Some(samples),
            row_sum_deviation: BeforeAfter::default(),
            reciprocity_deviation: BeforeAfter { before: deviation, after: deviation },
        }
    }
}

/// The power of two next below the largest value, or 1 where there is none: dividing by it costs no rounding, and brings
/// squares and single precision into range, however bright or dark a scene is.
pub(crate) fn magnitude(values: &[f64]) -> f64 {
    let largest = values.iter().copied().fold(0.0, f64::max);
    // Not below what has an inverse.
    if largest > 0.0 { 2f64.powi(largest.log2().floor().clamp(-1000.0, 1000.0) as i32) } else { 1.0 }
}

/// Columns and values of a row.
pub(crate) fn row(matrix: &Matrix, i: usize) -> (&[u32], &[f32]) {
    let range = matrix.indptr().outer_inds_sz(i);
    (&matrix.indices()[range.clone()], &matrix.data()[range])
}

/// out_i = Σ_j s_ij z_j for `C` channels.
///
/// sprs's own product is serial; this one reads its slices row by row in parallel, each row summed in order, so that
/// the bytes do not depend on the number of threads.
fn gather<const C: usize>(matrix: &Matrix, z: &[[f64; C]], out: &mut [[f64; C]]) {
    assert_eq!((matrix.cols(), matrix.rows()), (z.len(), out.len()), "sizes disagree");
    out.par_iter_mut().enumerate().with_min_len(128).for_each(|(i, out)| {
        let (columns, values) = row(matrix, i);
        *out = [0.0; C];
        for (&j, &s) in columns.iter().zip(values) {
            for c in 0..C {
                out[c] += f64::from(s) * z[j as usize][c];
            }
        }
    });
}
