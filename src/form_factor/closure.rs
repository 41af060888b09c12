//! Closure: what leaves a patch arrives somewhere or escapes.
//!
//! Pooling makes the exchange areas S reciprocal, and thereby spoils the row sums that one-way hits have for free. A
//! positive diagonal D with  d_i (Σ_j S_ij d_j + X_i) = A_i  restores them, where X_i = A_i e_i is the exchange area with
//! the outside, one more column that closes with the rest. The scaling keeps symmetry, zeros and positivity.
//!
//! It would move links with sources as well, which are known much better than the rest. So what is missing in a row is first
//! taken from what is uncertain: from what only hemisphere rays measured, and from what escapes (`settle`). RMS errors
//! at 64 rays a patch without and with that: 4.3 and 4.1 % on the Cornell box, 3.6 and 3.4 % on another one, 1.7 and 1.3 %
//! on a block in the open, whose floor and block, which exchange light with each other alone, contradict each other.

use std::ops::Range;

use rayon::prelude::*;

use super::{SHORT, ordered_sum, symmetric::Symmetric};

/// The scaling and what it repaired.
pub(super) struct Closed {
    pub(super) scale: Vec<f64>,
    /// The shares that escape, more than given where rows contradicted each other.
    pub(super) escaped: Vec<f64>,
    pub(super) deviation_before: f64,
}

/// As close as rounding of the longest row sums allows.
pub(super) const EXACT: f64 = 1e-13;

/// Rounds after which a matrix that cannot be closed is given up; what remains is reported.
const MOST_ROUNDS: usize = 500;

/// Rounds after which rows that are still off by more than [`CONTRADICTION`] yield.
const PATIENCE: usize = 100;
const CONTRADICTION: f64 = 1e-3;

/// Rounds of [`settle`]; twice as many give the same errors of irradiance, to a hundredth of them.
const SETTLING_ROUNDS: usize = 4;
/// Steps of Newton's method after these at most,
const SETTLING_STEPS: usize = 8;
/// and what rows may be off by then, relative to their area. What is left moves links with sources too. With 10⁻³, which eight
/// rounds alone often did not reach, the light of lamps in a black room, else right to 10⁻⁶, was 2·10⁻³ off in the mean.
const SETTLED: f64 = 1e-6;
/// Share of what a row misses that its escaped light takes, in a round. With none of it the mean irradiance of rooms is too
/// large, with all too small, by some 0.2 % at 64 rays a patch.
const ESCAPING: f64 = 0.3;
/// The least and greatest factor of a row,
const FACTORS: (f64, f64) = (0.1, 10.0);
/// and what the first rounds have to leave of it for Newton's method.
const NEARLY: Range<f64> = 0.5..2.0;

/// Rounds of [`balance`],
const BALANCING_ROUNDS: usize = 200;
/// and what sources' rows may be off by after it.
const BALANCED: f64 = 1e-5;

