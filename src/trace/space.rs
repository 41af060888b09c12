//! Unit space: where its origin is, and how long its unit.

use glam::DVec3;

use crate::scene::{Scene, centre_and_extent};

/// How a scene is moved and scaled for rays.
#[derive(Debug, Clone, Copy)]
pub(super) struct UnitSpace {
    /// The point of the file that becomes the origin.
    pub(super) origin: DVec3,
    /// File lengths per unit-space length: half of the longest side of the scene.
    pub(super) scale: f64,
    /// Magnitude of coordinates below which single precision is finer than the double precision of the file's.
    pub(super) least: f64,
}

/// The triangles whose size, relative to the scene, lies between one power of two and the next.
#[derive(Clone, Copy)]
struct Class {
    size: f64,
    low: DVec3,
    high: DVec3,
}

/// Sizes below 2⁻⁶⁰ of the scene count as 2⁻⁶⁰, since double precision has no more digits.
const CLASSES: usize = 61;

impl UnitSpace {
    /// Chooses the origin that minimises, over all triangles and axes, the largest ratio of a triangle's distance from the origin
    /// to the triangle's size. Single precision then resolves the worst triangle as well as it can. If all triangles have one
    /// size, the origin is the middle of the scene. With plates of a metre beneath a dome of kilometres, it lies at the plates.
    pub(super) fn of(scene: &Scene) -> UnitSpace {
        let (centre, scale) = centre_and_extent(scene.vertices.iter().copied());
        let mut classes: [Option<Class>; CLASSES] = [None; CLASSES];
        for t in 0..scene.triangles.len() {
            let [a, b, c] = scene.corners(t).map(|p| (p - centre) / scale);
            let size = (b - a).abs().max((c - b).abs()).max((a - c).abs()).max_element();
            let of_size = (-size.log2().floor()).clamp(0.0, (CLASSES - 1) as f64) as usize;
            let [low, high] = [a.min(b).min(c), a.max(b).max(c)];
            let class =
                classes[of_size].get_or_insert(Class { size: 0.5f64.powi(of_size as i32), low, high });
            (class.low, class.high) = (class.low.min(low), class.high.max(high));
        }
        let classes: Vec<Class> = classes.into_iter().flatten().collect();
        let along = |axis: usize| balanced(classes.iter().map(|c| (c.size, c.low[axis], c.high[axis])));
        let origin = centre + DVec3::new(along(0), along(1), along(2)) * scale;
        let digits = f64::EPSILON / f64::from(f32::EPSILON);
        let least = digits * (origin.abs().max_element() / scale).max(1.0);
        UnitSpace { origin, scale, least }
    }

    /// A point of the file in unit space.
    #[inline]
    pub(super) fn to_unit(self, point: DVec3) -> DVec3 {
        (point - self.origin) / self.scale
    }
}

/// The coordinate x for which the largest of (high - x) / size and (x - low) / size over all items is least.
///
/// All these are straight lines. The least value is the largest at which a falling one and a rising one cross (Helly's theorem
/// for half-lines).
fn balanced(items: impl Iterator<Item = (f64, f64, f64)> + Clone) -> f64 {
    let crossing = |(size, high): (f64, f64), (other, low): (f64, f64)| {
        ((high - low) / (size + other), (high * other + low * size) / (size + other))
    };
    let of_item = |(size, _, high): (f64, f64, f64)| {
        items.clone().map(move |(other, low, _)| crossing((size, high), (other, low)))
    };
    let crossings = items.clone().flat_map(of_item);
    crossings.reduce(|a, b| if b.0 > a.0 { b } else { a }).map_or(0.0, |(_, at)| at)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The middle of items of one size; by a small item, as near as its size over that of the whole.
    #[test]
    fn the_origin_is_by_the_finest_detail() {
        assert_eq!(balanced([(1.0, -3.0, 5.0)].into_iter()), 1.0);
        let at = balanced([(1.0, -1.0, 1.0), (1e-3, 0.5, 0.501)].into_iter());
        assert!((at - 0.5).abs() < 2e-3, "{at}");
        // As far from each, in multiples of its size.
        let at = balanced([(1e-3, 0.5, 0.5), (3e-3, -0.5, -0.5)].into_iter());
        assert!((at - 0.25).abs() < 1e-12, "{at}");
        assert_eq!(balanced(std::iter::empty()), 0.0);
    }
}
