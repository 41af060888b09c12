//! Solvers on matrices that are known exactly, those of the unit cube.

use crate::common::*;
use glam::DVec3;
use nalgebra::{DMatrix, DVector};
use radiosity::{
    Error, Progress, Result,
    form_factor::{
        CastOptions, Estimator, FormFactors,
        exact::{box_room_patches, rectangle_form_factors},
    },
    patch::Subdivision,
    solve::{Radiometry, Solution, SolveOptions, Solver, solve, southwell::Shooting},
};

const ITERATIVE: [Solver; 4] =
    [Solver::Jacobi, Solver::GaussSeidel, Solver::Southwell, Solver::ConjugateGradient];
const ALL: [Solver; 5] =
    [Solver::Jacobi, Solver::GaussSeidel, Solver::Southwell, Solver::ConjugateGradient, Solver::Direct];

/// The unit cube with `n` by `n` patches per face. The faces follow one after the other.
fn cube(n: usize) -> (DMatrix<f64>, FormFactors) {
    let patches = box_room_patches(DVec3::ONE, n);
    let exact = rectangle_form_factors(&patches);
    let areas: Vec<f64> = patches.iter().map(|p| p.area()).collect();
    let count = patches.len();
    let matrix = store(count, |i, j| areas[i] * exact[(i, j)]);
    (exact, FormFactors::from_exchange(matrix, areas, vec![0.0; count]))
}

/// Emission and reflectance of all patches.
struct Light {
    channels: usize,
    emission: Vec<f64>,
    reflectance: Vec<f64>,
}

impl Light {
    fn uniform(n: usize, lit: usize, rho: f64) -> Light {
        let emission = (0..n).map(|i| if i < lit { 1.0 } else { 0.0 }).collect();
        Light { channels: 1, emission, reflectance: vec![rho; n] }
    }

    /// About a tenth of the patches emit. No reflectance is above `most`.
    fn random(n: usize, channels: usize, most: f64, seed: u64) -> Light {
        let mut random = Random::new(seed);
        let dark: Vec<bool> = (0..n).map(|i| i > 0 && random.next() < 0.9).collect();
        let emission = (0..n * channels).map(|k| if dark[k / channels] { 0.0 } else { random.next() });
        let emission = emission.collect();
        let reflectance = (0..n * channels).map(|_| random.between(0.0, most)).collect();
        Light { channels, emission, reflectance }
    }

    fn channel(&self, c: usize) -> Light {
        let pick = |values: &[f64]| values.iter().skip(c).step_by(self.channels).copied().collect();
        Light { channels: 1, emission: pick(&self.emission), reflectance: pick(&self.reflectance) }
    }

    fn solve(&self, f: &FormFactors, solver: Solver, tolerance: f64) -> Result<Solution> {
        self.solve_with(f, SolveOptions::default().with_solver(solver).with_tolerance(tolerance))
    }

    fn solve_with(&self, f: &FormFactors, options: SolveOptions) -> Result<Solution> {
        let Light { channels, emission, reflectance } = self;
        solve(f, Radiometry { channels: *channels, emission, reflectance }, &options, &Progress::new())
    }

    /// Be + ρ F B - B, computed from the entries of the matrix one by one.
    fn residuals(&self, f: &FormFactors, b: &[f64]) -> Vec<f64> {
        let k = self.channels;
        let at = |i: usize, c: usize| {
            let e: f64 = f.row(i).map(|(j, x)| x * b[j * k + c]).sum();
            self.emission[i * k + c] + self.reflectance[i * k + c] * e - b[i * k + c]
        };
        (0..f.len() * k).map(|at_ik| at(at_ik / k, at_ik % k)).collect()
    }

    /// Σ A |r| / Σ A Be, of the worst channel.
    fn relative_residual(&self, f: &FormFactors, b: &[f64]) -> f64 {
        let r = self.residuals(f, b);
        let (k, a) = (self.channels, f.areas());
        let sum = |v: &[f64], c: usize| (0..a.len()).map(|i| a[i] * v[i * k + c].abs()).sum::<f64>();
        (0..k).map(|c| sum(&r, c) / sum(&self.emission, c)).fold(0.0, f64::max)
    }
}

