//! The materials and textures of a page.

use std::io;

use glam::DVec2;
use image::{ExtendedColorType, ImageEncoder, RgbImage, codecs::png::PngEncoder, imageops};
use serde_json::{Value, json};

use super::document::{Array, Values, base64_of};
use crate::scene::{Material, Scene, Texture, TextureMap};

/// Texels of a side of an image in a page; larger ones are made smaller.
const LARGEST: u32 = 1024;

/// The materials of a scene as JSON, and their images as data URIs.
pub(crate) fn materials(scene: &Scene, unit: f64) -> io::Result<(Value, Value)> {
    let mut used: Vec<usize> = Vec::new();
    let mut map = |map: &Option<TextureMap>| {
        map.as_ref().map(|map| {
            let known = used.iter().position(|&t| t == map.texture);
            let index = known.unwrap_or_else(|| {
                used.push(map.texture);
                used.len() - 1
            });
            json!({"texture": index, "clamp": map.clamp})
        })
    };
    let material = |m: &Material| {
        json!({
            "name": m.name,
            "reflectance": m.reflectance,
            "reflectance_offset": m.reflectance_offset,
            "emission": m.emission.map(|radiance| std::f64::consts::PI * radiance / unit),
            "reflectance_map": map(&m.reflectance_map),
            "emission_map": map(&m.emission_map),
        })
    };
    let materials: Vec<Value> = scene.materials.iter().map(material).collect();
    let images: Vec<String> =
        used.iter().map(|&t| data_uri(&scene.textures[t])).collect::<io::Result<_>>()?;
    Ok((materials.into(), images.into()))
}

/// Whether reflectance or emission varies within a material, so that patches have values of their own.
pub(crate) fn vary(scene: &Scene) -> bool {
    !scene.colours.is_empty() || scene.materials.iter().any(has_map)
}

/// Whether a material has an image.
pub(crate) fn has_map(material: &Material) -> bool {
    material.reflectance_map.is_some() || material.emission_map.is_some()
}

/// Texture coordinates of the images of reflectance and of emission at points of a triangle, as the images are addressed.
pub(crate) fn coordinates(scene: &Scene, t: usize, corners: [[f64; 3]; 3]) -> [[DVec2; 3]; 2] {
    let m = scene.material(t);
    let own = scene.texcoords.get(t);
    let of = |map: &Option<TextureMap>, uv: Option<&[DVec2; 3]>| {
        corners.map(|b| match (map, uv) {
            (Some(map), Some(uv)) => (0..3).map(|k| uv[k] * b[k]).sum::<DVec2>() * map.scale + map.offset,
            _ => DVec2::ZERO,
        })
    };
    [of(&m.reflectance_map, own), of(&m.emission_map, scene.emission_texcoords.get(t).or(own))]
}

/// The arrays of [`coordinates`] of some triangles.
pub(crate) fn coordinate_arrays(uv: &[[[DVec2; 3]; 2]]) -> [Array; 2] {
    let array = |name: &str, k: usize| {
        let all = uv.iter().flat_map(|uv| uv[k]).flat_map(|p| p.to_array()).map(|x| x as f32);
        (name.into(), Values::F32(all.collect()))
    };
    [array("reflectance_uv", 0), array("emission_uv", 1)]
}

fn data_uri(texture: &Texture) -> io::Result<String> {
    let (width, height) = texture.size();
    let image = RgbImage::from_raw(width as u32, height as u32, texture.texels().to_vec());
    let mut image = image.expect("a texture has three bytes a texel");
    if width.max(height) as u32 > LARGEST {
        let scale = f64::from(LARGEST) / width.max(height) as f64;
        let side = |n: usize| ((n as f64 * scale).round() as u32).max(1);
        image = imageops::resize(&image, side(width), side(height), imageops::FilterType::Triangle);
    }
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(&image, image.width(), image.height(), ExtendedColorType::Rgb8)
        .map_err(io::Error::other)?;
    let text = String::from_utf8(base64_of(&bytes)).expect("base64 is ASCII");
    Ok(format!("data:image/png;base64,{text}"))
}
