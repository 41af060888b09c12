//! Number of rays that each patch casts.
//!
//! The area-weighted mean square error of irradiance is Σ A_i (V_i / R_i + W_i / N_i), where V_i is the variance of one
//! hemisphere ray of patch i and W_i that of one shadow ray. For a given total number of rays it is least with R_i
//! proportional to sqrt(A_i V_i), and N_i to sqrt(A_i W_i) (Neyman, "On the Two Different Aspects of the Representative
//! Method", JRSS 97, 1934). A first part of the rays is cast evenly and estimates the variances.

use std::ops::Range;

use rayon::prelude::*;

use super::REPLICATES;
use crate::parallel::{SHORT, ordered_sum};

/// Numbers of rays of a patch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Share {
    pub(crate) hemisphere: u32,
    pub(crate) shadow: u32,
}

/// Share of the rays that are cast evenly.
pub(crate) const PILOT: f64 = 0.5;
/// Weight of the mean variance of all patches in the variance of each, because the estimate of a few patches may miss
/// rare light. RMS errors at 64 rays a patch on three rooms with 0.5, 0.25 and 0.1: 4.3, 4.1, 4.0; 3.5, 3.4, 3.4; 3.0,
/// 2.9, 2.7 %.
const COMMON: f64 = 0.1;
/// The number of rays of a kind may grow by at most this factor. On a block in the open at 256 rays, 4 gives an error
/// of 0.68 % and 8 of 0.50 %.
const MOST_GROWTH: f64 = 8.0;

/// Bisections of the logarithm of the level, over a range of 120. They give numbers of rays to a ten-thousandth.
const HALVINGS: usize = 20;

/// The least share of rays that is worth distributing evenly. Bisection leaves less.
const LEFT_OVER: f64 = 1e-3;

/// Small runs of siblings are joined until they have this many patches.
const NEIGHBOURS: usize = 4;

/// Numbers of rays are multiples of this, so that replicates have equally many. Replicates of one and of two rays would
/// overestimate the variance of the whole by an eighth, where both are equally frequent: on five scenes at 64 rays a
/// patch error bars were a tenth to a fifth too long. Nets are also better stratified.
const STEP: u32 = REPLICATES as u32;

/// The same number of rays for all patches, of which a share are shadow rays. If variances distribute more rays later,
/// replicates have equally many.
pub(crate) fn even(rays: f64, shadow_share: f64, looks_first: bool) -> Share {
    let whole = |rays: f64| {
        let rays = rays.round() as u32;
        (if looks_first { rays / STEP * STEP } else { rays }).max(REPLICATES as u32)
    };
    let hemisphere = whole(rays * (1.0 - shadow_share));
    Share { hemisphere, shadow: if shadow_share > 0.0 { whole(rays * shadow_share) } else { 0 } }
}

/// Distributes `rays` over all patches, given the rays already cast and the variances (V_i / R_i, W_i / N_i) of each
/// patch's irradiance with these.
///
/// The variance of a patch is estimated by the mean of its neighbours, without its own. Its own would make its
/// irradiance biased: a patch whose ray met a rare light would get more rays and estimate it correctly, and a patch
/// that missed it would get none and keep missing it. In a sphere with a port of half a percent, a fifth too little
/// light escaped. Nothing is lost, because a single patch estimates its own variance badly.
///
/// `siblings` are runs of patches that are close to each other and look the same way.
pub(crate) fn by_variance(
    cast: impl Fn(usize) -> Share + Sync,
    areas: &[f64],
    variances: &[[f64; 2]],
    siblings: &[Range<usize>],
    rays: f64,
) -> Vec<Share> {
    let now = |i: usize| {
        let Share { hemisphere, shadow } = cast(i);
        [hemisphere, shadow].map(f64::from)
    };
    // Variance times number of rays: the effective variance of one ray.
    let mut of_ray = Vec::with_capacity(areas.len());
    for run in neighbours(siblings) {
        let own = |i: usize| -> [f64; 2] { std::array::from_fn(|kind| variances[i][kind] * now(i)[kind]) };
        let mut sum = [0.0; 2];
        for i in run.clone() {
            (0..2).for_each(|kind| sum[kind] += own(i)[kind]);
        }
        let others = (run.len() - 1) as f64;
        of_ray.extend(run.map(|i| {
            let own = own(i);
            std::array::from_fn(|kind| {
                if others > 0.0 { ((sum[kind] - own[kind]) / others).max(0.0) } else { own[kind] }
            })
        }));
    }
    let total: f64 = areas.iter().sum();
    let mean: f64 = (0..areas.len()).map(|i| areas[i] * of_ray[i][0]).sum::<f64>() / total;
    for v in &mut of_ray {
        v[0] = (1.0 - COMMON) * v[0] + COMMON * mean;
    }
    let rows = of_ray.par_iter().zip(areas).with_min_len(SHORT);
    let roots: Vec<[f64; 2]> = rows.map(|(of_ray, area)| of_ray.map(|v| (area * v).sqrt())).collect();
    let wanted = |i: usize, level: f64| -> [f64; 2] {
        std::array::from_fn(|kind| {
            let now = now(i)[kind];
            (level * roots[i][kind]).clamp(now, MOST_GROWTH * now)
        })
    };
    let sum = |level: f64| ordered_sum(areas.len(), |i| wanted(i, level).iter().sum::<f64>());
    // The number of rays grows with the level: bisect its logarithm.
    let scale = roots.iter().map(|root| root[0].max(root[1])).fold(0.0, f64::max);
    let (mut low, mut high) = (-60.0f64, 60.0f64);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        if sum(middle.exp() / scale) > rays { high = middle } else { low = middle }
    }
    let level = if scale > 0.0 { low.exp() / scale } else { 0.0 };
    // Rays that variances do not ask for are cast evenly: in a furnace there are no variances.
    let (spent, more) = (sum(level), 1.0 + LEFT_OVER);
    let even = if more * spent < rays { rays / spent } else { 1.0 };
    // Differences from rounding to steps carry over to the next patches.
    let mut owed = [0.0; 2];
    (0..areas.len())
        .map(|i| {
            let (now, wanted) = (now(i), wanted(i, level).map(|wanted| even * wanted));
            let [hemisphere, shadow] = std::array::from_fn(|kind| {
                let mut rays = now[kind];
                if wanted[kind] > rays {
                    owed[kind] += wanted[kind] - rays;
                    let steps = (owed[kind] / f64::from(STEP)).round().max(0.0);
                    rays += steps * f64::from(STEP);
                    owed[kind] -= steps * f64::from(STEP);
                }
                rays as u32
            });
            Share { hemisphere, shadow }
        })
        .collect()
}

