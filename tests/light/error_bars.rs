//! Whether error bars are as long as errors.

use crate::common::*;
use glam::DVec3;
use radiosity::{
    Progress,
    accuracy::error_bars::ErrorBars,
    form_factor::{
        CastOptions, FormFactors,
        exact::{polygon_exchange_area, polygon_form_factor},
    },
    patch::{Patches, Subdivision},
    solve::{SolveOptions, solve},
    trace::Tracer,
};

const SEEDS: u64 = 12;
/// 95 % of a Student distribution with 15 degrees of freedom lie within.
const T95: f64 = 2.131;
/// Two-sided quantile for 11 degrees of freedom and a probability of 10⁻³ to be outside by chance.
const T11: f64 = 4.437;

/// The share of patches within [`T95`] error bars of the truth, seed by seed. The patches of one seed share rays, so
/// that the share varies more than a binomial one: what it may be off by is taken from its spread between seeds. That
/// the bars are an approximation (replicates are neither normal, nor is the closure linear) is allowed for by 2 %.
fn calibrate(name: &str, scene: &radiosity::Scene, edge: f64, radiosity: &[f64], truth: &[f64]) {
    let tracer = Tracer::new(scene);
    for estimator in BOTH {
        let mut shares = Vec::new();
        let mut squares = 0.0;
        for seed in 0..SEEDS {
            let mut patches = Patches::subdivide(scene, &Subdivision::Edge(edge));
            let options = CastOptions::default().with_rays(256.0).with_estimator(estimator).with_seed(seed);
            let f = FormFactors::cast(scene, &tracer, &mut patches, &options, &Progress::new()).unwrap();
            let irradiance = f.light(radiosity, radiosity, 1);
            let errors = standard_errors(&f, radiosity);
            let z: Vec<f64> = (0..f.len())
                .map(|i| (irradiance[i] - truth[i]) / errors[i])
                .filter(|z| !z.is_nan())
                .collect();
            assert!(z.len() >= f.len() * 9 / 10, "{name}: bars without length");
            shares.push(z.iter().filter(|z| z.abs() <= T95).count() as f64 / z.len() as f64);
            squares += z.iter().map(|z| z * z).sum::<f64>() / z.len() as f64;
        }
        let n = SEEDS as f64;
        let mean = shares.iter().sum::<f64>() / n;
        let variance = shares.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / (n - 1.0);
        let band = T11 * (variance / n).sqrt();
        println!("{name} {estimator:?}: {mean:.4} ± {band:.4}, RMS of z {:.3}", (squares / n).sqrt());
        assert!((mean - 0.95).abs() <= band + 0.02, "{name} {estimator:?}: {mean} within, band {band}");
    }
}

/// A shining wall of a cube of 192 patches, against exact form factors.
#[test]
fn bars_in_a_room() {
    let [x0, x1, y0, y1, floor, ceiling] = room_faces(DVec3::ZERO, DVec3::ONE);
    let room = scene(&[part([x0, x1, y0, y1, floor].concat(), 0.5, 0.0), part(ceiling, 0.5, 1.0)]);
    let patches = Patches::subdivide(&room, &Subdivision::Edge(0.4));
    let n = patches.len();
    let corners: Vec<Corners> = (0..n).map(|i| patches.corners(&room, i)).collect();
    let shares: Vec<Vec<f64>> = (0..n)
        .map(|i| (0..n).map(|j| polygon_exchange_area(&corners[i], &corners[j]) / patches.area(i)).collect())
        .collect();
    // The light of the room itself, after so many bounces that what is left out is 10⁻¹² of it.
    let mut radiosity = patches.emission().to_vec();
    let mut truth = Vec::new();
    for _ in 0..40 {
        truth = shares.iter().map(|row| row.iter().zip(&radiosity).map(|(f, b)| f * b).sum()).collect();
        radiosity = (0..n).map(|i| patches.emission()[i] + patches.reflectance()[i] * truth[i]).collect();
    }
    calibrate("room", &room, 0.4, &radiosity, &truth);
}

/// Occluded and open, no lamp: against 64 times the rays, which add less than 1 % to the variance.
#[test]
fn bars_with_an_occluder() {
    let parts = [
        black(level_square(1.0, 0.0, true)),
        black(level_square(1.0, 1.0, false)),
        black(level_square(0.5, 0.5, true)),
    ];
    let open = scene(&parts);
    let options = CastOptions::default().with_rays(16384.0).with_seed(1000);
    let reference = cast(open, Subdivision::Edge(0.2), options);
    let mut random = Random::new(2);
    let radiosity: Vec<f64> = (0..reference.patches.len()).map(|_| random.next()).collect();
    let truth = reference.form_factors.light(&radiosity, &radiosity, 1);
    calibrate("occluder", &reference.scene, 0.2, &radiosity, &truth);
}

