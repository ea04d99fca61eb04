//! The flight as one picture, flight.svg.
//!
//! It shows path, height, position error and estimates, of a law without estimates the attitude, and marks the swaps.

use crate::faults::InjectedFault;
use crate::render::figures::Figures;
use crate::render::plot::{Chart, HEIGHT, STYLE, WIDTH};
use crate::swaps::AppliedSwap;
use crate::traces::Traces;
use maud::{Markup, PreEscaped, html};

/// Space around charts [pixels].
const GAP: f64 = 16.0;
/// Space above a chart for its title [pixels].
const TITLE: f64 = 18.0;
/// Space for the heading and the key [pixels].
const HEADING: f64 = 62.0;

/// Draws the picture of a flight whose laws' ticks are `period_s` [s] long.
#[must_use]
pub fn render(
    traces: &Traces,
    swaps: &[AppliedSwap],
    faults: &[InjectedFault],
    period_s: f64,
    title: &str,
) -> String {
    let figures = Figures::new(traces, swaps, &[], period_s).faulty(faults);
    let path = figures.path(0, 1);
    let mut rows: Vec<(f64, f64, String, Chart)> = Vec::new();
    let left = GAP;
    let right = left + WIDTH + GAP;
    let mut below_path = HEADING + TITLE + path.height + GAP;
    let path_title = "path seen from above".to_owned();
    rows.push((left, HEADING, path_title, path));
    for (title, chart) in [
        ("height", figures.position(2)),
        ("position error", figures.distance()),
    ] {
        rows.push((left, below_path, title.into(), chart));
        below_path += TITLE + HEIGHT + GAP;
    }
    let mut below = HEADING;
    for i in 0..3 {
        let (title, chart) = if traces.has_estimates() {
            (
                format!("estimate of {}", ["I_R", "k_r", "delta"][i]),
                figures.estimate(i),
            )
        } else {
            (["roll", "pitch", "yaw"][i].to_owned(), figures.attitude(i))
        };
        rows.push((right, below, title, chart));
        below += TITLE + HEIGHT + GAP;
    }
    let [flown, reference] = if traces.has_estimates() {
        ["flown, estimated", "reference, true"]
    } else {
        ["flown", "reference"]
    };
    let (width, height) = (right + WIDTH + GAP, below_path.max(below));
    let picture: Markup = html! {
        svg xmlns="http://www.w3.org/2000/svg" viewBox=(format!("0 0 {width} {height}"))
            width=(width) height=(height) {
            style { (PreEscaped(STYLE)) (PreEscaped(OWN_STYLE)) }
            rect.card x="0" y="0" width=(width) height=(height) {}
            text.heading x=(GAP) y="28" { (title) }
            (key(GAP, &[("flown", flown), ("reference", reference), ("swap", if faults.is_empty() { "live swap" } else { "swap, fault" })]))
            @for (x, y, title, chart) in &rows {
                text.title x=(x) y=(y + 12.0) { (title) }
                (chart.svg(Some([*x, y + TITLE, WIDTH, chart.height])))
            }
        }
    };
    picture.into_string()
}

/// What does not come from the page's style sheet.
const OWN_STYLE: &str = "
.card { fill: var(--card); }
svg text.heading { font-size: 17px; font-weight: 600; fill: var(--ink); }
svg text.title { font-size: 13px; font-weight: 600; fill: var(--ink); }
";

fn key(left: f64, entries: &[(&str, &str)]) -> Markup {
    /// Space of an entry [pixels].
    const ENTRY: f64 = 150.0;
    html! {
        @for (i, (class, word)) in entries.iter().enumerate() {
            @let x = left + ENTRY * i as f64;
            path.line.vertical.(class) d=(format!("M{x} 46h22")) {}
            text x=(x + 28.0) y="50" { (word) }
        }
    }
}
