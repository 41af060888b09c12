//! `radiosity bake`: a lightmap.

use std::{
    path::{Path, PathBuf},
    time::Instant,
};

use clap::{Args, ValueEnum};
use radiosity::{
    Error, Result, Scene,
    energy::EnergyLedger,
    lightmap::{
        self, Atlas, AtlasOptions, BakeOptions, Coordinates, LARGEST, Layout, Lightmap, PAGE,
        gltf::Encoding,
        report::{BakeReport, BakeSeconds},
        write::{Layer, Picture, page_name},
    },
    monte_carlo::PictureFormat,
    output::{
        exposure,
        file::{OutputFile, Pending},
        gltf,
        page::PageOptions,
        report::{EnergyReport, SceneReport, peak_bytes, seconds},
    },
    tone::Exposure,
    trace::Tracer,
};

use super::{
    Common, Outcome,
    options::{CastArgs, SceneArgs, finite_length, stops},
    outputs::{self, Directory},
    page, per_light,
    pipeline::{self, Job, Solved},
    summary, to_stdout,
    watch::Watch,
};

/// The report in the output directory.
const REPORT: &str = "report.json";
/// Texels per side of a page, by default.
const RESOLUTION: u32 = 512;

/// Bake a lightmap: the irradiance of all surfaces as an image, with a mesh that fits
#[derive(Args)]
#[command(after_help = "Example:\n  radiosity bake room.obj -o room-lit/ --resolution 1024\n\n\
    Written to DIR:\n  \
      lightmap.exr, .hdr      irradiance, W/m2, linear R G B\n  \
      lightmap.png            irradiance for viewing\n  \
      scene.obj, .mtl         the mesh; its materials emit scene.png\n  \
      scene.png               radiosity for viewing, without lights\n  \
      scene-original-uv.obj   the same faces with the scene's texture coordinates\n  \
      report.json             all figures\n  \
      .radiosity              the list of files that a later bake may replace\n\
    Further pages are called lightmap-2.exr and so on.\n\n\
    With -o NAME.glb one glTF file holds the lit scene, with everything else that a glTF scene contained. NAME.exr beside \
    it holds the irradiance.\n\n\
    With --per-light, lightmap-LIGHT.exr (or NAME-LIGHT.exr) holds the irradiance of one emitting material or light alone. These maps sum to \
    the whole map, up to rounding.\n\n\
    The map shows the side of each face that has more light, or both with --two-sided. The texture coordinates of the \
    scene are used if they lie in 0..1, do not overlap, leave room between charts and use half of the texels. Otherwise new \
    coordinates are made, and the report gives the reason. Long faces may be cut for them. A file that no earlier bake wrote is never replaced.")]
pub struct BakeArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// Write the files into this directory, which is created if it is missing, or write one glTF file
    #[arg(short, long, value_name = "DIR|NAME.glb")]
    output: PathBuf,
    /// Form of the map in a glTF file: `emissive` materials, which every viewer shows; the extension MOZ_lightmap
    /// (`moz`); or only texture coordinates (`uv`)
    #[arg(long, value_enum, value_name = "HOW", default_value_t = GltfLightmap::Emissive)]
    gltf_lightmap: GltfLightmap,
    /// Write a page that shows the lit scene in a browser. It is one file and needs no server
    #[arg(long, value_name = "OUT.html")]
    page: Option<PathBuf>,
    /// Write the report to this file too
    #[arg(long, value_name = "R.json")]
    report: Option<PathBuf>,
    /// Texels per side of a page [default: 512; with --texel up to 4096]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=LARGEST as i64))]
    resolution: Option<u32>,
    /// Length of a texel, in the unit of the scene. The map has as many pages as it needs
    #[arg(long, value_name = "LENGTH", value_parser = finite_length)]
    texel: Option<f64>,
    /// Rays per texel for the final gather. With 0, texels have the irradiance of the patches, and the flux is exact
    #[arg(long, value_name = "N", default_value_t = BakeOptions::default().final_gather,
        value_parser = clap::value_parser!(u32).range(0..=65536))]
    final_gather: u32,
    /// Use the texture coordinates of the scene, or fail
    #[arg(long)]
    keep_uv: bool,
    /// Make new texture coordinates, even if the coordinates of the scene could be used
    #[arg(long, conflicts_with = "keep_uv")]
    new_uv: bool,
    /// Give both sides of a face texels if light reaches both. The mesh gets a second face for the back
    #[arg(long, conflicts_with = "keep_uv")]
    two_sided: bool,
    /// Also write the irradiance of each emitting material and each light alone, as .exr files. They share the rays of
    /// the solution, and each takes another final gather
    #[arg(long)]
    per_light: bool,
    /// Make the texels of a material FACTOR times shorter than other texels. May be repeated
    #[arg(long, value_name = "MATERIAL=FACTOR", value_parser = density, conflicts_with = "keep_uv")]
    density: Vec<(String, f64)>,
    /// Do not denoise the final gather
    #[arg(long)]
    no_denoise: bool,
    /// Do not fill texels without surface from their neighbours
    #[arg(long)]
    no_dilate: bool,
    /// Do not smooth the map across seams
    #[arg(long)]
    no_seams: bool,
    /// Write mask.png too: white is surface, grey is hidden surface, dark grey is filled from neighbours, black is
    /// empty
    #[arg(long)]
    mask: bool,
    /// Write standard-error.exr too: the standard error of the final gather, W/m2
    #[arg(long)]
    standard_error: bool,
    /// Make the .png files brighter by this number of stops. A negative number makes them darker
    #[arg(long, value_name = "STOPS", default_value_t = 0.0, value_parser = stops)]
    exposure: f64,
    /// Seed of the random numbers. The same seed gives the same bytes
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    common: Common,
    #[command(flatten, next_help_heading = "Solution")]
    cast: CastArgs,
}

