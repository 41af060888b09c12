//! Tests of reciprocity, energy conservation, and samplers against their densities.

use std::f64::consts::{FRAC_PI_2, PI};

use super::*;
use crate::{
    scene::{Distribution, Fresnel, Material, Scene, Shadowing, Specular},
    trace::sampling::mix,
};

const BLACK: [f64; 3] = [0.0; 3];
const WHITE: [f64; 3] = [1.0; 3];

/// Pseudo-random number `k` in \[0, 1).
fn random(k: u64) -> f64 {
    (mix(&[k, 5]) >> 11) as f64 * 2f64.powi(-53)
}

fn direction(k: u64) -> DVec3 {
    // Cosines down to 10⁻³.
    spherical(1e-3 + 0.999 * random(2 * k), 2.0 * PI * random(2 * k + 1))
}

fn facets(distribution: Distribution, alpha: f64, shadowing: Shadowing) -> Lobe {
    Lobe::Microfacet(Microfacet::new(distribution, [alpha; 2], Fresnel::Constant(WHITE), shadowing))
}

fn phong(exponent: f64) -> Lobe {
    Lobe::of(&Specular::Phong { reflectance: WHITE, exponent }, BLACK)
}

fn blinn_phong(exponent: f64) -> Lobe {
    Lobe::of(&Specular::BlinnPhong { reflectance: WHITE, exponent }, BLACK)
}

fn ward(ax: f64, ay: f64) -> Lobe {
    Lobe::of(&Specular::Ward { reflectance: WHITE, alpha: [ax, ay] }, BLACK)
}

/// Gold at 650, 550 and 450 nm.
const GOLD: Fresnel = Fresnel::Conductor { eta: [0.143, 0.375, 1.442], kappa: [3.983, 2.386, 1.603] };

fn facets_of(distribution: Distribution, alpha: f64) -> Specular {
    Specular::Microfacet {
        distribution,
        alpha: [alpha; 2],
        fresnel: GOLD,
        shadowing: Shadowing::HeightCorrelated,
    }
}

/// Lobes of each kind, smooth and rough, with every Fresnel term.
fn lobes() -> Vec<(&'static str, Lobe)> {
    use Distribution::{Beckmann, Ggx};
    use Shadowing::{HeightCorrelated, Separable};
    let of = |distribution, alpha, fresnel| {
        Lobe::Microfacet(Microfacet::new(distribution, alpha, fresnel, HeightCorrelated))
    };
    vec![
        ("Phong 0", phong(0.0)),
        ("Phong 10", phong(10.0)),
        ("Phong 100", phong(100.0)),
        ("Blinn-Phong 10", blinn_phong(10.0)),
        ("Blinn-Phong 100", blinn_phong(100.0)),
        ("Ward 0.2", ward(0.2, 0.2)),
        ("Ward 0.1, 0.4", ward(0.1, 0.4)),
        ("Beckmann 0.5", facets(Beckmann, 0.5, Separable)),
        ("Beckmann 0.1, 0.3, gold", of(Beckmann, [0.1, 0.3], GOLD)),
        ("GGX 0.1", facets(Ggx, 0.1, Separable)),
        ("GGX 1", facets(Ggx, 1.0, HeightCorrelated)),
        ("GGX 0.4, 0.15, Schlick", of(Ggx, [0.4, 0.15], Fresnel::Schlick([0.04, 0.5, 0.9]))),
    ]
}

/// ∫ f cos θi dωi by the midpoint rule over the angles of the hemisphere. It uses no sampler.
fn integrated(brdf: &impl Brdf, wo: DVec3, n: u32) -> DVec3 {
    let step = FRAC_PI_2 / f64::from(n);
    let mut sum = DVec3::ZERO;
    for i in 0..n {
        let (sin, cos) = ((f64::from(i) + 0.5) * step).sin_cos();
        for k in 0..2 * n {
            let wi = spherical(cos, (f64::from(k) + 0.5) * 2.0 * step);
            sum += brdf.evaluate(wo, wi) * (sin * cos * 2.0 * step * step);
        }
    }
    sum
}

