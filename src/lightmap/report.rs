//! The figures of a bake as JSON.

use std::io::{self, Write};

use serde::Serialize;

use super::{BakeOptions, Lightmap, Step, Texel, atlas::NONE};
use crate::{
    output::report::{EnergyReport, SceneReport, Seconds},
    scene::Scene,
};

/// A map gets a warning if less than this share of its texels holds surface.
const WELL_USED: f64 = 0.5;
/// A step gets a warning if it changes the flux by more than this share.
const NOTABLE: f64 = 1e-3;
/// Light on sides without texels gets a warning if it exceeds this share of the flux. A little is normal: patches that
/// reach under a wall catch some.
const NOTABLE_OTHER_SIDES: f64 = 1e-2;

/// The contents of `report.json` from `radiosity bake`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BakeReport {
    /// Version of the program.
    pub version: &'static str,
    /// The scene.
    pub scene: SceneReport,
    /// Energy balance of the solution.
    pub energy: EnergyReport,
    /// Layout of the map.
    pub atlas: AtlasReport,
    /// Numbers of texels by kind.
    pub texels: TexelsReport,
    /// Flux of the map and of the solution.
    pub flux: FluxReport,
    /// Steps after the map was computed, with their effect on the flux.
    pub steps: Vec<Step>,
    /// Differences across seams.
    pub seams: SeamsReport,
    /// Surface that the map does not show.
    pub left_out: LeftOutReport,
    /// Shown sides and hidden surface of each material, in the scene's order.
    pub materials: Vec<MapMaterialReport>,
    /// Root mean square over the surface of the finished texels' standard errors, relative to the mean irradiance, for
    /// the worst channel; `null` without a final gather. It does not include errors of the solution.
    pub rms_relative: Option<f64>,
    /// Files written, in the output directory.
    pub files: Vec<String>,
    /// Warnings, one sentence each.
    pub warnings: Vec<String>,
    /// Time of each stage.
    pub seconds: BakeSeconds,
    /// Peak memory of the process in bytes; `null` if the operating system does not report it.
    pub peak_bytes: Option<u64>,
    /// Options of the run.
    pub options: BakeOptionsReport,
}

/// Layout of the map.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AtlasReport {
    /// Texels in a row of a page.
    pub width: usize,
    /// Rows of a page.
    pub height: usize,
    /// Number of pages.
    pub pages: usize,
    /// Origin of the texture coordinates: `file` or `made`.
    pub coordinates: &'static str,
    /// The reason why the file's coordinates were not used; `null` if they were used.
    pub refused: Option<String>,
    /// Number of charts.
    pub charts: usize,
    /// Number of charts thinner than two texels.
    pub thin_charts: usize,
    /// Share of the mapped surface on thin charts.
    pub thin_share: f64,
    /// Number of texels that hold parts of more than one chart.
    pub shared_texels: usize,
    /// Share of all texels that hold surface.
    pub used_share: f64,
    /// Number of triangles that were cut because their charts would have been too large.
    pub cut_triangles: usize,
    /// Square root of the mean surface area per texel, in scene units.
    pub texel_length: f64,
    /// Root mean square of ln(density / mean density), where density is texels per surface area.
    pub density_spread: f64,
}

/// Numbers of texels by kind.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct TexelsReport {
    /// Surface that light can reach.
    pub valid: usize,
    /// Surface inside solids.
    pub hidden: usize,
    /// No surface, but a value from neighbours.
    pub dilated: usize,
    /// Neither surface nor a value.
    pub empty: usize,
}

/// Flux on the surface, W per channel.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FluxReport {
    /// From the solution.
    pub solver: [f64; 3],
    /// From the texels as computed.
    pub map: [f64; 3],
    /// (map - solver) / solver, for the worst channel.
    pub relative_difference: f64,
    /// Standard error of the map's flux from the final gather.
    pub standard_error: [f64; 3],
    /// From the texels as written.
    pub finished: [f64; 3],
}

/// Differences across seams, W/m².
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SeamsReport {
    /// Number of points on seams where both sides were compared.
    pub samples: usize,
    /// Root mean square before the seams were closed, per channel.
    pub before: [f64; 3],
    /// Root mean square after the seams were closed, per channel.
    pub after: [f64; 3],
}

