//! Solutions.

use std::{collections::HashMap, path::PathBuf, sync::Arc};

use numpy::{PyArray1, ToPyArray};
use pyo3::prelude::*;
use radiosity::{
    Progress,
    accuracy::{
        bias,
        discretisation::Discretisation,
        error_bars::{ErrorBars, relative_rms},
        refinement::Round,
        solved::Solved,
        survey::turned_lamps,
    },
    energy::EnergyLedger,
    form_factor::FormFactors,
    output::{
        exposure,
        file::OutputFile,
        gltf,
        ply::{self, PlyOptions},
        report::EnergyReport,
    },
    patch::Patches,
    tone::rgb,
};

use crate::{
    arrays::{self, Doubles},
    casting::{Casting, Job},
    run::run,
    scene::{Data, Scene},
};

/// The light on the patches of a scene, without the form factors that it was found with.
pub struct Answer {
    pub data: Arc<Data>,
    pub patches: Patches,
    pub solution: radiosity::solve::Solution,
    error_bars: ErrorBars,
    discretisation: Option<Discretisation>,
    energy: serde_json::Value,
    errors: Errors,
    rays: f64,
    /// Rays a patch, relative error and seconds after each round.
    rounds: Vec<(f64, f64, f64)>,
    /// What may be other than it was meant.
    warnings: Vec<String>,
}

/// Lamps that are inside out and are named, at most.
const MOST_TURNED: usize = 3;

/// Errors relative to the mean irradiance, where they are known.
#[derive(Default)]
struct Errors {
    sampling: Option<f64>,
    discretisation: Option<f64>,
    bias: Option<f64>,
    solver: Option<f64>,
}

impl Answer {
    /// The answer of a solution with all its errors.
    fn of(
        data: Arc<Data>,
        solved: Solved,
        rounds: &[Round],
        job: &Job,
        progress: &Progress,
    ) -> radiosity::Result<Answer> {
        let Solved { patches, form_factors, solution, error_bars } = solved;
        let discretisation = Discretisation::of(
            (data.lambertian(), data.tracer()),
            &form_factors,
            &patches,
            &solution,
            progress,
        )?;
        let bias = bias::relative(&form_factors, data.tracer(), &patches, &solution, &job.solve, progress)?;
        let mut answer = Answer::of_light(data, patches, &form_factors, solution, error_bars);
        answer.errors.bias = bias;
        answer.errors.discretisation = discretisation.as_ref().map(|d| d.relative);
        answer.discretisation = discretisation;
        answer.rounds = rounds.iter().map(|round| (round.rays, round.error, round.elapsed)).collect();
        answer.warnings.extend(answer.missed(job));
        Ok(answer)
    }

    /// Whether the wanted error was not reached: of sampling, or of the patches that it determined.
    fn missed(&self, job: &Job) -> Option<String> {
        let wanted = job.error?;
        let of_patches = self.errors.discretisation.filter(|_| job.search);
        let parts = [("sampling", self.errors.sampling), ("discretisation", of_patches)];
        let (name, error) = parts.into_iter().find_map(|(n, e)| Some((n, e.filter(|e| !(*e <= wanted))?)))?;
        Some(format!("the {name} error is {:.2} %, but {:.2} % was wanted", 100.0 * error, 100.0 * wanted))
    }

    /// The answer of a solution with the errors that cost nothing.
    pub fn of_light(
        data: Arc<Data>,
        patches: Patches,
        form_factors: &FormFactors,
        solution: radiosity::solve::Solution,
        error_bars: ErrorBars,
    ) -> Answer {
        let ledger = EnergyLedger::of(form_factors, &patches, &solution);
        let energy = EnergyReport {
            entered_standard_error: Some(rgb(&error_bars.of_entered)),
            escaped_standard_error: Some(rgb(&error_bars.of_escaped)),
            ..EnergyReport::of(&ledger)
        };
        let seen = patches.seen_areas(&solution.irradiance);
        let relative = |values: &[f64]| relative_rms(values, &solution.irradiance, &seen);
        let unit = relative(&vec![1.0; solution.irradiance.len()]);
        let errors = Errors {
            sampling: Some(relative(&error_bars.standard_error)),
            solver: Some(solution.error_bound * unit).filter(|x| x.is_finite() && unit > 0.0),
            ..Errors::default()
        };
        let turned = turned_lamps(data.lambertian(), data.tracer());
        let mut warnings: Vec<String> =
            turned.iter().take(MOST_TURNED).map(|lamp| lamp.warning(data.lambertian())).collect();
        let leak = ledger.relative_leak();
        if leak != 0.0 {
            warnings.push(format!(
                "{:.2} % of the light of lamps arrives nowhere, although no ray finds a way out of the scene: faces may be in each \
                 other's place",
                100.0 * leak
            ));
        }
        Answer {
            rays: form_factors.rays() as f64 / patches.len() as f64,
            energy: serde_json::to_value(energy).expect("a report is JSON"),
            data,
            patches,
            solution,
            error_bars,
            discretisation: None,
            errors,
            rounds: Vec::new(),
            warnings,
        }
    }
}

/// The light on the patches of a scene.
#[pyclass(frozen, module = "radiosity._radiosity")]
pub struct Solution {
    pub answer: Arc<Answer>,
}

impl Solution {
    fn channels<'py>(&self, py: Python<'py>, values: &[f64]) -> Doubles<'py> {
        arrays::from_channels(py, values, self.answer.patches.channels())
    }
}

#[pymethods]
impl Solution {
    #[getter]
    fn scene(&self) -> Scene {
        Scene { data: Arc::clone(&self.answer.data) }
    }

