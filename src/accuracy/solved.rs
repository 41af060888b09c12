//! A solved scene: the solution with its patches, form factors and error bars.

use crate::{
    Progress, Result,
    accuracy::error_bars::ErrorBars,
    form_factor::{CastOptions, FormFactors},
    patch::{Patches, Subdivision},
    scene::Scene,
    solve::{Solution, SolveOptions, solve_linear},
    trace::Tracer,
};

/// A scene solved at one patch size.
#[derive(Debug)]
pub struct Solved {
    /// The patches.
    pub patches: Patches,
    /// The form factors of the patches.
    pub form_factors: FormFactors,
    /// The solution.
    pub solution: Solution,
    /// Standard errors of the solution.
    pub error_bars: ErrorBars,
}

impl Solved {
    /// Subdivides the scene, casts rays, solves and estimates the errors.
    ///
    /// # Errors
    /// See [`FormFactors::cast`] and [`solve_linear`].
    pub fn new(
        scene: &Scene,
        tracer: &Tracer,
        subdivision: &Subdivision,
        cast: &CastOptions,
        options: &SolveOptions,
        progress: &Progress,
    ) -> Result<Solved> {
        Self::of_patches(scene, tracer, Patches::subdivide(scene, subdivision), cast, options, progress)
    }

    /// Like [`Solved::new`], for given patches.
    ///
    /// # Errors
    /// See [`FormFactors::cast`] and [`solve_linear`].
    pub fn of_patches(
        scene: &Scene,
        tracer: &Tracer,
        mut patches: Patches,
        cast: &CastOptions,
        options: &SolveOptions,
        progress: &Progress,
    ) -> Result<Solved> {
        let form_factors = FormFactors::cast(scene, tracer, &mut patches, cast, progress)?;
        let solution = solve_linear((scene, tracer), &form_factors, &patches, options, progress)?;
        let error_bars =
            ErrorBars::of(&form_factors, &patches, &solution).expect("the form factors were sampled");
        Ok(Solved { patches, form_factors, solution, error_bars })
    }
}
