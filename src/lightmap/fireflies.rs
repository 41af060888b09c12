//! Fireflies: single texels that stand out from all their neighbours, because one of their samples happened to find a
//! rare bright light.
//!
//! The denoiser keeps a texel that contradicts its neighbours, because it may be a small bright spot. A firefly remains
//! where chance brought several bright samples to one texel. If a texel stands out by no more than its own error allows, it
//! cannot be told from chance. The light of such a texel is real on average, so it is spread over the neighbours and not
//! removed.

use rayon::prelude::*;

use super::{denoise::square, grid::Grid};

/// A firefly is brighter than its brightest neighbour by more than this share of that neighbour.
const CONTRAST: f32 = 0.1;
/// A texel that stands out by more than this number of standard errors of its own samples is a bright spot. With 3, the
/// error of a map with 64 rays per texel grew by a third, because its bright spots were spread; with 2 it did not
/// change (docs/decisions/2026-12-01-denoiser.md).
const BY_CHANCE: f32 = 2.0;
/// Fireflies are spread over a square that reaches this many texels out in each direction.
const REACH: isize = 2;
/// A texel has too few neighbours to compare if fewer than this number are on its chart.
const FEWEST: usize = 3;
/// After the brightest of two adjacent fireflies was spread, the other one stands out.
const PASSES: usize = 2;

/// Spreads fireflies. `texels` has the place of each texel and the standard error of its own samples, summed over the
/// channels. `chart` and `values` are indexed by place.
pub(super) fn spread(grid: &Grid, chart: &[u32], texels: &[(usize, f32)], values: &mut [[f32; 3]]) {
    let near = |place: usize, reach: isize| {
        let on_chart = move |&at: &usize| at != place && chart[at] == chart[place];
        square(reach).filter_map(move |(dx, dy)| grid.neighbour(place, dx, dy)).filter(on_chart)
    };
    let brightness = |value: [f32; 3]| value.iter().sum::<f32>();
    for _ in 0..PASSES {
        let is_firefly = |&&(place, error): &&(usize, f32)| {
            let others = near(place, 1).map(|at| brightness(values[at]));
            let (count, most) = others.fold((0, 0.0f32), |(count, most), b| (count + 1, most.max(b)));
            let excess = brightness(values[place]) - most;
            count >= FEWEST && excess > CONTRAST * most && excess < BY_CHANCE * error
        };
        let found: Vec<usize> = texels.par_iter().filter(is_firefly).map(|&(place, _)| place).collect();
        for place in found {
            let others: Vec<usize> = near(place, REACH).collect();
            for c in 0..3 {
                let mean = others.iter().map(|&at| values[at][c]).sum::<f32>() / others.len() as f32;
                let share = (values[place][c] - mean) / (others.len() + 1) as f32;
                values[place][c] = (mean + share).max(0.0);
                others.iter().for_each(|&at| values[at][c] = (values[at][c] + share).max(0.0));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 9;
    const MIDDLE: usize = 4 * SIDE + 4;

    /// A chart of light 1, with other values in some texels. The standard error of all texels is 0.5 per channel.
    fn spread_in(bright: &[(usize, f32)]) -> Vec<[f32; 3]> {
        let grid = Grid::of_one_chart(SIDE);
        let mut values = vec![[1.0; 3]; SIDE * SIDE];
        bright.iter().for_each(|&(place, value)| values[place] = [value; 3]);
        let texels: Vec<(usize, f32)> = (0..values.len()).map(|place| (place, 1.5)).collect();
        spread(&grid, &vec![0; SIDE * SIDE], &texels, &mut values);
        values
    }

    /// 0.8 above the neighbours is chance with an error of 0.5, and 1.5 is not. Two bright texels are no firefly each.
    #[test]
    fn what_chance_explains_is_spread_and_the_light_stays() {
        let values = spread_in(&[(MIDDLE, 1.8)]);
        assert!((values[MIDDLE][1] - 1.032).abs() < 1e-6, "{:?}", values[MIDDLE]);
        let sum: f32 = values.iter().map(|v| v[1]).sum();
        assert!((sum - (81.0 + 0.8)).abs() < 1e-4, "{sum}");
        let kept = spread_in(&[(MIDDLE, 2.5)]);
        assert_eq!(kept[MIDDLE], [2.5; 3]);
        let pair = spread_in(&[(MIDDLE, 1.8), (MIDDLE + 1, 1.8)]);
        assert_eq!(pair[MIDDLE], [1.8; 3]);
    }

    /// Of two adjacent outliers of different size, the larger one is spread first.
    #[test]
    fn adjacent_fireflies_are_spread_one_after_the_other() {
        let values = spread_in(&[(MIDDLE, 1.9), (MIDDLE + 1, 1.5)]);
        let most = values.iter().map(|v| v[1]).fold(0.0, f32::max);
        assert!(most < 1.1, "{most}");
    }
}
