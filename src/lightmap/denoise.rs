//! Denoising of gathered texels, as far as the error bars allow.
//!
//! At every texel a plane is fitted to its neighbours on the same chart, in discs of growing radius. A disc is too
//! large when its estimate contradicts the estimate of a smaller disc, so that their confidence intervals no longer
//! intersect (Goldenshluger and Nemirovski, Mathematical Methods of Statistics 6, 1997; Katkovnik, IEEE Transactions on
//! Signal Processing 47, 1999). This keeps the steps that stand out of the noise, and the plane keeps slopes. All
//! texels in a disc have the same weight: weights by their own estimated errors would favour the dark ones.
//!
//! The largest disc without a contradiction balances bias against noise, so its bias is as large as its error bar.
//! Error bars hold for a smaller disc, whose bias is small against its noise (undersmoothing: Giné and Nickl, Annals of
//! Statistics 38, 2010). So texels take the next smaller disc. The difference between the two estimates, as far as it
//! exceeds the noise, shows how bias grows with the disc. From this growth follows the bias of the smaller disc, which
//! its error bar includes.
//!
//! The noise of neighbouring texels is not independent. They share one low-discrepancy sequence, so a mean over a disc has
//! less noise than if they were independent: 0.4 of the variance in one map, nearly all of it in others. So each texel
//! has a sample of its noise, half the difference between the means of its two halves of samples. The same planes are
//! fitted to these differences. Their mean square over the map corrects the variance of discs of each size.
//!
//! Bias varies from texel to texel as noise does, so it is averaged over neighbours. At the rim of a chart it is larger
//! than inside, because the planes end there and light falls off towards a corner of the room. So a texel at the rim has
//! at least its own bias.
//!
//! The residuals of the planes are fitted once more in the same discs and added ("twicing", Tukey, Exploratory Data
//! Analysis, 1977, section 16). This restores the energy that the planes lose where the light is curved. It also about
//! doubles the variance of a mean over a disc; error bars include that ([`twiced`]).

use rayon::prelude::*;

use super::{atlas::NONE, coverage::Coverage, gather::Noisy, grid::Grid};

/// Radii of the discs in texels.
const RADII: [f64; 6] = [1.0, 1.5, 2.3, 3.5, 5.5, 8.5];
/// Half widths of the confidence intervals in standard errors.
const CONFIDENCE: f64 = 2.5;
/// Half width, in standard errors, of the confidence interval of a single texel's own value. Samples are skewed: with a
/// narrower interval, bright outliers would stay as they are and take the light from their neighbours.
const CONFIDENCE_ALONE: f64 = 4.0;
/// Two discs show a bias if the squared difference of their estimates exceeds its variance by this factor. The mean over
/// neighbours of the excess is not negative, so noise alone would give it a size. On seven scenes 95 % intervals contain
/// 93.3 to 97.1 % of the texels with 1.4, 93.8 to 97.5 % with 1.3 and 92.3 to 96.3 % with 1.6
/// (docs/decisions/2026-12-01-denoiser.md).
const NOISE: f64 = 1.4;
/// At most about this many texels give the noise of the discs of each size.
const TRIED: usize = 1 << 14;
/// Variances and biases are averaged over a square that reaches this many texels out in each direction. The variance
/// from four replicates of one texel is too uncertain by itself.
const POOLING: isize = 2;
/// Where all samples of most texels missed the light, the square grows until this number of its variances are not zero,
/// but not beyond a reach of [`WIDEST`]. Otherwise the error bars of such texels would be zero, or too short: on a dark
/// ground beside a lit house 95 % intervals contained 87 % of the texels instead of 95 %.
const ENOUGH: usize = 9;
const WIDEST: isize = 16;
/// The least variance of a texel without denoising, as a share of the variance of its own samples. Neighbours do not show
/// how uncertain a bright outlier is. Three degrees of freedom reach four times their variance in 0.7 % of cases, so
/// this hardly changes other texels.
const OWN_SHARE: f32 = 0.25;

