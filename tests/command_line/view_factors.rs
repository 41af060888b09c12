//! The command `view-factors`: tables that agree with closed forms, for all kinds of surfaces.

use std::{collections::HashMap, fs};

use crate::common::program::{Here, stderr};
use radiosity::form_factor::exact::{
    opposed_rectangles, opposed_squares_with_blocker, perpendicular_rectangles,
};

/// Rounding of single precision, which is more than the error of the closed forms.
const STORED: f64 = 3e-7;

/// A table with names, areas, escaped shares, and rows.
struct Table {
    names: Vec<String>,
    areas: Vec<f64>,
    escaped: Vec<f64>,
    rows: Vec<Vec<f64>>,
}

impl Table {
    fn read(here: &Here, file: &str) -> Table {
        let text = String::from_utf8(here.read(file)).unwrap();
        let mut lines = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
        let head = lines.next().unwrap();
        assert_eq!(head[..3], ["surface", "area", "escaped"]);
        let names: Vec<String> = head[3..].iter().map(|name| name.to_string()).collect();
        let mut table = Table { names, areas: Vec::new(), escaped: Vec::new(), rows: Vec::new() };
        for line in lines {
            assert_eq!(line[0], table.names[table.rows.len()]);
            let numbers: Vec<f64> = line[1..].iter().map(|word| word.parse().unwrap()).collect();
            table.areas.push(numbers[0]);
            table.escaped.push(numbers[1]);
            table.rows.push(numbers[2..].to_vec());
        }
        table.check();
        table
    }

    /// Checks properties of all tables: rows sum to one and are reciprocal.
    fn check(&self) {
        let n = self.names.len();
        assert!(self.rows.len() == n && self.rows.iter().all(|row| row.len() == n));
        for i in 0..n {
            let sum = self.escaped[i] + self.rows[i].iter().sum::<f64>();
            // Rows of sky and ground are empty.
            if self.areas[i].is_infinite() {
                assert_eq!(sum, 0.0);
                continue;
            }
            assert!((sum - 1.0).abs() < 1e-12, "row {i} sums to {sum}");
            for j in (0..n).filter(|&j| self.areas[j].is_finite()) {
                let [there, back] = [(i, j), (j, i)].map(|(i, j)| self.areas[i] * self.rows[i][j]);
                let size = self.areas[i].min(self.areas[j]);
                assert!((0.0..=1.0).contains(&self.rows[i][j]));
                assert!((there - back).abs() <= 1e-14 * size, "{i} {j}: {there} and {back}");
            }
        }
    }

    fn get(&self, from: &str, to: &str) -> f64 {
        let index = |name: &str| self.names.iter().position(|n| n == name).expect(name);
        self.rows[index(from)][index(to)]
    }
}

/// Runs the command on an OBJ file and returns stderr.
fn run(obj: &str, options: &str) -> (Here, String) {
    let here = Here::new(obj, "");
    let output = here.run(&format!("view-factors scene.obj -o out.csv --quiet {options}"));
    let errors = stderr(&output);
    assert_eq!(output.status.code(), Some(0), "{options}: {errors}");
    assert!(output.stdout.is_empty());
    (here, errors)
}

fn table(obj: &str, options: &str) -> Table {
    Table::read(&run(obj, options).0, "out.csv")
}

/// An OBJ file of faces, each with the lines before it and its corners.
fn obj<'a>(faces: impl IntoIterator<Item = (&'a str, Vec<[f64; 3]>)>) -> String {
    let mut text = String::new();
    for (before, corners) in faces {
        text += before;
        text += "\n";
        corners.iter().for_each(|[x, y, z]| text += &format!("v {x} {y} {z}\n"));
        text += "f";
        (0..corners.len()).for_each(|k| text += &format!(" -{}", corners.len() - k));
        text += "\n";
    }
    text
}

/// A rectangle of a × b at height z that faces up or down.
fn flat(a: f64, b: f64, z: f64, up: bool) -> Vec<[f64; 3]> {
    let mut corners = vec![[0.0, 0.0, z], [a, 0.0, z], [a, b, z], [0.0, b, z]];
    if !up {
        corners.reverse();
    }
    corners
}

