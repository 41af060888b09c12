//! The lamps of a scene: emitting patches, joined where they have the same emission, and lights that are not surfaces.
//!
//! All kinds of lamps share an interface. [`Lamps::unoccluded_into`] gives the unblocked light at a patch.
//! [`Lamps::sample`] samples paths from points of the patch, each with the irradiance that it estimates. Visibility and
//! the estimate of irradiance are independent of the kind of lamp.

use std::ops::Range;

use glam::Vec3A;

use super::{
    Constants,
    remote::Remote,
    solid_angle,
    tree::Tree,
    unoccluded::{Facing, form_factor, moments, of_cells},
};
use crate::{
    parallel::magnitude,
    patch::Patches,
    rays::{
        footprint::{Footprint, is_hidden, kernel},
        siblings::adjoin,
    },
    scene::{
        Scene,
        light::{Lights, SKY, Sky},
    },
    slopes::{CELLS, MODES},
    trace::{
        Tracer, UnitTriangle,
        sampling::{mix, square_to_triangle},
    },
};
use rayon::prelude::*;

/// A source of samples: a part of a surface, or a light that is not a surface.
#[derive(Debug, Clone)]
pub(super) struct Piece {
    source: Source,
    /// Radiosity of a surface, irradiance or intensity of another light, summed over channels.
    pub(super) brightness: f64,
    /// Index of its lamp. Coplanar triangles that follow each other in the file and share a corner form one lamp.
    pub(super) lamp: usize,
}

#[derive(Debug, Clone)]
enum Source {
    Surface(Surface),
    /// The light, and its colour.
    Remote(Remote, [f64; 3]),
}

/// A triangle of constant emission: a patch, or all patches of a triangle.
#[derive(Debug, Clone)]
struct Surface {
    /// Where its light leaves.
    footprint: Footprint,
    facing: Facing,
    /// Area in unit space.
    area: f64,
    /// Its front patches.
    patches: Range<usize>,
}

/// The lamps of a scene.
#[derive(Debug, Clone, Default)]
pub(crate) struct Lamps {
    pub(super) pieces: Vec<Piece>,
    /// Number of lamps that the pieces form.
    pub(super) count: usize,
    /// Whether each front patch is a part of a lamp; empty if none is.
    is_part: Vec<bool>,
    /// Patches that emit behind another face at the same place, sorted. Their light cannot be seen.
    hidden: Vec<usize>,
    /// Number of pieces of surfaces, which come first.
    surfaces: usize,
    /// Chooses among many surfaces.
    tree: Option<Tree>,
    /// The names of the lights that the pieces after those of surfaces belong to.
    names: Vec<String>,
    /// The sky, whose light arrives by hemisphere rays.
    pub(crate) sky: Option<Sky>,
}

/// A path between a point of a patch and a point of a lamp, both moved off their surfaces. The weight is the irradiance
/// per brightness of the piece that this sample estimates if the path is free.
pub(super) struct Path {
    pub(super) from: Vec3A,
    pub(super) to: Vec3A,
    pub(super) piece: u32,
    pub(super) weight: f32,
}

/// How a patch chooses among the pieces.
pub(super) enum Choice<'a> {
    /// By the cumulative probabilities of the pieces.
    Table(Vec<f64>),
    /// By a walk down a tree.
    Tree(Walk<'a>),
    /// With equal probability a surface by a walk, or another light by cumulative probabilities.
    Both(Walk<'a>, Vec<f64>),
}

/// A tree, and the patch that chooses: its centre, radius and normal.
pub(super) type Walk<'a> = (&'a Tree, (glam::DVec3, f64, glam::DVec3));

/// The mean of the light of some patches.
fn mean<const C: usize>(values: &[[f64; C]]) -> [f64; C] {
    std::array::from_fn(|c| values.iter().map(|v| v[c]).sum::<f64>() / values.len() as f64)
}

/// Cumulative sums.
fn cumulated(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut sum = 0.0;
    let sums = values.map(|value| {
        sum += value;
        sum
    });
    sums.collect()
}

/// Chooses an entry by cumulative probabilities with a number in \[0, 1). Also returns the rest of the number,
/// stretched to \[0, 1) again, and the probability of the choice.
#[inline]
fn chosen(cumulative: &[f64], u: f64) -> (usize, f64, f64) {
    let end = cumulative[cumulative.len() - 1];
    let u = u * end;
    let k = cumulative.partition_point(|&c| c <= u).min(cumulative.len() - 1);
    let below = if k > 0 { cumulative[k - 1] } else { 0.0 };
    let share = cumulative[k] - below;
    (k, (u - below) / share, share / end)
}

