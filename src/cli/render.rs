//! `radiosity render`: a picture.

use std::{path::PathBuf, time::Instant};

use clap::{Args, ValueEnum};
use radiosity::{
    Error, Result, Scene,
    monte_carlo::{
        Camera, Film, LightOptions, LightTracer, PathOptions, PathTracer, PictureFormat, RenderOptions,
        reflection::Surfaces,
    },
    output::{
        false_colour::{self, FalseColour},
        file::Pending,
        picture,
        report::{peak_bytes, seconds},
        sampling_report::{PictureReport, SamplingReport, SamplingSeconds},
    },
    tone::Exposure,
    trace::Tracer,
};

use super::{
    Common, Outcome,
    camera::{self, CameraArgs},
    options::{CastArgs, SceneArgs, stops, white},
    outputs,
    pipeline::{self, Job, Solved},
    summary, to_stdout,
    watch::Watch,
};

/// Make a picture of a scene, by path tracing, light tracing or radiosity
#[derive(Args)]
#[command(after_help = "Example:\n  radiosity render room.obj -o room.png --method path --spp 256\n\n\
    In a .png the radiance is multiplied by the exposure, clipped at white and encoded as sRGB. There is no other tone \
    curve, so pictures with the same --white are comparable. A .exr or .hdr holds the radiance itself in W/(m2 sr).")]
pub struct RenderArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// Write the picture to this file: .png, .exr or .hdr
    #[arg(short, long, value_name = "OUT.png|.exr|.hdr")]
    output: PathBuf,
    /// Write all figures as JSON
    #[arg(long, value_name = "R.json")]
    report: Option<PathBuf>,
    /// Method
    #[arg(long, value_enum, default_value_t = Method::Path)]
    method: Method,
    /// Samples per pixel: paths, or the mean number of particles
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..))]
    spp: u32,
    /// Path tracing without next event estimation: light counts only if a path hits an emitter
    #[arg(long)]
    no_next_event: bool,
    /// With --method radiosity: gather the last bounce with N rays per sample, instead of interpolating between patches
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=65536))]
    final_gather: Option<u32>,
    /// With --method radiosity: show the irradiance in false colours, with a scale and with lines at its steps. Only
    /// for .png
    #[arg(long)]
    false_colour: bool,
    /// With --false-colour: the irradiance at the top of the scale [default: automatic]
    #[arg(long, value_name = "IRRADIANCE", value_parser = white, requires = "false_colour")]
    scale: Option<f64>,
    /// With --false-colour: no lines
    #[arg(long, requires = "false_colour")]
    no_isolines: bool,
    #[command(flatten)]
    camera: CameraArgs,
    /// Make the picture brighter by this number of stops. A negative number makes it darker
    #[arg(long, value_name = "STOPS", default_value_t = 0.0, value_parser = stops)]
    exposure: f64,
    /// Radiance that is shown as white, in W/(m2 sr) [default: automatic]
    #[arg(long, value_name = "RADIANCE", value_parser = white)]
    white: Option<f64>,
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
    /// Path tracing from the camera to the emitters
    Path,
    /// Light tracing from the emitters to the camera
    Light,
    /// A radiosity solution
    Radiosity,
}

impl Method {
    fn name(self) -> &'static str {
        match self {
            Method::Path => "path",
            Method::Light => "light",
            Method::Radiosity => "radiosity",
        }
    }
}

/// Largest number of particles in a run of light tracing.
const MOST_PARTICLES: u64 = 1 << 36;

impl RenderArgs {
    /// Refuses options that have no effect with this method.
    fn check(&self) -> Result<()> {
        let usage = |message: String, hint: &str| Err(Error::Usage { message, hint: Some(hint.into()) });
        if self.no_next_event && self.method == Method::Light {
            let message =
                "light tracing needs next event estimation, because no particle ever hits a pinhole";
            return usage(message.into(), "leave --no-next-event out, or use --method path");
        }
        let foreign = match self.method {
            Method::Radiosity => self.no_next_event.then_some("--no-next-event"),
            _ => {
                let false_colour = self.false_colour.then_some("--false-colour");
                self.final_gather.map(|_| "--final-gather").or(false_colour).or(self.cast.given())
            }
        };
        if let Some(option) = foreign {
            let message = format!("{option} has no effect with --method {}", self.method.name());
            let other = if self.method == Method::Radiosity { "path" } else { "radiosity" };
            return usage(message, &format!("leave it out, or use --method {other}"));
        }
        Ok(())
    }

    /// Refuses an exposure for a picture that holds radiance.
    fn check_exposure(&self, format: PictureFormat) -> Result<()> {
        let given = self.white.map(|_| "--white").or((self.exposure != 0.0).then_some("--exposure"));
        if self.false_colour && (format != PictureFormat::Png || given.is_some()) {
            return Err(Error::Usage {
                message: "--false-colour makes a .png, in which colours mean irradiance".into(),
                hint: Some("end the name in .png, and give --scale instead of --white or --exposure".into()),
            });
        }
        match given.filter(|_| format != PictureFormat::Png) {
            None => Ok(()),
            Some(option) => Err(Error::Usage {
                message: format!(
                    "{option} is for .png only: {} holds the radiance itself",
                    self.output.display()
                ),
                hint: Some(format!("leave {option} out, or end the name in .png")),
            }),
        }
    }