const WALLS: [&str; 6] = ["left", "right", "front", "rear", "floor", "ceiling"];

/// The walls of the unit cube, seen from inside, each cut into n × n.
fn cube(n: u32, before: impl Fn(usize) -> &'static str) -> Vec<(&'static str, Vec<[f64; 3]>)> {
    let mut faces = Vec::new();
    for wall in 0..6 {
        let (axis, far) = (wall / 2, wall % 2 == 1);
        for k in 0..n * n {
            let at = |u: u32, v: u32| {
                let mut p = [0.0; 3];
                p[axis] = f64::from(u8::from(far));
                p[(axis + 1) % 3] = f64::from(u) / f64::from(n);
                p[(axis + 2) % 3] = f64::from(v) / f64::from(n);
                p
            };
            let (u, v) = (k % n, k / n);
            let mut corners = vec![at(u, v), at(u + 1, v), at(u + 1, v + 1), at(u, v + 1)];
            if far {
                corners.reverse();
            }
            faces.push((before(wall), corners));
        }
    }
    faces
}

/// The two view factors of a cube.
fn of_cube(i: usize, j: usize) -> f64 {
    match (i == j, i / 2 == j / 2) {
        (true, _) => 0.0,
        (false, true) => opposed_rectangles(1.0, 1.0, 1.0),
        (false, false) => perpendicular_rectangles(1.0, 1.0, 1.0),
    }
}

/// View factors of two rectangles are the closed forms, up to single precision, and the rest of a row escapes.
#[test]
fn two_rectangles_are_closed_forms() {
    for (a, b, c) in [(1.0, 1.0, 1.0), (2.0, 1.0, 1.0), (1.0, 1.0, 0.1), (1.0, 1.0, 10.0), (1e-4, 1e-4, 1e-4)]
    {
        let found = table(&obj([("", flat(a, b, 0.0, true)), ("", flat(a, b, c, false))]), "");
        let exact = opposed_rectangles(a, b, c);
        assert!((found.get("0", "1") - exact).abs() < STORED, "{} not {exact}", found.get("0", "1"));
        assert!((found.escaped[0] - (1.0 - exact)).abs() < STORED);
    }
    for (l, w, h) in [(1.0, 1.0, 1.0), (2.0, 1.0, 1.0), (1.0, 1.0, 2.0), (300.0, 300.0, 1.0)] {
        let wall = vec![[0.0, 0.0, 0.0], [0.0, l, 0.0], [0.0, l, h], [0.0, 0.0, h]];
        let found = table(&obj([("", flat(w, l, 0.0, true)), ("", wall)]), "");
        let exact = perpendicular_rectangles(l, w, h);
        assert!((found.get("0", "1") - exact).abs() < STORED, "{} not {exact}", found.get("0", "1"));
        assert!(
            (found.areas[0] - l * w).abs() < 1e-9 * l * w && (found.areas[1] - l * h).abs() < 1e-9 * l * h
        );
    }
    // A number published with these formulas.
    let opposed = table(&obj([("", flat(1.0, 1.0, 0.0, true)), ("", flat(1.0, 1.0, 1.0, false))]), "");
    assert!((opposed.rows[0][1] - 0.199824895698).abs() < STORED);
}

