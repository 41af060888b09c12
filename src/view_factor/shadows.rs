//! What a point of one polygon sees of another one past a few blockers.
//!
//! Seen from a point, a convex blocker hides the part of a polygon that lies in the cone through the blocker's edges. The faces of the
//! cone meet the polygon's plane in lines. Cutting along these lines leaves convex pieces, and Lambert's formula gives the form factor
//! of each. So only the point is left to chance, and not the direction (G. N. Walton, "Calculation of Obstructed View Factors by
//! Adaptive Integration", NISTIR 6925, 2002, integrates over such points).

use glam::{DVec3, dvec3};

use super::{blockers::IN_PLANE, polygon::Area};
use crate::form_factor::exact::{clip, lambert};

/// A point this close to a line, in sizes of the polygon, lies on it. Otherwise rounding would leave slivers between the shadows of
/// adjoining blockers.
const ON_LINE: f64 = 1e-10;

/// Two polygons and the blockers between them. Coordinates are those of the seen polygon, whose plane is z = 0.
pub(super) struct Shadows {
    /// The polygon on which points are chosen.
    from: Area,
    /// The outline of the other one.
    outline: Vec<DVec3>,
    /// The parts of the blockers between the planes of both polygons, with their normals.
    screens: Vec<(Vec<DVec3>, DVec3)>,
    on_line: f64,
}

impl Shadows {
    /// Points are chosen on the smaller one of two polygons that lie wholly in front of each other.
    pub(super) fn between<'a>(
        p: &Area,
        q: &Area,
        blockers: impl Iterator<Item = (&'a [DVec3], DVec3)>,
    ) -> Shadows {
        let (from, to) = if p.area() <= q.area() { (p, q) } else { (q, p) };
        let origin = to.corners()[0];
        let along = to.normal().any_orthonormal_vector();
        let axes = [along, to.normal().cross(along), to.normal()];
        let turned = |v: DVec3| dvec3(v.dot(axes[0]), v.dot(axes[1]), v.dot(axes[2]));
        let local = |corners: &[DVec3]| corners.iter().map(|&v| turned(v - origin)).collect::<Vec<_>>();
        let flat = |corners: &[DVec3]| local(corners).into_iter().map(|v| v.with_z(0.0)).collect::<Vec<_>>();
        let from = Area::new(local(from.corners()), turned(from.normal()));
        let (outline, start) = (flat(to.corners()), from.corners()[0]);
        let screen = |(corners, normal): (&[DVec3], DVec3)| {
            let above = clip(&local(corners), DVec3::ZERO, DVec3::Z, IN_PLANE)?;
            Some((clip(&above, start, from.normal(), IN_PLANE)?, turned(normal)))
        };
        let screens = blockers.filter_map(screen).collect();
        let on_line = ON_LINE * outline.iter().map(|v| v.length()).fold(0.0, f64::max);
        Shadows { from, outline, screens, on_line }
    }

    /// Maps a point of the unit square to a point of the first polygon. Returns the exchange that it stands for, with nothing between
    /// the polygons and past the blockers. The means over all points are the exchange areas of the two polygons.
    pub(super) fn seen_from(&self, u: f64, v: f64, pieces: &mut Pieces) -> (f64, f64) {
        let point = self.from.point(u, v);
        let weight = |corners: &[DVec3]| self.from.area() * lambert(point, self.from.normal(), corners);
        let whole = weight(&self.outline);
        pieces.begin(&self.outline);
        let mut is_cut = false;
        for screen in &self.screens {
            if pieces.set_cone(point, screen) {
                is_cut |= pieces.remove_cone(self.on_line);
            }
        }
        (whole, if is_cut { pieces.all().map(weight).sum() } else { whole })
    }
}

/// Convex pieces of a polygon, and memory for cutting them.
#[derive(Default)]
pub(super) struct Pieces {
    now: List,
    next: List,
    inside: Vec<DVec3>,
    rest: Vec<DVec3>,
    /// Lines as (a, b, c): points with a x + b y + c > 0 are inside.
    cone: Vec<DVec3>,
}

