//! Noise taken out of gathered texels, as far as the error bars allow.
//!
//! At every texel planes are fitted to its neighbours on the same chart, in discs that grow. The largest disc counts
//! whose estimate agrees, within the error bars, with those of all smaller ones: the intersection of confidence
//! intervals (Goldenshluger and Nemirovski, Mathematical Methods of Statistics 6, 1997; Katkovnik, IEEE Transactions on
//! Signal Processing 47, 1999). A step of the light is kept where it stands out of the noise; a slope is kept by the
//! plane. All texels in a disc weigh the same: weights by their own estimated errors would favour the dark ones.
//!
//! What the planes leave is fitted once more in the same discs and added ("twicing", Tukey, Exploratory Data Analysis,
//! 1977, section 16): that gives back what curvature loses, and the energy with it.

use rayon::prelude::*;

use super::{coverage::Coverage, gather::Noisy, grid::Grid};

/// Radii of the discs in texels.
const RADII: [f64; 6] = [1.0, 1.5, 2.3, 3.5, 5.5, 8.5];
/// Half widths of the confidence intervals in standard errors.
const CONFIDENCE: f64 = 2.5;
/// The same of a texel by itself. Samples are skewed: with narrower ones bright outliers would stay as they are, and
/// take the light from their neighbours.
const CONFIDENCE_ALONE: f64 = 4.0;
/// Error bars of four replicates are too uncertain by themselves; they are averaged over a square this far out.
const POOLING: isize = 2;

/// The signal of covered texels without much of its noise; those for which `counts` is false are left alone. Error bars
/// that come with it take the noise of texels for independent and the discs for small enough.
pub fn filter(
    grid: &Grid,
    coverage: &Coverage,
    signal: &[Noisy],
    counts: &(dyn Fn(usize) -> bool + Sync),
) -> Vec<Noisy> {
    let pooled: Vec<[f64; 3]> = (0..signal.len())
        .into_par_iter()
        .map(|i| if counts(i) { pool(grid, coverage, signal, counts, i) } else { [0.0; 3] })
        .collect();
    let fits = Fits { grid, coverage, counts, discs: discs(), pooled: &pooled };
    let values: Vec<[f32; 3]> = signal.iter().map(|s| s.mean).collect();
    let smooth: Vec<(Noisy, usize)> = (0..signal.len())
        .into_par_iter()
        .map(|i| if counts(i) { fits.largest(&values, i) } else { (signal[i], 0) })
        .collect();
    let left: Vec<[f32; 3]> =
        (0..values.len()).map(|i| std::array::from_fn(|c| values[i][c] - smooth[i].0.mean[c])).collect();
    (0..signal.len())
        .into_par_iter()
        .map(|i| {
            let (noisy, reach) = smooth[i];
            let more = fits.within(&left, i, reach);
            let mean = std::array::from_fn(|c| (noisy.mean[c] + more[c] as f32).max(0.0));
            Noisy { mean, ..noisy }
        })
        .collect()
}

/// Planes through texels.
struct Fits<'a> {
    grid: &'a Grid,
    coverage: &'a Coverage,
    counts: &'a (dyn Fn(usize) -> bool + Sync),
    /// The offsets that each disc has beyond the next smaller one.
    discs: Vec<Vec<(isize, isize)>>,
    pooled: &'a [[f64; 3]],
}

impl Fits<'_> {
    /// The estimate of the largest disc that contradicts no smaller one, and how many discs that took.
    fn largest(&self, values: &[[f32; 3]], i: usize) -> (Noisy, usize) {
        let alone = (values[i].map(f64::from), self.pooled[i]);
        let mut best = Interval::new(alone.0, alone.1, CONFIDENCE_ALONE);
        let mut reach = 0;
        let mut moments = Moments::default();
        moments.add(0.0, 0.0, values[i], self.pooled[i]);
        for k in 0..self.discs.len() {
            self.add(&mut moments, values, i, k);
            let Some((mean, variance)) = moments.at_centre() else { continue };
            match best.narrowed(mean, variance) {
                Some(narrower) => (best, reach) = (narrower, k + 1),
                None => break,
            }
        }
        let noisy = Noisy { mean: best.mean.map(|x| x as f32), variance: best.variance.map(|v| v as f32) };
        (noisy, reach)
    }

    /// The plane in so many discs; nothing where there is none.
    fn within(&self, values: &[[f32; 3]], i: usize, reach: usize) -> [f64; 3] {
        let mut moments = Moments::default();
        moments.add(0.0, 0.0, values[i], self.pooled[i]);
        (0..reach).for_each(|k| self.add(&mut moments, values, i, k));
        moments.at_centre().map_or([0.0; 3], |(mean, _)| mean)
    }

    /// Adds the texels that disc `k` has beyond the next smaller one.
    fn add(&self, moments: &mut Moments, values: &[[f32; 3]], i: usize, k: usize) {
        let texel = self.coverage.texels()[i] as usize;
        for &(dx, dy) in &self.discs[k] {
            let place = self.grid.neighbour(texel, dx, dy);
            let Some(j) = place.and_then(|at| self.grid.covered(at)) else { continue };
            if self.grid.chart(j) == self.grid.chart(i) && (self.counts)(j) {
                moments.add(dx as f64, dy as f64, values[j], self.pooled[j]);
            }
        }
    }
}

