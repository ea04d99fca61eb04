//! The dashboard's state: the flight, and what the user looks at.
//!
//! It has no inputs and outputs of its own: others pass it messages and keys, and it returns the action of [`Model::key`](crate::watch::keys).

use std::collections::{BTreeMap, VecDeque};

use messages::blackboards::{ActiveParameters, EndReason, Run, Status};
use messages::content::{NO_TICK, RotorSpeeds, Setpoint, State, Wrench};
use messages::monitor::Monitor;
use messages::parameters::{Airframe, Parameter, SPECS};
use messages::role::{Role, STAGES};

use crate::observation::ObservedMessage;
use crate::settings::PointsFile;
use crate::settings::airframe::airframe_of;
use crate::settings::law_settings;
use crate::settings::trajectory::{built_in, is_file};
use errors::Failure;
use host::cpu_times::CpuTimes;
use host::sampler::Watch;
use report::flight_statistics::{FlightStatistics, is_last_word};
use report::host::Steal;
use report::laws::FlownLaws;
use report::schema::{Explained, Verdicts};
use report::speed::Speed;
use report::swaps::AppliedSwap;
use report::tracking::Tracking;
use report::verdicts::{TrackingLimits, flight_verdict, stability_verdict, timing_verdict};

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Tab {
    /// Where the airframe is, and where it should be.
    #[default]
    Flight,
    Latency,
    Theorem,
    Plant,
    RealTime,
    /// What the laws show of themselves.
    Laws,
}

impl Tab {
    pub const ALL: [Self; 6] = [
        Self::Flight,
        Self::Latency,
        Self::Theorem,
        Self::Plant,
        Self::RealTime,
        Self::Laws,
    ];

    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Flight => "Flight",
            Self::Latency => "Latency",
            Self::Theorem => "Theorem",
            Self::Plant => "Plant",
            Self::RealTime => "Real time",
            Self::Laws => "Laws",
        }
    }
}

/// A message for the user.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Said {
    pub text: String,
    /// Whether it reports an error.
    pub refused: bool,
}

#[derive(Clone, Debug, Default)]
pub struct ParameterPage {
    /// Row of the table of parameters.
    pub selected: usize,
    /// The text being typed: a new value or a fault.
    pub typed: Option<String>,
    pub fault: bool,
    /// Whether the plant's answer is pending.
    pub waits: bool,
    /// The result of the last request.
    pub said: Option<Said>,
}

impl ParameterPage {
    #[must_use]
    pub fn parameter(&self) -> Parameter {
        SPECS[self.selected.min(SPECS.len() - 1)].parameter
    }
}

#[derive(Debug)]
pub struct Model {
    pub instance: String,
    /// Whether `fly` started the dashboard: then leaving it does not end the flight.
    pub launched: bool,
    pub colours: bool,
    pub tab: Tab,
    pub help: bool,
    /// Row of the table of latencies.
    pub series: usize,
    pub desk: ParameterPage,
    /// The current or last flight.
    pub flight: Option<WatchedFlight>,
}

impl Model {
    #[must_use]
    pub fn new(instance: &str, launched: bool, colours: bool) -> Self {
        Self {
            instance: instance.into(),
            launched,
            colours,
            tab: Tab::default(),
            help: false,
            series: 0,
            desk: ParameterPage::default(),
            flight: None,
        }
    }

    /// Whether a flight is running.
    #[must_use]
    pub fn flies(&self) -> bool {
        self.flight
            .as_ref()
            .is_some_and(|flight| flight.ending.is_none())
    }

    pub fn join(&mut self, run: &Run, settings: BTreeMap<String, String>) -> Result<(), Failure> {
        self.flight = Some(WatchedFlight::new(run, settings)?);
        self.desk = ParameterPage {
            selected: self.desk.selected,
            ..ParameterPage::default()
        };
        Ok(())
    }

    /// Takes the plant's answer to an injection.
    pub fn answer(&mut self, answer: Result<String, Failure>) {
        self.desk.waits = false;
        self.desk.said = Some(match answer {
            Ok(injected) => Said {
                text: injected.split_whitespace().collect::<Vec<_>>().join(" "),
                refused: false,
            },
            Err(failure) => Said {
                text: failure.to_string(),
                refused: true,
            },
        });
    }

    pub fn reset(&mut self) -> Result<(), Failure> {
        self.flight.as_mut().map_or(Ok(()), WatchedFlight::reset)
    }
}

/// A flight as the dashboard has seen it.
#[derive(Debug)]
pub struct WatchedFlight {
    /// The run as its plant publishes it.
    pub run: Run,
    /// Settings shared by all roles, by key.
    pub settings: BTreeMap<String, String>,
    pub ending: Option<EndReason>,
    /// Whether the recorder runs, which passes messages on and runs the Lyapunov monitor; or ran at the end of the flight.
    pub recorder_lives: bool,
    /// Statistics since the dashboard joined, or since they were reset.
    pub tally: FlightStatistics,
    /// Messages lost before they were reset.
    lost_before: u64,
    tracking: Tracking,
    pub state: Option<State>,
    pub setpoint: Option<Setpoint>,
    pub wrench: Option<Wrench>,
    pub rotor_speeds: Option<RotorSpeeds>,
    /// The monitor's latest result.
    pub monitor: Option<Monitor>,
    /// Position error [m].
    pub position_error: ErrorTrace,
    /// V_th [rad^2/s^2].
    pub v_th: ErrorTrace,
    /// V [rad^2/s^2].
    pub v: ErrorTrace,
    pub crew: BTreeMap<Role, Status>,
    pub in_force: ActiveParameters,
    /// The latest parameter change that the dashboard received.
    pub newest_swap: Option<AppliedSwap>,
    /// The airframe as it was built.
    pub airframe: Airframe,
    pub laws: FlownLaws,
    pub steal: StealWatch,
}

