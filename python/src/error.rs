//! Errors of the library as exceptions.

use pyo3::{
    exceptions::{PyMemoryError, PyOSError, PyRuntimeError, PyValueError},
    prelude::*,
};
use radiosity::{Error, Setting};

/// The exception for an error: `OSError` where a file cannot be read or written, `RuntimeError` where an iteration did not
/// converge, else `ValueError`.
pub fn raise(error: Error) -> PyErr {
    let hint = error.hint().map(|hint| format!("; {hint}")).unwrap_or_default();
    match &error {
        Error::Io { path, source } => match source.raw_os_error() {
            // Python chooses the class by the number, for example FileNotFoundError.
            Some(number) => {
                let text = source.to_string();
                let text = text.split(" (os error").next().unwrap_or_default().to_owned();
                PyOSError::new_err((number, text, path.display().to_string()))
            }
            None => PyOSError::new_err(error.to_string()),
        },
        Error::NotConverged { .. } | Error::Stopped => PyRuntimeError::new_err(format!("{error}{hint}")),
        Error::Setting { settings, .. } => {
            // Users find the argument first.
            let names: Vec<&str> = settings.iter().map(|&setting| argument(setting)).collect();
            PyValueError::new_err(format!("{}: {error}{hint}", names.join(", ")))
        }
        _ => PyValueError::new_err(format!("{error}{hint}")),
    }
}

/// The argument of a setting that the library has named in an error.
fn argument(setting: Setting) -> &'static str {
    match setting {
        Setting::TexelLength => "texel",
        Setting::Resolution => "resolution",
        Setting::Coordinates => "uv",
        Setting::Solver => "solver",
        Setting::Estimator => "estimator",
        Setting::Patches => "patches",
        Setting::PictureSize => "width, height",
        Setting::FieldOfView => "fov",
        Setting::Eye => "eye",
        Setting::LookAt => "look_at",
        Setting::Up => "up",
        _ => "settings",
    }
}

/// The exception for a computation that needs more memory than there is.
pub fn too_large(what: &str, bytes: f64, available: f64) -> PyErr {
    const GIBIBYTE: f64 = (1u64 << 30) as f64;
    PyMemoryError::new_err(format!(
        "{what} need about {:.1} GiB of memory, and this machine has {:.1} GiB",
        bytes / GIBIBYTE,
        available / GIBIBYTE
    ))
}
