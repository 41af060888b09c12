//! The light of each lamp alone.
//!
//! Light is linear in what is emitted. So the same form factors give the light of each emitting material and of each group of lights
//! that are no surfaces, and the parts sum to the whole.

use super::{Radiometry, Solution, SolveOptions, solve};
use crate::{Progress, Result, form_factor::FormFactors, patch::Patches, scene::Scene};

/// The part of the light that some lamps give.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LampLight {
    /// The name of the material, or what the part holds.
    pub name: String,
    /// The materials that emit it; empty for lights that are no surfaces.
    pub materials: Vec<u32>,
    /// Irradiance, W/m²; interleaved channels.
    pub irradiance: Vec<f64>,
    /// Slopes of irradiance, as in [`LinearLight::slopes`](super::LinearLight::slopes); empty if light is constant.
    pub slopes: Vec<[f64; 2]>,
}

/// Splits a solution into at most `most` parts: one for each emitting material, brightest first, then the other
/// materials together; and one each for distant lights, for points with luminaires, and for the sky. With room for one part for all of
/// these lights only, they share it. Empty if there is one part only.
///
/// Each part costs a solution of the linear system with constant light, and no rays. What linear light adds to a patch is
/// divided among the parts in proportion to their light there. The parts sum to `whole`.
///
/// # Errors
/// As [`solve()`].
///
/// # Panics
/// When the sizes disagree.
pub fn by_lamp(
    scene: &Scene,
    (form_factors, patches): (&FormFactors, &Patches),
    whole: &Solution,
    most: usize,
    options: &SolveOptions,
    progress: &Progress,
) -> Result<Vec<LampLight>> {
    let mut outside = scene.lights.groups();
    let emitting = groups(scene, patches, 1).len();
    if outside.len() + emitting > most.max(1) {
        outside.truncate(1);
        outside.iter_mut().for_each(|(_, name)| *name = all_of(scene));
    }
    let groups = groups(scene, patches, most.saturating_sub(outside.len()));
    if groups.len() + outside.len() < 2 {
        return Ok(Vec::new());
    }
    let of_materials = |materials: &[u32]| -> Result<Vec<f64>> {
        let emission = emission_of(scene, patches, materials);
        let radiometry = Radiometry { emission: &emission, ..patches.into() };
        solve(form_factors, radiometry, options, progress).map(|solution| solution.irradiance)
    };
    // Lights that are no surfaces shine in every solution.
    let from_outside = if outside.is_empty() { None } else { Some(of_materials(&[])?) };
    let mut rest = whole.constant_irradiance().to_vec();
    let take = |from: &mut [f64], part: &[f64]| from.iter_mut().zip(part).for_each(|(x, part)| *x -= part);
    let mut parts: Vec<LampLight> = Vec::new();
    if let Some(irradiance) = &from_outside {
        take(&mut rest, irradiance);
    }
    let last = groups.len().saturating_sub(1);
    for (k, (name, materials)) in groups.into_iter().enumerate() {
        let irradiance = if k == last {
            std::mem::take(&mut rest)
        } else {
            let mut irradiance = of_materials(&materials)?;
            from_outside.iter().for_each(|outside| take(&mut irradiance, outside));
            take(&mut rest, &irradiance);
            irradiance
        };
        parts.push(LampLight { name, materials, irradiance, slopes: Vec::new() });
    }
    if let Some(from_outside) = from_outside {
        let mut rest = from_outside;
        let last = outside.len() - 1;
        for (k, (group, name)) in outside.into_iter().enumerate() {
            let irradiance = if k == last {
                std::mem::take(&mut rest)
            } else {
                let alone = form_factors.with_lights(scene, |light| scene.lights.is_in(group, light));
                let emission = emission_of(scene, patches, &[]);
                let radiometry = Radiometry { emission: &emission, ..patches.into() };
                let irradiance = solve(&alone, radiometry, options, progress)?.irradiance;
                take(&mut rest, &irradiance);
                irradiance
            };
            parts.push(LampLight { name, materials: Vec::new(), irradiance, slopes: Vec::new() });
        }
    }
    // Differences of solutions may be below zero within the tolerance of the solver.
    parts.iter_mut().flat_map(|part| &mut part.irradiance).for_each(|e| *e = e.max(0.0));
    share_slopes(whole, &mut parts);
    Ok(parts)
}

