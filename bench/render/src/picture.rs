//! The flight as one picture, flight.svg.
//!
//! It shows path, height, position error and estimates, of a law without estimates the attitude, and marks the swaps.

use crate::figures::{ANGLES, Figures, SYMBOLS};
use crate::flight::change_mark;
use crate::plot::{Chart, STYLE, WIDTH};
use maud::{Markup, PreEscaped, html};

/// Space around charts [pixels].
const GAP: f64 = 16.0;
/// Space above a chart for its title [pixels].
const TITLE: f64 = 18.0;
/// Space for the heading and the key [pixels].
const HEADING: f64 = 62.0;

pub fn render(figures: &Figures<'_>, title: &str) -> String {
    let has_estimates = figures.has_estimates();
    let mut below = [HEADING; 2];
    let mut place = |column: usize, title: String, chart: Chart| {
        let place = (GAP + (WIDTH + GAP) * column as f64, below[column]);
        below[column] += TITLE + chart.height + GAP;
        (place, title, chart)
    };
    let mut charts = vec![
        place(0, "path seen from above".into(), figures.path(0, 1)),
        place(0, "height".into(), figures.position(2).chart),
        place(0, "position error".into(), figures.distance().chart),
    ];
    charts.extend((0..3).map(|i| {
        let (title, figure) = match has_estimates {
            true => (format!("estimate of {}", SYMBOLS[i]), figures.estimate(i)),
            false => (ANGLES[i].into(), figures.attitude(i)),
        };
        place(1, title, figure.chart)
    }));
    let swap = change_mark(figures.faults);
    let [flown, reference] = match has_estimates {
        true => ["flown, estimated", "reference, true"],
        false => ["flown", "reference"],
    };
    let (width, height) = (2.0 * (WIDTH + GAP) + GAP, below[0].max(below[1]));
    let picture: Markup = html! {
        svg xmlns="http://www.w3.org/2000/svg" viewBox=(format!("0 0 {width} {height}"))
            width=(width) height=(height) {
            style { (PreEscaped(STYLE)) (PreEscaped(OWN_STYLE)) }
            rect.card x="0" y="0" width=(width) height=(height) {}
            text.heading x=(GAP) y="28" { (title) }
            (key(GAP, &[("flown", flown), ("reference", reference), ("swap", swap)]))
            @for ((x, y), title, chart) in &charts {
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
