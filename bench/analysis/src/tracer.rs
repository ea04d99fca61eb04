//! Reduces a flight to traces for plots, tick by tick.

use crate::laws::FlownLaws;
use crate::states::Joined;
use crate::traces::*;
use crate::tracking::Tracking;
use messages::monitor::{CAUSES, Cause};
use messages::role::Role;
use messages::telemetry::LAW_ROLES;
use std::collections::{BTreeMap, VecDeque};

/// Stretches kept: there are at least half as many once the flight has had that many ticks.
const STRETCHES: usize = 600;
/// Time between samples of the path [s].
const PATH_EVERY_S: f64 = 0.05;
/// Length of the path [samples]: the last minute. More of it would only cover itself.
const PATH_SAMPLES: usize = 1200;
const TIMING: [&str; 2] = [WAKE, LOOP];

#[derive(Clone, Copy, Debug)]
pub enum Timing {
    Wake,
    Loop,
}

#[derive(Debug)]
pub struct Tracer {
    tracking: Tracking,
    laws: FlownLaws,
    flight: Stretches<Range>,
    /// Names of the numbers in `flight`; none before the first tick.
    names: Vec<&'static str>,
    timing: Stretches<Range>,
    /// What the laws show, in the order of [`LAW_ROLES`].
    telemetry: [Stretches<Range>; LAW_ROLES.len()],
    violations: Stretches<u64>,
    counted: [u64; CAUSES],
    path_every_ticks: u64,
    /// Tick, position and reference [m].
    path: VecDeque<(u64, [f64; 3], [f64; 3])>,
}

impl Tracer {
    pub fn new(tracking: Tracking) -> Self {
        Self {
            tracking,
            laws: FlownLaws::default(),
            flight: Stretches::default(),
            names: Vec::new(),
            timing: Stretches::default(),
            telemetry: Default::default(),
            violations: Stretches::default(),
            counted: [0; CAUSES],
            path_every_ticks: ((PATH_EVERY_S / tracking.period_s()).round() as u64).max(1),
            path: VecDeque::new(),
        }
    }

    pub const fn set_laws(&mut self, laws: FlownLaws) {
        self.laws = laws;
    }

    pub fn take(&mut self, joined: &Joined) {
        let (tick, reference) = (
            joined.tick,
            self.tracking.reference(joined.tick, &joined.state),
        );
        let reference = reference.position_w_m;
        let distance_m = self.tracking.error_m(tick, &joined.state, None);
        let channels = channels(joined, &self.laws, reference, distance_m);
        if self.names.is_empty() {
            self.names = channels.iter().map(|(name, _)| *name).collect();
        }
        let ranges = self.flight.at(tick, channels.len());
        for (range, (_, value)) in ranges.iter_mut().zip(&channels) {
            *range = value.map_or(*range, |value| range.and(Range::of(value)));
        }
        let roles = self.telemetry.iter_mut().zip(LAW_ROLES);
        for ((stretches, role), shown) in roles.zip(joined.telemetry()) {
            let signals = self.laws.signals.of(role);
            if let Some(shown) = shown.filter(|_| !signals.is_empty()) {
                let ranges = stretches.at(tick, signals.len()).iter_mut();
                for (range, (_, value)) in ranges.zip(shown.of(signals)) {
                    *range = range.and(Range::of(value));
                }
            }
        }
        if tick.is_multiple_of(self.path_every_ticks) {
            if self.path.len() == PATH_SAMPLES {
                self.path.pop_front();
            }
            let position = joined.state.truth.position_w_m;
            self.path.push_back((tick, position, reference));
        }
        let counts = joined.monitor.map_or(self.counted, |it| it.violations);
        if counts != self.counted {
            for (i, at) in self.violations.at(tick, CAUSES).iter_mut().enumerate() {
                // A restarted inner loop counts from 0.
                *at += counts[i].checked_sub(self.counted[i]).unwrap_or(counts[i]);
            }
            self.counted = counts;
        }
    }

    pub fn timing(&mut self, tick: u64, timing: Timing, value_ns: u64) {
        let range = &mut self.timing.at(tick, TIMING.len())[timing as usize];
        *range = range.and(Range::of(value_ns as f64 / 1e3));
    }

    pub fn traces(&self) -> Traces {
        let shown = |(stretches, role): (&Stretches<Range>, Role)| {
            let signals = self.laws.signals.of(role).iter();
            let names: Vec<_> = signals.map(|signal| signal.name).collect();
            (!names.is_empty()).then(|| (role.to_string(), stretches.group(&names)))
        };
        let (telemetry, path) = (self.telemetry.iter().zip(LAW_ROLES), || self.path.iter());
        Traces {
            flight: self.flight.group(&self.names),
            timing: self.timing.group(&TIMING),
            path: Path {
                tick: path().map(|(tick, ..)| *tick).collect(),
                position_w_m: path().map(|(_, at, _)| at.map(round_digits)).collect(),
                reference_w_m: path().map(|(.., at)| at.map(round_digits)).collect(),
            },
            telemetry: telemetry.filter_map(shown).collect(),
            violations: self.by_cause(),
        }
    }

