//! What a ray is asked: which triangle it meets first, or whether it meets any on its way.

use super::watertight::Met;

/// A question to a ray, and what is known of the answer.
pub(super) trait Query: Default {
    /// What comes of it.
    type Answer;
    /// Triangles beyond this `t` do not matter.
    const LIMIT: f32;

    /// Takes note of a triangle met, by the scene's index. Returns the limit from now on.
    fn meet(&mut self, triangle: u32, met: Met) -> f32;

    /// The answer, once all that the limit left was met.
    fn answer(self) -> Self::Answer;
}

/// Whether the ray meets no triangle before `t` = 1.
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
        // A negative limit ends it: nothing is nearer.
        if self.blocked { -1.0 } else { 1.0 }
    }

    #[inline(always)]
    fn answer(self) -> bool {
        !self.blocked
    }
}

/// The first triangle that the ray meets: the nearest front and the nearest back so far.
///
/// Whatever the order in which they come: the lower index wins between equal distances.
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
        // A front wins against this back where it is farther by the roundings of both, each at most 1e-4 of t.
        front.min(back * 1.0003)
    }

    /// A ray that grazes the outline of a body meets a front and a back at distances that only rounding tells apart. It
    /// came from outside: the front counts.
    #[inline(always)]
    fn answer(self) -> Option<(u32, Met)> {
        match (self.front, self.back) {
            (Some(front), Some(back)) => {
                let slack = front.1.rounding() + back.1.rounding();
                Some(if front.1.t <= back.1.t + slack { front } else { back })
            }
            (front, back) => front.or(back),
        }
    }
}
