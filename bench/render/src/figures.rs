//! Charts of a flight over time and in space.

use crate::document::Figure;
use crate::plot::{Axis, Chart, Layer, WIDTH, through};
use crate::scale::Scale;
use crate::sentences;
use analysis::faults::{AppliedSwap, InjectedFault};
use analysis::schema::{ChannelOutage, LateStretchSection, Report, SignalSection};
use analysis::traces::{self, Group, Path, Trace, Traces};
use std::f64::consts::PI;

/// Names of a vector's components: also their colours.
pub const AXES: [&str; 3] = ["x", "y", "z"];
pub const ANGLES: [&str; 3] = ["roll", "pitch", "yaw"];
const ESTIMATED: [&str; 3] = ["i_r", "k_r", "delta"];
pub const SYMBOLS: [&str; 3] = ["I_R", "k_r", "delta"];
pub const UNITS: [&str; 3] = ["kg m^2", "N m s", "rad/s^2"];
const ROTORS: [&str; 4] = ["rotor-1", "rotor-2", "rotor-3", "rotor-4"];

/// Height of a picture of the path [pixels].
const PATH_HEIGHT: f64 = 330.0;
/// Height of a chart of which there are many [pixels].
const LOW: f64 = 150.0;

#[derive(Clone, Copy, Debug)]
enum Along {
    Linear(f64),
    Log(Option<f64>),
    Symmetric,
}

type Line<'a> = (&'static str, &'a str, &'a str);

#[derive(Clone, Copy, Debug)]
pub struct Figures<'a> {
    pub traces: &'a Traces,
    pub swaps: &'a [AppliedSwap],
    pub faults: &'a [InjectedFault],
    pub late: &'a [LateStretchSection],
    pub channel_outages: &'a [ChannelOutage],
    pub period_s: f64,
}

impl<'a> Figures<'a> {
    /// Of the flight of a report; none while it is in the air.
    pub fn of(report: &'a Report) -> Option<Self> {
        Some(Self {
            traces: report.traces.as_ref()?,
            swaps: &report.swaps,
            faults: &report.faults,
            late: &report.deadlines.stretches,
            channel_outages: report.redundancy.as_ref().map_or(&[], |it| &it.outages),
            period_s: report.run.period_us / 1e6,
        })
    }

    /// Whether the inner law estimates parameters.
    pub fn has_estimates(&self) -> bool {
        self.traces.flight.has(traces::ESTIMATE[0])
    }

    pub fn attitude(&self, i: usize) -> Figure {
        let channels = [traces::ATTITUDE_REFERENCE[i], traces::ATTITUDE[i]];
        self.with_reference(ANGLES[i], "Attitude", "rad", channels)
    }

    pub fn position(&self, i: usize) -> Figure {
        let channels = [traces::POSITION_REFERENCE[i], traces::POSITION[i]];
        self.with_reference(AXES[i], "Position", "m", channels)
    }

    fn with_reference(
        &self,
        name: &'static str,
        what: &str,
        unit: &str,
        [reference, actual]: [&str; 2],
    ) -> Figure {
        let lines = [
            ("reference", reference, "reference"),
            (name, actual, "actual"),
        ];
        let (title, label) = (format!("{what}: {name}"), format!("{name} [{unit}]"));
        self.over_time(name, &title, &label, &lines, 0.01)
    }

    pub fn distance(&self) -> Figure {
        let lines = [("flown", traces::DISTANCE, "")];
        let title = "Distance from the reference";
        self.over_time("distance", title, "distance [m]", &lines, 1e-4)
    }

    /// The charts beside the path: position error and heading.
    pub fn overview(&self) -> Vec<Figure> {
        let mut heading = self.attitude(2);
        heading.title = "Heading".into();
        vec![self.distance(), heading]
    }

