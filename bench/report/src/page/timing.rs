//! Latency: where the time goes, how each series is distributed, missed deadlines.

use maud::{Markup, html};

use crate::beside::Beside;
use crate::page::figures::Figures;
use crate::page::histograms;
use crate::page::parts::{Key, cell, chart, count, figure, section as part, table, us, us_if_known};
use crate::plot::bars::{Bar, bars};
use crate::plot::scale::Scale;
use crate::plot::{Axis, Chart, Layer};
use crate::schema::Report;
use crate::speed::Speed;
use crate::tally::distribution::{Distribution, PERCENTS, Percentile};
use crate::tally::series::Statistics;
use crate::text::beside::rows;
use crate::traces::{LOOP, WAKE};

/// A tick in the order of the data's way: series and colour.
const STAGES: [(&str, &str); 8] = [
    ("wake.plant", "plant"),
    ("compute.plant", "plant"),
    ("hop.plant_outer", "outer"),
    ("compute.outer", "outer"),
    ("hop.outer_inner", "inner"),
    ("compute.inner", "inner"),
    ("hop.inner_mixer", "mixer"),
    ("compute.mixer", "mixer"),
];

/// The section.
pub fn section(report: &Report) -> Markup {
    part(
        "latency",
        "Latency",
        html! {
            (histograms::section(report))
            (waterfall(report))
            (over_time(report))
            (misses(report))
            (curves(report))
            (percentiles(report))
            (intervals(report))
        },
    )
}

fn waterfall(report: &Report) -> Markup {
    type Pick = fn(&Statistics) -> Option<f64>;
    let percentiles: [(&str, &str, Pick); 3] =
        [("p50", "p50", |s| Some(s.p50_us)), ("p99", "p99", |s| Some(s.p99_us)), ("p999", "p99.9", |s| s.p999_us)];
    html! {
        h3 { "Where the time goes" }
        div.plots {
            @for (name, title, pick) in percentiles {
                @let stages = stage_bars(report, pick);
                @let caption = format!("A tick at {title}");
                @if stages.is_empty() {
                    (figure(&format!("waterfall-{name}"), &caption, &[], html! { p.note { "Too few values." } }))
                } @else {
                    (figure(&format!("waterfall-{name}"), &caption, &[], bars(&caption, "us", &stages)))
                }
            }
        }
        p.note {
            "Each stage's bar begins where the one before it ended. Percentiles do not add up: the loop's p99 is not the "
            "sum of its stages' p99, because other ticks are slow in other stages. The loop runs from the sampling of the "
            "state, after the wake-up, to the publishing of the rotor command."
        }
    }
}

/// The stages and the loop; nothing where one of them has too few values.
fn stage_bars(report: &Report, pick: fn(&Statistics) -> Option<f64>) -> Vec<Bar> {
    let value = |name: &str| report.series(name).and_then(pick);
    let mut end = 0.0;
    let mut all = Vec::new();
    for (name, class) in STAGES {
        // In lockstep nothing is late.
        let without = report.run.speed() == Speed::Lockstep && name == STAGES[0].0;
        let value = match value(name) {
            Some(value) => value,
            None if without => continue,
            None => return Vec::new(),
        };
        all.push(Bar { label: name.into(), class, from: end, to: end + value, number: us(value) });
        end += value;
    }
    let whole = |to: f64| Bar { label: "loop".into(), class: "loop", from: 0.0, to, number: us(to) };
    all.extend(value("loop").map(whole));
    all
}

fn over_time(report: &Report) -> Markup {
    let Some(traces) = &report.traces else { return html! {} };
    let figures = Figures::of(traces, report);
    let tick_us = Some(report.run.wall_period_us).filter(|us| *us > 0.0);
    html! {
        h3 { "Over time" }
        div.plots {
            (chart("loop", "Loop: from the state to the rotor command", &[], &figures.latency("loop", LOOP, tick_us)))
            @if tick_us.is_some() {
                (chart("wake", "Lateness of the plant's wake-up", &[], &figures.latency("plant", WAKE, tick_us)))
            }
            @if !report.deadlines.stretches.is_empty() {
                (chart("late", "Late commands: lateness", &[], &figures.late()))
            }
        }
        p.note {
            "Lines reach the smallest and the largest value of every " (count(traces.timing.every_ticks, "tick")) "."
        }
    }
}

