//! What the outside world can do wrong.
//!
//! Bugs of the caller (an index out of range, vectors of different length) panic. Everything that a file, a
//! terminal or a disk can cause is an [`Error`].

use std::path::{Path, PathBuf};

/// An error caused by input, output or the user; never by a bug of the caller.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// A file was read but what it says cannot be used. Displays as `FILE:LINE: what is wrong`.
    #[error("{}{}: {message}", file.display(), line.map_or(String::new(), |l| format!(":{l}")))]
    Input {
        /// The file.
        file: PathBuf,
        /// The line, counted from 1, where one line is to blame.
        line: Option<usize>,
        /// What is wrong.
        message: String,
        /// What to do about it.
        hint: Option<String>,
    },
    /// An option or a combination of options that cannot be honoured.
    #[error("{message}")]
    Usage {
        /// What is wrong.
        message: String,
        /// What to do about it.
        hint: Option<String>,
    },
    /// The iteration stopped before it reached its tolerance.
    #[error(
        "{solver} did not converge: relative residual {residual:.3e} after {iterations} iterations, {tolerance:.1e} demanded"
    )]
    NotConverged {
        /// Name of the solver.
        solver: &'static str,
        /// Iterations done.
        iterations: usize,
        /// The true relative residual reached.
        residual: f64,
        /// The one demanded.
        tolerance: f64,
    },
    /// The scene has no equilibrium: all light stays in it for ever.
    #[error("the scene has no equilibrium: it is closed, it emits, and nothing in it absorbs")]
    NoEquilibrium,
    /// Surfaces that were said to enclose a room let light out, or show it their backs.
    #[error("the view factors of surface {surface} sum to {sum:.4}: the surfaces do not enclose a room")]
    NotEnclosed {
        /// Index of the surface that is off most.
        surface: usize,
        /// The sum of its row.
        sum: f64,
    },
    /// [`Progress::stop`](crate::Progress::stop) was called.
    #[error("stopped")]
    Stopped,
}

impl Error {
    /// An [`Error::Input`] for `file`, at `line` where one line is to blame.
    pub fn input(file: &Path, line: Option<usize>, message: impl Into<String>) -> Self {
        Error::Input { file: file.to_owned(), line, message: message.into(), hint: None }
    }

    /// An [`Error::Io`] for `path`.
    pub fn io(path: &Path, source: std::io::Error) -> Self {
        Error::Io { path: path.to_owned(), source }
    }

    /// The same error with advice for the user, where the error can carry one.
    pub fn with_hint(mut self, advice: impl Into<String>) -> Self {
        if let Error::Input { hint, .. } | Error::Usage { hint, .. } = &mut self {
            *hint = Some(advice.into());
        }
        self
    }

    /// What to do about it, where something helps.
    pub fn hint(&self) -> Option<&str> {
        match self {
            Error::Input { hint, .. } | Error::Usage { hint, .. } => hint.as_deref(),
            Error::NotConverged { .. } => Some("raise the tolerance, or choose another solver"),
            Error::NoEquilibrium => Some("give a material a reflectance below 1, or open the scene"),
            _ => None,
        }
    }
}

/// A result with [`Error`].
pub type Result<T> = std::result::Result<T, Error>;
