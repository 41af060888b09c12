//! Lightmaps: the irradiance of a scene's surface as an image.
//!
//! [`Atlas`] is the layout: the place of each triangle in the map. [`Coverage`] lists the pieces of triangles that lie
//! in each texel. [`bake()`] computes the mean irradiance of the surface in every texel, either exactly from the patches
//! or more sharply by a final gather. Then it prepares the map for bilinear sampling: it removes noise, fills texels
//! without surface and closes seams. Each of these steps can be left out, and each reports how it changed the energy.
//!
//! The map shows the side of a triangle that has more light, or both sides if the atlas has a place for each.

mod atlas;
mod bake;
mod coverage;
mod cut;
mod denoise;
mod dilation;
mod fireflies;
mod gather;
pub mod gltf;
mod grid;
mod mesh;
mod overlap;
mod page;
mod raster;
pub mod report;
mod seams;
mod texels;
mod unwrap;
pub mod write;

use std::f64::consts::PI;

use glam::DVec2;
use serde::Serialize;

pub use self::{
    atlas::{Atlas, AtlasOptions, Coordinates, LARGEST, Layout, NONE, PAGE},
    bake::{bake, divide, lit_on_both_sides},
    coverage::{Coverage, Piece},
};
use self::{bake::Cells, gather::Gatherer, grid::Grid};
use crate::{
    output::final_gather::{FinalGather, outgoing},
    patch::{Patches, within_solids},
    scene::Scene,
    solve::Solution,
    tone::{luminance, rgb},
    trace::{Hit, Tracer},
};

/// Options of [`bake()`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct BakeOptions {
    /// Hemisphere rays per texel in the final gather, with as many shadow rays to lamps. 0 means no final gather:
    /// texels get the means of the patches.
    pub final_gather: u32,
    /// Whether to remove noise of the final gather, as far as its error bars allow.
    pub denoise: bool,
    /// Whether to fill texels without surface, for bilinear sampling.
    pub dilate: bool,
    /// Whether to make both sides of seams agree.
    pub close_seams: bool,
    /// Seed of all random numbers.
    pub seed: u64,
}

setters!(BakeOptions {
    with_final_gather(final_gather: u32),
    with_denoise(denoise: bool),
    with_dilate(dilate: bool),
    with_close_seams(close_seams: bool),
    with_seed(seed: u64),
});

impl Default for BakeOptions {
    /// 32 rays per texel, all steps, seed 0.
    fn default() -> Self {
        BakeOptions { final_gather: 32, denoise: true, dilate: true, close_seams: true, seed: 0 }
    }
}

/// What a texel holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Texel {
    /// No surface. The value is 0.
    Empty,
    /// Surface that light can reach, with its irradiance.
    Valid,
    /// Surface inside a solid, where no light can reach it. A value other than 0 comes from neighbours.
    Hidden,
    /// No surface. The value comes from neighbours.
    Dilated,
}

/// The effect of one step of [`bake()`] on the flux of the map.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Step {
    /// Name of the step: `hide`, `denoise`, `dilate` or `seams`.
    pub name: &'static str,
    /// Change of the flux on the surface, W, per channel.
    pub flux_change: [f64; 3],
    /// Change relative to the flux before the step, of the channel with the largest relative change.
    pub relative: f64,
}

/// Flux on the surface, Σ area · E, in W per channel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct Flux {
    /// Flux of the solution on the sides of triangles that the map shows.
    pub solver: [f64; 3],
    /// Flux of the texels before any step.
    pub map: [f64; 3],
    /// Standard error of `map` from the final gather. It does not include errors of the solution.
    pub standard_error: [f64; 3],
    /// Flux of the finished texels.
    pub finished: [f64; 3],
    /// Flux of the solution on triangles without a place in the map.
    pub unmapped: [f64; 3],
    /// Flux of the solution on the sides of triangles that the map does not show.
    pub other_sides: [f64; 3],
}

/// The irradiance of a scene's surface as an image.
#[derive(Debug, Clone)]
pub struct Lightmap {
    atlas: Atlas,
    coverage: Coverage,
    /// For each facet, whether the map shows the front of its triangle there.
    sides: Vec<bool>,
    irradiance: Vec<[f32; 3]>,
    texels: Vec<Texel>,
    /// Standard error of each covered texel, W/m². Empty without a final gather.
    standard_error: Vec<[f32; 3]>,
    /// For each covered texel, the share of its surface that is not inside a solid.
    open: Vec<f32>,
    flux: Flux,
    steps: Vec<Step>,
    seam_samples: usize,
    /// Root mean square of the differences across seams, before and after the seams were closed, W/m².
    seam_differences: [[f64; 3]; 2],
    other_sides_area: f64,
    unmapped_area: f64,
}

