//! View factors between polygons against closed forms, and against hemisphere rays, which share no estimator with them.

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
    view_factor::{ViewFactorOptions, ViewFactors, view_factors, view_factors_of_surfaces},
};

/// The six sides of a box, cut into n × n each; outwards with side 1, inwards with side -1.
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
    let h = side / 2.0;
    let mut corners =
        vec![dvec3(-h, -h, height), dvec3(h, -h, height), dvec3(h, h, height), dvec3(-h, h, height)];
    if !up {
        corners.reverse();
    }
    corners
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

#[test]
fn a_cube_is_exact_without_chance() {
    let cube = sides(DVec3::ZERO, DVec3::splat(0.5), 0.0, -1.0, 1);
    let form_factors = compute(&cube, 1e-2, true).form_factors;
    for i in 0..6 {
        for j in (0..6).filter(|&j| j != i) {
            let exact = if i / 2 == j / 2 {
                opposed_rectangles(1.0, 1.0, 1.0)
            } else {
                perpendicular_rectangles(1.0, 1.0, 1.0)
            };
            // Stored in single precision; rows that did not sum to one would move by as much as closed forms are off.
            assert!(
                (form_factors.get(i, j) - exact).abs() < 1e-6,
                "{i} {j}: {} not {exact}",
                form_factors.get(i, j)
            );
        }
    }
}

#[test]
fn a_blocker_hides_what_the_closed_form_says() {
    let error = 1e-3;
    let polygons =
        [square(1.0, 0.0, true), square(1.0, 1.0, false), square(0.6, 0.5, true), square(0.6, 0.5, false)];
    let form_factors = compute(&polygons, error, false).form_factors;
    let exact = opposed_squares_with_blocker(1.0, 1.0, 0.6);
    // All of the error, Σ σ² = (n error)², is this pair's, in both directions: 4.5 σ.
    let sigma = 4.0 * error / 2f64.sqrt();
    let found = form_factors.get(0, 1);
    assert!((found - exact).abs() < 4.5 * sigma, "{found}, not {exact}");
    for i in 0..4 {
        let sum: f64 = form_factors.row(i).map(|(_, f)| f).sum();
        assert!((sum + form_factors.escaped()[i] - 1.0).abs() < 1e-12);
    }
}

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
    // Independent rays would have variances of F / rays, here of 2 rays patches a polygon; stratified ones have less, and so
    // have those of both ends together.
    let bound = (error * error + 1.0 / n as f64 / (2.0 * rays)).sqrt();
    for (unit, place) in [(1.0, DVec3::ZERO), (1e-3, dvec3(1e3, -5e2, 2e2))] {
        let moved: Vec<Vec<DVec3>> =
            polygons.iter().map(|p| p.iter().map(|&v| v * unit + place).collect()).collect();
        let ViewFactors { form_factors, error: told, .. } = compute(&moved, error, true);
        assert!(told <= error, "{told} is more than {error}");
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

#[test]
fn triangles_and_parallelograms_agree() {
    let polygons = room_with_block();
    let halves: Vec<Vec<DVec3>> =
        polygons.iter().flat_map(|p| [vec![p[0], p[1], p[2]], vec![p[0], p[2], p[3]]]).collect();
    let error = 3e-4;
    let (whole, half) =
        (compute(&polygons, error, true).form_factors, compute(&halves, error, true).form_factors);
    let n = polygons.len();
    let difference = |p: usize, q: usize| {
        // Halves have equal areas. Their errors add up to at most twice those of one.
        let sum: f64 =
            [2 * p, 2 * p + 1].map(|i| 0.5 * (half.get(i, 2 * q) + half.get(i, 2 * q + 1))).iter().sum();
        whole.get(p, q) - sum
    };
    let rms = (0..n * n).map(|k| difference(k / n, k % n).powi(2)).sum::<f64>().sqrt() / n as f64;
    // The mean of two rows, of the sum of two columns each: as large an error as that of one entry.
    assert!(rms < error * 2f64.sqrt(), "differ by {rms:.2e}");
}

/// Walls that are not cut meet at edges, where the kernel has no bound; a box hides parts of each from the others. Were the
/// errors of rows as large as told, their z-scores had a mean square of 1, here with a standard deviation of about
/// sqrt(2 / 18), since rows share pairs. Stratified samples do better.
#[test]
fn errors_between_neighbours_are_no_larger_than_told() {
    let mut polygons = sides(DVec3::splat(0.5), DVec3::splat(0.5), 0.0, -1.0, 1);
    polygons.extend(sides(dvec3(0.45, 0.52, 0.45), dvec3(0.15, 0.17, 0.2), 0.0, 1.0, 1));
    let (mut sum, seeds) = (0.0, 6);
    for seed in 0..seeds {
        let options = ViewFactorOptions::default().with_error(1e-4).with_enclosed(true).with_seed(seed);
        let found = view_factors(&polygons, &options, &Progress::new()).unwrap();
        assert!(found.error <= options.error, "{} is more than {}", found.error, options.error);
        for i in 0..6 {
            let variance: f64 = (0..polygons.len()).map(|j| found.standard_error(i, j).powi(2)).sum();
            sum += (found.row_sums[i] - 1.0).powi(2) / variance;
        }
        let squares = |i: usize| (0..12).map(|j| found.standard_error(i, j).powi(2)).sum::<f64>();
        let rms = ((0..12).map(squares).sum::<f64>()).sqrt() / 12.0;
        assert!((rms / found.error - 1.0).abs() < 1e-5, "{rms} and {}", found.error);
        let (i, j, largest) = found.largest_standard_error().unwrap();
        assert!(largest == found.standard_error(i, j) && largest > found.error);
    }
    let mean = sum / (6 * seeds) as f64;
    assert!(mean < 1.5, "mean square of z-scores {mean}");
}

/// Rays cross a room a thousand times as large as the box they go to, which nothing hides.
#[test]
fn what_is_small_beside_the_room_is_seen_whole() {
    let mut polygons = sides(DVec3::splat(50.0), DVec3::splat(50.0), 0.0, -1.0, 1);
    polygons.extend(sides(dvec3(31.0, 47.0, 22.0), DVec3::splat(0.05), 0.3, 1.0, 1));
    let error = 1e-4;
    let found = compute(&polygons, error, false);
    for i in 6..12 {
        // What is unoccluded may be off by a tenth of the error times the surfaces, relatively.
        let off = found.row_sums[i] - 1.0;
        assert!(off.abs() < 2.0 * 0.1 * error * 12.0, "row {i} is off one by {off:.1e}");
    }
}

#[test]
fn a_room_that_is_none_is_an_error() {
    let mut polygons = sides(DVec3::ZERO, DVec3::splat(0.5), 0.0, -1.0, 1);
    polygons.remove(3);
    let options = ViewFactorOptions::default();
    let error = view_factors(&polygons, &options, &Progress::new()).unwrap_err();
    assert!(matches!(error, Error::NotEnclosed { sum, .. } if (sum - 0.8).abs() < 1e-3), "{error}");
    // Behind the wall across from the opening there is nothing to see.
    polygons.push(vec![dvec3(0.0, -2.0, 0.0), dvec3(1.0, -2.0, 0.0), dvec3(1.0, -1.0, 0.0)]);
    let error = view_factors(&polygons, &options, &Progress::new()).unwrap_err();
    assert!(matches!(error, Error::NotEnclosed { surface: 5, sum: 0.0 }), "{error}");
}

#[test]
fn surfaces_of_several_polygons_see_each_other_and_themselves() {
    let polygons = room_with_block();
    let error = 3e-4;
    let whole = compute(&polygons, error, true).form_factors;
    // The six sides of the room, of four each, and the block.
    let mut surfaces: Vec<&[Vec<DVec3>]> = polygons[..24].chunks(4).collect();
    surfaces.push(&polygons[24..]);
    let options = ViewFactorOptions::default().with_error(error).with_enclosed(true).with_seed(5);
    let found = view_factors_of_surfaces(&surfaces, &options, &Progress::new()).unwrap();
    let of = |i: usize| if i == 6 { 24..30 } else { 4 * i..4 * i + 4 };
    let mut squares = 0.0;
    for i in 0..7 {
        let row: f64 = found.form_factors.row(i).map(|(_, f)| f).sum();
        assert!((row - 1.0).abs() < 1e-12, "row {i} sums to {row}");
        let area: f64 = of(i).map(|p| whole.areas()[p]).sum();
        assert!((found.form_factors.areas()[i] - area).abs() < 1e-12);
        for j in 0..7 {
            let exchange = |p: usize| whole.areas()[p] * of(j).map(|q| whole.get(p, q)).sum::<f64>();
            squares += (found.form_factors.get(i, j) - of(i).map(exchange).sum::<f64>() / area).powi(2);
        }
    }
    // That of these and that of the parts, of which sixteen make one: their variances are averaged over four and summed over
    // four.
    let rms = squares.sqrt() / 7.0;
    assert!(rms < error * 2f64.sqrt(), "differ by {rms:.2e}");
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let polygons = room_with_block();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let found = pool.install(|| compute(&polygons, 1e-3, true));
        let rows = (0..polygons.len()).flat_map(|i| found.form_factors.row(i).collect::<Vec<_>>());
        (found.rays, found.error.to_bits(), rows.map(|(j, f)| (j, f.to_bits())).collect::<Vec<_>>())
    };
    let one = run(1);
    assert!(one == run(2) && one == run(5), "different bytes");
}

