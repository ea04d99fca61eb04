//! Latency: where the time goes, how each series is distributed, missed deadlines.

use crate::baseline::Baseline;
use crate::distribution::{Bin, Distribution, PERCENTS, Percentile};
use crate::phrase::count;
use crate::render::baseline_text::rows;
use crate::render::figures::Figures;
use crate::render::html::{Key, cell, chart, figure, section as part, table, us, us_if_known};
use crate::render::plot::{Axis, Bar, Chart, HEIGHT, LANE, Lane, Layer, Mark, bars};
use crate::render::scale::Scale;
use crate::schema::{Report, RunLength};
use crate::series::Statistics;
use crate::speed::Speed;
use crate::traces::{LOOP, WAKE};
use maud::{Markup, html};

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

pub fn section(report: &Report) -> Markup {
    part(
        "latency",
        "Latency",
        html! {
            (histogram_section(report))
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
    let percentiles: [(&str, &str, Pick); 3] = [
        ("p50", "p50", |s| Some(s.p50_us)),
        ("p99", "p99", |s| Some(s.p99_us)),
        ("p999", "p99.9", |s| s.p999_us),
    ];
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
        all.push(Bar {
            label: name.into(),
            class,
            from: end,
            to: end + value,
            number: us(value),
        });
        end += value;
    }
    let whole = |to: f64| Bar {
        label: "loop".into(),
        class: "loop",
        from: 0.0,
        to,
        number: us(to),
    };
    all.extend(value("loop").map(whole));
    all
}

fn over_time(report: &Report) -> Markup {
    let Some(traces) = &report.traces else {
        return html! {};
    };
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
            &[
                ("loop", "loop"),
                ("floor", "raw futex ring"),
                ("slack", "slack"),
                ("late", "late"),
            ],
        ),
        ("curve-wake", "Wake-up against the grid", &WAKES_AND_FLOOR),
        (
            "curve-timer",
            "The plant's timer against the instant that it was set to",
            &TIMER,
        ),
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
        Some(_) => {
            "The dashed lines are the machine's floors, measured right after the flight.".into()
        }
        None => {
            "The machine's floors were not measured; `ironbird fly --floor 11s` adds them.".into()
        }
    }
}

/// The flight's percentiles beside the floors'.
fn floors(report: &Report, beside: &Baseline) -> Markup {
    let rows = rows(beside, report).map(|(name, values, digits)| {
        let value = |value: Option<f64>| {
            value.map_or_else(|| "-".into(), |value| format!("{value:.digits$}"))
        };
        std::iter::once(cell(name))
            .chain(values.map(|it| cell(value(it))))
            .collect()
    });
    html! {
        h3 { "Compared with the machine's baselines [us]" }
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
pub const WAKES: [Key<'static>; 4] = [
    ("plant", "wake.plant"),
    ("outer", "wake.outer"),
    ("inner", "wake.inner"),
    ("mixer", "wake.mixer"),
];
pub const HOPS: [Key<'static>; 3] = [
    ("outer", "hop.plant_outer"),
    ("inner", "hop.outer_inner"),
    ("mixer", "hop.inner_mixer"),
];
pub const COMPUTE: [Key<'static>; 4] = [
    ("plant", "compute.plant"),
    ("outer", "compute.outer"),
    ("inner", "compute.inner"),
    ("mixer", "compute.mixer"),
];
pub const BUSY: [Key<'static>; 4] = [
    ("plant", "busy.plant"),
    ("outer", "busy.outer"),
    ("inner", "busy.inner"),
    ("mixer", "busy.mixer"),
];
pub const PERIODS: [Key<'static>; 4] = [
    ("plant", "period.plant"),
    ("outer", "period.outer"),
    ("inner", "period.inner"),
    ("mixer", "period.mixer"),
];

const WAKES_AND_FLOOR: [Key<'static>; 5] = [
    WAKES[0],
    ("floor", "bare timer"),
    WAKES[1],
    WAKES[2],
    WAKES[3],
];

/// The series of a flight, and its floor by the name of what was measured.
fn distribution<'a>(report: &'a Report, series: &str) -> Option<&'a Distribution> {
    let floors = report
        .beside
        .iter()
        .flat_map(|beside| &beside.floors)
        .map(|floor| &floor.distribution);
    report
        .distributions
        .iter()
        .chain(floors)
        .find(|distribution| distribution.name == series)
}

