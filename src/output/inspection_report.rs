//! The contents of a scene as JSON, with its problems in sentences.

use std::io::{self, Write};

use serde::Serialize;

use crate::{
    Quality,
    accuracy::survey::Survey,
    scene::{
        Contacts, Scene,
        inspection::{Edges, Inspection, MaterialUse},
        light::UnitNames,
        surfaces::Surfaces,
    },
    view_factor::{Enclosure, Sight, leaks},
};

/// The report of `radiosity inspect`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct InspectionReport {
    /// Version of the program.
    pub version: &'static str,
    /// The mesh.
    pub scene: MeshReport,
    /// The edges of the mesh.
    pub edges: EdgesReport,
    /// Whether the faces enclose a room; `null` where there are too many to look.
    pub enclosed: Option<EnclosedReport>,
    /// Cuts at places where surfaces touch or cross.
    pub contacts: Contacts,
    /// The hits of rays from fronts.
    pub seen: SeenReport,
    /// The materials, in the order of their first use.
    pub materials: Vec<MaterialReport>,
    /// The textures.
    pub textures: TexturesReport,
    /// The cost of each quality.
    pub forecast: [ForecastReport; 4],
    /// Warnings of the reader: what it left out or assumed.
    pub warnings: Vec<String>,
    /// Problems of the scene, one sentence each.
    pub concerns: Vec<String>,
}

/// The mesh.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MeshReport {
    /// The file, as it was named.
    pub file: String,
    /// Number of triangles with an area.
    pub triangles: usize,
    /// Number of triangles that were left out because they have no area.
    pub degenerate: usize,
    /// Number of triangles with the same corners as another triangle.
    pub doubled: usize,
    /// Number of different positions.
    pub vertices: usize,
    /// Number of positions that are almost the same as another position.
    pub near_vertices: usize,
    /// Area of all triangles, one side each.
    pub area: f64,
    /// Smallest coordinates.
    pub bounds_min: [f64; 3],
    /// Largest coordinates.
    pub bounds_max: [f64; 3],
    /// The likely unit of length; `null` if no unit is likely.
    pub unit_guess: Option<&'static str>,
    /// Number of channels: 1 if everything in the scene is grey, otherwise 3.
    pub channels: usize,
    /// The units of light.
    pub units: UnitNames,
}

/// Numbers of edges by their number of triangles.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct EdgesReport {
    /// The numbers of edges.
    #[serde(flatten)]
    pub count: Edges,
    /// Whether no edge is open or non-manifold.
    pub closed: bool,
}

/// Whether faces enclose a room, by rays from every front.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EnclosedReport {
    /// The answer.
    pub enclosed: Enclosed,
    /// Number of rays.
    pub rays: u64,
    /// Number of rays that left the scene or met a back.
    pub lost: u64,
    /// The faces that lose rays, in order of falling share.
    pub open_at: Vec<OpenFace>,
}

/// Whether faces enclose a room.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Enclosed {
    /// Every ray meets a front.
    Yes,
    /// But for cracks between faces that adjoin up to rounding.
    Cracked,
    /// They do not.
    No,
}

/// A face that loses rays.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OpenFace {
    /// Its number in the file, from 0.
    pub face: String,
    /// Its line.
    pub line: Option<usize>,
    /// The share of its rays that leave the scene or meet backs.
    pub lost_share: f64,
}

impl EnclosedReport {
    /// By what rays from each surface met.
    pub fn new(surfaces: &Surfaces, seen: &[Sight]) -> EnclosedReport {
        let all = seen.iter().fold(Sight::default(), |all, sight| all.and(*sight));
        let open = |i: usize| OpenFace {
            face: surfaces.list[i].name.clone(),
            line: surfaces.list[i].line,
            lost_share: seen[i].lost_share(),
        };
        EnclosedReport {
            enclosed: match Enclosure::of(seen) {
                Enclosure::Closed => Enclosed::Yes,
                Enclosure::Cracked => Enclosed::Cracked,
                Enclosure::Open(_) => Enclosed::No,
            },
            rays: all.rays,
            lost: all.lost(),
            open_at: leaks(seen).into_iter().map(open).collect(),
        }
    }
}

