//! Heat that grey, diffuse surfaces exchange by radiation. Their temperatures or fluxes are given, or their
//! temperatures float.
//!
//! The equations are those of light, and so is the solver. A surface at temperature T emits ε σ T⁴ and reflects 1 - ε.
//! A surface with a given net flux q has B = q + E, as if it emitted q and reflected everything. Radiosity is computed
//! per part, temperature per surface. A floating surface has the one temperature at which all its parts together gain
//! no heat. The system is linear in σ T⁴, so one solution per surface, for its emission alone, gives all others (M. F.
//! Modest, *Radiative Heat Transfer*, ch. 5).

mod conditions;

use nalgebra::{DMatrix, DVector};
use rand_pcg::rand_core::{Rng, SeedableRng};

use crate::{
    Error, Progress, Result,
    form_factor::{FormFactors, Matrix},
    solve::{Radiometry, SolveOptions, solve},
    view_factor::ViewFactors,
};

pub use conditions::{Condition, Conditions};

/// The Stefan-Boltzmann constant, W/(m² K⁴) (CODATA 2018).
pub const STEFAN_BOLTZMANN: f64 = 5.670374419e-8;

/// The tolerance of the solver: the sum of residuals over the sum of emissions. Heat balances to about the same.
const TOLERANCE: f64 = 1e-13;

/// Least amount of heat, as a share of the emitted power, to which the imbalance is related.
const LEAST: f64 = 1e-3;

/// The number of solutions with view factors that are changed at random by their standard errors. The standard error
/// from their spread is itself known to an eighth.
const REPLICATES: usize = 32;

/// The temperature and the net heat of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exchanged {
    /// The temperature in kelvin. On a surface with a given flux it follows from the mean of T⁴.
    pub temperature: f64,
    /// The standard error of the temperature in kelvin.
    pub temperature_error: f64,
    /// The net heat that leaves the surface, in W.
    pub heat: f64,
    /// The standard error of the heat in W, due to the standard errors of the view factors.
    pub heat_error: f64,
}

/// The heat exchanged by all surfaces and the sky.
#[derive(Debug, Clone, PartialEq)]
pub struct Exchange {
    /// One entry per surface.
    pub surfaces: Vec<Exchanged>,
    /// The net heat that the sky gives to the parts that see outside all surfaces, in W.
    pub sky: f64,
    /// The standard error of the sky's heat in W.
    pub sky_error: f64,
    /// The sum of all heat over the sum of its absolute values, or over 10⁻³ of the emitted power if that is more.
    pub imbalance: f64,
    /// A_i 𝓕_ij in m²: the heat that surface i absorbs per σ T⁴ of surface j, including all reflections, while floating
    /// surfaces float and fluxes stay. The last row and column belong to the sky. Rows of surfaces without a given
    /// temperature are zero.
    pub exchange_areas: DMatrix<f64>,
}

/// The parts, their surfaces, and the conditions of the surfaces.
struct System<'a> {
    form_factors: FormFactors,
    /// The areas of the parts, and the shares of light that reach no other part.
    areas: Vec<f64>,
    open: Vec<f64>,
    surface_of: &'a [usize],
    conditions: &'a [Condition],
}

/// The solution for a unit of σ T⁴ of one surface or of the sky, or for all given fluxes: the heat in W that leaves
/// each surface and the sky, and the irradiance of each part.
struct Response {
    heat: Vec<f64>,
    irradiance: Vec<f64>,
}

