//! How light varies over patches, from the hemisphere rays.
//!
//! The moments of the rays over their starting points give the shape of the light that form factors carry: two slopes
//! and three curvatures for each patch ([`modes`]). If the rays carried this light instead of its mean over the patch,
//! they would bring other light to the patches that they hit. No ray is cast for this: light goes both ways along a ray,
//! and its start point and direction are reproduced from its number and the seed.
//!
//! The rays of one half of the replicates carry the light that the other half has found. Otherwise a ray would bring
//! back the light that it found: with n rays, a share of 2 / n of the light would return to where it came from.

use nalgebra::{SMatrix, SVector};
use rayon::prelude::*;

use crate::{
    Progress, Result,
    direct::{
        self, Deviation,
        moments::{Emission, Local},
    },
    form_factor::{FormFactors, Samples},
    patch::Patches,
    rays::{ESCAPED, REPLICATES, footprint::Footprint, part},
    scene::{
        Scene, in_triangle,
        light::{SKY, Sky},
    },
    slopes::{CELLS, CORNERS, MODES, Measured, SQUARES, Shape, Slopes, cell, modes, rise, spread},
    trace::{Tracer, sampling::mix},
};

/// If the determinant of the sample moments is below this share of the exact one, the samples cannot determine the
/// coefficients by least squares.
const LEAST_DETERMINANT: f64 = 0.1;

/// The share of its slopes that linear light is taken to lack. They are the slopes of constant light, and the change that
/// linear light makes has slopes too. Without this share the estimated error of linear light was 0.36 to 1.17 of the true
/// one on six scenes of 250 patches (bench `discretisation`).
const LACKING: f64 = 0.25;

/// Number of patches whose rays are reproduced at a time. What a ray carries takes six times the memory of its target.
const BLOCK: usize = 128;

/// Replicates of each half of the rays.
const HALF: usize = REPLICATES / 2;

/// A solution with constant light on each patch. All light is in multiples of `unit`.
pub(crate) struct Constant<'a, const C: usize> {
    pub(crate) irradiance: &'a [[f64; C]],
    pub(crate) radiosity: &'a [[f64; C]],
    pub(crate) emission: &'a [[f64; C]],
    pub(crate) reflectance: &'a [[f64; C]],
    pub(crate) is_mapped: &'a [bool],
    pub(crate) unit: f64,
}

/// How light varies over patches, and what it brings beyond constant light.
pub(crate) struct Variation<const C: usize> {
    /// Slopes of irradiance of each patch, reduced by their noise and such that no light is negative.
    pub(crate) slopes: Vec<Slopes<C>>,
    /// The same for light that surfaces have reflected.
    pub(crate) reflected: Vec<Slopes<C>>,
    /// What linear light with these slopes brings, if it was asked for.
    pub(crate) linear: Option<Brought<C>>,
    /// What the light brings that neither the mean of a patch nor, where asked for, its slopes include: the irradiance
    /// of each patch by each half of the rays.
    pub(crate) missing: [Vec<[f32; C]>; 2],
}

/// What light brings beyond constant light.
pub(crate) struct Brought<const C: usize> {
    /// Irradiance of each patch.
    pub(crate) irradiance: Vec<[f64; C]>,
    /// Deviation of each replicate of the irradiance.
    pub(crate) deviations: Vec<Deviation<C>>,
    /// Power that leaves the scene.
    pub(crate) escaped: [f64; C],
    /// Power that patches reflect beyond their mean reflectance times their mean irradiance, because both vary together.
    pub(crate) beyond_means: [f64; C],
}

/// Sums over the rays of a replicate.
#[derive(Clone, Copy)]
struct Sums<const C: usize> {
    count: f64,
    basis: [f64; MODES],
    light: [f64; C],
    both: Shape<C>,
}

impl<const C: usize> Sums<C> {
    const ZERO: Self = Sums { count: 0.0, basis: [0.0; MODES], light: [0.0; C], both: [[0.0; MODES]; C] };

