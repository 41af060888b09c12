//! Inspection of a scene before any computation.

use crate::common::program::{Here, stderr};
use crate::common::*;
use glam::DVec3;
use radiosity::{
    Scene,
    accuracy::survey::{Seen, Survey, turned_lamps},
    trace::Tracer,
};

const RAYS: u64 = 1 << 16;

fn survey(scene: &Scene) -> Survey {
    Survey::of(scene, &Tracer::new(scene), RAYS, 7)
}

/// Asserts a share of rays within five standard errors of independent rays. Rays of a sequence have smaller errors.
fn assert_share(count: u64, rays: u64, wanted: f64) {
    let got = count as f64 / rays as f64;
    let error = (wanted * (1.0 - wanted) / rays as f64).sqrt();
    assert!((got - wanted).abs() <= 5.0 * error, "{got} instead of {wanted}");
}

/// The unit room seen from inside. `edit` changes the triangles of its last wall, which emits.
fn room_with(edit: impl Fn(Corners) -> Option<Corners>) -> Scene {
    let mut walls = room(DVec3::ZERO, DVec3::ONE);
    let last: Vec<Corners> = walls.split_off(10).into_iter().filter_map(edit).collect();
    scene(&[black(walls), part(last, 0.5, 1.0)])
}

/// A closed room sees only its own fronts.
#[test]
fn a_closed_room_sees_only_fronts() {
    let seen = survey(&room_with(Some));
    assert_eq!(seen.all, Seen { rays: RAYS, fronts: RAYS, backs: 0, escaped: 0 });
    assert_eq!(seen.lamps, Seen { rays: RAYS / 4, fronts: RAYS / 4, backs: 0, escaped: 0 });
    assert_eq!((seen.back_area, &seen.backs_of[..]), (0.0, &[0, 0][..]));
}

/// The opening sees only walls, so by reciprocity ∑ A F(wall, opening) = A of the opening: a fifth of all rays of the
/// five walls escape.
#[test]
fn a_fifth_of_the_rays_escape_through_an_opening() {
    let seen = survey(&room_with(|_| None)).all;
    assert_eq!(seen.backs, 0);
    assert_share(seen.escaped, seen.rays, 1.0 / 5.0);
}

/// A reversed wall sends its sixth of the rays outside. The rays that escaped through the opening before, a fifth of
/// five sixths, now hit its back.
#[test]
fn a_reversed_wall_is_hit_from_behind() {
    let seen = survey(&room_with(|[a, b, c]| Some([a, c, b])));
    assert_share(seen.all.escaped, seen.all.rays, 1.0 / 6.0);
    assert_share(seen.all.backs, seen.all.rays, 1.0 / 6.0);
    assert_eq!(seen.backs_of, [0, seen.all.backs]);
    // Many rays hit both of its triangles.
    assert!((seen.back_area - 1.0 / 6.0).abs() < 1e-12, "{}", seen.back_area);
    assert_eq!(seen.lamps.escaped, seen.lamps.rays);
}

/// The area of all visible backs is estimated although rays hit only some of many small triangles. The inside of the
/// sphere is seen from a small lamp only. Its N rays spread evenly over n triangles, so they hit about
/// n (1 - exp(-N / n)).
#[test]
fn backs_that_no_ray_hit_are_estimated() {
    let shell = icosphere(1.0, 5);
    let lamp = part(icosphere(0.2, 1), 0.5, 1.0);
    let scene = scene(&[black(shell), lamp]);
    let seen = survey(&scene);
    let (n, rays) = (20_480.0, seen.all.backs as f64);
    let met = n * -(-rays / n).exp_m1();
    assert!(met < 0.2 * n, "the test needs few rays, not {rays}");
    // The standard deviation of the estimate is about sqrt(n)·(n / rays)^1.5 ≈ 2000 of 20480 here. Its bias is downward
    // if triangles are not equally likely to be hit.
    assert!((seen.back_area - 1.0).abs() < 0.3, "{}", seen.back_area);
}