/// Names of [`Encoding`].
#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum GltfLightmap {
    Emissive,
    Moz,
    Uv,
}

impl BakeArgs {
    fn encoding(&self) -> Encoding {
        match self.gltf_lightmap {
            GltfLightmap::Emissive => Encoding::Emissive,
            GltfLightmap::Moz => Encoding::Moz,
            GltfLightmap::Uv => Encoding::Coordinates,
        }
    }

    fn layout(&self) -> Layout {
        match self.texel {
            Some(length) => Layout::Texel(length, self.resolution.map_or(PAGE, |n| n as usize)),
            None => Layout::Resolution(self.resolution.unwrap_or(RESOLUTION) as usize),
        }
    }

    fn coordinates(&self) -> Coordinates {
        match (self.keep_uv, self.new_uv) {
            (true, _) => Coordinates::File,
            (_, true) => Coordinates::New,
            _ => Coordinates::Auto,
        }
    }

    /// The layout of the map. The solution determines later which faces need both sides.
    fn atlas(&self, scene: &Scene) -> Result<AtlasOptions> {
        let mut options = AtlasOptions::new(self.layout(), self.coordinates());
        for (name, factor) in &self.density {
            let before = options.density.len();
            let of_name = scene.materials.iter().enumerate().filter(|(_, m)| m.name == *name);
            options.density.extend(of_name.map(|(m, _)| (m as u32, *factor)));
            if options.density.len() == before {
                return Err(Error::Usage {
                    message: format!(
                        "--density: no face of {} has material `{name}`",
                        self.scene.path.display()
                    ),
                    hint: Some("`radiosity inspect` lists the materials".into()),
                });
            }
        }
        Ok(options)
    }

    pub fn options(&self) -> BakeOptions {
        BakeOptions::default()
            .with_final_gather(self.final_gather)
            .with_denoise(!self.no_denoise)
            .with_dilate(!self.no_dilate)
            .with_close_seams(!self.no_seams)
            .with_seed(self.seed)
    }

    fn check(&self) -> Result<()> {
        if self.standard_error && self.final_gather == 0 {
            return Err(Error::Usage {
                message: "--standard-error needs a final gather".into(),
                hint: Some("leave --final-gather 0 out".into()),
            });
        }
        Ok(())
    }

    pub fn job(&self) -> Job<'_> {
        Job { file: &self.scene.path, cast: &self.cast, seed: self.seed, limit: self.common.limit() }
    }
}