    #[inline]
    fn add(&mut self, basis: &[f64; MODES], light: &[f64; C]) {
        self.count += 1.0;
        (0..MODES).for_each(|m| self.basis[m] += basis[m]);
        for c in 0..C {
            self.light[c] += light[c];
            (0..MODES).for_each(|m| self.both[c][m] += basis[m] * light[c]);
        }
    }
}

impl FormFactors {
    /// How the light of a solution varies over its patches. With `linear`, slopes are carried as light, and not only
    /// estimated. `None` if the form factors were not sampled.
    ///
    /// A ray from patch i stands for the exchange area A_i / R_i, in both directions.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped) when `progress` says so.
    pub(crate) fn variation<const C: usize>(
        &self,
        (scene, tracer, patches): (&Scene, &Tracer, &Patches),
        light: &Constant<C>,
        linear: bool,
        progress: &Progress,
    ) -> Result<Option<Variation<C>>> {
        let Some(samples) = self.samples() else { return Ok(None) };
        let without = |i: usize, of: bool| -> [f64; C] {
            std::array::from_fn(|c| light.radiosity[i][c] - if of { light.emission[i][c] } else { 0.0 })
        };
        let many = patches.len();
        let pass = Pass {
            samples,
            scene,
            tracer,
            patches,
            light,
            linear,
            carried: (0..many).map(|i| without(i, self.is_lamp(i))).collect(),
            reflected: (0..many).map(|i| without(i, true)).collect(),
            sky: samples.shadow.lamps.sky.as_ref().filter(|_| !self.dark().iter().any(|name| name == SKY)),
        };
        let mut found = Gathering::new(many, linear);
        for start in (0..many).step_by(BLOCK) {
            progress.check()?;
            let block = start..(start + BLOCK).min(many);
            let lamps = Emission { emission: light.emission, unit: light.unit, dark: self.dark() };
            let seed = samples.options.seed;
            let direct = samples.shadow.shapes((scene, tracer, patches), block.clone(), lamps, seed);
            let of_patches: Vec<OfPatch<C>> = block
                .clone()
                .into_par_iter()
                .with_min_len(4)
                .map(|i| pass.of_patch(i, &direct[i - start]))
                .collect();
            for (i, of_patch) in block.zip(of_patches) {
                found.add(samples, (i, self.areas()[i]), of_patch);
                for (missing, more) in found.variation.missing.iter_mut().zip(direct[i - start].of_textures) {
                    (0..C).for_each(|c| missing[i][c] += more[c] as f32);
                }
            }
        }
        Ok(Some(found.finish()))
    }
}

/// What the rays of a patch carry, beyond the mean light of the patch.
struct OfPatch<const C: usize> {
    slopes: Slopes<C>,
    reflected: Slopes<C>,
    /// By linear light, for each ray. Empty if it is nothing.
    linear: Vec<[f32; C]>,
    /// By the light that is missing, for each ray.
    missing: Vec<[f32; C]>,
    /// Power per area that the patch reflects beyond the product of the means.
    beyond_means: [f64; C],
}

struct Pass<'a, const C: usize> {
    samples: &'a Samples,
    scene: &'a Scene,
    tracer: &'a Tracer,
    patches: &'a Patches,
    light: &'a Constant<'a, C>,
    linear: bool,
    /// The radiosity that form factors carry, and the part of it that is reflected.
    carried: Vec<[f64; C]>,
    reflected: Vec<[f64; C]>,
    sky: Option<&'a Sky>,
}

