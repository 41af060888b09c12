//! Exact rasterisation: triangles are clipped to the squares of texels.
//!
//! Texel (x, y) is the square from (x, y) to (x + 1, y + 1). Rows are counted from the bottom, like texture
//! coordinates.

use glam::DVec2;

/// Largest number of corners. A triangle has 3; each of the 4 sides of a texel and of the 6 lines of a quadtree cell
/// adds at most one. The rest is for corners that rounding duplicates.
const MOST_CORNERS: usize = 20;

/// A convex polygon.
#[derive(Debug, Clone, Copy)]
pub struct Polygon {
    points: [DVec2; MOST_CORNERS],
    len: usize,
}

impl Polygon {
    /// A triangle.
    pub fn triangle(corners: [DVec2; 3]) -> Polygon {
        let mut points = [DVec2::ZERO; MOST_CORNERS];
        points[..3].copy_from_slice(&corners);
        Polygon { points, len: 3 }
    }

    /// Its corners in order; fewer than three if the polygon is empty.
    pub fn corners(&self) -> &[DVec2] {
        &self.points[..self.len]
    }

    /// The polygon whose corners are the images of this one's.
    pub fn map(mut self, image: impl Fn(DVec2) -> DVec2) -> Polygon {
        self.points[..self.len].iter_mut().for_each(|p| *p = image(*p));
        self
    }

    /// The part where the affine function `inside` is not negative (Sutherland and Hodgman, CACM 17(1), 1974).
    ///
    /// Cutting with the negated function makes the same corners, bit by bit, so the two parts fit together.
    pub fn cut(&self, inside: impl Fn(DVec2) -> f64) -> Polygon {
        let mut part = Polygon { points: [DVec2::ZERO; MOST_CORNERS], len: 0 };
        let Some(&last) = self.corners().last() else { return part };
        let (mut from, mut at_from) = (last, inside(last));
        for &to in self.corners() {
            let at_to = inside(to);
            if (at_from < 0.0) != (at_to < 0.0) {
                let crossing = from + (to - from) * (at_from / (at_from - at_to));
                // The corner that is inside is pushed below; do not push it twice.
                if crossing != if at_to < 0.0 { from } else { to } {
                    part.push(crossing);
                }
            }
            if at_to >= 0.0 {
                part.push(to);
            }
            (from, at_from) = (to, at_to);
        }
        part
    }

    /// The part where an affine function is between `low` and `high`.
    pub fn strip(&self, low: f64, high: f64, value: impl Fn(DVec2) -> f64) -> Polygon {
        self.cut(|p| value(p) - low).cut(|p| high - value(p))
    }

    fn push(&mut self, point: DVec2) {
        if self.len < MOST_CORNERS {
            self.points[self.len] = point;
            self.len += 1;
        }
    }

    /// Its area, independent of its orientation.
    pub fn area(&self) -> f64 {
        let fan = self.fan().map(|[a, b, c]| (b - a).perp_dot(c - a)).sum::<f64>();
        0.5 * fan.abs()
    }

    /// The polygon as a fan of triangles.
    pub fn fan(&self) -> impl Iterator<Item = [DVec2; 3]> + '_ {
        let corners = self.corners();
        (2..corners.len()).map(move |k| [corners[0], corners[k - 1], corners[k]])
    }

    /// A point inside it: the mean of its corners.
    pub fn middle(&self) -> DVec2 {
        self.corners().iter().sum::<DVec2>() / self.len.max(1) as f64
    }

    /// Least and largest value of an affine function on the polygon.
    pub fn range(&self, value: impl Fn(DVec2) -> f64) -> (f64, f64) {
        let extend = |(low, high): (f64, f64), &p: &DVec2| (low.min(value(p)), high.max(value(p)));
        self.corners().iter().fold((f64::INFINITY, f64::NEG_INFINITY), extend)
    }
}

/// The part of a triangle that lies in texel (x, y).
pub fn clip(corners: [DVec2; 3], x: usize, y: usize) -> Polygon {
    row(corners, y).strip(x as f64, (x + 1) as f64, |p| p.x)
}

fn row(corners: [DVec2; 3], y: usize) -> Polygon {
    Polygon::triangle(corners).strip(y as f64, (y + 1) as f64, |p| p.y)
}

/// Calls `visit` with column, row and part of the triangle for every texel that the triangle overlaps. Coordinates must
/// not be negative. The time is proportional to the number of these texels and rows, not to the area of the triangle's
/// bounding box.
pub fn for_each_texel(corners: [DVec2; 3], mut visit: impl FnMut(usize, usize, Polygon)) {
    let (bottom, top) = Polygon::triangle(corners).range(|p| p.y);
    for y in cells(bottom, top) {
        let row = row(corners, y);
        let (left, right) = row.range(|p| p.x);
        for x in cells(left, right) {
            let part = row.strip(x as f64, (x + 1) as f64, |p| p.x);
            if part.area() > 0.0 {
                visit(x, y, part);
            }
        }
    }
}

/// The unit intervals, by number, that an interval overlaps.
pub fn cells(low: f64, high: f64) -> std::ops::Range<usize> {
    // The range of an empty polygon goes from +∞ to -∞ and has no cells.
    if low > high { 0..0 } else { low.floor() as usize..high.ceil() as usize }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = DVec2> {
        // Many points lie on the lines of the grid.
        let number = || prop_oneof![0f64..9.0, (0u8..10).prop_map(f64::from)];
        (number(), number()).prop_map(|(x, y)| DVec2::new(x, y))
    }

    proptest! {
        #[test]
        fn the_parts_make_up_the_triangle(a in point(), b in point(), c in point()) {
            let (mut area, mut moment) = (0.0, DVec2::ZERO);
            for_each_texel([a, b, c], |x, y, part| {
                let (low, high) = (DVec2::new(x as f64, y as f64), DVec2::new((x + 1) as f64, (y + 1) as f64));
                for p in part.corners() {
                    assert!((p.clamp(low, high) - *p).length() < 1e-12);
                }
                assert!((clip([a, b, c], x, y).area() - part.area()).abs() < 1e-15);
                area += part.area();
                moment += part.fan().map(|[p, q, r]| {
                    0.5 * (q - p).perp_dot(r - p).abs() * (p + q + r) / 3.0
                }).sum::<DVec2>();
            });
            let whole = 0.5 * (b - a).perp_dot(c - a).abs();
            prop_assert!((area - whole).abs() < 1e-12, "{area} of {whole}");
            prop_assert!((moment - whole * (a + b + c) / 3.0).length() < 1e-11);
        }
    }

    #[test]
    fn a_texel_inside_is_covered_whole() {
        let corners = [DVec2::new(-0.0, 0.0), DVec2::new(20.0, 0.0), DVec2::new(0.0, 20.0)];
        assert_eq!(clip(corners, 3, 4).area(), 1.0);
        assert_eq!(clip(corners, 0, 19).area(), 0.5);
        assert_eq!(clip(corners, 19, 19).area(), 0.0);
    }
}
