//! Feeds damaged input to the readers and the command line: good files with bytes, numbers, words and lines changed at
//! random. Each file must load, or be refused with one line, within limits of time and memory.
//!
//!     cargo test --test fuzz -- obj|mtl|ply|gltf|glb|ies|ldt|toml|epw|cli|checkpoint SECONDS [FIRST]
//!
//! Case `k` depends on `k` alone. A case that fails prints its number and keeps its file; `FIRST` starts with that
//! number. `cargo test` alone does not run this program. Test builds check integer overflow.

#[path = "common/gltf.rs"]
mod gltf;

use std::{
    fmt::Write as _,
    fs,
    io::Read,
    panic::{AssertUnwindSafe, catch_unwind},
    path::{Path, PathBuf},
    process::{Command, ExitCode, Stdio},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use radiosity::{
    Progress, Scene,
    accuracy::survey::Survey,
    form_factor::{CastOptions, Checkpoint, FormFactors},
    patch::{Patches, Subdivision},
    scene::{
        inspection::Inspection,
        light::{self, Photometry, Weather},
    },
    trace::{Tracer, sampling::mix},
};

/// The longest time for a case.
const PATIENCE: Duration = Duration::from_secs(20);
/// The memory that a case may touch: a constant for the program itself, and an amount for each byte of the file.
const MEMORY: u64 = 64 << 20;
const MEMORY_PER_BYTE: u64 = 4000;
/// Mutations keep files at most this large.
const LARGEST: usize = 1 << 18;

/// A fixed sequence of random numbers.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(1);
        mix(&[self.0])
    }

    fn below(&mut self, n: usize) -> usize {
        (self.next() % n.max(1) as u64) as usize
    }

    fn pick<'a, T: ?Sized>(&mut self, from: &[&'a T]) -> &'a T {
        from[self.below(from.len())]
    }
}

/// Words that replace others.
const WORDS: [&str; 66] = [
    "0",
    "1",
    "-1",
    "0.5",
    "1e-300",
    "1e300",
    "1e999",
    "-0",
    "nan",
    "inf",
    "-inf",
    "1.",
    ".5",
    "+1",
    "1e",
    "0x10",
    "99999999999",
    "4294967295",
    "4294967296",
    "2147483648",
    "18446744073709551615",
    "-9223372036854775808",
    "3",
    "1/1/1",
    "1//1",
    "-1/-1",
    "/",
    "v",
    "vt",
    "vn",
    "f",
    "f 1 2 3\n",
    "f 1 1 1\n",
    "usemtl",
    "usemtl m\n",
    "mtllib",
    "mtllib s.mtl",
    "o",
    "g",
    "newmtl",
    "newmtl m\n",
    "Kd",
    "Ke",
    "map_Kd",
    "map_Ke t.png",
    "-s",
    "-o",
    "-clamp on",
    "-mm 1",
    "spectral",
    "xyz",
    "illum 99",
    "\\\n",
    "\r",
    "\r\n",
    "\n",
    "\t",
    "#",
    "\u{feff}",
    "property list uchar int vertex_indices\n",
    "property float x\n",
    "element face 3\n",
    "end_header\n",
    "ply\n",
    "format ascii 1.0\n",
    "\0",
];

/// `seed` with some changes, and with parts of `others` in it.
fn mutate(seed: &[u8], others: &[Vec<u8>], random: &mut Random) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for _ in 0..1 + random.below(6) {
        let at = random.below(bytes.len() + 1);
        let scale = random.below(8);
        let length = random.below(1 << scale).min(bytes.len() - at);
        match random.below(10) {
            0 if at < bytes.len() => bytes[at] = random.next() as u8,
            1 if at < bytes.len() => bytes[at] ^= 1 << random.below(8),
            2 => drop(bytes.drain(at..at + length)),
            3 => {
                let again = bytes[at..at + length].to_vec();
                (0..1 + random.below(4)).for_each(|_| drop(bytes.splice(at..at, again.iter().copied())));
            }
            4 => drop(bytes.splice(at..at, random.pick(&WORDS).bytes())),
            5 | 6 => {
                // Replace a word.
                let blank = |b: &u8| b.is_ascii_whitespace();
                let start = bytes[..at].iter().rposition(blank).map_or(0, |p| p + 1);
                let end = bytes[at..].iter().position(blank).map_or(bytes.len(), |p| at + p);
                drop(bytes.splice(start..end, random.pick(&WORDS).bytes()));
            }
            7 => bytes.truncate(at.max(1)),
            8 => {
                let other = &others[random.below(others.len())];
                let from = random.below(other.len());
                let part = &other[from..(from + length.max(40)).min(other.len())];
                drop(bytes.splice(at..at, part.iter().copied()));
            }
            _ => {
                // Swap two lines.
                let mut lines: Vec<&[u8]> = bytes.split_inclusive(|&b| b == b'\n').collect();
                let (i, j) = (random.below(lines.len()), random.below(lines.len()));
                if i < lines.len() && j < lines.len() {
                    lines.swap(i, j);
                }
                bytes = lines.concat();
            }
        }
        bytes.truncate(LARGEST);
    }
    bytes
}

