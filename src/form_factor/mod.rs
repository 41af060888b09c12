//! Form factors F_ij: the share of the light leaving patch i that arrives at patch j.
//!
//! [Hemisphere rays](rays) estimate the form factors. `pooling` combines both directions of a pair into one symmetric
//! exchange area S_ij = A_i F_ij. `calibration` fits the exchange areas to the estimates from each patch's own rays.
//! The [`closure`] scales them so that every row sums to one. The direct light of lamps does not use form factors:
//! module `direct` computes it. [`exact`] has the closed forms that test all of this.
//! [`view_factor`](crate::view_factor) computes view factors between single surfaces, each accurate by itself.

mod assembly;
mod calibration;
pub mod closure;
mod compressed;
mod pooling;
mod product;
pub(crate) mod replicates;

use std::{borrow::Cow, ops::Range, sync::Arc};

use rayon::prelude::*;

use crate::{
    Progress, Ranks, Result,
    direct::{Lamps, ShadowRays, brightness, sky::SkyLight},
    patch::Patches,
    rays::{
        RaySet,
        allocation::{self, Share},
        checkpoint::Section,
        regions::Regions,
    },
    scene::Scene,
    symmetric::Symmetric,
    trace::{Tracer, sampling::mix},
};
use assembly::Assembled;
pub(crate) use replicates::Samples;

pub(crate) use crate::{
    direct::DirectLight,
    parallel::{SHORT, magnitude, ordered_sum, together},
    rays::footprint::{is_hidden, kernel},
    symmetric::{Real, row},
};
pub use crate::{
    exact, rays,
    rays::{Checkpoint, Part},
    symmetric::Matrix,
};
pub use compressed::CompressedRows;

/// Allowed excess of a form factor over 1, about the precision of the closure.
const ROUNDING: f64 = 1e-12;

/// How hits become form factors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Estimator {
    /// F_ij = hits / rays, each direction by itself: the baseline. It is not reciprocal. A gathered solution therefore
    /// does not conserve energy.
    OneWay,
    /// Both directions are pooled and the rows closed: reciprocal, rows sum to one, energy is conserved to rounding.
    #[default]
    Pooled,
}

/// Options for casting rays.
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
    /// If true, half of the rays are cast evenly. Their variances decide where the other half lowers the error of
    /// irradiance most, unless there are neither lamps nor a sky. If false, all rays are cast evenly. Only for the pooled
    /// estimator.
    pub by_variance: bool,
    /// The processes that share out the rays and the rows of the matrix. With several, only the pooled estimator stores a
    /// share of the matrix, and single form factors cannot be read.
    pub ranks: Ranks,
}

setters!(CastOptions {
    with_rays(rays: f64),
    with_estimator(estimator: Estimator),
    with_seed(seed: u64),
    with_shadow_share(shadow_share: f64),
    with_by_variance(by_variance: bool),
    with_ranks(ranks: Ranks),
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
            ranks: Ranks::alone(),
        }
    }
}

impl CastOptions {
    /// These options with shadow rays switched on if lights that are not surfaces need them.
    fn for_lights(&self, scene: &Scene) -> CastOptions {
        let needed = scene.lights.need_shadow_rays() && !(self.shadow_share > 0.0);
        CastOptions {
            shadow_share: if needed { CastOptions::default().shadow_share } else { self.shadow_share },
            ..*self
        }
    }

    /// The same number of rays for all patches, with shadow rays if there are lamps.
    fn even(&self, rays: f64, lamps: bool) -> Share {
        allocation::even(rays, if lamps { self.shadow_share } else { 0.0 }, self.looks_first())
    }

    /// Whether variances distribute a part of the rays.
    fn looks_first(&self) -> bool {
        self.estimator == Estimator::Pooled && self.by_variance
    }
}

/// Powers of direct light, one value per channel.
pub(crate) struct DirectPowers {
    /// Power that arrives from lights that are not surfaces.
    pub(crate) entered: Vec<f64>,
    /// Power of lamps that arrives at no patch.
    pub(crate) escaped: Vec<f64>,
    /// Whether lamps lose more power than sampling error explains in a scene from which no ray escapes.
    pub(crate) leaks: bool,
}

/// How far [`FormFactors::cast_only`] came.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CastState {
    /// All rays of all parts are in the files of the checkpoint.
    Whole,
    /// The rays of this part are in its file. Rays of other parts are missing.
    PartCast,
    /// The rays that this part can cast now are in its file. The others depend on rays of other parts that no file holds
    /// yet.
    Waiting,
}

