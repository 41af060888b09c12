//! Where things are: a space of unit radius, the camera, and the sky around.

use glam::DVec3;
use serde_json::{Value, json};

use super::{document::Values, numbers::shared_exponent};
use crate::{monte_carlo::Camera, scene::Scene};

/// Texels around the horizon and from the zenith to the nadir. They show a smooth sky; the disc of the sun falls between them.
const SKY: [usize; 2] = [256, 128];

/// A ball that holds all vertices of a scene. Positions in it need no more than single precision, in any unit of length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Ball {
    pub centre: DVec3,
    pub radius: f64,
}

impl Ball {
    pub fn around(vertices: &[DVec3]) -> Ball {
        let (low, high) = vertices
            .iter()
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &p| (low.min(p), high.max(p)));
        let radius = 0.5 * (high - low).length();
        match radius > 0.0 && radius.is_finite() {
            true => Ball { centre: low + 0.5 * (high - low), radius },
            false => Ball { centre: DVec3::ZERO, radius: 1.0 },
        }
    }

    pub fn place(&self, positions: &[DVec3]) -> Vec<f32> {
        let inside = |p: &DVec3| ((*p - self.centre) / self.radius).to_array();
        positions.iter().flat_map(inside).map(|x| x as f32).collect()
    }
}

/// The first view.
pub(crate) fn camera(camera: &Camera) -> Value {
    json!({
        "eye": camera.eye().to_array(), "look_at": camera.look_at().to_array(), "fov": camera.fov(),
        "width": camera.width(), "height": camera.height(),
    })
}

/// What is seen beyond the surfaces, over a unit of radiosity; none where it is dark.
pub(crate) fn sky(scene: &Scene, unit: f64) -> Option<(Value, Values)> {
    scene.lights.sky.as_ref()?;
    let [width, height] = SKY;
    let texel = |k: usize| {
        let around = ((k % width) as f64 + 0.5) / width as f64 * std::f64::consts::TAU - std::f64::consts::PI;
        let down = ((k / width) as f64 + 0.5) / height as f64 * std::f64::consts::PI;
        let direction = DVec3::new(down.sin() * around.cos(), down.cos(), down.sin() * around.sin());
        shared_exponent(scene.lights.seen(direction).map(|radiance| radiance / unit))
    };
    let texels = (0..width * height).map(texel).collect();
    Some((json!({"width": width, "height": height}), Values::U32(texels)))
}