fn mesh(name: &str) -> Vec<u8> {
    let path = format!("{}/meshes/{name}", env!("CARGO_MANIFEST_DIR"));
    fs::read(&path).unwrap_or_else(|e| panic!("{path}: {e}"))
}

const ODD_OBJ: &str = "# odd\nmtllib s.mtl other.mtl\nv 0 0 0 1\nv 1 0 0 0.5 0.5 0.5\nv 1 1 \\\n 0\nv 0 1 0\nv 0.5 0.5 1\n\
    vt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\ns off\no a b\ng c d\nusemtl m\nf 1/1/1 2/2/1 3/3/1 4/1/1\nusemtl my lamp\n\
    f -1//1 -2//1 -3//1\nf 1 2 3 5 4\nl 1 2\np 1\n";
const ODD_MTL: &str = "newmtl m\nKd 0.5 0.25 0.125\nKs 1 1 1\nmap_Kd -s 2 2 -o 0.5 -clamp on t.png\nd 0.5\nTr 0.5\nillum 2\n\
    newmtl my lamp\nKd xyz 0.4 0.3 0.2\nKe 5\nmap_Ke t.png\nnewmtl s\nKd spectral a.rfl 1\nTf 1 1 1\nbump b.png\nPm 0.5\n";

/// A mesh as PLY in the given encoding.
fn to_ply(scene: &Scene, encoding: &str) -> Vec<u8> {
    let mut header =
        format!("ply\nformat {encoding} 1.0\ncomment seed\nelement vertex {}\n", scene.vertices.len());
    for name in ["float x", "float y", "float z", "uchar red", "uchar green", "uchar blue"] {
        let _ = writeln!(header, "property {name}");
    }
    let _ =
        writeln!(header, "element face {}\nproperty list uchar int vertex_indices", scene.triangles.len());
    for name in ["emission_r", "emission_g", "emission_b"] {
        let _ = writeln!(header, "property float {name}");
    }
    header += "end_header\n";
    let (mut text, mut binary) = (String::new(), Vec::new());
    let big = encoding == "binary_big_endian";
    let float = |x: f32| if big { x.to_be_bytes() } else { x.to_le_bytes() };
    for v in &scene.vertices {
        let [x, y, z] = v.to_array().map(|c| c as f32);
        let _ = writeln!(text, "{x} {y} {z} 200 100 50");
        binary.extend([x, y, z].map(float).concat());
        binary.extend([200, 100, 50]);
    }
    for t in &scene.triangles {
        let [a, b, c] = t.vertices;
        let _ = writeln!(text, "3 {a} {b} {c} 1 2 3");
        binary.push(3);
        binary.extend([a, b, c].map(|i| if big { i.to_be_bytes() } else { i.to_le_bytes() }).concat());
        binary.extend([1.0, 2.0, 3.0].map(float).concat());
    }
    [header.as_bytes(), if encoding == "ascii" { text.as_bytes() } else { &binary }].concat()
}

fn seeds(target: &str) -> Vec<Vec<u8>> {
    const MESHES: [&str; 3] = ["cornell-box", "furnace", "textured"];
    match target {
        "obj" => MESHES
            .iter()
            .map(|name| mesh(&format!("{name}.obj")))
            .chain([ODD_OBJ.into(), ODD_OBJ.replace('\n', "\r\n").into()])
            .collect(),
        "mtl" => MESHES
            .iter()
            .map(|name| mesh(&format!("{name}.mtl")))
            .chain([ODD_MTL.into(), ODD_MTL.replace('\n', "\r\n").into()])
            .collect(),
        "gltf" => {
            let mut json = odd_gltf().json;
            json["buffers"] = serde_json::json!([{"byteLength": odd_gltf().bytes.len(), "uri": "s.bin"}]);
            vec![json.to_string().into(), format!("{json:#}").into()]
        }
        "glb" => vec![odd_gltf().glb()],
        "ies" => vec![ODD_IES.into(), ODD_IES.replace("TILT=NONE", "TILT=INCLUDE\n1\n2\n0 90\n1 0.9").into()],
        "ldt" => vec![odd_ldt(1, 1).into(), odd_ldt(0, 4).into(), odd_ldt(4, 2).into()],
        "toml" => vec![ODD_LIGHTS.into()],
        "epw" => vec![odd_epw().into()],
        _ => {
            let load = |name: &str| Scene::load(format!("{}/meshes/{name}.obj", env!("CARGO_MANIFEST_DIR")));
            let scenes = MESHES.map(|name| load(name).expect("the repository's meshes load"));
            let encodings = ["ascii", "binary_little_endian", "binary_big_endian"];
            scenes.iter().flat_map(|scene| encodings.map(|e| to_ply(scene, e))).collect()
        }
    }
}

