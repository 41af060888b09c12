//! The exchange of two polygons with something between them.
//!
//! The exchange G with nothing between them is known. Samples have weights w, whose mean is G, and a share V of each
//! weight is free. A sample is a path, which is free (V = 1) or blocked (V = 0), or a point of one polygon, which sees
//! a part of the other one ([`Shadows`](super::shadows::Shadows)). The mean of V w + β (G - w) is unbiased for any β
//! that is estimated from other samples (regression with a control variate, cross-fitted). β is the free share of the
//! weight in the other replicates. If all samples are free the estimate is exactly G, and if all are blocked it is
//! exactly zero.

use crate::trace::sampling::{mix, sobol_4d};

/// Independent replicates of a pair's paths. Their spread estimates the standard error. Each uses a different digital
/// shift of a Sobol sequence.
pub(super) const REPLICATES: u32 = 16;

/// This many times (μ₃ / (μ₂ rays))² is added to the variance, where μ₂ and μ₃ are central moments of the hidden weights of the samples,
/// because the mean of few skew samples is seldom far on the side of the rare ones (N. J. Johnson, "Modified t Tests and Confidence
/// Intervals for Asymmetrical Populations", JASA 73(363), 1978). If few paths are blocked, μ₃ / μ₂ is their weight, and A. Agresti and
/// B. A. Coull add about as much to a binomial interval ("Approximate is Better than Exact", American Statistician 52(2), 1998).
pub(super) const DOUBT: f64 = 1.12;

/// If all samples agree, their spread is unknown. Then this many times (largest weight / rays)² is added instead. If all of n paths are
/// free, at most a share of 3.69 / n is blocked with 97.5 % confidence, since exp(-3.69) = 0.025 (C. J. Clopper and E. S. Pearson,
/// Biometrika 26(4), 1934). The blocked paths may be the heaviest, and their weight must lie within 1.96 standard errors. Measured on a
/// panel that touches the ground, where a wall hides 16 % of the weight but 9 % of the paths: with [`DOUBT`] alone, 77 % of the
/// intervals contained the right value at 16 paths, and 92 % at 32.
const AGREED: f64 = (3.69 / 1.960) * (3.69 / 1.960);

/// With sixteen replicates the variance has 15 degrees of freedom, so that 95 % of means lie within t = 2.131 standard errors instead of
/// 1.960. Variances are multiplied by the square of the ratio. Then 1.96 standard errors are a 95 % interval.
const STUDENT: f64 = (2.131 / 1.960) * (2.131 / 1.960);

/// Number of points of a sequence before a new one begins.
const SEQUENCE: u32 = 1 << 12;

/// Points of one scrambled Sobol sequence, as fractions of 2³². Each replicate shifts the digits in its own way, which
/// preserves the even distribution (digital shift; Dick and Pillichshammer, *Digital Nets and Sequences*, sec. 4.4).
pub(super) struct Sequence(Vec<[u32; 4]>);

impl Sequence {
    pub(super) fn new() -> Sequence {
        Sequence((0..SEQUENCE).map(|index| sobol_4d(index, 0).map(|x| (x * 2f32.powi(32)) as u32)).collect())
    }

    /// `count` points of a replicate.
    fn points(&self, words: [u64; 4], count: u32) -> impl Iterator<Item = [f64; 4]> + '_ {
        const UNIT: f64 = 1.0 / (1u64 << 32) as f64;
        (0..count.div_ceil(SEQUENCE)).flat_map(move |block| {
            let seed = mix(&words);
            let [a, b] = [0, 1].map(|k| mix(&[seed, u64::from(block), k]));
            let shift = [a as u32, (a >> 32) as u32, b as u32, (b >> 32) as u32];
            let points = &self.0[..(count - block * SEQUENCE).min(SEQUENCE) as usize];
            // In the middle of the interval of each number.
            points
                .iter()
                .map(move |digits| [0, 1, 2, 3].map(|k| (f64::from(digits[k] ^ shift[k]) + 0.5) * UNIT))
        })
    }
}

/// Samples of a pair. For each replicate, the mean of w and the mean of V w.
pub(super) struct Sample {
    sums: [(f64, f64); REPLICATES as usize],
    /// The largest weight.
    largest: f64,
    /// Sums of the powers 1 to 3 of the hidden weights.
    hidden: [f64; 3],
    replicates: u32,
    rays: u32,
}

