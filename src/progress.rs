//! How far a long computation is, and the request to stop it.

use std::sync::{
    Mutex, PoisonError,
    atomic::{AtomicBool, AtomicU64, Ordering},
};

/// Shared between a computation, which counts its steps, and the thread that watches it.
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
    /// Nothing done yet, and no request to stop.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Starts a stage of `total` steps. The total is 0 where the number of steps is unknown.
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

    /// Steps of the present stage; 0 where their number is unknown.
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

    /// Lets a computation end early.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped) once [`Progress::stop`] was called.
    pub fn check(&self) -> crate::Result<()> {
        if self.is_stopped() { Err(crate::Error::Stopped) } else { Ok(()) }
    }
}