/// Surface without texels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LeftOutReport {
    /// Area of lit sides that have no texels because the map shows the other side of their triangles.
    pub other_sides_area: f64,
    /// Flux on these sides, W per channel.
    pub other_sides_flux: [f64; 3],
    /// Number of triangles that the map shows from the back, because their back has more light.
    pub mapped_by_back: usize,
    /// Number of triangles that the map shows from both sides.
    pub mapped_twice: usize,
    /// Area of triangles without a place in the map, because they have no area there.
    pub unmapped_area: f64,
    /// Flux on these triangles, W per channel.
    pub unmapped_flux: [f64; 3],
}

/// A material's surface in the map.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MapMaterialReport {
    /// Name of the material.
    pub name: String,
    /// Area of its triangles.
    pub area: f64,
    /// Area of triangles that the map shows from the back only.
    pub by_back: f64,
    /// Area of triangles that the map shows from both sides.
    pub by_both: f64,
    /// Share of the material's area in the map that is inside a solid, where no light can reach it. Its texels have
    /// values from neighbours.
    pub hidden_share: f64,
}

impl MapMaterialReport {
    fn all(map: &Lightmap, scene: &Scene) -> Vec<MapMaterialReport> {
        let material = |m: &crate::scene::Material| MapMaterialReport {
            name: m.name.clone(),
            area: 0.0,
            by_back: 0.0,
            by_both: 0.0,
            hidden_share: 0.0,
        };
        let mut all: Vec<MapMaterialReport> = scene.materials.iter().map(material).collect();
        let mut shown = vec![0.0; all.len()];
        for t in 0..scene.triangles.len() {
            let (m, area) = (scene.triangles[t].material as usize, scene.area(t));
            all[m].area += area;
            match (map.is_of(t, true), map.is_of(t, false)) {
                (true, true) => all[m].by_both += area,
                (false, true) => all[m].by_back += area,
                _ => {}
            }
        }
        for i in 0..map.coverage().len() {
            for piece in map.coverage().pieces(i) {
                let t = map.atlas().triangle(piece.triangle as usize);
                shown[scene.triangles[t].material as usize] += piece.area;
            }
        }
        for ((material, hidden), shown) in all.iter_mut().zip(map.hidden_areas(scene)).zip(shown) {
            material.hidden_share = if shown > 0.0 { hidden / shown } else { 0.0 };
        }
        all
    }
}

/// Wall-clock time of each stage in seconds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct BakeSeconds {
    /// Stages of the solution.
    #[serde(flatten)]
    pub stages: Seconds,
    /// Laying out the charts.
    pub atlas: f64,
    /// Computing the texels.
    pub texels: f64,
}

/// Options of the run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct BakeOptionsReport {
    /// Options of the map.
    #[serde(flatten)]
    pub map: BakeOptions,
    /// Irradiance shown as white in `lightmap.png`, W/m².
    pub white: f64,
}

impl BakeReport {
    /// Collects the figures of a map. The caller adds files, times, peak memory and the warnings of the scene.
    pub fn new(
        map: &Lightmap,
        scene: &Scene,
        scene_report: SceneReport,
        energy: EnergyReport,
        options: &BakeOptions,
    ) -> BakeReport {
        let (samples, [before, after]) = map.seams();
        let flux = map.flux();
        let differences =
            (0..3).filter(|&c| flux.solver[c] > 0.0).map(|c| flux.map[c] / flux.solver[c] - 1.0);
        let worst = |x: f64, y: f64| if y.abs() > x.abs() { y } else { x };
        let mut report = BakeReport {
            version: env!("CARGO_PKG_VERSION"),
            scene: scene_report,
            energy,
            atlas: AtlasReport::new(map, scene),
            texels: TexelsReport::new(map),
            flux: FluxReport {
                solver: flux.solver,
                map: flux.map,
                relative_difference: differences.fold(0.0, worst),
                standard_error: flux.standard_error,
                finished: flux.finished,
            },
            steps: map.steps().to_vec(),
            seams: SeamsReport { samples, before, after },
            materials: MapMaterialReport::all(map, scene),
            left_out: LeftOutReport {
                other_sides_area: map.other_sides_area(),
                other_sides_flux: flux.other_sides,
                mapped_by_back: (0..scene.triangles.len()).filter(|&t| !map.is_of_front(t)).count(),
                mapped_twice: (0..scene.triangles.len())
                    .filter(|&t| map.is_of(t, true) && map.is_of(t, false))
                    .count(),
                unmapped_area: map.unmapped_area(),
                unmapped_flux: flux.unmapped,
            },
            rms_relative: (options.final_gather > 0).then(|| map.relative_error()),
            files: Vec::new(),
            warnings: Vec::new(),
            seconds: BakeSeconds::default(),
            peak_bytes: None,
            options: BakeOptionsReport { map: *options, white: map.exposure().white() },
        };
        report.warnings = report.objections();
        report
    }