/// A thin sheet between two squares blocks as much as the closed form says, within 4.5 of the reported standard errors.
#[test]
fn a_blocker_hides_as_much_as_the_closed_form_says() {
    let middle = |up| {
        let mut corners = flat(0.5, 0.5, 0.5, up);
        corners.iter_mut().for_each(|p| (p[0], p[1]) = (p[0] + 0.25, p[1] + 0.25));
        corners
    };
    // A thin sheet: its lower and upper side are faces of their own.
    let scene = obj([
        ("", flat(1.0, 1.0, 0.0, true)),
        ("", flat(1.0, 1.0, 1.0, false)),
        ("", middle(true)),
        ("", middle(false)),
    ]);
    let (here, said) = run(&scene, "--error 2e-4 --pairs pairs.csv --report r.json");
    assert!(!said.contains("same place"), "{said}");
    let found = Table::read(&here, "out.csv");
    let pairs = String::from_utf8(here.read("pairs.csv")).unwrap();
    let mut lines = pairs.lines();
    assert_eq!(lines.next(), Some("from,to,view_factor,standard_error"));
    let mut known = HashMap::new();
    for line in lines {
        let words: Vec<&str> = line.split(',').collect();
        let (f, error): (f64, f64) = (words[2].parse().unwrap(), words[3].parse().unwrap());
        assert_eq!(f, found.get(words[0], words[1]), "{line}");
        known.insert((words[0], words[1]), (f, error));
    }
    assert_eq!(known.len(), found.rows.iter().flatten().filter(|&&f| f > 0.0).count());
    let (f, error) = known[&("0", "1")];
    let exact = opposed_squares_with_blocker(1.0, 1.0, 0.5);
    assert!((f - exact).abs() < 4.5 * error, "{f} ± {error}, not {exact}");
    // This pair has nearly all of the error, in both directions. The RMS is over the six view factors above zero.
    let rms = here.json("r.json")["error"]["rms"].as_f64().unwrap();
    assert!(rms <= 2e-4 && error > 3f64.sqrt() * rms * 0.9, "{rms} {error}");
    assert_eq!(here.json("r.json")["enclosed"], false);
}

/// View factors of a cube's sides follow from those of their parts: whole sides, groups of nine squares, and sums over
/// squares.
#[test]
fn a_cube_is_closed_and_its_parts_sum_up() {
    let whole = table(&obj(cube(1, |_| "")), "");
    let named = |wall: usize| ["g left", "g right", "g front", "g rear", "g floor", "g ceiling"][wall];
    let groups = table(&obj(cube(3, named)), "--by group --error 1e-3");
    assert_eq!(groups.names, WALLS);
    let parts = table(&obj(cube(3, named)), "--error 1e-3");
    assert_eq!((parts.names.len(), &parts.names[53][..]), (54, "53"));
    for i in 0..6 {
        assert_eq!(whole.escaped[i], 0.0);
        assert!((groups.areas[i] - 1.0).abs() < 1e-12);
        for j in 0..6 {
            assert!((whole.rows[i][j] - of_cube(i, j)).abs() < STORED);
            // Nothing blocks, so there is no sampling: unblocked view factors are known to a thousandth.
            assert!((groups.rows[i][j] - of_cube(i, j)).abs() < 1e-3 * of_cube(i, j) + STORED, "{i} {j}");
            let of_part = |k: usize| parts.rows[k][9 * j..9 * j + 9].iter().sum::<f64>();
            let sum = (9 * i..9 * i + 9).map(of_part).sum::<f64>() / 9.0;
            assert!((sum - of_cube(i, j)).abs() < 1e-3 * of_cube(i, j) + STORED, "{i} {j}: {sum}");
        }
    }
}

/// An object of several walls sees itself. Its view factors are area-weighted sums of the two of a cube.
#[test]
fn surfaces_may_see_themselves() {
    // Floor and ceiling are one object. One of the walls has no name.
    let named = |wall: usize| ["o a", "o a", "o b", "o", "o plates", "o plates"][wall];
    let found = table(&obj(cube(1, named)), "--by object");
    assert_eq!(found.names, ["a", "b", "(none)", "plates"]);
    let (opposed, beside) = (of_cube(0, 1), of_cube(0, 2));
    for (from, to, exact) in [
        ("a", "a", opposed),
        ("a", "b", beside),
        ("a", "(none)", beside),
        ("b", "a", 2.0 * beside),
        ("a", "plates", 2.0 * beside),
        ("plates", "plates", opposed),
        ("b", "(none)", opposed),
        ("b", "b", 0.0),
    ] {
        assert!((found.get(from, to) - exact).abs() < 1e-6, "{from} {to}: {} {exact}", found.get(from, to));
    }
}

