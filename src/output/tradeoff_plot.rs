//! The chart of speed against accuracy: error over seconds, both logarithmic.

use plotters::{
    element::{Circle, Cross, EmptyElement, PathElement, Polygon, Rectangle, Text},
    prelude::{IntoDrawingArea, SVGBackend},
    series::{DashedLineSeries, LineSeries},
    style::{Color, RGBColor, ShapeStyle, WHITE},
};

use super::plot::{Area, Axis, Chart, Drawn, FONT, GREY, TEXT, Words, chart, printable, text_style};
use crate::{
    accuracy::tradeoff::{Point, Series, Tradeoff},
    solve::Solver,
};

const WIDTH: u32 = 1000;
const CHARTS: u32 = 430;
const HEADER: u32 = 84;
const LEGEND_LINE: u32 = 20;
/// Where the second chart begins.
const MIDDLE: u32 = 640;
/// Colours of Okabe and Ito's palette, which colour-blind people can distinguish.
const LINES: [RGBColor; 3] = [RGBColor(86, 180, 233), RGBColor(0, 114, 178), RGBColor(0, 51, 90)];
const PATH: RGBColor = RGBColor(213, 94, 0);
const PRESET: RGBColor = RGBColor(204, 121, 167);
const ESTIMATOR: RGBColor = RGBColor(51, 51, 51);
const BAND: RGBColor = RGBColor(238, 238, 238);
const SOLVERS: [(Solver, RGBColor); 5] = [
    (Solver::ConjugateGradient, RGBColor(0, 114, 178)),
    (Solver::GaussSeidel, RGBColor(0, 158, 115)),
    (Solver::Jacobi, RGBColor(230, 159, 0)),
    (Solver::Southwell, RGBColor(204, 121, 167)),
    (Solver::Direct, RGBColor(51, 51, 51)),
];

/// The look of a point.
#[derive(Clone, Copy, PartialEq)]
enum Mark {
    Dot,
    Ring,
    Diamond,
    Cross,
    /// A line with a dot, for the legend only.
    Line,
    /// A dotted line, for the legend only.
    Dotted,
}

/// The entries of a legend.
type Legend = Vec<(RGBColor, Mark, String)>;

/// The drawing as SVG.
///
/// The left chart shows the error over the time of everything: a line for each patch size, path tracing, the presets
/// and the estimators. The right chart shows the error over the time of the solver alone.
pub fn svg(file: &str, tradeoff: &Tradeoff) -> String {
    let of_solver = |p: &&Point| p.series == Series::Solver;
    let (right, left): (Vec<&Point>, Vec<&Point>) = tradeoff.points.iter().partition(of_solver);
    let legends = [legend(&left), solver_legend(&right)];
    let lines = legends.iter().map(Vec::len).max().unwrap_or(0) as u32;
    let height = HEADER + CHARTS + LEGEND_LINE * (lines + 1);
    let mut out = String::new();
    let root = SVGBackend::with_string(&mut out, (WIDTH, height)).into_drawing_area();
    draw(&root, file, tradeoff, [&left, &right], legends).expect("drawing into memory does not fail");
    drop(root);
    out
}

fn draw(
    root: &Area,
    file: &str,
    tradeoff: &Tradeoff,
    [left, right]: [&[&Point]; 2],
    legends: [Legend; 2],
) -> Drawn {
    root.fill(&WHITE)?;
    let known = tradeoff.reference.error();
    let estimated = left.iter().filter(|p| line_of(p).is_some()).map(|p| p.estimated());
    let y = Axis::over(tradeoff.points.iter().map(|p| p.error).chain(estimated).chain([known]));
    heading(root, file, tradeoff, right)?;
    let (_, below) = root.split_vertically(HEADER);
    let (charts, keys) = below.split_vertically(CHARTS);
    let (main_area, side_area) = charts.split_horizontally(MIDDLE);

    let x = Axis::over(left.iter().map(|p| p.seconds.total()));
    let names = ["seconds: casting, solving and error bars", "true error"];
    let mut main = chart(&main_area, [x, y], names, (" %", 100.0))?;
    band(&mut main, [x, y], known)?;
    lines(&mut main, left)?;
    variants(&mut main, &main_area, left)?;

    let x = Axis::over(right.iter().map(|p| p.seconds.solving));
    let mut side = chart(&side_area, [x, y], ["seconds: solving alone", ""], (" %", 100.0))?;
    band(&mut side, [x, y], known)?;
    for (solver, colour) in SOLVERS {
        let of_solver = right.iter().filter(|p| p.solver == Some(solver));
        let places: Vec<(f64, f64)> = of_solver.filter_map(|p| place(p.seconds.solving, p.error)).collect();
        side.draw_series(LineSeries::new(places.iter().copied(), colour.stroke_width(2)))?;
        places.iter().try_for_each(|&at| mark(&mut side, at, colour, Mark::Dot))?;
    }
    let (main_key, side_key) = keys.split_horizontally(MIDDLE);
    key(&main_key, &legends[0])?;
    key(&side_key, &legends[1])?;
    root.present()?;
    Ok(())
}

