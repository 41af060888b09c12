//! The light that is lost when glossy materials are treated as Lambertian, against closed forms.

use std::f64::consts::PI;

use glam::{DVec3, dvec3};
use radiosity::{
    Progress, Scene,
    accuracy::lambert::{LambertCost, LambertOptions},
    form_factor::exact::point_to_polygon,
    patch::{Patches, Subdivision},
    scene::{Fresnel, Material, Specular},
    trace::Tracer,
};

use crate::common::{flipped, rectangle};

fn glossy(name: &str, reflectance: f64, specular: Specular) -> Material {
    let mut material = Material::new(name, [reflectance; 3], [0.0; 3]);
    material.specular = Some(Box::new(specular));
    material
}

/// A black speck of floor under a lamp, beside a mirror in which the speck sees the whole lamp. Without the mirror the
/// speck loses π L k F, where F is the form factor of the lamp's image and k the reflectance of the mirror. The
/// tolerance is four standard errors plus 1 %, because F changes by less than 1 % over the speck.
#[test]
fn the_light_of_a_mirror_is_what_is_lost_without_it() {
    let lamp = rectangle(dvec3(0.0, 1.5, 0.0), DVec3::X, DVec3::Z * 0.6);
    let mirror = rectangle(dvec3(-1.0, 0.0, -4.0), DVec3::Y * 3.0, DVec3::Z * 8.0);
    let speck = flipped(rectangle(dvec3(0.5, 0.0, 0.3), DVec3::X * 0.01, DVec3::Z * 0.01));
    let mut triangles = Vec::new();
    for (part, material) in [(&speck, 0), (&lamp, 1), (&mirror, 2)] {
        triangles.extend(part.iter().map(|&t| (t, material)));
    }
    let ks = [0.9, 0.5, 0.1];
    let materials = vec![
        Material::new("black", [0.0; 3], [0.0; 3]),
        Material::new("lamp", [0.0; 3], [2.0, 1.0, 0.5]),
        glossy("mirror", 0.0, Specular::Mirror(Fresnel::Constant(ks))),
    ];
    let scene = Scene::new(&triangles, materials);
    assert!(scene.normal(0).y > 0.0 && scene.normal(2).y < 0.0);
    let tracer = Tracer::new(&scene);
    let patches = Patches::subdivide(&scene, &Subdivision::Edge(f64::INFINITY));
    let options = LambertOptions::default().with_paths(1 << 16).with_particles(1 << 16);
    let cost = LambertCost::of(&scene, &tracer, &patches, &options, &Progress::new()).unwrap();
    let [a, b, c, d] = [(-2.0, 0.0), (-3.0, 0.0), (-3.0, 0.6), (-2.0, 0.6)].map(|(x, z)| dvec3(x, 1.5, z));
    let image = point_to_polygon(dvec3(0.505, 0.0, 0.305), DVec3::Y, &[d, c, b, a]);
    let change = &cost.dropped.irradiance[0];
    for c in 0..3 {
        let wanted = PI * [2.0, 1.0, 0.5][c] * ks[c] * image;
        let (mean, error) = (change.mean[c], change.standard_error[c]);
        assert!((mean - wanted).abs() < 4.0 * error + 0.01 * wanted, "{mean} ± {error}, not {wanted}");
        assert!(error < 0.05 * wanted);
        // The mirror reflects its light away, and some of it meets speck and lamp, which are black.
        assert!(cost.dropped.absorbed.mean[c] < 0.0);
        let moved = cost.dropped.absorbed.mean[c] + cost.dropped.escaped.mean[c];
        assert!(moved.abs() < 1e-9 * cost.dropped.escaped.mean[c].abs());
    }
    assert_eq!(cost.glossy, 1);
}

/// The glossy lobe of the lamp reflects nothing, but one bounce in twenty samples it. So the paths differ and their
/// means do not: the reported root mean square of the change must be zero within four standard errors.
#[test]
fn noise_alone_is_no_change() {
    let walls = crate::common::room(DVec3::ZERO, DVec3::ONE);
    let mut triangles: Vec<_> = walls.iter().map(|&t| (t, 0)).collect();
    triangles[0].1 = 1;
    let black = Specular::Phong { reflectance: [0.0; 3], exponent: 1.0 };
    let materials = vec![glossy("wall", 0.5, black), Material::new("lamp", [0.5; 3], [1.0; 3])];
    let scene = Scene::new(&triangles, materials);
    let tracer = Tracer::new(&scene);
    let patches = Patches::subdivide(&scene, &Subdivision::Count(100));
    let options = LambertOptions::default().with_paths(256).with_particles(1 << 12);
    let cost = LambertCost::of(&scene, &tracer, &patches, &options, &Progress::new()).unwrap();
    assert!(cost.matched.irradiance.iter().any(|e| e.standard_error[0] > 0.0));
    let (rms, error) = (cost.matched.rms_relative, cost.matched.standard_error);
    assert!(rms < 4.0 * error && error < 0.05, "{rms} ± {error}");
}