impl Lightmap {
    /// The layout of the map.
    pub fn atlas(&self) -> &Atlas {
        &self.atlas
    }

    /// The covered texels and the pieces of surface in each.
    pub fn coverage(&self) -> &Coverage {
        &self.coverage
    }

    /// Whether the map shows the front of a triangle.
    pub fn is_of_front(&self, triangle: usize) -> bool {
        self.is_of(triangle, true)
    }

    /// Whether the map shows a side of a triangle.
    pub fn is_of(&self, triangle: usize, front: bool) -> bool {
        self.facet(triangle, [1.0, 0.0, 0.0], front).is_some()
    }

    /// The facet that shows a point on a side of a triangle, and the barycentric coordinates of the point in that
    /// facet.
    fn facet(&self, triangle: usize, barycentric: [f64; 3], front: bool) -> Option<(usize, [f64; 3])> {
        let second =
            self.atlas.facet_at(triangle, barycentric, true).filter(|&(f, _)| self.sides[f] == front);
        second.or_else(|| {
            self.atlas.facet_at(triangle, barycentric, false).filter(|&(f, _)| self.sides[f] == front)
        })
    }

    /// Area of the surface inside solids, where no light arrives. One entry per material of the scene.
    pub fn hidden_areas(&self, scene: &Scene) -> Vec<f64> {
        let mut areas = vec![0.0; scene.materials.len()];
        let within = within_solids(scene);
        for t in (0..within.len()).filter(|&t| within[t] && !self.atlas.is_mapped(t)) {
            areas[scene.triangles[t].material as usize] += scene.area(t);
        }
        for i in 0..self.coverage.len() {
            for piece in self.coverage.pieces(i) {
                let t = self.atlas.triangle(piece.triangle as usize);
                areas[scene.triangles[t].material as usize] += piece.area * f64::from(1.0 - self.open[i]);
            }
        }
        areas
    }

    /// Irradiance of all texels, W/m²: page by page, rows from the bottom to the top.
    pub fn irradiance(&self) -> &[[f32; 3]] {
        &self.irradiance
    }

    /// The kind of every texel, in the order of [`Lightmap::irradiance`].
    pub fn texels(&self) -> &[Texel] {
        &self.texels
    }

    /// Standard error of every covered texel, W/m², in the order of [`Coverage::texels`]. Empty without a final gather.
    /// It includes the noise of the final gather and the bias that the denoiser estimates, but no errors of the
    /// solution and no changes from closing seams.
    pub fn standard_error(&self) -> &[[f32; 3]] {
        &self.standard_error
    }

    /// Flux of the map and of the solution.
    pub fn flux(&self) -> &Flux {
        &self.flux
    }

    /// The effect of each step after the computation.
    pub fn steps(&self) -> &[Step] {
        &self.steps
    }

    /// Number of sample points on seams, and the root mean square of the differences across seams in W/m², per channel:
    /// before and after the seams were closed.
    pub fn seams(&self) -> (usize, [[f64; 3]; 2]) {
        (self.seam_samples, self.seam_differences)
    }

    /// Area of lit sides without texels: the map shows the other side of their triangles.
    pub fn other_sides_area(&self) -> f64 {
        self.other_sides_area
    }

    /// Area of triangles without a place in the map.
    pub fn unmapped_area(&self) -> f64 {
        self.unmapped_area
    }

    /// Area of the surface in covered texel `i` that is not inside a solid.
    pub fn open_area(&self, i: usize) -> f64 {
        self.coverage.area(i) * f64::from(self.open[i])
    }

    /// Irradiance at a point of a triangle, W/m², from a bilinear sample of the map as a viewer takes it. If the map
    /// shows both sides, it is the irradiance of the front. `None` for triangles without a place in the map.
    pub fn at(&self, triangle: usize, barycentric: [f64; 3]) -> Option<[f64; 3]> {
        self.at_side(triangle, barycentric, self.is_of_front(triangle))
    }

