//! Small glTF files built in code.

#![allow(dead_code, reason = "every test file uses a part of it")]

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

/// A file under construction: its JSON and the bytes of its one buffer.
pub struct Gltf {
    pub json: Value,
    pub bytes: Vec<u8>,
}

impl Gltf {
    /// A scene of one node whose mesh has no primitives yet.
    pub fn new() -> Gltf {
        let json = json!({
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}], "meshes": [{"primitives": []}],
            "accessors": [], "bufferViews": [],
        });
        Gltf { json, bytes: Vec::new() }
    }

    /// Adds to a list of the file and returns the index.
    pub fn push(&mut self, list: &str, what: Value) -> usize {
        let list = &mut self.json[list];
        if list.is_null() {
            *list = json!([]);
        }
        let list = list.as_array_mut().unwrap();
        list.push(what);
        list.len() - 1
    }

    pub fn view(&mut self, bytes: &[u8]) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let offset = self.bytes.len();
        self.bytes.extend(bytes);
        self.push("bufferViews", json!({"buffer": 0, "byteOffset": offset, "byteLength": bytes.len()}))
    }

    /// An accessor over bytes of its own.
    pub fn accessor(&mut self, bytes: &[u8], component: u32, kind: &str, count: usize) -> usize {
        let view = self.view(bytes);
        self.push(
            "accessors",
            json!({"bufferView": view, "componentType": component, "count": count, "type": kind}),
        )
    }

    pub fn floats<const N: usize>(&mut self, values: &[[f32; N]]) -> usize {
        let bytes: Vec<u8> = values.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
        let kind = ["SCALAR", "VEC2", "VEC3", "VEC4"].get(N - 1).copied().unwrap_or("MAT4");
        let accessor = self.accessor(&bytes, 5126, kind, values.len());
        if N == 3 {
            let bound = |f: fn(f32, f32) -> f32| -> Vec<f32> {
                (0..N).map(|c| values.iter().map(|v| v[c]).reduce(f).unwrap()).collect()
            };
            self.json["accessors"][accessor]["min"] = json!(bound(f32::min));
            self.json["accessors"][accessor]["max"] = json!(bound(f32::max));
        }
        accessor
    }

    pub fn indices(&mut self, values: &[u16]) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|x| x.to_le_bytes()).collect();
        self.accessor(&bytes, 5123, "SCALAR", values.len())
    }

    /// Adds a primitive to the first mesh and returns its index.
    pub fn primitive(&mut self, primitive: Value) -> usize {
        let list = self.json["meshes"][0]["primitives"].as_array_mut().unwrap();
        list.push(primitive);
        list.len() - 1
    }

    /// A diffuse material.
    pub fn material(&mut self, name: &str, colour: [f64; 3], emission: [f64; 3]) -> usize {
        let [r, g, b] = colour;
        self.push(
            "materials",
            json!({"name": name, "emissiveFactor": emission, "pbrMetallicRoughness":
                {"baseColorFactor": [r, g, b, 1.0], "metallicFactor": 0.0}}),
        )
    }

    /// Adds a parallelogram to the first mesh; its front looks along u × v.
    pub fn rectangle(&mut self, corner: [f32; 3], u: [f32; 3], v: [f32; 3], material: usize) -> usize {
        let at = |s: f32, t: f32| std::array::from_fn(|k| corner[k] + s * u[k] + t * v[k]);
        let position = self.floats::<3>(&[at(0., 0.), at(1., 0.), at(1., 1.), at(0., 1.)]);
        let uv = self.floats::<2>(&[[0., 1.], [1., 1.], [1., 0.], [0., 0.]]);
        let indices = self.indices(&[0, 1, 2, 0, 2, 3]);
        self.primitive(json!({"attributes": {"POSITION": position, "TEXCOORD_0": uv},
            "indices": indices, "material": material}))
    }

    /// A texture with an image stored in the file.
    pub fn texture(&mut self, pixels: &image::RgbaImage) -> usize {
        let mut png = Vec::new();
        pixels.write_with_encoder(image::codecs::png::PngEncoder::new(&mut png)).unwrap();
        let view = self.view(&png);
        let image = self.push("images", json!({"bufferView": view, "mimeType": "image/png"}));
        self.push("textures", json!({"source": image}))
    }

    pub fn glb(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        json["buffers"] = json!([{"byteLength": self.bytes.len()}]);
        glb(json.to_string().as_bytes(), &self.bytes)
    }

    pub fn save(&self, folder: &Path, name: &str) -> PathBuf {
        let path = folder.join(name);
        std::fs::write(&path, self.glb()).unwrap();
        path
    }
}

/// A binary file of these two chunks.
pub fn glb(json: &[u8], binary: &[u8]) -> Vec<u8> {
    let chunk = |kind: &[u8; 4], data: &[u8], pad: u8| {
        let mut chunk = (data.len().next_multiple_of(4) as u32).to_le_bytes().to_vec();
        chunk.extend(kind);
        chunk.extend(data);
        chunk.resize(8 + data.len().next_multiple_of(4), pad);
        chunk
    };
    let chunks = [chunk(b"JSON", json, b' '), chunk(b"BIN\0", binary, 0)].concat();
    let length = 12 + chunks.len() as u32;
    [b"glTF".to_vec(), 2u32.to_le_bytes().to_vec(), length.to_le_bytes().to_vec(), chunks].concat()
}

/// The JSON and the binary chunk of a GLB.
pub fn taken_apart(bytes: &[u8]) -> (Value, Vec<u8>) {
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((&bytes[..4], word(4), word(8)), (&b"glTF"[..], 2, bytes.len()));
    let json = 20 + word(12);
    let binary =
        if json < bytes.len() { bytes[json + 8..json + 8 + word(json)].to_vec() } else { Vec::new() };
    (serde_json::from_slice(&bytes[20..json]).unwrap(), binary)
}
