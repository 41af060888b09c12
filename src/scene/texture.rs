//! Textures.

mod mean;

use std::path::Path;
use std::sync::LazyLock;

use glam::DVec2;

use self::mean::Pyramid;

/// Images with a longer side or with more bytes are refused, because a damaged header may claim any size.
const LARGEST_SIDE: u32 = 16384;
const LARGEST_DECODED: u64 = 1 << 30;

/// Decodes a PNG, JPEG, TGA, BMP, WebP or TIFF image. The format follows from its bytes. If these do not identify it,
/// the format is `named`, from the file's name. The error is a sentence.
pub(super) fn decode(bytes: &[u8], named: Option<image::ImageFormat>) -> Result<image::DynamicImage, String> {
    use image::ImageFormat::{Bmp, Jpeg, Png, Tga, Tiff, WebP};
    let mut reader = image::ImageReader::new(std::io::Cursor::new(bytes));
    reader = reader.with_guessed_format().map_err(|e| e.to_string())?;
    // TGA files have no signature.
    if let (None, Some(named)) = (reader.format(), named) {
        reader.set_format(named);
    }
    if !matches!(reader.format(), Some(Png | Jpeg | Tga | Bmp | WebP | Tiff)) {
        return Err("not a PNG, JPEG, TGA, BMP, WebP or TIFF image".into());
    }
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(LARGEST_SIDE);
    limits.max_image_height = Some(LARGEST_SIDE);
    limits.max_alloc = Some(LARGEST_DECODED);
    reader.limits(limits);
    let image = reader.decode().map_err(|e| e.to_string())?;
    if image.width() == 0 || image.height() == 0 {
        return Err("the image has no texels".into());
    }
    Ok(image)
}

/// The smallest alpha, from 0 to 255, of a texel that counts as surface.
const HALF: u8 = 128;

/// An image, decoded from sRGB when looked up. Its texels are constant squares: the mean over a patch and the value
/// at a point agree exactly.
#[derive(Debug, Clone)]
pub struct Texture {
    width: usize,
    height: usize,
    /// R G B, sRGB-encoded, rows from the top.
    texels: Vec<u8>,
    is_grey: bool,
    /// Whether each texel is surface, rows from the top. `None` if all are.
    solid: Option<Vec<bool>>,
    pyramid: Pyramid,
}

/// The use of a texture by a material.
#[derive(Debug, Clone, PartialEq)]
pub struct TextureMap {
    /// Index into [`Scene::textures`](super::Scene::textures).
    pub texture: usize,
    /// Texture coordinates are multiplied by this scale.
    pub scale: DVec2,
    /// The offset is added after scaling.
    pub offset: DVec2,
    /// Whether the texels at the rim extend outside 0..1. Otherwise the image repeats.
    pub clamp: bool,
}

impl TextureMap {
    /// The texture without scale or offset, repeated.
    pub fn new(texture: usize) -> Self {
        TextureMap { texture, scale: DVec2::ONE, offset: DVec2::ZERO, clamp: false }
    }
}

/// The linear value of a byte of a texel.
static LINEAR: LazyLock<[f64; 256]> =
    LazyLock::new(|| std::array::from_fn(|i| crate::tone::linear(i as f64 / 255.0)));

impl Texture {
    /// Makes an image of `width` times `height` texels, R G B one byte each, sRGB-encoded, rows from the top.
    ///
    /// # Panics
    /// When there are no texels or `texels` has another length.
    pub fn new(width: usize, height: usize, texels: Vec<u8>) -> Texture {
        assert!(width > 0 && height > 0, "a texture without texels");
        assert_eq!(texels.len(), 3 * width * height, "three bytes a texel");
        let is_grey = texels.chunks_exact(3).all(|t| t[0] == t[1] && t[1] == t[2]);
        let mut texture =
            Texture { width, height, texels, is_grey, solid: None, pyramid: Pyramid::default() };
        texture.pyramid = Pyramid::new(&texture);
        texture
    }

