//! Lightmaps against the energy of the solver, against path tracing at random points of the surface, and against
//! themselves across seams.

use std::sync::LazyLock;

use crate::common::{Corners, Random, flipped, icosphere, part, rectangle, room, room_faces};
use glam::{DVec3, dvec3};
use radiosity::{
    Progress, Scene,
    form_factor::{CastOptions, FormFactors},
    lightmap::{
        Atlas, AtlasOptions, BakeOptions, Coordinates, Layout, Lightmap, NONE, Texel, bake, lit_on_both_sides,
    },
    monte_carlo::{Effort, PathOptions, PathTracer, Receiver},
    patch::{Patches, Subdivision},
    scene::Material,
    solve::{Solution, SolveOptions, solve},
    trace::{Tracer, sampling::square_to_triangle},
};

struct Solved {
    scene: Scene,
    tracer: Tracer,
    patches: Patches,
    solution: Solution,
}

fn solved(scene: Scene, patches: usize, rays: f64) -> Solved {
    let tracer = Tracer::new(&scene);
    let mut patches = Patches::subdivide(&scene, &Subdivision::Count(patches));
    let options = CastOptions::default().with_rays(rays);
    let form_factors = FormFactors::cast(&scene, &tracer, &mut patches, &options, &Progress::new()).unwrap();
    let solution = solve(&form_factors, &patches, &SolveOptions::default(), &Progress::new()).unwrap();
    Solved { scene, tracer, patches, solution }
}

impl Solved {
    fn atlas(&self, layout: Layout) -> Atlas {
        Atlas::new(&self.scene, &self.tracer, layout, Coordinates::Auto).unwrap()
    }

    fn bake(&self, layout: Layout, options: &BakeOptions) -> Lightmap {
        let solution = (&self.patches, &self.solution);
        let atlas = self.atlas(layout);
        bake(&self.scene, &self.tracer, solution, atlas, options, &Progress::new()).unwrap()
    }

    /// Compares the map, sampled bilinearly, with path tracing at random points of the surface.
    fn against_paths(&self, map: &Lightmap, points: usize, paths: u32) -> Comparison {
        let mut random = Random::new(7);
        let areas: Vec<f64> = (0..self.scene.triangles.len()).map(|t| self.scene.area(t)).collect();
        let total: f64 = areas.iter().sum();
        let places: Vec<(usize, [f64; 3])> = (0..points)
            .map(|_| {
                let mut left = random.next() * total;
                let t = areas.iter().position(|a| {
                    left -= a;
                    left < 0.0
                });
                let at = square_to_triangle(random.next() as f32, random.next() as f32);
                (t.unwrap_or(areas.len() - 1), at.map(f64::from))
            })
            .collect();
        self.at_places(map, &places, paths)
    }

    /// Compares at given points: a triangle and barycentric coordinates each.
    fn at_places(&self, map: &Lightmap, places: &[(usize, [f64; 3])], paths: u32) -> Comparison {
        let receivers: Vec<Receiver> = places
            .iter()
            .map(|&(t, at)| Receiver::on_triangle(&self.tracer, t, at, map.is_of_front(t)))
            .collect();
        let tracer = PathTracer::new(&self.scene, &self.tracer, PathOptions::default());
        let effort = Effort::default().with_samples(paths);
        let truth = tracer.irradiances(&receivers, &effort, &Progress::new()).unwrap();
        let mut sums = Comparison::default();
        for (&(t, at), truth) in places.iter().zip(&truth) {
            let found = map.at(t, at).unwrap()[0];
            let (e, se) = (truth.mean[0], truth.standard_error[0]);
            // No light arrives inside solids. The map has values of neighbours there.
            if e > 0.0 {
                sums.add(found - e, se, e);
            }
        }
        sums
    }
}

#[derive(Default, Debug)]
struct Comparison {
    n: f64,
    squares: f64,
    noise: f64,
    difference: f64,
    mean: f64,
}

impl Comparison {
    fn add(&mut self, difference: f64, standard_error: f64, mean: f64) {
        self.n += 1.0;
        self.squares += difference.powi(2);
        self.noise += standard_error.powi(2);
        self.difference += difference;
        self.mean += mean;
    }

    /// Root mean square difference without the noise of the paths, relative to the mean irradiance.
    fn rms(&self) -> f64 {
        ((self.squares - self.noise).max(0.0) / self.n).sqrt() / (self.mean / self.n)
    }

    /// Mean difference and its standard error, both relative to the mean irradiance.
    fn bias(&self) -> (f64, f64) {
        (self.difference / self.mean, self.squares.sqrt() / self.mean)
    }
}

const RED: [f64; 3] = [0.6, 0.1, 0.1];

/// A room of 2 x 2 x 2 with a lamp in its ceiling, and something in it.
fn furnished(things: Vec<Corners>) -> Scene {
    let mut faces = room_faces(DVec3::splat(-1.0), DVec3::ONE);
    let (x, y) = (DVec3::X, DVec3::Y);
    let strip = |from: DVec3, u: DVec3, v: DVec3| rectangle(from + DVec3::Z, v, u);
    faces[5] = [
        strip(-x - y, 2.0 * x, 0.6 * y),
        strip(-x + 0.4 * y, 2.0 * x, 0.6 * y),
        strip(-x - 0.4 * y, 0.6 * x, 0.8 * y),
        strip(0.4 * x - 0.4 * y, 0.6 * x, 0.8 * y),
    ]
    .concat();
    let mut parts: Vec<crate::common::Part> = faces.into_iter().map(|face| part(face, 0.7, 0.0)).collect();
    parts[0].reflectance = RED;
    parts.push(part(strip(-0.4 * x - 0.4 * y, 0.8 * x, 0.8 * y), 0.0, 10.0));
    if !things.is_empty() {
        parts.push(part(things, 0.6, 0.0));
    }
    crate::common::scene(&parts)
}