/// Mean variance of the neighbours.
fn pool(
    grid: &Grid,
    coverage: &Coverage,
    signal: &[Noisy],
    counts: &(dyn Fn(usize) -> bool + Sync),
    i: usize,
) -> [f64; 3] {
    let (mut sum, mut n) = ([0.0; 3], 0.0);
    for dy in -POOLING..=POOLING {
        for dx in -POOLING..=POOLING {
            let place = grid.neighbour(coverage.texels()[i] as usize, dx, dy);
            if let Some(j) =
                place.and_then(|at| grid.covered(at)).filter(|&j| grid.chart(j) == grid.chart(i) && counts(j))
            {
                (0..3).for_each(|c| sum[c] += f64::from(signal[j].variance[c]));
                n += 1.0;
            }
        }
    }
    sum.map(|s| s / n)
}

/// The offsets that each disc has beyond the next smaller one.
fn discs() -> Vec<Vec<(isize, isize)>> {
    let mut inner = 0.0;
    RADII
        .iter()
        .map(|&radius| {
            let reach = radius.floor() as isize;
            let is_new = |(dx, dy): &(isize, isize)| {
                let squared = (dx * dx + dy * dy) as f64;
                squared > inner && squared <= radius * radius
            };
            let square = (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy)));
            let offsets = square.filter(is_new).collect();
            inner = radius * radius;
            offsets
        })
        .collect()
}

/// Sums for a plane fitted by least squares.
#[derive(Default)]
struct Moments {
    n: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
    value: [[f64; 3]; 3],
    variance: [f64; 3],
}

impl Moments {
    fn add(&mut self, x: f64, y: f64, mean: [f32; 3], variance: [f64; 3]) {
        self.n += 1.0;
        self.x += x;
        self.y += y;
        self.xx += x * x;
        self.xy += x * y;
        self.yy += y * y;
        for c in 0..3 {
            let v = f64::from(mean[c]);
            self.value[c][0] += v;
            self.value[c][1] += x * v;
            self.value[c][2] += y * v;
            self.variance[c] += variance[c];
        }
    }

    /// The plane's value at the centre and its variance; `None` where the points lie on a line.
    fn at_centre(&self) -> Option<([f64; 3], [f64; 3])> {
        let Moments { n, x, y, xx, xy, yy, .. } = *self;
        // The first row of the inverse of [n x y; x xx xy; y xy yy].
        let adjugate = [xx * yy - xy * xy, y * xy - x * yy, x * xy - y * xx];
        let determinant = n * adjugate[0] + x * adjugate[1] + y * adjugate[2];
        if !(determinant > 1e-9 * n * xx * yy) {
            return None;
        }
        let weights = adjugate.map(|a| a / determinant);
        let mean = self.value.map(|v| (0..3).map(|k| weights[k] * v[k]).sum());
        Some((mean, self.variance.map(|v| v / n * weights[0])))
    }
}

/// An estimate, and where all estimates so far agree that the truth is.
struct Interval {
    mean: [f64; 3],
    variance: [f64; 3],
    low: [f64; 3],
    high: [f64; 3],
}

impl Interval {
    fn new(mean: [f64; 3], variance: [f64; 3], confidence: f64) -> Interval {
        let half = variance.map(|v| confidence * v.sqrt());
        Interval {
            mean,
            variance,
            low: std::array::from_fn(|c| mean[c] - half[c]),
            high: std::array::from_fn(|c| mean[c] + half[c]),
        }
    }

    /// Takes another estimate in; `None` when it contradicts those before.
    fn narrowed(&self, mean: [f64; 3], variance: [f64; 3]) -> Option<Interval> {
        let next = Interval::new(mean, variance, CONFIDENCE);
        let low = std::array::from_fn(|c| self.low[c].max(next.low[c]));
        let high = std::array::from_fn(|c| self.high[c].min(next.high[c]));
        (0..3).all(|c| low[c] <= high[c]).then_some(Interval { low, high, ..next })
    }
}
