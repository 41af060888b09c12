//! Noise taken out of gathered texels, as far as the error bars allow.
//!
//! At every texel planes are fitted to its neighbours on the same chart, in discs that grow. The largest disc counts
//! whose estimate agrees, within the error bars, with those of all smaller ones: the intersection of confidence
//! intervals (Goldenshluger and Nemirovski, Mathematical Methods of Statistics 6, 1997; Katkovnik, IEEE Transactions on
//! Signal Processing 47, 1999). A step of the light is kept where it stands out of the noise; a slope is kept by the
//! plane. All texels in a disc weigh the same: weights by their own estimated errors would favour the dark ones.
//!
//! What the planes leave is fitted once more in the same discs and added ("twicing", Tukey, Exploratory Data Analysis,
//! 1977, section 16): that gives back what curvature loses, and the energy with it. It also gives back noise: the variance
//! of a mean over a disc doubles about, and error bars count that ([`twicing`]).

use rayon::prelude::*;

use super::{atlas::NONE, coverage::Coverage, gather::Noisy, grid::Grid};

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
    counts: impl Fn(usize) -> bool + Sync,
) -> Vec<Noisy> {
    let places = coverage.texels();
    let mut values = vec![[0.0; 3]; grid.places()];
    for (noisy, &place) in signal.iter().zip(places) {
        values[place as usize] = noisy.mean;
    }
    let fits = Fits::new(grid, coverage, signal, &counts);

    let smooth: Vec<(Noisy, usize)> = places
        .par_iter()
        .enumerate()
        .map(|(i, &place)| if counts(i) { fits.largest(&values, place as usize) } else { (signal[i], 0) })
        .collect();
    // What the planes leave takes the place of the values.
    for ((noisy, _), &place) in smooth.iter().zip(places) {
        (0..3).for_each(|c| values[place as usize][c] -= noisy.mean[c]);
    }
    smooth
        .par_iter()
        .zip(places)
        .map(|(&(noisy, reach), &place)| {
            let more = fits.within(&values, place as usize, reach);
            let mean = std::array::from_fn(|c| (noisy.mean[c] + more[c] as f32).max(0.0));
            let factor = reach.checked_sub(1).map_or(1.0, |k| fits.discs[k].twicing as f32);
            Noisy { mean, variance: noisy.variance.map(|v| v * factor) }
        })
        .collect()
}

/// The signal as it is, with variances averaged over neighbours: four replicates know their own to a factor of two only, and
/// intervals by them hold the truth in 86 % of the cases for 95 %.
pub fn pooled(
    grid: &Grid,
    coverage: &Coverage,
    signal: &[Noisy],
    counts: impl Fn(usize) -> bool + Sync,
) -> Vec<Noisy> {
    let fits = Fits::new(grid, coverage, signal, &counts);
    let pooled = |(i, noisy): (usize, &Noisy)| match counts(i) {
        true => Noisy { variance: fits.pooled[coverage.texels()[i] as usize], ..*noisy },
        false => *noisy,
    };
    signal.iter().enumerate().map(pooled).collect()
}

/// Planes through texels. What it holds, and the values it is given, are by place in the map.
struct Fits<'a> {
    grid: &'a Grid,
    /// Chart of the texels that count.
    chart: Vec<u32>,
    discs: Vec<Disc>,
    /// Variances that are averaged over neighbours.
    pooled: Vec<[f32; 3]>,
}

impl<'a> Fits<'a> {
    fn new(
        grid: &'a Grid,
        coverage: &Coverage,
        signal: &[Noisy],
        counts: &(impl Fn(usize) -> bool + Sync),
    ) -> Self {
        let places = coverage.texels();
        let mut chart = vec![NONE; grid.places()];
        (0..signal.len()).filter(|&i| counts(i)).for_each(|i| chart[places[i] as usize] = grid.chart(i));
        let mut variances = vec![[0.0; 3]; grid.places()];
        for (noisy, &place) in signal.iter().zip(places) {
            variances[place as usize] = noisy.variance;
        }
        let mut fits = Fits { grid, chart, discs: discs(grid.width), pooled: Vec::new() };
        let of_neighbours: Vec<[f32; 3]> =
            places.par_iter().map(|&place| fits.pool(&variances, place as usize)).collect();
        let mut pooled = vec![[0.0; 3]; grid.places()];
        places.iter().zip(of_neighbours).for_each(|(&place, v)| pooled[place as usize] = v);
        fits.pooled = pooled;
        fits
    }