/// A torus around the vertical axis through `centre`. Fronts face outward.
fn torus(centre: DVec3, (large, small): (f64, f64), (n, m): (usize, usize)) -> Vec<Corners> {
    let at = |i: usize, j: usize| {
        let [u, v] =
            [(i % n) as f64 / n as f64, (j % m) as f64 / m as f64].map(|x| x * std::f64::consts::TAU);
        let r = large + small * v.cos();
        centre + dvec3(r * u.cos(), r * u.sin(), small * v.sin())
    };
    let quad = |i: usize, j: usize| {
        let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
        [[a, b, c], [a, c, d]]
    };
    (0..n).flat_map(|i| (0..m).flat_map(move |j| quad(i, j))).collect()
}

/// A map with all steps and the default number of rays.
fn finished(s: &Solved, side: usize) -> Lightmap {
    s.bake(Layout::Resolution(side), &BakeOptions::default())
}

/// Asserts that the map agrees with path tracing at random points. The RMS difference is below `rms`: texels lose what
/// is finer than they are, such as shadow edges, and texels of half the size lose a third less. The bias is at most
/// four standard errors of the comparison, plus half a percent for the size of patches and texels.
#[track_caller]
fn assert_shows_the_light(s: &Solved, side: usize, rms: f64) {
    let map = finished(s, side);
    let found = s.against_paths(&map, 300, 512);
    assert!(found.rms() < rms, "RMS {:.4}, {rms} is allowed", found.rms());
    let (bias, error) = found.bias();
    assert!(bias.abs() < 4.0 * error + 0.005, "bias {bias:.4} with standard error {error:.4}");
    assert_seams_are_closed(&map);
}

/// Asserts that the difference across seams is smaller than the error of the map.
#[track_caller]
fn assert_seams_are_closed(map: &Lightmap) {
    let (samples, [before, after]) = map.seams();
    assert!(samples > 50);
    let (mut area, mut flux) = (0.0, 0.0);
    for i in 0..map.coverage().len() {
        area += map.open_area(i);
        flux += map.open_area(i) * f64::from(map.irradiance()[map.coverage().texels()[i] as usize][0]);
    }
    let noise = map.relative_error() * flux / area;
    assert!(after[0] < noise && after[0] < 0.2 * before[0], "{before:?} {after:?}, noise {noise}");
}

/// Agrees with path tracing. The bound of 1.5 % leaves room over a measured RMS difference of 0.7 %.
#[test]
fn a_box_is_lit_as_paths_light_it() {
    assert_shows_the_light(&solved(furnished(vec![]), 2000, 256.0), 160, 0.015);
}

/// Agrees with path tracing. The bound of 3.5 % leaves room over measured RMS differences of 2.1 % and 2.0 %.
#[test]
fn curved_meshes_are_lit_as_paths_light_them() {
    let torus = torus(dvec3(0.1, 0.0, -0.3), (0.5, 0.2), (48, 24));
    assert_shows_the_light(&solved(furnished(torus), 4000, 128.0), 160, 0.035);
    assert_shows_the_light(&solved(furnished(icosphere(0.5, 3)), 4000, 128.0), 160, 0.035);
}

/// Agrees with path tracing. The bound of 4.5 % leaves room over a measured RMS difference of 2.5 %.
#[test]
fn an_occluded_room_is_lit_as_paths_light_it() {
    assert_shows_the_light(&solved(crate::common::load("door-ajar"), 4000, 256.0), 160, 0.045);
}

/// Apart from noise the error comes from the size of texels. The share of texels on shadow edges is proportional to
/// that size, and the error of such a texel stays the same. So the error falls at least with the square root of the
/// size: to half here.
#[test]
fn more_texels_show_the_light_better() {
    let s = solved(crate::common::load("cornell-box"), 4000, 128.0);
    let [coarse, fine] = [32, 128].map(|side| s.against_paths(&finished(&s, side), 300, 512).rms());
    assert!(fine < 0.5 * coarse, "{fine} with 128 texels, {coarse} with 32");
}

/// A plain map has exactly the flux of the solver, up to single precision, and its texels cover the surface.
#[test]
fn the_map_holds_the_flux_of_the_solver() {
    let plain = BakeOptions::default().with_final_gather(0).with_dilate(false).with_close_seams(false);
    for (scene, side) in [
        (crate::common::load("cornell-box"), 100),
        (crate::common::load("textured"), 64),
        (furnished(icosphere(0.5, 2)), 77),
    ] {
        let s = solved(scene, 2000, 64.0);
        let map = s.bake(Layout::Resolution(side), &plain);
        let flux = map.flux();
        assert_eq!(flux.unmapped, [0.0; 3]);
        for c in 0..3 {
            assert!((flux.map[c] / flux.solver[c] - 1.0).abs() < 1e-6, "{flux:?}");
        }
        // The covered parts of texels have the area of the surface.
        let covered: f64 = (0..map.coverage().len()).map(|i| map.coverage().area(i)).sum();
        let surface: f64 = (0..s.scene.triangles.len()).map(|t| s.scene.area(t)).sum();
        assert!((covered / surface - 1.0).abs() < 1e-9);
    }
}

