//! Irradiance at points, and pictures.

use std::sync::Arc;

use numpy::{PyArray1, PyReadonlyArrayDyn};
use pyo3::{exceptions::PyValueError, prelude::*};
use radiosity::{
    Error, Progress,
    glam::DVec3,
    monte_carlo::{
        Camera, Effort, Estimate, Film, LightOptions, LightTracer, PathOptions, PathTracer, Receiver,
        RenderOptions,
    },
    output::{final_gather::FinalGather, picture},
    tone::Exposure,
};

use rayon::prelude::*;

use crate::{
    arrays::{self, Doubles},
    run::run,
    scene::{Data, Scene},
    solution::{Answer, Solution},
};

/// Where light comes from: traced paths, or a solution.
#[derive(FromPyObject)]
pub enum Source<'py> {
    Scene(PyRef<'py, Scene>),
    Solution(PyRef<'py, Solution>),
}

/// The same for a thread of its own.
enum Owned {
    Scene(Arc<Data>),
    Solution(Arc<Answer>),
}

impl Source<'_> {
    fn owned(&self) -> PyResult<Owned> {
        match self {
            Source::Scene(scene) => {
                scene.data.check_lit()?;
                Ok(Owned::Scene(Arc::clone(&scene.data)))
            }
            Source::Solution(solution) => Ok(Owned::Solution(Arc::clone(&solution.answer))),
        }
    }
}

/// Rays of the last bounce for each sample. One is enough: there are many samples, and each takes another direction.
const GATHER: u32 = 1;

/// Irradiance, its standard error, and which points lie below a surface or inside a solid.
type Probes<'py> = (Doubles<'py>, Doubles<'py>, Vec<usize>);

/// Irradiance at points.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
pub fn probe<'py>(
    py: Python<'py>,
    source: Source<'py>,
    points: PyReadonlyArrayDyn<'py, f64>,
    normals: PyReadonlyArrayDyn<'py, f64>,
    samples: Option<u32>,
    next_event: bool,
    seed: u64,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Probes<'py>> {
    let source = source.owned()?;
    let (points, normals) = (arrays::points(&points)?, arrays::points(&normals)?);
    let effort = Effort::default();
    let effort = effort.with_samples(samples.unwrap_or(effort.samples)).with_seed(seed);
    let (estimates, buried) = run(py, progress, threads, move |progress| {
        let data = match &source {
            Owned::Scene(data) => data,
            Owned::Solution(answer) => &answer.data,
        };
        let places = points.iter().zip(&normals);
        let places: Vec<Receiver> =
            places.map(|(&point, &normal)| Receiver::free(data.tracer(), point, normal)).collect();
        let estimates = match &source {
            Owned::Scene(data) => {
                let options = PathOptions::default().with_next_event(next_event);
                let paths = PathTracer::new(&data.given, data.tracer(), options);
                paths.irradiances(&places, &effort, progress)
            }
            Owned::Solution(answer) => {
                let Answer { data, patches, solution, .. } = &**answer;
                let gather = FinalGather::new(data.lambertian(), data.tracer(), patches, solution, GATHER);
                gather.irradiances(&places, &effort, progress)
            }
        }?;
        let is_buried = |&k: &usize| places[k].is_buried(data.tracer());
        let buried: Vec<usize> = (0..places.len()).into_par_iter().filter(is_buried).collect();
        Ok((estimates, buried))
    })?;
    let of = |part: fn(&Estimate) -> [f64; 3]| {
        arrays::from_points(py, estimates.iter().map(part).map(DVec3::from))
    };
    Ok((of(|e| e.mean), of(|e| e.standard_error), buried))
}

/// A camera; what is not given is chosen so that the scene fills the picture.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct View {
    width: usize,
    height: usize,
    eye: Option<[f64; 3]>,
    look_at: Option<[f64; 3]>,
    up: Option<[f64; 3]>,
    fov: Option<f64>,
}

