//! The radiosity equation E = D + F (B - Bd), B = Be + ρ E.
//!
//! Bd is what lamps emit, whose light D comes straight. With U = B - Bd it is U = (Be - Bd + ρ D) + ρ F U: the same system as
//! without lamps, of another source.
//!
//! All solvers work on every channel in one pass over the matrix and report the same three things: iterations, the
//! true relative residual of what they return, and a certified bound on its distance from the exact solution of the
//! discrete system. Not converging is an error, never a silent result.

mod batches;
pub mod conjugate_gradient;
pub mod direct;
mod few_rays;
pub mod gauss_seidel;
pub mod jacobi;
pub mod linear;
pub mod southwell;
pub mod stochastic_jacobi;

use std::borrow::Cow;

use crate::{
    Error, Progress, Result, Setting,
    form_factor::{DirectLight, Estimator, FormFactors, together},
    patch::Patches,
};
pub use linear::{LinearLight, solve_linear};
use stochastic_jacobi::StochasticSolution;

/// Which algorithm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Solver {
    /// Conjugate gradients where the form factors are reciprocal, else Gauss-Seidel.
    #[default]
    Auto,
    /// [`jacobi`]: every patch gathers from the last sweep. Simple, parallel, slow in bright rooms.
    Jacobi,
    /// [`gauss_seidel`]: every patch gathers from the newest values; about half the sweeps of Jacobi, serial.
    GaussSeidel,
    /// [`southwell`]: the patch with most unshot power shoots (progressive refinement).
    Southwell,
    /// [`conjugate_gradient`] on the symmetrised system: few iterations even where hardly anything absorbs.
    ConjugateGradient,
    /// [`direct`]: dense LU decomposition, for small scenes and as the oracle of the others.
    Direct,
}

impl Solver {
    /// The name used on the command line and in reports.
    pub fn name(self) -> &'static str {
        match self {
            Solver::Auto => "auto",
            Solver::Jacobi => "jacobi",
            Solver::GaussSeidel => "gauss-seidel",
            Solver::Southwell => "southwell",
            Solver::ConjugateGradient => "cg",
            Solver::Direct => "direct",
        }
    }
}

/// How to solve.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct SolveOptions {
    /// Which algorithm.
    pub solver: Solver,
    /// Stop when Σ A |residual| is at most this share of Σ A Be, in every channel, or as small as rounding lets it become.
    /// The energy imbalance left by the solver is then at most as large.
    pub tolerance: f64,
    /// Give up after this many iterations (for Southwell: as many times the number of patches shoot).
    pub max_iterations: usize,
    /// Whether [`solve_linear`] lets light vary over each patch; else it is as constant as that of [`solve()`].
    pub linear: bool,
}

setters!(SolveOptions {
    with_solver(solver: Solver),
    with_tolerance(tolerance: f64),
    with_max_iterations(max_iterations: usize),
    with_linear(linear: bool),
});

impl Default for SolveOptions {
    /// Solver chosen by the system, tolerance 1e-10, at most 10,000 iterations, constant light.
    fn default() -> Self {
        SolveOptions { solver: Solver::Auto, tolerance: 1e-10, max_iterations: 10_000, linear: false }
    }
}

impl SolveOptions {
    /// The same, no more precise than what tells how large an error is needs to be.
    pub(crate) fn rough(&self) -> SolveOptions {
        SolveOptions { tolerance: self.tolerance.max(1e-4), ..*self }
    }
}

/// What the surfaces emit and reflect: the right-hand side and the diagonal of the system.
#[derive(Debug, Clone, Copy)]
pub struct Radiometry<'a> {
    /// 1 or 3; values are interleaved.
    pub channels: usize,
    /// Emitted radiosity Be, W/m².
    pub emission: &'a [f64],
    /// Reflectance ρ in \[0, 1\].
    pub reflectance: &'a [f64],
}

