//! Rounds of rays, each given to the pairs by what the ones before told of them, until the error is as wanted.

use glam::DVec3;
use rayon::prelude::*;

use super::{
    ViewFactorOptions,
    pair::Pair,
    polygon::Polygon,
    rays::{cast, sequence},
};
use crate::{
    Progress, Result,
    form_factor::ordered_sum,
    scene::{Material, Scene},
    trace::Tracer,
};

/// The most rays of a pair in the first round.
const FIRST: f64 = 8.0;

/// By how much the rays of a pair may grow in a round, as a multiple of what it had.
const GROWTH: f64 = 4.0;

/// The most pairs that a thread casts the rays of at a time.
const TOGETHER: usize = 256;

/// Casts rays until the error is as wanted. Returns how many, and the error.
pub(super) fn sample(
    pairs: &mut [Pair],
    polygons: &[Polygon],
    areas: &[f64],
    options: &ViewFactorOptions,
    progress: &Progress,
) -> Result<(u64, f64)> {
    // What a deviation of the visible share does to both view factors of a pair of surfaces, or to the one of a surface
    // and itself, in which each pair of polygons counts twice.
    let weight = |pair: &Pair| {
        let [i, j] = [pair.i, pair.j].map(|k| polygons[k as usize].surface);
        let [a, b] = [i, j].map(|k| areas[k as usize]);
        let squares = 1.0 / (a * a) + 1.0 / (b * b);
        f64::from(pair.unoccluded) * if i == j { 2.0 * squares } else { squares }.sqrt()
    };
    let (n, tracer, sequence) = (areas.len() as f64, tracer_of_blockers(polygons), sequence());
    let mut rays = 0;
    loop {
        let sum = ordered_sum(pairs.len(), |k| weight(&pairs[k]) * pairs[k].deviation());
        let rays_per_deviation = sum / (n * options.error).powi(2);
        let want = |pair: &mut Pair| {
            let most = if pair.rays == 0 { FIRST } else { (1.0 + GROWTH) * f64::from(pair.rays) };
            pair.wanted = (weight(pair) * pair.deviation() * rays_per_deviation).min(most).ceil() as u32;
            u64::from(pair.wanted.saturating_sub(pair.rays))
        };
        let more: u64 = pairs.par_iter_mut().map(want).sum();
        let variance = |pair: &Pair| (weight(pair) * pair.deviation()).powi(2) / f64::from(pair.rays.max(1));
        let error = ordered_sum(pairs.len(), |k| variance(&pairs[k])).sqrt() / n.max(1.0);
        // Once each pair has as many as it wants, so it is.
        if more == 0 || (rays > 0 && error <= options.error) {
            return Ok((rays, error));
        }
        rays += more;
        progress.begin("casting rays", more);
        let cast_some = |pairs: &mut [Pair]| {
            let rays = |pairs: &[Pair]| pairs.iter().map(|p| u64::from(p.rays)).sum::<u64>();
            let before = rays(pairs);
            pairs
                .iter_mut()
                .for_each(|pair| cast(pair, polygons, &tracer, &sequence, options.seed, progress));
            progress.advance(rays(pairs) - before);
        };
        // Of few pairs each may have many rays.
        let together = (pairs.len() / TOGETHER).clamp(1, TOGETHER);
        pairs.par_chunks_mut(together).for_each(cast_some);
        progress.check()?;
    }
}

/// A tracer of the polygons that have others behind them: the rest, like the walls of a room, block nothing.
fn tracer_of_blockers(polygons: &[Polygon]) -> Tracer {
    let blocks = |p: &&Polygon| polygons.iter().any(|q| !q.in_front(p).0);
    let blockers: Vec<&Polygon> = polygons.par_iter().filter(blocks).collect();
    let triangles: Vec<([DVec3; 3], u32)> =
        blockers.iter().flat_map(|p| p.triangles()).map(|t| (t, 0)).collect();
    let mut scene = Scene::new(&triangles, vec![Material::new("polygons", [0.0; 3], [0.0; 3])]);
    // Its unit space is that of all: blockers may be small, and rays come from afar.
    scene.vertices.extend(polygons.iter().flat_map(|p| &p.corners));
    Tracer::new(&scene)
}
