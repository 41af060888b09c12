//! Slopes of light over patches, from the hemisphere rays.
//!
//! The first moments of the rays over their starting points give the slopes of the light that form factors carry. The
//! same rays are cast again through light that varies over the patches they hit, which gives its difference from
//! constant light. Start and end points of rays are not stored: a ray is reproduced from its number and the seed.

use glam::Vec3A;
use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;

use crate::{
    Progress, Result,
    direct::{
        Deviation,
        moments::{Local, measured},
    },
    form_factor::{FormFactors, Samples},
    patch::Patches,
    rays::{ESCAPED, REPLICATES, footprint::Footprint, part},
    scene::Scene,
    slopes::{Measured, SQUARES, Slopes, basis, rise},
    trace::{Tracer, sampling::mix},
};

/// If the determinant of the sample moments is below this share of the exact one, the samples cannot determine two
/// slopes.
const LEAST_DETERMINANT: f64 = 0.1;

/// Light that varies linearly over each patch.
pub(crate) struct Varying<'a, const C: usize> {
    /// Irradiance of each patch.
    pub(crate) irradiance: &'a [[f64; C]],
    pub(crate) slopes: &'a [Slopes<C>],
    /// Reflectance of each patch.
    pub(crate) reflectance: &'a [[f64; C]],
    pub(crate) is_mapped: &'a [bool],
}

/// Difference between linear and constant light.
pub(crate) struct Shifted<const C: usize> {
    /// Irradiance of each patch.
    pub(crate) irradiance: Vec<[f64; C]>,
    /// Deviation of each replicate of the irradiance.
    pub(crate) deviations: Vec<Deviation<C>>,
    /// Slopes of each patch.
    pub(crate) slopes: Vec<Slopes<C>>,
    /// Power that leaves the scene.
    pub(crate) escaped: [f64; C],
}

/// Sums over the rays of a replicate.
#[derive(Clone, Copy)]
struct Sums<const C: usize> {
    count: f64,
    basis: [f64; 2],
    light: [f64; C],
    both: [[f64; 2]; C],
}

impl<const C: usize> Sums<C> {
    const ZERO: Self = Sums { count: 0.0, basis: [0.0; 2], light: [0.0; C], both: [[0.0; 2]; C] };

    #[inline]
    fn add(&mut self, basis: [f64; 2], light: &[f64; C]) {
        for m in 0..2 {
            self.basis[m] += basis[m];
        }
        for c in 0..C {
            self.light[c] += light[c];
            for m in 0..2 {
                self.both[c][m] += basis[m] * light[c];
            }
        }
    }
}

impl FormFactors {
    /// The slopes of direct light, without the sky. Lamps emit `emission`; it and the result are in multiples of
    /// `unit`. `None` if the form factors were not sampled.
    pub(crate) fn direct_slopes<const C: usize>(
        &self,
        tracer: &Tracer,
        patches: &Patches,
        (emission, unit): (&[[f64; C]], f64),
    ) -> Option<Vec<Measured<C>>> {
        let samples = self.samples()?;
        if samples.shadow.lamps.is_empty() {
            return Some(vec![Measured::NONE; patches.len()]);
        }
        Some(samples.shadow.slopes(tracer, patches, (emission, unit, self.dark()), samples.options.seed))
    }

    /// The slopes of the light that form factors carry from patches with this constant radiosity; `None` if the form
    /// factors were not sampled.
    pub(crate) fn carried_slopes<const C: usize>(
        &self,
        tracer: &Tracer,
        patches: &Patches,
        radiosity: &[[f64; C]],
    ) -> Option<Vec<Measured<C>>> {
        let samples = self.samples()?;
        let of_patch = |i: usize| samples.carried_slopes(tracer, patches, i, radiosity);
        Some((0..patches.len()).into_par_iter().with_min_len(64).map(of_patch).collect())
    }

    /// Casts the rays again and returns the difference between linear and constant light; `None` if the form factors
    /// were not sampled.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped) when `progress` says so.
    pub(crate) fn shift<const C: usize>(
        &self,
        (scene, tracer, patches): (&Scene, &Tracer, &Patches),
        light: &Varying<C>,
        progress: &Progress,
    ) -> Result<Option<Shifted<C>>> {
        let Some(samples) = self.samples() else { return Ok(None) };
        progress.begin("casting rays again", samples.rays.rays());
        let of_patch = |i: usize| {
            progress.check()?;
            let found = samples.shift(scene, tracer, patches, i, light);
            progress.advance(samples.rays.rays_of(i).into());
            Ok(found)
        };
        let found: Vec<OfPatch<C>> =
            (0..patches.len()).into_par_iter().with_min_len(32).map(of_patch).collect::<Result<_>>()?;
        let mut shifted = Shifted {
            irradiance: Vec::with_capacity(found.len()),
            deviations: Vec::with_capacity(found.len()),
            slopes: Vec::with_capacity(found.len()),
            escaped: [0.0; C],
        };
        for (found, area) in found.into_iter().zip(self.areas()) {
            shifted.irradiance.push(found.irradiance);
            shifted.deviations.push(found.deviation);
            shifted.slopes.push(found.slopes);
            (0..C).for_each(|c| shifted.escaped[c] += area * found.escaped[c]);
        }
        Ok(Some(shifted))
    }
}

