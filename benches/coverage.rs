//! Coverage of the standard errors of view factors: `cargo bench --bench coverage -- [SEEDS]`, by default 25. For twelve
//! scenes with occlusion it counts how often the true value of a pair above 1e-4 is within 1.96 standard errors. Pairs
//! that formulas give are not counted. The true value comes from a run with a small share of the error: estimates have
//! no bias (tests/light/view_factors.rs). Pairs that have little of it take the mean of all runs.

use glam::{DQuat, DVec3, dvec3};
use radiosity::{
    Progress,
    view_factor::{Enclosure, ViewFactorOptions, ViewFactors, look, view_factors},
};

const SEEDS: u64 = 25;
/// Error of the true values, as a share of the wanted error.
const TRUTH: f64 = 0.02;
/// A relative error below which a view factor comes from formulas.
const FORMULA: f64 = 1.01e-5;

type Polygons = Vec<Vec<DVec3>>;

fn main() {
    let seeds = std::env::args().filter_map(|a| a.parse().ok()).next().unwrap_or(SEEDS);
    println!("| scene | error | pairs | estimated / actual | in 95 % intervals | least | most | rays |");
    println!("|---|---|---|---|---|---|---|---|");
    let (mut all, mut inside) = (0, 0);
    for (name, polygons, error) in scenes() {
        // Rows of closed rooms are closed, as by the command line.
        let surfaces: Vec<&[Vec<DVec3>]> = polygons.iter().map(std::slice::from_ref).collect();
        let is_room = Enclosure::of(&look(&surfaces, &[], DVec3::Z)) == Enclosure::Closed;
        let run = |seed: u64, error: f64| {
            let options =
                ViewFactorOptions::default().with_error(error).with_enclosed(is_room).with_seed(seed);
            view_factors(&polygons, &options, &Progress::new()).expect("the run is not stopped")
        };
        let found: Vec<ViewFactors> = (1..=seeds).map(|seed| run(seed, error)).collect();
        let truth = run(0, TRUTH * error);
        let (mut shares, mut estimated, mut actual) = (Vec::new(), 0.0, 0.0);
        for (i, j) in (0..polygons.len()).flat_map(|i| (0..i).map(move |j| (i, j))) {
            // The truth of a pair that has little of the error is found best by the mean of all runs.
            let runs = found.iter().map(|one| one.get(i, j)).sum::<f64>() / seeds as f64;
            let told = found.iter().map(|one| one.standard_error(i, j).powi(2)).sum::<f64>() / seeds as f64;
            let weights = [truth.standard_error(i, j).powi(-2), seeds as f64 / told];
            let spread = (weights[0] + weights[1]).recip();
            let mean = spread * (weights[0] * truth.get(i, j) + weights[1] * runs);
            let is_exact = |one: &ViewFactors| one.standard_error(i, j) <= FORMULA * one.get(i, j);
            if mean < 1e-4 || found.iter().all(is_exact) {
                continue;
            }
            let off = |one: &ViewFactors| one.get(i, j) - mean;
            let is_inside = |one: &&ViewFactors| {
                off(one).abs() < 1.96 * (one.standard_error(i, j).powi(2) + spread).sqrt()
            };
            shares.push(found.iter().filter(is_inside).count());
            if std::env::var_os("PAIRS").is_some() {
                let rms = |f: &dyn Fn(&ViewFactors) -> f64| {
                    (found.iter().map(|one| f(one).powi(2)).sum::<f64>() / seeds as f64).sqrt()
                };
                println!(
                    "{i} {j}: {mean:.3e}, true to {:.1e}, off {:.1e}, estimated {:.1e}, inside {}",
                    spread.sqrt(),
                    rms(&off),
                    rms(&|one| one.standard_error(i, j)),
                    shares[shares.len() - 1]
                );
            }
            estimated += found.iter().map(|one| one.standard_error(i, j).powi(2)).sum::<f64>();
            actual += found.iter().map(|one| off(one).powi(2) - spread).sum::<f64>();
        }
        let percent = |count: usize| 100.0 * count as f64 / seeds as f64;
        let sum: usize = shares.iter().sum();
        (all, inside) = (all + shares.len(), inside + sum);
        println!(
            "| {name} | {error:.0e} | {} | {:.2} | {:.1} % | {:.1} % | {:.1} % | {} |",
            shares.len(),
            (estimated / actual).sqrt(),
            percent(sum) / shares.len() as f64,
            percent(*shares.iter().min().unwrap_or(&0)),
            percent(*shares.iter().max().unwrap_or(&0)),
            found[0].rays
        );
    }
    println!("| all | | {all} | | {:.1} % | | | |", 100.0 * inside as f64 / (all as u64 * seeds) as f64);
}

fn rectangle(origin: DVec3, a: DVec3, b: DVec3) -> Vec<DVec3> {
    vec![origin, origin + a, origin + a + b, origin + b]
}