/// Polygons, one after the other.
#[derive(Default)]
struct List {
    corners: Vec<DVec3>,
    ends: Vec<usize>,
}

impl List {
    fn clear(&mut self) {
        self.corners.clear();
        self.ends.clear();
    }

    fn push(&mut self, corners: &[DVec3]) {
        self.corners.extend_from_slice(corners);
        self.ends.push(self.corners.len());
    }

    fn get(&self, k: usize) -> &[DVec3] {
        &self.corners[if k == 0 { 0 } else { self.ends[k - 1] }..self.ends[k]]
    }

    fn truncate(&mut self, count: usize) {
        self.ends.truncate(count);
        self.corners.truncate(self.ends.last().copied().unwrap_or(0));
    }
}

impl Pieces {
    fn begin(&mut self, outline: &[DVec3]) {
        self.now.clear();
        self.now.push(outline);
    }

    fn all(&self) -> impl Iterator<Item = &[DVec3]> {
        (0..self.now.ends.len()).map(|k| self.now.get(k))
    }

    /// Sets the lines in which the cone from a point over a blocker meets the plane. Returns whether the cone has a volume.
    fn set_cone(&mut self, point: DVec3, (corners, normal): &(Vec<DVec3>, DVec3)) -> bool {
        let height = (point - corners[0]).dot(*normal);
        if height.abs() <= IN_PLANE {
            return false;
        }
        self.cone.clear();
        let mut start = corners[corners.len() - 1] - point;
        for corner in corners {
            let end = *corner - point;
            let inward = start.cross(end) * -height.signum();
            let length = inward.truncate().length();
            let line = inward.with_z(-inward.dot(point));
            // A face of the cone that is parallel to the plane has the whole plane on one side.
            self.cone.push(if length > 0.0 { line / length } else { DVec3::Z * line.z.signum() });
            start = end;
        }
        true
    }

