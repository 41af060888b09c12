//! Clusters of pieces near each other. What can be between a piece and any member of a cluster is looked up once for
//! all of its members.

use glam::DVec3;

use super::{
    blockers::{Blockers, Near, bounds},
    polygon::Polygon,
};

/// Most members of a cluster.
const MEMBERS: usize = 32;
/// Most blockers that are looked up for a cluster. With more, each pair walks through the hierarchy.
const MOST: usize = 64;
/// Margin for rounding, in unit space.
const MARGIN: f64 = 1e-12;

/// Pieces near each other.
pub(super) struct Cluster {
    /// Sorted.
    members: Vec<u32>,
    low: DVec3,
    high: DVec3,
}

impl Cluster {
    /// All pieces in clusters, by halving along the longest axis of the bounds of their centres.
    pub(super) fn all(pieces: &[Polygon]) -> Vec<Cluster> {
        let mut clusters = Vec::new();
        let mut members: Vec<u32> = (0..pieces.len() as u32).collect();
        divide(&mut members, pieces, &mut clusters);
        clusters
    }

    /// The members after a piece, unless all of the cluster is behind the piece.
    pub(super) fn after(&self, i: usize, piece: &Polygon) -> &[u32] {
        let farthest = DVec3::select(piece.normal.cmpgt(DVec3::ZERO), self.high, self.low);
        let is_behind = piece.height(farthest) < 0.0;
        let first = self.members.partition_point(|&j| j as usize <= i);
        &self.members[if is_behind { self.members.len() } else { first }..]
    }

    /// The blockers that may be between a piece and a member.
    pub(super) fn blockers<'a>(&self, piece: &Polygon, all: &'a Blockers) -> Near<'a> {
        let hull = Hull::new(bounds(&piece.corners), (self.low, self.high));
        all.near_hull(|low, high| hull.may_meet(low, high), MOST)
    }
}

fn divide(members: &mut [u32], pieces: &[Polygon], clusters: &mut Vec<Cluster>) {
    if members.is_empty() {
        return;
    }
    let centre = |&k: &u32| pieces[k as usize].centre;
    if members.len() <= MEMBERS {
        let mut members = members.to_vec();
        members.sort_unstable();
        let (low, high) = bounds(members.iter().flat_map(|&k| &pieces[k as usize].corners));
        clusters.push(Cluster { members, low, high });
        return;
    }
    let centres: Vec<DVec3> = members.iter().map(centre).collect();
    let (low, high) = bounds(&centres);
    let axis = (high - low).max_position();
    let half = members.len() / 2;
    members.select_nth_unstable_by(half, |a, b| centre(a)[axis].total_cmp(&centre(b)[axis]).then(a.cmp(b)));
    let (left, right) = members.split_at_mut(half);
    divide(left, pieces, clusters);
    divide(right, pieces, clusters);
}

/// The convex hull of two boxes: the half-spaces whose planes are parallel to an axis and hold a corner of each box.
struct Hull {
    low: DVec3,
    high: DVec3,
    /// Normals that point inward, and heights of the planes.
    sides: Vec<(DVec3, f64)>,
}

impl Hull {
    fn new(p: (DVec3, DVec3), q: (DVec3, DVec3)) -> Hull {
        let mut sides = Vec::new();
        for axis in 0..3 {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let corner = |b: (DVec3, DVec3), k: u32| {
                (if k & 1 == 0 { b.0[u] } else { b.1[u] }, if k & 2 == 0 { b.0[v] } else { b.1[v] })
            };
            for k in 0..16 {
                let (a, b) = (corner(p, k % 4), corner(q, k / 4));
                let across = (a.1 - b.1, b.0 - a.0);
                let length = across.0.hypot(across.1);
                if length == 0.0 {
                    continue;
                }
                for sign in [length.recip(), -length.recip()] {
                    let mut normal = DVec3::ZERO;
                    (normal[u], normal[v]) = (across.0 * sign, across.1 * sign);
                    let at = a.0 * normal[u] + a.1 * normal[v] - MARGIN;
                    let is_inside = |b: (DVec3, DVec3)| lowest(normal, b) >= at;
                    if is_inside(p) && is_inside(q) {
                        sides.push((normal, at));
                    }
                }
            }
        }
        Hull { low: p.0.min(q.0) - MARGIN, high: p.1.max(q.1) + MARGIN, sides }
    }

    /// Whether a box may have a part in the hull. False is always right.
    fn may_meet(&self, low: DVec3, high: DVec3) -> bool {
        !(low.cmpgt(self.high).any() || high.cmplt(self.low).any())
            && self.sides.iter().all(|&(normal, at)| -lowest(-normal, (low, high)) >= at)
    }
}

/// The least height of a box along a normal.
fn lowest(normal: DVec3, (low, high): (DVec3, DVec3)) -> f64 {
    DVec3::select(normal.cmpgt(DVec3::ZERO), low, high).dot(normal)
}

#[cfg(test)]
mod tests {
    use glam::dvec3;

    use super::*;

    /// Boxes that meet a line between two boxes may meet the hull. Boxes beside it do not, on any side of a slanted hull.
    #[test]
    fn the_hull_of_two_boxes() {
        let unit = |x: f64, y: f64, z: f64| (dvec3(x, y, z), dvec3(x, y, z) + 1.0);
        let (p, q) = (unit(0.0, 0.0, 0.0), unit(10.0, 10.0, 10.0));
        for (p, q) in [(p, q), (q, p)] {
            let hull = Hull::new(p, q);
            let meets = |(low, high): (DVec3, DVec3)| hull.may_meet(low, high);
            assert!(meets(unit(5.0, 5.0, 5.0)) && meets(unit(5.9, 4.1, 5.0)) && meets(unit(-0.5, 0.0, 0.0)));
            for k in 0..3 {
                let aside = DVec3::AXES[k] * 3.0;
                for by in [aside, -aside] {
                    let at = dvec3(5.0, 5.0, 5.0) + by;
                    assert!(!meets(unit(at.x, at.y, at.z)), "{by}");
                }
            }
            assert!(!meets(unit(12.5, 11.0, 11.0)));
        }
    }
}
