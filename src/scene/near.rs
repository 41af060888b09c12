//! Finds triangles of a scene that are near each other.

use obvhs::{
    BvhBuildParams, aabb::Aabb, bvh2::Bvh2, bvh2::builder::build_bvh2, ploc::PlocSearchDistance,
    ploc::SortPrecision,
};
use rayon::prelude::*;

/// Parameters of the hierarchy. They are those for rays (see `trace::bvh`), but without reinsertion: its time does not
/// pay off with one query per box.
const BUILD: BvhBuildParams = BvhBuildParams {
    pre_split: false,
    ploc_search_distance: PlocSearchDistance::Low,
    search_depth_threshold: 0,
    reinsertion_batch_ratio: 0.0,
    post_collapse_reinsertion_batch_ratio_multiplier: 0.0,
    sort_precision: SortPrecision::U64,
    max_prims_per_leaf: 1,
    collapse_traversal_cost: 1.0,
};

/// Calls `meet` for each pair of boxes that overlap, with their indices in ascending order. Returns everything that
/// `meet` appends. The order of the list has no meaning.
pub(super) fn overlapping<T: Send>(
    boxes: &[Aabb],
    meet: impl Fn(usize, usize, &mut Vec<T>) + Sync,
) -> Vec<T> {
    let tree = build_bvh2(boxes, BUILD, &mut Default::default());
    let of_one = |k: usize| {
        let mut found = Vec::new();
        tree.aabb_traverse(boxes[k], |tree: &Bvh2, node| {
            let node = &tree.nodes[node as usize];
            let first = node.first_index as usize;
            for &other in &tree.primitive_indices[first..first + node.prim_count as usize] {
                if (other as usize) > k {
                    meet(k, other as usize, &mut found);
                }
            }
            true
        });
        found
    };
    (0..boxes.len()).into_par_iter().with_min_len(256).flat_map_iter(of_one).collect()
}