/// In the empty room no surface is hidden, so only noise and the size of patches make the fluxes of a gathered map and
/// of the solver differ. The standard error of the solver's mean with 256 rays is below 0.1 % there; twice that is
/// allowed, plus five standard errors of the map.
#[test]
fn a_gathered_map_holds_the_flux_of_the_solver_within_its_error() {
    let s = solved(furnished(vec![]), 4000, 256.0);
    let map = s.bake(Layout::Resolution(64), &BakeOptions::default().with_final_gather(64));
    let flux = map.flux();
    for c in 0..3 {
        let off = (flux.map[c] - flux.solver[c]).abs();
        assert!(off < 5.0 * flux.standard_error[c] + 2e-3 * flux.solver[c], "{flux:?}");
        assert!(flux.standard_error[c] < 1e-3 * flux.solver[c]);
    }
    for step in map.steps() {
        assert!(step.relative.abs() < 1e-3, "{step:?}");
    }
}

/// Squared differences of green between two maps, summed over the texels that hold surface.
fn squares(a: &Lightmap, b: &Lightmap) -> f64 {
    let difference = |&at: &u32| [a, b].map(|map| f64::from(map.irradiance()[at as usize][1]));
    a.coverage().texels().iter().map(difference).map(|[x, y]| (x - y).powi(2)).sum()
}

/// The share of the chosen texels whose green differs from another map by at most 1.96 standard errors.
fn covered(a: &Lightmap, b: &Lightmap, is_chosen: impl Fn(usize) -> bool) -> f64 {
    let chosen: Vec<usize> = (0..a.coverage().len()).filter(|&i| is_chosen(i)).collect();
    let holds = |(i, &at): (usize, &u32)| {
        let [x, y] = [a, b].map(|map| f64::from(map.irradiance()[at as usize][1]));
        let [p, q] = [a, b].map(|map| f64::from(map.standard_error()[i][1]));
        (x - y).abs() <= 1.96 * p.hypot(q)
    };
    let texels = a.coverage().texels();
    chosen.iter().filter(|&&i| holds((i, &texels[i]))).count() as f64 / chosen.len() as f64
}

/// For each covered texel, whether it is at the foot of a penumbra, where the light begins to rise: the mean of four
/// neighbours is above it by more than half a percent of the mean of the map.
fn at_foot(map: &Lightmap) -> Vec<bool> {
    let (width, texels) = (map.atlas().width, map.coverage().texels());
    let chart: std::collections::HashMap<u32, u32> =
        texels.iter().enumerate().map(|(i, &at)| (at, map.coverage().chart(map.atlas(), i))).collect();
    let value = |at: u32| f64::from(map.irradiance()[at as usize][1]);
    let mean = texels.iter().map(|&at| value(at)).sum::<f64>() / texels.len() as f64;
    let is_foot = |&at: &u32| {
        let around = [at.wrapping_sub(2), at + 2, at.wrapping_sub(2 * width as u32), at + 2 * width as u32];
        let is_inside = around.iter().all(|n| chart.get(n) == chart.get(&at));
        is_inside && around.iter().map(|&n| value(n)).sum::<f64>() / 4.0 - value(at) > 0.005 * mean
    };
    texels.iter().map(is_foot).collect()
}

/// Compares maps of 16 rays per texel, denoised or not, with a map of many rays: the error bars hold for both.
///
/// If thousands of texels were independent, a share of 0.95 would be known to some tenths of a percent. But neighbours
/// share their error bars and, with the denoiser, their noise.
#[track_caller]
fn assert_error_bars_hold(s: &Solved, side: usize) {
    let raw = BakeOptions::default().with_denoise(false).with_dilate(false).with_close_seams(false);
    let bake = |options: BakeOptions| s.bake(Layout::Resolution(side), &options);
    let few = bake(raw.with_final_gather(16).with_seed(1));
    let smooth = bake(raw.with_denoise(true).with_final_gather(16).with_seed(1));
    let many = bake(raw.with_final_gather(256).with_seed(2));
    let estimated = |map: &Lightmap| -> f64 {
        map.standard_error().iter().map(|error| f64::from(error[1]).powi(2)).sum()
    };
    assert!(few.coverage().len() > 1000);
    for (map, name) in [(&few, "raw"), (&smooth, "denoised")] {
        let held = covered(map, &many, |_| true);
        println!("{name}: {held:.4}");
        assert!((0.93..0.97).contains(&held), "{name}: {held}");
        // With three degrees of freedom the ratio of variances would be known to 5 % if samples were normal. They are
        // skewed, and a few bright texels dominate the squares.
        let ratio = squares(map, &many) / (estimated(map) + estimated(&many));
        assert!((0.5..1.7).contains(&ratio), "{name}: {ratio}");
    }
    // A plane through a disc that reaches into the light is too bright at the foot of a penumbra; its error bar says so.
    let foot = at_foot(&many);
    if foot.iter().filter(|foot| **foot).count() > 100 {
        let held = covered(&smooth, &many, |i| foot[i]);
        println!("at the foot: {held:.4}");
        assert!(held > 0.9, "{held} at the foot of penumbras");
    }
    // The denoiser relies on error bars, and removes most of the variance.
    let left = squares(&smooth, &many) / squares(&few, &many);
    assert!(left < 0.4, "{left}");
    // No texel is much brighter than with many rays.
    let stands_out = |i: usize, &at: &u32| {
        let off = f64::from(smooth.irradiance()[at as usize][1] - many.irradiance()[at as usize][1]);
        off > 8.0 * f64::from(smooth.standard_error()[i][1].hypot(many.standard_error()[i][1]))
    };
    let fireflies =
        smooth.coverage().texels().iter().enumerate().filter(|(i, at)| stands_out(*i, at)).count();
    assert_eq!(fireflies, 0);
}

/// Error bars of texels contain the map of many rays in a plain room.
#[test]
fn error_bars_of_texels_cover_what_many_rays_find() {
    assert_error_bars_hold(&solved(furnished(vec![]), 2000, 128.0), 64);
}

/// Error bars hold also in a shaft of light through a window, with penumbras of all widths.
#[test]
fn error_bars_hold_in_penumbras() {
    assert_error_bars_hold(&HOUSE, 96);
}

