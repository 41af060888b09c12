//! The lamps of a scene: patches that emit, put together where they shine alike.
//!
//! A lamp meets one contract, whatever its kind: for a patch it tells what would arrive if nothing stood between
//! ([`Lamps::unoccluded`]), and it samples paths from points of the patch ([`Lamps::sample`]), each with the irradiance that it
//! stands for. Everything else, visibility and how samples become irradiance, does not ask what kind it is.

use std::ops::Range;

use glam::Vec3A;

use super::{
    Constants,
    footprint::{Footprint, is_hidden, kernel},
    solid_angle,
    tree::Tree,
    unoccluded::{Facing, form_factor},
};
use crate::{
    patch::Patches,
    trace::{
        Tracer, UnitTriangle,
        sampling::{mix, square_to_triangle},
    },
};
use rayon::prelude::*;

/// The cosine between neighbours in a plane.
const FLAT: f32 = 0.999;

/// Whether two triangles are in one plane and share a corner.
pub(crate) fn adjoin(p: &UnitTriangle, q: &UnitTriangle) -> bool {
    p.normal.dot(q.normal) > FLAT && p.corners.iter().any(|corner| q.corners.contains(corner))
}

/// A triangle of one brightness: a patch, or all patches of a triangle.
#[derive(Debug, Clone)]
pub(super) struct Piece {
    /// Where its light leaves.
    footprint: Footprint,
    facing: Facing,
    /// In unit space.
    area: f64,
    /// Radiosity, all channels together.
    pub(super) brightness: f64,
    /// The front patches that it consists of.
    pub(super) patches: Range<usize>,
    /// Which lamp it is a part of: triangles that follow each other in the file, in one plane, and share a corner, are one.
    pub(super) lamp: usize,
}

/// The lamps of a scene.
#[derive(Debug, Clone, Default)]
pub(crate) struct Lamps {
    pub(super) pieces: Vec<Piece>,
    /// How many lamps the pieces make.
    pub(super) count: usize,
    /// Whether each front patch is a part of one; empty where none is.
    is_part: Vec<bool>,
    /// Patches that emit behind another face at the same place, in order: nobody sees their light.
    hidden: Vec<usize>,
    /// To choose among many.
    tree: Option<Tree>,
}

/// A path between a point of a patch and one of a lamp, both moved off their surfaces, and which share of the lamp's radiosity
/// arrives at the patch, were all its samples like this one and the path free.
pub(super) struct Path {
    pub(super) from: Vec3A,
    pub(super) to: Vec3A,
    pub(super) piece: u32,
    pub(super) weight: f32,
}

/// How a patch chooses among the pieces.
pub(super) enum Choice<'a> {
    /// By the cumulative probability of each.
    Table(Vec<f64>),
    /// By a walk down a tree.
    Tree(&'a Tree, glam::DVec3, f64, glam::DVec3),
}

impl Piece {
    /// A path from a part of a patch in front of the piece to a part of the piece in front of the patch, both points of them, and what
    /// share of the piece's radiosity arrives, were all paths like it; `None` where they do not face each other. Where the piece is
    /// near, evenly over its solid angle, so that shares hardly differ; where it is far that is no other than evenly over its area.
    #[inline]
    fn sample(&self, from: &Footprint, [x, y, u, v]: [f32; 4]) -> Option<(Vec3A, Vec3A, f64)> {
        let own = &self.footprint;
        let (seen, x, of_patch) = part_in_front(&from.corners, own, x)?;
        let (corners, u, of_piece) = part_in_front(&own.corners, from, u)?;
        let within =
            |corners: &[Vec3A; 3], b: [f32; 3]| corners[0] * b[0] + corners[1] * b[1] + corners[2] * b[2];
        let p = within(&seen, square_to_triangle(x, y));
        let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
        let whole = f64::from(of_patch.of_all);
        if f64::from((middle - p).length_squared()) * Constants::FAR < self.area {
            let (point, at) = (p.as_dvec3(), corners.map(|corner| corner.as_dvec3()));
            let (direction, solid_angle) = solid_angle::sample(at, point, [u, v].map(f64::from))?;
            let (cos, cos_lamp) =
                (direction.dot(from.normal.as_dvec3()), -direction.dot(own.normal.as_dvec3()));
            let height = -f64::from((own.corners[0] - p).dot(own.normal));
            if cos <= 0.0 || cos_lamp <= 0.0 || height <= 0.0 {
                return None;
            }
            let q = point + direction * (height.abs() / cos_lamp);
            let weight = cos * solid_angle / std::f64::consts::PI / f64::from(of_piece.chosen);
            return Some((p, q.as_vec3a(), whole * weight));
        }
        let q = within(&corners, square_to_triangle(u, v));
        let facing = (q - p).dot(from.normal) > 0.0 && (q - p).dot(own.normal) < 0.0;
        let area = self.area * f64::from(of_piece.of_all);
        facing.then(|| (p, q, whole * area * f64::from(kernel(q - p, from.normal, own.normal))))
    }
}

