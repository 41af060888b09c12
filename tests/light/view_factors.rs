//! View factors between polygons against closed forms, and against hemisphere rays, which share no estimator with them.

use crate::common::parallelogram as rectangle;
use glam::{DQuat, DVec3, dvec3};
use radiosity::{
    Error, Progress, Scene,
    form_factor::{
        CastOptions, FormFactors,
        exact::{opposed_rectangles, opposed_squares_with_blocker, perpendicular_rectangles},
    },
    patch::{Patches, Subdivision},
    scene::Material,
    trace::Tracer,
    view_factor::{
        Enclosure, ViewFactorOptions, ViewFactors, look, view_factors, view_factors_among,
        view_factors_of_surfaces,
    },
};

/// The six sides of a box, each cut into n × n. They face outward with side 1, and inward with side -1.
fn sides(centre: DVec3, half: DVec3, turn: f64, side: f64, n: u32) -> Vec<Vec<DVec3>> {
    let turned = DQuat::from_rotation_z(turn);
    let mut polygons = Vec::new();
    for wall in 0..6 {
        let (axis, sign) = (wall / 2, if wall % 2 == 0 { -1.0 } else { 1.0 });
        let (a, b) = (DVec3::AXES[(axis + 1) % 3], DVec3::AXES[(axis + 2) % 3] * sign * side);
        let at = |u: u32, v: u32| {
            let [u, v] = [u, v].map(|w| 2.0 * f64::from(w) / f64::from(n) - 1.0);
            centre + turned * ((DVec3::AXES[axis] * sign + a * u + b * v) * half)
        };
        for k in 0..n * n {
            let (u, v) = (k % n, k / n);
            polygons.push(vec![at(u, v), at(u + 1, v), at(u + 1, v + 1), at(u, v + 1)]);
        }
    }
    polygons
}

fn square(side: f64, height: f64, up: bool) -> Vec<DVec3> {
    let corner = dvec3(-0.5 * side, -0.5 * side, height);
    let [a, b] = [DVec3::X * side, DVec3::Y * side];
    if up { rectangle(corner, a, b) } else { rectangle(corner, b, a) }
}

fn room_with_block() -> Vec<Vec<DVec3>> {
    let mut polygons = sides(DVec3::splat(0.5), DVec3::splat(0.5), 0.0, -1.0, 2);
    polygons.extend(sides(dvec3(0.55, 0.45, 0.4), dvec3(0.2, 0.15, 0.25), 0.5, 1.0, 1));
    polygons
}

fn compute(polygons: &[Vec<DVec3>], error: f64, enclosed: bool) -> ViewFactors {
    let options = ViewFactorOptions::default().with_error(error).with_enclosed(enclosed).with_seed(3);
    view_factors(polygons, &options, &Progress::new()).unwrap()
}

/// Nothing blocks in a cube, so all view factors are the closed forms, without sampling.
#[test]
fn a_cube_is_exact_without_chance() {
    let cube = sides(DVec3::ZERO, DVec3::splat(0.5), 0.0, -1.0, 1);
    let form_factors = compute(&cube, 1e-2, true);
    for i in 0..6 {
        for j in (0..6).filter(|&j| j != i) {
            let exact = if i / 2 == j / 2 {
                opposed_rectangles(1.0, 1.0, 1.0)
            } else {
                perpendicular_rectangles(1.0, 1.0, 1.0)
            };
            // Stored in single precision. Rows that do not sum to one would move by the error of the closed forms.
            assert!(
                (form_factors.get(i, j) - exact).abs() < 1e-6,
                "{i} {j}: {} not {exact}",
                form_factors.get(i, j)
            );
        }
    }
}

/// A square between two squares blocks as much as the closed form says, within 4.5 standard errors. The standard error
/// is as large as the wanted error allows: this pair has all of it.
#[test]
fn a_blocker_hides_what_the_closed_form_says() {
    let error = 1e-3;
    let polygons =
        [square(1.0, 0.0, true), square(1.0, 1.0, false), square(0.6, 0.5, true), square(0.6, 0.5, false)];
    let form_factors = compute(&polygons, error, false);
    let exact = opposed_squares_with_blocker(1.0, 1.0, 0.6);
    let (found, sigma) = (form_factors.get(0, 1), form_factors.standard_error(0, 1));
    // All of the error, Σ σ² = non-zeros error², belongs to this pair, in both directions.
    let most = error * (form_factors.non_zeros() as f64 / 2.0).sqrt();
    assert!(sigma < most && sigma > 0.3 * most, "{sigma} of {most}");
    assert!((found - exact).abs() < 4.5 * sigma, "{found}, not {exact}");
    for i in 0..4 {
        let sum: f64 = form_factors.row(i).map(|(_, f)| f).sum();
        assert!((sum + form_factors.escaped(i) - 1.0).abs() < 1e-12);
    }
}

