//! The stages that commands share: reading a scene, solving it.

use std::path::Path;

use radiosity::{
    Error, Result, Scene,
    form_factor::{CastOptions, Estimator, FormFactors},
    output::{file::OutputFile, report::Seconds},
    patch::Patches,
    solve::{self, Solution, SolveOptions, Solver},
    trace::Tracer,
};

use super::{
    forecast::{self, Limit, Work},
    options::{CastArgs, SceneArgs},
    watch::Watch,
};

/// A scene that emits, ready for rays. None of its files may be one of `outputs`.
pub fn load(
    args: &SceneArgs,
    outputs: &[&OutputFile],
    watch: &Watch,
    times: &mut Seconds,
) -> Result<(Scene, Tracer)> {
    let (scene, tracer);
    let path = &args.path;
    (scene, times.load) = watch.stage("reading", || read(args, outputs, watch))?;
    if scene.degenerate > 0 {
        watch.warn(&format!("{}: left out {} triangles without area", path.display(), scene.degenerate));
    }
    if !scene.has_emitter() {
        return Err(Error::input(path, None, "nothing emits light: there is nothing to compute").with_hint(
            "give a material an emitted radiance, by --emit or a line like `Ke 10 10 10` in the .mtl file",
        ));
    }
    (tracer, times.bvh) = watch.stage("bvh", || Ok(Tracer::new(&scene)))?;
    Ok((scene, tracer))
}

/// A scene, with what its reader has to say. None of its files may be one of `outputs`.
pub fn read(args: &SceneArgs, outputs: &[&OutputFile], watch: &Watch) -> Result<Scene> {
    let scene = args.load()?;
    outputs.iter().try_for_each(|output| output.check_inputs(&scene.files))?;
    scene.warnings.iter().for_each(|warning| watch.warn(warning));
    Ok(scene)
}

/// How commands that need a solution on their way to something else get it.
pub struct Job<'a> {
    /// The scene's file, for messages.
    pub file: &'a Path,
    pub cast: &'a CastArgs,
    pub seed: u64,
    pub limit: Limit,
}

/// A solved scene.
#[non_exhaustive]
pub struct Solved {
    pub patches: Patches,
    pub form_factors: FormFactors,
    pub solution: Solution,
}

impl Job<'_> {
    /// Refuses what cannot be held in memory; warns of what is much.
    pub fn check(&self, scene: &Scene, watch: &Watch) -> Result<()> {
        let (subdivision, _) = self.cast.subdivision();
        let bytes = forecast::bytes(scene, Estimator::Pooled, Solver::Auto);
        let work = Work {
            scene,
            patches: Patches::forecast(scene, &subdivision),
            rays: f64::from(self.cast.rays()),
            bytes: &bytes,
            options: forecast::USUAL,
        };
        if let Some(warning) = self.limit.check(&work)? {
            watch.warn(&warning);
        }
        Ok(())
    }

    /// Solves a scene.
    pub fn solve(
        &self,
        scene: &Scene,
        tracer: &Tracer,
        watch: &Watch,
        times: &mut Seconds,
    ) -> Result<Solved> {
        let (mut patches, form_factors, solution);
        let (subdivision, _) = self.cast.subdivision();
        (patches, times.subdivide) =
            watch.stage("patches", || Ok(Patches::subdivide(scene, &subdivision)))?;
        let rays = f64::from(self.cast.rays());
        let cast = CastOptions::default().with_rays(rays).with_seed(self.seed);
        (form_factors, times.form_factors) = watch
            .stage("rays", || FormFactors::cast(scene, tracer, &mut patches, &cast, watch.progress()))?;
        (solution, times.solve) = watch.stage("solving", || {
            solve::solve(&form_factors, &patches, &SolveOptions::default(), watch.progress())
                .map_err(|error| blame(self.file, error))
        })?;
        Ok(Solved { patches, form_factors, solution })
    }
}

/// Names the scene where the scene is to blame.
pub fn blame(file: &Path, error: Error) -> Error {
    match (&error, error.hint()) {
        (Error::NoEquilibrium, Some(hint)) => Error::input(file, None, error.to_string()).with_hint(hint),
        _ => error,
    }
}
