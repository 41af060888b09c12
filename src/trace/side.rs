//! Where rays leave a surface.

use glam::{BVec3A, DVec3, Vec3A};

use super::{Hit, Tracer};
use crate::scene::direction;

/// Fourteen roundings, each of at most half a unit in the last place: of a point on a triangle and of the intersection test.
const CLEARANCE: f32 = 14.0 * 0.5 * f32::EPSILON;

/// A side of a surface, for rays to leave.
///
/// Rays begin above their surface, because rounding moves the point and the triangle's plane. Rounding is relative to the coordinates
/// of the corners, and only its component along the normal matters. So the height above the surface is relative to that component: from
/// a floor at height zero of unit space rays begin on the floor itself, however large it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Side {
    /// Unit normal.
    pub normal: Vec3A,
    /// The largest magnitude of coordinates, by axis.
    reach: Vec3A,
}

impl Side {
    pub(crate) fn new(normal: Vec3A, reach: Vec3A) -> Side {
        Side { normal, reach }
    }

    /// The same surface seen with another normal, that of a sensor on it.
    pub(crate) fn turned(&self, normal: Vec3A) -> Side {
        // As high above the surface as before.
        let cosine = self.normal.dot(normal).max(0.5);
        let height = self.normal.abs().dot(self.reach) / (cosine * normal.abs().element_sum());
        Side { normal, reach: Vec3A::splat(height) }
    }

    /// How far above the surface rays begin.
    #[inline]
    pub(crate) fn clearance(&self) -> f32 {
        CLEARANCE * self.normal.abs().dot(self.reach)
    }

    /// The origin of rays that leave the surface at the point `p`.
    #[inline]
    pub fn leave(&self, p: Vec3A) -> Vec3A {
        self.outward(p + self.normal * self.clearance())
    }

    /// The end of a segment from the point `p` of the surface to `other`, for [`Tracer::visible`](super::Tracer::visible).
    ///
    /// The ray begins at the end with the smaller coordinates. If it begins at `other`, the coordinates of `other` add to the rounding
    /// of this surface's plane.
    #[inline]
    pub fn leave_towards(&self, p: Vec3A, other: Vec3A) -> Vec3A {
        // No branch: which end is finer cannot be predicted.
        let of_other = Vec3A::select(BVec3A::splat(is_finer(other, p)), other.abs(), Vec3A::ZERO);
        Side { reach: self.reach.max(of_other), ..*self }.leave(p)
    }

    /// [`Side::leave`] for one coordinate of several points.
    #[inline]
    pub(crate) fn leave_along<const N: usize>(&self, points: &mut [f32; N], axis: usize) {
        let (higher, step) = ((self.normal * self.clearance())[axis], self.step()[axis]);
        for x in points {
            let moved = *x + higher;
            *x = moved + moved.abs() * step;
        }
    }

    /// Moves a point away from the surface by one unit in the last place.
    #[inline]
    fn outward(&self, p: Vec3A) -> Vec3A {
        p + p.abs() * self.step()
    }

    /// By axis, the multiple of a coordinate's magnitude that moves it outward by one unit in the last place.
    #[inline]
    fn step(&self) -> Vec3A {
        let step = Vec3A::splat(JUST_OVER_HALF_AN_ULP).copysign(self.normal);
        Vec3A::select(self.normal.cmpeq(Vec3A::ZERO), Vec3A::ZERO, step)
    }
}

/// A coordinate of magnitude x in \[2ᵉ, 2ᵉ⁺¹) has units of 2ᵉ⁻²³. This multiple of x is more than half of a unit and less than one and
/// a half, and so rounds to one.
const JUST_OVER_HALF_AN_ULP: f32 = 0.5 * f32::EPSILON * (1.0 + 1e-4);

/// The largest error of coordinates printed with six digits, as a share of the largest coordinate.
const PRINTED: f64 = 4e-6;

impl Tracer {
    /// How far before a light at a point of the file shadow rays end, in unit space, so that the surface on which the light is mounted
    /// does not hide it: by the rounding of printed and of unit-space coordinates.
    pub(crate) fn mounted(&self, point: DVec3) -> f32 {
        let reach = self.to_unit(point).abs().max(Vec3A::splat(self.space.least as f32));
        self.printed(point) + CLEARANCE * reach.length()
    }

    /// The rounding of printed coordinates of a point of the file, in unit space.
    fn printed(&self, point: DVec3) -> f32 {
        (PRINTED * (point.abs().max_element() / self.scale()).min(1.0)) as f32
    }

    /// Places a sensor, given by a point of the file and a normal, in unit space. The point need not lie on a surface. If it lies on a
    /// surface up to the rounding of printed coordinates, it is moved onto the surface, because just below it would be dark.
    ///
    /// # Panics
    /// When the normal is zero or not finite.
    pub fn place(&self, point: DVec3, normal: DVec3) -> (Vec3A, Side) {
        let normal = direction(normal).expect("a normal has a direction").as_vec3a();
        let at = self.to_unit(point);
        let near = self.printed(point);
        let surface = |hit: &Hit| self.triangles()[hit.triangle as usize].side(hit.front);
        let is_near = |hit: &Hit, distance: f32| distance <= near.max(surface(hit).clearance());
        let above = self.closest(at, normal).filter(|hit| is_near(hit, hit.t));
        // From a little higher, so that a surface right at the point counts, but not from beyond another one.
        let lift = above.map_or(near, |hit| near.min(0.5 * hit.t));
        let below = self.closest(at + normal * lift, -normal).filter(|hit| is_near(hit, hit.t - lift));
        let found = match (above, below) {
            // Below the front of a floor. In a gap between two surfaces a point lies on the lower one.
            (Some(above), Some(below)) if above.front || below.t - lift < above.t => Some(below),
            (Some(above), _) => Some(Hit { front: !above.front, ..above }),
            (None, below) => below,
        };
        match found {
            // Steep surfaces are met by chance, near an edge.
            Some(hit) if surface(&hit).normal.dot(normal) > 0.7 => {
                let on = self.triangles()[hit.triangle as usize].point(hit.barycentric);
                (on, surface(&hit).turned(normal))
            }
            _ => (at, self.side_at(at, normal)),
        }
    }
}

/// Whether rounding changes a point less than another one, at most.
#[inline]
pub(super) fn is_finer(p: Vec3A, than: Vec3A) -> bool {
    p.abs().max_element() < than.abs().max_element()
}