/// Every texel belongs to one chart, and two empty texels lie between charts.
#[test]
fn charts_neither_overlap_nor_touch() {
    let scenes = [
        crate::common::load("cornell-box"),
        crate::common::load("door-ajar"),
        furnished(torus(DVec3::ZERO, (0.5, 0.2), (48, 24))),
    ];
    for scene in scenes {
        let tracer = Tracer::new(&scene);
        for side in [128, 300] {
            let atlas = Atlas::new(&scene, &tracer, Layout::Resolution(side), Coordinates::New).unwrap();
            assert_eq!((atlas.width, atlas.height, atlas.pages), (side, side, 1));
            let coverage = radiosity::lightmap::Coverage::new(&scene, &atlas);
            let mut chart = vec![NONE; side * side];
            for (i, &at) in coverage.texels().iter().enumerate() {
                // A texel holds no more surface than fits: charts cover each texel at most once.
                let filled: f64 = coverage
                    .pieces(i)
                    .iter()
                    .map(|p| {
                        let [a, b, c] = atlas.texel_corners(p.triangle as usize).unwrap();
                        let texels = 0.5 * (b - a).perp_dot(c - a).abs();
                        p.area / scene.area(p.triangle as usize) * texels
                    })
                    .sum();
                assert!(filled < 1.0 + 1e-4, "{filled}");
                chart[at as usize] = coverage.chart(&atlas, i);
                assert!(
                    coverage.pieces(i).iter().all(|p| atlas.chart[p.triangle as usize] == chart[at as usize])
                );
            }
            // At least two empty texels lie between charts, so that a bilinear sample reads one chart only.
            for (at, &c) in chart.iter().enumerate().filter(|(_, c)| **c != NONE) {
                let (x, y) = (at % side, at / side);
                for (dx, dy) in [(1, 0), (2, 0), (0, 1), (0, 2), (1, 1), (2, 2)] {
                    if x + dx < side && y + dy < side {
                        let other = chart[(y + dy) * side + x + dx];
                        assert!(other == c || other == NONE);
                    }
                }
            }
        }
    }
}

/// Texels under a block without a bottom are hidden and take values from their neighbours, so that no black shows at
/// its edge.
#[test]
fn the_floor_under_a_block_is_hidden_and_not_black() {
    // A block without a bottom on the floor.
    let faces = room_faces(dvec3(-0.3, -0.3, -1.0), dvec3(0.3, 0.3, -0.4));
    let block = crate::common::flipped([&faces[..4], &faces[5..]].concat().concat());
    let s = solved(furnished(block), 2000, 64.0);
    let floor: Vec<usize> =
        (0..s.scene.triangles.len()).filter(|&t| s.scene.corners(t).iter().all(|c| c.z == -1.0)).collect();
    for final_gather in [0, 16] {
        let map = s.bake(Layout::Resolution(128), &BakeOptions::default().with_final_gather(final_gather));
        let at = |point: DVec3| {
            let (t, b) = floor
                .iter()
                .map(|&t| (t, barycentric(s.scene.corners(t), point)))
                .find(|(_, b)| b.iter().all(|&x| x >= 0.0))
                .unwrap();
            let corners = map.atlas().texel_corners(t).unwrap();
            let p: glam::DVec2 = (0..3).map(|k| corners[k] * b[k]).sum();
            (map.texels()[p.y as usize * 128 + p.x as usize], map.at(t, b).unwrap()[0])
        };
        let (under, value) = at(dvec3(0.0, 0.0, -1.0));
        let (open, lit) = at(dvec3(0.7, 0.6, -1.0));
        assert_eq!((under, open), (Texel::Hidden, Texel::Valid));
        assert!(value > 0.05 * lit, "{value} under the block, {lit} beside it");
    }
}

/// The floor under a shell sees almost only the inside of the shell, but the rest counts too: it agrees with path
/// tracing.
#[test]
fn the_floor_under_a_shell_with_a_gap_is_lit_as_paths_light_it() {
    let faces = room_faces(dvec3(-0.5, -0.5, -0.9), dvec3(0.5, 0.5, 0.1));
    let shell = crate::common::flipped([&faces[..4], &faces[5..]].concat().concat());
    let s = solved(furnished(shell), 2000, 64.0);
    let map = s.bake(Layout::Resolution(128), &BakeOptions::default().with_final_gather(64));
    let floor: Vec<usize> =
        (0..s.scene.triangles.len()).filter(|&t| s.scene.corners(t).iter().all(|c| c.z == -1.0)).collect();
    let places: Vec<(usize, [f64; 3])> = (0..1600)
        .map(|k| dvec3((k % 40) as f64 * 0.02 - 0.39, (k / 40) as f64 * 0.02 - 0.39, -1.0))
        .map(|point| {
            let seen = floor.iter().map(|&t| (t, barycentric(s.scene.corners(t), point)));
            seen.into_iter().find(|(_, b)| b.iter().all(|&x| x >= 0.0)).unwrap()
        })
        .collect();
    let compared = s.at_places(&map, &places, 256);
    let (bias, error) = compared.bias();
    println!("{bias:.3} +- {error:.3}");
    // The edges of patches are a tenth of the shell's. A patch that reaches under the shell carries light that far.
    assert!(bias.abs() <= 4.0 * error + 0.1, "{bias} +- {error}");
}

fn barycentric([a, b, c]: Corners, p: DVec3) -> [f64; 3] {
    let n = (b - a).cross(c - a);
    let share = |u: DVec3, v: DVec3| (u - p).cross(v - p).dot(n) / n.length_squared();
    [share(b, c), share(c, a), share(a, b)]
}

