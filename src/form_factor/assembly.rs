//! Turns rays into form factors.

use std::sync::Arc;

use rayon::prelude::*;

use super::{
    BeforeAfter, CastOptions, Estimator, FormFactors, Matrix, SHORT, Stored,
    calibration::{self, Measured},
    closure,
    pooling::{self, Buckets, Densities},
    replicates::Samples,
    together,
};
use crate::{
    direct::{ShadowRays, brightness, sky::SkyLight},
    patch::Patches,
    rays::{RaySet, regions::Regions, siblings},
    symmetric::{Symmetric, blocks::Blocks},
    trace::Tracer,
};

/// Patches smaller than this share of the mean area are given that area. Otherwise their exchange areas would leave the
/// range of single precision. The energy this adds is below the rounding of double precision.
const LEAST_AREA: f64 = 1e-20;

/// Precision of rows in form factors that only serve to estimate errors.
const ROUGH: f64 = 1e-4;

impl FormFactors {
    /// Builds form factors from a symmetric matrix of exchange areas A_i F_ij in any unit, the areas of the patches in
    /// the same unit, and the share of each patch's light that leaves the scene. Closes the rows. Reads only the upper
    /// triangle of the matrix.
    ///
    /// # Panics
    /// When the sizes disagree.
    pub fn from_exchange(matrix: Matrix, areas: Vec<f64>, escaped: Vec<f64>) -> FormFactors {
        assert_eq!((matrix.rows(), matrix.cols()), (areas.len(), areas.len()), "sizes disagree");
        Self::closed(Symmetric::from_rows(&matrix), areas, &escaped, closure::EXACT)
    }

    fn closed(mut matrix: Symmetric, areas: Vec<f64>, escaped: &[f64], precision: f64) -> FormFactors {
        assert_eq!((matrix.len(), escaped.len()), (areas.len(), areas.len()), "sizes disagree");
        let closed = closure::close(&mut matrix, &areas, escaped, precision);
        let mut form_factors = FormFactors {
            left: closed.scale.iter().zip(&areas).map(|(d, a)| d / a).collect(),
            escaped: closed.escaping.iter().zip(&areas).map(|(x, a)| x / a).collect(),
            right: closed.scale,
            stored: Arc::new(Stored::Symmetric(matrix)),
            areas,
            estimator: Estimator::Pooled,
            samples: None,
            dark: Vec::new(),
            row_sum_deviation: BeforeAfter { before: closed.deviation_before, after: 0.0 },
            reciprocity_deviation: BeforeAfter::default(),
        };
        // Form factors of low precision only estimate errors and need no report.
        if precision <= closure::EXACT {
            form_factors.row_sum_deviation.after =
                closure::deviation(form_factors.row_sums().into_iter(), &form_factors.escaped);
            let after = form_factors.measure_reciprocity();
            form_factors.reciprocity_deviation = BeforeAfter { before: after, after };
        }
        form_factors
    }

    /// The form factors from the first or second half of every patch's rays. `None` if there are too few rays, or if
    /// the form factors were not cast from rays.
    pub(crate) fn half(&self, half: usize, tracer: &Tracer, patches: &Patches) -> Option<FormFactors> {
        let samples = self.samples.as_ref()?;
        let (rays, shadow) = (samples.rays.half(half)?, samples.shadow.half(half)?);
        let sky = samples.sky.as_ref().map(|sky| sky.half(half));
        let start = samples.radiosity.clone();
        Some(together(|| {
            let assembled = Assembled::new((rays, shadow, sky), tracer, patches, &samples.options, start);
            match samples.options.estimator {
                Estimator::OneWay => assembled.one_way(),
                Estimator::Pooled => assembled.pooled(patches, ROUGH),
            }
        }))
    }

    /// Largest |A_i F_ij - A_j F_ji| / min(A_i, A_j) over all pairs.
    fn measure_reciprocity(&self) -> f64 {
        let Stored::Symmetric(matrix) = &*self.stored else {
            unreachable!("pooled form factors are stored symmetrically")
        };
        let exchange =
            |i: usize, s: f32, j: usize| self.areas[i] * self.left[i] * f64::from(s) * self.right[j];
        let defect = |(i, j, s): (usize, usize, f32)| {
            (exchange(i, s, j) - exchange(j, s, i)).abs() / self.areas[i].min(self.areas[j])
        };
        let of_tiles = matrix.tiles().map(|tile| tile.map(defect).fold(0.0, f64::max));
        matrix.ranks().max(of_tiles.reduce(|| 0.0, f64::max))
    }
}

/// Rays and pooled exchange areas, before calibration and closure.
pub(super) struct Assembled {
    samples: Samples,
    areas: Vec<f64>,
    buckets: Buckets,
    /// Exchange areas.
    pooled: Symmetric,
    row_sum_deviation: f64,
    one_way_deviation: f64,
}