/// What casting rays led to.
enum Sampled {
    Whole(Box<Cast>),
    /// Rays of other parts are missing, in the `last` stage or in an earlier one.
    Lacking {
        last: bool,
    },
}

/// All rays of a scene.
struct Cast {
    set: RaySet,
    shadow: ShadowRays,
    options: CastOptions,
    /// A radiosity from fewer rays, or empty.
    start: Vec<f32>,
}

impl Cast {
    fn assembled(self, tracer: &Tracer, patches: &Patches) -> Assembled {
        let Cast { set, shadow, options, start } = self;
        let sky = SkyLight::of(&set, &shadow.lamps, tracer, patches, options.seed);
        Assembled::new((set, shadow, sky), tracer, patches, &options, start)
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

/// The sparse factor s of F_ij = left_i s_ij right_j.
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
    stored: Arc<Stored>,
    left: Vec<f64>,
    right: Vec<f64>,
    escaped: Vec<f64>,
    areas: Vec<f64>,
    estimator: Estimator,
    samples: Option<Arc<Samples>>,
    /// Names of lights that are not surfaces and send no light.
    dark: Vec<String>,
    row_sum_deviation: BeforeAfter,
    reciprocity_deviation: BeforeAfter,
}

impl FormFactors {
    /// Casts rays from every patch and estimates all form factors. When a ray hits the back of a surface, patches for
    /// that back are added to `patches` and cast rays too.
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

    /// Like [`FormFactors::cast`], with a checkpoint file. Rays that the file holds are read from it, the others are
    /// cast and added to it. [`FormFactors::cast_more`] continues with the same file. The result is the same with and
    /// without a file.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped) when `progress` says so, [`Error::Io`](crate::Error::Io) and
    /// [`Error::Input`](crate::Error::Input) when the file cannot be read or written. Its contents stay valid.
    ///
    /// # Panics
    /// When the checkpoint belongs to another seed, or casts only a part of the rays.
    pub fn cast_checkpointed(
        scene: &Scene,
        tracer: &Tracer,
        patches: &mut Patches,
        options: &CastOptions,
        checkpoint: Option<Arc<Checkpoint>>,
        progress: &Progress,
    ) -> Result<FormFactors> {
        together(|| match Self::sampled(scene, tracer, patches, options, checkpoint, progress)? {
            Sampled::Whole(cast) => Ok(cast.assembled(tracer, patches).finish(patches)),
            Sampled::Lacking { .. } => panic!("this checkpoint casts only a part of the rays"),
        })
    }

    /// Casts rays into a checkpoint and computes no form factors. If the checkpoint casts only a [`Part`] of the rays,
    /// this goes as far as the rays of other parts in its files permit.
    ///
    /// # Errors
    /// See [`FormFactors::cast_checkpointed`].
    ///
    /// # Panics
    /// When the checkpoint belongs to another seed.
    pub fn cast_only(
        scene: &Scene,
        tracer: &Tracer,
        patches: &mut Patches,
        options: &CastOptions,
        checkpoint: Arc<Checkpoint>,
        progress: &Progress,
    ) -> Result<CastState> {
        together(|| match Self::sampled(scene, tracer, patches, options, Some(checkpoint), progress)? {
            Sampled::Whole(_) => Ok(CastState::Whole),
            Sampled::Lacking { last: true } => Ok(CastState::PartCast),
            Sampled::Lacking { last: false } => Ok(CastState::Waiting),
        })
    }

