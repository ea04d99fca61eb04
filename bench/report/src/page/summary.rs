//! The head of the page: what was flown, how it went in three words, the contents; gates and swaps.

use maud::{Markup, html};

use crate::page::parts::{self, cell, table, us};
use crate::schema::Report;
use crate::status::FlightStatus;
use crate::swaps::seconds;
use crate::text;
use crate::words::{FlightWord, TheoremWord, TimingWord, Words};
use crate::{laws, losses, margin};

/// What was flown, the three words, key numbers.
pub fn head(report: &Report) -> Markup {
    let run = &report.run;
    let verdict = &report.verdict;
    let failed = verdict.status != FlightStatus::Pass && !run.in_flight;
    html! {
        header {
            h1 {
                (run.flown()) " "
                span.verdict.bad[failed] { (verdict.words()) }
            }
            (words(report))
            @for sentence in losses::sentences(report) { p.bad { (sentence) } }
            @if !run.last_words.is_empty() { p { (run.ending) ". What it said last:" } pre { (run.last_words.join("\n")) } }
            (tiles(report))
            @if let Some(margin) = margin::line::sentence(report) { p { "Margin: " (margin) "." } }
            p {
                (run.started) ", instance " (run.instance) ", "
                @if run.in_flight { "in flight: numbers so far, plots come with its end" } @else { (run.ending) }
                ". " (text::pace(report)) ". Laws: " (laws::flown(&run.laws)) ". " (text::machine(report)) ". Real time here: " (text::here(report)) "."
            }
        }
    }
}

/// Whether a word is good news, bad news, or neither.
fn tones(words: &Words) -> [&'static str; 3] {
    let flight = match words.flight.word {
        FlightWord::Tracked => "good",
        FlightWord::OffTrack | FlightWord::Lost => "bad",
        FlightWord::NotSeen => "open",
    };
    let timing = match words.timing.word {
        TimingWord::InTime => "good",
        TimingWord::Late => "bad",
        TimingWord::NotMeasured => "open",
    };
    let theorem = match words.theorem.word {
        TheoremWord::Holds => "good",
        TheoremWord::Broken => "bad",
        TheoremWord::NotApplicable | TheoremWord::PartlyWatched => "open",
    };
    [flight, timing, theorem]
}

fn words(report: &Report) -> Markup {
    html! {
        dl.words {
            @for ((subject, word, why), tone) in report.words.each().into_iter().zip(tones(&report.words)) {
                div.(tone) { dt { (subject) } dd.word { (word) } dd.why { (why) } }
            }
        }
    }
}

/// The way to each section, always in sight, and the switch of what is drawn in all charts.
pub fn contents(report: &Report) -> Markup {
    let has_outages = !report.autopsy.classes.is_empty();
    let has_miss_lines = report.traces.is_some() && !report.deadlines.stretches.is_empty();
    html! {
        nav {
            @for (id, title) in [
                ("latency", "Latency"),
                ("outages", "Outages"),
                ("gates", "Gates"),
                ("flight", "Flight"),
                ("theorem", "Theorem"),
                ("setup", "Processes and machine"),
            ] {
                @if id != "outages" || has_outages { a href=(format!("#{id}")) { (title) } }
            }
            @if has_miss_lines {
                label { input #miss-lines type="checkbox" checked; "missed deadlines in charts" }
            }
        }
    }
}

fn tiles(report: &Report) -> Markup {
    let series = |name: &str| report.series(name);
    let tile = |title: &str, value: String, unit: &str| {
        html! { div { dt { (title) } dd { (value) " " span.unit { (unit) } } } }
    };
    let missed = &report.deadlines;
    let error_m = report.flight.position_error_rms_m;
    let (error, unit) = if error_m < 1.0 { (error_m * 1e3, "mm") } else { (error_m, "m") };
    html! {
        dl.tiles {
            @if let Some(whole) = series("loop") {
                (tile("loop p50", us(whole.p50_us), "us"))
                (tile("loop p99", us(whole.p99_us), "us"))
                @match whole.p999_us {
                    Some(value) => (tile("loop p99.9", us(value), "us")),
                    None => (tile("loop p99.9", "-".into(), "too few values")),
                }
            }
            @if let Some(wake) = series("wake.plant") { (tile("wake p99", us(wake.p99_us), "us")) }
            @if report.run.wall_period_us > 0.0 {
                (tile("deadlines missed", missed.missed.to_string(), &format!("{:.1} ppm", missed.missed_ppm)))
            }
            (tile("ticks flown", report.ticks.run.to_string(), ""))
            (tile("ticks skipped", report.ticks.skipped.to_string(), ""))
            (tile("position error rms", format!("{error:.3}"), unit))
        }
    }
}

/// Gates and swaps.
pub fn section(report: &Report) -> Markup {
    let ticks = &report.ticks;
    let sum = ticks.run + ticks.skipped;
    parts::section(
        "gates",
        "Gates",
        html! {
            p {
                "Ticks: run " (ticks.run) " + skipped " (ticks.skipped) " = " (sum) " "
                @if ticks.identity_holds { "=" } @else { strong { "is not" } }
                " elapsed " (format!("{:.3}", ticks.elapsed_s)) " s / period = " (ticks.elapsed_periods) "."
            }
            (table(&["gate", "found", "allowed", ""], report.verdict.gates.iter().map(|gate| {
                let word = if gate.held { "held" } else { "FAILED" };
                vec![
                    cell(&gate.name),
                    cell(&gate.value),
                    cell(&gate.limit),
                    html! { span.good[gate.held].bad[!gate.held] { (word) } },
                ]
            })))
            h3 { "Live swaps" }
            @if report.swaps.is_empty() { p { "No parameter of the airframe was swapped." } }
            @else { (swaps(report)) }
            @if report.swaps_left_out > 0 { p { "And " (report.swaps_left_out) " later ones." } }
            @if !report.faults.is_empty() {
                h3 { "Faults" }
                (faults(report))
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
                cell(if change.over_s > 0.0 { seconds(change.over_s) } else { "at once".into() }),
            ]
        })
    });
    table(&["parameter", "at", "tick", "old", "new", "over"], rows)
}

fn faults(report: &Report) -> Markup {
    let rows = report.faults.iter().map(|fault| {
        let how = if fault.live { "injected in flight" } else { "planned" };
        vec![
            cell(&fault.what),
            cell(format!("{:.3} s", fault.time_s)),
            cell(fault.tick),
            cell(fault.until()),
            cell(how),
        ]
    });
    table(&["fault", "from", "tick", "until", "how"], rows)
}
