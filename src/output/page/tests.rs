//! What the file holds is read back as the viewer reads it.

use glam::dvec3;
use half::f16;
use serde_json::Value;

use super::*;
use crate::{
    Progress,
    form_factor::{CastOptions, FormFactors},
    patch::Subdivision,
    scene::{Material, Texture, TextureMap},
    solve::{Solution, SolveOptions, by_lamp::by_lamp, solve},
    trace::Tracer,
};

/// The numbers of an array of the page, as bytes, and its type.
fn array(page: &str, name: &str) -> (String, Vec<u8>) {
    let start = format!("id=\"data-{name}\" data-type=\"");
    let (_, rest) = page.split_once(&start).unwrap_or_else(|| panic!("no array {name}"));
    let (kind, rest) = rest.split_once("\">").unwrap();
    let text = rest.split_once("</script>").unwrap().0;
    let digit = |c: u8| match c {
        b'A'..=b'Z' => c - b'A',
        b'a'..=b'z' => c - b'a' + 26,
        b'0'..=b'9' => c - b'0' + 52,
        b'+' => 62,
        _ => 63,
    };
    let mut bytes = Vec::new();
    for group in text.as_bytes().chunks(4) {
        let given = group.iter().filter(|&&c| c != b'=').count();
        let bits = group.iter().fold(0u32, |bits, &c| bits << 6 | u32::from(digit(c) & 63));
        bytes.extend(&bits.to_be_bytes()[1..given]);
    }
    (kind.into(), bytes)
}

fn halves_of(page: &str, name: &str) -> Vec<f64> {
    let (kind, bytes) = array(page, name);
    assert_eq!(kind, "f16");
    bytes.as_chunks::<2>().0.iter().map(|&b| f16::from_le_bytes(b).to_f64()).collect()
}

fn whole_numbers(page: &str, name: &str) -> Vec<usize> {
    let (kind, bytes) = array(page, name);
    match &kind[..] {
        "u8" => bytes.iter().map(|&b| usize::from(b)).collect(),
        "u16" => bytes.as_chunks::<2>().0.iter().map(|&b| usize::from(u16::from_le_bytes(b))).collect(),
        _ => bytes.as_chunks::<4>().0.iter().map(|&b| u32::from_le_bytes(b) as usize).collect(),
    }
}

fn about(page: &str) -> Value {
    let text = page.split_once("id=\"about\">").unwrap().1.split_once("</script>").unwrap().0;
    serde_json::from_str(text).unwrap()
}

/// A floor with an image under a lamp, with names that would break out of a careless file.
fn scene() -> Scene {
    let floor = [dvec3(0., 0., 0.), dvec3(0., 0., 2.), dvec3(2., 0., 0.)];
    let lamp = [dvec3(0., 1., 0.), dvec3(1., 1., 0.), dvec3(0., 1., 1.)];
    let mut wood = Material::new("</script><script>alert(1)</script>", [0.8, 0.5, 0.4], [0.0; 3]);
    wood.reflectance_map = Some(TextureMap::new(0));
    let materials = vec![wood, Material::new("lamp & \"more\"", [0.1; 3], [30.0, 20.0, 10.0])];
    let mut scene = Scene::new(&[(floor, 0), (lamp, 1)], materials);
    scene.textures.push(Texture::new(2, 1, vec![255, 0, 0, 0, 0, 255]));
    let uv = |p: &glam::DVec3| glam::dvec2(p.x, p.z) * 0.5;
    scene.texcoords = [floor, lamp].map(|corners| corners.map(|p| uv(&p))).to_vec();
    scene
}

struct Solved {
    scene: Scene,
    patches: Patches,
    form_factors: FormFactors,
    solution: Solution,
    camera: Camera,
}