/// Hemisphere rays give the same view factors, in any unit and at any place. The RMS difference is at most the wanted
/// error and the standard error of the rays together.
#[test]
fn hemisphere_rays_find_the_same_in_any_unit_and_place() {
    let (error, rays) = (2e-4, 40_000.0);
    let polygons = room_with_block();
    let triangles: Vec<_> =
        polygons.iter().flat_map(|p| [([p[0], p[1], p[2]], 0), ([p[0], p[2], p[3]], 0)]).collect();
    let scene = Scene::new(&triangles, vec![Material::new("grey", [0.5; 3], [0.0; 3])]);
    let tracer = Tracer::new(&scene);
    let mut patches = Patches::subdivide(&scene, &Subdivision::Edge(f64::INFINITY));
    let options = CastOptions::default().with_rays(rays).with_shadow_share(0.0).with_by_variance(false);
    let cast = FormFactors::cast(&scene, &tracer, &mut patches, &options, &Progress::new()).unwrap();
    let of_quad = |p: usize, q: usize| {
        let share = |i: usize| cast.areas()[i] / (cast.areas()[2 * p] + cast.areas()[2 * p + 1]);
        [2 * p, 2 * p + 1]
            .map(|i| share(i) * (cast.get(i, 2 * q) + cast.get(i, 2 * q + 1)))
            .iter()
            .sum::<f64>()
    };
    let n = polygons.len();
    // Independent rays would have variances of F / rays, with 2 rays patches per polygon here. Stratified rays from
    // both ends have less.
    let bound = (error * error + 1.0 / n as f64 / (2.0 * rays)).sqrt();
    for (unit, place) in [(1.0, DVec3::ZERO), (1e-3, dvec3(1e3, -5e2, 2e2))] {
        let moved: Vec<Vec<DVec3>> =
            polygons.iter().map(|p| p.iter().map(|&v| v * unit + place).collect()).collect();
        let form_factors = compute(&moved, error, true);
        let reported = form_factors.error;
        assert!(reported <= error, "{reported} is more than {error}");
        let area: f64 = form_factors.areas().iter().sum::<f64>() / (unit * unit);
        assert!((area - 6.0 - 8.0 * (0.2 * 0.15 + 0.2 * 0.25 + 0.15 * 0.25)).abs() < 1e-9, "area {area}");
        let mut sum = 0.0;
        for p in 0..n {
            sum += (0..n).map(|q| (form_factors.get(p, q) - of_quad(p, q)).powi(2)).sum::<f64>();
            let row: f64 = form_factors.row(p).map(|(_, f)| f).sum();
            assert!((row - 1.0).abs() < 1e-12, "row {p} sums to {row}");
        }
        let rms = sum.sqrt() / n as f64;
        assert!(rms < bound, "differ by {rms:.2e}, more than {bound:.2e}");
    }
}

/// The view factors of parallelograms are the area-weighted sums of those of their triangles, within the wanted errors
/// of both.
#[test]
fn triangles_and_parallelograms_agree() {
    let polygons = room_with_block();
    let halves: Vec<Vec<DVec3>> =
        polygons.iter().flat_map(|p| [vec![p[0], p[1], p[2]], vec![p[0], p[2], p[3]]]).collect();
    let error = 3e-4;
    let (whole, half) = (compute(&polygons, error, true), compute(&halves, error, true));
    let n = polygons.len();
    let difference = |p: usize, q: usize| {
        // Halves have equal areas. Their errors add up to at most twice the error of one.
        let sum: f64 =
            [2 * p, 2 * p + 1].map(|i| 0.5 * (half.get(i, 2 * q) + half.get(i, 2 * q + 1))).iter().sum();
        whole.get(p, q) - sum
    };
    let rms = (0..n * n).map(|k| difference(k / n, k % n).powi(2)).sum::<f64>().sqrt() / n as f64;
    // The mean of two rows, each a sum of two columns, has an error as large as that of one entry.
    assert!(rms < error * 2f64.sqrt(), "differ by {rms:.2e}");
}

/// Walls that are not cut meet at edges, where the kernel is unbounded, and a box blocks parts of each from the others.
/// The z-scores of row sums have a mean square of 1 if the reported standard errors are right, with a standard
/// deviation of about sqrt(2 / 18), since rows share pairs.
#[test]
fn errors_between_neighbours_are_as_large_as_reported() {
    let mut polygons = sides(DVec3::splat(0.5), DVec3::splat(0.5), 0.0, -1.0, 1);
    polygons.extend(sides(dvec3(0.45, 0.52, 0.45), dvec3(0.15, 0.17, 0.2), 0.0, 1.0, 1));
    let (mut sum, seeds) = (0.0, 6);
    for seed in 0..seeds {
        let options = ViewFactorOptions::default().with_error(1e-4).with_enclosed(false).with_seed(seed);
        let found = view_factors(&polygons, &options, &Progress::new()).unwrap();
        assert!(found.error <= options.error, "{} is more than {}", found.error, options.error);
        for i in 0..6 {
            let variance: f64 = (0..polygons.len()).map(|j| found.standard_error(i, j).powi(2)).sum();
            sum += (found.row_sums[i] - 1.0).powi(2) / variance;
        }
        let squares = |i: usize| found.entries(i).filter(|e| e.1 > 0.0).map(|e| e.2 * e.2).sum::<f64>();
        let rms = ((0..12).map(squares).sum::<f64>() / found.non_zeros() as f64).sqrt();
        assert!((rms / found.error - 1.0).abs() < 1e-5, "{rms} and {}", found.error);
        let (i, j, largest) = found.largest_standard_error().unwrap();
        assert!(largest == found.standard_error(i, j) && largest > found.error);
    }
    let mean = sum / (6 * seeds) as f64;
    assert!(mean > 0.2 && mean < 2.0, "mean square of z-scores {mean}");
}

