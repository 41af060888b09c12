//! Whether surfaces enclose a room, and where they do not, by what rays from each of them met.

use super::{Sight, most_open};

/// Whether surfaces enclose a room.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Enclosure {
    /// Every ray met the front of a surface.
    Closed,
    /// Some rays met no front, but no more of any surface than slip through cracks.
    Cracked,
    /// Surfaces lose more rays than that. This one loses the largest share.
    Open(usize),
}

impl Enclosure {
    /// By what rays from each surface met ([`look`](super::look)).
    pub fn of(seen: &[Sight]) -> Enclosure {
        match most_open(seen) {
            Some(surface) => Enclosure::Open(surface),
            None if seen.iter().any(|sight| sight.lost() > 0) => Enclosure::Cracked,
            None => Enclosure::Closed,
        }
    }
}

/// The surfaces that lose rays, in order of falling share.
pub fn leaks(seen: &[Sight]) -> Vec<usize> {
    let mut leaks: Vec<usize> = (0..seen.len()).filter(|&i| seen[i].lost() > 0).collect();
    leaks.sort_by(|&i, &j| seen[j].lost_share().total_cmp(&seen[i].lost_share()));
    leaks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_room_is_open_where_more_is_lost_than_slips_through_cracks() {
        let sight = |lost: u64| Sight { rays: 1_000_000, up: lost, ..Sight::default() };
        assert_eq!(Enclosure::of(&[sight(0), sight(0)]), Enclosure::Closed);
        assert_eq!(Enclosure::of(&[sight(0), sight(120)]), Enclosure::Cracked);
        let open = [sight(0), sight(200), sight(0), sight(3000)];
        assert_eq!(Enclosure::of(&open), Enclosure::Open(3));
        assert_eq!(leaks(&open), [3, 1]);
    }
}
