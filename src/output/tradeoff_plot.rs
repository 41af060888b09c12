//! Speed against accuracy as a drawing: error over seconds, both logarithmic.

use std::fmt::Write;

use crate::{
    accuracy::tradeoff::{Point, Series, Tradeoff},
    solve::Solver,
};

const WIDTH: f64 = 1000.0;
const TOP: f64 = 84.0;
const BOTTOM: f64 = 450.0;
const LEGEND: f64 = 520.0;
const LEGEND_LINE: f64 = 19.0;
/// From Okabe and Ito's palette, which the colour-blind can tell apart.
const LINES: [&str; 3] = ["#56b4e9", "#0072b2", "#00335a"];
const PATH: &str = "#d55e00";
const PRESET: &str = "#cc79a7";
const ESTIMATOR: &str = "#333333";
const SOLVERS: [(Solver, &str); 5] = [
    (Solver::ConjugateGradient, "#0072b2"),
    (Solver::GaussSeidel, "#009e73"),
    (Solver::Jacobi, "#e69f00"),
    (Solver::Southwell, "#cc79a7"),
    (Solver::Direct, "#333333"),
];

/// A logarithmic axis: values from `low` to `high` on pixels from `start` to `end`.
struct Axis {
    low: f64,
    high: f64,
    start: f64,
    end: f64,
}

impl Axis {
    /// With room for all positive values; a decade where there is none.
    fn over(values: impl Iterator<Item = f64>, start: f64, end: f64) -> Axis {
        let (mut low, mut high) = (f64::INFINITY, 0f64);
        for value in values.filter(|v| *v > 0.0 && v.is_finite()) {
            (low, high) = (low.min(value), high.max(value));
        }
        if !(low <= high) {
            (low, high) = (0.01, 0.1);
        }
        Axis { low: low / 1.4, high: high * 1.4, start, end }
    }

    fn at(&self, value: f64) -> f64 {
        self.start + (self.end - self.start) * (value / self.low).ln() / (self.high / self.low).ln()
    }

    /// Where lines are drawn, and whether they get a number.
    fn ticks(&self) -> Vec<(f64, bool)> {
        let decade_length = (self.end - self.start).abs() / (self.high / self.low).log10();
        // Numbers at 1, 2 and 5 where there is room for them; at every few decades where there is little.
        let between = decade_length > 120.0;
        let every = (40.0 / decade_length).ceil() as i32;
        let mut ticks = Vec::new();
        for decade in self.low.log10().floor() as i32..=self.high.log10().ceil() as i32 {
            for digit in 1..10 {
                // Divided by a whole power, so that 0.3 is the double that prints as 0.3.
                let power = 10f64.powi(decade.abs());
                let value = if decade < 0 { f64::from(digit) / power } else { f64::from(digit) * power };
                let numbered = match digit {
                    1 => decade % every == 0,
                    2 | 5 => between,
                    _ => false,
                };
                if (self.low..=self.high).contains(&value) && (digit == 1 || every == 1) {
                    ticks.push((value, numbered));
                }
            }
        }
        ticks
    }
}

/// One field of the drawing.
struct Panel {
    x: Axis,
    y: Axis,
}

