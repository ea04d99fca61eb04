//! The dashboard's state: the flight, and what the user looks at.
//!
//! It is pure. Others tell it everything; its only output is the answer of [`Model::key`](crate::watch::keys).

use std::collections::BTreeMap;

use model::boards::{Ending, InForce, Run, Status};
use model::messages::{RotorSpeeds, Setpoint, State, Wrench};
use model::monitor::Monitor;
use model::parameters::{Airframe, Parameter, SPECS};
use model::role::Role;

use crate::observe::ObservedMessage;
use crate::settings::PointsFile;
use crate::settings::airframe::airframe_of;
use crate::settings::laws;
use crate::settings::trajectory::{built_in, is_file};
use crate::watch::trace::ErrorTrace;
use failure::Failure;
use report::laws::FlownLaws;
use report::swaps::AppliedSwap;
use report::tally::{Tally, is_last_word};
use report::tracking::Tracking;

use crate::watch::words::StealWatch;

/// A page of the dashboard.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Tab {
    /// Where the airframe is, and where it should be.
    #[default]
    Flight,
    /// How late every step was.
    Latency,
    /// Whether the theorem holds.
    Theorem,
    /// The airframe's parameters.
    Plant,
    /// What the system granted.
    RealTime,
    /// What the laws show of themselves.
    Laws,
}

impl Tab {
    /// All of them, in order.
    pub const ALL: [Self; 6] = [Self::Flight, Self::Latency, Self::Theorem, Self::Plant, Self::RealTime, Self::Laws];

    /// Its name.
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

/// A line for the user, and whether it is bad news.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Said {
    /// What.
    pub text: String,
    /// Whether something was refused or failed.
    pub refused: bool,
}

/// The page with the parameters.
#[derive(Clone, Debug, Default)]
pub struct ParameterPage {
    /// Row of the table of parameters.
    pub selected: usize,
    /// What is being typed as its new value, or as a fault.
    pub typed: Option<String>,
    /// Whether it is a fault.
    pub fault: bool,
    /// Whether the plant has not answered yet.
    pub waits: bool,
    /// What came of the last one.
    pub said: Option<Said>,
}

impl ParameterPage {
    /// The selected parameter.
    #[must_use]
    pub fn parameter(&self) -> Parameter {
        SPECS[self.selected.min(SPECS.len() - 1)].parameter
    }
}

/// Everything that the dashboard shows.
#[derive(Debug)]
pub struct Model {
    /// Name of the instance.
    pub instance: String,
    /// Whether a launcher waits for the end: then leaving the dashboard and ending the flight are two things.
    pub launched: bool,
    /// Whether colours may be used.
    pub colours: bool,
    /// The page that is open.
    pub tab: Tab,
    /// Whether help lies over it.
    pub help: bool,
    /// Row of the table of latencies.
    pub series: usize,
    /// The page with the parameters.
    pub desk: ParameterPage,
    /// The flight: the present one, or the last.
    pub flight: Option<WatchedFlight>,
}

impl Model {
    /// Knows nothing yet.
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

    /// Whether there is a flight in the air.
    #[must_use]
    pub fn flies(&self) -> bool {
        self.flight.as_ref().is_some_and(|flight| flight.ending.is_none())
    }

    /// Begins to show a flight.
    ///
    /// # Errors
    /// Those of [`Tally::joining`].
    pub fn join(&mut self, run: &Run, settings: BTreeMap<String, String>) -> Result<(), Failure> {
        self.flight = Some(WatchedFlight::new(run, settings)?);
        self.desk = ParameterPage { selected: self.desk.selected, ..ParameterPage::default() };
        Ok(())
    }

    /// Takes the plant's answer to an injection.
    pub fn answer(&mut self, answer: Result<String, Failure>) {
        self.desk.waits = false;
        self.desk.said = Some(match answer {
            Ok(injected) => Said { text: injected.split_whitespace().collect::<Vec<_>>().join(" "), refused: false },
            Err(failure) => Said { text: failure.to_string(), refused: true },
        });
    }

    /// Begins all statistics anew.
    ///
    /// # Errors
    /// Those of [`Tally::joining`].
    pub fn reset(&mut self) -> Result<(), Failure> {
        self.flight.as_mut().map_or(Ok(()), WatchedFlight::reset)
    }
}