    fn by_cause(&self) -> BTreeMap<String, Vec<Violations>> {
        let every = self.violations.every_ticks;
        let of = |cause: Cause| -> Vec<Violations> {
            let stretches = self.violations.stretches.iter();
            let all = stretches.map(|(i, counts)| Violations {
                tick: i * every,
                count: counts[cause as usize],
            });
            all.filter(|violations| violations.count > 0).collect()
        };
        let all = Cause::ALL
            .into_iter()
            .map(|cause| (cause.name().to_owned(), of(cause)));
        all.filter(|(_, violations)| !violations.is_empty())
            .collect()
    }
}

/// What is followed of a tick, by name; nothing of a stage that published nothing for it. A law that estimates nothing
/// has no estimates, and so on.
fn channels(
    joined: &Joined,
    laws: &FlownLaws,
    reference: [f64; 3],
    distance_m: f64,
) -> Vec<(&'static str, Option<f64>)> {
    let (state, setpoint) = (&joined.state, &joined.setpoint);
    let (wrench, rotor_speeds, monitor) = (joined.wrench, joined.rotor_speeds, joined.monitor);
    // Where it truly is, as it is judged.
    let position = state.truth.position_w_m;
    let error = std::array::from_fn::<_, 3, _>(|i| reference[i] - position[i]);
    let truth = state.truth.theta();
    let attitude_reference = setpoint.map(|setpoint| setpoint.attitude_rad);
    let rotor_speeds = rotor_speeds.map(|speeds| speeds.speed_rad_s);
    let mut all = Vec::with_capacity(48);
    follow(&mut all, ATTITUDE, Some(state.measured.attitude_rad));
    follow(&mut all, ATTITUDE_REFERENCE, attitude_reference);
    follow(&mut all, POSITION, Some(position));
    follow(&mut all, POSITION_REFERENCE, Some(reference));
    follow(&mut all, POSITION_ERROR, Some(error));
    follow(&mut all, [DISTANCE], Some([distance_m]));
    follow(&mut all, [THRUST], wrench.map(|wrench| [wrench.thrust_n]));
    follow(&mut all, TORQUE, wrench.map(|wrench| wrench.torque_b_nm));
    follow(&mut all, ROTORS, rotor_speeds);
    if let Some(places) = laws.rate_error() {
        let rate_error = wrench.map(|wrench| places.of(&wrench));
        follow(&mut all, RATE_ERROR, rate_error);
    }
    if let Some(places) = laws.estimates() {
        let estimate = wrench.map(|wrench| places.of(&wrench));
        let error = estimate.map(|estimate| std::array::from_fn(|i| estimate[i] - truth[i]));
        follow(&mut all, ESTIMATE, estimate);
        follow(&mut all, ACTUAL, Some(truth));
        follow(&mut all, ESTIMATE_ERROR, error);
    }
    if laws.without_theorem.is_none() {
        follow(&mut all, LYAPUNOV, monitor.map(|it| [it.v, it.v_th]));
        let change = monitor.map(|it| [it.v_change, it.v_th_change]);
        follow(&mut all, LYAPUNOV_CHANGE, change);
    }
    all
}

