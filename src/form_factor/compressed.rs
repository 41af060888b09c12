//! The matrix of form factors row by row, for other programs.

use super::{FormFactors, Matrix};

/// F_ij row by row: the layout that SciPy and most other programs call CSR.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct CompressedRows {
    /// Where each row starts in the two other lists, and where the last one ends.
    pub starts: Vec<usize>,
    /// The columns j, in ascending order within a row.
    pub columns: Vec<u32>,
    /// F_ij.
    pub values: Vec<f64>,
}

impl FormFactors {
    /// All non-zero F_ij row by row. This takes 12 bytes for each, besides the form factors themselves. The light that comes
    /// straight from lamps is no part of it.
    pub fn to_compressed_rows(&self) -> CompressedRows {
        let rows: Matrix = self.rows().into_owned();
        let (starts, columns, stored) = rows.into_raw_storage();
        let mut values = Vec::with_capacity(stored.len());
        for i in 0..self.len() {
            let row = starts[i]..starts[i + 1];
            let of = |k: usize| self.left[i] * f64::from(stored[k]) * self.right[columns[k] as usize];
            values.extend(row.map(of));
        }
        CompressedRows { starts, columns, values }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Progress, Scene,
        form_factor::{CastOptions, Estimator},
        patch::{Patches, Subdivision},
        trace::Tracer,
    };

    #[test]
    fn rows_are_those_of_the_form_factors() {
        let scene = Scene::load("meshes/cornell-box.obj").unwrap();
        let tracer = Tracer::new(&scene);
        for estimator in [Estimator::Pooled, Estimator::OneWay] {
            let mut patches = Patches::subdivide(&scene, &Subdivision::Count(100));
            let options = CastOptions::default().with_rays(32.0).with_estimator(estimator);
            let cast = FormFactors::cast(&scene, &tracer, &mut patches, &options, &Progress::new());
            let form_factors = cast.unwrap();
            let CompressedRows { starts, columns, values } = form_factors.to_compressed_rows();
            assert_eq!((starts.len(), starts[patches.len()]), (patches.len() + 1, values.len()));
            for i in 0..patches.len() {
                let row: Vec<(usize, f64)> =
                    (starts[i]..starts[i + 1]).map(|k| (columns[k] as usize, values[k])).collect();
                assert_eq!(row, form_factors.row(i).collect::<Vec<_>>(), "row {i}");
                assert!(row.is_sorted_by_key(|&(j, _)| j));
            }
        }
    }
}
