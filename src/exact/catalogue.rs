//! Pairs of surfaces with a formula in Howell's catalogue.
//!
//! The catalogue's expressions lose all digits if one length is far from the others, since they subtract nearly equal
//! arc tangents. Here they are rearranged so that no rounded numbers are subtracted.

use std::f64::consts::PI;

use super::rectangle::{Axis, AxisRectangle};

fn assert_lengths(lengths: &[f64]) {
    assert!(
        lengths.iter().all(|l| l.is_finite() && *l > 0.0),
        "lengths must be finite and positive: {lengths:?}"
    );
}

/// The form factor between two parallel, directly opposed `a` x `b` rectangles at `distance` (Howell C-11).
///
/// The relative error is a few units in the last place for any ratio of the three lengths.
///
/// # Panics
///
/// If a length is not finite and positive.
pub fn opposed_rectangles(a: f64, b: f64, distance: f64) -> f64 {
    assert_lengths(&[a, b, distance]);
    let (x, y) = (a / distance, b / distance);
    let logarithm = 0.5 * (x * x / (1.0 + x * x + y * y) * (y * y)).ln_1p();
    2.0 / (PI * x * y) * (logarithm + x * arc_difference(x, y) + y * arc_difference(y, x))
}

/// sqrt(1+y²) atan(x/sqrt(1+y²)) - atan(x), with the difference of the two arcs as one arc.
fn arc_difference(x: f64, y: f64) -> f64 {
    let q = 1.0f64.hypot(y);
    let q_minus_1 = y * y / (q + 1.0);
    q_minus_1 * (x / q).atan() - (x * q_minus_1 / (q + x * x)).atan()
}

/// The form factor from a rectangle `length` x `width` to a rectangle `length` x `height` at a right angle to it. They
/// share the edge of that `length` (Howell C-14).
///
/// The relative error is a few units in the last place for any ratio of the three lengths.
///
/// # Panics
///
/// If a length is not finite and positive.
pub fn perpendicular_rectangles(length: f64, width: f64, height: f64) -> f64 {
    assert_lengths(&[length, width, height]);
    let (w, h) = (width / length, height / length);
    let (large, small) = (w.max(h), w.min(h));
    let s = w.hypot(h);
    // With c(x) = atan(1/x): large c(large) - s c(s), where s - large = small² / (s + large).
    let excess = small * (small / (s + large));
    let arcs = small * (1.0 / small).atan() - excess * (1.0 / large).atan()
        + s * (excess / (1.0 + s * large)).atan();
    let (w2, h2, s2) = (w * w, h * h, s * s);
    let power = |a2: f64, b2: f64| {
        // ln[a²(1+s²) / ((1+a²) s²)] is ln(1 - loss); near loss = 1 the quotient itself is the accurate form.
        let loss = b2 / s2 / (1.0 + a2);
        a2 * if loss < 0.5 { (-loss).ln_1p() } else { (a2 / s2 * (1.0 + s2) / (1.0 + a2)).ln() }
    };
    let logarithms = (w2 / (1.0 + s2) * h2).ln_1p() + power(w2, h2) + power(h2, w2);
    (arcs + 0.25 * logarithms) / (PI * w)
}

/// The form factor from a disk of radius `r1` to a parallel disk of radius `r2` on the same axis at `distance`
/// (Howell C-41).
///
/// The relative error is a few units in the last place for any ratio of the three lengths.
///
/// # Panics
///
/// If a length is not finite and positive.
pub fn coaxial_disks(r1: f64, r2: f64, distance: f64) -> f64 {
    assert_lengths(&[r1, r2, distance]);
    let (q, k) = (r2 / r1, distance / r1);
    // The catalogue's smaller root (X - sqrt(X² - 4q²)) / 2 as the product of roots over the larger one, and its
    // discriminant as (X - 2q)(X + 2q): neither subtracts nearly equal numbers.
    let root = k.hypot(1.0 - q) * k.hypot(1.0 + q);
    2.0 * q * q / (1.0 + q * q + k * k + root)
}

/// The form factor between two parallel, directly opposed squares of `side` at `distance`, with an opaque square of
/// side `blocker` centred midway between them and parallel to them.
///
/// A ray is blocked if the midpoint of its two end points is inside the blocker. Along one axis, the end points with a
/// difference d for which this holds have measure min(blocker, side - |d|). Two unblocked intervals of lengths
/// `blocker` and `2 side - blocker` have the same measure. So the blocked light is the unblocked exchange between two
/// concentric squares of these sides at the same distance.
///
/// # Panics
///
/// If `side` or `distance` is not finite and positive, or `blocker` is not between 0 and `side`.
pub fn opposed_squares_with_blocker(side: f64, distance: f64, blocker: f64) -> f64 {
    assert_lengths(&[side, distance]);
    assert!((0.0..=side).contains(&blocker), "the blocker's side {blocker} must be between 0 and {side}");
    let square = |offset: f64, half: f64, positive: bool| AxisRectangle {
        axis: Axis::Z,
        positive,
        offset,
        min: [-half; 2],
        max: [half; 2],
    };
    let stopped =
        square(0.0, 0.5 * blocker, true).exchange_area(&square(distance, side - 0.5 * blocker, false));
    (opposed_rectangles(side, side, distance) - stopped / (side * side)).max(0.0)
}
