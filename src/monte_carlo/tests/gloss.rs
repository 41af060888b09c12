//! Tests with scenes that are not Lambertian.

use super::*;
use crate::{
    Progress,
    scene::{Distribution, Fresnel, Shadowing, Specular},
    trace::Tracer,
};
use std::f64::consts::PI;

const LOSSLESS: Specular = Specular::Mirror(Fresnel::Constant([1.0; 3]));

fn glossy(name: &str, reflectance: [f64; 3], specular: Specular) -> Material {
    Material { specular: Some(Box::new(specular)), ..Material::new(name, reflectance, [0.0; 3]) }
}

/// The coloured room with a block and a wall of the given materials.
fn glossy_room(block: Material, wall: Material) -> Scene {
    let mut scene = room(true);
    // The left wall is the first two triangles. The block comes after the ten triangles of the open room's walls.
    for (t, triangle) in scene.triangles.iter_mut().enumerate() {
        match t {
            0 | 1 => triangle.material = 5,
            10..22 => triangle.material = 4,
            _ => {}
        }
    }
    scene.materials.extend([block, wall]);
    scene
}

fn rooms() -> Vec<Scene> {
    let shadowing = Shadowing::HeightCorrelated;
    let ggx =
        |alpha, fresnel| Specular::Microfacet { distribution: Distribution::Ggx, alpha, fresnel, shadowing };
    let schlick = Fresnel::Schlick([0.9, 0.6, 0.3]);
    vec![
        glossy_room(
            glossy("mirror", [0.1; 3], Specular::Mirror(Fresnel::Constant([0.8; 3]))),
            glossy("phong", [0.3, 0.2, 0.1], Specular::Phong { reflectance: [0.5; 3], exponent: 15.0 }),
        ),
        glossy_room(
            glossy("metal", [0.0; 3], ggx([0.3, 0.15], schlick)),
            glossy("ward", [0.4; 3], Specular::Ward { reflectance: [0.4; 3], alpha: [0.15, 0.3] }),
        ),
        glossy_room(
            glossy(
                "plastic",
                [0.7, 0.3, 0.2],
                Specular::MetallicRoughness { metallic: 0.2, roughness: 0.4, anisotropy: 0.0 },
            ),
            glossy("blinn", [0.3; 3], Specular::BlinnPhong { reflectance: [0.6; 3], exponent: 30.0 }),
        ),
    ]
}

#[test]
fn furnace_with_lossless_surfaces() {
    // The walls have Le = 1 - ρ. A box inside reflects all light and emits none. So radiance is 1 everywhere. A white
    // base under a dielectric is lossless to the accuracy of its table.
    let lossless = [
        (LOSSLESS, [0.0; 3], 1e-6),
        (Specular::MetallicRoughness { metallic: 0.0, roughness: 0.5, anisotropy: 0.0 }, [1.0; 3], 2e-3),
    ];
    for (specular, reflectance, off) in lossless {
        let mut faces = box_walls(DVec3::ZERO, dvec3(3.0, 2.0, 2.5), true);
        let inner = box_walls(dvec3(0.5, 0.4, 0.6), dvec3(1.4, 1.2, 1.3), false);
        faces.extend(inner.into_iter().map(|(corners, _)| (corners, 1)));
        let materials = vec![
            Material::new("wall", [0.6, 0.5, 0.2], [0.4, 0.5, 0.8]),
            glossy("box", reflectance, specular),
        ];
        let scene = Scene::new(&faces, materials);
        let tracer = Tracer::new(&scene);
        let places = [0, 12, 17].map(|t| Receiver::on_triangle(&tracer, t, [0.3, 0.3, 0.4], true));
        for options in [PLAIN, NEXT_EVENT] {
            let paths = PathTracer::new(&scene, &tracer, options);
            let effort = Effort { samples: 1 << 14, replicates: 32, seed: 5 };
            for e in paths.irradiances(&places, &effort, &Progress::new()).unwrap() {
                for c in 0..3 {
                    let (mean, se) = (e.mean[c] / PI, e.standard_error[c] / PI);
                    assert!((mean - 1.0).abs() < 4.0 * se + off && se < 4e-3, "{mean} ± {se}");
                }
            }
        }
        let options = LightOptions { particles: 1 << 18, ..Default::default() };
        let light = LightTracer::new(&scene, &tracer, options)
            .trace(1, |hit| (hit.triangle >= 12 && hit.front).then_some(0), &Progress::new())
            .unwrap();
        let area: f64 = (12..24).map(|t| scene.area(t)).sum();
        let e = light.bins[0].scaled(1.0 / (PI * area));
        assert!((e.mean[0] - 1.0).abs() < 4.0 * e.standard_error[0] + off, "{e:?}");
        assert!(e.standard_error[0] < 5e-3, "{e:?}");
    }
}

