//! The exposure of pictures and vertex colours.

use crate::{
    patch::Patches,
    tone::{Exposure, luminance, rgb},
};

/// Automatic exposure ([`Exposure::automatic`]), weighted by area, for the lit surfaces that do not emit and that can
/// be seen ([`Patches::seen_areas`]). Lamps may clip. Unlit surfaces and the unit of length have no influence. A scene
/// without light is black.
///
/// # Panics
/// If `radiosity` does not have a value per patch and channel.
pub fn of_radiosity(patches: &Patches, radiosity: &[f64]) -> Exposure {
    let channels = patches.channels();
    assert_eq!(radiosity.len(), channels * patches.len(), "one value per patch and channel is needed");
    let emits = |i: usize| patches.emission()[i * channels..][..channels].iter().any(|&e| e > 0.0);
    let bright = |i: usize| luminance(rgb(&radiosity[i * channels..][..channels]));
    let areas = patches.seen_areas(radiosity);
    let of = |i: usize| (bright(i), areas[i]);
    let is_wall = |i: &usize| !emits(*i) && bright(*i) > 0.0 && areas[*i] > 0.0;
    if (0..patches.len()).any(|i| is_wall(&i)) {
        Exposure::automatic((0..patches.len()).filter(is_wall).map(of))
    } else {
        Exposure::automatic((0..patches.len()).map(of))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Scene, patch::Subdivision, scene::Material};
    use glam::DVec3;

    /// Right triangles with legs of 1. The first one emits.
    fn squares(n: usize) -> Patches {
        let materials =
            vec![Material::new("lamp", [0.5; 3], [9.0; 3]), Material::new("wall", [0.5; 3], [0.0; 3])];
        let triangles: Vec<_> = (0..n)
            .map(|k| {
                let x = DVec3::X * (2 * k) as f64;
                ([x, x + DVec3::X, x + DVec3::Y], u32::from(k > 0))
            })
            .collect();
        Patches::subdivide(&Scene::new(&triangles, materials), &Subdivision::Edge(f64::INFINITY))
    }

    #[test]
    fn exposure_goes_by_lit_walls_not_by_lamps_or_darkness() {
        // A lamp, three dark walls and ten lit ones. The brightest wall may exceed the target.
        let mut radiosity = vec![1000.0, 0.0, 0.0, 0.0];
        radiosity.extend((1..=10).map(f64::from));
        let exposure = of_radiosity(&squares(14), &radiosity);
        assert!((exposure.scale - 0.8 / 9.0).abs() < 1e-15);
    }

    #[test]
    fn exposure_of_darkness_and_of_lamps_alone_is_finite() {
        assert_eq!(of_radiosity(&squares(3), &[0.0; 3]).encode([0.0; 3]), [0; 3]);
        assert!((of_radiosity(&squares(1), &[5.0]).scale - 0.8 / 5.0).abs() < 1e-15);
        assert!(of_radiosity(&squares(2), &[0.0, 1e-310]).scale.is_finite());
    }
}