impl<'a> From<&'a Patches> for Radiometry<'a> {
    fn from(patches: &'a Patches) -> Self {
        Radiometry {
            channels: patches.channels(),
            emission: patches.emission(),
            reflectance: patches.reflectance(),
        }
    }
}

/// The light on every patch, `channels` interleaved values each.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Solution {
    /// 1 or 3.
    pub channels: usize,
    /// Radiosity B, W/m²: what leaves, emitted and reflected.
    pub radiosity: Vec<f64>,
    /// Irradiance E, W/m²: what arrives.
    pub irradiance: Vec<f64>,
    /// The solver that ran; never [`Solver::Auto`].
    pub solver: Solver,
    /// Its iterations: sweeps, products with the matrix, or shots.
    pub iterations: usize,
    /// Σ A |Be + ρ E - B| over what is emitted and enters, of the worst channel, computed from the result itself.
    pub residual: f64,
    /// No patch's radiosity is farther than this from the exact solution of the discrete system, W/m². Infinite where
    /// a patch reflects everything and loses nothing.
    pub error_bound: f64,
    /// How irradiance varies over each patch; `None` where light was taken as constant.
    pub linear: Option<Box<LinearLight>>,
}

impl Solution {
    /// Radiosity of patch `i` as R G B, W/m²; three equal values in a grey scene.
    pub fn rgb(&self, i: usize) -> [f64; 3] {
        rgb(&self.radiosity, self.channels, i)
    }

    /// Irradiance of patch `i` as R G B, W/m²; three equal values in a grey scene.
    pub fn irradiance_rgb(&self, i: usize) -> [f64; 3] {
        rgb(&self.irradiance, self.channels, i)
    }

    /// Irradiance as it is with constant light on each patch, W/m², interleaved channels.
    pub(crate) fn constant_irradiance(&self) -> &[f64] {
        self.linear.as_ref().map_or(&self.irradiance, |linear| &linear.constant)
    }
}

fn rgb(values: &[f64], channels: usize, i: usize) -> [f64; 3] {
    std::array::from_fn(|c| values[i * channels + if channels == 1 { 0 } else { c }])
}

/// The light on every patch, however it was found: what files show.
#[derive(Debug, Clone, Copy)]
pub struct Light<'a> {
    /// Radiosity B, W/m²; interleaved channels.
    pub radiosity: &'a [f64],
    /// Irradiance E, W/m².
    pub irradiance: &'a [f64],
    /// Slopes of irradiance ([`LinearLight::slopes`]); empty where light is constant over each patch.
    pub slopes: &'a [[f64; 2]],
}

impl<'a> From<&'a Solution> for Light<'a> {
    fn from(solution: &'a Solution) -> Self {
        let slopes = solution.linear.as_ref().map_or(&[][..], |linear| &linear.slopes);
        Light { radiosity: &solution.radiosity, irradiance: &solution.irradiance, slopes }
    }
}

impl StochasticSolution {
    /// Radiosity of patch `i` as R G B, W/m²; three equal values in a grey scene.
    pub fn rgb(&self, i: usize) -> [f64; 3] {
        rgb(&self.radiosity, self.channels, i)
    }

    /// Irradiance of patch `i` as R G B, W/m²; three equal values in a grey scene.
    pub fn irradiance_rgb(&self, i: usize) -> [f64; 3] {
        rgb(&self.irradiance, self.channels, i)
    }
}

impl<'a> From<&'a StochasticSolution> for Light<'a> {
    fn from(solution: &'a StochasticSolution) -> Self {
        Light { radiosity: &solution.radiosity, irradiance: &solution.irradiance, slopes: &[] }
    }
}

/// Solves for the light of these form factors and lamps. The emission may be another than that the rays were cast for: patches that
/// were no lamps send their light through form factors.
///
/// # Errors
/// [`Error::NoEquilibrium`] when light enters a part of the scene that nothing leaves and nothing absorbs in;
/// [`Error::NotConverged`] when the iterations run out; [`Error::Setting`] when the solver does not suit the system;
/// [`Error::Stopped`].
///
/// # Panics
/// When the sizes of `radiometry` and `form_factors` disagree.
pub fn solve<'a>(
    form_factors: &FormFactors,
    radiometry: impl Into<Radiometry<'a>>,
    options: &SolveOptions,
    progress: &Progress,
) -> Result<Solution> {
    solve_from(None, form_factors, radiometry, options, progress)
}