impl WatchedFlight {
    fn new(run: &Run, settings: BTreeMap<String, String>) -> Result<Self, Failure> {
        let tracking = tracking(run, &settings)?;
        let airframe = airframe_of(&settings)?;
        let laws = law_settings::shared(&settings)?;
        let mut tally = Self::tally(run, tracking, laws)?;
        tally.theorem.flown_by(&airframe);
        Ok(Self {
            airframe,
            laws,
            run: *run,
            settings,
            ending: None,
            recorder_lives: true,
            tally,
            lost_before: 0,
            tracking,
            state: None,
            setpoint: None,
            wrench: None,
            rotor_speeds: None,
            monitor: None,
            position_error: ErrorTrace::default(),
            v_th: ErrorTrace::default(),
            v: ErrorTrace::default(),
            crew: BTreeMap::new(),
            in_force: ActiveParameters::default(),
            newest_swap: None,
            steal: StealWatch::default(),
        })
    }

    fn tally(run: &Run, tracking: Tracking, laws: FlownLaws) -> Result<FlightStatistics, Failure> {
        let mut tally = FlightStatistics::joining(run.pace(), run.t0_ns, tracking)?;
        tally.flown_by(laws);
        Ok(tally)
    }

    fn reset(&mut self) -> Result<(), Failure> {
        self.lost_before = self.lost();
        let theorem = self.tally.theorem;
        self.tally = Self::tally(&self.run, self.tracking, self.laws)?;
        // The recorder counts these, from the start of the flight.
        self.tally.theorem = theorem;
        self.position_error = ErrorTrace::default();
        self.v_th = ErrorTrace::default();
        self.v = ErrorTrace::default();
        Ok(())
    }

    /// Messages that were overwritten before the dashboard read them.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.lost_before + self.tally.lost().iter().sum::<u64>()
    }

    /// Tick of the newest state; that of the plant's board before the first.
    #[must_use]
    pub fn tick(&self) -> u64 {
        if self.state.is_some() {
            self.tally.newest_tick()
        } else {
            self.run.tick
        }
    }

    /// The latest known tick if the recorder has died since.
    #[must_use]
    pub fn lost_at(&self) -> Option<u64> {
        (!self.recorder_lives).then(|| self.tick())
    }

    /// A setting of the run, as text.
    #[must_use]
    pub fn setting(&self, key: &str) -> &str {
        self.settings.get(key).map_or("", String::as_str)
    }

    pub fn take(&mut self, seen: ObservedMessage<'_>) {
        match seen {
            ObservedMessage::State(message) => {
                self.tally.state(message);
                self.state = Some(message.content);
                let tick = message.envelope.tick;
                self.position_error.take(
                    self.run.flight_time_s(tick),
                    self.tracking.error_m(tick, &message.content),
                );
            }
            ObservedMessage::Setpoint(message) => {
                self.tally.setpoint(message);
                self.setpoint = Some(message.content);
            }
            ObservedMessage::Wrench(message) => {
                self.tally.wrench(message);
                self.wrench = Some(message.content);
            }
            ObservedMessage::RotorSpeeds(message) => {
                self.tally.rotor_speeds(message);
                if !is_last_word(message) {
                    self.rotor_speeds = Some(message.content);
                }
            }
            ObservedMessage::Swap(message) => {
                self.tally.swap(message);
                let period_s = self.run.sample_time_ns as f64 / 1e9;
                self.newest_swap = Some(AppliedSwap::new(
                    message.envelope.tick,
                    period_s,
                    &message.content,
                ));
            }
            ObservedMessage::Theorem(message) => {
                self.tally.theorem(message);
                self.monitor = Some(message.content);
                let time_s = self.run.flight_time_s(message.envelope.tick);
                self.v_th.take(time_s, message.content.v_th);
                self.v.take(time_s, message.content.v);
            }
        }
    }
}