    #[getter]
    fn irradiance<'py>(&self, py: Python<'py>) -> Doubles<'py> {
        self.channels(py, &self.answer.solution.irradiance)
    }

    #[getter]
    fn radiosity<'py>(&self, py: Python<'py>) -> Doubles<'py> {
        self.channels(py, &self.answer.solution.radiosity)
    }

    #[getter]
    fn standard_error<'py>(&self, py: Python<'py>) -> Doubles<'py> {
        self.channels(py, &self.answer.error_bars.standard_error)
    }

    /// Two slopes for each patch and channel, where light is linear.
    #[getter]
    fn slopes<'py>(&self, py: Python<'py>) -> Option<Doubles<'py>> {
        let Answer { patches, solution, .. } = &*self.answer;
        let slopes = &solution.linear.as_ref()?.slopes;
        let grey = patches.channels() == 1;
        let all = slopes.iter().flat_map(|&of| std::iter::repeat_n(of, if grey { 3 } else { 1 }));
        Some(PyArray1::from_vec(py, all.flatten().collect()))
    }

    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.answer.warnings.clone()
    }

    #[getter]
    fn discretisation<'py>(&self, py: Python<'py>) -> Option<Doubles<'py>> {
        self.answer.discretisation.as_ref().map(|d| self.channels(py, &d.error))
    }

    #[getter]
    fn reflectance<'py>(&self, py: Python<'py>) -> Doubles<'py> {
        self.channels(py, self.answer.patches.reflectance())
    }

    #[getter]
    fn emission<'py>(&self, py: Python<'py>) -> Doubles<'py> {
        self.channels(py, self.answer.patches.emission())
    }

    #[getter]
    fn area<'py>(&self, py: Python<'py>) -> Doubles<'py> {
        let patches = &self.answer.patches;
        PyArray1::from_vec(py, (0..patches.len()).map(|i| patches.area(i)).collect())
    }

    /// Number of patches of fronts, which come first.
    #[getter]
    fn fronts(&self) -> usize {
        self.answer.patches.fronts()
    }

    #[getter]
    fn triangle<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u64>> {
        let patches = &self.answer.patches;
        PyArray1::from_vec(py, (0..patches.len()).map(|i| patches.triangle(i) as u64).collect())
    }

    /// Vertices of the patches, each position once, and the corners of each patch among them.
    fn mesh<'py>(&self, py: Python<'py>) -> (Doubles<'py>, Bound<'py, PyArray1<u32>>) {
        let (patches, scene) = (&self.answer.patches, self.answer.data.lambertian());
        let (mut vertices, mut known) = (Vec::new(), HashMap::new());
        let corners = (0..patches.len()).flat_map(|i| patches.corners(scene, i));
        let faces = corners.map(|corner| {
            *known.entry((corner + 0.0).to_array().map(f64::to_bits)).or_insert_with(|| {
                vertices.push(corner);
                vertices.len() as u32 - 1
            })
        });
        let faces = faces.collect();
        (arrays::from_points(py, vertices.into_iter()), PyArray1::from_vec(py, faces))
    }

    #[getter]
    fn ledger(&self) -> String {
        self.answer.energy.to_string()
    }

    /// Sampling, discretisation, bias and solver.
    #[getter]
    fn errors(&self) -> [Option<f64>; 4] {
        let Errors { sampling, discretisation, bias, solver } = self.answer.errors;
        [sampling, discretisation, bias, solver]
    }

    #[getter]
    fn rays(&self) -> f64 {
        self.answer.rays
    }

    #[getter]
    fn rounds(&self) -> Vec<(f64, f64, f64)> {
        self.answer.rounds.clone()
    }

    #[getter]
    fn solver(&self) -> (&'static str, usize, f64) {
        let solution = &self.answer.solution;
        (solution.solver.name(), solution.iterations, solution.residual)
    }

    #[getter]
    fn of_mean<'py>(&self, py: Python<'py>) -> Doubles<'py> {
        rgb(&self.answer.error_bars.of_mean).to_pyarray(py)
    }

    /// Writes a mesh as the command `solve` does.
    fn save(&self, py: Python<'_>, path: PathBuf, backs: bool) -> PyResult<()> {
        let answer = Arc::clone(&self.answer);
        run(py, None, None, move |_| {
            let Answer { data, patches, solution, error_bars, .. } = &*answer;
            let (scene, exposure) = (data.lambertian(), exposure::of_radiosity(patches, &solution.radiosity));
            let file = OutputFile::new(&path, &[])?;
            file.check_inputs(&scene.files)?;
            let written = match path.extension().is_some_and(|e| e.eq_ignore_ascii_case("glb")) {
                true => file.write(|out| {
                    gltf::vertex_colours::encode(out, scene, patches, solution.into(), exposure)
                }),
                false => file.write(|out| {
                    let options = PlyOptions::default()
                        .with_standard_errors(Some(&error_bars.standard_error))
                        .with_discretisation(answer.discretisation.as_ref().map(|d| &d.error[..]))
                        .with_backs(backs)
                        .with_exposure(Some(exposure));
                    ply::encode(out, scene, patches, solution, &options)
                }),
            };
            written?.commit()
        })
    }
}

/// Solves a scene.
#[pyfunction]
pub fn solve(
    py: Python<'_>,
    scene: &Scene,
    casting: Casting,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Solution> {
    let data = Arc::clone(&scene.data);
    data.check_lit()?;
    let job = casting.job(&data)?;
    let answer = run(py, progress, threads, move |progress| {
        let (solved, rounds) = job.solved(&data, progress)?;
        Answer::of(data, solved, &rounds, &job, progress)
    })?;
    Ok(Solution { answer: Arc::new(answer) })
}