/// What a lamp sends past nothing that blocks is known exactly, and closing rows that 64 rays have measured, elsewhere, leaves it
/// alone: every black patch of a cube whose ceiling shines has the light of Lambert's formula, within its bar. Whole triangles and
/// small patches, and a tile in the middle.
#[test]
fn unblocked_light_of_lamps_is_known_to_its_bar() {
    let [x0, x1, y0, y1, floor, ceiling] = room_faces(DVec3::ZERO, DVec3::ONE);
    let tile = rectangle(DVec3::splat(0.5), DVec3::X * 1e-4, DVec3::Y * 1e-4);
    let parts = [black([x0, x1, y0, y1, floor, tile].concat()), part(ceiling, 0.0, 1.0)];
    let above = [DVec3::Z, DVec3::new(0.0, 1.0, 1.0), DVec3::ONE, DVec3::new(1.0, 0.0, 1.0)];
    for subdivision in [Subdivision::Edge(f64::INFINITY), Subdivision::Count(300)] {
        let (mut off, mut of_bar) = (0f64, 0f64);
        for seed in 0..4 {
            let lit = cast(scene(&parts), subdivision, CastOptions::default().with_seed(seed));
            let radiosity = lit.patches.emission();
            let irradiance = lit.form_factors.light(radiosity, radiosity, 1);
            let errors = standard_errors(&lit.form_factors, radiosity);
            // The tile holds back a hundred millionth of what lights the floor; its back sees no lamp.
            for i in (0..lit.patches.fronts()).filter(|&i| radiosity[i] == 0.0) {
                let corners = lit.patches.corners(&lit.scene, i);
                let truth = polygon_form_factor(&corners, &above);
                off = off.max((irradiance[i] / truth - 1.0).abs());
                of_bar = of_bar.max((irradiance[i] - truth).abs() / errors[i]);
            }
        }
        println!("{subdivision:?}: off by {off:.1e}, {of_bar:.2} of a bar");
        assert!(of_bar <= 1.0 && off <= 1e-5, "{off:e}, {of_bar} bars");
    }
}