impl<const C: usize> Pass<'_, C> {
    fn of_patch(&self, i: usize, direct: &direct::moments::Shape<C>) -> OfPatch<C> {
        let rays = &self.samples.rays;
        let targets = rays.of(i);
        let mut found = OfPatch {
            slopes: [[0.0; 2]; C],
            reflected: [[0.0; 2]; C],
            linear: Vec::new(),
            missing: Vec::new(),
            beyond_means: [0.0; C],
        };
        if rays.is_withdrawn(i) {
            return found;
        }
        let from = Footprint::new(self.tracer, self.patches, i);
        let local = Local::new(&from);
        let count = targets.len() as u32;
        let mut places = Vec::with_capacity(targets.len());
        let mut products = SMatrix::<f64, MODES, MODES>::zeros();
        let mut sums = [[Sums::ZERO; REPLICATES]; 2];
        let mut cast = from.hemisphere_rays(0..count, mix(&[self.samples.options.seed, i as u64]));
        for k in 0..REPLICATES {
            for (&target, ray) in targets[part(count, k)].iter().zip(&mut cast) {
                let there = local.barycentric(ray.origin);
                let basis = modes(there);
                places.push((there, basis));
                for m in 0..MODES {
                    (m..MODES).for_each(|n| products[(m, n)] += basis[m] * basis[n]);
                }
                let [all, reflected] = match target {
                    ESCAPED => [self.of_sky(ray.direction), [0.0; C]],
                    j => [self.carried[j as usize], self.reflected[j as usize]],
                };
                sums[0][k].add(&basis, &all);
                if self.linear {
                    sums[1][k].add(&basis, &reflected);
                }
            }
        }
        products.fill_lower_triangle_with_upper_triangle();
        let arriving = fit(&sums[0], products);
        let light = direct.measured.plus(&arriving);
        let share = believed(&light);
        found.slopes = light.slopes().map(|slopes| slopes.map(|slope| share * slope));
        let flat = keep_positive(&mut found.slopes, &self.light.irradiance[i]);
        if self.linear {
            let reflected = fit(&sums[1], products);
            let share = believed(&reflected);
            found.reflected = reflected.slopes().map(|slopes| slopes.map(|slope| share * slope));
        }
        let kept = if self.linear { flat.map(|flat| share * flat) } else { [0.0; C] };
        self.carry(i, (&light, &direct.cells), kept, &places, &mut found);
        found
    }

    fn of_sky(&self, direction: glam::Vec3A) -> [f64; C] {
        let Some(sky) = self.sky else { return [0.0; C] };
        let radiance = sky.radiance(direction.as_dvec3().normalize());
        std::array::from_fn(|c| std::f64::consts::PI * radiance[c] / self.light.unit)
    }

    /// The light that each ray carries from its start point, given its barycentric coordinates and the values of the
    /// basis functions there. Linear light has the share `kept` of the slopes.
    fn carry(
        &self,
        i: usize,
        (shape, cells): (&Measured<C>, &[[[f64; CELLS]; C]; 2]),
        kept: [f64; C],
        places: &[([f64; 3], [f64; MODES])],
        found: &mut OfPatch<C>,
    ) {
        let (reflectance, is_mapped) = (&self.light.reflectance[i], self.light.is_mapped[i]);
        let is_flat = shape.halves == Measured::<C>::NONE.halves;
        if (*reflectance == [0.0; C] || is_flat) && !is_mapped {
            return;
        }
        let (t, corners) = (self.patches.triangle(i), self.patches.barycentric_corners(i));
        let here = |there: [f64; 3]| self.scene.reflectance_at(t, in_triangle(there, &corners));
        let middle = part(places.len() as u32, HALF).start;
        for (half, places) in [&places[..middle], &places[middle..]].into_iter().enumerate() {
            let many = places.len() as f64;
            let centre: [f64; MODES] =
                std::array::from_fn(|m| places.iter().map(|(_, basis)| basis[m]).sum::<f64>() / many);
            let here: Vec<[f64; 3]> =
                if is_mapped { places.iter().map(|&(there, _)| here(there)).collect() } else { Vec::new() };
            let mean: [f64; C] = std::array::from_fn(|c| here.iter().map(|here| here[c]).sum::<f64>() / many);
            let (shape, cells) = (&shape.halves[1 - half], &cells[1 - half]);
            for (at, (there, basis)) in places.iter().enumerate() {
                let (mut linear, mut missing, cell) = ([0.0; C], [0.0; C], cell(*there));
                for c in 0..C {
                    let of = |m: usize| shape[c][m] * (basis[m] - centre[m]);
                    let (slope, rest) = (of(0) + of(1), of(2) + of(3) + of(4) + cells[c][cell]);
                    let rho = here.get(at).map_or(reflectance[c], |here| here[c]);
                    // The variation of the texture alone is carried by no light. With it, few rays decide which dark or
                    // bright squares of a chessboard a patch sees: the sampling error was 2.3 times as large on
                    // `textured.obj`, for 4 % less discretisation error.
                    let texture = if is_mapped { (rho - mean[c]) * self.light.irradiance[i][c] } else { 0.0 };
                    let lacking = 1.0 - kept[c] + LACKING * kept[c];
                    (linear[c], missing[c]) = (rho * kept[c] * slope, rho * (lacking * slope + rest));
                    missing[c] += texture;
                    found.beyond_means[c] += linear[c];
                }
                if self.linear {
                    found.linear.push(linear.map(|x| x as f32));
                }
                found.missing.push(missing.map(|x| x as f32));
            }
        }
        let many = places.len() as f64;
        // Without a texture this is zero but for rounding.
        found.beyond_means = found.beyond_means.map(|sum| if is_mapped { sum / many } else { 0.0 });
    }
}

