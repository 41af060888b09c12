//! All steps from a solution to a finished map.

use super::{
    Atlas, BakeOptions, Coverage, Flux, Lightmap, Texel, denoise, fireflies,
    gather::{self, Gatherer, Noisy},
    grid::Grid,
    seams::Seams,
    texels,
};
use crate::{
    Progress, Result,
    output::final_gather::FinalGather,
    patch::Patches,
    scene::Scene,
    solve::Solution,
    trace::{Tracer, sampling::mix},
};

/// Both sides of a triangle get texels if the darker side has more than this share of the flux on the brighter side.
/// Patches that reach under a wall cause smaller shares.
const BOTH: f64 = 1e-2;
/// A texel that stands out from its neighbours is gathered again with this many times as many rays. The standard error
/// of the new value is a quarter of the first one, so it shows whether the texel stood out by chance.
const MORE_RAYS: u32 = 16;
/// Distinguishes the random numbers of the second gathering.
const AGAIN_SEED: u64 = 0x6167_6169_6e21;

/// For each triangle, whether both of its sides have enough light to deserve texels. This is the value for
/// [`AtlasOptions::two_sided`](super::AtlasOptions::two_sided).
pub fn lit_on_both_sides(patches: &Patches, solution: &Solution) -> Vec<bool> {
    texels::lit_on_both_sides(patches, solution, BOTH)
}

/// Computes a map from a solution.
///
/// # Errors
/// [`Error::Stopped`](crate::Error::Stopped).
///
/// # Panics
/// If the solution belongs to other patches, or the atlas to another scene.
pub fn bake(
    scene: &Scene,
    tracer: &Tracer,
    (patches, solution): (&Patches, &Solution),
    atlas: Atlas,
    options: &BakeOptions,
    progress: &Progress,
) -> Result<Lightmap> {
    assert_eq!(atlas.triangles(), scene.triangles.len(), "the atlas belongs to another scene");
    let lit = texels::lit_sides(patches, solution);
    let two_sided = |t: usize| atlas.facet_at(t, [1.0, 0.0, 0.0], true).is_some();
    let sides: Vec<bool> = (0..atlas.corners.len())
        .map(|facet| {
            let t = atlas.triangle(facet);
            if two_sided(t) { !atlas.is_second(facet) } else { lit[t] }
        })
        .collect();
    show_sides((scene, tracer), (patches, solution), atlas, sides, options, progress)
}

/// Divides a map among the lights that illuminate it. Each part is given as the scene in which only this light shines,
/// with its solution. The parts sum to the map, up to the rounding of single precision.
///
/// Every part is baked with the same rays as the map. Denoising and the closing of seams are not linear, and lamps are
/// chosen by their power. So the parts are shares: each texel of the map is divided in proportion to the values that
/// the parts have there.
///
/// # Errors
/// [`Error::Stopped`](crate::Error::Stopped).
///
/// # Panics
/// If a solution belongs to other patches, or the map to another scene.
pub fn divide(
    map: &Lightmap,
    tracer: &Tracer,
    lights: &[(Scene, Patches, Solution)],
    options: &BakeOptions,
    progress: &Progress,
) -> Result<Vec<Lightmap>> {
    let bake = |(scene, patches, solution): &(Scene, Patches, Solution)| {
        let (atlas, sides) = (map.atlas.clone(), map.sides.clone());
        show_sides((scene, tracer), (patches, solution), atlas, sides, options, progress)
    };
    let mut parts: Vec<Lightmap> = lights.iter().map(bake).collect::<Result<_>>()?;
    for (at, whole) in map.irradiance.iter().enumerate() {
        for c in 0..3 {
            let sum: f64 = parts.iter().map(|part| f64::from(part.irradiance[at][c])).sum();
            let count = parts.len() as f64;
            for part in &mut parts {
                let value = &mut part.irradiance[at][c];
                // If no part has light here, it comes from neighbours.
                let share = if sum > 0.0 { f64::from(*value) / sum } else { 1.0 / count };
                *value = (share * f64::from(whole[c])) as f32;
            }
        }
    }
    Ok(parts)
}

