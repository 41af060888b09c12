//! A distribution of intensity as photometric files have it.

/// Most directions that a file may tell of: one every half degree.
pub(super) const MOST_DIRECTIONS: usize = 1 << 20;
/// The axes that angles are measured about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Goniometer {
    /// Planes through the vertical axis, by C; in them γ from straight down.
    C,
    /// Planes through a horizontal axis, by the vertical angle; in them the lateral angle.
    B,
    /// Planes through the vertical axis, by the lateral angle; in them the vertical angle.
    A,
}

/// The part of a luminaire that shines, in metres: a rectangle, or a disc where it is round.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Opening {
    /// Along C0.
    pub length: f64,
    /// Along C90.
    pub width: f64,
    /// Whether it is an ellipse.
    pub round: bool,
}

/// A distribution as a file has it.
pub(super) struct Measured {
    pub(super) goniometer: Goniometer,
    pub(super) horizontal: Vec<f64>,
    pub(super) vertical: Vec<f64>,
    pub(super) candela: Vec<f64>,
    pub(super) stated_flux: Option<f64>,
    pub(super) opening: Option<Opening>,
    pub(super) warnings: Vec<String>,
}

/// What is wrong in a text, and where.
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
