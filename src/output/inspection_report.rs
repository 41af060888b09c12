//! What is in a scene, as JSON, with what will go wrong in sentences.

use std::io::{self, Write};

use serde::Serialize;

use crate::{
    Quality,
    accuracy::survey::Survey,
    scene::{
        Scene,
        inspection::{Edges, Inspection, MaterialUse},
    },
};

/// What `radiosity inspect --report` writes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct InspectionReport {
    /// Version of the program.
    pub version: &'static str,
    /// The mesh.
    pub scene: MeshReport,
    /// How its triangles join.
    pub edges: EdgesReport,
    /// What rays from its fronts meet.
    pub seen: SeenReport,
    /// Its materials, in the order of their first use.
    pub materials: Vec<MaterialReport>,
    /// Its textures.
    pub textures: TexturesReport,
    /// What each quality would take.
    pub forecast: [ForecastReport; 4],
    /// What the reader left out or assumed.
    pub warnings: Vec<String>,
    /// What will go wrong or look odd, a sentence each.
    pub concerns: Vec<String>,
}

/// The mesh.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MeshReport {
    /// The file, as it was named.
    pub file: String,
    /// Triangles that have an area.
    pub triangles: usize,
    /// Triangles left out because they have none.
    pub degenerate: usize,
    /// Triangles with the corners of another.
    pub doubled: usize,
    /// Different positions.
    pub vertices: usize,
    /// Positions that are almost another's.
    pub near_vertices: usize,
    /// Area of all triangles, one side each.
    pub area: f64,
    /// Smallest coordinates.
    pub bounds_min: [f64; 3],
    /// Largest coordinates.
    pub bounds_max: [f64; 3],
    /// The unit of length that is likely; `null` where none is.
    pub unit_guess: Option<&'static str>,
    /// 1 when everything in the scene is grey, else 3.
    pub channels: usize,
}

/// Edges by the triangles that run through them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct EdgesReport {
    /// Their numbers.
    #[serde(flatten)]
    pub count: Edges,
    /// Neither open nor non-manifold ones.
    pub closed: bool,
}

/// What rays meet.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SeenReport {
    /// Rays from all fronts.
    pub rays: u64,
    /// Share of what they met that was a back.
    pub back_share: f64,
    /// Share that left the scene.
    pub escaped_share: f64,
    /// Of rays from lamps, the share that left the scene; `null` without lamps.
    pub lamp_escaped_share: Option<f64>,
}

/// A material.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MaterialReport {
    /// Where and how it is used.
    #[serde(flatten)]
    pub used: MaterialUse,
    /// Of what was seen from behind, the share made of it.
    pub share_of_backs: f64,
}

/// Textures.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TexturesReport {
    /// Width and height of those that were read.
    pub found: Vec<(usize, usize)>,
    /// Names of files, textures or material libraries, that could not be read.
    pub missing: Vec<String>,
}

/// What a solution would take.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ForecastReport {
    /// The preset.
    pub quality: &'static str,
    /// Patches of fronts and of those backs that are likely to be seen.
    pub patches: f64,
    /// Rays, all patches together.
    pub rays: f64,
    /// Bytes of the form factors and the rays' hits; at most.
    pub bytes: f64,
    /// An estimate, from the rate of this scene's own rays on this machine.
    pub seconds: f64,
}

impl InspectionReport {
    /// Collects the figures. `forecast` gives patches, rays, bytes and seconds of a preset.
    pub fn new(
        file: &str,
        scene: &Scene,
        inspection: &Inspection,
        survey: &Survey,
        forecast: impl Fn(Quality) -> (f64, f64, f64, f64),
    ) -> InspectionReport {
        let [low, high] = inspection.bounds.map(|p| p.to_array());
        let edges = inspection.edges;
        let backs = survey.all.backs.max(1) as f64;
        InspectionReport {
            version: env!("CARGO_PKG_VERSION"),
            scene: MeshReport {
                file: file.into(),
                triangles: inspection.triangles,
                degenerate: inspection.degenerate,
                doubled: inspection.doubled,
                vertices: inspection.vertices,
                near_vertices: inspection.near_vertices,
                area: inspection.area,
                bounds_min: low,
                bounds_max: high,
                unit_guess: inspection.unit_guess(),
                channels: scene.channels(),
            },
            edges: EdgesReport { count: edges, closed: edges.is_closed() },
            seen: SeenReport {
                rays: survey.all.rays,
                back_share: survey.all.back_share(),
                escaped_share: survey.all.escaped_share(),
                lamp_escaped_share: (survey.lamps.rays > 0).then(|| survey.lamps.escaped_share()),
            },
            materials: std::iter::zip(&inspection.materials, &survey.backs_of)
                .map(|(used, &met)| MaterialReport { used: used.clone(), share_of_backs: met as f64 / backs })
                .collect(),
            textures: TexturesReport {
                found: scene.textures.iter().map(|t| t.size()).collect(),
                missing: scene.missing.clone(),
            },
            forecast: Quality::PRESETS.map(|(quality, preset)| {
                let (patches, rays, bytes, seconds) = forecast(preset);
                ForecastReport { quality, patches, rays, bytes, seconds }
            }),
            warnings: scene.warnings.clone(),
            concerns: concerns(scene, inspection, survey),
        }
    }