/// A box that nothing blocks, a thousandth as large as the room: its rows sum to one although rays cross the whole
/// room.
#[test]
fn a_small_box_in_a_large_room_is_seen_whole() {
    let mut polygons = sides(DVec3::splat(50.0), DVec3::splat(50.0), 0.0, -1.0, 1);
    polygons.extend(sides(dvec3(31.0, 47.0, 22.0), DVec3::splat(0.05), 0.3, 1.0, 1));
    let error = 1e-4;
    let found = compute(&polygons, error, false);
    for i in 6..12 {
        // Unblocked view factors may have a relative error of a tenth of the wanted error times the number of surfaces.
        let off = found.row_sums[i] - 1.0;
        assert!(off.abs() < 2.0 * 0.1 * error * 12.0, "row {i} is off one by {off:.1e}");
    }
}

/// A room with a missing side is an error that names the surface and its row sum.
#[test]
fn a_room_that_is_none_is_an_error() {
    let mut polygons = sides(DVec3::ZERO, DVec3::splat(0.5), 0.0, -1.0, 1);
    polygons.remove(3);
    let options = ViewFactorOptions::default();
    let error = view_factors(&polygons, &options, &Progress::new()).unwrap_err();
    assert!(matches!(error, Error::NotEnclosed { sum, .. } if (sum - 0.8).abs() < 1e-3), "{error}");
    // Behind the wall opposite the opening nothing is visible.
    polygons.push(vec![dvec3(0.0, -2.0, 0.0), dvec3(1.0, -2.0, 0.0), dvec3(1.0, -1.0, 0.0)]);
    let error = view_factors(&polygons, &options, &Progress::new()).unwrap_err();
    assert!(matches!(error, Error::NotEnclosed { surface: 5, sum: 0.0 }), "{error}");
}

/// Surfaces of several polygons have the area-weighted sums of the view factors of their parts, within the errors of
/// both.
#[test]
fn surfaces_of_several_polygons_see_each_other_and_themselves() {
    let polygons = room_with_block();
    let error = 3e-4;
    let whole = compute(&polygons, error, true);
    // The six sides of the room, of four polygons each, and the block.
    let mut surfaces: Vec<&[Vec<DVec3>]> = polygons[..24].chunks(4).collect();
    surfaces.push(&polygons[24..]);
    let options = ViewFactorOptions::default().with_error(error).with_seed(5);
    let found = view_factors_of_surfaces(&surfaces, &options, &Progress::new()).unwrap();
    let of = |i: usize| if i == 6 { 24..30 } else { 4 * i..4 * i + 4 };
    let mut squares = 0.0;
    for i in 0..7 {
        let row: f64 = found.row(i).map(|(_, f)| f).sum();
        assert!((row - 1.0).abs() < 1e-12, "row {i} sums to {row}");
        let area: f64 = of(i).map(|p| whole.areas()[p]).sum();
        assert!((found.areas()[i] - area).abs() < 1e-12);
        for j in 0..7 {
            let exchange = |p: usize| whole.areas()[p] * of(j).map(|q| whole.get(p, q)).sum::<f64>();
            squares += (found.get(i, j) - of(i).map(exchange).sum::<f64>() / area).powi(2);
        }
    }
    // The error of these, and of sums over sixteen parts: the variances are averaged over four rows and summed over
    // four columns.
    let rms = squares.sqrt() / 7.0;
    assert!(rms < error * 2f64.sqrt(), "differ by {rms:.2e}");
}

/// View factors have the same bits for any number of threads.
#[test]
fn the_number_of_threads_does_not_matter() {
    let polygons = room_with_block();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let found = pool.install(|| compute(&polygons, 1e-3, true));
        let rows = (0..polygons.len()).flat_map(|i| found.row(i).collect::<Vec<_>>());
        (found.rays, found.error.to_bits(), rows.map(|(j, f)| (j, f.to_bits())).collect::<Vec<_>>())
    };
    let one = run(1);
    assert!(one == run(2) && one == run(5), "different bytes");
}