/// Runs of siblings. Small runs that follow each other are joined.
fn neighbours(siblings: &[Range<usize>]) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for family in siblings {
        match runs.last_mut() {
            Some(run) if run.len() < NEIGHBOURS => run.end = family.end,
            _ => runs.push(family.clone()),
        }
    }
    // A small run at the end joins the one before it.
    if runs.len() > 1 && runs[runs.len() - 1].len() < NEIGHBOURS {
        let end = runs.pop().map_or(0, |last| last.end);
        runs.last_mut().expect("there is another").end = end;
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two groups of four equal patches.
    fn twice<T: Copy>([first, second]: [T; 2]) -> Vec<T> {
        [[first; 4], [second; 4]].concat()
    }

    /// Neyman's formula: the first four patches have four times the variance per hemisphere ray and four times the area
    /// of the others. They get four times as many rays, apart from the tenth of each variance that is the mean of all.
    #[test]
    fn rays_go_as_the_root_of_area_and_variance() {
        let cast = |_: usize| Share { hemisphere: 1600, shadow: 0 };
        let (areas, of_ray) = ([4.0, 1.0], [4.0, 1.0]);
        let variances = twice(of_ray.map(|v| [v / 1600.0, 0.0]));
        let shares = by_variance(cast, &twice(areas), &variances, &[0..4, 4..8], 8000.0 * 8.0);
        let common = COMMON * (4.0 * 4.0 + 1.0) / 5.0;
        let root = |k: usize| (areas[k] * ((1.0 - COMMON) * of_ray[k] + common)).sqrt();
        let wanted = 16_000.0 * root(0) / (root(0) + root(1));
        for (first, second) in shares[..4].iter().zip(&shares[4..]) {
            assert!((f64::from(first.hemisphere) - wanted).abs() <= 32.0, "{shares:?} for {wanted}");
            assert!((f64::from(second.hemisphere) + wanted - 16_000.0).abs() <= 32.0, "{shares:?}");
        }
        assert!(shares.iter().all(|share| share.hemisphere % STEP == 0 && share.shadow == 0));
    }

    /// A kind of ray without variance gets no more rays, and no patch gets more than eight times its rays. There are as
    /// many rays as that needs: 128 hemisphere rays of each patch, 16 shadow rays of four, and 128 of the other four.
    #[test]
    fn what_is_certain_gets_nothing_and_nobody_gets_all() {
        let cast = |_: usize| Share { hemisphere: 16, shadow: 16 };
        let shares = by_variance(cast, &[1.0; 8], &twice([[1.0, 0.0], [0.0, 1.0]]), &[0..4, 4..8], 1600.0);
        for (first, second) in shares[..4].iter().zip(&shares[4..]) {
            assert_eq!((first.shadow, second.shadow), (16, 128));
        }
        assert!(shares.iter().all(|share| share.hemisphere == 128), "{shares:?}");
    }

    /// Without variances all rays are cast all the same, and evenly.
    #[test]
    fn rays_that_variances_do_not_ask_for_are_cast_evenly() {
        let cast = |_: usize| Share { hemisphere: 32, shadow: 0 };
        let shares = by_variance(cast, &[1.0; 8], &[[0.0; 2]; 8], &[0..4, 4..8], 8.0 * 64.0);
        assert_eq!(shares, [Share { hemisphere: 64, shadow: 0 }; 8]);
    }

    /// Rare hits of its own rays give a patch no more rays: its neighbours get them.
    #[test]
    fn a_patch_has_no_part_in_its_own_share() {
        let cast = |_: usize| Share { hemisphere: 160, shadow: 0 };
        let mut variances = [[1e-3, 0.0]; 8];
        variances[1] = [1.0, 0.0];
        let shares = by_variance(cast, &[1.0; 8], &variances, &[0..4, 4..8], 8.0 * 400.0);
        let rays = |i: usize| shares[i].hemisphere;
        assert!(rays(1) <= rays(4) + STEP, "{shares:?}");
        assert!([0, 2, 3].iter().all(|&i| rays(i) > 3 * rays(1)), "{shares:?}");
    }

    /// Small runs are joined until they have four patches, and a small run at the end joins them.
    #[test]
    fn neighbours_are_four_at_least() {
        assert_eq!(neighbours(&[0..1, 1..3, 3..4, 4..20, 20..21]), [0..4, 4..21]);
        assert_eq!(neighbours(&[0..1, 1..3]).len(), 1);
    }
}
