//! Latency: how each series is distributed, where the time goes, and percentiles.

use crate::document::{Block, Column, Figure, Table, known, us};
use crate::figures::Figures;
use crate::plot::{Axis, Chart, Layer};
use crate::scale::{Kind, Scale};
use analysis::distribution::{Bin, Distribution};
use analysis::phrase::count;
use analysis::schema::{Report, Speed};
use analysis::series::{SLACK, Series, Statistics};
use messages::role::STAGES;

/// A tick in the order of the data's way.
const STEPS: [Series; 8] = {
    use Series::{Compute, Hop, Wake};
    let [plant, outer, inner, mixer] = STAGES;
    [
        Wake(plant),
        Compute(plant),
        Hop(plant, outer),
        Compute(outer),
        Hop(outer, inner),
        Compute(inner),
        Hop(inner, mixer),
        Compute(mixer),
    ]
};

/// Groups of series: the begin of their names, a title, the machine's floor, and how their histogram is drawn.
const GROUPS: [(&str, &str, &str, Value); 8] = {
    use Value::{Bare, Late, LessTick};
    const TIMER: &str = "The plant's timer against the instant that it was set to";
    [
        ("loop", "Loop", "raw futex ring", Bare),
        ("wake", "Wake-up against the grid", "bare timer", Bare),
        ("timer", TIMER, "", Bare),
        ("hop", "Hops", "", Bare),
        ("period", "Period: between two wake-ups", "", LessTick),
        ("deadline", "Commands against their deadline", "", Late),
        ("compute", "Computing", "", Bare),
        ("busy", "Busy", "", Bare),
    ]
};

fn group(series: &str) -> &str {
    match series {
        SLACK | "late" => "deadline",
        _ => series.split('.').next().unwrap_or(series),
    }
}

/// The colour of a series: that of the stage at its end.
fn class(series: &str) -> &'static str {
    let stages = ["plant", "outer", "inner", "mixer", "loop", SLACK, "late"];
    let class = stages.into_iter().find(|stage| series.ends_with(stage));
    class.unwrap_or("plant")
}

pub fn blocks(report: &Report) -> Vec<Block> {
    let mut blocks = percentiles(report);
    if !report.distributions.is_empty() {
        blocks.push(Block::PageHeading("Histograms"));
        blocks.push(Block::Figures(histograms(report)));
        let note =
            "Every value is in its bin. Differences are linear up to 10 us and logarithmic beyond.";
        blocks.push(Block::Note(note.into()));
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
            Some(_) => "dashed lines are the machine's floors, measured right after the flight.",
            None => "machine's floors were not measured; `ironbird fly --floor 11s` adds them.",
        };
        let note = format!("The largest of n values stands at 1 - 1/2n. The {floors}");
        blocks.push(Block::Note(note));
    }
    blocks
}

fn waterfalls(report: &Report) -> Vec<Figure> {
    let figure = |(percentile, pick): (&str, fn(&Statistics) -> Option<f64>)| {
        let title = format!("Steps of a tick, each at its {percentile}");
        let chart = waterfall(report, &title, pick)?;
        let name = format!("waterfall-{}", percentile.replace('.', ""));
        Some(Figure::new(name, title, Vec::new(), chart))
    };
    let figures = [
        figure(("p50", |series| Some(series.p50_us))),
        figure(("p99", |series| Some(series.p99_us))),
        figure(("p99.9", |series| series.p999_us)),
    ];
    figures.into_iter().flatten().collect()
}

/// The stages and the loop; none where one of them has too few values.
fn waterfall(report: &Report, title: &str, pick: fn(&Statistics) -> Option<f64>) -> Option<Chart> {
    let value = |name: &str| report.series(name).and_then(pick);
    // In lockstep nothing is late.
    let names = STEPS.map(Series::name);
    let first = usize::from(report.run.speed() == Speed::Lockstep && value(&names[0]).is_none());
    let mut end = 0.0;
    let mut bars = Vec::new();
    for name in &names[first..] {
        let value = value(name)?;
        bars.push((name.as_str(), end, end + value));
        end += value;
    }
    bars.extend(value("loop").map(|whole| ("loop", 0.0, whole)));
    let longest = bars.iter().map(|bar| bar.2).fold(0.0, f64::max);
    let names = bars.iter().map(|bar| bar.0.to_owned()).collect();
    let layer = |(i, (name, from, to)): (usize, (&str, f64, f64))| {
        let corners = [(from, i as f64 + 0.2), (to, i as f64 + 0.8)];
        Layer::Boxes(
            format!("bar {}", class(name)),
            vec![(corners, String::new(), us(to - from))],
        )
    };
    // Room for the number behind the longest bar.
    let x = Axis::new(Scale::time(0.0, 1.15 * longest), "us");
    let y = Axis::new(Scale::rows(names), "");
    let layers = bars.into_iter().enumerate().map(layer).collect();
    Some(Chart::new(title, x, y, layers))
}

