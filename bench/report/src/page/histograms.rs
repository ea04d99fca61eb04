//! Histograms of the latencies: how often each was, stages over each other.

use maud::{Markup, html};

use crate::page::parts::{Key, chart, us};
use crate::page::timing::{BUSY, COMPUTE, HOPS, PERIODS, TIMER, WAKES};
use crate::plot::lanes::{LANE, Lane, Mark};
use crate::plot::scale::Scale;
use crate::plot::{Axis, Chart, HEIGHT, Layer};
use crate::schema::{Report, RunLength};
use crate::tally::distribution::{Bin, Distribution};

/// Where the axis of a difference becomes logarithmic [us].
const THRESHOLD_US: f64 = 10.0;

/// The pictures; none while the flight is in the air.
pub fn section(report: &Report) -> Markup {
    if report.distributions.is_empty() {
        return html! {};
    }
    let (latency, bare) = ("latency [us]", Value::Bare);
    let pictures: [(&str, &str, &[Key<'static>], &str, Value); 8] = [
        ("histogram-loop", "Loop", &[("loop", "loop")], latency, bare),
        ("histogram-wake", "Wake-up against the grid", &WAKES, latency, bare),
        ("histogram-timer", "The plant's timer against the instant that it was set to", &TIMER, latency, bare),
        ("histogram-hop", "Hops", &HOPS, latency, bare),
        period(report),
        ("histogram-deadline", "Commands against their deadline", &DEADLINE, "late by [us]", Value::Late),
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

/// Series of the deadlines.
const DEADLINE: [Key<'static>; 2] = [("slack", "slack"), ("late", "late")];

/// What of a series is drawn.
#[derive(Clone, Copy, Debug)]
enum Value {
    /// Its values.
    Bare,
    /// Their difference from the length of a tick [us].
    LessTick(f64),
    /// How late they are: slack is to be early.
    Late,
}

type Picture = (&'static str, &'static str, &'static [Key<'static>], &'static str, Value);

fn period(report: &Report) -> Picture {
    let tick_us = report.run.wall_period_us;
    let (label, value) = if tick_us > 0.0 {
        ("difference from a tick [us]", Value::LessTick(tick_us))
    } else {
        ("latency [us]", Value::Bare)
    };
    ("histogram-period", "Period: between two wake-ups", &PERIODS, label, value)
}

fn found<'a>(report: &'a Report, keys: &[Key<'static>]) -> Vec<(&'static str, &'a Distribution)> {
    let of = |name: &str| report.distributions.iter().find(|distribution| distribution.name == name);
    keys.iter().filter_map(|(class, series)| Some((*class, of(series)?))).collect()
}

fn picture(report: &Report, title: &str, label: &str, all: &[(&'static str, &Distribution)], value: Value) -> Chart {
    let bins: Vec<(&'static str, Vec<Bin>)> = all.iter().map(|(class, series)| (*class, value.of(series))).collect();
    let each = || bins.iter().flat_map(|(_, bins)| bins);
    let most = each().map(|bin| bin.count).max().unwrap_or(1) as f64;
    let edges = each().flat_map(|bin| [bin.from_us, bin.below_us]);
    let lanes: Vec<Lane> = match value {
        Value::Late => Vec::new(),
        _ => all.iter().filter_map(|(class, series)| lane(report, class, &series.name, value)).collect(),
    };
    Chart {
        title: format!("histogram: {title}"),
        x: Axis::new(value.scale(edges), label),
        y: counts(most),
        height: HEIGHT + LANE * lanes.len() as f64,
        lanes,
        layers: bins.into_iter().map(|(class, bins)| steps(class, &bins)).chain(value.zero()).collect(),
    }
}

/// The axis of counts up to `most`: its foot is below 1, so that a single value is seen.
fn counts(most: f64) -> Axis {
    Axis::new(Scale::Log { low: 0.6, high: (most * 1.6).max(12.0) }, "count")
}

fn miss_runs(report: &Report) -> Chart {
    let runs = &report.deadlines.runs;
    let bin = |run: &RunLength| (run.length_ticks as f64 - 0.5, run.length_ticks as f64 + 0.5, run.count as f64);
    let bins: Vec<(f64, f64, f64)> = runs.iter().map(bin).collect();
    Chart {
        title: "histogram: deadlines missed in a row".into(),
        x: Axis::new(Scale::log(bins.iter().flat_map(|(from, below, _)| [*from, *below])), "ticks in a row"),
        y: counts(bins.iter().map(|bin| bin.2).fold(1.0, f64::max)),
        lanes: Vec::new(),
        layers: vec![Layer::Steps { class: "late", bins }],
        height: HEIGHT,
    }
}

fn steps(class: &'static str, bins: &[Bin]) -> Layer {
    Layer::Steps { class, bins: bins.iter().map(|bin| (bin.from_us, bin.below_us, bin.count as f64)).collect() }
}

/// Percentiles of a series and its largest value.
fn lane(report: &Report, class: &'static str, name: &str, value: Value) -> Option<Lane> {
    let series = report.series(name)?;
    let places = [Some(series.p50_us), Some(series.p99_us), series.p999_us, Some(series.max_us)];
    let marks = Mark::ALL.into_iter().zip(places).filter_map(|(mark, place)| {
        let place = place?;
        Some((mark, value.place(place), format!("{name}: {} {} us", mark.words(), us(place))))
    });
    Some(Lane { class, marks: marks.collect() })
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
            true => Bin { from_us: -bin.below_us, below_us: -bin.from_us, count: bin.count },
            false => Bin { from_us: self.place(bin.from_us), below_us: self.place(bin.below_us), count: bin.count },
        };
        let mut bins: Vec<Bin> = series.bins.iter().map(moved).collect();
        bins.sort_by(|a, b| a.from_us.total_cmp(&b.from_us));
        bins
    }

    fn scale(self, edges: impl Iterator<Item = f64>) -> Scale {
        if matches!(self, Self::Bare) {
            return Scale::log(edges);
        }
        let (low, high) = edges.fold((0.0, 0.0), |(low, high): (f64, f64), edge| (low.min(edge), high.max(edge)));
        // Room for what stands at the ends, and for 0.
        let beyond = |end: f64| 1.2 * end + 0.5 * THRESHOLD_US;
        Scale::Symmetric { threshold: THRESHOLD_US, low: -beyond(-low), high: beyond(high) }
    }

    /// The line where a difference changes its sign.
    fn zero(self) -> Option<Layer> {
        let word = match self {
            Self::Bare => return None,
            Self::LessTick(tick_us) => format!("a tick: {tick_us} us"),
            Self::Late => "the deadline".into(),
        };
        Some(Layer::Verticals { class: "deadline", at: vec![(0.0, word)] })
    }
}
