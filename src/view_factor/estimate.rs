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

/// The interval of a mean from n skew samples is too short: its coverage falls by 2 z φ(z) 0.97 γ² / n, where γ is the
/// skewness, if the kurtosis is 1.5 γ² as for gamma distributions, and 1.01 instead of 0.97 for rare events (P. Hall,
/// *The Bootstrap and Edgeworth Expansion*, 1992, sec. 2.6). This many times γ² / n of the variance is added, which
/// makes up for that. Rays of which k are blocked get the variance (k + 2) / n², about as much as A. Agresti and B. A.
/// Coull give a binomial interval ("Approximate is Better than Exact", American Statistician 52(2), 1998).
pub(super) const SKEWNESS: f64 = 2.0;

/// If all samples agree, their spread is unknown. Then this many times (largest weight / rays)² is added instead. If
/// all of n paths are free, at most a share of 3.69 / n is blocked with 97.5 % confidence, since exp(-3.69) = 0.025 (C.
/// J. Clopper and E. S. Pearson, Biometrika 26(4), 1934). The blocked paths may be the heaviest, and their weight must
/// lie within 1.96 standard errors.
const AGREED: f64 = (3.69 / 1.960) * (3.69 / 1.960);

/// The 97.5 % quantile of Student's t distribution, as a multiple of that of the normal distribution (M. Abramowitz and
/// I. A. Stegun, *Handbook of Mathematical Functions*, 26.7.5).
pub(super) fn student(freedom: f64) -> f64 {
    const Z2: f64 = 1.959964 * 1.959964;
    1.0 + (Z2 + 1.0) / (4.0 * freedom) + ((5.0 * Z2 + 16.0) * Z2 + 3.0) / (96.0 * freedom * freedom)
}

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
    moments: Moments,
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
        let (mut largest, mut moments) = (0f64, Moments::default());
        for (k, sum) in (0u64..).zip(&mut sums[..replicates as usize]) {
            for point in sequence.points([seed[0], seed[1], seed[2], k], each) {
                let (weight, free) = sample(point);
                *sum = (sum.0 + weight, sum.1 + free);
                largest = largest.max(weight);
                moments.add(free, weight - free);
            }
            *sum = (sum.0 / f64::from(each), sum.1 / f64::from(each));
        }
        Sample { sums, largest, moments, replicates, rays: each * replicates }
    }

    /// Whether nothing was free. The estimate is then zero.
    pub(super) fn is_blocked(&self) -> bool {
        self.sums.iter().all(|sum| sum.1 == 0.0)
    }

    /// The estimate, given the exchange with nothing between the two polygons. Without it, it is the mean.
    pub(super) fn estimate(&self, unoccluded: Option<f64>) -> Estimate {
        let sums = &self.sums[..self.replicates as usize];
        let all = sums.iter().fold((0.0, 0.0), |all, sum| (all.0 + sum.0, all.1 + sum.1));
        let estimate = |&(weight, free): &(f64, f64)| {
            let others = (all.0 - weight, all.1 - free);
            let share = if others.0 > 0.0 { (others.1 / others.0).clamp(0.0, 1.0) } else { 0.0 };
            free + unoccluded.map_or(0.0, |unoccluded| share * (unoccluded - weight))
        };
        let all_agree = sums.iter().all(|&(weight, free)| free == weight) || self.is_blocked();
        let (count, rays) = (f64::from(self.replicates), f64::from(self.rays));
        let mean = sums.iter().map(estimate).sum::<f64>() / count;
        let squares: f64 = sums.iter().map(|sum| (estimate(sum) - mean).powi(2)).sum();
        let variance = squares / (count * (count - 1.0));
        // Fewer than sixteen replicates are cast where single pairs do not matter. The variance of a sum over many pairs
        // is right without additions.
        let matters = self.replicates == REPLICATES;
        let doubt = match all_agree {
            true if matters => AGREED.sqrt() * self.largest / rays,
            true => self.largest / rays,
            false => (SKEWNESS * self.moments.skewness(all.1 / all.0).powi(2) / rays * variance).sqrt(),
        };
        Estimate { exchange: mean, variance, doubt, rays: self.rays, matters }
    }
}

