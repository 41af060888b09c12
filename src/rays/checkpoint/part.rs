//! Parts of the patches, each of which another process samples.

use std::{fmt, str::FromStr};

/// Patches that follow each other and belong to the same part: as many as share a record of the file. Parts take such
/// runs in turn, so that every part has about the same share of each surface.
pub(crate) const RUN: u32 = 32;

/// One of several equal parts of the patches. A process can cast the rays of one part alone.
///
/// ```
/// use radiosity::rays::Part;
///
/// let part: Part = "3/16".parse().unwrap();
/// assert_eq!((part.number(), part.count()), (3, 16));
/// assert!(Part::new(17, 16).is_none() && "0/4".parse::<Part>().is_err());
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Part {
    /// Counted from 1.
    number: u32,
    count: u32,
}

impl Part {
    /// All patches.
    pub const WHOLE: Part = Part { number: 1, count: 1 };

    /// Part `number` of `count`, counted from 1; `None` if there is no such part.
    pub fn new(number: u32, count: u32) -> Option<Part> {
        (1..=count).contains(&number).then_some(Part { number, count })
    }

    /// Number of this part, counted from 1.
    pub fn number(self) -> u32 {
        self.number
    }

    /// Number of parts.
    pub fn count(self) -> u32 {
        self.count
    }

    /// Whether the rays of this patch belong to the part.
    pub(super) fn contains(self, patch: u32) -> bool {
        patch / RUN % self.count == self.number - 1
    }
}

impl fmt::Display for Part {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "part {} of {}", self.number, self.count)
    }
}

impl FromStr for Part {
    type Err = &'static str;

    /// Reads a part like `3/16`.
    fn from_str(text: &str) -> Result<Part, Self::Err> {
        let (number, count) = text.split_once('/').ok_or("a part is two numbers, as in 3/16")?;
        let whole = |text: &str| text.parse().map_err(|_| "a part is two whole numbers, as in 3/16");
        Part::new(whole(number)?, whole(count)?).ok_or("parts are counted from 1, as in 3/16")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every patch belongs to one part, and parts differ by at most one run.
    #[test]
    fn parts_share_out_all_patches() {
        let patches = 1000;
        for count in 1..20 {
            let parts: Vec<Part> = (1..=count).map(|k| Part::new(k, count).unwrap()).collect();
            let owners = |patch: u32| parts.iter().filter(|part| part.contains(patch)).count();
            assert!((0..patches).all(|patch| owners(patch) == 1));
            let sizes = parts.iter().map(|part| (0..patches).filter(|&i| part.contains(i)).count() as u32);
            let (least, most) = sizes.fold((patches, 0), |(a, b), n| (a.min(n), b.max(n)));
            assert!(most - least <= RUN, "{count}: {least} to {most}");
        }
    }
}
