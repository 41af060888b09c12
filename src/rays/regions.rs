//! Regions: parts of a scene that rays connect, such as the rooms of a house with open doors.
//!
//! Light does not pass between regions. So what counts as bright or as a large error is relative to the light of the
//! region. Relative to the light of all patches, a dim room beside a bright sealed one would get none of the rays that
//! variances distribute, and its rows would not be calibrated. Finer distinctions are worse: with errors relative to
//! the light that each patch sees, the error behind a door that is ajar is 30 to 60 % larger.

use super::{ESCAPED, RaySet};
use crate::patch::{DisjointSets, Patches};

/// The region of each patch.
#[derive(Debug, Clone)]
pub(crate) struct Regions {
    of: Vec<u32>,
    count: usize,
}

impl Regions {
    /// Regions that these rays connect. The patches on one side of a triangle are in the same region.
    pub(crate) fn new(rays: &RaySet, patches: &Patches) -> Regions {
        let mut sets = DisjointSets::new(rays.len());
        let side = |i: usize| (patches.triangle(i), patches.is_front(i));
        for i in 0..rays.len() {
            if i > 0 && side(i) == side(i - 1) {
                sets.unite(i - 1, i);
            }
            rays.of(i).iter().filter(|&&j| j != ESCAPED).for_each(|&j| sets.unite(i, j as usize));
        }
        let (of, count) = sets.numbers();
        Regions { of, count }
    }

    /// Number of regions.
    pub(crate) fn count(&self) -> usize {
        self.count
    }

    /// The region of patch `i`.
    pub(crate) fn of(&self, i: usize) -> usize {
        self.of[i] as usize
    }

    /// The mean of a value over the region of each patch, weighted by area.
    pub(crate) fn means(&self, areas: &[f64], value: impl Fn(usize) -> f64) -> Vec<f64> {
        let mut sums = vec![[0.0; 2]; self.count];
        for (i, &region) in self.of.iter().enumerate() {
            let [area, sum] = &mut sums[region as usize];
            *area += areas[i];
            *sum += areas[i] * value(i);
        }
        self.of.iter().map(|&region| sums[region as usize]).map(|[area, sum]| sum / area).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Patches 0 and 1 are one region, 2 and 3 another. The means are (1 · 1 + 3 · 5) / 4 and (1 · 2 + 1 · 4) / 2.
    #[test]
    fn means_are_those_of_the_region() {
        let regions = Regions { of: vec![0, 0, 1, 1], count: 2 };
        let means = regions.means(&[1.0, 3.0, 1.0, 1.0], |i| [1.0, 5.0, 2.0, 4.0][i]);
        assert_eq!(means, [4.0, 4.0, 3.0, 3.0]);
    }
}