/// As [`solve`], from a radiosity that is near: conjugate gradients take fewer iterations then, the others do not look at it.
pub(crate) fn solve_from<'a>(
    start: Option<&[f64]>,
    form_factors: &FormFactors,
    radiometry: impl Into<Radiometry<'a>>,
    options: &SolveOptions,
    progress: &Progress,
) -> Result<Solution> {
    let radiometry = radiometry.into();
    let n = form_factors.len() * radiometry.channels;
    assert_eq!((radiometry.emission.len(), radiometry.reflectance.len()), (n, n), "sizes disagree");
    progress.begin("solving", 0);
    together(|| match radiometry.channels {
        1 => System::<1>::new(form_factors, radiometry).solve(start, options, progress),
        3 => System::<3>::new(form_factors, radiometry).solve(start, options, progress),
        c => panic!("{c} channels: there are 1 or 3"),
    })
}

/// The system U = S + ρ F U with its number of channels known to the compiler.
pub(crate) struct System<'a, const C: usize> {
    pub(crate) form_factors: &'a FormFactors,
    /// S = Be - Bd + ρ D.
    pub(crate) source: Cow<'a, [[f64; C]]>,
    pub(crate) reflectance: &'a [[f64; C]],
    /// Be.
    emission: &'a [[f64; C]],
    /// D, where there are lamps or other lights.
    direct: Option<Vec<[f64; C]>>,
    /// What of it enters from outside the patches, as a power.
    entered: [f64; C],
}

/// What an algorithm hands back: radiosity and iterations done.
type Iterate<const C: usize> = (Vec<[f64; C]>, usize);

impl<'a, const C: usize> System<'a, C> {
    pub(crate) fn new(form_factors: &'a FormFactors, radiometry: Radiometry<'a>) -> Self {
        let emission: &[[f64; C]] = radiometry.emission.as_chunks().0;
        let (direct, entered) = match form_factors.direct(emission, 1.0) {
            Some(DirectLight { irradiance, entered, .. }) => (Some(irradiance), entered),
            None => (None, [0.0; C]),
        };
        Self::with_direct(form_factors, radiometry, direct, entered)
    }

    /// With so much more light on each patch beside the direct light.
    fn with_more(form_factors: &'a FormFactors, radiometry: Radiometry<'a>, more: &[[f64; C]]) -> Self {
        let mut system = Self::new(form_factors, radiometry);
        let mut direct = system.direct.take().unwrap_or_else(|| vec![[0.0; C]; more.len()]);
        direct.as_flattened_mut().iter_mut().zip(more.as_flattened()).for_each(|(d, more)| *d += more);
        Self::with_direct(form_factors, radiometry, Some(direct), system.entered)
    }

    fn with_direct(
        form_factors: &'a FormFactors,
        radiometry: Radiometry<'a>,
        direct: Option<Vec<[f64; C]>>,
        entered: [f64; C],
    ) -> Self {
        let emission: &[[f64; C]] = radiometry.emission.as_chunks().0;
        let reflectance: &[[f64; C]] = radiometry.reflectance.as_chunks().0;
        let source = match &direct {
            None => Cow::Borrowed(emission),
            Some(direct) => {
                let source = |i: usize| {
                    let emitted = if form_factors.is_lamp(i) { [0.0; C] } else { emission[i] };
                    std::array::from_fn(|c| emitted[c] + reflectance[i][c] * direct[i][c])
                };
                Cow::Owned((0..emission.len()).map(source).collect())
            }
        };
        System { form_factors, source, reflectance, emission, direct, entered }
    }

