//! Queries: the first triangle that a ray hits, or whether it hits any.

use super::watertight::{MOST_ROUNDING, Met};

/// More than the distance of a front over the distance of a back that can be equal up to the rounding of both.
const FARTHER: f32 = 1.0 + 3.0 * MOST_ROUNDING;

/// A query, and the answer so far.
pub(super) trait Query: Default {
    /// The answer.
    type Answer;
    /// Triangles beyond this `t` do not matter.
    const LIMIT: f32;

    /// Takes a hit of the triangle with this index in the scene. Returns the new limit.
    fn meet(&mut self, triangle: u32, met: Met) -> f32;

    /// The answer, after all triangles within the limit. `rounding` bounds the rounding of a hit's distance.
    fn answer(self, rounding: impl Fn(&Met) -> f32) -> Self::Answer;
}

/// Whether the ray hits no triangle before `t` = 1.
#[derive(Default)]
pub(super) struct Free {
    blocked: bool,
}

impl Query for Free {
    type Answer = bool;
    const LIMIT: f32 = 1.0;

    #[inline(always)]
    fn meet(&mut self, _: u32, met: Met) -> f32 {
        self.blocked |= met.t < 1.0;
        // A negative limit ends the search: no triangle is nearer.
        if self.blocked { -1.0 } else { 1.0 }
    }

    #[inline(always)]
    fn answer(self, _: impl Fn(&Met) -> f32) -> bool {
        !self.blocked
    }
}

/// The first triangle that the ray hits: the nearest front and the nearest back so far.
///
/// The order of hits does not matter: between equal distances the lower index wins.
#[derive(Default)]
pub(super) struct Nearest {
    front: Option<(u32, Met)>,
    back: Option<(u32, Met)>,
}

impl Query for Nearest {
    type Answer = Option<(u32, Met)>;
    const LIMIT: f32 = f32::INFINITY;

    #[inline(always)]
    fn meet(&mut self, triangle: u32, met: Met) -> f32 {
        let slot = if met.front() { &mut self.front } else { &mut self.back };
        let nearer =
            |(other, nearest): &(u32, Met)| met.t < nearest.t || (met.t == nearest.t && triangle < *other);
        if slot.as_ref().is_none_or(nearer) {
            *slot = Some((triangle, met));
        }
        let t = |m: &Option<(u32, Met)>| m.as_ref().map_or(f32::INFINITY, |(_, met)| met.t);
        let (front, back) = (t(&self.front), t(&self.back));
        // A front wins against this back even if it is farther by the rounding of both.
        front.min(back * FARTHER)
    }

    /// A ray that grazes the outline of a body hits a front and a back at distances that differ only by rounding. It
    /// came from outside, so that the front counts.
    #[inline(always)]
    fn answer(self, rounding: impl Fn(&Met) -> f32) -> Option<(u32, Met)> {
        match (self.front, self.back) {
            (Some(front), Some(back)) => {
                let (t, limit) = (front.1.t, back.1.t);
                let is_front = t <= limit
                    || t <= limit * FARTHER && t <= limit + (rounding(&front.1) + rounding(&back.1));
                Some(if is_front { front } else { back })
            }
            (front, back) => front.or(back),
        }
    }
}