/// The hits of rays.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SeenReport {
    /// Number of rays from all fronts.
    pub rays: u64,
    /// Share of the hits that are on backs.
    pub back_share: f64,
    /// Share of the rays that left the scene.
    pub escaped_share: f64,
    /// Share of the rays from lamps that left the scene; `null` without lamps.
    pub lamp_escaped_share: Option<f64>,
}

/// A material.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MaterialReport {
    /// The use of the material in the scene.
    #[serde(flatten)]
    pub used: MaterialUse,
    /// Its share of the hits on backs.
    pub share_of_backs: f64,
}

/// Textures.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TexturesReport {
    /// Width and height of each texture that was read.
    pub found: Vec<(usize, usize)>,
    /// Names of textures and material libraries that could not be read.
    pub missing: Vec<String>,
}

/// The cost of a solution.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ForecastReport {
    /// The preset.
    pub quality: &'static str,
    /// Number of patches on fronts, and on backs that rays are likely to hit.
    pub patches: f64,
    /// Number of rays of all patches.
    pub rays: f64,
    /// Largest number of bytes for form factors and hits.
    pub bytes: f64,
    /// Estimated time in seconds, from the rate of rays in this scene on this machine.
    pub seconds: f64,
}

impl InspectionReport {
    /// Collects the figures. `forecast` returns patches, rays, bytes and seconds of a preset.
    pub fn new(
        file: &str,
        scene: &Scene,
        inspection: &Inspection,
        enclosed: Option<EnclosedReport>,
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
                units: scene.units.names(),
            },
            edges: EdgesReport { count: edges, closed: edges.is_closed() },
            enclosed,
            contacts: scene.contacts,
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

    /// Writes the report as indented JSON, followed by a line end.
    ///
    /// # Errors
    /// Errors of writing to `out`.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        super::write_json(self, out)
    }
}

/// Largest plausible reflectance: fresh snow and the whitest paints reflect less.
const BRIGHTEST: f64 = 0.95;
/// Tolerated share of hits on backs. Rays that graze an outline sometimes hit a back, even if all faces have the right
/// orientation.
const FEW: f64 = 0.001;

/// The problems of the scene.
fn concerns(scene: &Scene, inspection: &Inspection, survey: &Survey) -> Vec<String> {
    let mut concerns = Vec::new();
    let mut add = |applies: bool, sentence: &dyn Fn() -> String| {
        if applies {
            concerns.push(sentence());
        }
    };
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let (all, lamps, edges) = (&survey.all, &survey.lamps, &inspection.edges);
    add(!scene.is_lit(), &|| {
        "nothing emits light: solving needs an emitter, for instance a material with `Ke`".into()
    });
    add(lamps.rays > 0 && lamps.escaped == lamps.rays, &|| {
        "all light of the lamps leaves the scene: lamps emit from their front only; are they turned round?"
            .into()
    });
    add(lamps.back_share() > 0.5 && lamps.escaped < lamps.rays, &|| {
        format!(
            "{} of the first hits of lamplight are on backs: are lamps or surfaces turned round?",
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
            "{} of the hits of rays are on backs, most often of `{name}`: backs reflect but never emit, and cost patches",
            percent(all.back_share())
        )
    });
    add(edges.inconsistent > 0, &|| {
        format!("{} edges join a front to a back: the winding of the faces is mixed", edges.inconsistent)
    });
    for hidden in &scene.hidden {
        add(true, &|| hidden.to_string());
    }
    add(survey.shut_in_area > 0.0, &|| {
        format!(
            "faces between touching solids, with an area of {:.4e}, are shut in: their light cannot be seen, and they cost patches",
            survey.shut_in_area
        )
    });
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
        format!("{:.3} % of the rays leave a scene that looks closed: there may be gaps", 100.0 * share)
    });
    concerns
}

/// The first few names of a list, and the number of the others.
fn names(all: &[&str]) -> String {
    const MOST: usize = 3;
    let first: Vec<String> = all.iter().take(MOST).map(|name| format!("`{name}`")).collect();
    let rest = all.len().saturating_sub(MOST);
    if rest == 0 { first.join(", ") } else { format!("{} and {rest} more", first.join(", ")) }
}