impl System<'_> {
    fn emissivity(&self, part: usize) -> f64 {
        self.conditions[self.surface_of[part]].emissivity()
    }

    fn has_flux(&self, part: usize) -> bool {
        matches!(self.conditions[self.surface_of[part]], Condition::Flux { .. })
    }

    /// The irradiance of all parts from their emission, which may be negative, and from a sky of this emissive power.
    fn irradiance(&self, emission: &[f64], sky: f64, progress: &Progress) -> Result<Vec<f64>> {
        let n = self.areas.len();
        let reflectance: Vec<f64> =
            (0..n).map(|i| if self.has_flux(i) { 1.0 } else { 1.0 - self.emissivity(i) }).collect();
        let source = |i: usize| emission[i] + reflectance[i] * self.open[i] * sky;
        let mut irradiance: Vec<f64> = self.open.iter().map(|open| open * sky).collect();
        // The solver is for light, which is never negative, so each sign is solved separately.
        for sign in [1.0, -1.0] {
            let emission: Vec<f64> = (0..n).map(|i| (sign * source(i)).max(0.0)).collect();
            if emission.iter().all(|&e| e == 0.0) {
                continue;
            }
            let radiometry = Radiometry { channels: 1, emission: &emission, reflectance: &reflectance };
            let options = SolveOptions { tolerance: TOLERANCE, ..SolveOptions::default() };
            let solution = solve(&self.form_factors, radiometry, &options, progress)?;
            irradiance.iter_mut().zip(&solution.irradiance).for_each(|(sum, e)| *sum += sign * e);
        }
        Ok(irradiance)
    }

    /// The response to a unit of σ T⁴ of surface `of`, or of the sky if `of` is the number of surfaces.
    fn response(&self, of: usize, progress: &Progress) -> Result<Response> {
        let (n, m) = (self.areas.len(), self.conditions.len());
        let sky = f64::from(u8::from(of == m));
        let emits = |i: usize| self.surface_of[i] == of && !self.has_flux(i);
        let emission: Vec<f64> = (0..n).map(|i| if emits(i) { self.emissivity(i) } else { 0.0 }).collect();
        let irradiance = self.irradiance(&emission, sky, progress)?;
        let mut heat = vec![0.0; m + 1];
        for i in 0..n {
            if !self.has_flux(i) {
                heat[self.surface_of[i]] +=
                    self.areas[i] * (emission[i] - self.emissivity(i) * irradiance[i]);
            }
        }
        self.add_sky(&mut heat, &emission, &irradiance, sky);
        Ok(Response { heat, irradiance })
    }

    /// The response to the given fluxes.
    fn fluxes(&self, progress: &Progress) -> Result<Response> {
        let (n, m) = (self.areas.len(), self.conditions.len());
        let flux = |i: usize| match self.conditions[self.surface_of[i]] {
            Condition::Flux { flux, .. } => flux,
            _ => 0.0,
        };
        let emission: Vec<f64> = (0..n).map(flux).collect();
        let irradiance = self.irradiance(&emission, 0.0, progress)?;
        let mut heat = vec![0.0; m + 1];
        for i in 0..n {
            heat[self.surface_of[i]] += self.areas[i]
                * if self.has_flux(i) { emission[i] } else { -self.emissivity(i) * irradiance[i] };
        }
        self.add_sky(&mut heat, &emission, &irradiance, 0.0);
        Ok(Response { heat, irradiance })
    }

    /// Adds the net heat that the sky gives.
    fn add_sky(&self, heat: &mut [f64], emission: &[f64], irradiance: &[f64], sky: f64) {
        let last = heat.len() - 1;
        for i in 0..self.areas.len() {
            let reflected = if self.has_flux(i) { 1.0 } else { 1.0 - self.emissivity(i) } * irradiance[i];
            heat[last] += self.areas[i] * self.open[i] * (sky - emission[i] - reflected);
        }
    }

    /// The emissive powers σ T⁴ of all surfaces and the sky, their heat, and the exchange areas.
    fn solve(&self, sky: f64, progress: &Progress) -> Result<(Vec<f64>, Vec<f64>, DMatrix<f64>)> {
        let m = self.conditions.len();
        let responses: Vec<Response> =
            (0..=m).map(|of| self.response(of, progress)).collect::<Result<_>>()?;
        let fluxes = self.fluxes(progress)?;
        let power = |temperature: f64| STEFAN_BOLTZMANN * temperature.powi(4);
        let mut powers: Vec<f64> = self
            .conditions
            .iter()
            .map(|condition| match condition {
                Condition::Temperature { temperature, .. } => power(*temperature),
                _ => 0.0,
            })
            .chain([power(sky)])
            .collect();
        let floating: Vec<usize> =
            (0..m).filter(|&k| matches!(self.conditions[k], Condition::Floating { .. })).collect();
        // The heat of all floating surfaces is zero: by their own powers and those of the others.
        let count = floating.len();
        let own = DMatrix::from_fn(count, count, |a, b| responses[floating[b]].heat[floating[a]]).lu();
        let float = |sent: &dyn Fn(usize) -> f64| -> Result<DVector<f64>> {
            let sent = DVector::from_iterator(count, floating.iter().map(|&k| -sent(k)));
            own.solve(&sent).ok_or(Error::NoEquilibrium)
        };
        if count > 0 {
            let sent =
                |k: usize| (0..=m).map(|l| powers[l] * responses[l].heat[k]).sum::<f64>() + fluxes.heat[k];
            let found = float(&sent)?;
            floating.iter().zip(found.iter()).for_each(|(&k, &p)| powers[k] = p);
        }
        let mut heat: Vec<f64> = (0..=m)
            .map(|k| (0..=m).map(|l| powers[l] * responses[l].heat[k]).sum::<f64>() + fluxes.heat[k])
            .collect();
        floating.iter().for_each(|&k| heat[k] = 0.0);
        let mut areas = DMatrix::zeros(m + 1, m + 1);
        let is_source = |k: usize| k == m || matches!(self.conditions[k], Condition::Temperature { .. });
        for l in (0..=m).filter(|&l| is_source(l)) {
            let moved = if count > 0 { float(&|k| responses[l].heat[k])? } else { DVector::zeros(0) };
            for k in (0..=m).filter(|&k| is_source(k)) {
                let by_floating: f64 =
                    floating.iter().zip(moved.iter()).map(|(&f, &p)| p * responses[f].heat[k]).sum();
                let out = responses[l].heat[k] + by_floating;
                areas[(k, l)] = if k == l { 0.0 } else { -out };
            }
        }
        // A surface with a flux has σ T⁴ = E + q / ε on average.
        for k in 0..m {
            let Condition::Flux { flux, emissivity } = self.conditions[k] else { continue };
            let parts = || (0..self.areas.len()).filter(|&i| self.surface_of[i] == k);
            let irradiance = |i: usize| {
                (0..=m).map(|l| powers[l] * responses[l].irradiance[i]).sum::<f64>() + fluxes.irradiance[i]
            };
            let sum: f64 = parts().map(|i| self.areas[i] * irradiance(i)).sum();
            let area: f64 = parts().map(|i| self.areas[i]).sum();
            powers[k] = sum / area + flux / emissivity;
        }
        Ok((powers, heat, areas))
    }
}