    fn solve(&self, start: Option<&[f64]>, options: &SolveOptions, progress: &Progress) -> Result<Solution> {
        self.check_equilibrium()?;
        let symmetric = self.form_factors.estimator() == Estimator::Pooled;
        let solver = match options.solver {
            Solver::Auto if symmetric => Solver::ConjugateGradient,
            Solver::Auto => Solver::GaussSeidel,
            Solver::ConjugateGradient if !symmetric => {
                return Err(Error::setting(
                    &[Setting::Estimator, Setting::Solver],
                    "conjugate gradients need reciprocal form factors",
                    "use the pooled estimator, or the Gauss-Seidel method",
                ));
            }
            named => named,
        };
        let (radiosity, iterations) = match solver {
            Solver::Jacobi => jacobi::solve(self, options, progress)?,
            Solver::GaussSeidel => gauss_seidel::solve(self, options, progress)?,
            Solver::Southwell => southwell::solve(self, options, progress)?,
            Solver::Direct => direct::solve(self)?,
            _ => {
                let (iterate, irradiance) = conjugate_gradient::solve(self, start, options, progress)?;
                return self.finish(solver, iterate, irradiance, options);
            }
        };
        let irradiance = self.irradiance(&radiosity);
        self.finish(solver, (radiosity, iterations), irradiance, options)
    }

    /// Judges the result by its own residual, whatever the algorithm believed.
    fn finish(
        &self,
        solver: Solver,
        (radiosity, iterations): Iterate<C>,
        irradiance: Vec<[f64; C]>,
        options: &SolveOptions,
    ) -> Result<Solution> {
        let residual = self.relative_residual(&radiosity, &irradiance);
        // Negated so that NaN does not pass.
        if !(residual <= options.tolerance.max(self.attainable(&radiosity, options.tolerance))) {
            return Err(Error::NotConverged {
                solver: solver.name(),
                iterations,
                residual,
                tolerance: options.tolerance,
            });
        }
        let is_light = |b: &[f64; C]| b.iter().all(|&b| b.is_finite() && b >= 0.0);
        debug_assert!(radiosity.iter().all(is_light), "radiosity is not negative");
        let error_bound = self.error_bound(&radiosity, &irradiance);
        let (mut radiosity, mut irradiance) = (radiosity, irradiance);
        for (i, direct) in self.direct.iter().flatten().enumerate() {
            let is_lamp = self.form_factors.is_lamp(i);
            for c in 0..C {
                irradiance[i][c] += direct[c];
                radiosity[i][c] += if is_lamp { self.emission[i][c] } else { 0.0 };
            }
        }
        Ok(Solution {
            channels: C,
            error_bound,
            radiosity: radiosity.into_flattened(),
            irradiance: irradiance.into_flattened(),
            solver,
            iterations,
            residual,
            linear: None,
        })
    }

    /// F U.
    pub(crate) fn irradiance(&self, radiosity: &[[f64; C]]) -> Vec<[f64; C]> {
        let mut irradiance = vec![[0.0; C]; radiosity.len()];
        self.form_factors.irradiance_into::<f64, C>(radiosity.as_flattened(), irradiance.as_flattened_mut());
        irradiance
    }

    /// S + ρ F U - U of patch `i`.
    pub(crate) fn residual(&self, i: usize, radiosity: &[f64; C], irradiance: &[f64; C]) -> [f64; C] {
        std::array::from_fn(|c| self.source[i][c] + self.reflectance[i][c] * irradiance[c] - radiosity[c])
    }

    /// Σ A Be and what enters, for each channel.
    pub(crate) fn emitted(&self) -> [f64; C] {
        let mut sum = self.entered;
        for (area, emission) in self.form_factors.areas().iter().zip(self.emission) {
            for c in 0..C {
                sum[c] += area * emission[c];
            }
        }
        sum
    }

