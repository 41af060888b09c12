//! Gives the two sides of contacts separate vertices.

use std::collections::{HashMap, HashSet};

use crate::scene::Scene;

/// Gives the triangles on each side of these edges separate vertices at the same places. A vertex at the end of a line
/// stays one vertex if the triangles around it are connected by other edges.
pub(super) fn part(scene: &mut Scene, edges: &HashSet<[u32; 2]>) {
    let mut round: HashMap<u32, Vec<u32>> = edges.iter().flatten().map(|&v| (v, Vec::new())).collect();
    for (t, triangle) in scene.triangles.iter().enumerate() {
        for v in triangle.vertices {
            round.entry(v).and_modify(|round| round.push(t as u32));
        }
    }
    let mut vertices: Vec<(u32, Vec<u32>)> = round.into_iter().collect();
    vertices.sort_unstable();
    let mut renamed = Vec::new();
    for (v, round) in vertices {
        for (k, fan) in fans(scene, v, &round, edges).into_iter().enumerate() {
            if k > 0 {
                scene.vertices.push(scene.vertices[v as usize]);
                renamed.extend(fan.into_iter().map(|t| (t, v, scene.vertices.len() as u32 - 1)));
            }
        }
    }
    for (t, from, to) in renamed {
        let vertices = &mut scene.triangles[t as usize].vertices;
        *vertices = vertices.map(|v| if v == from { to } else { v });
    }
}

/// The triangles around a vertex, grouped into fans. Triangles that share an edge are in one fan unless the edge is a
/// contact.
fn fans(scene: &Scene, v: u32, round: &[u32], contacts: &HashSet<[u32; 2]>) -> Vec<Vec<u32>> {
    let others = |t: u32| scene.triangles[t as usize].vertices.into_iter().filter(move |&w| w != v);
    let mut by_edge: HashMap<u32, Vec<usize>> = HashMap::new();
    for (k, &t) in round.iter().enumerate() {
        for w in others(t).filter(|&w| !contacts.contains(&[v.min(w), v.max(w)])) {
            by_edge.entry(w).or_default().push(k);
        }
    }
    let mut fan_of = vec![usize::MAX; round.len()];
    let mut fans = Vec::new();
    for start in 0..round.len() {
        if fan_of[start] != usize::MAX {
            continue;
        }
        let (mut fan, mut open) = (Vec::new(), vec![start]);
        fan_of[start] = fans.len();
        while let Some(k) = open.pop() {
            fan.push(round[k]);
            for &next in others(round[k]).filter_map(|w| by_edge.get(&w)).flatten() {
                if fan_of[next] == usize::MAX {
                    fan_of[next] = fans.len();
                    open.push(next);
                }
            }
        }
        fans.push(fan);
    }
    fans
}
