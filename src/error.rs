//! Errors.
//!
//! A file, a terminal or a disk can cause an [`Error`]. A bug of the caller, such as an index out of range or vectors
//! of different lengths, causes a panic.

use std::path::{Path, PathBuf};

/// An error caused by input, output or settings.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// A file was read, but its contents cannot be used. The text is `FILE:LINE: message`.
    #[error("{}{}: {message}", file.display(), line.map_or(String::new(), |l| format!(":{l}")))]
    Input {
        /// The file.
        file: PathBuf,
        /// The line, counted from 1, if a single line is wrong.
        line: Option<usize>,
        /// What is wrong.
        message: String,
        /// What to do about it.
        hint: Option<String>,
    },
    /// Arrays that do not form a mesh, given to [`Scene::from_indexed`](crate::Scene::from_indexed).
    #[error(transparent)]
    Mesh(MeshError),
    /// A request that cannot be fulfilled.
    #[error("{message}")]
    Usage {
        /// What is wrong.
        message: String,
        /// What to do about it.
        hint: Option<String>,
    },
    /// Settings that cannot be combined, or that do not suit the scene.
    #[error("{message}")]
    Setting {
        /// The settings to change. A change of any one of them helps.
        settings: &'static [Setting],
        /// What is wrong.
        message: String,
        /// What to do about it.
        hint: Option<String>,
    },
    /// The iteration stopped before it reached its tolerance.
    #[error(
        "{solver} did not converge: the relative residual is {residual:.3e} after {iterations} iterations, but the tolerance is {tolerance:.1e}"
    )]
    NotConverged {
        /// Name of the solver.
        solver: &'static str,
        /// Number of iterations.
        iterations: usize,
        /// The relative residual after these iterations.
        residual: f64,
        /// The largest relative residual that is allowed.
        tolerance: f64,
    },
    /// The scene has no equilibrium: light enters it and never leaves it.
    #[error("the scene has no equilibrium: it is closed, it emits, and nothing in it absorbs")]
    NoEquilibrium,
    /// The caller declared that surfaces enclose a room, but rays leave the room or hit backs.
    #[error("the view factors of surface {surface} sum to {sum:.4}: the surfaces do not enclose a room")]
    NotEnclosed {
        /// Index of the surface whose row sum deviates most from 1.
        surface: usize,
        /// Its row sum.
        sum: f64,
    },
    /// A face stands before another one at a distance that the single precision of rays does not resolve.
    #[error(
        "triangles {} and {} are {width:.3e} apart, and rays resolve {resolved:.3e} there", triangles[0], triangles[1]
    )]
    UnresolvedGap {
        /// Indices of the two triangles in the scene.
        triangles: [u32; 2],
        /// How far apart they are, in the file's unit.
        width: f64,
        /// The narrowest gap that rays would resolve there.
        resolved: f64,
    },
    /// [`Progress::stop`](crate::Progress::stop) was called.
    #[error("stopped")]
    Stopped,
}

/// A setting of the caller. A program with its own names for settings can add these names to a hint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Setting {
    /// The file that keeps rays, [`Checkpoint`](crate::form_factor::Checkpoint).
    Checkpoint,
    /// Length of a texel of a lightmap, [`Layout::Texel`](crate::lightmap::Layout::Texel).
    TexelLength,
    /// Texels per side of a lightmap, [`Layout::Resolution`](crate::lightmap::Layout::Resolution).
    Resolution,
    /// The texture coordinates of a lightmap, [`Coordinates`](crate::lightmap::Coordinates).
    Coordinates,
    /// The algorithm for the linear system, [`Solver`](crate::solve::Solver).
    Solver,
    /// The estimator of form factors, [`Estimator`](crate::form_factor::Estimator).
    Estimator,
    /// Number or size of patches, [`Subdivision`](crate::patch::Subdivision).
    Patches,
    /// Width and height of a picture in pixels.
    PictureSize,
    /// Vertical angle of view of a camera.
    FieldOfView,
    /// The position of a camera.
    Eye,
    /// The point that a camera looks at.
    LookAt,
    /// The upward direction of a picture.
    Up,
}