    /// Casts all rays, or those of a part.
    fn sampled(
        scene: &Scene,
        tracer: &Tracer,
        patches: &mut Patches,
        options: &CastOptions,
        checkpoint: Option<Arc<Checkpoint>>,
        progress: &Progress,
    ) -> Result<Sampled> {
        let apart = options.estimator == Estimator::Pooled && options.shadow_share > 0.0;
        let options = &options.for_lights(scene);
        let rays = if options.looks_first() { allocation::PILOT * options.rays } else { options.rays };
        let mut set = RaySet::none();
        set.ranks = options.ranks;
        set.checkpoint = checkpoint.map(|file| Section::new(file, digest(patches), options.seed));
        let emits = apart && patches.emission().iter().any(|&b| b > 0.0);
        let mut share = options.even(rays, emits || scene.lights.need_shadow_rays());
        set.extend(scene, tracer, patches, |_| share.hemisphere, options.seed, progress)?;
        // The choice of lamps depends on all hemisphere rays.
        if set.is_lacking() {
            return Ok(Sampled::Lacking { last: false });
        }
        let lamps = match emits {
            true => brightness::lamps(&set, tracer, patches, &scene.lights),
            false => Lamps::new(tracer, patches, &scene.lights, |_| false),
        };
        if share.shadow > 0 && lamps.is_empty() {
            // Without lamps all rays are hemisphere rays.
            share = options.even(rays, false);
            set.extend(scene, tracer, patches, |_| share.hemisphere, options.seed, progress)?;
        }
        let mut shadow = ShadowRays::none(lamps);
        shadow.extend(tracer, patches, |_| share.shadow, options.seed, &set, progress)?;
        if set.is_lacking() {
            return Ok(Sampled::Lacking { last: !options.looks_first() });
        }
        let cast = Cast { set, shadow, options: *options, start: Vec::new() };
        if options.looks_first() {
            let samples = cast.assembled(tracer, patches).into_samples(patches);
            return Self::continued(samples, scene, tracer, patches, options.rays, progress);
        }
        Ok(Sampled::Whole(Box::new(cast)))
    }

    /// Casts more rays with the original options, until the mean number of rays a patch is `rays`. The rays cast before
    /// are kept.
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
        let samples = self.samples.expect("these form factors were not cast from rays");
        assert_eq!(samples.rays.len(), patches.len(), "the form factors belong to other patches");
        // Frees memory for the new matrix.
        drop(self.stored);
        let samples = Arc::unwrap_or_clone(samples);
        together(|| match Self::continued(samples, scene, tracer, patches, rays, progress)? {
            Sampled::Whole(cast) => Ok(cast.assembled(tracer, patches).finish(patches)),
            Sampled::Lacking { .. } => unreachable!("form factors come from all rays"),
        })
    }

    /// Casts more rays where the samples show that they lower the error most.
    fn continued(
        samples: Samples,
        scene: &Scene,
        tracer: &Tracer,
        patches: &mut Patches,
        rays: f64,
        progress: &Progress,
    ) -> Result<Sampled> {
        let options = samples.options;
        let shares = if options.looks_first() { samples.shares(patches, rays) } else { Vec::new() };
        let Samples { rays: mut set, mut shadow, radiosity, .. } = samples;
        // Without variances the result must not depend on the number of rounds: each starts anew.
        let start = if options.looks_first() { radiosity } else { Vec::new() };
        let even = options.even(rays, !shadow.lamps.is_empty());
        let share = |i: usize| shares.get(i).copied().unwrap_or(even);
        set.extend(scene, tracer, patches, |i| share(i).hemisphere, options.seed, progress)?;
        shadow.extend(tracer, patches, |i| share(i).shadow, options.seed, &set, progress)?;
        if set.is_lacking() {
            return Ok(Sampled::Lacking { last: true });
        }
        Ok(Sampled::Whole(Box::new(Cast { set, shadow, options, start })))
    }

    /// The same form factors, from which lights that are not surfaces send no light if `shines` is false for their
    /// names. The matrix and the rays are shared. To let only some surfaces emit, solve for another emission.
    pub fn with_lights(&self, scene: &Scene, shines: impl Fn(&str) -> bool) -> FormFactors {
        let dark = scene.lights.names().filter(|name| !shines(name)).map(String::from).collect();
        FormFactors { dark, ..self.clone() }
    }

    /// Direct light of lamps and other lights, in multiples of `unit`, as `emission` is; `None` if there is none.
    pub(crate) fn direct<const C: usize>(&self, emission: &[[f64; C]], unit: f64) -> Option<DirectLight<C>> {
        let samples = self.samples.as_ref().filter(|samples| samples.has_direct())?;
        // Samples use relative areas, whose squares stay in range.
        let mut light = samples.direct(emission, unit, &self.dark);
        let area = self.areas.iter().sum::<f64>() / samples.areas.iter().sum::<f64>();
        let powers = light.escaped.iter_mut().chain(&mut light.entered);
        let deviations = light
            .escaped_deviations
            .as_flattened_mut()
            .iter_mut()
            .chain(light.entered_deviations.as_flattened_mut());
        powers.chain(deviations).for_each(|x| *x *= area);
        Some(light)
    }

    /// The [`magnitude`] of all light that is emitted or enters the scene.
    pub(crate) fn magnitude(&self, emission: &[f64]) -> f64 {
        self.samples
            .as_ref()
            .map_or_else(|| magnitude(emission), |samples| samples.shadow.lamps.magnitude(emission))
    }