    /// Warnings about the map.
    fn objections(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        let atlas = &self.atlas;
        if atlas.thin_charts > 0 {
            warnings.push(format!(
                "{} of {} charts, with {:.2} % of the surface, are thinner than two texels: choose more texels",
                atlas.thin_charts,
                atlas.charts,
                100.0 * atlas.thin_share
            ));
        }
        if atlas.used_share < WELL_USED {
            let why = match atlas.refused {
                None => {
                    "the texture coordinates of the file leave the rest empty, and new ones would use more"
                }
                Some(_) => "the rest are gaps between charts; more texels make the gaps smaller",
            };
            warnings.push(format!("{:.0} % of the texels hold surface: {why}", 100.0 * atlas.used_share));
        }
        if atlas.shared_texels > 0 {
            warnings.push(format!(
                "{} texels belong to two charts: light leaks between them",
                atlas.shared_texels
            ));
        }
        for step in self.steps.iter().filter(|step| step.relative.abs() > NOTABLE) {
            warnings.push(format!(
                "the step {} changed the flux by {:+.2} %",
                step.name,
                100.0 * step.relative
            ));
        }
        let left_out = &self.left_out;
        let other_sides = share(left_out.other_sides_flux, self.flux.solver);
        if other_sides > NOTABLE_OTHER_SIDES {
            warnings.push(format!(
                "some triangles are lit on both sides, but the map shows only their brighter side: an area of {:.4e} with \
                 {:.2} % of the flux has no texels; show both sides to give it some",
                left_out.other_sides_area,
                100.0 * other_sides
            ));
        }
        if left_out.unmapped_area > 0.0 {
            warnings.push(format!(
                "triangles without area in the map, of {:.4e} on the surface, have no texels",
                left_out.unmapped_area
            ));
        }
        warnings
    }

    /// Writes the report as indented JSON, followed by a line end.
    ///
    /// # Errors
    /// Errors of `out`.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        crate::output::write_json(self, out)
    }
}

/// The largest ratio part / whole over the channels.
fn share(part: [f64; 3], whole: [f64; 3]) -> f64 {
    (0..3).filter(|&c| whole[c] > 0.0).map(|c| part[c] / whole[c]).fold(0.0, f64::max)
}

impl AtlasReport {
    fn new(map: &Lightmap, scene: &Scene) -> AtlasReport {
        let atlas = map.atlas();
        let (thin_charts, thin_share) = atlas.thin_charts(scene);
        debug_assert!(atlas.chart.iter().all(|&c| c == NONE || (c as usize) < atlas.charts));
        AtlasReport {
            width: atlas.width,
            height: atlas.height,
            pages: atlas.pages,
            coordinates: if atlas.refused.is_none() { "file" } else { "made" },
            refused: atlas.refused.clone(),
            charts: atlas.charts,
            thin_charts,
            thin_share,
            shared_texels: atlas.covered_and_shared_texels()[1],
            used_share: map.coverage().len() as f64 / atlas.texels().max(1) as f64,
            cut_triangles: (0..scene.triangles.len()).filter(|&t| atlas.facets_of(t).len() > 1).count(),
            texel_length: atlas.texel_length(scene),
            density_spread: atlas.density_spread(scene),
        }
    }
}

impl TexelsReport {
    fn new(map: &Lightmap) -> TexelsReport {
        let mut count = TexelsReport::default();
        for texel in map.texels() {
            *match texel {
                Texel::Valid => &mut count.valid,
                Texel::Hidden => &mut count.hidden,
                Texel::Dilated => &mut count.dilated,
                Texel::Empty => &mut count.empty,
            } += 1;
        }
        count
    }
}