/// A series of a group, with its colour.
type Member<'a> = (&'static str, &'a Distribution);

fn of_group<'a>(report: &'a Report, name: &str) -> Vec<Member<'a>> {
    let all = report.distributions.iter();
    let all = all.filter(|it| group(&it.name) == name);
    all.map(|it| (class(&it.name), it)).collect()
}

fn keys(all: &[Member<'_>]) -> Vec<(&'static str, String)> {
    let keys = all
        .iter()
        .map(|(class, series)| (*class, series.name.clone()));
    keys.collect()
}

/// Percentiles of the series of each group, with the machine's floors.
fn curves(report: &Report) -> Vec<Figure> {
    let figure = |(name, title, floor, _): &(&str, &str, &str, Value)| {
        let mut all = of_group(report, name);
        let mut floors = report.beside.iter().flat_map(|beside| &beside.floors);
        let floor = floors.find(|it| it.distribution.name == *floor);
        let floor = floor.map(|it| &it.distribution);
        all.extend(floor.map(|floor| ("floor", floor)));
        let points = || all.iter().flat_map(|(_, distribution)| &distribution.curve);
        let x = Scale::tail(points().map(|point| point.0).fold(0.0, f64::max));
        let y = Scale::log(points().map(|point| point.1));
        let lines = all.iter();
        let lines = lines.map(|(class, it)| Layer::Line(class, it.curve.clone()));
        let (x, y) = (Axis::new(x, "percentile"), Axis::new(y, "us"));
        let chart = Chart::new(format!("percentiles: {title}"), x, y, lines.collect());
        (!all.is_empty()).then(|| Figure::new(format!("curve-{name}"), *title, keys(&all), chart))
    };
    GROUPS.iter().filter_map(figure).collect()
}

fn histograms(report: &Report) -> Vec<Figure> {
    let mut figures = Vec::new();
    for (name, title, _, value) in GROUPS {
        let all = of_group(report, name);
        if !all.is_empty() {
            let chart = histogram(report, title, &all, value);
            let name = format!("histogram-{name}");
            figures.push(Figure::new(name, title, keys(&all), chart));
        }
    }
    if !report.deadlines.runs.is_empty() {
        figures.push(miss_runs(report));
    }
    figures
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Value {
    Bare,
    LessTick,
    /// How late they are: slack is to be early.
    Late,
}

fn histogram(report: &Report, title: &str, all: &[Member<'_>], value: Value) -> Chart {
    let tick_us = report.run.wall_period_us;
    let (shift_us, label, zero) = match value {
        // In lockstep ticks have no length.
        Value::LessTick if tick_us > 0.0 => {
            let zero = format!("a tick: {tick_us} us");
            (tick_us, "difference from a tick [us]", Some(zero))
        }
        Value::Late => (0.0, "missed by [us]", Some("the deadline".into())),
        _ => (0.0, "latency [us]", None),
    };
    let bins = |series: &Distribution| -> Vec<(f64, f64, f64)> {
        let is_early = value == Value::Late && series.name == SLACK;
        let bin = |(from_us, below_us, count): &Bin| {
            let (from, below) = (from_us - shift_us, below_us - shift_us);
            match is_early {
                true => (-below, -from, *count as f64),
                false => (from, below, *count as f64),
            }
        };
        let mut bins: Vec<_> = series.bins.iter().map(bin).collect();
        bins.sort_by(|a, b| a.0.total_cmp(&b.0));
        bins
    };
    let all_bins = all.iter().map(|(class, series)| (*class, bins(series)));
    let all_bins: Vec<_> = all_bins.collect();
    let each = || all_bins.iter().flat_map(|(_, bins)| bins);
    let most = each().map(|bin| bin.2).fold(1.0, f64::max);
    let edges = each().flat_map(|bin| [bin.0, bin.1]);
    let x = match zero {
        None => Scale::log(edges),
        Some(_) => around_zero(edges),
    };
    let steps = all_bins.into_iter();
    let steps = steps.map(|(class, bins)| Layer::Steps(class, bins));
    let zero = zero.map(|word| Layer::verticals("deadline", [(0.0, word)]));
    let (layers, x) = (steps.chain(zero).collect(), Axis::new(x, label));
    Chart::new(format!("histogram: {title}"), x, counts(most), layers)
}

/// An axis of differences, with room for what stands at its ends, and for 0.
fn around_zero(edges: impl Iterator<Item = f64>) -> Scale {
    /// Where it becomes logarithmic [us].
    const THRESHOLD_US: f64 = 10.0;
    let (low, high) = edges.fold((0.0_f64, 0.0_f64), |(low, high), edge| {
        (low.min(edge), high.max(edge))
    });
    let beyond = |end: f64| 1.2 * end + 0.5 * THRESHOLD_US;
    Scale::new(Kind::Symmetric(THRESHOLD_US), -beyond(-low), beyond(high))
}

/// The axis of counts up to `most`: its foot is below 1, so that a single value is seen.
fn counts(most: f64) -> Axis {
    let (low, high) = (0.6, (most * 1.6).max(12.0));
    Axis::new(Scale::new(Kind::Log, low, high), "count")
}

fn miss_runs(report: &Report) -> Figure {
    let runs = report.deadlines.runs.iter().map(|run| {
        let length = run.length_ticks as f64;
        (length - 0.5, length + 0.5, run.count as f64)
    });
    let bins: Vec<(f64, f64, f64)> = runs.collect();
    let x = Scale::log(bins.iter().flat_map(|(from, below, _)| [*from, *below]));
    let y = counts(bins.iter().map(|bin| bin.2).fold(1.0, f64::max));
    let (class, title) = ("late", "Deadlines missed in a row");
    let (layers, x) = (
        vec![Layer::Steps(class, bins)],
        Axis::new(x, "ticks in a row"),
    );
    let chart = Chart::new(format!("histogram: {title}"), x, y, layers);
    Figure::new("miss-runs", title, Vec::new(), chart)
}

fn percentiles(report: &Report) -> Vec<Block> {
    let columns: [Column<Statistics>; 9] = [
        ("Latencies [us]", |it| it.name.clone()),
        ("count", |it| it.count.to_string()),
        ("min", |it| us(it.min_us)),
        ("p50", |it| us(it.p50_us)),
        ("p90", |it| us(it.p90_us)),
        ("p99", |it| us(it.p99_us)),
        ("p99.9", |it| known(it.p999_us.map(us))),
        ("p99.99", |it| known(it.p9999_us.map(us))),
        ("max", |it| us(it.max_us)),
    ];
    let others = report.series.iter().filter(|it| it.name != SLACK);
    let table = Block::Table(Table::of(&columns, others));
    let few = "-: too few values. On a shared machine the maximum mostly shows the host. No sample was discarded.";
    vec![
        table,
        Block::Items([notes(report), vec![few.into()]].concat()),
    ]
}

/// The low end of the slack, which is the tail that matters, and why `wake.plant` is short.
pub fn notes(report: &Report) -> Vec<String> {
    let slack = report.series(SLACK).map(|it| {
        let [min, p50] = [it.min_us, it.p50_us].map(us);
        let tail = report.distributions.iter().find(|it| it.name == SLACK);
        let low = |percent| tail.and_then(|it| it.percentile(percent));
        let [p0_1, p1] = [0.1, 1.0].map(|it| known(low(it).map(|it| us(it.value_us))));
        format!("slack before the deadline: min {min}, p0.1 {p0_1}, p1 {p1}, p50 {p50}")
    });
    let lead_us = report.lead.lead_us;
    let early = (lead_us > 0.0).then(|| {
        format!("wake.plant: the plant is woken {lead_us:.0} us early, so only longer delays show")
    });
    slack.into_iter().chain(early).collect()
}