fn curves(report: &Report) -> Markup {
    let groups: [(&str, &str, &[Key<'_>]); 7] = [
        (
            "curve-loop",
            "Loop, slack, lateness of late commands",
            &[("loop", "loop"), ("floor", "raw futex ring"), ("slack", "slack"), ("late", "late")],
        ),
        ("curve-wake", "Wake-up against the grid", &WAKES_AND_FLOOR),
        ("curve-timer", "The plant's timer against the instant that it was set to", &TIMER),
        ("curve-hop", "Hops", &HOPS),
        ("curve-compute", "Computing", &COMPUTE),
        ("curve-busy", "Busy", &BUSY),
        ("curve-period", "Between two wake-ups", &PERIODS),
    ];
    if report.distributions.is_empty() {
        return html! {};
    }
    html! {
        h3 { "Percentiles" }
        div.plots {
            @for (name, title, keys) in groups {
                @let known: Vec<Key<'_>> = keys.iter().copied().filter(|(_, series)| distribution(report, series).is_some()).collect();
                @if !known.is_empty() { (chart(name, title, &known, &curve(report, title, &known))) }
            }
        }
        p.note { "The largest of n values stands at 1 - 1/2n. " (floors_note(report)) }
        @if let Some(beside) = &report.beside { (floors(report, beside)) }
    }
}

fn floors_note(report: &Report) -> String {
    match &report.beside {
        Some(_) => "The dashed lines are the machine's floors, measured right after the flight.".into(),
        None => "The machine's floors were not measured; `ironbird fly --floor 11s` adds them.".into(),
    }
}

/// The flight's percentiles beside the floors'.
fn floors(report: &Report, beside: &Beside) -> Markup {
    let rows = rows(beside, report).map(|(name, values, digits)| {
        let value = |value: Option<f64>| value.map_or_else(|| "-".into(), |value| format!("{value:.digits$}"));
        std::iter::once(cell(name)).chain(values.map(|it| cell(value(it)))).collect()
    });
    html! {
        h3 { "Beside the machine's floors [us]" }
        (table(&["", "p50", "p99", "p99.9"], rows))
        p.note {
            "Each measured for " (beside.seconds) " s right after the flight (" (beside.scheduling) ", the host stole "
            (format!("{:.2} %", beside.steal.percent)) "). The timer does nothing but wake; the ring's four processes hand on a "
            "token and compute as long as the laws did in the median."
            @for refused in &beside.refused { " Refused: " (refused) "." }
        }
    }
}

/// The timer of the plant, in its colour.
pub const TIMER: [Key<'static>; 1] = [("plant", "timer")];
/// Series of the stages, each in its colour.
pub const WAKES: [Key<'static>; 4] =
    [("plant", "wake.plant"), ("outer", "wake.outer"), ("inner", "wake.inner"), ("mixer", "wake.mixer")];
/// Likewise.
pub const HOPS: [Key<'static>; 3] =
    [("outer", "hop.plant_outer"), ("inner", "hop.outer_inner"), ("mixer", "hop.inner_mixer")];
/// Likewise.
pub const COMPUTE: [Key<'static>; 4] =
    [("plant", "compute.plant"), ("outer", "compute.outer"), ("inner", "compute.inner"), ("mixer", "compute.mixer")];
/// Likewise.
pub const BUSY: [Key<'static>; 4] =
    [("plant", "busy.plant"), ("outer", "busy.outer"), ("inner", "busy.inner"), ("mixer", "busy.mixer")];
/// Likewise.
pub const PERIODS: [Key<'static>; 4] =
    [("plant", "period.plant"), ("outer", "period.outer"), ("inner", "period.inner"), ("mixer", "period.mixer")];

const WAKES_AND_FLOOR: [Key<'static>; 5] = [WAKES[0], ("floor", "bare timer"), WAKES[1], WAKES[2], WAKES[3]];

/// The series of a flight, and its floor by the name of what was measured.
fn distribution<'a>(report: &'a Report, series: &str) -> Option<&'a Distribution> {
    let floors = report.beside.iter().flat_map(|beside| &beside.floors).map(|floor| &floor.distribution);
    report.distributions.iter().chain(floors).find(|distribution| distribution.name == series)
}

fn curve(report: &Report, title: &str, keys: &[Key<'static>]) -> Chart {
    let all: Vec<(&'static str, &Distribution)> =
        keys.iter().filter_map(|(class, series)| Some((*class, distribution(report, series)?))).collect();
    let points = || all.iter().flat_map(|(_, distribution)| &distribution.curve);
    Chart {
        title: format!("percentiles: {title}"),
        x: Axis::new(Scale::tail(points().map(|point| point.0).fold(0.0, f64::max)), "percentile"),
        y: Axis::new(Scale::log(points().map(|point| point.1)), "us"),
        layers: all.iter().map(|(class, d)| Layer::Line { class, points: d.curve.clone() }).collect(),
        lanes: Vec::new(),
        height: crate::plot::HEIGHT,
    }
}

fn misses(report: &Report) -> Markup {
    let deadlines = &report.deadlines;
    let ticks = |number: u64| count(number, "tick");
    if report.run.speed() == Speed::Lockstep {
        return html! { p { "In lockstep there are no deadlines." } };
    }
    html! {
        h3 { "Missed deadlines" }
        p {
            (deadlines.missed) " missed by the plant's verdict (" (format!("{:.1}", deadlines.missed_ppm))
            " per million ticks), " (deadlines.missed_by_stamps) " by the stamps of the commands."
        }
        @if !deadlines.stretches.is_empty() {
            details {
                summary { "Late commands, one by one" }
                (table(&["at", "tick", "length", "largest lateness [us]"], deadlines.stretches.iter().map(|stretch| {
                    vec![
                        cell(format!("{:.3} s", stretch.time_s)),
                        cell(stretch.tick),
                        cell(ticks(stretch.length_ticks)),
                        cell(us(stretch.late_us)),
                    ]
                })))
                @if deadlines.stretches_left_out > 0 {
                    p.note { "and " (deadlines.stretches_left_out) " late commands in later stretches" }
                }
            }
        }
    }
}

fn percentiles(report: &Report) -> Markup {
    html! {
        h3 { "Series [us]" }
        (table(&["series", "count", "min", "p50", "p90", "p99", "p99.9", "p99.99", "max"], report.series.iter().map(|s| {
            vec![
                cell(&s.name),
                cell(s.count),
                cell(us(s.min_us)),
                cell(us(s.p50_us)),
                cell(us(s.p90_us)),
                cell(us(s.p99_us)),
                cell(us_if_known(s.p999_us)),
                cell(us_if_known(s.p9999_us)),
                cell(us(s.max_us)),
            ]
        })))
        p.note { "-: too few values. On a shared machine the maximum mostly shows the host. No sample was discarded." }
    }
}

/// The percentiles again, with what the number of values says of them.
fn intervals(report: &Report) -> Markup {
    let columns: Vec<String> = PERCENTS.iter().map(|(percent, _)| format!("p{percent}")).collect();
    let columns: Vec<&str> = std::iter::once("series").chain(columns.iter().map(String::as_str)).collect();
    let interval = |of: &Percentile| cell(format!("{} to {}", us(of.low_us), us(of.high_us)));
    let rows = report.distributions.iter().map(|series| {
        let of = |percent: f64| series.percentile(percent).map_or_else(|| cell("-"), interval);
        std::iter::once(cell(&series.name)).chain(PERCENTS.map(|(percent, _)| of(percent))).collect()
    });
    html! {
        @if !report.distributions.is_empty() {
            details {
                summary { "What the number of values says of each percentile" }
                (table(&columns, rows))
                p.note {
                    "With 95 % the percentile [us] that endless sampling would give lies in its interval, if ticks do not "
                    "depend on each other. They do: the true interval is wider."
                }
            }
        }
    }
}