    /// Removes the cone from all pieces. Returns whether this changed any.
    fn remove_cone(&mut self, on_line: f64) -> bool {
        let height = |line: &DVec3, at: &DVec3| line.x * at.x + line.y * at.y + line.z;
        self.next.clear();
        let mut is_cut = false;
        for k in 0..self.now.ends.len() {
            let piece = self.now.get(k);
            let before = self.next.ends.len();
            let is_outside = |line: &DVec3| piece.iter().all(|at| height(line, at) <= on_line);
            let mut is_hidden = !self.cone.iter().any(is_outside);
            if is_hidden {
                self.inside.clear();
                self.inside.extend_from_slice(piece);
                for line in &self.cone {
                    let inside = &mut self.inside;
                    if inside.iter().all(|at| height(line, at) >= -on_line) {
                        continue;
                    }
                    if inside.iter().all(|at| height(line, at) <= on_line) {
                        is_hidden = false;
                        break;
                    }
                    self.rest.clear();
                    let mut start = inside[inside.len() - 1];
                    let mut from = height(line, &start);
                    for &end in inside.iter() {
                        let to = height(line, &end);
                        if (from > 0.0) != (to > 0.0) {
                            let across = start + (end - start) * (from / (from - to));
                            self.rest.push(across);
                            self.next.corners.push(across);
                        }
                        let part = if to > 0.0 { &mut self.rest } else { &mut self.next.corners };
                        part.push(end);
                        (start, from) = (end, to);
                    }
                    self.next.ends.push(self.next.corners.len());
                    std::mem::swap(inside, &mut self.rest);
                }
            }
            if is_hidden {
                is_cut = true;
            } else {
                self.next.truncate(before);
                self.next.push(piece);
            }
        }
        std::mem::swap(&mut self.now, &mut self.next);
        is_cut
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::form_factor::exact::opposed_squares_with_blocker;

    fn square(side: f64, height: f64, up: bool) -> Vec<DVec3> {
        let h = side / 2.0;
        let mut corners =
            vec![dvec3(-h, -h, height), dvec3(h, -h, height), dvec3(h, h, height), dvec3(-h, h, height)];
        if !up {
            corners.reverse();
        }
        corners
    }

    /// The mean over a grid of points, with nothing between and past the blockers.
    fn mean(p: &[DVec3], q: &[DVec3], blockers: &[(Vec<DVec3>, DVec3)], n: u32) -> (f64, f64) {
        let shadows = Shadows::between(
            &Area::new(p.to_vec(), DVec3::Z),
            &Area::new(q.to_vec(), -DVec3::Z),
            blockers.iter().map(|(corners, normal)| (&corners[..], *normal)),
        );
        let mut pieces = Pieces::default();
        let at = |k: u32| (f64::from(k) + 0.5) / f64::from(n);
        let points = (0..n * n).map(|k| shadows.seen_from(at(k / n), at(k % n), &mut pieces));
        let sum = points.fold((0.0, 0.0), |sum, (whole, seen)| (sum.0 + whole, sum.1 + seen));
        (sum.0 / f64::from(n * n), sum.1 / f64::from(n * n))
    }

    /// A square between two squares: whole, as two triangles, as overlapping strips, and facing either way.
    #[test]
    fn shadows_hide_what_the_closed_form_says() {
        let (p, q) = (square(1.0, 0.0, true), square(1.0, 1.0, false));
        let exact = opposed_squares_with_blocker(1.0, 1.0, 0.6);
        let middle = square(0.6, 0.5, true);
        let part = |corners: [usize; 3]| (corners.map(|k| middle[k]).to_vec(), DVec3::Z);
        let strip = |from: f64, to: f64| {
            let corners = [(from, -0.3), (to, -0.3), (to, 0.3), (from, 0.3)];
            (corners.map(|(x, y)| dvec3(x, y, 0.5)).to_vec(), DVec3::Z)
        };
        let turned: Vec<DVec3> = middle.iter().rev().copied().collect();
        for blockers in [
            vec![(middle.clone(), DVec3::Z)],
            vec![(turned.clone(), -DVec3::Z)],
            vec![(middle.clone(), DVec3::Z), (turned, -DVec3::Z)],
            vec![part([0, 1, 2]), part([0, 2, 3])],
            vec![strip(-0.3, 0.2), strip(0.1, 0.3)],
        ] {
            // The error of the midpoint rule falls as 1/n².
            let (_, seen) = mean(&p, &q, &blockers, 60);
            assert!((seen - exact).abs() < 2e-4, "{seen}, not {exact}, past {} blockers", blockers.len());
        }
    }

    /// Nothing is left past a wide wall of triangles, and a blocker above or below the two squares hides nothing, nor does one that
    /// lies in the plane of either.
    #[test]
    fn all_or_nothing() {
        let (p, q) = (square(1.0, 0.0, true), square(0.7, 1.0, false));
        let (a, b) = (square(3.0, 0.4, true), square(9.0, 0.4, true));
        let ring = (0..4).flat_map(|k| {
            let l = (k + 1) % 4;
            [vec![a[k], b[k], b[l]], vec![a[k], b[l], a[l]]]
        });
        let wall = [vec![a[0], a[1], a[2]], vec![a[0], a[2], a[3]]].into_iter().chain(ring);
        let wall: Vec<_> = wall.map(|corners| (corners, DVec3::Z)).collect();
        assert_eq!(mean(&p, &q, &wall, 20).1, 0.0);
        for height in [-0.1, 0.0, 1.0, 1.1] {
            let (whole, seen) = mean(&p, &q, &[(square(0.5, height, true), DVec3::Z)], 20);
            assert_eq!(whole, seen, "{height}");
        }
        // Upright, partly below one square and partly above the other: as without those parts.
        let upright = |low: f64, high: f64| {
            let corners = [(-0.2, low), (0.3, low), (0.3, high), (-0.2, high)];
            (corners.map(|(y, z)| dvec3(0.1, y, z)).to_vec(), DVec3::X)
        };
        let [long, short] = [upright(-1.0, 3.0), upright(0.0, 1.0)].map(|b| mean(&p, &q, &[b], 20).1);
        assert!((long / short - 1.0).abs() < 1e-12 && long < 0.9 * mean(&p, &q, &[], 20).1, "{long} {short}");
    }
}
