//! Subdivisions whose patches differ in size: restricted quadtrees, their meshes, and solutions on them.

use std::collections::{HashMap, HashSet};

use crate::common::*;
use glam::{DVec3, dvec3};
use proptest::{prelude::*, test_runner::RngSeed};
use radiosity::{
    Progress, Scene,
    accuracy::{adaptive::finer, discretisation::Discretisation, solved::Solved},
    form_factor::{CastOptions, Estimator, FormFactors},
    output::{
        vertex_colors::at_vertices,
        vertices::{CREASE, PatchMesh},
    },
    patch::{Patches, Subdivision},
    solve::{SolveOptions, solve},
    trace::{Tracer, sampling::square_to_triangle},
};

/// Refines a tenth of the patches, chosen at random, in each of the rounds.
fn refined_by_chance(scene: &Scene, edge: f64, rounds: usize, seed: u64) -> Patches {
    let mut random = Random::new(seed);
    let mut patches = Patches::subdivide(scene, &Subdivision::Edge(edge));
    for _ in 0..rounds {
        let marked: Vec<bool> = (0..patches.len()).map(|_| random.next() < 0.1).collect();
        patches = patches.refined(scene, &marked);
    }
    patches
}

/// A closed box with sides of 1, 2 and 4: whole triangles differ by two levels, and all coordinates are exact.
fn long_box() -> Scene {
    scene(&[part(room(DVec3::ZERO, dvec3(1.0, 2.0, 4.0)), 0.5, 1.0)])
}

fn corners_of(scene: &Scene, patches: &Patches, i: usize) -> Corners {
    let t = scene.corners(patches.triangle(i));
    patches.barycentric_corners(i).map(|b| t[0] * b[0] + t[1] * b[1] + t[2] * b[2])
}

fn place(p: DVec3) -> [u64; 3] {
    (p + 0.0).to_array().map(f64::to_bits)
}