const ODD_IES: &str = "IESNA:LM-63-1995\n[TEST] made\nTILT=NONE\n2 1000 1.5 3 3\n1 2 0.1 -0.2 0\n0.9 0.5 40\n0 45 90\n\
    0 90 180\n100 70.71 0\n90 60, 0\n80 50 0\n";

/// A light file with one of every kind.
const ODD_LIGHTS: &str = "up = \"z\"\n[[sun]]\nplace = [48.1, 11.6]\nat = \"2026-06-21T12:00+02:00\"\nirradiance = [3, 2, 1]\n\
    [[directional]]\nname = \"d\"\ndirection = [0, 0, -2]\nirradiance = 5\n[[point]]\nposition = [1, 2, 3]\nintensity = 4\n\
    [[spot]]\nposition = [1, 2, 3]\ndirection = [0, 0, -1]\nintensity = 4\ninner = 10\nouter = 20\n\
    [[luminaire]]\nfile = \"s.ies\"\nposition = [0, 0, 2]\nrotation = 30\ndimming = 0.5\n\
    [sky]\nkind = \"perez\"\ndirect = 700\ndiffuse = 120\ncolour = [1, 0.5, 2]\n";

/// A EULUMDAT file of this symmetry, with the intensities of this number of planes.
fn odd_ldt(symmetry: u32, planes: usize) -> String {
    let mut text = format!("maker\n1\n{symmetry}\n4\n90\n3\n90\nreport\nname\nnumber\nfile\ndate\n");
    text += "600\n600\n50\n500\n0\n0\n0\n0\n0\n100\n80\n1.0\n0\n1\n2\nLED\n3000\n3000\n80\n20\n";
    text += &"0.5\n".repeat(10);
    text += "0\n90\n180\n270\n0\n90\n180\n";
    text + &"200\n100,5\n0\n".repeat(planes)
}

/// A weather file of one day.
fn odd_epw() -> String {
    let mut text = String::from("LOCATION,Munich,-,DEU,made,108660,48.1,11.6,1.0,520\n");
    for name in ["DESIGN CONDITIONS", "TYPICAL/EXTREME PERIODS", "GROUND TEMPERATURES"] {
        text += &format!("{name},0\n");
    }
    text += "HOLIDAYS/DAYLIGHT SAVINGS,No,0,0,0\nCOMMENTS 1,made\nCOMMENTS 2,made\n";
    text += "DATA PERIODS,1,1,Data,Sunday,6/21,6/21\n";
    for hour in 1..=24 {
        let light = if (6..20).contains(&hour) { 100 + 10 * hour } else { 0 };
        text += &format!(
            "2026,6,21,{hour},60,?9,20,10,50,95000,0,0,300,{light},{light},{light},0,0,0,0,180,2,5,5\n"
        );
    }
    text
}

