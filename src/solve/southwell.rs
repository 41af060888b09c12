//! Southwell relaxation, known in graphics as progressive refinement (Cohen, Chen, Wallace and Greenberg, SIGGRAPH 88;
//! Gortler, Cohen and Slusallek, "Radiosity and relaxation methods", 1993). The patch with the most unshot power shoots
//! it to all patches that it sees. Every intermediate solution can be shown as a picture.

use std::{cmp::Ordering, collections::BinaryHeap};

use super::{Iterate, Radiometry, SolveOptions, System};
use crate::{
    Progress, Result,
    form_factor::{Estimator, FormFactors, Matrix, row},
};

/// A patch in the queue, by the unshot power it had when it was queued.
struct Queued {
    power: f64,
    patch: u32,
}

impl PartialEq for Queued {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}
impl Eq for Queued {}
impl PartialOrd for Queued {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Queued {
    fn cmp(&self, other: &Self) -> Ordering {
        self.power.total_cmp(&other.power).then_with(|| other.patch.cmp(&self.patch))
    }
}

/// A shooting solution in progress, with `C` channels. The unshot radiosity is exactly the residual Be + ρ F B - B.
pub struct Shooting<'a, const C: usize> {
    system: System<'a, C>,
    /// Column i of the matrix as a row. A symmetric matrix is its own transpose.
    transposed: Matrix,
    radiosity: Vec<[f64; C]>,
    unshot: Vec<[f64; C]>,
    queue: BinaryHeap<Queued>,
    /// The power of each patch in the queue; zero if it is not queued.
    queued: Vec<f64>,
    shots: usize,
}

impl<'a, const C: usize> Shooting<'a, C> {
    /// Starts with zero radiosity and all emission unshot.
    ///
    /// # Panics
    /// When `radiometry` does not have `C` channels.
    pub fn new(form_factors: &'a FormFactors, radiometry: impl Into<Radiometry<'a>>) -> Self {
        let radiometry = radiometry.into();
        assert_eq!(radiometry.channels, C, "channels disagree");
        let system = System::new(form_factors, radiometry);
        let rows = form_factors.rows();
        let transposed = match form_factors.estimator() {
            Estimator::OneWay => rows.transpose_view().to_csr(),
            Estimator::Pooled => rows.into_owned(),
        };
        let mut shooting = Shooting {
            transposed,
            radiosity: vec![[0.0; C]; form_factors.len()],
            unshot: system.source.to_vec(),
            queue: BinaryHeap::new(),
            queued: vec![0.0; form_factors.len()],
            shots: 0,
            system,
        };
        for i in 0..shooting.unshot.len() {
            shooting.enqueue(i);
        }
        shooting
    }

    fn power(&self, i: usize) -> f64 {
        self.system.form_factors.areas()[i] * self.unshot[i].iter().sum::<f64>()
    }

    /// Queues patch `i` again once its power has doubled. The queue stays short, and the patch that shoots has at least
    /// half of the greatest power.
    fn enqueue(&mut self, i: usize) {
        let power = self.power(i);
        if power > 2.0 * self.queued[i] {
            self.queued[i] = power;
            self.queue.push(Queued { power, patch: i as u32 });
        }
    }

    /// Lets the patch with the most unshot power shoot. Returns the patch, or `None` if nothing is unshot.
    pub fn shoot(&mut self) -> Option<usize> {
        // Queueing a patch again leaves its old entry in the queue, which is dropped here.
        let i = loop {
            let Queued { power, patch } = self.queue.pop()?;
            if self.queued[patch as usize] == power {
                break patch as usize;
            }
        };
        self.queued[i] = 0.0;
        let shot = std::mem::replace(&mut self.unshot[i], [0.0; C]);
        for c in 0..C {
            self.radiosity[i][c] += shot[c];
        }
        let (left, right) = self.system.form_factors.scaling();
        // Taken out for the loop, which changes other fields of self.
        let transposed = std::mem::replace(&mut self.transposed, Matrix::zero((0, 0)));
        let (columns, values) = row(&transposed, i);
        for (&j, &s) in columns.iter().zip(values) {
            let j = j as usize;
            let form_factor = left[j] * f64::from(s) * right[i];
            for c in 0..C {
                self.unshot[j][c] += self.system.reflectance[j][c] * form_factor * shot[c];
            }
            self.enqueue(j);
        }
        self.transposed = transposed;
        self.shots += 1;
        Some(i)
    }

    /// Number of shots so far.
    pub fn shots(&self) -> usize {
        self.shots
    }

    /// The relative residual: Σ A |unshot| relative to the power that is emitted and enters, in the worst channel.
    pub fn residual(&self) -> f64 {
        self.system.relative(self.unshot.iter().copied())
    }

    /// The radiosity so far, including the unshot radiosity.
    pub fn radiosity(&self) -> Vec<[f64; C]> {
        self.radiosity.iter().zip(&self.unshot).map(|(b, u)| std::array::from_fn(|c| b[c] + u[c])).collect()
    }
}

/// Shoots until the residual is small.
pub(super) fn solve<const C: usize>(
    system: &System<C>,
    options: &SolveOptions,
    progress: &Progress,
) -> Result<Iterate<C>> {
    let radiometry = Radiometry {
        channels: C,
        emission: system.source.as_flattened(),
        reflectance: system.reflectance.as_flattened(),
    };
    let n = system.form_factors.len();
    let mut shooting = Shooting::<C>::new(system.form_factors, radiometry);
    while shooting.shots() < options.max_iterations.saturating_mul(n) {
        // The residual costs a pass over all patches, so it is computed after every n shots.
        let round = shooting.shots();
        while shooting.shots() < round + n {
            if shooting.shoot().is_none() {
                return Ok((shooting.radiosity(), shooting.shots()));
            }
        }
        progress.check()?;
        if shooting.residual() <= options.tolerance {
            break;
        }
    }
    Ok((shooting.radiosity(), shooting.shots()))
}