/// Closes the rows of sources, which are all `links`, and leaves to the other patches the light that they get from sources in
/// all: that is known better than how it divides among these. `brightness` is the radiosity of sources in any unit, and zero
/// of others. A diagonal for both sides, by iterative proportional fitting (Deming and Stephan, Annals of Mathematical
/// Statistics 11, 1940).
///
/// Were sources closed alone, a patch that by chance got much from one near it, and so made it scale down, would lose light
/// for that: in a cube with a ceiling that shines, floors were 2.5 % too bright at 64 rays a patch.
///
/// Where it is `known` what arrives, what sources lose in all is what arrives nowhere; which of them loses it is told by `escaped`,
/// which follows. Its noise does not cancel, since no share is below zero: under a lamp as large as the floor and a tenth of its
/// width above, irradiances were 0.8 % too low at 64 rays a patch.
pub(super) fn balance(
    links: &mut Symmetric,
    brightness: &[f64],
    areas: &[f64],
    escaped: &mut [f64],
    known: bool,
) {
    let n = areas.len();
    let is_source = |i: usize| brightness[i] > 0.0;
    let arriving = links.product(brightness);
    let among_sources: Vec<f64> = (0..n).map(|i| if is_source(i) { 1.0 } else { 0.0 }).collect();
    let among_sources = links.product(&among_sources);
    let sum = |source: bool, value: &dyn Fn(usize) -> f64| {
        (0..n).filter(|&i| is_source(i) == source).map(value).sum::<f64>()
    };
    let arrives = sum(false, &|i| arriving[i]);
    // Those without links lose all, whatever the others do.
    let open: Vec<usize> = (0..n).filter(|&i| known && is_source(i) && escaped[i] < 1.0).collect();
    let told: f64 = open.iter().map(|&i| brightness[i] * areas[i] * escaped[i]).sum();
    if told > 0.0 {
        let sent: f64 = open.iter().map(|&i| brightness[i] * (areas[i] - among_sources[i])).sum();
        let factor = ((sent - arrives) / told).max(0.0);
        open.iter().for_each(|&i| escaped[i] = (escaped[i] * factor).min(1.0 - f64::EPSILON));
    }
    let target = |i: usize| areas[i] * (1.0 - escaped[i]);
    // What sources send for what arrives.
    let common = sum(true, &|i| brightness[i] * (target(i) - among_sources[i])) / arrives;
    if !(common > FACTORS.0 && common < FACTORS.1) {
        return;
    }
    let mut scale = vec![1.0; n];
    for _ in 0..BALANCING_ROUNDS {
        let mut worst = 0f64;
        for source in [true, false] {
            let weigh = |i: usize| if source { scale[i] } else { scale[i] * brightness[i] };
            let sums = links.product(&(0..n).map(weigh).collect::<Vec<f64>>());
            for i in (0..n).filter(|&i| is_source(i) == source && sums[i] > 0.0) {
                let factor = if source { target(i) } else { common * arriving[i] } / (sums[i] * scale[i]);
                if source {
                    worst = worst.max((factor - 1.0).abs());
                }
                scale[i] = (scale[i] * factor).clamp(FACTORS.0, FACTORS.1);
            }
        }
        if worst < BALANCED {
            break;
        }
    }
    links.update(|i, j, s| s * (scale[i] * scale[j]) as f32);
}

/// Brings rows to their sums by a positive diagonal that scales only `plain`, what no source takes part in, and by what escapes.
/// `links` are the sums of what else is in each row.
///
/// The first rounds choose between the two; Newton's method then scales both alike.
///
/// Returns what rows, but those of sources, still miss, or nothing if none do: a patch close under a lamp may have sent all of its
/// rays there, and nothing is known of where the light goes that passes the lamp by. It is taken to stay where it is, as patches
/// nearby see it alike. Were it left to [`close`], the links with the lamp would be scaled for it, which are known, and all others
/// of that lamp after them: in a black box with a lamp of 0.4 edges 0.03 above the floor, irradiances were 6 % off.
pub(super) fn settle(
    plain: &mut Symmetric,
    links: &[f64],
    is_source: impl Fn(usize) -> bool + Sync,
    areas: &[f64],
    escaped: &mut [f64],
    precision: f64,
) -> Vec<f32> {
    let settled = precision.max(SETTLED);
    let n = areas.len();
    let mut scale = vec![1.0; n];
    for _ in 0..SETTLING_ROUNDS {
        let sums = plain.product(&scale);
        let rows = scale.par_iter_mut().zip(escaped.par_iter_mut()).enumerate().with_min_len(SHORT);
        let settle_row = |(i, (scale, escaped)): (usize, (&mut f64, &mut f64))| {
            let off = 1.0 - (links[i] + sums[i] * *scale) / areas[i] - *escaped;
            // Of what does not escape at all nothing is made to.
            let escapes = if *escaped > 0.0 { (*escaped + ESCAPING * off).max(0.5 * *escaped) } else { 0.0 };
            let wanted = areas[i] * (1.0 - escapes) - links[i];
            if sums[i] <= 0.0 || wanted <= 0.0 {
                return 0.0;
            }
            *escaped = escapes;
            *scale = (*scale * wanted / sums[i]).sqrt().clamp(FACTORS.0, FACTORS.1);
            off.abs()
        };
        if rows.map(settle_row).reduce(|| 0.0, f64::max) < settled {
            break;
        }
    }
    let all = settle_exactly(plain, links, &is_source, areas, escaped, &mut scale, settled);
    plain.update(|i, j, s| s * (scale[i] * scale[j]) as f32);
    if all {
        return Vec::new();
    }
    let sums = plain.row_sums();
    let missing = |i: usize| {
        let missing = areas[i] * (1.0 - escaped[i]) - links[i] - sums[i];
        if missing > settled * areas[i] && !is_source(i) { missing as f32 } else { 0.0 }
    };
    let missing: Vec<f32> = (0..n).into_par_iter().with_min_len(SHORT).map(missing).collect();
    if missing.iter().any(|&missing| missing > 0.0) { missing } else { Vec::new() }
}

