//! Pictures of radiance, and their encoding.

use std::io::{self, Seek, Write};

use exr::prelude::{Blocks, Compression, Encoding, LineOrder, SpecificChannels, Vec2, WritableImage};
use glam::Vec3A;
use image::{
    Rgb32FImage, RgbImage,
    codecs::{hdr::HdrEncoder, png::PngEncoder},
};
use rayon::prelude::*;

use super::{Camera, Lens, PathTracer, Samples, samples::take};
use crate::{
    Progress, Result,
    tone::{Exposure, luminance},
    trace::sampling::mix,
};

/// A picture of linear radiance, W/(m² sr), row by row from the top.
#[derive(Debug, Clone, PartialEq)]
pub struct Film {
    width: usize,
    height: usize,
    pixels: Vec<[f32; 3]>,
}

/// Options of [`Film::render`] and [`Film::sample`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct RenderOptions {
    /// Paths per pixel, spread over the pixel's square. Default 64. Sobol sequences are most accurate with powers of
    /// two.
    pub samples: u32,
    /// Seed of all random numbers. Default 1.
    pub seed: u64,
}

setters!(RenderOptions {
    with_samples(samples: u32),
    with_seed(seed: u64),
});

impl Default for RenderOptions {
    fn default() -> Self {
        RenderOptions { samples: 64, seed: 1 }
    }
}

/// File format of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PictureFormat {
    /// Eight bits per channel, exposed and encoded as sRGB.
    Png,
    /// Radiance in single precision, linear and not exposed.
    Exr,
    /// Radiance with a shared exponent (Radiance RGBE), linear and not exposed.
    Hdr,
}

impl PictureFormat {
    /// The format with this file name extension.
    pub fn of_extension(extension: &str) -> Option<PictureFormat> {
        let all = [PictureFormat::Png, PictureFormat::Exr, PictureFormat::Hdr];
        all.into_iter().find(|format| extension.eq_ignore_ascii_case(format.extension()))
    }

    /// The file name extension of this format.
    pub fn extension(self) -> &'static str {
        match self {
            PictureFormat::Png => "png",
            PictureFormat::Exr => "exr",
            PictureFormat::Hdr => "hdr",
        }
    }
}

impl Film {
    /// A picture from its pixels.
    ///
    /// # Panics
    /// If the number of pixels is not `width` times `height`.
    pub fn from_pixels(width: usize, height: usize, pixels: Vec<[f32; 3]>) -> Film {
        assert_eq!(pixels.len(), width * height, "a picture has width times height pixels");
        Film { width, height, pixels }
    }

    /// Adds a picture of the same size.
    pub(super) fn add(&mut self, other: &Film) {
        let values = self.pixels.as_flattened_mut().iter_mut().zip(other.pixels.as_flattened());
        values.for_each(|(sum, more)| *sum += more);
    }

    /// Pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The pixels, row by row from the top.
    pub fn pixels(&self) -> &[[f32; 3]] {
        &self.pixels
    }

    /// Renders a picture by path tracing: each pixel is the mean radiance over its square.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped).
    pub fn render(
        paths: &PathTracer,
        camera: &Camera,
        options: &RenderOptions,
        progress: &Progress,
    ) -> Result<Film> {
        let lens = camera.lens(paths.tracer());
        Film::sample(&lens, options, progress, |direction, samples| {
            paths.radiance(lens.eye(), direction, samples)
        })
    }

    /// Samples a picture: each pixel is the mean radiance over its square. `radiance` returns a sample of the radiance
    /// that arrives at the eye from a direction, which need not have unit length.
    ///
    /// The random numbers of a sample depend only on the seed, the pixel and the index of the sample. So the bytes are
    /// the same for any number of threads.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped).
    pub fn sample(
        lens: &Lens,
        options: &RenderOptions,
        progress: &Progress,
        radiance: impl Fn(Vec3A, &mut Samples) -> [f64; 3] + Sync,
    ) -> Result<Film> {
        let (width, height) = (lens.width(), lens.height());
        let samples = options.samples.max(1);
        let mut pixels = vec![[0.0; 3]; width * height];
        progress.begin("rendering", pixels.len() as u64 * samples as u64);
        // Short stretches of pixels keep all threads busy to the end, for any shape of the picture.
        const STRETCH: usize = 32;
        pixels.par_chunks_mut(STRETCH).enumerate().try_for_each(|(chunk, stretch)| {
            for (k, pixel) in stretch.iter_mut().enumerate() {
                let i = chunk * STRETCH + k;
                let seed = mix(&[options.seed, i as u64]);
                let mut sum = [0.0; 3];
                take(samples, progress, |s| {
                    let mut numbers = Samples::new(s, seed);
                    let [x, y] = numbers.square().map(f64::from);
                    let direction = lens.direction((i % width) as f64 + x, (i / width) as f64 + y);
                    let radiance = radiance(direction, &mut numbers);
                    (0..3).for_each(|c| sum[c] += radiance[c]);
                    Ok(())
                })?;
                *pixel = sum.map(|x| (x / samples as f64) as f32);
            }
            Ok(())
        })?;
        Ok(Film { width, height, pixels })
    }

    /// Mean radiance over the picture.
    pub fn mean(&self) -> [f64; 3] {
        let n = self.pixels.len() as f64;
        std::array::from_fn(|c| self.pixels.iter().map(|p| f64::from(p[c])).sum::<f64>() / n)
    }

