//! Scenes.

use std::{
    ffi::OsString,
    sync::{Arc, OnceLock},
};

use numpy::{PyArray1, PyReadonlyArray1, PyReadonlyArrayDyn};
use pyo3::{exceptions::PyValueError, prelude::*};
use radiosity::{
    cli,
    monte_carlo::reflection::{SpecularPart, make_lambertian},
    scene::{Material, light::Units},
    trace::Tracer,
};

use crate::{
    arrays::{self, Doubles},
    error::raise,
    run::run,
};

/// A scene with its ray tracer.
pub struct Data {
    /// Its file, or another name for reports.
    pub name: String,
    /// With the specular parts of its materials, for path and light tracing.
    pub given: radiosity::Scene,
    /// With Lambertian surfaces, where that differs.
    flat: Option<radiosity::Scene>,
    /// With its faces whole, where other surface touches or crosses them and so cuts them.
    whole: Option<Arc<radiosity::Scene>>,
    tracer: Arc<OnceLock<Tracer>>,
    specular: SpecularPart,
}

impl Data {
    /// Cuts a scene where surfaces touch or cross.
    fn new(name: String, mut given: radiosity::Scene, specular: SpecularPart) -> Data {
        let whole = given.clone();
        given.cut_contacts();
        let is_cut = given.triangles != whole.triangles || given.vertices.len() != whole.vertices.len();
        let whole = is_cut.then(|| Arc::new(whole));
        Data { name, flat: flat(&given, specular), given, whole, tracer: Arc::default(), specular }
    }

    /// The scene with Lambertian surfaces.
    pub fn lambertian(&self) -> &radiosity::Scene {
        self.flat.as_ref().unwrap_or(&self.given)
    }

    /// The scene with whole faces, for view factors.
    pub fn whole(&self) -> &radiosity::Scene {
        self.whole.as_deref().unwrap_or(&self.given)
    }

    /// Its ray tracer, built when it is first wanted.
    pub fn tracer(&self) -> &Tracer {
        self.tracer.get_or_init(|| Tracer::new(&self.given))
    }

    /// The same geometry with another look.
    fn changed(&self, given: radiosity::Scene) -> Data {
        let flat = flat(&given, self.specular);
        let (name, whole, tracer) = (self.name.clone(), self.whole.clone(), Arc::clone(&self.tracer));
        Data { name, flat, given, whole, tracer, specular: self.specular }
    }

    /// Refuses a scene that is dark.
    pub fn check_lit(&self) -> PyResult<()> {
        if self.lambertian().is_lit() {
            return Ok(());
        }
        let what =
            "scene: nothing emits light, so there is nothing to compute; give an emission, a sun or a sky";
        Err(PyValueError::new_err(what))
    }
}

/// The scene with Lambertian surfaces, where that differs.
fn flat(given: &radiosity::Scene, specular: SpecularPart) -> Option<radiosity::Scene> {
    given.has_specular().then(|| {
        let mut scene = given.clone();
        make_lambertian(&mut scene, specular);
        scene
    })
}

/// Triangles with materials.
#[pyclass(frozen, module = "radiosity._radiosity")]
pub struct Scene {
    pub data: Arc<Data>,
}

