//! Points of the four-dimensional Owen-scrambled Sobol sequence, several at a time.
//!
//! They equal the points of [`sobol_4d`](super::sampling::sobol_4d) and take a third of the time. Hashes of the seed
//! are computed once, the linear map from a number to its point is looked up byte by byte, and the compiler scrambles
//! all lanes at once.

use std::{ops::Range, sync::LazyLock};

use sobol_burley::parts::{hash, owen_scramble_rev, sobol_rev, u32_to_f32_norm};

use super::sampling::{SEQUENCE, seed_of};

/// Number of points computed at a time.
pub const LANES: usize = 8;

/// The points of all numbers with a single non-zero byte, the first or the second of their reversed bits. Numbers have
/// two bytes.
static POINTS: LazyLock<[[[u32; 4]; 256]; 2]> = LazyLock::new(|| {
    let point = |number: u32| [0, 1, 2, 3].map(|dimension| sobol_rev(number, dimension));
    [24, 16].map(|shift| std::array::from_fn(|byte| point((byte as u32) << shift)))
});

/// The sequence with one seed.
#[derive(Clone, Copy)]
pub struct Sobol {
    seed: u64,
    scramble: Scramble,
    points: &'static [[[u32; 4]; 256]; 2],
}

/// Hashes of a seed: one shuffles the numbers, and one scrambles each dimension. Burley, "Practical Hash-based Owen
/// Scrambling", JCGT 10(1), 2020; the words are those of sobol_burley, so that points are the same.
#[derive(Clone, Copy)]
struct Scramble {
    numbers: u32,
    dimensions: [u32; 4],
}

impl Scramble {
    fn new(seed: u32) -> Scramble {
        const DIMENSIONS: [u32; 4] = [0x912f_69ba, 0x174f_18ab, 0x691e_72ca, 0xb40c_c1b8];
        Scramble {
            numbers: hash(seed ^ 0x79c6_8e4a),
            dimensions: DIMENSIONS.map(|word| hash(seed.wrapping_mul(0x9c8f_2d3b) ^ word)),
        }
    }
}

/// The blocks of [`LANES`] points that contain these numbers: the first number of each block, and the wanted lanes.
#[inline]
pub fn blocks(numbers: Range<u32>) -> impl Iterator<Item = (u32, Range<usize>)> {
    let lanes = LANES as u32;
    (numbers.start / lanes..numbers.end.div_ceil(lanes)).map(move |block| {
        let first = block * lanes;
        let within = |number: u32| number.clamp(first, first + lanes) - first;
        (first, within(numbers.start) as usize..within(numbers.end) as usize)
    })
}

impl Sobol {
    /// The sequence of a seed.
    pub fn new(seed: u64) -> Sobol {
        Sobol { seed, scramble: Scramble::new(seed_of(seed, 0)), points: &POINTS }
    }

    /// The points from number `first` on, by dimension; coordinates in \[0, 1).
    ///
    /// # Panics
    /// When `first` is not a multiple of [`LANES`].
    #[inline]
    pub fn points(&self, first: u32) -> [[f32; LANES]; 4] {
        assert_eq!(first % LANES as u32, 0, "the first number must be a multiple of the lanes");
        let scramble =
            if first < SEQUENCE { self.scramble } else { Scramble::new(seed_of(self.seed, first)) };
        let base = (first % SEQUENCE).reverse_bits();
        let mut numbers = [0; LANES];
        for (lane, number) in numbers.iter_mut().enumerate() {
            *number = owen_scramble_rev(base | (lane as u32).reverse_bits(), scramble.numbers);
        }
        let mut digits = [[0; LANES]; 4];
        for lane in 0..LANES {
            let [first, second] = [24, 16].map(|shift| (numbers[lane] >> shift) as usize & 0xff);
            let (first, second) = (self.points[0][first], self.points[1][second]);
            for d in 0..4 {
                digits[d][lane] = first[d] ^ second[d];
            }
        }
        let mut points = [[0.0; LANES]; 4];
        for d in 0..4 {
            for lane in 0..LANES {
                let scrambled = owen_scramble_rev(digits[d][lane], scramble.dimensions[d]);
                points[d][lane] = u32_to_f32_norm(scrambled.reverse_bits());
            }
        }
        points
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::sampling::sobol_4d;

    #[test]
    fn blocks_hold_all_numbers_once() {
        for numbers in [0..0, 0..1, 3..5, 0..8, 7..9, 5..40, 16..24] {
            let found = blocks(numbers.clone())
                .flat_map(|(first, lanes)| lanes.map(move |lane| first + lane as u32))
                .collect::<Vec<_>>();
            assert_eq!(found, numbers.collect::<Vec<_>>());
        }
    }

    #[test]
    fn points_are_those_of_the_library() {
        for seed in [0, 1, 0x1234_5678_9abc_def0, u64::MAX] {
            let sobol = Sobol::new(seed);
            for first in (0..2048).chain(SEQUENCE - 64..SEQUENCE + 64).chain(5 * SEQUENCE..5 * SEQUENCE + 64)
            {
                if first % LANES as u32 == 0 {
                    let points = sobol.points(first);
                    for lane in 0..LANES {
                        let point = points.map(|lanes| lanes[lane]);
                        assert_eq!(point, sobol_4d(first + lane as u32, seed), "{first} {lane} {seed}");
                    }
                }
            }
        }
    }
}