/// A triangle 10¹¹ times as long as wide has no area in single precision, but its rays are cast, and so are those of
/// triangles of any size.
#[test]
fn slivers_and_giants_are_surveyed() {
    for [b, c] in
        [[DVec3::X, DVec3::Y * 1e11], [DVec3::X * 1e-150, DVec3::Y * 1e-150], [DVec3::X * 1e153, DVec3::Z]]
    {
        let seen = survey(&scene(&[black(vec![[DVec3::ZERO, b, c]])]));
        assert_eq!(seen.all, Seen { rays: RAYS, fronts: 0, backs: 0, escaped: RAYS }, "{b} {c}");
        assert_eq!(seen.lamps.rays, 0);
    }
}

const ROOM: &str = "mtllib scene.mtl\nusemtl wall
v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nv 0 0 1\nv 1 0 1\nv 0 1 1\nv 1 1 1
f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n";

#[test]
fn a_room_is_described_in_figures_and_sentences() {
    let here = Here::new(ROOM, "newmtl wall\nKd 0.5 0.25 0\nKe 1 1 1\n");
    let output = here.run("inspect scene.obj --report r.json");
    assert_eq!((output.status.code(), stderr(&output)), (Some(0), String::new()));
    let table = String::from_utf8(output.stdout).unwrap();
    for said in [
        "12 triangles, 8 vertices, area 6.0",
        "probably in metres",
        "enclosed      yes",
        "concerns      none",
    ] {
        assert!(table.contains(said), "{said} is missing in\n{table}");
    }
    let report = here.json("r.json");
    assert_eq!(report["scene"]["triangles"], 12);
    assert_eq!(report["scene"]["area"], 6.0);
    assert_eq!(report["edges"]["closed"], true);
    assert_eq!(report["seen"]["escaped_share"], 0.0);
    assert_eq!(report["seen"]["lamp_escaped_share"], 0.0);
    assert_eq!(report["materials"][0]["reflectance"], serde_json::json!([0.5, 0.25, 0.0]));
    assert_eq!(report["concerns"].as_array().unwrap().len(), 0);
    let forecast = report["forecast"].as_array().unwrap();
    let names: Vec<_> = forecast.iter().map(|f| f["quality"].as_str().unwrap()).collect();
    assert_eq!(names, ["draft", "medium", "high", "reference"]);
    // The forecast equals the result.
    here.run("solve scene.obj --quality draft --report s.json");
    assert_eq!(forecast[0]["patches"].as_f64(), here.json("s.json")["scene"]["patches"].as_f64());
    assert_eq!(forecast[0]["rays"].as_f64(), here.json("s.json")["form_factors"]["rays"].as_f64());
}

#[test]
fn concerns_are_reported_and_are_no_failure() {
    // No lamp, a reversed wall, a doubled face, a face without area, and a missing texture.
    let obj = ROOM.replace("f 2 6 8 4", "f 4 8 6 2\nf 1 2 4\nf 1 1 2");
    let here = Here::new(&obj, "newmtl wall\nmap_Kd no.png\n");
    let output = here.run("inspect scene.obj --report r.json");
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let concerns = here.json("r.json")["concerns"].to_string();
    for said in [
        "nothing emits light",
        "of the hits of rays are on backs, most often of `wall`",
        "4 edges join a front to a back",
        // Half of a square.
        "faces overlap in one plane: an area of 5.0000e-1 of material `wall` lies behind `wall` and is left out",
        "1 triangles without area",
    ] {
        assert!(concerns.contains(said), "{said} is missing in {concerns}");
    }
    let lit = here.run("inspect scene.obj --emit 5@wall --report r.json");
    assert_eq!(lit.status.code(), Some(0));
    assert!(!here.json("r.json")["concerns"].to_string().contains("nothing emits"));

    let broken = Here::new(&ROOM.replace("f 1 5 6 2", "f 1 5 66 2"), "");
    assert!(broken.fails("inspect scene.obj --report r.json", 2).starts_with("error: scene.obj:13: "));
    let errors = broken.fails("inspect scene.abc", 2);
    assert!(errors.starts_with("error: scene.abc: unknown kind of scene\nhint: "), "{errors}");
}