/// The drawing as SVG.
///
/// On the left error over all seconds: a line a patch size, path tracing, the presets and the estimators. On the right error
/// over the seconds of the solver alone.
pub fn svg(file: &str, tradeoff: &Tradeoff) -> String {
    let (mut legend, mut body) = (Vec::new(), String::new());
    let of_solver = |p: &&Point| p.series == Series::Solver;
    let (right, left): (Vec<&Point>, Vec<&Point>) = tradeoff.points.iter().partition(of_solver);
    let known = tradeoff.reference.error();
    let errors = || {
        let told = left.iter().filter(|p| line_of(p).is_some()).map(|p| p.estimated());
        tradeoff.points.iter().map(|p| p.error).chain(told).chain([known])
    };
    let y = || Axis::over(errors(), BOTTOM, TOP);
    let main = Panel { x: Axis::over(left.iter().map(|p| p.seconds.total()), 78.0, 640.0), y: y() };
    let side = Panel { x: Axis::over(right.iter().map(|p| p.seconds.solving), 712.0, 980.0), y: y() };
    main.frame(&mut body, "seconds: casting, solving and error bars", known);
    side.frame(&mut body, "seconds: solving alone", known);

    for (line, colour) in LINES.iter().enumerate() {
        let points: Vec<&Point> = left.iter().copied().filter(|p| line_of(p) == Some(line)).collect();
        let Some(most) = points.last() else { continue };
        main.line(&mut body, &points, colour);
        let mib = most.bytes as f64 / f64::from(1 << 20);
        let rays = format!("{:.0} to {:.0}", points[0].rays, most.rays);
        let text = format!("{} patches, {rays} rays each, up to {mib:.1} MiB", most.patches);
        legend.push((*colour, "line", text));
    }
    let paths: Vec<&Point> = left.iter().copied().filter(|p| p.series == Series::PathTracing).collect();
    if let (Some(first), Some(last)) = (paths.first(), paths.last()) {
        main.line(&mut body, &paths, PATH);
        let text =
            format!("path tracing with next event, {:.0} to {:.0} paths a patch", first.rays, last.rays);
        legend.push((PATH, "line", text));
    }
    legend.push(("#777777", "dotted", "the same with the error that the solution itself estimates".into()));
    let mut letters = 'a'..='z';
    for p in &left {
        let (x, y) = (p.seconds.total(), p.error);
        match p.series {
            Series::Preset(name) => {
                main.mark(&mut body, x, y, PRESET, "diamond", &name.to_uppercase());
                let mib = p.bytes as f64 / f64::from(1 << 20);
                let text = format!(
                    "preset {}: {} patches, {:.0} rays, {mib:.1} MiB",
                    name.to_uppercase(),
                    p.patches,
                    p.rays
                );
                legend.push((PRESET, "diamond", text));
            }
            Series::Estimator(name) => {
                let letter = letters.next().unwrap_or('z').to_string();
                main.mark(&mut body, x, y, ESTIMATOR, "cross", &letter);
                legend.push((
                    ESTIMATOR,
                    "cross",
                    format!("{letter}: {name}, {} patches, {:.0} rays", p.patches, p.rays),
                ));
            }
            _ => {}
        }
    }
    let mut solvers = Vec::new();
    for (solver, colour) in SOLVERS {
        let points: Vec<&Point> = right.iter().copied().filter(|p| p.solver == Some(solver)).collect();
        if !points.is_empty() {
            side.polyline(&mut body, points.iter().map(|p| (p.seconds.solving, p.error)), colour, "");
            points.iter().for_each(|p| side.mark(&mut body, p.seconds.solving, p.error, colour, "dot", ""));
            solvers.push((colour, "line", solver.name().to_owned()));
        }
    }
    key(&mut body, 60.0, &legend);
    key(&mut body, 712.0, &solvers);
    let height = LEGEND + LEGEND_LINE * legend.len().max(solvers.len()) as f64 + 8.0;
    let tolerances = match (right.first(), right.iter().map(|p| p.tolerance).reduce(f64::min)) {
        (Some(first), Some(least)) => format!("Solvers, tolerances {:.0e} to {least:.0e}", first.tolerance),
        _ => String::new(),
    };
    let title = format!("Speed against accuracy: {}", escaped(file));
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" width=\"{WIDTH}\" height=\"{height}\" \
         font-family=\"Helvetica, Arial, sans-serif\" font-size=\"12\" fill=\"#222222\" role=\"img\">\n\
         <title>{title}</title>\n<rect width=\"{WIDTH}\" height=\"{height}\" fill=\"white\"/>\n\
         <text x=\"20\" y=\"28\" font-size=\"18\">{title}</text>\n\
         <text x=\"20\" y=\"50\">Error: RMS of the mean irradiance of {} patches, by area, relative to their mean; against {} \
         patches with {:.0} rays each, twice</text>\n\
         <text x=\"78\" y=\"76\" font-weight=\"bold\">Patch size, rays, estimator; path tracing</text>\n\
         <text x=\"712\" y=\"76\" font-weight=\"bold\">{tolerances}</text>\n\
         <text transform=\"translate(22 {}) rotate(-90)\" text-anchor=\"middle\">true error</text>\n{body}</svg>\n",
        tradeoff.common_patches,
        tradeoff.reference.patches,
        tradeoff.reference.rays,
        0.5 * (TOP + BOTTOM)
    )
}

fn line_of(point: &Point) -> Option<usize> {
    match point.series {
        Series::Rays(line) => Some(line),
        _ => None,
    }
}

impl Panel {
    /// Grid, numbers, and the errors that the reference cannot tell.
    fn frame(&self, out: &mut String, label: &str, known: f64) {
        let Panel { x, y } = self;
        if known > y.low {
            let top = y.at(known.min(y.high));
            let (width, height) = (x.end - x.start, y.start - top);
            let _ = writeln!(
                out,
                "<rect x=\"{:.1}\" y=\"{top:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"#eeeeee\"/>",
                x.start
            );
            if height > 14.0 {
                let _ = writeln!(
                    out,
                    "<text x=\"{:.1}\" y=\"{:.1}\" fill=\"#777777\" font-size=\"10\">below the reference&#39;s own error, {:.2} %</text>",
                    x.start + 5.0,
                    top + 12.0,
                    100.0 * known
                );
            }
        }
        let rule = |out: &mut String, [x1, y1, x2, y2]: [f64; 4], numbered: bool| {
            let colour = if numbered { "#cccccc" } else { "#ececec" };
            let _ = writeln!(
                out,
                "<line x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\" stroke=\"{colour}\"/>"
            );
        };
        for (value, numbered) in x.ticks() {
            let at = x.at(value);
            rule(out, [at, y.start, at, y.end], numbered);
            if numbered {
                let below = y.start + 16.0;
                let _ = writeln!(
                    out,
                    "<text x=\"{at:.1}\" y=\"{below:.1}\" text-anchor=\"middle\">{}</text>",
                    plain(value)
                );
            }
        }
        for (value, numbered) in y.ticks() {
            let at = y.at(value);
            rule(out, [x.start, at, x.end, at], numbered);
            if numbered {
                let (left, percent) = (x.start - 6.0, plain(100.0 * value));
                let _ = writeln!(
                    out,
                    "<text x=\"{left:.1}\" y=\"{:.1}\" text-anchor=\"end\">{percent} %</text>",
                    at + 4.0
                );
            }
        }
        let _ = writeln!(
            out,
            "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"none\" stroke=\"#888888\"/>\n\
             <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{label}</text>",
            x.start,
            y.end,
            x.end - x.start,
            y.start - y.end,
            0.5 * (x.start + x.end),
            y.start + 36.0
        );
    }

