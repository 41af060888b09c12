//! Stages that commands share: reading a scene, and solving it.

use std::path::Path;

use radiosity::{
    Error, Result, Scene,
    accuracy::survey::turned_lamps,
    form_factor::{CastOptions, Estimator, FormFactors},
    monte_carlo::reflection::{SpecularPart, Surfaces, make_lambertian},
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

/// Reads a scene with light, makes its surfaces Lambertian, and builds its ray tracer. Refuses a scene if one of its
/// files is in `outputs`.
pub fn load(
    args: &SceneArgs,
    outputs: &[&OutputFile],
    watch: &Watch,
    times: &mut Seconds,
) -> Result<(Scene, Tracer)> {
    let (mut scene, tracer) = load_as_given(args, outputs, watch, times)?;
    flatten(&mut scene, args, watch);
    Ok((scene, tracer))
}

/// Does the same as [`load`], but keeps the specular parts of materials.
pub fn load_as_given(
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
    if !scene.is_lit() {
        return Err(Error::input(path, None, "nothing emits light, so there is nothing to compute").with_hint(
            "give a material an emitted radiance with --emit, or with a line like `Ke 10 10 10` in the .mtl file, or add --sun or --sky",
        ));
    }
    (tracer, times.bvh) = watch.stage("bvh", || trace(&scene, path, watch))?;
    warn_of_turned_lamps(&scene, &tracer, watch);
    Ok((scene, tracer))
}

/// The ray tracer of a scene. Refuses a scene with a gap that rays do not resolve, and warns of one that they resolve badly.
pub fn trace(scene: &Scene, path: &Path, watch: &Watch) -> Result<Tracer> {
    let tracer = Tracer::new(scene);
    let face = |t: u32| {
        let triangle = &scene.triangles[t as usize];
        let face = scene.face_of_source(triangle.source);
        let line = face.and_then(|face| scene.faces[face].line);
        (line, format!("face {} of `{}`", face.unwrap_or(t as usize), scene.material(t as usize).name))
    };
    let describe = |[one, other]: [u32; 2], width: f64, resolved: f64| {
        let [(line, one), (_, other)] = [one, other].map(face);
        (line, format!("{one} is {width:.3e} from {other}, and rays resolve {resolved:.3e} there"))
    };
    match tracer.check_gaps(scene) {
        Ok(None) => {}
        Ok(Some(gap)) => {
            let (line, message) = describe(gap.triangles, gap.width, gap.resolved);
            let line = line.map_or(String::new(), |line| format!(":{line}"));
            watch.warn(&format!(
                "{}{line}: {message}: light between them may be off by {:.0} %",
                path.display(),
                100.0 * gap.share()
            ));
        }
        Err(error) => {
            let Error::UnresolvedGap { triangles, width, resolved } = error else { return Err(error) };
            let (line, message) = describe(triangles, width, resolved);
            return Err(Error::input(path, line, message).with_hint(error.hint().unwrap_or_default()));
        }
    }
    Ok(tracer)
}

/// Warns of luminaires that are inside out.
pub fn warn_of_turned_lamps(scene: &Scene, tracer: &Tracer, watch: &Watch) {
    const MOST: usize = 3;
    let turned = turned_lamps(scene, tracer);
    turned.iter().take(MOST).for_each(|lamp| watch.warn(&lamp.warning(scene)));
    match turned.len().saturating_sub(MOST) {
        0 => {}
        1 => watch.warn("1 more lamp does the same"),
        more => watch.warn(&format!("{more} more lamps do the same")),
    }
}

/// Makes all surfaces Lambertian, with a warning that names the materials with a specular part.
pub fn flatten(scene: &mut Scene, args: &SceneArgs, watch: &Watch) {
    let glossy = scene.materials.iter().filter(|m| m.specular.is_some());
    let glossy: Vec<String> = glossy.map(|m| m.name.clone()).collect();
    make_lambertian(scene, args.specular());
    if let [first, rest @ ..] = &glossy[..] {
        let whose = match rest.len() {
            0 => format!("the specular part of material `{first}`"),
            n => format!("the specular parts of material `{first}` and {n} more"),
        };
        let what = match args.specular() {
            SpecularPart::Diffuse => "counted as diffuse, unless --specular drop is given",
            SpecularPart::Drop => "left out",
        };
        let warning = format!("{}: {whose}: {what}", args.path.display());
        watch.warn(&warning);
        scene.warnings.push(warning);
    }
}

/// Warns of materials whose reflection path and light tracing cannot follow exactly.
pub fn warn_of_gloss(scene: &Scene, file: &Path, watch: &Watch) {
    for warning in Surfaces::of(scene).warnings() {
        watch.warn(&format!("{}: {warning}", file.display()));
    }
}

/// Reads a scene, cuts it where surfaces touch or cross, and prints the warnings. Refuses a scene if one of its files
/// is in `outputs`.
pub fn read(args: &SceneArgs, outputs: &[&OutputFile], watch: &Watch) -> Result<Scene> {
    read_and(args, outputs, watch, |_| ()).map(|(scene, ())| scene)
}

/// Does the same as [`read`], and calls `look` with the scene before it is cut.
pub fn read_and<T>(
    args: &SceneArgs,
    outputs: &[&OutputFile],
    watch: &Watch,
    look: impl FnOnce(&Scene) -> T,
) -> Result<(Scene, T)> {
    let mut scene = args.load()?;
    outputs.iter().try_for_each(|output| output.check_inputs(&scene.files))?;
    let seen = look(&scene);
    scene.cut_contacts();
    scene.warnings.iter().for_each(|warning| watch.warn(warning));
    Ok((scene, seen))
}

/// Settings of a solution from which a command computes something else.
pub struct Job<'a> {
    /// The file of the scene, for messages.
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
    /// Refuses a computation that needs too much memory, and warns if it needs much.
    pub fn check(&self, scene: &Scene, watch: &Watch) -> Result<()> {
        let (subdivision, _) = self.cast.subdivision();
        let bytes = forecast::bytes(scene, Estimator::Pooled, Solver::Auto);
        let linear = forecast::of_linear_light(scene, self.cast.linear());
        let bytes = |patches: f64, rays: f64| bytes(patches, rays) + linear(patches);
        let work = Work {
            scene,
            patches: Patches::forecast(scene, &subdivision),
            rays: f64::from(self.cast.rays()),
            bytes: &bytes,
            options: forecast::USUAL,
        };
        let warnings = [self.limit.check(&work)?, self.cast.too_few(scene)];
        warnings.iter().flatten().for_each(|warning| watch.warn(warning));
        Ok(())
    }

    /// Options of the solver.
    pub fn options(&self) -> SolveOptions {
        SolveOptions::default().with_linear(self.cast.linear())
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
            solve::solve_linear((scene, tracer), &form_factors, &patches, &self.options(), watch.progress())
                .map_err(|error| blame(self.file, error))
        })?;
        Ok(Solved { patches, form_factors, solution })
    }
}

/// Adds the name of the scene to errors that the scene causes.
pub fn blame(file: &Path, error: Error) -> Error {
    match (&error, error.hint()) {
        (Error::NoEquilibrium, Some(hint)) => Error::input(file, None, error.to_string()).with_hint(hint),
        _ => error,
    }
}