    /// Irradiance of all patches from `radiosity` and from the direct light of lamps and other lights. `radiosity` and
    /// `emission` hold `channels` (1 or 3) interleaved values a patch. `radiosity` includes that of lamps. All values
    /// have one unit, such as W/m².
    ///
    /// # Panics
    /// When the number of values is wrong.
    pub fn light(&self, radiosity: &[f64], emission: &[f64], channels: usize) -> Vec<f64> {
        let of_lamps = |q: usize| if self.is_lamp(q / channels) { emission[q] } else { 0.0 };
        let carried: Vec<f64> = radiosity.iter().enumerate().map(|(q, b)| b - of_lamps(q)).collect();
        let mut irradiance = self.irradiance(&carried, channels);
        let direct = match channels {
            1 => self.direct::<1>(emission.as_chunks().0, 1.0).map(|d| d.irradiance.into_flattened()),
            _ => self.direct::<3>(emission.as_chunks().0, 1.0).map(|d| d.irradiance.into_flattened()),
        };
        irradiance.iter_mut().zip(direct.iter().flatten()).for_each(|(e, direct)| *e += direct);
        irradiance
    }

    /// Balance of the power of lamps with this `emission`, `channels` interleaved values a patch, and of other lights.
    pub(crate) fn direct_powers(&self, emission: &[f64], channels: usize) -> DirectPowers {
        fn of<const C: usize>(light: Option<DirectLight<C>>) -> DirectPowers {
            let none = || vec![0.0; C];
            light.map_or_else(
                || DirectPowers { entered: none(), escaped: none(), leaks: false },
                |d| DirectPowers { entered: d.entered.to_vec(), escaped: d.escaped.to_vec(), leaks: d.leaks },
            )
        }
        match channels {
            1 => of(self.direct::<1>(emission.as_chunks().0, 1.0)),
            _ => of(self.direct::<3>(emission.as_chunks().0, 1.0)),
        }
    }

    /// Whether patch `i` is a part of a lamp. The emission of lamps arrives by direct light, not through form factors.
    pub(crate) fn is_lamp(&self, i: usize) -> bool {
        self.samples.as_ref().is_some_and(|samples| samples.shadow.lamps.contains(i))
    }

    /// The rays; `None` if the form factors were not cast from rays.
    pub(crate) fn samples(&self) -> Option<&Samples> {
        self.samples.as_deref()
    }

    /// Names of lights that are not surfaces and send no light.
    pub(crate) fn dark(&self) -> &[String] {
        &self.dark
    }

    /// Number of shadow rays that left patch `i`.
    pub fn shadow_rays_of(&self, i: usize) -> u32 {
        self.samples.as_ref().map_or(0, |samples| samples.shadow.count(i))
    }

    /// Coplanar neighbours: runs of up to 16 patches, in the order of the patches.
    pub(crate) fn siblings(&self) -> &[Range<usize>] {
        self.samples.as_ref().map_or(&[], |samples| &samples.siblings)
    }

    /// Parts of the scene that rays connect; `None` if the form factors were not cast from rays.
    pub(crate) fn regions(&self) -> Option<&Regions> {
        self.samples.as_ref().map(|samples| &samples.regions)
    }

    /// The share of patch `i`'s light that the closure keeps on the diagonal, because no ray shows where it goes.
    pub(crate) fn unseen(&self, i: usize) -> f64 {
        match &*self.stored {
            Stored::Symmetric(_) => self.get(i, i),
            Stored::Rows(_) => 0.0,
        }
    }

    /// Number of patches.
    pub fn len(&self) -> usize {
        self.areas.len()
    }

    /// Whether there is no patch.
    pub fn is_empty(&self) -> bool {
        self.areas.is_empty()
    }

    /// F_ij. Searches a part of the matrix.
    pub fn get(&self, i: usize, j: usize) -> f64 {
        let s = match &*self.stored {
            Stored::Symmetric(matrix) => matrix.get(i, j),
            Stored::Rows(matrix) => matrix.get(i, j).copied().unwrap_or(0.0),
        };
        self.left[i] * f64::from(s) * self.right[j]
    }