impl Piece {
    /// Its light by channel, in multiples of `unit`. The emission of patches is in that unit already.
    #[inline]
    pub(super) fn sent<const C: usize>(&self, emission: &[[f64; C]], unit: f64) -> [f64; C] {
        match &self.source {
            Source::Surface(surface) => mean(&emission[surface.patches.clone()]),
            Source::Remote(_, colour) => std::array::from_fn(|c| colour[c] / unit),
        }
    }

    /// Whether its light enters the scene from outside the patches.
    #[inline]
    pub(super) fn is_remote(&self) -> bool {
        matches!(self.source, Source::Remote(..))
    }

    /// Whether its unblocked light at a patch is known exactly.
    pub(super) fn is_known(&self) -> bool {
        match &self.source {
            Source::Surface(_) => true,
            Source::Remote(remote, _) => remote.is_known(),
        }
    }

    /// The unblocked irradiance of a patch, relative to its brightness.
    fn unoccluded(&self, patch: &Facing) -> f64 {
        match &self.source {
            Source::Surface(surface) => form_factor(patch, &surface.facing),
            Source::Remote(remote, _) => remote.unblocked(patch),
        }
    }

    /// The means over a patch of the basis functions times the unblocked relative irradiance; `None` if they are not
    /// known.
    pub(super) fn moments(&self, patch: &Facing) -> Option<[f64; MODES]> {
        match &self.source {
            Source::Surface(surface) => Some(moments(patch, &surface.facing)),
            // Their irradiance is constant.
            Source::Remote(Remote::Distant(_) | Remote::Cell(_), _) => Some([0.0; MODES]),
            Source::Remote(Remote::Point { .. }, _) => None,
        }
    }

    /// The unblocked relative irradiance of the cells of a patch; `None` if it is of the second degree.
    pub(super) fn of_cells(&self, patch: &Facing) -> Option<[f64; CELLS]> {
        match &self.source {
            Source::Surface(surface) => of_cells(patch, &surface.facing),
            Source::Remote(..) => None,
        }
    }

    /// A textured surface: its first patch and where its light leaves.
    pub(super) fn textured(&self, scene: &Scene, patches: &Patches) -> Option<(usize, &Footprint)> {
        let Source::Surface(surface) = &self.source else { return None };
        let first = surface.patches.start;
        let is_mapped = scene.material(patches.triangle(first)).emission_map.is_some();
        is_mapped.then_some((first, &surface.footprint))
    }

    /// A path between a patch and the piece, both ends moved off their surfaces, and the unblocked relative irradiance
    /// that this sample estimates.
    #[inline]
    fn sample(&self, from: &Footprint, point: [f32; 4]) -> Option<(Vec3A, Vec3A, f64)> {
        let (p, q, weight) = match &self.source {
            Source::Surface(surface) => {
                let (p, q, weight) = surface.sample(from, point)?;
                (p, surface.footprint.side.leave_towards(q, p), weight)
            }
            Source::Remote(remote, _) => remote.sample(from, point)?,
        };
        Some((from.side.leave_towards(p, q), q, weight))
    }
}

impl Surface {
    /// A path from the part of a patch in front of the piece to the part of the piece in front of the patch, and the
    /// unblocked form factor that it estimates; `None` if the points do not face each other. On a near piece, points
    /// are distributed evenly over the solid angle, so that the estimates hardly vary. On a far piece they are
    /// distributed evenly over the area, which is nearly the same.
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
                (direction.dot(from.normal().as_dvec3()), -direction.dot(own.normal().as_dvec3()));
            // In double precision: the point must be on the piece up to the rounding of the piece's own coordinates,
            // which may be much smaller than those of the patch.
            let height = (point - at[0]).dot(own.normal().as_dvec3());
            if cos <= 0.0 || cos_lamp <= 0.0 || height <= 0.0 {
                return None;
            }
            let q = point + direction * (height / cos_lamp);
            let weight = cos * solid_angle / std::f64::consts::PI / f64::from(of_piece.chosen);
            return Some((p, q.as_vec3a(), whole * weight));
        }
        let q = within(&corners, square_to_triangle(u, v));
        let facing = (q - p).dot(from.normal()) > 0.0 && (q - p).dot(own.normal()) < 0.0;
        let area = self.area * f64::from(of_piece.of_all);
        facing.then(|| (p, q, whole * area * f64::from(kernel(q - p, from.normal(), own.normal()))))
    }
}

