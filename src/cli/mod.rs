//! Commands, and what they tell the shell.
//!
//! Results go to files, a short summary to stdout, progress, warnings and errors to stderr. Exit status: 0 done; 1
//! computed, but a demanded check failed; 2 bad usage or input; 130 stopped by a signal.

mod bake;
mod camera;
mod forecast;
mod inspect;
mod models;
mod options;
mod outputs;
mod pipeline;
mod probe;
mod render;
mod sampling;
mod solve;
mod summary;
mod sweeps;
mod tradeoff;
mod validate;
mod view_factors;
mod watch;

use std::{
    any::TypeId,
    fmt::Display,
    io::{self, Write},
    num::NonZeroUsize,
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::{Arg, Args, CommandFactory, FromArgMatches, Parser, Subcommand, error::ErrorKind};
use radiosity::{Error, Result, Setting};

/// Computes how light spreads between diffuse surfaces, and how right its answer is.
#[derive(Parser)]
#[command(
    name = "radiosity",
    version,
    propagate_version = true,
    after_help = "Example:\n  radiosity solve room.obj -o room.ply --report room.json\n\n\
        Exit status: 0 done; 1 computed, but a check failed; 2 bad usage or input; 130 stopped."
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Solve(solve::SolveArgs),
    Validate(validate::ValidateArgs),
    Render(render::RenderArgs),
    Bake(bake::BakeArgs),
    Probe(probe::ProbeArgs),
    Inspect(inspect::InspectArgs),
    Tradeoff(tradeoff::TradeoffArgs),
    ViewFactors(view_factors::ViewFactorsArgs),
}

/// Threads that may be asked for whatever the machine: of many more than processors each waits for the others.
const MOST_THREADS: usize = 256;

/// Options of every command.
#[derive(Args)]
struct Common {
    /// Print no summary and no progress; warnings and errors remain
    #[arg(long)]
    quiet: bool,
    /// Use N threads; by default all processors. The result is the same for any number
    #[arg(long, value_name = "N")]
    threads: Option<NonZeroUsize>,
    /// Refuse at once what would take more memory, as in 500MB or 4GiB; what `solve` has no room for a matrix for, it solves
    /// without one [default: what this machine has]
    #[arg(long, value_name = "SIZE", value_parser = forecast::size)]
    memory: Option<f64>,
}

impl Common {
    fn limit(&self) -> forecast::Limit {
        forecast::Limit::new(self.memory)
    }

    fn start_threads(&self) -> Result<()> {
        let Some(threads) = self.threads else { return Ok(()) };
        let processors = std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
        let most = MOST_THREADS.max(processors);
        if threads.get() > most {
            return Err(Error::Usage {
                message: format!("--threads {threads} is more than {most}"),
                hint: Some(format!("this machine has {processors} processors: more threads gain nothing")),
            });
        }
        rayon::ThreadPoolBuilder::new().num_threads(threads.get()).build_global().map_err(|e| Error::Usage {
            message: format!("cannot start {threads} threads: {e}"),
            hint: Some("leave --threads out to use every processor once".into()),
        })
    }
}

/// How a computation that ended with a result went.
enum Outcome {
    Done,
    /// A demanded check failed: this one.
    CheckFailed(String),
}

const CHECK_FAILED: u8 = 1;
const BAD_INPUT: u8 = 2;
const STOPPED: u8 = 130;

/// Runs the command that the arguments name.
pub fn run() -> ExitCode {
    let command = match command().try_get_matches().and_then(|matches| Cli::from_arg_matches(&matches)) {
        Ok(cli) => cli.command,
        Err(error) => return usage_error(&error),
    };
    let result = match command {
        Command::Solve(args) => solve::run(&args),
        Command::Validate(args) => validate::run(&args),
        Command::Render(args) => render::run(&args),
        Command::Bake(args) => bake::run(&args),
        Command::Probe(args) => probe::run(&args),
        Command::Inspect(args) => inspect::run(&args),
        Command::Tradeoff(args) => tradeoff::run(&args),
        Command::ViewFactors(args) => view_factors::run(&args),
    };
    match result {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::CheckFailed(check)) => {
            say_error(&check);
            ExitCode::from(CHECK_FAILED)
        }
        Err(Error::Stopped) => {
            to_stderr("stopped");
            ExitCode::from(STOPPED)
        }
        Err(error) => {
            say_error(&error);
            if let Some(hint) = error.hint() {
                let options: Vec<&str> = error.settings().iter().filter_map(|&s| option(s)).collect();
                let named =
                    if options.is_empty() { String::new() } else { format!(" ({})", options.join(", ")) };
                to_stderr(format_args!("hint: {hint}{named}"));
            }
            ExitCode::from(if matches!(error, Error::NotConverged { .. }) { CHECK_FAILED } else { BAD_INPUT })
        }
    }
}