/// The heat exchanged by surfaces under the given `conditions`, one per surface. The parts of `found` belong to the
/// surfaces in `surface_of`, one index per part. Light that reaches no part meets a sky of this temperature, in kelvin.
/// Areas are in m².
///
/// # Errors
/// [`Error::NoEquilibrium`] if the temperature of some surface is not determined. [`Error::Stopped`] if `progress` is
/// stopped.
///
/// # Panics
/// If the sizes disagree.
pub fn exchange(
    found: &ViewFactors,
    surface_of: &[usize],
    conditions: &[Condition],
    sky: f64,
    seed: u64,
    progress: &Progress,
) -> Result<Exchange> {
    assert_eq!(surface_of.len(), found.len(), "sizes disagree");
    let m = conditions.len();
    let system = |noise: Option<u64>| {
        let form_factors = form_factors(found, noise);
        let open = form_factors.escaped().to_vec();
        System { areas: form_factors.areas().to_vec(), open, form_factors, surface_of, conditions }
    };
    let (powers, heat, exchange_areas) = system(None).solve(sky, progress)?;
    let (mut heats, mut temperatures) = (vec![0.0; m + 1], vec![0.0; m]);
    let kelvin = |power: f64| (power.max(0.0) / STEFAN_BOLTZMANN).powf(0.25);
    progress.begin("error bars", REPLICATES as u64);
    for replicate in 0..REPLICATES {
        progress.advance(1);
        progress.check()?;
        let (changed, others, _) = system(Some(seed ^ ((replicate as u64) << 32))).solve(sky, progress)?;
        heats.iter_mut().zip(others.iter().zip(&heat)).for_each(|(sum, (a, b))| *sum += (a - b).powi(2));
        for k in 0..m {
            temperatures[k] += (kelvin(changed[k]) - kelvin(powers[k])).powi(2);
        }
    }
    let error = |squares: f64| (squares / REPLICATES as f64).sqrt();
    // If almost no heat flows, its rounding does not matter.
    let gross: f64 = (0..found.len()).map(|i| found.areas()[i] * powers[surface_of[i]].abs()).sum();
    let amount = heat.iter().map(|q| q.abs()).sum::<f64>().max(LEAST * gross);
    Ok(Exchange {
        surfaces: (0..m)
            .map(|k| Exchanged {
                temperature: match conditions[k] {
                    Condition::Temperature { temperature, .. } => temperature,
                    _ => kelvin(powers[k]),
                },
                temperature_error: error(temperatures[k]),
                heat: heat[k],
                heat_error: error(heats[k]),
            })
            .collect(),
        sky: heat[m],
        sky_error: error(heats[m]),
        imbalance: if amount > 0.0 { heat.iter().sum::<f64>() / amount } else { 0.0 },
        exchange_areas,
    })
}