    /// Reads an image file. The error is a sentence.
    pub(super) fn load(path: &Path) -> Result<Texture, String> {
        let image = decode(
            &std::fs::read(path).map_err(|e| e.to_string())?,
            image::ImageFormat::from_path(path).ok(),
        )?;
        let (width, height) = (image.width() as usize, image.height() as usize);
        let alpha = image.color().has_alpha().then(|| image.to_rgba8().into_raw());
        let texture = Texture::new(width, height, image.into_rgb8().into_raw());
        Ok(match alpha {
            Some(rgba) => texture.with_solid(rgba.chunks_exact(4).map(|texel| texel[3] >= HALF).collect()),
            None => texture,
        })
    }

    /// The same image with holes where `solid` is false; rows from the top. Colours stay as they are.
    ///
    /// # Panics
    /// When `solid` does not have one value per texel.
    pub fn with_solid(mut self, solid: Vec<bool>) -> Texture {
        assert_eq!(solid.len(), self.width * self.height, "one value a texel");
        self.solid = solid.contains(&false).then_some(solid);
        self
    }

    /// The same image as a mask. If its alpha has no holes, white is surface and black is a hole.
    pub(super) fn into_mask(self) -> Texture {
        if self.has_holes() {
            return self;
        }
        let white = |t: &[u8]| t.iter().map(|&x| u32::from(x)).sum::<u32>() >= 3 * u32::from(HALF);
        let solid = self.texels.chunks_exact(3).map(white).collect();
        self.with_solid(solid)
    }

    /// Whether any texel is a hole.
    pub fn has_holes(&self) -> bool {
        self.solid.is_some()
    }

    /// Whether a texel is surface. `x` counts to the right and `y` down from the top left texel. Outside the image the
    /// map decides whether it repeats.
    pub(super) fn is_solid(&self, map: &TextureMap, x: i64, y: i64) -> bool {
        let Some(solid) = &self.solid else { return true };
        let within = |x: i64, n: usize| {
            let n = n as i64;
            (if map.clamp { x.clamp(0, n - 1) } else { x.rem_euclid(n) }) as usize
        };
        solid[within(y, self.height) * self.width + within(x, self.width)]
    }

    /// Number of texels in a row and in a column.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// R G B of all texels, one byte each, sRGB-encoded, rows from the top.
    pub fn texels(&self) -> &[u8] {
        &self.texels
    }

    /// Whether every texel has three equal channels.
    pub fn is_grey(&self) -> bool {
        self.is_grey
    }

    /// The largest linear value of each channel.
    pub(crate) fn brightest(&self) -> [f64; 3] {
        let most = self
            .texels
            .chunks_exact(3)
            .fold([0; 3], |most: [u8; 3], texel| std::array::from_fn(|c| most[c].max(texel[c])));
        most.map(|byte| LINEAR[usize::from(byte)])
    }

    /// Linear value at `uv`.
    pub fn at(&self, map: &TextureMap, uv: DVec2) -> [f64; 3] {
        let p = self.to_texels(map, uv);
        let column = |x: f64, n: usize| {
            let x = x.floor();
            // The cast saturates, which clamps. It also turns NaN into 0.
            let x = if map.clamp { x } else { x.rem_euclid(n as f64) };
            (x as usize).min(n - 1)
        };
        self.texel(column(p.x, self.width), column(p.y, self.height))
    }

    /// Mean linear value over the triangle `uv`, or the value at the centroid if its area is zero.
    ///
    /// The mean is exact for triangles with an extent (width plus height) of up to about a thousand texels. On the rim
    /// of a larger triangle, a square smaller than 1/512 of its extent counts with its mean. This bounds the time, even
    /// if the image repeats very often.
    pub fn mean(&self, map: &TextureMap, uv: [DVec2; 3]) -> [f64; 3] {
        let corners = uv.map(|p| self.to_texels(map, p));
        mean::over(self, map.clamp, corners)
            .unwrap_or_else(|| self.at(map, super::interpolate(&uv, [1.0 / 3.0; 3])))
    }

    /// Texture coordinates in texels: x to the right and y down from the top left corner. The v of a texture coordinate
    /// points up.
    pub(super) fn to_texels(&self, map: &TextureMap, uv: DVec2) -> DVec2 {
        let p = uv * map.scale + map.offset;
        DVec2::new(p.x * self.width as f64, (1.0 - p.y) * self.height as f64)
    }

    fn texel(&self, x: usize, y: usize) -> [f64; 3] {
        let at = 3 * (y * self.width + x);
        std::array::from_fn(|c| LINEAR[usize::from(self.texels[at + c])])
    }
}
