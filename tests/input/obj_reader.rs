//! The OBJ reader on good, odd and broken files.

use std::path::Path;

use crate::common::save_png;

use glam::{DVec2, DVec3};
use radiosity::{
    Error, Scene,
    scene::{
        LoadOptions,
        surfaces::{By, Side, Surfaces},
    },
};
use tempfile::TempDir;

const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n";

struct Folder(TempDir);

impl Folder {
    fn new() -> Self {
        Folder(tempfile::tempdir().unwrap())
    }

    fn with(self, name: &str, contents: impl AsRef<[u8]>) -> Self {
        let path = self.0.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, contents).unwrap();
        self
    }

    fn image(self, name: &str, width: u32, rgb: &[[u8; 3]]) -> Self {
        let height = rgb.len() as u32 / width;
        let pixels = image::RgbImage::from_raw(width, height, rgb.concat()).unwrap();
        let path = self.0.path().join(name);
        if name.ends_with(".bmp") {
            let mut file = std::fs::File::create(path).unwrap();
            pixels.write_with_encoder(image::codecs::bmp::BmpEncoder::new(&mut file)).unwrap();
        } else {
            save_png(&pixels, path);
        }
        self
    }

    fn try_load(&self) -> Result<Scene, Error> {
        // The faces of a test are often the same.
        let options = LoadOptions::default().with_keep_overlaps(true);
        Scene::load_with(self.0.path().join("s.obj"), &options)
    }

    fn load(&self) -> Scene {
        self.try_load().unwrap()
    }

    /// The text of the error without the folder.
    fn error(&self) -> String {
        let error = self.try_load().expect_err("should be refused");
        assert!(matches!(error, Error::Input { .. }), "{error:?}");
        error.to_string().replace(&format!("{}/", self.0.path().display()), "")
    }
}

fn obj(text: &str) -> Folder {
    Folder::new().with("s.obj", text)
}

/// One textured triangle whose material has these statements.
fn material(statements: &str) -> Folder {
    obj(&format!("mtllib s.mtl\n{TRIANGLE}usemtl m\nf 1/1 2/2 3/3\n"))
        .with("s.mtl", format!("newmtl m\n{statements}\n"))
}

fn reflectance(folder: &Folder) -> [f64; 3] {
    folder.load().materials[0].reflectance
}

fn count(scene: &Scene, part: &str) -> usize {
    scene.warnings.iter().filter(|w| w.contains(part)).count()
}