    /// Irradiance at a point on one side of a triangle, W/m². `None` where the map does not show that side.
    pub fn at_side(&self, triangle: usize, barycentric: [f64; 3], front: bool) -> Option<[f64; 3]> {
        let (facet, barycentric) = self.facet(triangle, barycentric, front)?;
        let corners = self.atlas.texel_corners(facet)?;
        let p: DVec2 = (0..3).map(|k| corners[k] * barycentric[k]).sum();
        let mut sum = [0.0; 3];
        for (at, weight) in bilinear(&self.atlas, self.atlas.page[facet] as usize, p) {
            (0..3).for_each(|c| sum[c] += weight * f64::from(self.irradiance[at as usize][c]));
        }
        Some(sum)
    }

    /// Radiance that leaves a hit point towards the ray's origin, computed from the map alone. Sides that the map does
    /// not show reflect nothing.
    pub fn radiance(&self, scene: &Scene, hit: &Hit) -> [f64; 3] {
        let t = hit.triangle as usize;
        let irradiance = self.at_side(t, hit.barycentric.map(f64::from), hit.front);
        outgoing(scene, hit, irradiance.unwrap_or_default().into())
    }

    /// Root mean square of the standard errors over the surface, relative to its mean irradiance, for the worst
    /// channel. 0 without a final gather.
    pub fn relative_error(&self) -> f64 {
        let (mut area, mut squares, mut sums) = (0.0, [0.0; 3], [0.0; 3]);
        for i in 0..self.standard_error.len() {
            let a = self.open_area(i);
            area += a;
            for c in 0..3 {
                squares[c] += a * f64::from(self.standard_error[i][c]).powi(2);
                sums[c] += a * f64::from(self.irradiance[self.coverage.texels()[i] as usize][c]);
            }
        }
        (0..3)
            .filter(|&c| sums[c] > 0.0)
            .map(|c| (squares[c] / area).sqrt() / (sums[c] / area))
            .fold(0.0, f64::max)
    }

    /// Radiosity of every covered texel, W/m², from its irradiance and the mean reflectance and emission of its
    /// surface. All other texels are 0.
    fn radiosity(&self, scene: &Scene) -> Vec<[f32; 3]> {
        use rayon::prelude::*;
        let mut out = vec![[0.0; 3]; self.irradiance.len()];
        let values: Vec<[f32; 3]> = (0..self.coverage.len())
            .into_par_iter()
            .map(|i| {
                let e = self.irradiance[self.coverage.texels()[i] as usize];
                let (mut sum, mut total) = ([0.0; 3], 0.0);
                for piece in self.coverage.pieces(i) {
                    let facet = piece.triangle as usize;
                    let t = self.atlas.triangle(facet);
                    let part = self.coverage.barycentric_part(&self.atlas, i, facet);
                    let part = part.in_triangle(&self.atlas, facet);
                    let whole: f64 = part.fan().map(|(_, share)| share).sum();
                    for (corners, share) in part.fan().filter(|(_, share)| *share > 0.0) {
                        let weight = piece.area * share / whole;
                        let rho = scene.mean_reflectance(t, &corners);
                        let emitted =
                            if self.sides[facet] { scene.mean_emission(t, &corners) } else { [0.0; 3] };
                        (0..3).for_each(|c| sum[c] += weight * (PI * emitted[c] + rho[c] * f64::from(e[c])));
                        total += weight;
                    }
                }
                sum.map(|s| if total > 0.0 { (s / total) as f32 } else { 0.0 })
            })
            .collect();
        for (&at, value) in self.coverage.texels().iter().zip(values) {
            out[at as usize] = value;
        }
        out
    }

    /// Writes the values of covered texels into the map. Texels whose surface is all inside a solid become 0.
    fn show(&mut self, cells: &Cells) {
        for (i, &at) in self.coverage.texels().iter().enumerate() {
            let open = cells.open[i] > 0.0;
            self.irradiance[at as usize] = if open { cells.mean(i) } else { [0.0; 3] };
            self.texels[at as usize] = if open { Texel::Valid } else { Texel::Hidden };
        }
        if cells.sampled {
            self.standard_error = (0..cells.open.len()).map(|i| cells.standard_error(i)).collect();
        }
    }

    fn dilate(&mut self, grid: &Grid) {
        let mut owner = vec![NONE; self.texels.len()];
        let shown = self.shown_charts(grid);
        for (i, &at) in self.coverage.texels().iter().enumerate() {
            // A chart that is all inside a solid stays dark. Otherwise it would get the light of the charts beside it.
            if self.open[i] > 0.0 || !shown[grid.chart(i) as usize] {
                owner[at as usize] = grid.chart(i);
            }
        }
        dilation::dilate(grid, &mut owner, &mut self.irradiance);
        for (texel, owner) in self.texels.iter_mut().zip(owner) {
            if *texel == Texel::Empty && owner != NONE {
                *texel = Texel::Dilated;
            }
        }
    }

