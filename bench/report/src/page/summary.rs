//! The head of the page: what was flown, whether it passed, its gates and swaps.

use maud::{Markup, html};

use crate::losses;
use crate::page::parts::{cell, number, section, table, us};
use crate::schema::Report;
use crate::text;

/// Heading, verdict, key numbers, contents.
pub fn head(report: &Report) -> Markup {
    let run = &report.run;
    let status = &report.verdict.status;
    let passed = status == "PASS";
    html! {
        header {
            h1 {
                (run.trajectory) " with gains " (run.preset) " "
                span.verdict.good[passed].bad[!passed && !run.in_flight] { (status) }
            }
            p {
                (run.started) ", instance " (run.instance) ", "
                @if run.in_flight { "in flight: numbers so far, plots come with its end" } @else { (run.ending) }
            }
            p { (text::pace(report)) }
            p { (text::machine(report)) }
            p { "Real time here: " (text::here(report)) }
            @for sentence in losses::sentences(report) { p.bad { (sentence) } }
            (tiles(report))
            nav {
                @for (id, title) in [
                    ("summary", "Summary"),
                    ("flight", "Flight"),
                    ("latency", "Latency"),
                    ("theorem", "Theorem"),
                    ("setup", "Processes and machine"),
                ] { a href=(format!("#{id}")) { (title) } }
            }
        }
    }
}

fn tiles(report: &Report) -> Markup {
    let series = |name: &str| report.series(name);
    let tile = |title: &str, value: String, unit: &str| {
        html! { div { dt { (title) } dd { (value) " " span.unit { (unit) } } } }
    };
    html! {
        dl.tiles {
            (tile("ticks", report.ticks.run.to_string(), &format!("+ {} skipped", report.ticks.skipped)))
            (tile("deadlines missed", report.deadlines.missed.to_string(), &format!("{:.1} per million", report.deadlines.missed_ppm)))
            @if let Some(whole) = series("loop") {
                (tile("loop p50", us(whole.p50_us), "us"))
                (tile("loop p99", us(whole.p99_us), "us"))
                @match whole.p999_us {
                    Some(value) => (tile("loop p99.9", us(value), "us")),
                    None => (tile("loop p99.9", "-".into(), "too few values")),
                }
            }
            @if let Some(wake) = series("wake.plant") { (tile("wake p99", us(wake.p99_us), "us")) }
            (tile("position error rms", number(report.flight.position_error_rms_m), "m"))
            div { dt { "theorem" } dd.words { (report.theorem.verdict()) } }
        }
    }
}

/// Gates and swaps.
pub fn sections(report: &Report) -> Markup {
    let ticks = &report.ticks;
    let sum = ticks.run + ticks.skipped;
    section(
        "summary",
        "Summary",
        html! {
            p {
                "Ticks: run " (ticks.run) " + skipped " (ticks.skipped) " = " (sum) " "
                @if ticks.identity_holds { "=" } @else { strong { "is not" } }
                " elapsed " (format!("{:.3}", ticks.elapsed_s)) " s / period = " (ticks.elapsed_periods) "."
            }
            div.columns {
                div {
                    h3 { "Gates" }
                    (table(&["gate", "found", "allowed", ""], report.verdict.gates.iter().map(|gate| {
                        let word = if gate.held { "held" } else { "FAILED" };
                        vec![
                            cell(&gate.name),
                            cell(&gate.value),
                            cell(&gate.limit),
                            html! { span.good[gate.held].bad[!gate.held] { (word) } },
                        ]
                    })))
                }
                div {
                    h3 { "Live swaps" }
                    @if report.swaps.is_empty() { p { "No parameter of the airframe was swapped." } }
                    @else { (swaps(report)) }
                    @if report.swaps_left_out > 0 { p { "And " (report.swaps_left_out) " later ones." } }
                }
            }
        },
    )
}

fn swaps(report: &Report) -> Markup {
    let rows = report.swaps.iter().flat_map(|swap| {
        swap.changes.iter().map(move |change| {
            vec![
                cell(&change.name),
                cell(format!("{:.3} s", swap.time_s)),
                cell(swap.tick),
                cell(change.old),
                cell(change.new),
            ]
        })
    });
    table(&["parameter", "at", "tick", "old", "new"], rows)
}
