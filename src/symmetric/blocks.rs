//! Patches in blocks, and the order in which threads work on pairs of blocks.
//!
//! Each block takes part in its tiles (pairs of blocks) in the order of a tournament in which everyone meets everyone
//! (the circle method; Kirkman, 1847). Many tiles that share no block run at the same time, no two threads write to the
//! same place, and every sum has the same order for any number of threads.

use std::{ops::Range, sync::Mutex};

use crate::ranks::{Ranks, Words};

/// Most rows of a block. Smaller blocks keep the memory of a product closer together. But at a million patches their
/// tiles would have no more entries than rows, and reading the rows would take all the time.
const MOST_ROWS: usize = 1 << PLACE;
/// Bits of a place within a block.
pub(crate) const PLACE: u32 = u16::BITS;
/// Fewest rows of a block: smaller tiles are not worth a task.
const LEAST_ROWS: usize = 1 << 9;
/// Fewest blocks, for threads to share: each tile occupies two. Tiles differ much in their number of entries. With half
/// as many blocks, two threads would wait up to a third of their time.
const ENOUGH_BLOCKS: usize = 16;

/// How patches are divided into blocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Blocks {
    len: usize,
    /// Logarithm of the number of rows of a block.
    bits: u32,
    /// The processes that share out the blocks. Each has the tiles of its blocks.
    ranks: Ranks,
}

impl Blocks {
    pub(crate) fn new(len: usize) -> Blocks {
        Self::of_rows(len, LEAST_ROWS, MOST_ROWS)
    }

    /// Blocks of between `least` and `most` rows, as a power of two, and enough of them if these bounds permit.
    pub(crate) fn of_rows(len: usize, least: usize, most: usize) -> Blocks {
        assert!(most <= MOST_ROWS, "places have {PLACE} bits");
        let bits = (len / ENOUGH_BLOCKS).clamp(least, most).ilog2();
        Blocks { len, bits, ranks: Ranks::alone() }
    }

    /// The same blocks, shared out among processes.
    pub(crate) fn among(self, ranks: Ranks) -> Blocks {
        Blocks { ranks, ..self }
    }

    /// The processes that share out the blocks.
    pub(crate) fn ranks(self) -> Ranks {
        self.ranks
    }

    /// The rank that computes the values of a block.
    fn owner(self, block: usize) -> usize {
        block * self.ranks.count() / self.count()
    }

    /// Whether this process computes the values of a block.
    pub(crate) fn owns(self, block: usize) -> bool {
        self.owner(block) == self.ranks.rank()
    }

    /// Whether this process has a tile, because it owns one of its blocks.
    pub(crate) fn has(self, (a, b): (usize, usize)) -> bool {
        self.owns(a) || self.owns(b)
    }

    /// Brings the values of all blocks to all ranks.
    pub(crate) fn share<V: Words>(self, values: &mut [V]) {
        self.ranks.share(values, (0..self.count()).map(|block| (self.range(block), self.owner(block))));
    }

    /// Number of patches.
    pub(crate) fn len(self) -> usize {
        self.len
    }

    /// Number of blocks.
    pub(crate) fn count(self) -> usize {
        self.len.div_ceil(self.rows())
    }

    /// Number of rows of each block but the last.
    pub(crate) fn rows(self) -> usize {
        1 << self.bits
    }

    /// The patches of a block.
    pub(crate) fn range(self, block: usize) -> Range<usize> {
        block * self.rows()..((block + 1) * self.rows()).min(self.len)
    }

    /// The block of a patch, and its place there.
    #[inline]
    pub(crate) fn of(self, i: usize) -> (usize, u32) {
        (i >> self.bits, (i & (self.rows() - 1)) as u32)
    }

    /// The tiles, as pairs of blocks of which the second is not before the first.
    pub(crate) fn tiles(self) -> Vec<(usize, usize)> {
        (0..self.count()).flat_map(|a| (a..self.count()).map(move |b| (a, b))).collect()
    }

    /// Index of a tile in the order of [`Blocks::tiles`].
    pub(crate) fn tile(self, (a, b): (usize, usize)) -> usize {
        a * (2 * self.count() - a + 1) / 2 + b - a
    }

    /// All tiles in rounds: no two tiles of a round share a block.
    fn rounds(self) -> impl Iterator<Item = Vec<(usize, usize)>> {
        let count = self.count();
        // With an odd number of blocks one rests in every round.
        let last = (count + count % 2).max(2) - 1;
        let round = move |round: usize| {
            let meet = |k: usize| match k {
                0 => (round, last),
                k => {
                    let (a, b) = ((round + k) % last, (round + last - k) % last);
                    (a.min(b), a.max(b))
                }
            };
            (0..=last / 2).map(meet).filter(|&(_, b)| b < count).collect()
        };
        std::iter::once((0..count).map(|a| (a, a)).collect()).chain((0..last).map(round))
    }

