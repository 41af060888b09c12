//! A distribution of intensity as in photometric files.

/// Largest number of directions in a file. It allows steps of half a degree.
pub(super) const MOST_DIRECTIONS: usize = 1 << 20;
/// The axes about which angles are measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Goniometer {
    /// The angle C selects a plane through the vertical axis. In the plane, γ is the angle from straight down.
    C,
    /// The vertical angle selects a plane through a horizontal axis. The lateral angle is measured in the plane.
    B,
    /// The lateral angle selects a plane through the vertical axis. The vertical angle is measured in the plane.
    A,
}

impl Goniometer {
    /// Warnings about angles that end where the goniometer does not: nothing is known beyond them.
    pub(super) fn missing(self, vertical: &[f64], horizontal: &[f64]) -> Vec<String> {
        let warning = |kind: &str, angles: &[f64], complete: &[(f64, f64)]| {
            let (first, last) = (angles[0], angles[angles.len() - 1]);
            (angles.len() > 1 && !complete.contains(&(first, last))).then(|| {
                format!(
                    "the {kind} angles run from {first} to {last}: the intensity beyond them is taken as 0"
                )
            })
        };
        let half = [(0.0, 90.0), (-90.0, 90.0)];
        let warnings = match self {
            Goniometer::C => {
                [warning("vertical", vertical, &[(0.0, 90.0), (0.0, 180.0), (90.0, 180.0)]), None]
            }
            Goniometer::A | Goniometer::B => [
                warning("vertical", vertical, &half),
                warning("horizontal", horizontal, &[half, [(0.0, 180.0), (-180.0, 180.0)]].concat()),
            ],
        };
        warnings.into_iter().flatten().collect()
    }
}

/// The luminous opening of a luminaire: a rectangle or an ellipse.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Opening {
    /// Size along C0, in metres.
    pub length: f64,
    /// Size along C90, in metres.
    pub width: f64,
    /// Whether it is an ellipse.
    pub round: bool,
}

/// The contents of a photometric file.
pub(super) struct Measured {
    pub(super) goniometer: Goniometer,
    pub(super) horizontal: Vec<f64>,
    pub(super) vertical: Vec<f64>,
    pub(super) candela: Vec<f64>,
    pub(super) stated_flux: Option<f64>,
    pub(super) opening: Option<Opening>,
    pub(super) warnings: Vec<String>,
}

/// An error in a text, and its line.
#[derive(Debug)]
pub(super) struct Wrong {
    pub(super) line: usize,
    pub(super) message: String,
}

impl Wrong {
    /// An error in a line, counted from 1. An empty file has a first line, too.
    pub(super) fn at(line: usize, message: impl Into<String>) -> Wrong {
        Wrong { line: line.max(1), message: message.into() }
    }
}

/// Whether planes of type C reach all round: the gap from the last to the first is no larger than the others.
pub(super) fn reach_all_round(planes: &[f64]) -> bool {
    // Files give angles with a few decimals.
    const ROUNDING: f64 = 0.01;
    let widest = planes.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max);
    planes.len() > 1 && planes[planes.len() - 1] - planes[0] + widest >= 360.0 - ROUNDING
}
