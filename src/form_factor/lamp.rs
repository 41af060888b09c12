//! What lamps would send to a patch if nothing stood between, exactly.
//!
//! Where lamps are few, shadow rays need not find out how much light goes from one to a patch, only how much of it is
//! blocked: the sum of a patch's samples, blocked ones included, is known beforehand (a ratio estimator; Cochran,
//! *Sampling Techniques*, 1977, chapter 6). What no blocker touches is then exact.

use glam::DVec3;

use super::{
    exact::{lambert, polygon_form_factor},
    shadow::Sources,
    siblings::adjoin,
};
use crate::{
    patch::Patches,
    trace::{Tracer, UnitTriangle},
};

/// More lamps than this are sampled only: each costs about as much as a ray, at every patch.
pub(crate) const MOST_LAMPS: usize = 16;
/// Lamps with a smaller area, in unit space, are sampled only: rounding would be all that is left of Lambert's formula. One
/// sample knows their light as well.
const LEAST_AREA: f32 = 1e-16;
/// A patch is cut until it is smaller than this share of its distance to the lamp. The rule is then right to 10⁻⁶; its error
/// goes with the sixth power of that.
const NEAR: f64 = 0.25;
/// For one that is smaller than this share three points are as good; their error goes with the third power.
const FAR: f64 = 0.03;
/// One that is larger than this many times the distance is left to the closed form, which costs a hundred times as much.
const TOUCHING: f64 = 2.0;

/// The points, as weights of the corners, and the weights of a rule for a triangle that is exact to the fifth degree (J. Radon,
/// "Zur mechanischen Kubatur", Monatshefte für Mathematik 52, 1948).
const FIFTH_DEGREE: [(f64, f64, f64); 3] = [
    (1.0 / 3.0, 1.0 / 3.0, 0.225),
    (0.059_715_871_789_769_82, 0.470_142_064_105_115_1, 0.132_394_152_788_506_2),
    (0.797_426_985_353_087_3, 0.101_286_507_323_456_3, 0.125_939_180_544_827_15),
];

/// One that is exact to the second (Strang and Fix, *An Analysis of the Finite Element Method*, 1973, section 4.3).
const SECOND_DEGREE: [(f64, f64, f64); 1] = [(2.0 / 3.0, 1.0 / 6.0, 1.0 / 3.0)];

/// The lamps of a scene: triangles that follow each other in the file, in one plane, and share a corner, are one.
#[derive(Debug, Clone)]
pub(super) struct Lamps {
    triangles: Vec<Triangle>,
    /// How many there are.
    pub(super) count: usize,
    /// Which of them each source is part of.
    pub(super) of_sources: Vec<u8>,
}

/// A triangle of one brightness, in unit space.
#[derive(Debug, Clone)]
struct Triangle {
    lamp: usize,
    corners: [DVec3; 3],
    normal: DVec3,
    /// Probability of a shadow ray a unit area, in proportion to the lamp's radiosity.
    density: f64,
}

/// The lamps of the scene; `None` when they are too many, or one is too small.
pub(super) fn few(tracer: &Tracer, patches: &Patches, sources: &Sources) -> Option<Lamps> {
    let mut lamps = Lamps { triangles: Vec::new(), count: 0, of_sources: Vec::new() };
    let mut last: Option<&UnitTriangle> = None;
    let of_triangle = |&i: &u32, &j: &u32| patches.triangle(i as usize) == patches.triangle(j as usize);
    for part in sources.patches().chunk_by(of_triangle) {
        let triangle = &tracer.triangles()[patches.triangle(part[0] as usize)];
        let area = 0.5
            * (triangle.corners[1] - triangle.corners[0])
                .cross(triangle.corners[2] - triangle.corners[0])
                .length();
        if area < LEAST_AREA {
            return None;
        }
        let goes_on = last.is_some_and(|last| adjoin(last, triangle));
        last = Some(triangle);
        lamps.count += usize::from(!goes_on);
        let lamp = lamps.count - 1;
        lamps.of_sources.extend(part.iter().map(|_| lamp as u8));
        let whole = patches.triangle_areas()[patches.triangle(part[0] as usize)];
        let density =
            |i: u32| sources.probability(i as usize) * (whole / patches.area(i as usize)) / f64::from(area);
        let mut add = |corners: [[f64; 3]; 3], density: f64| {
            let corners =
                corners.map(|b| (0..3).map(|k| triangle.corners[k].as_dvec3() * b[k]).sum::<DVec3>());
            let normal = triangle.normal.as_dvec3();
            lamps.triangles.push(Triangle { lamp, corners, normal, density });
        };
        let even = part.len() == patches.leaves(patches.triangle(part[0] as usize))
            && part.iter().all(|&i| (density(i) / density(part[0]) - 1.0).abs() <= f64::from(f32::EPSILON));
        if even {
            add([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], density(part[0]));
        } else {
            part.iter()
                .take(MOST_LAMPS + 1)
                .for_each(|&i| add(patches.barycentric_corners(i as usize), density(i)));
        }
        if lamps.triangles.len() > MOST_LAMPS {
            return None;
        }
    }
    Some(lamps)
}

