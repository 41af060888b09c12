//! The reports that have charts as a page: speed against accuracy, validation, daylight.

use std::collections::BTreeMap;

use super::chart::{Axis, COLOURS, Chart, ChartPage, Line, Mark, Point, Series, Stroke, Verdict};
use crate::{
    accuracy::{
        comparison::Estimates,
        tradeoff::{self, Tradeoff},
        validation::Validation,
    },
    daylight::{coefficients::Place, year::Year},
    output::validation_report::ValidationReport,
    scene::Scene,
    tone::{luminance, rgb},
};

/// Points of a curve that shows a distribution; more could not be distinguished.
const STEPS: usize = 200;

fn series(
    name: impl Into<String>,
    colour: usize,
    mark: Mark,
    line: Option<Stroke>,
    points: Vec<Point>,
) -> Series {
    let colour = COLOURS[colour % COLOURS.len()].to_owned();
    Series { name: name.into(), colour, mark, line, points }
}

/// The chart of `radiosity tradeoff`.
pub fn tradeoff(file: &str, tradeoff: &Tradeoff) -> ChartPage {
    let reference = &tradeoff.reference;
    let band = Some(100.0 * reference.error());
    let of_solver = |p: &&tradeoff::Point| p.series == tradeoff::Series::Solver;
    let (solvers, others): (Vec<&tradeoff::Point>, Vec<&tradeoff::Point>) =
        tradeoff.points.iter().partition(of_solver);
    let mut notes = vec![format!(
        "Errors are RMS errors of the irradiance of {} patches, weighted by area, relative to the mean irradiance. They are against {} \
         patches with {:.0} rays each, twice. Errors in the grey band are smaller than the error of the reference.",
        tradeoff.common_patches, reference.patches, reference.rays
    )];
    notes.extend(tradeoff.left_out.iter().map(|sentence| format!("Left out: {sentence}.")));
    let chart = |title: &str, x: &str, series| Chart {
        title: title.into(),
        text: None,
        x: Axis::log(x, "s"),
        y: Axis::log("error", "%"),
        band,
        lines: Vec::new(),
        series,
    };
    ChartPage {
        title: format!("Speed against accuracy: {file}"),
        verdict: None,
        notes,
        charts: vec![
            chart("Rays, patches and estimators", "casting, solving and error bars", of_rays(&others)),
            chart("Solvers", "solving alone", of_solvers(&solvers)),
        ],
    }
}

fn of_rays(points: &[&tradeoff::Point]) -> Vec<Series> {
    use tradeoff::Series as Kind;
    let mut groups: BTreeMap<(u8, usize), Vec<&tradeoff::Point>> = BTreeMap::new();
    for p in points {
        let key = match p.series {
            Kind::Rays(line) => (0, line),
            Kind::PathTracing => (1, 0),
            Kind::Preset(_) => (2, 0),
            _ => (3, 0),
        };
        groups.entry(key).or_default().push(p);
    }
    let words = |p: &tradeoff::Point| {
        let name = match p.series {
            Kind::Preset(name) | Kind::Estimator(name) => format!("{name}: "),
            _ => String::new(),
        };
        let what = if p.series == Kind::PathTracing { "paths" } else { "rays" };
        format!(
            "{name}{} patches, {:.0} {what} each; estimated error {:.2} %; {:.1} MiB",
            p.patches,
            p.rays,
            100.0 * p.estimated(),
            p.bytes as f64 / f64::from(1 << 20)
        )
    };
    let at = |p: &tradeoff::Point, error: f64| Point {
        x: p.seconds.total(),
        y: 100.0 * error,
        text: Some(words(p)),
    };
    let mut found = Vec::new();
    for (k, (kind, points)) in groups.into_iter().enumerate() {
        let measured = points.iter().map(|p| at(p, p.error)).collect();
        let estimated = points.iter().map(|p| at(p, p.estimated())).collect();
        let most = points.iter().map(|p| p.patches).max().unwrap_or_default();
        match kind.0 {
            0 => {
                found.push(series(format!("{most} patches"), k, Mark::Dot, Some(Stroke::Solid), measured));
                let name = format!("{most} patches, estimated error");
                found.push(series(name, k, Mark::Small, Some(Stroke::Dashed), estimated));
            }
            1 => found.push(series("path tracing", k, Mark::Dot, Some(Stroke::Solid), measured)),
            2 => found.push(series("presets", k, Mark::Diamond, None, measured)),
            _ => found.push(series("estimators", k, Mark::Cross, None, measured)),
        }
    }
    found
}

fn of_solvers(points: &[&tradeoff::Point]) -> Vec<Series> {
    let mut groups: Vec<(&str, Vec<Point>)> = Vec::new();
    for p in points {
        let name = p.solver.map_or("", |solver| solver.name());
        let text = format!("tolerance {:.0e}, {} iterations", p.tolerance, p.iterations);
        let point = Point { x: p.seconds.solving, y: 100.0 * p.error, text: Some(text) };
        match groups.iter_mut().find(|(known, _)| *known == name) {
            Some((_, points)) => points.push(point),
            None => groups.push((name, vec![point])),
        }
    }
    let of = |(k, (name, points))| series(name, k, Mark::Dot, Some(Stroke::Solid), points);
    groups.into_iter().enumerate().map(of).collect()
}

