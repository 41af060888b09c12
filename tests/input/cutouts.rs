//! Cut-outs: transparent texels are holes.

use std::collections::HashMap;

use crate::common::save_png;
use radiosity::{Error, Scene};
use tempfile::TempDir;

/// A scene of one square of side 4 with texture coordinates from 0 to 1, and a material with these statements.
fn square(statements: &str) -> (TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("s.obj");
    let text = "mtllib s.mtl\nv 0 0 0\nv 4 0 0\nv 4 4 0\nv 0 4 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3 4/4\n";
    std::fs::write(&path, text).unwrap();
    std::fs::write(folder.path().join("s.mtl"), format!("newmtl m\n{statements}")).unwrap();
    (folder, path)
}

/// An image that is opaque where `solid` is true.
fn image(folder: &TempDir, name: &str, side: u32, solid: impl Fn(u32, u32) -> bool) {
    let texel = |x, y| image::Rgba([200, 100, 50, if solid(x, y) { 128 } else { 127 }]);
    save_png(&image::RgbaImage::from_fn(side, side, texel), folder.path().join(name));
}

fn load(statements: &str, side: u32, solid: impl Fn(u32, u32) -> bool) -> Result<Scene, Error> {
    let (folder, path) = square(statements);
    image(&folder, "a.png", side, solid);
    Scene::load(path)
}

fn area(scene: &Scene) -> f64 {
    (0..scene.triangles.len()).map(|t| scene.area(t)).sum()
}

/// The length of the edges that only one triangle has: the outline of the remaining surface.
fn outline(scene: &Scene) -> f64 {
    let mut edges: HashMap<[u32; 2], u32> = HashMap::new();
    for [a, b, c] in scene.triangles.iter().map(|t| t.vertices) {
        for [p, q] in [[a, b], [b, c], [c, a]] {
            *edges.entry([p.min(q), p.max(q)]).or_default() += 1;
        }
    }
    let length = |[p, q]: [u32; 2]| scene.vertices[p as usize].distance(scene.vertices[q as usize]);
    edges.into_iter().filter(|&(_, n)| n == 1).map(|(edge, _)| length(edge)).sum()
}

/// The opaque area and the length of its outline, for `side` by `side` texels on the square.
fn of_texels(side: i64, solid: impl Fn(i64, i64) -> bool) -> (f64, f64) {
    let texel = 4.0 / side as f64;
    let is = |x: i64, y: i64| (0..side).contains(&x) && (0..side).contains(&y) && solid(x, y);
    let all = || (0..side).flat_map(|x| (0..side).map(move |y| (x, y))).filter(|&(x, y)| is(x, y));
    let rims = |(x, y)| {
        [(x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)].into_iter().filter(|&(x, y)| !is(x, y)).count()
    };
    (all().count() as f64 * texel * texel, all().map(rims).sum::<usize>() as f64 * texel)
}

/// The remaining surface has exactly the area and the outline of the opaque texels, so no crack lies between its
/// pieces. It keeps its texture coordinates.
#[test]
fn holes_are_cut_along_texels() {
    type Solid = fn(u32, u32) -> bool;
    let patterns: [(&str, u32, Solid); 6] = [
        ("bars", 8, |x, _| x % 4 < 2),
        ("checkerboard", 8, |x, y| (x + y) % 2 == 0),
        ("one hole", 5, |x, y| (x, y) != (2, 2)),
        ("one texel", 7, |x, y| (x, y) == (5, 1)),
        ("noise", 16, |x, y| (x * 7919 + y * 104729 + x * y * 31) % 5 < 3),
        ("frame", 6, |x, y| x == 0 || y == 0 || x == 5 || y == 5),
    ];
    for (name, side, solid) in patterns {
        for (repeat, scale) in [(1, "map_Kd a.png\n"), (3, "map_Kd -s 3 3 a.png\n")] {
            let scene = load(scale, side, solid).unwrap();
            let many = i64::from(side * repeat);
            // Rows of the image run down, and v runs up. The last repetition is at the top.
            let at = |x: i64, y: i64| solid(x as u32 % side, y as u32 % side);
            let (right, rim) = of_texels(many, at);
            assert!((area(&scene) - right).abs() < 1e-9, "{name} {repeat}: {} for {right}", area(&scene));
            assert!((outline(&scene) - rim).abs() < 1e-6, "{name} {repeat}: {} for {rim}", outline(&scene));
            for t in 0..scene.triangles.len() {
                assert!(scene.normal(t).z > 0.999);
                for (corner, uv) in scene.corners(t).into_iter().zip(scene.texcoords[t]) {
                    assert!((corner.truncate() / 4.0 - uv).length() < 1e-9);
                }
            }
        }
    }
}