    /// True errors with dots, and the estimated ones dotted.
    fn line(&self, out: &mut String, points: &[&Point], colour: &str) {
        let estimated = points.iter().map(|p| (p.seconds.total(), p.estimated()));
        self.polyline(out, estimated, colour, " stroke-dasharray=\"1.5 3.5\"");
        self.polyline(out, points.iter().map(|p| (p.seconds.total(), p.error)), colour, "");
        for p in points {
            let kind = if p.believed { "dot" } else { "ring" };
            self.mark(out, p.seconds.total(), p.error, colour, kind, "");
        }
    }

    fn polyline(
        &self,
        out: &mut String,
        points: impl Iterator<Item = (f64, f64)>,
        colour: &str,
        dashes: &str,
    ) {
        let places: Vec<String> = points
            .filter(|&(x, y)| x > 0.0 && y > 0.0)
            .map(|(x, y)| format!("{:.1},{:.1}", self.x.at(x), self.y.at(y)))
            .collect();
        let _ = writeln!(
            out,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.8\"{dashes}/>",
            places.join(" ")
        );
    }

    /// A mark with a word beside it. What is zero has no place on a logarithmic axis.
    fn mark(&self, out: &mut String, x: f64, y: f64, colour: &str, kind: &str, word: &str) {
        if x > 0.0 && y > 0.0 {
            let (x, y) = (self.x.at(x), self.y.at(y));
            symbol(out, x, y, colour, kind);
            if !word.is_empty() {
                // Below and to the left where there is no room to the right.
                let narrow = x + 9.0 * word.len() as f64 + 12.0 > self.x.end;
                let (x, y, anchor) = if narrow { (x, y + 20.0, "end") } else { (x + 9.0, y - 7.0, "start") };
                let _ = writeln!(
                    out,
                    "<text x=\"{x:.1}\" y=\"{y:.1}\" fill=\"{colour}\" font-weight=\"bold\" text-anchor=\"{anchor}\">{word}</text>"
                );
            }
        }
    }
}

fn symbol(out: &mut String, x: f64, y: f64, colour: &str, kind: &str) {
    let place = format!("<g transform=\"translate({x:.1} {y:.1})\"");
    let _ = match kind {
        "diamond" => {
            writeln!(out, "{place} fill=\"{colour}\" stroke=\"white\"><path d=\"M0-8 8 0 0 8-8 0Z\"/></g>")
        }
        "cross" => writeln!(
            out,
            "{place} stroke=\"{colour}\" stroke-width=\"2\"><path d=\"M-4-4 4 4M-4 4 4-4\"/></g>"
        ),
        "ring" => writeln!(
            out,
            "{place} fill=\"white\" stroke=\"{colour}\" stroke-width=\"1.5\"><circle r=\"4\"/></g>"
        ),
        "dot" => writeln!(out, "{place} fill=\"{colour}\"><circle r=\"3.5\"/></g>"),
        "dotted" => writeln!(
            out,
            "{place} stroke=\"{colour}\" stroke-width=\"1.8\" stroke-dasharray=\"1.5 3.5\"><path d=\"M-12 0H12\"/></g>"
        ),
        _ => writeln!(
            out,
            "{place} fill=\"{colour}\" stroke=\"{colour}\" stroke-width=\"1.8\"><path d=\"M-12 0H12\"/><circle r=\"3\"/></g>"
        ),
    };
}

/// A number of one digit as people write it.
fn plain(value: f64) -> String {
    let digit = format!("{value:.0e}");
    if (1e-4..1e5).contains(&value) { digit.parse().map_or(digit, |x: f64| x.to_string()) } else { digit }
}

/// What the marks mean.
fn key(out: &mut String, x: f64, entries: &[(&str, &str, String)]) {
    for (k, (colour, kind, text)) in entries.iter().enumerate() {
        let y = LEGEND + LEGEND_LINE * k as f64;
        symbol(out, x + 12.0, y - 4.0, colour, kind);
        let _ = writeln!(out, "<text x=\"{:.1}\" y=\"{y:.1}\">{}</text>", x + 32.0, escaped(text));
    }
}

/// Text that XML can hold: control characters have no place in it.
fn escaped(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            c if c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}') => safe.push('\u{fffd}'),
            c => safe.push(c),
        }
    }
    safe
}