#[pymethods]
impl Scene {
    /// From faces with any number of corners: `corners` lists those of all faces, `sizes` how many each face has, `material` an
    /// index into `names`. Reflectance and emission have a row for each face.
    #[new]
    #[allow(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        vertices: PyReadonlyArrayDyn<'_, f64>,
        corners: PyReadonlyArray1<'_, u32>,
        sizes: PyReadonlyArray1<'_, u32>,
        material: PyReadonlyArray1<'_, u32>,
        names: Vec<String>,
        reflectance: PyReadonlyArrayDyn<'_, f64>,
        emission: PyReadonlyArrayDyn<'_, f64>,
        photometric: bool,
    ) -> PyResult<Scene> {
        let vertices = arrays::points(&vertices)?;
        let mut rest = corners.as_slice()?;
        let faces = sizes.as_slice()?.iter().map(|&size| {
            let face;
            (face, rest) = rest.split_at(size as usize);
            face
        });
        let materials = names.iter().map(|name| Material::new(name, [0.0; 3], [0.0; 3])).collect();
        let scene = radiosity::Scene::from_indexed(&vertices, faces, material.as_slice()?, materials);
        let mut scene = scene.map_err(raise)?;
        let (reflectance, emission) = (arrays::triples(&reflectance)?, arrays::triples(&emission)?);
        scene.paint(Some(&reflectance), Some(&emission)).map_err(raise)?;
        if photometric {
            scene.units = Units::Photometric;
        }
        let data = run(py, None, None, move |_| {
            scene.cut_overlaps();
            Ok(Data::new("<arrays>".into(), scene, SpecularPart::Drop))
        })?;
        Ok(Scene { data: Arc::new(data) })
    }

    /// Reads a file with the options of the command line.
    #[staticmethod]
    fn load(py: Python<'_>, name: String, words: Vec<OsString>) -> PyResult<Scene> {
        let data = run(py, None, None, move |_| {
            let (scene, specular) = cli::read_scene(words)?;
            Ok(Data::new(name, scene, specular))
        })?;
        Ok(Scene { data: Arc::new(data) })
    }

    /// The same geometry with another reflectance or emission for each face.
    fn painted(
        &self,
        reflectance: Option<PyReadonlyArrayDyn<'_, f64>>,
        emission: Option<PyReadonlyArrayDyn<'_, f64>>,
    ) -> PyResult<Scene> {
        let reflectance = reflectance.as_ref().map(arrays::triples).transpose()?;
        let emission = emission.as_ref().map(arrays::triples).transpose()?;
        let mut given = self.data.given.clone();
        given.paint(reflectance.as_deref(), emission.as_deref()).map_err(raise)?;
        Ok(Scene { data: Arc::new(self.data.changed(given)) })
    }

    /// The same scene with more lights, by options of the command line.
    fn lit(&self, py: Python<'_>, words: Vec<OsString>) -> PyResult<Scene> {
        let data = Arc::clone(&self.data);
        let data = run(py, None, None, move |_| {
            let mut given = data.given.clone();
            cli::add_lights(&mut given, words)?;
            Ok(data.changed(given))
        })?;
        Ok(Scene { data: Arc::new(data) })
    }

    /// Names of lights that are no surfaces.
    #[getter]
    fn lights(&self) -> Vec<String> {
        self.data.given.lights.names().map(String::from).collect()
    }

    #[getter]
    fn name(&self) -> &str {
        &self.data.name
    }

    #[getter]
    fn warnings(&self) -> Vec<String> {
        let scene = &self.data.given;
        let specular = scene.materials.iter().filter(|m| m.specular.is_some()).map(|m| &m.name);
        let specular: Vec<&String> = specular.collect();
        let mut warnings = scene.warnings.clone();
        if scene.degenerate > 0 {
            warnings.push(format!("left out {} triangles without area", scene.degenerate));
        }
        if let [first, rest @ ..] = &specular[..] {
            let more = if rest.is_empty() { String::new() } else { format!(" and {} more", rest.len()) };
            warnings.push(format!(
                "the specular part of material `{first}`{more} counts in path and light tracing only"
            ));
        }
        warnings
    }

    /// Number of faces.
    #[getter]
    fn faces(&self) -> usize {
        self.data.given.faces.len()
    }

    #[getter]
    fn vertices<'py>(&self, py: Python<'py>) -> Doubles<'py> {
        arrays::from_points(py, self.data.given.vertices.iter().copied())
    }

    #[getter]
    fn triangles<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u32>> {
        let triangles = self.data.given.triangles.iter();
        PyArray1::from_vec(py, triangles.flat_map(|triangle| triangle.vertices).collect())
    }

    /// The face that each triangle is of.
    #[getter]
    fn face_of_triangles<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u64>> {
        let faces = self.data.given.face_of_triangles();
        PyArray1::from_vec(py, faces.into_iter().map(|face| face as u64).collect())
    }

    #[getter]
    fn area<'py>(&self, py: Python<'py>) -> Doubles<'py> {
        let scene = &self.data.given;
        PyArray1::from_vec(py, (0..scene.triangles.len()).map(|t| scene.area(t)).collect())
    }

    /// Name, reflectance and emission of each material.
    #[getter]
    fn materials(&self) -> Vec<(String, [f64; 3], [f64; 3])> {
        let of = |m: &Material| (m.name.clone(), m.reflectance, m.emission);
        self.data.given.materials.iter().map(of).collect()
    }

    /// The material of each triangle.
    #[getter]
    fn material_of_triangles<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u32>> {
        PyArray1::from_vec(py, self.data.given.triangles.iter().map(|t| t.material).collect())
    }
}