    /// Writes it as indented JSON with a line end after it.
    ///
    /// # Errors
    /// What `out` says.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        super::write_json(self, out)
    }
}

/// Fresh snow and the whitest paints give back less than this.
const BRIGHTEST: f64 = 0.95;
/// Rays that graze an outline meet a back now and then even where all is well.
const FEW: f64 = 0.001;

/// What will go wrong or look odd.
fn concerns(scene: &Scene, inspection: &Inspection, survey: &Survey) -> Vec<String> {
    let mut concerns = Vec::new();
    let mut add = |applies: bool, sentence: &dyn Fn() -> String| {
        if applies {
            concerns.push(sentence());
        }
    };
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let (all, lamps, edges) = (&survey.all, &survey.lamps, &inspection.edges);
    add(!scene.has_emitter(), &|| {
        "nothing emits light: solving needs an emitter, for instance a material with `Ke`".into()
    });
    add(lamps.rays > 0 && lamps.escaped == lamps.rays, &|| {
        "all light of the lamps leaves the scene: lamps emit from their front only; are they turned round?"
            .into()
    });
    add(lamps.back_share() > 0.5 && lamps.escaped < lamps.rays, &|| {
        format!(
            "{} of what the lamps shine on are backs: are lamps or surfaces turned round?",
            percent(lamps.back_share())
        )
    });
    let closed = edges.is_closed() && all.escaped == 0;
    let absorbs = |m: &MaterialUse| m.reflectance.iter().any(|&r| r < 1.0);
    add(closed && !inspection.materials.iter().any(absorbs), &|| {
        "the scene is closed and nothing in it absorbs: there is no equilibrium".into()
    });
    let bright = inspection.materials.iter().filter(|m| m.reflectance.iter().any(|&r| r > BRIGHTEST));
    let bright: Vec<&str> = bright.map(|m| m.name.as_str()).collect();
    add(!bright.is_empty(), &|| {
        format!("reflectance above {BRIGHTEST}, whiter than any paint: {}", names(&bright))
    });
    add(all.back_share() > FEW, &|| {
        let most = (0..survey.backs_of.len()).max_by_key(|&m| (survey.backs_of[m], std::cmp::Reverse(m)));
        let name = most.map_or("", |m| scene.materials[m].name.as_str());
        format!(
            "{} of what is seen are backs, most often of `{name}`: they reflect but never emit, and cost patches",
            percent(all.back_share())
        )
    });
    add(edges.inconsistent > 0, &|| {
        format!("{} edges join a front to a back: the winding of the faces is mixed", edges.inconsistent)
    });
    for hidden in &scene.hidden {
        add(true, &|| hidden.to_string());
    }
    add(inspection.near_vertices > 0, &|| {
        format!(
            "{} vertices almost coincide with another: rays may slip through the cracks",
            inspection.near_vertices
        )
    });
    add(inspection.degenerate > 0, &|| {
        format!("{} triangles without area are left out", inspection.degenerate)
    });
    add(!scene.missing.is_empty(), &|| {
        let missing: Vec<&str> = scene.missing.iter().map(String::as_str).collect();
        format!("missing, or cannot be read: {}", names(&missing))
    });
    add(all.escaped_share() > 0.0 && all.escaped_share() < 0.01, &|| {
        let share = all.escaped_share();
        format!("{:.3} % of the rays leave what looks closed: there may be gaps", 100.0 * share)
    });
    concerns
}

/// The first few of a list.
fn names(all: &[&str]) -> String {
    const MOST: usize = 3;
    let first: Vec<String> = all.iter().take(MOST).map(|name| format!("`{name}`")).collect();
    let rest = all.len().saturating_sub(MOST);
    if rest == 0 { first.join(", ") } else { format!("{} and {rest} more", first.join(", ")) }
}
