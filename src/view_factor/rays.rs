//! The rays of a pair: between points of both polygons, or from the smaller one as light leaves it.

use glam::Vec3A;

use super::{
    pair::{NEAR, Pair},
    polygon::Polygon,
};
use crate::{
    Progress,
    form_factor::kernel,
    trace::{
        Tracer,
        sampling::{mix, sobol_4d},
    },
};

/// Distance of centres, in sums of radii, up to which rays leave the smaller polygon as light does, if at least such a share of
/// its light meets the other.
const NEIGHBOURS: f64 = NEAR;
const LEAST_SHARE: f64 = 0.1;

/// Points of a pair's sequence before a new one begins.
const SEQUENCE: u32 = 1 << 12;

/// Points of one scrambled Sobol sequence, as fractions of 2³². Pairs shift its digits, each in its own way, which keeps what is
/// even about it (digital shift; Dick and Pillichshammer, *Digital Nets and Sequences*, sec. 4.4).
pub(super) fn sequence() -> Vec<[u32; 4]> {
    (0..SEQUENCE).map(|index| sobol_4d(index, 0).map(|x| (x * 2f32.powi(32)) as u32)).collect()
}

/// Casts the rays that a pair wants more of.
pub(super) fn cast(
    pair: &mut Pair,
    polygons: &[Polygon],
    tracer: &Tracer,
    sequence: &[[u32; 4]],
    seed: u64,
    progress: &Progress,
) {
    let ends = Ends::of(pair, polygons);
    let [start, end] = [pair.rays, pair.rays.max(pair.wanted)].map(|rays| u64::from(rays) * ends.tries());
    pair.rays = pair.rays.max(pair.wanted);
    const UNIT: f32 = 1.0 / (1u64 << 32) as f32;
    // Millions may be summed up.
    let (mut weights, mut free, mut squares) = (0.0, 0.0, 0.0);
    let length = u64::from(SEQUENCE);
    for block in start / length..end.div_ceil(length) {
        if progress.is_stopped() {
            return;
        }
        let [a, b] = [0, 1].map(|k| mix(&[seed, u64::from(pair.i), u64::from(pair.j), block, k]));
        let shift = [a as u32, (a >> 32) as u32, b as u32, (b >> 32) as u32];
        for index in start.max(block * length)..end.min((block + 1) * length) {
            let digits = sequence[(index % length) as usize];
            let shifted = |k: usize| (digits[k] ^ shift[k]) as f32 * UNIT;
            if let Some((from, to, weight)) = ends.path([shifted(0), shifted(1), shifted(2), shifted(3)]) {
                weights += weight;
                squares += weight * weight;
                if tracer.visible(from, to) {
                    free += weight;
                }
            }
        }
    }
    let add = |sum: &mut f32, more: f64| *sum = (f64::from(*sum) + more) as f32;
    add(&mut pair.weights, weights);
    add(&mut pair.free, free);
    add(&mut pair.squares, squares);
}

/// How points of a pair are chosen.
enum Ends<'a> {
    /// Evenly on both, weighted by the kernel; the product of the areas over what they exchange, so that weights are near 1.
    Apart(&'a Polygon, &'a Polygon, f64),
    /// By rays that leave the first as light does: as many as one that meets the other takes, in a frame round its normal.
    Neighbours(&'a Polygon, &'a Polygon, u64, [Vec3A; 2]),
}

impl<'a> Ends<'a> {
    fn of(pair: &Pair, polygons: &'a [Polygon]) -> Ends<'a> {
        let [p, q] = [pair.i, pair.j].map(|k| &polygons[k as usize]);
        let (small, large) = if p.area <= q.area { (p, q) } else { (q, p) };
        let exchange = f64::from(pair.unoccluded);
        let share = exchange / small.area;
        if share >= LEAST_SHARE && p.centre.distance(q.centre) < NEIGHBOURS * (p.radius + q.radius) {
            // Of the points of a square a disk holds π / 4.
            let tries = (4.0 / std::f64::consts::PI / share).ceil() as u64;
            let across = small.edges[0].normalize();
            Ends::Neighbours(small, large, tries, [across, small.facing.cross(across)])
        } else {
            Ends::Apart(p, q, p.area * q.area / exchange)
        }
    }

    /// Points of the sequence a ray.
    fn tries(&self) -> u64 {
        if let Ends::Neighbours(_, _, tries, _) = self { *tries } else { 1 }
    }

    /// Two points and the weight of what they tell, if they face each other.
    #[inline]
    fn path(&self, [x, y, u, v]: [f32; 4]) -> Option<(Vec3A, Vec3A, f64)> {
        match *self {
            Ends::Apart(p, q, unit) => {
                let (from, to) = (p.point(x, y), q.point(u, v));
                let (d, n, m) = (to - from, p.facing, q.facing);
                (d.dot(n) > 0.0 && d.dot(m) < 0.0).then(|| (from, to, unit * f64::from(kernel(d, n, m))))
            }
            Ends::Neighbours(p, q, _, [across, along]) => {
                // Above even points of the disk directions have the density of light (Nusselt's analogue).
                let (s, t) = (2.0 * u - 1.0, 2.0 * v - 1.0);
                let squared = 1.0 - s * s - t * t;
                if squared <= 0.0 {
                    return None;
                }
                let from = p.point(x, y);
                let to = q.met(from, across * s + along * t + p.facing * squared.sqrt())?;
                Some((from, to, 1.0))
            }
        }
    }
}
