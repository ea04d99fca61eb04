//! Charts of a flight over time and in space.

use crate::faults::InjectedFault;
use crate::render::plot::{Axis, Chart, HEIGHT, Layer, WIDTH, through};
use crate::render::scale::Scale;
use crate::schema::SignalSection;
use crate::schema::{LateStretchSection, Report};
use crate::swaps::AppliedSwap;
use crate::traces;
use crate::traces::{Group, Path, Traces};

/// Shortest axis of an estimate, as a share of the true value.
const LEAST_OF_TRUTH: f64 = 3e-3;
/// Names of a vector's components: also their colours.
const AXES: [&str; 3] = ["x", "y", "z"];
const ANGLES: [&str; 3] = ["roll", "pitch", "yaw"];
pub const ESTIMATED: [&str; 3] = ["i_r", "k_r", "delta"];
pub const ROTORS: [&str; 4] = ["rotor-1", "rotor-2", "rotor-3", "rotor-4"];

/// Height of a picture of the path [pixels].
const PATH_HEIGHT: f64 = 330.0;

/// Height of a chart of which there are many [pixels].
const LOW: f64 = 150.0;

#[derive(Clone, Copy, Debug)]
pub struct Figures<'a> {
    traces: &'a Traces,
    swaps: &'a [AppliedSwap],
    faults: &'a [InjectedFault],
    late: &'a [LateStretchSection],
    period_s: f64,
}

impl<'a> Figures<'a> {
    /// Of a flight with its marks; `period_s` is the length of a tick of the laws [s].
    #[must_use]
    pub const fn new(
        traces: &'a Traces,
        swaps: &'a [AppliedSwap],
        late: &'a [LateStretchSection],
        period_s: f64,
    ) -> Self {
        Self {
            traces,
            swaps,
            faults: &[],
            late,
            period_s,
        }
    }

    /// Of the flight of a report.
    #[must_use]
    pub fn of(traces: &'a Traces, report: &'a Report) -> Self {
        Self::new(
            traces,
            &report.swaps,
            &report.deadlines.stretches,
            report.run.period_us / 1e6,
        )
        .faulty(&report.faults)
    }

    /// The same with marks of the flight's faults.
    #[must_use]
    pub const fn faulty(self, faults: &'a [InjectedFault]) -> Self {
        Self { faults, ..self }
    }

    /// Roll, pitch or yaw, with what the outer loop wants.
    #[must_use]
    pub fn attitude(&self, i: usize) -> Chart {
        let label = format!("{} [rad]", ANGLES[i]);
        let lines = [
            ("reference", traces::ATTITUDE_REFERENCE[i]),
            (ANGLES[i], traces::ATTITUDE[i]),
        ];
        self.over_time(label, &lines, 0.01)
    }

    /// A component of the position, with its reference.
    #[must_use]
    pub fn position(&self, i: usize) -> Chart {
        let lines = [
            ("reference", traces::POSITION_REFERENCE[i]),
            (AXES[i], traces::POSITION[i]),
        ];
        self.over_time(format!("{} [m]", AXES[i]), &lines, 0.01)
    }

    #[must_use]
    pub fn distance(&self) -> Chart {
        self.over_time("distance [m]".into(), &[("flown", traces::DISTANCE)], 1e-4)
    }

    #[must_use]
    pub fn thrust(&self) -> Chart {
        self.over_time("thrust [N]".into(), &[("flown", traces::THRUST)], 0.1)
    }

    /// What the position lacks of its reference.
    #[must_use]
    pub fn position_error(&self) -> Chart {
        self.three("position error [m]", AXES, traces::POSITION_ERROR, 1e-4)
    }

    /// The rate error of the law.
    #[must_use]
    pub fn rate_error(&self) -> Chart {
        self.three("rate error e [rad/s]", ANGLES, traces::RATE_ERROR, 1e-4)
    }

    #[must_use]
    pub fn torque(&self) -> Chart {
        self.three("torque [N m]", ANGLES, traces::TORQUE, 1e-7)
    }

    #[must_use]
    pub fn rotor_speeds(&self) -> Chart {
        let lines: Vec<_> = ROTORS.into_iter().zip(traces::ROTORS).collect();
        self.over_time("rotor speed [rad/s]".into(), &lines, 1.0)
    }

    /// An estimate, with what is true.
    #[must_use]
    pub fn estimate(&self, i: usize) -> Chart {
        let label = ["I_R [kg m^2]", "k_r [N m s]", "delta [rad/s^2]"][i];
        let lines = [
            ("reference", traces::ACTUAL[i]),
            (ESTIMATED[i], traces::ESTIMATE[i]),
        ];
        // An airframe of any size fills its axis.
        let actual = self
            .values(&self.traces.flight, &lines[..1])
            .map(f64::abs)
            .fold(0.0, f64::max);
        let least = if actual > 0.0 {
            LEAST_OF_TRUTH * actual
        } else {
            [1e-7, 1e-4, 1e-4][i]
        };
        self.over_time(label.into(), &lines, least)
    }