/// The reference trajectory of a flight, from its shared settings.
fn tracking(run: &Run, settings: &BTreeMap<String, String>) -> Result<Tracking, Failure> {
    const KEY: &str = "flight.trajectory";
    let name = settings.get(KEY).map_or("", String::as_str);
    let course = if is_file(name) {
        let sha256 = settings.get("trajectory.sha256").map_or("", String::as_str);
        let gone = |what: String| {
            Failure::failed(what).help(format!(
                "restore the file with SHA-256 {sha256}, and start watch again; the flight itself continues, and flight.mcap \
                 contains its points"
            ))
        };
        let read = PointsFile::read(name);
        let points =
            read.map_err(|e| gone(format!("the trajectory of the flight cannot be shown: {e}")))?;
        if points.sha256 != sha256 {
            return Err(gone(format!(
                "the trajectory file {name} has changed since the flight began"
            )));
        }
        points.course
    } else {
        built_in(name)
            .map_err(|e| Failure::failed(format!("{KEY} of the flight is `{name}`: {e}")))?
    };
    let number = |key: &str| {
        settings
            .get(key)
            .and_then(|value| value.parse().ok())
            .unwrap_or(1.0)
    };
    let course = course.stretched(number("trajectory.size"), number("trajectory.period"));
    Ok(Tracking::along(course, run.sample_time_ns as f64 / 1e9))
}

/// CPU time that the hypervisor took from the loops' CPU, since the dashboard knows that CPU.
#[derive(Clone, Copy, Debug, Default)]
pub struct StealWatch {
    begin: Option<(Option<u64>, CpuTimes)>,
    pub steal: Steal,
}

impl StealWatch {
    /// Updates the figures for the CPU of this flight's loops.
    pub fn look(&mut self, flight: &WatchedFlight) {
        let loops = STAGES.map(|role| flight.crew.get(&role).copied().unwrap_or_default());
        let processor = Watch::new(&loops, true).processor;
        let now = CpuTimes::read(processor);
        match &self.begin {
            Some((of, begin)) if *of == processor => self.steal = begin.steal_until(&now),
            _ => self.begin = Some((processor, now)),
        }
    }
}

/// The three verdicts on a flight so far.
#[must_use]
pub fn verdicts(flight: &WatchedFlight) -> Verdicts {
    let (run, tally) = (&flight.run, &flight.tally);
    let speed = Speed::of(run.period_ns, run.sample_time_ns);
    // Counted by the plant, from the start of the flight.
    let mut ticks = tally.ticks(run);
    ticks.skipped = run.ticks_skipped;
    let begun = if flight.tick() == NO_TICK {
        0
    } else {
        flight.tick() + 1
    };
    ticks.run = begun.saturating_sub(run.ticks_skipped);
    let limit = |key: &str| flight.setting(key).parse::<f64>().ok();
    let limits = limit("flight.tracking_error_max_m").zip(limit("flight.ground_z_m"));
    let unknown = || Explained {
        why: "the limits of the flight are unknown".into(),
        ..Explained::default()
    };
    let tracked = |(error_max_m, ground_z_m)| {
        flight_verdict(
            &tally.flight(),
            flight.ending,
            &TrackingLimits {
                error_max_m,
                ground_z_m,
            },
        )
    };
    Verdicts {
        flight: limits.map_or_else(unknown, tracked),
        timing: timing_verdict(
            &ticks,
            &tally.not_fresh(&ticks).unwrap_or_default(),
            speed,
            &flight.steal.steal,
        ),
        theorem: stability_verdict(&tally.theorem.section()),
    }
}

/// Flight time of a point [s].
pub const POINT_S: f64 = 0.1;
pub const POINTS: usize = 600;

/// The last [`POINTS`] points.
#[derive(Clone, Debug, Default)]
pub struct ErrorTrace {
    points: VecDeque<f64>,
    /// The current point: its number, and the largest value so far.
    present: Option<(u64, f64)>,
}

impl ErrorTrace {
    /// Takes the value at a time of the flight [s].
    pub fn take(&mut self, time_s: f64, value: f64) {
        let number = (time_s / POINT_S) as u64;
        match &mut self.present {
            Some((present, largest)) if *present == number => *largest = largest.max(value),
            present => {
                if let Some((_, largest)) = present.replace((number, value)) {
                    self.points.push_back(largest);
                    if self.points.len() > POINTS {
                        self.points.pop_front();
                    }
                }
            }
        }
    }

    /// At most `most` newest points, in order of time.
    #[must_use]
    pub fn newest(&self, most: usize) -> Vec<f64> {
        let all = self
            .points
            .iter()
            .copied()
            .chain(self.present.map(|(_, largest)| largest));
        let skipped =
            (self.points.len() + usize::from(self.present.is_some())).saturating_sub(most);
        all.skip(skipped).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_is_the_largest_of_its_tenth_of_a_second() {
        let mut trace = ErrorTrace::default();
        for (time_s, value) in [
            (0.01, 1.0),
            (0.05, 3.0),
            (0.09, 2.0),
            (0.11, 5.0),
            (0.21, 4.0),
        ] {
            trace.take(time_s, value);
        }
        assert_eq!(trace.newest(10), [3.0, 5.0, 4.0]);
        assert_eq!(trace.newest(2), [5.0, 4.0]);
    }

    #[test]
    fn old_points_are_dropped() {
        let mut trace = ErrorTrace::default();
        for i in 0..2 * POINTS {
            trace.take(i as f64 * POINT_S + 0.01, i as f64);
        }
        let points = trace.newest(usize::MAX);
        assert_eq!(
            (points.len(), points.last()),
            (POINTS + 1, Some(&((2 * POINTS - 1) as f64)))
        );
    }
}
