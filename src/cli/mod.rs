//! The commands of the program `radiosity`, and their exit status. Only with the feature `cli`.
//!
//! Results go to files, and a short summary to stdout. Progress, warnings and errors go to stderr. Exit status: 0 done;
//! 1 computed, but a check failed; 2 bad usage or input; 130 stopped by a signal.

mod bake;
mod camera;
mod checkpoint;
mod daylight;
mod exchange;
mod forecast;
mod inspect;
mod lights;
mod models;
mod options;
mod outputs;
mod page;
mod per_light;
mod pipeline;
mod probe;
mod render;
mod sampling;
mod scene;
mod solve;
mod summary;
mod surfaces;
mod sweeps;
mod tradeoff;
mod validate;
mod view;
mod view_factors;
mod watch;

use std::{
    any::TypeId,
    ffi::OsString,
    fmt::Display,
    io::{self, Write},
    num::NonZeroUsize,
    path::{Path, PathBuf},
    time::Duration,
};

use clap::{
    Arg, Args, CommandFactory, FromArgMatches, Parser, Subcommand,
    error::{ContextKind, ContextValue, ErrorKind},
};
use radiosity::{Error, Ranks, Result, Setting};

pub use scene::{add_lights, read_scene};

/// Compute the light between diffuse surfaces, with error bars
#[derive(Parser)]
#[command(
    name = "radiosity",
    version,
    propagate_version = true,
    max_term_width = 80,
    after_help = "Example:\n  radiosity solve room.obj -o room.ply --report room.json\n\n\
        Exit status: 0 done; 1 computed, but a check failed; 2 bad usage or input; 130 stopped by a signal."
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Solve(solve::SolveArgs),
    #[command(after_help = "Example:\n  radiosity view room.obj --quality high\n\n\
        The environment variable BROWSER names the program that opens the page.")]
    View(view::ViewArgs),
    Validate(validate::ValidateArgs),
    Render(render::RenderArgs),
    Bake(bake::BakeArgs),
    Probe(probe::ProbeArgs),
    Inspect(inspect::InspectArgs),
    Tradeoff(tradeoff::TradeoffArgs),
    Daylight(daylight::DaylightArgs),
    ViewFactors(view_factors::ViewFactorsArgs),
    Exchange(exchange::ExchangeArgs),
}

/// Largest `--threads` on a machine with fewer processors. More threads than processors gain nothing.
const MOST_THREADS: usize = 256;

/// Options of every command.
#[derive(Args)]
struct Common {
    /// Print no summary and no progress. Warnings and errors remain
    #[arg(long)]
    quiet: bool,
    /// Number of threads [default: all processors]. The result does not depend on it
    #[arg(long, value_name = "N")]
    threads: Option<NonZeroUsize>,
    /// Largest amount of memory to use, for example 500MB or 4GiB. A computation that needs more is refused before it
    /// starts, but `solve` can continue without a matrix. Under MPI, the limit is that of each rank [default: the memory
    /// of this machine]
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
                message: format!("--threads {threads} is too large: at most {most} are allowed"),
                hint: Some(format!(
                    "this machine has {processors} processors, and more threads gain nothing"
                )),
            });
        }
        rayon::ThreadPoolBuilder::new().num_threads(threads.get()).build_global().map_err(|e| Error::Usage {
            message: format!("cannot start {threads} threads: {e}"),
            hint: Some("leave --threads out to use every processor once".into()),
        })
    }
}

/// The outcome of a computation with a result.
enum Outcome {
    Done,
    /// A check failed. The sentence describes the failure.
    CheckFailed(String),
}

const DONE: u8 = 0;
const CHECK_FAILED: u8 = 1;
const BAD_INPUT: u8 = 2;
const STOPPED: u8 = 130;

/// Runs the command that the arguments name, and returns the exit status. The first argument is the name of the program.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    // Dropped at the end, which other ranks wait for.
    let _connection = match Ranks::connect() {
        Ok(connection) => connection,
        Err(error) => return fail(&error),
    };
    let matches = command().try_get_matches_from(arguments);
    let command = match matches.and_then(|matches| Cli::from_arg_matches(&matches)) {
        Ok(cli) => cli.command,
        Err(error) => return usage_error(&error),
    };
    if let Err(error) = check_ranks(&command) {
        return fail(&error);
    }
    let result = match command {
        Command::Solve(args) => solve::run(&args),
        Command::View(args) => view::run(args),
        Command::Validate(args) => validate::run(&args),
        Command::Render(args) => render::run(&args),
        Command::Bake(args) => bake::run(&args),
        Command::Probe(args) => probe::run(&args),
        Command::Inspect(args) => inspect::run(&args),
        Command::Tradeoff(args) => tradeoff::run(&args),
        Command::Daylight(args) => daylight::run(&args),
        Command::ViewFactors(args) => view_factors::run(&args),
        Command::Exchange(args) => exchange::run(&args),
    };
    match result {
        Ok(Outcome::Done) => DONE,
        Ok(Outcome::CheckFailed(check)) => {
            if Ranks::world().is_first() {
                say_error(&check);
            }
            CHECK_FAILED
        }
        Err(error) => fail(&error),
    }
}

