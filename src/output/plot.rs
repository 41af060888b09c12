//! Charts with logarithmic axes as SVG, drawn by [plotters](https://docs.rs/plotters).

use plotters::{
    chart::{ChartBuilder, ChartContext},
    coord::{
        Shift,
        cartesian::Cartesian2d,
        combinators::{BindKeyPoints, IntoLogRange, LogCoord, WithKeyPoints},
    },
    drawing::DrawingArea,
    prelude::SVGBackend,
    style::{IntoFont, RGBColor, TextStyle},
};

/// A part of the drawing.
pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
/// A chart with two logarithmic axes.
pub(super) type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<Log, Log>>;
type Log = WithKeyPoints<LogCoord<f64>>;
/// The error of drawing. Drawing into memory does not fail.
pub(super) type Drawn = Result<(), Box<dyn std::error::Error>>;

pub(super) const TEXT: RGBColor = RGBColor(34, 34, 34);
pub(super) const GREY: RGBColor = RGBColor(119, 119, 119);
const GRID: RGBColor = RGBColor(204, 204, 204);
pub(super) const FONT: f64 = 14.0;
/// Least distance of two labels on an axis, in pixels.
const LABEL: f64 = 48.0;
/// Width of a letter in pixels at font size [`FONT`].
const LETTER: f64 = 7.5;

/// A logarithmic axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Axis {
    pub low: f64,
    pub high: f64,
}

impl Axis {
    /// An axis over all positive values, with a margin; over one decade if there is no such value.
    pub fn over(values: impl Iterator<Item = f64>) -> Axis {
        let (mut low, mut high) = (f64::INFINITY, 0f64);
        for value in values.filter(|v| *v > 0.0 && v.is_finite()) {
            (low, high) = (low.min(value), high.max(value));
        }
        if !(low <= high) {
            (low, high) = (0.01, 0.1);
        }
        Axis { low: low / 1.6, high: high * 1.6 }
    }

    /// The values that get a line and a label: powers of ten. If there is room, 2 and 5 times these too; if there is
    /// little room, only every few decades. `pixels` is the length of the axis.
    fn ticks(&self, pixels: f64) -> Vec<f64> {
        let decade = pixels / (self.high / self.low).log10();
        let digits: &[f64] = if 0.22 * decade > LABEL { &[1.0, 2.0, 5.0] } else { &[1.0] };
        let every = (LABEL / decade).ceil().max(1.0) as i32;
        let decades = self.low.log10().floor() as i32..=self.high.log10().ceil() as i32;
        let values =
            decades.filter(|d| d % every == 0).flat_map(|d| digits.iter().map(move |x| of_digit(*x, d)));
        values.filter(|value| (self.low..=self.high).contains(value)).collect()
    }

    fn coordinates(&self, pixels: f64) -> Log {
        (self.low..self.high).log_scale().with_key_points(self.ticks(pixels))
    }
}

/// A digit times a power of ten. For negative powers it divides, so that 0.3 is the double that prints as 0.3.
fn of_digit(digit: f64, decade: i32) -> f64 {
    let power = 10f64.powi(decade.abs());
    if decade < 0 { digit / power } else { digit * power }
}

/// The label of a value with one significant digit: 0.02, 1, 50, then 10³, 2·10⁴.
pub(super) fn label(value: f64) -> String {
    let text = format!("{value:.0e}");
    let (digit, power) = text.split_once('e').unwrap_or((&text, "0"));
    match power.parse::<i32>() {
        Ok(power) if !(-3..3).contains(&power) => {
            let raised: String = power.to_string().chars().map(superscript).collect();
            if digit == "1" { format!("10{raised}") } else { format!("{digit}·10{raised}") }
        }
        _ => text.parse::<f64>().map_or(text.clone(), |x| x.to_string()),
    }
}

fn superscript(c: char) -> char {
    const DIGITS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    c.to_digit(10).map_or('⁻', |digit| DIGITS[digit as usize])
}

/// The style of text.
pub(super) fn text_style(size: f64, colour: RGBColor) -> TextStyle<'static> {
    ("sans-serif", size).into_font().color(&colour)
}

/// A chart with a grid and labels. Labels of the vertical axis are multiplied by `factor` and followed by `unit`.
pub(super) fn chart<'a, 'b>(
    area: &'a Area<'b>,
    [x, y]: [Axis; 2],
    [x_name, y_name]: [&str; 2],
    (unit, factor): (&str, f64),
) -> Result<Chart<'a, 'b>, Box<dyn std::error::Error>> {
    let (width, height) = area.dim_in_pixel();
    let mut chart =
        ChartBuilder::on(area).margin(8).x_label_area_size(44).y_label_area_size(74).build_cartesian_2d(
            x.coordinates(f64::from(width) - 90.0),
            y.coordinates(f64::from(height) - 60.0),
        )?;
    chart
        .configure_mesh()
        .bold_line_style(GRID)
        .light_line_style(plotters::style::TRANSPARENT)
        .axis_style(GREY)
        .x_desc(x_name)
        .y_desc(y_name)
        .axis_desc_style(text_style(FONT, TEXT))
        .label_style(text_style(FONT, TEXT))
        .x_label_formatter(&|value| label(*value))
        .y_label_formatter(&|value| format!("{}{unit}", label(of_label(*value * factor))))
        .draw()?;
    Ok(chart)
}

