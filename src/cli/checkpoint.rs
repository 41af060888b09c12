//! `--checkpoint` and `--cast-only` of `solve`: files of rays, and processes that cast parts of them.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use clap::Args;
use radiosity::{
    Error, Ranks, Result, Scene,
    form_factor::{CastOptions, CastState, Checkpoint, FormFactors, Part},
    output::{file::OutputFile, report::Seconds},
    patch::Patches,
};

use super::{
    Outcome,
    forecast::{self, Work},
    outputs, pipeline,
    solve::SolveArgs,
    to_stderr, to_stdout,
    watch::Watch,
};

/// Characters of a pattern of file names.
const WILD: [char; 2] = ['*', '?'];

/// Files of rays.
#[derive(Args)]
pub struct CheckpointArgs {
    /// More files of rays for --checkpoint
    #[arg(value_name = "FILE")]
    more: Vec<PathBuf>,
    /// Keep the hits of all rays in this file. After an interruption, the same command continues from it and reaches
    /// the same result. A run with more --rays or a lower --error can continue from it, too. With several files, or a
    /// pattern in quotes such as 'part-*', rays are read from all of them, and new rays go to the first one
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    /// Cast rays into the file of --checkpoint, and end without a solution. `solve` with the same options and this file
    /// then has the same result as without it, and takes less time
    #[arg(long, requires = "checkpoint")]
    pub cast_only: bool,
    /// With --cast-only, cast one part of the rays, for example 3/16. The other parts can run on other machines. See
    /// docs/guides/clusters.md
    #[arg(long, value_name = "K/N", requires = "cast_only", value_parser = |text: &str| text.parse::<Part>())]
    part: Option<Part>,
}

impl CheckpointArgs {
    /// Whether rays are kept.
    pub fn is_given(&self) -> bool {
        self.checkpoint.is_some()
    }

    /// Refuses more files without a checkpoint.
    pub fn check(&self) -> Result<()> {
        match self.more.first().filter(|_| self.checkpoint.is_none()) {
            None => Ok(()),
            Some(file) => Err(Error::Usage {
                message: format!("{}: the command takes one scene", file.display()),
                hint: Some("name an output with -o, and files of rays with --checkpoint".into()),
            }),
        }
    }

    /// The files: the one that gets new rays, checked as an output, and those that are only read.
    pub fn files(&self, scene: &Path) -> Result<Option<Files>> {
        let Some(first) = &self.checkpoint else { return Ok(None) };
        let mut paths: Vec<PathBuf> = Vec::new();
        for given in [first].into_iter().chain(&self.more) {
            for path in matching(given)? {
                if !paths.iter().any(|known| is_same(known, &path)) {
                    paths.push(path);
                }
            }
            // Before the first part runs, the files of the others need not exist.
            if paths.is_empty() || !self.cast_only && is_pattern(given) && matching(given)?.is_empty() {
                return Err(Error::Usage {
                    message: format!("{}: no file has a name like this", given.display()),
                    hint: Some("cast rays first, with --cast-only".into()),
                });
            }
        }
        let ranks = Ranks::world();
        if ranks.count() > 1 {
            paths.splice(0..1, files_of_ranks(&paths[0], ranks)?);
            // No rank makes its file before all have found those of an earlier run.
            ranks.wait();
        }
        let written = outputs::checkpoint(&paths[0], scene)?;
        Ok(Some(Files { paths, written }))
    }
}

/// The files of a checkpoint.
pub struct Files {
    /// The file that gets new rays, and then the files that are only read.
    pub paths: Vec<PathBuf>,
    /// The first file.
    pub written: OutputFile,
}

impl Files {
    /// Opens the files and prints the number of their rays.
    pub fn open(&self, scene: &Scene, args: &SolveArgs, watch: &Watch) -> Result<Arc<Checkpoint>> {
        let checkpoint = match args.checkpoint.cast_only {
            true => {
                let part = args.checkpoint.part.unwrap_or(Part::WHOLE);
                Checkpoint::open_part(&self.paths, part, scene, args.seed)
            }
            false => Checkpoint::open_all(&self.paths, scene, args.seed),
        }?;
        for (k, (path, bytes)) in checkpoint.torn().iter().enumerate() {
            let done = if k == 0 && *path == self.paths[0] { "removed" } else { "ignored" };
            watch.warn(&format!(
                "{}: {done} the last {bytes} bytes, which an interrupted run left incomplete",
                path.display()
            ));
        }
        if checkpoint.found() > 0 && !args.common.quiet {
            let holds = match self.paths.len() {
                1 => "it holds".into(),
                n => format!("these {n} files hold"),
            };
            let found = checkpoint.found();
            watch.say(&format!("{}: {holds} {found} rays of earlier runs", self.name()));
        }
        Ok(Arc::new(checkpoint))
    }

    /// The files in messages.
    fn name(&self) -> String {
        match &self.paths[..] {
            [one] => one.display().to_string(),
            [first, .., last] => format!("{} to {}", first.display(), last.display()),
            [] => unreachable!("there is a first file"),
        }
    }