/// The expected values come from an independent quadrature of the formulas in double precision, at 0, 30, 60, 80 and 85
/// degrees. For separable shadowing, Mitsuba 3.9.1's `roughconductor` agrees (±0.0003 by a million samples).
#[test]
fn directional_albedos_are_those_of_the_literature() {
    use Distribution::{Beckmann, Ggx};
    use Shadowing::{HeightCorrelated, Separable};
    let table = [
        (phong(10.0), [1.00000, 0.86603, 0.50474, 0.22806, 0.17127]),
        (phong(100.0), [1.00000, 0.86603, 0.50000, 0.17523, 0.09761]),
        (blinn_phong(10.0), [1.00000, 0.80464, 0.40032, 0.17633, 0.13488]),
        (ward(0.1, 0.1), [0.99000, 0.98829, 0.97396, 0.86742, 0.81277]),
        (ward(0.2, 0.2), [0.96000, 0.95265, 0.89758, 0.79942, 0.80551]),
        (ward(0.5, 0.5), [0.75457, 0.73395, 0.70825, 0.76543, 0.82508]),
        (facets(Beckmann, 0.1, Separable), [1.00000, 1.00000, 0.99985, 0.93781, 0.91227]),
        (facets(Beckmann, 0.5, Separable), [0.94300, 0.90279, 0.86894, 0.91839, 0.93924]),
        (facets(Beckmann, 0.5, HeightCorrelated), [0.94300, 0.90279, 0.86936, 0.92902, 0.96014]),
        (facets(Ggx, 0.1, Separable), [0.98830, 0.98608, 0.96912, 0.89197, 0.87313]),
        (facets(Ggx, 0.5, Separable), [0.68785, 0.68165, 0.68601, 0.74690, 0.77720]),
        (facets(Ggx, 0.5, HeightCorrelated), [0.68785, 0.68305, 0.69825, 0.80532, 0.87202]),
        (facets(Ggx, 1.0, Separable), [0.30685, 0.32888, 0.40914, 0.52290, 0.56451]),
        (facets(Ggx, 1.0, HeightCorrelated), [0.30685, 0.33519, 0.45069, 0.66819, 0.78005]),
    ];
    for (lobe, wanted) in table {
        for (degrees, wanted) in [0.0f64, 30.0, 60.0, 80.0, 85.0].into_iter().zip(wanted) {
            let wo = spherical(degrees.to_radians().cos(), 0.3);
            let found = integrated(&lobe, wo, 400);
            assert!((found.x - wanted).abs() < 1e-4, "{lobe:?} at {degrees}: {found}, not {wanted}");
            // The quadrature that scenes use, with directions sampled from the lobe.
            let by_lobe = directional_albedo(&lobe, wo);
            assert!((by_lobe.x - wanted).abs() < 2e-3, "{lobe:?} at {degrees}: {by_lobe}, not {wanted}");
        }
    }
}

#[test]
fn light_can_go_both_ways() {
    for (name, lobe) in lobes() {
        for k in 0..20_000 {
            let (a, b) = (direction(2 * k), direction(2 * k + 1));
            let (there, back) = (lobe.evaluate(a, b), lobe.evaluate(b, a));
            let off = (there - back).abs().max_element();
            // Opposite grazing directions almost cancel in the half vector, which is down to 10⁻³ of its terms.
            assert!(off <= 1e-11 * there.max_element(), "{name}: {there} and {back} at {a} {b}");
            assert!(there.min_element() >= 0.0 && there.is_finite());
        }
    }
}

#[test]
fn no_lobe_reflects_more_than_it_gets() {
    for (name, lobe) in lobes() {
        for k in 0..8 {
            let wo = spherical(0.02 + 0.14 * k as f64, 2.0 * PI * random(k));
            let albedo = integrated(&lobe, wo, 160).max_element();
            assert!(albedo < 1.0 + 1e-3, "{name} at {wo}: {albedo}");
        }
    }
}