/// The charts of `radiosity validate`: the methods against each other patch by patch, and the distribution of z-scores.
pub fn validation(report: &ValidationReport, validation: &Validation, scene: &Scene) -> ChartPage {
    let Validation { radiosity, path_traced, light_traced, .. } = validation;
    let unit = scene.units.names().irradiance;
    let text = match report.valid {
        true => "All checks passed.".into(),
        false => format!("Checks failed: {}.", report.objections.join("; ")),
    };
    let z = Chart {
        title: "Differences in standard errors".into(),
        text: Some(
            "The share of values in steps of half a standard error. Normal errors follow the dashed line."
                .into(),
        ),
        x: Axis::even("difference", "standard errors"),
        y: Axis::even("share of values", "%"),
        band: None,
        lines: Vec::new(),
        series: vec![
            series(
                "radiosity and path tracing",
                0,
                Mark::Dot,
                Some(Stroke::Solid),
                histogram(radiosity, path_traced),
            ),
            series(
                "radiosity and light tracing",
                1,
                Mark::Dot,
                Some(Stroke::Solid),
                histogram(radiosity, light_traced),
            ),
            series(
                "path and light tracing",
                2,
                Mark::Dot,
                Some(Stroke::Solid),
                histogram(path_traced, light_traced),
            ),
            series("normal errors", 6, Mark::Small, Some(Stroke::Dashed), normal()),
        ],
    };
    ChartPage {
        title: format!("Validation: {}", report.scene),
        verdict: Some(Verdict { passed: report.valid, text }),
        notes: vec![format!(
            "{} patches, {} rays. The energy imbalance is {:.1e}, the discretisation error {:.2} % RMS.",
            report.patches,
            report.rays,
            report.energy.imbalance,
            100.0 * report.discretisation_relative
        )],
        charts: vec![against(validation, scene, unit), z],
    }
}

/// Irradiance by radiosity against that by path and light tracing.
fn against(validation: &Validation, scene: &Scene, unit: &str) -> Chart {
    let patches = &validation.solved.patches;
    let channels = patches.channels();
    let of = |values: &[f64], i: usize| luminance(rgb(&values[i * channels..][..channels]));
    let first = &validation.radiosity;
    let points = |second: &Estimates| {
        let point = |i: usize| {
            let [x, y, z] = patches.centroid(scene, i).to_array();
            let error = of(&first.standard_error, i).hypot(of(&second.standard_error, i));
            Point {
                x: of(&second.irradiance, i),
                y: of(&first.irradiance, i),
                text: Some(format!(
                    "patch {i} of `{}` at {x:.4} {y:.4} {z:.4}; standard error of the difference {error:.2e}",
                    scene.material(patches.triangle(i)).name
                )),
            }
        };
        (0..patches.fronts()).map(point).collect::<Vec<_>>()
    };
    let traced = [("path tracing", &validation.path_traced), ("light tracing", &validation.light_traced)];
    let series: Vec<Series> = traced
        .into_iter()
        .enumerate()
        .map(|(k, (name, found))| series(name, k, Mark::Small, None, points(found)))
        .collect();
    let most = series.iter().flat_map(|s| &s.points).map(|p| p.x.max(p.y)).fold(0.0, f64::max);
    Chart {
        title: "Irradiance of each patch".into(),
        text: Some("Methods that agree lie on the dashed line.".into()),
        x: Axis::even("irradiance by path or light tracing", unit),
        y: Axis::even("irradiance by radiosity", unit),
        band: None,
        lines: vec![Line { from: [0.0; 2], to: [most; 2] }],
        series,
    }
}

/// The width of a step of the z-scores, and how far they go.
const BIN: f64 = 0.5;
const BINS: i32 = 10;

/// The share of z-scores in each step, in percent. Those beyond the last are counted in it.
fn histogram(first: &Estimates, second: &Estimates) -> Vec<Point> {
    let mut counts = vec![0usize; 2 * BINS as usize + 1];
    for q in 0..first.irradiance.len() {
        let difference = first.irradiance[q] - second.irradiance[q];
        let part = |e: &Estimates| e.standard_error[q].hypot(e.allowance[q]);
        let z = difference / part(first).hypot(part(second));
        // Equal values, as in the dark, say nothing.
        if difference != 0.0 && !z.is_nan() {
            let bin = (z / BIN).round().clamp(f64::from(-BINS), f64::from(BINS));
            counts[(bin as i32 + BINS) as usize] += 1;
        }
    }
    let all = counts.iter().sum::<usize>().max(1) as f64;
    let point = |(k, count): (i32, &usize)| Point {
        x: f64::from(k) * BIN,
        y: 100.0 * *count as f64 / all,
        text: Some(format!("{count} values")),
    };
    (-BINS..).zip(&counts).map(point).collect()
}