    /// The exposure at which nine tenths of the lit pixels are below white. Lamps in the picture may clip. Black pixels
    /// do not count.
    pub fn automatic_exposure(&self) -> Exposure {
        Exposure::automatic(self.pixels.iter().map(|p| (luminance(p.map(f64::from)), 1.0)))
    }

    /// The picture as eight-bit sRGB.
    pub fn to_srgb(&self, exposure: Exposure) -> Vec<[u8; 3]> {
        self.pixels.iter().map(|p| exposure.encode(p.map(f64::from))).collect()
    }

    /// Writes the picture to `out`. The exposure applies to PNG only.
    ///
    /// # Errors
    /// Errors of `out`, and an error if a radiance is not finite in single precision.
    pub fn encode(
        &self,
        out: &mut (impl Write + ?Sized),
        format: PictureFormat,
        exposure: Exposure,
    ) -> io::Result<()> {
        if !self.pixels.iter().flatten().all(|x| x.is_finite()) {
            return Err(io::Error::other(
                "the picture has a radiance that is not finite in single precision",
            ));
        }
        let (width, height) = (self.width as u32, self.height as u32);
        let mut bytes = io::Cursor::new(Vec::new());
        match format {
            PictureFormat::Png => {
                let pixels = self.to_srgb(exposure).into_flattened();
                let image = RgbImage::from_raw(width, height, pixels).expect("the buffer fits its size");
                // `write_to` would compile the encoders of all formats.
                image.write_with_encoder(PngEncoder::new(&mut bytes)).map_err(io::Error::other)?;
            }
            PictureFormat::Hdr => {
                let pixels = self.pixels.as_flattened().to_vec();
                let image = Rgb32FImage::from_raw(width, height, pixels).expect("the buffer fits its size");
                image.write_with_encoder(HdrEncoder::new(&mut bytes)).map_err(io::Error::other)?;
            }
            PictureFormat::Exr => self.encode_exr(&mut bytes)?,
        }
        out.write_all(bytes.get_ref())
    }

    /// In scan lines from the top. The encoder of `image` writes tiles in any order, which Godot 3 reads as if they were in rows.
    fn encode_exr(&self, out: &mut (impl Write + Seek)) -> io::Result<()> {
        let encoding = Encoding {
            compression: Compression::ZIP16,
            blocks: Blocks::ScanLines,
            line_order: LineOrder::Increasing,
        };
        let channels = SpecificChannels::rgb(|at: Vec2<usize>| {
            let [r, g, b] = self.pixels[at.y() * self.width + at.x()];
            (r, g, b)
        });
        let picture = exr::image::Image::from_encoded_channels((self.width, self.height), encoding, channels);
        picture.write().non_parallel().to_buffered(out).map_err(io::Error::other)
    }
}

#[cfg(test)]
mod tests {
    use image::DynamicImage;

    use super::*;

    fn ramp() -> Film {
        Film::from_pixels(3, 2, (0..6).map(|i| [0.5 * i as f32, 0.25, 7.5]).collect())
    }

    fn encoded(film: &Film, format: PictureFormat, exposure: Exposure) -> DynamicImage {
        let mut bytes = Vec::new();
        film.encode(&mut bytes, format, exposure).unwrap();
        image::load_from_memory(&bytes).unwrap()
    }

    #[test]
    fn linear_formats_keep_radiance_and_row_order() {
        for (format, tolerance) in [(PictureFormat::Exr, 0.0), (PictureFormat::Hdr, 0.01)] {
            let back = encoded(&ramp(), format, Exposure::of_white(0.125)).to_rgb32f();
            assert_eq!(back.dimensions(), (3, 2));
            for (pixel, want) in back.pixels().zip(ramp().pixels()) {
                for c in 0..3 {
                    let allowed = tolerance * want.iter().fold(0.0f32, |a, &b| a.max(b));
                    assert!((pixel.0[c] - want[c]).abs() <= allowed, "{format:?} {pixel:?} {want:?}");
                }
            }
        }
    }

    #[test]
    fn png_is_exposed_and_encoded() {
        // 20 lit pixels of luminance 1 to 19 and a lamp; nine tenths do not exceed 18. Black does not count.
        let mut pixels = vec![[0.0; 3]; 4];
        pixels.extend((1..=19).map(|i| [i as f32; 3]));
        pixels.push([900.0; 3]);
        let film = Film::from_pixels(12, 2, pixels);
        let exposure = film.automatic_exposure();
        assert!((exposure.scale - 0.8 / 18.0).abs() < 1e-12);
        let back = encoded(&film, PictureFormat::Png, exposure).to_rgb8();
        let value = |i: u32| back.get_pixel(i % 12, i / 12).0;
        // The sRGB standard: 255 (1.055 x^(1/2.4) - 0.055) is 231.1 for 0.8 and 59.5 for 0.8/18.
        assert_eq!([value(0), value(4), value(21), value(23)], [[0; 3], [59; 3], [231; 3], [255; 3]]);
        // For 0.4 it is 169.6.
        let darker = encoded(&film, PictureFormat::Png, exposure.brighter(-1.0)).to_rgb8();
        assert_eq!(darker.get_pixel(9, 1).0, [170; 3]);
    }

    #[test]
    fn a_picture_with_a_nan_is_not_written() {
        let film = Film::from_pixels(1, 1, vec![[f32::NAN, 0.0, 0.0]]);
        for format in [PictureFormat::Png, PictureFormat::Exr, PictureFormat::Hdr] {
            let mut bytes = Vec::new();
            assert!(film.encode(&mut bytes, format, Exposure::of_white(1.0)).is_err());
            assert!(bytes.is_empty());
        }
    }
}