/// Walls the wrong way round and a lamp the right way: only the backs of the walls are lit. The map shows them, with
/// the flux of the room with walls the right way, up to 1 % of sampling noise.
#[test]
fn a_room_that_shows_its_backs_is_mapped_by_them() {
    let mut scene = furnished(vec![]);
    for t in 0..scene.triangles.len() {
        if !scene.emits(t) {
            scene.triangles[t].vertices.swap(1, 2);
        }
    }
    let s = solved(scene, 500, 64.0);
    let map = s.bake(Layout::Resolution(64), &BakeOptions::default());
    for t in 0..s.scene.triangles.len() {
        assert_eq!(map.is_of_front(t), s.scene.emits(t));
    }
    assert_eq!(map.flux().other_sides, [0.0; 3]);
    assert!(map.texels().iter().all(|&texel| texel != Texel::Hidden));
    let straight = solved(furnished(vec![]), 500, 64.0).bake(Layout::Resolution(64), &BakeOptions::default());
    let ratio = map.flux().map[0] / straight.flux().map[0];
    assert!((ratio - 1.0).abs() < 0.01, "{ratio}");
}

/// Texels of a given length take as many pages as they need. Charts are scaled by less than 2 % to fill whole texels.
#[test]
fn texels_of_a_length_take_as_many_pages_as_they_need() {
    let scene = crate::common::load("cornell-box");
    let tracer = Tracer::new(&scene);
    let make = |layout| Atlas::new(&scene, &tracer, layout, Coordinates::Auto);
    let one = make(Layout::Texel(10.0, 4096)).unwrap();
    assert_eq!(one.pages, 1);
    assert!((one.texel_length(&scene) / 10.0 - 1.0).abs() < 0.02);
    // Every wall has 56 texels a side, and four walls do not fit on a page of 100.
    let several = make(Layout::Texel(10.0, 100)).unwrap();
    assert!(several.pages > 1 && several.width <= 100 && several.height <= 100);
    assert!(several.density_spread(&scene) < 0.05, "texels are equally dense everywhere");
    // Walls that do not fit on a page are split.
    let split = make(Layout::Texel(10.0, 40)).unwrap();
    assert!(split.pages > several.pages && split.width <= 40 && split.height <= 40);
    assert!((split.texel_length(&scene) / 10.0 - 1.0).abs() < 0.02 && split.density_spread(&scene) < 0.05);
    let map = solved(scene.clone(), 500, 16.0).bake(Layout::Texel(10.0, 100), &BakeOptions::default());
    assert!(map.texels().iter().all(|&texel| texel != Texel::Empty), "every page is filled");
}

/// A map that is too small fails with the least size that works. That size works, and a smaller one does not. In a long
/// strip the least size needs charts that are split.
#[test]
fn the_smallest_map_that_works_is_stated_and_works() {
    let strip = crate::common::level_square(1.0, 0.0, true).into_iter();
    let strip = strip.map(|corners| corners.map(|p| p * glam::dvec3(500.0, 1.0, 1.0))).collect();
    for scene in [crate::common::load("cornell-box"), crate::common::scene(&[part(strip, 0.5, 1.0)])] {
        let tracer = Tracer::new(&scene);
        let make = |side| Atlas::new(&scene, &tracer, Layout::Resolution(side), Coordinates::Auto);
        let error = make(8).unwrap_err();
        let hint = error.hint().unwrap();
        let least: usize = hint.rsplit(' ').next().unwrap().parse().unwrap();
        assert!(least > 8 && make(least).is_ok() && make(least - 1).is_err(), "{hint}");
    }
}

/// Coordinates of the file are used if they lie in 0..1, do not overlap and use half of the texels; otherwise the reason is
/// stated.
#[test]
fn own_coordinates_are_kept_where_they_suit() {
    let square = |scene: &mut Scene, map: fn(glam::DVec2) -> glam::DVec2| {
        let uv = [(0., 0.), (1., 0.), (1., 1.), (0., 1.)].map(|(u, v)| map(glam::dvec2(u, v)));
        scene.texcoords = vec![[uv[0], uv[1], uv[2]], [uv[0], uv[2], uv[3]]];
    };
    let mut scene = crate::common::scene(&[part(crate::common::level_square(1.0, 0.0, true), 0.5, 1.0)]);
    let tracer = Tracer::new(&scene);
    let make = |scene: &Scene, whose| Atlas::new(scene, &tracer, Layout::Resolution(16), whose);
    square(&mut scene, |uv| 0.1 + 0.6 * uv);
    assert!(make(&scene, Coordinates::Auto).unwrap().refused.unwrap().contains("47.3 % of the texels"));
    assert!(make(&scene, Coordinates::File).unwrap().refused.is_none());
    square(&mut scene, |uv| 0.1 + 0.8 * uv);
    let own = make(&scene, Coordinates::Auto).unwrap();
    assert!(own.refused.is_none() && own.charts == 1);
    assert_eq!(own.coordinates[own.corners[0][0] as usize], glam::dvec2(0.1, 0.1));
    square(&mut scene, |uv| 0.1 + uv);
    assert!(make(&scene, Coordinates::Auto).unwrap().refused.unwrap().contains("outside 0..1"));
    assert!(
        make(&scene, Coordinates::File)
            .unwrap_err()
            .to_string()
            .contains("the coordinates of triangle 1 lie outside")
    );
    scene.texcoords[0] = [(0., 0.), (1., 0.), (1., 1.)].map(|(u, v)| glam::dvec2(u, v));
    scene.texcoords[1] = scene.texcoords[0];
    let message = make(&scene, Coordinates::File).unwrap_err().to_string();
    assert!(message.contains("triangle 1 and triangle 2 overlap"), "{message}");
}