fn normal() -> Vec<Point> {
    let below = |z: f64| 0.5 * libm::erfc(-z / std::f64::consts::SQRT_2);
    let share = |k: i32| {
        let z = f64::from(k) * BIN;
        100.0 * (below(z + 0.5 * BIN) - below(z - 0.5 * BIN))
    };
    (-BINS..=BINS).map(|k| Point { x: f64::from(k) * BIN, y: share(k), text: None }).collect()
}

/// The charts of `radiosity daylight`.
pub fn daylight(file: &str, places: &[Place], factors: &[f64], year: Option<&Year>) -> ChartPage {
    let mean = factors.iter().sum::<f64>() / factors.len().max(1) as f64;
    let mut notes = vec![format!(
        "{} places; the mean daylight factor is {:.2} %. Lamps do not shine here.",
        places.len(),
        100.0 * mean
    )];
    let percent: Vec<f64> = factors.iter().map(|factor| 100.0 * factor).collect();
    let mut charts = vec![distribution("Daylight factor", ("daylight factor", "%"), &percent, places)];
    if let Some(year) = year {
        notes.push(format!(
            "{:.1} % of the places have 300 lx in half of the hours from 8 to 18.",
            100.0 * year.spatial_autonomy
        ));
        let missing = year.is_missing.iter().filter(|missing| **missing).count();
        if missing > 0 {
            notes.push(format!("{missing} hours have no irradiance in the weather file, and are left out."));
        }
        charts.push(hours(year));
        let autonomy: Vec<f64> = year.autonomy.iter().map(|share| 100.0 * share).collect();
        let title = "Daylight autonomy: hours with 300 lx";
        charts.push(distribution(title, ("share of the hours from 8 to 18", "%"), &autonomy, places));
    }
    ChartPage { title: format!("Daylight: {file}"), verdict: None, notes, charts }
}

/// What share of the places has at least a value.
fn distribution(title: &str, (label, unit): (&str, &str), values: &[f64], places: &[Place]) -> Chart {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[b].total_cmp(&values[a]));
    let every = order.len().div_ceil(STEPS).max(1);
    let point = |(rank, &i): (usize, &usize)| {
        let [x, y, z] = places[i].0.to_array();
        Point {
            x: values[i],
            y: 100.0 * (rank + 1) as f64 / order.len() as f64,
            text: Some(format!("place {i} at {x:.4} {y:.4} {z:.4}")),
        }
    };
    let last = order.len().saturating_sub(1);
    let chosen = order.iter().enumerate().filter(|&(rank, _)| rank % every == 0 || rank == last);
    Chart {
        title: title.into(),
        text: None,
        x: Axis::even(label, unit),
        y: Axis::even("places with at least that", "%"),
        band: None,
        lines: Vec::new(),
        series: vec![series("places", 0, Mark::Small, Some(Stroke::Solid), chosen.map(point).collect())],
    }
}

/// Mean illuminance of all places by month and hour of the day.
fn hours(year: &Year) -> Chart {
    const MONTHS: [&str; 12] = [
        "January",
        "February",
        "March",
        "April",
        "May",
        "June",
        "July",
        "August",
        "September",
        "October",
        "November",
        "December",
    ];
    // As seasons: blue in winter, green and yellow towards summer, red in autumn.
    const SEASONS: [&str; 12] = [
        "#1f4e8c", "#3a7cc2", "#56b4e9", "#2f9e8f", "#009e73", "#8ab13c", "#e6c229", "#e69f00", "#d55e00",
        "#b5367a", "#7b3f98", "#4b3f8f",
    ];
    let places = year.autonomy.len().max(1);
    let mut sums: BTreeMap<(u32, u32), (f64, u32)> = BTreeMap::new();
    let hours = year.labels.iter().zip(year.illuminance.chunks(places)).zip(&year.is_missing);
    for ((&[month, _, label], lx), _) in hours.filter(|(_, missing)| !**missing) {
        let (sum, count) = sums.entry((month, label)).or_default();
        *sum += lx.iter().map(|&e| f64::from(e)).sum::<f64>() / places as f64;
        *count += 1;
    }
    let of_month = |month: u32| -> Vec<Point> {
        // A label counts hours from 1; the light is that of the middle.
        let of = |(&(_, label), &(sum, count)): (&(u32, u32), &(f64, u32))| Point {
            x: f64::from(label) - 0.5,
            y: sum / f64::from(count),
            text: Some(format!("mean of {count} hours")),
        };
        sums.range((month, 0)..(month + 1, 0)).map(of).collect()
    };
    let months = (1..=12).map(|month| (month, of_month(month))).filter(|(_, points)| !points.is_empty());
    let series = months
        .map(|(month, points)| {
            let k = month as usize - 1;
            let (name, colour) = (MONTHS[k].to_owned(), SEASONS[k].to_owned());
            Series { name, colour, mark: Mark::Small, line: Some(Stroke::Solid), points }
        })
        .collect();
    Chart {
        title: "Mean illuminance of the places".into(),
        text: None,
        x: Axis::even("hour of the day", ""),
        y: Axis::even("illuminance", "lx"),
        band: None,
        lines: Vec::new(),
        series,
    }
}
