//! Joins adjoining blockers in one plane. The facets of a wall block like the wall itself, and one large blocker is met faster, and hides
//! more by itself, than many small ones.

use std::collections::HashMap;

use glam::DVec3;

use super::blockers::IN_PLANE;

/// A sine below this is that of a straight angle.
pub(super) const STRAIGHT: f64 = 1e-12;

/// A convex planar outline.
pub(super) struct Shape {
    /// Counterclockwise as seen from where the normal points.
    pub(super) corners: Vec<DVec3>,
    pub(super) normal: DVec3,
    /// Only shapes of one kind are joined.
    pub(super) kind: u32,
    /// The shapes that it was joined from, by their place in the list.
    pub(super) members: Vec<u32>,
}

/// Joins shapes that share a whole edge and lie in one plane, while their union is convex. Longer edges come first: the triangles of a
/// grid become squares, and these become strips and rectangles.
pub(super) fn join(mut shapes: Vec<Shape>) -> Vec<Shape> {
    loop {
        let pairs = neighbours(&shapes);
        let mut is_changed = vec![false; shapes.len()];
        for [i, j] in pairs {
            if is_changed[i] || is_changed[j] {
                continue;
            }
            if let Some((corners, normal)) = union(&shapes[i], &shapes[j]) {
                let members = std::mem::take(&mut shapes[j].members);
                shapes[i].members.extend(members);
                (shapes[i].corners, shapes[i].normal) = (corners, normal);
                shapes[j].corners.clear();
                (is_changed[i], is_changed[j]) = (true, true);
            }
        }
        if !is_changed.contains(&true) {
            return shapes;
        }
        shapes.retain(|shape| !shape.corners.is_empty());
    }
}

fn edges(corners: &[DVec3]) -> impl Iterator<Item = [DVec3; 2]> {
    (0..corners.len()).map(|k| [corners[k], corners[(k + 1) % corners.len()]])
}

/// Pairs of shapes with a common edge, in order of falling length of it and then by its direction.
fn neighbours(shapes: &[Shape]) -> Vec<[usize; 2]> {
    let bits = |p: DVec3| (p + DVec3::ZERO).to_array().map(f64::to_bits);
    let mut starts = HashMap::with_capacity(4 * shapes.len());
    for (i, shape) in shapes.iter().enumerate() {
        edges(&shape.corners).for_each(|[a, b]| {
            starts.insert((bits(a), bits(b), shape.kind), i);
        });
    }
    let mut pairs = Vec::new();
    for (i, shape) in shapes.iter().enumerate() {
        for [a, b] in edges(&shape.corners) {
            if let Some(&j) = starts.get(&(bits(b), bits(a), shape.kind)).filter(|&&j| j > i) {
                // Single precision, so that rounding does not decide between edges of one length.
                let along = (b - a).abs().as_vec3();
                pairs.push((along.length(), along, [i, j]));
            }
        }
    }
    pairs.sort_by(|(length, along, pair), (other, direction, next)| {
        let by_direction = || along.x.total_cmp(&direction.x).then(along.y.total_cmp(&direction.y));
        other.total_cmp(length).then_with(by_direction).then(pair.cmp(next))
    });
    pairs.into_iter().map(|(_, _, pair)| pair).collect()
}

/// The union of two shapes with a common edge, and its normal, if they lie in one plane and the union is convex.
fn union(p: &Shape, q: &Shape) -> Option<(Vec<DVec3>, DVec3)> {
    let size = |shape: &Shape| edges(&shape.corners).map(|[a, b]| a.distance_squared(b)).fold(0.0, f64::max);
    // The larger one has the more exact normal.
    let (plane, other) = if size(p) >= size(q) { (p, q) } else { (q, p) };
    let height = |v: &DVec3| (*v - plane.corners[0]).dot(plane.normal).abs();
    if p.normal.dot(q.normal) <= 0.0 || other.corners.iter().any(|v| height(v) > IN_PLANE) {
        return None;
    }
    let (n, m) = (p.corners.len(), q.corners.len());
    let (at, to) = (0..n).find_map(|k| {
        let (a, b) = (p.corners[k], p.corners[(k + 1) % n]);
        (0..m).find(|&l| q.corners[l] == b && q.corners[(l + 1) % m] == a).map(|l| (k, l))
    })?;
    // From the end of the edge round the first shape to its start, then round the second one.
    let mut ring: Vec<DVec3> = (1..=n).map(|k| p.corners[(at + k) % n]).collect();
    ring.extend((2..m).map(|l| q.corners[(to + l) % m]));
    for k in [n - 1, 0] {
        let count = ring.len();
        let (before, after) = (ring[k] - ring[(k + count - 1) % count], ring[(k + 1) % count] - ring[k]);
        let (sine, straight) =
            (before.cross(after).dot(plane.normal), STRAIGHT * before.length() * after.length());
        if sine < -straight {
            return None;
        }
        if sine <= straight {
            ring.remove(k);
        }
    }
    (ring.len() >= 3).then_some((ring, plane.normal))
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, dvec3};

    use super::*;

    fn shapes(corners: impl IntoIterator<Item = Vec<DVec3>>) -> Vec<Shape> {
        let shape = |(k, corners): (u32, Vec<DVec3>)| {
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
            Shape { corners, normal, kind: 0, members: vec![k] }
        };
        (0..).zip(corners).map(shape).collect()
    }

    /// A grid of triangles, turned, becomes one rectangle.
    #[test]
    fn a_grid_becomes_one_rectangle() {
        let turn = DQuat::from_rotation_x(0.7) * DQuat::from_rotation_z(0.4);
        let at = |x: u32, y: u32| turn * dvec3(0.1 * f64::from(x), 0.07 * f64::from(y), 0.2);
        let cell = |k: u32| {
            let (x, y) = (k % 7, k / 7);
            let [a, b, c, d] = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
            [vec![a, b, c], vec![a, c, d]]
        };
        let joined = join(shapes((0..35).flat_map(cell)));
        assert_eq!(joined.len(), 1);
        assert_eq!((joined[0].corners.len(), joined[0].members.len()), (4, 70));
        let area = (joined[0].corners[1] - joined[0].corners[0])
            .cross(joined[0].corners[3] - joined[0].corners[0])
            .length();
        assert!((area - 0.7 * 0.35).abs() < 1e-12, "{area}");
    }

    /// Shapes at an angle, with a part of an edge in common, or whose union has a dent stay apart.
    #[test]
    fn others_stay_apart() {
        let square = |x: f64, y: f64, side: f64| {
            [(0.0, 0.0), (side, 0.0), (side, side), (0.0, side)]
                .map(|(a, b)| dvec3(x + a, y + b, 0.0))
                .to_vec()
        };
        let bent =
            vec![dvec3(0.5, 0.0, 0.0), dvec3(0.9, 0.0, 1e-9), dvec3(0.9, 0.5, 1e-9), dvec3(0.5, 0.5, 0.0)];
        assert_eq!(join(shapes([square(0.0, 0.0, 0.5), bent])).len(), 2);
        assert_eq!(join(shapes([square(0.0, 0.0, 0.5), square(0.5, 0.0, 0.3)])).len(), 2);
        let dented =
            vec![dvec3(0.5, 0.0, 0.0), dvec3(0.9, -0.4, 0.0), dvec3(0.9, 0.5, 0.0), dvec3(0.5, 0.5, 0.0)];
        assert_eq!(join(shapes([square(0.0, 0.0, 0.5), dented])).len(), 2);
    }
}
