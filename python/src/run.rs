//! Long computations: without the GIL, heard by Ctrl-C, watched by a callback.

use std::{
    any::Any,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Arc,
        mpsc::{RecvTimeoutError, channel},
    },
    thread,
    time::Duration,
};

use pyo3::{
    exceptions::{PyRuntimeError, PyValueError},
    prelude::*,
};
use radiosity::{Progress, Result};

use crate::error::raise;

/// How often signals are looked for and the callback is called.
const TICK: Duration = Duration::from_millis(50);
/// How long a computation that was asked to stop is waited for. One that takes longer to hear of it ends by itself later.
const PATIENCE: Duration = Duration::from_millis(50);

/// Computes in a thread of its own, with a pool of its own: the threads of a pool that all calls share would not survive a fork.
/// This thread meanwhile looks for signals and calls `progress(stage, done, total)`. What either of them raises ends the
/// computation and comes out of here.
pub fn run<T: Send + 'static>(
    py: Python<'_>,
    progress: Option<Py<PyAny>>,
    threads: Option<usize>,
    work: impl FnOnce(&Progress) -> Result<T> + Send + 'static,
) -> PyResult<T> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.unwrap_or(0)).build();
    let pool = pool.map_err(|error| PyValueError::new_err(format!("threads: {error}")))?;
    let shared = Arc::new(Progress::new());
    let counted = Arc::clone(&shared);
    let (sender, mut receiver) = channel();
    thread::Builder::new().name("radiosity".into()).spawn(move || {
        let result = catch_unwind(AssertUnwindSafe(|| pool.install(|| work(&counted))));
        // Nobody listens any more after a signal.
        let _ = sender.send(result);
    })?;
    let tell = || match &progress {
        Some(callback) => callback.call1(py, (shared.stage(), shared.done(), shared.total())).map(drop),
        None => Ok(()),
    };
    loop {
        let heard;
        (heard, receiver) = py.detach(move || (receiver.recv_timeout(TICK), receiver));
        match heard {
            Ok(Ok(Ok(result))) => {
                tell()?;
                return Ok(result);
            }
            Ok(Ok(Err(error))) => return Err(raise(error)),
            Ok(Err(panic)) => return Err(internal(&*panic)),
            Err(RecvTimeoutError::Disconnected) => return Err(internal(&"the computation has no end")),
            Err(RecvTimeoutError::Timeout) => {}
        }
        if let Err(raised) = py.check_signals().and_then(|()| tell()) {
            shared.stop();
            py.detach(move || drop(receiver.recv_timeout(PATIENCE)));
            return Err(raised);
        }
    }
}

fn internal(panic: &(dyn Any + Send)) -> PyErr {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("unknown");
    PyRuntimeError::new_err(format!("error inside radiosity, which should be reported: {text}"))
}
