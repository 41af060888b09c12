//! Pictures of irradiance in false colours, with a scale and isolines.

use std::io::{self, Write};

use image::{Rgb, RgbImage, codecs::png::PngEncoder};

use crate::{monte_carlo::Film, tone::luminance};

/// Colours from zero to the top of the scale: even steps of the colour map viridis (Smith and Van der Walt, 2015),
/// whose lightness grows evenly.
const COLOURS: [[u8; 3]; 9] = [
    [68, 1, 84],
    [71, 44, 122],
    [59, 81, 139],
    [44, 113, 142],
    [33, 144, 141],
    [39, 173, 129],
    [92, 200, 99],
    [170, 220, 50],
    [253, 231, 37],
];

/// Bitmaps of the scale's letters: 5 by 7 dots, row by row.
const LETTERS: [(char, [u8; 7]); 19] = [
    ('0', [0x0e, 0x11, 0x13, 0x15, 0x19, 0x11, 0x0e]),
    ('1', [0x04, 0x0c, 0x04, 0x04, 0x04, 0x04, 0x0e]),
    ('2', [0x0e, 0x11, 0x01, 0x02, 0x04, 0x08, 0x1f]),
    ('3', [0x1f, 0x02, 0x04, 0x02, 0x01, 0x11, 0x0e]),
    ('4', [0x02, 0x06, 0x0a, 0x12, 0x1f, 0x02, 0x02]),
    ('5', [0x1f, 0x10, 0x1e, 0x01, 0x01, 0x11, 0x0e]),
    ('6', [0x06, 0x08, 0x10, 0x1e, 0x11, 0x11, 0x0e]),
    ('7', [0x1f, 0x01, 0x02, 0x04, 0x08, 0x08, 0x08]),
    ('8', [0x0e, 0x11, 0x11, 0x0e, 0x11, 0x11, 0x0e]),
    ('9', [0x0e, 0x11, 0x11, 0x0f, 0x01, 0x02, 0x0c]),
    ('.', [0x00, 0x00, 0x00, 0x00, 0x00, 0x0c, 0x0c]),
    ('/', [0x00, 0x01, 0x02, 0x04, 0x08, 0x10, 0x00]),
    ('W', [0x11, 0x11, 0x11, 0x15, 0x15, 0x15, 0x0a]),
    ('m', [0x00, 0x00, 0x1a, 0x15, 0x15, 0x11, 0x11]),
    ('l', [0x0c, 0x04, 0x04, 0x04, 0x04, 0x04, 0x0e]),
    ('x', [0x00, 0x00, 0x11, 0x0a, 0x04, 0x0a, 0x11]),
    ('e', [0x00, 0x00, 0x0e, 0x11, 0x1f, 0x10, 0x0e]),
    ('-', [0x00, 0x00, 0x00, 0x1f, 0x00, 0x00, 0x00]),
    ('+', [0x00, 0x04, 0x04, 0x1f, 0x04, 0x04, 0x00]),
];

/// Width of the strip with the scale, in pixels.
const STRIP: u32 = 100;
/// Width of the bar in the strip.
const BAR: u32 = 16;
/// Width of a letter with its gap.
const LETTER: u32 = 6;
/// Distance of the bar from the top and the bottom of the picture.
const MARGIN: u32 = 20;
/// Share of the lit pixels that an automatic scale covers.
const COVERED: f64 = 0.995;
/// Approximate number of steps of the scale.
const STEPS: f64 = 6.0;

/// Options of [`draw`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct FalseColour {
    /// Irradiance at the top of the scale; `None` for an automatic scale.
    pub most: Option<f64>,
    /// Whether to draw isolines at the steps of the scale.
    pub isolines: bool,
}

setters!(FalseColour {
    with_most(most: Option<f64>),
    with_isolines(isolines: bool),
});

impl Default for FalseColour {
    /// An automatic scale with isolines.
    fn default() -> Self {
        FalseColour { most: None, isolines: true }
    }
}

/// The step of a scale from 0 to `most`: 1, 2 or 5 times a power of ten.
fn step(most: f64) -> f64 {
    let rough = most / STEPS;
    let power = 10f64.powf(rough.log10().floor());
    let digit = [1.0, 2.0, 5.0, 10.0].into_iter().find(|digit| digit * power >= rough * (1.0 - 1e-9));
    digit.unwrap_or(10.0) * power
}

fn colour(share: f64) -> Rgb<u8> {
    let at = share.clamp(0.0, 1.0) * (COLOURS.len() - 1) as f64;
    let k = (at as usize).min(COLOURS.len() - 2);
    let mix = |c: usize| {
        let (low, high) = (f64::from(COLOURS[k][c]), f64::from(COLOURS[k + 1][c]));
        (low + (high - low) * (at - k as f64)).round() as u8
    };
    Rgb([mix(0), mix(1), mix(2)])
}

/// A label of the scale: a number with up to three significant digits.
fn label(x: f64) -> String {
    match x {
        0.0 => "0".into(),
        x if !(1e-3..1e6).contains(&x) => format!("{x:.0e}"),
        x => {
            let decimals = (2.0 - x.log10().floor()).clamp(0.0, 5.0) as usize;
            let text = format!("{x:.decimals$}");
            match text.contains('.') {
                true => text.trim_end_matches('0').trim_end_matches('.').into(),
                false => text,
            }
        }
    }
}

