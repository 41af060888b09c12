//! The uniform quadtree of a triangle.
//!
//! Each step cuts a triangle into four congruent children. Children 0, 1 and 2 each keep a corner. Child 3 is in the
//! middle and rotated by 180 degrees. The base-4 digits of a patch's number are the steps to it, most significant digit
//! first.

/// Number of patches at a level.
#[inline]
pub fn children(level: u8) -> u32 {
    1 << (2 * u32::from(level))
}

/// The number of the patch that contains a point.
#[inline]
pub fn child_at(barycentric: [f32; 3], level: u8) -> u32 {
    let [mut a, mut b, mut c] = barycentric;
    let mut index = 0;
    // Doubling is exact, and so is subtracting 1 from a number between 1 and 2. So rounding loses no digit.
    for _ in 0..level {
        let digit = if a >= 0.5 {
            (a, b, c) = (2.0 * a - 1.0, 2.0 * b, 2.0 * c);
            0
        } else if b >= 0.5 {
            (a, b, c) = (2.0 * a, 2.0 * b - 1.0, 2.0 * c);
            1
        } else if c >= 0.5 {
            (a, b, c) = (2.0 * a, 2.0 * b, 2.0 * c - 1.0);
            2
        } else {
            (a, b, c) = (1.0 - 2.0 * a, 1.0 - 2.0 * b, 1.0 - 2.0 * c);
            3
        };
        index = index * 4 + digit;
    }
    index
}

/// Barycentric coordinates of the corners of a patch, in the triangle's winding order.
pub fn corners(child: u32, level: u8) -> [[f64; 3]; 3] {
    lattice(child, level).map(|p| p.map(|k| f64::from(k) / f64::from(1u32 << level)))
}

/// The corners of a patch in units of 1/2^level: whole barycentric coordinates that sum to 2^level.
pub fn lattice(child: u32, level: u8) -> [[u32; 3]; 3] {
    let mut corners = [[1u32, 0, 0], [0, 1, 0], [0, 0, 1]];
    for step in (0..level).rev() {
        // In the new unit, a corner doubles, and the middle of two corners is the sum of the old corners.
        let add = |p: [u32; 3], q: [u32; 3]| [p[0] + q[0], p[1] + q[1], p[2] + q[2]];
        let [p, q, r] = corners;
        let (pp, qq, rr) = (add(p, p), add(q, q), add(r, r));
        let (pq, qr, rp) = (add(p, q), add(q, r), add(r, p));
        corners = match (child >> (2 * step)) & 3 {
            0 => [pp, pq, rp],
            1 => [pq, qq, qr],
            2 => [rp, qr, rr],
            _ => [qr, rp, pq],
        };
    }
    corners
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn every_child_contains_its_own_centroid_and_keeps_the_winding() {
        for level in 0..6 {
            for child in 0..children(level) {
                let corners = corners(child, level);
                let centroid: [f64; 3] =
                    std::array::from_fn(|k| corners.iter().map(|c| c[k]).sum::<f64>() / 3.0);
                assert_eq!(child_at(centroid.map(|x| x as f32), level), child);
                let [p, q, r] = corners;
                let doubled_area = (q[0] - p[0]) * (r[1] - p[1]) - (r[0] - p[0]) * (q[1] - p[1]);
                assert!((doubled_area * f64::from(children(level)) - 1.0).abs() < 1e-12);
            }
        }
    }

    proptest! {
        #[test]
        fn a_point_lies_in_the_child_that_the_lookup_names(x in 0f32..1.0, y in 0f32..1.0, level in 0u8..=12) {
            let b = crate::trace::sampling::square_to_triangle(x, y);
            let [p, q, r] = corners(child_at(b, level), level);
            // Signed areas. Times the number of children, they are the point's barycentric coordinates in its child.
            let at = |k: usize| f64::from(b[k]);
            let cross = |u: [f64; 3], v: [f64; 3]| (u[0] - at(0)) * (v[1] - at(1)) - (v[0] - at(0)) * (u[1] - at(1));
            let n = f64::from(children(level));
            // The coordinates sum to 1 up to the rounding of single precision. Each doubling magnifies this error.
            let slack = 4.0 * f64::from(f32::EPSILON) * f64::from(1u32 << level);
            for w in [cross(q, r), cross(r, p), cross(p, q)] {
                prop_assert!(w * n >= -slack, "outside by {}", -w * n);
            }
        }
    }
}
