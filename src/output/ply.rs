//! Coloured meshes as binary PLY, which MeshLab, Blender, CloudCompare, three.js and Python's `plyfile` read.
//!
//! - `vertex`: `x y z` float in scene units; `red green blue` uchar, exposed and sRGB-encoded; `radiosity_r radiosity_g
//!   radiosity_b` float, linear, W/m².
//! - `face`, one per patch: `vertex_indices`; `triangle` int, the triangle of the file; `side` uchar, 0 for the front
//!   and 1 for the back; `area` double; `irradiance_*`, `radiosity_*` and `error_*` float. `error_*` is the standard
//!   error of the irradiance, or NaN if it is unknown.
//! - Further float values of a face, if they were computed: `discretisation_*`, the estimated error of the irradiance from
//!   the size of patches; `lambert_*`, irradiance with the given materials minus irradiance with Lambertian ones, and
//!   `lambert_error_*`, its standard error. The last two are NaN on backs.
//!
//! A face shows the side of its patch that has more light, and faces never lie on each other. So viewers that draw both
//! sides of a face show no noise. With [`PlyOptions::backs`] both sides of a patch are faces.
//!
//! Where patches of several sizes meet, a large patch has vertices of its neighbours on its edges. It is then cut into
//! several triangles, so that no viewer shows gaps along its edges. The first triangles of all patches come first, in
//! the order of patches, and the other triangles follow. Then faces have the value `patch` int, the index of their
//! patch. Light and errors are those of the whole patch, areas are those of the face.

use std::{
    io::{self, Write},
    path::Path,
};

use ply_rs::{
    ply::{Addable, ElementDef, Encoding, Header, PropertyAccess, PropertyDef, PropertyType, ScalarType},
    writer::Writer,
};

use super::{
    exposure,
    file::OutputFile,
    lit_sides::lit_sides,
    vertex_colors,
    vertices::{CREASE, PatchMesh},
};
use crate::{
    Result,
    monte_carlo::Estimate,
    patch::Patches,
    scene::{
        Scene,
        light::{UnitNames, Units},
        ply::BOTH_SIDES,
    },
    solve::Light,
    tone::{Exposure, rgb},
};

/// Options of [`write()`] and [`encode`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct PlyOptions<'a> {
    /// Standard error of each patch's irradiance, with interleaved channels. `None` is written as NaN.
    pub standard_errors: Option<&'a [f64]>,
    /// Estimated error of each patch's irradiance from the size of patches, with interleaved channels. `None` is not
    /// written.
    pub discretisation: Option<&'a [f64]>,
    /// For each front patch, irradiance with the given materials minus irradiance with Lambertian ones. `None` is not
    /// written.
    pub lambert: Option<&'a [Estimate]>,
    /// Crease angle in degrees. Surfaces that bend by this angle or more at an edge are not shaded smoothly across it.
    pub crease: f64,
    /// Whether to write both sides of a patch if rays hit both, instead of the side with more light.
    pub backs: bool,
    /// Exposure of the vertex colours; `None` for [`exposure::of_radiosity`].
    pub exposure: Option<Exposure>,
}

setters!(PlyOptions<'a> {
    with_standard_errors(standard_errors: Option<&'a [f64]>),
    with_discretisation(discretisation: Option<&'a [f64]>),
    with_lambert(lambert: Option<&'a [Estimate]>),
    with_crease(crease: f64),
    with_backs(backs: bool),
    with_exposure(exposure: Option<Exposure>),
});

impl Default for PlyOptions<'_> {
    /// No errors, a crease angle of [`CREASE`] degrees, one side of each patch, automatic exposure.
    fn default() -> Self {
        PlyOptions {
            standard_errors: None,
            discretisation: None,
            lambert: None,
            crease: CREASE,
            backs: false,
            exposure: None,
        }
    }
}

/// Writes the solution to a file, completely or not at all.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io).
///
/// # Panics
/// If the sizes disagree.
pub fn write<'a>(
    path: &Path,
    scene: &Scene,
    patches: &Patches,
    light: impl Into<Light<'a>>,
    options: &PlyOptions<'_>,
) -> Result<()> {
    let light = light.into();
    OutputFile::new(path, &[])?.write(|out| encode_light(out, scene, patches, light, options))?.commit()
}

