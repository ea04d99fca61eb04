//! A comparison as one self-contained web page: all combinations in each chart, tables below.

use crate::comparison::{Comparison, Fault, Outcome, POWER, TRUE_ERROR};
use crate::render::comparison_text;
use crate::render::html::{Key, chart, section};
use crate::render::page::document;
use crate::render::plot::{Axis, Chart, HEIGHT, Layer, through};
use crate::render::scale::Scale;
use crate::traces::Span;
use maud::{Markup, html};

/// Colours of the combinations: six, and the same once more as broken lines.
const CLASSES: [&str; 12] = [
    "law-1", "law-2", "law-3", "law-4", "law-5", "law-6", "law-7", "law-8", "law-9", "law-10",
    "law-11", "law-12",
];

/// Combinations at the most that a page tells apart.
pub const COMBINATIONS_MAX: usize = CLASSES.len();

/// Errors below are drawn as this [m]: that of a flight at rest has no logarithm.
const ERROR_MIN_M: f64 = 1e-4;

#[must_use]
pub fn render(comparison: &Comparison) -> String {
    let flight = &comparison.flight;
    let build = &comparison.build;
    document(
        &format!(
            "{} combinations of laws, {flight}",
            comparison.outcomes.len()
        ),
        &build.to_string(),
        html! {
            header {
                h1 { (comparison.outcomes.len()) " combinations of laws, one flight" }
                p {
                    (flight.to_string()) "."
                    @for fault in &flight.faults { " At " (format!("{:.3} s ", fault.time_s)) (fault.what) "." }
                }
            }
            main {
                (section("time", "Over time", over_time(comparison)))
                @for part in comparison_text::parts(comparison) { (part.html("laws")) }
                @if comparison.outcomes.iter().any(|outcome| outcome.lost.is_some()) {
                    (section("lost", "Lost", endings(comparison)))
                }
            }
            footer { "ironbird " (build) ". The hash of each flight is the one that " code { "ironbird simulate" } " prints." }
        },
    )
}

fn over_time(comparison: &Comparison) -> Markup {
    let names: Vec<String> = comparison
        .outcomes
        .iter()
        .map(|outcome| comparison.name_of(&outcome.laws))
        .collect();
    let keys: Vec<Key<'_>> = CLASSES
        .into_iter()
        .zip(names.iter().map(String::as_str))
        .collect();
    html! {
        p.marks {
            span.key.mark.swap { "fault" } " Each line is drawn through the smallest and the largest value of its stretches; "
            "it ends where the flight did. The error is by the truth, not by the sensors; power is the sum of the cubed "
            "rotor speeds, as a multiple of that in hover."
        }
        div.plots.wide {
            (chart("error", "True position error", &keys, &error_chart(comparison)))
            (chart("power", "Rotor power", &keys, &power_chart(comparison)))
        }
    }
}

fn error_chart(comparison: &Comparison) -> Chart {
    let floored = |span: Span| Span {
        min: span.min.max(ERROR_MIN_M),
        max: span.max.max(ERROR_MIN_M),
        ..span
    };
    let bound_m = comparison.flight.bound_m;
    let (lines, values) = lines(comparison, TRUE_ERROR, floored);
    let scale = Scale::log(values.into_iter().chain([bound_m.max(ERROR_MIN_M)]));
    let level = Layer::Level {
        class: "deadline",
        at: bound_m,
        label: "recovered".into(),
    };
    over(
        comparison,
        "true position error [m]",
        scale,
        lines.into_iter().chain([level]).collect(),
    )
}

fn power_chart(comparison: &Comparison) -> Chart {
    let (lines, values) = lines(comparison, POWER, |span| span);
    over(
        comparison,
        "rotor power [hover]",
        Scale::linear(values.into_iter(), 0.01),
        lines,
    )
}

/// A line for each combination, and all values on them.
fn lines(
    comparison: &Comparison,
    channel: &str,
    shown: impl Fn(Span) -> Span,
) -> (Vec<Layer>, Vec<f64>) {
    let flight = &comparison.flight;
    let mut values = Vec::new();
    let line = |(outcome, class): (&Outcome, &'static str)| {
        let trace = &outcome.figures.trace;
        let spans: Vec<Span> = trace.spans(channel).map(&shown).collect();
        values.extend(spans.iter().flat_map(|span| [span.min, span.max]));
        let last = trace.every_ticks.saturating_sub(1);
        let ends_s = |tick| [flight.time_s(tick), flight.time_s(tick + last)];
        Layer::Line {
            class,
            points: through(spans.into_iter(), ends_s),
        }
    };
    let lines = comparison.outcomes.iter().zip(CLASSES).map(line).collect();
    (lines, values)
}

/// A chart over the whole plan of the flight, with its faults below what it shows.
fn over(comparison: &Comparison, label: &str, scale: Scale, layers: Vec<Layer>) -> Chart {
    let flight = &comparison.flight;
    let words = |fault: &Fault| {
        (
            fault.time_s,
            format!("fault at {:.3} s: {}", fault.time_s, fault.what),
        )
    };
    let faults = Layer::Verticals {
        class: "swap",
        at: flight.faults.iter().map(words).collect(),
    };
    Chart {
        title: format!("{label} over time"),
        x: Axis::new(
            Scale::time(0.0, flight.time_s(flight.last_tick)),
            "time [s]",
        ),
        y: Axis::new(scale, label),
        lanes: Vec::new(),
        layers: [faults].into_iter().chain(layers).collect(),
        height: HEIGHT,
    }
}

fn endings(comparison: &Comparison) -> Markup {
    html! {
        @for outcome in &comparison.outcomes {
            @if let Some(ending) = comparison_text::ending(outcome) {
                p { strong { (comparison.name_of(&outcome.laws)) } " " (ending) "." }
            }
            @for sentence in &outcome.unusable {
                p { strong { (comparison.name_of(&outcome.laws)) } " " (sentence) "." }
            }
        }
    }
}
