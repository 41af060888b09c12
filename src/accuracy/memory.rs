//! A forecast of the memory that a solution needs. All constants are in bytes.

use crate::{direct::Constants, form_factor::Estimator, rays::REPLICATES, scene::Scene, solve::Solver};

/// For the program, its threads, and the buffers of output files.
const BASE: f64 = 17.0 * 1024.0 * 1024.0;
/// For a triangle, its normals and its share of the hierarchy during construction: 498 bytes measured on 10⁶ triangles.
const TRIANGLE: f64 = 500.0;
/// For an entry of a matrix of whole rows: value and column.
const ENTRY: f64 = 8.0;
/// For an entry of whole rows while they are built from a symmetric matrix: pairs are listed, and rows grow.
const UNFOLDED_ENTRY: f64 = 36.0;
/// For an entry of columns while they are built from rows. Memory that was freed earlier does not fit. The peak of equal runs
/// varies with the order in which threads free memory: 98 to 120 MB in seven runs of 9,344 patches with 256 rays, of which the
/// forecast with 24 bytes covered 118 MB.
const TRANSPOSED_ENTRY: f64 = 32.0;
/// For an entry of a dense matrix, of its factors, and of the factors of the previous channel.
const DENSE_ENTRY: f64 = 32.0;
/// For an entry of a row of a symmetric matrix: half of a pair, which has 12 bytes at most.
const SHARED_ENTRY: f64 = 6.0;
/// For linear light, per patch and channel: slopes, constant light, what is missing, and replicates of the change from
/// slopes; and the shapes of direct light and a second solution during the computation.
const LINEAR: f64 = 400.0;
/// For a shadow ray: its target and its weight.
const SHADOW_RAY: f64 = 8.0;

/// For a patch without a matrix, for any number of rays: everything that does not depend on channels, and then the mesh
/// that is written.
const SWEPT: f64 = 480.0;
/// For a patch without a matrix, per channel: sums, batches, light and error.
const SWEPT_CHANNEL: f64 = 160.0;
/// For a patch without a matrix, per channel: the light from outside the patches, in all sweeps, in a batch and in the
/// present sweep.
const SWEPT_OUTSIDE: f64 = 48.0;
/// For the form factor of a patch to a piece of a lamp.
const KNOWN_PIECE: f64 = 8.0;

/// Bytes of memory and swap space of this machine as Linux reports them, or the limit of the control group if that is smaller;
/// `None` elsewhere.
pub fn of_machine() -> Option<f64> {
    let info = std::fs::read_to_string("/proc/meminfo").ok()?;
    let kibibytes = |name: &str| -> Option<f64> {
        let line = info.lines().find_map(|line| line.strip_prefix(name))?;
        line.trim().strip_suffix("kB")?.trim().parse().ok()
    };
    let all = 1024.0 * (kibibytes("MemTotal:")? + kibibytes("SwapTotal:").unwrap_or(0.0));
    let group = std::fs::read_to_string("/sys/fs/cgroup/memory.max").ok();
    let group = group.and_then(|text| text.trim().parse::<f64>().ok());
    Some(all.min(group.unwrap_or(f64::INFINITY)))
}

/// The largest number of rays a patch for which a computation takes no more than `limit` bytes. `bytes` gives what it takes for
/// a number of rays.
pub fn most_rays(limit: f64, bytes: impl Fn(f64) -> f64) -> f64 {
    if limit == f64::INFINITY {
        return f64::INFINITY;
    }
    let (mut few, mut many) = (0.0, limit);
    for _ in 0..100 {
        let middle = 0.5 * (few + many);
        if bytes(middle) <= limit { few = middle } else { many = middle }
    }
    few
}

/// Peak number of bytes of a solution without a matrix. `patches` is the number of patches, backs included.
pub fn without_matrix(scene: &Scene, patches: f64) -> f64 {
    let outside = if scene.lights.is_empty() { 0.0 } else { SWEPT_OUTSIDE };
    let of_channels = (SWEPT_CHANNEL + outside) * scene.channels() as f64;
    let of_patch = SWEPT + of_channels + KNOWN_PIECE * known_pieces(scene, patches);
    BASE + TRIANGLE * scene.triangles.len() as f64 + of_patch * patches
}

/// Largest number of bytes that linear light adds. `patches` is the number of patches, backs included.
pub fn of_linear_light(scene: &Scene, patches: f64) -> f64 {
    LINEAR * scene.channels() as f64 * patches
}