/// Computes a map of the given side of each facet.
fn show_sides(
    (scene, tracer): (&Scene, &Tracer),
    (patches, solution): (&Patches, &Solution),
    atlas: Atlas,
    sides: Vec<bool>,
    options: &BakeOptions,
    progress: &Progress,
) -> Result<Lightmap> {
    let coverage = Coverage::new(scene, &atlas);
    let source = FinalGather::new(scene, tracer, patches, solution, 1);
    let mut cells = if options.final_gather == 0 {
        Cells::exact(texels::means(&atlas, &coverage, patches, solution, &sides))
    } else {
        let gatherer =
            Gatherer { atlas: &atlas, coverage: &coverage, tracer, sides: &sides, source: &source };
        let all: Vec<u32> = (0..coverage.len() as u32).collect();
        Cells::gathered(gatherer.gather(&all, (options.final_gather, options.seed), progress)?)
    };
    let mut map = Lightmap {
        irradiance: vec![[0.0; 3]; atlas.texels()],
        texels: vec![Texel::Empty; atlas.texels()],
        standard_error: Vec::new(),
        open: cells.open.clone(),
        flux: Flux::default(),
        steps: Vec::new(),
        seam_samples: 0,
        seam_differences: [[0.0; 3]; 2],
        other_sides_area: 0.0,
        unmapped_area: 0.0,
        atlas,
        coverage,
        sides,
    };
    map.add_up_solution(patches, solution);
    let grid = Grid::new(&map.atlas, &map.coverage);
    map.show(&cells.pooled(&grid, &map.coverage));
    map.flux.map = map.surface_flux();
    map.flux.standard_error = map.flux_error();
    progress.check()?;
    if options.final_gather == 0 {
        // Patches do not show which surface is inside a solid, so a few gather rays find it.
        let hidden = map.gatherer(tracer, &source).hidden(options.seed);
        cells.open.iter_mut().zip(hidden).filter(|(_, hidden)| *hidden).for_each(|(open, _)| *open = 0.0);
        map.step("hide", |map| {
            map.open.clone_from(&cells.open);
            map.show(&cells);
        });
    }
    if options.denoise && options.final_gather > 0 {
        let gatherer = map.gatherer(tracer, &source);
        let effort = (MORE_RAYS.saturating_mul(options.final_gather), mix(&[options.seed, AGAIN_SEED]));
        let smooth =
            cells.denoised(&grid, &map.coverage, &|texels| gatherer.gather(texels, effort, progress))?;
        map.step("denoise", |map| map.show(&smooth));
    }
    // Seams are compared by bilinear samples, which read texels outside the charts.
    if options.dilate || options.close_seams {
        map.step("dilate", |map| map.dilate(&grid));
    }
    progress.check()?;
    if options.close_seams {
        let shown = map.shown_charts(&grid);
        let seams = Seams::new(map.atlas.scene(scene), &map.atlas, &map.sides, &shown);
        map.seam_samples = seams.points();
        map.seam_differences[0] = seams.difference(&map.irradiance);
        map.step("seams", |map| {
            let holds_surface = |at: usize| map.texels[at] == Texel::Valid;
            seams.close(&mut map.irradiance, holds_surface);
        });
        map.seam_differences[1] = seams.difference(&map.irradiance);
    }
    if !options.dilate {
        map.clear();
    }
    map.flux.finished = map.surface_flux();
    Ok(map)
}

/// Values of all covered texels, direct and reflected light separately.
#[derive(Clone)]
pub(super) struct Cells {
    direct: Vec<Noisy>,
    reflected: Vec<Noisy>,
    pub(super) open: Vec<f32>,
    /// Whether the values have error bars.
    pub(super) sampled: bool,
}

impl Cells {
    fn gathered(texels: Vec<gather::Texel>) -> Cells {
        Cells {
            direct: texels.iter().map(|t| t.direct).collect(),
            reflected: texels.iter().map(|t| t.reflected).collect(),
            open: texels.iter().map(|t| t.open).collect(),
            sampled: true,
        }
    }

    /// Cells with exact means, all of them open.
    fn exact(means: Vec<[f32; 3]>) -> Cells {
        let reflected: Vec<Noisy> =
            means.into_iter().map(|mean| Noisy { mean, ..Noisy::default() }).collect();
        let n = reflected.len();
        Cells { direct: vec![Noisy::default(); n], reflected, open: vec![1.0; n], sampled: false }
    }

    /// The same values, with variances averaged over neighbours.
    fn pooled(&self, grid: &Grid, coverage: &Coverage) -> Cells {
        if !self.sampled {
            return self.clone();
        }
        let counts = |i: usize| self.open[i] > 0.0;
        let [direct, reflected] =
            [&self.direct, &self.reflected].map(|signal| denoise::pooled(grid, coverage, signal, counts));
        Cells { direct, reflected, ..self.clone() }
    }

    /// Denoised values. `gather` gathers some texels again, with more rays.
    fn denoised(
        &self,
        grid: &Grid,
        coverage: &Coverage,
        gather: &dyn Fn(&[u32]) -> Result<Vec<gather::Texel>>,
    ) -> Result<Cells> {
        let counts = |i: usize| self.open[i] > 0.0;
        let [direct, mut reflected] =
            [&self.direct, &self.reflected].map(|signal| denoise::filter(grid, coverage, signal, counts));
        let total =
            |direct: &Noisy, reflected: &Noisy| std::array::from_fn(|c| direct.mean[c] + reflected.mean[c]);
        let counted = (0..self.open.len()).filter(|&i| counts(i));
        let texels: Vec<(usize, u32)> = counted.map(|i| (coverage.texels()[i] as usize, i as u32)).collect();
        let mut shown = vec![[0.0; 3]; grid.places()];
        for &(place, i) in &texels {
            shown[place] = total(&direct[i as usize], &reflected[i as usize]);
        }
        let again = |texels: &[u32]| {
            let found = gather(texels)?;
            Ok(found.iter().map(|texel| total(&texel.direct, &texel.reflected)).collect())
        };
        fireflies::spread(grid, &texels, &mut shown, &again)?;
        for (place, i) in texels {
            let direct = direct[i as usize].mean;
            reflected[i as usize].mean = std::array::from_fn(|c| shown[place][c] - direct[c]);
        }
        Ok(Cells { direct, reflected, ..self.clone() })
    }

    pub(super) fn mean(&self, i: usize) -> [f32; 3] {
        // Rounding may take a sum of zero below zero.
        std::array::from_fn(|c| (self.direct[i].mean[c] + self.reflected[i].mean[c]).max(0.0))
    }

    pub(super) fn standard_error(&self, i: usize) -> [f32; 3] {
        std::array::from_fn(|c| (self.direct[i].variance[c] + self.reflected[i].variance[c]).sqrt())
    }
}