/// The light that rays brought so far.
struct Gathering<const C: usize> {
    variation: Variation<C>,
    /// Irradiance by each replicate.
    parts: Vec<Deviation<C>>,
}

impl<const C: usize> Gathering<C> {
    fn new(many: usize, linear: bool) -> Self {
        let brought = || Brought {
            irradiance: vec![[0.0; C]; many],
            deviations: Vec::new(),
            escaped: [0.0; C],
            beyond_means: [0.0; C],
        };
        Gathering {
            variation: Variation {
                slopes: Vec::with_capacity(many),
                reflected: Vec::with_capacity(many),
                linear: linear.then(brought),
                missing: [0, 1].map(|_| vec![[0.0; C]; many]),
            },
            parts: if linear { vec![[[0.0; REPLICATES]; C]; many] } else { Vec::new() },
        }
    }

    /// Adds what the rays of a patch of this area carry.
    fn add(&mut self, samples: &Samples, (i, area): (usize, f64), found: OfPatch<C>) {
        let (variation, parts) = (&mut self.variation, &mut self.parts);
        variation.slopes.push(found.slopes);
        variation.reflected.push(found.reflected);
        let targets = samples.rays.of(i);
        let of_ray = samples.areas[i] / targets.len() as f64;
        for k in 0..REPLICATES {
            let range = part(targets.len() as u32, k);
            let of_replicate = samples.areas[i] / range.len() as f64;
            for s in range {
                let (j, missing) = (targets[s], found.missing.get(s));
                if let Some(missing) = missing.filter(|_| j != ESCAPED) {
                    let weight = of_replicate / HALF as f64 / samples.areas[j as usize];
                    let brought = &mut variation.missing[k / HALF][j as usize];
                    (0..C).for_each(|c| brought[c] += weight as f32 * missing[c]);
                }
                let Some((linear, carried)) = variation.linear.as_mut().zip(found.linear.get(s)) else {
                    continue;
                };
                let carried = carried.map(f64::from);
                if j == ESCAPED {
                    (0..C).for_each(|c| linear.escaped[c] += area / targets.len() as f64 * carried[c]);
                    continue;
                }
                let to = samples.areas[j as usize];
                for c in 0..C {
                    linear.irradiance[j as usize][c] += of_ray / to * carried[c];
                    parts[j as usize][c][k] += (of_replicate / to * carried[c]) as f32;
                }
            }
        }
        if let Some(linear) = &mut variation.linear {
            (0..C).for_each(|c| linear.beyond_means[c] += area * found.beyond_means[c]);
        }
    }

    fn finish(mut self) -> Variation<C> {
        if let Some(linear) = &mut self.variation.linear {
            for parts in self.parts.as_flattened_mut() {
                let mean = parts.iter().sum::<f32>() / REPLICATES as f32;
                parts.iter_mut().for_each(|part| *part -= mean);
            }
            linear.deviations = self.parts;
        }
        self.variation
    }
}

