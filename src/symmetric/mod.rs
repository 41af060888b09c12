//! Symmetric sparse matrices that store each pair of patches once and use it for both directions.
//!
//! The patches are divided into blocks, and the pairs into tiles, one for every two blocks. A product works tile by
//! tile: the values that a tile reads and writes are close in memory, and indices within a block take 16 bits.
//! [`Blocks`] decides which tiles run at the same time.

pub(crate) mod blocks;
mod tile;

use std::ops::{Add, AddAssign, Mul, Sub, SubAssign};

use rayon::prelude::*;

use crate::ranks::{Ranks, Word, Words};
use blocks::{Blocks, PLACE};
use sprs::CsMatI;
use tile::{Entry, Tile};

/// Sparse matrix by rows, 8 bytes a non-zero: single-precision values (sums run in double precision) and 32-bit
/// columns. It passes form factors in and out, and serves solvers that need whole rows.
pub type Matrix = CsMatI<f32, u32, usize>;

/// Columns and values of a row.
pub(crate) fn row(matrix: &Matrix, i: usize) -> (&[u32], &[f32]) {
    let range = matrix.indptr().outer_inds_sz(i);
    (&matrix.indices()[range.clone()], &matrix.data()[range])
}

/// Single or double precision.
pub(crate) trait Real:
    Word
    + From<f32>
    + Into<f64>
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + AddAssign
    + SubAssign
{
    /// The nearest value to `x`.
    fn of(x: f64) -> Self;
}

impl Real for f32 {
    #[inline]
    fn of(x: f64) -> f32 {
        x as f32
    }
}

impl Real for f64 {
    #[inline]
    fn of(x: f64) -> f64 {
        x
    }
}

/// A symmetric matrix of non-negative values.
#[derive(Debug, Clone, Default)]
pub(crate) struct Symmetric {
    blocks: Blocks,
    /// Empty where another rank has the tile.
    tiles: Vec<Tile>,
    /// Number of entries off the diagonal, counting each pair once.
    pairs: usize,
    /// Empty if the diagonal is zero.
    diagonal: Vec<f32>,
}

impl Symmetric {
    /// Builds each tile from the result of `entries`: its entries sorted by row and column, their number, and a value
    /// to return.
    pub(crate) fn from_tiles<T, I>(
        blocks: Blocks,
        entries: impl Fn((usize, usize)) -> (I, usize, T) + Sync,
    ) -> (Symmetric, Vec<T>)
    where
        T: Send + Default,
        I: Iterator<Item = Entry>,
    {
        let make = |&at: &(usize, usize)| {
            if !blocks.has(at) {
                return (Tile::default(), T::default());
            }
            let (entries, count, rest) = entries(at);
            (Tile::of(entries, count), rest)
        };
        let (tiles, rest): (Vec<Tile>, _) = blocks.tiles().par_iter().with_max_len(1).map(make).unzip();
        let counted = tiles.iter().zip(blocks.tiles()).filter(|(_, (a, _))| blocks.owns(*a));
        let pairs = blocks.ranks().sum(counted.map(|(tile, _)| tile.values.len()).sum());
        (Symmetric { blocks, tiles, pairs, diagonal: Vec::new() }, rest)
    }

