//! Margins as one self-contained web page: outages over the phase, error over lateness and losses, tables below.

use crate::margin::{LawMargins, Margins, Point, SteadyMargin};
use crate::render::comparison_text::millimetres;
use crate::render::html::{Key, cell, chart, section, table};
use crate::render::margin_text::ticks;
use crate::render::page::document;
use crate::render::plot::{Axis, Chart, HEIGHT, Layer};
use crate::render::scale::Scale;
use maud::{Markup, html};

/// Colours of the combinations: six, and the same once more as broken lines.
const CLASSES: [&str; 12] = [
    "law-1", "law-2", "law-3", "law-4", "law-5", "law-6", "law-7", "law-8", "law-9", "law-10",
    "law-11", "law-12",
];
/// Errors below are drawn as this [m].
const ERROR_MIN_M: f64 = 1e-4;

#[must_use]
pub fn render(margins: &Margins) -> String {
    let build = &margins.build;
    let has = |of: fn(&LawMargins) -> bool| margins.laws.first().is_some_and(of);
    document(
        &format!("margins, {}", margins.flown()),
        &build.to_string(),
        html! {
            header {
                h1 { "Robustness of the loop" }
                p { (margins.flown()) ". " (margins.phases()) ". Survived: " (margins.gate_words()) "." }
            }
            main {
                @if has(|law| !law.outages.is_empty()) { (section("outage", "Outages survived, over the phase", outages(margins))) }
                @if has(|law| !law.lags.is_empty()) { (section("lateness", "Error over lateness", lateness(margins))) }
                @if has(|law| !law.losses.is_empty()) { (section("loss", "Error over losses", losses(margins))) }
                @if has(|law| !law.patterns.is_empty()) { (section("patterns", "Losses in a row", patterns(margins))) }
            }
            footer { "ironbird " (build) ". Each flight is one of " code { "ironbird simulate --fault" } "." }
        },
    )
}

fn names(margins: &Margins) -> Vec<String> {
    margins
        .laws
        .iter()
        .map(|law| margins.name_of(&law.laws))
        .collect()
}

fn keys(names: &[String]) -> Vec<Key<'_>> {
    CLASSES
        .into_iter()
        .zip(names.iter().map(String::as_str))
        .collect()
}

/// A table with a row per combination.
fn rows(
    margins: &Margins,
    columns: &[String],
    cells: impl Fn(&LawMargins) -> Vec<String>,
) -> Markup {
    let columns: Vec<&str> = ["laws"]
        .into_iter()
        .chain(columns.iter().map(String::as_str))
        .collect();
    let row = |law: &LawMargins| {
        [margins.name_of(&law.laws)]
            .into_iter()
            .chain(cells(law))
            .map(cell)
            .collect()
    };
    table(&columns, margins.laws.iter().map(row))
}

fn outages(margins: &Margins) -> Markup {
    let names = names(margins);
    let keys = keys(&names);
    let of: Vec<String> = margins
        .laws
        .first()
        .into_iter()
        .flat_map(|law| &law.outages)
        .map(|margin| margin.of.clone())
        .collect();
    let ms = margins.period_s * 1e3;
    html! {
        p {
            "The longest outage that a flight survived, by when it began. A stage that is out works nothing; "
            b { "machine" } " is all four at once; an input as " b { "inner.state" } " loses all messages. Outages of more than "
            (margins.longest_ticks) " ticks were not tried. A tick takes " (ms) " ms."
        }
        div.plots.wide {
            @for (i, name) in of.iter().enumerate() {
                (chart(&format!("outage-{i}"), name, &keys, &outage_chart(margins, i, name)))
            }
        }
        h3 { "Least / median of the phases [ticks]" }
        (rows(margins, &of, |law| {
            law.outages.iter().map(|it| format!("{} / {}", ticks(it.least(), margins), ticks(it.median(), margins))).collect()
        }))
    }
}

