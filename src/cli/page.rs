//! The option `--page`: a scene to walk through in a browser.

use std::{
    cell::Cell,
    io::{self, Write},
    path::{Path, PathBuf},
};

use clap::Args;
use radiosity::{
    Error, Progress, Result, Scene,
    accuracy::solved::Solved,
    monte_carlo::Camera,
    output::{
        file::{OutputFile, Pending},
        page::{self, LARGE, Method, PageOptions},
    },
    patch::Patches,
    solve::{
        Light, SolveOptions,
        by_lamp::{LampLight, by_lamp},
    },
    tone::Exposure,
    trace::Tracer,
};

use super::{options::SceneArgs, outputs, sampling::Answer, watch::Watch};

/// The picture that the first view is framed for.
const WIDTH: usize = 640;
const HEIGHT: usize = 480;

/// The page of `solve` and `view`.
#[derive(Args)]
pub struct PageArgs {
    /// Write a page to walk through in a browser, with error bars to read. It is one file and needs no server
    #[arg(long, value_name = "OUT.html")]
    pub page: Option<PathBuf>,
    /// Most lamps that have a slider each in the page [default: 8, fewer if the page would exceed 10 MB]. 0 or 1 makes none. Each
    /// costs a solution of the linear system
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=64))]
    page_lamps: Option<u32>,
}

/// The output file of a page.
pub fn file(path: &Path, scene: &Path) -> Result<OutputFile> {
    let is_html =
        path.extension().is_some_and(|e| e.eq_ignore_ascii_case("html") || e.eq_ignore_ascii_case("htm"));
    if !is_html {
        return Err(Error::Usage {
            message: format!("{}: the name of a page must end in .html", path.display()),
            hint: Some("give it a name like room.html".into()),
        });
    }
    outputs::text(path, &[scene], "a page")
}

/// The first view, with the direction upwards that the options give.
pub fn camera(args: &SceneArgs, scene: &Scene, tracer: &Tracer) -> Result<Camera> {
    let framed = Camera::frame(scene, tracer, WIDTH, HEIGHT)?;
    let (eye, look_at) = (framed.eye(), framed.look_at());
    let up = args.lights.upwards(look_at - eye).unwrap_or(framed.up());
    Camera::new(eye, look_at, up, framed.fov(), WIDTH, HEIGHT)
}

/// The title of the page of a scene: the name of its file.
pub fn title(scene: &Path) -> String {
    scene.file_name().unwrap_or(scene.as_os_str()).to_string_lossy().into_owned()
}

/// Writes a page, and warns if it is large.
pub fn write(
    file: OutputFile,
    watch: &Watch,
    contents: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<Pending> {
    let (path, bytes) = (file.path().to_owned(), Cell::new(0));
    let pending = file.write(|out| contents(&mut Counted { out, bytes: &bytes }))?;
    if bytes.get() > LARGE {
        watch.warn(&format!(
            "{}: the page has {} MB, and browsers will take long to open it: use fewer patches for a page",
            path.display(),
            bytes.get() / 1_000_000
        ));
    }
    Ok(pending)
}

/// Counts what is written.
struct Counted<'a> {
    out: &'a mut dyn Write,
    bytes: &'a Cell<u64>,
}

impl Write for Counted<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.out.write(bytes)?;
        self.bytes.set(self.bytes.get() + written as u64);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

/// A solution to write.
pub struct Solution<'a> {
    pub args: &'a SceneArgs,
    pub scene: &'a Scene,
    pub tracer: &'a Tracer,
    pub answer: &'a Answer,
    pub exposure: Exposure,
    pub options: SolveOptions,
}

impl PageArgs {
    /// Writes the page of a solution.
    pub fn write(&self, file: OutputFile, solution: &Solution, watch: &Watch) -> Result<Pending> {
        let Solution { scene, tracer, answer, .. } = *solution;
        let (patches, light) = (answer.patches(), answer.light());
        let (lamps, left_out) = self.lamps(solution, watch.progress())?;
        let mut notes = notes(patches, light, &lamps);
        notes.extend(left_out);
        let discretisation = answer.errors().and_then(|errors| errors.of_patches());
        let title = title(&solution.args.path);
        let options = PageOptions::default()
            .with_title(&title)
            .with_discretisation(discretisation)
            .with_exposure(Some(solution.exposure))
            .with_notes(notes);
        let method = Method::new("radiosity", light)
            .with_standard_error(Some(answer.standard_error()))
            .with_lamps(&lamps);
        let camera = camera(solution.args, scene, tracer)?;
        write(file, watch, |out| page::encode(out, scene, patches, &camera, &[method], &options))
    }

    /// The light of each lamp, and a sentence if it is left out.
    fn lamps(&self, solution: &Solution, progress: &Progress) -> Result<(Vec<LampLight>, Option<String>)> {
        let Solution { scene, answer, ref options, .. } = *solution;
        let left_out =
            |why: &str| Ok((Vec::new(), Some(format!("There are no sliders for single lamps: {why}."))));
        let Answer::Matrix(solved, _) = answer else {
            return left_out("they need form factors, and the solver stored none");
        };
        let Solved { patches, form_factors, solution: whole, .. } = &**solved;
        let fit = page::lamps_that_fit(patches);
        let most = self.page_lamps.map_or(fit, |n| n as usize);
        if most < 2 {
            let why =
                if self.page_lamps.is_some() { "none were asked for" } else { "the page would exceed 10 MB" };
            return left_out(why);
        }
        Ok((by_lamp(scene, (form_factors, patches), whole, most, options, progress)?, None))
    }
}

/// What the page says about the solution.
fn notes(patches: &Patches, light: Light, lamps: &[LampLight]) -> Vec<String> {
    let mut notes = vec![format!(
        "radiosity {}: the light on {} patches. Light is drawn smoothly between patches; a click reads the mean of a patch.",
        env!("CARGO_PKG_VERSION"),
        patches.len()
    )];
    notes.push(
        "White is clipped, and there is no tone curve: below white the picture is proportional to the light."
            .into(),
    );
    if !light.slopes.is_empty() {
        notes.push("Light is linear over each patch.".into());
    }
    if !lamps.is_empty() {
        notes.push(
            "Each lamp has its own solution over the same form factors, so that sliders mix them exactly."
                .into(),
        );
    }
    notes
}