fn write_text(image: &mut RgbImage, (left, top): (u32, u32), text: &str) {
    for (k, letter) in text.chars().enumerate() {
        let Some((_, rows)) = LETTERS.iter().find(|(known, _)| *known == letter) else { continue };
        for (row, dots) in (0..).zip(rows) {
            for column in (0..5).filter(|column| dots >> (4 - column) & 1 == 1) {
                let (x, y) = (left + LETTER * k as u32 + column, top + row);
                if x < image.width() && y < image.height() {
                    image.put_pixel(x, y, Rgb([255; 3]));
                }
            }
        }
    }
}

/// Draws a picture of irradiance in false colours, with the scale to its right. Pixels without light stay black.
pub fn draw(film: &Film, options: &FalseColour, unit: &str) -> RgbImage {
    let values: Vec<f64> = film.pixels().iter().map(|pixel| luminance(pixel.map(f64::from))).collect();
    let mut lit: Vec<f64> = values.iter().copied().filter(|&e| e > 0.0).collect();
    lit.sort_by(f64::total_cmp);
    let covered = lit.get(((lit.len() as f64 * COVERED) as usize).min(lit.len().saturating_sub(1)));
    let automatic = covered.map_or(1.0, |&most| {
        let step = step(most);
        (most / step).ceil() * step
    });
    let most = options.most.unwrap_or(automatic);
    let step = step(most);
    let (width, height) = (film.width() as u32, film.height() as u32);
    let mut image = RgbImage::new(width + STRIP, height);
    let at = |x: u32, y: u32| values[y as usize * film.width() + x as usize];
    let level = |e: f64| (e / step) as i64;
    for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
        let e = at(x, y);
        if e <= 0.0 {
            continue;
        }
        let next = [(x + 1, y), (x, y + 1)].into_iter().filter(|&(x, y)| x < width && y < height);
        let crosses = next.map(|(x, y)| at(x, y)).any(|other| other > 0.0 && level(other) != level(e));
        let drawn = if options.isolines && crosses { Rgb([255; 3]) } else { colour(e / most) };
        image.put_pixel(x, y, drawn);
    }
    let bar = height.saturating_sub(2 * MARGIN).max(1);
    let left = width + 8;
    for row in 0..bar.min(height) {
        let share = 1.0 - f64::from(row) / f64::from(bar);
        for x in left..left + BAR {
            image.put_pixel(x, (MARGIN + row).min(height - 1), colour(share));
        }
    }
    for k in 0..=(most / step + 1e-9) as u32 {
        let value = f64::from(k) * step;
        let row = MARGIN + ((1.0 - value / most) * f64::from(bar)) as u32;
        for x in left..left + BAR + 3 {
            image.put_pixel(x, row.min(height - 1), Rgb([255; 3]));
        }
        write_text(&mut image, (left + BAR + 6, row.saturating_sub(3)), &label(value));
    }
    write_text(&mut image, (left, 4), unit);
    image
}

/// Writes the picture of [`draw`] as PNG.
///
/// # Errors
/// Errors of `out`.
pub fn encode(out: &mut dyn Write, film: &Film, options: &FalseColour, unit: &str) -> io::Result<()> {
    let mut bytes = Vec::new();
    let picture = draw(film, options, unit);
    picture.write_with_encoder(PngEncoder::new(&mut bytes)).map_err(io::Error::other)?;
    out.write_all(&bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// In a ramp from 0 to 300, colours follow the map, isolines are at 50, 100, 150, ..., and dark pixels stay black.
    #[test]
    fn a_ramp_has_its_colours_and_lines() {
        let (width, height) = (301, 60);
        let pixels = (0..width * height).map(|k| [(k % width) as f32; 3]).collect();
        let film = Film::from_pixels(width, height, pixels);
        let options = FalseColour::default().with_most(Some(300.0));
        let image = draw(&film, &options, "lx");
        assert_eq!((image.width(), image.height()), (301 + STRIP, 60));
        let lines: Vec<u32> = (0..301).filter(|&x| image.get_pixel(x, 30).0 == [255; 3]).collect();
        assert_eq!(lines, [49, 99, 149, 199, 249, 299]);
        assert_eq!(image.get_pixel(0, 30).0, [0; 3]);
        assert_eq!(image.get_pixel(150, 30).0, COLOURS[4]);
        assert_eq!(image.get_pixel(300, 30).0, COLOURS[8]);
        let plain = draw(&film, &options.with_isolines(false), "lx");
        assert!((1..301).all(|x| plain.get_pixel(x, 30).0 != [255; 3]));
    }

    #[test]
    fn scales_have_round_steps() {
        assert_eq!([300.0, 1.0, 0.07].map(step), [50.0, 0.2, 0.02]);
        assert_eq!(["0", "50", "0.2", "1.25", "1500", "2e6"], [0.0, 50.0, 0.2, 1.25, 1500.0, 2e6].map(label));
    }
}
