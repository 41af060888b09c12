//! Direct light: the irradiance that arrives straight from lamps.
//!
//! If R is the reflected radiosity, irradiance is E = D + F R. The direct light of lamps is a vector D and needs no
//! matrix. Every patch casts [shadow rays](shadow) to points on [lamps], chosen with probabilities close to their
//! contributions. [`irradiance`] turns the rays into irradiance.

pub(crate) mod brightness;
mod irradiance;
mod lamps;
pub(crate) mod moments;
mod remote;
mod shadow;
pub(crate) mod sky;
mod solid_angle;
mod tree;
mod unoccluded;

pub(crate) use irradiance::{Deviation, DirectLight};
pub(crate) use lamps::Lamps;
pub(crate) use shadow::ShadowRays;

/// Constants chosen by experiments.
pub(crate) struct Constants;

impl Constants {
    /// Up to this many triangles, the unblocked light of each is computed at every patch, for about the cost of a tenth
    /// of a ray each. Above it a tree chooses among them, and unblocked light is not known.
    pub(crate) const MOST_KNOWN: usize = 256;
    /// Share of the choices that is spread evenly over all lamps, if they are few. The rest follows the unblocked
    /// light. Without it, one of two neighbouring rooms was dark because its lamp was ten thousand times dimmer than
    /// the lamp of the other room.
    const ALIKE: f64 = 0.25;
    /// The same for two lamps. Each half of the fewest rays, 16, then has a sample of either lamp: 8 points of a
    /// stratified sequence never miss a quarter of it.
    const ALIKE_OF_TWO: f64 = 0.5;
    /// Share of the choices in a tree that follows power alone.
    const BY_POWER: f64 = 0.1;
    /// A triangle with less area than this share of the squared distance is far: its kernel varies only by some
    /// percent.
    const FAR: f64 = 0.02;
    /// Weight of the visibility of all lamps in the estimate for a single lamp, as a number of samples.
    const SHARED: f64 = 1.0;
    /// If half of the rays should have this many samples of a lamp, other lamps do not contribute to its visibility.
    const MANY: f64 = 1.0;
}