/// Floor and ceiling of a cube from faces of any shape: their view factors, weighted by area, sum to those of the cube.
/// The tolerance is twice the wanted error.
#[test]
fn faces_of_any_shape_are_surfaces() {
    // The floor is a trapezoid, a triangle, and the remaining L. The ceiling is a hexagon with corners on its edges.
    let mut faces = cube(1, |_| "");
    faces.truncate(4);
    let corners = |list: &[(f64, f64)], z: f64| list.iter().map(|&(x, y)| [x, y, z]).collect::<Vec<_>>();
    faces.push(("", corners(&[(0.0, 0.0), (1.0, 0.0), (0.75, 0.25), (0.0, 0.25)], 0.0)));
    faces.push(("", corners(&[(1.0, 0.0), (1.0, 0.25), (0.75, 0.25)], 0.0)));
    faces.push((
        "",
        corners(&[(0.0, 0.25), (0.5, 0.25), (0.5, 0.5), (1.0, 0.5), (1.0, 1.0), (0.0, 1.0)], 0.0),
    ));
    faces.push(("", corners(&[(0.5, 0.25), (0.75, 0.25), (1.0, 0.25), (1.0, 0.5), (0.5, 0.5)], 0.0)));
    let mut ceiling = corners(&[(0.0, 0.0), (0.5, 0.0), (1.0, 0.0), (1.0, 1.0), (0.3, 1.0), (0.0, 1.0)], 1.0);
    ceiling.reverse();
    faces.push(("", ceiling));
    let found = table(&obj(faces), "--error 1e-5");
    assert_eq!(found.names.len(), 9);
    let areas = [0.21875, 0.03125, 0.625, 0.125];
    for (k, area) in areas.into_iter().enumerate() {
        assert!((found.areas[4 + k] - area).abs() < 1e-12);
        assert_eq!(found.escaped[4 + k], 0.0);
    }
    for (j, wall) in [0, 1, 2, 3, 8].into_iter().zip([0, 1, 2, 3, 5]) {
        let sum: f64 = areas.iter().enumerate().map(|(k, area)| area * found.rows[4 + k][j]).sum();
        assert!((sum - of_cube(4, wall)).abs() < 2e-5, "{wall}: {sum}");
    }
}

#[test]
fn rays_or_the_user_decide_if_a_room_is_enclosed() {
    let closed = obj(cube(1, |_| ""));
    let open = obj(cube(1, |_| "").into_iter().take(5));
    let outward = obj(cube(1, |_| "").into_iter().map(|(b, c)| (b, c.into_iter().rev().collect())));
    let report = |scene: &str, options: &str| {
        let (here, said) = run(scene, &format!("--report r.json {options}"));
        (here.json("r.json"), Table::read(&here, "out.csv"), said)
    };
    // No warning about the missing reflectance.
    let (json, _, said) = report(&closed, "");
    assert_eq!(said, "");
    assert_eq!((&json["enclosed"], &json["look"]["escaped"]), (&true.into(), &0.into()));
    let (json, found, _) = report(&open, "");
    assert_eq!(json["enclosed"], false);
    for wall in 0..5 {
        assert!((found.escaped[wall] - of_cube(wall, 5)).abs() < 1e-6, "{:?}", found.escaped);
    }
    // Declared open, the closed room still loses nothing.
    let (_, found, _) = report(&closed, "--open");
    assert!(found.escaped.iter().all(|&e| e < 1e-6));
    // A room seen from outside.
    let (json, found, _) = report(&outward, "");
    assert!(found.escaped.iter().all(|&e| e == 1.0) && json["non_zeros"] == 0);
    let (json, found, _) = report(&outward, "--side back");
    assert_eq!(json["enclosed"], true);
    assert!((found.rows[0][1] - of_cube(0, 1)).abs() < STORED);
    // Both sides of all walls: the inside as above, the outside sees nothing.
    let (json, found, said) = report(&closed, "--side both");
    assert_eq!(found.names[6..8], ["0 back", "1 back"]);
    assert!(json["enclosed"] == false && !said.contains("backs"), "{said}");
    assert!((found.rows[0][1] - of_cube(0, 1)).abs() < 1e-6 && found.escaped[0] < 1e-6);
    assert!(found.escaped[6..].iter().all(|&e| e == 1.0));
    // An open box that is declared closed is refused.
    let here = Here::new(&open, "");
    let errors = here.fails("view-factors scene.obj -o out.csv --enclosed", 2);
    assert!(errors.contains("error: scene.obj:") && errors.contains("no room is enclosed"), "{errors}");
    // Also if the sampling error is large.
    let errors = here.fails("view-factors scene.obj -o out.csv --enclosed --error 0.1", 2);
    assert!(errors.contains("no room is enclosed"), "{errors}");
    assert!(errors.contains("hint: ") && errors.contains("rays left the room"), "{errors}");
}