/// Runs the command.
pub fn run(args: &BakeArgs) -> Result<Outcome> {
    let start = Instant::now();
    args.check()?;
    // The report in the output directory is written anyway.
    let elsewhere = args.report.as_ref().filter(|path| **path != args.output.join(REPORT));
    let report_file = elsewhere.map(|path| outputs::report(path, &args.scene.path)).transpose()?;
    let page_file = args.page.as_ref().map(|path| page::file(path, &args.scene.path)).transpose()?;
    args.common.start_threads()?;
    let watch = Watch::new(args.common.quiet);
    let mut times = BakeSeconds::default();
    let apart: Vec<&OutputFile> = report_file.iter().chain(&page_file).collect();
    let (scene, tracer) = pipeline::load(&args.scene, &apart, &watch, &mut times.stages)?;
    args.job().check(&scene, &watch)?;
    let directory = match outputs::is_glb(&args.output) {
        true => None,
        false => Some(Directory::new(&args.output, "bake")?),
    };
    let mut layout = args.atlas(&scene)?;
    // With two sides, the layout needs the solution. Otherwise the layout comes first, because it may be refused.
    let solve = |times: &mut BakeSeconds| args.job().solve(&scene, &tracer, &watch, &mut times.stages);
    let solved = if args.two_sided { Some(solve(&mut times)?) } else { None };
    if let Some(Solved { patches, solution, .. }) = &solved {
        layout.two_sided = lightmap::lit_on_both_sides(patches, solution);
    }
    let atlas;
    (atlas, times.atlas) = watch.stage("atlas", || Atlas::with(&scene, &tracer, &layout))?;
    let names = if args.per_light { per_light::names(&scene) } else { Vec::new() };
    args.common.limit().check_map((1 + names.len()) as f64 * atlas.texels() as f64)?;
    let stems = per_light::stems(&names);
    let files = match &directory {
        Some(directory) => Files::new(args, directory, &atlas, &scene, &stems)?,
        None => Files::of_glb(args, &atlas, &stems)?,
    };
    let all: Vec<&OutputFile> = files.0.iter().map(|file| &file.output).chain(apart).collect();
    outputs::check_distinct(&all)?;
    all.iter().try_for_each(|output| output.check_inputs(&scene.files))?;

    let solved = solved.map_or_else(|| solve(&mut times), Ok)?;
    let alone = per_light::solutions(args, (&scene, &tracer), &solved, &names, &watch)?;
    let (map, mut report, exposures) = compute(args, (&scene, &tracer), atlas, solved, &watch, &mut times)?;
    let (alone, _) = watch
        .stage("texels", || lightmap::divide(&map, &tracer, &alone, &args.options(), watch.progress()))?;
    for warning in &report.warnings {
        watch.warn(warning);
    }
    watch.begin_writing();
    report.files = files.0.iter().map(|file| file.name.clone()).collect();
    let mut pending = Vec::new();
    if let Some(directory) = &directory {
        let names = report.files.iter().map(String::as_str).chain([REPORT]);
        pending.push(directory.marker(names)?);
    }
    let written;
    (written, times.stages.output) =
        watch.stage("writing", || files.write(args, (&map, &alone), &scene, &exposures))?;
    pending.extend(written);
    if let Some(file) = page_file {
        pending.push(write_page(args, file, &map, (&scene, &tracer), exposures.radiosity, &watch)?);
    }
    times.stages.total = seconds(start.elapsed());
    report.seconds = times;
    report.peak_bytes = peak_bytes();
    let inside =
        directory.as_ref().map(|directory| directory.file(REPORT, &[&args.scene.path])).transpose()?;
    let reports = inside.into_iter().chain(report_file);
    for file in reports {
        pending.push(file.write(|out| report.write(out))?);
    }
    watch.progress().check()?;
    Pending::commit_all(pending)?;
    drop(watch);
    if !args.common.quiet {
        to_stdout(&summary::bake(&report, &args.output.display().to_string()))?;
    }
    Ok(Outcome::Done)
}

fn write_page(
    args: &BakeArgs,
    file: OutputFile,
    map: &Lightmap,
    (scene, tracer): (&Scene, &Tracer),
    exposure: Exposure,
    watch: &Watch,
) -> Result<Pending> {
    let title = page::title(&args.scene.path);
    let notes = vec![format!(
        "radiosity {}: a lightmap of {} by {} texels. A click reads the texel.",
        env!("CARGO_PKG_VERSION"),
        map.atlas().width,
        map.atlas().height
    )];
    let options = PageOptions::default().with_title(&title).with_exposure(Some(exposure)).with_notes(notes);
    let camera = page::camera(&args.scene, scene, tracer)?;
    page::write(file, watch, |out| map.write_page(scene, &camera, &options, out))
}

