//! View factors between surfaces.

use std::sync::Arc;

use numpy::PyArray1;
use pyo3::{exceptions::PyValueError, prelude::*};
use radiosity::{
    Error, Progress,
    glam::DVec3,
    scene::surfaces::{By, Side, Surfaces},
    view_factor::{self, Share, Sight, ViewFactorOptions, look, most_open, view_factors_among},
};

use crate::{arrays::Doubles, run::run, scene::Scene};

/// View factors with the surfaces that they are of.
#[pyclass(frozen, module = "radiosity._radiosity")]
pub struct ViewFactors {
    surfaces: Arc<Surfaces>,
    found: view_factor::ViewFactors,
    enclosed: bool,
    warnings: Vec<String>,
}

/// How to compute them.
struct Wanted {
    error: f64,
    /// Whether the surfaces enclose a room, where the user says so.
    enclosed: Option<bool>,
    up: DVec3,
    seed: u64,
}

/// A share of backs among what is seen that is worth a word.
const MANY_BACKS: f64 = 0.01;

impl Wanted {
    /// Looks round, and then computes as the command `view-factors` does.
    fn compute(
        &self,
        surfaces: &Surfaces,
        progress: &Progress,
    ) -> radiosity::Result<(view_factor::ViewFactors, bool, Vec<String>)> {
        let Surfaces { list, obstacles, .. } = surfaces;
        let seen = look(list, obstacles, self.up);
        let all = seen.iter().fold(Sight::default(), |all, sight| all.and(*sight));
        let mut warnings = Vec::new();
        let backs = all.backs as f64 / (all.rays - all.up - all.down).max(1) as f64;
        // Obstacles count as backs, and are meant.
        if backs > MANY_BACKS && obstacles.is_empty() {
            warnings.push(format!(
                "{:.1} % of what surfaces see are backs, from which nothing comes; side=\"back\" turns all faces, side=\"both\" \
                 takes both sides",
                100.0 * backs
            ));
        }
        let options =
            ViewFactorOptions::default().with_error(self.error).with_up(self.up).with_seed(self.seed);
        let run =
            |enclosed: bool| view_factors_among(list, obstacles, &options.with_enclosed(enclosed), progress);
        let refused = |message: String| Error::Usage { message: format!("enclosed: {message}"), hint: None };
        if !self.enclosed.unwrap_or(all.lost() == 0) {
            return Ok((run(false)?, false, warnings));
        }
        if let Some(i) = most_open(&seen) {
            return Err(refused(format!(
                "the surfaces do not enclose a room: {} of {} rays left it or met backs from surface `{}`",
                seen[i].lost(),
                seen[i].rays,
                list[i].name
            )));
        }
        match run(true) {
            Err(Error::NotEnclosed { surface, sum }) if self.enclosed.is_some() => Err(refused(format!(
                "the surfaces do not enclose a room: the view factors of `{}` sum to {sum:.6}",
                list[surface].name
            ))),
            // No ray was lost, but a row sum deviates by more than chance explains.
            Err(Error::NotEnclosed { surface, sum }) => {
                warnings.push(format!(
                    "the view factors of `{}` sum to {sum:.6}, so no room is enclosed, though no ray was lost",
                    list[surface].name
                ));
                Ok((run(false)?, false, warnings))
            }
            found => Ok((found?, true, warnings)),
        }
    }
}