/// What polygons do not exchange escapes: from no polygon, from one, and from four of very different sizes.
#[test]
fn few_polygons_lose_what_they_do_not_exchange() {
    assert!(compute(&[], 1e-3, false).is_empty());
    let alone = compute(&[square(2.0, 0.0, true)], 1e-3, false);
    assert_eq!((alone.non_zeros(), alone.escaped(0)), (0, 1.0));
    // One of them is a triangle of a size and at a distance of ten thousand others.
    let far = vec![dvec3(-1e4, -1e4, 1e4), dvec3(0.0, 1e4, 1e4), dvec3(1e4, -1e4, 1e4)];
    let polygons = [square(1.0, 0.0, true), square(0.5, 0.25, true), square(0.5, 0.25, false), far];
    let form_factors = compute(&polygons, 1e-3, false);
    // The plane of the triangle is 10⁴ away: for the small square it looks like from a point.
    let up = exact_from_a_point(&polygons[3]);
    assert!((form_factors.get(1, 3) - up).abs() < 1e-4, "{} not {up}", form_factors.get(1, 3));
    assert!(form_factors.get(0, 2) > 0.0 && form_factors.get(2, 3) == 0.0);
}

/// The form factor from the origin, facing up, to a polygon.
fn exact_from_a_point(polygon: &[DVec3]) -> f64 {
    radiosity::form_factor::exact::point_to_polygon(DVec3::ZERO, DVec3::Z, polygon)
}

/// Polygons that are not planar are refused.
#[test]
#[should_panic(expected = "not planar")]
fn bent_quadrilaterals_are_refused() {
    let mut odd = square(1.0, 0.0, true);
    odd[2].z += 0.1;
    compute(&[odd], 1e-3, false);
}

/// A regular polygon of `n` corners around the z axis.
fn disk(n: u32, radius: f64, height: f64, up: bool) -> Vec<DVec3> {
    let corner = |k: u32| {
        let angle = std::f64::consts::TAU * f64::from(k) / f64::from(n) * if up { 1.0 } else { -1.0 };
        dvec3(radius * angle.cos(), radius * angle.sin(), height)
    };
    (0..n).map(corner).collect()
}

/// A sphere of many facets over a disk. Only the bodies themselves hide anything, so no ray is cast, and the sum over
/// all facets is as exact as the formula. The form factor of the sphere to the disk is its share of the solid angle,
/// F = 0.5 (1 - 1 / sqrt(1 + (r / h)²)). That of the polyhedron differs by the square of the size of its facets.
#[test]
fn sums_over_facets_have_no_bias() {
    let (n, m) = (24u32, 12u32);
    let mut sphere = Vec::new();
    let at = |i: u32, j: u32| {
        let (theta, phi) = (
            std::f64::consts::PI * f64::from(i) / f64::from(m),
            std::f64::consts::TAU * f64::from(j % n) / f64::from(n),
        );
        dvec3(0.3 * theta.sin() * phi.cos(), 0.3 * theta.sin() * phi.sin(), 1.5 + 0.3 * theta.cos())
    };
    for i in 0..m {
        for j in 0..n {
            let quad = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            match i {
                0 => sphere.push(vec![quad[0], quad[1], quad[2]]),
                _ if i == m - 1 => sphere.push(vec![quad[0], quad[1], quad[3]]),
                _ => sphere.push(quad.to_vec()),
            }
        }
    }
    let surfaces = [sphere, vec![disk(96, 1.0, 0.0, true)]];
    for seed in 0..3 {
        let options = ViewFactorOptions::default().with_error(1e-2).with_enclosed(false).with_seed(seed);
        let found = view_factors_of_surfaces(&surfaces, &options, &Progress::new()).unwrap();
        assert_eq!(found.rays, 0);
        let exact = 0.5 * (1.0 - 1.0 / (1.0 + (1.0 / 1.5f64).powi(2)).sqrt());
        // Facets of 15 degrees, a disk of 96 corners.
        assert!((found.get(0, 1) / exact - 1.0).abs() < 0.02, "{} not {exact}", found.get(0, 1));
        assert!(found.standard_error(0, 1) < 2e-5 * exact);
        assert_eq!(found.get(0, 0), 0.0);
    }
}

/// Nearly all of the floor is behind the wall. The rest is seen fully, for every seed.
#[test]
fn what_is_mostly_behind_is_seen_for_every_seed() {
    let wall = vec![dvec3(0.0, 0.0, 0.0), dvec3(0.0, 1.0, 0.0), dvec3(0.0, 1.0, 1.0), dvec3(0.0, 0.0, 1.0)];
    let floor =
        vec![dvec3(-19.0, 0.0, 0.0), dvec3(1.0, 0.0, 0.0), dvec3(1.0, 1.0, 0.0), dvec3(-19.0, 1.0, 0.0)];
    let exact = perpendicular_rectangles(1.0, 1.0, 1.0);
    for seed in 0..5 {
        let options = ViewFactorOptions::default().with_error(0.1).with_enclosed(false).with_seed(seed);
        let found = view_factors(&[wall.clone(), floor.clone()], &options, &Progress::new()).unwrap();
        assert!((found.get(0, 1) - exact).abs() < 1e-6 && found.rays == 0, "{}", found.get(0, 1));
    }
}