#[test]
fn bad_lines_are_named() {
    for (text, wanted) in [
        ("v 0 0 0\nv 1 nan 0\n", "s.obj:2: vertex coordinate `nan` is not finite"),
        ("v 0 0 0\nv 1 1e999 0\n", "s.obj:2: vertex coordinate `1e999` is not finite"),
        ("v 0 0 0\nv 1 x 0\n", "s.obj:2: vertex coordinate `x` is not a number"),
        ("#\n\nv 0 0\n", "s.obj:3: vertex without z"),
        ("vt 1 a\n", "s.obj:1: texture coordinate `a` is not a number"),
        ("v 0 0 0\nf 1 1 2\n", "s.obj:2: face corner `2`: vertex 2 does not exist, the file has 1"),
        ("v 0 0 0\nf 1 1 0\n", "s.obj:2: face corner `0`: vertex 0 does not exist: vertices count from 1"),
        (
            "v 0 0 0\nf -2 1 1\nv 1 1 1\n",
            "s.obj:2: face corner `-2`: vertex -2 does not exist, 1 came before",
        ),
        ("v 0 0 0\nf 1 \\\n 1 \\\n y\n", "s.obj:2: face corner `y` is not an index"),
        ("v 0 0 0\nf 1 1 /1\n", "s.obj:2: face corner `/1` is not an index"),
        (
            "v 0 0 0\nf 1 1 99999999999999999999\n",
            "s.obj:2: face corner `99999999999999999999` is not an index",
        ),
        ("v 0 0 0\nl 1 1\np 1\n", "s.obj: no faces"),
        ("", "s.obj: no faces"),
        ("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "s.obj: every face has zero area"),
    ] {
        assert_eq!(obj(text).error(), wanted, "{text:?}");
    }
}

#[test]
fn bad_materials_are_named() {
    for (statements, wanted) in [
        ("Ka 0\nKd 0.5 1.5 0", "s.mtl:3: material `m`: reflectance 1.5 is outside 0..1"),
        ("Kd -0.1", "s.mtl:2: material `m`: reflectance -0.1 is outside 0..1"),
        ("Kd 0.5 NaN 0.5", "s.mtl:2: material `m`: reflectance NaN is outside 0..1"),
        ("Kd 0.5\nKe 0 -1 0", "s.mtl:3: material `m`: radiance -1.0 is not a number from 0 to 1e100"),
        ("Ke 0 1e308 0", "s.mtl:2: material `m`: radiance 1e308 is not a number from 0 to 1e100"),
        ("Ke inf 0 0", "s.mtl:2: material `m`: radiance inf is not a number from 0 to 1e100"),
        ("Kd 0.5 0.5", "s.mtl:2: Kd needs three numbers, not `0.5 0.5`"),
        ("Kd 0.5 red 0.5", "s.mtl:2: Kd needs three numbers, not `red`"),
    ] {
        assert_eq!(material(statements).error(), wanted, "{statements:?}");
    }
    let unused = material("Kd 0.25\nnewmtl other\nKd 7\nKe x");
    assert_eq!(reflectance(&unused), [0.25; 3]);
    assert_eq!(unused.load().materials.len(), 1);
}

#[test]
fn a_missing_file_is_an_io_error() {
    assert!(matches!(Folder::new().try_load(), Err(Error::Io { .. })));
    assert!(matches!(Scene::load(Path::new("x.foo")), Err(Error::Input { .. })));
}

#[test]
fn triangles_are_in_file_order_across_materials_and_objects() {
    let text = "mtllib s.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n\
        o a\nusemtl x\nf 1 2 3 4\ng b\nusemtl y\nf 1 2 2\nf 3 4 1\nusemtl x\nf -4 -3 -2\n";
    let scene = obj(text).with("s.mtl", "newmtl y\nKd 0.1\nnewmtl x\nKd 0.2\n").load();
    let got: Vec<_> = (0..4).map(|t| (scene.triangles[t].source, scene.material(t).name.as_str())).collect();
    assert_eq!(got, [(0, "x"), (1, "x"), (3, "y"), (4, "x")]);
    assert_eq!(scene.degenerate, 1);
    assert_eq!(scene.corners(1), [DVec3::ZERO, DVec3::new(1., 1., 0.), DVec3::Y]);
    assert_eq!(scene.materials.len(), 2);
    assert_eq!(scene.warnings, [""; 0]);
    assert!(!scene.has_emitter());
}

#[test]
fn concave_polygons_are_cut_inside() {
    // The fan from the first vertex would leave this arrow and flip a triangle.
    let scene = obj("v 1 1 0\nv 2 0 0\nv 0 3 0\nv -2 0 0\nf 3 4 1 2\nf 2 3 4 1\n").load();
    assert_eq!(scene.triangles.len(), 4);
    for t in 0..4 {
        assert!(scene.normal(t).z > 0.99);
    }
    let halves = [scene.area(0) + scene.area(1), scene.area(2) + scene.area(3)];
    assert!(halves.iter().all(|a| (a - 4.0).abs() < 1e-12), "{halves:?}");
}

#[test]
fn lines_end_and_continue_in_all_ways() {
    let text = "\u{feff}mtllib\ts.mtl\r\nv 0 0 0\rv 1 0 \\\r\n0 # comment\nv\t0\t1\t0 0.5\n# C:\\dir\\\n\
        usemtl\tred  wall\t\r\nf\t1//7 2//8 3//9 # normals do not exist\nl 1 2\np 1\nsurf 0 1\n";
    let scene = obj(text).with("s.mtl", "Kd 9\nnewmtl\tred  wall\r\n\tKD\t0.1 0.2 0.3 # dark\r\n").load();
    assert_eq!(scene.corners(0), [DVec3::ZERO, DVec3::X, DVec3::Y]);
    assert_eq!(scene.materials[0].reflectance, [0.1, 0.2, 0.3]);
    assert_eq!(scene.channels(), 3);
    assert_eq!(scene.warnings.len(), 1, "{:?}", scene.warnings);
    assert_eq!(count(&scene, "s.obj:11: a free-form surface is left out"), 1);
}

#[test]
fn utf_16_is_text_and_binary_files_are_refused() {
    let utf_16 = |text: &str| -> Vec<u8> {
        ["\u{feff}", text].concat().encode_utf16().flat_map(u16::to_le_bytes).collect()
    };
    let text = format!("mtllib s.mtl\r\n{TRIANGLE}usemtl grün\r\nf 1 2 3\r\n");
    let scene =
        Folder::new().with("s.obj", utf_16(&text)).with("s.mtl", utf_16("newmtl grün\r\nKd 0.25\r\n")).load();
    assert_eq!((scene.material(0).reflectance, scene.warnings.len()), ([0.25; 3], 0));
    let error = Folder::new().with("s.obj", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR").error();
    assert_eq!(error, "s.obj: not an OBJ file: it is not text");
    assert_eq!(obj("v 0 0 0\0\n").error(), "s.obj:1: vertex coordinate `0\0` is not a number");
}

#[test]
fn latin_1_names_are_distinguished() {
    let text = format!("mtllib s.mtl\n{TRIANGLE}").into_bytes();
    let text = [&text[..], b"usemtl gr\xfcn\nf 1 2 3\nusemtl gr\xf6n\nf 3 2 1\n"].concat();
    let scene = Folder::new()
        .with("s.obj", text)
        .with("s.mtl", b"newmtl gr\xf6n\nKd 0.1\nnewmtl gr\xfcn\nKd 0.2\n")
        .load();
    assert_eq!(scene.material(0).reflectance, [0.2; 3]);
    assert_eq!(scene.material(1).reflectance, [0.1; 3]);
}

#[test]
fn vertices_and_libraries_may_follow_their_use() {
    let text = format!("usemtl m\nf 1 2 3\n{TRIANGLE}mtllib s.mtl\n");
    assert_eq!(reflectance(&obj(&text).with("s.mtl", "newmtl m\nKd 0.3\n")), [0.3; 3]);
}

#[test]
fn library_names_come_in_many_forms() {
    let faces = format!("{TRIANGLE}usemtl a\nf 1 2 3\nusemtl b\nf 3 2 1\n");
    for (line, first, second) in [
        ("one.mtl two.mtl", "one.mtl", "two.mtl"),
        ("my one.mtl my two.mtl", "my one.mtl", "my two.mtl"),
        (r"my\ one.mtl two.mtl", "my one.mtl", "two.mtl"),
        (r"sub\one.mtl .\sub\two.mtl", "sub/one.mtl", "sub/two.mtl"),
        ("ONE.mtl Two.MTL", "one.mtl", "two.mtl"),
        (r"C:\work\one.mtl /work/two.mtl", "one.mtl", "two.mtl"),
    ] {
        let scene = obj(&format!("mtllib {line}\n{faces}"))
            .with(first, "newmtl a\nKd 0.125\n")
            .with(second, "newmtl b\nKd 0.25\nnewmtl a\nKd 1\n")
            .load();
        let got = [0, 1].map(|t| scene.material(t).reflectance[0]);
        assert_eq!(got, [0.125, 0.25], "{line}: {:?}", scene.warnings);
        assert_eq!(count(&scene, "material `a` is defined again; the first definition counts"), 1);
    }
}

#[test]
fn missing_files_and_materials_are_reported_once() {
    let text = format!("mtllib no.mtl\nmtllib no.mtl\n{TRIANGLE}f 1 2 3\nf 1 2 3\n")
        + "usemtl m\nf 1 2 3\nusemtl n\nf 1 2 3\nusemtl m\nf 1 2 3\nusemtl unused\n";
    let scene = obj(&text).load();
    assert!(scene.materials.iter().all(|m| m.reflectance == [0.5; 3] && !m.emits()));
    let names: Vec<_> = scene.materials.iter().map(|m| m.name.as_str()).collect();
    assert_eq!(names, ["(none)", "m", "n"]);
    assert_eq!(scene.warnings.len(), 4, "{:?}", scene.warnings);
    assert_eq!(count(&scene, "s.obj:1: material library `no.mtl`: not found"), 1);
    assert_eq!(count(&scene, "s.obj:12: material `m` is not defined; it gets reflectance 0.5"), 1);
    assert_eq!(count(&scene, "s.obj:9: faces without a material get reflectance 0.5"), 1);
}

#[test]
fn short_faces_are_skipped() {
    let scene = obj(&format!("{TRIANGLE}f 1 2\nf 3\nf 1 2 3\n")).load();
    assert_eq!((scene.triangles.len(), scene.triangles[0].source), (1, 0));
    assert_eq!(
        count(&scene, "s.obj:7: a face with fewer than three vertices is left out (2 in the file)"),
        1
    );
}

#[test]
fn colours_in_other_forms() {
    assert_eq!(reflectance(&material("Kd 0.25")), [0.25; 3]);
    assert_eq!(reflectance(&material("v 0 0.1 0\nnonsense\nKd 0.25 0 1 0.7")), [0.25, 0.0, 1.0]);
    let red = reflectance(&material("Kd xyz 0.4124 0.2126 0.0193"));
    assert_eq!(red, [1.0, 0.0, 0.0]);
    let spectral = material("Kd spectral a.rfl 1\nKe 3 4 5").load();
    assert_eq!(spectral.materials[0].reflectance, [0.5; 3]);
    assert_eq!(spectral.materials[0].emission, [3.0, 4.0, 5.0]);
    assert_eq!(spectral.warnings.len(), 1, "{:?}", spectral.warnings);
    assert_eq!(count(&spectral, "s.mtl:2: `Kd spectral` is not supported; reflectance 0.5"), 1);
    let missing = material("Ke 1").load();
    assert!(missing.has_emitter());
    assert_eq!(missing.materials[0].reflectance, [0.5; 3]);
    assert_eq!(count(&missing, "s.mtl:1: material `m` has no Kd; reflectance 0.5 is used"), 1);
}

#[test]
fn what_is_not_diffuse_is_reported_in_one_sentence() {
    let more = "Kd 0.1\nKs 0 0.1 0\nd 0.5\nTf 0.5 1 1\nillum 7\nbump x.png\nmap_Tr y.png\nPm 1\nNs many\n";
    let scene = material(&format!("{more}newmtl unused\nKs 1 1 1")).load();
    assert_eq!(scene.warnings.len(), 1, "{:?}", scene.warnings);
    for part in
        ["Ks", "transparency (d, Tr)", "transparency map (map_Tr)", "Tf", "glass (illum 7)", "bump", "Pm"]
    {
        assert!(scene.warnings[0].contains(part), "{part} in {}", scene.warnings[0]);
    }
    let plain = material("Kd 0.1\nKs 0 0 0\nd 1\nTr 0\nTf 1 1 1\nillum 2\nNs 10\nNi 1.5\nillum").load();
    assert_eq!(plain.warnings, [""; 0]);
}

const WHITE: [u8; 3] = [255; 3];
const BLACK: [u8; 3] = [0; 3];

#[test]
fn texture_multiplies() {
    let folder =
        material("Kd 0.5 0.25 1\nmap_Kd t.png\nKe 2 2 2\nmap_Ke t.png").image("t.png", 2, &[WHITE, BLACK]);
    let scene = folder.load();
    assert_eq!(scene.textures.len(), 1);
    assert!(scene.textures[0].is_grey());
    assert_eq!(scene.texcoords.len(), 1);
    // Corner 0 is at u = 0 and corner 1 at u = 1. The texture is white up to the middle.
    assert_eq!(scene.reflectance_at(0, [0.8, 0.1, 0.1]), [0.5, 0.25, 1.0]);
    assert_eq!(scene.emission_at(0, [0.1, 0.8, 0.1]), [0.0; 3]);
    let whole = [[1., 0., 0.], [0., 1., 0.], [0., 0., 1.]];
    let mean = scene.mean_emission(0, &whole);
    assert!((mean[0] - 1.5).abs() < 1e-12, "{mean:?}");
}

#[test]
fn factor_is_one_where_only_the_map_is_given() {
    let scene = material("map_Kd t.bmp\nmap_Ke t.bmp").image("t.bmp", 1, &[WHITE]).load();
    assert_eq!(scene.materials[0].reflectance, [1.0; 3]);
    assert_eq!(scene.materials[0].emission, [1.0; 3]);
    assert!(scene.has_emitter());
    assert_eq!(scene.warnings, [""; 0]);
}

#[test]
fn a_black_factor_is_reported() {
    let scene = material("Kd 0 0 0\nmap_Kd t.png").image("t.png", 1, &[WHITE]).load();
    assert_eq!(scene.reflectance_at(0, [0.2, 0.2, 0.6]), [0.0; 3]);
    assert_eq!(count(&scene, "s.mtl:3: map_Kd has no effect because Kd is 0"), 1);
}

#[test]
fn a_texture_is_found_beside_its_library_under_any_spelling() {
    for (name, line) in [
        ("my tex.tga", "map_Kd my tex.tga"),
        ("tex.png", r"map_kd -s 1 1 1 .\TEX.png"),
        ("a.jpg", r"map_Kd D:\maps\a.jpg"),
    ] {
        let folder = obj(&format!("mtllib lib/s.mtl\n{TRIANGLE}usemtl m\nf 1/1 2/2 3/3\n"))
            .with("lib/s.mtl", format!("newmtl m\nKd 1\n{line}\n"))
            .image(&format!("lib/{name}"), 1, &[WHITE]);
        let scene = folder.load();
        assert_eq!(scene.textures.len(), 1, "{line}: {:?}", scene.warnings);
        assert_eq!(scene.textures[0].size(), (1, 1));
    }
}

#[test]
fn texture_options_move_the_image() {
    let line = "Kd 1\nmap_Kd -blendu on -s 2 1 -o 0.5 -clamp on t.png";
    let scene = material(line).image("t.png", 2, &[WHITE, BLACK]).load();
    let map = scene.materials[0].reflectance_map.as_ref().unwrap();
    assert_eq!((map.scale, map.offset, map.clamp), (DVec2::new(2.0, 1.0), DVec2::new(0.5, 0.0), true));
    // u = 0.5 + 2 · 0.8 lies beyond the image. Repeating would find white there.
    assert_eq!(scene.reflectance_at(0, [0.1, 0.8, 0.1]), [0.0; 3]);
    assert_eq!(count(&scene, "s.mtl:3: texture options without effect: -blendu"), 1);
}

#[test]
fn missing_and_broken_textures_leave_the_plain_colour() {
    let missing = material("Kd 0.25\nmap_Kd no.png\nmap_Ke no.png").load();
    assert_eq!((missing.materials[0].reflectance, missing.materials[0].emission), ([0.25; 3], [0.0; 3]));
    assert_eq!(count(&missing, "s.mtl:3: texture `no.png` not found; plain Kd is used"), 1);
    let bare = material("map_Kd no.png").load();
    assert_eq!(bare.materials[0].reflectance, [0.5; 3]);
    assert_eq!(count(&bare, "reflectance 0.5 is used"), 1);
    for bytes in [&b"not an image"[..], b"\x89PNG\r\n\x1a\n broken"] {
        let broken = material("Kd 0.25\nmap_Kd t.png").with("t.png", bytes).load();
        assert!(broken.materials[0].reflectance_map.is_none() && broken.textures.is_empty());
        assert_eq!(count(&broken, "s.mtl:3: texture `t.png` cannot be read: "), 1, "{:?}", broken.warnings);
    }
}

#[test]
fn absurd_dimensions_are_refused() {
    // A BMP header that asks for 60000 by 60000 texels.
    let mut bmp = b"BM\0\0\0\0\0\0\0\0\x36\0\0\0\x28\0\0\0".to_vec();
    bmp.extend([60000i32.to_le_bytes(), 60000i32.to_le_bytes()].concat());
    bmp.extend(b"\x01\0\x18\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0");
    let scene = material("Kd 0.25\nmap_Kd t.bmp").with("t.bmp", bmp).load();
    assert_eq!(count(&scene, "texture `t.bmp` cannot be read"), 1, "{:?}", scene.warnings);
    assert!(scene.textures.is_empty());
}

#[test]
fn faces_without_texture_coordinates_go_without_texture() {
    let text = format!("mtllib s.mtl\n{TRIANGLE}usemtl m\nf 1/1 2/2 3/3\nf 1 2/2 3\nf 3/1 2/9 1/3\n");
    let scene =
        obj(&text).with("s.mtl", "newmtl m\nKd 0.75\nmap_Kd t.png\n").image("t.png", 1, &[BLACK]).load();
    let middle = [1.0 / 3.0; 3];
    assert_eq!([0, 1, 2].map(|t| scene.reflectance_at(t, middle)[0]), [0.0, 0.75, 0.75]);
    assert_eq!(count(&scene, "faces of material `m` have no texture coordinates"), 1);
    assert_eq!(count(&scene, "s.obj:11: a face corner names a texture coordinate that does not exist"), 1);
}

#[test]
fn faces_and_their_groups_are_kept_on_request() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("parts.obj");
    let text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\no a\ng b c\nf 1 2 2\nf 1 2 3\ng\nf 1 3 4\ng b c\nf 2 3 4\n";
    std::fs::write(&path, text).unwrap();
    assert!(Scene::load(&path).unwrap().faces.is_empty());
    let scene =
        Scene::load_with(&path, &LoadOptions::default().with_faces(true).with_keep_overlaps(true)).unwrap();
    let faces: Vec<_> = scene.faces.iter().map(|f| (f.first, f.line.unwrap(), f.part)).collect();
    assert_eq!(faces, [(0, 5, 0), (2, 8, 1), (3, 9, 1), (4, 11, 2), (5, 13, 1)]);
    let parts: Vec<_> = scene.parts.iter().map(|p| (p.object.as_deref(), p.group.as_deref())).collect();
    assert_eq!(parts, [(None, None), (Some("a"), Some("b c")), (Some("a"), None)]);
    // The face without area is no surface. The others keep their numbers.
    let names =
        |by: By| Surfaces::of(&scene, &by, Side::Front).list.into_iter().map(|s| s.name).collect::<Vec<_>>();
    assert_eq!(names(By::Face), ["0", "2", "3", "4"]);
    assert_eq!(names(By::Group), ["(none)", "b c"]);
    assert_eq!(names(By::Object), ["(none)", "a"]);
}

#[test]
fn colours_of_vertices_are_reflectances_times_kd() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("s.obj");
    std::fs::write(folder.path().join("s.mtl"), "newmtl half\nKd 0.5 0.5 0.5\nnewmtl bare\n").unwrap();
    let linear = radiosity::tone::linear;
    for (white, numbers) in [(1.0, "0.9 0.1 1"), (255.0, "204 51 255")] {
        let vertices = format!("v 0 0 0 {numbers}\nv 1 0 0 {numbers}\nv 0 1 0 1 {numbers}\nv 9 9 9\n");
        std::fs::write(
            &path,
            format!("mtllib s.mtl\nf 1 2 3\nusemtl half\nf 1 2 3\nusemtl bare\nf 1 3 2\nf 1 2 4\n{vertices}"),
        )
        .unwrap();
        let colour: Vec<f64> =
            numbers.split(' ').map(|c| linear(c.parse::<f64>().unwrap() / white)).collect();
        let scene = Scene::load_with(&path, &LoadOptions::default().with_keep_overlaps(true)).unwrap();
        for (t, factor) in [(0, 1.0), (1, 0.5), (2, 1.0)] {
            let found = scene.mean_reflectance(t, &[[1., 0., 0.], [0., 1., 0.], [0., 0., 1.]]);
            for c in 0..3 {
                assert!((found[c] - factor * colour[c]).abs() < 1e-6, "{t}: {found:?}");
            }
        }
        // A face with an uncoloured vertex has no colour.
        assert_eq!(scene.mean_reflectance(3, &[[1., 0., 0.], [0., 1., 0.], [0., 0., 1.]]), [0.5; 3]);
        // A reflectance given by the caller replaces them, but not Kd.
        let options = LoadOptions::default().with_keep_overlaps(true).with_reflectance(Some([0.3; 3]));
        let given = Scene::load_with(&path, &options).unwrap();
        assert!(given.colours.is_empty());
        let found = [0, 1, 2].map(|t| given.material(t).reflectance[0]);
        assert_eq!(found, [0.3, 0.5, 0.3]);
    }
}

#[test]
fn normals_are_kept_for_smooth_shading_and_do_not_flip_faces() {
    let text = format!(
        "{TRIANGLE}vn 0 0 -1\nvn 0 3 4 # long\nvn nan 0 0\nf 1//1 2/2/2 3//-1\nf 1 2//9 3//1\nf 1/1 2/2 3/3\n"
    );
    let scene = obj(&text).load();
    let zero = [0.0; 3];
    assert_eq!(scene.normals[0], [[0.0, 0.0, -1.0], [0.0, 3.0, 4.0], zero]);
    assert_eq!(scene.normals[1..], [[zero, zero, [0.0, 0.0, -1.0]], [zero; 3]]);
    assert!((0..3).all(|t| scene.normal(t) == DVec3::Z));
    assert!(scene.warnings.iter().all(|warning| !warning.contains("normal")), "{:?}", scene.warnings);
    assert!(obj(&format!("{TRIANGLE}f 1 2 3\n")).load().normals.is_empty());
}