/// A glTF file with one of every feature.
fn odd_gltf() -> gltf::Gltf {
    use serde_json::json;
    let mut file = gltf::Gltf::new();
    let wall = file.material("wall", [0.5, 0.4, 0.3], [0.0; 3]);
    let lamp = file.material("lamp", [0.5; 3], [1.0; 3]);
    let texture = file.texture(&image::RgbaImage::from_pixel(2, 2, image::Rgba([200, 100, 50, 99])));
    file.json["textures"][texture]["sampler"] =
        file.push("samplers", json!({"wrapS": 33648, "wrapT": 33071})).into();
    let turned = json!({"index": texture, "extensions": {"KHR_texture_transform": {"rotation": 0.5, "scale": [2, 3]}}});
    file.json["materials"][wall]["pbrMetallicRoughness"] = json!({"metallicFactor": 0.5, "baseColorTexture": turned, "metallicRoughnessTexture": {"index": texture}});
    file.json["materials"][lamp]["doubleSided"] = true.into();
    file.json["materials"][lamp]["emissiveTexture"] = json!({"index": texture, "texCoord": 0});
    file.rectangle([0., 0., 0.], [1., 0., 0.], [0., 1., 0.], wall);
    file.rectangle([0., 0., 1.], [0., 1., 0.], [1., 0., 0.], lamp);
    let position = file.floats::<3>(&[[0., 0., 0.], [1., 0., 0.], [0., 0., 1.], [1., 0., 1.]]);
    let (indices, values) = (file.view(&[1, 3]), file.view(&[7; 24]));
    file.json["accessors"][position]["sparse"] = json!({"count": 2, "indices": {"bufferView": indices, "componentType": 5121},
        "values": {"bufferView": values}});
    let colour = file.accessor(&[200; 16], 5121, "VEC4", 4);
    file.json["accessors"][colour]["normalized"] = true.into();
    let joints = file.accessor(&[0; 16], 5121, "VEC4", 4);
    let weights = file.floats::<4>(&[[1., 0., 0., 0.]; 4]);
    file.primitive(json!({"mode": 5, "material": wall, "targets": [{"POSITION": position}],
        "attributes": {"POSITION": position, "COLOR_0": colour, "JOINTS_0": joints, "WEIGHTS_0": weights}}));
    let places = file.floats::<3>(&[[0., 0., 0.], [3., 0., 0.]]);
    file.push(
        "nodes",
        json!({"mesh": 0, "translation": [1, 2, 3], "rotation": [0, 0, 1, 1], "scale": [1, -2, 1],
        "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": places}}}}),
    );
    file.push("skins", json!({"joints": [0, 1]}));
    file.push("nodes", json!({"mesh": 0, "skin": 0, "weights": [0.5]}));
    file.json["nodes"][0]["children"] = json!([1, 2]);
    file
}

/// The number of files that loaded. If all files are refused at their first line, the test checks little.
static LOADED: AtomicU64 = AtomicU64::new(0);

/// The fault in how the file was handled, if any.
fn objection(path: &Path) -> Option<String> {
    let before = reset_peak();
    let said = match catch_unwind(AssertUnwindSafe(|| look(path))) {
        Ok(objection) => objection,
        Err(_) => Some("panicked".into()),
    };
    let size = fs::metadata(path).map_or(0, |m| m.len());
    let used = peak().saturating_sub(before);
    said.or_else(|| {
        (used > MEMORY + MEMORY_PER_BYTE * size).then(|| format!("{} MiB for {size} bytes", used >> 20))
    })
}

fn look(path: &Path) -> Option<String> {
    let lines = |text: &str| (text.contains('\n')).then(|| format!("more than one line: {text:?}"));
    match path.extension().and_then(|e| e.to_str()) {
        Some("ies" | "ldt") => {
            return match Photometry::load(path) {
                Ok(found) => {
                    LOADED.fetch_add(1, Ordering::Relaxed);
                    let flux = found.flux();
                    (!(flux.is_finite() && flux >= 0.0)).then(|| format!("a flux of {flux}"))
                }
                Err(error) => lines(&error.to_string()),
            };
        }
        Some("toml") => {
            let mut scene = Scene::default();
            return match light::file::add(&mut scene, path, None) {
                Ok(_) => {
                    LOADED.fetch_add(1, Ordering::Relaxed);
                    let seen = scene.lights.seen(glam::DVec3::Z);
                    seen.iter().any(|x| !(x.is_finite() && *x >= 0.0)).then(|| format!("seen {seen:?}"))
                }
                Err(error) => lines(&error.to_string()),
            };
        }
        Some("epw") => {
            return match Weather::load(path) {
                Ok(weather) => {
                    LOADED.fetch_add(1, Ordering::Relaxed);
                    let sane = |hour: &light::Hour| hour.direct >= 0.0 && hour.diffuse >= 0.0;
                    (!weather.hours.iter().all(sane)).then(|| "an hour with negative light".into())
                }
                Err(error) => lines(&error.to_string()),
            };
        }
        _ => {}
    }
    let scene = match Scene::load(path) {
        Ok(scene) => scene,
        Err(error) => return lines(&error.to_string()),
    };
    LOADED.fetch_add(1, Ordering::Relaxed);
    let n = scene.triangles.len();
    let sane = |rgb: [f64; 3], most: f64| rgb.iter().all(|x| (0.0..=most).contains(x));
    for m in &scene.materials {
        if !sane(m.reflectance, 1.0) || !sane(m.emission, f64::MAX) {
            return Some(format!("material {m:?}"));
        }
    }
    if n == 0 || !(scene.texcoords.is_empty() || scene.texcoords.len() == n) {
        return Some(format!("{n} triangles, {} texture coordinates", scene.texcoords.len()));
    }
    if !(0..n).all(|t| scene.area(t) > 0.0 && scene.corners(t).iter().all(|p| p.is_finite())) {
        return Some("a triangle has no area".into());
    }
    let inspection = Inspection::of(&scene);
    let seen = Survey::of(&scene, &Tracer::new(&scene), 256, 0).all;
    if inspection.triangles + scene.backs_of_lamps != n || seen.fronts + seen.backs + seen.escaped != 256 {
        return Some(format!("{inspection:?} {seen:?}"));
    }
    scene.warnings.iter().find_map(|warning| lines(warning))
}