/// Denoises the signal of covered texels. Texels for which `counts` is false stay as they are. The variances include
/// the squared bias that was estimated.
pub fn filter(
    grid: &Grid,
    coverage: &Coverage,
    signal: &[Noisy],
    counts: impl Fn(usize) -> bool + Sync,
) -> Vec<Noisy> {
    let places = coverage.texels();
    let at_places = |value: fn(&Noisy) -> [f32; 3]| {
        let mut values = vec![[0.0; 3]; grid.places()];
        signal.iter().zip(places).for_each(|(noisy, &place)| values[place as usize] = value(noisy));
        values
    };
    let (values, halves) = (at_places(|noisy| noisy.mean), at_places(|noisy| noisy.half));
    let mut fits = Fits::new(grid, coverage, signal, &counts);
    let counted: Vec<usize> = (0..signal.len()).filter(|&i| counts(i)).collect();
    fits.measure_noise(counted.iter().map(|&i| places[i] as usize), &halves);
    let of_texel = |(i, &place): (usize, &u32)| match counts(i) {
        true => fits.best(&values, place as usize, signal[i].variance),
        false => [Estimate::default(); 2],
    };
    let mut found: Vec<[Estimate; 2]> = places.par_iter().enumerate().map(of_texel).collect();
    // The noise of these estimates, as one sample of each: the same planes through the halves' differences.
    let of_halves = |(pair, &place): (&[Estimate; 2], &u32)| {
        pair.map(|Estimate { reach, .. }| Estimate {
            mean: fits.within(&halves, place as usize, reach),
            variance: [0.0; 3],
            reach,
        })
    };
    let mut noise: Vec<[Estimate; 2]> = found.par_iter().zip(places).map(of_halves).collect();
    for k in 0..2 {
        fits.add_residuals(places, &values, &mut found, k);
        fits.add_residuals(places, &halves, &mut noise, k);
    }
    let scales = Scales::of(&fits.discs, counted.iter().map(|&i| (&found[i], &noise[i])));
    found.iter_mut().for_each(|pair| scales.correct(&mut pair[0]));

    let mut bias = vec![[0.0; 3]; grid.places()];
    for (pair, &place) in found.iter().zip(places) {
        bias[place as usize] = scales.squared_bias(pair);
    }
    let noisy = |(i, [narrow, _]): (usize, &[Estimate; 2])| {
        if !counts(i) {
            return signal[i];
        }
        let place = places[i] as usize;
        let least = if fits.is_at_rim(place) { bias[place] } else { [0.0; 3] };
        let around = fits.mean_around(&bias, place);
        let bias: [f64; 3] = std::array::from_fn(|c| around[c].max(least[c]).max(0.0).into());
        Noisy {
            mean: narrow.mean.map(|x| x.max(0.0) as f32),
            variance: std::array::from_fn(|c| (narrow.variance[c] + bias[c]) as f32),
            half: signal[i].half,
        }
    };
    found.par_iter().enumerate().map(noisy).collect()
}

/// The same signal, with variances averaged over neighbours. Four replicates determine their variance to a factor of
/// two only: 95 % confidence intervals computed from them contain the truth in 86 % of cases.
pub fn pooled(
    grid: &Grid,
    coverage: &Coverage,
    signal: &[Noisy],
    counts: impl Fn(usize) -> bool + Sync,
) -> Vec<Noisy> {
    let fits = Fits::new(grid, coverage, signal, &counts);
    let pooled = |(i, noisy): (usize, &Noisy)| match counts(i) {
        true => {
            let pooled = fits.pooled[coverage.texels()[i] as usize];
            let variance = std::array::from_fn(|c| pooled[c].max(OWN_SHARE * noisy.variance[c]));
            Noisy { variance, ..*noisy }
        }
        false => *noisy,
    };
    signal.iter().enumerate().map(pooled).collect()
}

