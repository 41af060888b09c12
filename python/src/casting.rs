//! Patches and rays: what the functions that solve have in common.

use pyo3::{exceptions::PyValueError, prelude::*};
use radiosity::{
    Progress, Quality,
    accuracy::{
        memory::{self, Memory},
        patch_search::PatchSearch,
        refinement::{FIRST_RAYS, Plan, Round, begin, refine},
        solved::Solved,
        survey::Survey,
    },
    form_factor::{CastOptions, Estimator, FormFactors},
    patch::{Patches, Subdivision},
    solve::{SolveOptions, Solver},
};

use crate::{error::too_large, scene::Data};

/// How many patches and rays, and which numerics.
#[derive(FromPyObject, Clone)]
#[pyo3(from_item_all)]
pub struct Casting {
    error: Option<f64>,
    rays: Option<u32>,
    patches: Option<u32>,
    patch_size: Option<f64>,
    quality: Option<String>,
    estimator: String,
    solver: String,
    tolerance: Option<f64>,
    linear: bool,
    pub seed: u64,
}

/// Rays that estimate how much of the scene is seen from behind.
const LOOKING: u64 = 10_000;

impl Casting {
    fn quality(&self) -> PyResult<Quality> {
        let Some(name) = &self.quality else { return Ok(Quality::default()) };
        let found = Quality::PRESETS.iter().find(|(preset, _)| preset == name);
        found.map(|&(_, quality)| quality).ok_or_else(|| {
            let names = Quality::PRESETS.map(|(name, _)| name).join(", ");
            PyValueError::new_err(format!("quality: `{name}` is none of {names}"))
        })
    }

    fn estimator(&self) -> PyResult<Estimator> {
        match self.estimator.as_str() {
            "pooled" => Ok(Estimator::Pooled),
            "one-way" => Ok(Estimator::OneWay),
            other => Err(PyValueError::new_err(format!("estimator: `{other}` is none of pooled, one-way"))),
        }
    }

    /// How to solve the linear system.
    pub fn solve_options(&self) -> PyResult<SolveOptions> {
        let solver = match self.solver.as_str() {
            "auto" => Solver::Auto,
            "jacobi" => Solver::Jacobi,
            "gauss-seidel" => Solver::GaussSeidel,
            "southwell" => Solver::Southwell,
            "cg" => Solver::ConjugateGradient,
            "direct" => Solver::Direct,
            other => {
                return Err(PyValueError::new_err(format!(
                    "solver: `{other}` is none of auto, jacobi, gauss-seidel, southwell, cg, direct"
                )));
            }
        };
        let default = SolveOptions::default();
        let tolerance = self.tolerance.unwrap_or(default.tolerance);
        Ok(default
            .with_solver(solver)
            .with_tolerance(tolerance)
            .with_linear(self.linear && self.patch_size != Some(f64::INFINITY)))
    }

    /// How to cut the scene, where that is said.
    pub fn given_subdivision(&self) -> PyResult<Option<Subdivision>> {
        Ok(match (self.patch_size, self.patches) {
            (Some(edge), _) => Some(Subdivision::Edge(edge)),
            (_, Some(count)) => Some(Subdivision::Count(count as usize)),
            _ if self.quality.is_some() => Some(Subdivision::Count(self.quality()?.patches)),
            _ => None,
        })
    }

    /// Rays a patch, where that is said.
    pub fn given_rays(&self) -> PyResult<Option<u32>> {
        let of_quality = self.quality.is_some().then(|| self.quality()).transpose()?;
        Ok(self.rays.or(of_quality.map(|quality| quality.rays)))
    }

