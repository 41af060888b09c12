//! Targets of hemisphere rays, as numbers.

use crate::patch::Patches;

/// The target of a ray that left the scene.
pub const ESCAPED: u32 = u32::MAX;

/// Marks a target while casting: the ray hit the back of this front patch, and the back was not an unknown yet.
pub(super) const BACK: u32 = 1 << 31;

/// Names of patches that do not depend on the order in which backs are found: the number of the front, with a mark for
/// its back.
pub(crate) struct Names<'a> {
    patches: &'a Patches,
    /// The front of each back that is a patch.
    fronts: Vec<u32>,
}

impl<'a> Names<'a> {
    pub(crate) fn new(patches: &'a Patches) -> Self {
        let mut fronts = vec![0; patches.len() - patches.fronts()];
        for front in 0..patches.fronts() {
            if let Some(back) = patches.back_of(front) {
                fronts[back as usize - patches.fronts()] = front as u32;
            }
        }
        Names { patches, fronts }
    }

    pub(crate) fn lasting(&self, target: u32) -> u32 {
        match (target as usize).checked_sub(self.patches.fronts()) {
            Some(back) if target & BACK == 0 => BACK | self.fronts[back],
            _ => target,
        }
    }

    /// The number of a target among the present patches; `None` if there is no such patch.
    pub(super) fn present(&self, lasting: u32) -> Option<u32> {
        let front = (lasting & !BACK) as usize;
        match lasting {
            ESCAPED => Some(lasting),
            _ if front >= self.patches.fronts() => None,
            _ if lasting & BACK == 0 => Some(lasting),
            _ => Some(self.patches.back_of(front).unwrap_or(lasting)),
        }
    }
}
