//! Unblocked form factors of patches to lamps.

use glam::DVec3;

use crate::{
    exact::{lambert, polygon_form_factor},
    scene::longest_edge,
    slopes::{CELLS, MODES, middles, modes},
};

/// If a patch is larger than this share of its distance to the lamp, the closed form is used, which costs ten times as
/// much as a quadrature rule. For smaller patches the rule is accurate to 10⁻⁶; its error grows with the sixth power of
/// the share.
const NEAR: f64 = 0.25;
/// If a patch is smaller than this share, three points suffice; their error grows with the third power. A lamp smaller
/// than this share is integrated with three points too. The largest errors of 300 random pairs, strips among them, are
/// 10⁻⁶ with 0.01 and 1.4·10⁻⁵ with 0.03.
const FAR: f64 = 0.01;

/// A rule for a triangle that is exact for polynomials of degree five: points as weights of the corners, and weights
/// (J. Radon, "Zur mechanischen Kubatur", Monatshefte für Mathematik 52, 1948).
const FIFTH_DEGREE: [(f64, f64, f64); 3] = [
    (1.0 / 3.0, 1.0 / 3.0, 0.225),
    (0.059_715_871_789_769_82, 0.470_142_064_105_115_1, 0.132_394_152_788_506_2),
    (0.797_426_985_353_087_3, 0.101_286_507_323_456_3, 0.125_939_180_544_827_15),
];

/// A rule that is exact for degree two (Strang and Fix, *An Analysis of the Finite Element Method*, 1973, section 4.3).
const SECOND_DEGREE: [(f64, f64, f64); 1] = [(2.0 / 3.0, 1.0 / 6.0, 1.0 / 3.0)];

/// A triangle with the normal of its front, in unit space.
#[derive(Debug, Clone, Copy)]
pub(super) struct Facing {
    pub(super) corners: [DVec3; 3],
    pub(super) normal: DVec3,
}

/// The form factor of a patch to a lamp, between the parts that are in front of each other.
pub(super) fn form_factor(patch: &Facing, lamp: &Facing) -> f64 {
    let Facing { corners, normal } = *patch;
    let heights = corners.map(|c| (c - lamp.corners[0]).dot(lamp.normal));
    // Heights up to single-precision rounding count as in the lamp's plane. Coordinates are 2 at most.
    const MOST: f64 = 4.0 * f32::EPSILON as f64;
    if heights.iter().all(|&h| h <= MOST) {
        let reach = corners.iter().chain(&lamp.corners).fold(DVec3::ZERO, |reach, c| reach.max(c.abs()));
        let rounding = f64::from(f32::EPSILON) * lamp.normal.abs().dot(reach);
        if heights.iter().all(|&h| h <= rounding) {
            return 0.0;
        }
    }
    let rises = lamp.corners.map(|c| (c - corners[0]).dot(normal));
    if rises.iter().all(|&h| h <= 0.0) {
        return 0.0;
    }
    let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
    let gap = distance(lamp, middle);
    let size = longest_edge(corners);
    let in_front = heights.iter().chain(&rises).all(|&h| h >= 0.0);
    if in_front && size.max(longest_edge(lamp.corners)) < FAR * gap {
        return between_points(patch, lamp);
    }
    if size > NEAR * gap {
        // The front of a polygon is the side where its corners run counterclockwise.
        let turned = |of: &Facing| {
            let [a, b, c] = of.corners;
            if (b - a).cross(c - a).dot(of.normal) >= 0.0 { of.corners } else { [a, c, b] }
        };
        return polygon_form_factor(&turned(patch), &turned(lamp));
    }
    let (above, count) = clip(lamp.corners, rises);
    if count < 3 {
        return 0.0;
    }
    if heights.iter().all(|&h| h >= 0.0) {
        return over_triangle(lamp, &above[..count], corners, normal);
    }
    let (seen, sides) = clip(corners, heights);
    let area = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a).length();
    let of_part = |k: usize| {
        let part = [seen[0], seen[k], seen[k + 1]];
        area(part) / area(corners) * over_triangle(lamp, &above[..count], part, normal)
    };
    (1..sides.max(1) - 1).map(of_part).sum()
}

