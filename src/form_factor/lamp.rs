//! What lamps would send to a patch if nothing stood between, exactly.
//!
//! Where lamps are few, shadow rays need not find out how much light goes from one to a patch, only how much of it is
//! blocked: the sum of a patch's samples, blocked ones included, is known beforehand (a ratio estimator; Cochran,
//! *Sampling Techniques*, 1977, chapter 6). What no blocker touches is then exact.

use glam::DVec3;

use super::{
    exact::{lambert, polygon_form_factor},
    shadow::Sources,
};
use crate::{patch::Patches, trace::Tracer};

/// More lamps than this are sampled only: each costs about as much as a ray, at every patch.
pub(crate) const MOST_LAMPS: usize = 16;
/// Lamps with a smaller area, in unit space, are sampled only: rounding would be all that is left of Lambert's formula. One
/// sample knows their light as well.
const LEAST_AREA: f32 = 1e-16;
/// A patch is cut until it is smaller than this share of its distance to the lamp. The rule's relative error is about the
/// sixth power of that.
const NEAR: f64 = 0.125;
/// One that is larger than this many times the distance is left to the closed form, which costs a hundred times as much.
const TOUCHING: f64 = 2.0;

/// The points, as weights of the corners, and the weights of a rule for a triangle that is exact to the fifth degree (J. Radon,
/// "Zur mechanischen Kubatur", Monatshefte für Mathematik 52, 1948).
const RULE: [(f64, f64, f64); 3] = [
    (1.0 / 3.0, 1.0 / 3.0, 0.225),
    (0.059_715_871_789_769_82, 0.470_142_064_105_115_1, 0.132_394_152_788_506_2),
    (0.797_426_985_353_087_3, 0.101_286_507_323_456_3, 0.125_939_180_544_827_15),
];

/// A triangle of one brightness, in unit space.
#[derive(Debug, Clone)]
pub(super) struct Lamp {
    corners: [DVec3; 3],
    normal: DVec3,
    /// Probability of a shadow ray a unit area, in proportion to the lamp's radiosity.
    density: f64,
}

/// The lamps of the scene; `None` when they are too many, or one is too small.
pub(super) fn few(tracer: &Tracer, patches: &Patches, sources: &Sources) -> Option<Vec<Lamp>> {
    let mut lamps: Vec<Lamp> = Vec::new();
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
        let whole = patches.triangle_areas()[patches.triangle(part[0] as usize)];
        let density =
            |i: u32| sources.probability(i as usize) * (whole / patches.area(i as usize)) / f64::from(area);
        let mut add = |corners: [[f64; 3]; 3], density: f64| {
            let corners =
                corners.map(|b| (0..3).map(|k| triangle.corners[k].as_dvec3() * b[k]).sum::<DVec3>());
            lamps.push(Lamp { corners, normal: triangle.normal.as_dvec3(), density });
        };
        let even = part.len() == patches.leaves(patches.triangle(part[0] as usize))
            && part.iter().all(|&i| (density(i) / density(part[0]) - 1.0).abs() <= f64::from(f32::EPSILON));
        if even {
            add([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], density(part[0]));
        } else {
            part.iter().take(MOST_LAMPS + 1).for_each(|&i| add(patches.corners(i as usize), density(i)));
        }
        if lamps.len() > MOST_LAMPS {
            return None;
        }
    }
    Some(lamps)
}

/// The mean over a triangle of the density-weighted form factors to all lamps: a shadow ray's kernel, visible or not,
/// has this mean.
pub(super) fn mean_kernel(lamps: &[Lamp], corners: [DVec3; 3], normal: DVec3) -> f64 {
    lamps.iter().map(|lamp| lamp.density * form_factor(lamp, corners, normal)).sum()
}

/// The form factor of a triangle to a lamp.
fn form_factor(lamp: &Lamp, corners: [DVec3; 3], normal: DVec3) -> f64 {
    let heights = corners.map(|c| (c - lamp.corners[0]).dot(lamp.normal));
    // What rounding lifts out of the lamp's plane is in it.
    if heights.iter().all(|&h| h <= f64::from(f32::EPSILON)) {
        return 0.0;
    }
    let gap = distance(lamp, (corners[0] + corners[1] + corners[2]) / 3.0);
    if longest(corners) > TOUCHING * gap || heights.iter().any(|&h| h < 0.0) {
        // The front of `corners` is the side of `normal`.
        let [a, b, c] = corners;
        let facing = if (b - a).cross(c - a).dot(normal) >= 0.0 { corners } else { [a, c, b] };
        polygon_form_factor(&facing, &lamp.corners)
    } else {
        over_triangle(lamp, corners, normal)
    }
}

fn longest([a, b, c]: [DVec3; 3]) -> f64 {
    a.distance(b).max(b.distance(c)).max(c.distance(a))
}

/// Distance from a point to the lamp.
fn distance(lamp: &Lamp, point: DVec3) -> f64 {
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

fn over_triangle(lamp: &Lamp, corners: [DVec3; 3], normal: DVec3) -> f64 {
    let [a, b, c] = corners;
    if longest(corners) > NEAR * distance(lamp, (a + b + c) / 3.0) {
        let (ab, bc, ca) = (a.midpoint(b), b.midpoint(c), c.midpoint(a));
        let parts = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [bc, ca, ab]];
        return parts.iter().map(|&part| over_triangle(lamp, part, normal)).sum::<f64>() / 4.0;
    }
    let mut sum = 0.0;
    for (k, &(p, q, weight)) in RULE.iter().enumerate() {
        sum += weight * at_point(lamp, a * p + (b + c) * q, normal);
        if k > 0 {
            sum += weight
                * (at_point(lamp, b * p + (c + a) * q, normal) + at_point(lamp, c * p + (a + b) * q, normal));
        }
    }
    sum
}

/// The form factor from a point to the lamp's front, by Lambert's formula; what is below the horizon is cut off.
fn at_point(lamp: &Lamp, point: DVec3, normal: DVec3) -> f64 {
    if (point - lamp.corners[0]).dot(lamp.normal) <= 0.0 {
        return 0.0;
    }
    let corners = lamp.corners.map(|c| c - point);
    let heights = corners.map(|c| c.dot(normal));
    if heights.iter().all(|&h| h >= 0.0) {
        return lambert(DVec3::ZERO, normal, &corners);
    }
    let (mut above, mut count) = ([DVec3::ZERO; 4], 0);
    for k in 0..3 {
        let (p, q, hp, hq) = (corners[k], corners[(k + 1) % 3], heights[k], heights[(k + 1) % 3]);
        if hp >= 0.0 {
            above[count] = p;
            count += 1;
        }
        if (hp < 0.0) != (hq < 0.0) {
            above[count] = p + (q - p) * (hp / (hp - hq));
            count += 1;
        }
    }
    if count >= 3 { lambert(DVec3::ZERO, normal, &above[..count]) } else { 0.0 }
}
