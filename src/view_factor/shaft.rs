//! The shaft between two convex polygons: the union of all paths between their points, which is their convex hull (E.
//! A. Haines and J. R. Wallace, "Shaft Culling for Efficient Ray-Traced Radiosity", EG Workshop on Rendering 1991).
//!
//! A polygon outside the shaft blocks nothing, and a polygon inside blocks some path. This decides without rays whether
//! two polygons see all of each other.

use glam::DVec3;

use crate::form_factor::exact::clip;

/// A polygon that reaches less deep into a shaft than this, relative to the smaller end, counts as outside: adjoining
/// walls as rounded in files. It hides at most about as large a share.
const DEPTH: f64 = 1e-7;

/// A half-space: the unit normal that points into it, and the height of its plane along the normal.
struct HalfSpace {
    normal: DVec3,
    at: f64,
}

impl HalfSpace {
    fn height(&self, point: DVec3) -> f64 {
        point.dot(self.normal) - self.at
    }
}

/// The half-spaces whose intersection is the shaft, moved inward a little, and its bounds.
pub(super) struct Shaft {
    sides: Vec<HalfSpace>,
    low: DVec3,
    high: DVec3,
}

impl Shaft {
    /// The shaft between two polygons that lie wholly in front of each other, given by corners and normals.
    pub(super) fn new((p, n): (&[DVec3], DVec3), (q, m): (&[DVec3], DVec3)) -> Shaft {
        let size = |corners: &[DVec3]| corners.iter().map(|v| v.distance(corners[0])).fold(0.0, f64::max);
        let depth = (DEPTH * size(p).min(size(q))).max(16.0 * f64::EPSILON);
        let all = || p.iter().chain(q);
        let none = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let (low, high) = all().fold(none, |(low, high), v| (low.min(*v), high.max(*v)));
        let mut sides = vec![
            HalfSpace { normal: n, at: p[0].dot(n) + depth },
            HalfSpace { normal: m, at: q[0].dot(m) + depth },
        ];
        add_sides(p, q, depth, &mut sides);
        add_sides(q, p, depth, &mut sides);
        Shaft { sides, low, high }
    }

    /// Whether a box may enter the shaft. False is always right.
    pub(super) fn may_meet_box(&self, low: DVec3, high: DVec3) -> bool {
        if low.cmpgt(self.high).any() || high.cmplt(self.low).any() {
            return false;
        }
        let farthest = |n: DVec3| DVec3::select(n.cmpgt(DVec3::ZERO), high, low);
        self.sides.iter().all(|side| side.height(farthest(side.normal)) > 0.0)
    }

    /// Whether a convex polygon enters the shaft.
    pub(super) fn meets(&self, corners: &[DVec3]) -> bool {
        let outside = |side: &HalfSpace| corners.iter().all(|&p| side.height(p) <= 0.0);
        if self.sides.iter().any(outside) {
            return false;
        }
        let cut = |rest: Vec<DVec3>, side: &HalfSpace| clip(&rest, side.normal * side.at, side.normal, 0.0);
        self.sides.iter().try_fold(corners.to_vec(), cut).is_some()
    }
}

/// Adds the half-spaces whose planes hold an edge of `p` and a corner of `q`, with both polygons on one side.
fn add_sides(p: &[DVec3], q: &[DVec3], depth: f64, sides: &mut Vec<HalfSpace>) {
    let centre = p.iter().sum::<DVec3>() / p.len() as f64;
    for (k, &start) in p.iter().enumerate() {
        let edge = p[(k + 1) % p.len()] - start;
        let plane = |&corner: &DVec3| {
            let across = edge.cross(corner - start);
            let length = across.length();
            if length <= 1e-9 * edge.length() * (corner - start).length() {
                return None;
            }
            // The plane of the polygon itself is not a side.
            let inside = (centre - start).dot(across) / length;
            if inside.abs() <= 1e-9 * edge.length() {
                return None;
            }
            let inward = inside.signum() / length;
            let side = HalfSpace { normal: across * inward, at: start.dot(across) * inward };
            q.iter().all(|&v| side.height(v) >= -0.1 * depth).then_some(side)
        };
        if let Some(side) = q.iter().find_map(plane) {
            sides.push(HalfSpace { at: side.at + depth, ..side });
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::dvec3;

    use super::*;
    use crate::view_factor::polygon::level_square as square;

    /// The floor and the other walls of a room touch the shaft between two adjoining walls, which is a prism, and do
    /// not enter it.
    #[test]
    fn adjoining_walls_are_outside() {
        let wall = [DVec3::ZERO, DVec3::Y, dvec3(0.0, 1.0, 1.0), DVec3::Z];
        let next = [DVec3::ZERO, DVec3::Z, dvec3(1.0, 0.0, 1.0), DVec3::X];
        let shaft = Shaft::new((&wall, DVec3::X), (&next, DVec3::Y));
        let floor = [DVec3::ZERO, DVec3::X, dvec3(1.0, 1.0, 0.0), DVec3::Y];
        let lift = |by: DVec3| floor.map(|p| p + by);
        assert!(!shaft.meets(&floor) && !shaft.meets(&lift(DVec3::Z)));
        assert!(shaft.meets(&lift(DVec3::Z * 0.01)) && !shaft.meets(&lift(dvec3(1.0, 0.0, 0.5))));
    }

    #[test]
    fn a_square_enters_as_soon_as_it_blocks_a_path() {
        let (p, q) = (square(2.0, DVec3::ZERO, true), square(1.0, dvec3(0.0, 0.0, 1.0), false));
        let shaft = Shaft::new((&p, DVec3::Z), (&q, -DVec3::Z));
        // Halfway up the shaft is 1.5 wide. A square of width 0.2 touches it when its centre is 0.85 away.
        for (x, meets) in [(0.0, true), (0.8499, true), (0.8501, false), (3.0, false)] {
            let blocker = square(0.2, dvec3(x, 0.0, 0.5), true);
            assert_eq!(shaft.meets(&blocker), meets, "{x}");
            let (low, high) = (blocker[0], blocker[2]);
            assert!(shaft.may_meet_box(low, high) >= meets);
        }
        // A square larger than the shaft, and upright ones beside it and through it.
        assert!(shaft.meets(&square(10.0, dvec3(0.0, 0.0, 0.3), true)));
        let upright =
            |x: f64| vec![dvec3(x, -5.0, -5.0), dvec3(x, 5.0, -5.0), dvec3(x, 5.0, 5.0), dvec3(x, -5.0, 5.0)];
        assert!(shaft.meets(&upright(0.99)) && !shaft.meets(&upright(1.0)));
        // In the planes of the two polygons, and behind them.
        for z in [0.0, 1.0, -0.1, 1.1] {
            assert!(!shaft.meets(&square(0.5, dvec3(0.0, 0.0, z), true)), "{z}");
        }
    }
}
