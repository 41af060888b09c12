//! Form factors F_ij: the share of the light leaving patch i that arrives at patch j.
//!
//! Rays measure them ([`hemisphere`]), both directions of a pair are pooled into one symmetric exchange area
//! S_ij = A_i F_ij ([`reciprocity`]), and a diagonal scaling makes every row sum to one ([`closure`]). [`exact`] holds
//! the closed forms that all of it is tested against.

mod allocation;
mod calibration;
mod checkpoint;
pub mod closure;
mod escape;
pub mod exact;
pub mod hemisphere;
mod lamp;
pub mod reciprocity;
pub(crate) mod replicates;
mod shadow;

use std::sync::Arc;

use rayon::prelude::*;
use sprs::CsMatI;

use crate::{Progress, Result, patch::Patches, scene::Scene, trace::Tracer};
use checkpoint::Section;
use hemisphere::{Hits, REPLICATES};
use reciprocity::Densities;
use replicates::{Deviation, Samples};
use shadow::Sources;

pub use checkpoint::Checkpoint;

/// Sparse matrix with 8 bytes a non-zero: single-precision values (their sums run in double), 32-bit columns.
pub type Matrix = CsMatI<f32, u32, usize>;

/// Patches smaller than this share of the mean patch count as that large: exchange areas would leave the range of single
/// precision otherwise, and what that adds to the energy does not show in double precision.
const LEAST_AREA: f64 = 1e-20;

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