/// Reads a material's name and a positive factor. Names may contain `=`.
fn density(text: &str) -> std::result::Result<(String, f64), String> {
    let (name, factor) = text.rsplit_once('=').ok_or("expected MATERIAL=FACTOR, as in floor=2")?;
    let factor: f64 = factor.trim().parse().map_err(|_| format!("`{factor}` is not a number"))?;
    // In a wider range, no page could hold both kinds of charts.
    if (1e-3..=1e3).contains(&factor) {
        Ok((name.to_owned(), factor))
    } else {
        Err("expected a factor from 0.001 to 1000".into())
    }
}

/// Exposures of the pictures of irradiance and of radiosity.
struct Exposures {
    irradiance: Exposure,
    radiosity: Exposure,
}

fn compute(
    args: &BakeArgs,
    (scene, tracer): (&Scene, &Tracer),
    atlas: Atlas,
    Solved { patches, form_factors, solution }: Solved,
    watch: &Watch,
    times: &mut BakeSeconds,
) -> Result<(Lightmap, BakeReport, Exposures)> {
    let energy = EnergyLedger::of(&form_factors, &patches, &solution);
    // Texels need only the solution. Dropping the form factors frees memory.
    drop(form_factors);
    let map;
    (map, times.texels) = watch.stage("texels", || {
        lightmap::bake(scene, tracer, (&patches, &solution), atlas, &args.options(), watch.progress())
    })?;
    let exposures = Exposures {
        irradiance: map.exposure().brighter(args.exposure),
        radiosity: exposure::of_radiosity(&patches, &solution.radiosity).brighter(args.exposure),
    };
    let file = args.scene.path.display().to_string();
    let scene_report = SceneReport::of(&file, scene, &patches);
    let energy = EnergyReport::of(&energy);
    let mut report = BakeReport::new(&map, scene, scene_report, energy, &args.options());
    report.options.white = exposures.irradiance.white();
    Ok((map, report, exposures))
}

/// An output file.
struct File {
    name: String,
    output: OutputFile,
    kind: Kind,
}

#[derive(Clone, Copy)]
enum Kind {
    Picture(Picture, usize, PictureFormat),
    /// A page of the map of one light.
    Alone(usize, usize),
    Mesh,
    Materials,
    OriginalCoordinates,
    Glb,
}

/// The scene's material libraries, as files in a directory name them.
fn libraries(scene: &Scene, directory: &Path) -> Vec<String> {
    let is_library = |file: &&PathBuf| file.extension().is_some_and(|e| e.eq_ignore_ascii_case("mtl"));
    scene.files.iter().filter(is_library).map(|file| relative(file, directory)).collect()
}

/// The relative path from a directory to a file, with `/` on every system. The whole path if there is no relative path.
fn relative(file: &Path, directory: &Path) -> String {
    let [Ok(file), Ok(directory)] = [file, directory].map(std::fs::canonicalize) else {
        return file.display().to_string();
    };
    let common = file.components().zip(directory.components()).take_while(|(a, b)| a == b).count();
    if common == 0 {
        return file.display().to_string();
    }
    let up = directory.components().skip(common).map(|_| "..".into());
    let down = file.components().skip(common).map(|part| part.as_os_str().to_string_lossy());
    up.chain(down).collect::<Vec<std::borrow::Cow<str>>>().join("/")
}

/// All files except the report.
struct Files(Vec<File>);

impl Files {
    fn new(
        args: &BakeArgs,
        directory: &Directory,
        atlas: &Atlas,
        scene: &Scene,
        lights: &[String],
    ) -> Result<Files> {
        use PictureFormat::{Exr, Hdr, Png};
        let mut wanted = Vec::new();
        for page in 0..atlas.pages {
            for format in [Exr, Hdr, Png] {
                wanted.push(("lightmap", Picture::Irradiance, page, format));
            }
            wanted.push(("scene", Picture::Radiosity, page, Png));
            if args.mask {
                wanted.push(("mask", Picture::Mask, page, Png));
            }
            if args.standard_error {
                wanted.push(("standard-error", Picture::StandardError, page, Exr));
            }
        }
        let pictures = wanted.into_iter().map(|(stem, what, page, format)| {
            (page_name(stem, page, format), Kind::Picture(what, page, format))
        });
        let mut meshes =
            vec![("scene.obj".to_owned(), Kind::Mesh), ("scene.mtl".to_owned(), Kind::Materials)];
        if atlas.refused.is_some() && !scene.texcoords.is_empty() {
            meshes.push(("scene-original-uv.obj".to_owned(), Kind::OriginalCoordinates));
        }
        let inputs: [&Path; 1] = [&args.scene.path];
        // The report is written last, but it is checked here with the other files.
        directory.file(REPORT, &inputs)?;
        let files = pictures
            .chain(of_lights("lightmap", atlas.pages, lights))
            .chain(meshes)
            .map(|(name, kind)| Ok(File { output: directory.file(&name, &inputs)?, name, kind }));
        Ok(Files(files.collect::<Result<_>>()?))
    }

