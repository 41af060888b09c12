//! Faces that overlap in one plane and face the same way: a lamp flush with the ceiling, a rug on the floor, a decal.
//!
//! One of such faces is in front and hides the others. The reader cuts the hidden parts away. Every method then works
//! on surfaces that do not overlap, so all methods agree, and areas, means and emitted power count visible surface
//! only. A depth priority at ray hits would leave partly hidden patches, and their areas, means and shares of rays
//! would each need a special rule.
//!
//! The rule, in this order:
//! 1. a face that emits is in front of one that does not;
//! 2. the smaller surface is in front, where a surface is all triangles of one material that share edges and lie in one
//!    plane;
//! 3. the surface that comes first in the file is in front.
//!
//! `pairs` finds the faces and `overlay` cuts them. Cuts end at new vertices on edges. Every triangle with such an edge
//! gets these vertices too, so that there are no cracks between neighbours.

mod overlay;
mod pairs;

use std::collections::{BTreeMap, BTreeSet, HashMap};

use super::{Scene, cutting, triangle_area};
use overlay::Overlay;

/// The surface of one material that was cut away because it lies behind other faces in one plane.
#[derive(Debug, Clone, PartialEq)]
pub struct Hidden {
    /// Name of the material.
    pub material: String,
    /// Names of the materials in front of it.
    pub behind: Vec<String>,
    /// Area that was cut away, in the file's unit squared.
    pub area: f64,
}

impl std::fmt::Display for Hidden {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Hidden { material, behind, area } = self;
        let behind: Vec<String> = behind.iter().map(|name| format!("`{name}`")).collect();
        write!(
            f,
            "faces overlap in one plane: an area of {area:.4e} of material `{material}` lies behind {} and is left out",
            behind.join(", ")
        )
    }
}

/// Cuts away hidden surface. The triangles keep their order: the rest of a triangle takes its place.
pub(super) fn resolve(scene: &mut Scene) -> Vec<Hidden> {
    let pairs = pairs::find(scene, pairs::Facing::Same);
    if pairs.is_empty() {
        return Vec::new();
    }
    let ranks = ranks(scene);
    let mut components = components(&pairs);
    weld(scene, &components);
    let mut hidden = HashMap::new();
    let mut left: HashMap<u32, Vec<[u32; 3]>> = HashMap::new();
    let (mut chains, mut inner) = (Vec::new(), Vec::new());
    for component in &mut components {
        component.members.sort_by_key(|&t| ranks[t as usize]);
        let overlay = Overlay::new(scene, &component.members, component.tolerance);
        for (&t, pieces) in component.members.iter().zip(overlay.left) {
            let Some(pieces) = pieces else { continue };
            let corners = |piece: &[u32; 3]| piece.map(|v| scene.vertices[v as usize]);
            let area: f64 = pieces.iter().map(|piece| triangle_area(corners(piece))).sum();
            hidden.insert(t, (scene.area(t as usize) - area).max(0.0));
            left.insert(t, pieces);
        }
        chains.extend(overlay.chains);
        inner.extend(overlay.inner);
    }
    let list = by_material(scene, &pairs, &ranks, &hidden);
    let cuts = cutting::cuts(scene, chains, inner);
    cutting::replace(scene, &left, &cuts);
    list
}

/// Pairs of triangles that overlap in one plane, whether they face the same way or opposite ways.
pub(crate) fn in_one_plane(scene: &Scene) -> Vec<[u32; 2]> {
    pairs::find(scene, pairs::Facing::Any).into_iter().map(|pair| pair.triangles).collect()
}

pub(crate) use pairs::covered;

/// Triangles that are connected by overlaps.
struct Component {
    members: Vec<u32>,
    /// Points closer than this count as one.
    tolerance: f64,
}

fn components(pairs: &[pairs::Pair]) -> Vec<Component> {
    let mut sets = Sets::default();
    pairs.iter().for_each(|pair| sets.join(pair.triangles[0], pair.triangles[1]));
    let mut found: BTreeMap<u32, Component> = BTreeMap::new();
    let mut members: Vec<u32> = pairs.iter().flat_map(|pair| pair.triangles).collect();
    members.sort_unstable();
    members.dedup();
    for t in members {
        let new = || Component { members: Vec::new(), tolerance: 0.0 };
        found.entry(sets.first(t)).or_insert_with(new).members.push(t);
    }
    for pair in pairs {
        let component = found.get_mut(&sets.first(pair.triangles[0])).expect("every pair is in a component");
        component.tolerance = component.tolerance.max(pair.tolerance);
    }
    found.into_values().collect()
}

/// Disjoint sets of numbers, each identified by its smallest member.
#[derive(Default)]
struct Sets(HashMap<u32, u32>);

impl Sets {
    fn first(&mut self, x: u32) -> u32 {
        let mut root = x;
        while let Some(&up) = self.0.get(&root) {
            root = up;
        }
        // Path compression.
        let mut at = x;
        while at != root {
            at = self.0.insert(at, root).unwrap_or(root);
        }
        root
    }

    fn join(&mut self, x: u32, y: u32) {
        let (x, y) = (self.first(x), self.first(y));
        if x != y {
            self.0.insert(x.max(y), x.min(y));
        }
    }
}

