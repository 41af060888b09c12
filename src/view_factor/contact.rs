//! Polygons that lie on each other.
//!
//! Polygons front to front (a box on a floor) see each other where they touch, and nothing else there, like in the
//! limit of a narrow gap. If polygons face the same way (a window drawn in the plane of a wall), the smaller one is in
//! front and hides the other. In both cases the rest of a polygon is cut into convex pieces, which see the rest of the
//! scene.

use glam::DVec3;
use rayon::prelude::*;

use super::{
    blockers::Blockers,
    polygon::{Polygon, area_vector},
};
use crate::{form_factor::exact::clip, trace::sampling::mix};

/// Largest gap between two touching fronts, in the extent of the scene and in radii of the smaller polygon. It allows
/// for rounding; a wider gap is a real gap.
const GAP: (f64, f64) = (1e-7, 1e-5);
/// Depth to which a polygon may be sunk into the one that it lies on, because files round to six digits. If their planes cross, so that
/// there is no gap, other corners may be as high above it.
const SUNK: (f64, f64) = (5e-6, 1e-3);
/// Largest difference between the normals of polygons in one plane.
const TURNED: f64 = 1e-4;
/// Overlaps below this share of the smaller polygon are the rounding of neighbours' edges.
const OVERLAP: f64 = 1e-6;

/// Number of directions that decide on which side of a sheet the inside of a body is.
const LOOKS: u64 = 16;

/// The polygons without touching and hidden areas.
pub(super) struct Parts {
    /// Convex pieces, in the order of the polygons.
    pub(super) pieces: Vec<Polygon>,
    /// Pairs of touching surfaces with the area of contact. The first index is not greater than the second.
    pub(super) touching: Vec<(u32, u32, f64)>,
    /// For each polygon, the area that others in its plane hide.
    pub(super) hidden: Vec<f64>,
}

/// Two polygons that overlap in one plane.
struct Overlap {
    p: usize,
    q: usize,
    /// Whether they face each other. Otherwise the first hides the second.
    touch: bool,
}

/// Removes areas that touch others, or are hidden in their own plane.
pub(super) fn separate(polygons: Vec<Polygon>, blockers: &Blockers) -> Parts {
    let mut overlaps: Vec<Overlap> =
        (0..polygons.len()).into_par_iter().flat_map_iter(|i| overlaps_of(&polygons, i, blockers)).collect();
    let mut rest: Vec<Option<Vec<Vec<DVec3>>>> = polygons.iter().map(|_| None).collect();
    let mut hidden = vec![0.0; polygons.len()];
    let mut touching = Vec::new();
    overlaps.sort_by_key(|o| !o.touch);
    let mut take = |from: usize, by: usize| {
        let polygon = &polygons[from];
        let pieces = rest[from].take().unwrap_or_else(|| vec![polygon.corners.clone()]);
        let (left, taken) = without(pieces, polygon, &polygons[by]);
        rest[from] = Some(left);
        taken
    };
    for Overlap { p, q, touch } in overlaps {
        let taken = take(q, p);
        if touch {
            take(p, q);
            let (a, b) = (polygons[p].surface, polygons[q].surface);
            touching.push((a.min(b), a.max(b), taken));
        } else {
            hidden[q] += taken;
        }
    }
    let cut = |(polygon, rest): (Polygon, Option<Vec<Vec<DVec3>>>)| match rest {
        None => vec![polygon],
        Some(rest) => {
            let piece = |corners: Vec<DVec3>| Polygon::piece(corners, polygon.surface, polygon.source);
            rest.into_iter().map(piece).collect()
        }
    };
    let pieces = polygons.into_iter().zip(rest).flat_map(cut).collect();
    Parts { pieces, touching, hidden }
}