/// Number of patches whose rays are reproduced at a time.
const BLOCK: usize = 1024;

impl FormFactors {
    /// The difference between linear and constant light that the rays bring to the patches they hit, if they carry the
    /// light of their start points: the irradiance of each patch by each half of the replicates. `None` if the form
    /// factors were not sampled.
    ///
    /// A ray from patch i stands for the exchange area A_i / R_i, in both directions.
    pub(crate) fn brought<const C: usize>(
        &self,
        (scene, tracer, patches): (&Scene, &Tracer, &Patches),
        light: &Varying<C>,
    ) -> Option<[Vec<[f64; C]>; 2]> {
        const HALF: usize = REPLICATES / 2;
        let samples = self.samples()?;
        let mut brought = [0, 1].map(|_| vec![[0.0; C]; patches.len()]);
        for start in (0..patches.len()).step_by(BLOCK) {
            let block = start..(start + BLOCK).min(patches.len());
            let carried: Vec<Vec<[f32; C]>> = block
                .clone()
                .into_par_iter()
                .with_min_len(16)
                .map(|i| samples.carried(scene, tracer, patches, i, light))
                .collect();
            for (i, carried) in block.zip(carried) {
                let targets = samples.rays.of(i);
                for k in 0..REPLICATES {
                    let range = part(targets.len() as u32, k);
                    let exchanged = samples.areas[i] / (HALF * range.len()) as f64;
                    // Without slopes a patch carries nothing, and `carried` is empty.
                    for (&j, carried) in targets[range.clone()].iter().zip(carried.get(range).unwrap_or(&[]))
                    {
                        if j != ESCAPED {
                            let weight = exchanged / samples.areas[j as usize];
                            let brought = &mut brought[k / HALF][j as usize];
                            (0..C).for_each(|c| brought[c] += weight * f64::from(carried[c]));
                        }
                    }
                }
            }
        }
        Some(brought)
    }
}

/// Difference between linear and constant light at a patch.
struct OfPatch<const C: usize> {
    irradiance: [f64; C],
    deviation: Deviation<C>,
    slopes: Slopes<C>,
    /// Power per area.
    escaped: [f64; C],
}

impl Samples {
    fn carried_slopes<const C: usize>(
        &self,
        tracer: &Tracer,
        patches: &Patches,
        i: usize,
        radiosity: &[[f64; C]],
    ) -> Measured<C> {
        let targets = self.rays.of(i);
        if self.rays.is_withdrawn(i) {
            return Measured::NONE;
        }
        let from = Footprint::new(tracer, patches, i);
        let local = Local::new(&from);
        let mut products = Matrix2::zeros();
        let mut sums = [Sums::ZERO; REPLICATES];
        let mut rays = from.hemisphere_rays(0..targets.len() as u32, self.seed_of(i));
        for (k, sums) in sums.iter_mut().enumerate() {
            let range = part(targets.len() as u32, k);
            sums.count = range.len() as f64;
            for (&target, ray) in targets[range].iter().zip(&mut rays) {
                let basis = local.basis(ray.origin);
                let along = Vector2::from(basis);
                products += along * along.transpose();
                let light = if target == ESCAPED { &[0.0; C] } else { &radiosity[target as usize] };
                sums.add(basis, light);
            }
        }
        fit(&sums, products)
    }

    /// The light of the start point of each ray of patch `i`, minus the mean of the patch. Empty if light does not vary.
    fn carried<const C: usize>(
        &self,
        scene: &Scene,
        tracer: &Tracer,
        patches: &Patches,
        i: usize,
        light: &Varying<C>,
    ) -> Vec<[f32; C]> {
        let is_black = light.reflectance[i] == [0.0; C];
        let is_constant = light.slopes[i] == [[0.0; 2]; C] && !light.is_mapped[i];
        if is_black || is_constant || self.rays.is_withdrawn(i) {
            return Vec::new();
        }
        let from = Footprint::new(tracer, patches, i);
        let local = Local::new(&from);
        let (t, corners) = (patches.triangle(i), patches.barycentric_corners(i));
        let of_ray = |point: Vec3A| {
            let there = local.barycentric(point);
            let of_triangle = std::array::from_fn(|k| (0..3).map(|m| there[m] * corners[m][k]).sum());
            light.more(there, i, || scene.reflectance_at(t, of_triangle)).map(|x| x as f32)
        };
        from.hemisphere_rays(0..self.rays.rays_of(i), self.seed_of(i)).map(|ray| of_ray(ray.origin)).collect()
    }

