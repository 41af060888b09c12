//! The random numbers of one path.

use rand_pcg::{Pcg32, rand_core::Rng};

use crate::{
    Progress, Result,
    trace::sampling::{mix, sobol_4d},
};

/// Number of samples between two checks whether the computation was stopped.
const STRETCH: u32 = 1024;

/// Takes `count` samples in order and reports their progress. Ends early if the computation is stopped.
#[inline]
pub(super) fn take(count: u32, progress: &Progress, mut sample: impl FnMut(u32) -> Result<()>) -> Result<()> {
    for start in (0..count).step_by(STRETCH as usize) {
        progress.check()?;
        let end = count.min(start.saturating_add(STRETCH));
        (start..end).try_for_each(&mut sample)?;
        progress.advance(u64::from(end - start));
    }
    Ok(())
}

/// Number of groups of four dimensions that come from Sobol sequences. A path's first decisions (pixel or place, first
/// direction, point on a lamp, second direction) cause most of the variance. More groups give no measurable gain.
const SOBOL_GROUPS: u32 = 2;

/// Makes the seed of branches different from the seed of paths.
const BRANCH: u64 = 0x6272_616e_6368;

/// The random numbers of one path: scrambled Sobol points first, then a pseudo-random stream.
///
/// Each group of four dimensions is its own Owen-scrambled and shuffled sequence (the padding of Burley, JCGT 10(1),
/// 2020, section 5).
#[derive(Debug, Clone)]
pub struct Samples {
    index: u32,
    seed: u64,
    group: u32,
    spare: Option<[f32; 2]>,
    stream: Pcg32,
}

impl Samples {
    /// The numbers of path `index` in the point set with this seed.
    #[inline]
    pub fn new(index: u32, seed: u64) -> Self {
        let stream = Pcg32::new(mix(&[seed, index as u64]), seed);
        Samples { index, seed, group: 0, spare: None, stream }
    }

    /// The numbers of branch `k` of `of` branches of this path. The branches of all paths of the point set form one
    /// sequence, so they are stratified across paths too.
    #[inline]
    pub fn branch(&self, k: u32, of: u32) -> Samples {
        // Indices may wrap: after the end of a sequence, a new scramble begins in any case.
        Samples::new(self.index.wrapping_mul(of).wrapping_add(k), mix(&[self.seed, BRANCH]))
    }

    /// A uniform number in \[0, 1) with 24 bits.
    #[inline]
    pub fn number(&mut self) -> f32 {
        (self.stream.next_u32() >> 8) as f32 * 2f32.powi(-24)
    }

    /// A point of the unit square from the next pair of dimensions.
    #[inline]
    pub fn square(&mut self) -> [f32; 2] {
        if let Some(pair) = self.spare.take() {
            return pair;
        }
        if self.group == SOBOL_GROUPS {
            return [self.number(), self.number()];
        }
        let [x, y, z, w] = sobol_4d(self.index, self.seed.wrapping_add(mix(&[self.group as u64])));
        self.group += 1;
        self.spare = Some([z, w]);
        [x, y]
    }

    /// A point of the unit square whose first coordinate has 53 bits. If it chooses among millions of items, its
    /// remainder is still a uniform number.
    #[inline]
    pub fn fine_square(&mut self) -> (f64, f32) {
        let [x, y] = self.square();
        let x = f64::from(x) + f64::from(self.stream.next_u32()) * 2f64.powi(-56);
        (x.min(1.0 - f64::EPSILON), y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;

    #[test]
    fn a_stop_is_obeyed_amid_many_samples() {
        let progress = Progress::new();
        let mut last = 0;
        let taken = take(u32::MAX, &progress, |s| {
            last = s;
            if s == 5000 {
                progress.stop();
            }
            Ok(())
        });
        assert!(matches!(taken, Err(Error::Stopped)));
        assert!((5000..5000 + STRETCH).contains(&last) && progress.done() > 5000, "{last}");

        let (progress, mut taken) = (Progress::new(), Vec::new());
        let push = |s| {
            taken.push(s);
            Ok(())
        };
        take(2500, &progress, push).unwrap();
        assert!(taken.into_iter().eq(0..2500) && progress.done() == 2500);
    }

    /// Counts 2¹² points of two coordinates in 16 × 16 cells: 16 are expected in each.
    fn largest_deviation(pick: impl Fn(&mut Samples) -> [f64; 2]) -> f64 {
        let mut cells = [[0.0f64; 16]; 16];
        for i in 0..1 << 12 {
            let [x, y] = pick(&mut Samples::new(i, 42));
            cells[(x * 16.0) as usize][(y * 16.0) as usize] += 1.0;
        }
        cells.iter().flatten().map(|c| (c - 16.0).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn groups_are_padded_without_correlation() {
        // If both groups had the same scramble, most cells would be empty.
        let across = largest_deviation(|s| {
            let [x, _] = s.square();
            s.square();
            [x as f64, s.square()[0] as f64]
        });
        assert!(across < 5.0 * 4.0, "{across}");
        let within = largest_deviation(|s| s.square().map(f64::from));
        assert_eq!(within, 0.0, "a (0, 2) net puts 16 points in each cell");
        let late = largest_deviation(|s| {
            for _ in 0..4 {
                s.square();
            }
            s.square().map(f64::from)
        });
        assert!(late > 0.0 && late < 5.0 * 4.0, "{late}");
    }

    #[test]
    fn branches_are_one_sequence_of_their_own() {
        // 2¹⁰ paths have 4 branches each. If each cell holds 16 points, all branches form one net.
        let across = largest_deviation(|s| {
            Samples::new(s.index / 4, 42).branch(s.index % 4, 4).square().map(f64::from)
        });
        assert_eq!(across, 0.0);
        let [own, branch] = [Samples::new(0, 42), Samples::new(0, 42).branch(0, 1)].map(|mut s| s.square());
        assert_ne!(own, branch);
    }

    #[test]
    fn fine_numbers_fill_the_gaps_of_single_precision() {
        let mut low_bits = 0;
        for i in 0..1000 {
            let (x, _) = Samples::new(i, 7).fine_square();
            assert!((0.0..1.0).contains(&x));
            low_bits += ((x * 2f64.powi(40)) as u64 & 1) as i32;
        }
        assert!((400..600).contains(&low_bits), "{low_bits}");
    }
}