    /// Σ A |r| / Σ A Be of the worst channel; a dark channel has none.
    pub(crate) fn relative(&self, residuals: impl Iterator<Item = [f64; C]>) -> f64 {
        let mut sum = [0.0; C];
        for (area, r) in self.form_factors.areas().iter().zip(residuals) {
            for c in 0..C {
                sum[c] += area * r[c].abs();
            }
        }
        let emitted = self.emitted();
        (0..C)
            .map(|c| if sum[c] == 0.0 { 0.0 } else { sum[c] / emitted[c] })
            .fold(0.0, |a, b| if b > a || b.is_nan() { b } else { a })
    }

    /// The relative residual that rounding leaves whatever the algorithm: eight units in the last place of what leaves and
    /// what arrives, each summed and scaled. Where all but 10⁻⁷ is reflected it exceeds a tolerance of 10⁻¹⁰, since what is
    /// emitted is so little beside it. Who demands more than that of all light alike is not given it.
    fn attainable(&self, radiosity: &[[f64; C]], tolerance: f64) -> f64 {
        const ROUNDINGS: f64 = 8.0 * f64::EPSILON;
        if tolerance < ROUNDINGS {
            return 0.0;
        }
        self.relative(radiosity.iter().map(|b| b.map(|b| ROUNDINGS * b)))
    }

    /// The relative residual of a radiosity with its irradiance.
    pub(crate) fn relative_residual(&self, radiosity: &[[f64; C]], irradiance: &[[f64; C]]) -> f64 {
        self.relative((0..radiosity.len()).map(|i| self.residual(i, &radiosity[i], &irradiance[i])))
    }

    /// Max-norm bound ‖B - B*‖ ≤ ‖r‖ / (1 - max ρ_i Σ_j F_ij): the rows of ρF sum to less than one, so its Neumann
    /// series is bounded by a geometric one.
    fn error_bound(&self, radiosity: &[[f64; C]], irradiance: &[[f64; C]]) -> f64 {
        let escaped = self.form_factors.escaped();
        let mut worst = 0f64;
        for c in 0..C {
            let mut residual = 0f64;
            let mut loss = f64::INFINITY;
            for i in 0..radiosity.len() {
                residual = residual.max(self.residual(i, &radiosity[i], &irradiance[i])[c].abs());
                // 1 - ρ (1 - e) without cancellation.
                let rho = self.reflectance[i][c];
                loss = loss.min((1.0 - rho) + rho * escaped[i]);
            }
            if residual > 0.0 {
                worst = worst.max(residual / loss);
            }
        }
        worst
    }

    /// Refuses a scene in which light is caught: an emitter from which no path of light leads to anything that absorbs
    /// or to the outside.
    fn check_equilibrium(&self) -> Result<()> {
        let is_caught =
            |(drained, source): (&[bool; C], &[f64; C])| (0..C).any(|c| !drained[c] && source[c] > 0.0);
        if self.drained().iter().zip(&*self.source).any(is_caught) {
            return Err(Error::NoEquilibrium);
        }
        Ok(())
    }

    /// Whether a path of light leads from each patch to anything that absorbs or to the outside, in each channel.
    pub(crate) fn drained(&self) -> Vec<[bool; C]> {
        let loses = |(reflectance, &escaped): (&[f64; C], &f64)| {
            reflectance.map(|rho| if rho < 1.0 || escaped > 0.0 { 1.0 } else { 0.0 })
        };
        let mut drained: Vec<[f64; C]> =
            self.reflectance.iter().zip(self.form_factors.escaped()).map(loses).collect();
        // From the losing patches backwards along the light, a bounce each time: a product needs no rows of the matrix, and
        // is right for hits that are not mutual too.
        let mut changed = drained.as_flattened().contains(&0.0);
        while changed {
            changed = false;
            let reaches = self.irradiance(&drained);
            for (drained, &reaches) in drained.as_flattened_mut().iter_mut().zip(reaches.as_flattened()) {
                if *drained == 0.0 && reaches > 0.0 {
                    *drained = 1.0;
                    changed = true;
                }
            }
        }
        drained.into_iter().map(|drained| drained.map(|drained| drained > 0.0)).collect()
    }
}