fn centre(corners: [[f64; 3]; 3]) -> [f32; 3] {
    std::array::from_fn(|k| (corners.iter().map(|c| c[k]).sum::<f64>() / 3.0) as f32)
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 60,
        failure_persistence: None,
        rng_seed: RngSeed::Fixed(1),
        ..ProptestConfig::default()
    })]

    /// Patches tile their triangles: areas add up, windings are kept, and a lookup on either side finds the right
    /// patch.
    #[test]
    fn patches_tile_every_triangle(seed in any::<u64>(), rounds in 1usize..6, x in 0f32..1.0, y in 0f32..1.0) {
        let scene = long_box();
        let mut patches = refined_by_chance(&scene, 3.0, rounds, seed);
        let fronts = patches.fronts();
        patches.add_backs(&scene, &[7, 2]);
        let mut areas = vec![0.0; scene.triangles.len()];
        for i in 0..patches.len() {
            let corners = corners_of(&scene, &patches, i);
            // All coordinates are sums of few dyadic numbers, so only the area and its ratio round.
            prop_assert!((area(&[corners]) / patches.area(i) - 1.0).abs() < 1e-14);
            let turn = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
            prop_assert!(turn.dot(scene.normal(patches.triangle(i))) > 0.0);
            let (t, front) = (patches.triangle(i) as u32, patches.is_front(i));
            prop_assert_eq!(patches.at(t, centre(patches.barycentric_corners(i)), front), Some(i as u32));
            if front {
                areas[t as usize] += patches.area(i);
                let back = patches.back_of(i);
                prop_assert_eq!(back.is_some(), t == 7 || t == 2);
                prop_assert!(back.is_none_or(|b| patches.barycentric_corners(b as usize) == patches.barycentric_corners(i)));
            }
        }
        prop_assert!(areas.iter().enumerate().all(|(t, a)| (a / scene.area(t) - 1.0).abs() < 1e-14));
        let point = square_to_triangle(x, y);
        let found = patches.at(3, point, true).unwrap() as usize;
        prop_assert!(found < fronts && patches.triangle(found) == 3);
        // Inside up to rounding: coordinates sum to 1 up to rounding, which each level doubles.
        let corners = patches.barycentric_corners(found);
        for (a, b) in [(0, 1), (1, 2), (2, 0)] {
            let from = |k: usize| [0, 1].map(|axis| corners[k][axis] - f64::from(point[axis]));
            let ([ux, uy], [vx, vy]) = (from(a), from(b));
            prop_assert!(ux * vy - vx * uy >= -1e-6);
        }
    }

    /// Restricted quadtrees: a corner of another patch divides at most one edge of a patch, and only in its middle.
    /// This holds within triangles and across the edges that they share.
    #[test]
    fn neighbours_differ_by_one_level_on_one_edge(seed in any::<u64>(), rounds in 1usize..6) {
        let scene = long_box();
        let patches = refined_by_chance(&scene, 3.0, rounds, seed);
        let corners: Vec<Corners> = (0..patches.len()).map(|i| corners_of(&scene, &patches, i)).collect();
        let places: HashSet<[u64; 3]> = corners.iter().flatten().map(|&p| place(p)).collect();
        for c in &corners {
            let is_cut = |k: usize, share: f64| places.contains(&place(c[k].lerp(c[(k + 1) % 3], share)));
            prop_assert!((0..3).all(|k| !is_cut(k, 0.25) && !is_cut(k, 0.75)));
            prop_assert!((0..3).filter(|&k| is_cut(k, 0.5)).count() <= 1);
        }
    }

    /// The parts of another subdivision that a patch overlaps cover it exactly. Families of neighbours are whole
    /// ancestors, and together they are all patches in order.
    #[test]
    fn overlaps_and_families_are_whole(seed in any::<u64>(), rounds in 1usize..5, levels in 0u8..3) {
        let scene = long_box();
        let patches = refined_by_chance(&scene, 3.0, rounds, seed);
        for other in [refined_by_chance(&scene, 3.0, 2, !seed), Patches::subdivide(&scene, &Subdivision::Edge(0.7))] {
            let mut covered = vec![0.0; other.len()];
            for i in 0..patches.len() {
                let (overlapped, share) = patches.overlap(&other, i);
                let there: f64 = overlapped.clone().map(|j| share * other.area(j)).sum();
                prop_assert!((there / patches.area(i) - 1.0).abs() < 1e-14);
                overlapped.for_each(|j| covered[j] += share);
            }
            prop_assert!(covered.iter().all(|&share| share == 1.0));
        }
        let mut next = 0;
        for family in patches.families(levels) {
            prop_assert_eq!(family.start, next);
            next = family.end;
            let cells: Vec<_> = family.map(|i| patches.cell(i)).collect();
            let smallest = cells.iter().map(|c| c.level).max().unwrap();
            // A family fills an ancestor of its first patch, and no patch of it is deeper than `levels` below that.
            let share: f64 = cells.iter().map(|c| 0.25f64.powi(c.level.into())).sum();
            let up = -share.log2() / 2.0;
            prop_assert!(up == up.round() && smallest <= up as u8 + levels);
            let ancestor = |c: &radiosity::patch::Cell| (c.triangle, c.child >> (2 * (c.level - up as u8)));
            prop_assert!(cells.iter().all(|c| ancestor(c) == ancestor(&cells[0])));
        }
        prop_assert_eq!(next, patches.len());
    }

    /// Every edge of a closed box belongs to two faces: by position, and by vertex if the creases are welded.
    /// Vertices inside an edge have interpolated colours.
    #[test]
    fn meshes_are_closed_and_colours_continuous(seed in any::<u64>(), rounds in 1usize..5) {
        let scene = long_box();
        let mut patches = refined_by_chance(&scene, 3.0, rounds, seed);
        for crease in [CREASE, 91.0] {
            let mesh = PatchMesh::new(&scene, &patches, crease);
            let mut uses: HashMap<_, usize> = HashMap::new();
            let mut drawn = vec![0.0; patches.len()];
            for f in 0..mesh.faces() {
                let (i, share) = mesh.patch(f);
                drawn[i] += share;
                let face = mesh.face(f).map(|v| mesh.positions()[v as usize]);
                let turn = 0.5 * (face[1] - face[0]).cross(face[2] - face[0]);
                prop_assert!((turn.dot(scene.normal(patches.triangle(i))) / (share * patches.area(i)) - 1.0).abs() < 1e-14);
                for k in 0..3 {
                    *uses.entry((place(face[k]), place(face[(k + 1) % 3]))).or_default() += 1;
                }
            }
            prop_assert!(drawn.iter().all(|&share| share == 1.0));
            prop_assert!(uses.iter().all(|(&(a, b), &n)| n == 1 && uses.get(&(b, a)) == Some(&1)));
            prop_assert_eq!(mesh.hanging().len(), mesh.faces() - patches.len());
            let places: HashSet<_> = mesh.positions().iter().map(|&p| place(p)).collect();
            // Euler: V - E + F = 2 for a sphere.
            prop_assert_eq!(places.len() + mesh.faces(), uses.len() / 2 + 2);
            if crease > 90.0 {
                prop_assert_eq!(places.len(), mesh.positions().len());
            }
            let values: Vec<f64> = (0..patches.len()).map(|i| (i as f64).sin()).collect();
            let values = at_vertices(&scene, &patches, &mesh, &values);
            for hanging in mesh.hanging() {
                let [a, b] = hanging.ends.map(|v| values[v as usize]);
                prop_assert!((values[hanging.vertex as usize] - 0.5 * (a + b)).abs() < 1e-15);
                let [a, b] = hanging.ends.map(|v| mesh.positions()[v as usize]);
                prop_assert_eq!(mesh.positions()[hanging.vertex as usize], 0.5 * (a + b));
            }
        }
        // Backs are surfaces of their own and closed like the fronts.
        patches.add_backs(&scene, &(0..12).collect::<Vec<u32>>());
        let mesh = PatchMesh::new(&scene, &patches, 91.0);
        let mut uses: HashMap<_, usize> = HashMap::new();
        for face in (0..mesh.faces()).map(|f| mesh.face(f)) {
            (0..3).for_each(|k| *uses.entry((face[k], face[(k + 1) % 3])).or_default() += 1);
        }
        prop_assert!(uses.iter().all(|(&(a, b), &n)| n == 1 && uses.get(&(b, a)) == Some(&1)));
    }
}

