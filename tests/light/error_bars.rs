//! Error bars are as long as the errors.

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
/// 95 % of Student's t distribution with 15 degrees of freedom lie within this.
const T95: f64 = 2.131;
/// Two-sided quantile of Student's t with 11 degrees of freedom for a probability of 10⁻³ to be exceeded by chance.
const T11: f64 = 4.437;

/// Asserts that 95 % of the patches are within [`T95`] error bars of the truth. The patches of one seed share rays, so
/// the share varies more than a binomial one: its tolerance comes from its spread between seeds. Another 2 % is allowed
/// because error bars are an approximation: replicates are not normal and closure is not linear.
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

/// A cube of 192 patches whose ceiling emits, against exact form factors.
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
    // Light after 40 bounces of half the light each: what is left out is 10⁻¹² of it.
    let mut radiosity = patches.emission().to_vec();
    let mut truth = Vec::new();
    for _ in 0..40 {
        truth = shares.iter().map(|row| row.iter().zip(&radiosity).map(|(f, b)| f * b).sum()).collect();
        radiosity = (0..n).map(|i| patches.emission()[i] + patches.reflectance()[i] * truth[i]).collect();
    }
    calibrate("room", &room, 0.4, &radiosity, &truth);
}

/// Blocked and open pairs without a lamp, against 64 times as many rays, whose error adds less than 1 % to the
/// variance.
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

/// The light of a lamp that nothing blocks is known exactly. Closing rows that 64 rays have measured elsewhere leaves
/// it unchanged. So every black patch of a cube whose ceiling emits has the irradiance of Lambert's formula, within its
/// error bar and within 10⁻⁵, the least relative bar. The cube has whole triangles or small patches, and a tile in the
/// middle.
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
            // The tile blocks 10⁻⁸ of the light of the floor. Its back sees no lamp.
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

/// Compares the irradiance of all black patches with Lambert's formula. `lamps` gives the lamps that a point sees, and
/// their radiosity; patches that see none are left out. Returns the share of patches within [`T95`] error bars, and the
/// root mean squares of errors and of error bars, weighted by area, relative to the mean irradiance.
fn against_lambert<'a, L>(lit: &Cast, lamps: impl Fn(DVec3) -> L) -> [f64; 3]
where
    L: IntoIterator<Item = (&'a [DVec3], f64)>,
{
    let radiosity = lit.patches.emission();
    let irradiance = lit.form_factors.light(radiosity, radiosity, 1);
    let errors = standard_errors(&lit.form_factors, radiosity);
    let (mut within, mut many, mut off, mut estimated, mut light, mut area) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
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
        estimated += a * errors[i].powi(2);
        light += a * truth;
        area += a;
    }
    let relative = |squares: f64| (squares / area).sqrt() * area / light;
    [within / many, relative(off), relative(estimated)]
}

/// A lamp close above the floor of a black room. The few rays of a patch under it do not measure how much light passes
/// the lamp. Closure must not correct that sampling error by changing the lamp's light, which is known exactly: it
/// agrees with Lambert's formula within the error bars, which are at most 10⁻³.
#[test]
fn light_of_a_lamp_close_to_the_floor_is_known_to_its_bar() {
    let corners = [(0.3, 0.3), (0.3, 0.7), (0.7, 0.7), (0.7, 0.3)].map(|(x, y)| DVec3::new(x, y, 0.03));
    for rays in [64.0, 256.0] {
        let options = CastOptions::default().with_rays(rays);
        let lit = cast(low_lamp(), Subdivision::Count(1000), options);
        let [within, off, estimated] =
            against_lambert(&lit, |at| (at.z < 1e-9).then_some((&corners[..], 1.0)));
        println!("{rays} rays: {within:.3} within, error {off:.1e}, estimated {estimated:.1e}");
        assert!(
            within >= 0.95 && off <= 2.0 * estimated && estimated <= 1e-3,
            "{within}, {off:e}, {estimated:e}"
        );
    }
}

/// Most patches are wholly or largely behind most of these lamps, and a patch sends about three shadow rays to each
/// lamp. If none of these rays starts in front of the lamp, its light must still not be estimated as zero.
#[test]
fn light_of_lamps_that_hardly_rise_above_a_patch_is_known_to_its_bar() {
    const GAP: f64 = 0.1;
    let (u, v, w) = (DVec3::X, DVec3::Y, DVec3::Z);
    let beside = |along: DVec3, u: DVec3, v: DVec3| {
        let near = 0.35 * u + 0.42 * v + GAP * along;
        let far = near + (1.0 - 2.0 * GAP) * along;
        let (u, v) = (0.2 * u, 0.2 * v);
        // Counterclockwise as seen from the wall that each lamp lights.
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
        let [within, off, estimated] = against_lambert(&lit, seen);
        println!("{rays} rays: {within:.3} within, error {off:.1e}, estimated {estimated:.1e}");
        assert!(
            within >= 0.95 && off <= 2.0 * estimated && estimated <= 1e-3,
            "{within}, {off:e}, {estimated:e}"
        );
    }
}

/// A lamp above a floor in the open: light that does not reach the floor escapes. The few rays of a patch of the lamp
/// measure by chance that none or too much of it escapes. Closure must not correct that by changing the light that
/// arrives, which is known.
#[test]
fn light_of_a_lamp_in_the_open_is_known_to_its_bar() {
    let lamp = [(0.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, 0.0)].map(|(x, y)| DVec3::new(x, y, 0.1));
    let floor = black(rectangle(DVec3::ZERO, DVec3::X, DVec3::Y));
    let parts = [floor, part(rectangle(lamp[0], DVec3::Y, DVec3::X), 0.0, 1.0)];
    for (patches, rays) in [(256, 64.0), (4096, 64.0), (4096, 256.0)] {
        let options = CastOptions::default().with_rays(rays);
        let lit = cast(scene(&parts), Subdivision::Count(patches), options);
        let [within, off, estimated] = against_lambert(&lit, |_| Some((&lamp[..], 1.0)));
        println!(
            "{patches} patches, {rays} rays: {within:.3} within, error {off:.1e}, estimated {estimated:.1e}"
        );
        assert!(
            within >= 0.95 && off <= 2.0 * estimated && estimated <= 1e-3,
            "{within}, {off:e}, {estimated:e}"
        );
    }
}

/// Two closed rooms, each with a ceiling that emits, one ten thousand times as brightly. Nobody in the other room sees
/// the bright lamp, so its power must not draw the shadow rays of that room.
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
            let [within, off, estimated] =
                against_lambert(&lit, |at| is_there(at).then_some((&lamp[..], brightness)));
            println!("{name}, {rays} rays: {within:.3} within, error {off:.1e}, estimated {estimated:.1e}");
            assert!(
                within >= 0.95 && off <= 2.0 * estimated && estimated <= 1e-3,
                "{name} {within}, {off:e}, {estimated:e}"
            );
        }
    }
}

/// If everything emits alike, closing rows changes no light. There are more lamps than the number whose light is
/// computed exactly, and still the error bars are at most 10⁻⁴ and contain the true irradiance of 1.
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