/// The overlaps of a polygon with later ones.
fn overlaps_of<'a>(
    polygons: &'a [Polygon],
    i: usize,
    blockers: &'a Blockers,
) -> impl Iterator<Item = Overlap> + 'a {
    let p = &polygons[i];
    let margin = SUNK.0;
    let near = blockers.near(&p.corners, margin);
    near.into_iter().map(|j| j as usize).filter(move |&j| j > i).filter_map(move |j| {
        let q = &polygons[j];
        let reach = p.radius + q.radius;
        let cosine = p.normal.dot(q.normal);
        if p.centre.distance_squared(q.centre) > reach * reach || cosine.abs() < 1.0 - TURNED {
            return None;
        }
        let small = p.radius.min(q.radius);
        let limit = |(extent, radii): (f64, f64)| (radii * small).min(extent);
        let opposed = cosine < 0.0;
        let (gap, sunk) = (limit(GAP), limit(if opposed { SUNK } else { GAP }));
        // Heights of the smaller polygon above the plane of the larger one, which has the more exact normal.
        let (plane, other) = if p.radius >= q.radius { (p, q) } else { (q, p) };
        let heights = other.corners.iter().map(|&v| plane.height(v));
        let (least, most) =
            heights.fold((0.0, 0.0), |(least, most): (f64, f64), h| (least.min(h), most.max(h)));
        let is_crossing = least < 0.0 && most > 0.0 && most.max(-least) <= limit(SUNK);
        if !is_crossing && (most > gap || least < -sunk) {
            return None;
        }
        let (_, overlap) = without(vec![other.corners.clone()], other, plane);
        if overlap < OVERLAP * p.area.min(q.area) {
            return None;
        }
        match opposed {
            true => in_contact(p, q, blockers).then_some(Overlap { p: i, q: j, touch: true }),
            false if p.area <= q.area => Some(Overlap { p: i, q: j, touch: false }),
            false => Some(Overlap { p: j, q: i, touch: false }),
        }
    })
}

/// Whether two polygons in one plane that face opposite ways touch front to front.
///
/// The two sides of a sheet have the same corners. They touch only if the front of one of them sees mostly backs, the
/// inside of a body. If both polygons have another one behind them, the pair that comes first in the list touches, and
/// the polygons behind them do not.
fn in_contact(p: &Polygon, q: &Polygon, blockers: &Blockers) -> bool {
    if blockers.name(p.source) == blockers.name(q.source) {
        return [p, q].iter().any(|polygon| is_inside(polygon, blockers));
    }
    match (blockers.reverse(p.source), blockers.reverse(q.source)) {
        (Some(back), Some(other)) => p.source.min(q.source) < back.min(other),
        _ => true,
    }
}

/// Whether the front of a polygon sees mostly backs.
fn is_inside(polygon: &Polygon, blockers: &Blockers) -> bool {
    let across = polygon.normal.any_orthonormal_vector();
    let along = polygon.normal.cross(across);
    let backs = (0..LOOKS).filter(|&k| {
        let unit = |d: u64| mix(&[k, d]) as f64 / 2f64.powi(64);
        let (sine, cosine) = (std::f64::consts::TAU * unit(0)).sin_cos();
        let squared = unit(1);
        let direction =
            (across * cosine + along * sine) * squared.sqrt() + polygon.normal * (1.0 - squared).sqrt();
        let name = blockers.name(polygon.source);
        blockers.first(polygon.centre, direction, name) == Some(false)
    });
    2 * backs.count() as u64 > LOOKS
}

/// The parts of the pieces of a polygon that another polygon in its plane does not cover, and the covered area.
fn without(pieces: Vec<Vec<DVec3>>, of: &Polygon, other: &Polygon) -> (Vec<Vec<DVec3>>, f64) {
    let normal = of.normal * of.normal.dot(other.normal).signum();
    let (mut left, mut taken) = (Vec::new(), 0.0);
    let (n, large) =
        (other.corners.len(), |corners: &[DVec3]| area_vector(corners).length() > 1e-12 * of.area);
    for piece in pieces {
        let (mut inside, mut outside) = (Some(piece.clone()), Vec::new());
        for k in 0..n {
            let (a, b) = (other.corners[k], other.corners[(k + 1) % n]);
            let inward = normal.cross(b - a).normalize();
            let Some(part) = inside else { break };
            outside.extend(clip(&part, a, -inward, 0.0).filter(|corners| large(corners)));
            inside = clip(&part, a, inward, 0.0).filter(|corners| large(corners));
        }
        match inside {
            None => left.push(piece),
            Some(inside) => {
                taken += area_vector(&inside).length();
                left.append(&mut outside);
            }
        }
    }
    (left, taken)
}