/// The lines before a face, and its corners.
type Face = (&'static str, Vec<[f64; 3]>);

/// A box from corner to corner, seen from outside.
fn block(low: [f64; 3], high: [f64; 3]) -> Vec<Face> {
    let place = |p: [f64; 3]| std::array::from_fn(|k| low[k] + (high[k] - low[k]) * p[k]);
    let outward = |corners: Vec<[f64; 3]>| corners.into_iter().rev().map(place).collect();
    cube(1, |_| "").into_iter().map(|(before, corners)| (before, outward(corners))).collect()
}

/// `inspect` and `--enclosed` agree about what is closed, and name the same faces where it is open: a room, one without a wall, with
/// a cube on its floor, with one on the joint of two tiles, and with a hole in the floor beside it.
#[test]
fn inspect_and_enclosed_agree() {
    let cut = |from: f64, to: f64| vec![[from, 0.0, 0.0], [to, 0.0, 0.0], [to, 1.0, 0.0], [from, 1.0, 0.0]];
    let floor = (0..6).find(|&k| cube(1, |_| "")[k].1.iter().all(|p| p[2] == 0.0)).unwrap();
    let with = |floors: &[Vec<[f64; 3]>], block: &[Face]| {
        let mut faces = cube(1, |_| "");
        faces.remove(floor);
        faces.extend(floors.iter().map(|corners| ("", corners.clone())));
        faces.extend_from_slice(block);
        obj(faces)
    };
    let box_on_it = block([0.3, 0.4, 0.0], [0.7, 0.6, 0.3]);
    let cases = [
        ("a room", with(&[cut(0.0, 1.0)], &[]), true),
        ("without a floor", with(&[], &[]), false),
        ("a cube on the floor", with(&[cut(0.0, 1.0)], &box_on_it), true),
        ("a cube on a joint", with(&[cut(0.0, 0.5), cut(0.5, 1.0)], &box_on_it), true),
        ("a slit beside it", with(&[cut(0.0, 0.2), cut(0.21, 1.0)], &box_on_it), false),
    ];
    for (name, scene, is_closed) in cases {
        let here = Here::new(&scene, "");
        here.run("inspect scene.obj --report i.json");
        let inspected = here.json("i.json");
        let state = if is_closed { "yes" } else { "no" };
        assert_eq!(inspected["enclosed"]["enclosed"], state, "{name}: {}", inspected["enclosed"]);
        if is_closed {
            let output =
                here.run("view-factors scene.obj -o out.csv --enclosed --error 1e-2 --report r.json");
            assert_eq!(output.status.code(), Some(0), "{name}: {}", stderr(&output));
            assert_eq!(here.json("r.json")["enclosed"], true, "{name}");
            continue;
        }
        let errors = here.fails("view-factors scene.obj -o out.csv --enclosed --error 1e-2", 2);
        let open = inspected["enclosed"]["open_at"].as_array().unwrap();
        assert!(!open.is_empty(), "{name}");
        for face in open.iter().take(4) {
            let share = 100.0 * face["lost_share"].as_f64().unwrap();
            let named = format!("`{}` ({share:.3} %)", face["face"].as_str().unwrap());
            assert!(errors.contains(&named), "{name}: {named} is not in {errors}");
        }
    }
}

#[test]
fn reversed_walls_and_overlapping_faces_are_reported() {
    let mut faces = cube(1, |_| "");
    faces[5].1.reverse();
    let (_, said) = run(&obj(faces.clone()), "");
    assert!(said.contains("% of the rays hit backs"), "{said}");
    assert!(said.contains("face 5 runs along an edge in the same direction as its neighbour"), "{said}");
    faces[5].1.reverse();
    // The same face once more, from another corner.
    let mut again = faces[4].clone();
    again.1.rotate_left(1);
    faces.push(again);
    let (here, said) = run(&obj(faces.clone()), "");
    assert!(said.contains("faces overlap in one plane"), "{said}");
    assert_eq!(Table::read(&here, "out.csv").names.len(), 6);
    // Half of the floor once more replaces that half.
    faces[6].1 = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.5, 0.0], [0.0, 0.5, 0.0]];
    let (here, said) = run(&obj(faces), "");
    assert!(said.contains("faces overlap in one plane"), "{said}");
    assert_eq!(Table::read(&here, "out.csv").areas[4..], [0.5, 1.0, 0.5]);
}