/// The part of a triangle above a plane, given the heights of its corners: up to four corners, and their number.
fn clip(corners: [DVec3; 3], heights: [f64; 3]) -> ([DVec3; 4], usize) {
    let (mut above, mut count) = ([DVec3::ZERO; 4], 0);
    for k in 0..3 {
        let next = (k + 1) % 3;
        let (p, q, hp, hq) = (corners[k], corners[next], heights[k], heights[next]);
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
/// Distance from a point to the lamp.
fn distance(lamp: &Facing, point: DVec3) -> f64 {
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

/// The points and weights of a rule.
fn nodes(rule: &[(f64, f64, f64)], [a, b, c]: [DVec3; 3]) -> impl Iterator<Item = (DVec3, f64)> {
    rule.iter().flat_map(move |&(p, q, weight)| {
        // The middle has no permutations.
        let all = [a * p + (b + c) * q, b * p + (c + a) * q, c * p + (a + b) * q];
        all.into_iter().take(if p == q { 1 } else { 3 }).map(move |point| (point, weight))
    })
}

/// The form factor of a patch to a lamp if both are small compared with their distance.
fn between_points(patch: &Facing, lamp: &Facing) -> f64 {
    let [a, b, c] = lamp.corners;
    let area = 0.5 * (b - a).cross(c - a).length();
    let kernel = |x: DVec3, y: DVec3| {
        let path = y - x;
        let squared = path.length_squared();
        path.dot(patch.normal) * -path.dot(lamp.normal) / (std::f64::consts::PI * squared * squared)
    };
    let from = |x: DVec3| nodes(&SECOND_DEGREE, lamp.corners).map(|(y, w)| w * kernel(x, y)).sum::<f64>();
    area * nodes(&SECOND_DEGREE, patch.corners).map(|(x, w)| w * from(x)).sum::<f64>()
}

/// The mean form factor of a triangle to `above`, the part of the lamp in front of it.
fn over_triangle(lamp: &Facing, above: &[DVec3], corners: [DVec3; 3], normal: DVec3) -> f64 {
    let [a, b, c] = corners;
    let size = longest_edge(corners) / distance(lamp, (a + b + c) / 3.0);
    let rule: &[_] = if size < FAR { &SECOND_DEGREE } else { &FIFTH_DEGREE };
    nodes(rule, corners).map(|(point, weight)| weight * lambert(point, normal, above)).sum()
}

/// Most cuts of a patch for slopes, which need less accuracy than the light itself.
const MOST_CUTS_OF_MOMENTS: usize = 2;

/// The means over a patch of the basis functions ([`modes`]) times each point's form factor to a lamp.
pub(super) fn moments(patch: &Facing, lamp: &Facing) -> [f64; MODES] {
    let Facing { corners, normal } = *patch;
    let rises = lamp.corners.map(|c| (c - corners[0]).dot(normal));
    let (above, count) = clip(lamp.corners, rises);
    if count < 3 {
        return [0.0; MODES];
    }
    let whole = (corners, [DVec3::X, DVec3::Y, DVec3::Z]);
    moments_of_part((lamp, &above[..count], normal), whole, 0)
}

/// The same over a part of a patch, given by its corners and their barycentric coordinates.
fn moments_of_part(
    seen: (&Facing, &[DVec3], DVec3),
    (corners, places): ([DVec3; 3], [DVec3; 3]),
    cuts: usize,
) -> [f64; MODES] {
    let (lamp, above, normal) = seen;
    let [a, b, c] = corners;
    let size = longest_edge(corners) / distance(lamp, (a + b + c) / 3.0);
    if size > NEAR && cuts < MOST_CUTS_OF_MOMENTS {
        let quarters = |[a, b, c]: [DVec3; 3]| {
            let (ab, bc, ca) = (a.midpoint(b), b.midpoint(c), c.midpoint(a));
            [[a, ab, ca], [ab, b, bc], [ca, bc, c], [bc, ca, ab]]
        };
        let (parts, places) = (quarters(corners), quarters(places));
        let sums: [_; 4] = std::array::from_fn(|k| moments_of_part(seen, (parts[k], places[k]), cuts + 1));
        return std::array::from_fn(|m| sums.iter().map(|sum| sum[m]).sum::<f64>() / 4.0);
    }
    let rule: &[_] = if size < FAR { &SECOND_DEGREE } else { &FIFTH_DEGREE };
    let mut sum = [0.0; MODES];
    for ((point, weight), (place, _)) in nodes(rule, corners).zip(nodes(rule, places)) {
        // Points behind the lamp do not see it.
        if (point - lamp.corners[0]).dot(lamp.normal) > 0.0 {
            let light = weight * lambert(point, normal, above);
            let modes = modes(place.to_array());
            (0..MODES).for_each(|m| sum[m] += light * modes[m]);
        }
    }
    sum
}

/// The form factors of the cells of a patch to a lamp, each at the middle of the cell. `None` if they hardly differ from
/// light of the second degree: if the patch is small beside its distance from the lamp, and both are altogether in front
/// of each other.
pub(super) fn of_cells(patch: &Facing, lamp: &Facing) -> Option<[f64; CELLS]> {
    let Facing { corners, normal } = *patch;
    let rises = lamp.corners.map(|c| (c - corners[0]).dot(normal));
    let (above, count) = clip(lamp.corners, rises);
    let is_in_front = |point: DVec3| (point - lamp.corners[0]).dot(lamp.normal) > 0.0;
    let in_front = corners.iter().filter(|&&corner| is_in_front(corner)).count();
    if count < 3 || in_front == 0 {
        return None;
    }
    let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
    let is_far = longest_edge(corners) <= NEAR * distance(lamp, middle);
    if is_far && in_front == 3 && rises.iter().all(|&rise| rise >= 0.0) {
        return None;
    }
    let at = |[a, b, c]: [f64; 3]| corners[0] * a + corners[1] * b + corners[2] * c;
    let seen = |point: DVec3| if is_in_front(point) { lambert(point, normal, &above[..count]) } else { 0.0 };
    Some(middles().map(at).map(seen))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::dvec3;

    /// Compares with a fine lattice of points: small and far, large and near, and crossing the lamp's plane.
    #[test]
    fn moments_are_those_of_many_points() {
        const N: usize = 120;
        let lamp = facing([dvec3(0.0, 0.0, 1.0), dvec3(1.0, 0.0, 1.0), dvec3(0.0, 1.0, 1.0)], -DVec3::Z);
        for (corners, towards, within) in [
            ([dvec3(5.0, 3.0, -9.0), dvec3(5.5, 3.0, -9.0), dvec3(5.0, 3.5, -9.0)], DVec3::Z, 1e-4),
            ([dvec3(0.1, 0.0, 0.0), dvec3(0.9, 0.1, 0.1), dvec3(0.2, 0.8, 0.0)], DVec3::Z, 1e-3),
            ([dvec3(-0.5, 0.0, 0.0), dvec3(-0.5, 1.0, 0.0), dvec3(-0.5, 0.0, 2.0)], DVec3::X, 3e-2),
        ] {
            let patch = facing(corners, towards);
            let rises = lamp.corners.map(|c| (c - corners[0]).dot(patch.normal));
            let (above, count) = clip(lamp.corners, rises);
            let (mut wanted, mut mean, mut points) = ([0.0; MODES], 0.0, 0.0);
            for i in 0..N {
                for j in 0..N - i {
                    for turned in 0..=usize::from(i + j + 2 <= N) {
                        let x = |k: usize| (k as f64 + (1.0 + turned as f64) / 3.0) / N as f64;
                        let b = [x(i), x(j), 1.0 - x(i) - x(j)];
                        let point: DVec3 = (0..3).map(|k| corners[k] * b[k]).sum();
                        let in_front = (point - lamp.corners[0]).dot(lamp.normal) > 0.0;
                        let light =
                            if in_front { lambert(point, patch.normal, &above[..count]) } else { 0.0 };
                        let modes = modes(b);
                        (0..MODES).for_each(|m| wanted[m] += light * modes[m]);
                        (mean, points) = (mean + light, points + 1.0);
                    }
                }
            }
            let found = moments(&patch, &lamp);
            let off = (0..MODES)
                .map(|m| (found[m] - wanted[m] / points).abs() / (mean / points))
                .fold(0.0, f64::max);
            assert!(off < within, "{corners:?}: {found:?}, off by {off:e} of the mean");
        }
    }

    fn facing(corners: [DVec3; 3], towards: DVec3) -> Facing {
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
        Facing { corners, normal: if normal.dot(towards) > 0.0 { normal } else { -normal } }
    }

    /// Strips a hundred times as long as wide, as patch and as lamp, at all distances: the closed form within 10⁻⁶, also
    /// where another rule takes over.
    #[test]
    fn strips_are_those_of_the_closed_form() {
        let strip = |at: DVec3, along: DVec3, across: DVec3| [at, at + along, at + along + 0.01 * across];
        for gap in [0.05, 0.5, 2.0, 3.9, 4.1, 10.0, 33.0, 40.0, 90.0, 110.0, 300.0] {
            let lamp = facing(strip(dvec3(0.2, 0.1, gap), DVec3::X, DVec3::Y), dvec3(0.0, 0.0, -1.0));
            for along in [DVec3::X, DVec3::Y, dvec3(0.6, 0.0, 0.8), dvec3(0.0, 0.8, -0.6)] {
                let corners = strip(DVec3::ZERO, along, along.any_orthonormal_vector());
                let patch = facing(corners, DVec3::Z);
                let turned = |of: &Facing| {
                    let [a, b, c] = of.corners;
                    if (b - a).cross(c - a).dot(of.normal) > 0.0 { [a, b, c] } else { [a, c, b] }
                };
                let wanted = polygon_form_factor(&turned(&patch), &turned(&lamp));
                let found = form_factor(&patch, &lamp);
                let off = found / wanted - 1.0;
                println!("{gap} {along}: {found:e}, off by {off:.1e}");
                // The contour integral of thin strips cancels: it rounds at 1e-16 of the longest edges, squared.
                assert!(
                    (found - wanted).abs() <= 1e-6 * wanted + 1e-14,
                    "{gap} {along}: {found} for {wanted}"
                );
            }
        }
    }

    /// Compares with the double contour integral: near and far, crossing the lamp's plane, and touching at an edge and
    /// at a corner.
    #[test]
    fn form_factors_are_those_of_the_closed_form() {
        let lamp = facing([dvec3(0.0, 0.0, 1.0), dvec3(1.0, 0.0, 1.0), dvec3(0.0, 1.0, 1.0)], -DVec3::Z);
        let down = [dvec3(0.0, 0.0, 1.0), dvec3(0.0, 1.0, 1.0), dvec3(1.0, 0.0, 1.0)];
        for (corners, towards) in [
            ([dvec3(0.1, 0.0, 0.0), dvec3(0.9, 0.1, 0.1), dvec3(0.2, 0.8, 0.0)], DVec3::Z),
            ([dvec3(0.3, 0.3, 0.5), dvec3(0.32, 0.3, 0.5), dvec3(0.3, 0.32, 0.5)], DVec3::Z),
            ([dvec3(5.0, 3.0, -9.0), dvec3(5.5, 3.0, -9.0), dvec3(5.0, 3.5, -9.0)], DVec3::Z),
            ([dvec3(50.0, 3.0, -90.0), dvec3(50.5, 3.0, -90.0), dvec3(50.0, 3.5, -90.0)], DVec3::Z),
            ([dvec3(-0.5, 0.0, 0.0), dvec3(-0.5, 1.0, 0.0), dvec3(-0.5, 0.0, 2.0)], DVec3::X),
            ([dvec3(0.0, 0.0, 0.0), dvec3(0.0, 1.0, 1.0), dvec3(0.0, 0.0, 1.0)], DVec3::X),
            ([dvec3(0.0, 0.0, 1.0), dvec3(0.0, -1.0, 0.0), dvec3(0.5, -1.0, 0.0)], DVec3::Y),
            ([dvec3(0.0, 0.0, 1.0), dvec3(2.0, -1.0, 0.0), dvec3(0.0, -1.0, 0.0)], dvec3(0.0, 1.0, -1.0)),
        ] {
            let patch = facing(corners, towards);
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
            let ccw =
                if normal.dot(patch.normal) > 0.0 { corners } else { [corners[0], corners[2], corners[1]] };
            let wanted = polygon_form_factor(&ccw, &down);
            let found = form_factor(&patch, &lamp);
            assert!((found - wanted).abs() <= 3e-6 * wanted + 1e-12, "{corners:?}: {found} for {wanted}");
        }
    }
}
