//! Values for texels where there is no surface.
//!
//! A bilinear sample next to the border of a chart reads texels outside it. These get the mean of their neighbours nearer to
//! the surface, ring by ring, until the page is full, because mipmaps read far out. Texels that have a value keep it.

use super::{atlas::NONE, grid::Grid};

/// Fills the places that have no `owner`, in place. An owner is the chart that a value belongs to; a place that several
/// charts reach at once gets the lowest numbered one's.
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

/// The mean of the neighbours that have values, of the lowest numbered chart among them.
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