/// The share of the slopes that is not noise (Wiener filter).
fn believed<const C: usize>(found: &Measured<C>) -> f64 {
    let spread = spread(&found.slopes());
    if spread > 0.0 { (1.0 - found.noise / spread).max(0.0) } else { 0.0 }
}

/// Reduces slopes until the light is nowhere negative, and returns the share that is left. The mean does not change.
pub(crate) fn keep_positive<const C: usize>(slopes: &mut Slopes<C>, mean: &[f64; C]) -> [f64; C] {
    let mut left = [1.0; C];
    for (c, slopes) in slopes.iter_mut().enumerate() {
        let least = CORNERS.iter().map(|&corner| rise(slopes, corner)).fold(0.0, f64::min);
        if -least > mean[c] {
            left[c] = mean[c].max(0.0) / -least;
            *slopes = slopes.map(|slope| left[c] * slope);
        }
    }
    left
}

/// Fits the shape of light by least squares. The spread of the replicates gives the noise of the slopes.
fn fit<const C: usize>(sums: &[Sums<C>; REPLICATES], products: SMatrix<f64, MODES, MODES>) -> Measured<C> {
    let count: f64 = sums.iter().map(|sums| sums.count).sum();
    let of_all = |value: &dyn Fn(&Sums<C>) -> f64| sums.iter().map(value).sum::<f64>() / count;
    let centre: [f64; MODES] = std::array::from_fn(|m| of_all(&|sums| sums.basis[m]));
    let along = SVector::from(centre);
    let inverse = inverse(products / count - along * along.transpose());
    let mut found = Measured::NONE;
    let of_half = [0, 1].map(|half| sums[half * HALF..][..HALF].iter().map(|sums| sums.count).sum::<f64>());
    for c in 0..C {
        let mean = of_all(&|sums| sums.light[c]);
        // Sums of (φ - mean φ) (light - mean light).
        let of_part = |sums: &Sums<C>| {
            let moment = |m: usize| {
                let (b, l) = (sums.basis[m], sums.light[c]);
                sums.both[c][m] - centre[m] * l - mean * b + sums.count * centre[m] * mean
            };
            inverse * SVector::<f64, MODES>::from_fn(|m, _| moment(m))
        };
        let parts = sums.map(|sums| of_part(&sums));
        for (k, part) in parts.iter().enumerate() {
            (0..MODES).for_each(|m| found.halves[k / HALF][c][m] += part[m] / of_half[k / HALF]);
        }
        let all: SVector<f64, MODES> = parts.iter().sum::<SVector<f64, MODES>>() / count;
        for (part, sums) in parts.iter().zip(sums) {
            let off = part / sums.count - all;
            let spread = SQUARES[0] * off[0] * off[0] + SQUARES[1] * off[1] * off[1];
            found.noise += spread / (REPLICATES * (REPLICATES - 1)) as f64;
        }
    }
    found
}

/// The inverse of the moments of the basis functions. If the samples cannot determine all coefficients, least squares
/// determines the slopes alone, and the moments of the curvatures count as exact. If they cannot determine slopes
/// either, it is zero.
fn inverse(moments: SMatrix<f64, MODES, MODES>) -> SMatrix<f64, MODES, MODES> {
    let exact = |count: usize| LEAST_DETERMINANT * SQUARES[..count].iter().product::<f64>();
    if moments.determinant() >= exact(MODES) {
        return moments.try_inverse().unwrap_or_else(SMatrix::zeros);
    }
    let slopes = moments.fixed_view::<2, 2>(0, 0).into_owned();
    let mut inverse = SMatrix::zeros();
    if slopes.determinant() >= exact(2) {
        inverse = SMatrix::from_diagonal(&SVector::from(SQUARES.map(|square| 1.0 / square)));
        let slopes = slopes.try_inverse().unwrap_or_else(SMatrix::zeros);
        inverse.fixed_view_mut::<2, 2>(0, 0).copy_from(&slopes);
    }
    inverse
}