    /// What an estimate is off by.
    #[must_use]
    pub fn estimate_error(&self, i: usize) -> Chart {
        let label = [
            "error of I_R [kg m^2]",
            "error of k_r [N m s]",
            "error of delta [rad/s^2]",
        ][i];
        self.over_time(
            label.into(),
            &[(ESTIMATED[i], traces::ESTIMATE_ERROR[i])],
            [1e-9, 1e-6, 1e-6][i],
        )
    }

    /// A signal of a role's law, low, as there may be many.
    #[must_use]
    pub fn signal(&self, role: &'static str, group: &'a Group, signal: &SignalSection) -> Chart {
        /// Least length of an axis, as a share of the numbers on it.
        const LEAST: f64 = 1e-3;
        let line = (role, signal.name.as_str());
        let most = self
            .values(group, &[line])
            .fold(0.0, |most: f64, value| most.max(value.abs()));
        let scale = Scale::linear(
            self.values(group, &[line]),
            if most > 0.0 { LEAST * most } else { 1.0 },
        );
        let chart = self.marked(signal.unit.clone(), scale, vec![self.line(group, &line)]);
        Chart {
            title: format!("{} over time", signal.name),
            height: LOW,
            ..chart
        }
    }

    #[must_use]
    pub fn lyapunov(&self) -> Chart {
        let lines: Vec<_> = ["v", "v_th"].into_iter().zip(traces::LYAPUNOV).collect();
        let scale = Scale::log(self.values(&self.traces.flight, &lines));
        self.lines_over_time("V, V_th [rad^2/s^2]".into(), &lines, scale)
    }

    #[must_use]
    pub fn lyapunov_change(&self) -> Chart {
        let lines: Vec<_> = ["v", "v_th"]
            .into_iter()
            .zip(traces::LYAPUNOV_CHANGE)
            .collect();
        let scale = Scale::symmetric(self.values(&self.traces.flight, &lines));
        self.lines_over_time("change in a tick [rad^2/s^2]".into(), &lines, scale)
    }

    /// Violating steps in each stretch, of one cause.
    #[must_use]
    pub fn violations(&self, cause: &str) -> Chart {
        let counts = self.traces.violations.get(cause).into_iter().flatten();
        let points: Vec<_> = counts
            .map(|at| (self.time_s(at.tick), at.count as f64))
            .collect();
        let scale = Scale::Linear {
            low: 0.0,
            high: points.iter().map(|point| point.1).fold(1.0, f64::max) * 1.1,
        };
        let layers = vec![Layer::Stems {
            class: "violation",
            points,
        }];
        self.marked(
            format!("violations: {}", cause.replace('_', " ")),
            scale,
            layers,
        )
    }

    /// A latency over time; `tick_us` is the length of a tick, where ticks have one.
    #[must_use]
    pub fn latency(&self, class: &'static str, channel: &str, tick_us: Option<f64>) -> Chart {
        let (group, line) = (&self.traces.timing, (class, channel));
        let scale = Scale::log(self.values(group, &[line]).chain(tick_us));
        let mut layers = vec![self.line(group, &line)];
        layers.extend(tick_us.map(|at| Layer::Level {
            class: "deadline",
            at,
            label: "a tick".into(),
        }));
        self.marked("latency [us]".into(), scale, layers)
    }

    /// How late commands were that missed their deadline.
    #[must_use]
    pub fn late(&self) -> Chart {
        let points: Vec<_> = self
            .late
            .iter()
            .map(|stretch| (stretch.time_s, stretch.late_us))
            .collect();
        let scale = Scale::log(points.iter().map(|point| point.1));
        let layers = vec![Layer::Stems {
            class: "late",
            points,
        }];
        self.marked("late by [us]".into(), scale, layers)
    }

    /// The way flown, projected on the plane of two axes at one scale.
    #[must_use]
    pub fn path(&self, across: usize, up: usize) -> Chart {
        let Path {
            tick,
            position_w_m: flown,
            reference_w_m: reference,
        } = &self.traces.path;
        let both = || flown.iter().chain(reference);
        let axis = |i: usize| Scale::linear(both().map(|point| point[i]), 0.1);
        let (x, y) = (axis(across), axis(up));
        let line = |points: &[[f64; 3]]| {
            points
                .iter()
                .map(|point| (point[across], point[up]))
                .collect()
        };
        let at_swap = |swap: &AppliedSwap| {
            let sample = tick
                .iter()
                .position(|tick| *tick >= swap.tick)
                .filter(|_| tick.first() <= Some(&swap.tick))?;
            Some(((flown[sample][across], flown[sample][up]), swap_words(swap)))
        };
        let mut chart = Chart {
            title: format!("path in the plane of {} and {}", AXES[across], AXES[up]),
            height: PATH_HEIGHT,
            lanes: Vec::new(),
            x: Axis::new(x, format!("{} [m]", AXES[across])),
            y: Axis::new(y, format!("{} [m]", AXES[up])),
            layers: vec![
                Layer::Line {
                    class: "reference",
                    points: line(reference),
                },
                Layer::Line {
                    class: "flown",
                    points: line(flown),
                },
                Layer::Dots {
                    class: "swap",
                    points: self.swaps.iter().filter_map(at_swap).collect(),
                },
            ],
        };
        // One scale: the axis that would be stretched becomes longer. Its names may then need more room.
        let excess = length(&chart.x.scale) / (length(&chart.y.scale) * chart.proportion());
        chart.x.scale = widened(chart.x.scale, (1.0 / excess).max(1.0));
        chart.y.scale = widened(chart.y.scale, excess.max(1.0));
        chart
    }