    /// The estimate of the largest disc that contradicts no smaller one, and how many discs that took.
    fn largest(&self, values: &[[f32; 3]], place: usize) -> (Noisy, usize) {
        let alone = (values[place].map(f64::from), self.pooled[place].map(f64::from));
        let mut best = Interval::new(alone.0, alone.1, CONFIDENCE_ALONE);
        let mut reach = 0;
        let mut moments = Moments::default();
        moments.add((0, 0), values[place], self.pooled[place]);
        for k in 0..self.discs.len() {
            self.add(&mut moments, values, place, k);
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
    fn within(&self, values: &[[f32; 3]], place: usize, reach: usize) -> [f64; 3] {
        let mut moments = Moments::default();
        moments.add((0, 0), values[place], self.pooled[place]);
        (0..reach).for_each(|k| self.add(&mut moments, values, place, k));
        moments.at_centre().map_or([0.0; 3], |(mean, _)| mean)
    }

    /// Adds the texels that disc `k` has beyond the next smaller one.
    fn add(&self, moments: &mut Moments, values: &[[f32; 3]], place: usize, k: usize) {
        let chart = self.chart[place];
        let disc = &self.discs[k];
        if self.grid.is_inside(place, disc.reach) {
            for &(dx, dy, step) in &disc.offsets {
                let at = place.wrapping_add_signed(step);
                if self.chart[at] == chart {
                    moments.add((dx, dy), values[at], self.pooled[at]);
                }
            }
        } else {
            for &(dx, dy, _) in &disc.offsets {
                if let Some(at) = self.grid.neighbour(place, dx, dy).filter(|&at| self.chart[at] == chart) {
                    moments.add((dx, dy), values[at], self.pooled[at]);
                }
            }
        }
    }

    /// Mean variance of the neighbours on the same chart.
    fn pool(&self, variances: &[[f32; 3]], place: usize) -> [f32; 3] {
        let (mut sum, mut n) = ([0.0; 3], 0.0f32);
        for dy in -POOLING..=POOLING {
            for dx in -POOLING..=POOLING {
                let at = self.grid.neighbour(place, dx, dy);
                if let Some(at) = at.filter(|&at| self.chart[at] == self.chart[place]) {
                    (0..3).for_each(|c| sum[c] += variances[at][c]);
                    n += 1.0;
                }
            }
        }
        sum.map(|s| s / n)
    }
}

/// A ring: what a disc has beyond the next smaller one.
struct Disc {
    /// Columns, rows, and places in the map.
    offsets: Vec<(isize, isize, isize)>,
    reach: usize,
    /// By how much twicing in the disc raises the variance.
    twicing: f64,
}

/// By how much the variance rises when what a mean over a disc leaves is averaged once more and added: with the mean's
/// weights w, |2 w - w * w|² / |w|². At the centre of a disc a fitted plane is the mean.
fn twicing(radius: f64) -> f64 {
    let reach = radius.floor() as isize;
    let is_in = |x: isize, y: isize| ((x * x + y * y) as f64) <= radius * radius;
    let square = |reach: isize| (-reach..=reach).flat_map(move |y| (-reach..=reach).map(move |x| (x, y)));
    let disc: Vec<(isize, isize)> = square(reach).filter(|&(x, y)| is_in(x, y)).collect();
    let n = disc.len() as f64;
    let weight = |x: isize, y: isize| {
        let twice = disc.iter().filter(|&&(dx, dy)| is_in(x - dx, y - dy)).count() as f64 / (n * n);
        if is_in(x, y) { 2.0 / n - twice } else { -twice }
    };
    n * square(2 * reach).map(|(x, y)| weight(x, y).powi(2)).sum::<f64>()
}

/// The discs of a map so wide.
fn discs(width: usize) -> Vec<Disc> {
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
            let offsets = square.filter(is_new).map(|(dx, dy)| (dx, dy, dy * width as isize + dx)).collect();
            inner = radius * radius;
            Disc { offsets, reach: reach as usize, twicing: twicing(radius) }
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
    #[inline]
    fn add(&mut self, (x, y): (isize, isize), mean: [f32; 3], variance: [f32; 3]) {
        let (x, y) = (x as f64, y as f64);
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
            self.variance[c] += f64::from(variance[c]);
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
