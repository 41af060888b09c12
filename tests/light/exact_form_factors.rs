//! Exact form factors against published numbers, each other, quadrature and conservation laws.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DMat3, DQuat, DVec3, dvec3};
use proptest::prelude::*;
use radiosity::form_factor::exact::*;

/// Half a unit in the twelfth decimal, to which the reference numbers are given, plus rounding.
const TWELVE_DIGITS: f64 = 0.51e-12;

#[track_caller]
fn assert_close(got: f64, want: f64, tolerance: f64) {
    assert!((got - want).abs() <= tolerance, "{got:e} instead of {want:e}, off by {:e}", got - want);
}

fn square(corner: DVec3, u: DVec3, v: DVec3) -> [DVec3; 4] {
    [corner, corner + u, corner + u + v, corner + v]
}

fn centroid(polygon: &[DVec3]) -> DVec3 {
    polygon.iter().sum::<DVec3>() / polygon.len() as f64
}

fn perimeter(polygon: &[DVec3]) -> f64 {
    (0..polygon.len()).map(|k| polygon[k].distance(polygon[(k + 1) % polygon.len()])).sum()
}

fn unit_normal(t: &[DVec3]) -> DVec3 {
    (t[1] - t[0]).cross(t[2] - t[0]).normalize()
}

/// Integrates over a triangle by 4^`level` copies of Radon's seven points, exact for degree 5. For a smooth function
/// each level divides the error by 64.
fn integrate(t: [DVec3; 3], level: u32, f: &dyn Fn(DVec3) -> f64) -> f64 {
    let [a, b, c] = t;
    if level > 0 {
        let (ab, bc, ca) = ((a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0);
        return [[a, ab, ca], [ab, b, bc], [ca, bc, c], [bc, ca, ab]]
            .iter()
            .map(|&t| integrate(t, level - 1, f))
            .sum();
    }
    let s = 15f64.sqrt();
    let mut sum = 9.0 / 40.0 * f((a + b + c) / 3.0);
    for (x, w) in [((6.0 - s) / 21.0, (155.0 - s) / 1200.0), ((6.0 + s) / 21.0, (155.0 + s) / 1200.0)] {
        for [p, q, r] in [[a, b, c], [b, c, a], [c, a, b]] {
            sum += w * f(p * (1.0 - 2.0 * x) + (q + r) * x);
        }
    }
    sum * 0.5 * (b - a).cross(c - a).length()
}

/// Form factors of the catalogue agree with reference numbers of twelve decimals.
#[test]
fn catalogue_numbers() {
    for (a, b, c, f) in [
        (1.0, 1.0, 1.0, 0.199824895698),
        (2.0, 1.0, 1.0, 0.285875384851),
        (1.0, 1.0, 0.1, 0.826994522397),
        (1.0, 1.0, 10.0, 0.003162056839),
    ] {
        assert_close(opposed_rectangles(a, b, c), f, TWELVE_DIGITS);
    }
    for (l, w, h, f) in
        [(1.0, 1.0, 1.0, 0.200043776075), (2.0, 1.0, 1.0, 0.240636006177), (1.0, 1.0, 2.0, 0.232852602795)]
    {
        assert_close(perpendicular_rectangles(l, w, h), f, TWELVE_DIGITS);
    }
    for (r1, r2, h, f) in
        [(1.0, 1.0, 1.0, 0.381966011250), (1.0, 2.0, 1.0, 0.763932022500), (1.0, 0.5, 2.0, 0.048058983989)]
    {
        assert_close(coaxial_disks(r1, r2, h), f, TWELVE_DIGITS);
    }
    for (s, f) in [(0.25, 0.169474204912), (0.5, 0.099506294599), (1.0, 0.0), (0.0, 0.199824895698)] {
        assert_close(opposed_squares_with_blocker(1.0, 1.0, s), f, TWELVE_DIGITS);
    }
    let triangle = [dvec3(0.1, 0.2, 1.2), dvec3(0.3, 1.1, 0.7), dvec3(1.2, 0.4, 0.9)];
    assert_close(point_to_polygon(dvec3(0.3, 0.2, 0.0), DVec3::Z, &triangle), 0.122926902965, TWELVE_DIGITS);
}

/// If a length is a million times another, the textbook expressions lose all digits. Their limits are known. The
/// tolerances are the first neglected terms, or 1e-14 if those are smaller.
#[test]
fn catalogue_limits() {
    // Small and far: the product of the areas over pi c², with relative corrections of order 1e-12.
    assert_close(opposed_rectangles(1.0, 2.0, 1e6) * PI * 1e12 / 2.0, 1.0, 1e-11);
    assert_close(coaxial_disks(1.0, 1e-3, 1e6) * 1e18, 1.0, 1e-11);
    // Very long strips, by crossed strings. The ends matter in proportion to distance over length.
    assert_close(opposed_rectangles(1.0, 1e9, 1.0), 2f64.sqrt() - 1.0, 1e-8);
    let far_strips = opposed_rectangles(1e-6, 1e9, 1.0);
    assert_close(far_strips / 0.5e-6, 1.0, 1e-8);
    for (w, h) in [(1.0, 1.0), (1.0, 3.0), (1e-4, 1.0), (1.0, 1e-4)] {
        let strings = 0.5 * (1.0 + h / w - 1f64.hypot(h / w));
        assert_close(perpendicular_rectangles(1e9, w, h) / strings, 1.0, 1e-8);
    }
    // A very narrow floor sees the wall fill half of its hemisphere, up to terms of order W ln W.
    assert_close(perpendicular_rectangles(1.0, 1e-9, 1.0), 0.5, 1e-7);
    // A very short common edge: F = (ln(WH / S) / 2 + 3/4) / (π W) with W, H, S in units of the edge. Corrections are
    // of order W^-2.
    let (w, h) = (1e6f64, 2e6f64);
    let expected = (0.5 * (w * h / w.hypot(h)).ln() + 0.75) / (PI * w);
    assert_close(perpendicular_rectangles(1e-6, 1.0, 2.0) / expected, 1.0, 1e-11);
    // Close plates see almost only each other: the loss is at most perimeter times distance over area.
    for c in [1e-3, 1e-6, 1e-12] {
        for f in [opposed_rectangles(1.0, 1.0, c), coaxial_disks(1.0, 1.0, c)] {
            assert!(f <= 1.0 && f > 1.0 - 4.0 * c, "{f} at {c}");
        }
    }
}

/// Coaxial disks: A1 F12 = A2 F21, to rounding.
#[test]
fn disks_are_reciprocal() {
    for (r1, r2, h) in [(1.0, 2.0, 1.0), (1e-6, 3.0, 0.1), (5.0, 1.0, 1e4)] {
        let (there, back) = (r1 * r1 * coaxial_disks(r1, r2, h), r2 * r2 * coaxial_disks(r2, r1, h));
        assert_close(there / back, 1.0, 1e-14);
    }
}

/// The general formulas for rectangles and polygons agree with those of the catalogue, over twelve orders of scale. The
/// tolerance is the rounding of their corner sums.
#[test]
fn general_formulas_reduce_to_the_catalogue() {
    for scale in [1e-6, 1.0, 1e6] {
        for (a, b, c) in
            [(1.0, 1.0, 1.0), (2.0, 1.0, 0.3), (1.0, 1.0, 1e-6), (1.0, 3.0, 40.0), (1.0, 1.0, 1e4)]
        {
            let want = opposed_rectangles(a, b, c);
            let (a, b, c) = (a * scale, b * scale, c * scale);
            let low =
                AxisRectangle { axis: Axis::Z, positive: true, offset: 0.0, min: [0.0; 2], max: [a, b] };
            let high = AxisRectangle { positive: false, offset: c, ..low };
            assert_close(low.form_factor(&high) / want, 1.0, 1e-12);
            assert_close(polygon_form_factor(&low.corners(), &high.corners()) / want, 1.0, 1e-12);
        }
        for (l, w, h) in [(1.0, 1.0, 1.0), (3.0, 1.0, 0.2), (0.01, 1.0, 1.0), (1.0, 1e-3, 1.0)] {
            let want = perpendicular_rectangles(l, w, h);
            let (l, w, h) = (l * scale, w * scale, h * scale);
            let floor =
                AxisRectangle { axis: Axis::Z, positive: true, offset: 0.0, min: [0.0; 2], max: [w, l] };
            let wall =
                AxisRectangle { axis: Axis::X, positive: true, offset: 0.0, min: [0.0; 2], max: [l, h] };
            // The smallest term is 1e-3 of the largest, so the corner sums lose three digits.
            assert_close(floor.form_factor(&wall) / want, 1.0, 1e-11);
            assert_close(polygon_form_factor(&floor.corners(), &wall.corners()) / want, 1.0, 1e-11);
        }
    }
}

/// The walls of a closed box cut into rectangles: rows sum to one and exchange areas are symmetric, to rounding.
#[test]
fn room_rows_sum_to_one_and_exchange_is_symmetric() {
    for n in 1..=6 {
        let patches = box_room_patches(DVec3::ONE, n);
        assert_eq!(patches.len(), 6 * n * n);
        let f = rectangle_form_factors(&patches);
        let area = 1.0 / (n * n) as f64;
        for i in 0..patches.len() {
            assert_close(patches[i].area(), area, 1e-15);
            // A row adds about 200 numbers below 1. Each has an error of some units of 1e-16.
            assert_close(f.row(i).sum(), 1.0, 1e-13);
            for j in 0..patches.len() {
                assert!((0.0..=1.0).contains(&f[(i, j)]));
                assert_close(patches[i].area() * f[(i, j)], patches[j].area() * f[(j, i)], 1e-15);
            }
        }
    }
    let f = rectangle_form_factors(&box_room_patches(dvec3(1.0, 20.0, 0.1), 4));
    for i in 0..f.nrows() {
        // The errors of the closed forms are 1e-15 of 400, the square of the room's size. A patch has an area of 1/160
        // to 5/4.
        assert_close(f.row(i).sum(), 1.0, 1e-11);
    }
}

/// The six faces of a cube: opposite faces and neighbours have the two form factors of the catalogue.
#[test]
fn the_cube_of_six_patches() {
    let f = rectangle_form_factors(&box_room_patches(DVec3::ONE, 1));
    for (i, j) in (0..6).flat_map(|i| (0..6).map(move |j| (i, j))) {
        let want = match (i, j) {
            _ if i == j => 0.0,
            _ if i / 2 == j / 2 => 0.199824895698,
            _ => 0.200043776075,
        };
        assert_close(f[(i, j)], want, TWELVE_DIGITS);
    }
}

/// A wall that reaches through the floor: only its part above the floor counts, as if it had been cut there.
#[test]
fn rectangles_across_the_line_of_intersection() {
    let floor =
        AxisRectangle { axis: Axis::Z, positive: true, offset: 0.0, min: [-0.7, 0.0], max: [1.0, 1.0] };
    let wall =
        AxisRectangle { axis: Axis::X, positive: true, offset: 0.0, min: [0.0, -0.4], max: [1.0, 1.0] };
    let want = perpendicular_rectangles(1.0, 1.0, 1.0);
    assert_close(floor.exchange_area(&wall), want, 1e-14);
    assert_close(polygon_exchange_area(&floor.corners(), &wall.corners()), want, 1e-13);
    let back = AxisRectangle { positive: false, ..wall };
    let want = 0.7 * perpendicular_rectangles(1.0, 0.7, 1.0);
    assert_close(floor.exchange_area(&back), want, 1e-14);
    assert_close(polygon_exchange_area(&floor.corners(), &back.corners()), want, 1e-13);
    let below = AxisRectangle { max: [1.0, -0.1], ..wall };
    assert_eq!(floor.exchange_area(&below), 0.0);
    assert_eq!(polygon_exchange_area(&floor.corners(), &below.corners()), 0.0);
}

/// Surfaces that do not face each other, lie in one plane or have no area have a form factor of exactly zero.
#[test]
fn surfaces_that_do_not_face_each_other_exchange_nothing() {
    let low = square(DVec3::ZERO, DVec3::X, DVec3::Y);
    let high = |v: [DVec3; 4]| v.map(|p| p + DVec3::Z);
    let flipped = |v: [DVec3; 4]| [v[0], v[3], v[2], v[1]];
    assert!(polygon_exchange_area(&low, &flipped(high(low))) > 0.19);
    assert_eq!(polygon_exchange_area(&low, &high(low)), 0.0);
    assert_eq!(polygon_exchange_area(&flipped(low), &high(low)), 0.0);
    assert_eq!(polygon_exchange_area(&flipped(low), &flipped(high(low))), 0.0);
    // In one plane: neighbours, and a square with itself.
    let beside = square(DVec3::X, DVec3::X, DVec3::Y);
    assert_eq!(polygon_exchange_area(&low, &beside), 0.0);
    assert_eq!(polygon_exchange_area(&low, &low), 0.0);
    // The same, tilted, so that no coordinate is exact.
    let turn = DMat3::from_quat(DQuat::from_euler(glam::EulerRot::XYZ, 0.3, 1.1, -2.0));
    let tilt = |v: [DVec3; 4]| v.map(|p| turn * p + dvec3(3.0, -7.0, 0.1));
    assert_eq!(polygon_exchange_area(&tilt(low), &tilt(beside)), 0.0);
    // A polygon without area exchanges nothing, and neither does a polygon whose corners are one point.
    assert_eq!(polygon_exchange_area(&low, &[DVec3::Z, dvec3(1.0, 0.0, 1.0), dvec3(2.0, 0.0, 1.0)]), 0.0);
    assert_eq!(polygon_exchange_area(&[DVec3::Z; 3], &[DVec3::Z; 3]), 0.0);
}

/// The form factors from a point in a closed room to all walls sum to 1, also from the floor, where the walls begin at
/// the horizon.
#[test]
fn a_point_in_a_room_sees_everything() {
    let faces = box_room_patches(dvec3(1.0, 2.0, 0.5), 1);
    for (p, n) in [
        (dvec3(0.3, 0.4, 0.0), DVec3::Z),
        (dvec3(0.3, 1.9, 0.2), dvec3(0.48, 0.6, 0.64)),
        (dvec3(0.999999, 1.0, 0.25), dvec3(-0.6, 0.8, 0.0)),
    ] {
        let sum: f64 = faces.iter().map(|f| point_to_polygon(p, n, &f.corners())).sum();
        // From a point on the floor, the floor itself adds 1: the limit from below it.
        assert_close(sum, if p.z == 0.0 { 2.0 } else { 1.0 }, 1e-14);
    }
}

/// Form factors of points on a polygon, on its edge, on its corner, beside and behind it; half of the hemisphere for an
/// infinite wall; sin² t for a disk of half-angle t about the normal.
#[test]
fn points_at_the_polygon_and_at_its_horizon() {
    let low = square(DVec3::ZERO, DVec3::X, DVec3::Y);
    assert_close(point_to_polygon(dvec3(0.5, 0.3, 0.0), DVec3::Z, &low), 1.0, 1e-15);
    assert_close(point_to_polygon(dvec3(0.5, 0.3, -1e-9), DVec3::Z, &low), 1.0, 1e-8);
    assert_close(point_to_polygon(dvec3(0.5, 0.0, 0.0), DVec3::Z, &low), 0.5, 1e-15);
    assert_close(point_to_polygon(DVec3::ZERO, DVec3::Z, &low), 0.25, 1e-15);
    assert_close(point_to_polygon(dvec3(3.0, 0.3, 0.0), DVec3::Z, &low), 0.0, 1e-15);
    assert_eq!(point_to_polygon(dvec3(0.5, 0.5, 1.0), DVec3::Z, &low), 0.0);
    // A wall that extends to infinity from the height of the point, in all directions: half of the hemisphere.
    let wall = [dvec3(1.0, -1e9, -1e9), dvec3(1.0, 1e9, -1e9), dvec3(1.0, 1e9, 1e9), dvec3(1.0, -1e9, 1e9)];
    assert_close(point_to_polygon(DVec3::ZERO, DVec3::Z, &wall), 0.5, 1e-8);
    // A disk of half-angle t about the normal has the form factor sin² t, an inscribed polygon slightly less.
    let n = 10_000;
    let circle: Vec<DVec3> = (0..n)
        .map(|k| {
            let a = 2.0 * PI * k as f64 / n as f64;
            dvec3(a.cos(), a.sin(), 2.0)
        })
        .collect();
    // The polygon has the area of the disk times 1 - (2π / n)² / 6 = 1 - 6.6e-8.
    assert_close(point_to_polygon(DVec3::ZERO, DVec3::Z, &circle), 0.2, 0.2 * 7e-8);
}

/// Small and far polygons: the product of the areas over π r² times the cosines, with relative accuracy down to values
/// of 1e-24. The coordinates are exact in binary, so the triangles have exactly this shape.
#[test]
fn far_polygons_keep_their_digits() {
    let e = 2f64.powi(-20);
    let p = [DVec3::ZERO, dvec3(e, 0.0, 0.0), dvec3(0.0, e, 0.0)];
    let shift = dvec3(0.25, -0.5, 1.0);
    let q = p.map(|v| dvec3(v.y, v.x, 0.0) + shift);
    let (area, r2) = (0.5 * e * e, shift.length_squared());
    let per_area = area / (PI * r2 * r2);
    // The centroids are `shift` apart. Neglected terms are of second order in size over distance, 1e-12.
    assert_close(polygon_exchange_area(&p, &q) / (area * per_area), 1.0, 1e-11);
    // The point itself is rounded to 1e-16 of the distance.
    assert_close(point_to_polygon(centroid(&p), DVec3::Z, &q) / per_area, 1.0, 1e-9);
    // Small against large: the point formula at the centroid of the small one, again up to second order.
    let large = [dvec3(-3.0, -2.0, 1.0), dvec3(-1.0, 5.0, 1.5), dvec3(4.0, -1.0, 0.5)];
    let want = area * point_to_polygon(centroid(&p), DVec3::Z, &large);
    assert_close(polygon_exchange_area(&p, &large) / want, 1.0, 1e-11);
}

/// Long strips that share an edge: F = 1 - sin(angle / 2), by crossed strings.
#[test]
fn wedge_of_long_strips() {
    for angle in [0.05, 0.5, FRAC_PI_2, 2.5, 3.1f64] {
        let up = dvec3(angle.cos(), 0.0, angle.sin());
        let along = DVec3::Y * 1e4;
        let floor = square(DVec3::ZERO, DVec3::X, along);
        let wall = square(DVec3::ZERO, along, up);
        // The two ends lose at most about their width over the length of 1e4.
        assert_close(polygon_form_factor(&floor, &wall), 1.0 - (0.5 * angle).sin(), 2e-4);
    }
}

/// Two vertices are no polygon, which is a programming error.
#[test]
#[should_panic(expected = "3 vertices")]
fn two_vertices_are_no_polygon() {
    polygon_exchange_area(&[DVec3::X, DVec3::Y], &[DVec3::X, DVec3::Y, DVec3::Z]);
}

/// A distance of zero is no configuration, which is a programming error.
#[test]
#[should_panic(expected = "positive")]
fn no_distance_is_no_configuration() {
    opposed_rectangles(1.0, 1.0, 0.0);
}

fn point(low: f64, high: f64) -> impl Strategy<Value = DVec3> {
    (low..high, low..high, low..high).prop_map(|(x, y, z)| dvec3(x, y, z))
}

fn triangle(low: f64, high: f64) -> impl Strategy<Value = [DVec3; 3]> {
    [point(low, high), point(low, high), point(low, high)]
        .prop_filter("a sliver", |t| (t[1] - t[0]).cross(t[2] - t[0]).length() > 0.02)
}

/// Rectangles on a coarse grid, so that shared edges, planes and T-junctions are common, or anywhere.
fn rectangle() -> impl Strategy<Value = AxisRectangle> {
    let coordinate = || prop_oneof![(0..5).prop_map(|i| 0.5 * i as f64), 0.0..2.0f64];
    let axis = prop_oneof![Just(Axis::X), Just(Axis::Y), Just(Axis::Z)];
    (axis, any::<bool>(), [coordinate(), coordinate(), coordinate(), coordinate(), coordinate()])
        .prop_map(|(axis, positive, [offset, a, b, c, d])| AxisRectangle {
            axis,
            positive,
            offset,
            min: [a.min(b), c.min(d)],
            max: [a.max(b), c.max(d)],
        })
        .prop_filter("too thin", |r| r.max[0] - r.min[0] > 0.01 && r.max[1] - r.min[1] > 0.01)
}

fn rotation() -> impl Strategy<Value = DMat3> {
    (-3.0..3.0f64, -1.5..1.5f64, -3.0..3.0f64)
        .prop_map(|(a, b, c)| DMat3::from_quat(DQuat::from_euler(glam::EulerRot::XYZ, a, b, c)))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 500, failure_persistence: None, ..ProptestConfig::default() })]

    /// Contour integrals of polygons agree with corner sums of rectangles. Both have errors of some units of 1e-16
    /// times 16 terms of the order of the squared extent, 12 at most.
    #[test]
    fn polygons_agree_with_axis_aligned_rectangles(a in rectangle(), b in rectangle()) {
        let want = a.exchange_area(&b);
        assert_close(polygon_exchange_area(&a.corners(), &b.corners()), want, 2e-13);
        assert_close(b.exchange_area(&a), want, 1e-14);
        prop_assert!(want >= 0.0 && want <= a.area().min(b.area()));
    }

    /// Cutting a rectangle in two keeps the total exchange area, up to the rounding of the corner sums.
    #[test]
    fn rectangles_are_additive(a in rectangle(), b in rectangle(), t in 0.1..0.9f64) {
        let cut = b.min[0] + t * (b.max[0] - b.min[0]);
        let low = AxisRectangle { max: [cut, b.max[1]], ..b };
        let high = AxisRectangle { min: [cut, b.min[1]], ..b };
        assert_close(a.exchange_area(&low) + a.exchange_area(&high), a.exchange_area(&b), 5e-14);
    }

    /// The faces of a tetrahedron see only each other, so every row sums to one, whatever the angles at the shared
    /// edges. One face is cut in two, so that its edges meet those of its neighbours only in part.
    #[test]
    fn tetrahedra_are_closed(v in [point(0.0, 1.0), point(0.0, 1.0), point(0.0, 1.0), point(0.0, 1.0)], t in 0.1..0.9f64) {
        let [a, b, c, d] = v;
        let volume = (b - a).cross(c - a).dot(d - a);
        prop_assume!(volume.abs() > 0.01);
        let (b, c) = if volume > 0.0 { (b, c) } else { (c, b) };
        let e = a + (b - a) * t;
        // Counterclockwise seen from inside.
        let faces = [[a, b, c], [a, c, d], [b, d, c]];
        let cut = [[a, d, e], [e, d, b]];
        for f in &faces {
            let others = faces.iter().chain(&cut).filter(|g| *g != f);
            let sum: f64 = others.map(|g| polygon_exchange_area(f, g)).sum();
            assert_close(sum / polygon_area(f), 1.0, 1e-12);
        }
    }

    /// Contour integrals agree with Lambert's formula for points, integrated over the other triangle. The tolerance is
    /// a tenth of the change between the two finest levels of the quadrature, which extrapolation removes.
    #[test]
    fn polygons_agree_with_integrated_points(p in triangle(0.0, 1.0), q in triangle(0.0, 1.0), gap in 0.3..2.0f64) {
        let up = |t: [DVec3; 3], way: f64| if unit_normal(&t).z * way > 0.0 { t } else { [t[0], t[2], t[1]] };
        let (p, q) = (up(p, 1.0), up(q.map(|v| v + DVec3::Z * (1.0 + gap)), -1.0));
        let (n, m) = (unit_normal(&p), unit_normal(&q));
        // Clipped parts make a kink in the integrand; the next test has those.
        prop_assume!(q.iter().all(|v| (*v - p[0]).dot(n) > 0.0) && p.iter().all(|v| (*v - q[0]).dot(m) > 0.0));
        let at = |level| integrate(p, level, &|x| point_to_polygon(x, n, &q));
        let (coarse, fine) = (at(3), at(4));
        let want = fine + (fine - coarse) / 63.0;
        let got = polygon_exchange_area(&p, &q);
        assert_close(got, want, 1e-12 + 0.1 * (fine - coarse).abs());
        assert_close(got / want, 1.0, 1e-8);
        assert_close(polygon_exchange_area(&q, &p), got, 1e-15 * perimeter(&p) * perimeter(&q));
    }

    /// Triangles that cut each other's planes agree with quadrature of the visible half of the kernel.
    #[test]
    fn clipped_polygons_agree_with_integrated_points(p in triangle(0.0, 1.0), q in triangle(0.0, 1.0)) {
        let q = q.map(|v| v + dvec3(0.6, 0.0, 0.6));
        let (n, m) = (unit_normal(&p), unit_normal(&q));
        let seen = |x: DVec3| if (x - q[0]).dot(m) > 0.0 { point_to_polygon(x, n, &q) } else { 0.0 };
        let got = polygon_exchange_area(&p, &q);
        // The integrand has a step where the planes meet, of at most 1. The quadrature resolves it to a fraction of a
        // cell of 1/128.
        assert_close(got, integrate(p, 6, &seen), 2e-3 * polygon_area(&p).sqrt());
        prop_assert!(got >= 0.0 && got <= polygon_area(&p).min(polygon_area(&q)) * (1.0 + 1e-14));
    }

    /// Cutting a triangle in two keeps the total exchange area, also if its plane cuts the other one. Contour integrals
    /// have errors of about 1e-15 times the product of the perimeters, 25 at most.
    #[test]
    fn polygons_are_additive_and_reciprocal(p in triangle(0.0, 1.0), q in triangle(0.0, 1.0), t in 0.1..0.9f64) {
        let e = q[0] + (q[1] - q[0]) * t;
        let parts = polygon_exchange_area(&p, &[q[0], e, q[2]]) + polygon_exchange_area(&p, &[e, q[1], q[2]]);
        let whole = polygon_exchange_area(&p, &q);
        assert_close(parts, whole, 1e-12);
        assert_close(polygon_exchange_area(&q, &p), whole, 1e-12);
    }

    /// Moving, rotating and scaling a pair changes nothing. The coordinates round at 1e-16 of the shift, which is ten
    /// times the size.
    #[test]
    fn polygons_do_not_depend_on_the_frame(
        p in triangle(0.0, 1.0),
        q in triangle(0.0, 1.0),
        turn in rotation(),
        shift in point(-10.0, 10.0),
        exponent in -6.0..6.0f64,
    ) {
        let scale = 10f64.powf(exponent);
        let moved = |t: [DVec3; 3]| t.map(|v| (turn * v + shift) * scale);
        let want = polygon_exchange_area(&p, &q);
        assert_close(polygon_exchange_area(&moved(p), &moved(q)) / (scale * scale), want, 1e-12);
        let (n, m) = (unit_normal(&p), unit_normal(&moved(p)));
        assert_close(point_to_polygon(moved(p)[0], m, &moved(q)), point_to_polygon(p[0], n, &q), 1e-11);
    }
}
