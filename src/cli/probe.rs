//! `radiosity probe`: irradiance at given points.

use std::{
    path::{Path, PathBuf},
    time::Instant,
};

use clap::{Args, ValueEnum};
use radiosity::{
    Error, Result, Scene,
    monte_carlo::{Effort, Estimate, PathOptions, PathTracer, Probe, Receiver, read_probes, write_probes},
    output::{
        file::Pending,
        final_gather::FinalGather,
        report::{peak_bytes, seconds},
        sampling_report::{ProbesReport, SamplingReport, SamplingSeconds},
    },
    trace::Tracer,
};
use rayon::prelude::*;

use super::{
    Common, Outcome,
    options::{CastArgs, SceneArgs},
    outputs,
    pipeline::{self, Job, Solved},
    summary, to_stdout,
    watch::Watch,
};

/// Compute the irradiance at given points, with its standard error
#[derive(Args)]
#[command(after_help = "Example:\n  radiosity probe room.obj --points desk.txt -o desk-light.txt\n\n\
    Each line of the points is `x y z nx ny nz`. Each line of the result is `x y z nx ny nz Er Eg Eb SEr SEg SEb`: the \
    irradiance and its standard error in W/m2. With --method radiosity the standard error covers the last bounce \
    only, and not the solution.")]
pub struct ProbeArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// Points and their normals, one line `x y z nx ny nz` each
    #[arg(long, value_name = "FILE")]
    points: PathBuf,
    /// Write the result to this file instead of stdout
    #[arg(short, long, value_name = "OUT")]
    output: Option<PathBuf>,
    /// Write all figures as JSON
    #[arg(long, value_name = "R.json")]
    report: Option<PathBuf>,
    /// Method
    #[arg(long, value_enum, default_value_t = Method::Path)]
    method: Method,
    /// Samples per point
    #[arg(long, value_name = "N", default_value_t = Effort::default().samples,
        value_parser = clap::value_parser!(u32).range(1..=1 << 30))]
    spp: u32,
    /// Path tracing without next event estimation: light counts only if a path hits an emitter
    #[arg(long)]
    no_next_event: bool,
    /// Seed of the random numbers. The same seed gives the same bytes
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    common: Common,
    #[command(flatten, next_help_heading = "With --method radiosity")]
    cast: CastArgs,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Method {
    /// Path tracing from the points to the emitters
    Path,
    /// A radiosity solution, with the last bounce gathered by rays
    Radiosity,
}

impl Method {
    fn name(self) -> &'static str {
        if self == Method::Path { "path" } else { "radiosity" }
    }
}

impl ProbeArgs {
    /// Refuses options that have no effect with this method.
    fn check(&self) -> Result<()> {
        let foreign = match self.method {
            Method::Path => self.cast.given(),
            Method::Radiosity => self.no_next_event.then_some("--no-next-event"),
        };
        let Some(option) = foreign else { return Ok(()) };
        let other = if self.method == Method::Path { "radiosity" } else { "path" };
        Err(Error::Usage {
            message: format!("{option} has no effect with --method {}", self.method.name()),
            hint: Some(format!("leave it out, or use --method {other}")),
        })
    }
}