    /// The whole flight as JSON for replay.js: `columns` names the numbers of each of its `frames`, in the middle between
    /// the smallest and the largest value of a stretch; `marks` are the instants of changes and faults.
    pub fn replay(&self) -> String {
        let group = &self.traces.flight;
        let columns = [
            &traces::POSITION[..],
            &traces::ATTITUDE,
            &traces::POSITION_REFERENCE,
            &traces::ROTORS,
        ]
        .concat();
        let spans = columns.iter().map(|column| group.channels.get(*column));
        let spans: Vec<_> = spans.collect();
        let frame = |(i, tick): (usize, &u64)| {
            let number = |trace: &Option<&Trace>| {
                let (min, max) = (
                    (*trace)?.min.get(i)?.as_ref()?,
                    (*trace)?.max.get(i)?.as_ref()?,
                );
                // An angle that jumps from pi to -pi has no middle.
                Some(if max - min > PI {
                    *min
                } else {
                    (min + max) / 2.0
                })
            };
            let numbers: Option<Vec<f64>> = spans.iter().map(number).collect();
            let numbers = numbers?.into_iter().map(|it| (it * 1e4).round() / 1e4);
            Some([self.time_s(*tick)].into_iter().chain(numbers).collect())
        };
        let frames: Vec<Vec<f64>> = group.tick.iter().enumerate().filter_map(frame).collect();
        let faults = self.acting().map(|it| (it.time_s, it.what.clone()));
        let changes = self.swaps.iter().flat_map(|swap| {
            let named = swap.changes.iter();
            named.map(|it| (swap.time_s, it.name.clone()))
        });
        let marks: Vec<(f64, String)> = faults.chain(changes).collect();
        let columns: Vec<&str> = ["t_s"].into_iter().chain(columns).collect();
        let json = serde_json::json!({"columns": columns, "frames": frames, "marks": marks});
        // Nothing in it ends the element that it stands in.
        json.to_string().replace('<', "\\u003c")
    }