    /// Builds the matrix from lists of (i, j, s) in any order. A list may name a pair in either direction or in both.
    /// Values of the same pair are summed in the order of the lists.
    pub(crate) fn from_lists(len: usize, lists: &[Vec<(u32, u32, f32)>]) -> Symmetric {
        let blocks = Blocks::new(len);
        let count = blocks.count();
        // Each list is sorted by tile separately.
        let sorted: Vec<Vec<Vec<(u32, f32)>>> = lists
            .par_iter()
            .map(|list| {
                let place = |i: u32, j: u32| {
                    let ((a, r), (b, c)) = (blocks.of(i.min(j) as usize), blocks.of(i.max(j) as usize));
                    (blocks.tile((a, b)), r << PLACE | c)
                };
                let mut lengths = vec![0; count * (count + 1) / 2];
                list.iter().for_each(|&(i, j, _)| lengths[place(i, j).0] += 1);
                let mut tiles: Vec<Vec<(u32, f32)>> = lengths.into_iter().map(Vec::with_capacity).collect();
                for &(i, j, value) in list.iter().filter(|&(i, j, _)| i != j) {
                    let (tile, key) = place(i, j);
                    tiles[tile].push((key, value));
                }
                tiles
            })
            .collect();
        let (mut matrix, _) = Self::from_tiles(blocks, |at| {
            let tile = blocks.tile(at);
            let mut all: Vec<(u32, f32)> = sorted.iter().flat_map(|tiles| &tiles[tile]).copied().collect();
            // A stable sort fixes the order of sums.
            all.sort_by_key(|&(key, _)| key);
            all.dedup_by(|later, first| {
                let same = later.0 == first.0;
                if same {
                    first.1 += later.1;
                }
                same
            });
            let mask = (1 << PLACE) - 1;
            let count = all.len();
            let entries =
                all.into_iter().map(move |(key, s)| ((key >> PLACE) as u16, (key & mask) as u16, s));
            (entries, count, ())
        });
        for &(i, _, value) in lists.iter().flatten().filter(|&(i, j, _)| i == j) {
            matrix.diagonal.resize(len, 0.0);
            matrix.diagonal[i as usize] += value;
        }
        matrix
    }

    /// From the upper triangle of a matrix.
    pub(crate) fn from_rows(rows: &Matrix) -> Symmetric {
        let upper = rows.iter().filter(|&(_, (i, j))| i as usize <= j as usize);
        Self::from_lists(rows.rows(), &[upper.map(|(&s, (i, j))| (i, j, s)).collect()])
    }

    /// Adds to the entries on the diagonal.
    pub(crate) fn add_diagonal(&mut self, more: impl Fn(usize) -> f32) {
        self.diagonal.resize(self.len(), 0.0);
        self.diagonal.iter_mut().enumerate().for_each(|(i, s)| *s += more(i));
    }

    /// Number of rows.
    pub(crate) fn len(&self) -> usize {
        self.blocks.len()
    }

    /// Number of entries, counting both directions of a pair.
    pub(crate) fn non_zeros(&self) -> usize {
        2 * self.pairs + self.diagonal.iter().filter(|&&s| s != 0.0).count()
    }

    /// The processes that share out the matrix.
    pub(crate) fn ranks(&self) -> Ranks {
        self.blocks.ranks()
    }

    /// Refuses an access to single entries, which other ranks may have.
    fn assert_whole(&self) {
        assert_eq!(self.ranks().count(), 1, "the rows are shared out among ranks");
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        self.tiles.iter().map(Tile::bytes).sum::<usize>() + 4 * self.diagonal.len()
    }

    /// The entries of each tile as (i, j, s), i < j, tiles in parallel. Over all ranks, each tile occurs once.
    pub(crate) fn tiles(
        &self,
    ) -> impl ParallelIterator<Item = impl Iterator<Item = (usize, usize, f32)> + '_> + '_ {
        let rows = self.blocks.rows();
        let tiles = self.tiles.par_iter().with_max_len(1).zip(self.blocks.tiles());
        let tiles = tiles.filter(|(_, (a, _))| self.blocks.owns(*a));
        tiles.map(move |(tile, (a, b))| {
            let whole = move |(r, c, s): Entry| (a * rows + usize::from(r), b * rows + usize::from(c), s);
            tile.entries().map(whole)
        })
    }