/// A box on the floor of a room: its bottom sees only the floor below it, rows sum to one without other changes, and
/// the floor sees the bottom by reciprocity. A gap of 10⁻⁶ gives the same view factors, up to five standard errors and
/// the light through the gap.
#[test]
fn a_box_on_the_floor_sees_what_it_stands_on() {
    let room = sides(dvec3(2.0, 1.5, 1.0), dvec3(2.0, 1.5, 1.0), 0.0, -1.0, 1);
    let half = dvec3(0.4, 0.3, 0.25);
    let block = |lift: f64| sides(dvec3(1.1, 1.3, half.z + lift), half, 0.4, 1.0, 1);
    let found = |lift: f64| {
        let surfaces: Vec<Vec<Vec<DVec3>>> =
            room.iter().chain(&block(lift)).map(|p| vec![p.clone()]).collect();
        let options = ViewFactorOptions::default().with_error(2e-4).with_enclosed(true).with_seed(1);
        view_factors_of_surfaces(&surfaces, &options, &Progress::new()).unwrap()
    };
    let (touching, gap) = (found(0.0), found(1e-6));
    // Sides: floor 4, ceiling 5; of the box its bottom is 10.
    assert!((touching.get(10, 4) - 1.0).abs() < 1e-12, "{}", touching.get(10, 4));
    assert_eq!(touching.row(10).count(), 1);
    assert!((touching.get(4, 10) - 4.0 * half.x * half.y / 12.0).abs() < 1e-12);
    for i in 0..12 {
        let sum: f64 = touching.row(i).map(|(_, f)| f).sum();
        assert!((sum - 1.0).abs() < 1e-12, "row {i}: {sum}");
        for j in 0..12 {
            let (a, b) = (touching.get(i, j), gap.get(i, j));
            let sigma = touching.standard_error(i, j).hypot(gap.standard_error(i, j));
            assert!((a - b).abs() < 5.0 * sigma + 2e-5, "{i} {j}: {a} and {b} ± {sigma}");
        }
    }
}

/// A box in the corner of a room: its back sees only the wall, its bottom only the floor. Gaps of 10⁻⁶ give the same
/// view factors, up to five standard errors and the light through the gaps.
#[test]
fn a_box_in_a_corner_sees_what_it_leans_on() {
    let room = sides(dvec3(2.0, 1.5, 1.0), dvec3(2.0, 1.5, 1.0), 0.0, -1.0, 1);
    let half = dvec3(0.4, 0.3, 0.25);
    let found = |gap: f64| {
        let block = sides(dvec3(half.x + gap, 1.3, half.z + gap), half, 0.0, 1.0, 1);
        compute(&[room.clone(), block].concat(), 3e-4, true)
    };
    let (touching, gap) = (found(0.0), found(1e-6));
    // Walls: left 0, floor 4; of the box its left side is 6 and its bottom 10.
    for (side, wall) in [(6, 0), (10, 4)] {
        assert!((touching.get(side, wall) - 1.0).abs() < 1e-12, "{}", touching.get(side, wall));
        assert_eq!(touching.row(side).count(), 1);
    }
    for (i, j) in (0..144).map(|k| (k / 12, k % 12)) {
        let (a, b) = (touching.get(i, j), gap.get(i, j));
        let sigma = touching.standard_error(i, j).hypot(gap.standard_error(i, j));
        assert!((a - b).abs() < 5.0 * sigma + 2e-5, "{i} {j}: {a} and {b} ± {sigma}");
    }
}

/// Plates a millionth of their size apart see nothing but each other, to what the gap lets out. The gap is open: they
/// do not touch.
#[test]
fn plates_a_millionth_apart_are_apart() {
    for turn in [DQuat::IDENTITY, DQuat::from_rotation_x(0.7) * DQuat::from_rotation_z(0.4)] {
        let turned = |p: Vec<DVec3>| p.into_iter().map(|v| turn * v).collect::<Vec<_>>();
        let found = compute(&[turned(square(1.0, 0.0, true)), turned(square(1.0, 1e-6, false))], 1e-3, false);
        let exact = opposed_rectangles(1.0, 1.0, 1e-6);
        assert!((found.get(0, 1) / exact - 1.0).abs() < 2e-5, "{}, not {exact}", found.get(0, 1));
        assert_eq!(found.rays, 0);
    }
}