/// What part of a triangle a point is chosen from.
struct Part {
    /// The share of the triangle's area that may be chosen,
    of_all: f32,
    /// and of that, what is chosen from.
    chosen: f32,
}

/// A triangle of what of another is in front of a face, chosen by area with a number in \[0, 1), and the rest of the number, stretched
/// to \[0, 1) again; `None` where nothing is in front.
#[inline]
fn part_in_front(corners: &[Vec3A; 3], face: &Footprint, u: f32) -> Option<([Vec3A; 3], f32, Part)> {
    let heights = corners.map(|corner| (corner - face.corners[0]).dot(face.normal));
    if heights.iter().all(|&h| h >= 0.0) {
        return Some((*corners, u, Part { of_all: 1.0, chosen: 1.0 }));
    }
    let (mut above, mut count) = ([Vec3A::ZERO; 4], 0);
    for k in 0..3 {
        let next = (k + 1) % 3;
        let (hp, hq) = (heights[k], heights[next]);
        if hp >= 0.0 {
            above[count] = corners[k];
            count += 1;
        }
        if (hp < 0.0) != (hq < 0.0) {
            above[count] = corners[k] + (corners[next] - corners[k]) * (hp / (hp - hq));
            count += 1;
        }
    }
    let area = |a: Vec3A, b: Vec3A, c: Vec3A| (b - a).cross(c - a).length();
    let first = if count >= 3 { area(above[0], above[1], above[2]) } else { 0.0 };
    let second = if count == 4 { area(above[0], above[2], above[3]) } else { 0.0 };
    let (sum, all) = (first + second, area(corners[0], corners[1], corners[2]));
    if !(sum > 0.0 && all > 0.0) {
        return None;
    }
    let of_all = (sum / all).min(1.0);
    let share = first / sum;
    if u < share {
        return Some(([above[0], above[1], above[2]], u / share, Part { of_all, chosen: share }));
    }
    let rest = 1.0 - share;
    let u = ((u - share) / rest).min(1.0 - f32::EPSILON);
    Some(([above[0], above[2], above[3]], u, Part { of_all, chosen: rest }))
}

impl Lamps {
    /// Those front patches that `shine`, but for hidden ones.
    pub(crate) fn new(tracer: &Tracer, patches: &Patches, shines: impl Fn(usize) -> bool + Sync) -> Lamps {
        let channels = patches.channels();
        let emission = |i: usize| &patches.emission()[i * channels..][..channels];
        let brightness = |i: usize| emission(i).iter().sum::<f64>();
        let candidates = (0..patches.fronts()).into_par_iter().filter(|&i| brightness(i) > 0.0 && shines(i));
        let (hidden, parts): (Vec<usize>, Vec<usize>) =
            candidates.partition_map(|i| match is_hidden(tracer, patches, i) {
                true => rayon::iter::Either::Left(i),
                false => rayon::iter::Either::Right(i),
            });
        let mut lamps = Lamps { hidden, ..Lamps::default() };
        if parts.is_empty() {
            return lamps;
        }
        lamps.is_part = vec![false; patches.fronts()];
        parts.iter().for_each(|&i| lamps.is_part[i] = true);
        let mut last: Option<&UnitTriangle> = None;
        for part in parts.chunk_by(|&i, &j| patches.triangle(i) == patches.triangle(j)) {
            let t = patches.triangle(part[0]);
            let triangle = &tracer.triangles()[t];
            lamps.count += usize::from(!last.is_some_and(|last| adjoin(last, triangle)));
            last = Some(triangle);
            let even =
                part.len() == patches.leaves(t) && part.iter().all(|&i| emission(i) == emission(part[0]));
            let whole = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
            let mut add = |corners: [[f64; 3]; 3], of: Range<usize>| {
                let exactly = |b: [f64; 3]| (0..3).map(|k| triangle.corners[k].as_dvec3() * b[k]).sum();
                let facing = Facing { corners: corners.map(exactly), normal: triangle.normal.as_dvec3() };
                let [a, b, c] = facing.corners;
                lamps.pieces.push(Piece {
                    footprint: Footprint {
                        corners: corners.map(|b| triangle.point(b.map(|x| x as f32))),
                        normal: triangle.normal,
                    },
                    facing,
                    area: 0.5 * (b - a).cross(c - a).length(),
                    brightness: brightness(of.start),
                    patches: of,
                    lamp: lamps.count - 1,
                });
            };
            if even {
                add(whole, part[0]..part[0] + part.len());
            } else {
                part.iter().for_each(|&i| add(patches.barycentric_corners(i), i..i + 1));
            }
        }
        if lamps.pieces.len() > Constants::MOST_KNOWN {
            let of =
                |piece: &Piece| (piece.facing.corners, piece.facing.normal, piece.brightness * piece.area);
            lamps.tree = Some(Tree::new(lamps.pieces.iter().map(of)));
        }
        lamps
    }

    /// How many pieces there are.
    pub(crate) fn pieces(&self) -> usize {
        self.pieces.len()
    }

