//! Pictures: made by paths, and written to files.

use std::{
    io::{BufWriter, Write},
    path::Path,
};

use image::{DynamicImage, ImageFormat, Rgb32FImage, RgbImage};
use rayon::prelude::*;

use super::{Camera, PathTracer, Samples};
use crate::{Error, Progress, Result, trace::sampling::mix};

/// Linear radiance, W/(m² sr), row by row from the top.
#[derive(Debug, Clone, PartialEq)]
pub struct Film {
    width: usize,
    height: usize,
    pixels: Vec<[f32; 3]>,
}

/// How a picture is sampled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RenderOptions {
    /// Paths a pixel, spread over its square. Default 64; powers of two suit the sequences best.
    pub samples: u32,
    /// Everything is a function of it. Default 1.
    pub seed: u64,
}

impl Default for RenderOptions {
    fn default() -> Self {
        RenderOptions { samples: 64, seed: 1 }
    }
}

/// How radiance becomes a displayed value: times a factor, clipped at 1, sRGB transfer function. There is no other
/// curve: below white the picture is proportional to the light.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Exposure {
    /// Photographic stops brighter (or darker, below 0) than the automatic exposure. Default 0.
    ///
    /// The automatic one shows the luminance that nine tenths of the pixels with any light do not exceed as 0.8:
    /// lamps in the picture clip, what they light does not, and black surroundings do not count.
    pub stops: f64,
}

impl Film {
    /// A picture from its pixels.
    ///
    /// # Panics
    /// When the number of pixels is not `width` times `height`.
    pub fn from_pixels(width: usize, height: usize, pixels: Vec<[f32; 3]>) -> Film {
        assert_eq!(pixels.len(), width * height, "a picture has width times height pixels");
        Film { width, height, pixels }
    }

    /// Pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The pixels, row by row from the top.
    pub fn pixels(&self) -> &[[f32; 3]] {
        &self.pixels
    }

    /// Renders a picture by path tracing: each pixel is the mean radiance over its square.
    ///
    /// The numbers of a path depend on the seed, the pixel and the sample alone, so the bytes are the same for any
    /// number of threads.
    ///
    /// # Errors
    /// [`Error::Stopped`].
    pub fn render(
        paths: &PathTracer,
        camera: &Camera,
        options: &RenderOptions,
        progress: &Progress,
    ) -> Result<Film> {
        let (width, height) = (camera.width(), camera.height());
        let lens = camera.lens(paths.tracer());
        let samples = options.samples.max(1);
        let mut pixels = vec![[0.0; 3]; width * height];
        progress.begin(pixels.len() as u64 * samples as u64);
        // Short stretches keep all threads busy to the end, whatever the picture's shape.
        const STRETCH: usize = 32;
        pixels.par_chunks_mut(STRETCH).enumerate().try_for_each(|(chunk, stretch)| {
            progress.check()?;
            for (k, pixel) in stretch.iter_mut().enumerate() {
                let i = chunk * STRETCH + k;
                let seed = mix(&[options.seed, i as u64]);
                let mut sum = [0.0; 3];
                for s in 0..samples {
                    let mut numbers = Samples::new(s, seed);
                    let [x, y] = numbers.square().map(f64::from);
                    let direction = lens.direction((i % width) as f64 + x, (i / width) as f64 + y);
                    let radiance = paths.radiance(lens.eye(), direction, &mut numbers);
                    (0..3).for_each(|c| sum[c] += radiance[c]);
                }
                *pixel = sum.map(|x| (x / samples as f64) as f32);
            }
            progress.advance(stretch.len() as u64 * samples as u64);
            Ok(())
        })?;
        Ok(Film { width, height, pixels })
    }

    /// The factor by which radiance is multiplied for display.
    pub fn exposure_factor(&self, exposure: Exposure) -> f64 {
        let mut lit: Vec<f64> =
            self.pixels.iter().map(luminance).filter(|l| *l > 0.0 && l.is_finite()).collect();
        let automatic = if lit.is_empty() {
            1.0
        } else {
            let rank = (lit.len() - 1) * 9 / 10;
            0.8 / *lit.select_nth_unstable_by(rank, f64::total_cmp).1
        };
        automatic * exposure.stops.exp2()
    }

    /// The picture as eight-bit sRGB.
    pub fn to_srgb(&self, exposure: Exposure) -> Vec<[u8; 3]> {
        let factor = self.exposure_factor(exposure);
        self.pixels.iter().map(|p| p.map(|x| srgb(f64::from(x) * factor))).collect()
    }