    /// The entries of the diagonal as (i, s).
    pub(crate) fn diagonal(&self) -> impl Iterator<Item = (usize, f32)> + '_ {
        self.diagonal.iter().copied().enumerate().filter(|&(_, s)| s != 0.0)
    }

    /// The entry s_ij.
    pub(crate) fn get(&self, i: usize, j: usize) -> f32 {
        if i == j {
            return self.diagonal.get(i).copied().unwrap_or(0.0);
        }
        self.assert_whole();
        let ((a, row), (b, column)) = (self.blocks.of(i.min(j)), self.blocks.of(i.max(j)));
        let runs = self.tiles[self.blocks.tile((a, b))].runs();
        let entry = |(_, columns, values): (u16, &[u16], &[f32])| {
            Some(values[columns.binary_search(&(column as u16)).ok()?])
        };
        runs.filter(|&(of, ..)| u32::from(of) == row).find_map(entry).unwrap_or(0.0)
    }

    /// The entries of row `i` as (j, s), sorted. Searches all tiles that contain the row.
    pub(crate) fn row(&self, i: usize) -> Vec<(usize, f32)> {
        self.assert_whole();
        let (block, place) = self.blocks.of(i);
        let mut row: Vec<(usize, f32)> =
            self.diagonal.get(i).filter(|&&s| s != 0.0).map(|&s| (i, s)).into_iter().collect();
        for other in 0..self.blocks.count() {
            let start = self.blocks.range(other).start;
            let tile = &self.tiles[self.blocks.tile((block.min(other), block.max(other)))];
            for (of, columns, values) in tile.runs() {
                if block <= other && u32::from(of) == place {
                    row.extend(columns.iter().zip(values).map(|(&c, &s)| (start + usize::from(c), s)));
                }
                if block >= other
                    && let Ok(k) = columns.binary_search(&(place as u16))
                {
                    row.push((start + usize::from(of), values[k]));
                }
            }
        }
        row.sort_unstable_by_key(|&(j, _)| j);
        row
    }

    /// All rows, compressed, with both directions of every pair. Takes twice the memory.
    pub(crate) fn rows(&self) -> Matrix {
        self.assert_whole();
        let n = self.len();
        let mut rows: Vec<Vec<(u32, f32)>> = vec![Vec::new(); n];
        for (i, s) in self.diagonal() {
            rows[i].push((i as u32, s));
        }
        let entries: Vec<Vec<(usize, usize, f32)>> = self.tiles().map(Iterator::collect).collect();
        for (i, j, s) in entries.into_iter().flatten() {
            rows[i].push((j as u32, s));
            rows[j].push((i as u32, s));
        }
        rows.par_iter_mut().for_each(|row| row.sort_unstable_by_key(|&(j, _)| j));
        let mut starts = vec![0];
        rows.iter().for_each(|row| starts.push(starts[starts.len() - 1] + row.len()));
        let (columns, values) = rows.into_iter().flatten().unzip();
        Matrix::new((n, n), starts, columns, values)
    }

    /// Replaces every value off the diagonal by `value(i, j, s)`.
    pub(crate) fn update(&mut self, value: impl Fn(usize, usize, f32) -> f32 + Sync) {
        let rows = self.blocks.rows();
        let at = self.blocks.tiles();
        self.tiles.par_iter_mut().with_max_len(1).zip(at).for_each(|(tile, (a, b))| {
            let mut rest = tile.columns.iter().zip(&mut tile.values);
            for &[row, length] in &tile.runs {
                let i = a * rows + usize::from(row);
                for (&column, s) in rest.by_ref().take(length.into()) {
                    *s = value(i, b * rows + usize::from(column), *s);
                }
            }
        });
    }

    /// Calls `pair(s_ij, z_i, z_j, y_i, y_j)` for all pairs off the diagonal. Each y is updated in the same order for
    /// any number of threads.
    pub(crate) fn accumulate<Z: Copy + Sync, Y: Copy + Send + Words>(
        &self,
        z: &[Z],
        y: &mut [Y],
        pair: impl Fn(f32, &Z, &Z, &mut Y, &mut Y) + Sync,
    ) {
        assert_eq!(z.len(), self.len(), "sizes disagree");
        self.blocks.meet(y, |at, first, mut second| {
            let tile = &self.tiles[self.blocks.tile(at)];
            let (z_first, z_second) = (&z[self.blocks.range(at.0)], &z[self.blocks.range(at.1)]);
            let (mut columns, mut values) = (&tile.columns[..], &tile.values[..]);
            for &[row, length] in &tile.runs {
                let (own, rest) = columns.split_at(length.into());
                let (s, rest_of_values) = values.split_at(length.into());
                (columns, values) = (rest, rest_of_values);
                let row = usize::from(row);
                // These stay in registers for the whole row.
                let (z_row, mut sum) = (z_first[row], first[row]);
                let y_second = match &mut second {
                    Some(second) => &mut **second,
                    None => &mut *first,
                };
                // Equal lengths let one bounds check serve both slices.
                let z_second = &z_second[..y_second.len()];
                let s = &s[..own.len()];
                for k in 0..own.len() {
                    let column = usize::from(own[k]);
                    pair(s[k], &z_row, &z_second[column], &mut sum, &mut y_second[column]);
                }
                first[row] = sum;
            }
        });
    }

    /// Adds Σ_j s_ij z_j to every `out_i`, for `C` channels, in single or double precision.
    pub(crate) fn add_product<T: Real, const C: usize>(&self, z: &[[T; C]], out: &mut [[T; C]]) {
        for (i, s) in self.diagonal() {
            for c in 0..C {
                out[i][c] += T::from(s) * z[i][c];
            }
        }
        self.accumulate(z, out, |s, z_i, z_j, at_i, at_j| {
            let s = T::from(s);
            for c in 0..C {
                at_i[c] += s * z_j[c];
                at_j[c] += s * z_i[c];
            }
        });
    }

    /// Σ_j s_ij z_j of every row.
    pub(crate) fn product(&self, z: &[f64]) -> Vec<f64> {
        let mut sums = vec![[0f64]; self.len()];
        self.add_product(z.as_chunks().0, &mut sums);
        sums.into_flattened()
    }

    /// Σ_j s_ij of every row.
    pub(crate) fn row_sums(&self) -> Vec<f64> {
        self.product(&vec![1.0; self.len()])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compares with the plain sum over a list of pairs. All values are whole numbers, so that no rounding hides a
    /// difference.
    #[test]
    fn a_product_is_that_of_the_whole_matrix() {
        let n = 2500u32;
        let mut pairs = Vec::new();
        for i in 0..n {
            for k in 0..7 {
                pairs.push((i, (i * 37 + k * k * 101) % n, ((i + k) % 5 + 1) as f32));
            }
        }
        let z: Vec<[f64; 3]> =
            (0..n).map(|i| [f64::from(i % 11), f64::from(i % 3), f64::from(i % 17)]).collect();
        let mut wanted = vec![[0.0; 3]; n as usize];
        let mut add = |i: u32, j: u32, s: f32| {
            for c in 0..3 {
                wanted[i as usize][c] += f64::from(s) * z[j as usize][c];
            }
        };
        for &(i, j, s) in &pairs {
            add(i, j, s);
            if i != j {
                add(j, i, s);
            }
        }
        let lists: Vec<Vec<(u32, u32, f32)>> = pairs.chunks(1000).map(<[_]>::to_vec).collect();
        let matrix = Symmetric::from_lists(n as usize, &lists);
        let mut found = vec![[0.0; 3]; n as usize];
        matrix.add_product(&z, &mut found);
        assert_eq!(found, wanted);
        let rows = matrix.rows();
        assert_eq!(rows.nnz(), matrix.non_zeros());
        for i in [0, 1, 1023, 1024, 2499] {
            for j in 0..n as usize {
                assert_eq!(matrix.get(i, j), rows.get(i, j).copied().unwrap_or(0.0));
            }
            let (columns, values) = row(&rows, i);
            let row: Vec<(usize, f32)> =
                columns.iter().map(|&j| j as usize).zip(values.iter().copied()).collect();
            assert_eq!(matrix.row(i), row);
        }
        let again = Symmetric::from_rows(&rows);
        assert_eq!((again.non_zeros(), again.row_sums()), (matrix.non_zeros(), matrix.row_sums()));
    }
}