fn curve(report: &Report, title: &str, keys: &[Key<'static>]) -> Chart {
    let all: Vec<(&'static str, &Distribution)> = keys
        .iter()
        .filter_map(|(class, series)| Some((*class, distribution(report, series)?)))
        .collect();
    let points = || all.iter().flat_map(|(_, distribution)| &distribution.curve);
    Chart {
        title: format!("percentiles: {title}"),
        x: Axis::new(
            Scale::tail(points().map(|point| point.0).fold(0.0, f64::max)),
            "percentile",
        ),
        y: Axis::new(Scale::log(points().map(|point| point.1)), "us"),
        layers: all
            .iter()
            .map(|(class, d)| Layer::Line {
                class,
                points: d.curve.clone(),
            })
            .collect(),
        lanes: Vec::new(),
        height: HEIGHT,
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
    let columns: Vec<String> = PERCENTS
        .iter()
        .map(|(percent, _)| format!("p{percent}"))
        .collect();
    let columns: Vec<&str> = std::iter::once("series")
        .chain(columns.iter().map(String::as_str))
        .collect();
    let interval = |of: &Percentile| cell(format!("{} to {}", us(of.low_us), us(of.high_us)));
    let rows = report.distributions.iter().map(|series| {
        let of = |percent: f64| {
            series
                .percentile(percent)
                .map_or_else(|| cell("-"), interval)
        };
        std::iter::once(cell(&series.name))
            .chain(PERCENTS.map(|(percent, _)| of(percent)))
            .collect()
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

/// Where the axis of a difference becomes logarithmic [us].
const THRESHOLD_US: f64 = 10.0;

/// The pictures; none while the flight is in the air.
fn histogram_section(report: &Report) -> Markup {
    if report.distributions.is_empty() {
        return html! {};
    }
    let (latency, bare) = ("latency [us]", Value::Bare);
    let pictures: [(&str, &str, &[Key<'static>], &str, Value); 8] = [
        ("histogram-loop", "Loop", &[("loop", "loop")], latency, bare),
        (
            "histogram-wake",
            "Wake-up against the grid",
            &WAKES,
            latency,
            bare,
        ),
        (
            "histogram-timer",
            "The plant's timer against the instant that it was set to",
            &TIMER,
            latency,
            bare,
        ),
        ("histogram-hop", "Hops", &HOPS, latency, bare),
        period(report),
        (
            "histogram-deadline",
            "Commands against their deadline",
            &DEADLINE,
            "late by [us]",
            Value::Late,
        ),
        ("histogram-compute", "Computing", &COMPUTE, latency, bare),
        ("histogram-busy", "Busy", &BUSY, latency, bare),
    ];
    html! {
        h3 { "Histograms" }
        div.plots {
            @for (name, title, keys, label, value) in pictures {
                @let all = found(report, keys);
                @if !all.is_empty() {
                    @let keys: Vec<Key<'_>> = all.iter().map(|(class, series)| (*class, series.name.as_str())).collect();
                    (chart(name, title, &keys, &picture(report, title, label, &all, value)))
                }
                @if name == "histogram-deadline" && !report.deadlines.runs.is_empty() {
                    (chart("miss-runs", "Deadlines missed in a row", &[], &miss_runs(report)))
                }
            }
        }
        p.note {
            "Every value is in its bin. Above histograms of latencies, a row for each series:"
            @for mark in Mark::ALL { " " span.nobreak { (mark.sample()) " " (mark.words()) } }
            ". A percentile stands there if it has enough values. Differences are linear up to 10 us and logarithmic beyond."
        }
    }
}

const DEADLINE: [Key<'static>; 2] = [("slack", "slack"), ("late", "late")];

/// What of a series is drawn.
#[derive(Clone, Copy, Debug)]
enum Value {
    Bare,
    /// Their difference from the length of a tick [us].
    LessTick(f64),
    /// How late they are: slack is to be early.
    Late,
}

type Picture = (
    &'static str,
    &'static str,
    &'static [Key<'static>],
    &'static str,
    Value,
);

fn period(report: &Report) -> Picture {
    let tick_us = report.run.wall_period_us;
    let (label, value) = if tick_us > 0.0 {
        ("difference from a tick [us]", Value::LessTick(tick_us))
    } else {
        ("latency [us]", Value::Bare)
    };
    (
        "histogram-period",
        "Period: between two wake-ups",
        &PERIODS,
        label,
        value,
    )
}

fn found<'a>(report: &'a Report, keys: &[Key<'static>]) -> Vec<(&'static str, &'a Distribution)> {
    let of = |name: &str| {
        report
            .distributions
            .iter()
            .find(|distribution| distribution.name == name)
    };
    keys.iter()
        .filter_map(|(class, series)| Some((*class, of(series)?)))
        .collect()
}

fn picture(
    report: &Report,
    title: &str,
    label: &str,
    all: &[(&'static str, &Distribution)],
    value: Value,
) -> Chart {
    let bins: Vec<(&'static str, Vec<Bin>)> = all
        .iter()
        .map(|(class, series)| (*class, value.of(series)))
        .collect();
    let each = || bins.iter().flat_map(|(_, bins)| bins);
    let most = each().map(|bin| bin.count).max().unwrap_or(1) as f64;
    let edges = each().flat_map(|bin| [bin.from_us, bin.below_us]);
    let lanes: Vec<Lane> = match value {
        Value::Late => Vec::new(),
        _ => all
            .iter()
            .filter_map(|(class, series)| lane(report, class, &series.name, value))
            .collect(),
    };
    Chart {
        title: format!("histogram: {title}"),
        x: Axis::new(value.scale(edges), label),
        y: counts(most),
        height: HEIGHT + LANE * lanes.len() as f64,
        lanes,
        layers: bins
            .into_iter()
            .map(|(class, bins)| steps(class, &bins))
            .chain(value.zero())
            .collect(),
    }
}

/// The axis of counts up to `most`: its foot is below 1, so that a single value is seen.
fn counts(most: f64) -> Axis {
    Axis::new(
        Scale::Log {
            low: 0.6,
            high: (most * 1.6).max(12.0),
        },
        "count",
    )
}

fn miss_runs(report: &Report) -> Chart {
    let runs = &report.deadlines.runs;
    let bin = |run: &RunLength| {
        (
            run.length_ticks as f64 - 0.5,
            run.length_ticks as f64 + 0.5,
            run.count as f64,
        )
    };
    let bins: Vec<(f64, f64, f64)> = runs.iter().map(bin).collect();
    Chart {
        title: "histogram: deadlines missed in a row".into(),
        x: Axis::new(
            Scale::log(bins.iter().flat_map(|(from, below, _)| [*from, *below])),
            "ticks in a row",
        ),
        y: counts(bins.iter().map(|bin| bin.2).fold(1.0, f64::max)),
        lanes: Vec::new(),
        layers: vec![Layer::Steps {
            class: "late",
            bins,
        }],
        height: HEIGHT,
    }
}

fn steps(class: &'static str, bins: &[Bin]) -> Layer {
    Layer::Steps {
        class,
        bins: bins
            .iter()
            .map(|bin| (bin.from_us, bin.below_us, bin.count as f64))
            .collect(),
    }
}

/// Percentiles of a series and its largest value.
fn lane(report: &Report, class: &'static str, name: &str, value: Value) -> Option<Lane> {
    let series = report.series(name)?;
    let places = [
        Some(series.p50_us),
        Some(series.p99_us),
        series.p999_us,
        Some(series.max_us),
    ];
    let marks = Mark::ALL
        .into_iter()
        .zip(places)
        .filter_map(|(mark, place)| {
            let place = place?;
            Some((
                mark,
                value.place(place),
                format!("{name}: {} {} us", mark.words(), us(place)),
            ))
        });
    Some(Lane {
        class,
        marks: marks.collect(),
    })
}

impl Value {
    fn place(self, us: f64) -> f64 {
        match self {
            Self::LessTick(tick_us) => us - tick_us,
            _ => us,
        }
    }

    /// The bins as they are drawn.
    fn of(self, series: &Distribution) -> Vec<Bin> {
        let early = matches!(self, Self::Late) && series.name == DEADLINE[0].1;
        let moved = |bin: &Bin| match early {
            true => Bin {
                from_us: -bin.below_us,
                below_us: -bin.from_us,
                count: bin.count,
            },
            false => Bin {
                from_us: self.place(bin.from_us),
                below_us: self.place(bin.below_us),
                count: bin.count,
            },
        };
        let mut bins: Vec<Bin> = series.bins.iter().map(moved).collect();
        bins.sort_by(|a, b| a.from_us.total_cmp(&b.from_us));
        bins
    }

    fn scale(self, edges: impl Iterator<Item = f64>) -> Scale {
        if matches!(self, Self::Bare) {
            return Scale::log(edges);
        }
        let (low, high) = edges.fold((0.0, 0.0), |(low, high): (f64, f64), edge| {
            (low.min(edge), high.max(edge))
        });
        // Room for what stands at the ends, and for 0.
        let beyond = |end: f64| 1.2 * end + 0.5 * THRESHOLD_US;
        Scale::Symmetric {
            threshold: THRESHOLD_US,
            low: -beyond(-low),
            high: beyond(high),
        }
    }

    /// The line where a difference changes its sign.
    fn zero(self) -> Option<Layer> {
        let word = match self {
            Self::Bare => return None,
            Self::LessTick(tick_us) => format!("a tick: {tick_us} us"),
            Self::Late => "the deadline".into(),
        };
        Some(Layer::Verticals {
            class: "deadline",
            at: vec![(0.0, word)],
        })
    }
}