/// Brings rows that are nearly settled to `precision`: as [`close`], but for the rows' sums of links, which stay. Whether these were
/// all, but those of sources.
fn settle_exactly(
    plain: &Symmetric,
    links: &[f64],
    is_source: impl Fn(usize) -> bool,
    areas: &[f64],
    escaped: &mut [f64],
    scale: &mut [f64],
    precision: f64,
) -> bool {
    let patches = || (0..areas.len()).into_par_iter().with_min_len(SHORT);
    // What escapes, but for the scale that is on it next.
    let mut outside: Vec<f64> = patches().map(|i| areas[i] * escaped[i] / scale[i]).collect();
    let (mut all, mut before) = (false, f64::INFINITY);
    for _ in 0..SETTLING_STEPS {
        let mut arriving = plain.product(scale);
        let mut wanted: Vec<f64> = patches().map(|i| areas[i] - links[i]).collect();
        let rows = arriving.par_iter_mut().zip(&mut wanted).zip(&mut outside).enumerate();
        let off = |(i, ((arriving, wanted), outside)): (usize, ((&mut f64, &mut f64), &mut f64))| {
            let all = *arriving + *outside;
            if NEARLY.contains(&(*wanted / (scale[i] * all))) {
                *arriving = all;
            } else {
                // Rows of links alone, and those that links fill already: left as they are for good.
                *outside = f64::NAN;
                *arriving = arriving.max(areas[i]);
                *wanted = scale[i] * *arriving;
            }
            (*wanted - scale[i] * *arriving).abs() / areas[i]
        };
        let deviation = rows.with_min_len(SHORT).map(off).reduce(|| 0.0, f64::max);
        all = deviation < precision;
        if all || deviation > PROGRESS * before {
            break;
        }
        before = deviation;
        if !step(plain, &wanted, scale, &arriving, deviation, precision) {
            break;
        }
    }
    let rows = escaped.par_iter_mut().zip(&outside).zip(&*scale).zip(areas).with_min_len(SHORT);
    rows.filter(|(((_, outside), _), _)| **outside > 0.0)
        .for_each(|(((escaped, outside), scale), area)| *escaped = outside * scale / area);
    all && (0..outside.len()).all(|i| is_source(i) || !outside[i].is_nan())
}

/// Newton's method takes over where no row is off by more than this, as long as each step
const NEAR: f64 = 0.1;
/// leaves at most this share.
const PROGRESS: f64 = 0.5;
/// A step is solved for to this share of what is missing at least: some hundred times the rounding of single precision.
const LEAST_STEP: f64 = 1e-5;

/// Finds the scaling to `precision`, the largest |row sum + escaped share - 1|.
///
/// Far from it by the fixed point d ← sqrt(d A / (S d + X)), which converges for all scenes that are not nearly bipartite,
/// though slowly; near it by Newton's method (as Knight and Ruiz, "A fast algorithm for matrix balancing", IMA Journal of
/// Numerical Analysis 33, 2013), which needs a third of the products.
///
/// Patches that see hardly more than each other may have been told by few rays that all of what one sends arrives at the
/// other, whose area is too small for it. No scaling closes them; `spare`, a share that may have escaped unseen, does.
pub(super) fn close(
    matrix: &Symmetric,
    areas: &[f64],
    escaped: &[f64],
    spare: impl Fn(usize) -> f64,
    precision: f64,
) -> Closed {
    let mut escaped = escaped.to_vec();
    let mut scale = vec![1.0; areas.len()];
    let mut deviation_before = None;
    let (mut newton, mut before) = (true, f64::INFINITY);
    for round in 1..=MOST_ROUNDS {
        let mut arriving: Vec<f64> = areas.iter().zip(&escaped).map(|(area, e)| area * e).collect();
        matrix.add_product(scale.as_chunks::<1>().0, arriving.as_chunks_mut::<1>().0);
        let off = |i: usize| (scale[i] * arriving[i] / areas[i] - 1.0).abs();
        let deviation =
            (0..areas.len()).into_par_iter().with_min_len(SHORT).map(off).reduce(|| 0.0, f64::max);
        deviation_before.get_or_insert(deviation);
        if deviation < precision {
            break;
        }
        if round % PATIENCE == 0 && deviation > CONTRADICTION {
            for i in (0..scale.len()).filter(|&i| off(i) > CONTRADICTION) {
                escaped[i] = (escaped[i] + spare(i)).min(1.0);
            }
            scale.fill(1.0);
            (newton, before) = (true, f64::INFINITY);
            continue;
        }
        if newton && deviation < NEAR {
            newton = deviation <= PROGRESS * before;
            before = deviation;
            if newton && step(matrix, areas, &mut scale, &arriving, deviation, precision) {
                continue;
            }
            newton = false;
        }
        let scales = scale.par_iter_mut().zip(&arriving).zip(areas).with_min_len(SHORT);
        scales.for_each(|((scale, arriving), area)| *scale = (*scale * area / arriving).sqrt());
    }
    Closed { scale, escaped, deviation_before: deviation_before.unwrap_or(0.0) }
}