/// The option of a setting that the library has named in an error.
fn option(setting: Setting) -> Option<&'static str> {
    Some(match setting {
        Setting::Checkpoint => "--checkpoint",
        Setting::TexelLength => "--texel",
        Setting::Resolution => "--resolution",
        Setting::Coordinates => "without --keep-uv",
        Setting::Solver => "--solver",
        Setting::Estimator => "--estimator",
        Setting::Patches => "--patches",
        Setting::PictureSize => "--width, --height",
        Setting::FieldOfView => "--fov",
        Setting::Eye => "--eye",
        Setting::LookAt => "--look-at",
        Setting::Up => "--up",
        _ => return None,
    })
}

/// The commands as clap knows them. What looks like a negative number is taken for the value of an option: its own words say
/// better what is wrong with it than clap's advice to put `--` before it.
fn command() -> clap::Command {
    let is_number = |arg: &Arg| {
        let names_a_file = arg.get_value_parser().type_id() == TypeId::of::<PathBuf>();
        arg.get_action().takes_values() && !arg.is_positional() && !names_a_file
    };
    let numbers = |arg: Arg| if is_number(&arg) { arg.allow_negative_numbers(true) } else { arg };
    Cli::command().mut_subcommands(|command| command.mut_args(numbers))
}

/// Tells what clap says in the form that all errors have. Help and version are no errors.
fn usage_error(error: &clap::Error) -> ExitCode {
    if !error.use_stderr() || error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
        let _ = error.print();
        return if error.use_stderr() { ExitCode::from(BAD_INPUT) } else { ExitCode::SUCCESS };
    }
    let text = error.render().to_string();
    let (mut what, mut hints) = (String::new(), Vec::new());
    for (k, paragraph) in text.split("\n\n").enumerate() {
        let lines = paragraph.lines().map(str::trim);
        if k == 0 {
            what = lines.collect::<Vec<_>>().join(" ");
        } else {
            hints.extend(lines.filter_map(|line| line.strip_prefix("tip: ")));
        }
    }
    to_stderr(what);
    to_stderr(format_args!(
        "hint: {}",
        if hints.is_empty() { "try --help".into() } else { hints.join("; ") }
    ));
    ExitCode::from(BAD_INPUT)
}

fn say_error(what: &dyn Display) {
    to_stderr(format_args!("error: {what}"));
}

/// Prints a line, and one whatever names of files hold. Nobody reading is no reason to panic, which `eprintln!` would.
fn to_stderr(line: impl Display) {
    let _ = writeln!(io::stderr().lock(), "{}", printable(&line.to_string()).replace('\n', "\\n"));
}

/// Prints text that ends its own lines. That nobody reads on is no error; a full disk behind stdout is.
fn to_stdout(text: &str) -> Result<()> {
    let mut out = io::stdout().lock();
    match out.write_all(printable(text).as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => Err(Error::io(Path::new("stdout"), e)),
        _ => Ok(()),
    }
}

/// The text with control characters spelt out. Names come from files, and a terminal would obey them.
fn printable(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '\n' => shown.push(c),
            c if c.is_control() => shown.extend(c.escape_default()),
            c => shown.push(c),
        }
    }
    shown
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn terminals_are_not_told_what_to_do_by_names_in_files() {
        assert_eq!(printable("a\u{1b}[31mé\tb\n\0\u{9b}"), "a\\u{1b}[31mé\\tb\n\\u{0}\\u{9b}");
    }

    #[test]
    fn the_commands_are_consistent_and_each_help_has_an_example() {
        let mut cli = command();
        cli.clone().debug_assert();
        assert!(cli.render_help().to_string().contains("Example:\n  radiosity solve"));
        for command in cli.get_subcommands_mut().filter(|c| c.get_name() != "help") {
            let help = command.render_help().to_string();
            assert!(help.contains(&format!("Example:\n  radiosity {} ", command.get_name())), "{help}");
        }
    }
}