/// A box on the joint of two tiles, and a panel with two sides that leans on the floor: in a closed room all rows close, however the
/// faces touch, and the bottom of the box sees both tiles by the areas that it covers.
#[test]
fn contact_of_any_kind_leaves_rows_closed() {
    let room = sides(dvec3(2.0, 1.5, 1.0), dvec3(2.0, 1.5, 1.0), 0.0, -1.0, 1);
    let joint = 1.2;
    let tiles = [
        rectangle(DVec3::ZERO, DVec3::X * joint, DVec3::Y * 3.0),
        rectangle(DVec3::X * joint, DVec3::X * (4.0 - joint), DVec3::Y * 3.0),
    ];
    let half = dvec3(0.4, 0.3, 0.25);
    let leaning = [dvec3(2.5, 0.5, 0.0), dvec3(0.0, 2.0, 0.0), dvec3(0.985, 0.0, 0.174)];
    let panel =
        [rectangle(leaning[0], leaning[1], leaning[2]), rectangle(leaning[0], leaning[2], leaning[1])];
    let walls = room.iter().enumerate().filter(|(k, _)| *k != 4).map(|(_, wall)| wall.clone());
    let mut polygons: Vec<Vec<DVec3>> = tiles.into_iter().chain(walls).chain(panel).collect();
    let bottom = polygons.len() + 4;
    polygons.extend(sides(dvec3(1.1, 1.3, half.z), half, 0.0, 1.0, 1));
    let seen = look(&polygons.iter().map(|p| vec![p.clone()]).collect::<Vec<_>>(), &[], DVec3::Z);
    assert_eq!(Enclosure::of(&seen), Enclosure::Closed);
    let found = compute(&polygons, 1e-3, true);
    // It reaches from 0.7 to 1.5.
    for (tile, share) in [(0, (joint - 0.7) / 0.8), (1, (1.5 - joint) / 0.8)] {
        // Clipping is exact to some 10⁻¹¹ of coordinates.
        assert!((found.get(bottom, tile) - share).abs() < 1e-9, "{tile}: {}", found.get(bottom, tile));
    }
    assert_eq!(found.row(bottom).count(), 2);
    for i in 0..polygons.len() {
        let sum: f64 = found.row(i).map(|(_, f)| f).sum();
        assert!((sum - 1.0).abs() < 1e-12, "row {i}: {sum}");
    }
}

/// A box on the floor of a room, turned and printed with six digits: rounding sinks some corners of the box into the floor and lifts
/// others by up to 10⁻⁶ of the scene. It still touches the floor, and its bottom sees nothing else.
#[test]
fn a_box_of_rounded_corners_touches_the_floor() {
    let size = 4000.0;
    let printed = |x: f64| format!("{x:.5e}").parse::<f64>().unwrap();
    let room = sides(dvec3(2.0, 1.5, 1.0), dvec3(2.0, 1.5, 1.0), 0.0, -1.0, 1);
    let block = sides(dvec3(1.1, 1.3, 0.4), dvec3(0.4, 0.5, 0.4), 0.4, 1.0, 1);
    for k in 0..8 {
        let turn = DQuat::from_rotation_z(0.3 + f64::from(k)) * DQuat::from_rotation_x(1.1 - f64::from(k));
        let rounded = |p: &DVec3| DVec3::from((turn * *p * size / 4.0).to_array().map(printed));
        // As triangles, because rounded quadrilaterals are not plane.
        let triangles = |polygon: &Vec<DVec3>| {
            let [a, b, c, d] = [0, 1, 2, 3].map(|corner| rounded(&polygon[corner]));
            vec![vec![a, b, c], vec![a, c, d]]
        };
        let surfaces: Vec<Vec<Vec<DVec3>>> = room.iter().chain(&block).map(triangles).collect();
        let options = ViewFactorOptions::default().with_error(1e-3).with_enclosed(false);
        let found = view_factors_of_surfaces(&surfaces, &options, &Progress::new()).unwrap();
        // Sides: floor 4; of the box its bottom is 10.
        assert!((found.get(10, 4) - 1.0).abs() < 1e-3, "{k}: {}", found.get(10, 4));
    }
}

/// A window in the plane of a wall is in front of it. The wall has its area less, and shares its view factors with the
/// window.
#[test]
fn of_faces_in_one_plane_the_smaller_is_in_front() {
    let ground = rectangle(DVec3::ZERO, DVec3::X * 3.0, DVec3::Y * 5.0);
    let wall = rectangle(DVec3::ZERO, DVec3::Y * 5.0, DVec3::Z * 2.0);
    let window = rectangle(dvec3(0.0, 1.0, 0.5), DVec3::Y * 2.0, DVec3::Z);
    let both = compute(&[ground.clone(), wall.clone(), window.clone()], 1e-3, false);
    let (plain, alone) =
        (compute(&[ground.clone(), wall], 1e-3, false), compute(&[ground, window], 1e-3, false));
    assert_eq!(both.rays, 0);
    assert!((both.areas()[1] - 8.0).abs() < 1e-12 && (both.hidden[1] - 2.0).abs() < 1e-12);
    assert!((both.get(0, 2) - alone.get(0, 1)).abs() < 1e-6);
    assert!((both.get(0, 1) - (plain.get(0, 1) - alone.get(0, 1))).abs() < 1e-6);
    assert!((both.escaped(0) - plain.escaped(0)).abs() < 1e-6);
}

/// Plates 2 cm apart under a dome of 20 km, 10⁻⁶ of the scene. The gap lets out the light that opposed squares do not
/// exchange.
#[test]
fn sizes_do_not_matter_to_each_other() {
    let (r, gap) = (2e4, 0.02);
    let mut polygons = vec![square(1.0, 0.0, true), square(1.0, gap, false)];
    let dome = sides(dvec3(0.0, 0.0, 0.0), DVec3::splat(r), 0.0, -1.0, 1);
    let options = ViewFactorOptions::default().with_error(1e-3).with_enclosed(false);
    let mut surfaces = vec![vec![polygons.remove(0)], vec![polygons.remove(0)]];
    surfaces.push(dome);
    let found = view_factors_of_surfaces(&surfaces, &options, &Progress::new()).unwrap();
    let exact = opposed_rectangles(1.0, 1.0, gap);
    assert!((found.get(0, 1) - exact).abs() < 2e-5 * exact, "{} not {exact}", found.get(0, 1));
    let (sky, error) = (found.get(0, 2), found.standard_error(0, 2));
    assert!(
        (sky - (1.0 - exact)).abs() < 4.5 * error && error < 2e-3,
        "{sky} ± {error}, not {}",
        1.0 - exact
    );
}

