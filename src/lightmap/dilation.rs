//! Dilation: values for texels without surface.
//!
//! A bilinear sample next to the border of a chart reads texels outside it. These get the mean of their neighbours
//! nearer to the surface, ring by ring. The rings fill the whole page, because mipmaps read far beyond the charts.
//! Texels that have a value keep it.

use super::{atlas::NONE, grid::Grid};

/// Fills the `values` of all places without an `owner`, and sets their owners. The owner of a value is the chart that
/// it belongs to. If several charts reach a place in the same ring, the chart with the lowest number takes it.
pub fn dilate(grid: &Grid, owner: &mut [u32], values: &mut [[f32; 3]]) {
    let mut ring: Vec<u32> = (0..owner.len() as u32).filter(|&at| owner[at as usize] != NONE).collect();
    while !ring.is_empty() {
        let mut next: Vec<u32> = Vec::new();
        for &at in &ring {
            next.extend(around(grid, at as usize).filter(|&n| owner[n] == NONE).map(|n| n as u32));
        }
        next.sort_unstable();
        next.dedup();
        let made: Vec<(u32, [f32; 3])> =
            next.iter().map(|&at| mean(grid, owner, values, at as usize)).collect();
        for (&at, &(chart, value)) in next.iter().zip(&made) {
            owner[at as usize] = chart;
            values[at as usize] = value;
        }
        ring = next;
    }
}

/// The lowest-numbered chart among the neighbours, and the mean of the neighbours' values that belong to it.
fn mean(grid: &Grid, owner: &[u32], values: &[[f32; 3]], at: usize) -> (u32, [f32; 3]) {
    let chart = around(grid, at).map(|n| owner[n]).min().expect("a neighbour has a value");
    let (mut sum, mut count) = ([0.0f32; 3], 0.0);
    for n in around(grid, at).filter(|&n| owner[n] == chart) {
        (0..3).for_each(|c| sum[c] += values[n][c]);
        count += 1.0;
    }
    (chart, sum.map(|s| s / count))
}

fn around(grid: &Grid, at: usize) -> impl Iterator<Item = usize> + '_ {
    const AROUND: [(isize, isize); 8] =
        [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)];
    AROUND.into_iter().filter_map(move |(dx, dy)| grid.neighbour(at, dx, dy))
}
