//! Exchange areas as a symmetric matrix. The upper triangle is stored as it was computed, because large scenes fill most
//! of their memory with it. The lower triangle has only the places of its entries.

use super::cell::Cell;

/// A symmetric sparse matrix of exchange areas.
#[derive(Debug, Clone)]
pub(super) struct Symmetric {
    /// For each row its entries from the diagonal on, sorted by column.
    upper: Vec<Vec<Cell>>,
    /// Where each row begins in `lower`.
    starts: Vec<usize>,
    /// For each entry left of the diagonal its column, and its place in the row of that number of the upper triangle.
    lower: Vec<[u32; 2]>,
}

impl Symmetric {
    /// The matrix with this upper triangle.
    pub(super) fn new(upper: Vec<Vec<Cell>>) -> Symmetric {
        let n = upper.len();
        let left = |i: usize| upper[i].iter().filter(move |cell| cell.column as usize != i);
        let mut starts = vec![0; n + 1];
        (0..n).flat_map(left).for_each(|cell| starts[cell.column as usize + 1] += 1);
        (0..n).for_each(|i| starts[i + 1] += starts[i]);
        let (mut next, mut lower) = (starts.clone(), vec![[0; 2]; starts[n]]);
        // Row by row, so that the columns of each row come in order.
        for (i, row) in upper.iter().enumerate() {
            for (place, cell) in row.iter().enumerate().filter(|(_, cell)| cell.column as usize != i) {
                let at = &mut next[cell.column as usize];
                lower[*at] = [i as u32, place as u32];
                *at += 1;
            }
        }
        Symmetric { upper, starts, lower }
    }

    /// The columns and entries of a row, sorted by column.
    pub(super) fn row(&self, i: usize) -> impl Iterator<Item = (usize, &Cell)> + '_ {
        let left = self.lower[self.starts[i]..self.starts[i + 1]].iter();
        let left = left.map(|&[row, place]| (row as usize, &self.upper[row as usize][place as usize]));
        left.chain(self.upper[i].iter().map(|cell| (cell.column as usize, cell)))
    }

    /// All entries of the upper triangle with their rows.
    pub(super) fn upper(&self) -> impl Iterator<Item = (usize, &Cell)> + '_ {
        self.upper.iter().enumerate().flat_map(|(i, row)| row.iter().map(move |cell| (i, cell)))
    }

    /// An entry, if it is stored.
    pub(super) fn get(&self, i: usize, j: usize) -> Option<&Cell> {
        let (row, column) = (&self.upper[i.min(j)], i.max(j) as u32);
        row.binary_search_by_key(&column, |cell| cell.column).ok().map(|k| &row[k])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_triangles_have_the_same_entries() {
        let cell = |column: u32, exchange: f64| Cell { exchange, column, ..Cell::default() };
        let upper = vec![
            vec![cell(1, 3.0), cell(3, 4.0)],
            vec![cell(1, 5.0), cell(2, 6.0)],
            vec![],
            vec![cell(3, 7.0)],
        ];
        let matrix = Symmetric::new(upper);
        let row = |i: usize| matrix.row(i).map(|(j, cell)| (j, cell.exchange)).collect::<Vec<_>>();
        assert_eq!(row(0), [(1, 3.0), (3, 4.0)]);
        assert_eq!(row(1), [(0, 3.0), (1, 5.0), (2, 6.0)]);
        assert_eq!(row(2), [(1, 6.0)]);
        assert_eq!(row(3), [(0, 4.0), (3, 7.0)]);
        assert_eq!(matrix.get(2, 1).map(|cell| cell.exchange), Some(6.0));
        assert!(matrix.get(2, 0).is_none() && matrix.get(2, 2).is_none());
        assert_eq!(matrix.upper().map(|(i, cell)| i as f64 + cell.exchange).sum::<f64>(), 25.0 + 5.0);
    }
}