/// Fits of planes to texels. All its arrays, and the values it is given, are indexed by place in the map.
struct Fits<'a> {
    grid: &'a Grid,
    /// Chart of the texels that count; [`NONE`] for others.
    chart: Vec<u32>,
    discs: Vec<Disc>,
    /// Variances averaged over neighbours.
    pooled: Vec<[f32; 3]>,
    /// Variance of the plane through each disc, relative to its value for independent texels.
    noise: [f64; RADII.len()],
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
        let noise = [1.0; RADII.len()];
        let mut fits = Fits { grid, chart, discs: discs(grid.width), pooled: Vec::new(), noise };
        let of_neighbours: Vec<[f32; 3]> =
            places.par_iter().map(|&place| fits.pool(&variances, place as usize)).collect();
        let mut pooled = vec![[0.0; 3]; grid.places()];
        places.iter().zip(of_neighbours).for_each(|(&place, v)| pooled[place as usize] = v);
        fits.pooled = pooled;
        fits
    }

    /// Measures the noise of the discs: fits planes to the halves' differences around some of the places.
    fn measure_noise(&mut self, places: impl ExactSizeIterator<Item = usize>, halves: &[[f32; 3]]) {
        let every = places.len().div_ceil(TRIED).max(1);
        let tried: Vec<usize> = places.step_by(every).collect();
        let of_place = |&place: &usize| {
            let mut moments = Moments::default();
            moments.add((0, 0), halves[place], self.pooled[place]);
            std::array::from_fn(|k| {
                self.add(&mut moments, halves, place, k);
                moments
                    .at_centre()
                    .map_or([0.0; 2], |(noise, variance)| [squares(noise), variance.iter().sum()])
            })
        };
        let found: Vec<[[f64; 2]; RADII.len()]> = tried.par_iter().map(of_place).collect();
        self.noise = std::array::from_fn(|k| {
            let mut ratio = Ratio::default();
            found.iter().for_each(|of_place| ratio.add(of_place[k]));
            ratio.beside(self.discs[k].texels, 1.0)
        });
    }

    /// Two estimates: first of the disc before the largest disc that contradicts no smaller one, then of that largest
    /// disc.
    fn best(&self, values: &[[f32; 3]], place: usize, own: [f32; 3]) -> [Estimate; 2] {
        // A bright outlier is uncertain by its own variance, which the mean over its neighbours does not show.
        let alone = Estimate {
            mean: values[place].map(f64::from),
            variance: std::array::from_fn(|c| own[c].max(self.pooled[place][c]).into()),
            reach: 0,
        };
        let mut agreed = Interval::new(&alone, CONFIDENCE_ALONE);
        let mut best = [alone; 2];
        let mut moments = Moments::default();
        moments.add((0, 0), values[place], self.pooled[place]);
        for k in 0..self.discs.len() {
            self.add(&mut moments, values, place, k);
            let Some((mean, variance)) = moments.at_centre() else { continue };
            let next = Estimate { mean, variance, reach: k + 1 };
            match agreed.intersection(&Interval::new(&next, CONFIDENCE * self.noise[k].sqrt())) {
                Some(narrower) => (agreed, best) = (narrower, [best[1], next]),
                None => break,
            }
        }
        best
    }

    /// Fits the residuals of the estimates with index `which` in the same discs and adds the fits to the estimates.
    fn add_residuals(
        &self,
        places: &[u32],
        values: &[[f32; 3]],
        estimates: &mut [[Estimate; 2]],
        which: usize,
    ) {
        let mut residuals = values.to_vec();
        for (estimate, &place) in estimates.iter().zip(places) {
            (0..3).for_each(|c| residuals[place as usize][c] -= estimate[which].mean[c] as f32);
        }
        estimates.par_iter_mut().zip(places).for_each(|(estimate, &place)| {
            let estimate = &mut estimate[which];
            if let Some(k) = estimate.reach.checked_sub(1) {
                let more = self.within(&residuals, place as usize, estimate.reach);
                (0..3).for_each(|c| estimate.mean[c] += more[c]);
                estimate.variance = estimate.variance.map(|v| v * self.discs[k].twicing);
            }
        });
    }

    /// The value at `place` of the plane fitted to the first `reach` discs, or of the texel alone; 0 if no plane is
    /// determined.
    fn within(&self, values: &[[f32; 3]], place: usize, reach: usize) -> [f64; 3] {
        if reach == 0 {
            return values[place].map(f64::from);
        }
        let mut moments = Moments::default();
        moments.add((0, 0), values[place], self.pooled[place]);
        (0..reach).for_each(|k| self.add(&mut moments, values, place, k));
        moments.at_centre().map_or([0.0; 3], |(mean, _)| mean)
    }

    /// Adds the texels of disc `k` that are not in the next smaller disc.
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

    /// Whether a neighbour of a place is not on its chart.
    fn is_at_rim(&self, place: usize) -> bool {
        let is_outside = |at: Option<usize>| at.is_none_or(|at| self.chart[at] != self.chart[place]);
        square(1).any(|(dx, dy)| is_outside(self.grid.neighbour(place, dx, dy)))
    }

    /// The mean of variances over the neighbours on the same chart. The square of neighbours grows until enough
    /// variances are not zero.
    fn pool(&self, variances: &[[f32; 3]], place: usize) -> [f32; 3] {
        let mut reach = POOLING;
        loop {
            let (mean, lit) = self.mean_within(variances, place, reach);
            if lit >= ENOUGH || reach >= WIDEST {
                return mean;
            }
            reach *= 2;
        }
    }

    /// The mean over the neighbours on the same chart.
    fn mean_around(&self, values: &[[f32; 3]], place: usize) -> [f32; 3] {
        self.mean_within(values, place, POOLING).0
    }

    /// The mean over the places on the same chart up to `reach` texels away, and the number of values that are not zero.
    fn mean_within(&self, values: &[[f32; 3]], place: usize, reach: isize) -> ([f32; 3], usize) {
        let (mut sum, mut n, mut lit) = ([0.0; 3], 0.0f32, 0);
        for (dx, dy) in square(reach) {
            let at = self.grid.neighbour(place, dx, dy);
            if let Some(at) = at.filter(|&at| self.chart[at] == self.chart[place]) {
                (0..3).for_each(|c| sum[c] += values[at][c]);
                n += 1.0;
                lit += usize::from(values[at] != [0.0; 3]);
            }
        }
        (sum.map(|s| s / n), lit)
    }
}

