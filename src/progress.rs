//! The progress of a long computation, and the request to stop it.

use std::sync::{
    Mutex, PoisonError,
    atomic::{AtomicBool, AtomicU64, Ordering},
};

/// The progress of a computation. The computation counts its steps here, and another thread watches them.
///
/// A computation consists of stages. Each stage has a name and counts steps: rays, paths or texels. Counting takes no
/// lock and does not change results.
///
/// ```
/// use std::{thread, time::Duration};
/// use radiosity::{Progress, Scene, form_factor::*, patch::*, trace::Tracer};
///
/// let scene = Scene::load("meshes/cornell-box.obj")?;
/// let tracer = Tracer::new(&scene);
/// let mut patches = Patches::subdivide(&scene, &Subdivision::Count(1000));
/// let progress = Progress::new();
/// let options = CastOptions::default();
/// let form_factors = thread::scope(|threads| {
///     let work = threads.spawn(|| FormFactors::cast(&scene, &tracer, &mut patches, &options, &progress));
///     while !work.is_finished() {
///         println!("{}: {} of {}", progress.stage(), progress.done(), progress.total());
///         thread::sleep(Duration::from_millis(10));
///     }
///     work.join().unwrap()
/// })?;
/// assert!(progress.stage().starts_with("casting"));
/// # Ok::<(), radiosity::Error>(())
/// ```
#[derive(Debug, Default)]
pub struct Progress {
    stage: Mutex<&'static str>,
    total: AtomicU64,
    done: AtomicU64,
    stopped: AtomicBool,
}

impl Progress {
    /// Makes a progress without steps done or a request to stop.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Starts a stage of `total` steps. The total is 0 if the number of steps is unknown.
    pub fn begin(&self, stage: &'static str, total: u64) {
        *self.stage.lock().unwrap_or_else(PoisonError::into_inner) = stage;
        self.done.store(0, Ordering::Relaxed);
        self.total.store(total, Ordering::Relaxed);
    }

    /// Adds `steps` to the steps done.
    pub fn advance(&self, steps: u64) {
        self.done.fetch_add(steps, Ordering::Relaxed);
    }

    /// Name of the present stage; empty before the first.
    pub fn stage(&self) -> &'static str {
        *self.stage.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Number of steps of the present stage; 0 if it is unknown.
    pub fn total(&self) -> u64 {
        self.total.load(Ordering::Relaxed)
    }

    /// Number of steps done in the present stage.
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

    /// Returns an error if the computation should stop. Computations call this often.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped) after a call of [`Progress::stop`].
    pub fn check(&self) -> crate::Result<()> {
        if self.is_stopped() { Err(crate::Error::Stopped) } else { Ok(()) }
    }
}