fn outage_chart(margins: &Margins, i: usize, name: &str) -> Chart {
    let lines: Vec<(&'static str, Vec<(f64, f64)>)> = margins
        .laws
        .iter()
        .zip(CLASSES)
        .filter_map(|(law, class)| {
            let ticks = law
                .outages
                .get(i)?
                .ticks
                .iter()
                .map(|ticks| (*ticks as f64).max(0.5));
            Some((class, margins.phases_s.iter().copied().zip(ticks).collect()))
        })
        .collect();
    let values = lines
        .iter()
        .flat_map(|(_, points)| points.iter().map(|(_, ticks)| *ticks));
    let y = Scale::log(values.collect::<Vec<_>>().into_iter());
    let first_s = margins.phases_s.first().copied().unwrap_or_default();
    Chart {
        title: format!("longest outage of {name} survived, over its begin"),
        x: Axis::new(
            Scale::time(first_s, first_s + margins.span_s),
            "begin of the outage [s]",
        ),
        y: Axis::new(y, "survived [ticks]"),
        lanes: Vec::new(),
        layers: lines
            .into_iter()
            .map(|(class, points)| Layer::Line { class, points })
            .collect(),
        height: HEIGHT,
    }
}

/// A picture per input: a line per combination through what its flights survived.
fn over(
    margins: &Margins,
    (name, label): (&str, &str),
    inputs: &[String],
    points: impl Fn(&LawMargins, usize) -> Vec<Point>,
    at: impl Fn(f64) -> f64,
) -> Markup {
    let names = names(margins);
    let keys = keys(&names);
    html! {
        div.plots.wide {
            @for (i, input) in inputs.iter().enumerate() {
                @let lines: Vec<(&'static str, Vec<Point>)> =
                    margins.laws.iter().zip(CLASSES).map(|(law, class)| (class, points(law, i))).collect();
                (chart(&format!("{name}-{i}"), input, &keys, &error_chart(input, label, &lines, &at)))
            }
        }
    }
}

fn error_chart(
    input: &str,
    label: &str,
    lines: &[(&'static str, Vec<Point>)],
    at: &impl Fn(f64) -> f64,
) -> Chart {
    let drawn = |points: &[Point]| -> Vec<(f64, f64)> {
        points
            .iter()
            .map_while(|it| Some((at(it.at), it.error_m?.max(ERROR_MIN_M))))
            .collect()
    };
    let mut layers = Vec::new();
    let (mut values, mut last) = (Vec::new(), 0.0_f64);
    for (class, points) in lines {
        let line = drawn(points);
        last = points.iter().map(|it| at(it.at)).fold(last, f64::max);
        values.extend(line.iter().map(|(_, error_m)| *error_m));
        let failed = points
            .iter()
            .zip(&line)
            .filter(|(it, _)| it.survived < it.flights);
        let word = |it: &Point| format!("{} of {} flights survived", it.survived, it.flights);
        let dots = failed.map(|(it, place)| (*place, word(it))).collect();
        layers.push(Layer::Line {
            class,
            points: line,
        });
        layers.push(Layer::Dots {
            class,
            points: dots,
        });
    }
    Chart {
        title: format!("largest position error over {label} of {input}"),
        x: Axis::new(
            Scale::Linear {
                low: 0.0,
                high: last.max(1.0),
            },
            label,
        ),
        y: Axis::new(
            Scale::log(values.into_iter()),
            "largest error of the last 5 s [m]",
        ),
        lanes: Vec::new(),
        layers,
        height: HEIGHT,
    }
}

const DOTS: &str = "A dot is where not every flight survived. A line ends where one left its envelope, or where the \
                    first phase had missed so often in a row that it was flown no further.";

fn lateness(margins: &Margins) -> Markup {
    let inputs = |of: fn(&LawMargins) -> &[SteadyMargin]| -> Vec<String> {
        margins
            .laws
            .first()
            .into_iter()
            .flat_map(of)
            .map(|it| it.input.clone())
            .collect()
    };
    let longest = |of: fn(&LawMargins) -> &[SteadyMargin]| {
        rows(margins, &inputs(of), |law| {
            of(law)
                .iter()
                .map(|it| format!("{}{}", it.ticks, if it.is_most { " and more" } else { "" }))
                .collect()
        })
    };
    let lags: fn(&LawMargins) -> &[SteadyMargin] = |law| &law.lags;
    let delays: fn(&LawMargins) -> &[SteadyMargin] = |law| &law.delays;
    let points = |of: fn(&LawMargins) -> &[SteadyMargin]| {
        move |law: &LawMargins, i: usize| {
            of(law)
                .get(i)
                .map(|it| it.points.clone())
                .unwrap_or_default()
        }
    };
    html! {
        p {
            "A " b { "lag" } " is dead time: messages come in time with a content of so many ticks before, and no stage can tell. "
            "A " b { "delay" } " is lateness: messages come so many ticks later, and the stage sees that they are stale. " (DOTS)
        }
        h3 { "Lag" }
        (over(margins, ("lag", "lag [ticks]"), &inputs(lags), points(lags), |it| it))
        h3 { "Longest lag that all flights survived [ticks]" }
        (longest(lags))
        h3 { "Longest delay that all flights survived [ticks]" }
        (longest(delays))
    }
}

fn losses(margins: &Margins) -> Markup {
    let inputs: Vec<String> = margins
        .laws
        .first()
        .into_iter()
        .flat_map(|law| &law.losses)
        .map(|it| it.input.clone())
        .collect();
    let points = |law: &LawMargins, i: usize| {
        law.losses
            .get(i)
            .map(|it| it.points.clone())
            .unwrap_or_default()
    };
    html! {
        p { "A share of the messages of an input is lost at random, by another seed at each phase. " (DOTS) }
        (over(margins, ("loss", "messages lost [%]"), &inputs, points, |share| 100.0 * share))
        h3 { "Share that all flights survived / that half of them did [%]" }
        p {
            "Behind them, how many flights with other seeds survived the first share, and the interval of the probability "
            "of survival that follows, at 95 %."
        }
        (rows(margins, &inputs, |law| {
            let each = law.losses.iter().map(|it| {
                let [low, high] = it.survival.map(|it| 100.0 * it);
                let (share, half) = (100.0 * it.share, 100.0 * it.median_share);
                format!("{share:.0} / {half:.0} ({} of {}: {low:.1} to {high:.0} %)", it.survived, it.flights)
            });
            each.collect()
        }))
    }
}

fn patterns(margins: &Margins) -> Markup {
    let inputs: Vec<String> = margins
        .laws
        .first()
        .into_iter()
        .flat_map(|law| &law.patterns)
        .map(|it| it.input.clone())
        .collect();
    html! {
        p { "The first m of each k messages are lost. For each k the largest m up to which the flights survived." }
        (rows(margins, &inputs, |law| {
            let pattern = |[m, k]: &[u64; 2]| format!("{m} of {k}");
            law.patterns.iter().map(|it| it.most.iter().map(pattern).collect::<Vec<_>>().join(", ")).collect()
        }))
        h3 { "Without a fault" }
        (rows(margins, &["largest error [mm]".into(), "recovered below [mm]".into(), "flights".into()], |law| {
            vec![millimetres(law.unfaulted_error_m), millimetres(law.recovered_below_m), law.flights.to_string()]
        }))
    }
}