/// Writes the solution to `out`, which should be buffered.
///
/// # Errors
/// Errors of writing to `out`; [`io::ErrorKind::InvalidData`] if a value exceeds the range of single precision.
///
/// # Panics
/// If the sizes disagree.
pub fn encode<'a>(
    out: &mut dyn Write,
    scene: &Scene,
    patches: &Patches,
    light: impl Into<Light<'a>>,
    options: &PlyOptions<'_>,
) -> io::Result<()> {
    encode_light(out, scene, patches, light.into(), options)
}

fn encode_light(
    mut out: &mut dyn Write,
    scene: &Scene,
    patches: &Patches,
    light: Light<'_>,
    options: &PlyOptions<'_>,
) -> io::Result<()> {
    let values = patches.channels() * patches.len();
    assert_eq!((light.radiosity.len(), light.irradiance.len()), (values, values), "sizes disagree");
    let errors = [options.standard_errors, options.discretisation];
    assert!(errors.iter().flatten().all(|e| e.len() == values), "sizes disagree");

    let mesh = PatchMesh::new(scene, patches, options.crease);
    let exposure = options.exposure.unwrap_or_else(|| exposure::of_radiosity(patches, light.radiosity));
    let radiosity = vertex_colors::radiosity(scene, patches, &mesh, light);
    let shown = match options.backs {
        true => Shown::all(&mesh),
        false => Shown::of(&mesh, &lit_sides(scene, patches, light)),
    };
    let header = header(exposure, &shown, options, mesh.has_pieces(), scene.units);

    Writer::<Vertex>::new().write_header(&mut out, &header)?;
    let channels = patches.channels();
    write_elements(&mut out, &header, "vertex", shown.vertices.len(), |v| {
        let v = shown.vertices[v] as usize;
        let radiosity = rgb(&radiosity[v * channels..][..channels]);
        Vertex {
            position: single(mesh.positions()[v].to_array()),
            colour: exposure.encode(radiosity),
            radiosity: single(positive(radiosity)),
        }
    })?;
    write_elements(&mut out, &header, "face", shown.faces.len(), |f| {
        let face = shown.faces[f] as usize;
        let (i, share) = mesh.patch(face);
        let of = |values: &[f64]| rgb(&values[i * channels..][..channels]);
        Face {
            vertices: mesh.face(face).map(|v| shown.numbers[v as usize] as i32),
            patch: i as i32,
            triangle: scene.triangles[patches.triangle(i)].source as i32,
            back: u8::from(!patches.is_front(i)),
            area: share * patches.area(i),
            irradiance: single(positive(of(light.irradiance))),
            radiosity: single(positive(of(light.radiosity))),
            error: options.standard_errors.map_or([f32::NAN; 3], |e| single(of(e))),
            discretisation: options.discretisation.map_or([0.0; 3], |e| single(of(e))),
            lambert: options
                .lambert
                .and_then(|all| all.get(i))
                .map_or([[f32::NAN; 3]; 2], |change| [change.mean, change.standard_error].map(single)),
        }
    })
}

/// The faces and vertices of a mesh that are written to the file.
struct Shown {
    faces: Vec<u32>,
    vertices: Vec<u32>,
    /// For each vertex of the mesh, its index among the written ones. Undefined for vertices that are not written.
    numbers: Vec<u32>,
}

impl Shown {
    fn all(mesh: &PatchMesh) -> Shown {
        let vertices: Vec<u32> = (0..mesh.positions().len() as u32).collect();
        Shown { faces: (0..mesh.faces() as u32).collect(), numbers: vertices.clone(), vertices }
    }

