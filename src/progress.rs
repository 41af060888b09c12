//! How far a long computation is, and the wish to stop it.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Shared between a computation, which counts, and whoever watches it.
///
/// Counting is free of locks and has no influence on results.
#[derive(Debug, Default)]
pub struct Progress {
    total: AtomicU64,
    done: AtomicU64,
    stopped: AtomicBool,
}

impl Progress {
    /// Nothing done yet, nobody wants to stop.
    pub fn new() -> Self {
        Self::default()
    }

    /// Starts a stage of `total` steps (rays, paths, texels).
    pub fn begin(&self, total: u64) {
        self.done.store(0, Ordering::Relaxed);
        self.total.store(total, Ordering::Relaxed);
    }

    /// Adds `steps` to what is done.
    pub fn advance(&self, steps: u64) {
        self.done.fetch_add(steps, Ordering::Relaxed);
    }

    /// Steps of the present stage.
    pub fn total(&self) -> u64 {
        self.total.load(Ordering::Relaxed)
    }

    /// Steps done of the present stage.
    pub fn done(&self) -> u64 {
        self.done.load(Ordering::Relaxed)
    }

    /// Asks the computation to return [`Error::Stopped`](crate::Error::Stopped) soon.
    pub fn stop(&self) {
        self.stopped.store(true, Ordering::Relaxed);
    }

    /// Whether [`Progress::stop`] was called.
    pub fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::Relaxed)
    }

    /// `Err(Stopped)` once [`Progress::stop`] was called.
    pub fn check(&self) -> crate::Result<()> {
        if self.is_stopped() { Err(crate::Error::Stopped) } else { Ok(()) }
    }
}
