//! The watertight ray/triangle test of Woop, Benthin and Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013.
//!
//! Vertices are moved to the ray's origin and sheared so that the ray runs along +z; an edge shared by two triangles
//! then gives both the same edge function up to its sign. Products must stay separate (no fused multiply-add), or the
//! two signs would round differently. A ray exactly on an edge counts as inside for both triangles: met twice, never
//! lost.

use glam::Vec3A;

/// A triangle as rays meet it: 64 bytes, a line of cache.
#[derive(Clone, Copy)]
pub(super) struct Facet {
    pub(super) corners: [Vec3A; 3],
    /// Unit normal of the front, not from the rounded corners: it leaves none of them by more than their rounding.
    pub(super) normal: Vec3A,
}

/// A ray, prepared: axes permuted so that z is the direction's largest, and the shear that takes the direction to +z.
pub(super) struct ShearedRay {
    origin: Vec3A,
    direction: Vec3A,
    axes: [usize; 3],
    shear: [f32; 2],
}

/// A triangle met, before the division by the determinant that only the closest one needs.
#[derive(Clone, Copy)]
pub(super) struct Met {
    pub(super) t: f32,
    /// Cosine to the front's normal times the length of the direction: negative for rays from the front.
    approach: f32,
    weights: [f32; 3],
    determinant: f32,
}

impl Met {
    pub(super) fn front(&self) -> bool {
        self.approach < 0.0
    }

    /// Whether this triangle is met before the other one.
    ///
    /// A ray that grazes the outline of a body meets a front and a back at distances that only rounding tells apart. It
    /// came from outside: the front counts.
    #[inline]
    pub(super) fn is_before(&self, other: &Met) -> bool {
        if self.front() == other.front() {
            return self.t < other.t;
        }
        let slack = self.rounding() + other.rounding();
        if self.front() { self.t <= other.t + slack } else { self.t + slack < other.t }
    }

    /// By how much `t` may be off: about eight roundings of coordinates near 1, more at grazing incidence, within
    /// reason.
    fn rounding(&self) -> f32 {
        (8.0 * 0.5 * f32::EPSILON / self.approach.abs()).min(1e-4 * self.t)
    }

    pub(super) fn barycentric(&self) -> [f32; 3] {
        self.weights.map(|w| w / self.determinant)
    }
}

impl ShearedRay {
    #[inline]
    pub(super) fn new(origin: Vec3A, direction: Vec3A) -> Self {
        let size = direction.abs();
        let kz = if size.x >= size.y && size.x >= size.z {
            0
        } else if size.y >= size.z {
            1
        } else {
            2
        };
        let (mut kx, mut ky) = ((kz + 1) % 3, (kz + 2) % 3);
        // Keeps the winding, so that the determinant's sign tells the side.
        if direction[kz] < 0.0 {
            std::mem::swap(&mut kx, &mut ky);
        }
        let inverse = 1.0 / direction[kz];
        ShearedRay {
            origin,
            direction,
            axes: [kx, ky, kz],
            shear: [direction[kx] * inverse, direction[ky] * inverse],
        }
    }

    /// The triangle where the ray meets it at a positive distance.
    ///
    /// The edge functions tell whether. Where, and from which side, the plane tells: in a long thin triangle distances
    /// interpolated between corners are off by the roundings of its length over its width, and rays would meet the
    /// surface they leave.
    #[inline]
    pub(super) fn intersect(&self, Facet { corners, normal }: &Facet) -> Option<Met> {
        let [kx, ky, kz] = self.axes;
        let [sx, sy] = self.shear;
        let [a, b, c] = corners.map(|v| v - self.origin);
        let (ax, ay) = (a[kx] - sx * a[kz], a[ky] - sy * a[kz]);
        let (bx, by) = (b[kx] - sx * b[kz], b[ky] - sy * b[kz]);
        let (cx, cy) = (c[kx] - sx * c[kz], c[ky] - sy * c[kz]);
        let u = cx * by - cy * bx;
        let v = ax * cy - ay * cx;
        let w = bx * ay - by * ax;
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return None;
        }
        let determinant = u + v + w;
        if determinant == 0.0 {
            return None;
        }
        let approach = normal.dot(self.direction);
        let t = normal.dot(a) / approach;
        // Written so that a NaN is a miss.
        if t > 0.0 { Some(Met { t, approach, weights: [u, v, w], determinant }) } else { None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
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
            let facet = Facet { corners: turned, normal };
            let inside = (turned[0] + turned[1] + turned[2]) / 3.0;
            for tilt in [Vec3A::ZERO, vec3a(0.1, -0.2, 0.05)] {
                for side in [1.0, -1.0] {
                    let origin = inside + normal * side + tilt;
                    let met = ShearedRay::new(origin, inside - origin).intersect(&facet).unwrap();
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