/// A room, the checkpoint of its rays, and their hits.
struct Kept {
    scene: Scene,
    tracer: Tracer,
    bytes: Vec<u8>,
    met: Vec<u32>,
}

impl Kept {
    fn new(folder: &Path) -> Kept {
        let path = format!("{}/meshes/cornell-box.obj", env!("CARGO_MANIFEST_DIR"));
        let scene = Scene::load(path).expect("the repository's meshes load");
        let tracer = Tracer::new(&scene);
        let mut kept = Kept { scene, tracer, bytes: Vec::new(), met: Vec::new() };
        let path = folder.join("seed");
        kept.met = kept.cast(Checkpoint::open(&path, &kept.scene, 0).expect("a new file can be made"), 16.0);
        kept.bytes = fs::read(path).expect("what was written can be read");
        kept
    }

    fn cast(&self, file: Checkpoint, rays: f64) -> Vec<u32> {
        let mut patches = Patches::subdivide(&self.scene, &Subdivision::Count(40));
        let options = CastOptions::default().with_rays(rays);
        let (file, progress) = (Some(Arc::new(file)), Progress::new());
        let cast = FormFactors::cast_checkpointed(
            &self.scene,
            &self.tracer,
            &mut patches,
            &options,
            file,
            &progress,
        );
        // A file with right checksums may still contain impossible values, which are refused later.
        let Ok(f) = cast else { return Vec::new() };
        let hits = f.ray_set().expect("rays were cast");
        (0..f.len()).flat_map(|i| hits.of(i)).copied().collect()
    }

    /// The fault in how a changed checkpoint is handled, if any.
    fn objection(&self, path: &Path, random: &mut Random) -> Option<String> {
        // In most cases the header stays.
        let start = if random.below(4) > 0 { HEADER } else { 0 };
        let other = [self.bytes[HEADER..].to_vec()];
        let mut bytes = [&self.bytes[..start], &mutate(&self.bytes[start..], &other, random)].concat();
        let repaired = random.below(2) == 0;
        if repaired {
            repair(&mut bytes);
        }
        fs::write(path, &bytes).expect("a temporary folder can be written to");
        let before = reset_peak();
        let opened = catch_unwind(AssertUnwindSafe(|| Checkpoint::open(path, &self.scene, 0)));
        let used = peak().saturating_sub(before);
        if used > MEMORY + MEMORY_PER_BYTE * bytes.len() as u64 {
            return Some(format!("{} MiB for {} bytes", used >> 20, bytes.len()));
        }
        match opened {
            Err(_) => Some("panicked".into()),
            Ok(Err(error)) => {
                let changed = fs::read(path).ok().as_ref() != Some(&bytes);
                (changed || error.to_string().contains('\n')).then(|| format!("refused and changed: {error}"))
            }
            Ok(Ok(file)) => {
                LOADED.fetch_add(1, Ordering::Relaxed);
                let rays = if random.below(2) == 0 { 16.0 } else { 32.0 };
                match catch_unwind(AssertUnwindSafe(|| self.cast(file, rays))) {
                    Err(cause) => {
                        // Invented hits may give invalid form factors, which debug builds report.
                        let said = cause.downcast_ref::<String>().map_or("", String::as_str);
                        (!repaired || !said.contains("form factors are shares")).then(|| "panicked".into())
                    }
                    Ok(met) => (!repaired && rays == 16.0 && met != self.met).then(|| "other hits".into()),
                }
            }
        }
    }
}

/// Bytes of the header of a checkpoint.
const HEADER: usize = 56;