    /// Whether there is none.
    pub(crate) fn is_empty(&self) -> bool {
        self.pieces.is_empty()
    }

    /// Whether patch `i` is a part of a lamp.
    #[inline]
    pub(crate) fn contains(&self, i: usize) -> bool {
        self.is_part.get(i).copied().unwrap_or(false)
    }

    /// Whether patch `i` emits behind another face at the same place.
    pub(crate) fn hides(&self, i: usize) -> bool {
        self.hidden.binary_search(&i).is_ok()
    }

    /// Whether it is known what each piece would send to a patch if nothing stood between: where they are not too many.
    pub(super) fn are_known(&self) -> bool {
        self.tree.is_none()
    }

    /// What decides which samples a patch takes of the lamps.
    pub(crate) fn digest(&self) -> u64 {
        let words = self
            .pieces
            .iter()
            .map(|p| mix(&[p.patches.start as u64, p.patches.end as u64, p.brightness.to_bits()]));
        mix(&words.collect::<Vec<_>>())
    }

    /// The form factor of a patch to each piece if nothing stands between, where [they are known](Self::are_known).
    pub(super) fn unoccluded_into(&self, tracer: &Tracer, patches: &Patches, i: usize, found: &mut [f64]) {
        // Of the whole patch: rays keep away from the edges of its triangle.
        let triangle = &tracer.triangles()[patches.triangle(i)];
        let exactly = |b: [f64; 3]| (0..3).map(|k| triangle.corners[k].as_dvec3() * b[k]).sum();
        let normal = triangle.side_normal(patches.is_front(i)).as_dvec3();
        let patch = Facing { corners: patches.barycentric_corners(i).map(exactly), normal };
        for (found, piece) in found.iter_mut().zip(&self.pieces) {
            *found = form_factor(&patch, &piece.facing);
        }
    }

    /// How a patch, of which the form factors to each piece are known or not, chooses among them; `None` where no light can come.
    ///
    /// By what would arrive, and some of all lamps alike: a dim one may be all the light there is behind a door.
    pub(super) fn choice(&self, from: &Footprint, unoccluded: &[f64]) -> Option<Choice<'_>> {
        if let Some(tree) = &self.tree {
            let middle = (from.corners[0] + from.corners[1] + from.corners[2]) / 3.0;
            let radius = from.corners.iter().map(|c| c.distance(middle)).fold(0.0, f32::max);
            return Some(Choice::Tree(tree, middle.as_dvec3(), radius.into(), from.normal.as_dvec3()));
        }
        let shares = self.shares(unoccluded)?;
        let mut cumulative = 0.0;
        let sums = shares.into_iter().map(|share| {
            cumulative += share;
            cumulative
        });
        Some(Choice::Table(sums.collect()))
    }

    /// The probability of each piece to be chosen, where they are few; `None` where no light can come.
    pub(super) fn shares(&self, unoccluded: &[f64]) -> Option<Vec<f64>> {
        let arriving =
            || self.pieces.iter().zip(unoccluded).map(|(piece, f)| (piece.lamp, piece.brightness * f));
        let mut of_lamps = vec![0.0; self.count];
        arriving().for_each(|(lamp, light)| of_lamps[lamp] += light);
        let sum: f64 = of_lamps.iter().sum();
        let many = of_lamps.iter().filter(|&&light| light > 0.0).count() as f64;
        let alike = if many <= 2.0 { Constants::ALIKE_OF_TWO } else { Constants::ALIKE };
        let share = |(lamp, light): (usize, f64)| {
            let of_alike = if light > 0.0 { light / of_lamps[lamp] / many } else { 0.0 };
            (1.0 - alike) * light / sum + alike * of_alike
        };
        (sum > 0.0).then(|| arriving().map(share).collect())
    }

    /// A path from a patch to a lamp for a point of the unit hypercube; `None` where the two points do not face each other.
    #[inline]
    pub(super) fn sample(
        &self,
        choice: &Choice<'_>,
        from: &Footprint,
        [x, y, u, v]: [f32; 4],
    ) -> Option<Path> {
        let (k, u, probability) = match choice {
            Choice::Table(cumulative) => {
                let end = cumulative[cumulative.len() - 1];
                let u = f64::from(u) * end;
                let k = cumulative.partition_point(|&c| c <= u).min(cumulative.len() - 1);
                let below = if k > 0 { cumulative[k - 1] } else { 0.0 };
                let share = cumulative[k] - below;
                (k, (u - below) / share, share / end)
            }
            Choice::Tree(tree, middle, radius, normal) => {
                tree.choose((*middle, *radius, *normal), f64::from(u))
            }
        };
        let piece = &self.pieces[k];
        let u = (u as f32).clamp(0.0, 1.0 - f32::EPSILON);
        let (p, q, weight) = piece.sample(from, [x, y, u, v])?;
        let weight = (weight / probability) as f32;
        (weight > 0.0 && weight.is_finite()).then(|| Path {
            from: Tracer::leave(p, from.normal),
            to: Tracer::leave(q, piece.footprint.normal),
            piece: k as u32,
            weight,
        })
    }
}
