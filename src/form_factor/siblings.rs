//! Patches that are close to each other and look the same way, and whose sampling errors are therefore of one size.
//!
//! One patch knows its own variance badly, and nothing of rare paths that all its rays have missed; its neighbours know more.

use std::ops::Range;

use crate::{direct::adjoin, patch::Patches, trace::Tracer};

/// Patches of a run at most.
const MOST: usize = 16;
/// What `make` makes of every value and its mean over the siblings: `C` interleaved values a patch.
pub(crate) fn with_mean<const C: usize>(
    siblings: &[Range<usize>],
    values: &[[f64; C]],
    make: impl Fn(f64, f64) -> f64,
) -> Vec<f64> {
    let mut made = Vec::with_capacity(C * values.len());
    for run in siblings {
        let (values, many) = (&values[run.clone()], run.len() as f64);
        let mean: [f64; C] = std::array::from_fn(|c| values.iter().map(|v| v[c]).sum::<f64>() / many);
        for value in values {
            made.extend((0..C).map(|c| make(value[c], mean[c])));
        }
    }
    made
}

/// Runs of up to 16 patches, in the order of the patches: of one triangle's side, or of triangles that follow each other in
/// the file, in one plane, and share a corner.
pub(super) fn siblings(tracer: &Tracer, patches: &Patches) -> Vec<Range<usize>> {
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
