//! Cuts polygons into triangles: convex polygons as a fan, concave polygons by ear clipping in their plane.

use earcut::Earcut;
use earcut::utils3d::project3d_to_2d;
use glam::{DVec2, DVec3};

/// Sine of the angle by which a corner may turn the wrong way and still count as straight.
const STRAIGHT: f64 = 1e-9;

/// Largest number of corners of a concave polygon. The time of ear clipping grows with the square of this number:
/// 10,000 corners took a tenth of a second, and 100,000 corners a minute and a half.
const MOST_CORNERS: usize = 10_000;

/// Message for a polygon that [`polygon`] refuses.
pub(super) const TOO_MANY: &str = "a concave face of more than 10000 corners cannot be cut into triangles";

/// Cuts a polygon of n ≥ 3 points into n − 2 triangles, given as indices into `points`. They have the polygon's
/// winding. Degenerate and self-intersecting polygons become a fan. `None` if a concave polygon has too many corners.
pub(super) fn polygon(points: &[DVec3]) -> Option<Vec<[usize; 3]>> {
    if points.len() == 3 {
        return Some(fan(3));
    }
    let Some(plane) = flatten(points) else { return Some(fan(points.len())) };
    if is_convex(&plane) {
        return Some(fan(points.len()));
    }
    (points.len() <= MOST_CORNERS).then(|| clip_ears(&plane).unwrap_or_else(|| fan(points.len())))
}

fn fan(n: usize) -> Vec<[usize; 3]> {
    (1..n - 1).map(|i| [0, i, i + 1]).collect()
}

/// Projects a polygon onto the plane of its Newell normal, counter-clockwise. The polygon is first scaled to about one
/// unit, because the thresholds of the projection are absolute.
fn flatten(points: &[DVec3]) -> Option<Vec<[f64; 2]>> {
    let extent = points.iter().map(|p| (*p - points[0]).abs().max_element()).fold(0.0, f64::max);
    if extent == 0.0 || !extent.is_finite() {
        return None;
    }
    let unit: Vec<[f64; 3]> = points.iter().map(|p| ((*p - points[0]) / extent).to_array()).collect();
    let mut plane = Vec::new();
    (project3d_to_2d(&unit, unit.len(), &mut plane) && doubled_area(&plane) > 1e-12).then_some(plane)
}

fn doubled_area(ring: &[[f64; 2]]) -> f64 {
    (0..ring.len()).map(|i| DVec2::from(ring[i]).perp_dot(ring[(i + 1) % ring.len()].into())).sum()
}

fn doubled_triangle(ring: &[[f64; 2]], [a, b, c]: [usize; 3]) -> f64 {
    let [a, b, c] = [ring[a], ring[b], ring[c]].map(DVec2::from);
    (b - a).perp_dot(c - a)
}

/// Whether a polygon turns left at every corner, and all triangles of its fan do so too. The second condition excludes
/// stars: they turn left at every corner, but go round more than once.
fn is_convex(ring: &[[f64; 2]]) -> bool {
    let n = ring.len();
    let turns_left = |t: [usize; 3]| {
        let [a, b, c] = t.map(|i| DVec2::from(ring[i]));
        doubled_triangle(ring, t) >= -STRAIGHT * (b - a).length() * (c - a).length()
    };
    (0..n).all(|i| turns_left([i, (i + 1) % n, (i + 2) % n])) && fan(n).into_iter().all(turns_left)
}

/// Cuts a polygon by ear clipping. `None` if the triangles do not cover the polygon, for instance because it intersects
/// itself.
fn clip_ears(ring: &[[f64; 2]]) -> Option<Vec<[usize; 3]>> {
    let mut indices: Vec<usize> = Vec::new();
    Earcut::new().earcut_slice(ring, &[], &mut indices);
    let mut triangles: Vec<[usize; 3]> = indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
    for t in &mut triangles {
        if doubled_triangle(ring, *t) < 0.0 {
            t.swap(1, 2);
        }
    }
    insert_dropped(ring.len(), &mut triangles)?;
    let covered: f64 = triangles.iter().map(|t| doubled_triangle(ring, *t).abs()).sum();
    let area = doubled_area(ring);
    ((covered - area).abs() <= 1e-9 * area && triangles.len() == ring.len() - 2).then_some(triangles)
}

