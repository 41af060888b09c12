//! Light does not leak where surfaces touch: sealed rooms on a large ground stay dark.

use crate::common::*;
use glam::{DQuat, DVec3, dvec3};
use radiosity::{
    Progress, Scene,
    accuracy::solved::Solved,
    form_factor::CastOptions,
    lightmap::{Atlas, BakeOptions, Coordinates, Layout, bake},
    monte_carlo::{Effort, Receiver},
    output::final_gather::FinalGather,
    patch::Subdivision,
    scene::Material,
    solve::SolveOptions,
    trace::Tracer,
};

const GROUND: u32 = 0;
const WALL: u32 = 1;
const LAMP: u32 = 2;

/// A box without its lower face: walls from height `from`, and a lid. Its faces look outward, or inward with `inward`.
fn hood(low: [f64; 2], high: [f64; 2], from: f64, to: f64, inward: bool) -> Vec<(Corners, u32)> {
    let [p, q, r, s] = [[low[0], low[1]], [low[0], high[1]], [high[0], high[1]], [high[0], low[1]]];
    let at = |p: [f64; 2], y: f64| dvec3(p[0], y, p[1]);
    let mut all: Vec<Corners> = Vec::new();
    for (a, b) in [(p, q), (q, r), (r, s), (s, p)] {
        all.extend([[at(a, from), at(b, from), at(b, to)], [at(a, from), at(b, to), at(a, to)]]);
    }
    all.extend([[at(p, to), at(q, to), at(r, to)], [at(p, to), at(r, to), at(s, to)]]);
    let turned = if inward { flipped(all) } else { all };
    turned.into_iter().map(|t| (t, WALL)).collect()
}

struct Room {
    /// Half of the side of the ground.
    half: f64,
    /// Thickness of the walls; zero for single faces.
    thickness: f64,
    /// Height above the ground at which the walls begin.
    from: f64,
    /// Whether the scene is rotated and rounded to the six digits of a file.
    rounded: bool,
}

impl Room {
    /// The scene, with a lamp above the ground beside the room.
    fn scene(&self) -> Scene {
        let mut scene = self.uncut();
        scene.cut_overlaps();
        scene.cut_contacts();
        scene
    }

    /// The scene without cuts.
    fn uncut(&self) -> Scene {
        let h = self.half;
        let at = |x: f64, z: f64| dvec3(x + 0.3, 0.0, z - 0.2);
        let ground = [[at(-h, -h), at(-h, h), at(h, h)], [at(-h, -h), at(h, h), at(h, -h)]];
        let mut all: Vec<(Corners, u32)> = ground.into_iter().map(|t| (t, GROUND)).collect();
        all.extend(hood([-2.0, -1.5], [2.0, 1.5], self.from, 2.5, false));
        if self.thickness > 0.0 {
            let (x, z) = (2.0 - self.thickness, 1.5 - self.thickness);
            all.extend(hood([-x, -z], [x, z], self.from, 2.5 - self.thickness, true));
        }
        let lamp = |x: f64, z: f64| dvec3(x, 30.0, z);
        let corners = [lamp(2.0, -10.0), lamp(22.0, -10.0), lamp(22.0, 10.0), lamp(2.0, 10.0)];
        all.extend([
            ([corners[0], corners[1], corners[2]], LAMP),
            ([corners[0], corners[2], corners[3]], LAMP),
        ]);
        let turn = DQuat::from_axis_angle(dvec3(0.3, -0.5, 0.8).normalize(), 1.1);
        let place = |p: DVec3| match self.rounded {
            true => (turn * p).to_array().map(|x| format!("{x:.5e}").parse::<f64>().unwrap()).into(),
            false => p,
        };
        let placed: Vec<_> = all.into_iter().map(|(t, m)| (t.map(place), m)).collect();
        let material = |name, rho, emission| Material::new(name, [rho; 3], [emission; 3]);
        let materials =
            vec![material("ground", 0.3, 0.0), material("wall", 0.7, 0.0), material("lamp", 0.0, 50.0)];
        Scene::new(&placed, materials)
    }

