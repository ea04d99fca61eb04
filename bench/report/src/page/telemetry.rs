//! What the laws show: a small chart for each signal, with its name and unit.

use maud::{Markup, html};

use crate::laws::{SignalSection, in_order};
use crate::page::figures::Figures;
use crate::page::parts::{self, cell, chart, table};
use crate::schema::Report;

/// A table and charts for each law, in the order of the data flow; nothing in reports from before it was kept.
pub fn laws(report: &Report) -> Markup {
    let laws = &report.run.laws;
    if laws.values().all(|law| law.telemetry.is_empty()) {
        return html! {};
    }
    html! {
        h3 #telemetry { "Telemetry of the laws" }
        p.note {
            "What each law shows of itself, as it names it (" code { "ironbird laws NAME" } "). Where a law knew no \
             number, there is none."
        }
        @for (role, law) in in_order(laws) {
            h4 { (capital(role)) " law " code { (law.name) } }
            @if law.telemetry.is_empty() {
                p { "It shows nothing." }
            } @else {
                (charts(report, role, &law.telemetry))
                details {
                    summary { "Numbers of " (parts::count(law.telemetry.len() as u64, "signal")) }
                    (numbers(&law.telemetry))
                }
            }
        }
    }
}

fn charts(report: &Report, role: &'static str, signals: &[SignalSection]) -> Markup {
    let Some(traces) = &report.traces else { return html! {} };
    let Some(group) = traces.telemetry.get(role) else { return html! {} };
    let figures = Figures::of(traces, report);
    html! {
        div.plots {
            @for signal in signals.iter().filter(|signal| group.has(&signal.name)) {
                (chart(&format!("{role}-{}", signal.name), &titled(signal), &[], &figures.signal(role, group, signal)))
            }
        }
    }
}

/// A word as a heading begins with it.
fn capital(word: &str) -> String {
    word.chars().take(1).map(|first| first.to_ascii_uppercase()).chain(word.chars().skip(1)).collect()
}

/// Name and unit.
fn titled(signal: &SignalSection) -> String {
    if signal.unit.is_empty() { signal.name.clone() } else { format!("{} [{}]", signal.name, signal.unit) }
}

fn numbers(signals: &[SignalSection]) -> Markup {
    let number = |value: Option<f64>| cell(value.map_or_else(|| "-".into(), |value| format!("{value:.4e}")));
    let rows = signals.iter().map(|signal| {
        vec![cell(&signal.name), cell(&signal.unit), number(signal.last), number(signal.min), number(signal.max)]
    });
    table(&["signal", "unit", "at the end", "smallest", "largest"], rows)
}