/// Corrects the checksums of a checkpoint, as far as its lengths lead.
fn repair(bytes: &mut [u8]) {
    let check = |bytes: &[u8]| crc32fast::hash(bytes).to_le_bytes();
    let mut at = HEADER;
    while let Some(record) = bytes.get_mut(at..).filter(|rest| rest.len() >= 16) {
        let length = u64::from_le_bytes(std::array::from_fn(|k| record[k])) as usize;
        let sum = check(&record[..8]);
        record[8..12].copy_from_slice(&sum);
        let Some(body) = record.get(12..length.saturating_add(12)) else { return };
        let sum = check(body);
        let Some(end) = record.get_mut(12 + length..16 + length) else { return };
        end.copy_from_slice(&sum);
        at += 16 + length;
    }
}

/// The peak of touched memory since [`reset_peak`], on Linux.
fn peak() -> u64 {
    radiosity::output::report::peak_bytes().unwrap_or(0)
}

fn reset_peak() -> u64 {
    let _ = fs::write("/proc/self/clear_refs", "5");
    peak()
}

/// A command line of the program's own words, often with invalid values.
fn arguments(random: &mut Random) -> Vec<String> {
    const VALUES: [&str; 24] = [
        "0",
        "1",
        "2",
        "16",
        "64",
        "-1",
        "1e-300",
        "1e300",
        "nan",
        "inf",
        "0.5",
        "x",
        "",
        "1,2,3",
        "0.5,0.25,0.1",
        "0,0,0",
        "1,1",
        "10@wall",
        "@",
        "out.ply",
        "out.json",
        "scene.mtl",
        "points",
        "nowhere/out",
    ];
    const OPTIONS: [&str; 41] = [
        "-o",
        "--report",
        "--quality",
        "--patch-size",
        "--patches",
        "--rays",
        "--error",
        "--time",
        "--solver",
        "--tolerance",
        "--estimator",
        "--exposure",
        "--seed",
        "--threads",
        "--quiet",
        "--method",
        "--spp",
        "--no-next-event",
        "--final-gather",
        "--width",
        "--height",
        "--eye",
        "--look-at",
        "--up",
        "--fov",
        "--white",
        "--points",
        "--paths",
        "--particles",
        "--reflectance",
        "--emit",
        "--help",
        "--version",
        "-o",
        "--report",
        "--emit",
        "--points",
        "--spp",
        "--checkpoint",
        "--checkpoint",
        "--memory",
    ];
    const FIT: [(&str, &[&str]); 13] = [
        (
            "--checkpoint",
            &["rays", "rays", "rays2", "out.ply", "scene.obj", "scene.mtl", "t.png", "points", "."],
        ),
        ("--memory", &["1", "20MB", "100MB", "1GiB", "64g", "1e9"]),
        ("--quality", &["draft", "medium", "DRAFT"]),
        ("--solver", &["auto", "jacobi", "gauss-seidel", "southwell", "cg", "direct"]),
        ("--estimator", &["pooled", "one-way"]),
        ("--method", &["path", "light", "radiosity"]),
        ("-o", &["out.ply", "out.png", "out.exr", "out.hdr", "out.txt", "scene.obj", "t.png"]),
        ("--report", &["out.json", "out.txt", "scene.obj", "."]),
        ("--points", &["points", "scene.obj", "missing"]),
        ("--patch-size", &["inf", "0.25", "1e-9", "1e9"]),
        ("--patches", &["1", "100", "1000", "1000000000", "4294967295"]),
        ("--emit", &["1", "5@wall", "1,2,3@lamp", "0"]),
        ("--width", &["1", "7", "16", "1000000"]),
    ];
    let commands = ["solve", "render", "probe", "validate", "inspect", "view-factors", "nonsense"];
    let scenes = ["scene.obj", "scene.ply", "dark.obj", "missing.obj", "scene.mtl", "."];
    let mut words = vec![random.pick(&commands).to_owned(), random.pick(&scenes[..3]).to_owned()];
    if random.below(8) == 0 {
        words[1] = random.pick(&scenes).into();
    }
    // Little work, unless one of the options below asks for more.
    let small: &[&str] = match &words[0][..] {
        "solve" => &["--patches", "60", "--rays", "16"],
        "render" => &["--spp", "1", "--width", "9", "--height", "7"],
        "probe" => &["--points", "points", "--spp", "16"],
        "validate" => &["--patches", "40", "--rays", "16", "--paths", "16", "--particles", "1024"],
        _ => &[],
    };
    let mut taken: Vec<&str> = Vec::new();
    for _ in 0..random.below(5) {
        let option = random.pick(&OPTIONS);
        taken.push(option);
        words.push(option.into());
        let fit = FIT.iter().find(|(name, _)| *name == option).map(|(_, values)| *values);
        match fit {
            Some(values) if random.below(4) > 0 => words.push(random.pick(values).into()),
            _ if ["--quiet", "--no-next-event", "--help", "--version"].contains(&option) => {}
            _ if random.below(12) == 0 => {}
            _ => words.push(random.pick(&VALUES).into()),
        }
    }
    for pair in small.chunks(2).filter(|pair| !taken.contains(&pair[0])) {
        words.extend(pair.iter().map(ToString::to_string));
    }
    words
}