/// Divides what linear light adds to a solution among its parts.
fn share_slopes(whole: &Solution, parts: &mut [LampLight]) {
    let Some(linear) = &whole.linear else { return };
    let alike = 1.0 / parts.len() as f64;
    for (q, (&constant, &light)) in linear.constant.iter().zip(&whole.irradiance).enumerate() {
        for part in &mut *parts {
            let share = if constant > 0.0 { part.irradiance[q] / constant } else { alike };
            part.irradiance[q] = share * light;
            part.slopes.push(linear.slopes[q].map(|slope| share * slope));
        }
    }
}

/// A name for all lights that are no surfaces.
fn all_of(scene: &Scene) -> String {
    let names: Vec<&str> = scene.lights.names().collect();
    if names.len() > 4 { format!("{} lights", names.len()) } else { names.join(", ") }
}

/// The emitting materials, each with its name, by falling power; what exceeds `most` is one group.
fn groups(scene: &Scene, patches: &Patches, most: usize) -> Vec<(String, Vec<u32>)> {
    let channels = patches.channels();
    let mut power = vec![0.0; scene.materials.len()];
    for i in 0..patches.len() {
        let emitted: f64 = patches.emission()[i * channels..][..channels].iter().sum();
        power[scene.triangles[patches.triangle(i)].material as usize] += emitted * patches.area(i);
    }
    let mut emitting: Vec<u32> = (0..power.len() as u32).filter(|&m| power[m as usize] > 0.0).collect();
    emitting.sort_by(|&a, &b| power[b as usize].total_cmp(&power[a as usize]));
    let alone = if emitting.len() > most { most.saturating_sub(1) } else { emitting.len() };
    let others = emitting.split_off(alone);
    let name = |&m: &u32| (scene.materials[m as usize].name.clone(), vec![m]);
    let mut groups: Vec<(String, Vec<u32>)> = emitting.iter().map(name).collect();
    if !others.is_empty() {
        let name = if groups.is_empty() {
            "all materials".into()
        } else {
            format!("{} other materials", others.len())
        };
        groups.push((name, others));
    }
    groups
}

