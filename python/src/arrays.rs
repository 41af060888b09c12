//! Arrays of numpy to and from lists.
//!
//! The package hands over arrays that are contiguous and of the right type. Arrays go back flat; the package gives them their
//! shape, which copies nothing.

use numpy::{PyArray1, PyReadonlyArrayDyn, ToPyArray};
use pyo3::prelude::*;
use radiosity::glam::DVec3;

/// Flat, of double precision.
pub type Doubles<'py> = Bound<'py, PyArray1<f64>>;

/// The values of an array in threes.
pub fn triples(array: &PyReadonlyArrayDyn<'_, f64>) -> PyResult<Vec<[f64; 3]>> {
    Ok(array.as_slice()?.as_chunks().0.to_vec())
}

/// The points of an array.
pub fn points(array: &PyReadonlyArrayDyn<'_, f64>) -> PyResult<Vec<DVec3>> {
    Ok(triples(array)?.into_iter().map(DVec3::from).collect())
}

/// Points as an array.
pub fn from_points<'py>(py: Python<'py>, points: impl Iterator<Item = DVec3>) -> Doubles<'py> {
    let flat: Vec<[f64; 3]> = points.map(|p| p.to_array()).collect();
    PyArray1::from_vec(py, flat.into_flattened())
}

/// Interleaved values of 1 or 3 channels as an array of three: a grey value counts for all.
pub fn from_channels<'py>(py: Python<'py>, values: &[f64], channels: usize) -> Doubles<'py> {
    if channels == 3 {
        return values.to_pyarray(py);
    }
    PyArray1::from_vec(py, values.iter().flat_map(|&grey| [grey; 3]).collect())
}