    /// The faces of some unknowns, and their vertices.
    fn of(mesh: &PatchMesh, unknowns: &[bool]) -> Shown {
        let is_shown = |&f: &u32| unknowns[mesh.patch(f as usize).0];
        let faces: Vec<u32> = (0..mesh.faces() as u32).filter(is_shown).collect();
        let mut numbers = vec![0; mesh.positions().len()];
        faces.iter().flat_map(|&f| mesh.face(f as usize)).for_each(|v| numbers[v as usize] = 1);
        let vertices: Vec<u32> = (0..numbers.len() as u32).filter(|&v| numbers[v as usize] == 1).collect();
        (0..).zip(&vertices).for_each(|(number, &v)| numbers[v as usize] = number);
        Shown { faces, vertices, numbers }
    }
}

/// Replaces negative values by zero. Iterative solvers leave a dark patch a little below zero, within their error
/// bound. The exact solution has no negative value, so zero is closer to it.
fn positive(rgb: [f64; 3]) -> [f64; 3] {
    // `max` would turn NaN into 0.
    rgb.map(|x| if x < 0.0 { 0.0 } else { x })
}

fn single(values: [f64; 3]) -> [f32; 3] {
    values.map(|x| x as f32)
}

/// Writes `count` elements, with one block of them in memory at a time.
fn write_elements<E: PropertyAccess + Checked>(
    mut out: &mut dyn Write,
    header: &Header,
    name: &str,
    count: usize,
    element: impl Fn(usize) -> E + Sync,
) -> io::Result<()> {
    use rayon::prelude::*;
    const BLOCK: usize = 1 << 16;
    for start in (0..count).step_by(BLOCK) {
        let block: Vec<E> = (start..(start + BLOCK).min(count)).into_par_iter().map(&element).collect();
        if let Some(bad) = block.iter().position(|e| !e.fits()) {
            return Err(io::Error::new(
                io::ErrorKind::InvalidData,
                format!("{name} {}: a value is beyond the range of single precision", start + bad),
            ));
        }
        Writer::new().write_payload_of_element(&mut out, &block, &header.elements[name], header)?;
    }
    Ok(())
}

const RGB: [&str; 3] = ["r", "g", "b"];

fn header(exposure: Exposure, shown: &Shown, options: &PlyOptions<'_>, patch: bool, units: Units) -> Header {
    let UnitNames { irradiance, radiosity, .. } = units.names();
    let of_light = match irradiance == radiosity {
        true => format!("radiosity, irradiance and its errors in {radiosity}"),
        false => format!("radiosity in {radiosity}, irradiance and its errors in {irradiance}"),
    };
    let mut header = Header::new();
    header.encoding = Encoding::BinaryLittleEndian;
    header.comments = vec![
        format!("radiosity {}", env!("CARGO_PKG_VERSION")),
        format!("units: lengths as in the scene; {of_light}, linear Rec. 709"),
        format!("exposure: colours are sRGB, white is a radiosity of {:.6e} {radiosity}", exposure.white()),
    ];
    if options.backs {
        header.comments.push(BOTH_SIDES.into());
    }
    let named = |quantity: &'static str| RGB.map(|c| (format!("{quantity}_{c}"), ScalarType::Float));
    let mut vertex = element("vertex", shown.vertices.len());
    for name in ["x", "y", "z"] {
        vertex.properties.add(scalar(name, ScalarType::Float));
    }
    for name in ["red", "green", "blue"] {
        vertex.properties.add(scalar(name, ScalarType::UChar));
    }
    for (name, kind) in named("radiosity") {
        vertex.properties.add(scalar(&name, kind));
    }
    header.elements.add(vertex);

    let mut face = element("face", shown.faces.len());
    let indices = PropertyType::List(ScalarType::UChar, ScalarType::Int);
    face.properties.add(PropertyDef::new("vertex_indices".into(), indices));
    face.properties.add(scalar("triangle", ScalarType::Int));
    if patch {
        face.properties.add(scalar("patch", ScalarType::Int));
    }
    face.properties.add(scalar("side", ScalarType::UChar));
    face.properties.add(scalar("area", ScalarType::Double));
    let quantities = [
        ("irradiance", true),
        ("radiosity", true),
        ("error", true),
        ("discretisation", options.discretisation.is_some()),
        ("lambert", options.lambert.is_some()),
        ("lambert_error", options.lambert.is_some()),
    ];
    let written = quantities.into_iter().filter(|(_, is_known)| *is_known);
    for (name, kind) in written.flat_map(|(quantity, _)| named(quantity)) {
        face.properties.add(scalar(&name, kind));
    }
    header.elements.add(face);
    header
}

