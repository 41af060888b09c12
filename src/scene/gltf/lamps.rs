//! Double-sided lamps: the backs of open surfaces that emit.

use std::collections::HashMap;

use crate::scene::{Scene, Triangle};

/// Adds the backs of triangles that emit from both sides, unless the triangles belong to a closed body. Returns the
/// number of added triangles.
pub fn double(scene: &mut Scene, both_sides: &[u32]) -> usize {
    let open = open_parts(scene, both_sides);
    for &t in &open {
        let t = t as usize;
        let turned = |corners: [u32; 3]| [corners[0], corners[2], corners[1]];
        let triangle = scene.triangles[t];
        scene.triangles.push(Triangle { vertices: turned(triangle.vertices), ..triangle });
        for texcoords in [&mut scene.texcoords, &mut scene.emission_texcoords] {
            if let Some(&[a, b, c]) = texcoords.get(t) {
                texcoords.push([a, c, b]);
            }
        }
        if let Some(&[a, b, c]) = scene.colours.get(t) {
            scene.colours.push([a, c, b]);
        }
    }
    open.len()
}

/// The triangles of open parts. A part is connected, and it is open if one of its edges does not have exactly one
/// triangle in each direction.
fn open_parts(scene: &Scene, triangles: &[u32]) -> Vec<u32> {
    let mut edges: HashMap<(u32, u32), Vec<usize>> = HashMap::new();
    let directed = |k: usize| {
        let [a, b, c] = scene.triangles[triangles[k] as usize].vertices;
        [(a, b), (b, c), (c, a)]
    };
    for k in 0..triangles.len() {
        directed(k).into_iter().for_each(|edge| edges.entry(edge).or_default().push(k));
    }
    let of = |edge: (u32, u32)| edges.get(&edge).map_or(&[][..], |there| there);
    let mut part_of = vec![usize::MAX; triangles.len()];
    let mut is_open = Vec::new();
    for first in 0..triangles.len() {
        if part_of[first] != usize::MAX {
            continue;
        }
        let part = is_open.len();
        is_open.push(false);
        part_of[first] = part;
        let mut waiting = vec![first];
        while let Some(k) = waiting.pop() {
            for (a, b) in directed(k) {
                let (same, other) = (of((a, b)), of((b, a)));
                is_open[part] |= same.len() != 1 || other.len() != 1;
                for &next in same.iter().chain(other) {
                    if part_of[next] == usize::MAX {
                        part_of[next] = part;
                        waiting.push(next);
                    }
                }
            }
        }
    }
    (0..triangles.len()).filter(|&k| is_open[part_of[k]]).map(|k| triangles[k]).collect()
}
