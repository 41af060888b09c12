//! What a point of one polygon sees of another one past a few blockers.
//!
//! Seen from a point, a convex blocker hides the part of a polygon that lies in the cone through the blocker's edges. The faces of the
//! cone meet the polygon's plane in lines. Cutting along these lines leaves convex pieces, and Lambert's formula gives the form factor
//! of each. So only the point is left to chance, and not the direction (G. N. Walton, "Calculation of Obstructed View Factors by
//! Adaptive Integration", NISTIR 6925, 2002, integrates over such points).

use glam::{DVec3, dvec3};

use super::{
    blockers::IN_PLANE,
    polygon::{Area, area_vector, exchange_near},
};
use crate::form_factor::exact::{clip, lambert};

/// A point this close to a line, in sizes of the polygon, lies on it. Otherwise rounding would leave slivers between the shadows of
/// adjoining blockers.
const ON_LINE: f64 = 1e-10;

/// Points are chosen on a part of a polygon only if it is smaller than this share. Otherwise its exchange is not worth
/// computing.
const NEARLY_ALL: f64 = 0.999;

/// Points are chosen outside the umbra if it is more than this share of the penumbra. Otherwise the known exchange of the
/// whole penumbra is worth more.
const MOSTLY: f64 = 0.5;

/// A corner this far on the wrong side of a plane that holds others still counts as on it, in unit space.
const ON_SIDE: f64 = 1e-13;

/// The sine of an angle below which an edge and a corner determine no plane.
const THIN: f64 = 1e-9;

/// Two polygons and the blockers between them. Coordinates are those of the seen polygon, whose plane is z = 0.
pub(super) struct Shadows {
    /// Points are chosen on these convex pieces of the smaller polygon. From the rest everything is seen, or nothing.
    from: Vec<Area>,
    /// Their area.
    area: f64,
    normal: DVec3,
    /// The part from which something may be hidden, if it is not all of the polygon.
    penumbra: Option<Vec<DVec3>>,
    /// Whether the pieces are all of that part.
    is_all: bool,
    /// The outline of the other one.
    outline: Vec<DVec3>,
    /// The parts of the blockers between the planes of both polygons, with their normals.
    screens: Vec<(Vec<DVec3>, DVec3)>,
    on_line: f64,
}

impl Shadows {
    /// Points are chosen on the smaller one of two polygons that lie wholly in front of each other. `None` if nothing
    /// is hidden.
    pub(super) fn between<'a>(
        p: &Area,
        q: &Area,
        blockers: impl Iterator<Item = (&'a [DVec3], DVec3)>,
    ) -> Option<Shadows> {
        let (from, to) = if p.area() <= q.area() { (p, q) } else { (q, p) };
        let origin = to.corners()[0];
        let along = to.normal().any_orthonormal_vector();
        let axes = [along, to.normal().cross(along), to.normal()];
        let turned = |v: DVec3| dvec3(v.dot(axes[0]), v.dot(axes[1]), v.dot(axes[2]));
        let local = |corners: &[DVec3]| corners.iter().map(|&v| turned(v - origin)).collect::<Vec<_>>();
        let flat = |corners: &[DVec3]| local(corners).into_iter().map(|v| v.with_z(0.0)).collect::<Vec<_>>();
        let (corners, normal) = (local(from.corners()), turned(from.normal()));
        let outline = flat(to.corners());
        let screen = |(blocker, facing): (&[DVec3], DVec3)| {
            let above = clip(&local(blocker), DVec3::ZERO, DVec3::Z, IN_PLANE)?;
            Some((clip(&above, corners[0], normal, IN_PLANE)?, turned(facing)))
        };
        let screens: Vec<_> = blockers.filter_map(screen).collect();
        let shaded: Vec<_> =
            screens.iter().filter_map(|(screen, _)| shaded(&corners, &outline, screen)).collect();
        let whole = Area::new(corners, normal);
        let is_all = |region: &[DVec3]| area_vector(region).length() >= NEARLY_ALL * whole.area();
        let region = match &shaded[..] {
            [] => return None,
            regions if regions.iter().any(|region| is_all(region)) => None,
            [one] => Some(one.clone()),
            several => Some(hull(several.iter().flatten().copied(), normal)).filter(|hull| !is_all(hull)),
        };
        let penumbra = region.clone();
        let region = region.unwrap_or_else(|| whole.corners().to_vec());
        let dark = screens.iter().filter_map(|screen| umbra(&region, &outline, screen));
        let size = |corners: &Vec<DVec3>| area_vector(corners).length();
        let largest = dark.max_by(|a, b| size(a).total_cmp(&size(b)));
        let largest = largest.filter(|dark| size(dark) > MOSTLY * size(&region));
        let is_all = largest.is_none();
        let pieces = match largest {
            None => vec![region],
            Some(dark) => rest(region, &dark, normal),
        };
        let from: Vec<Area> = pieces.into_iter().map(|corners| Area::new(corners, normal)).collect();
        let area = from.iter().map(Area::area).sum();
        let on_line = ON_LINE * outline.iter().map(|v| v.length()).fold(0.0, f64::max);
        Some(Shadows { from, area, normal, penumbra, is_all, outline, screens, on_line })
    }

