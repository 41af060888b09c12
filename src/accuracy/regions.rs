//! Errors of the parts of a scene, relative to the light on each part.
//!
//! The error of a whole scene is relative to its mean irradiance. If one room is bright and another dim, this error
//! shows nothing about the dim room.

use std::collections::BTreeMap;

use super::error_bars::relative_rms;
use crate::{patch::Patches, scene::Scene};

/// The sampling error of the surfaces of one material or object.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RegionError {
    /// Name of the material or object, as in `material wall` or `object lamp`.
    pub region: String,
    /// Area-weighted root mean square of the standard errors in the region, relative to the mean irradiance of the
    /// region.
    pub rms_relative: f64,
}

/// The errors of all materials, and of all objects that the file names, largest first. Regions that no light reaches
/// and patches that are shut in solids are left out. `irradiance` and `standard_error` have an entry per patch and channel.
///
/// # Panics
/// If the sizes disagree.
pub fn errors(
    scene: &Scene,
    patches: &Patches,
    irradiance: &[f64],
    standard_error: &[f64],
) -> Vec<RegionError> {
    let channels = patches.channels();
    let values = patches.len() * channels;
    assert_eq!((irradiance.len(), standard_error.len()), (values, values), "sizes disagree");
    let seen = patches.seen_areas(irradiance);
    let mut regions: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    for i in 0..patches.len() {
        let triangle = &scene.triangles[patches.triangle(i)];
        let material = &scene.materials[triangle.material as usize].name;
        regions.entry(format!("material {material}")).or_default().push(i);
        let face = scene.face_of_source(triangle.source).map(|face| &scene.faces[face]);
        let object = face.and_then(|face| scene.parts.get(face.part as usize)?.object.as_ref());
        if let Some(object) = object {
            regions.entry(format!("object {object}")).or_default().push(i);
        }
    }
    let mut errors: Vec<RegionError> = regions
        .into_iter()
        .map(|(region, of)| {
            let pick = |values: &[f64]| -> Vec<f64> {
                of.iter().flat_map(|&i| &values[channels * i..][..channels]).copied().collect()
            };
            let areas: Vec<f64> = of.iter().map(|&i| seen[i]).collect();
            let rms_relative = relative_rms(&pick(standard_error), &pick(irradiance), &areas);
            RegionError { region, rms_relative }
        })
        .filter(|error| error.rms_relative > 0.0)
        .collect();
    errors.sort_by(|a, b| b.rms_relative.total_cmp(&a.rms_relative));
    errors
}

#[cfg(test)]
mod tests {
    use glam::dvec3;

    use super::*;
    use crate::{patch::Subdivision, scene::Material};

    /// Two triangles have areas 1/2 and 2 and irradiances 4 ± 1 and 1/2 ± 1/4. Their relative errors are 1/4 and 1/2.
    #[test]
    fn errors_are_relative_to_the_light_of_their_region() {
        let triangle = |size: f64, z: f64| [dvec3(0.0, 0.0, z), dvec3(size, 0.0, z), dvec3(0.0, size, z)];
        let materials = ["bright", "dim"].map(|name| Material::new(name, [0.5; 3], [0.0; 3]));
        let scene = Scene::new(&[(triangle(1.0, 0.0), 0), (triangle(2.0, 1.0), 1)], materials.into());
        let patches = Patches::subdivide(&scene, &Subdivision::Edge(f64::INFINITY));
        let found = errors(&scene, &patches, &[4.0, 0.5], &[1.0, 0.25]);
        let reported: Vec<(&str, f64)> = found.iter().map(|e| (&*e.region, e.rms_relative)).collect();
        assert_eq!(reported, [("material dim", 0.5), ("material bright", 0.25)]);
        assert!(errors(&scene, &patches, &[4.0, 0.0], &[1.0, 0.0]).len() == 1);
    }
}
