//! The binary format of a checkpoint: header, records and their pieces.

use std::path::Path;

use super::part::Part;
use crate::{Error, Result, scene::Scene, trace::sampling::mix};

/// Identifies the file. A transfer as text changes the line end.
const MAGIC: &[u8; 16] = b"radiosity rays\r\n";
/// Grows with each change of the format, of the rays that a seed gives, or of what is stored of them.
const FORMAT: u32 = 6;
/// Bytes of the header, of which the last four are a checksum.
pub(super) const HEADER: usize = 56;
const CHECKED: usize = HEADER - 4;
/// Bytes of a record before and after its body.
pub(super) const BEFORE: usize = 12;
pub(super) const AFTER: usize = 4;
/// Number of 4-byte numbers before the rays of each patch in a record.
const NUMBERS: usize = 5;

/// The kind of ray and the subdivision (one digest), the number of the patch, which chooses its rays, and the surface
/// of the patch. The surface is needed because numbers of backs depend on the order in which they were found.
pub(super) type Key = (u64, u32, u32);

/// Rays of one patch in a record. They continue the previous piece of the patch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Piece {
    /// The file of the checkpoint, and the position there.
    pub(super) file: u32,
    pub(super) at: u64,
    pub(super) from: u32,
    pub(super) to: u32,
    /// Bytes of a ray.
    pub(super) size: u32,
}

impl Piece {
    /// Bytes of all rays.
    pub(super) fn bytes(&self) -> usize {
        (self.to - self.from) as usize * self.size as usize
    }
}

pub(super) fn damage(path: &Path, place: &str) -> Error {
    Error::input(path, None, format!("the checkpoint is damaged at {place}"))
        .with_hint("delete it to begin anew, or keep the checkpoint in another file")
}

pub(super) fn header(scene: &Scene, seed: u64, part: Part) -> [u8; HEADER] {
    let mut bytes = [0; HEADER];
    bytes[..16].copy_from_slice(MAGIC);
    bytes[16..20].copy_from_slice(&FORMAT.to_le_bytes());
    let version = env!("CARGO_PKG_VERSION").bytes().fold(0, |h, b| mix(&[h, b.into()]));
    for (k, word) in [version, digest(scene), seed].into_iter().enumerate() {
        bytes[20 + 8 * k..28 + 8 * k].copy_from_slice(&word.to_le_bytes());
    }
    for (k, word) in [part.number(), part.count()].into_iter().enumerate() {
        bytes[44 + 4 * k..48 + 4 * k].copy_from_slice(&word.to_le_bytes());
    }
    let check = crc32fast::hash(&bytes[..CHECKED]);
    bytes[CHECKED..].copy_from_slice(&check.to_le_bytes());
    bytes
}

/// Checks the header, and returns the part of the patches that the file belongs to. The error describes what the file
/// is instead.
pub(super) fn check_header(path: &Path, found: &[u8], wanted: &[u8; HEADER]) -> Result<Part> {
    let same = |range: std::ops::Range<usize>| found[range.clone()] == wanted[range];
    let other = |what: String, advice: &str| Err(Error::input(path, None, what).with_hint(advice));
    let name = "keep the checkpoint in another file, or delete this one";
    if found.len() < 20 || !same(0..16) {
        return other("this file is not a checkpoint, and was left as it is".into(), name);
    }
    // Headers of other formats may have other lengths.
    if !same(16..20) {
        return other("the checkpoint is of another version of the program".into(), name);
    }
    if found.len() < HEADER || crc32fast::hash(&found[..CHECKED]).to_le_bytes() != found[CHECKED..] {
        return Err(damage(path, "its start"));
    }
    if !same(20..28) {
        return other("the checkpoint is of another version of the program".into(), name);
    }
    if !same(28..36) {
        return other("the checkpoint is of another scene".into(), name);
    }
    if !same(36..44) {
        let seed = u64::from_le_bytes(std::array::from_fn(|k| found[36 + k]));
        return other(format!("the checkpoint is of seed {seed}"), &format!("use seed {seed}, or {name}"));
    }
    let [number, count] = numbers(&found[44..CHECKED]);
    Part::new(number, count).ok_or_else(|| damage(path, "its start"))
}

