//! Form factors F_ij: the share of the light leaving patch i that arrives at patch j.
//!
//! Rays measure them ([`hemisphere`]), both directions of a pair are pooled into one symmetric exchange area
//! S_ij = A_i F_ij ([`reciprocity`]), and a diagonal scaling makes every row sum to one ([`closure`]). [`exact`] holds
//! the closed forms that all of it is tested against.

pub mod closure;
mod escape;
pub mod exact;
pub mod hemisphere;
pub mod reciprocity;
pub(crate) mod replicates;
mod shadow;

use rayon::prelude::*;
use sprs::CsMatI;

use crate::{Progress, Result, patch::Patches, scene::Scene, trace::Tracer};
use closure::Spread;
use hemisphere::{Hits, REPLICATES, Share};
use reciprocity::Densities;
use replicates::Samples;
use shadow::Sources;

/// Sparse matrix with 8 bytes a non-zero: single-precision values (their sums run in double), 32-bit columns.
pub type Matrix = CsMatI<f32, u32, usize>;

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

/// Share of the hemisphere rays that leave the sources, by power. They alone tell how much of the emitted light goes
/// straight out of the scene.
const POWER_SHARE: f64 = 0.2;

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
}

impl Default for CastOptions {
    /// 64 rays a patch, half of them shadow rays, pooled, seed 0.
    fn default() -> Self {
        CastOptions { rays: 64.0, estimator: Estimator::Pooled, seed: 0, shadow_share: 0.5 }
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
        let sources = match options.estimator {
            Estimator::OneWay => Sources::default(),
            Estimator::Pooled => Sources::emitters(patches),
        };
        let shadow_rays = if sources.is_empty() { 0.0 } else { options.rays * options.shadow_share };
        let hemisphere_rays = options.rays - shadow_rays;
        let (power, even) = if sources.is_empty() { (0.0, 1.0) } else { (POWER_SHARE, 1.0 - POWER_SHARE) };
        let fronts = patches.fronts() as f64;
        let probability: Vec<f64> = (0..patches.fronts()).map(|i| sources.probability(i)).collect();
        let per_replicate = |rays: f64| (rays / REPLICATES as f64).round().max(1.0) as u32;
        let share = |i: usize| {
            let by_power = power * fronts * probability.get(i).unwrap_or(&0.0);
            Share {
                hemisphere: per_replicate(hemisphere_rays * (even + by_power)),
                shadow: if shadow_rays > 0.0 { per_replicate(shadow_rays) } else { 0 },
            }
        };
        let hits = hemisphere::cast(scene, tracer, patches, sources, share, options.seed, progress)?;
        let areas: Vec<f64> = (0..patches.len()).map(|i| patches.area(i)).collect();
        Ok(Self::from_hits(hits, areas, tracer.scale(), options.estimator))
    }

    fn from_hits(hits: Hits, areas: Vec<f64>, scale: f64, estimator: Estimator) -> FormFactors {
        let n = areas.len();
        // In units of the mean area no exchange area leaves the range of single precision.
        let mean = areas.iter().sum::<f64>() / n as f64;
        let relative: Vec<f64> = areas.iter().map(|a| a / mean).collect();
        let densities = Densities::new(&hits, &relative, scale * (scale / mean));
        let own = reciprocity::count(&hits, &densities);
        let one_way = reciprocity::one_way_deviation(&own, &hits, &areas);
        let escaped: Vec<f64> = (0..n).map(|i| own.escaped(i) / f64::from(hits.rays_of(i))).collect();
        match estimator {
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
                    spread: Spread::none(n),
                    escapes: Vec::new(),
                    areas: relative,
                }),
                row_sum_deviation: BeforeAfter::default(),
                reciprocity_deviation: BeforeAfter { before: one_way, after: one_way },
            },
            Estimator::Pooled => {
                let mut matrix = reciprocity::pool(own, &hits, &densities);
                let before = closure::row_sum_deviation(&matrix, &relative, &escaped);
                let is_source: Vec<bool> = (0..n).map(|i| hits.sources.probability(i) > 0.0).collect();
                let escapes = escape::refine(&escaped, &matrix, &hits, &densities, &relative);
                let escaped: Vec<f64> = escapes.iter().map(|e| e.share).collect();
                let spread = closure::spread(&mut matrix, &relative, &escaped, &is_source);
                let mut form_factors = Self::from_exchange(matrix, relative.clone(), escaped);
                form_factors.areas = areas;
                form_factors.samples = Some(Samples { hits, densities, spread, escapes, areas: relative });
                form_factors.row_sum_deviation.before = before;
                form_factors.reciprocity_deviation.before = one_way;
                form_factors
            }
        }
    }

    /// Form factors from a symmetric matrix of exchange areas A_i F_ij, in any one unit of area, the patches' areas in
    /// the same unit, and the share of each patch's light that leaves the scene. Closes the rows.
    ///
    /// # Panics
    /// When the sizes disagree.
    pub fn from_exchange(matrix: Matrix, areas: Vec<f64>, escaped: Vec<f64>) -> FormFactors {
        let n = areas.len();
        assert_eq!((matrix.rows(), matrix.cols(), escaped.len()), (n, n, n), "sizes disagree");
        let closed = closure::close(&matrix, &areas, &escaped);
        let mut form_factors = FormFactors {
            left: closed.scale.iter().zip(&areas).map(|(d, a)| d / a).collect(),
            escaped: closed.scale.iter().zip(&escaped).map(|(d, e)| d * e).collect(),
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

    /// Area of each patch.
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

    /// F z for a value a replicate and channel, in single precision: for error bars. Rows that `special` names take
    /// their z from the function instead.
    pub(crate) fn gather_replicates<const C: usize>(
        &self,
        z: &[[[f32; REPLICATES]; C]],
        special: impl Fn(usize) -> bool + Sync,
        z_special: impl Fn(usize) -> [[f32; REPLICATES]; C] + Sync,
    ) -> Vec<[[f32; REPLICATES]; C]> {
        (0..self.len())
            .into_par_iter()
            .with_min_len(128)
            .map(|i| {
                let mut sums = [[0f32; REPLICATES]; C];
                let special = special(i);
                let (columns, values) = row(&self.matrix, i);
                for (&j, &s) in columns.iter().zip(values) {
                    let j = j as usize;
                    let factor = (self.left[i] * f64::from(s) * self.right[j]) as f32;
                    let own;
                    let z = if special {
                        own = z_special(j);
                        &own
                    } else {
                        &z[j]
                    };
                    for (sums, z) in sums.iter_mut().zip(z) {
                        for (sum, z) in sums.iter_mut().zip(z) {
                            *sum += factor * z;
                        }
                    }
                }
                sums
            })
            .collect()
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