impl Sample {
    /// About `rays` samples, at least two. `sample` maps a point of the unit hypercube to a weight and the free part of it.
    pub(super) fn cast(
        rays: u32,
        sequence: &Sequence,
        seed: [u64; 3],
        mut sample: impl FnMut([f64; 4]) -> (f64, f64),
    ) -> Sample {
        let replicates = rays.clamp(2, REPLICATES);
        let each = rays.div_ceil(replicates).max(1);
        let mut sums = [(0.0, 0.0); REPLICATES as usize];
        let (mut largest, mut powers) = (0f64, [0.0; 3]);
        for (k, sum) in (0u64..).zip(&mut sums[..replicates as usize]) {
            for point in sequence.points([seed[0], seed[1], seed[2], k], each) {
                let (weight, free) = sample(point);
                *sum = (sum.0 + weight, sum.1 + free);
                largest = largest.max(weight);
                let hidden = weight - free;
                powers[0] += hidden;
                powers[1] += hidden * hidden;
                powers[2] += hidden * hidden * hidden;
            }
            *sum = (sum.0 / f64::from(each), sum.1 / f64::from(each));
        }
        Sample { sums, largest, hidden: powers, replicates, rays: each * replicates }
    }

    /// Whether nothing was free. The estimate is then zero.
    pub(super) fn is_blocked(&self) -> bool {
        self.sums.iter().all(|sum| sum.1 == 0.0)
    }

    /// |μ₃| / μ₂ of the hidden weights.
    fn skew(&self) -> f64 {
        let [mean, square, cube] = self.hidden.map(|sum| sum / f64::from(self.rays));
        let second = square - mean * mean;
        // Otherwise the difference is rounding.
        if second > 1e-12 * square {
            ((cube - 3.0 * mean * square + 2.0 * mean.powi(3)) / second).abs()
        } else {
            0.0
        }
    }

    /// The estimate, given the exchange with nothing between the two polygons.
    pub(super) fn estimate(&self, unoccluded: f64) -> Estimate {
        let sums = &self.sums[..self.replicates as usize];
        let all = sums.iter().fold((0.0, 0.0), |all, sum| (all.0 + sum.0, all.1 + sum.1));
        let estimate = |&(weight, free): &(f64, f64)| {
            let others = (all.0 - weight, all.1 - free);
            let share = if others.0 > 0.0 { (others.1 / others.0).clamp(0.0, 1.0) } else { 0.0 };
            free + share * (unoccluded - weight)
        };
        let all_agree = sums.iter().all(|&(weight, free)| free == weight) || self.is_blocked();
        // Fewer than sixteen replicates are cast where single pairs do not matter. The variance of a sum over many pairs is right
        // without the addition.
        let matters = self.replicates == REPLICATES;
        let doubt = match all_agree {
            true if matters => AGREED.sqrt() * self.largest,
            true => DOUBT.sqrt() * unoccluded,
            false => DOUBT.sqrt() * self.skew().min(unoccluded),
        };
        let count = f64::from(self.replicates);
        let mean = sums.iter().map(estimate).sum::<f64>() / count;
        let squares: f64 = sums.iter().map(|sum| (estimate(sum) - mean).powi(2)).sum();
        Estimate {
            exchange: mean,
            variance: squares / (count * (count - 1.0)) * if matters { STUDENT } else { 1.0 },
            doubt: doubt / f64::from(self.rays),
            rays: self.rays,
        }
    }
}

/// The estimate of a pair from its samples.
#[derive(Debug, Clone, Copy)]
pub(super) struct Estimate {
    /// A_i F_ij. May be a little below zero.
    pub(super) exchange: f64,
    /// Its variance, by the spread of the replicates.
    pub(super) variance: f64,
    /// An additional standard error of a single pair, because replicates may agree by chance.
    pub(super) doubt: f64,
    pub(super) rays: u32,
}

impl Estimate {
    /// The doubt of one ray.
    pub(super) fn doubt_of_ray(&self) -> f64 {
        self.doubt * f64::from(self.rays)
    }

    /// The standard deviation of one ray, estimated from few rays.
    pub(super) fn deviation(&self) -> f64 {
        let rays = f64::from(self.rays);
        (self.variance * rays + 0.1 * self.doubt_of_ray().powi(2) / rays).sqrt()
    }
}

/// The number of rays at which a pair reduces the sum of variances as much per ray as any other pair: where the
/// derivative of w² (deviation² / n + doubt² / n²) is -1 / pace² (Neyman, 1934, extended by the doubt of a ray).
pub(super) fn rays(weight: f64, deviation: f64, doubt: f64, pace: f64) -> f64 {
    (pace * weight * deviation).max((2.0 * (pace * weight * doubt).powi(2)).cbrt())
}

/// The variance that remains with this number of rays.
pub(super) fn variance(deviation: f64, doubt: f64, rays: f64) -> f64 {
    (deviation * deviation + doubt * doubt / rays) / rays
}
