//! Disjoint sets of numbers (Galler and Fischer, CACM 7(5), 1964).

/// Sets of numbers. Any two of them can be united.
pub(crate) struct DisjointSets(Vec<u32>);

impl DisjointSets {
    /// `n` sets with one member each.
    pub(crate) fn new(n: usize) -> DisjointSets {
        DisjointSets((0..n as u32).collect())
    }

    /// The least member of a set.
    pub(crate) fn root(&mut self, mut i: usize) -> usize {
        while self.0[i] as usize != i {
            self.0[i] = self.0[self.0[i] as usize];
            i = self.0[i] as usize;
        }
        i
    }

    pub(crate) fn unite(&mut self, i: usize, j: usize) {
        let (i, j) = (self.root(i), self.root(j));
        self.0[i.max(j)] = i.min(j) as u32;
    }

    /// The index of the set of each number, in the order of their first members, and the number of sets.
    pub(crate) fn numbers(mut self) -> (Vec<u32>, usize) {
        let (mut count, mut numbers) = (0, vec![0; self.0.len()]);
        for i in 0..self.0.len() {
            let root = self.root(i);
            if root == i {
                numbers[i] = count;
                count += 1;
            } else {
                numbers[i] = numbers[root];
            }
        }
        (numbers, count as usize)
    }
}
