//! A binary glTF file under construction.

use serde_json::{Value, json};

/// The contents of a buffer view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Target {
    /// Attributes of vertices, with the number of bytes from one vertex to the next.
    Vertices(usize),
    /// Indices of vertices.
    Indices,
    /// Anything else.
    Other,
}

/// JSON and one buffer.
#[derive(Debug, Clone)]
pub struct Glb {
    /// The JSON.
    pub json: Value,
    bytes: Vec<u8>,
}

impl Glb {
    /// A file with this JSON and an empty buffer.
    pub fn new(json: Value) -> Glb {
        Glb { json, bytes: Vec::new() }
    }

    /// Adds a value to a list of the JSON and returns its index.
    pub fn push(&mut self, list: &str, what: Value) -> usize {
        let list = &mut self.json[list];
        if !list.is_array() {
            *list = json!([]);
        }
        match list {
            Value::Array(list) => {
                list.push(what);
                list.len() - 1
            }
            _ => unreachable!("it was made a list"),
        }
    }

    /// Adds bytes to the buffer at a multiple of four, and returns where they begin.
    pub fn append(&mut self, bytes: &[u8]) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let start = self.bytes.len();
        self.bytes.extend(bytes);
        start
    }

    /// Adds bytes as a buffer view and returns its index.
    pub fn view(&mut self, bytes: &[u8], target: Target) -> usize {
        let start = self.append(bytes);
        let mut view = json!({"buffer": 0, "byteOffset": start, "byteLength": bytes.len()});
        match target {
            Target::Vertices(stride) => {
                view["target"] = 34962.into();
                view["byteStride"] = stride.into();
            }
            Target::Indices => view["target"] = 34963.into(),
            Target::Other => {}
        }
        self.push("bufferViews", view)
    }

    /// Adds vectors of single precision, one per vertex, and returns the index of the accessor. Positions need
    /// `bounds`.
    pub fn vectors<const N: usize>(&mut self, values: &[[f32; N]], bounds: bool) -> usize {
        let bytes: Vec<u8> = values.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
        let view = self.view(&bytes, Target::Vertices(4 * N));
        let mut accessor = json!({"bufferView": view, "componentType": 5126, "count": values.len(), "type": format!("VEC{N}")});
        if bounds {
            let bound = |of: fn(f32, f32) -> f32| -> Vec<f32> {
                (0..N).filter_map(|c| values.iter().map(|v| v[c]).reduce(of)).collect()
            };
            accessor["min"] = json!(bound(f32::min));
            accessor["max"] = json!(bound(f32::max));
        }
        self.push("accessors", accessor)
    }

    /// Adds the corners of triangles and returns the index of the accessor.
    pub fn triangles(&mut self, corners: &[[u32; 3]]) -> usize {
        let bytes: Vec<u8> = corners.iter().flatten().flat_map(|i| i.to_le_bytes()).collect();
        let view = self.view(&bytes, Target::Indices);
        let count = 3 * corners.len();
        self.push(
            "accessors",
            json!({"bufferView": view, "componentType": 5125, "count": count, "type": "SCALAR"}),
        )
    }

    /// Adds an image file and returns the index of the image.
    pub fn image(&mut self, name: &str, bytes: &[u8], mime: &str) -> usize {
        let view = self.view(bytes, Target::Other);
        self.push("images", json!({"name": name, "bufferView": view, "mimeType": mime}))
    }

    /// Adds an 8-bit R G B image as PNG and returns the index of the image.
    pub fn png(&mut self, name: &str, pixels: &image::RgbImage) -> usize {
        let mut png = Vec::new();
        // Writing to memory does not fail, and PNG holds eight bits of R G B.
        let encoder = image::codecs::png::PngEncoder::new(&mut png);
        pixels.write_with_encoder(encoder).expect("an image can be encoded into memory");
        self.image(name, &png, "image/png")
    }

    /// Lists an extension as used.
    pub fn uses(&mut self, extension: &str) {
        let known =
            self.json["extensionsUsed"].as_array().is_some_and(|list| list.iter().any(|e| e == extension));
        if !known {
            self.push("extensionsUsed", extension.into());
        }
    }

    /// The whole file.
    pub fn finish(mut self) -> Vec<u8> {
        self.json["buffers"] = json!([{"byteLength": self.bytes.len()}]);
        if self.bytes.is_empty() {
            // The specification forbids empty buffers.
            self.json.as_object_mut().map(|json| json.remove("buffers"));
        }
        let json = self.json.to_string().into_bytes();
        let chunk = |kind: &[u8; 4], mut data: Vec<u8>, pad: u8| {
            data.resize(data.len().next_multiple_of(4), pad);
            [&(data.len() as u32).to_le_bytes(), &kind[..], &data].concat()
        };
        let mut chunks = chunk(b"JSON", json, b' ');
        if !self.bytes.is_empty() {
            chunks.extend(chunk(b"BIN\0", self.bytes, 0));
        }
        let length = 12 + chunks.len() as u32;
        [&b"glTF"[..], &2u32.to_le_bytes(), &length.to_le_bytes(), &chunks].concat()
    }
}