/// 95 % intervals contain a reference with a tenth of the error. A panel of 100 m that touches the ground hides a part
/// of it from a wall behind it: near singularities, and sampled shares of all sizes. At least 92 % is required, or
/// three standard deviations of a binomial count below 95 % if that is less.
#[test]
fn intervals_hold() {
    let along = DVec3::Y * 100.0;
    let strip = |k: u32| rectangle(dvec3(-10.0 + 5.0 * f64::from(k), 0.0, 0.0), DVec3::X * 5.0, along);
    let mut polygons = vec![
        rectangle(DVec3::ZERO, dvec3(1.8, 0.0, 1.0), along),
        rectangle(dvec3(-3.0, 0.0, 0.0), along, DVec3::Z * 1.5),
        rectangle(dvec3(4.0, 40.0, 0.0), DVec3::Z * 3.0, DVec3::Y * 3.0),
    ];
    polygons.extend((0..4).map(strip));
    let run = |error: f64, seed: u64| {
        let options = ViewFactorOptions::default().with_error(error).with_enclosed(false).with_seed(seed);
        view_factors(&polygons, &options, &Progress::new()).unwrap()
    };
    let reference = run(1e-4, 99);
    let (mut inside, mut all) = (0.0, 0.0_f64);
    for seed in 0..25 {
        let found = run(1e-3, seed);
        assert!(found.error <= 1e-3);
        for i in 0..polygons.len() {
            for (j, f, sure) in reference.entries(i).filter(|e| e.1 > 1e-4) {
                let error = found.standard_error(i, j);
                // Each pair once, and without unblocked pairs, which are not sampled.
                if i < j && error > 2e-5 * f {
                    all += 1.0;
                    inside += f64::from(u8::from((found.get(i, j) - f).abs() < 1.96 * error.hypot(sure)));
                }
            }
        }
    }
    let slack = 3.0 * (0.95 * 0.05 / all).sqrt();
    let share: f64 = inside / all;
    assert!(all >= 100.0 && share > 0.95 - slack.max(0.03), "{share} of {all}");
}

/// A nearly endless street between walls as high as it is wide: the ground sees the sky by sqrt(2) - 1, the walls by
/// (1 + 1 - sqrt(2)) / 2 (crossed strings; H. C. Hottel). The tolerance is 4.5 standard errors and the loss at the
/// ends.
#[test]
fn a_street_sees_the_sky() {
    let along = DVec3::Y * 2000.0;
    let ground = rectangle(dvec3(-0.5, -1000.0, 0.0), DVec3::X, along);
    let left = rectangle(dvec3(-0.5, -1000.0, 0.0), along, DVec3::Z);
    let right = rectangle(dvec3(0.5, -1000.0, 0.0), DVec3::Z, along);
    let options = ViewFactorOptions::default().with_error(1e-3).with_enclosed(false).with_up(DVec3::Z);
    let found = view_factors(&[ground, left, right], &options, &Progress::new()).unwrap();
    for (i, exact) in [(0, 2f64.sqrt() - 1.0), (1, 1.0 - 0.5 * 2f64.sqrt()), (2, 1.0 - 0.5 * 2f64.sqrt())] {
        let sky = found.lost[i].up;
        // The ends of the street let out about one over its length more.
        assert!((sky.value - exact).abs() < 4.5 * sky.error + 1e-3, "{i}: {sky:?}, not {exact}");
        assert!(sky.error < 2e-3 && found.lost[i].backs.value == 0.0);
    }
}