/// Number of pieces of lamps for which each patch stores the unblocked light. A piece is an emitting triangle, a patch of
/// a triangle with an emission texture, or a light that is not a surface. Zero if there are too many pieces.
fn known_pieces(scene: &Scene, patches: f64) -> f64 {
    let all: f64 = (0..scene.triangles.len()).map(|t| scene.area(t)).sum();
    let of_triangle = |t: usize| match scene.material(t).emission_map {
        Some(_) => (patches * scene.area(t) / all).max(1.0),
        None => 1.0,
    };
    let pieces: f64 = (0..scene.triangles.len()).filter(|&t| scene.emits(t)).map(of_triangle).sum();
    if pieces <= Constants::MOST_KNOWN as f64 { pieces + scene.lights.list.len() as f64 } else { 0.0 }
}

/// Forecast number of bytes of a solution with all its errors, by purpose. It is an upper estimate. With evenly
/// distributed hits, a row of r rays among n patches has n (1 - exp(-r / n)) entries. In a real scene hits are
/// concentrated, and a row has fewer entries.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Memory {
    /// The program, the scene and the hierarchy of its triangles.
    pub scene: f64,
    /// Numbers stored for every patch.
    pub patches: f64,
    /// Hits of all rays.
    pub hits: f64,
    /// Form factors.
    pub matrix: f64,
    /// Temporary: hits sorted by the blocks that they connect, and entries before they are stored in tiles.
    pub calibration: f64,
    /// Temporary: sums of every replicate, and deviations.
    pub error_bars: f64,
    /// Temporary: half of the hits, the form factors from these hits, and the solver's copy of them.
    pub halves: f64,
    /// Temporary: the solver's copy of the matrix, if it needs another format.
    pub solver: f64,
}

impl Memory {
    /// The forecast for a scene. `patches` is the number of patches, including the backs that rays will hit. `rays` is
    /// the mean number of rays per patch.
    pub fn of(scene: &Scene, patches: f64, rays: f64, estimator: Estimator, solver: Solver) -> Memory {
        let n = patches.max(1.0);
        let channels = scene.channels() as f64;
        let pooled = estimator == Estimator::Pooled;
        let (hemisphere, shadow) = if pooled { (0.75 * rays, 0.25 * rays) } else { (rays, 0.0) };
        let of_lamps = if pooled { KNOWN_PIECE * known_pieces(scene, n) } else { 0.0 };
        // Expected number of entries of a row with `samples` samples among `patches` patches.
        let row = |samples: f64, patches: f64| -patches * (-samples / patches).exp_m1();
        let both = if pooled { 2.0 } else { 1.0 };
        let hits = 4.0 * hemisphere + SHADOW_RAY * shadow + 100.0;
        let entry = if pooled { SHARED_ENTRY } else { ENTRY };
        let entries = row(both * rays, n);
        let factors = if pooled { 10.0 * entries + 8.0 * row(rays, n) } else { 2.0 * ENTRY * row(rays, n) };
        let half_entries = row(0.5 * both * rays, n);
        let half = entry * half_entries;
        // Some solvers need whole rows, which a symmetric matrix does not have. Southwell needs columns.
        let (whole, columns) =
            if pooled { (UNFOLDED_ENTRY, UNFOLDED_ENTRY) } else { (0.0, TRANSPOSED_ENTRY) };
        let solver = |entries: f64| match solver {
            Solver::Auto | Solver::Jacobi | Solver::ConjugateGradient => 0.0,
            Solver::GaussSeidel => whole * entries,
            Solver::Southwell => columns * entries,
            Solver::Direct => whole * entries + DENSE_ENTRY * n,
        };
        let (sums, deviations) = (16.0 + 8.0 * channels, 4.0 * (7.0 * channels + 3.0));
        Memory {
            scene: BASE + TRIANGLE * scene.triangles.len() as f64,
            patches: n * (if pooled { 700.0 } else { 1500.0 } + of_lamps),
            hits: n * hits,
            matrix: n * entry * entries,
            calibration: n * factors,
            error_bars: n * REPLICATES as f64 * (sums + deviations),
            // Twice: the entries are copied into vectors that grow while they are filled.
            halves: n * (hits + 2.0 * half + solver(half_entries)),
            solver: n * solver(entries),
        }
    }

    /// The memory of each of several ranks that share out a pooled matrix. A rank has the tiles of its blocks of
    /// patches with all blocks, which are a share 2/n - 1/n² of all tiles, and the hits that they consist of. Scene,
    /// numbers of patches and hits are on every rank.
    #[must_use]
    pub fn among(self, ranks: usize) -> Memory {
        let share = 1.0 / ranks as f64;
        let tiles = share * (2.0 - share);
        Memory {
            matrix: tiles * self.matrix,
            calibration: tiles * self.calibration,
            halves: self.hits + tiles * (self.halves - self.hits),
            ..self
        }
    }

    /// The peak over time, in bytes.
    pub fn peak(&self) -> f64 {
        let for_a_time = [self.calibration, self.error_bars, self.halves, self.solver];
        let kept = self.scene + self.patches + self.hits + self.matrix;
        kept + for_a_time.into_iter().fold(0.0, f64::max)
    }
}