fn solved(scene: Scene) -> Solved {
    let (tracer, progress) = (Tracer::new(&scene), Progress::new());
    let mut patches = Patches::subdivide(&scene, &Subdivision::Count(60));
    let cast = CastOptions::default().with_rays(64.0);
    let form_factors = FormFactors::cast(&scene, &tracer, &mut patches, &cast, &progress).unwrap();
    let solution = solve(&form_factors, &patches, &SolveOptions::default(), &progress).unwrap();
    let camera = Camera::frame(&scene, &tracer, 64, 48).unwrap();
    Solved { scene, patches, form_factors, solution, camera }
}

fn page(solved: &Solved, methods: &[Method], options: &PageOptions) -> String {
    let mut out = Vec::new();
    encode(&mut out, &solved.scene, &solved.patches, &solved.camera, methods, options).unwrap();
    String::from_utf8(out).unwrap()
}

/// Half of the last of eleven binary digits.
const ROUNDING: f64 = 1.0 / 2048.0;

#[test]
fn values_of_patches_come_back_within_the_rounding_of_half_floats() {
    let solved = solved(scene());
    let Solved { scene, patches, solution, .. } = &solved;
    let error: Vec<f64> = solution.irradiance.iter().map(|e| 0.01 * e).collect();
    let change: Vec<f64> = solution.irradiance.iter().map(|e| -0.1 * e).collect();
    let options = PageOptions::default().with_title("a < b").with_discretisation(Some(&change));
    let methods = [Method::new("radiosity", solution).with_standard_error(Some(&error))];
    let page = page(&solved, &methods, &options);
    let about = about(&page);
    let unit = about["unit"].as_f64().unwrap();
    for (name, wanted) in [
        ("patch_light_0", &solution.irradiance[..]),
        ("error_0", &error),
        ("discretisation", &change),
        ("emission", patches.emission()),
    ] {
        let found = halves_of(&page, name);
        assert_eq!(found.len(), wanted.len());
        for (found, wanted) in found.iter().zip(wanted) {
            assert!((found * unit - wanted).abs() <= ROUNDING * wanted.abs() + unit * 3e-8, "{name}");
        }
    }
    // Emission lies in the table of materials as well, and the image of the floor in the page.
    let [r, g, b] = [0, 1, 2].map(|c| about["materials"][1]["emission"][c].as_f64().unwrap() * unit);
    for (found, wanted) in [(r, 30.0), (g, 20.0), (b, 10.0)] {
        assert!((found / (std::f64::consts::PI * wanted) - 1.0).abs() < 1e-12);
    }
    assert!(about["textures"][0].as_str().unwrap().starts_with("data:image/png;base64,"));
    assert_eq!(about["materials"][0]["name"], scene.materials[0].name);
    // Each array is whole, and each face of the floor has coordinates in its image.
    assert_eq!(whole_numbers(&page, "material").len(), patches.len());
    let mapped = whole_numbers(&page, "material").iter().filter(|&&m| m == 0).count();
    assert_eq!(array(&page, "reflectance_uv").1.len(), mapped * 3 * 2 * 4);
    // The page, its data, and nothing that a name has opened.
    assert_eq!(page.matches("<script").count(), page.matches("</script").count());
    assert!(page.contains("<title>a &lt; b</title>") && !page.contains("<script>alert"));
}

/// Position and normal of each patch, from the arrays, are those of the solution, and a request to anywhere appears nowhere.
#[test]
fn faces_lie_where_their_patches_are_and_face_the_same_way() {
    let solved = solved(scene());
    let Solved { scene, patches, solution, .. } = &solved;
    let page = page(&solved, &[Method::new("radiosity", solution)], &PageOptions::default());
    let about = about(&page);
    let radius = about["radius"].as_f64().unwrap();
    let origin = [0, 1, 2].map(|k| about["origin"][k].as_f64().unwrap());
    let bytes = array(&page, "positions").1;
    let places: Vec<f64> =
        bytes.as_chunks::<4>().0.iter().map(|&b| f64::from(f32::from_le_bytes(b))).collect();
    let place = |v: usize| DVec3::from_slice(&places[3 * v..]) * radius + DVec3::from(origin);
    let faces = whole_numbers(&page, "faces");
    assert_eq!(faces.len(), 3 * patches.len());
    for (i, face) in faces.chunks(3).enumerate() {
        let [a, b, c] = [0, 1, 2].map(|k| place(face[k]));
        let middle = (a + b + c) / 3.0;
        assert!((middle - patches.centroid(scene, i)).length() < 1e-6, "{i}");
        assert!((b - a).cross(c - a).normalize().dot(patches.normal(scene, i)) > 0.999, "{i}");
    }
    let policy =
        "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:";
    assert!(page.contains(policy));
}