/// Time for the first rank to end all ranks, if all have the same error.
const TURN: Duration = Duration::from_secs(1);

/// Prints an error, and returns the exit status. Ends the other ranks of an MPI job.
fn fail(error: &Error) -> u8 {
    let ranks = Ranks::world();
    if !ranks.is_first() {
        std::thread::sleep(TURN);
        to_stderr(format_args!("rank {} of {} ends all ranks", ranks.rank(), ranks.count()));
    }
    let status = match error {
        Error::Stopped => {
            to_stderr("stopped");
            STOPPED
        }
        error => {
            say_error(error);
            if let Some(hint) = error.hint() {
                let options: Vec<&str> = error.settings().iter().map(|&s| option(s)).collect();
                let named =
                    if options.is_empty() { String::new() } else { format!(" ({})", options.join(", ")) };
                to_stderr(format_args!("hint: {hint}{named}"));
            }
            if matches!(error, Error::NotConverged { .. }) { CHECK_FAILED } else { BAD_INPUT }
        }
    };
    ranks.abort(status);
    status
}

/// Refuses commands that the ranks of an MPI job do not share out.
fn check_ranks(command: &Command) -> Result<()> {
    if Ranks::world().count() == 1 || matches!(command, Command::Solve(_)) {
        return Ok(());
    }
    Err(Error::Usage {
        message: "only `solve` shares out its work among MPI ranks".into(),
        hint: Some("run other commands without mpirun".into()),
    })
}

/// The option for a setting that an error of the library names.
fn option(setting: Setting) -> &'static str {
    match setting {
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
    }
}

/// The commands for clap. A word like `-1` counts as the value of an option, so that the option's own message explains
/// the error. Otherwise, clap would advise to put `--` before the word.
fn command() -> clap::Command {
    let is_number = |arg: &Arg| {
        let names_a_file = arg.get_value_parser().type_id() == TypeId::of::<PathBuf>();
        arg.get_action().takes_values() && !arg.is_positional() && !names_a_file
    };
    let numbers = |arg: Arg| if is_number(&arg) { arg.allow_negative_numbers(true) } else { arg };
    Cli::command().mut_subcommands(|command| command.mut_args(numbers))
}

/// Prints an error of clap in the form of all other errors, on the first rank. Help and version are not errors.
fn usage_error(error: &clap::Error) -> u8 {
    if !Ranks::world().is_first() {
        return if error.use_stderr() { BAD_INPUT } else { DONE };
    }
    if !error.use_stderr() || error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
        let _ = error.print();
        return if error.use_stderr() { BAD_INPUT } else { DONE };
    }
    if let Some(ContextValue::String(given)) = error.get(ContextKind::InvalidSubcommand)
        && Path::new(given).extension().is_some()
    {
        // The word is most likely a scene, and the command before it is missing.
        to_stderr(format_args!("error: `{given}` is not a command"));
        to_stderr(format_args!("hint: put a command before it, as in `radiosity solve {given} -o out.ply`"));
        return BAD_INPUT;
    }
    let (what, hints) = explain(error);
    to_stderr(format_args!("error: {what}"));
    to_stderr(format_args!("hint: {}", hints.as_deref().unwrap_or("try --help")));
    BAD_INPUT
}

/// What is wrong by an error of clap, and what to do.
fn explain(error: &clap::Error) -> (String, Option<String>) {
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
    let what = what.strip_prefix("error: ").unwrap_or(&what).to_owned();
    (what, Some(hints.join("; ")).filter(|hints| !hints.is_empty()))
}

fn say_error(what: &dyn Display) {
    to_stderr(format_args!("error: {what}"));
}

/// Prints one line, even if a file name contains line breaks. Ignores a closed stderr, on which `eprintln!` would
/// panic.
fn to_stderr(line: impl Display) {
    let _ = writeln!(io::stderr().lock(), "{}", printable(&line.to_string()).replace('\n', "\\n"));
}

/// Prints text that contains its own line ends, on the first rank. A closed pipe is not an error, but a full disk behind stdout is.
fn to_stdout(text: &str) -> Result<()> {
    if !Ranks::world().is_first() {
        return Ok(());
    }
    let mut out = io::stdout().lock();
    match out.write_all(printable(text).as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => Err(Error::io(Path::new("stdout"), e)),
        _ => Ok(()),
    }
}

/// The text with its control characters escaped. Names come from files, and a terminal would execute control characters
/// in them.
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
    fn control_characters_in_names_do_not_reach_the_terminal() {
        assert_eq!(printable("a\u{1b}[31mé\tb\n\0\u{9b}"), "a\\u{1b}[31mé\\tb\n\\u{0}\\u{9b}");
    }

    #[test]
    fn help_fits_into_80_columns() {
        let mut cli = command();
        cli.build();
        for command in cli.get_subcommands_mut() {
            for help in [command.render_help(), command.render_long_help()] {
                let text = help.to_string();
                let widest = text.lines().max_by_key(|line| line.chars().count()).unwrap();
                assert!(widest.chars().count() <= 80, "{}: {widest}", command.get_name());
            }
        }
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
