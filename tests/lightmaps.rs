//! Lightmaps against the solver's energy, against path tracing at random points of the surface, and against themselves
//! across seams.

mod common;

use common::{Corners, Random, icosphere, part, rectangle, room_faces};
use glam::{DVec3, dvec3};
use radiosity::{
    Progress, Scene,
    form_factor::{CastOptions, FormFactors},
    lightmap::{Atlas, BakeOptions, Coordinates, Layout, Lightmap, NONE, Texel, bake},
    monte_carlo::{Effort, PathOptions, PathTracer, Receiver},
    patch::{Patches, Subdivision},
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
    let options = CastOptions { rays, ..CastOptions::default() };
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

    /// Differences of the map, sampled bilinearly, from path tracing at random points of the surface.
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
        let receivers: Vec<Receiver> = places
            .iter()
            .map(|&(t, at)| Receiver::on_triangle(&self.tracer, t, at, map.is_of_front(t)))
            .collect();
        let tracer = PathTracer::new(&self.scene, &self.tracer, PathOptions::default());
        let effort = Effort { samples: paths, ..Effort::default() };
        let truth = tracer.irradiances(&receivers, &effort, &Progress::new()).unwrap();
        let mut sums = Comparison::default();
        for (&(t, at), truth) in places.iter().zip(&truth) {
            let found = map.at(t, at).unwrap()[0];
            let (e, se) = (truth.mean[0], truth.standard_error[0]);
            // Nothing arrives inside solids, and what the map shows there comes from neighbours.
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

    /// Root mean square difference beyond the noise of the paths, relative to the mean.
    fn rms(&self) -> f64 {
        ((self.squares - self.noise).max(0.0) / self.n).sqrt() / (self.mean / self.n)
    }

    /// Mean difference, relative to the mean; and its standard error.
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
    let mut parts: Vec<common::Part> = faces.into_iter().map(|face| part(face, 0.7, 0.0)).collect();
    parts[0].reflectance = RED;
    parts.push(part(strip(-0.4 * x - 0.4 * y, 0.8 * x, 0.8 * y), 0.0, 10.0));
    if !things.is_empty() {
        parts.push(part(things, 0.6, 0.0));
    }
    common::scene(&parts)
}

/// A torus round the vertical axis through `centre`; fronts outside.
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

#[test]
fn measure() {
    for (name, s) in [
        ("box", solved(furnished(vec![]), 4000, 256.0)),
        ("torus", solved(furnished(torus(dvec3(0.1, 0.0, -0.3), (0.5, 0.2), (48, 24))), 8000, 256.0)),
        ("sphere", solved(furnished(icosphere(0.5, 3)), 8000, 256.0)),
        ("cornell", solved(common::load("cornell-box"), 8000, 256.0)),
        ("door", solved(common::load("door-ajar"), 8000, 256.0)),
    ] {
        for n in [128, 192] {
            for fg in [0, 64] {
                let start = std::time::Instant::now();
                let map = s
                    .bake(Layout::Resolution(n), &BakeOptions { final_gather: fg, ..BakeOptions::default() });
                let t = start.elapsed();
                let c = s.against_paths(&map, 500, 1024);
                println!(
                    "{name} {n} {fg}: rms {:.4} bias {:.4} +- {:.4}; noise of paths {:.4}; bake {t:?} compare {:?} seams {:?}",
                    c.rms(),
                    c.bias().0,
                    c.bias().1,
                    (c.noise / c.n).sqrt() / (c.mean / c.n),
                    start.elapsed() - t,
                    map.seams()
                );
            }
        }
    }
}