/// Compares the number of samples in cells of the hemisphere, and below the surface, with the integral of the density.
/// Returns χ² as a number of standard deviations above its expectation.
fn chi_square(brdf: &impl Brdf, wo: DVec3) -> f64 {
    const ROWS: usize = 16;
    const COLUMNS: usize = 32;
    const SAMPLES: u64 = 1 << 17;
    // Rows are evenly spaced in the angle from the normal.
    let cell = |w: DVec3| {
        let row = (w.z.clamp(0.0, 1.0).acos() / FRAC_PI_2 * ROWS as f64) as usize;
        let azimuth = w.y.atan2(w.x).rem_euclid(2.0 * PI);
        let column = (azimuth / (2.0 * PI) * COLUMNS as f64) as usize;
        row.min(ROWS - 1) * COLUMNS + column.min(COLUMNS - 1)
    };
    let mut counts = vec![0.0; ROWS * COLUMNS + 1];
    for k in 0..SAMPLES {
        let u = [random(1000 + 2 * k), random(1001 + 2 * k)];
        counts[brdf.sample(wo, u).map_or(ROWS * COLUMNS, cell)] += 1.0;
    }
    const FINE: usize = 24;
    let (rise, turn) = (FRAC_PI_2 / (ROWS * FINE) as f64, 2.0 * PI / (COLUMNS * FINE) as f64);
    let mut expected = vec![0.0; ROWS * COLUMNS + 1];
    for i in 0..ROWS * FINE {
        let (sin, cos) = ((i as f64 + 0.5) * rise).sin_cos();
        for k in 0..COLUMNS * FINE {
            let wi = spherical(cos, (k as f64 + 0.5) * turn);
            expected[i / FINE * COLUMNS + k / FINE] +=
                brdf.density(wo, wi) * sin * rise * turn * SAMPLES as f64;
        }
    }
    expected[ROWS * COLUMNS] = SAMPLES as f64 - expected.iter().sum::<f64>();
    // All cells with an expectation below 10 are merged into one.
    let (mut chi, mut degrees) = (0.0, -1.0);
    let mut rest = [0.0, 0.0];
    for (count, expected) in counts.iter().zip(&expected) {
        if *expected < 10.0 {
            rest = [rest[0] + count, rest[1] + expected];
        } else {
            chi += (count - expected).powi(2) / expected;
            degrees += 1.0;
        }
    }
    if rest[1] >= 10.0 {
        chi += (rest[0] - rest[1]).powi(2) / rest[1];
        degrees += 1.0;
    } else {
        assert!(rest[0] < 40.0, "{} samples where {} are expected", rest[0], rest[1]);
    }
    (chi - degrees) / f64::sqrt(2.0 * degrees)
}

#[test]
fn samples_follow_their_density() {
    let lambert = Lambert { reflectance: DVec3::ONE };
    assert!(chi_square(&lambert, DVec3::Z) < 5.0);
    for (name, lobe) in lobes() {
        for (degrees, azimuth) in [(0.0f64, 0.0), (35.0, 0.7), (75.0, 4.0)] {
            let z = chi_square(&lobe, spherical(degrees.to_radians().cos(), azimuth));
            assert!(z < 5.0, "{name} at {degrees} degrees: {z} standard deviations too far");
        }
    }
}

#[test]
fn a_density_of_another_roughness_is_found_out() {
    struct Wrong(Lobe, Lobe);
    impl Brdf for Wrong {
        fn evaluate(&self, wo: DVec3, wi: DVec3) -> DVec3 {
            self.0.evaluate(wo, wi)
        }
        fn sample(&self, wo: DVec3, u: [f64; 2]) -> Option<DVec3> {
            self.0.sample(wo, u)
        }
        fn density(&self, wo: DVec3, wi: DVec3) -> f64 {
            self.1.density(wo, wi)
        }
    }
    let wrong = Wrong(ward(0.2, 0.2), ward(0.21, 0.2));
    assert!(chi_square(&wrong, spherical(0.8, 0.7)) > 10.0);
}

#[test]
fn gold_is_yellow_and_metals_reflect_all_at_grazing_angles() {
    // The reflectance at normal incidence is ((n - 1)² + k²)/((n + 1)² + k²).
    let wanted = [0.143f64, 0.375, 1.442].into_iter().zip([3.983f64, 2.386, 1.603]);
    let found = GOLD.reflectance(1.0);
    for (c, (n, k)) in wanted.enumerate() {
        let above = ((n - 1.0).powi(2) + k * k) / ((n + 1.0).powi(2) + k * k);
        assert!((found[c] - above).abs() < 1e-12);
    }
    assert!(found.x > found.y && found.y > found.z);
    assert!((GOLD.reflectance(0.0) - DVec3::ONE).abs().max_element() < 1e-12);
    // Glass has no absorption. At Brewster's angle only one polarisation, half of the light, is reflected.
    let glass = Fresnel::Conductor { eta: [1.5; 3], kappa: [0.0; 3] };
    assert!((glass.reflectance(1.0).x - 0.04).abs() < 1e-12);
    let brewster = 1.5f64.atan().cos();
    let across = ((1.5f64.powi(2) - 1.0) / (1.5f64.powi(2) + 1.0)).powi(2);
    assert!((glass.reflectance(brewster).x - 0.5 * across).abs() < 1e-12);
    let schlick = Fresnel::Schlick([0.04; 3]);
    assert!((schlick.reflectance(1.0).x - 0.04).abs() < 1e-12 && schlick.reflectance(0.0).x == 1.0);
}