    /// The point before the rotation of the scene.
    fn back(&self, p: DVec3) -> DVec3 {
        let turn = DQuat::from_axis_angle(dvec3(0.3, -0.5, 0.8).normalize(), 1.1);
        if self.rounded { turn.inverse() * p } else { p }
    }
}

/// Sealed rooms of thick and thin walls in the middle of a large ground. One has a gap of a micrometre, which lets in
/// no light that counts. Two poke through the ground. Two are rotated, so that contact is exact only up to rounding.
/// The ground inside is black up to rays that rounding leads astray: the bound is a thousandth of the light outside.
#[test]
fn sealed_rooms_on_a_large_ground_are_dark_inside() {
    let cases = [
        Room { half: 200.0, thickness: 0.2, from: 0.0, rounded: false },
        Room { half: 1000.0, thickness: 0.2, from: 0.0, rounded: false },
        Room { half: 200.0, thickness: 0.0, from: 0.0, rounded: false },
        Room { half: 200.0, thickness: 0.2, from: 1e-6, rounded: false },
        Room { half: 200.0, thickness: 0.2, from: -0.03, rounded: false },
        Room { half: 20.0, thickness: 0.0, from: -0.03, rounded: true },
        Room { half: 20.0, thickness: 0.2, from: 0.0, rounded: true },
    ];
    for case in cases {
        let (scene, progress) = (case.scene(), Progress::new());
        let tracer = Tracer::new(&scene);
        let cast = CastOptions::default().with_rays(64.0);
        let cut = Subdivision::Count(2000);
        let Solved { patches, solution, .. } =
            Solved::new(&scene, &tracer, &cut, &cast, &SolveOptions::default(), &progress).unwrap();
        let inner =
            |p: DVec3| p.x.abs() < 2.0 - case.thickness && p.z.abs() < 1.5 - case.thickness && p.y < 2.4;
        let (mut inside, mut outside): (f64, f64) = (0.0, 0.0);
        for i in 0..patches.len() {
            let (p, e) = (case.back(patches.centroid(&scene, i)), solution.irradiance[i]);
            let of_ground = scene.triangles[patches.triangle(i)].material == GROUND && patches.is_front(i);
            if of_ground && inner(p) {
                inside = inside.max(e);
            } else if of_ground && p.length() < 10.0 {
                outside = outside.max(e);
            }
        }
        let what = format!("ground of {}, walls of {} from {}", 2.0 * case.half, case.thickness, case.from);
        assert!(outside > 1.0 && inside < 1e-3 * outside, "{what}: {inside} inside, {outside} outside");
        if case.thickness > 0.0 {
            continue;
        }
        // The map is as dark, up to the walls, although a dark room of faces that look outward is like a solid.
        let atlas = Atlas::new(&scene, &tracer, Layout::Resolution(256), Coordinates::Auto).unwrap();
        let options = BakeOptions::default().with_final_gather(4);
        let map = bake(&scene, &tracer, (&patches, &solution), atlas, &options, &progress).unwrap();
        for (t, triangle) in scene.triangles.iter().enumerate() {
            for at in [[0.98, 0.01, 0.01], [0.01, 0.98, 0.01], [0.01, 0.01, 0.98]] {
                let corners = scene.corners(t);
                let p = case.back((0..3).map(|k| corners[k] * at[k]).sum());
                if triangle.material == GROUND && inner(p) {
                    let found = map.at(t, at).unwrap_or_default()[0];
                    assert!(found < 1e-3 * outside, "{what}: the map has {found} at {p}");
                }
            }
        }
    }
}

