//! Images of a glTF file, and the steps that make textures of them.

use image::{DynamicImage, Rgb, RgbImage};

use crate::tone;

/// A decoded image.
#[derive(Debug)]
pub struct Image {
    pub colour: RgbImage,
    /// Alpha of all texels, rows from the top; `None` for an image without alpha.
    pub alpha: Option<Vec<u8>>,
}

impl Image {
    pub fn new(image: DynamicImage) -> Image {
        let alpha = image.color().has_alpha().then(|| image.to_rgba8().pixels().map(|p| p.0[3]).collect());
        Image { colour: image.into_rgb8(), alpha }
    }

    /// The mask that is white where alpha is at least `least` and black elsewhere. `None` if all of it would be white.
    pub fn mask(&self, least: f64) -> Option<RgbImage> {
        let alpha = self.alpha.as_ref()?;
        let is_solid = |alpha: u8| f64::from(alpha) >= least;
        if alpha.iter().all(|&alpha| is_solid(alpha)) {
            return None;
        }
        let (width, height) = self.colour.dimensions();
        let at = |x: u32, y: u32| alpha[y as usize * width as usize + x as usize];
        Some(RgbImage::from_fn(width, height, |x, y| Rgb([if is_solid(at(x, y)) { 255 } else { 0 }; 3])))
    }

    /// The mean of a channel with linear values, from 0 to 1.
    pub fn mean_of(&self, channel: usize) -> f64 {
        let sum: f64 = self.colour.pixels().map(|p| f64::from(p.0[channel])).sum();
        sum / (255.0 * f64::from(self.colour.width()) * f64::from(self.colour.height()))
    }

    /// The mean colour, as linear values.
    pub fn mean(&self) -> [f64; 3] {
        let mut counts = [[0u64; 256]; 3];
        for pixel in self.colour.pixels() {
            (0..3).for_each(|c| counts[c][usize::from(pixel.0[c])] += 1);
        }
        let texels = f64::from(self.colour.width()) * f64::from(self.colour.height());
        counts.map(|counts| {
            let of_byte = |(byte, &count): (usize, &u64)| count as f64 * tone::linear(byte as f64 / 255.0);
            counts.iter().enumerate().map(of_byte).sum::<f64>() / texels
        })
    }
}

/// A base colour times the share that is not metal. The blue channel of `metal` is the share of metal. The result has
/// the larger width and height of the two images.
pub fn without_metal(base: Option<&RgbImage>, metal: &RgbImage, factor: f64) -> RgbImage {
    let size = |image: &RgbImage| image.dimensions();
    let (w, h) = base.map_or(size(metal), |base| {
        let (a, b) = (size(base), size(metal));
        (a.0.max(b.0), a.1.max(b.1))
    });
    let at = |image: &RgbImage, x: u32, y: u32| {
        let scaled = |k: u32, from: u32, to: u32| (u64::from(k) * u64::from(to) / u64::from(from)) as u32;
        *image.get_pixel(scaled(x, w, image.width()), scaled(y, h, image.height()))
    };
    RgbImage::from_fn(w, h, |x, y| {
        let left = 1.0 - factor * f64::from(at(metal, x, y).0[2]) / 255.0;
        let colour = base.map_or([255; 3], |base| at(base, x, y).0);
        Rgb(colour.map(|c| {
            let linear = left * tone::linear(f64::from(c) / 255.0);
            (tone::srgb(linear) * 255.0).round() as u8
        }))
    })
}

/// The image with its mirror image to the right of it, below it, or both. If the result repeats, the image is mirrored.
pub fn mirrored(image: RgbImage, [right, below]: [bool; 2]) -> RgbImage {
    if !right && !below {
        return image;
    }
    let (w, h) = image.dimensions();
    let (width, height) = (w << u32::from(right), h << u32::from(below));
    RgbImage::from_fn(width, height, |x, y| {
        let inside = |k: u32, n: u32| if k < n { k } else { 2 * n - 1 - k };
        *image.get_pixel(inside(x, w), inside(y, h))
    })
}