fn plate(material: Material) -> Scene {
    Scene::new(&[([DVec3::ZERO, DVec3::X, DVec3::Y], 0)], vec![material])
}

fn with(specular: Specular, reflectance: [f64; 3]) -> Material {
    Material { specular: Some(Box::new(specular)), ..Material::new("gloss", reflectance, [0.0; 3]) }
}

/// A plate of one material.
struct Plate {
    scene: Scene,
    surfaces: Surfaces,
}

impl Plate {
    fn new(material: Material) -> Plate {
        let scene = plate(material);
        Plate { surfaces: Surfaces::of(&scene), scene }
    }

    /// The surface of the plate for light to or from a direction in scene coordinates.
    fn seen_from(&self, wo: DVec3) -> Surface<'_> {
        let tracer = crate::trace::Tracer::new(&self.scene);
        let origin = tracer.to_unit(DVec3::new(0.25, 0.25, 0.0)) + 0.1 * wo.as_vec3a();
        let hit = tracer.closest(origin, -wo.as_vec3a()).unwrap();
        Surface::met(&self.surfaces, &self.scene, &tracer.triangles()[0], &hit, -wo.as_vec3a())
    }

    /// ∫ f cos θ dω by the midpoint rule.
    fn albedo(&self, wo: DVec3) -> DVec3 {
        const N: u32 = 320;
        let (surface, step) = (self.seen_from(wo), FRAC_PI_2 / f64::from(N));
        let mut sum = DVec3::ZERO;
        for i in 0..N {
            let (sin, cos) = ((f64::from(i) + 0.5) * step).sin_cos();
            for k in 0..2 * N {
                let wi = spherical(cos, (f64::from(k) + 0.5) * 2.0 * step);
                sum += surface.towards(wi.as_vec3a()).0 * (sin * 2.0 * step * step);
            }
        }
        sum
    }
}

#[test]
fn a_white_base_under_a_dielectric_reflects_all_and_no_more() {
    for roughness in [0.3, 0.5, 1.0] {
        let specular = Specular::MetallicRoughness { metallic: 0.0, roughness, anisotropy: 0.0 };
        let [white, grey] = [1.0, 0.5].map(|base| Plate::new(with(specular.clone(), [base; 3])));
        for degrees in [0.0f64, 30.0, 60.0, 80.0, 85.0] {
            let wo = spherical(degrees.to_radians().cos(), 0.0);
            // The specification's own mix reaches 1.08 to 1.45 here.
            let albedo = white.albedo(wo).x;
            assert!((albedo - 1.0).abs() < 3e-3, "roughness {roughness} at {degrees}: {albedo}");
            let half = grey.albedo(wo).x;
            assert!(half > 0.5 && half < 1.0, "{half}");
        }
    }
    // A brushed metal and a half-metal do not exceed 1 either.
    for (metallic, anisotropy) in [(1.0, 0.8), (0.5, 0.5), (0.0, 1.0)] {
        let specular = Specular::MetallicRoughness { metallic, roughness: 0.5, anisotropy };
        let plate = Plate::new(with(specular, [1.0, 0.7, 0.2]));
        for k in 0..5 {
            let albedo = plate.albedo(spherical(0.05 + 0.9 * random(k), 6.0 * random(k + 50)));
            assert!(albedo.max_element() < 1.003, "metallic {metallic}: {albedo}");
        }
    }
}