    fn gatherer<'a>(&'a self, tracer: &'a Tracer, source: &'a FinalGather) -> Gatherer<'a> {
        Gatherer { atlas: &self.atlas, coverage: &self.coverage, tracer, sides: &self.sides, source }
    }

    /// For each chart, whether any of its surface is not inside a solid.
    fn shown_charts(&self, grid: &Grid) -> Vec<bool> {
        let mut shown = vec![false; self.atlas.charts];
        for i in 0..self.coverage.len() {
            shown[grid.chart(i) as usize] |= self.open[i] > 0.0;
        }
        shown
    }

    /// Sets texels without open surface to 0.
    fn clear(&mut self) {
        for (texel, value) in self.texels.iter_mut().zip(&mut self.irradiance) {
            if *texel == Texel::Dilated {
                *texel = Texel::Empty;
            }
            if *texel != Texel::Valid {
                *value = [0.0; 3];
            }
        }
        self.steps.retain(|step| step.name != "dilate");
    }

    /// Runs a step and records how it changes the flux.
    fn step(&mut self, name: &'static str, work: impl FnOnce(&mut Lightmap)) {
        let before = self.surface_flux();
        work(self);
        let after = self.surface_flux();
        let flux_change: [f64; 3] = std::array::from_fn(|c| after[c] - before[c]);
        let relative = (0..3).filter(|&c| before[c] > 0.0).map(|c| flux_change[c] / before[c]);
        let relative = relative.fold(0.0, |worst: f64, x| if x.abs() > worst.abs() { x } else { worst });
        self.steps.push(Step { name, flux_change, relative });
    }

    /// Σ area · E over the texels that hold open surface.
    fn surface_flux(&self) -> [f64; 3] {
        let mut flux = [0.0; 3];
        for (i, &at) in self.coverage.texels().iter().enumerate() {
            let (area, e) = (self.open_area(i), self.irradiance[at as usize]);
            (0..3).for_each(|c| flux[c] += area * f64::from(e[c]));
        }
        flux
    }

    fn flux_error(&self) -> [f64; 3] {
        let mut squares = [0.0; 3];
        for (i, error) in self.standard_error.iter().enumerate() {
            let area = self.open_area(i);
            (0..3).for_each(|c| squares[c] += (area * f64::from(error[c])).powi(2));
        }
        squares.map(f64::sqrt)
    }

    /// Adds up the flux of the solution: on the sides that the map shows and on all others.
    fn add_up_solution(&mut self, patches: &Patches, solution: &Solution) {
        let channels = solution.channels;
        for i in 0..patches.len() {
            let t = patches.triangle(i);
            let e = rgb(&solution.irradiance[i * channels..][..channels]);
            let is_mapped = self.atlas.is_mapped(t);
            if !is_mapped && patches.is_shut_in(i) {
                continue;
            }
            let of_map = self.is_of(t, patches.is_front(i));
            let area = patches.area(i);
            let sum = if !of_map {
                self.other_sides_area += if luminance(e) > 0.0 { area } else { 0.0 };
                &mut self.flux.other_sides
            } else if !is_mapped {
                self.unmapped_area += area;
                &mut self.flux.unmapped
            } else {
                &mut self.flux.solver
            };
            (0..3).for_each(|c| sum[c] += area * e[c]);
        }
    }
}

/// The four texels that a bilinear sample at a point reads, with their weights. The point `p` is in texels of its page.
/// Values belong to the centres of texels. Beyond the outermost centres they are constant.
fn bilinear(atlas: &Atlas, page: usize, p: DVec2) -> [(u32, f64); 4] {
    let most = DVec2::new((atlas.width - 1) as f64, (atlas.height - 1) as f64);
    let q = (p - 0.5).clamp(DVec2::ZERO, most);
    let low = q.floor();
    let f = q - low;
    let high = (low + 1.0).min(most);
    let at = |x: f64, y: f64| ((page * atlas.height + y as usize) * atlas.width + x as usize) as u32;
    [
        (at(low.x, low.y), (1.0 - f.x) * (1.0 - f.y)),
        (at(high.x, low.y), f.x * (1.0 - f.y)),
        (at(low.x, high.y), (1.0 - f.x) * f.y),
        (at(high.x, high.y), f.x * f.y),
    ]
}