/// Coordinates just outside 0..1 by rounding are clamped, and a face whose coordinates enclose no area has no place in the
/// map. Neither spoils the coordinates of the other faces.
#[test]
fn a_few_bad_coordinates_do_not_spoil_the_others() {
    let small = [DVec3::ZERO, dvec3(0.01, 0.0, 0.0), dvec3(0.0, 0.01, 0.001)];
    let square = crate::common::level_square(1.0, 0.0, true);
    let lamp = crate::common::level_square(1.0, 1.0, false);
    let mut scene =
        crate::common::scene(&[part(square, 0.5, 0.0), part(vec![small], 0.5, 0.0), part(lamp, 0.0, 5.0)]);
    let uv = |u: f64, v: f64| glam::dvec2(u, v);
    let half = |from: f64, to: f64| {
        let (low, high) = (-1e-6, 1.000001);
        [[uv(from, low), uv(to, low), uv(to, high)], [uv(from, low), uv(to, high), uv(from, high)]]
    };
    let [one, two] = half(-1e-6, 0.45);
    // The corners of the lamp run the other way round.
    let [three, four] = half(0.55, 1.000001).map(|[a, b, c]| [a, c, b]);
    scene.texcoords = vec![one, two, [uv(0.2, 0.2); 3], three, four];
    let s = solved(scene, 100, 32.0);
    for whose in [Coordinates::Auto, Coordinates::File] {
        let atlas = Atlas::new(&s.scene, &s.tracer, Layout::Resolution(64), whose).unwrap();
        assert_eq!((&atlas.refused, atlas.chart[2], atlas.charts - 1), (&None, NONE, 2), "{whose:?}");
        assert!(atlas.coordinates.iter().all(|uv| uv.min_element() >= 0.0 && uv.max_element() <= 1.0));
        let solution = (&s.patches, &s.solution);
        let options = BakeOptions::default().with_final_gather(0);
        let map = bake(&s.scene, &s.tracer, solution, atlas, &options, &Progress::new()).unwrap();
        // The small face has no texels. All others have the flux of the solver.
        assert!((map.unmapped_area() / s.scene.area(2) - 1.0).abs() < 1e-9);
        let flux = map.flux();
        assert!((flux.map[0] / flux.solver[0] - 1.0).abs() < 1e-6, "{flux:?}");
    }
    // Too much surface without a place is no layout, unless it is demanded.
    let mut large = s.scene.clone();
    large.texcoords[0] = [uv(0.2, 0.2); 3];
    let make = |whose| Atlas::new(&large, &s.tracer, Layout::Resolution(64), whose);
    assert!(make(Coordinates::Auto).unwrap().refused.unwrap().contains("triangle 1 enclose no area"));
    assert!(make(Coordinates::File).is_ok());
}

/// Each step runs only with its option, and dilation changes only texels without surface.
#[test]
fn every_step_can_be_left_out() {
    let s = solved(furnished(icosphere(0.5, 1)), 500, 32.0);
    let all = BakeOptions::default().with_final_gather(4);
    let names = |options: BakeOptions| -> Vec<&str> {
        let map = s.bake(Layout::Resolution(64), &options);
        let empty = map.texels().iter().filter(|&&t| t == Texel::Empty).count();
        assert_eq!(empty == 0, options.dilate);
        // Only dilation writes texels without surface.
        for (&texel, value) in map.texels().iter().zip(map.irradiance()) {
            assert!(texel != Texel::Empty || *value == [0.0; 3]);
            assert!(value.iter().all(|x| x.is_finite() && *x >= 0.0));
        }
        map.steps().iter().map(|step| step.name).collect()
    };
    assert_eq!(names(all), ["denoise", "dilate", "seams"]);
    assert_eq!(names(all.with_denoise(false)), ["dilate", "seams"]);
    assert_eq!(names(all.with_dilate(false)), ["denoise", "seams"]);
    assert_eq!(names(all.with_close_seams(false)), ["denoise", "dilate"]);
    assert_eq!(names(all.with_final_gather(0)), ["hide", "dilate", "seams"]);
    // Dilation changes no texel with surface.
    let [with, without] = [true, false]
        .map(|dilate| s.bake(Layout::Resolution(64), &all.with_dilate(dilate).with_close_seams(false)));
    for (k, &texel) in without.texels().iter().enumerate() {
        assert!(texel != Texel::Valid || with.irradiance()[k] == without.irradiance()[k]);
    }
}

/// A strip of 60 m beside a box of 2 m. As one chart the strip would set the density of the whole map.
fn strip_and_box() -> Scene {
    let strip = rectangle(dvec3(-30.0, -1.2, 0.0), dvec3(0.1, 0.0, 0.0) * 600.0, dvec3(0.0, 0.2, 0.0));
    let cube = crate::common::flipped(room_faces(dvec3(-1.0, -1.0, 0.1), dvec3(1.0, 1.0, 2.1)).concat());
    let lamp = rectangle(dvec3(-1.0, -3.0, 4.0), DVec3::Y * 2.0, DVec3::X * 2.0);
    crate::common::scene(&[part(strip, 0.5, 0.0), part(cube, 0.5, 0.0), part(lamp, 0.0, 5.0)])
}

/// The share of texels with surface.
fn used(map: &Lightmap) -> f64 {
    map.coverage().len() as f64 / map.atlas().texels() as f64
}

