//! Lightmaps.

use std::sync::Arc;

use numpy::PyArray1;
use pyo3::{exceptions::PyValueError, prelude::*};
use radiosity::lightmap::{self, Atlas, AtlasOptions, BakeOptions, Coordinates, Layout, PAGE, Texel};

use crate::{
    arrays::Doubles,
    run::run,
    solution::{Answer, Solution},
};

/// A lightmap.
#[pyclass(frozen, module = "radiosity._radiosity")]
pub struct Lightmap {
    answer: Arc<Answer>,
    map: lightmap::Lightmap,
}

/// How to bake.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Baking {
    resolution: Option<usize>,
    texel: Option<f64>,
    coordinates: String,
    two_sided: bool,
    final_gather: Option<u32>,
    denoise: bool,
    dilate: bool,
    close_seams: bool,
    seed: u64,
}

/// Texels a side of a page, where nothing is said.
const RESOLUTION: usize = 512;

impl Baking {
    fn atlas(&self) -> PyResult<AtlasOptions> {
        let layout = match self.texel {
            Some(length) => Layout::Texel(length, self.resolution.unwrap_or(PAGE)),
            None => Layout::Resolution(self.resolution.unwrap_or(RESOLUTION)),
        };
        let coordinates = match self.coordinates.as_str() {
            "auto" => Coordinates::Auto,
            "keep" => Coordinates::File,
            "new" => Coordinates::New,
            other => {
                return Err(PyValueError::new_err(format!("uv: `{other}` is none of auto, keep, new")));
            }
        };
        Ok(AtlasOptions::new(layout, coordinates))
    }

    fn options(&self) -> BakeOptions {
        let default = BakeOptions::default();
        default
            .with_final_gather(self.final_gather.unwrap_or(default.final_gather))
            .with_denoise(self.denoise)
            .with_dilate(self.dilate)
            .with_close_seams(self.close_seams)
            .with_seed(self.seed)
    }
}

/// Bakes the light of a solution.
#[pyfunction]
pub fn bake(
    py: Python<'_>,
    solution: &Solution,
    baking: Baking,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Lightmap> {
    let answer = Arc::clone(&solution.answer);
    let (mut layout, options) = (baking.atlas()?, baking.options());
    let map = run(py, progress, threads, move |progress| {
        let Answer { data, patches, solution, .. } = &*answer;
        let (scene, tracer) = (data.lambertian(), data.tracer());
        if baking.two_sided {
            layout.two_sided = lightmap::lit_on_both_sides(patches, solution);
        }
        let atlas = Atlas::with(scene, tracer, &layout)?;
        lightmap::bake(scene, tracer, (patches, solution), atlas, &options, progress)
    })?;
    Ok(Lightmap { answer: Arc::clone(&solution.answer), map })
}

#[pymethods]
impl Lightmap {
    /// Pages, rows and columns.
    #[getter]
    fn shape(&self) -> (usize, usize, usize) {
        let atlas = self.map.atlas();
        (atlas.pages, atlas.height, atlas.width)
    }

    #[getter]
    fn irradiance<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f32>> {
        PyArray1::from_slice(py, self.map.irradiance().as_flattened())
    }

    /// Of all texels, NaN where the final gather did not compute one; nothing without a final gather.
    #[getter]
    fn standard_error<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f32>>> {
        let errors = self.map.standard_error();
        (!errors.is_empty()).then(|| {
            let mut all = vec![[f32::NAN; 3]; self.map.atlas().texels()];
            for (&texel, &error) in self.map.coverage().texels().iter().zip(errors) {
                all[texel as usize] = error;
            }
            PyArray1::from_vec(py, all.into_flattened())
        })
    }

    /// 0 nothing, 1 surface, 2 hidden surface, 3 filled from neighbours.
    #[getter]
    fn kind<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u8>> {
        let kind = |texel: &Texel| match texel {
            Texel::Empty => 0,
            Texel::Valid => 1,
            Texel::Hidden => 2,
            Texel::Dilated => 3,
        };
        PyArray1::from_vec(py, self.map.texels().iter().map(kind).collect())
    }

    /// Positions of the facets' corners, nine numbers for each facet.
    #[getter]
    fn corners<'py>(&self, py: Python<'py>) -> Doubles<'py> {
        let scene = self.map.atlas().scene(self.answer.data.lambertian());
        let corners = (0..scene.triangles.len()).flat_map(|t| scene.corners(t));
        crate::arrays::from_points(py, corners)
    }

    /// Texture coordinates of the facets' corners, six numbers for each facet; NaN where it has no place.
    #[getter]
    fn uv<'py>(&self, py: Python<'py>) -> Doubles<'py> {
        let atlas = self.map.atlas();
        let flat = (0..atlas.corners.len()).flat_map(|f| match atlas.texel_corners(f) {
            Some(_) => atlas.corners[f].map(|i| atlas.coordinates[i as usize].to_array()),
            None => [[f64::NAN; 2]; 3],
        });
        PyArray1::from_vec(py, flat.flatten().collect())
    }

    #[getter]
    fn page<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u32>> {
        PyArray1::from_slice(py, &self.map.atlas().page)
    }

    /// The triangle of the scene that each facet is of.
    #[getter]
    fn triangle<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u64>> {
        let atlas = self.map.atlas();
        PyArray1::from_vec(py, (0..atlas.corners.len()).map(|f| atlas.triangle(f) as u64).collect())
    }

    /// Solver's flux, the map's, and the standard error of that.
    #[getter]
    fn flux(&self) -> [[f64; 3]; 3] {
        let flux = self.map.flux();
        [flux.solver, flux.map, flux.standard_error]
    }

    /// RMS standard error relative to the mean irradiance.
    #[getter]
    fn relative_error(&self) -> f64 {
        self.map.relative_error()
    }

    /// Why new texture coordinates were made; nothing where those of the file were used.
    #[getter]
    fn refused(&self) -> Option<String> {
        self.map.atlas().refused.clone()
    }
}