#[test]
fn few_polygons_lose_what_they_do_not_exchange() {
    assert!(compute(&[], 1e-3, false).form_factors.is_empty());
    let alone = compute(&[square(2.0, 0.0, true)], 1e-3, false).form_factors;
    assert_eq!((alone.non_zeros(), alone.escaped()), (0, &[1.0][..]));
    // Of very different sizes, one of them a triangle that is out of sight of the room's coordinates.
    let far = vec![dvec3(-1e4, -1e4, 1e4), dvec3(0.0, 1e4, 1e4), dvec3(1e4, -1e4, 1e4)];
    let polygons = [square(1.0, 0.0, true), square(0.5, 0.25, true), square(0.5, 0.25, false), far];
    let form_factors = compute(&polygons, 1e-3, false).form_factors;
    // The triangle's plane is 10⁴ away: from there all but the small square is a point that sees the same.
    let up = exact_from_a_point(&polygons[3]);
    assert!((form_factors.get(1, 3) - up).abs() < 1e-4, "{} not {up}", form_factors.get(1, 3));
    assert!(form_factors.get(0, 2) > 0.0 && form_factors.get(2, 3) == 0.0);
}

/// From the origin, facing up.
fn exact_from_a_point(polygon: &[DVec3]) -> f64 {
    radiosity::form_factor::exact::point_to_polygon(DVec3::ZERO, DVec3::Z, polygon)
}

#[test]
#[should_panic(expected = "no parallelogram")]
fn other_quadrilaterals_are_refused() {
    let mut odd = square(1.0, 0.0, true);
    odd[2] *= 1.1;
    compute(&[odd], 1e-3, false);
}
