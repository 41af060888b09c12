//! A forecast of the memory that a solution will take.

use crate::{
    direct::{Constants, REPLICATES},
    form_factor::Estimator,
    scene::Scene,
    solve::Solver,
};

/// The program, its threads, and the buffers of output files.
const BASE: f64 = 16.0 * 1024.0 * 1024.0;
/// A triangle, its normals and its share of the hierarchy during construction: 498 bytes measured on 10⁶ triangles.
const TRIANGLE: f64 = 500.0;
/// Entries of a matrix of whole rows: value and column.
const ENTRY: f64 = 8.0;
/// The same while they are made from a symmetric matrix: pairs are listed, and rows grow.
const UNFOLDED_ENTRY: f64 = 36.0;
/// The same while they are made from columns. Memory freed earlier does not fit.
const TRANSPOSED_ENTRY: f64 = 24.0;
/// Entries of a dense matrix and of its factors, and of the factors of the previous channel.
const DENSE_ENTRY: f64 = 32.0;
/// Entries of a row of a symmetric matrix, each half of a pair of 12 bytes at most.
const SHARED_ENTRY: f64 = 6.0;
/// How light varies over a patch, for each channel: slopes, constant light, and replicates of what they change; and the same while it
/// is found.
const LINEAR: f64 = 400.0;
/// A shadow ray: what it went to, and its weight.
const SHADOW_RAY: f64 = 8.0;

/// A patch without a matrix, for any number of rays: sums, batches, light and error of a channel, and everything that does not
/// depend on channels; then the mesh that is written.
const SWEPT: f64 = 480.0;
const SWEPT_CHANNEL: f64 = 160.0;
/// The form factor of a patch to a piece of a lamp.
const KNOWN_PIECE: f64 = 8.0;

/// Peak number of bytes of a solution without a matrix, for a number of patches that includes backs.
pub fn without_matrix(scene: &Scene, patches: f64) -> f64 {
    let of_patch =
        SWEPT + SWEPT_CHANNEL * scene.channels() as f64 + KNOWN_PIECE * known_pieces(scene, patches);
    BASE + TRIANGLE * scene.triangles.len() as f64 + of_patch * patches
}

/// Bytes that linear light adds at most, for a number of patches that includes backs.
pub fn of_linear_light(scene: &Scene, patches: f64) -> f64 {
    LINEAR * scene.channels() as f64 * patches
}

/// How many pieces of lamps there are whose unblocked light each patch holds: a lamp's triangle, or of one that shines by a texture
/// each patch; none where they are too many.
fn known_pieces(scene: &Scene, patches: f64) -> f64 {
    let all: f64 = (0..scene.triangles.len()).map(|t| scene.area(t)).sum();
    let of_triangle = |t: usize| match scene.material(t).emission_map {
        Some(_) => (patches * scene.area(t) / all).max(1.0),
        None => 1.0,
    };
    let pieces: f64 = (0..scene.triangles.len()).filter(|&t| scene.emits(t)).map(of_triangle).sum();
    if pieces <= Constants::MOST_KNOWN as f64 { pieces } else { 0.0 }
}

/// Number of bytes of a solution with all its errors, by purpose. This is an upper estimate: with evenly distributed hits, a row of r
/// rays among n patches has n (1 - exp(-r / n)) entries; in a real scene hits crowd together and it has fewer. The number of
/// patches must include backs, which rays find later.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Memory {
    /// The program, the scene and the hierarchy of its triangles.
    pub scene: f64,
    /// Numbers stored for every patch.
    pub patches: f64,
    /// The hits of all rays.
    pub hits: f64,
    /// The form factors.
    pub matrix: f64,
    /// For a time: hits sorted by the blocks that they connect, and entries before tiles hold them.
    pub calibration: f64,
    /// For a time: sums of every replicate, and deviations.
    pub error_bars: f64,
    /// For a time: half of the hits, and the form factors that they give, with what the solver makes of them.
    pub halves: f64,
    /// For a time: the matrix as the solver wants it, where that is not as it is kept.
    pub solver: f64,
}

impl Memory {
    /// The forecast for a number of patches, backs included, and a mean number of rays per patch.
    pub fn of(scene: &Scene, patches: f64, rays: f64, estimator: Estimator, solver: Solver) -> Memory {
        let n = patches.max(1.0);
        let channels = scene.channels() as f64;
        let pooled = estimator == Estimator::Pooled;
        let (hemisphere, shadow) = if pooled { (0.75 * rays, 0.25 * rays) } else { (rays, 0.0) };
        let of_lamps = if pooled { KNOWN_PIECE * known_pieces(scene, n) } else { 0.0 };
        // Number of entries of a row with a number of samples among a number of patches.
        let row = |samples: f64, patches: f64| -patches * (-samples / patches).exp_m1();
        let both = if pooled { 2.0 } else { 1.0 };
        let hits = 4.0 * hemisphere + SHADOW_RAY * shadow + 100.0;
        let entry = if pooled { SHARED_ENTRY } else { ENTRY };
        let entries = row(both * rays, n);
        let factors = if pooled { 10.0 * entries + 8.0 * row(rays, n) } else { 2.0 * ENTRY * row(rays, n) };
        let half_entries = row(0.5 * both * rays, n);
        let half = entry * half_entries;
        // Whole rows, unless the matrix has them; columns, unless it is symmetric; a dense matrix.
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
            // Copied into vectors that grow while they are filled.
            halves: n * (hits + 2.0 * half + solver(half_entries)),
            solver: n * solver(entries),
        }
    }

    /// The peak over time.
    pub fn peak(&self) -> f64 {
        let for_a_time = [self.calibration, self.error_bars, self.halves, self.solver];
        let kept = self.scene + self.patches + self.hits + self.matrix;
        kept + for_a_time.into_iter().fold(0.0, f64::max)
    }
}