/// The fault in how the program handles these words, if any.
fn cli_objection(program: &Path, folder: &Path, words: &[String]) -> Option<String> {
    let mut child = Command::new("sh")
        .args(["-c", "ulimit -v 8000000; exec \"$@\"", "sh"])
        .arg(program)
        .args(words)
        .current_dir(folder)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program runs");
    let mut stderr = child.stderr.take().expect("it is piped");
    let reader = std::thread::spawn(move || {
        let mut text = Vec::new();
        let _ = stderr.read_to_end(&mut text);
        String::from_utf8_lossy(&text).into_owned()
    });
    let start = Instant::now();
    let status = loop {
        match child.try_wait().expect("a child can be waited for") {
            Some(status) => break status,
            None if start.elapsed() > PATIENCE => {
                let _ = child.kill();
                let _ = child.wait();
                return Some("it hangs".into());
            }
            None => std::thread::sleep(Duration::from_millis(2)),
        }
    };
    let errors = reader.join().unwrap_or_default();
    if !matches!(status.code(), Some(0..=2)) || errors.contains("panicked") {
        return Some(format!("{status}: {errors}"));
    }
    let clap = errors.contains("For more information, try") || errors.contains("Usage:");
    if status.code() == Some(2) && !clap && errors.lines().filter(|l| l.starts_with("error: ")).count() != 1 {
        return Some(format!("not one error: {errors}"));
    }
    let names = fs::read_dir(folder).expect("the folder is there").flatten().map(|e| e.file_name());
    let partial = names.into_iter().find(|name| name.to_string_lossy().ends_with(".part"));
    let kept = folder.join("kept");
    let written =
        ["scene.obj", "scene.mtl", "scene.ply", "t.png", "points", "dark.obj"].into_iter().find(|name| {
            let changed = fs::read(folder.join(name)).ok() != fs::read(kept.join(name)).ok();
            if changed {
                let _ = fs::copy(kept.join(name), folder.join(name));
            }
            // Only one scene uses the texture, and only one command uses the points. All others may overwrite them.
            let foreign = match *name {
                "t.png" => words[1] != "scene.obj",
                "points" => words[0] != "probe",
                _ => false,
            };
            changed && !foreign
        });
    match (partial, written) {
        (Some(name), _) => Some(format!("left {}", name.to_string_lossy())),
        (_, Some(name)) => Some(format!("wrote over {name}")),
        _ => None,
    }
}

