//! Search for triangles of a map that overlap.

use glam::DVec2;

use super::raster::{Polygon, for_each_texel};

/// Two triangles may share this part of the smaller one's area, because printed coordinates are rounded.
const ROUNDING: f64 = 1e-4;

/// Finds up to `most` pairs of overlapping triangles in the unit square. The lower index comes first in each pair.
///
/// A grid about as fine as the triangles finds neighbours. Clipping one triangle with the other decides whether they
/// overlap.
pub fn find(triangles: &[[DVec2; 3]], most: usize) -> Vec<[usize; 2]> {
    let side = (2.0 * (triangles.len() as f64).sqrt()).clamp(1.0, 2048.0);
    let cells = side as usize + 1;
    let mut heads: Vec<Vec<u32>> = vec![Vec::new(); cells * cells];
    let mut pairs: Vec<[usize; 2]> = Vec::new();
    for (t, corners) in triangles.iter().enumerate() {
        for_each_texel(corners.map(|p| p * side), |x, y, _| {
            let cell = &mut heads[y * cells + x];
            for &u in cell.iter() {
                let pair = [u as usize, t];
                if pairs.len() < most && !pairs.contains(&pair) && overlap(triangles[pair[0]], *corners) {
                    pairs.push(pair);
                }
            }
            cell.push(t as u32);
        });
        if pairs.len() >= most {
            break;
        }
    }
    pairs
}

fn overlap(a: [DVec2; 3], b: [DVec2; 3]) -> bool {
    let doubled = |[p, q, r]: [DVec2; 3]| (q - p).perp_dot(r - p);
    let sign = doubled(a).signum();
    let mut common = Polygon::triangle(b);
    for k in 0..3 {
        let (p, q) = (a[k], a[(k + 1) % 3]);
        common = common.cut(|x| sign * (q - p).perp_dot(x - p));
    }
    common.area() > 0.5 * ROUNDING * doubled(a).abs().min(doubled(b).abs())
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::dvec2;

    #[test]
    fn neighbours_do_not_overlap_and_twins_do() {
        let square =
            [[dvec2(0., 0.), dvec2(1., 0.), dvec2(1., 1.)], [dvec2(0., 0.), dvec2(1., 1.), dvec2(0., 1.)]];
        assert!(find(&square, 3).is_empty());
        let twins = [square[0], square[1], square[1], square[0]];
        assert_eq!(find(&twins, 9), [[1, 2], [0, 3]]);
        let small = [dvec2(0.5, 0.3), dvec2(0.5, 0.2), dvec2(0.6, 0.2)];
        assert_eq!(find(&[square[0], square[1], small], 9), [[0, 2]]);
        let both = [dvec2(0.5, 0.6), dvec2(0.5, 0.2), dvec2(0.6, 0.2)];
        assert_eq!(find(&[square[0], square[1], both], 9), [[0, 2], [1, 2]]);
        assert_eq!(find(&[square[0], square[1], both], 1), [[0, 2]]);
    }
}
