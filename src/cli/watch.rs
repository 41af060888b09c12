//! The progress bar, and Ctrl-C.

use std::{
    io::{self, IsTerminal},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use indicatif::{HumanCount, ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use radiosity::{Progress, Ranks, Result};

const REFRESH: Duration = Duration::from_millis(100);

/// Watches a computation until it is dropped.
pub struct Watch {
    shared: Arc<Shared>,
    bar: Option<(ProgressBar, JoinHandle<()>)>,
}

#[derive(Default)]
struct Shared {
    progress: Progress,
    finished: AtomicBool,
    writing: AtomicBool,
}

impl Watch {
    /// Listens for Ctrl-C. Draws a progress bar if stderr is a terminal and `quiet` is false.
    pub fn new(quiet: bool) -> Watch {
        let shared = Arc::new(Shared::default());
        let handled = Arc::clone(&shared);
        // This fails only if there is a handler already or if the system has no resources. Then Ctrl-C kills the
        // program, which is acceptable.
        let _ = ctrlc::set_handler(move || {
            // Not every stage checks whether it should stop. A second Ctrl-C exits at once, except while files are
            // written, which takes seconds at most: temporary files and empty directories must not stay behind. One
            // Ctrl-C can be two signals, because timeout(1) signals the program and its group.
            if handled.progress.is_stopped() && !handled.writing.load(Ordering::Relaxed) {
                super::outputs::remove_made();
                std::process::exit(super::STOPPED.into());
            }
            handled.progress.stop();
        });
        let bar = (!quiet && Ranks::world().is_first() && io::stderr().is_terminal()).then(|| {
            let bar =
                ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr()).with_style(style(false));
            let (drawn, drawing) = (bar.clone(), Arc::clone(&shared));
            (bar, std::thread::spawn(move || draw(&drawn, &drawing)))
        });
        Watch { shared, bar }
    }

    /// The counter of the computation.
    pub fn progress(&self) -> &Progress {
        &self.shared.progress
    }

    /// Runs a stage of the work, and returns its result and its duration in seconds.
    pub fn stage<T>(&self, name: &'static str, work: impl FnOnce() -> Result<T>) -> Result<(T, f64)> {
        self.progress().check()?;
        self.progress().begin(name, 0);
        let start = Instant::now();
        let result = work()?;
        self.progress().check()?;
        Ok((result, radiosity::output::report::seconds(start.elapsed())))
    }

    /// Marks that temporary files exist from here on.
    pub fn begin_writing(&self) {
        self.shared.writing.store(true, Ordering::Relaxed);
    }

    /// Prints a warning above the bar.
    pub fn warn(&self, warning: &str) {
        self.say(&format!("warning: {warning}"));
    }

    /// Prints a line above the bar, on the first rank.
    pub fn say(&self, line: &str) {
        if !Ranks::world().is_first() {
            return;
        }
        let print = || super::to_stderr(line);
        match &self.bar {
            Some((bar, _)) => bar.suspend(print),
            None => print(),
        }
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.shared.finished.store(true, Ordering::Relaxed);
        if let Some((_, thread)) = self.bar.take() {
            thread.thread().unpark();
            let _ = thread.join();
        }
    }
}

fn draw(bar: &ProgressBar, shared: &Shared) {
    let mut shown = ("", u64::MAX);
    while !shared.finished.load(Ordering::Relaxed) {
        let stage = shared.progress.stage();
        let total = shared.progress.total();
        if (stage, total) != shown {
            // Rate and time left refer to one stage. The total of a stage can grow while it runs, because rays find
            // backs.
            if stage != shown.0 {
                bar.reset();
            }
            shown = (stage, total);
            bar.set_message(stage);
            bar.set_style(style(total > 0));
            bar.set_length(total);
        }
        bar.set_position(shared.progress.done());
        bar.tick();
        std::thread::park_timeout(REFRESH);
    }
    bar.finish_and_clear();
}

fn style(counted: bool) -> ProgressStyle {
    let template = match counted {
        true => "{msg:17} [{bar:30}] {percent:>3} % {rate}, {eta} left",
        false => "{msg:17} {spinner} {elapsed}",
    };
    ProgressStyle::with_template(template).expect("the template is valid").progress_chars("=> ").with_key(
        "rate",
        |state: &ProgressState, out: &mut dyn std::fmt::Write| {
            let _ = write!(out, "{}/s", HumanCount(state.per_sec() as u64));
        },
    )
}