    fn job(&self) -> Job<'_> {
        Job { file: &self.scene.path, cast: &self.cast, seed: self.seed, limit: self.common.limit() }
    }

    /// Refuses pictures that need too much memory or too many particles.
    fn check_size(&self, camera: &Camera) -> Result<()> {
        let pixels = (camera.width() * camera.height()) as u64;
        self.common.limit().check_picture(pixels as f64, self.method == Method::Light)?;
        if self.method == Method::Light && pixels.saturating_mul(self.spp.into()) > MOST_PARTICLES {
            return Err(Error::Usage {
                message: format!("{} particles per pixel for {pixels} pixels are too many", self.spp),
                hint: Some("give a smaller --spp or fewer pixels".into()),
            });
        }
        Ok(())
    }

    /// The exposure of the picture.
    fn exposure(&self, film: &Film) -> Exposure {
        self.white.map_or_else(|| film.automatic_exposure(), Exposure::of_white).brighter(self.exposure)
    }
}

/// Runs the command.
pub fn run(args: &RenderArgs) -> Result<Outcome> {
    let start = Instant::now();
    args.check()?;
    let (file, format) = outputs::picture(&args.output, &args.scene.path)?;
    args.check_exposure(format)?;
    let report_file = args.report.as_ref().map(|path| outputs::report(path, &args.scene.path)).transpose()?;
    let files: Vec<_> = std::iter::once(&file).chain(&report_file).collect();
    outputs::check_distinct(&files)?;
    args.common.start_threads()?;

    let watch = Watch::new(args.common.quiet);
    let mut times = SamplingSeconds::default();
    let (scene, tracer) = if args.method == Method::Radiosity {
        pipeline::load(&args.scene, &files, &watch, &mut times.stages)?
    } else {
        let (scene, tracer) = pipeline::load_as_given(&args.scene, &files, &watch, &mut times.stages)?;
        pipeline::warn_of_gloss(&scene, &args.scene.path, &watch);
        if args.method == Method::Light && Surfaces::of(&scene).has_mirror() {
            watch.warn(
                "mirrors are dark in the picture, because no particle from a mirror hits the camera's pinhole; \
                 --method path shows reflections",
            );
        }
        (scene, tracer)
    };
    let camera = args.camera.camera(|view| args.scene.lights.upwards(view), &scene, &tracer)?;
    args.check_size(&camera)?;
    camera::check(&args.camera, &camera, &scene, &tracer, &watch)?;
    let (film, patches) = picture(args, &scene, &tracer, &camera, &watch, &mut times)?;
    let exposure = args.exposure(&film);

    watch.begin_writing();
    let (written, seconds_writing) = watch.stage("writing", || {
        file.write(|out| match args.false_colour {
            true => {
                let lines = !args.no_isolines;
                let options = FalseColour::default().with_most(args.scale).with_isolines(lines);
                false_colour::encode(out, &film, &options, scene.units.names().irradiance)
            }
            false => film.encode(out, format, exposure),
        })
    })?;
    let mut pending = vec![written];
    times.stages.output = seconds_writing;
    times.stages.total = seconds(start.elapsed());
    let report = SamplingReport {
        version: env!("CARGO_PKG_VERSION"),
        scene: args.scene.path.display().to_string(),
        triangles: scene.triangles.len(),
        method: args.method.name(),
        samples: args.spp,
        next_event: !args.no_next_event && (args.method != Method::Radiosity || args.final_gather.is_some()),
        final_gather: args.final_gather,
        patches,
        seed: args.seed,
        units: scene.units.names(),
        picture: Some(PictureReport::new(&camera, &film, exposure.white())),
        probes: None,
        seconds: times,
        peak_bytes: peak_bytes(),
    };
    pending.extend(report_file.map(|file| file.write(|out| report.write(out))).transpose()?);
    watch.progress().check()?;
    Pending::commit_all(pending)?;
    drop(watch);
    if !args.common.quiet {
        let names = outputs::names(&[&Some(args.output.clone()), &args.report]);
        to_stdout(&summary::picture(&report, args.white.is_some(), args.exposure, &names))?;
    }
    Ok(Outcome::Done)
}

/// The picture, and the number of patches of the solution.
fn picture(
    args: &RenderArgs,
    scene: &Scene,
    tracer: &Tracer,
    camera: &Camera,
    watch: &Watch,
    times: &mut SamplingSeconds,
) -> Result<(Film, Option<usize>)> {
    let options = RenderOptions::default().with_samples(args.spp).with_seed(args.seed);
    let (film, patches);
    match args.method {
        Method::Path => {
            let next_event = !args.no_next_event;
            let paths = PathTracer::new(scene, tracer, PathOptions::default().with_next_event(next_event));
            (film, times.sampling) =
                watch.stage("paths", || Film::render(&paths, camera, &options, watch.progress()))?;
            patches = None;
        }
        Method::Light => {
            let pixels = (camera.width() * camera.height()) as u64;
            let particles = pixels * u64::from(args.spp);
            let options = LightOptions::default().with_particles(particles).with_seed(args.seed);
            let light = LightTracer::new(scene, tracer, options);
            let made = watch.stage("particles", || {
                light.image(camera, watch.progress()).map_err(|e| pipeline::blame(&args.scene.path, e))
            });
            let image;
            (image, times.sampling) = made?;
            (film, patches) = (image.film, None);
        }
        Method::Radiosity => {
            let job = args.job();
            job.check(scene, watch)?;
            let Solved { patches: solved, solution, .. } =
                job.solve(scene, tracer, watch, &mut times.stages)?;
            (film, times.sampling) = watch.stage("picture", || {
                let solution = (&solved, &solution);
                let make = if args.false_colour { picture::irradiance } else { picture::render };
                make(scene, tracer, solution, camera, args.final_gather, &options, watch.progress())
            })?;
            patches = Some(solved.len());
        }
    }
    Ok((film, patches))
}
