//! In equilibrium all emitted light is absorbed or escapes. The energy ledger of every solver shows this, for both
//! estimators of the form factors. A wrong matrix balances too: the ledger alone does not prove that a solution is
//! right.
//!
//!     cargo run --release --example energy_equilibrium -- [SCENE.obj]

use std::path::PathBuf;

use radiosity::{
    Progress, Result, Scene,
    energy::EnergyLedger,
    form_factor::{CastOptions, Estimator, FormFactors, Matrix},
    monte_carlo::{LightOptions, LightTracer},
    patch::{Patches, Subdivision},
    solve::{Solution, SolveOptions, Solver, solve},
    trace::{Hit, Tracer},
};

const SOLVERS: [Solver; 5] =
    [Solver::Jacobi, Solver::GaussSeidel, Solver::Southwell, Solver::ConjugateGradient, Solver::Direct];

fn main() -> Result<()> {
    let default = || concat!(env!("CARGO_MANIFEST_DIR"), "/meshes/cornell-box.obj").into();
    let scene = Scene::load(std::env::args_os().nth(1).map_or_else(default, PathBuf::from))?;
    let tracer = Tracer::new(&scene);
    let progress = Progress::new();

    println!("matrix    solver            emitted   absorbed    escaped  imbalance     solver  reciprocity");
    for (name, estimator) in [("one-way", Estimator::OneWay), ("pooled", Estimator::Pooled)] {
        // Casting adds the backs of surfaces that light reaches, so each estimator starts from the fronts.
        let mut patches = Patches::subdivide(&scene, &Subdivision::Count(600));
        let options = CastOptions::default().with_rays(256.0).with_estimator(estimator);
        let form_factors = FormFactors::cast(&scene, &tracer, &mut patches, &options, &progress)?;
        for solver in SOLVERS {
            let options = SolveOptions::default().with_solver(solver);
            match solve(&form_factors, &patches, &options, &progress) {
                Ok(solution) => ledger(name, &form_factors, &patches, &solution),
                Err(error) => println!("{name:8}  {:12}  {error}", solver.name()),
            }
        }

        // Every patch sees every other, even through walls: symmetric, closed and wrong.
        let (areas, escaped) = (form_factors.areas().to_vec(), form_factors.escaped().to_vec());
        let sphere = FormFactors::from_exchange(exchange_of_a_sphere(&areas), areas, escaped);
        let right = solve(&form_factors, &patches, &SolveOptions::default(), &progress)?;
        let wrong = solve(&sphere, &patches, &SolveOptions::default(), &progress)?;
        ledger("sphere", &sphere, &patches, &wrong);

        // Light tracing uses no form factors and finds the error.
        let particles = LightOptions::default().with_particles(1 << 22);
        let bin = |hit: &Hit| patches.at(hit.triangle, hit.barycentric, hit.front).map(|i| i as usize);
        let truth = LightTracer::new(&scene, &tracer, particles).trace(patches.len(), bin, &progress)?;
        let error = |solution: &Solution| {
            let (mut squares, mut flux, mut area) = (0.0, 0.0, 0.0);
            for (i, bin) in truth.bins.iter().enumerate() {
                let (a, red) = (patches.area(i), bin.mean[0]);
                squares += (a * solution.irradiance[i * solution.channels] - red).powi(2) / a;
                (flux, area) = (flux + red, area + a);
            }
            100.0 * (squares * area).sqrt() / flux
        };
        println!("RMS difference of red irradiance from light tracing, of its mean:");
        println!("  {name} {:.1} %, sphere {:.1} %\n", error(&right), error(&wrong));
    }
    Ok(())
}

/// Prints the ledger of the first channel. The imbalance and its two parts are relative to the emitted power.
fn ledger(matrix: &str, form_factors: &FormFactors, patches: &Patches, solution: &Solution) {
    let ledger = EnergyLedger::of(form_factors, patches, solution);
    println!(
        "{matrix:8}  {:12} {:12.5e} {:10.4e} {:10.4e} {:10.1e} {:10.1e}   {:10.1e}",
        solution.solver.name(),
        ledger.emitted[0],
        ledger.absorbed[0],
        ledger.escaped[0],
        ledger.imbalance(),
        ledger.relative_solver_part(),
        ledger.relative_reciprocity_part(),
    );
}

/// A_i F_ij = A_i A_j / ΣA, which holds inside a sphere.
fn exchange_of_a_sphere(areas: &[f64]) -> Matrix {
    let (n, total) = (areas.len(), areas.iter().sum::<f64>());
    let values = areas.iter().flat_map(|a| areas.iter().map(move |b| (a * b / total) as f32)).collect();
    let columns = (0..n).flat_map(|_| 0..n as u32).collect();
    Matrix::new((n, n), (0..=n).map(|row| row * n).collect(), columns, values)
}