fn heading(root: &Area, file: &str, tradeoff: &Tradeoff, right: &[&Point]) -> Drawn {
    let line = |text: String, (x, y): (i32, i32), size: f64| -> Drawn {
        root.draw(&Text::new(text, (x, y), text_style(size, TEXT)))?;
        Ok(())
    };
    line(printable(&format!("Speed against accuracy: {file}")), (20, 10), 20.0)?;
    let reference = &tradeoff.reference;
    let against = format!(
        "Relative area-weighted RMS error of the irradiance of {} patches, against two references of {} patches with {:.0} rays \
         each",
        tradeoff.common_patches, reference.patches, reference.rays
    );
    line(against, (20, 38), FONT)?;
    line("Patch size, rays, estimator; path tracing".into(), (82, 64), FONT)?;
    if let (Some(first), Some(least)) = (right.first(), right.iter().map(|p| p.tolerance).reduce(f64::min)) {
        let text = format!("Solvers, tolerances {:.0e} to {least:.0e}", first.tolerance);
        line(text, (MIDDLE as i32 + 82, 64), FONT)?;
    }
    Ok(())
}

fn line_of(point: &Point) -> Option<usize> {
    match point.series {
        Series::Rays(line) => Some(line),
        _ => None,
    }
}

/// The position of a point; `None` if a value is not positive and so has no place on a logarithmic axis.
fn place(x: f64, y: f64) -> Option<(f64, f64)> {
    (x > 0.0 && y > 0.0).then_some((x, y))
}

/// Shades the errors that are smaller than the error of the reference.
fn band(chart: &mut Chart, [x, y]: [Axis; 2], known: f64) -> Drawn {
    if known > y.low {
        let top = known.min(y.high);
        chart.draw_series([Rectangle::new([(x.low, y.low), (x.high, top)], BAND.filled())])?;
        let text = format!("below the error of the reference, {:.2} %", 100.0 * known);
        let beside = EmptyElement::at((x.low, top)) + Text::new(text, (6, 4), text_style(11.0, GREY));
        chart.draw_series([beside])?;
    }
    Ok(())
}

/// The lines of patch sizes and of path tracing. Dotted lines show the estimated errors.
fn lines(chart: &mut Chart, left: &[&Point]) -> Drawn {
    let of_line =
        |line: usize| -> Vec<&Point> { left.iter().copied().filter(|p| line_of(p) == Some(line)).collect() };
    let paths: Vec<&Point> = left.iter().copied().filter(|p| p.series == Series::PathTracing).collect();
    let all = LINES.iter().enumerate().map(|(line, colour)| (*colour, of_line(line))).chain([(PATH, paths)]);
    for (colour, points) in all {
        let places = |error: fn(&Point) -> f64| {
            points.iter().filter_map(move |p| place(p.seconds.total(), error(p))).collect::<Vec<_>>()
        };
        chart.draw_series(DashedLineSeries::new(places(Point::estimated), 2, 4, colour.stroke_width(2)))?;
        chart.draw_series(LineSeries::new(places(|p| p.error), colour.stroke_width(2)))?;
        for p in &points {
            if let Some(at) = place(p.seconds.total(), p.error) {
                mark(chart, at, colour, if p.believed { Mark::Dot } else { Mark::Ring })?;
            }
        }
    }
    Ok(())
}

/// Presets and estimators, with their names beside them.
fn variants(chart: &mut Chart, area: &Area, left: &[&Point]) -> Drawn {
    let mut words = Words::default();
    let pixel = |chart: &Chart, at: &(f64, f64)| {
        let (x, y) = chart.plotting_area().map_coordinate(at);
        let (left, top) = area.get_base_pixel();
        (x - left, y - top)
    };
    for p in left {
        if let Some(at) = place(p.seconds.total(), p.error) {
            words.keep_off(pixel(chart, &at), 6.0);
        }
    }
    let mut letters = 'a'..='z';
    for p in left {
        let (colour, kind, word) = match p.series {
            Series::Preset(name) => (PRESET, Mark::Diamond, name.to_uppercase()),
            Series::Estimator(_) => (ESTIMATOR, Mark::Cross, letters.next().unwrap_or('z').to_string()),
            _ => continue,
        };
        if let Some(at) = place(p.seconds.total(), p.error) {
            mark(chart, at, colour, kind)?;
            let corner = words.place(&word, pixel(chart, &at), f64::from(area.dim_in_pixel().0));
            area.draw(&Text::new(word, corner, text_style(FONT, colour)))?;
        }
    }
    Ok(())
}