#[test]
fn light_by_lamp_sums_to_the_whole() {
    let mut two = scene();
    two.materials.push(Material::new("second", [0.1; 3], [0.0, 0.0, 7.0]));
    let corners = [dvec3(1., 1., 0.), dvec3(2., 1., 0.), dvec3(1., 1., 1.)];
    let triangles: Vec<([DVec3; 3], u32)> =
        [0, 1].iter().map(|&t| (two.corners(t), two.triangles[t].material)).chain([(corners, 2)]).collect();
    let mut materials = two.materials.clone();
    materials[0].reflectance_map = None;
    let solved = solved(Scene::new(&triangles, materials));
    let Solved { scene, patches, form_factors, solution, .. } = &solved;
    let options = SolveOptions::default();
    let lamps = by_lamp(scene, (form_factors, patches), solution, 8, &options, &Progress::new()).unwrap();
    let page =
        page(&solved, &[Method::new("radiosity", solution).with_lamps(&lamps)], &PageOptions::default());
    let about = about(&page);
    assert_eq!(about["layers"][0]["name"], "lamp & \"more\"");
    assert_eq!(about["layers"][1]["emitters"], serde_json::json!([2]));
    let unit = about["unit"].as_f64().unwrap();
    let [a, b] = ["patch_light_0", "patch_light_1"].map(|name| halves_of(&page, name));
    for ((a, b), wanted) in a.iter().zip(&b).zip(&solution.irradiance) {
        assert!(((a + b) * unit - wanted).abs() <= ROUNDING * wanted + unit * 1e-7);
    }
    // Without maps the table of materials says all: no values for each patch.
    assert!(!page.contains("data-reflectance\""));
}

/// Bytes for each patch, without the scripts: 100,000 patches of a coloured scene with all error bars stay below 10 MB.
#[test]
fn a_hundred_thousand_patches_fit_into_ten_megabytes() {
    let floor = [dvec3(0., 0., 0.), dvec3(0., 0., 2.), dvec3(2., 0., 0.)];
    let material = Material::new("floor", [0.5, 0.4, 0.3], [1.0; 3]);
    let scene = Scene::new(&[(floor, 0)], vec![material]);
    let tracer = Tracer::new(&scene);
    let patches = Patches::subdivide(&scene, &Subdivision::Count(20_000));
    let light = vec![0.7; 3 * patches.len()];
    let camera = Camera::frame(&scene, &tracer, 64, 48).unwrap();
    let all = Light { radiosity: &light, irradiance: &light, slopes: &[] };
    let methods = [Method::new("radiosity", all).with_standard_error(Some(&light))];
    let options = PageOptions::default().with_discretisation(Some(&light));
    let mut out = Vec::new();
    encode(&mut out, &scene, &patches, &camera, &methods, &options).unwrap();
    let scripts = Kind::View.bytes();
    let each = (out.len() - scripts) as f64 / patches.len() as f64;
    assert!(scripts as f64 + 100_000.0 * each < COMFORTABLE as f64, "{each} bytes a patch");
    // What leaves room for single lamps is close to that.
    let room = lamps_that_fit(&patches);
    assert_eq!(room, LAMPS);
    let layer = 4.0 / 3.0 * 6.0 * 1.75;
    assert!((scripts as f64 + (each + 7.0 * layer) * patches.len() as f64) < COMFORTABLE as f64);
}