    /// What is to be done, or why it cannot be.
    pub fn job(&self, data: &Data) -> PyResult<Job> {
        let preset = Subdivision::Count(self.quality()?.patches);
        let given = self.given_subdivision()?;
        let job = Job {
            error: self.error,
            search: self.error.is_some() && given.is_none(),
            subdivision: given.unwrap_or(preset),
            cast: CastOptions::default()
                .with_rays(match self.error {
                    Some(_) => FIRST_RAYS,
                    None => f64::from(self.rays.unwrap_or(self.quality()?.rays)),
                })
                .with_estimator(self.estimator()?)
                .with_seed(self.seed),
            solve: self.solve_options()?,
        };
        if let (Some(available), false) = (memory::of_machine(), job.search) {
            let patches = Patches::forecast(data.lambertian(), &job.subdivision);
            let need = job.bytes(data, 1.0)(patches, job.cast.rays);
            if need > available {
                let what = format!("{patches:.0} patches with {:.0} rays each", job.cast.rays);
                return Err(too_large(&what, need, available));
            }
        }
        Ok(job)
    }
}

/// What is to be done.
pub struct Job {
    /// The wanted RMS error relative to the mean.
    pub error: Option<f64>,
    /// Whether the patches are to be found for it.
    pub search: bool,
    subdivision: Subdivision,
    cast: CastOptions,
    pub solve: SolveOptions,
}

impl Job {
    /// Bytes for a number of front patches and of rays. `with_backs` is the number of all patches over that of front patches.
    fn bytes(&self, data: &Data, with_backs: f64) -> impl Fn(f64, f64) -> f64 {
        let (scene, estimator, options) = (data.lambertian(), self.cast.estimator, self.solve);
        move |fronts, rays| {
            let patches = with_backs * fronts;
            let linear = if options.linear { memory::of_linear_light(scene, patches) } else { 0.0 };
            Memory::of(scene, patches, rays, estimator, options.solver).peak() + linear
        }
    }

    /// The form factors alone; those of a solution where an error is wanted.
    pub fn cast(&self, data: &Data, progress: &Progress) -> radiosity::Result<(Patches, FormFactors)> {
        if self.error.is_some() {
            let (Solved { patches, form_factors, .. }, _) = self.solved(data, progress)?;
            return Ok((patches, form_factors));
        }
        let (scene, tracer) = (data.lambertian(), data.tracer());
        let mut patches = Patches::subdivide(scene, &self.subdivision);
        let form_factors = FormFactors::cast(scene, tracer, &mut patches, &self.cast, progress)?;
        Ok((patches, form_factors))
    }

    /// Casts and solves, in rounds where an error is wanted: as the command `solve` does.
    pub fn solved(&self, data: &Data, progress: &Progress) -> radiosity::Result<(Solved, Vec<Round>)> {
        let (scene, tracer) = (data.lambertian(), data.tracer());
        let mut plan = Plan::default().with_error(self.error);
        let (mut patches, mut first) = (None, None);
        let available = memory::of_machine().unwrap_or(f64::INFINITY);
        let with_backs = match self.error {
            Some(_) => 1.0 + Survey::of(scene, tracer, LOOKING, self.cast.seed).back_area,
            None => 1.0,
        };
        let bytes = self.bytes(data, with_backs);
        if let (Some(wanted), true) = (self.error, self.search) {
            progress.begin("patches", 0);
            let search = PatchSearch::new(scene, tracer, self.cast.seed)
                .with_error(Some(wanted))
                .with_solve(self.solve);
            let found = search.run(|fronts| bytes(fronts, FIRST_RAYS) <= available, || false, progress)?;
            plan.error = Some(found.sampling_error(wanted));
            first = found.first.filter(|_| self.cast.estimator == Estimator::Pooled);
            patches = Some(found.patches);
        }
        let patches = patches.unwrap_or_else(|| Patches::subdivide(scene, &self.subdivision));
        if self.error.is_some() {
            plan.most_rays = Some(memory::most_rays(available, |rays| bytes(patches.fronts() as f64, rays)));
        }
        let first = match first {
            Some(first) => first,
            None => begin(scene, tracer, patches, &self.cast, &self.solve, None, progress)?,
        };
        let next = |_: &Solved, rounds: &[Round]| Ok(self.error.and_then(|_| plan.next(rounds)));
        refine(scene, tracer, first, &self.solve, next, progress)
    }
}