/// The form factors of all patches, F_ij = left_i s_ij right_j with a sparse s, and the share of each patch's light
/// that leaves the scene.
#[derive(Debug, Clone)]
pub struct FormFactors {
    matrix: Matrix,
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
        let form_factors = Self::from_hits(hits, tracer, patches, options);
        if options.looks_first() {
            return form_factors.cast_more(scene, tracer, patches, options.rays, progress);
        }
        Ok(form_factors)
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
        let n = samples.hits.len();
        assert_eq!(n, patches.len(), "other patches");
        let shares = if samples.options.looks_first() {
            let variances = samples.variances(patches.channels());
            allocation::by_variance(&samples.hits, &samples.areas, &variances, rays * n as f64)
        } else {
            Vec::new()
        };
        let Samples { mut hits, options, .. } = samples;
        let even = allocation::even(&options, rays, !hits.sources.is_empty());
        let share = |i: usize, kernel: f64| shares.get(i).copied().unwrap_or_else(|| even(i, kernel));
        hits.extend(scene, tracer, patches, share, options.seed, progress)?;
        Ok(Self::from_hits(hits, tracer, patches, &options))
    }

    fn from_hits(mut hits: Hits, tracer: &Tracer, patches: &Patches, options: &CastOptions) -> FormFactors {
        let mut areas: Vec<f64> = (0..patches.len()).map(|i| patches.area(i)).collect();
        let (n, scale, options, estimator) = (areas.len(), tracer.scale(), *options, options.estimator);
        // In units of the mean area no exchange area leaves the range of single precision.
        let mean = areas.iter().sum::<f64>() / n as f64;
        areas.iter_mut().for_each(|a| *a = a.max(LEAST_AREA * mean));
        let relative: Vec<f64> = areas.iter().map(|a| a / mean).collect();
        if estimator == Estimator::Pooled {
            hits.withdraw_hidden(&relative);
        }
        let densities = Densities::new(&hits, &relative, scale * (scale / mean));
        let own = reciprocity::count(&hits, &densities);
        let one_way = reciprocity::one_way_deviation(&own, &hits, &areas);
        let escaped: Vec<f64> = (0..n).map(|i| own.escaped(i) / f64::from(hits.rays_of(i))).collect();
        let form_factors = match estimator {
            Estimator::OneWay => FormFactors {
                left: (0..n).map(|i| 1.0 / f64::from(hits.rays_of(i))).collect(),
                right: vec![1.0; n],
                matrix: own.into_matrix(),
                escaped,
                areas,
                estimator,
                samples: Some(Samples {
                    hits,
                    densities,
                    escapes: Vec::new(),
                    areas: relative,
                    radiosity: Vec::new(),
                    siblings: patches.families(2).collect(),
                    options,
                }),
                row_sum_deviation: BeforeAfter::default(),
                reciprocity_deviation: BeforeAfter { before: one_way, after: one_way },
            },
            Estimator::Pooled => {
                let mut matrix = reciprocity::pool(own, &hits, &densities);
                let before = closure::row_sum_deviation(&matrix, &relative, &escaped);
                let escapes = escape::refine(&escaped, &matrix, &hits, &densities, &relative);
                let escaped: Vec<f64> = escapes.iter().map(|e| e.share).collect();
                let radiosity =
                    calibration::calibrate(&mut matrix, &hits, &densities, &relative, &escaped, patches);
                let mut form_factors =
                    Self::closed(matrix, relative.clone(), escaped, |i| 0.5 / f64::from(hits.rays_of(i)));
                form_factors.areas = areas;
                form_factors.samples = Some(Samples {
                    hits,
                    densities,
                    escapes,
                    areas: relative,
                    radiosity,
                    siblings: patches.families(2).collect(),
                    options,
                });
                form_factors.row_sum_deviation.before = before;
                form_factors.reciprocity_deviation.before = one_way;
                form_factors
            }
        };
        debug_assert_eq!(form_factors.out_of_range(), 0, "form factors are shares");
        form_factors
    }

    /// Form factors from a symmetric matrix of exchange areas A_i F_ij, in any one unit of area, the patches' areas in
    /// the same unit, and the share of each patch's light that leaves the scene. Closes the rows.
    ///
    /// # Panics
    /// When the sizes disagree.
    pub fn from_exchange(matrix: Matrix, areas: Vec<f64>, escaped: Vec<f64>) -> FormFactors {
        Self::closed(matrix, areas, escaped, |_| 0.0)
    }

    fn closed(
        matrix: Matrix,
        areas: Vec<f64>,
        escaped: Vec<f64>,
        spare: impl Fn(usize) -> f64,
    ) -> FormFactors {
        let n = areas.len();
        assert_eq!((matrix.rows(), matrix.cols(), escaped.len()), (n, n, n), "sizes disagree");
        let closed = closure::close(&matrix, &areas, &escaped, spare);
        let mut form_factors = FormFactors {
            left: closed.scale.iter().zip(&areas).map(|(d, a)| d / a).collect(),
            escaped: closed.scale.iter().zip(&closed.escaped).map(|(d, e)| d * e).collect(),
            right: closed.scale,
            matrix,
            areas,
            estimator: Estimator::Pooled,
            samples: None,
            row_sum_deviation: BeforeAfter { before: closed.deviation_before, after: 0.0 },
            reciprocity_deviation: BeforeAfter::default(),
        };
        form_factors.row_sum_deviation.after =
            closure::deviation(&form_factors.row_sums(), &form_factors.escaped);
        let after = form_factors.measure_reciprocity();
        form_factors.reciprocity_deviation = BeforeAfter { before: after, after };
        form_factors
    }

    /// The form factors of patches that are put together, a run of them each. Nothing tells how they were sampled.
    ///
    /// # Panics
    /// When the sizes disagree.
    pub(crate) fn merged(&self, families: &[std::ops::Range<usize>]) -> FormFactors {
        let mut parents = Vec::with_capacity(self.len());
        for (p, family) in families.iter().enumerate() {
            parents.extend(family.clone().map(|_| p as u32));
        }
        assert_eq!(parents.len(), self.len(), "one parent a patch is wanted");
        let areas: Vec<f64> = families.iter().map(|f| self.areas[f.clone()].iter().sum()).collect();
        let lost =
            |f: &std::ops::Range<usize>| f.clone().map(|i| self.areas[i] * self.escaped[i]).sum::<f64>();
        let escaped = families.iter().zip(&areas).map(|(f, area)| lost(f) / area).collect();
        let (count, mean) = (families.len(), areas.iter().sum::<f64>() / families.len() as f64);
        let parents = &parents;
        let rows: Vec<Vec<(u32, f64)>> = families
            .par_iter()
            .with_min_len(64)
            .map(|family| {
                let entry = |i: usize| self.row(i).map(move |(j, f)| (parents[j], self.areas[i] * f / mean));
                let mut entries: Vec<(u32, f64)> = family.clone().flat_map(entry).collect();
                entries.sort_by_key(|&(j, _)| j);
                entries.chunk_by(|a, b| a.0 == b.0).map(|e| (e[0].0, e.iter().map(|e| e.1).sum())).collect()
            })
            .collect();
        let mut starts = vec![0];
        rows.iter().for_each(|row| starts.push(starts[starts.len() - 1] + row.len()));
        let (columns, values) = rows.into_iter().flatten().map(|(j, s)| (j, s as f32)).unzip();
        let matrix = Matrix::new((count, count), starts, columns, values);
        let mut merged = Self::from_exchange(matrix, areas.iter().map(|a| a / mean).collect(), escaped);
        merged.areas = areas;
        merged.estimator = self.estimator;
        merged
    }

    /// The form factors from the first or second half of every patch's rays; `None` when they are too few or unknown.
    pub(crate) fn half(&self, half: usize, tracer: &Tracer, patches: &Patches) -> Option<FormFactors> {
        let samples = self.samples.as_ref()?;
        let hits = samples.hits.half(half)?;
        Some(Self::from_hits(hits, tracer, patches, &samples.options))
    }

    /// Neighbours in the plane: runs of up to 16 patches of one triangle's side, in the order of the patches.
    pub(crate) fn siblings(&self) -> &[std::ops::Range<usize>] {
        self.samples.as_ref().map_or(&[], |samples| &samples.siblings)
    }

    /// Number of patches.
    pub fn len(&self) -> usize {
        self.areas.len()
    }

    /// Whether there is no patch.
    pub fn is_empty(&self) -> bool {
        self.areas.is_empty()
    }

    /// F_ij.
    pub fn get(&self, i: usize, j: usize) -> f64 {
        self.matrix.get(i, j).map_or(0.0, |&s| self.left[i] * f64::from(s) * self.right[j])
    }

    /// The non-zero F_ij of row `i` as (j, F_ij).
    pub fn row(&self, i: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let (columns, values) = row(&self.matrix, i);
        columns.iter().zip(values).map(move |(&j, &s)| {
            let j = j as usize;
            (j, self.left[i] * f64::from(s) * self.right[j])
        })
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
        self.matrix.nnz()
    }

    /// Bytes held by the matrix, its scaling and the hits.
    pub fn bytes(&self) -> usize {
        8 * self.matrix.nnz() + 8 * 5 * self.len() + self.hits().map_or(0, Hits::bytes)
    }

    /// How many form factors, escaped shares included, are no shares: negative, above one by more than rounding, or not
    /// numbers. None, or there is an error in the program.
    pub fn out_of_range(&self) -> usize {
        let is_share = |x: f64| (0.0..=1.0 + ROUNDING).contains(&x);
        let of_row = |i: usize| {
            let here = usize::from(!is_share(self.escaped[i]));
            here + self.row(i).filter(|&(_, x)| !is_share(x)).count()
        };
        (0..self.len()).into_par_iter().with_min_len(128).map(of_row).sum()
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
        let mut sums = vec![0.0; self.len()];
        gather(&self.matrix, self.right.as_chunks::<1>().0, &mut sums, |i, [sum]| [self.left[i] * sum]);
        sums
    }

    /// Σ_i A_i F_ij for every column j: what the other patches receive of patch j's radiosity.
    pub fn column_sums(&self) -> Vec<f64> {
        let mut sums = vec![0.0; self.len()];
        for i in 0..self.len() {
            let weight = self.areas[i] * self.left[i];
            let (columns, values) = row(&self.matrix, i);
            for (&j, &s) in columns.iter().zip(values) {
                sums[j as usize] += weight * f64::from(s) * self.right[j as usize];
            }
        }
        sums
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
        let scaled: Vec<[f64; C]> = radiosity
            .as_chunks::<C>()
            .0
            .iter()
            .zip(&self.right)
            .map(|(b, right)| b.map(|b| b * right))
            .collect();
        gather(&self.matrix, &scaled, irradiance, |i, sums| sums.map(|sum| self.left[i] * sum));
    }

    /// F z for a value a replicate and channel, in single precision: for error bars.
    pub(crate) fn gather_replicates<const C: usize>(&self, z: &[Deviation<C>]) -> Vec<Deviation<C>> {
        let of_row = |i: usize| {
            let mut sums = [[0f32; REPLICATES]; C];
            let (columns, values) = row(&self.matrix, i);
            for (&j, &s) in columns.iter().zip(values) {
                let j = j as usize;
                let factor = (self.left[i] * f64::from(s) * self.right[j]) as f32;
                for (sums, z) in sums.iter_mut().zip(&z[j]) {
                    for (sum, z) in sums.iter_mut().zip(z) {
                        *sum += factor * z;
                    }
                }
            }
            sums
        };
        (0..self.len()).into_par_iter().with_min_len(128).map(of_row).collect()
    }

    /// Largest |A_i F_ij - A_j F_ji| / min(A_i, A_j), by visiting every pair.
    fn measure_reciprocity(&self) -> f64 {
        let exchange =
            |i: usize, s: f32, j: usize| self.areas[i] * self.left[i] * f64::from(s) * self.right[j];
        reciprocity::deviation(&self.matrix, &self.areas, exchange)
    }

    /// The exchange area A_i F_ij of the stored value `s`, for solvers that need columns and rows alike.
    pub(crate) fn scaling(&self) -> (&Matrix, &[f64], &[f64]) {
        (&self.matrix, &self.left, &self.right)
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

/// out_i = finish(i, Σ_j s_ij z_j) for `C` interleaved channels.
///
/// sprs's own product is serial; this one reads its slices row by row in parallel, each row summed in order, so that
/// the bytes do not depend on the number of threads.
pub(crate) fn gather<const C: usize>(
    matrix: &Matrix,
    z: &[[f64; C]],
    out: &mut [f64],
    finish: impl Fn(usize, [f64; C]) -> [f64; C] + Sync,
) {
    const ROWS: usize = 128;
    assert_eq!((matrix.cols(), matrix.rows() * C), (z.len(), out.len()), "sizes disagree");
    out.as_chunks_mut::<C>().0.par_chunks_mut(ROWS).enumerate().for_each(|(block, out)| {
        for (k, out) in out.iter_mut().enumerate() {
            let i = block * ROWS + k;
            let (columns, values) = row(matrix, i);
            let mut sums = [0.0; C];
            for (&j, &s) in columns.iter().zip(values) {
                let z = &z[j as usize];
                for c in 0..C {
                    sums[c] += f64::from(s) * z[c];
                }
            }
            *out = finish(i, sums);
        }
    });
}