/// The means over a triangle of the density-weighted form factors to each lamp: a shadow ray's kernel, visible or not, zero if it
/// goes to another lamp, has this mean.
pub(super) fn mean_kernels(lamps: &Lamps, corners: [DVec3; 3], normal: DVec3) -> Vec<f64> {
    // Where there is none at all, one that is dark.
    let mut means = vec![0.0; lamps.count.max(1)];
    for lamp in &lamps.triangles {
        means[lamp.lamp] += lamp.density * form_factor(lamp, corners, normal);
    }
    means
}

/// The form factor of a triangle to a lamp.
fn form_factor(lamp: &Triangle, corners: [DVec3; 3], normal: DVec3) -> f64 {
    let heights = corners.map(|c| (c - lamp.corners[0]).dot(lamp.normal));
    // What rounding lifts out of the lamp's plane is in it.
    if heights.iter().all(|&h| h <= f64::from(f32::EPSILON)) {
        return 0.0;
    }
    let (above, count) = above_horizon(lamp, corners[0], normal);
    if count < 3 {
        return 0.0;
    }
    let gap = distance(lamp, (corners[0] + corners[1] + corners[2]) / 3.0);
    if longest(corners) > TOUCHING * gap || heights.iter().any(|&h| h < 0.0) {
        // The front of `corners` is the side of `normal`.
        let [a, b, c] = corners;
        let facing = if (b - a).cross(c - a).dot(normal) >= 0.0 { corners } else { [a, c, b] };
        polygon_form_factor(&facing, &lamp.corners)
    } else {
        over_triangle(lamp, &above[..count], corners, normal)
    }
}

/// The corners of what is in front of a patch of the lamp, one more at most.
fn above_horizon(lamp: &Triangle, on_patch: DVec3, normal: DVec3) -> ([DVec3; 4], usize) {
    let heights = lamp.corners.map(|c| (c - on_patch).dot(normal));
    let (mut above, mut count) = ([DVec3::ZERO; 4], 0);
    for k in 0..3 {
        let next = (k + 1) % 3;
        let (p, q, hp, hq) = (lamp.corners[k], lamp.corners[next], heights[k], heights[next]);
        if hp >= 0.0 {
            above[count] = p;
            count += 1;
        }
        if (hp < 0.0) != (hq < 0.0) {
            above[count] = p + (q - p) * (hp / (hp - hq));
            count += 1;
        }
    }
    (above, count)
}

fn longest([a, b, c]: [DVec3; 3]) -> f64 {
    a.distance(b).max(b.distance(c)).max(c.distance(a))
}

/// Distance from a point to the lamp.
fn distance(lamp: &Triangle, point: DVec3) -> f64 {
    let [a, b, c] = lamp.corners;
    let edges = [(a, b), (b, c), (c, a)];
    let height = (point - a).dot(lamp.normal);
    if edges.iter().all(|&(p, q)| (q - p).cross(point - p).dot(lamp.normal) >= 0.0) {
        return height.abs();
    }
    let to_edge = |(p, q): (DVec3, DVec3)| {
        let along = q - p;
        let t = ((point - p).dot(along) / along.length_squared()).clamp(0.0, 1.0);
        point.distance(p + along * t)
    };
    edges.into_iter().map(to_edge).fold(f64::INFINITY, f64::min)
}

/// The mean form factor of a triangle to what it sees of the lamp.
fn over_triangle(lamp: &Triangle, above: &[DVec3], corners: [DVec3; 3], normal: DVec3) -> f64 {
    let [a, b, c] = corners;
    let size = longest(corners) / distance(lamp, (a + b + c) / 3.0);
    if size > NEAR {
        let (ab, bc, ca) = (a.midpoint(b), b.midpoint(c), c.midpoint(a));
        let parts = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [bc, ca, ab]];
        return parts.iter().map(|&part| over_triangle(lamp, above, part, normal)).sum::<f64>() / 4.0;
    }
    let at = |point: DVec3| lambert(point, normal, above);
    let rule: &[_] = if size < FAR { &SECOND_DEGREE } else { &FIFTH_DEGREE };
    let mut sum = 0.0;
    for &(p, q, weight) in rule {
        sum += weight * at(a * p + (b + c) * q);
        // But for the middle, which has no others like it.
        if p != q {
            sum += weight * (at(b * p + (c + a) * q) + at(c * p + (a + b) * q));
        }
    }
    sum
}