/// A step of Newton's method in ln d: the δ of (diag(R) + D S D) δ = A - R with the rows' sums R, by conjugate gradients in
/// single precision; what rows shall sum to is A here. Scales by it, unless it goes too far to be believed.
fn step(
    matrix: &Symmetric,
    areas: &[f64],
    scale: &mut [f64],
    arriving: &[f64],
    deviation: f64,
    precision: f64,
) -> bool {
    const MOST: usize = 40;
    let n = areas.len();
    let patches = || (0..n).into_par_iter().with_min_len(SHORT);
    let rows: Vec<f32> = patches().map(|i| (scale[i] * arriving[i]) as f32).collect();
    // In a unit in which single precision holds it.
    let mut residual: Vec<f32> =
        patches().map(|i| ((areas[i] - scale[i] * arriving[i]) / deviation) as f32).collect();
    let mut step = vec![[0f32]; n];
    let mut direction: Vec<f32> = patches().map(|i| residual[i] / rows[i]).collect();
    let (mut scaled, mut image) = (vec![[0f32]; n], vec![[0f32]; n]);
    let dot =
        |a: &[f32], b: &(dyn Fn(usize) -> f32 + Sync)| ordered_sum(n, |i| f64::from(a[i]) * f64::from(b(i)));
    let mut size = dot(&residual, &|i| direction[i]);
    // No more than a step of Newton's method gains, or single precision can, or is asked for.
    let enough = deviation.max(0.1 * precision / deviation).clamp(LEAST_STEP, 1e-1).powi(2) * size;
    for _ in 0..MOST {
        // Negated, so that NaN ends it too.
        if !(size > enough) {
            break;
        }
        let directions = scaled.par_iter_mut().zip(&mut image).zip(&direction).zip(&*scale);
        directions.with_min_len(SHORT).for_each(|(((scaled, image), direction), scale)| {
            (*scaled, *image) = ([direction * *scale as f32], [0.0]);
        });
        matrix.add_product(&scaled, &mut image);
        let images = image.par_iter_mut().zip(&direction).zip(&rows).zip(&*scale).with_min_len(SHORT);
        images.for_each(|((([image], direction), row), scale)| {
            *image = *image * *scale as f32 + row * direction;
        });
        let length = (size / dot(&direction, &|i| image[i][0])) as f32;
        let ends = step.par_iter_mut().zip(&mut residual).zip(&direction).zip(&image).with_min_len(SHORT);
        ends.for_each(|((([step], residual), direction), [image])| {
            *step += length * direction;
            *residual -= length * image;
        });
        let before = std::mem::replace(&mut size, dot(&residual, &|i| residual[i] / rows[i]));
        let growth = (size / before) as f32;
        let directions = direction.par_iter_mut().zip(&residual).zip(&rows).with_min_len(SHORT);
        directions.for_each(|((direction, residual), row)| *direction = residual / row + growth * *direction);
    }
    step.par_iter_mut().with_min_len(SHORT).for_each(|[step]| *step *= deviation as f32);
    let believed = step.iter().all(|[step]| step.abs() < 0.5);
    if believed {
        let scales = scale.par_iter_mut().zip(&step).with_min_len(SHORT);
        scales.for_each(|(scale, [step])| *scale *= 1.0 + f64::from(*step));
    }
    believed
}

/// Largest |row sum + escaped share - 1|.
pub(super) fn deviation(row_sums: impl Iterator<Item = f64>, escaped: &[f64]) -> f64 {
    row_sums.zip(escaped).map(|(sum, out)| (sum + out - 1.0).abs()).fold(0.0, f64::max)
}