/// A box inside another at a distance of 0.01: rows close although few rays pass the gap and escape past the edges.
#[test]
fn boxes_one_in_the_other_close() {
    let mut faces = cube(1, |_| "");
    for (_, mut corners) in cube(1, |_| "") {
        corners.iter_mut().flatten().for_each(|x| *x = 0.01 + 0.98 * *x);
        corners.reverse();
        faces.push(("", corners));
    }
    for error in ["1e-2", "1e-4"] {
        let (here, said) = run(&obj(faces.clone()), &format!("--error {error} --report r.json"));
        let off = here.json("r.json")["row_sum_deviation"]["after"].as_f64().unwrap();
        assert!(off < 1e-12 && said.is_empty(), "{off}: {said}");
    }
}

/// All formats hold the same numbers.
#[test]
fn tables_in_other_formats() {
    let scene = obj(cube(1, |_| "").into_iter().take(5));
    let csv = table(&scene, "--up z --sky --ground");
    assert_eq!(csv.names, ["0", "1", "2", "3", "4", "sky", "ground"]);
    let here = Here::new(&scene, "");
    for name in ["out.npy", "out.npz", "out.mtx"] {
        let output = here.run(&format!("view-factors scene.obj -o {name} --quiet --up z --sky --ground"));
        assert_eq!((output.status.code(), stderr(&output).as_str()), (Some(0), ""));
    }
    let all: Vec<f64> = csv.rows.concat();
    let npy = here.read("out.npy");
    assert_eq!(npy[..8], *b"\x93NUMPY\x01\x00");
    let start = 10 + usize::from(u16::from_le_bytes([npy[8], npy[9]]));
    assert!(start % 64 == 0 && String::from_utf8_lossy(&npy[10..start]).contains("(7, 7)"));
    let numbers =
        |bytes: &[u8]| bytes.chunks(8).map(|c| f64::from_le_bytes(c.try_into().unwrap())).collect::<Vec<_>>();
    assert_eq!(numbers(&npy[start..]), all);
    // Rows and columns count from 1.
    let text = String::from_utf8(here.read("out.mtx")).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("%%MatrixMarket matrix coordinate real general"));
    let mut lines = lines.filter(|line| !line.starts_with('%'));
    let count = all.iter().filter(|&&f| f > 0.0).count();
    assert_eq!(lines.next().unwrap(), format!("7 7 {count}"));
    let mut found = vec![0.0; 49];
    for line in lines {
        let words: Vec<&str> = line.split(' ').collect();
        let [i, j] = [0, 1].map(|k| words[k].parse::<usize>().unwrap() - 1);
        found[7 * i + j] = words[2].parse().unwrap();
    }
    assert_eq!(found, all);
    // An archive that SciPy reads: its last member has the values, and it ends with a directory of five.
    let npz = here.read("out.npz");
    let values: Vec<u8> = all.iter().filter(|&&f| f > 0.0).flat_map(|f| f.to_le_bytes()).collect();
    assert!(npz.windows(values.len()).any(|window| window == values));
    let end = &npz[npz.len() - 22..];
    assert_eq!((&end[..4], end[10]), (&b"PK\x05\x06"[..], 5));
    for member in ["indices.npy", "indptr.npy", "format.npy", "shape.npy", "data.npy"] {
        assert_eq!(npz.windows(member.len()).filter(|w| *w == member.as_bytes()).count(), 2, "{member}");
    }
    assert!(here.fails("view-factors scene.obj -o out.txt", 2).contains("unknown kind of table"));
}

