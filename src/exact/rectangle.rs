//! Axis-aligned rectangles in any position, and the exact form-factor matrix of a box room.

use std::f64::consts::PI;

use glam::DVec3;
use nalgebra::DMatrix;

use super::cubature;

/// A coordinate axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// The first coordinate.
    X,
    /// The second coordinate.
    Y,
    /// The third coordinate.
    Z,
}

/// A rectangle at a right angle to an axis, seen from one side only.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisRectangle {
    /// The axis parallel to the normal of the rectangle.
    pub axis: Axis,
    /// Whether the front, the side that exchanges light, faces towards larger coordinates.
    pub positive: bool,
    /// The coordinate of its plane along `axis`.
    pub offset: f64,
    /// Its least coordinates along the two axes that follow `axis` in the cycle X, Y, Z, X.
    pub min: [f64; 2],
    /// Its greatest coordinates along the same two axes.
    pub max: [f64; 2],
}

/// An interval of one coordinate.
type Span = [f64; 2];

/// The smaller rectangle counts as small if its distance to the other is at least this many radii of its bounding
/// circle. The corner sums lose as many digits as the product of the areas is below the fourth power of the distance,
/// about 4 at this ratio. From here on the cubature is more accurate and needs at most 8 points per side.
const FAR: f64 = 8.0;

impl AxisRectangle {
    /// The area.
    pub fn area(&self) -> f64 {
        (self.max[0] - self.min[0]) * (self.max[1] - self.min[1])
    }

    /// The unit normal on the front.
    pub fn normal(&self) -> DVec3 {
        DVec3::AXES[self.axis as usize] * self.sign()
    }

    /// The corners, counterclockwise as seen from the front.
    pub fn corners(&self) -> [DVec3; 4] {
        let ([u0, v0], [u1, v1]) = (self.min, self.max);
        let at = |u: f64, v: f64| {
            let a = self.axis as usize;
            let mut p = DVec3::ZERO;
            (p[a], p[(a + 1) % 3], p[(a + 2) % 3]) = (self.offset, u, v);
            p
        };
        if self.positive {
            [at(u0, v0), at(u1, v0), at(u1, v1), at(u0, v1)]
        } else {
            [at(u0, v0), at(u0, v1), at(u1, v1), at(u1, v0)]
        }
    }

    /// The form factor from this rectangle to another: the exchange area over this rectangle's area.
    ///
    /// # Panics
    ///
    /// Like [`exchange_area`](Self::exchange_area), and if this rectangle has no area.
    pub fn form_factor(&self, other: &AxisRectangle) -> f64 {
        assert!(self.area() > 0.0, "a rectangle without area has no form factor");
        self.exchange_area(other) / self.area()
    }

    /// The exchange area A1 F12 of two rectangles. It is 0 unless each has a part in front of the other.
    ///
    /// It is a sum over the corners of the fourth antiderivative of the kernel (Howell C-13 and C-15; J. R. Ehlert and
    /// T. F. Smith, "View factors for perpendicular and parallel rectangular plates", J. Thermophysics and Heat
    /// Transfer 7(1), 1993). Perpendicular rectangles that reach across the line where their planes meet count with
    /// their parts in front of the other's plane.
    ///
    /// # Panics
    ///
    /// If a coordinate is not finite, or a `min` exceeds its `max`.
    pub fn exchange_area(&self, other: &AxisRectangle) -> f64 {
        self.check();
        other.check();
        let Some((a, b)) = self.mutually_visible(other) else { return 0.0 };
        if a.area() == 0.0 || b.area() == 0.0 {
            return 0.0;
        }
        let far = cubature::exchange_if_far(
            (&a.corners(), a.normal()),
            (&b.corners(), b.normal()),
            FAR,
            f64::EPSILON,
        );
        far.unwrap_or_else(|| {
            let sum = if a.axis == b.axis { parallel(&a, &b) } else { perpendicular(&a, &b) };
            sum.clamp(0.0, a.area().min(b.area()))
        })
    }

    fn sign(&self) -> f64 {
        if self.positive { 1.0 } else { -1.0 }
    }

    fn check(&self) {
        let numbers = [self.offset, self.min[0], self.min[1], self.max[0], self.max[1]];
        assert!(numbers.iter().all(|x| x.is_finite()), "coordinates must be finite: {self:?}");
        assert!(self.min[0] <= self.max[0] && self.min[1] <= self.max[1], "min exceeds max: {self:?}");
    }

    /// The index in `min` and `max` of an axis other than its own.
    fn slot(&self, axis: Axis) -> usize {
        (axis as usize + 2 - self.axis as usize) % 3
    }

    fn span(&self, axis: Axis) -> Span {
        [self.min[self.slot(axis)], self.max[self.slot(axis)]]
    }

    /// The part in front of another rectangle's plane.
    fn in_front_of(mut self, other: &AxisRectangle) -> Option<AxisRectangle> {
        if self.axis == other.axis {
            return ((self.offset - other.offset) * other.sign() > 0.0).then_some(self);
        }
        let k = self.slot(other.axis);
        if other.positive {
            self.min[k] = self.min[k].max(other.offset);
        } else {
            self.max[k] = self.max[k].min(other.offset);
        }
        (self.min[k] < self.max[k]).then_some(self)
    }