/// The view factors in the form that the solver needs; with noise, changed by their standard errors and closed again.
fn form_factors(found: &ViewFactors, noise: Option<u64>) -> FormFactors {
    let n = found.len();
    let unit = found.areas().iter().sum::<f64>() / n as f64;
    let mut random = noise.map(rand_pcg::Pcg64Mcg::seed_from_u64);
    let (mut starts, mut columns, mut values) = (vec![0], Vec::new(), Vec::new());
    let areas: Vec<f64> = found.areas().iter().map(|area| area / unit).collect();
    for i in 0..n {
        for (j, f, error) in found.entries(i).filter(|entry| entry.0 >= i) {
            let shift = random.as_mut().map_or(0.0, |random| error * normal(random));
            let exchange = areas[i] * (f + shift);
            if exchange > 0.0 {
                columns.push(j as u32);
                values.push(exchange as f32);
            }
        }
        starts.push(columns.len());
    }
    let matrix = Matrix::new((n, n), starts, columns, values);
    // A row that gains takes it from its escaped share, if it has one.
    let sums = {
        let mut sums = vec![0.0; n];
        for (&x, (i, j)) in &matrix {
            sums[i as usize] += f64::from(x);
            if i != j {
                sums[j as usize] += f64::from(x);
            }
        }
        sums
    };
    let escaped = (0..n)
        .map(|i| if found.escaped(i) > 0.0 { (1.0 - sums[i] / areas[i]).max(0.0) } else { 0.0 })
        .collect();
    let mut form_factors = FormFactors::from_exchange(matrix, areas, escaped);
    form_factors.scale_areas(unit);
    form_factors
}

/// A normal deviate (G. E. P. Box and M. E. Muller, 1958).
fn normal(random: &mut rand_pcg::Pcg64Mcg) -> f64 {
    let mut unit = || (random.next_u64() >> 11) as f64 * 2f64.powi(-53);
    let (u, v) = (1.0 - unit(), unit());
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}