    /// The non-zero F_ij of row `i` as (j, F_ij). Collects them from a part of the matrix.
    pub fn row(&self, i: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let entries = match &*self.stored {
            Stored::Symmetric(matrix) => matrix.row(i),
            Stored::Rows(matrix) => {
                let (columns, values) = row(matrix, i);
                columns.iter().map(|&j| j as usize).zip(values.iter().copied()).collect()
            }
        };
        entries.into_iter().map(move |(j, s)| (j, self.left[i] * f64::from(s) * self.right[j]))
    }

    /// All rows of s in F_ij = left_i s_ij right_j, compressed. For pooled form factors they take twice the memory of
    /// the matrix.
    pub(crate) fn rows(&self) -> Cow<'_, Matrix> {
        match &*self.stored {
            Stored::Symmetric(matrix) => Cow::Owned(matrix.rows()),
            Stored::Rows(matrix) => Cow::Borrowed(matrix),
        }
    }

    /// Area of each patch, at least 10⁻²⁰ of the mean area: in the scene's unit squared, or the unit given to
    /// [`FormFactors::from_exchange`].
    pub fn areas(&self) -> &[f64] {
        &self.areas
    }

    /// Multiplies all areas by `unit`. Form factors do not change.
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

    /// The radiosity that calibrated the form factors, interleaved channels, in units of the [`magnitude`] of emission.
    /// It is near the solution for the same emission. Empty if there is none.
    pub(crate) fn expected(&self) -> &[f32] {
        self.samples.as_ref().map_or(&[], |samples| &samples.radiosity)
    }

    /// Targets of all hemisphere rays; `None` if the form factors were not cast from rays.
    pub fn ray_set(&self) -> Option<&RaySet> {
        self.samples.as_ref().map(|samples| &samples.rays)
    }

    /// Number of hemisphere and shadow rays cast; 0 if the form factors were not cast from rays.
    pub fn rays(&self) -> u64 {
        self.samples.as_ref().map_or(0, |samples| samples.rays.rays() + samples.shadow.rays())
    }

    /// Number of non-zero form factors.
    pub fn non_zeros(&self) -> usize {
        match &*self.stored {
            Stored::Symmetric(matrix) => matrix.non_zeros(),
            Stored::Rows(matrix) => matrix.nnz(),
        }
    }

    /// Bytes of the matrix.
    pub fn matrix_bytes(&self) -> usize {
        match &*self.stored {
            Stored::Symmetric(matrix) => matrix.bytes(),
            Stored::Rows(matrix) => 8 * (matrix.nnz() + self.len()),
        }
    }

    /// Bytes held by the matrix, its scaling and the rays.
    pub fn bytes(&self) -> usize {
        let samples = |samples: &Arc<Samples>| samples.bytes();
        self.matrix_bytes() + 8 * 4 * self.len() + self.samples.as_ref().map_or(0, samples)
    }

    /// Number of form factors and escaped shares that are negative, exceed one by more than rounding, or are not
    /// numbers. Any other result than 0 is an error of the program.
    pub fn out_of_range(&self) -> usize {
        let is_share = |x: f64| (0.0..=1.0 + ROUNDING).contains(&x);
        let strays =
            |i: usize, j: usize, s: f32| usize::from(!is_share(self.left[i] * f64::from(s) * self.right[j]));
        let escaped = self.escaped.iter().filter(|&&x| !is_share(x)).count();
        escaped
            + match &*self.stored {
                Stored::Symmetric(matrix) => {
                    let both = |(i, j, s): (usize, usize, f32)| strays(i, j, s) + strays(j, i, s);
                    let of_tiles = matrix.tiles().map(|tile| tile.map(both).sum::<usize>()).sum();
                    matrix.ranks().sum(of_tiles)
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

    /// Largest |A_i F_ij - A_j F_ji| / min(A_i, A_j): `before` for the one-way estimates, `after` for the form factors
    /// in use.
    pub fn reciprocity_deviation(&self) -> BeforeAfter {
        self.reciprocity_deviation
    }

    /// The factors `left` and `right` of F_ij = left_i s_ij right_j.
    pub(crate) fn scaling(&self) -> (&[f64], &[f64]) {
        (&self.left, &self.right)
    }
}

/// Identifies a subdivision in a checkpoint.
fn digest(patches: &Patches) -> u64 {
    let of_patch = |i: usize| {
        let corners = patches.barycentric_corners(i).map(|b| mix(&b.map(f64::to_bits)));
        mix(&[patches.triangle(i) as u64, mix(&corners)])
    };
    let all: Vec<u64> = (0..patches.fronts()).into_par_iter().with_min_len(1024).map(of_patch).collect();
    mix(&all)
}
