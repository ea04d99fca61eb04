//! Charts as SVG: axes with units, lines and marks, coloured by the style sheet.
//!
//! A chart is drawn [`WIDTH`] pixels wide. Pages show it at about that width on phones and on desktops, so its text
//! keeps its size. Colours are classes of `plot.css`, one for each thing shown, with variants for light and dark. Fonts
//! come from the style sheet too.

use crate::scale::{Kind, Scale};
use analysis::traces::Span;
use maud::{Markup, html};
use std::fmt::Write as _;

/// Colours of laws: six, and the same once more as broken lines.
pub const LAWS: [&str; 12] = [
    "law-1", "law-2", "law-3", "law-4", "law-5", "law-6", "law-7", "law-8", "law-9", "law-10",
    "law-11", "law-12",
];

pub const STYLE: &str = include_str!("plot.css");

/// Width of a chart [pixels].
pub const WIDTH: f64 = 420.0;
/// Height of a chart over time [pixels].
pub const HEIGHT: f64 = 220.0;

const X_TICKS: usize = 6;
const Y_TICKS: usize = 5;
/// Space of a character of a label [pixels]: of the widest fonts in use.
const CHARACTER: f64 = 7.2;
/// Space above the axes, with the name of the vertical one [pixels].
const ABOVE: f64 = 22.0;
/// Space below the axes, with the numbers and the name of the horizontal one [pixels].
const BELOW: f64 = 36.0;
/// Height of a row [pixels].
const ROW: f64 = 20.0;
/// Space to the right of the axes, for half a number [pixels].
const RIGHT: f64 = 20.0;
/// Height of a capital from its baseline to its middle [pixels].
const HALF_CAPITAL: f64 = 4.0;

#[derive(Clone, Debug)]
pub struct Axis {
    pub scale: Scale,
    pub label: String,
}

impl Axis {
    pub fn new(scale: Scale, label: impl Into<String>) -> Self {
        Self {
            scale,
            label: label.into(),
        }
    }

    fn words(&self) -> Option<String> {
        let Scale { kind, low, high } = &self.scale;
        Some(match kind {
            Kind::Linear => format!("linear {low} {high}"),
            Kind::Log => format!("log {low} {high}"),
            Kind::Symmetric(threshold) => format!("symmetric {low} {high} {threshold}"),
            Kind::Tail => format!("tail {low} {high}"),
            Kind::Rows(_) | Kind::Windows(..) => return None,
        })
    }
}

/// Two opposite corners of a box, or both ends of a line, in the units of the axes.
pub type Ends = [(f64, f64); 2];