#[test]
fn a_mirror_doubles_a_room() {
    // A room that is symmetric about x = 0, and its right half with a mirror at x = 0.
    let whole = {
        let mut faces = box_walls(dvec3(-2.0, 0.0, 0.0), dvec3(2.0, 2.0, 3.0), true);
        for x in [-1.4, 0.8] {
            let (a, b) = (x, x + 0.6);
            let lamp = [dvec3(a, 1.9, 1.), dvec3(b, 1.9, 1.), dvec3(b, 1.9, 1.6), dvec3(a, 1.9, 1.6)];
            faces.extend(quad(lamp, 1));
        }
        faces
    };
    let half = {
        let mut faces = box_walls(DVec3::ZERO, dvec3(2.0, 2.0, 3.0), true);
        // The wall at x = 0.
        faces[0].1 = 2;
        faces[1].1 = 2;
        faces.extend(quad(
            [dvec3(0.8, 1.9, 1.), dvec3(1.4, 1.9, 1.), dvec3(1.4, 1.9, 1.6), dvec3(0.8, 1.9, 1.6)],
            1,
        ));
        faces
    };
    let materials = vec![
        Material::new("wall", [0.7, 0.5, 0.3], [0.0; 3]),
        Material::new("lamp", [0.0; 3], [9.0, 8.0, 7.0]),
        glossy("mirror", [0.0; 3], LOSSLESS),
    ];
    let points = [
        (dvec3(0.2, 0.0, 1.0), DVec3::Y),
        (dvec3(1.5, 0.0, 2.2), DVec3::Y),
        (dvec3(2.0, 0.9, 1.1), DVec3::NEG_X),
        (dvec3(0.6, 1.2, 3.0), DVec3::NEG_Z),
    ];
    let [whole, half] = [whole, half].map(|faces| {
        let scene = Scene::new(&faces, materials.clone());
        let tracer = Tracer::new(&scene);
        let places = points.map(|(p, n)| Receiver::free(&tracer, p, n));
        let effort = Effort { samples: 1 << 15, replicates: 32, seed: 2 };
        let paths = PathTracer::new(&scene, &tracer, NEXT_EVENT);
        paths.irradiances(&places, &effort, &Progress::new()).unwrap()
    });
    for (a, b) in whole.iter().zip(&half) {
        assert!(apart(a, b) < 4.0 && b.standard_error[0] < 0.02 * b.mean[0], "{a:?} {b:?}");
    }
}

