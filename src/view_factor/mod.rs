//! View factors between all pairs of a few hundred or thousand polygons, as heat transfer wants them: each accurate by
//! itself, where a lighting solution wants but their sums.
//!
//! What two polygons would exchange if nothing stood between them is known: by Gauss-Legendre products where they are apart,
//! by [closed forms](crate::form_factor::exact) where they are near. Only the visible share of it is sampled (a ratio estimator; Cochran,
//! *Sampling Techniques*, ch. 6): where all see each other nothing is left to chance. Polygons that are apart are sampled by
//! rays between points of both, weighted by the kernel. Between neighbours that has a singularity, and its square no integral:
//! there rays leave the smaller one as light does, and those count that would meet the other. Rays go to pairs in proportion to
//! their standard deviations, which is what lowers the sum of variances most (Neyman, 1934), in rounds that each learn from the
//! ones before.
//!
//! A surface may be of several polygons: their exchange areas A_i F_ij sum up, and so do the variances of these.

mod pair;
mod polygon;
mod rays;
mod rounds;
mod rows;

use glam::DVec3;

use self::{
    pair::pairs,
    polygon::in_unit_space,
    rounds::sample,
    rows::{allowances, check_enclosed, sums_of_rows, upper_triangles},
};
use crate::{
    Progress, Result,
    form_factor::{self, FormFactors, Matrix},
};

/// How accurate view factors are wanted.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ViewFactorOptions {
    /// RMS error over all pairs that independent samples would have. These are stratified, and had 0.35 to 0.65 of it in rooms of
    /// 500 and 2000 polygons. Not in it is what is unoccluded, which is known to about 10⁻³ of itself, or to a tenth of this
    /// error if that is less; single precision ends at about 10⁻⁷.
    pub error: f64,
    /// Whether the polygons enclose a room and show it their fronts: then rows sum to one exactly, else what is missing from
    /// them escapes, or is caught by backs.
    pub enclosed: bool,
    /// The same seed gives the same bytes, whatever the number of threads.
    pub seed: u64,
}

setters!(ViewFactorOptions {
    with_error(error: f64),
    with_enclosed(enclosed: bool),
    with_seed(seed: u64),
});

impl Default for ViewFactorOptions {
    /// 10⁻⁴, enclosed, seed 0.
    fn default() -> Self {
        ViewFactorOptions { error: 1e-4, enclosed: true, seed: 0 }
    }
}

/// View factors, and how they came about.
#[derive(Debug, Clone)]
pub struct ViewFactors {
    /// F_ij of the surfaces in the order given: reciprocal, and rows close.
    pub form_factors: FormFactors,
    /// Rays cast.
    pub rays: u64,
    /// RMS error over all pairs that as many independent samples would have: at most the one wanted, unless more than 2³² rays
    /// of a pair would be needed.
    pub error: f64,
    /// Sums of the rows as sampled, before they were closed.
    pub row_sums: Vec<f64>,
    /// Standard errors of exchange areas, in units of the mean area; the upper triangle.
    errors: Matrix,
    /// Areas in the same unit.
    areas: Vec<f64>,
}

impl ViewFactors {
    /// The standard error of F_ij that as many independent samples would have, before rows are closed.
    pub fn standard_error(&self, i: usize, j: usize) -> f64 {
        let (row, column) = (i.min(j), i.max(j));
        let (columns, errors) = form_factor::row(&self.errors, row);
        columns.binary_search(&(column as u32)).map_or(0.0, |k| f64::from(errors[k]) / self.areas[i])
    }

    /// The largest standard error, and of which F_ij it is.
    pub fn largest_standard_error(&self) -> Option<(usize, usize, f64)> {
        let of_pair = |(&e, (i, j)): (&f32, (u32, u32))| {
            let (i, j) = (i as usize, j as usize);
            let (i, j) = if self.areas[j] < self.areas[i] { (j, i) } else { (i, j) };
            (i, j, f64::from(e) / self.areas[i])
        };
        self.errors.iter().map(of_pair).reduce(|a, b| if b.2 > a.2 { b } else { a })
    }

    /// The surfaces whose view factors summed up to more than 1 before rows were closed, beyond what chance explains: there are
    /// others at the same place.
    pub fn overfull_rows(&self) -> Vec<usize> {
        let allowed = allowances(&self.errors, &self.areas);
        (0..self.row_sums.len()).filter(|&i| self.row_sums[i] > 1.0 + allowed[i]).collect()
    }
}

/// View factors between triangles and parallelograms, each by its corners, counter-clockwise where it is seen. They see each
/// other from that side, and block each other from both. Takes 32 bytes a pair that could see each other, and 16 for the result.
///
/// # Errors
/// [`Error::NotEnclosed`](crate::Error::NotEnclosed) when they were said to enclose a room and do not,
/// [`Error::Stopped`](crate::Error::Stopped) when `progress` says so.
///
/// # Panics
/// When a polygon is neither triangle nor parallelogram, or has no area, or no positive error is wanted.
pub fn view_factors(
    polygons: &[Vec<DVec3>],
    options: &ViewFactorOptions,
    progress: &Progress,
) -> Result<ViewFactors> {
    let surfaces: Vec<&[Vec<DVec3>]> = polygons.iter().map(std::slice::from_ref).collect();
    view_factors_of_surfaces(&surfaces, options, progress)
}

/// View factors between surfaces, each a list of polygons as [`view_factors`] takes them. A surface may see itself.
///
/// # Errors
/// Those of [`view_factors`].
///
/// # Panics
/// As [`view_factors`], or when a surface has no polygon.
pub fn view_factors_of_surfaces(
    surfaces: &[impl AsRef<[Vec<DVec3>]>],
    options: &ViewFactorOptions,
    progress: &Progress,
) -> Result<ViewFactors> {
    assert!(options.error > 0.0, "the error must be positive");
    let (polygons, scale) = in_unit_space(surfaces);
    let mut areas = vec![0.0; surfaces.len()];
    polygons.iter().for_each(|p| areas[p.surface as usize] += p.area);
    assert!(areas.iter().all(|&area| area > 0.0), "a surface has no polygon");
    let mean = areas.iter().sum::<f64>() / areas.len() as f64;
    let mut pairs = pairs(&polygons, areas.len() as f64 * options.error, progress)?;
    let (rays, error) = sample(&mut pairs, &polygons, &areas, options, progress)?;
    // In units of the mean area no exchange area leaves the range of single precision.
    areas.iter_mut().for_each(|area| *area /= mean);
    let [matrix, errors] = upper_triangles(&pairs, &polygons, areas.len(), mean);
    let mut row_sums = sums_of_rows(&matrix, areas.len(), |exchange| exchange);
    row_sums.iter_mut().zip(&areas).for_each(|(sum, area)| *sum /= area);
    if options.enclosed {
        check_enclosed(&row_sums, &errors, &areas)?;
    }
    let escapes = |sum: &f64| if options.enclosed { 0.0 } else { (1.0 - sum).max(0.0) };
    let escaped = row_sums.iter().map(escapes).collect();
    let mut form_factors = FormFactors::from_exchange(matrix, areas.clone(), escaped);
    form_factors.scale_areas(mean * scale * scale);
    Ok(ViewFactors { form_factors, rays, error, row_sums, errors, areas })
}
