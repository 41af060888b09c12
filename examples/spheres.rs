//! Writes a scene of a row of spheres on a floor under a lamp. Each has its own material, to try models of reflection.
//!
//!     cargo run --release --example spheres -- spheres.obj

use std::{
    f64::consts::PI,
    fmt::Write as _,
    fs, io,
    path::{Path, PathBuf},
};

/// The materials, in the order of their spheres.
const NAMES: [&str; 8] = ["lambert", "mirror", "phong", "blinn-phong", "ward", "beckmann", "ggx", "plastic"];

/// Facets between the poles, and half of the facets around the axis. Normals are per facet, so there must be many.
const ROWS: usize = 160;

fn main() -> io::Result<()> {
    let path: PathBuf = std::env::args_os().nth(1).map_or_else(|| "spheres.obj".into(), PathBuf::from);
    let library = path.with_extension("mtl");
    let name = library.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let mut obj = Obj { text: format!("mtllib {name}\n"), vertices: 0 };
    let half = NAMES.len() as f64 + 3.0;
    obj.quad("floor", [[-half, 0.0, -4.0], [-half, 0.0, 6.0], [half, 0.0, 6.0], [half, 0.0, -4.0]]);
    obj.quad("wall", [[-half, 0.0, -4.0], [half, 0.0, -4.0], [half, 8.0, -4.0], [-half, 8.0, -4.0]]);
    obj.quad("lamp", [[-6.0, 7.0, 1.0], [-6.0, 7.0, 4.0], [6.0, 7.0, 4.0], [6.0, 7.0, 1.0]].map(flip));
    for (k, name) in NAMES.iter().enumerate() {
        let x = 2.2 * (k as f64 - 0.5 * (NAMES.len() - 1) as f64);
        obj.sphere(name, [x, 1.0, 0.0]);
    }
    fs::write(&path, obj.text)?;
    fs::write(&library, materials())?;
    println!("{}", Path::new(&path).display());
    Ok(())
}

/// Mirrors a corner, which reverses the order of corners: the lamp faces down.
fn flip([x, y, z]: [f64; 3]) -> [f64; 3] {
    [-x, y, z]
}

fn materials() -> String {
    let mut text = String::from("newmtl floor\nKd 0.4 0.4 0.4\nnewmtl wall\nKd 0.3 0.4 0.55\n");
    text.push_str("newmtl lamp\nKd 0 0 0\nKe 12 11 10\n");
    for name in NAMES {
        let _ = writeln!(text, "newmtl {name}\nKd 0.25 0.1 0.05");
    }
    text
}

struct Obj {
    text: String,
    vertices: usize,
}

impl Obj {
    fn vertex(&mut self, [x, y, z]: [f64; 3]) {
        let _ = writeln!(self.text, "v {x:.6} {y:.6} {z:.6}");
        self.vertices += 1;
    }

    fn quad(&mut self, material: &str, corners: [[f64; 3]; 4]) {
        let first = self.vertices + 1;
        corners.into_iter().for_each(|c| self.vertex(c));
        let _ = writeln!(self.text, "usemtl {material}\nf {first} {} {} {}", first + 1, first + 2, first + 3);
    }

    fn sphere(&mut self, material: &str, centre: [f64; 3]) {
        let (first, columns) = (self.vertices + 1, 2 * ROWS);
        for row in 0..=ROWS {
            let (sin, cos) = (PI * row as f64 / ROWS as f64).sin_cos();
            for column in 0..columns {
                let (s, c) = (2.0 * PI * column as f64 / columns as f64).sin_cos();
                self.vertex([centre[0] + sin * s, centre[1] + cos, centre[2] + sin * c]);
            }
        }
        let _ = writeln!(self.text, "usemtl {material}");
        for row in 0..ROWS {
            for column in 0..columns {
                let at = |r: usize, c: usize| first + r * columns + c % columns;
                let mut corners =
                    vec![at(row, column), at(row + 1, column), at(row + 1, column + 1), at(row, column + 1)];
                // At the poles one side has no length.
                match row {
                    0 => drop(corners.pop()),
                    r if r + 1 == ROWS => drop(corners.remove(2)),
                    _ => {}
                }
                let corners: Vec<String> = corners.iter().map(usize::to_string).collect();
                let _ = writeln!(self.text, "f {}", corners.join(" "));
            }
        }
    }
}