    /// Calls `work((a, b), part a of values, part b)` for all tiles. The second part is `None` on the diagonal. Each
    /// value is updated in the same order for any number of threads and of ranks. A rank works on the tiles of its own
    /// blocks. It also adds to the values of other blocks, which their owners replace.
    pub(crate) fn meet<Y: Send + Words>(
        self,
        values: &mut [Y],
        work: impl Fn((usize, usize), &mut [Y], Option<&mut [Y]>) + Sync,
    ) {
        assert_eq!(values.len(), self.len, "sizes disagree");
        let parts: Vec<Mutex<&mut [Y]>> = values.chunks_mut(self.rows()).map(Mutex::new).collect();
        // These locks are always free: they only satisfy the borrow checker.
        let part = |k: usize| parts[k].try_lock().expect("a block is in one tile at a time");
        let tournament = Mutex::new(Tournament::new(self));
        let next = || tournament.lock().expect("nobody panics while choosing").next();
        let play = || {
            loop {
                match next() {
                    Next::Over => return,
                    // The thread that holds a missing block may have lost its processor for a while.
                    Next::Wait => std::thread::yield_now(),
                    Next::Tile((a, b)) => {
                        if a == b {
                            work((a, b), &mut part(a), None);
                        } else {
                            work((a, b), &mut part(a), Some(&mut part(b)));
                        }
                        tournament.lock().expect("nobody panics while choosing").end((a, b));
                    }
                }
            }
        };
        rayon::scope(|scope| {
            for _ in 1..rayon::current_num_threads().min(self.count().div_ceil(2)) {
                scope.spawn(|_| play());
            }
            play();
        });
        drop(parts);
        self.share(values);
    }
}

/// The tiles already begun and done. A tile is next when both of its blocks have done all their earlier tiles, so that
/// no thread waits for a whole round.
struct Tournament {
    /// The tiles round by round, each with its position in the order of its first and of its second block.
    tiles: Vec<((usize, usize), [usize; 2])>,
    begun: Vec<bool>,
    /// All tiles before this one have begun.
    first: usize,
    /// Number of tiles that each block has done.
    done: Vec<usize>,
}

enum Next {
    Tile((usize, usize)),
    Wait,
    Over,
}

impl Tournament {
    fn new(blocks: Blocks) -> Tournament {
        let mut played = vec![0; blocks.count()];
        let mut tiles = Vec::with_capacity(blocks.count() * (blocks.count() + 1) / 2);
        for (a, b) in blocks.rounds().flatten().filter(|&tile| blocks.has(tile)) {
            tiles.push(((a, b), [played[a], played[b]]));
            played[a] += 1;
            played[b] += usize::from(a != b);
        }
        Tournament { begun: vec![false; tiles.len()], tiles, first: 0, done: vec![0; blocks.count()] }
    }

    /// Begins a tile.
    fn next(&mut self) -> Next {
        while self.begun.get(self.first) == Some(&true) {
            self.first += 1;
        }
        let is_next = |k: &usize| {
            let ((a, b), numbers) = self.tiles[*k];
            !self.begun[*k] && numbers == [self.done[a], self.done[b]]
        };
        match (self.first..self.tiles.len()).find(is_next) {
            Some(k) => {
                self.begun[k] = true;
                Next::Tile(self.tiles[k].0)
            }
            None if self.first == self.tiles.len() => Next::Over,
            None => Next::Wait,
        }
    }

    /// Ends a tile.
    fn end(&mut self, (a, b): (usize, usize)) {
        self.done[a] += 1;
        self.done[b] += usize::from(a != b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everyone_meets_everyone_once_and_nobody_two_at_a_time() {
        for len in [1, 1024, 1025, 3000, 5000, 40_000, 16 * 16_384, 700_000] {
            let blocks = Blocks::new(len);
            let mut met = Vec::new();
            for round in blocks.rounds() {
                let mut busy: Vec<usize> =
                    round.iter().flat_map(|&(a, b)| if a == b { vec![a] } else { vec![a, b] }).collect();
                busy.sort_unstable();
                assert!(busy.windows(2).all(|w| w[0] != w[1]), "{len}: {round:?}");
                met.extend(round);
            }
            met.sort_unstable();
            assert_eq!(met, blocks.tiles());
            assert!(met.iter().enumerate().all(|(k, &at)| blocks.tile(at) == k));
        }
    }
}
