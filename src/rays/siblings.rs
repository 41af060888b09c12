//! Patches that are close to each other and look the same way, so that their sampling errors are of similar size.
//!
//! A single patch estimates its own variance badly, and misses rare paths that none of its rays found. Its neighbours
//! add information.

use std::ops::Range;

use crate::{
    patch::Patches,
    trace::{Tracer, UnitTriangle},
};

/// Most patches of a run.
const MOST: usize = 16;
/// Smallest cosine between the normals of coplanar neighbours.
const FLAT: f32 = 0.999;

/// Whether two triangles are coplanar and share a corner.
pub(crate) fn adjoin(p: &UnitTriangle, q: &UnitTriangle) -> bool {
    p.normal.dot(q.normal) > FLAT && p.corners.iter().any(|corner| q.corners.contains(corner))
}

/// Applies `make` to every value and the mean over its siblings. Returns `C` interleaved values a patch.
pub(crate) fn with_mean<const C: usize>(
    siblings: &[Range<usize>],
    values: &[[f64; C]],
    make: impl Fn(f64, f64) -> f64,
) -> Vec<f64> {
    let mut made = Vec::with_capacity(C * values.len());
    for run in siblings {
        let (values, count) = (&values[run.clone()], run.len() as f64);
        let mean: [f64; C] = std::array::from_fn(|c| values.iter().map(|v| v[c]).sum::<f64>() / count);
        for value in values {
            made.extend((0..C).map(|c| make(value[c], mean[c])));
        }
    }
    made
}

/// Runs of up to 16 patches, in the order of the patches. They lie on one side of one triangle, or of coplanar
/// triangles that follow each other in the file and share a corner.
pub(crate) fn siblings(tracer: &Tracer, patches: &Patches) -> Vec<Range<usize>> {
    let goes_on = |i: usize, j: usize| {
        let [p, q] = [i, j].map(|i| &tracer.triangles()[patches.triangle(i)]);
        patches.is_front(i) == patches.is_front(j) && adjoin(p, q)
    };
    let mut runs: Vec<Range<usize>> = Vec::new();
    for family in patches.families(2) {
        match runs.last_mut() {
            Some(run) if run.len() + family.len() <= MOST && goes_on(run.end - 1, family.start) => {
                run.end = family.end;
            }
            _ => runs.push(family),
        }
    }
    runs
}