/// Something in a chart; the class that it begins with is its colour.
#[derive(Clone, Debug)]
pub enum Layer {
    Line(&'static str, Vec<(f64, f64)>),
    /// A part of a line, once more: on top of others.
    Again(&'static str, Vec<(f64, f64)>),
    /// From, to and height of each bin, in order.
    Steps(&'static str, Vec<(f64, f64, f64)>),
    /// Dots, each with a word for who points at it.
    Dots(&'static str, Vec<((f64, f64), String)>),
    /// A line over the whole width, with its name.
    Level(&'static str, f64, &'static str),
    /// Rectangles from one corner to the other, each with a word for who points at it and a label behind it.
    Boxes(String, Vec<(Ends, String, String)>),
    /// Straight lines, each with a word for who points at it.
    Segments(String, Vec<(Ends, String)>),
}

impl Layer {
    pub fn stems(class: &str, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        let stem = |(x, y)| ([(x, f64::NEG_INFINITY), (x, y)], String::new());
        Self::Segments(
            format!("stem {class}"),
            points.into_iter().map(stem).collect(),
        )
    }

    pub fn verticals(class: &str, at: impl IntoIterator<Item = (f64, String)>) -> Self {
        let vertical = |(x, word)| ([(x, f64::NEG_INFINITY), (x, f64::INFINITY)], word);
        Self::Segments(
            format!("vertical {class}"),
            at.into_iter().map(vertical).collect(),
        )
    }
}

#[derive(Clone, Debug)]
pub struct Chart {
    pub title: String,
    pub x: Axis,
    pub y: Axis,
    pub layers: Vec<Layer>,
    /// Height [pixels].
    pub height: f64,
}

/// The rectangle inside the axes [pixels].
#[derive(Clone, Copy, Debug)]
struct Frame {
    left: f64,
    right: f64,
    top: f64,
    foot: f64,
}

impl Chart {
    pub fn new(title: impl Into<String>, x: Axis, y: Axis, layers: Vec<Layer>) -> Self {
        let height = match &y.scale.kind {
            Kind::Rows(names) => ABOVE + ROW * names.len() as f64 + BELOW,
            _ => HEIGHT,
        };
        Self {
            title: title.into(),
            x,
            y,
            layers,
            height,
        }
    }

    /// The chart as an `svg` element; `place` are attributes that put it into another one: x, y, width, height.
    pub fn svg(&self, place: Option<[f64; 4]>) -> Markup {
        let frame = self.frame();
        let [x, y, width, height] = place.map_or([None; 4], |place| place.map(Some));
        let (left, right, top, foot) = (frame.left, frame.right, frame.top, frame.foot);
        // A chart of its own can be read with a pointer: readout.js.
        let words = self.x.words().zip(self.y.words());
        let (words_x, words_y) = words.filter(|_| place.is_none()).unzip();
        let readable = words_x
            .is_some()
            .then(|| format!("{left} {right} {top} {foot}"));
        let has_rows = matches!(self.y.scale.kind, Kind::Rows(_));
        html! {
            svg viewBox=(format!("0 0 {WIDTH} {}", self.height)) role="img" aria-label=(self.title)
                x=[x] y=[y] width=[width] height=[height]
                data-frame=[readable] data-x=[words_x] data-y=[words_y] {
                g.grid {
                    @for tick in self.y.scale.ticks(Y_TICKS) {
                        @let y = tenths(self.at_y(frame, tick.value));
                        @if !has_rows { line x1=(left) x2=(right) y1=(y) y2=(y) {} }
                        text.left x=(left - 5.0) y=(tenths(self.at_y(frame, tick.value) + HALF_CAPITAL)) {
                            (tick.label)
                        }
                    }
                    @for tick in self.x.scale.ticks(X_TICKS) {
                        @let x = tenths(self.at_x(frame, tick.value));
                        line.at-x x1=(x) x2=(x) y1=(ABOVE) y2=(foot) {}
                        @if !tick.label.is_empty() { text.below x=(x) y=(foot + 15.0) { (tick.label) } }
                    }
                    @if !self.y.label.is_empty() { text.of-y x="2" y="12" { (self.y.label) } }
                    text.of-x x=(right) y=(self.height - 5.0) { (self.x.label) }
                }
                // A page cuts off at the axes what it zooms.
                svg.layers x=(left) y="0" width=(right - left) height=(self.height) overflow="visible"
                    viewBox=(format!("{left} 0 {} {}", right - left, self.height)) {
                    g { @for layer in &self.layers { (self.layer(frame, layer)) } }
                }
                path.frame d=(format!("M{left} {top}V{foot}H{right}")) {}
            }
        }
    }

    fn frame(&self) -> Frame {
        let ticks = self.y.scale.ticks(Y_TICKS);
        let lengths = ticks.iter().map(|tick| tick.label.chars().count());
        let widest = lengths.max().unwrap_or(1);
        let left = 10.0 + CHARACTER * widest as f64;
        Frame {
            left,
            right: WIDTH - RIGHT,
            top: ABOVE,
            foot: self.height - BELOW,
        }
    }

    pub fn proportion(&self) -> f64 {
        let frame = self.frame();
        (frame.right - frame.left) / (frame.foot - frame.top)
    }

    fn at_x(&self, frame: Frame, value: f64) -> f64 {
        frame.left + (frame.right - frame.left) * self.x.scale.place(value)
    }

    fn at_y(&self, frame: Frame, value: f64) -> f64 {
        frame.foot - (frame.foot - frame.top) * self.y.scale.place(value)
    }

    fn layer(&self, frame: Frame, layer: &Layer) -> Markup {
        let at = |(x, y): (f64, f64)| (self.at_x(frame, x), self.at_y(frame, y));
        match layer {
            Layer::Line(class, points) | Layer::Again(class, points) => {
                let is_again = matches!(layer, Layer::Again(..));
                let kind = if is_again { "again" } else { "line" };
                let d = path(points.iter().map(|point| at(*point)));
                html! { path.(kind).(class) d=(d) {} }
            }
            Layer::Steps(class, bins) => {
                let bin =
                    |(from, to, y): &(f64, f64, f64)| (at((*from, *y)), self.at_x(frame, *to));
                let d = outline(bins.iter().map(bin), frame.foot);
                html! { path.steps.(class) d=(d) {} }
            }
            Layer::Dots(class, points) => html! {
                @for (point, word) in points {
                    @let (x, y) = at(*point);
                    circle.dot.(class) cx=(tenths(x)) cy=(tenths(y)) r="4.5" { title { (word) } }
                }
            },
            Layer::Level(class, at, label) => {
                let y = tenths(self.at_y(frame, *at));
                html! {
                    line.level.(class) x1=(frame.left) x2=(frame.right) y1=(y) y2=(y) {}
                    text.level x=(frame.right - 4.0) y=(tenths(self.at_y(frame, *at) - 4.0)) { (label) }
                }
            }
            Layer::Boxes(class, boxes) => html! {
                @for ([from, to], word, label) in boxes {
                    @let ((x0, y0), (x1, y1)) = (at(*from), at(*to));
                    // What is short can be seen, too.
                    rect class=(class) x=(tenths(x0)) y=(tenths(y0.min(y1)))
                        width=(tenths((x1 - x0).max(2.0))) height=(tenths((y1 - y0).abs())) {
                        @if !word.is_empty() { title { (word) } }
                    }
                    @if !label.is_empty() {
                        text.number x=(tenths(x1 + 5.0)) y=(tenths((y0 + y1) / 2.0 + HALF_CAPITAL)) { (label) }
                    }
                }
            },
            Layer::Segments(class, segments) => html! {
                // Many marks over the whole height must not hide what they mark.
                @let is_over_all = class.starts_with("vertical");
                @let opacity = tenths((30.0 / segments.len() as f64).clamp(0.2, 1.0));
                g opacity=[is_over_all.then_some(opacity)] {
                    @for ([from, to], word) in segments {
                        @let ((x0, y0), (x1, y1)) = (at(*from), at(*to));
                        @let d = format!("M{} {}L{} {}", tenths(x0), tenths(y0), tenths(x1), tenths(y1));
                        path class=(class) d=(d) { @if !word.is_empty() { title { (word) } } }
                    }
                }
            },
        }
    }
}

/// A channel as a line: through the smallest and the largest value of each stretch, the nearer one first, as if they
/// were its ends. What rises or falls all the time is drawn as it is.
///
/// `ends_s` gives the begin and the end of a stretch that begins at a tick [s].
pub fn through(
    spans: impl Iterator<Item = Span>,
    ends_s: impl Fn(u64) -> [f64; 2],
) -> Vec<(f64, f64)> {
    let mut points: Vec<(f64, f64)> = Vec::new();
    for span in spans {
        let last = points.last().map_or(span.min, |point| point.1);
        let rises = (last - span.min).abs() <= (last - span.max).abs();
        let values = if rises {
            [span.min, span.max]
        } else {
            [span.max, span.min]
        };
        points.extend(ends_s(span.tick).into_iter().zip(values));
    }
    points
}

/// Lines over an axis from `low` to `high`, each of which lies on top in some of its stretches: where they coincide, all
/// of them can be seen.
pub fn braided(lines: Vec<(&'static str, Vec<(f64, f64)>)>, low: f64, high: f64) -> Vec<Layer> {
    const STRETCHES: usize = 48;
    let part = |(class, points): &(&'static str, Vec<(f64, f64)>), stretch: usize| {
        let end = |i: usize| low + (high - low) * i as f64 / STRETCHES as f64;
        let from = points.partition_point(|point| point.0 < end(stretch));
        let to = points.partition_point(|point| point.0 < end(stretch + 1));
        let from = from.saturating_sub(1);
        Layer::Again(class, points[from..(to + 1).min(points.len())].to_vec())
    };
    let several = if lines.len() > 1 { STRETCHES } else { 0 };
    let again: Vec<Layer> = (0..several)
        .map(|stretch| part(&lines[stretch % lines.len()], stretch))
        .collect();
    let whole = lines
        .into_iter()
        .map(|(class, points)| Layer::Line(class, points));
    whole.chain(again).collect()
}

/// Path through points in pixels, without those that make no difference.
fn path(points: impl Iterator<Item = (f64, f64)>) -> String {
    /// Less than anybody sees [pixels].
    const UNSEEN: f64 = 0.25;
    let mut kept: Vec<(f64, f64)> = Vec::new();
    for (x, y) in points {
        match kept[..] {
            // Where neighbours stand at one place, or three at one height, the middle one goes.
            [.., (x0, y0)] if (x - x0).abs() < UNSEEN && (y - y0).abs() < UNSEEN => {}
            [.., (_, y0), (_, y1)] if (y - y1).abs() < 0.05 && (y - y0).abs() < 0.05 => {
                let last = kept.len() - 1;
                kept[last] = (x, y);
            }
            _ => kept.push((x, y)),
        }
    }
    let mut d = String::new();
    for (i, (x, y)) in kept.into_iter().enumerate() {
        let to = if i == 0 { "M" } else { "L" };
        // Writing into a string cannot fail.
        let _ = write!(d, "{to}{} {}", tenths(x), tenths(y));
    }
    d
}

/// Outline of bins in pixels, each as its upper left corner and its right edge, down to the foot where one is missing.
fn outline(bins: impl Iterator<Item = ((f64, f64), f64)>, foot: f64) -> String {
    let mut d = String::new();
    let mut end = f64::NAN;
    for ((left, y), right) in bins {
        // Writing into a string cannot fail.
        let follows = (left - end).abs() < 0.01;
        if !follows && !end.is_nan() {
            let _ = write!(d, "L{end:.2} {foot}");
        }
        if !follows {
            let _ = write!(d, "M{left:.2} {foot}");
        }
        let _ = write!(d, "L{left:.2} {y:.2}L{right:.2} {y:.2}");
        end = right;
    }
    if !end.is_nan() {
        let _ = write!(d, "L{end:.2} {foot}");
    }
    d
}

pub fn tenths(pixels: f64) -> f64 {
    (pixels * 10.0).round() / 10.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_has_no_path_and_no_outline() {
        assert_eq!(path(std::iter::empty()), "");
        assert_eq!(outline(std::iter::empty(), 9.0), "");
    }
}