fn element(name: &str, count: usize) -> ElementDef {
    let mut element = ElementDef::new(name.into());
    element.count = count;
    element
}

fn scalar(name: &str, kind: ScalarType) -> PropertyDef {
    PropertyDef::new(name.into(), PropertyType::Scalar(kind))
}

/// Check whether all values fit single precision.
trait Checked: Send {
    fn fits(&self) -> bool;
}

#[derive(Default)]
struct Vertex {
    position: [f32; 3],
    colour: [u8; 3],
    radiosity: [f32; 3],
}

impl Checked for Vertex {
    fn fits(&self) -> bool {
        self.position.iter().chain(&self.radiosity).all(|x| x.is_finite())
    }
}

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self::default()
    }

    fn get_float(&self, name: &str) -> Option<f32> {
        match name {
            "x" => Some(self.position[0]),
            "y" => Some(self.position[1]),
            "z" => Some(self.position[2]),
            _ => channel(name, "radiosity_", self.radiosity),
        }
    }

    fn get_uchar(&self, name: &str) -> Option<u8> {
        ["red", "green", "blue"].iter().position(|&n| n == name).map(|c| self.colour[c])
    }
}

#[derive(Default)]
struct Face {
    vertices: [i32; 3],
    patch: i32,
    triangle: i32,
    back: u8,
    area: f64,
    irradiance: [f32; 3],
    radiosity: [f32; 3],
    error: [f32; 3],
    discretisation: [f32; 3],
    /// The change and its standard error.
    lambert: [[f32; 3]; 2],
}

impl Checked for Face {
    fn fits(&self) -> bool {
        let finite = self.irradiance.iter().chain(&self.radiosity).chain(&self.discretisation);
        let known = self.error.iter().chain(self.lambert.as_flattened());
        finite.into_iter().all(|x| x.is_finite()) && !known.into_iter().any(|x| x.is_infinite())
    }
}

impl PropertyAccess for Face {
    fn new() -> Self {
        Self::default()
    }

    fn get_list_int(&self, name: &str) -> Option<&[i32]> {
        (name == "vertex_indices").then_some(&self.vertices)
    }

    fn get_int(&self, name: &str) -> Option<i32> {
        match name {
            "triangle" => Some(self.triangle),
            "patch" => Some(self.patch),
            _ => None,
        }
    }

    fn get_uchar(&self, name: &str) -> Option<u8> {
        (name == "side").then_some(self.back)
    }

    fn get_double(&self, name: &str) -> Option<f64> {
        (name == "area").then_some(self.area)
    }

    fn get_float(&self, name: &str) -> Option<f32> {
        channel(name, "irradiance_", self.irradiance)
            .or_else(|| channel(name, "radiosity_", self.radiosity))
            .or_else(|| channel(name, "error_", self.error))
            .or_else(|| channel(name, "discretisation_", self.discretisation))
            .or_else(|| channel(name, "lambert_error_", self.lambert[1]))
            .or_else(|| channel(name, "lambert_", self.lambert[0]))
    }
}

/// The value of the channel `name`, if it is a channel of this quantity.
fn channel(name: &str, quantity: &str, values: [f32; 3]) -> Option<f32> {
    let channel = name.strip_prefix(quantity)?;
    RGB.iter().position(|&c| c == channel).map(|c| values[c])
}