#[test]
fn surfaces_of_both_parts_are_reciprocal_and_sampled_by_their_density() {
    let specular = [
        Specular::MetallicRoughness { metallic: 0.3, roughness: 0.4, anisotropy: 0.5 },
        Specular::Phong { reflectance: [0.3; 3], exponent: 20.0 },
        facets_of(Distribution::Beckmann, 0.3),
    ];
    for specular in specular {
        let plate = Plate::new(with(specular, [0.6, 0.5, 0.4]));
        for k in 0..20 {
            let (a, b) = (direction(2 * k), direction(2 * k + 1));
            let there = plate.seen_from(a).brdf(b.as_vec3a());
            let back = plate.seen_from(b).brdf(a.as_vec3a());
            // Directions are in single precision here.
            assert!((there - back).abs().max_element() < 1e-4 * there.max_element(), "{there} {back}");
        }
        // The mean weight of samples is the albedo.
        let wo = spherical(0.6, 0.4);
        let surface = plate.seen_from(wo);
        let weights: Vec<f64> = (0..1 << 16)
            .map(|k| {
                let bounce = surface.sample(&mut crate::monte_carlo::Samples::new(k, 3));
                bounce.map_or(0.0, |b| {
                    let (value, density) = surface.towards(b.direction);
                    assert!((density - b.density).abs() < 1e-3 * density, "{density} {}", b.density);
                    assert!((value / density - b.weight).abs().max_element() < 1e-3);
                    b.weight.x
                })
            })
            .collect();
        let n = weights.len() as f64;
        let mean = weights.iter().sum::<f64>() / n;
        let error = (weights.iter().map(|w| (w - mean).powi(2)).sum::<f64>() / n / n).sqrt();
        let albedo = plate.albedo(wo).x;
        assert!((mean - albedo).abs() < 4.0 * error + 1e-4 && error < 2e-3, "{mean} ± {error}, {albedo}");
    }
}

#[test]
fn parts_that_add_up_to_more_than_one_are_scaled_with_a_warning() {
    let phong = |ks: f64| Specular::Phong { reflectance: [ks, 0.1, 0.1], exponent: 10.0 };
    let plate = Plate::new(with(phong(0.5), [0.8, 0.3, 0.3]));
    let [warning] = plate.surfaces.warnings() else { panic!("{:?}", plate.surfaces.warnings()) };
    assert!(warning.contains("`gloss`") && warning.contains("1.300"), "{warning}");
    let albedo = plate.albedo(DVec3::Z);
    assert!((albedo - DVec3::new(1.3, 0.4, 0.4) / 1.3).abs().max_element() < 1e-3, "{albedo}");
    assert!(Plate::new(with(phong(0.2), [0.8, 0.3, 0.3])).surfaces.warnings().is_empty());
}

fn flattened(scene: &Scene, part: SpecularPart) -> Scene {
    let mut flat = scene.clone();
    make_lambertian(&mut flat, part);
    flat
}

#[test]
fn lambertian_stand_ins_have_the_same_hemispherical_albedo() {
    let specular = [
        Specular::MetallicRoughness { metallic: 0.3, roughness: 0.4, anisotropy: 0.0 },
        Specular::MetallicRoughness { metallic: 1.0, roughness: 0.6, anisotropy: 0.0 },
        Specular::Phong { reflectance: [0.6; 3], exponent: 20.0 },
        Specular::Ward { reflectance: [0.3; 3], alpha: [0.3; 2] },
        facets_of(Distribution::Ggx, 0.5),
    ];
    for specular in specular {
        let plate = Plate::new(with(specular.clone(), [0.6, 0.5, 0.4]));
        let mut wanted = DVec3::ZERO;
        const RINGS: u32 = 16;
        for k in 0..RINGS {
            let cos = ((f64::from(k) + 0.5) / f64::from(RINGS)).sqrt();
            wanted += plate.albedo(spherical(cos, 0.2)) / f64::from(RINGS);
        }
        let flat = flattened(&plate.scene, SpecularPart::Diffuse);
        let found = DVec3::from(flat.materials[0].reflectance);
        assert!(!flat.has_specular());
        assert!((found - wanted).abs().max_element() < 4e-3, "{specular:?}: {found}, not {wanted}");
        let dropped = flattened(&plate.scene, SpecularPart::Drop);
        assert_eq!(dropped.materials[0].reflectance, [0.6, 0.5, 0.4]);
    }
    let mirror = with(Specular::Mirror(Fresnel::Constant([0.7, 0.5, 0.2])), [0.1; 3]);
    let flat = flattened(&plate(mirror), SpecularPart::Diffuse).materials[0].reflectance;
    assert!((DVec3::from(flat) - DVec3::new(0.8, 0.6, 0.3)).abs().max_element() < 1e-12, "{flat:?}");
}
