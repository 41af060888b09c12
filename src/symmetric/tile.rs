//! The entries of two blocks of a symmetric matrix, by rows.
//!
//! An entry takes 4 bytes for its value and 2 for its column. Every run of entries of a row takes 4 bytes more. A pair
//! takes 6 to 10 bytes in all. Runs of equal length follow each other as far as memory stays local: a mispredicted end
//! of a run costs as much time as eight entries.

/// Entry of a tile: row and column within the tile, and value.
pub(super) type Entry = (u16, u16, f32);

/// Runs are sorted by length within groups of 2^NEAR rows. Across all rows of a large block their reads and writes
/// would be too far apart.
const NEAR: u32 = 9;

/// The entries of two blocks, by rows.
#[derive(Debug, Clone, Default)]
pub(super) struct Tile {
    /// Row and length of each run of entries.
    pub(super) runs: Vec<[u16; 2]>,
    pub(super) columns: Vec<u16>,
    pub(super) values: Vec<f32>,
}

impl Tile {
    /// Builds a tile from `count` entries that are sorted by row.
    pub(super) fn of(entries: impl Iterator<Item = Entry>, count: usize) -> Tile {
        let mut by_row =
            Tile { runs: Vec::new(), columns: Vec::with_capacity(count), values: Vec::with_capacity(count) };
        for (row, column, value) in entries {
            match by_row.runs.last_mut() {
                Some([last, length]) if *last == row && *length < u16::MAX => *length += 1,
                _ => by_row.runs.push([row, 1]),
            }
            by_row.columns.push(column);
            by_row.values.push(value);
        }
        let mut runs: Vec<_> = by_row.runs().collect();
        runs.sort_by_key(|&(row, columns, _)| (row >> NEAR, columns.len()));
        let mut tile = Tile {
            runs: runs.iter().map(|&(row, columns, _)| [row, columns.len() as u16]).collect(),
            columns: Vec::with_capacity(by_row.columns.len()),
            values: Vec::with_capacity(by_row.values.len()),
        };
        for (_, columns, values) in runs {
            tile.columns.extend_from_slice(columns);
            tile.values.extend_from_slice(values);
        }
        tile
    }

    /// The runs as row, columns, values.
    pub(super) fn runs(&self) -> impl Iterator<Item = (u16, &[u16], &[f32])> {
        self.runs.iter().scan(0, |start, &[row, length]| {
            let range = *start..*start + usize::from(length);
            *start = range.end;
            Some((row, &self.columns[range.clone()], &self.values[range]))
        })
    }

    pub(super) fn entries(&self) -> impl Iterator<Item = Entry> + '_ {
        let rows = self.runs.iter().flat_map(|&[row, length]| std::iter::repeat_n(row, length.into()));
        rows.zip(&self.columns).zip(&self.values).map(|((row, &column), &value)| (row, column, value))
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> usize {
        4 * self.runs.len() + 6 * self.values.len()
    }
}
