//! A solved scene as one HTML file that opens in any browser: to walk through, and to read.
//!
//! The file holds its viewer and all numbers. It needs no server, and makes no request to anywhere. The viewer is written in
//! JavaScript with three.js (`web/src`); the program embeds what `web/build.sh` makes of it.
//!
//! Light and errors are half floats over a common unit, a power of two. Irradiance at vertices shades the picture, as in
//! [`picture`](super::picture); irradiance of patches is what a click reads.

pub mod chart;
pub(crate) mod document;
pub(crate) mod materials;
pub(crate) mod numbers;
pub(crate) mod place;
pub mod reports;

use std::io::{self, Write};

use glam::DVec3;
use serde_json::{Value, json};

use self::{
    document::{Array, Kind, Values},
    numbers::{halves, unit_of},
    place::Ball,
};
use super::{
    exposure, vertex_colors,
    vertices::{CREASE, PatchMesh},
};
use crate::{
    monte_carlo::Camera,
    patch::Patches,
    scene::Scene,
    solve::{Light, by_lamp::LampLight},
    tone::Exposure,
};

/// A page larger than this takes long to open.
pub const LARGE: u64 = 50_000_000;
/// A page is kept below this size, in bytes, by leaving out the light of single lamps.
pub const COMFORTABLE: usize = 10_000_000;
/// The most lamps that have a slider each, unless more are asked for.
pub const LAMPS: usize = 8;

/// The light that one method found.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Method<'a> {
    /// Its name, for example `radiosity`.
    pub name: &'a str,
    /// Irradiance of all patches; NaN where the method has no value.
    pub light: Light<'a>,
    /// The same in parts that sum to it, if it is known by lamp.
    pub lamps: &'a [LampLight],
    /// Standard error of irradiance, if it is known; interleaved channels.
    pub standard_error: Option<&'a [f64]>,
}

setters!(Method<'a> {
    with_lamps(lamps: &'a [LampLight]),
    with_standard_error(standard_error: Option<&'a [f64]>),
});

impl<'a> Method<'a> {
    /// Light without error bars and without parts.
    pub fn new(name: &'a str, light: impl Into<Light<'a>>) -> Self {
        Method { name, light: light.into(), lamps: &[], standard_error: None }
    }
}

/// What may be chosen.
#[derive(Debug, Clone, Default)]
#[non_exhaustive]
pub struct PageOptions<'a> {
    /// The title.
    pub title: &'a str,
    /// Estimated error of the irradiance of the first method from the size of patches; interleaved channels.
    pub discretisation: Option<&'a [f64]>,
    /// How bright the first picture is; by [`exposure::of_radiosity`] where `None`.
    pub exposure: Option<Exposure>,
    /// Sentences about the solution.
    pub notes: Vec<String>,
}