/// The part of a triangle from which a point is chosen.
struct Part {
    /// Share of the triangle's area that is in front of the face.
    of_all: f32,
    /// Share of that area from which the point is chosen.
    chosen: f32,
}

/// Chooses one of the triangles that form the part of a triangle in front of a face, by area, with a number in \[0, 1).
/// Also returns the rest of the number, stretched to \[0, 1) again. Returns `None` if nothing is in front.
#[inline]
fn part_in_front(corners: &[Vec3A; 3], face: &Footprint, u: f32) -> Option<([Vec3A; 3], f32, Part)> {
    let heights = corners.map(|corner| (corner - face.corners[0]).dot(face.normal()));
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
    /// The front patches that `shine`, except hidden ones, and all lights that are not surfaces.
    pub(crate) fn new(
        tracer: &Tracer,
        patches: &Patches,
        lights: &Lights,
        shines: impl Fn(usize) -> bool + Sync,
    ) -> Lamps {
        let mut lamps = Lamps::of_surfaces(tracer, patches, shines);
        let of_list = lights
            .list
            .iter()
            .map(|light| (Remote::new(&light.kind, tracer), light.kind.colour(), &light.name[..]));
        let (bright, dim) = lights.sky.as_ref().map(Sky::split).unzip();
        let bright = bright.into_iter().flatten().map(|(cell, radiance)| (Remote::Cell(cell), radiance, SKY));
        for (remote, colour, name) in of_list.chain(bright) {
            let brightness = colour[..patches.channels()].iter().sum();
            if brightness > 0.0 {
                lamps.pieces.push(Piece {
                    source: Source::Remote(remote, colour),
                    brightness,
                    lamp: lamps.count,
                });
                lamps.count += 1;
                lamps.names.push(name.into());
            }
        }
        lamps.sky = dim;
        lamps
    }

    fn of_surfaces(tracer: &Tracer, patches: &Patches, shines: impl Fn(usize) -> bool + Sync) -> Lamps {
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
                let brightness = brightness(of.start);
                let surface = Surface {
                    footprint: Footprint {
                        corners: corners.map(|b| triangle.point(b.map(|x| x as f32))),
                        side: triangle.side(true),
                    },
                    facing,
                    area: 0.5 * (b - a).cross(c - a).length(),
                    patches: of,
                };
                lamps.pieces.push(Piece {
                    source: Source::Surface(surface),
                    brightness,
                    lamp: lamps.count - 1,
                });
            };
            if even {
                add(whole, part[0]..part[0] + part.len());
            } else {
                part.iter().for_each(|&i| add(patches.barycentric_corners(i), i..i + 1));
            }
        }
        lamps.surfaces = lamps.pieces.len();
        if lamps.surfaces > Constants::MOST_KNOWN {
            let of = |piece: &Piece| match &piece.source {
                Source::Surface(of) => (of.facing.corners, of.facing.normal, piece.brightness * of.area),
                Source::Remote(..) => unreachable!("only surfaces have been added"),
            };
            lamps.tree = Some(Tree::new(lamps.pieces.iter().map(of)));
        }
        lamps
    }

    /// The [`magnitude`] of the light of patches with this emission, other lights and the sky.
    pub(crate) fn magnitude(&self, emission: &[f64]) -> f64 {
        let mut values = vec![magnitude(emission)];
        values.retain(|_| emission.iter().any(|&b| b > 0.0));
        for piece in &self.pieces {
            if let Source::Remote(_, colour) = &piece.source {
                values.extend(colour);
            }
        }
        values.extend(self.sky.iter().flat_map(Sky::strongest));
        magnitude(&values)
    }

    /// The light of each piece by channel, in multiples of `unit`, as `emission` is. Lights with names in `dark` send
    /// none.
    pub(super) fn sent<const C: usize>(
        &self,
        emission: &[[f64; C]],
        unit: f64,
        dark: &[String],
    ) -> Vec<[f64; C]> {
        let is_dark = |k: usize| k >= self.surfaces && dark.contains(&self.names[k - self.surfaces]);
        let sent =
            |(k, piece): (usize, &Piece)| if is_dark(k) { [0.0; C] } else { piece.sent(emission, unit) };
        self.pieces.iter().enumerate().map(sent).collect()
    }

    /// Whether lights outside the patches are among the [pieces](Piece::is_remote).
    pub(crate) fn has_remote(&self) -> bool {
        self.pieces.len() > self.surfaces
    }

    /// Number of pieces.
    pub(crate) fn pieces(&self) -> usize {
        self.pieces.len()
    }

    /// Whether there are no pieces.
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

    /// Whether the unblocked light of each piece is computed for every patch: only if there are not too many.
    pub(super) fn are_known(&self) -> bool {
        self.tree.is_none() && self.pieces.len() - self.surfaces <= Constants::MOST_KNOWN
    }

    /// Whether there are so many surfaces that a tree chooses among them.
    pub(super) fn are_many(&self) -> bool {
        self.tree.is_some()
    }

    /// A digest of everything that affects the samples of lamps.
    pub(crate) fn digest(&self) -> u64 {
        let words = |piece: &Piece| match &piece.source {
            Source::Surface(Surface { patches, .. }) => {
                mix(&[patches.start as u64, patches.end as u64, piece.brightness.to_bits()])
            }
            Source::Remote(remote, _) => mix(&[mix(&remote.words()), piece.brightness.to_bits()]),
        };
        mix(&self.pieces.iter().map(words).collect::<Vec<_>>())
    }

    /// A whole patch. Unlike footprints, it is not inset from the edges of its triangle.
    pub(super) fn facing(&self, tracer: &Tracer, patches: &Patches, i: usize) -> Facing {
        let triangle = &tracer.triangles()[patches.triangle(i)];
        let exactly = |b: [f64; 3]| (0..3).map(|k| triangle.corners[k].as_dvec3() * b[k]).sum();
        let normal = triangle.side_normal(patches.is_front(i)).as_dvec3();
        Facing { corners: patches.barycentric_corners(i).map(exactly), normal }
    }

    /// The unblocked form factor of a patch to each piece, if [they are known](Self::are_known).
    pub(super) fn unoccluded_into(&self, tracer: &Tracer, patches: &Patches, i: usize, found: &mut [f64]) {
        let patch = self.facing(tracer, patches, i);
        for (found, piece) in found.iter_mut().zip(&self.pieces) {
            *found = piece.unoccluded(&patch);
        }
    }

    /// How a patch chooses among the pieces; `None` if no light can arrive. `unoccluded` holds its form factors if they
    /// are known.
    ///
    /// Most choices follow the unblocked light. Some are spread evenly over all lamps, because a dim one may be the
    /// only light behind a door.
    pub(super) fn choice(&self, from: &Footprint, unoccluded: &[f64]) -> Option<Choice<'_>> {
        if self.are_known() {
            return Some(Choice::Table(cumulated(self.shares(unoccluded)?.into_iter())));
        }
        let walk = self.tree.as_ref().map(|tree| {
            let middle = (from.corners[0] + from.corners[1] + from.corners[2]) / 3.0;
            let radius = from.corners.iter().map(|c| c.distance(middle)).fold(0.0, f32::max);
            (tree, (middle.as_dvec3(), radius.into(), from.normal().as_dvec3()))
        });
        if !self.has_remote() {
            return walk.map(Choice::Tree);
        }
        let mut found = vec![0.0; self.pieces.len()];
        let corners = from.corners.map(|corner| corner.as_dvec3());
        let patch = Facing { corners, normal: from.normal().as_dvec3() };
        let from = if walk.is_some() { self.surfaces } else { 0 };
        let asked = found[from..].iter_mut().zip(&self.pieces[from..]);
        asked.for_each(|(found, piece)| *found = piece.unoccluded(&patch));
        let others = self.shares(&found);
        match (walk, others) {
            (Some(walk), Some(shares)) => {
                Some(Choice::Both(walk, cumulated(shares[self.surfaces..].iter().copied())))
            }
            (Some(walk), None) => Some(Choice::Tree(walk)),
            (None, shares) => Some(Choice::Table(cumulated(shares?.into_iter()))),
        }
    }

    /// The probability of choosing each piece, if they are few; `None` if no light can arrive.
    pub(super) fn shares(&self, unoccluded: &[f64]) -> Option<Vec<f64>> {
        let arriving =
            || self.pieces.iter().zip(unoccluded).map(|(piece, f)| (piece.lamp, piece.brightness * f));
        let mut of_lamps = vec![0.0; self.count];
        arriving().for_each(|(lamp, light)| of_lamps[lamp] += light);
        let sum: f64 = of_lamps.iter().sum();
        let count = of_lamps.iter().filter(|&&light| light > 0.0).count() as f64;
        let alike = if count <= 2.0 { Constants::ALIKE_OF_TWO } else { Constants::ALIKE };
        let share = |(lamp, light): (usize, f64)| {
            let of_alike = if light > 0.0 { light / of_lamps[lamp] / count } else { 0.0 };
            (1.0 - alike) * light / sum + alike * of_alike
        };
        (sum > 0.0).then(|| arriving().map(share).collect())
    }

    /// Maps a point of the unit hypercube to a path from a patch to a lamp; `None` if the two ends do not face each
    /// other.
    #[inline]
    pub(super) fn sample(
        &self,
        choice: &Choice<'_>,
        from: &Footprint,
        [x, y, u, v]: [f32; 4],
    ) -> Option<Path> {
        let u = f64::from(u);
        let (k, u, probability) = match choice {
            Choice::Table(cumulative) => chosen(cumulative, u),
            Choice::Tree((tree, patch)) => tree.choose(*patch, u),
            Choice::Both((tree, patch), _) if u < 0.5 => {
                let (k, u, probability) = tree.choose(*patch, 2.0 * u);
                (k, u, 0.5 * probability)
            }
            Choice::Both(_, cumulative) => {
                let (k, u, probability) = chosen(cumulative, 2.0 * u - 1.0);
                (self.surfaces + k, u, 0.5 * probability)
            }
        };
        let piece = &self.pieces[k];
        let u = (u as f32).clamp(0.0, 1.0 - f32::EPSILON);
        let (from, to, weight) = piece.sample(from, [x, y, u, v])?;
        let weight = (weight / probability) as f32;
        (weight > 0.0 && weight.is_finite()).then_some(Path { from, to, piece: k as u32, weight })
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::trace::Side;

    /// Points on a lamp that is small beside the room are as exact as the lamp's own coordinates. Otherwise rays that leave
    /// them by the lamp's rounding could start behind the lamp.
    #[test]
    fn points_on_a_small_lamp_are_as_exact_as_the_lamp() {
        let normal = Vec3::new(0.03, -0.15, -0.99).normalize();
        let along = normal.cross(Vec3::X).normalize();
        let triangle = |middle: Vec3, normal: Vec3, size: f32| {
            let across = normal.cross(along);
            let corners =
                [middle - size * along, middle + size * along, middle + size * across].map(Vec3A::from);
            let reach = corners.iter().fold(Vec3A::ZERO, |reach, corner| reach.max(corner.abs()));
            Footprint { corners, side: Side::new(normal.into(), reach) }
        };
        let footprint = triangle(Vec3::new(1e-3, -2e-3, 1e-3), normal, 0.01);
        let [a, b, c] = footprint.corners.map(|corner| corner.as_dvec3());
        let facing = Facing { corners: [a, b, c], normal: footprint.normal().as_dvec3() };
        let area = 0.5 * (b - a).cross(c - a).length();
        let lamp = Surface { footprint, facing, area, patches: 0..1 };
        let from = triangle(0.06 * normal + 0.01 * along + Vec3::new(0.0, 0.0, -0.003), -normal, 0.02);
        let mut found = 0;
        for k in 0..256 {
            let point = [0.1, 0.37, 0.61, 0.83].map(|step: f32| (0.5 + step * k as f32).fract());
            let Some((_, q, _)) = lamp.sample(&from, point) else { continue };
            found += 1;
            let height = (q.as_dvec3() - a).dot(lamp.facing.normal).abs();
            // Half an ulp of each coordinate, and as much for the plane.
            let reach = q.as_dvec3().abs().max(a.abs());
            let rounding = f64::from(f32::EPSILON) * lamp.facing.normal.abs().dot(reach);
            assert!(height <= rounding, "{height:e} {rounding:e}");
        }
        assert!(found > 200, "{found}");
    }
}