/// An error in arrays that should form a mesh. Indices count from 0.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MeshError {
    /// A coordinate is infinite or not a number.
    #[error("vertex {vertex} has a coordinate that is not finite")]
    NotFinite {
        /// Index of the vertex.
        vertex: usize,
    },
    /// A face has fewer than three corners.
    #[error("face {face} has {corners} corners; a face needs at least three")]
    FewCorners {
        /// Index of the face.
        face: usize,
        /// Number of its corners.
        corners: usize,
    },
    /// A concave face has too many corners to be cut into triangles in reasonable time.
    #[error("face {face} is concave and has {corners} corners; at most 10000 are possible")]
    ManyCorners {
        /// Index of the face.
        face: usize,
        /// Number of its corners.
        corners: usize,
    },
    /// A face refers to a vertex that does not exist.
    #[error("face {face} refers to vertex {vertex}, but there are {vertices} vertices")]
    NoSuchVertex {
        /// Index of the face.
        face: usize,
        /// The index that is out of range.
        vertex: u32,
        /// Number of vertices.
        vertices: usize,
    },
    /// A face refers to a material that does not exist.
    #[error("face {face} refers to material {material}, but there are {materials} materials")]
    NoSuchMaterial {
        /// Index of the face.
        face: usize,
        /// The index that is out of range.
        material: u32,
        /// Number of materials.
        materials: usize,
    },
    /// The number of faces and the number of their materials differ.
    #[error("there are {faces} faces, but material indices for {given}")]
    MaterialOfFace {
        /// Number of faces.
        faces: usize,
        /// Number of material indices.
        given: usize,
    },
    /// A reflectance is outside 0 to 1.
    #[error("material `{material}`: reflectance {value} is outside 0..1")]
    Reflectance {
        /// Name of the material.
        material: String,
        /// The reflectance.
        value: f64,
    },
    /// A radiance is negative, too large or not a number.
    #[error("material `{material}`: radiance {value:?} is not a number from 0 to {most:e}")]
    Emission {
        /// Name of the material.
        material: String,
        /// The radiance.
        value: f64,
        /// The largest radiance that is allowed.
        most: f64,
    },
    /// A material has a texture, but arrays have no texture coordinates.
    #[error("material `{material}` has a texture, but the faces have no texture coordinates")]
    Texture {
        /// Name of the material.
        material: String,
    },
}

impl Error {
    /// Makes an [`Error::Input`] for `file`, at `line` if a single line is wrong.
    pub fn input(file: &Path, line: Option<usize>, message: impl Into<String>) -> Self {
        Error::Input { file: file.to_owned(), line, message: message.into(), hint: None }
    }

    /// Makes an [`Error::Io`] for `path`.
    pub fn io(path: &Path, source: std::io::Error) -> Self {
        Error::Io { path: path.to_owned(), source }
    }

    /// Makes an [`Error::Setting`] with advice for the user.
    pub(crate) fn setting(
        settings: &'static [Setting],
        message: impl Into<String>,
        hint: impl Into<String>,
    ) -> Self {
        Error::Setting { settings, message: message.into(), hint: Some(hint.into()) }
    }

    /// The settings to change. Empty if the error is not an [`Error::Setting`].
    pub fn settings(&self) -> &'static [Setting] {
        if let Error::Setting { settings, .. } = self { settings } else { &[] }
    }

    /// Adds advice for the user. Kinds of errors that have no field for a hint stay as they are.
    #[must_use]
    pub fn with_hint(mut self, advice: impl Into<String>) -> Self {
        if let Error::Input { hint, .. } | Error::Usage { hint, .. } | Error::Setting { hint, .. } = &mut self
        {
            *hint = Some(advice.into());
        }
        self
    }

    /// Advice for the user, if there is any.
    pub fn hint(&self) -> Option<&str> {
        match self {
            Error::Input { hint, .. } | Error::Usage { hint, .. } | Error::Setting { hint, .. } => {
                hint.as_deref()
            }
            Error::NotConverged { .. } => Some("raise the tolerance, or choose another solver"),
            Error::UnresolvedGap { .. } => Some(
                "single precision has seven digits: leave out what is far away, compute parts of the scene one by one, or \
                 join the two faces",
            ),
            Error::NoEquilibrium => Some("give a material a reflectance below 1, or open the scene"),
            _ => None,
        }
    }
}

/// A result with [`Error`].
pub type Result<T> = std::result::Result<T, Error>;