#[pymethods]
impl ViewFactors {
    /// All F_ij, and all standard errors, row by row.
    fn dense<'py>(&self, py: Python<'py>) -> (Doubles<'py>, Doubles<'py>) {
        let n = self.found.len();
        let (mut factors, mut errors) = (vec![0.0; n * n], vec![0.0; n * n]);
        for i in 0..n {
            for (j, factor, error) in self.found.entries(i) {
                (factors[i * n + j], errors[i * n + j]) = (factor, error);
            }
        }
        (PyArray1::from_vec(py, factors), PyArray1::from_vec(py, errors))
    }

    /// Values, standard errors, columns and starts of the rows.
    #[allow(clippy::type_complexity)]
    fn rows<'py>(
        &self,
        py: Python<'py>,
    ) -> (Doubles<'py>, Doubles<'py>, Bound<'py, PyArray1<u32>>, Bound<'py, PyArray1<i64>>) {
        let (mut factors, mut errors, mut columns, mut starts) = (vec![], vec![], vec![], vec![0]);
        for i in 0..self.found.len() {
            for (j, factor, error) in self.found.entries(i) {
                factors.push(factor);
                errors.push(error);
                columns.push(j as u32);
            }
            starts.push(columns.len() as i64);
        }
        (
            PyArray1::from_vec(py, factors),
            PyArray1::from_vec(py, errors),
            PyArray1::from_vec(py, columns),
            PyArray1::from_vec(py, starts),
        )
    }

    /// What no surface gets, and its standard error: all of it, what meets backs, what leaves upward and downward.
    fn lost<'py>(&self, py: Python<'py>, what: &str) -> PyResult<(Doubles<'py>, Doubles<'py>)> {
        let share: fn(&view_factor::Lost) -> Share = match what {
            "escaped" => |lost| lost.escaped,
            "backs" => |lost| lost.backs,
            "up" => |lost| lost.up,
            "down" => |lost| lost.down,
            other => return Err(PyValueError::new_err(format!("what: `{other}`"))),
        };
        let shares: Vec<Share> = self.found.lost.iter().map(share).collect();
        let of = |part: fn(&Share) -> f64| PyArray1::from_vec(py, shares.iter().map(part).collect());
        Ok((of(|share| share.value), of(|share| share.error)))
    }

    #[getter]
    fn area<'py>(&self, py: Python<'py>) -> Doubles<'py> {
        PyArray1::from_slice(py, self.found.areas())
    }

    #[getter]
    fn names(&self) -> Vec<String> {
        self.surfaces.list.iter().map(|surface| surface.name.clone()).collect()
    }

    #[getter]
    fn rays(&self) -> u64 {
        self.found.rays
    }

    #[getter]
    fn error(&self) -> f64 {
        self.found.error
    }

    #[getter]
    fn enclosed(&self) -> bool {
        self.enclosed
    }

    #[getter]
    fn warnings(&self) -> Vec<String> {
        let mut warnings = self.warnings.clone();
        let Surfaces { list, doubled, tiny, odd, .. } = &*self.surfaces;
        if *doubled > 0 {
            warnings.push(format!("left out {doubled} faces at the same place as earlier ones"));
        }
        if *tiny > 0 {
            warnings.push(format!("left out {tiny} triangles too small beside the scene"));
        }
        for (faces, what) in [
            (&odd.bent, "corners out of its plane: its triangles are taken as they are"),
            (&odd.turned, "an edge that runs the same way as its neighbour's: one of the two shows its back"),
        ] {
            if let Some((first, _)) = faces.first() {
                let more = if faces.len() > 1 {
                    format!(", as have {} more", faces.len() - 1)
                } else {
                    String::new()
                };
                warnings.push(format!("face {first} has {what}{more}"));
            }
        }
        if let Some(i) = self.found.hidden.iter().position(|&area| area > 0.0) {
            warnings.push(format!(
                "parts of surfaces, of `{}` for example, lie in the plane of smaller faces, which hide them",
                list[i].name
            ));
        }
        if let Some(&i) = self.found.overfull_rows().first() {
            warnings.push(format!(
                "the view factors of `{}` summed to {:.4} before they were closed: do faces cross or overlap?",
                list[i].name, self.found.row_sums[i]
            ));
        }
        warnings
    }
}

/// What one surface is, by the word for it.
fn by_word(word: &str, scene: &radiosity::Scene) -> PyResult<By> {
    let by = match word {
        "face" => By::Face,
        "group" => By::Group,
        "object" => By::Object,
        "material" => By::Material,
        _ => match word.strip_prefix("property:") {
            Some(name) if !name.is_empty() => By::Property(name.into()),
            _ => {
                return Err(PyValueError::new_err(format!(
                    "by: `{word}` is none of face, group, object, material, property:NAME"
                )));
            }
        },
    };
    let is_known = match &by {
        By::Group => scene.parts.iter().any(|part| part.group.is_some()),
        By::Object => scene.parts.iter().any(|part| part.object.is_some()),
        By::Property(name) => scene.parts.iter().any(|part| part.properties.iter().any(|(n, _)| n == name)),
        By::Face | By::Material => true,
    };
    if is_known { Ok(by) } else { Err(PyValueError::new_err(format!("by: no face has a {word}"))) }
}

/// View factors between the surfaces of a scene, among faces of materials that block alone.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
pub fn view_factors(
    py: Python<'_>,
    scene: &Scene,
    by: &str,
    side: &str,
    obstacles: Vec<String>,
    error: f64,
    enclosed: Option<bool>,
    up: [f64; 3],
    seed: u64,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<ViewFactors> {
    let whole = scene.data.whole();
    let by = by_word(by, whole)?;
    let side = match side {
        "front" => Side::Front,
        "back" => Side::Back,
        "both" => Side::Both,
        other => {
            return Err(PyValueError::new_err(format!("side: `{other}` is none of front, back, both")));
        }
    };
    let mut blocking = Vec::new();
    for name in &obstacles {
        let before = blocking.len();
        let of_name = whole.materials.iter().enumerate().filter(|(_, m)| m.name == *name);
        blocking.extend(of_name.map(|(k, _)| k as u32));
        if blocking.len() == before {
            return Err(PyValueError::new_err(format!("obstacles: no face has material `{name}`")));
        }
    }
    let surfaces = Arc::new(Surfaces::among(whole, &by, side, &blocking));
    if surfaces.list.is_empty() {
        return Err(PyValueError::new_err("surfaces: no face is a surface that is large enough"));
    }
    let wanted = Wanted { error, enclosed, up: up.into(), seed };
    let among = Arc::clone(&surfaces);
    let (found, enclosed, warnings) =
        run(py, progress, threads, move |progress| wanted.compute(&among, progress))?;
    Ok(ViewFactors { surfaces, found, enclosed, warnings })
}