impl View {
    /// The camera, and a warning if it sees only backs. One that sees nothing, or only backs without light, is refused.
    fn camera(&self, data: &Data) -> radiosity::Result<(Camera, Option<String>)> {
        let framed = Camera::frame(&data.given, data.tracer(), self.width, self.height)?;
        let or = |given: Option<[f64; 3]>, framed| given.map_or(framed, DVec3::from);
        let camera = Camera::new(
            or(self.eye, framed.eye()),
            or(self.look_at, framed.look_at()),
            or(self.up, framed.up()),
            self.fov.unwrap_or(framed.fov()),
            self.width,
            self.height,
        )?;
        let warning = camera.check(data.tracer())?;
        if let Some(warning) = &warning {
            let paths = PathTracer::new(&data.given, data.tracer(), PathOptions::default());
            if !camera.sees_light(&paths) {
                return Err(Error::Usage { message: format!("{warning}; no light gets there"), hint: None });
            }
        }
        Ok((camera, warning))
    }
}

/// How a picture is made.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Rendering {
    method: String,
    samples: u32,
    next_event: bool,
    final_gather: Option<u32>,
    seed: u64,
}

impl Rendering {
    fn film(
        &self,
        source: &Owned,
        view: &View,
        progress: &Progress,
    ) -> radiosity::Result<(Film, Option<String>)> {
        let options = RenderOptions::default().with_samples(self.samples).with_seed(self.seed);
        let data = match source {
            Owned::Solution(answer) => &answer.data,
            Owned::Scene(data) => data,
        };
        let (camera, warning) = view.camera(data)?;
        let film = match source {
            Owned::Solution(answer) => {
                let light = (&answer.patches, &answer.solution);
                let scene = data.lambertian();
                picture::render(scene, data.tracer(), light, &camera, self.final_gather, &options, progress)
            }
            Owned::Scene(_) if self.method == "light" => {
                let particles = (camera.width() * camera.height()) as u64 * u64::from(self.samples);
                let options = LightOptions::default().with_particles(particles).with_seed(self.seed);
                let light = LightTracer::new(&data.given, data.tracer(), options);
                light.image(&camera, progress).map(|image| image.film)
            }
            Owned::Scene(_) => {
                let paths = PathOptions::default().with_next_event(self.next_event);
                let paths = PathTracer::new(&data.given, data.tracer(), paths);
                Film::render(&paths, &camera, &options, progress)
            }
        }?;
        Ok((film, warning))
    }
}

/// Radiance of all pixels, row by row from the top, and a warning about the camera.
#[pyfunction]
pub fn render<'py>(
    py: Python<'py>,
    source: Source<'py>,
    view: View,
    rendering: Rendering,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(Bound<'py, PyArray1<f32>>, Option<String>)> {
    let source = source.owned()?;
    let (film, warning) =
        run(py, progress, threads, move |progress| rendering.film(&source, &view, progress))?;
    Ok((PyArray1::from_slice(py, film.pixels().as_flattened()), warning))
}

/// A picture of radiance as eight-bit sRGB. `white` is the radiance that is shown as white; chosen by the picture where `None`.
#[pyfunction]
pub fn to_srgb<'py>(
    py: Python<'py>,
    picture: PyReadonlyArrayDyn<'py, f64>,
    white: Option<f64>,
    stops: f64,
) -> PyResult<Bound<'py, PyArray1<u8>>> {
    if white.is_some_and(|white| !(white > 0.0 && white.is_finite())) {
        return Err(PyValueError::new_err("white: a radiance above 0 is wanted"));
    }
    let pixels: Vec<[f32; 3]> = arrays::triples(&picture)?.into_iter().map(|p| p.map(|x| x as f32)).collect();
    let film = Film::from_pixels(pixels.len(), 1, pixels);
    let exposure = white.map_or_else(|| film.automatic_exposure(), Exposure::of_white).brighter(stops);
    Ok(PyArray1::from_vec(py, film.to_srgb(exposure).into_flattened()))
}
