//! The watertight ray/triangle test of Woop, Benthin and Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013.
//!
//! Vertices are moved to the ray's origin and sheared so that the ray runs along +z; an edge shared by two triangles
//! then gives both the same edge function up to its sign. Products must stay separate (no fused multiply-add), or the
//! two signs would round differently. A ray exactly on an edge counts as inside for both triangles: met twice, never
//! lost.

use glam::Vec3A;

/// A ray, prepared: axes permuted so that z is the direction's largest, and the shear that takes the direction to +z.
pub(super) struct ShearedRay {
    origin: Vec3A,
    axes: [usize; 3],
    shear: [f32; 3],
}

/// A triangle met, before the division by the determinant that only the closest one needs.
#[derive(Clone, Copy)]
pub(super) struct Met {
    pub(super) t: f32,
    pub(super) front: bool,
    weights: [f32; 3],
    determinant: f32,
}

impl Met {
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
            axes: [kx, ky, kz],
            shear: [direction[kx] * inverse, direction[ky] * inverse, inverse],
        }
    }

    /// The triangle where the ray meets it at a positive distance.
    #[inline]
    pub(super) fn intersect(&self, corners: &[Vec3A; 3]) -> Option<Met> {
        let [kx, ky, kz] = self.axes;
        let [sx, sy, sz] = self.shear;
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
        let t = sz * (u * a[kz] + v * b[kz] + w * c[kz]) / determinant;
        // Written so that a NaN is a miss.
        if t > 0.0 {
            Some(Met { t, front: determinant > 0.0, weights: [u, v, w], determinant })
        } else {
            None
        }
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
            let normal = (turned[1] - turned[0]).cross(turned[2] - turned[0]);
            let inside = (turned[0] + turned[1] + turned[2]) / 3.0;
            for tilt in [Vec3A::ZERO, vec3a(0.1, -0.2, 0.05)] {
                for side in [1.0, -1.0] {
                    let origin = inside + normal * side + tilt;
                    let met = ShearedRay::new(origin, inside - origin).intersect(&turned).unwrap();
                    assert_eq!(met.front, side > 0.0);
                    assert!((met.t - 1.0).abs() < 1e-6);
                    for b in met.barycentric() {
                        assert!((b - 1.0 / 3.0).abs() < 1e-6);
                    }
                }
            }
        }
    }
}