    /// Says how to continue after an interruption.
    pub fn say_stopped(&self) {
        let path = &self.paths[0];
        if path.exists() && Ranks::world().is_first() {
            to_stderr(format_args!(
                "{} holds the rays cast so far: the same command continues from there",
                path.display()
            ));
        }
    }

    /// Says how many rays no file held.
    pub fn say_added(&self, checkpoint: &Checkpoint, watch: &Watch) {
        let added = checkpoint.rays() - checkpoint.found();
        if self.paths.len() > 1 && added > 0 {
            let share = 100.0 * added as f64 / checkpoint.rays() as f64;
            watch.say(&format!(
                "no file held {added} rays, {share:.1} % of all; they were cast here, and are in {} now",
                self.paths[0].display()
            ));
        }
    }
}

/// Casts rays into the checkpoint.
pub fn cast_only(args: &SolveArgs, files: &Files, outputs: &[&OutputFile]) -> Result<Outcome> {
    let watch = Watch::new(args.common.quiet);
    let (scene, tracer) = pipeline::load(&args.scene, outputs, &watch, &mut Seconds::default())?;
    args.cast.too_few(&scene).iter().for_each(|warning| watch.warn(warning));
    let (subdivision, _) = args.cast.subdivision();
    let rays = f64::from(args.cast.rays());
    let with_backs = forecast::with_backs(&scene, &tracer, args.seed);
    let bytes = forecast::bytes(&scene, args.estimator(), args.solve_options().solver);
    let work = Work {
        scene: &scene,
        patches: Patches::forecast(&scene, &subdivision),
        rays,
        bytes: &|fronts, rays| bytes(with_backs * fronts, rays),
        options: forecast::USUAL,
    };
    args.common.limit().check(&work)?.iter().for_each(|warning| watch.warn(warning));
    let checkpoint = files.open(&scene, args, &watch)?;
    let (mut patches, _) = watch.stage("patches", || Ok(Patches::subdivide(&scene, &subdivision)))?;
    let cast = CastOptions::default().with_rays(rays).with_estimator(args.estimator()).with_seed(args.seed);
    let (state, _) = watch.stage("rays", || {
        let checkpoint = Arc::clone(&checkpoint);
        FormFactors::cast_only(&scene, &tracer, &mut patches, &cast, checkpoint, watch.progress())
    })?;
    drop(watch);
    if !args.common.quiet {
        to_stdout(&summary(&checkpoint, state, &files.paths[0]))?;
    }
    Ok(Outcome::Done)
}

/// What was done, and what to do next.
fn summary(checkpoint: &Checkpoint, state: CastState, file: &Path) -> String {
    let part = checkpoint.part();
    let of = if part == Part::WHOLE { "all rays".into() } else { part.to_string() };
    let added = checkpoint.rays() - checkpoint.found();
    let lacking = checkpoint.lacking();
    let next = match state {
        CastState::Whole => "all rays are cast: leave out --cast-only to solve".into(),
        CastState::PartCast => format!(
            "this part is cast, and {lacking} rays of other parts are not here: solve when these parts are cast, too"
        ),
        CastState::Waiting => format!(
            "the next rays depend on {lacking} rays of other parts: run this command again when these are cast, with their files"
        ),
    };
    format!("{}: {of}, {added} rays added\n{next}\n", file.display())
}

/// The file of this rank, and the files that ranks of an earlier run wrote. They have the name of the checkpoint with the
/// number of the rank.
fn files_of_ranks(path: &Path, ranks: Ranks) -> Result<Vec<PathBuf>> {
    let numbered = |rank: &str| {
        let mut name = path.as_os_str().to_owned();
        name.push(format!(".{rank}"));
        PathBuf::from(name)
    };
    let own = numbered(&ranks.rank().to_string());
    let is_of_rank = |file: &PathBuf| {
        file.extension().is_some_and(|end| end.to_string_lossy().bytes().all(|b| b.is_ascii_digit()))
    };
    let mut files = matching(&numbered("*"))?;
    files.retain(|file| is_of_rank(file) && *file != own);
    files.insert(0, own);
    files.extend(path.exists().then(|| path.to_owned()));
    Ok(files)
}

/// Whether a name is a pattern and not the name of a file.
fn is_pattern(path: &Path) -> bool {
    !path.exists() && path.to_str().is_some_and(|text| text.contains(WILD))
}

/// The files with names like this, sorted.
fn matching(path: &Path) -> Result<Vec<PathBuf>> {
    if !is_pattern(path) {
        return Ok(vec![path.to_owned()]);
    }
    let wrong = |e: glob::PatternError| Error::Usage {
        message: format!("{}: {e}", path.display()),
        hint: Some("* stands for any characters, and ? for one".into()),
    };
    let files = glob::glob(&path.to_string_lossy()).map_err(wrong)?;
    files.map(|file| file.map_err(|e| Error::io(e.path(), std::io::Error::from(e.error().kind())))).collect()
}

/// Whether two names are those of the same file.
fn is_same(one: &Path, other: &Path) -> bool {
    one == other
        || fs::canonicalize(one).is_ok_and(|one| fs::canonicalize(other).is_ok_and(|other| one == other))
}