setters!(PageOptions<'a> {
    with_title(title: &'a str),
    with_discretisation(discretisation: Option<&'a [f64]>),
    with_exposure(exposure: Option<Exposure>),
    with_notes(notes: Vec<String>),
});

/// How many lamps may have light of their own in a page of these patches that stays [`COMFORTABLE`].
pub fn lamps_that_fit(patches: &Patches) -> usize {
    let channels = patches.channels() as f64;
    // Vertices for each patch: half of one inside a surface, more where surfaces end.
    const VERTICES: f64 = 0.75;
    let base64 = |bytes: f64| bytes * 4.0 / 3.0;
    let layer = base64(2.0 * channels * (1.0 + VERTICES));
    // Faces, materials, triangles and sides; the standard and the discretisation error; positions.
    let rest = base64(12.0 + 2.0 + 4.0 + 1.0 + 4.0 * channels + 12.0 * VERTICES);
    let left = COMFORTABLE as f64 - Kind::View.bytes() as f64 - rest * patches.len() as f64;
    (left / (layer * patches.len() as f64)).clamp(0.0, LAMPS as f64) as usize
}

/// Writes a page of the light on patches, found by one or more methods, to `out`, which should be buffered.
///
/// # Errors
/// Errors of writing to `out`.
///
/// # Panics
/// When there is no method, or when the sizes disagree.
pub fn encode(
    out: &mut dyn Write,
    scene: &Scene,
    patches: &Patches,
    camera: &Camera,
    methods: &[Method],
    options: &PageOptions,
) -> io::Result<()> {
    let values = patches.channels() * patches.len();
    let known = methods.iter().flat_map(|m| [Some(m.light.irradiance), m.standard_error]);
    for values_of in known.chain([options.discretisation]).flatten() {
        assert_eq!(values_of.len(), values, "sizes disagree");
    }
    let mesh = PatchMesh::new(scene, patches, CREASE);
    let lit = methods.iter().flat_map(|m| m.light.irradiance).chain(patches.emission());
    let unit = unit_of(lit.copied());
    let ball = Ball::around(&scene.vertices);
    let mut arrays = mesh_arrays(scene, patches, &mesh, &ball);
    let mut layers: Vec<Value> = Vec::new();
    let mut listed: Vec<Value> = Vec::new();
    for (m, method) in methods.iter().enumerate() {
        let first = layers.len();
        let all: Vec<u32> = (0..scene.materials.len() as u32).collect();
        let mut layer = |name: &str, materials: &[u32], light: Light| {
            let at_vertices = vertex_colors::irradiance(scene, patches, &mesh, light);
            let k = layers.len();
            let positive: Vec<f64> = at_vertices.iter().map(|&e| if e < 0.0 { 0.0 } else { e }).collect();
            arrays.push((format!("vertex_light_{k}"), Values::F16(halves(&positive, unit))));
            arrays.push((format!("patch_light_{k}"), Values::F16(halves(light.irradiance, unit))));
            layers.push(json!({"name": name, "emitters": materials}));
        };
        match method.lamps {
            [] => layer(method.name, &all, method.light),
            lamps => lamps.iter().for_each(|lamp| {
                let light = Light { radiosity: &[], irradiance: &lamp.irradiance, slopes: &lamp.slopes };
                layer(&lamp.name, &lamp.materials, light);
            }),
        }
        if let Some(error) = method.standard_error {
            arrays.push((format!("error_{m}"), Values::F16(halves(error, unit))));
        }
        listed.push(json!({"name": method.name, "layers": (first..layers.len()).collect::<Vec<_>>()}));
    }
    if let Some(change) = options.discretisation {
        arrays.push(("discretisation".into(), Values::F16(halves(change, unit))));
    }
    if materials::vary(scene) {
        arrays.push(("reflectance".into(), Values::F16(halves(patches.reflectance(), 1.0))));
        arrays.push(("emission".into(), Values::F16(halves(patches.emission(), unit))));
    }
    let exposure =
        options.exposure.unwrap_or_else(|| exposure::of_radiosity(patches, methods[0].light.radiosity));
    let mut about = about((scene, camera), options, (unit, exposure), &ball, &mut arrays)?;
    about["kind"] = "patches".into();
    about["channels"] = patches.channels().into();
    about["methods"] = listed.into();
    about["layers"] = layers.into();
    document::write(out, Kind::View, options.title, &about, &arrays)
}

/// What every page of a scene says: its title, units, exposure, materials, camera and sky. Adds the texels of the sky to `arrays`.
pub(crate) fn about(
    (scene, camera): (&Scene, &Camera),
    options: &PageOptions,
    (unit, exposure): (f64, Exposure),
    ball: &Ball,
    arrays: &mut Vec<Array>,
) -> io::Result<Value> {
    let sky = place::sky(scene, unit).map(|(sky, texels)| {
        arrays.push(("sky".into(), texels));
        sky
    });
    let (materials, textures) = materials::materials(scene, unit)?;
    Ok(json!({
        "version": env!("CARGO_PKG_VERSION"), "title": options.title, "notes": options.notes,
        "units": scene.units.names(), "unit": unit, "white": exposure.white(),
        "origin": ball.centre.to_array(), "radius": ball.radius, "camera": place::camera(camera),
        "up": camera.up().to_array(), "materials": materials, "textures": textures, "sky": sky,
    }))
}

/// Positions, faces, and what each patch is a part of.
fn mesh_arrays(scene: &Scene, patches: &Patches, mesh: &PatchMesh, ball: &Ball) -> Vec<Array> {
    let faces: Vec<u32> = (0..mesh.faces()).flat_map(|f| mesh.face(f)).collect();
    let all = 0..patches.len();
    let material = |i: usize| scene.triangles[patches.triangle(i)].material;
    let mut arrays = vec![
        ("positions".into(), Values::F32(ball.place(mesh.positions()))),
        ("faces".into(), Values::indices(faces)),
        ("material".into(), Values::indices(all.clone().map(material).collect())),
        (
            "triangle".into(),
            Values::indices(all.clone().map(|i| scene.triangles[patches.triangle(i)].source).collect()),
        ),
        ("flags".into(), Values::U8(all.map(|i| flags(patches, i)).collect())),
    ];
    if mesh.has_pieces() {
        let patch_of = (0..mesh.faces()).map(|f| mesh.patch(f).0 as u32).collect();
        arrays.push(("patch_of".into(), Values::indices(patch_of)));
    }
    let mapped: Vec<usize> = (0..mesh.faces())
        .filter(|&f| materials::has_map(scene.material(patches.triangle(mesh.patch(f).0))))
        .collect();
    if !mapped.is_empty() {
        let of = |&f: &usize| {
            let t = patches.triangle(mesh.patch(f).0);
            let place = |v: u32| barycentric(scene.corners(t), mesh.positions()[v as usize]);
            materials::coordinates(scene, t, mesh.face(f).map(place))
        };
        arrays.extend(materials::coordinate_arrays(&mapped.iter().map(of).collect::<Vec<_>>()));
    }
    arrays
}

/// 1 on a back; 2 where the other side of the surface has a patch too.
fn flags(patches: &Patches, i: usize) -> u8 {
    match patches.is_front(i) {
        true => 2 * u8::from(patches.back_of(i).is_some()),
        false => 3,
    }
}

/// Barycentric coordinates of a point of a triangle.
fn barycentric([a, b, c]: [DVec3; 3], p: DVec3) -> [f64; 3] {
    let (u, v, w) = (b - a, c - a, p - a);
    let n = u.cross(v);
    let square = n.length_squared();
    let (second, third) = (w.cross(v).dot(n) / square, u.cross(w).dot(n) / square);
    [1.0 - second - third, second, third]
}

#[cfg(test)]
mod tests;