/// Off and told of the irradiance of all black patches that a scene's lamps light, against Lambert's formula: the lamps that each
/// patch sees, and their radiosity; patches that see none are left out. Returns the share within [`T95`] bars, and the root
/// mean squares of errors and of bars, weighted by area, over the mean irradiance.
fn against_lambert<'a, L>(lit: &Cast, lamps: impl Fn(DVec3) -> L) -> [f64; 3]
where
    L: IntoIterator<Item = (&'a [DVec3], f64)>,
{
    let radiosity = lit.patches.emission();
    let irradiance = lit.form_factors.light(radiosity, radiosity, 1);
    let errors = standard_errors(&lit.form_factors, radiosity);
    let (mut within, mut many, mut off, mut told, mut light, mut area) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for i in (0..lit.patches.fronts()).filter(|&i| radiosity[i] == 0.0) {
        let corners = lit.patches.corners(&lit.scene, i);
        let mut lamps = lamps((corners[0] + corners[1] + corners[2]) / 3.0).into_iter().peekable();
        if lamps.peek().is_none() {
            continue;
        }
        let truth: f64 =
            lamps.map(|(lamp, brightness)| brightness * polygon_form_factor(&corners, lamp)).sum();
        let a = lit.patches.area(i);
        within += f64::from(u8::from((irradiance[i] - truth).abs() <= T95 * errors[i]));
        many += 1.0;
        off += a * (irradiance[i] - truth).powi(2);
        told += a * errors[i].powi(2);
        light += a * truth;
        area += a;
    }
    let relative = |squares: f64| (squares / area).sqrt() * area / light;
    [within / many, relative(off), relative(told)]
}

/// Of a patch close under a lamp no ray tells where the light goes that passes the lamp by. That must not be made good from the
/// light of the lamp, which is known: in a black room all of it is.
#[test]
fn light_of_a_lamp_close_to_the_floor_is_known_to_its_bar() {
    let corners = [(0.3, 0.3), (0.3, 0.7), (0.7, 0.7), (0.7, 0.3)].map(|(x, y)| DVec3::new(x, y, 0.03));
    for rays in [64.0, 256.0] {
        let options = CastOptions::default().with_rays(rays);
        let lit = cast(low_lamp(), Subdivision::Count(1000), options);
        let [within, off, told] = against_lambert(&lit, |at| (at.z < 1e-9).then_some((&corners[..], 1.0)));
        println!("{rays} rays: {within:.3} within, {off:.1e} off, {told:.1e} told");
        assert!(within >= 0.95 && off <= 2.0 * told && told <= 1e-3, "{within}, {off:e}, {told:e}");
    }
}

/// Most patches are behind most of these lamps, or largely so, and a lamp gets three shadow rays of a patch or so: where none of them
/// left from what is before the lamp, its light is not none.
#[test]
fn light_of_lamps_that_hardly_rise_above_a_patch_is_known_to_its_bar() {
    const GAP: f64 = 0.1;
    let (u, v, w) = (DVec3::X, DVec3::Y, DVec3::Z);
    let beside = |along: DVec3, u: DVec3, v: DVec3| {
        let near = 0.35 * u + 0.42 * v + GAP * along;
        let far = near + (1.0 - 2.0 * GAP) * along;
        let (u, v) = (0.2 * u, 0.2 * v);
        // Counterclockwise as seen from the wall that each shines on.
        [[near, near + v, near + u + v, near + u], [far, far + u, far + u + v, far + v]]
    };
    let lamps = [beside(u, v, w), beside(v, w, u), beside(w, u, v)].concat();
    let mut parts = vec![black(room(DVec3::ZERO, DVec3::ONE))];
    parts.extend(lamps.iter().map(|&[a, b, _, d]| part(rectangle(a, b - a, d - a), 0.0, 1.0)));
    let on_wall = |at: DVec3| at.min_element() < 1e-9 || at.max_element() > 1.0 - 1e-9;
    let seen = |at: DVec3| lamps.iter().filter(move |_| on_wall(at)).map(|lamp| (&lamp[..], 1.0));
    for rays in [64.0, 256.0] {
        let options = CastOptions::default().with_rays(rays);
        let lit = cast(scene(&parts), Subdivision::Count(300), options);
        let [within, off, told] = against_lambert(&lit, seen);
        println!("{rays} rays: {within:.3} within, {off:.1e} off, {told:.1e} told");
        assert!(within >= 0.95 && off <= 2.0 * told && told <= 1e-3, "{within}, {off:e}, {told:e}");
    }
}

/// What of a lamp's light passes a floor by is what does not arrive there. Few rays of a patch of the lamp tell how much of its own
/// escapes, none or too much by chance, and that must not be made good from what arrives, which is known.
#[test]
fn light_of_a_lamp_in_the_open_is_known_to_its_bar() {
    let lamp = [(0.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, 0.0)].map(|(x, y)| DVec3::new(x, y, 0.1));
    let floor = black(rectangle(DVec3::ZERO, DVec3::X, DVec3::Y));
    let parts = [floor, part(rectangle(lamp[0], DVec3::Y, DVec3::X), 0.0, 1.0)];
    for (patches, rays) in [(256, 64.0), (4096, 64.0), (4096, 256.0)] {
        let options = CastOptions::default().with_rays(rays);
        let lit = cast(scene(&parts), Subdivision::Count(patches), options);
        let [within, off, told] = against_lambert(&lit, |_| Some((&lamp[..], 1.0)));
        println!("{patches} patches, {rays} rays: {within:.3} within, {off:.1e} off, {told:.1e} told");
        assert!(within >= 0.95 && off <= 2.0 * told && told <= 1e-3, "{within}, {off:e}, {told:e}");
    }
}

/// Two closed rooms, a ceiling in each, of which one shines ten thousand times as brightly: its power must not draw all shadow rays
/// of the other room, where nobody sees it.
#[test]
fn light_of_a_dim_lamp_is_known_to_its_bar() {
    let side = |x: f64| DVec3::new(x, 0.0, 0.0);
    let mut parts = Vec::new();
    for (x, brightness) in [(0.0, 1.0), (1.5, 1e4)] {
        let [x0, x1, y0, y1, floor, ceiling] = room_faces(side(x), side(x) + DVec3::ONE);
        parts.extend([black([x0, x1, y0, y1, floor].concat()), part(ceiling, 0.0, brightness)]);
    }
    let above =
        |x: f64| [(0.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, 0.0)].map(|(u, v)| DVec3::new(x + u, v, 1.0));
    let (dim, bright) = (above(0.0), above(1.5));
    for rays in [64.0, 256.0] {
        let options = CastOptions::default().with_rays(rays);
        let lit = cast(scene(&parts), Subdivision::Count(600), options);
        for (name, first, lamp, brightness) in [("dim", 0.0, &dim, 1.0), ("bright", 1.5, &bright, 1e4)] {
            let is_there = |at: DVec3| (first - 0.1..first + 1.1).contains(&at.x);
            let [within, off, told] =
                against_lambert(&lit, |at| is_there(at).then_some((&lamp[..], brightness)));
            println!("{name}, {rays} rays: {within:.3} within, {off:.1e} off, {told:.1e} told");
            assert!(
                within >= 0.95 && off <= 2.0 * told && told <= 1e-3,
                "{name} {within}, {off:e}, {told:e}"
            );
        }
    }
}

/// Where everything shines alike, rows that are moved to sum to one change nothing; there are more lamps than are known by themselves.
#[test]
fn bars_of_light_that_is_the_same_everywhere_are_short() {
    let lit = cast(load("furnace"), Subdivision::Count(500), CastOptions::default());
    let solution =
        solve(&lit.form_factors, &lit.patches, &SolveOptions::default(), &Progress::new()).unwrap();
    let bars = ErrorBars::of(&lit.form_factors, &lit.patches, &solution).unwrap();
    for (irradiance, error) in solution.irradiance.iter().zip(&bars.standard_error) {
        assert!((irradiance - 1.0).abs() <= *error && *error <= 1e-4, "{irradiance} +- {error}");
    }
}