/// Sums of the products f², f h, h² and f³, f² h, f h², h³ of the free and the hidden weights of all samples.
#[derive(Default)]
struct Moments {
    second: [f64; 3],
    third: [f64; 4],
    count: f64,
}

impl Moments {
    fn add(&mut self, free: f64, hidden: f64) {
        let second = [free * free, free * hidden, hidden * hidden];
        (0..3).for_each(|k| self.second[k] += second[k]);
        (0..3).for_each(|k| self.third[k] += free * second[k]);
        self.third[3] += hidden * second[2];
        self.count += 1.0;
    }

    /// The skewness of what the control variate leaves: f - V (f + h), whose mean is zero if V is the free share of the
    /// sum of all weights.
    fn skewness(&self, share: f64) -> f64 {
        let (a, b, n) = (1.0 - share, share, self.count);
        let ([ff, fh, hh], [fff, ffh, fhh, hhh]) = (self.second, self.third);
        let second = (a * a * ff - 2.0 * a * b * fh + b * b * hh) / n;
        let third = (a.powi(3) * fff - 3.0 * a * a * b * ffh + 3.0 * a * b * b * fhh - b.powi(3) * hhh) / n;
        // Samples have no larger skewness than the square root of their number.
        let largest = n.sqrt();
        if second > 0.0 { (third / second.powf(1.5)).clamp(-largest, largest) } else { 0.0 }
    }
}

/// The estimate of a pair from its samples.
#[derive(Debug, Clone, Copy)]
pub(super) struct Estimate {
    /// A_i F_ij. May be a little below zero.
    pub(super) exchange: f64,
    /// Its variance, by the spread of the replicates.
    pub(super) variance: f64,
    /// An additional standard error of a single pair, because samples are skew or agree by chance.
    pub(super) doubt: f64,
    pub(super) rays: u32,
    /// Whether the pair matters by itself, so that it has all replicates.
    pub(super) matters: bool,
}

impl Estimate {
    /// The doubt of one ray.
    pub(super) fn doubt_of_ray(&self) -> f64 {
        self.doubt * f64::from(self.rays)
    }

    /// The standard deviation of one ray, estimated from few rays.
    pub(super) fn deviation(&self) -> f64 {
        let rays = f64::from(self.rays.max(1));
        let student = if self.matters { student(f64::from(REPLICATES - 1)) } else { 1.0 };
        (self.variance * student * student * rays + 0.1 * self.doubt_of_ray().powi(2) / rays).sqrt()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_of_the_t_distribution() {
        for (freedom, t) in [(15.0, 2.13145), (30.0, 2.04227), (100.0, 1.98397)] {
            assert!((student(freedom) * 1.959964 / t - 1.0).abs() < 1e-3, "{freedom}");
        }
    }

    /// The skewness of rare events is that of the Bernoulli distribution, whether these are free or hidden, and does not
    /// depend on weights that are free or hidden alike.
    #[test]
    fn skewness_of_rare_events() {
        let (n, k) = (1000, 30);
        let p = f64::from(k) / f64::from(n);
        let exact = (1.0 - 2.0 * p) / (p * (1.0 - p)).sqrt();
        for is_free in [true, false] {
            let mut moments = Moments::default();
            (0..n)
                .for_each(|i| if (i < k) == is_free { moments.add(0.7, 0.0) } else { moments.add(0.0, 0.7) });
            let skewness = moments.skewness(if is_free { p } else { 1.0 - p });
            assert!((skewness.abs() / exact - 1.0).abs() < 1e-9, "{skewness}, not {exact}");
        }
        let mut even = Moments::default();
        (1..=n).for_each(|i| even.add(0.25 * f64::from(i), 0.75 * f64::from(i)));
        assert!(even.second[0] > 0.0 && even.skewness(0.25).abs() <= f64::from(n).sqrt());
    }
}