/// A flight as the dashboard has seen it.
#[derive(Debug)]
pub struct WatchedFlight {
    /// The run as its plant shows it.
    pub run: Run,
    /// Settings that all roles share, by key.
    pub settings: BTreeMap<String, String>,
    /// How it ended.
    pub ending: Option<Ending>,
    /// Whether the recorder lives, who passes everything on and watches the theorem; or did when the flight ended.
    pub recorder_lives: bool,
    /// Statistics since the dashboard joined, or since they were reset.
    pub tally: Tally,
    /// Messages lost before they were reset.
    lost_before: u64,
    tracking: Tracking,
    /// Newest state.
    pub state: Option<State>,
    /// Newest set-point.
    pub setpoint: Option<Setpoint>,
    /// Newest wrench.
    pub wrench: Option<Wrench>,
    /// Newest rotor command.
    pub rotor_speeds: Option<RotorSpeeds>,
    /// What was said of the theorem last.
    pub monitor: Option<Monitor>,
    /// Position error [m].
    pub position_error: ErrorTrace,
    /// V_th [rad^2/s^2].
    pub v_th: ErrorTrace,
    /// V [rad^2/s^2].
    pub v: ErrorTrace,
    /// Every role as it shows itself.
    pub crew: BTreeMap<Role, Status>,
    /// The parameters in force.
    pub in_force: InForce,
    /// The newest swap that the dashboard has seen.
    pub newest_swap: Option<AppliedSwap>,
    /// The airframe as it was built.
    pub airframe: Airframe,
    /// What is known of the laws.
    pub laws: FlownLaws,
    /// What the host takes.
    pub steal: StealWatch,
}

impl WatchedFlight {
    fn new(run: &Run, settings: BTreeMap<String, String>) -> Result<Self, Failure> {
        let tracking = tracking(run, &settings)?;
        let airframe = airframe_of(&settings)?;
        let laws = laws::shared(&settings)?;
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
            in_force: InForce::default(),
            newest_swap: None,
            steal: StealWatch::default(),
        })
    }

    fn tally(run: &Run, tracking: Tracking, laws: FlownLaws) -> Result<Tally, Failure> {
        let mut tally = Tally::joining(run.pace(), run.t0_ns, tracking)?;
        tally.flown_by(laws);
        Ok(tally)
    }

    fn reset(&mut self) -> Result<(), Failure> {
        self.lost_before = self.lost();
        let theorem = self.tally.theorem;
        self.tally = Self::tally(&self.run, self.tracking, self.laws)?;
        // The monitor counts in the recorder, from the flight's begin on.
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
        if self.state.is_some() { self.tally.newest_tick() } else { self.run.tick }
    }

    /// The newest tick that was seen of, where the recorder has gone since: of what came later nothing is known.
    #[must_use]
    pub fn lost_at(&self) -> Option<u64> {
        (!self.recorder_lives).then(|| self.tick())
    }

    /// A setting of the run, as text.
    #[must_use]
    pub fn setting(&self, key: &str) -> &str {
        self.settings.get(key).map_or("", String::as_str)
    }

    /// Takes a message.
    pub fn take(&mut self, seen: ObservedMessage<'_>) {
        match seen {
            ObservedMessage::State(message) => {
                self.tally.state(message);
                self.state = Some(message.content);
                let tick = message.envelope.tick;
                self.position_error.take(self.run.flight_time_s(tick), self.tracking.error_m(tick, &message.content));
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
                self.newest_swap = Some(AppliedSwap::new(message.envelope.tick, period_s, &message.content));
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

/// The reference of a flight whose settings its processes share.
fn tracking(run: &Run, settings: &BTreeMap<String, String>) -> Result<Tracking, Failure> {
    const KEY: &str = "flight.trajectory";
    let name = settings.get(KEY).map_or("", String::as_str);
    let course = if is_file(name) {
        let sha256 = settings.get("trajectory.sha256").map_or("", String::as_str);
        let gone = |what: String| {
            Failure::failed(what).help(format!(
                "bring back the file whose SHA-256 is {sha256}, and watch again; the flight itself goes on, and flight.mcap \
                 keeps its points"
            ))
        };
        let read = PointsFile::read(name);
        let points = read.map_err(|e| gone(format!("the trajectory of the flight cannot be shown: {e}")))?;
        if points.sha256 != sha256 {
            return Err(gone(format!("the trajectory file {name} has changed since the flight began")));
        }
        points.course
    } else {
        built_in(name).map_err(|e| Failure::failed(format!("{KEY} of the flight is `{name}`: {e}")))?
    };
    let number = |key: &str| settings.get(key).and_then(|value| value.parse().ok()).unwrap_or(1.0);
    let course = course.stretched(number("trajectory.size"), number("trajectory.period"));
    Ok(Tracking::along(course, run.sample_time_ns as f64 / 1e9))
}
