//! Lights of KHR_lights_punctual: points and spots in candela, directional lights in lux.

use glam::DVec3;

use super::{container::Document, nodes::Nodes};
use crate::{
    Result,
    scene::{
        direction, is_radiance,
        light::{Distant, Distribution, Light, LightKind, PointLight},
    },
};

/// The lights that nodes of the scene place. Luminous quantities are divided by `efficacy`. The `range` of a light is
/// ignored, because real light has none.
///
/// # Errors
/// [`Error::Input`](crate::Error::Input) when a light is missing or has invalid numbers.
pub fn lights(document: &Document, nodes: &Nodes, efficacy: f64) -> Result<Vec<Light>> {
    let known = document.root.extensions.lights.as_ref().map_or(&[][..], |l| &l.lights[..]);
    let mut lights = Vec::new();
    for (i, node) in document.root.nodes.iter().enumerate() {
        let (Some(placed), Some(matrix)) = (&node.extensions.light, nodes.matrices[i]) else { continue };
        let failed = |what: &str| document.error(format!("nodes[{i}]: light {}: {what}", placed.light));
        let Some(light) = known.get(placed.light) else { return Err(failed("it does not exist")) };
        // The scale of a node does not change intensities.
        let axis = direction(matrix.transform_vector3(-DVec3::Z)).filter(|axis| axis.is_finite());
        let axis = axis.ok_or_else(|| failed("the scale of its node leaves it no direction"))?;
        let colour: [f64; 3] = std::array::from_fn(|c| light.color[c] * light.intensity / efficacy);
        if !colour.into_iter().all(is_radiance) {
            return Err(failed("its intensity is negative or not finite"));
        }
        let at = |distribution| {
            LightKind::Point(PointLight::new(matrix.transform_point3(DVec3::ZERO), colour, distribution))
        };
        let kind = match &light.kind[..] {
            "directional" => LightKind::Distant(Distant::new(-axis, colour, 0.0)),
            "point" => at(Distribution::Isotropic),
            "spot" => {
                let (inner, outer) = (light.spot.inner_cone_angle, light.spot.outer_cone_angle);
                if !(inner >= 0.0 && inner < outer && outer <= std::f64::consts::FRAC_PI_2) {
                    return Err(failed(
                        "its inner angle must be at least 0 and less than its outer angle, which must be at most 90 degrees",
                    ));
                }
                at(Distribution::spot(axis, inner, outer))
            }
            other => return Err(failed(&format!("`{other}` is not a type of light"))),
        };
        let name = light.name.as_ref().or(node.name.as_ref());
        let name = name.map_or_else(|| format!("light {}", placed.light), String::clone);
        lights.push(Light { name, kind });
    }
    Ok(lights)
}