/// Mean squares of noise relative to a forecast of them.
#[derive(Default, Clone, Copy)]
struct Ratio {
    found: f64,
    forecast: f64,
    count: f64,
}

impl Ratio {
    fn add(&mut self, [found, forecast]: [f64; 2]) {
        self.found += found;
        self.forecast += forecast;
        self.count += 1.0;
    }

    /// The ratio, with `many` texels added that have the ratio `usual`. Estimates whose discs overlap are not independent,
    /// so that a few of them give no ratio.
    fn beside(&self, many: f64, usual: f64) -> f64 {
        let more = many * self.forecast / self.count.max(1.0);
        match self.forecast > 0.0 {
            true => (self.found + usual * more) / (self.forecast + more),
            false => usual,
        }
    }
}

fn squares(values: [f64; 3]) -> f64 {
    values.iter().map(|x| x * x).sum()
}

/// Corrections of the variances of finished estimates.
struct Scales {
    /// Variance of an estimate of each reach, relative to its value for independent texels.
    variance: [f64; RADII.len() + 1],
    /// For each pair of a narrow and a wide disc: the variance of the difference of their estimates, relative to the
    /// corrected variance of the narrow one.
    apart: [[f64; RADII.len()]; RADII.len()],
}

impl Scales {
    /// `texels` has the estimates of each texel, and the same planes through the differences of halves.
    fn of<'a>(
        discs: &[Disc],
        texels: impl Iterator<Item = (&'a [Estimate; 2], &'a [Estimate; 2])> + Clone,
    ) -> Scales {
        let mut variances = [Ratio::default(); RADII.len() + 1];
        for ([narrow, _], [noise, _]) in texels.clone() {
            variances[narrow.reach].add([squares(noise.mean), narrow.variance.iter().sum()]);
        }
        let mut scales =
            Scales { variance: [1.0; RADII.len() + 1], apart: [[1.0; RADII.len()]; RADII.len()] };
        for (k, disc) in discs.iter().enumerate() {
            scales.variance[k + 1] = variances[k + 1].beside(disc.texels, 1.0);
        }
        let mut apart = [[Ratio::default(); RADII.len()]; RADII.len()];
        for ([narrow, wide], [noise, of_wide]) in texels {
            if let (Some(k), Some(l)) = (narrow.reach.checked_sub(1), wide.reach.checked_sub(1)) {
                let difference = std::array::from_fn(|c| noise.mean[c] - of_wide.mean[c]);
                let variance = scales.variance[k + 1] * narrow.variance.iter().sum::<f64>();
                apart[k][l].add([squares(difference), variance]);
            }
        }
        for (k, row) in apart.iter().enumerate() {
            for (l, disc) in discs.iter().enumerate() {
                scales.apart[k][l] = row[l].beside(disc.texels, disc.apart);
            }
        }
        scales
    }

    fn correct(&self, narrow: &mut Estimate) {
        narrow.variance = narrow.variance.map(|v| v * self.variance[narrow.reach]);
    }

    /// An estimate of the squared bias of the narrower of two estimates, whose variance is corrected. It may be negative.
    ///
    /// Where a penumbra begins or ends, the light has a kink, and bias grows with the radius. So the bias of the smaller
    /// of two discs with radii r < R is their difference times 1 / (R / r - 1). On smooth curves, where it grows with the
    /// square of the radius, this is too much by half. A single texel has no bias.
    fn squared_bias(&self, [narrow, wide]: &[Estimate; 2]) -> [f32; 3] {
        let (Some(k), Some(l)) = (narrow.reach.checked_sub(1), wide.reach.checked_sub(1)) else {
            return [0.0; 3];
        };
        if k == l {
            return [0.0; 3];
        }
        let share = (RADII[l] / RADII[k] - 1.0).recip();
        std::array::from_fn(|c| {
            let noise = NOISE * self.apart[k][l] * narrow.variance[c];
            (share.powi(2) * ((narrow.mean[c] - wide.mean[c]).powi(2) - noise)) as f32
        })
    }
}

