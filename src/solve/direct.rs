//! Dense LU decomposition of I - ρ F, one system for each channel. Tests compare other solvers with it in small scenes.

use nalgebra::{DMatrix, DVector};

use super::{Iterate, System};
use crate::{Error, Result, Setting, form_factor::row};

/// Time grows with the cube: 0.15 s for 1000 patches, about 8 s for 3000.
const MOST_PATCHES: usize = 4096;

/// Solves, with one step of iterative refinement.
pub(super) fn solve<const C: usize>(system: &System<C>) -> Result<Iterate<C>> {
    let n = system.form_factors.len();
    if n > MOST_PATCHES {
        return Err(Error::setting(
            &[Setting::Solver, Setting::Patches],
            format!("the direct solver takes at most {MOST_PATCHES} patches, the scene has {n}"),
            "use conjugate gradients, or fewer patches",
        ));
    }
    let (rows, (left, right)) = (system.form_factors.rows(), system.form_factors.scaling());
    let mut radiosity = vec![[0.0; C]; n];
    let drained = system.drained();
    for c in 0..C {
        let mut matrix = DMatrix::<f64>::identity(n, n);
        // Patches whose light could never be absorbed or escape receive none, or there would be no equilibrium. Their
        // rows would be singular together, so they are replaced by B = 0.
        for i in (0..n).filter(|&i| drained[i][c]) {
            let (columns, values) = row(&rows, i);
            for (&j, &s) in columns.iter().zip(values) {
                let form_factor = left[i] * f64::from(s) * right[j as usize];
                matrix[(i, j as usize)] -= system.reflectance[i][c] * form_factor;
            }
        }
        let emission = DVector::from_iterator(n, system.source.iter().map(|e| e[c]));
        let lu = matrix.clone().lu();
        let solved = lu.solve(&emission).and_then(|mut b| {
            b += lu.solve(&(&emission - &matrix * &b))?;
            Some(b)
        });
        for (b, value) in radiosity.iter_mut().zip(solved.ok_or(Error::NoEquilibrium)?.iter()) {
            b[c] = value.max(0.0);
        }
    }
    Ok((radiosity, 1))
}