/// Fills the folder in which the command line works.
fn cli_folder(folder: &Path) {
    let obj = "mtllib scene.mtl\nusemtl wall\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nv 0 0 1\nv 1 0 1\nv 0 1 1\nv 1 1 1\n\
        vt 0 0\nvt 1 0\nvt 1 1\nf 1/1 2/2 4/3\nf 1 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nusemtl lamp\nf 2 6 8 4\n";
    let mtl = "newmtl wall\nKd 0.5 0.4 0.3\nmap_Kd t.png\nnewmtl lamp\nKd 0.5\nKe 1\n";
    let files: [(&str, Vec<u8>); 5] = [
        ("scene.obj", obj.into()),
        ("scene.mtl", mtl.into()),
        ("dark.obj", obj.replace("mtllib", "# no").into()),
        ("points", "0.5 0.5 0.5 0 0 1\n0.2 0.5 0.5 1 0 0\n".into()),
        ("t.png", mesh("checkerboard.png")),
    ];
    fs::create_dir_all(folder.join("kept")).expect("a temporary folder can be written to");
    let put = |name: &str, bytes: &[u8]| {
        fs::write(folder.join(name), bytes).expect("a temporary folder can be written to");
        fs::write(folder.join("kept").join(name), bytes).expect("a temporary folder can be written to");
    };
    files.iter().for_each(|(name, bytes)| put(name, bytes));
    let scene = Scene::load(folder.join("scene.obj")).expect("this scene is good");
    put("scene.ply", &to_ply(&scene, "binary_little_endian"));
}

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let number = |i: usize| words.get(i).and_then(|w| w.parse::<u64>().ok());
    let (Some(target), Some(seconds)) = (words.first().map(String::as_str), number(1)) else {
        eprintln!("usage: fuzz obj|mtl|ply|gltf|glb|ies|ldt|toml|epw|cli|checkpoint SECONDS [FIRST]");
        return ExitCode::from(2);
    };
    let folder = tempfile::tempdir().expect("a temporary folder can be made").keep();
    println!("in {}", folder.display());
    let (first, limit) = (number(2).unwrap_or(0), Duration::from_secs(seconds));
    let program = Path::new(env!("CARGO_BIN_EXE_radiosity"));
    if target == "cli" {
        cli_folder(&folder);
    } else {
        fs::write(folder.join("other.mtl"), ODD_MTL).expect("a temporary folder can be written to");
        fs::write(folder.join("t.png"), mesh("checkerboard.png"))
            .expect("a temporary folder can be written to");
        fs::write(folder.join("s.bin"), odd_gltf().bytes).expect("a temporary folder can be written to");
        fs::write(folder.join("s.mtl"), ODD_MTL).expect("a temporary folder can be written to");
        fs::write(folder.join("s.ies"), ODD_IES).expect("a temporary folder can be written to");
        fs::write(folder.join("s.obj"), ODD_OBJ).expect("a temporary folder can be written to");
    }
    let seeds = if ["cli", "checkpoint"].contains(&target) { Vec::new() } else { seeds(target) };
    let kept = (target == "checkpoint").then(|| Kept::new(&folder));
    std::panic::set_hook(Box::new(|info| eprintln!("{info}")));

    // A second thread reports a case that hangs, because it cannot be stopped from inside.
    static CASE: AtomicU64 = AtomicU64::new(0);
    static BEGAN: AtomicU64 = AtomicU64::new(0);
    let start = Instant::now();
    if target != "cli" {
        std::thread::spawn(move || {
            loop {
                std::thread::sleep(Duration::from_secs(1));
                let since = start.elapsed().as_secs().saturating_sub(BEGAN.load(Ordering::Relaxed));
                if since > PATIENCE.as_secs() {
                    println!("case {} hangs; its file is the last one written", CASE.load(Ordering::Relaxed));
                    std::process::exit(1);
                }
            }
        });
    }
    let (mut case, mut failures) = (first, 0);
    while start.elapsed() < limit && failures < 20 {
        CASE.store(case, Ordering::Relaxed);
        BEGAN.store(start.elapsed().as_secs(), Ordering::Relaxed);
        let mut random = Random(mix(&[case]));
        let objection = if target == "cli" {
            let words = arguments(&mut random);
            cli_objection(program, &folder, &words).map(|o| format!("{words:?}: {o}"))
        } else if let Some(kept) = &kept {
            let path = folder.join("s.checkpoint");
            kept.objection(&path, &mut random).inspect(|_| {
                let _ = fs::copy(&path, folder.join(format!("failed-{case}.checkpoint")));
            })
        } else {
            let seed = &seeds[random.below(seeds.len())];
            // Most changes of a header are refused by it, so in most cases it stays.
            let data = seed.windows(11).position(|w| w == b"end_header\n").map_or(0, |p| p + 11);
            let kept = if random.below(3) > 0 { data } else { 0 };
            let bytes = [&seed[..kept], &mutate(&seed[kept..], &seeds, &mut random)].concat();
            fs::write(folder.join(format!("s.{target}")), &bytes)
                .expect("a temporary folder can be written to");
            let scene = folder.join(if target == "mtl" { "s.obj".into() } else { format!("s.{target}") });
            objection(&scene).inspect(|_| {
                let _ = fs::write(folder.join(format!("failed-{case}.{target}")), &bytes);
            })
        };
        if let Some(objection) = objection {
            println!("case {case}: {objection}");
            failures += 1;
        }
        case += 1;
    }
    let loaded = LOADED.load(Ordering::Relaxed);
    let seconds = start.elapsed().as_secs_f64();
    println!("{target}: {} cases in {seconds:.0} s, {loaded} files loaded, {failures} failed", case - first);
    if failures > 0 {
        return ExitCode::from(1);
    }
    let _ = fs::remove_dir_all(&folder);
    ExitCode::SUCCESS
}