/// The order of triangles at one place. The smallest rank is in front.
type Rank = (bool, u32, u32, u64, u32);

fn ranks(scene: &Scene) -> Vec<Rank> {
    let surfaces = surfaces(scene);
    let mut areas = vec![0.0; surfaces.len()];
    (0..surfaces.len()).for_each(|t| areas[surfaces[t] as usize] += scene.area(t));
    let sizes = sizes(&areas);
    let rank = |t: usize| {
        let surface = surfaces[t];
        // Positive numbers and their bits have the same order.
        (!scene.emits(t), sizes[surface as usize], surface, scene.area(t).to_bits(), t as u32)
    };
    (0..surfaces.len()).map(rank).collect()
}

/// The ranks of areas. Areas that differ by rounding only share a rank.
fn sizes(areas: &[f64]) -> Vec<u32> {
    // Coordinates of six digits give areas of about five digits.
    const SAME: f64 = 1.0 + 1e-4;
    let mut order: Vec<usize> = (0..areas.len()).collect();
    order.sort_by(|&i, &j| areas[i].total_cmp(&areas[j]));
    let (mut sizes, mut place, mut least) = (vec![0; areas.len()], 0, 0.0);
    for i in order {
        if areas[i] > least * SAME {
            (place, least) = (place + 1, areas[i]);
        }
        sizes[i] = place;
    }
    sizes
}

/// The first triangle of each triangle's surface. A surface is all triangles of one material that share edges and lie
/// in one plane.
pub(super) fn surfaces(scene: &Scene) -> Vec<u32> {
    /// Cosine of the largest angle between neighbours in one plane. Coordinates are rounded.
    const FLAT: f64 = 1.0 - 1e-6;
    let mut edges: Vec<(u32, u32, u32)> = Vec::with_capacity(3 * scene.triangles.len());
    for (t, triangle) in scene.triangles.iter().enumerate() {
        let [a, b, c] = triangle.vertices;
        edges.extend([(a, b), (b, c), (c, a)].map(|(p, q)| (p.min(q), p.max(q), t as u32)));
    }
    edges.sort_unstable();
    let mut sets = Sets::default();
    for edge in edges.chunk_by(|e, f| (e.0, e.1) == (f.0, f.1)) {
        for pair in edge.windows(2) {
            let [s, t] = [pair[0].2 as usize, pair[1].2 as usize];
            let same = scene.triangles[s].material == scene.triangles[t].material;
            if same && scene.normal(s).dot(scene.normal(t)) > FLAT {
                sets.join(s as u32, t as u32);
            }
        }
    }
    (0..scene.triangles.len() as u32).map(|t| sets.first(t)).collect()
}

/// Joins vertices of a component that lie at one place. This changes all triangles of the scene, so that neighbours
/// stay connected.
fn weld(scene: &mut Scene, components: &[Component]) {
    let mut same = Sets::default();
    for component in components {
        let mut vertices: Vec<u32> =
            component.members.iter().flat_map(|&t| scene.triangles[t as usize].vertices).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let at = |v: u32| scene.vertices[v as usize];
        vertices.sort_by(|&v, &w| at(v).x.total_cmp(&at(w).x));
        for (k, &v) in vertices.iter().enumerate() {
            let near = vertices[k + 1..].iter().take_while(|&&w| at(w).x - at(v).x <= component.tolerance);
            for &w in near.filter(|&&w| at(v).distance(at(w)) <= component.tolerance) {
                same.join(v, w);
            }
        }
    }
    if same.0.is_empty() {
        return;
    }
    for triangle in &mut scene.triangles {
        triangle.vertices = triangle.vertices.map(|v| same.first(v));
    }
}

/// The hidden surfaces, by material, in the order of the scene.
fn by_material(
    scene: &Scene,
    pairs: &[pairs::Pair],
    ranks: &[Rank],
    hidden: &HashMap<u32, f64>,
) -> Vec<Hidden> {
    let material = |t: u32| scene.triangles[t as usize].material;
    let mut areas: BTreeMap<u32, f64> = BTreeMap::new();
    let mut triangles: Vec<u32> = hidden.keys().copied().collect();
    triangles.sort_unstable();
    for t in triangles {
        // The area of a triangle that only got new vertices on its edges changes by rounding.
        if hidden[&t] > 1e-9 * scene.area(t as usize) {
            *areas.entry(material(t)).or_default() += hidden[&t];
        }
    }
    let mut fronts: BTreeMap<u32, BTreeSet<u32>> = BTreeMap::new();
    for pair in pairs {
        let [s, t] = pair.triangles;
        let (front, back) = if ranks[s as usize] < ranks[t as usize] { (s, t) } else { (t, s) };
        fronts.entry(material(back)).or_default().insert(material(front));
    }
    let name = |m: u32| scene.materials[m as usize].name.clone();
    // A material in front of all others only changes by the rounding of its outline.
    let of_material = |(m, area): (u32, f64)| {
        let behind = fronts.get(&m)?.iter().map(|&front| name(front)).collect();
        Some(Hidden { material: name(m), behind, area })
    };
    areas.into_iter().filter_map(of_material).collect()
}
