//! Queries: the first triangle that a ray hits, or whether it hits any.

use super::watertight::{MOST_ROUNDING, Met, SLACK};

/// More than the distance of a front over the distance of a back that can be equal up to the rounding of both.
const FARTHER: f32 = 1.0 + 3.0 * MOST_ROUNDING;

/// A query, and the answer so far.
pub(super) trait Query: Default {
    /// The answer.
    type Answer;
    /// Triangles beyond this `t` do not matter.
    const LIMIT: f32;

    /// Takes a hit. Returns the new limit.
    fn meet(&mut self, met: Met) -> f32;

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
    fn meet(&mut self, met: Met) -> f32 {
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
pub(super) struct Nearest {
    front: Met,
    back: Met,
}

impl Default for Nearest {
    #[inline(always)]
    fn default() -> Self {
        Nearest { front: Met::NONE, back: Met::NONE }
    }
}

impl Query for Nearest {
    type Answer = Option<Met>;
    const LIMIT: f32 = f32::INFINITY;

    #[inline(always)]
    fn meet(&mut self, met: Met) -> f32 {
        let nearest = if met.front() { &mut self.front } else { &mut self.back };
        if met.is_before(nearest) {
            *nearest = met;
        }
        // A front wins against this back even if it is farther by the rounding of both. The box of an equal front may
        // be farther by rounding.
        (self.front.t * SLACK).min(self.back.t * FARTHER)
    }

    /// A ray that grazes the outline of a body hits a front and a back at distances that differ only by rounding. It
    /// came from outside, so that the front counts.
    #[inline(always)]
    fn answer(self, rounding: impl Fn(&Met) -> f32) -> Option<Met> {
        let Nearest { front, back } = self;
        let slack = || rounding(&front) + rounding(&back);
        let is_front = front.t <= back.t || front.t <= back.t * FARTHER && front.t <= back.t + slack();
        let nearest = if is_front { front } else { back };
        (nearest.t < f32::INFINITY).then_some(nearest)
    }
}
