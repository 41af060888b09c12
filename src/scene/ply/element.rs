//! The elements of a PLY file, with numbers of any type.

use ply_rs::ply::{Property, PropertyAccess, PropertyAccessResult};

use crate::tone;

/// Names of the list of a face's corners.
pub(super) const INDICES: [&str; 2] = ["vertex_indices", "vertex_index"];

/// Three channels; some may be absent.
#[derive(Default)]
pub(super) struct Channels([Option<f64>; 3]);

impl Channels {
    /// Takes `value` if `name` is one of `names`, and returns whether it is.
    fn take(&mut self, names: [&str; 3], name: &str, value: f64) -> bool {
        let channel = names.iter().position(|&n| n == name);
        if let Some(c) = channel {
            self.0[c] = Some(value);
        }
        channel.is_some()
    }

    pub(super) fn given(&self) -> Option<[f64; 3]> {
        match self.0 {
            [Some(r), Some(g), Some(b)] => Some([r, g, b]),
            _ => None,
        }
    }

    /// The linear values of sRGB colours.
    pub(super) fn linear(&self) -> std::result::Result<Option<[f64; 3]>, String> {
        match self.given() {
            Some(rgb) => match rgb.iter().find(|c| !(0.0..=1.0).contains(*c)) {
                Some(_) => Err("a colour is out of range".into()),
                None => Ok(Some(rgb.map(tone::linear))),
            },
            None => Ok(None),
        }
    }
}

const COLOUR: [&str; 3] = ["red", "green", "blue"];

/// A vertex.
#[derive(Default)]
pub(super) struct Vertex {
    pub(super) position: [f64; 3],
    /// Zero if the file gives none.
    pub(super) normal: [f32; 3],
    pub(super) colour: Channels,
}

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        match (name, number(&property)) {
            ("x", Some(x)) => self.position[0] = x,
            ("y", Some(y)) => self.position[1] = y,
            ("z", Some(z)) => self.position[2] = z,
            ("nx", Some(x)) => self.normal[0] = x as f32,
            ("ny", Some(y)) => self.normal[1] = y as f32,
            ("nz", Some(z)) => self.normal[2] = z as f32,
            (_, Some(value)) => {
                self.colour.take(COLOUR, name, value / full(&property));
            }
            _ => return PropertyAccessResult::Ignored,
        }
        PropertyAccessResult::Set
    }
}

/// A face.
#[derive(Default)]
pub(super) struct Face {
    pub(super) indices: Vec<i64>,
    pub(super) colour: Channels,
    pub(super) reflectance: Channels,
    pub(super) emission: Channels,
    /// The side of the patch, in files of this program: 0 for a front.
    pub(super) side: f64,
    /// Other numbers, by which faces may be grouped.
    pub(super) others: Vec<(String, f64)>,
}

impl PropertyAccess for Face {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        if INDICES.contains(&name) {
            return match integers(property) {
                Some(indices) => {
                    self.indices = indices;
                    PropertyAccessResult::Set
                }
                None => PropertyAccessResult::UnsupportedType,
            };
        }
        if let Some(value) = number(&property) {
            let known = self.colour.take(COLOUR, name, value / full(&property))
                || self.reflectance.take(["reflectance_r", "reflectance_g", "reflectance_b"], name, value)
                || self.emission.take(["emission_r", "emission_g", "emission_b"], name, value);
            match name {
                _ if known => {}
                "side" => self.side = value,
                _ => self.others.push((name.into(), value)),
            }
        }
        PropertyAccessResult::Set
    }
}

/// An element that the reader ignores.
pub(super) struct Ignored;

impl PropertyAccess for Ignored {
    fn new() -> Self {
        Ignored
    }
}

/// The value of a scalar.
fn number(property: &Property) -> Option<f64> {
    Some(match *property {
        Property::Char(x) => x.into(),
        Property::UChar(x) => x.into(),
        Property::Short(x) => x.into(),
        Property::UShort(x) => x.into(),
        Property::Int(x) => x.into(),
        Property::UInt(x) => x.into(),
        Property::Float(x) => x.into(),
        Property::Double(x) => x,
        _ => return None,
    })
}

/// The value of a colour that stands for 1.
fn full(property: &Property) -> f64 {
    match property {
        Property::Float(_) | Property::Double(_) => 1.0,
        Property::UShort(_) => 65535.0,
        _ => 255.0,
    }
}

/// The values of a list of integers.
fn integers(property: Property) -> Option<Vec<i64>> {
    fn all<T: Into<i64>>(list: Vec<T>) -> Option<Vec<i64>> {
        Some(list.into_iter().map(Into::into).collect())
    }
    match property {
        Property::ListChar(list) => all(list),
        Property::ListUChar(list) => all(list),
        Property::ListShort(list) => all(list),
        Property::ListUShort(list) => all(list),
        Property::ListInt(list) => all(list),
        Property::ListUInt(list) => all(list),
        _ => None,
    }
}