/// A digest of everything in the scene that affects rays.
fn digest(scene: &Scene) -> u64 {
    let mut sum = 0;
    let mut add = |words: &[u64]| sum = mix(&[sum, mix(words)]);
    add(&[scene.triangles.len(), scene.materials.len(), scene.textures.len()].map(|n| n as u64));
    for (t, triangle) in scene.triangles.iter().enumerate() {
        let corners = scene.corners(t).map(|p| mix(&p.to_array().map(f64::to_bits)));
        add(&[triangle.material.into(), mix(&corners)]);
    }
    for uv in scene.texcoords.iter().chain(&scene.emission_texcoords).flatten() {
        add(&uv.to_array().map(f64::to_bits));
    }
    for colour in scene.colours.iter().flatten() {
        add(&colour.map(|c| u64::from(c.to_bits())));
    }
    for m in &scene.materials {
        add(&[m.reflectance, m.emission].map(|rgb| mix(&rgb.map(f64::to_bits))));
        for map in [&m.reflectance_map, &m.emission_map] {
            let Some(map) = map else { continue };
            let placed = [map.scale.x, map.scale.y, map.offset.x, map.offset.y].map(f64::to_bits);
            add(&[map.texture as u64, map.clamp.into(), mix(&placed)]);
        }
    }
    for texture in &scene.textures {
        add(&[texture.size().0 as u64, texture.size().1 as u64]);
        for texels in texture.texels().chunks(1 << 10) {
            add(&[u64::from(crc32fast::hash(texels))]);
        }
    }
    sum
}

/// Begins a record of rays of one kind and subdivision.
pub(super) fn begin_record(bytes: &mut Vec<u8>, digest: u64) {
    bytes.extend([0; BEFORE]);
    bytes.extend(digest.to_le_bytes());
}

/// Fills in a record's length and checksums.
pub(super) fn seal_record(bytes: &mut Vec<u8>) {
    let length = ((bytes.len() - BEFORE) as u64).to_le_bytes();
    bytes[..8].copy_from_slice(&length);
    bytes[8..BEFORE].copy_from_slice(&crc32fast::hash(&length).to_le_bytes());
    let check = crc32fast::hash(&bytes[BEFORE..]);
    bytes.extend(check.to_le_bytes());
}

/// The length of a record's body; `None` if its checksum does not match.
pub(super) fn body_length(before: &[u8; BEFORE]) -> Option<u64> {
    let (length, check) = before.split_at(8);
    let length: [u8; 8] = std::array::from_fn(|k| length[k]);
    (crc32fast::hash(&length).to_le_bytes() == check).then(|| u64::from_le_bytes(length))
}

/// The next `N` numbers of 4 bytes.
fn numbers<const N: usize>(bytes: &[u8]) -> [u32; N] {
    std::array::from_fn(|k| u32::from_le_bytes(std::array::from_fn(|b| bytes[4 * k + b])))
}

/// The pieces of a record's body, which begins at `at` in the file; `None` if the body is invalid.
pub(super) fn pieces(body: &[u8], at: u64) -> Option<Vec<(Key, Piece)>> {
    let (digest, mut rest) = body.split_first_chunk::<8>()?;
    let mut pieces = Vec::new();
    while !rest.is_empty() {
        let (start, tail) = rest.split_at_checked(4 * NUMBERS)?;
        let [patch, surface, from, to, size] = numbers(start);
        if from >= to {
            return None;
        }
        let piece = Piece { file: 0, at: at + (body.len() - tail.len()) as u64, from, to, size };
        rest = tail.get(piece.bytes()..)?;
        pieces.push(((u64::from_le_bytes(*digest), patch, surface), piece));
    }
    Some(pieces)
}

/// The numbers before the rays of a piece.
pub(super) fn piece_start((_, patch, surface): Key, piece: &Piece) -> [u8; 4 * NUMBERS] {
    let Piece { from, to, size, .. } = *piece;
    let numbers = [patch, surface, from, to, size];
    std::array::from_fn(|k| numbers[k / 4].to_le_bytes()[k % 4])
}
