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
    In a .png radiance is multiplied by the exposure, clipped at white and encoded as sRGB; there is no other curve, \
    and the same --white makes pictures comparable. A .exr or .hdr holds the radiance itself, W/(m2 sr).")]
pub struct RenderArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// Write the picture: .png, .exr or .hdr
    #[arg(short, long, value_name = "OUT.png|.exr|.hdr")]
    output: PathBuf,
    /// Write all figures as JSON
    #[arg(long, value_name = "R.json")]
    report: Option<PathBuf>,
    /// How light is followed
    #[arg(long, value_enum, default_value_t = Method::Path)]
    method: Method,
    /// Samples a pixel: paths, or particles on average
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..))]
    spp: u32,
    /// Path tracing without looking at emitters: light counts only where a path runs into it
    #[arg(long)]
    no_next_event: bool,
    /// With --method radiosity: gather the last bounce by N rays a sample, instead of smoothing the patches
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=65536))]
    final_gather: Option<u32>,
    #[command(flatten)]
    camera: CameraArgs,
    /// Make the picture brighter, by stops; negative is darker
    #[arg(long, value_name = "STOPS", default_value_t = 0.0, value_parser = stops)]
    exposure: f64,
    /// Radiance to show as white, W/(m2 sr) [default: chosen by the picture]
    #[arg(long, value_name = "RADIANCE", value_parser = white)]
    white: Option<f64>,
    /// Another seed casts other rays; the same gives the same bytes
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    common: Common,
    #[command(flatten, next_help_heading = "With --method radiosity")]
    cast: CastArgs,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Method {
    /// Paths from the camera to the light
    Path,
    /// Particles from the light to the camera
    Light,
    /// The radiosity of patches
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

/// Particles that a run of light tracing can number.
const MOST_PARTICLES: u64 = 1 << 36;

impl RenderArgs {
    /// Refuses options that the method has no use for.
    fn check(&self) -> Result<()> {
        let usage = |message: String, hint: &str| Err(Error::Usage { message, hint: Some(hint.into()) });
        if self.no_next_event && self.method == Method::Light {
            let message = "light tracing needs next event estimation: no particle ever meets a pinhole";
            return usage(message.into(), "leave --no-next-event out, or use --method path");
        }
        let foreign = match self.method {
            Method::Radiosity => self.no_next_event.then_some("--no-next-event"),
            _ => self.final_gather.map(|_| "--final-gather").or(self.cast.given()),
        };
        if let Some(option) = foreign {
            let message = format!("{option} is not for --method {}", self.method.name());
            let other = if self.method == Method::Radiosity { "path" } else { "radiosity" };
            return usage(message, &format!("leave it out, or use --method {other}"));
        }
        Ok(())
    }

    /// Refuses an exposure of a picture that holds radiance.
    fn check_exposure(&self, format: PictureFormat) -> Result<()> {
        let given = self.white.map(|_| "--white").or((self.exposure != 0.0).then_some("--exposure"));
        match given.filter(|_| format != PictureFormat::Png) {
            None => Ok(()),
            Some(option) => Err(Error::Usage {
                message: format!("{option} is for .png: {} holds the radiance itself", self.output.display()),
                hint: Some(format!("leave {option} out, or end the name in .png")),
            }),
        }
    }

    fn job(&self) -> Job<'_> {
        Job { file: &self.scene.path, cast: &self.cast, seed: self.seed, limit: self.common.limit() }
    }

    /// Refuses pictures that neither memory nor a day's work can hold.
    fn check_size(&self, camera: &Camera) -> Result<()> {
        let pixels = (camera.width() * camera.height()) as u64;
        self.common.limit().check_picture(pixels as f64, self.method == Method::Light)?;
        if self.method == Method::Light && pixels.saturating_mul(self.spp.into()) > MOST_PARTICLES {
            return Err(Error::Usage {
                message: format!("{} particles for each of {pixels} pixels are too many", self.spp),
                hint: Some("give a smaller --spp or fewer pixels".into()),
            });
        }
        Ok(())
    }

    /// What the picture's white is.
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
                "mirrors are dark in the picture: no particle that leaves one meets the camera's pinhole; \
                 --method path shows what they reflect",
            );
        }
        (scene, tracer)
    };
    let camera = args.camera.camera(&scene, &tracer)?;
    args.check_size(&camera)?;
    camera::check(&args.camera, &camera, &scene, &tracer, &watch)?;
    let (film, patches) = picture(args, &scene, &tracer, &camera, &watch, &mut times)?;
    let exposure = args.exposure(&film);

    watch.begin_writing();
    let (written, seconds_writing) =
        watch.stage("writing", || file.write(|out| film.encode(out, format, exposure)))?;
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

/// The picture, and how many patches it took.
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
                picture::render(
                    scene,
                    tracer,
                    solution,
                    camera,
                    args.final_gather,
                    &options,
                    watch.progress(),
                )
            })?;
            patches = Some(solved.len());
        }
    }
    Ok((film, patches))
}