    fn three(
        &self,
        label: &str,
        classes: [&'static str; 3],
        channels: traces::Names,
        least: f64,
    ) -> Chart {
        let lines: Vec<_> = classes.into_iter().zip(channels).collect();
        self.over_time(label.into(), &lines, least)
    }

    /// Channels of the flight, each with its colour, on a linear axis.
    fn over_time(&self, label: String, lines: &[(&'static str, &str)], least: f64) -> Chart {
        let scale = Scale::linear(self.values(&self.traces.flight, lines), least);
        self.lines_over_time(label, lines, scale)
    }

    fn lines_over_time(
        &self,
        label: String,
        lines: &[(&'static str, &str)],
        scale: Scale,
    ) -> Chart {
        self.marked(
            label,
            scale,
            lines
                .iter()
                .map(|line| self.line(&self.traces.flight, line))
                .collect(),
        )
    }

    fn line(&self, group: &Group, (class, channel): &(&'static str, &str)) -> Layer {
        let last = group.every_ticks.saturating_sub(1);
        let ends_s = |tick| [self.time_s(tick), self.time_s(tick + last)];
        Layer::Line {
            class,
            points: through(group.spans(channel), ends_s),
        }
    }

    fn values(&self, group: &'a Group, lines: &[(&str, &str)]) -> impl Iterator<Item = f64> {
        let spans: Vec<_> = lines
            .iter()
            .flat_map(|(_, channel)| group.spans(channel))
            .collect();
        spans.into_iter().flat_map(|span| [span.min, span.max])
    }

    /// A chart over the whole flight, with its swaps, faults and missed deadlines below what it shows.
    fn marked(&self, label: String, scale: Scale, layers: Vec<Layer>) -> Chart {
        let end_s = [&self.traces.flight, &self.traces.timing]
            .into_iter()
            .filter_map(|group| {
                group
                    .tick
                    .last()
                    .map(|tick| self.time_s(tick + group.every_ticks.saturating_sub(1)))
            })
            .fold(0.0, f64::max);
        let marks = [
            Layer::Verticals {
                class: "missed",
                at: self.misses(end_s),
            },
            Layer::Verticals {
                class: "swap",
                at: self
                    .swaps
                    .iter()
                    .map(|swap| (swap.time_s, swap_words(swap)))
                    .chain(self.faults.iter().flat_map(InjectedFault::marks))
                    .collect(),
            },
        ];
        Chart {
            title: format!("{label} over time"),
            x: Axis::new(Scale::time(0.0, end_s.max(self.period_s)), "time [s]"),
            y: Axis::new(scale, label),
            lanes: Vec::new(),
            layers: marks.into_iter().chain(layers).collect(),
            height: HEIGHT,
        }
    }

    /// Missed deadlines as marks: of those that would stand on one pixel, the longest.
    fn misses(&self, end_s: f64) -> Vec<(f64, String)> {
        let mut shown: Vec<(u64, &LateStretchSection)> = Vec::new();
        for stretch in self.late {
            let pixel = (stretch.time_s / end_s * WIDTH) as u64;
            match shown.last_mut() {
                Some((last, longest)) if *last == pixel => {
                    if stretch.length_ticks > longest.length_ticks {
                        *longest = stretch;
                    }
                }
                _ => shown.push((pixel, stretch)),
            }
        }
        shown
            .into_iter()
            .map(|(_, stretch)| (stretch.time_s, miss_words(stretch)))
            .collect()
    }

    fn time_s(&self, tick: u64) -> f64 {
        tick as f64 * self.period_s
    }
}

/// From one end of a linear axis to the other.
fn length(scale: &Scale) -> f64 {
    if let Scale::Linear { low, high } = scale {
        high - low
    } else {
        1.0
    }
}

/// The same axis, `factor` times as long.
fn widened(scale: Scale, factor: f64) -> Scale {
    let Scale::Linear { low, high } = scale else {
        return scale;
    };
    let (middle, half) = ((low + high) / 2.0, (high - low) / 2.0 * factor);
    Scale::Linear {
        low: middle - half,
        high: middle + half,
    }
}

fn swap_words(swap: &AppliedSwap) -> String {
    format!("swap at {:.3} s: {}", swap.time_s, swap.words())
}

fn miss_words(stretch: &LateStretchSection) -> String {
    let LateStretchSection {
        time_s,
        length_ticks,
        late_us,
        ..
    } = stretch;
    format!("{length_ticks} missed at {time_s:.3} s, at most {late_us:.0} us late")
}