/// A long chart is split, so that the other charts keep their texels. Area and flux are still exact, and points of the
/// strip have their own light: it agrees with path tracing within 2 %, with 0.3 % measured.
#[test]
fn long_charts_are_split_and_leave_the_rest_its_texels() {
    let s = solved(strip_and_box(), 500, 64.0);
    let exact = BakeOptions::default().with_final_gather(0);
    for layout in [Layout::Resolution(128), Layout::Texel(0.05, 256)] {
        let map = s.bake(layout, &exact);
        let atlas = map.atlas();
        // As one chart the strip would leave 97 % of a page empty. Measured use: 56 % and 65 %.
        assert!(used(&map) > 0.5, "{layout:?}: {}", used(&map));
        assert!(atlas.density_spread(&s.scene) < 0.05, "texels are equally dense everywhere");
        // The parts of cut triangles have the area of the surface, and its flux.
        let covered: f64 = (0..map.coverage().len()).map(|i| map.coverage().area(i)).sum();
        let surface: f64 = (0..s.scene.triangles.len()).map(|t| s.scene.area(t)).sum();
        assert!((covered / surface - 1.0).abs() < 1e-9, "{covered} {surface}");
        let flux = map.flux();
        assert_eq!(flux.unmapped, [0.0; 3]);
        assert!((flux.map[0] / flux.solver[0] - 1.0).abs() < 1e-6, "{flux:?}");
        // Each point of the strip has its own texel. Patches of half a metre would be too coarse to show this.
        let gathered = s.bake(layout, &BakeOptions::default().with_final_gather(64));
        let compared = s.at_places(&gathered, &[(0, [0.45, 0.1, 0.45]), (1, [0.3, 0.4, 0.3])], 4096);
        assert!(compared.rms() < 0.02, "{compared:?}");
    }
}

/// A hundred crates on a ground: the texels have the length that was asked for, on as many pages as that takes, and more
/// than half of them hold surface.
#[test]
fn many_small_charts_have_the_density_and_use_the_pages() {
    let mut random = Random::new(3);
    let crate_at = |k: usize| {
        let size = 0.4 + 0.4 * random.next();
        let low = dvec3((k % 10) as f64 - 4.9, (k / 10) as f64 - 4.9, 0.0);
        let faces = room_faces(low, low + size);
        let stands_on = |face: &Vec<Corners>| face.iter().flatten().all(|p| p.z == 0.0);
        let sides: Vec<_> = faces.into_iter().filter(|face| !stands_on(face)).collect();
        part(crate::common::flipped(sides.concat()), 0.6, 0.0)
    };
    let mut parts: Vec<crate::common::Part> = (0..100).map(crate_at).collect();
    parts.push(part(crate::common::level_square(12.0, 0.0, true), 0.4, 0.0));
    let scene = crate::common::scene(&parts);
    let tracer = Tracer::new(&scene);
    for (length, page) in [(0.05, 4096), (0.05, 256), (0.02, 512)] {
        let atlas = Atlas::new(&scene, &tracer, Layout::Texel(length, page), Coordinates::Auto).unwrap();
        let coverage = radiosity::lightmap::Coverage::new(&scene, &atlas);
        let used = coverage.len() as f64 / atlas.texels() as f64;
        println!("{length} {page}: {used}, {} pages of {} x {}", atlas.pages, atlas.width, atlas.height);
        assert!((atlas.texel_length(&scene) / length - 1.0).abs() < 0.02);
        assert!(used > 0.5 && atlas.density_spread(&scene) < 0.05, "{used}");
        assert!(atlas.pages == 1 || atlas.width <= page && atlas.height <= page);
    }
}

/// A material with three times the density has texels of a third of the length, up to the 2 % of whole texels.
#[test]
fn a_material_can_have_denser_texels() {
    let scene = strip_and_box();
    let tracer = Tracer::new(&scene);
    let options = AtlasOptions::new(Layout::Texel(0.05, 1024), Coordinates::Auto)
        .with_density(vec![(scene.triangles[4].material, 3.0)]);
    let atlas = Atlas::with(&scene, &tracer, &options).unwrap();
    for facet in 0..atlas.corners.len() {
        let t = atlas.triangle(facet);
        let [a, b, c] = atlas.texel_corners(facet).unwrap();
        let texels = 0.5 * (b - a).perp_dot(c - a).abs();
        let length = (atlas.scene(&scene).area(facet) / texels).sqrt();
        let wanted =
            if scene.triangles[t].material == scene.triangles[4].material { 0.05 / 3.0 } else { 0.05 };
        assert!((length / wanted - 1.0).abs() < 0.02, "triangle {t}: {length}");
    }
}

/// A sheet between a bright and a dim lamp. Its front is on the dim side.
fn curtain() -> Scene {
    let sheet = rectangle(dvec3(-1.0, -1.0, 0.0), DVec3::X * 2.0, DVec3::Y * 2.0);
    let above = rectangle(dvec3(-0.5, -0.5, 1.0), DVec3::Y, DVec3::X);
    let below = rectangle(dvec3(-0.5, -0.5, -1.0), DVec3::X, DVec3::Y);
    crate::common::scene(&[part(sheet, 0.5, 0.0), part(above, 0.0, 1.0), part(below, 0.0, 9.0)])
}