fn cast_on(scene: Scene, mut patches: Patches, rays: f64, estimator: Estimator) -> Cast {
    let tracer = Tracer::new(&scene);
    let options = CastOptions::default().with_rays(rays).with_estimator(estimator);
    let form_factors = FormFactors::cast(&scene, &tracer, &mut patches, &options, &Progress::new()).unwrap();
    Cast { scene, tracer, patches, form_factors }
}

/// Be = 1 - ρ gives B = 1 everywhere in a closed scene, whatever its patches, because rows sum to one.
#[test]
fn furnace_on_patches_of_all_sizes() {
    let faces = room_faces(DVec3::ZERO, dvec3(1.0, 2.0, 4.0));
    let of_face = |(k, face): (usize, Vec<Corners>)| {
        let rho = 0.15 * (k + 1) as f64;
        part(face, rho, 1.0 - rho)
    };
    let scene = scene(&faces.into_iter().enumerate().map(of_face).collect::<Vec<_>>());
    let patches = refined_by_chance(&scene, 3.0, 4, 5);
    let cast = cast_on(scene, patches, 64.0, Estimator::Pooled);
    let options = SolveOptions::default().with_tolerance(1e-12);
    let solution = solve(&cast.form_factors, &cast.patches, &options, &Progress::new()).unwrap();
    let worst = solution.radiosity.iter().map(|b| (b - 1.0).abs()).fold(0.0, f64::max);
    // The largest reflectance is 0.9, so the error is at most ten times the tolerance of the solver.
    assert!(worst < 1e-11, "{worst:e}");
    let (closure, reciprocity) = deviations(&cast.form_factors);
    assert!(closure < 1e-12 && reciprocity < 1e-12, "{closure:e} {reciprocity:e}");
}

