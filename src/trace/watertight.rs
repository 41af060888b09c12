//! The watertight ray/triangle test of Woop, Benthin and Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013.
//!
//! Vertices are moved to the ray's origin and sheared so that the ray runs along +z. Two triangles then compute the same edge
//! function for a shared edge, up to its sign. Products must stay separate: a fused multiply-add would round the two signs
//! differently. A ray exactly on an edge is inside both triangles: it hits twice and is never lost.

use glam::Vec3A;

/// A ray, prepared for boxes and triangles.
pub(super) struct PreparedRay {
    pub(super) origin: Vec3A,
    pub(super) direction: Vec3A,
    /// One over the direction, with zeros replaced.
    pub(super) inverse: Vec3A,
    /// The axes along which the direction is negative: the ray enters boxes at their high side.
    pub(super) backward: [bool; 3],
    /// The axes permuted so that z is the direction's largest.
    pub(super) axes: [usize; 3],
    /// The origin, permuted like the axes.
    pub(super) turned_origin: [f32; 3],
    /// The shear that takes the direction to +z.
    pub(super) shear: [f32; 2],
}

/// Largest rounding of a distance that counts as rounding, relative to the distance.
pub(super) const MOST_ROUNDING: f32 = 1e-4;

/// Factor on the distance where a ray leaves a box, and on that of the nearest hit. With u half an ulp: entry and exit have
/// relative errors of 3 u each (Ize, "Robust BVH Ray Traversal", JCGT 2(2), 2013). Vertices that the watertight test moves and
/// shears have 6 u of their distance along an axis. Together these are 6 ulp.
pub(super) const SLACK: f32 = 1.0 + 8.0 * f32::EPSILON;

/// A hit, before the division by the determinant, which only the closest hit needs.
#[derive(Clone, Copy)]
pub(super) struct Met {
    /// Index of the triangle in the scene.
    pub(super) triangle: u32,
    pub(super) t: f32,
    /// Cosine to the normal of the front, times the length of the direction. Negative for rays from the front.
    approach: f32,
    weights: [f32; 3],
}

impl Met {
    /// No hit: farther than all others.
    pub(super) const NONE: Met =
        Met { triangle: u32::MAX, t: f32::INFINITY, approach: 0.0, weights: [0.0; 3] };

    /// Whether this hit comes before another one: it is nearer, or its triangle has the lower index.
    #[inline(always)]
    pub(super) fn is_before(&self, other: &Met) -> bool {
        self.t < other.t || self.t == other.t && self.triangle < other.triangle
    }

    pub(super) fn front(&self) -> bool {
        self.approach < 0.0
    }

    /// Bound of the rounding of `t`: about eight roundings of the coordinates, and more at grazing incidence up to a limit. `reach` is
    /// the magnitude of the coordinates that `t` was computed from, as far as they are along the normal ([`PreparedRay::reach`]).
    pub(super) fn rounding(&self, reach: f32) -> f32 {
        (8.0 * 0.5 * f32::EPSILON * reach / self.approach.abs()).min(MOST_ROUNDING * self.t)
    }

    pub(super) fn barycentric(&self) -> [f32; 3] {
        let determinant = self.weights[0] + self.weights[1] + self.weights[2];
        let [u, v, w] = self.weights;
        [u / determinant, v / determinant, w / determinant]
    }
}

/// The two other axes, by the largest axis of a direction and by whether the direction is negative there.
const TURNED: [[[usize; 2]; 2]; 3] = [[[1, 2], [2, 1]], [[2, 0], [0, 2]], [[0, 1], [1, 0]]];

