//! The choice of the patches and sides that a mesh shows.
//!
//! A viewer that draws both sides of a face cannot decide between two faces at the same place: rounding makes it show
//! one face at some pixels and the other face at others. So a mesh for such viewers has one face at each place. It
//! shows the side of a patch that has more light. If faces of the scene lie on each other with opposite orientation,
//! like the bottom of a box on a floor, the mesh leaves out the darker surface as far as the brighter one covers it.

use std::collections::{BTreeMap, HashMap};

use crate::{
    patch::{DisjointSets, Patches},
    scene::{
        Scene,
        overlaps::{covered, in_one_plane},
    },
    solve::Light,
    tone::{luminance, rgb},
};

/// A patch counts as covered if at most this share of it is uncovered. It allows for faces that are slightly off their
/// common plane.
const UNCOVERED: f64 = 1e-3;

/// For each unknown, whether the mesh shows it. The mesh shows a patch or its back, whichever has the larger radiosity.
/// If their radiosities are equal, the larger irradiance decides, and then the front is chosen.
pub(super) fn lit_sides(scene: &Scene, patches: &Patches, light: Light<'_>) -> Vec<bool> {
    let channels = patches.channels();
    let of = |values: &[f64], i: usize| luminance(rgb(&values[i * channels..][..channels]));
    let brightness = |i: usize| [of(light.radiosity, i), of(light.irradiance, i)];
    let mut shown = vec![false; patches.len()];
    for i in 0..patches.fronts() {
        let back = patches.back_of(i).map(|back| back as usize);
        shown[back.filter(|&back| brightness(back) > brightness(i)).unwrap_or(i)] = true;
    }
    let pairs = in_one_plane(scene);
    let power = |t: u32| {
        let shown = sides(patches, t).filter(|&i| shown[i]);
        shown.fold([0.0; 2], |sum, i| {
            let (area, brightness) = (patches.area(i), brightness(i));
            std::array::from_fn(|k| sum[k] + area * brightness[k])
        })
    };
    let order = order(scene, &pairs, power);
    let place: HashMap<u32, usize> = order.iter().copied().zip(0..).collect();
    let mut above: HashMap<u32, Vec<u32>> = HashMap::new();
    for [s, t] in pairs {
        let (upper, lower) = if place[&s] < place[&t] { (s, t) } else { (t, s) };
        above.entry(lower).or_default().push(upper);
    }
    for (t, above) in above {
        for i in sides(patches, t) {
            let corners = patches.corners(scene, i);
            let share: f64 = above.iter().map(|&upper| covered(corners, scene.corners(upper as usize))).sum();
            shown[i] &= share < 1.0 - UNCOVERED;
        }
    }
    shown
}

/// The patches of both sides of a triangle.
fn sides(patches: &Patches, t: u32) -> impl Iterator<Item = usize> {
    let backs = |i| patches.back_of(i).map(|back| back as usize);
    patches.fronts_of(t as usize).flat_map(move |i| [Some(i), backs(i)]).flatten()
}

/// All triangles that lie on others, in the order of precedence. In each stack of such triangles, the orientation with
/// more power comes first. The decision is for the whole stack: if single triangles decided, two sheets whose
/// quadrangles are cut along different diagonals would each lose one half.
fn order(scene: &Scene, pairs: &[[u32; 2]], power: impl Fn(u32) -> [f64; 2]) -> Vec<u32> {
    let mut triangles: Vec<u32> = pairs.iter().flatten().copied().collect();
    triangles.sort_unstable();
    triangles.dedup();
    let at = |t: u32| triangles.binary_search(&t).expect("it is in a pair");
    let mut sets = DisjointSets::new(triangles.len());
    pairs.iter().for_each(|&[s, t]| sets.unite(at(s), at(t)));
    let (numbers, _) = sets.numbers();
    let mut stacks: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (&t, &number) in triangles.iter().zip(&numbers) {
        stacks.entry(number).or_default().push(t);
    }
    let in_order = |stack: Vec<u32>| {
        let normal = scene.normal(stack[0] as usize);
        let (one_way, other): (Vec<u32>, Vec<u32>) =
            stack.into_iter().partition(|&t| scene.normal(t as usize).dot(normal) > 0.0);
        let total = |triangles: &[u32]| {
            triangles
                .iter()
                .map(|&t| power(t))
                .fold([0.0; 2], |sum, power| [sum[0] + power[0], sum[1] + power[1]])
        };
        let other_first = total(&other) > total(&one_way);
        if other_first { [other, one_way] } else { [one_way, other] }.concat()
    };
    stacks.into_values().flat_map(in_order).collect()
}