/// The six sides of a box, seen from inside or from outside.
fn sides(centre: DVec3, half: DVec3, turn: f64, inside: bool) -> Polygons {
    let turned = DQuat::from_rotation_z(turn);
    let side = |wall: usize| {
        let (axis, sign) = (wall / 2, if wall % 2 == 0 { -1.0 } else { 1.0 });
        let flip = if inside { -sign } else { sign };
        let (a, b) = (DVec3::AXES[(axis + 1) % 3], DVec3::AXES[(axis + 2) % 3] * flip);
        let at = |u: f64, v: f64| centre + turned * ((DVec3::AXES[axis] * sign + a * u + b * v) * half);
        vec![at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)]
    };
    (0..6).map(side).collect()
}

/// A panel of this length that touches the ground at an angle, in front of a wall.
fn panel(degrees: f64, length: f64) -> Polygons {
    let along = DVec3::Y * length;
    let (sine, cosine) = degrees.to_radians().sin_cos();
    let mut polygons = vec![
        rectangle(DVec3::ZERO, dvec3(2.0 * cosine, 0.0, 2.0 * sine), along),
        rectangle(dvec3(-3.0, 0.0, 0.0), along, DVec3::Z),
    ];
    polygons.extend(
        (0..4).map(|k| rectangle(dvec3(-10.0 + 5.0 * f64::from(k), 0.0, 0.0), DVec3::X * 5.0, along)),
    );
    polygons
}

/// Rows of panels or of houses, one behind the other.
fn rows(count: u32, length: f64, pitch: f64, up: DVec3) -> Polygons {
    let along = DVec3::Y * length;
    let ground = rectangle(dvec3(-pitch, 0.0, 0.0), DVec3::X * (f64::from(count) + 1.0) * pitch, along);
    let row = |k: u32| rectangle(DVec3::X * pitch * f64::from(k), up, along);
    let back = |k: u32| rectangle(DVec3::X * pitch * f64::from(k), along, up);
    std::iter::once(ground).chain((0..count).map(row)).chain((0..count).map(back)).collect()
}

fn scenes() -> Vec<(&'static str, Polygons, f64)> {
    let room = |boxes: &[Polygons]| {
        let mut polygons = sides(DVec3::splat(0.5), DVec3::splat(0.5), 0.0, true);
        polygons.extend(boxes.iter().flatten().cloned());
        polygons
    };
    let block =
        |x: f64, y: f64, half: f64, turn: f64| sides(dvec3(x, y, half), DVec3::splat(half), turn, false);
    let wedge = {
        let along = DVec3::Y;
        let (sine, cosine) = 12f64.to_radians().sin_cos();
        vec![
            rectangle(DVec3::ZERO, DVec3::X, along),
            rectangle(DVec3::ZERO, along, dvec3(cosine, 0.0, sine)),
            rectangle(dvec3(0.4, 0.2, 0.02), DVec3::X * 0.3, along * 0.4),
            rectangle(dvec3(0.4, 0.2, 0.02), along * 0.4, DVec3::X * 0.3),
        ]
    };
    let opposed = |gap: f64, hole: f64| {
        let strip = |x: f64, width: f64| rectangle(dvec3(x, -0.5, gap / 2.0), DVec3::X * width, DVec3::Y);
        vec![
            rectangle(dvec3(-0.5, -0.5, 0.0), DVec3::X, DVec3::Y),
            rectangle(dvec3(-0.5, -0.5, gap), DVec3::Y, DVec3::X),
            strip(-0.5, 0.5 - hole / 2.0),
            strip(hole / 2.0, 0.5 - hole / 2.0),
        ]
    };
    let court = {
        let mut polygons = sides(dvec3(0.0, 0.0, 5.0), dvec3(10.0, 10.0, 5.0), 0.0, true);
        polygons.pop();
        for (x, y) in [(-4.0, -3.0), (3.0, 2.0), (4.0, -5.0)] {
            polygons.extend(sides(dvec3(x, y, 2.0), dvec3(1.0, 1.5, 2.0), 0.3, false));
        }
        polygons
    };
    vec![
        ("panel of 200 m at 10 degrees", panel(10.0, 200.0), 1e-3),
        ("panel of 200 m at 20 degrees", panel(20.0, 200.0), 1e-3),
        ("panel of 200 m at 30 degrees", panel(30.0, 200.0), 3e-4),
        ("wedge of 12 degrees with a plate", wedge, 1e-3),
        ("4 rows of panels, 2 km", rows(4, 2000.0, 5.0, dvec3(1.7, 0.0, 1.0)), 1e-3),
        ("5 rows of walls, 2 km", rows(5, 2000.0, 3.0, DVec3::Z * 2.0), 1e-3),
        ("room with a box", room(&[block(0.45, 0.52, 0.2, 0.0)]), 3e-4),
        ("room with two turned boxes", room(&[block(0.3, 0.3, 0.15, 0.5), block(0.7, 0.65, 0.2, 0.2)]), 1e-3),
        ("plates with a slot of 0.1 between", opposed(1.0, 0.1), 1e-3),
        ("plates 0.2 apart with a slot of 0.02", opposed(0.2, 0.02), 1e-3),
        ("court with three blocks", court, 1e-3),
        (
            "room with a plate near a wall",
            room(&[vec![rectangle(dvec3(0.01, 0.2, 0.2), DVec3::Y * 0.6, DVec3::Z * 0.6)]]),
            1e-3,
        ),
    ]
}
