//! The command `render`.

use std::f64::consts::PI;

use crate::common::program::{Here, stderr};

/// One block of a picture, with one value per channel.
type Block = [f64; 3];

const SIZE: u32 = 48;
/// Blocks per row. Each has 12 x 12 pixels.
const BLOCKS: u32 = 4;

fn mesh(name: &str) -> String {
    format!("{}/meshes/{name}.obj", env!("CARGO_MANIFEST_DIR"))
}

/// A directory with a scene that shows nothing.
fn here() -> Here {
    Here::new("mtllib scene.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "newmtl m\nKe 1 1 1\n")
}

/// Renders and returns the bytes of the picture.
fn render(here: &Here, scene: &str, options: &str, name: &str) -> Vec<u8> {
    let output = here.run(&format!("render {scene} -o {name} --quiet {options}"));
    assert_eq!(output.status.code(), Some(0), "{options}: {}", stderr(&output));
    assert!(output.stdout.is_empty() && output.stderr.is_empty(), "{}", stderr(&output));
    here.read(name)
}

/// The means of the blocks of an EXR picture.
fn blocks(bytes: &[u8]) -> Vec<Block> {
    let picture =
        image::load_from_memory_with_format(bytes, image::ImageFormat::OpenExr).unwrap().to_rgb32f();
    assert_eq!(picture.dimensions(), (SIZE, SIZE));
    let side = SIZE / BLOCKS;
    let mut means = vec![[0.0; 3]; (BLOCKS * BLOCKS) as usize];
    for (x, y, pixel) in picture.enumerate_pixels() {
        let mean = &mut means[(y / side * BLOCKS + x / side) as usize];
        (0..3).for_each(|c| mean[c] += f64::from(pixel.0[c]) / f64::from(side * side));
    }
    means
}

/// The mean of each block over several seeds, and its standard error.
fn sampled(here: &Here, options: &str, seeds: u32) -> Vec<(Block, Block)> {
    let runs: Vec<Vec<Block>> = (0..seeds)
        .map(|seed| {
            let options = format!("{options} --width {SIZE} --height {SIZE} --seed {seed}");
            blocks(&render(here, &mesh("cornell-box"), &options, "out.exr"))
        })
        .collect();
    let n = f64::from(seeds);
    (0..runs[0].len())
        .map(|b| {
            let mean: Block = std::array::from_fn(|c| runs.iter().map(|r| r[b][c]).sum::<f64>() / n);
            let error = std::array::from_fn(|c| {
                let squares: f64 = runs.iter().map(|r| (r[b][c] - mean[c]).powi(2)).sum();
                (squares / (n * (n - 1.0))).sqrt()
            });
            (mean, error)
        })
        .collect()
}

/// All methods give the same picture of the Cornell box, block by block: unbiased ones within five standard errors, and
/// radiosity within five times the noise and twice the change between patches and patches of half the size.
#[test]
fn all_methods_give_one_picture_of_the_cornell_box() {
    let here = here();
    let path = sampled(&here, "--method path --spp 64", 6);
    let light = sampled(&here, "--method light --spp 64", 6);
    let plain = sampled(&here, "--method path --no-next-event --spp 256", 6);
    let lit = path.iter().filter(|(mean, _)| mean[0] > 0.0).count();
    assert_eq!(lit, 16, "the box fills a square picture");
    for (name, other) in [("light", &light), ("no next event", &plain)] {
        let mut squares = 0.0;
        for (b, (p, o)) in path.iter().zip(other).enumerate() {
            for c in 0..3 {
                let (difference, error) = (p.0[c] - o.0[c], p.1[c].hypot(o.1[c]));
                assert!(error < 0.06 * p.0[c], "{name}, block {b}: {p:?} {o:?}");
                assert!(difference.abs() < 5.0 * error, "{name}, block {b}: {p:?} {o:?}");
                squares += (difference / error).powi(2) / 48.0;
            }
        }
        assert!(
            (0.4..2.5).contains(&squares),
            "{name}: mean square of differences over their errors {squares}"
        );
    }
    for way in ["--spp 16", "--spp 4 --final-gather 16"] {
        let solved = |patches: u32| {
            sampled(&here, &format!("--method radiosity {way} --rays 64 --patches {patches}"), 3)
        };
        let (coarse, fine) = (solved(1_000), solved(4_000));
        let relative = |of: &dyn Fn(usize, usize) -> f64| {
            let squares = (0..48).map(|k| (of(k / 3, k % 3) / path[k / 3].0[k % 3]).powi(2));
            (squares.sum::<f64>() / 48.0).sqrt()
        };
        // In a single block the change by smaller patches can vanish by chance, and three seeds say little about its noise. So
        // both are root mean squares over all blocks. The discretisation error falls at least linearly: half the size of
        // patches, half the error.
        let patches = relative(&|b, c| coarse[b].0[c] - fine[b].0[c]);
        let noise = relative(&|b, c| fine[b].1[c].hypot(path[b].1[c]));
        let allowance = 2.0 * patches + 5.0 * noise;
        for (b, (p, f)) in path.iter().zip(&fine).enumerate() {
            for c in 0..3 {
                let difference = (p.0[c] - f.0[c]).abs() / p.0[c];
                assert!(
                    difference < allowance,
                    "{way}, block {b}: {p:?} {f:?}, patches {patches}, noise {noise}"
                );
            }
        }
        println!("{way}: patches {patches:.4}, noise {noise:.4}");
        assert!(allowance < 0.1, "{way}: the comparison allows {allowance}");
    }
}

/// In a furnace the radiosity is 1 W/m² everywhere, so every method shows a radiance of 1/π, within four standard
/// errors.
#[test]
fn every_method_sees_one_over_pi_everywhere_in_a_furnace() {
    let here = here();
    let furnace = mesh("furnace");
    for (options, sharp) in [
        ("--method path --spp 64", 0.005),
        ("--method path --spp 256 --no-next-event", 0.005),
        ("--method light --spp 64", 0.02),
        ("--method radiosity --spp 1 --patches 300", 1e-6),
        ("--method radiosity --spp 16 --final-gather 4 --patches 300", 0.005),
    ] {
        let options = format!("{options} --width {SIZE} --height {SIZE}");
        let means = blocks(&render(&here, &furnace, &options, "out.exr"));
        let n = means.len() as f64;
        let mean = means.iter().map(|m| m[1]).sum::<f64>() / n;
        let error = (means.iter().map(|m| (m[1] - mean).powi(2)).sum::<f64>() / (n * (n - 1.0))).sqrt();
        assert!(error <= sharp / PI, "{options}: the error {error} is too large");
        assert!((mean - 1.0 / PI).abs() <= 4.0 * error + 1e-7, "{options}: {mean} ± {error}");
        for m in means {
            assert_eq!((m[0], m[2]), (m[1], m[1]), "{options}: grey light has become coloured");
            // Each block, with the spread of blocks.
            assert!((m[1] - mean).abs() < 4.5 * error * n.sqrt() + 1e-7, "{options}: {m:?}, mean {mean}");
        }
    }
}

/// EXR and HDR files hold radiance, to their precision. PNG files hold the exposed radiance as sRGB.
#[test]
fn files_hold_radiance_or_its_exposure() {
    let here = here();
    let run = |name: &str, options: &str| {
        let options = format!("--method radiosity --spp 1 --patches 300 --width 20 --height 10 {options}");
        image::load_from_memory(&render(&here, &mesh("furnace"), &options, name)).unwrap()
    };
    let hdr = run("out.hdr", "").to_rgb32f();
    // Eight bits of mantissa, the first of which is 1.
    assert_eq!(hdr.dimensions(), (20, 10));
    assert!(hdr.pixels().all(|p| p.0.iter().all(|x| (f64::from(*x) * PI - 1.0).abs() < 1.0 / 128.0)));
    let exr = run("out.exr", "").to_rgb32f();
    assert!(exr.pixels().all(|p| p.0.iter().all(|x| (f64::from(*x) * PI - 1.0).abs() < 1e-5)));
    // 1/π of white is 153 of 255 by IEC 61966-2-1, and 2/π is 209. Automatic exposure shows even light at 0.8: 231.
    for (options, value) in [
        ("--white 1", 153),
        ("--white 1 --exposure 1", 209),
        ("--white 2 --exposure 2", 209),
        ("--white 0.3", 255),
        ("", 231),
    ] {
        let png = run("out.png", options);
        assert_eq!(png.color(), image::ColorType::Rgb8);
        assert!(png.to_rgb8().pixels().all(|p| p.0 == [value; 3]), "{options}");
    }
}

#[test]
fn the_same_seed_gives_the_same_bytes_on_any_number_of_threads() {
    let here = here();
    for method in [
        "path",
        "light",
        "radiosity --patches 300 --rays 32",
        "radiosity --patches 300 --rays 32 --final-gather 3",
    ] {
        let options = format!("--method {method} --spp 3 --width 33 --height 21");
        let run = |more: &str| render(&here, &mesh("door-ajar"), &format!("{options} {more}"), "out.png");
        let one = run("--threads 1");
        assert!(one == run("--threads 2") && one == run("--threads 5"), "{method}");
        assert!(one != run("--seed 7"), "{method}");
    }
}

#[test]
fn the_camera_is_where_options_place_it_and_the_report_states_it() {
    let here = here();
    // From inside, close to the red wall (x = 556), looking at it.
    let options =
        "--eye 400,270,-100 --look-at 556,270,280 --fov 10 --width 12 --height 8 --spp 16 --report r.json";
    let bytes = render(&here, &mesh("cornell-box"), options, "out.exr");
    let picture = image::load_from_memory(&bytes).unwrap().to_rgb32f();
    assert!(picture.pixels().all(|p| p.0[0] > 2.0 * p.0[1] && p.0[0] > 0.0));
    let report = here.json("r.json");
    assert_eq!(report["picture"]["eye"], serde_json::json!([400.0, 270.0, -100.0]));
    assert_eq!(report["picture"]["up"], serde_json::json!([0.0, 1.0, 0.0]));
    assert_eq!(report["picture"]["fov"], 10.0);
    assert_eq!((&report["method"], &report["samples"]), (&"path".into(), &16.into()));
    let mean: f64 = picture.pixels().map(|p| f64::from(p.0[0])).sum::<f64>() / 96.0;
    assert!((report["picture"]["mean_radiance"][0].as_f64().unwrap() / mean - 1.0).abs() < 1e-6);
    // Only the eye is given: the picture is centred on the middle of the box.
    let output = here.run(&format!(
        "render {} -o out.png --spp 1 --width 8 --height 8 --eye -5,270,-700",
        mesh("cornell-box")
    ));
    let table = String::from_utf8(output.stdout).unwrap();
    assert!(
        table.contains("--eye -5.000000,270.000000,-700.000000 --look-at 278.000000,274.400000,279.600000"),
        "{table}"
    );
    assert!(table.contains("white is "), "{table}");
}

#[test]
fn bad_usage_is_reported_and_leaves_no_file() {
    let here = here();
    let cornell = mesh("cornell-box");
    for (options, said) in [
        ("-o out.png --width 0", "empty"),
        ("-o out.png --width 100000 --height 100000", "too large"),
        ("-o out.png --spp 0", "--spp"),
        ("-o out.png --fov 180", "180"),
        ("-o out.png --eye 1,2", "three numbers"),
        ("-o out.png --eye 1,2,nan", "three numbers"),
        ("-o out.png --eye 1,2,3 --look-at 1,2,3", "are the same"),
        ("-o out.png --up 0,0,1", "parallel"),
        ("-o out.png --eye 278,273,-800 --look-at 278,273,-900", "sees nothing"),
        // Inside the tall block; behind the back wall.
        ("-o out.png --eye 368,100,351 --look-at 368,100,400", "no light reaches the visible surfaces"),
        ("-o out.png --eye 278,273,2000 --look-at 278,273,0", "no light reaches the visible surfaces"),
        ("-o out.png --method light --no-next-event", "pinhole"),
        ("-o out.png --method light --spp 4000000000", "too many"),
        (
            "-o out.png --method radiosity --no-next-event",
            "--no-next-event has no effect with --method radiosity",
        ),
        ("-o out.png --final-gather 4", "--final-gather has no effect with --method path"),
        ("-o out.png --method light --rays 4", "--rays has no effect with --method light"),
        ("-o out.png --method radiosity --patches 10 --patch-size 1", "cannot be used with"),
        ("-o out.png --white 0", "a radiance from 1e-100"),
        ("-o out.exr --white 1", "--white is for .png"),
        ("-o out.hdr --exposure -1", "--exposure is for .png"),
        ("-o out.gif", ".png, .exr or .hdr"),
        ("-o nowhere/out.png", "nowhere/out.png"),
        ("-o out.png --report out.png", "may not have the name"),
        ("", "--output"),
    ] {
        let errors = here.fails(&format!("render {cornell} {options}"), 2);
        assert!(errors.contains(said), "{options}: {errors}");
        assert!(errors.starts_with("error: "), "{errors}");
    }
    let dark = Here::new("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "");
    assert!(dark.fails("render scene.obj -o out.png", 2).contains("nothing emits light"));
}