/// Runs the command.
pub fn run(args: &ProbeArgs) -> Result<Outcome> {
    let start = Instant::now();
    args.check()?;
    let inputs = [args.scene.path.as_path(), &args.points];
    let text = |path: &PathBuf, what| outputs::text(path, &inputs, what);
    let file = args.output.as_ref().map(|path| text(path, "a table of irradiance")).transpose()?;
    let report_file = args.report.as_ref().map(|path| text(path, "a report")).transpose()?;
    let files: Vec<_> = [&file, &report_file].into_iter().flatten().collect();
    outputs::check_distinct(&files)?;
    let probes = read_probes(&args.points)?;
    args.common.start_threads()?;

    let watch = Watch::new(args.common.quiet);
    let mut times = SamplingSeconds::default();
    let (scene, tracer) = if args.method == Method::Radiosity {
        pipeline::load(&args.scene, &files, &watch, &mut times.stages)?
    } else {
        let (scene, tracer) = pipeline::load_as_given(&args.scene, &files, &watch, &mut times.stages)?;
        pipeline::warn_of_gloss(&scene, &args.scene.path, &watch);
        (scene, tracer)
    };
    let (estimates, patches) = estimate(args, &probes, &scene, &tracer, &watch, &mut times)?;

    watch.begin_writing();
    let mut pending = Vec::new();
    pending.extend(
        file.map(|file| file.write(|mut out| write_probes(&mut out, &probes, &estimates))).transpose()?,
    );
    times.stages.total = seconds(start.elapsed());
    let report = SamplingReport {
        version: env!("CARGO_PKG_VERSION"),
        scene: args.scene.path.display().to_string(),
        triangles: scene.triangles.len(),
        method: args.method.name(),
        samples: args.spp,
        next_event: !args.no_next_event,
        final_gather: patches.map(|_| GATHER),
        patches,
        seed: args.seed,
        units: scene.units.names(),
        picture: None,
        probes: Some(ProbesReport::new(&estimates)),
        seconds: times,
        peak_bytes: peak_bytes(),
    };
    pending.extend(report_file.map(|file| file.write(|out| report.write(out))).transpose()?);
    watch.progress().check()?;
    Pending::commit_all(pending)?;
    drop(watch);
    if args.output.is_none() {
        let mut table = Vec::new();
        write_probes(&mut table, &probes, &estimates).map_err(|e| Error::io(Path::new("stdout"), e))?;
        to_stdout(&String::from_utf8_lossy(&table))?;
    } else if !args.common.quiet {
        to_stdout(&summary::probes(&report, &outputs::names(&[&args.output, &args.report])))?;
    }
    Ok(Outcome::Done)
}

/// Rays of the last bounce per sample. One is enough, because each of the many samples has another direction.
const GATHER: u32 = 1;

/// Warns of points that see backs of faces in almost all directions, because they lie below a surface or inside a
/// solid.
fn warn_of_buried(probes: &[Probe], places: &[Receiver], tracer: &Tracer, watch: &Watch) {
    let buried: Vec<usize> =
        (0..places.len()).into_par_iter().filter(|&k| places[k].is_buried(tracer)).collect();
    let Some(&first) = buried.first() else { return };
    let p = probes[first].point;
    let (points, lie, see) =
        if buried.len() == 1 { ("1 point", "lies", "sees") } else { ("points", "lie", "see") };
    let many = if buried.len() == 1 { points.into() } else { format!("{} {points}", buried.len()) };
    watch.warn(&format!(
        "{many} {lie} below a surface or inside a solid, and {see} little but backs: point {}, {} {} {}, is the first",
        first + 1,
        p.x,
        p.y,
        p.z
    ));
}

/// The irradiance of the probes, and the number of patches of the solution.
fn estimate(
    args: &ProbeArgs,
    probes: &[Probe],
    scene: &Scene,
    tracer: &Tracer,
    watch: &Watch,
    times: &mut SamplingSeconds,
) -> Result<(Vec<Estimate>, Option<usize>)> {
    let places: Vec<Receiver> = probes.iter().map(|p| Receiver::free(tracer, p.point, p.normal)).collect();
    warn_of_buried(probes, &places, tracer, watch);
    let effort = Effort::default().with_samples(args.spp).with_seed(args.seed);
    let (estimates, patches);
    match args.method {
        Method::Path => {
            let options = PathOptions::default().with_next_event(!args.no_next_event);
            let paths = PathTracer::new(scene, tracer, options);
            (estimates, times.sampling) =
                watch.stage("paths", || paths.irradiances(&places, &effort, watch.progress()))?;
            patches = None;
        }
        Method::Radiosity => {
            let job =
                Job { file: &args.scene.path, cast: &args.cast, seed: args.seed, limit: args.common.limit() };
            job.check(scene, watch)?;
            let Solved { patches: solved, solution, .. } =
                job.solve(scene, tracer, watch, &mut times.stages)?;
            let gather = FinalGather::new(scene, tracer, &solved, &solution, GATHER);
            (estimates, times.sampling) =
                watch.stage("gathering", || gather.irradiances(&places, &effort, watch.progress()))?;
            patches = Some(solved.len());
        }
    }
    Ok((estimates, patches))
}