#[test]
fn paths_and_particles_agree_on_gloss() {
    for (k, scene) in rooms().iter().enumerate() {
        let tracer = Tracer::new(scene);
        let (n, progress) = (scene.triangles.len(), Progress::new());
        let effort = Effort { samples: 1 << 13, replicates: 32, seed: 4 };
        let by = |options| {
            let paths = PathTracer::new(scene, &tracer, options);
            paths.mean_irradiances(&all_sides(scene)[..n], &effort, &progress).unwrap()
        };
        let (plain, next) = (by(PLAIN), by(NEXT_EVENT));
        let options = LightOptions { particles: 1 << 19, seed: 8, ..Default::default() };
        let front = |hit: &crate::trace::Hit| hit.front.then_some(hit.triangle as usize);
        let light = LightTracer::new(scene, &tracer, options).trace(n, front, &progress).unwrap();
        let (mut squares, mut compared) = (0.0, 0);
        for i in 0..n {
            let flux = light.bins[i].scaled(1.0 / scene.area(i));
            assert!(apart(&plain[i], &next[i]) < 5.0, "room {k}, {i}: {:?} {:?}", plain[i], next[i]);
            assert!(apart(&flux, &next[i]) < 5.0, "room {k}, {i}: {flux:?} {:?}", next[i]);
            if next[i].mean[0] > 0.0 {
                assert!(next[i].standard_error[0] < 0.1 * next[i].mean[0], "{i}: {:?}", next[i]);
                let se = flux.standard_error[0].hypot(next[i].standard_error[0]);
                squares += ((flux.mean[0] - next[i].mean[0]) / se).powi(2);
                compared += 1;
            }
        }
        let chi = squares / f64::from(compared);
        assert!(
            compared >= 20 && (0.4..2.0).contains(&chi),
            "room {k}: {chi} of the squared standard errors"
        );
        let power: f64 = light.emitted.mean[0];
        let rest = power - light.absorbed.mean[0] - light.escaped.mean[0];
        assert!(rest.abs() < 1e-9 * power, "{rest}");
    }
}

#[test]
fn pictures_of_gloss_by_paths_and_by_particles_agree() {
    // Light tracing cannot show reflections in mirrors, so the room with the mirror is left out. Bright glints are
    // rare, so the spread is measured from many renders.
    for scene in &rooms()[1..] {
        let tracer = Tracer::new(scene);
        let camera = Camera::new(dvec3(1.8, 1.6, 9.0), dvec3(2.1, 1.4, 2.0), DVec3::Y, 35.0, 24, 20).unwrap();
        let progress = Progress::new();
        let options = LightOptions { particles: 1 << 20, ..Default::default() };
        let light = LightTracer::new(scene, &tracer, options).image(&camera, &progress).unwrap();
        let paths = PathTracer::new(scene, &tracer, NEXT_EVENT);
        let renders: Vec<Film> = (0..16)
            .map(|seed| {
                Film::render(&paths, &camera, &RenderOptions { samples: 64, seed }, &progress).unwrap()
            })
            .collect();
        for block in 0..16 {
            let inside = |i: usize| i % 24 / 6 == block % 4 && i / 24 / 5 == block / 4;
            let mean = |film: &Film| {
                let chosen = film.pixels().iter().enumerate().filter(|(i, _)| inside(*i));
                chosen.fold([0.0; 3], |sum: [f64; 3], (_, p)| {
                    std::array::from_fn(|c| sum[c] + f64::from(p[c]) / 30.0)
                })
            };
            let by_paths = Estimate::of(&renders.iter().map(mean).collect::<Vec<_>>());
            let squares =
                light.standard_error.pixels().iter().enumerate().filter(|(i, _)| inside(*i)).fold(
                    [0.0; 3],
                    |sum: [f64; 3], (_, s)| {
                        std::array::from_fn(|c| sum[c] + (f64::from(s[c]) / 30.0).powi(2))
                    },
                );
            let by_light = Estimate { mean: mean(&light.film), standard_error: squares.map(f64::sqrt) };
            assert!(by_paths.standard_error[0] < 0.1 * by_paths.mean[0], "{block}: {by_paths:?}");
            assert!(apart(&by_paths, &by_light) < 5.0, "{block}: {by_paths:?} {by_light:?}");
        }
    }
}

#[test]
fn looking_at_lamps_pays_off_on_gloss_too() {
    let scene = &rooms()[1];
    let tracer = Tracer::new(scene);
    let at = Receiver::on_triangle(&tracer, 4, [0.3, 0.3, 0.4], true);
    let spread = |options| {
        let effort = Effort { samples: 1 << 14, replicates: 32, seed: 7 };
        PathTracer::new(scene, &tracer, options).irradiances(&[at], &effort, &Progress::new()).unwrap()[0]
    };
    let (plain, next) = (spread(PLAIN), spread(NEXT_EVENT));
    assert!(apart(&plain, &next) < 4.0);
    assert!(next.standard_error[0] < 0.5 * plain.standard_error[0], "{plain:?} {next:?}");
}