/// Holes emit nothing: the power is that of the opaque texels.
#[test]
fn holes_emit_nothing() {
    let scene = load("Kd 0 0 0\nKe 2 2 2\nmap_d a.png\n", 8, |x, y| x < 3 && y > 1).unwrap();
    let power: f64 =
        (0..scene.triangles.len()).map(|t| scene.area(t) * scene.emission_at(t, [1.0, 0.0, 0.0])[0]).sum();
    assert!((power - 2.0 * 18.0 * 0.25).abs() < 1e-9, "{power}");
}

/// Transparent texels do not count in the reflectance of the remaining surface.
#[test]
fn transparent_texels_are_no_albedo() {
    let (folder, path) = square("map_Kd a.png\n");
    let texel = |x, _| if x < 1 { image::Rgba([255, 255, 255, 255]) } else { image::Rgba([0, 0, 0, 0]) };
    save_png(&image::RgbaImage::from_fn(3, 2, texel), folder.path().join("a.png"));
    let scene = Scene::load(path).unwrap();
    let whole = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    for t in 0..scene.triangles.len() {
        assert!(scene.mean_reflectance(t, &whole).iter().all(|r| (r - 1.0).abs() < 1e-9));
    }
    assert!((area(&scene) - 16.0 / 3.0).abs() < 1e-9);
}

/// A mask may be black and white or have an alpha channel. `d` also makes holes.
#[test]
fn masks_and_dissolve() {
    let (folder, path) = square("map_d a.png\n");
    let mask = image::GrayImage::from_fn(4, 1, |x, _| image::Luma([if x < 3 { 200 } else { 90 }]));
    save_png(&mask, folder.path().join("a.png"));
    assert!((area(&Scene::load(&path).unwrap()) - 12.0).abs() < 1e-9);
    // Opaque everywhere.
    let whole = load("map_Kd a.png\n", 4, |_, _| true).unwrap();
    assert_eq!((whole.triangles.len(), whole.warnings.len()), (2, 0));
    // A half-transparent surface is opaque, with a warning.
    let glass = load("Kd 0 0 0\nd 0.1\n", 1, |_, _| true).unwrap();
    assert!(glass.triangles.len() == 2 && glass.warnings[0].contains("transparency"), "{:?}", glass.warnings);
    for (statements, solid) in [("Kd 0 0 0\nd 0\n", true), ("map_Kd a.png\n", false)] {
        let error = load(statements, 4, |_, _| solid).unwrap_err();
        assert!(error.to_string().contains("no face is left but holes"), "{error}");
    }
}

/// A scene with too many holes is refused before it takes all memory. The error names the material.
#[test]
fn endless_holes_are_refused() {
    let error = load("map_Kd -s 5000 5000 a.png\n", 8, |x, y| (x + y) % 2 == 0).unwrap_err();
    assert!(error.to_string().contains("material `m`") && error.hint().is_some(), "{error}");
}

#[test]
fn materials_can_be_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("s.obj");
    let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 90\nvt 0 0\nvt 1 1\nusemtl a\nf 1/1 2/1 3/1\nusemtl b\nf 1/2 2/2 4/2\n";
    std::fs::write(&path, text).unwrap();
    let mut scene = Scene::load(path).unwrap();
    assert_eq!((scene.leave_out("c"), scene.leave_out("b"), scene.leave_out("b")), (0, 1, 0));
    assert_eq!((scene.triangles.len(), scene.vertices.len(), scene.texcoords.len()), (1, 3, 1));
    assert_eq!(scene.area(0), 0.5);
}
