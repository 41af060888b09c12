//! What escapes, refined by what shadow rays know.
//!
//! The share of a patch's hemisphere rays that leave the scene is all that tells what escapes, and where nearly all does,
//! its noise is large beside what stays. But what goes to sources is known better from shadow rays, and all shares sum to
//! one.

use rayon::prelude::*;

use super::{
    hemisphere::{Hits, LINKED, REPLICATES},
    reciprocity::Densities,
    shadow::Found,
};

/// An escaped share, and how it responds to what it was made of.
#[derive(Debug, Clone, Copy)]
pub(super) struct Escape {
    pub(super) share: f64,
    /// To the share of hemisphere rays that escaped.
    pub(super) by_rays: f64,
    /// To the sum of the row's links over its area.
    pub(super) by_links: f64,
    /// To the share of hemisphere rays that connect with sources.
    pub(super) by_linked: f64,
}

/// Escaped shares consistent with the exchange areas S_il of each row's links; `sums` are those of each row's other exchange
/// areas, and of its links.
///
/// A patch that is no source has its other shares, escaped or landed, rescaled to what its links leave. A source has
/// nothing but links: what they sum to and what escapes are two estimates of one number, taken together by their
/// variances.
pub(super) fn refine(
    escaped: &[f64],
    [plain, links]: &[Vec<f64>; 2],
    hits: &Hits,
    densities: &Densities,
    areas: &[f64],
) -> Vec<Escape> {
    let is_source = |i: usize| hits.sources.contains(i);
    // What lamps send in all is known but for shadows; only how it divides among them is left to chance, and other rows
    // would pay for setting that right.
    let lamps = hits.sources.are_lamps();
    // Where no source loses light, as in closed rooms, nobody asks for it.
    let asked = !lamps && hits.sources.patches().iter().any(|&i| escaped[i as usize] > 0.0);
    let variance = if asked { link_variance(hits, densities, areas) } else { Vec::new() };
    let source = |i: usize| hits.sources.patches().binary_search(&(i as u32)).expect("asked of sources only");
    (0..escaped.len())
        .into_par_iter()
        .with_min_len(128)
        .map(|i| {
            let rays = f64::from(hits.rays_of(i));
            let reached = plain[i] + links[i] > 0.0;
            let links = links[i] / areas[i];
            let e = escaped[i];
            let mut escape = Escape { share: e, by_rays: 1.0, by_links: 0.0, by_linked: 0.0 };
            if is_source(i) {
                let of_rays = e * (1.0 - e) / rays;
                // Of a source that no ray leaves the scene from, none does: closed rooms stay closed.
                if e > 0.0 {
                    let trust = if lamps || of_rays == 0.0 {
                        0.0
                    } else {
                        let of_links = variance[source(i)];
                        of_links / (of_rays + of_links)
                    };
                    let share = trust * e + (1.0 - trust) * (1.0 - links);
                    escape = Escape { share, by_rays: trust, by_links: trust - 1.0, by_linked: 0.0 };
                }
            } else {
                let linked = hits.of(i).iter().filter(|&&j| j == LINKED).count() as f64 / rays;
                if linked < 1.0 {
                    let (left, known) = (1.0 - links, 1.0 - linked);
                    escape = Escape {
                        share: e * left / known,
                        by_rays: left / known,
                        by_links: -e / known,
                        by_linked: e * left / (known * known),
                    };
                }
            }
            // A patch none of whose rays landed may be hit by others all the same, and keeps half a ray for them. What
            // sees nothing and is seen by nothing loses everything.
            let keep = if links > 0.0 { f64::EPSILON } else { 0.5 / rays };
            escape.share = if reached { escape.share.clamp(0.0, 1.0 - keep) } else { 1.0 };
            escape
        })
        .collect()
}

/// Variance of the sum of each source's links over its area, from the spread of the replicates, where lamps are many.
fn link_variance(hits: &Hits, densities: &Densities, areas: &[f64]) -> Vec<f64> {
    let many = REPLICATES as f64;
    let sources = hits.sources.patches();
    let mut sums = vec![[0f64; REPLICATES]; sources.len()];
    for i in 0..hits.len() {
        for link in hits.links_of(i).iter().filter(|link| link.found != Found::Blocked) {
            let (replicate, many) = hits.part_of(i, link);
            let exchange = many * densities.link(hits, i, link);
            for l in [i as u32, link.to] {
                if let Ok(k) = sources.binary_search(&l) {
                    sums[k][replicate] += exchange / areas[l as usize];
                }
            }
        }
    }
    sums.iter()
        .map(|replicates| {
            let mean = replicates.iter().sum::<f64>() / many;
            replicates.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (many * (many - 1.0))
        })
        .collect()
}
