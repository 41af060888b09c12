//! Neighbouring texels in a map.
//!
//! A place is the index of a texel in the map: (page · height + row) · width + column.

use super::{atlas::Atlas, coverage::Coverage};

/// The shape of a map and the chart of each covered texel.
#[derive(Debug, Clone)]
pub struct Grid {
    pub width: usize,
    /// Rows of a page.
    pub height: usize,
    /// Number of rows on all pages together.
    rows: usize,
    /// Chart of each covered texel.
    chart: Vec<u32>,
}

impl Grid {
    /// Collects the charts of a map's covered texels.
    pub fn new(atlas: &Atlas, coverage: &Coverage) -> Grid {
        let chart = (0..coverage.len()).map(|i| coverage.chart(atlas, i)).collect();
        Grid { width: atlas.width, height: atlas.height, rows: atlas.pages * atlas.height, chart }
    }

    /// A square page that one chart covers.
    #[cfg(test)]
    pub fn of_one_chart(side: usize) -> Grid {
        Grid { width: side, height: side, rows: side, chart: vec![0; side * side] }
    }

    /// Chart of covered texel `i`.
    pub fn chart(&self, i: usize) -> u32 {
        self.chart[i]
    }

    /// Number of places: texels on all pages.
    pub fn places(&self) -> usize {
        self.width * self.rows
    }

    /// Whether all places up to `reach` columns and rows away are on the same page.
    pub fn is_inside(&self, texel: usize, reach: usize) -> bool {
        let (x, y) = (texel % self.width, texel / self.width % self.height);
        x >= reach && x + reach < self.width && y >= reach && y + reach < self.height
    }

    /// The place `dx` columns and `dy` rows away; `None` if it is not on the same page.
    pub fn neighbour(&self, texel: usize, dx: isize, dy: isize) -> Option<usize> {
        let (x, row) = (texel % self.width, texel / self.width);
        let nx = x.checked_add_signed(dx).filter(|&nx| nx < self.width)?;
        let y = (row % self.height).checked_add_signed(dy).filter(|&ny| ny < self.height)?;
        Some((row - row % self.height + y) * self.width + nx)
    }
}