    /// The exchange of the part on which points are chosen, and what else may be seen from the rest of the polygon, given the
    /// exchange with nothing between. The first is unknown where points are chosen on pieces of that part only.
    pub(super) fn exchange(&self, unoccluded: f64) -> (Option<f64>, f64) {
        let penumbra = |corners: &Vec<DVec3>| exchange_near(corners, &self.outline).min(unoccluded);
        let sampled = self.penumbra.as_ref().map_or(unoccluded, penumbra);
        (self.is_all.then_some(sampled), unoccluded - sampled)
    }

    /// Whether there is nothing to sample.
    pub(super) fn is_empty(&self) -> bool {
        self.from.is_empty()
    }

    /// Maps a point of the unit square to a point of the first polygon. Returns the exchange that it stands for, with nothing between
    /// the polygons and past the blockers. The means over all points are the exchange areas of the two polygons.
    pub(super) fn seen_from(&self, u: f64, v: f64, pieces: &mut Pieces) -> (f64, f64) {
        let mut at = u * self.area;
        let last = self.from.len() - 1;
        let is_before = |area: &&Area| {
            let is_before = at >= area.area();
            if is_before {
                at -= area.area();
            }
            is_before
        };
        let piece = &self.from[self.from.iter().take_while(is_before).count().min(last)];
        let point = piece.point((at / piece.area()).clamp(0.0, 1.0), v);
        let weight = |corners: &[DVec3]| self.area * lambert(point, self.normal, corners);
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

/// The convex part of a polygon from whose points a convex blocker hides something of another polygon. `None` if it has
/// no area.
///
/// A plane with the blocker on one side and the other polygon on the other side separates them: from a point on the
/// polygon's side, no path to the polygon meets the blocker. What all planes leave that hold an edge of one of both and
/// a corner of the other is the penumbra (T. Nishita and E. Nakamae, "Half-Tone Representation of 3-D Objects
/// Illuminated by Area Sources or Polyhedron Sources", COMPSAC 83).
fn shaded(from: &[DVec3], seen: &[DVec3], blocker: &[DVec3]) -> Option<Vec<DVec3>> {
    let mut part = from.to_vec();
    for (of_edge, other, is_seen) in [(seen, blocker, true), (blocker, seen, false)] {
        for k in 0..of_edge.len() {
            let (start, end) = (of_edge[k], of_edge[(k + 1) % of_edge.len()]);
            for &corner in other {
                let (edge, to) = (end - start, corner - start);
                let across = edge.cross(to);
                let length = across.length();
                if length <= THIN * edge.length() * to.length() {
                    continue;
                }
                let plane = across / length;
                let sides = |points: &[DVec3]| {
                    let heights = points.iter().map(|&v| (v - start).dot(plane));
                    heights.fold((0f64, 0f64), |(low, high), h| (low.min(h), high.max(h)))
                };
                let ((low, high), (other_low, other_high)) = (sides(of_edge), sides(other));
                // The normal that points to the blocker's side.
                let toward_other = if high <= ON_SIDE && other_low >= -ON_SIDE {
                    plane
                } else if low >= -ON_SIDE && other_high <= ON_SIDE {
                    -plane
                } else {
                    continue;
                };
                let inward = if is_seen { toward_other } else { -toward_other };
                part = clip(&part, start, inward, 0.0)?;
            }
        }
    }
    let whole = area_vector(from).length();
    (area_vector(&part).length() > THIN * whole).then_some(part)
}

/// The convex part of a polygon from whose points a convex blocker hides all of another polygon: what it hides from all
/// of its corners. `None` if it has no area.
fn umbra(from: &[DVec3], seen: &[DVec3], (blocker, normal): &(Vec<DVec3>, DVec3)) -> Option<Vec<DVec3>> {
    let height = |v: &DVec3| (*v - blocker[0]).dot(*normal);
    let side = height(&seen[0]).signum();
    let is_between =
        seen.iter().all(|v| side * height(v) > ON_SIDE) && from.iter().all(|v| side * height(v) < -ON_SIDE);
    if !is_between {
        return None;
    }
    let middle = blocker.iter().sum::<DVec3>() / blocker.len() as f64;
    let mut part = from.to_vec();
    for &corner in seen {
        for k in 0..blocker.len() {
            let (start, end) = (blocker[k], blocker[(k + 1) % blocker.len()]);
            let across = (end - start).cross(corner - start);
            let inward = across * (middle - start).dot(across).signum();
            part = clip(&part, start, inward.normalize_or_zero(), 0.0)?;
        }
    }
    (area_vector(&part).length() > THIN * area_vector(from).length()).then_some(part)
}

/// The convex pieces of a convex polygon without a convex part of it.
fn rest(polygon: Vec<DVec3>, part: &[DVec3], normal: DVec3) -> Vec<Vec<DVec3>> {
    let least = THIN * area_vector(&polygon).length();
    let (mut left, mut pieces) = (polygon, Vec::new());
    for k in 0..part.len() {
        let (a, b) = (part[k], part[(k + 1) % part.len()]);
        let inward = normal.cross(b - a).normalize_or_zero();
        pieces.extend(clip(&left, a, -inward, 0.0).filter(|piece| area_vector(piece).length() > least));
        let Some(inside) = clip(&left, a, inward, 0.0) else { break };
        left = inside;
    }
    pieces
}

/// The convex hull of points in a plane, counterclockwise as seen from where the normal points (A. M. Andrew, "Another
/// Efficient Algorithm for Convex Hulls in Two Dimensions", Information Processing Letters 9(5), 1979).
fn hull(points: impl Iterator<Item = DVec3>, normal: DVec3) -> Vec<DVec3> {
    let along = normal.any_orthonormal_vector();
    let across = normal.cross(along);
    let mut points: Vec<DVec3> = points.collect();
    let by_place = |a: &DVec3, b: &DVec3| {
        a.dot(along).total_cmp(&b.dot(along)).then(a.dot(across).total_cmp(&b.dot(across)))
    };
    points.sort_by(by_place);
    // The direction between two roundings of one corner is arbitrary.
    let same = THIN * points[0].distance(points[points.len() - 1]);
    let chain = |points: &mut dyn Iterator<Item = &DVec3>| {
        let mut chain: Vec<DVec3> = Vec::new();
        for &point in points {
            if chain.last().is_some_and(|last| last.distance(point) <= same) {
                continue;
            }
            while let [.., a, b] = chain[..] {
                if (b - a).cross(point - b).dot(normal) > 0.0 {
                    break;
                }
                chain.pop();
            }
            chain.push(point);
        }
        chain.pop();
        chain
    };
    let mut ring = chain(&mut points.iter());
    ring.append(&mut chain(&mut points.iter().rev()));
    ring
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
    use glam::DQuat;

    use super::*;
    use crate::{form_factor::exact::opposed_squares_with_blocker, view_factor::polygon::level_square};

    fn square(side: f64, height: f64, up: bool) -> Vec<DVec3> {
        level_square(side, DVec3::Z * height, up)
    }

    /// The mean over a grid of points, with nothing between and past the blockers.
    fn mean(p: &[DVec3], q: &[DVec3], blockers: &[(Vec<DVec3>, DVec3)], n: u32) -> (f64, f64) {
        let all = exchange_near(p, q);
        let shadows = Shadows::between(
            &Area::new(p.to_vec(), DVec3::Z),
            &Area::new(q.to_vec(), -DVec3::Z),
            blockers.iter().map(|(corners, normal)| (&corners[..], *normal)),
        );
        let Some(shadows) = shadows else { return (all, all) };
        let (_, beside) = shadows.exchange(all);
        let mut pieces = Pieces::default();
        let at = |k: u32| (f64::from(k) + 0.5) / f64::from(n);
        let points = if shadows.is_empty() { 0 } else { n * n };
        let seen = (0..points).map(|k| shadows.seen_from(at(k / n), at(k % n), &mut pieces).1).sum::<f64>();
        (all, beside + seen / f64::from(n * n))
    }

    /// The hull of the corners of adjoining squares, each rounded in its own way, whichever way they are turned.
    #[test]
    fn a_hull_of_rounded_corners() {
        for turn in 0..50 {
            let turned = DQuat::from_rotation_z(0.13 * f64::from(turn)) * DQuat::from_rotation_x(0.7);
            let corners = |shift: f64| {
                let rounding = 1e-17 * f64::from(turn % 7 - 3);
                square(1.0, 0.0, true).into_iter().map(move |v| turned * (v + dvec3(shift, rounding, 0.0)))
            };
            let points = (0..4).flat_map(|k| corners(f64::from(k)).chain(corners(f64::from(k) + 1e-16)));
            let ring = hull(points, turned * DVec3::Z);
            assert!((area_vector(&ring).dot(turned * DVec3::Z) - 4.0).abs() < 1e-9, "{turn}: {ring:?}");
        }
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

    /// A square that lies nearly on another one hides what lies beneath it, and points are chosen only there. Two such
    /// squares need all of their hull.
    #[test]
    fn points_are_chosen_where_something_may_be_hidden() {
        let (p, q) = (square(1.0, 0.0, true), square(1.0, 1.0, false));
        let at = |x: f64, y: f64| -> (Vec<DVec3>, DVec3) {
            (square(0.2, 1e-4, true).iter().map(|&v| v + dvec3(x, y, 0.0)).collect(), DVec3::Z)
        };
        let beneath = |(corners, _): &(Vec<DVec3>, DVec3)| exchange_near(corners, &q);
        let region = |blockers: &[(Vec<DVec3>, DVec3)]| {
            Shadows::between(
                &Area::new(p.clone(), DVec3::Z),
                &Area::new(q.clone(), -DVec3::Z),
                blockers.iter().map(|(corners, normal)| (&corners[..], *normal)),
            )
            .map(|shadows| shadows.penumbra.map_or(1.0, |corners| area_vector(&corners).length()))
        };
        let (one, two) = (at(0.25, 0.1), at(-0.3, 0.1));
        let (all, seen) = mean(&p, &q, std::slice::from_ref(&one), 200);
        assert!(((all - seen) / beneath(&one) - 1.0).abs() < 2e-3, "{all} {seen}");
        assert!((region(std::slice::from_ref(&one)).unwrap() / 0.04 - 1.0).abs() < 5e-3);
        let both = [one, two];
        let (all, seen) = mean(&p, &q, &both, 200);
        let hidden: f64 = both.iter().map(beneath).sum();
        assert!(((all - seen) / hidden - 1.0).abs() < 2e-2, "{all} {seen} {hidden}");
        assert!((region(&both).unwrap() / (0.2 * 0.75) - 1.0).abs() < 5e-3);
        // Beside the shaft.
        assert!(region(&[at(0.7, 0.0)]).is_none());
    }

    /// From most of a square, a larger one near it hides all of a distant one: points are chosen near the edges only, in
    /// the frame between the umbra and the penumbra.
    #[test]
    fn points_are_chosen_where_something_may_be_seen() {
        let (p, q) = (square(1.0, 0.0, true), square(2.0, 1.0, false));
        let cover = [(square(1.0, 0.01, true), DVec3::Z)];
        let shadows = Shadows::between(
            &Area::new(p.clone(), DVec3::Z),
            &Area::new(q.clone(), -DVec3::Z),
            cover.iter().map(|(corners, normal)| (&corners[..], *normal)),
        )
        .unwrap();
        // A corner of the square at (1, 1, 1) is hidden from (x, x) for x < 0.5 - 0.5 * 0.01 / 0.99.
        let hidden = 1.0 - 0.01 / 0.99;
        assert!((shadows.area - (1.0 - hidden * hidden)).abs() < 1e-9, "{}", shadows.area);
        assert!(shadows.exchange(1.0) == (None, 0.0));
        // As seen from the other square, which is sampled whole where it is the smaller one.
        let (_, seen) = mean(&p, &q, &cover, 400);
        let exact = exchange_near(&p, &q) - exchange_near(&cover[0].0, &q);
        assert!(seen > 0.0 && seen < 0.1 * exchange_near(&p, &q) && seen > exact, "{seen} {exact}");
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
            assert!((whole - seen).abs() < 1e-3 * whole, "{height}: {whole} {seen}");
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