    fn seed_of(&self, i: usize) -> u64 {
        mix(&[self.options.seed, i as u64])
    }

    fn shift<const C: usize>(
        &self,
        scene: &Scene,
        tracer: &Tracer,
        patches: &Patches,
        i: usize,
        light: &Varying<C>,
    ) -> OfPatch<C> {
        let rays = self.rays.rays_of(i);
        let mut sums = [Sums::ZERO; REPLICATES];
        let mut escaped = [0.0; C];
        if !self.rays.is_withdrawn(i) {
            let from = Footprint::new(tracer, patches, i);
            let local = Local::new(&from);
            let ranges: [_; REPLICATES] = std::array::from_fn(|k| part(rays, k));
            let cast = from
                .hemisphere_rays(0..rays, self.seed_of(i))
                .map(|ray| ((ray.index as usize, local.basis(ray.origin)), ray.origin, ray.direction));
            tracer.closest_each(cast, |(index, basis), hit| {
                let Some((j, hit)) = hit.and_then(|hit| {
                    Some((patches.at(hit.triangle, hit.barycentric, hit.front)? as usize, hit))
                }) else {
                    for c in 0..C {
                        escaped[c] += light.reflectance[i][c] * rise(&light.slopes[i][c], basis);
                    }
                    return;
                };
                let replicate = ranges.partition_point(|range| range.end <= index);
                let there = patches.local(j, hit.barycentric);
                sums[replicate].add(basis, &light.more(there, j, || hit.reflectance(scene)));
            });
        }
        let count = f64::from(rays);
        let mean: [f64; C] =
            std::array::from_fn(|c| sums.iter().map(|sums| sums.light[c]).sum::<f64>() / count);
        let mut parts = [[[0.0; 2]; C]; REPLICATES];
        let deviation = std::array::from_fn(|c| {
            std::array::from_fn(|k| {
                let of_part = part(rays, k).len() as f64;
                parts[k][c] = sums[k].both[c].map(|both| both / of_part);
                (sums[k].light[c] / of_part - mean[c]) as f32
            })
        });
        OfPatch {
            irradiance: mean,
            deviation,
            slopes: measured(&parts, rays as usize).slopes,
            escaped: escaped.map(|escaped| escaped / count),
        }
    }
}

impl<const C: usize> Varying<'_, C> {
    /// Reflected light at a point of patch `j`, minus the mean of the patch. `there` are barycentric coordinates in the
    /// patch.
    #[inline]
    fn more(&self, there: [f64; 3], j: usize, at_point: impl FnOnce() -> [f64; 3]) -> [f64; C] {
        let (reflectance, slopes) = (&self.reflectance[j], &self.slopes[j]);
        let basis = basis(there);
        let rises = |c: usize| rise(&slopes[c], basis);
        if !self.is_mapped[j] {
            return std::array::from_fn(|c| reflectance[c] * rises(c));
        }
        let here = at_point();
        std::array::from_fn(|c| {
            let irradiance = self.irradiance[j][c];
            here[c] * (irradiance + rises(c)) - reflectance[c] * irradiance
        })
    }
}

/// Fits slopes by least squares. The spread of the replicates gives their noise.
fn fit<const C: usize>(sums: &[Sums<C>; REPLICATES], products: Matrix2<f64>) -> Measured<C> {
    let count: f64 = sums.iter().map(|sums| sums.count).sum();
    let of_all = |value: &dyn Fn(&Sums<C>) -> f64| sums.iter().map(value).sum::<f64>() / count;
    let centre = [0, 1].map(|m| of_all(&|sums| sums.basis[m]));
    let along = Vector2::from(centre);
    let squares = products / count - along * along.transpose();
    if squares.determinant() < LEAST_DETERMINANT * SQUARES[0] * SQUARES[1] {
        return Measured::NONE;
    }
    let inverse = squares.try_inverse().unwrap_or_else(Matrix2::zeros);
    let mut found = Measured::NONE;
    for c in 0..C {
        let mean = of_all(&|sums| sums.light[c]);
        // Sums of (φ - mean φ) (light - mean light).
        let of_part = |sums: &Sums<C>| {
            let moment = |m: usize| {
                let (b, l) = (sums.basis[m], sums.light[c]);
                sums.both[c][m] - centre[m] * l - mean * b + sums.count * centre[m] * mean
            };
            inverse * Vector2::new(moment(0), moment(1))
        };
        let parts = sums.map(|sums| of_part(&sums) / sums.count);
        let slopes: Vector2<f64> =
            parts.iter().zip(sums).map(|(part, sums)| part * (sums.count / count)).sum();
        found.slopes[c] = slopes.into();
        for part in parts {
            let off = part - slopes;
            let spread = SQUARES[0] * off[0] * off[0] + SQUARES[1] * off[1] * off[1];
            found.noise += spread / (REPLICATES * (REPLICATES - 1)) as f64;
        }
    }
    found
}