    pub fn flight(&self) -> Vec<Figure> {
        fn three(names: [&'static str; 3], channels: traces::Names) -> [Line<'static>; 3] {
            std::array::from_fn(|i| (names[i], channels[i], names[i]))
        }
        let mut figures: Vec<Figure> = (0..2).map(|i| self.attitude(i)).collect();
        figures.extend((0..3).map(|i| self.position(i)));
        let lines = three(AXES, traces::POSITION_ERROR);
        let title = "Tracking error: position";
        figures.push(self.over_time("position-error", title, "position error [m]", &lines, 1e-4));
        if self.traces.flight.has(traces::RATE_ERROR[0]) {
            let lines = three(ANGLES, traces::RATE_ERROR);
            let title = "Tracking error: body rates";
            figures.push(self.over_time("rate-error", title, "rate error e [rad/s]", &lines, 1e-4));
        }
        let lines = [("flown", traces::THRUST, "")];
        figures.push(self.over_time("thrust", "Thrust demanded", "thrust [N]", &lines, 0.1));
        let lines = three(ANGLES, traces::TORQUE);
        figures.push(self.over_time("torque", "Torque demanded", "torque [N m]", &lines, 1e-7));
        let rotor = |i: usize| (ROTORS[i], traces::ROTORS[i], &ROTORS[i]["rotor-".len()..]);
        let lines: [Line<'_>; 4] = std::array::from_fn(rotor);
        figures.push(self.over_time("rotors", "Rotor speeds", "rotor speed [rad/s]", &lines, 1.0));
        if self.has_estimates() {
            figures.extend((0..3).map(|i| self.estimate(i)));
        }
        for (across, up, title) in [(0, 1, "from above"), (0, 2, "along y"), (1, 2, "along x")] {
            let classes = ["flown", "reference", "swap ring"];
            let words = ["flown", "reference", "parameter change"].map(str::to_owned);
            let keys = classes.into_iter().zip(words).collect();
            let name = format!("path-{}{}", AXES[across], AXES[up]);
            let (title, chart) = (format!("Path seen {title}"), self.path(across, up));
            figures.push(Figure::new(name, title, keys, chart));
        }
        figures
    }

    pub fn estimate(&self, i: usize) -> Figure {
        let lines = [
            ("reference", traces::ACTUAL[i], "true"),
            (ESTIMATED[i], traces::ESTIMATE[i], "estimated"),
        ];
        let title = format!("Estimate of {}", SYMBOLS[i]);
        let label = format!("{} [{}]", SYMBOLS[i], UNITS[i]);
        self.over_time(ESTIMATED[i], &title, &label, &lines, 0.0)
    }

    /// The signals of a role's law, low, as there may be many.
    pub fn telemetry(&self, role: &'static str, signals: &[SignalSection]) -> Vec<Figure> {
        let Some(group) = self.traces.telemetry.get(role) else {
            return Vec::new();
        };
        let figure = |signal: &SignalSection| {
            let SignalSection { name, unit, .. } = signal;
            let title = match unit.as_str() {
                "" => name.clone(),
                unit => format!("{name} [{unit}]"),
            };
            let lines = [(role, name.as_str(), "")];
            let id = format!("{role}-{name}");
            let mut figure = self.figure_of(group, &id, &title, unit, &lines, Along::Linear(0.0));
            figure.chart.title = format!("{name} over time");
            figure.chart.height = LOW;
            figure
        };
        let is_known = |signal: &&SignalSection| group.has(&signal.name);
        signals.iter().filter(is_known).map(figure).collect()
    }

    pub fn theorem(&self) -> Vec<Figure> {
        let group = &self.traces.flight;
        let both = |name: &str, title: &str, label: &str, channels: [&str; 2], along| {
            let lines = [("v", channels[0], "V"), ("v_th", channels[1], "V_th")];
            self.figure_of(group, name, title, label, &lines, along)
        };
        let (v, change) = ("V, V_th [rad^2/s^2]", "change in a tick [rad^2/s^2]");
        let (title, changes) = ("Their change in a tick", traces::LYAPUNOV_CHANGE);
        let mut figures = vec![
            both("v", "V and V_th", v, traces::LYAPUNOV, Along::Log(None)),
            both("v-change", title, change, changes, Along::Symmetric),
        ];
        for (cause, counts) in &self.traces.violations {
            let points = counts
                .iter()
                .map(|at| (self.time_s(at.tick), at.count as f64));
            let high = points.clone().map(|point| point.1).fold(1.0, f64::max) * 1.1;
            let named = cause.replace('_', " ");
            let (scale, layer) = (Scale::time(0.0, high), Layer::stems("violation", points));
            let chart = self.chart_over_time(&format!("violations: {named}"), scale, vec![layer]);
            let title = format!("Violations under {named}");
            figures.push(Figure::new(
                format!("violations-{cause}"),
                title,
                Vec::new(),
                chart,
            ));
        }
        figures
    }

    /// Latencies over time; `tick_us` is the length of a tick, where ticks have one.
    pub fn latencies(&self, tick_us: Option<f64>) -> Vec<Figure> {
        let latency = |name: &str, title: &str, line: Line<'_>| {
            let (label, along) = ("latency [us]", Along::Log(tick_us));
            self.figure_of(&self.traces.timing, name, title, label, &[line], along)
        };
        let title = "Loop: from the state to the rotor command";
        let mut figures = vec![latency("loop", title, ("loop", traces::LOOP, ""))];
        if tick_us.is_some() {
            let title = "Lateness of the plant's wake-up";
            figures.push(latency("wake", title, ("plant", traces::WAKE, "")));
        }
        for figure in &mut figures {
            let level = |at| Layer::Level("deadline", at, "a tick");
            figure.chart.layers.extend(tick_us.map(level));
        }
        if !self.late.is_empty() {
            let points = self.late.iter().map(|it| (it.time_s, it.late_us));
            let scale = Scale::log(points.clone().map(|point| point.1));
            let chart =
                self.chart_over_time("missed by [us]", scale, vec![Layer::stems("late", points)]);
            let title = "Missed deadlines: by how much";
            figures.push(Figure::new("late", title, Vec::new(), chart));
        }
        figures
    }

    /// The way flown, projected on the plane of two axes at one scale.
    pub fn path(&self, across: usize, up: usize) -> Chart {
        let Path { tick, .. } = &self.traces.path;
        let flown = &self.traces.path.position_w_m;
        let place = |point: &[f64; 3]| (point[across], point[up]);
        let at_swap = |swap: &AppliedSwap| {
            let sample = tick.iter().position(|tick| *tick >= swap.tick);
            let sample = sample.filter(|_| tick.first() <= Some(&swap.tick))?;
            Some((place(&flown[sample]), swap_words(swap)))
        };
        let swaps = self.swaps.iter().filter_map(at_swap).collect();
        let reference = self.traces.path.reference_w_m.as_slice();
        let mut chart = plane([across, up], &[("reference", reference), ("flown", flown)]);
        chart.layers.push(Layer::Dots("swap", swaps));
        chart
    }

    /// Channels of the flight, each with its colour, on a linear axis.
    fn over_time(
        &self,
        name: &str,
        title: &str,
        label: &str,
        lines: &[Line<'_>],
        least: f64,
    ) -> Figure {
        let group = &self.traces.flight;
        self.figure_of(group, name, title, label, lines, Along::Linear(least))
    }

    fn figure_of(
        &self,
        group: &Group,
        name: &str,
        title: &str,
        label: &str,
        lines: &[Line<'_>],
        along: Along,
    ) -> Figure {
        let channels = lines.iter().map(|(_, channel, _)| *channel);
        let spans = channels.flat_map(|channel| group.spans(channel));
        let values = spans.flat_map(|span| [span.min, span.max]);
        let scale = match along {
            Along::Linear(least) => Scale::linear(values, least),
            Along::Log(marked) => Scale::log(values.chain(marked)),
            Along::Symmetric => Scale::symmetric(values),
        };
        let last = group.every_ticks.saturating_sub(1);
        let ends_s = |tick| [self.time_s(tick), self.time_s(tick + last)];
        let layers = lines
            .iter()
            .map(|(class, channel, _)| Layer::Line(class, through(group.spans(channel), ends_s)));
        let chart = self.chart_over_time(label, scale, layers.collect());
        let keys = lines.iter().filter(|(.., word)| !word.is_empty());
        let keys = keys.map(|(class, _, word)| (*class, (*word).to_owned()));
        let mut keys: Vec<(&'static str, String)> = keys.collect();
        // What was wanted lies below, and is named last.
        keys.sort_by_key(|(class, _)| *class == "reference");
        Figure::new(name, title, keys, chart)
    }

    fn acting(&self) -> impl Iterator<Item = &InjectedFault> {
        self.faults.iter().filter(|fault| fault.acted())
    }

    /// A chart over the whole flight, with its swaps, faults, handovers and missed deadlines below what it shows.
    fn chart_over_time(&self, label: &str, scale: Scale, layers: Vec<Layer>) -> Chart {
        let groups = [&self.traces.flight, &self.traces.timing].into_iter();
        let ends_s = groups.filter_map(|group| {
            let last = group.tick.last()?;
            Some(self.time_s(last + group.every_ticks.saturating_sub(1)))
        });
        let end_s = ends_s.fold(0.0, f64::max);
        let swaps = self
            .swaps
            .iter()
            .map(|swap| (swap.time_s, swap_words(swap)));
        let faults = self.acting().flat_map(|fault| {
            let InjectedFault { what, time_s, .. } = fault;
            let begin = (*time_s, format!("fault from {time_s:.3} s: {what}"));
            let end = |to_s| (to_s, format!("fault until {to_s:.3} s: {what}"));
            std::iter::once(begin).chain(fault.to_s.map(end))
        });
        let handovers = self.channel_outages.iter().filter(|it| it.handover);
        let handovers = handovers.map(|it| {
            let (time_s, from, reason) = (it.time_s, &it.channel, &it.reason);
            (
                time_s,
                format!("handover from {from} at {time_s:.3} s: {reason}"),
            )
        });
        let marks = [
            Layer::verticals("missed", self.misses(end_s)),
            Layer::verticals("handover", handovers),
            Layer::verticals("swap", swaps.chain(faults)),
        ];
        let x = Axis::new(Scale::time(0.0, end_s.max(self.period_s)), "time [s]");
        let layers = marks.into_iter().chain(layers).collect();
        let y = Axis::new(scale, label);
        Chart::new(format!("{label} over time"), x, y, layers)
    }

    /// Missed deadlines as marks: of those that would stand on one pixel, the longest.
    fn misses(&self, end_s: f64) -> Vec<(f64, String)> {
        let pixel = |stretch: &LateStretchSection| (stretch.time_s / end_s * WIDTH) as u64;
        let groups = self.late.chunk_by(|a, b| pixel(a) == pixel(b));
        let longest =
            groups.filter_map(|group| group.iter().rev().max_by_key(|it| it.length_ticks));
        let mark = |stretch: &LateStretchSection| {
            let (missed, time_s, late_us) = (stretch.length_ticks, stretch.time_s, stretch.late_us);
            let word = format!("{missed} missed at {time_s:.3} s, at most {late_us:.0} us late");
            (time_s, word)
        };
        longest.map(mark).collect()
    }

    fn time_s(&self, tick: u64) -> f64 {
        tick as f64 * self.period_s
    }
}

/// Ways through space, projected on the plane of two axes at one scale.
pub fn plane([across, up]: [usize; 2], ways: &[(&'static str, &[[f64; 3]])]) -> Chart {
    let all = || ways.iter().flat_map(|(_, points)| *points);
    let axis = |i: usize| {
        let scale = Scale::linear(all().map(|point| point[i]), 0.1);
        Axis::new(scale, format!("{} [m]", AXES[i]))
    };
    let line = |(class, points): &(&'static str, &[[f64; 3]])| {
        let points = points.iter().map(|point| (point[across], point[up]));
        Layer::Line(class, points.collect())
    };
    let title = format!("path in the plane of {} and {}", AXES[across], AXES[up]);
    let layers = ways.iter().map(line).collect();
    let mut chart = Chart {
        height: PATH_HEIGHT,
        ..Chart::new(title, axis(across), axis(up), layers)
    };
    // One scale: the axis that would be stretched becomes longer. Its names may then need more room.
    let length = |scale: &Scale| scale.high - scale.low;
    let excess = length(&chart.x.scale) / (length(&chart.y.scale) * chart.proportion());
    widen(&mut chart.x.scale, (1.0 / excess).max(1.0));
    widen(&mut chart.y.scale, excess.max(1.0));
    chart
}

/// Makes a linear axis `factor` times as long.
fn widen(scale: &mut Scale, factor: f64) {
    let middle = (scale.low + scale.high) / 2.0;
    let half = (scale.high - scale.low) / 2.0 * factor;
    (scale.low, scale.high) = (middle - half, middle + half);
}

fn swap_words(swap: &AppliedSwap) -> String {
    format!(
        "parameter change at {:.3} s: {}",
        swap.time_s,
        sentences::swap(swap)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_misses_on_one_pixel_the_first_of_the_longest_is_marked() {
        let late = [(1.0, 1), (1.001, 4), (1.002, 4), (5.0, 2)];
        let late = late.map(|(time_s, length_ticks)| LateStretchSection {
            tick: 0,
            time_s,
            length_ticks,
            late_us: 10.0,
        });
        let figures = Figures {
            traces: &Traces::default(),
            swaps: &[],
            faults: &[],
            late: &late,
            channel_outages: &[],
            period_s: 1e-3,
        };
        let marks = figures.misses(30.0).into_iter();
        let words: Vec<_> = marks
            .map(|(_, word)| word.split_at(19).0.to_owned())
            .collect();
        assert_eq!(words, ["4 missed at 1.001 s", "2 missed at 5.000 s"]);
    }
}
