//! Direct light: the irradiance that comes straight from lamps.
//!
//! With R what surfaces reflect, E = D + F R: the light of lamps is a vector D, for which no matrix is needed. Every patch casts
//! [shadow rays](shadow) to points on [lamps], chosen nearly by what would arrive; [`irradiance`] makes light of them.

pub(crate) mod footprint;
mod irradiance;
mod lamps;
pub(crate) mod moments;
mod remote;
mod shadow;
mod solid_angle;
mod tree;
mod unoccluded;

pub(crate) use irradiance::{Deviation, DirectLight};
pub(crate) use lamps::{Lamps, adjoin};
pub(crate) use shadow::{Keep, ShadowRay, ShadowRays};

/// Parts that the rays of each patch are divided into. The standard error then has 15 degrees of freedom; with 4 parts
/// intervals of two standard errors held only 85 % of patches, with 16 about 94 %.
pub const REPLICATES: usize = 16;

/// The rays of a replicate: as many as of any other, or one more.
pub(crate) fn part(rays: u32, replicate: usize) -> std::ops::Range<usize> {
    let start = |k: usize| k * rays as usize / REPLICATES;
    start(replicate)..start(replicate + 1)
}

/// What was tried, and chosen.
pub(crate) struct Constants;

impl Constants {
    /// More triangles than this are chosen by a tree, and what they would send unblocked is not known: each costs about as much as a
    /// tenth of a ray, at every patch.
    pub(crate) const MOST_KNOWN: usize = 256;
    /// Share of the choices that all lamps get alike, where they are few: the others go by what would arrive. Of two rooms side by side,
    /// whose lamps differed ten thousand times, the dim one was dark without it.
    const ALIKE: f64 = 0.25;
    /// The same of two lamps: each half of the fewest rays, 16, then has a sample of either, since a quarter of a stratified sequence
    /// is never missed by 8.
    const ALIKE_OF_TWO: f64 = 0.5;
    /// Share of the choices in a tree that goes by power alone.
    const BY_POWER: f64 = 0.1;
    /// A triangle of less area than this share of the squared distance is far: its kernel differs by some percent from point to point.
    const FAR: f64 = 0.02;
    /// How many samples of a lamp what all lamps tell of visibility counts as.
    const SHARED: f64 = 1.0;
    /// A half of the rays that should have so many samples of a lamp is asked of that alone.
    const MANY: f64 = 1.0;
}