/// A black block stands on a black ground and against a wall that emits. The mean irradiance of the ground is the form
/// factor of the whole ground to the wall with the block in between: 0.1552 by an independent integral, with a
/// tolerance of 0.001 for the sampling error. The ground under the block gets nothing: no light from the wall behind
/// the block leaks into it.
#[test]
fn a_block_against_a_wall_keeps_the_light_out() {
    let mut parts: Vec<(Corners, u32)> = Vec::new();
    let wall = rectangle(DVec3::ZERO, 10.0 * DVec3::Y, 10.0 * DVec3::Z);
    let ground = rectangle(DVec3::ZERO, 10.0 * DVec3::X, 10.0 * DVec3::Y);
    let block = flipped(room(dvec3(0.0, 4.0, 0.0), dvec3(2.0, 6.0, 2.0)));
    parts.extend(wall.into_iter().map(|t| (t, LAMP)));
    parts.extend(ground.into_iter().map(|t| (t, GROUND)));
    parts.extend(block.into_iter().map(|t| (t, WALL)));
    let material = |name, emission| Material::new(name, [0.0; 3], [emission; 3]);
    let materials =
        vec![material("ground", 0.0), material("block", 0.0), material("wall", 1.0 / std::f64::consts::PI)];
    let mut scene = Scene::new(&parts, materials);
    scene.cut_overlaps();
    scene.cut_contacts();
    assert!((scene.hidden[0].area - 4.0).abs() < 1e-9, "{:?}", scene.hidden);
    let (cast, progress) = (CastOptions::default().with_rays(256.0), Progress::new());
    let Solved { patches, solution, .. } = Solved::new(
        &scene,
        &Tracer::new(&scene),
        &Subdivision::Count(3000),
        &cast,
        &SolveOptions::default(),
        &progress,
    )
    .unwrap();
    let (mut flux, mut under): (f64, f64) = (0.0, 0.0);
    for i in (0..patches.len()).filter(|&i| patches.is_front(i)) {
        if scene.triangles[patches.triangle(i)].material == GROUND {
            let p = patches.centroid(&scene, i);
            flux += patches.area(i) * solution.irradiance[i];
            if p.x < 2.0 && (p.y - 5.0).abs() < 1.0 {
                under = under.max(solution.irradiance[i]);
            }
        }
    }
    assert!((flux / 100.0 - 0.1552).abs() < 0.001, "{}", flux / 100.0);
    assert_eq!(under, 0.0);
}

/// The final gather asks the lamps at the hits of its rays. Patches of the ground reach under the walls of a sealed room,
/// because the ground is not cut here, and their irradiance is that of outside and inside together. Only the ground
/// reflects, so that all light on it is direct. A point on a wall inside sees the dark ground: exactly zero. A point
/// outside sees the lit one.
#[test]
fn the_final_gather_reads_no_direct_light_through_a_wall() {
    let mut scene = Room { half: 20.0, thickness: 0.0, from: 0.0, rounded: false }.uncut();
    assert_eq!(scene.set_material("wall", [0.0; 3], [0.0; 3]), 1);
    let (tracer, progress) = (Tracer::new(&scene), Progress::new());
    let (cast, options) = (CastOptions::default().with_rays(64.0), SolveOptions::default());
    let solved = Solved::new(&scene, &tracer, &Subdivision::Count(500), &cast, &options, &progress).unwrap();
    let gather = FinalGather::new(&scene, &tracer, &solved.patches, &solved.solution, 1);
    let place = |x: f64, nx: f64| Receiver::free(&tracer, dvec3(x, 0.5, 0.3), dvec3(nx, 0.0, 0.0));
    let places = [place(1.99, -1.0), place(-1.99, 1.0), place(2.01, 1.0)];
    let effort = Effort::default().with_samples(4096);
    let found = gather.irradiances(&places, &effort, &progress).unwrap();
    assert_eq!([found[0].mean, found[1].mean], [[0.0; 3]; 2]);
    assert!(found[2].mean[0] > 1.0, "{:?}", found[2]);
}