impl Assembled {
    /// `start` is a radiosity without the emission of lamps, from another number of rays, or empty.
    pub(super) fn new(
        (mut rays, mut shadow, mut sky): (RaySet, ShadowRays, Option<SkyLight>),
        tracer: &Tracer,
        patches: &Patches,
        options: &CastOptions,
        start: Vec<f32>,
    ) -> Assembled {
        let mut areas: Vec<f64> = (0..patches.len()).map(|i| patches.area(i)).collect();
        let n = areas.len();
        // In units of the mean area all exchange areas are in the range of single precision.
        let mean = areas.iter().sum::<f64>() / n as f64;
        areas.iter_mut().for_each(|a| *a = a.max(LEAST_AREA * mean));
        let relative: Vec<f64> = areas.iter().map(|a| a / mean).collect();
        if options.estimator == Estimator::Pooled {
            let lamps = &shadow.lamps;
            let known = (|i: usize| lamps.contains(i), |i: usize| lamps.hides(i));
            let withdrawn = rays.withdraw_hidden(&relative, tracer, patches, known);
            shadow.withdraw(withdrawn);
            sky.iter_mut().for_each(|sky| sky.withdraw(withdrawn));
        }
        let densities = Densities::new(&rays, &relative);
        let buckets = Buckets::new(&rays, Blocks::new(n).among(options.ranks));
        let (pooled, one_way_deviation) = pooling::pool(&rays, &buckets, &densities, &relative);
        let sums = pooled.row_sums();
        let escaped = rays.escaped();
        let row_sum_deviation = closure::deviation((0..n).map(|i| sums[i] / relative[i]), &escaped);
        let samples = Samples {
            escaping: if shadow.lamps.is_empty() {
                0.0
            } else {
                brightness::escaping(&rays, patches, &escaped)
            },
            regions: Regions::new(&rays, patches),
            rays,
            shadow,
            sky,
            densities,
            escaped,
            areas: relative,
            radiosity: start,
            siblings: siblings::siblings(tracer, patches),
            options: *options,
        };
        Assembled { samples, areas, buckets, pooled, row_sum_deviation, one_way_deviation }
    }

    /// The form factors by the estimator that the options name.
    pub(super) fn finish(self, patches: &Patches) -> FormFactors {
        let form_factors = match self.samples.options.estimator {
            Estimator::OneWay => self.one_way(),
            Estimator::Pooled => self.pooled(patches, closure::EXACT),
        };
        debug_assert_eq!(form_factors.out_of_range(), 0, "form factors are shares");
        form_factors
    }

    /// Light that each patch sends before form factors carry light, in the unit of emission: its emission unless it is
    /// a lamp, and the reflected direct light.
    fn source(&self, patches: &Patches) -> Vec<f32> {
        match patches.channels() {
            1 => self.source_of::<1>(patches),
            _ => self.source_of::<3>(patches),
        }
    }

    fn source_of<const C: usize>(&self, patches: &Patches) -> Vec<f32> {
        let lamps = &self.samples.shadow.lamps;
        let unit = lamps.magnitude(patches.emission());
        let scaled = |b: &[f64; C]| b.map(|b| b / unit);
        let emission: Vec<[f64; C]> = patches.emission().as_chunks().0.iter().map(scaled).collect();
        let reflectance = patches.reflectance().as_chunks::<C>().0;
        let direct = self.samples.direct(&emission, unit, &[]).irradiance;
        let of_patch = |i: usize| {
            let emitted = if lamps.contains(i) { [0.0; C] } else { emission[i] };
            std::array::from_fn::<f32, C, _>(|c| (emitted[c] + reflectance[i][c] * direct[i][c]) as f32)
        };
        let all: Vec<[f32; C]> =
            (0..emission.len()).into_par_iter().with_min_len(SHORT).map(of_patch).collect();
        all.into_flattened()
    }

    fn measured<'a>(&'a self, source: &'a [f32]) -> Measured<'a> {
        Measured {
            rays: &self.samples.rays,
            densities: &self.samples.densities,
            areas: &self.samples.areas,
            regions: &self.samples.regions,
            escaped: &self.samples.escaped,
            source,
        }
    }

    /// Keeps only the samples that variances need.
    pub(super) fn into_samples(mut self, patches: &Patches) -> Samples {
        let start = std::mem::take(&mut self.samples.radiosity);
        let source = self.source(patches);
        self.samples.radiosity =
            calibration::radiosity(&self.pooled, &self.measured(&source), patches, &start);
        self.samples
    }

    fn pooled(mut self, patches: &Patches, precision: f64) -> FormFactors {
        let mut pooled = std::mem::take(&mut self.pooled);
        let buckets = std::mem::take(&mut self.buckets);
        let source = self.source(patches);
        let radiosity = calibration::calibrate(
            &mut pooled,
            buckets,
            &self.measured(&source),
            patches,
            &self.samples.radiosity,
        );
        let Assembled { mut samples, areas, .. } = self;
        let mut form_factors =
            FormFactors::closed(pooled, samples.areas.clone(), &samples.escaped, precision);
        samples.radiosity = radiosity;
        form_factors.areas = areas;
        form_factors.samples = Some(Arc::new(samples));
        form_factors.row_sum_deviation.before = self.row_sum_deviation;
        form_factors.reciprocity_deviation.before = self.one_way_deviation;
        form_factors
    }

    fn one_way(self) -> FormFactors {
        let Assembled { samples, areas, one_way_deviation: deviation, .. } = self;
        FormFactors {
            left: (0..areas.len()).map(|i| 1.0 / f64::from(samples.rays.rays_of(i))).collect(),
            right: vec![1.0; areas.len()],
            stored: Arc::new(Stored::Rows(pooling::one_way(&samples.rays))),
            escaped: samples.escaped.clone(),
            areas,
            estimator: Estimator::OneWay,
            samples: Some(Arc::new(samples)),
            dark: Vec::new(),
            row_sum_deviation: BeforeAfter::default(),
            reciprocity_deviation: BeforeAfter { before: deviation, after: deviation },
        }
    }
}