/// A disc, stored as the ring of texels that are not in the next smaller disc.
struct Disc {
    /// Offsets of the ring's texels from the centre: columns, rows, and places in the map.
    offsets: Vec<(isize, isize, isize)>,
    reach: usize,
    /// Number of texels in the disc.
    texels: f64,
    /// The factor by which twicing in the disc raises the variance.
    twicing: f64,
    /// Variance of the difference between this disc's estimate and the estimate of the disc before it, relative to the
    /// variance of the latter, for independent texels.
    apart: f64,
}

/// The weights of the texels around a centre after twicing: 2 w - w * w, where w are the weights of a mean over a disc
/// and `*` is convolution. At the centre of a disc, the value of a fitted plane is the mean.
fn twiced(radius: f64) -> impl Fn((isize, isize)) -> f64 {
    let is_in = move |x: isize, y: isize| ((x * x + y * y) as f64) <= radius * radius;
    let disc: Vec<(isize, isize)> = square(radius.floor() as isize).filter(|&(x, y)| is_in(x, y)).collect();
    let n = disc.len() as f64;
    move |(x, y)| {
        let twice = disc.iter().filter(|&&(dx, dy)| is_in(x - dx, y - dy)).count() as f64 / (n * n);
        if is_in(x, y) { 2.0 / n - twice } else { -twice }
    }
}

pub(super) fn square(reach: isize) -> impl Iterator<Item = (isize, isize)> {
    (-reach..=reach).flat_map(move |y| (-reach..=reach).map(move |x| (x, y)))
}

/// The discs for a map of a given width in texels.
fn discs(width: usize) -> Vec<Disc> {
    let mut inner = 0.0;
    RADII
        .iter()
        .enumerate()
        .map(|(k, &radius)| {
            let reach = radius.floor() as isize;
            let is_new = |(dx, dy): &(isize, isize)| {
                let squared = (dx * dx + dy * dy) as f64;
                squared > inner && squared <= radius * radius
            };
            let offsets: Vec<_> =
                square(reach).filter(is_new).map(|(dx, dy)| (dx, dy, dy * width as isize + dx)).collect();
            inner = radius * radius;
            let is_in = |(x, y): &(isize, isize)| ((x * x + y * y) as f64) <= radius * radius;
            let texels = square(reach).filter(is_in).count() as f64;
            let weight = twiced(radius);
            let squares = |weight: &dyn Fn((isize, isize)) -> f64| {
                square(2 * reach).map(|at| weight(at).powi(2)).sum::<f64>()
            };
            let apart = k.checked_sub(1).map_or(1.0, |before| {
                let narrow = twiced(RADII[before]);
                squares(&|at| weight(at) - narrow(at)) / squares(&narrow)
            });
            Disc { offsets, reach: reach as usize, texels, twicing: texels * squares(&weight), apart }
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

    /// The plane's value at the centre and its variance; `None` if the points lie on a line.
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

/// An estimate from the first `reach` discs; with `reach` = 0, the value of the texel alone.
#[derive(Debug, Clone, Copy, Default)]
struct Estimate {
    mean: [f64; 3],
    variance: [f64; 3],
    reach: usize,
}

/// A confidence interval per channel.
struct Interval {
    low: [f64; 3],
    high: [f64; 3],
}

impl Interval {
    fn new(of: &Estimate, confidence: f64) -> Interval {
        let half = of.variance.map(|v| confidence * v.sqrt());
        Interval {
            low: std::array::from_fn(|c| of.mean[c] - half[c]),
            high: std::array::from_fn(|c| of.mean[c] + half[c]),
        }
    }

    /// The intersection of two intervals; `None` if it is empty in some channel.
    fn intersection(&self, other: &Interval) -> Option<Interval> {
        let low = std::array::from_fn(|c| self.low[c].max(other.low[c]));
        let high = std::array::from_fn(|c| self.high[c].min(other.high[c]));
        (0..3).all(|c| low[c] <= high[c]).then_some(Interval { low, high })
    }
}