/// A unit cube without a lid: the light that leaves it upward reaches the sky, as much as would reach the lid.
#[test]
fn the_sky_and_the_ground_are_surfaces() {
    let (here, _) = run(&obj(cube(1, |_| "").into_iter().take(5)), "--up z --sky --report r.json");
    let text = String::from_utf8(here.read("out.csv")).unwrap();
    assert!(text.lines().last().unwrap().starts_with("sky,inf,0,0"), "{text}");
    let report = here.json("r.json");
    for wall in 0..5 {
        let surface = &report["surfaces"][wall];
        let get = |name: &str| surface[name].as_f64().unwrap();
        let exact = of_cube(wall, 5);
        assert!((get("escaped") - exact).abs() < 1e-6 && get("escaped_standard_error") < 2e-5);
        assert!(
            (get("sky") - exact).abs() < 4.5 * get("sky_standard_error") && get("sky_standard_error") < 2e-4
        );
        assert!((get("backs") + get("sky") + get("ground") - get("escaped")).abs() < 1e-12);
    }
}

#[test]
fn names_reach_the_table_as_they_are() {
    let scene = obj([("g a,b", flat(1.0, 1.0, 0.0, true)), ("g \"c\" d", flat(1.0, 1.0, 1.0, false))]);
    let (here, _) = run(&scene, "--by group");
    let text = String::from_utf8(here.read("out.csv")).unwrap();
    assert!(text.starts_with("surface,area,escaped,\"a,b\",\"\"\"c\"\" d\"\n\"a,b\",1,"), "{text}");
    let materials = "mtllib scene.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 0 1 1\n\
                     usemtl warm\nf 1 2 3\nusemtl cold\nf 6 5 4\n";
    let here = Here::new(materials, "newmtl warm\nnewmtl cold\n");
    let output = here.run("view-factors scene.obj -o out.csv --quiet --by material");
    assert_eq!((output.status.code(), stderr(&output).as_str()), (Some(0), ""));
    assert_eq!(Table::read(&here, "out.csv").names, ["warm", "cold"]);
}

/// The same seed gives the same table for any number of threads, and a summary goes to stdout.
#[test]
fn the_same_bytes_for_any_number_of_threads_and_a_summary_on_stdout() {
    let mut faces = cube(1, |_| "");
    for (_, mut corners) in cube(1, |_| "") {
        corners.iter_mut().flatten().for_each(|x| *x = 0.3 + 0.3 * *x);
        corners.reverse();
        faces.push(("", corners));
    }
    let here = Here::new(&obj(faces), "");
    let bytes = |options: &str| {
        let output = here.run(&format!("view-factors scene.obj -o out.csv --error 1e-3 {options}"));
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let said = String::from_utf8(output.stdout).unwrap();
        assert!(said.contains("enclosed      yes") && said.contains("12 by face"), "{said}");
        here.read("out.csv")
    };
    let one = bytes("--threads 1");
    assert!(one == bytes("--threads 3") && one != bytes("--seed 1"));
}

#[test]
fn a_ply_has_faces_too() {
    let here = Here::new("", "");
    let mut ply = String::from(
        "ply\nformat ascii 1.0\nelement vertex 24\nproperty double x\nproperty double y\nproperty double z\n\
         element face 6\nproperty list uchar int vertex_indices\nend_header\n",
    );
    let walls = cube(1, |_| "");
    walls.iter().flat_map(|(_, wall)| wall).for_each(|[x, y, z]| ply += &format!("{x} {y} {z}\n"));
    (0..6).for_each(|k| ply += &format!("4 {} {} {} {}\n", 4 * k, 4 * k + 1, 4 * k + 2, 4 * k + 3));
    fs::write(here.path("room.ply"), ply).unwrap();
    let output = here.run("view-factors room.ply -o out.csv --quiet");
    assert_eq!((output.status.code(), stderr(&output).as_str()), (Some(0), ""));
    let found = Table::read(&here, "out.csv");
    assert_eq!(found.names.len(), 6);
    assert!((found.rows[0][1] - of_cube(0, 1)).abs() < STORED);
    assert!(here.fails("view-factors room.ply --by group", 2).contains("no face belongs to a named group"));
}