fn farthest(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Error of radiosity by storage in single precision. Closed rows have an error of 6e-8, and the closure as much again.
/// With E at most max B, and ‖(I - ρF)⁻¹‖ at most 1 / (1 - ρ), the error of B is at most 2 · 6e-8 ρ / (1 - ρ) max B.
fn storage_error(rho: f64, radiosity: f64) -> f64 {
    2.0 * F32 * rho / (1.0 - rho) * radiosity
}

/// A cube of six patches has a solution in closed form. All solvers give it, up to storage in single precision.
#[test]
fn the_cube_of_six_patches() {
    let (_, f) = cube(1);
    for (rho, emitter, opposite, side) in [
        (0.5, 1.090909098108, 0.181745826108, 0.181836268946),
        (0.8, 1.551724153645, 0.689551070738, 0.689681193904),
    ] {
        for solver in ALL {
            let b = Light::uniform(6, 1, rho).solve(&f, solver, 1e-12).unwrap().radiosity;
            let wanted = [emitter, opposite, side, side, side, side];
            let slack = storage_error(rho, emitter) + 1e-12;
            assert!(farthest(&b, &wanted) <= slack, "{solver:?}: {b:?} instead of {wanted:?}");
        }
    }
}

/// All solvers agree with the dense solution of the exact matrix in double precision, up to storage and their certified
/// bounds.
#[test]
fn finer_cubes_against_dense_algebra() {
    for (n, seed) in [(3, 1), (5, 2)] {
        let (exact, f) = cube(n);
        let light = Light::random(f.len(), 1, 0.9, seed);
        let mut system = -exact;
        for i in 0..f.len() {
            system.row_mut(i).scale_mut(light.reflectance[i]);
            system[(i, i)] += 1.0;
        }
        let truth = system.lu().solve(&DVector::from_vec(light.emission.clone())).unwrap();
        for solver in ALL {
            let solution = light.solve(&f, solver, 1e-12).unwrap();
            let slack = storage_error(0.9, truth.max()) + solution.error_bound;
            assert!(farthest(&solution.radiosity, truth.as_slice()) <= slack, "{solver:?}");
        }
    }
}

/// Two solutions differ at most by the sum of their certified bounds. The sums of the bounds round at some 1e-15.
#[test]
fn solvers_agree_to_their_certified_bounds() {
    for (n, channels) in [(4, 1), (4, 3), (5, 3), (6, 1), (6, 3)] {
        let (_, f) = cube(n);
        let light = Light::random(f.len(), channels, 0.95, n as u64);
        let direct = light.solve(&f, Solver::Direct, 1e-12).unwrap();
        // Rows of 200 terms, and max B below 20.
        assert!(direct.error_bound < 1e-12, "{}", direct.error_bound);
        for solver in ITERATIVE {
            for tolerance in [1e-2, 1e-4, 1e-6, 1e-10] {
                let solution = light.solve(&f, solver, tolerance).unwrap();
                let distance = farthest(&solution.radiosity, &direct.radiosity);
                let bound = solution.error_bound + direct.error_bound + 1e-14;
                assert!(distance <= bound, "{solver:?} at {tolerance}: {distance:e} > {bound:e}");
                assert_eq!((solution.solver, solution.channels), (solver, channels));
            }
        }
    }
}

/// The reported residual, irradiance and bound agree with values recomputed from each F_ij.
#[test]
fn reported_residuals_are_the_true_ones() {
    let (_, f) = cube(5);
    for channels in [1, 3] {
        let light = Light::random(f.len(), channels, 0.9, 9);
        for (solver, tolerance) in ALL.into_iter().flat_map(|s| [1e-2, 1e-5, 1e-10].map(|t| (s, t))) {
            let solution = light.solve(&f, solver, tolerance).unwrap();
            let residual = light.relative_residual(&f, &solution.radiosity);
            assert!(residual <= tolerance);
            // Sums of 150 radiosities below 10 round at some 1e-15.
            assert!((solution.residual - residual).abs() <= 1e-13, "{solver:?}: {residual:e}");
            let worst_loss = light.reflectance.iter().copied().fold(0.0, f64::max);
            let largest = light.residuals(&f, &solution.radiosity);
            let largest = largest.iter().fold(0f64, |a, r| a.max(r.abs()));
            // The reported bound is computed per channel and may be sharper, but never larger than this one.
            assert!(solution.error_bound <= largest / (1.0 - worst_loss) + 1e-13);
            assert!(solution.error_bound >= largest - 1e-14);
            for (k, e) in solution.irradiance.iter().enumerate() {
                let (i, c) = (k / channels, k % channels);
                let sum: f64 = f.row(i).map(|(j, x)| x * solution.radiosity[j * channels + c]).sum();
                assert!((sum - e).abs() < 1e-13);
            }
        }
    }
}

/// In a closed room of one reflectance each Jacobi sweep multiplies the sum of the residual by exactly ρ, from ρ at the
/// start. Gauss-Seidel needs fewer sweeps (Stein and Rosenberg). Conjugate gradients need at most as many iterations as
/// Chebyshev's bound for eigenvalues between 1 - ρ and 1 + ρ.
#[test]
fn iterations_are_as_many_as_theory_says() {
    let (_, f) = cube(6);
    let tolerance = 1e-6f64;
    for rho in [0.5, 0.8, 0.95] {
        let light = Light::uniform(f.len(), 36, rho);
        let [jacobi, gauss_seidel, southwell, cg] =
            ITERATIVE.map(|s| light.solve(&f, s, tolerance).unwrap().iterations);
        let wanted = (tolerance.ln() / f64::ln(rho)).ceil() as usize - 1;
        assert_eq!(jacobi, wanted, "rho = {rho}");
        assert!(cg < gauss_seidel && gauss_seidel < jacobi, "rho = {rho}: {cg}, {gauss_seidel}, {jacobi}");
        assert!(southwell < jacobi * f.len(), "rho = {rho}: {southwell} shots");
        // ‖r_k‖ ≤ 2 sqrt(κ) q^k ‖r_0‖. In this norm the solver aims at half the tolerance.
        let kappa = ((1.0 + rho) / (1.0 - rho)).sqrt();
        let q = (kappa - 1.0) / (kappa + 1.0);
        let most = (0.5 * tolerance / (2.0 * kappa)).ln() / q.ln();
        assert!(cg as f64 <= most.ceil(), "rho = {rho}: {cg} iterations, at most {most}");
    }
}

/// Shooting only adds light, and never more than the solution has.
#[test]
fn southwell_rises_from_below() {
    let (_, f) = cube(6);
    let n = f.len();
    let light = Light::random(n, 1, 0.9, 4);
    let Light { emission, reflectance, .. } = &light;
    let radiometry = Radiometry { channels: 1, emission, reflectance };
    let truth = light.solve(&f, Solver::Direct, 1e-12).unwrap();
    let mut shooting = Shooting::<1>::new(&f, radiometry);
    let (mut before, mut residual) = (shooting.radiosity(), shooting.residual());
    assert_eq!(before.as_flattened(), emission);
    assert!((residual - 1.0).abs() < 1e-15, "all light is unshot");
    for shot in 1..=3 * n {
        let i = shooting.shoot().unwrap();
        assert!(i < n && shooting.shots() == shot);
        let after = shooting.radiosity();
        for i in 0..n {
            assert!(after[i] >= before[i], "patch {i} loses light at shot {shot}");
            assert!(after[i][0] <= truth.radiosity[i] + truth.error_bound + 1e-13);
        }
        // Each of 216 unshot values may round up.
        assert!(shooting.residual() <= residual * (1.0 + 1e-13), "shot {shot}");
        (before, residual) = (after, shooting.residual());
    }
    // Unshot light has not arrived elsewhere yet. One reflection of it is left as the residual: at most 0.9 of it.
    let recomputed = light.relative_residual(&f, before.as_flattened());
    assert!(recomputed <= 0.9 * residual && recomputed > 0.0, "{recomputed:e}, {residual:e} unshot");
}

/// In a black room B = Be to the bit, and E = F Be up to storage in single precision.
#[test]
fn black_rooms_hold_what_is_emitted() {
    let (exact, f) = cube(2);
    let light = Light { reflectance: vec![0.0; 24], ..Light::random(24, 1, 0.0, 3) };
    let irradiance = exact * DVector::from_vec(light.emission.clone());
    for solver in ALL {
        let solution = light.solve(&f, solver, 1e-12).unwrap();
        assert_eq!(solution.radiosity, light.emission, "{solver:?}");
        assert_eq!((solution.residual, solution.error_bound), (0.0, 0.0));
        assert!(farthest(&solution.irradiance, irradiance.as_slice()) <= 2.0 * F32);
    }
}

/// White walls with one side open: exactly the emitted light leaves.
#[test]
fn white_with_an_opening() {
    let n = 3;
    let patches = box_room_patches(DVec3::ONE, n);
    let exact = rectangle_form_factors(&patches);
    let (walls, area) = (5 * n * n, patches[0].area());
    let opening = |i: usize| (walls..6 * n * n).map(|j| exact[(i, j)]).sum();
    let f = FormFactors::from_exchange(
        store(walls, |i, j| area * exact[(i, j)]),
        vec![area; walls],
        (0..walls).map(opening).collect(),
    );
    let light = Light::uniform(walls, 4, 1.0);
    for solver in ALL {
        let tolerance = 1e-9;
        let solution = light.solve(&f, solver, tolerance).unwrap();
        assert!(solution.error_bound.is_finite());
        let out: f64 = (0..walls).map(|i| area * solution.radiosity[i] * f.escaped()[i]).sum();
        // Light that has not left is the sum of the residual.
        assert!((out / (4.0 * area) - 1.0).abs() <= tolerance + 1e-13, "{solver:?}: {out}");
    }
}

/// Two cubes that do not see each other, the first white, the second grey.
fn two_chambers() -> FormFactors {
    let exact = rectangle_form_factors(&box_room_patches(DVec3::ONE, 1));
    let matrix = store(12, |i, j| if i / 6 == j / 6 { exact[(i % 6, j % 6)] } else { 0.0 });
    FormFactors::from_exchange(matrix, vec![1.0; 12], vec![0.0; 12])
}

/// Light that enters a closed white chamber has no equilibrium, in whichever channel. One black patch, or no light,
/// gives one.
#[test]
fn light_that_is_caught_is_refused() {
    let (_, f) = cube(2);
    let chambers = two_chambers();
    let reflectance: Vec<f64> = (0..12).map(|i| if i < 6 { 1.0 } else { 0.5 }).collect();
    let lit = |from: usize| Light {
        channels: 1,
        emission: (0..12).map(|i| if i == from { 1.0 } else { 0.0 }).collect(),
        reflectance: reflectance.clone(),
    };
    for solver in ALL.into_iter().chain([Solver::Auto]) {
        let white = Light::uniform(24, 1, 1.0).solve(&f, solver, 1e-6);
        assert!(matches!(white, Err(Error::NoEquilibrium)), "{solver:?}: {white:?}");
        let caught = lit(0).solve(&chambers, solver, 1e-6);
        assert!(matches!(caught, Err(Error::NoEquilibrium)), "{solver:?}: {caught:?}");
        // One black patch, or a lamp in the other chamber, gives an equilibrium.
        let mut drained = Light::uniform(24, 1, 1.0);
        drained.reflectance[7] = 0.0;
        drained.solve(&f, solver, 1e-6).unwrap();
    }
    // A chamber that no light enters stays dark, although its part of the matrix is singular, also for the direct
    // solver.
    for solver in ALL {
        let solution = lit(6).solve(&chambers, solver, 1e-9).unwrap();
        assert_eq!(solution.radiosity[..6], [0.0; 6], "{solver:?}");
        assert!(solution.radiosity[6..].iter().all(|&b| b > 0.1));
    }
    // One channel is enough to refuse.
    let mut coloured = Light::random(24, 3, 0.9, 1);
    coloured.reflectance.iter_mut().skip(2).step_by(3).for_each(|rho| *rho = 1.0);
    assert!(matches!(coloured.solve(&f, Solver::Auto, 1e-6), Err(Error::NoEquilibrium)));
}

/// Ten white patches in a row, each of which sees only its neighbours. Light reaches the grey one at the far end after
/// nine bounces, and all of it is absorbed there.
#[test]
fn light_that_drains_by_many_bounces_is_not_refused() {
    let n = 10;
    let sees = |i: usize, j: usize| i.abs_diff(j) == 1 || i == j && (i == 0 || i == n - 1);
    let row = store(n, |i, j| if sees(i, j) { 0.5 } else { 0.0 });
    let row = FormFactors::from_exchange(row, vec![1.0; n], vec![0.0; n]);
    let mut light = Light::uniform(n, 1, 1.0);
    light.emission = (0..n).map(|i| if i == 0 { 1.0 } else { 0.0 }).collect();
    assert!(matches!(light.solve(&row, Solver::Auto, 1e-9), Err(Error::NoEquilibrium)));
    light.reflectance[n - 1] = 0.5;
    for solver in ALL {
        let solution = light.solve(&row, solver, 1e-9).unwrap();
        // Light that has not been absorbed is the sum of the residual.
        assert!((0.5 * solution.irradiance[n - 1] - 1.0).abs() < 2e-9, "{solver:?}");
    }
}

/// A solver that runs out of iterations reports how far it came.
#[test]
fn running_out_of_iterations_is_an_error() {
    let (_, f) = cube(4);
    let light = Light::uniform(f.len(), 16, 0.95);
    for solver in ITERATIVE {
        let options = SolveOptions::default().with_solver(solver).with_max_iterations(1);
        match light.solve_with(&f, options) {
            Err(Error::NotConverged { solver: name, iterations, residual, tolerance }) => {
                assert_eq!((name, tolerance), (solver.name(), 1e-10));
                assert_eq!(iterations, if solver == Solver::Southwell { f.len() } else { 1 });
                assert!(residual > tolerance);
                // Every bounce absorbs a twentieth. Conjugate gradients minimise another norm.
                assert!(residual <= 0.95 + 1e-12 || solver == Solver::ConjugateGradient, "{residual}");
            }
            other => panic!("{solver:?}: {other:?}"),
        }
    }
}

/// The channels of a colour are solved as if each were alone, to rounding.
#[test]
fn channels_do_not_mix() {
    let (_, f) = cube(4);
    let colour = Light::random(f.len(), 3, 0.9, 6);
    let together = colour.solve(&f, Solver::Direct, 1e-12).unwrap();
    for c in 0..3 {
        let alone = colour.channel(c).solve(&f, Solver::Direct, 1e-12).unwrap();
        let of_c: Vec<f64> = together.radiosity.iter().skip(c).step_by(3).copied().collect();
        assert!(farthest(&of_c, &alone.radiosity) <= 1e-14);
    }
    // Iterations stop for all channels at once, so the channels have to be alike here.
    let grey = colour.channel(0);
    let triple = |v: &[f64]| v.iter().flat_map(|&x| [x; 3]).collect();
    let thrice =
        Light { channels: 3, emission: triple(&grey.emission), reflectance: triple(&grey.reflectance) };
    for solver in ITERATIVE {
        let (one, three) = (grey.solve(&f, solver, 1e-6).unwrap(), thrice.solve(&f, solver, 1e-6).unwrap());
        for c in 0..3 {
            let of_c: Vec<f64> = three.radiosity.iter().skip(c).step_by(3).copied().collect();
            assert!(farthest(&of_c, &one.radiosity) <= 1e-14, "{solver:?}");
        }
        assert_eq!(one.iterations, three.iterations, "{solver:?}");
    }
}

/// Conjugate gradients need a symmetric matrix: they refuse one-way form factors, and the automatic choice avoids them.
#[test]
fn conjugate_gradients_want_reciprocity() {
    for estimator in BOTH {
        let options = CastOptions::default().with_estimator(estimator);
        let room = cast(load("furnace"), Subdivision::Edge(1.0), options);
        let solve = |solver| {
            let options = SolveOptions::default().with_solver(solver);
            solve(&room.form_factors, &room.patches, &options, &Progress::new())
        };
        let (cg, auto) = (solve(Solver::ConjugateGradient), solve(Solver::Auto).unwrap().solver);
        match estimator {
            Estimator::OneWay => {
                assert!(matches!(cg, Err(Error::Setting { .. })), "{cg:?}");
                assert_eq!(auto, Solver::GaussSeidel);
            }
            Estimator::Pooled => {
                assert_eq!(cg.unwrap().solver, Solver::ConjugateGradient);
                assert_eq!(auto, Solver::ConjugateGradient);
            }
        }
    }
}