fn mark(chart: &mut Chart, at: (f64, f64), colour: RGBColor, kind: Mark) -> Drawn {
    let filled = colour.filled();
    match kind {
        Mark::Cross => {
            chart.draw_series([Cross::new(at, 5, colour.stroke_width(2))])?;
        }
        Mark::Diamond => {
            let shape = [(0, -7), (7, 0), (0, 7), (-7, 0)];
            chart.draw_series([EmptyElement::at(at) + Polygon::new(shape.to_vec(), filled)])?;
        }
        Mark::Ring => {
            let ring = EmptyElement::at(at)
                + Circle::new((0, 0), 4, WHITE.filled())
                + Circle::new((0, 0), 4, colour);
            chart.draw_series([ring])?;
        }
        Mark::Dot | Mark::Line | Mark::Dotted => {
            chart.draw_series([Circle::new(at, 3, filled)])?;
        }
    }
    Ok(())
}

fn legend(left: &[&Point]) -> Legend {
    let mut legend = Vec::new();
    for (line, colour) in LINES.iter().enumerate() {
        let points: Vec<&&Point> = left.iter().filter(|p| line_of(p) == Some(line)).collect();
        if let (Some(first), Some(most)) = (points.first(), points.last()) {
            let rays = format!("{:.0} to {:.0}", first.rays, most.rays);
            let text =
                format!("{} patches, {rays} rays each, up to {:.1} MiB", most.patches, mebibytes(most));
            legend.push((*colour, Mark::Line, text));
        }
    }
    let paths: Vec<&&Point> = left.iter().filter(|p| p.series == Series::PathTracing).collect();
    if let (Some(first), Some(last)) = (paths.first(), paths.last()) {
        let text =
            format!("path tracing with next event, {:.0} to {:.0} paths per patch", first.rays, last.rays);
        legend.push((PATH, Mark::Line, text));
    }
    legend.push((GREY, Mark::Dotted, "the same, with the estimated error".into()));
    let mut letters = 'a'..='z';
    for p in left {
        match p.series {
            Series::Preset(name) => {
                let mib = mebibytes(p);
                let text = format!(
                    "preset {}: {} patches, {:.0} rays, {mib:.1} MiB",
                    name.to_uppercase(),
                    p.patches,
                    p.rays
                );
                legend.push((PRESET, Mark::Diamond, text));
            }
            Series::Estimator(name) => {
                let letter = letters.next().unwrap_or('z');
                let text = format!("{letter}: {name}, {} patches, {:.0} rays", p.patches, p.rays);
                legend.push((ESTIMATOR, Mark::Cross, text));
            }
            _ => {}
        }
    }
    legend
}

fn solver_legend(right: &[&Point]) -> Legend {
    let there = SOLVERS.into_iter().filter(|(solver, _)| right.iter().any(|p| p.solver == Some(*solver)));
    there.map(|(solver, colour)| (colour, Mark::Line, solver.name().to_owned())).collect()
}

fn mebibytes(point: &Point) -> f64 {
    point.bytes as f64 / f64::from(1 << 20)
}

/// Draws the legend.
fn key(area: &Area, legend: &Legend) -> Drawn {
    for (k, (colour, kind, text)) in legend.iter().enumerate() {
        let (x, y) = (84, (LEGEND_LINE * k as u32) as i32 + 10);
        let (filled, stroke): (ShapeStyle, ShapeStyle) = (colour.filled(), colour.stroke_width(2));
        match kind {
            Mark::Cross => area.draw(&Cross::new((x, y), 5, stroke))?,
            Mark::Diamond => {
                let shape = [(0, -7), (7, 0), (0, 7), (-7, 0)].map(|(dx, dy)| (x + dx, y + dy));
                area.draw(&Polygon::new(shape.to_vec(), filled))?;
            }
            Mark::Dotted => {
                for start in [-12, -6, 0, 6] {
                    area.draw(&PathElement::new(vec![(x + start, y), (x + start + 2, y)], stroke))?;
                }
            }
            Mark::Line | Mark::Dot | Mark::Ring => {
                area.draw(&PathElement::new(vec![(x - 12, y), (x + 12, y)], stroke))?;
                area.draw(&Circle::new((x, y), 3, filled))?;
            }
        }
        area.draw(&Text::new(printable(text), (x + 20, y - 8), text_style(FONT, TEXT)))?;
    }
    Ok(())
}
