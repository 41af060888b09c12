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
    pub(super) line: Option<usize>,
    pub(super) message: String,
}

impl Wrong {
    pub(super) fn at(line: usize, message: impl Into<String>) -> Wrong {
        Wrong { line: Some(line), message: message.into() }
    }
}
