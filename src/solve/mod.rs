//! The radiosity equation E = D + F (B - Bd), B = Be + ρ E.
//!
//! Bd is the emission of lamps, and D the direct light of lamps and other lights. With U = B - Bd the equation becomes
//! U = (Be - Bd + ρ D) + ρ F U: the same system as without lamps, with another source.
//!
//! All solvers handle every channel in one pass over the matrix. They report their iterations, the true relative
//! residual of the result, and a certified bound on its distance from the exact solution of the discrete system. A
//! solver that does not converge returns an error.

mod batches;
pub mod by_lamp;
pub mod conjugate_gradient;
pub mod direct;
mod few_rays;
pub mod gauss_seidel;
pub mod jacobi;
pub mod linear;
pub mod southwell;
pub mod stochastic_jacobi;
pub mod sweep;

use std::borrow::Cow;

use crate::{
    Error, Progress, Result, Setting,
    form_factor::{DirectLight, Estimator, FormFactors, together},
    patch::Patches,
};
pub use linear::{LinearLight, solve_linear};
use stochastic_jacobi::StochasticSolution;

/// The solver for the radiosity system.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Solver {
    /// Conjugate gradients if the form factors are reciprocal, otherwise Gauss-Seidel.
    #[default]
    Auto,
    /// [`jacobi`]: every patch gathers from the last sweep. Simple and parallel, but slow in bright rooms.
    Jacobi,
    /// [`gauss_seidel`]: every patch gathers from the newest values. Takes about half the sweeps of Jacobi, but is
    /// serial.
    GaussSeidel,
    /// [`southwell`]: the patch with the most unshot power shoots (progressive refinement).
    Southwell,
    /// [`conjugate_gradient`] on the symmetrised system: few iterations even if hardly any light is absorbed.
    ConjugateGradient,
    /// [`direct`]: dense LU decomposition, for small scenes and for testing the other solvers.
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

/// Options for solving.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct SolveOptions {
    /// The solver.
    pub solver: Solver,
    /// Stop when Σ A |residual| is at most this share of the power that is emitted and enters, in every channel, or is
    /// as small as rounding permits. The energy imbalance left by the solver is then at most as large.
    pub tolerance: f64,
    /// Give up after this many iterations. For Southwell the limit is this number times the number of patches, in
    /// shots.
    pub max_iterations: usize,
    /// Whether [`solve_linear`] lets light vary linearly over each patch. Otherwise light is constant, as with
    /// [`solve()`].
    pub linear: bool,
}

setters!(SolveOptions {
    with_solver(solver: Solver),
    with_tolerance(tolerance: f64),
    with_max_iterations(max_iterations: usize),
    with_linear(linear: bool),
});

impl Default for SolveOptions {
    /// Solver chosen by the system, tolerance 1e-10, at most 10,000 iterations, linear light.
    fn default() -> Self {
        SolveOptions { solver: Solver::Auto, tolerance: 1e-10, max_iterations: 10_000, linear: true }
    }
}

impl SolveOptions {
    /// These options with a tolerance that suffices for estimating errors.
    pub(crate) fn rough(&self) -> SolveOptions {
        SolveOptions { tolerance: self.tolerance.max(1e-4), ..*self }
    }
}

/// Emission and reflectance of the patches: the right-hand side and the diagonal of the system.
#[derive(Debug, Clone, Copy)]
pub struct Radiometry<'a> {
    /// Number of channels, 1 or 3. Values are interleaved.
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

/// The light on every patch, `channels` interleaved values a patch.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Solution {
    /// Number of channels, 1 or 3.
    pub channels: usize,
    /// Radiosity B, W/m²: emitted and reflected light.
    pub radiosity: Vec<f64>,
    /// Irradiance E, W/m²: arriving light.
    pub irradiance: Vec<f64>,
    /// The part of the irradiance that surfaces have reflected, W/m²: F (B - Be). The rest comes straight from lights.
    pub reflected: Vec<f64>,
    /// The solver that ran; never [`Solver::Auto`].
    pub solver: Solver,
    /// Its number of iterations: sweeps, products with the matrix, or shots.
    pub iterations: usize,
    /// Σ A |Be + ρ E - B|, relative to the power that is emitted and enters, in the worst channel, computed from the
    /// result itself.
    pub residual: f64,
    /// Upper bound on the distance of each patch's radiosity from the exact solution of the discrete system, W/m².
    /// Infinite if a patch reflects everything and no light escapes from it.
    pub error_bound: f64,
    /// Variation of irradiance over each patch; `None` if light is constant.
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

    /// Irradiance computed with constant light on each patch, W/m², interleaved channels.
    pub(crate) fn constant_irradiance(&self) -> &[f64] {
        self.linear.as_ref().map_or(&self.irradiance, |linear| &linear.constant)
    }
}

fn rgb(values: &[f64], channels: usize, i: usize) -> [f64; 3] {
    std::array::from_fn(|c| values[i * channels + if channels == 1 { 0 } else { c }])
}

/// The light on every patch, from any solver, for writing files.
#[derive(Debug, Clone, Copy)]
pub struct Light<'a> {
    /// Radiosity B, W/m²; interleaved channels.
    pub radiosity: &'a [f64],
    /// Irradiance E, W/m².
    pub irradiance: &'a [f64],
    /// Slopes of irradiance ([`LinearLight::slopes`]); empty if light is constant over each patch.
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

