//! Charts as a page: points are read with the cursor, with a finger or with the arrow keys.

use std::io::{self, Write};

use serde::Serialize;

use super::document::{self, Kind};

/// Colours of Okabe and Ito's palette, which colour-blind people can distinguish.
pub(crate) const COLOURS: [&str; 7] =
    ["#0072b2", "#e69f00", "#009e73", "#d55e00", "#56b4e9", "#cc79a7", "#8c8c8c"];

/// A page of charts.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ChartPage {
    /// The title.
    pub title: String,
    /// The verdict of a check, if there was one.
    pub verdict: Option<Verdict>,
    /// Sentences about all of it.
    pub notes: Vec<String>,
    /// The charts.
    pub charts: Vec<Chart>,
}

/// How a check ended.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Verdict {
    /// Whether it passed.
    pub passed: bool,
    /// The same in words.
    pub text: String,
}

/// One chart.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Chart {
    /// Its title.
    pub title: String,
    /// A sentence about it.
    pub text: Option<String>,
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
    /// Values of y below this one mean nothing; they lie in a grey band.
    pub band: Option<f64>,
    /// Straight lines beside the points.
    pub lines: Vec<Line>,
    /// The points.
    pub series: Vec<Series>,
}

/// An axis.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Axis {
    /// What it shows.
    pub label: String,
    /// In which unit; empty if in none.
    pub unit: String,
    /// Whether it is logarithmic.
    pub log: bool,
}

impl Axis {
    /// A logarithmic axis.
    pub fn log(label: &str, unit: &str) -> Axis {
        Axis { label: label.into(), unit: unit.into(), log: true }
    }

    /// An even axis.
    pub fn even(label: &str, unit: &str) -> Axis {
        Axis { label: label.into(), unit: unit.into(), log: false }
    }
}

/// A straight line between two points.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Line {
    /// Where it begins: x and y.
    pub from: [f64; 2],
    /// Where it ends.
    pub to: [f64; 2],
}

/// Points that belong together.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Series {
    /// Their name.
    pub name: String,
    /// Their colour, as CSS writes it.
    pub colour: String,
    /// How a point looks.
    pub mark: Mark,
    /// Whether a line joins them.
    pub line: Option<Stroke>,
    /// The points.
    pub points: Vec<Point>,
}

/// How a point looks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Mark {
    /// A disc.
    Dot,
    /// A circle.
    Ring,
    /// A small disc, for many points.
    Small,
    /// A diamond.
    Diamond,
    /// A cross.
    Cross,
}

/// How a line looks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Stroke {
    /// Without gaps.
    Solid,
    /// With gaps.
    Dashed,
}

/// A point.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Point {
    /// Its value on the horizontal axis.
    pub x: f64,
    /// Its value on the vertical axis.
    pub y: f64,
    /// What else is known of it.
    pub text: Option<String>,
}

impl ChartPage {
    /// Writes the page to `out`.
    ///
    /// # Errors
    /// Errors of writing to `out`.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        let about = serde_json::to_value(self).map_err(io::Error::other)?;
        document::write(out, Kind::Charts, &self.title, &about, &[])
    }
}
