//! Latency: how each series is distributed, where the time goes, and percentiles.

use crate::distribution::{Bin, Distribution};
use crate::phrase::count;
use crate::render::document::{Block, Figure, us};
use crate::render::figures::Figures;
use crate::render::flight::percentiles;
use crate::render::plot::{Axis, Chart, LANE, Lane, Layer, MARKS};
use crate::render::scale::Scale;
use crate::schema::Report;
use crate::series::Statistics;
use crate::speed::Speed;

type Key = (&'static str, &'static str);

/// A tick in the order of the data's way: colour of a bar and series.
const STAGES: [Key; 8] = [
    ("bar plant", "wake.plant"),
    ("bar plant", "compute.plant"),
    ("bar outer", "hop.plant_outer"),
    ("bar outer", "compute.outer"),
    ("bar inner", "hop.outer_inner"),
    ("bar inner", "compute.inner"),
    ("bar mixer", "hop.inner_mixer"),
    ("bar mixer", "compute.mixer"),
];

/// A group of series: name, title, colour of each, and how their histogram is drawn.
type Group = (&'static str, &'static str, &'static [Key], Value);

const GROUPS: [Group; 8] = [
    (
        "loop",
        "Loop",
        &[("loop", "loop"), ("floor", "raw futex ring")],
        Value::Bare,
    ),
    (
        "wake",
        "Wake-up against the grid",
        &[
            ("plant", "wake.plant"),
            ("floor", "bare timer"),
            ("outer", "wake.outer"),
            ("inner", "wake.inner"),
            ("mixer", "wake.mixer"),
        ],
        Value::Bare,
    ),
    (
        "timer",
        "The plant's timer against the instant that it was set to",
        &[("plant", "timer")],
        Value::Bare,
    ),
    (
        "hop",
        "Hops",
        &[
            ("outer", "hop.plant_outer"),
            ("inner", "hop.outer_inner"),
            ("mixer", "hop.inner_mixer"),
        ],
        Value::Bare,
    ),
    (
        "period",
        "Period: between two wake-ups",
        &[
            ("plant", "period.plant"),
            ("outer", "period.outer"),
            ("inner", "period.inner"),
            ("mixer", "period.mixer"),
        ],
        Value::LessTick,
    ),
    (
        "deadline",
        "Commands against their deadline",
        &[("slack", SLACK), ("late", "late")],
        Value::Late,
    ),
    (
        "compute",
        "Computing",
        &[
            ("plant", "compute.plant"),
            ("outer", "compute.outer"),
            ("inner", "compute.inner"),
            ("mixer", "compute.mixer"),
        ],
        Value::Bare,
    ),
    (
        "busy",
        "Busy",
        &[
            ("plant", "busy.plant"),
            ("outer", "busy.outer"),
            ("inner", "busy.inner"),
            ("mixer", "busy.mixer"),
        ],
        Value::Bare,
    ),
];

const SLACK: &str = "slack";

#[must_use]
pub fn blocks(report: &Report) -> Vec<Block> {
    let mut blocks = percentiles(report);
    if !report.distributions.is_empty() {
        blocks.push(Block::PageHeading("Histograms"));
        blocks.push(Block::Figures(histograms(report)));
        blocks.push(Block::Note(
            "Every value is in its bin. Above histograms of latencies, a row for each series: a bar at p50, a diamond at \
             p99, a square at p99.9, a cross at the largest value. A percentile stands there if it has enough values. \
             Differences are linear up to 10 us and logarithmic beyond."
                .into(),
        ));
    }
    blocks.push(Block::PageHeading("Where the time goes"));
    blocks.push(Block::Figures(waterfalls(report)));
    blocks.push(Block::Note(
        "Each stage's bar begins where the one before it ended. Percentiles do not add up: the loop's p99 is not the sum \
         of its stages' p99, because other ticks are slow in other stages. The loop runs from the sampling of the state, \
         after the wake-up, to the publishing of the rotor command."
            .into(),
    ));
    if let Some(figures) = Figures::of(report) {
        let tick_us = Some(report.run.wall_period_us).filter(|us| *us > 0.0);
        blocks.push(Block::PageHeading("Over time"));
        blocks.push(Block::Figures(figures.latencies(tick_us)));
        let stretch = count(figures.traces.timing.every_ticks, "tick");
        let note = format!("Lines reach the smallest and the largest value of every {stretch}.");
        blocks.push(Block::Note(note));
    }
    if !report.distributions.is_empty() {
        blocks.push(Block::PageHeading("Percentiles"));
        blocks.push(Block::Figures(curves(report)));
        let floors = match &report.beside {
            Some(_) => {
                "The dashed lines are the machine's floors, measured right after the flight."
            }
            None => "The machine's floors were not measured; `ironbird fly --floor 11s` adds them.",
        };
        blocks.push(Block::Note(format!(
            "The largest of n values stands at 1 - 1/2n. {floors}"
        )));
    }
    blocks
}

fn waterfalls(report: &Report) -> Vec<Figure> {
    type Pick = fn(&Statistics) -> Option<f64>;
    let percentiles: [(&str, &str, Pick); 3] = [
        ("p50", "p50", |s| Some(s.p50_us)),
        ("p99", "p99", |s| Some(s.p99_us)),
        ("p999", "p99.9", |s| s.p999_us),
    ];
    let figure = |(name, percentile, pick): (&str, &str, Pick)| {
        let title = format!("A tick at {percentile}");
        let chart = waterfall(report, &title, pick)?;
        Some(Figure::new(
            format!("waterfall-{name}"),
            title,
            Vec::new(),
            chart,
        ))
    };
    percentiles.into_iter().filter_map(figure).collect()
}

/// The stages and the loop; none where one of them has too few values.
fn waterfall(report: &Report, title: &str, pick: fn(&Statistics) -> Option<f64>) -> Option<Chart> {
    let value = |name: &str| report.series(name).and_then(pick);
    // In lockstep nothing is late.
    let first = usize::from(report.run.speed() == Speed::Lockstep && value(STAGES[0].1).is_none());
    let mut end = 0.0;
    let mut bars = Vec::new();
    for (class, name) in &STAGES[first..] {
        let value = value(name)?;
        bars.push((*class, *name, end, end + value));
        end += value;
    }
    bars.extend(value("loop").map(|whole| ("bar loop", "loop", 0.0, whole)));
    let longest = bars.iter().map(|bar| bar.3).fold(0.0, f64::max);
    let names = bars.iter().map(|bar| bar.1.to_owned()).collect();
    let layer = |(i, (class, _, from, to)): (usize, (&'static str, &str, f64, f64))| {
        let corners = [(from, i as f64 + 0.2), (to, i as f64 + 0.8)];
        let boxes = vec![(corners, String::new(), us(to - from))];
        Layer::Boxes { class, boxes }
    };
    // Room for the number behind the longest bar.
    let x = Axis::new(Scale::time(0.0, 1.15 * longest), "us");
    let y = Axis::new(Scale::Rows(names), "");
    Some(Chart::new(
        title,
        x,
        y,
        bars.into_iter().enumerate().map(layer).collect(),
    ))
}

fn keys(all: &[(&'static str, &Distribution)]) -> Vec<(&'static str, String)> {
    all.iter()
        .map(|(class, series)| (*class, series.name.clone()))
        .collect()
}

/// Percentiles of the series of each group, with the machine's floors.
fn curves(report: &Report) -> Vec<Figure> {
    let floors = report.beside.iter().flat_map(|beside| &beside.floors);
    let floors: Vec<&Distribution> = floors.map(|floor| &floor.distribution).collect();
    let figure = |(name, title, series, _): &Group| {
        let find = |name: &str| {
            let mut all = report.distributions.iter().chain(floors.iter().copied());
            all.find(|distribution| distribution.name == name)
        };
        let all = series
            .iter()
            .filter_map(|(class, name)| Some((*class, find(name)?)));
        let all: Vec<(&'static str, &Distribution)> = all.collect();
        let points = || all.iter().flat_map(|(_, distribution)| &distribution.curve);
        let x = Scale::tail(points().map(|point| point.0).fold(0.0, f64::max));
        let y = Scale::log(points().map(|point| point.1));
        let lines = all.iter().map(|(class, it)| Layer::Line {
            class,
            points: it.curve.clone(),
        });
        let chart = Chart::new(
            format!("percentiles: {title}"),
            Axis::new(x, "percentile"),
            Axis::new(y, "us"),
            lines.collect(),
        );
        (!all.is_empty()).then(|| Figure::new(format!("curve-{name}"), *title, keys(&all), chart))
    };
    GROUPS.iter().filter_map(figure).collect()
}

fn histograms(report: &Report) -> Vec<Figure> {
    let mut figures = Vec::new();
    for (name, title, series, value) in &GROUPS {
        let find = |name: &str| report.distributions.iter().find(|it| it.name == name);
        let all = series
            .iter()
            .filter_map(|(class, name)| Some((*class, find(name)?)));
        let all: Vec<(&'static str, &Distribution)> = all.collect();
        if !all.is_empty() {
            let chart = histogram(report, title, &all, *value);
            figures.push(Figure::new(
                format!("histogram-{name}"),
                *title,
                keys(&all),
                chart,
            ));
        }
    }
    if !report.deadlines.runs.is_empty() {
        figures.push(miss_runs(report));
    }
    figures
}

/// What of a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Value {
    Bare,
    /// Their difference from the length of a tick.
    LessTick,
    /// How late they are: slack is to be early.
    Late,
}

fn histogram(
    report: &Report,
    title: &str,
    all: &[(&'static str, &Distribution)],
    value: Value,
) -> Chart {
    let tick_us = report.run.wall_period_us;
    // In lockstep ticks have no length.
    let value = if value == Value::LessTick && tick_us == 0.0 {
        Value::Bare
    } else {
        value
    };
    let shift_us = if value == Value::LessTick {
        tick_us
    } else {
        0.0
    };
    let bins = |series: &Distribution| -> Vec<(f64, f64, f64)> {
        let bin = |bin: &Bin| {
            let (from, below) = (bin.from_us - shift_us, bin.below_us - shift_us);
            let is_early = value == Value::Late && series.name == SLACK;
            let (from, below) = if is_early {
                (-below, -from)
            } else {
                (from, below)
            };
            (from, below, bin.count as f64)
        };
        let mut bins: Vec<_> = series.bins.iter().map(bin).collect();
        bins.sort_by(|a, b| a.0.total_cmp(&b.0));
        bins
    };
    let all_bins: Vec<_> = all
        .iter()
        .map(|(class, series)| (*class, bins(series)))
        .collect();
    let each = || all_bins.iter().flat_map(|(_, bins)| bins);
    let most = each().map(|bin| bin.2).fold(1.0, f64::max);
    let edges = each().flat_map(|bin| [bin.0, bin.1]);
    let (x, label) = match value {
        Value::Bare => (Scale::log(edges), "latency [us]"),
        Value::LessTick => (around_zero(edges), "difference from a tick [us]"),
        Value::Late => (around_zero(edges), "late by [us]"),
    };
    let zero = match value {
        Value::Bare => None,
        Value::LessTick => Some(format!("a tick: {tick_us} us")),
        Value::Late => Some("the deadline".into()),
    };
    let steps = all_bins
        .into_iter()
        .map(|(class, bins)| Layer::Steps { class, bins });
    let zero = zero.map(|word| Layer::Verticals {
        class: "deadline",
        at: vec![(0.0, word)],
    });
    let (x, y) = (Axis::new(x, label), counts(most));
    let mut chart = Chart::new(
        format!("histogram: {title}"),
        x,
        y,
        steps.chain(zero).collect(),
    );
    if value != Value::Late {
        let lane = |(class, series): &(&'static str, &Distribution)| {
            Some(lane(class, report.series(&series.name)?, shift_us))
        };
        chart.lanes = all.iter().filter_map(lane).collect();
        chart.height += LANE * chart.lanes.len() as f64;
    }
    chart
}

/// An axis of differences, with room for what stands at its ends, and for 0.
fn around_zero(edges: impl Iterator<Item = f64>) -> Scale {
    /// Where it becomes logarithmic [us].
    const THRESHOLD_US: f64 = 10.0;
    let (low, high) = edges.fold((0.0_f64, 0.0_f64), |(low, high), edge| {
        (low.min(edge), high.max(edge))
    });
    let beyond = |end: f64| 1.2 * end + 0.5 * THRESHOLD_US;
    Scale::Symmetric {
        threshold: THRESHOLD_US,
        low: -beyond(-low),
        high: beyond(high),
    }
}

/// The axis of counts up to `most`: its foot is below 1, so that a single value is seen.
fn counts(most: f64) -> Axis {
    let (low, high) = (0.6, (most * 1.6).max(12.0));
    Axis::new(Scale::Log { low, high }, "count")
}

/// Percentiles of a series and its largest value.
fn lane(class: &'static str, series: &Statistics, shift_us: f64) -> Lane {
    let places = [
        Some(series.p50_us),
        Some(series.p99_us),
        series.p999_us,
        Some(series.max_us),
    ];
    let marks = places
        .into_iter()
        .enumerate()
        .filter_map(|(mark, place_us)| {
            let place_us = place_us?;
            let word = format!("{}: {} {} us", series.name, MARKS[mark], us(place_us));
            Some((mark, place_us - shift_us, word))
        });
    let marks = marks.collect();
    Lane { class, marks }
}

fn miss_runs(report: &Report) -> Figure {
    let runs = report.deadlines.runs.iter().map(|run| {
        let length = run.length_ticks as f64;
        (length - 0.5, length + 0.5, run.count as f64)
    });
    let bins: Vec<(f64, f64, f64)> = runs.collect();
    let x = Scale::log(bins.iter().flat_map(|(from, below, _)| [*from, *below]));
    let y = counts(bins.iter().map(|bin| bin.2).fold(1.0, f64::max));
    let layers = vec![Layer::Steps {
        class: "late",
        bins,
    }];
    let title = "Deadlines missed in a row";
    let chart = Chart::new(
        format!("histogram: {title}"),
        Axis::new(x, "ticks in a row"),
        y,
        layers,
    );
    Figure::new("miss-runs", title, Vec::new(), chart)
}