#[test]
fn a_lamp_that_faces_outward_is_reported() {
    let obj = ROOM.replace("f 1 2 4 3", "usemtl lamp\nf 3 4 2 1\nusemtl wall");
    let here = Here::new(&obj, "newmtl wall\nKd 0.5\nnewmtl lamp\nKd 0.5\nKe 1\n");
    assert_eq!(here.run("inspect scene.obj --report r.json").status.code(), Some(0));
    let concerns = here.json("r.json")["concerns"].to_string();
    assert!(concerns.contains("all light of the lamps leaves the scene"), "{concerns}");
}

#[test]
fn options_make_materials_emit() {
    let obj = ROOM.replace("f 1 2 4 3", "usemtl my lamp\nf 1 2 4 3\nusemtl wall");
    let here = Here::new(&obj, "newmtl wall\nKd 0.5\nnewmtl my lamp\n");
    let emissions = |arguments: &str| {
        let mut words: Vec<&str> = arguments.split('|').collect();
        words.extend(["inspect", "scene.obj", "--report", "r.json", "--quiet"]);
        words.rotate_left(arguments.split('|').count());
        let output = std::process::Command::new(env!("CARGO_BIN_EXE_radiosity"))
            .current_dir(here.directory())
            .args(words)
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let report = here.json("r.json");
        [0, 1].map(|m| report["materials"][m]["emission"].as_array().unwrap().clone())
    };
    let rgb = |c: [f64; 3]| c.map(serde_json::Value::from).to_vec();
    assert_eq!(emissions("--emit|3,2,1@my lamp"), [rgb([3.0, 2.0, 1.0]), rgb([0.0; 3])]);
    assert_eq!(emissions("--emit|4|--emit|0@wall"), [rgb([4.0; 3]), rgb([0.0; 3])]);
    // The lamp has no Kd.
    assert_eq!(here.json("r.json")["materials"][0]["reflectance"][1], 0.5);
    emissions("--reflectance|0.2,0.3,0.4");
    assert_eq!(here.json("r.json")["materials"][0]["reflectance"], serde_json::json!([0.2, 0.3, 0.4]));
    std::fs::remove_file(here.path("r.json")).unwrap();
    let errors = here.fails("solve scene.obj --emit 3@lamp", 2);
    assert!(errors.contains("has material `lamp`\nhint: its materials are my lamp, wall"), "{errors}");
    assert!(here.fails("solve scene.obj --emit=-3", 2).contains("--emit"));
    assert!(here.fails("solve scene.obj --reflectance 1.5", 2).contains("--reflectance"));
}

#[test]
fn no_output_replaces_a_file_of_the_scene() {
    let obj = ROOM
        .replace("mtllib scene.mtl", "mtllib out.ply\nvt 0 0\nvt 1 0\nvt 0 1")
        .replace("f 1 2 4 3", "f 1/1 2/2 4/3 3/1");
    let here = Here::new(&obj, "");
    std::fs::write(here.path("out.ply"), "newmtl wall\nKd 0.5\nKe 1\nmap_Kd t.PNG\n").unwrap();
    save_png(&image::RgbImage::from_pixel(2, 2, image::Rgb([90; 3])), here.path("t.png"));
    let (mtl, texture) = (here.read("out.ply"), here.read("t.png"));
    for arguments in [
        "solve scene.obj -o out.ply --quality draft",
        "render scene.obj -o ./t.png --spp 1 --width 8 --height 8",
        "render scene.obj -o x.png --report out.ply --spp 1 --width 8 --height 8",
        "probe scene.obj --points scene.mtl -o out.ply",
        "validate scene.obj --report out.ply",
        "inspect scene.obj --report out.ply",
    ] {
        if arguments.starts_with("probe") {
            std::fs::write(here.path("scene.mtl"), "0.5 0.5 0.5 0 0 1\n").unwrap();
        }
        let errors = here.fails(arguments, 2);
        assert!(errors.contains("the output would replace the input"), "{arguments}: {errors}");
    }
    assert_eq!((here.read("out.ply"), here.read("t.png")), (mtl, texture));
    // A file that the scene does not use may be replaced.
    std::fs::write(here.path("other.ply"), "old").unwrap();
    let output = here.run("solve scene.obj -o other.ply --quality draft");
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(here.read("other.ply").starts_with(b"ply\n"));
}

