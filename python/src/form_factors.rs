//! Form factors, kept to be solved with again.

use std::sync::Arc;

use numpy::{PyArray1, ToPyArray};
use pyo3::prelude::*;
use radiosity::{accuracy::error_bars::ErrorBars, form_factor::CompressedRows, patch::Patches, solve};

use crate::{
    arrays::Doubles,
    casting::Casting,
    run::run,
    scene::Scene,
    solution::{Answer, Solution},
};

struct Cast {
    patches: Patches,
    form_factors: radiosity::form_factor::FormFactors,
}

/// The form factors of the patches of a scene.
#[pyclass(frozen, module = "radiosity._radiosity")]
pub struct FormFactors {
    cast: Arc<Cast>,
}

/// Values, columns and starts of the rows of a matrix.
type Rows<'py> = (Doubles<'py>, Bound<'py, PyArray1<u32>>, Bound<'py, PyArray1<i64>>);

#[pymethods]
impl FormFactors {
    /// The light of a scene of the same geometry.
    fn solve(
        &self,
        py: Python<'_>,
        scene: &Scene,
        casting: Casting,
        threads: Option<usize>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Solution> {
        let (cast, data) = (Arc::clone(&self.cast), Arc::clone(&scene.data));
        data.check_lit()?;
        let options = casting.solve_options()?;
        let answer = run(py, progress, threads, move |progress| {
            let mut patches = cast.patches.clone();
            patches.update_materials(data.lambertian());
            let scene = (data.lambertian(), data.tracer());
            let solution = solve::solve_linear(scene, &cast.form_factors, &patches, &options, progress)?;
            let bars = ErrorBars::of(&cast.form_factors, &patches, &solution).expect("rays were cast");
            Ok(Answer::of_light(data, patches, &cast.form_factors, solution, bars))
        })?;
        Ok(Solution { answer: Arc::new(answer) })
    }

    /// The matrix F_ij row by row.
    fn rows<'py>(&self, py: Python<'py>) -> PyResult<Rows<'py>> {
        let cast = Arc::clone(&self.cast);
        let rows = run(py, None, None, move |_| Ok(cast.form_factors.to_compressed_rows()))?;
        let CompressedRows { starts, columns, values, .. } = rows;
        let starts = starts.into_iter().map(|start| start as i64).collect();
        Ok((PyArray1::from_vec(py, values), PyArray1::from_vec(py, columns), PyArray1::from_vec(py, starts)))
    }

    #[getter]
    fn patches(&self) -> usize {
        self.cast.patches.len()
    }

    #[getter]
    fn area<'py>(&self, py: Python<'py>) -> Doubles<'py> {
        self.cast.form_factors.areas().to_pyarray(py)
    }

    #[getter]
    fn escaped<'py>(&self, py: Python<'py>) -> Doubles<'py> {
        self.cast.form_factors.escaped().to_pyarray(py)
    }

    #[getter]
    fn rays(&self) -> u64 {
        self.cast.form_factors.rays()
    }
}

/// Casts the form factors of a scene.
#[pyfunction]
pub fn form_factors(
    py: Python<'_>,
    scene: &Scene,
    casting: Casting,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<FormFactors> {
    let data = Arc::clone(&scene.data);
    let job = casting.job(&data)?;
    let cast = run(py, progress, threads, move |progress| {
        let (patches, form_factors) = job.cast(&data, progress)?;
        Ok(Cast { patches, form_factors })
    })?;
    Ok(FormFactors { cast: Arc::new(cast) })
}