/// A crater, a spherical cap below the ground. The form factor from any element of a sphere to a part of it is the
/// part's share of the sphere's area. So every point of the crater sees the sky by 1 - h / (2 R), where h is the depth.
/// A hollow of facets, open at one plane, sees the sky on average by the area of the opening over its own area, which
/// is exact.
#[test]
fn a_crater_sees_the_sky() {
    let (radius, rim, n, m) = (2.0, 60f64.to_radians(), 24u32, 8u32);
    let at = |i: u32, j: u32| {
        let (theta, phi) =
            (rim * f64::from(i) / f64::from(m), std::f64::consts::TAU * f64::from(j % n) / f64::from(n));
        radius * dvec3(theta.sin() * phi.cos(), theta.sin() * phi.sin(), -theta.cos())
    };
    let mut facets = Vec::new();
    for (i, j) in (0..n * m).map(|k| (k / n, k % n)) {
        let quad = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
        match i {
            0 => facets.push(vec![quad[0], quad[1], quad[2]]),
            _ => facets.push(quad.to_vec()),
        }
    }
    let options = ViewFactorOptions::default().with_error(1e-3).with_enclosed(false).with_up(DVec3::Z);
    let found = view_factors(&facets, &options, &Progress::new()).unwrap();
    // Nothing blocks: the facets see each other across the hollow.
    assert_eq!(found.rays, 0);
    let opening =
        0.5 * f64::from(n) * (radius * rim.sin()).powi(2) * (std::f64::consts::TAU / f64::from(n)).sin();
    let area: f64 = found.areas().iter().sum();
    let sky: f64 = (0..found.len()).map(|i| found.areas()[i] * found.lost[i].up.value).sum();
    assert!((sky / opening - 1.0).abs() < 2e-5, "{sky} not {opening}");
    let exact = 1.0 - (1.0 - rim.cos()) / 2.0;
    // Facets of 7.5 by 15 degrees differ from the sphere by the square of half of these angles.
    assert!((opening / area / exact - 1.0).abs() < 3e-3);
    for i in 0..found.len() {
        let up = found.lost[i].up;
        assert!((up.value - exact).abs() < 3e-3, "facet {i} sees {}, not {exact}", up.value);
    }
}

/// An obstacle between two squares blocks like a pair of surfaces there but has no row. The light that reaches it
/// escapes.
#[test]
fn obstacles_block_and_have_no_row() {
    let surfaces = [vec![square(1.0, 0.0, true)], vec![square(1.0, 1.0, false)]];
    let options = ViewFactorOptions::default().with_error(1e-3).with_enclosed(false).with_up(DVec3::Z);
    let found = view_factors_among(&surfaces, &[square(0.6, 0.5, true)], &options, &Progress::new()).unwrap();
    let (exact, error) = (opposed_squares_with_blocker(1.0, 1.0, 0.6), found.standard_error(0, 1));
    assert_eq!(found.len(), 2);
    assert!((found.get(0, 1) - exact).abs() < 4.5 * error && error < 2e-3, "{} ± {error}", found.get(0, 1));
    let to_obstacle = opposed_squares(1.0, 0.6, 0.5);
    let backs = found.lost[0].backs;
    assert!((backs.value - to_obstacle).abs() < 4.5 * backs.error, "{backs:?}, not {to_obstacle}");
    let seen = look(&surfaces, &[square(0.6, 0.5, true)], DVec3::Z);
    assert!(seen.iter().all(|sight| sight.backs > 0));
}

/// The view factor from a square to a smaller one above its middle, with nothing between them.
fn opposed_squares(large: f64, small: f64, height: f64) -> f64 {
    let polygons = [square(large, 0.0, true), square(small, height, false)];
    compute(&polygons, 1e-3, false).get(0, 1)
}

/// Pairs that matter little get two rays each, but their sums have no bias: plates of 256 facets each, with a grid of
/// bars between them, exchange as much as two whole plates, within four standard errors.
#[test]
fn sums_of_pairs_with_two_rays_are_unbiased() {
    const HEIGHT: f64 = 6.0;
    let bar =
        |k: u32| rectangle(dvec3(-0.5 + 0.2 * f64::from(k), -0.5, 0.5 * HEIGHT), DVec3::X * 0.1, DVec3::Y);
    let bars: Vec<Vec<DVec3>> = (0..5).map(bar).collect();
    let plate = |height: f64, up: bool, n: u32| -> Vec<Vec<DVec3>> {
        let side = 1.0 / f64::from(n);
        let cell = |k: u32| {
            let corner = dvec3(f64::from(k % n) * side - 0.5, f64::from(k / n) * side - 0.5, height);
            let (a, b) = (DVec3::X * side, DVec3::Y * side);
            if up { rectangle(corner, a, b) } else { rectangle(corner, b, a) }
        };
        (0..n * n).map(cell).collect()
    };
    let run = |n: u32, error: f64| {
        let polygons: Vec<_> = [plate(0.0, true, n), plate(HEIGHT, false, n)].concat();
        let surfaces: Vec<_> = polygons.into_iter().map(|p| vec![p]).collect();
        let options = ViewFactorOptions::default().with_error(error).with_enclosed(false).with_seed(7);
        let found = view_factors_among(&surfaces, &bars, &options, &Progress::new()).unwrap();
        let half = found.len() / 2;
        let (mut sum, mut variance) = (0.0, 0.0);
        for i in 0..half {
            let area = found.areas()[i];
            for (_, f, error) in found.entries(i) {
                sum += area * f;
                variance += (area * error).powi(2);
            }
        }
        (sum, variance.sqrt(), found.rays)
    };
    let (whole, error, _) = run(1, 2e-5);
    // A facet has a view factor to a facet of the other plate of at most 1 / (256 π 6²) = 3.5e-5.
    let (parts, sigma, rays) = run(16, 1e-3);
    assert!(rays < 2 * 256 * 256, "{rays} rays");
    assert!((whole - parts).abs() < 4.0 * error.hypot(sigma), "{whole} ± {error}, {parts} ± {sigma}");
    assert!(whole > 2e-3 && sigma < 0.01 * whole, "{whole} {sigma}");
}
