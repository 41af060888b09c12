//! Fireflies: single texels, or two adjacent ones, that stand out from their neighbours, because some of their samples
//! happened to find a rare bright light. Texels are dark in the same way where all samples missed it.
//!
//! The denoiser keeps a texel that contradicts its neighbours, because it may be a small spot. Its own samples
//! cannot decide: few of them found the light, so their spread says little. So a texel that stands out is measured again,
//! with new and more rays. If these do not confirm it, it is a firefly. Its light is real on average, so it is spread over
//! the neighbours and not removed.

use std::collections::HashMap;

use rayon::prelude::*;

use super::{atlas::NONE, denoise::square, grid::Grid};
use crate::Result;

/// A texel stands out if the larger of its brightness and that of its brightest neighbour but one exceeds the other by
/// more than this share, or the same with its darkest neighbour but one. One neighbour may be a firefly as well.
const CONTRAST: f32 = 0.1;
/// New samples confirm a texel if they differ from that neighbour by more than this share of what the texel does.
const CONFIRMED: f32 = 0.5;
/// Fireflies are spread over a square that reaches this many texels out in each direction.
const REACH: isize = 2;
/// A texel has too few neighbours to compare if fewer than this number are on its chart.
const FEWEST: usize = 4;
/// After one of several adjacent fireflies was spread, another one stands out.
const PASSES: usize = 8;

/// Measures the texels with these numbers.
pub(super) type Measure<'a> = dyn Fn(&[u32]) -> Result<Vec<[f32; 3]>> + 'a;

/// Spreads fireflies. `texels` has the place of each texel that counts, and its number among the covered ones. `again`
/// measures texels with these numbers once more. `values` is indexed by place.
///
/// # Errors
/// Those of `again`.
pub(super) fn spread(
    grid: &Grid,
    texels: &[(usize, u32)],
    values: &mut [[f32; 3]],
    again: &Measure<'_>,
) -> Result<()> {
    let mut chart = vec![NONE; grid.places()];
    texels.iter().for_each(|&(place, i)| chart[place] = grid.chart(i as usize));
    let chart = &chart;
    let near = |place: usize, reach: isize| {
        let on_chart = move |&at: &usize| at != place && chart[at] == chart[place];
        square(reach).filter_map(move |(dx, dy)| grid.neighbour(place, dx, dy)).filter(on_chart)
    };
    let brightness = |value: [f32; 3]| value.iter().sum::<f32>();
    // If a place stands out: the brightness of its brightest, or its darkest, neighbour but one.
    let beside = |values: &[[f32; 3]], place: usize| {
        let mut others: Vec<f32> = near(place, 1).map(|at| brightness(values[at])).collect();
        if others.len() < FEWEST {
            return None;
        }
        others.sort_unstable_by(f32::total_cmp);
        let (least, most, here) = (others[1], others[others.len() - 2], brightness(values[place]));
        match here {
            _ if here > (1.0 + CONTRAST) * most => Some(most),
            _ if (1.0 + CONTRAST) * here < least => Some(least),
            _ => None,
        }
    };
    let mut measured: HashMap<u32, f32> = HashMap::new();
    for _ in 0..PASSES {
        let stand_out: Vec<(usize, u32)> =
            texels.par_iter().copied().filter(|&(place, _)| beside(values, place).is_some()).collect();
        let new: Vec<u32> = stand_out.iter().map(|&(_, i)| i).filter(|i| !measured.contains_key(i)).collect();
        if !new.is_empty() {
            measured.extend(new.iter().copied().zip(again(&new)?.into_iter().map(brightness)));
        }
        let mut found = false;
        for (place, i) in stand_out {
            // The texel may stand out no more, because a neighbour was spread.
            let Some(other) = beside(values, place) else { continue };
            let excess = brightness(values[place]) - other;
            if (measured[&i] - other) * excess.signum() > CONFIRMED * excess.abs() {
                continue;
            }
            found = true;
            let others: Vec<usize> = near(place, REACH).collect();
            for c in 0..3 {
                let mean = others.iter().map(|&at| values[at][c]).sum::<f32>() / others.len() as f32;
                let share = (values[place][c] - mean) / (others.len() + 1) as f32;
                values[place][c] = (mean + share).max(0.0);
                others.iter().for_each(|&at| values[at][c] = (values[at][c] + share).max(0.0));
            }
        }
        if !found {
            break;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 9;
    const MIDDLE: usize = 4 * SIDE + 4;

    /// A chart of light 1, with other values in some texels. When measured again, all texels have the value `truth`.
    fn spread_in(bright: &[(usize, f32)], truth: f32) -> Vec<[f32; 3]> {
        let grid = Grid::of_one_chart(SIDE);
        let mut values = vec![[1.0; 3]; SIDE * SIDE];
        bright.iter().for_each(|&(place, value)| values[place] = [value; 3]);
        let texels: Vec<(usize, u32)> = (0..values.len()).map(|place| (place, place as u32)).collect();
        let again = |texels: &[u32]| Ok(vec![[truth; 3]; texels.len()]);
        spread(&grid, &texels, &mut values, &again).unwrap();
        values
    }

    /// A texel that new samples do not confirm is spread, and the light stays. A bright spot is kept.
    #[test]
    fn what_chance_made_is_spread_and_the_light_stays() {
        let values = spread_in(&[(MIDDLE, 1.8)], 1.1);
        assert!((values[MIDDLE][1] - 1.032).abs() < 1e-6, "{:?}", values[MIDDLE]);
        let sum: f32 = values.iter().map(|v| v[1]).sum();
        assert!((sum - (81.0 + 0.8)).abs() < 1e-4, "{sum}");
        assert_eq!(spread_in(&[(MIDDLE, 1.8)], 1.7)[MIDDLE], [1.8; 3]);
    }

    /// Two adjacent outliers are spread, and dark ones as well.
    #[test]
    fn adjacent_and_dark_outliers_are_spread() {
        let bright = [(MIDDLE, 1.9), (MIDDLE + 1, 1.5)];
        let most = spread_in(&bright, 1.0).iter().map(|v| v[1]).fold(0.0, f32::max);
        // A texel may exceed its brightest neighbour by a tenth, and the neighbours have got the light.
        assert!(most < 1.15, "{most}");
        assert!((spread_in(&[(MIDDLE, 0.2)], 1.0)[MIDDLE][0] - 0.968).abs() < 1e-6);
        assert_eq!(spread_in(&[(MIDDLE, 0.2)], 0.3)[MIDDLE], [0.2; 3]);
    }
}