/// What the patches of some materials emit.
fn emission_of(scene: &Scene, patches: &Patches, materials: &[u32]) -> Vec<f64> {
    let channels = patches.channels();
    let mut emission = patches.emission().to_vec();
    for (i, values) in emission.chunks_exact_mut(channels).enumerate() {
        if !materials.contains(&scene.triangles[patches.triangle(i)].material) {
            values.fill(0.0);
        }
    }
    emission
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        form_factor::CastOptions,
        patch::Subdivision,
        scene::{
            Material,
            light::{Distant, Light, LightKind, PointLight, Sky, SkyModel, Up},
        },
        trace::Tracer,
    };
    use glam::{DVec3, dvec3};

    /// A floor under two lamps, open to the sky.
    fn scene(sky: bool) -> Scene {
        let triangle = |at: DVec3, u: DVec3, v: DVec3| [at, at + u, at + v];
        let materials = vec![
            Material::new("floor", [0.6, 0.5, 0.4], [0.0; 3]),
            Material::new("red", [0.2; 3], [4.0, 0.0, 0.0]),
            Material::new("green", [0.2; 3], [0.0, 9.0, 0.0]),
        ];
        let mut scene = Scene::new(
            &[
                (triangle(DVec3::ZERO, dvec3(0., 0., 4.), dvec3(4., 0., 0.)), 0),
                (triangle(dvec3(0., 1., 0.), DVec3::X, DVec3::Z), 1),
                (triangle(dvec3(2., 1., 0.), DVec3::X, DVec3::Z), 2),
            ],
            materials,
        );
        scene.lights.sky = sky.then(|| Sky::with_irradiance(SkyModel::Overcast, Up::Y, [1.0, 1.0, 2.0]));
        scene
    }

    fn parts(scene: &Scene, most: usize) -> (Solution, Vec<LampLight>) {
        let (tracer, progress) = (Tracer::new(scene), Progress::new());
        let mut patches = Patches::subdivide(scene, &Subdivision::Count(100));
        let cast = CastOptions::default().with_rays(64.0);
        let form_factors = FormFactors::cast(scene, &tracer, &mut patches, &cast, &progress).unwrap();
        let options = SolveOptions::default();
        let whole = solve(&form_factors, &patches, &options, &progress).unwrap();
        let parts = by_lamp(scene, (&form_factors, &patches), &whole, most, &options, &progress).unwrap();
        (whole, parts)
    }

    /// The sum is the whole within the tolerance, and the red lamp gives no green: colours do not mix by reflection.
    #[test]
    fn parts_sum_to_the_whole_and_keep_their_colours() {
        for sky in [false, true] {
            let (whole, parts) = parts(&scene(sky), 8);
            let names: Vec<&str> = parts.iter().map(|part| &part.name[..]).collect();
            assert_eq!(names, if sky { vec!["green", "red", "sky"] } else { vec!["green", "red"] });
            let largest = whole.irradiance.iter().copied().fold(0.0, f64::max);
            for q in 0..whole.irradiance.len() {
                let sum: f64 = parts.iter().map(|part| part.irradiance[q]).sum();
                assert!((sum - whole.irradiance[q]).abs() < 1e-8 * largest, "{q}");
                let (green, red) = (&parts[0].irradiance, &parts[1].irradiance);
                let stray = if q % 3 == 0 { green[q] } else { red[q] };
                assert!(stray < 1e-8 * largest, "{q}: {stray}");
            }
            assert_eq!((&parts[0].materials[..], &parts[1].materials[..]), (&[2][..], &[1][..]));
        }
    }

    /// Sun, bulb and sky have a part each. Each part is the light of a scene with that light alone: the same rays give it
    /// up to the choice among lights, so the fluxes agree within 2 %.
    #[test]
    fn sun_points_and_sky_have_parts_of_their_own() {
        let mut all = scene(true);
        let sun = Distant::new(dvec3(0.3, 1.0, 0.2), [3.0, 3.0, 2.0], 0.01);
        let bulb = PointLight::isotropic(dvec3(3.0, 0.7, 0.6), [2.0; 3]);
        all.lights.list.push(Light::new("sun", LightKind::Distant(sun)));
        all.lights.list.push(Light::new("bulb", LightKind::Point(bulb)));
        let (whole, parts) = parts(&all, 8);
        let names: Vec<&str> = parts.iter().map(|part| &part.name[..]).collect();
        assert_eq!(names, ["green", "red", "sun", "bulb", "sky"]);
        let flux = |irradiance: &[f64]| irradiance.iter().sum::<f64>();
        let sum: f64 = parts.iter().map(|part| flux(&part.irradiance)).sum();
        assert!((sum / flux(&whole.irradiance) - 1.0).abs() < 1e-9);
        for part in &parts[2..] {
            let mut alone = all.clone();
            alone.materials.iter_mut().for_each(|material| material.emission = [0.0; 3]);
            alone.lights.retain(|name| name == part.name);
            let (alone, _) = self::parts(&alone, 1);
            let ratio = flux(&part.irradiance) / flux(&alone.irradiance);
            assert!((ratio - 1.0).abs() < 0.02, "{}: {ratio}", part.name);
        }
        let few: Vec<String> = self::parts(&all, 2).1.into_iter().map(|part| part.name).collect();
        assert_eq!(few, ["all materials", "sun, bulb, sky"]);
    }

    #[test]
    fn few_parts_hold_many_lamps() {
        assert!(parts(&scene(false), 1).1.is_empty());
        let (whole, parts) = parts(&scene(true), 2);
        assert_eq!((&parts[0].name[..], &parts[0].materials[..]), ("all materials", &[2, 1][..]));
        assert_eq!(parts.len(), 2);
        let sum: f64 = parts.iter().flat_map(|part| &part.irradiance).sum();
        assert!((sum / whole.irradiance.iter().sum::<f64>() - 1.0).abs() < 1e-9);
    }
}