#[test]
fn impossible_requests_are_refused_with_nothing_left_behind() {
    let here = Here::new(&obj(cube(1, |_| "")), "");
    fs::write(here.path("bad.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n").unwrap();
    for (arguments, said) in [
        ("missing.obj -o out.csv", "error: missing.obj: "),
        ("bad.obj -o out.csv", "error: bad.obj:4: "),
        ("scene.obj -o scene.obj", "replace the input"),
        ("scene.obj -o other.mtl", "may not have the name"),
        ("scene.obj -o other.dat", "unknown kind of table"),
        ("scene.obj -o a.csv --pairs a.csv", "the same file"),
        ("scene.obj -o nowhere/a.csv", "nowhere/a.csv"),
        ("scene.obj --error 0", "between 1e-7 and 0.1"),
        ("scene.obj --open --enclosed", "--enclosed"),
        ("scene.obj --by group", "no face belongs to a named group"),
        ("scene.obj --memory 1k", "--memory allows"),
        ("", "SCENE"),
    ] {
        let errors = here.fails(&format!("view-factors {arguments}"), 2);
        assert!(errors.contains(said), "{arguments}: {errors}");
    }
}

/// Faces of a PLY are grouped by a number that each has. A property that no face has is refused.
#[test]
fn faces_of_a_ply_are_grouped_by_a_property() {
    let here = Here::new("", "");
    let mut ply = String::from(
        "ply\nformat ascii 1.0\nelement vertex 24\nproperty double x\nproperty double y\nproperty double z\n\
         element face 6\nproperty list uchar int vertex_indices\nproperty uchar red\nproperty uchar green\n\
         property uchar blue\nproperty int zone\nend_header\n",
    );
    let walls = cube(1, |_| "");
    walls.iter().flat_map(|(_, wall)| wall).for_each(|[x, y, z]| ply += &format!("{x} {y} {z}\n"));
    for k in 0..6 {
        ply += &format!("4 {} {} {} {} 9 9 9 {}\n", 4 * k, 4 * k + 1, 4 * k + 2, 4 * k + 3, 7 + k / 2);
    }
    fs::write(here.path("room.ply"), ply).unwrap();
    let output = here.run("view-factors room.ply -o out.csv --quiet --by property:zone");
    assert_eq!((output.status.code(), stderr(&output).as_str()), (Some(0), ""));
    let found = Table::read(&here, "out.csv");
    assert_eq!((found.names, found.areas), (vec!["7".into(), "8".into(), "9".into()], vec![2.0; 3]));
    // Two opposite walls are one surface.
    assert!((found.rows[0][0] - of_cube(0, 1)).abs() < STORED);
    let errors = here.fails("view-factors room.ply --by property:colour", 2);
    assert!(errors.contains("no face has a property `colour`"), "{errors}");
    assert!(here.fails("view-factors room.ply --by zone", 2).contains("property:NAME"));
}

/// A material that only blocks has no row. The floor sees the ceiling past it as the closed form says, within some
/// standard errors.
#[test]
fn an_obstruction_has_no_row() {
    let mut faces =
        vec![("usemtl plate", flat(1.0, 1.0, 0.0, true)), ("usemtl plate", flat(1.0, 1.0, 1.0, false))];
    let middle = |z: f64| vec![[0.2, 0.2, z], [0.8, 0.2, z], [0.8, 0.8, z], [0.2, 0.8, z]];
    faces.push(("usemtl tree", middle(0.5)));
    let text = format!("mtllib scene.mtl\n{}", obj(faces));
    let here = Here::new(&text, "newmtl plate\nnewmtl tree\n");
    let output = here.run("view-factors scene.obj -o out.csv --quiet --obstruct tree --error 1e-3");
    assert_eq!((output.status.code(), stderr(&output).as_str()), (Some(0), ""));
    let found = Table::read(&here, "out.csv");
    assert_eq!(found.names, ["0", "1"]);
    assert!((found.rows[0][1] - opposed_squares_with_blocker(1.0, 1.0, 0.6)).abs() < 5e-3);
    let errors = here.fails("view-factors scene.obj --obstruct hedge", 2);
    assert!(errors.contains("--obstruct") && errors.contains("hedge"), "{errors}");
}

#[test]
fn faces_that_are_not_flat_are_named() {
    let mut faces = cube(1, |_| "");
    faces[2].1[1][1] -= 0.01;
    let (_, said) = run(&obj(faces), "--open");
    assert!(said.contains("face 2 has corners out of its plane"), "{said}");
}