fn follow<const N: usize>(
    all: &mut Vec<(&'static str, Option<f64>)>,
    names: [&'static str; N],
    values: Option<[f64; N]>,
) {
    let value = |i: usize| values.map(|values| values[i]);
    all.extend((0..N).map(|i| (names[i], value(i))));
}

/// Five significant digits: more than a plot shows.
fn round_digits(value: f64) -> f64 {
    format!("{value:.4e}").parse().unwrap_or(value)
}

pub(crate) trait Merge: Copy + Default {
    fn and(self, other: Self) -> Self;
}

impl Merge for u64 {
    fn and(self, other: Self) -> Self {
        self + other
    }
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Range {
    min: f64,
    max: f64,
}

impl Range {
    pub(crate) const fn of(value: f64) -> Self {
        let (min, max) = (value, value);
        Self { min, max }
    }
}

impl Default for Range {
    fn default() -> Self {
        Self {
            min: f64::INFINITY,
            max: f64::NEG_INFINITY,
        }
    }
}

impl Merge for Range {
    fn and(self, other: Self) -> Self {
        Self {
            min: self.min.min(other.min),
            max: self.max.max(other.max),
        }
    }
}

/// Stretches of equal length, by their number from tick 0 on; each has several channels.
#[derive(Debug)]
pub(crate) struct Stretches<T> {
    every_ticks: u64,
    stretches: BTreeMap<u64, Vec<T>>,
}

impl<T> Default for Stretches<T> {
    fn default() -> Self {
        Self {
            every_ticks: 1,
            stretches: BTreeMap::new(),
        }
    }
}

impl<T: Merge> Stretches<T> {
    pub(crate) fn at(&mut self, tick: u64, channels: usize) -> &mut [T] {
        let is_new = !self.stretches.contains_key(&(tick / self.every_ticks));
        if self.stretches.len() >= STRETCHES && is_new {
            self.double();
        }
        let stretch = self.stretches.entry(tick / self.every_ticks);
        stretch.or_insert_with(|| vec![T::default(); channels])
    }

    fn double(&mut self) {
        self.every_ticks *= 2;
        for (i, stretch) in std::mem::take(&mut self.stretches) {
            match self.stretches.get_mut(&(i / 2)) {
                Some(earlier) => {
                    let both = earlier.iter_mut().zip(stretch);
                    both.for_each(|(a, b)| *a = a.and(b));
                }
                None => drop(self.stretches.insert(i / 2, stretch)),
            }
        }
    }
}

impl Stretches<Range> {
    pub(crate) fn group(&self, names: &[&str]) -> Group {
        let trace = |channel: usize, pick: fn(&Range) -> f64| -> Vec<Option<f64>> {
            let values = self.stretches.values().map(|ranges| pick(&ranges[channel]));
            values
                .map(|value| value.is_finite().then(|| round_digits(value)))
                .collect()
        };
        let channel = |(i, name): (usize, &&str)| {
            let (min, max) = (trace(i, |range| range.min), trace(i, |range| range.max));
            ((*name).to_owned(), Trace { min, max })
        };
        let ticks = self.stretches.keys().map(|i| i * self.every_ticks);
        Group {
            every_ticks: self.every_ticks,
            tick: ticks.collect(),
            channels: names.iter().enumerate().map(channel).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use controller::Trajectory;
    use messages::content::{RotorSpeeds, Setpoint, Wrench};
    use messages::monitor::Monitor;

    use super::*;

    fn tracer() -> Tracer {
        Tracer::new(Tracking::of(Trajectory::Hover, 1e-3))
    }

    fn joined(tick: u64, x: f64) -> Joined {
        let mut joined = Joined {
            tick,
            setpoint: Some(Setpoint::default()),
            wrench: Some(Wrench::default()),
            rotor_speeds: Some(RotorSpeeds::default()),
            ..Joined::default()
        };
        joined.state.truth.position_w_m = [x, 0.0, 1.0];
        joined.state.measured.position_w_m = [f64::NAN; 3];
        joined
    }

    #[test]
    fn a_long_flight_keeps_its_peaks_in_bounded_memory() {
        let (mut tracer, last) = (tracer(), 500_000);
        for tick in 0..=last {
            tracer.take(&joined(tick, if tick == 123_456 { 7.0 } else { 0.5 }));
        }
        let Traces { flight, path, .. } = tracer.traces();
        assert!((STRETCHES / 2..=STRETCHES).contains(&flight.tick.len()));
        let peaks = flight.spans(POSITION[0]).filter(|span| span.max > 0.5);
        let peaks: Vec<_> = peaks.collect();
        assert_eq!((peaks.len(), peaks[0].min, peaks[0].max), (1, 0.5, 7.0));
        assert!((peaks[0].tick..peaks[0].tick + flight.every_ticks).contains(&123_456));
        let newest = path.position_w_m.last().map(|it| it[0]);
        let path = (path.tick.len(), path.tick.last(), newest);
        assert_eq!(path, (PATH_SAMPLES, Some(&last), Some(0.5)));
    }

    #[test]
    fn a_state_without_messages_of_the_stages_is_traced_and_violations_are_counted_through_a_restart()
     {
        let mut tracer = tracer();
        for (tick, count) in [(0, 0), (1, 2), (2, 2), (3, 1)] {
            let mut monitor = Monitor::default();
            monitor.violations[Cause::GyroNoise as usize] = count;
            let monitor = Some(monitor);
            let joined = joined(tick, 0.5);
            tracer.take(&Joined { monitor, ..joined });
        }
        let mut alone = Joined {
            tick: 4,
            ..Joined::default()
        };
        alone.state.truth.position_w_m = [9.0, 0.0, 1.0];
        tracer.take(&alone);
        let Traces {
            flight, violations, ..
        } = tracer.traces();
        let largest = |channel| {
            let spans = flight.spans(channel);
            spans.map(|span| span.max).fold(0.0, f64::max)
        };
        assert_eq!(largest(POSITION[0]), 9.0);
        assert!(largest(DISTANCE) > 9.0, "the climb to 1 m has only begun");
        assert_eq!(flight.spans(THRUST).count(), 4, "one tick has no wrench");
        let counts = violations["gyro_noise"].iter();
        assert!(counts.map(|it| (it.tick, it.count)).eq([(1, 2), (3, 1)]));
        assert_eq!(violations.len(), 1, "{violations:?}");
    }
}
