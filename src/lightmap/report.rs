//! The figures of a bake as JSON.

use std::io::{self, Write};

use serde::Serialize;

use super::{BakeOptions, Lightmap, Step, Texel, atlas::NONE};
use crate::{
    output::report::{EnergyReport, SceneReport, Seconds},
    scene::Scene,
};

/// Maps of which less than this share holds surface are worth a warning.
const WELL_USED: f64 = 0.5;
/// A step that changes the flux by more than this share is worth a warning.
const NOTABLE: f64 = 1e-3;
/// The same of light on sides without texels. Some always gets in where patches reach under a wall.
const NOTABLE_OTHER_SIDES: f64 = 1e-2;

/// What `radiosity bake` writes to `report.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BakeReport {
    /// Version of the program.
    pub version: &'static str,
    /// What was computed on.
    pub scene: SceneReport,
    /// Where the light went, by the solver.
    pub energy: EnergyReport,
    /// Layout of the map.
    pub atlas: AtlasReport,
    /// What the texels hold.
    pub texels: TexelsReport,
    /// Energy of the map.
    pub flux: FluxReport,
    /// What was done to the map after it was computed.
    pub steps: Vec<Step>,
    /// Differences across seams.
    pub seams: SeamsReport,
    /// Surface that the map is not of.
    pub left_out: LeftOutReport,
    /// Which sides are shown, and what is hidden, by material, in the scene's order.
    pub materials: Vec<MapMaterialReport>,
    /// Root mean square over the surface of the texels' standard errors, relative to the mean irradiance, of the worst
    /// channel, as denoised; `null` without a final gather. What the solution is off by is not in it.
    pub rms_relative: Option<f64>,
    /// Files written, in the output directory.
    pub files: Vec<String>,
    /// Things to look at, a sentence each.
    pub warnings: Vec<String>,
    /// Time of each stage.
    pub seconds: BakeSeconds,
    /// Most memory held at any time; `null` where the operating system does not tell.
    pub peak_bytes: Option<u64>,
    /// What was asked for.
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
    /// `file` or `made`.
    pub coordinates: &'static str,
    /// Why the file's own were not used; `null` where they were.
    pub refused: Option<String>,
    /// Number of charts.
    pub charts: usize,
    /// Charts thinner than two texels.
    pub thin_charts: usize,
    /// Share of the mapped surface that they hold.
    pub thin_share: f64,
    /// Texels that two charts share.
    pub shared_texels: usize,
    /// Share of all texels that hold surface.
    pub used_share: f64,
    /// Triangles that were cut into smaller ones, because charts would have been too large.
    pub cut_triangles: usize,
    /// Root of the mean surface area a texel, in the scene's unit.
    pub texel_length: f64,
    /// Root mean square of ln(texels an area / its mean).
    pub density_spread: f64,
}

/// How many texels hold what.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct TexelsReport {
    /// Surface.
    pub valid: usize,
    /// Surface inside solids.
    pub hidden: usize,
    /// No surface, but a value from neighbours.
    pub dilated: usize,
    /// Nothing.
    pub empty: usize,
}

/// Flux on the surface, W.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FluxReport {
    /// By the solver.
    pub solver: [f64; 3],
    /// By the texels as computed.
    pub map: [f64; 3],
    /// (map - solver) / solver of the worst channel.
    pub relative_difference: f64,
    /// Standard error of the map's flux from the final gather.
    pub standard_error: [f64; 3],
    /// By the texels as written.
    pub finished: [f64; 3],
}

/// Differences across seams, W/m².
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SeamsReport {
    /// Points compared.
    pub samples: usize,
    /// Root mean square before they were closed.
    pub before: [f64; 3],
    /// And after.
    pub after: [f64; 3],
}

/// Surface without texels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LeftOutReport {
    /// Area of lit sides whose triangle is mapped by its other side, which is lit too.
    pub other_sides_area: f64,
    /// Flux on them, W.
    pub other_sides_flux: [f64; 3],
    /// Triangles shown by their backs, because those have more light.
    pub mapped_by_back: usize,
    /// Triangles shown by both sides.
    pub mapped_twice: usize,
    /// Area of triangles that are too thin to have a place in the map.
    pub unmapped_area: f64,
    /// Flux on them, W.
    pub unmapped_flux: [f64; 3],
}

/// A material's surface in the map.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MapMaterialReport {
    /// Its name.
    pub name: String,
    /// Area of its triangles.
    pub area: f64,
    /// The part that is shown by its back alone.
    pub by_back: f64,
    /// The part that is shown by both sides.
    pub by_both: f64,
    /// Share of the area in the map that no light can reach, because it is inside a solid. Its texels have values of
    /// neighbours.
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
    /// The stages of a solution.
    #[serde(flatten)]
    pub stages: Seconds,
    /// Laying out the charts.
    pub atlas: f64,
    /// Computing the texels.
    pub texels: f64,
}

/// What was asked for.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct BakeOptionsReport {
    /// How the map was made.
    #[serde(flatten)]
    pub map: BakeOptions,
    /// Irradiance shown as white in `lightmap.png`, W/m².
    pub white: f64,
}

impl BakeReport {
    /// Collects the figures of a map. Files, times, peak memory and the scene's warnings are for the caller to add.
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

    /// What a user should look at.
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
                "lit on both sides, shown by the brighter one: an area of {:.4e} with {:.2} % of the flux has no texels; \
                 show both sides to give it some",
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

    /// Writes it as indented JSON with a line end after it.
    ///
    /// # Errors
    /// What `out` says.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        crate::output::write_json(self, out)
    }
}

/// The largest share of a whole, over the channels.
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
            shared_texels: atlas.shared_texels(),
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