    fn mutually_visible(&self, other: &AxisRectangle) -> Option<(AxisRectangle, AxisRectangle)> {
        Some((self.in_front_of(other)?, other.in_front_of(self)?))
    }
}

/// The sum of the antiderivative over both ends of four spans, with alternating signs.
fn corner_sum(spans: [Span; 4], antiderivative: impl Fn(f64, f64, f64, f64) -> f64) -> f64 {
    let [x, xi, y, eta] = spans;
    let mut sum = 0.0;
    for corner in 0..16 {
        let [i, j, k, l] = [0, 1, 2, 3].map(|bit| (corner >> bit) & 1);
        let sign = if (i + j + k + l) % 2 == 0 { 1.0 } else { -1.0 };
        sum += sign * antiderivative(x[i], xi[j], y[k], eta[l]);
    }
    sum.abs() / (2.0 * PI)
}

/// `factor` ln(`argument`), with the limit 0 if both vanish.
fn times_ln(factor: f64, argument: f64) -> f64 {
    if argument > 0.0 { factor * argument.ln() } else { 0.0 }
}

fn parallel(a: &AxisRectangle, b: &AxisRectangle) -> f64 {
    let (u, v) = next_axes(a.axis);
    let spans = [a.span(u), b.span(u), a.span(v), b.span(v)];
    let distance = (a.offset - b.offset).abs();
    let unit = distance.max(reach(spans[0], spans[1])).max(reach(spans[2], spans[3]));
    let z = distance / unit;
    let sum = corner_sum(spans, |x, xi, y, eta| {
        let (dx, dy) = ((x - xi) / unit, (y - eta) / unit);
        let (sx, sy) = (dx.hypot(z), dy.hypot(z));
        dy * sx * dy.atan2(sx) + dx * sy * dx.atan2(sy) - 0.5 * times_ln(z * z, dx * dx + dy * dy + z * z)
    });
    sum * unit * unit
}

fn perpendicular(a: &AxisRectangle, b: &AxisRectangle) -> f64 {
    let (u, v) = next_axes(a.axis);
    let common = if b.axis == u { v } else { u };
    // Distances from the line where the planes meet. Both spans lie on one side of it by now.
    let x = a.span(b.axis).map(|c| c - b.offset);
    let xi = b.span(a.axis).map(|c| c - a.offset);
    let spans = [x, xi, a.span(common), b.span(common)];
    let unit = reach(x, [0.0; 2]).max(reach(xi, [0.0; 2])).max(reach(spans[2], spans[3]));
    let sum = corner_sum(spans, |x, xi, y, eta| {
        let (d, r) = ((y - eta) / unit, (x / unit).hypot(xi / unit));
        d * r * d.atan2(r) - 0.25 * times_ln((r - d) * (r + d), r * r + d * d)
    });
    sum * unit * unit
}

fn next_axes(axis: Axis) -> (Axis, Axis) {
    match axis {
        Axis::X => (Axis::Y, Axis::Z),
        Axis::Y => (Axis::Z, Axis::X),
        Axis::Z => (Axis::X, Axis::Y),
    }
}

/// The greatest distance from a point of one span to a point of the other.
fn reach(a: Span, b: Span) -> f64 {
    (a[1] - b[0]).abs().max((b[1] - a[0]).abs())
}

/// The six faces of a box room from the origin to `size`. Each is cut into `n` x `n` equal patches that face inward.
///
/// The faces come in the order x = 0, x = `size.x`, then y and z likewise. On a face the coordinate of the axis that
/// follows the face's own axis in the cycle X, Y, Z, X varies fastest.
///
/// # Panics
///
/// If `n` is 0 or a size is not finite and positive.
pub fn box_room_patches(size: DVec3, n: usize) -> Vec<AxisRectangle> {
    assert!(n > 0, "a face needs at least one patch");
    assert!(size.is_finite() && size.min_element() > 0.0, "a room needs a finite, positive size: {size}");
    let mut patches = Vec::with_capacity(6 * n * n);
    let at = |axis: Axis, i: usize| size[axis as usize] * (i as f64 / n as f64);
    for axis in [Axis::X, Axis::Y, Axis::Z] {
        let (u, v) = next_axes(axis);
        for positive in [true, false] {
            let offset = if positive { 0.0 } else { size[axis as usize] };
            for (j, i) in (0..n).flat_map(|j| (0..n).map(move |i| (j, i))) {
                let (min, max) = ([at(u, i), at(v, j)], [at(u, i + 1), at(v, j + 1)]);
                patches.push(AxisRectangle { axis, positive, offset, min, max });
            }
        }
    }
    patches
}

/// The dense matrix of form factors F_ij from patch i (row) to patch j (column), ignoring anything between them.
///
/// In a room of [`box_room_patches`] nothing lies between them, and every row sums to 1.
///
/// # Panics
///
/// If a patch has no area or coordinates that are not finite.
pub fn rectangle_form_factors(patches: &[AxisRectangle]) -> DMatrix<f64> {
    DMatrix::from_fn(patches.len(), patches.len(), |i, j| patches[i].form_factor(&patches[j]))
}
