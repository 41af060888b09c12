//! Noise taken out of gathered texels, as far as the error bars allow.
//!
//! At every texel planes are fitted to its neighbours on the same chart, in discs that grow. The largest disc counts
//! whose estimate agrees, within the error bars, with those of all smaller ones: the intersection of confidence
//! intervals (Goldenshluger and Nemirovski, Mathematical Methods of Statistics 6, 1997; Katkovnik, IEEE Transactions on
//! Signal Processing 47, 1999). A step of the light is kept where it stands out of the noise; a slope is kept by the
//! plane. All texels in a disc weigh the same: weights by their own estimated errors would favour the dark ones.

use rayon::prelude::*;

use super::{coverage::Coverage, gather::Noisy, grid::Grid};

/// Radii of the discs in texels.
const RADII: [f64; 6] = [1.0, 1.5, 2.3, 3.5, 5.5, 8.5];
/// Half widths of the confidence intervals in standard errors.
const CONFIDENCE: f64 = 2.0;
/// Error bars of four replicates are too uncertain by themselves; they are averaged over a square this far out.
const POOLING: isize = 2;

/// The signal of covered texels without much of its noise; those for which `counts` is false are left alone.
pub fn filter(
    grid: &Grid,
    coverage: &Coverage,
    signal: &[Noisy],
    counts: &(dyn Fn(usize) -> bool + Sync),
) -> Vec<Noisy> {
    let discs = Disc::all();
    let pooled: Vec<[f64; 3]> = (0..signal.len())
        .into_par_iter()
        .map(|i| if counts(i) { pool(grid, coverage, signal, counts, i) } else { [0.0; 3] })
        .collect();
    (0..signal.len())
        .into_par_iter()
        .map(|i| {
            if !counts(i) {
                return signal[i];
            }
            let texel = coverage.texels()[i] as usize;
            let mut best = Interval::new(signal[i].mean.map(f64::from), pooled[i]);
            let mut moments = Moments::default();
            moments.add(0.0, 0.0, signal[i].mean, pooled[i]);
            for disc in &discs {
                for &(dx, dy) in &disc.offsets {
                    let Some(j) = grid.neighbour(texel, dx, dy).and_then(|at| grid.covered(at)) else {
                        continue;
                    };
                    if grid.chart(j) == grid.chart(i) && counts(j) {
                        moments.add(dx as f64, dy as f64, signal[j].mean, pooled[j]);
                    }
                }
                let Some((mean, variance)) = moments.at_centre() else { continue };
                match best.narrowed(mean, variance) {
                    Some(narrower) => best = narrower,
                    None => break,
                }
            }
            Noisy { mean: best.mean.map(|x| x.max(0.0) as f32), variance: best.variance.map(|v| v as f32) }
        })
        .collect()
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

/// The offsets that a disc has beyond the next smaller one.
struct Disc {
    offsets: Vec<(isize, isize)>,
}

impl Disc {
    fn all() -> Vec<Disc> {
        let mut inner = 0.0;
        RADII
            .iter()
            .map(|&radius| {
                let reach = radius.floor() as isize;
                let within = |(dx, dy): &(isize, isize)| {
                    let squared = (dx * dx + dy * dy) as f64;
                    squared > inner && squared <= radius * radius
                };
                let offsets = (-reach..=reach)
                    .flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy)))
                    .filter(within)
                    .collect();
                inner = radius * radius;
                Disc { offsets }
            })
            .collect()
    }
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
    fn new(mean: [f64; 3], variance: [f64; 3]) -> Interval {
        let half = variance.map(|v| CONFIDENCE * v.sqrt());
        Interval {
            mean,
            variance,
            low: std::array::from_fn(|c| mean[c] - half[c]),
            high: std::array::from_fn(|c| mean[c] + half[c]),
        }
    }

    /// Takes another estimate in; `None` when it contradicts those before.
    fn narrowed(&self, mean: [f64; 3], variance: [f64; 3]) -> Option<Interval> {
        let next = Interval::new(mean, variance);
        let low = std::array::from_fn(|c| self.low[c].max(next.low[c]));
        let high = std::array::from_fn(|c| self.high[c].min(next.high[c]));
        (0..3).all(|c| low[c] <= high[c]).then_some(Interval { low, high, ..next })
    }
}