/// A sheet lit on both sides shows its brighter side, or both if asked. Both sides agree with path tracing within 5 %,
/// for the size of patches and texels.
#[test]
fn a_sheet_is_shown_by_its_brighter_side_or_by_both() {
    let s = solved(curtain(), 500, 256.0);
    let options = BakeOptions::default().with_final_gather(64);
    let one = s.bake(Layout::Resolution(64), &options);
    assert_eq!([0, 1, 2].map(|t| one.is_of_front(t)), [false, false, true]);
    assert_eq!(one.at_side(0, [0.3, 0.3, 0.4], true), None);
    assert!(one.flux().other_sides[0] > 0.05 * one.flux().solver[0]);

    let two_sided = lit_on_both_sides(&s.patches, &s.solution);
    assert_eq!(two_sided.iter().map(|&both| usize::from(both)).collect::<Vec<_>>(), [1, 1, 0, 0, 0, 0]);
    let layout = AtlasOptions::new(Layout::Resolution(64), Coordinates::Auto).with_two_sided(two_sided);
    let atlas = Atlas::with(&s.scene, &s.tracer, &layout).unwrap();
    let both =
        bake(&s.scene, &s.tracer, (&s.patches, &s.solution), atlas, &options, &Progress::new()).unwrap();
    assert_eq!(both.flux().other_sides, [0.0; 3]);
    let tracer = PathTracer::new(&s.scene, &s.tracer, PathOptions::default());
    for front in [true, false] {
        let at = [0.3, 0.2, 0.5];
        let receiver = Receiver::on_triangle(&s.tracer, 0, at, front);
        let effort = Effort::default().with_samples(4096);
        let truth = tracer.irradiances(&[receiver], &effort, &Progress::new()).unwrap()[0];
        let found = both.at_side(0, at, front).unwrap()[0];
        assert!((found / truth.mean[0] - 1.0).abs() < 0.05, "front {front}: {found} for {}", truth.mean[0]);
        assert!((both.at(0, at).unwrap()[0] - found).abs() < 1e-12 || !front);
    }
}

static HOUSE: LazyLock<Solved> = LazyLock::new(|| solved(sheet_house(), 2000, 128.0));

/// A house of single faces whose fronts face outward, on a ground. Light enters only through a window.
fn sheet_house() -> Scene {
    let faces = room_faces(dvec3(-1.0, -1.0, 0.0), dvec3(1.0, 1.0, 1.6));
    // Without its floor, and without the wall at x = -1, which has the window.
    let is_kept = |face: &Vec<Corners>| {
        let all = |f: &dyn Fn(&DVec3) -> bool| face.iter().flatten().all(f);
        !all(&|p| p.z == 0.0) && !all(&|p| p.x == -1.0)
    };
    let kept: Vec<Vec<Corners>> = faces.iter().filter(|face| is_kept(face)).cloned().collect();
    let wall = |y: f64, z: f64, dy: f64, dz: f64| rectangle(dvec3(-1.0, y, z), DVec3::Z * dz, DVec3::Y * dy);
    let pierced = [
        wall(-1.0, 0.0, 2.0, 0.5),
        wall(-1.0, 1.1, 2.0, 0.5),
        wall(-1.0, 0.5, 0.6, 0.6),
        wall(0.4, 0.5, 0.6, 0.6),
    ];
    let ground = rectangle(dvec3(-6.0, -4.0, 0.0), DVec3::X * 10.0, DVec3::Y * 8.0);
    let lamp = rectangle(dvec3(-5.5, -0.5, 3.0), DVec3::Y, DVec3::X);
    let house = [crate::common::flipped(kept.concat()), pierced.concat()].concat();
    crate::common::scene(&[part(ground, 0.4, 0.0), part(house, 0.6, 0.0), part(lamp, 0.0, 20.0)])
}

/// A house whose walls face outward is not mistaken for a solid: its floor is valid and lit as path tracing lights it,
/// within 15 % for patches on the edge of the light from the window, plus four standard errors.
#[test]
fn a_house_whose_walls_face_outward_is_no_solid() {
    let s = &*HOUSE;
    let map = s.bake(Layout::Texel(0.1, 1024), &BakeOptions::default().with_final_gather(64));
    let floor = |point: DVec3| {
        let at = (0..2).map(|t| (t, barycentric(s.scene.corners(t), point)));
        at.into_iter().find(|(_, b)| b.iter().all(|&x| x >= 0.0)).unwrap()
    };
    let inside: Vec<DVec3> =
        (0..64).map(|k| dvec3((k % 8) as f64 * 0.2 - 0.7, (k / 8) as f64 * 0.2 - 0.7, 0.0)).collect();
    for &point in &inside {
        let (t, b) = floor(point);
        let corners = map.atlas().texel_corners(t).unwrap();
        let p: glam::DVec2 = (0..3).map(|k| corners[k] * b[k]).sum();
        let at = (map.atlas().page[t] as usize * map.atlas().height + p.y as usize) * map.atlas().width;
        assert_eq!(map.texels()[at + p.x as usize], Texel::Valid, "{point}");
    }
    let places: Vec<_> = inside.iter().map(|&point| floor(point)).collect();
    let compared = s.at_places(&map, &places, 2048);
    let (bias, error) = compared.bias();
    assert!(bias.abs() < 4.0 * error + 0.15, "{bias} +- {error}");
}

/// Four blocks that touch, each with all six faces, under a lamp. The faces between them have no place in the map and
/// count as hidden. The outer faces of all blocks are one smooth surface per side: top, bottom and four walls.
#[test]
fn faces_within_solids_have_no_texels() {
    let mut parts: Vec<(Corners, u32)> = Vec::new();
    for (x, z) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
        let low = dvec3(x, 0.0, z);
        parts.extend(flipped(room(low, low + 1.0)).into_iter().map(|t| (t, 0)));
    }
    let lamp = rectangle(dvec3(0.0, 3.0, 0.0), DVec3::X, DVec3::Z);
    parts.extend(lamp.into_iter().map(|t| (t, 1)));
    let materials =
        vec![Material::new("stone", [0.5; 3], [0.0; 3]), Material::new("lamp", [0.0; 3], [1.0; 3])];
    let s = solved(Scene::new(&parts, materials), 200, 64.0);
    let map = s.bake(Layout::Resolution(64), &BakeOptions::default());
    assert_eq!(map.atlas().charts, 7);
    assert_eq!(map.hidden_areas(&s.scene), [8.0, 0.0]);
    assert_eq!(map.unmapped_area(), 0.0);
    let mapped: f64 = (0..map.coverage().len()).map(|i| map.coverage().area(i)).sum();
    assert!((mapped - 17.0).abs() < 1e-6, "{mapped}");
}