/// Inserts the points that ear clipping drops from straight edges. Without them, such an edge would have a T-junction
/// with its neighbour, and rays can escape through a T-junction.
fn insert_dropped(n: usize, triangles: &mut Vec<[usize; 3]>) -> Option<()> {
    let mut kept = vec![false; n];
    triangles.iter().flatten().for_each(|&i| kept[i] = true);
    let first = kept.iter().position(|&k| k)?;
    let mut at = 0;
    while at < n {
        let a = (first + at) % n;
        let gap = (1..=n).find(|d| kept[(a + d) % n])?;
        if gap > 1 {
            let b = (a + gap) % n;
            let (t, c) = triangles.iter().enumerate().find_map(|(t, v)| {
                (0..3).find(|&k| v[k] == a && v[(k + 1) % 3] == b).map(|k| (t, v[(k + 2) % 3]))
            })?;
            triangles.swap_remove(t);
            triangles.extend((0..gap).map(|d| [(a + d) % n, (a + d + 1) % n, c]));
        }
        at += gap;
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn in_3d(ring: &[[f64; 2]], scale: f64) -> Vec<DVec3> {
        // Two orthonormal directions of a plane that contains no axis.
        let (u, v) = (DVec3::new(1.0, 2.0, 2.0) / 3.0, DVec3::new(2.0, 1.0, -2.0) / 3.0);
        ring.iter().map(|p| (u * p[0] + v * p[1]) * scale + DVec3::splat(scale)).collect()
    }

    /// Twice the covered area. Checks that every triangle keeps the winding and that every edge of the ring is an edge
    /// of one triangle.
    fn check(ring: &[[f64; 2]], triangles: &[[usize; 3]]) -> f64 {
        let n = ring.len();
        assert_eq!(triangles.len(), n - 2);
        for i in 0..n {
            let on_ring = |t: &[usize; 3]| (0..3).any(|k| t[k] == i && t[(k + 1) % 3] == (i + 1) % n);
            assert_eq!(triangles.iter().filter(|t| on_ring(t)).count(), 1, "edge {i} of {triangles:?}");
        }
        triangles
            .iter()
            .map(|t| {
                let area = doubled_triangle(ring, *t);
                assert!(area >= -1e-12, "{t:?} is flipped");
                area
            })
            .sum()
    }

    #[test]
    fn convex_is_a_fan_from_the_first_vertex() {
        let ring: Vec<[f64; 2]> =
            (0..6).map(|i| (f64::from(i)).to_radians() * 60.0).map(|a| [a.cos(), a.sin()]).collect();
        assert_eq!(polygon(&in_3d(&ring, 1.0)).unwrap(), [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]);
    }

    #[test]
    fn a_point_on_a_straight_edge_stays() {
        let l = [[0., 0.], [1., 0.], [2., 0.], [2., 1.], [1., 1.], [1., 2.], [0., 2.], [0., 1.], [0., 0.5]];
        let area = check(&l, &polygon(&in_3d(&l, 1.0)).unwrap());
        assert!((area - 6.0).abs() < 1e-12);
    }

    #[test]
    fn degenerate_polygons_are_fans() {
        let line: Vec<DVec3> = (0..5).map(|i| DVec3::X * f64::from(i)).collect();
        assert_eq!(polygon(&line).unwrap().len(), 3);
        assert_eq!(polygon(&[DVec3::ONE; 4]).unwrap().len(), 2);
        let bow_tie = [[0., 0.], [1., 1.], [1., 0.], [0., 1.]];
        assert_eq!(polygon(&in_3d(&bow_tie, 1.0)).unwrap(), fan(4));
    }

    #[test]
    fn time_does_not_grow_with_the_square_of_a_file() {
        // A circle becomes a fan, whatever its number of corners. With a dent, it has too many corners.
        let mut ring: Vec<[f64; 2]> = (0..20_000)
            .map(|i| std::f64::consts::TAU * f64::from(i) / 20_000.0)
            .map(|a| [a.cos(), a.sin()])
            .collect();
        assert_eq!(polygon(&in_3d(&ring, 1.0)).unwrap().len(), 19_998);
        ring[7] = [0.5, 0.0];
        assert!(polygon(&in_3d(&ring, 1.0)).is_none());
    }

    proptest! {
        #[test]
        fn any_star_shaped_polygon_is_covered_once(
            radii in prop::collection::vec(0.05f64..1.0, 4..40),
            exponent in -8i32..8,
            clockwise: bool,
        ) {
            let n = radii.len();
            let mut ring: Vec<[f64; 2]> = radii
                .iter()
                .enumerate()
                .map(|(i, r)| (r, std::f64::consts::TAU * i as f64 / n as f64))
                .map(|(r, a)| [r * a.cos(), r * a.sin()])
                .collect();
            let points = in_3d(&ring, 10f64.powi(exponent));
            let triangles = if clockwise {
                let back: Vec<DVec3> = points.into_iter().rev().collect();
                for p in &mut ring {
                    p[1] = -p[1];
                }
                ring.reverse();
                polygon(&back).unwrap()
            } else {
                polygon(&points).unwrap()
            };
            let area = check(&ring, &triangles);
            prop_assert!((area - doubled_area(&ring)).abs() < 1e-9);
        }
    }
}
