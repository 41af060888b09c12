//! Neighbours in a map.

use super::{
    atlas::{Atlas, NONE},
    coverage::Coverage,
};

/// Which covered texel is where, and whose chart it is on.
#[derive(Debug, Clone)]
pub struct Grid {
    pub width: usize,
    /// Rows of a page.
    pub height: usize,
    /// Index of the covered texel at each place, [`NONE`] where nothing is covered.
    at: Vec<u32>,
    /// Chart of each covered texel.
    chart: Vec<u32>,
}

impl Grid {
    /// The covered texels of a map.
    pub fn new(atlas: &Atlas, coverage: &Coverage) -> Grid {
        let mut at = vec![NONE; atlas.texels()];
        for (i, &texel) in coverage.texels().iter().enumerate() {
            at[texel as usize] = i as u32;
        }
        let chart = (0..coverage.len()).map(|i| coverage.chart(atlas, i)).collect();
        Grid { width: atlas.width, height: atlas.height, at, chart }
    }

    /// Chart of a covered texel.
    pub fn chart(&self, i: usize) -> u32 {
        self.chart[i]
    }

    /// The covered texel at a place.
    pub fn covered(&self, texel: usize) -> Option<usize> {
        (self.at[texel] != NONE).then_some(self.at[texel] as usize)
    }

    /// The place so many columns and rows away, where that is on the same page.
    pub fn neighbour(&self, texel: usize, dx: isize, dy: isize) -> Option<usize> {
        let (x, row) = (texel % self.width, texel / self.width);
        let nx = x.checked_add_signed(dx).filter(|&nx| nx < self.width)?;
        let y = (row % self.height).checked_add_signed(dy).filter(|&ny| ny < self.height)?;
        Some((row - row % self.height + y) * self.width + nx)
    }
}