/// Solves for the light of these form factors and lamps. The emission may differ from the emission that the rays were
/// cast for. Patches that were not lamps then send their light through form factors.
///
/// # Errors
/// [`Error::NoEquilibrium`] when light enters a part of the scene that absorbs nothing and lets nothing out;
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
    solve_from(None, form_factors, radiometry.into(), options, progress)
}

/// Like [`solve`], from a radiosity near the solution. Conjugate gradients then take fewer iterations. The other
/// solvers ignore it.
pub(crate) fn solve_from(
    start: Option<&[f64]>,
    form_factors: &FormFactors,
    radiometry: Radiometry<'_>,
    options: &SolveOptions,
    progress: &Progress,
) -> Result<Solution> {
    let n = form_factors.len() * radiometry.channels;
    assert_eq!((radiometry.emission.len(), radiometry.reflectance.len()), (n, n), "sizes disagree");
    progress.begin("solving", 0);
    together(|| match radiometry.channels {
        1 => System::<1>::new(form_factors, radiometry).solve(start, options, progress),
        3 => System::<3>::new(form_factors, radiometry).solve(start, options, progress),
        c => panic!("{c} channels: must be 1 or 3"),
    })
}

/// The system U = S + ρ F U, with the number of channels known at compile time.
pub(crate) struct System<'a, const C: usize> {
    pub(crate) form_factors: &'a FormFactors,
    /// S = Be - Bd + ρ D.
    pub(crate) source: Cow<'a, [[f64; C]]>,
    pub(crate) reflectance: &'a [[f64; C]],
    /// Be.
    emission: &'a [[f64; C]],
    /// D, if there are lamps or other lights.
    direct: Option<Vec<[f64; C]>>,
    /// Power of the part of D that enters from outside the patches.
    entered: [f64; C],
}

/// The result of an algorithm: radiosity, and iterations done.
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

    /// The system with `more` irradiance on each patch in addition to the direct light.
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

    /// U of a radiosity B: B without the emission of lamps. For black patches U is the known source.
    fn unknowns(&self, radiosity: &[[f64; C]]) -> Vec<[f64; C]> {
        let of_patch = |(i, b): (usize, &[f64; C])| {
            let emitted = if self.form_factors.is_lamp(i) { self.emission[i] } else { [0.0; C] };
            std::array::from_fn(|c| match self.reflectance[i][c] > 0.0 {
                true => (b[c] - emitted[c]).max(0.0),
                false => self.source[i][c],
            })
        };
        radiosity.iter().enumerate().map(of_patch).collect()
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

    /// Checks the result by its own residual, independently of the algorithm.
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
        let reflected = self.reflected(&radiosity, &irradiance);
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
            reflected: reflected.into_flattened(),
            solver,
            iterations,
            residual,
            linear: None,
        })
    }

    /// The part of F U that surfaces have reflected: all of it, unless form factors carry the light of emitters.
    fn reflected(&self, radiosity: &[[f64; C]], irradiance: &[[f64; C]]) -> Vec<[f64; C]> {
        let emits = |i: &usize| !self.form_factors.is_lamp(*i) && self.emission[*i].iter().any(|&e| e > 0.0);
        if !(0..radiosity.len()).any(|i| emits(&i)) {
            return irradiance.to_vec();
        }
        let mut reflected = radiosity.to_vec();
        for i in (0..reflected.len()).filter(emits) {
            (0..C).for_each(|c| reflected[i][c] = (reflected[i][c] - self.emission[i][c]).max(0.0));
        }
        self.irradiance(&reflected)
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

    /// Σ A Be plus the power that enters, for each channel.
    pub(crate) fn emitted(&self) -> [f64; C] {
        let mut sum = self.entered;
        for (area, emission) in self.form_factors.areas().iter().zip(self.emission) {
            for c in 0..C {
                sum[c] += area * emission[c];
            }
        }
        sum
    }

    /// Σ A |r| relative to the power that is emitted and enters, in the worst channel; 0 for a dark channel.
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

    /// The relative residual that rounding leaves in any algorithm: eight units in the last place of the leaving and
    /// the arriving light, each summed and scaled. If surfaces reflect all but 10⁻⁷ of the light, it exceeds a
    /// tolerance of 10⁻¹⁰, because the emitted light is so small in comparison. A tolerance below eight roundings is
    /// not relaxed.
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

    /// Max-norm bound ‖B - B*‖ ≤ ‖r‖ / (1 - max ρ_i Σ_j F_ij): the row sums of ρF are less than one, so that a
    /// geometric series bounds its Neumann series.
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

    /// Refuses a scene that traps light: an emitter from which no path of light leads to an absorbing surface or to the
    /// outside.
    fn check_equilibrium(&self) -> Result<()> {
        let is_caught =
            |(drained, source): (&[bool; C], &[f64; C])| (0..C).any(|c| !drained[c] && source[c] > 0.0);
        if self.drained().iter().zip(&*self.source).any(is_caught) {
            return Err(Error::NoEquilibrium);
        }
        Ok(())
    }

    /// Whether a path of light leads from each patch to an absorbing surface or to the outside, in each channel.
    pub(crate) fn drained(&self) -> Vec<[bool; C]> {
        let loses = |(reflectance, &escaped): (&[f64; C], &f64)| {
            reflectance.map(|rho| if rho < 1.0 || escaped > 0.0 { 1.0 } else { 0.0 })
        };
        let mut drained: Vec<[f64; C]> =
            self.reflectance.iter().zip(self.form_factors.escaped()).map(loses).collect();
        // Goes backwards along the light from the absorbing patches, a bounce at a time. A product needs no rows of the
        // matrix, and is also right for one-way form factors.
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