    /// Writes the picture; the extension chooses the format: `.png` (eight bits, exposed), `.exr` or `.hdr` (linear
    /// radiance, unexposed). The file appears complete or not at all.
    ///
    /// # Errors
    /// [`Error::Usage`] for another extension or an exposure that is not finite, [`Error::Io`] when writing fails.
    ///
    /// # Panics
    /// When a pixel is negative or not finite, which no estimator here yields.
    pub fn save(&self, path: &Path, exposure: Exposure) -> Result<()> {
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        let format = match extension.as_deref() {
            Some("png") => ImageFormat::Png,
            Some("exr") => ImageFormat::OpenExr,
            Some("hdr") => ImageFormat::Hdr,
            _ => {
                return Err(Error::Usage {
                    message: format!("{}: unknown kind of picture", path.display()),
                    hint: Some("end the name in .png, .exr or .hdr".into()),
                });
            }
        };
        if !exposure.stops.is_finite() {
            return Err(Error::Usage { message: "the exposure is not a number".into(), hint: None });
        }
        assert!(
            self.pixels.iter().flatten().all(|x| x.is_finite() && *x >= 0.0),
            "a pixel is negative or not finite"
        );
        let (width, height) = (self.width as u32, self.height as u32);
        let picture = if format == ImageFormat::Png {
            RgbImage::from_raw(width, height, self.to_srgb(exposure).into_flattened()).map(DynamicImage::from)
        } else {
            Rgb32FImage::from_raw(width, height, self.pixels.as_flattened().to_vec()).map(DynamicImage::from)
        };
        replace(path, |file| {
            let mut bytes = std::io::Cursor::new(Vec::new());
            picture
                .as_ref()
                .expect("the buffer fits its size")
                .write_to(&mut bytes, format)
                .map_err(std::io::Error::other)?;
            file.write_all(bytes.get_ref())
        })
    }
}

/// Writes a file under a temporary name in the same folder and renames it when it is complete.
fn replace(path: &Path, write: impl FnOnce(&mut dyn Write) -> std::io::Result<()>) -> Result<()> {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let attempt = || {
        let mut builder = tempfile::Builder::new();
        builder.prefix(".radiosity-");
        #[cfg(unix)]
        {
            // Temporary files are private by default; a picture is as public as the umask says.
            use std::os::unix::fs::PermissionsExt;
            builder.permissions(std::fs::Permissions::from_mode(0o666));
        }
        let mut file = builder.tempfile_in(folder)?;
        {
            let mut buffered = BufWriter::new(file.as_file_mut());
            write(&mut buffered)?;
            buffered.flush()?;
        }
        file.persist(path).map(drop).map_err(|e| e.error)
    };
    attempt().map_err(|source| Error::io(path, source))
}

fn luminance(pixel: &[f32; 3]) -> f64 {
    let [r, g, b] = pixel.map(f64::from);
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

/// Transfer function of IEC 61966-2-1, clipped.
fn srgb(x: f64) -> u8 {
    let x = x.clamp(0.0, 1.0);
    let encoded = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
    (encoded * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> Film {
        Film::from_pixels(3, 2, (0..6).map(|i| [0.5 * i as f32, 0.25, 7.5]).collect())
    }

    #[test]
    fn linear_formats_keep_radiance_and_row_order() {
        let folder = tempfile::tempdir().unwrap();
        for (name, tolerance) in [("a.exr", 0.0), ("a.hdr", 0.01)] {
            let path = folder.path().join(name);
            ramp().save(&path, Exposure { stops: 3.0 }).unwrap();
            let back = image::open(&path).unwrap().to_rgb32f();
            assert_eq!(back.dimensions(), (3, 2));
            for (pixel, want) in back.pixels().zip(ramp().pixels()) {
                for c in 0..3 {
                    let allowed = tolerance * want.iter().fold(0.0f32, |a, &b| a.max(b));
                    assert!((pixel.0[c] - want[c]).abs() <= allowed, "{name} {pixel:?} {want:?}");
                }
            }
        }
    }

    #[test]
    fn png_is_exposed_and_encoded() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("grey.png");
        // 19 lit pixels of luminance 1 to 19, the last a lamp; nine tenths do not exceed 17. Black does not count.
        let mut pixels = vec![[0.0; 3]; 5];
        pixels.extend((1..=18).map(|i| [i as f32; 3]));
        pixels.push([900.0; 3]);
        let film = Film::from_pixels(12, 2, pixels);
        assert!((film.exposure_factor(Exposure::default()) - 0.8 / 17.0).abs() < 1e-12);
        film.save(&path, Exposure::default()).unwrap();
        let back = image::open(&path).unwrap().to_rgb8();
        let value = |i: u32| back.get_pixel(i % 12, i / 12).0;
        // By the standard: 255 (1.055 x^(1/2.4) - 0.055) is 231.1 for 0.8 and 61.3 for 0.8/17.
        assert_eq!([value(0), value(5), value(21), value(23)], [[0; 3], [61; 3], [231; 3], [255; 3]]);
        film.save(&path, Exposure { stops: -1.0 }).unwrap();
        // 0.4: 169.6.
        assert_eq!(image::open(&path).unwrap().to_rgb8().get_pixel(9, 1).0, [170; 3]);
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("old.png");
        std::fs::write(&path, "old").unwrap();
        let failed = replace(&path, |file| {
            file.write_all(b"half")?;
            Err(std::io::Error::other("disk full"))
        });
        assert!(failed.unwrap_err().to_string().contains("disk full"));
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        let nowhere = ramp().save(&folder.path().join("none/a.png"), Exposure::default());
        assert!(matches!(nowhere, Err(Error::Io { .. })));
        let unknown = ramp().save(&folder.path().join("a.gif"), Exposure::default()).unwrap_err();
        assert!(matches!(unknown, Error::Usage { .. }) && unknown.hint().unwrap().contains(".png"));
    }

    #[test]
    #[should_panic(expected = "not finite")]
    fn a_picture_with_a_nan_is_not_written() {
        let film = Film::from_pixels(1, 1, vec![[f32::NAN, 0.0, 0.0]]);
        let _ = film.save(&std::env::temp_dir().join("nan.exr"), Exposure::default());
    }
}
