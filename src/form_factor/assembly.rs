//! From hits to form factors.

use rayon::prelude::*;

use super::{
    BeforeAfter, CastOptions, Estimator, FormFactors, Matrix, Stored,
    blocks::Blocks,
    calibration::{self, Measured},
    closure, escape,
    hemisphere::{ESCAPED, Hits},
    reciprocity::{self, Buckets, Densities},
    replicates::Samples,
    siblings,
    symmetric::Symmetric,
    together,
};
use crate::{patch::Patches, trace::Tracer};

/// Patches smaller than this share of the mean patch count as that large: exchange areas would leave the range of single
/// precision otherwise, and what that adds to the energy does not show in double precision.
const LEAST_AREA: f64 = 1e-20;

/// What rows may be off by in form factors that only tell how large an error is.
const ROUGH: f64 = 1e-4;

impl FormFactors {
    pub(super) fn from_hits(
        hits: Hits,
        tracer: &Tracer,
        patches: &Patches,
        options: &CastOptions,
        start: Vec<f32>,
    ) -> FormFactors {
        let assembled = Assembled::new(hits, tracer, patches, options, start);
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
        // Nobody asks it of what only tells how large an error is.
        if precision <= closure::EXACT {
            form_factors.row_sum_deviation.after =
                closure::deviation(form_factors.row_sums().into_iter(), &form_factors.escaped);
            let after = form_factors.measure_reciprocity();
            form_factors.reciprocity_deviation = BeforeAfter { before: after, after };
        }
        form_factors
    }

    /// The form factors from the first or second half of every patch's rays; `None` when they are too few or unknown.
    pub(crate) fn half(&self, half: usize, tracer: &Tracer, patches: &Patches) -> Option<FormFactors> {
        let samples = self.samples.as_ref()?;
        let hits = samples.hits.half(half)?;
        let start = samples.radiosity.clone();
        Some(together(|| {
            let assembled = Assembled::new(hits, tracer, patches, &samples.options, start);
            match samples.options.estimator {
                Estimator::OneWay => assembled.one_way(),
                Estimator::Pooled => assembled.pooled(patches, ROUGH),
            }
        }))
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
}

/// Hits on their way to form factors.
pub(super) struct Assembled {
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
    /// `start` is the radiosity that fewer or more rays told, or empty.
    pub(super) fn new(
        mut hits: Hits,
        tracer: &Tracer,
        patches: &Patches,
        options: &CastOptions,
        start: Vec<f32>,
    ) -> Assembled {
        let mut areas: Vec<f64> = (0..patches.len()).map(|i| patches.area(i)).collect();
        let (n, scale) = (areas.len(), tracer.scale());
        // In units of the mean area no exchange area leaves the range of single precision.
        let mean = areas.iter().sum::<f64>() / n as f64;
        areas.iter_mut().for_each(|a| *a = a.max(LEAST_AREA * mean));
        let relative: Vec<f64> = areas.iter().map(|a| a / mean).collect();
        if options.estimator == Estimator::Pooled {
            hits.withdraw_hidden(&relative, tracer, patches);
        }
        let mut densities = Densities::new(&hits, &relative, scale * (scale / mean));
        let buckets = Buckets::new(&hits, Blocks::new(n));
        let (plain, one_way_deviation) = reciprocity::pool(&hits, &buckets, &densities, &relative);
        let links = reciprocity::links(&hits, &mut densities);
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
                radiosity: start,
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
    pub(super) fn into_samples(mut self, patches: &Patches) -> Samples {
        let start = std::mem::take(&mut self.samples.radiosity);
        self.samples.radiosity = calibration::radiosity(&self.plain, &self.measured(), patches, &start);
        self.samples
    }

    fn pooled(mut self, patches: &Patches, precision: f64) -> FormFactors {
        let mut plain = std::mem::take(&mut self.plain);
        let buckets = std::mem::take(&mut self.buckets);
        let brightness = self.samples.densities.brightness();
        let known = self.samples.hits.sources.are_lamps();
        closure::balance(&mut self.links, brightness, &self.samples.areas, &mut self.escaped, known);
        self.link_sums = self.links.row_sums();
        let radiosity =
            calibration::calibrate(&mut plain, buckets, &self.measured(), patches, &self.samples.radiosity);
        let Assembled { mut samples, links, link_sums, mut escaped, areas, .. } = self;
        let is_source = |i: usize| samples.hits.sources.contains(i);
        let missing =
            closure::settle(&mut plain, &link_sums, is_source, &samples.areas, &mut escaped, precision);
        plain.append(links);
        plain.set_diagonal(missing);
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