/// A value with one significant digit, without the rounding error of a factor of ten.
fn of_label(value: f64) -> f64 {
    format!("{value:.0e}").parse().unwrap_or(value)
}

/// Places words beside marks so that no word covers another word or a mark.
#[derive(Debug, Default)]
pub(super) struct Words {
    /// Boxes that are taken: left, top, right, bottom in pixels.
    taken: Vec<[f64; 4]>,
}

impl Words {
    /// Reserves the space of a mark, so that no word covers it.
    pub fn keep_off(&mut self, (x, y): (i32, i32), radius: f64) {
        let (x, y) = (f64::from(x), f64::from(y));
        self.taken.push([x - radius, y - radius, x + radius, y + radius]);
    }

    /// The upper left corner for a word beside a mark, within the width of the drawing.
    pub fn place(&mut self, word: &str, (x, y): (i32, i32), width: f64) -> (i32, i32) {
        let size = [LETTER * word.chars().count() as f64, FONT];
        let (x, y) = (f64::from(x), f64::from(y));
        // Tries near places first. At each distance: to the right, to the left, above and below.
        let offsets = (1..12).flat_map(|ring| {
            let far = 9.0 * f64::from(ring);
            let half = [0.5 * size[0], 0.5 * size[1]];
            let (left, up) = (-far - size[0], -far - size[1]);
            [
                (far, up),
                (far, far - size[1]),
                (left, up),
                (left, far - size[1]),
                (-half[0], up),
                (-half[0], far),
            ]
        });
        let boxes = offsets.map(|(dx, dy)| [x + dx, y + dy, x + dx + size[0], y + dy + size[1]]);
        let is_free = |b: &[f64; 4]| {
            let meets = |t: &[f64; 4]| b[0] < t[2] && t[0] < b[2] && b[1] < t[3] && t[1] < b[3];
            b[0] >= 0.0 && b[2] <= width && b[1] >= 0.0 && !self.taken.iter().any(meets)
        };
        let chosen = boxes.clone().find(is_free).or_else(|| boxes.clone().next());
        let chosen = chosen.unwrap_or([x, y, x + size[0], y + size[1]]);
        self.taken.push(chosen);
        (chosen[0].round() as i32, chosen[1].round() as i32)
    }
}

/// The text without control characters, which XML cannot hold. Plotters escapes the rest.
pub(super) fn printable(text: &str) -> String {
    let is_bad = |c: char| c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}');
    text.chars().map(|c| if is_bad(c) { '\u{fffd}' } else { c }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_read_as_people_write_them() {
        for (value, text) in [
            (0.001, "0.001"),
            (0.3, "0.3"),
            (1.0, "1"),
            (200.0, "200"),
            (1e3, "10³"),
            (2e6, "2·10⁶"),
            (1e-4, "10⁻⁴"),
        ] {
            assert_eq!(label(value), text);
        }
    }

    #[test]
    fn labels_of_an_axis_are_apart_and_there_are_two() {
        for decades in [0.5, 1.0, 2.0, 4.0, 9.0, 40.0] {
            for pixels in [250.0, 600.0] {
                let axis = Axis { low: 0.013, high: 0.013 * 10f64.powf(decades) };
                let ticks = axis.ticks(pixels);
                let place = |v: &f64| pixels * (v / axis.low).log10() / decades;
                assert!(
                    ticks.windows(2).all(|t| place(&t[1]) - place(&t[0]) >= 0.99 * LABEL),
                    "{decades} {ticks:?}"
                );
                assert!(decades < 1.0 || !ticks.is_empty(), "{decades}: {ticks:?}");
            }
        }
    }

    #[test]
    fn words_cover_neither_marks_nor_each_other() {
        let mut words = Words::default();
        let marks = [(100, 100), (104, 102), (98, 99), (590, 100)];
        marks.iter().for_each(|&mark| words.keep_off(mark, 4.0));
        for mark in marks {
            words.place("MEDIUM", mark, 600.0);
        }
        for (i, a) in words.taken.iter().enumerate().skip(marks.len()) {
            for b in &words.taken[..i] {
                assert!(!(a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3]), "{a:?} {b:?}");
            }
            assert!(a[0] >= 0.0 && a[2] <= 600.0);
        }
    }
}