/// A luminaire with its faces inside out lights only itself. The warning names it, but not the correct one beside it.
#[test]
fn lamps_that_shine_into_their_own_housing_are_named() {
    let mut obj = "mtllib scene.mtl\n".to_string();
    let mut vertices = 0;
    let mut square = |material: &str, x: f64, y: f64, up: bool| {
        let mut corners = [(x, 0.0), (x, 1.0), (x + 1.0, 1.0), (x + 1.0, 0.0)];
        if !up {
            corners.reverse();
        }
        corners.iter().for_each(|(x, z)| obj += &format!("v {x} {y} {z}\n"));
        obj += &format!(
            "usemtl {material}\nf {} {} {} {}\n",
            vertices + 1,
            vertices + 2,
            vertices + 3,
            vertices + 4
        );
        vertices += 4;
    };
    // A plate above each lamp. One lamp faces down into the room, the other up at its plate.
    for (x, up) in [(0.0, false), (3.0, true)] {
        square("housing", x, 3.05, !up);
        square(if up { "turned" } else { "right" }, x, 3.0, up);
    }
    square("housing", 0.0, 0.0, true);
    let mtl =
        "newmtl housing\nKd .5 .5 .5\nnewmtl right\nKd 0 0 0\nKe 5 5 5\nnewmtl turned\nKd 0 0 0\nKe 5 5 5\n";
    let here = Here::new(&obj, mtl);
    let said = stderr(&here.run("inspect scene.obj"));
    assert!(
        said.contains("the lamp of `turned` at 3.") && said.contains("its own luminaire (`housing`)"),
        "{said}"
    );
    assert!(!said.contains("`right`"), "{said}");
}

/// A luminaire of six faces inside out is named once. A strip of light deep in a channel lights the room and is not
/// named, though most of its light meets the channel first and its back sees the room above.
#[test]
fn a_luminaire_is_named_once_and_a_recessed_one_is_not() {
    let case = room_faces(DVec3::new(2.0, 2.0, 2.5), DVec3::new(3.0, 3.0, 2.6)).concat();
    let channel = room_faces(DVec3::new(0.5, 0.0, 1.9), DVec3::new(0.55, 4.0, 2.0));
    let [sides @ .., _, _] = channel.clone();
    let lamps = |triangles: &[Corners], turned: bool| {
        let triangles = triangles.to_vec();
        part(if turned { flipped(triangles) } else { triangles }, 0.0, 5.0)
    };
    let scene = scene(&[
        part(room(DVec3::ZERO, DVec3::new(4.0, 4.0, 3.0)), 0.5, 0.0),
        part(sides.concat(), 0.5, 0.0),
        lamps(&channel[5], false),
        lamps(&case, false),
        lamps(&room_faces(DVec3::new(1.0, 1.0, 2.5), DVec3::new(1.8, 1.8, 2.6)).concat(), true),
    ]);
    let named = turned_lamps(&scene, &Tracer::new(&scene));
    let materials: Vec<u32> = named.iter().map(|lamp| scene.triangles[lamp.triangle].material).collect();
    assert_eq!(materials, [3], "{named:?}");
    // No light leaves a closed box.
    assert_eq!((named[0].kept, named[0].lit), (1.0, 3));
}

/// Surface between touching blocks is not counted as visible.
#[test]
fn surface_inside_solids_is_not_surveyed() {
    let blocks = crate::common::room_of_blocks(|_, _| true);
    let scene = scene(&[part(blocks, 0.5, 1.0)]);
    let seen = survey(&scene);
    // The 54 squares outside and the 6 of the room are visible. The rest lie between blocks.
    assert!((seen.shut_in_area - (26.0 * 6.0 - 60.0)).abs() < 1e-9, "{}", seen.shut_in_area);
    assert_eq!((seen.all.backs, seen.all.fronts + seen.all.escaped), (0, RAYS));
    // The outside is convex, so all of its light escapes.
    assert_share(seen.all.escaped, RAYS, 54.0 / 60.0);
}