/// Unit squares a unit apart, and at a right angle with a common edge (Howell C-11 and C-14), within the error bars
/// of the rays.
#[test]
fn form_factors_between_patches_of_all_sizes() {
    let low = rectangle(DVec3::ZERO, DVec3::X, DVec3::Y);
    let opposite = rectangle(DVec3::Z, DVec3::Y, DVec3::X);
    let upright = rectangle(DVec3::ZERO, DVec3::Y, DVec3::Z);
    for (other, wanted) in [(opposite, 0.199824895698), (upright, 0.200043776075)] {
        for estimator in BOTH {
            let scene = scene(&[black(low.clone()), black(other.clone())]);
            let patches = refined_by_chance(&scene, 0.8, 4, 3);
            assert!(!patches.is_uniform(0) && !patches.is_uniform(3));
            let cast = cast_on(scene, patches, 256.0, estimator);
            for (from, to) in [(0, 1), (1, 0)] {
                cast.form_factor(from, to).assert_is(wanted, 0.0);
            }
        }
    }
}

fn solved(scene: &Scene, tracer: &Tracer, patches: Patches, rays: f64, linear: bool) -> Solved {
    let cast = CastOptions::default().with_rays(rays);
    let options = SolveOptions::default().with_linear(linear);
    Solved::of_patches(scene, tracer, patches, &cast, &options, &Progress::new()).unwrap()
}

fn discretisation(scene: (&Scene, &Tracer), solved: &Solved) -> f64 {
    let Solved { patches, form_factors, solution, .. } = solved;
    let found = Discretisation::of(scene, form_factors, patches, solution, &Progress::new());
    found.unwrap().unwrap().relative
}

/// Like on uniform patches, the error falls with the square of the edge if light is smooth: half the edge leaves a
/// quarter of the error. The order is nearer to two than to one or three.
#[test]
fn discretisation_falls_with_the_square_of_the_edge() {
    let low = rectangle(DVec3::ZERO, DVec3::X, DVec3::Y);
    let high = rectangle(DVec3::Z, DVec3::Y, DVec3::X);
    let scene = scene(&[part(low, 0.5, 0.0), part(high, 0.5, 1.0)]);
    let tracer = Tracer::new(&scene);
    let [coarse, fine] = [0.8, 0.4].map(|edge| {
        let uniform = Patches::subdivide(&scene, &Subdivision::Edge(edge));
        let near = |i: usize| corners_of(&scene, &uniform, i).iter().all(|p| p.x <= 0.5);
        let patches = uniform.refined(&scene, &(0..uniform.len()).map(near).collect::<Vec<bool>>());
        assert!(!patches.is_uniform(0));
        discretisation((&scene, &tracer), &solved(&scene, &tracer, patches, 4096.0, false))
    });
    println!("{coarse:e} {fine:e}");
    let order = (coarse / fine).log2();
    assert!((1.5..2.5).contains(&order), "{order}");
}

/// In a Cornell box with blocks, patches that are small where light varies have a smaller error than the same number
/// of patches of one size. The same seed gives the same patches and the same light for any number of threads.
#[test]
fn patches_where_light_varies_pay() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let scene = load("cornell-box");
            let tracer = Tracer::new(&scene);
            let mut patches = Patches::subdivide(&scene, &Subdivision::Count(500));
            for _ in 0..2 {
                let Solved { patches: solved, solution, .. } = solved(&scene, &tracer, patches, 64.0, true);
                patches = finer(&scene, &solved, &solution, 2.0);
            }
            let solved = solved(&scene, &tracer, patches, 64.0, true);
            let change = discretisation((&scene, &tracer), &solved);
            (scene, tracer, solved, change)
        })
    };
    let (scene, tracer, adapted, change) = run(7);
    let (_, _, one, _) = run(1);
    let cells = |s: &Solved| (0..s.patches.len()).map(|i| s.patches.cell(i)).collect::<Vec<_>>();
    let bits = |s: &Solved| s.solution.irradiance.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    assert!(cells(&adapted) == cells(&one) && bits(&adapted) == bits(&one), "threads matter");

    let count = adapted.patches.fronts();
    let uniform = Patches::subdivide(&scene, &Subdivision::Count(2 * count));
    assert!(uniform.len() > count * 3 / 2);
    // With the same number of uniform patches the error is larger in proportion to their edge.
    let more = (uniform.len() as f64 / count as f64).sqrt();
    let uniform = more * discretisation((&scene, &tracer), &solved(&scene, &tracer, uniform, 64.0, true));
    println!("{count}: {change:.5}, uniform: {uniform:.5}");
    assert!(change < uniform, "{change} {uniform}");
}