impl PreparedRay {
    #[inline(always)]
    pub(super) fn new(origin: Vec3A, direction: Vec3A) -> Self {
        let size = direction.abs();
        // Look-ups in arrays need no branch; the largest axis cannot be predicted.
        let (along, from) = (direction.to_array(), origin.to_array());
        let kz = if size.x.max(size.y) >= size.z { usize::from(size.x < size.y) } else { 2 };
        // Keeps the winding, so that the sign of the determinant is the side.
        let [kx, ky] = TURNED[kz][usize::from(along[kz] < 0.0)];
        let inverse = 1.0 / along[kz];
        // A component near zero is replaced by one with a finite inverse. Over the length of the scene this moves the ray by
        // far less than boxes are padded.
        let least = Vec3A::splat(along[kz].abs() * 1e-10);
        let safe = size.max(least).copysign(direction);
        PreparedRay {
            origin,
            direction,
            inverse: safe.recip(),
            backward: [
                direction.x.is_sign_negative(),
                direction.y.is_sign_negative(),
                direction.z.is_sign_negative(),
            ],
            axes: [kx, ky, kz],
            turned_origin: [from[kx], from[ky], from[kz]],
            shear: [along[kx] * inverse, along[ky] * inverse],
        }
    }

    /// Whether all values are finite, so that no distance to a box is NaN. Other rays hit nothing.
    #[inline(always)]
    pub(super) fn is_proper(&self) -> bool {
        self.origin.is_finite() && self.direction.is_finite() && self.inverse.is_finite()
    }

    /// The hit of the triangle with these edge functions, if its distance is positive.
    ///
    /// The edge functions decide whether the ray hits. Distance and side come from the triangle's plane. In a long thin
    /// triangle, distances interpolated between corners have rounding errors of its length over its width, and rays would hit
    /// the surface that they leave.
    #[inline(always)]
    pub(super) fn meet(
        &self,
        triangle: u32,
        (corner, normal): (Vec3A, Vec3A),
        weights: [f32; 3],
    ) -> Option<Met> {
        let approach = normal.dot(self.direction);
        let t = normal.dot(corner - self.origin) / approach;
        // Written so that a NaN is a miss.
        if t > 0.0 { Some(Met { triangle, t, approach, weights }) } else { None }
    }

    /// The magnitude of the coordinates from which [`PreparedRay::meet`] computes a distance, as far as they are along the normal.
    pub(super) fn reach(&self, corner: Vec3A, normal: Vec3A) -> f32 {
        normal.abs().dot(corner.abs().max(self.origin.abs()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::{
        UnitTriangle,
        bvh::Leaf,
        wide::{Lanes, Portable},
    };
    use glam::vec3a;

    #[test]
    fn counter_clockwise_is_the_front_from_every_direction() {
        let corners = [vec3a(0.0, 0.0, 0.0), vec3a(1.0, 0.0, 0.0), vec3a(0.0, 1.0, 0.0)];
        for axis in 0..3 {
            // Cyclic permutations keep the winding.
            let turned = corners.map(|p| {
                let mut q = Vec3A::ZERO;
                for k in 0..3 {
                    q[(k + axis) % 3] = p[k];
                }
                q
            });
            let normal = (turned[1] - turned[0]).cross(turned[2] - turned[0]).normalize();
            let triangle = UnitTriangle::new(turned.map(|p| p.as_dvec3()), normal, [0.0; 3], 0.0);
            let leaf = Leaf::new(&[0], &[triangle]);
            let inside = (turned[0] + turned[1] + turned[2]) / 3.0;
            for tilt in [Vec3A::ZERO, vec3a(0.1, -0.2, 0.05)] {
                for side in [1.0, -1.0] {
                    let origin = inside + normal * side + tilt;
                    let ray = PreparedRay::new(origin, inside - origin);
                    let (hit, edges) = Portable.edges(&leaf, &ray);
                    assert_eq!(hit, 1, "one lane holds a triangle");
                    let met =
                        ray.meet(0, (turned[0], normal), [edges[0][0], edges[1][0], edges[2][0]]).unwrap();
                    assert_eq!(met.front(), side > 0.0);
                    assert!((met.t - 1.0).abs() < 1e-6);
                    for b in met.barycentric() {
                        assert!((b - 1.0 / 3.0).abs() < 1e-6);
                    }
                }
            }
        }
    }
}