    /// A glTF file, and the irradiance beside it.
    fn of_glb(args: &BakeArgs, atlas: &Atlas, lights: &[String]) -> Result<Files> {
        let (glb, scene) = (&args.output, &args.scene.path);
        let file = |output: OutputFile, kind| {
            let name = output.path().file_name().unwrap_or_default().to_string_lossy().into_owned();
            File { name, output, kind }
        };
        let mut files = vec![file(OutputFile::new(glb, &[scene])?, Kind::Glb)];
        for (page, name) in exr_names(glb, atlas.pages).into_iter().enumerate() {
            let kind = Kind::Picture(Picture::Irradiance, page, PictureFormat::Exr);
            files.push(file(outputs::beside_glb(glb, &name, scene)?, kind));
        }
        for (name, kind) in of_lights(&stem_of(glb), atlas.pages, lights) {
            files.push(file(outputs::beside_glb(glb, &name, scene)?, kind));
        }
        Ok(Files(files))
    }

    fn write(
        self,
        args: &BakeArgs,
        (map, alone): (&Lightmap, &[Lightmap]),
        scene: &Scene,
        exposures: &Exposures,
    ) -> Result<Vec<Pending>> {
        let mut layers: Vec<(Picture, Layer)> = Vec::new();
        let write_one = |file: File| match file.kind {
            Kind::Picture(what, page, format) => {
                let made = layers.iter().position(|(made, _)| *made == what).unwrap_or_else(|| {
                    layers.push((what, map.layer(scene, what)));
                    layers.len() - 1
                });
                let film = layers[made].1.page(page);
                let exposure = match what {
                    Picture::Irradiance | Picture::StandardError => exposures.irradiance,
                    Picture::Radiosity => exposures.radiosity,
                    Picture::Mask => Exposure::of_white(1.0),
                };
                file.output.write(|out| film.encode(out, format, exposure))
            }
            Kind::Alone(light, page) => {
                let film = alone[light].layer(scene, Picture::Irradiance).page(page);
                file.output.write(|out| film.encode(out, PictureFormat::Exr, exposures.irradiance))
            }
            Kind::Mesh => file.output.write(|out| map.write_obj(scene, "scene.mtl", out)),
            Kind::Materials => file
                .output
                .write(|out| map.write_mtl(scene, |page| page_name("scene", page, PictureFormat::Png), out)),
            Kind::OriginalCoordinates => {
                let libraries = libraries(scene, &args.output);
                file.output.write(|out| map.write_original(scene, &libraries, out))
            }
            Kind::Glb => {
                let source = gltf::Source::of(map.atlas().scene(scene), &args.scene.path)?;
                let names = exr_names(&args.output, map.atlas().pages);
                let bytes = map.glb(scene, &source, args.encoding(), exposures.radiosity, &names)?;
                file.output.write(|out| out.write_all(&bytes))
            }
        };
        self.0.into_iter().map(write_one).collect()
    }
}

/// Names and kinds of the files of single lights.
fn of_lights(stem: &str, pages: usize, lights: &[String]) -> Vec<(String, Kind)> {
    let of_page = |light: usize, page: usize| {
        let stem = format!("{stem}-{}", lights[light]);
        (page_name(&stem, page, PictureFormat::Exr), Kind::Alone(light, page))
    };
    (0..lights.len()).flat_map(|light| (0..pages).map(move |page| of_page(light, page))).collect()
}

fn stem_of(glb: &Path) -> String {
    glb.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// Names of the images of irradiance beside a glTF file, one per page.
fn exr_names(glb: &Path, pages: usize) -> Vec<String> {
    let stem = stem_of(glb);
    (0..pages).map(|page| page_name(&stem, page, PictureFormat::Exr)).collect()
}
